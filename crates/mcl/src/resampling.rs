use std::fmt::Debug;

use locsim_core::{Draw, Weights};
use rand::RngExt;

/// Chooses which particles live on.
///
/// Every scheme here is unbiased (particle i of weight w_i has `count * w_i` expected copies), takes time
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

/// floor(`count * w_i`) certain copies each, and multinomial draws from what is left of each weight (Liu and
/// Chen 1998).
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
        let u: f64 = draw.item(0).random();
        invert(weights.linear(), (0..count).map(|i| (i as f64 + u) / count as f64), out);
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
/// the remaining numbers on what is left of the interval (Bentley and Saxe 1980).
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
