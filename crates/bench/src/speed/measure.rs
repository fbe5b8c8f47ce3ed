//! Times the parts of a filter step on the workload's particles and scan.

use std::hint::black_box;
use std::sync::Arc;

use locsim_core::{Draw, Hits, Particles, Pose2, RangeMap, SensorModel, Stage, Weights};
use locsim_mcl::{
    Filter, FilterOptions, MotionModel, OdometryMotion, ResampleTrigger, Resampler, Spread, Start, StepInput,
    Systematic, weighted_mean,
};

use super::Workload;
use super::replay::filter_options;
use super::timing::{Timing, time};
use crate::BenchError;
use locsim_core::Clock;

/// Poses that are cast in one call: as many as the filter casts.
const CAST_POSES: usize = 128;

/// Puts the particles at given poses, so that each timed step begins alike; then, perhaps, moves them.
#[derive(Debug)]
struct Placed {
    particles: Particles,
    then: Option<OdometryMotion>,
}

impl MotionModel for Placed {
    fn propagate(&self, increment: &Pose2, draw: &Draw, particles: &mut Particles) {
        particles.x.copy_from_slice(&self.particles.x);
        particles.y.copy_from_slice(&self.particles.y);
        particles.theta.copy_from_slice(&self.particles.theta);
        if let Some(motion) = &self.then {
            motion.propagate(increment, draw, particles);
        }
    }
}

/// A filter whose every step weighs the given particles; with `whole`, it also moves and resamples them.
pub fn placed_filter(
    workload: &Workload,
    particles: Particles,
    whole: bool,
    map: &dyn RangeMap,
) -> Result<Filter, BenchError> {
    let then = whole.then(|| OdometryMotion::new(workload.alpha)).transpose()?;
    let count = particles.len();
    let options = FilterOptions {
        motion: Arc::new(Placed { particles, then }),
        trigger: if whole { ResampleTrigger::EachStep } else { ResampleTrigger::EffectiveShareBelow(0.0) },
        ..filter_options(workload.alpha, count)?
    };
    let start = Start::Tracking { pose: workload.truth, spread: Spread { sigma_m: 0.0, sigma_rad: 0.0 } };
    Ok(Filter::new(options, &start, map, 1)?)
}

/// Time of a filter step, per step.
fn step(
    clock: Clock<'_>,
    workload: &Workload,
    mut filter: Filter,
    map: &dyn RangeMap,
    model: &dyn SensorModel,
) -> Result<Timing, BenchError> {
    let input = StepInput { odometry: workload.increment, laser: &workload.laser, scan: &workload.scan };
    let mut failed = None;
    let timing = time(clock, 1, || {
        if let Err(error) = filter.step(&input, map, model) {
            failed = Some(error);
        }
    });
    failed.map_or(Ok(timing), |error| Err(error.into()))
}

/// Time of a sensor update per particle and beam: casts, densities, weights and the estimate from them, without moving
/// or resampling.
pub fn update(
    clock: Clock<'_>,
    workload: &Workload,
    map: &dyn RangeMap,
    model: &dyn SensorModel,
) -> Result<Timing, BenchError> {
    let filter = placed_filter(workload, workload.particles.clone(), false, map)?;
    let units = workload.particles.len() * workload.laser.beam_count();
    Ok(step(clock, workload, filter, map, model)?.per(units))
}

/// Time of a whole step: predict, update, estimate, resample.
pub fn whole_step(
    clock: Clock<'_>,
    workload: &Workload,
    map: &dyn RangeMap,
    model: &dyn SensorModel,
) -> Result<Timing, BenchError> {
    step(clock, workload, placed_filter(workload, workload.particles.clone(), true, map)?, map, model)
}

