//! Returns that are lost at some bearings: a dirty, scratched or covered window.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::hash::Hash;

use locsim_core::{Estimate, cell_at, gains_surely, sum_error};
use locsim_gap::WALL_CELL_M;
use serde::Serialize;

use super::fitting::Known;
use super::pool::{Expected, Pool};

/// Parts into which all bearings are cut.
const PARTS: usize = 36;
const PART_RAD: f64 = TAU / PARTS as f64;
/// A share isn't told of fewer readings.
const FEWEST: f64 = 40.0;
/// The least probability of a loss: the baseline may have none at a place by chance.
const LEAST: f64 = 1e-3;
/// A share that is surely larger is shown.
const SHOWN: f64 = 0.05;
/// A share of lost returns is at most this.
const MOST: f64 = 0.99;

/// The share of returns that are lost at some bearings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LossAtBearings {
    /// First and last bearing \[rad\].
    pub bearings: [f64; 2],
    /// Share of the returns that the baseline has there.
    pub share: Estimate,
}

/// Returns that today's log loses, beyond the baseline, by the bearing of the beam.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LossesByBearing {
    /// The parts of the bearings that have been seen often enough, from the right to the left.
    pub parts: Vec<LossAtBearings>,
    /// Log score that they gain on stretches that they weren't learnt from (nats).
    pub gain_nats: f64,
}

impl LossesByBearing {
    /// The stretches of bearings at which returns are surely lost \[rad\]. Parts between which no other has been seen are of one stretch.
    pub fn stretches(&self) -> Vec<[f64; 2]> {
        let lossy = |part: &LossAtBearings| part.share.interval.lo >= SHOWN;
        let runs = self.parts.chunk_by(|a, b| lossy(a) == lossy(b)).filter(|run| lossy(&run[0]));
        runs.map(|run| [run[0].bearings[0], run[run.len() - 1].bearings[1]]).collect()
    }

    /// The bearings at which most returns are lost.
    pub fn most(&self) -> Option<&LossAtBearings> {
        self.parts.iter().max_by(|a, b| a.share.value.total_cmp(&b.share.value))
    }
}

/// A reading of today's log.
struct Outcome {
    stretch: usize,
    part: usize,
    /// The cell of the wall that the beam meets.
    place: [i32; 2],
    /// The baseline's probability of a loss.
    usual: f64,
    is_lost: bool,
}

/// Returns that were expected, and those that were lost beyond the baseline's.
#[derive(Clone, Copy, Default)]
struct Count {
    expected: f64,
    lost: f64,
}

impl Count {
    fn add(&mut self, outcome: &Outcome) {
        self.expected += 1.0 - outcome.usual;
        self.lost += f64::from(u8::from(outcome.is_lost)) - outcome.usual;
    }

    fn without(self, other: Self) -> Self {
        Self { expected: self.expected - other.expected, lost: self.lost - other.lost }
    }

    fn share(self) -> f64 {
        (self.lost / self.expected.max(1.0)).clamp(0.0, MOST)
    }
}

/// Losses by some property of a beam, learnt from today's log.
struct Losses<K> {
    all: HashMap<K, Count>,
    of_stretches: HashMap<(usize, K), Count>,
}

impl<K: Copy + Eq + Hash> Losses<K> {
    fn new(outcomes: &[Outcome], key: impl Fn(&Outcome) -> K) -> Self {
        let mut losses = Self { all: HashMap::new(), of_stretches: HashMap::new() };
        for outcome in outcomes {
            losses.all.entry(key(outcome)).or_default().add(outcome);
            losses.of_stretches.entry((outcome.stretch, key(outcome))).or_default().add(outcome);
        }
        losses
    }

    /// What the shares gain on each of so many stretches, as learnt from all others (nats).
    fn gains(&self, outcomes: &[Outcome], key: impl Fn(&Outcome) -> K, stretches: usize) -> Vec<f64> {
        let mut gains = vec![0.0; stretches];
        for outcome in outcomes {
            let (key, usual) = (key(outcome), outcome.usual);
            let share = self.all[&key].without(self.of_stretches[&(outcome.stretch, key)]).share();
            gains[outcome.stretch] +=
                if outcome.is_lost { (share * (1.0 - usual) / usual).ln_1p() } else { (-share).ln_1p() };
        }
        gains
    }
}

/// Losses by bearing, where they surely gain more on held-out stretches of today's log than each of three others: `rival`, the gain of an
/// effect on each stretch (nats); the same loss of all returns; losses by the place where a beam ends. `expected` is what is
/// expected of each reading without that effect.
pub(super) fn find(
    pool: &Pool<'_>,
    known: &Known,
    expected: &[Expected],
    rival: &[f64],
) -> Option<LossesByBearing> {
    let outcomes = outcomes(pool, known, expected);
    let gains_by_place = Losses::new(&outcomes, |of| of.place).gains(&outcomes, |of| of.place, rival.len());
    let gains_of_all = Losses::new(&outcomes, |_| ()).gains(&outcomes, |_| (), rival.len());
    let losses = Losses::new(&outcomes, |of| of.part);
    let gains = losses.gains(&outcomes, |of| of.part, rival.len());
    let of_today = pool.stretches[0]..;
    let beats = |other: &[f64]| {
        let ahead: Vec<f64> = gains.iter().zip(other).map(|(own, other)| own - other).collect();
        gains_surely(&ahead[of_today.clone()])
    };
    if ![rival, &gains_of_all, &gains_by_place].into_iter().all(beats) {
        return None;
    }
    let part = |part: usize| {
        let whole = losses.all.get(&part).filter(|whole| whole.expected >= FEWEST)?;
        // Stretches are independent, readings of one aren't.
        let of_stretches = of_today.clone().take(rival.len() - pool.stretches[0]);
        let counts = of_stretches.filter_map(|stretch| losses.of_stretches.get(&(stretch, part)));
        let rests: Vec<f64> = counts.map(|of| of.lost - whole.share() * of.expected).collect();
        let from = part as f64 * PART_RAD - PI;
        let share = Estimate::normal(whole.share(), sum_error(&rests) / whole.expected);
        Some(LossAtBearings { bearings: [from, from + PART_RAD], share })
    };
    let parts = (0..PARTS).filter_map(part).collect();
    Some(LossesByBearing { parts, gain_nats: gains.iter().sum() })
        .filter(|found| !found.stretches().is_empty())
}

/// The readings of today's log at places that the baseline has seen.
fn outcomes(pool: &Pool<'_>, known: &Known, expected: &[Expected]) -> Vec<Outcome> {
    let max = pool.nominal.laser.max_range_m as f32;
    let readings = pool.at_shared_places().iter().zip(expected);
    let today = readings.filter(|(reading, expected)| reading.log == 1 && expected.mean.is_finite());
    let outcome = today.map(|(reading, expected)| {
        let view = &pool.beam(reading).view;
        Outcome {
            stretch: reading.stretch as usize,
            part: (((view.bearing + PI).rem_euclid(TAU) / PART_RAD) as usize).min(PARTS - 1),
            place: cell_at(view.endpoint, WALL_CELL_M),
            usual: known.learnt.density(reading.stretch, expected, max).clamp(LEAST, 1.0 - LEAST),
            is_lost: reading.z >= max,
        }
    });
    outcome.collect()
}
