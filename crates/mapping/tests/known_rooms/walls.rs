//! Maps of walls from simulated scans, whose walls are known.

use std::f32::consts::PI;
use std::f64::consts::TAU;

use glam::DVec2;
use locsim_core::{Draw, Drive, DriveStep, Hits, Laser, Particles, Pose2, RangeMap, Scan, Stage};
use locsim_mapping::{MappingOptions, check_maps, walls_from_drive};
use locsim_world::map::{Geometry, MapError, MeasuredMap, MeasuredWall};
use locsim_world::raycast::ExactRangeMap;
use rand_distr::{Distribution, Normal};

use crate::common::vector_map;

const MAX_RANGE_M: f32 = 10.0;
const NOISE_M: f64 = 0.01;

/// A scan of 360 beams all around, from each pose, in the world that it has there; readings have noise of 1 cm.
fn drive<'a>(scans: impl IntoIterator<Item = (Pose2, &'a Geometry)>) -> Drive {
    let bearings: Vec<f32> = (0..360).map(|i| (i as f32 / 180.0 - 1.0) * PI).collect();
    let laser = Laser::new(bearings, vec![0.0; 360], 0.0, MAX_RANGE_M, Pose2::IDENTITY).unwrap();
    let noise = Normal::new(0.0, NOISE_M).unwrap();
    let steps = scans
        .into_iter()
        .zip(0..)
        .map(|((pose, world), step)| {
            let mut hits = Hits::default();
            let eye: Particles = std::iter::once(pose).collect();
            ExactRangeMap::new(world.clone()).cast(eye.as_poses(), laser.bearings(), MAX_RANGE_M, &mut hits);
            let mut rng = Draw::new(3, Stage::Laser, step).item(0);
            for range in hits.range.iter_mut().filter(|range| **range < MAX_RANGE_M) {
                *range += noise.sample(&mut rng) as f32;
            }
            let scan = Scan { ranges: hits.range };
            DriveStep { stamp_secs: f64::from(step), odometry: Pose2::IDENTITY, reference: Some(pose), scan }
        })
        .collect();
    Drive { laser, steps }
}

/// Poses on an ellipse.
fn ellipse(centre: [f64; 2], radii: [f64; 2], count: u32) -> impl Iterator<Item = Pose2> {
    (0..count).map(move |i| {
        let (sin, cos) = (TAU * f64::from(i) / f64::from(count)).sin_cos();
        Pose2::new(centre[0] + radii[0] * cos, centre[1] + radii[1] * sin, f64::from(i))
    })
}

fn mapped(drive: &Drive) -> MeasuredMap {
    let steps: Vec<usize> = (0..drive.steps.len()).collect();
    walls_from_drive(drive, &steps, &MappingOptions::default()).unwrap()
}

fn ends(wall: &MeasuredWall) -> [DVec2; 2] {
    [wall.from_m, wall.to_m].map(DVec2::from_array)
}

/// How far a wall's line is from a true wall's, on the side that the true wall's normal points to; `None` if it isn't that
/// wall.
fn offset(wall: &MeasuredWall, [a, b]: [DVec2; 2]) -> Option<f64> {
    let [from, to] = ends(wall);
    let tangent = (b - a).normalize();
    let facing = (to - from).normalize().dot(tangent);
    let along = |point: DVec2| (point - a).dot(tangent);
    let within = |point: DVec2| (-0.05..=a.distance(b) + 0.05).contains(&along(point));
    let distance = |point: DVec2| (point - a).dot(tangent.perp());
    let is_it = facing > 0.9 && within(from) && within(to) && distance(0.5 * (from + to)).abs() < 0.05;
    is_it.then(|| distance(0.5 * (from + to)))
}

