//! Mapping a simulated room, whose walls are known.

use std::f32::consts::PI;

use glam::DVec2;
use locsim_core::{Drive, DriveStep, Hits, Laser, Particles, Pose2, RangeMap, Scan};
use locsim_mapping::{MappingOptions, occupancy_from_drive};
use locsim_world::map::{Cell, MapError, OccupancyGrid};
use locsim_world::raycast::ExactRangeMap;

use crate::common;

const MAX_RANGE_M: f32 = 6.0;

/// Scans from a square of poses in a room of 5 m x 4 m with a pillar.
fn drive() -> Drive {
    let outline = vec![[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]];
    let pillar = vec![[2.3, 1.8], [2.7, 1.8], [2.7, 2.2], [2.3, 2.2]];
    let map = ExactRangeMap::new(common::vector_map(outline, vec![pillar]));
    let bearings: Vec<f32> = (0..180).map(|i| (i as f32 / 179.0 - 0.5) * PI).collect();
    let base_from_laser = Pose2::new(0.2, 0.0, 0.0);
    let laser = Laser::new(bearings, vec![0.0; 180], 0.0, MAX_RANGE_M, base_from_laser).unwrap();
    let steps = (0..64)
        .map(|i| {
            let angle = f64::from(i) / 64.0 * std::f64::consts::TAU;
            let pose = Pose2::new(2.5 + 1.2 * angle.cos(), 2.0 + 1.2 * angle.sin(), 3.0 * angle);
            let mut hits = Hits::default();
            let eye: Particles = std::iter::once(pose.compose(&base_from_laser)).collect();
            map.cast(eye.as_poses(), laser.bearings(), MAX_RANGE_M, &mut hits);
            DriveStep {
                stamp_secs: f64::from(i),
                odometry: Pose2::IDENTITY,
                reference: Some(pose),
                scan: Scan { ranges: hits.range },
            }
        })
        .collect();
    Drive { laser, steps }
}

fn all_steps(drive: &Drive) -> Vec<usize> {
    (0..drive.steps.len()).collect()
}

#[test]
fn the_walls_of_a_room_are_recovered_within_a_cell() {
    let drive = drive();
    let options = MappingOptions::default();
    let grid = occupancy_from_drive(&drive, &all_steps(&drive), &options).unwrap();
    // Every occupied cell lies on a wall or the pillar's sides.
    let to_wall = |x: f64, y: f64| {
        let room = [x, 5.0 - x, y, 4.0 - y].into_iter().fold(f64::INFINITY, |a, b| a.min(b.abs()));
        let (dx, dy) = ((x - 2.5).abs() - 0.2, (y - 2.0).abs() - 0.2);
        let pillar = if dx < 0.0 && dy < 0.0 { dx.max(dy).abs() } else { dx.max(0.0).hypot(dy.max(0.0)) };
        room.min(pillar)
    };
    let mut occupied = 0;
    for row in 0..grid.height() {
        for column in 0..grid.width() {
            if grid.cells()[row * grid.width() + column] == Cell::Occupied {
                let centre = |origin: f64, i: usize| origin + (i as f64 + 0.5) * grid.resolution_m();
                let (x, y) = (centre(grid.origin().x, column), centre(grid.origin().y, row));
                assert!(to_wall(x, y) <= options.resolution_m, "({x}, {y}) is occupied");
                occupied += 1;
            }
        }
    }
    assert!(occupied >= 360, "only {occupied} cells are occupied");
    // Every point of the room's walls has an occupied cell at most one cell away.
    let r = options.resolution_m;
    for i in 1..100 {
        let share = f64::from(i) / 100.0;
        for (x, y) in [(5.0 * share, 0.0), (5.0 * share, 4.0), (0.0, 4.0 * share), (5.0, 4.0 * share)] {
            let near = [-r, 0.0, r];
            let found = near
                .iter()
                .any(|dx| near.iter().any(|dy| grid.cell_at(x + dx, y + dy) == Some(Cell::Occupied)));
            assert!(found, "the wall at ({x}, {y}) is missing");
        }
    }
    assert_eq!(grid.cell_at(1.0, 1.0), Some(Cell::Free));
    assert_eq!(grid.cell_at(2.5, 2.0), Some(Cell::Unknown));
    assert_eq!(grid.cell_at(-0.3, 2.0), Some(Cell::Unknown));
}

