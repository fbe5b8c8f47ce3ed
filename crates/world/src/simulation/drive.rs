use glam::DVec2;
use locsim_core::limits::Limits;
use locsim_core::{Draw, Drive, DriveStep, Pose2, Stage};
use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;

use super::error::{check, check_limit};
use super::observe::Scratch;
use super::{Block, BlockModel, OdometryNoise, RobotPath, SimulationError, Simulator, Trajectory};
use crate::effect::{Effects, slip_draw};

/// A robot that drives through the world.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Robot {
    /// The path it drives.
    pub path: RobotPath,
    /// Half-width of the uniform shift of the path's start along x and along y \[m\], at least 0; see
    /// [`RobotPath::with_start_moved`].
    pub start_jitter_m: f64,
    /// How its odometry errs.
    pub odometry_noise: OdometryNoise,
}

/// A recorded drive and what only the simulator knows.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedDrive {
    /// Scans, odometry (starting at the origin of `odom`) and true poses as reference, from the start of the
    /// path at 0 s to its end. Laser and stamps are as they are said to be, whatever effects make of them.
    pub drive: Drive,
    /// The blocks that stood around the robot at the stamp of each scan.
    pub blocks: Vec<Vec<Block>>,
}

/// Drives `robot` through the world, taking scans at the laser's rate.
///
/// The odometry reads the motion between two scans as one increment.
///
/// # Errors
/// As [`Trajectory::new`]; a negative jitter; more than a million scans, or more readings or blocks in all
/// scans than the limits allow; a scan outside the map's free space.
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
    let count = trajectory.scan_count(rate)?;
    let limits = Limits::current();
    let beams = simulator.laser().laser().beam_count();
    check_limit("log_readings", limits.log_readings, (count * beams) as f64)?;
    let blocks = simulator.blocks().map_or(0.0, BlockModel::expected_count);
    check_limit("drive_blocks", limits.drive_blocks, count as f64 * blocks)?;
    let stamps: Vec<f64> = (0..count).map(|i| i as f64 / rate).collect();
    let truth: Vec<Pose2> = stamps.iter().map(|&secs| trajectory.pose_at(secs)).collect();
    let geometry = simulator.map().geometry();
    if let Some(i) = truth.iter().position(|pose| !geometry.is_free(pose.x, pose.y)) {
        return Err(SimulationError::OutsideFreeSpace { secs: stamps[i], x: truth[i].x, y: truth[i].y });
    }
    let odometry = odometry_along(&truth, &robot.odometry_noise, simulator.effects(), seed);

    let beams = simulator.all_beams();
    let scans: Vec<_> = (0..stamps.len())
        .into_par_iter()
        .map_init(Scratch::default, |scratch, i| {
            let scan = simulator.sweep(
                seed,
                (i as u32, stamps[i]),
                &beams,
                |secs| trajectory.pose_at(secs),
                scratch,
            );
            let blocks = scratch.blocks.iter().map(|placement| placement.block(stamps[i])).collect();
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

/// `odom_from_base` at each of the true poses `truth` (`map_from_base`), from the origin on: the sum of increments as a
/// robot of this noise and these effects reads them. Increment `i` draws from step `i`.
pub fn odometry_along(truth: &[Pose2], noise: &OdometryNoise, effects: &Effects, seed: u64) -> Vec<Pose2> {
    let mut odom_from_base = Pose2::IDENTITY;
    let mut track = Vec::with_capacity(truth.len());
    for (i, pose) in truth.iter().enumerate() {
        if i > 0 {
            let mut increment = pose.relative_to(&truth[i - 1]);
            if !effects.is_empty() {
                increment = effects.odometry(&increment).sample(&mut slip_draw(seed, i as u32));
            }
            let mut rng = Draw::new(seed, Stage::Odometry, i as u32).item(0);
            odom_from_base = odom_from_base.compose(&noise.sample(&increment, &mut rng));
        }
        track.push(odom_from_base);
    }
    track
}

#[cfg(test)]
mod tests {
    use locsim_core::wrap_angle;

    use super::super::fixtures::{block_options, laser_options, on_threads, room_map};
    use super::super::{BlockOptions, BlockResampling, LaserOptions, VelocitySegment};
    use super::*;

    fn simulator(blocks: Option<BlockOptions>, laser: LaserOptions) -> Simulator {
        Simulator::new(room_map(), blocks, laser, Effects::none()).unwrap()
    }

    /// 4 s forward in a curve, 2 s in place, 2 s backward.
    fn robot(alpha: [f64; 4]) -> Robot {
        let segments = [[4.0, 0.5, 0.2], [2.0, 0.0, -0.8], [2.0, -0.3, 0.1]]
            .map(|[secs, speed_m_s, turn_rate_rad_s]| VelocitySegment { secs, speed_m_s, turn_rate_rad_s });
        let start = Pose2::new(1.5, 1.5, 0.2);
        Robot {
            path: RobotPath::VelocityProfile { start, segments: segments.to_vec() },
            start_jitter_m: 0.0,
            odometry_noise: OdometryNoise::new(alpha).unwrap(),
        }
    }

    fn is_near(a: &Pose2, b: &Pose2) -> bool {
        a.position().distance(b.position()) < 1e-9 && wrap_angle(a.theta - b.theta).abs() < 1e-9
    }

    #[test]
    fn without_noise_the_odometry_is_the_path() {
        let robot = robot([0.0; 4]);
        let drive = simulate_drive(&simulator(None, laser_options()), &robot, 1).unwrap().drive;
        let trajectory = Trajectory::new(&robot.path).unwrap();
        assert_eq!(drive.steps.len(), 41, "8 s at 5 Hz, both ends");
        for (i, step) in drive.steps.iter().enumerate() {
            assert!((step.stamp_secs - 0.2 * i as f64).abs() < 1e-12);
            let truth = trajectory.pose_at(step.stamp_secs);
            assert_eq!(step.reference, Some(truth));
            let odometry = truth.relative_to(&trajectory.pose_at(0.0));
            assert!(is_near(&step.odometry, &odometry), "step {i}");
        }
    }

    #[test]
    fn with_noise_the_odometry_drifts_and_the_path_does_not() {
        let simulator = simulator(None, laser_options());
        let run = |alpha, seed| simulate_drive(&simulator, &robot(alpha), seed).unwrap().drive;
        let (quiet, noisy, other) = (run([0.0; 4], 1), run([0.05; 4], 1), run([0.05; 4], 2));
        for ((quiet, noisy), other) in quiet.steps.iter().zip(&noisy.steps).zip(&other.steps).skip(1) {
            assert_eq!(quiet.reference, noisy.reference);
            assert_ne!(quiet.odometry, noisy.odometry);
            assert_ne!(noisy.odometry, other.odometry);
        }
    }

    /// Each beam of a sweep is an exact cast from the robot's pose at the beam's time at the blocks' edges
    /// there.
    #[test]
    fn beams_are_cast_from_the_pose_at_their_own_time() {
        let blocks = BlockOptions {
            resample: BlockResampling::Never,
            speed_m_s: [0.2, 0.4],
            clearance_m: 0.0,
            ..block_options()
        };
        let mount = Pose2::new(0.1, 0.0, 0.5);
        let simulator = simulator(Some(blocks), LaserOptions { scan_secs: 0.2, mount, ..laser_options() });
        let robot = robot([0.0; 4]);
        let trajectory = Trajectory::new(&robot.path).unwrap();
        let drive = simulate_drive(&simulator, &robot, 3).unwrap().drive;
        let mut differing = 0;
        for step in &drive.steps {
            let cast = |beam: usize, secs: f64| {
                let map_from_laser = trajectory.pose_at(secs).compose(&mount);
                let placed = simulator.blocks().unwrap().blocks_at(3, 0, secs, DVec2::splat(1e3));
                let edges: Vec<[DVec2; 2]> = placed
                    .iter()
                    .flat_map(|block| (0..4).map(|i| [block.corners[i], block.corners[(i + 1) % 4]]))
                    .collect();
                let direction =
                    DVec2::from_angle(map_from_laser.theta + f64::from(drive.laser.bearings()[beam]));
                simulator
                    .map()
                    .cast_ray_with(&edges, map_from_laser.position(), direction, 8.0)
                    .unwrap()
                    .range
            };
            for (beam, &reading) in step.scan.ranges.iter().enumerate() {
                let offset_secs = f64::from(drive.laser.beam_times_secs()[beam]);
                let expected = cast(beam, step.stamp_secs + offset_secs);
                assert!((f64::from(reading) - expected).abs() < 1e-5, "{reading} {expected}");
                differing += u32::from((cast(beam, step.stamp_secs) - expected).abs() > 1e-3);
            }
        }
        assert!(
            differing > 700,
            "half of the beams see that the robot moves while the laser turns: {differing}"
        );
    }

    /// The blocks handed back are those that the scan saw.
    #[test]
    fn the_blocks_of_a_step_explain_its_scan() {
        let simulator = simulator(Some(block_options()), laser_options());
        let SimulatedDrive { drive, blocks } = simulate_drive(&simulator, &robot([0.0; 4]), 5).unwrap();
        assert_eq!(blocks.len(), drive.steps.len());
        let mut shortened = 0;
        for (step, blocks) in drive.steps.iter().zip(&blocks) {
            let pose = step.reference.unwrap();
            let edges: Vec<[DVec2; 2]> = blocks
                .iter()
                .flat_map(|block| (0..4).map(|i| [block.corners[i], block.corners[(i + 1) % 4]]))
                .collect();
            for (&reading, &bearing) in step.scan.ranges.iter().zip(drive.laser.bearings()) {
                let direction = DVec2::from_angle(pose.theta + f64::from(bearing));
                let cast =
                    |edges| simulator.map().cast_ray_with(edges, pose.position(), direction, 8.0).unwrap();
                assert!((f64::from(reading) - cast(&edges).range).abs() < 1e-5);
                shortened += u32::from(cast(&edges).range < cast(&[]).range);
            }
        }
        assert!(shortened > 100, "hardly a block was in the way: {shortened}");
    }

    #[test]
    fn a_drive_is_the_same_on_any_number_of_threads() {
        let laser = LaserOptions { sigma_m: 0.01, scan_secs: 0.1, ..laser_options() };
        let simulator = simulator(Some(block_options()), laser);
        let run = |threads| on_threads(threads, || simulate_drive(&simulator, &robot([0.05; 4]), 7).unwrap());
        let one = run(1);
        assert_eq!(one, run(2));
        assert_eq!(one, run(8));
    }

    #[test]
    fn the_start_is_shifted_within_the_jitter_by_trial() {
        let simulator = simulator(None, laser_options());
        let start = |seed| {
            let robot = Robot { start_jitter_m: 0.2, ..robot([0.0; 4]) };
            simulate_drive(&simulator, &robot, seed).unwrap().drive.steps[0].reference.unwrap()
        };
        let starts: Vec<Pose2> = (0..50).map(start).collect();
        assert!(
            starts.iter().all(|p| (p.x - 1.5).abs() <= 0.2 && (p.y - 1.5).abs() <= 0.2 && p.theta == 0.2)
        );
        // 50 uniform draws all on one side of the middle: 2^-49 each.
        for coordinate in [|p: &Pose2| p.x, |p: &Pose2| p.y] {
            assert!(starts.iter().any(|p| coordinate(p) < 1.5) && starts.iter().any(|p| coordinate(p) > 1.5));
        }
    }

    #[test]
    fn drives_that_would_not_fit_into_memory_are_refused() {
        let robot = |secs: f64| Robot {
            path: RobotPath::VelocityProfile {
                start: Pose2::new(1.5, 1.5, 0.0),
                segments: vec![VelocitySegment { secs, speed_m_s: 0.0, turn_rate_rad_s: 0.1 }],
            },
            start_jitter_m: 0.0,
            odometry_noise: OdometryNoise::default(),
        };
        assert_eq!(Trajectory::new(&robot(1000.0).path).unwrap().scan_count(5.0).unwrap(), 5001);
        let many_blocks = BlockOptions { per_metre_of_wall: 500.0, ..block_options() };
        let many_beams = LaserOptions { beams: 100_000, ..laser_options() };
        for (simulator, message) in [
            (
                simulator(Some(many_blocks), laser_options()),
                "50010000 unmapped blocks in all scans of a simulated drive",
            ),
            (simulator(None, many_beams), "500100000 range readings of a log"),
        ] {
            let error = simulate_drive(&simulator, &robot(1000.0), 1).unwrap_err().to_string();
            assert!(error.starts_with(message) && error.contains("--limit"), "{error}");
        }
    }

    #[test]
    fn drives_that_cannot_be_are_refused() {
        let simulator = simulator(None, laser_options());
        let path = |points: &[[f64; 2]], speed_m_s| RobotPath::Waypoints {
            points_m: points.to_vec(),
            speed_m_s,
            turn_rate_rad_s: 1.0,
        };
        let inside = [[1.0, 1.0], [5.0, 1.0]];
        for (path, start_jitter_m, message) in [
            (path(&[inside[0], [9.0, 1.0]], 1.0), 0.0, "outside the map's free space"),
            (path(&[], 1.0), 0.0, "at least 2 waypoints"),
            (path(&inside, 1e-6), 0.0, "20000001 scans are more than the 1000000"),
            (path(&inside, 1.0), -0.1, "start jitter [m] must be at least 0; got -0.1"),
        ] {
            let robot = Robot { path, start_jitter_m, odometry_noise: OdometryNoise::default() };
            let error = simulate_drive(&simulator, &robot, 1).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
