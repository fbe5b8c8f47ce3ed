//! Recordings with faults that are mended and told.

use super::*;

/// A scan of 20 beams over a radian.
fn wide_scan(secs: f64, beams: u16) -> LaserScan {
    LaserScan {
        angle_increment: 1.0 / f32::from(beams - 1),
        time_increment: 0.0,
        ranges: (0..beams).map(|beam| 1.0 + f32::from(beam) / f32::from(beams - 1)).collect(),
        ..scan(secs, &[])
    }
}

/// A robot that drives along x with 1 m/s, for the seconds that `is_recorded` holds for: odometry ten times a second, scans every
/// other time.
fn driving(secs: u32, is_recorded: impl Fn(f64) -> bool, x: impl Fn(f64) -> f64) -> Bag {
    let mut bag = Bag::default();
    for tick in 0..=10 * secs {
        let now = f64::from(tick) / 10.0;
        if is_recorded(now) {
            bag = bag.add("/odom", &odometry(now, &Pose2::new(x(now), 0.0, 0.0)));
        }
        // At other times than the odometry, and the last one after it.
        if tick % 2 == 0 {
            bag = bag.add("/scan", &wide_scan(now + 0.03, 20));
        }
    }
    bag
}

fn remark(summary: &LogSummary, part: &str) {
    assert!(summary.remarks.iter().any(|remark| remark.contains(part)), "{part}: {:?}", summary.remarks);
}

#[test]
fn a_clean_recording_has_no_remarks() {
    let (drive, summary) = driving(5, |_| true, |now| now).read(&BagOptions::default()).unwrap();
    // The last scan is after the odometry, as in most recordings.
    assert_eq!((drive.steps.len(), summary.scans_dropped, &summary.remarks), (25, 1, &Vec::new()));
}

#[test]
fn poses_that_are_none_are_left_out() {
    let mut zero = odometry(2.0, &Pose2::IDENTITY);
    zero.pose.pose.orientation.w = 0.0;
    let far = Pose2 { x: 1e300, ..Pose2::IDENTITY };
    let (expected, _) = plain().read(&BagOptions::default()).unwrap();
    for odd in [zero, odometry(2.0, &far), odometry(2.0, &Pose2 { x: f64::NAN, ..Pose2::IDENTITY })] {
        let (drive, summary) = plain().add("/odom", &odd).read(&BagOptions::default()).unwrap();
        assert_eq!(drive, expected);
        remark(&summary, "Messages of /odom without a usable pose of the odometry are left out: 1 (");
    }
    let reference = plain().add("/reference", &odometry(1.2, &far));
    assert!(reference.message().contains("/reference: message 1: position is"), "{}", reference.message());
}

/// Two poses 50 m away are no drive there and back. A robot that goes on from elsewhere has jumped.
#[test]
fn poses_where_no_robot_can_be_are_left_out() {
    let astray = |now: f64| if (2.05..2.25).contains(&now) { 50.0 } else { 0.0 };
    let (drive, summary) =
        driving(5, |_| true, |now| now + astray(now)).read(&BagOptions::default()).unwrap();
    remark(
        &summary,
        "Poses of /odom that lie where no robot can be between their neighbours are left out: 2.",
    );
    assert!(drive.steps.iter().all(|step| (step.odometry.x - step.stamp_secs).abs() < 1e-9), "{drive:?}");
    let elsewhere = |now: f64| if now > 2.05 { now + 50.0 } else { now };
    let (drive, summary) = driving(5, |_| true, elsewhere).read(&BagOptions::default()).unwrap();
    assert!(summary.remarks.is_empty() && (drive.steps[24].odometry.x - 54.83).abs() < 1e-9);
}

