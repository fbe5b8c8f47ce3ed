//! The paper's batch: N = 1000 states, M = 100 observations each, Q = 200 queries, B = 4501 bins.

use distreg::{Alignment, Dataset, Grid, Kernel, NpReg, NpRegOptions};
use divan::Bencher;
use rand_distr::{Distribution as _, StandardNormal};
use rand_philox::{Philox, u32_to_unit_f64};

fn main() {
    divan::main();
}

/// Range in metres and incidence in radians, uniform.
fn states(count: usize, seed: u64) -> Vec<f64> {
    let mut random = Philox::from_u64_seed(seed);
    let mut uniform = || u32_to_unit_f64(random.next_u32());
    (0..count).flat_map(|_| [0.3 + 3.9 * uniform(), 1.3 * uniform()]).collect()
}

fn model(alignment: Alignment, bandwidths: [f64; 2]) -> NpReg {
    let mut data = Dataset::new(2);
    for (i, state) in states(1000, 1).chunks(2).enumerate() {
        let mut random = Philox::from_u64_seed_stream(2, i as u64);
        let sigma = 0.002 + 0.0012 * state[0].powi(2);
        let z: Vec<f64> = (0..100)
            .map(|_| {
                let e: f64 = StandardNormal.sample(&mut random);
                ((state[0] + sigma * e) * 1000.0).round() / 1000.0
            })
            .collect();
        data.push(state, &z).expect("states and observations are finite");
    }
    let options = NpRegOptions {
        grid: Grid::of_values(0.0, 4.5, 0.001).expect("a valid grid"),
        point_mass_at: Some(4.5),
        alignment,
        observation_bandwidth: 0.0,
        kernel: Kernel::Gaussian,
        bandwidths: bandwidths.to_vec(),
    };
    NpReg::fit(&data, options).expect("valid options")
}

/// Weights and product of all queries, on the given number of threads.
fn predict(bencher: Bencher, threads: usize, model: &NpReg) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let queries = states(200, 3);
    bencher.bench_local(|| pool.install(|| model.predict_batch(&queries)));
}

#[divan::bench(args = [1, 2])]
fn faithful(bencher: Bencher, threads: usize) {
    predict(bencher, threads, &model(Alignment::Identity, [0.002, 0.4]));
}

#[divan::bench(args = [1, 2])]
fn registered(bencher: Bencher, threads: usize) {
    predict(bencher, threads, &model(Alignment::Shift { state_dim: 0 }, [0.2, 0.05]));
}
