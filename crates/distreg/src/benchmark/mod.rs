//! The fixed task by which this crate is measured: a synthetic range sensor whose truth is known, N = 1000 states
//! with M = 100 observations each, Q = 200 queries, B = 4501 bins.
//!
//! The data are those of a NumPy script with `default_rng(7)`, reading by reading; NumPy's generator is part of this
//! module, so no file is needed.

mod numpy;
mod task;

use std::hint::black_box;
use std::time::Duration;

use rayon::ThreadPool;
use serde::{Deserialize, Serialize};

pub use task::{Task, Truth};

use crate::{
    Alignment, ConditionalDistribution, Degree, DensityEstimate, Error, Family, Kernel, Loss, NpRegOptions,
    Outcomes, PRegOptions, Predictions, Regressor, Smoother, Support, Table, Weighting, cross_validate,
    grid_search, optimize, product,
};

/// Folds of the cross-validation over training states that chooses all bandwidths, and its seed.
const FOLDS: usize = 5;
const FOLD_SEED: u64 = 1;

/// Runs whose shortest time counts.
const REPETITIONS: usize = 30;

/// What the benchmark found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Time of weights and product of all queries, of the slower truth.
    pub predict_ms: PredictMs,
    /// Time of one density at one query from a prepared table \[ns\].
    pub density_ns: f64,
    /// Risk of each method \[mm\]: mean histogram match with the truth at the queries.
    pub risk_mm: RiskMm,
    /// Largest difference of any predicted mass from the dense f64 product.
    pub max_abs_diff_from_dense: f64,
    /// What cross-validation chose: a line per truth and method.
    pub chosen: Vec<String>,
}

/// Times of batches of 200 queries \[ms\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PredictMs {
    /// NP-REG as published, one thread.
    pub faithful: f64,
    /// The same on two threads.
    pub faithful_2_threads: f64,
    /// Registered NP-REG, one thread.
    pub registered: f64,
}

/// Risks for each truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RiskMm {
    /// [`Truth::Gauss`].
    pub gauss: MethodRisk,
    /// [`Truth::Mixed`].
    pub mixed: MethodRisk,
}

/// Risk of each method \[mm\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MethodRisk {
    /// NP-REG as published.
    pub faithful: f64,
    /// NP-REG of z - r, balanced.
    pub registered: f64,
    /// P-REG with a Gaussian, as published.
    pub p_reg: f64,
}

/// NP-REG as published: histograms, Gaussian kernel, mean.
fn faithful(outcomes: Outcomes, bandwidths: &[f64]) -> NpRegOptions {
    NpRegOptions {
        outcomes,
        alignment: Alignment::Identity,
        density: DensityEstimate::Histogram,
        weighting: Weighting::kernel(Kernel::Gaussian, bandwidths),
        degree: Degree::Constant,
    }
}

/// Registered NP-REG: histograms of z - r, Epanechnikov kernel, balanced mean.
fn registered(outcomes: Outcomes, bandwidths: &[f64]) -> NpRegOptions {
    NpRegOptions {
        alignment: Alignment::Shift { state_dim: 0 },
        weighting: Weighting::kernel(Kernel::Epanechnikov, bandwidths),
        degree: Degree::Linear,
        ..faithful(outcomes, bandwidths)
    }
}

/// P-REG as published: one Gaussian for all readings, planes.
fn p_reg(outcomes: Outcomes, bandwidths: &[f64]) -> PRegOptions {
    PRegOptions {
        outcomes: Outcomes { point_mass_at: None, ..outcomes },
        alignment: Alignment::Identity,
        family: Family::Gaussian,
        weighting: Weighting::kernel(Kernel::Gaussian, bandwidths),
        degree: Degree::Linear,
        smallest_sigma: outcomes.grid.width / 12f64.sqrt(),
        least_observations: 20,
    }
}

