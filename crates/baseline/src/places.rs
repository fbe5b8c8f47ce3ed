//! Effects at one place: panes, displaced walls, objects.
//!
//! Some change of one place is in any two logs: a door, a person. Permutations of stretches can't tell how rare a place is that few
//! stretches see. But the places of both logs can: the best place is held against the next ones, those included where the baseline
//! differs from today's log as today's log does from the baseline. Were it one of them, its distance to the next would be
//! exponential with their scale (Renyi 1953). The others say how large that is. They are few, and it is no smaller than that of independent readings.
//!
//! A wall that has moved is judged by the root of its gain. An object or a pane has to gain, too, and is judged by how many beams it
//! stops or lets through in either log: by the Bayes factor of two shares over one, which knows how often the baseline has looked.

use std::collections::BTreeMap;

use glam::DVec2;
use locsim_gap::GapError;
use locsim_world::effect::{Effect, EffectKind, Moves};
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, Gamma};
use statrs::function::beta::ln_beta;

use super::assignment::Assignment;
use super::fitting::{Known, Search};
use super::given::Given;
use super::null::root;
use super::pool::{CLASSES, Expected, REACH_M, is_of_outcomes};
use super::trials::{Trial, usual};

/// Places nearer to each other count as one \[m\].
const APART_M: f64 = 2.5;
/// The places that the best one is held against.
const OTHERS: usize = 10;
/// The scale of scores of independent readings, about.
const LEAST_SCALE: f64 = 1.0;
/// Objects whose position is fitted before they are compared: those that gain most.
const FITTED_OBJECTS: usize = 15;
/// Kinds of effect at a place.
const KINDS: f64 = 3.0;
/// A reading of an object lies this near to its face \[m\].
const AT_OBJECT_M: f32 = 0.2;
/// Both numbers of the prior of a share, a beta distribution (Jeffreys 1946).
const JEFFREYS: f64 = 0.5;
/// Places by the kind of effect.
pub(super) type Places = BTreeMap<EffectKind, Vec<Place>>;

/// An effect at a place, with its gain (nats) and how far it stands out.
#[derive(Clone)]
pub(super) struct Place {
    pub effect: Effect,
    pub gain: f64,
    /// Root of twice the gain, or of an object or a pane the Bayes factor (nats); at least 0.
    score: f64,
}

impl Place {
    fn is_near(&self, other: &Self) -> bool {
        self.center().distance(other.center()) < APART_M
    }

    /// Whether it is about a point \[m\].
    pub fn is_at(&self, point: DVec2) -> bool {
        self.gain > 0.0 && self.center().distance(point) < APART_M
    }

    fn center(&self) -> DVec2 {
        match self.effect.place.first() {
            Some([a, b]) => 0.5 * (*a + *b),
            None => DVec2::new(self.effect.values[0], self.effect.values[1]),
        }
    }
}

/// The place where a kind gains most.
pub(super) struct Best {
    pub place: Place,
    /// How far it is beyond the best other place, in their scale.
    pub z: f64,
    /// Chance that some kind's best place stands out as much.
    pub p: f64,
}

impl Best {
    /// Holds the best place of today's log against all others of both directions; `None` where nothing was tried.
    fn new(today: &[Place], baseline: &[Place]) -> Option<Self> {
        let best = today.iter().max_by(|a, b| a.score.total_cmp(&b.score))?;
        let mut all: Vec<&Place> = today.iter().chain(baseline).collect();
        all.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut others: Vec<&Place> = Vec::new();
        for place in all {
            if others.len() > OTHERS {
                break;
            }
            if !place.is_near(best) && others.iter().all(|other| !other.is_near(place)) {
                others.push(place);
            }
        }
        // Where nothing is tried nothing gains.
        let score = |i: usize| others.get(i).map_or(0.0, |other| other.score);
        let excess: f64 = (0..OTHERS).map(|i| score(i) - score(OTHERS)).sum();
        let beyond = best.score - score(0);
        let z = beyond / (excess / OTHERS as f64).max(LEAST_SCALE);
        Some(Self { place: best.clone(), z, p: (KINDS * chance_beyond(beyond.max(0.0), excess)).min(1.0) })
    }

