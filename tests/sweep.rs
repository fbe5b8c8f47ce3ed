//! `locsim sweep` and `locsim merge` as a user types them.

#[allow(dead_code, reason = "the calls of the other tests aren't needed here")]
mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use common::{Folder, edited, locsim, output};
use predicates::str::contains;
use serde_json::{Value, json};

/// 6 cells of 2 trials.
const SWEEP: &str = "\
name: room-sweep
scenario: room-run.yaml
seed: 5
trials: 2
axes:
  blocks.per_metre_of_wall: [0.0, 0.3]
  filter.particles: {from: 40, to: 80, step: 20}
";

/// With models that are trained at once.
fn scenario() -> String {
    edited(common::SCENARIO, "[classic, np_reg_registered]", "[classic, likelihood_field]")
}

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("room-run.yaml", scenario());
    folder.write("s.yaml", SWEEP);
    folder
}

/// Files under a folder by path, but for those that hold wall times.
fn results(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    fn walk(root: &Path, folder: &Path, files: &mut BTreeMap<PathBuf, Vec<u8>>) {
        for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                walk(root, &entry, files);
            } else if !["times.csv", "manifest.json"].iter().any(|name| entry.ends_with(name)) {
                files.insert(entry.strip_prefix(root).unwrap().to_owned(), fs::read(&entry).unwrap());
            }
        }
    }
    let mut files = BTreeMap::new();
    walk(root, root, &mut files);
    files
}

fn run_shards(folder: &Folder, shards: u32, out: &str) {
    for number in 1..=shards {
        folder.locsim(&format!("sweep s.yaml --out {out} --shard {number}/{shards} --quiet")).success();
    }
}

#[test]
fn shards_merge_into_the_bytes_of_one_machine_on_any_number_of_threads() {
    let folder = folder();
    let told = output(&folder.locsim("sweep s.yaml --out one").success());
    assert!(told.contains("room-sweep: 6 cells, seed 5") && told.contains("classic"), "{told}");
    let one = results(&folder.path("one"));
    for name in
        ["trials/model=classic/part-0.parquet", "cells.csv", "sweep.json", "report.html", "figures/error.svg"]
    {
        assert!(one.contains_key(Path::new(name)), "{name}: {:?}", one.keys());
    }
    folder.locsim("sweep s.yaml --out again --threads 1 --quiet").success();
    assert!(one == results(&folder.path("again")));
    for shards in [1, 2, 6] {
        let out = format!("shards{shards}");
        run_shards(&folder, shards, &out);
        folder.locsim(&format!("merge {out} --quiet")).success();
        let merged = results(&folder.path(&format!("{out}/merged")));
        assert_eq!(one.keys().collect::<Vec<_>>(), merged.keys().collect::<Vec<_>>());
        for (name, bytes) in &one {
            assert!(*bytes == merged[name], "{shards} shards: {}", name.display());
        }
    }
}

#[test]
fn a_sweep_has_the_figures_of_its_cells() {
    let folder = folder();
    folder.locsim("sweep s.yaml --out o --quiet").success();
    let sweep: Value = serde_json::from_slice(&folder.read("o/sweep.json")).unwrap();
    assert_eq!((&sweep["cells"], &sweep["rows"]), (&Value::from(6), &Value::from(24)));
    assert_eq!(sweep["models"]["classic"]["trials"], 12);
    assert!(sweep["inputs"]["room.yaml"].is_string(), "{sweep}");
    let cells = String::from_utf8(folder.read("o/cells.csv")).unwrap();
    let lines: Vec<Vec<&str>> = cells.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines.len(), 13);
    let column = |name: &str| lines[0].iter().position(|title| *title == name).unwrap();
    let row = lines.iter().find(|row| row[0] == "5" && row[column("model")] == "classic").unwrap();
    assert_eq!(row[column("filter.particles")], "80");
    // The cell alone, as `locsim run` runs it, has the same trials.
    let text = edited(&scenario(), "particles: 100", "particles: 80");
    folder.write("cell.yaml", text);
    let seed = row[column("cell_seed")];
    folder
        .locsim(&format!("run cell.yaml --seed {seed} --trials 2 --record none --quiet --out cell"))
        .success();
    let summary: Value = serde_json::from_slice(&folder.read("cell/summary.json")).unwrap();
    let rmse: f64 = row[column("position_rmse_m")].parse().unwrap();
    let expected = summary["models"]["classic"]["position_rmse_m"].as_f64().unwrap();
    assert!((rmse - expected).abs() < 1e-12, "{rmse} {expected}");
}

