use std::io::Write;
use std::path::Path;

use locsim_core::Drive;
use locsim_core::limits::Limits;

use crate::carmen::{self, encode_carmen};
use crate::output::write_whole;
use crate::ros::{self, encode_mcap};
use crate::{CarmenOptions, DatasetError, LogSummary, McapOptions, McapTopics};

/// The formats of measured logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFormat {
    /// A ROS 2 bag in one MCAP file: its name ends in `.mcap`.
    Mcap,
    /// A CARMEN log: every other name.
    Carmen,
}

impl LogFormat {
    /// The format of a file, by its name.
    pub fn of(path: &Path) -> Self {
        let mcap = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"));
        if mcap { Self::Mcap } else { Self::Carmen }
    }
}

/// How to read a log of either format.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LogOptions {
    /// Readings of this range (m) or more mean "no return". `None`: the log's own maximum.
    pub max_range_m: Option<f32>,
    /// Names of a bag's topics; a CARMEN log has no topics.
    pub topics: McapTopics,
}

/// Reads a log in the format of its name: [`read_mcap`](crate::read_mcap) or [`read_carmen`](crate::read_carmen).
///
/// # Errors
/// Those of the format's reader; topics are named for a CARMEN log.
pub fn read_log(path: &Path, options: &LogOptions) -> Result<(Drive, LogSummary), DatasetError> {
    read(path, options, Limits::current())
}

pub fn read(path: &Path, options: &LogOptions, limits: &Limits) -> Result<(Drive, LogSummary), DatasetError> {
    let LogOptions { max_range_m, topics } = options.clone();
    match LogFormat::of(path) {
        LogFormat::Carmen if topics != McapTopics::default() => Err(DatasetError::Topic {
            path: path.to_owned(),
            reason: "a topic is named; allowed: topics of a bag, a file named `.mcap`".to_owned(),
            found: "a CARMEN log".to_owned(),
        }),
        LogFormat::Mcap => {
            ros::read(path, &McapOptions { topics, max_range_m, ..McapOptions::default() }, limits)
        }
        LogFormat::Carmen => {
            carmen::read(path, &CarmenOptions { max_range_m, ..CarmenOptions::default() }, limits)
        }
    }
}

/// Writes a drive in the format of the file's name: [`write_mcap`](crate::write_mcap) or
/// [`write_carmen`](crate::write_carmen).
///
/// # Errors
/// Those of the format's writer.
pub fn write_log(path: &Path, drive: &Drive) -> Result<(), DatasetError> {
    write_whole(path, |out| encode_log(path, drive, out))
}

/// Writes the bytes of the file that [`write_log`] writes to `out`. `path` decides the format and the compression, and
/// is named in errors.
///
/// # Errors
/// Those of the format's writer.
pub fn encode_log(path: &Path, drive: &Drive, out: &mut dyn Write) -> Result<(), DatasetError> {
    match LogFormat::of(path) {
        LogFormat::Mcap => encode_mcap(path, drive, out),
        LogFormat::Carmen => encode_carmen(path, drive, out),
    }
}
