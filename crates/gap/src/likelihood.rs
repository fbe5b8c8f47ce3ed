//! The density of a reading under a hypothesis: nominal world, effects, unmapped blocks, an error of the reference pose.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use locsim_world::effect::{Alternative, BeamView, Effects, HitKind, ReadingDistribution};
use locsim_world::simulation::LaserOptions;
use statrs::function::erf::erfc;

use crate::views::Beam;

/// Share of a uniform density under everything, so that no single reading can rule a hypothesis out.
const FLOOR: f64 = 1e-6;
/// A step below this share of the noise is as good as none.
const FINE_STEP: f64 = 0.5;
/// Readings of a laser without a resolution are taken as multiples of this \[m\], so that quantized ones can be
/// compared with them.
const FINEST_STEP_M: f64 = 1e-4;

/// What one reading says.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Terms {
    /// Density \[1/m\], a probability at the maximum range.
    pub density: f64,
    /// Probability that the reading is of the surface itself, given the reading.
    pub hit: f64,
    /// Density of the distribution of the unobstructed beam.
    pub clear_density: f64,
    /// Probability that no block stands before the surface.
    pub clear: f64,
    /// Probability that the reading is of a block, given the reading.
    pub short: f64,
    /// Reading less the expected one \[m\], and its deviation \[m\]; 0 and infinity for no return.
    pub error: f64,
    pub sigma: f64,
}

pub(crate) fn normal_density(t: f64) -> f64 {
    (-0.5 * t * t).exp() / (2.0 * PI).sqrt()
}

pub(crate) fn normal_cdf(t: f64) -> f64 {
    0.5 * erfc(-t * FRAC_1_SQRT_2)
}

/// Density of a reading of what a distribution's beam met, alternatives left out: normal with tails, cut at the maximum range.
fn return_density(distribution: &ReadingDistribution, z: f64, max: f64) -> f64 {
    let [tail, factor] = distribution.tail;
    let one = |sigma: f64| {
        if distribution.mean.is_infinite() {
            f64::from(u8::from(z >= max))
        } else if z >= max {
            normal_cdf((distribution.mean - max) / sigma)
        } else if distribution.step_m > FINE_STEP * sigma {
            let half = 0.5 * distribution.step_m;
            let (a, b) = ((z - half - distribution.mean) / sigma, (z + half - distribution.mean) / sigma);
            (normal_cdf(b) - normal_cdf(a)) / distribution.step_m
        } else {
            normal_density((z - distribution.mean) / sigma) / sigma
        }
    };
    if tail > 0.0 {
        (1.0 - tail) * one(distribution.sigma) + tail * one(factor * distribution.sigma)
    } else {
        one(distribution.sigma)
    }
}

/// Density of the alternatives of a distribution, and the probability that none of them comes to pass.
fn alternatives_density(distribution: &ReadingDistribution, z: f64, max: f64) -> (f64, f64) {
    let (mut density, mut rest) = (0.0, 1.0);
    for &(probability, alternative) in distribution.alternatives.as_slice() {
        let weight = rest * probability;
        density += weight * alternative_density(alternative, z, max);
        rest -= weight;
    }
    (density, rest)
}

fn alternative_density(alternative: Alternative, z: f64, max: f64) -> f64 {
    match alternative {
        Alternative::NoReturn => f64::from(u8::from(z >= max)),
        Alternative::Near { mean, sigma } if z < max => normal_density((z - mean) / sigma) / sigma,
        Alternative::Near { mean, sigma } => normal_cdf((mean - max) / sigma),
        Alternative::Between { lo, hi } => {
            if z < max {
                if (lo..hi).contains(&z) { 1.0 / (hi - lo) } else { 0.0 }
            } else {
                ((hi - max) / (hi - lo)).clamp(0.0, 1.0)
            }
        }
    }
}

fn alternative_cdf(alternative: Alternative, z: f64) -> f64 {
    match alternative {
        Alternative::NoReturn => 0.0,
        Alternative::Near { mean, sigma } => normal_cdf((z - mean) / sigma),
        Alternative::Between { lo, hi } => ((z - lo) / (hi - lo)).clamp(0.0, 1.0),
    }
}

/// A hypothesis about the world, for single readings.
#[derive(Clone, Copy)]
pub(crate) struct Density<'a> {
    pub laser: &'a LaserOptions,
    pub effects: &'a Effects,
    /// Factor on the density of blocks.
    pub blocks: f64,
}