#[test]
fn a_shard_that_is_complete_is_left_alone() {
    let folder = folder();
    let line = "sweep s.yaml --out o --shard 2/3";
    let told = output(&folder.locsim(line).success());
    assert!(told.contains("shard 2 of 3: 2 cells in o/shard-00002-of-00003"), "{told}");
    let before = results(&folder.path("o"));
    let told = output(&folder.locsim(line).success());
    assert!(told.contains("shard 2 of 3: nothing to do"), "{told}");
    assert!(before == results(&folder.path("o")));
    // Of another seed it is another shard.
    let line = format!("{line} --seed 6");
    folder.locsim(&line).code(2).stderr(contains("holds a shard of something else"));
    assert!(before == results(&folder.path("o")));
    folder.locsim(&format!("{line} --force")).success();
    assert!(before != results(&folder.path("o")));
}

#[test]
fn the_environment_of_an_engine_names_the_shard() {
    let folder = folder();
    let with = |line: &str, variables: &[(&str, &str)]| {
        let mut command = locsim(&folder.path("."), line);
        command.envs(variables.iter().copied()).assert()
    };
    let slurm = [
        ("SLURM_ARRAY_TASK_ID", "8"),
        ("SLURM_ARRAY_TASK_COUNT", "3"),
        ("SLURM_ARRAY_TASK_MIN", "7"),
        ("SLURM_ARRAY_TASK_MAX", "9"),
    ];
    with("sweep s.yaml --out o", &slurm).success().stdout(contains("shard 2 of 3: 2 cells"));
    with("sweep s.yaml --out o --shards 3", &[("HQ_TASK_ID", "1")])
        .success()
        .stdout(contains("shard 1 of 3"));
    with("sweep s.yaml --out o --shards 3", &[("PARALLEL_SEQ", "3")])
        .success()
        .stdout(contains("shard 3 of 3"));
    folder.locsim("merge o --quiet").success();
    with("sweep s.yaml --out o --shards 3", &[("PARALLEL_SEQ", "4")])
        .code(2)
        .stderr(contains("shard 4 of 3"));
    with("sweep s.yaml --out o --shards 3", &[])
        .code(2)
        .stderr(contains("no task number in the environment"));
}

/// Without what tells times: reports, and the times of a summary.
fn timeless(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = results(folder);
    files.retain(|name, _| !name.to_str().unwrap().starts_with("report."));
    let summary = files.get_mut(Path::new("summary.json")).unwrap();
    let mut value: Value = serde_json::from_slice(summary).unwrap();
    value.as_object_mut().unwrap().remove("seconds").unwrap();
    for model in value["models"].as_object_mut().unwrap().values_mut() {
        model.as_object_mut().unwrap().retain(|key, _| !key.contains("step_ms"));
    }
    *summary = value.to_string().into_bytes();
    files
}

#[test]
fn shards_of_a_run_merge_into_the_bytes_of_one_run() {
    let folder = folder();
    folder.locsim("run room-run.yaml --trials 5 --seed 9 --record none --quiet --out one").success();
    let one = timeless(&folder.path("one"));
    assert!(one.contains_key(Path::new("trials.parquet")) || one.len() > 5, "{:?}", one.keys());
    for shards in [1, 2, 5] {
        let out = format!("o{shards}");
        for number in (1..=shards).rev() {
            let line = format!("run room-run.yaml --trials 5 --seed 9 --out {out} --shard {number}/{shards}");
            let told = output(&folder.locsim(&line).success());
            assert!(told.contains(&format!("shard {number} of {shards}: ")), "{told}");
            let again = output(&folder.locsim(&line).success());
            assert!(again.contains("nothing to do"), "{again}");
        }
        // As deep as the other: the copy of the scenario names its map from there.
        folder.locsim(&format!("merge {out} --out merged{shards} --record none --quiet")).success();
        let merged = timeless(&folder.path(&format!("merged{shards}")));
        assert_eq!(one.keys().collect::<Vec<_>>(), merged.keys().collect::<Vec<_>>());
        for (name, bytes) in &one {
            assert!(*bytes == merged[name], "{shards} shards: {}", name.display());
        }
    }
    // The report names the command of the whole run.
    let report = String::from_utf8(folder.read("merged2/report.md")).unwrap();
    assert!(report.contains("locsim run room-run.yaml --seed 9 --trials 5"), "{report}");
}

