use std::path::PathBuf;

use thiserror::Error;

/// Why a run or a search could not be done.
#[derive(Debug, Error)]
pub enum LabError {
    /// The scenario's map, log or path is refused.
    #[error(transparent)]
    Scenario(#[from] locsim_scenario::ScenarioError),
    /// The map can't be used.
    #[error("map {path}: {source}")]
    Map {
        /// The map's file, or the log it was built from.
        path: PathBuf,
        /// The cause.
        source: locsim_world::map::MapError,
    },
    /// The simulated world, robot or laser is refused.
    #[error("{path}: {source}")]
    Simulation {
        /// The scenario's file.
        path: PathBuf,
        /// The cause.
        source: locsim_world::simulation::SimulationError,
    },
    /// The measured log can't be read.
    #[error(transparent)]
    Dataset(#[from] locsim_dataset::DatasetError),
    /// A log doesn't fit the scenario.
    #[error("{path}: {what}")]
    Log {
        /// The log's file.
        path: PathBuf,
        /// The defect, and the needed content.
        what: String,
    },
    /// The training data are refused.
    #[error("training data: {source}")]
    TrainingData {
        /// The cause.
        source: locsim_sensor::SensorError,
    },
    /// A fitted model's file can't be used.
    #[error("model {path}: {what}")]
    ModelFile {
        /// The file.
        path: PathBuf,
        /// The defect, and the needed content.
        what: String,
    },
    /// A sensor model could not be fitted.
    #[error("sensor model `{label}`: {source}")]
    Sensor {
        /// The model's label.
        label: String,
        /// The cause.
        source: locsim_sensor::SensorError,
    },
    /// The filter gave up.
    #[error("filter: {0}")]
    Filter(#[from] locsim_mcl::FilterError),
    /// The report could not be written.
    #[error(transparent)]
    Report(#[from] locsim_report::ReportError),
    /// The recording failed; the results are complete without it.
    #[error("the results are in {out}, but the recording failed: {source}")]
    Recording {
        /// The results folder.
        out: PathBuf,
        /// The recorder's error.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The results folder can't be used.
    #[error(transparent)]
    Store(#[from] locsim_report::store::StoreError),
    /// A search can't be done, or was stopped.
    #[error(transparent)]
    Gap(#[from] locsim_gap::GapError),
    /// The user stopped work of which nothing is kept.
    #[error("interrupted")]
    Stopped,
    /// The user stopped the run; finished trials are kept.
    #[error("interrupted after {finished} of {trials} trials; add --resume to go on")]
    Interrupted {
        /// Trials that are kept.
        finished: usize,
        /// Trials asked for.
        trials: usize,
    },
}

impl LabError {
    /// Whether the user stopped the work.
    pub fn is_interruption(&self) -> bool {
        matches!(
            self,
            Self::Interrupted { .. } | Self::Stopped | Self::Gap(locsim_gap::GapError::Interrupted)
        )
    }
}