/// Four seconds without odometry. A robot that drove in them was anywhere; one that stood still was there.
#[test]
fn poses_are_not_interpolated_across_a_hole() {
    let is_recorded = |now: f64| !(3.05..6.95).contains(&now);
    let (drive, summary) = driving(10, is_recorded, |now| now).read(&BagOptions::default()).unwrap();
    assert!(drive.steps.iter().all(|step| !(3.0..7.0).contains(&step.stamp_secs)));
    remark(&summary, "21 of 51 scans are left out: no odometry was recorded");
    let waits = |now: f64| if now < 3.0 { now } else { 3.0 + (now - 7.0).max(0.0) };
    let (drive, summary) = driving(10, is_recorded, waits).read(&BagOptions::default()).unwrap();
    assert_eq!((drive.steps.len(), &summary.remarks), (50, &Vec::new()));
}

#[test]
fn a_reference_that_stands_still_is_none() {
    let mut bag = driving(5, |_| true, |now| now);
    for tick in 0..=50_u32 {
        let now = f64::from(tick) / 10.0;
        let known = if (1.95..4.05).contains(&now) { 2.0 } else { now };
        bag = bag.add("/reference", &stamped(now, &Pose2::new(known, 1.0, 0.0)));
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.mcap");
    fs::write(&path, bag.bytes()).unwrap();
    let (drive, summary) = read_log(&path, &LogOptions::default()).unwrap();
    remark(
        &summary,
        "The reference stands still or creeps evenly for 1.8 s, in which the odometry comes 1.80 m away",
    );
    let without: Vec<f64> =
        drive.steps.iter().filter(|step| step.reference.is_none()).map(|step| step.stamp_secs).collect();
    // And the one after them, whose pose is between the last one and the next.
    assert_eq!(without.len(), 10, "{without:?}");
    assert!(without.iter().all(|secs| (2.1..4.3).contains(secs)), "{without:?}");
}

/// Twenty beams over a radian and nineteen, whose readings grow evenly with the bearing: each beam has a reading of at most half a beam
/// beside it.
#[test]
fn scans_with_a_beam_less_are_put_onto_the_beams_of_the_first() {
    let bag = Bag::default()
        .add("/odom", &odometry(1.0, &Pose2::IDENTITY))
        .add("/odom", &odometry(2.0, &Pose2::IDENTITY))
        .add("/scan", &wide_scan(1.0, 20))
        .add("/scan", &wide_scan(1.5, 19));
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    remark(&summary, "1 of 2 scans have other beams than the first");
    for (first, second) in drive.steps[0].scan.ranges.iter().zip(&drive.steps[1].scan.ranges) {
        assert!((first - second).abs() < 0.5 / 18.0 + 1e-5, "{first} {second}");
    }
    // The last of the beams isn't there.
    let mut cut = wide_scan(1.5, 20);
    cut.ranges.truncate(19);
    let mut bag = bag;
    bag.messages[3].3 = encode(&cut).unwrap();
    let (drive, _) = bag.read(&BagOptions::default()).unwrap();
    assert_eq!(drive.steps[1].scan.ranges[..19], drive.steps[0].scan.ranges[..19]);
    assert!(drive.steps[1].scan.ranges[19].is_nan());
    bag.messages[3].3 = encode(&wide_scan(1.5, 15)).unwrap();
    assert!(bag.message().contains("the scan has 15 ranges from -0.5 rad"), "{}", bag.message());
}

/// A first turn that isn't whole is left out.
#[test]
fn the_first_whole_scan_tells_the_beams() {
    let bag = Bag::default()
        .add("/odom", &odometry(1.0, &Pose2::IDENTITY))
        .add("/odom", &odometry(2.0, &Pose2::IDENTITY))
        .add("/scan", &wide_scan(1.2, 12))
        .add("/scan", &wide_scan(1.4, 20))
        .add("/scan", &wide_scan(1.6, 20));
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    assert_eq!((drive.laser.beam_count(), drive.steps.len(), summary.scans_dropped), (20, 2, 1));
}

/// A localizer's correction that comes seldom, and jumps by half a metre where the odometry's origin is far away, is bridged and kept.
#[test]
fn corrections_are_no_motion() {
    let mut bag = driving(10, |_| true, |now| now);
    for (secs, x) in [(0.0, 0.0), (0.1, 0.6), (0.2, 0.0), (0.3, 0.6), (8.0, 0.0), (10.0, 0.0)] {
        let mut correction = transform("map", "odom", [x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
        correction.transforms[0].header = header(secs, "map");
        bag = bag.add("/tf", &correction);
    }
    for tick in 0..=100_u32 {
        let now = f64::from(tick) / 10.0;
        let mut motion = transform("odom", "base_footprint", [now, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
        motion.transforms[0].header = header(now, "odom");
        bag = bag.add("/tf", &motion);
    }
    bag.messages.sort_by(|a, b| a.0.cmp(&b.0));
    let topics = BagTopics { reference: Some("map:base_footprint".to_owned()), ..BagTopics::default() };
    let (drive, _) = bag.read(&BagOptions { topics, ..BagOptions::default() }).unwrap();
    assert!(drive.steps.iter().all(|step| step.reference.is_some()));
    // Half-way between the corrections of 0.1 and 0.2 s.
    let second = drive.steps[1].reference.unwrap();
    assert!((second.x - (0.23 + 0.18)).abs() < 1e-9, "{second:?}");
}

#[test]
fn beams_are_of_the_stamp_where_their_times_cannot_be() {
    for (increment, is_kept) in [(0.009, true), (0.2, false), (-0.009, true), (-0.2, false)] {
        let mut bag = Bag::default();
        for tick in 0..10_u32 {
            let now = f64::from(tick) / 5.0;
            let scan = LaserScan { time_increment: increment, ..wide_scan(now, 20) };
            bag = bag.add("/odom", &odometry(now, &Pose2::IDENTITY)).add("/scan", &scan);
        }
        let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
        let sweep = drive.laser.beam_times_secs()[19];
        assert!(
            (f64::from(sweep) - if is_kept { 19.0 * f64::from(increment) } else { 0.0 }).abs() < 1e-6,
            "{sweep}"
        );
        assert_eq!(summary.remarks.iter().any(|remark| remark.starts_with("time_increment is")), !is_kept);
    }
}

#[test]
fn static_transforms_may_change_and_may_be_told_the_other_way_round() {
    let level = [0.0, 0.0, 0.0, 1.0];
    let first = plain().add("/tf_static", &transform("base_footprint", "laser", [0.5, 0.0, 0.0], level));
    assert!(first.read(&BagOptions::default()).unwrap().1.remarks.is_empty());
    let changed = first.add("/tf_static", &transform("base_footprint", "laser", [0.3, 0.0, 0.0], level));
    let (drive, summary) = changed.read(&BagOptions::default()).unwrap();
    remark(&summary, "or a frame has two parents (base_footprint:laser)");
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(0.3, 0.0, 0.0)));
    let quarter = [0.0, 0.0, 0.5_f64.sqrt(), 0.5_f64.sqrt()];
    let reversed = plain().add("/tf_static", &transform("laser", "base_footprint", [0.5, 0.0, 0.0], quarter));
    let (drive, _) = reversed.read(&BagOptions::default()).unwrap();
    let expected = Pose2::new(0.5, 0.0, FRAC_PI_2).inverse();
    assert!(near(&drive.laser.base_from_laser(), &expected), "{:?}", drive.laser.base_from_laser());
}

/// A reference that turns about an axis in the floor.
#[test]
fn a_reference_that_is_not_upright_is_told() {
    let mut bag = driving(2, |_| true, |now| now);
    for tick in 0..=20_u32 {
        let now = f64::from(tick) / 10.0;
        let mut pose = stamped(now, &Pose2::new(now, 0.0, 0.0));
        pose.pose.orientation = Quaternion { x: 0.5_f64.sqrt(), y: 0.0, z: 0.0, w: 0.5_f64.sqrt() };
        bag = bag.add("/reference", &pose);
    }
    let (_, summary) = bag.read(&BagOptions::default()).unwrap();
    remark(&summary, "Most poses of the reference are tilted by more than 10 degrees");
}

/// The drive of [`driving`] with a reference of these poses: seconds, what they are poses of, and the frame that they are in.
fn referenced(poses: &[f64], of: &str, within: &str) -> (Drive, LogSummary) {
    let add = |bag: Bag, now: &f64| {
        let mut pose = odometry(*now, &Pose2::new(*now, 0.0, 0.0));
        pose.child_frame_id = of.into();
        pose.header.frame_id = within.into();
        bag.add("/reference", &pose)
    };
    let bag = poses.iter().fold(driving(60, |_| true, |now| now), add);
    bag.read(&BagOptions::default()).unwrap()
}

#[test]
fn references_of_other_frames_and_clocks_are_told() {
    let all: Vec<f64> = (0..=300).map(|i| f64::from(i) / 5.0).collect();
    let (drive, summary) = referenced(&all, "base_footprint", "map");
    assert!(summary.remarks.is_empty() && drive.steps[40].reference.is_some(), "{:?}", summary.remarks);
    let (_, summary) = referenced(&all, "laser", "map");
    remark(&summary, "The reference is the pose of `laser`, the odometry that of `base_footprint`");
    let (_, summary) = referenced(&all, "base_footprint", "odom");
    remark(&summary, "The reference is in the frame of the odometry, `odom`");
    let later: Vec<f64> = all.iter().map(|secs| secs + 7200.0).collect();
    let (drive, summary) = referenced(&later, "base_footprint", "map");
    assert!(drive.steps.iter().all(|step| step.reference.is_none()));
    remark(&summary, "The reference poses are of 7200.0 s to 7260.0 s, the scans of 0.0 s to 60.0 s");
}

/// A robot drives no straight line from one pose to another a minute later.
#[test]
fn two_poses_are_no_reference_of_what_is_between() {
    for (poses, known) in [([0.0, 60.0], false), ([20.0, 30.0], true)] {
        let (drive, _) = referenced(&poses, "base_footprint", "map");
        let at = drive.steps.iter().find(|step| step.stamp_secs > 25.0).unwrap();
        assert_eq!(at.reference.is_some(), known, "{poses:?}");
    }
}

#[test]
fn an_end_of_the_scan_that_is_elsewhere_is_told() {
    let remarks = |angle_max: f32| {
        let scan = |secs| LaserScan { angle_max, ..wide_scan(secs, 20) };
        let bag = Bag::default()
            .add("/odom", &odometry(1.0, &Pose2::IDENTITY))
            .add("/scan", &scan(1.5))
            .add("/odom", &odometry(3.0, &Pose2::IDENTITY));
        bag.read(&BagOptions::default()).unwrap().1.remarks
    };
    // As it is, a beam more, and wrapped.
    for angle_max in [0.5, 0.5 + 1.0 / 19.0, 0.5 - std::f32::consts::TAU] {
        assert_eq!(remarks(angle_max), [""; 0], "{angle_max}");
    }
    // A sector of half the width, and of the other direction.
    for angle_max in [0.0, -1.5] {
        let told = remarks(angle_max);
        assert!(told.len() == 1 && told[0].starts_with("angle_max is"), "{told:?}");
    }
}

#[test]
fn a_frame_that_is_its_own_parent_is_passed_over() {
    let level = [0.0, 0.0, 0.0, 1.0];
    let mounted = plain().add("/tf_static", &transform("base_footprint", "laser", [0.5, 0.0, 0.0], level));
    let itself = mounted.add("/tf_static", &transform("laser", "laser", [0.0; 3], level));
    let (drive, summary) = itself.read(&BagOptions::default()).unwrap();
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(0.5, 0.0, 0.0)) && summary.remarks.is_empty());
    let two = itself.add("/tf_static", &transform("chassis", "laser", [0.1, 0.0, 0.0], level));
    remark(&two.read(&BagOptions::default()).unwrap().1, "a frame has two parents (base_footprint:laser)");
}

/// A drive of 5 s whose messages are recorded 20 ms after their stamps, which are changed by `scan` and `odom`.
fn recorded(scan: impl Fn(f64) -> f64, odom: impl Fn(f64) -> f64) -> Bag {
    let mut bag = Bag::default();
    for tick in 0..=50_u32 {
        let now = 100.0 + f64::from(tick) / 10.0;
        bag = bag.add_at(now + 0.02, "/odom", &odometry(odom(now), &Pose2::new(now - 100.0, 0.0, 0.0)));
        if tick % 2 == 0 {
            bag = bag.add_at(now + 0.05, "/scan", &wide_scan(scan(now + 0.03), 20));
        }
    }
    bag
}

fn same(now: f64) -> f64 {
    now
}

/// One, or three in a row, of another time: of the future, or of the past. More than a few are a clock that was set.
#[test]
fn stamps_that_are_far_off_are_left_out() {
    let whole = recorded(same, same).read(&BagOptions::default()).unwrap();
    assert_eq!(whole.1.remarks, Vec::<String>::new());
    for off in [1e5, 30.0, -30.0] {
        let one = |now: f64| if (101.9..102.1).contains(&now) { now + off } else { now };
        let (drive, summary) = recorded(one, same).read(&BagOptions::default()).unwrap();
        remark(
            &summary,
            "Messages of the scans whose stamps are seconds off those before and after are left out: 1.",
        );
        assert_eq!(drive.steps.len() + 1, whole.0.steps.len());
        let three = |now: f64| if (101.95..102.25).contains(&now) { now + off } else { now };
        let (drive, summary) = recorded(same, three).read(&BagOptions::default()).unwrap();
        remark(
            &summary,
            "Messages of the odometry whose stamps are seconds off those before and after are left out: 3.",
        );
        // Even motion: interpolated as it is.
        assert!(drive.steps.iter().all(|step| (step.odometry.x - (step.stamp_secs - 100.0)).abs() < 1e-6));
    }
    let last = |now: f64| if now > 104.95 { now - 30.0 } else { now };
    let (_, summary) = recorded(same, last).read(&BagOptions::default()).unwrap();
    remark(
        &summary,
        "Messages of the odometry whose stamps are seconds off those before and after are left out: 1.",
    );
    let set_back = recorded(same, |now| if now > 103.0 { now - 2.5 } else { now }).message();
    assert!(set_back.contains("/odom: message 35: the clock was set: a stamp is 100.6"), "{set_back}");
    // Every fourth is of another clock.
    let often = |now: f64| if ((10.0 * now).round() as u32).is_multiple_of(8) { now - 30.0 } else { now };
    let message = recorded(same, often).message();
    assert!(message.contains("/odom: 6 messages have stamps that are seconds off"), "{message}");
}

/// Drivers that give whole seconds, or none at all.
#[test]
fn stamps_of_whole_seconds_give_way_to_the_times_of_recording() {
    let (expected, _) = recorded(|now| now + 0.02, |now| now + 0.02).read(&BagOptions::default()).unwrap();
    for stamp in [f64::floor, |_| 0.0] {
        let (drive, summary) = recorded(stamp, stamp).read(&BagOptions::default()).unwrap();
        for name in ["scans", "odometry"] {
            remark(&summary, &format!("Stamps of the {name} are whole seconds that several messages share"));
        }
        assert_eq!(summary.remarks.len(), 2, "{:?}", summary.remarks);
        let both = || drive.steps.iter().zip(&expected.steps);
        assert_eq!(drive.steps.len(), expected.steps.len());
        assert!(
            both().all(|(a, b)| (a.stamp_secs - b.stamp_secs).abs() < 1e-6 && near(&a.odometry, &b.odometry))
        );
    }
    // Recorded at whole seconds, too: nothing is known better.
    let mut bag = recorded(f64::floor, f64::floor);
    bag.logged.iter_mut().for_each(|logged| *logged = *logged / 1_000_000_000 * 1_000_000_000);
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    assert_eq!((summary.remarks, drive.steps[3].stamp_secs), (Vec::new(), 100.0));
}

#[test]
fn clocks_that_differ_are_told() {
    let (_, summary) = recorded(|now| now - 2.0, same).read(&BagOptions::default()).unwrap();
    remark(
        &summary,
        "The scans are recorded 2.0 s after their stamps, the odometry 0.0 s: their stamps are of different clocks.",
    );
}

#[test]
fn rare_odometry_is_told() {
    let mut bag = Bag::default();
    for tick in 0..=50_u32 {
        let now = f64::from(tick) / 10.0;
        if tick % 10 == 0 {
            bag = bag.add("/odom", &odometry(now, &Pose2::new(now, 0.0, 0.0)));
        }
        bag = bag.add("/scan", &wide_scan(now, 20));
    }
    let (_, summary) = bag.read(&BagOptions::default()).unwrap();
    assert_eq!(summary.odometry_interval_secs, Some(1.0));
    remark(&summary, "The odometry comes every 1.00 s, scans every 0.10 s: between its poses");
}

#[test]
fn odometry_in_a_frame_that_does_not_drift_is_told() {
    let mut bag = Bag::default();
    for secs in [1.0, 2.0] {
        let mut truth = odometry(secs, &Pose2::new(secs, 0.0, 0.0));
        truth.header.frame_id = "world".into();
        bag = bag.add("/p3d", &truth);
    }
    let (_, summary) = bag.add("/scan", &wide_scan(1.5, 20)).read(&BagOptions::default()).unwrap();
    remark(&summary, "The odometry, /p3d, is in the frame `world`, which doesn't drift");
}

/// A network that delivers late, and a file that was written backwards: no order of recording is refused where the stamps are whole.
#[test]
fn messages_in_any_order_near_their_stamps_are_sorted() {
    let expected = recorded(same, same).read(&BagOptions::default()).unwrap().0;
    let stamps = |drive: &Drive| drive.steps.iter().map(|step| step.stamp_secs).collect::<Vec<_>>();
    for which in 0..3 {
        let mut bag = recorded(same, same);
        let count = bag.messages.len();
        match which {
            0 => bag.messages.reverse(),
            1 => bag.messages[count / 2..].reverse(),
            _ => bag.messages[count / 3..count / 2].reverse(),
        }
        let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
        assert_eq!(stamps(&drive), stamps(&expected), "{which}");
        assert!(!summary.remarks.iter().any(|remark| remark.contains("set back")), "{:?}", summary.remarks);
    }
}

/// Stamps that go back by 0.85 s and on from there are in order again once they are sorted.
#[test]
fn a_clock_that_was_set_back_by_less_than_a_second_is_told() {
    let back = |now: f64| if now < 102.0 { now } else { now - 0.85 };
    let (_, summary) = recorded(back, back).read(&BagOptions::default()).unwrap();
    remark(&summary, "Stamps of the scans go back by 0.");
    remark(&summary, "Stamps of the odometry go back by 0.");
}

#[test]
fn scans_that_were_recorded_twice_count_once() {
    let mut bag = recorded(same, same);
    let (expected, _) = bag.read(&BagOptions::default()).unwrap();
    for at in (0..bag.messages.len()).rev() {
        bag.messages.insert(at, bag.messages[at].clone());
        bag.logged.insert(at, bag.logged[at]);
    }
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    assert_eq!(drive.steps.len(), expected.steps.len());
    // One of them is after the last odometry.
    remark(&summary, &format!("{} scans are copies of another", expected.steps.len() + 1));
}
