use std::fmt::Write as _;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use locsim_core::{Drive, DriveStep, Laser, Pose2, Scan, wrap_angle};
use proptest::prelude::*;

use super::*;
use crate::test_drives::{bits, drive};
use crate::{LogKind, OdometrySource, encode_log, write_log};

fn read_text(text: &str) -> Result<(Drive, LogSummary), DatasetError> {
    read_with(text, &CarmenOptions::default())
}

fn read_with(text: &str, options: &CarmenOptions) -> Result<(Drive, LogSummary), DatasetError> {
    read_from(Path::new("test.log"), Cursor::new(text.as_bytes()), options, &Limits::DEFAULT)
}

fn near(a: &Pose2, b: &Pose2) -> bool {
    (a.x - b.x).abs() < 1e-9 && (a.y - b.y).abs() < 1e-9 && wrap_angle(a.theta - b.theta).abs() < 1e-9
}

fn words(pose: &Pose2) -> String {
    format!("{} {} {}", pose.x, pose.y, pose.theta)
}

/// A path of the laser: corrected poses, and the odometry of each motion, which differs a little.
fn corrected_path() -> (Vec<Pose2>, Vec<Pose2>) {
    let mut poses = vec![Pose2::new(0.5, -0.25, 0.75)];
    let mut increments = vec![Pose2::IDENTITY];
    for i in 0..12 {
        let turn = if i % 4 == 3 { 0.4 } else { 0.02 };
        poses.push(poses[i].compose(&Pose2::new(0.3, 0.01, turn)));
        increments.push(Pose2::new(0.31, 0.0, turn + 0.01));
    }
    (poses, increments)
}

/// A log as gmapping writes it: ODOM restarts at each corrected pose, `lines` of them per interval.
fn corrected_log(lines: usize) -> String {
    let (poses, increments) = corrected_path();
    let mut text = String::from("PARAM robot_frontlaser_offset -0.04 nohost 0\n");
    for (i, pose) in poses.iter().enumerate() {
        let time = i as f64;
        if i > 0 {
            let from = &poses[i - 1];
            if lines > 0 {
                writeln!(text, "ODOM {} 0 0 0 0 h 0\nNEFF 10", words(from)).unwrap();
            }
            if lines > 2 {
                writeln!(
                    text,
                    "ODOM {} 0 0 0 {} h 0",
                    words(&from.compose(&Pose2::new(0.1, 0.0, 0.0))),
                    time - 0.5
                )
                .unwrap();
            }
            if lines > 1 {
                writeln!(text, "ODOM {} 0 0 0 {time} h 0", words(&from.compose(&increments[i]))).unwrap();
            }
        }
        writeln!(text, "FLASER 3 1 2.5 81.91 {0} {0} {time} h {time}", words(pose)).unwrap();
    }
    text
}

/// A log as a robot records it: continuous ODOM, the scans between them, the laser 0.25 m before the axle.
fn raw_log() -> String {
    let mut text = String::new();
    for i in 0..10 {
        let time = f64::from(i);
        let at = |t: f64| Pose2::new(0.5 * t, 0.0, 0.125);
        let laser = at(time).compose(&Pose2::new(0.25, 0.0, 0.0));
        writeln!(text, "ODOM {} 0.5 0 0 {} h {time}", words(&at(time - 0.125)), time - 0.125).unwrap();
        writeln!(text, "FLASER 3 1 2 3 {} {} {time} h {time}", words(&laser), words(&at(time))).unwrap();
        writeln!(text, "ODOM {} 0.5 0 0 {} h {time}", words(&at(time + 0.125)), time + 0.125).unwrap();
    }
    text
}

#[test]
fn a_corrected_logs_odometry_is_recovered() {
    let (poses, increments) = corrected_path();
    for lines in [2, 3] {
        let (drive, summary) = read_text(&corrected_log(lines)).unwrap();
        assert_eq!(summary.kind, LogKind::Corrected, "{}", summary.evidence);
        assert_eq!(summary.odometry, OdometrySource::RestartedOdomLines);
        assert_eq!(summary.intervals_without_odometry, 0);
        assert!(summary.evidence.contains("one in 13 of 13 scans"), "{}", summary.evidence);
        assert!(summary.evidence.contains("in 12 of 12 intervals"), "{}", summary.evidence);
        assert_eq!(summary.skipped["NEFF"], 12);
        // The scan's pose is the laser's; the base is where the mount says, and the motion of the base follows.
        let mount = Pose2::new(-0.04, 0.0, 0.0);
        assert_eq!(drive.laser.base_from_laser(), mount);
        assert_eq!(drive.steps.len(), poses.len());
        assert!(near(&drive.steps[0].odometry, &drive.steps[0].reference.unwrap()));
        for i in 0..poses.len() {
            assert!(near(&drive.steps[i].reference.unwrap().compose(&mount), &poses[i]));
            let of_base = mount.compose(&increments[i]).compose(&mount.inverse());
            assert!(near(&drive.odometry_increment(i), &of_base), "step {i}");
        }
    }
}

