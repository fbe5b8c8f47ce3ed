//! Whole drives and scans in worlds with effects.

use glam::DVec2;
use locsim_core::{Draw, Pose2, Stage, Track};

use super::fixtures::{block_options, laser_options, on_threads, room_map};
use super::*;
use crate::effect::tests::{distance_from, place, strong};
use crate::effect::{BeamView, Effect, EffectKind, Effects, HitKind, Moves, Site, jump_at};

fn effects(list: Vec<Effect>) -> Effects {
    Effects::new(list).unwrap()
}

fn laser() -> LaserOptions {
    LaserOptions {
        sigma_m: 0.01,
        sigma_per_m: 0.002,
        resolution_m: 0.001,
        min_range_m: 0.3,
        max_range_m: 4.0,
        mount: Pose2::new(0.1, 0.05, 0.3),
        scan_secs: 0.15,
        ..laser_options()
    }
}

fn simulator(effects: Effects) -> Simulator {
    let blocks = BlockOptions {
        resample: BlockResampling::EachScanN(4),
        speed_m_s: [0.1, 0.4],
        per_metre_of_wall: 0.3,
        ..block_options()
    };
    Simulator::new(room_map(), Some(blocks), laser(), effects).unwrap()
}

/// Forward in a curve, in place, backward.
fn robot() -> Robot {
    let segments = [[3.0, 0.5, 0.2], [1.0, 0.0, -0.8], [1.0, -0.3, 0.1]]
        .map(|[secs, speed_m_s, turn_rate_rad_s]| VelocitySegment { secs, speed_m_s, turn_rate_rad_s });
    let start = Pose2::new(1.5, 1.5, 0.2);
    Robot {
        path: RobotPath::VelocityProfile { start, segments: segments.to_vec() },
        start_jitter_m: 0.1,
        odometry_noise: OdometryNoise::new([0.05, 0.02, 0.05, 0.01]).unwrap(),
    }
}

/// All numbers of a drive's scans as bits, so that NaN equals NaN.
fn scan_bits(drive: &SimulatedDrive) -> Vec<u32> {
    drive.drive.steps.iter().flat_map(|step| step.scan.ranges.iter().map(|z| z.to_bits())).collect()
}

fn pose_bits(poses: impl IntoIterator<Item = Pose2>) -> Vec<[u64; 3]> {
    poses.into_iter().map(|pose| [pose.x, pose.y, pose.theta].map(f64::to_bits)).collect()
}

fn odometry_bits(drive: &SimulatedDrive) -> Vec<[u64; 3]> {
    pose_bits(drive.drive.steps.iter().map(|step| step.odometry))
}

#[test]
fn a_neutral_effect_changes_no_bit_of_a_drive() {
    let nominal = simulate_drive(&simulator(Effects::none()), &robot(), 7).unwrap();
    let neutral = |kind| Effect::neutral(kind, place(kind));
    let mut worlds: Vec<Vec<Effect>> = EffectKind::ALL.map(|kind| vec![neutral(kind)]).to_vec();
    worlds.push(EffectKind::ALL.map(neutral).to_vec());
    for list in worlds {
        let kinds: Vec<EffectKind> = list.iter().map(|effect| effect.kind).collect();
        let simulator = simulator(effects(list));
        let drive = simulate_drive(&simulator, &robot(), 7).unwrap();
        assert_eq!(scan_bits(&drive), scan_bits(&nominal), "{kinds:?}");
        assert_eq!(odometry_bits(&drive), odometry_bits(&nominal), "{kinds:?}");
        assert_eq!(drive.blocks, nominal.blocks, "{kinds:?}");
        assert_eq!(drive.drive.laser, nominal.drive.laser, "{kinds:?}");
    }
}

