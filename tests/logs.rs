//! Measured logs from end to end: written by `simulate`, mapped by `map`, localized on by `run`; and what else a
//! user types beside `run`.

mod common;
#[path = "common/stamps.rs"]
mod stamps;

use std::path::{Path, PathBuf};

use common::{Folder, SCENARIO, edited, locsim, output};
use predicates::prelude::*;
use predicates::str::contains;
use serde_json::Value;
use stamps::with_one_stamp;

/// A drive through the corridor of the room and back, long enough to map, to learn from, and to localize on.
fn folder_with_a_drive() -> Folder {
    let folder = Folder::new();
    let path = "[[0.6, 0.9], [2.6, 0.9]]";
    let there_and_back = "[[0.6, 0.9], [2.6, 0.9], [2.6, 0.6], [0.6, 0.6], [0.6, 1.2], [2.4, 1.0]]";
    let text = edited(SCENARIO, path, there_and_back);
    folder.write("drive.yaml", edited(&text, "beams: 12", "beams: 60"));
    folder
}

/// A scenario that localizes on a log.
fn on_a_log(log: &str) -> String {
    format!(
        "seed: 1\ntrials: 3\nlog: {log}\ntraining: {{poses: 400, beams: 20}}\nmodels: [classic, np_reg_registered]\n\
         filter:\n  particles: 300\n  beams: 20\n  motion: {{model: odometry, alpha: [0.1, 0.05, 0.1, 0.05]}}\n  \
         start: {{tracking: {{sigma_m: 0.1, sigma_deg: 3}}}}\n"
    )
}

/// Runs a scenario and holds every model's error under a bound.
fn localizes(folder: &Folder, scenario: &str, text: &str, rmse_m: f64) -> Value {
    folder.write(scenario, text);
    let run = folder.locsim(&format!("run {scenario} --out {scenario}.d --record none --json")).success();
    let summary: Value = serde_json::from_str(&output(&run)).unwrap();
    for (name, model) in summary["models"].as_object().unwrap() {
        assert_eq!(model["lost_share"], 0.0, "{scenario}: {name} lost its way");
        let found = model["position_rmse_m"].as_f64().unwrap();
        assert!(found < rmse_m, "{scenario}: {name} is off by {found} m");
    }
    summary
}

