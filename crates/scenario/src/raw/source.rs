use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::default;

/// How the filter computes nominal ranges and log densities.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawRayCast {
    /// From precomputed tables of map and sensor model, or exactly each time.
    #[serde(default)]
    pub method: RayCastMethod,
    /// Side of a cell of the map's table (m), 0.001 to 10; larger where it would not fit. Only with `table`. Default:
    /// 0.1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("default" = default::CELL_M))]
    pub cell_m: Option<f64>,
    /// The map's table may be this large (MB), 16 to 65536. Only with `table`. Default: 512.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("default" = default::MEMORY_MB))]
    pub memory_mb: Option<u64>,
}

/// Where nominal ranges and log densities come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RayCastMethod {
    /// From a table over (cell, heading) and one over (reading, nominal range, incidence).
    #[default]
    Table,
    /// By an exact cast and the model itself each time; slower.
    Exact,
}

/// Unmapped rectangular blocks along the walls. Each pair `[lo, hi]` is the interval of a uniform distribution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawBlocks {
    /// Blocks per metre of wall face (1/m), 0 to 100; a thin wall has two faces. The number that is drawn is Poisson-distributed. Blocks may overlap each other, and stick into other walls.
    pub per_metre_of_wall: f64,
    /// Length of a block along the wall, before it is turned (m), 0.001 to 10000.
    pub length_m: [f64; 2],
    /// Width of a block (m), 0.001 to 10000.
    pub width_m: [f64; 2],
    /// Yaw relative to the wall (deg), -180 to 180.
    #[serde(default)]
    pub yaw_deg: [f64; 2],
    /// Gap between the wall and the block's nearest corner, after it is turned (m), 0 to 10000.
    #[serde(default)]
    pub wall_distance_m: [f64; 2],
    /// When blocks take new places.
    #[serde(default)]
    pub resample: RawBlockResampling,
    /// Speed along the wall, either way (m/s), 0 to 1000; only with `never` or `each_scan_n`.
    #[serde(default)]
    pub speed_m_s: [f64; 2],
    /// A block that is closer than this to the robot's centre is left out (m), 0 to 10000.
    #[serde(default = "default::clearance_m")]
    pub clearance_m: f64,
}

/// When blocks take new places.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RawBlockResampling {
    /// At every scan.
    #[default]
    EachObservation,
    /// Never: they stay, or move at their speed.
    Never,
    /// The number of scans between two draws, at least 1.
    EachScanN(u64),
}

/// A simulated robot. Beside a log, only the noise of its odometry is given: it drives the log's poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawRobot {
    /// The path it drives. Not allowed with `log`. `locsim gap --log` drives the log's poses; the key is needed all the same, and any path in free space does.
    pub path: Option<RawPath>,
    /// The start is shifted along x and along y by a uniform draw from -this to this, anew for each trial
    /// (m), 0 to 10000.
    #[serde(default)]
    pub start_jitter_m: f64,
    /// Noise of its odometry.
    #[serde(default)]
    pub odometry_noise: RawOdometryNoise,
}

/// Noise of the simulated odometry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawOdometryNoise {
    /// alpha 1 to 4 of Probabilistic Robotics, table 5.6, each 0 to 1000. Of the motion from one scan to the next, the variances are alpha 1 rot^2 + alpha 2 trans^2 for each of its two rotations (rad^2) and alpha 3 trans^2 + alpha 4 (rot1^2 + rot2^2) for its translation (m^2).
    #[serde(default)]
    pub alpha: [f64; 4],
}

/// A path through the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum RawPath {
    /// Straight legs between points, turning in place at each.
    Waypoints {
        /// 2 to 100000 points [x, y] in the map frame (m), -1000000 to 1000000, neighbours apart.
        points_m: Vec<[f64; 2]>,
        /// Speed on a leg (m/s), 0.001 to 1000.
        speed_m_s: f64,
        /// Turn rate at a point (deg/s), 0.001 to 100000.
        turn_rate_deg_s: f64,
    },
    /// Arcs of constant speed and turn rate.
    VelocityProfile {
        /// First pose in the map frame.
        start: RawPose,
        /// 1 to 100000.
        segments: Vec<RawSegment>,
    },
}

/// A pose in the map frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawPose {
    /// x (m), -1000000 to 1000000.
    pub x_m: f64,
    /// y (m), -1000000 to 1000000.
    pub y_m: f64,
    /// Heading (deg), 0 along x, counter-clockwise, -1000000 to 1000000.
    pub heading_deg: f64,
}

/// An arc; negative speeds reverse, speed 0 turns in place or stops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawSegment {
    /// How long it lasts (s), 0.000001 to 10000000.
    pub secs: f64,
    /// Forward speed (m/s), -1000 to 1000.
    pub speed_m_s: f64,
    /// Turn rate (deg/s), counter-clockwise, -100000 to 100000.
    #[serde(default)]
    pub turn_rate_deg_s: f64,
}

