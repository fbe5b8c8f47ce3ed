//! Costs on one thread: `cargo bench -p locsim-mcl`. Times are of whole calls; with 10,000 and 1,000,000 particles
//! ns per particle are read off by moving the point: 123.4 us for 10,000 are 12.34 ns, 12.34 ms for 1,000,000 too.
//! The toy room and sensor cost little, so that a whole step shows the filter's own share.

use std::sync::Arc;
use std::time::Duration;

use divan::Bencher;
use divan::counter::ItemsCount;
use locsim_core::{Draw, Laser, Particles, Pose2, Scan, Stage, Weights};
use locsim_mcl::{
    Clusters, Filter, FilterOptions, MotionModel, Multinomial, OdometryMotion, ParticleCount, PoseBins,
    ResampleTrigger, Resampler, Residual, Spread, Start, StepInput, Stratified, Systematic, VelocityMotion,
    max_weight, weighted_mean,
};
use toy::{Gaussian, Room};

#[path = "../tests/toy/mod.rs"]
mod toy;

const SIZES: [usize; 2] = [10_000, 1_000_000];
const INCREMENT: Pose2 = Pose2 { x: 0.1, y: 0.01, theta: 0.1 };

fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the first and only pool");
    divan::Divan::default().sample_count(100).max_time(Duration::from_secs(2)).config_with_args().main();
}

/// A cloud of half a metre and the weights of a plausible posterior.
fn cloud(n: usize) -> (Particles, Weights) {
    let mut particles: Particles = (0..n).map(|_| Pose2::new(5.0, 3.0, 1.0)).collect();
    let motion = OdometryMotion::new([0.5, 0.1, 10.0, 0.1]).unwrap();
    motion.propagate(&INCREMENT, &Draw::new(1, Stage::Motion, 0), &mut particles);
    let mut weights = Weights::uniform(n);
    let log_likelihood: Vec<f64> = particles.x.iter().map(|x| -20.0 * (x - 5.0).powi(2)).collect();
    weights.update(&log_likelihood).unwrap();
    (particles, weights)
}

fn predict(bencher: Bencher<'_, '_>, n: usize, motion: &dyn MotionModel) {
    let (mut particles, _) = cloud(n);
    let draw = Draw::new(2, Stage::Motion, 1);
    bencher.counter(ItemsCount::new(n)).bench_local(|| motion.propagate(&INCREMENT, &draw, &mut particles));
}

#[divan::bench(args = SIZES)]
fn predict_odometry(bencher: Bencher<'_, '_>, n: usize) {
    predict(bencher, n, &OdometryMotion::new([0.1; 4]).unwrap());
}

#[divan::bench(args = SIZES)]
fn predict_velocity(bencher: Bencher<'_, '_>, n: usize) {
    predict(bencher, n, &VelocityMotion::new([0.1; 6]).unwrap());
}

fn resample(bencher: Bencher<'_, '_>, n: usize, resampler: &dyn Resampler) {
    let (particles, weights) = cloud(n);
    resample_from(bencher, &particles, &weights, resampler);
}

fn resample_from(
    bencher: Bencher<'_, '_>,
    particles: &Particles,
    weights: &Weights,
    resampler: &dyn Resampler,
) {
    let n = particles.len();
    let draw = Draw::new(3, Stage::Resample, 1);
    let (mut ancestors, mut next) = (Vec::new(), Particles::default());
    bencher.counter(ItemsCount::new(n)).bench_local(|| {
        resampler.ancestors(weights, n, &draw, &mut ancestors);
        next.gather(particles, &ancestors);
    });
}

#[divan::bench(args = SIZES)]
fn resample_multinomial(bencher: Bencher<'_, '_>, n: usize) {
    resample(bencher, n, &Multinomial);
}

#[divan::bench(args = SIZES)]
fn resample_systematic(bencher: Bencher<'_, '_>, n: usize) {
    resample(bencher, n, &Systematic);
}

