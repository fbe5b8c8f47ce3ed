//! Which family of distributions fits the rays of a static lidar, and whether a sample is Gaussian.

use distreg::{Distribution, Error, Grid, Kernel, gaussian_parameters, kernel_density, log_loss};
use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use super::experiment::{Sample, Samples};
use super::results::{Families, Family};
use super::sensor::RaySummary;
use super::{Study, StudyError};
use crate::statistics::Bootstrap;

/// Level of the test for a Gaussian.
const LEVEL: f64 = 0.01;
/// Least expected number in a cell of the test, as textbooks ask.
const LEAST_EXPECTED: f64 = 5.0;
/// Share of a uniform floor under every family, without which one reading far off decides over a family.
const FLOOR: f64 = 1e-3;
/// Bandwidths that the kernel density chooses from, in bins.
const BANDWIDTHS: [f64; 8] = [0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0];
/// Rays that figures show.
const SHOWN: usize = 6;
/// Steps of expectation maximization; it has long converged then.
const STEPS: usize = 300;

/// Whether a chi-square test of level 1 % tells the observations from a Gaussian that is rounded to the bins of `grid`.
///
/// Mean and deviation are estimated from the observations themselves, which makes the statistic's distribution lie
/// between chi-squares of k - 3 and k - 1 degrees of freedom for k cells (Chernoff and Lehmann 1954); the latter is used,
/// so that a Gaussian is taken for something else in at most 1 % of cases.
pub(super) fn is_not_gaussian(observations: &[f64], grid: &Grid) -> bool {
    let (mean, Some(sigma)) = gaussian_parameters(observations) else { return false };
    // Rounding to bins adds width^2 / 12 to the variance that the Gaussian behind it has.
    let sigma = (sigma * sigma - grid.width.powi(2) / 12.0).max(1e-3 * grid.width.powi(2)).sqrt();
    let Ok(normal) = Normal::new(mean, sigma) else { return false };
    let mut counts = vec![0.0; grid.bins];
    for &z in observations {
        counts[grid.bin(z)] += 1.0;
    }
    let n = observations.len() as f64;
    let (mut cells, mut statistic) = (0, 0.0);
    let (mut observed, mut expected, mut before) = (0.0, 0.0, 0.0);
    let mut rest = n;
    for (b, count) in counts.iter().enumerate() {
        let last = b + 1 == grid.bins;
        let upper = if last { 1.0 } else { normal.cdf(grid.lo + (b + 1) as f64 * grid.width) };
        observed += count;
        expected += n * (upper - before);
        before = upper;
        // The last cell takes what would be too little for one of its own.
        if last || (expected >= LEAST_EXPECTED && rest - expected >= LEAST_EXPECTED) {
            statistic += (observed - expected).powi(2) / expected.max(1e-9);
            cells += 1;
            rest -= expected;
            (observed, expected) = (0.0, 0.0);
        }
    }
    if cells < 3 {
        return false;
    }
    ChiSquared::new(f64::from(cells - 1)).is_ok_and(|chi| 1.0 - chi.cdf(statistic) < LEVEL)
}

/// A family, by what it makes of observations.
type Fit = fn(&[f64], Grid) -> Result<Distribution, Error>;

/// The families under comparison, the kernel density last.
const FAMILIES: [(&str, Fit); 4] = [
    ("gaussian", fit_gaussian),
    ("laplace", fit_laplace),
    ("two_gaussians", fit_two_gaussians),
    ("kernel_density", fit_kernel_density),
];

fn fit_gaussian(observations: &[f64], grid: Grid) -> Result<Distribution, Error> {
    let (mean, sigma) = gaussian_parameters(observations);
    mixture(&[(1.0, mean, sigma.unwrap_or(0.0))], grid)
}

/// Median and mean distance from it, the maximum likelihood estimates.
fn fit_laplace(observations: &[f64], grid: Grid) -> Result<Distribution, Error> {
    let mut sorted = observations.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = crate::statistics::quantile(&sorted, 0.5);
    let scale = sorted.iter().map(|z| (z - median).abs()).sum::<f64>() / sorted.len() as f64;
    let scale = scale.max(least_sigma(grid));
    on_grid(grid, |z| {
        let tail = 0.5 * (-(z - median).abs() / scale).exp();
        if z < median { tail } else { 1.0 - tail }
    })
}

/// By expectation maximization from the two halves of the sorted observations.
fn fit_two_gaussians(observations: &[f64], grid: Grid) -> Result<Distribution, Error> {
    let mut sorted = observations.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (low, high) = sorted.split_at(sorted.len() / 2);
    let start = |part: &[f64]| {
        let (mean, sigma) = gaussian_parameters(part);
        (0.5, mean, sigma.unwrap_or(0.0).max(least_sigma(grid)))
    };
    let mut parts = [start(low), start(high)];
    let n = sorted.len() as f64;
    // Moments about the middle, or squares of metres would swallow millimetres.
    let middle = high[0];
    for _ in 0..STEPS {
        let mut sums = [[0.0; 3]; 2];
        for &z in &sorted {
            let densities = parts.map(|(weight, mean, sigma): (f64, f64, f64)| {
                weight * (-0.5 * ((z - mean) / sigma).powi(2)).exp() / sigma
            });
            let total: f64 = densities.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            for (sums, density) in sums.iter_mut().zip(densities) {
                let share = density / total;
                *sums = [sums[0] + share, sums[1] + share * (z - middle), sums[2] + share * (z - middle).powi(2)];
            }
        }
        parts = sums.map(|[weight, first, second]| {
            let weight = weight.max(1e-9);
            let mean = first / weight;
            let variance = (second / weight - mean * mean).max(0.0);
            (weight / n, middle + mean, variance.sqrt().max(least_sigma(grid)))
        });
    }
    mixture(&parts, grid)
}

