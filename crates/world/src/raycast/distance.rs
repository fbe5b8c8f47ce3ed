use std::f64::consts::SQRT_2;

use glam::DVec2;
use locsim_core::DistanceMap;
use parry2d_f64::partitioning::{Bvh, BvhNode};
use rayon::prelude::*;

use super::segment::tree_over;
use crate::map::{CellFrame, Geometry, MapError};
use locsim_core::distance_to;

/// Side of a square tile of cells that queries the tree together, ..
const BLOCK: usize = 8;
/// .. unless more segments than this are near: then each cell asks.
const MOST_NEAR: usize = 64;

/// Distance to the nearest wall, exact at the centres of a grid's cells and interpolated bilinearly between them
/// (the distance table of the likelihood field, Probabilistic Robotics, section 6.4).
///
/// The grid reaches `max_m` beyond the map's bounds, so that a reading's end point behind a wall has its true
/// distance. Interpolation is off by less than 0.71 cells.
pub struct DistanceGrid {
    frame: CellFrame,
    distances: Vec<f32>,
    max_m: f32,
    /// The surface that is the border of what is known.
    unknown: Option<u32>,
    /// By surface, each of which is one wall in a measured map; empty of other maps.
    hit_shares: Vec<f32>,
}

impl DistanceGrid {
    /// Computes the distances in parallel, for cells of `cell_m` metres. Distances saturate at `max_m` metres (0 if
    /// negative).
    ///
    /// # Errors
    /// [`MapError`] when the cell size is not positive, or the grid too large.
    pub fn new(geometry: &Geometry, cell_m: f64, max_m: f64) -> Result<Self, MapError> {
        let max_m = max_m.max(0.0);
        let [x0, y0, x1, y1] = geometry.bounds();
        let frame = CellFrame::covering([x0 - max_m, y0 - max_m, x1 + max_m, y1 + max_m], cell_m)?;
        let walls = Walls { segments: geometry.walls(), tree: tree_over(geometry.walls()) };
        let mut distances = vec![0.0; frame.rows * frame.columns];
        let radius = 0.5 * BLOCK as f64 * cell_m * SQRT_2;
        distances.par_chunks_mut(BLOCK * frame.columns).enumerate().for_each_init(
            Vec::new,
            |near, (band, out)| {
                for first in (0..frame.columns).step_by(BLOCK) {
                    let centre = frame.half_cell(2 * first + BLOCK, (2 * band + 1) * BLOCK);
                    walls.near(DVec2::from_array(centre), radius, max_m, near);
                    for (row, out) in (band * BLOCK..).zip(out.chunks_mut(frame.columns)) {
                        for (column, out) in out.iter_mut().enumerate().skip(first).take(BLOCK) {
                            let centre = DVec2::from_array(frame.half_cell(2 * column + 1, 2 * row + 1));
                            *out = walls.nearest_of(near, centre, max_m) as f32;
                        }
                    }
                }
            },
        );
        let hit_shares = geometry.hit_shares().iter().map(|share| *share as f32).collect();
        Ok(Self { frame, distances, max_m: max_m as f32, unknown: geometry.unknown(), hit_shares })
    }
}

impl DistanceMap for DistanceGrid {
    fn distance(&self, x: f64, y: f64) -> f32 {
        let CellFrame { x0, y0, cell_m, columns, rows } = self.frame;
        let (column, row) = ((x - x0) / cell_m - 0.5, (y - y0) / cell_m - 0.5);
        // False for NaN too.
        let inside = column >= 0.0 && row >= 0.0 && column < (columns - 1) as f64 && row < (rows - 1) as f64;
        if !inside {
            return self.max_m;
        }
        // Not `fract`, which is a call without SSE 4.1.
        let (left, bottom) = (column as u32, row as u32);
        let (right, up) = ((column - f64::from(left)) as f32, (row - f64::from(bottom)) as f32);
        let i = bottom as usize * columns + left as usize;
        let below = self.distances[i] * (1.0 - right) + self.distances[i + 1] * right;
        let above = self.distances[i + columns] * (1.0 - right) + self.distances[i + columns + 1] * right;
        below * (1.0 - up) + above * up
    }

