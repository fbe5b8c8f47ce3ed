//! Promises of every method, and differences between them.

use distreg::{
    Alignment, Axis, ConditionalDistribution, Dataset, Degree, DensityEstimate, Distribution, Error, Family,
    FrechetOptions, Kernel, LocalRegression, Loss, NpRegOptions, Outcomes, PRegOptions, Predictions,
    Regressor, Selection, Smoother, StandardizedOptions, Support, Table, Weighting, condense, cross_validate,
    losses, risk, select, wasserstein_1,
};
use proptest::prelude::*;
use rand_distr::{Distribution as _, StandardNormal};
use rand_philox::{Philox, u32_to_unit_f64};

const MAXIMUM: f64 = 5.0;

fn outcomes() -> Outcomes {
    Outcomes::of_values(0.0, MAXIMUM, 0.02).unwrap().with_point_mass(MAXIMUM)
}

fn uniform(random: &mut Philox, lo: f64, hi: f64) -> f64 {
    lo + (hi - lo) * u32_to_unit_f64(random.next_u32())
}

/// z = x0 + noise whose deviation depends on x1, and 10 % of the observations at the maximum.
fn data(states: usize, draws: usize, seed: u64) -> Dataset {
    let mut random = Philox::from_u64_seed(seed);
    let mut data = Dataset::new(2);
    for _ in 0..states {
        let x = [uniform(&mut random, 0.5, 4.0), uniform(&mut random, 0.0, 1.0)];
        let z: Vec<f64> = (0..draws)
            .map(|_| {
                let e: f64 = StandardNormal.sample(&mut random);
                let lost = uniform(&mut random, 0.0, 1.0) < 0.1;
                if lost { MAXIMUM } else { x[0] + (0.02 + 0.04 * x[1]) * e }
            })
            .collect();
        data.push(&x, &z).unwrap();
    }
    data
}

type Model = Box<dyn ConditionalDistribution>;

/// Every method with the given settings, fitted.
fn fit_all(data: &Dataset, alignment: Alignment, weighting: &Weighting, degree: Degree) -> Vec<Model> {
    let weighting = || weighting.clone();
    let np_reg = |density| {
        NpRegOptions { outcomes: outcomes(), alignment, density, weighting: weighting(), degree }.fit(data)
    };
    let p_reg = |family| {
        let (smallest_sigma, least_observations) = (1e-3, 10);
        PRegOptions {
            outcomes: outcomes(),
            alignment,
            family,
            weighting: weighting(),
            degree,
            smallest_sigma,
            least_observations,
        }
        .fit(data)
    };
    let frechet =
        FrechetOptions { outcomes: outcomes(), alignment, quantiles: 50, weighting: weighting(), degree };
    let standardized = StandardizedOptions {
        location_scale: PRegOptions {
            outcomes: outcomes(),
            alignment,
            family: Family::Gaussian,
            weighting: weighting(),
            degree,
            smallest_sigma: 1e-3,
            least_observations: 10,
        },
        residual: NpRegOptions {
            outcomes: Outcomes::of_values(-4.0, 4.0, 0.1).unwrap().with_point_mass(9.0),
            alignment: Alignment::Identity,
            density: DensityEstimate::Histogram,
            weighting: weighting(),
            degree,
        },
    };
    vec![
        Box::new(standardized.fit(data).unwrap()),
        Box::new(np_reg(DensityEstimate::Histogram).unwrap()),
        Box::new(np_reg(DensityEstimate::Kernel { kernel: Kernel::Gaussian, bandwidth: 0.05 }).unwrap()),
        Box::new(p_reg(Family::Gaussian).unwrap()),
        Box::new(p_reg(Family::TwoGaussians).unwrap()),
        Box::new(p_reg(Family::GaussianExponential).unwrap()),
        Box::new(frechet.fit(data).unwrap()),
    ]
}

