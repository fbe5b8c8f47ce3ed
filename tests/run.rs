//! `locsim run` as a user types it: what it prints, what it leaves, and what changes its results and what doesn't.

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use common::{Folder, SCENARIO, edited, output};
use predicates::prelude::*;
use predicates::str::{contains, is_empty};
use serde_json::Value;

/// Files under a folder by relative path.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() {
            found.extend(
                files(&path).into_iter().map(|(inner, content)| (format!("{name}/{inner}"), content)),
            );
        } else {
            found.insert(name, fs::read(&path).unwrap());
        }
    }
    found
}

/// Rows of a CSV table whose first cells satisfy a condition.
fn rows(table: &[u8], keep: impl Fn(&[&str]) -> bool) -> Vec<String> {
    let lines = std::str::from_utf8(table).unwrap().lines().skip(1);
    lines.filter(|line| keep(&line.split(',').collect::<Vec<_>>())).map(str::to_owned).collect()
}

/// A summary without what a repeated run doesn't reproduce.
fn timeless(summary: &[u8]) -> Value {
    let mut summary: Value = serde_json::from_slice(summary).unwrap();
    summary["seconds"].take();
    for model in summary["models"].as_object_mut().unwrap().values_mut() {
        model["step_ms"].take();
    }
    summary
}

#[test]
fn a_run_prints_a_table_and_leaves_every_documented_file_and_figure() {
    let folder = Folder::new();
    folder.write("room-run.yaml", edited(SCENARIO, "models: [classic,", "models: [oracle, classic,"));
    let models = ["oracle", "classic", "np_reg_registered"];
    let run = folder.locsim("run room-run.yaml --out results/room").success();
    let table = output(&run);
    for word in models.into_iter().chain(["RMSE [m]", "lost [%]", "results/room/recording.rrd"]) {
        assert!(table.contains(word), "{word} is not in\n{table}");
    }

    let found = files(&folder.path("results/room"));
    let starts = |name: &str, magic: &[u8]| {
        let content = found.get(name).unwrap_or_else(|| panic!("no {name} in {:?}", found.keys()));
        assert!(
            content.starts_with(magic),
            "{name} begins with {:?}",
            &content[..magic.len().min(content.len())]
        );
    };
    starts("steps.csv", b"trial,model,step,stamp_secs,");
    starts("trials.csv", b"trial,seed,model,steps,lost,");
    starts("steps.parquet", b"PAR1");
    starts("trials.parquet", b"PAR1");
    starts("report.md", b"# ");
    starts("report.html", b"<!doctype html>");
    starts("recording.rrd", b"RRF2");
    let figures: Vec<&str> =
        found.keys().filter_map(|name| name.strip_prefix("figures/")?.strip_suffix(".svg")).collect();
    for name in ["trajectories", "rmse", "filter_snapshots", "predicted_densities"] {
        assert!(figures.contains(&name), "no figure {name} in {figures:?}");
    }
    for name in figures {
        starts(&format!("figures/{name}.svg"), b"<svg");
        starts(&format!("figures/{name}.png"), b"\x89PNG");
    }
    for name in ["classic", "np_reg_registered"] {
        assert!(found.contains_key(&format!("models/{name}.model")), "no saved {name}");
    }
    let estimates = models.map(|model| format!("{model}-estimate"));
    for name in
        models.into_iter().chain(["reference", "odometry"]).chain(estimates.iter().map(String::as_str))
    {
        let text = std::str::from_utf8(&found[&format!("trajectories/{name}.tum")]).unwrap();
        let poses: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
        assert_eq!(poses.len(), 21, "{name}: a scan every 0.2 s over 2 m at 0.5 m/s");
        for pose in poses {
            let numbers = pose.split(' ').filter(|field| field.parse::<f64>().is_ok_and(f64::is_finite));
            assert_eq!(numbers.count(), 8, "{name}: {pose}");
        }
    }
    assert_eq!(rows(&found["trials.csv"], |_| true).len(), 3 * 3);
    assert_eq!(rows(&found["steps.csv"], |_| true).len(), 3 * 3 * 21);
    assert_eq!(fs::read_dir(folder.path("results")).unwrap().count(), 1, "nothing but the results is left");

    let summary: Value = serde_json::from_slice(&found["summary.json"]).unwrap();
    assert_eq!(summary["scenario"], "room");
    assert_eq!(summary["seed"], 3);
    assert_eq!(summary["trials"], 3);
    assert!(summary["seconds"].as_f64().unwrap() > 0.0);
    let number = |pointer: &str| {
        let value = summary.pointer(pointer).and_then(Value::as_f64);
        value.unwrap_or_else(|| panic!("{pointer} is not a number in {summary:#}"))
    };
    for model in models {
        let figures = "lost_share position_rmse_m position_median_m position_p95_m along/mean_m along/std_m \
                       across/mean_m across/std_m heading/mean_rad heading/std_rad ess_mean nees_mean \
                       nees_with_shared_errors_mean step_ms train/log_loss_nats train/histogram_match_m";
        for figure in figures.split_whitespace() {
            number(&format!("/models/{model}/{figure}"));
        }
        for ratio in ["position_std_vs_classic", "rmse_vs_classic", "rmse_vs_oracle"] {
            let [value, lo, hi] =
                ["value", "lo", "hi"].map(|end| number(&format!("/ratios/{model}/{ratio}/{end}")));
            assert!(lo <= value && value <= hi, "{model} {ratio}: {value} is not within [{lo}, {hi}]");
        }
        // The start alone is uncertain by 0.1 m; every scan sees walls on all sides with 0.02 m noise.
        assert!(number(&format!("/models/{model}/position_rmse_m")) < 0.1, "{model} doesn't localize");
    }
    assert_eq!(number("/ratios/classic/rmse_vs_classic/value"), 1.0);
    assert_eq!(number("/ratios/oracle/rmse_vs_oracle/value"), 1.0);
}

