//! The log of a scenario: how it is read, what it must have, its map, and the scans of each use.

use std::path::Path;

use locsim_core::{Drive, DriveStep, Pose2, Progress, RangeMap};
use locsim_dataset::{BagTopics, DatasetError, LogFormat, LogOptions, LogSummary, read_log};
use locsim_mapping::{MappingOptions, occupancy_from_drive, walls_from_drive};
use locsim_scenario::{self as scenario, Log, LogMap, Scenario, Source};
use locsim_world::map::{Geometry, MapError};
use locsim_world::raycast::ExactRangeMap;

use super::corrected::corrected;
use super::training::{ScanData, check_files};
use crate::LabError;
use crate::inspect::{COVERED, least_covered};

/// Consecutive training scans of a log that are held out together: some metres of driving.
const RUN: u32 = 20;

/// The log of a scenario, which has all that the scenario wants of it.
pub(super) struct MeasuredLog {
    pub drive: Drive,
    pub summary: LogSummary,
    /// What was corrected in its scans, in sentences.
    pub corrections: Vec<String>,
    /// A defect of the split that a run survives, in words.
    pub warning: Option<String>,
}

impl MeasuredLog {
    /// Reads the log and checks it, before anything that takes time.
    ///
    /// # Errors
    /// [`LabError::Dataset`] for a log that can't be read, and those of [`check_drive`].
    pub fn read(scenario: &Scenario, log: &Log) -> Result<Self, LabError> {
        let (drive, summary) = read_scenario_log(scenario, log)?;
        check_drive(scenario, log, &drive, &summary)?;
        let (drive, corrections) = corrected(drive);
        let warning = uncovered(log, &drive);
        Ok(Self { drive, summary, corrections, warning })
    }
}

/// A sentence on localized scans that see what no scan of the map saw.
fn uncovered(log: &Log, drive: &Drive) -> Option<String> {
    let (LogMap::FromScans { scans, .. } | LogMap::Walls { scans }) = &log.map else { return None };
    let covered = least_covered(drive, &log.localize_scans, scans)?;
    (covered < COVERED).then(|| {
        format!(
            "In one stretch of `log.localize_scans` only {:.0} % of the readings end where scans of `log.map_scans` have \
             readings, and filters may get lost there. `locsim inspect` proposes another split.",
            100.0 * covered
        )
    })
}

/// The localized scans that have a reference pose, where some have; with a sentence on the others. Between them the filter follows the odometry.
pub(super) fn judged(drive: &Drive, localized: Vec<usize>) -> (Vec<usize>, Option<String>) {
    let all = localized.len();
    let known: Vec<usize> =
        localized.iter().copied().filter(|&i| drive.steps[i].reference.is_some()).collect();
    let without = all - known.len();
    if known.is_empty() || without == 0 {
        return (localized, None);
    }
    let told = format!(
        "{without} of the {all} localized scans have no reference pose to hold an estimate against, and are left out."
    );
    (known, Some(told))
}

