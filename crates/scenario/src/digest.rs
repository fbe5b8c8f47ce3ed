use std::io;
use std::path::{Path, PathBuf};

use locsim_dataset::log_files;

use super::{LogMap, Scenario, ScenarioError, Source, load_map};

impl Scenario {
    /// A hash (blake3, hexadecimal) of everything that a trial's result depends on: the settings, the content of
    /// the map, log and model files, and the version of this program. Equal hashes mean that finished trials can
    /// be kept when an interrupted run is resumed, with more trials too.
    ///
    /// # Errors
    /// [`ScenarioError`] when one of the files can't be read any more.
    pub fn content_hash(&self) -> Result<String, ScenarioError> {
        let unreadable = |path: &Path, source| ScenarioError::Read { path: path.to_owned(), source };
        let settings = serde_json::to_vec(self).map_err(|error| unreadable(&self.file, error.into()))?;
        let mut hasher = blake3::Hasher::new();
        hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
        let mut add = |content: &[u8]| {
            hasher.update(&(content.len() as u64).to_le_bytes());
            hasher.update(content);
        };
        add(&settings);
        for path in self.inputs()?.iter().skip(1) {
            add(&std::fs::read(path).map_err(|source| unreadable(path, source))?);
        }
        Ok(hasher.finalize().to_hex().to_string())
    }

    /// Every file that the scenario is read from: its own first, then map, image of the map, log, and models.
    ///
    /// # Errors
    /// [`ScenarioError`] when the map can't be read any more.
    pub fn inputs(&self) -> Result<Vec<PathBuf>, ScenarioError> {
        let image = self.map_file().map(load_map).transpose()?.and_then(|map| map.image);
        let log = match &self.source {
            Source::Simulation(_) => Vec::new(),
            Source::Log(log) => log_files(&log.file).map_err(|error| ScenarioError::Read {
                path: log.file.clone(),
                source: io::Error::other(error),
            })?,
        };
        let log = log.iter().map(PathBuf::as_path);
        let fitted = self.models.iter().filter_map(|model| model.file.as_deref());
        let others = self.map_file().into_iter().chain(image.as_deref()).chain(log).chain(fitted);
        Ok([self.file.as_path()].into_iter().chain(others).map(Path::to_owned).collect())
    }

    /// The map file; `None` where the map is built from the log.
    pub fn map_file(&self) -> Option<&Path> {
        match &self.source {
            Source::Simulation(simulation) => Some(&simulation.map),
            Source::Log(log) => match &log.map {
                LogMap::File(path) => Some(path),
                LogMap::FromScans { .. } => None,
            },
        }
    }
}
