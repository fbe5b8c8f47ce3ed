//! The batched standard normal numbers of [`Draw::normals`] against the distribution, each test with a
//! false-alarm probability of about 1e-6 and with a sample that it must refuse.

use locsim_core::{BATCH, Draw, Stage};
use statrs::distribution::{Continuous, ContinuousCDF, Normal};

const N: usize = 1 << 20;
/// Two-sided quantile of the standard normal distribution for a false-alarm probability of 1e-6.
const Z: f64 = 4.9;

fn draw() -> Draw {
    Draw::new(42, Stage::Motion, 7)
}

/// Number `k` of the first [`N`] items.
fn sample(k: usize) -> Vec<f64> {
    let batches = (0..(N / BATCH) as u32).map(|batch| draw().normals(batch * BATCH as u32)[k]);
    batches.flatten().map(f64::from).collect()
}

/// Kolmogorov and Smirnov's distance to the standard normal distribution, over its bound for a false-alarm
/// probability of 1e-6 by the inequality of Dvoretzky, Kiefer and Wolfowitz: sqrt(ln(2 / 1e-6) / (2 n)).
fn kolmogorov_smirnov(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len() as f64;
    let distance = values.iter().enumerate().fold(0.0_f64, |distance, (i, value)| {
        let cdf = Normal::standard().cdf(*value);
        distance.max(cdf - i as f64 / n).max((i + 1) as f64 / n - cdf)
    });
    distance / ((2.0 / 1e-6_f64).ln() / (2.0 * n)).sqrt()
}

/// Greatest deviation of the first six moments from 0, 1, 0, 3, 0, 15, over its bound. Var(z^k) is
/// E z^2k - (E z^k)^2.
fn moments(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let expected = [(0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0), (0.0, 945.0), (15.0, 10_170.0)];
    expected.iter().enumerate().fold(0.0, |greatest, (i, (mean, variance))| {
        let moment = values.iter().map(|v| v.powi(i as i32 + 1)).sum::<f64>() / n;
        f64::max(greatest, (moment - mean).abs() / (Z * f64::sqrt(variance / n)))
    })
}

/// Deviation of the numbers beyond 3, 3.5 and 4, on either side, from their expectations, over its bound. The
/// rarest is expected 33 times in a million: its counts are Poisson, and 33 + 4.9 sqrt(33) + 4.9^2 / 3 is exceeded
/// with a probability below 1e-6 (Bernstein's inequality gives the last term).
fn tails(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    [3.0, 3.5, 4.0].into_iter().fold(0.0, |greatest, threshold| {
        let expected = n * Normal::standard().sf(threshold);
        let bound = Z * expected.sqrt() + Z * Z / 3.0;
        let above = values.iter().filter(|v| **v > threshold).count() as f64;
        let below = values.iter().filter(|v| **v < -threshold).count() as f64;
        f64::max(greatest, (above - expected).abs().max((below - expected).abs()) / bound)
    })
}

#[test]
fn each_of_the_three_is_standard_normal() {
    for k in 0..3 {
        let mut values = sample(k);
        let results = [moments(&values), tails(&values), kolmogorov_smirnov(&mut values)];
        assert!(results.iter().all(|r| *r < 1.0), "number {k}: {results:?}");
    }
}

/// Negative controls: a scale off by 1 %, a mean off by a hundredth, tails cut at 3.5.
#[test]
fn each_test_refuses_what_is_slightly_off() {
    let mut wide: Vec<f64> = sample(0).iter().map(|v| 1.01 * v).collect();
    assert!(moments(&wide) > 1.0 && kolmogorov_smirnov(&mut wide) > 1.0);
    let mut shifted: Vec<f64> = sample(0).iter().map(|v| v + 0.01).collect();
    assert!(moments(&shifted) > 1.0 && kolmogorov_smirnov(&mut shifted) > 1.0);
    let cut: Vec<f64> = sample(0).iter().map(|v| v.clamp(-3.5, 3.5)).collect();
    assert!(tails(&cut) > 1.0);
}

