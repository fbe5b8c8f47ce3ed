//! A bias or a spread that may be many standard deviations large, as a curve over one covariate: the likelihood of the readings
//! where what they meet is nearer or farther, or where they err by so much more. A tilt of bins has no such change.

use distreg::others::variances_of_others;
use distreg::steps::{COUNT, Crossfit, Steps, biases, spreads};
use locsim_comparison::{Comparison, Fitted, Terms, Usable};
use locsim_core::{Folds, normal, simplest};
use locsim_world::effect::Effects;

use super::covariates::{Axis, Covariates, NOISE_OF_SCANS};
use super::{MEAN, Part, SPREAD};
use crate::Recorded;
use crate::statistics::Covariate;

/// Readings that err by more are none of the surface (standard deviations).
const MOST_DEVIATIONS: f64 = 10.0;

fn ladder(moment: usize) -> &'static Steps<COUNT> {
    if moment == MEAN { biases() } else { spreads() }
}

/// A change of the error of a reading of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Change {
    /// Its mean \[m\].
    pub bias_m: f64,
    /// Factor on its spread.
    pub spread: f64,
}

impl Change {
    pub const NONE: Self = Self { bias_m: 0.0, spread: 1.0 };
}

/// What is known of each reading: its scan, its beam, its fold, its standard deviation (0 of a beam that meets no surface), and the log
/// score that it gains by each change (nats).
struct Row {
    scan: usize,
    beam: usize,
    fold: usize,
    sigma: f64,
    /// Its error in standard deviations, where it is of the surface.
    error: Option<f64>,
    gains: [[f64; COUNT]; 2],
}

/// A bias or a spread over one covariate.
#[derive(Clone)]
pub(super) struct Large {
    /// [`MEAN`] or [`SPREAD`].
    pub moment: usize,
    pub axis: usize,
    /// Of each reading, as fitted without its fold.
    pub of_readings: Vec<Change>,
    /// Of each level, fitted to all folds: a bias in standard deviations, or the logarithm of a factor on them.
    pub levels: Vec<f64>,
    /// Its standard error.
    pub errors: Vec<f64>,
    /// Gain on each fold of the change that was fitted without it (nats).
    pub gains: Vec<f64>,
}

impl Large {
    /// The bias and the spread that gain most on held-out folds, of those that the part of the log has, each over the simplest of the covariates
    /// that can't be told apart. Beside them the bias that gains most over any covariate, told apart or not.
    pub fn of_moments(
        comparison: &Comparison<'_>,
        effects: &Effects,
        fitted: &Fitted,
        covariates: &Covariates,
        folds: Folds,
        part: Part,
    ) -> (Vec<Self>, Option<Self>) {
        let views = &*comparison.views;
        let mut rows = Vec::with_capacity(views.beams.len());
        let [biases, spreads] = [MEAN, SPREAD].map(ladder);
        comparison.for_each_reading(views, effects, fitted, |scan, i, density, shift, z, terms| {
            let sigma = if terms.sigma.is_finite() { terms.sigma } else { 0.0 };
            let mut gains = [[0.0; COUNT]; 2];
            if sigma > 0.0 {
                let with_bias = |bias: f64| density.terms(&views.beams[i], shift + bias * sigma, z).density;
                for step in (0..COUNT).filter(|step| *step != biases.none) {
                    gains[MEAN][step] = (with_bias(biases.at[step]) / terms.density).ln();
                }
                for (gain, step) in gains[SPREAD].iter_mut().zip(spreads.at) {
                    *gain = gain_by_spread(&terms, step.exp());
                }
            }
            let error = Some(terms.error / sigma).filter(|error| error.abs() < MOST_DEVIATIONS);
            rows.push(Row { scan, beam: i, fold: folds.of_scan(scan), sigma, error, gains });
        });
        let mut best = Vec::new();
        let mut most_biased = None;
        for moment in [MEAN, SPREAD] {
            let axes = covariates.axes.iter().enumerate();
            let over = |index, axis: &Axis| Self::over(moment, index, axis, &rows, folds, part);
            let ordinary = axes.clone().filter(|(_, axis)| !axis.is_of_readings());
            let all: Vec<Self> = ordinary.map(|(index, axis)| over(index, axis)).collect();
            let most = all.iter().map(Self::gain).fold(0.0, f64::max);
            let mut of_scans = axes.filter(|(_, axis)| moment == SPREAD && axis.covariate == Covariate::Scan);
            let noisy = of_scans.next().map(|(index, axis)| over(index, axis));
            let simplest = simplest(all.iter().map(|change| (change.levels.len(), &change.gains[..])));
            if moment == MEAN {
                most_biased = all.iter().max_by(|a, b| a.gain().total_cmp(&b.gain())).cloned();
            }
            let noisy = noisy.filter(|noisy| noisy.gain() > NOISE_OF_SCANS * most);
            best.extend(noisy.or_else(|| all.into_iter().nth(simplest?)));
        }
        (best, most_biased)
    }