impl Density<'_> {
    /// What a reading `z` says; `shift` is added to the range of what stands there \[m\].
    pub fn terms(&self, beam: &Beam, shift: f64, z: f64) -> Terms {
        let max = self.laser.max_range_m;
        let wall = self.wall_reading(beam, shift);
        let range = beam.range() + shift;
        let clear = (self.blocks * beam.log_clear).exp();
        let (alternatives, rest) = alternatives_density(&wall, z, max);
        let returned = rest * return_density(&wall, z, max);
        let clear_density = alternatives + returned;
        let mut density = clear * clear_density;
        let mut short = 0.0;
        if clear < 1.0 {
            let (others, rest) = self.object_alternatives(beam, z);
            density += (1.0 - clear) * others;
            if z < max && z < range {
                let (survival, hazard) = beam.survival_at(z - shift);
                if hazard > 0.0 {
                    short = rest * self.blocks * survival.max(1e-12).powf(self.blocks - 1.0) * hazard;
                }
            }
            density += short;
        }
        let (density, short) = self.with_step(&wall, z, density, short);
        let density = (1.0 - FLOOR) * density + FLOOR / max;
        let is_return = z < max && wall.mean < max;
        Terms {
            density,
            hit: if is_return { (clear * returned / density).min(1.0) } else { 0.0 },
            clear_density,
            clear,
            short: short / density,
            error: if is_return { z - wall.mean } else { 0.0 },
            sigma: if is_return { wall.sigma } else { f64::INFINITY },
        }
    }

    /// The distribution of a beam that no block is in the way of.
    fn wall_reading(&self, beam: &Beam, shift: f64) -> ReadingDistribution {
        let range = beam.range() + shift;
        let view = BeamView { range: beam.view.range + shift, ..beam.view };
        self.effects.reading(self.laser, &view, HitKind::Wall, range)
    }

    /// In the measure of the laser's own steps: a coarser step gathers the probability of several.
    fn with_step(&self, distribution: &ReadingDistribution, z: f64, density: f64, short: f64) -> (f64, f64) {
        let own = self.laser.resolution_m.max(FINEST_STEP_M);
        if distribution.step_m <= 1.000_001 * own || z >= self.laser.max_range_m {
            return (density, short);
        }
        let steps = z / distribution.step_m;
        let on_grid = (steps - steps.round()).abs() * distribution.step_m < 0.5 * own;
        let factor = if on_grid { distribution.step_m / own } else { 0.0 };
        (factor * density, factor * short)
    }

    /// Density of a reading that has nothing to do with the block that stands in the way, and the probability that the
    /// reading is of the block.
    fn object_alternatives(&self, beam: &Beam, z: f64) -> (f64, f64) {
        if self.effects.is_empty() {
            return (0.0, 1.0);
        }
        let max = self.laser.max_range_m;
        let range = if z < max { z } else { 0.5 * beam.range().min(max) };
        alternatives_density(&self.effects.reading(self.laser, &beam.view, HitKind::Object, range), z, max)
    }

    /// P(reading <= z), for z below the maximum range.
    pub fn cdf(&self, beam: &Beam, shift: f64, z: f64) -> f64 {
        let range = beam.range() + shift;
        let mixture_cdf = |distribution: &ReadingDistribution,
                           below: &dyn Fn(&ReadingDistribution) -> f64| {
            let (mut cdf, mut rest) = (0.0, 1.0);
            for &(probability, alternative) in distribution.alternatives.as_slice() {
                let weight = rest * probability;
                cdf += weight * alternative_cdf(alternative, z);
                rest -= weight;
            }
            cdf + rest * below(distribution)
        };
        let wall = self.wall_reading(beam, shift);
        let clear = (self.blocks * beam.log_clear).exp();
        let mut cdf = clear
            * mixture_cdf(&wall, &|distribution| {
                let [tail, factor] = distribution.tail;
                let one = |sigma: f64| {
                    if distribution.mean.is_finite() {
                        normal_cdf((z - distribution.mean) / sigma)
                    } else {
                        0.0
                    }
                };
                if tail > 0.0 {
                    (1.0 - tail) * one(distribution.sigma) + tail * one(factor * distribution.sigma)
                } else {
                    one(distribution.sigma)
                }
            });
        if clear < 1.0 {
            let survival = beam.survival_at((z - shift).min(range)).0.max(1e-12).powf(self.blocks).max(clear);
            let share = ((1.0 - survival) / (1.0 - clear)).clamp(0.0, 1.0);
            let object = self.effects.reading(self.laser, &beam.view, HitKind::Object, z.min(range));
            cdf += (1.0 - clear) * mixture_cdf(&object, &|_| share);
        }
        cdf.clamp(0.0, 1.0)
    }

    /// Density of a reading in which a beam that is not blocked reads by `other` instead, relative to that by the
    /// hypothesis, less 1: the score of a contamination.
    pub fn contamination(terms: &Terms, other: f64) -> f64 {
        terms.clear * (other - terms.clear_density) / terms.density
    }
}

/// Density of a normal reading of what stands at `mean`.
pub(crate) fn near_density(z: f64, mean: f64, sigma: f64, max: f64) -> f64 {
    alternative_density(Alternative::Near { mean, sigma }, z, max)
}
