//! How rare gains of each kind of effect are, by permutations of stretches.

use std::collections::BTreeMap;

use locsim_world::effect::EffectKind;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::increments::is_of_odometry;

/// Logs are clearly off where they are beyond all permutations by this (nats). Of those that are beyond them by chance, one in e^3 is.
const FARTHER: f64 = 3.0;

/// The trial of a kind that gains most.
#[derive(Clone, Copy)]
pub(super) struct Score {
    /// Its gain (nats), negative where nothing gains.
    pub gain: f64,
    /// How surely the kind gains today and not in the baseline, in standard errors: the most of any trial. That of odometry is
    /// signed.
    pub contrast: f64,
    /// Index of the trial.
    pub index: usize,
}

/// The best trial of each kind.
pub(super) type Best = BTreeMap<EffectKind, Score>;

/// Keeps the better one.
pub(super) fn add(best: &mut Best, kind: EffectKind, score: Score) {
    let entry = best.entry(kind).or_insert(score);
    let contrast = entry.contrast.max(score.contrast);
    if score.gain > entry.gain {
        *entry = score;
    }
    entry.contrast = contrast;
}

/// The most that kinds of effect gain in permutations.
pub(super) struct Null {
    roots: BTreeMap<EffectKind, Roots>,
    contrasts: BTreeMap<EffectKind, Contrasts>,
    /// The largest weight of each permutation, in order: of all kinds, of those that change readings, of those of the odometry.
    all: Vec<f64>,
    readings: Vec<f64>,
    odometry: Vec<f64>,
}

/// Roots of twice the gains of one kind, of the true logs and of permutations, in order.
struct Roots {
    sorted: Vec<f64>,
    mean: f64,
    deviation: f64,
    /// Where the tail begins, and its mean excess.
    begin: f64,
    scale: f64,
}

