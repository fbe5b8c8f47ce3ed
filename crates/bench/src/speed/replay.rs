//! How well a filter localizes on the recorded drives.

use std::sync::Arc;

use locsim_core::{Drive, Pose2, RangeMap, SensorModel, wrap_angle};
use locsim_mcl::{
    Filter, FilterOptions, OdometryMotion, ParticleCount, ResampleTrigger, Spread, Start, StepInput,
    Systematic,
};
use rayon::prelude::*;
use serde::Serialize;

use crate::BenchError;
use locsim_report::statistics::quantile;

/// Filter seeds of each replay: 1, 2, ..
pub const SEEDS: u64 = 10;

/// Particles of a replay with a known start.
pub const TRACKING_PARTICLES: usize = 500;

/// Particles of a replay with an unknown start.
pub const GLOBAL_PARTICLES: usize = 5000;

/// A robot is localized whose last estimate is within this distance \[m\] and angle \[rad\] of the truth.
pub const LOCALIZED: (f64, f64) = (0.5, 20.0 * std::f64::consts::PI / 180.0);

/// How a filter did on one drive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Replay {
    /// Root mean square over all steps of the distance between weighted mean and truth \[m\], not aligned.
    pub ate_m: f64,
    /// Distance at the last step \[m\].
    pub last_m: f64,
    /// Heading error at the last step \[rad\].
    pub last_rad: f64,
}

impl Replay {
    /// Whether the last estimate is where the robot is ([`LOCALIZED`]).
    pub fn localized(&self) -> bool {
        self.last_m < LOCALIZED.0 && self.last_rad.abs() < LOCALIZED.1
    }
}

/// The filter of the replays: odometry motion with the workload's noise, systematic resampling when the effective
/// sample size is below half of the particles.
pub fn filter_options(alpha: [f64; 4], particles: usize) -> Result<FilterOptions, BenchError> {
    Ok(FilterOptions {
        particles: ParticleCount::Fixed(particles),
        motion: Arc::new(OdometryMotion::new(alpha)?),
        resampler: Arc::new(Systematic),
        trigger: ResampleTrigger::EffectiveShareBelow(0.5),
        injection: None,
        regularization: None,
        update: None,
        least_effective_share: None,
        clusters: None,
        annealing: None,
        ancestry: false,
    })
}

/// Runs one filter over a drive.
pub fn replay(
    drive: &Drive,
    options: FilterOptions,
    start: &Start,
    map: &dyn RangeMap,
    model: &dyn SensorModel,
    seed: u64,
) -> Result<Replay, BenchError> {
    let mut filter = Filter::new(options, start, map, seed)?;
    let mut squares = 0.0;
    let mut last = (0.0, 0.0);
    for (i, step) in drive.steps.iter().enumerate() {
        let input =
            StepInput { odometry: drive.odometry_increment(i), laser: &drive.laser, scan: &step.scan };
        let estimate = filter.step(&input, map, model)?.estimates.weighted_mean.pose;
        let truth = truth(drive, i);
        let distance = estimate.position().distance(truth.position());
        squares += distance * distance;
        last = (distance, wrap_angle(estimate.theta - truth.theta));
    }
    let ate_m = (squares / drive.steps.len() as f64).sqrt();
    Ok(Replay { ate_m, last_m: last.0, last_rad: last.1 })
}

/// The true pose at a step; every step of a workload has one.
pub fn truth(drive: &Drive, step: usize) -> Pose2 {
    drive.steps[step].reference.unwrap_or(Pose2::IDENTITY)
}

/// Median and greatest error of all seeds, and how many localized.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReplayErrors {
    /// Median over seeds of [`Replay::ate_m`] \[m\].
    pub median: f64,
    /// Its greatest \[m\].
    pub max: f64,
    /// Number of seeds that ended localized, of [`SEEDS`].
    pub localized: usize,
}

impl ReplayErrors {
    /// Of at least one replay.
    pub fn of(replays: &[Replay]) -> Self {
        let mut errors: Vec<f64> = replays.iter().map(|replay| replay.ate_m).collect();
        errors.sort_by(f64::total_cmp);
        Self {
            median: quantile(&errors, 0.5),
            max: errors.last().copied().unwrap_or(f64::NAN),
            localized: replays.iter().filter(|replay| replay.localized()).count(),
        }
    }
}

/// The same drive under every seed, in parallel.
pub fn replays(
    drive: &Drive,
    options: &FilterOptions,
    start: &Start,
    map: &dyn RangeMap,
    model: &dyn SensorModel,
    seeds: u64,
) -> Result<Vec<Replay>, BenchError> {
    (1..=seeds).into_par_iter().map(|seed| replay(drive, options.clone(), start, map, model, seed)).collect()
}

/// A start that is known exactly.
pub fn known_start(drive: &Drive) -> Start {
    Start::Tracking { pose: truth(drive, 0), spread: Spread { sigma_m: 0.0, sigma_rad: 0.0 } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn localized_is_near_in_place_and_in_heading() {
        let at = |last_m, degrees: f64| Replay { ate_m: 1.0, last_m, last_rad: degrees.to_radians() };
        assert!(at(0.49, -19.0).localized());
        assert!(!at(0.51, 0.0).localized(), "half a metre off");
        assert!(!at(0.0, 180.0).localized(), "the mirrored pose");
    }

    #[test]
    fn errors_of_seeds_have_a_median_and_a_greatest() {
        let replay = |ate_m, last_m| Replay { ate_m, last_m, last_rad: 0.0 };
        let errors = ReplayErrors::of(&[replay(0.3, 0.1), replay(0.1, 0.1), replay(0.2, 2.0)]);
        assert_eq!(errors, ReplayErrors { median: 0.2, max: 0.3, localized: 2 });
    }
}
