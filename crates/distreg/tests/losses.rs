//! Losses against closed forms, and the paper's statements about them.

use distreg::{Distribution, Error, Grid, Loss, Outcomes, PointMass, crps, euclidean, histogram};
use distreg::{empirical_wasserstein_1, histogram_match, log_loss, risk, wasserstein_1};
use proptest::prelude::*;
use rand_distr::{Distribution as _, StandardNormal};
use rand_philox::Philox;
use statrs::distribution::{ContinuousCDF, Normal};

const GRID: Grid = Grid { lo: 0.0, width: 0.5, bins: 20 };

fn peak(grid: Grid, bin: usize) -> Distribution {
    let mut mass = vec![0.0; grid.bins];
    mass[bin] = 1.0;
    Distribution::new(grid, mass, None).unwrap()
}

/// Fig. 5: a narrow peak one bin off is a far better prediction of a narrow peak than a flat density, but the
/// Euclidean distance says the opposite, as it knows no neighbourhood of bins.
#[test]
fn euclidean_distance_ranks_wrongly_where_the_histogram_match_ranks_rightly() {
    let truth = peak(GRID, 10);
    let close = peak(GRID, 11);
    let flat = Distribution::new(GRID, vec![1.0; GRID.bins], None).unwrap();
    let euclid = |d| euclidean(&truth, d).unwrap();
    let matched = |d| histogram_match(&truth, d).unwrap();
    assert!(euclid(&flat) < euclid(&close));
    assert!(matched(&close) < matched(&flat));
    // sqrt(2), and sqrt((1 - 1/20)^2 + 19 / 20^2).
    assert!((euclid(&close) - 2f64.sqrt()).abs() < 1e-15);
    assert!((euclid(&flat) - (0.95f64.powi(2) + 19.0 / 400.0).sqrt()).abs() < 1e-15);
    // One bin; and (1 + .. + 10) / 20 below the peak with (1 + .. + 9) / 20 above it.
    assert!((matched(&close) - 1.0).abs() < 1e-15);
    assert!((matched(&flat) - (55.0 + 45.0) / 20.0).abs() < 1e-12);
    assert!((wasserstein_1(&truth, &close).unwrap() - 0.5).abs() < 1e-15);
}

#[test]
fn a_point_mass_counts_in_its_bin_and_other_grids_are_refused() {
    let point = Distribution::new(GRID, vec![0.0; 20], Some(PointMass { at: 9.9, mass: 1.0 })).unwrap();
    assert!((histogram_match(&point, &peak(GRID, 12)).unwrap() - 7.0).abs() < 1e-12);
    assert!(histogram_match(&point, &peak(GRID, 19)).unwrap() < 1e-12);
    let other = Grid { lo: 0.1, ..GRID };
    assert_eq!(histogram_match(&point, &peak(other, 0)), Err(Error::GridMismatch));
}

