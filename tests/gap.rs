//! `locsim gap` as a user types it: a log of a robot that differs from what its scenario says.

mod common;
#[path = "common/stamps.rs"]
mod stamps;

use std::path::Path;

use common::{Folder, edited, output};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::{contains, is_empty};
use serde_json::{Value, json};
use stamps::with_one_stamp;

/// The nominal scenario: the room, two rounds in it.
const NOMINAL: &str = "\
# As the developers think it is.
name: nominal
seed: 3
trials: 1
map: {file: maps/room.yaml}
blocks: {per_metre_of_wall: 0.2, length_m: [0.1, 0.2], width_m: [0.1, 0.2], wall_distance_m: [0.0, 0.1]}
robot:
  path: {waypoints: {points_m: [[0.6, 0.6], [2.6, 0.8], [2.2, 1.1], [0.7, 1.2], [0.6, 0.6]], speed_m_s: 0.6, turn_rate_deg_s: 60}}
  odometry_noise: {alpha: [0.02, 0.005, 0.01, 0.005]}
laser: {rate_hz: 6, beams: 24, max_range_m: 5, resolution_m: 0.001, noise: {sigma_m: 0.01}}
effects: # what a laser does anyway
  - {name: range_dropout, p: 0.005, exponent: 0}
training: {poses: 24, observations: 24}
models: [classic]
filter:
  particles: 100
  motion: {model: odometry, alpha: [0.05, 0.02, 0.05, 0.01]}
  start: {tracking: {sigma_m: 0.05, sigma_deg: 2}}
  beams: 12
";

/// Effects of the real robot that the scenario lacks.
const HIDDEN: &str = "  - {name: range_bias, bias_m: 0.04}\ntraining:";

/// A folder with the nominal scenario, and with the log of a robot whose readings are too long.
fn folder() -> Folder {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("maps")).unwrap();
    std::fs::rename(folder.path("room.yaml"), folder.path("maps/room.yaml")).unwrap();
    folder.write("nominal.yaml", NOMINAL);
    folder.write("hidden.yaml", edited(NOMINAL, "training:", HIDDEN));
    folder.locsim("simulate hidden.yaml --seed 11 --out measured.log").success();
    folder
}

/// What `gap` would refuse or remark on before it searches, in a second.
#[test]
fn a_scenario_is_held_against_a_log_before_a_search() {
    let folder = folder();
    let fits = folder.locsim("validate nominal.yaml --log measured.log").success();
    assert!(output(&fits).starts_with("nominal.yaml: valid, and of the same laser as measured.log"));
    folder.write("other.yaml", edited(NOMINAL, "beams: 24", "beams: 36"));
    folder.locsim("validate other.yaml").success();
    folder.locsim("validate other.yaml --log measured.log").code(2).stderr(contains("laser.beams"));
    folder.locsim("validate nominal.yaml --scan-topic /scan").code(2).stderr(contains("needs --log"));
    folder
        .locsim("validate nominal.yaml other.yaml --log measured.log")
        .code(2)
        .stderr(contains("one scenario"));
}

/// A log goes on after the scans that are looked at: the answer says so, and only then.
#[test]
fn a_log_that_is_cut_is_told() {
    let folder = folder();
    let notes_of = |scans: &str| {
        let line = "gap nominal.yaml --log measured.log --replicates 19 --no-filter --json";
        let call = folder.locsim(&format!("{line} --out results/{scans} --scans {scans}")).success();
        let outcome: Value = serde_json::from_str(&output(&call)).unwrap();
        outcome["notes"].to_string()
    };
    assert!(notes_of("40").contains("The first 40 of "));
    assert!(!notes_of("600").contains("are looked at"));
}

