//! Differences of the filter's estimates between the table and exact casts.

use locsim_core::{Hits, Particles, RangeMap, SensorModel};
use locsim_mcl::StepInput;
use serde::Serialize;

use super::Workload;
use super::measure::placed_filter;
use super::replay::{TRACKING_PARTICLES, filter_options, known_start, replays};
use crate::BenchError;
use locsim_report::statistics::quantile;

/// Seeds of the replays that are run with exact casts, which are slow.
const SEEDS: u64 = 2;

/// Size of a set of differences.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Differences {
    /// Mean of the absolute values.
    pub mean: f64,
    /// 99 % are at most this.
    pub p99: f64,
    /// The greatest.
    pub max: f64,
}

impl Differences {
    fn of(differences: impl Iterator<Item = f64>) -> Self {
        let mut sizes: Vec<f64> = differences.map(f64::abs).collect();
        sizes.sort_by(f64::total_cmp);
        let mean = sizes.iter().sum::<f64>() / sizes.len() as f64;
        Self { mean, p99: quantile(&sizes, 0.99), max: sizes.last().copied().unwrap_or(f64::NAN) }
    }
}

/// The table's answers less the exact ones.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Accuracy {
    /// Of nominal ranges, cut at the sensor's maximum \[m\], over all particles and beams of the timed update.
    pub range_m: Differences,
    /// Of a scan's log likelihood (nats), over all particles, less the mean difference, which weights don't show.
    pub log_likelihood: Differences,
    /// Of the error of a replay, same seed \[m\]: static and dynamic.
    pub ate_m: Differences,
}

/// Compares table and exact casts.
pub fn compare(
    workload: &Workload,
    exact: &dyn RangeMap,
    exact_model: &dyn SensorModel,
    table: &dyn RangeMap,
    prepared: &dyn SensorModel,
) -> Result<Accuracy, BenchError> {
    let mut ate_m = Vec::new();
    for drive in [&workload.static_world, &workload.dynamic_world] {
        let options = filter_options(workload.alpha, TRACKING_PARTICLES)?;
        let exact = replays(drive, &options, &known_start(drive), exact, exact_model, SEEDS)?;
        let table = replays(drive, &options, &known_start(drive), table, prepared, SEEDS)?;
        ate_m.extend(table.iter().zip(&exact).map(|(table, exact)| table.ate_m - exact.ate_m));
    }
    Ok(Accuracy {
        range_m: ranges(workload, exact, table),
        log_likelihood: log_likelihoods(workload, exact, exact_model, table, prepared)?,
        ate_m: Differences::of(ate_m.into_iter()),
    })
}

fn ranges(workload: &Workload, exact: &dyn RangeMap, table: &dyn RangeMap) -> Differences {
    let laser = &workload.laser;
    let poses: Particles =
        workload.particles.iter().map(|pose| pose.compose(&laser.base_from_laser())).collect();
    let [exact, table] = [exact, table].map(|map| {
        let mut hits = Hits::default();
        map.cast(poses.as_poses(), laser.bearings(), laser.cast_range(), &mut hits);
        hits.range
    });
    let seen = |range: f32| f64::from(range.min(laser.max_range()));
    Differences::of(table.into_iter().zip(exact).map(|(table, exact)| seen(table) - seen(exact)))
}

fn log_likelihoods(
    workload: &Workload,
    exact: &dyn RangeMap,
    exact_model: &dyn SensorModel,
    table: &dyn RangeMap,
    prepared: &dyn SensorModel,
) -> Result<Differences, BenchError> {
    let of = |map, model| -> Result<Vec<f64>, BenchError> {
        let mut filter = placed_filter(workload, workload.particles.clone(), false, map)?;
        let input = StepInput { odometry: workload.increment, laser: &workload.laser, scan: &workload.scan };
        filter.step(&input, map, model)?;
        Ok(filter.log_likelihood().to_vec())
    };
    let (exact, table) = (of(exact, exact_model)?, of(table, prepared)?);
    let differences: Vec<f64> = table.into_iter().zip(exact).map(|(table, exact)| table - exact).collect();
    let mean = differences.iter().sum::<f64>() / differences.len() as f64;
    Ok(Differences::of(differences.into_iter().map(|difference| difference - mean)))
}
