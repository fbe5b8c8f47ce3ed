//! The normal distribution, and the normal noise of a range reading: cut at 0, censored at the maximum range.

use std::sync::LazyLock;

pub(crate) use locsim_core::normal::{cdf, density as pdf};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// 1 / sqrt(2 pi).
const INV_SQRT_TAU: f32 = 0.398_942_3;

/// Standard deviations beyond which a normal distribution has less mass (1e-9) than f32 resolves.
const FAR: f64 = 6.0;

/// Standard normal distribution function from a table: monotone, within 1e-6 of [`cdf`] and much faster.
pub(crate) fn quick_cdf(t: f32) -> f32 {
    const PER_UNIT: f32 = 256.0;
    static TABLE: LazyLock<Vec<f32>> = LazyLock::new(|| {
        let steps = (2.0 * FAR * f64::from(PER_UNIT)) as usize;
        (0..=steps).map(|i| cdf(i as f64 / f64::from(PER_UNIT) - FAR) as f32).collect()
    });
    let at = (t + FAR as f32) * PER_UNIT;
    if at <= 0.0 {
        return 0.0;
    }
    let i = at as usize;
    match TABLE.get(i..) {
        Some(&[a, b, ..]) => a + (at - i as f32) * (b - a),
        _ => 1.0,
    }
}

/// A normal distribution of readings around `mean` \[m\]: conditioned on being at least 0, and everything at
/// or beyond the maximum range reported as the maximum range.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RangeNormal {
    pub mean: f32,
    pub sigma: f32,
}

impl RangeNormal {
    /// Share of the uncut distribution that is at least 0.
    fn kept(self) -> f32 {
        quick_cdf(self.mean / self.sigma).max(f32::MIN_POSITIVE)
    }

    /// Density at `z` below the maximum range \[1/m\].
    pub fn density(self, z: f32) -> f32 {
        let t = (z - self.mean) / self.sigma;
        INV_SQRT_TAU * (-0.5 * t * t).exp() / (self.sigma * self.kept())
    }

    /// ln(`weight` * [`RangeNormal::density`]) without its underflow.
    pub fn log_density(self, weight: f32, z: f32) -> f32 {
        let t = (z - self.mean) / self.sigma;
        -0.5 * t * t + (weight * INV_SQRT_TAU / (self.sigma * self.kept())).ln()
    }

    /// P(reading <= `z`) below the maximum range.
    pub fn cdf(self, z: f32) -> f32 {
        let kept = self.kept();
        (quick_cdf((z - self.mean) / self.sigma) - (1.0 - kept)) / kept
    }

    /// Probability of the maximum range.
    pub fn at(self, max_range: f32) -> f32 {
        let t = (f64::from(self.mean) - f64::from(max_range)) / f64::from(self.sigma);
        if t < -2.0 * FAR { 0.0 } else { cdf(t) as f32 / self.kept() }
    }

    /// A draw, at least 0 and at most the maximum range.
    pub fn sample(self, max_range: f32, rng: &mut dyn Rng) -> f32 {
        loop {
            let t: f32 = StandardNormal.sample(rng);
            let z = self.mean + self.sigma * t;
            if z >= 0.0 {
                return z.min(max_range);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quick_distribution_function_is_near_the_exact_one_and_monotone() {
        let mut last = 0.0;
        for i in -80_000..80_000 {
            let t = i as f32 * 1e-4;
            let p = quick_cdf(t);
            assert!((f64::from(p) - cdf(f64::from(t))).abs() < 1e-6, "at {t}");
            assert!(p >= last);
            last = p;
        }
    }
}
