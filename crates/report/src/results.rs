//! Results of a run: plain rows that the tables, figures, reports and recordings are made from.

use std::collections::BTreeMap;

use locsim_core::{Drive, Particles, Pose2};
use serde::{Deserialize, Serialize};

/// One filter step of one model in one trial. Positions in metres, angles in radians.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepRow {
    /// Index of the scan in the drive.
    pub step: u32,
    /// Time of the scan \[s\].
    pub stamp_secs: f64,
    /// True (or reference) pose, `map_from_base`.
    pub truth: Pose2,
    /// Dead-reckoned pose from the true start by odometry alone, `map_from_base`.
    pub dead_reckoning: Pose2,
    /// The estimate the scenario asks for, `map_from_base`.
    pub estimate: Pose2,
    /// Signed error of the estimate along the scenario's error axis \[m\].
    pub error_along_m: f64,
    /// Signed error across it, left positive \[m\].
    pub error_across_m: f64,
    /// Signed heading error \[rad\].
    pub error_heading_rad: f64,
    /// Effective sample size before resampling.
    pub effective_sample_size: f64,
    /// Power of the scan's likelihood that the filter took in: 1 of a whole scan, less where it would have left too few
    /// effective particles.
    pub likelihood_power: f64,
    /// Number of particles.
    pub particles: u32,
    /// The step's log evidence `ln p(z_t | z_1..t-1)` under this model (nats).
    pub log_evidence_nats: f64,
    /// Mean log density of the scan's readings at the step's own estimate (nats per reading), with a floor of 0.001 under the model's
    /// density; NaN of a scan without usable readings.
    pub scan_log_density_nats: f64,
    /// Normalized estimation error squared of the weighted mean, e^T C^-1 e over (x, y, heading), where C is the filter's covariance: on
    /// average 3 where C is right, more where the filter is too sure.
    pub nees: f64,
    /// The same with the covariance of the errors that scans of a log share added to C; elsewhere as `nees`.
    pub nees_with_shared_errors: f64,
    /// Whether the filter resampled.
    pub resampled: bool,
}

impl StepRow {
    /// Distance between estimate and truth \[m\].
    pub fn position_error_m(&self) -> f64 {
        self.error_along_m.hypot(self.error_across_m)
    }
}

/// All steps of one model in one trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelTrial {
    /// Model name, as in the scenario.
    pub model: String,
    /// One row per scan.
    pub steps: Vec<StepRow>,
    /// The trial ended farther from the truth than the scenario's `lost_m`, or was that far off in more than half of its
    /// steps.
    pub lost: bool,
    /// Mean wall time of a filter step \[ms\]; the only thing here that a repeated run doesn't reproduce. It is measured
    /// while trials run in parallel on all threads, so it includes contention.
    pub step_ms: f64,
    /// Events, each with its step: recoveries, injections.
    pub events: Vec<(u32, String)>,
}

/// One trial: every model on the same drive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Number of the trial, from 0.
    pub trial: u32,
    /// The seed all its draws come from.
    pub seed: u64,
    /// One entry per model, in the scenario's order.
    pub models: Vec<ModelTrial>,
}

/// The name in [`TrainingRow::chosen`] of the [`StepRow::scan_log_density_nats`] that 99 of 100 scans of the training drive exceed
/// while the filter localizes on it.
pub const USUAL_SCAN: &str = "training_drive_scan_log_density_nats";

/// A filter whose scans are unusual this often in a row has probably lost the robot. Where the map isn't true in places, up to 21 in a row
/// were seen (Intel) without that; where it was lost, 87.
pub const UNUSUAL_SCANS: usize = 30;

/// How a model did on held-out training data.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrainingRow {
    /// Mean negative log density of held-out readings (nats), with a floor of 0.001 under every model's density;
    /// `None` where the model isn't a normalized density.
    pub log_loss_nats: Option<f64>,
    /// Wasserstein-1 distance between predicted and observed distribution at held-out states \[m\]
    /// (the paper's histogram match times the bin width); `None` as above.
    pub histogram_match_m: Option<f64>,
    /// Parameters chosen on held-out data, by name: bandwidths, floor, exponent, mixture weights.
    pub chosen: BTreeMap<String, f64>,
}

