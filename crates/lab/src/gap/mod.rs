//! `locsim gap`: holds a measured log against a simulated scenario with [`locsim_gap`], and writes what was found: the
//! scenario with the effect that it lacks, and a report that says why.

mod answer;
mod baseline;
mod covariate;
mod curve;
mod figures;
mod filter;
mod laser;
mod map_error;
mod next;
mod open;
mod page;
mod profile;
mod proposal;
mod unnamed;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use locsim_core::limits::quoted;
use locsim_core::{Drive, DriveStep, Hits, Particles, Pose2, RangeMap};
use locsim_dataset::{DriveQuality, LogKind, LogOptions, LogSummary, MountSource, read_log};
use locsim_gap::{GapError, GapOptions, Nominal, Purpose, Recorded, ResidualStage};
use locsim_world::effect::{EffectKind, Moves};
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::{BlockOptions, LaserSimulator, Simulator};

pub use answer::answer;
pub use baseline::{answer_since, find as find_since, json as json_since, run as run_since};
pub use locsim_gap::{BeamPit, Outcome};

pub use filter::FilterOnLog;
pub use proposal::{scenario_after, scenario_since};

use laser::{are_apart, logged_mount, mount_in_words, with_beams, with_mount};
use open::{Clutter, Way};

use crate::LabError;
use crate::inspect::{doubts, frozen_odometry};
use crate::run::{log_map, no_reference, options_beside, read_scenario_log, selected, spread_stamps};
use locsim_core::Control;
use locsim_report::ReportError;
use locsim_report::store::{Folder, Request};
use locsim_scenario::{
    LogMap, Overrides, Problem, Scenario, ScenarioError, SimulatorOptions, Source, load_map,
};
use locsim_world::map::Geometry;

/// The part of the log that the search uses, and how.
#[derive(Clone, Debug)]
pub struct GapSettings {
    /// Simulated logs, or beside a baseline permutations, behind a p-value.
    pub replicates: u32,
    /// Seed; `None` for the scenario's.
    pub seed: Option<u64>,
    /// The most scans that are looked at.
    pub scans: usize,
    /// The most beams of a scan that are looked at.
    pub beams: usize,
    /// Effects that aren't thought of.
    pub without: Vec<EffectKind>,
    /// How to read the logs.
    pub log: LogOptions,
    /// An earlier log of the same robot: what has changed since is searched, instead of what the simulation lacks.
    pub baseline: Option<PathBuf>,
}

impl GapSettings {
    /// Simulated logs behind a p-value, unless the user says otherwise.
    pub const REPLICATES: u32 = 999;
    /// Permutations beside a baseline, unless the user says otherwise.
    pub const PERMUTATIONS: u32 = 399;
    /// The most scans that are looked at, unless the user says otherwise.
    pub const SCANS: usize = 600;
    /// The most beams of a scan that are looked at, unless the user says otherwise.
    pub const BEAMS: usize = 72;
    /// The least and the greatest number of replicates: a p-value of .05, and one of a hundred thousandth.
    pub const ALLOWED_REPLICATES: [u64; 2] = [19, 100_000];
    /// The least and the greatest number of scans that a search looks at.
    pub const ALLOWED_SCANS: [u64; 2] = [locsim_gap::LEAST_SCANS as u64, u32::MAX as u64];
    /// The least and the greatest number of beams that a search looks at.
    pub const ALLOWED_BEAMS: [u64; 2] = [1, u32::MAX as u64];

    /// The settings of a search, unless the user says otherwise, with how its log is read.
    pub fn of_log(log: LogOptions) -> Self {
        Self {
            replicates: Self::REPLICATES,
            seed: None,
            scans: Self::SCANS,
            beams: Self::BEAMS,
            without: Vec::new(),
            log,
            baseline: None,
        }
    }

    /// Whether the numbers make sense.
    ///
    /// # Errors
    /// `name: value is not allowed; what is`.
    pub fn check(&self) -> Result<(), String> {
        let [replicates, scans, beams] = [Self::ALLOWED_REPLICATES, Self::ALLOWED_SCANS, Self::ALLOWED_BEAMS];
        let numbers = [
            ("replicates", u64::from(self.replicates), replicates),
            ("scans", self.scans as u64, scans),
            ("beams", self.beams as u64, beams),
        ];
        match numbers.into_iter().find(|(_, value, [least, most])| !(least..=most).contains(&value)) {
            Some((name, value, [least, most])) => {
                Err(format!("{name}: {value} is not allowed; a whole number from {least} to {most}"))
            }
            None => Ok(()),
        }
    }
}

