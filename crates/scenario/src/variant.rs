//! Variants of a scenario: the same file with other values at some keys.

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use crate::{Overrides, Problem, Scenario, ScenarioError, yaml};

/// A scenario file whose values can be replaced.
#[derive(Clone, Debug)]
pub struct Template {
    /// The file.
    pub file: PathBuf,
    /// Its keys and values, without `expect` and `record`: bounds and recordings are of the scenario as it stands in the file.
    pub tree: Value,
}

impl Template {
    /// Reads a scenario file. It must be a valid scenario as it is.
    ///
    /// # Errors
    /// [`ScenarioError`], as [`Scenario::load`].
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        Scenario::load(path, &Overrides::default())?;
        let (mut tree, _) = yaml::parse::<Map<String, Value>>(path, &yaml::read(path)?)?;
        for key in ["expect", "record"] {
            tree.remove(key);
        }
        // `map.file` is a key path, however short the file writes it.
        if let Some(map @ Value::String(_)) = tree.get_mut("map") {
            *map = json!({ "file": map.take() });
        }
        Ok(Self { file: path.to_owned(), tree: Value::Object(tree) })
    }

    /// The scenario with other values at these key paths, such as `filter.particles` or `models[0].floor`.
    ///
    /// # Errors
    /// [`ScenarioError`] for a path that leads nowhere, and for a scenario that is not valid. Its lines are meaningless.
    pub fn with<'v>(
        &self,
        values: impl IntoIterator<Item = (&'v str, &'v Value)>,
        overrides: &Overrides,
    ) -> Result<Scenario, ScenarioError> {
        let mut tree = self.tree.clone();
        for (key, value) in values {
            *place(&mut tree, key).map_err(|message| self.refused(key, message))? = value.clone();
        }
        Scenario::of_text(&self.file, &yaml::text(&tree), overrides)
    }

    fn refused(&self, key: &str, message: String) -> ScenarioError {
        let problem = Problem { line: None, key: key.to_owned(), message };
        ScenarioError::Invalid { file: self.file.clone(), problems: vec![problem] }
    }
}

/// Where a value stands. Maps on the way that are absent are made; elements of lists must be there.
fn place<'t>(tree: &'t mut Value, path: &str) -> Result<&'t mut Value, String> {
    let mut node = tree;
    for part in path.split('.') {
        let (key, indices) = part.split_at(part.find('[').unwrap_or(part.len()));
        if key.is_empty() {
            return Err("a path of keys such as filter.particles or models[0].floor is needed".to_owned());
        }
        if node.is_null() {
            *node = Value::Object(Map::new());
        }
        let map =
            node.as_object_mut().ok_or_else(|| format!("the scenario has no map there to hold `{key}`"))?;
        node = map.entry(key).or_insert(Value::Null);
        for index in indices.split_inclusive(']') {
            let number = index.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
            let number = number.and_then(|number| number.parse::<usize>().ok());
            let number =
                number.ok_or_else(|| format!("`{index}` is not the number of an element, such as [0]"))?;
            let list = node.as_array_mut().ok_or_else(|| format!("`{key}` is not a list in the scenario"))?;
            let count = list.len();
            node = list.get_mut(number).ok_or_else(|| {
                format!("`{key}` has {count} elements in the scenario; [{number}] is not among them")
            })?;
        }
    }
    Ok(node)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_put_where_its_path_leads() {
        let tree = json!({"laser": {"beams": 12}, "models": [{"name": "classic"}], "seed": 1});
        let with = |path: &str| {
            let mut tree = tree.clone();
            *place(&mut tree, path).unwrap() = json!(7);
            tree
        };
        assert_eq!(with("laser.beams")["laser"]["beams"], 7);
        assert_eq!(with("models[0].floor")["models"][0], json!({"name": "classic", "floor": 7}));
        assert_eq!(with("training.poses")["training"], json!({"poses": 7}));
        assert_eq!(with("seed")["seed"], 7);
    }

    #[test]
    fn a_path_that_leads_nowhere_is_refused() {
        for (path, message) in [
            ("seed.low", "the scenario has no map there to hold `low`"),
            ("models[1]", "`models` has 1 elements in the scenario; [1] is not among them"),
            ("models[x]", "`[x]` is not the number of an element, such as [0]"),
            ("models[0", "`[0` is not the number of an element, such as [0]"),
            ("seed[0]", "`seed` is not a list in the scenario"),
            ("laser..beams", "a path of keys such as filter.particles or models[0].floor is needed"),
        ] {
            let mut tree = json!({"laser": {"beams": 12}, "models": ["classic"], "seed": 1});
            assert_eq!(place(&mut tree, path).unwrap_err(), message);
        }
    }
}
