//! P-REG and its regressor.

use distreg::{
    Alignment, ConditionalDistribution, Dataset, Degree, Error, Family, Kernel, LocalRegression, Outcomes,
    PReg, PRegOptions, Regressor, Second, Support, Weighting, gaussian_parameters,
};
use proptest::prelude::*;
use rand_distr::{Distribution as _, StandardNormal};
use rand_philox::{Philox, u32_to_unit_f64};

/// States uniform in the unit cube.
fn cube(n: usize, dim: usize, seed: u64) -> Vec<f64> {
    let mut random = Philox::from_u64_seed(seed);
    (0..n * dim).map(|_| u32_to_unit_f64(random.next_u32())).collect()
}

fn planes(
    states: &[f64],
    targets: &[f64],
    kernel: Kernel,
    bandwidths: &[f64],
) -> Result<LocalRegression, Error> {
    LocalRegression::fit(states, targets, &Weighting::kernel(kernel, bandwidths), Degree::Linear)
}

fn options(outcomes: Outcomes, family: Family, bandwidths: &[f64]) -> PRegOptions {
    PRegOptions {
        outcomes,
        alignment: Alignment::Identity,
        family,
        weighting: Weighting::kernel(Kernel::Boxcar, bandwidths),
        degree: Degree::Linear,
        smallest_sigma: 1e-3,
        least_observations: 20,
    }
}

/// A plane is reproduced at every query within the data, but for the ridge.
#[test]
fn planes_are_reproduced() {
    let states = cube(300, 3, 1);
    let plane = |x: &[f64]| [1.0 + 2.0 * x[0] - x[1] + 0.5 * x[2], -3.0 * x[2]];
    let targets: Vec<f64> = states.chunks(3).flat_map(plane).collect();
    for kernel in [Kernel::Gaussian, Kernel::Boxcar, Kernel::Epanechnikov] {
        let fit = planes(&states, &targets, kernel, &[0.4; 3]).unwrap();
        assert_eq!(fit.target_dim(), 2);
        for query in cube(50, 3, 2).chunks(3) {
            let mut out = [0.0; 2];
            assert_eq!(fit.predict(query, &mut out).unwrap(), Support::InData);
            for (o, t) in out.iter().zip(plane(query)) {
                assert!((o - t).abs() < 1e-4, "{kernel:?}: {o} {t}");
            }
        }
    }
}

proptest! {
    /// In one dimension local linear regression has a closed form (Fan and Gijbels 1996, eq. 2.4):
    /// sum w (s2 - s1 u) t / sum w (s2 - s1 u), with u = x_i - x and s_k = sum w u^k.
    #[test]
    fn one_dimension_agrees_with_the_closed_form(
        seed in 0..1000u64,
        query in 0.05..0.95f64,
        bandwidth in 0.1..1.0f64,
    ) {
        let states = cube(40, 1, seed);
        let targets = cube(40, 1, seed + 5000);
        let fit = planes(&states, &targets, Kernel::Gaussian, &[bandwidth]).unwrap();
        let mut out = [0.0];
        fit.predict(&[query], &mut out).unwrap();
        let w: Vec<f64> = states.iter().map(|x| (-0.5 * ((x - query) / bandwidth).powi(2)).exp()).collect();
        let s = |k| states.iter().zip(&w).map(|(x, w)| w * (x - query).powi(k)).sum::<f64>();
        let (s1, s2) = (s(1), s(2));
        let effective = |i: usize| w[i] * (s2 - s1 * (states[i] - query));
        let direct = (0..40).map(|i| effective(i) * targets[i]).sum::<f64>()
            / (0..40).map(effective).sum::<f64>();
        prop_assert!((out[0] - direct).abs() < 1e-3, "{} {direct}", out[0]);
    }
}

