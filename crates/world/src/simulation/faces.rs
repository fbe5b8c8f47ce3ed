use glam::DVec2;

use super::SimulationError;
use super::error::check_count;
use crate::map::Geometry;

/// The most points at which free space is looked for, and the most corners of polygons that they are all compared with.
const MOST_PROBES: f64 = 5e6;
const MOST_COMPARED: f64 = 1e10;

/// Distance between the points of a wall at which free space is looked for \[m\].
const PROBE_PITCH_M: f64 = 0.25;
/// Distance of these points from the wall \[m\].
const PROBE_OFFSET_M: f64 = 0.01;

/// One side of a stretch of wall, with free space before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Face {
    /// One end \[m\].
    pub start: DVec2,
    /// Unit vector to the other end.
    pub along: DVec2,
    /// Unit normal into free space.
    pub inward: DVec2,
    /// Length \[m\].
    pub length: f64,
}

impl Face {
    /// A metre of wall along x, with free space on its left.
    pub const UNIT: Self = Self { start: DVec2::ZERO, along: DVec2::X, inward: DVec2::Y, length: 1.0 };
}

/// Every side of every wall that borders free space. A thin wall with free space on both sides has two faces;
/// a wall that borders it only in part has a face there.
///
/// # Errors
/// [`SimulationError::TooMany`] where the walls are too long.
pub(super) fn faces_of(geometry: &Geometry) -> Result<Vec<Face>, SimulationError> {
    let pieces = |length: f64| (length / PROBE_PITCH_M).ceil().max(1.0);
    let probes: f64 = geometry.segments().iter().map(|[a, b]| 2.0 * pieces(a.distance(*b))).sum();
    check_count("quarter metres of wall at which blocks may stand", probes, MOST_PROBES)?;
    let corners = geometry.corners_of_free_space() as f64;
    check_count("quarter metres of wall times corners of the map", probes * corners, MOST_COMPARED)?;
    let mut faces = Vec::new();
    for &[a, b] in geometry.segments() {
        let length = a.distance(b);
        let along = (b - a) / length;
        let pieces = pieces(length) as usize;
        let at = |piece: f64| a + (piece / pieces as f64) * (b - a);
        for inward in [along.perp(), -along.perp()] {
            let is_free = |&piece: &usize| {
                let probe = at(piece as f64 + 0.5) + PROBE_OFFSET_M * inward;
                geometry.is_free(probe.x, probe.y)
            };
            let mut from = 0;
            while let Some(first) = (from..pieces).find(is_free) {
                let end = (first..pieces).find(|piece| !is_free(piece)).unwrap_or(pieces);
                let (start, stop) = (at(first as f64), at(end as f64));
                faces.push(Face { start, along, inward, length: start.distance(stop) });
                from = end;
            }
        }
    }
    Ok(faces)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::{Polyline, VectorMap, Wall};

    fn room(walls: Vec<Wall>, obstacles: Vec<Polyline>) -> Geometry {
        let outline = Polyline {
            points_m: vec![[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]],
            ..Polyline::default()
        };
        VectorMap { outline, obstacles, walls }.to_geometry().unwrap()
    }

    fn total(faces: &[Face]) -> f64 {
        faces.iter().map(|face| face.length).sum()
    }

    #[test]
    fn a_room_has_the_inner_sides_of_its_walls() {
        let faces = faces_of(&room(vec![], vec![])).unwrap();
        assert_eq!(faces.len(), 4);
        assert!((total(&faces) - 14.0).abs() < 1e-9);
        for face in faces {
            let middle = face.start + 0.5 * face.length * face.along;
            assert!(face.inward.dot(DVec2::new(2.0, 1.5) - middle) > 0.0);
        }
    }

    #[test]
    fn walls_too_long_to_walk_along_are_refused() {
        let wall = |metres: f64| Wall { name: "long".into(), from_m: [1.0, 1.0], to_m: [1.0 + metres, 1.0] };
        // Amid a hall that is as long.
        let refusal = |metres: f64, obstacles| {
            let points_m = vec![[0.0, 0.0], [metres + 2.0, 0.0], [metres + 2.0, 3.0], [0.0, 3.0]];
            let outline = Polyline { points_m, ..Polyline::default() };
            let map = VectorMap { outline, obstacles, walls: vec![wall(metres)] };
            faces_of(&map.to_geometry().unwrap()).unwrap_err().to_string()
        };
        let error = refusal(1e6, vec![]);
        assert!(
            error.starts_with("24000080 quarter metres of wall at which blocks may stand are more than"),
            "{error}"
        );
        let zigzag = (0..10_000).map(|i| [f64::from(i), f64::from(i % 2)]).collect();
        let obstacle = Polyline { points_m: zigzag, ..Polyline::default() };
        let error = refusal(1e5, vec![obstacle]);
        assert!(error.contains("quarter metres of wall times corners of the map are more than"), "{error}");
    }

    #[test]
    fn a_thin_wall_has_two_faces_and_an_obstacle_its_outside() {
        let screen = Wall { name: "screen".into(), from_m: [1.0, 1.0], to_m: [2.0, 1.0] };
        let pillar = Polyline {
            points_m: vec![[3.0, 1.0], [3.5, 1.0], [3.5, 1.5], [3.0, 1.5]],
            ..Polyline::default()
        };
        assert!(
            (total(&faces_of(&room(vec![screen], vec![pillar])).unwrap()) - (14.0 + 2.0 + 2.0)).abs() < 1e-9
        );
    }

    #[test]
    fn the_part_of_a_wall_outside_free_space_has_no_face() {
        let through = Wall { name: "through".into(), from_m: [3.0, 1.5], to_m: [6.0, 1.5] };
        let faces = faces_of(&room(vec![through], vec![])).unwrap();
        assert_eq!(faces.len(), 6);
        assert!((total(&faces) - 16.0).abs() < 1e-9);
    }
}