    /// The best place of each kind.
    pub fn all(today: &Places, baseline: &Places) -> BTreeMap<EffectKind, Self> {
        let best = |(kind, places): (&EffectKind, &Vec<Place>)| {
            let of_baseline = baseline.get(kind).map_or(&[][..], |places| places);
            Some((*kind, Self::new(places, of_baseline)?))
        };
        today.iter().filter_map(best).collect()
    }
}

/// Chance that an exponential number is larger than `beyond` where [`OTHERS`] of its scale sum up to `sum`, a scale below [`LEAST_SCALE`] being as that. Of
/// scales whose prior is 1 / scale, the inverse has a gamma distribution then.
fn chance_beyond(beyond: f64, sum: f64) -> f64 {
    // The part of the distribution below the inverse of the least scale, if its rate is such.
    let below = |rate: f64| {
        Gamma::new(OTHERS as f64, rate.max(f64::MIN_POSITIVE))
            .map_or(1.0, |gamma| gamma.cdf(1.0 / LEAST_SCALE))
    };
    let of_larger = (sum / (sum + beyond).max(f64::MIN_POSITIVE)).powi(OTHERS as i32) * below(sum + beyond);
    of_larger + (1.0 - below(sum)) * (-beyond / LEAST_SCALE).exp()
}

impl Search<'_> {
    /// The places where today's log gains, by kind.
    pub fn places(
        &self,
        placed: &[Trial],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<Places, GapError> {
        let none = Given::none();
        let expected = usual(self.pool);
        let logs = self.log_densities(known, &expected);
        let used = assignment.used();
        let mut places = Places::new();
        for trial in placed {
            let gains = trial.gains(self.pool, &known.learnt, &logs[0], &used);
            let gain = assignment.net(&gains, &gains).iter().sum();
            let effect = trial.effect.clone();
            let score = self.score(&effect, gain, &trial.changed, assignment);
            places.entry(effect.kind).or_default().push(Place { effect, gain, score });
        }
        for (_, places) in places.iter_mut().filter(|(kind, _)| kind.moves() == Moves::Objects) {
            places.sort_by(|a, b| b.score.total_cmp(&a.score).then(b.gain.total_cmp(&a.gain)));
            let most = places.len().min(FITTED_OBJECTS);
            places[..most].par_iter_mut().try_for_each(|place| -> Result<(), GapError> {
                let fit = self.fit(place.effect.clone(), &none, &expected, &logs, assignment, known)?;
                let changed = Trial::new(self.pool, &none, fit.effect.clone(), &expected, None)?.changed;
                let score = self.score(&fit.effect, fit.gain(), &changed, assignment);
                *place = Place { gain: fit.gain(), effect: fit.effect, score };
                Ok(())
            })?;
        }
        Ok(places)
    }

    /// How far an effect stands out at its place.
    fn score(&self, effect: &Effect, gain: f64, changed: &[(u32, Expected)], assignment: &Assignment) -> f64 {
        if gain <= 0.0 {
            0.0
        } else if is_of_outcomes(effect.kind) {
            self.bayes_factor(effect, changed, assignment).max(0.0)
        } else {
            root(gain)
        }
    }

    /// Logarithm of the Bayes factor of two shares of beams that an effect acts on, of the baseline and of today, over one share of both;
    /// 0 where today's is smaller. Losses grow with incidence, and each class has shares of its own.
    fn bayes_factor(&self, effect: &Effect, changed: &[(u32, Expected)], assignment: &Assignment) -> f64 {
        let max = self.pool.nominal.laser.max_range_m as f32;
        let is_object = effect.kind.moves() == Moves::Objects;
        let mut scans: BTreeMap<(usize, usize, usize), [f64; 2]> = BTreeMap::new();
        for &(index, expected) in changed {
            let reading = &self.pool.readings[index as usize];
            let error = reading.z - if is_object { expected.mean } else { reading.expected.mean };
            let border = if is_object { AT_OBJECT_M } else { REACH_M as f32 };
            if error < -border {
                // Something nearer hides the place.
                continue;
            }
            let is_acted_on = if is_object { error < border } else { error > border || reading.z >= max };
            let is_today = usize::from(assignment.is_today[reading.stretch as usize]);
            let class = if is_object { 0 } else { usize::from(self.pool.class_of[expected.place as usize]) };
            let scan = reading.index / self.pool.logs[reading.log].views.per_scan;
            scans.entry((class, is_today, scan)).or_default()[usize::from(is_acted_on)] += 1.0;
        }
        let counts = |class: usize, is_today: usize| {
            let own = scans.range((class, is_today, 0)..=(class, is_today, usize::MAX));
            effective(&own.map(|(_, counts)| *counts).collect::<Vec<_>>())
        };
        (0..CLASSES).map(|class| factor_of_shares(counts(class, 0), counts(class, 1))).sum()
    }

    /// The places where the baseline gains, held against today's log.
    pub fn places_of_baseline(&self, placed: &[Trial], assignment: &Assignment) -> Result<Places, GapError> {
        let Assignment { is_baseline, is_today } = assignment.clone();
        let turned = Assignment { is_baseline: is_today, is_today: is_baseline };
        let known = self.learn(&turned);
        self.places(placed, &turned, &known)
    }
}

