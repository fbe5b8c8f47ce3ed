//! Ray casts against slower or independent ways to know the answer.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec2;
use locsim_core::{DistanceMap, Draw, Hits, NO_SURFACE, Particles, Pose2, RangeMap, Stage};
use locsim_world::map::{Cell, Geometry, MapError, OccupancyGrid};
use locsim_world::raycast::{DistanceGrid, ExactRangeMap, SurfaceTable};
use proptest::prelude::*;
use rand::RngExt;

use crate::common;

fn square_room() -> ExactRangeMap {
    let outline = vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
    ExactRangeMap::new(common::vector_map(outline, Vec::new()))
}

/// A grid with random occupied cells: clutter with many shared corners.
fn cluttered(seed: u64) -> Geometry {
    let (width, height) = (40, 30);
    let mut rng = Draw::new(seed, Stage::Blocks, 0).item(0);
    let cells: Vec<Cell> =
        (0..width * height).map(|_| if rng.random_bool(0.1) { Cell::Occupied } else { Cell::Free }).collect();
    let occupancy = vec![0.5; cells.len()];
    let origin = Pose2::new(-3.0, 2.0, 0.4);
    OccupancyGrid::new(width, height, 0.25, origin, cells, occupancy).unwrap().to_geometry()
}

/// Range by solving origin + t direction = a + u (b - a) for every segment (Cramer's rule).
fn brute_force(geometry: &Geometry, origin: DVec2, direction: DVec2) -> Option<f64> {
    let ranges = geometry.segments().iter().filter_map(|&[a, b]| {
        let (edge, start) = (b - a, a - origin);
        let determinant = direction.perp_dot(edge);
        let t = start.perp_dot(edge) / determinant;
        let u = start.perp_dot(direction) / determinant;
        (t >= 0.0 && (0.0..=1.0).contains(&u)).then_some(t)
    });
    ranges.min_by(f64::total_cmp)
}

fn random_poses(n: u32, [x0, y0, x1, y1]: [f64; 4]) -> Particles {
    let draw = Draw::new(5, Stage::Initial, 0);
    (0..n)
        .map(|i| {
            let mut rng = draw.item(i);
            Pose2::new(rng.random_range(x0..x1), rng.random_range(y0..y1), rng.random_range(-PI..PI))
        })
        .collect()
}

fn bearings(n: u16) -> Vec<f32> {
    (0..n).map(|i| f32::from(i) * std::f32::consts::TAU / f32::from(n)).collect()
}

proptest! {
    #[test]
    fn exact_casts_agree_with_brute_force(
        seed in 0..20_u64, x in -12.0..12.0, y in -6.0..14.0, heading in 0.0..TAU,
    ) {
        let map = ExactRangeMap::new(cluttered(seed));
        let (origin, direction) = (DVec2::new(x, y), DVec2::from_angle(heading));
        let expected = brute_force(map.geometry(), origin, direction);
        let hit = map.cast_ray(origin, direction, f64::INFINITY);
        prop_assert_eq!(hit.is_some(), expected.is_some());
        if let (Some(hit), Some(expected)) = (hit, expected) {
            prop_assert!((hit.range - expected).abs() < 1e-9, "{} for {expected}", hit.range);
            let [a, b] = map.geometry().segments()[hit.surface as usize];
            let normal = (b - a).normalize().perp();
            prop_assert!((hit.incidence.cos() - normal.dot(direction).abs()).abs() < 1e-9);
            // Nothing else within a shorter range, and the same hit within a longer one.
            prop_assert_eq!(map.cast_ray(origin, direction, hit.range), None);
            prop_assert_eq!(map.cast_ray(origin, direction, hit.range + 1e-6), Some(hit));
        }
    }

    #[test]
    fn distances_are_those_to_the_nearest_point_of_any_segment(x in -4.0..6.0, y in 1.0..9.0) {
        let geometry = cluttered(3);
        let grid = DistanceGrid::new(&geometry, 0.1, 2.0).unwrap();
        let point = DVec2::new(x, y);
        // Points 1 mm apart along every segment.
        let nearest = geometry
            .segments()
            .iter()
            .flat_map(|&[a, b]| {
                let steps = (a.distance(b) / 1e-3).ceil();
                (0..=steps as u32).map(move |i| a.lerp(b, f64::from(i) / steps).distance(point))
            })
            .fold(2.0, f64::min);
        let distance = f64::from(grid.distance(x, y));
        prop_assert!((distance - nearest).abs() < 0.071 + 1e-3, "{distance} for {nearest}");
    }
}

/// Rays aimed exactly at vertices, from many places in all directions: each must meet the vertex, or something
/// nearer. A test that asks two neighbouring segments separately loses about a fifth of these.
#[test]
fn no_ray_slips_through_a_vertex() {
    for geometry in [common::corridor(), cluttered(1)] {
        let map = ExactRangeMap::new(geometry);
        for origin in random_poses(200, map.bounds()).iter() {
            for &[vertex, _] in map.geometry().segments() {
                let to_vertex = vertex - origin.position();
                let hit = map.cast_ray(origin.position(), to_vertex.normalize(), f64::INFINITY);
                let range = hit.map_or(f64::INFINITY, |hit| hit.range);
                assert!(range <= to_vertex.length() + 1e-6, "{origin:?} misses {vertex}");
            }
        }
    }
}