    /// The log with this bias taken off its returns. `fitted` is what the bias was found with.
    pub fn taken_off(&self, comparison: &Comparison<'_>, fitted: &Fitted) -> Recorded {
        let max = comparison.nominal.laser.max_range_m;
        let mut readings = comparison.recorded.readings.clone();
        let mut changes = self.of_readings.iter();
        comparison.for_each_usable(&comparison.views, fitted, |Usable { beam, z, .. }| {
            let Change { bias_m, .. } = changes.next().copied().unwrap_or(Change::NONE);
            if z < max {
                readings[beam] = (z - bias_m) as f32;
            }
        });
        comparison.recorded.with(readings, comparison.recorded.odometry.clone())
    }

    /// Log score gained on held-out folds (nats).
    pub fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }

    fn over(moment: usize, index: usize, axis: &Axis, rows: &[Row], folds: Folds, part: Part) -> Self {
        let levels: Vec<usize> = if axis.is_of_readings() {
            let errors = rows.iter().map(|row| (row.scan, row.error));
            let of = |value: Option<f64>| usize::from(axis.level_of(value.unwrap_or(f64::NAN)));
            variances_of_others(errors).map(of).collect()
        } else {
            rows.iter().map(|row| usize::from(axis.of_beams[row.beam])).collect()
        };
        let mut sums = vec![vec![[0.0; COUNT]; axis.levels.len()]; folds.count()];
        // Things that stand before a wall are as far from it as they are: no noise and no bias of the readings there.
        let counts = |row: &Row| {
            part.includes(row.fold) && (axis.covariate != Covariate::Place || row.error.is_some())
        };
        for (row, &level) in rows.iter().zip(&levels).filter(|(row, _)| counts(row)) {
            sums[row.fold][level].iter_mut().zip(row.gains[moment]).for_each(|(sum, more)| *sum += more);
        }
        let Crossfit { levels: fits, without, gains } = Crossfit::of(ladder(moment), &sums, axis.is_ordered);
        let of_reading = |(row, &level): (&Row, &usize)| {
            let at = without[row.fold][level].at;
            if moment == MEAN {
                Change { bias_m: at * row.sigma, ..Change::NONE }
            } else {
                Change { spread: at.exp(), ..Change::NONE }
            }
        };
        Self {
            moment,
            axis: index,
            of_readings: rows.iter().zip(&levels).map(of_reading).collect(),
            levels: fits.iter().map(|fit| fit.at).collect(),
            errors: fits.iter().map(|fit| fit.error).collect(),
            gains,
        }
    }
}

/// Log score that a reading gains where the errors of the surface's readings are wider by a factor (nats).
fn gain_by_spread(terms: &Terms, factor: f64) -> f64 {
    let (t, [tail, wider]) = (terms.error / terms.sigma, terms.tail);
    let of_surface = |factor: f64| {
        let t = t / factor;
        let density = (1.0 - tail) * normal::density(t) + tail * normal::density(t / wider) / wider;
        terms.returned * density / (factor * terms.sigma)
    };
    let change = (of_surface(factor) - of_surface(1.0)) / terms.density;
    change.max(-1.0 + f64::EPSILON).ln_1p()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of readings that are all of the surface the gain is the ratio of two normal densities, and the density that is changed adds up
    /// to 1.
    #[test]
    fn a_wider_error_is_a_density() {
        for (tail, factor) in [([0.0, 5.0], 3.0), ([0.1, 5.0], 0.5)] {
            let sum: f64 = (-40_000..40_000)
                .map(|i| {
                    let error = 1e-5 * f64::from(i);
                    let sigma = 0.01;
                    let [share, wider] = tail;
                    let t = error / sigma;
                    let density = ((1.0 - share) * normal::density(t)
                        + share * normal::density(t / wider) / wider)
                        / sigma;
                    // A floor, as the likelihood has: far out both densities vanish.
                    let density = density + 1e-12;
                    let terms = Terms { density, returned: 1.0, tail, error, sigma, ..Terms::default() };
                    1e-5 * density * gain_by_spread(&terms, factor).exp()
                })
                .sum();
            assert!((sum - 1.0).abs() < 1e-4, "{tail:?} {factor}: {sum}");
        }
    }
}