/// Positions and stamps of a trajectory.
fn trajectory(file: &[u8]) -> Vec<[f64; 3]> {
    let lines = std::str::from_utf8(file).unwrap().lines().filter(|line| !line.starts_with('#'));
    let numbers = |line: &str| -> Vec<f64> { line.split(' ').map(|field| field.parse().unwrap()).collect() };
    lines.map(|line| numbers(line)[..3].try_into().unwrap()).collect()
}

/// The root of the mean squared distance, as `evo_ape tum reference.tum MODEL-estimate.tum` gives it: no alignment.
#[test]
fn the_absolute_pose_error_of_the_trajectories_is_the_tables() {
    let folder = Folder::new();
    for estimate in ["weighted_mean", "max_weight", "most_likely_trajectory"] {
        let scenario = edited(SCENARIO, "filter:\n", &format!("filter:\n  estimate: {estimate}\n"));
        folder.write("room-run.yaml", edited(&scenario, "trials: 3", "trials: 1"));
        folder.locsim("run room-run.yaml --out o --force --quiet --record none").success();
        let summary: Value = serde_json::from_slice(&folder.read("o/summary.json")).unwrap();
        let reference = trajectory(&folder.read("o/trajectories/reference.tum"));
        for model in ["classic", "np_reg_registered"] {
            let file = format!("o/trajectories/{model}-estimate.tum");
            let estimates = trajectory(&folder.read(&file));
            assert_eq!(estimates.len(), reference.len());
            let square = |(a, b): (&[f64; 3], &[f64; 3])| {
                assert_eq!(a[0], b[0], "the same stamps");
                (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)
            };
            let sum: f64 = estimates.iter().zip(&reference).map(square).sum();
            let rmse = (sum / reference.len() as f64).sqrt();
            let table = summary["models"][model]["position_rmse_m"].as_f64().unwrap();
            assert!((rmse - table).abs() < 1e-9, "{model}, {estimate}: {rmse} and {table}");
        }
    }
}

