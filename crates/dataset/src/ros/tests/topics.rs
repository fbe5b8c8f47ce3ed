//! The topics that are read, and the mount that transforms give.

use super::*;

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

    // A name that several types stand under.
    let (_, summary) =
        plain().add("/scan", &odometry(1.0, &Pose2::IDENTITY)).read(&BagOptions::default()).unwrap();
    let types = "/scan has messages of several types, as no topic may: nav_msgs/msg/Odometry, sensor_msgs/msg/LaserScan";
    assert!(summary.evidence.contains(types), "{summary}");

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
        (
            Bag::default().raw("/scan", "sensor_msgs/LaserScan", "ros1", &[]),
            &["messages are those of ROS 1; `rosbags-convert`", "/scan (sensor_msgs/LaserScan, 1 messages)"],
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
fn a_carmen_log_has_no_topics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.log");
    fs::write(&path, "FLASER 1 1 0 0 0 0 0 0 1 h 1\n").unwrap();
    let topics = BagTopics { scan: Some("/scan".to_owned()), ..BagTopics::default() };
    let refused = read_log(&path, &LogOptions { topics, ..LogOptions::default() }).unwrap_err().to_string();
    assert!(
        refused.ends_with(
            "topics are named, by options or in `log.topics`; allowed: for a ROS 2 bag; found: a CARMEN log"
        ),
        "{refused}"
    );
}
