use std::path::{Path, PathBuf};

use locsim_scenario::{Overrides, Scenario as Checked, Template};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{python, tree};
use crate::error::Error;

/// A scenario that isn't a file, in errors.
const DICT: &str = "<dict>";

/// A scenario that passed every check: what an experiment is.
///
/// Args:
///     source: A YAML file, or a dict of its keys.
///     base: The folder that the files of a dict are looked up in; the working directory by default.
///     trials: Number of trials, instead of the scenario's.
///     seed: Seed, instead of the scenario's.
///     models: Labels of the models to run, a subset of the scenario's.
///
/// Raises:
///     ScenarioError: Everything that is wrong, with file, line and key.
#[pyclass(frozen, module = "locsim")]
pub struct Scenario {
    pub checked: Checked,
}

#[pymethods]
impl Scenario {
    #[new]
    #[pyo3(signature = (source, *, base = None, trials = None, seed = None, models = None))]
    fn new(
        source: &Bound<'_, PyAny>,
        base: Option<PathBuf>,
        trials: Option<u32>,
        seed: Option<u64>,
        models: Option<Vec<String>>,
    ) -> Result<Self, Error> {
        let overrides = Overrides { trials, seed, models };
        let checked = if let Ok(keys) = source.cast::<PyDict>() {
            Checked::of_tree(&base.unwrap_or_default().join(DICT), &tree(keys)?, &overrides)?
        } else {
            Checked::load(&source.extract::<PathBuf>()?, &overrides)?
        };
        Ok(Self { checked })
    }

    /// The scenario that a function was given: itself, or a path or dict.
    #[staticmethod]
    fn of(source: &Bound<'_, PyAny>) -> Result<Self, Error> {
        of(source, Overrides::default()).map(|checked| Self { checked })
    }

    /// The scenario's keys and values as they were written. `trials`, `seed` and `models` that were given beside them are not in it.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>, Error> {
        python(py, &self.checked.tree()?)
    }

    /// The scenario with other values at some key paths, such as `{"filter.particles": 500, "models[0].floor": 0.01}`. Its bounds
    /// (`expect`) and its recording are dropped: they are of the scenario as it was.
    ///
    /// Raises:
    ///     ScenarioError: A path leads nowhere, or the scenario isn't valid with these values.
    #[pyo3(signature = (values, *, trials = None, seed = None, models = None))]
    fn replace(
        &self,
        values: &Bound<'_, PyDict>,
        trials: Option<u32>,
        seed: Option<u64>,
        models: Option<Vec<String>>,
    ) -> Result<Self, Error> {
        let values = tree(values)?;
        let template = Template { file: self.checked.file.clone(), tree: self.checked.tree()? };
        let values = values.as_object().into_iter().flatten().map(|(key, value)| (key.as_str(), value));
        let checked = template.with(values, &Overrides { trials, seed, models });
        // The lines are those of a text that nobody has written.
        Ok(Self { checked: checked.map_err(|error| error.without_lines_of(&self.checked.file))? })
    }

    /// The name.
    #[getter]
    fn name(&self) -> &str {
        &self.checked.name
    }

    /// One line for people; may be empty.
    #[getter]
    fn description(&self) -> &str {
        &self.checked.description
    }

    /// The file that it was read from; `None` of a dict.
    #[getter]
    fn file(&self) -> Option<&Path> {
        Some(self.checked.file.as_path()).filter(|file| !file.ends_with(DICT))
    }

    /// Everything random derives from it.
    #[getter]
    fn seed(&self) -> u64 {
        self.checked.seed
    }

    /// Number of trials.
    #[getter]
    fn trials(&self) -> u32 {
        self.checked.trials
    }

    /// Labels of the sensor models, in order.
    #[getter]
    fn models(&self) -> Vec<&str> {
        self.checked.models.iter().map(|model| model.label.as_str()).collect()
    }

    fn __repr__(&self) -> String {
        format!("Scenario({:?}, {} trials of {:?})", self.checked.name, self.checked.trials, self.models())
    }
}

/// A scenario with other trials, seed and models, from itself, a path or a dict.
pub fn of(source: &Bound<'_, PyAny>, overrides: Overrides) -> Result<Checked, Error> {
    let Ok(scenario) = source.cast::<Scenario>() else {
        let Overrides { trials, seed, models } = overrides;
        return Ok(Scenario::new(source, None, trials, seed, models)?.checked);
    };
    let scenario = &scenario.get().checked;
    if overrides == Overrides::default() {
        return Ok(scenario.clone());
    }
    let overrides = Overrides {
        trials: overrides.trials.or(Some(scenario.trials)),
        seed: overrides.seed.or(Some(scenario.seed)),
        models: overrides
            .models
            .or_else(|| Some(scenario.models.iter().map(|model| model.label.clone()).collect())),
    };
    Ok(Checked::of_tree(&scenario.file, &scenario.tree()?, &overrides)?)
}

/// The command that a report names; a dict has no file to name.
pub fn named(scenario: &Checked) -> String {
    format!("{:?}", scenario.file.display().to_string())
}
