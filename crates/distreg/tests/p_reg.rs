//! P-REG and its regressor.

use distreg::{Dataset, Error, Grid, Kernel, LocallyWeightedLinear, PReg, Support, gaussian_parameters};
use proptest::prelude::*;
use rand_distr::{Distribution as _, StandardNormal};
use rand_philox::{Philox, u32_to_unit_f64};

/// States uniform in the unit cube.
fn cube(n: usize, dim: usize, seed: u64) -> Vec<f64> {
    let mut random = Philox::from_u64_seed(seed);
    (0..n * dim).map(|_| u32_to_unit_f64(random.next_u32())).collect()
}

/// A plane is reproduced at every query within the data, but for the ridge.
#[test]
fn planes_are_reproduced() {
    let states = cube(300, 3, 1);
    let plane = |x: &[f64]| [1.0 + 2.0 * x[0] - x[1] + 0.5 * x[2], -3.0 * x[2]];
    let targets: Vec<f64> = states.chunks(3).flat_map(plane).collect();
    for kernel in [Kernel::Gaussian, Kernel::Boxcar, Kernel::Epanechnikov] {
        let fit = LocallyWeightedLinear::fit(3, &states, &targets, kernel, &[0.4; 3]).unwrap();
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
        let fit = LocallyWeightedLinear::fit(1, &states, &targets, Kernel::Gaussian, &[bandwidth]).unwrap();
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
        let fit = LocallyWeightedLinear::fit(2, states, targets, Kernel::Gaussian, &[1.0, 1.0]).unwrap();
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
        let model = PReg::fit(&data, Kernel::Boxcar, &[0.1], 1e-3).unwrap();
        for x in [0.2, 0.5, 0.8] {
            let (mean, sigma, support) = model.parameters(&[x]).unwrap();
            let truth = 0.05 + 0.1 * x;
            assert!((mean - 2.0 * x).abs() < 0.12 * truth, "{draws} draws: mean {mean} at {x}");
            assert!((sigma - truth).abs() < 0.12 * truth, "{draws} draws: sigma {sigma} at {x}");
            assert_eq!(support, Support::InData);
        }
        let grid = Grid::of_values(-1.0, 4.0, 0.01).unwrap();
        let (d, _) = model.predict(&[0.5], grid).unwrap();
        assert!((d.mass().iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!((d.mean() - model.parameters(&[0.5]).unwrap().0).abs() < 1e-6);
        let mut file = Vec::new();
        ciborium::into_writer(&model, &mut file).unwrap();
        assert_eq!(ciborium::from_reader::<PReg, _>(&file[..]).unwrap(), model);
    }
}

#[test]
fn impossible_input_is_an_error() {
    let fit = |states: &[f64], targets: &[f64], bandwidths: &[f64]| {
        LocallyWeightedLinear::fit(2, states, targets, Kernel::Gaussian, bandwidths)
    };
    assert!(matches!(fit(&[], &[], &[1.0, 1.0]), Err(Error::Empty { .. })));
    assert!(matches!(fit(&[0.0; 4], &[], &[1.0, 1.0]), Err(Error::Empty { .. })));
    assert!(matches!(fit(&[0.0; 3], &[1.0], &[1.0, 1.0]), Err(Error::Dimension { .. })));
    assert!(matches!(fit(&[0.0; 4], &[1.0; 3], &[1.0, 1.0]), Err(Error::Length { .. })));
    assert!(matches!(fit(&[0.0; 4], &[1.0; 2], &[1.0]), Err(Error::Length { .. })));
    assert!(matches!(fit(&[0.0; 4], &[f64::NAN; 2], &[1.0, 1.0]), Err(Error::NotFinite { .. })));
    let good = fit(&[0.0; 4], &[1.0; 2], &[1.0, 1.0]).unwrap();
    assert!(matches!(good.predict(&[0.0, 0.0], &mut [0.0; 2]), Err(Error::Length { .. })));
    assert!(matches!(good.predict(&[0.0], &mut [0.0]), Err(Error::Dimension { .. })));
    let mut data = Dataset::new(1);
    data.push(&[0.0], &[1.0, 2.0]).unwrap();
    assert!(matches!(PReg::fit(&data, Kernel::Gaussian, &[1.0], 0.0), Err(Error::NotPositive { .. })));
    assert!(PReg::fit(&Dataset::new(1), Kernel::Gaussian, &[1.0], 1.0).is_err());
}
