//! `locsim convert`: logs and maps of older programs, in the formats of today's.

use std::path::Path;

use locsim_dataset::{
    BeesoftMap, LogFormat, LogOptions, LogSummary, read_beesoft_map, read_log, write_log, write_simulated_log,
};
use locsim_world::map::OccupancyGrid;

use crate::LabError;

/// Stamps below this don't count from 1970, but from the beginning of a drive (s): 1973-03-03.
const EARLIEST_DATE_SECS: f64 = 1e8;

/// Writes a log in the format of `out`'s name: a bag for `.mcap`, a CARMEN log otherwise. In a bag, stamps that count from the
/// beginning of the drive count from 2024-01-01. Returns the number of scans and the summary of the log that was read.
///
/// # Errors
/// [`LabError::Dataset`] for a name of another format, and for a log that can't be read or doesn't fit into the format.
pub fn convert_log(log: &Path, options: &LogOptions, out: &Path) -> Result<(usize, LogSummary), LabError> {
    // Before the log is read, which takes time.
    LogFormat::to_write(out, Some(log))?;
    let (drive, summary) = read_log(log, options)?;
    if drive.steps[0].stamp_secs < EARLIEST_DATE_SECS {
        write_simulated_log(out, &drive)?;
    } else {
        write_log(out, &drive)?;
    }
    Ok((drive.steps.len(), summary))
}

/// The grid of a map of BeeSoft, by the default thresholds of ROS.
///
/// # Errors
/// [`LabError::Dataset`] for a file that is no such map, [`LabError::Map`] for a size that a grid can't have.
pub fn convert_map(map: &Path) -> Result<OccupancyGrid, LabError> {
    let BeesoftMap { width, height, resolution_m, free } = read_beesoft_map(map)?;
    let occupancy = free.iter().map(|free| free.map_or(0.5, |free| 1.0 - free)).collect();
    OccupancyGrid::of_occupancy([width, height], resolution_m, occupancy)
        .map_err(|source| LabError::Map { path: map.to_owned(), source })
}