/// Time of a ray cast, as far as the filter casts.
pub fn raycast(clock: Clock<'_>, workload: &Workload, map: &dyn RangeMap) -> Timing {
    let (laser, n) = (&workload.laser, workload.particles.len());
    let poses: Particles =
        workload.particles.iter().map(|pose| pose.compose(&laser.base_from_laser())).collect();
    let mut hits = Hits::default();
    time(clock, n * laser.beam_count(), || {
        for start in (0..n).step_by(CAST_POSES) {
            let poses = poses.as_poses().slice(start, (start + CAST_POSES).min(n));
            map.cast(poses, laser.bearings(), laser.cast_range(), &mut hits);
            black_box(&hits);
        }
    })
}

/// Time to move a particle by the odometry motion model.
pub fn predict(clock: Clock<'_>, workload: &Workload) -> Result<Timing, BenchError> {
    let motion = OdometryMotion::new(workload.alpha)?;
    let mut particles = workload.particles.clone();
    let mut step = 0;
    Ok(time(clock, particles.len(), || {
        motion.propagate(&workload.increment, &Draw::new(1, Stage::Motion, step), &mut particles);
        step += 1;
    }))
}

/// `n` particles about the workload's true pose, with weights such as its scan gives.
fn cloud(workload: &Workload, n: usize) -> (Particles, Weights) {
    let count = workload.particles.len();
    let particles: Particles = (0..n).map(|i| workload.particles.get(i % count)).collect();
    let mut weights = Weights::uniform(n);
    let near = |pose: Pose2| -> f64 {
        let off = (pose.position() - workload.truth.position()) / workload.spread.0.max(1e-3);
        -2.0 * off.length_squared()
    };
    let log_likelihood: Vec<f64> = particles.iter().map(near).collect();
    weights.update(&log_likelihood).expect("one finite log likelihood per particle");
    (particles, weights)
}

/// Time of systematic resampling per particle: ancestors, and their poses gathered.
pub fn resample(clock: Clock<'_>, workload: &Workload, n: usize) -> Timing {
    let (particles, weights) = cloud(workload, n);
    let (mut ancestors, mut next) = (Vec::new(), Particles::default());
    let mut step = 0;
    time(clock, n, || {
        Systematic.ancestors(&weights, n, &Draw::new(1, Stage::Resample, step), &mut ancestors);
        next.gather(&particles, &ancestors);
        step += 1;
    })
}

/// Time of the weighted mean and covariance, per particle.
pub fn estimate(clock: Clock<'_>, workload: &Workload) -> Timing {
    let (particles, weights) = cloud(workload, workload.particles.len());
    time(clock, particles.len(), || {
        black_box(weighted_mean(black_box(&particles), &weights));
    })
}

/// Resident memory \[bytes\] that a filter adds to the program for each million of its particles, once it has taken two
/// steps; `None` where the system doesn't tell (`/proc/self/statm` of Linux).
pub fn bytes_per_million_particles(
    workload: &Workload,
    map: &dyn RangeMap,
    model: &dyn SensorModel,
) -> Result<Option<f64>, BenchError> {
    /// So many that an allocator has nothing of that size lying about.
    const PARTICLES: usize = 10_000_000;
    const PAGE_BYTES: f64 = 4096.0;
    let resident = || -> Option<f64> {
        let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
        Some(PAGE_BYTES * statm.split_whitespace().nth(1)?.parse::<f64>().ok()?)
    };
    let before = resident();
    let start = Start::Tracking {
        pose: workload.truth,
        spread: Spread { sigma_m: workload.spread.0, sigma_rad: workload.spread.1 },
    };
    let options =
        FilterOptions { trigger: ResampleTrigger::EachStep, ..filter_options(workload.alpha, PARTICLES)? };
    let mut filter = Filter::new(options, &start, map, 1)?;
    let input = StepInput { odometry: workload.increment, laser: &workload.laser, scan: &workload.scan };
    for _ in 0..2 {
        filter.step(&input, map, model)?;
    }
    Ok(resident().zip(before).map(|(after, before)| (after - before) * 1e6 / PARTICLES as f64))
}
