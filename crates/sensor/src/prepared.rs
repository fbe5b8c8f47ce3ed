//! Models as tables.

use std::sync::Arc;

use locsim_core::{
    Beams, DependsOn, Draw, EndpointGrid, EndpointTable, LikelihoodGrid, LikelihoodTable, ModelTable, Poses,
    SensorModel,
};
use rayon::prelude::*;

use crate::SensorError;

/// A model with its log densities in a table, for filters that want them fast: a beam then costs one read. All else is
/// the model's own.
pub struct Prepared {
    inner: Arc<dyn SensorModel>,
    table: Table,
}

enum Table {
    State(LikelihoodTable),
    Endpoint(EndpointTable),
}

impl Prepared {
    /// Evaluates `inner` in parallel: at every knot of `states` if it looks at nominal range and incidence, at the
    /// centre of every cell of `endpoints` if it looks at where a reading ends. That grid has to reach as far beyond
    /// the map as the model distinguishes distances.
    ///
    /// # Errors
    /// [`SensorError::NoTable`] for a model that wants to know more of a beam.
    pub fn new(
        inner: Arc<dyn SensorModel>,
        states: LikelihoodGrid,
        endpoints: &EndpointGrid,
    ) -> Result<Self, SensorError> {
        let table = match inner.depends_on() {
            DependsOn::State => Table::State(over_states(&*inner, states)),
            DependsOn::Endpoint => Table::Endpoint(over_endpoints(&*inner, states.max_range, endpoints)),
            DependsOn::Everything => return Err(SensorError::NoTable { model: inner.name().to_owned() }),
        };
        Ok(Self { inner, table })
    }

    /// The table for `inner`, a model whose log density is `factor` times that of the model it was made of: the same with another
    /// exponent.
    #[must_use]
    pub fn scaled(self, inner: Arc<dyn SensorModel>, factor: f64) -> Self {
        let table = match self.table {
            Table::State(table) => Table::State(table.scaled(factor)),
            Table::Endpoint(table) => Table::Endpoint(table.scaled(factor)),
        };
        Self { inner, table }
    }
}

/// Rows of a table that are held as numbers at the same time.
const ROWS_AT_ONCE: usize = 64;

fn over_states(model: &dyn SensorModel, grid: LikelihoodGrid) -> LikelihoodTable {
    let (range, incidence) = grid.states();
    let n = range.len();
    // The state is all that such a model looks at: the beams' poses, bearings and surfaces are dummies.
    let (bearings, surface) = (vec![0.0; n], vec![0; n]);
    let beams = Beams {
        laser: Poses { x: &[0.0], y: &[0.0], theta: &[0.0] },
        bearings: &bearings,
        range: &range,
        incidence: &incidence,
        surface: &surface,
        max_range: grid.max_range,
    };
    let log_density = |row: usize| {
        let mut out = vec![0.0; n];
        model.log_density(&vec![grid.reading(row); n], &beams, &mut out);
        out
    };
    // Every row is evaluated twice: all of them as f32 would take twice the table's own memory.
    let widest = |[a, b]: [f32; 2], [c, d]: [f32; 2]| [a.min(c), b.max(d)];
    let none = [f32::INFINITY, f32::NEG_INFINITY];
    let limits = (0..grid.rows())
        .into_par_iter()
        .map(|row| log_density(row).into_iter().fold(none, |limits, l| widest(limits, [l, l])))
        .reduce(|| none, widest);
    let blocks = (0..grid.rows()).step_by(ROWS_AT_ONCE).map(|from| {
        let to = grid.rows().min(from + ROWS_AT_ONCE);
        (from..to).into_par_iter().map(log_density).collect::<Vec<_>>()
    });
    LikelihoodTable::of_rows(grid, limits, blocks.flatten())
}

fn over_endpoints(model: &dyn SensorModel, max_range: f32, grid: &EndpointGrid) -> EndpointTable {
    // Readings of half the maximum range that end at the centres of a row's cells, from lasers that look along x.
    let z = 0.5 * max_range;
    let n = grid.columns;
    let (theta, range, incidence, surface) = (vec![0.0; n], vec![z; n], vec![0.0; n], vec![0; n]);
    let score = |z: f32, x: &[f64], y: &[f64], out: &mut [f32]| {
        let n = out.len();
        let beams = Beams {
            laser: Poses { x, y, theta: &theta[..n] },
            bearings: &[0.0],
            range: &range[..n],
            incidence: &incidence[..n],
            surface: &surface[..n],
            max_range,
        };
        model.log_density(&[z], &beams, out);
    };
    let mut log_density = vec![0.0; grid.rows * n + 1];
    let (cells, no_return) = log_density.split_at_mut(grid.rows * n);
    cells.par_chunks_mut(n).enumerate().for_each(|(row, out)| {
        let (x, y): (Vec<f64>, Vec<f64>) = grid.centres(row).map(|[x, y]| (x - f64::from(z), y)).unzip();
        score(z, &x, &y, out);
    });
    score(max_range, &[0.0], &[0.0], no_return);
    EndpointTable::new(*grid, max_range, &log_density)
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

    fn table(&self) -> Option<ModelTable<'_>> {
        Some(match &self.table {
            Table::State(table) => ModelTable::State(table),
            Table::Endpoint(table) => ModelTable::Endpoint(table),
        })
    }
}
