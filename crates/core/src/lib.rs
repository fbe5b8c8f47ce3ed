//! The vocabulary of all other crates: poses, frames and tracks, scans and ray-cast hits, particles and their weights,
//! keyed random draws, shares of long work, and the traits between a world, a sensor model and a filter.
//!
//! Conventions (REP-103, REP-105): SI units, radians in (-pi, pi], x forward, y left, counter-clockwise
//! positive; frames `map`, `odom`, `base`, `laser`; a transform named `map_from_base` takes coordinates of
//! `base` to coordinates of `map`.

mod beams;
mod cells;
mod control;
mod deskew;
mod draw;
mod drive;
mod edges;
mod elementary;
mod endpoint;
mod folds;
pub mod input;
mod interval;
mod lanes;
mod likelihood;
pub mod limits;
mod lines;
mod low_discrepancy;
mod model;
pub mod normal;
mod normals;
pub mod output;
mod particles;
mod pose;
mod pose_error;
mod purpose;
mod quantile;
mod recorded;
mod resampled;
mod shard;
mod stretches;
mod survival;
pub mod tilt;
mod track;
mod weights;

pub use beams::{Beams, CAST_REACH, Hits, NO_SURFACE};
pub use cells::{cell_at, cells_between, densest, most_of_four, share_again};
pub use control::{Clock, Control, Progress};
pub use draw::{BATCH, Draw, Stage};
pub use drive::{Drive, DriveStep, FASTEST, Laser, LaserError, Scan};
pub use edges::{even_edges, inner_quantile_edges, quantile_edges};
pub use elementary::{sin_cos, sin_cos_near_zero};
pub use endpoint::{EndpointGrid, EndpointScan, EndpointTable};
pub use folds::{Folds, differences, gains_beyond, gains_surely, simplest, sum_error};
pub use interval::{Estimate, Interval, are_alike, surely_largest};
pub use likelihood::{
    BEAMS_PER_RUN, BeamRun, INCIDENCE_KNOTS, LikelihoodGrid, LikelihoodScale, LikelihoodTable, PreparedScan,
    turn,
};
pub use lines::{Line, SlantedStretch, distance_to, is_along_wall, is_of_wall, lines_through};
pub use low_discrepancy::low_discrepancy;
pub use model::{DependsOn, DistanceMap, ModelTable, Obstructions, RangeMap, SensorModel, Survival};
pub use particles::{Particles, Poses};
pub use pose::{Pose2, circular_mean, increments, sector_holds_middle, wrap_angle};
pub use pose_error::{
    PoseError, PoseInformation, SmoothedPoseErrors, TurnedFrame, are_errors, fit_pose_error, longest_lasting,
    most_change, no_larger_than_told, pattern_score, smooth_pose_errors, without_patterns,
};
pub use purpose::Purpose;
pub use quantile::{equal_bins, median, quantile, sorted};
pub use recorded::{LEAST_SCANS, PoseJitter, Recorded, RecordedError};
pub use resampled::resampled;
pub use shard::Shard;
pub use stretches::{Stretch, Stretches};
pub use survival::survival_of;
pub use track::{Track, TrackError};
pub use weights::{WeightError, Weights};
