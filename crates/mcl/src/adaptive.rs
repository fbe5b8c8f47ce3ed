use std::collections::HashSet;

use locsim_core::Pose2;
use statrs::distribution::{ContinuousCDF, Normal};

use crate::FilterError;
use crate::bins::{BinKey, PoseBins};
use crate::error::{check, check_positive};

/// KLD sampling (Fox 2003; Probabilistic Robotics, table 8.4): as many particles as keep the Kullback-Leibler
/// distance between the sampled and the true posterior, both as histograms, below a bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KldOptions {
    /// Least number of particles.
    pub min: usize,
    /// Greatest number of particles, and the number a filter starts with.
    pub max: usize,
    /// Bound epsilon on the Kullback-Leibler distance (nats).
    pub error: f64,
    /// Probability 1 - delta with which the bound holds.
    pub quantile: f64,
    /// The histogram.
    pub bins: PoseBins,
}

/// Finds the sample size of [`KldOptions`].
#[derive(Clone, Debug)]
pub struct KldSampler {
    options: KldOptions,
    /// Upper 1 - delta quantile of the standard normal distribution.
    z: f64,
    occupied: HashSet<BinKey>,
}

impl KldSampler {
    /// Checks the options.
    ///
    /// # Errors
    /// [`FilterError::Option`] unless 1 <= min <= max, error > 0 and 0.5 <= quantile < 1.
    pub fn new(options: KldOptions) -> Result<Self, FilterError> {
        let KldOptions { min, max, error, quantile, .. } = options;
        check("least particle count", min as f64, min >= 1, "at least 1")?;
        check("greatest particle count", max as f64, max >= min, "at least the least one")?;
        check_positive("KLD error", error)?;
        check("KLD quantile", quantile, (0.5..1.0).contains(&quantile), "at least 0.5 and below 1")?;
        Ok(Self { options, z: Normal::standard().inverse_cdf(quantile), occupied: HashSet::new() })
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
            if self.occupied.insert(self.options.bins.key(&pose()?)) {
                enough = self.sample_size(self.occupied.len());
            }
            drawn += 1;
        }
        Ok(drawn)
    }
}
