use std::path::{Path, PathBuf};

use locsim_dataset::{BagTopics, LogOptions};
use locsim_gap::Named;
use locsim_lab::gap::{self as laboratory, GapSettings, GapStudy, GapStudyOptions};
use locsim_scenario::Overrides;
use pyo3::prelude::*;
use serde_json::Value;

use crate::array::loads;
use crate::error::{Error, refused};
use crate::scenario;
use crate::work::Work;

/// What a simulation lacks, or what has changed since the baseline. `str(answer)` is what the command prints.
#[pyclass(frozen, module = "locsim")]
pub struct Answer {
    /// The findings in a few sentences.
    #[pyo3(get)]
    text: String,
    /// none, named, ambiguous, partly_explained, unnamed, unexplained or underpowered; beside a baseline none, changed, unexplained or
    /// underpowered.
    #[pyo3(get)]
    verdict: String,
    names: Vec<&'static str>,
    /// JSON.
    effects: String,
    content: String,
    /// The scenario with the effects that were found, as YAML for a file in the results folder or, without one, in the scenario's
    /// own folder.
    #[pyo3(get)]
    scenario: String,
    /// The results folder; `None` where nothing was written.
    #[pyo3(get)]
    out: Option<PathBuf>,
}

/// Compares a measured log with a scenario's simulation, and names the effects that the simulation lacks (docs/gap.md). With a
/// baseline, compares it with that log, and names the effects that have come since.
///
/// Args:
///     source: The scenario, its file, or a dict of its keys.
///     log: The measured log, with reference poses; by default the scenario's own.
///     out: The results folder; by default nothing is written.
///     baseline: An earlier log of the same robot in the scenario's map.
///     replicates: Simulated logs (beside a baseline: permutations) behind a p-value, at least 19; by default 999 (399).
///     seed: Seed, instead of the scenario's.
///     scans, beams: The most that are looked at.
///     without: Names of effects that aren't thought of.
///     filter: Whether to run a filter with the old and the new simulator; not beside a baseline.
///     max_range_m, scan_topic, odometry_topic, reference_topic: How the log is read, as for `read_log`.
///     force, threads, progress: As for `run`.
///
/// Raises:
///     ScenarioError, LogError, LocsimError, KeyboardInterrupt: As for `run`.
#[pyfunction]
#[pyo3(signature = (
    source, log = None, out = None, *, baseline = None, replicates = None, seed = None, scans = 600, beams = 72, without = None,
    filter = true, max_range_m = None, scan_topic = None, odometry_topic = None, reference_topic = None,
    force = false, threads = None, progress = None,
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments, as the command has options")]
pub fn gap(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    log: Option<PathBuf>,
    out: Option<PathBuf>,
    baseline: Option<PathBuf>,
    replicates: Option<u32>,
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
        replicates: replicates.unwrap_or(match baseline {
            None => GapSettings::REPLICATES,
            Some(_) => GapSettings::PERMUTATIONS,
        }),
        seed,
        scans,
        beams,
        without: without.map_err(|error| refused(format!("without: {error}")))?,
        log: LogOptions {
            max_range_m,
            topics: BagTopics { scan: scan_topic, odometry: odometry_topic, reference: reference_topic },
            without_odometry: false,
        },
        baseline,
    };
    settings.check().map_err(refused)?;
    let command = format!("locsim.gap({})", scenario::named(&scenario));
    let cache = locsim::users_cache();
    let beside = scenario.file.parent().unwrap_or(Path::new("")).to_owned();
    Work::new(py, progress, threads)?.run(py, |control| {
        let study = GapStudy::new(scenario, log.as_deref(), settings)?;
        let options = out.as_ref().map(|out| GapStudyOptions {
            out: out.clone(),
            force,
            command,
            filter,
            control,
            cache: cache.as_deref(),
            recorder: None,
        });
        let folder = out.as_ref().unwrap_or(&beside);
        if study.settings().baseline.is_some() {
            let changes = match &options {
                None => laboratory::find_since(&study, control)?,
                Some(options) => laboratory::run_since(&study, options)?,
            };
            let content = laboratory::json_since(&study, &changes)?;
            let scenario = laboratory::scenario_since(&study, &changes, folder)?;
            return Answer::new(laboratory::answer_since(&changes), &changes.effects, content, scenario, out);
        }
        let outcome = match &options {
            None => laboratory::find(&study, filter, cache.as_deref(), control)?,
            Some(options) => laboratory::run(&study, options)?,
        };
        let content = serde_json::to_string(&outcome)?;
        let scenario = laboratory::scenario_after(&study, &outcome, folder)?;
        Answer::new(laboratory::answer(&outcome), &outcome.effects, content, scenario, out)
    })
}

impl Answer {
    fn new(
        text: String,
        effects: &[Named],
        content: String,
        scenario: String,
        out: Option<PathBuf>,
    ) -> Result<Self, Error> {
        let fields: Value = serde_json::from_str(&content)?;
        let verdict = fields["verdict"].as_str().unwrap_or_default().to_owned();
        let names = effects.iter().map(|named| named.name.name()).collect();
        Ok(Self { text, verdict, names, effects: serde_json::to_string(effects)?, content, scenario, out })
    }
}

#[pymethods]
impl Answer {
    /// The named effects, with their numbers, intervals and evidence; beside a baseline, numbers are changes.
    #[getter]
    fn effects<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>, Error> {
        loads(py, &self.effects)
    }

    /// The content of `gap.json`.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>, Error> {
        loads(py, &self.content)
    }

    fn __str__(&self) -> &str {
        &self.text
    }

    fn __repr__(&self) -> String {
        format!("Answer({:?}, {:?})", self.verdict, self.names)
    }
}