#[test]
fn the_missing_effect_is_named_and_added() {
    let folder = folder();
    let line = "gap nominal.yaml --log measured.log --out results/found --replicates 29";
    let call = folder.locsim(&format!("{line} --json")).success();
    let outcome: Value = serde_json::from_str(&output(&call)).unwrap();
    assert_eq!(outcome["effects"][0]["name"], "range_bias", "{outcome:#}");
    let bias = &outcome["effects"][0]["params"]["bias_m"];
    let number = |value: &Value| value.as_f64().unwrap();
    assert!((number(&bias["value"]) - 0.04).abs() < 0.01, "{bias}");
    assert_eq!(bias["unit"], "m");
    assert!(number(&outcome["gap"]["closed"]["value"]) > 0.8, "{}", outcome["gap"]);
    // Both filters have the same seeds: the mean of the paired differences is the difference of the means.
    let filter = &outcome["filter"];
    let rmse = |side: &str| number(&filter[side]["position_rmse_m"]["value"]);
    let change = number(&filter["change_m"]["value"]);
    assert!(change != 0.0 && (rmse("after") - rmse("before") - change).abs() < 1e-9, "{filter}");
    let saved: Value = serde_json::from_slice(&folder.read("results/found/gap.json")).unwrap();
    assert_eq!(saved, outcome);

    for name in [
        "report.md",
        "report.html",
        "gap.rrd",
        "figures/map.svg",
        "figures/pit.png",
        "figures/rivals.svg",
        "figures/range_bias.svg",
    ] {
        assert!(folder.path("results/found").join(name).is_file(), "{name}");
    }
    // Readings are 4 cm too long, which the simulated logs aren't until they have the effect.
    let profile = &outcome["profiles"][0];
    assert_eq!(
        (&profile["quantity"], &profile["over"]),
        (&Value::from("error"), &Value::from("range")),
        "{profile}"
    );
    let bins = profile["bins"].as_array().unwrap();
    let inside = |side: &str| {
        let is_inside = |bin: &&Value| {
            let [value, lo, hi] = [&bin["measured"], &bin[side]["lo"], &bin[side]["hi"]].map(number);
            lo <= value && value <= hi
        };
        bins.iter().filter(is_inside).count()
    };
    assert!(bins.len() >= 6 && inside("before") == 0, "{profile:#}");
    assert!(3 * inside("after") >= 2 * bins.len(), "{profile:#}");
    let steps = next_steps(&folder, "results/found");
    assert!(steps[0].contains("range_bias") && steps[0].contains("`scenario.yaml`"), "{steps:?}");
    let [report, page] = ["report.md", "report.html"]
        .map(|name| String::from_utf8(folder.read(&format!("results/found/{name}"))).unwrap());
    let holds_zero = number(&filter["change_m"]["lo"]) <= 0.0 && number(&filter["change_m"]["hi"]) >= 0.0;
    assert_eq!(report.contains("| change | no difference ("), holds_zero, "{filter}");
    // The bias was everywhere, so that what was off follows from it.
    let regions = outcome["where"].as_array().unwrap();
    let followed = regions.iter().filter(|region| region["remains"] == false).count();
    assert!(followed > 0, "{regions:?}");
    assert!(report.contains(&format!("<summary>{followed} region")), "{report}");
    assert!(page.contains("<details>\n<summary>") && page.contains("<blockquote>"));
    let text = String::from_utf8(folder.read("results/found/scenario.yaml")).unwrap();
    assert!(text.starts_with("# As the developers think it is.\n"), "{text}");
    assert!(
        text.contains("map: {file: ../../maps/room.yaml}")
            && text.contains("- {name: range_bias, bias_m: 0.0")
    );
    let diff = String::from_utf8(folder.read("results/found/scenario.diff")).unwrap();
    // Headers, name, map and effects: a line or two each.
    assert!(diff.lines().filter(|line| line.starts_with(['+', '-'])).count() <= 10, "{diff}");
    assert!(diff.contains("-name: nominal\n+name: nominal-gap\n"), "{diff}");
    assert!(!Path::new(&folder.path("results/found.partial")).exists());

    // It is a scenario like another.
    folder.locsim("validate results/found/scenario.yaml").success();
    folder.locsim("simulate results/found/scenario.yaml --out again.log").success();
    folder.locsim("run results/found/scenario.yaml --record none --quiet --out ran").success();
    // And what the log is held against next lacks nothing.
    let again =
        "gap results/found/scenario.yaml --log measured.log --out again --replicates 29 --no-filter --json";
    let again: Value = serde_json::from_str(&output(&folder.locsim(again).success())).unwrap();
    assert_eq!(again["effects"], serde_json::json!([]), "{again:#}");
    assert_eq!(again["filter"], Value::Null);
}

