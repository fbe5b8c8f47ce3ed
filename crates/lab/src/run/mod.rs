//! Runs a scenario: prepares the laboratory, runs the trials in parallel, writes the results folder.

mod bounds;
mod corrected;
mod coverage;
mod detail;
mod disagreement;
mod estimate;
mod filter;
mod grounds;
mod laboratory;
mod map;
mod measure;
mod measured_log;
mod misfit;
mod rehearsal;
mod training;
mod trial;
mod unreferenced;

use std::ops::Range;
use std::path::{Path, PathBuf};

use locsim_core::{Clock, Control, Pose2, Progress};
use locsim_dataset::{StampedPose, write_tum};
use rayon::prelude::*;
use serde::Serialize;

pub use bounds::MissedBound;
pub use estimate::{Estimate as CostEstimate, duration, size};
pub use grounds::Grounds;
pub use laboratory::{MapSet, free_poses, refused, simulate_trial};
pub use map::{LogMaps, agreement_figure, agreement_table, contradiction, grid_files};
pub use measure::{Measurement, measure};
pub use rehearsal::START;
pub use training::{ScanData, Surroundings, TrainedModel, temper, train};
pub use unreferenced::{Unreferenced, UnreferencedModel};

use crate::LabError;
pub(crate) use corrected::spread_stamps;
use detail::Detail;
pub(crate) use filter::options as filter_options;
use laboratory::{Laboratory, TrialDrive, check_measured, check_simulation};
use locsim_report::results::{DetailedTrial, RunResults, StepRow, Trial};
use locsim_report::store::{Folder, Part, Request, Store, StoreError};
use locsim_report::summary::Summary;
use locsim_report::{self as report, ReportContext, ReportError};
use locsim_scenario::{ErrorFrame, Estimate, ModelName, Scenario, Source};
pub(crate) use measured_log::{log_map, no_reference, selected};
pub use measured_log::{options_beside, read_options, read_scenario_log};

/// The recording's name in the results folder.
pub const RECORDING: &str = "recording.rrd";

/// Records one trial, into the file of this path if it writes one.
pub type Recorder<'a> =
    dyn Fn(&DetailedTrial, &Path) -> Result<(), Box<dyn std::error::Error + Send + Sync>> + Sync + 'a;

/// How to run a scenario.
pub struct RunOptions<'a> {
    /// The results folder.
    pub out: PathBuf,
    /// Whether to go on with an interrupted run.
    pub resume: bool,
    /// Whether earlier results, and what an interrupted run has kept, may be replaced.
    pub force: bool,
    /// The command that reproduces the run, for the report.
    pub command: String,
    /// The caller's clock, for `seconds` and `step_ms`, and progress; an interruption stops after the trials under way.
    pub control: Control<'a>,
    /// Where range tables are kept between runs, if anywhere.
    pub cache: Option<&'a Path>,
    /// Who records the scenario's recorded trial, if anyone.
    pub recorder: Option<&'a Recorder<'a>>,
}

/// The outcome of a complete run.
pub struct Outcome {
    /// The content of `summary.json`.
    pub summary: RunSummary,
    /// Bounds of the scenario's `expect` that the results miss.
    pub missed: Vec<MissedBound>,
    /// Every step of every trial; `None` on a log without reference poses, which has no errors to tell.
    pub results: Option<RunResults>,
}

/// The content of `summary.json`.
#[derive(Serialize)]
#[serde(untagged)]
pub enum RunSummary {
    /// Of estimates that were held against true or reference poses.
    Referenced(Summary),
    /// Of estimates on a log without reference poses.
    Unreferenced(Unreferenced),
}

/// Finds what a run of a scenario would refuse before its first costly step: too little memory, a fitted model of no use
/// here, a log that can't be read or lacks what the scenario wants of it. Returns what a run would warn of.
///
/// # Errors
/// [`LabError`], as [`run`].
pub fn check(scenario: &Scenario) -> Result<Vec<String>, LabError> {
    CostEstimate::of(scenario, rayon::current_num_threads()).check(scenario)?;
    for model in &scenario.models {
        if let ModelName::Amcl(kind) = model.name {
            training::amcl_parameters(model, kind)?;
        }
    }
    match &scenario.source {
        Source::Simulation(simulation) => check_simulation(scenario, simulation).map(|()| Vec::new()),
        Source::Log(log) => check_measured(scenario, log),
    }
}