#[test]
fn what_moved_away_is_cleared() {
    let mut drive = drive();
    // In the first two scans something stands half a metre in front of the laser.
    for step in &mut drive.steps[..2] {
        step.scan.ranges = vec![0.5; 180];
    }
    let grid = occupancy_from_drive(&drive, &all_steps(&drive), &MappingOptions::default()).unwrap();
    let ahead = drive.steps[0].reference.unwrap().transform_point(DVec2::new(0.7, 0.0));
    assert_eq!(grid.cell_at(ahead.x, ahead.y), Some(Cell::Free));
    let only = occupancy_from_drive(&drive, &[0, 1], &MappingOptions::default()).unwrap();
    assert_eq!(only.cell_at(ahead.x, ahead.y), Some(Cell::Occupied));
}

#[test]
fn beams_without_return_clear_only_as_far_as_asked() {
    let mut drive = drive();
    let base = drive.steps[0].reference.unwrap();
    for step in &mut drive.steps {
        step.reference = Some(base);
        step.scan.ranges = vec![MAX_RANGE_M; 180];
    }
    let ahead = |grid: &OccupancyGrid, metres: f64| {
        let p = base.transform_point(DVec2::new(0.2 + metres, 0.0));
        grid.cell_at(p.x, p.y)
    };
    let steps = all_steps(&drive);
    let grid = |no_return_clear_m, margin_m| {
        let options = MappingOptions { no_return_clear_m, margin_m, ..MappingOptions::default() };
        occupancy_from_drive(&drive, &steps, &options).unwrap()
    };
    assert_eq!(ahead(&grid(2.0, 1.0), 1.8), Some(Cell::Free));
    assert_eq!(ahead(&grid(2.0, 1.0), 2.2), Some(Cell::Unknown));
    assert_eq!(ahead(&grid(0.0, 2.0), 1.0), Some(Cell::Unknown));
}

#[test]
fn far_readings_mark_nothing_and_unusable_ones_are_left_out() {
    let mut drive = drive();
    for step in &mut drive.steps {
        step.scan.ranges = vec![f32::NAN; 180];
    }
    drive.steps[0].scan.ranges[90] = 5.0;
    let options = MappingOptions { usable_range_m: 3.0, ..MappingOptions::default() };
    let steps = all_steps(&drive);
    let grid = occupancy_from_drive(&drive, &steps, &options).unwrap();
    assert!(!grid.cells().contains(&Cell::Occupied));
    drive.steps[0].scan.ranges[90] = f32::NAN;
    let error = occupancy_from_drive(&drive, &steps, &options).unwrap_err();
    assert!(matches!(error, MapError::NoReference { steps: 64 }));
    drive.steps.iter_mut().for_each(|step| step.reference = None);
    assert!(occupancy_from_drive(&drive, &steps, &options).is_err());
}

#[test]
fn poses_beyond_any_building_and_maps_with_too_many_cells_are_refused() {
    let map_of = |x: f64, resolution_m: f64| {
        let mut drive = drive();
        for step in &mut drive.steps {
            step.reference = step.reference.map(|pose| Pose2::new(x, pose.y, pose.theta));
        }
        drive.steps[0].reference = Some(Pose2::new(0.0, 1e3, 0.0));
        let options = MappingOptions { resolution_m, ..MappingOptions::default() };
        occupancy_from_drive(&drive, &all_steps(&drive), &options).unwrap_err()
    };
    for x in [1e300, 1e16, -1.1e7] {
        assert!(matches!(map_of(x, 0.05), MapError::Origin(_)), "{x}");
    }
    let error = map_of(1e6, 0.05).to_string();
    assert!(
        error.contains("are the map's units metres?") && error.contains("--limit grid_cells="),
        "{error}"
    );
    let error = map_of(180.0, 0.05).to_string();
    assert!(error.contains("pixels of a map's image are not allowed"), "{error}");
}
