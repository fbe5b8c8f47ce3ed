//! Bags that are copied with changes.

use super::*;
use crate::{BagCopy, DriveEdit, OdometryEdit};

/// Doubles readings, and moves everything that can be moved.
struct Moves {
    mount: Option<[Pose2; 2]>,
    odometry: Option<Ahead>,
    delay_secs: [f64; 2],
    left_out_secs: f64,
}

/// A robot that has got a metre farther, 0.25 rad to the left, twice as fast.
struct Ahead;

const STEP: Pose2 = Pose2 { x: 1.0, y: 0.0, theta: 0.25 };

impl OdometryEdit for Ahead {
    fn pose(&self, _: f64, pose: &Pose2) -> Pose2 {
        pose.compose(&STEP)
    }

    fn velocity(&self, _: f64, velocity: &Pose2) -> Pose2 {
        Pose2 { x: 2.0 * velocity.x, y: 2.0 * velocity.y, theta: 2.0 * velocity.theta }
    }

    fn correction(&self, secs: f64, map_from_odom: &Pose2) -> Pose2 {
        Pose2 { x: map_from_odom.x + secs, ..*map_from_odom }
    }
}

impl DriveEdit for Moves {
    fn scan(&mut self, secs: f64, readings: &mut [f32]) -> bool {
        readings[0] *= 2.0;
        readings[1] = 8.0;
        secs != self.left_out_secs
    }

    fn delay_secs(&self) -> [f64; 2] {
        self.delay_secs
    }

    fn mount(&self) -> Option<[Pose2; 2]> {
        self.mount
    }

    fn odometry(&self) -> Option<&dyn OdometryEdit> {
        self.odometry.as_ref().map(|ahead| ahead as &dyn OdometryEdit)
    }
}

const NONE: Moves = Moves { mount: None, odometry: None, delay_secs: [0.0; 2], left_out_secs: 0.0 };

/// The bytes of a copy of a bag, and the drive before.
fn copied(path: &Path, mut edit: Moves) -> Result<(Vec<u8>, Drive), DatasetError> {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("copy.mcap");
    let (copy, drive, _) = BagCopy::open(path, &BagOptions::default())?;
    copy.write(&out, &mut edit)?;
    Ok((fs::read(out).unwrap(), drive))
}

/// Topic, type, definition, metadata, times and content of each message.
type Content = (String, String, Vec<u8>, BTreeMap<String, String>, [u64; 2], Vec<u8>);

fn messages(bytes: &[u8]) -> Vec<Content> {
    let of = |message: mcap::Message<'_>| {
        let channel = &message.channel;
        let times = [message.log_time, message.publish_time];
        let schema = channel.schema.as_ref();
        let (name, text) =
            schema.map(|schema| (schema.name.clone(), schema.data.to_vec())).unwrap_or_default();
        (channel.topic.clone(), name, text, channel.metadata.clone(), times, message.data.to_vec())
    };
    mcap::MessageStream::new(bytes).unwrap().map(|message| of(message.unwrap())).collect()
}

/// The plain bag with transforms and topics that no drive is read from.
fn rich() -> Bag {
    let mut all = plain();
    let turned = [0.0, 0.0, 1.0, 0.0];
    all = all
        .add("/tf_static", &transform("plate", "laser", [0.1, 0.0, 0.3], [1.0, 0.0, 0.0, 0.0]))
        .add("/tf_static", &transform("base_footprint", "plate", [0.2, 0.1, 0.1], turned))
        .add("/tf", &transform("odom", "base_footprint", [1.0, 2.0, 0.5], [0.0, 0.0, 0.0, 1.0]))
        .add("/tf", &transform("map", "odom", [5.0, 6.0, 0.0], [0.0, 0.0, 0.0, 1.0]))
        .raw("/camera", "sensor_msgs/msg/Image", "cdr", &[7; 1000])
        .raw("/json", "", "json", b"{}");
    all
}

#[test]
fn what_no_drive_is_read_from_is_copied_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    // As our own writer has it: with definitions, quality of service and times.
    let whole = rich().bytes();
    fs::write(&path, &whole).unwrap();
    let (copy, _) = copied(&path, NONE).unwrap();
    let (before, after) = (messages(&whole), messages(&copy));
    assert_eq!(before.len(), after.len());
    for (before, after) in before.iter().zip(&after) {
        if before.0 == "/scan" {
            assert_ne!(before.5, after.5);
        } else {
            // Definitions that are missing and known are added.
            assert_eq!(
                (&before.0, &before.1, &before.3, &before.5),
                (&after.0, &after.1, &after.3, &after.5)
            );
        }
    }
    let (again, _) = copied(&path, NONE).unwrap();
    assert!(copy == again, "the same input gives the same bytes");
    assert!(mcap::Summary::read(&copy).unwrap().unwrap().stats.unwrap().message_count == after.len() as u64);

    let (drive, _) = read_bytes(&whole, &BagOptions::default()).unwrap();
    let written = folder.path().join("own.mcap");
    write_log(&written, &drive).unwrap();
    let own = fs::read(&written).unwrap();
    let (copy, _) = copied(&written, NONE).unwrap();
    for (before, after) in messages(&own).iter().zip(&messages(&copy)) {
        assert_eq!((&before.1, &before.2, &before.3, before.4), (&after.1, &after.2, &after.3, after.4));
        assert!(before.0 == "/scan" || before.5 == after.5, "{}", before.0);
        assert!(!after.2.is_empty() && after.3.contains_key("offered_qos_profiles"));
    }
}

