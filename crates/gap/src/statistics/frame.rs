//! A reference in a frame that is turned or shifted against the map's.

use super::{Covariate, Deviation, Family, Halves, Readings, Statistic};

/// The errors of the reference's poses that a turn of all of them makes, over those that it leaves: the root of their squares' ratio; the same of
/// a shift. Errors that come and go are a turn or a shift by chance only, and those that last leave much, where a frame leaves nothing.
pub(super) struct Frame;

/// A greater share is as good as all.
const MOST_SHARE: f64 = 1.0 - 1e-6;

impl Family for Frame {
    fn statistics(&self) -> Vec<Statistic> {
        let of = |deviation| Statistic::of_misalignment(Covariate::Everywhere, deviation);
        [Deviation::FrameTurn, Deviation::FrameShift].map(of).to_vec()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let error = &log.fitted.nuisances.pose_error;
        let frame = error.turned_frame(&log.comparison.recorded.track, &log.fitted.corrections);
        let ratio = |share: f64| {
            let share = if log.has_pose_errors { share.min(MOST_SHARE) } else { 0.0 };
            // A frame is of the log as a whole.
            0.5 * (share / (1.0 - share)).sqrt()
        };
        vec![[ratio(frame.share_of_turn).copysign(frame.turn); 2], [ratio(frame.share_of_shift); 2]]
    }
}
