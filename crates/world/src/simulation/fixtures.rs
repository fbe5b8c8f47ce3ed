//! Fixtures for the simulator's tests.

use std::f64::consts::TAU;
use std::sync::Arc;

use locsim_core::Pose2;

use super::{BlockOptions, BlockResampling, LaserOptions};
use crate::map::{Geometry, Polyline, VectorMap};
use crate::raycast::ExactRangeMap;

/// Two-sided quantile of the standard normal distribution at a false-alarm probability of 1e-6.
pub(crate) const Z_1E6: f64 = 4.892;

/// A room of 6 m x 4 m with a corner at the origin: 20 m of wall.
pub(crate) fn room() -> Geometry {
    let outline =
        Polyline { points_m: vec![[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]], ..Polyline::default() };
    VectorMap { outline, obstacles: vec![], walls: vec![] }.to_geometry().unwrap()
}

pub(crate) fn room_map() -> Arc<ExactRangeMap> {
    Arc::new(ExactRangeMap::new(room()))
}

/// On average 20 blocks in the room.
pub(crate) fn block_options() -> BlockOptions {
    BlockOptions {
        per_metre_of_wall: 1.0,
        length_m: [0.2, 0.6],
        width_m: [0.1, 0.4],
        yaw_rad: [-0.5, 0.5],
        wall_distance_m: [0.05, 0.5],
        resample: BlockResampling::EachObservation,
        speed_m_s: [0.0, 0.0],
        clearance_m: 0.35,
    }
}

/// 36 beams without noise or quantization, beyond the room's walls.
pub(crate) const fn laser_options() -> LaserOptions {
    LaserOptions {
        rate_hz: 5.0,
        beams: 36,
        field_of_view_rad: TAU,
        first_bearing_rad: None,
        min_range_m: 0.0,
        max_range_m: 8.0,
        resolution_m: 0.0,
        sigma_m: 0.0,
        sigma_per_m: 0.0,
        mount: Pose2::IDENTITY,
        scan_secs: 0.0,
    }
}

/// Runs `work` on a pool of `threads` threads.
pub(crate) fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

/// Mean and variance of a sample.
pub(crate) fn moments(sample: &[f64]) -> (f64, f64) {
    let n = sample.len() as f64;
    let mean = sample.iter().sum::<f64>() / n;
    (mean, sample.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0))
}

/// Whether a sample of a normal distribution agrees with `mean` and `variance`, each at a false-alarm
/// probability of 1e-6: the mean's standard error is sigma / sqrt(n), the variance's is variance * sqrt(2 /
/// n).
pub(crate) fn is_normal_sample(sample: &[f64], mean: f64, variance: f64) -> bool {
    let n = sample.len() as f64;
    let (sample_mean, sample_variance) = moments(sample);
    (sample_mean - mean).abs() < Z_1E6 * (variance / n).sqrt()
        && (sample_variance - variance).abs() < Z_1E6 * variance * (2.0 / n).sqrt()
}
