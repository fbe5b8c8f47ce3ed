use std::sync::Arc;

use glam::DVec2;
use locsim_core::{Hits, Particles, RangeMap, Track};
use locsim_world::effect::Effects;
use locsim_world::map::{Polyline, VectorMap};
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::LaserOptions;

use super::readings::{Open, across_from, is_one_thing};
use super::*;

const BEAMS: usize = 72;

const LASER: LaserOptions = LaserOptions {
    rate_hz: 10.0,
    beams: 360,
    field_of_view_rad: std::f64::consts::TAU,
    first_bearing_rad: None,
    min_range_m: 0.05,
    max_range_m: 20.0,
    resolution_m: 0.001,
    sigma_m: 0.01,
    sigma_per_m: 0.0,
    mount: Pose2::IDENTITY,
    scan_secs: 0.0,
};

fn blocks(gap_m: f64) -> BlockOptions {
    BlockOptions {
        per_metre_of_wall: 0.1,
        length_m: [0.3, 0.4],
        width_m: [0.2, 0.3],
        yaw_rad: [0.0, 0.0],
        wall_distance_m: [0.0, gap_m],
        resample: BlockResampling::EachObservation,
        speed_m_s: [0.0, 0.0],
        clearance_m: 0.0,
    }
}

/// 100 scans amid a hall of 12 m. `beam` of the `seen` beams of scan i sees something at a distance \[m\].
fn told(
    seen: usize,
    beam: impl Fn(usize, usize) -> usize,
    at_m: f32,
    blocks: Option<&BlockOptions>,
) -> Option<String> {
    told_in(6.0, seen, beam, at_m, blocks).and_then(|found| found.warning())
}

/// The same amid a hall whose walls are `wall_m` away.
fn told_in(
    wall_m: f64,
    seen: usize,
    beam: impl Fn(usize, usize) -> usize,
    at_m: f32,
    blocks: Option<&BlockOptions>,
) -> Option<InOpen> {
    let corners = [[-wall_m, -wall_m], [wall_m, -wall_m], [wall_m, wall_m], [-wall_m, wall_m]];
    let outline = Polyline { points_m: corners.to_vec(), ..Polyline::default() };
    let map = VectorMap { outline, obstacles: Vec::new(), walls: Vec::new() };
    let map = ExactRangeMap::new(map.to_geometry().unwrap());
    let bearings: Vec<f32> = (0..BEAMS).map(|i| (i as f32 * 5.0 - 177.5).to_radians()).collect();
    let laser = Laser::new(bearings, vec![0.0; BEAMS], 0.0, 20.0, Pose2::IDENTITY).unwrap();
    let poses: Particles = std::iter::once(Pose2::IDENTITY).collect();
    let mut hits = Hits::default();
    map.cast(poses.as_poses(), laser.bearings(), laser.cast_range(), &mut hits);
    let step = |i: usize| {
        let mut ranges: Vec<f32> = hits.range.iter().map(|range| range.min(laser.max_range())).collect();
        (0..seen).for_each(|j| ranges[beam(i, j)] = at_m);
        let pose = Pose2::IDENTITY;
        DriveStep { stamp_secs: i as f64, odometry: pose, reference: Some(pose), scan: Scan { ranges } }
    };
    let steps: Vec<DriveStep> = (0..100).map(step).collect();
    in_open(&looked_at(steps.iter()), &laser, &map, blocks, None)
}

/// A hall of 12 m, and 200 scans of a simulator amid it.
struct Hall {
    map: Arc<ExactRangeMap>,
    walls: BlockOptions,
}

impl Hall {
    fn new(walls: BlockOptions) -> Self {
        let corners = [[-6.0, -6.0], [6.0, -6.0], [6.0, 6.0], [-6.0, 6.0]];
        let outline = Polyline { points_m: corners.to_vec(), ..Polyline::default() };
        let map = VectorMap { outline, obstacles: Vec::new(), walls: Vec::new() };
        Self { map: Arc::new(ExactRangeMap::new(map.to_geometry().unwrap())), walls }
    }

    fn simulator(&self, blocks: Option<BlockOptions>) -> Simulator {
        Simulator::new(Arc::clone(&self.map), blocks, LASER, Effects::none()).unwrap()
    }

