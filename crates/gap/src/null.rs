//! The null distribution of the statistics, by replicates: whole simulated drives along the recorded poses.
//!
//! Beams of a scan share its pose's error and its blocks, and scans share both, so that no statistic over beams has a
//! distribution one could look up. Here each replicate simulates the whole log, with blocks that stay as long as the
//! log's and references that err as the log's, fits the same nuisances to it, and gives all statistics. One false-alarm
//! rate holds for all of them together: the largest standardized statistic of the log is ranked among those of the
//! replicates (max-T; Westfall and Young 1993).

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use crate::hypothesis::{Comparison, Fitted, Nuisances};
use crate::rank::rank;
use crate::replay::Replay;
use crate::statistics::{Dictionary, Group, Halves, Readings, pit_draw};
use crate::{GapError, Purpose};

/// Expectation maximization steps of a replicate, which starts at the fitted process.
pub(crate) const REFIT: usize = 4;

/// The statistics of a log beside those of replicates.
pub(crate) struct Null {
    /// The log's statistics in standard deviations of the replicates, over both halves.
    pub z: Vec<f64>,
    /// The same of each half of the log's folds.
    pub halves: Vec<Halves>,
    /// The log's rank among replicates: p-values of the largest of the library, of the cells, of all.
    pub p_library: f64,
    pub p_omnibus: f64,
    pub p: f64,
    /// How much each statistic says: minus the logarithm of the chance that one of its group says as much, over the
    /// group's share of the false-alarm rate.
    pub weight: Vec<f64>,
    /// The largest weight of each replicate, in order.
    pub largest: Vec<f64>,
    /// The threshold of each group at a false-alarm rate of 1 % (standard deviations).
    pub thresholds: [f64; Group::COUNT],
    /// Standard deviation of each statistic among the replicates.
    pub spread: Vec<f64>,
    /// Nuisances that were found in the replicates.
    pub nuisances: Vec<Nuisances>,
    /// Log likelihood of some of the replicates (nats).
    pub log_likelihoods: Vec<f64>,
}

impl Null {
    /// Whether the log is so far beyond all replicates that more of them would not make it a log without anything.
    pub fn is_clearly_off(&self) -> bool {
        let own = self.weight.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        matches!(self.largest[..], [.., most] if own > most + FARTHER)
    }

    /// The weight that the largest of a log without anything exceeds with this chance.
    pub fn weight_at(&self, chance: f64) -> f64 {
        let rank = ((1.0 - chance) * self.largest.len() as f64) as usize;
        self.largest[rank.min(self.largest.len() - 1)]
    }
}

/// Runs the replicates and ranks the log among them.
#[expect(clippy::too_many_arguments, reason = "one call, and each is a thing of its own")]
pub(crate) fn compare(
    replay: &Replay<'_>,
    comparison: &Comparison<'_>,
    dictionary: &Dictionary,
    fitted: &Fitted,
    replicates: u32,
    seed: u64,
    stop: &AtomicBool,
    tick: &(dyn Fn(u64) + Sync),
) -> Result<Null, GapError> {
    let effects = replay.nominal.effects_with(replay.effects)?;
    let has_pose_errors = !replay.nuisances.pose_error.is_none();
    let measure = |comparison: &Comparison<'_>, fitted: &Fitted, seed: u64| {
        dictionary.measure(&Readings::new(comparison, &effects, fitted, has_pose_errors, &pit_draw(seed)))
    };
    let own = measure(comparison, fitted, seed);
    let draw = Purpose::Replicates.draw(seed);
    let one = |i: u32| {
        if stop.load(Ordering::Relaxed) {
            return Err(GapError::Interrupted);
        }
        let recorded = replay.simulate(draw.seed(i))?;
        let other = comparison.of(&recorded);
        let fitted = other.find_nuisances(&effects, &replay.nuisances, REFIT);
        let statistics = measure(&other, &fitted, draw.seed(i));
        let likelihood =
            (i < WITH_LIKELIHOOD).then(|| other.evaluate_views(&other.views, &effects, &fitted, 0).total());
        tick(1);
        Ok((statistics, fitted.nuisances, likelihood))
    };
    let (mut statistics, mut nuisances, mut log_likelihoods) = (Vec::new(), Vec::new(), Vec::new());
    let mut begun = 0;
    // Of a world with effects the question is whether anything is left; of the nominal one also what would have been seen.
    let mut end = if replay.effects.is_empty() { FIRST_LOOK } else { EARLIEST_LOOK }.min(replicates);
    loop {
        let more = (begun..end).into_par_iter().map(one).collect::<Result<Vec<_>, GapError>>()?;
        for (of_log, found, likelihood) in more {
            statistics.push(of_log);
            nuisances.push(found);
            log_likelihoods.extend(likelihood);
        }
        begun = end;
        let null = rank(&dictionary.statistics, &own, &statistics);
        let is_clear = match begun {
            EARLIEST_LOOK => null.p > NOTHING_SO_EARLY,
            _ => null.p > CLEARLY_NOTHING || null.is_clearly_off(),
        };
        if begun == replicates || is_clear {
            tick(u64::from(replicates - begun));
            return Ok(Null { nuisances, log_likelihoods, ..null });
        }
        end = if begun < FIRST_LOOK { FIRST_LOOK.min(replicates) } else { replicates };
    }
}

/// Replicates whose log likelihood is found, for a mean: its error is an eighth of what logs differ by.
const WITH_LIKELIHOOD: u32 = 64;

/// Replicates after which the comparison may stop, because more of them could not change the answer (Besag and Clifford 1991).
const FIRST_LOOK: u32 = 199;
/// It stops there if a larger share of the replicates than this exceeds the log.
const CLEARLY_NOTHING: f64 = 0.1;
/// It stops there if the log is beyond all replicates by this (nats). One log in 200 is beyond all of them by chance, and e^-3
/// of those by so much.
const FARTHER: f64 = 3.0;
/// In a world with effects it may stop after this many replicates,
const EARLIEST_LOOK: u32 = 59;
/// if a larger share of them than this exceeds the log.
const NOTHING_SO_EARLY: f64 = 0.3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_is_clearly_off_beyond_all_replicates_and_more() {
        let of = |own: f64| Null {
            z: Vec::new(),
            halves: Vec::new(),
            p_library: 0.0,
            p_omnibus: 0.0,
            p: 0.0,
            weight: vec![0.1, own],
            largest: vec![1.0, 2.0],
            thresholds: [0.0; Group::COUNT],
            spread: Vec::new(),
            nuisances: Vec::new(),
            log_likelihoods: Vec::new(),
        };
        assert!(of(2.1 + FARTHER).is_clearly_off());
        assert!(!of(1.9 + FARTHER).is_clearly_off());
    }
}
