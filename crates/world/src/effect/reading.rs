//! A beam's return while effects act on it.

use super::beam::tan_squared;
use super::{Alternative, Alternatives, BeamView, HitKind};
use crate::options::LaserOptions;

/// A beam with what it meets.
pub(crate) struct Hit<'a> {
    pub laser: &'a LaserOptions,
    pub view: &'a BeamView,
    pub met: HitKind,
    /// Range of what the beam meets \[m\].
    pub range: f64,
    /// Whether that is the wall of the map, moved as it may be.
    pub mapped: bool,
    /// Maximum range \[m\].
    pub max: f64,
    /// Probability that the bursts of the effect with this index, which have this share, fall on the beam.
    pub burst: &'a dyn Fn(usize, f64) -> f64,
    /// Index of the effect that is asked.
    pub index: usize,
}

/// The return of a beam: N(`scale` r + `bias` + `wall_bias`, ((sigma(r) + `growth` r^2) `wall_sigma`)^2), r the range of
/// what the beam meets.
pub(crate) struct Return<'a> {
    pub scale: f64,
    pub bias: f64,
    /// Of the wall or object that is met alone.
    pub wall_bias: f64,
    pub wall_sigma: f64,
    pub growth: f64,
    /// Probability of the tail.
    pub tail: f64,
    pub step_m: f64,
    alternatives: &'a mut Alternatives,
}

impl<'a> Return<'a> {
    /// The nominal return.
    pub fn new(laser: &LaserOptions, alternatives: &'a mut Alternatives) -> Self {
        Self {
            scale: 1.0,
            bias: 0.0,
            wall_bias: 0.0,
            wall_sigma: 1.0,
            growth: 0.0,
            tail: 0.0,
            step_m: laser.resolution_m,
            alternatives,
        }
    }

    /// Adds what is read instead, with a probability, where nothing before it is.
    pub fn or(&mut self, probability: f64, alternative: Alternative) {
        self.alternatives.push(probability, alternative);
    }
}

impl Hit<'_> {
    /// Whether what is met lies within the maximum range.
    pub fn is_in_range(&self) -> bool {
        self.range < self.max
    }

    /// tan^2 of the incidence on a wall, 0 on a block.
    pub fn tan_squared(&self) -> f64 {
        if self.met == HitKind::Wall { tan_squared(self.view.incidence) } else { 0.0 }
    }

    /// Nominal standard deviation at a range \[m\].
    pub fn sigma(&self, range: f64) -> f64 {
        self.laser.sigma_m + self.laser.sigma_per_m * range
    }

    /// Probability that the bursts of the effect at hand, of this share, fall on the beam.
    pub fn burst(&self, share: f64) -> f64 {
        (self.burst)(self.index, share)
    }
}
