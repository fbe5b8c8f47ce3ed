use glam::DVec2;
use locsim_core::{Draw, Drive, DriveStep, Pose2, Stage};
use rand::RngExt;
use rayon::prelude::*;

use super::error::{check, check_count};
use super::{Block, OdometryNoise, RobotPath, SimulationError, Simulator, Trajectory};

/// The most scans of a drive.
const MAX_SCANS: f64 = 1e6;

/// A robot that drives through the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// The path it drives.
    pub path: RobotPath,
    /// Half-width of the uniform shift of the path's start along x and along y [m], at least 0; see
    /// [`RobotPath::with_start_moved`].
    pub start_jitter_m: f64,
    /// How its odometry errs.
    pub odometry_noise: OdometryNoise,
}

/// A recorded drive and what only the simulator knows.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedDrive {
    /// Scans, odometry (starting at the origin of `odom`) and true poses as reference, from the start of the path at
    /// 0 s to its end.
    pub drive: Drive,
    /// The blocks that stood around the robot at the stamp of each scan.
    pub blocks: Vec<Vec<Block>>,
}

/// Drives `robot` through the world, taking scans at the laser's rate.
///
/// The odometry reads the motion between two scans as one increment.
///
/// # Errors
/// As [`Trajectory::new`]; a negative jitter; more than a million scans; a scan outside the map's free space.
pub fn simulate_drive(
    simulator: &Simulator,
    robot: &Robot,
    seed: u64,
) -> Result<SimulatedDrive, SimulationError> {
    let jitter = check("start jitter [m]", robot.start_jitter_m, "at least 0", |jitter| jitter >= 0.0)?;
    let mut rng = Draw::new(seed, Stage::Path, 0).item(0);
    let offset = jitter * (2.0 * DVec2::new(rng.random(), rng.random()) - DVec2::ONE);
    let trajectory = Trajectory::new(&robot.path.with_start_moved(offset))?;

    let rate = simulator.laser().options().rate_hz;
    let count = (trajectory.duration_secs() * rate + 1e-9).floor() + 1.0;
    check_count("scans", count, MAX_SCANS)?;
    let stamps: Vec<f64> = (0..count as usize).map(|i| i as f64 / rate).collect();
    let truth: Vec<Pose2> = stamps.iter().map(|&secs| trajectory.pose_at(secs)).collect();
    let geometry = simulator.map().geometry();
    if let Some(i) = truth.iter().position(|pose| !geometry.is_free(pose.x, pose.y)) {
        return Err(SimulationError::OutsideFreeSpace { secs: stamps[i], x: truth[i].x, y: truth[i].y });
    }
    let odometry = odometry_track(&truth, &robot.odometry_noise, seed);

    let scans: Vec<_> = (0..stamps.len())
        .into_par_iter()
        .map(|i| {
            let mut placements = Vec::new();
            if let Some(blocks) = simulator.blocks() {
                let draw = blocks.draw(seed, i as u32);
                blocks.place_blocks(&draw, stamps[i], truth[i].position(), &mut placements);
            }
            let noise = Draw::new(seed, Stage::Laser, i as u32);
            let scan = simulator.sweep(&placements, stamps[i], |secs| trajectory.pose_at(secs), &noise);
            let blocks = placements.iter().map(|placement| placement.block(stamps[i])).collect();
            (scan, blocks)
        })
        .collect();
    let (scans, blocks): (Vec<_>, Vec<_>) = scans.into_iter().unzip();
    let steps = scans
        .into_iter()
        .enumerate()
        .map(|(i, scan)| DriveStep {
            stamp_secs: stamps[i],
            odometry: odometry[i],
            reference: Some(truth[i]),
            scan,
        })
        .collect();
    Ok(SimulatedDrive { drive: Drive { laser: simulator.laser().laser().clone(), steps }, blocks })
}

/// `odom_from_base` at each scan: the sum of noisy increments of the true poses. Increment `i` draws from step `i`.
fn odometry_track(truth: &[Pose2], noise: &OdometryNoise, seed: u64) -> Vec<Pose2> {
    let mut odom_from_base = Pose2::IDENTITY;
    let mut track = Vec::with_capacity(truth.len());
    for (i, pose) in truth.iter().enumerate() {
        if i > 0 {
            let increment = pose.relative_to(&truth[i - 1]);
            let mut rng = Draw::new(seed, Stage::Odometry, i as u32).item(0);
            odom_from_base = odom_from_base.compose(&noise.sample(&increment, &mut rng));
        }
        track.push(odom_from_base);
    }
    track
}
