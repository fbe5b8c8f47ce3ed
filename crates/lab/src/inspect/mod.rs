//! `locsim inspect`: the contents of a log, the quality of its recording, and a split of it into a part for the map, one for
//! training and one for the filter.

mod init;
mod picture;
mod split;
mod text;

use std::path::Path;

use locsim_core::{Drive, Pose2};
use locsim_dataset::{
    DatasetError, DriveQuality, LogContents, LogFormat, LogKind, LogOptions, LogSummary, MountSource,
    OdometrySource, Scanner, decimal, read_contents, read_log,
};
use locsim_gap::LEAST_SCANS;
use serde::Serialize;

pub use init::{NewScenario, rounded};
pub use picture::picture;
pub use split::{COVERED, Part, Role, Split, least_covered};

use crate::LabError;

/// Topics that an error lists, at the most.
const LISTED_TOPICS: usize = 20;

/// The contents of a log, and the commands that can work on it.
#[derive(Debug, Serialize)]
pub struct Inspection {
    /// The log's file.
    pub file: String,
    /// Topics, scanners, transforms.
    #[serde(flatten)]
    pub contents: LogContents,
    /// The drive; `None` where none can be read, not even without odometry.
    pub drive: Option<DriveFacts>,
    /// Why the log can't be read as a drive with odometry.
    pub problem: Option<String>,
    /// Topics and transforms that may hold reference poses, where none was found.
    pub reference_candidates: Vec<String>,
    /// The inputs that each command would lack.
    pub lacks: Lacks,
    /// Remarks on what may go wrong.
    pub warnings: Vec<String>,
    /// How to cut the log for `locsim run`; `None` where it is too short or has no reference.
    pub split: Option<Split>,
    /// The drive itself, for the picture.
    #[serde(skip)]
    pub recording: Option<Drive>,
}

/// A drive in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct DriveFacts {
    /// The topic or the keyword of the scans.
    pub scan_source: String,
    /// Number of scans.
    pub scans: usize,
    /// The laser.
    pub laser: LaserFacts,
    /// The kind of the poses.
    pub kind: LogKind,
    /// Where the odometry comes from.
    pub odometry_source: OdometrySource,
    /// How all this was recognised, in words.
    pub evidence: String,
    /// Median standard deviations of the reference \[m, m, rad\], where its messages have covariances.
    pub reference_deviation: Option<[f64; 3]>,
    /// Median time between reference poses \[s\], where they come apart from the scans.
    pub reference_interval_secs: Option<f64>,
    /// Number of scans whose reference pose is interpolated.
    pub references_interpolated: usize,
    /// Estimates from the drive.
    #[serde(flatten)]
    pub quality: DriveQuality,
}

/// The description of a laser.
#[derive(Clone, Debug, Serialize)]
pub struct LaserFacts {
    /// Number of beams.
    pub beams: usize,
    /// Bearing of the first beam \[rad\].
    pub first_rad: f64,
    /// Mean step from one beam to the next \[rad\], counter-clockwise positive; 0 of a single beam.
    pub step_rad: f64,
    /// Minimum range \[m\].
    pub min_range_m: f64,
    /// Maximum range \[m\].
    pub max_range_m: f64,
    /// From the first beam to the last \[s\].
    pub sweep_secs: f64,
    /// Where it sits on the robot.
    pub mount: Pose2,
    /// How that is known.
    pub mount_source: MountSource,
}

/// The inputs that the log lacks for each command, in words; nothing where a command can work on it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Lacks {
    /// For `locsim run`.
    pub run: Vec<String>,
    /// For `locsim map`.
    pub map: Vec<String>,
    /// For `locsim gap`.
    pub gap: Vec<String>,
}

