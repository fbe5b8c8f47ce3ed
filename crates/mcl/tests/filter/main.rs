//! The whole filter in a toy room: against an exact histogram filter, on its promises, and over thread counts.

use std::sync::Arc;

use locsim_core::{Draw, Hits, Laser, Particles, Pose2, RangeMap, Scan, SensorModel, Stage};
use locsim_mcl::{FilterOptions, OdometryMotion, ParticleCount, ResampleTrigger, Systematic};
use toy::Gaussian;

mod annealing;
mod behaviour;
mod exact;
mod threads;
#[path = "../toy/mod.rs"]
mod toy;

/// A laser on the base with `beams` beams all around and a range that the room never exceeds.
fn laser(beams: usize) -> Laser {
    let bearings = (0..beams).map(|i| (i as f32 * 360.0 / beams as f32).to_radians()).collect();
    Laser::new(bearings, vec![0.0; beams], 0.0, 50.0, Pose2::IDENTITY).unwrap()
}

/// A scan of `laser` at `base` in `room`, drawn from `model` for time step `step`.
fn scan(room: &dyn RangeMap, laser: &Laser, model: &Gaussian, base: Pose2, step: u32) -> Scan {
    let pose: Particles = [base.compose(&laser.base_from_laser())].into_iter().collect();
    let mut hits = Hits::default();
    room.cast(pose.as_poses(), laser.bearings(), laser.max_range(), &mut hits);
    let mut ranges = vec![0.0; laser.beam_count()];
    let beams = hits.beams(pose.as_poses(), laser.bearings(), laser.max_range());
    model.sample(&beams, &Draw::new(99, Stage::Laser, step), &mut ranges);
    Scan { ranges }
}

/// A plain filter of `n` particles; each test changes the options it is about.
fn options(n: usize) -> FilterOptions {
    FilterOptions {
        particles: ParticleCount::Fixed(n),
        motion: Arc::new(OdometryMotion::new([0.02; 4]).unwrap()),
        resampler: Arc::new(Systematic),
        trigger: ResampleTrigger::EachStep,
        injection: None,
        regularization: None,
        update: None,
        least_effective_share: None,
        clusters: None,
        annealing: None,
        ancestry: false,
    }
}
