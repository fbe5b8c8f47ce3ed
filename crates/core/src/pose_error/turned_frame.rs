use glam::{DVec2, DVec3};

use super::process::PoseError;
use crate::{Pose2, Track};

/// A turn about the middle of all poses and a shift of them: what the errors of poses in a turned frame have in common.
#[derive(Clone, Copy, Debug)]
pub struct TurnedFrame {
    /// The middle \[m\].
    pub center: DVec2,
    /// The shift \[m\].
    pub shift: DVec2,
    /// Standard error of the shift along each axis, of errors that are as large and last as long as the process says \[m\].
    pub shift_error_m: f64,
    /// The turn \[rad\], positive counter-clockwise.
    pub turn: f64,
    /// Information of the turn \[1/rad^2\].
    pub information: f64,
    /// Share of the errors' squares, each over its variance, that turn and shift make.
    pub share: f64,
    /// Share that the turn makes of what the shift leaves.
    pub share_of_turn: f64,
    /// Share that the shift makes of what the turn leaves.
    pub share_of_shift: f64,
}

impl TurnedFrame {
    /// A pose of the turned frame, turned and shifted.
    pub fn put_right(&self, pose: &Pose2) -> Pose2 {
        let arm = pose.position() - self.center;
        let position = self.center + self.shift + DVec2::from_angle(self.turn).rotate(arm);
        Pose2::new(position.x, position.y, pose.theta + self.turn)
    }
}

impl PoseError {
    /// The turn and the shift that fit corrections of the poses of a track (x and y \[m\], heading \[rad\]) best.
    pub fn turned_frame(&self, track: &Track, corrections: &[DVec3]) -> TurnedFrame {
        let count = track.len() as f64;
        let center = track.poses().iter().map(Pose2::position).sum::<DVec2>() / count;
        let shift = corrections.iter().map(|c| c.truncate()).sum::<DVec2>() / count;
        let [of_position, of_heading] = [self.sigma_m, self.sigma_rad].map(|sigma| sigma.max(1e-6).powi(-2));
        let [mut turned, mut information, mut all] = [0.0; 3];
        for (pose, c) in track.poses().iter().zip(corrections) {
            let arm = pose.position() - center;
            turned += of_position * arm.perp_dot(c.truncate()) + of_heading * c.z;
            information += of_position * arm.length_squared() + of_heading;
            all += of_position * c.truncate().length_squared() + of_heading * c.z * c.z;
        }
        let turn = turned / information;
        let secs = track.secs().last().unwrap_or(&0.0) - track.secs().first().unwrap_or(&0.0);
        let (by_turn, by_shift) = (turn * turned, of_position * count * shift.length_squared());
        let share = |part: f64, of: f64| if of > 0.0 { part / of } else { 0.0 };
        TurnedFrame {
            center,
            shift,
            shift_error_m: self.sigma_m * self.variance_of_mean(secs / count, track.len()).sqrt(),
            turn,
            information,
            share: share(by_turn + by_shift, all),
            share_of_turn: share(by_turn, all - by_shift),
            share_of_shift: share(by_shift, all - by_turn),
        }
    }
}