#[test]
fn a_simulated_log_is_mapped_learnt_from_and_localized_on() {
    let folder = folder_with_a_drive();
    for name in ["drive.log", "drive.log.gz"] {
        let call = folder.locsim(&format!("simulate drive.yaml --out {name} --seed 5")).success();
        assert!(output(&call).starts_with(&format!("{name}: ")), "{}", output(&call));
    }
    assert!(folder.read("drive.log").starts_with(b"# CARMEN"));
    assert!(folder.read("drive.log.gz").starts_with(b"\x1f\x8b"));

    // One observation of each state; the map as drawn. Noise is 0.02 m on each of 20 beams.
    let log = "{file: LOG, train_scans: [[0.0, 0.5]], localize_scans: [[0.5, 1.0]]}\nmap: {file: room.yaml}";
    let plain = localizes(&folder, "plain.yaml", &on_a_log(&log.replace("LOG", "drive.log")), 0.1);
    let packed = localizes(&folder, "packed.yaml", &on_a_log(&log.replace("LOG", "drive.log.gz")), 0.1);
    for name in ["classic", "np_reg_registered"] {
        assert_eq!(
            plain["models"][name]["position_rmse_m"], packed["models"][name]["position_rmse_m"],
            "{name}"
        );
    }

    // A map built from the first third of the log itself.
    let log = "{file: drive.log, map_scans: [[0.0, 0.35]], train_scans: [[0.35, 0.7]], localize_scans: [[0.7, 1.0]], \
               map_resolution_m: 0.05}";
    localizes(&folder, "mapped.yaml", &on_a_log(log), 0.2);

    let log = "{file: drive.log, map: walls, map_scans: [[0.0, 0.35]], train_scans: [[0.35, 0.7]], \
               localize_scans: [[0.7, 1.0]]}";
    localizes(&folder, "mapped-walls.yaml", &on_a_log(log), 0.2);

    // Without numbers, motion noise is fitted to the log's odometry on what isn't localized on.
    let unfitted = edited(&on_a_log(log), ", alpha: [0.1, 0.05, 0.1, 0.05]", "");
    let fitted = localizes(&folder, "fitted.yaml", &unfitted, 0.2);
    for name in ["classic", "np_reg_registered"] {
        let chosen = &fitted["models"][name]["train"]["chosen"];
        assert!(chosen["training_drive_nees"].as_f64().is_some_and(|nees| nees > 0.0), "{name}: {chosen}");
    }
    let report = String::from_utf8(folder.read("fitted.yaml.d/report.md")).unwrap();
    let told = "is fitted to the odometry's errors against the reference poses of all other scans.";
    assert!(
        report.contains("The filter's motion noise (alpha 1 to 4: ") && report.contains(told),
        "{report}"
    );

    // A map that `map` wrote, in a file. What follows a dot in its name is no extension.
    let call = folder.locsim("map drive.log --out room-0.05 --share 0.0,0.5").success();
    let told = output(&call);
    assert!(told.contains("log with true poses") && told.contains("room-0.05.yaml: "), "{told}");
    assert!(folder.read("room-0.05.pgm").starts_with(b"P5"), "the greymap that map servers read");
    folder.locsim("map drive.log --out again.yaml --share 0.0,0.5").success();
    assert_eq!(folder.read("again.pgm"), folder.read("room-0.05.pgm"));
    let log = "{file: drive.log, train_scans: [[0.0, 0.5]], localize_scans: [[0.5, 1.0]]}\nmap: {file: room-0.05.yaml}";
    localizes(&folder, "written.yaml", &on_a_log(log), 0.2);

    // Its walls, and the picture of held-out readings on them.
    assert!(told.contains("room-0.05.walls.yaml: ") && told.contains("walls, each scan aligned"), "{told}");
    assert!(folder.read("room-0.05.check.svg").starts_with(b"<svg"));
    assert_eq!(folder.read("again.walls.yaml"), folder.read("room-0.05.walls.yaml"));
    let log = "{file: drive.log, train_scans: [[0.0, 0.5]], localize_scans: [[0.5, 1.0]]}\nmap: {file: room-0.05.walls.yaml}";
    localizes(&folder, "walls.yaml", &on_a_log(log), 0.2);

    // The map serves a simulation too.
    let simulated = edited(SCENARIO, "room.yaml", "room-0.05.yaml");
    folder.write("simulated.yaml", simulated);
    folder.locsim("run simulated.yaml --quiet --record none --trials 1").success();
}

/// Odometry that is 8 % long, on a drive of some 60 m. Poses of the log are true.
#[test]
fn a_worn_wheel_is_calibrated_unless_the_scenario_says_no() {
    let folder = Folder::new();
    let loop_of_the_room = "[2.6, 0.9], [2.6, 0.6], [0.6, 0.6], [0.6, 0.9], ".repeat(14);
    let path = format!("[[0.6, 0.9], {}]", loop_of_the_room.trim_end_matches(", "));
    let text = edited(&edited(SCENARIO, "[[0.6, 0.9], [2.6, 0.9]]", &path), "beams: 12", "beams: 60");
    folder.write("drive.yaml", format!("{text}\neffects: [{{name: odom_distance_scale, k: 0.08}}]\n"));
    folder.locsim("simulate drive.yaml --out drive.log --seed 5").success();
    let log =
        "{file: drive.log, train_scans: [[0.0, 0.7]], localize_scans: [[0.7, 1.0]]}\nmap: {file: room.yaml}";
    let alpha_3 = ["", ", calibrate: false"].map(|motion| {
        let is_told = motion.is_empty();
        let text = edited(&on_a_log(log), ", alpha: [0.1, 0.05, 0.1, 0.05]", motion);
        localizes(&folder, "worn.yaml", &text, 0.1);
        let report = String::from_utf8(folder.read("worn.yaml.d/report.md")).unwrap();
        let told = "The odometry is calibrated by the reference poses of all other scans (`filter.motion.calibrate`): a metre of it is 0.9";
        assert_eq!(report.contains(told), is_told, "{report}");
        std::fs::remove_dir_all(folder.path("worn.yaml.d")).unwrap();
        // Noise of the distance by the way, which is fitted to what is left.
        let (_, alphas) = report.split_once("alpha 1 to 4: ").unwrap();
        alphas.split(", ").nth(2).unwrap().parse::<f64>().unwrap()
    });
    assert!(alpha_3[0] < 0.8 * alpha_3[1], "{alpha_3:?}");
}

