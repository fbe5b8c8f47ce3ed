//! The arithmetic of an experiment over trials: moments that add up over trials, pooled quantiles, and
//! percentile intervals from a bootstrap that resamples whole trials.
//!
//! Steps of one trial depend on each other, trials don't; so trials are what the bootstrap draws (Efron and
//! Tibshirani, An Introduction to the Bootstrap, section 8.4), and every model gets the same draws, which
//! keeps comparisons on the same trials paired.

use locsim_core::{Draw, Interval, Stage};
use rayon::prelude::*;
use statrs::distribution::{Beta, ContinuousCDF, StudentsT};

/// Number of bootstrap resamples behind each interval.
pub const REPLICATES: u32 = 2000;

/// Tail probability left out at each end of an interval: together they make it a 95 % interval.
const TAIL: f64 = 0.025;

/// Count, sum and sum of squares of a sample; those of a union are the sums of its parts'.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    count: f64,
    sum: f64,
    sum_of_squares: f64,
}

impl Moments {
    /// The moments of the union of `copies` copies of each part.
    pub fn pooled<'a>(parts: impl IntoIterator<Item = (&'a Self, u32)>) -> Self {
        parts.into_iter().fold(Self::default(), |total, (part, copies)| {
            let copies = f64::from(copies);
            Self {
                count: total.count + copies * part.count,
                sum: total.sum + copies * part.sum,
                sum_of_squares: total.sum_of_squares + copies * part.sum_of_squares,
            }
        })
    }

    /// Mean; NaN of an empty sample.
    pub fn mean(&self) -> f64 {
        self.sum / self.count
    }

    /// Number of values.
    pub fn count(&self) -> f64 {
        self.count
    }

    /// The 95 % interval of the mean by Student's t; `None` for fewer than two values.
    pub fn mean_interval(&self) -> Option<Interval> {
        let freedom = self.count - 1.0;
        let t = StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(1.0 - TAIL);
        let half = t * (self.variance() / freedom).sqrt();
        half.is_finite().then(|| Interval { lo: self.mean() - half, hi: self.mean() + half })
    }

    /// Mean of the squares; NaN of an empty sample.
    pub fn mean_square(&self) -> f64 {
        self.sum_of_squares / self.count
    }

    /// Variance about the mean, divided by the count, so that `mean_square == mean^2 + variance`.
    pub fn variance(&self) -> f64 {
        (self.mean_square() - self.mean().powi(2)).max(0.0)
    }
}

impl FromIterator<f64> for Moments {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        values.into_iter().fold(Self::default(), |m, value| Self {
            count: m.count + 1.0,
            sum: m.sum + value,
            sum_of_squares: m.sum_of_squares + value * value,
        })
    }
}

/// The values of all trials in ascending order, each with the trial it came from, so that quantiles of any
/// resample of trials are found in one pass.
#[derive(Clone, Debug, Default)]
pub struct PooledValues {
    values: Vec<f64>,
    /// The trial of each value.
    trials: Vec<u32>,
    /// How many values each trial has.
    sizes: Vec<u32>,
}

impl PooledValues {
    /// Pools `(value, trial)` pairs of trials numbered below `trials`.
    pub fn new(trials: usize, values: impl IntoIterator<Item = (f64, u32)>) -> Self {
        let mut sorted: Vec<_> = values.into_iter().collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (values, of): (Vec<f64>, Vec<u32>) = sorted.into_iter().unzip();
        let mut sizes = vec![0; trials];
        for &trial in &of {
            sizes[trial as usize] += 1;
        }
        Self { values, trials: of, sizes }
    }

    /// Quantiles of the sample in which trial `t` occurs `copies[t]` times, by linear interpolation between
    /// order statistics (Hyndman and Fan's type 7). `probabilities` ascend. NaN when the sample is empty.
    pub fn quantiles<const N: usize>(&self, copies: &[u32], probabilities: [f64; N]) -> [f64; N] {
        let copies_of = |value: usize| copies[self.trials[value] as usize] as usize;
        let total: usize = self.sizes.iter().zip(copies).map(|(&size, &n)| size as usize * n as usize).sum();
        if total == 0 {
            return [f64::NAN; N];
        }
        // The value at `place` has the ranks `before..before + copies_of(place)` in the sample.
        let (mut place, mut before) = (0, 0);
        probabilities.map(|probability| {
            let rank = probability * (total - 1) as f64;
            let below = rank.floor() as usize;
            while before + copies_of(place) <= below {
                before += copies_of(place);
                place += 1;
            }
            let value = self.values[place];
            let upper = if below + 1 < before + copies_of(place) {
                value
            } else {
                let next = (place + 1..self.values.len()).find(|&next| copies_of(next) > 0);
                next.map_or(value, |next| self.values[next])
            };
            value + (rank - rank.floor()) * (upper - value)
        })
    }
}