#[test]
fn an_interval_without_odometry_is_counted_and_filled() {
    let whole = corrected_log(2);
    // The second interval keeps only its restart line, the third keeps no ODOM line.
    let mut odometry_line = 0;
    let text: String = whole
        .split_inclusive('\n')
        .filter(|line| {
            odometry_line += usize::from(line.starts_with("ODOM"));
            !(line.starts_with("ODOM") && [4, 5, 6].contains(&odometry_line))
        })
        .collect();
    let (drive, summary) = read_text(&text).unwrap();
    assert_eq!(summary.odometry, OdometrySource::RestartedOdomLines, "{}", summary.evidence);
    assert_eq!(summary.intervals_without_odometry, 2);
    let (unchanged, _) = read_text(&whole).unwrap();
    let reference = |i: usize| drive.steps[i].reference.unwrap();
    for i in 1..drive.steps.len() {
        let expected = if i == 2 || i == 3 {
            reference(i).relative_to(&reference(i - 1))
        } else {
            unchanged.odometry_increment(i)
        };
        assert!(near(&drive.odometry_increment(i), &expected), "step {i}");
    }
}

#[test]
fn a_raw_log_has_the_scans_odometry_and_no_reference() {
    let (drive, summary) = read_text(&raw_log()).unwrap();
    assert_eq!((summary.kind, summary.odometry), (LogKind::Raw, OdometrySource::ScanLines));
    assert_eq!((summary.odometry_messages, summary.reference_messages), (20, 0));
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(0.25, 0.0, 0.0)));
    for (i, step) in drive.steps.iter().enumerate() {
        assert!(near(&step.odometry, &Pose2::new(0.5 * i as f64, 0.0, 0.125)));
        assert_eq!(step.reference, None);
    }
}

/// A laser on the axle: both poses of a line are one, as in a corrected log, and each ODOM line after a scan
/// repeats its pose; but the ODOM line of the same time before a scan has it too.
#[test]
fn a_raw_log_is_not_taken_for_a_corrected_one() {
    let mut text = String::new();
    for i in 0..10 {
        let pose = words(&Pose2::new(f64::from(i), 0.5, 0.0));
        writeln!(text, "ODOM {pose} 0 0 0 {i} h {i}\nFLASER 1 1 {pose} {pose} {i} h {i}").unwrap();
        writeln!(text, "ODOM {pose} 0 0 0 {i}.5 h {i}").unwrap();
    }
    let (_, summary) = read_text(&text).unwrap();
    assert_eq!(summary.kind, LogKind::Raw, "{}", summary.evidence);
}

#[test]
fn odometry_beside_corrected_poses_is_found_in_either_place() {
    let pose = |i: i32, drift: f64| words(&Pose2::new(0.5 * f64::from(i), drift * f64::from(i), 0.0));
    let (mut in_scans, mut in_lines, mut frozen) = (String::new(), String::new(), String::new());
    for i in 0..20 {
        let (corrected, odometry) = (pose(i, 0.0), pose(i, 0.25));
        writeln!(in_scans, "FLASER 1 1 {corrected} {odometry} {i} h {i}").unwrap();
        writeln!(in_lines, "ODOM {odometry} 0 0 0 {i} h {i}").unwrap();
        writeln!(in_lines, "FLASER 1 1 {corrected} {corrected} {i} h {i}").unwrap();
        writeln!(frozen, "ODOM {odometry} 0 0 0 {i} h {i}\nFLASER 1 1 0 0 0 0 0 0 {i} h {i}").unwrap();
    }
    for (text, kind, source) in [
        (in_scans, LogKind::Corrected, OdometrySource::ScanLines),
        (in_lines, LogKind::Corrected, OdometrySource::OdomLines),
        (frozen, LogKind::Raw, OdometrySource::OdomLines),
    ] {
        let (drive, summary) = read_text(&text).unwrap();
        assert_eq!((summary.kind, summary.odometry), (kind, source), "{}", summary.evidence);
        for (i, step) in drive.steps.iter().enumerate() {
            assert!(near(&step.odometry, &Pose2::new(0.5 * i as f64, 0.25 * i as f64, 0.0)));
            if kind == LogKind::Corrected {
                assert!(near(&step.reference.unwrap(), &Pose2::new(0.5 * i as f64, 0.0, 0.0)));
            }
        }
    }
}

