//! Measured logs in and out, as [`locsim_core::Drive`]: CARMEN logs and TUM trajectories.
//!
//! [`read_carmen`] reads what the Radish repository and its mirrors hold; [`write_carmen`] writes a drive so
//! that [`read_carmen`] returns it again. [`read_tum`] and [`write_tum`] exchange trajectories with `evo`.
//! Files may be compressed with gzip: readers look at the content, writers at the name.

mod carmen;
mod error;
mod lines;
mod output;
mod tum;

pub use carmen::{
    CarmenLaser, CarmenOptions, LogKind, LogSummary, OdometrySource, read_carmen, write_carmen,
};
pub use error::DatasetError;
pub use tum::{StampedPose, odometry_trajectory, read_tum, reference_trajectory, write_tum};