    fn is_unknown(&self, surface: u32) -> bool {
        self.unknown == Some(surface)
    }

    fn hit_share(&self, surface: u32) -> f32 {
        self.hit_shares.get(surface as usize).copied().unwrap_or(1.0)
    }
}

/// Wall segments and a tree over them.
struct Walls<'a> {
    segments: &'a [[DVec2; 2]],
    tree: Bvh,
}

impl Walls<'_> {
    /// The segments of which one may be the nearest to a point at most `radius` from `centre`, if it is nearer than
    /// `max_m` \[m\]; a few more than [`MOST_NEAR`] of them at the most.
    fn near(&self, centre: DVec2, radius: f64, max_m: f64, near: &mut Vec<u32>) {
        near.clear();
        if let Some(distance) = self.nearest(centre, max_m + radius) {
            // The point is no farther from that segment than this and the radius, and its own nearest one is not either.
            let within = distance + 2.0 * radius;
            near.extend(self.tree.leaves(|node| outside(node, centre) <= within).take(MOST_NEAR + 1));
        }
    }

    /// Distance from a point to the nearest of these segments \[m\], of all where these are too many; at most `max_m`.
    fn nearest_of(&self, near: &[u32], point: DVec2, max_m: f64) -> f64 {
        if near.len() > MOST_NEAR {
            return self.nearest(point, max_m).unwrap_or(max_m);
        }
        let distances = near.iter().map(|&segment| distance_to(&self.segments[segment as usize], point));
        distances.fold(max_m, f64::min)
    }

    /// Distance from a point to the nearest segment \[m\], if that is nearer than `max_m`.
    fn nearest(&self, point: DVec2, max_m: f64) -> Option<f64> {
        let cost = |node: &BvhNode, _| outside(node, point);
        let distance = |leaf: u32, _| Some(distance_to(&self.segments[leaf as usize], point));
        self.tree.find_best(max_m, cost, distance).map(|(_, distance)| distance)
    }
}

/// Distance from a point to a box \[m\].
fn outside(node: &BvhNode, point: DVec2) -> f64 {
    (node.mins() - point).max(point - node.maxs()).max(DVec2::ZERO).length()
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Pose2, Stage};
    use rand::RngExt;

    use super::*;
    use crate::map::{Cell, OccupancyGrid};

    /// Blocks of cells with few segments around and blocks with many, in a grid that no block fits into evenly.
    #[test]
    fn each_cell_has_the_distance_to_the_nearest_of_all_segments() {
        let mut rng = Draw::new(1, Stage::Blocks, 0).item(0);
        for occupied in [0.3, 0.01, 0.0005] {
            let share = |i: usize| if i % 90 < 45 { 0.0 } else { occupied };
            let cells: Vec<Cell> = (0..90 * 70)
                .map(|i| if rng.random::<f64>() < share(i) { Cell::Occupied } else { Cell::Free })
                .collect();
            let origin = Pose2::new(-1.0, 2.0, 0.3);
            let grid = OccupancyGrid::new(90, 70, 0.05, origin, cells, vec![0.5; 90 * 70]).unwrap();
            let geometry = grid.to_geometry().unwrap();
            let distances = DistanceGrid::new(&geometry, 0.06, 1.0).unwrap();
            let walls = Walls { segments: geometry.segments(), tree: tree_over(geometry.segments()) };
            for (i, &distance) in distances.distances.iter().enumerate() {
                let (column, row) = (i % distances.frame.columns, i / distances.frame.columns);
                let centre = DVec2::from_array(distances.frame.half_cell(2 * column + 1, 2 * row + 1));
                let expected = walls.nearest(centre, 1.0).unwrap_or(1.0) as f32;
                assert_eq!(distance.to_bits(), expected.to_bits(), "cell {column}, {row}");
            }
        }
    }
}
