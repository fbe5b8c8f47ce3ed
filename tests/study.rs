//! `locsim study` as a user types it.

mod common;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use common::{Folder, edited, locsim, output};
use predicates::prelude::*;
use predicates::str::{contains, is_empty};
use serde_json::Value;

/// A grass study of seconds, whose lines tests replace.
const GRASS: &str = "\
name: lawn
description: A short rail
seed: 5
sensor:
  grass:
    rail_m: 0.5
    depth_m: [0.1, 0.2]
    blades_per_m2: 1000
    blade_m: [0.001, 0.002]
    wind_m: 0.001
    beam_m: 0.001
    sigma_m: 0.002
    max_range_m: 0.3
    resolution_m: 0.002
observations: 20
states: [8, 16]
counts: [5, 20]
models: [p_reg, np_reg]
bandwidths: {position_m: [0.01, 0.05, 0.2]}
test_states: 10
truth_observations: 300
repeats: 3
";

/// A table of a sensor that reads its state, with a step.
fn table(rows: usize) -> String {
    let mut text = "# a comment\nx,z\n".to_owned();
    for i in 0..rows {
        let x = (i / 2) as f64 / 10.0;
        let _ = writeln!(text, "{x},{}", x + 0.01 * (i % 2) as f64);
    }
    text
}

const TABLE: &str = "\
seed: 1
sensor: {table: {file: readings.csv, values: [0, 3], resolution: 0.01, align: {shift: x}}}
criterion: crps
states: [10, 14]
models: [np_reg, np_reg_registered]
bandwidths: {x: [0.05, 0.2, 1]}
repeats: 2
";

fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = PathBuf::from(path.file_name().unwrap());
        if path.is_dir() {
            found.extend(files(&path).into_iter().map(|(inner, content)| (name.join(inner), content)));
        } else {
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

#[test]
fn a_study_says_what_holds_and_leaves_every_documented_file() {
    let folder = Folder::new();
    folder.write("lawn.yaml", GRASS);
    let run = folder.locsim("study lawn.yaml").success();
    assert!(output(&run).contains("Fig. 3") && output(&run).contains("results/lawn"), "{}", output(&run));
    let found = files(&folder.path("results/lawn"));
    for name in
        ["neighbours", "roughness", "observations", "loss_against_observations", "risk", "predictions"]
    {
        assert!(found[Path::new(&format!("figures/{name}.svg"))].starts_with(b"<svg"), "{name}");
        assert!(found[Path::new(&format!("figures/{name}.png"))].starts_with(b"\x89PNG"), "{name}");
    }
    let report = String::from_utf8(found[Path::new("report.md")].clone()).unwrap();
    for part in
        ["# lawn", "## What holds", "Fig. 3", "locsim study lawn.yaml --seed 5 --repeats 3", "rail_m: 0.5"]
    {
        assert!(report.contains(part), "no {part} in\n{report}");
    }
    assert!(found[Path::new("report.html")].starts_with(b"<!doctype html>"));
    let results: Value = serde_json::from_slice(&found[Path::new("results.json")]).unwrap();
    assert_eq!(results["repeats"], 3);
    assert_eq!(results["conditions"][0]["risks"][1]["model"], "np_reg");
    for curve in ["risk", "crps"] {
        let mean = results["conditions"][0]["risks"][1][curve]["mean"].as_array().unwrap();
        assert_eq!(mean.len(), 2);
        assert!(mean.iter().all(|risk| risk.as_f64().unwrap() > 0.0), "{mean:?}");
    }
    assert_eq!(results["claims"][0]["figure"], "Fig. 3");
    assert_eq!(fs::read_dir(folder.path("results")).unwrap().count(), 1, "nothing but the results is left");

    // Once more in the same place, then something else in it.
    folder.locsim("study lawn.yaml --quiet --force").success().stdout(is_empty());
    assert_eq!(folder.read("results/lawn/results.json"), found[Path::new("results.json")]);
    folder.locsim("study lawn.yaml").code(2).stderr(contains("it isn't empty"));
    folder.write("results/lawn/notes.txt", "precious");
    folder
        .locsim("study lawn.yaml --force")
        .code(2)
        .stderr(contains("results/lawn/notes.txt isn't as locsim wrote it"));
    assert_eq!(folder.read("results/lawn/notes.txt"), b"precious");
}

#[test]
fn threads_change_no_byte_and_the_seed_does() {
    let folder = Folder::new();
    folder.write("lawn.yaml", GRASS);
    let run = |options: &str| {
        folder.locsim(&format!("study lawn.yaml --quiet --out {options}")).success();
    };
    run("one --threads 1");
    run("two --threads 2");
    run("other --seed 6");
    let [one, two, other] = ["one", "two", "other"].map(|out| files(&folder.path(out)));
    assert!(one == two, "results depend on the number of threads");
    let results = Path::new("lawn/results.json");
    assert_ne!(one[results], other[results]);
}

#[test]
fn options_replace_what_the_file_says() {
    let folder = Folder::new();
    folder.write("lawn.yaml", GRASS);
    let json = output(&folder.locsim("study lawn.yaml --quick --repeats 1 --seed 9 --json").success());
    let results: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&results["repeats"], &results["seed"], &results["quick"]),
        (&1.into(), &9.into(), &true.into())
    );
    assert!(
        String::from_utf8(folder.read("results/lawn/report.md")).unwrap().contains("Cut down by `--quick`")
    );
}

