//! Bags that are copied with changes to the drive in them.

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::error::Error as _;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use glam::{DAffine3, DQuat};
use locsim_core::limits::Limits;
use locsim_core::{Drive, Pose2, wrap_angle};
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{MAGIC, McapResult, WriteOptions};

use super::BagOptions;
use super::bag::{Bag, Channel, Definition, Envelope};
use super::messages::{
    LaserEcho, LaserScan, MULTI_ECHO_LASER_SCAN, Message, MultiEchoLaserScan, Odometry, POINT_CLOUD_2, Pose,
    Quaternion, TfMessage, Time, Vector3, decode, encode, secs,
};
use super::poses::{affine, plain};
use super::read::{Layout, read_with_layout};
use super::topics::PoseSource;
use super::write::order;
use crate::output::write_whole;
use crate::{DatasetError, LogSummary};

/// Changes to the drive of a recording. Times are the stamps of messages (s), as those of a [`Drive`].
pub trait DriveEdit {
    /// Changes the readings of a scan (m; the maximum range without return, NaN where a reading isn't usable). `false` leaves
    /// the scan out.
    fn scan(&mut self, secs: f64, readings: &mut [f32]) -> bool;

    /// How much later than their stamps scans begin, and how much longer the time from beam to beam is (s).
    fn delay_secs(&self) -> [f64; 2];

    /// Where the laser is said to be mounted, for where it was, `base_from_laser`; `None` to leave it.
    fn mount(&self) -> Option<[Pose2; 2]>;

    /// The odometry; `None` to leave it.
    fn odometry(&self) -> Option<&dyn OdometryEdit>;
}

/// Changes to an odometry.
pub trait OdometryEdit {
    /// `odom_from_base` in the place of another.
    fn pose(&self, secs: f64, pose: &Pose2) -> Pose2;

    /// The velocity of the base in the place of another (m/s, m/s, rad/s).
    fn velocity(&self, secs: f64, velocity: &Pose2) -> Pose2;

    /// `map_from_odom` in the place of another.
    fn correction(&self, secs: f64, map_from_odom: &Pose2) -> Pose2;
}

/// A bag that is copied with changes: the messages that a drive is read from, and nothing else.
pub struct BagCopy {
    path: PathBuf,
    layout: Layout,
}

impl BagCopy {
    /// Reads the drive of a bag, as [`read_bag`](super::read_bag).
    ///
    /// # Errors
    /// As [`read_bag`](super::read_bag).
    pub fn open(path: &Path, options: &BagOptions) -> Result<(Self, Drive, LogSummary), DatasetError> {
        let (drive, summary, layout) = read_with_layout(path, options, Limits::current())?;
        Ok((Self { path: path.to_owned(), layout }, drive, summary))
    }

    /// Writes the bag with changes as one MCAP file at `out`, in a stream: readings, stamps, odometry and transforms of the drive
    /// as `edit` has them, every other message byte for byte, with its topic, type, definition and times.
    ///
    /// Attachments and metadata records of MCAP, which rosbag2 writes none of but a copy of `metadata.yaml`, aren't copied.
    ///
    /// # Errors
    /// The bag's scans are clouds; the laser's mount is to change and no transform tells it; the bag can't be read, or the file
    /// can't be written.
    pub fn write(&self, out: &Path, edit: &mut dyn DriveEdit) -> Result<(), DatasetError> {
        let refuse =
            |reason: &str| Err(DatasetError::Unwritable { path: out.to_owned(), reason: reason.to_owned() });
        if self.layout.chosen.scan.schema == POINT_CLOUD_2 {
            return refuse(
                "the scans are clouds (PointCloud2); allowed: LaserScan, or a CARMEN log to write",
            );
        }
        if self.layout.resampled_scans > 0 {
            return refuse(
                "some scans have other beams than the first; allowed: scans of one number of beams, or a CARMEN log to write",
            );
        }
        if self.layout.is_of_recording {
            return refuse(
                "stamps are whole seconds that several messages share; allowed: stamps that tell the messages apart, or a CARMEN log to write",
            );
        }
        if edit.mount().is_some() && self.layout.laser.is_none() {
            return refuse(
                "no transform tells where the laser is mounted; allowed: one, as its mount is to change",
            );
        }
        let bag = Bag::open(&self.path, Limits::current())?;
        write_whole(out, |stream| {
            let written = |error: mcap::McapError| DatasetError::Unwritable {
                path: out.to_owned(),
                // The system's own words, such as that the disk is full.
                reason: error.source().map_or_else(|| error.to_string(), ToString::to_string),
            };
            let mut copy = Copy::to(stream).map_err(written)?;
            let mut failed = None;
            let read = bag.visit(
                |_| true,
                |channel, envelope, data| {
                    let Some(message) = self.changed(channel, data, edit)? else { return Ok(()) };
                    copy.write(channel, envelope, &message).map_err(|error| {
                        let reason = error.to_string();
                        failed = Some(error);
                        reason
                    })
                },
            );
            if let Some(error) = failed {
                return Err(written(error));
            }
            read?;
            copy.finish().map_err(written)
        })
    }

