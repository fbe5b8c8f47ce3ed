//! A measured log compared with a simulator.
//!
//! A [`Comparison`] holds a [`Nominal`] simulator against a recorded log. It gives the log's likelihood under effects of
//! [`locsim_world::effect`]. What a scenario can't know is fitted to the log: the [`Nuisances`], which are the density of blocks, the
//! errors of the reference poses and those of a measured map's walls. A [`Replay`] simulates whole logs along the recorded poses:
//! they tell what is normal. [`hidden`] simulates logs of known truth.

mod catalogue;
mod error;
#[cfg(any(test, feature = "testing"))]
pub mod fixtures;
pub mod hidden;
mod hypothesis;
mod jitter;
mod likelihood;
mod nominal;
mod pose_pattern;
mod replay;
mod views;
mod wall_error;

pub use catalogue::{kinds_shown_by, shown_by, values_along};
pub use error::ComparisonError;
pub use hypothesis::{CORRECTIONS, Comparison, Fitted, Nuisances, Usable};
pub use likelihood::{Density, Terms, near_density, normal_density};
pub use nominal::{BlockPolicy, Guess, Nominal};
pub use pose_pattern::{PosePattern, errors_beyond_patterns};
pub use replay::{BlockTruth, OBJECT_CELL_M, Replay, fit_persistence};
pub use views::{Beam, PieceView, Views, beam_headings, jumps, surface_ranges};
