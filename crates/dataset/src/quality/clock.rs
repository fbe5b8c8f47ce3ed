use locsim_core::{Drive, median};
use serde::Serialize;

use super::lag::odometry_lag;
use crate::LogSummary;

/// A gap is an interval this many times the usual one.
const GAP: f64 = 3.0;

/// The stamps of a drive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockQuality {
    /// Stamp of the first scan \[s\].
    pub first_secs: f64,
    /// Time from the first scan to the last \[s\].
    pub duration_secs: f64,
    /// Median time between scans \[s\]; `None` of a single scan.
    pub interval_secs: Option<f64>,
    /// Number of intervals between scans more than three times as long as the median one.
    pub gaps: usize,
    /// The longest interval between scans \[s\].
    pub longest_gap_secs: f64,
    /// Number of scans whose stamp went backwards or leapt and was repaired.
    pub repaired: usize,
    /// Number of scans with the stamp of the scan before.
    pub repeated: usize,
    /// Number of scans with all readings of the scan before, though the robot has moved.
    pub stale: usize,
    /// Number of scans left out, without readings or without odometry at their time.
    pub dropped: usize,
    /// How much later than the scans' stamps the odometry shows the turns that the scans show \[s\]; `None` where the robot
    /// turned too little, or scans are too rare.
    pub odometry_lag_secs: Option<f64>,
    /// Standard error of that lag \[s\].
    pub odometry_lag_error_secs: Option<f64>,
}

impl ClockQuality {
    pub(super) fn of(drive: &Drive, summary: &LogSummary, has_odometry: bool) -> Self {
        let stamps = || drive.steps.iter().map(|step| step.stamp_secs);
        let intervals: Vec<f64> = stamps().zip(stamps().skip(1)).map(|(a, b)| b - a).collect();
        let usual = median(&mut intervals.clone());
        let (first, last) = (stamps().next().unwrap_or_default(), stamps().next_back().unwrap_or_default());
        let lag = if has_odometry { odometry_lag(drive, usual) } else { None };
        Self {
            first_secs: first,
            duration_secs: last - first,
            interval_secs: (!intervals.is_empty()).then_some(usual),
            gaps: intervals.iter().filter(|interval| **interval > GAP * usual && **interval > 0.0).count(),
            longest_gap_secs: intervals.iter().copied().fold(0.0, f64::max),
            repaired: summary.stamps_repaired,
            repeated: summary.stamps_repeated,
            stale: drive.stale_scans().len(),
            dropped: summary.scans_dropped,
            odometry_lag_secs: lag.map(|lag| lag.secs),
            odometry_lag_error_secs: lag.map(|lag| lag.error_secs),
        }
    }
}