    /// The message with changes; `None` where it is left out.
    fn changed<'m>(
        &self,
        channel: &Channel,
        data: &'m [u8],
        edit: &mut dyn DriveEdit,
    ) -> Result<Option<Cow<'m, [u8]>>, String> {
        let chosen = &self.layout.chosen;
        let encoded = |message: Result<Vec<u8>, re_cdr::Error>| {
            message.map(|data| Some(Cow::Owned(data))).map_err(|error| error.to_string())
        };
        if *channel == chosen.scan {
            if channel.schema == MULTI_ECHO_LASER_SCAN {
                let mut message: MultiEchoLaserScan = decode(data)?;
                let mut scan = LaserScan::from(message.clone());
                if !self.change_scan(&mut scan, edit)? {
                    return Ok(None);
                }
                for (LaserEcho { echoes }, range) in message.ranges.iter_mut().zip(scan.ranges) {
                    if echoes.first().is_none_or(|first| first.to_bits() != range.to_bits())
                        && !range.is_nan()
                    {
                        *echoes = vec![range];
                    }
                }
                message.header = scan.header;
                message.time_increment = scan.time_increment;
                return encoded(encode(&message));
            }
            let mut scan: LaserScan = decode(data)?;
            return if self.change_scan(&mut scan, edit)? { encoded(encode(&scan)) } else { Ok(None) };
        }
        if let (Some(PoseSource::Topic(topic)), Some(odometry)) = (&chosen.odometry, edit.odometry())
            && topic == channel
        {
            let mut message: Odometry = decode(data)?;
            let secs = secs(message.header.stamp.nanos());
            // What is no pose is left out by who reads it, and stays.
            let Ok(pose) = message.pose.pose.projected() else { return Ok(Some(Cow::Borrowed(data))) };
            move_to(&mut message.pose.pose, &pose, &odometry.pose(secs, &pose));
            let twist = &mut message.twist;
            let velocity = Pose2 { x: twist.linear.x, y: twist.linear.y, theta: twist.angular.z };
            let velocity = odometry.velocity(secs, &velocity);
            (twist.linear.x, twist.linear.y, twist.angular.z) = (velocity.x, velocity.y, velocity.theta);
            return encoded(encode(&message));
        }
        if channel.schema == TfMessage::TYPE
            && channel.encoding == "cdr"
            && (edit.odometry().is_some() || edit.mount().is_some())
        {
            let mut message: TfMessage = decode(data)?;
            self.change_transforms(&mut message, edit);
            return encoded(encode(&message));
        }
        Ok(Some(Cow::Borrowed(data)))
    }

    fn change_scan(&self, scan: &mut LaserScan, edit: &mut dyn DriveEdit) -> Result<bool, String> {
        // No step of the drive is of a scan without readings.
        if scan.ranges.is_empty() {
            return Ok(true);
        }
        let convention = self.layout.convention;
        let before: Vec<f32> = scan.ranges.iter().map(|range| convention.reading(*range)).collect();
        let mut after = before.clone();
        if !edit.scan(secs(scan.header.stamp.nanos()), &mut after) {
            return Ok(false);
        }
        for ((range, before), after) in scan.ranges.iter_mut().zip(before).zip(after) {
            // What isn't changed stays as its driver wrote it.
            if before.to_bits() != after.to_bits() && !(before.is_nan() && after.is_nan()) {
                *range = convention.written(after);
            }
        }
        let [delay, interval] = edit.delay_secs();
        let stamp = scan.header.stamp.nanos() - (delay * 1e9).round() as i64;
        scan.header.stamp =
            Time::from_nanos(stamp).ok_or("the stamp would be before 0 or after 2^31 s".to_owned())?;
        scan.time_increment -= interval as f32;
        Ok(true)
    }

    fn change_transforms(&self, message: &mut TfMessage, edit: &dyn DriveEdit) {
        let Layout { odom, laser, .. } = &self.layout;
        for stamped in &mut message.transforms {
            let (child, parent) = (plain(&stamped.child_frame_id), plain(&stamped.header.frame_id));
            let secs = secs(stamped.header.stamp.nanos());
            if let Some(odometry) = edit.odometry()
                && (parent == odom || child == odom)
            {
                let Ok(pose) = stamped.transform.projected() else { continue };
                let changed = if parent == odom {
                    odometry.pose(secs, &pose)
                } else {
                    odometry.correction(secs, &pose)
                };
                move_to(&mut stamped.transform, &pose, &changed);
            }
            if let (Some([was, said]), Some(laser)) = (edit.mount(), laser)
                && child == laser.frame
                && parent == laser.parent
            {
                let in_base = in_space(&said.compose(&Pose2::IDENTITY.relative_to(&was)));
                let in_parent = laser.base_from_parent.inverse() * in_base * laser.base_from_parent;
                stamped.transform = pose(&(in_parent * affine(&stamped.transform)));
            }
        }
    }
}