/// Checks a true wall, given with the laser on its left: walls of the map cover it, and their mean offset, by length, is
/// at most `bias_m`.
fn assert_is_mapped(map: &MeasuredMap, truth: [DVec2; 2], covered: f64, bias_m: f64) {
    let parts: Vec<(f64, f64)> = map
        .walls
        .iter()
        .filter_map(|wall| Some((ends(wall)[0].distance(ends(wall)[1]), offset(wall, truth)?)))
        .collect();
    let length: f64 = parts.iter().map(|part| part.0).sum();
    let bias = parts.iter().map(|(length, offset)| length * offset).sum::<f64>() / length;
    let share = length / truth[0].distance(truth[1]);
    assert!(share >= covered && share <= 1.02, "{truth:?} is covered to {share}: {parts:?}");
    assert!(bias.abs() <= bias_m, "{truth:?} is off by {bias}: {parts:?}");
}

fn sides(corners: &[[f64; 2]]) -> impl Iterator<Item = [DVec2; 2]> {
    (0..corners.len()).map(|i| [corners[i], corners[(i + 1) % corners.len()]].map(DVec2::from_array))
}

const BOX: [[f64; 2]; 4] = [[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]];

/// At 1 cm noise and some hundred readings to a wall, the standard error of an offset is below 0.5 mm; 2 mm is four of them.
#[test]
fn the_walls_of_a_box_are_where_they_are() {
    let world = vector_map(BOX.to_vec(), Vec::new());
    let map = mapped(&drive(ellipse([2.5, 2.0], [1.5, 1.0], 40).map(|pose| (pose, &world))));
    for side in sides(&BOX) {
        assert_is_mapped(&map, side, 0.97, 0.002);
    }
    let geometry = map.to_geometry().unwrap();
    assert!(geometry.walls().len() <= 8, "{:?}", map.walls);
    assert!((geometry.wall_length_m() - 18.0).abs() < 0.2, "{}", geometry.wall_length_m());
    assert!(geometry.is_free(2.5, 2.0) && !geometry.is_free(6.0, 2.0));
    let long = map.walls.iter().filter(|wall| ends(wall)[0].distance(ends(wall)[1]) > 1.0);
    assert!(long.clone().all(|wall| wall.hit_share > 0.95 && wall.sigma_m > 1e-5 && wall.sigma_m < 2e-3));
    assert!(long.count() >= 4);
}

/// A reference whose headings err by up to 1.1 degrees puts readings of a wall at 8 m up to 15 cm off: they are of one wall all the same.
#[test]
fn a_reference_that_turns_makes_no_second_wall() {
    let hall = [[0.0, 0.0], [9.5, 0.0], [9.5, 8.0], [0.0, 8.0]];
    let world = vector_map(hall.to_vec(), Vec::new());
    let mut drive = drive(ellipse([4.75, 4.0], [3.5, 2.5], 200).map(|pose| (pose, &world)));
    for (step, i) in drive.steps.iter_mut().zip(0..) {
        let turn = 0.02 * (2.4 * f64::from(i)).sin();
        step.reference = step.reference.map(|pose| Pose2::new(pose.x, pose.y, pose.theta + turn));
    }
    let map = mapped(&drive);
    for side in sides(&hall) {
        assert_is_mapped(&map, side, 0.95, 0.01);
    }
    let length = map.to_geometry().unwrap().wall_length_m();
    assert!((length - 35.0).abs() < 1.0, "{length}");
}

#[test]
fn a_rotated_and_shifted_world_has_a_rotated_and_shifted_map() {
    let by = Pose2::new(123.4, -56.7, 0.6);
    let corners = BOX.map(|corner| by.transform_point(DVec2::from_array(corner)).to_array());
    let world = vector_map(corners.to_vec(), Vec::new());
    let poses = ellipse([2.5, 2.0], [1.5, 1.0], 40).map(|pose| (by.compose(&pose), &world));
    let map = mapped(&drive(poses));
    for side in sides(&corners) {
        assert_is_mapped(&map, side, 0.97, 0.002);
    }
}