#[test]
fn a_merge_of_a_run_says_which_shards_to_run_again() {
    let folder = folder();
    let shard = |number: u32, more: &str| {
        let line = format!("run room-run.yaml --models classic --out o --shard {number}/3 --quiet {more}");
        folder.locsim(&line)
    };
    shard(1, "").success();
    let call = folder.locsim("merge o").code(2);
    let error = String::from_utf8(call.get_output().stderr.clone()).unwrap();
    let again = "for i in 2 3; do locsim run room-run.yaml --seed 3 --trials 3 --models classic --out o --shard $i/3; done";
    assert!(error.contains("2 of 3 shards are missing: 2-3") && error.contains(again), "{error}");
    shard(2, "").success();
    shard(3, "--seed 4").success();
    folder.locsim("merge o").code(2).stderr(contains("o/shard-00003-of-00003 is of another run: its digest"));
    shard(3, "").code(2).stderr(contains("holds a shard of something else"));
    shard(3, "--force").success();
    // A scenario that has changed since.
    folder.write("room-run.yaml", edited(&scenario(), "particles: 100", "particles: 101"));
    folder.locsim("merge o").code(2).stderr(contains("isn't what the shards were run with"));
    folder.write("room-run.yaml", scenario());
    let trials = folder.path("o/shard-00002-of-00003/trials.cbor");
    let bytes = fs::read(&trials).unwrap();
    fs::write(&trials, &bytes[..bytes.len() / 2]).unwrap();
    folder.locsim("merge o").code(2).stderr(contains("trials.cbor was cut or changed"));
    fs::write(&trials, bytes).unwrap();
    folder.locsim("merge o --record none --quiet").success();
    // More shards than trials; an engine's variables.
    folder
        .locsim("run room-run.yaml --shard 1/4")
        .code(2)
        .stderr(contains("4 shards of 3 trials are not allowed"));
    let mut command = locsim(&folder.path("."), "run room-run.yaml --models classic --out p --shards 3");
    command.env("HQ_TASK_ID", "2").assert().success().stdout(contains("shard 2 of 3: 1 trials in p"));
}

#[test]
fn a_merge_refuses_what_is_not_one_sweep_and_says_how_to_mend_it() {
    let folder = folder();
    run_shards(&folder, 3, "o");
    let whole = results(&folder.path("o"));
    let refused = |told: &[&str]| {
        let call = folder.locsim("merge o").code(2);
        let error = String::from_utf8(call.get_output().stderr.clone()).unwrap();
        for told in told {
            assert!(error.contains(told), "{told:?} in {error}");
        }
        assert!(!folder.path("o/merged").exists());
        error
    };
    let [first, second] = ["o/shard-00001-of-00003", "o/shard-00002-of-00003"].map(|name| folder.path(name));

    // A gap.
    fs::rename(&second, folder.path("aside")).unwrap();
    let again = "locsim sweep s.yaml --out o --shard 2/3";
    let error = refused(&["1 of 3 shards are missing: 2; run them:", again]);
    assert!(error.trim_end().ends_with(again), "{error}");
    folder.locsim(again.strip_prefix("locsim ").unwrap()).success();
    assert!(
        whole["shard-00002-of-00003/trials.parquet".as_ref() as &Path]
            == folder.read("o/shard-00002-of-00003/trials.parquet")
    );

    // A double.
    fs::rename(folder.path("aside"), folder.path("o/shard-copy")).unwrap();
    refused(&["shard 2 of 3 is there twice: o/shard-00002-of-00003 and o/shard-copy; remove one of them"]);
    fs::remove_dir_all(folder.path("o/shard-copy")).unwrap();

    // Another seed, and another number of shards.
    folder.locsim("sweep s.yaml --out o --shard 2/3 --seed 6 --force --quiet").success();
    refused(&["o/shard-00002-of-00003 is of another sweep: its digest", "--shard 2/3"]);
    folder.locsim("sweep s.yaml --out o --shard 2/3 --force --quiet").success();
    folder.locsim("sweep s.yaml --out o --shard 2/4 --quiet").success();
    refused(&["o/shard-00002-of-00004 is of another sweep: it is one of 4 shards, not of 3"]);
    fs::remove_dir_all(folder.path("o/shard-00002-of-00004")).unwrap();

    // Another map in the same place.
    let map = String::from_utf8(folder.read("room.yaml")).unwrap();
    folder.write("room.yaml", edited(&map, "[3.2, 2]", "[3.2, 2.1]"));
    folder.locsim("sweep s.yaml --out o --shard 2/3 --force --quiet").success();
    refused(&["o/shard-00002-of-00003 is of another sweep: it read another content of room.yaml"]);
    folder.write("room.yaml", map);
    folder.locsim("sweep s.yaml --out o --shard 2/3 --force --quiet").success();

    // A truncated Parquet.
    let trials = first.join("trials.parquet");
    let bytes = fs::read(&trials).unwrap();
    fs::write(&trials, &bytes[..bytes.len() / 2]).unwrap();
    refused(&[
        "o/shard-00001-of-00003/trials.parquet was cut or changed since it was written",
        "1 of 3 shards are missing: 1; run them:\n  rm -r o/shard-00001-of-00003\n  locsim sweep s.yaml --out o --shard 1/3",
    ]);
    // A summary that somebody edited: the plan isn't one, or there are more shards than any memory holds.
    fs::write(&trials, &bytes).unwrap();
    let summary = fs::read_to_string(first.join("shard.json")).unwrap();
    let mut value: Value = serde_json::from_str(&summary).unwrap();
    for (path, other, told) in [
        ("/sweep/plan/groups/0/0", json!(7), "has axes that don't belong together"),
        ("/sweep/plan/axes/0/values", json!([]), "has axes that don't belong together"),
        ("/shard/of", json!(u32::MAX), "says that 4294967295 shards are not allowed; at most 100000"),
        ("/shard/number", json!(4), "says that shard 4 of 3 is not there"),
        ("/first_cell", json!(1), "has the cells 1..3, which aren't those of shard 1 of 3"),
    ] {
        let before = std::mem::replace(value.pointer_mut(path).unwrap(), other);
        fs::write(first.join("shard.json"), value.to_string()).unwrap();
        refused(&[told]);
        *value.pointer_mut(path).unwrap() = before;
    }
    fs::write(first.join("shard.json"), summary).unwrap();
    fs::write(&trials, &bytes[..bytes.len() / 2]).unwrap();
    // Nor does the shard itself take a truncated file for done.
    folder.locsim("sweep s.yaml --out o --shard 1/3").code(2).stderr(contains("was cut or changed"));
    fs::remove_dir_all(&first).unwrap();
    folder.locsim("sweep s.yaml --out o --shard 1/3 --quiet").success();
    folder.locsim("merge o --quiet").success();
    folder.locsim("merge o").code(2).stderr(contains("it isn't empty"));
    folder.locsim("merge absent").code(2).stderr(contains("absent is not allowed; nothing is there"));
    fs::create_dir(folder.path("empty")).unwrap();
    folder.locsim("merge empty").code(2).stderr(contains("empty: there is no whole shard"));
}