/// Each effect shows, and in what its site says alone; poses, stamps and the laser that a filter is told of stay.
#[test]
fn a_strong_effect_changes_what_its_site_says() {
    let nominal = simulate_drive(&simulator(Effects::none()), &robot(), 7).unwrap();
    for kind in EffectKind::ALL {
        let drive = simulate_drive(&simulator(effects(vec![strong(kind)])), &robot(), 7).unwrap();
        let of_odometry = kind.site() == Site::Odometry;
        assert_eq!(odometry_bits(&drive) != odometry_bits(&nominal), of_odometry, "odometry of {kind}");
        let differing = scan_bits(&drive).iter().zip(scan_bits(&nominal)).filter(|(a, b)| *a != b).count();
        assert_eq!(differing > 0, !of_odometry, "scans of {kind}");
        let of_blocks = matches!(kind, EffectKind::BlockDensity | EffectKind::BlockDepth);
        assert_eq!(drive.blocks != nominal.blocks, of_blocks, "blocks of {kind}");
        assert_eq!(drive.drive.laser, nominal.drive.laser, "{kind}");
        for (step, nominal) in drive.drive.steps.iter().zip(&nominal.drive.steps) {
            assert_eq!((step.stamp_secs, step.reference), (nominal.stamp_secs, nominal.reference));
        }
    }
}

#[test]
fn effects_are_the_same_on_any_number_of_threads() {
    let simulator = simulator(effects(EffectKind::ALL.map(strong).to_vec()));
    let poses: locsim_core::Particles = (0..5).map(|i| Pose2::new(1.0 + f64::from(i), 2.0, 0.3)).collect();
    let run = |threads| {
        on_threads(threads, || {
            let drive = simulate_drive(&simulator, &robot(), 7).unwrap();
            let many = simulator.observe_many(poses.as_poses(), 3, 1);
            (scan_bits(&drive), odometry_bits(&drive), many.into_iter().map(f32::to_bits).collect::<Vec<_>>())
        })
    };
    assert_eq!(run(1), run(2));
}

/// The beams of a robot at `pose`, by casts of the test's own.
fn views(simulator: &Simulator, pose: &Pose2) -> Vec<BeamView> {
    let laser = simulator.laser().laser();
    let map_from_laser = pose.compose(&simulator.effects().laser_mount(laser.base_from_laser()));
    let (origin, reach) = (map_from_laser.position(), f64::from(laser.cast_range()));
    let cast = |bearing: &f32| {
        let direction = DVec2::from_angle(map_from_laser.theta + f64::from(*bearing));
        (direction, simulator.map().cast_ray(origin, direction, reach))
    };
    let nominal: Vec<f64> =
        laser.bearings().iter().map(|b| cast(b).1.map_or(reach, |hit| hit.range)).collect();
    let view = |(i, bearing): (usize, &f32)| {
        let (direction, hit) = cast(bearing);
        BeamView {
            secs: 0.0,
            bearing: f64::from(*bearing),
            range: nominal[i],
            incidence: hit.map_or(0.0, |hit| hit.incidence),
            endpoint: origin + nominal[i] * direction,
            direction,
            normal: DVec2::ZERO,
            jump: jump_at(&nominal, i, true),
            behind: None,
        }
    };
    laser.bearings().iter().enumerate().map(view).collect()
}

/// The readings of a robot that stands still have the distribution that the map's view of each beam gives; one test per beam at
/// a false-alarm probability of 1e-6. Under the nominal one they haven't, where an effect shapes readings.
#[test]
fn simulated_readings_have_the_law_of_their_beam() {
    let pose = Pose2::new(2.0, 1.0, 0.4);
    let scans = 400;
    for kind in EffectKind::ALL {
        if kind == EffectKind::MissingObject {
            continue;
        }
        let simulator = Simulator::new(room_map(), None, laser(), effects(vec![strong(kind)])).unwrap();
        let views = views(&simulator, &pose);
        let observed: Vec<Vec<f32>> = (0..scans).map(|i| simulator.observe(&pose, 4, i)).collect();
        let greatest = |effects: &Effects| {
            let distance = |(beam, view): (usize, &BeamView)| {
                let distribution =
                    effects.reading(simulator.laser().options(), view, HitKind::Wall, view.range);
                let readings: Vec<f32> = observed.iter().map(|scan| scan[beam]).collect();
                distance_from(|_| distribution.clone(), &readings)
            };
            views.iter().enumerate().map(distance).fold(0.0, f64::max)
        };
        let distance = greatest(simulator.effects());
        assert!(distance < 1.0, "{kind}: {distance}");
        let shapes_readings = kind.has_place()
            || kind.site() == Site::Beam && !matches!(kind, EffectKind::MountYaw | EffectKind::MountOffset);
        // There is no edge in an empty room.
        if shapes_readings && kind != EffectKind::MixedPixels {
            assert!(greatest(&Effects::none()) > 1.0, "{kind} is told from nothing");
        }
    }
}