/// Stamps of six digits since 1970 are all alike. Errors don't depend on them, and steps have times of their own none the less.
#[test]
fn a_log_whose_clock_stands_still_is_localized_on() {
    let folder = folder_with_a_drive();
    folder.locsim("simulate drive.yaml --out drive.log --seed 5").success();
    folder.write("still.log", with_one_stamp(&folder.read("drive.log")));
    let log = "{file: LOG, train_scans: [[0.0, 0.5]], localize_scans: [[0.5, 1.0]]}\nmap: {file: room.yaml}";
    let [plain, still] = ["drive", "still"].map(|name| {
        let text = on_a_log(&log.replace("LOG", &format!("{name}.log")));
        localizes(&folder, &format!("{name}-run.yaml"), &text, 0.1)
    });
    for name in ["classic", "np_reg_registered"] {
        assert_eq!(
            plain["models"][name]["position_rmse_m"], still["models"][name]["position_rmse_m"],
            "{name}"
        );
    }
    let steps = String::from_utf8(folder.read("still-run.yaml.d/steps.csv")).unwrap();
    let mut lines = steps.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let column = lines.next().unwrap().iter().position(|name| *name == "stamp_secs").unwrap();
    let stamps: Vec<f64> = lines.take(20).map(|line| line[column].parse().unwrap()).collect();
    assert!(stamps.windows(2).all(|pair| pair[1] == pair[0] + 1.0), "{stamps:?}");
    let report = String::from_utf8(folder.read("still-run.yaml.d/report.md")).unwrap();
    assert!(report.contains("scans have the stamp of the scan before."), "{report}");
}

#[test]
fn a_ros_bag_is_written_mapped_and_localized_on() {
    let folder = folder_with_a_drive();
    for name in ["drive.mcap", "drive.log"] {
        folder.locsim(&format!("simulate drive.yaml --out {name} --seed 5")).success();
    }
    assert!(folder.read("drive.mcap").starts_with(b"\x89MCAP0\r\n"));
    for name in ["drive.mcap", "drive.log"] {
        folder.locsim(&format!("map {name} --out {name}-map --share 0.0,0.5")).success();
    }
    assert_eq!(folder.read("drive.mcap-map.pgm"), folder.read("drive.log-map.pgm"));

    // The reference as the odometry, which is then perfect.
    let log = "{file: drive.mcap, train_scans: [[0.0, 0.5]], localize_scans: [[0.5, 1.0]], \
               topics: {scan: /scan, odometry: /reference}}\nmap: {file: room.yaml}";
    localizes(&folder, "perfect.yaml", &on_a_log(log), 0.1);
    let log = log.replace(", topics: {scan: /scan, odometry: /reference}", "");
    localizes(&folder, "bag.yaml", &on_a_log(&log), 0.1);

    let refused =
        |call: &str| folder.locsim(call).code(2).stderr(contains("/scan (sensor_msgs/msg/LaserScan, "));
    refused("map drive.mcap --out m --scan-topic /lidar").stderr(contains("scan topic `/lidar` isn't there"));
    let whole = folder.read("drive.mcap");
    folder.write("cut.mcap", &whole[..whole.len() / 2]);
    folder.locsim("map cut.mcap --out m").code(2).stderr(contains("cut.mcap: not a complete MCAP file"));
}