/// The box at the top of a report: three steps, numbered.
fn next_steps(folder: &Folder, found: &str) -> Vec<String> {
    let report = String::from_utf8(folder.read(&format!("{found}/report.md"))).unwrap();
    let (before, rest) = report.split_once("> **What to do next**\n>\n").unwrap();
    assert!(!before.contains("\n## ") && !before.contains("**"), "the box comes first\n{report}");
    let lines: Vec<&str> = rest.lines().take_while(|line| !line.is_empty()).collect();
    assert_eq!(lines.len(), 3, "{lines:?}");
    let step = |(i, line): (usize, &&str)| line.strip_prefix(&format!("> {}. ", i + 1)).unwrap().to_owned();
    lines.iter().enumerate().map(step).collect()
}

/// Every section that a scenario may leave out, left out once: a search ends with an answer, whether something is hidden or
/// not.
#[test]
fn a_scenario_may_leave_out_what_is_optional() {
    let folder = folder();
    let line = |start: &str| NOMINAL.lines().find(|line| line.trim_start().starts_with(start)).unwrap();
    let [blocks, odometry] = ["blocks:", "odometry_noise:"].map(line);
    let effects = "effects: # what a laser does anyway\n  - {name: range_dropout, p: 0.005, exponent: 0}\n";
    let cases = [
        ("blocks", vec![(blocks, "")]),
        ("odometry_noise", vec![(odometry, "")]),
        ("effects", vec![(effects, "")]),
        ("resolution_m", vec![(", resolution_m: 0.001", "")]),
        ("all", vec![(blocks, ""), (odometry, ""), (effects, ""), (", resolution_m: 0.001", "")]),
        // And once what the others leave out.
        ("mount", vec![("beams: 24,", "beams: 24, mount: {x_m: 0.1, y_m: 0.02, yaw_deg: 5},")]),
    ];
    let search = |(name, edits): &(&str, Vec<(&str, &str)>)| {
        let text = edits.iter().fold(NOMINAL.to_owned(), |text, (from, to)| edited(&text, from, to));
        folder.write(&format!("{name}.yaml"), &text);
        let list = if text.contains("effects:") { HIDDEN.to_owned() } else { format!("effects:\n{HIDDEN}") };
        let hidden = edited(&text, "training:", &list);
        folder.write(&format!("{name}-hidden.yaml"), hidden);
        for log in ["", "-hidden"] {
            folder.locsim(&format!("simulate {name}{log}.yaml --seed 11 --out {name}{log}.log")).success();
            let line = format!(
                "gap {name}.yaml --log {name}{log}.log --out {name}{log} --replicates 19 --threads 1 --json"
            );
            let outcome: Value = serde_json::from_str(&output(&folder.locsim(&line).success())).unwrap();
            let found: Vec<&str> =
                outcome["effects"].as_array().unwrap().iter().map(|e| e["name"].as_str().unwrap()).collect();
            if log.is_empty() {
                assert!(!found.contains(&"range_bias"), "{name}: {found:?}");
            } else {
                assert!(found.contains(&"range_bias"), "{name}: {found:?}");
            }
            next_steps(&folder, &format!("{name}{log}"));
            folder.locsim(&format!("validate {name}{log}/scenario.yaml")).success();
        }
    };
    std::thread::scope(|scope| {
        for case in &cases {
            scope.spawn(move || search(case));
        }
    });
}

/// What the log says of the laser's mount counts where the scenario says nothing.
#[test]
fn a_mount_that_is_left_out_is_the_logs() {
    let folder = folder();
    folder.write("turned.yaml", edited(NOMINAL, "beams: 24,", "beams: 24, mount: {x_m: 0.1, yaw_deg: 20},"));
    folder.locsim("simulate turned.yaml --seed 11 --out turned.log").success();
    let line = "gap nominal.yaml --log turned.log --out found --replicates 19 --no-filter";
    let call = folder.locsim(line).success();
    let told = "The scenario has no `laser.mount`; the log's is used: (0.100 m, 0.000 m, 20.0 deg).";
    let answer = output(&call);
    assert!(!answer.contains("mount_"), "{answer}");
    call.stderr(contains(told));
    let scenario = String::from_utf8(folder.read("found/scenario.yaml")).unwrap();
    assert!(scenario.contains("laser: {mount: {x_m: 0.1, y_m: 0, yaw_deg: 20}, rate_hz: 6"), "{scenario}");
    folder.locsim("validate found/scenario.yaml").success();
    // What the scenario says counts, be it that the laser is amid the robot.
    folder.write("amid.yaml", edited(NOMINAL, "beams: 24,", "beams: 24, mount: {},"));
    let call = folder.locsim(&line.replace("nominal.yaml", "amid.yaml").replace("found", "amid")).success();
    call.stderr(contains("the scenario's (0.000 m, 0.000 m, 0.0 deg) is used"));
}

