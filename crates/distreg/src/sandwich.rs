//! Intervals of maximum likelihood estimates from few folds.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// The least share of the half-width by the curvature alone: the sandwich of few folds is now and then far too small.
const LEAST_SHARE: f64 = 0.8;
/// The 97.5 % quantile of the standard normal distribution, to two decimals.
const QUANTILE_975: f64 = 1.96;

/// Half-widths of the 95 % intervals of parameters, by the inverse of their information \[parameter\]\[parameter\] and the gradient of the log
/// likelihood \[parameter\]\[fold\]: by the mean of the variances that the sandwich of Godambe (1960) and the curvature alone have, as
/// each is a poor estimate by itself, with Student's distribution.
pub fn half_widths(inverse: &[Vec<f64>], gradient: &[Vec<f64>]) -> Vec<f64> {
    let count = gradient.first().map_or(0, Vec::len);
    // One less than folds, and no fewer than have a variance.
    let degrees = (count as f64 - 1.0).max(2.0);
    let quantile = StudentsT::new(0.0, 1.0, degrees).map_or(QUANTILE_975, |t| t.inverse_cdf(0.975));
    let half = |(i, row): (usize, &Vec<f64>)| {
        let projected = (0..count).map(|b| row.iter().zip(gradient).map(|(r, g)| r * g[b]).sum::<f64>());
        let sandwich = projected.map(|p| p * p).sum::<f64>() * count as f64 / degrees;
        let error = sandwich.max(0.0).sqrt();
        let curvature = row[i].max(0.0).sqrt();
        let both = (0.5 * (error * error + curvature * curvature)).sqrt();
        (quantile * both).max(QUANTILE_975 * LEAST_SHARE * curvature)
    };
    inverse.iter().enumerate().map(half).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of 100 folds of standard deviation 1, whose information is 100: .1 by either variance; without any spread between folds .08.
    #[test]
    fn a_mean_of_many_folds_has_the_interval_of_its_deviation() {
        let gradient: Vec<f64> = (0..100).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let [half] = half_widths(&[vec![0.01]], &[gradient])[..] else { panic!() };
        assert!((half - 1.98 * 0.1).abs() < 0.003, "{half}");
        let [half] = half_widths(&[vec![0.01]], &[vec![0.0; 100]])[..] else { panic!() };
        assert!((half - QUANTILE_975 * 0.08).abs() < 1e-9, "{half}");
    }
}