/// Effects on the mount and on blocks are the same as a laser mounted, or blocks dense and deep, as they say.
#[test]
fn mounts_and_blocks_are_as_effects_say() {
    let drive = |blocks, laser, list| {
        let simulator = Simulator::new(room_map(), Some(blocks), laser, effects(list)).unwrap();
        scan_bits(&simulate_drive(&simulator, &robot(), 3).unwrap())
    };
    let by_effect = |kind| drive(block_options(), laser(), vec![strong(kind)]);
    let mount = |mount| drive(block_options(), LaserOptions { mount, ..laser() }, vec![]);
    assert_eq!(by_effect(EffectKind::MountYaw), mount(Pose2::new(0.1, 0.05, 0.4)));
    assert_eq!(by_effect(EffectKind::MountOffset), mount(Pose2::new(0.2, 0.0, 0.3)));
    let blocks = |blocks| drive(blocks, laser(), vec![]);
    let nominal = block_options();
    assert_eq!(
        by_effect(EffectKind::BlockDensity),
        blocks(BlockOptions { per_metre_of_wall: 2.0, ..nominal })
    );
    let deep = BlockOptions {
        width_m: nominal.width_m.map(|width| 1.5 * width),
        wall_distance_m: nominal.wall_distance_m.map(|gap| 1.5 * gap),
        ..nominal
    };
    assert_eq!(by_effect(EffectKind::BlockDepth), blocks(deep));
}

/// Without noise each reading is an exact cast from where the robot is at the beam's true time.
#[test]
fn beams_are_taken_when_effects_say() {
    let (robot, laser) = (robot(), LaserOptions { scan_secs: 0.1, ..laser_options() });
    for kind in [EffectKind::TimeOffset, EffectKind::MotionSkew] {
        let simulator = Simulator::new(room_map(), None, laser, effects(vec![strong(kind)])).unwrap();
        let robot = Robot { start_jitter_m: 0.0, ..robot.clone() };
        let trajectory = Trajectory::new(&robot.path).unwrap();
        let drive = simulate_drive(&simulator, &robot, 3).unwrap().drive;
        for step in &drive.steps {
            for (beam, &reading) in step.scan.ranges.iter().enumerate() {
                let bearing = f64::from(drive.laser.bearings()[beam]);
                let stamp = step.stamp_secs + f64::from(drive.laser.beam_times_secs()[beam]);
                let shift = match kind {
                    EffectKind::TimeOffset => 0.1,
                    _ => 0.2 * bearing / std::f64::consts::TAU,
                };
                let pose = trajectory.pose_at(stamp + shift);
                let direction = DVec2::from_angle(pose.theta + bearing);
                let hit = simulator.map().cast_ray(pose.position(), direction, 8.0).unwrap();
                assert!((f64::from(reading) - hit.range).abs() < 1e-5, "{kind}: {reading} {hit:?}");
            }
        }
    }
}

