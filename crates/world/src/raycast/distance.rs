use glam::DVec2;
use locsim_core::DistanceMap;
use parry2d_f64::partitioning::Bvh;
use rayon::prelude::*;

use super::segment::{distance_to, tree_over};
use crate::map::{CellFrame, Geometry, MapError};

/// Distance to the nearest wall, exact at the centres of a grid's cells and interpolated bilinearly between them
/// (the distance table of the likelihood field, Probabilistic Robotics, section 6.4).
///
/// The grid reaches `max_m` beyond the map's bounds, so that a reading's end point behind a wall has its true
/// distance. Interpolation is off by less than 0.71 cells.
pub struct DistanceGrid {
    frame: CellFrame,
    distances: Vec<f32>,
    max_m: f32,
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
        let tree = tree_over(geometry.segments());
        let mut distances = vec![0.0; frame.rows * frame.columns];
        distances.par_chunks_mut(frame.columns).enumerate().for_each(|(row, distances)| {
            let mut last = max_m;
            for (column, out) in distances.iter_mut().enumerate() {
                let centre = DVec2::from_array(frame.half_cell(2 * column + 1, 2 * row + 1));
                // No farther than from the cell before, by a little more than a cell.
                let most = max_m.min((last + cell_m) * (1.0 + 1e-9) + 1e-9);
                let found = nearest(geometry, &tree, centre, most);
                last = found.or_else(|| nearest(geometry, &tree, centre, max_m)).unwrap_or(max_m);
                *out = last as f32;
            }
        });
        Ok(Self { frame, distances, max_m: max_m as f32 })
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
        let (right, up) = (column.fract() as f32, row.fract() as f32);
        let i = row as usize * columns + column as usize;
        let below = self.distances[i] * (1.0 - right) + self.distances[i + 1] * right;
        let above = self.distances[i + columns] * (1.0 - right) + self.distances[i + columns + 1] * right;
        below * (1.0 - up) + above * up
    }
}

/// Distance from a point to the nearest segment \[m\], if there is one nearer than `max_m`.
fn nearest(geometry: &Geometry, tree: &Bvh, point: DVec2, max_m: f64) -> Option<f64> {
    let segments = geometry.segments();
    tree.find_best(
        max_m,
        |node, _| {
            let outside = (node.mins() - point).max(point - node.maxs()).max(DVec2::ZERO);
            outside.length()
        },
        |leaf, _| Some(distance_to(&segments[leaf as usize], point)),
    )
    .map(|(_, distance)| distance)
}
