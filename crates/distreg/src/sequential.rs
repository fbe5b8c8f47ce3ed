//! A sequential Monte Carlo test: after how many replicates it may stop, because more of them could not change the answer (Besag and Clifford 1991).

/// Replicates after which the test may stop,
const FIRST_LOOK: u32 = 199;
/// if a larger share of them than this exceeds the data.
const CLEARLY_NOTHING: f64 = 0.1;
/// Where a rejection is no alarm, it may stop after this many,
const EARLIEST_LOOK: u32 = 59;
/// if a larger share of them than this exceeds the data.
const NOTHING_SO_EARLY: f64 = 0.3;
/// Where it isn't clear after as few replicates as this, the fewest that can reject at 1 %,
const FEWEST_TO_REJECT: u32 = 99;
/// and no larger a share of them than this exceeds the data, one replicate more or less would decide. Where a rejection is no alarm, data beyond all
/// of them are rejected.
const IN_DOUBT: f64 = 0.05;
/// So many are simulated then. Data are rejected by all of them or not at all, so that the rate of false alarms is theirs.
const ENOUGH: u32 = 399;

/// After how many replicates is looked first; later where a rejection would be an alarm.
#[must_use]
pub fn first_look(is_alarm: bool) -> u32 {
    if is_alarm { FIRST_LOOK } else { EARLIEST_LOOK }
}

/// To how many replicates the test goes on after `begun` of the `replicates` that were asked for; `None` where they are enough. `p` is the p-value so
/// far, `is_clearly_off` says that the data are far beyond all, and `is_alarm` that a rejection would be an alarm.
#[must_use]
pub fn next_look(begun: u32, replicates: u32, p: f64, is_clearly_off: bool, is_alarm: bool) -> Option<u32> {
    let is_clear = match begun {
        EARLIEST_LOOK => p > NOTHING_SO_EARLY,
        _ => p > CLEARLY_NOTHING || is_clearly_off,
    };
    let may_be_nothing = is_alarm || p * f64::from(begun) > 1.0;
    let is_in_doubt = (FEWEST_TO_REJECT..ENOUGH).contains(&begun) && p <= IN_DOUBT && may_be_nothing;
    let next = [FIRST_LOOK.min(replicates), replicates, ENOUGH].into_iter().find(|look| *look > begun);
    next.filter(|look| !is_clear && (*look <= replicates || is_in_doubt))
}

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
        // Where a rejection is no alarm, data beyond all are rejected.
        let without_alarm = |begun, p| next_look(begun, 99, p, false, false);
        assert_eq!((without_alarm(59, 0.4), without_alarm(59, 0.1)), (None, Some(99)));
        assert_eq!((without_alarm(99, 0.01), without_alarm(99, 0.02)), (None, Some(399)));
        // 19 can't reject, and screen.
        assert_eq!(next(19, 19, 0.05), None);
    }
}