/// A measured log and the scenario that it is held against, read and checked.
pub struct GapStudy {
    /// The scenario.
    scenario: Scenario,
    simulator: SimulatorOptions,
    /// The laser's mount by the log, where the scenario has none; it is the simulator's.
    logged_mount: Option<Pose2>,
    /// Blocks that the log has and the scenario hasn't; they are among the simulator's.
    added_blocks: Option<BlockOptions>,
    /// People and things that the log has farther from walls than the scenario's blocks reach.
    in_the_open: Option<BlockOptions>,
    log: PathBuf,
    map: Arc<ExactRangeMap>,
    /// The log with the scenario's laser mount.
    drive: Drive,
    recorded: Recorded,
    /// By how much its odometry lags behind its reference.
    odometry_lag_secs: f64,
    /// The log that it is held against, if there is one.
    baseline: Option<Baseline>,
    settings: GapSettings,
    /// How the logs were read.
    notes: Vec<String>,
    /// What is odd about them.
    warnings: Vec<String>,
    /// The log's reference is what a localizer found.
    is_localized: bool,
}

/// An earlier log of the same robot.
struct Baseline {
    log: PathBuf,
    recorded: Recorded,
    odometry_lag_secs: f64,
}

/// How to do it.
pub struct GapStudyOptions<'a> {
    /// The results folder.
    pub out: PathBuf,
    /// Whether earlier results there may be replaced.
    pub force: bool,
    /// The command that repeats it, for the report.
    pub command: String,
    /// Whether to run the filter with the old and the new simulator.
    pub filter: bool,
    /// The caller's clock, progress and interruption.
    pub control: Control<'a>,
    /// Where range tables are kept between runs, if anywhere.
    pub cache: Option<&'a Path>,
    /// Who records the drive, if anyone.
    pub recorder: Option<&'a GapRecorder<'a>>,
}

/// The recording's name in the results folder.
pub const RECORDING: &str = "gap.rrd";

/// Writes a recording to this path.
pub type GapRecorder<'a> =
    dyn Fn(&GapStudy, &Outcome, &Path) -> Result<(), Box<dyn std::error::Error + Send + Sync>> + Sync + 'a;

impl GapStudy {
    /// Reads and checks the scenario and the log; `None` is the log that the scenario names.
    ///
    /// Where the scenario's map is built from scans of the log, its other scans are held against it: those to localize on.
    ///
    /// # Errors
    /// [`LabError`]: what is wrong with the scenario, its map or the log, or that they are of different lasers.
    pub fn load(scenario: &Path, log: Option<&Path>, settings: GapSettings) -> Result<Self, LabError> {
        let overrides = Overrides { seed: settings.seed, ..Overrides::default() };
        Self::new(Scenario::load(scenario, &overrides)?, log, settings)
    }