/// Wheels that drift to 20 cm at the most, with an ODOM line every 5 cm; beside poses that are the odometry's, up to two lines late, the
/// log is as a robot records it.
#[test]
fn poses_a_little_off_a_good_odometry_are_corrected_ones() {
    let log = |pose: fn(f64) -> Pose2| {
        let mut text = String::new();
        for i in 0..60 {
            let time = f64::from(i);
            for part in 0..4 {
                let t = time - 0.8 + 0.2 * f64::from(part);
                writeln!(text, "ODOM {} 0.25 0 0 {t} h {t}", words(&Pose2::new(0.25 * t, 0.0, 0.0))).unwrap();
            }
            writeln!(text, "FLASER 1 1 {0} {0} {time} h {time}", words(&pose(time))).unwrap();
        }
        text
    };
    let (drive, summary) =
        read_text(&log(|t| Pose2::new(0.25 * t, 0.2 + 0.02 * (0.2 * t).sin(), 0.0))).unwrap();
    assert_eq!((summary.kind, summary.odometry), (LogKind::Corrected, OdometrySource::OdomLines));
    assert!(
        summary.evidence.contains("corrected") && drive.steps.iter().all(|step| step.reference.is_some())
    );
    for late in [-0.4, 0.0, 0.4] {
        let pose: fn(f64) -> Pose2 = match late {
            -0.4 => |t| Pose2::new(0.25 * t - 0.1, 0.0, 0.0),
            0.0 => |t| Pose2::new(0.25 * t, 0.0, 0.0),
            _ => |t| Pose2::new(0.25 * t + 0.1, 0.0, 0.0),
        };
        assert_eq!(read_text(&log(pose)).unwrap().1.kind, LogKind::Raw, "{late}");
    }
}

#[test]
fn a_true_pose_is_carried_to_the_scan_by_odometry() {
    let text = "TRUEPOS 10 20 1.5707963267948966 1 0 0 0.5 h 0\n\
                FLASER 1 1 2 0 0 2 0 0 1 h 1\n\
                FLASER 1 1 3 0 0 3 0 0 2 h 2\n";
    let (drive, summary) = read_text(text).unwrap();
    assert_eq!(summary.kind, LogKind::Simulated);
    assert!(summary.evidence.contains("1 of 2 scans"));
    // Odometry moves on by one metre, which at a heading of 90 degrees is along y.
    assert!(near(&drive.steps[0].reference.unwrap(), &Pose2::new(10.0, 21.0, std::f64::consts::FRAC_PI_2)));
    assert_eq!(drive.steps[1].reference, None);
}

#[test]
fn readings_at_the_ends_of_the_range_become_sentinels() {
    let text = "FLASER 6 0 0.05 1.5e0 81.82 81.83 inf 0 0 0 0 0 0 1 h 1\r\n";
    let ranges = |options| read_with(text, &options).unwrap().0.steps[0].scan.ranges.clone();
    let all = ranges(CarmenOptions::default());
    assert!(all[0].is_nan());
    assert_eq!(all[1..], [0.05, 1.5, 81.82, 81.83, 81.83]);
    let narrow = CarmenOptions { max_range_m: Some(50.0), min_range_m: Some(0.1), ..Default::default() };
    let few = ranges(narrow);
    assert!(few[0].is_nan() && few[1].is_nan());
    assert_eq!(few[2..], [1.5, 50.0, 50.0, 50.0]);
    let (drive, summary) = read_with(text, &narrow).unwrap();
    assert_eq!((drive.laser.min_range(), drive.laser.max_range()), (0.1, 50.0));
    assert_eq!((summary.no_return_share, summary.unusable_share), (0.5, 1.0 / 3.0));
    assert_eq!(summary.longest_return_m, Some(1.5));
}

#[test]
fn a_robotlaser_line_describes_its_laser() {
    let text = "ROBOTLASER1 0 -1 2 0.5 30 0.01 0 5 1 2 3 4 30 2 7 7 0.25 0 0 0 0 0 0 0 0 0 0 9 h 9\n\
                FLASER 2 1 1 0 0 0 0 0 0 9 h 9\n";
    let (drive, summary) = read_text(text).unwrap();
    assert_eq!(drive.laser.bearings(), [-1.0, -0.5, 0.0, 0.5, 1.0]);
    assert_eq!(drive.laser.max_range(), 30.0);
    assert_eq!(drive.steps[0].scan.ranges, [1.0, 2.0, 3.0, 4.0, 30.0]);
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(0.25, 0.0, 0.0)));
    // The other form of the same laser's lines is skipped.
    assert_eq!(summary.scan_source, "ROBOTLASER1");
    assert_eq!(summary.skipped["FLASER"], 1);
    let no_resolution = text.replace(" 0.5 30", " 0 30");
    assert_eq!(read_text(&no_resolution).unwrap().0.laser, drive.laser);
}