impl Inspection {
    /// Reads a log and looks at all that it has.
    ///
    /// # Errors
    /// [`LabError::Dataset`] for a file that is no log, is damaged, or costs more than the limits allow. A log that lacks
    /// something is no error.
    pub fn of(log: &Path, options: &LogOptions) -> Result<Self, LabError> {
        let contents = read_contents(log)?;
        let (options, chosen) = with_scanner(options, &contents);
        let (read, problem) = match read_log(log, &options) {
            Ok(read) => (Some(read), None),
            Err(error) => {
                let alone = LogOptions { without_odometry: true, ..options.clone() };
                let reason = without_path(&error.to_string(), log);
                (scans_alone(&error).then(|| read_log(log, &alone).ok()).flatten(), Some(reason))
            }
        };
        let facts = read.as_ref().map(|(drive, summary)| DriveFacts::of(drive, summary));
        let (recording, remarks) =
            read.map(|(drive, summary)| (Some(drive), summary.remarks)).unwrap_or_default();
        let split = recording.as_ref().and_then(Split::propose);
        let references = facts.as_ref().map_or(0, DriveFacts::references);
        let reference_candidates = if references == 0 { reference_candidates(&contents) } else { Vec::new() };
        let mut warnings = facts.as_ref().map(|facts| warnings(facts, split.as_ref())).unwrap_or_default();
        warnings.extend(remarks);
        warnings.extend(chosen);
        Ok(Self {
            file: log.display().to_string(),
            lacks: lacks(facts.as_ref(), split.as_ref()),
            warnings,
            reference_candidates,
            contents,
            drive: facts,
            problem,
            split,
            recording,
        })
    }
}

impl Inspection {
    /// How the log's reference may be named, where none was found.
    fn reference_in_words(&self) -> String {
        match (&self.reference_candidates[..], &self.contents.topics[..]) {
            ([], _) if self.contents.format == LogFormat::Carmen => {
                "TRUEPOS lines are reference poses".to_owned()
            }
            ([], topics) => {
                let topics: Vec<_> =
                    topics.iter().take(LISTED_TOPICS).map(|topic| topic.name.as_str()).collect();
                format!("--reference-topic names a topic of poses; found: {}", topics.join(", "))
            }
            (candidates, _) => format!("--reference-topic may name {}", candidates.join(" or ")),
        }
    }
}

/// Options that name a scanner: the one with the most readings, where several are there, none is called `/scan` and none is named.
fn with_scanner(options: &LogOptions, contents: &LogContents) -> (LogOptions, Option<String>) {
    let scanners = &contents.scanners;
    let is_clear = options.topics.scan.is_some()
        || contents.format != LogFormat::Bag
        || scanners.len() < 2
        || scanners.iter().any(|scanner| scanner.source == "/scan");
    let readings = |scanner: &Scanner| {
        scanner.scans.saturating_mul(scanner.beams.as_ref().map_or(1, |beams| beams.count))
    };
    // The first of those with most readings.
    let most = scanners.iter().rev().max_by_key(|scanner| readings(scanner));
    let Some(most) = most.filter(|_| !is_clear) else {
        return (options.clone(), None);
    };
    let mut options = options.clone();
    options.topics.scan = Some(most.source.clone());
    let told =
        format!("Several scanners, none called /scan: {} is read; --scan-topic names another.", most.source);
    (options, Some(told))
}

/// Topics of poses, and transforms from a frame that REP-105 doesn't give to odometry.
fn reference_candidates(contents: &LogContents) -> Vec<String> {
    const TYPES: [&str; 3] = ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped"];
    let topics = contents
        .topics
        .iter()
        .filter(|topic| TYPES.iter().any(|name| topic.kind == format!("geometry_msgs/msg/{name}")));
    let pairs = || {
        let moving = contents.transforms.iter().filter(|pair| !pair.is_static);
        moving.filter_map(|pair| pair.frames.split_once(':'))
    };
    let origins = pairs().filter(|(parent, _)| ["map", "world", "earth", "mocap"].contains(parent));
    let transforms = origins.map(|(origin, child)| {
        // The last frame that moves on the way down is the robot's base; `odom` isn't.
        let mut base = child;
        for _ in pairs() {
            let mut below = pairs().filter(|(parent, _)| *parent == base).map(|(_, child)| child);
            let Some(only) = below.next().filter(|_| below.next().is_none()) else { break };
            base = only;
        }
        format!("{origin}:{base}")
    });
    topics.map(|topic| topic.name.clone()).chain(transforms).collect()
}

/// Whether a log with this error may be readable without its odometry.
fn scans_alone(error: &DatasetError) -> bool {
    matches!(
        error,
        DatasetError::Topic { .. } | DatasetError::Message { .. } | DatasetError::NoOdometry { .. }
    )
}