/// Whether a log has all that a scenario wants of it.
///
/// # Errors
/// [`LabError::Log`]: no scan to localize on, no reference poses where the map, the training or the start needs them, a
/// simulated laser of another maximum range. [`LabError::ModelFile`]: a model that is of no use here.
fn check_drive(scenario: &Scenario, log: &Log, drive: &Drive, summary: &LogSummary) -> Result<(), LabError> {
    let refuse = |what: String| Err(LabError::Log { path: log.file.clone(), what });
    let referenced = |steps: &[usize]| steps.iter().filter(|&&i| drive.steps[i].reference.is_some()).count();
    let map_scans = match &log.map {
        LogMap::File(_) => None,
        LogMap::FromScans { scans, .. } | LogMap::Walls { scans } => Some(scans),
    };
    let train_scans = (!log.train_scans.is_empty()).then_some(&log.train_scans);
    for (key, scans) in [("log.map_scans", map_scans), ("log.train_scans", train_scans)] {
        if let Some(scans) = scans
            && referenced(&selected(drive, scans)) == 0
        {
            return refuse(format!("{key}: {}", no_reference(&summary.topics, &summary.transforms)));
        }
    }
    let localized = selected(drive, &log.localize_scans);
    if localized.is_empty() {
        return refuse("no scan is left to localize on; widen `log.localize_scans`".to_owned());
    }
    let known = referenced(&localized);
    if known == 0 && matches!(scenario.filter.start, scenario::Start::Tracking(_)) {
        return refuse(format!(
            "filter.start: `tracking` begins at a reference pose; `global`, or `around` with a pose, needs none; {}",
            no_reference(&summary.topics, &summary.transforms)
        ));
    }
    if known > 0 && 2 * known < localized.len() {
        return refuse(format!(
            "log.localize_scans: {} of the {} scans have no reference pose; allowed: scans of which half have one, or none",
            localized.len() - known,
            localized.len()
        ));
    }
    let most =
        log.simulator.as_ref().filter(|_| log.train_scans.is_empty()).map(|it| it.laser.max_range_m as f32);
    if let Some(most) = most.filter(|most| *most != drive.laser.max_range()) {
        return refuse(format!(
            "laser.max_range_m: models that are trained at up to {most} m don't suit the log's laser of {} m",
            drive.laser.max_range()
        ));
    }
    check_files(&scenario.models, drive.laser.max_range())
}

/// Indices of the steps within shares of a drive.
pub(crate) fn selected(drive: &Drive, shares: &[[f64; 2]]) -> Vec<usize> {
    let n = drive.steps.len();
    let inside = |i: usize| {
        let share = i as f64 / n as f64;
        shares.iter().any(|[from, to]| (*from..*to).contains(&share))
    };
    (0..n).filter(|&i| inside(i)).collect()
}

/// Attaches the map's file to what is wrong with it.
pub(super) fn unusable(path: &Path) -> impl FnOnce(MapError) -> LabError {
    let path = path.to_owned();
    move |source| LabError::Map { path, source }
}

/// The error of a log without reference poses; lists its topics and transforms.
pub(crate) fn no_reference(topics: &[String], transforms: &[String]) -> String {
    let needed = "no scan has a reference pose";
    if topics.is_empty() {
        return format!("{needed}; a CARMEN log has them in TRUEPOS lines, or is a corrected log as a whole");
    }
    let transforms = if transforms.is_empty() {
        String::new()
    } else {
        format!("; transforms: {}", transforms.join(", "))
    };
    format!(
        "{needed}; `log.topics.reference` or --reference-topic names a topic of them, or a transform such as map:base_link; \
         found: {}{transforms}",
        topics.join(", ")
    )
}

/// The map of a measured log: from its file, or from the log's own scans.
pub(crate) fn log_map(log: &Log, drive: &Drive, progress: &dyn Progress) -> Result<Geometry, LabError> {
    let built = match &log.map {
        LogMap::File(file) => {
            let map = scenario::load_map(file)?.geometry;
            let references = drive.steps.iter().filter_map(|step| step.reference);
            let positions: Vec<_> = references.map(|pose| [pose.x, pose.y]).collect();
            scenario::check_reading(file, &map, &positions)?;
            return Ok(map);
        }
        LogMap::FromScans { scans, resolution_m } => {
            let (drive, _) = &corrected(drive.clone());
            progress.stage("building the map", 1);
            let options = MappingOptions { resolution_m: *resolution_m, ..MappingOptions::default() };
            occupancy_from_drive(drive, &selected(drive, scans), &options).and_then(|grid| grid.to_geometry())
        }
        LogMap::Walls { scans } => {
            let (drive, _) = &corrected(drive.clone());
            progress.stage("building the map", 1);
            walls_from_drive(drive, &selected(drive, scans), &MappingOptions::default())
                .and_then(|walls| walls.to_geometry())
        }
    };
    progress.advance(1);
    built.map_err(unusable(&log.file))
}

/// Fewest training scans that models are fitted to.
const FEWEST_TRAINING_SCANS: usize = 4;

