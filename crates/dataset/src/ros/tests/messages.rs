//! Messages of a bag become scans, odometry and reference; those that make no sense are refused.

use super::*;

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
    assert!(bag.message().contains(
        "/scan: 1 messages have stamps that are seconds off those before and after; allowed: one in 10"
    ));
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
    let message = late.message();
    assert!(
        message.contains(
            "none of the 1 scans, from 2.500 s to 2.500 s, lies within the time of the odometry, from 1.000 s to 2.000 s"
        ),
        "{message}"
    );
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
fn errors_name_file_topic_message_value_and_what_is_allowed() {
    let with = |change: &dyn Fn(&mut LaserScan)| {
        let mut other = scan(3.0, &[1.0; 5]);
        change(&mut other);
        plain().add("/scan", &other)
    };
    let pose = |change: &dyn Fn(&mut Pose)| {
        let mut other = odometry(3.0, &Pose2::IDENTITY);
        change(&mut other.pose.pose);
        // The only one: some of many are left out.
        plain().without("/odom").add("/odom", &other)
    };
    let whole = encode(&scan(3.0, &[1.0; 5])).unwrap();
    for (bag, parts) in [
        (
            with(&|scan| scan.ranges.truncate(4)),
            &[
                "test.mcap: /scan: message 4:",
                "4 ranges from -0.5 rad, every 0.25 rad; allowed: about 5 from -0.5",
            ][..],
        ),
        (with(&|scan| scan.angle_min = -1.0), &["5 ranges from -1 rad", "as in the first"]),
        (
            with(&|scan| scan.angle_increment = 0.5),
            &["every 0.5 rad; allowed: about 5 from -0.5, every 0.25"],
        ),
        (with(&|scan| scan.range_min = 0.5), &["range_min is 0.5; allowed: 0.25"]),
        (with(&|scan| scan.range_max = 9.0), &["range_max is 9; allowed: 8"]),
        (with(&|scan| scan.time_increment = f32::NAN), &["time_increment is NaN; allowed: a finite number"]),
        (with(&|scan| scan.header.frame_id = "rear".into()), &["frame_id is `rear`; allowed: `laser`"]),
        (pose(&|pose| pose.position.x = f64::NAN), &["/odom: message 1: position is (NaN, 0, 0)"]),
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
    assert!(wide.message().contains(
        "/scan: message 1: range_max is inf; allowed: a finite number above range_min, or `--max-range`"
    ));

    let folder = tempfile::tempdir().unwrap();
    let missing = read_bag(&folder.path().join("no.mcap"), &BagOptions::default()).unwrap_err();
    assert!(matches!(missing, DatasetError::Open { .. }), "{missing}");
    let directory = read_bag(folder.path(), &BagOptions::default()).unwrap_err();
    assert!(matches!(directory, DatasetError::Folder { .. }), "{directory}");
    let text = read_bytes(b"# CARMEN Logfile\n", &BagOptions::default()).unwrap_err().to_string();
    assert!(text.contains("this is a text file; allowed: a ROS 2 bag (a folder, MCAP or SQLite)"), "{text}");
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
        (plain().without("/odom").add("/odom", &odometry(3.0, &far)), "/odom: message 1: position is (1"),
        (plain().add("/reference", &odometry(3.0, &far)), "allowed: finite numbers up to 1e9"),
        (
            plain().add("/tf_static", &transform("a", "b", [0.0, 0.0, 1e10], [0.0, 0.0, 0.0, 1.0])),
            "/tf_static",
        ),
        (scan_with(&|scan| scan.angle_increment = 1e30), "angle_increment is 1"),
        (scan_with(&|scan| scan.angle_increment = 0.0), "angle_increment is 0.0 rad; allowed: 0.000001 to"),
        // Degrees.
        (
            scan_with(&|scan| scan.angle_increment = -10.0),
            "angle_increment is -10.0 rad; allowed: 0.000001 to",
        ),
        (scan_with(&|scan| scan.angle_increment = f32::NAN), "angle_increment is NaN rad"),
        (scan_with(&|scan| scan.angle_min = f32::NAN), "angle_min is NaN rad"),
        (scan_with(&|scan| scan.time_increment = 1e10), "time_increment is 10000000000; allowed"),
        (scan_with(&|scan| scan.time_increment = 9e8), "time of a beam is 1800000000; allowed"),
        (
            scan_with(&|scan| (scan.range_min, scan.range_max) = (0.0, 1e-30)),
            "maximum range is 1e-30 m; allowed: 0.001 to 10000 m",
        ),
        (
            scan_with(&|scan| scan.range_max = f32::MAX),
            "maximum range is 3.4028235e38 m; allowed: 0.001 to 10000 m",
        ),
        (claims, "not a message of its type: sequence length 4294967295 exceeds"),
    ] {
        let message = refused(&bag.bytes(), &Limits::DEFAULT);
        assert!(message.contains(part), "{message}");
    }
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