/// The sums of the scans' counts, over the ratio of the variance of their share between scans to that of independent beams (Rao and
/// Scott 1992): one who walks by hides all beams of a scan alike.
fn effective(scans: &[[f64; 2]]) -> [f64; 2] {
    let [passed, acted_on] = [0, 1].map(|which| scans.iter().map(|counts| counts[which]).sum::<f64>());
    let all = passed + acted_on;
    let share = (acted_on + JEFFREYS) / (all + 2.0 * JEFFREYS);
    let squares =
        scans.iter().map(|[passed, acted_on]| (acted_on - share * (passed + acted_on)).powi(2)).sum::<f64>();
    let ratio = match scans.len() {
        0 => 1.0,
        // All of it may be one event.
        1 => all,
        n => n as f64 / (n as f64 - 1.0) * squares / (all * share * (1.0 - share)),
    };
    [passed, acted_on].map(|count| count / ratio.max(1.0))
}

/// The factor of one class; counts are of beams that an effect doesn't act on, and that it does.
fn factor_of_shares(baseline: [f64; 2], today: [f64; 2]) -> f64 {
    let (of_baseline, of_today) = (baseline[0] + baseline[1], today[0] + today[1]);
    if of_baseline == 0.0 || of_today == 0.0 || today[1] * of_baseline <= baseline[1] * of_today {
        return 0.0;
    }
    let evidence = |[passed, acted_on]: [f64; 2]| ln_beta(passed + JEFFREYS, acted_on + JEFFREYS);
    let both = [baseline[0] + today[0], baseline[1] + today[1]];
    evidence(baseline) + evidence(today) - evidence(both) - evidence([0.0; 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, root: f64) -> Place {
        let effect = Effect::new(EffectKind::MissingObject, vec![x, 0.0, 0.2], Vec::new()).unwrap();
        Place { effect, gain: 0.5 * root * root, score: root }
    }

    /// Against integrals of the likelihoods over the shares.
    #[test]
    fn shares_that_differ_outweigh_one_share() {
        // Integrals of x^(a-1) (1-x)^(b-1) by the midpoint rule, without the beta function.
        let integral = |a: f64, b: f64| -> f64 {
            // x = sin^2 t takes the roots at the ends away.
            let n = 20_000_u32;
            let step = std::f64::consts::FRAC_PI_2 / f64::from(n);
            (0..n)
                .map(|i| (f64::from(i) + 0.5) * step)
                .map(|t| 2.0 * t.sin().powf(2.0 * a - 1.0) * t.cos().powf(2.0 * b - 1.0) * step)
                .sum()
        };
        let expected =
            (integral(10.5, 0.5) * integral(2.5, 8.5) / integral(0.5, 0.5) / integral(12.5, 8.5)).ln();
        assert!((factor_of_shares([10.0, 0.0], [2.0, 8.0]) - expected).abs() < 1e-6, "{expected}");
        // What the baseline has more of, or never looked at, says nothing.
        assert_eq!(factor_of_shares([2.0, 8.0], [10.0, 0.0]), 0.0);
        assert_eq!(factor_of_shares([0.0, 0.0], [2.0, 8.0]), 0.0);
    }

    /// Twenty beams of five scans: hidden independently, or all four of a scan at once, which counts as a scan.
    #[test]
    fn beams_of_a_scan_that_are_hidden_together_count_once() {
        let apart = effective(&[[2.0, 2.0]; 5]);
        assert_eq!(apart, [10.0, 10.0]);
        let together = effective(&[[4.0, 0.0], [0.0, 4.0], [4.0, 0.0], [0.0, 4.0], [4.0, 0.0]]);
        let counted = together[0] + together[1];
        assert!((3.0..5.0).contains(&counted) && (together[0] / counted - 0.6).abs() < 1e-12, "{together:?}");
        assert_eq!(effective(&[[0.0, 7.0]]), [0.0, 1.0]);
        // A wall that loses all returns is sure in all of them.
        assert_eq!(effective(&[[0.0, 7.0]; 3]), [0.0, 21.0]);
    }

    /// Against the integral over scales.
    #[test]
    fn a_scale_that_few_say_is_no_smaller_than_one() {
        for (beyond, sum) in [(8.0, 0.6), (16.0, 18.0), (5.0, 9.0), (0.0, 4.0)] {
            let (mut all, mut above) = (0.0, 0.0);
            for i in 0..400_000_u32 {
                // The logarithm of the scale, whose prior is flat.
                let scale = (-8.0 + 16.0 * (f64::from(i) + 0.5) / 4e5_f64).exp();
                let weight = scale.powi(-(OTHERS as i32)) * (-sum / scale).exp();
                all += weight;
                above += weight * (-beyond / scale.max(1.0)).exp();
            }
            let chance = chance_beyond(beyond, sum);
            assert!((chance / (above / all) - 1.0).abs() < 1e-4, "{beyond} {sum}: {chance} {}", above / all);
        }
    }

    /// Eleven others with roots 2 above the least of them on average, and a best place beside the largest one, of root 6.
    #[test]
    fn a_place_stands_out_by_its_distance_to_the_next() {
        let others = |direction: usize| -> Vec<Place> {
            let roots = [6.0, 5.0, 4.0, 4.0, 4.0, 4.0, 3.0, 3.0, 3.0, 4.0, 2.0];
            let places = roots.into_iter().enumerate().filter(|(i, _)| i % 2 == direction);
            places.map(|(i, root)| at(10.0 * i as f64, root)).collect()
        };
        let best_of = |root: f64| {
            let mut today = others(0);
            // What is seen beside it is the same place.
            today.extend([at(-10.0, root), at(-9.0, 0.9 * root)]);
            Best::new(&today, &others(1)).unwrap()
        };
        let found = best_of(26.0);
        assert!(
            (found.z - 10.0).abs() < 1e-9 && (found.p - 3.0 * 2.0_f64.powi(-10)).abs() < 1e-9,
            "{}",
            found.z
        );
        assert_eq!(best_of(5.5).p, 1.0);
        // Beside nothing the scale is 1.
        let alone = Best::new(&[at(0.0, 10.0)], &[]).unwrap();
        assert!((alone.z - 10.0).abs() < 1e-9 && (alone.p - 3.0 * (-10.0_f64).exp()).abs() < 1e-12);
        assert!(Best::new(&[], &others(1)).is_none());
    }
}