#[test]
fn a_study_that_is_wrong_is_refused_with_line_and_key() {
    for (from, to, message) in [
        (
            "rail_m: 0.5",
            "rial_m: 0.5",
            "s.yaml:6: sensor.grass.rial_m: `rial_m` is not a key; did you mean `rail_m`?",
        ),
        (
            "rail_m: 0.5",
            "rail_m: -1",
            "s.yaml:6: sensor.grass.rail_m: -1 is not allowed; a number from 0.001 to 10000",
        ),
        ("  grass:", "  gras:", "s.yaml:4: sensor: `gras` is not allowed; did you mean `grass`?"),
        ("[8, 16]", "[16, 8]", "s.yaml:16: states[1]: 8 is not allowed; numbers ascend"),
        ("[8, 16]", "[2, 16]", "s.yaml:16: states[0]: 2 is not allowed; a whole number from 5 to"),
        ("np_reg]", "p_reg]", "s.yaml:18: models[1]: `p_reg` is not allowed; it is in the list already"),
        (
            "np_reg]",
            "np_reg_registered]",
            "s.yaml:18: models[1]: `np_reg_registered` is not allowed; the observation follows no",
        ),
        (
            "position_m: [0.01, 0.05, 0.2]",
            "place: [1]",
            "bandwidths.place: `place` is not a state coordinate; allowed: position_m",
        ),
        (
            "position_m: [0.01, 0.05, 0.2]",
            "position_m: [0]",
            "bandwidths.position_m[0]: 0 is not allowed; a number from 1e-12 to 1000000000000",
        ),
        ("observations: 20\n", "", "observations: the key is missing"),
        (
            "resolution_m: 0.002",
            "resolution_m: 0.00000001",
            "sensor.grass.resolution_m: 30000000 values are not allowed",
        ),
    ] {
        let folder = Folder::new();
        folder.write("s.yaml", edited(GRASS, from, to));
        folder.locsim("study s.yaml").code(2).stdout(is_empty()).stderr(contains(message));
        assert!(!folder.path("results").exists(), "{to}");
    }
}

#[test]
fn validate_and_schema_know_studies() {
    let folder = Folder::new();
    folder.write("lawn.yaml", GRASS);
    let valid = folder.locsim("validate lawn.yaml").success();
    assert!(output(&valid).contains("lawn.yaml: valid (study, 2 models, 3 repeats)"), "{}", output(&valid));
    folder.write("lawn.yaml", edited(GRASS, "rail_m: 0.5", "rail_m: -1"));
    folder.locsim("validate lawn.yaml").code(2).stderr(contains("lawn.yaml:6: sensor.grass.rail_m: -1"));
    folder.locsim("validate absent.yaml").code(2).stderr(contains("absent.yaml"));
    let schema: Value = serde_json::from_str(&output(&folder.locsim("schema --study").success())).unwrap();
    assert!(schema["properties"]["sensor"].is_object() && schema["properties"]["robot"].is_null());
}

#[test]
fn a_study_that_is_refused_does_not_keep_the_others_from_running() {
    let folder = Folder::new();
    folder.write("lawn.yaml", GRASS);
    folder.locsim("study none.yaml lawn.yaml --quick").code(2).stderr(contains("none.yaml"));
    assert!(folder.path("results/lawn/report.html").is_file());
}