/// A disc in the room is seen where it stands, and hides blocks and walls behind it.
#[test]
fn a_missing_object_stands_in_the_way() {
    let with =
        |list| Simulator::new(room_map(), Some(block_options()), laser_options(), effects(list)).unwrap();
    let (nominal, simulator) = (with(vec![]), with(vec![strong(EffectKind::MissingObject)]));
    let pose = Pose2::new(2.5, 2.0, 0.5);
    let disc = simulator.effects().objects()[0];
    let mut seen = 0;
    for observation in 0..20 {
        let without = nominal.observe(&pose, 1, observation);
        let readings = simulator.observe(&pose, 1, observation);
        for ((&reading, &without), &bearing) in
            readings.iter().zip(&without).zip(simulator.laser().laser().bearings())
        {
            let direction = DVec2::from_angle(pose.theta + f64::from(bearing));
            let hit = disc.first_hit(pose.position(), direction, f64::from(without));
            seen += u32::from(hit.is_some());
            assert!((f64::from(reading) - hit.unwrap_or(f64::from(without))).abs() < 1e-5);
        }
    }
    assert!(seen > 20, "{seen}");
}

/// Effects of walls act on a missing object by its own incidence, and not those of the place behind it.
#[test]
fn a_missing_object_is_a_wall_of_its_own() {
    let laser = LaserOptions { beams: 1, ..laser_options() };
    let disc = || Effect::new(EffectKind::MissingObject, vec![3.0, 2.0, 0.5], vec![]).unwrap();
    let list = vec![
        disc(),
        Effect::new(EffectKind::IncidenceDropout, vec![1.0, 0.8, 0.001], vec![]).unwrap(),
        Effect::new(
            EffectKind::MovedWall,
            vec![1.0, 0.0],
            vec![[DVec2::new(6.0, 4.0), DVec2::new(6.0, 0.0)]],
        )
        .unwrap(),
    ];
    let simulator = Simulator::new(room_map(), None, laser, effects(list)).unwrap();
    let reading = |y: f64| f64::from(simulator.observe(&Pose2::new(1.0, y, 0.0), 1, 0)[0]);
    assert!((reading(2.0) - 1.5).abs() < 1e-6, "the disc's middle");
    assert_eq!(reading(2.45), 8.0, "its edge, at an incidence of 64 deg");
    assert!((reading(3.0) - 6.0).abs() < 1e-6, "past it, the wall that has moved");

    let east = vec![[DVec2::new(6.0, 0.0), DVec2::new(6.0, 4.0)]];
    let list = vec![disc(), Effect::new(EffectKind::Glass, vec![1.0, 0.0], east).unwrap()];
    let simulator = Simulator::new(room_map(), None, laser, effects(list)).unwrap();
    let reading = |y: f64| f64::from(simulator.observe(&Pose2::new(1.0, y, 0.0), 1, 0)[0]);
    assert!((reading(2.0) - 1.5).abs() < 1e-6, "the disc isn't of glass");
    assert!(reading(3.0) > 5.0, "past it, through the glass");
    // The map has nothing behind: half of the beams come back, from anywhere there.
    let readings: Vec<f32> = (0..400)
        .map(|observation| simulator.observe(&Pose2::new(1.0, 3.0, 0.0), 1, observation)[0])
        .collect();
    let returns: Vec<f64> = readings.iter().filter(|z| **z < 8.0).map(|z| f64::from(*z)).collect();
    // 200 of 400, with a standard deviation of 10; means of 200 over 3 m, of 6 cm.
    assert!((150..=250).contains(&returns.len()), "{}", returns.len());
    assert!(returns.iter().all(|z| *z >= 5.0));
    assert!((returns.iter().sum::<f64>() / returns.len() as f64 - 6.5).abs() < 0.3);
}