/// A wall of 2 cm, less than a cell, seen from both sides.
#[test]
fn a_thin_wall_has_two_faces() {
    let thin = [[4.0, 2.0], [4.0, 2.02], [0.5, 2.02], [0.5, 2.0]];
    let world = vector_map(BOX.to_vec(), vec![thin.to_vec()]);
    let below = ellipse([2.5, 1.0], [1.8, 0.5], 30);
    let above = ellipse([2.5, 3.0], [1.8, 0.5], 30);
    let map = mapped(&drive(below.chain(above).map(|pose| (pose, &world))));
    let face = |ends: [[f64; 2]; 2]| ends.map(DVec2::from_array);
    assert_is_mapped(&map, face([[4.0, 2.0], [0.5, 2.0]]), 0.95, 0.002);
    assert_is_mapped(&map, face([[0.5, 2.02], [4.0, 2.02]]), 0.95, 0.002);
}

/// Chords of a polygon are up to 1.5 cm inside the circle, where lines are split.
#[test]
fn a_round_pillar_is_a_polygon_around_it() {
    let centre = DVec2::new(2.5, 2.0);
    let circle: Vec<[f64; 2]> =
        (0..90).map(|i| (centre + 0.3 * DVec2::from_angle(TAU * f64::from(i) / 90.0)).to_array()).collect();
    let world = vector_map(BOX.to_vec(), vec![circle]);
    let map = mapped(&drive(ellipse([2.5, 2.0], [1.6, 1.3], 60).map(|pose| (pose, &world))));
    let [truth, made] = [world, map.to_geometry().unwrap()].map(ExactRangeMap::new);
    let mut errors: Vec<f64> = (0..360)
        .map(|i| {
            let out = DVec2::from_angle(TAU * f64::from(i) / 360.0);
            let range = |map: &ExactRangeMap| map.cast_ray(centre + out, -out, 9.0).unwrap().range;
            range(&made) - range(&truth)
        })
        .collect();
    errors.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    assert!(errors[180].abs() < 0.01 && errors[355].abs() < 0.04, "{errors:?}");
}

/// A door that is shut in some of the scans: seldom, and it stays in the map with its share, but has no nominal range;
/// mostly, and it is a part of its wall.
#[test]
fn a_door_is_kept_as_it_was_seen() {
    let open: Vec<[f64; 2]> =
        vec![[0.0, 0.0], [5.0, 0.0], [5.0, 1.5], [8.0, 1.5], [8.0, 2.5], [5.0, 2.5], [5.0, 4.0], [0.0, 4.0]];
    let open = vector_map(open, Vec::new());
    let shut = vector_map(BOX.to_vec(), Vec::new());
    for (shut_in, range) in [(12, 5.5), (30, 2.5)] {
        let poses = ellipse([2.5, 2.0], [1.5, 0.3], 40);
        let world = |i: u32| if i * 7 % 40 < shut_in { &shut } else { &open };
        let map = mapped(&drive(poses.zip(0..).map(|(pose, i)| (pose, world(i)))));
        let casts = ExactRangeMap::new(map.to_geometry().unwrap());
        let hit = casts.cast_ray(DVec2::new(2.5, 2.0), DVec2::X, 9.0).unwrap();
        assert!((hit.range - range).abs() < 0.01, "{shut_in}: {hit:?}");
        let door = [DVec2::new(5.0, 1.5), DVec2::new(5.0, 2.5)];
        let leaf = |wall: &&MeasuredWall| {
            offset(wall, door).is_some() && ends(wall)[0].distance(ends(wall)[1]) > 0.5
        };
        let share = map.walls.iter().find(leaf).map(|leaf| leaf.hit_share);
        assert!(share.is_none_or(|share| (share - 0.3).abs() < 0.07), "{shut_in}: {share:?}");
        assert_eq!(share.is_some(), shut_in == 12);
    }
}

#[test]
fn who_stood_there_in_one_scan_is_no_wall() {
    let world = vector_map(BOX.to_vec(), Vec::new());
    let someone = vec![[3.4, 1.8], [3.8, 1.8], [3.8, 2.2], [3.4, 2.2]];
    let visited = vector_map(BOX.to_vec(), vec![someone]);
    let poses = ellipse([2.5, 2.0], [0.5, 1.0], 40).zip(0..);
    let map = mapped(&drive(poses.map(|(pose, i)| (pose, if i == 20 { &visited } else { &world }))));
    let casts = ExactRangeMap::new(map.to_geometry().unwrap());
    let hit = casts.cast_ray(DVec2::new(2.5, 2.0), DVec2::X, 9.0).unwrap();
    assert!((hit.range - 2.5).abs() < 0.01, "{hit:?}");
}

