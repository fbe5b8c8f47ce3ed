//! Ray casts into a map, exact and from a table, and distances to its walls.

mod batch;
mod boxes;
mod build;
mod cache;
mod distance;
mod exact;
mod segment;
mod sight;
mod table;
mod unsure;

pub use boxes::Boxes;
pub use distance::DistanceGrid;
pub use exact::{BEHIND_M, ExactRangeMap, RayHit};
pub use table::{RangeTable, RangeTableOptions, Vicinity};
pub use unsure::{Unsure, unsure};
