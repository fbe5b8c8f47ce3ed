//! The grounds on which filter parameters are searched and judged: a map, drives to search on, drives that the search doesn't see.

use std::path::Path;

use locsim_core::{Draw, Drive, Progress, Stage};
use locsim_scenario::{self as scenario, Log, Scenario, Simulation, Source};

use super::laboratory::{MapSet, drive_of, followed, refused, world};
use super::measured_log::{MeasuredLog, log_map, selected, unusable};
use super::rehearsal::keep_referenced;
use crate::LabError;

/// Simulated drives that serve a search, and the number of the first: far from any trial's.
const TRAINING_DRIVES: u32 = 6;
const FIRST_DRIVE: u32 = u32::MAX - 1000;

/// A map and drives with reference poses, with all beams of the laser.
pub struct Grounds {
    /// The map.
    pub maps: MapSet,
    /// Drives to search on.
    pub training: Vec<Drive>,
    /// Drives of the trials: trial i takes drive i modulo their number. A log has one.
    pub trials: Vec<Drive>,
    /// Drives that tell how noisy the odometry is: their reference poses are those of no trial.
    pub odometry: Vec<Drive>,
}

impl Grounds {
    /// Reads or simulates them; `trials` is the number of trials.
    ///
    /// # Errors
    /// What is wrong with map, log or world; [`LabError::Log`] for a log without training scans, or without reference poses.
    pub fn prepare(
        scenario: &Scenario,
        trials: u32,
        cache: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self, LabError> {
        match &scenario.source {
            Source::Simulation(simulation) => Self::simulated(scenario, simulation, trials, cache, progress),
            Source::Log(log) => Self::measured(scenario, log, cache, progress),
        }
    }

    fn simulated(
        scenario: &Scenario,
        simulation: &Simulation,
        trials: u32,
        cache: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self, LabError> {
        let geometry = scenario::load_map(&simulation.map)?.geometry;
        let maps = MapSet::new(geometry, scenario.ray_cast, None, cache, progress)
            .map_err(unusable(&simulation.map))?;
        let world = world(simulation, &maps).map_err(refused(scenario))?;
        progress.stage("simulating drives", u64::from(trials + TRAINING_DRIVES));
        let drive = |number: u32| {
            let seed = Draw::new(scenario.seed, Stage::Trial, 0).seed(number);
            let drive = drive_of(&world, seed, scenario)?.drive;
            progress.advance(1);
            Ok(drive)
        };
        let training: Vec<Drive> =
            (FIRST_DRIVE..FIRST_DRIVE + TRAINING_DRIVES).map(drive).collect::<Result<_, LabError>>()?;
        let trials = (0..trials).map(drive).collect::<Result<_, LabError>>()?;
        Ok(Self { maps, odometry: training.clone(), training, trials })
    }

    fn measured(
        scenario: &Scenario,
        log: &Log,
        cache: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self, LabError> {
        let refuse = |what: &str| Err(LabError::Log { path: log.file.clone(), what: what.to_owned() });
        progress.stage("reading the log", 1);
        let MeasuredLog { drive, .. } = MeasuredLog::read(scenario, log)?;
        progress.advance(1);
        let localized = selected(&drive, &log.localize_scans);
        let part = |steps: &[usize]| Drive {
            laser: drive.laser.clone(),
            steps: steps.iter().map(|&i| drive.steps[i].clone()).collect(),
        };
        let mut training: Vec<Drive> =
            log.train_scans.iter().map(|share| part(&selected(&drive, &[*share]))).collect();
        training.iter_mut().for_each(keep_referenced);
        training.retain(|stretch| stretch.steps.len() > 1);
        if training.is_empty() {
            return refuse(
                "log.train_scans: parameters are searched on scans with reference poses, and none is left",
            );
        }
        if localized.iter().any(|&i| drive.steps[i].reference.is_none()) {
            return refuse("log.localize_scans: errors need reference poses, and a scan has none");
        }
        let map = log_map(log, &drive, progress)?;
        let followed = followed(&scenario.filter, log, &drive);
        let maps = MapSet::new(map, scenario.ray_cast, followed.as_deref(), cache, progress)
            .map_err(unusable(&log.file))?;
        let trials = vec![part(&localized)];
        let mut odometry = drive;
        for i in localized {
            odometry.steps[i].reference = None;
        }
        Ok(Self { maps, training, trials, odometry: vec![odometry] })
    }
}