    /// [`GapStudy::load`] of a scenario that was read before, whose seed counts.
    ///
    /// # Errors
    /// As [`GapStudy::load`].
    pub fn new(scenario: Scenario, log: Option<&Path>, settings: GapSettings) -> Result<Self, LabError> {
        let file = scenario.file.clone();
        let refuse = |key: &str, message: &str| {
            let problem = Problem { line: None, key: key.to_owned(), message: message.to_owned() };
            ScenarioError::Invalid { file: file.clone(), problems: vec![problem] }
        };
        let Some(mut simulator) = scenario.simulator() else {
            let message =
                "the key is missing; beside a log, it describes the simulation that could lack something";
            return Err(refuse("laser", message).into());
        };
        // Now, as an error after the search would come late.
        if !scenario.can_grow() {
            let message =
                "an effect could not be added; write `effects` as a list with an entry on each line";
            return Err(refuse("effects", message).into());
        }
        let Held { log, map, drive, summary } = Held::of(&scenario, log, &settings, &refuse)?;
        let map = Arc::new(ExactRangeMap::new(map));
        let mut notes = vec![summary.to_string().replace('\n', "; ")];
        let mut warnings = Vec::new();
        if settings.baseline.is_none() && simulator.laser.sigma_m <= 0.0 {
            return Err(refuse("laser.noise.sigma_m", &without_noise(&drive, &summary)).into());
        }
        let laser = LaserSimulator::new(simulator.laser).map_err(GapError::from)?;
        let mount = logged_mount(&drive.laser, laser.laser());
        let is_news = !scenario.has_key("laser.mount")
            && summary.mount != MountSource::Unknown
            && are_apart(&mount, &simulator.laser.mount);
        let logged_mount = is_news.then_some(mount);
        if let Some(mount) = logged_mount {
            simulator.laser.mount = mount;
            warnings.push(format!(
                "The scenario has no `laser.mount`; the log's is used: {}.",
                mount_in_words(mount)
            ));
        }
        let effects = simulator.effects().map_err(GapError::from)?;
        let simulated = Simulator::new(Arc::clone(&map), simulator.blocks, simulator.laser, effects)
            .map_err(GapError::from)?;
        let baseline = settings.baseline.clone().map(|path| -> Result<Baseline, LabError> {
            if same_file(&path, &log) {
                warnings.push("The baseline is the log itself: nothing can have changed.".to_owned());
            }
            let (drive, summary) = read_log(&path, &options_beside(&scenario, &path, &settings.log))?;
            notes.push(format!("Baseline: {}", summary.to_string().replace('\n', "; ")));
            let laser = simulated.laser();
            let (_, recorded, odometry_lag_secs) =
                usable(&path, drive, &summary, laser, &map, &settings, &mut warnings)?;
            Ok(Baseline { log: path, recorded, odometry_lag_secs })
        });
        let baseline = baseline.transpose()?;
        let laser = simulated.laser();
        let (drive, recorded, odometry_lag_secs) =
            usable(&log, drive, &summary, laser, &map, &settings, &mut warnings)?;
        let (mut added_blocks, mut in_the_open) = (None, None);
        // Beside a baseline, clutter is as the baseline has it.
        if baseline.is_none() {
            let steps = open::looked_at(drive.steps.iter().filter(|step| is_free(&map, step)));
            let seed = Purpose::InTheOpen.draw(scenario.seed).seed(0);
            let effects = simulator.effects().map_err(GapError::from)?;
            let empty =
                Simulator::new(Arc::clone(&map), None, simulator.laser, effects).map_err(GapError::from)?;
            let track = drive.reference().ok();
            let first = drive.steps.iter().find(|step| step.reference.is_some());
            let way = track.as_ref().zip(first);
            let way = way.map(|(track, first)| Way { first_secs: first.stamp_secs, track });
            let clutter =
                Clutter::of(&steps, way.as_ref(), &drive.laser, &empty, simulator.blocks.as_ref(), seed);
            let clutter = clutter.map_err(GapError::from)?;
            warnings.extend(clutter.warning);
            (added_blocks, in_the_open) = (clutter.blocks, clutter.things);
            simulator.blocks = simulator.blocks.or(added_blocks);
        }
        let is_localized = summary.kind == LogKind::Localized;
        Ok(Self {
            scenario,
            simulator,
            logged_mount,
            added_blocks,
            in_the_open,
            log,
            map,
            drive,
            recorded,
            odometry_lag_secs,
            baseline,
            settings,
            notes,
            warnings,
            is_localized,
        })
    }

    /// How the logs were read, and what is odd about them.
    pub fn remarks(&self) -> impl Iterator<Item = String> {
        self.notes.iter().chain(&self.warnings).cloned()
    }

    /// The scenario's name.
    pub fn name(&self) -> &str {
        &self.scenario.name
    }

    /// The part of the log that is looked at.
    pub fn recorded(&self) -> &Recorded {
        &self.recorded
    }

    /// Where each beam would end in the world as it is mapped \[m\], \[scan\]\[beam\]; `None` where that is too far.
    pub fn expected_ends(&self) -> Vec<Option<[f64; 2]>> {
        let Recorded { laser, track, .. } = &self.recorded;
        let poses: Particles =
            track.poses().iter().map(|pose| pose.compose(&laser.base_from_laser())).collect();
        let mut hits = Hits::default();
        self.map.cast(poses.as_poses(), laser.bearings(), laser.max_range(), &mut hits);
        let beams = laser.beam_count();
        let end = |(i, &range): (usize, &f32)| {
            let pose = poses.get(i / beams);
            let direction = pose.theta + f64::from(laser.bearings()[i % beams]);
            let range = (range < laser.max_range()).then_some(f64::from(range))?;
            Some([pose.x + range * direction.cos(), pose.y + range * direction.sin()])
        };
        hits.range.iter().enumerate().map(end).collect()
    }

