use std::path::PathBuf;

use locsim_lab::run::{self as laboratory, Outcome, RunOptions, RunSummary};
use locsim_report::tables;
use locsim_scenario::Overrides;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

use crate::array::python;
use crate::error::Error;
use crate::scenario;
use crate::table::Table;
use crate::work::Work;

/// The results of a run. `str(run)` is the table that the command prints.
#[pyclass(frozen, module = "locsim")]
pub struct Run {
    outcome: Outcome,
    /// The results folder; `None` where nothing was written.
    #[pyo3(get)]
    out: Option<PathBuf>,
}

/// Runs a scenario: trains the sensor models, and localizes under each of them on the same trials.
///
/// Args:
///     source: A scenario, its file, or a dict of its keys.
///     out: The results folder, with report, figures and models; by default nothing is written.
///     trials: Number of trials, instead of the scenario's.
///     seed: Seed, instead of the scenario's.
///     models: Labels of the models to run, a subset of the scenario's.
///     resume: Goes on with an interrupted run into the same folder.
///     force: Replaces results that are in the folder.
///     threads: Worker threads; all cores by default. Results don't depend on it.
///     progress: Whether to draw progress bars (tqdm); by default on a terminal and in a notebook.
///
/// Raises:
///     ScenarioError: The scenario is refused.
///     LogError: Its log can't be read, or lacks what the scenario wants of it.
///     LocsimError: Anything else.
///     KeyboardInterrupt: After Ctrl-C, once the trials under way are done. A run into a folder keeps its finished trials.
#[pyfunction]
#[pyo3(signature = (
    source, out = None, *, trials = None, seed = None, models = None, resume = false, force = false, threads = None,
    progress = None,
))]
#[expect(clippy::too_many_arguments, reason = "keyword arguments, as the command has options")]
pub fn run(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    out: Option<PathBuf>,
    trials: Option<u32>,
    seed: Option<u64>,
    models: Option<Vec<String>>,
    resume: bool,
    force: bool,
    threads: Option<usize>,
    progress: Option<bool>,
) -> Result<Run, Error> {
    let scenario = scenario::of(source, Overrides { trials, seed, models })?;
    let cache = locsim::users_cache();
    let outcome = Work::new(py, progress, threads)?.run(py, |control| match &out {
        None => laboratory::compute(&scenario, cache.as_deref(), control),
        Some(out) => {
            let options = RunOptions {
                out: out.clone(),
                resume,
                force,
                command: format!(
                    "locsim.run({}, trials={}, seed={})",
                    scenario::named(&scenario),
                    scenario.trials,
                    scenario.seed
                ),
                control,
                cache: cache.as_deref(),
                recorder: None,
            };
            laboratory::run(&scenario, &options)
        }
    })?;
    Ok(Run { outcome, out })
}

impl Run {
    fn json(&self) -> Result<Value, Error> {
        Ok(serde_json::to_value(&self.outcome.summary)?)
    }
}

#[pymethods]
impl Run {
    /// `"trials"`: a row for each trial and model; `"steps"`: a row for each trial, model and scan. Empty on a log without reference
    /// poses.
    #[getter]
    fn tables<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyDict>, Error> {
        let all = PyDict::new(py);
        if let Some(results) = &self.outcome.results {
            all.set_item("trials", Bound::new(py, Table::new(tables::trials(results)?))?)?;
            all.set_item("steps", Bound::new(py, Table::new(tables::steps(results)?))?)?;
        }
        Ok(all)
    }

    /// The content of `summary.json`: errors of each model with their 95 % intervals, and ratios.
    #[getter]
    fn summary<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>, Error> {
        python(py, &self.outcome.summary)
    }

    /// Ratios of each model to `classic` and `oracle` on the same trials, `{model: {name: {"value", "lo", "hi"}}}`, with 95 %
    /// intervals of the paired bootstrap.
    #[getter]
    fn ratios<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>, Error> {
        let mut summary = self.json()?;
        let ratios = summary.get_mut("ratios").map_or_else(|| Value::Object(<_>::default()), Value::take);
        python(py, &ratios)
    }

    /// The bounds of the scenario's `expect` that the results miss, in words.
    #[getter]
    fn missed(&self) -> Vec<String> {
        self.outcome.missed.iter().map(ToString::to_string).collect()
    }

    fn __str__(&self) -> String {
        match &self.outcome.summary {
            RunSummary::Referenced(summary) => locsim_report::terminal_table(summary, None),
            RunSummary::Unreferenced(summary) => summary.table().to_terminal(None),
        }
    }

    fn __repr__(&self) -> Result<String, Error> {
        let summary = self.json()?;
        Ok(format!("Run({}, {} trials)", summary["scenario"], summary["trials"]))
    }
}
