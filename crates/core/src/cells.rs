//! Square cells of the plane.

use std::collections::{BTreeMap, HashSet};
use std::hash::BuildHasher;

use glam::DVec2;

/// The cell of a grid from the origin, with sides of this length \[m\], that a point \[m\] is in.
pub fn cell_at(point: DVec2, side_m: f64) -> [i32; 2] {
    [(point.x / side_m).floor() as i32, (point.y / side_m).floor() as i32]
}

/// The greatest sum of numbers in two by two cells, and the sum of all.
pub fn most_of_four(numbers: impl IntoIterator<Item = ([i32; 2], f64)>) -> [f64; 2] {
    let mut cells: BTreeMap<[i32; 2], f64> = BTreeMap::new();
    for (cell, number) in numbers {
        *cells.entry(cell).or_default() += number;
    }
    let at = |x: i32, y: i32| cells.get(&[x, y]).unwrap_or(&0.0);
    let four = |x: i32, y: i32| at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1);
    // The four of which a cell is any.
    let places =
        cells.keys().flat_map(|&[x, y]| [four(x, y), four(x - 1, y), four(x, y - 1), four(x - 1, y - 1)]);
    [places.fold(0.0, f64::max), cells.values().sum()]
}

/// Share of the cells that are there again so many sets later; of one cell more, that isn't.
pub fn share_again<S: BuildHasher>(sets: &[HashSet<[i32; 2], S>], later: usize) -> f64 {
    let pairs = sets.iter().zip(sets.iter().skip(later));
    let (both, all) = pairs.fold((0, 1), |(both, all), (here, later)| {
        (both + here.intersection(later).count(), all + here.len())
    });
    f64::from(both as u32) / f64::from(all as u32)
}

/// The cells that a line crosses from one point to another \[m\], in order. Where it cuts less than half a side off a corner, that cell may be left out.
pub fn cells_between(from: DVec2, to: DVec2, side_m: f64) -> impl Iterator<Item = [i32; 2]> {
    let steps = (2.0 * from.distance(to) / side_m).ceil().max(1.0) as usize;
    let mut last = None;
    (0..=steps).filter_map(move |i| {
        let cell = cell_at(from.lerp(to, i as f64 / steps as f64), side_m);
        let is_new = last != Some(cell);
        last = Some(cell);
        is_new.then_some(cell)
    })
}

/// Points that the others may be about in [`densest`], at the most.
const MOST_MIDDLES: usize = 500;

/// The middle of the points that are this near \[m\] to the one that most are near to, of 500 in equal steps; `None` of no points.
pub fn densest(points: &[DVec2], near_m: f64) -> Option<DVec2> {
    let near = |p: &DVec2| {
        let near = points.iter().filter(|q| p.distance(**q) < near_m);
        near.fold((0_u32, DVec2::ZERO), |(count, sum), q| (count + 1, sum + *q))
    };
    let every = points.len().div_ceil(MOST_MIDDLES).max(1);
    let (count, sum) = points.iter().step_by(every).map(near).max_by_key(|(count, _)| *count)?;
    Some(sum / f64::from(count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_crosses_cells_in_order() {
        let cells: Vec<[i32; 2]> = cells_between(DVec2::new(-0.1, 0.1), DVec2::new(0.6, 0.1), 0.25).collect();
        assert_eq!(cells, [[-1, 0], [0, 0], [1, 0], [2, 0]]);
        assert_eq!(cells_between(DVec2::ZERO, DVec2::ZERO, 0.25).collect::<Vec<_>>(), [[0, 0]]);
    }

    #[test]
    fn four_cells_are_summed_wherever_they_meet() {
        let numbers = [([0, 0], 1.0), ([-1, -1], 2.0), ([0, 0], 0.5), ([1, 1], 1.0), ([5, 5], 3.0)];
        assert_eq!(most_of_four(numbers), [3.5, 7.5]);
        assert_eq!(most_of_four([]), [0.0, 0.0]);
    }

    /// Three cells are looked for in the next set, of which two are there.
    #[test]
    fn cells_are_found_again() {
        let sets = [vec![[0, 0], [1, 0]], vec![[1, 0]], vec![[1, 0], [2, 0]]].map(HashSet::<_>::from_iter);
        assert!((share_again(&sets, 1) - 2.0 / 4.0).abs() < 1e-12);
        assert!((share_again(&sets, 2) - 1.0 / 3.0).abs() < 1e-12);
    }
}
