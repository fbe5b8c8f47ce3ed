//! Errors of the reference poses as effects of the laser's pose and time look like them.
//!
//! A displaced laser, a turned one and a late stamp all move whole scans, each in its own pattern over the drive.

use distreg::matrix::invert;
use glam::DVec3;
use locsim_core::{PoseError, PoseInformation, smooth_pose_errors};
use locsim_world::effect::{Direction, EffectKind, PoseState, Statistic};

use crate::Recorded;
use crate::catalogue::{shown_by, values_along};

/// A pattern that errors of the reference poses may follow.
pub(crate) struct PosePattern {
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
pub(crate) fn errors_beyond_patterns(
    process: &PoseError,
    recorded: &Recorded,
    scans: &[PoseInformation],
) -> Vec<DVec3> {
    let rest = without_patterns(scans, &PosePattern::all_over(recorded));
    smooth_pose_errors(process, recorded.track.secs(), &rest).mean
}

/// Data of scans after the least-squares fit of the patterns is subtracted.
pub(crate) fn without_patterns(scans: &[PoseInformation], patterns: &[Vec<DVec3>]) -> Vec<PoseInformation> {
    let sum = |of: &dyn Fn(usize) -> f64| (0..scans.len()).map(of).sum::<f64>();
    let normal: Vec<Vec<f64>> = patterns
        .iter()
        .map(|a| patterns.iter().map(|b| sum(&|i| a[i].dot(scans[i].matrix * b[i]))).collect())
        .collect();
    let data: Vec<f64> = patterns.iter().map(|a| sum(&|i| a[i].dot(scans[i].vector))).collect();
    let inverse = invert(&normal);
    let numbers = inverse.iter().map(|row| row.iter().zip(&data).map(|(a, b)| a * b).sum::<f64>());
    let numbers: Vec<f64> = numbers.collect();
    let shift = |i: usize| patterns.iter().zip(&numbers).map(|(p, number)| *number * p[i]).sum::<DVec3>();
    scans
        .iter()
        .enumerate()
        .map(|(i, scan)| PoseInformation {
            matrix: scan.matrix,
            vector: scan.vector - scan.matrix * shift(i),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;

    /// Data along the patterns are subtracted to the last bit; data orthogonal to them stay.
    #[test]
    fn patterns_are_taken_off() {
        let matrix = DMat3::from_diagonal(DVec3::new(4.0, 9.0, 100.0));
        let pattern: Vec<DVec3> = (0..6).map(|i| DVec3::new(1.0, 0.5 * f64::from(i), 0.1)).collect();
        let other: Vec<DVec3> = (0..6).map(|i| DVec3::new(0.0, 0.0, f64::from(i % 2))).collect();
        let along = |i: usize| 0.03 * pattern[i] - 0.2 * other[i];
        let scans: Vec<PoseInformation> =
            (0..6).map(|i| PoseInformation { matrix, vector: matrix * along(i) }).collect();
        for rest in without_patterns(&scans, &[pattern.clone(), other.clone()]) {
            assert!(rest.vector.length() < 1e-9, "{}", rest.vector);
        }
        let rest = without_patterns(&scans, std::slice::from_ref(&pattern));
        let score: f64 = pattern.iter().zip(&rest).map(|(p, rest)| p.dot(rest.vector)).sum();
        assert!(score.abs() < 1e-9 && rest[1].vector.length() > 1.0, "{score}");
    }
}
