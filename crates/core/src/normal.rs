//! The standard normal distribution.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use statrs::function::erf::erfc;

use crate::elementary::exp_nonpositive;

/// Standard deviation over median absolute deviation (Hampel 1974).
pub const SIGMA_OVER_MAD: f64 = 1.4826;

/// 97.5 % quantile, to two decimals: the half-width of a 95 % interval in standard deviations.
pub const QUANTILE_975: f64 = 1.96;

/// Density at `t`.
#[inline]
pub fn density(t: f64) -> f64 {
    exp_nonpositive(-0.5 * t * t) / (2.0 * PI).sqrt()
}

/// P(N(0, 1) <= `t`).
#[inline]
pub fn cdf(t: f64) -> f64 {
    tail(-t)
}

/// P(N(0, 1) > `t`). The error is below 1e-10 of the value, in the far tail too.
#[inline]
pub fn tail(t: f64) -> f64 {
    0.5 * erfc(t * FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles of printed tables (Abramowitz and Stegun, table 26.1); the density is the slope of the distribution function.
    #[test]
    fn tails_are_those_of_the_tables() {
        for (t, p) in [(0.0, 0.5), (1.0, 0.158_655_253_931_457), (3.0, 1.349_898_031_630_1e-3)] {
            assert!((tail(t) / p - 1.0).abs() < 1e-10 && tail(t) == cdf(-t), "{t}: {}", tail(t));
        }
        assert!((tail(10.0) / 7.619_853_024_160_5e-24 - 1.0).abs() < 1e-10, "{}", tail(10.0));
        for t in [-2.0, 0.3, 1.7] {
            let slope = (cdf(t + 1e-4) - cdf(t - 1e-4)) / 2e-4;
            assert!((density(t) - slope).abs() < 1e-8, "{t}");
        }
    }
}
