//! The common parts of all trials of a scenario: the map, the trained models, and the source of drives.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use locsim_core::limits::number;
use locsim_core::{
    DistanceMap, Draw, Drive, DriveStep, EndpointGrid, Obstructions, Particles, Pose2, RangeMap, Stage,
    Survival,
};
use locsim_dataset::{LogKind, OdometryError};
use locsim_report::results::Disagreement;
use locsim_sensor::SensorError;
use locsim_world::map::{Geometry, MapError};
use locsim_world::raycast::{DistanceGrid, ExactRangeMap, RangeTable, RangeTableOptions, Vicinity};
use locsim_world::simulation::{
    Block, ObstructionOptions, ObstructionTable, Robot, SimulationError, Simulator, simulate_drive,
};
use rand::RngExt;

use super::coverage::{against_odometry, outside_of_map, unlike_map, unmapped_start, untrained_states};
use super::disagreement::disagreements;
use super::estimate::Estimate;
use super::filter::{calibrated, fitted_alpha};
use super::measured_log::{
    MeasuredLog, enough_to_train_on, judged, log_map, measured_scans, selected, unusable,
};
use super::rehearsal::Rehearsal;
use super::training::{ScanData, Surroundings, TrainedModel, check_files, train};
use crate::LabError;
use locsim_core::Progress;
use locsim_scenario::{
    self as scenario, Log, ModelName, Motion, RayCast, Scenario, Simulation, SimulatorOptions, Source,
};

/// Training poses keep this far from walls \[m\]: a robot has a body.
const WALL_CLEARANCE_M: f64 = 0.25;

/// A filter that tracks is expected to be this near to the reference \[m\]: three times the distance at which it usually counts
/// as lost. A ray from elsewhere is cast exactly, which takes longer.
const VICINITY_M: f64 = 3.0;

/// Cell \[m\] and saturation \[m\] of the distance grid behind the likelihood field.
const DISTANCE_GRID_M: (f64, f64) = (0.05, 2.0);

/// Units of progress of a range table.
const TABLE_TICKS: u64 = 100;

/// Cell \[m\] of the likelihood field's table: a fraction of the laser's noise.
const ENDPOINT_CELL_M: f64 = 0.01;

/// Trial numbers from here on are not trials: their seeds serve training.
const TRAINING_SEED: u32 = u32::MAX;

/// A map in the forms that a run needs.
#[derive(Clone)]
pub struct MapSet {
    /// Exact ray casts.
    pub exact: Arc<ExactRangeMap>,
    /// Ray casts for the filter: the table, or the exact ones.
    pub ranges: Arc<dyn RangeMap>,
    /// Distances to the nearest surface.
    pub distance: Arc<dyn DistanceMap>,
}

impl MapSet {
    /// Prepares a map; a range table can take seconds, unless `cache` has it. With `drive`, the poses that a filter follows,
    /// the table holds only what is near to it.
    ///
    /// # Errors
    /// `MapError` for a table above the limits.
    pub fn new(
        geometry: Geometry,
        ray_cast: RayCast,
        drive: Option<&[[f64; 2]]>,
        cache: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self, MapError> {
        let distance = Arc::new(DistanceGrid::new(&geometry, DISTANCE_GRID_M.0, DISTANCE_GRID_M.1)?);
        let exact = Arc::new(ExactRangeMap::new(geometry));
        let ranges: Arc<dyn RangeMap> = match ray_cast {
            RayCast::Exact => Arc::<ExactRangeMap>::clone(&exact),
            RayCast::Table { cell_m, memory_mb } => {
                progress.stage("building the range table", TABLE_TICKS);
                let most_bytes = (memory_mb as usize) << 20;
                let options = RangeTableOptions { cell_m, most_bytes, ..RangeTableOptions::default() };
                let done = AtomicU64::new(0);
                let vicinity = drive.map(|points| Vicinity { points, distance_m: VICINITY_M });
                let table = RangeTable::near(&exact, &options, vicinity, cache, &|share| {
                    let now = (share * TABLE_TICKS as f64) as u64;
                    progress.advance(now.saturating_sub(done.fetch_max(now, Ordering::Relaxed)));
                })?;
                Arc::new(table)
            }
        };
        Ok(Self { exact, ranges, distance })
    }

    /// Cells for tables over where readings end.
    pub fn endpoints(&self) -> EndpointGrid {
        let [x0, y0, x1, y1] = self.exact.bounds();
        let margin = DISTANCE_GRID_M.1;
        EndpointGrid::covering([x0 - margin, y0 - margin, x1 + margin, y1 + margin], ENDPOINT_CELL_M)
    }

    /// Wall segments \[m\].
    pub fn walls(&self) -> Vec<[[f64; 2]; 2]> {
        self.exact.geometry().segments().iter().map(|wall| wall.map(|end| end.to_array())).collect()
    }
}

/// One drive to localize on, with what stood in its way.
pub struct TrialDrive {
    /// Scans with the beams that the filter uses.
    pub drive: Drive,
    /// Corners of the blocks at each step; empty for a measured log.
    pub blocks: Vec<Vec<[[f64; 2]; 4]>>,
}

/// Where drives come from.
enum Drives {
    Simulated(Box<World>),
    /// One measured drive serves every trial; trials differ in the filter's draws alone.
    Measured(Drive),
}

/// A simulated world and the robot in it.
pub(super) struct World {
    simulator: Simulator,
    robot: Robot,
}

/// Everything that the trials of a scenario share.
pub struct Laboratory<'a> {
    /// The scenario.
    pub scenario: &'a Scenario,
    /// The scenario's filter, with the motion noise that was fitted to a log.
    pub filter: scenario::Filter,
    /// The map.
    pub maps: MapSet,
    /// The sensor models in the scenario's order.
    pub models: Vec<TrainedModel>,
    /// Remarks to read before the results.
    pub warnings: Vec<String>,
    /// Remarks for the report: what kind of log, how much training data.
    pub notes: Vec<String>,
    drives: Drives,
}

