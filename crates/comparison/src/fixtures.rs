//! A small world and a drive through it, for tests.

use std::f64::consts::TAU;
use std::sync::{Arc, LazyLock};

use locsim_core::{Drive, Pose2, Track};
use locsim_world::effect::{Effect, EffectKind, Effects};
use locsim_world::map::{MeasuredMap, MeasuredWall, NamedEdges, Polyline, VectorMap, Wall};
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::{
    BlockOptions, BlockResampling, LaserOptions, OdometryNoise, Robot, RobotPath, simulate_drive,
};

use crate::Nominal;
use crate::hidden::Regime;

/// Standard deviation of the laser's noise \[m\].
pub const SIGMA_M: f64 = 0.01;
/// Its maximum range \[m\].
pub const MAX_M: f64 = 5.0;
/// Seed of the drive.
pub const SEED: u64 = 5;
/// The room's corners \[m\], its inside on the left.
const CORNERS: [[f64; 2]; 8] =
    [[0.0, 0.0], [2.0, 0.0], [2.0, -0.4], [3.0, -0.4], [3.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]];
/// A room with a door recess and a thin wall that hides part of the east end, some blocks and dropouts.
pub static NOMINAL: LazyLock<Nominal> = LazyLock::new(|| {
    let outline = Polyline {
        points_m: CORNERS.to_vec(),
        surfaces: vec![NamedEdges { name: "door".to_owned(), edges: vec![2] }],
        ..Polyline::default()
    };
    let screen = Wall { name: "screen".to_owned(), from_m: [5.0, 1.0], to_m: [5.0, 2.0] };
    let map = VectorMap { outline, obstacles: Vec::new(), walls: vec![screen] };
    let map = Arc::new(ExactRangeMap::new(map.to_geometry().unwrap()));
    let laser = LaserOptions {
        rate_hz: 10.0,
        beams: 72,
        field_of_view_rad: TAU,
        first_bearing_rad: None,
        min_range_m: 0.05,
        max_range_m: MAX_M,
        resolution_m: 0.001,
        sigma_m: SIGMA_M,
        sigma_per_m: 0.0,
        mount: Pose2::new(0.1, 0.0, 0.0),
        scan_secs: 0.0,
    };
    let blocks = BlockOptions {
        per_metre_of_wall: 0.3,
        length_m: [0.15, 0.35],
        width_m: [0.1, 0.25],
        yaw_rad: [-0.5, 0.5],
        wall_distance_m: [0.1, 0.3],
        resample: BlockResampling::EachObservation,
        speed_m_s: [0.0; 2],
        clearance_m: 0.35,
    };
    let dropout = Effect::new(EffectKind::RangeDropout, vec![0.02, 0.0], vec![]).unwrap();
    let odometry = OdometryNoise::new([0.02, 0.005, 0.01, 0.005]).unwrap();
    let effects = Effects::new(vec![dropout]).unwrap();
    Nominal::new(map, laser, Some(blocks), odometry, effects).unwrap()
});
/// The same room by a measured map, whose walls are known to 5 mm.
pub static MEASURED: LazyLock<Nominal> = LazyLock::new(|| {
    let wall = |from_m, to_m| MeasuredWall { from_m, to_m, sigma_m: 0.005, hits: 1000, hit_share: 1.0 };
    let next = CORNERS.iter().cycle().skip(1);
    let mut walls: Vec<MeasuredWall> = CORNERS.iter().zip(next).map(|(a, b)| wall(*a, *b)).collect();
    walls.extend([wall([5.0, 1.0], [5.0, 2.0]), wall([5.0, 2.0], [5.0, 1.0])]);
    let seen = vec![vec![[-0.3, -0.7], [6.3, -0.7], [6.3, 4.3], [-0.3, 4.3]]];
    let map = Arc::new(ExactRangeMap::new(MeasuredMap { seen, walls }.to_geometry().unwrap()));
    Nominal::new(map, NOMINAL.laser, NOMINAL.blocks, NOMINAL.odometry, NOMINAL.effects.clone()).unwrap()
});
/// A drive through the room.
pub static DRIVE: LazyLock<Drive> = LazyLock::new(|| {
    let path = RobotPath::Waypoints {
        points_m: vec![[1.0, 1.0], [4.2, 1.2], [4.0, 3.0], [1.2, 2.6]],
        speed_m_s: 0.6,
        turn_rate_rad_s: 0.8,
    };
    let robot = Robot { path, start_jitter_m: 0.0, odometry_noise: NOMINAL.odometry };
    let simulator = Regime::default().simulator(&NOMINAL, &NOMINAL.effects).unwrap();
    simulate_drive(&simulator, &robot, SEED).unwrap().drive
});
/// Its true poses.
pub static TRUTH: LazyLock<Track> = LazyLock::new(|| DRIVE.reference().unwrap());
