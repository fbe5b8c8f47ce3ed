//! A bias that may be many standard deviations large, as a curve over one covariate: the likelihood of the readings where what they
//! meet is nearer or farther. A tilt of bins has no such bias.

use locsim_world::effect::Effects;

use super::covariates::{Axis, Covariates};
use super::{Part, fold_of};
use crate::fit::sum_error;
use crate::hypothesis::{Comparison, Fitted};
use crate::statistics::Covariate;

/// Biases that are tried, in standard deviations of a reading, to both sides. Between them a parabola is.
const STEPS: [f64; 13] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.5, 10.0, 14.0, 20.0, 28.0, 40.0];
const COUNT: usize = 2 * STEPS.len() + 1;
const NONE: usize = STEPS.len();

/// Of two covariates that gain as much the one with fewer levels is meant: each level has to gain this (nats).
const NATS_PER_LEVEL: f64 = 1.0;

/// A covariate is surely behind another by this many standard errors of the difference over folds.
const SURELY: f64 = 2.0;

/// The bias of a step \[standard deviations\].
fn bias(step: usize) -> f64 {
    match step.cmp(&NONE) {
        std::cmp::Ordering::Less => -STEPS[NONE - 1 - step],
        std::cmp::Ordering::Equal => 0.0,
        std::cmp::Ordering::Greater => STEPS[step - NONE - 1],
    }
}

/// A bias between the steps: the vertex of the parabola through the log likelihood at the best step and at its neighbours.
#[derive(Clone, Copy)]
struct Fit {
    /// The best step.
    step: usize,
    /// The bias \[standard deviations\], and its standard error.
    at: f64,
    error: f64,
}

impl Fit {
    /// The best bias, where a sum of log likelihoods is known at each step.
    fn of(sums: impl Fn(usize) -> f64) -> Self {
        // None, of steps that are all as good: a level without readings.
        let step = (0..COUNT).fold(NONE, |best, step| if sums(step) > sums(best) { step } else { best });
        if step == 0 || step == COUNT - 1 {
            return Self { step, at: bias(step), error: 0.0 };
        }
        let [a, b, c] = [step - 1, step, step + 1].map(bias);
        let [below, here, above] = [step - 1, step, step + 1].map(sums);
        let (left, right) = ((here - below) / (b - a), (above - here) / (c - b));
        // The second derivative is twice this, and not above 0, as the middle is the highest.
        let bend = (right - left) / (c - a);
        let slope = left + bend * (b - a);
        if bend >= -1e-12 {
            return Self { step, at: b, error: 0.0 };
        }
        Self { step, at: (b - 0.5 * slope / bend).clamp(a, c), error: (-0.5 / bend).sqrt() }
    }

    /// Other log likelihoods at this bias, by the parabola through the same steps.
    fn read(self, sums: impl Fn(usize) -> f64) -> f64 {
        let Self { step, at, .. } = self;
        if step == 0 || step == COUNT - 1 || at == bias(step) {
            return sums(step);
        }
        let steps = [step - 1, step, step + 1];
        let [a, b, c] = steps.map(bias);
        let [below, here, above] = steps.map(sums);
        let share = |p: f64, q: f64, r: f64| (at - q) * (at - r) / ((p - q) * (p - r));
        below * share(a, b, c) + here * share(b, a, c) + above * share(c, a, b)
    }
}

/// A bias over one covariate.
pub(super) struct Shift {
    pub axis: usize,
    /// Of each reading, as fitted without its fold \[m\].
    pub of_readings: Vec<f64>,
    /// Of each level, fitted to all folds \[standard deviations\].
    pub levels: Vec<f64>,
    /// Its standard error \[standard deviations\].
    pub errors: Vec<f64>,
    /// Gain on each fold of the bias that was fitted without it (nats).
    pub gains: Vec<f64>,
}

