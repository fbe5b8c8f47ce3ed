//! Studies: experiments of distribution regression alone, without a robot that localizes. A YAML file names a sensor,
//! the models and how much data they get; [`Study::load`] reads and checks it, [`run`] writes a results folder with
//! figures beside what the paper says of its own.

mod claims;
mod experiment;
mod families;
mod figures;
mod model;
mod page;
mod raw;
mod results;
#[cfg(test)]
mod schema_tests;
mod sensor;
mod validate;

use std::path::{Path, PathBuf};

use thiserror::Error;

pub use model::{Criterion, Model};
pub use page::terminal_summary;
pub use results::{Claim, Curve, Results, Verdict};

use locsim_core::Control;
use locsim_report::ReportError;
use locsim_report::store::{Request, StoreError};
use locsim_scenario::ScenarioError;
use locsim_scenario::check::Checker;
use locsim_scenario::error::shown;
use locsim_scenario::yaml;
use sensor::Setup;

/// A study that passed every check, its maps and data read.
pub struct Study {
    /// The file it was read from.
    pub file: PathBuf,
    /// The file's text.
    text: String,
    /// Letters, digits, `-` and `_`.
    pub name: String,
    /// One line for people; may be empty.
    description: String,
    /// Everything random derives from it.
    seed: u64,
    kind: Kind,
    setup: Setup,
    models: Vec<Model>,
    /// Candidates for each state coordinate, in the order of the coordinates.
    bandwidths: Vec<Vec<f64>>,
    folds: usize,
    criterion: Criterion,
    /// Ascending, at least one.
    states: Vec<usize>,
    /// Observations of a training state; `None` for all there are.
    observations: Option<usize>,
    /// Whether to choose training states within budgets.
    thinning: bool,
    /// Ascending; may be empty.
    counts: Vec<usize>,
    repeats: u32,
    test_states: usize,
    /// Observations behind the truth of a simulated test state.
    truth_observations: usize,
    /// Whether the size was cut down by `--quick`.
    quick: bool,
}

/// Which of the paper's experiments a study is, and so which of its statements stand beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
enum Kind {
    Laser,
    FieldSensor,
    Grass,
    StaticLidar,
    Table,
}

/// Settings that the command line overrides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StudyOverrides {
    /// Number of repeats.
    pub repeats: Option<u32>,
    /// Seed.
    pub seed: Option<u64>,
    /// Two repeats on little data, to see whether everything works.
    pub quick: bool,
}

/// How to run a study.
pub struct StudyOptions<'a> {
    /// The results folder.
    pub out: PathBuf,
    /// Whether to go on with an interrupted study.
    pub resume: bool,
    /// Whether earlier results, and what an interrupted study has kept, may be replaced.
    pub force: bool,
    /// The caller's progress and interruption.
    pub control: Control<'a>,
}

/// Why a study could not be read or done.
#[derive(Debug, Error)]
pub enum StudyError {
    /// The study's file or its map is refused.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A data file is refused.
    #[error("{}:{} {what}", shown(path), line.map_or_else(String::new, |line| format!("{line}:")))]
    Data {
        /// The file.
        path: PathBuf,
        /// The line, from 1, where there is one.
        line: Option<usize>,
        /// The defect, and the allowed values.
        what: String,
    },
    /// A regression refused its data.
    #[error("distribution regression: {0}")]
    Regression(#[from] distreg::Error),
    /// The figures or the report could not be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The results folder can't be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The user stopped the study; finished repeats are kept.
    #[error("interrupted; add --resume to go on")]
    Interrupted,
}

impl StudyError {
    /// Whether the user stopped the study.
    pub fn is_interruption(&self) -> bool {
        matches!(self, Self::Interrupted)
    }
}

impl Study {
    /// Reads and checks a study and the map or data that it names.
    ///
    /// # Errors
    /// [`StudyError`] with everything that is wrong: file, line, key path, value and what is allowed.
    pub fn load(path: &Path, overrides: StudyOverrides) -> Result<Self, StudyError> {
        let text = yaml::read(path)?;
        let (raw, locations) = yaml::parse::<raw::RawStudy>(path, &text)?;
        let environment = |name: &str| std::env::var(name).ok();
        let check = || Checker::new(path, &locations, &environment);
        validate::validate(raw, path, text, overrides, &check)
    }
}

/// Whether the file at `path` is a study and not a scenario: only studies have the key `sensor`.
///
/// # Errors
/// [`ScenarioError::Read`] where the file can't be read.
pub fn is_study(path: &Path) -> Result<bool, ScenarioError> {
    Ok(yaml::has_key(&yaml::read(path)?, "sensor"))
}

/// The JSON Schema of study files.
pub fn schema() -> serde_json::Value {
    schemars::schema_for!(raw::RawStudy).to_value()
}

impl Study {
    /// The models under comparison.
    pub fn models(&self) -> &[Model] {
        &self.models
    }

    /// Number of repeats.
    pub fn repeats(&self) -> u32 {
        self.repeats
    }

    /// A hash of all that a repeat depends on; not of their number, so that a study can be resumed with more of them.
    fn fingerprint(&self) -> Result<String, StudyError> {
        let mut hasher = blake3::Hasher::new();
        let mut add = |content: &[u8]| {
            hasher.update(&(content.len() as u64).to_le_bytes());
            hasher.update(content);
        };
        add(env!("CARGO_PKG_VERSION").as_bytes());
        add(self.text.as_bytes());
        add(&self.seed.to_le_bytes());
        add(&[u8::from(self.quick)]);
        for path in &self.setup.files {
            add(&std::fs::read(path).map_err(|source| ScenarioError::Read { path: path.clone(), source })?);
        }
        Ok(hasher.finalize().to_hex().to_string())
    }

    /// The command that repeats it.
    pub fn command(&self) -> String {
        let quick = if self.quick { " --quick" } else { "" };
        format!("locsim study {} --seed {} --repeats {}{quick}", self.file.display(), self.seed, self.repeats)
    }
}

/// Does a study and writes `results.json`, figures and reports into the results folder, which is written beside its
/// place and renamed when complete. The bytes are a function of the study alone.
///
/// # Errors
/// [`StudyError`]; earlier results at `options.out` are then untouched.
pub fn run(study: &Study, options: &StudyOptions<'_>) -> Result<Results, StudyError> {
    let fingerprint = study.fingerprint()?;
    let StudyOptions { resume, force, .. } = *options;
    let request = Request { out: &options.out, kind: "study", fingerprint: &fingerprint, resume, force };
    let results = request.fill(|store| {
        let (results, extra) = experiment::run(study, store.parts(), options)?;
        page::write(store.folder(), study, &results, &extra)?;
        Ok::<_, StudyError>(results)
    })?;
    options.control.progress.finish();
    Ok(results)
}
