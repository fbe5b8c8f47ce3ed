use std::fmt::Debug;

use locsim_core::{Draw, Weights};
use rand::RngExt;

/// Chooses the particles that survive.
///
/// Every scheme here is unbiased (particle i of weight `w_i` has `count * w_i` expected copies), takes time
/// linear in the numbers of particles and copies, never chooses a particle of weight zero, and returns the
/// ancestors in increasing order. Douc, Cappe and Moulines (2005) compare the schemes.
pub trait Resampler: Debug + Send + Sync {
    /// Fills `out` (cleared first) with the index of the ancestor of each of `count` new particles; draws from
    /// `draw.item(0)`. `out` stays empty where there are no weights.
    fn ancestors(&self, weights: &Weights, count: usize, draw: &Draw, out: &mut Vec<u32>);
}

/// Independent draws: the copies are multinomial (Gordon, Salmond and Smith 1993). The greatest variance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Multinomial;

/// One draw for a comb of equally spaced points (Kitagawa 1996; the low variance sampler of Probabilistic
/// Robotics, table 4.4): particle i has floor or ceil of `count * w_i` copies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Systematic;

/// One draw in each of `count` equal strata (Kitagawa 1996).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stratified;

/// floor(`count * w_i`) certain copies each, and multinomial draws from the remainders of the weights (Liu and Chen
/// 1998).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Residual;

impl Resampler for Multinomial {
    fn ancestors(&self, weights: &Weights, count: usize, draw: &Draw, out: &mut Vec<u32>) {
        let mut rng = draw.item(0);
        invert(weights.linear(), SortedUniforms::new(count, || rng.random()), out);
    }
}

impl Resampler for Systematic {
    fn ancestors(&self, weights: &Weights, count: usize, draw: &Draw, out: &mut Vec<u32>) {
        // How many copies a particle has can't be predicted, and a mistaken branch costs more than all else. So
        // each particle writes this many; surplus copies are overwritten by the next particle.
        const ROOM: usize = 4;
        // The points are k + 1 - u, for whole k, on the scale where the weights sum to `count`. Up to a cumulative
        // weight c there are floor(c + u) of them.
        let u: f64 = draw.item(0).random();
        let weights = weights.linear();
        // The sum of the weights may round to below the last point: that one goes to the last possible particle.
        let Some(last) = weights.iter().rposition(|&w| w > 0.0) else { return out.clear() };
        out.resize(count + ROOM, 0);
        let scale = count as f64;
        let (mut cumulative, mut start) = (0.0, 0);
        for (i, weight) in weights[..last].iter().enumerate() {
            cumulative += weight;
            let end = ((cumulative * scale + u) as usize).min(count);
            out[start..start + ROOM].fill(i as u32);
            if end > start + ROOM {
                out[start + ROOM..end].fill(i as u32);
            }
            start = end;
        }
        out.truncate(count);
        out[start..].fill(last as u32);
    }
}

impl Resampler for Stratified {
    fn ancestors(&self, weights: &Weights, count: usize, draw: &Draw, out: &mut Vec<u32>) {
        let mut rng = draw.item(0);
        invert(weights.linear(), (0..count).map(|i| (i as f64 + rng.random::<f64>()) / count as f64), out);
    }
}

impl Resampler for Residual {
    fn ancestors(&self, weights: &Weights, count: usize, draw: &Draw, out: &mut Vec<u32>) {
        out.clear();
        let expected = |w: &f64| w * count as f64;
        let certain: f64 = weights.linear().iter().map(|w| expected(w).floor()).sum();
        let rest: f64 = weights.linear().iter().map(|w| expected(w).fract()).sum();
        let mut rng = draw.item(0);
        let mut uniforms = SortedUniforms::new(count.saturating_sub(certain as usize), || rng.random());
        let mut target = uniforms.next();
        let mut cumulative = 0.0;
        let mut last_positive = 0;
        for (i, w) in weights.linear().iter().enumerate() {
            let expected = expected(w);
            for _ in 0..expected.floor() as usize {
                out.push(i as u32);
            }
            cumulative += expected.fract();
            while target.is_some_and(|u| u * rest < cumulative) {
                out.push(i as u32);
                target = uniforms.next();
            }
            if *w > 0.0 {
                last_positive = i as u32;
            }
        }
        // Only rounding can leave draws behind the last sum, or put one copy too many before it.
        if !weights.is_empty() {
            out.resize(count, last_positive);
        }
    }
}