/// Lines of CMU's Wean Hall logs: centimetres, the laser 25 cm ahead, codes from 8183 on for no return.
#[test]
fn lines_of_cmu_are_in_centimetres() {
    let text = "O 100 200 1.5707963267948966 0.5\n\
                L 110 200 1.5707963267948966 110 225 1.5707963267948966 66 500 8183 8191 1\n\
                O 120 200 1.5707963267948966 1.5\n\
                L 130 200 1.5707963267948966 130 225 1.5707963267948966 66 501 0 8187 2\n";
    let (drive, summary) = read_text(text).unwrap();
    assert_eq!((summary.kind, summary.odometry), (LogKind::Raw, OdometrySource::ScanLines));
    assert_eq!((summary.scan_source.as_str(), summary.odometry_messages), ("L", 2));
    assert!(summary.skipped.is_empty());
    let mount = drive.laser.base_from_laser();
    assert!(near(&mount, &Pose2::new(0.25, 0.0, 0.0)), "{mount:?}");
    assert_eq!(drive.laser.max_range(), 81.83);
    assert_eq!(drive.steps[0].scan.ranges, [0.66, 5.0, 81.83, 81.83]);
    assert!(drive.steps[1].scan.ranges[2].is_nan());
    assert!(near(&drive.steps[1].odometry, &Pose2::new(1.3, 2.0, std::f64::consts::FRAC_PI_2)));
    assert_eq!((drive.steps[1].stamp_secs, drive.steps[1].reference), (2.0, None));
    // 180 readings begin at the right, a degree apart.
    let whole = format!("L 0 0 0 25 0 0{} 1\n", " 66".repeat(180));
    let bearings = read_text(&whole).unwrap().0.laser.bearings().to_vec();
    assert_eq!((bearings[0].to_degrees(), bearings[179].to_degrees().round()), (-90.0, 89.0));
}

#[test]
fn the_rear_laser_looks_backwards() {
    let text = "PARAM robot_rearlaser_offset -0.3 h 0\nPARAM robot_frontlaser_offset 0.2 h 0\n\
                FLASER 1 1 0 0 0 0 0 0 1 h 1\nRLASER 1 4 0 0 0 0 0 0 1 h 1\n";
    let options = CarmenOptions { laser: CarmenLaser::Rear, ..Default::default() };
    let (drive, summary) = read_with(text, &options).unwrap();
    assert_eq!(drive.steps[0].scan.ranges, [4.0]);
    assert!(near(&drive.laser.base_from_laser(), &Pose2::new(-0.3, 0.0, std::f64::consts::PI)));
    assert_eq!(summary.skipped["FLASER"], 1);
}

/// The maximum range is that of the caller, of the lines, of the parameter of the same laser, of the SICK LMS: the first that there is.
#[test]
fn the_maximum_range_is_a_parameter_of_the_log() {
    let max_of = |text: &str, options: &CarmenOptions| read_with(text, options).unwrap().0.laser.max_range();
    let scan = "FLASER 1 1 0 0 0 0 0 0 1 h 1\n";
    let with = |param: &str| format!("PARAM {param} h 0\n{scan}");
    let own = CarmenOptions::default();
    assert_eq!(max_of(&with("robot_front_laser_max 8.0"), &own), 8.0);
    assert_eq!(max_of(&with("robot_rear_laser_max 8.0"), &own), 81.83);
    assert_eq!(max_of(&with("robot_front_laser_max 90"), &own), 81.83);
    let options = CarmenOptions { max_range_m: Some(6.0), ..own };
    assert_eq!(max_of(&with("robot_front_laser_max 8.0"), &options), 6.0);
    assert_eq!(max_of(&with("robot_front_laser_max 0"), &own), 81.83);
}

#[test]
fn comments_unknown_lines_and_windows_line_ends_are_no_obstacle() {
    let text = raw_log().replace('\n', "\r\n");
    let noisy = format!("# a comment\r\n\r\n# another\r\nSYNC tag 0 h 0\r\n\u{fffd}\u{0} x\r\n{text}");
    let (plain, _) = read_text(&raw_log()).unwrap();
    let (drive, summary) = read_text(&noisy).unwrap();
    assert_eq!(drive, plain);
    let skipped: Vec<_> = summary.skipped.iter().map(|(word, n)| (word.as_str(), *n)).collect();
    assert_eq!(skipped, [("#", 2), ("(no keyword)", 1), ("SYNC", 1)]);
    assert!(summary.to_string().ends_with("skipped: # 2, (no keyword) 1, SYNC 1"), "{summary}");
}