/// Quantile of values in ascending order, by the same rule; NaN without values.
pub fn quantile(sorted: &[f64], probability: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let rank = probability * last as f64;
    let below = rank.floor() as usize;
    let upper = sorted[(below + 1).min(last)];
    sorted[below] + (rank - rank.floor()) * (upper - sorted[below])
}

/// Resamples of the trials of an experiment, with replacement: how often each trial occurs in each.
#[derive(Clone, Debug)]
pub struct Bootstrap {
    copies: Vec<Vec<u32>>,
}

impl Bootstrap {
    /// [`REPLICATES`] resamples of `trials` trials; the draws are keyed by `seed`.
    ///
    /// `None` for fewer than two trials: one trial says nothing of how trials differ.
    pub fn new(seed: u64, trials: usize) -> Option<Self> {
        if trials < 2 {
            return None;
        }
        let draw = Draw::new(seed, Stage::Bootstrap, 0);
        let copies = (0..REPLICATES)
            .into_par_iter()
            .map(|replicate| {
                let mut copies = vec![0; trials];
                for item in 0..trials as u32 {
                    // Multiply and shift takes 64 random bits to 0..trials with a bias below trials / 2^64.
                    let bits = u128::from(draw.at(replicate).seed(item));
                    copies[((bits * trials as u128) >> 64) as usize] += 1;
                }
                copies
            })
            .collect();
        Some(Self { copies })
    }

    /// Percentile intervals of the statistics that `statistics` computes from a resample (copies of each
    /// trial). Resamples for which a statistic isn't finite are left out of its interval; `None` when these
    /// are more than half, for any statistic.
    pub fn intervals<const N: usize>(
        &self,
        statistics: impl Fn(&[u32]) -> [f64; N] + Sync,
    ) -> Option<[Interval; N]> {
        let replicates: Vec<[f64; N]> = self.copies.par_iter().map(|copies| statistics(copies)).collect();
        let mut intervals = [Interval { lo: f64::NAN, hi: f64::NAN }; N];
        for (i, interval) in intervals.iter_mut().enumerate() {
            let mut values: Vec<f64> = replicates.iter().map(|r| r[i]).filter(|v| v.is_finite()).collect();
            if 2 * values.len() < replicates.len() {
                return None;
            }
            values.sort_by(f64::total_cmp);
            *interval = Interval { lo: quantile(&values, TAIL), hi: quantile(&values, 1.0 - TAIL) };
        }
        Some(intervals)
    }
}

