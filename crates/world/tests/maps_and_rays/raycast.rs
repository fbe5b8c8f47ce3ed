//! Ray casts against slower or independent ways to know the answer.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec2;
use locsim_core::{
    DistanceMap, Draw, Hits, LikelihoodGrid, LikelihoodTable, NO_SURFACE, Particles, Pose2, PreparedScan,
    RangeMap, Stage,
};
use locsim_world::map::{Cell, Geometry, MapError, OccupancyGrid};
use locsim_world::raycast::{DistanceGrid, ExactRangeMap, RangeTable, RangeTableOptions, Vicinity};
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
    OccupancyGrid::new(width, height, 0.25, origin, cells, occupancy).unwrap().to_geometry().unwrap()
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
        for map in [&map as &dyn RangeMap, &table(&map, 0.5)] {
            map.cast(laser.as_poses(), &[0.0], max_range, &mut hits);
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
    map.cast(poses.as_poses(), &bearings, max_range, &mut hits);
    assert_eq!(hits.len(), 70 * 130);
    for (i, pose) in poses.iter().enumerate() {
        for (j, &bearing) in bearings.iter().enumerate() {
            let direction = DVec2::from_angle(pose.theta + f64::from(bearing));
            let hit = map.cast_ray(pose.position(), direction, f64::from(max_range));
            let expected = hit.map_or(max_range, |hit| hit.range as f32);
            assert!((hits.range[i * 130 + j] - expected).abs() < 1e-5);
        }
    }
    map.cast(poses.as_poses(), &[], max_range, &mut hits);
    assert!(hits.is_empty());
}

fn table(map: &ExactRangeMap, cell_m: f64) -> RangeTable {
    RangeTable::new(map, &RangeTableOptions { cell_m, ..RangeTableOptions::default() }, &|_| ()).unwrap()
}

/// The table against exact casts from random poses: a bound on the share of ranges that are off by more than
/// rounding, and one on the mean error (m). Measured are 0.14 % and 0.4 mm in the corridor, 1.6 % and 64 mm where a
/// tenth of all cells is occupied at random, which is worse than any building.
#[test]
fn table_ranges_are_exact_but_for_slivers() {
    for (geometry, most_wrong, most_error_m) in [(common::corridor(), 3e-3, 1e-3), (cluttered(2), 5e-2, 0.2)]
    {
        let exact = ExactRangeMap::new(geometry);
        let table = table(&exact, 0.1);
        let (poses, bearings) = (random_poses(2000, exact.bounds()), bearings(60));
        let (mut expected, mut hits) = (Hits::default(), Hits::default());
        exact.cast(poses.as_poses(), &bearings, 30.0, &mut expected);
        table.cast(poses.as_poses(), &bearings, 30.0, &mut hits);
        let (mut wrong, mut sum, mut count) = (0, 0.0, 0);
        let is_free = |pose: Pose2| exact.is_free(pose.x, pose.y);
        for i in (0..hits.len()).filter(|i| is_free(poses.get(i / bearings.len()))) {
            count += 1;
            let error = (hits.range[i] - expected.range[i]).abs();
            sum += f64::from(error);
            if error > 2e-5 * expected.range[i].max(1.0) / expected.incidence[i].cos().max(0.02) {
                wrong += 1;
            } else if hits.surface[i] == expected.surface[i] {
                // Elsewhere two surfaces meet at a corner, and the incidence is that of either.
                assert!((hits.incidence[i] - expected.incidence[i]).abs() < 1e-5);
            }
        }
        let (share, mean) = (f64::from(wrong) / f64::from(count), sum / f64::from(count));
        assert!(share < most_wrong, "{wrong} of {count} rays are wrong");
        assert!(mean < most_error_m, "ranges are off by {mean} m on average");
    }
}

