//! The null distribution of the statistics, by replicates: whole simulated drives along the recorded poses.
//!
//! Beams of a scan share its pose's error and its blocks, and scans share both, so that no statistic over beams has a
//! distribution one could look up. Here each replicate simulates the whole log, with blocks that stay as long as the
//! log's and references that err as the log's, fits the same nuisances to it, and gives all statistics. One false-alarm
//! rate holds for all of them together: the largest standardized statistic of the log is ranked among those of the
//! replicates (max-T; Westfall and Young 1993).

use std::sync::atomic::{AtomicBool, Ordering};

use distreg::sequential::{first_look, next_look};
use locsim_comparison::Replay;
use rayon::prelude::*;

use crate::rank::{Null, rank};
use crate::statistics::{Dictionary, Readings, pit_draw};
use crate::{GapError, Purpose};
use locsim_comparison::{Comparison, Fitted};

/// Expectation maximization steps of a replicate, which starts at the fitted process.
pub(crate) const REFIT: usize = 4;

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
        tick(u64::from(i < replicates));
        Ok((statistics, fitted.nuisances, likelihood))
    };
    let (mut statistics, mut nuisances, mut log_likelihoods) = (Vec::new(), Vec::new(), Vec::new());
    let mut begun = 0;
    // Of a world with effects the question is whether anything is left; of the nominal one also what would have been seen, and a rejection is an
    // alarm.
    let is_nominal = replay.effects.is_empty();
    let mut end = first_look(is_nominal).min(replicates);
    loop {
        let more = (begun..end).into_par_iter().map(one).collect::<Result<Vec<_>, GapError>>()?;
        for (of_log, found, likelihood) in more {
            statistics.push(of_log);
            nuisances.push(found);
            log_likelihoods.extend(likelihood);
        }
        begun = end;
        let null = rank(&dictionary.statistics, &own, &statistics);
        let Some(next) = next_look(begun, replicates, null.p, null.is_clearly_off(), is_nominal) else {
            tick(u64::from(replicates.saturating_sub(begun)));
            return Ok(Null { nuisances, log_likelihoods, ..null });
        };
        end = next;
    }
}

/// Replicates whose log likelihood is found, for a mean: its error is an eighth of what logs differ by.
const WITH_LIKELIHOOD: u32 = 64;
