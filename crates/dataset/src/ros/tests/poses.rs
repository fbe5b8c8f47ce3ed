//! Odometry and reference from other topics than `/odom` and `/reference`, and other scans than those of one common lidar.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use super::super::messages::{
    LaserEcho, MULTI_ECHO_LASER_SCAN, MultiEchoLaserScan, POINT_CLOUD_2, POSE_WITH_COVARIANCE_STAMPED,
    PointCloud2, PointField, PoseWithCovarianceStamped, TRANSFORM_STAMPED,
};
use super::*;
use crate::OdometrySource;

impl Message for PoseWithCovarianceStamped {
    const TYPE: &str = POSE_WITH_COVARIANCE_STAMPED;
    const DEFINITION: &str = "";
}

impl Message for TransformStamped {
    const TYPE: &str = TRANSFORM_STAMPED;
    const DEFINITION: &str = "";
}

impl Message for MultiEchoLaserScan {
    const TYPE: &str = MULTI_ECHO_LASER_SCAN;
    const DEFINITION: &str = "";
}

impl Message for PointCloud2 {
    const TYPE: &str = POINT_CLOUD_2;
    const DEFINITION: &str = "";
}

/// Covariances of an AMCL pose (m^2, m^2, rad^2).
const VARIANCES: [f64; 3] = [0.04, 0.09, 0.01];

fn moving(secs: f64, parent: &str, child: &str, pose: &Pose2) -> TfMessage {
    TfMessage {
        transforms: vec![TransformStamped {
            header: header(secs, parent),
            child_frame_id: child.into(),
            transform: Pose::planar(pose),
        }],
    }
}

fn amcl(secs: f64, pose: &Pose2) -> PoseWithCovarianceStamped {
    let mut covariance = [[0.0; 6]; 6];
    for (axis, variance) in [0, 1, 5].into_iter().zip(VARIANCES) {
        covariance[axis][axis] = variance;
    }
    PoseWithCovarianceStamped {
        header: header(secs, "map"),
        pose: PoseWithCovariance { pose: Pose::planar(pose), covariance },
    }
}

fn reference(name: &str) -> BagOptions {
    BagOptions {
        topics: BagTopics { reference: Some(name.to_owned()), ..BagTopics::default() },
        ..BagOptions::default()
    }
}

/// [`plain`] with its odometry as transforms to `base_footprint`.
fn of_transforms() -> Bag {
    plain()
        .without("/odom")
        .add("/tf", &moving(1.0, "odom", "base_footprint", &Pose2::new(1.0, 2.0, 3.0)))
        .add("/tf", &moving(3.0, "odom", "base_footprint", &Pose2::new(3.0, 6.0, -3.0)))
}

#[test]
fn odometry_is_read_from_transforms() {
    let (expected, _) = plain().read(&BagOptions::default()).unwrap();
    let (drive, summary) = of_transforms().read(&BagOptions::default()).unwrap();
    assert_eq!(drive, expected);
    assert_eq!(summary.odometry, OdometrySource::Transforms);
    assert!(summary.evidence.contains("odometry from the transforms odom:base_footprint"), "{summary}");

    // The base is a frame above which a static transform leads.
    let level = [0.0, 0.0, 0.0, 1.0];
    let linked = of_transforms()
        .add("/tf_static", &transform("base_footprint", "base_link", [1.0, 0.0, 0.1], level))
        .add("/tf_static", &transform("base_link", "laser", [0.5, 0.0, 0.0], level));
    let (drive, _) = linked.read(&BagOptions::default()).unwrap();
    let ahead = Pose2::new(1.0, 0.0, 0.0);
    for (step, expected) in drive.steps.iter().zip(&expected.steps) {
        assert!(near(&step.odometry, &expected.odometry.compose(&ahead)), "{:?}", step.odometry);
    }
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(0.5, 0.0, 0.0)));

    // A topic comes first, also where transforms are there; frames may be named.
    let both = plain().add("/tf", &moving(1.0, "odom", "base_link", &Pose2::IDENTITY));
    assert_eq!(both.read(&BagOptions::default()).unwrap().1.odometry, OdometrySource::Topic);
    let other = plain()
        .add("/tf", &moving(1.0, "wheels", "robot", &Pose2::IDENTITY))
        .add("/tf", &moving(3.0, "wheels", "robot", &ahead));
    let topics = BagTopics { odometry: Some("wheels:robot".to_owned()), ..BagTopics::default() };
    let (drive, _) = other.read(&BagOptions { topics, ..BagOptions::default() }).unwrap();
    assert!(near(&drive.steps[1].odometry, &Pose2::new(0.25, 0.0, 0.0)));

    // Joints that aren't known do no harm.
    let unknown =
        of_transforms().add("/tf", &moving(1.0, "base_link", "wheel", &Pose2::new(f64::NAN, 0.0, 0.0)));
    assert!(unknown.read(&BagOptions::default()).is_ok());
}

