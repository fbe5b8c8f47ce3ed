//! The fixed task by which distribution regression is measured: a synthetic range sensor whose truth is known, N = 1000 states
//! with M = 100 observations each, Q = 200 queries, B = 4501 bins.
//!
//! The data are those of a `NumPy` script with `default_rng(7)`, reading by reading; `NumPy`'s generator is part of
//! this module, so no file is needed. Bandwidths are chosen by cross-validation on the training states; queries and the
//! truth are looked at once, for the risk.

mod numpy;
mod task;

use std::hint::black_box;

use locsim_core::Clock;
use rayon::ThreadPool;
use serde::{Deserialize, Serialize};

pub use task::{Task, Truth};

use crate::BenchError;
use distreg::{
    Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, Error, Family, Found, Kernel, Loss,
    NpReg, NpRegOptions, Outcomes, PRegOptions, Predictions, Regressor, Smoother, Standardized,
    StandardizedOptions, Support, Table, Weighting, cross_validate, grid_search, optimize, product,
};

/// Folds of the cross-validation over training states that chooses all bandwidths, and its seed.
const FOLDS: usize = 5;
const FOLD_SEED: u64 = 1;

/// Runs whose shortest time counts.
const REPETITIONS: usize = 30;

/// Results of the benchmark.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Time of weights and product of all queries, of the slower truth.
    pub predict_ms: PredictMs,
    /// Time of one density at one query from a prepared table \[ns\].
    pub density_ns: f64,
    /// Risk of each method \[mm\]: mean histogram match with the truth at the queries.
    pub risk_mm: RiskMm,
    /// The alignment of the registered method of each truth, chosen by cross-validation on the training states.
    pub registered_by: RegisteredBy,
    /// Largest difference of any predicted mass from the dense f64 product.
    pub max_abs_diff_from_dense: f64,
    /// The choices of cross-validation: a line per truth and method.
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
    /// NP-REG, registered by the [`Registration`] that the report's `registered_by` names.
    pub registered: f64,
    /// P-REG with a Gaussian, as published.
    pub p_reg: f64,
}

/// The alignment of observations by registered NP-REG.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Registration {
    /// z - r.
    #[default]
    Range,
    /// (z - m(x)) / s(x) with a learned location m and scale s.
    LocationAndScale,
}

impl std::fmt::Display for Registration {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Range => "z - r",
            Self::LocationAndScale => "location and scale",
        })
    }
}

/// The registration of each truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegisteredBy {
    /// [`Truth::Gauss`].
    pub gauss: Registration,
    /// [`Truth::Mixed`].
    pub mixed: Registration,
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

/// Registered NP-REG by a learned location and scale: residuals in bins of 0.05 deviations.
fn standardized(
    outcomes: Outcomes,
    location_scale: &[f64],
    bandwidths: &[f64],
) -> Result<StandardizedOptions<NpRegOptions>, Error> {
    let residuals = Outcomes::of_values(-8.0, 8.0, 0.05)?.with_point_mass(LOST);
    Ok(StandardizedOptions {
        location_scale: locations(outcomes, location_scale),
        residual: NpRegOptions { alignment: Alignment::Identity, ..registered(residuals, bandwidths) },
    })
}

/// The value of a lost return among residuals.
const LOST: f64 = 100.0;

