use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::path::Path;

use locsim_core::{Drive, DriveStep, Pose2};
use mcap::records::{MessageHeader, op};
use mcap::{MAGIC, McapResult, WriteOptions};

use super::messages::{
    Header, LaserScan, Message, Odometry, Pose, PoseWithCovariance, TfMessage, Time, TransformStamped,
    TwistWithCovariance, Vector3, encode,
};
use crate::DatasetError;
use crate::output::{encoded, evenly_spaced, write_whole};

/// Frames of REP-105.
const MAP: &str = "map";
const ODOM: &str = "odom";
const BASE: &str = "base_link";
const LASER: &str = "laser";

/// Writes a drive as a ROS 2 bag in one MCAP file that [`read_bag`](super::read_bag) turns into the same drive, and
/// that `ros2 bag play` and Foxglove open: `/scan`, `/odom` with velocities, `/reference` where it is known, `/tf` with
/// the odometry and the transform from the odometry's frame to the map's, and `/tf_static` with the laser's mount.
/// Channels tell their quality of service, so that a player latches `/tf_static`. Chunks aren't compressed.
///
/// Ranges come back exactly, no return as infinity in between (REP-117); poses to 1e-9, bearings and beam times to
/// 1e-6, stamps to a nanosecond. A scan without reference between others with it comes back with one, interpolated;
/// a reading of exactly 0 comes back as unusable. The file is written under a temporary name, then renamed.
///
/// # Errors
/// The drive has no scan, bearings or beam times that aren't evenly spaced (the first beam at the stamp), values that
/// no log may hold, or times before 0 or from 2^31 - 1 s on; the file can't be written.
pub fn write_mcap(path: &Path, drive: &Drive) -> Result<(), DatasetError> {
    write_whole(path, |out| encode_mcap(path, drive, 0, out))
}

/// Writes the bytes of the file to `out`; `path` is for messages. The drive's stamps count from `epoch_secs`, Unix time.
pub fn encode_mcap(
    path: &Path,
    drive: &Drive,
    epoch_secs: i32,
    out: &mut dyn Write,
) -> Result<(), DatasetError> {
    let (beams, times) = evenly_spaced(path, drive)?;
    let stamps = drive.steps.iter().enumerate().map(|(i, step)| {
        let stamp = Time::from_secs(step.stamp_secs)
            .and_then(|time| Some(Time { sec: time.sec.checked_add(epoch_secs)?, ..time }));
        stamp.ok_or_else(|| DatasetError::Unwritable {
            path: path.to_owned(),
            reason: format!("scan {i}: the time is {} s; allowed: 0 to 2147483647 s", step.stamp_secs),
        })
    });
    let stamps = stamps.collect::<Result<Vec<_>, _>>()?;
    let bytes = bag(drive, &stamps, beams.step as f32, times.step as f32)
        .map_err(|error| DatasetError::Unwritable { path: path.to_owned(), reason: error.to_string() })?;
    encoded(path, out, |out| out.write_all(&bytes))
}

/// The bytes of the file.
fn bag(drive: &Drive, stamps: &[Time], angle_increment: f32, time_increment: f32) -> McapResult<Vec<u8>> {
    let options = WriteOptions::new().profile("ros2").library("locsim").compression(None);
    let mut bag = Bag { writer: options.create(Cursor::new(Vec::new()))?, channels: BTreeMap::new() };
    let laser = &drive.laser;
    let bearings = laser.bearings();
    let header = |stamp: Time, frame: &str| Header { stamp, frame_id: frame.to_owned() };
    let tf = |stamp: Time, parent: &str, child: &str, pose: &Pose2| TfMessage {
        transforms: vec![TransformStamped {
            header: header(stamp, parent),
            child_frame_id: child.to_owned(),
            transform: Pose::planar(pose),
        }],
    };
    let odometry = |stamp: Time, parent: &str, pose: &Pose2, twist: TwistWithCovariance| Odometry {
        header: header(stamp, parent),
        child_frame_id: BASE.to_owned(),
        pose: PoseWithCovariance { pose: Pose::planar(pose), covariance: Default::default() },
        twist,
    };
    let scan_time = period_secs(&drive.steps) as f32;
    for (i, (step, &stamp)) in drive.steps.iter().zip(stamps).enumerate() {
        if i == 0 {
            bag.write("/tf_static", stamp, &tf(stamp, BASE, LASER, &laser.base_from_laser()))?;
        }
        bag.write("/tf", stamp, &tf(stamp, ODOM, BASE, &step.odometry))?;
        let twist = |pose: &dyn Fn(&DriveStep) -> Option<Pose2>| velocity(&drive.steps, i, pose);
        let moved = twist(&|step| Some(step.odometry));
        bag.write("/odom", stamp, &odometry(stamp, ODOM, &step.odometry, moved))?;
        if let Some(reference) = &step.reference {
            let map_from_odom = reference.compose(&Pose2::IDENTITY.relative_to(&step.odometry));
            bag.write("/tf", stamp, &tf(stamp, MAP, ODOM, &map_from_odom))?;
            let moved = twist(&|step| step.reference);
            bag.write("/reference", stamp, &odometry(stamp, MAP, reference, moved))?;
        }
        let or_infinity = |range: &f32| if *range == laser.max_range() { f32::INFINITY } else { *range };
        let scan = LaserScan {
            header: header(stamp, LASER),
            angle_min: bearings[0],
            angle_max: bearings[bearings.len() - 1],
            angle_increment,
            time_increment,
            scan_time,
            range_min: laser.min_range(),
            range_max: laser.max_range(),
            ranges: step.scan.ranges.iter().map(or_infinity).collect(),
            intensities: Vec::new(),
        };
        bag.write("/scan", stamp, &scan)?;
    }
    bag.writer.finish()?;
    let mut bytes = bag.writer.into_inner().into_inner();
    let summary = mcap::read::footer(&bytes)?.summary_start as usize;
    order(&mut bytes[summary..]);
    Ok(bytes)
}