#[test]
fn a_terminal_of_80_columns_shows_whole_tables() {
    let folder = Folder::new();
    let line = "run room-run.yaml --out o --record none";
    let run = common::locsim(&folder.path(""), line).env("COLUMNS", "80").assert().success();
    let table = output(&run);
    let rows: Vec<&str> = table.lines().take_while(|line| !line.starts_with("mean ±")).collect();
    assert!(rows.len() > 10 && rows.iter().all(|row| row.chars().count() <= 80), "{table}");
    assert!(["p95", "RMSE", "ms/step", "/ classic"].iter().all(|word| table.contains(word)), "{table}");
    let wide = output(&folder.locsim(&format!("{line} --force")).success());
    assert!(wide.lines().any(|row| row.chars().count() > 100), "the control\n{wide}");
}

#[test]
fn the_number_of_threads_changes_no_bit_of_the_results() {
    let folder = Folder::new();
    // Beside the filters: KLD-adaptive counts, random particles, and the oracle's integration over blocks.
    let scenario = edited(SCENARIO, "models: [classic,", "models: [oracle, classic,");
    let scenario = edited(&scenario, "particles: 100", "particles: {kld: {min: 60, max: 400}}");
    let scenario =
        edited(&scenario, "filter:\n", "filter:\n  injection: {alpha_slow: 0.01, alpha_fast: 0.2}\n");
    folder.write("room-run.yaml", scenario);
    let [one, two, eight] = [1, 2, 8].map(|threads| {
        let out = format!("threads-{threads}");
        folder.locsim(&format!("run room-run.yaml --quiet --out {out} --threads {threads}")).success();
        let mut found = files(&folder.path(&out));
        let summary = timeless(&found.remove("summary.json").unwrap());
        // The report quotes wall times; a recording has an identity of its own; the manifest has hashes of both.
        let changing = ["report.md", "report.html", "recording.rrd", "manifest.json"];
        found.retain(|name, _| !changing.contains(&name.as_str()));
        assert!(found.len() > 15, "{:?}", found.keys());
        (summary, found)
    });
    for other in [two, eight] {
        assert_eq!(one.0, other.0);
        assert!(one.1.keys().eq(other.1.keys()));
        for (name, content) in &one.1 {
            assert!(*content == other.1[name], "{name} depends on the number of threads");
        }
    }
}

#[test]
fn seed_trials_and_models_of_the_command_line_change_just_what_they_say() {
    let folder = Folder::new();
    let steps = |options: &str| {
        folder
            .locsim(&format!("run room-run.yaml --out o --force --quiet --record none {options}"))
            .success();
        folder.read("o/steps.csv")
    };
    let plain = steps("");
    assert_eq!(plain, steps("--seed 3"), "the scenario's own seed");

    let reseeded = steps("--seed 4");
    assert_eq!(rows(&reseeded, |_| true).len(), rows(&plain, |_| true).len());
    assert_ne!(plain, reseeded);

    let fewer = steps("--trials 2");
    assert_eq!(rows(&fewer, |_| true), rows(&plain, |cells| cells[0] != "2"), "trials 0 and 1 stay the same");

    // Which other models run beside it changes nothing for a model.
    let alone = steps("--models np_reg_registered");
    assert_eq!(rows(&alone, |_| true), rows(&plain, |cells| cells[1] == "np_reg_registered"));
    let summary: Value = serde_json::from_slice(&folder.read("o/summary.json")).unwrap();
    assert_eq!(summary["models"].as_object().unwrap().keys().collect::<Vec<_>>(), ["np_reg_registered"]);
    assert!(summary.pointer("/ratios/np_reg_registered/rmse_vs_classic").unwrap().is_null());
    assert_eq!(summary.pointer("/ratios/np_reg_registered/rmse_vs_first"), None, "it is alone");
}

#[test]
fn json_prints_the_summary_quiet_prints_nothing_and_no_recording_is_left_when_none_is_asked_for() {
    let folder = Folder::new();
    let options = "--models classic --record none";
    let run = folder.locsim(&format!("run room-run.yaml --out a {options} --json")).success();
    let printed: Value = serde_json::from_str(&output(&run)).unwrap();
    assert_eq!(printed, serde_json::from_slice::<Value>(&folder.read("a/summary.json")).unwrap());

    folder
        .locsim(&format!("run room-run.yaml --out b {options} --quiet"))
        .success()
        .stdout(is_empty())
        .stderr(is_empty());
    let run = folder.locsim(&format!("run room-run.yaml {options} --quiet --json")).success();
    serde_json::from_str::<Value>(&output(&run)).unwrap();
    assert!(folder.path("results/room/summary.json").exists(), "the default folder has the scenario's name");

    folder
        .locsim(&format!("run room-run.yaml --out b {options} --force"))
        .success()
        .stdout(contains("recording.rrd").not());
    assert!(!folder.path("b/recording.rrd").exists());
    assert!(folder.path("b/report.html").exists());
}

