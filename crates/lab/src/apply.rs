//! `locsim apply`: the effects of a scenario applied to a recording.

use std::path::Path;
use std::sync::Arc;

use locsim_core::{Drive, DriveStep, Laser, Pose2, Track};
use locsim_dataset::{
    BagCopy, BagOptions, DatasetError, DriveEdit, LogFormat, LogOptions, LogSummary, OdometryEdit, read_log,
    write_log,
};
use locsim_scenario::{Problem, Scenario, ScenarioError, SimulatorOptions, Source, load_map};
use locsim_world::effect::{Effect, EffectKind, Moves, Site};
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::{MountFilter, OdometryFilter, ScanFilter};

use crate::LabError;
use crate::run::{log_map, no_reference, options_beside, read_scenario_log, refused};

/// Delays of beams that differ by less than this from evenly spaced ones are evenly spaced \[s\]: a nanosecond is the resolution
/// of a stamp, and beam times are f32.
const EVEN_SECS: f64 = 1e-6;

/// What was done to a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Applied {
    /// Scans that were written.
    pub scans: usize,
    /// Scans that were left out: they have no odometry.
    pub left_out: usize,
    /// Scans without a reference pose in the map's free space: effects that need the map don't act on them.
    pub unplaced: usize,
    /// Each effect, and the part of the recording that it changes.
    pub changes: Vec<(&'static str, &'static str)>,
}

impl std::fmt::Display for Applied {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} scans", self.scans)?;
        for (effect, part) in &self.changes {
            write!(f, "\n  {effect}: {part}")?;
        }
        if self.left_out > 0 {
            write!(f, "\n{} scans without odometry were left out", self.left_out)?;
        }
        if self.unplaced > 0 {
            write!(
                f,
                "\n{} scans have no reference pose in the map's free space; effects that need the map were not applied to them",
                self.unplaced
            )?;
        }
        Ok(())
    }
}

/// Applies the effects of a scenario, but those of the kinds `without`, to the recording `log`, and writes the result to `out`: an MCAP bag if its name ends so, a
/// CARMEN log otherwise. A bag that is written from a bag keeps all its other messages.
///
/// # Errors
/// [`LabError`]: the scenario has no effects; the log can't be read; it has no reference poses and an effect needs the map; the
/// result can't be written.
pub fn apply(
    scenario: &Scenario,
    log: &Path,
    without: &[EffectKind],
    options: &LogOptions,
    out: &Path,
) -> Result<Applied, LabError> {
    let simulator = scenario.simulator().map(|mut simulator| {
        simulator.effects.retain(|effect| !without.contains(&effect.kind));
        simulator
    });
    let Some(simulator) = simulator.filter(|simulator| !simulator.effects.is_empty()) else {
        let message = "no effect is left to apply; allowed: one or more".to_owned();
        let problem = Problem { line: None, key: "effects".to_owned(), message };
        return Err(ScenarioError::Invalid { file: scenario.file.clone(), problems: vec![problem] }.into());
    };
    if !simulator.residuals.is_empty() {
        let message =
            "the key is not allowed here; only effects are applied to a recording, not curves".to_owned();
        let problem = Problem { line: None, key: "residuals".to_owned(), message };
        return Err(ScenarioError::Invalid { file: scenario.file.clone(), problems: vec![problem] }.into());
    }
    let options = &options_beside(scenario, log, options);
    let is_bag = LogFormat::to_write(out, Some(log))? == LogFormat::Bag
        && LogFormat::of_content(log)? == LogFormat::Bag;
    let moves_odometry =
        simulator.effects.iter().any(|effect| effect.kind.description().moves == Moves::Odometry);
    let interval_secs = simulator.laser.rate_hz.recip();
    let with_odometry = read(log, options, is_bag, interval_secs);
    let recording = match with_odometry {
        Err(_) if !moves_odometry && !options.without_odometry => {
            // A log without odometry; another error comes again.
            read(log, &LogOptions { without_odometry: true, ..options.clone() }, is_bag, interval_secs)?
        }
        recording => recording?,
    };
    let mut edit = Edit::new(scenario, &simulator, &recording, log)?;
    let scans = if let Some(copy) = &recording.copy {
        copy.write(out, &mut edit)?;
        recording.drive.steps.len()
    } else {
        let drive = edit.edited(&recording.drive, log)?;
        write_log(out, &drive)?;
        drive.steps.len()
    };
    let needs_map = ScanFilter::needing_map(&simulator.effects).next().is_some();
    Ok(Applied {
        scans,
        left_out: recording.summary.scans_dropped + recording.drive.steps.len() - scans,
        unplaced: if needs_map { edit.unplaced } else { 0 },
        changes: simulator.effects.iter().map(|effect| (effect.kind.name(), part(effect))).collect(),
    })
}

/// The part of a recording that an effect changes.
fn part(effect: &Effect) -> &'static str {
    let description = effect.kind.description();
    match (description.moves, description.site) {
        (Moves::Odometry, _) => "odometry",
        (Moves::Scans, Site::Clock) => "stamps of the scans",
        (Moves::Scans, _) => "mount of the laser",
        _ if description.needs.map => "readings, by the map",
        _ => "readings",
    }
}