/// Inverts the cumulative weights at `points`, which increase in [0, 1].
fn invert(weights: &[f64], points: impl Iterator<Item = f64>, out: &mut Vec<u32>) {
    out.clear();
    // The sum of the weights may round to below the last point: that one goes to the last possible particle.
    let Some(last) = weights.iter().rposition(|&w| w > 0.0) else { return };
    let mut i = 0;
    let mut cumulative = weights[0];
    for point in points {
        while cumulative <= point && i < last {
            i += 1;
            cumulative += weights[i];
        }
        out.push(i as u32);
    }
}

/// `count` uniform numbers in increasing order, in linear time: the gaps above the k-th smallest are those of
/// the remaining numbers on the rest of the interval (Bentley and Saxe 1980).
struct SortedUniforms<F> {
    left: usize,
    above: f64,
    uniform: F,
}

impl<F: FnMut() -> f64> SortedUniforms<F> {
    fn new(count: usize, uniform: F) -> Self {
        Self { left: count, above: 1.0, uniform }
    }
}

impl<F: FnMut() -> f64> Iterator for SortedUniforms<F> {
    type Item = f64;

    fn next(&mut self) -> Option<f64> {
        if self.left == 0 {
            return None;
        }
        self.above *= (1.0 - (self.uniform)()).powf(1.0 / self.left as f64);
        self.left -= 1;
        Some(1.0 - self.above)
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::Stage;
    use proptest::prelude::*;
    use statrs::distribution::{ChiSquared, ContinuousCDF};

    use super::*;

    const ALL: [&dyn Resampler; 4] = [&Multinomial, &Systematic, &Stratified, &Residual];

    fn weights(w: &[f64]) -> Weights {
        let mut weights = Weights::uniform(w.len());
        weights.update(&w.iter().map(|w| w.ln()).collect::<Vec<_>>()).unwrap();
        weights
    }

    fn ancestors(scheme: &dyn Resampler, weights: &Weights, count: usize, step: u32) -> Vec<u32> {
        let mut out = vec![77];
        scheme.ancestors(weights, count, &Draw::new(3, Stage::Resample, step), &mut out);
        out
    }

    fn copies(ancestors: &[u32], n: usize) -> Vec<usize> {
        let mut copies = vec![0; n];
        for &a in ancestors {
            copies[a as usize] += 1;
        }
        copies
    }

    /// Mean copies of each particle over many resamplings, and their variances.
    fn moments(scheme: &dyn Resampler, weights: &Weights, count: usize) -> (Vec<f64>, Vec<f64>) {
        let n = weights.len();
        let (mut sum, mut squares) = (vec![0.0; n], vec![0.0; n]);
        for step in 0..RUNS {
            for (i, c) in copies(&ancestors(scheme, weights, count, step), n).into_iter().enumerate() {
                sum[i] += c as f64;
                squares[i] += (c * c) as f64;
            }
        }
        let runs = f64::from(RUNS);
        let mean: Vec<f64> = sum.iter().map(|s| s / runs).collect();
        let variance = squares.iter().zip(&mean).map(|(s, m)| s / runs - m * m).collect();
        (mean, variance)
    }

    const RUNS: u32 = 20_000;
    const W: [f64; 7] = [0.05, 0.2, 0.0, 0.33, 0.07, 0.15, 0.2];

    /// Pearson's statistic of the copies of all runs, and its quantile for a false-alarm probability of 1e-6.
    /// The multinomial scheme's copies of all runs are one multinomial sample, so that the statistic is
    /// chi-square with one degree of freedom less than there are particles of positive weight. The copies of the
    /// other schemes vary less, so that the bound holds for them all the more.
    fn chi_square(mean: &[f64], w: &[f64], count: usize) -> (f64, f64) {
        let positive = w.iter().filter(|w| **w > 0.0).count();
        let statistic = mean
            .iter()
            .zip(w)
            .filter(|(_, w)| **w > 0.0)
            .map(|(mean, w)| {
                let expected = count as f64 * w;
                f64::from(RUNS) * (mean - expected).powi(2) / expected
            })
            .sum();
        let bound = ChiSquared::new((positive - 1) as f64).unwrap().inverse_cdf(1.0 - 1e-6);
        (statistic, bound)
    }

    #[test]
    fn every_scheme_is_unbiased() {
        let weights = weights(&W);
        for scheme in ALL {
            for count in [7, 3, 20] {
                let (mean, _) = moments(scheme, &weights, count);
                let (statistic, bound) = chi_square(&mean, &W, count);
                assert!(statistic < bound, "{scheme:?}, {count}: {statistic} >= {bound}");
            }
        }
    }

    /// Negative control: a bias of one percent of the copies is found.
    #[test]
    fn the_unbiasedness_test_finds_a_small_bias() {
        let mut biased = W;
        biased[3] += 0.01;
        biased[0] -= 0.01;
        let (mean, _) = moments(&Multinomial, &weights(&W), 20);
        let (statistic, bound) = chi_square(&mean, &biased, 20);
        assert!(statistic > bound, "{statistic} <= {bound}");
    }

    /// Multinomial variance is count w (1 - w) exactly: 20,000 runs give it to within 4.9 sqrt((2 + k) / runs), which
    /// is 8 % for an excess kurtosis k of up to 3; here it is below 1. The other schemes have no more than that.
    #[test]
    fn variances_are_those_of_the_schemes() {
        let weights = weights(&W);
        let count = 20;
        let multinomial = W.map(|w| count as f64 * w * (1.0 - w));
        for scheme in ALL {
            let (_, variance) = moments(scheme, &weights, count);
            for (variance, multinomial) in variance.iter().zip(multinomial) {
                assert!(*variance <= 1.08 * multinomial, "{scheme:?}: {variance} > {multinomial}");
            }
        }
        let (_, variance) = moments(&Multinomial, &weights, count);
        for (variance, multinomial) in variance.iter().zip(multinomial) {
            assert!(*variance >= 0.92 * multinomial, "{variance} < {multinomial}");
        }
    }

    proptest! {
        #[test]
        fn ancestors_are_sorted_of_positive_weight_and_as_many_as_asked(
            w in prop::collection::vec(prop_oneof![Just(0.0), 1e-300..1e-200, 0.0..1.0f64], 1..60),
            extra in 1e-3..1.0f64, count in 0..200usize, step in 0..1000u32,
        ) {
            let mut w = w;
            w.push(extra);
            let weights = weights(&w);
            for scheme in ALL {
                let ancestors = ancestors(scheme, &weights, count, step);
                prop_assert_eq!(ancestors.len(), count);
                prop_assert!(ancestors.is_sorted());
                prop_assert!(ancestors.iter().all(|&a| weights.linear()[a as usize] > 0.0));
            }
        }

        #[test]
        fn copies_stay_within_what_each_scheme_guarantees(
            w in prop::collection::vec(0.0..1.0f64, 2..60), count in 1..200usize, step in 0..1000u32,
        ) {
            let weights = weights(&w);
            let copies_of = |scheme| copies(&ancestors(scheme, &weights, count, step), w.len());
            let [systematic, stratified, residual] = [&Systematic as &dyn Resampler, &Stratified, &Residual].map(copies_of);
            for (i, w) in weights.linear().iter().enumerate() {
                let expected = w * count as f64;
                // 1e-9: where a sum of weights rounds across a whole number.
                prop_assert!((systematic[i] as f64 - expected).abs() < 1.0 + 1e-9);
                prop_assert!((stratified[i] as f64 - expected).abs() < 2.0 + 1e-9);
                prop_assert!(residual[i] as f64 >= (expected - 1e-9).floor());
            }
        }
    }

    #[test]
    fn a_single_survivor_is_everybodys_ancestor_and_no_weights_have_no_ancestors() {
        for scheme in ALL {
            assert_eq!(ancestors(scheme, &weights(&[0.0, 0.0, 1.0, 0.0]), 5, 0), [2; 5], "{scheme:?}");
            assert!(ancestors(scheme, &Weights::uniform(0), 5, 0).is_empty(), "{scheme:?}");
        }
    }

    #[test]
    fn equal_weights_keep_every_particle_under_systematic_stratified_and_residual() {
        let n = 1000;
        let everybody: Vec<u32> = (0..n).collect();
        for scheme in [&Systematic as &dyn Resampler, &Residual] {
            assert_eq!(
                ancestors(scheme, &Weights::uniform(n as usize), n as usize, 9),
                everybody,
                "{scheme:?}"
            );
        }
    }
}
