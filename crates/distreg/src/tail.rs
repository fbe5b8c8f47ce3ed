//! The upper tail of a sample: how likely a value beyond it is.

/// A tail is fitted to this part of a sample, of small samples to no fewer values. Of a hundred values a tenth says too little of how
/// heavy a tail is.
const PART: usize = 4;
const FEWEST: usize = 10;
/// The largest shape of a tail, with which it still has a mean and just no variance; below the other one it is exponential.
const HEAVIEST: f64 = 0.5;
const LIGHT: f64 = 1e-6;

/// The upper tail of a sample: a generalized Pareto distribution over its last quarter, by probability-weighted moments
/// (Hosking and Wallis 1987) of all but the largest value, which may be of another distribution. Never lighter than an exponential:
/// what lies beyond a light tail would be impossible.
#[derive(Clone, Debug)]
pub struct Tail {
    /// Where the tail begins, and minus the logarithm of the share of the sample beyond.
    begin: f64,
    minus_log_share: f64,
    scale: f64,
    shape: f64,
    sorted: Vec<f64>,
}

impl Tail {
    /// The tail of a sample of at least two values.
    pub fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_by(f64::total_cmp);
        let beyond = (sorted.len() / PART).max(FEWEST).min(sorted.len() - 1);
        let first = sorted.len() - beyond;
        let begin = sorted[first - 1];
        let high = &sorted[first..sorted.len() - usize::from(beyond > 1)];
        let (mut mean, mut weighed) = (0.0, 0.0);
        for (i, value) in high.iter().enumerate() {
            let excess = (value - begin) / high.len() as f64;
            mean += excess;
            weighed += excess * (1.0 - (i as f64 + 0.65) / beyond as f64);
        }
        let shape = (2.0 - mean / (mean - 2.0 * weighed).max(1e-9)).clamp(0.0, HEAVIEST);
        let minus_log_share = (sorted.len() as f64 / beyond as f64).ln();
        Self { begin, minus_log_share, scale: (mean * (1.0 - shape)).max(1e-3), shape, sorted }
    }

    /// Minus the logarithm of the chance of a value as large.
    pub fn minus_log_p(&self, value: f64) -> f64 {
        if value > self.begin {
            let excess = (value - self.begin) / self.scale;
            let beyond = if self.shape < LIGHT { excess } else { (self.shape * excess).ln_1p() / self.shape };
            return self.minus_log_share + beyond;
        }
        let above = self.sorted.len() - self.sorted.partition_point(|v| *v < value);
        -(above as f64 / self.sorted.len() as f64).ln()
    }

    /// The value of so small a chance.
    pub fn at(&self, minus_log_p: f64) -> f64 {
        let beyond = (minus_log_p - self.minus_log_share).max(0.0);
        let excess = if self.shape < LIGHT { beyond } else { (self.shape * beyond).exp_m1() / self.shape };
        self.begin + excess * self.scale
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt;
    use rand_philox::Philox;

    use super::*;

    /// The chance of a number that one in a thousand exceeds, by the tail of 100 exponential ones: its logarithm is off by 1.7 (root of the
    /// mean square over 400 samples). By the last tenth of the numbers it is off by 3.4.
    #[test]
    fn a_hundred_numbers_say_how_likely_one_beyond_them_is() {
        let truth = 1000.0_f64.ln();
        let squares = (0..400).map(|sample| {
            let mut rng = Philox::from_u64_seed(sample);
            let tail = Tail::of((0..100).map(|_| -(1.0 - rng.random::<f64>()).ln()));
            (tail.minus_log_p(truth) - truth).powi(2)
        });
        let error = (squares.sum::<f64>() / 400.0).sqrt();
        assert!(error < 2.0, "{error}");
    }

    /// Of an exponential sample, and of one with a heavy tail (shape 0.3), the tail goes on as it is.
    #[test]
    fn a_tail_is_continued() {
        for shape in [0.0, 0.3] {
            let quantile = |beyond: f64| if shape > 0.0 { (shape * beyond).exp_m1() / shape } else { beyond };
            let tail = Tail::of((0..20_000).map(|i| quantile(-((f64::from(i) + 0.5) / 20_000.0).ln())));
            for beyond in [0.5, 2.0, 4.0, 8.0] {
                let minus_log_p = tail.minus_log_p(quantile(beyond));
                assert!(
                    (minus_log_p - beyond).abs() < 0.04 * beyond + 0.02,
                    "{shape}: {minus_log_p} for {beyond}"
                );
            }
            assert!((tail.at(tail.minus_log_p(6.0)) - 6.0).abs() < 1e-9);
        }
    }

    /// Twenty logs are enough to show one that is far beyond the others: the tail is fitted without it.
    #[test]
    fn few_replicates_show_a_log_that_is_far_off() {
        let own = 12.0;
        let sample: Vec<f64> = (0..19).map(|i| -((f64::from(i) + 0.5) / 19.0).ln()).chain([own]).collect();
        let tail = Tail::of(sample.iter().copied());
        assert!(tail.minus_log_p(own) > tail.minus_log_p(sample[0]) + 6.0);
    }

    /// A few outliers among the statistics of one group don't make what another group has to exceed absurd.
    #[test]
    fn outliers_are_not_impossible() {
        let sample =
            (0..400).map(|i| if i < 5 { 10.0 + f64::from(i) } else { -((f64::from(i) + 0.5) / 400.0).ln() });
        assert!(Tail::of(sample).minus_log_p(12.0) < 7.5);
    }
}