/// Between scans the reference is where it was then, every 20 ms, and a pause is not filled.
#[test]
fn a_reference_is_known_between_scans() {
    let pose = |secs, x| stamped(secs, &Pose2::new(x, 0.0, 0.0));
    let bag = plain().add("/reference", &pose(1.0, 0.0)).add("/reference", &pose(1.25, 1.0));
    let bag = bag.add("/reference", &pose(1.5, 0.0)).add("/reference", &pose(3.0, 0.0));
    let (_, summary) = bag.read(&BagOptions::default()).unwrap();
    let of_turn: Vec<_> = summary.between.iter().filter(|(secs, _)| *secs < 1.5).collect();
    assert_eq!(of_turn.len(), 24);
    for (secs, pose) in of_turn {
        let expected = 1.0 - (secs - 1.25).abs() / 0.25;
        assert!((pose.x - expected).abs() < 1e-6, "{secs} {pose:?}");
    }
    assert!(summary.between.is_sorted_by(|a, b| a.0 < b.0));
    assert!(summary.between.iter().all(|(secs, _)| *secs < 2.5), "a second after a scan");
    assert!(plain().read(&BagOptions::default()).unwrap().1.between.is_empty());
}

/// A robot that stops on the way between two poses of its reference stops between scans, too. The wheels' error comes evenly. Wheels that err
/// more than even motion don't say how it moves.
#[test]
fn between_rare_poses_of_a_topic_the_reference_moves_as_an_odometry_that_is_good() {
    let place = Pose2::new(10.0, -5.0, FRAC_PI_2);
    let at = |secs: f64, gain: f64| {
        let way = (secs - 1.0).min(0.25);
        Pose2::new(way, 0.0, 0.8 * way + gain * (secs - 1.0))
    };
    for (gain, is_followed) in [(0.004, true), (0.4, false)] {
        let mut bag = Bag::default();
        for i in 0..=20 {
            let secs = 1.0 + 0.05 * f64::from(i);
            bag = bag.add("/odom", &odometry(secs, &at(secs, 0.0)));
        }
        for secs in [1.0, 1.5, 2.0] {
            let pose = stamped(secs, &place.compose(&at(secs, gain)));
            bag = bag.add("/scan", &scan(secs, &[1.0; 5])).add("/reference", &pose);
        }
        let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
        assert_eq!((drive.steps.len(), summary.between.len()), (3, 48));
        for (secs, pose) in summary.between.into_iter().filter(|(secs, _)| *secs < 1.5) {
            let even =
                place.compose(&at(1.0, gain)).interpolate(&place.compose(&at(1.5, gain)), 2.0 * (secs - 1.0));
            let expected = if is_followed { place.compose(&at(secs, gain)) } else { even };
            assert!(pose.error_from(&expected).length() < 1e-6, "{secs} {pose:?}");
        }
    }
}