/// The exact 95 % interval of a binomial share after `successes` of `trials` (Clopper and Pearson 1934). Unlike a
/// bootstrap it isn't empty when nothing happened. `trials` must be at least 1.
pub fn share_interval(successes: u32, trials: u32) -> Interval {
    let (k, n) = (f64::from(successes), f64::from(trials));
    let beta_quantile = |a: f64, b: f64, p: f64| Beta::new(a, b).map_or(f64::NAN, |beta| beta.inverse_cdf(p));
    Interval {
        lo: if successes == 0 { 0.0 } else { beta_quantile(k, n - k + 1.0, TAIL) },
        hi: if successes == trials { 1.0 } else { beta_quantile(k + 1.0, n - k, 1.0 - TAIL) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quantiles_of_a_resample_are_those_of_the_expanded_sample(
            values in proptest::collection::vec((-5.0..5.0f64, 0..4u32), 1..40),
            copies in proptest::collection::vec(0..4u32, 4),
        ) {
            let mut expanded: Vec<f64> = values
                .iter()
                .flat_map(|&(value, trial)| std::iter::repeat_n(value, copies[trial as usize] as usize))
                .collect();
            expanded.sort_by(f64::total_cmp);
            let probabilities = [0.0, 0.1, 0.5, 0.95, 1.0];
            let found = PooledValues::new(4, values).quantiles(&copies, probabilities);
            for (found, probability) in found.into_iter().zip(probabilities) {
                let expected = quantile(&expanded, probability);
                prop_assert!((found - expected).abs() < 1e-12 || (found.is_nan() && expected.is_nan()));
            }
        }

        #[test]
        fn moments_of_a_union_are_those_of_the_whole(values in proptest::collection::vec(-5.0..5.0f64, 2..40)) {
            let (a, b) = values.split_at(values.len() / 2);
            let parts = [a.iter().copied().collect::<Moments>(), b.iter().copied().collect()];
            let union = Moments::pooled(parts.iter().map(|part| (part, 1)));
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
            prop_assert!((union.mean() - mean).abs() < 1e-12);
            prop_assert!((union.variance() - variance).abs() < 1e-9);
        }
    }

    #[test]
    fn the_median_of_an_even_sample_is_halfway() {
        assert_eq!(quantile(&[1.0, 2.0, 4.0, 9.0], 0.5), 3.0);
        assert!(quantile(&[], 0.5).is_nan());
    }

    /// The interval of the mean of n values is mean +- 1.96 sigma / sqrt(n) in the limit; with 2000 resamples a
    /// 2.5 % quantile has a relative error of about 3 % of the half width (1 standard error), and n = 400 leaves
    /// skewness below that. 5 standard errors: 15 %.
    #[test]
    fn the_interval_of_a_mean_has_the_width_that_theory_gives() {
        let n = 400;
        let values: Vec<f64> = (0..n).map(|i| (f64::from(i) * 0.754_877_666).fract()).collect();
        let trials: Vec<Moments> = values.iter().map(|&v| std::iter::once(v).collect()).collect();
        let mean = |copies: &[u32]| [Moments::pooled(trials.iter().zip(copies.iter().copied())).mean()];
        let [interval] = Bootstrap::new(5, n as usize).unwrap().intervals(mean).unwrap();
        let sigma = values.iter().copied().collect::<Moments>().variance().sqrt();
        let expected = 2.0 * 1.96 * sigma / f64::from(n).sqrt();
        let width = interval.hi - interval.lo;
        assert!((width / expected - 1.0).abs() < 0.15, "{width} against {expected}");
        assert!(interval.contains(0.5));
    }

    /// Of 200 experiments of 60 trials each, about 95 % should have an interval that covers the true mean. The
    /// percentile interval of n = 60 covers about 94 %; the count of misses is binomial(200, 0.06), which exceeds
    /// 32 with a probability below 1e-6 and falls below 1 with about 4e-6. Intervals of half the width, the
    /// negative control, miss about a third of the time and must be found out.
    #[test]
    fn intervals_cover_the_truth_as_often_as_they_say() {
        let (experiments, n) = (200, 60);
        let (mut missed, mut missed_by_half) = (0, 0);
        for experiment in 0..experiments {
            let draw = Draw::new(99, Stage::Laser, experiment);
            let trials: Vec<Moments> =
                (0..n).map(|i| std::iter::once(draw.seed(i) as f64 / u64::MAX as f64).collect()).collect();
            let mean = |copies: &[u32]| [Moments::pooled(trials.iter().zip(copies.iter().copied())).mean()];
            let [interval] =
                Bootstrap::new(u64::from(experiment), n as usize).unwrap().intervals(mean).unwrap();
            missed += u32::from(!interval.contains(0.5));
            let quarter = (interval.hi - interval.lo) / 4.0;
            let half = Interval { lo: interval.lo + quarter, hi: interval.hi - quarter };
            missed_by_half += u32::from(!half.contains(0.5));
        }
        assert!((1..=32).contains(&missed), "missed {missed} of {experiments}");
        assert!(missed_by_half > 32, "half the width missed only {missed_by_half} of {experiments}");
    }

    /// Reference values: R's `binom.test(x, n)$conf.int`.
    #[test]
    fn shares_have_exact_intervals() {
        let none = share_interval(0, 200);
        assert_eq!(none.lo, 0.0);
        assert!((none.hi - 0.018_275).abs() < 1e-5);
        let some = share_interval(3, 200);
        assert!((some.lo - 0.003_102).abs() < 1e-5 && (some.hi - 0.043_208).abs() < 1e-4, "{some:?}");
        assert_eq!(share_interval(5, 5).hi, 1.0);
    }

    /// Reference values: R's `t.test(c(1, 2, 4, 9))$conf.int`.
    #[test]
    fn a_mean_has_student_s_interval() {
        let interval = [1.0, 2.0, 4.0, 9.0].into_iter().collect::<Moments>().mean_interval().unwrap();
        assert!(
            (interval.lo + 1.663_20).abs() < 1e-3 && (interval.hi - 9.663_20).abs() < 1e-3,
            "{interval:?}"
        );
        assert_eq!([1.0].into_iter().collect::<Moments>().mean_interval(), None);
        assert_eq!(Moments::default().mean_interval(), None);
    }

    #[test]
    fn one_trial_has_no_interval_and_the_seed_decides_the_draws() {
        assert!(Bootstrap::new(1, 1).is_none());
        let copies = |seed| Bootstrap::new(seed, 7).unwrap().copies;
        assert_eq!(copies(1), copies(1));
        assert_ne!(copies(1), copies(2));
        assert!(copies(1).iter().all(|c| c.iter().sum::<u32>() == 7));
    }
}