fn any_weighting() -> impl Strategy<Value = Weighting> {
    let kernel = prop::sample::select(vec![Kernel::Gaussian, Kernel::Boxcar, Kernel::Epanechnikov]);
    prop_oneof![
        (kernel, 0.01..2.0f64, 0.01..2.0f64).prop_map(|(kernel, a, b)| Weighting::kernel(kernel, &[a, b])),
        (1..40usize, 0.1..2.0f64).prop_map(|(count, b)| Weighting::nearest_neighbours(count, &[0.5, b])),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever the method and wherever the query, within the data or far from it: a distribution.
    #[test]
    fn every_prediction_is_a_distribution(
        seed in 0..1000u64,
        draws in prop_oneof![Just(1usize), Just(3), Just(25)],
        query in (0.01..8.0f64, -2.0..3.0f64),
        weighting in any_weighting(),
        degree in prop::sample::select(vec![Degree::Constant, Degree::Linear]),
        alignment in prop::sample::select(vec![
            Alignment::Identity,
            Alignment::Shift { state_dim: 0 },
            Alignment::Scale { state_dim: 0 },
        ]),
    ) {
        let data = data(30, draws, seed);
        for (k, model) in fit_all(&data, alignment, &weighting, degree).iter().enumerate() {
            for query in [[query.0, query.1], [400.0, -300.0], [data.state(0)[0], data.state(0)[1]]] {
                let (d, support) = model.predict(&query).unwrap();
                let total = d.mass().iter().sum::<f64>() + d.point().unwrap().mass;
                prop_assert!((total - 1.0).abs() < 1e-9, "method {k}: {total}");
                prop_assert!(d.mass().iter().all(|m| m.is_finite() && *m >= 0.0), "method {k}");
                prop_assert!(d.point().unwrap().mass >= 0.0 && d.mean().is_finite(), "method {k}");
                prop_assert!(d.quantile(0.5).is_finite() && d.density(1.0) >= 0.0, "method {k}");
                let far = query[0] == 400.0 && matches!(weighting, Weighting::Kernel { .. });
                prop_assert_eq!(support == Support::Nearest, far || support == Support::Nearest);
            }
        }
    }

    /// The k nearest states, against all distances sorted.
    #[test]
    fn nearest_neighbours_are_the_nearest(seed in 0..1000u64, count in 1..60usize, x in (-1.0..6.0f64, -1.0..2.0f64)) {
        let data = data(50, 1, seed);
        let scales = [0.5, 0.2];
        let smoother = Smoother::new(&data, &Weighting::nearest_neighbours(count, &scales)).unwrap();
        let mut weights = Vec::new();
        prop_assert_eq!(smoother.weights(&[x.0, x.1], &mut weights).unwrap(), Support::InData);
        let distance = |i: usize| ((data.state(i)[0] - x.0) / 0.5).hypot((data.state(i)[1] - x.1) / 0.2);
        let mut all: Vec<usize> = (0..50).collect();
        all.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        all.truncate(count);
        prop_assert_eq!(weights.iter().map(|w| w.0).collect::<Vec<_>>(), all);
        prop_assert!(weights.iter().all(|w| w.1 == 1.0 / count.min(50) as f64));
    }

    /// Balanced weights are the kernel's, times exp(t x) for one t, and the states' weighted mean is the query to the
    /// ridge: its offset is 0.01 t bandwidths.
    #[test]
    fn balanced_weights_centre_the_states(seed in 0..1000u64, x in (1.2..3.3f64, 0.25..0.75f64)) {
        let data = data(200, 1, seed);
        let h = [0.8, 0.3];
        let smoother = Smoother::new(&data, &Weighting::kernel(Kernel::Epanechnikov, &h)).unwrap();
        let query = [x.0, x.1];
        let (mut plain, mut balanced) = (Vec::new(), Vec::new());
        smoother.positive_weights(&query, Degree::Constant, &mut plain).unwrap();
        smoother.positive_weights(&query, Degree::Linear, &mut balanced).unwrap();
        prop_assert!((balanced.iter().map(|w| w.1).sum::<f64>() - 1.0).abs() < 1e-12);
        prop_assert!(balanced.iter().all(|w| w.1 > 0.0));
        let offset = |weights: &[(usize, f64)], d: usize| -> f64 {
            weights.iter().map(|&(i, w)| w * (data.state(i)[d] - query[d]) / h[d]).sum()
        };
        let tilt = [0, 1].map(|d| -offset(&balanced, d) / 0.01);
        prop_assume!(plain.len() > 8);
        // The ratio of weights is exp(t u) up to a constant factor.
        let logs: Vec<f64> = plain
            .iter()
            .zip(&balanced)
            .map(|(p, b)| {
                let u = |d: usize| (data.state(p.0)[d] - query[d]) / h[d];
                (b.1 / p.1).ln() - tilt[0] * u(0) - tilt[1] * u(1)
            })
            .collect();
        for log in &logs {
            prop_assert!((log - logs[0]).abs() < 1e-6, "{logs:?}");
        }
        for d in 0..2 {
            let (before, after) = (offset(&plain, d).abs(), offset(&balanced, d).abs());
            prop_assert!(after < 0.15 * before + 0.02, "{before} {after}");
        }
    }
}

/// Weights of a local plane give the plane's value; regressed densities and quantiles use the same ones.
#[test]
fn regression_weights_are_those_of_the_plane() {
    let data = data(80, 1, 3);
    let targets: Vec<f64> = data.states().chunks(2).map(|x| 3.0 - 2.0 * x[0] + x[1]).collect();
    for weighting in
        [Weighting::kernel(Kernel::Epanechnikov, &[1.0, 0.5]), Weighting::nearest_neighbours(15, &[1.0, 0.5])]
    {
        let smoother = Smoother::new(&data, &weighting).unwrap();
        let plane = LocalRegression::fit(data.states(), &targets, &weighting, Degree::Linear).unwrap();
        let mut weights = Vec::new();
        for query in [[1.0, 0.1], [3.9, 0.9], [2.0, 0.5]] {
            smoother.regression_weights(&query, Degree::Linear, &mut weights).unwrap();
            assert!((weights.iter().map(|w| w.1).sum::<f64>() - 1.0).abs() < 1e-9);
            let mut value = [0.0];
            plane.predict(&query, &mut value).unwrap();
            assert!((value[0] - (3.0 - 2.0 * query[0] + query[1])).abs() < 1e-3);
        }
    }
}

#[test]
fn thread_count_changes_no_bit_and_memory_is_used_again() {
    let data = data(100, 10, 3);
    let queries: Vec<f64> = data.states().iter().map(|x| x + 0.01).collect();
    let weighting = Weighting::kernel(Kernel::Gaussian, &[0.3, 0.3]);
    for model in fit_all(&data, Alignment::Shift { state_dim: 0 }, &weighting, Degree::Linear) {
        let [one, two, eight] = [1, 2, 8].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| model.predict_batch(&queries).unwrap())
        });
        assert_eq!(one, two);
        assert_eq!(one, eight);
        let mut again = Predictions::new(model.outcomes());
        for _ in 0..2 {
            model.predict_batch_into(&queries, &mut again).unwrap();
            assert_eq!(one, again);
        }
        assert!(model.predict_batch_into(&queries[1..], &mut again).is_err());
        assert!(again.is_empty());
        model.predict_batch_into(&queries[..4], &mut again).unwrap();
        assert_eq!(again.distribution(1), one.distribution(1));
    }
}

