//! Stretches, and the log that each is of.

/// The stretches of the baseline and of today's log; a permutation assigns them anew.
#[derive(Clone)]
pub(super) struct Assignment {
    pub is_baseline: Vec<bool>,
    pub is_today: Vec<bool>,
}

impl Assignment {
    /// The gains on today's stretches.
    pub fn of_today(&self, gains: &[f64]) -> Vec<f64> {
        gains.iter().zip(&self.is_today).filter(|(_, is_today)| **is_today).map(|(gain, _)| *gain).collect()
    }

    pub fn used(&self) -> Vec<bool> {
        self.is_baseline.iter().zip(&self.is_today).map(|(baseline, today)| baseline | today).collect()
    }

    /// Mean gain of today's stretches less that of the baseline's, in its standard errors (Welch 1947). What all of today's stretches
    /// gain stands out in it even where permutations gain as well, because they mix stretches that gain with others. Gains that
    /// sum up to a nat or so are noise.
    pub fn contrast(&self, gains: &[f64]) -> f64 {
        let [today, baseline] = [&self.is_today, &self.is_baseline].map(|is_used| mean_of(gains, is_used));
        let stretches = self.is_today.iter().filter(|is| **is).count().max(1) as f64;
        (today[0] - baseline[0].max(0.0)) / (today[1] + baseline[1] + stretches.powi(-2)).sqrt()
    }

    /// The gain on today's stretches beyond that on as many stretches of the baseline: an effect that both logs have gains on
    /// both, as does one that makes up for what the baseline's histograms can't express.
    pub fn net(&self, today: &[f64], baseline: &[f64]) -> Vec<f64> {
        let of_baseline =
            || baseline.iter().zip(&self.is_baseline).filter(|(_, is)| **is).map(|(gain, _)| *gain);
        let stretches = of_baseline().count().max(1);
        let usual = (of_baseline().sum::<f64>() / stretches as f64).max(0.0);
        let gains = today.iter().zip(&self.is_today);
        gains.map(|(gain, is_today)| if *is_today { gain - usual } else { 0.0 }).collect()
    }
}

/// Mean over stretches and its variance.
fn mean_of(gains: &[f64], is_used: &[bool]) -> [f64; 2] {
    let own = || gains.iter().zip(is_used).filter(|(_, is)| **is).map(|(gain, _)| *gain);
    let n = f64::max(own().count() as f64, 2.0);
    let mean = own().sum::<f64>() / n;
    [mean, own().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))]
}

/// Stretches up to so many apart err together, by decreasing weights.
const MOST_LAG: usize = 4;

/// The variance inflation of a sum over stretches in the order of time, by which its variance is larger than that of independent ones, at
/// least 1: by the products of those that follow each other (Bartlett's weights; Newey and West 1987). `logs` are what the stretches of each log add to the sum, less
/// what is expected of them.
pub(super) fn variance_inflation(logs: &[&[f64]]) -> f64 {
    let products = |lag: usize| -> f64 {
        logs.iter().flat_map(|log| log.iter().zip(log.iter().skip(lag))).map(|(a, b)| a * b).sum()
    };
    let weight = |lag: usize| 2.0 * (1.0 - lag as f64 / (MOST_LAG + 1) as f64);
    let together: f64 = (1..=MOST_LAG).map(|lag| weight(lag) * products(lag)).sum();
    1.0 + (together / products(0).max(f64::MIN_POSITIVE)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Signs that stay for eight stretches: of 8 products of stretches k apart, 8 - k are positive and k are of the next sign. Those that
    /// alternate tell more than independent ones, which isn't believed of so few.
    #[test]
    fn stretches_that_err_alike_tell_less() {
        let lasting: Vec<f64> = (0..64).map(|i| if i / 8 % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let expected: f64 = (1..5)
            .map(|k| {
                let [same, other] = [(8 - k) * 8, k * 7].map(f64::from);
                2.0 * (1.0 - f64::from(k) / 5.0) * (same - other) / 64.0
            })
            .sum();
        assert!((variance_inflation(&[&lasting]) - 1.0 - expected).abs() < 1e-12);
        assert!(expected > 1.0);
        let (first, second) = lasting.split_at(32);
        // A log's last stretch isn't followed by the other's first.
        assert!(variance_inflation(&[first, second]) > variance_inflation(&[&lasting]));
        let alternating: Vec<f64> = (0..64).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        assert_eq!(variance_inflation(&[&alternating]), 1.0);
        assert_eq!(variance_inflation(&[&[0.0; 5]]), 1.0);
    }
}
