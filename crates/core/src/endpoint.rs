//! A sensor model that scores where readings end, as a table.

use wide::bytemuck::cast;
use wide::{f32x4, u32x4};

use crate::likelihood::{BEAMS_PER_RUN, BeamRun, Nats};
use crate::{Poses, sin_cos};

/// Log densities of readings by the cell of the plane in which they end, and of "no return" (the likelihood field,
/// Probabilistic Robotics, table 6.3).
#[derive(Clone, Debug, PartialEq)]
pub struct EndpointTable {
    grid: EndpointGrid,
    /// Maximum range of the sensor \[m\]; a reading of it or above means "no return".
    max_range: f32,
    /// \[row\]\[column\], then "no return", then 0 for a beam that doesn't count.
    entries: Vec<i16>,
    nats: Nats,
}

/// Square cells over a box of the map frame. A point outside counts as in the border cell next to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EndpointGrid {
    /// Lower left corner \[m\].
    pub x0: f64,
    /// Lower left corner \[m\].
    pub y0: f64,
    /// Side of a cell \[m\].
    pub cell_m: f64,
    /// Cells along x.
    pub columns: usize,
    /// Cells along y.
    pub rows: usize,
}

/// Most cells of a grid, 32 MB.
const MOST_CELLS: f64 = (1 << 24) as f64;

impl EndpointGrid {
    /// Cells of `cell_m` metres over the box \[x0, y0, x1, y1\] \[m\], larger ones where they would be more than 2^24.
    pub fn covering([x0, y0, x1, y1]: [f64; 4], cell_m: f64) -> Self {
        let cells = |length: f64, cell_m: f64| (length / cell_m).ceil().max(1.0);
        let mut cell_m = cell_m;
        while cells(x1 - x0, cell_m) * cells(y1 - y0, cell_m) > MOST_CELLS {
            cell_m *= 2.0;
        }
        Self {
            x0,
            y0,
            cell_m,
            columns: cells(x1 - x0, cell_m) as usize,
            rows: cells(y1 - y0, cell_m) as usize,
        }
    }

    /// Centre of each cell of a row \[m\].
    pub fn centres(&self, row: usize) -> impl Iterator<Item = [f64; 2]> + '_ {
        let centre = |origin: f64, i: usize| origin + (i as f64 + 0.5) * self.cell_m;
        (0..self.columns).map(move |column| [centre(self.x0, column), centre(self.y0, row)])
    }
}

/// The usable readings of a scan (not NaN), prepared for an [`EndpointTable`].
#[derive(Clone, Debug, Default)]
pub struct EndpointScan {
    /// Directions, readings \[m\], and whether they are scored by where they end: all bits or none.
    runs: Vec<(BeamRun, f32x4, u32x4)>,
    beams: usize,
    /// Sum of the entries of the others.
    no_returns: i32,
}

impl EndpointScan {
    /// Takes the readings `z` \[m\] at `bearings` \[rad\]; keeps its buffers.
    pub fn prepare(&mut self, bearings: &[f32], z: &[f32], table: &EndpointTable) {
        self.runs.clear();
        (self.beams, self.no_returns) = (0, 0);
        let mut returns = 0;
        for (&bearing, &z) in bearings.iter().zip(z).filter(|(_, z)| !z.is_nan()) {
            self.beams += 1;
            if z >= table.max_range {
                self.no_returns += i32::from(table.entries[table.grid.rows * table.grid.columns]);
                continue;
            }
            let i = returns % BEAMS_PER_RUN;
            returns += 1;
            if i == 0 {
                self.runs.push((BeamRun::AHEAD, f32x4::ZERO, u32x4::ZERO));
            }
            if let Some((beams, readings, counts)) = self.runs.last_mut() {
                beams.set(i, bearing);
                readings.as_mut_array()[i] = z.max(0.0);
                counts.as_mut_array()[i] = u32::MAX;
            }
        }
    }
}

impl EndpointTable {
    /// Makes a table of log densities (nats): one per cell, row by row, and one of "no return"; none is NaN or plus
    /// infinity.
    ///
    /// # Panics
    /// If the number of log densities is not the grid's.
    pub fn new(grid: EndpointGrid, max_range: f32, log_density: &[f32]) -> Self {
        assert_eq!(log_density.len(), grid.rows * grid.columns + 1, "log densities do not match the grid");
        let (mut entries, nats) = Nats::of(log_density);
        entries.push(0);
        Self { grid, max_range, entries, nats }
    }

    /// The same log densities times a positive factor.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { nats: self.nats.scaled(factor), ..self }
    }

    /// Log likelihood (nats) of a scan for each of the laser poses.
    pub fn log_likelihood(&self, laser: Poses<'_>, scan: &EndpointScan, out: &mut [f64]) {
        let EndpointGrid { x0, y0, cell_m, columns, rows } = self.grid;
        let per_metre = (1.0 / cell_m) as f32;
        let last = [columns as f32 - 1.0, rows as f32 - 1.0].map(f32x4::splat);
        let nothing = u32x4::splat(self.entries.len() as u32 - 1);
        for (i, out) in out.iter_mut().enumerate() {
            let pose = laser.get(i);
            let (sin, cos) = sin_cos(pose.theta);
            let [s, c] = [sin as f32 * per_metre, cos as f32 * per_metre];
            let [x, y] = [(pose.x - x0) / cell_m, (pose.y - y0) / cell_m].map(|v| f32x4::splat(v as f32));
            let mut sum = scan.no_returns;
            for &(ref beams, z, counts) in &scan.runs {
                let end_x = x + (beams.cos * c - beams.sin * s) * z;
                let end_y = y + (beams.cos * s + beams.sin * c) * z;
                // Rounds half a cell off to the whole number below.
                let cell = |at: f32x4, last: f32x4| {
                    let at = (at - 0.5).fast_max(f32x4::ZERO).fast_min(last);
                    cast::<_, u32x4>(at.fast_round_int())
                };
                let place = cell(end_y, last[1]) * u32x4::splat(columns as u32) + cell(end_x, last[0]);
                for place in counts.bitselect(place, nothing).to_array() {
                    sum += i32::from(self.entries[place as usize]);
                }
            }
            *out = self.nats.sum(scan.beams, sum);
        }
    }
}