/// Behind a wall of glass stands what stands there; a wall that has moved nearer hides the blocks behind it.
#[test]
fn glass_shows_what_is_behind_and_a_moved_wall_hides_what_is_before() {
    let screen = crate::map::Wall { name: "screen".into(), from_m: [2.0, 0.5], to_m: [2.0, 3.5] };
    let outline = crate::map::Polyline {
        points_m: vec![[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]],
        ..crate::map::Polyline::default()
    };
    let map = crate::map::VectorMap { outline, obstacles: vec![], walls: vec![screen] };
    let map = std::sync::Arc::new(crate::raycast::ExactRangeMap::new(map.to_geometry().unwrap()));
    let place = vec![[DVec2::new(2.0, 0.5), DVec2::new(2.0, 3.5)]];
    let glass = Effect::new(EffectKind::Glass, vec![1.0, 0.0], place.clone()).unwrap();
    let laser = LaserOptions { beams: 1, ..laser_options() };
    let simulator = Simulator::new(std::sync::Arc::clone(&map), None, laser, effects(vec![glass])).unwrap();
    let reading = |simulator: &Simulator, x: f64, theta: f64| {
        f64::from(simulator.observe(&Pose2::new(x, 2.0, theta), 1, 0)[0])
    };
    assert!((reading(&simulator, 1.0, 0.0) - 5.0).abs() < 1e-6, "through the screen");
    assert!((reading(&simulator, 3.0, std::f64::consts::PI) - 3.0).abs() < 1e-6, "from the other side");
    assert!((reading(&simulator, 3.0, 0.0) - 3.0).abs() < 1e-6, "away from it");

    let dense = BlockOptions { per_metre_of_wall: 20.0, clearance_m: 0.0, ..block_options() };
    let moved = Effect::new(EffectKind::MovedWall, vec![-1.5, 0.0], place).unwrap();
    let simulator = Simulator::new(map, Some(dense), laser, effects(vec![moved])).unwrap();
    for observation in 0..20 {
        let reading = f64::from(simulator.observe(&Pose2::new(0.2, 2.0, 0.0), 1, observation)[0]);
        assert!(reading <= 0.3 + 1e-6, "{reading} looks through the wall");
    }
}

#[test]
fn bursts_of_crosstalk_last_for_a_second() {
    let crosstalk = Effect::new(EffectKind::Crosstalk, vec![1.0, 0.5], vec![]).unwrap();
    let simulator = Simulator::new(room_map(), None, laser_options(), effects(vec![crosstalk])).unwrap();
    let nominal = Simulator::new(room_map(), None, laser_options(), Effects::none()).unwrap();
    let poses = (0..200).map(|i| (0.2 * f64::from(i) + 0.05, Pose2::new(2.0, 2.0, 0.0)));
    let track = Track::new(poses).unwrap();
    let clear = nominal.scan_along(track.secs(), |i, secs| track.pose_during(i, secs), 1);
    let readings = simulator.scan_along(track.secs(), |i, secs| track.pose_during(i, secs), 1);
    let disturbed: Vec<bool> = readings.chunks(36).zip(clear.chunks(36)).map(|(a, b)| a != b).collect();
    for window in disturbed.chunks(5) {
        assert!(window.iter().all(|scan| *scan == window[0]), "{window:?}");
    }
    // 40 fair coins: all the same with probability 2e-12.
    assert!(disturbed.contains(&true) && disturbed.contains(&false));
}

/// A recorded drive has the scans and the odometry of the drive that it records, but for a robot that is faster or
/// turns faster between the poses.
#[test]
fn scans_and_odometry_along_a_drive_are_the_drives() {
    let laser = LaserOptions { scan_secs: 0.0, ..laser() };
    let blocks = BlockOptions { resample: BlockResampling::EachScanN(3), ..block_options() };
    let list =
        vec![strong(EffectKind::WheelSlip), strong(EffectKind::WarmupDrift), strong(EffectKind::Crosstalk)];
    let simulator = Simulator::new(room_map(), Some(blocks), laser, effects(list)).unwrap();
    let drive = simulate_drive(&simulator, &robot(), 11).unwrap();
    let track = drive.drive.reference().unwrap();
    let along =
        on_threads(2, || simulator.scan_along(track.secs(), |i, secs| track.pose_during(i, secs), 11));
    assert_eq!(along.iter().map(|z| z.to_bits()).collect::<Vec<_>>(), scan_bits(&drive));
    let odometry = odometry_along(track.poses(), &robot().odometry_noise, simulator.effects(), 11);
    assert_eq!(pose_bits(odometry), odometry_bits(&drive));
    let later = track.secs().iter().map(|secs| secs + 64.0).zip(track.poses().iter().copied());
    let later = Track::new(later).unwrap();
    let shifted = simulator.scan_along(later.secs(), |i, secs| later.pose_during(i, secs), 11);
    let differing = along.iter().zip(&shifted).filter(|(a, b)| (*a - *b).abs() > 0.0011).count();
    assert_eq!(differing, 0, "time counts from the first scan");
}

