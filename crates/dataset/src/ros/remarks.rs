//! What is said of the times of a recording, and of messages that it lacks, in sentences.

use std::path::Path;

use super::bag::counted_messages;
use super::messages::secs;
use super::poses::Poses;
use super::stamped::Timing;

/// A reference that a localizer gives more seldom than this (s) follows the odometry for most of the time.
const SELDOM_SECS: f64 = 3.0;

/// Scans and poses that are recorded so differently long after their stamps (s) have stamps of different clocks: no driver is so late.
const OTHER_CLOCK_SECS: f64 = 1.0;

/// Poses that come more seldom than this (s), and than every so many scans, are interpolated for most of the time.
const RARE_SECS: f64 = 0.25;
const RARE_INTERVALS: f64 = 1.5;

/// The times of scans and poses.
pub struct Times<'a> {
    /// What the stamps of the scans are worth.
    pub scans: Timing,
    /// First and last scan (s).
    pub span_secs: [f64; 2],
    /// Median time between scans (s).
    pub interval_secs: f64,
    pub odometry: &'a Poses<'a>,
    pub reference: Option<&'a Poses<'a>>,
    /// What the stamps of the reference are worth, where they are known.
    pub reference_timing: Option<&'a Timing>,
}

impl Times<'_> {
    /// Whether times of recording take the place of some stamps.
    pub fn are_of_recording(&self) -> bool {
        let poses = [self.odometry.timing(), self.reference_timing];
        self.scans.is_of_recording || poses.into_iter().flatten().any(|timing| timing.is_of_recording)
    }

    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        remarks.extend(self.interpolated("odometry", self.odometry.interval_secs()));
        if let Some(reference) = self.reference {
            if let Some(secs) = reference.correction_interval_secs() {
                remarks.extend((secs > SELDOM_SECS).then(|| {
                    format!(
                        "Reference poses come every {secs:.1} s. Between them they follow the odometry, whose error can't be told from them."
                    )
                }));
            } else {
                remarks.extend(self.interpolated("reference", reference.motion_interval_secs()));
            }
        }
        remarks.extend(self.stamps());
        remarks.extend(
            self.reference.and_then(Poses::span).and_then(|span| other_clock(span.map(secs), self.span_secs)),
        );
        remarks
    }

    /// What is said of poses that come more seldom than the scans (s).
    fn interpolated(&self, name: &str, poses: Option<f64>) -> Option<String> {
        let scans = self.interval_secs;
        poses.filter(|secs| scans > 0.0 && *secs > RARE_SECS && *secs > RARE_INTERVALS * scans).map(|secs| {
            format!(
                "The {name} comes every {secs:.2} s, scans every {scans:.2} s: between its poses the robot is taken to move straight and evenly, and as the odometry where a turn begins or ends."
            )
        })
    }

    fn stamps(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        let poses = [("the odometry", self.odometry.timing()), ("the reference", self.reference_timing)];
        let poses = poses.into_iter().filter_map(|(name, timing)| Some((name, timing?)));
        let all: Vec<_> = [("the scans", &self.scans)].into_iter().chain(poses).collect();
        for (name, timing) in &all {
            if timing.astray > 0 {
                remarks.push(format!(
                    "Messages of {name} whose stamps are seconds off those before and after are left out: {}.",
                    timing.astray
                ));
            }
            if let Some([after, by]) = timing.set_back {
                remarks.push(format!(
                    "Stamps of {name} go back by {by:.2} s after {after:.2} s and go on from there, as where the clock was set back: \
                     two stretches of the drive may lie over each other, with wrong poses."
                ));
            }
            if timing.is_of_recording {
                remarks.push(format!(
                    "Stamps of {name} are whole seconds that several messages share: the times of recording are taken instead."
                ));
            }
        }
        for (name, timing) in &all[1..] {
            let is_of_recording = self.scans.is_of_recording || timing.is_of_recording;
            if let (Some(scan), Some(pose), false) =
                (self.scans.delay_secs, timing.delay_secs, is_of_recording)
                && (scan - pose).abs() > OTHER_CLOCK_SECS
            {
                remarks.push(format!(
                    "The scans are recorded {scan:.1} s after their stamps, {name} {pose:.1} s: their stamps are of different clocks."
                ));
            }
        }
        remarks
    }
}

/// What is said of a reference whose poses are all of another time than the scans (s).
fn other_clock([first, last]: [f64; 2], [from, to]: [f64; 2]) -> Option<String> {
    (last < from || first > to).then(|| {
        format!(
            "The reference poses are of {first:.1} s to {last:.1} s, the scans of {from:.1} s to {to:.1} s: stamps of one clock are needed."
        )
    })
}

/// What is said of a bag whose files hold fewer messages than its metadata count.
pub fn missing_messages(path: &Path, there: usize) -> Option<String> {
    counted_messages(path).filter(|counted| *counted > there).map(|counted| {
        format!(
            "metadata.yaml counts {counted} messages, and the files hold {there}: a part of the recording is missing, such as a -wal file."
        )
    })
}