/// Runs every trial of a scenario under every model and writes the results folder.
///
/// The folder is written beside its final place and renamed when complete; finished trials are kept there if the
/// run is interrupted.
///
/// # Errors
/// [`LabError`]; earlier results at `options.out` are then untouched, save with [`LabError::Recording`], when the new
/// ones are complete.
pub fn run(scenario: &Scenario, options: &RunOptions<'_>) -> Result<Outcome, LabError> {
    run_with(scenario, options, |_| Ok(()))
}

/// Runs a scenario, as [`run`] does, without the trials that `keep` puts among the finished parts of the store, under their numbers.
///
/// # Errors
/// [`LabError`], as [`run`], and those of `keep`.
pub fn run_with<E: From<LabError> + From<StoreError>>(
    scenario: &Scenario,
    options: &RunOptions<'_>,
    keep: impl FnOnce(&Store) -> Result<(), E>,
) -> Result<Outcome, E> {
    let threads = rayon::current_num_threads();
    let cost = CostEstimate::of(scenario, threads).with_table(scenario);
    cost.check(scenario)?;
    options.control.progress.note(&format!("{}: {}", scenario.name, cost.in_words(threads)));
    let fingerprint = scenario.content_hash().map_err(LabError::from)?;
    let RunOptions { resume, force, .. } = *options;
    let request = Request { out: &options.out, kind: "run", fingerprint: &fingerprint, resume, force };
    let (outcome, recorded) = request.fill(|store| {
        keep(store)?;
        let (outcome, detail) = write_results(scenario, store, options)?;
        let recorded = match (options.recorder, detail) {
            (Some(recorder), Some(detail)) => recorder(&detail, &store.folder().claim(RECORDING)?),
            _ => Ok(()),
        };
        Ok::<_, E>((outcome, recorded))
    })?;
    options.control.progress.advance(1);
    options.control.progress.finish();
    recorded.map_err(|source| LabError::Recording { out: options.out.clone(), source })?;
    Ok(outcome)
}

/// Runs a share of a scenario's trials, or takes them from `store`, which keeps them.
///
/// # Errors
/// [`LabError`], as [`run`], and for a log without reference poses, whose results are a report alone.
pub fn run_share(
    scenario: &Scenario,
    trials: Range<u32>,
    store: &Store,
    cache: Option<&Path>,
    control: Control<'_>,
) -> Result<Vec<Trial>, LabError> {
    CostEstimate::of(scenario, rayon::current_num_threads()).check(scenario)?;
    let laboratory = Laboratory::prepare(scenario, cache, control.progress)?;
    laboratory.with_reference()?;
    warn(&laboratory.warnings, control.progress);
    run_trials(&laboratory, trials, Some(store), control)
}

/// Runs every trial of a scenario under every model, as [`run`] does, and writes nothing.
///
/// # Errors
/// [`LabError`], as [`run`], and for a log without reference poses, whose results are a report alone.
pub fn compute(scenario: &Scenario, cache: Option<&Path>, control: Control<'_>) -> Result<Outcome, LabError> {
    let threads = rayon::current_num_threads();
    let cost = CostEstimate::of(scenario, threads).with_table(scenario);
    cost.check(scenario)?;
    control.progress.note(&format!("{}: {}", scenario.name, cost.in_words(threads)));
    let began = (control.clock)();
    let laboratory = Laboratory::prepare(scenario, cache, control.progress)?;
    laboratory.with_reference()?;
    warn(&laboratory.warnings, control.progress);
    let trials = run_trials(&laboratory, 0..scenario.trials, None, control)?;
    let results = results_of(&laboratory, trials, control.seconds_since(began));
    warn(&report::warnings(&results), control.progress);
    control.progress.finish();
    let summary = Summary::new(&results).map_err(ReportError::from)?;
    Ok(outcome(scenario, summary, results))
}

fn outcome(scenario: &Scenario, summary: Summary, results: RunResults) -> Outcome {
    let missed = bounds::missed(&scenario.expect, &summary);
    Outcome { summary: RunSummary::Referenced(summary), missed, results: Some(results) }
}

fn warn(warnings: &[String], progress: &dyn Progress) {
    for warning in warnings {
        progress.warn(warning);
    }
}

/// The results of trials that took `seconds`.
fn results_of(laboratory: &Laboratory<'_>, trials: Vec<Trial>, seconds: f64) -> RunResults {
    let scenario = laboratory.scenario;
    RunResults {
        scenario: scenario.name.clone(),
        description: scenario.description.clone(),
        seed: scenario.seed,
        seconds,
        error_frame: match scenario.errors.frame {
            ErrorFrame::Map => "map: along is x, across is y".to_owned(),
            ErrorFrame::Robot => "robot: along is forward, across is left".to_owned(),
        },
        localized_within_m: (scenario.filter.start == locsim_scenario::Start::Global)
            .then_some(scenario.errors.lost_m),
        estimate: estimate_name(scenario.filter.estimate).to_owned(),
        models: scenario.models.iter().map(|model| model.label.clone()).collect(),
        training: laboratory.models.iter().map(|model| model.row.clone()).collect(),
        disagreements: laboratory.disagreements(),
        trials,
    }
}