#[test]
fn a_dry_run_counts_and_runs_nothing() {
    let folder = folder();
    let told = output(&folder.locsim("sweep s.yaml --out o --dry-run").success());
    assert!(told.starts_with("room-sweep: 6 cells; about ") && told.contains("of memory"), "{told}");
    assert!(!folder.path("o").exists());
    folder.locsim("validate s.yaml").success().stdout(contains("s.yaml: valid (sweep, 6 cells; about"));
    let schema: Value = serde_json::from_str(&output(&folder.locsim("schema --sweep").success())).unwrap();
    assert_eq!(schema["title"], "locsim sweep");
}

/// 10^9 cells are refused at once, 10^12 with --yes too.
#[test]
fn a_slip_in_a_range_does_not_start_a_billion_runs() {
    let folder = folder();
    let range = "{from: 1, to: 1000, step: 1}";
    let axes = format!("{SWEEP}  laser.beams: {range}\n")
        .replace("blocks.per_metre_of_wall: [0.0, 0.3]", &format!("training.observations: {range}"));
    folder.write("large.yaml", axes.replace("{from: 40, to: 80, step: 20}", range));
    folder.locsim("sweep large.yaml --out o").code(2).stderr(contains(
        "large.yaml: 1000000000 cells (1000 x 1000 x 1000) are not allowed; at most 10000, or more with --yes",
    ));
    folder.locsim("sweep large.yaml --dry-run").success().stdout(contains("1000000000 cells; about"));
    let more = format!("{}  laser.rate_hz: {range}\n", String::from_utf8(folder.read("large.yaml")).unwrap());
    folder.write("larger.yaml", more);
    folder.locsim("sweep larger.yaml --out o --yes").code(2).stderr(contains(
        "larger.yaml:5: axes: 1000 x 1000 x 1000 x 1000 cells are not allowed; at most 2147483648",
    ));
    assert!(!folder.path("o").exists());
}