/// Refuses too few training scans.
///
/// # Errors
/// [`LabError::Log`].
pub(super) fn enough_to_train_on(log: &Log, scans: usize) -> Result<(), LabError> {
    if scans >= FEWEST_TRAINING_SCANS {
        return Ok(());
    }
    let what = format!(
        "{scans} training scans have a reference pose in the map's free space; fitting takes at least {FEWEST_TRAINING_SCANS}: \
         `log.train_scans` and `log.map_scans` choose them"
    );
    Err(LabError::Log { path: log.file.clone(), what })
}

/// Reads the log of a scenario.
///
/// # Errors
/// [`LabError::Scenario`] for topics that it names and that aren't there, [`LabError::Dataset`] for a log that can't be read.
pub fn read_scenario_log(scenario: &Scenario, log: &Log) -> Result<(Drive, LogSummary), LabError> {
    read_log(&log.file, &read_options(log)).map_err(|error| match error {
        DatasetError::Topic { .. } if log.topics != BagTopics::default() => {
            scenario.refusal("log.topics", error.to_string()).into()
        }
        error => error.into(),
    })
}

/// How the log of a scenario is read.
pub fn read_options(log: &Log) -> LogOptions {
    let max_range_m = log.max_range_m.map(|max| max as f32);
    LogOptions { max_range_m, topics: log.topics.clone(), ..LogOptions::default() }
}

/// How a log that is named beside a scenario is read: as given, and where nothing is given as the scenario's own log.
pub fn options_beside(scenario: &Scenario, log: &Path, given: &LogOptions) -> LogOptions {
    let Source::Log(own) = &scenario.source else { return given.clone() };
    let mut own = read_options(own);
    if !matches!(LogFormat::of_content(log), Ok(LogFormat::Bag)) {
        own.topics = BagTopics::default();
    }
    given.clone().or(&own)
}

/// Training scans of a log: those whose reference pose lies in the map's free space, at most as many as asked
/// for, evenly spread; and how many there were.
pub(super) fn measured_scans(
    drive: &Drive,
    steps: &[usize],
    map: &ExactRangeMap,
    training: &scenario::Training,
) -> (ScanData, usize) {
    let beams = training.beams.map_or(drive.laser.beam_count(), |beams| beams as usize);
    let (laser, kept) = drive.laser.thinned(beams);
    let usable: Vec<(Pose2, &DriveStep)> = steps
        .iter()
        .map(|&i| &drive.steps[i])
        .filter_map(|step| Some((step.reference?, step)))
        .filter(|(pose, _)| map.is_free(pose.x, pose.y))
        .collect();
    let count = usable.len();
    let stride = count.div_ceil(training.poses as usize).max(1);
    let (poses, scans): (Vec<Pose2>, Vec<_>) = usable
        .into_iter()
        .step_by(stride)
        .map(|(pose, step)| (pose, vec![kept.iter().map(|&beam| step.scan.ranges[beam]).collect()]))
        .unzip();
    let run = (poses.len() as u32 / 8).clamp(1, RUN);
    (ScanData { laser, poses, scans, run }, count)
}

#[cfg(test)]
mod tests {
    use locsim_core::{Laser, Scan};

    use super::*;

    /// Scans in a hole of the reference are left out and counted. Where none has a reference, all stay.
    #[test]
    fn scans_without_a_reference_are_not_judged() {
        let laser = Laser::new(vec![0.0], vec![0.0], 0.0, 8.0, Pose2::IDENTITY).unwrap();
        let drive = |has_reference: &dyn Fn(u32) -> bool| {
            let step = |i: u32| DriveStep {
                stamp_secs: f64::from(i),
                odometry: Pose2::IDENTITY,
                reference: has_reference(i).then_some(Pose2::IDENTITY),
                scan: Scan { ranges: vec![1.0] },
            };
            Drive { laser: laser.clone(), steps: (0..10).map(step).collect() }
        };
        let (kept, told) = judged(&drive(&|i| !(4..6).contains(&i)), (2..8).collect());
        assert_eq!(kept, [2, 3, 6, 7]);
        assert!(told.unwrap().starts_with("2 of the 6 localized scans"));
        for all in [true, false] {
            assert_eq!(judged(&drive(&|_| all), vec![2, 3]), (vec![2, 3], None));
        }
    }
}
