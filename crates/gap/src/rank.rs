//! A log's statistics ranked among those of replicates: standardized, in groups, under one false-alarm rate.

use crate::hypothesis::Nuisances;
use crate::statistics::{Form, Group, Halves, Statistic};

/// The statistics of a log beside those of replicates.
pub(crate) struct Null {
    /// The log's statistics in standard deviations of the replicates, over both halves.
    pub z: Vec<f64>,
    /// The same of each half of the log's folds.
    pub halves: Vec<Halves>,
    /// The log's rank among replicates: p-values of the largest of the library, of the cells, of all.
    pub p_library: f64,
    pub p_omnibus: f64,
    pub p: f64,
    /// How much each statistic says: minus the logarithm of the chance that one of its group says as much, over the
    /// group's share of the false-alarm rate.
    pub weight: Vec<f64>,
    /// The largest weight of each replicate, in order.
    pub largest: Vec<f64>,
    /// The threshold of each group at a false-alarm rate of 1 % (standard deviations).
    pub thresholds: [f64; Group::COUNT],
    /// Standard deviation of each statistic among the replicates.
    pub spread: Vec<f64>,
    /// Nuisances that were found in the replicates.
    pub nuisances: Vec<Nuisances>,
    /// Log likelihood of some of the replicates (nats).
    pub log_likelihoods: Vec<f64>,
}

impl Null {
    /// Whether the log is so far beyond all replicates that more of them would not make it a log without anything.
    pub fn is_clearly_off(&self) -> bool {
        let own = self.weight.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        matches!(self.largest[..], [.., most] if own > most + FARTHER)
    }

    /// The weight that the largest of a log without anything exceeds with this chance.
    pub fn weight_at(&self, chance: f64) -> f64 {
        let rank = ((1.0 - chance) * self.largest.len() as f64) as usize;
        self.largest[rank.min(self.largest.len() - 1)]
    }
}

/// A log is clearly off where it is beyond all replicates by this (nats). One log in 200 is beyond all of them by chance, and e^-3
/// of those by so much.
const FARTHER: f64 = 3.0;

/// How the false-alarm rate is shared out among the groups of statistics, in their order. Each gets its share however many
/// statistics it has, and one whose largest is now and then far off doesn't raise what the others have to exceed.
const SHARES: [f64; Group::COUNT] = [0.4, 0.2, 0.15, 0.05, 0.2];