/// What came before CARMEN: `L` and `O` lines in centimetres without a reference, and cells by the probability that they are free.
#[test]
fn a_log_and_a_map_of_beesoft_are_converted_and_run() {
    let folder = Folder::new();
    // A hall of 5 m x 3 m in cells of 10 cm; a line of cells for each place along x.
    let cell = |x: usize, y: usize| match (x, y) {
        (0 | 49, _) | (_, 0 | 29) => "0.000",
        (30..=34, 12..=16) => "-1.000",
        _ => "1.000",
    };
    let lines = (0..50).map(|x| (0..30).map(|y| cell(x, y)).collect::<Vec<_>>().join(" ") + "\n");
    let head = "robot_specifications->resolution   10\nglobal_map[0]: 30 50\n";
    folder.write("hall.dat", head.to_owned() + &lines.collect::<String>());
    let scans = (0..40).map(|i| {
        let x = 100 + 2 * i;
        let line =
            |ts: f64| format!("O {x} 150 0 {ts}\nL {x} 150 0 {} 150 0{} {ts}\n", x + 25, " 140".repeat(180));
        line(0.1 + 0.2 * f64::from(i))
    });
    folder.write("hall.log", scans.collect::<String>());

    let told = output(&folder.locsim("convert hall.dat --out hall").success());
    assert_eq!(told, "hall.yaml: 50 x 30 cells of 0.1 m\n");
    let image = folder.read("hall.pgm");
    let pixels = &image[image.len() - 50 * 30..];
    let at = |x: usize, y: usize| pixels[(29 - y) * 50 + x];
    assert_eq!([at(10, 10), at(0, 10), at(31, 14), at(31, 20)], [254, 0, 205, 254]);

    let told = output(&folder.locsim("convert hall.log --out hall.mcap").success());
    assert!(
        told.ends_with("hall.mcap: 40 scans\n") && told.contains("raw log without reference poses"),
        "{told}"
    );
    // A bag's stamps are dates, which the log's aren't.
    let found: Value =
        serde_json::from_str(&output(&folder.locsim("inspect hall.mcap --json").success())).unwrap();
    assert_eq!(found["drive"]["laser"]["mount"]["x"], 0.25, "{found:#}");
    assert!(found["drive"]["clock"]["first_secs"].as_f64().unwrap() > 1.7e9, "{found:#}");

    for log in ["hall.log", "hall.mcap"] {
        folder.locsim(&format!("init {log} --map hall.yaml -o s.yaml --force")).success();
        let text = String::from_utf8(folder.read("s.yaml")).unwrap();
        assert!(text.contains("noise: {sigma_m: 0.1} # a cell of the map, 0.1 m"), "{text}");
        let near = "start: {around: {x_m: 1, y_m: 1.5, heading_deg: 0, sigma_m: 0.2, sigma_deg: 5}}";
        folder.write("s.yaml", edited(&edited(&text, "start: global", near), "  annealing: {}\n", ""));
        let run = format!("run s.yaml --trials 1 --models likelihood_field --out {log}.d");
        folder.locsim(&run).success().stdout(contains("no error is known"));
    }

    for (call, part) in [
        ("convert hall.dat --out hall", "error: hall.pgm is not allowed; it exists (--force replaces it)"),
        ("convert hall.log --out hall.mcap", "hall.mcap is not allowed; it exists"),
        (
            "convert hall.dat --out other --max-range 20",
            "hall.dat: options of a log are given, and this is a map",
        ),
        ("inspect hall.dat", "hall.dat: this is a map of BeeSoft, which `locsim convert` makes a ROS map of"),
        ("init hall.log --map hall.dat -o n.yaml", "`locsim convert` makes a ROS map of"),
    ] {
        folder.locsim(call).code(2).stderr(contains(part));
    }
}

