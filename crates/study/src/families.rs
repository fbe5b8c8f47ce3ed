//! Which family of distributions fits the rays of a static lidar, and whether a sample is Gaussian.

use distreg::{
    Alignment, ConditionalDistribution, Dataset, Degree, Distribution, Error, Family, Grid, Kernel, Outcomes,
    PRegOptions, Regressor, Weighting, gaussian_parameters, kernel_density, log_loss,
};
use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

use super::results::{Families, FamilyResults, Sample, Samples};
use super::sensor::RaySummary;
use super::{Study, StudyError};
use locsim_report::statistics::{Bootstrap, quantile};

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
type Fit = fn(&[f64], Outcomes) -> Result<Distribution, Error>;

/// The families under comparison, the Gaussian first and the kernel density last.
const FAMILIES: [(&str, Fit); 5] = [
    ("gaussian", |z, outcomes| fit(Family::Gaussian, z, outcomes)),
    ("laplace", fit_laplace),
    ("two_gaussians", |z, outcomes| fit(Family::TwoGaussians, z, outcomes)),
    ("gaussian_exponential", |z, outcomes| fit(Family::GaussianExponential, z, outcomes)),
    ("kernel_density", fit_kernel_density),
];

/// A family of P-REG at a single state.
fn fit(family: Family, observations: &[f64], outcomes: Outcomes) -> Result<Distribution, Error> {
    let mut data = Dataset::new(1);
    data.push(&[0.0], observations)?;
    let options = PRegOptions {
        outcomes,
        alignment: Alignment::Identity,
        family,
        weighting: Weighting::kernel(Kernel::Gaussian, &[1.0]),
        degree: Degree::Constant,
        smallest_sigma: least_sigma(&outcomes),
        least_observations: 1,
    };
    Ok(options.fit(&data)?.predict(&[0.0])?.0)
}

/// Median and mean distance from it, the maximum likelihood estimates.
fn fit_laplace(observations: &[f64], outcomes: Outcomes) -> Result<Distribution, Error> {
    let mut sorted = observations.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = quantile(&sorted, 0.5);
    let scale = sorted.iter().map(|z| (z - median).abs()).sum::<f64>() / sorted.len() as f64;
    let scale = scale.max(least_sigma(&outcomes));
    let cdf = |z: f64| {
        let tail = 0.5 * (-(z - median).abs() / scale).exp();
        if z < median { tail } else { 1.0 - tail }
    };
    let grid = outcomes.grid;
    let mut before = 0.0;
    let mass = (1..=grid.bins)
        .map(|b| {
            let after = if b == grid.bins { 1.0 } else { cdf(grid.lo + b as f64 * grid.width) };
            let mass = (after - before).max(0.0);
            before = after;
            mass
        })
        .collect();
    Distribution::new(grid, mass, None)
}

/// A Gaussian kernel with the bandwidth of the smallest log loss in two-fold cross-validation.
fn fit_kernel_density(observations: &[f64], outcomes: Outcomes) -> Result<Distribution, Error> {
    let half = |parity: usize| -> Vec<f64> { observations.iter().skip(parity).step_by(2).copied().collect() };
    let halves = [half(0), half(1)];
    let width = outcomes.grid.width;
    let mut best = (f64::INFINITY, BANDWIDTHS[0]);
    for bandwidth in BANDWIDTHS {
        let mut loss = 0.0;
        for (train, test) in [(0, 1), (1, 0)] {
            let density = kernel_density(&halves[train], &outcomes, Kernel::Gaussian, bandwidth * width)?;
            loss += log_loss(&density.with_floor(FLOOR)?, &halves[test]);
        }
        if loss < best.0 {
            best = (loss, bandwidth);
        }
    }
    kernel_density(observations, &outcomes, Kernel::Gaussian, best.1 * width)
}

/// The deviation of rounding to bins.
fn least_sigma(outcomes: &Outcomes) -> f64 {
    outcomes.grid.width / 12f64.sqrt()
}