/// A sharp posterior: of a hundred particles few live on.
#[divan::bench(args = SIZES)]
fn resample_systematic_few_survivors(bencher: Bencher<'_, '_>, n: usize) {
    let (particles, mut weights) = cloud(n);
    let log_likelihood: Vec<f64> = particles.x.iter().map(|x| -5000.0 * (x - 5.0).powi(2)).collect();
    weights.update(&log_likelihood).unwrap();
    resample_from(bencher, &particles, &weights, &Systematic);
}

#[divan::bench(args = SIZES)]
fn resample_stratified(bencher: Bencher<'_, '_>, n: usize) {
    resample(bencher, n, &Stratified);
}

#[divan::bench(args = SIZES)]
fn resample_residual(bencher: Bencher<'_, '_>, n: usize) {
    resample(bencher, n, &Residual);
}

/// Multiply by likelihoods and normalize, again and again: the cost does not depend on the values.
#[divan::bench(args = SIZES)]
fn update_weights(bencher: Bencher<'_, '_>, n: usize) {
    let (particles, mut weights) = cloud(n);
    let log_likelihood: Vec<f64> = particles.x.iter().map(|x| -20.0 * (x - 5.0).powi(2)).collect();
    bencher.counter(ItemsCount::new(n)).bench_local(|| weights.update(&log_likelihood));
}

/// Weighted mean, covariance, and the particle of the greatest weight.
#[divan::bench(args = SIZES)]
fn estimate_mean(bencher: Bencher<'_, '_>, n: usize) {
    let (particles, weights) = cloud(n);
    bencher
        .counter(ItemsCount::new(n))
        .bench_local(|| (weighted_mean(&particles, &weights), max_weight(&particles, &weights)));
}

/// The same where nothing is known of the heading, so that it takes a second pass.
#[divan::bench(args = SIZES)]
fn estimate_mean_of_all_headings(bencher: Bencher<'_, '_>, n: usize) {
    let (mut particles, weights) = cloud(n);
    for (i, theta) in particles.theta.iter_mut().enumerate() {
        *theta = Pose2::new(0.0, 0.0, i as f64).theta;
    }
    bencher.counter(ItemsCount::new(n)).bench_local(|| weighted_mean(&particles, &weights));
}

#[divan::bench(args = SIZES)]
fn estimate_cluster(bencher: Bencher<'_, '_>, n: usize) {
    let (particles, weights) = cloud(n);
    let mut clusters = Clusters::new(PoseBins::new(0.5, 10_f64.to_radians()).unwrap());
    bencher.counter(ItemsCount::new(n)).bench_local(|| clusters.heaviest(&particles, &weights));
}

/// Predict, cast and weight 36 beams, estimate the mean and resample.
#[divan::bench(args = [1_000, 10_000, 100_000])]
fn step(bencher: Bencher<'_, '_>, n: usize) {
    let room = Room { width: 10.0, depth: 6.0 };
    let bearings = (0..36).map(|i| (i as f32 * 10.0).to_radians()).collect();
    let laser = Laser::new(bearings, vec![0.0; 36], 0.0, 20.0, Pose2::IDENTITY).unwrap();
    let scan = Scan { ranges: vec![3.0; 36] };
    let options = FilterOptions {
        particles: ParticleCount::Fixed(n),
        motion: Arc::new(OdometryMotion::new([0.1; 4]).unwrap()),
        resampler: Arc::new(Systematic),
        trigger: ResampleTrigger::EachStep,
        injection: None,
        regularization: None,
        update: None,
        least_effective_share: None,
        clusters: None,
        annealing: None,
        ancestry: false,
    };
    let start =
        Start::Tracking { pose: Pose2::new(5.0, 3.0, 0.0), spread: Spread { sigma_m: 0.3, sigma_rad: 0.1 } };
    let mut filter = Filter::new(options, &start, &room, 1).unwrap();
    let input = StepInput { odometry: Pose2::IDENTITY, laser: &laser, scan: &scan };
    let model = Gaussian { sigma_m: 1.0 };
    bencher.counter(ItemsCount::new(n)).bench_local(|| filter.step(&input, &room, &model).unwrap());
}