#[test]
fn a_log_depends_on_seed_and_trial_alone() {
    let folder = Folder::new();
    let log = |options: &str| {
        folder.locsim(&format!("simulate room-run.yaml --out o.log --force {options}")).success();
        folder.read("o.log")
    };
    let plain = log("");
    assert_eq!(plain, log("--seed 3 --trial 0"));
    assert_ne!(plain, log("--seed 4"));
    assert_ne!(plain, log("--trial 1"));
}

/// The checkout's root folder.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// The scenario files of a folder, as relative paths.
fn scenarios(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(root().join(folder)).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    let mut paths: Vec<String> = paths
        .filter(|path| path.extension().is_some_and(|extension| extension == "yaml"))
        .map(|path| format!("{folder}/{}", path.file_name().unwrap().to_str().unwrap()))
        .collect();
    paths.sort();
    paths
}

#[test]
fn the_shipped_scenarios_and_their_maps_are_valid() {
    let shipped = scenarios("scenarios");
    assert!(shipped.iter().any(|path| path == "scenarios/table2.yaml"), "{shipped:?}");
    let call = locsim(&root(), "validate").args(&shipped).assert().success();
    for path in &shipped {
        assert!(output(&call).contains(&format!("{path}: valid (")), "{path}");
    }

    // Every shipped map: a short drive from a place that is free in it.
    let folder = Folder::new();
    let maps = scenarios("maps");
    assert!(maps.len() >= 4, "{maps:?}");
    for map in maps {
        let y = if map.ends_with("office.yaml") { 6.0 } else { 1.5 };
        let map = root().join(map);
        let text = edited(SCENARIO, "room.yaml", map.to_str().unwrap());
        folder.write("s.yaml", edited(&text, "[[0.6, 0.9], [2.6, 0.9]]", &format!("[[1, {y}], [1.5, {y}]]")));
        folder.locsim("simulate s.yaml --out o.log --force").success();
    }
}

#[test]
fn the_scenarios_of_measured_logs_say_where_they_look_for_data() {
    let measured = scenarios("scenarios/real");
    assert!(measured.len() >= 2, "{measured:?}");
    for path in &measured {
        locsim(&root(), &format!("validate {path}"))
            .env_remove("LOCSIM_DATA")
            .assert()
            .code(2)
            .stderr(contains(format!("{path}:")).and(contains("log.file: `${LOCSIM_DATA}/")))
            .stderr(contains("the environment variable LOCSIM_DATA is not set (export LOCSIM_DATA=...)"));
    }
}

/// What a run refuses once it has read the log is found without running it.
#[test]
fn validate_reads_the_log_as_a_run_does() {
    let folder = folder_with_a_drive();
    for name in ["drive.log", "drive.mcap"] {
        folder.locsim(&format!("simulate drive.yaml --out {name}")).success();
    }
    let text = String::from_utf8(folder.read("drive.log")).unwrap();
    let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("TRUEPOS")).collect();
    folder.write("blind.log", lines.join("\n") + "\n");
    folder.write("far.yaml", "outline:\n  points_m: [[40, 40], [44, 40], [44, 42], [40, 42]]\n");
    let shares = "train_scans: [[0.0, 0.5]], localize_scans: [[0.5, 1.0]]";
    for (log, said) in [
        (format!("{{file: drive.mcap, topics: {{scan: /front}}, {shares}}}\nmap: {{file: room.yaml}}"), "s.yaml:3: log.topics: drive.mcap: scan topic `/front` isn't there"),
        (format!("{{file: blind.log, {shares}}}\nmap: {{file: room.yaml}}"), "log.train_scans: no scan has a reference pose"),
        (
            "{file: drive.log, train_scans: [[0.0, 0.5]], localize_scans: [[0.501, 0.502]]}\nmap: {file: room.yaml}".to_owned(),
            "no scan is left to localize on",
        ),
        (
            format!("{{file: drive.log, {shares}}}\nmap: {{file: far.yaml}}"),
            "0 training scans have a reference pose in the map's free space; fitting takes at least 4",
        ),
    ] {
        folder.write("s.yaml", on_a_log(&log));
        let told = |line: &str| {
            let call = folder.locsim(line).code(2).stdout(predicates::str::is_empty()).stderr(contains(said));
            String::from_utf8(call.get_output().stderr.clone()).unwrap()
        };
        let found = told("validate s.yaml");
        assert!(told("run s.yaml --quiet").ends_with(&found), "{found}");
        assert!(!folder.path("results/s").exists());
    }
    folder.write("s.yaml", on_a_log(&format!("{{file: drive.log, {shares}}}\nmap: {{file: room.yaml}}")));
    folder.locsim("validate s.yaml").success().stderr(predicates::str::is_empty());
}