    fn scans(simulator: &Simulator, seed: u64) -> Vec<DriveStep> {
        let secs: Vec<f64> = (0..200).map(|i| 0.1 * f64::from(i)).collect();
        let readings = simulator.scan_along(&secs, |_, _| Pose2::IDENTITY, seed);
        let step = |(secs, ranges): (&f64, &[f32])| DriveStep {
            stamp_secs: *secs,
            odometry: Pose2::IDENTITY,
            reference: Some(Pose2::IDENTITY),
            scan: Scan { ranges: ranges.to_vec() },
        };
        secs.iter().zip(readings.chunks(LASER.beams as usize)).map(step).collect()
    }

    fn in_open(&self, steps: &[DriveStep]) -> InOpen {
        let empty = self.simulator(None);
        in_open(&steps.iter().collect::<Vec<_>>(), empty.laser().laser(), &self.map, Some(&self.walls), None)
            .unwrap()
    }

    fn things(&self, found: &InOpen, steps: &[DriveStep]) -> Option<BlockOptions> {
        let steps: Vec<&DriveStep> = steps.iter().collect();
        let empty = self.simulator(None);
        found.things(&Along::new(&steps, &empty, 7), Some(&self.walls)).unwrap()
    }
}

/// The same in other places in every scan, so that their share is that of the density.
fn anew(things: BlockOptions) -> BlockOptions {
    BlockOptions { resample: BlockResampling::EachObservation, speed_m_s: [0.0; 2], ..things }
}

/// Scans of a simulator have things in the open at a known density, which is found from them. One thing alone is none of these.
#[test]
fn simulated_logs_get_as_many_things_in_the_open_as_a_log_has() {
    let hall = Hall::new(blocks(0.2));
    let simulator = hall.simulator(Some(hall.walls));
    let seen = |things: BlockOptions, seed: u64| {
        Hall::scans(&simulator.clone().with_more_blocks(things).unwrap(), seed)
    };
    let truth = BlockOptions { per_metre_of_wall: 0.03, wall_distance_m: [0.0, 4.0], ..hall.walls };
    let steps = seen(truth, 3);
    let found = hall.in_open(&steps);
    let things = hall.things(&found, &steps).unwrap();
    let refound = hall.in_open(&seen(anew(things), 5));
    let ratio = refound.share / found.share;
    assert!((0.7..1.4).contains(&ratio), "{} {}", found.share, refound.share);
    let one_thing = InOpen { is_one_thing: true, ..found };
    assert!(hall.things(&one_thing, &steps).is_none());
}

/// Legs of 12 cm, and trolleys of about a metre: simulated things show as wide, which nobody has told.
#[test]
fn simulated_things_are_as_wide_as_those_of_a_log() {
    let hall = Hall::new(blocks(0.2));
    let seen = |things: BlockOptions, seed: u64| {
        Hall::scans(&hall.simulator(None).with_more_blocks(things).unwrap(), seed)
    };
    for (sizes, most) in [([0.11, 0.13], [0.0, 0.25]), ([0.9, 1.1], [0.7, 2.0])] {
        let truth = BlockOptions {
            per_metre_of_wall: 0.04,
            length_m: sizes,
            width_m: sizes,
            wall_distance_m: [1.0, 3.5],
            ..hall.walls
        };
        let steps = seen(truth, 3);
        let found = hall.in_open(&steps);
        let things = hall.things(&found, &steps).unwrap();
        let again = hall.in_open(&seen(anew(things), 5));
        let ratio = again.width_m / found.width_m;
        assert!((0.75..1.35).contains(&ratio), "{sizes:?}: {} {}", found.width_m, again.width_m);
        let size = things.length_m[1];
        assert!(most[0] < size && size < most[1], "{sizes:?}: {size}");
    }
}

/// A mast of two beams on the robot itself is in every scan. Things are as wide without it.
#[test]
fn what_a_robot_sees_of_itself_is_no_thing() {
    let hall = Hall::new(blocks(0.2));
    let things = BlockOptions { per_metre_of_wall: 0.02, wall_distance_m: [1.0, 3.5], ..hall.walls };
    let mut steps = Hall::scans(&hall.simulator(None).with_more_blocks(things).unwrap(), 3);
    let without = hall.in_open(&steps).width_m;
    for step in &mut steps {
        (step.scan.ranges[40], step.scan.ranges[41]) = (0.3, 0.3);
    }
    let with = hall.in_open(&steps).width_m;
    assert!((with - without).abs() < 0.02, "{with} {without}");
}

