//! The road from a recording to a report: `inspect` says what a log holds, `init` writes a scenario that `run`, `map` and `gap`
//! take as it is.

mod common;

use std::path::Path;

use common::{Folder, SCENARIO, edited, locsim, output};
use predicates::prelude::*;
use predicates::str::contains;
use serde_json::Value;

/// A bag that the Python package rosbags wrote: no odometry topic, five scans, `/tf` and `/amcl_pose`.
fn bag() -> String {
    let path = "../dataset/tests/data/rosbags";
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path).canonicalize().unwrap().display().to_string()
}

/// A folder with a drive through the corridor of the room, three times there and back.
fn folder_with_a_drive(name: &str) -> Folder {
    let folder = Folder::new();
    let path = "[[0.6, 0.9], [2.6, 0.9]]";
    let rounds = "[[0.6, 0.9], [2.6, 0.9], [2.6, 0.6], [0.6, 0.6], [0.6, 1.2], [2.4, 1.0], [0.6, 0.9], [2.6, 0.8], [0.7, 0.7]]";
    let text = edited(SCENARIO, path, rounds);
    folder.write("drive.yaml", edited(&text, "beams: 12", "beams: 60"));
    folder.locsim(&format!("simulate drive.yaml --out {name} --seed 5")).success();
    folder
}

fn inspected(folder: &Folder, log: &str) -> Value {
    serde_json::from_str(&output(&folder.locsim(&format!("inspect {log} --json")).success())).unwrap()
}

fn names(list: &Value, key: &str) -> Vec<String> {
    list.as_array().unwrap().iter().map(|entry| entry[key].as_str().unwrap().to_owned()).collect()
}