/// The end of a corridor that the scans of the map never saw.
#[test]
fn validate_warns_of_a_split_without_a_map() {
    let folder = Folder::new();
    let corridor = root().join("maps/corridor.yaml");
    let text = edited(SCENARIO, "room.yaml", corridor.to_str().unwrap());
    folder.write("s.yaml", edited(&text, "[[0.6, 0.9], [2.6, 0.9]]", "[[1, 1.5], [15, 1.5]]"));
    folder.locsim("simulate s.yaml --out drive.log").success();
    for (map, is_known) in [("[[0.0, 0.2]]", false), ("[[0.0, 0.2], [0.5, 0.79], [0.9, 1.0]]", true)] {
        let log = format!(
            "{{file: drive.log, map_scans: {map}, train_scans: [[0.0, 0.2]], localize_scans: [[0.8, 0.9]]}}"
        );
        folder.write("split.yaml", on_a_log(&log));
        let said = contains("split.yaml: In one stretch of `log.localize_scans` only");
        let call = folder.locsim("validate split.yaml").success();
        if is_known {
            call.stderr(said.not())
        } else {
            call.stderr(said)
        };
    }
}

#[test]
fn schema_and_completions_are_what_editors_and_shells_take() {
    let folder = Folder::new();
    let schema: Value = serde_json::from_str(&output(&folder.locsim("schema").success())).unwrap();
    assert_eq!(schema["type"], "object");
    for key in ["seed", "models", "filter", "expect"] {
        assert!(schema["properties"][key].is_object(), "{key}");
    }
    let script = output(&folder.locsim("completions bash").success());
    assert!(script.contains("complete -F _locsim"), "{script}");
    for word in ["--resume", "--trials", "--share", "incidence_dropout", "glass"] {
        assert!(script.contains(word), "{word}");
    }
}

#[test]
fn help_is_plain_and_shows_the_arguments_that_are_needed() {
    let folder = Folder::new();
    let help = |command: &str| output(&folder.locsim(&format!("{command} --help")).success());
    assert!(help("map").contains("Cell size [m]"), "{}", help("map"));
    let gap = help("gap");
    assert!(gap.contains("gap [OPTIONS] --out <OUT> <SCENARIO>") && !gap.contains("[SCENARIO]"), "{gap}");
    // The list of limits is long: it stands behind all other options.
    assert!(gap.find("--limit").unwrap() > gap.find("--explain").unwrap(), "{gap}");
    let width = |text: &str| text.lines().map(|line| line.chars().count()).max().unwrap();
    let narrow = locsim(&root(), "effects").env("COLUMNS", "80").assert().success();
    assert!(width(&output(&narrow)) <= 80, "{}", output(&narrow));
}

#[test]
fn a_manual_page_has_every_option_of_its_command() {
    let folder = Folder::new();
    let page = |line: &str| output(&folder.locsim(line).success());
    let whole = page("manual");
    assert!(whole.contains(".TH locsim 1") && whole.contains(r"locsim\-run(1)"), "{whole}");
    let run = page("manual run");
    assert!(run.contains(".TH locsim-run 1"), "{run}");
    for option in ["resume", "trials", "cache", "limit"] {
        assert!(run.contains(&format!(r"\-\-{option}")), "{option} is not in\n{run}");
    }
    folder
        .locsim("manual drive")
        .code(2)
        .stderr(contains("`drive` is not a command of locsim; allowed: run, study"));
}
