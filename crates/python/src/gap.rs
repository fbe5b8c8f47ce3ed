use std::path::{Path, PathBuf};

use locsim_dataset::{BagTopics, LogOptions};
use locsim_gap::Outcome;
use locsim_lab::gap::{self as laboratory, GapSettings, GapStudy, GapStudyOptions};
use locsim_scenario::Overrides;
use pyo3::prelude::*;
use serde_json::Value;

use crate::array::python;
use crate::error::{Error, refused};
use crate::scenario;
use crate::work::Work;

/// What a simulation lacks. `str(answer)` is what the command prints.
#[pyclass(frozen, module = "locsim")]
pub struct Answer {
    outcome: Outcome,
    /// The scenario with the effects that were found, as YAML for a file in the results folder or, without one, in the scenario's
    /// own folder.
    #[pyo3(get)]
    scenario: String,
    /// The results folder; `None` where nothing was written.
    #[pyo3(get)]
    out: Option<PathBuf>,
}

/// Compares a measured log with a scenario's simulation, and names the effects that the simulation lacks (docs/gap.md).
///
/// Args:
///     source: The scenario, its file, or a dict of its keys.
///     log: The measured log, with reference poses; by default the scenario's own.
///     out: The results folder; by default nothing is written.
///     replicates: Simulated logs behind a p-value, at least 19.
///     seed: Seed, instead of the scenario's.
///     scans, beams: The most that are looked at.
///     without: Names of effects that aren't thought of.
///     filter: Whether to run a filter with the old and the new simulator.
///     max_range_m, scan_topic, odometry_topic, reference_topic: How the log is read, as for `read_log`.
///     force, threads, progress: As for `run`.
///
/// Raises:
///     ScenarioError, LogError, LocsimError, KeyboardInterrupt: As for `run`.
#[pyfunction]
#[pyo3(signature = (
    source, log = None, out = None, *, replicates = GapSettings::REPLICATES, seed = None, scans = 600, beams = 72, without = None,
    filter = true, max_range_m = None, scan_topic = None, odometry_topic = None, reference_topic = None,
    force = false, threads = None, progress = None,
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments, as the command has options")]
pub fn gap(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    log: Option<PathBuf>,
    out: Option<PathBuf>,
    replicates: u32,
    seed: Option<u64>,
    scans: usize,
    beams: usize,
    without: Option<Vec<String>>,
    filter: bool,
    max_range_m: Option<f32>,
    scan_topic: Option<String>,
    odometry_topic: Option<String>,
    reference_topic: Option<String>,
    force: bool,
    threads: Option<usize>,
    progress: Option<bool>,
) -> Result<Answer, Error> {
    let scenario = scenario::of(source, Overrides { seed, ..Overrides::default() })?;
    let without = without.unwrap_or_default();
    let without: Result<Vec<_>, _> = without.iter().map(|name| name.parse()).collect();
    let settings = GapSettings {
        replicates,
        seed,
        scans,
        beams,
        without: without.map_err(|error| refused(format!("without: {error}")))?,
        log: LogOptions {
            max_range_m,
            topics: BagTopics { scan: scan_topic, odometry: odometry_topic, reference: reference_topic },
            without_odometry: false,
        },
        baseline: None,
    };
    settings.check().map_err(refused)?;
    let command = format!("locsim.gap({})", scenario::named(&scenario));
    let cache = locsim::users_cache();
    let beside = scenario.file.parent().unwrap_or(Path::new("")).to_owned();
    let (outcome, scenario) = Work::new(py, progress, threads)?.run(py, |control| {
        let study = GapStudy::new(scenario, log.as_deref(), settings)?;
        let outcome = match &out {
            None => laboratory::find(&study, filter, cache.as_deref(), control)?,
            Some(out) => {
                let options = GapStudyOptions {
                    out: out.clone(),
                    force,
                    command,
                    filter,
                    control,
                    cache: cache.as_deref(),
                    recorder: None,
                };
                laboratory::run(&study, &options)?
            }
        };
        let folder = out.as_ref().unwrap_or(&beside);
        let scenario = laboratory::scenario_with(&study, &outcome.effects, folder)?;
        Ok::<_, locsim_lab::LabError>((outcome, scenario))
    })?;
    Ok(Answer { outcome, scenario, out })
}

impl Answer {
    fn json(&self) -> Result<Value, Error> {
        Ok(serde_json::to_value(&self.outcome)?)
    }
}

#[pymethods]
impl Answer {
    /// The findings in a few sentences.
    #[getter]
    fn text(&self) -> String {
        laboratory::answer(&self.outcome)
    }

    /// none, named, ambiguous, partly_explained, unnamed, unexplained or underpowered.
    #[getter]
    fn verdict(&self) -> Result<String, Error> {
        Ok(self.json()?["verdict"].as_str().unwrap_or_default().to_owned())
    }

    /// The named effects, with their numbers, intervals and evidence.
    #[getter]
    fn effects<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>, Error> {
        python(py, &self.outcome.effects)
    }

    /// The content of `gap.json`.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>, Error> {
        python(py, &self.outcome)
    }

    fn __str__(&self) -> String {
        self.text()
    }

    fn __repr__(&self) -> Result<String, Error> {
        let names: Vec<String> = self.outcome.effects.iter().map(|named| named.name.to_string()).collect();
        Ok(format!("Answer({:?}, {names:?})", self.verdict()?))
    }
}