    /// Wall segments of the map \[m\].
    pub fn walls(&self) -> Vec<[[f64; 2]; 2]> {
        self.map.geometry().segments().iter().map(|wall| wall.map(|end| end.to_array())).collect()
    }

    /// The seed that everything random derives from.
    pub fn seed(&self) -> u64 {
        self.scenario.seed
    }

    /// How the log is searched.
    pub fn settings(&self) -> &GapSettings {
        &self.settings
    }

    /// Scans that can be compared: those with a reference pose in the map's free space.
    fn usable_steps(&self) -> impl Iterator<Item = &DriveStep> {
        self.drive.steps.iter().filter(|step| is_free(&self.map, step))
    }

    /// The scenario as it simulates now.
    fn nominal(&self) -> Result<Nominal, GapError> {
        let SimulatorOptions { blocks, laser, odometry_noise, .. } = self.simulator;
        let effects = self.simulator.effects()?;
        let nominal = Nominal::new(Arc::clone(&self.map), laser, blocks, odometry_noise, effects)?;
        match self.in_the_open {
            Some(open) => Ok(nominal.with_things_in_the_open(open)?),
            None => Ok(nominal),
        }
    }
}

/// What is said of a laser without noise.
fn without_noise(drive: &Drive, summary: &LogSummary) -> String {
    let sigma = DriveQuality::of(drive, summary).readings.noise_m();
    let of_log =
        sigma.map_or_else(String::new, |sigma| format!("; the log's readings have about {sigma:.3} m"));
    format!("more than 0 is allowed: without noise no reading of a real laser has a density{of_log}")
}

/// Whether a scan's reference pose is known, and in the map's free space.
fn is_free(map: &ExactRangeMap, step: &DriveStep) -> bool {
    step.reference.is_some_and(|pose| map.geometry().is_free(pose.x, pose.y))
}

/// A log with the map that it is held against.
struct Held {
    log: PathBuf,
    map: Geometry,
    drive: Drive,
    summary: LogSummary,
}

impl Held {
    /// Reads the log that is given, or else the scenario's.
    fn of(
        scenario: &Scenario,
        log: Option<&Path>,
        settings: &GapSettings,
        refuse: &dyn Fn(&str, &str) -> ScenarioError,
    ) -> Result<Self, LabError> {
        let of_scenario = match &scenario.source {
            Source::Simulation(simulation) => {
                let Some(log) = log else {
                    return Err(refuse(
                        "log",
                        "the key is missing; without it, --log names the measured log",
                    )
                    .into());
                };
                let map = load_map(&simulation.map)?.geometry;
                let (drive, summary) = read_log(log, &settings.log)?;
                return Ok(Self { log: log.to_owned(), map, drive, summary });
            }
            Source::Log(log) => log,
        };
        if let Some(log) = log {
            let (drive, summary) = read_log(log, &options_beside(scenario, log, &settings.log))?;
            let map = match &of_scenario.map {
                LogMap::File(_) => log_map(of_scenario, &drive, &())?,
                LogMap::FromScans { .. } | LogMap::Walls { .. } => {
                    log_map(of_scenario, &read_scenario_log(scenario, of_scenario)?.0, &())?
                }
            };
            return Ok(Self { log: log.to_owned(), map, drive, summary });
        }
        let (drive, summary) = read_scenario_log(scenario, of_scenario)?;
        let map = log_map(of_scenario, &drive, &())?;
        let steps = match &of_scenario.map {
            LogMap::File(_) => drive.steps,
            LogMap::FromScans { .. } | LogMap::Walls { .. } => {
                let held = selected(&drive, &of_scenario.localize_scans);
                held.into_iter().map(|i| drive.steps[i].clone()).collect()
            }
        };
        let drive = Drive { steps, laser: drive.laser };
        Ok(Self { log: of_scenario.file.clone(), map, drive, summary })
    }
}

