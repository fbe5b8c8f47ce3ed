//! Times of `Filter::update` on a drive that `tools/python-speed/filter_update.py` has written, with the filter that `locsim.Filter`
//! makes. Prints them as JSON, with the evidence of each scan by which the script sees that the work was the same.
//! `RAYON_NUM_THREADS` is the number of threads.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use locsim_core::{Laser, LikelihoodGrid, Pose2, Scan};
use locsim_lab::run::MapSet;
use locsim_mcl::{
    Filter, FilterOptions, OdometryMotion, ParticleCount, ResampleTrigger, Spread, Start, Systematic,
};
use locsim_scenario::{RayCast, load_map};
use locsim_sensor::{FittedModel, Prepared, Tempered};
use locsim_world::raycast::RangeTableOptions;
use serde::Deserialize;

#[derive(Deserialize)]
struct Drive {
    map: PathBuf,
    model: PathBuf,
    bearings: Vec<f32>,
    start: [f64; 3],
    increments: Vec<[f64; 3]>,
    ranges: Vec<Vec<f32>>,
    particles: usize,
    start_sigma: (f64, f64),
    alpha: [f64; 4],
    mount: [f64; 3],
    tempering: (f64, f64),
    below: f64,
    seed: u64,
}

fn pose([x, y, theta]: [f64; 3]) -> Pose2 {
    Pose2::new(x, y, theta)
}

#[expect(clippy::disallowed_methods, reason = "it measures")]
fn main() -> Result<()> {
    let file = std::env::args_os().nth(1).unwrap_or_default();
    let drive: Drive = serde_json::from_reader(File::open(Path::new(&file))?)?;
    let RangeTableOptions { cell_m, most_bytes, .. } = RangeTableOptions::default();
    let table = RayCast::Table { cell_m, memory_mb: (most_bytes >> 20) as u32 };
    let maps = MapSet::new(load_map(&drive.map)?.geometry, table, None, None, &())?;
    let fitted = FittedModel::load(&drive.model)?;
    let no_delays = vec![0.0; drive.bearings.len()];
    let laser = Laser::new(drive.bearings, no_delays, 0.0, fitted.max_range(), pose(drive.mount))?;
    let (floor, exponent) = drive.tempering;
    let tempered = Tempered::new(fitted.into_model(None)?, floor, exponent)?;
    let model = Prepared::new(Arc::new(tempered), LikelihoodGrid::for_laser(&laser), &maps.endpoints())?;
    let options = FilterOptions {
        particles: ParticleCount::Fixed(drive.particles),
        motion: Arc::new(OdometryMotion::new(drive.alpha)?),
        resampler: Arc::new(Systematic),
        trigger: ResampleTrigger::EachStep,
        injection: None,
        regularization: None,
        update: None,
        least_effective_share: None,
        clusters: None,
        annealing: None,
        ancestry: false,
    };
    let spread = Spread { sigma_m: drive.start_sigma.0, sigma_rad: drive.start_sigma.1 };
    let start = Start::Tracking { pose: pose(drive.start), spread };
    let mut filter = Filter::new(options, &start, &*maps.ranges, drive.seed)?;

    let (mut milliseconds, mut evidence) = (Vec::new(), Vec::new());
    for (increment, ranges) in drive.increments.into_iter().zip(drive.ranges) {
        let scan = Scan { ranges };
        filter.predict(&pose(increment))?;
        let before = Instant::now();
        let update = filter.update(&laser, &scan, &*maps.ranges, &model)?;
        milliseconds.push(before.elapsed().as_secs_f64() * 1e3);
        evidence.push(update.log_evidence);
        let few = filter.weights().effective_sample_size() < drive.below * drive.particles as f64;
        filter.resample(few, &*maps.ranges)?;
    }
    println!("{}", serde_json::json!({ "milliseconds": milliseconds, "evidence": evidence }));
    Ok(())
}
