//! Measured logs in and out, as [`locsim_core::Drive`]: ROS 2 bags, CARMEN logs and TUM trajectories.
//!
//! [`read_beesoft_map`] reads the map that comes with one kind of log.
//!
//! [`read_log`] recognises the format by the first bytes, [`write_log`] by the file's name. [`read_bag`] and
//! [`write_mcap`] exchange bags with ROS 2. [`read_carmen`] reads the logs of the Radish repository and its mirrors;
//! [`write_carmen`] writes a drive so that [`read_carmen`] returns it again. [`read_tum`] and [`write_tum`] exchange trajectories with `evo`.
//! [`encode_log`] and [`encode_tum`] give the same bytes to any [`Write`](std::io::Write).
//! Files that are read may be compressed with gzip or zstd; text files are written with gzip where their name says so.

mod beams;
mod beesoft;
mod carmen;
mod contents;
mod error;
mod laser;
mod lines;
mod log;
mod output;
mod quality;
mod quaternion;
mod ros;
mod source;
mod summary;
mod tum;

#[cfg(test)]
mod mutations;
#[cfg(test)]
mod test_drives;

pub use beesoft::{BeesoftMap, is_beesoft_map, read_beesoft_map};
pub use carmen::{CarmenLaser, CarmenOptions, SICK_MAX_RANGE, read_carmen, write_carmen};
pub use contents::{LogContents, Scanner, ScannerBeams, Topic, TransformPair, decimal};
pub use error::DatasetError;
pub use log::{
    LogFormat, LogOptions, encode_log, log_files, not_a_text, read_contents, read_log, write_log,
    write_simulated_log,
};
pub use quality::{
    ClockQuality, DriveQuality, OdometryCalibration, OdometryError, OdometryQuality, ReadingQuality,
    ReferenceQuality,
};
pub use ros::{BagCopy, BagOptions, BagTopics, DriveEdit, OdometryEdit, read_bag, write_mcap};
pub use summary::{LogKind, LogSummary, MountSource, OdometrySource};
pub use tum::{StampedPose, encode_tum, odometry_trajectory, read_tum, reference_trajectory, write_tum};