/// Some beams read what they read among all, whatever effects they are under.
#[test]
fn some_beams_of_a_scan_read_what_they_read_among_all() {
    let track =
        Track::new((0..4).map(|i| (0.5 * f64::from(i), Pose2::new(1.5, 1.5, 0.3 * f64::from(i))))).unwrap();
    let at = |i: usize, secs: f64| track.pose_during(i, secs);
    let some = [0, 1, 5, 17, 35];
    for kind in EffectKind::ALL {
        let simulator = simulator(effects(vec![strong(kind)]));
        let all = simulator.scan_along(track.secs(), at, 11);
        let expected = all.chunks(36).flat_map(|scan| some.map(|beam| scan[beam].to_bits()));
        let own = simulator.beams_along(&some, track.secs(), at, 11);
        assert!(expected.eq(own.into_iter().map(f32::to_bits)), "{kind}");
    }
}

/// Readings of a disc lie on it, for a laser that is turned on its robot and a robot that turns while it scans.
#[test]
fn a_reading_lies_where_its_beam_met_something() {
    let center = DVec2::new(2.5, 2.0);
    let disc = Effect::new(EffectKind::MissingObject, vec![center.x, center.y, 0.3], Vec::new()).unwrap();
    let laser = LaserOptions { mount: Pose2::new(0.1, 0.05, 3.0), ..laser() };
    let simulator = Simulator::new(room_map(), None, laser, effects(vec![disc])).unwrap();
    let caster = simulator.caster();
    let rays: Vec<_> = caster.rays(0..36, 0.0, |secs| Pose2::new(1.5, 1.5, 2.0 * secs)).collect();
    let mut beams = Vec::new();
    caster.cast(&rays, &mut beams);
    let of_disc: Vec<_> = beams.iter().filter(|beam| !beam.is_mapped()).collect();
    assert!(of_disc.len() >= 2);
    for beam in of_disc {
        assert!((beam.view.point_at(beam.range).distance(center) - 0.3).abs() < 1e-9);
    }
}

/// Draws of effects are keyed by the stage of their own.
#[test]
fn draws_of_effects_are_their_own() {
    assert_ne!(Draw::new(1, Stage::Effect, 2).seed(3), Draw::new(1, Stage::Laser, 2).seed(3));
}

/// A filter of scans of [`laser`] in the room.
fn filter(list: &[Effect]) -> ScanFilter {
    let recorded = LaserSimulator::new(laser()).unwrap().laser().clone();
    ScanFilter::new(list, recorded, laser(), 9).unwrap().with_map(room_map(), None).unwrap()
}

