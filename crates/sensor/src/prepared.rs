//! Any model that knows a beam by its state alone, as a table.

use std::sync::Arc;

use locsim_core::{Beams, Draw, LikelihoodGrid, LikelihoodTable, Poses, SensorModel};
use rayon::prelude::*;

use crate::SensorError;

/// A model with its log densities in a [`LikelihoodTable`], for filters that want them fast: a beam then costs one
/// read. All else is the model's own.
pub struct Prepared {
    inner: Arc<dyn SensorModel>,
    table: LikelihoodTable,
}

impl Prepared {
    /// Evaluates `inner` at every knot of `grid`, in parallel.
    ///
    /// # Errors
    /// [`SensorError::DependsOnPlace`] for a model that wants to know more of a beam than nominal range and incidence.
    pub fn new(inner: Arc<dyn SensorModel>, grid: LikelihoodGrid) -> Result<Self, SensorError> {
        if inner.depends_on_place() {
            return Err(SensorError::DependsOnPlace { model: inner.name().to_owned() });
        }
        let (range, incidence) = grid.states();
        let n = range.len();
        // The state is all that such a model looks at: the beams' poses, bearings and surfaces are dummies.
        let (bearings, surface) = (vec![0.0; n], vec![0; n]);
        let laser = Poses { x: &[0.0], y: &[0.0], theta: &[0.0] };
        let beams = Beams {
            laser,
            bearings: &bearings,
            range: &range,
            incidence: &incidence,
            surface: &surface,
            max_range: grid.max_range,
        };
        let mut log_density = vec![0.0; grid.rows() * n];
        log_density.par_chunks_mut(n).enumerate().for_each_init(
            || vec![0.0; n],
            |z, (row, out)| {
                z.fill(grid.reading(row));
                inner.log_density(z, &beams, out);
            },
        );
        Ok(Self { table: LikelihoodTable::new(grid, &log_density), inner })
    }
}

impl SensorModel for Prepared {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        self.inner.log_density(z, beams, out);
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        self.inner.cdf(z, beams, out);
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        self.inner.sample(beams, draw, out);
    }

    fn table(&self) -> Option<&LikelihoodTable> {
        Some(&self.table)
    }
}