/// Moves a pose whose projection is `from` in the plane, such that its projection is `to`; height and tilt stay.
fn move_to(pose: &mut Pose, from: &Pose2, to: &Pose2) {
    if from == to {
        return;
    }
    let q = pose.orientation;
    let turn = DQuat::from_rotation_z(wrap_angle(to.theta - from.theta));
    let [x, y, z, w] = (turn * DQuat::from_xyzw(q.x, q.y, q.z, q.w)).to_array();
    pose.orientation = Quaternion { x, y, z, w };
    (pose.position.x, pose.position.y) = (to.x, to.y);
}

/// A pose of the plane in space.
fn in_space(pose: &Pose2) -> DAffine3 {
    DAffine3::from_rotation_translation(DQuat::from_rotation_z(pose.theta), pose.position().extend(0.0))
}

/// The message of a transform in space.
fn pose(transform: &DAffine3) -> Pose {
    let (_, rotation, translation) = transform.to_scale_rotation_translation();
    let [x, y, z, w] = rotation.normalize().to_array();
    Pose {
        position: Vector3 { x: translation.x, y: translation.y, z: translation.z },
        orientation: Quaternion { x, y, z, w },
    }
}

/// A stream whose end is kept back, so that it can be put in order.
struct Held<'a> {
    stream: &'a mut dyn Write,
    /// Bytes that went through.
    written: u64,
    /// The bytes since the end began.
    end: Rc<RefCell<Option<Vec<u8>>>>,
}

impl Write for Held<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Some(end) = &mut *self.end.borrow_mut() {
            end.extend(bytes);
            return Ok(bytes.len());
        }
        let written = self.stream.write(bytes)?;
        self.written += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}

/// A copy in the making.
struct Copy<'a> {
    writer: mcap::Writer<NoSeek<Held<'a>>>,
    end: Rc<RefCell<Option<Vec<u8>>>>,
    /// Number of each channel, and how many messages it has.
    channels: BTreeMap<Channel, (u16, u32)>,
}

impl<'a> Copy<'a> {
    fn to(stream: &'a mut dyn Write) -> McapResult<Self> {
        let end = Rc::default();
        let held = Held { stream, written: 0, end: Rc::clone(&end) };
        let options =
            WriteOptions::new().profile("ros2").library("locsim").compression(None).disable_seeking(true);
        Ok(Self { writer: options.create(NoSeek::new(held))?, end, channels: BTreeMap::new() })
    }

    fn write(&mut self, channel: &Channel, envelope: Envelope<'_>, data: &[u8]) -> McapResult<()> {
        let Envelope { logged, published, definition } = envelope;
        let (channel_id, sequence) = match self.channels.get(channel) {
            Some(numbers) => *numbers,
            None => (self.add(channel, definition)?, 0),
        };
        self.channels.insert(channel.clone(), (channel_id, sequence + 1));
        let [log_time, publish_time] = [logged, published].map(|time| time.max(0) as u64);
        self.writer
            .write_to_known_channel(&MessageHeader { channel_id, sequence, log_time, publish_time }, data)
    }

    fn add(&mut self, channel: &Channel, definition: &Definition) -> McapResult<u16> {
        let Definition { encoding, text, metadata } = definition;
        let known = match channel.schema.as_str() {
            LaserScan::TYPE => LaserScan::DEFINITION,
            Odometry::TYPE => Odometry::DEFINITION,
            TfMessage::TYPE => TfMessage::DEFINITION,
            _ => "",
        };
        let schema = match channel.schema.as_str() {
            "" => 0,
            name if encoding.is_empty() && !known.is_empty() => {
                self.writer.add_schema(name, "ros2msg", known.as_bytes())?
            }
            name => self.writer.add_schema(name, encoding, text)?,
        };
        self.writer.add_channel(schema, &channel.topic, &channel.encoding, metadata)
    }

    /// Completes the file.
    fn finish(mut self) -> McapResult<()> {
        self.writer.flush()?;
        *self.end.borrow_mut() = Some(Vec::new());
        self.writer.finish()?;
        let Held { stream, written, .. } = self.writer.into_inner().into_inner();
        let mut end = self.end.take().unwrap_or_default();
        // The footer begins with the place of the summary, then come another place and a check sum.
        let footer = end.len().saturating_sub(MAGIC.len() + 8 + 8 + 4);
        let summary = end[footer..].first_chunk().map_or(0, |place| u64::from_le_bytes(*place));
        order(&mut end[(summary - written) as usize..]);
        stream.write_all(&end)?;
        Ok(())
    }
}