#[test]
fn bad_sweeps_are_refused_with_line_and_key() {
    let folder = folder();
    for (from, to, told) in [
        ("filter.particles:", "filter.partcles:", "s.yaml:7: axes.filter.partcles: "),
        ("filter.particles:", "filter.partcles:", "did you mean `particles`?"),
        (
            "filter.particles: {from: 40, to: 80, step: 20}",
            "filter.particles: [40, 0]",
            "s.yaml:7: axes.filter.particles: 0 is not allowed; a whole number from 1 to 10000000",
        ),
        (
            "filter.particles:",
            "seed.low:",
            "s.yaml:7: axes.seed.low: the scenario has no map there to hold `low`",
        ),
        (
            "filter.particles:",
            "models[2].floor:",
            "`models` has 2 elements in the scenario; [2] is not among them",
        ),
        (
            "[0.0, 0.3]",
            "[]",
            "s.yaml:6: axes.blocks.per_metre_of_wall: an empty list is not allowed; at least one value",
        ),
        ("[0.0, 0.3]", "[0.3, 0.30]", "s.yaml:6: axes.blocks.per_metre_of_wall[1]: 0.3 stands twice"),
        (
            "[0.0, 0.3]",
            "0.3",
            "s.yaml:6: axes.blocks.per_metre_of_wall: 0.3 is not allowed; a list of values",
        ),
        ("to: 80, step: 20", "to: 80", "s.yaml:7: axes.filter.particles: either `step` or `count` is needed"),
        (
            "to: 80, step: 20",
            "to: 80, step: 0",
            "axes.filter.particles.step: 0 is not allowed; a number above 0",
        ),
        (
            "to: 80, step: 20",
            "to: 30, step: 20",
            "axes.filter.particles.to: 30 is not allowed; a number above 40",
        ),
        (
            "to: 80, step: 20",
            "to: 42, count: 9",
            "axes.filter.particles.count: 9 is not allowed; there are fewer whole numbers",
        ),
        (
            "from: 40, to: 80, step: 20",
            "from: 0, to: 80, count: 3, log: true",
            "axes.filter.particles.from: 0 is not allowed with `log`",
        ),
        ("trials: 2", "trials: 0", "s.yaml:4: trials: 0 is not allowed"),
        (
            "room-run.yaml",
            "absent.yaml",
            "s.yaml:2: scenario: `absent.yaml` is not allowed; there is no file",
        ),
        ("trials: 2", "where: [filter.particles < 40]", "s.yaml:4: where: the conditions leave no cell"),
        (
            "trials: 2",
            "where: [filter.particles 40]",
            "where[0]: `filter.particles 40` is not allowed; AXIS SIGN AXIS-OR-VALUE",
        ),
        ("trials: 2", "where: [filter.partcles < 40]", "did you mean `filter.particles`?"),
        (
            "trials: 2",
            "zip: [[blocks.per_metre_of_wall, filter.particles]]",
            "s.yaml:4: zip[0]: axes of different lengths (2, 3)",
        ),
        ("trials: 2", "zip: [[filter.particles]]", "zip[0]: at least two axes are needed"),
        (
            "filter.particles: {",
            "blocks: [{}]\n  filter.particles: {",
            "axes.blocks.per_metre_of_wall: the axis is not allowed beside `blocks`",
        ),
        ("trials: 2", "template: make", "template: a text without {command} or {arguments} is not allowed"),
        ("trials: 2", "colour: red", "did you mean"),
    ] {
        folder.write("s.yaml", edited(SWEEP, from, to));
        let call = folder.locsim("sweep s.yaml --out o").code(2);
        let error = String::from_utf8(call.get_output().stderr.clone()).unwrap();
        assert!(
            error.contains(told) || told == "did you mean" && error.contains("`colour` is not a key"),
            "{to}: {error}"
        );
        assert!(!folder.path("o").exists(), "{to}");
    }
    // No axes at all.
    folder.write("s.yaml", SWEEP.split("axes:").next().unwrap().to_owned() + "axes: {}\n");
    folder.locsim("sweep s.yaml").code(2).stderr(contains("s.yaml:5: axes: no axes are not allowed"));
}

#[test]
fn a_shard_outside_its_range_is_refused() {
    let folder = folder();
    for (shard, told) in [
        ("0/3", "shard 0 of 3 is not there"),
        ("4/3", "shard 4 of 3 is not there"),
        ("1-3", "I/N is allowed, such as 3/50"),
        ("1/7", "--shard: 7 shards of 6 cells are not allowed"),
    ] {
        folder.locsim(&format!("sweep s.yaml --out o --shard {shard}")).code(2).stderr(contains(told));
        assert!(!folder.path("o").exists(), "{shard}");
    }
}
