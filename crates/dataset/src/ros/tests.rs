//! Bags put together message by message, for the tests of what reads them.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI};
use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;

use lz4_flex::frame::FrameEncoder;
use mcap::records::{ChunkHeader, MessageHeader, Record, op};
use mcap::{MAGIC, WriteOptions, Writer, parse_record};
use proptest::prelude::*;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::messages::{
    Header, LaserScan, Message, Odometry, Pose, PoseStamped, PoseWithCovariance, Quaternion, TfMessage, Time,
    TransformStamped, TwistWithCovariance, Vector3, decode, encode,
};
use super::*;
use crate::test_drives::{bits, drive};
use crate::{LogFormat, LogKind, LogOptions, read_log, write_log};
use locsim_core::limits::UNPACKING_FACTOR;
use locsim_core::{DriveStep, Laser, Scan, wrap_angle};

mod container;
mod mended;
mod messages;
mod poses;
mod rewrite;
mod storage;
mod topics;
mod write;

impl Message for PoseStamped {
    const TYPE: &str = super::messages::POSE_STAMPED;
    const DEFINITION: &str = "";
}

/// A bag put together message by message.
#[derive(Clone, Default)]
pub struct Bag {
    /// Topic, type, encoding, content.
    messages: Vec<(String, String, String, Vec<u8>)>,
    /// When the first messages were recorded (ns); the others at 0.
    logged: Vec<u64>,
}

impl Bag {
    fn add<M: Message>(mut self, topic: &str, message: &M) -> Self {
        self.messages.push((topic.into(), M::TYPE.into(), "cdr".into(), encode(message).unwrap()));
        self
    }

    /// Adds a message that was recorded at this time.
    fn add_at<M: Message>(mut self, secs: f64, topic: &str, message: &M) -> Self {
        self.logged.resize(self.messages.len(), 0);
        self.logged.push((secs * 1e9).round() as u64);
        self.add(topic, message)
    }

    fn raw(mut self, topic: &str, schema: &str, encoding: &str, data: &[u8]) -> Self {
        self.messages.push((topic.into(), schema.into(), encoding.into(), data.into()));
        self
    }

    fn without(mut self, topic: &str) -> Self {
        self.messages.retain(|(name, ..)| name != topic);
        self
    }

    fn bytes(&self) -> Vec<u8> {
        let options = WriteOptions::new().compression(None).profile("ros2");
        let mut writer: Writer<_> = options.create(Cursor::new(Vec::new())).unwrap();
        let logged = self.logged.iter().copied().chain(std::iter::repeat(0));
        for ((topic, schema, encoding, data), log_time) in self.messages.iter().zip(logged) {
            let schema = writer.add_schema(schema, "ros2msg", b"").unwrap();
            let channel_id = writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap();
            let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
            writer.write_to_known_channel(&header, data).unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }

    fn read(&self, options: &BagOptions) -> Result<(Drive, LogSummary), DatasetError> {
        read_bytes(&self.bytes(), options)
    }

    fn message(&self) -> String {
        self.read(&BagOptions::default()).unwrap_err().to_string()
    }
}

fn read_bytes(bytes: &[u8], options: &BagOptions) -> Result<(Drive, LogSummary), DatasetError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.mcap");
    fs::write(&path, bytes).unwrap();
    read_bag(&path, options)
}

fn header(secs: f64, frame: &str) -> Header {
    Header { stamp: Time::from_secs(secs).unwrap(), frame_id: frame.into() }
}

fn scan(secs: f64, ranges: &[f32]) -> LaserScan {
    LaserScan {
        header: header(secs, "laser"),
        angle_min: -0.5,
        angle_max: 0.5,
        angle_increment: 0.25,
        time_increment: 0.001,
        scan_time: 0.1,
        range_min: 0.25,
        range_max: 8.0,
        ranges: ranges.into(),
        intensities: vec![1.0; ranges.len()],
    }
}