impl Shift {
    /// The one that gains most on held-out folds, of those that the part of the log has.
    pub fn new(
        comparison: &Comparison<'_>,
        effects: &Effects,
        fitted: &Fitted,
        covariates: &Covariates,
        folds: usize,
        part: Part,
    ) -> Option<Self> {
        let views = &*comparison.views;
        let mut table: Vec<[f64; COUNT]> = Vec::with_capacity(views.beams.len());
        let mut sigmas = Vec::with_capacity(views.beams.len());
        let mut readings = Vec::with_capacity(views.beams.len());
        comparison.for_each_reading(views, effects, fitted, |scan, i, density, shift, z, terms| {
            readings.push((i, fold_of(scan, folds)));
            let sigma = if terms.sigma.is_finite() { terms.sigma } else { 0.0 };
            sigmas.push(sigma);
            let log = |step| {
                if sigma == 0.0 || step == NONE {
                    return terms.density.ln();
                }
                density.terms(&views.beams[i], shift + bias(step) * sigma, z).density.ln()
            };
            table.push(std::array::from_fn(|step| log(step) - terms.density.ln()));
        });
        let axes =
            covariates.axes.iter().enumerate().filter(|(_, axis)| axis.covariate != Covariate::Neighbour);
        let all: Vec<Self> = axes
            .map(|(index, axis)| Self::over(index, axis, &table, &sigmas, &readings, folds, part))
            .collect();
        let worth =
            |shift: &Self| shift.gains.iter().sum::<f64>() - NATS_PER_LEVEL * shift.levels.len() as f64;
        let best = all.iter().max_by(|a, b| worth(a).total_cmp(&worth(b)))?;
        // One that isn't surely behind, and has the fewest levels.
        let is_as_good = |shift: &Self| {
            let behind: Vec<f64> =
                best.gains.iter().zip(&shift.gains).map(|(best, own)| best - own).collect();
            behind.iter().sum::<f64>() <= SURELY * sum_error(&behind)
        };
        let simplest = all.iter().position(|shift| {
            let has_fewer = |other: &Self| other.levels.len() < shift.levels.len();
            is_as_good(shift) && !all.iter().any(|other| has_fewer(other) && is_as_good(other))
        });
        simplest.and_then(|index| all.into_iter().nth(index))
    }

    fn over(
        index: usize,
        axis: &Axis,
        table: &[[f64; COUNT]],
        sigmas: &[f64],
        readings: &[(usize, usize)],
        folds: usize,
        part: Part,
    ) -> Self {
        let count = axis.levels.len();
        let mut sums = vec![vec![[0.0; COUNT]; count]; folds];
        let mut total = vec![[0.0; COUNT]; count];
        for (row, &(beam, fold)) in table.iter().zip(readings).filter(|(_, (_, fold))| part.includes(*fold)) {
            let level = axis.of_beams[beam] as usize;
            for sum in [&mut sums[fold][level], &mut total[level]] {
                sum.iter_mut().zip(row).for_each(|(sum, more)| *sum += more);
            }
        }
        let without: Vec<Vec<Fit>> = sums
            .iter()
            .map(|fold| (0..count).map(|l| Fit::of(|step| total[l][step] - fold[l][step])).collect())
            .collect();
        let gains = sums
            .iter()
            .zip(&without)
            .map(|(fold, fits)| fold.iter().zip(fits).map(|(sums, fit)| fit.read(|step| sums[step])).sum())
            .collect();
        let of_reading = |(&(beam, fold), sigma): (&(usize, usize), &f64)| {
            without[fold][axis.of_beams[beam] as usize].at * sigma
        };
        let fits: Vec<Fit> = total.iter().map(|sums| Fit::of(|step| sums[step])).collect();
        Self {
            axis: index,
            of_readings: readings.iter().zip(sigmas).map(of_reading).collect(),
            levels: fits.iter().map(|fit| fit.at).collect(),
            errors: fits.iter().map(|fit| fit.error).collect(),
            gains,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn biases_are_even_on_both_sides() {
        assert_eq!(bias(NONE), 0.0);
        assert!((0..COUNT).all(|step| bias(step) == -bias(COUNT - 1 - step)));
        assert!((1..COUNT).all(|step| bias(step) > bias(step - 1)));
    }

    /// The log likelihood of readings with unit noise is a parabola, and its vertex is their mean, known to 1 / sqrt(n).
    #[test]
    fn a_parabola_is_found_between_the_steps() {
        for (mean, n) in [(0.2, 5.0), (-1.7, 20.0), (3.4, 100.0), (12.0, 7.0)] {
            let log = |step: usize| -0.5 * n * (bias(step) - mean).powi(2) + 3.0;
            let fit = Fit::of(log);
            assert!((fit.at - mean).abs() < 1e-9 && (fit.error - f64::sqrt(1.0 / n)).abs() < 1e-9);
            assert!((fit.read(log) - 3.0).abs() < 1e-9);
        }
        let flat = Fit::of(|_| 0.0);
        assert_eq!(flat.error, 0.0);
    }
}