/// A robot that turns through 0.2 s of each sweep, amid a hall with pillars and nothing else: what its beams meet at their own times is the map.
#[test]
fn beams_of_a_sweep_start_where_the_robot_is_by_then() {
    let square = |x: f64, y: f64| Polyline {
        points_m: vec![[x, y], [x + 0.5, y], [x + 0.5, y + 0.5], [x, y + 0.5]],
        ..Polyline::default()
    };
    let corners = [[-6.0, -6.0], [6.0, -6.0], [6.0, 6.0], [-6.0, 6.0]];
    let outline = Polyline { points_m: corners.to_vec(), ..Polyline::default() };
    let obstacles = vec![square(2.0, 1.0), square(-3.0, 2.0), square(0.0, -3.0), square(-2.0, -2.0)];
    let map = VectorMap { outline, obstacles, walls: Vec::new() };
    let map = Arc::new(ExactRangeMap::new(map.to_geometry().unwrap()));
    let laser = LaserOptions { rate_hz: 5.0, scan_secs: 0.2, ..LASER };
    let simulator = Simulator::new(Arc::clone(&map), None, laser, Effects::none()).unwrap();
    let secs: Vec<f64> = (0..100).map(|i| 0.2 * f64::from(i)).collect();
    let pose_at = |secs: f64| Pose2::new(0.1 * secs, 0.0, 0.8 * secs);
    let readings = simulator.scan_along(&secs, |_, secs| pose_at(secs), 3);
    let step = |(secs, ranges): (&f64, &[f32])| DriveStep {
        // Since 1970.
        stamp_secs: 1.7e9 + *secs,
        odometry: pose_at(*secs),
        reference: Some(pose_at(*secs)),
        scan: Scan { ranges: ranges.to_vec() },
    };
    let steps: Vec<DriveStep> = secs.iter().zip(readings.chunks(LASER.beams as usize)).map(step).collect();
    let track = Track::new(steps.iter().map(|step| (step.stamp_secs, step.odometry))).unwrap();
    let way = Way { first_secs: 1.7e9, track: &track };
    let steps: Vec<&DriveStep> = steps.iter().collect();
    let found = |way: Option<&Way<'_>>| in_open(&steps, simulator.laser().laser(), &map, None, way);
    assert!(found(Some(&way)).is_none());
    assert!(found(None).is_some_and(|found| found.is_told));
}

/// Of a scenario without blocks, what stands at walls are blocks, and what stands three to four metres from them is in the open.
#[test]
fn a_scenario_without_blocks_gets_some_and_things_in_the_open() {
    let hall = Hall::new(blocks(0.2));
    let far = BlockOptions { per_metre_of_wall: 0.05, wall_distance_m: [3.0, 4.0], ..hall.walls };
    let at_walls = hall.simulator(Some(hall.walls));
    let everywhere = at_walls.clone().with_more_blocks(far).unwrap();
    let empty = hall.simulator(None);
    let of = |simulator: &Simulator, of_scenario: Option<&BlockOptions>| {
        let steps = Hall::scans(simulator, 3);
        let steps: Vec<&DriveStep> = steps.iter().collect();
        Clutter::of(&steps, None, empty.laser().laser(), &empty, of_scenario, 7).unwrap()
    };
    let without = of(&everywhere, None);
    assert_eq!(without.blocks.unwrap().wall_distance_m, [0.0, AT_WALLS_M]);
    assert!(without.warning.is_some());
    let with = of(&everywhere, Some(&hall.walls));
    assert!(with.blocks.is_none());
    // As many as beside the scenario's blocks.
    let [with, without] = [with, without].map(|found| found.things.unwrap());
    let ratio = without.per_metre_of_wall / with.per_metre_of_wall;
    assert!((0.6..1.6).contains(&ratio), "{without:?} {with:?}");
    let found = of(&at_walls, None);
    assert!(found.blocks.is_some() && found.things.is_none());
}

/// Things amid a hall, three to four metres from its walls, and none nearer. Those of simulated logs keep away from walls, too.
#[test]
fn things_make_no_more_readings_at_walls_than_the_log_has() {
    let hall = Hall::new(blocks(2.0));
    let seen = |things: BlockOptions, seed: u64| {
        Hall::scans(&hall.simulator(None).with_more_blocks(things).unwrap(), seed)
    };
    let truth = BlockOptions { per_metre_of_wall: 0.05, wall_distance_m: [3.0, 4.0], ..hall.walls };
    let steps = seen(truth, 3);
    let found = hall.in_open(&steps);
    let things = hall.things(&found, &steps).unwrap();
    assert!(things.wall_distance_m[0] > 0.0, "{things:?}");
    let [own, again] = [found.share_in_reach, hall.in_open(&seen(anew(things), 3)).share_in_reach];
    assert!(again < 1.3 * own + 0.002, "{again} {own}");
}

