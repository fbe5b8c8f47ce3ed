//! Effects fitted to today's log, and their net gain over an assignment's baseline.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

use locsim_core::Progress;
use locsim_gap::GapError;
use locsim_world::effect::{Effect, Moves, Role};
use locsim_world::simulation::OdometryModel;

use super::BaselineOptions;
use super::assignment::Assignment;
use super::given::Given;
use super::increments::{Increments, is_of_odometry};
use super::learnt::Learnt;
use super::neighbours::Neighbours;
use super::pool::{Expected, Pool};
use super::trials::{Trial, of_object, usual};

/// Halvings of the steps of a fit.
const HALVINGS: usize = 6;
/// Gain that each parameter has to have (nats); see [`locsim_gap::find`]'s choice.
const BY_CHANCE: f64 = 1.92;
/// A step of a fit gains at least this (nats).
const LEAST_MORE: f64 = 0.01;

/// What a search has at hand.
pub(super) struct Search<'a> {
    pub pool: &'a Pool<'a>,
    pub increments: Increments,
    pub neighbours: Neighbours,
    pub options: &'a BaselineOptions,
    pub progress: &'a dyn Progress,
    pub stop: &'a AtomicBool,
}

/// The distributions that are learnt from an assignment's baseline.
pub(super) struct Known {
    pub learnt: Learnt,
    pub usual: OdometryModel,
}

/// What an effect changes.
pub(super) enum Change {
    /// Readings of today's log beside the given effects, and of the baseline where those differ.
    Readings { today: Trial, baseline: Option<Trial> },
    /// The odometry, beside the given effects of today's log.
    Odometry { effect: Effect, given: Given },
}

/// An effect near a fit, with its gain on today's log (nats).
struct Near {
    effect: Effect,
    change: Change,
    gain: f64,
}

/// An effect with its net gain on today's stretches (nats).
#[derive(Clone)]
pub(super) struct Fit {
    pub effect: Effect,
    pub gains: Vec<f64>,
}

impl Fit {
    pub fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }

    /// Less what its parameters gain by chance.
    pub fn worth(&self) -> f64 {
        self.gain() - BY_CHANCE * self.effect.values.len() as f64
    }
}

