//! Scenarios: YAML files that say what an experiment is. [`Scenario::load`] reads and checks one; nothing runs
//! before every check has passed. [`schema`] describes the files to editors.

mod amcl;
pub mod catalogue;
pub mod check;
mod digest;
pub mod edit;
pub mod effect;
pub mod error;
mod form;
pub mod key_path;
pub mod limited;
mod map_file;
mod raw;
#[cfg(test)]
mod schema_tests;
#[cfg(any(test, feature = "testing"))]
pub mod testing;
#[cfg(test)]
mod tests;
mod validate;
mod validated;
mod variant;
pub mod yaml;

use std::path::Path;

use serde::de::IgnoredAny;
use serde_json::Value;

pub use amcl::load_amcl;
pub use effect::effect_yaml;
pub use error::{Problem, ScenarioError};
pub use map_file::{LoadedMap, check_reading, load_map};
pub use validate::name;
pub use validated::*;
pub use variant::Template;

/// Settings that the command line overrides.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Overrides {
    /// Number of trials. A recorded trial beyond them becomes the last.
    pub trials: Option<u32>,
    /// Seed.
    pub seed: Option<u64>,
    /// Labels of the models to run, a subset of the scenario's; their order stays the scenario's. Bounds and
    /// recordings of the others are dropped.
    pub models: Option<Vec<String>>,
}

impl Scenario {
    /// Reads and checks a scenario file and the map that it names.
    ///
    /// # Errors
    /// [`ScenarioError`] with everything that is wrong: file, line, key path, value and what is allowed.
    pub fn load(path: &Path, overrides: &Overrides) -> Result<Self, ScenarioError> {
        let text = yaml::read(path)?;
        Self::of_text(path, &text, overrides)
    }

    /// Checks a scenario that isn't read from a file: a tree of its keys and values. `file` stands for it in errors; files that
    /// the scenario names are looked up in the folder of that path.
    ///
    /// # Errors
    /// As [`Scenario::load`], without lines.
    pub fn of_tree(file: &Path, tree: &Value, overrides: &Overrides) -> Result<Self, ScenarioError> {
        Self::of_text(file, &yaml::text(tree), overrides).map_err(|error| error.without_lines_of(file))
    }

    /// The scenario's keys and values as they were written. Overrides are not among them.
    ///
    /// # Errors
    /// None: the text was read before.
    pub fn tree(&self) -> Result<Value, ScenarioError> {
        Ok(Value::Object(yaml::parse(&self.file, &self.text)?.0))
    }

    /// The error that something is wrong with the value at a key path.
    pub fn refusal(&self, key: &str, message: String) -> ScenarioError {
        let line =
            yaml::parse::<IgnoredAny>(&self.file, &self.text).ok().and_then(|(_, lines)| lines.line(key));
        let problem = Problem { line, key: key.to_owned(), message };
        ScenarioError::Invalid { file: self.file.clone(), problems: vec![problem] }
    }

    /// Checks a text that is, or will be, in the file `path`.
    ///
    /// # Errors
    /// As [`Scenario::load`].
    pub fn of_text(path: &Path, text: &str, overrides: &Overrides) -> Result<Self, ScenarioError> {
        Self::parse(path, text, overrides, &|name| std::env::var(name).ok())
    }

    /// [`Scenario::load`] of a text that was read from `path`, with an environment of the caller's.
    fn parse(
        path: &Path,
        text: &str,
        overrides: &Overrides,
        environment: check::Environment<'_>,
    ) -> Result<Self, ScenarioError> {
        let (raw, locations) = yaml::parse::<raw::RawScenario>(path, text)?;
        let check = || check::Checker::new(path, &locations, environment);
        let walls: Vec<_> = raw.effects.iter().map(|effect| effect.wall.clone()).collect();
        let mut scenario = validate::validate(raw, path, overrides, check())?;
        text.clone_into(&mut scenario.text);
        if let Some(map) = scenario.map_file() {
            let map = load_map(map)?;
            validate::in_map(&mut scenario, &walls, &map, check())?;
        } else {
            validate::without_map(&walls, check())?;
        }
        Ok(scenario)
    }
}

/// The JSON Schema of scenario files.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(raw::RawScenario).to_value()
}
