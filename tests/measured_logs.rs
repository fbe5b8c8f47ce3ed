//! Tests on measured logs, which aren't part of the project: they are in the folder `LOCSIM_DATA`. Where that isn't set,
//! these tests are reported as ignored.

#[allow(dead_code, reason = "the scenarios of the other tests aren't needed here")]
mod common;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use common::{Folder, locsim, output};
use libtest_mimic::{Arguments, Trial};
use locsim_core::{Drive, Pose2};
use locsim_dataset::{CarmenOptions, LogKind, OdometrySource, read_carmen};
use predicates::str::contains;
use serde_json::Value;

fn main() -> ExitCode {
    let tests: [(&str, fn()); 8] = [
        (
            "corrected_logs_are_recognised_and_their_odometry_is_recovered",
            corrected_logs_are_recognised_and_their_odometry_is_recovered,
        ),
        ("another_maximum_range_shows_in_the_summary", another_maximum_range_shows_in_the_summary),
        ("a_wean_hall_log_and_its_map_are_read", a_wean_hall_log_and_its_map_are_read),
        (
            "what_a_measured_log_has_beyond_a_plain_simulator_is_told_without_a_wrong_name",
            what_a_measured_log_has_beyond_a_plain_simulator_is_told_without_a_wrong_name,
        ),
        ("the_scenarios_of_measured_logs_are_valid", the_scenarios_of_measured_logs_are_valid),
        ("a_measured_log_is_localized_on", a_measured_log_is_localized_on),
        (
            "walls_agree_with_held_out_scans_better_than_cells",
            walls_agree_with_held_out_scans_better_than_cells,
        ),
        ("the_study_of_measured_scans_runs", the_study_of_measured_scans_runs),
    ];
    let is_unset = std::env::var_os(DATA).is_none();
    let trial = |(name, test): (&str, fn())| {
        Trial::test(name, move || {
            test();
            Ok(())
        })
        .with_ignored_flag(is_unset)
    };
    libtest_mimic::run(&Arguments::from_args(), tests.into_iter().map(trial).collect()).exit_code()
}

const DATA: &str = "LOCSIM_DATA";