#[test]
fn grazing_rays_meet_long_walls() {
    let outline = vec![[0.0, 0.0], [50.0, 0.0], [50.0, 2.0], [0.0, 2.0]];
    let map = ExactRangeMap::new(common::vector_map(outline, Vec::new()));
    for i in 1..2000 {
        // From 1 m above the wall towards a point on it, up to 49.9 m away and 20 micrometres high.
        let (x, y) = (f64::from(i) * 0.024, 2e-5 * f64::from(i));
        let origin = DVec2::new(0.5, y);
        let target = DVec2::new(0.5 + x, 0.0);
        let hit = map.cast_ray(origin, (target - origin).normalize(), 100.0).unwrap();
        assert!((hit.range - origin.distance(target)).abs() < 1e-8, "at {x} m: {hit:?}");
        assert_eq!(hit.surface, 0);
    }
}

#[test]
fn a_surface_at_exactly_the_maximum_range_is_no_return() {
    let map = square_room();
    let laser: Particles = std::iter::once(Pose2::new(1.0, 2.0, 0.0)).collect();
    let mut hits = Hits::default();
    for (max_range, expected) in [(3.5, (3.0, 0.0, 1)), (3.0, (3.0, 0.0, NO_SURFACE))] {
        for map in [&map as &dyn RangeMap, &SurfaceTable::new(&map, 0.5, 16).unwrap()] {
            map.cast(laser.view(), &[0.0], max_range, &mut hits);
            assert_eq!((hits.range[0], hits.incidence[0], hits.surface[0]), expected);
        }
    }
}

#[test]
fn rays_from_outside_the_map_and_from_inside_a_wall_hit_what_is_in_front() {
    let outline = vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
    let pillar = vec![[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]];
    let map = ExactRangeMap::new(common::vector_map(outline, vec![pillar]));
    let range = |x, y| map.cast_ray(DVec2::new(x, y), DVec2::X, 10.0).map(|hit| hit.range);
    assert_eq!(range(-3.0, 0.5), Some(3.0));
    assert_eq!(range(1.25, 1.5), Some(0.75));
    assert_eq!(range(5.0, 0.5), None);
    assert_eq!(range(f64::NAN, 0.5), None);
    // On a wall.
    assert_eq!(range(0.0, 0.5), Some(0.0));
}

/// Along an axis, past the end of a wall by just less than walls overlap and by more: there, on the edges of boxes,
/// a slab's bound is zero times infinity.
#[test]
fn a_ray_past_the_end_of_a_wall_meets_it_within_the_overlap() {
    let map = square_room();
    for (origin, direction) in [
        (DVec2::new(5.0, 0.0), -DVec2::X),
        (DVec2::new(-1.0, 4.0), DVec2::X),
        (DVec2::new(0.0, 5.0), -DVec2::Y),
        (DVec2::new(4.0, -1.0), DVec2::Y),
    ] {
        // Out of the room, whose middle is (2, 2).
        let outward = direction.perp() * direction.perp().dot(origin - DVec2::splat(2.0)).signum();
        let cast = |past_m: f64| map.cast_ray(origin + past_m * outward, direction, 10.0);
        let hit = cast(0.999e-9);
        assert!(hit.is_some_and(|hit| (hit.range - 1.0).abs() < 1e-8), "{origin} {direction}: {hit:?}");
        assert_eq!([cast(2e-9), cast(1e-8)], [None; 2], "{origin} {direction}");
    }
}

#[test]
fn segments_that_the_map_does_not_know_are_met_without_a_surface() {
    let map = square_room();
    let extra = [[DVec2::new(3.0, 0.0), DVec2::new(3.0, 4.0)], [DVec2::new(9.0, 0.0), DVec2::new(9.0, 4.0)]];
    let cast = |direction| map.cast_ray_with(&extra, DVec2::new(1.0, 2.0), direction, 10.0).unwrap();
    assert_eq!((cast(DVec2::X).range, cast(DVec2::X).surface), (2.0, NO_SURFACE));
    assert_eq!((cast(-DVec2::X).range, cast(-DVec2::X).surface), (1.0, 3));
}

#[test]
fn a_ray_along_a_segment_meets_its_nearest_point() {
    let map = square_room();
    let along = [[DVec2::new(3.0, 2.0), DVec2::new(2.0, 2.0)]];
    for (x, expected) in [(1.0, 1.0), (2.5, 0.0), (3.5, 0.5)] {
        let hit = map.cast_ray_with(&along, DVec2::new(x, 2.0), DVec2::X, 10.0).unwrap();
        let (incidence, surface) = if x > 3.0 { (0.0, 1) } else { (FRAC_PI_2, NO_SURFACE) };
        assert_eq!((hit.range, hit.incidence, hit.surface), (expected, incidence, surface));
    }
}

