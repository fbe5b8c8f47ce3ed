//! A reference in a frame that is turned against the map's.

use super::{Covariate, Deviation, Family, Halves, Readings, Statistic};

/// The correlation of the errors of the reference's poses with those that a turn of all of them makes, by Fisher's transformation. Errors that
/// come and go are a turn by chance only.
pub(super) struct Frame;

/// A greater share is as good as all.
const MOST_SHARE: f64 = 1.0 - 1e-9;

impl Family for Frame {
    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic::of_misalignment(Covariate::Everywhere, Deviation::Frame)]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let error = &log.fitted.nuisances.pose_error;
        let frame = error.turned_frame(&log.comparison.recorded.track, &log.fitted.corrections);
        let share = if log.has_pose_errors { frame.share_of_turn } else { 0.0 };
        // A turn is of the log as a whole.
        vec![[0.5 * share.min(MOST_SHARE).sqrt().atanh().copysign(frame.turn); 2]]
    }
}
