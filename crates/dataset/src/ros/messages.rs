//! The messages of ROS 2 that a drive is made of: fields in the order of their definitions, which is that of CDR.

use locsim_core::Pose2;
use locsim_core::limits::{COORDINATE, number, quoted};
use re_cdr::{BigEndian, LittleEndian};
use serde::{Deserialize, Serialize};

use crate::quaternion::heading;

/// Types that are read and not written.
pub const MULTI_ECHO_LASER_SCAN: &str = "sensor_msgs/msg/MultiEchoLaserScan";
pub const POINT_CLOUD_2: &str = "sensor_msgs/msg/PointCloud2";
pub const POSE_STAMPED: &str = "geometry_msgs/msg/PoseStamped";
pub const POSE_WITH_COVARIANCE_STAMPED: &str = "geometry_msgs/msg/PoseWithCovarianceStamped";
pub const TRANSFORM_STAMPED: &str = "geometry_msgs/msg/TransformStamped";

/// A type of messages that is written.
pub trait Message: Serialize {
    /// The type's name.
    const TYPE: &str;
    /// Its definition with those it consists of, as `ros2msg` schemas have it.
    const DEFINITION: &str;
}

/// Nanoseconds of a second.
const SECOND: i64 = 1_000_000_000;

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Time {
    pub sec: i32,
    pub nanosec: u32,
}

impl Time {
    /// The time nearest to `secs` (s); `None` before 0 and from 2^31 - 1 on.
    pub fn from_secs(secs: f64) -> Option<Self> {
        (0.0..f64::from(i32::MAX)).contains(&secs).then(|| {
            let nanos = (secs.fract() * SECOND as f64).round() as i64;
            // The fraction may round up to a whole second.
            Self { sec: secs as i32 + (nanos / SECOND) as i32, nanosec: (nanos % SECOND) as u32 }
        })
    }

    /// The time of nanoseconds since the clock's zero; `None` before 0 and from 2^31 s on.
    pub fn from_nanos(nanos: i64) -> Option<Self> {
        let sec = i32::try_from(nanos.div_euclid(SECOND)).ok().filter(|sec| *sec >= 0)?;
        Some(Self { sec, nanosec: nanos.rem_euclid(SECOND) as u32 })
    }

    /// Nanoseconds since the clock's zero.
    pub fn nanos(self) -> i64 {
        i64::from(self.sec) * SECOND + i64::from(self.nanosec)
    }
}

/// Seconds since the clock's zero.
pub fn secs(nanos: i64) -> f64 {
    nanos.div_euclid(SECOND) as f64 + nanos.rem_euclid(SECOND) as f64 / SECOND as f64
}

/// `std_msgs/msg/Header`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Header {
    pub stamp: Time,
    pub frame_id: String,
}

/// `geometry_msgs/msg/Vector3`, and `Point`, which has the same fields.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Vector3 {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/msg/Quaternion`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

/// `geometry_msgs/msg/Pose`, and `Transform`, which has the same fields.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Pose {
    pub position: Vector3,
    pub orientation: Quaternion,
}

impl Pose {
    /// A pose in the plane, at height 0.
    pub fn planar(pose: &Pose2) -> Self {
        let (z, w) = (0.5 * pose.theta).sin_cos();
        Self {
            position: Vector3 { x: pose.x, y: pose.y, z: 0.0 },
            orientation: Quaternion { x: 0.0, y: 0.0, z, w },
        }
    }

    /// The pose projected to the plane.
    ///
    /// # Errors
    /// Content that isn't allowed: numbers that aren't finite or too large, a quaternion that isn't of unit length.
    pub fn projected(&self) -> Result<Pose2, String> {
        let Self { position: Vector3 { x, y, z }, orientation: q } = self;
        if ![x, y, z].iter().all(|v| v.abs() <= COORDINATE) {
            let [x, y, z] = [*x, *y, *z].map(number);
            return Err(format!("position is ({x}, {y}, {z}); allowed: finite numbers up to {COORDINATE:e}"));
        }
        let theta = heading([q.x, q.y, q.z, q.w]).map_err(|length| {
            format!("length of the quaternion is {}; allowed: 0.99 to 1.01", number(length))
        })?;
        Ok(Pose2::new(*x, *y, theta))
    }
}

