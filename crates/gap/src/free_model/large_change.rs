//! A bias or a spread that may be many standard deviations large, as a curve over one covariate: the likelihood of the readings
//! where those of the surface err by so much more. A tilt of bins has no such change.

use locsim_core::normal;
use locsim_world::effect::Effects;

use super::covariates::{Axis, Covariates};
use super::fold_of_scan;
use crate::hypothesis::{Comparison, Fitted};
use crate::likelihood::Terms;
use crate::statistics::{Covariate, Deviation};

/// Biases that are tried, to both sides: from the first to the last \[standard deviations\], each this factor larger than the one
/// before. Between them tilts do.
const BIASES: [f64; 2] = [0.25, 45.0];
const BIAS_STEP: f64 = 1.1;
/// Factors on the spread that are tried, likewise.
const SPREADS: [f64; 2] = [0.2, 70.0];
const SPREAD_STEP: f64 = 1.15;

/// A covariate explains a change if it gains this share of what the best one gains. Of those that do, the one with the fewest
/// levels is meant. The rest of a reference's errors gives finer ones up to 1 %.
const EXPLAINED: f64 = 0.98;

/// A change of the error of a reading of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Error {
    /// Its mean \[standard deviations\].
    pub bias: f64,
    /// Factor on its spread.
    pub spread: f64,
}

impl Error {
    pub const NONE: Self = Self { bias: 0.0, spread: 1.0 };

    /// The density of an error `t`, in standard deviations, of a normal number whose tail has this probability and factor.
    fn density(self, t: f64, [tail, wider]: [f64; 2]) -> f64 {
        let t = (t - self.bias) / self.spread;
        ((1.0 - tail) * normal::density(t) + tail * normal::density(t / wider) / wider) / self.spread
    }
}

/// A bias or a spread over one covariate.
pub(super) struct LargeChange {
    pub axis: usize,
    /// [`Deviation::Mean`] or [`Deviation::Spread`].
    pub moment: Deviation,
    /// Of each reading, as fitted without its fold.
    pub of_readings: Vec<Error>,
    /// Of each level, fitted to all folds.
    pub levels: Vec<Error>,
    /// Gain on each fold of the change that was fitted without it (nats).
    pub gains: Vec<f64>,
}

impl LargeChange {
    /// The one that gains most on held-out folds; `None` of a log without readings.
    pub fn new(
        comparison: &Comparison<'_>,
        effects: &Effects,
        fitted: &Fitted,
        covariates: &Covariates,
        folds: usize,
    ) -> Option<Self> {
        let mut readings = Vec::new();
        comparison.for_each_reading(&comparison.views, effects, fitted, |scan, beam, _, _, _, terms| {
            readings.push(Reading { beam, fold: fold_of_scan(scan, folds), terms });
        });
        let biases = ladder(BIASES, BIAS_STEP).flat_map(|bias| [-bias, bias]);
        let biases = biases.map(|bias| Error { bias, ..Error::NONE });
        let spreads = ladder(SPREADS, SPREAD_STEP).map(|spread| Error { spread, ..Error::NONE });
        let moments = [
            (Deviation::Mean, std::iter::once(Error::NONE).chain(biases).collect::<Vec<_>>()),
            (Deviation::Spread, std::iter::once(Error::NONE).chain(spreads).collect()),
        ];
        let best = moments.iter().filter_map(|(moment, errors)| {
            Self::over_one_covariate(*moment, errors, &readings, covariates, folds)
        });
        best.max_by(|a, b| a.gain().total_cmp(&b.gain()))
    }