#[test]
fn the_drive_of_a_copy_is_the_changed_one() {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in [("bag.mcap", rich().bytes()), ("bag.db3", rich().db3())] {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        let mount = Pose2::new(0.1, 0.1, PI);
        let said = Pose2::new(0.4, -0.2, -2.0);
        let edit = Moves {
            mount: Some([mount, said]),
            odometry: Some(Ahead),
            delay_secs: [-0.5, 0.02],
            left_out_secs: 3.0,
        };
        let (copy, before) = copied(&path, edit).unwrap();
        assert!(near(&before.laser.base_from_laser(), &mount), "{:?}", before.laser);
        let (after, _) = read_bytes(&copy, &BagOptions::default()).unwrap();
        // Of three scans the last is left out; the others are half a second later.
        assert_eq!(after.steps.len(), 2, "{name}");
        assert!(near(&after.laser.base_from_laser(), &said), "{:?}", after.laser.base_from_laser());
        // The laser hangs upside down: its bearings are mirrored, before and after.
        assert_eq!(after.laser.bearings(), before.laser.bearings());
        for (beam, (after, before)) in
            after.laser.beam_times_secs().iter().zip(before.laser.beam_times_secs()).enumerate()
        {
            assert!((after - (before - 0.02 * beam as f32)).abs() < 1e-6);
        }
        for (after, before) in after.steps.iter().zip(&before.steps) {
            assert!((after.stamp_secs - before.stamp_secs - 0.5).abs() < 1e-9);
            assert_eq!(after.scan.ranges, [2.0, 8.0, 3.0, 4.0, 5.0]);
        }
        let first = messages(&copy).into_iter().find(|message| message.0 == "/scan").unwrap();
        let first: LaserScan = decode(&first.5).unwrap();
        assert_eq!(first.ranges, [2.0, f32::INFINITY, 3.0, 4.0, 5.0], "no return as REP-117 has it");
        assert_eq!(first.intensities, [1.0; 5]);
        let odometry = messages(&copy).into_iter().find(|message| message.0 == "/odom").unwrap();
        let odometry: Odometry = decode(&odometry.5).unwrap();
        assert!(near(&odometry.pose.pose.projected().unwrap(), &Pose2::new(1.0, 2.0, 3.0).compose(&STEP)));
        let transforms: Vec<TransformStamped> = messages(&copy)
            .into_iter()
            .filter(|message| message.0 == "/tf")
            .flat_map(|message| decode::<TfMessage>(&message.5).unwrap().transforms)
            .collect();
        assert!(near(&transforms[0].transform.projected().unwrap(), &Pose2::new(2.0, 2.0, 0.25)));
        assert_eq!(transforms[0].transform.position.z, 0.5, "the height stays");
        assert!(near(&transforms[1].transform.projected().unwrap(), &Pose2::new(5.0, 6.0, 0.0)));
    }
}

#[test]
fn a_folder_of_packed_files_is_copied() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rosbags");
    let (copy, before) = copied(&path, NONE).unwrap();
    let (after, _) = read_bytes(&copy, &BagOptions::default()).unwrap();
    assert_eq!(before.steps.len(), after.steps.len());
    for (before, after) in before.steps.iter().zip(&after.steps) {
        assert_eq!(after.reference, before.reference);
        assert_eq!(after.scan.ranges[2..5].len(), before.scan.ranges[2..5].len());
        assert_eq!(after.scan.ranges[4].to_bits(), before.scan.ranges[4].to_bits());
    }
}

#[test]
fn what_cannot_be_changed_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    fs::write(&path, plain().bytes()).unwrap();
    let mount = Some([Pose2::IDENTITY, STEP]);
    let error = copied(&path, Moves { mount, ..NONE }).unwrap_err().to_string();
    assert!(error.contains("no transform tells where the laser is mounted"), "{error}");
    let error = copied(&path, Moves { delay_secs: [10.0, 0.0], ..NONE }).unwrap_err().to_string();
    assert!(error.contains("the stamp would be before 0"), "{error}");
}
