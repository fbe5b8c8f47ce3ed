//! NP-REG: against the dense product it stands for, at its limits, and registered against faithful.

use distreg::{
    Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, Distribution, Error,
    FALLBACK_NEIGHBOURS, Grid, Kernel, Loss, NpReg, NpRegOptions, Outcomes, PointMass, Regressor, Smoother,
    Support, Weighting, cross_validate, grid_search, histogram, histogram_match, kernel_density, product,
    risk,
};
use proptest::prelude::*;
use rand_distr::{Distribution as _, StandardNormal};
use rand_philox::{Philox, u32_to_unit_f64};
use statrs::distribution::{ContinuousCDF, Normal};

const KERNELS: [Kernel; 3] = [Kernel::Gaussian, Kernel::Boxcar, Kernel::Epanechnikov];
const ALIGNMENTS: [Alignment; 3] =
    [Alignment::Identity, Alignment::Shift { state_dim: 0 }, Alignment::Scale { state_dim: 0 }];
const MAXIMUM: f64 = 5.0;

fn grid() -> Grid {
    Grid::of_values(0.0, MAXIMUM, 0.02).unwrap()
}

fn outcomes() -> Outcomes {
    Outcomes { grid: grid(), point_mass_at: Some(MAXIMUM) }
}

fn options(alignment: Alignment, kernel: Kernel, bandwidths: &[f64]) -> NpRegOptions {
    NpRegOptions {
        outcomes: outcomes(),
        alignment,
        density: DensityEstimate::Histogram,
        weighting: Weighting::kernel(kernel, bandwidths),
        degree: Degree::Constant,
    }
}

fn uniform(random: &mut Philox, lo: f64, hi: f64) -> f64 {
    lo + (hi - lo) * u32_to_unit_f64(random.next_u32())
}