#[test]
fn compression_is_known_by_content() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("without-suffix.log");
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    std::io::Write::write_all(&mut encoder, raw_log().as_bytes()).unwrap();
    let compressed = encoder.finish().unwrap();
    fs::write(&path, &compressed).unwrap();
    let options = CarmenOptions::default();
    assert_eq!(read_carmen(&path, &options).unwrap().0, read_text(&raw_log()).unwrap().0);

    fs::write(&path, &compressed[..compressed.len() / 2]).unwrap();
    let cut = read_carmen(&path, &options).unwrap_err();
    assert!(matches!(cut, DatasetError::Read { .. }), "{cut}");
    let missing = read_carmen(&folder.path().join("missing.log"), &options).unwrap_err();
    assert!(matches!(missing, DatasetError::Open { .. }), "{missing}");
}

/// Recorders that are stopped leave such lines, as the published Freiburg 101 log has one.
#[test]
fn a_cut_last_line_is_left_out_and_counted() {
    let good = "FLASER 2 1 1 0 0 0 0 0 0 1 h 1\nFLASER 2 1 1 0 0 0 0 0 0 2 h 2\n";
    let (whole, whole_summary) = read_text(good).unwrap();
    for cut in ["FLASER 2 1 1 0 0 0 0 0 0 3 h 3", "FLASER 2 1 1 0 0", "ODOM 0 0", "F"] {
        let (drive, summary) = read_text(&format!("{good}{cut}")).unwrap();
        assert_eq!(drive, whole);
        assert_eq!(summary.skipped, [("(cut off)".to_owned(), 1)].into());
        assert!(whole_summary.skipped.is_empty());
    }
}

#[test]
fn errors_name_file_line_keyword_value_and_what_is_allowed() {
    let good = "FLASER 2 1 1 0 0 0 0 0 0 1 h 1\n";
    let robot = "ROBOTLASER1 0 -1 1 1 30 0.01 0 2 1 2 0 0 0 0 0 0 0 0 0 0 0 0 9 h 9\n";
    for (text, parts) in [
        (String::new(), &["test.log", "empty"][..]),
        ("\n# nothing\n".into(), &["empty"]),
        ("M 1 2 3\nN 1\nN 2\n".into(), &["no scan", "FLASER or ROBOTLASER1 or L", "M 1, N 2"]),
        ("O 1 2 3\n".into(), &[":1: O", "4 fields", "5 (O x y theta, time)"]),
        ("L 0 0 0 0 0 0 1\n".into(), &[":1: L", "8 fields", "9 or more (L robot pose"]),
        ("L 0 0 0 0 0 0 1 1 1\nL 0 0 0 0 0 0 1 1\n".into(), &[":2: L", "9 fields", "10 for 2 beams"]),
        ("L 0 0 0 0 0 0 -1 1\n".into(), &["range 1 is `-1`"]),
        ("ODOM 0 0 0 0 0 0 0 h 0\n".into(), &["no scan", "found: ODOM 1"]),
        ("PARAM a 1 h 0\nPARAM b\n# end\n".into(), &["no scan", "found: PARAM 2"]),
        (good.trim_end().into(), &["test.log:1: FLASER", "cut off", "newline"]),
        (format!("{good}{good}").replace('\n', "\r"), &["test.log:1", "lines end in carriage returns alone"]),
        (format!("{good}FLASER 2 1 1 0 0\n"), &[":2: FLASER", "6 fields", "13 for 2 beams"]),
        (format!("{good}ODOM 0 0 0\n"), &[":2: ODOM", "4 fields", "10 (ODOM x y theta"]),
        (format!("{good}TRUEPOS 0 0 0 0 0 0 0 h\n"), &[":2: TRUEPOS", "9 fields", "10 (TRUEPOS"]),
        ("FLASER 3 1 1 0 0 0 0 0 0 1 h 1\n".into(), &[":1: FLASER", "13 fields", "14 for 3 beams"]),
        ("FLASER\n".into(), &[":1: FLASER", "number of beams is ``"]),
        ("FLASER 0 0 0 0 0 0 0 1 h 1\n".into(), &["number of beams is `0`", "1 or more"]),
        ("FLASER 18446744073709551615 1\n".into(), &["3 fields", "18446744073709551615 for"]),
        (format!("{good}FLASER 1 1 0 0 0 0 0 0 1 h 1\n"), &[":2:", "number of beams is `1`", "2, as in"]),
        (good.replace("2 1 1", "2 1 -1"), &["range 2 is `-1`", "a range of 0 or more"]),
        (good.replace("2 1 1", "2 nan 1"), &["range 1 is `nan`", "a range of 0 or more"]),
        (good.replace("2 1 1", "2 1 x1"), &["range 2 is `x1`"]),
        ("FLASER 1 1 0 inf 0 0 0 0 1 h 1\n".into(), &["laser y is `inf`", "a finite number"]),
        ("ODOM 0 0 0 0 0 0 noon h 0\n".into(), &["ODOM", "ipc_timestamp is `noon`"]),
        ("PARAM robot_frontlaser_offset on h 0\n".into(), &["robot_frontlaser_offset is `on`"]),
        (robot.replace("1 1 30", "1 0.1 30"), &["angular_resolution is `0.1`", "2 beams over 1 rad"]),
        (robot.replace(" 30 ", " 0 "), &["maximum_range is `0`", "more than 0 m"]),
        (
            robot.replace("2 1 2 0", "2 1 2 5"),
            &["ROBOTLASER1", "26 fields", "31 for 2 beams and 5 remissions"],
        ),
        ("ROBOTLASER1 0 -1 1 1 30 0.01 0 2 1\n".into(), &["10 fields", "26 or more for 2 beams"]),
        (format!("{robot}{}", robot.replace("-1 1 1", "-2 1 1")), &[":2:", "from -2 rad", "same laser"]),
        (format!("{} 1\n", "9".repeat(1 << 20)), &["test.log:1:", "too long", "1048576"]),
    ] {
        let message = read_text(&text).unwrap_err().to_string();
        for part in parts {
            assert!(message.contains(part), "{:?}\n{message}\n{part}", text.get(..80));
        }
    }
    for options in [
        CarmenOptions { max_range_m: Some(0.0), ..Default::default() },
        CarmenOptions { min_range_m: Some(f32::NAN), ..Default::default() },
    ] {
        let refused = read_with(good, &options).unwrap_err();
        assert!(matches!(refused, DatasetError::Laser { .. }), "{refused}");
    }
}