/// Correlations of two numbers of an item, of their squares, and of neighbouring items' numbers: with n pairs of
/// independent standard normal numbers the mean product has the standard deviation 1 / sqrt(n), that of squares
/// about their mean 2 / sqrt(n).
#[test]
fn numbers_of_an_item_and_of_its_neighbours_are_independent() {
    let samples = [0, 1, 2].map(sample);
    let products = |a: &[f64], b: &[f64]| {
        let n = a.len().min(b.len()) as f64;
        let mean = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(a, b)| f(*a, *b)).sum::<f64>() / n;
        let plain = mean(&|a, b| a * b) * n.sqrt();
        let squares = mean(&|a, b| (a * a - 1.0) * (b * b - 1.0)) * n.sqrt() / 2.0;
        plain.abs().max(squares.abs()) / Z
    };
    for (i, a) in samples.iter().enumerate() {
        for b in &samples[..i] {
            assert!(products(a, b) < 1.0);
        }
        for lag in [1, 2, 8, BATCH] {
            assert!(products(a, &a[lag..]) < 1.0, "lag {lag}");
        }
    }
    // Negative controls: a share of one in the other, and a radius in common.
    let [x, y, z] = samples;
    let mixed: Vec<f64> = x.iter().zip(&y).map(|(x, y)| 0.01 * x + y).collect();
    assert!(products(&x, &mixed) > 1.0);
    let common: Vec<f64> = x.iter().zip(&z).map(|(x, z)| z * (0.9 + 0.1 * x.abs())).collect();
    assert!(products(&x, &common) > 1.0);
}

#[test]
fn numbers_depend_on_the_key_and_the_item_and_not_on_the_batch() {
    let base = draw().normals(0);
    let shifted = draw().normals(5);
    for k in 0..3 {
        assert_eq!(base[k][5..], shifted[k][..BATCH - 5]);
        assert!(base[k].windows(2).all(|pair| pair[0] != pair[1]));
    }
    for other in
        [Draw::new(43, Stage::Motion, 7), Draw::new(42, Stage::Resample, 7), Draw::new(42, Stage::Motion, 8)]
    {
        assert!(base.as_flattened().iter().zip(other.normals(0).as_flattened()).all(|(a, b)| a != b));
    }
    // The last item's neighbour is the first: item numbers wrap.
    assert_eq!(draw().normals(u32::MAX)[0][1], base[0][0]);
}

/// The numbers are Box and Muller's of the first words of the item's generator, to the precision of f32.
#[test]
fn numbers_are_those_of_the_items_own_generator() {
    for first in [0, 1000, u32::MAX - 63] {
        let [a, b, c] = draw().normals(first);
        for (i, ((a, b), c)) in a.iter().zip(b).zip(c).enumerate() {
            let mut generator = draw().item(first + i as u32);
            let mut pair = || {
                let u = (f64::from(generator.next_u32() >> 1) + 0.5) / 2_f64.powi(31);
                let angle = f64::from(generator.next_u32()) / 2_f64.powi(32) * std::f64::consts::TAU;
                let radius = (-2.0 * u.ln()).sqrt();
                [radius * angle.cos(), radius * angle.sin()]
            };
            let [expected_a, expected_b] = pair();
            let [expected_c, _] = pair();
            for (got, expected) in [(*a, expected_a), (b, expected_b), (c, expected_c)] {
                assert!((f64::from(got) - expected).abs() < 1e-6, "{got}, expected {expected}");
            }
        }
    }
    // The textbook's density at 0, so that the reference above isn't the same mistake twice.
    let near_zero = sample(1).iter().filter(|v| v.abs() < 0.1).count() as f64 / N as f64;
    assert!((near_zero / 0.2 / Normal::standard().pdf(0.0) - 1.0).abs() < 0.03);
}
