use serde::Serialize;

use crate::FilterError;
use crate::error::check;

/// Random particles while observations are less likely than they used to be (augmented MCL, Probabilistic
/// Robotics, table 8.3).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct InjectionOptions {
    /// Decay rate of the long-term average likelihood: above 0, below `alpha_fast`.
    pub alpha_slow: f64,
    /// Decay rate of the short-term average likelihood: above `alpha_slow`, at most 1.
    pub alpha_fast: f64,
}

/// The two running averages of augmented MCL.
///
/// The likelihood of a scan is a product over its beams: it under- and overflows, and a step of a few beams more
/// or less changes its scale. The averages are therefore of the evidence per beam, `w_avg = exp(ln p(z) / K)`
/// for K usable beams: the geometric mean of the beams' likelihoods, formed from the log evidence
/// `ln p(z) = ln sum_i w_i p(z | x_i)`, which is stable. As a ratio per beam the injected share answers less
/// sharply than the table's would, and random particles, which lower ln p(z) by ln 2 at most when they are half
/// of the set, cannot drive it up by themselves.
#[derive(Clone, Debug)]
pub struct Augmented {
    options: InjectionOptions,
    /// `[w_slow, w_fast]`, once there was an observation.
    averages: Option<[f64; 2]>,
}

impl Augmented {
    /// Starts without an average.
    ///
    /// # Errors
    /// [`FilterError::Option`] unless 0 < `alpha_slow` < `alpha_fast` <= 1.
    pub fn new(options: InjectionOptions) -> Result<Self, FilterError> {
        let InjectionOptions { alpha_slow, alpha_fast } = options;
        check("alpha_slow", alpha_slow, alpha_slow > 0.0 && alpha_slow < 1.0, "between 0 and 1")?;
        check(
            "alpha_fast",
            alpha_fast,
            alpha_fast > alpha_slow && alpha_fast <= 1.0,
            "above alpha_slow and at most 1",
        )?;
        Ok(Self { options, averages: None })
    }

    /// Begins again without an average.
    pub fn restart(&mut self) {
        self.averages = None;
    }

    /// Takes in one step's log evidence (nats) of `beams` usable beams and returns the share of particles to
    /// replace by random ones, `max(0, 1 - w_fast / w_slow)`: 0 without usable beams and at the first step. A
    /// log evidence of minus infinity (every particle impossible) counts as `w_avg` = 0.
    pub fn update(&mut self, log_evidence: f64, beams: usize) -> f64 {
        if beams == 0 {
            return 0.0;
        }
        let average = (log_evidence / beams as f64).exp();
        let [slow, fast] = self.averages.get_or_insert([average; 2]);
        *slow += self.options.alpha_slow * (average - *slow);
        *fast += self.options.alpha_fast * (average - *fast);
        if *slow > 0.0 { (1.0 - *fast / *slow).max(0.0) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn augmented() -> Augmented {
        Augmented::new(InjectionOptions { alpha_slow: 0.01, alpha_fast: 0.5 }).unwrap()
    }

    #[test]
    fn the_share_follows_table_8_3() {
        let mut augmented = augmented();
        // 4 beams of likelihood 2 each, then of 1 each.
        assert_eq!(augmented.update(4.0 * 2.0_f64.ln(), 4), 0.0);
        let share = augmented.update(0.0, 4);
        let (slow, fast) = (2.0 - 0.01, 1.5);
        assert!((share - (1.0 - fast / slow)).abs() < 1e-12, "{share}");
        let share = augmented.update(0.0, 4);
        let (slow, fast) = (slow - 0.01 * (slow - 1.0), 1.25);
        assert!((share - (1.0 - fast / slow)).abs() < 1e-12, "{share}");
    }

    #[test]
    fn better_observations_inject_nothing() {
        let mut augmented = augmented();
        augmented.update(-10.0, 5);
        assert_eq!(augmented.update(-5.0, 5), 0.0);
    }

    /// exp(-4000) and exp(4000) are 0 and infinity as doubles; per beam they are ordinary numbers.
    #[test]
    fn long_scans_neither_underflow_nor_overflow() {
        for scale in [1.0, -1.0] {
            let mut augmented = augmented();
            augmented.update(scale * 4000.0, 1000);
            let share = augmented.update(scale * 4000.0 - 1000.0 * 2.0_f64.ln(), 1000);
            assert!((share - (1.0 - 0.75 / 0.995)).abs() < 1e-12, "{share}");
        }
    }

    #[test]
    fn impossible_observations_and_blind_scans_have_defined_shares() {
        let mut augmented = augmented();
        assert_eq!(augmented.update(f64::NEG_INFINITY, 4), 0.0, "no average yet to fall below");
        let mut augmented = self::augmented();
        augmented.update(0.0, 4);
        assert_eq!(augmented.update(0.0, 0), 0.0, "no usable beam, no news");
        let share = augmented.update(f64::NEG_INFINITY, 4);
        assert!((share - (1.0 - 0.5 / 0.99)).abs() < 1e-12, "{share}");
    }

    #[test]
    fn rates_are_checked() {
        for (alpha_slow, alpha_fast) in [(0.0, 0.1), (0.1, 0.1), (0.1, 1.1), (f64::NAN, 0.1)] {
            assert!(Augmented::new(InjectionOptions { alpha_slow, alpha_fast }).is_err());
        }
    }
}