/// Where the truth is a location-scale family, linear in the state, its quantiles are linear in the state, and local
/// linear Frechet regression has no bias: Wasserstein-1 distance below a quarter of a bin's width with 200 states.
/// The barycentre (degree 0) is biased at the edge, which is the control.
#[test]
fn frechet_regression_is_unbiased_at_the_edge_of_a_linear_family() {
    let grid = Outcomes::of_values(-2.0, 6.0, 0.02).unwrap();
    let mut data = Dataset::new(1);
    // Exact quantiles of a uniform density in place of random draws.
    for k in 0..200 {
        let x = f64::from(k) / 199.0;
        let z: Vec<f64> = (0..100).map(|j| 2.0 * x + (0.2 + x) * ((f64::from(j) + 0.5) / 100.0)).collect();
        data.push(&[x], &z).unwrap();
    }
    let predict = |degree, x: f64| {
        let method = FrechetOptions {
            outcomes: grid,
            alignment: Alignment::Identity,
            quantiles: 100,
            weighting: Weighting::kernel(Kernel::Epanechnikov, &[0.3]),
            degree,
        };
        method.fit(&data).unwrap().predict(&[x]).unwrap().0
    };
    for x in [0.0, 0.5, 1.0] {
        let cdf = |z: f64| ((z - 2.0 * x) / (0.2 + x)).clamp(0.0, 1.0);
        let mass = (0..grid.grid.bins)
            .map(|b| grid.grid.lo + b as f64 * grid.grid.width)
            .map(|edge| cdf(edge + grid.grid.width) - cdf(edge))
            .collect();
        let truth = Distribution::new(grid.grid, mass, None).unwrap();
        let distance = |degree| wasserstein_1(&predict(degree, x), &truth).unwrap();
        assert!(distance(Degree::Linear) < 0.005, "{} at {x}", distance(Degree::Linear));
        assert!(x == 0.5 || distance(Degree::Constant) > 0.1);
    }
}