/// A robot of several, whose drivers put its name before each frame; `map` is of all of them.
#[test]
fn frames_may_be_in_the_namespace_of_the_laser() {
    let poses = [Pose2::new(1.0, 2.0, 3.0), Pose2::new(3.0, 6.0, -3.0)];
    let mut bag = Bag::default();
    for (secs, pose) in [1.0, 3.0].into_iter().zip(&poses) {
        bag = bag
            .add("/tf", &moving(secs, "fleet/a/odom", "fleet/a/base_link", pose))
            .add("/tf", &moving(secs, "odom", "base_link", &Pose2::IDENTITY));
    }
    let level = [0.0, 0.0, 0.0, 1.0];
    bag =
        bag.add("/tf_static", &transform("fleet/a/base_link", "fleet/a/front/laser", [0.5, 0.0, 0.0], level));
    for secs in [1.0, 1.5, 3.0] {
        let mut scan = scan(secs, &[1.0, 2.0, 3.0, 4.0, 5.0]);
        scan.header.frame_id = "fleet/a/front/laser".to_owned();
        bag = bag.add("/a/scan", &scan);
    }
    let (expected, _) = plain().read(&BagOptions::default()).unwrap();
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    assert!(summary.evidence.contains("the transforms fleet/a/odom:fleet/a/base_link"), "{summary}");
    let odometry = |drive: &Drive| drive.steps.iter().map(|step| step.odometry).collect::<Vec<_>>();
    assert_eq!(odometry(&drive), odometry(&expected));
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(0.5, 0.0, 0.0)));
    assert_eq!(summary.kind, LogKind::Raw);

    let localized = bag
        .add("/tf", &moving(1.0, "map", "fleet/a/odom", &Pose2::IDENTITY))
        .add("/tf", &moving(3.0, "map", "fleet/a/odom", &Pose2::IDENTITY));
    let (drive, summary) = localized.read(&BagOptions::default()).unwrap();
    assert_eq!(summary.kind, LogKind::Localized);
    assert!(near(&drive.steps[0].reference.unwrap(), &poses[0]), "{summary}");
}

/// Odometry and scans every 0.1 s, corrected every `every` tenths of a second. Poses of the base follow the odometry meanwhile.
#[test]
fn corrections_may_come_seldom() {
    let remarks = |every: usize| {
        let mut bag = Bag::default();
        for i in 0..100 {
            let (secs, pose) = (1.0 + 0.1 * f64::from(i), Pose2::new(0.03 * f64::from(i), 0.0, 0.0));
            bag = bag
                .add("/scan", &scan(secs, &[1.0, 2.0, 3.0, 4.0, 5.0]))
                .add("/tf", &moving(secs, "odom", "base_link", &pose));
            if (i as usize).is_multiple_of(every) {
                bag = bag.add("/tf", &moving(secs, "map", "odom", &Pose2::IDENTITY));
            }
        }
        bag.read(&BagOptions::default()).unwrap().1.remarks
    };
    assert_eq!(remarks(10), [""; 0]);
    let [seldom] = &remarks(40)[..] else { panic!("one remark") };
    assert!(
        seldom.starts_with("Reference poses come every 4.0 s. Between them they follow the odometry"),
        "{seldom}"
    );
}

#[test]
fn frames_without_a_way_between_them_are_refused_with_those_that_are_there() {
    let message =
        plain().without("/odom").add("/tf", &moving(1.0, "world", "robot", &Pose2::IDENTITY)).message();
    for part in [
        "no topic of type nav_msgs/msg/Odometry for odometry, and no transforms lead from `base_link` to `odom`",
        "transforms: world:robot; found: /scan (sensor_msgs/msg/LaserScan, 3 messages), /tf (",
    ] {
        assert!(message.contains(part), "{message}");
    }
    let error = of_transforms().read(&reference("map:base_link")).unwrap_err().to_string();
    assert!(error.contains("for reference, and no transforms lead from `base_link` to `map`"), "{error}");
    // A circle has no end.
    let circle = of_transforms().add("/tf", &moving(1.0, "base_footprint", "odom", &Pose2::IDENTITY));
    assert!(circle.read(&reference("map:base_link")).is_err());
}