/// Regression of location and scale.
fn locations(outcomes: Outcomes, bandwidths: &[f64]) -> PRegOptions {
    PRegOptions {
        outcomes,
        weighting: Weighting::kernel(Kernel::Epanechnikov, bandwidths),
        ..p_reg(outcomes, bandwidths)
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
pub fn run(clock: Clock<'_>) -> Result<Report, BenchError> {
    let pools = [1, 2].map(|threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build());
    let [one, two] = pools;
    let (one, two) = (one?, two?);
    let outcomes = Task::outcomes()?;
    let mut report = Report {
        predict_ms: PredictMs::default(),
        density_ns: f64::INFINITY,
        risk_mm: RiskMm::default(),
        registered_by: RegisteredBy::default(),
        max_abs_diff_from_dense: 0.0,
        chosen: Vec::new(),
    };
    for truth in [Truth::Gauss, Truth::Mixed] {
        let task = Task::new(truth)?;
        let mut risk = MethodRisk::default();

        let slower = |time: &mut f64, found: f64| *time = time.max(found);

        let chosen = search(&task, &FACTORS, [0.002, 0.2], |h| Ok(faithful(outcomes, h)))?;
        report.note(truth, "faithful", &chosen);
        let model = faithful(outcomes, &chosen.candidate).fit(&task.train)?;
        let predictions = model.predict_batch(&task.queries)?;
        risk.faithful = task.risk(&predictions);
        slower(&mut report.predict_ms.faithful, batch_ms(&model, &task, &one, clock)?);
        slower(&mut report.predict_ms.faithful_2_threads, batch_ms(&model, &task, &two, clock)?);
        slower(&mut report.max_abs_diff_from_dense, difference_of_np_reg(&model, &task, &predictions)?);

        let by_range = search(&task, &FACTORS, [0.4, 0.1], |h| Ok(registered(outcomes, h)))?;
        report.note(truth, "registered by z - r", &by_range);
        let place = search(&task, &FACTORS, [0.4, 0.1], |h| Ok(locations(outcomes, h)))?;
        report.note(truth, "location and scale", &place);
        let by_place =
            search(&task, &FEW_FACTORS, [0.8, 0.2], |h| standardized(outcomes, &place.candidate, h))?;
        report.note(truth, "registered by location and scale", &by_place);
        let registration = if by_range.score < by_place.score {
            Registration::Range
        } else {
            Registration::LocationAndScale
        };
        let (model, difference): (Box<dyn ConditionalDistribution>, f64) = if registration
            == Registration::Range
        {
            let model = registered(outcomes, &by_range.candidate).fit(&task.train)?;
            let difference = difference_of_np_reg(&model, &task, &model.predict_batch(&task.queries)?)?;
            (Box::new(model), difference)
        } else {
            let model = standardized(outcomes, &place.candidate, &by_place.candidate)?.fit(&task.train)?;
            let difference = difference_of_standardized(&model, &task, &model.predict_batch(&task.queries)?)?;
            (Box::new(model), difference)
        };
        slower(&mut report.max_abs_diff_from_dense, difference);
        let predictions = model.predict_batch(&task.queries)?;
        risk.registered = task.risk(&predictions);
        slower(&mut report.predict_ms.registered, batch_ms(model.as_ref(), &task, &one, clock)?);
        report.density_ns = report.density_ns.min(density_ns(&Table::of_predictions(&predictions), clock));

        let chosen = search(&task, &FACTORS, [0.2, 0.1], |h| Ok(p_reg(outcomes, h)))?;
        report.note(truth, "p_reg", &chosen);
        let model = p_reg(outcomes, &chosen.candidate).fit(&task.train)?;
        risk.p_reg = task.risk(&model.predict_batch(&task.queries)?);
        match truth {
            Truth::Gauss => (report.risk_mm.gauss, report.registered_by.gauss) = (risk, registration),
            Truth::Mixed => (report.risk_mm.mixed, report.registered_by.mixed) = (risk, registration),
        }
    }
    Ok(report)
}

/// The report as text for people.
pub fn terminal_text(report: &Report) -> String {
    let (ms, gauss, mixed) = (report.predict_ms, report.risk_mm.gauss, report.risk_mm.mixed);
    format!(
        "200 queries [ms]: faithful {:.3}, on two threads {:.3}, registered {:.3}\n\
             one density from a table [ns]: {:.2}\n\
             risk, gauss [mm]: faithful {:.3}, registered {:.3} (by {}), p_reg {:.3}\n\
             risk, mixed [mm]: faithful {:.3}, registered {:.3} (by {}), p_reg {:.3}\n\
             largest difference from the dense product: {:.1e}",
        ms.faithful,
        ms.faithful_2_threads,
        ms.registered,
        report.density_ns,
        gauss.faithful,
        gauss.registered,
        report.registered_by.gauss,
        gauss.p_reg,
        mixed.faithful,
        mixed.registered,
        report.registered_by.mixed,
        mixed.p_reg,
        report.max_abs_diff_from_dense
    )
}

/// Candidates for bandwidths, as factors of a scale.
const FACTORS: [f64; 7] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
/// Candidates for residuals, which change little with the state: wider ones would gain little and cost time.
const FEW_FACTORS: [f64; 3] = [0.25, 0.5, 1.0];

/// The bandwidths of least cross-validated risk over training states: the best of a grid of factors of `scale`, and
/// where that is open to wider ones, of a search around it.
fn search<R: Regressor>(
    task: &Task,
    factors: &[f64],
    scale: [f64; 2],
    method: impl Fn(&[f64]) -> Result<R, Error> + Send + Sync,
) -> Result<Found<Vec<f64>>, Error> {
    let axes = scale.map(|h| factors.iter().map(|factor| factor * h).collect::<Vec<_>>());
    let score = |h: &[f64]| cross_validate(&method(h)?, &task.train, FOLDS, FOLD_SEED, Loss::HistogramMatch);
    let coarse = grid_search(&product(&[&axes[0], &axes[1]]), |h| score(h))?;
    if factors.len() == FACTORS.len() { optimize(&coarse.candidate, 1.4, 15, score) } else { Ok(coarse) }
}

impl Report {
    fn note(&mut self, truth: Truth, method: &str, found: &Found<Vec<f64>>) {
        let [h_range, h_incidence] = [found.candidate[0], found.candidate[1]];
        self.chosen.push(format!(
            "{truth:?}, {method}: bandwidths {h_range:.4} m, {h_incidence:.4} rad, score {:.3}",
            found.score
        ));
    }
}

/// Shortest time of all queries, in milliseconds, into memory that is used again.
fn batch_ms<M: ConditionalDistribution + ?Sized>(
    model: &M,
    task: &Task,
    pool: &ThreadPool,
    clock: Clock<'_>,
) -> Result<f64, Error> {
    let mut predictions = Predictions::new(model.outcomes());
    let mut best = f64::INFINITY;
    for _ in 0..REPETITIONS {
        let start = clock();
        pool.install(|| model.predict_batch_into(black_box(&task.queries), &mut predictions))?;
        best = best.min(clock().saturating_sub(start).as_secs_f64() * 1e3);
    }
    Ok(best)
}

/// Shortest mean time of a density in nanoseconds, over many readings at each query, as a filter asks.
fn density_ns(table: &Table, clock: Clock<'_>) -> f64 {
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
        best =
            best.min(clock().saturating_sub(start).as_secs_f64() * 1e9 / (f64::from(cells) * z.len() as f64));
    }
    best
}

/// Largest difference of predicted masses from the dense product, for NP-REG of z or of z - r.
fn difference_of_np_reg(model: &NpReg, task: &Task, predictions: &Predictions) -> Result<f64, Error> {
    let grid = model.options().outcomes.grid;
    let registered = model.options().alignment != Alignment::Identity;
    let mut largest: f64 = 0.0;
    for (q, query) in task.queries.chunks(2).enumerate() {
        let (row, point) = dense_product(model, &task.train, query, predictions.support()[q])?;
        // Bin b of z - r starts at (b - B) widths.
        let start = if registered { (query[0] - grid.lo) / grid.width - grid.bins as f64 } else { 0.0 };
        let (expected, above) = move_bins(&row, start, 1.0, grid.bins);
        largest = largest.max(difference(predictions, q, &expected, point + above));
    }
    Ok(largest)
}

/// The same for NP-REG of residuals of location and scale.
fn difference_of_standardized(
    model: &Standardized<NpReg>,
    task: &Task,
    predictions: &Predictions,
) -> Result<f64, Error> {
    let residual = model.residual();
    let data = model.location_scale().residuals(&task.train, Some(LOST))?;
    let (from, to) = (residual.options().outcomes.grid, predictions.outcomes().grid);
    let mut largest: f64 = 0.0;
    for (q, query) in task.queries.chunks(2).enumerate() {
        let (row, point) = dense_product(residual, &data, query, predictions.support()[q])?;
        let (at, _) = model.location_scale().parameters(query)?;
        let start = (at.mean + at.sigma * from.lo - to.lo) / to.width;
        let (expected, above) = move_bins(&row, start, at.sigma * from.width / to.width, to.bins);
        largest = largest.max(difference(predictions, q, &expected, point + above));
    }
    Ok(largest)
}

fn difference(predictions: &Predictions, q: usize, expected: &[f64], point: f64) -> f64 {
    let bins = predictions.mass(q).iter().zip(expected).map(|(found, expected)| (found - expected).abs());
    bins.fold((predictions.points()[q] - point).abs(), f64::max)
}

/// The weighted mean of all states' histograms, bin by bin and without skipping anything, and that of the point
/// mass. Histograms of z - r have bins from -B to B.
fn dense_product(
    model: &NpReg,
    data: &Dataset,
    query: &[f64],
    support: Support,
) -> Result<(Vec<f64>, f64), Error> {
    let options = model.options();
    let (outcomes, grid) = (options.outcomes, options.outcomes.grid);
    let registered = options.alignment != Alignment::Identity;
    let mut weights = vec![0.0; data.len()];
    match &options.weighting {
        Weighting::Kernel { kernel, bandwidths }
            if options.degree == Degree::Constant && support == Support::InData =>
        {
            for (w, state) in weights.iter_mut().zip(data.states().chunks(2)) {
                let offsets = state.iter().zip(query).zip(bandwidths).map(|((x, q), h)| (x - q) / h);
                *w = kernel.at_squared(offsets.map(|u| u * u).sum());
            }
        }
        // Other weights are a model's own business; here it's the product that counts.
        weighting => {
            let mut sparse = Vec::new();
            Smoother::new(data, weighting)?.positive_weights(query, options.degree, &mut sparse)?;
            for (i, w) in sparse {
                weights[i] = w;
            }
        }
    }
    let total: f64 = weights.iter().sum();
    let mut row = vec![0.0; if registered { 2 * grid.bins } else { grid.bins }];
    let mut point = 0.0;
    for (i, weight) in weights.iter().enumerate() {
        let mut column = vec![0.0; row.len()];
        let z = data.observations(i);
        let mut points = 0.0;
        for &z in z {
            if outcomes.is_point(z) {
                points += 1.0;
            } else if registered {
                let aligned = ((z - data.state(i)[0]) / grid.width).floor();
                column[(aligned + grid.bins as f64) as usize] += 1.0;
            } else {
                column[grid.bin(z)] += 1.0;
            }
        }
        let factor = weight / total / z.len() as f64;
        for (r, count) in row.iter_mut().zip(column) {
            *r += factor * count;
        }
        point += factor * points;
    }
    Ok((row, point))
}

/// Bin b of `row` covers `start` + b `length` to `start` + (b + 1) `length` in bins of the result, evenly. What lies
/// below counts in the first bin; what lies above is given apart.
fn move_bins(row: &[f64], start: f64, length: f64, bins: usize) -> (Vec<f64>, f64) {
    let mut moved = vec![0.0; bins];
    let mut above = 0.0;
    for (b, mass) in row.iter().enumerate() {
        let (from, to) = (start + b as f64 * length, start + (b + 1) as f64 * length);
        for bin in from.floor() as i64..to.ceil() as i64 {
            let share = (to.min((bin + 1) as f64) - from.max(bin as f64)) / length;
            match usize::try_from(bin) {
                Ok(bin) if bin >= bins => above += share * mass,
                Ok(bin) => moved[bin] += share * mass,
                Err(_) => moved[0] += share * mass,
            }
        }
    }
    (moved, above)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of all readings \[mm\] and of readings with weights 0 to 999, of the true distribution functions, and risks
    /// at given bandwidths, as the task's scripts have them.
    #[test]
    fn data_truth_and_risk_are_those_of_numpy() {
        for (truth, sums, cdf_sum, bandwidths, risk) in [
            (Truth::Gauss, [222_961_283, 111_518_753_947], 723.963_577_932_255_5, [0.002, 0.4], 3.733),
            (Truth::Mixed, [219_693_775, 109_957_966_661], 3_442.313_225_235_566_3, [0.02, 0.2], 61.523),
        ] {
            let task = Task::new(truth).unwrap();
            let readings: Vec<u64> = (0..task.train.len())
                .flat_map(|i| task.train.observations(i))
                .map(|z| (z * 1000.0).round() as u64)
                .collect();
            let weighted: u64 = readings.iter().zip((0..1000).cycle()).map(|(z, k)| z * k).sum();
            assert_eq!([readings.iter().sum::<u64>(), weighted], sums);
            let cdf: f64 = task.cdf([task.queries[0], task.queries[1]]).iter().sum();
            assert!((cdf - cdf_sum).abs() < 1e-6, "{cdf}");
            let model = faithful(Task::outcomes().unwrap(), &bandwidths).fit(&task.train).unwrap();
            let found = task.risk(&model.predict_batch(&task.queries).unwrap());
            assert!((found - risk).abs() < 0.0005, "{found}");
        }
    }

    /// The difference is rounding alone; for predictions of other bandwidths, the control, it isn't.
    #[test]
    fn predictions_are_the_dense_product() {
        let mut task = Task::new(Truth::Mixed).unwrap();
        task.queries.truncate(60);
        let outcomes = Task::outcomes().unwrap();
        let predict =
            |method: &NpRegOptions| method.fit(&task.train).unwrap().predict_batch(&task.queries).unwrap();
        for (method, other) in [
            (faithful(outcomes, &[0.02, 0.1]), faithful(outcomes, &[0.02, 0.100_001])),
            (registered(outcomes, &[0.8, 0.2]), registered(outcomes, &[0.8, 0.200_001])),
        ] {
            let model = method.fit(&task.train).unwrap();
            let difference = |from| difference_of_np_reg(&model, &task, &predict(from)).unwrap();
            assert!(difference(&method) < 1e-12, "{}", difference(&method));
            assert!(difference(&other) > 1e-12);
        }
        let fit = |h: f64| standardized(outcomes, &[1.0, 0.1], &[0.4, h]).unwrap().fit(&task.train).unwrap();
        let model = fit(0.1);
        let difference = |from: &Standardized<NpReg>| {
            let predictions = from.predict_batch(&task.queries).unwrap();
            difference_of_standardized(&model, &task, &predictions).unwrap()
        };
        assert!(difference(&model) < 1e-12, "{}", difference(&model));
        assert!(difference(&fit(0.100_001)) > 1e-12);
    }
}
