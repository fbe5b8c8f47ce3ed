use std::path::PathBuf;

use locsim_core::limits::{Limits, RANGE_M, number, quoted};
use thiserror::Error;

use super::{COARSEST_M, FARTHEST_M, FINEST_M};

/// Why a map is refused.
#[derive(Debug, Error)]
pub enum MapError {
    /// A closed polyline needs three points.
    #[error("`{}` has {points} points; a closed polyline needs at least 3", quoted(polyline))]
    TooFewPoints {
        /// Name of the polyline.
        polyline: String,
        /// How many points it has.
        points: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("point {point} of `{}` is not finite: {}", quoted(polyline), point_of(value))]
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
        "point {point} of `{}` is not allowed: {}; coordinates are metres, at most {FARTHEST_M} either way",
        quoted(polyline),
        point_of(value)
    )]
    TooFar {
        /// Name of the polyline or wall.
        polyline: String,
        /// Index of the point.
        point: usize,
        /// Its coordinates.
        value: [f64; 2],
    },
    /// A wall is so far from the floor that no laser on it can see it.
    #[error(
        "point {point} of `{}` is not allowed: {}; at most {RANGE_M} m beyond the outline, as no laser reaches farther",
        quoted(wall),
        point_of(value)
    )]
    OutOfReach {
        /// Name of the wall.
        wall: String,
        /// Index of the point.
        point: usize,
        /// Its coordinates.
        value: [f64; 2],
    },
    /// An outline has nothing inside.
    #[error("`{}` has no area: its points lie on one line", quoted(polyline))]
    NoArea {
        /// Name of the polyline.
        polyline: String,
    },
    /// Two edges of an outline cross each other.
    #[error("edges {} and {} of `{}` cross each other; an outline has one inside", edges[0], edges[1], quoted(polyline))]
    Crosses {
        /// Name of the polyline.
        polyline: String,
        /// Indices of the edges.
        edges: [usize; 2],
    },
    /// Two neighbouring points coincide; the last point of a polyline neighbours the first.
    #[error(
        "points {point} and {next} of `{}` coincide; edges need a length, and polylines close themselves",
        quoted(polyline)
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
    #[error("`{key}` of `{}`: {} is not allowed; {allowed}", quoted(wall), number(*value))]
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
    #[error("the name `{}` is given twice, the second time in `{}`", quoted(name), quoted(polyline))]
    DuplicateName {
        /// The name.
        name: String,
        /// Polyline or wall where it occurs again.
        polyline: String,
    },
    /// A surface names an edge that its polyline doesn't have.
    #[error(
        "surface `{}` names edge {edge} of `{}`, which has edges 0 to {last}",
        quoted(name),
        quoted(polyline)
    )]
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
    #[error(
        "edge {edge} of `{}` is named twice: `{}` and `{}`",
        quoted(polyline),
        quoted(first),
        quoted(second)
    )]
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
    #[error(
        "thresholds must satisfy 0 <= free_thresh < occupied_thresh <= 1; got {} and {}",
        number(*free), number(*occupied)
    )]
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
        "a grid of {} x {} cells is empty or too large: are the map's units metres? (at most {} cells; \
         `--limit grid_cells=N` raises it)", number(*width), number(*height), Limits::current().grid_cells
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
    #[error("map image {}: {refusal}", quoted(&path.to_string_lossy()))]
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
    #[error("map image {}: {}", quoted(&path.to_string_lossy()), of_image(source))]
    Image {
        /// The image's path.
        path: PathBuf,
        /// The decoder's error.
        source: image::ImageError,
    },
}

/// What is wrong with an image. The decoder says it in its own words, and not what is allowed.
fn of_image(error: &image::ImageError) -> String {
    match error {
        image::ImageError::IoError(error) => error.to_string(),
        error => {
            let reason = error.to_string();
            format!(
                "it can't be decoded ({}); a whole image in PNG or PGM is needed",
                quoted(reason.trim_end_matches('.'))
            )
        }
    }
}

/// A point as an error quotes it.
fn point_of([x, y]: &[f64; 2]) -> String {
    format!("[{}, {}]", number(*x), number(*y))
}