/// Runs the trials and writes everything but the recording. Without reference poses there is no trial to record.
fn write_results(
    scenario: &Scenario,
    store: &Store,
    options: &RunOptions<'_>,
) -> Result<(Outcome, Option<DetailedTrial>), LabError> {
    let began = (options.control.clock)();
    let laboratory = Laboratory::prepare(scenario, options.cache, options.control.progress)?;
    warn(&laboratory.warnings, options.control.progress);
    if let Some(drive) = laboratory.unreferenced() {
        save_scenario(scenario, store.folder(), &options.out)?;
        save_models(&laboratory, store.folder())?;
        let summary = unreferenced::write(&laboratory, drive, store.folder(), options)?;
        let summary = RunSummary::Unreferenced(summary);
        return Ok((Outcome { summary, missed: Vec::new(), results: None }, None));
    }
    let trials = run_trials(&laboratory, 0..scenario.trials, Some(store), options.control)?;
    options.control.progress.stage("report and recording", 1);
    let detail = detailed_trial(&laboratory, scenario.record.trial, options.control.clock)?;
    let folder = store.folder();
    save_scenario(scenario, folder, &options.out)?;
    save_models(&laboratory, folder)?;
    save_trajectories(&detail, &trials[scenario.record.trial as usize], folder)?;
    let results = results_of(&laboratory, trials, options.control.seconds_since(began));
    let mut warnings = laboratory.warnings.clone();
    let noticed = report::warnings(&results);
    warn(&noticed, options.control.progress);
    warnings.extend(noticed);
    let context = ReportContext {
        scenario_yaml: scenario.text.clone(),
        command: options.command.clone(),
        simulated: matches!(scenario.source, Source::Simulation(_)),
        warnings,
        notes: laboratory.notes.clone(),
    };
    // A report of many trials needs as much memory as map and models do.
    drop(laboratory);
    let summary = report::write(folder, &results, Some(&detail), &context)?;
    Ok((outcome(scenario, summary, results), Some(detail)))
}

/// The scenario as a file of the results folder `out`, for commands that take the folder.
fn save_scenario(scenario: &Scenario, folder: &Folder, out: &Path) -> Result<(), LabError> {
    Ok(folder.write("scenario.yaml", scenario.text_in(&out_folder(out)?).as_bytes())?)
}

/// A results folder, which need not be there yet, without links.
///
/// # Errors
/// [`LabError::Store`] for a folder whose path can't be told.
pub(crate) fn out_folder(out: &Path) -> Result<PathBuf, LabError> {
    let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let parent =
        parent.canonicalize().map_err(|source| StoreError::File { path: parent.to_owned(), source })?;
    Ok(parent.join(out.file_name().unwrap_or_default()))
}

/// Runs these trials, or takes them from `store`, which keeps them.
fn run_trials(
    laboratory: &Laboratory<'_>,
    numbers: Range<u32>,
    store: Option<&Store>,
    control: Control<'_>,
) -> Result<Vec<Trial>, LabError> {
    control.progress.stage("trials", numbers.len() as u64);
    let trials: Vec<Option<Trial>> = numbers
        .into_par_iter()
        .map(|number| {
            if control.is_interrupted() {
                return Ok(None);
            }
            let kept = store.and_then(|store| kept_trial(laboratory, store, number, control.progress));
            let trial = if let Some(trial) = kept {
                trial
            } else {
                let trial = run_trial(laboratory, number, control.clock)?;
                if let Some(store) = store {
                    store.parts().save(number, &trial)?;
                }
                trial
            };
            control.progress.advance(1);
            Ok(Some(trial))
        })
        .collect::<Result<_, LabError>>()?;
    if trials.iter().any(Option::is_none) {
        // A trial that wasn't looked at may be kept all the same.
        let finished = store.map_or(Ok(0), |store| store.parts().kept())?;
        return Err(LabError::Interrupted { finished, trials: trials.len() });
    }
    Ok(trials.into_iter().flatten().collect())
}

