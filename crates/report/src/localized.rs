//! How soon a filter that starts anywhere has found the robot.

use serde::{Deserialize, Serialize};

use crate::results::{RunResults, StepRow};
use crate::statistics::quantile;

/// Distance of driving \[m\] after which a filter should have found the robot.
const SOON_M: f64 = 30.0;

/// How soon a filter from an unknown start has found the robot. It has done so at the first scan from which on each estimate is
/// within the scenario's `lost_m` of the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Localized {
    /// Number of trials in which it ever has.
    pub trials: u32,
    /// Number of those in which it has after at most 30 m of driving.
    pub trials_after_30_m: u32,
    /// Median over all trials of the distance driven until then \[m\]; `None` where half of them or more never get there.
    pub after_m_median: Option<f64>,
}

impl Localized {
    /// Of the model at an index; `None` where the start is known.
    pub(crate) fn of(results: &RunResults, model: usize) -> Option<Self> {
        let within_m = results.localized_within_m?;
        let after = |steps: &[StepRow]| localized_after(steps, within_m).unwrap_or(f64::INFINITY);
        let mut after: Vec<f64> =
            results.trials.iter().map(|trial| after(&trial.models[model].steps)).collect();
        after.sort_by(f64::total_cmp);
        let up_to = |distance: f64| after.partition_point(|after| *after <= distance) as u32;
        // Between a distance and none, the middle is none.
        let middle = quantile(&after, 0.5);
        Some(Self {
            trials: up_to(f64::MAX),
            trials_after_30_m: up_to(SOON_M),
            after_m_median: Some(middle).filter(|middle| middle.is_finite()),
        })
    }
}

/// Distance driven \[m\] up to the first step from which on errors are at most `within_m` \[m\].
fn localized_after(steps: &[StepRow], within_m: f64) -> Option<f64> {
    let first = steps.iter().rposition(|row| row.position_error_m() > within_m).map_or(0, |last| last + 1);
    let driven = |pair: &[StepRow]| pair[0].truth.position().distance(pair[1].truth.position());
    (first < steps.len()).then(|| steps[..=first].windows(2).map(driven).sum())
}

#[cfg(test)]
mod tests {
    use locsim_core::Pose2;

    use super::*;

    /// Half a metre a step: off at the first two scans and again at the fifth, near at all others.
    #[test]
    fn a_robot_is_localized_where_it_stays_so() {
        let errors = [3.0, 1.0, 0.2, 0.2, 0.6, 0.1, 0.1];
        let steps: Vec<StepRow> = (0..)
            .zip(errors)
            .map(|(i, error)| StepRow {
                truth: Pose2::new(0.5 * f64::from(i), 0.0, 0.0),
                error_along_m: error,
                ..StepRow::default()
            })
            .collect();
        assert_eq!(localized_after(&steps, 0.5), Some(2.5));
        assert_eq!(localized_after(&steps, 0.7), Some(1.0));
        assert_eq!(localized_after(&steps, 5.0), Some(0.0));
        assert_eq!(localized_after(&steps[..5], 0.5), None);
    }
}