/// Mean time between scans (s); 0, which is unknown, for a single one.
fn period_secs(steps: &[DriveStep]) -> f64 {
    match steps {
        [first, .., last] => (last.stamp_secs - first.stamp_secs) / (steps.len() - 1) as f64,
        _ => 0.0,
    }
}

/// The velocity in the robot's frame since the step before, or, of the first step, until the next; 0 where it isn't
/// known.
fn velocity(
    steps: &[DriveStep],
    step: usize,
    pose: &dyn Fn(&DriveStep) -> Option<Pose2>,
) -> TwistWithCovariance {
    let from = step.saturating_sub(1);
    let moved = steps.get(from + 1).and_then(|to| {
        let secs = to.stamp_secs - steps[from].stamp_secs;
        let apart = pose(to)?.relative_to(&pose(&steps[from])?);
        (secs > 0.0).then(|| [apart.x / secs, apart.y / secs, apart.theta / secs])
    });
    let [x, y, turn] = moved.unwrap_or_default();
    TwistWithCovariance {
        linear: Vector3 { x, y, z: 0.0 },
        angular: Vector3 { x: 0.0, y: 0.0, z: turn },
        ..TwistWithCovariance::default()
    }
}

/// Quality of service that `ros2 bag play` offers a topic with, as rosbag2 writes it: reliable, and latched for the
/// transforms that don't change. Times are unlimited.
fn quality_of_service(topic: &str) -> String {
    const UNLIMITED: &str = "    sec: 9223372036\n    nsec: 854775807\n";
    // Numbers of rmw_qos_durability_policy_t: transient local, volatile.
    let durability = if topic == "/tf_static" { 1 } else { 2 };
    format!(
        "- history: 1\n  depth: 10\n  reliability: 1\n  durability: {durability}\n  deadline:\n{UNLIMITED}  \
         lifespan:\n{UNLIMITED}  liveliness: 1\n  liveliness_lease_duration:\n{UNLIMITED}  \
         avoid_ros_namespace_conventions: false"
    )
}

/// Puts the schemas and channels of a summary in the order of their numbers. The library has them in that of a hash
/// map, which differs from run to run.
pub fn order(summary: &mut [u8]) {
    // The summary ends with the footer, which ends with a check sum, and the magic.
    let (footer, sum) = (9 + 20 + MAGIC.len(), 4 + MAGIC.len());
    let mut records = Vec::new();
    let mut rest = &summary[..summary.len() - footer];
    while let Some((start, _)) = rest.split_first_chunk::<9>() {
        let length = u64::from_le_bytes(start[1..].try_into().unwrap_or_default());
        let (record, behind) = rest.split_at(9 + length as usize);
        records.push(record);
        rest = behind;
    }
    for kind in records.chunk_by_mut(|a, b| a[0] == b[0]) {
        if [op::SCHEMA, op::CHANNEL].contains(&kind[0][0]) {
            kind.sort_by_key(|record| [record[10], record[9]]);
        }
    }
    let ordered = records.concat();
    summary[..ordered.len()].copy_from_slice(&ordered);
    let summed = summary.len() - sum;
    let sum = crc32fast::hash(&summary[..summed]);
    summary[summed..summed + 4].copy_from_slice(&sum.to_le_bytes());
}

/// A bag in the making.
struct Bag {
    writer: mcap::Writer<Cursor<Vec<u8>>>,
    /// Number of each topic's channel, and how many messages it has.
    channels: BTreeMap<&'static str, (u16, u32)>,
}

impl Bag {
    fn write<M: Message>(&mut self, topic: &'static str, stamp: Time, message: &M) -> McapResult<()> {
        let (channel_id, sequence) = if let Some(channel) = self.channels.get(topic) {
            *channel
        } else {
            let schema = self.writer.add_schema(M::TYPE, "ros2msg", M::DEFINITION.as_bytes())?;
            let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), quality_of_service(topic))]);
            (self.writer.add_channel(schema, topic, "cdr", &metadata)?, 0)
        };
        self.channels.insert(topic, (channel_id, sequence + 1));
        let time = stamp.nanos() as u64;
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        let data = encode(message).map_err(std::io::Error::other)?;
        self.writer.write_to_known_channel(&header, &data)
    }
}