/// A plane through quantiles that close on each other crosses them beyond the data; their projection doesn't fall.
#[test]
fn predicted_quantiles_never_fall() {
    let mut data = Dataset::new(1);
    for k in 0..20 {
        let x = f64::from(k) * 0.05;
        let z: Vec<f64> = (0..10).map(|j| 2.0 + (1.0 - x) * f64::from(j) * 0.1).collect();
        data.push(&[x], &z).unwrap();
    }
    let method = FrechetOptions {
        outcomes: Outcomes::of_values(0.0, 4.0, 0.02).unwrap(),
        alignment: Alignment::Identity,
        quantiles: 10,
        weighting: Weighting::kernel(Kernel::Gaussian, &[0.5]),
        degree: Degree::Linear,
    };
    let model = method.fit(&data).unwrap();
    let (inside, _) = model.quantiles(&[0.5]).unwrap();
    assert!(inside.is_sorted() && inside[9] > inside[0] + 0.4);
    // At 1.5 the plane has quantiles 2 to 1.55; what doesn't fall and is nearest is their mean.
    let (outside, support) = model.quantiles(&[1.5]).unwrap();
    assert_eq!(support, Support::InData);
    assert!(outside.iter().all(|q| (q - 1.775).abs() < 1e-3), "{outside:?}");
}

/// Balanced weights take the bias from the edge of the data: NP-REG of a share that is linear in the state.
#[test]
fn balancing_takes_the_bias_at_the_edge() {
    let outcomes = Outcomes::of_values(0.0, 1.0, 1.0).unwrap();
    let mut data = Dataset::new(1);
    for k in 0..=100 {
        // State k / 100 reads 1 with that probability, exactly.
        let z: Vec<f64> = (0..100).map(|j| f64::from(u8::from(j < k))).collect();
        data.push(&[f64::from(k) / 100.0], &z).unwrap();
    }
    let share = |degree, x: f64| {
        let method = NpRegOptions {
            outcomes,
            alignment: Alignment::Identity,
            density: DensityEstimate::Histogram,
            weighting: Weighting::kernel(Kernel::Epanechnikov, &[0.3]),
            degree,
        };
        method.fit(&data).unwrap().predict(&[x]).unwrap().0.mass()[1]
    };
    assert!((share(Degree::Linear, 0.5) - 0.5).abs() < 1e-9);
    // One-sided Epanechnikov weights have their mean at 3/8 of a bandwidth.
    assert!((share(Degree::Constant, 1.0) - (1.0 - 0.1125)).abs() < 0.005);
    assert!((share(Degree::Linear, 1.0) - 1.0).abs() < 0.04, "{}", share(Degree::Linear, 1.0));
}

#[test]
fn a_table_holds_the_predictions_of_its_cells() {
    let data = data(60, 20, 5);
    let weighting = Weighting::kernel(Kernel::Gaussian, &[0.5, 0.3]);
    let model = &fit_all(&data, Alignment::Shift { state_dim: 0 }, &weighting, Degree::Constant)[1];
    let axes = [Axis { lo: 0.5, width: 0.5, cells: 7 }, Axis { lo: 0.0, width: 0.25, cells: 4 }];
    let table = Table::prepare(model.as_ref(), &axes).unwrap();
    for (state, middle) in [
        ([1.3, 0.6], [1.25, 0.625]),
        ([-4.0, 0.1], [0.75, 0.125]),
        ([99.0, 99.0], [3.75, 0.875]),
        ([f64::NAN, 0.1], [0.75, 0.125]),
    ] {
        let (d, _) = model.predict(&middle).unwrap();
        for k in 0..300 {
            let z = f64::from(k) * 0.02 - 0.3;
            let (found, expected) = (f64::from(table.density(&state, z)), d.density(z));
            assert!((found - expected).abs() <= 1e-6 * expected, "{found} {expected} at {z}");
        }
        assert!((f64::from(table.density(&state, MAXIMUM)) - d.density(MAXIMUM)).abs() < 1e-7);
        assert_eq!(table.density(&state, f64::NAN), 0.0);
    }
    assert!(Table::prepare(model.as_ref(), &axes[..1]).is_err());
    assert!(Table::prepare(model.as_ref(), &[axes[0], Axis { cells: 0, ..axes[1] }]).is_err());
}

