//! Many tests at once: false discovery rates.

/// The false discovery rate at which each of some p-values, in increasing order, is a discovery (Benjamini and Hochberg 1995).
pub fn false_discovery_rates(p_values: &[f64]) -> Vec<f64> {
    let count = p_values.len() as f64;
    let mut rates: Vec<f64> =
        p_values.iter().enumerate().map(|(rank, p)| p * count / (rank + 1) as f64).collect();
    let mut least = 1.0_f64;
    for rate in rates.iter_mut().rev() {
        least = least.min(*rate);
        *rate = least;
    }
    rates
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_discovery_has_the_rate_of_the_best_set_that_it_is_in() {
        let rates = false_discovery_rates(&[0.001, 0.04, 0.041, 0.9]);
        let expected = [0.004, 0.041 * 4.0 / 3.0, 0.041 * 4.0 / 3.0, 0.9];
        assert!(
            rates.iter().zip(expected).all(|(rate, expected)| (rate - expected).abs() < 1e-12),
            "{rates:?}"
        );
        assert!(false_discovery_rates(&[]).is_empty());
    }
}
