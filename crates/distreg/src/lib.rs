//! Distribution regression: learn the whole distribution p(z | x) of a one-dimensional observation z given a
//! state x of any dimension from samples, not only its mean.
//!
//! The procedures are those of Tallavajhula, Poczos and Kelly, "Nonparametric Distribution Regression Applied
//! to Sensor Modeling", IROS 2016. Equation numbers in this crate are that paper's. Beyond it, [`Alignment`] smooths
//! an observation that follows a state coordinate relative to it, so that it isn't blurred.
//!
//! | step | what there is |
//! | --- | --- |
//! | data | [`Dataset`]: states with one or more observations; [`select`] and [`condense`] thin it |
//! | outcomes | [`Outcomes`]: a [`Grid`] and a point mass such as the maximum range |
//! | methods | [`NpRegOptions`], [`PRegOptions`], [`FrechetOptions`], [`StandardizedOptions`], each a [`Regressor`] |
//! | weights over states | [`Weighting`]: a [`Kernel`] or nearest neighbours; [`Degree`]: mean or plane |
//! | predictions | [`ConditionalDistribution`]: a [`Distribution`] and whether the query is in the data ([`Support`]) |
//! | quality | [`Loss`], [`losses`], [`risk`] |
//! | settings | [`cross_validate`] with [`grid_search`] or [`optimize`] |
//! | curves of residuals | [`curve`]: what a moment of PITs depends on, level by level; [`wave`]: whether that is a wave |
//! | series | [`lasting`]: whether errors that last have a mean or a slope |
//! | precision | [`matrix`]: the covariance of estimates from their information; [`newton`]: steps to the maximum of a likelihood |
//! | speed | [`ConditionalDistribution::predict_batch`]; [`Table`] for single densities |
//!
//! `docs/sensor-in-20-lines.md` shows the whole way for a new sensor. In short:
//!
//! ```
//! use distreg::{Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, Kernel};
//! use distreg::{NpRegOptions, Outcomes, Regressor, Support, Weighting};
//!
//! // Ranges \[m\] read at two distances \[m\]; 3 m where there was no echo.
//! let mut data = Dataset::new(1);
//! data.push(&[1.0], &[0.99, 1.0, 1.01, 3.0])?;
//! data.push(&[1.5], &[1.48, 1.5, 1.52, 3.0])?;
//! let method = NpRegOptions {
//!     outcomes: Outcomes::of_values(0.0, 3.0, 0.01)?.with_point_mass(3.0),
//!     alignment: Alignment::Shift { state_dim: 0 },
//!     density: DensityEstimate::Histogram,
//!     weighting: Weighting::kernel(Kernel::Gaussian, &[0.5]),
//!     degree: Degree::Constant,
//! };
//! let (distribution, support) = method.fit(&data)?.predict(&[1.25])?;
//! assert_eq!(support, Support::InData);
//! assert!((distribution.density(3.0) - 0.25).abs() < 1e-12); // the probability of no echo
//! assert!((distribution.quantile(0.375) - 1.25).abs() < 0.02);
//! # Ok::<(), distreg::Error>(())
//! ```

/// The page that shows the crate, compiled.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/sensor-in-20-lines.md")]
struct SensorIn20Lines;

mod alignment;
pub mod contamination;
mod correlation;
pub mod curve;
mod dataset;
mod density;
mod distribution;
mod error;
pub mod explained;
mod false_discovery;
mod family;
mod floor;
mod frechet;
mod kernel;
pub mod lasting;
mod local_regression;
mod loss;
pub mod matrix;
mod max_t;
pub mod moments;
pub mod newton;
mod np_reg;
pub mod others;
mod p_reg;
mod point_share;
pub mod random_effects;
mod regressor;
pub mod sandwich;
mod search;
pub mod sequential;
mod smoother;
mod standardized;
pub mod steps;
mod table;
pub mod tail;
mod thin;
pub mod wave;

pub use alignment::Alignment;
pub use correlation::Correlation;
pub use dataset::Dataset;
pub use density::{DensityEstimate, histogram, kernel_density};
pub use distribution::{Distribution, Grid, Outcomes, PointMass};
pub use error::Error;
pub use false_discovery::false_discovery_rates;
pub use family::{Family, Parameters, Second, gaussian_parameters};
pub use floor::Floor;
pub use frechet::{Frechet, FrechetOptions};
pub use kernel::Kernel;
pub use local_regression::LocalRegression;
pub use loss::{
    Loss, Risk, crps, empirical_wasserstein_1, euclidean, histogram_match, log_loss, losses, risk,
    wasserstein_1,
};
pub use max_t::MaxT;
pub use np_reg::{NpReg, NpRegOptions};
pub use p_reg::{PReg, PRegOptions};
pub use regressor::{ConditionalDistribution, Predictions, Regressor, Scratch};
pub use search::{Found, cross_validate, grid_search, optimize, product};
pub use smoother::{Degree, FALLBACK_NEIGHBOURS, Smoother, Support, Weighting};
pub use standardized::{Standardized, StandardizedOptions};
pub use table::{Axis, Table};
pub use thin::{Selection, condense, select};
