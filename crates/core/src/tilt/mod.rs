//! A standard normal number in bins, under tilts of its first moments: their probabilities are multiplied by exp(t x), exp(t (x^2 - 1)) and
//! exp(t (x^3 - 3 x)), the Hermite polynomials, so that small tilts are orthogonal.

mod looks;
mod outcome;

use std::sync::LazyLock;

use crate::elementary::exp_nonpositive;
use crate::normal;

pub use looks::Looks;
pub use outcome::{Class, Look, MOMENTS_OF_READING, Outcome, SHARES, Tilt};

/// Moments that are tilted: mean, spread and skewness.
pub const MOMENTS: usize = 3;
/// The bins reach to this on both sides (standard deviations): noise alone brings 6 in 10^5 farther.
pub const NEAR: f64 = 4.0;
/// Edges of the bins (standard deviations). Finer ones would add 1 % to what the mean says.
const EDGES: [f64; 14] = [-NEAR, -3.0, -2.25, -1.5, -1.0, -0.6, -0.2, 0.2, 0.6, 1.0, 1.5, 2.25, 3.0, NEAR];
/// Number of bins.
pub const BINS: usize = EDGES.len() - 1;
/// The largest tilt.
pub const MOST: f64 = 14.0;

/// The bins of a standard normal number.
pub struct Bins {
    /// Their probabilities.
    pub weight: [f64; BINS],
    /// Mean of each moment's polynomial in each bin.
    pub basis: [[f64; MOMENTS]; BINS],
    /// The same by moment.
    of_moments: [[f64; BINS]; MOMENTS],
    /// The same with their squares after them.
    pub squares: [[f64; 2 * MOMENTS]; BINS],
}

impl Bins {
    fn new() -> Self {
        let (mut weight, mut basis) = ([0.0; BINS], [[0.0; MOMENTS]; BINS]);
        for (bin, edges) in EDGES.windows(2).enumerate() {
            let [a, b] = [edges[0], edges[1]];
            let [at_a, at_b] = [a, b].map(normal::density);
            let share = normal::cdf(b) - normal::cdf(a);
            // The integral of a Hermite polynomial times the density is minus the one before it times the density.
            basis[bin] = [
                (at_a - at_b) / share,
                (a * at_a - b * at_b) / share,
                ((a * a - 1.0) * at_a - (b * b - 1.0) * at_b) / share,
            ];
            weight[bin] = share;
        }
        let of_moments = std::array::from_fn(|moment| basis.map(|of_bin| of_bin[moment]));
        let squares =
            basis.map(|[mean, spread, skew]| [mean, spread, skew, mean * mean, spread * spread, skew * skew]);
        Self { weight, basis, of_moments, squares }
    }
}

/// The bins, which are the same for all.
#[must_use]
pub fn bins() -> &'static Bins {
    static OF_NORMAL: LazyLock<Bins> = LazyLock::new(Bins::new);
    &OF_NORMAL
}

/// The bin of a number by its cumulative probability among those that the bins reach.
#[must_use]
pub fn bin_of(u: f64) -> u8 {
    static CDF: LazyLock<[f64; EDGES.len()]> = LazyLock::new(|| EDGES.map(normal::cdf));
    let [first, last] = [-NEAR, NEAR].map(normal::cdf);
    let at = first + u * (last - first);
    CDF[1..BINS].partition_point(|&edge| edge <= at) as u8
}

/// Probability that the bins reach a standard normal number.
#[must_use]
pub fn share_within() -> f64 {
    normal::cdf(NEAR) - normal::cdf(-NEAR)
}

/// Probabilities of the bins under tilts, of which the first [`MOMENTS`] count.
#[must_use]
pub fn tilted(tilts: &[f64]) -> [f64; BINS] {
    let Bins { weight, of_moments, .. } = bins();
    let mut shares = *weight;
    if tilts.iter().take(MOMENTS).any(|tilt| *tilt != 0.0) {
        let mut powers = [0.0; BINS];
        for (basis, tilt) in of_moments.iter().zip(tilts) {
            let tilt = tilt.clamp(-MOST, MOST);
            powers.iter_mut().zip(basis).for_each(|(power, b)| *power += b * tilt);
        }
        let most = powers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        shares.iter_mut().zip(powers).for_each(|(share, power)| *share *= exp_nonpositive(power - most));
    }
    let total: f64 = shares.iter().sum();
    shares.map(|share| share / total)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tilt of the mean by t moves a normal number by t; one of the spread by t makes its variance 1 / (1 - 2 t). Bins are coarse.
    #[test]
    fn tilts_change_mean_and_spread() {
        let moments = |tilts: [f64; 3]| {
            let shares = tilted(&tilts);
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let mean =
                |of: usize| shares.iter().zip(&bins().basis).map(|(p, basis)| p * basis[of]).sum::<f64>();
            [mean(0), mean(1) + 1.0 - mean(0).powi(2)]
        };
        let [mean, _] = moments([0.0; 3]);
        assert!(mean.abs() < 1e-12);
        let [mean, _] = moments([0.5, 0.0, 0.0]);
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
        let [_, variance] = moments([0.0, 0.1, 0.0]);
        assert!((variance - 1.0 / 0.8).abs() < 0.05, "{variance}");
    }

    #[test]
    fn numbers_fall_into_bins_as_often_as_they_weigh() {
        let mut counts = [0_u32; BINS];
        let n = 100_000;
        (0..n).for_each(|i| counts[usize::from(bin_of((f64::from(i) + 0.5) / f64::from(n)))] += 1);
        for (count, weight) in counts.iter().zip(&bins().weight) {
            let share = f64::from(*count) / f64::from(n);
            assert!((share - weight / share_within()).abs() < 1e-4, "{share} {weight}");
        }
    }
}
