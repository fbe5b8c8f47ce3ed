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
use super::null::root;
use super::pool::Expected;
use super::search::{Known, Search};
use super::trials::{Given, Trial, usual};

/// Places nearer to each other count as one \[m\].
const APART_M: f64 = 2.5;
/// The places that the best one is held against.
const OTHERS: usize = 10;
/// Objects whose position is fitted before they are compared: those that gain most.
const FITTED_OBJECTS: usize = 15;
/// Kinds of effect at a place.
const KINDS: f64 = 3.0;

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

/// The best place of a kind.
pub(super) struct Best {
    pub place: Place,
    /// Its distance to the next one, in their scale.
    pub z: f64,
    /// Chance that some kind has a place that stands out as much.
    pub p: f64,
}

/// How far the best place stands out from all others of both directions; `None` where there are too few.
fn stands_out(today: &[Place], baseline: &[Place]) -> Option<Best> {
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
    let (last, others) = others.split_last().filter(|(_, others)| others.len() == OTHERS)?;
    let excess: f64 = others.iter().map(|other| other.root() - last.root()).sum();
    // Independent readings have roots of a scale of about 1.
    let scale = (excess / OTHERS as f64).max(1.0);
    let z = (best.root() - others[0].root()) / scale;
    let p = (KINDS * (1.0 + z.max(0.0) / OTHERS as f64).powi(-(OTHERS as i32))).min(1.0);
    Some(Best { place: best.clone(), z, p })
}

impl Search<'_> {
    /// The places where today's log gains beside the given effects, by kind. `tried` are the trials beside the given effects, `plain`
    /// those beside nothing.
    pub fn places(
        &self,
        [tried, plain]: [&[Trial]; 2],
        given: &Given,
        expected: &[Expected],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<BTreeMap<EffectKind, Vec<Place>>, GapError> {
        let logs = self.log_densities(known, expected);
        let mut places: BTreeMap<EffectKind, Vec<Place>> = BTreeMap::new();
        for trial in tried {
            let Some(plain) = plain.iter().find(|plain| plain.effect == trial.effect) else { continue };
            let today = trial.gains(self.pool, &known.learnt, &logs[1], &assignment.is_today);
            let baseline = plain.gains(self.pool, &known.learnt, &logs[0], &assignment.is_baseline);
            let gain = assignment.net(&today, &baseline).iter().sum();
            let effect = trial.effect.clone();
            places.entry(effect.kind).or_default().push(Place { effect, gain });
        }
        for (_, places) in places.iter_mut().filter(|(kind, _)| kind.moves() == Moves::Objects) {
            places.sort_by(|a, b| b.gain.total_cmp(&a.gain));
            let most = places.len().min(FITTED_OBJECTS);
            places[..most].par_iter_mut().try_for_each(|place| -> Result<(), GapError> {
                let fit = self.fit(place.effect.clone(), given, expected, &logs, assignment, known)?;
                *place = Place { gain: fit.gain(), effect: fit.effect };
                Ok(())
            })?;
        }
        Ok(places)
    }

    /// The places where the baseline gains, held against today's log.
    pub fn places_of_baseline(
        &self,
        placed: &[Trial],
        assignment: &Assignment,
    ) -> Result<BTreeMap<EffectKind, Vec<Place>>, GapError> {
        let Assignment { is_baseline, is_today } = assignment.clone();
        let turned = Assignment { is_baseline: is_today, is_today: is_baseline };
        let known = self.learn(&turned);
        let none = Given { effects: Vec::new() };
        self.places([placed, placed], &none, &usual(self.pool), &turned, &known)
    }
}

/// The best place of each kind.
pub(super) fn best_places(
    today: &BTreeMap<EffectKind, Vec<Place>>,
    baseline: &BTreeMap<EffectKind, Vec<Place>>,
) -> BTreeMap<EffectKind, Best> {
    let best = |(kind, places): (&EffectKind, &Vec<Place>)| {
        Some((*kind, stands_out(places, baseline.get(kind).map_or(&[][..], |places| places))?))
    };
    today.iter().filter_map(best).collect()
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
        let p_of = |root: f64| {
            let mut today = others(0);
            // What is seen beside it is the same place.
            today.extend([at(-10.0, root), at(-9.0, 0.9 * root)]);
            let best = stands_out(&today, &others(1)).unwrap();
            (best.z, best.p)
        };
        let (z, p) = p_of(26.0);
        assert!((z - 10.0).abs() < 1e-9 && (p - 3.0 * 2.0_f64.powi(-10)).abs() < 1e-12, "{z} {p}");
        assert_eq!(p_of(5.5).1, 1.0);
        assert!(stands_out(&others(0), &[]).is_none());
    }
}
