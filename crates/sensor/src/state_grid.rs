//! The grid over the state (r, alpha) on which the regressed models are prepared.

use std::f32::consts::FRAC_PI_2;

use serde::{Deserialize, Serialize};

use crate::beam::Beam;

/// Cells over nominal range and incidence angle, and one more for beams that meet nothing in the map.
///
/// A prepared model answers with the density of the cell that a beam falls into. Cells are small against the
/// bandwidths, so that the difference between a state and its cell's centre is small too.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct StateGrid {
    /// Nominal ranges from 0 to here \[m\] have cells; a beam that reaches it is open.
    pub reach: f32,
    pub ranges: usize,
    pub incidences: usize,
}

impl StateGrid {
    /// Whether there are values for just the cells of this grid, `per_cell` each.
    pub fn holds(&self, values: usize, per_cell: usize) -> Result<(), String> {
        let Self { reach, ranges, incidences } = *self;
        if !(reach > 0.0 && reach.is_finite()) {
            return Err(format!("a state grid that reaches to {reach} m is not allowed"));
        }
        let mapped = ranges.checked_mul(incidences).filter(|&mapped| mapped > 0);
        let expected = mapped.and_then(|mapped| mapped.checked_add(1)?.checked_mul(per_cell));
        if expected == Some(values) {
            return Ok(());
        }
        Err(format!(
            "a number of {values} values doesn't match the grid of {ranges} ranges x {incidences} incidences and one \
             more, with {per_cell} values each"
        ))
    }

    /// Cells with a mapped surface; the cell of open beams has this index.
    pub fn mapped(&self) -> usize {
        self.ranges * self.incidences
    }

    /// All cells.
    pub fn cells(&self) -> usize {
        self.mapped() + 1
    }

    pub fn range_width(&self) -> f32 {
        self.reach / self.ranges as f32
    }

    pub fn incidence_width(&self) -> f32 {
        FRAC_PI_2 / self.incidences as f32
    }

    /// The cell of a beam.
    #[inline]
    pub fn cell(&self, beam: &Beam) -> usize {
        if beam.nominal >= self.reach {
            return self.mapped();
        }
        let i = (beam.nominal * (self.ranges as f32 / self.reach)) as usize;
        let j = (beam.incidence * (self.incidences as f32 / FRAC_PI_2)) as usize;
        i.min(self.ranges - 1) * self.incidences + j.min(self.incidences - 1)
    }

    /// The longest nominal range of a cell \[m\].
    pub fn longest(&self, cell: usize) -> f32 {
        if cell >= self.mapped() {
            return self.reach;
        }
        (cell / self.incidences + 1) as f32 * self.range_width()
    }

    /// Nominal range and incidence angle at the middle of a cell; the grid's reach and 0 for open beams.
    pub fn centre(&self, cell: usize) -> (f32, f32) {
        if cell >= self.mapped() {
            return (self.reach, 0.0);
        }
        let (i, j) = (cell / self.incidences, cell % self.incidences);
        ((i as f32 + 0.5) * self.range_width(), (j as f32 + 0.5) * self.incidence_width())
    }
}