/// Scans of a nominal robot that stands still, with the effects applied, have the distribution that the map's view of each beam
/// gives; one test per beam at a false-alarm probability of 1e-6. Without the effects they haven't.
#[test]
fn filtered_readings_have_the_law_of_their_beam() {
    let pose = Pose2::new(2.0, 1.0, 0.4);
    let nominal = Simulator::new(room_map(), None, laser(), Effects::none()).unwrap();
    let observed: Vec<Vec<f32>> = (0..400).map(|i| nominal.observe(&pose, 4, i)).collect();
    for kind in EffectKind::ALL {
        let moves = kind.description().moves;
        // Objects are new surfaces; mounts, clocks and odometry leave readings as they are.
        if matches!(moves, Moves::Scans | Moves::Odometry | Moves::Objects) {
            continue;
        }
        let simulator = Simulator::new(room_map(), None, laser(), effects(vec![strong(kind)])).unwrap();
        let views = views(&simulator, &pose);
        let mut filter = filter(&[strong(kind)]);
        let still = |_: f64| pose;
        let filtered: Vec<Vec<f32>> = observed
            .iter()
            .enumerate()
            .map(|(i, scan)| {
                let mut scan = scan.clone();
                // Bursts fall on windows of time: each scan in another, at the first scan for a drift that fades.
                let secs = if kind == EffectKind::Crosstalk { i as f64 * 3.0 } else { 0.0 };
                filter.apply(i as u32, secs, Some(&still), &mut scan);
                scan
            })
            .collect();
        let greatest = |effects: &Effects| {
            let distance = |(beam, view): (usize, &BeamView)| {
                let view = BeamView { secs: view.secs + f64::from(laser_times()[beam]), ..*view };
                let distribution =
                    effects.reading(simulator.laser().options(), &view, HitKind::Wall, view.range);
                let readings: Vec<f32> = filtered.iter().map(|scan| scan[beam]).collect();
                distance_from(|_| distribution.clone(), &readings)
            };
            views.iter().enumerate().map(distance).fold(0.0, f64::max)
        };
        let distance = greatest(simulator.effects());
        assert!(distance < 1.0, "{kind}: {distance}");
        // There is no edge in an empty room, and no clutter.
        let shows =
            !matches!(kind, EffectKind::MixedPixels | EffectKind::BlockDensity | EffectKind::BlockDepth);
        if shows {
            assert!(greatest(&Effects::none()) > 1.0, "{kind} is told from nothing");
        }
    }
}

fn laser_times() -> Vec<f32> {
    LaserSimulator::new(laser()).unwrap().laser().beam_times_secs().to_vec()
}

#[test]
fn neutral_effects_change_no_bit_of_a_recording_and_scans_are_filtered_one_by_one() {
    let nominal = simulate_drive(&simulator(Effects::none()), &robot(), 7).unwrap().drive;
    let track =
        Track::new(nominal.steps.iter().map(|step| (step.stamp_secs, step.reference.unwrap()))).unwrap();
    let at = |secs: f64| track.pose_at(secs);
    let run = |filter: &mut ScanFilter, step: usize| {
        let mut readings = nominal.steps[step].scan.ranges.clone();
        filter.apply(step as u32, nominal.steps[step].stamp_secs, Some(&at), &mut readings);
        readings.into_iter().map(f32::to_bits).collect::<Vec<u32>>()
    };
    let neutral: Vec<Effect> = EffectKind::ALL.map(|kind| Effect::neutral(kind, place(kind))).to_vec();
    let (mut neutral, count) = (filter(&neutral), nominal.steps.len());
    for step in 0..count {
        let recorded: Vec<u32> = nominal.steps[step].scan.ranges.iter().map(|z| z.to_bits()).collect();
        assert_eq!(run(&mut neutral, step), recorded, "scan {step}");
    }
    // In any order, and again: the same.
    let all: Vec<Effect> = EffectKind::ALL.map(strong).to_vec();
    let mut one = filter(&all);
    let forth: Vec<_> = (0..count).map(|step| run(&mut one, step)).collect();
    let mut other = filter(&all);
    for step in (0..count).rev() {
        assert_eq!(run(&mut other, step), forth[step], "scan {step}");
    }
    // Without a pose, effects that need the map are left out, and the others act.
    let mut readings = nominal.steps[0].scan.ranges.clone();
    let only = |kind| filter(&[strong(kind)]);
    only(EffectKind::MissingObject).apply(0, 0.0, None, &mut readings);
    only(EffectKind::IncidenceDropout).apply(0, 0.0, None, &mut readings);
    let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
    assert!(same(&readings, &nominal.steps[0].scan.ranges));
    only(EffectKind::RangeBias).apply(0, 0.0, None, &mut readings);
    assert!(!same(&readings, &nominal.steps[0].scan.ranges));
}

