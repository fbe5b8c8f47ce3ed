use std::path::PathBuf;

use locsim_core::limits::Limits;
use thiserror::Error;

use super::{COARSEST_M, FARTHEST_M, FINEST_M};

/// Why a map is refused.
#[derive(Debug, Error)]
pub enum MapError {
    /// A closed polyline needs three points.
    #[error("`{polyline}` has {points} points; a closed polyline needs at least 3")]
    TooFewPoints {
        /// Name of the polyline.
        polyline: String,
        /// How many points it has.
        points: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("point {point} of `{polyline}` is not finite: [{}, {}]", .value[0], .value[1])]
    NotFinite {
        /// Name of the polyline or wall.
        polyline: String,
        /// Index of the point.
        point: usize,
        /// Its coordinates.
        value: [f64; 2],
    },
    /// A coordinate is far beyond any building.
    #[error(
        "point {point} of `{polyline}` is not allowed: [{}, {}]; coordinates are metres, at most {FARTHEST_M} either way",
        .value[0], .value[1]
    )]
    TooFar {
        /// Name of the polyline or wall.
        polyline: String,
        /// Index of the point.
        point: usize,
        /// Its coordinates.
        value: [f64; 2],
    },
    /// Two neighbouring points coincide; the last point of a polyline neighbours the first.
    #[error(
        "points {point} and {next} of `{polyline}` coincide; edges need a length, and polylines close themselves"
    )]
    ZeroLengthEdge {
        /// Name of the polyline or wall.
        polyline: String,
        /// Index of the edge's first point.
        point: usize,
        /// Index of the edge's second point.
        next: usize,
    },
    /// A number of a measured wall is out of range.
    #[error("`{key}` of `{wall}`: {value} is not allowed; {allowed}")]
    Wall {
        /// Name of the wall.
        wall: String,
        /// The number's key.
        key: &'static str,
        /// The number.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A name stands for two things.
    #[error("the name `{name}` is given twice, the second time in `{polyline}`")]
    DuplicateName {
        /// The name.
        name: String,
        /// Polyline or wall where it occurs again.
        polyline: String,
    },
    /// A surface names an edge that its polyline doesn't have.
    #[error("surface `{name}` names edge {edge} of `{polyline}`, which has edges 0 to {last}")]
    NoSuchEdge {
        /// Name of the polyline.
        polyline: String,
        /// Name of the surface.
        name: String,
        /// The edge's index.
        edge: usize,
        /// The greatest index.
        last: usize,
    },
    /// An edge belongs to two surfaces.
    #[error("edge {edge} of `{polyline}` is named twice: `{first}` and `{second}`")]
    EdgeNamedTwice {
        /// Name of the polyline.
        polyline: String,
        /// The edge's index.
        edge: usize,
        /// Its first name.
        first: String,
        /// Its second name.
        second: String,
    },
    /// The cells of a grid are finer than any sensor resolves, larger than a building, or their size is no number.
    #[error("a cell size of {0:?} m is not allowed; {FINEST_M} to {COARSEST_M} m")]
    Resolution(f64),
    /// The origin of a grid is not finite, its yaw is more than a turn, or part of the grid is far beyond any building.
    #[error(
        "origin must be [x, y, yaw], with the yaw in radians, up to a turn, and all of the map within {FARTHEST_M} m of 0; \
         got [{:?}, {:?}, {:?}]", .0[0], .0[1], .0[2]
    )]
    Origin([f64; 3]),
    /// The thresholds of a grid are out of order.
    #[error("thresholds must satisfy 0 <= free_thresh < occupied_thresh <= 1; got {free} and {occupied}")]
    Thresholds {
        /// `free_thresh`.
        free: f64,
        /// `occupied_thresh`.
        occupied: f64,
    },
    /// The number of cells given is not the number of cells of the grid.
    #[error("a grid of {width} x {height} cells cannot be made from {cells} cells")]
    GridSize {
        /// Cells along x.
        width: usize,
        /// Cells along y.
        height: usize,
        /// Cells given.
        cells: usize,
    },
    /// The grid would have no cells, or more than are allowed.
    #[error(
        "a grid of {width} x {height} cells is empty or too large: are the map's units metres? (at most {} cells; \
         `--limit grid_cells=N` raises it)", Limits::current().grid_cells
    )]
    Extent {
        /// Cells along x.
        width: f64,
        /// Cells along y.
        height: f64,
    },
    /// No step of a drive has a reference pose, so there is nothing to make a map from.
    #[error(
        "none of the {steps} steps has a reference pose and a return near enough for a map: are ranges in metres?"
    )]
    NoReference {
        /// How many steps were asked for.
        steps: usize,
    },
    /// The image of a grid has more pixels than are allowed.
    #[error("map image {}: {refusal}", .path.display())]
    ImageSize {
        /// The image's path.
        path: PathBuf,
        /// The allowed values.
        refusal: String,
    },
    /// There is more of something than is allowed.
    #[error("{0}")]
    TooMany(String),
    /// The image of a grid cannot be read or written.
    #[error("map image {}: {source}", .path.display())]
    Image {
        /// The image's path.
        path: PathBuf,
        /// The decoder's error.
        source: image::ImageError,
    },
}
