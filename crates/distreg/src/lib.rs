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
//! | what can be observed | [`Outcomes`]: a [`Grid`] and a point mass such as the maximum range |
//! | methods | [`NpRegOptions`], [`PRegOptions`], [`FrechetOptions`], each a [`Regressor`] |
//! | weights over states | [`Weighting`]: a [`Kernel`] or nearest neighbours; [`Degree`]: mean or plane |
//! | predictions | [`ConditionalDistribution`]: a [`Distribution`] and whether the query is in the data ([`Support`]) |
//! | quality | [`Loss`], [`losses`], [`risk`] |
//! | settings | [`cross_validate`] with [`grid_search`] or [`optimize`] |
//! | speed | [`ConditionalDistribution::predict_batch`]; [`Table`] for single densities |
//!
//! # A new sensor
//!
//! An ultrasonic ranger reads 0 to 3 m in steps of 1 cm, and 3 m where the echo is lost. Its state is the true
//! distance and the angle to the surface. Learn it from recorded readings, choose the bandwidths by
//! cross-validation, and ask for the probability of a reading at a state that was never measured:
//!
//! ```
//! use distreg::{Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, Error, Kernel, Loss};
//! use distreg::{NpRegOptions, Outcomes, Regressor, Support, Weighting, cross_validate, grid_search, product};
//!
//! # fn readings(i: u32) -> (f64, f64, [f64; 4]) {
//! #     let (distance, angle) = (0.5 + 0.02 * f64::from(i), 0.01 * f64::from(i * 37 % 100));
//! #     let near = (distance * 100.0).round() / 100.0;
//! #     (distance, angle, [near, near + 0.01, near - 0.01, if angle > 0.7 { 3.0 } else { near }])
//! # }
//! let mut data = Dataset::new(2);
//! for i in 0..100 {
//!     let (distance, angle, z) = readings(i);
//!     data.push(&[distance, angle], &z)?;
//! }
//! let outcomes = Outcomes::of_values(0.0, 3.0, 0.01)?.with_point_mass(3.0);
//! let method = |bandwidths: &[f64]| NpRegOptions {
//!     outcomes,
//!     alignment: Alignment::Shift { state_dim: 0 },
//!     density: DensityEstimate::Histogram,
//!     weighting: Weighting::kernel(Kernel::Gaussian, bandwidths),
//!     degree: Degree::Constant,
//! };
//! let best = grid_search(&product(&[&[0.1, 0.5, 1.0], &[0.05, 0.2, 0.5]]), |bandwidths| {
//!     cross_validate(&method(bandwidths), &data, 5, 1, Loss::HistogramMatch)
//! })?;
//! let sensor = method(&best.candidate).fit(&data)?;
//!
//! let (distribution, support) = sensor.predict(&[1.234, 0.3])?;
//! assert_eq!(support, Support::InData);
//! assert!(distribution.density(1.23) > 10.0); // per metre
//! assert!(distribution.density(3.0) < 0.1); // the probability of a lost echo
//! # Ok::<(), Error>(())
//! ```

mod alignment;
pub mod benchmark;
mod dataset;
mod density;
mod distribution;
mod error;
mod family;
mod frechet;
mod kernel;
mod local_regression;
mod loss;
mod np_reg;
mod p_reg;
mod point_share;
mod regressor;
mod search;
mod smoother;
mod table;
mod thin;

pub use alignment::Alignment;
pub use dataset::Dataset;
pub use density::{DensityEstimate, histogram, kernel_density};
pub use distribution::{Distribution, Grid, Outcomes, PointMass};
pub use error::Error;
pub use family::{Family, Parameters, Second, gaussian_parameters};
pub use frechet::{Frechet, FrechetOptions};
pub use kernel::Kernel;
pub use local_regression::LocalRegression;
pub use loss::{Loss, Risk, crps, euclidean, histogram_match, log_loss, losses, risk, wasserstein_1};
pub use np_reg::{NpReg, NpRegOptions};
pub use p_reg::{PReg, PRegOptions};
pub use regressor::{ConditionalDistribution, Predictions, Regressor, Scratch};
pub use search::{Found, cross_validate, grid_search, optimize, product};
pub use smoother::{Degree, FALLBACK_NEIGHBOURS, Smoother, Support, Weighting};
pub use table::{Axis, Table};
pub use thin::{Selection, condense, select};
