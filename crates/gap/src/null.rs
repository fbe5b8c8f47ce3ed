//! The null distribution of the statistics, by replicates: whole simulated drives along the recorded poses.
//!
//! Beams of a scan share its pose's error and its blocks, and scans share both, so that no statistic over beams has a
//! distribution one could look up. Here each replicate simulates the whole log, with blocks that stay as long as the
//! log's and references that err as the log's, fits the same nuisances to it, and gives all statistics. One false-alarm
//! rate holds for all of them together: the largest standardized statistic of the log is ranked among those of the
//! replicates (max-T; Westfall and Young 1993).

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use crate::hypothesis::{Comparison, Fitted};
use crate::rank::{Null, rank};
use crate::replay::Replay;
use crate::statistics::{Dictionary, Readings, pit_draw};
use crate::{GapError, Purpose};

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
        let is_nominal = replay.effects.is_empty();
        let Some(next) = next_look(begun, replicates, null.p, null.is_clearly_off(), is_nominal) else {
            tick(u64::from(replicates.saturating_sub(begun)));
            return Ok(Null { nuisances, log_likelihoods, ..null });
        };
        end = next;
    }
}

/// To how many replicates the comparison goes on after so many of those that were asked for; `None` where they are enough.
fn next_look(begun: u32, replicates: u32, p: f64, is_clearly_off: bool, is_nominal: bool) -> Option<u32> {
    let is_clear = match begun {
        EARLIEST_LOOK => p > NOTHING_SO_EARLY,
        _ => p > CLEARLY_NOTHING || is_clearly_off,
    };
    let may_be_nothing = is_nominal || p * f64::from(begun) > 1.0;
    let is_in_doubt = (FEWEST_TO_REJECT..ENOUGH).contains(&begun) && p <= IN_DOUBT && may_be_nothing;
    let next = [FIRST_LOOK.min(replicates), replicates, ENOUGH].into_iter().find(|look| *look > begun);
    next.filter(|look| !is_clear && (*look <= replicates || is_in_doubt))
}

/// Replicates whose log likelihood is found, for a mean: its error is an eighth of what logs differ by.
const WITH_LIKELIHOOD: u32 = 64;

/// Replicates after which the comparison may stop, because more of them could not change the answer (Besag and Clifford 1991).
const FIRST_LOOK: u32 = 199;
/// It stops there if a larger share of the replicates than this exceeds the log.
const CLEARLY_NOTHING: f64 = 0.1;
/// In a world with effects it may stop after this many replicates,
const EARLIEST_LOOK: u32 = 59;
/// if a larger share of them than this exceeds the log.
const NOTHING_SO_EARLY: f64 = 0.3;
/// Where it isn't clear after as few replicates as this, the fewest that can reject at a false-alarm rate of 1 %,
const FEWEST_TO_REJECT: u32 = 99;
/// and no larger a share of them than this exceeds the log, one replicate more or less would decide. With effects, a log beyond all of
/// them is off: what is left there is no alarm.
const IN_DOUBT: f64 = 0.05;
/// So many are simulated then. A log is rejected by all of them or not at all, so that the rate of false alarms is theirs.
const ENOUGH: u32 = 399;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_replicates_are_simulated_where_they_can_change_the_answer() {
        let next = |begun, replicates, p| next_look(begun, replicates, p, false, true);
        // 999 are the default: the first 199 tell what is clear.
        assert_eq!((next(199, 999, 0.05), next(199, 999, 0.2)), (Some(999), None));
        assert_eq!(next_look(199, 999, 0.005, true, true), None);
        assert_eq!(next(999, 999, 0.002), None);
        // Of 99 none, or up to four, are beyond the log.
        assert_eq!(
            [0.01, 0.03, 0.05, 0.06, 0.2].map(|p| next(99, 99, p).is_some()),
            [true, true, true, false, false]
        );
        assert_eq!((next(99, 99, 0.01), next(399, 99, 0.01)), (Some(399), None));
        assert_eq!(next_look(99, 99, 0.01, true, true), None);
        // With effects a log that is beyond all is off.
        let with_effects = |begun, p| next_look(begun, 99, p, false, false);
        assert_eq!((with_effects(59, 0.4), with_effects(59, 0.1)), (None, Some(99)));
        assert_eq!((with_effects(99, 0.01), with_effects(99, 0.02)), (None, Some(399)));
        // 19 can't reject, and screen.
        assert_eq!(next(19, 19, 0.05), None);
    }
}
