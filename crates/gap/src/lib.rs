//! Where and why a simulation and a measured log disagree.
//!
//! [`find`] takes a [`Nominal`] simulator and a [`Recorded`] log. It simulates whole logs along the recorded poses, with
//! blocks and errors of the reference fitted to the log, to know what is normal; looks at many statistics at once under
//! one false-alarm rate; fits the effects of [`locsim_world::effect`] by maximum likelihood; names the one that gains
//! most on held-out scans, with those that can't be told from it; adds it, and starts again until nothing is off. The
//! [`Outcome`] says what was found and how sure that is.

mod catalogue;
mod error;
mod fit;
#[cfg(any(test, feature = "testing"))]
pub mod fixtures;
mod free_model;
pub mod hidden;
mod hypothesis;
mod likelihood;
mod map_error;
mod nominal;
mod null;
mod outcome;
mod pose_pattern;
mod profile;
mod rank;
mod regions;
mod replay;
mod search;
mod statistics;
mod strength;
mod views;
mod wall_error;

pub use catalogue::values_along;
pub use error::GapError;
pub use hypothesis::Nuisances;
pub use locsim_core::{LEAST_SCANS, PoseError, Purpose, Recorded};
pub use map_error::{LeftOut, MapError, MapErrorKind, MeasuredMapFindings};
pub use nominal::{Guess, Nominal};
pub use outcome::{
    BeamPit, CurvePoint, Detectable, Detection, Direction, Distance, Evidence, FilterError, FilterGap, Gap,
    Named, Number, Outcome, Over, PitHistogram, Profile, ProfileBin, Quantity, Region, ResidualStage, Rival,
    Unnamed, Verdict,
};
pub use search::{GapOptions, find};
pub use statistics::{Cell, Covariate, Deviation, OBJECT_CELL_M, WALL_CELL_M};
pub use strength::{OtherForm, Strength};
pub use views::Views;
