//! A log's statistics ranked among those of replicates: standardized, in groups, under one false-alarm rate.

use distreg::MaxT;
use distreg::moments::Moments;

use crate::statistics::{Form, Group, Halves, Statistic};
use locsim_comparison::Nuisances;

/// The statistics of a log beside those of replicates.
pub(crate) struct Null {
    /// The log's statistics in standard deviations of the replicates, over both halves.
    pub z: Vec<f64>,
    /// The same of each half of the log's folds.
    pub halves: Vec<Halves>,
    /// The log's rank among replicates: p-values of the largest of the library, of the cells and misalignments, of all.
    pub p_library: f64,
    pub p_omnibus: f64,
    pub p: f64,
    /// How much each statistic says, see [`MaxT`].
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

/// How the false-alarm rate is shared out among the groups of statistics, in their order.
const SHARES: [f64; Group::COUNT] = [0.38, 0.14, 0.14, 0.05, 0.16, 0.05, 0.03, 0.025, 0.025];

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
    let max_t = MaxT::new(&largest, SHARES);
    let is_omnibus = |group: usize| Group::OMNIBUS.iter().any(|of| *of as usize == group);
    let largest = max_t.of_replicates();
    let above = ((0.01 * largest.len() as f64).ceil() as usize).max(1);
    let weights = statistics.iter().zip(&z).map(|(of, &z)| max_t.weight(of.group as usize, of.off(z)));
    let weight = weights.collect();
    Null {
        z,
        halves,
        p_library: max_t.p(|group| !is_omnibus(group)),
        p_omnibus: max_t.p(is_omnibus),
        p: max_t.p(|_| true),
        weight,
        thresholds: max_t.values_at(largest[largest.len() - above]),
        largest,
        spread: spreads,
        nuisances: Vec::new(),
        log_likelihoods: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::{Cell, Covariate, Deviation, Target};

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
}
