//! The filter's fast path: a table of ray casts, and sensor models prepared as tables.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use locsim_core::{DependsOn, EndpointGrid, Laser, LikelihoodGrid, SensorModel};
use locsim_sensor::Prepared;
use locsim_world::raycast::{ExactRangeMap, RangeTable, RangeTableOptions};

use crate::BenchError;
use locsim_core::Clock;
use locsim_core::Progress;
use locsim_lab::run::TrainedModel;

/// Units of progress of a table.
const TICKS: u64 = 100;

/// A table and what it cost.
pub struct Table {
    /// Ray casts from the table.
    pub map: Arc<RangeTable>,
    /// Time to build it on all threads \[s\].
    pub seconds: f64,
}

/// Builds the table that the filter casts from, with the options that scenarios have by default, not from a cache.
pub fn build(exact: &ExactRangeMap, clock: Clock<'_>, progress: &dyn Progress) -> Result<Table, BenchError> {
    progress.stage("building the range table", TICKS);
    let done = AtomicU64::new(0);
    let before = clock();
    let table = RangeTable::new(exact, &RangeTableOptions::default(), &|share| {
        let now = (share * TICKS as f64) as u64;
        progress.advance(now.saturating_sub(done.fetch_max(now, Ordering::Relaxed)));
    })?;
    let seconds = clock().saturating_sub(before).as_secs_f64();
    Ok(Table { map: Arc::new(table), seconds })
}

/// A sensor model in the two forms that are compared.
pub struct BenchModel {
    /// Its name.
    pub label: String,
    /// With floor and exponent.
    pub exact: Arc<dyn SensorModel>,
    /// The same as a table, if it can be one.
    pub prepared: Arc<dyn SensorModel>,
}

impl BenchModel {
    /// Prepares a model that was trained without tables.
    pub fn new(model: TrainedModel, laser: &Laser, endpoints: &EndpointGrid) -> Result<Self, BenchError> {
        let TrainedModel { label, tempered: exact, .. } = model;
        let prepared: Arc<dyn SensorModel> = if exact.depends_on() == DependsOn::Everything {
            Arc::clone(&exact)
        } else {
            Arc::new(Prepared::new(Arc::clone(&exact), LikelihoodGrid::for_laser(laser), endpoints)?)
        };
        Ok(Self { label, exact, prepared })
    }
}
