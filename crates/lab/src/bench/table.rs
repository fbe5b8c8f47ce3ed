//! The filter's fast path: a table of ray casts, and sensor models prepared for it.

use std::sync::Arc;

use locsim_core::{RangeMap, SensorModel};
use locsim_world::raycast::{ExactRangeMap, SurfaceTable};

use super::BenchError;
use super::timing::Clock;
use crate::run::Progress;
use crate::run::training::TrainedModel;

/// Cells of the table \[m\].
pub const CELL_M: f64 = 0.05;

/// Bins of heading of the table.
pub const HEADINGS: usize = 128;

/// A table and what it cost.
pub struct Table {
    /// Ray casts from the table.
    pub map: Arc<dyn RangeMap>,
    /// Time to build it on all threads \[s\].
    pub seconds: f64,
    /// Its size \[bytes\], where it tells.
    pub bytes: Option<usize>,
}

/// Builds the table that the filter casts from.
pub fn build(exact: &ExactRangeMap, clock: Clock<'_>, progress: &dyn Progress) -> Result<Table, BenchError> {
    progress.stage("building the ray-cast table", 1);
    let before = clock();
    let table = SurfaceTable::new(exact, CELL_M, HEADINGS)?;
    let seconds = clock().saturating_sub(before).as_secs_f64();
    progress.advance(1);
    Ok(Table { map: Arc::new(table), seconds, bytes: None })
}

/// A model as the filter uses it with the table.
pub fn prepared(model: &TrainedModel) -> Arc<dyn SensorModel> {
    Arc::clone(&model.tempered)
}