pub(crate) fn rank(statistics: &[Statistic], own: &[Halves], others: &[Vec<Halves>]) -> Null {
    let count = others.len() + 1;
    let (mut z, mut halves) = (vec![0.0; own.len()], vec![[0.0; 2]; own.len()]);
    let mut spreads = vec![0.0; own.len()];
    // The largest of each group, of each replicate, the log last.
    let mut largest = vec![[0.0_f64; Group::COUNT]; count];
    let mut values = vec![0.0; count];
    for (i, statistic) in statistics.iter().enumerate() {
        let group = statistic.group as usize;
        // Counts by their roots, whose variance doesn't depend on the mean (Anscombe 1948) and is at most about 1 by
        // chance; of a count that hardly ever happens it is less, and would make a single event stand out.
        let is_count = statistic.form == Form::Count;
        let least = if is_count { 1.0 } else { statistic.by_one_reading };
        let number = |value: f64| if is_count { 2.0 * (value.max(0.0) + 0.375).sqrt() } else { value };
        for half in 0..2 {
            let replicates = others.iter().map(|other| number(other[i][half]));
            halves[i][half] = Moments::of(replicates).normal(number(own[i][half]), least, is_count);
        }
        for (value, log) in values.iter_mut().zip(others.iter().map(|other| &other[i]).chain([&own[i]])) {
            *value = number(log[0] + log[1]);
        }
        // Each by what all others say, so that log and replicates are alike where the simulator is right.
        let all = Moments::of(values.iter().copied());
        for (value, largest) in values.iter().zip(&mut largest) {
            let normal = all.without(*value).normal(*value, least, is_count);
            largest[group] = largest[group].max(statistic.off(normal));
        }
        let rest = all.without(values[count - 1]);
        z[i] = rest.normal(values[count - 1], least, is_count);
        spreads[i] = rest.variance().sqrt().max(least);
    }
    // Each group's largest as a p-value over the group's share, as a logarithm.
    let tails: Vec<Tail> = (0..Group::COUNT).map(|g| Tail::of(largest.iter().map(|t| t[g]))).collect();
    let weighed: Vec<[f64; Group::COUNT]> = largest
        .iter()
        .map(|t| std::array::from_fn(|g| tails[g].minus_log_p(t[g]) + SHARES[g].ln()))
        .collect();
    let p_of = |of: &dyn Fn(&[f64; Group::COUNT]) -> f64| {
        let mine = of(&weighed[count - 1]);
        weighed.iter().filter(|other| of(other) >= mine).count() as f64 / count as f64
    };
    let all = |t: &[f64; Group::COUNT]| t.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let p_library = p_of(&|t| {
        let mut library = *t;
        library[Group::Cells as usize] = f64::NEG_INFINITY;
        all(&library)
    });
    let p_omnibus = p_of(&|t| t[Group::Cells as usize]);
    let p = p_of(&all);
    let mut sorted: Vec<f64> = weighed[..count - 1].iter().map(all).collect();
    sorted.sort_by(f64::total_cmp);
    let above = ((0.01 * sorted.len() as f64).ceil() as usize).max(1);
    let weight = statistics
        .iter()
        .zip(&z)
        .map(|(statistic, &z)| {
            let group = statistic.group as usize;
            tails[group].minus_log_p(statistic.off(z)) + SHARES[group].ln()
        })
        .collect();
    let thresholds = std::array::from_fn(|g| tails[g].at(sorted[sorted.len() - above] - SHARES[g].ln()));
    Null {
        z,
        halves,
        p_library,
        p_omnibus,
        p,
        weight,
        largest: sorted,
        thresholds,
        spread: spreads,
        nuisances: Vec::new(),
        log_likelihoods: Vec::new(),
    }
}

/// The upper tail of a sample: a generalized Pareto distribution over its last quarter, by probability-weighted moments
/// (Hosking and Wallis 1987) of all but the largest value, which is the log's where the log is off. Never lighter than
/// an exponential: one group's outliers taken for impossible would raise what all groups have to exceed.
struct Tail {
    /// Where the tail begins, and minus the logarithm of the share of the sample beyond.
    begin: f64,
    minus_log_share: f64,
    scale: f64,
    shape: f64,
    sorted: Vec<f64>,
}

