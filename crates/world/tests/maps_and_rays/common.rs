//! Maps that several tests and benches use.

use locsim_world::map::{Geometry, Polyline, VectorMap};

/// A corridor of 20 m x 4 m with closed ends and six door recesses, each 0.4 m deep.
pub fn corridor() -> Geometry {
    let mut points_m = vec![[0.0, 0.0]];
    for [from, to] in [[4.3, 5.2], [9.9, 11.1], [17.0, 17.9]] {
        points_m.extend([[from, 0.0], [from, -0.4], [to, -0.4], [to, 0.0]]);
    }
    points_m.extend([[20.0, 0.0], [20.0, 4.0]]);
    for [from, to] in [[15.1, 14.2], [7.7, 6.5], [2.9, 2.0]] {
        points_m.extend([[from, 4.0], [from, 4.4], [to, 4.4], [to, 4.0]]);
    }
    points_m.push([0.0, 4.0]);
    vector_map(points_m, Vec::new())
}

/// An outline with obstacles, without names.
pub fn vector_map(outline: Vec<[f64; 2]>, obstacles: Vec<Vec<[f64; 2]>>) -> Geometry {
    let polyline = |points_m| Polyline { points_m, ..Polyline::default() };
    let map = VectorMap {
        outline: polyline(outline),
        obstacles: obstacles.into_iter().map(polyline).collect(),
        walls: Vec::new(),
    };
    map.to_geometry().unwrap()
}