/// Runs the benchmark. `clock` gives the time since any fixed moment; it only times, and decides nothing.
///
/// # Errors
/// If a thread pool can't be made.
pub fn run(clock: &dyn Fn() -> Duration) -> Result<Report, BenchmarkError> {
    let pools = [1, 2].map(|threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build());
    let [one, two] = pools;
    let (one, two) = (one?, two?);
    let outcomes = Task::outcomes()?;
    let mut report = Report {
        predict_ms: PredictMs::default(),
        density_ns: f64::INFINITY,
        risk_mm: RiskMm::default(),
        max_abs_diff_from_dense: 0.0,
        chosen: Vec::new(),
    };
    for truth in [Truth::Gauss, Truth::Mixed] {
        let task = Task::new(truth)?;
        let mut risk = MethodRisk::default();

        let model = choose(&task, "faithful", |h| faithful(outcomes, h), [0.002, 0.2], &mut report)?;
        let predictions = model.predict_batch(&task.queries)?;
        risk.faithful = task.risk(&predictions);
        let slower = |time: &mut f64, found: f64| *time = time.max(found);
        slower(&mut report.predict_ms.faithful, batch_ms(&model, &task, &one, clock)?);
        slower(&mut report.predict_ms.faithful_2_threads, batch_ms(&model, &task, &two, clock)?);
        slower(&mut report.max_abs_diff_from_dense, difference_from_dense(&model, &task, &predictions)?);

        let model = choose(&task, "registered", |h| registered(outcomes, h), [0.4, 0.1], &mut report)?;
        let predictions = model.predict_batch(&task.queries)?;
        risk.registered = task.risk(&predictions);
        slower(&mut report.predict_ms.registered, batch_ms(&model, &task, &one, clock)?);
        slower(&mut report.max_abs_diff_from_dense, difference_from_dense(&model, &task, &predictions)?);
        report.density_ns = report.density_ns.min(density_ns(&Table::of_predictions(&predictions), clock));

        let model = choose(&task, "p_reg", |h| p_reg(outcomes, h), [0.2, 0.1], &mut report)?;
        risk.p_reg = task.risk(&model.predict_batch(&task.queries)?);
        match truth {
            Truth::Gauss => report.risk_mm.gauss = risk,
            Truth::Mixed => report.risk_mm.mixed = risk,
        }
    }
    Ok(report)
}

