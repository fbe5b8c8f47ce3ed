//! A bias that may be many standard deviations large, as a curve over one covariate: the likelihood of the readings where what they
//! meet is nearer or farther. A tilt of bins has no such bias.

use locsim_world::effect::Effects;

use super::covariates::{Axis, Covariates};
use crate::hypothesis::{Comparison, Fitted};
use crate::statistics::Covariate;

/// Biases that are tried, in standard deviations of a reading, to both sides. Between them tilts do.
const STEPS: [f64; 13] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.5, 10.0, 14.0, 20.0, 28.0, 40.0];
const COUNT: usize = 2 * STEPS.len() + 1;
const NONE: usize = STEPS.len();

/// Of two covariates that gain as much the one with fewer levels is meant: each level has to gain this (nats).
const NATS_PER_LEVEL: f64 = 1.0;

/// The bias of a step \[standard deviations\].
fn bias(step: usize) -> f64 {
    match step.cmp(&NONE) {
        std::cmp::Ordering::Less => -STEPS[NONE - 1 - step],
        std::cmp::Ordering::Equal => 0.0,
        std::cmp::Ordering::Greater => STEPS[step - NONE - 1],
    }
}

/// A bias over one covariate.
pub(super) struct Shift {
    pub axis: usize,
    /// Of each reading, as fitted without its fold \[m\].
    pub of_readings: Vec<f64>,
    /// Of each level, fitted to all folds \[standard deviations\].
    pub levels: Vec<f64>,
    /// Gain on each fold of the bias that was fitted without it (nats).
    pub gains: Vec<f64>,
}

impl Shift {
    /// The one that gains most on held-out folds. `readings` gives the beam and the fold of each.
    pub fn new(
        comparison: &Comparison<'_>,
        effects: &Effects,
        fitted: &Fitted,
        covariates: &Covariates,
        readings: &[(usize, usize)],
        folds: usize,
    ) -> Option<Self> {
        let views = &*comparison.views;
        let mut table: Vec<[f64; COUNT]> = Vec::with_capacity(readings.len());
        let mut sigmas = Vec::with_capacity(readings.len());
        comparison.for_each_reading(views, effects, fitted, |_, i, density, shift, z, terms| {
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
        let all = axes.map(|(index, axis)| Self::over(index, axis, &table, &sigmas, readings, folds));
        let worth =
            |shift: &Self| shift.gains.iter().sum::<f64>() - NATS_PER_LEVEL * shift.levels.len() as f64;
        all.max_by(|a, b| worth(a).total_cmp(&worth(b)))
    }

    fn over(
        index: usize,
        axis: &Axis,
        table: &[[f64; COUNT]],
        sigmas: &[f64],
        readings: &[(usize, usize)],
        folds: usize,
    ) -> Self {
        let count = axis.levels.len();
        let mut sums = vec![vec![[0.0; COUNT]; count]; folds];
        let mut total = vec![[0.0; COUNT]; count];
        for (row, &(beam, fold)) in table.iter().zip(readings) {
            let level = axis.of_beams[beam] as usize;
            for sum in [&mut sums[fold][level], &mut total[level]] {
                sum.iter_mut().zip(row).for_each(|(sum, more)| *sum += more);
            }
        }
        let best =
            |of: &dyn Fn(usize) -> f64| (0..COUNT).max_by(|&a, &b| of(a).total_cmp(&of(b))).unwrap_or(NONE);
        let without: Vec<Vec<usize>> = sums
            .iter()
            .map(|fold| (0..count).map(|l| best(&|step| total[l][step] - fold[l][step])).collect())
            .collect();
        let gains = sums
            .iter()
            .zip(&without)
            .map(|(fold, steps)| fold.iter().zip(steps).map(|(sums, &step)| sums[step]).sum())
            .collect();
        let of_reading = |(&(beam, fold), sigma): (&(usize, usize), &f64)| {
            bias(without[fold][axis.of_beams[beam] as usize]) * sigma
        };
        Self {
            axis: index,
            of_readings: readings.iter().zip(sigmas).map(of_reading).collect(),
            levels: total.iter().map(|sums| bias(best(&|step| sums[step]))).collect(),
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
}