/// `sensor_msgs/msg/LaserScan`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LaserScan {
    pub header: Header,
    pub angle_min: f32,
    pub angle_max: f32,
    pub angle_increment: f32,
    pub time_increment: f32,
    pub scan_time: f32,
    pub range_min: f32,
    pub range_max: f32,
    pub ranges: Vec<f32>,
    pub intensities: Vec<f32>,
}

/// `sensor_msgs/msg/MultiEchoLaserScan`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MultiEchoLaserScan {
    pub header: Header,
    pub angle_min: f32,
    pub angle_max: f32,
    pub angle_increment: f32,
    pub time_increment: f32,
    pub scan_time: f32,
    pub range_min: f32,
    pub range_max: f32,
    pub ranges: Vec<LaserEcho>,
    pub intensities: Vec<LaserEcho>,
}

/// `sensor_msgs/msg/LaserEcho`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LaserEcho {
    pub echoes: Vec<f32>,
}

impl From<MultiEchoLaserScan> for LaserScan {
    /// The first echo of each beam, which is the nearest; NaN where there is none. The ROS package `laser_proc` has it so.
    fn from(scan: MultiEchoLaserScan) -> Self {
        let first = |beam: &LaserEcho| beam.echoes.first().copied().unwrap_or(f32::NAN);
        Self {
            header: scan.header,
            angle_min: scan.angle_min,
            angle_max: scan.angle_max,
            angle_increment: scan.angle_increment,
            time_increment: scan.time_increment,
            scan_time: scan.scan_time,
            range_min: scan.range_min,
            range_max: scan.range_max,
            ranges: scan.ranges.iter().map(first).collect(),
            intensities: Vec::new(),
        }
    }
}

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PointCloud2 {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub fields: Vec<PointField>,
    pub is_bigendian: bool,
    pub point_step: u32,
    pub row_step: u32,
    pub data: Vec<u8>,
    pub is_dense: bool,
}

/// `sensor_msgs/msg/PointField`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PointField {
    pub name: String,
    pub offset: u32,
    pub datatype: u8,
    pub count: u32,
}

impl PointField {
    pub const FLOAT32: u8 = 7;
}

/// `geometry_msgs/msg/PoseStamped`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoseStamped {
    pub header: Header,
    pub pose: Pose,
}

/// `geometry_msgs/msg/PoseWithCovariance`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    pub pose: Pose,
    /// 6 x 6, row by row; 0 is unknown.
    pub covariance: [[f64; 6]; 6],
}

/// `geometry_msgs/msg/PoseWithCovarianceStamped`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoseWithCovarianceStamped {
    pub header: Header,
    pub pose: PoseWithCovariance,
}

/// `geometry_msgs/msg/TwistWithCovariance`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    pub linear: Vector3,
    pub angular: Vector3,
    /// 6 x 6, row by row; 0 is unknown.
    pub covariance: [[f64; 6]; 6],
}

/// `nav_msgs/msg/Odometry`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Odometry {
    pub header: Header,
    pub child_frame_id: String,
    pub pose: PoseWithCovariance,
    pub twist: TwistWithCovariance,
}

/// `geometry_msgs/msg/TransformStamped`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TransformStamped {
    pub header: Header,
    pub child_frame_id: String,
    pub transform: Pose,
}

/// `tf2_msgs/msg/TFMessage`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TfMessage {
    pub transforms: Vec<TransformStamped>,
}