#[test]
fn what_does_not_fit_into_a_log_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.log");
    let laser =
        |bearings: Vec<f32>, times: Vec<f32>| Laser::new(bearings, times, 0.0, 5.0, Pose2::IDENTITY).unwrap();
    let even = laser(vec![0.0, 0.1, 0.2], vec![0.0; 3]);
    let step = |ranges: &[f32]| DriveStep {
        stamp_secs: 0.0,
        odometry: Pose2::IDENTITY,
        reference: None,
        scan: Scan { ranges: ranges.to_vec() },
    };
    let good = step(&[1.0, 2.0, f32::NAN]);
    let lost = DriveStep { odometry: Pose2 { x: f64::NAN, ..Pose2::IDENTITY }, ..good.clone() };
    for (laser, steps, part) in [
        (even.clone(), vec![], "no scan"),
        (laser(vec![0.0, 0.1, 0.3], vec![0.0; 3]), vec![good.clone()], "bearings"),
        (laser(vec![0.0, 0.1, 0.2], vec![0.0, 0.0, 0.1]), vec![good.clone()], "beam times"),
        (even.clone(), vec![good.clone(), lost], "scan 1: a pose"),
        (even.clone(), vec![step(&[1.0])], "scan 0 has 1 ranges; allowed: 3"),
        (even.clone(), vec![step(&[1.0, 1.0, 6.0])], "range of 6 m; allowed: 0 to 5 m"),
        (even.clone(), vec![step(&[1.0, 1.0, -1.0])], "range of -1 m"),
    ] {
        let message = write_carmen(&path, &Drive { laser, steps }).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
    assert!(!path.exists());
    write_carmen(&path, &Drive { laser: even, steps: vec![good] }).unwrap();
    let names: Vec<_> = fs::read_dir(&folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["drive.log"]);
}

#[test]
fn a_log_costs_so_much_and_no_more() {
    let scan = "FLASER 50 ".to_owned() + &"1 ".repeat(50) + "0 0 0 0 0 0 1 h 1\n";
    let read = |text: &str, limits: &Limits| {
        let text = Cursor::new(text.as_bytes().to_vec());
        let result = read_from(Path::new("test.log"), text, &CarmenOptions::default(), limits);
        result.map(|(drive, _)| drive.steps.len()).map_err(|error| error.to_string())
    };
    let ten = scan.repeat(10);
    // Each scan counts for a hundred readings more.
    let readings = |log_readings| Limits { log_readings, ..Limits::DEFAULT };
    assert_eq!(read(&ten, &readings(1500)), Ok(10));
    assert_eq!(
        read(&ten, &readings(1499)).unwrap_err(),
        "test.log:10: more than 1499 range readings of a log (100 more for each scan) are not allowed \
         (`--limit log_readings=2998` allows twice as many)"
    );
    let lines = |log_messages| Limits { log_messages, ..Limits::DEFAULT };
    let text = format!("\n# nothing\n{scan}");
    assert_eq!(read(&text, &lines(3)), Ok(1));
    let message = read(&text, &lines(2)).unwrap_err();
    assert!(message.starts_with("test.log:3: more than 2 lines of a text log"), "{message}");
}

