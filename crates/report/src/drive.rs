//! Trials that all have one drive, those of a log: how well a mean over its steps is known.
//!
//! Such trials differ in the filter's draws alone. How they vary doesn't say what another drive would have given; how the steps of the
//! drive vary does, if it is known that their errors last.

use distreg::lasting::{self, QUANTILE_975};

use crate::results::{ModelTrial, StepRow};
use crate::statistics::Moments;

/// Of more steps, neighbours are put together: errors that last are summed over all pairs of steps.
const MOST_VALUES: usize = 2000;
/// Fewer steps tell nothing of how long errors last.
const FEWEST_STEPS: usize = 20;

/// Whether all trials are of the same true poses.
pub(crate) fn is_shared(trials: &[&ModelTrial]) -> bool {
    trials.windows(2).all(|pair| {
        let [a, b] = [pair[0], pair[1]].map(|trial| trial.steps.iter().map(|row| row.truth));
        a.eq(b)
    })
}

/// The mean over trials at each step of a drive that they share, of long drives at a few neighbouring steps. `None` of fewer than 20 steps
/// and of no trial.
pub(crate) fn by_step(trials: &[&ModelTrial], value: impl Fn(&StepRow) -> f64) -> Option<Vec<f64>> {
    let steps = trials.first()?.steps.len();
    if steps < FEWEST_STEPS {
        return None;
    }
    let mean =
        |step: usize| trials.iter().map(|trial| value(&trial.steps[step])).sum::<f64>() / trials.len() as f64;
    let means: Vec<f64> = (0..steps).map(mean).collect();
    let together = means.chunks(steps.div_ceil(MOST_VALUES));
    Some(together.map(|part| part.iter().copied().collect::<Moments>().mean()).collect())
}

/// The mean of values in the order of the steps and half of its 95 % interval (Kiefer and Vogelsang 2005).
pub(crate) fn mean(values: &[f64]) -> [f64; 2] {
    let [mean, error] = lasting::mean(values);
    [mean, QUANTILE_975 * error]
}

/// The factor from the root of the ratio of two means to either end of its 95 % interval, by the delta method. Both are of the same steps.
pub(crate) fn factor_of_root_ratio(values: &[f64], base: &[f64]) -> f64 {
    let [own, other] = [values, base].map(|values| values.iter().sum::<f64>() / values.len() as f64);
    if own == 0.0 {
        return 1.0;
    }
    let relative: Vec<f64> = values.iter().zip(base).map(|(a, b)| a / own - b / other).collect();
    let [_, half] = mean(&relative);
    (0.5 * half).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two models whose squared errors have the same mean, the one wrong in turn with the other: for a step, or for half of the drive.
    #[test]
    fn a_ratio_is_known_by_the_steps_of_the_drive() {
        let errors = |run: usize, phase: usize| {
            (0..200).map(|i| 1.0 + ((i / run + phase) % 2) as f64).collect::<Vec<_>>()
        };
        let factor = |run: usize| factor_of_root_ratio(&errors(run, 0), &errors(run, 1));
        let (in_turn, lasting) = (factor(1), factor(100));
        assert!(in_turn < 1.1 && lasting > 1.5, "{in_turn} {lasting}");
        assert_eq!(factor_of_root_ratio(&[0.0; 30], &errors(1, 0)[..30]), 1.0);
        // Errors that both have leave nothing open.
        assert!((factor_of_root_ratio(&errors(100, 0), &errors(100, 0)) - 1.0).abs() < 1e-9);
    }
}
