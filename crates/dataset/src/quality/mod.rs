//! The quality of a recording, estimated from itself: readings, odometry against the reference, clocks.

mod body;
mod calibration;
mod clock;
mod lag;
mod odometry;
mod readings;
mod units;
mod windows;

use locsim_core::Drive;
use serde::Serialize;

use lag::{lag_to_reference, with_earlier_odometry};

pub use calibration::OdometryCalibration;
pub use clock::ClockQuality;
pub use odometry::{OdometryError, OdometryQuality, ReferenceQuality};
pub use readings::ReadingQuality;
pub(crate) use units::unlikely_units;

use crate::{LogSummary, OdometrySource};

/// Poses that come more seldom \[s\] tell no lags and no jumps.
const RAREST_SECS: f64 = 0.3;

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
        // Between rare poses the motion is interpolated, which looks like lags and jumps.
        let is_rare = |interval: Option<f64>| interval.is_some_and(|secs| secs > RAREST_SECS);
        let is_odometry_rare = is_rare(summary.odometry_interval_secs);
        let are_comparable = has_odometry && !is_odometry_rare && !is_rare(summary.reference_interval_secs);
        let lag_secs = if are_comparable { lag_to_reference(drive) } else { 0.0 };
        // What a lag makes of a motion is no error of the odometry, and no jump of the reference.
        let on_time = (lag_secs != 0.0).then(|| with_earlier_odometry(drive, lag_secs));
        let on_time = on_time.as_ref().unwrap_or(drive);
        Self {
            readings: ReadingQuality::of(drive, has_odometry),
            odometry: has_odometry.then(|| OdometryQuality::of(drive, on_time, lag_secs)),
            reference: ReferenceQuality::of(on_time, are_comparable),
            clock: ClockQuality::of(drive, summary, has_odometry && !is_odometry_rare),
        }
    }
}

#[cfg(test)]
mod tests;
