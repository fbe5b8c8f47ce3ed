//! Scenarios: YAML files that say what an experiment is. [`Scenario::load`] reads and checks one; nothing runs
//! before every check has passed.

mod error;
mod validated;

pub use error::{Problem, ScenarioError};
pub use validated::*;