/// The part of a log that is looked at, with the scenario's laser, and by how much the odometry lags behind the reference \[s\].
///
/// Beside a baseline the scans are spread evenly over the log, so that both see the same places.
fn usable(
    log: &Path,
    drive: Drive,
    summary: &LogSummary,
    laser: &LaserSimulator,
    map: &ExactRangeMap,
    settings: &GapSettings,
    warnings: &mut Vec<String>,
) -> Result<(Drive, Recorded, f64), LabError> {
    let refuse = |what: String| LabError::Log { path: log.to_owned(), what };
    let drive = with_mount(drive, laser.laser(), warnings);
    let mut drive = with_beams(drive, laser.laser()).map_err(refuse)?;
    warnings.extend(spread_stamps(&mut drive, laser.options().rate_hz.recip()));
    warnings.extend(summary.remarks.iter().cloned());
    let quality = DriveQuality::of(&drive, summary);
    let lag_secs = quality.odometry.as_ref().map_or(0.0, |odometry| odometry.lag_secs);
    warnings.extend(doubts(&quality));
    warnings.extend(without_stale_scans(&mut drive));
    let frozen = drive.frozen_odometry();
    warnings.extend((frozen[0] > 0.0).then(|| frozen_odometry(frozen)));
    let free = |pose: &Pose2| map.geometry().is_free(pose.x, pose.y);
    let references = drive.steps.iter().filter(|step| step.reference.is_some()).count();
    let is_usable = |step: &&DriveStep| is_free(map, step);
    let part = if settings.baseline.is_some() {
        let each = drive.steps.iter().filter(is_usable).count().div_ceil(settings.scans).max(1);
        let steps = drive.steps.iter().filter(is_usable).step_by(each).cloned().collect();
        &Drive { laser: drive.laser.clone(), steps }
    } else {
        &drive
    };
    let recorded = Recorded::new(part, settings.scans, settings.beams, free).map_err(|error| {
        refuse(match references {
            0 => format!(
                "{}; without one nothing can be compared",
                no_reference(&summary.topics, &summary.transforms)
            ),
            _ => error.to_string(),
        })
    })?;
    // Where scans are left out, and where the log knows more of a sweep.
    let recorded = if settings.baseline.is_some() || !summary.between.is_empty() {
        let scans = drive.steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?)));
        let mut poses: Vec<(f64, Pose2)> = scans.chain(summary.between.iter().copied()).collect();
        poses.sort_by(|a, b| a.0.total_cmp(&b.0));
        recorded.along(poses)
    } else {
        recorded
    };
    if settings.baseline.is_none() {
        warnings.extend(cut(&drive, &recorded, map));
    }
    let outside = drive.steps.iter().filter(|s| s.reference.is_some_and(|pose| !free(&pose))).count();
    if outside > 0 {
        let many = if 10 * outside > references { " Is the reference in the map's frame?" } else { "" };
        warnings.push(format!(
            "{outside} scans of {} were left out: their reference pose is not in the map's free space.{many}",
            quoted(&log.file_name().unwrap_or_default().to_string_lossy())
        ));
    }
    Ok((drive, recorded, lag_secs))
}

/// A note on a log that goes on beyond the scans that are looked at.
fn cut(drive: &Drive, recorded: &Recorded, map: &ExactRangeMap) -> Option<String> {
    let stamps: Vec<f64> =
        drive.steps.iter().filter(|step| is_free(map, step)).map(|step| step.stamp_secs).collect();
    let (looked_at, all) = (recorded.scans(), stamps.len());
    let secs = |last: usize| stamps[last] - stamps[0];
    (looked_at < all).then(|| {
        format!(
            "The first {looked_at} of {all} scans are looked at: {:.0} of {:.0} s. `--scans` says how many.",
            secs(looked_at - 1),
            secs(all - 1)
        )
    })
}

/// Leaves out scans that were sent again; a note on them.
fn without_stale_scans(drive: &mut Drive) -> Option<String> {
    let stale = drive.stale_scans();
    let mut scans = 0..;
    drive.steps.retain(|_| scans.next().is_none_or(|scan| stale.binary_search(&scan).is_err()));
    (!stale.is_empty()).then(|| {
        format!(
            "{} scans have all readings of the scan before, though the robot has moved: the driver has sent them again. They were left out.",
            stale.len()
        )
    })
}

