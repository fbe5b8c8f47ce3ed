//! ROS 2 bags: laser scans, odometry and reference poses.
//!
//! Messages are in CDR, in one file or in several of a folder, MCAP or `SQLite`, as rosbag2 writes them.

mod bag;
mod cloud;
mod contents;
mod messages;
mod motion;
mod poses;
mod read;
mod remarks;
mod rewrite;
mod scans;
mod stamped;
mod topics;
mod write;

use std::path::Path;

use locsim_core::limits::Limits;
use locsim_core::{Drive, Pose2};
use serde::Serialize;

use crate::{DatasetError, LogSummary};

pub use bag::{folder_files, is_recording};
pub use contents::contents;
pub use read::read;
pub use rewrite::{BagCopy, DriveEdit, OdometryEdit};
pub use write::{encode_mcap, write_mcap};

/// Topics of a bag. Odometry and reference may also be transforms of `/tf`, written `parent:child`,
/// such as `map:base_link`, or `/tf:parent.child` as evo does. Topics of a default name are also taken from the namespace
/// of the scans, or from the only one that has them, such as `/robot1/tf`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BagTopics {
    /// Laser scans, `sensor_msgs/msg/LaserScan`; `MultiEchoLaserScan`, of which the first echoes are taken; `PointCloud2`
    /// of a 2D lidar. `None`: `/scan`, the only topic of scans, or the only topic of clouds.
    pub scan: Option<String>,
    /// Odometry, `nav_msgs/msg/Odometry`. `None`: `/odom` or `/odometry/filtered`, the only topic of that type beside the
    /// reference, or, where there is none, the transform from `base_link` or `base_footprint` to `odom`.
    pub odometry: Option<String>,
    /// Reference poses, `nav_msgs/msg/Odometry`, or `PoseStamped`, `PoseWithCovarianceStamped` or `TransformStamped` of
    /// `geometry_msgs`. `None`: `/reference`, `/ground_truth`, `/base_pose_ground_truth` or `/ground_truth/state`; where none is
    /// there, what a localizer found: the transform from the base to `map`, or `/amcl_pose`.
    pub reference: Option<String>,
}

/// How to read a bag.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BagOptions {
    /// The topics.
    pub topics: BagTopics,
    /// Reads the scans alone; their odometry is then the origin.
    pub without_odometry: bool,
    /// Where the laser is mounted. `None`: as `/tf_static` says, or transforms of `/tf` that don't change; the base's
    /// origin where they say nothing.
    pub base_from_laser: Option<Pose2>,
    /// Readings of this range (m) or more mean "no return". `None`: the scans' `range_max`.
    pub max_range_m: Option<f32>,
    /// Readings below this range (m) are unusable. `None`: the scans' `range_min`.
    pub min_range_m: Option<f32>,
}

/// Reads a ROS 2 bag: the scans of one laser with odometry and, where there is a topic of them, reference poses.
///
/// - **Files**: one of MCAP or `SQLite` (`.db3`), or a folder of them, read in the order of their numbers. Files and
///   messages may be compressed with zstd, files with gzip, chunks of MCAP with lz4 or zstd. Message types are known by
///   their names, so that files without definitions are read.
/// - **Topics** are those of [`BagOptions::topics`].
/// - **Times** are those of the messages' headers. A topic's messages may be out of order by up to a second and are
///   then sorted.
/// - **Odometry and reference** of a scan are interpolated at its stamp between the messages before and after it, the
///   position linearly, the heading along the shorter arc, both in the plane. Where several messages have a scan's
///   very time, the first scan of that time takes the first, the second the second. Scans outside the span of the
///   odometry are left out and counted; those outside the span of the reference have none. Transforms are interpolated
///   one by one, then multiplied. Between poses with covariance, which a localizer publishes only now and then, the
///   reference follows the odometry: the transform from the odometry's frame to the map's is interpolated.
/// - **Readings**: infinity and `range_max` or more are no return; NaN and less than `range_min` are unusable. Exactly 0
///   is no return in a log that has no other reading without return, as its driver knows no other way to say so;
///   otherwise it is unusable.
/// - **Scans without readings**, which some drivers publish as they start, are left out and counted.
/// - **Clouds** become scans of the beams that the log has points on. A beam without a point is unusable: clouds don't
///   tell whether it had no return. The maximum range is just above the longest reading where none is given.
/// - **Beams** are at `angle_min + i angle_increment` and i times the mean of the scans' `time_increment`.
/// - **Mount** of the laser: the chain of `/tf_static`, and of transforms of `/tf` that never change, from the scans'
///   `frame_id` up to the odometry's `child_frame_id`, `base_link` or `base_footprint`, the first of them that it has. A
///   laser mounted upside down has its bearings mirrored.
///
/// # Errors
/// A file can't be read, is cut off or damaged, or costs more than the [`Limits`] allow; a topic is missing or one of
/// several would have to be chosen; a message can't be decoded or has values that aren't allowed; the laser changes or scans out of the
/// plane; no scan has odometry.
pub fn read_bag(path: &Path, options: &BagOptions) -> Result<(Drive, LogSummary), DatasetError> {
    read(path, options, Limits::current())
}

#[cfg(test)]
pub mod tests;
