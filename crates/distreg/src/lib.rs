//! Distribution regression: learn the whole distribution p(z | x) of a one-dimensional observation z given a
//! state x of any dimension from samples, not only its mean.
//!
//! The procedures are those of Tallavajhula, Poczos and Kelly, "Nonparametric Distribution Regression Applied
//! to Sensor Modeling", IROS 2016: [`PReg`] regresses the parameters of a Gaussian on the state, [`NpReg`]
//! regresses the density itself. Equation numbers in this crate are that paper's. [`Alignment`] goes beyond it: an
//! observation that follows a state coordinate is smoothed relative to it, and isn't blurred by smoothing.
//!
//! # A new sensor
//!
//! An ultrasonic ranger reads 0 to 3 m in steps of 1 cm, and 3 m where the echo is lost. Its state is the true
//! distance and the angle to the surface. Learn it from recorded readings, choose the bandwidths by
//! cross-validation, and ask for the probability of a reading at a state that was never measured:
//!
//! ```
//! use distreg::{Alignment, Dataset, Error, Grid, Kernel, NpReg, NpRegOptions, Support};
//! use distreg::{cross_validate, grid_search, histogram, histogram_match, product};
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
//! let grid = Grid::of_values(0.0, 3.0, 0.01)?;
//! let options = |bandwidths: &[f64]| NpRegOptions {
//!     grid,
//!     point_mass_at: Some(3.0),
//!     alignment: Alignment::Shift { state_dim: 0 },
//!     observation_bandwidth: 0.0,
//!     kernel: Kernel::Gaussian,
//!     bandwidths: bandwidths.to_vec(),
//! };
//! let best = grid_search(&product(&[&[0.1, 0.5, 1.0], &[0.05, 0.2, 0.5]]), |bandwidths| {
//!     cross_validate(&data, 5, 1, |train, held_out| {
//!         let predicted = NpReg::fit(train, options(bandwidths))?.predict_batch(held_out.states())?;
//!         let loss = |i| {
//!             let observed = histogram(held_out.observations(i), grid, Some(3.0))?;
//!             histogram_match(&predicted.distribution(i), &observed)
//!         };
//!         Ok((0..held_out.len()).map(loss).sum::<Result<f64, Error>>()? / held_out.len() as f64)
//!     })
//! })?;
//! let sensor = NpReg::fit(&data, options(&best.candidate))?;
//!
//! let (distribution, support) = sensor.predict(&[1.234, 0.3])?;
//! assert_eq!(support, Support::InData);
//! assert!(distribution.density(1.23) > 10.0); // per metre
//! assert!(distribution.density(3.0) < 0.1); // the probability of a lost echo
//! # Ok::<(), Error>(())
//! ```

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