#[test]
fn the_answer_is_for_people_and_an_effect_can_be_left_out() {
    let folder = folder();
    let line = "gap nominal.yaml --log measured.log --out found --replicates 19 --no-filter";
    let answer = output(&folder.locsim(line).success());
    for words in ["Every return is too long", "range_bias, bias = 0.0", "% closed [", "Results in found"] {
        assert!(answer.contains(words), "{words} is not in\n{answer}");
    }
    let rest = "--without range_bias --no-filter --max-range 5";
    let line = line.replace("--no-filter", rest);
    folder.locsim(&format!("{line} --quiet --force")).success().stdout(is_empty());
    let report = String::from_utf8(folder.read("found/report.md")).unwrap();
    assert!(report.contains(rest), "the command that repeats it isn't in\n{report}");
    let outcome: Value = serde_json::from_slice(&folder.read("found/gap.json")).unwrap();
    assert!(outcome["rivals"].as_array().unwrap().iter().all(|rival| rival["name"] != "range_bias"));
}

#[test]
fn what_does_not_fit_is_refused_and_earlier_results_stay() {
    let folder = folder();
    std::fs::create_dir(folder.path("found")).unwrap();
    folder.write("found/gap.json", "{}");
    let refused = |line: &str, message: &str| {
        folder.locsim(line).code(2).stdout(is_empty()).stderr(contains(message));
    };
    let with = |name: &str, from: &str, to: &str| folder.write(name, edited(NOMINAL, from, to));
    with("beams.yaml", "beams: 24", "beams: 36");
    with("range.yaml", "max_range_m: 5", "max_range_m: 6");
    with("view.yaml", "beams: 24", "beams: 24, field_of_view_deg: 270");
    with("exact.yaml", "noise: {sigma_m: 0.01}", "noise: {sigma_m: 0}");
    let gap = |scenario: &str, rest: &str| format!("gap {scenario} --log measured.log --out found {rest}");
    refused(&gap("beams.yaml", ""), "(24 beams in the log, 36 in the scenario)");
    refused(&gap("range.yaml", ""), "measured.log: a maximum range of 5 m doesn't fit");
    refused(&gap("view.yaml", ""), "measured.log: beam 0 points to");
    with("quiet.yaml", ", noise: {sigma_m: 0.01}", "");
    for scenario in ["exact.yaml", "quiet.yaml"] {
        refused(&gap(scenario, "").replace("found", "new"), "laser.noise.sigma_m: more than 0 is allowed");
    }
    refused(&gap("nominal.yaml", ""), "--out: found is not allowed; it isn't empty");
    refused(&gap("nominal.yaml", "--force"), "found/gap.json isn't as locsim wrote it, and stays");
    refused(&gap("nominal.yaml", "--without glas"), "\"glas\" is not an effect; one of range_bias");
    refused(&gap("nominal.yaml", "--replicates 5"), "a whole number from 19 to 100000 is allowed");
    refused(&gap("nominal.yaml", "--beams 0"), "a whole number from 1 to 4294967295 is allowed");
    refused("gap nominal.yaml --log missing.log --out found", "missing.log");
    refused("gap nominal.yaml --log measured.log", "--out");
    let text = String::from_utf8(folder.read("measured.log")).unwrap();
    let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("TRUEPOS")).collect();
    folder.write("blind.log", lines.join("\n") + "\n");
    refused("gap nominal.yaml --log blind.log --out found", "blind.log: no scan has a reference pose");
    assert_eq!(folder.read("found/gap.json"), b"{}");
    assert!(!folder.path("found.partial").exists() && !folder.path("new.partial").exists());
}

/// A scenario with twice the scans, of which each half has several folds, and its log.
fn dense_log(folder: &Folder) -> String {
    folder.write("dense.yaml", edited(NOMINAL, "rate_hz: 6", "rate_hz: 12"));
    folder.locsim("simulate dense.yaml --seed 12 --out plain.log").success();
    String::from_utf8(folder.read("plain.log")).unwrap()
}