/// Whether two paths are of one file.
fn same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Holds the log against the scenario and writes the results folder, which is made beside its place and renamed when
/// complete.
///
/// # Errors
/// [`LabError`]; earlier results at `options.out` are then untouched.
pub fn run(study: &GapStudy, options: &GapStudyOptions<'_>) -> Result<Outcome, LabError> {
    let GapStudyOptions { out, force, .. } = options;
    let fingerprint = study.scenario.content_hash()?;
    // A search has no parts that could be kept.
    let request = Request { out, kind: "gap", fingerprint: &fingerprint, resume: false, force: *force };
    let (outcome, recorded) = request.fill(|store| {
        let outcome = find(study, options.filter, options.cache, options.control)?;
        options.control.progress.stage("writing the report", 1);
        write(store.folder(), study, &outcome, options)?;
        let recorded = match options.recorder {
            Some(recorder) => recorder(study, &outcome, &store.folder().claim(RECORDING)?),
            None => Ok(()),
        };
        Ok::<_, LabError>((outcome, recorded))
    })?;
    options.control.progress.finish();
    recorded.map_err(|source| LabError::Recording { out: options.out.clone(), source })?;
    Ok(outcome)
}

/// Holds the log against the scenario, as [`run`] does, and writes nothing. With `filter`, a filter is run with the old and the
/// new simulator; `cache` keeps its range tables.
///
/// # Errors
/// [`LabError`].
pub fn find(
    study: &GapStudy,
    filter: bool,
    cache: Option<&Path>,
    control: Control<'_>,
) -> Result<Outcome, LabError> {
    let Control { clock, progress, interrupted } = control;
    let began = clock();
    study.warnings.iter().for_each(|warning| progress.warn(warning));
    progress.stage("integrating over blocks", 1);
    let nominal = study.nominal()?;
    progress.advance(1);
    let replicates = study.settings.replicates;
    let usual = GapOptions::default();
    let mut without = study.settings.without.clone();
    if study.added_blocks.is_some() {
        // The scenario says nothing of them that could be wrong.
        without.extend(EffectKind::ALL.into_iter().filter(|kind| kind.moves() == Moves::Clutter));
    }
    let search = GapOptions {
        replicates,
        false_alarm: false_alarm(replicates),
        without,
        seed: study.scenario.seed,
        ..usual
    };
    let mut outcome = locsim_gap::find(&nominal, &study.recorded, &search, progress, interrupted)?;
    if filter {
        outcome.filter = filter::filter_gap(study, &outcome, cache, control)?;
    }
    if search.false_alarm > GapOptions::default().false_alarm {
        outcome.notes.push(format!(
            "{replicates} simulated logs tell no chance below {:.0} %: the chance of a false alarm is that, instead of 1 %. \
             999 replicates are the default.",
            100.0 * search.false_alarm
        ));
    }
    outcome.notes.splice(0..0, study.remarks());
    outcome.seconds = control.seconds_since(began);
    Ok(outcome)
}

/// The chance of a false alarm: the usual one, or the least p-value that this number of simulations can give.
fn false_alarm(replicates: u32) -> f64 {
    GapOptions::default().false_alarm.max(1.0 / (f64::from(replicates) + 1.0))
}

/// Writes everything into `folder`.
fn write(
    folder: &Folder,
    study: &GapStudy,
    outcome: &Outcome,
    options: &GapStudyOptions<'_>,
) -> Result<(), LabError> {
    let json = serde_json::to_string_pretty(outcome).map_err(ReportError::from)?;
    folder.write("gap.json", format!("{json}\n").as_bytes())?;
    let scenario = scenario_after(study, outcome, &options.out)?;
    folder.write("scenario.yaml", scenario.as_bytes())?;
    let old = study.scenario.file.display().to_string();
    let diff = proposal::diff(
        &study.scenario.text,
        &scenario,
        &old,
        &options.out.join("scenario.yaml").display().to_string(),
    );
    folder.write("scenario.diff", diff.as_bytes())?;
    // A name and paths of its own are no news.
    let has_curves = outcome.residual.as_ref().is_some_and(ResidualStage::is_nearer);
    let is_news = !outcome.effects.is_empty()
        || has_curves
        || outcome.map.as_ref().is_some_and(|map| !map.guesses.is_empty());
    let shown = if is_news { &diff } else { "" };
    Ok(page::write(folder, study, outcome, shown, &options.command)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_without_reference_lists_its_topics() {
        let topics = ["/scan (sensor_msgs/msg/LaserScan, 3 messages)".to_owned()];
        assert!(no_reference(&topics, &[]).ends_with("found: /scan (sensor_msgs/msg/LaserScan, 3 messages)"));
        assert!(no_reference(&[], &[]).contains("a CARMEN log has them in TRUEPOS lines"));
    }
}
