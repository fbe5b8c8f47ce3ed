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

mod poses;
mod storage;

impl Message for PoseStamped {
    const TYPE: &str = super::messages::POSE_STAMPED;
    const DEFINITION: &str = "";
}

/// A bag put together message by message.
#[derive(Default)]
pub struct Bag {
    /// Topic, type, encoding, content.
    messages: Vec<(String, String, String, Vec<u8>)>,
}

impl Bag {
    fn add<M: Message>(mut self, topic: &str, message: &M) -> Self {
        self.messages.push((topic.into(), M::TYPE.into(), "cdr".into(), encode(message).unwrap()));
        self
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
        for (topic, schema, encoding, data) in &self.messages {
            let schema = writer.add_schema(schema, "ros2msg", b"").unwrap();
            let channel_id = writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap();
            let header = MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn a_written_drive_reads_back(mut drive in drive(), known in any::<bool>()) {
        // Between two known references a reader interpolates: all or none.
        for step in &mut drive.steps {
            step.reference = known.then(|| step.reference.unwrap_or(Pose2::new(1.0, -2.0, 3.0)));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.mcap");
        write_log(&path, &drive).unwrap();
        let (back, summary) = read_log(&path, &LogOptions::default()).unwrap();
        prop_assert_eq!(summary.kind, if known { LogKind::Referenced } else { LogKind::Raw });
        prop_assert_eq!((summary.stamps_repaired, summary.scans_dropped), (0, 0));
        prop_assert_eq!(summary.odometry_messages, drive.steps.len());
        prop_assert_eq!(back.steps.len(), drive.steps.len());
        for (a, b) in back.steps.iter().zip(&drive.steps) {
            prop_assert!((a.stamp_secs - b.stamp_secs).abs() <= 1e-9_f64.max(f64::EPSILON * b.stamp_secs));
            prop_assert!(near(&a.odometry, &b.odometry), "{:?} {:?}", a.odometry, b.odometry);
            prop_assert_eq!(a.reference.is_some(), known);
            prop_assert!(!known || near(&a.reference.unwrap(), &b.reference.unwrap()));
            prop_assert_eq!(bits(&a.scan), bits(&b.scan));
        }
        let (a, b) = (&back.laser, &drive.laser);
        prop_assert_eq!((a.min_range(), a.max_range()), (b.min_range(), b.max_range()));
        prop_assert!(near(&a.base_from_laser(), &b.base_from_laser()));
        for (a, b) in a.bearings().iter().zip(b.bearings()) {
            prop_assert!((a - b).abs() <= 1e-6);
        }
        for (a, b) in a.beam_times_secs().iter().zip(b.beam_times_secs()) {
            prop_assert!((a - b).abs() <= 1e-6);
        }
    }

    /// A changed byte in the data is always found out, by a check sum or before; elsewhere it is no obstacle.
    #[test]
    fn a_damaged_file_is_refused(place in any::<prop::sample::Index>(), change in 1..=255_u8) {
        let mut bytes = plain().bytes();
        let data_end = bytes.len() - summary_length(&bytes);
        let place = place.index(bytes.len());
        bytes[place] ^= change;
        let result = read_bytes(&bytes, &BagOptions::default());
        prop_assert!(place >= data_end || result.is_err(), "byte {place} of {data_end}");
    }

    /// Without check sums damage may go unnoticed, but nothing panics.
    #[test]
    fn no_bytes_make_the_reader_panic(
        places in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        packing in prop::sample::select(vec!["", "lz4", "zstd"]),
        inside in any::<bool>(),
    ) {
        let mut records = records_of(&plain().bytes());
        if inside {
            for (place, byte) in &places {
                let place = place.index(records.len());
                records[place] = *byte;
            }
        }
        let mut bytes = packed(&records, packing, false);
        if !inside {
            for (place, byte) in &places {
                let place = place.index(bytes.len());
                bytes[place] = *byte;
            }
        }
        let _ = read_bytes(&bytes, &BagOptions::default());
    }

    #[test]
    fn a_cut_file_is_refused(share in 0.0..1.0f64) {
        let bytes = plain().bytes();
        let cut = read_bytes(&bytes[..(share * bytes.len() as f64) as usize], &BagOptions::default());
        // Of the first bytes nobody can tell what they begin.
        let refused = matches!(cut, Err(DatasetError::Mcap { .. } | DatasetError::NotALog { .. }));
        prop_assert!(refused, "{cut:?}");
    }
}

/// From the end of the data section to the end of the file.
fn summary_length(bytes: &[u8]) -> usize {
    let footer = mcap::read::footer(bytes).unwrap();
    // The record that ends the data: kind, length, check sum; only its check sum matters to a reader.
    bytes.len() - footer.summary_start as usize + 1 + 8 + 4
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

#[test]
fn compressed_chunks_are_unpacked() {
    let bytes = plain().bytes();
    let (plain, _) = read_bytes(&bytes, &BagOptions::default()).unwrap();
    let records = records_of(&bytes);
    for compression in ["", "lz4", "zstd"] {
        for sums in [false, true] {
            let (drive, _) =
                read_bytes(&packed(&records, compression, sums), &BagOptions::default()).unwrap();
            assert_eq!(drive, plain, "{compression}");
        }
    }
    for compression in ["", "lz4", "zstd"] {
        // The chunk's unpacked size and check sum, behind the magic, the header, a record's start and two times.
        let size = MAGIC.len() + 9 + 8 + 9 + 16;
        for (place, part) in
            [(size, "unpacks to another number of bytes"), (size + 8, "check sum of a chunk is wrong")]
        {
            for change in [1, 2, 3] {
                let mut bytes = packed(&records, compression, true);
                bytes[place] ^= change;
                let message = read_bytes(&bytes, &BagOptions::default()).unwrap_err().to_string();
                assert!(message.contains(part), "{compression}: {message}");
            }
        }
    }
    let odd = read_bytes(&packed(&records, "xz", true), &BagOptions::default()).unwrap_err().to_string();
    assert!(odd.contains("chunks compressed with `xz`; allowed: lz4, zstd, none"), "{odd}");
}

/// Written by other people's programs: the Python packages mcap 1.6.0 and mcap-ros2-support 0.6.0.
#[test]
fn a_bag_of_other_programs_is_read() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/other-programs.mcap");
    let (drive, summary) = read_bag(&path, &BagOptions::default()).unwrap();
    assert_eq!(drive.laser.bearings(), [-0.5, -0.25, 0.0, 0.25, 0.5]);
    assert_eq!((drive.laser.min_range(), drive.laser.max_range()), (0.25, 8.0));
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(0.5, -0.125, FRAC_PI_2)));
    assert_eq!(summary.kind, LogKind::Referenced);
    assert_eq!(summary.skipped, BTreeMap::from([("/chatter".to_owned(), 1)]));
    assert_eq!((drive.steps.len(), summary.scans_dropped), (3, 0));
    for (i, step) in drive.steps.iter().enumerate() {
        let t = i as f64 * 0.5;
        assert_eq!(step.stamp_secs, 1_700_000_000.0 + t);
        assert!(near(&step.odometry, &Pose2::new(t, -t, 0.25 * t)), "{i}: {:?}", step.odometry);
        assert!(near(&step.reference.unwrap(), &Pose2::new(10.0 + t, t, 0.0)));
        assert_eq!(step.scan.ranges[..4], [1.5 + i as f32, 8.0, 8.0, 7.75]);
        assert!(step.scan.ranges[4].is_nan());
    }
}

#[test]
fn poses_are_interpolated_at_the_scans() {
    let reference = [(1.25, Pose2::new(0.0, 0.0, 0.0)), (2.25, Pose2::new(4.0, 8.0, 1.0))];
    let bag = plain()
        .add("/ground_truth", &stamped(reference[0].0, &reference[0].1))
        .add("/ground_truth", &stamped(reference[1].0, &reference[1].1))
        .add("/scan", &scan(0.5, &[1.0; 5]))
        .add("/scan", &scan(3.25, &[1.0; 5]));
    // The scan of 0.5 s comes 2.5 s late.
    assert!(
        bag.message().contains("/scan: message 4: stamp is 0.5 s after one of 3 s; allowed: at most 1 s")
    );
    let mut bag = bag;
    let early = bag.messages.remove(bag.messages.len() - 2);
    bag.messages.insert(0, early);
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    assert_eq!((summary.scans_dropped, summary.stamps_repaired, drive.steps.len()), (2, 0, 3));
    assert!(summary.to_string().contains("scans: 2 left out"), "{summary}");
    let stamps: Vec<_> = drive.steps.iter().map(|step| step.stamp_secs).collect();
    assert_eq!(stamps, [1.0, 1.5, 3.0]);
    // From 3 rad to -3 rad the shorter arc leads over pi.
    let quarter = Pose2::new(1.5, 3.0, 3.0 + 0.25 * (2.0 * PI - 6.0));
    let expected = [Pose2::new(1.0, 2.0, 3.0), quarter, Pose2::new(3.0, 6.0, -3.0)];
    for (step, expected) in drive.steps.iter().zip(&expected) {
        assert!(near(&step.odometry, expected), "{:?}", step.odometry);
    }
    let references: Vec<_> = drive.steps.iter().map(|step| step.reference).collect();
    assert!(references[0].is_none() && references[2].is_none());
    assert!(near(&references[1].unwrap(), &Pose2::new(1.0, 2.0, 0.25)));

    // Only scans without odometry.
    let late = Bag::default()
        .add("/odom", &odometry(1.0, &Pose2::IDENTITY))
        .add("/odom", &odometry(2.0, &Pose2::IDENTITY))
        .add("/scan", &scan(2.5, &[1.0]));
    assert!(late.message().contains("none of the 1 scans lies within the time of the odometry"));
}

#[test]
fn messages_a_little_out_of_order_are_sorted() {
    let mut bag = plain();
    bag.messages.swap(1, 2);
    bag.messages.reverse();
    // Scans now come at 3, 1, 1.5 s, which is too much; with 2 s instead of 3 s it isn't.
    bag.messages[0].3 = encode(&scan(2.0, &[1.0; 5])).unwrap();
    bag.messages[1].3 = encode(&odometry(2.0, &Pose2::new(3.0, 6.0, -3.0))).unwrap();
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    let stamps: Vec<_> = drive.steps.iter().map(|step| step.stamp_secs).collect();
    assert_eq!(stamps, [1.0, 1.5, 2.0]);
    assert_eq!(summary.stamps_repaired, 2);
    assert!(near(&drive.steps[1].odometry, &Pose2::new(2.0, 4.0, PI)));
}

#[test]
fn scans_of_one_time_take_their_own_odometry() {
    let pose = |x: f64| Pose2::new(x, 0.0, 0.0);
    let bag = Bag::default()
        .add("/odom", &odometry(1.0, &pose(1.0)))
        .add("/scan", &scan(1.0, &[1.0]))
        .add("/odom", &odometry(1.0, &pose(2.0)))
        .add("/scan", &scan(1.0, &[1.0]))
        .add("/scan", &scan(1.0, &[1.0]));
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    let x: Vec<_> = drive.steps.iter().map(|step| step.odometry.x).collect();
    assert_eq!(x, [1.0, 2.0, 2.0]);
    assert_eq!(summary.stamps_repeated, 2);
}

#[test]
fn readings_at_the_ends_of_the_range_become_sentinels() {
    let ranges = [f32::INFINITY, 8.0, 9.0, 7.5, 0.25, 0.125, 0.0, f32::NAN, f32::NEG_INFINITY];
    let bag = Bag::default().add("/odom", &odometry(1.0, &Pose2::IDENTITY)).add("/scan", &scan(1.0, &ranges));
    let read = |options| bag.read(&options).unwrap();
    let (drive, summary) = read(BagOptions::default());
    let found = &drive.steps[0].scan.ranges;
    assert_eq!(found[..5], [8.0, 8.0, 8.0, 7.5, 0.25]);
    assert!(found[5..].iter().all(|range| range.is_nan()), "{found:?}");
    assert_eq!((summary.no_return_share, summary.unusable_share), (3.0 / 9.0, 4.0 / 9.0));
    assert_eq!(summary.longest_return_m, Some(7.5));
    let narrow = BagOptions { max_range_m: Some(4.0), min_range_m: Some(0.0), ..BagOptions::default() };
    let (drive, _) = read(narrow);
    assert_eq!(drive.steps[0].scan.ranges[..6], [4.0, 4.0, 4.0, 4.0, 0.25, 0.125]);
    assert!(drive.steps[0].scan.ranges[6..].iter().all(|range| range.is_nan()));
    let times = drive.laser.beam_times_secs();
    assert_eq!((times[0], times[8]), (0.0, (8.0 * f64::from(0.001_f32)) as f32));
}

#[test]
fn topics_are_the_default_ones_or_alone_of_their_type() {
    let rename = |from: &str, to: &str| {
        let mut bag = plain();
        for message in bag.messages.iter_mut().filter(|message| message.0 == from) {
            message.0 = to.into();
        }
        bag
    };
    let (default, _) = plain().read(&BagOptions::default()).unwrap();
    let lidar = rename("/scan", "/front/lidar");
    let (drive, summary) = lidar.read(&BagOptions::default()).unwrap();
    assert_eq!((&drive, summary.scan_source.as_str()), (&default, "/front/lidar"));
    assert!(summary.evidence.contains("/front/lidar is taken for scan as the only"), "{summary}");

    // A second topic of the type: no guessing. With a name, no need to.
    let two = lidar.add("/rear/lidar", &scan(1.0, &[1.0]));
    let message = two.message();
    for part in [
        "no topic `/scan` for scan",
        "no single other",
        "/front/lidar (sensor_msgs/msg/LaserScan, 3",
        "/odom (",
    ] {
        assert!(message.contains(part), "{message}");
    }
    let topics = |scan: Option<&str>, reference: Option<&str>| BagOptions {
        topics: BagTopics {
            scan: scan.map(Into::into),
            reference: reference.map(Into::into),
            odometry: None,
        },
        ..BagOptions::default()
    };
    let (drive, summary) = two.read(&topics(Some("/front/lidar"), None)).unwrap();
    assert_eq!((&drive, summary.skipped["/rear/lidar"]), (&default, 1));
    let absent = two.read(&topics(Some("/lidar"), None)).unwrap_err().to_string();
    assert!(
        absent.contains("scan topic `/lidar` isn't there with messages of type sensor_msgs/msg/LaserScan")
    );

    // A reference is never guessed, and isn't taken for odometry.
    let pose = Pose2::new(7.0, 8.0, 0.5);
    let more =
        rename("/odom", "/wheels").add("/fused", &odometry(1.0, &pose)).add("/fused", &odometry(3.0, &pose));
    assert!(more.message().contains("no topic `/odom` for odometry, and no single other"));
    let (drive, summary) = more.read(&topics(None, Some("/fused"))).unwrap();
    assert_eq!(summary.kind, LogKind::Referenced);
    for (step, default) in drive.steps.iter().zip(&default.steps) {
        assert_eq!(step.odometry, default.odometry);
        assert!(near(&step.reference.unwrap(), &pose));
    }
    let (drive, summary) = plain().add("/goal", &stamped(1.0, &pose)).read(&BagOptions::default()).unwrap();
    assert_eq!((&drive, summary.kind), (&default, LogKind::Raw));
    assert!(summary.evidence.contains("reference from no topic"), "{summary}");

    for (bag, parts) in [
        (Bag::default(), &["no topic `/scan`", "and no other", "found: no topic"][..]),
        (Bag::default().add("/scan", &scan(1.0, &[1.0])), &["no topic `/odom` for odometry, and no other"]),
        (
            Bag::default().raw("/scan", LaserScan::TYPE, "ros1", &[]).add("/odom", &odometry(1.0, &pose)),
            &["messages of /scan are encoded as `ros1`; allowed: `cdr`"],
        ),
    ] {
        let message = bag.message();
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
}

#[test]
fn static_transforms_tell_the_mount() {
    let level = [0.0, 0.0, 0.0, 1.0];
    let left = [0.0, 0.0, FRAC_PI_2.sin() * 0.5_f64.sqrt(), 0.5_f64.sqrt()];
    let chain = || {
        plain()
            .add("/tf_static", &transform("base_footprint", "base_link", [0.0, 0.0, 0.1], level))
            .add("/tf_static", &transform("/base_link", "mast", [0.5, 0.0, 1.0], left))
    };
    let mount = |bag: &Bag| {
        let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
        (drive.laser, summary.evidence)
    };
    let upright = chain().add("/tf_static", &transform("mast", "laser", [0.25, 0.0, 0.0], level));
    let (laser, evidence) = mount(&upright);
    // A quarter metre ahead on the mast, which looks to the left.
    assert!(
        near(&laser.base_from_laser(), &Pose2::new(0.5, 0.25, FRAC_PI_2)),
        "{:?}",
        laser.base_from_laser()
    );
    assert_eq!(laser.bearings()[0], -0.5);
    assert!(evidence.contains("the laser `laser` is mounted on `base_footprint`"), "{evidence}");

    // Rolled over: what was to its right is to its left.
    let hanging =
        chain().add("/tf_static", &transform("mast", "laser", [0.25, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]));
    let (laser, _) = mount(&hanging);
    assert!(near(&laser.base_from_laser(), &Pose2::new(0.5, 0.25, FRAC_PI_2)));
    assert_eq!(laser.bearings(), [0.5, 0.25, 0.0, -0.25, -0.5]);

    let (s, c) = 0.2_f64.sin_cos();
    let tilted = chain().add("/tf_static", &transform("mast", "laser", [0.0; 3], [0.0, s, 0.0, c]));
    assert!(tilted.message().contains("tilted by 22.9 degrees on `base_footprint`; allowed: at most 10"));

    // No chain, a circle, and a mount that is given.
    for bag in [chain(), chain().add("/tf_static", &transform("laser", "laser", [1.0, 0.0, 0.0], level))] {
        let (laser, evidence) = mount(&bag);
        assert_eq!(laser.base_from_laser(), Pose2::IDENTITY);
        assert!(
            evidence.contains("no static transform leads from `laser` to `base_footprint`"),
            "{evidence}"
        );
    }
    let given = Pose2::new(-1.0, 0.5, 3.0);
    let options = BagOptions { base_from_laser: Some(given), ..BagOptions::default() };
    assert_eq!(tilted.read(&options).unwrap().0.laser.base_from_laser(), given);
}

#[test]
fn errors_name_file_topic_message_value_and_what_is_allowed() {
    let with = |change: &dyn Fn(&mut LaserScan)| {
        let mut other = scan(3.0, &[1.0; 5]);
        change(&mut other);
        plain().add("/scan", &other)
    };
    let pose = |change: &dyn Fn(&mut Pose)| {
        let mut other = odometry(3.0, &Pose2::IDENTITY);
        change(&mut other.pose.pose);
        plain().add("/odom", &other)
    };
    let whole = encode(&scan(3.0, &[1.0; 5])).unwrap();
    for (bag, parts) in [
        (
            with(&|scan| scan.ranges.truncate(4)),
            &["test.mcap: /scan: message 4:", "4 ranges; allowed: 5"][..],
        ),
        (with(&|scan| scan.ranges.clear()), &["/scan: message 4:", "no ranges; allowed: at least one"]),
        (with(&|scan| scan.angle_min = -1.0), &["angle_min is -1; allowed: -0.5, as in the first"]),
        (with(&|scan| scan.angle_increment = 0.5), &["angle_increment is 0.5; allowed: 0.25"]),
        (with(&|scan| scan.range_min = 0.5), &["range_min is 0.5; allowed: 0.25"]),
        (with(&|scan| scan.range_max = 9.0), &["range_max is 9; allowed: 8"]),
        (with(&|scan| scan.time_increment = f32::NAN), &["time_increment is NaN; allowed: a finite number"]),
        (with(&|scan| scan.header.frame_id = "rear".into()), &["frame_id is `rear`; allowed: `laser`"]),
        (pose(&|pose| pose.position.x = f64::NAN), &["/odom: message 3: position is (NaN, 0, 0)"]),
        (pose(&|pose| pose.orientation.w = 0.0), &["length of the quaternion is 0; allowed: 0.99 to 1.01"]),
        (pose(&|pose| pose.orientation.w = f64::NAN), &["length of the quaternion is NaN"]),
        (
            plain().raw("/scan", LaserScan::TYPE, "cdr", &whole[..40]),
            &["message 4: not a message of its type"],
        ),
        (
            plain().raw("/scan", LaserScan::TYPE, "cdr", &[0, 7, 0, 0, 1]),
            &["representation is 00 07; allowed"],
        ),
        (plain().raw("/scan", LaserScan::TYPE, "cdr", &[0]), &["1 bytes are too few for a message"]),
    ] {
        let message = bag.message();
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    }
    let wide = Bag::default()
        .add("/odom", &odometry(1.0, &Pose2::IDENTITY))
        .add("/scan", &LaserScan { range_max: f32::INFINITY, ..scan(1.0, &[1.0]) });
    assert!(matches!(wide.read(&BagOptions::default()), Err(DatasetError::Laser { .. })));

    let folder = tempfile::tempdir().unwrap();
    let missing = read_bag(&folder.path().join("no.mcap"), &BagOptions::default()).unwrap_err();
    assert!(matches!(missing, DatasetError::Open { .. }), "{missing}");
    let directory = read_bag(folder.path(), &BagOptions::default()).unwrap_err();
    assert!(matches!(directory, DatasetError::Folder { .. }), "{directory}");
    let text = read_bytes(b"# CARMEN Logfile\n", &BagOptions::default()).unwrap_err().to_string();
    assert!(text.contains("this is a text file; allowed: a ROS 2 bag (a folder, MCAP or SQLite)"), "{text}");
}

fn refused(bytes: &[u8], limits: &Limits) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.mcap");
    fs::write(&path, bytes).unwrap();
    let message = read(&path, &BagOptions::default(), limits).unwrap_err().to_string();
    assert!(message.len() < 4000 && !message.contains(char::is_control), "{message:?}");
    message
}

#[test]
fn a_bag_unpacks_to_so_much_and_no_more() {
    let plain = plain();
    let mut records = records_of(&plain.bytes());
    // An attachment of zeros.
    records.push(op::ATTACHMENT);
    records.extend(1_000_000_u64.to_le_bytes());
    records.extend(vec![0; 1_000_000]);
    let size = records.len() as u64;
    for packing in ["lz4", "zstd"] {
        let bytes = packed(&records, packing, true);
        assert!(bytes.len() as u64 * UNPACKING_FACTOR < size);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("test.mcap");
        fs::write(&path, &bytes).unwrap();
        let limits = |log_unpacked_bytes| Limits { log_unpacked_bytes, ..Limits::DEFAULT };
        assert!(read(&path, &BagOptions::default(), &limits(size)).is_ok());
        let message = refused(&bytes, &limits(size - 1));
        let part = format!(
            "more than {} bytes that a compressed log unpacks to are not allowed (`--limit",
            size - 1
        );
        assert!(message.contains(&part), "{message}");
    }
    // Several chunks count together, and bytes that aren't compressed don't count.
    let chunk = |packing: &str| {
        let file = packed(&records, packing, true);
        let end = file.len() - (9 + 4) - (9 + 20) - MAGIC.len();
        (file[..end].to_vec(), file[end..].to_vec())
    };
    let limits = Limits { log_unpacked_bytes: size, ..Limits::DEFAULT };
    let ((mut twice, end), start) = (chunk("lz4"), MAGIC.len() + 9 + 8);
    twice.extend_from_within(start..);
    let message = refused(&[&twice[..], &end].concat(), &limits);
    assert!(message.contains("bytes that a compressed log unpacks to"), "{message}");
    let (plain, end) = chunk("");
    let message = refused(&[&plain[..], &plain[start..], &end].concat(), &limits);
    assert!(message.contains("after one of 3 s"), "{message}");
}

#[test]
fn a_bag_costs_so_much_and_no_more() {
    let bytes = plain().bytes();
    // Three scans of five beams, each counting for a hundred readings more; five messages.
    for (limits, message) in [
        (
            Limits { log_readings: 314, ..Limits::DEFAULT },
            "/scan: message 3: more than 314 range readings of a log (100 more for each scan) are not allowed \
             (`--limit log_readings=628` allows twice as many)",
        ),
        (
            Limits { log_messages: 4, ..Limits::DEFAULT },
            "/scan: message 3: more than 4 lines of a text log or messages read from a bag are not allowed \
             (`--limit log_messages=8` allows twice as many)",
        ),
    ] {
        let found = refused(&bytes, &limits);
        assert!(found.ends_with(message), "{found}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.mcap");
    fs::write(&path, &bytes).unwrap();
    let limits = Limits { log_readings: 315, log_messages: 5, ..Limits::DEFAULT };
    assert!(read(&path, &BagOptions::default(), &limits).is_ok());
}

#[test]
fn names_channels_and_frames_are_limited() {
    let pose = transform("base_link", "x", [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    let mut frames = pose.clone();
    frames.transforms = (0..10_001)
        .map(|i| TransformStamped { child_frame_id: format!("frame{i}"), ..pose.transforms[0].clone() })
        .collect();
    let mut long = pose.clone();
    long.transforms[0].header.frame_id = "\u{1b}".repeat(1001);
    let channels = |count: usize| {
        (0..count).fold(plain(), |bag, i| bag.raw(&format!("/\u{1b}{i}"), "std_msgs/msg/String", "cdr", &[]))
    };
    for (bag, part) in [
        (plain().raw(&"\u{1b}".repeat(1001), "", "cdr", &[]), "..` has 1001 bytes; allowed: at most 1000"),
        (plain().raw("/a", &"\u{1b}".repeat(1001), "cdr", &[]), "has 1001 bytes; allowed: at most 1000"),
        (plain().add("/tf_static", &long), "/tf_static: message 1: frame `\\u{1b}"),
        (plain().add("/tf_static", &frames), "more than 10000 pairs of frames"),
        (channels(10_000), "more than 10000 channels"),
        (channels(30).without("/scan"), "/\\u{1b}1 (std_msgs/msg/String, 1 messages)"),
        (channels(30).without("/scan"), ", 11 more"),
    ] {
        let message = refused(&bag.bytes(), &Limits::DEFAULT);
        assert!(message.contains(part), "{message}");
    }
}

/// The mcap library reserves memory for a name by its claimed length before it looks whether it is there.
#[test]
fn a_name_longer_than_its_record_is_refused() {
    let bytes = plain().raw("/a", "some_msgs/msg/Name", "cdr", &[]).bytes();
    let name = b"some_msgs/msg/Name";
    let places = (4..bytes.len()).filter(|at| bytes[*at..].starts_with(name));
    // Each schema stands before its messages and again in the summary, which isn't read.
    let at = places.min().unwrap();
    for length in [19_u32, 1 << 31, u32::MAX] {
        let mut bytes = bytes.clone();
        bytes[at - 4..at].copy_from_slice(&length.to_le_bytes());
        let message = refused(&bytes, &Limits::DEFAULT);
        assert!(
            (length == 19) != message.contains("a schema or a channel is longer than its record"),
            "{length}: {message}"
        );
    }
}

#[test]
fn a_record_that_is_skipped_may_be_of_any_length() {
    let large = vec![0; (super::bag::LARGEST_RECORD + 1) as usize];
    let (expected, _) = plain().read(&BagOptions::default()).unwrap();
    let image = plain().raw("/image", "sensor_msgs/msg/Image", "cdr", &large);
    assert_eq!(image.read(&BagOptions::default()).unwrap().0, expected);
    let scan = plain().raw("/scan", LaserScan::TYPE, "cdr", &large);
    let message = refused(&scan.bytes(), &Limits::DEFAULT);
    assert!(
        message.ends_with("/scan: message 4: a record has 16777217 bytes; allowed: at most 16777216"),
        "{message}"
    );
}

#[test]
fn numbers_that_arithmetic_cannot_bear_are_refused() {
    let scan_with = |change: &dyn Fn(&mut LaserScan)| {
        let mut scan = scan(1.0, &[1.0; 5]);
        change(&mut scan);
        Bag::default().add("/odom", &odometry(1.0, &Pose2::IDENTITY)).add("/scan", &scan)
    };
    let far = Pose2 { x: 1e300, ..Pose2::IDENTITY };
    let claims = {
        let mut whole = encode(&scan(1.0, &[1.0; 5])).unwrap();
        let count = whole.len() - 2 * (4 + 5 * 4);
        whole[count..count + 4].copy_from_slice(&[0xff; 4]);
        Bag::default()
            .raw("/scan", LaserScan::TYPE, "cdr", &whole)
            .add("/odom", &odometry(1.0, &Pose2::IDENTITY))
    };
    for (bag, part) in [
        (plain().add("/odom", &odometry(3.0, &far)), "/odom: message 3: position is (1"),
        (plain().add("/reference", &odometry(3.0, &far)), "allowed: finite numbers up to 1e9"),
        (
            plain().add("/tf_static", &transform("a", "b", [0.0, 0.0, 1e10], [0.0, 0.0, 0.0, 1.0])),
            "/tf_static",
        ),
        (scan_with(&|scan| scan.angle_increment = 1e30), "bearing of a beam is 1"),
        (scan_with(&|scan| scan.angle_min = f32::NAN), "bearing 0 of the laser is not finite"),
        (scan_with(&|scan| scan.time_increment = 1e10), "time_increment is 10000000000; allowed"),
        (scan_with(&|scan| scan.time_increment = 9e8), "time of a beam is 1800000000; allowed"),
        (scan_with(&|scan| scan.range_max = f32::MAX), "maximum range is 34028"),
        (claims, "not a message of its type: sequence length 4294967295 exceeds"),
    ] {
        let message = refused(&bag.bytes(), &Limits::DEFAULT);
        assert!(message.contains(part), "{message}");
    }
}

/// As other programs see a written bag.
#[test]
fn a_written_bag_has_velocities_a_rate_and_all_frames() {
    let step = |secs: f64, x: f64, theta: f64| DriveStep {
        stamp_secs: secs,
        odometry: Pose2::new(x, 0.0, theta),
        reference: Some(Pose2::new(10.0, x, FRAC_PI_2 + theta)),
        scan: Scan { ranges: vec![1.0] },
    };
    let laser = Laser::new(vec![0.0], vec![0.0], 0.0, 8.0, Pose2::IDENTITY).unwrap();
    let drive = Drive { laser, steps: vec![step(1.0, 0.0, 0.0), step(1.5, 1.0, 0.0), step(3.0, 1.0, 0.75)] };
    let mut bytes = Vec::new();
    encode_mcap(Path::new("drive.mcap"), &drive, 0, &mut bytes).unwrap();
    let (mut twists, mut scan_times, mut map_from_odom) = (Vec::new(), Vec::new(), Vec::new());
    let mut latched = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let channel = &message.channel;
        let durability = channel.metadata["offered_qos_profiles"]
            .lines()
            .find_map(|line| line.strip_prefix("  durability: "));
        latched.insert(channel.topic.clone(), durability.unwrap() == "1");
        match channel.topic.as_str() {
            "/odom" => {
                let odometry: Odometry = decode(&message.data).unwrap();
                twists.push((odometry.twist.linear.x, odometry.twist.angular.z));
            }
            "/scan" => scan_times.push(decode::<LaserScan>(&message.data).unwrap().scan_time),
            "/tf" => {
                let TfMessage { transforms } = decode(&message.data).unwrap();
                if transforms[0].header.frame_id == "map" {
                    map_from_odom.push(transforms[0].transform.projected().unwrap());
                }
            }
            _ => {}
        }
    }
    assert_eq!(twists, [(2.0, 0.0), (2.0, 0.0), (0.0, 0.5)]);
    assert_eq!(scan_times, [1.0; 3]);
    assert_eq!(map_from_odom.len(), 3);
    assert!(
        map_from_odom.iter().all(|pose| near(pose, &Pose2::new(10.0, 0.0, FRAC_PI_2))),
        "{map_from_odom:?}"
    );
    assert_eq!(
        latched.into_iter().filter(|(_, latched)| *latched).map(|(topic, _)| topic).collect::<Vec<_>>(),
        ["/tf_static"]
    );
}

/// The summary's records are put in order after the library wrote them.
#[test]
fn a_written_summary_is_in_order_and_its_check_sum_right() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.mcap");
    let (drive, _) = plain().read(&BagOptions::default()).unwrap();
    write_mcap(&path, &drive).unwrap();
    let bytes = fs::read(&path).unwrap();
    let footer = mcap::read::footer(&bytes).unwrap();
    let summed = bytes.len() - MAGIC.len() - 4;
    let summary = &bytes[footer.summary_start as usize..summed];
    assert_eq!(footer.summary_crc, crc32fast::hash(summary));
    let (mut schemas, mut channels) = (Vec::new(), Vec::new());
    for record in mcap::read::LinearReader::sans_magic(&summary[..summary.len() - 9 - 16]) {
        match record.unwrap() {
            Record::Schema { header, .. } => schemas.push(header.id),
            Record::Channel(channel) => channels.push(channel.id),
            _ => {}
        }
    }
    assert_eq!((schemas, channels), (vec![1, 2, 3], vec![1, 2, 3, 4]));
}

#[test]
fn data_without_an_end_are_refused() {
    let bytes = packed(&records_of(&plain().bytes()), "", true);
    let end = bytes.len() - (9 + 4) - (9 + 20) - MAGIC.len();
    let message = refused(&[&bytes[..end], &bytes[end + 9 + 4..]].concat(), &Limits::DEFAULT);
    assert!(message.contains("not a complete MCAP file: the data have no end"), "{message}");
}

#[test]
fn big_endian_messages_are_read() {
    let mut data = vec![0, 0, 0, 0];
    data.extend(re_cdr::to_vec::<_, re_cdr::BigEndian>(&scan(3.0, &[1.0, 2.0, 3.0, 4.0, 5.0])).unwrap());
    let mut bag = plain();
    let (expected, _) = bag.read(&BagOptions::default()).unwrap();
    bag.messages.pop();
    let (drive, _) = bag.raw("/scan", LaserScan::TYPE, "cdr", &data).read(&BagOptions::default()).unwrap();
    assert_eq!(drive, expected);
}

#[test]
fn the_name_tells_the_format_of_a_log_to_write() {
    for (name, format) in [
        ("drive.mcap", LogFormat::Bag),
        ("drive.MCAP", LogFormat::Bag),
        ("drive.log", LogFormat::Carmen),
        ("drive.log.gz", LogFormat::Carmen),
        ("mcap", LogFormat::Carmen),
    ] {
        assert_eq!(LogFormat::of_name(Path::new(name)), format, "{name}");
    }
}

#[test]
fn a_carmen_log_has_no_topics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.log");
    fs::write(&path, "FLASER 1 1 0 0 0 0 0 0 1 h 1\n").unwrap();
    let topics = BagTopics { scan: Some("/scan".to_owned()), ..BagTopics::default() };
    let refused = read_log(&path, &LogOptions { topics, ..LogOptions::default() }).unwrap_err().to_string();
    assert!(
        refused.ends_with("a topic is named; allowed: topics of a ROS 2 bag; found: a CARMEN log"),
        "{refused}"
    );
}

#[test]
fn times_a_bag_cannot_hold_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (drive, _) = plain().read(&BagOptions::default()).unwrap();
    for time in [-1.0, 2_147_483_647.0] {
        let mut drive = drive.clone();
        drive.steps[1].stamp_secs = time;
        let message = write_mcap(&folder.path().join("d.mcap"), &drive).unwrap_err().to_string();
        assert!(message.contains(&format!("scan 1: the time is {time} s; allowed: 0 to")), "{message}");
    }
    assert_eq!(Time::from_secs(1.999_999_999_9), Some(Time { sec: 2, nanosec: 0 }));
}