impl DriveFacts {
    fn of(drive: &Drive, summary: &LogSummary) -> Self {
        let laser = &drive.laser;
        let bearings = laser.bearings();
        let (first, last) = (f64::from(bearings[0]), f64::from(bearings[bearings.len() - 1]));
        let times = laser.beam_times_secs();
        Self {
            scan_source: summary.scan_source.clone(),
            scans: drive.steps.len(),
            laser: LaserFacts {
                beams: bearings.len(),
                first_rad: first,
                step_rad: (last - first) / (bearings.len() - 1).max(1) as f64,
                min_range_m: decimal(laser.min_range()),
                max_range_m: decimal(laser.max_range()),
                sweep_secs: f64::from(times[times.len() - 1]) - f64::from(times[0]),
                mount: laser.base_from_laser(),
                mount_source: summary.mount,
            },
            kind: summary.kind,
            odometry_source: summary.odometry,
            evidence: summary.evidence.clone(),
            reference_deviation: summary.reference_deviation,
            reference_interval_secs: summary.reference_interval_secs,
            references_interpolated: summary.references_interpolated,
            quality: DriveQuality::of(drive, summary),
        }
    }

    /// Number of scans with a reference pose.
    pub fn references(&self) -> usize {
        self.quality.reference.as_ref().map_or(0, |reference| reference.scans)
    }
}

fn lacks(facts: Option<&DriveFacts>, split: Option<&Split>) -> Lacks {
    let Some(facts) = facts else {
        let nothing = vec!["a drive that can be read: see the reason above".to_owned()];
        return Lacks { run: nothing.clone(), map: nothing.clone(), gap: nothing };
    };
    let mut lacks = Lacks::default();
    let references = facts.references();
    if facts.odometry_source == OdometrySource::Missing {
        for lack in [&mut lacks.run, &mut lacks.map, &mut lacks.gap] {
            lack.push(
                "odometry at the times of the scans: a topic of nav_msgs/msg/Odometry, or the transform odom:base_link".to_owned(),
            );
        }
    }
    if references == 0 {
        lacks.map.push("a reference: the pose from which each scan was taken".to_owned());
        lacks.gap.push("a reference: simulated scans are taken from its poses".to_owned());
    } else if references < LEAST_SCANS {
        lacks.gap.push(format!(
            "scans with a reference pose: {references} of the {LEAST_SCANS} that it needs at least"
        ));
    } else {
        // Beside a map of its own, a scenario of `init` localizes on a half.
        let localized = split.map_or(references / 2, |split| split.localized(facts.scans));
        if localized < LEAST_SCANS {
            lacks.gap.push(format!(
                "scans to localize on: the proposed split has {localized} of the {LEAST_SCANS} that it needs at least; give \
                 `localize_scans` more of the log"
            ));
        }
    }
    if facts.scans < 2 {
        lacks.run.push("scans: it has one".to_owned());
    }
    if facts.quality.readings.longest_return_m.is_none_or(|longest| longest <= 0.0) {
        for lack in [&mut lacks.run, &mut lacks.map, &mut lacks.gap] {
            lack.push("returns: no reading is a range".to_owned());
        }
    }
    lacks
}

/// An error's text without the path that it begins with; a line number stays.
fn without_path(error: &str, path: &Path) -> String {
    match error.strip_prefix(&format!("{}:", path.display())) {
        None => error.to_owned(),
        Some(rest) => rest.strip_prefix(' ').map_or_else(|| format!("line {rest}"), str::to_owned),
    }
}

/// Shares of a drive, lags and errors beyond which a remark is worth reading.
const NOTABLE: Notable = Notable {
    lag_secs: 0.08,
    position_per_m: 0.1,
    references: 0.95,
    unusable: 0.2,
    lag_intervals: 0.5,
    repeated: 5e-3,
};

/// A lag that is so near half of a sweep may be that of the sweep \[s\]: what drives without a lag have.
const HALF_SWEEP_SECS: f64 = 0.03;

struct Notable {
    /// What clutter and few turns make of no lag at all is up to 0.05 s.
    lag_secs: f64,
    /// Wheel odometry is off by some per cent; by a tenth, something is wrong with it or with the reference.
    position_per_m: f64,
    references: f64,
    unusable: f64,
    /// Share of the time between scans: a lag below is within their interpolation.
    lag_intervals: f64,
    /// Far returns that are alike to the last digit: a wall gives no more than a few of these.
    repeated: f64,
}