/// The fused path of a table gives the same sums as its casts, looked up beam by beam.
#[test]
fn a_scan_is_scored_as_its_casts_say() {
    let exact = ExactRangeMap::new(common::corridor());
    let table = table(&exact, 0.1);
    let grid = LikelihoodGrid { max_range: 4.5, reach: 6.75, step_m: 0.05 };
    let (ranges, incidences) = grid.states();
    let density = |z: f32, r: f32, a: f32| -(z - r).powi(2) - 0.1 * a;
    let values: Vec<f32> = (0..grid.rows())
        .flat_map(|row| ranges.iter().zip(&incidences).map(move |(&r, &a)| density(grid.reading(row), r, a)))
        .collect();
    let likelihood = LikelihoodTable::new(grid, &values);
    // Poses in the walls and outside, a beam count that fills no run, a NaN reading, and one of no return.
    let (poses, bearings) = (random_poses(500, [-0.5, -0.5, 20.5, 4.5]), bearings(23));
    let mut z: Vec<f32> = (0..23).map(|i| 0.2 * i as f32).collect();
    z[7] = f32::NAN;
    let mut scan = PreparedScan::default();
    scan.prepare(&bearings, &z, &likelihood);
    let (mut hits, mut fused) = (Hits::default(), vec![0.0; poses.len()]);
    table.log_likelihood(poses.as_poses(), &scan, &likelihood, &mut hits, &mut fused);
    table.cast(poses.as_poses(), &bearings, 6.75, &mut hits);
    let mut differing = 0;
    for (i, fused) in fused.iter().enumerate() {
        let by_beam: f64 = (0..23)
            .filter(|&j| j != 7)
            .map(|j| {
                let hit = i * 23 + j;
                f64::from(likelihood.log_density(z[j], hits.range[hit], hits.incidence[hit].cos()))
            })
            .sum();
        // A state half way between two knots may fall to the other by rounding: up to 2 |z - r| 5 cm.
        assert!((by_beam - fused).abs() < 0.7, "pose {i}: {by_beam} and {fused}");
        differing += usize::from((by_beam - fused).abs() > 1e-3);
    }
    assert!(differing <= 5, "{differing} of 500 poses differ");
}