#[test]
fn a_reference_is_composed_of_transforms() {
    let map_from_odom = Pose2::new(10.0, -5.0, FRAC_PI_2);
    let whole = of_transforms()
        .add("/tf", &moving(0.5, "map", "odom", &map_from_odom))
        .add("/tf", &moving(3.5, "map", "odom", &map_from_odom));
    let (drive, summary) = whole.read(&BagOptions::default()).unwrap();
    assert_eq!(summary.kind, LogKind::Localized);
    assert!(
        summary.evidence.contains("reference from the transforms map:base_footprint, which a localizer"),
        "{summary}"
    );
    assert_eq!(drive.steps.len(), 3);
    for step in &drive.steps {
        let expected = map_from_odom.compose(&step.odometry);
        assert!(near(&step.reference.unwrap(), &expected), "{:?}", step.reference);
    }
    // Poses under another name may be anything: the user hears of them.
    let (_, summary) = whole
        .clone()
        .add("/mocap/robot", &stamped(1.0, &Pose2::IDENTITY))
        .read(&BagOptions::default())
        .unwrap();
    assert!(
        summary.evidence.contains("poses that may be named as the reference: /mocap/robot (1 messages)"),
        "{summary}"
    );
    // Named as we and as evo write it, the user vouches for it.
    for name in ["map:base_footprint", "/tf:map.base_footprint"] {
        let (named, summary) = whole.read(&reference(name)).unwrap();
        assert_eq!((&named, summary.kind), (&drive, LogKind::Referenced));
    }
    // Beside a topic of reference poses it isn't asked.
    let topic = whole.add("/reference", &odometry(1.0, &Pose2::IDENTITY));
    assert_eq!(topic.read(&BagOptions::default()).unwrap().1.kind, LogKind::Referenced);
}

#[test]
fn between_poses_of_a_localizer_the_reference_follows_the_odometry() {
    let map_from_odom = Pose2::new(10.0, -5.0, FRAC_PI_4);
    // A quarter turn between two poses of the localizer.
    let odometry_at =
        [(1.0, Pose2::IDENTITY), (2.0, Pose2::new(4.0, 0.0, 0.0)), (3.0, Pose2::new(4.0, 4.0, FRAC_PI_2))];
    let mut bag = Bag::default();
    for (secs, pose) in &odometry_at {
        bag = bag.add("/odom", &odometry(*secs, pose)).add("/scan", &scan(*secs, &[1.0; 5]));
    }
    for (secs, pose) in [odometry_at[0], odometry_at[2]] {
        bag = bag.add("/amcl_pose", &amcl(secs, &map_from_odom.compose(&pose)));
    }
    for (options, kind) in
        [(BagOptions::default(), LogKind::Localized), (reference("/amcl_pose"), LogKind::Referenced)]
    {
        let (drive, summary) = bag.read(&options).unwrap();
        assert_eq!((summary.kind, summary.reference_messages), (kind, 2));
        for (step, (_, pose)) in drive.steps.iter().zip(&odometry_at) {
            assert!(near(&step.reference.unwrap(), &map_from_odom.compose(pose)), "{:?}", step.reference);
        }
        for (deviation, variance) in summary.reference_deviation.unwrap().into_iter().zip(VARIANCES) {
            assert!((deviation - variance.sqrt()).abs() < 1e-12);
        }
        let said = summary.to_string();
        assert!(said.contains("standard deviations of 0.200 m, 0.300 m, 5.73 deg"), "{said}");
    }
}