#[test]
fn results_are_complete_when_the_recording_fails() {
    let folder = Folder::new();
    // No viewer can be found to start.
    common::locsim(&folder.path("."), "run room-run.yaml --out o --models classic --quiet --record spawn")
        .env("PATH", "")
        .assert()
        .code(2)
        .stdout(is_empty())
        .stderr(contains("error: the results are in o, but the recording failed: "));
    assert!(folder.path("o/report.html").exists() && folder.path("o/summary.json").exists());
    assert!(!folder.path("o.partial").exists());
}

#[test]
fn a_missed_bound_gives_exit_code_1_and_complete_results() {
    let folder = Folder::new();
    let bound = |text: &str| format!("{SCENARIO}expect:\n  classic: {text}\n");
    folder.write("missed.yaml", bound("{position_rmse_m: {max: 0.0001}, ess_mean: {min: 1}}"));
    folder
        .locsim("run missed.yaml --out missed --models classic --quiet")
        .code(1)
        .stdout(is_empty())
        .stderr(contains("missed: classic.position_rmse_m is 0.").and(contains("expected at most 0.0001")))
        .stderr(contains("ess_mean").not());
    assert!(folder.path("missed/report.html").exists());
    assert!(folder.path("missed/recording.rrd").exists());

    folder.write("kept.yaml", bound("{position_rmse_m: {max: 0.3, min: 0.0001}}"));
    folder.locsim("run kept.yaml --out kept --models classic --quiet --trials 1").code(0);
}

#[test]
fn what_nobody_documented_is_refused_with_exit_code_2() {
    let folder = Folder::new();
    for line in [
        "",
        "run",
        "drive room-run.yaml",
        "run room-run.yaml --particles 3",
        "run room-run.yaml --trials many",
        "run room-run.yaml --seed -1",
        "run room-run.yaml --record tape",
        "validate",
        "simulate room-run.yaml",
    ] {
        folder.locsim(line).code(2).stdout(is_empty());
    }
    assert!(!folder.path("results").exists());
}

#[test]
fn a_saved_model_gives_the_same_trials_as_fitting_it() {
    let folder = Folder::new();
    folder.locsim("run room-run.yaml --out fitted --quiet --record none").success();
    let from_file = |name: &str| format!("{{name: {name}, file: fitted/models/{name}.model}}");
    let models = format!("models: [{}, {}]", from_file("classic"), from_file("np_reg_registered"));
    folder.write("saved.yaml", edited(SCENARIO, "models: [classic, np_reg_registered]", &models));
    folder.locsim("run saved.yaml --out saved --quiet --record none").success();
    for table in ["steps.csv", "trials.csv"] {
        assert_eq!(
            folder.read(&format!("fitted/{table}")),
            folder.read(&format!("saved/{table}")),
            "{table}"
        );
    }

    // The file is what counts: a model of other data gives other trials.
    folder.locsim("run room-run.yaml --out fitted --seed 4 --force --quiet --record none").success();
    folder.locsim("run saved.yaml --out saved --force --quiet --record none").success();
    folder.locsim("run room-run.yaml --out fitted --force --quiet --record none").success();
    assert_ne!(folder.read("fitted/trials.csv"), folder.read("saved/trials.csv"));
}