#[test]
fn the_table_does_not_depend_on_the_number_of_threads() {
    let exact = ExactRangeMap::new(common::corridor());
    let poses = random_poses(300, exact.bounds());
    let cast_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut hits = Hits::default();
        pool.install(|| {
            table(&exact, 0.2).cast(poses.as_poses(), &bearings(60), 30.0, &mut hits);
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
        let options = RangeTableOptions { cell_m, ..RangeTableOptions::default() };
        assert!(matches!(RangeTable::new(&exact, &options, &|_| ()), Err(MapError::Resolution(_))));
    }
    assert!(matches!(DistanceGrid::new(exact.geometry(), 0.1, f64::INFINITY), Err(MapError::Extent { .. })));
}

#[test]
fn a_table_that_does_not_fit_gets_larger_cells() {
    let exact = square_room();
    let options = RangeTableOptions { cell_m: 1e-4, most_bytes: 1 << 20, ..RangeTableOptions::default() };
    let table = RangeTable::new(&exact, &options, &|_| ()).unwrap();
    assert!(table.bytes() <= 1 << 20 && table.bytes() > 1 << 17, "{} bytes", table.bytes());
    // Cells are doubled until the table fits, and no further.
    let finer = RangeTableOptions { cell_m: 0.5 * table.cell_m(), most_bytes: usize::MAX, ..options };
    let finer = RangeTable::new(&exact, &finer, &|_| ()).unwrap();
    assert_eq!(finer.cell_m(), 0.5 * table.cell_m());
    assert!(finer.bytes() > 1 << 20, "{} bytes of {} m", finer.bytes(), finer.cell_m());
    let options = RangeTableOptions { cell_m: 1.0, most_bytes: 2000, ..RangeTableOptions::default() };
    let table = RangeTable::new(&exact, &options, &|_| ()).unwrap();
    assert!(table.bytes() < 2000);
    let (poses, bearings) = (random_poses(20, exact.bounds()), bearings(30));
    let (mut expected, mut hits) = (Hits::default(), Hits::default());
    exact.cast(poses.as_poses(), &bearings, 30.0, &mut expected);
    table.cast(poses.as_poses(), &bearings, 30.0, &mut hits);
    assert!(
        hits.range.iter().zip(&expected.range).all(|(a, b)| (a - b).abs() < 1e-5),
        "without a table, casts are exact"
    );
}

/// A table of a vicinity answers like the whole one inside, and like exact casts outside.
#[test]
fn a_table_may_hold_the_vicinity_of_a_drive_only() {
    let exact = ExactRangeMap::new(cluttered(2));
    let options = RangeTableOptions::default();
    let whole = RangeTable::new(&exact, &options, &|_| ()).unwrap();
    let [x0, y0, x1, y1] = exact.bounds();
    let vicinity = Vicinity {
        points: &[[x0 + 0.3 * (x1 - x0), y0 + 0.1 * (y1 - y0)], [1e300, -1e300]],
        distance_m: 2.0,
    };
    let near = RangeTable::near(&exact, &options, Some(vicinity), None, &|_| ()).unwrap();
    assert!(near.bytes() < whole.bytes() / 2, "{} of {} bytes", near.bytes(), whole.bytes());
    let bearings = bearings(30);
    let cell = options.cell_m;
    let (mut inside, mut outside, mut wrong) = (0, 0, 0);
    for pose in random_poses(2000, exact.bounds()).iter() {
        let cast = |map: &dyn RangeMap| {
            let mut hits = Hits::default();
            map.cast(Particles::from_iter([pose]).as_poses(), &bearings, 30.0, &mut hits);
            hits.range
        };
        let [x, y] = vicinity.points[0];
        let distance = pose.position().distance(DVec2::new(x, y));
        if distance < 2.0 - cell {
            inside += 1;
            assert_eq!(cast(&near), cast(&whole));
        } else if distance > 2.0 + cell {
            outside += bearings.len();
            wrong += cast(&near).iter().zip(cast(&exact)).filter(|(a, b)| (*a - b).abs() > 1e-4).count();
        }
    }
    // Directions are rounded to f32, which decides at corners. The whole table is wrong on 1.6 % here.
    assert!(
        inside > 20 && wrong < outside / 1000,
        "{inside} poses inside; {wrong} of {outside} ranges outside"
    );
}

/// A cached table answers like the one that was built, whatever has happened to its file.
#[test]
fn a_cached_table_is_the_built_one_or_is_built_anew() {
    let folder = tempfile::tempdir().unwrap();
    let exact = ExactRangeMap::new(common::corridor());
    let cached = |options: &RangeTableOptions| {
        let table = RangeTable::cached(&exact, options, Some(folder.path()), &|_| ()).unwrap();
        let (poses, mut hits) = (random_poses(100, exact.bounds()), Hits::default());
        table.cast(poses.as_poses(), &bearings(60), 30.0, &mut hits);
        hits
    };
    let files = || {
        let mut files: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|file| file.unwrap().path()).collect();
        files.sort();
        files
    };
    let options = RangeTableOptions { cell_m: 0.4, ..RangeTableOptions::default() };
    let built = cached(&options);
    let [file] = &files()[..] else { panic!("one file is kept") };
    let content = std::fs::read(file).unwrap();
    assert_eq!(cached(&options), built);
    let mut altered = content.clone();
    altered[5000] ^= 1;
    for damaged in [&altered[..], &content[..content.len() / 2], &[]] {
        std::fs::write(file, damaged).unwrap();
        assert_eq!(cached(&options), built);
        assert_eq!(std::fs::read(file).unwrap(), content, "the damaged file is replaced");
    }
    // A pipe in its place isn't waited for.
    #[cfg(unix)]
    {
        std::fs::remove_file(file).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(file).status().unwrap().success());
        assert_eq!(cached(&options), built);
        assert_eq!(std::fs::read(file).unwrap(), content, "the pipe is replaced");
    }
    // A file under another table's name isn't taken for it.
    let other = RangeTableOptions { cell_m: 0.8, ..options };
    let built_other = cached(&other);
    let [a, b] = &files()[..] else { panic!("another table has another file") };
    let other_file = if a == file { b } else { a };
    std::fs::copy(file, other_file).unwrap();
    assert_eq!(cached(&other), built_other);
}

