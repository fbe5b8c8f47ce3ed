//! Distribution regression: learn the whole distribution p(z | x) of a one-dimensional observation z given a
//! state x of any dimension from samples, not only its mean.
//!
//! The procedures are those of Tallavajhula, Poczos and Kelly, "Nonparametric Distribution Regression Applied
//! to Sensor Modeling", IROS 2016: [`PReg`] regresses the parameters of a Gaussian on the state, [`NpReg`]
//! regresses the density itself. Equation numbers in this crate are that paper's.

mod dataset;
mod density;
mod distribution;
mod error;
mod kernel;
mod linear;
mod loss;
mod np_reg;
mod p_reg;
mod search;
mod smoother;

pub use dataset::Dataset;
pub use density::{histogram, kernel_density};
pub use distribution::{Distribution, Grid, PointMass};
pub use error::Error;
pub use kernel::Kernel;
pub use linear::LocallyWeightedLinear;
pub use loss::{Risk, crps, euclidean, histogram_match, log_loss, risk, wasserstein_1};
pub use np_reg::{Alignment, NpReg, NpRegOptions, Predictions};
pub use p_reg::{PReg, gaussian_parameters};
pub use search::{Found, cross_validate, grid_search, product};
pub use smoother::{FALLBACK_NEIGHBOURS, Smoother, Support};
