use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

/// A 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower end.
    pub lo: f64,
    /// Upper end.
    pub hi: f64,
}

impl Interval {
    /// From `half` below `value` to `half` above it.
    pub fn around(value: f64, half: f64) -> Self {
        Self { lo: value - half, hi: value + half }
    }

    /// Half of its width.
    pub fn half(&self) -> f64 {
        0.5 * (self.hi - self.lo)
    }

    /// Whether it covers `value`, ends included.
    pub fn contains(&self, value: f64) -> bool {
        self.lo <= value && value <= self.hi
    }

    /// The interval of a function of the value that keeps its order.
    #[must_use]
    pub fn map(self, of: impl Fn(f64) -> f64) -> Self {
        Self { lo: of(self.lo), hi: of(self.hi) }
    }
}

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its interval.
    #[serde(flatten)]
    pub interval: Interval,
}

impl Estimate {
    /// The interval from `half` below the value to `half` above it.
    pub fn around(value: f64, half: f64) -> Self {
        Self { value, interval: Interval::around(value, half) }
    }

    /// An estimate with a normally distributed error of this standard deviation.
    pub fn normal(value: f64, error: f64) -> Self {
        Self::around(value, crate::normal::QUANTILE_975 * error)
    }

    /// The sum of what folds gain, with its normal error over them.
    #[must_use]
    pub fn of_sum(folds: &[f64]) -> Self {
        Self::normal(folds.iter().sum(), crate::sum_error(folds))
    }

    /// The median of values of replicates, with the interval that holds 95 % of them; NaN if a value is.
    #[must_use]
    pub fn of_replicates(mut values: Vec<f64>) -> Self {
        if values.iter().any(|value| value.is_nan()) {
            return Self::around(f64::NAN, 0.0);
        }
        let [lo, value, hi] = [0.025, 0.5, 0.975].map(|share| crate::quantile(&mut values, share));
        Self { value, interval: Interval { lo, hi } }
    }

    /// A fitted value less its bias, with the 95 % interval of its spread, by how far fits to simulated logs are from the truth. A bias that would
    /// take away most of what the value is beyond a neutral one, or add as much, is beyond what fits can say: then the value stays, and the bias
    /// is part of its uncertainty.
    #[must_use]
    pub fn less_bias(value: f64, neutral: f64, shifts: &[f64]) -> Self {
        let n = shifts.len() as f64;
        let bias = shifts.iter().sum::<f64>() / n;
        let spread = shifts.iter().map(|shift| (shift - bias).powi(2)).sum::<f64>() / (n - 1.0);
        let quantile =
            StudentsT::new(0.0, 1.0, n - 1.0).map_or(crate::normal::QUANTILE_975, |t| t.inverse_cdf(0.975));
        let mut variance = spread * (1.0 + 1.0 / n);
        let (away, left) = ((value - neutral).abs(), (value - bias - neutral) * (value - neutral).signum());
        let is_plausible = left > 0.3 * away && left < 1.7 * away;
        let value = if is_plausible {
            value - bias
        } else {
            variance += bias * bias;
            value
        };
        Self::around(value, quantile * variance.sqrt())
    }

    /// The estimate of a function of the value that keeps its order.
    #[must_use]
    pub fn map(self, of: impl Fn(f64) -> f64) -> Self {
        Self { value: of(self.value), interval: self.interval.map(of) }
    }
}

/// Whether numbers are one number, as far as their 95 % intervals say (chi squared, at 5 %).
#[must_use]
pub fn are_alike(numbers: &[Estimate]) -> bool {
    let error = |number: &Estimate| {
        ((number.interval.hi - number.interval.lo) / (2.0 * crate::normal::QUANTILE_975)).max(1e-9)
    };
    let weights: Vec<f64> = numbers.iter().map(|number| error(number).powi(-2)).collect();
    let mean = numbers.iter().zip(&weights).map(|(number, w)| w * number.value).sum::<f64>()
        / weights.iter().sum::<f64>();
    let squares: f64 =
        numbers.iter().zip(&weights).map(|(number, w)| w * (number.value - mean).powi(2)).sum();
    let freedom = numbers.len() as f64 - 1.0;
    ChiSquared::new(freedom).is_ok_and(|chi_squared| chi_squared.sf(squares) > 0.05)
}

/// The value that is surely largest: that whose interval begins farthest from 0. The largest, where all intervals hold 0; 0 of none.
pub fn surely_largest(numbers: impl IntoIterator<Item = Estimate>) -> f64 {
    let surely = |at: &Estimate| at.interval.lo.max(-at.interval.hi).max(0.0);
    let most = numbers
        .into_iter()
        .max_by(|a, b| surely(a).total_cmp(&surely(b)).then(a.value.abs().total_cmp(&b.value.abs())));
    most.map_or(0.0, |most| most.value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A place that few beams meet has the largest value, and the others the surest.
    #[test]
    fn the_surely_largest_value_is_told() {
        let largest = |values: &[[f64; 2]]| {
            surely_largest(values.iter().map(|&[value, error]| Estimate::normal(value, error)))
        };
        assert_eq!(largest(&[[0.46, 0.1], [0.25, 0.01], [0.02, 0.01]]), 0.46);
        assert_eq!(largest(&[[0.46, 0.2], [0.25, 0.01], [-0.1, 0.01]]), 0.25);
        assert_eq!(largest(&[[0.1, 0.2], [-0.3, 0.2]]), -0.3);
        assert_eq!(largest(&[]), 0.0);
    }

    /// Walls of one kind of surface read 6 mm short, each to within 1 mm. Walls that moved have moved each on its own.
    #[test]
    fn numbers_that_are_one_are_told_from_others() {
        let of = |values: [f64; 3]| values.map(|value| Estimate::normal(value, 0.001));
        assert!(are_alike(&of([-0.0062, -0.0051, -0.0065])));
        assert!(!are_alike(&of([-0.006, 0.006, -0.006])));
        assert!(!are_alike(&of([-0.006, -0.03, -0.012])));
    }

    /// Steps of 1, 2, 3 from the truth: a bias of 2 and a spread of 1.
    #[test]
    fn a_bias_is_taken_off() {
        let number = Estimate::less_bias(10.0, 0.0, &[1.0, 2.0, 3.0]);
        assert!((number.value - 8.0).abs() < 1e-12);
        let hi = number.interval.hi;
        assert!((hi - 8.0 - 4.302_653 * (4.0_f64 / 3.0).sqrt()).abs() < 1e-5, "{hi}");
        let doubtful = Estimate::less_bias(2.5, 0.0, &[1.0, 2.0, 3.0]);
        assert!((doubtful.value - 2.5).abs() < 1e-12);
        assert!(doubtful.interval.lo < 0.0 && doubtful.interval.hi > 5.0);
    }
}