#[test]
fn a_motion_capture_publishes_transforms() {
    let pose = Pose2::new(7.0, 8.0, 0.5);
    let stamped = |secs: f64| moving(secs, "world", "robot", &pose).transforms.remove(0);
    let bag = plain().add("/vicon", &stamped(1.0)).add("/vicon", &stamped(3.0));
    let (drive, summary) = bag.read(&reference("/vicon")).unwrap();
    assert_eq!((summary.kind, summary.reference_deviation), (LogKind::Referenced, None));
    assert!(drive.steps.iter().all(|step| near(&step.reference.unwrap(), &pose)));
    // Without being named it isn't taken, but listed.
    let (_, summary) = bag.read(&BagOptions::default()).unwrap();
    assert_eq!(summary.kind, LogKind::Raw);
    assert!(summary.topics.contains(&"/vicon (geometry_msgs/msg/TransformStamped, 2 messages)".to_owned()));
}

#[test]
fn other_scanners_are_listed() {
    let (_, summary) = plain().add("/rear", &scan(1.0, &[1.0])).read(&BagOptions::default()).unwrap();
    assert!(summary.evidence.contains("other scanners: /rear (1 messages)"), "{summary}");
}

#[test]
fn the_first_echo_of_a_beam_is_its_reading() {
    let LaserScan {
        header,
        angle_min,
        angle_max,
        angle_increment,
        time_increment,
        scan_time,
        range_min,
        range_max,
        ..
    } = scan(1.0, &[]);
    let beam = |echoes: &[f32]| LaserEcho { echoes: echoes.to_vec() };
    let ranges = vec![beam(&[1.0, 2.0]), beam(&[]), beam(&[f32::INFINITY])];
    let scan = MultiEchoLaserScan {
        header,
        angle_min,
        angle_max,
        angle_increment,
        time_increment,
        scan_time,
        range_min,
        range_max,
        ranges,
        intensities: Vec::new(),
    };
    let bag = Bag::default().add("/echoes", &scan).add("/odom", &odometry(1.0, &Pose2::IDENTITY));
    let (drive, _) = bag.read(&BagOptions::default()).unwrap();
    let ranges = &drive.steps[0].scan.ranges;
    assert_eq!((ranges[0], ranges[2]), (1.0, 8.0));
    assert!(ranges[1].is_nan());
}

#[test]
fn zero_is_no_return_where_a_driver_has_no_other_word_for_it() {
    let read = |ranges: &[f32]| {
        let bag =
            Bag::default().add("/odom", &odometry(1.0, &Pose2::IDENTITY)).add("/scan", &scan(1.0, ranges));
        let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
        (drive.steps[0].scan.ranges[0], summary)
    };
    let (zero, summary) = read(&[0.0, 1.0, f32::NAN]);
    assert_eq!((zero, summary.no_return_share), (8.0, 1.0 / 3.0));
    assert!(summary.evidence.contains("readings of 0 are taken for no return"), "{summary}");
    for other in [f32::INFINITY, 8.0] {
        let (zero, summary) = read(&[0.0, 1.0, other]);
        assert!(zero.is_nan() && !summary.evidence.contains("readings of 0"), "{summary}");
    }
    // One reading in a thousand is of a driver, one in two thousand of dust on the window.
    for (scans, is_word) in [(333, true), (700, false)] {
        let mut bag = Bag::default().add("/odom", &odometry(1.0, &Pose2::IDENTITY));
        for i in 0..scans {
            let first = if i == 0 { 0.0 } else { 1.0 };
            bag = bag.add("/scan", &scan(1.0 + 1e-3 * f64::from(i), &[first, 1.0, 1.0]));
        }
        let zero = bag.read(&BagOptions::default()).unwrap().0.steps[0].scan.ranges[0];
        assert_eq!((zero == 8.0, zero.is_nan()), (is_word, !is_word), "{scans}");
    }
}

