//! Effects: the named ways in which a real world may differ from the nominal simulator.
//!
//! An [`Effect`] has a kind, numbers and, where it acts on a stretch of wall, a place. [`Effects`] are all those of a
//! world. What they do to a beam is a [`ReadingDistribution`]: one definition that both samples readings and tells their
//! density, so that what is simulated and what is fitted can't drift apart. At its neutral value an effect is the
//! identity, bit for bit.

mod disc;
mod distribution;
mod error;
mod kind;
mod odometry;
mod set;
#[cfg(test)]
pub(crate) mod tests;

use glam::DVec2;
use serde::{Serialize, Serializer};

pub use disc::Disc;
pub use distribution::{Alternative, Alternatives, ReadingDistribution, TAIL_FACTOR};
pub(crate) use distribution::{Parts, as_read};
pub use error::EffectError;
pub use kind::{EffectKind, Parameter, Site};
pub use odometry::{OdometryDistribution, Slip};
pub use set::{BeamView, Effects, HitKind, JUMP_M, Needs, PLACE_REACH_M, burst_window, jump_at};
pub(crate) use set::{burst, slip_draw};

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

    /// The effect at its neutral value, the identity.
    pub fn neutral(kind: EffectKind, place: Vec<[DVec2; 2]>) -> Self {
        Self { kind, values: kind.parameters().iter().map(|parameter| parameter.neutral).collect(), place }
    }
}

fn stretches<S: Serializer>(place: &[[DVec2; 2]], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(place.iter().map(|stretch| stretch.map(|end| end.to_array())))
}