#[test]
fn unknown_keywords_are_counted_up_to_a_hundred() {
    let mut text = "WORD005 2\n".to_owned();
    for i in 0..1000 {
        writeln!(text, "WORD{i:03} 1").unwrap();
    }
    let (_, summary) = read_text(&(text + &raw_log())).unwrap();
    assert_eq!(summary.skipped.len(), 101);
    assert_eq!(
        (summary.skipped["WORD005"], summary.skipped["WORD099"], summary.skipped["(others)"]),
        (2, 1, 900)
    );
}

#[test]
fn numbers_that_arithmetic_cannot_bear_are_refused() {
    let robot = "ROBOTLASER1 0 -1 1 1 30 0.01 0 2 1 2 0 0 0 0 0 0 0 0 0 0 0 0 9 h 9\n";
    for (text, part) in [
        ("ODOM 1e300 0 0 0 0 0 0 h 0\n".to_owned(), "robot x is `1e300`; allowed: a finite number up to 1e9"),
        ("FLASER 1 1 0 0 0 0 -1.1e9 0 1 h 1\n".into(), "robot y is `-1.1e9`"),
        ("FLASER 1 1 0 0 1e10 0 0 0 1 h 1\n".into(), "laser theta is `1e10`"),
        (
            "FLASER 1 1 0 0 0 0 0 0 1e13 h 1\n".into(),
            "ipc_timestamp is `1e13`; allowed: a finite number up to 1e12",
        ),
        ("PARAM robot_frontlaser_offset 1e300 h 0\n".into(), "robot_frontlaser_offset is `1e300`"),
        (robot.replace("-1 1 1 30", "-1 1e300 1e300 30"), "field_of_view is `1e300`"),
        (robot.replace("-1 1 1 30", "-90 1 1 30"), "start_angle is `-90`; allowed: radians, up to a turn"),
        (robot.replace("-1 1 1 30", "-1 180 1 30"), "field_of_view is `180`; allowed: radians, up to a turn"),
        (robot.replace(" 30 ", " 1e30 "), "maximum range is 1e30 m; allowed: 0.001 to 10000 m"),
        (format!("PARAM {} 1e9 h 0\n{robot}", parse::BEAM_INTERVAL), ""),
        (
            format!(
                "PARAM {} 1e8 h 0\nFLASER 12{} 0 0 0 0 0 0 1 h 1\n",
                parse::BEAM_INTERVAL,
                " 1".repeat(12)
            ),
            "time of a beam is 1100000000; allowed",
        ),
    ] {
        match read_text(&text) {
            Ok(_) => assert_eq!(part, ""),
            Err(error) => assert!(!part.is_empty() && error.to_string().contains(part), "{error}"),
        }
    }
}

#[test]
fn an_error_holds_no_control_characters_and_is_short() {
    for text in [
        format!("\u{1b}[2J{}", "x".repeat(1000)),
        format!("FLASER \u{1b}[2J{}\n", "x".repeat(1000)),
        format!("\u{7}{} 1\n", "x".repeat(1000)),
    ] {
        let message = read_text(&text).unwrap_err().to_string();
        assert!(message.len() < 300 && !message.contains(char::is_control), "{message:?}");
    }
}

/// The temporary file never replaces an existing neighbour.
#[test]
fn a_neighbour_of_the_file_stays() {
    let folder = tempfile::tempdir().unwrap();
    let (drive, _) = read_text(&raw_log()).unwrap();
    for name in ["a.log", "a.log.gz", "a.mcap"] {
        let (path, neighbour) = (folder.path().join(name), folder.path().join(format!("{name}.partial")));
        fs::write(&neighbour, "precious").unwrap();
        write_log(&path, &drive).unwrap();
        assert_eq!(fs::read(&neighbour).unwrap(), b"precious");
        let mut bytes = Vec::new();
        encode_log(&path, &drive, &mut bytes).unwrap();
        assert!(fs::read(&path).unwrap() == bytes, "{name}");
    }
}

