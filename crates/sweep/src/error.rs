use std::path::PathBuf;

use locsim_core::limits::quoted;
use locsim_lab::LabError;
use locsim_report::ReportError;
use locsim_report::store::StoreError;
use locsim_scenario::ScenarioError;
use thiserror::Error;

/// Why a sweep could not be run or merged.
#[derive(Debug, Error)]
pub enum SweepError {
    /// The sweep, its scenario or the scenario of a cell is refused.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A cell could not be run.
    #[error("cell {cell} ({name}): {source}")]
    Cell {
        /// Its number.
        cell: u32,
        /// Its values.
        name: String,
        /// The cause.
        source: Box<LabError>,
    },
    /// A run could not be done.
    #[error(transparent)]
    Run(#[from] LabError),
    /// A run's scenario isn't what its shards were run with.
    #[error(
        "{}: it, or a file that it reads, isn't what the shards were run with; bring that back, or run the shards again",
        file.display()
    )]
    ChangedScenario {
        /// The scenario's file.
        file: PathBuf,
    },
    /// There are more shards than cells of a sweep or trials of a run.
    #[error("--shard: {shards} shards of {parts} {part}s are not allowed; at most one for each {part}")]
    TooManyShards {
        /// Shards asked for.
        shards: u32,
        /// Cells of the sweep, or trials of the run.
        parts: u32,
        /// The name of one.
        part: &'static str,
    },
    /// The place of a shard is taken.
    #[error(
        "{} holds a shard of something else: scenario, axes, seed, inputs or version of locsim differ. Name another folder, \
         or add --force to replace it",
        folder.display()
    )]
    OtherShard {
        /// The folder of the shard.
        folder: PathBuf,
    },
    /// A shard's file was cut or changed.
    #[error("{} {what}; remove it and run the shard again", path.display())]
    DamagedShard {
        /// The file or folder.
        path: PathBuf,
        /// The defect.
        what: String,
    },
    /// The place of the shards isn't a folder.
    #[error("{} is not allowed; {what}, and the folder that the shards are in is needed", quoted(&path.to_string_lossy()))]
    NoFolder {
        /// The path.
        path: PathBuf,
        /// What is there.
        what: &'static str,
    },
    /// The shards in a folder can't be merged.
    #[error("{}", problems.join("\n"))]
    Unmergeable {
        /// Each shard at fault, and the commands that mend it.
        problems: Vec<String>,
    },
    /// Results can't be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A folder can't be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The system can't read or write something.
    #[error("{}: {source}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// Worker threads can't be started.
    #[error("threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// The engine's program failed.
    #[error("--submit: {} {what}", script.display())]
    Submit {
        /// The script.
        script: PathBuf,
        /// The reason.
        what: String,
    },
    /// The user stopped the work; what is finished is kept.
    #[error("interrupted after {finished} of {of} {parts}; {again}")]
    Interrupted {
        /// Cells or trials that are kept.
        finished: usize,
        /// Cells or trials asked for.
        of: u32,
        /// The name of either.
        parts: &'static str,
        /// How to go on.
        again: &'static str,
    },
}

impl SweepError {
    /// Whether the user stopped the work.
    pub fn is_interruption(&self) -> bool {
        match self {
            Self::Interrupted { .. } => true,
            Self::Run(error) => error.is_interruption(),
            _ => false,
        }
    }
}
