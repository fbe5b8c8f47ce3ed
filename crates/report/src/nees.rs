//! Whether a filter's covariance is right: the normalized estimation error squared, with its interval.

use locsim_core::Interval;
use serde::{Deserialize, Serialize};

use crate::drive;
use crate::results::{ModelTrial, StepRow};
use crate::statistics::{Bootstrap, Moments};

/// 95 % intervals of the mean NEES.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NeesIntervals {
    /// With the filter's own covariance.
    pub nees_mean: Interval,
    /// With the covariance of the errors that scans of a log share added to it.
    pub nees_with_shared_errors_mean: Interval,
}

impl NeesIntervals {
    /// Of the trials of one model. Where all have one drive, how its steps vary, whose errors last, says how well the mean is known (Kiefer and
    /// Vogelsang 2005); where each has its own, the bootstrap over trials. `None` of a drive of fewer than 20 steps, and of one trial of
    /// several drives.
    pub(crate) fn of(trials: &[&ModelTrial], bootstrap: Option<&Bootstrap>) -> Option<Self> {
        let values = [|row: &StepRow| row.nees, |row: &StepRow| row.nees_with_shared_errors];
        let [nees_mean, nees_with_shared_errors_mean] = if drive::is_shared(trials) {
            let [own, shared] = values.map(|value| over_steps(trials, value));
            [own?, shared?]
        } else {
            let means = values.map(|value| -> Vec<f64> {
                let mean = |trial: &&ModelTrial| trial.steps.iter().map(value).collect::<Moments>().mean();
                trials.iter().map(mean).collect()
            });
            bootstrap?.intervals(|copies| {
                let count: f64 = copies.iter().map(|copies| f64::from(*copies)).sum();
                let sum = |means: &Vec<f64>| {
                    means.iter().zip(copies).map(|(mean, copies)| mean * f64::from(*copies)).sum::<f64>()
                };
                [sum(&means[0]) / count, sum(&means[1]) / count]
            })?
        };
        Some(Self { nees_mean, nees_with_shared_errors_mean })
    }
}

fn over_steps(trials: &[&ModelTrial], value: fn(&StepRow) -> f64) -> Option<Interval> {
    let [mean, half] = drive::mean(&drive::by_step(trials, value)?);
    Some(Interval { lo: (mean - half).max(0.0), hi: mean + half })
}

#[cfg(test)]
mod tests {
    use locsim_core::Pose2;

    use super::*;

    /// Trials of 100 steps. NEES alternates between 2 and 4, or is 2 for half of the drive and 4 for the other.
    fn trials(nees: impl Fn(u32, u32) -> f64, drives: f64) -> Vec<ModelTrial> {
        let row = |trial: u32, step: u32| StepRow {
            truth: Pose2::new(f64::from(step) + drives * f64::from(trial), 0.0, 0.0),
            nees: nees(trial, step),
            nees_with_shared_errors: 1.0,
            ..StepRow::default()
        };
        let trial = |trial: u32| ModelTrial {
            model: "np_reg".to_owned(),
            steps: (0..100).map(|step| row(trial, step)).collect(),
            lost: false,
            step_ms: 0.0,
            events: Vec::new(),
        };
        (0..8).map(trial).collect()
    }

    fn intervals(trials: &[ModelTrial]) -> NeesIntervals {
        let bootstrap = Bootstrap::new(1, trials.len());
        NeesIntervals::of(&trials.iter().collect::<Vec<_>>(), bootstrap.as_ref()).unwrap()
    }

    /// On one drive, errors that last for half of it leave its mean open; on drives of their own the trials' means count.
    #[test]
    fn one_drive_is_known_by_its_steps_and_several_by_their_trials() {
        let in_turn = intervals(&trials(|_, step| 2.0 + 2.0 * f64::from(step % 2), 0.0)).nees_mean;
        assert!(in_turn.contains(3.0) && in_turn.half() < 0.4, "{in_turn:?}");
        let lasting = intervals(&trials(|_, step| 2.0 + 2.0 * f64::from(step / 50), 0.0)).nees_mean;
        assert!(lasting.contains(3.0) && lasting.half() > 1.5, "{lasting:?}");
        let of_drives =
            intervals(&trials(|trial, step| 2.0 + f64::from(trial % 2) + 2.0 * f64::from(step / 50), 1.0));
        assert!(of_drives.nees_mean.contains(3.5) && of_drives.nees_mean.half() < 0.5, "{of_drives:?}");
        assert_eq!(of_drives.nees_with_shared_errors_mean, Interval { lo: 1.0, hi: 1.0 });
        let short: Vec<ModelTrial> = trials(|_, _| 3.0, 0.0)
            .into_iter()
            .map(|mut trial| {
                trial.steps.truncate(19);
                trial
            })
            .collect();
        assert_eq!(NeesIntervals::of(&short.iter().collect::<Vec<_>>(), None), None);
    }
}
