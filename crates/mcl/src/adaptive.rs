use std::collections::HashSet;

use locsim_core::{Pose2, Weights};
use rand::{Rng, RngExt};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal};

use crate::FilterError;
use crate::bins::{BinKey, PoseBins};
use crate::error::{check, check_positive};

/// KLD sampling (Fox 2003; Probabilistic Robotics, table 8.4): as many particles as keep the Kullback-Leibler
/// distance between the sampled and the true posterior, both as histograms, below a bound.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct KldOptions {
    /// Least number of particles.
    pub min: usize,
    /// Greatest number of particles, and the number a filter starts with.
    pub max: usize,
    /// Bound epsilon on the Kullback-Leibler distance (nats).
    pub error: f64,
    /// Probability 1 - delta with which the bound holds.
    pub quantile: f64,
    /// Side of a histogram bin (m).
    pub bin_m: f64,
    /// Heading width of a histogram bin (rad).
    pub bin_rad: f64,
}

/// Finds the sample size of [`KldOptions`].
#[derive(Clone, Debug)]
pub struct KldSampler {
    options: KldOptions,
    bins: PoseBins,
    /// Upper 1 - delta quantile of the standard normal distribution.
    z: f64,
    occupied: HashSet<BinKey>,
}

impl KldSampler {
    /// Checks the options.
    ///
    /// # Errors
    /// [`FilterError::Option`] unless 1 <= min <= max, error > 0, 0.5 <= quantile < 1, and as [`PoseBins::new`].
    pub fn new(options: KldOptions) -> Result<Self, FilterError> {
        let KldOptions { min, max, error, quantile, bin_m, bin_rad } = options;
        check("least particle count", min as f64, min >= 1, "at least 1")?;
        check("greatest particle count", max as f64, max >= min, "at least the least one")?;
        check_positive("KLD error", error)?;
        check("KLD quantile", quantile, (0.5..1.0).contains(&quantile), "at least 0.5 and below 1")?;
        let z = Normal::standard().inverse_cdf(quantile);
        Ok(Self { options, bins: PoseBins::new(bin_m, bin_rad)?, z, occupied: HashSet::new() })
    }

    /// Sample size n for `k` occupied bins: the chi-square quantile with k - 1 degrees of freedom over
    /// 2 epsilon, by the approximation of Wilson and Hilferty, within the options' limits.
    pub fn sample_size(&self, k: usize) -> usize {
        let KldOptions { min, max, error, .. } = self.options;
        if k < 2 {
            return min;
        }
        let freedom = (k - 1) as f64;
        let b = 2.0 / (9.0 * freedom);
        let n = freedom / (2.0 * error) * (1.0 - b + b.sqrt() * self.z).powi(3);
        (n.ceil() as usize).clamp(min, max)
    }

    /// Least number of particles.
    pub(crate) fn least(&self) -> usize {
        self.options.min
    }

    /// Draws poses until there are as many as the bins they occupy ask for; returns that number. `pose` draws
    /// from the distribution that is going to be resampled.
    ///
    /// # Errors
    /// Only those of `pose`.
    pub fn draw<E>(&mut self, mut pose: impl FnMut() -> Result<Pose2, E>) -> Result<usize, E> {
        self.occupied.clear();
        let mut enough = self.options.min;
        let mut drawn = 0;
        while drawn < enough {
            if self.occupied.insert(self.bins.key(&pose()?)) {
                enough = self.sample_size(self.occupied.len());
            }
            drawn += 1;
        }
        Ok(drawn)
    }
}

/// Draws particles one by one, each as often as its weight says.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lots {
    cumulative: Vec<f64>,
}

impl Lots {
    /// Takes over the weights of a set, which isn't empty.
    pub fn prepare(&mut self, weights: &Weights) {
        self.cumulative.clear();
        self.cumulative.extend(weights.linear().iter().scan(0.0, |sum, w| {
            *sum += w;
            Some(*sum)
        }));
    }

    /// The number of a particle.
    pub fn draw(&self, rng: &mut impl Rng) -> usize {
        let u: f64 = rng.random();
        self.cumulative.partition_point(|&c| c <= u).min(self.cumulative.len() - 1)
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Stage};
    use rand::RngExt;
    use statrs::distribution::ChiSquared;

    use super::*;

    fn options() -> KldOptions {
        let bin_rad = 10_f64.to_radians();
        KldOptions { min: 10, max: 1_000_000, error: 0.05, quantile: 0.99, bin_m: 0.5, bin_rad }
    }

    /// Wilson and Hilferty's approximation is within 1 % of the exact chi-square quantile from 3 degrees of
    /// freedom on.
    #[test]
    fn sample_sizes_are_chi_square_quantiles() {
        let sampler = KldSampler::new(options()).unwrap();
        for k in [4, 10, 100, 1000] {
            let exact = ChiSquared::new((k - 1) as f64).unwrap().inverse_cdf(0.99) / (2.0 * 0.05);
            let got = sampler.sample_size(k) as f64;
            assert!((got / exact - 1.0).abs() < 0.01, "{k} bins: {got}, exact {exact}");
        }
        // By hand, for k = 11: 100 (1 - 0.0222222 + 0.1490712 * 2.3263479)^3 = 232.16.
        assert_eq!(sampler.sample_size(11), 233);
    }

    #[test]
    fn sample_sizes_stay_within_their_limits() {
        let sampler = KldSampler::new(KldOptions { min: 100, max: 200, ..options() }).unwrap();
        assert_eq!([0, 1, 2, 11, 1000].map(|k| sampler.sample_size(k)), [100, 100, 100, 200, 200]);
    }

    #[test]
    fn drawing_stops_when_the_bins_found_ask_for_no_more() {
        let mut sampler = KldSampler::new(options()).unwrap();
        let mut draw_over = |bins: f64| {
            let mut rng = Draw::new(1, Stage::Resample, 0).item(0);
            sampler.draw(|| Ok::<_, ()>(Pose2::new(bins * 0.5 * rng.random::<f64>(), 0.1, 0.1))).unwrap()
        };
        assert_eq!(draw_over(1.0), 10, "one bin: the least number");
        // 50 equally likely bins: with 750 draws, one is missed with probability 50 exp(-15) = 1.5e-5 at most,
        // and this seed misses none.
        let fifty = draw_over(50.0);
        assert_eq!(fifty, KldSampler::new(options()).unwrap().sample_size(50));
        assert_eq!(draw_over(50.0), fifty, "bins found before are forgotten");
        assert_eq!(sampler.draw(|| Err("no pose")), Err("no pose"));
    }

    #[test]
    fn options_are_checked() {
        let bad = [
            KldOptions { min: 0, ..options() },
            KldOptions { min: 10, max: 9, ..options() },
            KldOptions { error: 0.0, ..options() },
            KldOptions { quantile: 1.0, ..options() },
        ];
        assert!(bad.into_iter().all(|options| KldSampler::new(options).is_err()));
    }
}