/// A log whose returns are off by a function of range and bearing.
fn shifted(log: &str, by: impl Fn(f64, f64) -> f64) -> String {
    let line = |line: &str| {
        let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        if words[0] == "ROBOTLASER1" {
            let [first, step, count] = [2, 4, 8].map(|i| words[i].parse::<f64>().unwrap());
            for i in 0..count as usize {
                let range: f64 = words[9 + i].parse().unwrap();
                if range < 4.9 {
                    words[9 + i] = format!("{:.3}", range + by(range, first + step * i as f64));
                }
            }
        }
        words.join(" ")
    };
    log.lines().map(line).collect::<Vec<_>>().join("\n") + "\n"
}

/// Near returns are too short and far ones too long, which a share of the range is not. The name is the one of errors over range, and
/// the rest is told as its form.
#[test]
fn an_error_over_range_has_its_name_in_any_form() {
    let folder = folder();
    let text = dense_log(&folder);
    folder.write("measured.log", shifted(&text, |range, _| 0.012 * range * (range - 0.7)));
    let line = "gap dense.yaml --log measured.log --out found --replicates 99 --no-filter --json";
    let outcome: Value = serde_json::from_str(&output(&folder.locsim(line).success())).unwrap();
    let names: Vec<&Value> =
        outcome["effects"].as_array().unwrap().iter().map(|effect| &effect["name"]).collect();
    assert_eq!(names, ["range_scale"], "{outcome:#}");
    // What is likelier than its formula was refused for its curve.
    assert_eq!(outcome["effects"][0]["candidates"], json!(["range_scale"]), "{outcome:#}");
    let left = &outcome["unnamed"][0];
    assert_eq!((&left["covariate"], &left["form_of"]), (&"range".into(), &"range_scale".into()), "{left:#}");
}

/// Returns of a log are off by 3 cm sin(2 bearing), which no effect of the library is, and the log is edited here. The curve is
/// learnt, the simulator carries it, and with it nothing is off any more.
#[test]
fn a_curve_without_a_name_becomes_a_part_of_the_simulator() {
    let folder = folder();
    let text = dense_log(&folder);
    folder.write("measured.log", shifted(&text, |_, bearing| 0.03 * (2.0 * bearing).sin()));
    let search = |scenario: &str, out: &str| -> Value {
        let line =
            format!("gap {scenario} --log measured.log --out {out} --replicates 99 --no-filter --json");
        serde_json::from_str(&output(&folder.locsim(&line).success())).unwrap()
    };
    let outcome = search("dense.yaml", "found");
    let found = &outcome["unnamed"][0];
    assert_eq!(
        (&outcome["verdict"], &found["covariate"]),
        (&"unnamed".into(), &"bearing".into()),
        "{outcome:#}"
    );
    let amplitude = found["wave"]["amplitude"].as_f64().unwrap();
    assert!((amplitude - 0.03).abs() < 0.006, "{found:#}");
    let stage = &outcome["residual"];
    let [without, with] = ["w1_without_mm", "w1_mm"].map(|key| stage[key].as_f64().unwrap());
    assert!(with < 0.6 * without, "{stage:#}");
    let proposed = String::from_utf8(folder.read("found/scenario.yaml")).unwrap();
    assert!(proposed.contains("residuals:\n") && proposed.contains("- {bearing_deg: ["), "{proposed}");
    assert!(folder.path("found/figures/unnamed.svg").is_file());
    let again = search("found/scenario.yaml", "again");
    assert!(again["detection"]["p"].as_f64().unwrap() > 0.01, "{again:#}");
    assert_eq!(
        (&again["unnamed"], &again["residual"]),
        (&Value::Array(Vec::new()), &Value::Null),
        "{again:#}"
    );
    let apply = "apply found/scenario.yaml --in measured.log --out worse.log";
    folder.locsim(apply).code(2).stderr(contains("residuals: the key is not allowed here"));
}