proptest! {
    #[test]
    fn a_written_drive_reads_back(drive in drive(), compressed in any::<bool>()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(if compressed { "drive.log.gz" } else { "drive.log" });
        write_carmen(&path, &drive).unwrap();
        let starts_as_gzip = fs::read(&path).unwrap().starts_with(&[0x1f, 0x8b]);
        prop_assert_eq!(starts_as_gzip, compressed);

        let (back, summary) = read_carmen(&path, &CarmenOptions::default()).unwrap();
        let known = drive.steps.iter().any(|step| step.reference.is_some());
        prop_assert_eq!(summary.kind, if known { LogKind::Simulated } else { LogKind::Raw });
        prop_assert_eq!((summary.stamps_repaired, summary.intervals_without_odometry), (0, 0));
        prop_assert_eq!(back.steps.len(), drive.steps.len());
        for (a, b) in back.steps.iter().zip(&drive.steps) {
            prop_assert_eq!((a.stamp_secs, a.odometry, a.reference), (b.stamp_secs, b.odometry, b.reference));
            prop_assert_eq!(bits(&a.scan), bits(&b.scan));
        }
        let (a, b) = (&back.laser, &drive.laser);
        prop_assert_eq!((a.min_range(), a.max_range()), (b.min_range(), b.max_range()));
        prop_assert_eq!(a.base_from_laser(), b.base_from_laser());
        for (a, b) in a.bearings().iter().zip(b.bearings()) {
            prop_assert!((a - b).abs() <= 1e-6);
        }
        for (a, b) in a.beam_times_secs().iter().zip(b.beam_times_secs()) {
            prop_assert!((a - b).abs() <= 1e-6);
        }
    }

    #[test]
    fn no_bytes_make_the_reader_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = read_from(Path::new("test.log"), Cursor::new(&bytes), &CarmenOptions::default(), &Limits::DEFAULT);
    }

    #[test]
    fn no_words_make_the_reader_panic(
        words in prop::collection::vec(
            prop::sample::select(vec![
                "FLASER", "ROBOTLASER1", "L", "O", "ODOM", "TRUEPOS", "PARAM", "robot_frontlaser_offset", "laser_front_laser_fov",
                "laser_front_laser_resolution", "locsim_laser_min_range_m", "1", "2", "0", "-1", "1e308", "-1e308",
                "1e999", "nan", "inf", "18446744073709551615", "h", "\n", "\n", " ",
            ]), 0..120),
    ) {
        let text = words.join(" ") + "\n";
        let _ = read_text(&text);
    }

    /// A log that is cut anywhere but at a line's end is refused.
    #[test]
    fn a_cut_log_has_the_scans_of_its_whole_lines(share in 0.0..1.0f64) {
        let text = corrected_log(3);
        let cut = &text[..(share * text.len() as f64) as usize];
        let whole = &cut[..cut.rfind('\n').map_or(0, |end| end + 1)];
        let scans = whole.lines().filter(|line| line.starts_with("FLASER")).count();
        if let Ok((drive, summary)) = read_text(cut) {
            prop_assert_eq!(drive.steps.len(), scans);
            prop_assert_eq!(summary.skipped.contains_key("(cut off)"), cut.len() > whole.len());
        } else {
            prop_assert_eq!(scans, 0);
        }
    }
}

/// ODOM lines every 40 ms and scans every 130 ms, each with its own time: between two lines the odometry is where the robot was. Lines that are a
/// second apart, or of another clock, tell no more than where they are.
#[test]
fn odometry_of_lines_is_at_the_times_of_the_scans() {
    let at = |secs: f64| words(&Pose2::new(0.8 * secs, 0.0, 0.5 * secs));
    let text = |interval: f64, of_clock: f64| {
        let mut text = String::new();
        let (mut line, mut scan) = (0.0, 0.0);
        for _ in 0..300 {
            if line <= scan {
                writeln!(text, "ODOM {} 0 0 0 {} h 0", at(line), line + of_clock).unwrap();
                line += interval;
            } else {
                writeln!(text, "FLASER 1 1 0 0 0 0 0 0 {scan} h 0").unwrap();
                scan += 0.13;
            }
        }
        text
    };
    let worst = |text: &str| {
        let (drive, summary) = read_text(text).unwrap();
        assert_eq!(summary.odometry, OdometrySource::OdomLines);
        let off = |step: &DriveStep| (step.odometry.x - 0.8 * step.stamp_secs).abs();
        // After the last line nothing is known.
        drive.steps[..drive.steps.len() - 1].iter().map(off).fold(0.0, f64::max)
    };
    assert!(worst(&text(0.04, 0.0)) < 1e-6);
    for (interval, of_clock) in [(1.0, 0.0), (0.04, 500.0)] {
        assert!(worst(&text(interval, of_clock)) > 0.8 * 0.02);
    }
}