/// A recording that is read.
struct Recording {
    /// The bag, where it is copied.
    copy: Option<BagCopy>,
    drive: Drive,
    summary: LogSummary,
}

/// Reads a log. One that isn't copied gets a clock that runs, with scans at most `interval_secs` \[s\] apart where its own stands still: what
/// an effect does is looked up by the time of the scan.
fn read(
    log: &Path,
    options: &LogOptions,
    is_bag: bool,
    interval_secs: f64,
) -> Result<Recording, DatasetError> {
    if !is_bag {
        let (mut drive, summary) = read_log(log, options)?;
        drive.spread_stamps(interval_secs);
        return Ok(Recording { copy: None, drive, summary });
    }
    let LogOptions { max_range_m, topics, without_odometry } = options.clone();
    let options = BagOptions { topics, without_odometry, max_range_m, ..BagOptions::default() };
    let (copy, drive, summary) = BagCopy::open(log, &options)?;
    Ok(Recording { copy: Some(copy), drive, summary })
}

/// The changes to a recording.
struct Edit {
    scans: ScanFilter,
    mount: MountFilter,
    odometry: Option<AffectedOdometry>,
    laser: Laser,
    /// Delay of the first beam, and growth of the delay from beam to beam \[s\].
    delay_secs: [f64; 2],
    /// Stamps of the drive's scans \[s\].
    stamps: Vec<f64>,
    /// Whether a scan was taken.
    taken: Vec<bool>,
    /// Whether the robot's pose is known at a scan, and in the map's free space.
    placed: Vec<bool>,
    /// The reference poses, and the time of the first after the first scan \[s\].
    reference: Option<(Track, f64)>,
    unplaced: usize,
}

impl Edit {
    fn new(
        scenario: &Scenario,
        simulator: &SimulatorOptions,
        recording: &Recording,
        log: &Path,
    ) -> Result<Self, LabError> {
        let Recording { drive, summary, .. } = recording;
        let SimulatorOptions { effects, laser, blocks, .. } = simulator;
        let of_log = |what: String| LabError::Log { path: log.to_owned(), what };
        let track = |poses: &mut dyn Iterator<Item = (f64, Pose2)>| {
            Track::new(poses).map_err(|error| of_log(error.to_string()))
        };
        let mut scans = ScanFilter::new(effects, drive.laser.clone(), *laser, scenario.seed)
            .map_err(refused(scenario))?;
        let stamps: Vec<f64> = drive.steps.iter().map(|step| step.stamp_secs).collect();
        let mut referenced =
            drive.steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?))).peekable();
        let first = referenced.peek().map(|(secs, _)| *secs);
        let reference = match first {
            Some(first) => Some((track(&mut referenced)?, first - stamps[0])),
            None => None,
        };
        let needing: Vec<&str> = ScanFilter::needing_map(effects).map(EffectKind::name).collect();
        let mut placed = vec![false; stamps.len()];
        if !needing.is_empty() {
            if reference.is_none() {
                return Err(of_log(format!(
                    "{} act by the map and the robot's pose, and {}",
                    needing.join(", "),
                    no_reference(&summary.topics, &summary.transforms)
                )));
            }
            let map = Arc::new(ExactRangeMap::new(map_of(scenario)?));
            for (placed, step) in placed.iter_mut().zip(&drive.steps) {
                *placed = step.reference.is_some_and(|pose| map.geometry().is_free(pose.x, pose.y));
            }
            scans = scans.with_map(map, *blocks).map_err(refused(scenario))?;
        }
        let mount = MountFilter::new(effects).map_err(refused(scenario))?;
        let delay_secs = even_delays(&mount, &drive.laser).ok_or_else(|| {
            of_log(
                "the beams' times wouldn't be evenly spaced, as bearings go on beyond 180 degrees; allowed: bearings \
                 from -180 to 180 degrees"
                    .to_owned(),
            )
        })?;
        let moves_odometry = effects.iter().any(|effect| effect.kind.description().moves == Moves::Odometry);
        let odometry = if moves_odometry {
            let recorded = track(&mut drive.steps.iter().map(|step| (step.stamp_secs, step.odometry)))?;
            let filter = OdometryFilter::new(effects, recorded, scenario.seed).map_err(refused(scenario))?;
            Some(AffectedOdometry { filter, first_secs: stamps[0] })
        } else {
            None
        };
        Ok(Self {
            scans,
            mount,
            odometry,
            laser: drive.laser.clone(),
            delay_secs,
            taken: vec![false; stamps.len()],
            unplaced: placed.iter().filter(|placed| !**placed).count(),
            placed,
            stamps,
            reference,
        })
    }

    /// The drive with the changes; scans whose new stamp lies outside the span of the odometry are left out.
    fn edited(&mut self, drive: &Drive, log: &Path) -> Result<Drive, LabError> {
        let of_log = |what: String| LabError::Log { path: log.to_owned(), what };
        let [delay, interval] = self.delay_secs;
        let times = drive.laser.beam_times_secs().iter().enumerate();
        let times = times.map(|(beam, time)| (f64::from(*time) - beam as f64 * interval) as f32).collect();
        let laser = Laser::new(
            drive.laser.bearings().to_vec(),
            times,
            drive.laser.min_range(),
            drive.laser.max_range(),
            self.mount.mount(&drive.laser.base_from_laser()),
        )
        .map_err(|error| of_log(error.to_string()))?;
        let odometry = Track::new(drive.steps.iter().map(|step| (step.stamp_secs, step.odometry)))
            .map_err(|error| of_log(error.to_string()))?;
        let first = self.stamps[0];
        let last = odometry.secs()[odometry.len() - 1];
        let mut steps = Vec::new();
        for step in &drive.steps {
            let mut scan = step.scan.clone();
            self.scan(step.stamp_secs, &mut scan.ranges);
            if delay == 0.0 {
                let odometry = match &self.odometry {
                    Some(affected) => affected.pose(step.stamp_secs, &step.odometry),
                    None => step.odometry,
                };
                steps.push(DriveStep { odometry, scan, ..step.clone() });
                continue;
            }
            let stamp_secs = step.stamp_secs - delay;
            let secs = stamp_secs - first;
            if !(0.0..=last).contains(&secs) {
                continue;
            }
            let recorded = odometry.pose_at(secs);
            let odometry = match &self.odometry {
                Some(affected) => affected.pose(stamp_secs, &recorded),
                None => recorded,
            };
            let reference = self.reference.as_ref().and_then(|(track, from)| {
                let within = (0.0..=track.secs()[track.len() - 1]).contains(&(secs - from));
                within.then(|| track.pose_at(secs - from))
            });
            steps.push(DriveStep { stamp_secs, odometry, reference, scan });
        }
        Ok(Drive { laser, steps })
    }
}