/// Decodes a message in CDR.
///
/// # Errors
/// Why it isn't one of this type.
pub fn decode<'a, T: Deserialize<'a>>(data: &'a [u8]) -> Result<T, String> {
    let (kind, body) = match data {
        [0, kind @ (0 | 1), _, _, body @ ..] => (kind, body),
        [a, b, _, _, ..] => {
            return Err(format!(
                "representation is {a:02x} {b:02x}; allowed: 00 00 or 00 01, which is plain CDR"
            ));
        }
        _ => return Err(format!("{} bytes are too few for a message", data.len())),
    };
    let read = if *kind == 0 {
        re_cdr::from_bytes::<T, BigEndian>(body)
    } else {
        re_cdr::from_bytes::<T, LittleEndian>(body)
    };
    read.map(|(message, _)| message)
        .map_err(|error| format!("not a message of its type: {}", quoted(&error.to_string())))
}

/// Encodes a message in CDR, little endian.
///
/// # Errors
/// The library's, for types that CDR can't hold; none of ours is one.
pub fn encode(message: &impl Serialize) -> Result<Vec<u8>, re_cdr::Error> {
    let mut data = vec![0, 1, 0, 0];
    data.extend(re_cdr::to_vec::<_, LittleEndian>(message)?);
    Ok(data)
}

/// The line before the definition of a type that another consists of.
macro_rules! part {
    ($name:literal) => {
        concat!(
            "================================================================================\nMSG: ",
            $name,
            "\n"
        )
    };
}

macro_rules! header {
    () => {
        concat!(
            part!("std_msgs/Header"),
            "builtin_interfaces/Time stamp\nstring frame_id\n",
            part!("builtin_interfaces/Time"),
            "int32 sec\nuint32 nanosec\n"
        )
    };
}

macro_rules! vector {
    () => {
        concat!(part!("geometry_msgs/Vector3"), "float64 x\nfloat64 y\nfloat64 z\n")
    };
}

macro_rules! quaternion {
    () => {
        concat!(part!("geometry_msgs/Quaternion"), "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n")
    };
}

impl Message for LaserScan {
    const TYPE: &str = "sensor_msgs/msg/LaserScan";
    const DEFINITION: &str = concat!(
        "std_msgs/Header header\n\
         float32 angle_min\n\
         float32 angle_max\n\
         float32 angle_increment\n\
         float32 time_increment\n\
         float32 scan_time\n\
         float32 range_min\n\
         float32 range_max\n\
         float32[] ranges\n\
         float32[] intensities\n",
        header!()
    );
}

impl Message for Odometry {
    const TYPE: &str = "nav_msgs/msg/Odometry";
    const DEFINITION: &str = concat!(
        "std_msgs/Header header\n\
         string child_frame_id\n\
         geometry_msgs/PoseWithCovariance pose\n\
         geometry_msgs/TwistWithCovariance twist\n",
        header!(),
        part!("geometry_msgs/PoseWithCovariance"),
        "geometry_msgs/Pose pose\n\
         float64[36] covariance\n",
        part!("geometry_msgs/Pose"),
        "geometry_msgs/Point position\n\
         geometry_msgs/Quaternion orientation\n",
        part!("geometry_msgs/Point"),
        "float64 x\nfloat64 y\nfloat64 z\n",
        quaternion!(),
        part!("geometry_msgs/TwistWithCovariance"),
        "geometry_msgs/Twist twist\n\
         float64[36] covariance\n",
        part!("geometry_msgs/Twist"),
        "geometry_msgs/Vector3 linear\n\
         geometry_msgs/Vector3 angular\n",
        vector!(),
    );
}

impl Message for TfMessage {
    const TYPE: &str = "tf2_msgs/msg/TFMessage";
    const DEFINITION: &str = concat!(
        "geometry_msgs/TransformStamped[] transforms\n",
        part!("geometry_msgs/TransformStamped"),
        "std_msgs/Header header\n\
         string child_frame_id\n\
         geometry_msgs/Transform transform\n",
        header!(),
        part!("geometry_msgs/Transform"),
        "geometry_msgs/Vector3 translation\n\
         geometry_msgs/Quaternion rotation\n",
        vector!(),
        quaternion!(),
    );
}
