//! The quality of a recording, estimated from itself: readings, odometry against the reference, clocks.

mod clock;
mod lag;
mod odometry;
mod readings;

use locsim_core::Drive;
use serde::Serialize;

pub use clock::ClockQuality;
pub use odometry::{OdometryError, OdometryQuality, ReferenceQuality};
pub use readings::ReadingQuality;

use crate::{LogSummary, OdometrySource};

/// The quality of a recording. What can't be estimated from it is `None`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DriveQuality {
    /// The laser's readings.
    pub readings: ReadingQuality,
    /// The odometry; `None` in a log without.
    pub odometry: Option<OdometryQuality>,
    /// The reference poses; `None` in a log without.
    pub reference: Option<ReferenceQuality>,
    /// The stamps.
    pub clock: ClockQuality,
}

impl DriveQuality {
    /// Estimates the quality of a drive that was read with this summary.
    pub fn of(drive: &Drive, summary: &LogSummary) -> Self {
        let has_odometry = summary.odometry != OdometrySource::Missing;
        Self {
            readings: ReadingQuality::of(drive, has_odometry),
            odometry: has_odometry.then(|| OdometryQuality::of(drive)),
            reference: ReferenceQuality::of(drive, has_odometry),
            clock: ClockQuality::of(drive, summary, has_odometry),
        }
    }
}

#[cfg(test)]
mod tests;
