use thiserror::Error;

use crate::elementary::exp_nonpositive;
use crate::lanes::{all_below_infinity, greatest_sum, lane_sums};

/// Reasons for which weights can't be updated. The weights are then unchanged.
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

/// Particles per batch; a batch's intermediate results stay in the first-level cache.
const RUN: usize = 512;

/// Normalized importance weights of a particle set, with their logs and statistics.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// Log of each weight over the greatest weight.
    log_ratio: Vec<f64>,
    linear: Vec<f64>,
    /// Log of the greatest weight.
    log_greatest: f64,
    /// Index of the greatest weight, the first among equals; 0 for an empty set.
    heaviest: usize,
    effective_sample_size: f64,
}

impl Weights {
    /// `n` equal weights.
    pub fn uniform(n: usize) -> Self {
        let mut weights = Self {
            log_ratio: Vec::new(),
            linear: Vec::new(),
            log_greatest: 0.0,
            heaviest: 0,
            effective_sample_size: 0.0,
        };
        weights.reset(n);
        weights
    }

    /// Makes the weights `n` equal ones; keeps its buffers.
    pub fn reset(&mut self, n: usize) {
        let weight = 1.0 / n.max(1) as f64;
        self.linear.clear();
        self.linear.resize(n, weight);
        self.log_ratio.clear();
        self.log_ratio.resize(n, 0.0);
        self.log_greatest = weight.ln();
        self.heaviest = 0;
        self.effective_sample_size = n as f64;
    }

    /// Multiplies each weight by exp(`log_likelihood`) and normalizes. A weight below exp(-708) of the greatest
    /// becomes 0; its log lives on.
    ///
    /// Returns the log of the weighted mean likelihood, `ln sum_i w_i exp(l_i)`: the step's share of the log
    /// evidence, `ln p(z_t | z_1..t-1)` (nats).
    ///
    /// # Errors
    /// [`WeightError`]; the weights are then unchanged.
    pub fn update(&mut self, log_likelihood: &[f64]) -> Result<f64, WeightError> {
        if log_likelihood.len() != self.log_ratio.len() {
            return Err(WeightError::Length { expected: self.log_ratio.len(), got: log_likelihood.len() });
        }
        let (highest, heaviest) = self.highest(log_likelihood)?;
        let (mut sum, mut squares) = (0.0, 0.0);
        let runs = self.log_ratio.chunks_mut(RUN).zip(self.linear.chunks_mut(RUN));
        for ((log_ratio, linear), l) in runs.zip(log_likelihood.chunks(RUN)) {
            for ((log_ratio, linear), l) in log_ratio.iter_mut().zip(linear.iter_mut()).zip(l) {
                *log_ratio = *log_ratio + l - highest;
                *linear = exp_nonpositive(*log_ratio);
            }
            let [part, part_squares] = lane_sums(linear, |w| [w, w * w]);
            sum += part;
            squares += part_squares;
        }
        let share = 1.0 / sum;
        for linear in &mut self.linear {
            *linear *= share;
        }
        let log_mean = self.log_greatest + highest + sum.ln();
        self.log_greatest = share.ln();
        self.heaviest = heaviest;
        self.effective_sample_size = sum * sum / squares;
        Ok(log_mean)
    }

    /// The log of the weighted mean likelihood alone, as [`update`](Self::update) returns it (nats); minus infinity where every particle has
    /// likelihood zero, or one has none that is a number below infinity.
    pub fn log_mean(&self, log_likelihood: &[f64]) -> f64 {
        let Ok((highest, _)) = self.highest(log_likelihood) else { return f64::NEG_INFINITY };
        let terms = self.log_ratio.iter().zip(log_likelihood);
        let sum: f64 = terms.map(|(log_ratio, l)| exp_nonpositive(log_ratio + l - highest)).sum();
        self.log_greatest + highest + sum.ln()
    }

    /// The greatest sum of log ratio and log likelihood, and where it stands first.
    fn highest(&self, log_likelihood: &[f64]) -> Result<(f64, usize), WeightError> {
        let (mut highest, mut best_run) = (f64::NEG_INFINITY, 0);
        for (run, (log_ratio, l)) in self.log_ratio.chunks(RUN).zip(log_likelihood.chunks(RUN)).enumerate() {
            if !all_below_infinity(l) {
                let within = l.iter().position(|l| !all_below_infinity(&[*l])).unwrap_or(0);
                return Err(WeightError::NotANumber { particle: run * RUN + within });
            }
            let greatest = greatest_sum(log_ratio, l);
            if greatest > highest {
                (highest, best_run) = (greatest, run * RUN);
            }
        }
        if highest == f64::NEG_INFINITY {
            return Err(WeightError::AllZero);
        }
        let mut sums =
            self.log_ratio[best_run..].iter().zip(&log_likelihood[best_run..]).map(|(log, l)| log + l);
        Ok((highest, best_run + sums.position(|sum| sum == highest).unwrap_or(0)))
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

    /// Natural logs of the weights, in order.
    pub fn log(&self) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.log_ratio.iter().map(|ratio| ratio + self.log_greatest)
    }

    /// Effective sample size 1 / sum of squared weights (Kong, Liu and Wong 1994), from 1 to n.
    pub fn effective_sample_size(&self) -> f64 {
        self.effective_sample_size
    }

    /// Index of the greatest weight, the first among equals; `None` for an empty set.
    pub fn argmax(&self) -> Option<usize> {
        (!self.is_empty()).then_some(self.heaviest)
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

    /// Two updates by the definitions, over several runs and with impossible particles among them.
    #[test]
    fn updates_multiply_and_normalize() {
        for n in [1, 7, RUN, RUN + 1, 5 * RUN + 13] {
            let mut weights = Weights::uniform(n);
            let mut expected = vec![1.0 / n as f64; n];
            for round in 0..2 {
                let l: Vec<f64> = (0..n)
                    .map(|i| {
                        if i % 5 == 4 { f64::NEG_INFINITY } else { ((i * 7919 + round) % 1009) as f64 / 50.0 }
                    })
                    .collect();
                let products: Vec<f64> = expected.iter().zip(&l).map(|(w, l)| w * l.exp()).collect();
                let evidence: f64 = products.iter().sum();
                expected = products.iter().map(|p| p / evidence).collect();
                let got = weights.update(&l).unwrap();
                assert!((got - evidence.ln()).abs() < 1e-9, "{n}: {got}, expected {}", evidence.ln());
            }
            for ((got, log), expected) in weights.linear().iter().zip(weights.log()).zip(&expected) {
                assert!((got - expected).abs() <= 1e-12 * expected, "{n}: {got}, expected {expected}");
                assert!(log == expected.ln() || (log - expected.ln()).abs() < 1e-9);
            }
            let first_greatest = (0..n).reduce(|best, i| if expected[i] > expected[best] { i } else { best });
            assert_eq!(weights.argmax(), first_greatest);
            let squares: f64 = expected.iter().map(|w| w * w).sum();
            assert!((weights.effective_sample_size() * squares - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn the_first_of_the_greatest_is_found_in_any_run() {
        let n = 3 * RUN + 5;
        for best in [0, 1, RUN - 1, RUN, 2 * RUN + 3, n - 2] {
            let mut weights = Weights::uniform(n);
            let mut l = vec![0.0; n];
            (l[best], l[n - 1]) = (1.0, 1.0);
            weights.update(&l).unwrap();
            assert_eq!(weights.argmax(), Some(best));
        }
        assert_eq!((Weights::uniform(3).argmax(), Weights::uniform(0).argmax()), (Some(0), None));
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
