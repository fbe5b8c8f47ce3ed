//! The readings of a log under a hypothesis.

use glam::DVec2;
use locsim_comparison::{Beam, Comparison, Density, Fitted, Terms};
use locsim_core::{Draw, Stage};
use locsim_world::effect::Effects;
use rand::RngExt;

/// The largest noise with which readings of the surface are separated from readings of other things \[m\]. With more, most
/// things in front of a wall would count as the wall.
const MOST_NOISE_M: f64 = 0.1;

/// A log under a hypothesis.
pub(crate) struct Readings<'a> {
    pub comparison: &'a Comparison<'a>,
    pub effects: &'a Effects,
    pub fitted: &'a Fitted,
    /// Whether the hypothesis has errors of the reference poses. A log and its replicates are measured alike, whatever
    /// errors are found in each: a statistic that one replicate alone has would be an outlier among them.
    pub has_pose_errors: bool,
    /// All usable readings, by scan and beam.
    pub all: Vec<Reading<'a>>,
}

/// A reading under a hypothesis.
pub(crate) struct Reading<'a> {
    pub scan: usize,
    /// The half of the log that it is of.
    pub half: usize,
    /// Index of its beam in the log.
    pub index: usize,
    pub beam: &'a Beam,
    /// Change of the expected range by the fitted error of the reference \[m\].
    pub shift: f64,
    /// The reading, at most the maximum range \[m\].
    pub z: f64,
    pub terms: Terms,
    /// Probability integral transform; that of a missing return is drawn from its interval.
    pub pit: f64,
    pub is_return: bool,
    /// Whether it is a return of something in front of the mapped surface.
    pub is_in_front: bool,
    /// Whether it is a return of something behind the mapped surface.
    pub is_behind: bool,
}

impl<'a> Readings<'a> {
    /// The readings of a log under `effects` with the nuisance parameters `fitted` to it.
    pub fn new(
        comparison: &'a Comparison<'a>,
        effects: &'a Effects,
        fitted: &'a Fitted,
        has_pose_errors: bool,
        pit: &Draw,
    ) -> Self {
        let views = &*comparison.views;
        let max = comparison.nominal.laser.max_range_m;
        let mut all = Vec::with_capacity(views.beams.len());
        comparison.for_each_reading(views, effects, fitted, |scan, index, density, shift, z, terms| {
            let beam = &views.beams[index];
            let is_return = z < max;
            let noise = terms.sigma.min(MOST_NOISE_M);
            let expected = beam.range() + shift;
            let pit = if is_return {
                density.cdf(beam, shift, z)
            } else {
                1.0 - terms.density.min(1.0) * pit.at(scan as u32).item(index as u32).random::<f64>()
            };
            all.push(Reading {
                scan,
                half: comparison.recorded.folds.half_of(scan),
                index,
                beam,
                shift,
                z,
                terms,
                pit,
                is_return,
                // So far from the surface noise alone brings 3 in 10^5 readings to the front, and fewer behind, where
                // hardly anything else is.
                is_in_front: is_return && z < expected - 4.0 * noise,
                is_behind: is_return && z > expected + 5.0 * noise,
            });
        });
        Self { comparison, effects, fitted, has_pose_errors, all }
    }

    /// The laser's maximum range \[m\].
    pub fn max_range(&self) -> f64 {
        self.comparison.nominal.laser.max_range_m
    }

    /// The readings of each scan that has any.
    pub fn scans(&self) -> impl Iterator<Item = &[Reading<'a>]> {
        self.all.chunk_by(|a, b| a.scan == b.scan)
    }

    /// The returns of something in front of the mapped surface.
    pub fn in_front(&self) -> impl Iterator<Item = &Reading<'a>> {
        self.all.iter().filter(|reading| reading.is_in_front)
    }
}

impl Reading<'_> {
    /// Where it is in the map \[m\].
    pub fn point(&self) -> DVec2 {
        self.beam.view.point_at(self.z)
    }

    /// The score of a contamination: a beam that no clutter blocks has the density `other` instead. It is the ratio of the two
    /// densities, less 1.
    pub fn contamination(&self, other: f64) -> f64 {
        Density::contamination(&self.terms, other)
    }

    /// The side of its wall that it is seen from, 1 or -1. Walls that are parallel have the same.
    pub fn side(&self) -> f64 {
        side_of(-self.beam.view.normal)
    }

    /// Derivative of the log density by a displacement of the wall away from the laser, along its normal \[1/m\].
    pub fn wall_shift_score(&self) -> f64 {
        let Terms { hit, error, sigma, .. } = self.terms;
        if sigma.is_infinite() {
            return 0.0;
        }
        hit * error / sigma.powi(2) / self.beam.view.incidence.cos().max(LEAST_COSINE)
    }
}

/// Of the two normals of a wall one is at less than 90 degrees to a direction, which few walls are parallel to.
pub(super) fn side_of(normal: DVec2) -> f64 {
    normal.dot(DVec2::new(0.8, 0.6)).signum()
}

/// Beams more grazing than 80 degrees count as that (cosine): their ends move far with a wall that moves little.
const LEAST_COSINE: f64 = 0.17;

/// The draws that randomize the PIT of missing returns.
pub(crate) fn pit_draw(seed: u64) -> Draw {
    Draw::new(seed, Stage::Bootstrap, 0)
}