/// With M draws the cumulative sum at z has mean F(z) and variance F (1 - F) / M, so its mean absolute error is
/// near sqrt(2 / pi) sqrt(F (1 - F) / M). Summed over bins of width w, for a Gaussian, this is
/// E[loss] = 1.288 sigma / (w sqrt(M)), as the integral of sqrt(Phi (1 - Phi)) is 1.6147.
///
/// The mean of 4000 losses is within 4.9 standard errors with a false-alarm probability of 1e-6; 1 % is allowed
/// for binomial instead of Gaussian cumulative sums (largest in the tails).
#[test]
fn expected_loss_of_a_gaussian_histogram() {
    let grid = Grid::of_values(0.0, 80.0, 1.0).unwrap();
    let (mu, sigma) = (40.3, 3.25);
    let normal = Normal::new(mu, sigma).unwrap();
    let edge = |b: usize| normal.cdf(grid.lo + b as f64 * grid.width);
    let truth =
        Distribution::new(grid, (0..grid.bins).map(|b| edge(b + 1) - edge(b)).collect(), None).unwrap();
    let trials = 4000;
    let mean_loss = |draws: usize| {
        let losses: Vec<f64> = (0..trials)
            .map(|trial| {
                let mut random = Philox::from_u64_seed_stream(1, trial);
                let z: Vec<f64> = (0..draws)
                    .map(|_| {
                        let e: f64 = StandardNormal.sample(&mut random);
                        mu + sigma * e
                    })
                    .collect();
                histogram_match(&histogram(&z, &Outcomes { grid, point_mass_at: None }).unwrap(), &truth)
                    .unwrap()
            })
            .collect();
        let mean = losses.iter().sum::<f64>() / trials as f64;
        let variance = losses.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / (trials - 1) as f64;
        (mean, (variance / trials as f64).sqrt())
    };
    let expected = |draws: usize| 1.288 * sigma / (grid.width * (draws as f64).sqrt());
    for draws in [70, 300] {
        let (mean, error) = mean_loss(draws);
        let tolerance = 4.9 * error + 0.01 * expected(draws);
        assert!((mean - expected(draws)).abs() < tolerance, "{draws} draws: {mean} +- {error}");
        // Negative control: the law for 20 % more draws is refused.
        assert!((mean - expected(draws * 6 / 5)).abs() > tolerance);
    }
    // The paper's M = 70 for a loss of 0.5 belongs to a deviation of about 3.25 bins.
    assert!((expected(70) - 0.5).abs() < 0.001);
}

/// For a uniform density on [0, 1], CRPS(z) = z^2 - z + 1/3 inside and 1/3 more per unit outside; for a point,
/// it's the distance.
#[test]
fn crps_has_its_closed_forms() {
    let uniform = Distribution::new(Grid { lo: 0.0, width: 1.0, bins: 1 }, vec![1.0], None).unwrap();
    for z in [0.0, 0.2, 0.5, 1.0] {
        assert!((crps(&uniform, &[z]) - (z * z - z + 1.0 / 3.0)).abs() < 1e-12);
    }
    assert!((crps(&uniform, &[-2.0]) - (2.0 + 1.0 / 3.0)).abs() < 1e-12);
    assert!((crps(&uniform, &[3.0]) - (2.0 + 1.0 / 3.0)).abs() < 1e-12);
    let point = Distribution::new(GRID, vec![0.0; 20], Some(PointMass { at: 4.2, mass: 1.0 })).unwrap();
    for z in [-1.0, 4.2, 6.0, 12.0] {
        assert!((crps(&point, &[z]) - (z - 4.2f64).abs()).abs() < 1e-12);
    }
}

proptest! {
    /// CRPS by its other definition, E|Z - z| - E|Z - Z'| / 2, over midpoint quantiles; the sums are within one
    /// step of 1 / 1000 of the support's width of 10 each.
    #[test]
    fn crps_agrees_with_expected_distances(
        mass in prop::collection::vec(0.0..1.0f64, 20),
        point in 0.0..3.0f64,
        z in -2.0..12.0f64,
    ) {
        prop_assume!(mass.iter().sum::<f64>() > 0.1);
        let d = Distribution::new(GRID, mass, Some(PointMass { at: 7.0, mass: point })).unwrap();
        let n = 1000;
        let draws: Vec<f64> = (0..n).map(|k| d.quantile((f64::from(k) + 0.5) / f64::from(n))).collect();
        let to_z = draws.iter().map(|q| (q - z).abs()).sum::<f64>() / f64::from(n);
        // For sorted draws the mean distance of pairs is a weighted sum.
        let pairs = draws
            .iter()
            .enumerate()
            .map(|(k, q)| q * (2.0 * k as f64 + 1.0 - f64::from(n)))
            .sum::<f64>()
            * 2.0
            / f64::from(n * n);
        prop_assert!((crps(&d, &[z]) - (to_z - 0.5 * pairs)).abs() < 0.02);
    }
}