#[test]
fn a_table_of_ones_own_is_studied_and_its_faults_have_lines() {
    let folder = Folder::new();
    folder.write("own.yaml", TABLE);
    folder.write("readings.csv", table(48));
    folder.locsim("study own.yaml").success();
    let results: Value = serde_json::from_slice(&folder.read("results/own/results.json")).unwrap();
    assert_eq!(results["bins"], 301);
    // Readings follow x, so that those relative to it lose nothing by smoothing.
    let crps = |model: usize| results["conditions"][0]["risks"][model]["crps"]["mean"][1].as_f64().unwrap();
    assert!(crps(1) < 0.5 * crps(0), "registered {} against {}", crps(1), crps(0));

    for (content, message) in [
        ("x,z\n1,2\n1,two\n", "readings.csv:3: `two` is not allowed; a number"),
        ("x,z\n1,2\n1\n", "readings.csv:3: 1 columns are not allowed; 2 as in the line before"),
        ("# c\nx,z\n1,2\n1,inf\n", "readings.csv:4: inf is not allowed; a finite number"),
        ("z\n1\n", "readings.csv:1: one column is not allowed"),
        ("x,z\n1,2\n", "readings.csv:1: 1 states are not enough; at least 8"),
    ] {
        folder.write("readings.csv", content);
        folder.locsim("study own.yaml").code(2).stderr(contains(message));
    }
    folder.write("readings.csv", table(48).replace("x,z", "y,z"));
    folder
        .locsim("study own.yaml")
        .code(2)
        .stderr(contains("sensor.table.align: `x` is not a state column; did you mean `y`? allowed: y"));
    folder.write("readings.csv", table(20));
    folder
        .locsim("study own.yaml")
        .code(2)
        .stderr(contains("own.yaml:4: states[0]: 10 is not allowed; at most 7: of 10 states 3"));
}

#[test]
fn a_static_lidar_is_studied_ray_by_ray() {
    // 40 rays in a round room; ray 7 never returns.
    let mut scans = String::new();
    for scan in 0..60 {
        let cells: Vec<String> = (0..40)
            .map(|ray| {
                let jitter = f64::from((scan * 7 + ray * 3) % 5) * 0.001;
                if ray == 7 {
                    "inf".to_owned()
                } else {
                    format!("{:.3}", 1.0 + 0.01 * f64::from(ray % 9) + jitter)
                }
            })
            .collect();
        scans += &(cells.join(",") + "\n");
    }
    let folder = Folder::new();
    folder.write("scans.csv", &scans);
    folder.write(
        "lidar.yaml",
        "seed: 1\nsensor:\n  static_lidar: {file: scans.csv, max_range_m: 2, resolution_m: 0.001, map_scans: 10, \
         least_return_share: 0.5}\ncounts: [5, 10]\nstates: [10, 20]\nmodels: [p_reg, np_reg]\nbandwidths: {range_m: [0.01, \
         0.1], slope_m: [0.01, 0.1], edge_m: [0.01, 0.1]}\nrepeats: 2\n",
    );
    folder.locsim("study lidar.yaml").success();
    let results: Value = serde_json::from_slice(&folder.read("results/lidar/results.json")).unwrap();
    assert_eq!(results["families"]["rays"], 39);
    assert!(folder.path("results/lidar/figures/rays.png").is_file());
    folder.write("scans.csv", scans.replace("1.042", "x"));
    folder
        .locsim("study lidar.yaml")
        .code(2)
        .stderr(contains("scans.csv:").and(contains("`x` is not allowed; a number")));
}

/// The repository's own studies, cut down.
#[test]
fn the_papers_studies_run() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = Folder::new();
    let out = folder.path("results");
    for study in ["laser", "field_sensor", "grass", "table"] {
        let line =
            format!("study scenarios/paper/{study}.yaml --quick --repeats 1 --quiet --out {}", out.display());
        locsim(&root, &line).assert().success();
        assert!(out.join(study).join("report.html").is_file(), "{study}");
    }
}

#[test]
fn measured_scans_that_are_not_there_are_named() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let call = locsim(&root, "study scenarios/paper/static_lidar.yaml").env_remove("LOCSIM_DATA").assert();
    call.code(2).stderr(contains("sensor.static_lidar.file").and(contains("LOCSIM_DATA is not set")));
}