/// Odometry that stood still \[s\] while the reference moved \[m\].
pub fn frozen_odometry([secs, metres]: [f64; 2]) -> String {
    format!(
        "The odometry stands still for {secs:.1} s, in which the reference moves by {metres:.2} m: it wasn't recorded then."
    )
}

/// Sentences on what makes maps and simulations of a recording wrong: no returns that look like returns, a reference of another frame, and
/// stamps.
pub fn doubts(quality: &DriveQuality) -> Vec<String> {
    let no_returns = quality.readings.repeated.filter(|[_, share]| *share >= NOTABLE.repeated).map(|[at, share]| {
        format!(
            "{:.1} % of the readings are {at:.3} m to the last digit: these may be no returns, which the recording doesn't say. \
             `--max-range {at:.3}` does.",
            100.0 * share
        )
    });
    let body = quality.reference.as_ref().and_then(|reference| reference.body).map(|body| {
        format!(
            "The reference moves as a body at ({:.2}, {:.2}) m on the odometry's, turned by {:.1} deg: it is the pose of another frame, and is \
             taken for the robot's. Ranges are off by as much.",
            body.x,
            body.y,
            body.theta.to_degrees()
        )
    });
    no_returns.into_iter().chain(body).chain(lags(quality)).collect()
}

/// Sentences on an odometry, and on a reference, that are late or early: against the scans or, of the odometry, against the reference
/// where the scans don't tell.
fn lags(quality: &DriveQuality) -> Vec<String> {
    let clock = &quality.clock;
    let least = NOTABLE.lag_secs.max(NOTABLE.lag_intervals * clock.interval_secs.unwrap_or(0.0));
    let to_reference = quality.odometry.as_ref().map_or(0.0, |odometry| odometry.lag_secs);
    // A lag that may be twice its error off tells nothing of one that is worth a word.
    let is_sure = clock.odometry_lag_error_secs.is_some_and(|error| 2.0 * error < least);
    told_lags(clock.odometry_lag_secs.filter(|_| is_sure), to_reference, least, clock.interval_secs)
}

/// The same by the odometry's lags \[s\] against the scans, if they tell one, and against the reference, 0 for none. A laser that sweeps all the time
/// `between_scans` \[s\], and doesn't say so, seems to be early by half of that.
fn told_lags(
    to_scans: Option<f64>,
    to_reference: f64,
    least: f64,
    between_scans: Option<f64>,
) -> Vec<String> {
    let told = |what: &str, than: &str, lag: f64| {
        let half_sweep = between_scans.map(|secs| 0.5 * secs).filter(|_| than == "scans");
        let is_sweep = half_sweep.is_some_and(|secs| (lag - secs).abs() < HALF_SWEEP_SECS);
        let reason = if is_sweep {
            "which is half of the time between scans: a laser that sweeps all of it and has no `time_increment` looks like this; `laser.scan_secs` is the scenario's key. Otherwise their stamps are of different clocks, or late."
        } else if lag > 0.0 && than == "scans" {
            "so their stamps are of different clocks, or late. Of a laser that sweeps without a `time_increment`, half of the sweep is in this."
        } else {
            "so their stamps are of different clocks, or late."
        };
        let side = if lag > 0.0 { "lags behind" } else { "is ahead of" };
        (lag.abs() >= least)
            .then(|| format!("The {what} {side} the {than} by {:.0} ms, {reason}", 1e3 * lag.abs()))
    };
    let all = match to_scans {
        None => [told("odometry", "reference", to_reference), None],
        Some(lag) if to_reference == 0.0 => [told("odometry", "scans", lag), None],
        Some(lag) => [told("odometry", "scans", lag), told("reference", "scans", lag - to_reference)],
    };
    all.into_iter().flatten().collect()
}

