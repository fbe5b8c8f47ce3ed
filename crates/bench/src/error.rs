use std::path::PathBuf;

use thiserror::Error;

use locsim_core::RecordedError;
use locsim_dataset::DatasetError;
use locsim_gap::GapError;
use locsim_lab::LabError;
use locsim_report::ReportError;
use locsim_scenario::ScenarioError;

/// Why a benchmark could not be run.
#[derive(Debug, Error)]
pub enum BenchError {
    /// The map, the scenario or `workload.json` is refused.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A file can't be read or written.
    #[error("{}: {source}", path.display())]
    System {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A table of comma-separated values doesn't hold what it should.
    #[error("{}:{line}: {column}: {what}", path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// Line in it, from 1.
        line: u64,
        /// Name of the column.
        column: String,
        /// The value and what is allowed instead.
        what: String,
    },
    /// The particles are not pairs of 8-byte numbers that are poses.
    #[error("{}: {what}", path.display())]
    Particles {
        /// The file.
        path: PathBuf,
        /// The defect, and the needed content.
        what: String,
    },
    /// No log of the suite is of the groups and setups asked for.
    #[error(
        "--groups, --setups: the suite has no such logs at this --size; medium has all groups and all setups"
    )]
    NoLogs,
    /// There are more shards than logs.
    #[error("--shard: {shards} shards of {logs} logs are not allowed; at most one for each log")]
    TooManyShards {
        /// Shards asked for.
        shards: u32,
        /// Logs of the suite.
        logs: u32,
    },
    /// Shards don't hold all logs.
    #[error("{}: {missing} of {of} logs are missing; run with --shard {again}", folder.display())]
    MissingLogs {
        /// The folder with the shards.
        folder: PathBuf,
        /// Logs that no shard holds.
        missing: usize,
        /// Logs of the suite.
        of: usize,
        /// The shards to run.
        again: String,
    },
    /// The map can't be used.
    #[error("map: {0}")]
    Map(#[from] locsim_world::map::MapError),
    /// A laser is refused.
    #[error("laser: {0}")]
    Laser(String),
    /// The simulated world or laser is refused.
    #[error("{0}")]
    Simulation(#[from] locsim_world::simulation::SimulationError),
    /// A sensor model could not be trained, or a filter not be run on a log.
    #[error(transparent)]
    Lab(#[from] LabError),
    /// A search failed, or was stopped.
    #[error(transparent)]
    Gap(#[from] GapError),
    /// A log can't be compared with a simulator.
    #[error(transparent)]
    Comparison(#[from] locsim_gap::ComparisonError),
    /// No part of a log can be compared.
    #[error(transparent)]
    Recorded(#[from] RecordedError),
    /// A log could not be written or read.
    #[error(transparent)]
    Log(#[from] DatasetError),
    /// A log can't be put down for the search.
    #[error("a folder for logs: {0}")]
    Temporary(std::io::Error),
    /// The figures can't be written as JSON.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// The scenario is of a measured log.
    #[error("{0}: the suite needs a simulated scenario, with `robot` and `laser`")]
    NotSimulated(PathBuf),
    /// A sensor model could not be made a table.
    #[error("sensor model: {0}")]
    Sensor(#[from] locsim_sensor::SensorError),
    /// The filter gave up.
    #[error("filter: {0}")]
    Filter(#[from] locsim_mcl::FilterError),
    /// The regression refused its input.
    #[error(transparent)]
    Regression(#[from] distreg::Error),
    /// Threads could not be started.
    #[error("threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// The folder for figures can't be used.
    #[error(transparent)]
    Store(#[from] locsim_report::store::StoreError),
    /// A figure could not be drawn.
    #[error(transparent)]
    Figure(#[from] ReportError),
}

impl BenchError {
    /// Whether the user stopped the work.
    pub fn is_interruption(&self) -> bool {
        match self {
            Self::Lab(error) => error.is_interruption(),
            Self::Gap(GapError::Interrupted) => true,
            _ => false,
        }
    }

    /// Attaches a path to a system error.
    pub(crate) fn system(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::System { path, source }
    }
}
