//! Sweeps: one scenario, run with every combination of other values at some of its keys. [`Sweep::load`] reads and checks a
//! file; [`run_sweep`] runs all cells on this machine; [`run_shard`] runs a share of them, and [`merge()`] puts shards together
//! into the same bytes. [`ShardedRun`] and [`RunShards`] do it for the trials of one run.

mod cells;
mod engine;
mod error;
mod figures;
mod merge;
mod page;
pub mod plan;
mod raw;
mod results;
mod run;
mod run_shard;
pub mod shard;
mod sweep;

use std::path::Path;

pub use engine::{Engine, Job};
pub use error::SweepError;
pub use merge::{MergeOptions, merge, run_sweep};
pub use results::{Merged, ModelFigures};
pub use run::SweepOptions;
pub use run_shard::{RunShards, ShardedRun};
pub use shard::{ShardOutcome, run_shard};
pub use sweep::{Sweep, SweepEstimate, SweepOverrides};

use locsim_scenario::{ScenarioError, yaml};

/// Whether the file at `path` is a sweep and not a scenario: only sweeps have the key `axes`.
///
/// # Errors
/// [`ScenarioError::Read`] where the file can't be read.
pub fn is_sweep(path: &Path) -> Result<bool, ScenarioError> {
    Ok(yaml::has_key(&yaml::read(path)?, "axes"))
}

/// The JSON Schema of sweep files.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(raw::RawSweep).to_value()
}