/// NaN is no return where a driver has no other word for it, but not on beams that have nothing else, nor between two surfaces.
#[test]
fn nan_is_no_return_where_a_driver_has_no_other_word_for_it() {
    let nan = f32::NAN;
    let read = |scans: &[&[f32]]| {
        let mut bag = Bag::default().add("/odom", &odometry(1.0, &Pose2::IDENTITY));
        for (i, ranges) in scans.iter().enumerate() {
            bag = bag.add("/scan", &scan(1.0 + 1e-3 * i as f64, ranges));
        }
        let (drive, summary) =
            bag.add("/odom", &odometry(2.0, &Pose2::IDENTITY)).read(&BagOptions::default()).unwrap();
        (drive.steps[0].scan.ranges.clone(), summary)
    };
    let first_of = |first: &'static [f32]| -> Vec<&[f32]> {
        std::iter::once(first).chain([&[1.0; 4][..]; 29]).collect()
    };
    let (ranges, summary) = read(&first_of(&[f32::NAN, 1.0, 1.0, 1.0]));
    assert_eq!(ranges[0], 8.0);
    assert!(summary.evidence.contains("readings of NaN are taken for no return"), "{summary}");
    let (ranges, summary) = read(&first_of(&[f32::NAN, f32::INFINITY, 1.0, 1.0]));
    assert!(ranges[0].is_nan() && !summary.evidence.contains("readings of NaN"), "{summary}");
    // A filter's, at the edge of a near surface.
    assert!(read(&first_of(&[1.0, f32::NAN, 3.0, 3.0])).0[1].is_nan());
    // A few scans don't tell.
    assert!(read(&first_of(&[f32::NAN, 1.0, 1.0, 1.0])[..5]).0[0].is_nan());
    // One of 1,200 readings, on a beam that has others.
    let (first, others) = ([nan, 1.0, 1.0, 1.0], [1.0; 4]);
    let few: Vec<&[f32]> = std::iter::once(&first[..]).chain([&others[..]; 299]).collect();
    assert!(read(&few).0[0].is_nan() && read(&few[..200]).0[0] == 8.0);
    // A part of the robot before the first beam.
    assert!(read(&[&[nan, 1.0, 1.0, 1.0][..]; 30]).0[0].is_nan());
    assert_eq!(
        read(&[&[&[nan, nan, 1.0, 1.0][..]], &[&[nan, 1.0, 1.0, 1.0][..]; 29][..]].concat()).0[1],
        8.0
    );
}

#[test]
fn bearings_are_as_the_scans_have_them() {
    let turn = |first: f32, step: f32| LaserScan {
        angle_min: first,
        angle_max: -first,
        angle_increment: step,
        ..scan(1.0, &[1.0; 4])
    };
    let pi = std::f32::consts::PI;
    for (first, step) in [(-pi, pi / 2.0), (pi, -pi / 2.0), (0.0, pi / 2.0)] {
        let bag =
            Bag::default().add("/odom", &odometry(1.0, &Pose2::IDENTITY)).add("/scan", &turn(first, step));
        let (drive, _) = bag.read(&BagOptions::default()).unwrap();
        for (i, bearing) in drive.laser.bearings().iter().enumerate() {
            assert!((bearing - (first + i as f32 * step)).abs() < 1e-6, "{bearing}");
        }
    }
}

fn cloud(secs: f64, points: &[[f32; 3]]) -> PointCloud2 {
    let field = |name: &str, offset: u32| PointField {
        name: name.into(),
        offset,
        datatype: PointField::FLOAT32,
        count: 1,
    };
    // Four bytes of something else before each point.
    let data = points.iter().flat_map(|point| [9.0].iter().chain(point).copied().collect::<Vec<_>>());
    PointCloud2 {
        header: header(secs, "laser"),
        height: 1,
        width: points.len() as u32,
        fields: vec![field("x", 4), field("y", 8), field("z", 12)],
        is_bigendian: false,
        point_step: 16,
        row_step: 16 * points.len() as u32,
        data: data.flat_map(f32::to_le_bytes).collect(),
        is_dense: false,
    }
}

/// Points of a quarter circle of five beams, at 1 m, 2 m, ...; of some of them only.
fn quarter(kept: impl Fn(usize) -> bool) -> Vec<[f32; 3]> {
    let point = |beam: usize| {
        let (sin, cos) = (beam as f32 * std::f32::consts::FRAC_PI_8 - std::f32::consts::FRAC_PI_4).sin_cos();
        [(beam + 1) as f32 * cos, (beam + 1) as f32 * sin, 0.0]
    };
    (0..5).filter(|beam| kept(*beam)).map(point).collect()
}