/// The models that hold regressed values come back from a file as they were, and don't from one whose values don't
/// fit the settings.
#[test]
fn a_fitted_model_survives_a_file_and_a_damaged_one_is_refused() {
    fn there_and_back<M>(model: &M, damage: &[(&str, &str)])
    where
        M: serde::Serialize + serde::de::DeserializeOwned + PartialEq + std::fmt::Debug,
    {
        let mut file = Vec::new();
        ciborium::into_writer(model, &mut file).unwrap();
        assert_eq!(&ciborium::from_reader::<M, _>(&file[..]).unwrap(), model);
        let text = serde_json::to_string(model).unwrap();
        for (key, bad) in damage {
            assert!(text.contains(key), "{key}");
            assert!(serde_json::from_str::<M>(&text.replace(key, bad)).is_err(), "{bad}");
        }
    }
    let data = data(20, 10, 4);
    let (alignment, degree) = (Alignment::Shift { state_dim: 0 }, Degree::Linear);
    let weighting = Weighting::nearest_neighbours(7, &[0.5, 0.5]);
    let p_reg = PRegOptions {
        outcomes: outcomes(),
        alignment,
        family: Family::TwoGaussians,
        weighting: weighting.clone(),
        degree,
        smallest_sigma: 1e-3,
        least_observations: 5,
    };
    let damage = [("two_gaussians", "gaussian"), ("\"smallest_sigma\":0.001", "\"smallest_sigma\":-1.0")];
    there_and_back(&p_reg.fit(&data).unwrap(), &damage);
    let frechet = FrechetOptions { outcomes: outcomes(), alignment, quantiles: 9, weighting, degree };
    let damage =
        [("\"quantiles\":9", "\"quantiles\":8"), ("\"point_mass_at\":5.0", "\"point_mass_at\":null")];
    there_and_back(&frechet.fit(&data).unwrap(), &damage);
}

fn np_reg(bandwidths: &[f64]) -> NpRegOptions {
    NpRegOptions {
        outcomes: outcomes(),
        alignment: Alignment::Shift { state_dim: 0 },
        density: DensityEstimate::Histogram,
        weighting: Weighting::kernel(Kernel::Gaussian, bandwidths),
        degree: Degree::Constant,
    }
}

/// The mean over folds of held-out losses, as plain sums.
#[test]
fn cross_validation_is_the_mean_loss_of_held_out_states() {
    let data = data(31, 12, 6);
    let method = np_reg(&[0.5, 0.3]);
    let mut sum = 0.0;
    for (train, held_out) in data.folds(4, 2).unwrap() {
        let model = method.fit(&train).unwrap();
        for i in 0..held_out.len() {
            let (d, _) = model.predict(held_out.state(i)).unwrap();
            sum += Loss::Crps.of(&d, held_out.observations(i)).unwrap();
        }
    }
    let found = cross_validate(&method, &data, 4, 2, Loss::Crps).unwrap();
    assert!((found - sum / 31.0).abs() < 1e-12);
    assert!(matches!(cross_validate(&method, &data, 32, 2, Loss::Crps), Err(Error::Folds { .. })));
}

