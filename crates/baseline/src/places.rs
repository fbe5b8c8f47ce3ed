//! Effects at one place: panes, displaced walls, objects.
//!
//! Some change of one place is in any two logs: a door, a person. Permutations of stretches can't tell how rare a place is that few
//! stretches see. But the places of both logs can: the best place is held against the next ones, those included where the baseline
//! differs from today's log as today's log does from the baseline. Were it one of them, its distance to the next would be
//! exponential with their scale (Renyi 1953).

use std::collections::BTreeMap;

use glam::DVec2;
use locsim_gap::GapError;
use locsim_world::effect::{Effect, EffectKind, Moves};
use rayon::prelude::*;

use super::assignment::Assignment;
use super::fitting::{Known, Search};
use super::null::root;
use super::trials::{Given, Trial, usual};

/// Places nearer to each other count as one \[m\].
const APART_M: f64 = 2.5;
/// The places that the best one is held against.
const OTHERS: usize = 10;
/// Objects whose position is fitted before they are compared: those that gain most.
const FITTED_OBJECTS: usize = 15;
/// Kinds of effect at a place.
const KINDS: f64 = 3.0;
/// Places by the kind of effect.
pub(super) type Places = BTreeMap<EffectKind, Vec<Place>>;

/// Whether a kind acts at one place.
pub(super) fn is_of_place(kind: EffectKind) -> bool {
    kind.has_place() || kind.moves() == Moves::Objects
}

/// An effect at a place with the root of twice its gain.
#[derive(Clone)]
pub(super) struct Place {
    pub effect: Effect,
    pub gain: f64,
}

impl Place {
    fn root(&self) -> f64 {
        root(self.gain).max(0.0)
    }

    fn is_near(&self, other: &Self) -> bool {
        self.center().distance(other.center()) < APART_M
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
        let best = today.iter().max_by(|a, b| a.gain.total_cmp(&b.gain))?;
        let mut all: Vec<&Place> = today.iter().chain(baseline).collect();
        all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
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
        let root = |i: usize| others.get(i).map_or(0.0, |other| other.root());
        let excess: f64 = (0..OTHERS).map(|i| root(i) - root(OTHERS)).sum();
        // Roots of independent readings have a scale of about 1.
        let scale = (excess / OTHERS as f64).max(1.0);
        let z = (best.root() - root(0)) / scale;
        // The scale is that of ten exponential numbers.
        let p = (KINDS * (1.0 + z.max(0.0) / OTHERS as f64).powi(-(OTHERS as i32))).min(1.0);
        Some(Self { place: best.clone(), z, p })
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

impl Search<'_> {
    /// The places where today's log gains, by kind.
    pub fn places(
        &self,
        placed: &[Trial],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<Places, GapError> {
        let none = Given { effects: Vec::new() };
        let expected = usual(self.pool);
        let logs = self.log_densities(known, &expected);
        let used = assignment.used();
        let mut places = Places::new();
        for trial in placed {
            let gains = trial.gains(self.pool, &known.learnt, &logs[0], &used);
            let gain = assignment.net(&gains, &gains).iter().sum();
            let effect = trial.effect.clone();
            places.entry(effect.kind).or_default().push(Place { effect, gain });
        }
        for (_, places) in places.iter_mut().filter(|(kind, _)| kind.moves() == Moves::Objects) {
            places.sort_by(|a, b| b.gain.total_cmp(&a.gain));
            let most = places.len().min(FITTED_OBJECTS);
            places[..most].par_iter_mut().try_for_each(|place| -> Result<(), GapError> {
                let fit = self.fit(place.effect.clone(), &none, &expected, &logs, assignment, known)?;
                *place = Place { gain: fit.gain(), effect: fit.effect };
                Ok(())
            })?;
        }
        Ok(places)
    }

    /// The places where the baseline gains, held against today's log.
    pub fn places_of_baseline(&self, placed: &[Trial], assignment: &Assignment) -> Result<Places, GapError> {
        let Assignment { is_baseline, is_today } = assignment.clone();
        let turned = Assignment { is_baseline: is_today, is_today: is_baseline };
        let known = self.learn(&turned);
        self.places(placed, &turned, &known)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, root: f64) -> Place {
        let effect = Effect::new(EffectKind::MissingObject, vec![x, 0.0, 0.2], Vec::new()).unwrap();
        Place { effect, gain: 0.5 * root * root }
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
            (found.z - 10.0).abs() < 1e-9 && (found.p - 3.0 * 2.0_f64.powi(-10)).abs() < 1e-12,
            "{}",
            found.z
        );
        assert_eq!(best_of(5.5).p, 1.0);
        // Beside nothing the scale is 1.
        assert!((Best::new(&[at(0.0, 10.0)], &[]).unwrap().z - 10.0).abs() < 1e-9);
        assert!(Best::new(&[], &others(1)).is_none());
    }
}
