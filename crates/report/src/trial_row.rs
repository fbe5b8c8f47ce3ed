use serde::{Deserialize, Serialize};

use crate::results::{ModelTrial, StepRow, Trial};
use crate::statistics::{Moments, quantile};

/// The figures of one model in one trial. Errors are over the steps of the trial; docs/RESULTS.md describes each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrialRow {
    /// Number of the trial, from 0.
    pub trial: u32,
    /// Its seed.
    pub seed: u64,
    /// Label of the model.
    pub model: String,
    /// Number of scans.
    pub steps: u32,
    /// Whether the filter lost the robot.
    pub lost: bool,
    /// Root of the mean squared position error \[m\].
    pub position_rmse_m: f64,
    /// Median position error \[m\].
    pub position_median_m: f64,
    /// 95th percentile of the position error \[m\].
    pub position_p95_m: f64,
    /// Greatest position error \[m\].
    pub position_max_m: f64,
    /// Last position error \[m\].
    pub position_final_m: f64,
    /// Mean error along the scenario's axis \[m\].
    pub along_mean_m: f64,
    /// Standard deviation of the error along \[m\].
    pub along_std_m: f64,
    /// Mean error across \[m\].
    pub across_mean_m: f64,
    /// Standard deviation of the error across \[m\].
    pub across_std_m: f64,
    /// Mean heading error \[rad\].
    pub heading_mean_rad: f64,
    /// Standard deviation of the heading error \[rad\].
    pub heading_std_rad: f64,
    /// Mean effective sample size before resampling.
    pub ess_mean: f64,
    /// Number of steps after which the filter resampled.
    pub resamplings: u32,
    /// Log evidence of the drive (nats).
    pub log_evidence_nats: f64,
    /// Mean number of particles.
    pub particles_mean: f64,
    /// Mean wall time of a filter step \[ms\].
    pub step_ms: f64,
    /// Events, each with its step.
    pub events: Vec<(u32, String)>,
}

impl TrialRow {
    /// The row of a model in a trial.
    pub fn new(trial: &Trial, model: &ModelTrial) -> Self {
        let moments = |value: fn(&StepRow) -> f64| model.steps.iter().map(value).collect::<Moments>();
        let mean = |value| moments(value).mean();
        let std = |value| moments(value).variance().sqrt();
        let mut errors: Vec<f64> = model.steps.iter().map(StepRow::position_error_m).collect();
        let position_final_m = errors.last().copied().unwrap_or(f64::NAN);
        errors.sort_by(f64::total_cmp);
        Self {
            trial: trial.trial,
            seed: trial.seed,
            model: model.model.clone(),
            steps: model.steps.len() as u32,
            lost: model.lost,
            position_rmse_m: moments(StepRow::position_error_m).mean_square().sqrt(),
            position_median_m: quantile(&errors, 0.5),
            position_p95_m: quantile(&errors, 0.95),
            position_max_m: quantile(&errors, 1.0),
            position_final_m,
            along_mean_m: mean(|s| s.error_along_m),
            along_std_m: std(|s| s.error_along_m),
            across_mean_m: mean(|s| s.error_across_m),
            across_std_m: std(|s| s.error_across_m),
            heading_mean_rad: mean(|s| s.error_heading_rad),
            heading_std_rad: std(|s| s.error_heading_rad),
            ess_mean: mean(|s| s.effective_sample_size),
            resamplings: model.steps.iter().filter(|s| s.resampled).count() as u32,
            log_evidence_nats: model.steps.iter().map(|s| s.log_evidence_nats).sum(),
            particles_mean: mean(|s| f64::from(s.particles)),
            step_ms: model.step_ms,
            events: model.events.clone(),
        }
    }

    /// `step: event`, separated by semicolons.
    pub(crate) fn events_text(&self) -> String {
        self.events.iter().map(|(step, event)| format!("{step}: {event}")).collect::<Vec<_>>().join("; ")
    }
}
