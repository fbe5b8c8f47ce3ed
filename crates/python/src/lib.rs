//! The extension module `_locsim` that the Python package `locsim` is made of: arrays, Arrow tables, exceptions and interruption
//! around the crates. `python/locsim/_locsim.pyi` has the signatures and the documentation that users read.

#![allow(clippy::needless_pass_by_value, reason = "Python's arguments are handed over by value")]
#![allow(
    clippy::doc_markdown,
    rustdoc::broken_intra_doc_links,
    reason = "docstrings of Python, where [m] is a unit"
)]

mod array;
mod error;
mod filter;
mod gap;
mod log;
mod map;
mod regression;
mod run;
mod scenario;
mod sensor;
mod table;
mod work;

use pyo3::prelude::pymodule;

/// The compiled part of locsim.
#[pymodule]
mod _locsim {
    use std::ffi::OsString;

    use pyo3::prelude::{Python, pyfunction};

    #[pymodule_export]
    use crate::error::{FilterError, LocsimError, LogError, ScenarioError, SensorError};
    #[pymodule_export]
    use crate::filter::{Annealing, Estimate, Filter, KldSampling, Update};
    #[pymodule_export]
    use crate::gap::{Answer, gap};
    #[pymodule_export]
    use crate::log::{Log, read_log, simulate};
    #[pymodule_export]
    use crate::map::{Beams, Map};
    #[pymodule_export]
    use crate::regression::{Prediction, Regression, fit, risk};
    #[pymodule_export]
    use crate::run::{Run, run};
    #[pymodule_export]
    use crate::scenario::Scenario;
    #[pymodule_export]
    use crate::sensor::SensorModel;
    #[pymodule_export]
    use crate::table::Table;

    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "the name that Python packages have")]
    const __version__: &str = env!("CARGO_PKG_VERSION");

    /// Runs the command line and returns its exit code.
    #[pyfunction]
    fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
        py.detach(|| locsim::run(&arguments))
    }
}