#[test]
fn degenerate_designs_fall_back_to_the_mean() {
    let predict = |states: &[f64], targets: &[f64], query: &[f64]| {
        let fit = planes(states, targets, Kernel::Gaussian, &[1.0, 1.0]).unwrap();
        let mut out = [f64::NAN];
        let support = fit.predict(query, &mut out).unwrap();
        (out[0], support)
    };
    // One state; the same state three times.
    assert_eq!(predict(&[0.0, 0.0], &[5.0], &[0.5, 0.5]), (5.0, Support::InData));
    let (mean, _) = predict(&[0.0; 6], &[1.0, 2.0, 6.0], &[0.5, 0.5]);
    assert!((mean - 3.0).abs() < 1e-9);
    // States on a line: no slope across it, the right slope along it.
    let line = [0.0, 0.0, 1.0, 1.0, 2.0, 2.0];
    let (on, _) = predict(&line, &[0.0, 2.0, 4.0], &[1.5, 1.5]);
    let (off, _) = predict(&line, &[0.0, 2.0, 4.0], &[1.7, 1.3]);
    assert!((on - 3.0).abs() < 1e-4 && (off - 3.0).abs() < 1e-4, "{on} {off}");
    // Far outside, the mean of the nearest states and no extrapolation.
    let (far, support) = predict(&line, &[0.0, 2.0, 4.0], &[500.0, 500.0]);
    assert!((far - 2.0).abs() < 1e-12);
    assert_eq!(support, Support::Nearest);
}

/// Eq. 4 with the square root that is missing in print.
#[test]
fn sigma_is_the_root_of_the_variance() {
    let (mean, sigma) = gaussian_parameters(&[1.0, 3.0, 5.0]);
    assert_eq!((mean, sigma), (3.0, Some(2.0)));
    assert_eq!(gaussian_parameters(&[1.5]), (1.5, None));
}