/// Off the corner of a rack nothing stands at the rack's own faces: things there are of the wall beyond.
#[test]
fn off_a_corner_things_are_of_the_wall_across() {
    let walls = [[[0.0, 0.0], [2.0, 0.0]], [[0.0, 0.0], [0.0, 2.0]], [[-3.0, -9.0], [-3.0, 9.0]]];
    let walls = walls.map(|wall| wall.map(DVec2::from_array));
    let across = |x: f64, y: f64| across_from(DVec2::new(x, y), &walls);
    assert_eq!(across(1.0, -0.5), Some(0.5));
    assert_eq!(across(-0.5, -0.5), Some(2.5));
    assert_eq!(across(5.0, 5.0), Some(8.0));
    assert_eq!(across(5.0, 12.0), None);
}

/// A post that is seen from both sides, one who walks by within a metre, and two posts.
#[test]
fn one_thing_stays_where_it_is() {
    let at = |scan: usize, x: f64| Open { scan, end: DVec2::new(x, 0.1), distance: 3.0, range: 2.0 };
    let post: Vec<Open> = (0..60).map(|scan| at(scan, if scan < 30 { 0.1 } else { 0.35 })).collect();
    assert!(is_one_thing(&post));
    let walks: Vec<Open> = (0..60).map(|scan| at(scan, 0.05 + 0.015 * scan as f64)).collect();
    assert!(!is_one_thing(&walks));
    let two: Vec<Open> = (0..60).map(|scan| at(scan, 5.0 * (scan % 2) as f64)).collect();
    assert!(!is_one_thing(&two) && !is_one_thing(&[]));
}

#[test]
fn what_walks_in_the_open_is_told() {
    let walks = |i: usize, j: usize| i * 7 % (BEAMS - 2) + j;
    let told_with = |gap_m: f64| told(3, walks, 2.0, Some(&blocks(gap_m)));
    let text = told_with(0.5).unwrap();
    assert!(
        text.starts_with(
            "4.2 % of the readings end where no block of the scenario reaches (0.8 m from a wall)"
        ),
        "{text}"
    );
    // Two metres ahead are four metres to the walls; in the corners it is less.
    assert!(text.contains("most of them within 4.5 m of a wall"), "{text}");
    assert!(text.contains("Simulated logs get as many"), "{text}");
    let found = told_in(6.0, 3, walks, 2.0, Some(&blocks(0.5))).unwrap();
    let one_thing = InOpen { is_one_thing: true, ..found }.warning().unwrap();
    assert!(!one_thing.contains("Simulated logs get as many"), "{one_thing}");
    assert_eq!(told_with(5.0), None);
    assert!(told(3, walks, 2.0, None).unwrap().contains("the scenario has no `blocks`"));
    // Blocks are added where there are none, as far as these readings are or up to a metre. What is farther off is in the open.
    let added = |wall_m: f64, at_m: f32, blocks: Option<&BlockOptions>| {
        told_in(wall_m, 3, walks, at_m, blocks).unwrap().blocks()
    };
    let reach = |wall_m: f64, at_m: f32| added(wall_m, at_m, None).map(|blocks| blocks.wall_distance_m);
    assert_eq!([reach(6.0, 2.0), reach(2.0, 1.6)], [Some([0.0, 1.0]), Some([0.0, 0.8])]);
    assert_eq!(added(6.0, 2.0, Some(&blocks(0.5))), None);
    assert!(told(3, walks, 2.0, None).unwrap().contains("blocks up to 1.0 m from a wall"));
    assert!(
        told(3, walks, 2.0, added(6.0, 2.0, None).as_ref())
            .unwrap()
            .contains("no block of the scenario reaches")
    );
    // Walls beyond the maximum range return nothing, and nothing stands where a reading without return seems to end.
    assert!(told_in(24.0, 0, walks, 2.0, Some(&blocks(0.5))).is_none());
    // What is read where no wall is in reach is something all the same.
    assert!(told_in(40.0, 3, walks, 2.0, Some(&blocks(0.5))).is_some());
    assert!(told_in(40.0, 0, walks, 2.0, Some(&blocks(0.5))).is_none());
    // One beam in a place is a random reading; the same beams at all times see the robot.
    assert_eq!(told(3, |i, j| (i * 7 + 20 * j) % BEAMS, 2.0, Some(&blocks(0.5))), None);
    assert_eq!(told(3, |_, j| j, 2.0, Some(&blocks(0.5))), None);
}
