//! The paper's batch, N = 1000 states, M = 100 observations each, Q = 200 queries, B = 4501 bins, and how its time
//! grows with each of them and with the dimension p of the state.

use distreg::{
    Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, Kernel, NpReg, NpRegOptions,
    Outcomes, Predictions, Regressor, Table, Weighting,
};
use divan::Bencher;
use locsim_bench::regression::{Task, Truth};
use rand_distr::{Distribution as _, StandardNormal};
use rand_philox::{Philox, u32_to_unit_f64};

fn main() {
    divan::main();
}

fn faithful(outcomes: Outcomes, bandwidths: &[f64]) -> NpRegOptions {
    NpRegOptions {
        outcomes,
        alignment: Alignment::Identity,
        density: DensityEstimate::Histogram,
        weighting: Weighting::kernel(Kernel::Gaussian, bandwidths),
        degree: Degree::Constant,
    }
}

fn registered(outcomes: Outcomes, bandwidths: &[f64], degree: Degree) -> NpRegOptions {
    NpRegOptions {
        alignment: Alignment::Shift { state_dim: 0 },
        weighting: Weighting::kernel(Kernel::Epanechnikov, bandwidths),
        degree,
        ..faithful(outcomes, bandwidths)
    }
}

/// Weights and product of all queries, on the given number of threads, into memory that is used again.
fn predict(bencher: Bencher, threads: usize, model: &NpReg, queries: &[f64]) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let mut predictions = Predictions::new(model.outcomes());
    bencher.bench_local(|| pool.install(|| model.predict_batch_into(queries, &mut predictions)));
}

/// The fixed task, with the bandwidths that its cross-validation chooses.
fn on_task(bencher: Bencher, threads: usize, truth: Truth, method: impl Fn(Outcomes) -> NpRegOptions) {
    let task = Task::new(truth).expect("the task");
    let model = method(Task::outcomes().expect("a grid")).fit(&task.train).expect("a fit");
    predict(bencher, threads, &model, &task.queries);
}

#[divan::bench(args = [1, 2])]
fn faithful_gauss(bencher: Bencher, threads: usize) {
    on_task(bencher, threads, Truth::Gauss, |outcomes| faithful(outcomes, &[0.0034, 0.37]));
}

#[divan::bench(args = [1, 2])]
fn faithful_mixed(bencher: Bencher, threads: usize) {
    on_task(bencher, threads, Truth::Mixed, |outcomes| faithful(outcomes, &[0.026, 0.125]));
}

#[divan::bench(args = [1, 2])]
fn registered_gauss(bencher: Bencher, threads: usize) {
    on_task(bencher, threads, Truth::Gauss, |outcomes| registered(outcomes, &[0.4, 0.14], Degree::Linear));
}

#[divan::bench(args = [1, 2])]
fn registered_mixed(bencher: Bencher, threads: usize) {
    on_task(bencher, threads, Truth::Mixed, |outcomes| registered(outcomes, &[0.8, 0.2], Degree::Linear));
}

/// Registered without balanced weights.
#[divan::bench]
fn registered_mixed_unbalanced(bencher: Bencher) {
    on_task(bencher, 1, Truth::Mixed, |outcomes| registered(outcomes, &[0.8, 0.1], Degree::Constant));
}

/// A thousand densities from a prepared table.
#[divan::bench]
fn thousand_densities(bencher: Bencher) {
    let task = Task::new(Truth::Mixed).expect("the task");
    let model = faithful(Task::outcomes().expect("a grid"), &[0.026, 0.125]).fit(&task.train).expect("a fit");
    let table = Table::of_predictions(&model.predict_batch(&task.queries).expect("predictions"));
    let z: Vec<f64> = (0..1000).map(|k| f64::from(k * 37 % 1000) * 0.0045).collect();
    bencher.bench_local(|| z.iter().map(|&z| table.density(&[17.0], z)).sum::<f32>());
}

/// A laser in p dimensions: the first is the range, the others don't matter.
struct Size {
    states: usize,
    draws: usize,
    queries: usize,
    bins: usize,
    dim: usize,
}

const PAPER: Size = Size { states: 1000, draws: 100, queries: 200, bins: 4501, dim: 2 };

fn of_size(bencher: Bencher, size: &Size) {
    let states = |count: usize, seed: u64| -> Vec<f64> {
        let mut random = Philox::from_u64_seed(seed);
        let mut unit = || u32_to_unit_f64(random.next_u32());
        (0..count * size.dim).map(|k| if k % size.dim == 0 { 0.3 + 3.9 * unit() } else { unit() }).collect()
    };
    let mut data = Dataset::new(size.dim);
    for (i, state) in states(size.states, 1).chunks(size.dim).enumerate() {
        let mut random = Philox::from_u64_seed_stream(2, i as u64);
        let z: Vec<f64> = (0..size.draws)
            .map(|_| {
                let e: f64 = StandardNormal.sample(&mut random);
                state[0] + (0.002 + 0.0012 * state[0].powi(2)) * e
            })
            .collect();
        data.push(state, &z).expect("states and observations are finite");
    }
    let outcomes = Outcomes::of_values(0.0, 4.5, 4.5 / (size.bins - 1) as f64).expect("a grid");
    let mut bandwidths = vec![0.3; size.dim];
    bandwidths[0] = 0.02;
    let model = faithful(outcomes, &bandwidths).fit(&data).expect("a fit");
    predict(bencher, 1, &model, &states(size.queries, 3));
}

#[divan::bench(args = [1000, 4000, 16000])]
fn by_states(bencher: Bencher, states: usize) {
    of_size(bencher, &Size { states, ..PAPER });
}

#[divan::bench(args = [1, 10, 100, 1000])]
fn by_draws(bencher: Bencher, draws: usize) {
    of_size(bencher, &Size { draws, ..PAPER });
}

#[divan::bench(args = [50, 200, 800])]
fn by_queries(bencher: Bencher, queries: usize) {
    of_size(bencher, &Size { queries, ..PAPER });
}

#[divan::bench(args = [451, 4501, 45001])]
fn by_bins(bencher: Bencher, bins: usize) {
    of_size(bencher, &Size { bins, ..PAPER });
}

#[divan::bench(args = [1, 2, 4, 8])]
fn by_dimension(bencher: Bencher, dim: usize) {
    of_size(bencher, &Size { dim, ..PAPER });
}