#[test]
fn bad_input_and_a_folder_of_someone_else_change_nothing() {
    let folder = Folder::new();
    folder.locsim("run room-run.yaml --out o --models classic --quiet --record none").success();
    let before = files(&folder.path("o"));
    folder.write("bad.yaml", edited(SCENARIO, "particles: 100", "particles: 0"));
    folder.locsim("run bad.yaml --out o").code(2);
    folder.write("bad.model", "not a model");
    folder.write(
        "bad.yaml",
        edited(SCENARIO, "[classic, np_reg_registered]", "[{name: classic, file: bad.model}]"),
    );
    folder.locsim("run bad.yaml --out o").code(2);
    assert_eq!(files(&folder.path("o")), before);
    assert!(!folder.path("o.partial").exists(), "no trial was run");

    fs::create_dir(folder.path("thesis")).unwrap();
    folder.write("thesis/thesis.tex", "precious");
    for place in ["thesis", "thesis/thesis.tex", ".", ".."] {
        for option in ["", "--force", "--resume"] {
            folder
                .locsim(&format!("run room-run.yaml --models classic --out {place} {option}"))
                .code(2)
                .stderr(contains(format!("--out: {place} is not allowed; ")));
        }
    }
    assert_eq!(
        files(&folder.path("thesis")),
        BTreeMap::from([("thesis.tex".to_owned(), b"precious".to_vec())])
    );
}

/// Signals are sent by the shell's `kill`.
#[cfg(unix)]
mod interrupted {
    use super::*;
    use std::process::{Command, Stdio};
    use std::thread::sleep;
    use std::time::Duration;

    /// A run of some seconds on one thread.
    const LONG: &str = "run long.yaml --models classic --record none --quiet --out o";

    fn trials_kept(folder: &Folder) -> usize {
        let Ok(entries) = fs::read_dir(folder.path("o.partial/parts")) else { return 0 };
        let paths = entries.map(|entry| entry.unwrap().path());
        paths.filter(|path| path.extension().is_some_and(|extension| extension == "part")).count()
    }

    #[test]
    fn a_run_keeps_finished_trials_and_resume_completes_it_as_if_nothing_had_happened() {
        let folder = Folder::new();
        let long = edited(SCENARIO, "trials: 3", "trials: 120");
        folder.write("long.yaml", edited(&long, "particles: 100", "particles: 2000"));
        folder.locsim(LONG).success();
        let whole = files(&folder.path("o"));

        let child = Command::new(env!("CARGO_BIN_EXE_locsim"))
            .args(LONG.split(' ').chain(["--threads", "1", "--force"]))
            .current_dir(folder.path("."))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // A minute at the most: a program that never gets there fails the test.
        let reached = (0..6000).any(|_| {
            sleep(Duration::from_millis(10));
            trials_kept(&folder) >= 3
        });
        assert!(reached, "no trial was kept");
        let kill = Command::new("sh").arg("-c").arg(format!("kill -INT {}", child.id())).status().unwrap();
        assert!(kill.success());
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(130), "{message}");

        let kept = trials_kept(&folder);
        assert!((3..120).contains(&kept), "{kept}");
        assert!(
            message.contains(&format!("{kept} ")) && message.contains("; add --resume to go on"),
            "{message}"
        );
        assert_eq!(files(&folder.path("o")), whole, "earlier results stay as they were");

        // Neither a new run nor one of something else takes them away.
        folder.locsim(LONG).code(2).stderr(contains("it isn't empty"));
        folder.locsim(&format!("{LONG} --resume --seed 9")).code(2).stderr(contains("it isn't empty"));
        assert_eq!(trials_kept(&folder), kept);

        // A kept trial with a flipped bit is run again, and that is said.
        let part = "o.partial/parts/000001.part";
        let mut bytes = folder.read(part);
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        folder.write(part, bytes);
        folder
            .locsim(&format!("{LONG} --resume"))
            .success()
            .stderr(contains("note: trial 1 was kept, but its file is damaged; it is run again\n"));
        let resumed = files(&folder.path("o"));
        for name in ["steps.csv", "steps.parquet", "trials.csv", "trials.parquet"] {
            assert!(resumed[name] == whole[name], "{name} differs from that of an uninterrupted run");
        }
        assert_eq!(timeless(&resumed["summary.json"]), timeless(&whole["summary.json"]));
        assert!(!folder.path("o.partial").exists());
    }
}