/// Stamps of six digits since 1970 are all alike, as in logs that are handed around. Simulated logs are of the whole drive none the less.
#[test]
fn a_clock_that_stands_still_hides_nothing() {
    let folder = folder();
    folder.write("still.log", with_one_stamp(&folder.read("measured.log")));
    let line = "gap nominal.yaml --log still.log --out found --replicates 29 --no-filter --json";
    let outcome: Value = serde_json::from_str(&output(&folder.locsim(line).success())).unwrap();
    assert_eq!(outcome["effects"][0]["name"], "range_bias", "{outcome:#}");
    let of = |key: &str| outcome["gap"][key]["w1_mm"].as_f64().unwrap();
    let [before, after, floor] = ["before", "after", "floor"].map(of);
    assert!(after - floor < 0.3 * (before - floor), "{}", outcome["gap"]);
    let notes = outcome["notes"].to_string();
    assert!(notes.contains("have the stamp of the scan before"), "{notes}");
}

/// A driver that sends each tenth scan a second time, under the next stamp, and an odometry that isn't recorded for two seconds. Neither
/// is an effect of the laser: readings of where the robot was aren't looked at.
#[test]
fn scans_that_were_sent_again_are_left_out() {
    let folder = folder();
    folder.locsim("simulate nominal.yaml --seed 12 --out plain.log").success();
    // Twelve scans are two seconds.
    let freeze = |poses: &mut [String], frozen: &mut Vec<String>, scan: usize| {
        if (30..42).contains(&scan) {
            poses.clone_from_slice(frozen);
        }
        *frozen = poses.to_vec();
    };
    let text = String::from_utf8(folder.read("plain.log")).unwrap();
    let (mut scan, mut scans, mut sent) = (Vec::new(), 0, 0);
    // Poses by odometry in lines of it, of the truth and of scans.
    let mut frozen: [Vec<String>; 3] = Default::default();
    let line = |line: &str| {
        let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        if words[0] == "ROBOTLASER1" {
            // Readings, the number of remissions, then the poses of laser and robot by odometry.
            let end = 9 + words[8].parse::<usize>().unwrap();
            let (readings, poses) = (9..end, end + 1..end + 7);
            if scans % 10 == 5 {
                words[readings.clone()].clone_from_slice(&scan);
                sent += 1;
            }
            scan = words[readings].to_vec();
            freeze(&mut words[poses], &mut frozen[0], scans);
            scans += 1;
        } else if words[0] == "ODOM" {
            freeze(&mut words[1..4], &mut frozen[1], scans);
        } else if words[0] == "TRUEPOS" {
            freeze(&mut words[4..7], &mut frozen[2], scans);
        }
        words.join(" ")
    };
    folder.write("again.log", text.lines().map(line).collect::<Vec<_>>().join("\n") + "\n");
    let line = "gap nominal.yaml --log again.log --out found --replicates 29 --no-filter --json";
    let found = folder.locsim(line).success().stderr(contains("the driver has sent them again"));
    let outcome: Value = serde_json::from_str(&output(&found)).unwrap();
    let named = outcome["effects"].as_array().unwrap().iter().map(|effect| effect["name"].as_str().unwrap());
    assert!(named.clone().all(|name| name.contains("odom") || name.contains("slip")), "{outcome:#}");
    let notes = outcome["notes"].to_string();
    assert!(sent > 5 && notes.contains(&format!("{sent} scans have all readings")), "{sent}: {notes}");
    assert!(notes.contains("The odometry stands still for"), "{notes}");
    let report = String::from_utf8(folder.read("found/report.md")).unwrap();
    let top = report.split("## ").next().unwrap();
    assert!(top.contains("sent them again") && top.contains("stands still"), "{top}");
    let warnings = output(&folder.locsim("inspect again.log").success());
    assert!(warnings.contains("sent them again") && warnings.contains("stands still"), "{warnings}");
}

/// A laser of 5 cm steps and hardly any noise often reads the same from one scan to the next. No driver has sent these again.
#[test]
fn scans_of_a_coarse_laser_are_its_own() {
    let folder = folder();
    let laser =
        "laser: {rate_hz: 20, beams: 24, max_range_m: 5, resolution_m: 0.05, noise: {sigma_m: 0.001}}";
    let coarse = NOMINAL.lines().map(|line| if line.starts_with("laser:") { laser } else { line });
    folder.write("coarse.yaml", coarse.collect::<Vec<_>>().join("\n") + "\n");
    folder.locsim("simulate coarse.yaml --seed 3 --out coarse.log").success();
    let facts = output(&folder.locsim("inspect coarse.log --json").success());
    let facts: Value = serde_json::from_str(&facts).unwrap();
    assert_eq!(facts["drive"]["clock"]["stale"], 0, "{:#}", facts["drive"]["clock"]);
}