/// A Gaussian kernel with the bandwidth of the smallest log loss in two-fold cross-validation.
fn fit_kernel_density(observations: &[f64], grid: Grid) -> Result<Distribution, Error> {
    let half = |parity: usize| -> Vec<f64> { observations.iter().skip(parity).step_by(2).copied().collect() };
    let halves = [half(0), half(1)];
    let mut best = (f64::INFINITY, BANDWIDTHS[0]);
    for bandwidth in BANDWIDTHS {
        let mut loss = 0.0;
        for (train, test) in [(0, 1), (1, 0)] {
            let density = kernel_density(&halves[train], grid, None, Kernel::Gaussian, bandwidth * grid.width)?;
            loss += log_loss(&density.with_floor(FLOOR)?, &halves[test]);
        }
        if loss < best.0 {
            best = (loss, bandwidth);
        }
    }
    kernel_density(observations, grid, None, Kernel::Gaussian, best.1 * grid.width)
}

fn least_sigma(grid: Grid) -> f64 {
    grid.width / 12f64.sqrt()
}

/// Gaussians of (weight, mean, deviation) on the bins.
fn mixture(parts: &[(f64, f64, f64)], grid: Grid) -> Result<Distribution, Error> {
    let normals: Vec<(f64, Normal)> = parts
        .iter()
        .filter_map(|&(weight, mean, sigma)| Some((weight, Normal::new(mean, sigma.max(least_sigma(grid))).ok()?)))
        .collect();
    on_grid(grid, |z| normals.iter().map(|(weight, normal)| weight * normal.cdf(z)).sum())
}

fn on_grid(grid: Grid, cdf: impl Fn(f64) -> f64) -> Result<Distribution, Error> {
    let mut before = 0.0;
    let mass = (0..grid.bins)
        .map(|b| {
            let after = if b + 1 == grid.bins { 1.0 } else { cdf(grid.lo + (b + 1) as f64 * grid.width) };
            let mass = (after - before).max(0.0);
            before = after;
            mass
        })
        .collect();
    Distribution::new(grid, mass, None)
}

/// Fits each family to every other reading of each ray, and asks which predicts the others best.
pub(super) fn compare(study: &Study) -> Result<Families, StudyError> {
    let grid = study.setup.grid;
    let losses: Vec<[f64; FAMILIES.len()]> = study
        .setup
        .rays
        .par_iter()
        .map(|ray| {
            let part = |parity: usize| -> Vec<f64> { ray.readings.iter().skip(parity).step_by(2).copied().collect() };
            let (train, test) = (part(0), part(1));
            let mut losses = [0.0; FAMILIES.len()];
            for (loss, (_, fit)) in losses.iter_mut().zip(FAMILIES) {
                *loss = log_loss(&fit(&train, grid)?.with_floor(FLOOR)?, &test);
            }
            Ok(losses)
        })
        .collect::<Result<_, Error>>()?;
    let not_gaussian: Vec<bool> = study.setup.rays.par_iter().map(|r| is_not_gaussian(&r.readings, &grid)).collect();
    let best = |among: usize| -> Vec<usize> {
        losses
            .iter()
            .filter_map(|of_ray| (0..among).min_by(|&a, &b| of_ray[a].total_cmp(&of_ray[b])))
            .collect()
    };
    let kernel = FAMILIES.len() - 1;
    let (best_of_all, best_parametric) = (best(FAMILIES.len()), best(kernel));
    let gains: Vec<f64> =
        losses.iter().zip(&not_gaussian).filter(|(_, not)| **not).map(|(l, _)| l[0] - l[kernel]).collect();
    let mean = |copies: &[u32]| {
        let total: u32 = copies.iter().sum();
        [gains.iter().zip(copies).map(|(gain, &n)| gain * f64::from(n)).sum::<f64>() / f64::from(total)]
    };
    let interval = Bootstrap::new(study.seed, gains.len()).and_then(|b| b.intervals(mean)).map(|[i]| i);
    Ok(Families {
        rays: losses.len(),
        not_gaussian: gains.len(),
        families: FAMILIES
            .iter()
            .enumerate()
            .map(|(f, (family, _))| Family {
                family,
                log_loss: losses.iter().map(|l| l[f]).sum::<f64>() / losses.len() as f64,
                best: best_of_all.iter().filter(|b| **b == f).count(),
                best_parametric: (f < kernel).then(|| best_parametric.iter().filter(|b| **b == f).count()),
            })
            .collect(),
        kernel_density_gain: gains.iter().sum::<f64>() / gains.len() as f64,
        kernel_density_gain_interval: interval,
    })
}

/// Some rays with the families fitted to them, for a figure; empty for other studies.
pub(super) fn shown(study: &Study) -> Result<Samples, StudyError> {
    let rays = &study.setup.rays;
    let shown = SHOWN.min(rays.len());
    let states = (0..shown)
        .map(|k| {
            let ray: &RaySummary = &rays[(2 * k + 1) * rays.len() / (2 * shown)];
            let predicted = FAMILIES
                .iter()
                .map(|(_, fit)| fit(&ray.readings, study.setup.grid))
                .collect::<Result<_, Error>>()?;
            Ok(Sample { state: vec![ray.ray as f64], truth: study.histogram(&ray.readings)?, predicted })
        })
        .collect::<Result<_, StudyError>>()?;
    Ok(Samples { states, training_states: 0 })
}

/// Names of the families in the order of [`shown`]'s predictions.
pub(super) fn names() -> Vec<String> {
    FAMILIES.iter().map(|(name, _)| (*name).to_owned()).collect()
}
