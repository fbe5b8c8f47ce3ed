use thiserror::Error;

/// Why weights could not be updated. The weights are unchanged when this is returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum WeightError {
    /// A log likelihood is NaN or plus infinity: a defect of the sensor model, never silently repaired.
    #[error("the log likelihood of particle {particle} is not a number below infinity")]
    NotANumber {
        /// Index of the first such particle.
        particle: usize,
    },
    /// Every particle has likelihood zero: the observation contradicts the whole set.
    #[error("every particle has likelihood zero")]
    AllZero,
    /// The number of log likelihoods is not the number of particles.
    #[error("{got} log likelihoods for {expected} particles")]
    Length {
        /// Number of particles.
        expected: usize,
        /// Number of log likelihoods given.
        got: usize,
    },
}

/// Sums are formed over runs of this many particles, then combined in order, so that a parallel sum and a
/// serial one have the same bits.
const CHUNK: usize = 4096;

/// Normalized importance weights of a particle set, with what follows from them.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    log: Vec<f64>,
    linear: Vec<f64>,
    effective_sample_size: f64,
}

impl Weights {
    /// `n` equal weights.
    pub fn uniform(n: usize) -> Self {
        let mut weights = Self { log: Vec::new(), linear: Vec::new(), effective_sample_size: 0.0 };
        weights.reset(n);
        weights
    }

    /// Makes the weights `n` equal ones; keeps its buffers.
    pub fn reset(&mut self, n: usize) {
        let weight = 1.0 / n.max(1) as f64;
        self.linear.clear();
        self.linear.resize(n, weight);
        self.log.clear();
        self.log.resize(n, weight.ln());
        self.effective_sample_size = n as f64;
    }

    /// Multiplies each weight by exp(`log_likelihood`) and normalizes.
    ///
    /// Returns the log of the weighted mean likelihood, `ln sum_i w_i exp(l_i)`: the step's share of the log
    /// evidence, `ln p(z_t | z_1..t-1)` (nats).
    ///
    /// # Errors
    /// [`WeightError`]; the weights are then unchanged.
    pub fn update(&mut self, log_likelihood: &[f64]) -> Result<f64, WeightError> {
        if log_likelihood.len() != self.log.len() {
            return Err(WeightError::Length { expected: self.log.len(), got: log_likelihood.len() });
        }
        let mut highest = f64::NEG_INFINITY;
        for (i, (log, l)) in self.log.iter().zip(log_likelihood).enumerate() {
            if l.is_nan() || *l == f64::INFINITY {
                return Err(WeightError::NotANumber { particle: i });
            }
            highest = highest.max(log + l);
        }
        if highest == f64::NEG_INFINITY {
            return Err(WeightError::AllZero);
        }
        let mut sum = 0.0;
        let chunks = self.log.chunks_mut(CHUNK).zip(self.linear.chunks_mut(CHUNK));
        for ((log, linear), l) in chunks.zip(log_likelihood.chunks(CHUNK)) {
            let mut part = 0.0;
            for ((log, linear), l) in log.iter_mut().zip(linear).zip(l) {
                *log += l;
                *linear = (*log - highest).exp();
                part += *linear;
            }
            sum += part;
        }
        let log_mean = highest + sum.ln();
        let mut squares = 0.0;
        for (log, linear) in self.log.chunks_mut(CHUNK).zip(self.linear.chunks_mut(CHUNK)) {
            let mut part = 0.0;
            for (log, linear) in log.iter_mut().zip(linear) {
                *log -= log_mean;
                *linear /= sum;
                part += *linear * *linear;
            }
            squares += part;
        }
        self.effective_sample_size = 1.0 / squares;
        Ok(log_mean)
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.linear.len()
    }

    /// No particles at all.
    pub fn is_empty(&self) -> bool {
        self.linear.is_empty()
    }

    /// Weights, summing to 1.
    pub fn linear(&self) -> &[f64] {
        &self.linear
    }

    /// Natural logs of the weights.
    pub fn log(&self) -> &[f64] {
        &self.log
    }

    /// Effective sample size 1 / sum of squared weights (Kong, Liu and Wong 1994), from 1 to n.
    pub fn effective_sample_size(&self) -> f64 {
        self.effective_sample_size
    }

    /// Index of the greatest weight, the first among equals; `None` for an empty set.
    pub fn argmax(&self) -> Option<usize> {
        (0..self.len()).reduce(|best, i| if self.log[i] > self.log[best] { i } else { best })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn weights_are_a_distribution_and_ignore_a_common_factor(
            l in prop::collection::vec(-700.0..700.0f64, 1..40), shift in -1e4..1e4f64,
        ) {
            let mut a = Weights::uniform(l.len());
            let mut b = a.clone();
            let mean_a = a.update(&l).unwrap();
            let mean_b = b.update(&l.iter().map(|l| l + shift).collect::<Vec<_>>()).unwrap();
            prop_assert!((a.linear().iter().sum::<f64>() - 1.0).abs() < 1e-12);
            prop_assert!((mean_b - mean_a - shift).abs() < 1e-6);
            for (a, b) in a.linear().iter().zip(b.linear()) {
                prop_assert!((a - b).abs() < 1e-6);
            }
            prop_assert!(a.effective_sample_size() >= 1.0 - 1e-9);
            prop_assert!(a.effective_sample_size() <= l.len() as f64 + 1e-9);
        }
    }

    #[test]
    fn likelihoods_far_below_the_smallest_double_still_rank() {
        let mut weights = Weights::uniform(2);
        weights.update(&[-2000.0, -2000.0 + 2.0_f64.ln()]).unwrap();
        assert!((weights.linear()[1] - 2.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn nan_and_all_zero_are_errors_that_leave_the_weights_alone() {
        let mut weights = Weights::uniform(2);
        let before = weights.clone();
        assert_eq!(weights.update(&[0.0, f64::NAN]), Err(WeightError::NotANumber { particle: 1 }));
        assert_eq!(weights.update(&[f64::NEG_INFINITY; 2]), Err(WeightError::AllZero));
        assert_eq!(weights.update(&[0.0]), Err(WeightError::Length { expected: 2, got: 1 }));
        assert_eq!(weights, before);
    }
}
