//! Maps: their file formats, and the wall segments that rays are cast against.
//!
//! # Vector map files
//! A [`VectorMap`] describes a floor by closed polylines, in metres of the map frame:
//! ```yaml
//! outline:                         # the boundary of the floor; free space is inside
//!   points_m: [[0, 0], [20, 0], [20, 4], [0, 4]]   # closes itself: don't repeat the first point
//!   surfaces:                      # optional names; edge i runs from point i to point i + 1
//!     - {name: south, edges: [0]}
//!     - {name: north, edges: [2]}
//! obstacles:                       # optional closed polylines; free space is outside them
//!   - name: pillar                 # optional; `obstacle-0`, `obstacle-1`, .. otherwise
//!     points_m: [[5, 1], [5.4, 1], [5.4, 1.4], [5, 1.4]]
//! walls:                           # optional thin walls
//!   - {name: screen, from_m: [12, 0], to_m: [12, 1.5]}
//! ```
//! Each name is one surface; an edge without a name is a surface called after its polyline and its index, for
//! example `outline/1`.
//!
//! # Occupancy grid maps
//! An [`OccupancyMapFile`] is the yaml file of ROS `map_server`; it loads an [`OccupancyGrid`] from its image.
//!
//! Either kind becomes a [`Geometry`].

mod error;
mod frame;
mod geometry;
mod grid;
mod outline;
mod ros;
mod vector;

/// Coordinates of a map are at most so far from 0 \[m\]; northings of a national grid are nearer.
pub const FARTHEST_M: f64 = 1e7;

/// Cells of a grid are at least this wide \[m\].
pub const FINEST_M: f64 = 1e-4;

/// Points that are nearer to each other than this \[m\] coincide.
const COINCIDENT_M: f64 = 1e-6;

pub use error::MapError;
pub(crate) use frame::CellFrame;
pub use geometry::Geometry;
pub use grid::{Cell, ImageFormat, OccupancyGrid};
pub use ros::{ImageMode, OccupancyMapFile};
pub use vector::{NamedEdges, Polyline, VectorMap, Wall};
