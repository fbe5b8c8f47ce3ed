//! Cost of a simulated ray in a corridor with on average 24 unmapped blocks, on one thread. Read the item rate: one
//! item is one ray.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use divan::Bencher;
use divan::counter::ItemsCount;
use locsim_core::{Draw, Particles, Pose2, Stage};
use locsim_world::effect::Effects;
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::{
    BlockModel, BlockOptions, BlockResampling, LaserOptions, OdometryNoise, Robot, RobotPath, Simulator,
    simulate_drive,
};
use rand::RngExt;
use rayon::{ThreadPool, ThreadPoolBuilder};

#[path = "../tests/maps_and_rays/common.rs"]
mod common;

const BLOCKS: f64 = 24.0;
/// Beams per scan.
const BEAMS: [u32; 3] = [24, 60, 360];

fn main() {
    divan::main();
}

/// The corridor with its blocks.
fn simulator(beams: u32, scan_secs: f64, resample: BlockResampling, speed_m_s: [f64; 2]) -> Simulator {
    let map = Arc::new(ExactRangeMap::new(common::corridor()));
    let blocks = BlockOptions {
        per_metre_of_wall: 1.0,
        length_m: [0.2, 0.6],
        width_m: [0.1, 0.4],
        yaw_rad: [-0.5, 0.5],
        wall_distance_m: [0.0, 0.3],
        resample,
        speed_m_s,
        clearance_m: 0.35,
    };
    let walls_m = BlockModel::new(blocks, map.geometry()).unwrap().wall_length_m();
    let blocks = BlockOptions { per_metre_of_wall: BLOCKS / walls_m, ..blocks };
    let laser = LaserOptions {
        rate_hz: 5.0,
        beams,
        field_of_view_rad: TAU,
        first_bearing_rad: None,
        min_range_m: 0.0,
        max_range_m: 4.5,
        resolution_m: 0.001,
        sigma_m: 0.02,
        sigma_per_m: 0.0,
        mount: Pose2::IDENTITY,
        scan_secs,
    };
    Simulator::new(map, Some(blocks), laser, Effects::none()).unwrap()
}

fn one_thread() -> ThreadPool {
    ThreadPoolBuilder::new().num_threads(1).build().unwrap()
}

fn drive(bencher: Bencher<'_, '_>, simulator: &Simulator) {
    let points_m = vec![[1.5, 1.8], [7.0, 2.3], [13.0, 1.7], [18.5, 2.1]];
    let robot = Robot {
        path: RobotPath::Waypoints { points_m, speed_m_s: 0.7, turn_rate_rad_s: 0.8 },
        start_jitter_m: 0.2,
        odometry_noise: OdometryNoise::default(),
    };
    let rays = simulate_drive(simulator, &robot, 1).unwrap().drive.steps.len()
        * simulator.laser().options().beams as usize;
    let pool = one_thread();
    bencher
        .counter(ItemsCount::new(rays))
        .bench_local(|| pool.install(|| simulate_drive(simulator, &robot, 1).unwrap()));
}

/// Each scan from one pose, with blocks of its own.
#[divan::bench(args = BEAMS)]
fn drive_standing_scans(bencher: Bencher<'_, '_>, beams: u32) {
    drive(bencher, &simulator(beams, 0.0, BlockResampling::EachObservation, [0.0; 2]));
}

/// Each beam from the pose at its own time, with blocks of its own.
#[divan::bench(args = BEAMS)]
fn drive_swept_scans(bencher: Bencher<'_, '_>, beams: u32) {
    drive(bencher, &simulator(beams, 0.1, BlockResampling::EachObservation, [0.0; 2]));
}

/// As swept scans, among blocks that move.
#[divan::bench(args = BEAMS)]
fn drive_moving_blocks(bencher: Bencher<'_, '_>, beams: u32) {
    drive(bencher, &simulator(beams, 0.1, BlockResampling::Never, [0.1, 0.5]));
}

/// 100 observations at each of 20 poses.
#[divan::bench(args = BEAMS)]
fn observe_many(bencher: Bencher<'_, '_>, beams: u32) {
    let simulator = simulator(beams, 0.0, BlockResampling::EachObservation, [0.0; 2]);
    let poses: Particles = (0..20)
        .map(|i| {
            let mut rng = Draw::new(1, Stage::Initial, 0).item(i);
            let (x, y) = (rng.random_range(0.5..19.5), rng.random_range(0.5..3.5));
            Pose2::new(x, y, rng.random_range(-PI..PI))
        })
        .collect();
    let pool = one_thread();
    bencher
        .counter(ItemsCount::new(20 * 100 * beams))
        .bench_local(|| pool.install(|| simulator.observe_many(poses.as_poses(), 100, 1)));
}
