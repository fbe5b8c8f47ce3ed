//! A reading as the outcome of a few classes: of the surface, in bins of its PIT there, of something in front of it or
//! behind it, or of nothing.

use locsim_comparison::{Comparison, Fitted};
use locsim_core::tilt::{Class, MOMENTS_OF_READING, NEAR, Outcome, bin_of};
use locsim_core::{Draw, normal};
use locsim_world::effect::Effects;
use rand::RngExt;

use super::large::Change;
use crate::statistics::Deviation;

/// The moments of a reading that have curves: three of the error of a reading of the surface, and the shares of the other
/// classes. Two are in front: where clutter can stand, and where hardly anything can.
pub(super) const MOMENTS: [Deviation; MOMENTS_OF_READING] = [
    Deviation::Mean,
    Deviation::Spread,
    Deviation::Skew,
    Deviation::Short,
    Deviation::Long,
    Deviation::NoReturn,
    Deviation::Short,
];

/// Whether a moment is the share of a class.
pub fn is_share(moment: Deviation) -> bool {
    matches!(moment, Deviation::Short | Deviation::Long | Deviation::NoReturn)
}

/// A reading in front is in the open where the hypothesis has no more than this share of a beam's readings up to there. Few of them
/// stand out, among all that clutter makes.
const OPEN: f64 = 1e-3;
/// Share of an even density under the hypothesis, so that no reading is impossible; as in the likelihood.
const FLOOR: f64 = 1e-6;

/// The readings of a log under a hypothesis.
pub(super) struct Outcomes {
    pub all: Vec<Outcome>,
}

impl Outcomes {
    /// The readings of a log, whose errors at the surface are changed as `changes` says of each; not at all, if none is given.
    pub fn new(
        comparison: &Comparison<'_>,
        effects: &Effects,
        fitted: &Fitted,
        draw: &Draw,
        changes: Option<&[Change]>,
    ) -> Self {
        let laser = &comparison.nominal.laser;
        let (min, max) = (laser.min_range_m, laser.max_range_m);
        let stepped = effects.list().iter().filter(|effect| effect.kind.is_stepped());
        let step = stepped.map(|effect| effect.values[0]).fold(laser.resolution_m, f64::max);
        let views = &*comparison.views;
        let mut all = Vec::with_capacity(views.beams.len());
        comparison.for_each_reading(views, effects, fitted, |scan, i, density, shift, z, terms| {
            let beam = &views.beams[i];
            let is_return = z < max;
            let Change { bias_m, spread } = changes.map_or(Change::NONE, |changes| changes[all.len()]);
            let shift = shift + bias_m;
            let probe = if is_return { z } else { 0.5 * (min + max) };
            let terms = if is_return && bias_m == 0.0 { terms } else { density.terms(beam, shift, probe) };
            let (mean, nominal) =
                if terms.sigma.is_finite() { (probe - terms.error, terms.sigma) } else { (max, 0.0) };
            let sigma = spread * nominal;
            let cdf = |x: f64| {
                let x = x.clamp(min, max);
                let cdf = density.cdf(beam, shift, x);
                if sigma == nominal {
                    return cdf;
                }
                let [own, wider] = [nominal, sigma].map(|sigma| normal::cdf((x - mean) / sigma));
                (cdf + terms.returned / terms.measure * (wider - own)).clamp(0.0, 1.0)
            };
            let [lo, hi] = [mean - NEAR * sigma, mean + NEAR * sigma].map(|edge| edge.clamp(min, max));
            let [below, within, returned] = [lo, hi, max].map(cdf);
            let (below, within) = (below.min(within), within.max(below).min(returned));
            let class = if !is_return {
                Class::NoReturn
            } else if z < lo {
                if cdf(z) > OPEN { Class::Short } else { Class::Open }
            } else if z >= hi || hi <= lo {
                Class::Long
            } else {
                let share: f64 = draw.at(scan as u32).item(i as u32).random();
                let [before, after] = [-0.5, 0.5].map(|side| cdf((z + side * step).clamp(lo, hi)));
                let u = (before + share * (after - before) - below) / (within - below).max(1e-12);
                Class::Surface(bin_of(u))
            };
            let floors = [hi - lo, lo - min, max - hi].map(|width| FLOOR * width.max(0.0) / max);
            let open = below.min(OPEN);
            let probabilities = [
                (within - below) + floors[0],
                (below - open) + floors[1],
                (returned - within).max(0.0) + floors[2],
                (1.0 - returned).max(0.0) + FLOOR,
                open + floors[1],
            ];
            let total: f64 = probabilities.iter().sum();
            all.push(Outcome {
                scan: scan as u32,
                beam: i as u32,
                class,
                probabilities: probabilities.map(|p| p / total),
                sigma,
            });
        });
        Self { all }
    }
}