    /// Log score gained on held-out folds (nats).
    pub fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }

    /// The change over the covariate that explains it with the fewest levels.
    fn over_one_covariate(
        moment: Deviation,
        errors: &[Error],
        readings: &[Reading],
        covariates: &Covariates,
        folds: usize,
    ) -> Option<Self> {
        let axes = covariates.axes.iter().enumerate();
        let axes: Vec<_> = axes.filter(|(_, axis)| axis.covariate != Covariate::Neighbour).collect();
        let mut sums: Vec<Vec<Vec<f64>>> =
            axes.iter().map(|(_, axis)| vec![vec![0.0; errors.len()]; folds * axis.levels.len()]).collect();
        let mut of_reading = vec![0.0; errors.len()];
        for Reading { beam, fold, terms } in readings {
            gains(terms, errors, &mut of_reading);
            for ((_, axis), sums) in axes.iter().zip(&mut sums) {
                let level = axis.of_beams[*beam] as usize;
                let sums = &mut sums[fold * axis.levels.len() + level];
                sums.iter_mut().zip(&of_reading).for_each(|(sum, more)| *sum += more);
            }
        }
        let all: Vec<Self> = axes
            .iter()
            .zip(&sums)
            .map(|((index, axis), sums)| Self::over(*index, axis, moment, errors, sums, readings))
            .collect();
        let most = all.iter().map(Self::gain).fold(0.0, f64::max);
        all.into_iter()
            .filter(|change| change.gain() >= EXPLAINED * most)
            .min_by(|a, b| a.levels.len().cmp(&b.levels.len()).then(b.gain().total_cmp(&a.gain())))
    }

    /// The change over an axis. `sums` are the gains (nats) of each error, by fold and level.
    fn over(
        index: usize,
        axis: &Axis,
        moment: Deviation,
        errors: &[Error],
        sums: &[Vec<f64>],
        readings: &[Reading],
    ) -> Self {
        let count = axis.levels.len();
        let mut total = vec![vec![0.0; errors.len()]; count];
        for fold in sums.chunks_exact(count) {
            for (total, sums) in total.iter_mut().zip(fold) {
                total.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
            }
        }
        let best = |of: &dyn Fn(usize) -> f64| {
            (0..errors.len()).max_by(|&a, &b| of(a).total_cmp(&of(b)).then(b.cmp(&a))).unwrap_or(0)
        };
        let without: Vec<Vec<usize>> = sums
            .chunks_exact(count)
            .map(|fold| (0..count).map(|level| best(&|i| total[level][i] - fold[level][i])).collect())
            .collect();
        let gains = sums
            .chunks_exact(count)
            .zip(&without)
            .map(|(fold, chosen)| fold.iter().zip(chosen).map(|(sums, &i)| sums[i]).sum())
            .collect();
        let of_reading =
            |reading: &Reading| errors[without[reading.fold][axis.of_beams[reading.beam] as usize]];
        Self {
            axis: index,
            moment,
            of_readings: readings.iter().map(of_reading).collect(),
            levels: total.iter().map(|sums| errors[best(&|i| sums[i])]).collect(),
            gains,
        }
    }
}

/// A reading of the log under the hypothesis.
struct Reading {
    beam: usize,
    fold: usize,
    terms: Terms,
}

/// Log score that a reading gains by each error of the surface's readings (nats).
fn gains(terms: &Terms, errors: &[Error], gains: &mut [f64]) {
    if !terms.sigma.is_finite() || terms.sigma == 0.0 {
        gains.fill(0.0);
        return;
    }
    let t = terms.error / terms.sigma;
    let surface = |error: Error| terms.returned * error.density(t, terms.tail) / terms.sigma;
    let unchanged = surface(Error::NONE);
    for (gain, &error) in gains.iter_mut().zip(errors) {
        let change = (surface(error) - unchanged) / terms.density;
        *gain = change.max(-1.0 + f64::EPSILON).ln_1p();
    }
}

/// Numbers from the first to the last, each `step` times the one before.
fn ladder([first, last]: [f64; 2], step: f64) -> impl Iterator<Item = f64> {
    let count = ((last / first).ln() / step.ln()).round() as i32;
    (0..=count).map(move |i| first * step.powi(i))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ladder_goes_from_its_first_to_its_last() {
        let rungs: Vec<f64> = ladder([1.0, 8.0], 2.0).collect();
        assert_eq!(rungs, [1.0, 2.0, 4.0, 8.0]);
    }

    /// The density of the changed error adds up to 1, has its mean and its spread.
    #[test]
    fn a_changed_error_has_its_mean_and_its_spread() {
        for (error, tail) in [
            (Error { bias: 3.0, spread: 1.0 }, [0.0, 5.0]),
            (Error { bias: 0.0, spread: 4.0 }, [0.0, 5.0]),
            (Error { bias: 0.0, spread: 2.0 }, [0.1, 5.0]),
        ] {
            let [mut sum, mut mean, mut square] = [0.0; 3];
            for i in -40_000..=40_000 {
                let t = 0.005 * f64::from(i);
                let mass = 0.005 * error.density(t, tail);
                sum += mass;
                mean += mass * t;
                square += mass * t * t;
            }
            let [share, wider] = tail;
            let variance = error.spread.powi(2) * (1.0 - share + share * wider * wider);
            assert!((sum - 1.0).abs() < 1e-9 && (mean - error.bias).abs() < 1e-9, "{error:?}: {sum} {mean}");
            assert!((square - mean * mean - variance).abs() < 1e-6, "{error:?}: {square}");
        }
    }
}
