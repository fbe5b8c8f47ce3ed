//! A reading as the outcome of a few classes: of the surface, in bins of its PIT there, of something in front of it or
//! behind it, or of nothing.

use locsim_core::tilt::{self, MOST, NEAR, bin_of, bins, share_within, tilted};
use locsim_core::{Draw, normal};
use locsim_world::effect::Effects;
use rand::RngExt;

use super::large::Change;
use crate::hypothesis::{Comparison, Fitted};
use crate::statistics::Deviation;

/// The moments of a reading that have curves: three of the error of a reading of the surface, and the shares of the other
/// classes. Two are in front: where clutter can stand, and where hardly anything can.
pub(super) const MOMENTS: [Deviation; 7] = [
    Deviation::Mean,
    Deviation::Spread,
    Deviation::Skew,
    Deviation::Short,
    Deviation::Long,
    Deviation::NoReturn,
    Deviation::Short,
];
/// Moments of the surface's readings, the first of [`MOMENTS`].
const OF_SURFACE: usize = tilt::MOMENTS;

/// Whether a moment is the share of a class.
pub fn is_share(moment: Deviation) -> bool {
    matches!(moment, Deviation::Short | Deviation::Long | Deviation::NoReturn)
}

/// A reading in front is in the open where the hypothesis has no more than this share of a beam's readings up to there. Few of them
/// stand out, among all that clutter makes.
const OPEN: f64 = 1e-3;
/// Share of an even density under the hypothesis, so that no reading is impossible; as in the likelihood.
const FLOOR: f64 = 1e-6;
/// The least variance that a class with a small probability counts as having.
const LEAST_VARIANCE: f64 = 1e-9;

/// The logarithm of what the probabilities of a reading are multiplied by, for each moment (1).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tilt(pub [f64; MOMENTS.len()]);

/// Sums of what a reading says of a moment: pull, and its variance.
pub(super) type Pull = [[f64; 2]; MOMENTS.len()];

/// The class of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Class {
    /// Of the surface, in a bin.
    Surface(u8),
    Short,
    Long,
    NoReturn,
    /// In front of the surface, in the open.
    Open,
}

/// A reading with the probabilities of its classes under the hypothesis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outcome {
    pub scan: u32,
    /// Index of its beam in the log.
    pub beam: u32,
    class: Class,
    /// Probabilities of the classes, in the order of [`Class`].
    probabilities: [f64; 5],
    /// Standard deviation of a reading of the surface \[m\].
    sigma: f64,
}

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

impl Outcome {
    fn class(&self) -> usize {
        match self.class {
            Class::Surface(_) => 0,
            Class::Short => 1,
            Class::Long => 2,
            Class::NoReturn => 3,
            Class::Open => 4,
        }
    }

    /// Probabilities of the classes under a tilt.
    fn classes(&self, tilt: &Tilt) -> [f64; 5] {
        let mut shares = self.probabilities;
        for (share, tilt) in shares[1..].iter_mut().zip(&tilt.0[OF_SURFACE..]) {
            if *tilt != 0.0 {
                *share *= tilt.clamp(-MOST, MOST).exp();
            }
        }
        let total: f64 = shares.iter().sum();
        shares.map(|share| share / total)
    }

    /// Log score gained by a tilt (nats).
    pub fn gain(&self, tilt: &Tilt) -> f64 {
        let class = self.class();
        let of_class = (self.classes(tilt)[class] / self.probabilities[class]).ln();
        match self.class {
            Class::Surface(bin) => {
                of_class
                    + (tilted(&tilt.0)[usize::from(bin)] / bins().weight[usize::from(bin)] * share_within())
                        .ln()
            }
            _ => of_class,
        }
    }

    /// The slope of the log score by each moment's tilt, and its variance.
    pub fn pull(&self, tilt: &Tilt) -> Pull {
        let mut pull = [[0.0; 2]; MOMENTS.len()];
        if let Class::Surface(bin) = self.class {
            let (shares, basis) = (tilted(&tilt.0), &bins().basis);
            for moment in 0..OF_SURFACE {
                let [mut mean, mut square] = [0.0; 2];
                for (share, basis) in shares.iter().zip(basis) {
                    mean += share * basis[moment];
                    square += share * basis[moment].powi(2);
                }
                pull[moment] = [basis[usize::from(bin)][moment] - mean, square - mean * mean];
            }
        }
        let (shares, own) = (self.classes(tilt), self.class());
        for class in 1..shares.len() {
            let hit = f64::from(u8::from(class == own));
            pull[OF_SURFACE + class - 1] =
                [hit - shares[class], (shares[class] * (1.0 - shares[class])).max(LEAST_VARIANCE)];
        }
        pull
    }

    /// The change that a tilt of one moment makes: the mean of a reading of the surface \[m\], its spread (a factor, less 1), its skewness,
    /// or the share of a class. `None` of a beam that meets no surface, for the surface's moments.
    pub fn change(&self, moment: usize, by: f64) -> Option<f64> {
        let mut tilt = Tilt::default();
        tilt.0[moment] = by;
        if moment >= OF_SURFACE {
            let class = moment - OF_SURFACE + 1;
            return Some(self.classes(&tilt)[class] - self.probabilities[class]);
        }
        if self.sigma == 0.0 {
            return None;
        }
        let of = |tilt: &Tilt| {
            let mut means = [0.0; OF_SURFACE];
            for (share, basis) in tilted(&tilt.0).iter().zip(&bins().basis) {
                means.iter_mut().zip(basis).for_each(|(mean, basis)| *mean += share * basis);
            }
            means
        };
        let [mean, square, cube] = of(&tilt);
        Some(match moment {
            0 => self.sigma * mean,
            1 => {
                let [_, plain, _] = of(&Tilt::default());
                ((1.0 + square - mean * mean) / (1.0 + plain)).max(0.0).sqrt() - 1.0
            }
            _ => cube,
        })
    }

    /// What a reading counts for in the mean change of a moment: 1, or the probability that it isn't of the share's class.
    pub fn weight(&self, moment: usize) -> f64 {
        let class = (moment + 1).checked_sub(OF_SURFACE).filter(|class| *class > 0);
        class.map_or(1.0, |class| 1.0 - self.probabilities[class])
    }

    /// Standard deviation of a reading of the surface \[m\]; 0 of a beam that meets none.
    pub fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Error of a reading of the surface beyond the model (standard deviations).
    pub fn error(&self, tilt: &Tilt) -> Option<f64> {
        let Class::Surface(bin) = self.class else { return None };
        let (shares, basis) = (tilted(&tilt.0), &bins().basis);
        let mean: f64 = shares.iter().zip(basis).map(|(share, basis)| share * basis[0]).sum();
        Some(basis[usize::from(bin)][0] - mean)
    }
}
