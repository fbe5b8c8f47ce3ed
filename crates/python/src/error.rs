//! Errors of the crates as Python exceptions, with the text that the program prints.

use locsim_lab::LabError;
use locsim_scenario::ScenarioError as InvalidScenario;
use locsim_terminal::Failure;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;

create_exception!(locsim, LocsimError, PyException, "What locsim refuses or can't do.");
create_exception!(
    locsim,
    ScenarioError,
    LocsimError,
    "A scenario, or a map that it names, is refused. `file`, `line` and `key` are those of the first problem; `problems` lists all."
);
create_exception!(locsim, LogError, LocsimError, "A log can't be read, or lacks what is asked of it.");
create_exception!(locsim, SensorError, LocsimError, "A sensor model can't be fitted, read or used.");
create_exception!(locsim, FilterError, LocsimError, "A filter can't be made, or can't go on.");

/// An error on its way to Python.
#[derive(Debug)]
pub enum Error {
    /// Of Python itself.
    Python(PyErr),
    /// A scenario is refused.
    Scenario(InvalidScenario),
    /// A log is refused.
    Log(String),
    /// A sensor model is refused.
    Sensor(String),
    /// A filter is refused.
    Filter(String),
    /// Anything else.
    Other(String),
    /// The user stopped the work.
    Interrupted,
}

/// The text that the program prints.
fn text(error: impl std::error::Error + Send + Sync + 'static) -> String {
    Failure::from(error).explain()
}

/// An argument that Python itself would refuse with a `ValueError`.
pub fn refused(message: impl Into<String>) -> Error {
    Error::Python(PyValueError::new_err(message.into()))
}

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        match error {
            Error::Python(error) => error,
            Error::Scenario(error) => of_scenario(error),
            Error::Log(text) => LogError::new_err(text),
            Error::Sensor(text) => SensorError::new_err(text),
            Error::Filter(text) => FilterError::new_err(text),
            Error::Other(text) => LocsimError::new_err(text),
            Error::Interrupted => PyKeyboardInterrupt::new_err(()),
        }
    }
}

fn of_scenario(error: InvalidScenario) -> PyErr {
    let (file, problems) = match &error {
        InvalidScenario::Read { path, .. } => (path.clone(), Vec::new()),
        InvalidScenario::Invalid { file, problems } => {
            let problem = |problem: &locsim_scenario::Problem| {
                (problem.line, problem.key.clone(), problem.message.clone())
            };
            (file.clone(), problems.iter().map(problem).collect())
        }
    };
    let (line, key) = problems.first().map_or((None, ""), |(line, key, _)| (*line, key.as_str()));
    Python::attach(|py| {
        let exception = ScenarioError::new_err(text(error));
        let value = exception.value(py);
        let done = value
            .setattr("file", file)
            .and_then(|()| value.setattr("line", line))
            .and_then(|()| value.setattr("key", key))
            .and_then(|()| value.setattr("problems", &problems));
        done.err().unwrap_or(exception)
    })
}

impl From<PyErr> for Error {
    fn from(error: PyErr) -> Self {
        Self::Python(error)
    }
}

impl From<InvalidScenario> for Error {
    fn from(error: InvalidScenario) -> Self {
        Self::Scenario(error)
    }
}

impl From<LabError> for Error {
    fn from(error: LabError) -> Self {
        if error.is_interruption() {
            return Self::Interrupted;
        }
        match error {
            LabError::Scenario(error) => Self::Scenario(error),
            LabError::Dataset(_) | LabError::Log { .. } => Self::Log(text(error)),
            LabError::TrainingData { .. } | LabError::ModelFile { .. } | LabError::Sensor { .. } => {
                Self::Sensor(text(error))
            }
            LabError::Filter(_) => Self::Filter(text(error)),
            _ => Self::Other(text(error)),
        }
    }
}

impl From<locsim_dataset::DatasetError> for Error {
    fn from(error: locsim_dataset::DatasetError) -> Self {
        Self::Log(text(error))
    }
}

impl From<locsim_sensor::SensorError> for Error {
    fn from(error: locsim_sensor::SensorError) -> Self {
        Self::Sensor(text(error))
    }
}

impl From<locsim_mcl::FilterError> for Error {
    fn from(error: locsim_mcl::FilterError) -> Self {
        Self::Filter(text(error))
    }
}

impl From<locsim_core::LaserError> for Error {
    fn from(error: locsim_core::LaserError) -> Self {
        refused(text(error))
    }
}

impl From<locsim_world::map::MapError> for Error {
    fn from(error: locsim_world::map::MapError) -> Self {
        Self::Other(text(error))
    }
}

impl From<locsim_report::ReportError> for Error {
    fn from(error: locsim_report::ReportError) -> Self {
        Self::Other(text(error))
    }
}

impl From<distreg::Error> for Error {
    fn from(error: distreg::Error) -> Self {
        Self::Other(text(error))
    }
}

impl From<serde_json::Error> for Error {
    fn from(error: serde_json::Error) -> Self {
        Self::Other(text(error))
    }
}
