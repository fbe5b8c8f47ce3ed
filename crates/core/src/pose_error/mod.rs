//! Errors of the reference poses: a correction for each scan, smooth in time.
//!
//! Beams of one scan share the error of its pose, and neighbouring scans share some of it. The error of x, y (one
//! standard deviation for both) and of the heading is a first-order autoregressive process and white noise, in the map frame: a localizer's
//! estimate drifts, and wheels or a camera add something to each pose.

mod fit;
mod information;
mod pattern;
mod process;
mod smoother;
#[cfg(test)]
mod tests;
mod turned_frame;

pub use fit::{are_errors, fit_pose_error, longest_lasting, no_larger_than_told};
pub use information::PoseInformation;
pub use pattern::{most_change, pattern_score, without_patterns};
pub use process::PoseError;
pub use smoother::{SmoothedPoseErrors, smooth_pose_errors};
pub use turned_frame::TurnedFrame;