/// Fits each family to every other reading of each ray, and asks which predicts the others best.
pub(super) fn compare(study: &Study) -> Result<Families, StudyError> {
    let outcomes = study.setup.outcomes;
    let losses: Vec<[f64; FAMILIES.len()]> = study
        .setup
        .rays
        .par_iter()
        .map(|ray| {
            let part = |parity: usize| -> Vec<f64> {
                ray.readings.iter().skip(parity).step_by(2).copied().collect()
            };
            let (train, test) = (part(0), part(1));
            let mut losses = [0.0; FAMILIES.len()];
            for (loss, (_, fit)) in losses.iter_mut().zip(FAMILIES) {
                *loss = log_loss(&fit(&train, outcomes)?.with_floor(FLOOR)?, &test);
            }
            Ok(losses)
        })
        .collect::<Result<_, Error>>()?;
    let not_gaussian: Vec<bool> =
        study.setup.rays.par_iter().map(|r| is_not_gaussian(&r.readings, &outcomes.grid)).collect();
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
            .map(|(f, (family, _))| FamilyResults {
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
                .map(|(_, fit)| fit(&ray.readings, study.setup.outcomes))
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

#[cfg(test)]
mod tests {
    use super::*;
    use locsim_core::{Draw, Stage};
    use rand::RngExt;
    use rand_distr::{Distribution as _, StandardNormal};

    /// Rounded Gaussians of a deviation of 1 to 10 bins, a quarter of the second kind moved by `apart` deviations.
    fn flagged(samples: u32, apart: f64) -> u32 {
        let grid = Grid::of_values(0.0, 4.5, 0.001).unwrap();
        let draw = Draw::new(3, Stage::Laser, 0);
        (0..samples)
            .map(|i| {
                let mut random = draw.item(i);
                let sigma = 0.001 * (1.0 + 9.0 * random.random::<f64>());
                let observations: Vec<f64> = (0..1000)
                    .map(|_| {
                        let normal: f64 = StandardNormal.sample(&mut random);
                        let moved = if random.random::<f64>() < 0.25 { apart } else { 0.0 };
                        ((2.0 + sigma * (normal + moved)) / 0.001).round() * 0.001
                    })
                    .collect();
                u32::from(is_not_gaussian(&observations, &grid))
            })
            .sum()
    }

    /// Of 400 Gaussians at most 1 % each are flagged: more than 17 with a probability below 1e-6. The control, a quarter
    /// of whose readings are three deviations off, must be found out nearly always.
    #[test]
    fn gaussians_pass_the_test_and_mixtures_dont() {
        let gaussians = flagged(400, 0.0);
        assert!(gaussians <= 17, "{gaussians} of 400");
        let mixtures = flagged(100, 3.0);
        assert!(mixtures > 90, "{mixtures} of 100");
    }

    #[test]
    fn each_family_fits_its_own_best() {
        let outcomes = Outcomes::of_values(0.0, 1.0, 0.001).unwrap();
        let draw = Draw::new(4, Stage::Laser, 0);
        let best = |sample: &dyn Fn(u32) -> f64| {
            let readings: Vec<f64> = (0..4000).map(sample).collect();
            let (train, test) = readings.split_at(2000);
            let loss = |(_, fit): &(&str, Fit)| {
                log_loss(&fit(train, outcomes).unwrap().with_floor(FLOOR).unwrap(), test)
            };
            let best = FAMILIES[..FAMILIES.len() - 1].iter().min_by(|a, b| loss(a).total_cmp(&loss(b)));
            best.unwrap().0
        };
        let normal = |i: u32| -> f64 { StandardNormal.sample(&mut draw.item(i)) };
        let uniform = |i: u32| -> f64 { draw.at(1).item(i).random() };
        assert_eq!(
            best(&|i| 0.5 + 0.02 * normal(i) + if uniform(i) < 0.3 { 0.2 } else { 0.0 }),
            "two_gaussians"
        );
        assert_eq!(
            best(&|i| 0.5
                + 0.02 * (1.0 - 2.0 * uniform(i)).signum() * -draw.at(2).item(i).random::<f64>().ln()),
            "laplace"
        );
        let short = |i: u32| (-0.2 * draw.at(3).item(i).random::<f64>().ln()).min(1.0);
        assert_eq!(
            best(&|i| if uniform(i) < 0.3 { short(i) } else { 0.8 + 0.02 * normal(i) }),
            "gaussian_exponential"
        );
    }
}