impl DriveEdit for Edit {
    fn scan(&mut self, secs: f64, readings: &mut [f32]) -> bool {
        // Of several scans of one stamp the next.
        let from = self.stamps.partition_point(|&stamp| stamp < secs);
        let same = self.stamps[from..].partition_point(|&stamp| stamp <= secs);
        let Some(step) = (from..from + same).find(|&step| !self.taken[step]) else { return false };
        self.taken[step] = true;
        let at = self.reference.as_ref().map(|(track, from)| move |secs: f64| track.pose_at(secs - from));
        let at = at.as_ref().filter(|_| self.placed[step]).map(|at| at as &dyn Fn(f64) -> Pose2);
        self.scans.apply(step as u32, secs - self.stamps[0], at, readings);
        true
    }

    fn delay_secs(&self) -> [f64; 2] {
        self.delay_secs
    }

    fn mount(&self) -> Option<[Pose2; 2]> {
        let was = self.laser.base_from_laser();
        let said = self.mount.mount(&was);
        (said != was).then_some([was, said])
    }

    fn odometry(&self) -> Option<&dyn OdometryEdit> {
        self.odometry.as_ref().map(|odometry| odometry as &dyn OdometryEdit)
    }
}

/// An odometry with effects, by the stamps of a recording.
struct AffectedOdometry {
    filter: OdometryFilter,
    /// Stamp of the first scan \[s\].
    first_secs: f64,
}

impl OdometryEdit for AffectedOdometry {
    fn pose(&self, secs: f64, pose: &Pose2) -> Pose2 {
        self.filter.pose(secs - self.first_secs, pose)
    }

    fn velocity(&self, secs: f64, velocity: &Pose2) -> Pose2 {
        self.filter.velocity(secs - self.first_secs, velocity)
    }

    fn correction(&self, secs: f64, map_from_odom: &Pose2) -> Pose2 {
        self.filter.correction(secs - self.first_secs, map_from_odom)
    }
}

/// Delay of the first beam and its growth from beam to beam \[s\]; `None` where the delays aren't evenly spaced.
fn even_delays(mount: &MountFilter, laser: &Laser) -> Option<[f64; 2]> {
    let delays: Vec<f64> =
        laser.bearings().iter().map(|&bearing| mount.delay_secs(f64::from(bearing))).collect();
    let first = delays[0];
    let gaps = (delays.len() - 1).max(1) as f64;
    let step = (delays[delays.len() - 1] - first) / gaps;
    let even = |(beam, delay): (usize, &f64)| (delay - first - beam as f64 * step).abs() < EVEN_SECS;
    delays.iter().enumerate().all(even).then_some([first, step])
}

/// The map of a scenario.
fn map_of(scenario: &Scenario) -> Result<locsim_world::map::Geometry, LabError> {
    match &scenario.source {
        Source::Simulation(simulation) => Ok(load_map(&simulation.map)?.geometry),
        Source::Log(log) => {
            let (drive, _) = read_scenario_log(scenario, log)?;
            log_map(log, &drive, &())
        }
    }
}