/// Clutter that effects change is drawn anew: recorded readings in front of walls make way for the scenario's.
#[test]
fn clutter_of_a_recording_makes_way_for_that_of_the_effects() {
    let blocks = BlockOptions { resample: BlockResampling::EachObservation, ..block_options() };
    let pose = Pose2::new(2.0, 1.0, 0.4);
    let world = |list| Simulator::new(room_map(), Some(blocks), laser(), effects(list)).unwrap();
    let short = |scans: &[Vec<f32>]| {
        let clear =
            Simulator::new(room_map(), None, LaserOptions { sigma_m: 0.0, ..laser() }, Effects::none());
        let clear = clear.unwrap().observe(&pose, 0, 0);
        let is_short = |scan: &Vec<f32>| scan.iter().zip(&clear).filter(|(z, r)| **z < **r - 0.08).count();
        scans.iter().map(is_short).sum::<usize>() as f64 / (scans.len() * clear.len()) as f64
    };
    let nominal = world(vec![]);
    let recorded: Vec<Vec<f32>> = (0..300).map(|i| nominal.observe(&pose, 4, i)).collect();
    for factor in [0.0, 0.5, 3.0] {
        let density = Effect::new(EffectKind::BlockDensity, vec![factor], vec![]).unwrap();
        let expected = world(vec![density.clone()]);
        let expected: Vec<Vec<f32>> = (0..300).map(|i| expected.observe(&pose, 5, i)).collect();
        let recorded_laser = nominal.laser().laser().clone();
        let filter = ScanFilter::new(&[density], recorded_laser, laser(), 9).unwrap();
        let mut filter = filter.with_map(room_map(), Some(blocks)).unwrap();
        let filtered: Vec<Vec<f32>> = recorded
            .iter()
            .enumerate()
            .map(|(i, scan)| {
                let mut scan = scan.clone();
                filter.apply(i as u32, 0.0, Some(&|_| pose), &mut scan);
                scan
            })
            .collect();
        let (found, expected, before) = (short(&filtered), short(&expected), short(&recorded));
        assert!(
            (found - expected).abs() < 0.25 * (expected - before).abs(),
            "{factor}: {found} {expected} {before}"
        );
    }
}

/// At the scans an affected odometry reads what [`odometry_along`] reads without noise, and between them it goes on evenly;
/// what corrects it leaves the robot where it is in the map.
#[test]
fn an_affected_odometry_is_a_simulated_one() {
    let trajectory = Trajectory::new(&robot().path).unwrap();
    let track = Track::new((0..40).map(|i| 0.1 * f64::from(i)).map(|t| (t, trajectory.pose_at(t)))).unwrap();
    for kind in EffectKind::ALL.into_iter().filter(|kind| kind.site() == Site::Odometry) {
        let list = [strong(kind)];
        let filter = OdometryFilter::new(&list, track.clone(), 3).unwrap();
        let seed = Draw::new(3, Stage::Recording, 0).seed(0);
        let quiet = OdometryNoise::default();
        let expected = odometry_along(track.poses(), &quiet, &effects(list.to_vec()), seed);
        let mut moved = 0.0_f64;
        for (i, (secs, pose)) in track.secs().iter().zip(track.poses()).enumerate() {
            let read = filter.pose(*secs, pose);
            let simulated = track.poses()[0].compose(&expected[i]);
            assert!(read.position().distance(simulated.position()) < 1e-9, "{kind} at scan {i}");
            moved = moved.max(read.position().distance(pose.position()));
            let map_from_odom = Pose2::new(1.0, 2.0, 0.5);
            let back = filter.correction(*secs, &map_from_odom).compose(&read);
            let stays = map_from_odom.compose(pose);
            assert!(back.position().distance(stays.position()) < 1e-9, "{kind} at scan {i}");
            // Just after a scan, just beyond its pose.
            let later = filter.pose(secs + 1e-9, &track.pose_at(secs + 1e-9));
            assert!(later.position().distance(read.position()) < 1e-6, "{kind} after scan {i}");
        }
        assert!(moved > 0.01, "{kind}: {moved}");
    }
}
