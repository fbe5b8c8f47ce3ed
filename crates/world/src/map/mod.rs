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
//! # Measured maps
//! A [`MeasuredMap`] is made from scans (see the crate `locsim-mapping`): walls that face one way, and the area that was seen.
//! ```yaml
//! seen:                            # closed polylines; the first around what was seen, the others around holes in it
//!   - [[0, 0], [20, 0], [20, 4], [0, 4]]
//! walls:
//!   - {from_m: [19.9, 0.1], to_m: [0.1, 0.1], sigma_m: 0.002, hits: 5210, hit_share: 0.99}
//! ```
//! A ray that leaves what was seen meets the surface `unknown`, see [`Geometry::is_unknown`].
//!
//! Each kind becomes a [`Geometry`].

mod error;
mod frame;
mod geometry;
mod grid;
mod measured;
mod outline;
mod polygons;
mod ros;
mod vector;

/// Coordinates of a map are at most so far from 0 \[m\]; northings of a national grid are nearer.
pub const FARTHEST_M: f64 = 1e7;

/// Cells of a grid are at least this wide \[m\].
pub const FINEST_M: f64 = 1e-4;

/// Cells of a grid are at most this wide \[m\].
pub const COARSEST_M: f64 = 1000.0;

/// Points that are nearer to each other than this \[m\] coincide.
const COINCIDENT_M: f64 = 1e-6;

pub use error::MapError;
pub use frame::CellFrame;
pub use geometry::Geometry;
pub use grid::{Cell, ImageFormat, OccupancyGrid};
pub use measured::{MeasuredMap, MeasuredWall};
pub use ros::{ImageMode, OccupancyMapFile};
use vector::finite_points;
pub use vector::{NamedEdges, Polyline, VectorMap, Wall};