impl Search<'_> {
    pub fn learn(&self, assignment: &Assignment) -> Known {
        Known {
            learnt: Learnt::new(self.pool, &assignment.is_baseline),
            usual: self.increments.learn(&assignment.is_baseline),
        }
    }

    /// Log density of readings without more effects.
    pub fn log_density(&self, learnt: &Learnt, expected: &[Expected]) -> Vec<f64> {
        let readings = self.pool.readings.iter().zip(expected);
        readings
            .map(|(reading, expected)| learnt.density(reading.stretch, expected, reading.z).ln())
            .collect()
    }

    /// The expected readings with these effects.
    pub fn expected_with(&self, effects: &[Effect]) -> Result<Vec<Expected>, GapError> {
        let on_laser: Vec<Effect> = effects
            .iter()
            .filter(|effect| !is_of_odometry(effect.kind))
            .map(|effect| effect.bursts().map_or_else(|| effect.clone(), |bursts| bursts.spread))
            .collect();
        let (objects, others): (Vec<Effect>, Vec<Effect>) =
            on_laser.into_iter().partition(|effect| effect.kind.moves() == Moves::Objects);
        let mut expected = usual(self.pool);
        if !others.is_empty() {
            let world = self.pool.world(&others)?;
            let readings = self.pool.readings.iter().zip(&mut expected);
            readings.for_each(|(reading, expected)| *expected = self.pool.expected(&world, reading));
        }
        for object in &objects {
            for (index, met) in of_object(self.pool, object, &expected) {
                expected[index as usize] = met;
            }
        }
        Ok(expected)
    }

    /// What an effect changes beside the given ones.
    pub fn change(&self, effect: Effect, given: &Given, expected: &[Expected]) -> Result<Change, GapError> {
        let given = given.of_these(|other| is_of_odometry(other.kind) == is_of_odometry(effect.kind));
        if is_of_odometry(effect.kind) {
            return Ok(Change::Odometry { effect, given });
        }
        let today = Trial::new(self.pool, &given, effect.clone(), expected, None)?;
        let baseline = if given.effects.is_empty() {
            None
        } else {
            Some(Trial::new(self.pool, &given.of_these(|_| false), effect, &usual(self.pool), None)?)
        };
        Ok(Change::Readings { today, baseline })
    }

    /// Gain of a change on each of today's stretches (nats). `logs` are log densities of the readings without and with the given effects.
    pub fn today(
        &self,
        change: &Change,
        logs: &[Vec<f64>; 2],
        assignment: &Assignment,
        known: &Known,
    ) -> Vec<f64> {
        match change {
            Change::Readings { today, .. } => {
                today.gains(self.pool, &known.learnt, &logs[1], &assignment.is_today)
            }
            Change::Odometry { effect, given } => {
                self.increments.gains(&known.usual, &given.effects, effect, &assignment.is_today)
            }
        }
    }

    /// Net gain of a change on today's stretches (nats).
    pub fn net(
        &self,
        change: &Change,
        logs: &[Vec<f64>; 2],
        assignment: &Assignment,
        known: &Known,
    ) -> Vec<f64> {
        let used = &assignment.is_baseline;
        let baseline = match change {
            Change::Readings { today, baseline } => {
                baseline.as_ref().unwrap_or(today).gains(self.pool, &known.learnt, &logs[0], used)
            }
            Change::Odometry { effect, .. } => self.increments.gains(&known.usual, &[], effect, used),
        };
        assignment.net(&self.today(change, logs, assignment, known), &baseline)
    }

    /// The probabilities that an effect's bursts last in each of today's windows of time; `None` of an effect without bursts.
    pub fn lasting(
        &self,
        effect: &Effect,
        given: &Given,
        expected: &[Expected],
        logs: &[Vec<f64>; 2],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<Option<HashMap<u32, f64>>, GapError> {
        if effect.bursts().is_none() {
            return Ok(None);
        }
        let given = given.of_these(|other| !is_of_odometry(other.kind));
        let trial = Trial::new(self.pool, &given, effect.clone(), expected, None)?;
        Ok(trial.burst_probabilities(self.pool, &known.learnt, &logs[1], &assignment.is_today))
    }

    /// Log densities of the readings without and with the given effects.
    pub fn log_densities(&self, known: &Known, expected: &[Expected]) -> [Vec<f64>; 2] {
        [&usual(self.pool)[..], expected].map(|expected| self.log_density(&known.learnt, expected))
    }

    /// The strength near a trial that gains most on today's log, by a pattern search (Hooke and Jeeves 1961). What the baseline gains
    /// says whether there is a change, and not how strong it is: where a few of its readings look like the effect's, the net gain of
    /// a share grows on far beyond the share of today's.
    pub fn fit(
        &self,
        start: Effect,
        given: &Given,
        expected: &[Expected],
        logs: &[Vec<f64>; 2],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<Fit, GapError> {
        let at = |effect: Effect| -> Result<Near, GapError> {
            if self.stop.load(Ordering::Relaxed) {
                return Err(GapError::Interrupted);
            }
            let change = self.change(effect.clone(), given, expected)?;
            let gain = self.today(&change, logs, assignment, known).iter().sum();
            Ok(Near { effect, change, gain })
        };
        let mut best = at(start)?;
        let kind = best.effect.kind;
        let mut share = 0.5;
        for _ in 0..HALVINGS {
            let before = best.effect.clone();
            for (i, parameter) in kind.parameters().iter().enumerate() {
                // Places of both logs are too few for what an effect may do without.
                if parameter.role == Role::Step || parameter.is_extra() {
                    continue;
                }
                for sign in [1.0, -1.0] {
                    loop {
                        let value = best.effect.values[i];
                        let step = match parameter.role {
                            // The edge of a sector is between two beams.
                            Role::Position { first_step } if parameter.unit == "rad" => {
                                2.0 * first_step.max(self.pool.beam_spacing_rad())
                            }
                            Role::Position { first_step } => 2.0 * first_step,
                            Role::Shape(_) => value.abs().max(0.1 * parameter.start.abs()),
                            _ => parameter.typical_step(value),
                        };
                        let mut effect = best.effect.clone();
                        effect.values[i] = (value + sign * share * step).clamp(parameter.lo, parameter.hi);
                        let more = at(effect)?;
                        if more.gain <= best.gain + LEAST_MORE {
                            break;
                        }
                        best = more;
                    }
                }
            }
            // On along the way: parameters that stand for each other lead along a ridge.
            let mut from = before;
            loop {
                let mut effect = best.effect.clone();
                let ends = effect.values.iter_mut().zip(&from.values).zip(kind.parameters());
                ends.for_each(|((value, from), parameter)| {
                    *value = (2.0 * *value - from).clamp(parameter.lo, parameter.hi);
                });
                if effect == best.effect {
                    break;
                }
                let more = at(effect)?;
                if more.gain <= best.gain + LEAST_MORE {
                    break;
                }
                from = std::mem::replace(&mut best, more).effect;
            }
            share *= 0.5;
        }
        Ok(Fit { gains: self.net(&best.change, logs, assignment, known), effect: best.effect })
    }
}
