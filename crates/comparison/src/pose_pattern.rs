//! Errors of the reference poses as effects of the laser's pose and time look like them.
//!
//! A displaced laser, a turned one and a late stamp all move whole scans, each in its own pattern over the drive.

use glam::DVec3;
use locsim_core::{PoseError, PoseInformation, Recorded, smooth_pose_errors, without_patterns};
use locsim_world::effect::{Direction, EffectKind, PoseState, Statistic};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

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

/// Errors of each pose of a log in all patterns, drawn as large in each as the process is, or as [`MOST_M`] and [`MOST_RAD`]: a reference whose
/// errors come and go by so much is off by about as much all along, which its fit can't tell from a displaced laser or a late stamp. None where
/// the reference is exact.
pub fn errors_in_patterns(process: &PoseError, recorded: &Recorded, rng: &mut impl Rng) -> Vec<DVec3> {
    let mut errors = vec![DVec3::ZERO; recorded.scans()];
    if process.is_none() {
        return errors;
    }
    let PoseError { sigma_m, sigma_rad, .. } = *process;
    let sigma_m = sigma_m.min(MOST_M);
    let sigmas = DVec3::new(sigma_m, sigma_m, sigma_rad.min(MOST_RAD)).max(DVec3::splat(LEAST_SIGMA));
    for pattern in PosePattern::all_over(recorded) {
        let squares = pattern.iter().map(|error| (*error / sigmas).length_squared()).sum::<f64>();
        let normal: f64 = StandardNormal.sample(rng);
        let factor = normal * (errors.len() as f64 / squares.max(f64::MIN_POSITIVE)).sqrt();
        errors.iter_mut().zip(&pattern).for_each(|(error, one)| *error += factor * *one);
    }
    errors
}

/// A process that was fitted to a log with a strong effect has a part of that in it. No reference that is worth its name is off all along by more
/// than these \[m, rad\]: a centimetre and 0.15 degrees.
const MOST_M: f64 = 0.01;
const MOST_RAD: f64 = 0.0026;
/// The least standard deviation of a process \[m, rad\].
const LEAST_SIGMA: f64 = 1e-6;

/// Errors of a log's poses that scans tell, but for what looks like an effect: that is left to the effect.
pub fn errors_beyond_patterns(
    process: &PoseError,
    recorded: &Recorded,
    scans: &[PoseInformation],
) -> Vec<DVec3> {
    let rest = without_patterns(scans, &PosePattern::all_over(recorded));
    smooth_pose_errors(process, recorded.track.secs(), &rest).mean
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Stage};

    use super::*;
    use crate::fixtures::DRIVE;

    /// The mean square of errors in independent patterns, each as large as the process, is their number. Of 4,000 draws the mean is off by
    /// more than 0.3 with a probability below 1e-6; with errors of an exact reference it is 0.
    #[test]
    fn errors_in_each_pattern_are_as_large_as_the_process() {
        let recorded = Recorded::new(&DRIVE, 100, 24, |_| true).unwrap();
        let process =
            PoseError { sigma_m: 0.008, sigma_rad: 0.002, correlation_secs: 2.0, ..PoseError::NONE };
        let sigmas = DVec3::new(0.008, 0.008, 0.002);
        let mean_square = |process: &PoseError| {
            let draws = 4000;
            let of_draw = |i: u32| {
                let errors =
                    errors_in_patterns(process, &recorded, &mut Draw::new(3, Stage::Path, i).item(0));
                let squares = errors.iter().map(|error| (*error / sigmas).length_squared());
                squares.sum::<f64>() / errors.len() as f64
            };
            (0..draws).map(of_draw).sum::<f64>() / f64::from(draws)
        };
        let expected = PosePattern::all().len() as f64;
        assert!((mean_square(&process) - expected).abs() < 0.3, "{} {expected}", mean_square(&process));
        assert_eq!(mean_square(&PoseError::NONE), 0.0);
    }
}
