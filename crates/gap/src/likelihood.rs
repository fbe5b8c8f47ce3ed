//! The density of a reading under a hypothesis: nominal world, effects, clutter, an error of the reference pose.

pub(crate) use locsim_core::normal::density as normal_density;
use locsim_world::effect::{Alternative, Effects};
use locsim_world::simulation::{LaserOptions, ReadingMixture};

use crate::views::Beam;

/// Share of a uniform density under everything, so that no single reading can rule a hypothesis out.
const FLOOR: f64 = 1e-6;

/// What one reading says.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Terms {
    /// Density \[1/m\], a probability at the maximum range.
    pub density: f64,
    /// Probability that the reading is of the surface itself, given the reading.
    pub hit: f64,
    /// Density of the distribution of the unobstructed beam.
    pub clear_density: f64,
    /// Probability that no clutter stands before the surface.
    pub clear: f64,
    /// Probability that the reading is of clutter, given the reading.
    pub short: f64,
    /// Factor from a density per metre to one in the measure of these; see [`locsim_world::simulation::MixtureDensity`].
    pub measure: f64,
    /// Reading less the expected one \[m\], and its deviation \[m\]; 0 and infinity for no return.
    pub error: f64,
    pub sigma: f64,
}

/// A hypothesis about the world, for single readings.
#[derive(Clone, Copy)]
pub(crate) struct Density<'a> {
    pub laser: &'a LaserOptions,
    pub effects: &'a Effects,
    /// Factor on the density of clutter.
    pub blocks: f64,
}

impl Density<'_> {
    fn mixture(&self) -> ReadingMixture<'_> {
        ReadingMixture { laser: self.laser, effects: self.effects, clutter_density: self.blocks }
    }

    /// What a reading `z` says; `shift` is added to the range of what stands there \[m\].
    pub fn terms(&self, beam: &Beam, shift: f64, z: f64) -> Terms {
        let max = self.laser.max_range_m;
        let parts = self.mixture().density(beam, shift, z);
        let density = (1.0 - FLOOR) * parts.total + FLOOR / max;
        let is_return = z < max && parts.mean < max;
        Terms {
            density,
            hit: if is_return { (parts.surface / density).min(1.0) } else { 0.0 },
            clear_density: parts.unobstructed,
            clear: parts.clear,
            short: parts.clutter / density,
            measure: parts.measure,
            error: if is_return { z - parts.mean } else { 0.0 },
            sigma: if is_return { parts.sigma } else { f64::INFINITY },
        }
    }

    /// P(reading <= z), for z below the maximum range.
    pub fn cdf(&self, beam: &Beam, shift: f64, z: f64) -> f64 {
        self.mixture().cdf(beam, shift, z)
    }

    /// Density of a reading in which a beam that is not blocked reads by `other` \[1/m\] instead, relative to that by the
    /// hypothesis, less 1: the score of a contamination.
    pub fn contamination(terms: &Terms, other: f64) -> f64 {
        terms.clear * (terms.measure * other - terms.clear_density) / terms.density
    }
}

/// Density of a normal reading of what stands at `mean`.
pub(crate) fn near_density(z: f64, mean: f64, sigma: f64, max: f64) -> f64 {
    Alternative::Near { mean, sigma }.density(z, max)
}