/// The true poses of a log are turned by a degree about the map's origin, and scans are as they were. To a scan that is much like a laser
/// that sits at another angle.
#[test]
fn a_reference_in_a_turned_frame_is_no_turned_laser() {
    let folder = folder();
    let text = dense_log(&folder);
    let turn = 1_f64.to_radians();
    let line = |line: &str| {
        let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        if words[0] == "TRUEPOS" {
            let [x, y, heading] = [1, 2, 3].map(|i| words[i].parse::<f64>().unwrap());
            let turned = [x * turn.cos() - y * turn.sin(), x * turn.sin() + y * turn.cos(), heading + turn];
            words[1..4].clone_from_slice(&turned.map(|value| value.to_string()));
        }
        words.join(" ")
    };
    folder.write("measured.log", text.lines().map(line).collect::<Vec<_>>().join("\n") + "\n");
    let line = "gap dense.yaml --log measured.log --out found --replicates 99 --no-filter --json";
    let outcome: Value = serde_json::from_str(&output(&folder.locsim(line).success())).unwrap();
    let found = &outcome["unnamed"][0];
    assert_eq!(
        (&outcome["verdict"], &found["deviation"], &found["covariate"]),
        (&"unnamed".into(), &"frame".into(), &"place".into()),
        "{outcome:#}"
    );
    let size = found["size"].as_f64().unwrap();
    assert!((size - turn).abs() < 0.2 * turn, "{found:#}");
    let report = String::from_utf8(folder.read("found/report.md")).unwrap();
    assert!(report.contains("1. Put the reference's poses into the map's frame"), "{report}");
}

#[test]
fn an_effect_is_explained_as_in_the_list() {
    let folder = Folder::new();
    let page = output(&folder.locsim("effects glass").success());
    folder.locsim("gap --explain glass").success().stdout(contains(page.trim_end()));
    folder
        .locsim("gap --explain glas")
        .code(2)
        .stdout(is_empty())
        .stderr(contains("not an effect").and(contains("glass")));
}

#[test]
fn what_changed_since_a_baseline_is_named() {
    let folder = folder();
    folder.locsim("simulate nominal.yaml --seed 21 --out good.log").success();
    let line = "gap nominal.yaml --baseline good.log --log measured.log --replicates 99";
    let call = folder.locsim(&format!("{line} --out since --json")).success();
    let found: Value = serde_json::from_str(&output(&call)).unwrap();
    assert_eq!(found["verdict"], "changed", "{found:#}");
    let first = &found["baseline"]["effects"][0];
    assert_eq!(first["name"], "range_bias", "{found:#}");
    let bias = first["params"]["bias_m"]["value"].as_f64().unwrap();
    assert!((bias - 0.04).abs() < 0.01, "{bias}");
    assert_eq!(found["baseline"]["log"], "good.log");
    let report = std::fs::read_to_string(folder.path("since/report.md")).unwrap();
    assert!(report.contains("Since the baseline: Every return is too long by the same length"), "{report}");
    assert!(report.contains("--baseline good.log"), "{report}");
    // The scenario has the change, and runs.
    folder.locsim("validate since/scenario.yaml").success();
    // The log itself: nothing has changed, and the report says why.
    let same = "gap nominal.yaml --baseline good.log --log good.log --replicates 19 --out same";
    folder.locsim(same).success().stdout(contains("Nothing has changed since the baseline"));
    let report = std::fs::read_to_string(folder.path("same/report.md")).unwrap();
    assert!(report.contains("The baseline is the log itself"), "{report}");
}

#[test]
fn a_baseline_that_cannot_be_one_is_refused() {
    let folder = folder();
    let other = edited(NOMINAL, "beams: 24, max_range_m: 5", "beams: 24, max_range_m: 6");
    folder.write("other.yaml", other);
    folder.locsim("simulate other.yaml --out other.log").success();
    folder.write("empty.log", "");
    for (baseline, part) in [
        ("missing.log", "missing.log"),
        ("empty.log", "empty.log"),
        ("other.log", "other.log: a maximum range of 6 m doesn't fit the scenario's laser"),
    ] {
        let line = format!("gap nominal.yaml --baseline {baseline} --log measured.log --out since");
        folder.locsim(&line).code(2).stderr(contains(part));
        assert!(!folder.path("since").exists());
    }
}