/// A file with a right hash whose numbers stand for nothing there is.
#[test]
fn a_cached_table_of_absurd_content_is_built_anew() {
    const START: usize = 24 + 32;
    let folder = tempfile::tempdir().unwrap();
    let exact = ExactRangeMap::new(common::corridor());
    let options = RangeTableOptions { cell_m: 0.4, ..RangeTableOptions::default() };
    let cached = || {
        let table = RangeTable::cached(&exact, &options, Some(folder.path()), &|_| ()).unwrap();
        let (poses, mut hits) = (random_poses(100, exact.bounds()), Hits::default());
        table.cast(poses.as_poses(), &bearings(60), 30.0, &mut hits);
        hits
    };
    let built = cached();
    let file = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let sound = std::fs::read(&file).unwrap();
    let words: Vec<u32> =
        sound[START..sound.len() - 32].as_chunks().0.iter().map(|&bytes| u32::from_ne_bytes(bytes)).collect();
    // Where the length of each of the five parts stands.
    let mut lengths = vec![0];
    for part in 0..4 {
        lengths.push(lengths[part] + 1 + words[lengths[part]] as usize);
    }
    let mut changes: Vec<(usize, u32)> = lengths.iter().map(|&at| (at, u32::MAX)).collect();
    changes.extend(lengths.iter().map(|&at| (at, words[at] + 3)));
    changes.extend(lengths.iter().map(|&at| (at, 0)));
    // A row, an entry, a wall and the corner of a sight, the length of a list, a wall of a list.
    for at in [lengths[0] + 1, lengths[1] + 1, lengths[2] + 1, lengths[2] + 3, lengths[3] + 1, lengths[4] + 1]
    {
        changes.extend([1_000_000, u32::MAX - 1].map(|value| (at, value)));
    }
    for (at, value) in changes {
        let mut words = words.clone();
        words[at] = value;
        let mut content = sound[..START].to_vec();
        content.extend(words.iter().flat_map(|word| word.to_ne_bytes()));
        let hash = blake3::hash(&content);
        content.extend(hash.as_bytes());
        std::fs::write(&file, &content).unwrap();
        assert_eq!(cached(), built, "word {at} is {value}");
        assert_eq!(std::fs::read(&file).unwrap(), sound, "word {at} is {value}: the file stays");
    }
}

/// A table that is read counts as used.
#[test]
fn reading_a_cached_table_moves_its_time_of_change() {
    let folder = tempfile::tempdir().unwrap();
    let exact = square_room();
    let options = RangeTableOptions { cell_m: 0.4, ..RangeTableOptions::default() };
    let cached = || RangeTable::cached(&exact, &options, Some(folder.path()), &|_| ()).unwrap();
    cached();
    let path = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let file = std::fs::File::options().write(true).open(&path).unwrap();
    file.set_modified(std::time::SystemTime::UNIX_EPOCH).unwrap();
    cached();
    assert!(path.metadata().unwrap().modified().unwrap() > std::time::SystemTime::UNIX_EPOCH);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_map_without_walls_returns_nothing() {
    let grid = OccupancyGrid::new(2, 1, 1.0, Pose2::IDENTITY, vec![Cell::Free; 2], vec![0.0; 2]).unwrap();
    let exact = ExactRangeMap::new(grid.to_geometry().unwrap());
    assert_eq!(exact.cast_ray(DVec2::splat(0.5), DVec2::X, f64::INFINITY), None);
    let table = table(&exact, 0.5);
    let mut hits = Hits::default();
    table.cast(random_poses(3, [0.0, 0.0, 2.0, 1.0]).as_poses(), &bearings(4), 5.0, &mut hits);
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
