use serde::{Deserialize, Serialize};

use crate::error::{finite, positive};
use crate::{ConditionalDistribution, Error, Outcomes, Predictions};

/// Equal cells along one state coordinate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Axis {
    /// Lower edge of the first cell, in units of the coordinate.
    pub lo: f64,
    /// Width of a cell, positive, in units of the coordinate.
    pub width: f64,
    /// Number of cells.
    pub cells: usize,
}

/// Densities p(z | x) prepared for states in cells, for millions of queries: one lookup instead of a prediction. A state
/// counts as the middle of its cell, beyond the ends as the end cell.
///
/// Memory is 4 bytes x cells x (bins + 1).
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Axes, each with the reciprocal of its width: a multiplication is quicker than a division.
    axes: Vec<(Axis, f64)>,
    outcomes: Outcomes,
    /// Cells x (bins, and the probability of the point mass).
    densities: Vec<f32>,
    inverse_width: f64,
}

impl Table {
    /// Predicts at the middle of every cell.
    ///
    /// # Errors
    /// If there isn't one axis per state coordinate, an axis has no cells or no width, or a prediction fails.
    pub fn prepare<M>(model: &M, axes: &[Axis]) -> Result<Self, Error>
    where
        M: ConditionalDistribution + ?Sized,
    {
        if axes.len() != model.dim() {
            return Err(Error::Dimension { expected: model.dim(), found: axes.len() });
        }
        let mut states = vec![Vec::new()];
        for axis in axes {
            finite("the lower edge of a table's axis", axis.lo)?;
            positive("the width of a table's cells", axis.width)?;
            if axis.cells == 0 {
                return Err(Error::Empty { what: "an axis of a table" });
            }
            states = states
                .into_iter()
                .flat_map(|state: Vec<f64>| {
                    (0..axis.cells).map(move |cell| {
                        let middle = axis.lo + (cell as f64 + 0.5) * axis.width;
                        [&state[..], &[middle]].concat()
                    })
                })
                .collect();
        }
        let predictions = model.predict_batch(&states.concat())?;
        let axes = axes.iter().map(|&axis| (axis, 1.0 / axis.width)).collect();
        Ok(Self { axes, ..Self::of_predictions(&predictions) })
    }

    /// The densities of predictions, in their order: prediction i is cell i.
    pub fn of_predictions(predictions: &Predictions) -> Self {
        let outcomes = *predictions.outcomes();
        let width = outcomes.grid.width;
        let densities = (0..predictions.len())
            .flat_map(|i| {
                let bins = predictions.mass(i).iter().map(move |m| (m / width) as f32);
                bins.chain([predictions.points()[i] as f32])
            })
            .collect();
        let axis = Axis { lo: 0.0, width: 1.0, cells: predictions.len() };
        Self { axes: vec![(axis, 1.0)], outcomes, densities, inverse_width: 1.0 / width }
    }

    /// The possible outcomes.
    pub fn outcomes(&self) -> &Outcomes {
        &self.outcomes
    }

    /// The cell of a state, to be asked with [`Table::density_in`] for many observations.
    ///
    /// # Panics
    /// If the state hasn't one coordinate per axis.
    #[inline]
    pub fn cell(&self, state: &[f64]) -> usize {
        assert_eq!(state.len(), self.axes.len(), "one coordinate per axis");
        self.axes.iter().zip(state).fold(0, |cell, ((axis, inverse), x)| {
            // The cast takes negative numbers and NaN to zero.
            cell * axis.cells + (((x - axis.lo) * inverse) as usize).min(axis.cells - 1)
        })
    }

    /// p(z | x) in a cell, with the meaning of [`Distribution::density`](crate::Distribution::density).
    ///
    /// # Panics
    /// If there is no such cell.
    #[inline]
    pub fn density_in(&self, cell: usize, z: f64) -> f32 {
        let bins = self.outcomes.grid.bins;
        let row = &self.densities[cell * (bins + 1)..(cell + 1) * (bins + 1)];
        let position = (z - self.outcomes.grid.lo) * self.inverse_width;
        if self.outcomes.point_mass_at == Some(z) {
            row[bins]
        } else if position >= 0.0 && position < bins as f64 {
            row[position as usize]
        } else {
            0.0
        }
    }

    /// p(z | x): density per unit of z, or the probability where z is the point mass.
    ///
    /// # Panics
    /// If the state hasn't one coordinate per axis.
    #[inline]
    pub fn density(&self, state: &[f64], z: f64) -> f32 {
        self.density_in(self.cell(state), z)
    }
}