/// Thinning 400 states to 25: each choice is a set of different states whose beginnings are the smaller choices;
/// covering beats chance, and giving the kept states all observations beats throwing them away.
#[test]
fn thinning_keeps_the_most_of_the_risk() {
    let steep = |states, draws, seed| {
        let mut random = Philox::from_u64_seed(seed);
        let mut data = Dataset::new(2);
        for _ in 0..states {
            let x = [uniform(&mut random, 0.5, 4.0), uniform(&mut random, 0.0, 1.0)];
            let mut draw = || {
                let lost = uniform(&mut random, 0.0, 1.0) < 0.7 * x[1];
                if lost { MAXIMUM } else { x[0] + uniform(&mut random, -0.2, 0.2) }
            };
            let z: Vec<f64> = (0..draws).map(|_| draw()).collect();
            data.push(&x, &z).unwrap();
        }
        data
    };
    let (train, held_out) = (steep(300, 10, 7), steep(100, 400, 8));
    let scales = [0.8, 0.3];
    let mean_risk = |kept: &Dataset| {
        let method = NpRegOptions { degree: Degree::Linear, ..np_reg(&[0.8, 0.2]) };
        let model = method.fit(kept).unwrap();
        risk(&losses(&model, &held_out, Loss::Wasserstein1).unwrap(), 1).unwrap().mean
    };
    let whole = mean_risk(&train);
    let mut covering = Vec::new();
    for selection in [Selection::FarthestFirst, Selection::Herding, Selection::Random] {
        let order = select(&train, 25, selection, &scales, 3).unwrap();
        let mut different = order.clone();
        different.sort_unstable();
        different.dedup();
        assert_eq!(different.len(), 25);
        assert_eq!(select(&train, 10, selection, &scales, 3).unwrap(), order[..10]);
        assert_eq!(select(&train, 999, selection, &scales, 3).unwrap().len(), 300);
        let condensed =
            condense(&train, &order, Alignment::Shift { state_dim: 0 }, Some(MAXIMUM), &scales).unwrap();
        let count: usize = (0..condensed.len()).map(|i| condensed.observations(i).len()).sum();
        assert_eq!((condensed.len(), count), (25, 3000));
        let (thinned, condensed) = (mean_risk(&train.subset(&order)), mean_risk(&condensed));
        assert!(condensed - whole < 0.5 * (thinned - whole), "{selection:?}: {whole} {thinned} {condensed}");
        // The greatest distance of a state from the nearest kept one, in scales.
        let radius = |order: &[usize]| {
            let distance = |i: usize, j: usize| {
                let (a, b) = (train.state(i), train.state(j));
                ((a[0] - b[0]) / scales[0]).hypot((a[1] - b[1]) / scales[1])
            };
            let nearest = |i| order.iter().map(|&j| distance(i, j)).fold(f64::INFINITY, f64::min);
            (0..train.len()).map(nearest).fold(0.0, f64::max)
        };
        covering.push(radius(&order));
    }
    assert!(covering[0] < 0.8 * covering[2], "{covering:?}");
    assert!(covering[1] < covering[2], "{covering:?}");
    assert!(select(&train, 5, Selection::Herding, &[0.1], 1).is_err());
    assert!(select(&Dataset::new(2), 5, Selection::Random, &scales, 1).is_err());
    assert!(condense(&train, &[], Alignment::Identity, None, &scales).is_err());
}

/// Two narrow peaks that move and part with the state: neither a Gaussian nor histograms of z - x know that shape,
/// residuals of location and scale do. Truth by 2000 draws at each held-out state.
#[test]
fn standardized_residuals_keep_a_shape_that_stretches() {
    let outcomes = Outcomes::of_values(-1.0, 3.0, 0.005).unwrap();
    let family = |states, draws, seed| {
        let mut random = Philox::from_u64_seed(seed);
        let mut data = Dataset::new(1);
        for _ in 0..states {
            let x = uniform(&mut random, 0.0, 1.0);
            let z: Vec<f64> = (0..draws)
                .map(|_| {
                    let e: f64 = StandardNormal.sample(&mut random);
                    let peak = if uniform(&mut random, 0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
                    x + (0.05 + 0.5 * x) * (peak + 0.1 * e)
                })
                .collect();
            data.push(&[x], &z).unwrap();
        }
        data
    };
    let (train, held_out) = (family(150, 50, 1), family(60, 2000, 2));
    let weighting = Weighting::kernel(Kernel::Epanechnikov, &[0.2]);
    let np_reg = NpRegOptions {
        outcomes,
        alignment: Alignment::Shift { state_dim: 0 },
        density: DensityEstimate::Histogram,
        weighting: weighting.clone(),
        degree: Degree::Linear,
    };
    let p_reg = PRegOptions {
        outcomes,
        alignment: Alignment::Identity,
        family: Family::Gaussian,
        weighting,
        degree: Degree::Linear,
        smallest_sigma: 1e-3,
        least_observations: 10,
    };
    let standardized = StandardizedOptions {
        location_scale: p_reg.clone(),
        residual: NpRegOptions {
            outcomes: Outcomes::of_values(-4.0, 4.0, 0.02).unwrap(),
            alignment: Alignment::Identity,
            ..np_reg.clone()
        },
    };
    let mean = |model: &dyn ConditionalDistribution| {
        risk(&losses(model, &held_out, Loss::Wasserstein1).unwrap(), 1).unwrap().mean
    };
    let found = mean(&standardized.fit(&train).unwrap());
    let (registered, gaussian) = (mean(&np_reg.fit(&train).unwrap()), mean(&p_reg.fit(&train).unwrap()));
    assert!(found < 0.6 * registered && found < 0.2 * gaussian, "{found} {registered} {gaussian}");
    let no_point = StandardizedOptions {
        location_scale: PRegOptions { outcomes: outcomes.with_point_mass(2.0), ..p_reg },
        ..standardized
    };
    assert!(matches!(no_point.fit(&train), Err(Error::PointMassMismatch)));
}