fn odometry(secs: f64, pose: &Pose2) -> Odometry {
    Odometry {
        header: header(secs, "odom"),
        child_frame_id: "base_footprint".into(),
        pose: PoseWithCovariance { pose: Pose::planar(pose), covariance: [[1.0; 6]; 6] },
        twist: TwistWithCovariance::default(),
    }
}

fn stamped(secs: f64, pose: &Pose2) -> PoseStamped {
    PoseStamped { header: header(secs, "map"), pose: Pose::planar(pose) }
}

fn transform(parent: &str, child: &str, [x, y, z]: [f64; 3], [qx, qy, qz, qw]: [f64; 4]) -> TfMessage {
    TfMessage {
        transforms: vec![TransformStamped {
            header: header(0.0, parent),
            child_frame_id: child.into(),
            transform: Pose {
                position: Vector3 { x, y, z },
                orientation: Quaternion { x: qx, y: qy, z: qz, w: qw },
            },
        }],
    }
}

/// Odometry from 1 s to 3 s, scans at 1 s, 1.5 s and 3 s.
pub fn plain() -> Bag {
    let five = [1.0, 2.0, 3.0, 4.0, 5.0];
    Bag::default()
        .add("/odom", &odometry(1.0, &Pose2::new(1.0, 2.0, 3.0)))
        .add("/scan", &scan(1.0, &five))
        .add("/scan", &scan(1.5, &five))
        .add("/odom", &odometry(3.0, &Pose2::new(3.0, 6.0, -3.0)))
        .add("/scan", &scan(3.0, &five))
}

fn near(a: &Pose2, b: &Pose2) -> bool {
    (a.x - b.x).abs() < 1e-9 && (a.y - b.y).abs() < 1e-9 && wrap_angle(a.theta - b.theta).abs() < 1e-9
}

/// The records in the chunks of a file.
pub fn records_of(bytes: &[u8]) -> Vec<u8> {
    let mut records = Vec::new();
    for record in mcap::read::LinearReader::new(bytes).unwrap() {
        if let Record::Chunk { data, .. } = record.unwrap() {
            records.extend_from_slice(&data);
        }
    }
    records
}

/// A file of one chunk, without summary.
pub fn packed(records: &[u8], compression: &str, sums: bool) -> Vec<u8> {
    let data = match compression {
        "lz4" => {
            let mut encoder = FrameEncoder::new(Vec::new());
            encoder.write_all(records).unwrap();
            encoder.finish().unwrap()
        }
        "zstd" => compress_to_vec(records, CompressionLevel::Fastest),
        _ => records.to_vec(),
    };
    let header = ChunkHeader {
        message_start_time: 0,
        message_end_time: 0,
        uncompressed_size: records.len() as u64,
        uncompressed_crc: if sums { crc32fast::hash(records) } else { 0 },
        compression: compression.into(),
        compressed_size: data.len() as u64,
    };
    let mut chunk = Vec::new();
    for time in [header.message_start_time, header.message_end_time, header.uncompressed_size] {
        chunk.extend(time.to_le_bytes());
    }
    chunk.extend(header.uncompressed_crc.to_le_bytes());
    chunk.extend((compression.len() as u32).to_le_bytes());
    chunk.extend(compression.bytes());
    chunk.extend(header.compressed_size.to_le_bytes());
    chunk.extend(&data);
    assert!(
        matches!(parse_record(op::CHUNK, &chunk).unwrap(), Record::Chunk { header: h, .. } if h == header)
    );

    let mut file = MAGIC.to_vec();
    for (opcode, body) in
        [(op::HEADER, vec![0; 8]), (op::CHUNK, chunk), (op::DATA_END, vec![0; 4]), (op::FOOTER, vec![0; 20])]
    {
        file.push(opcode);
        file.extend((body.len() as u64).to_le_bytes());
        file.extend(body);
    }
    file.extend(MAGIC);
    file
}

fn refused(bytes: &[u8], limits: &Limits) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.mcap");
    fs::write(&path, bytes).unwrap();
    let message = read(&path, &BagOptions::default(), limits).unwrap_err().to_string();
    assert!(message.len() < 4000 && !message.contains(char::is_control), "{message:?}");
    message
}
