//! Bags that other programs wrote, as real robots publish them: `data/recordings.py` makes them.
//!
//! The readings tell whether all of a bag is understood, its topics, transforms, mount, bearings and stamps: projected from
//! the poses that were read, they end on the walls of the room.

use std::path::{Path, PathBuf};

use locsim_core::{Drive, Pose2};
use locsim_dataset::{LogKind, LogOptions, LogSummary, MountSource, OdometrySource, read_contents, read_log};

/// The robot at the first time of the odometry.
const START: Pose2 = Pose2 { x: 0.8, y: 0.7, theta: 0.2 };

/// The walls of the room and of its pillar: least x, least y, greatest x, greatest y (m).
const RECTANGLES: [[f64; 4]; 2] = [[0.0, 0.0, 4.0, 3.0], [3.0, 0.6, 3.4, 1.0]];

/// Interpolated poses, stamps with jitter and rounding to f32 (m).
const NEAR_M: f64 = 2e-3;

fn recording(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/recordings").join(name)
}

fn named(scan: &str, odometry: &str, reference: &str) -> LogOptions {
    let mut options = LogOptions::default();
    let name = |name: &str| (!name.is_empty()).then(|| name.to_owned());
    options.topics.scan = name(scan);
    options.topics.odometry = name(odometry);
    options.topics.reference = name(reference);
    options
}