#[test]
fn clouds_of_a_2d_lidar_are_scans() {
    let with = |clouds: &[PointCloud2]| {
        let bag = plain().without("/scan");
        clouds.iter().fold(bag, |bag, cloud| bag.add("/points", cloud))
    };
    let mut unknown = quarter(|beam| beam != 2);
    unknown.push([f32::NAN; 3]);
    let bag =
        with(&[cloud(1.0, &unknown), cloud(1.5, &quarter(|_| true)), cloud(3.0, &quarter(|beam| beam == 4))]);
    let (drive, summary) = bag.read(&BagOptions::default()).unwrap();
    for (i, bearing) in drive.laser.bearings().iter().enumerate() {
        let expected = i as f32 * std::f32::consts::FRAC_PI_8 - std::f32::consts::FRAC_PI_4;
        assert!((bearing - expected).abs() < 1e-6, "{bearing}");
    }
    let found =
        |step: usize| drive.steps[step].scan.ranges.iter().map(|r| if r.is_nan() { 0.0 } else { r.round() });
    assert!(found(0).eq([1.0, 2.0, 0.0, 4.0, 5.0]) && found(1).eq([1.0, 2.0, 3.0, 4.0, 5.0]));
    assert!(found(2).eq([0.0, 0.0, 0.0, 0.0, 5.0]));
    assert_eq!(summary.no_return_share, 0.0);
    assert!(summary.evidence.contains("clouds don't tell readings without return"), "{summary}");

    // Around the circle the beam behind is one, at either end.
    let around = |from: usize| {
        let angle = |beam: usize| (beam as f32).mul_add(std::f32::consts::FRAC_PI_4, -std::f32::consts::PI);
        (from..8).map(|beam| [angle(beam).cos(), angle(beam).sin(), 0.0]).collect::<Vec<_>>()
    };
    let (drive, _) =
        with(&[cloud(1.0, &around(0)), cloud(3.0, &around(1))]).read(&BagOptions::default()).unwrap();
    assert_eq!(drive.laser.beam_count(), 8);

    // Scans come first; clouds may be named.
    let both = plain().add("/points", &cloud(1.0, &quarter(|_| true)));
    assert_eq!(both.read(&BagOptions::default()).unwrap().1.scan_source, "/scan");
    let topics = BagTopics { scan: Some("/points".to_owned()), ..BagTopics::default() };
    let (_, summary) = both.read(&BagOptions { topics, ..BagOptions::default() }).unwrap();
    assert_eq!(summary.scan_source, "/points");
}

#[test]
fn clouds_that_are_no_scans_are_refused() {
    let refused = |change: &dyn Fn(&mut PointCloud2), part: &str| {
        let mut cloud = cloud(1.0, &quarter(|_| true));
        change(&mut cloud);
        let message = plain().without("/scan").add("/points", &cloud).message();
        assert!(message.contains("/points: message 1: ") && message.contains(part), "{message}");
    };
    refused(&|cloud| cloud.fields[2].name = "height".into(), "the cloud has no field `z` of FLOAT32");
    refused(&|cloud| cloud.fields[0].datatype = 8, "the cloud has no field `x` of FLOAT32");
    refused(&|cloud| cloud.fields[0].offset = 13, "the cloud has no field `x` of FLOAT32");
    refused(&|cloud| cloud.point_step = 0, "the cloud has no field `x`");
    refused(
        &|cloud| cloud.width = u32::MAX,
        "the cloud has 80 bytes; allowed: 16 for each of 4294967295 points",
    );
    refused(
        &|cloud| cloud.data[12..16].copy_from_slice(&2_f32.to_le_bytes()),
        "a point lies 2 m off the plane",
    );
    refused(&|cloud| (cloud.width, cloud.data) = (0, Vec::new()), "too few points to tell the beams");
}
