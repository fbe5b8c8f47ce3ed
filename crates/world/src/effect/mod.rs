//! Effects: the named ways in which a real world may differ from the nominal simulator.
//!
//! An [`Effect`] has a kind, numbers and, where it acts on a stretch of wall, a place. [`Effects`] are all those of a
//! world. What they do to a beam is a [`ReadingDistribution`]: one definition that both samples readings and tells their
//! density, so that what is simulated and what is fitted can't drift apart. At its neutral value an effect is the
//! identity, bit for bit.

mod beam;
mod burst_states;
mod clock;
mod clutter;
mod description;
mod disc;
mod distribution;
mod effect_type;
mod error;
mod false_returns;
mod kind;
mod lost_returns;
mod mount;
mod noise;
mod objects;
mod odometry;
mod parameter;
mod ranges;
mod reading;
mod residual;
mod set;
mod statistic;
#[cfg(test)]
pub(crate) mod tests;
mod walls;

use glam::DVec2;
use locsim_core::{PoseError, distance_to};
use serde::{Serialize, Serializer};

pub use beam::{BeamView, HitKind, JUMP_M, jump_at};
pub use burst_states::{BurstStates, InBurst};
pub use description::{Description, Experiment, Fit, Moves, Needs, Replacement, Site};
pub use disc::Disc;
pub use distribution::{Alternative, Alternatives, ReadingDistribution, TAIL_FACTOR};
pub(crate) use distribution::{Parts, as_read, least_value};
pub use error::EffectError;
pub(crate) use false_returns::burst;
pub use false_returns::burst_window;
pub use kind::EffectKind;
pub(crate) use odometry::slip_draw;
pub use odometry::{OdometryDistribution, OdometryErrors, Slip};
pub use parameter::{Parameter, Prior, Role};
pub use residual::{BeamCovariate, Levels, MOST_VALUES, Moment, Residual, ResidualError};
pub use set::Effects;
pub(crate) use set::Met;
pub use statistic::{Axis, BeamState, Direction, PoseState, Score, Statistic};

/// A beam ends on a stretch of wall if its nominal endpoint is no farther from it than this \[m\].
pub const PLACE_REACH_M: f64 = 0.1;

/// One effect with its numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Effect {
    /// Which.
    pub kind: EffectKind,
    /// Its numbers in SI units, in the order of [`EffectKind::parameters`].
    pub values: Vec<f64>,
    /// The stretches of wall that it acts on, end points in the map frame \[m\]; empty where the kind has no place.
    #[serde(serialize_with = "stretches")]
    pub place: Vec<[DVec2; 2]>,
}

impl Effect {
    /// An effect of `values` in SI units, one per parameter.
    ///
    /// # Errors
    /// [`EffectError`] for a wrong number of values, one out of its range, a place where there is none or the other
    /// way round.
    pub fn new(kind: EffectKind, values: Vec<f64>, place: Vec<[DVec2; 2]>) -> Result<Self, EffectError> {
        if values.len() != kind.parameters().len() {
            return Err(EffectError::Values { kind, got: values.len() });
        }
        for (parameter, &value) in kind.parameters().iter().zip(&values) {
            let (lo, hi) = (parameter.lo, parameter.hi);
            if !(lo..=hi).contains(&value) {
                return Err(EffectError::Value { kind, parameter: parameter.name, value, lo, hi });
            }
        }
        if place.is_empty() == kind.has_place() {
            return Err(EffectError::Place { kind });
        }
        if let Some(index) = place.iter().position(|[a, b]| !(a.is_finite() && b.is_finite() && a != b)) {
            return Err(EffectError::Stretch { kind, index });
        }
        Ok(Self { kind, values, place })
    }

    /// What it does in plain language, with the side to which its strength lies.
    pub fn sentence(&self) -> &'static str {
        if let Some(sentence) = (self.kind.description().sentence_of)(&self.values) {
            return sentence;
        }
        let strength = self.kind.strengths().next();
        match (self.kind.description().sides, strength) {
            (Some([below, above]), Some(i)) => {
                if self.values[i] < self.kind.parameters()[i].neutral {
                    below
                } else {
                    above
                }
            }
            _ => self.kind.sentence(),
        }
    }

    /// Whether it places or turns the laser so differently from another one of its kind that errors of the reference can't be the reason.
    pub fn is_beyond(&self, other: &Self, reference: &PoseError) -> bool {
        /// Standard deviations of the reference's errors.
        const ERRORS: f64 = 3.0;
        let sigma = |parameter: &Parameter| match parameter.unit {
            "rad" => reference.sigma_rad,
            "m" => reference.sigma_m,
            _ => f64::INFINITY,
        };
        let apart = self.values.iter().zip(&other.values).map(|(a, b)| (a - b).abs());
        self.kind.parameters().iter().zip(apart).any(|(parameter, apart)| apart > ERRORS * sigma(parameter))
    }

    /// Its numbers as an array, for a kind with `N` parameters.
    fn numbers<const N: usize>(&self) -> [f64; N] {
        std::array::from_fn(|i| self.values[i])
    }

    /// Whether a point of the map \[m\] is on one of its stretches of wall.
    fn is_at(&self, point: DVec2) -> bool {
        self.stretch_at(point).is_some()
    }

    /// The stretch of wall that a point of the map \[m\] is on.
    pub fn stretch_at(&self, point: DVec2) -> Option<&[DVec2; 2]> {
        self.place.iter().find(|stretch| distance_to(stretch, point) <= PLACE_REACH_M)
    }

    /// The bearings of an effect that acts between two of them, counter-clockwise from the first \[rad\].
    pub fn sector(&self) -> Option<[f64; 2]> {
        Some([self.value("from_rad")?, self.value("to_rad")?])
    }

    /// The value of a parameter by its name, in SI units.
    pub fn value(&self, name: &str) -> Option<f64> {
        let index = self.kind.parameters().iter().position(|parameter| parameter.name == name)?;
        Some(self.values[index])
    }

    /// The states of an effect that comes in bursts; `None` of one that is always there.
    pub fn bursts(&self) -> Option<Bursts> {
        self.kind.effect_type().bursts(self)
    }

    /// The effect at typical values.
    pub fn typical(kind: EffectKind, place: Vec<[DVec2; 2]>) -> Self {
        Self { kind, values: kind.parameters().iter().map(|parameter| parameter.start).collect(), place }
    }

    /// The effect at its neutral value, the identity.
    pub fn neutral(kind: EffectKind, place: Vec<[DVec2; 2]>) -> Self {
        Self { kind, values: kind.parameters().iter().map(|parameter| parameter.neutral).collect(), place }
    }
}

/// An effect that falls on some windows of time (see [`burst_window`]) and not on others.
#[derive(Clone, Debug, PartialEq)]
pub struct Bursts {
    /// Share of the windows that it falls on.
    pub share: f64,
    /// The effect in such a window.
    pub on: Effect,
    /// The effect in any other window.
    pub off: Effect,
    /// An effect that is as strong in each window as this one is on average.
    pub spread: Effect,
}

impl Bursts {
    /// Whether they fall on so few windows, less than a third, that all of them may have been in a few places.
    pub fn are_seldom(&self) -> bool {
        self.share < 1.0 / 3.0
    }
}

fn stretches<S: Serializer>(place: &[[DVec2; 2]], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(place.iter().map(|stretch| stretch.map(|end| end.to_array())))
}
