//! Scores of contaminations: readings that follow another density with a small probability.

/// About as many events of a kind can just be told from chance. At the share that gives them the score is near the best test, and
/// bounded; at a share of 0 it is a ratio of densities, which can be 10,000 for a single reading.
const EVENTS: f64 = 15.0;

/// The largest share of a contamination at which its score is taken: that of fewer than 50 readings.
const MOST: f64 = 0.3;

/// The share at which a contamination of `readings` readings can just be told from chance. Its score is taken there.
#[must_use]
pub fn detectable_share(readings: f64) -> f64 {
    (EVENTS / readings.max(1.0)).min(MOST)
}

/// Derivative of a log density by the share of a contamination, at `share`; `ratio` is the contamination's density over
/// the hypothesis's, less 1. At a share of 0 it would be the ratio itself, which a single reading can make huge.
#[inline]
#[must_use]
pub fn score(ratio: f64, share: f64) -> f64 {
    ratio / (1.0 + share * ratio)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At the share itself the score's mean is 0: sum of q ratio / (1 + share ratio) over two outcomes of probability
    /// q = p (1 + share ratio), p those of the hypothesis.
    #[test]
    fn the_score_of_a_contamination_has_no_mean_at_its_share() {
        let (p, share) = ([0.9, 0.1], 0.05);
        // Under the contamination alone: 0.2 and 0.8.
        let ratios = [0.2 / 0.9 - 1.0, 0.8 / 0.1 - 1.0];
        let mean: f64 = p.iter().zip(ratios).map(|(p, r)| p * (1.0 + share * r) * score(r, share)).sum();
        assert!(mean.abs() < 1e-12, "{mean}");
    }
}
