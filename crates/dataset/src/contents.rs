//! The contents of a log before anything is concluded from them.

use serde::Serialize;

use crate::LogFormat;

/// The contents of a log: its topics, its scanners and its transforms.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogContents {
    /// The format.
    pub format: LogFormat,
    /// The topics of a bag, or the keywords of a CARMEN log.
    pub topics: Vec<Topic>,
    /// Topics or keywords of laser scans.
    pub scanners: Vec<Scanner>,
    /// Pairs of frames in `/tf` and `/tf_static`.
    pub transforms: Vec<TransformPair>,
}

/// The messages of a topic, or the lines of a keyword.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// Type of its messages; empty where the log doesn't say.
    #[serde(rename = "type")]
    pub kind: String,
    /// How many there are.
    pub messages: usize,
    /// Messages per second, by the times of recording; `None` of a single message, or where a log has no such times.
    pub rate_hz: Option<f64>,
    /// Longest time without a message (s).
    pub longest_gap_secs: Option<f64>,
}

/// A topic of laser scans.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scanner {
    /// The topic, or the keyword.
    pub source: String,
    /// Number of scans.
    pub scans: usize,
    /// The beams of its first scan; `None` where that can't be told from one scan.
    pub beams: Option<ScannerBeams>,
}

/// The description of a scanner in its first scan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScannerBeams {
    /// The frame of its readings.
    pub frame: String,
    /// Number of beams.
    pub count: usize,
    /// Bearing of the first beam (rad).
    pub first_rad: f64,
    /// From one beam to the next (rad), counter-clockwise positive.
    pub step_rad: f64,
    /// Minimum range (m).
    pub min_range_m: f64,
    /// Maximum range (m).
    pub max_range_m: f64,
}

/// The transforms between two frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TransformPair {
    /// The frames, as `parent:child`.
    pub frames: String,
    /// Whether they come from `/tf_static`.
    pub is_static: bool,
    /// How many there are.
    pub messages: usize,
    /// Transforms per second, by their stamps; `None` of a single one.
    pub rate_hz: Option<f64>,
}

/// The number that a message says, without the digits that f32 adds.
pub fn decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| value.into())
}

/// Events per second of `count` events between the first and the last (ns).
pub fn rate_hz(count: usize, [first, last]: [i64; 2]) -> Option<f64> {
    let secs = last.saturating_sub(first) as f64 * 1e-9;
    (count > 1 && secs > 0.0).then(|| (count - 1) as f64 / secs)
}
