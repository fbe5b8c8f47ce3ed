//! A sequential Monte Carlo test: after how many replicates it may stop, because more of them could not change the answer (Besag and Clifford 1991).

/// After how many replicates is looked first. In a nominal world that is later, as the question is also what would have been seen.
#[must_use]
pub fn first_look(is_nominal: bool) -> u32 {
    if is_nominal { FIRST_LOOK } else { EARLIEST_LOOK }
}

/// To how many replicates the test goes on after `begun` of those that were asked for, with the p-value so far; `None` where they are enough.
#[must_use]
pub fn next_look(begun: u32, replicates: u32, p: f64, is_clearly_off: bool, is_nominal: bool) -> Option<u32> {
    let is_clear = match begun {
        EARLIEST_LOOK => p > NOTHING_SO_EARLY,
        _ => p > CLEARLY_NOTHING || is_clearly_off,
    };
    let may_be_nothing = is_nominal || p * f64::from(begun) > 1.0;
    let is_in_doubt = (FEWEST_TO_REJECT..ENOUGH).contains(&begun) && p <= IN_DOUBT && may_be_nothing;
    let next = [FIRST_LOOK.min(replicates), replicates, ENOUGH].into_iter().find(|look| *look > begun);
    next.filter(|look| !is_clear && (*look <= replicates || is_in_doubt))
}

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