/// A shift family: z = x0 + noise whose deviation depends on x1, and 10 % of the observations at the maximum.
fn shift_family(states: usize, draws: usize, seed: u64) -> Dataset {
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

/// The expected prediction at a state of some data.
type Target = fn(&Dataset, usize) -> Distribution;

/// The distribution that [`shift_family`] draws from.
fn truth(data: &Dataset, i: usize) -> Distribution {
    let (x, grid) = (data.state(i), grid());
    let normal = Normal::new(x[0], 0.02 + 0.04 * x[1]).unwrap();
    let edge = |b: usize| 0.9 * normal.cdf(grid.lo + b as f64 * grid.width);
    let mass = (0..grid.bins).map(|b| edge(b + 1) - edge(b)).collect();
    Distribution::new(grid, mass, Some(PointMass { at: MAXIMUM, mass: 0.1 })).unwrap()
}

fn queries(count: usize, seed: u64) -> Vec<f64> {
    let mut random = Philox::from_u64_seed(seed);
    (0..count).flat_map(|_| [uniform(&mut random, 0.4, 4.1), uniform(&mut random, -0.1, 1.1)]).collect()
}

fn total(d: &Distribution) -> f64 {
    d.mass().iter().sum::<f64>() + d.point().map_or(0.0, |p| p.mass)
}

/// The product H W of the paper in dense f64, from eq. 6 and 7 as they stand: one row per bin and one more for
/// the point mass. `None` for queries without any weight.
fn dense(data: &Dataset, kernel: Kernel, h: &[f64], query: &[f64]) -> Option<Vec<f64>> {
    let grid = grid();
    let mut weights: Vec<f64> = (0..data.len())
        .map(|i| {
            let u2: f64 = (0..2).map(|d| ((query[d] - data.state(i)[d]) / h[d]).powi(2)).sum();
            match kernel {
                Kernel::Gaussian => (-0.5 * u2).exp(),
                Kernel::Boxcar => f64::from(u8::from(u2 <= 1.0)),
                Kernel::Epanechnikov => (1.0 - u2).max(0.0),
            }
        })
        .collect();
    let sum: f64 = weights.iter().sum();
    if sum == 0.0 {
        return None;
    }
    for w in &mut weights {
        *w /= sum;
    }
    let mut out = vec![0.0; grid.bins + 1];
    for (i, w) in weights.iter().enumerate() {
        let z = data.observations(i);
        let mut column = vec![0.0; grid.bins + 1];
        for &z in z {
            column[if z == MAXIMUM { grid.bins } else { grid.bin(z) }] += 1.0;
        }
        for (o, c) in out.iter_mut().zip(&column) {
            *o += w * c / z.len() as f64;
        }
    }
    Some(out)
}

/// Every kernel and several bandwidths, from those that reach a few states to those that reach all; for narrow
/// Gaussians some queries are tens of bandwidths from the nearest state, where pruning would show.
#[test]
fn predictions_equal_the_dense_product() {
    let data = shift_family(300, 40, 1);
    let queries = queries(60, 2);
    for kernel in KERNELS {
        for h in [[0.005, 0.02], [0.05, 0.1], [0.3, 2.0], [9.0, 9.0]] {
            let model = options(Alignment::Identity, kernel, &h).fit(&data).unwrap();
            let predictions = model.predict_batch(&queries).unwrap();
            for (q, query) in queries.chunks(2).enumerate() {
                let Some(dense) = dense(&data, kernel, &h, query) else {
                    assert_eq!(predictions.support()[q], Support::Nearest);
                    continue;
                };
                assert_eq!(predictions.support()[q], Support::InData);
                for (b, m) in predictions.mass(q).iter().enumerate() {
                    assert!((m - dense[b]).abs() < 1e-12, "{kernel:?} {h:?} bin {b}: {m} {}", dense[b]);
                }
                assert!((predictions.points()[q] - dense[grid().bins]).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn thread_count_changes_no_bit() {
    let data = shift_family(200, 20, 3);
    let queries = queries(101, 4);
    for alignment in ALIGNMENTS {
        let model = options(alignment, Kernel::Gaussian, &[0.2, 0.2]).fit(&data).unwrap();
        let [one, two, eight] = [1, 2, 8].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| model.predict_batch(&queries).unwrap())
        });
        assert_eq!(one, two);
        assert_eq!(one, eight);
        for (q, query) in queries.chunks(2).enumerate() {
            assert_eq!(model.predict(query).unwrap().0, one.distribution(q));
        }
    }
}

/// A query with no state within the kernel's support is answered by its nearest states, and says so.
#[test]
fn a_query_outside_the_data_is_flagged_and_finite() {
    let data = shift_family(50, 10, 5);
    let far = [400.0, -300.0];
    for kernel in KERNELS {
        let smoother = Smoother::new(&data, &Weighting::kernel(kernel, &[0.1, 0.1])).unwrap();
        let mut weights = Vec::new();
        assert_eq!(smoother.weights(&far, &mut weights).unwrap(), Support::Nearest);
        let mut by_distance: Vec<usize> = (0..data.len()).collect();
        let distance = |i: usize| (data.state(i)[0] - far[0]).hypot(data.state(i)[1] - far[1]);
        by_distance.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        let mut used: Vec<usize> = weights.iter().map(|w| w.0).collect();
        used.sort_unstable();
        by_distance.truncate(FALLBACK_NEIGHBOURS);
        by_distance.sort_unstable();
        assert_eq!(used, by_distance);
        for alignment in ALIGNMENTS {
            let model = options(alignment, kernel, &[0.1, 0.1]).fit(&data).unwrap();
            for query in [far, [f64::MAX, f64::MAX], [f64::MIN_POSITIVE, 0.0]] {
                let (d, support) = model.predict(&query).unwrap();
                assert!(query[0] < 1.0 || support == Support::Nearest);
                assert!((total(&d) - 1.0).abs() < 1e-12);
                assert!(d.mass().iter().all(|m| m.is_finite() && *m >= 0.0));
            }
            assert_eq!(model.predict(data.state(0)).unwrap().1, Support::InData);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn predictions_sum_to_one(
        seed in 0..1000u64,
        query in (0.01..6.0f64, -1.0..2.0f64),
        h in (0.01..2.0f64, 0.01..2.0f64),
        kernel in prop::sample::select(KERNELS.to_vec()),
        alignment in prop::sample::select(ALIGNMENTS.to_vec()),
        degree in prop::sample::select(vec![Degree::Constant, Degree::Linear]),
        bandwidth in prop::option::of(0.01..0.5f64),
    ) {
        let data = shift_family(30, 5, seed);
        let density = bandwidth.map_or(DensityEstimate::Histogram, |bandwidth| {
            DensityEstimate::Kernel { kernel, bandwidth }
        });
        let options = NpRegOptions { density, degree, ..options(alignment, kernel, &[h.0, h.1]) };
        let (d, _) = options.fit(&data).unwrap().predict(&[query.0, query.1]).unwrap();
        prop_assert!((total(&d) - 1.0).abs() < 1e-12);
        prop_assert!(d.mass().iter().all(|&m| m >= 0.0));
    }

    /// Binning an aligned observation moves it by at most half a bin, and moving histograms keeps the mean: a
    /// prediction well within the grid has the mean of the moved observations to half a bin. A ratio's bin that is
    /// wider than the grid's, by a factor L, is spread over several; the mean over their centres is off by another
    /// 1 / (8 L) of a bin where half of the last one is covered.
    #[test]
    fn alignment_moves_observations_with_the_state(
        state in 0.8..2.0f64,
        query in 0.5..2.0f64,
        relative in prop::collection::vec(-0.2..0.2f64, 1..20),
    ) {
        let n = relative.len() as f64;
        for (alignment, expected) in [
            (Alignment::Shift { state_dim: 0 }, query + relative.iter().sum::<f64>() / n),
            (Alignment::Scale { state_dim: 0 }, query * (1.0 + relative.iter().sum::<f64>() / n / state)),
        ] {
            let mut data = Dataset::new(1);
            let z: Vec<f64> = relative.iter().map(|r| state + r).collect();
            data.push(&[state], &z).unwrap();
            let model = options(alignment, Kernel::Gaussian, &[1.0]).fit(&data).unwrap();
            let (d, _) = model.predict(&[query]).unwrap();
            // A ratio's bin is as wide as the grid's at the largest state, and wider beyond it.
            let wider = (query / state).max(1.0);
            let spread = if wider > 1.0 { 0.125 / wider } else { 0.0 };
            let most = (0.5 * wider + spread) * grid().width;
            prop_assert!((d.mean() - expected).abs() <= most + 1e-9);
        }
    }
}

/// Where the distribution moves with the state, smoothing aligned histograms doesn't blur. Both have their
/// bandwidths from the same cross-validated search on the states' own histograms, and are held against the true
/// distribution at held-out states.
#[test]
fn registered_prediction_beats_faithful_on_a_shift_family() {
    let (train, held_out) = shift_family(220, 40, 6).split(0.25, 7);
    assert_eq!((train.len(), held_out.len()), (165, 55));
    let losses = |data: &Dataset, test: &Dataset, options: &NpRegOptions, target: Target| {
        let predictions = options.fit(data)?.predict_batch(test.states())?;
        (0..test.len())
            .map(|i| histogram_match(&predictions.distribution(i), &target(test, i)))
            .collect::<Result<Vec<f64>, Error>>()
    };
    let [faithful, registered] = [Alignment::Identity, Alignment::Shift { state_dim: 0 }].map(|alignment| {
        let candidates = product(&[&[0.01, 0.03, 0.1, 0.3, 1.0], &[0.1, 0.3, 1.0]]);
        let found = grid_search(&candidates, |h| {
            cross_validate(&options(alignment, Kernel::Gaussian, h), &train, 4, 8, Loss::HistogramMatch)
        })
        .unwrap();
        assert_eq!(found.scores.len(), 15);
        let chosen = options(alignment, Kernel::Gaussian, &found.candidate);
        risk(&losses(&train, &held_out, &chosen, truth).unwrap(), 9).unwrap()
    });
    assert!(registered.hi < 0.5 * faithful.lo, "{registered:?} {faithful:?}");
}

#[test]
fn what_moves_above_the_maximum_reads_as_maximum_and_below_the_grid_as_its_first_bin() {
    let mut data = Dataset::new(1);
    data.push(&[2.0], &[1.5, 2.0, 2.5, MAXIMUM]).unwrap();
    let mut options = options(Alignment::Shift { state_dim: 0 }, Kernel::Gaussian, &[10.0]);
    let predict = |options: &NpRegOptions, x: f64| options.fit(&data).unwrap().predict(&[x]).unwrap().0;
    // At 5.0: the observation at 5.5, and half of the bin [5.0, 5.02) that 5.0 aligns to, as the grid ends at 5.01.
    assert!((predict(&options, 5.0).point().unwrap().mass - (0.25 + 0.25 + 0.125)).abs() < 1e-9);
    assert!((predict(&options, 6.0).point().unwrap().mass - 1.0).abs() < 1e-12);
    assert!((predict(&options, -3.0).mass()[0] - 0.75).abs() < 1e-12);
    assert!((predict(&options, -3.0).point().unwrap().mass - 0.25).abs() < 1e-12);
    // Without a point mass at that end, it's the last bin.
    options.outcomes.point_mass_at = None;
    assert!((predict(&options, 9.0).mass()[250] - 1.0).abs() < 1e-12);
}

/// With a single state the prediction is that state's own density, by eq. 6 or eq. 5.
#[test]
fn one_state_predicts_its_own_density() {
    let mut data = Dataset::new(1);
    let z = [1.0, 1.0, 1.02, 3.0];
    data.push(&[0.3], &z).unwrap();
    let plain = options(Alignment::Identity, Kernel::Epanechnikov, &[0.1]);
    let kernel = Kernel::Epanechnikov;
    let smooth =
        NpRegOptions { density: DensityEstimate::Kernel { kernel, bandwidth: 0.1 }, ..plain.clone() };
    let predict = |options: NpRegOptions| options.fit(&data).unwrap().predict(&[0.31]).unwrap().0;
    assert_eq!(predict(plain), histogram(&z, &outcomes()).unwrap());
    assert_eq!(predict(smooth), kernel_density(&z, &outcomes(), kernel, 0.1).unwrap());
}

#[test]
fn a_fitted_model_survives_a_file_and_a_damaged_one_is_refused() {
    let data = shift_family(40, 1, 10);
    for alignment in ALIGNMENTS {
        let model = options(alignment, Kernel::Gaussian, &[0.2, 0.3]).fit(&data).unwrap();
        let mut file = Vec::new();
        ciborium::into_writer(&model, &mut file).unwrap();
        let back: NpReg = ciborium::from_reader(&file[..]).unwrap();
        assert_eq!(model, back);
        let queries = queries(9, 11);
        assert_eq!(model.predict_batch(&queries).unwrap(), back.predict_batch(&queries).unwrap());
        let text = serde_json::to_string(&model).unwrap();
        for (key, bad) in [
            ("\"masses\":[", "\"masses\":[3.5,"),
            ("\"ends\":[1,", "\"ends\":[99,"),
            ("\"bandwidths\":[0.2,", "\"bandwidths\":[-0.2,"),
            ("\"bins\":251", "\"bins\":0"),
        ] {
            assert!(text.contains(key), "{key}");
            assert!(serde_json::from_str::<NpReg>(&text.replace(key, bad)).is_err(), "{bad}");
        }
    }
}

#[test]
fn impossible_input_is_an_error() {
    let data = shift_family(10, 3, 12);
    let good = options(Alignment::Identity, Kernel::Gaussian, &[0.1, 0.1]);
    let fit = |change: &dyn Fn(&mut NpRegOptions)| {
        let mut options = good.clone();
        change(&mut options);
        options.fit(&data)
    };
    let model = fit(&|_| ()).unwrap();
    assert!(matches!(
        fit(&|o| o.weighting = Weighting::kernel(Kernel::Gaussian, &[0.1])),
        Err(Error::Length { .. })
    ));
    assert!(matches!(
        fit(&|o| o.weighting = Weighting::kernel(Kernel::Gaussian, &[0.1, 0.0])),
        Err(Error::NotPositive { .. })
    ));
    let negative = DensityEstimate::Kernel { kernel: Kernel::Gaussian, bandwidth: -1.0 };
    assert!(matches!(fit(&|o| o.density = negative), Err(Error::NotPositive { .. })));
    assert!(matches!(fit(&|o| o.outcomes.grid.bins = 0), Err(Error::Bins { found: 0, .. })));
    assert!(matches!(fit(&|o| o.outcomes.point_mass_at = Some(f64::NAN)), Err(Error::NotFinite { .. })));
    let nobody = Weighting::nearest_neighbours(0, &[0.1, 0.1]);
    assert!(matches!(fit(&|o| o.weighting = nobody.clone()), Err(Error::Empty { .. })));
    let beyond = Alignment::Shift { state_dim: 2 };
    assert_eq!(fit(&|o| o.alignment = beyond), Err(Error::AlignmentDimension { state_dim: 2, dim: 2 }));
    assert!(matches!(good.fit(&Dataset::new(2)), Err(Error::Empty { .. })));
    for query in [&[1.0][..], &[1.0; 3], &[], &[1.0; 4]] {
        assert!(matches!(model.predict(query), Err(Error::Dimension { .. })), "{query:?}");
    }
    assert!(matches!(model.predict(&[f64::NAN, 0.0]), Err(Error::NotFinite { .. })));
    let scaled = fit(&|o| o.alignment = Alignment::Scale { state_dim: 0 }).unwrap();
    assert!(matches!(scaled.predict(&[0.0, 0.0]), Err(Error::NotPositive { .. })));
    assert!(model.predict_batch(&[]).unwrap().is_empty());
}