#[test]
fn log_loss_is_a_density_per_unit_and_a_probability_at_the_point() {
    let mut mass = vec![0.0; 20];
    mass[4] = 0.6;
    let d = Distribution::new(GRID, mass, Some(PointMass { at: 10.0, mass: 0.4 })).unwrap();
    let loss = log_loss(&d, &[2.1, 10.0]);
    assert!((loss + 0.5 * ((0.6f64 / 0.5).ln() + 0.4f64.ln())).abs() < 1e-12);
    assert_eq!(log_loss(&d, &[3.0]), f64::INFINITY);
    let floored = d.with_floor(0.21).unwrap();
    assert!((log_loss(&floored, &[3.0]) + (0.21f64 / 21.0 / 0.5).ln()).abs() < 1e-12);
    assert!(matches!(d.with_floor(1.5), Err(Error::NotAShare { .. })));
}

/// The 95 % interval over 40 exponential losses. Percentile intervals of skewed means cover a little less than
/// they say (about 92.5 % here); 600 trials have a standard error of 0.011, so 0.87 to 0.98 has a
/// false-alarm probability below 1e-6.
#[test]
fn bootstrap_interval_covers_the_true_risk() {
    let trials = 600;
    let covered = (0..trials)
        .filter(|&trial| {
            let mut random = Philox::from_u64_seed_stream(5, trial);
            let losses: Vec<f64> = (0..40).map(|_| rand_distr::Exp1.sample(&mut random)).collect();
            let risk = risk(&losses, trial).unwrap();
            assert!(risk.lo <= risk.mean && risk.mean <= risk.hi);
            risk.lo <= 1.0 && 1.0 <= risk.hi
        })
        .count();
    let share = covered as f64 / trials as f64;
    assert!((0.87..0.98).contains(&share), "coverage {share}");
    assert!(risk(&[], 1).is_err());
    assert!(risk(&[1.0, f64::NAN], 1).is_err());
}

/// Each selectable loss is its function of the observations' histogram or of the observations.
#[test]
fn a_loss_is_what_it_names() {
    let predicted = Distribution::new(GRID, vec![1.0; 20], Some(PointMass { at: 9.9, mass: 0.5 })).unwrap();
    let z = [1.2, 1.4, 7.0, 9.9];
    let observed = histogram(&z, &Outcomes { grid: GRID, point_mass_at: Some(9.9) }).unwrap();
    let floored = predicted.with_floor(0.1).unwrap();
    let mean_crps = z.iter().map(|&z| crps(&predicted, &[z])).sum::<f64>() / 4.0;
    for (loss, expected) in [
        (Loss::HistogramMatch, histogram_match(&predicted, &observed).unwrap()),
        (Loss::Wasserstein1, wasserstein_1(&predicted, &observed).unwrap()),
        (Loss::Euclidean, euclidean(&predicted, &observed).unwrap()),
        (Loss::LogLoss { floor: 0.1 }, log_loss(&floored, &z)),
        (Loss::Crps, mean_crps),
    ] {
        assert!((loss.of(&predicted, &z).unwrap() - expected).abs() < 1e-12, "{loss:?}");
    }
    assert!(Loss::Crps.of(&predicted, &[]).is_err());
}

/// Between a sample and itself moved by d it is d; two unequal samples by hand.
#[test]
fn the_distance_of_a_moved_sample_is_how_far_it_moved() {
    let sample: Vec<f64> = (0..37).map(|i| f64::from(i * i % 11)).collect();
    let moved: Vec<f64> = sample.iter().map(|v| v + 0.25).collect();
    assert!((empirical_wasserstein_1(sample.clone(), moved) - 0.25).abs() < 1e-12);
    assert!(empirical_wasserstein_1(sample.clone(), sample).abs() < 1e-12);
    // Quantiles agree up to 1/2; from there to 2/3 they are 1 apart, then 2.
    let distance = empirical_wasserstein_1(vec![0.0, 1.0], vec![0.0, 0.0, 3.0]);
    assert!((distance - 5.0 / 6.0).abs() < 1e-12, "{distance}");
}