#[test]
fn batches_are_single_casts_in_pose_major_order() {
    let map = ExactRangeMap::new(common::corridor());
    // More rays than are cast on one thread, more beams than are prepared at once.
    let (poses, bearings, max_range) = (random_poses(70, map.bounds()), bearings(130), 4.5);
    let mut hits = Hits::default();
    map.cast(poses.view(), &bearings, max_range, &mut hits);
    assert_eq!(hits.len(), 70 * 130);
    for (i, pose) in poses.iter().enumerate() {
        for (j, &bearing) in bearings.iter().enumerate() {
            let direction = DVec2::from_angle(pose.theta + f64::from(bearing));
            let hit = map.cast_ray(pose.position(), direction, f64::from(max_range));
            let expected = hit.map_or(max_range, |hit| hit.range as f32);
            assert!((hits.range[i * 130 + j] - expected).abs() < 1e-5);
        }
    }
    map.cast(poses.view(), &[], max_range, &mut hits);
    assert!(hits.is_empty());
}

/// Wrong ranges are measured to be 2 of 120,000 in the corridor, and 141 where a tenth of all cells is occupied at
/// random, which is worse than any building.
#[test]
fn table_ranges_are_exact_but_for_slivers() {
    for (geometry, most) in [(common::corridor(), 1e-4), (cluttered(2), 2e-3)] {
        let exact = ExactRangeMap::new(geometry);
        let table = SurfaceTable::new(&exact, 0.1, 128).unwrap();
        let (poses, bearings) = (random_poses(2000, exact.bounds()), bearings(60));
        let (mut expected, mut hits) = (Hits::default(), Hits::default());
        exact.cast(poses.view(), &bearings, 30.0, &mut expected);
        table.cast(poses.view(), &bearings, 30.0, &mut hits);
        let mut wrong = 0;
        for i in 0..hits.len() {
            let error = hits.range[i] - expected.range[i];
            if error.abs() > 1e-6 * expected.range[i].max(1.0) {
                wrong += 1;
                assert!(error > 0.0, "a sliver is missed, so a range can only be too long");
            } else if hits.surface[i] == expected.surface[i] {
                // Elsewhere two surfaces meet at a corner, and the incidence is that of either.
                assert!((hits.incidence[i] - expected.incidence[i]).abs() < 1e-5);
            }
        }
        let share = f64::from(wrong) / hits.len() as f64;
        assert!(share < most, "{wrong} of {} rays are wrong", hits.len());
    }
}

#[test]
fn the_table_does_not_depend_on_the_number_of_threads() {
    let exact = ExactRangeMap::new(common::corridor());
    let poses = random_poses(300, exact.bounds());
    let cast_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut hits = Hits::default();
        pool.install(|| {
            let table = SurfaceTable::new(&exact, 0.2, 64).unwrap();
            table.cast(poses.view(), &bearings(60), 30.0, &mut hits);
        });
        hits
    };
    let one = cast_with(1);
    assert_eq!(one, cast_with(2));
    assert_eq!(one, cast_with(8));
}

#[test]
fn impossible_table_sizes_are_refused() {
    let exact = square_room();
    for cell_m in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(SurfaceTable::new(&exact, cell_m, 64), Err(MapError::Resolution(_))));
    }
    assert!(matches!(SurfaceTable::new(&exact, 1e-6, 64), Err(MapError::Extent { .. })));
    assert!(matches!(DistanceGrid::new(exact.geometry(), 0.1, f64::INFINITY), Err(MapError::Extent { .. })));
}

#[test]
fn a_map_without_walls_returns_nothing() {
    let grid = OccupancyGrid::new(2, 1, 1.0, Pose2::IDENTITY, vec![Cell::Free; 2], vec![0.0; 2]).unwrap();
    let exact = ExactRangeMap::new(grid.to_geometry());
    assert_eq!(exact.cast_ray(DVec2::splat(0.5), DVec2::X, f64::INFINITY), None);
    let table = SurfaceTable::new(&exact, 0.5, 16).unwrap();
    let mut hits = Hits::default();
    table.cast(random_poses(3, [0.0, 0.0, 2.0, 1.0]).view(), &bearings(4), 5.0, &mut hits);
    assert!(hits.range.iter().all(|&range| range == 5.0));
    assert_eq!(DistanceGrid::new(exact.geometry(), 0.1, 1.0).unwrap().distance(1.0, 0.5), 1.0);
}

#[test]
fn distances_saturate_and_reach_behind_walls() {
    let grid = DistanceGrid::new(square_room().geometry(), 0.05, 1.0).unwrap();
    assert!((grid.distance(0.5, 2.0) - 0.5).abs() < 1e-6);
    assert!((grid.distance(-0.5, 2.0) - 0.5).abs() < 1e-6);
    assert_eq!(grid.distance(2.0, 2.0), 1.0);
    assert_eq!(grid.distance(100.0, 2.0), 1.0);
    assert_eq!(grid.distance(f64::NAN, 2.0), 1.0);
}
