//! Errors of the reference poses as effects of the laser's pose and time look like them.
//!
//! A displaced laser, a turned one and a late stamp all move whole scans, each in its own pattern over the drive.

use glam::DVec3;
use locsim_core::{PoseError, PoseInformation, Recorded, smooth_pose_errors, without_patterns};
use locsim_world::effect::{Direction, EffectKind, PoseState, Statistic};

use crate::catalogue::{shown_by, values_along};

/// A pattern that errors of the reference poses may follow.
pub struct PosePattern {
    /// The effect that looks like it.
    pub kind: EffectKind,
    /// The direction of that effect's values.
    pub direction: Direction,
    error: fn(&PoseState, &[f64]) -> [f64; 3],
}

impl PosePattern {
    /// All patterns, in the catalogue's order.
    pub fn all() -> Vec<Self> {
        let patterns = shown_by(|statistic| match statistic {
            Statistic::Pose { pattern, directions } => Some((*pattern, *directions)),
            _ => None,
        });
        patterns
            .flat_map(|(kind, (error, directions))| {
                directions.iter().map(move |direction| Self { kind, direction, error })
            })
            .collect()
    }

    /// Errors of each pose of a log in all patterns; see [`PosePattern::over`].
    pub fn all_over(recorded: &Recorded) -> Vec<Vec<DVec3>> {
        Self::all().iter().map(|pattern| pattern.over(recorded)).collect()
    }

    /// Error of each pose of a log \[m, m, rad\] in the map frame, up to a factor.
    pub fn over(&self, recorded: &Recorded) -> Vec<DVec3> {
        let values = values_along(self.kind, self.direction);
        let mount = recorded.laser.base_from_laser().position();
        let robots = recorded.track.poses().iter().zip(recorded.velocities());
        robots
            .map(|(pose, velocity)| PoseState { heading: pose.theta, velocity, mount })
            .map(|robot| DVec3::from_array((self.error)(&robot, &values)))
            .collect()
    }
}

/// Errors of a log's poses that scans tell, but for what looks like an effect: that is left to the effect.
pub fn errors_beyond_patterns(
    process: &PoseError,
    recorded: &Recorded,
    scans: &[PoseInformation],
) -> Vec<DVec3> {
    let rest = without_patterns(scans, &PosePattern::all_over(recorded));
    smooth_pose_errors(process, recorded.track.secs(), &rest).mean
}
