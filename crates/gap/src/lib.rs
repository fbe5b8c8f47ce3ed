//! Where and why a simulation and a measured log disagree.
//!
//! [`find`] takes a [`Nominal`] simulator and a [`Recorded`] log. It simulates whole logs along the recorded poses, with
//! blocks and errors of the reference fitted to the log, to know what is normal; looks at many statistics at once under
//! one false-alarm rate; fits the effects of [`locsim_world::effect`] by maximum likelihood; names the one that gains
//! most on held-out scans, with those that can't be told from it; adds it, and starts again until nothing is off. The
//! [`Outcome`] says what was found and how sure that is.

mod error;
mod fit;
mod free_model;
mod map_error;
mod null;
mod outcome;
mod profile;
mod rank;
mod regions;
mod search;
mod statistics;
mod strength;

pub use error::GapError;
pub use locsim_comparison::{
    ComparisonError, Guess, Nominal, Nuisances, OBJECT_CELL_M, Views, hidden, values_along,
};
pub use locsim_core::{LEAST_SCANS, PoseError, Purpose, Recorded};
pub use map_error::{LeftOut, MapError, MapErrorKind, MeasuredMapFindings};
pub use outcome::{
    BeamPit, CurvePoint, Detectable, Detection, Direction, Distance, Evidence, FilterError, FilterGap, Gap,
    Named, Number, Outcome, Over, PitHistogram, Profile, ProfileBin, Quantity, Region, ResidualStage, Rival,
    Unnamed, Verdict,
};
pub use search::{GapOptions, find};
pub use statistics::{Cell, Covariate, Deviation, WALL_CELL_M};
pub use strength::{OtherForm, Strength};
