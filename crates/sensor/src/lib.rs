//! Sensor models p(z | beam) of a planar range sensor, learnt from data.
//!
//! [`fit`] makes a [`FittedModel`] of any [`ModelKind`] from a [`TrainingSet`]; [`FittedModel::into_model`]
//! turns it into a [`locsim_core::SensorModel`], which scores and samples. [`Oracle`] knows the simulated
//! world instead of learning it. [`Tempered`] makes any of them fit for a filter, with constants from
//! [`choose_tempering`], and [`Prepared`] fast; [`evaluate`] scores them on readings they haven't seen.
//!
//! Every model has the same reference measure: a density per metre on \[0, maximum range) and a point mass at
//! the maximum range, which means "no return". The models know a beam by its nominal range r and incidence
//! angle alpha (the likelihood field: by where it ends). A beam along which the map has nothing within reach,
//! r = maximum range, is a case of its own in all of them.
//!
//! Sources: Tallavajhula, Poczos and Kelly, "Nonparametric Distribution Regression Applied to Sensor
//! Modeling", IROS 2016 ("the paper"); Thrun, Burgard and Fox, "Probabilistic Robotics", MIT Press 2005,
//! chapter 6.

mod amcl;
mod axis;
mod beam;
mod binned;
mod error;
mod evaluate;
mod field;
mod file;
mod fitted;
mod histogram;
mod mixture;
mod normal;
mod np_reg;
mod np_reg_field;
mod oracle;
mod p_reg;
mod prepared;
mod state_grid;
mod tempered;
mod total;
mod training;

#[cfg(test)]
mod tests;

pub use amcl::{Amcl, AmclKind, AmclParameters};
pub use error::SensorError;
pub use evaluate::{Evaluation, evaluate};
pub use fitted::{FitOptions, FittedModel, ModelKind, fit};
pub use oracle::Oracle;
pub use prepared::Prepared;
pub use tempered::{CalibrationScan, Tempered, Tempering, TemperingGrid, choose_tempering};
pub use training::{BeamState, TrainingSet};