/// A trial that an interrupted run has kept, if it is whole and of these models.
fn kept_trial(
    laboratory: &Laboratory<'_>,
    store: &Store,
    number: u32,
    progress: &dyn Progress,
) -> Option<Trial> {
    let models = laboratory.models.iter().map(|model| model.label.as_str());
    match store.parts().load::<Trial>(number) {
        Part::Missing => return None,
        Part::Whole(trial)
            if trial.trial == number
                && trial.seed == laboratory.trial_seed(number)
                && trial.models.iter().map(|model| model.model.as_str()).eq(models) =>
        {
            return Some(trial);
        }
        Part::Whole(_) | Part::Damaged => {}
    }
    progress.warn(&format!("trial {number} was kept, but its file is damaged; it is run again"));
    None
}

fn run_trial(laboratory: &Laboratory<'_>, number: u32, clock: Clock<'_>) -> Result<Trial, LabError> {
    let TrialDrive { drive, .. } = laboratory.drive(number)?;
    let seed = laboratory.trial_seed(number);
    let models = laboratory
        .models
        .iter()
        .map(|model| trial::localize(laboratory, model, &drive, seed, clock, None))
        .collect::<Result<_, _>>()?;
    Ok(Trial { trial: number, seed, models })
}

/// Runs one trial again and keeps everything.
fn detailed_trial(
    laboratory: &Laboratory<'_>,
    number: u32,
    clock: Clock<'_>,
) -> Result<DetailedTrial, LabError> {
    let TrialDrive { drive, blocks } = laboratory.drive(number)?;
    let seed = laboratory.trial_seed(number);
    let recorded = &laboratory.scenario.record.models;
    let mut probes = None;
    let mut models = Vec::new();
    for model in laboratory.models.iter().filter(|model| recorded.contains(&model.label)) {
        let mut detail = Detail::new(&*laboratory.maps.exact, &drive, &model.label, recorded.len(), probes);
        trial::localize(laboratory, model, &drive, seed, clock, Some(&mut detail))?;
        let (model, used) = detail.into_model();
        models.push(model);
        probes = Some(used);
    }
    let dead_reckoning = trial::dead_reckoning(&drive, drive.steps[0].reference.unwrap_or(Pose2::IDENTITY));
    let labels = laboratory.models.iter().map(|model| model.label.clone()).collect();
    Ok(DetailedTrial { labels, walls: laboratory.maps.walls(), blocks, dead_reckoning, models, drive })
}

/// `models/LABEL.model`: what a scenario's `file` key takes.
fn save_models(laboratory: &Laboratory<'_>, folder: &Folder) -> Result<(), LabError> {
    for model in &laboratory.models {
        if let Some(fitted) = &model.fitted {
            fitted
                .save(&folder.claim(&format!("models/{}.model", model.label))?)
                .map_err(|source| LabError::Sensor { label: model.label.clone(), source })?;
        }
    }
    Ok(())
}

/// `trajectories/*.tum` of the recorded trial, as `evo` reads them: the most likely trajectory of each recorded model, and the
/// estimates of each model that the tables are of.
fn save_trajectories(detail: &DetailedTrial, trial: &Trial, folder: &Folder) -> Result<(), LabError> {
    let path = |name: &str| folder.claim(&format!("trajectories/{name}.tum"));
    let stamped = |poses: &[Pose2]| -> Vec<StampedPose> {
        // A path that begins at a random particle lacks its first steps.
        let missing = detail.drive.steps.len() - poses.len();
        let steps = detail.drive.steps.iter().skip(missing);
        steps.zip(poses).map(|(step, &pose)| StampedPose { stamp_secs: step.stamp_secs, pose }).collect()
    };
    write_tum(&path("reference")?, &locsim_dataset::reference_trajectory(&detail.drive))?;
    write_tum(&path("odometry")?, &stamped(&detail.dead_reckoning))?;
    for model in &detail.models {
        write_tum(&path(&model.name)?, &stamped(&model.most_likely_trajectory))?;
    }
    for model in &trial.models {
        let pose = |row: &StepRow| StampedPose { stamp_secs: row.stamp_secs, pose: row.estimate };
        let estimates: Vec<StampedPose> = model.steps.iter().map(pose).collect();
        write_tum(&path(&format!("{}-estimate", model.model))?, &estimates)?;
    }
    Ok(())
}

fn estimate_name(estimate: Estimate) -> &'static str {
    match estimate {
        Estimate::WeightedMean => "weighted mean",
        Estimate::MaxWeight => "particle of greatest weight",
        Estimate::DensestCluster => "densest cluster",
        Estimate::MostLikelyTrajectory => "most likely trajectory",
    }
}