/// What can go wrong with a benchmark.
#[derive(Debug, thiserror::Error)]
pub enum BenchmarkError {
    /// The regression refused its input.
    #[error(transparent)]
    Regression(#[from] Error),
    /// No threads.
    #[error("cannot make a pool of threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
}

/// The model with the bandwidths of least cross-validated risk over training states: a grid of factors 1/4 to 16 of
/// `scale`, then a search around its best.
fn choose<R: Regressor>(
    task: &Task,
    name: &str,
    method: impl Fn(&[f64]) -> R + Send + Sync,
    scale: [f64; 2],
    report: &mut Report,
) -> Result<R::Model, Error> {
    let axes = scale.map(|h| [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0].map(|factor| factor * h));
    let score = |h: &[f64]| cross_validate(&method(h), &task.train, FOLDS, FOLD_SEED, Loss::HistogramMatch);
    let coarse = grid_search(&product(&[&axes[0], &axes[1]]), |h| score(h))?;
    let fine = optimize(&coarse.candidate, 1.4, 15, score)?;
    let h = &fine.candidate;
    let line = format!(
        "{:?} {name}: bandwidths {:.4} m, {:.4} rad, score {:.3}",
        task.truth(),
        h[0],
        h[1],
        fine.score
    );
    report.chosen.push(line);
    method(h).fit(&task.train)
}

/// Shortest time of all queries, in milliseconds, into memory that is used again.
fn batch_ms<M: ConditionalDistribution>(
    model: &M,
    task: &Task,
    pool: &ThreadPool,
    clock: &dyn Fn() -> Duration,
) -> Result<f64, Error> {
    let mut predictions = Predictions::new(model.outcomes());
    let mut best = f64::INFINITY;
    for _ in 0..REPETITIONS {
        let start = clock();
        pool.install(|| model.predict_batch_into(black_box(&task.queries), &mut predictions))?;
        best = best.min((clock() - start).as_secs_f64() * 1e3);
    }
    Ok(best)
}

/// Shortest mean time of a density in nanoseconds, over many readings at each query, as a filter asks.
fn density_ns(table: &Table, clock: &dyn Fn() -> Duration) -> f64 {
    let z: Vec<f64> = (0..1000).map(|k| f64::from(k * 37 % 1000) * 0.0045).collect();
    let cells = 200;
    let mut best = f64::INFINITY;
    for _ in 0..REPETITIONS {
        let start = clock();
        let mut sum = 0.0;
        for cell in 0..cells {
            for &z in black_box(&z) {
                sum += table.density(&[f64::from(cell)], z);
            }
        }
        black_box(sum);
        best = best.min((clock() - start).as_secs_f64() * 1e9 / (f64::from(cells) * z.len() as f64));
    }
    best
}

/// Largest difference of predicted masses from the dense product of all states' histograms, bin by bin and without
/// skipping anything.
fn difference_from_dense(model: &crate::NpReg, task: &Task, predictions: &Predictions) -> Result<f64, Error> {
    let options = model.options();
    let (grid, n) = (options.outcomes.grid, task.train.len());
    let Weighting::Kernel { kernel, bandwidths } = &options.weighting else {
        return Ok(f64::INFINITY);
    };
    let smoother = Smoother::new(&task.train, &options.weighting)?;
    let registered = options.alignment != Alignment::Identity;
    // Bins of z, or of z - r from -B to B, and the point mass as one more.
    let bins = if registered { 2 * grid.bins } else { grid.bins };
    let mut dense = vec![0.0; (bins + 1) * n];
    for i in 0..n {
        let column = &mut dense[i * (bins + 1)..(i + 1) * (bins + 1)];
        let z = task.train.observations(i);
        for &z in z {
            let bin = match (options.outcomes.is_point(z), registered) {
                (true, _) => bins,
                (false, false) => grid.bin(z),
                (false, true) => {
                    let aligned = ((z - task.train.state(i)[0]) / grid.width).floor();
                    (aligned + grid.bins as f64) as usize
                }
            };
            column[bin] += 1.0;
        }
        for mass in column {
            *mass /= z.len() as f64;
        }
    }
    let mut largest: f64 = 0.0;
    for (q, query) in task.queries.chunks(2).enumerate() {
        let mut weights = vec![0.0; n];
        if options.degree == Degree::Constant && predictions.support()[q] == Support::InData {
            for (w, state) in weights.iter_mut().zip(task.train.states().chunks(2)) {
                let offsets = state.iter().zip(query).zip(bandwidths).map(|((x, q), h)| (x - q) / h);
                *w = kernel.at_squared(offsets.map(|u| u * u).sum());
            }
        } else {
            // The weights themselves are a model's own business; here it's the product that counts.
            let mut sparse = Vec::new();
            smoother.positive_weights(query, options.degree, &mut sparse)?;
            for (i, w) in sparse {
                weights[i] = w;
            }
        }
        let total: f64 = weights.iter().sum();
        let mut row = vec![0.0; bins + 1];
        for (w, column) in weights.iter().zip(dense.chunks(bins + 1)) {
            for (r, mass) in row.iter_mut().zip(column) {
                *r += w / total * mass;
            }
        }
        let mut expected = vec![0.0; grid.bins];
        let mut point = row[bins];
        if registered {
            // Bin b of z - r starts at (b - B) widths; in the grid at r, its mass is even over one width.
            for (b, mass) in row[..bins].iter().enumerate() {
                let at = b as f64 - grid.bins as f64 + (query[0] - grid.lo) / grid.width;
                for (bin, share) in [(at.floor(), 1.0 - at + at.floor()), (at.floor() + 1.0, at - at.floor())]
                {
                    if bin >= grid.bins as f64 {
                        point += share * mass;
                    } else {
                        expected[bin.max(0.0) as usize] += share * mass;
                    }
                }
            }
        } else {
            expected.copy_from_slice(&row[..bins]);
        }
        for (found, expected) in predictions.mass(q).iter().zip(&expected) {
            largest = largest.max((found - expected).abs());
        }
        largest = largest.max((predictions.points()[q] - point).abs());
    }
    Ok(largest)
}
