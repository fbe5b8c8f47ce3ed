//! A reference in a frame that is turned against the map's.

use super::{Covariate, Deviation, Family, Halves, Readings, Statistic};

/// The errors of the reference's poses that a turn of all of them makes, over those that it leaves: the root of their squares' ratio. Errors that
/// come and go are a turn by chance only, and those that last leave much, where a turn leaves nothing.
pub(super) struct Frame;

/// A greater share is as good as all.
const MOST_SHARE: f64 = 1.0 - 1e-6;

impl Family for Frame {
    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic::of_misalignment(Covariate::Everywhere, Deviation::Frame)]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let error = &log.fitted.nuisances.pose_error;
        let frame = error.turned_frame(&log.comparison.recorded.track, &log.fitted.corrections);
        let share = if log.has_pose_errors { frame.share_of_turn } else { 0.0 };
        let share = share.min(MOST_SHARE);
        // A turn is of the log as a whole.
        vec![[0.5 * (share / (1.0 - share)).sqrt().copysign(frame.turn); 2]]
    }
}