/// A simulated planar laser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawLaser {
    /// Scans per second (Hz), 0.001 to 100000. Of a log that keeps every second or third scan, those that are kept: `scan_secs` stays the time of one sweep.
    pub rate_hz: f64,
    /// Beams per scan, 1 to 100000.
    pub beams: u64,
    /// Field of view (deg), 0.001 to 360. At 360 beams are spread evenly without a double end; below, both
    /// ends carry a beam.
    #[serde(default = "default::field_of_view_deg")]
    pub field_of_view_deg: f64,
    /// Bearing of the first beam (deg), -180 to 180, counter-clockwise from where the laser looks; `mount.yaw_deg` turns it with the laser. Beams are counter-clockwise: of a log whose beams are clockwise, as of a laser that hangs upside down, this is the lowest bearing, which its messages have last. Default: the middle of the field of view is ahead, and the last beam of a full circle is at 180.
    pub first_beam_deg: Option<f64>,
    /// Minimum range (m), 0 to 10000. A shorter reading is unusable: NaN in a simulated bag, 0 in a CARMEN log.
    #[serde(default)]
    pub min_range_m: f64,
    /// Maximum range (m), 0.001 to 10000, above the minimum. A reading at it means "no return".
    pub max_range_m: f64,
    /// Step of a reading (m), 0.000001 to `max_range_m`, or 0 for readings that aren't quantized.
    #[serde(default)]
    pub resolution_m: f64,
    /// Gaussian noise of a reading.
    #[serde(default)]
    pub noise: RawRangeNoise,
    /// Where the laser sits on the robot. Where it is left out, `gap` takes what the log says.
    #[serde(default)]
    pub mount: RawMount,
    /// Time that the laser takes for its field of view (s), 0 to 1 / `rate_hz`. Of n beams, beam i from 0 is taken i `scan_secs` / (n - 1) after the stamp, so this is the time from the first beam to the last; at 360 degrees i `scan_secs` / n, so it is the whole turn. Beams are taken counter-clockwise. `gap` has the times of the log's own beams where it says any, as a `time_increment`: the key can be left out then.
    #[serde(default)]
    pub scan_secs: f64,
}

/// Gaussian noise of a reading: `sigma(r) = sigma_m + sigma_per_m * r`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawRangeNoise {
    /// Standard deviation at range 0 (m), 0.000001 to 1, or 0; not 0 with the model `oracle`.
    #[serde(default)]
    pub sigma_m: f64,
    /// Growth of the standard deviation per metre of range (m/m), 0 to 1000.
    #[serde(default)]
    pub sigma_per_m: f64,
}

/// Where the laser sits: a pose in the robot's frame, x forward, y left.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawMount {
    /// Forward (m), -10000 to 10000.
    #[serde(default)]
    pub x_m: f64,
    /// Left (m), -10000 to 10000.
    #[serde(default)]
    pub y_m: f64,
    /// Counter-clockwise (deg), -1000000 to 1000000.
    #[serde(default)]
    pub yaw_deg: f64,
}

/// A measured log, cut by share of its scans: each part is a list of intervals `[from, to)` with
/// 0 <= from < to <= 1, in order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawLog {
    /// A ROS 2 bag (a folder, `.mcap` or `.db3`) or a CARMEN log (`.log`), also compressed with gzip or zstd. Relative to the scenario file; `${VARIABLE}` is replaced from the
    /// environment.
    pub file: String,
    /// The map that is built from the log: cells of an occupancy grid, or walls where its readings end. Default: `walls`, but `cells`
    /// beside `map_resolution_m`.
    pub map: Option<MapFromScans>,
    /// Scans that the map is built from. Needed where `map` is absent, not allowed beside it.
    pub map_scans: Option<Vec<[f64; 2]>>,
    /// Scans that the sensor models are trained on. Without them, models are trained on scans that are simulated in the map;
    /// `laser` is then needed.
    pub train_scans: Option<Vec<[f64; 2]>>,
    /// Scans that the filter localizes on: one interval, as a drive doesn't jump; none of them may be a training or map
    /// scan.
    #[schemars(length(min = 1, max = 1))]
    pub localize_scans: Vec<[f64; 2]>,
    /// Side of a cell of the map built from the log (m), 0.001 to 10; only with cells, for which it is 0.05 where it isn't given.
    pub map_resolution_m: Option<f64>,
    /// Readings at or above this count as no return (m), 0.001 to 10000. Default: the log's own maximum.
    pub max_range_m: Option<f64>,
    /// Topics of a bag; only with a bag.
    pub topics: Option<RawTopics>,
}

/// The kind of map that is built from a log.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MapFromScans {
    /// An occupancy grid.
    Cells,
    /// Walls where readings end, and the border of what was seen.
    Walls,
}

/// Topics of a bag.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawTopics {
    /// Laser scans, `sensor_msgs/msg/LaserScan`; `MultiEchoLaserScan`, of which the first echoes are taken; `PointCloud2`
    /// of a 2D lidar. Default: `/scan`, or else the only topic of that type.
    pub scan: Option<String>,
    /// Odometry, `nav_msgs/msg/Odometry`, or a transform of `/tf`, written `parent:child`. Default: `/odom`, or else the only topic of that type beside the reference.
    pub odometry: Option<String>,
    /// Reference poses: `nav_msgs/msg/Odometry`, `geometry_msgs/msg/PoseStamped`, `PoseWithCovarianceStamped` or
    /// `TransformStamped`, or a transform such as `map:base_link`. Default: `/reference` or
    /// `/ground_truth`.
    pub reference: Option<String>,
}