fn read(name: &str, options: &LogOptions) -> (Drive, LogSummary) {
    read_log(&recording(name), options).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Distance of a place to the nearest wall (m).
fn to_a_wall(x: f64, y: f64) -> f64 {
    let to_edges = RECTANGLES.map(|[left, lower, right, upper]| {
        let inside = [x - left, right - x, y - lower, upper - y].into_iter().fold(f64::MAX, f64::min);
        let beside = (left - x).max(x - right).max(0.0).hypot((lower - y).max(y - upper).max(0.0));
        inside.abs().max(beside)
    });
    to_edges[0].min(to_edges[1])
}

/// Number of readings that end on a wall, seen from `base` of each step; all that are no return or unusable are left out.
fn on_walls(name: &str, drive: &Drive, base: impl Fn(usize) -> Pose2) -> usize {
    let laser = &drive.laser;
    let mut count = 0;
    for (i, step) in drive.steps.iter().enumerate() {
        let from = base(i).compose(&laser.base_from_laser());
        let usable = step.scan.ranges.iter().zip(laser.bearings());
        for (range, bearing) in usable.filter(|(range, _)| **range < laser.max_range()) {
            let (sin, cos) = (from.theta + f64::from(*bearing)).sin_cos();
            let range = f64::from(*range);
            let off = to_a_wall(from.x + range * cos, from.y + range * sin);
            assert!(off < NEAR_M, "{name}: step {i}, bearing {bearing}: {off} m off the nearest wall");
            count += 1;
        }
    }
    count
}

/// What is read of a recording.
struct Expected {
    file: &'static str,
    options: LogOptions,
    kind: LogKind,
    odometry: OdometrySource,
    scan: &'static str,
    /// Beams, and those of them that have readings in each scan.
    beams: [usize; 2],
    /// Bearing of the first beam (deg).
    first_deg: f64,
}

impl Default for Expected {
    fn default() -> Self {
        Self {
            file: "nav2.mcap.zstd",
            options: LogOptions::default(),
            kind: LogKind::Localized,
            odometry: OdometrySource::Topic,
            scan: "/scan",
            beams: [36, 27],
            first_deg: -180.0,
        }
    }
}

fn all() -> Vec<Expected> {
    let usual = Expected::default;
    let rear = Expected {
        file: "two_scanners.mcap.zstd",
        options: named("/scan_rear", "", ""),
        scan: "/scan_rear",
        beams: [12, 8],
        first_deg: (-0.8_f64).to_degrees(),
        ..usual()
    };
    let front = Expected {
        options: named("/scan_front", "", ""),
        scan: "/scan_front",
        beams: [20, 15],
        first_deg: (-1.4_f64).to_degrees(),
        file: rear.file,
        ..usual()
    };
    let mocap =
        |file, topic| Expected { file, options: named("", "", topic), kind: LogKind::Referenced, ..usual() };
    let stored = ["split", "chunks_zstd.mcap", "chunks_lz4.mcap", "messages_zstd.db3", "humble.db3"];
    let mut all: Vec<Expected> = stored.map(|file| Expected { file, ..usual() }).into();
    all.extend([
        usual(),
        Expected { file: "tf_only.mcap.zstd", odometry: OdometrySource::Transforms, ..usual() },
        Expected { file: "amcl_pose.mcap.zstd", ..usual() },
        mocap("mocap_pose.mcap.zstd", "/vrpn_mocap/robot/pose"),
        mocap("mocap_transform.mcap.zstd", "/vicon/robot/robot"),
        Expected { file: "no_reference.mcap.zstd", kind: LogKind::Raw, ..usual() },
        rear,
        front,
        // A beam that no point was ever on isn't known: NaN is beam 3, and each fifth has no return.
        Expected { file: "cloud.mcap.zstd", scan: "/points", first_deg: -170.0, beams: [34, 27], ..usual() },
        Expected {
            file: "multi_echo.mcap.zstd",
            scan: "/echoes",
            beams: [30, 23],
            first_deg: (-2.0_f64).to_degrees(),
            ..usual()
        },
        Expected { file: "clockwise.mcap.zstd", first_deg: 180.0, ..usual() },
        Expected { file: "at_maximum.mcap.zstd", beams: [37, 28], ..usual() },
        // Mirrored: the first beam looks to the left.
        Expected {
            file: "upside_down.mcap.zstd",
            first_deg: 1.5_f64.to_degrees(),
            beams: [31, 23],
            ..usual()
        },
        Expected { file: "namespace.mcap.zstd", scan: "/robot1/scan", ..usual() },
        Expected { file: "prefixed_frames.mcap.zstd", scan: "/robot1/scan", ..usual() },
        Expected { file: "out_of_order.mcap.zstd", ..usual() },
        Expected { file: "empty_scan.mcap.zstd", ..usual() },
        Expected { file: "two_odometries.mcap.zstd", ..usual() },
        Expected { file: "two_odometries.mcap.zstd", options: named("", "/wheel/odometry", ""), ..usual() },
        Expected {
            options: named("", "odom:base_footprint", "/tf:map.base_link"),
            odometry: OdometrySource::Transforms,
            kind: LogKind::Referenced,
            ..usual()
        },
    ]);
    all
}

#[test]
fn recordings_of_other_programs_are_read_as_they_are() {
    for expected in all() {
        let Expected { file, options, kind, odometry, scan, beams: [beams, usable], first_deg } = expected;
        let (drive, summary) = read(file, &options);
        assert_eq!((summary.kind, summary.odometry), (kind, odometry), "{file}: {summary}");
        assert_eq!(
            (summary.scan_source.as_str(), summary.mount),
            (scan, MountSource::StaticTransforms),
            "{file}"
        );
        assert_eq!((drive.steps.len(), drive.laser.beam_count()), (40, beams), "{file}: {summary}");
        let first = f64::from(drive.laser.bearings()[0]).to_degrees();
        assert!((first - first_deg).abs() < 1e-3, "{file}: {first}");

        let origin = drive.steps[0].odometry;
        assert!((origin.x).hypot(origin.y) < 0.01, "{file}: {origin:?}");
        let by_odometry = on_walls(file, &drive, |i| START.compose(&drive.steps[i].odometry));
        assert_eq!(by_odometry, 40 * usable, "{file}: {summary}");
        let referenced = drive.steps.iter().filter(|step| step.reference.is_some()).count();
        assert_eq!(referenced, if kind == LogKind::Raw { 0 } else { 40 }, "{file}: {summary}");
        if referenced > 0 {
            on_walls(file, &drive, |i| drive.steps[i].reference.unwrap());
        }
    }
}

#[test]
fn scans_without_readings_are_counted() {
    let (_, summary) = read("empty_scan.mcap.zstd", &LogOptions::default());
    assert_eq!(summary.scans_dropped, 1);
}

/// Topics on which nothing was published are listed, and nothing else comes of them.
#[test]
fn empty_topics_are_listed() {
    let contents = read_contents(&recording("nav2.mcap.zstd")).unwrap();
    let topic = contents.topics.iter().find(|topic| topic.name == "/diagnostics").unwrap();
    assert_eq!((topic.messages, topic.rate_hz), (0, None));
}

#[test]
fn a_choice_that_has_to_be_made_names_the_topics() {
    let error =
        |name: &str, options: &LogOptions| read_log(&recording(name), options).unwrap_err().to_string();
    let scanners = error("two_scanners.mcap.zstd", &LogOptions::default());
    assert!(
        scanners.contains("no single other topic of type")
            && scanners.contains("but /scan_front and /scan_rear; allowed: a topic that is named"),
        "{scanners}"
    );
    let absent = error("nav2.mcap.zstd", &named("", "", "/vicon/robot"));
    assert!(
        absent.contains("reference topic `/vicon/robot` isn't there") && absent.contains("/amcl_pose ("),
        "{absent}"
    );
}

#[test]
fn a_recording_that_was_cut_off_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (name, part) in [
        ("humble.db3", "not a sound bag in SQLite"),
        ("chunks_lz4.mcap", "`mcap recover` mends one that was cut off"),
        ("nav2.mcap.zstd", "cut off"),
    ] {
        let whole = std::fs::read(recording(name)).unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        let error = read_log(&path, &LogOptions::default()).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    // Part of a folder.
    let split = folder.path().join("split");
    std::fs::create_dir(&split).unwrap();
    for file in ["metadata.yaml", "split_0.mcap.zstd"] {
        std::fs::copy(recording("split").join(file), split.join(file)).unwrap();
    }
    let error = read_log(&split, &LogOptions::default()).unwrap_err().to_string();
    assert!(error.contains("`split_1.mcap.zstd` isn't there, which metadata.yaml lists"), "{error}");
    std::fs::remove_file(split.join("metadata.yaml")).unwrap();
    assert!(read_log(&split, &LogOptions::default()).is_ok());
}
