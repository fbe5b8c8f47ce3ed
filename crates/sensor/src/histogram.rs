//! A sensor model made of one histogram per cell of the state.

use std::sync::Arc;

use locsim_core::{Beams, Draw, SensorModel};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::ModelKind;
use crate::axis::Axis;
use crate::beam::{Beam, cdfs, log_densities, samples};
use crate::state_grid::StateGrid;

/// The prepared form of `np_reg` and `np_reg_registered`: for each cell of (r, alpha) a histogram of the
/// observation, which is z itself or the offset z - r from the beam's exact nominal range, and a point mass
/// at the maximum range.
///
/// Within a bin the density is constant, so density, distribution function and samples agree exactly. An
/// offset that would give a reading outside of \[0, maximum) counts as no return, at the maximum range.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub(crate) struct HistogramTable {
    // A fitted model and the one that a filter asks are copies, of up to 90 MB.
    parts: Arc<Parts>,
    /// \[cell\]\[bin\]: ln(mass / width).
    log_density: Arc<Vec<f32>>,
    /// \[cell\]\[bins + 1\]: mass below each bin.
    below: Arc<Vec<f32>>,
    /// ln of the probability of the maximum range on an open beam, the usual case of such a reading.
    open_no_return: f32,
}

/// The masses of a cell are rounded to f32 one by one, so that their sum may be above 1 by this much.
const MASS_TOLERANCE: f64 = 1e-6;

/// The stored form of the model.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Parts {
    pub kind: ModelKind,
    /// Maximum range of the sensor \[m\].
    pub max_range: f32,
    pub grid: StateGrid,
    pub axis: Axis,
    /// \[cell\]\[bin\]: mass of each bin; with the point mass a cell's masses sum to 1.
    pub mass: Vec<f32>,
}

impl From<HistogramTable> for Parts {
    fn from(table: HistogramTable) -> Self {
        Arc::unwrap_or_clone(table.parts)
    }
}

impl TryFrom<Parts> for HistogramTable {
    type Error = String;

    fn try_from(parts: Parts) -> Result<Self, Self::Error> {
        let bins = parts.axis.bins();
        let grid = &parts.grid;
        grid.holds(parts.mass.len(), bins)?;
        if let Some(i) = parts.mass.iter().position(|m| !(0.0..=1.0).contains(m)) {
            return Err(format!(
                "mass {} of bin {} of cell {} is no probability",
                parts.mass[i],
                i % bins,
                i / bins
            ));
        }
        let widths: Vec<f32> = (0..bins).map(|bin| parts.axis.width(bin)).collect();
        let mut log_density = vec![0.0; parts.mass.len()];
        let mut below = vec![0.0; parts.mass.len() + grid.cells()];
        let rows = log_density.par_chunks_mut(bins).zip(below.par_chunks_mut(bins + 1));
        rows.zip(parts.mass.par_chunks(bins)).for_each(|((log_density, below), mass)| {
            let mut sum = 0.0f64;
            for bin in 0..bins {
                log_density[bin] = (mass[bin] / widths[bin]).ln();
                sum += f64::from(mass[bin]);
                below[bin + 1] = sum as f32;
            }
        });
        let total = |mass: &[f32]| mass.iter().map(|m| f64::from(*m)).sum::<f64>();
        let heavy = |mass: &[f32]| total(mass) > 1.0 + MASS_TOLERANCE;
        if let Some(cell) = parts.mass.chunks(bins).position(heavy) {
            let total = total(&parts.mass[cell * bins..][..bins]);
            return Err(format!("the masses of cell {cell} sum to {total}, more than 1"));
        }
        let (parts, log_density, below) = (Arc::new(parts), Arc::new(log_density), Arc::new(below));
        let mut table = Self { parts, log_density, below, open_no_return: 0.0 };
        let (max_range, nominal) = (table.parts.max_range, table.parts.grid.reach);
        let open = Beam { pose: 0, bearing: 0, range: max_range, nominal, incidence: 0.0, max_range };
        table.open_no_return = table.log_no_return(&open);
        Ok(table)
    }
}

impl HistogramTable {
    /// Which model this is.
    pub fn kind(&self) -> ModelKind {
        self.parts.kind
    }

    /// Maximum range of the sensor \[m\].
    pub fn max_range(&self) -> f32 {
        self.parts.max_range
    }

    /// Nominal range up to which there are cells \[m\].
    pub fn reach(&self) -> f32 {
        self.parts.grid.reach
    }

    /// The observation that a reading is, on this beam \[m\].
    #[inline]
    fn observation(&self, z: f32, beam: &Beam) -> f32 {
        if self.parts.kind == ModelKind::NpRegRegistered {
            z - beam.nominal.min(self.parts.grid.reach)
        } else {
            z
        }
    }

    /// Mass of the cell's histogram below an observation.
    fn mass_below(&self, cell: usize, observation: f32) -> f32 {
        let axis = &self.parts.axis;
        let bin = axis.bin(observation);
        let row = &self.below[cell * (axis.bins() + 1)..];
        let share = ((observation - axis.lower(bin)) / axis.width(bin)).clamp(0.0, 1.0);
        row[bin] + share * (row[bin + 1] - row[bin])
    }

    /// ln of the probability of the maximum range.
    fn log_no_return(&self, beam: &Beam) -> f32 {
        (1.0 - self.cdf_at(beam.max_range, beam)).max(0.0).ln()
    }

    /// P(reading < `z`), `z` at most the maximum range.
    fn cdf_at(&self, z: f32, beam: &Beam) -> f32 {
        let cell = self.parts.grid.cell(beam);
        self.mass_below(cell, self.observation(z, beam)) - self.mass_below(cell, self.observation(0.0, beam))
    }
}

impl SensorModel for HistogramTable {
    fn name(&self) -> &str {
        self.parts.kind.as_str()
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        let bins = self.parts.axis.bins();
        log_densities(z, beams, out, |z, beam| {
            if z >= beam.max_range {
                let open = beam.nominal >= self.parts.grid.reach;
                return if open { self.open_no_return } else { self.log_no_return(&beam) };
            }
            let bin = self.parts.axis.bin(self.observation(z, &beam));
            self.log_density[self.parts.grid.cell(&beam) * bins + bin]
        });
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        cdfs(z, beams, out, |z, beam| self.cdf_at(z, &beam));
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        let axis = &self.parts.axis;
        samples(beams, draw, out, |beam, rng| {
            let row = &self.below[self.parts.grid.cell(&beam) * (axis.bins() + 1)..][..=axis.bins()];
            let u = rng.random::<f32>();
            let above = row.partition_point(|&p| p <= u);
            if above > axis.bins() {
                return beam.max_range;
            }
            let bin = above - 1;
            let share = (u - row[bin]) / (row[above] - row[bin]);
            let z = axis.lower(bin) + share * axis.width(bin) - self.observation(0.0, &beam);
            if (0.0..beam.max_range).contains(&z) { z } else { beam.max_range }
        });
    }
}