impl Roots {
    fn new(own: f64, others: Vec<f64>) -> Self {
        let n = others.len() as f64;
        let mean = others.iter().sum::<f64>() / n;
        let variance = others.iter().map(|root| (root - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let mut sorted = others;
        sorted.push(own);
        sorted.sort_by(f64::total_cmp);
        // The last tenth but for the largest value, which is the true logs' where something changed.
        let beyond = (sorted.len() / 10).max(FEWEST).min(sorted.len() - 1);
        let first = sorted.len() - beyond;
        // A kind that loses in most permutations isn't found by a gain of nothing.
        let begin = sorted[first - 1].max(0.0);
        let tail =
            sorted[first..sorted.len() - 1].iter().map(|root| root - begin).filter(|excess| *excess > 0.0);
        let excess = tail.clone().sum::<f64>() / f64::max(tail.count() as f64, 1.0);
        Self {
            mean,
            deviation: variance.sqrt().max(LEAST_SCALE),
            begin,
            scale: excess.max(LEAST_SCALE),
            sorted,
        }
    }

    /// Minus the logarithm of the chance of a root as large: its rank, and beyond the last tenth an exponential tail.
    fn weight(&self, root: f64) -> f64 {
        let count = self.sorted.len() as f64;
        let above = |value: f64| count - self.sorted.partition_point(|v| *v < value) as f64;
        if root > self.begin {
            let beyond = (count / 10.0).max(FEWEST as f64);
            (count / beyond).ln() + (root - self.begin) / self.scale
        } else {
            -(above(root) / count).ln()
        }
    }
}

/// Contrasts of one kind in permutations: they follow Student's distribution about a mean that the best of several trials has.
struct Contrasts {
    mean: f64,
    deviation: f64,
    degrees: f64,
    is_two_sided: bool,
}

impl Contrasts {
    fn new(kind: EffectKind, others: &[f64], stretches: usize) -> Self {
        let n = others.len() as f64;
        let mean = others.iter().sum::<f64>() / n;
        let variance = others.iter().map(|contrast| (contrast - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let is_two_sided = is_of_odometry(kind) && !kind.is_one_sided();
        Self {
            mean: if is_two_sided { mean } else { mean.max(0.0) },
            deviation: variance.sqrt().max(LEAST_SCALE),
            degrees: f64::max(stretches as f64 - 1.0, 1.0),
            is_two_sided,
        }
    }

    fn z(&self, contrast: f64) -> f64 {
        let z = (contrast - self.mean) / self.deviation;
        if self.is_two_sided { z.abs() } else { z }
    }

    /// Minus the logarithm of the chance of a contrast as large.
    fn weight(&self, contrast: f64) -> f64 {
        let chance =
            StudentsT::new(0.0, 1.0, self.degrees).map_or(1.0, |student| student.sf(self.z(contrast)));
        -(if self.is_two_sided { 2.0 * chance } else { chance }).max(f64::MIN_POSITIVE).ln()
    }
}

/// A gain as a number of standard deviations, were its effect a shift of one direction; negative where it loses, so that kinds
/// which hardly ever gain have a distribution, too.
pub(super) fn root(gain: f64) -> f64 {
    gain.signum() * (2.0 * gain.abs()).sqrt()
}

impl Null {
    pub fn new(own: &Best, others: &[Best], stretches: usize) -> Self {
        let of = |kind: EffectKind, number: &dyn Fn(&Score) -> f64| -> Vec<f64> {
            others.iter().map(|best| best.get(&kind).map_or(0.0, number)).collect()
        };
        let roots = |(&kind, score): (&EffectKind, &Score)| {
            (kind, Roots::new(root(score.gain), of(kind, &|score| root(score.gain))))
        };
        let contrasts =
            |&kind: &EffectKind| (kind, Contrasts::new(kind, &of(kind, &|score| score.contrast), stretches));
        let mut null = Self {
            roots: own.iter().map(roots).collect(),
            contrasts: own.keys().map(contrasts).collect(),
            all: Vec::new(),
            readings: Vec::new(),
            odometry: Vec::new(),
        };
        let largest = |is_among: &dyn Fn(EffectKind) -> bool| {
            let mut largest: Vec<f64> = others.iter().map(|best| null.most(best, is_among)).collect();
            largest.sort_by(f64::total_cmp);
            largest
        };
        let [all, readings, odometry] =
            [largest(&|_| true), largest(&|kind| !is_of_odometry(kind)), largest(&is_of_odometry)];
        (null.all, null.readings, null.odometry) = (all, readings, odometry);
        null
    }

    /// Gain or contrast in standard deviations of permutations, the larger one.
    pub fn z(&self, kind: EffectKind, score: &Score) -> f64 {
        let (Some(roots), Some(contrasts)) = (self.roots.get(&kind), self.contrasts.get(&kind)) else {
            return 0.0;
        };
        ((root(score.gain) - roots.mean) / roots.deviation).max(contrasts.z(score.contrast))
    }

    /// The larger of the weights of gain and contrast.
    pub fn weight(&self, kind: EffectKind, score: &Score) -> f64 {
        // A kind that doesn't gain says nothing, however rare its small loss is.
        if score.gain <= 0.0 {
            return 0.0;
        }
        let of_gain = self.roots.get(&kind).map_or(0.0, |roots| roots.weight(root(score.gain)));
        let of_contrast = self.contrasts.get(&kind).map_or(0.0, |contrasts| contrasts.weight(score.contrast));
        // Increments err independently of each other. A likelihood ratio of e^g has a chance of e^-g then (Markov's inequality), however
        // few permutations gain anything.
        let most = if is_of_odometry(kind) { score.gain } else { f64::INFINITY };
        of_gain.max(of_contrast).min(most)
    }

    fn most(&self, best: &Best, is_among: &dyn Fn(EffectKind) -> bool) -> f64 {
        let among = best.iter().filter(|(kind, _)| is_among(**kind));
        among.map(|(&kind, score)| self.weight(kind, score)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Whether the logs are so far beyond all permutations that more of them would not make them logs without a change.
    pub fn is_clearly_off(&self, own: &Best) -> bool {
        self.all.last().is_some_and(|most| self.most(own, &|_| true) > most + FARTHER)
    }

    /// Share of logs without a change that are as far off.
    pub fn p(&self, own: &Best) -> f64 {
        share_above(&self.all, self.most(own, &|_| true))
    }

    /// The same of the kinds that are of the same data as this one. Readings and odometry are different data: a change of one says
    /// nothing of the other. Where [`Null::p`] is below a level, too, a name at this level is false no more often than that
    /// (Marcus, Peritz and Gabriel 1976: a closed test).
    pub fn p_beside(&self, kind: EffectKind, own: &Best) -> f64 {
        share_above(self.beside(kind), self.most_beside(kind, own))
    }

    /// The largest weight of the kinds that are of the same data as this one.
    pub fn most_beside(&self, kind: EffectKind, own: &Best) -> f64 {
        self.most(own, &|other| is_of_odometry(other) == is_of_odometry(kind))
    }

    /// The weight that the largest one of the kinds of the same data exceeds with this chance where nothing changed.
    pub fn least_weight(&self, kind: EffectKind, chance: f64) -> f64 {
        let largest = self.beside(kind);
        let beyond = (chance * largest.len() as f64) as usize;
        let at = largest.len().checked_sub(beyond + 1);
        at.map_or(f64::INFINITY, |at| largest[at])
    }

    fn beside(&self, kind: EffectKind) -> &[f64] {
        if is_of_odometry(kind) { &self.odometry } else { &self.readings }
    }
}

/// Share of weights that are as large, one's own counted.
fn share_above(sorted: &[f64], weight: f64) -> f64 {
    let above = sorted.len() - sorted.partition_point(|&other| other < weight);
    (above as f64 + 1.0) / (sorted.len() as f64 + 1.0)
}

/// The least scale of a root, that of independent readings: a kind that gains in few permutations isn't found by one reading.
const LEAST_SCALE: f64 = 1.0;
/// A tail is of no fewer values.
const FEWEST: usize = 4;

#[cfg(test)]
mod tests {
    use locsim_world::effect::EffectKind as E;

    use super::*;

    fn of(kind: EffectKind, gain: f64, contrast: f64) -> Best {
        Best::from([(kind, Score { gain, contrast, index: 0 })])
    }

    /// Quantiles of Student's distribution with 15 degrees of freedom: 2.131 at .975, 2.947 at .995.
    #[test]
    fn contrasts_weigh_as_student_s_table_has_it() {
        let others = [-1.0, 1.0].repeat(100);
        for (kind, sides) in [(E::OdomDistanceScale, 2.0), (E::RangeBias, 1.0)] {
            let contrasts = Contrasts::new(kind, &others, 16);
            let deviation = contrasts.deviation;
            for (quantile, tail) in [(2.131, 0.025), (2.947, 0.005)] {
                let chance = (-contrasts.weight(quantile * deviation)).exp();
                // The table has four digits.
                assert!((chance / (sides * tail) - 1.0).abs() < 2e-3, "{kind:?} {chance}");
            }
            let of_other_side = (-contrasts.weight(-2.131 * deviation)).exp();
            let expected = if sides == 2.0 { 0.05 } else { 0.975 };
            assert!((of_other_side - expected).abs() < 1e-4, "{kind:?} {of_other_side}");
        }
    }

    /// A kind that loses in each permutation isn't found where it gains hardly anything, and is where it gains much.
    #[test]
    fn a_gain_of_nothing_is_no_discovery() {
        let others: Vec<Best> = (0..99).map(|i| of(E::MissingObject, -50.0 - f64::from(i), -3.0)).collect();
        let least = Score { gain: 0.5, contrast: 0.1, index: 0 };
        let much = Score { gain: 40.0, ..least };
        let null = Null::new(&of(E::MissingObject, 0.5, 0.1), &others, 16);
        let needed = -0.01_f64.ln();
        assert!(null.weight(E::MissingObject, &least) < needed);
        assert!(null.weight(E::MissingObject, &much) > needed);
    }

    /// Half a nat of an odometry that gains in no permutation is no discovery.
    #[test]
    fn an_odometry_is_no_surer_than_its_likelihood_ratio() {
        let others: Vec<Best> = (0..99).map(|_| of(EffectKind::WheelSlip, -5.0, -1.0)).collect();
        let weight = |gain| {
            let own = of(EffectKind::WheelSlip, gain, 3.0);
            Null::new(&own, &others, 16).weight(EffectKind::WheelSlip, &own[&EffectKind::WheelSlip])
        };
        assert!(weight(0.6) <= 0.6 && weight(40.0) > -0.01_f64.ln());
    }

    /// A change of the odometry that no permutation has stands out more than readings that gain more, as they do in permutations.
    #[test]
    fn readings_and_odometry_stand_out_apart() {
        let both = |readings: f64, odometry: f64| {
            let mut best = of(E::RangeNoise, readings, 0.0);
            best.extend(of(E::OdomDistanceScale, odometry, 0.0));
            best
        };
        let others: Vec<Best> = (0..199).map(|i| both(f64::from(i), f64::from(i % 5) / 5.0)).collect();
        let own = both(196.5, 60.0);
        let null = Null::new(&own, &others, 16);
        assert!(null.p(&own) <= 0.01);
        assert!(null.p_beside(E::OdomDistanceScale, &own) <= 0.01);
        assert!(null.p_beside(E::RangeNoise, &own) > 0.01);
        assert_eq!(null.p_beside(E::RangeBias, &own), null.p_beside(E::RangeNoise, &own));
        assert!(null.most_beside(E::OdomImbalance, &own) > null.most_beside(E::RangeNoise, &own));
    }

    /// What gains on all of today's stretches is found by its contrast, although permutations gain more: they mix stretches that
    /// gain with others.
    #[test]
    fn a_contrast_finds_what_permutations_hide() {
        let others: Vec<Best> =
            (0..99).map(|i| of(E::OdomDistanceScale, f64::from(i), f64::from(i % 5 - 2))).collect();
        let own = of(E::OdomDistanceScale, 50.0, 12.0);
        assert!(Null::new(&own, &others, 16).p(&own) <= 0.01);
        let unsure = of(E::OdomDistanceScale, 50.0, 1.0);
        assert!(Null::new(&unsure, &others, 16).p(&unsure) > 0.2);
    }
}