/// A room beyond a doorway that no scan looked into.
#[test]
fn a_ray_that_leaves_what_was_seen_has_no_nominal_range() {
    let corners = vec![
        [0.0, 0.0],
        [5.0, 0.0],
        [5.0, 1.5],
        [30.0, 1.5],
        [30.0, 2.5],
        [5.0, 2.5],
        [5.0, 4.0],
        [0.0, 4.0],
    ];
    let world = vector_map(corners, Vec::new());
    let map = mapped(&drive(ellipse([2.5, 2.0], [1.5, 1.0], 40).map(|pose| (pose, &world))));
    let geometry = map.to_geometry().unwrap();
    let casts = ExactRangeMap::new(geometry.clone());
    let meets = |direction: DVec2| casts.cast_ray(DVec2::new(2.5, 2.0), direction, 40.0).unwrap();
    let unknown = meets(DVec2::X);
    assert!(geometry.is_unknown(unknown.surface) && unknown.range > 2.5, "{unknown:?}");
    assert_eq!(geometry.surface_names()[unknown.surface as usize], "unknown");
    let wall = meets(-DVec2::X);
    assert!(!geometry.is_unknown(wall.surface) && (wall.range - 2.5).abs() < 0.01, "{wall:?}");
    assert!(geometry.walls().len() < geometry.segments().len());
    assert!(!world.is_unknown(0), "a drawn map has no such border");
}

/// Cells are off by about half of their width, walls by less than the noise.
#[test]
fn held_out_scans_tell_which_map_is_better() {
    let world = vector_map(BOX.to_vec(), Vec::new());
    let drive = drive(ellipse([2.53, 2.01], [1.5, 1.0], 100).map(|pose| (pose, &world)));
    let steps: Vec<usize> = (0..100).collect();
    let check = check_maps(&drive, &steps, &MappingOptions::default()).unwrap().unwrap();
    assert_eq!((check.scans, check.readings.len()), (20, 20 * 360));
    // The median of |N(0, 1 cm)| is 6.7 mm.
    assert!((check.walls.median_abs_m - 0.0067).abs() < 0.0005, "{:?}", check.walls);
    assert!(check.walls.median_m.abs() < 0.001 && check.walls.far_share < 0.002, "{:?}", check.walls);
    assert!(check.walls.nominal_share > 0.995, "{:?}", check.walls);
    assert!(check.walls_aligned.median_abs_m < 0.007, "{:?}", check.walls_aligned);
    assert!(check.cells.median_m > 0.01, "{:?}", check.cells);
    let few = check_maps(&drive, &steps[..15], &MappingOptions::default()).unwrap();
    assert!(few.is_none(), "nothing is held out");
}

#[test]
fn drives_without_use_are_refused() {
    let world = vector_map(BOX.to_vec(), Vec::new());
    let mut drive = drive(ellipse([2.5, 2.0], [1.5, 1.0], 3).map(|pose| (pose, &world)));
    let mut map = |x: f64| {
        drive.steps[0].reference = Some(Pose2::new(x, 0.0, 0.0));
        walls_from_drive(&drive, &[0, 1], &MappingOptions::default())
    };
    assert!(matches!(map(1e300), Err(MapError::Origin(_))));
    assert!(matches!(map(-1e6), Err(MapError::Extent { .. })));
    assert!(map(f64::NAN).is_ok());
    let nothing = walls_from_drive(&drive, &[], &MappingOptions::default());
    assert!(matches!(nothing, Err(MapError::NoReference { steps: 0 })));
    drive.steps[1].scan.ranges.fill(f32::NAN);
    let nothing = walls_from_drive(&drive, &[1], &MappingOptions::default());
    assert!(matches!(nothing, Err(MapError::NoReference { steps: 1 })));
}