/// Everything a run measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunResults {
    /// The scenario's name.
    pub scenario: String,
    /// Its one-line description.
    pub description: String,
    /// Its seed.
    pub seed: u64,
    /// Wall time of the run \[s\].
    pub seconds: f64,
    /// Where errors are measured: "map x axis" or "robot".
    pub error_frame: String,
    /// From an unknown start, the distance to the truth within which the filter has found the robot \[m\]: the scenario's `lost_m`.
    /// `None` where the start is known.
    pub localized_within_m: Option<f64>,
    /// Which estimate the errors are of.
    pub estimate: String,
    /// Model names in the scenario's order.
    pub models: Vec<String>,
    /// Held-out quality of each model, in the same order.
    pub training: Vec<TrainingRow>,
    /// Stretches of a measured drive on which its reference poses and the map disagree.
    pub disagreements: Vec<Disagreement>,
    /// All trials in order.
    pub trials: Vec<Trial>,
}

/// A stretch of a measured drive whose scans fit the map better from poses beside its reference poses: a filter that is right in
/// the map is wrong against the reference there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Disagreement {
    /// Index of its first scan in the drive.
    pub first_scan: u32,
    /// Index of its last scan.
    pub last_scan: u32,
    /// How far beside the reference poses these poses are, at least \[m\].
    pub least_m: f64,
    /// The same at most.
    pub most_m: f64,
    /// A reading is near a mapped surface up to this distance \[m\].
    pub near_m: f64,
    /// Share of the returns that end near one, from the reference poses.
    pub near_share: f64,
    /// The same from the poses beside them.
    pub near_share_beside: f64,
}

impl Disagreement {
    /// Whether a scan is in the stretch.
    pub fn has(&self, step: u32) -> bool {
        (self.first_scan..=self.last_scan).contains(&step)
    }
}

/// One trial in full, for pictures and recordings.
#[derive(Clone, Debug)]
pub struct DetailedTrial {
    /// All models of the run in the scenario's order, which their colours follow.
    pub labels: Vec<String>,
    /// The drive that was localized on (beams as the filter saw them).
    pub drive: Drive,
    /// Wall segments of the map \[m\].
    pub walls: Vec<[[f64; 2]; 2]>,
    /// Corners of the blocks that stood there at each step, not known to the filter; empty for measured logs.
    pub blocks: Vec<Vec<[[f64; 2]; 4]>>,
    /// `map_from_base` by odometry alone, at each step.
    pub dead_reckoning: Vec<Pose2>,
    /// One entry per model.
    pub models: Vec<DetailedModel>,
}

/// One model's filter in full.
#[derive(Clone, Debug)]
pub struct DetailedModel {
    /// Model name.
    pub name: String,
    /// One entry per scan.
    pub steps: Vec<DetailedStep>,
    /// The most likely trajectory at the end of the drive, one pose per scan.
    pub most_likely_trajectory: Vec<Pose2>,
}

/// One filter step in full.
#[derive(Clone, Debug)]
pub struct DetailedStep {
    /// Particles after weighting, before resampling.
    pub particles: Particles,
    /// Their normalized weights.
    pub weights: Vec<f64>,
    /// Online estimate of this step (weighted mean).
    pub estimate: Pose2,
    /// Covariance of (x, y) of the particles \[m^2\], row-major.
    pub position_covariance: [[f64; 2]; 2],
    /// Log density of each beam's reading at the true pose under this model (nats).
    pub beam_log_density: Vec<f32>,
    /// Effective sample size.
    pub effective_sample_size: f64,
    /// Log evidence of the step (nats).
    pub log_evidence_nats: f64,
    /// Events, for the text log.
    pub events: Vec<String>,
    /// Predicted density of one beam against its reading.
    pub probe: BeamProbe,
}

/// A predicted distribution of one beam of one particle, beside the reading.
#[derive(Clone, Debug, Default)]
pub struct BeamProbe {
    /// Index of the beam in the scan.
    pub beam: usize,
    /// The pose of the particle it is predicted for, `map_from_base`.
    pub pose: Pose2,
    /// Nominal range from that pose \[m\].
    pub nominal_m: f32,
    /// The reading \[m\].
    pub reading_m: f32,
    /// Ranges at which the density is given \[m\].
    pub z_m: Vec<f32>,
    /// Density at each \[1/m\].
    pub density_per_m: Vec<f32>,
    /// Probability of no return.
    pub max_range_probability: f32,
}