/// z ~ N(2 x, (0.05 + 0.1 x)^2) with 10,000 draws, 100 or 1 per state, of which 2,000 are within the boxcar around
/// a query. The standard error of the mean is sigma / 45, that of the deviation less (0.76 sigma / 45 for absolute
/// residuals): 4.9 of them are 11 % of sigma. 1 % is for the residuals' own share in the regressed mean.
#[test]
fn repeated_and_single_observations_give_the_gaussian() {
    for (states, draws) in [(100, 100), (10_000, 1)] {
        let mut random = Philox::from_u64_seed(3);
        let mut data = Dataset::new(1);
        for x in cube(states, 1, 4) {
            let z: Vec<f64> = (0..draws)
                .map(|_| {
                    let e: f64 = StandardNormal.sample(&mut random);
                    2.0 * x + (0.05 + 0.1 * x) * e
                })
                .collect();
            data.push(&[x], &z).unwrap();
        }
        let outcomes = Outcomes::of_values(-1.0, 4.0, 0.01).unwrap();
        let model = options(outcomes, Family::Gaussian, &[0.1]).fit(&data).unwrap();
        for x in [0.2, 0.5, 0.8] {
            let (found, support) = model.parameters(&[x]).unwrap();
            let truth = 0.05 + 0.1 * x;
            assert!((found.mean - 2.0 * x).abs() < 0.12 * truth, "{draws} draws: {found:?} at {x}");
            assert!((found.sigma - truth).abs() < 0.12 * truth, "{draws} draws: {found:?} at {x}");
            assert_eq!(support, Support::InData);
        }
        let (d, _) = model.predict(&[0.5]).unwrap();
        assert!((d.mass().iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!((d.mean() - model.parameters(&[0.5]).unwrap().0.mean).abs() < 1e-6);
        let mut file = Vec::new();
        ciborium::into_writer(&model, &mut file).unwrap();
        assert_eq!(ciborium::from_reader::<PReg, _>(&file[..]).unwrap(), model);
    }
}

#[test]
fn impossible_input_is_an_error() {
    let fit = |states: &[f64], targets: &[f64], bandwidths: &[f64]| {
        planes(states, targets, Kernel::Gaussian, bandwidths)
    };
    assert!(matches!(fit(&[], &[], &[1.0, 1.0]), Err(Error::Empty { .. })));
    assert!(matches!(fit(&[0.0; 4], &[], &[1.0, 1.0]), Err(Error::Empty { .. })));
    assert!(matches!(fit(&[0.0; 3], &[1.0], &[1.0, 1.0]), Err(Error::Dimension { .. })));
    assert!(matches!(fit(&[0.0; 4], &[1.0; 3], &[1.0, 1.0]), Err(Error::Length { .. })));
    assert!(matches!(fit(&[0.0; 4], &[1.0; 2], &[]), Err(Error::Empty { .. })));
    assert!(matches!(fit(&[0.0; 4], &[f64::NAN; 2], &[1.0, 1.0]), Err(Error::NotFinite { .. })));
    let good = fit(&[0.0; 4], &[1.0; 2], &[1.0, 1.0]).unwrap();
    assert!(matches!(good.predict(&[0.0, 0.0], &mut [0.0; 2]), Err(Error::Length { .. })));
    assert!(matches!(good.predict(&[0.0], &mut [0.0]), Err(Error::Dimension { .. })));
    let mut data = Dataset::new(1);
    data.push(&[0.0], &[1.0, 2.0]).unwrap();
    let outcomes = Outcomes::of_values(0.0, 4.0, 0.01).unwrap();
    let good = options(outcomes, Family::Gaussian, &[1.0]);
    let no_sigma = PRegOptions { smallest_sigma: 0.0, ..good.clone() };
    assert!(matches!(no_sigma.fit(&data), Err(Error::NotPositive { .. })));
    assert!(good.fit(&Dataset::new(1)).is_err());
    let only_points = PRegOptions { outcomes: outcomes.with_point_mass(3.0), ..good };
    data = Dataset::new(1);
    data.push(&[0.0], &[3.0, 3.0]).unwrap();
    assert!(matches!(only_points.fit(&data), Err(Error::Empty { .. })));
}

/// Draws of a mixture whose parameters are linear in the state (the share quadratic in its random labels only); each
/// state has 400, so that the regressed parameters of about 40 states have 1.3 % of the error of one draw's.
fn mixture(second: impl Fn(f64, &mut Philox) -> f64) -> Dataset {
    let mut random = Philox::from_u64_seed(8);
    let mut data = Dataset::new(1);
    for x in cube(200, 1, 9) {
        let z: Vec<f64> = (0..400)
            .map(|_| {
                let e: f64 = StandardNormal.sample(&mut random);
                let first = u32_to_unit_f64(random.next_u32()) > 0.2 + 0.2 * x;
                if first { 5.0 + x + 0.05 * e } else { second(x, &mut random) }
            })
            .collect();
        data.push(&[x], &z).unwrap();
    }
    data
}

/// At a query about 40 states with 400 draws count: the share's standard error is 0.004, the means' below 0.002, the
/// relative one of a deviation below 0.01, of an exponential's scale 0.015. The limits are above 5 of them, and 0.01
/// for a cut of the exponential by the Gaussian.
#[test]
fn mixtures_find_their_parameters() {
    let outcomes = Outcomes::of_values(0.0, 10.0, 0.01).unwrap();
    let data = mixture(|x, random| {
        let e: f64 = StandardNormal.sample(random);
        7.0 - x + 0.2 * e
    });
    let model = options(outcomes, Family::TwoGaussians, &[0.1]).fit(&data).unwrap();
    for x in [0.2, 0.5, 0.8] {
        let found = model.parameters(&[x]).unwrap().0;
        let Some((share, Second::Gaussian { mean, sigma })) = found.second else { panic!("{found:?}") };
        assert!((found.mean - 5.0 - x).abs() < 0.005 && (found.sigma / 0.05 - 1.0).abs() < 0.05, "{found:?}");
        assert!((mean - 7.0 + x).abs() < 0.02 && (sigma / 0.2 - 1.0).abs() < 0.05, "{found:?}");
        assert!((share - 0.2 - 0.2 * x).abs() < 0.02, "{found:?}");
    }
    let data = mixture(|_, random| {
        let e: f64 = rand_distr::Exp1.sample(random);
        1.5 * e
    });
    let model = options(outcomes, Family::GaussianExponential, &[0.1]).fit(&data).unwrap();
    for x in [0.2, 0.5, 0.8] {
        let found = model.parameters(&[x]).unwrap().0;
        let Some((share, Second::Exponential { scale })) = found.second else { panic!("{found:?}") };
        assert!((found.mean - 5.0 - x).abs() < 0.005 && (found.sigma / 0.05 - 1.0).abs() < 0.05, "{found:?}");
        assert!((scale / 1.5 - 1.0).abs() < 0.1 && (share - 0.2 - 0.2 * x).abs() < 0.03, "{found:?}");
        let (d, _) = model.predict(&[x]).unwrap();
        let cdf = share * (1.0 - (-2.0f64 / scale).exp());
        assert!((d.cdf(1.995) - cdf).abs() < 1e-3);
    }
}
