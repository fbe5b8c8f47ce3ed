use indexmap::IndexMap;
use locsim_core::Interval;
use serde::Serialize;

use crate::plan::Plan;
use crate::run::Inputs;

/// The content of `sweep.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Merged {
    /// Name of the sweep.
    pub name: String,
    /// One line for people.
    pub description: String,
    /// Version of locsim.
    pub version: String,
    /// Hash of version, scenario and plan.
    pub digest: String,
    /// Files that the cells read, with their BLAKE3.
    pub inputs: Inputs,
    /// Axes, groups, conditions, seed and trials.
    pub plan: Plan,
    /// Number of cells.
    pub cells: u32,
    /// Number of rows of the data set.
    pub rows: u64,
    /// Each model over all cells.
    pub models: IndexMap<String, ModelFigures>,
}

/// A model over all cells that have it.
#[derive(Clone, Debug, Serialize)]
pub struct ModelFigures {
    /// Number of trials.
    pub trials: u32,
    /// Share of lost trials.
    pub lost_share: f64,
    /// Its exact 95 % interval.
    pub lost_share_interval: Interval,
    /// Root of the mean over trials of the mean squared position error \[m\].
    pub position_rmse_m: f64,
    /// Its 95 % interval.
    pub position_rmse_interval: Option<Interval>,
    /// Cells in which its RMSE is the lowest.
    pub cells_best: usize,
    /// Cells in which its interval meets that of the lowest.
    pub cells_tied: usize,
}