impl<'a> Laboratory<'a> {
    /// Loads the map, gathers training data and fits every model.
    ///
    /// # Errors
    /// Whatever is wrong with map, log, world, training data or model files.
    pub fn prepare(
        scenario: &'a Scenario,
        cache: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self, LabError> {
        match &scenario.source {
            Source::Simulation(simulation) => Self::simulated(scenario, simulation, cache, progress),
            Source::Log(log) => Self::measured(scenario, log, cache, progress),
        }
    }

    fn simulated(
        scenario: &'a Scenario,
        simulation: &Simulation,
        cache: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self, LabError> {
        check_simulation(scenario, simulation)?;
        let maps = MapSet::new(
            scenario::load_map(&simulation.map)?.geometry,
            scenario.ray_cast,
            None,
            cache,
            progress,
        )
        .map_err(unusable(&simulation.map))?;
        let world = world(simulation, &maps).map_err(refused(scenario))?;
        let training = &scenario.training;
        let seed = Draw::new(scenario.seed, Stage::Trial, 0).seed(TRAINING_SEED);
        let poses = free_poses(&maps, training.poses, seed);
        progress.stage("simulating training scans", 1);
        let readings = world.simulator.observe_many(poses.as_poses(), training.observations, seed);
        progress.advance(1);
        let laser = world.simulator.laser().laser();
        let beams = training.beams.map_or(laser.beam_count(), |beams| beams as usize);
        let data = ScanData::simulated(laser, beams, &poses, training.observations, &readings);
        let needs_oracle = scenario.models.iter().any(|model| model.name == ModelName::Oracle);
        let oracle = if needs_oracle {
            progress.stage("integrating over blocks", 1);
            let obstructions = obstructions(&world.simulator).map_err(refused(scenario))?;
            progress.advance(1);
            Some((obstructions, [simulation.laser.sigma_m, simulation.laser.sigma_per_m]))
        } else {
            None
        };
        let surroundings = Surroundings {
            map: Arc::<ExactRangeMap>::clone(&maps.exact),
            distance: Arc::clone(&maps.distance),
            oracle,
            tables: (scenario.ray_cast != RayCast::Exact).then(|| maps.endpoints()),
            rehearsal: None,
        };
        let beams = scenario.filter.beams.map(|beams| beams as usize);
        let models =
            train(&scenario.models, &data, &surroundings, training.held_out_share, beams, seed, progress)
                .map_err(untrainable(scenario))?;
        let notes = vec![format!(
            "Every fitted model was trained on the same {} scan poses with {} observations of each of their {} beams; \
             {:.0} % of the poses were held out to choose bandwidths, floors and exponents.",
            data.poses.len(),
            training.observations,
            data.laser.beam_count(),
            100.0 * training.held_out_share,
        )];
        let warnings = Vec::new();
        let filter = scenario.filter.clone();
        let drives = Drives::Simulated(Box::new(world));
        Ok(Self { scenario, filter, maps, models, warnings, notes, drives })
    }

    fn measured(
        scenario: &'a Scenario,
        log: &Log,
        cache: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self, LabError> {
        progress.stage("reading the log", 1);
        let MeasuredLog { mut drive, summary, corrections, warning } = MeasuredLog::read(scenario, log)?;
        progress.advance(1);
        let map = log_map(log, &drive, progress)?;
        let followed = followed(&scenario.filter, log, &drive);
        let maps = MapSet::new(map, scenario.ray_cast, followed.as_deref(), cache, progress)
            .map_err(unusable(&log.file))?;
        let training = &scenario.training;
        let seed = Draw::new(scenario.seed, Stage::Trial, 0).seed(TRAINING_SEED);
        let train_steps = selected(&drive, &log.train_scans);
        let simulator = log.simulator.as_ref().filter(|_| log.train_scans.is_empty());
        let (data, usable) = match simulator {
            Some(simulator) => (simulated_scans(scenario, simulator, &maps, &drive, seed, progress)?, 0),
            None => measured_scans(&drive, &train_steps, &maps.exact, training),
        };
        enough_to_train_on(log, data.poses.len())?;
        let (localized, unjudged) = judged(&drive, selected(&drive, &log.localize_scans));
        let calibration = if scenario.filter.calibrate { calibrated(&mut drive, &localized) } else { None };
        let (filter, motion_note) = with_motion_noise(&scenario.filter, &drive, &localized);
        let stretches = log.train_scans.iter().map(|interval| {
            let steps = selected(&drive, &[*interval]).into_iter().map(|i| drive.steps[i].clone()).collect();
            with_filter_beams(Drive { laser: drive.laser.clone(), steps }, scenario)
        });
        let stretches = stretches.collect();
        let surroundings = Surroundings {
            map: Arc::<ExactRangeMap>::clone(&maps.exact),
            distance: Arc::clone(&maps.distance),
            oracle: None,
            tables: (scenario.ray_cast != RayCast::Exact).then(|| maps.endpoints()),
            rehearsal: Rehearsal::new(&filter, stretches, Arc::clone(&maps.ranges), seed),
        };
        let beams = scenario.filter.beams.map(|beams| beams as usize);
        let models =
            train(&scenario.models, &data, &surroundings, training.held_out_share, beams, seed, progress)
                .map_err(untrainable(scenario))?;
        let localized: Vec<DriveStep> = localized.into_iter().map(|i| drive.steps[i].clone()).collect();
        let mut notes = vec![
            summary.to_string().replace('\n', "; "),
            match simulator {
                None => format!(
                    "Every fitted model was trained on the same {} scans of {} beams, one observation of each state; \
                     {:.0} % of them were held out to choose bandwidths, floors and exponents. Reference poses are \
                     not the truth: errors below some centimetres say nothing.",
                    data.poses.len(),
                    data.laser.beam_count(),
                    100.0 * training.held_out_share,
                ),
                Some(_) => format!(
                    "Every fitted model was trained on {} simulated scan poses in the map, with {} observations of each of {} \
                     beams: it knows the simulator's laser and clutter, and nothing of the log.",
                    data.poses.len(),
                    training.observations,
                    data.laser.beam_count(),
                ),
            },
            "All trials share this one drive: intervals over them show how the filter's own draws vary, and nothing \
             else."
                .to_owned(),
        ];
        notes.extend(corrections);
        notes.extend(calibration.map(|found| {
            format!("The odometry is calibrated by the reference poses of all other scans (`filter.motion.calibrate`): {found}.")
        }));
        notes.extend(motion_note);
        let drive = with_filter_beams(Drive { steps: localized, ..drive }, scenario);
        let dropped = train_steps.len() - usable;
        let warnings = [
            (summary.kind == LogKind::Localized).then(|| LogKind::LOCALIZED.to_owned()),
            warning,
            (dropped > 0).then(|| {
                format!(
                    "{dropped} of {} training scans were dropped: they have no reference pose in the map's free space.",
                    train_steps.len()
                )
            }),
            (summary.intervals_without_odometry > 0).then(|| {
                format!(
                    "The log has no odometry in {} intervals. The motion of the reference stands in for it, so that these \
                     steps test nothing.",
                    summary.intervals_without_odometry
                )
            }),
            unjudged,
            against_odometry(&drive),
            unmapped_start(&*maps.exact, &*maps.distance, &drive),
            outside_of_map(&*maps.exact, &drive),
            unlike_map(&*maps.exact, &drive),
            untrained_states(&*maps.exact, (&data.laser, &data.poses), &drive),
        ];
        let warnings = summary.remarks.into_iter().chain(warnings.into_iter().flatten()).collect();
        Ok(Self { scenario, filter, maps, models, warnings, notes, drives: Drives::Measured(drive) })
    }

    /// Where reference poses of a log and its map disagree.
    pub(super) fn disagreements(&self) -> Vec<Disagreement> {
        match &self.drives {
            Drives::Measured(drive) => disagreements(&*self.maps.distance, drive),
            Drives::Simulated(_) => Vec::new(),
        }
    }

    /// The measured drive, if it has no reference pose to hold an estimate against.
    pub fn unreferenced(&self) -> Option<&Drive> {
        match &self.drives {
            Drives::Measured(drive) if drive.steps.iter().all(|step| step.reference.is_none()) => Some(drive),
            _ => None,
        }
    }

    /// Refuses a log without reference poses.
    ///
    /// # Errors
    /// [`LabError::Log`].
    pub fn with_reference(&self) -> Result<(), LabError> {
        if self.unreferenced().is_none() {
            return Ok(());
        }
        let what = "errors need reference poses, and no scan that is localized on has one".to_owned();
        Err(LabError::Log { path: self.scenario.file.clone(), what })
    }

    /// Beams of a scan that the filter uses.
    pub fn beams(&self) -> usize {
        match &self.drives {
            Drives::Measured(drive) => drive.laser.beam_count(),
            Drives::Simulated(world) => {
                let beams = world.simulator.laser().laser().beam_count();
                self.scenario.filter.beams.map_or(beams, |most| beams.min(most as usize))
            }
        }
    }

    /// Seed of a trial.
    pub fn trial_seed(&self, trial: u32) -> u64 {
        Draw::new(self.scenario.seed, Stage::Trial, 0).seed(trial)
    }

    /// The drive of a trial.
    ///
    /// # Errors
    /// [`LabError::Simulation`] for a path that makes no sense.
    pub fn drive(&self, trial: u32) -> Result<TrialDrive, LabError> {
        match &self.drives {
            Drives::Measured(drive) => Ok(TrialDrive { drive: drive.clone(), blocks: Vec::new() }),
            Drives::Simulated(world) => {
                let simulated = drive_of(world, self.trial_seed(trial), self.scenario)?;
                Ok(TrialDrive { drive: with_filter_beams(simulated.drive, self.scenario), ..simulated })
            }
        }
    }
}

/// Simulates the drive of one trial without training anything, with all beams of the laser.
///
/// # Errors
/// [`LabError::Log`] if the scenario is of a measured log; a drive that needs more memory than there
/// is; what is wrong with map, world or path.
pub fn simulate_trial(scenario: &Scenario, trial: u32) -> Result<Drive, LabError> {
    let Source::Simulation(simulation) = &scenario.source else {
        let what = "a scenario of a measured log has nothing to simulate".to_owned();
        return Err(LabError::Log { path: scenario.file.clone(), what });
    };
    Estimate::of_simulated_log(simulation).check(scenario)?;
    let maps = MapSet::new(scenario::load_map(&simulation.map)?.geometry, RayCast::Exact, None, None, &())
        .map_err(unusable(&simulation.map))?;
    let world = world(simulation, &maps).map_err(refused(scenario))?;
    let seed = Draw::new(scenario.seed, Stage::Trial, 0).seed(trial);
    Ok(drive_of(&world, seed, scenario)?.drive)
}

pub(super) fn drive_of(world: &World, seed: u64, scenario: &Scenario) -> Result<TrialDrive, LabError> {
    let simulated = simulate_drive(&world.simulator, &world.robot, seed).map_err(refused(scenario))?;
    let corners = |block: &Block| block.corners.map(|corner| corner.to_array());
    let blocks = simulated.blocks.iter().map(|blocks| blocks.iter().map(corners).collect()).collect();
    Ok(TrialDrive { drive: simulated.drive, blocks })
}

/// Attaches the scenario's file to what the simulator refuses, and the key where one is to blame.
pub fn refused(scenario: &Scenario) -> impl FnOnce(SimulationError) -> LabError {
    move |source| {
        let jitter = match &scenario.source {
            Source::Simulation(simulation) => simulation.robot.start_jitter_m,
            Source::Log(_) => 0.0,
        };
        match source {
            // The path itself was looked at when the scenario was loaded.
            SimulationError::OutsideFreeSpace { .. } if jitter > 0.0 => {
                let jitter = number(jitter);
                let what = format!(
                    "{jitter} is not allowed; with a start that is moved by up to so much, {source}; 0, or what the path has room for"
                );
                scenario.refusal("robot.start_jitter_m", what).into()
            }
            SimulationError::TooMany { what: "scans", .. } => {
                scenario.refusal("laser.rate_hz", format!("{source}; a lower rate, or a shorter path")).into()
            }
            source => LabError::Simulation { path: scenario.file.clone(), source },
        }
    }
}

/// Attaches the scenario's file and key to data that a model can't be fitted to.
fn untrainable(scenario: &Scenario) -> impl FnOnce(LabError) -> LabError {
    move |error| match error {
        LabError::Sensor { label, source: SensorError::TooFewData { what, .. } } => {
            scenario.refusal("models", format!("`{label}` can't be fitted: {what}")).into()
        }
        other => other,
    }
}

fn with_filter_beams(drive: Drive, scenario: &Scenario) -> Drive {
    match scenario.filter.beams {
        Some(beams) => drive.with_beams(beams as usize),
        None => drive,
    }
}

/// Where the filters of a log are expected: on the reference poses of the scans that trials localize on and of those that
/// exponents are rehearsed on. `None` where a filter may be anywhere.
pub(super) fn followed(settings: &scenario::Filter, log: &Log, drive: &Drive) -> Option<Vec<[f64; 2]>> {
    let tracks = matches!(settings.start, scenario::Start::Tracking(_)) && settings.injection.is_none();
    let steps = [&log.localize_scans, &log.train_scans].map(|scans| selected(drive, scans)).concat();
    let points: Option<Vec<_>> =
        steps.into_iter().map(|i| drive.steps[i].reference.map(|pose| [pose.x, pose.y])).collect();
    points.filter(|_| tracks)
}

/// A scenario's filter with motion noise fitted to a log where the scenario has none, and a remark on it.
fn with_motion_noise(
    settings: &scenario::Filter,
    drive: &Drive,
    localized: &[usize],
) -> (scenario::Filter, Option<String>) {
    if settings.motion != Motion::Odometry(None) {
        return (settings.clone(), None);
    }
    let fitted = fitted_alpha(drive, localized);
    let alpha = fitted.unwrap_or(OdometryError::USUAL_ALPHA);
    let from = match fitted {
        Some(_) => "fitted to the odometry's errors against the reference poses of all other scans",
        None => "a guess: too few of the other scans have reference poses to fit it to",
    };
    let numbers = alpha.map(|alpha| format!("{alpha:.2e}")).join(", ");
    let walk = match settings.random_walk_m {
        0.0 => String::new(),
        walk => format!(
            " Beside it the position walks at random, by {walk} m after a metre (`filter.motion.random_walk_m`)."
        ),
    };
    let note = format!("The filter's motion noise (alpha 1 to 4: {numbers}) is {from}.{walk}");
    (scenario::Filter { motion: Motion::Odometry(Some(alpha)), ..settings.clone() }, Some(note))
}

pub(super) fn world(simulation: &Simulation, maps: &MapSet) -> Result<World, SimulationError> {
    let Simulation { blocks, laser, robot, .. } = simulation;
    let simulator = Simulator::new(Arc::clone(&maps.exact), *blocks, *laser, simulation.effects()?)?;
    Ok(World { simulator, robot: robot.clone() })
}

/// The oracle's knowledge of the world: its true blocks, and no other effects.
fn obstructions(simulator: &Simulator) -> Result<Arc<dyn Obstructions>, SimulationError> {
    let Some(blocks) = simulator.blocks() else { return Ok(Arc::new(NothingInTheWay)) };
    let max_range_m = simulator.laser().options().max_range_m;
    let options = ObstructionOptions { max_range_m, ..OBSTRUCTIONS };
    Ok(Arc::new(ObstructionTable::new(blocks, simulator.map(), &options)?))
}

/// The lattice of the oracle; its rays are as long as the laser's. A finer one brings it a little nearer to the true bound
/// (docs/DESIGN.md).
const OBSTRUCTIONS: ObstructionOptions =
    ObstructionOptions { cell_m: 0.075, headings: 360, bin_m: 0.05, max_range_m: 0.0, shapes: 128 };

/// A world that is as mapped.
struct NothingInTheWay;

impl Obstructions for NothingInTheWay {
    fn bin_m(&self) -> f32 {
        1.0
    }

    fn survival(&self, _x: f64, _y: f64, _heading: f64, _range: f32) -> Survival<'_> {
        Survival { probability: &[1.0], start_m: 0.0 }
    }
}

/// Poses uniform over free space, clear of walls, with uniform headings.
pub fn free_poses(maps: &MapSet, count: u32, seed: u64) -> Particles {
    /// A map with less room than this share of its bounds gets fewer poses.
    const ATTEMPTS_PER_POSE: u32 = 10_000;
    let [x0, y0, x1, y1] = maps.exact.bounds();
    let draw = Draw::new(seed, Stage::Path, 1);
    (0..count)
        .filter_map(|i| {
            let mut rng = draw.item(i);
            (0..ATTEMPTS_PER_POSE).find_map(|_| {
                let x = x0 + (x1 - x0) * rng.random::<f64>();
                let y = y0 + (y1 - y0) * rng.random::<f64>();
                let theta = std::f64::consts::PI * (1.0 - 2.0 * rng.random::<f64>());
                let clear = f64::from(maps.distance.distance(x, y)) >= WALL_CLEARANCE_M;
                (clear && maps.exact.is_free(x, y)).then(|| Pose2::new(x, y, theta))
            })
        })
        .collect()
}

/// Whether a simulation can begin: the same for its models.
///
/// # Errors
/// [`LabError::ModelFile`].
pub(super) fn check_simulation(scenario: &Scenario, simulation: &Simulation) -> Result<(), LabError> {
    check_files(&scenario.models, simulation.laser.max_range_m as f32)
}

/// Training scans that are simulated in the map of a log.
fn simulated_scans(
    scenario: &Scenario,
    simulator: &SimulatorOptions,
    maps: &MapSet,
    drive: &Drive,
    seed: u64,
    progress: &dyn Progress,
) -> Result<ScanData, LabError> {
    let training = &scenario.training;
    let effects = simulator.effects().map_err(SimulationError::from).map_err(refused(scenario))?;
    let simulator = Simulator::new(Arc::clone(&maps.exact), simulator.blocks, simulator.laser, effects)
        .map_err(refused(scenario))?;
    let poses = free_poses(maps, training.poses, seed);
    progress.stage("simulating training scans", 1);
    let readings = simulator.observe_many(poses.as_poses(), training.observations, seed);
    progress.advance(1);
    let laser = simulator.laser().laser();
    let beams = training.beams.map_or(drive.laser.beam_count(), |beams| beams as usize);
    Ok(ScanData::simulated(laser, beams, &poses, training.observations, &readings))
}

/// Finds what a run on a log would refuse once it has read the log and its map. Returns what a run would warn of.
///
/// # Errors
/// [`LabError`].
pub(super) fn check_measured(scenario: &Scenario, log: &Log) -> Result<Vec<String>, LabError> {
    let MeasuredLog { drive, warning, .. } = MeasuredLog::read(scenario, log)?;
    let map = ExactRangeMap::new(log_map(log, &drive, &())?);
    let distance = DistanceGrid::new(map.geometry(), DISTANCE_GRID_M.0, DISTANCE_GRID_M.1)
        .map_err(unusable(&log.file))?;
    if log.simulator.is_none() || !log.train_scans.is_empty() {
        let (data, _) = measured_scans(&drive, &selected(&drive, &log.train_scans), &map, &scenario.training);
        enough_to_train_on(log, data.poses.len())?;
    }
    let (localized, unjudged) = judged(&drive, selected(&drive, &log.localize_scans));
    let steps = localized.into_iter().map(|i| drive.steps[i].clone()).collect();
    let localized = Drive { laser: drive.laser.clone(), steps };
    let warnings = [
        warning,
        unjudged,
        against_odometry(&localized),
        unmapped_start(&map, &distance, &localized),
        outside_of_map(&map, &localized),
        unlike_map(&map, &localized),
    ];
    Ok(warnings.into_iter().flatten().collect())
}
