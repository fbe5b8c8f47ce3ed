//! The first moments of a sample, and how far off a further value is.

/// A sample's skewness counts as no more than this, and as none below that: of 200 numbers its error is 0.17.
const MOST_SKEWED: f64 = 2.0;
const LEAST_SKEWED: f64 = 0.25;

/// The first three moments of a sample, as sums about its first value.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    about: f64,
    count: f64,
    sums: [f64; 3],
}

impl Moments {
    /// Those of a sample of at least one value.
    pub fn of(mut values: impl Iterator<Item = f64>) -> Self {
        let about = values.next().unwrap_or(0.0);
        let mut all = Self { about, count: 1.0, sums: [0.0; 3] };
        for value in values {
            all.add(value, 1.0);
        }
        all
    }

    fn add(&mut self, value: f64, times: f64) {
        let x = value - self.about;
        for (sum, power) in self.sums.iter_mut().zip([x, x * x, x * x * x]) {
            *sum += times * power;
        }
        self.count += times;
    }

    /// The sample less one of its values.
    #[must_use]
    pub fn without(mut self, value: f64) -> Self {
        self.add(value, -1.0);
        self
    }

    /// The mean.
    pub fn mean(&self) -> f64 {
        self.about + self.sums[0] / self.count
    }

    /// The variance, of at least 0.
    pub fn variance(&self) -> f64 {
        let mean = self.sums[0] / self.count;
        ((self.sums[1] - self.count * mean * mean) / (self.count - 1.0).max(1.0)).max(0.0)
    }

    fn skewness(&self) -> f64 {
        let [a, b, c] = self.sums.map(|sum| sum / self.count);
        let variance = b - a * a;
        if variance <= 1e-12 * b.abs() {
            0.0
        } else {
            (c - 3.0 * a * b + 2.0 * a.powi(3)) / variance.powf(1.5)
        }
    }

    /// A value as a standard normal number, if the sample is of a shifted gamma distribution (Pearson's type III; the
    /// cube root of Wilson and Hilferty 1931): sums of rare contributions are skewed, and would be taken for
    /// discoveries. Roots of counts are nearly normal. A standard deviation counts as no less than `least`.
    pub fn normal(&self, value: f64, least: f64, is_count: bool) -> f64 {
        let sigma = self.variance().max(1e-9).sqrt();
        let t = (value - self.mean()) / sigma.max(least);
        if is_count || sigma < least {
            return t;
        }
        let skewness = self.skewness().clamp(-MOST_SKEWED, MOST_SKEWED);
        // Only the heavy side: a few hundred logs don't say how light the other one is.
        if skewness.abs() < LEAST_SKEWED || t * skewness < 0.0 {
            return t;
        }
        let shape = 4.0 / (skewness * skewness);
        let ratio = (1.0 + t * skewness.signum() / shape.sqrt()).max(0.0);
        skewness.signum() * 3.0 * shape.sqrt() * (ratio.cbrt() - 1.0 + 1.0 / (9.0 * shape))
    }
}

/// The mean of a number under its likelihood, by its values at even steps and the log likelihood of each (nats): where nothing is known
/// before, the best estimate of a location (Pitman 1939).
pub fn mean_of_likelihood(values: impl Iterator<Item = f64> + Clone, log_likelihoods: &[f64]) -> f64 {
    let most = log_likelihoods.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let [sum, weights] = values.zip(log_likelihoods).fold([0.0; 2], |[sum, weights], (value, likelihood)| {
        let weight = (likelihood - most).exp();
        [sum + weight * value, weights + weight]
    });
    sum / weights
}

#[cfg(test)]
mod tests {
    use statrs::distribution::{ContinuousCDF, Gamma, Normal};

    use super::*;

    /// Quantiles of a gamma distribution of shape 4, skewness 1, become those of a normal one on its heavy side.
    #[test]
    fn skewed_sums_become_normal() {
        let gamma = Gamma::new(4.0, 0.5).unwrap();
        let normal = Normal::new(0.0, 1.0).unwrap();
        let sample = (0..20_000).map(|i| gamma.inverse_cdf((f64::from(i) + 0.5) / 20_000.0));
        let moments = Moments::of(sample);
        for p in [0.9, 0.99, 0.999, 0.9999] {
            let (z, plain) = (moments.normal(gamma.inverse_cdf(p), 0.0, false), normal.inverse_cdf(p));
            assert!((z - plain).abs() < 0.05, "{p}: {z} for {plain}");
        }
        // Mirrored, the heavy side is the other one.
        let mirrored = (0..20_000).map(|i| -gamma.inverse_cdf((f64::from(i) + 0.5) / 20_000.0));
        let z = Moments::of(mirrored).normal(-gamma.inverse_cdf(0.999), 0.0, false);
        assert!((z - normal.inverse_cdf(0.001)).abs() < 0.05, "{z}");
    }

    /// Nothing of the kind in 99 logs, and one reading in the hundredth: one standard deviation.
    #[test]
    fn a_single_reading_does_not_stand_out() {
        let nothing = Moments::of([0.0; 99].into_iter());
        assert!((nothing.normal(25.0, 25.0, false) - 1.0).abs() < 1e-12);
        assert!(nothing.normal(25.0, 0.0, false) > 1e5);
        let usual = Moments::of((0..99).map(|i| f64::from(i % 9)));
        assert!((usual.normal(9.0, 1.0, false) - usual.normal(9.0, 0.0, false)).abs() < 1e-12);
    }

    #[test]
    fn a_sample_without_a_value_is_the_rest() {
        let values = [3.0, 8.5, -1.0, 4.25, 0.5];
        let rest = Moments::of(values[1..].iter().copied());
        let without = Moments::of(values.iter().copied()).without(3.0);
        assert!((rest.mean() - without.mean()).abs() < 1e-12);
        assert!((rest.variance() - without.variance()).abs() < 1e-12);
        assert!((rest.skewness() - without.skewness()).abs() < 1e-12);
    }

    #[test]
    fn the_mean_of_a_normal_likelihood_is_its_middle() {
        let values = (-40..=40).map(|i| 0.1 * f64::from(i));
        let logs: Vec<f64> = values.clone().map(|value| -800.0 - 2.0 * (value - 0.73).powi(2)).collect();
        assert!((mean_of_likelihood(values, &logs) - 0.73).abs() < 1e-9);
    }
}