/// A file of the folder.
fn data(file: &str) -> PathBuf {
    Path::new(&std::env::var_os(DATA).expect("LOCSIM_DATA is not set")).join(file)
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Medians over the steps of a drive of |translation| (m) and |rotation| (rad).
fn medians(drive: &Drive, of: impl Fn(Pose2, Pose2) -> Pose2) -> (f64, f64) {
    let reference = |i: usize| drive.steps[i].reference.unwrap();
    let steps: Vec<_> = (1..drive.steps.len())
        .map(|i| of(reference(i).relative_to(&reference(i - 1)), drive.odometry_increment(i)))
        .collect();
    (
        median(steps.iter().map(|p| p.position().length()).collect()),
        median(steps.iter().map(|p| p.theta.abs()).collect()),
    )
}

/// Recovered odometry agrees with the reference: the median disagreement over an interval stays below 35 % of
/// the median motion (Freiburg's short steps of 0.1 m: 27 %, the others 8 % and 3 %), which neither odometry
/// that stands still (100 %) nor one with the jumps of the corrections in it could do. It isn't the reference
/// itself either: there is some disagreement.
fn corrected_logs_are_recognised_and_their_odometry_is_recovered() {
    for (file, scans, beams, last_bearing) in [
        ("intel-corrected.log.gz", 910, 180, 89.0_f32),
        ("freiburg-079-corrected.log.gz", 4791, 360, 89.5),
        ("infinite-corridor-corrected.log.gz", 1941, 180, 89.0),
    ] {
        let path = data(file);
        let (drive, summary) = read_carmen(&path, &CarmenOptions::default()).unwrap();
        assert_eq!(summary.kind, LogKind::Corrected);
        assert_eq!(summary.odometry, OdometrySource::RestartedOdomLines);
        assert_eq!((drive.steps.len(), drive.laser.beam_count()), (scans, beams));
        assert_eq!(summary.intervals_without_odometry, 0);
        let bearings = drive.laser.bearings();
        assert!((bearings[0].to_degrees() + 90.0).abs() < 1e-4);
        assert!((bearings[beams - 1].to_degrees() - last_bearing).abs() < 1e-4);
        assert!(drive.steps.windows(2).all(|w| w[0].stamp_secs <= w[1].stamp_secs));

        let motion = medians(&drive, |reference, _| reference);
        let error = medians(&drive, |reference, odometry| odometry.relative_to(&reference));
        assert!(error.0 > 1e-3 && error.0 < 0.35 * motion.0);
        assert!(error.1 > 1e-4 && error.1 < 0.35 * motion.1);
    }
}

/// The laser of the infinite corridor's robot counted only to 51 m; the summary shows it and the option mends it.
fn another_maximum_range_shows_in_the_summary() {
    let path = data("infinite-corridor-corrected.log.gz");
    let (_, summary) = read_carmen(&path, &CarmenOptions::default()).unwrap();
    assert_eq!((summary.no_return_share, summary.longest_return_m), (0.0, Some(51.16)));
    let options = CarmenOptions { max_range_m: Some(50.0), ..Default::default() };
    let (drive, summary) = read_carmen(&path, &options).unwrap();
    assert!(summary.no_return_share > 0.01);
    assert_eq!(drive.laser.max_range(), 50.0);
}

/// CMU's own format: counts of its lines by `grep -c`, the laser 25 cm ahead, no reference; the map's bounds are its header's.
fn a_wean_hall_log_and_its_map_are_read() {
    for (file, scans, odometry) in
        [("robotdata1", 713, 1505), ("robotdata2", 2251, 3126), ("robotdata3", 1241, 1735)]
    {
        let (drive, summary) =
            read_carmen(&data(&format!("wean-hall/{file}.log.gz")), &CarmenOptions::default()).unwrap();
        assert_eq!((summary.kind, summary.scan_source.as_str()), (LogKind::Raw, "L"));
        assert_eq!(
            (drive.steps.len(), summary.odometry_messages, drive.laser.beam_count()),
            (scans, odometry, 180)
        );
        assert!((drive.laser.base_from_laser().x - 0.25).abs() < 1e-3);
        assert!(drive.steps.iter().all(|step| step.reference.is_none()));
    }
    let folder = Folder::new();
    let map = data("wean-hall/wean.dat.gz");
    locsim(&folder.path(""), &format!("convert {} --out wean", map.display())).assert().success();
    let description = std::fs::read_to_string(folder.path("wean.yaml")).unwrap();
    assert!(description.contains("resolution: 0.1\n"), "{description}");
    let image = std::fs::read(folder.path("wean.pgm")).unwrap();
    assert!(image.starts_with(b"P5\n800 800 "), "{:?}", String::from_utf8_lossy(&image[..20]));
}

/// A real laser, a real building, and a plain simulator of both on the map of walls: what the odometry does has its name, walls that send
/// hardly anything back are told where they stand, and no other effect of the library is made up than losses of far surfaces.
fn what_a_measured_log_has_beyond_a_plain_simulator_is_told_without_a_wrong_name() {
    let log = data("intel-corrected.log.gz");
    let scenario = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenarios/gap/intel.yaml");
    let folder = Folder::new();
    let call = |line: String| {
        let mut command = locsim(&folder.path(""), &line);
        command.env("LOCSIM_MAPS", folder.path("maps")).assert().success()
    };
    std::fs::create_dir(folder.path("maps")).unwrap();
    let log = log.display();
    call(format!("map {log} --out maps/intel --resolution 0.05 --max-range 40 --share 0.3,1.0"));
    let found = call(format!(
        "gap {scenario} --log {log} --max-range 40 --replicates 99 --scans 120 --beams 36 --no-filter --out found --json"
    ));
    let outcome: Value = serde_json::from_str(&output(&found)).unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    // Intel's odometry reads distances too long and turns on straight lines. `locsim inspect` measures that as well, with code of its own,
    // over the whole log.
    let inspected = locsim(&folder.path(""), &format!("inspect {log} --json")).assert().success();
    let inspected: Value = serde_json::from_str(&output(&inspected)).unwrap();
    let error = &inspected["drive"]["odometry"]["error"];
    let effects = outcome["effects"].as_array().unwrap();
    let of = |name: &str, parameter: &str| -> Option<f64> {
        let effect = effects.iter().find(|effect| effect["name"] == name)?;
        Some(number(&effect["params"][parameter]["value"]))
    };
    let (k, turn) = (of("odom_distance_scale", "k").unwrap(), of("odom_imbalance", "turn_per_m").unwrap());
    assert!((k - (number(&error["distance_ratio"]) - 1.0)).abs() < 0.015, "{k} {error:#}");
    // The heading's error per metre is a root mean square, of the imbalance and of noise.
    let per_m = number(&error["heading_per_m"]);
    assert!((0.7 * per_m..per_m).contains(&turn.abs()), "{turn} {error:#}");
    let is_known = |name: &Value| {
        ["block_density", "odom_distance_scale", "odom_imbalance", "range_dropout"]
            .iter()
            .any(|known| name == known)
    };
    assert!(effects.iter().all(|effect| is_known(&effect["name"])), "{outcome:#}");
    assert_eq!(outcome["verdict"], "named");
    // Two walls of a curve and a third one, from x and y to x and y by a look at the map [m].
    let known = [[7.0, -0.5, 10.5, 2.5], [11.5, -4.8, 13.7, -1.8], [-2.5, -3.0, -1.8, -1.3]];
    let errors = outcome["map"]["errors"].as_array().unwrap();
    let holes: Vec<[f64; 2]> = errors
        .iter()
        .filter(|error| error["kind"] == "hole")
        .map(|error| [0, 1].map(|axis| number(&error["place"][0][axis])))
        .collect();
    let is_known =
        |[x, y]: &[f64; 2]| known.iter().any(|b| (b[0]..b[2]).contains(x) && (b[1]..b[3]).contains(y));
    assert!(holes.len() >= 10 && holes.iter().all(is_known), "{holes:?}");
    // Each lost return counts 40 m: with those walls ranges were 0.9 m off.
    assert!(number(&outcome["gap"]["before"]["w1_mm"]) < 200.0, "{}", outcome["gap"]);
}

fn the_scenarios_of_measured_logs_are_valid() {
    let paths = std::fs::read_dir(root().join("scenarios/real")).unwrap().map(|entry| entry.unwrap().path());
    let paths: Vec<PathBuf> = paths.collect();
    assert!(paths.len() >= 2, "{paths:?}");
    // The map of Wean Hall is made from its data.
    let folder = Folder::new();
    let map = data("wean-hall/wean.dat.gz");
    locsim(&folder.path(""), &format!("convert {} --out wean", map.display())).assert().success();
    let mut validate = locsim(&root(), "validate");
    validate.args(&paths).env("LOCSIM_MAPS", folder.path("")).assert().success();
    // A variable's path is meant from where the program is called.
    let scenario = root().join("scenarios/real/wean-hall.yaml");
    let mut validate = locsim(&folder.path(""), "validate");
    validate.arg(scenario).env("LOCSIM_MAPS", ".").assert().success();
}

fn a_measured_log_is_localized_on() {
    let folder = Folder::new();
    let line =
        "run scenarios/real/intel.yaml --trials 1 --models likelihood_field --record none --json --out";
    let call = locsim(&root(), line).arg(folder.path("intel")).assert().success();
    call.stdout(contains("\"likelihood_field\""));
}

/// The bias of cells, half a cell and more, is gone; with the errors of the poses taken away, the median reading is at most
/// 2 cm from a wall; fewer readings are far off.
fn walls_agree_with_held_out_scans_better_than_cells() {
    let folder = Folder::new();
    for log in ["intel", "belgioioso", "freiburg-101"] {
        let file = data(&format!("{log}-corrected.log.gz"));
        let line = format!("map {} --max-range 40 --out {log}", file.display());
        let told = output(&locsim(&folder.path(""), &line).assert().success());
        // Share with a nominal range, median |error|, median error, share far off.
        let row = |name: &str| -> [f64; 4] {
            let row = told.lines().find_map(|line| line.trim().strip_prefix(name)).unwrap();
            let numbers: Vec<f64> = row.split_whitespace().map(|cell| cell.parse().unwrap()).collect();
            numbers.try_into().unwrap()
        };
        let [cells, walls, aligned] =
            ["cells, where walls have a nominal range ", "walls ", "walls, each scan aligned "].map(row);
        assert!(walls[1] < 0.6 * cells[1], "{told}");
        assert!(walls[2].abs() < 0.5 * cells[2].abs(), "{told}");
        assert!(walls[3] < cells[3], "{told}");
        assert!(aligned[1] <= 2.0, "{told}");
    }
}

fn the_study_of_measured_scans_runs() {
    let folder = Folder::new();
    let line = "study scenarios/paper/static_lidar.yaml --quick --repeats 1 --quiet --out";
    locsim(&root(), line).arg(folder.path("results")).assert().success();
    assert!(folder.path("results/static_lidar/report.html").is_file());
}