#[test]
fn a_bag_of_another_program_is_described() {
    let folder = Folder::new();
    let found = inspected(&folder, &bag());
    assert_eq!(found["format"], "bag");
    assert!(names(&found["topics"], "name").contains(&"/amcl_pose".to_owned()), "{}", found["topics"]);
    let pairs = names(&found["transforms"], "frames");
    assert!(pairs.contains(&"odom:base_footprint".to_owned()), "{pairs:?}");
    let scanner = &found["scanners"][0];
    assert_eq!((&scanner["source"], &scanner["beams"]["count"]), (&"/scan".into(), &36.into()));
    let drive = &found["drive"];
    assert_eq!(drive["odometry_source"], "transforms");
    assert_eq!(drive["laser"]["mount_source"], "static_transforms");
    assert!((drive["laser"]["first_rad"].as_f64().unwrap() + std::f64::consts::PI).abs() < 1e-6);
    assert!((drive["clock"]["interval_secs"].as_f64().unwrap() - 0.1).abs() < 1e-6);
    assert!(found["lacks"]["gap"][0].as_str().unwrap().contains("5 of the 40"), "{}", found["lacks"]);
    assert_eq!(found["split"], Value::Null, "five scans aren't cut");

    let text = output(&folder.locsim(&format!("inspect {}", bag())).success());
    for part in
        ["map:odom", "36 beams, the first at -180.00 deg", "from /tf_static", "every 0.100 s", "Warnings"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
    // Nothing is left out or wrapped by a terminal of 80 columns.
    let bags = Path::new(&bag()).parent().unwrap().to_owned();
    let narrow = output(&locsim(&bags, "inspect rosbags").env("COLUMNS", "80").assert().success());
    assert!(narrow.lines().all(|line| line.chars().count() <= 80), "{narrow}");
    assert!(narrow.contains("PoseWithCovarianceStamped") && !narrow.contains("left out:"), "{narrow}");
}

#[test]
fn logs_of_every_format_are_inspected_and_drawn() {
    for name in ["drive.log.gz", "drive.mcap"] {
        let folder = folder_with_a_drive(name);
        let found = inspected(&folder, name);
        let drive = &found["drive"];
        assert!(
            (drive["readings"]["flat_noise_m"].as_f64().unwrap() - 0.02).abs() < 0.01,
            "{}",
            drive["readings"]
        );
        assert_eq!(found["lacks"]["run"], Value::Array(Vec::new()));
        assert_eq!(drive["reference"]["scans"], drive["scans"]);
        // The room is small: the map knows every place.
        assert!(found["split"]["least_localized"].as_f64().unwrap() > 0.8, "{}", found["split"]);
        let text = output(&folder.locsim(&format!("inspect {name} --picture drive.svg")).success());
        assert!(text.contains("map_scans: [[") && text.contains("localize_scans: [["), "{text}");
        assert!(folder.read("drive.svg").starts_with(b"<svg"));
        folder.locsim(&format!("inspect {name} --picture drive.png")).success();
        assert!(folder.read("drive.png").starts_with(b"\x89PNG"));
        // Nothing is overwritten without being asked to.
        folder.locsim(&format!("inspect {name} --picture drive.svg")).code(2).stderr(contains("--force"));
        folder
            .locsim(&format!("inspect {name} --picture drive.pdf"))
            .code(2)
            .stderr(contains(".svg or .png"));
    }
}

/// The proposed split is a scenario's: it runs, and no filter gets lost.
#[test]
fn the_proposed_split_runs() {
    let folder = folder_with_a_drive("drive.log");
    let text = output(&folder.locsim("inspect drive.log").success());
    let keys: Vec<&str> = text.lines().filter(|line| line.contains("_scans: [[")).map(str::trim).collect();
    let log = format!("log:\n  file: drive.log\n  {}\n", keys.join("\n  "));
    let rest = "seed: 1\nmodels: [likelihood_field]\nfilter:\n  particles: 300\n  motion: {model: odometry, alpha: [0.1, \
                0.05, 0.1, 0.05]}\n  start: {tracking: {sigma_m: 0.1, sigma_deg: 3}}\n";
    folder.write("split.yaml", format!("{log}{rest}"));
    let run = folder.locsim("run split.yaml --json --record none").success();
    let summary: Value = serde_json::from_str(&output(&run)).unwrap();
    assert_eq!(summary["models"]["likelihood_field"]["lost_share"], 0.0);
}

#[test]
fn a_log_that_lacks_something_is_inspected_all_the_same() {
    let folder = folder_with_a_drive("drive.log");
    let text = String::from_utf8(folder.read("drive.log")).unwrap();
    let lines = |keep: &dyn Fn(&str) -> bool| -> String {
        text.split_inclusive('\n').filter(|line| keep(line)).collect()
    };
    // Without a reference.
    folder.write("raw.log", lines(&|line| !line.starts_with("TRUEPOS")));
    let found = inspected(&folder, "raw.log");
    assert_eq!(found["drive"]["reference"], Value::Null);
    assert_eq!(found["split"], Value::Null);
    assert!(found["lacks"]["map"][0].as_str().unwrap().contains("a reference"), "{}", found["lacks"]);
    folder.locsim("inspect raw.log --picture raw.svg").success().stdout(contains("can't tell errors"));

    // A single scan.
    let first =
        text.lines().position(|line| line.starts_with("FLASER") || line.starts_with("ROBOTLASER")).unwrap();
    let one: String = text.split_inclusive('\n').take(first + 1).collect();
    folder.write("one.log", one);
    folder.locsim("inspect one.log --picture one.svg").success().stdout(contains("1 in 0.0 s"));

    // No scan at all: the contents are listed, and the reason is told.
    folder.write("none.log", lines(&|line| line.starts_with("ODOM")));
    folder
        .locsim("inspect none.log --picture none.svg")
        .code(2)
        .stdout(contains("no scan in this log").and(contains("needs a drive that can be read")))
        .stderr(contains("error: none.log: no scan in this log"));

    // Odometry that isn't there.
    let found: Value = serde_json::from_str(&output(
        &folder.locsim(&format!("inspect {} --odometry-topic /odom --json", bag())).success(),
    ))
    .unwrap();
    assert!(found["problem"].as_str().unwrap().contains("odometry topic `/odom` isn't there"), "{found}");
    assert_eq!(
        (&found["drive"]["odometry_source"], &found["drive"]["scans"]),
        (&"missing".into(), &5.into())
    );

    // What is no log stays an error.
    folder.write("image.log", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR");
    folder.locsim("inspect image.log").code(2);
    folder.locsim("inspect nothing.log").code(2);
}

/// The two commands from a log to a report, and the others on the same scenario.
#[test]
fn a_new_scenario_serves_run_map_and_gap_without_an_edit() {
    let folder = folder_with_a_drive("drive.mcap");
    folder
        .locsim("init drive.mcap -o my.yaml")
        .success()
        .stdout(contains("`locsim run my.yaml`").and(contains("`locsim gap my.yaml --out found`")));
    let text = String::from_utf8(folder.read("my.yaml")).unwrap();
    for part in [
        "file: drive.mcap",
        "map_scans: [[",
        "is fitted to the log's odometry",
        "against the reference",
        "flat walls",
        "from /tf_static",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    folder.locsim("validate my.yaml").success();
    // Two trials: a test needs no more.
    folder.locsim("run my.yaml --trials 2 --record none --json --out results").success();
    assert!(!folder.read("results/report.html").is_empty());
    folder.locsim("map my.yaml --out floor").success();
    assert!(folder.read("floor.pgm").starts_with(b"P5"));
    folder.locsim("gap my.yaml --out found --replicates 19 --scans 60 --beams 12 --no-filter").success();
    // The proposal is a scenario of its own name, which finds log and map from its folder.
    let proposal = String::from_utf8(folder.read("found/scenario.yaml")).unwrap();
    assert!(proposal.contains("name: my-gap") && proposal.contains("file: ../drive.mcap"), "{proposal}");
    folder.locsim("validate found/scenario.yaml").success();

    // Nothing is overwritten.
    folder.locsim("init drive.mcap -o my.yaml").code(2).stderr(contains("--force"));
    folder.locsim("init drive.mcap -o drive.mcap --force").code(2);
    assert!(folder.read("drive.mcap").starts_with(b"\x89MCAP0\r\n"));
    folder.locsim("init drive.mcap -o my.yaml --force").success();
}

#[test]
fn a_bag_keeps_its_files_and_a_log_has_the_name_of_its_format() {
    let folder = folder_with_a_drive("drive.mcap");
    let at = |name: &str| folder.path(name);
    std::fs::create_dir(at("bag")).unwrap();
    std::fs::rename(at("drive.mcap"), at("bag/drive_0.mcap")).unwrap();
    folder.write("bag/metadata.yaml", "rosbag2_bagfile_information: {}\n");
    for file in ["bag/metadata.yaml", "bag/drive_0.mcap"] {
        let before = std::fs::read(at(file)).unwrap();
        folder
            .locsim(&format!("init bag -o {file} --force"))
            .code(2)
            .stderr(contains("this command reads it"));
        assert_eq!(std::fs::read(at(file)).unwrap(), before, "{file}");
    }
    for name in ["drive.bag", "drive.db3"] {
        let allowed = "isn't written as";
        folder
            .locsim(&format!("convert bag --out {name}"))
            .code(2)
            .stderr(contains(allowed).and(contains(".mcap")));
        assert!(!at(name).exists(), "{name}");
    }
    folder.locsim("convert bag --out drive.log").success();
}

#[test]
fn a_new_scenario_takes_a_map_from_another_folder() {
    let folder = folder_with_a_drive("drive.log");
    folder.locsim("map drive.log --out floor").success();
    std::fs::create_dir(folder.path("runs")).unwrap();
    for map in ["room.yaml", "floor.yaml", "floor.walls.yaml"] {
        folder.locsim(&format!("init drive.log --map {map} -o runs/my.yaml --force")).success();
        let text = String::from_utf8(folder.read("runs/my.yaml")).unwrap();
        assert!(text.contains(&format!("map: {{file: ../{map}}}")), "{text}");
        assert!(!text.contains("map_scans"), "{text}");
        folder.locsim("validate runs/my.yaml").success();
    }
    folder.locsim("init drive.log --map drive.yaml -o runs/other.yaml").code(2);
    folder.locsim("run runs/my.yaml --trials 1 --record none --quiet").success();
}

/// A log without reference poses: the filters run on a map, and the results say what can't be said.
#[test]
fn a_log_without_a_reference_is_localized_on() {
    let folder = folder_with_a_drive("drive.log");
    let text = String::from_utf8(folder.read("drive.log")).unwrap();
    let raw: String = text.split_inclusive('\n').filter(|line| !line.starts_with("TRUEPOS")).collect();
    folder.write("raw.log", raw);
    folder.locsim("init raw.log -o raw.yaml").code(2).stderr(contains("--map names a map"));
    folder.locsim("init raw.log --map room.yaml -o raw.yaml").success();
    let global = String::from_utf8(folder.read("raw.yaml")).unwrap();
    assert!(global.contains("start: global") && !global.contains("train_scans"), "{global}");

    // From a given start, with few particles: the estimates are those of the log with a reference.
    let start = "start: {around: {x_m: 0.6, y_m: 0.9, heading_deg: 0, sigma_m: 0.1, sigma_deg: 3}}";
    let tracked: Vec<&str> =
        global.lines().filter(|line| !line.contains("annealing:") && !line.contains("particles:")).collect();
    let tracked = tracked
        .join("\n")
        .replace("start: global # the log has no reference that could tell the first pose", start)
        .replace("filter:\n", "filter:\n  particles: 500\n");
    assert!(tracked.contains(start), "{tracked}");
    folder.write("tracked.yaml", &tracked);
    let run = folder.locsim("run tracked.yaml --trials 2 --record none --json --out results").success();
    let summary: Value = serde_json::from_str(&output(&run)).unwrap();
    assert_eq!(summary["has_reference"], false);
    assert_eq!(summary["models"].as_array().unwrap().len(), 3);
    for model in summary["models"].as_array().unwrap() {
        assert_eq!(model["gathered_share"], 1.0, "{model}");
        assert!(model["spread_median_m"].as_f64().unwrap() < 0.2, "{model}");
        assert!(model["disagreement_m"].as_f64().unwrap() < 0.5, "{model}");
    }
    let report = String::from_utf8(folder.read("results/report.md")).unwrap();
    assert!(report.contains("no error is known"), "{report}");
    let estimates = String::from_utf8(folder.read("results/trajectories/likelihood_field.tum")).unwrap();
    let last: Vec<f64> =
        estimates.lines().last().unwrap().split_whitespace().map(|word| word.parse().unwrap()).collect();
    // The drive ends at (0.7, 0.7) m.
    assert!((last[1] - 0.7).hypot(last[2] - 0.7) < 0.2, "{last:?}");

    // A start at a reference pose that isn't there.
    let nowhere = tracked.replace(start, "start: {tracking: {sigma_m: 0.1, sigma_deg: 3}}");
    folder.write("nowhere.yaml", nowhere);
    folder.locsim("run nowhere.yaml --record none").code(2).stderr(contains("begins at a reference pose"));
}

/// Written bags have stamps that programs of ROS take for times.
#[test]
fn a_simulated_bag_has_a_date() {
    let folder = folder_with_a_drive("drive.mcap");
    let found = inspected(&folder, "drive.mcap");
    assert_eq!(found["drive"]["clock"]["first_secs"], 1_704_067_200.0);
    let found = inspected(&folder_with_a_drive("drive.log"), "drive.log");
    assert_eq!(found["drive"]["clock"]["first_secs"], 0.0);
}

/// Bags that other programs wrote (`crates/dataset/tests/data/recordings.py`), and their room.
struct Recordings {
    folder: Folder,
}

impl Recordings {
    fn new() -> Self {
        let folder = Folder::new();
        folder.write(
            "floor.yaml",
            "outline: {name: floor, points_m: [[0, 0], [4, 0], [4, 3], [0, 3]]}\n\
             obstacles: [{name: pillar, points_m: [[3, 0.6], [3.4, 0.6], [3.4, 1], [3, 1]]}]\n",
        );
        Self { folder }
    }

    fn file(name: &str) -> String {
        let path = format!("../dataset/tests/data/recordings/{name}");
        Path::new(env!("CARGO_MANIFEST_DIR")).join(path).canonicalize().unwrap().display().to_string()
    }

    /// The scenario that `init` writes for a recording.
    fn scenario(&self, name: &str, options: &str) -> String {
        let file = Self::file(name);
        let line = format!("init {file} --map floor.yaml -o my.robot.yaml --force {options}");
        self.folder.locsim(&line).success();
        self.folder.locsim("validate my.robot.yaml").success();
        String::from_utf8(self.folder.read("my.robot.yaml")).unwrap()
    }
}

/// A driver of 37 beams from -180 to 180 degrees has one twice: the scenario has 36, and `gap` finds them all.
#[test]
fn recordings_of_other_programs_become_scenarios() {
    let recordings = Recordings::new();
    for (name, options, laser) in [
        ("split", "", "beams: 36\n  field_of_view_deg: 360.0\n  first_beam_deg: -180.0\n"),
        ("humble.db3", "", "beams: 36\n"),
        ("chunks_lz4.mcap", "", "beams: 36\n"),
        ("tf_only.mcap.zstd", "", "beams: 36\n"),
        ("amcl_pose.mcap.zstd", "", "beams: 36\n"),
        ("mocap_pose.mcap.zstd", "--reference-topic /vrpn_mocap/robot/pose", "beams: 36\n"),
        ("two_scanners.mcap.zstd", "", "beams: 20\n"),
        ("two_scanners.mcap.zstd", "--scan-topic /scan_rear", "beams: 12\n"),
        ("cloud.mcap.zstd", "", "beams: 34\n  field_of_view_deg: 330.0"),
        ("multi_echo.mcap.zstd", "", "beams: 30\n"),
        (
            "clockwise.mcap.zstd",
            "",
            "beams: 36\n  field_of_view_deg: 360.0\n  first_beam_deg: -170.0 # the log's beams run clockwise",
        ),
        (
            "at_maximum.mcap.zstd",
            "",
            "beams: 36 # the log's last beam points where its first does\n  field_of_view_deg: 360.0\n",
        ),
        ("upside_down.mcap.zstd", "", "beams: 31\n"),
        ("prefixed_frames.mcap.zstd", "", "mount: {x_m: 0.2, y_m: 0.1, yaw_deg: 180.0}"),
        ("empty_scan.mcap.zstd", "", "beams: 36\n"),
        ("two_odometries.mcap.zstd", "", "beams: 36\n"),
    ] {
        let text = recordings.scenario(name, options);
        assert!(text.contains(laser), "{name}: {text}");
        if name == "mocap_pose.mcap.zstd" {
            // The scenario's topics hold for a log that is named.
            let gap = format!(
                "gap my.robot.yaml --log {} --out found --replicates 19 --beams 12 --no-filter",
                Recordings::file(name)
            );
            recordings.folder.locsim(&gap).success();
        }
        // 40 scans are the fewest that `gap` takes.
        if ["at_maximum.mcap.zstd", "clockwise.mcap.zstd"].contains(&name) {
            let gap = "gap my.robot.yaml --out found --replicates 19 --beams 12 --no-filter --force";
            recordings.folder.locsim(gap).success();
        }
    }
}

/// Errors on the road say what to do next.
#[test]
fn a_missing_choice_is_named() {
    let folder = Folder::new();
    let init = |name: &str| folder.locsim(&format!("init {} -o my.yaml", Recordings::file(name)));
    for (name, part) in [
        ("mocap_pose.mcap.zstd", "--map names a map, --reference-topic may name /vrpn_mocap/robot/pose"),
        ("mocap_transform.mcap.zstd", "--reference-topic may name /vicon/robot/robot"),
        (
            "no_reference.mcap.zstd",
            "--reference-topic names a topic of poses; found: /diagnostics, /odom, /scan",
        ),
    ] {
        init(name).code(2).stderr(contains(part));
    }
    let map = |name: &str| folder.locsim(&format!("map {} --out floor", Recordings::file(name)));
    map("mocap_pose.mcap.zstd").code(2).stderr(
        contains("no scan has a reference pose").and(contains("/vrpn_mocap/robot/pose (geometry_msgs")),
    );
    // Of a chain of transforms, the robot's base is named, not the odometry's frame.
    let log = Recordings::file("tf_only.mcap.zstd");
    let call = folder.locsim(&format!("inspect {log} --reference-topic nowhere:base --json")).code(2);
    let found: Value = serde_json::from_str(&output(&call)).unwrap();
    assert_eq!(found["reference_candidates"][0], "map:base_link", "{found}");
}

/// A CARMEN log of the drive, with the readings of each scan as `change` makes them.
fn with_readings(folder: &Folder, name: &str, change: impl Fn(Vec<f64>) -> Vec<f64>) {
    let text = String::from_utf8(folder.read("drive.log")).unwrap();
    let line = |line: &str| {
        let mut words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        if words.first().is_some_and(|word| word == "ROBOTLASER1") {
            let count: usize = words[8].parse().unwrap();
            let readings = words[9..9 + count].iter().map(|word| word.parse().unwrap()).collect();
            let changed = change(readings).into_iter().map(|reading| format!("{reading:.3}"));
            words.splice(9..9 + count, changed.collect::<Vec<_>>());
        }
        words.join(" ") + "\n"
    };
    folder.write(name, text.lines().map(line).collect::<String>());
}

/// Scans that are read the other way around contradict each other from pose to pose.
#[test]
fn a_map_that_its_log_contradicts_is_told() {
    let folder = folder_with_a_drive("drive.log");
    let told = contains("of the held-out readings are more than 0.5 m from the walls");
    folder.locsim("map drive.log --out right").success().stderr(told.clone().not());
    with_readings(&folder, "mirrored.log", |readings| readings.into_iter().rev().collect());
    folder.locsim("map mirrored.log --out wrong").success().stderr(told);
}

/// What `init` writes is legal: a log of which no legal scenario comes is refused before anything is written.
#[test]
fn no_scenario_is_written_that_run_would_refuse() {
    let folder = folder_with_a_drive("drive.log");
    with_readings(&folder, "noisy.log", |readings| {
        let far = |(i, reading): (usize, f64)| {
            if reading < 4.0 { 40.0 * reading + 3.0 * (i % 2) as f64 } else { 400.0 }
        };
        readings.into_iter().enumerate().map(far).collect()
    });
    // Neighbours that differ by metres tell no noise.
    folder.locsim("init noisy.log -o noisy.yaml --max-range 400").success();
    let noisy = std::fs::read_to_string(folder.path("noisy.yaml")).unwrap();
    assert!(noisy.contains("noise: {sigma_m: 0.02} # a guess"), "{noisy}");
    std::fs::copy(folder.path("drive.log"), folder.path("a${NAME}.log")).unwrap();
    folder
        .locsim("init a${NAME}.log -o a.yaml")
        .code(2)
        .stderr(contains("the environment variable NAME is not set"));
    assert!(!folder.path("a.yaml").exists());
    folder
        .locsim("init drive.log -o drive.log/drive.yaml")
        .code(2)
        .stderr(contains("drive.log/drive.yaml: cannot be written"));
    folder.locsim("init drive.log -o new/drive.yaml").success();
    folder.locsim("validate new/drive.yaml").success();
}
