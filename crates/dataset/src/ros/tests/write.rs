//! Bags that are written.

use super::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn a_written_drive_reads_back(mut drive in drive(), known in any::<bool>()) {
        // Between two known references a reader interpolates: all or none.
        // A robot drives a metre or so, a reference isn't the same at all times, and a sweep of 40 beams in 40 ms is over before the next one.
        for (step, i) in drive.steps.iter_mut().zip(0_u32..) {
            step.stamp_secs += 0.05 * f64::from(i);
            step.odometry = Pose2::new(1e-4 * step.odometry.x, 1e-4 * step.odometry.y, step.odometry.theta);
            step.reference = known.then(|| Pose2::new(1.0 + 0.01 * f64::from(i), -2.0, 3.0));
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