impl Tail {
    fn of(values: impl Iterator<Item = f64>) -> Self {
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
    fn minus_log_p(&self, value: f64) -> f64 {
        if value > self.begin {
            let excess = (value - self.begin) / self.scale;
            let beyond = if self.shape < LIGHT { excess } else { (self.shape * excess).ln_1p() / self.shape };
            return self.minus_log_share + beyond;
        }
        let above = self.sorted.len() - self.sorted.partition_point(|v| *v < value);
        -(above as f64 / self.sorted.len() as f64).ln()
    }

    /// The value of so small a chance.
    fn at(&self, minus_log_p: f64) -> f64 {
        let beyond = (minus_log_p - self.minus_log_share).max(0.0);
        let excess = if self.shape < LIGHT { beyond } else { (self.shape * beyond).exp_m1() / self.shape };
        self.begin + excess * self.scale
    }
}

/// A tail is fitted to this part of a sample, of small samples to no fewer values. Of a hundred replicates a tenth says too little
/// of how heavy a tail is: tails that look heavy by chance hide what is off.
const PART: usize = 4;
const FEWEST: usize = 10;
/// The largest shape of a tail, with which it still has a mean and just no variance; below the other one it is exponential.
const HEAVIEST: f64 = 0.5;
const LIGHT: f64 = 1e-6;

/// The first three moments of a sample, as sums about its first value.
#[derive(Clone, Copy, Default)]
struct Moments {
    about: f64,
    count: f64,
    sums: [f64; 3],
}

impl Moments {
    fn of(mut values: impl Iterator<Item = f64>) -> Self {
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
    fn without(mut self, value: f64) -> Self {
        self.add(value, -1.0);
        self
    }

    fn mean(&self) -> f64 {
        self.about + self.sums[0] / self.count
    }

    fn variance(&self) -> f64 {
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
    fn normal(&self, value: f64, least: f64, is_count: bool) -> f64 {
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

/// A sample's skewness counts as no more than this, and as none below that: of 200 numbers its error is 0.17.
const MOST_SKEWED: f64 = 2.0;
const LEAST_SKEWED: f64 = 0.25;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::{Cell, Covariate, Deviation, Target};
    use locsim_core::{Draw, Stage};
    use rand::RngExt;
    use statrs::distribution::{ContinuousCDF, Gamma, Normal};

    #[test]
    fn a_log_is_clearly_off_beyond_all_replicates_and_more() {
        let of = |own: f64| Null {
            z: Vec::new(),
            halves: Vec::new(),
            p_library: 0.0,
            p_omnibus: 0.0,
            p: 0.0,
            weight: vec![0.1, own],
            largest: vec![1.0, 2.0],
            thresholds: [0.0; Group::COUNT],
            spread: Vec::new(),
            nuisances: Vec::new(),
            log_likelihoods: Vec::new(),
        };
        assert!(of(2.1 + FARTHER).is_clearly_off());
        assert!(!of(1.9 + FARTHER).is_clearly_off());
    }

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

    /// The chance of a number that one in a thousand exceeds, by the tail of 100 exponential ones: its logarithm is off by 1.7 (root of the
    /// mean square over 400 samples). By the last tenth of the numbers it is off by 3.4.
    #[test]
    fn a_hundred_numbers_say_how_likely_one_beyond_them_is() {
        let truth = 1000.0_f64.ln();
        let squares = (0..400).map(|sample| {
            let mut rng = Draw::new(5, Stage::Trial, sample).item(0);
            let tail = Tail::of((0..100).map(|_| -(1.0 - rng.random::<f64>()).ln()));
            (tail.minus_log_p(truth) - truth).powi(2)
        });
        let error = (squares.sum::<f64>() / 400.0).sqrt();
        assert!(error < 2.0, "{error}");
    }

    /// Forty statistics of stray readings, each 0 in all replicates but one, don't raise what a group has to exceed, as long as they say
    /// what one reading changes.
    #[test]
    fn stray_readings_do_not_hide_what_is_off() {
        const STRAY: usize = 40;
        let cell = |covariate| Cell { covariate, lo: 0.0, hi: 0.0, place: None, deviation: Deviation::Mean };
        let threshold = |by_one_reading: f64| {
            let statistic = |i: usize| Statistic {
                target: Target::Cell(cell(if i < STRAY { Covariate::Place } else { Covariate::Time })),
                group: Group::Cells,
                form: Form::Other,
                by_one_reading: if i < STRAY { by_one_reading } else { 0.0 },
            };
            let statistics: Vec<Statistic> = (0..STRAY + 5).map(statistic).collect();
            let log = |number: usize| -> Vec<Halves> {
                let of = |i: usize| match i {
                    _ if i < STRAY => {
                        if number == i {
                            20.0
                        } else {
                            0.0
                        }
                    }
                    // Numbers that are as good as any.
                    _ => ((number * (i + 7) * 37) % 101) as f64 / 101.0,
                };
                (0..statistics.len()).map(|i| [of(i), 0.0]).collect()
            };
            let others: Vec<Vec<Halves>> = (0..99).map(log).collect();
            rank(&statistics, &log(99), &others).thresholds[Group::Cells as usize]
        };
        assert!(threshold(20.0) < 4.0 && threshold(0.0) > 1000.0);
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
