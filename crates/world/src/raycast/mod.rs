//! Ray casts into a map: exact, and from a table.

mod batch;
mod exact;
mod segment;

pub use exact::{ExactRangeMap, RayHit};