fn warnings(facts: &DriveFacts, split: Option<&Split>) -> Vec<String> {
    let mut warnings = Vec::new();
    let mut warn = |is_so: bool, text: String| {
        if is_so {
            warnings.push(text);
        }
    };
    let DriveQuality { readings, odometry, reference, clock } = &facts.quality;
    warn(
        facts.laser.mount_source == MountSource::Unknown,
        "The laser's mount is unknown; it is taken to be the robot's origin. A wrong mount shows as an error that turns \
         with the robot."
            .to_owned(),
    );
    warn(facts.kind == LogKind::Localized, LogKind::LOCALIZED.to_owned());
    if let Some(reference) = reference {
        let share = reference.scans as f64 / facts.scans as f64;
        let gap = reference.longest_gap_secs;
        warn(
            share < NOTABLE.references,
            format!(
                "{:.0} % of the scans have no reference pose; the longest gap is {gap:.1} s.",
                100.0 * (1.0 - share)
            ),
        );
        warn(
            reference.jumps > 0,
            format!(
                "The reference jumps against the odometry (steps: {}), by {:.0} cm and {:.1} deg in the median: a localizer has \
                 corrected itself, or wheels have slipped. The odometry's error has these jumps in it.",
                reference.jumps,
                100.0 * reference.jump_m,
                reference.jump_rad.to_degrees()
            ),
        );
    }
    if let Some(odometry) = odometry {
        let jumps = odometry.jumps.unwrap_or(0);
        warn(jumps > 0, format!("The odometry jumps {jumps} times."));
        let frozen = [odometry.frozen_secs, odometry.frozen_m];
        warn(frozen[0] > 0.0, frozen_odometry(frozen));
        if let Some(error) = &odometry.error {
            warn(
                error.position_per_m == 0.0,
                "Odometry and reference are the same poses: a filter has nothing to correct.".to_owned(),
            );
            let body = reference.as_ref().and_then(|reference| reference.body);
            warn(
                error.position_per_m > NOTABLE.position_per_m && body.is_none(),
                format!("The odometry is off by {:.0} cm per metre driven.", 100.0 * error.position_per_m),
            );
        }
    }
    for doubt in doubts(&facts.quality) {
        warn(true, doubt);
    }
    warn(
        2 * clock.repeated > facts.scans,
        format!(
            "{} scans have the stamp of the scan before: speeds, gaps and lags can't be told.",
            clock.repeated
        ),
    );
    warn(
        clock.stale > 0,
        format!(
            "{} scans have all readings of the scan before, though the robot has moved: the driver has sent them again.",
            clock.stale
        ),
    );
    warn(
        clock.gaps > 0,
        format!("Gaps between scans: {}, the longest of {:.1} s.", clock.gaps, clock.longest_gap_secs),
    );
    warn(
        readings.unusable_share > NOTABLE.unusable,
        format!("{:.0} % of the readings are unusable.", 100.0 * readings.unusable_share),
    );
    if let Some(split) = split {
        warn(
            split.least_localized < split::COVERED,
            format!(
                "In the worst part of the drive to be localized only {:.0} % of the readings end where the map knows \
                 something: a filter may get lost there. Drive through each place twice.",
                100.0 * split.least_localized
            ),
        );
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_late_is_told_by_both_lags() {
        for (to_scans, to_reference, wanted) in [
            (Some(0.22), 0.19, &["The odometry lags behind the scans by 220 ms"][..]),
            // The odometry is on time, and ahead of the reference.
            (Some(0.01), -0.12, &["The reference lags behind the scans by 130 ms"]),
            (Some(0.2), 0.0, &["The odometry lags behind the scans by 200 ms"]),
            (None, -0.3, &["The odometry is ahead of the reference by 300 ms"]),
            // The scans are late, or those two are early.
            (
                Some(-0.3),
                -0.1,
                &[
                    "The odometry is ahead of the scans by 300 ms",
                    "The reference is ahead of the scans by 200 ms",
                ],
            ),
            (Some(0.05), 0.04, &[]),
            (None, 0.0, &[]),
        ] {
            let told = told_lags(to_scans, to_reference, 0.08, Some(0.2));
            assert_eq!(told.len(), wanted.len(), "{told:?}");
            assert!(told.iter().zip(wanted).all(|(told, wanted)| told.starts_with(wanted)), "{told:?}");
            assert!(told.iter().all(|told| !told.contains("scan_secs")), "{told:?}");
        }
        let sweeps = |between_scans: f64| told_lags(Some(0.101), 0.0, 0.08, Some(between_scans));
        assert!(sweeps(0.2)[0].contains("`laser.scan_secs`") && !sweeps(0.1)[0].contains("scan_secs"));
    }
}
