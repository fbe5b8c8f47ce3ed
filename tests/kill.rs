//! Commands that are killed at any moment and then repeated leave what an undisturbed one leaves, byte for byte, and
//! never half of a file in the place of a whole one.

#![cfg(unix)]

#[allow(dead_code, reason = "the calls of the other tests aren't needed here")]
mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::Instant;

use common::{Folder, SCENARIO, edited};
use locsim_core::{Draw, Stage};
use serde_json::Value;

/// Kills of each of the five commands: half of them spread over the time that it takes, half of them while it writes.
const KILLS: u32 = 4;

/// A kill while writing comes at one of so many first changes of the folder.
const CHANGES: u64 = 10;

/// A command that writes results.
struct Case {
    /// Everything of the command line but the place of the results.
    line: &'static str,
    /// A command line with other results, so that there is something to replace.
    other: &'static str,
    /// Where the results are written to.
    out: &'static str,
    /// The content to write.
    results: &'static [&'static str],
    /// Whether the command keeps what it has finished, and goes on with `--resume`.
    resumes: bool,
}

const CASES: [Case; 5] = [
    Case {
        line: "run room-run.yaml --quiet",
        other: "run room-run.yaml --quiet --seed 4 --trials 1 --record none",
        out: "results/room",
        results: &["results/room"],
        resumes: true,
    },
    Case {
        line: "gap nominal.yaml --log measured.log --replicates 19 --scans 60 --beams 12 --no-filter --quiet",
        other: "gap nominal.yaml --log measured.log --replicates 19 --scans 40 --beams 4 --no-filter --quiet",
        out: "results/gap",
        results: &["results/gap"],
        resumes: false,
    },
    Case {
        line: "study lawn.yaml --quiet",
        other: "study lawn.yaml --quiet --seed 4 --quick",
        out: "results",
        results: &["results/lawn"],
        resumes: true,
    },
    Case {
        line: "map measured.log --resolution 0.004",
        other: "map measured.log --resolution 0.1",
        out: "floor",
        results: &["floor.pgm", "floor.yaml", "floor.walls.yaml", "floor.check.svg"],
        resumes: false,
    },
    Case {
        line: "simulate long.yaml",
        other: "simulate nominal.yaml",
        out: "long.mcap",
        results: &["long.mcap"],
        resumes: false,
    },
];

const STUDY: &str = "\
name: lawn
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

/// A simulation whose readings are too long, and the one in which they aren't.
fn scenarios() -> [String; 3] {
    let noisy =
        edited(SCENARIO, "training:", "effects: [{name: range_dropout, p: 0.005, exponent: 0}]\ntraining:");
    let noisy = edited(&noisy, "rate_hz: 5, beams: 12", "rate_hz: 20, beams: 24");
    let hidden = edited(&noisy, "exponent: 0}]", "exponent: 0}, {name: range_bias, bias_m: 0.04}]");
    let long = edited(&noisy, "rate_hz: 20, beams: 24", "rate_hz: 500, beams: 360");
    [noisy, hidden, long]
}

/// A folder with everything that the commands read.
fn folder() -> Folder {
    let folder = Folder::new();
    let [nominal, hidden, long] = scenarios();
    folder.write("nominal.yaml", nominal);
    folder.write("hidden.yaml", hidden);
    folder.write("long.yaml", long);
    folder.write("lawn.yaml", STUDY);
    folder.locsim("simulate hidden.yaml --seed 11 --out measured.log").success();
    folder
}

/// Files under a path by relative path, without what a repeated command doesn't reproduce: times, and a recording's
/// identity.
fn content(folder: &Folder, results: &[impl AsRef<str>]) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for result in results {
        let result = result.as_ref();
        // Earlier results keep their names where they stand beside their place.
        collect(&folder.path(result), result.trim_end_matches(".old"), &mut found);
    }
    found
}

fn collect(path: &Path, name: &str, found: &mut BTreeMap<String, Vec<u8>>) {
    if let Ok(entries) = fs::read_dir(path) {
        for entry in entries.map(Result::unwrap) {
            collect(&entry.path(), &format!("{name}/{}", entry.file_name().to_str().unwrap()), found);
        }
    } else if let Ok(content) = fs::read(path) {
        found.insert(name.to_owned(), timeless(name, content));
    }
}

/// Names of results that are replaced, while they are.
fn beside(results: &[&str]) -> Vec<String> {
    results.iter().map(|result| format!("{result}.old")).collect()
}

fn is_a(name: &str, extension: &str) -> bool {
    Path::new(name).extension().is_some_and(|found| found == extension)
}

/// Whether a file tells times, or what only one recording is.
fn tells_time(name: &str) -> bool {
    let name = name.rsplit('/').next().unwrap();
    name.starts_with("report.")
        || is_a(name, "rrd")
        || ["summary.json", "gap.json", "times.csv"].contains(&name)
}

fn timeless(name: &str, content: Vec<u8>) -> Vec<u8> {
    if !is_a(name, "json") {
        return if tells_time(name) { Vec::new() } else { content };
    }
    let mut json: Value = serde_json::from_slice(&content).unwrap_or_else(|error| panic!("{name}: {error}"));
    without_times(&mut json);
    json.to_string().into_bytes()
}

/// Takes out wall times, and hashes of files that tell them.
fn without_times(json: &mut Value) {
    match json {
        Value::Object(map) => {
            map.retain(|key, _| !["seconds", "step_ms"].contains(&key.as_str()));
            for (key, value) in map {
                if tells_time(key) {
                    *value = Value::Null;
                }
                without_times(value);
            }
        }
        Value::Array(list) => list.iter_mut().for_each(without_times),
        _ => (),
    }
}

/// The program with the words of a command line.
fn command(folder: &Folder, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_locsim"));
    command.args(line.split_whitespace()).current_dir(folder.path("."));
    command.env("LOCSIM_CACHE", folder.path(".cache")).env_remove("LOCSIM_DATA");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn succeeds(folder: &Folder, line: &str) -> Output {
    let output = command(folder, line).output().unwrap();
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Every file below a folder with its size.
fn listing(folder: &Path, found: &mut Vec<(PathBuf, u64)>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            listing(&path, found);
        } else {
            let size = entry.metadata().map_or(0, |found| found.len());
            found.push((path, size));
        }
    }
}

/// Waits until the files below a folder have changed so often, or the process has ended.
fn wait_for_changes(child: &mut Child, folder: &Path, changes: u64) {
    let list = || {
        let mut found = Vec::new();
        listing(folder, &mut found);
        found.sort();
        found
    };
    let mut last = list();
    let mut seen = 0;
    while seen < changes && child.try_wait().unwrap().is_none() {
        let now = list();
        if now != last {
            (last, seen) = (now, seen + 1);
        }
    }
}

#[expect(clippy::disallowed_methods, reason = "moments are spread over the time that the command takes")]
fn now() -> Instant {
    Instant::now()
}

#[test]
fn a_killed_command_is_repeated_as_if_nothing_had_happened() {
    for (number, case) in CASES.iter().enumerate() {
        let Case { line, other, out, results, resumes } = case;
        let folder = folder();
        let there = |line: &str| format!("{line} --out {out}");
        succeeds(&folder, &there(other));
        let old = content(&folder, results);
        let start = now();
        succeeds(&folder, &there(&format!("{line} --force")));
        let whole_time = now() - start;
        let new = content(&folder, results);
        assert!(old != new && !new.is_empty(), "{line}: there is nothing to compare");

        for kill in 0..KILLS {
            let earlier = kill % 2 == 0;
            for result in *results {
                let path = folder.path(result);
                let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
                removed.unwrap();
            }
            if earlier {
                succeeds(&folder, &there(other));
                assert_eq!(content(&folder, results), old, "{line}");
            }
            let force = if earlier { "--force" } else { "" };

            let draw = Draw::new(17, Stage::Trial, number as u32).seed(kill);
            let mut child = command(&folder, &there(&format!("{line} {force}"))).spawn().unwrap();
            let moment = if kill < KILLS / 2 {
                let chance = draw as f64 / u64::MAX as f64;
                let moment = whole_time.mul_f64((f64::from(kill) + chance) / f64::from(KILLS / 2));
                sleep(moment);
                format!("after {moment:?} of {whole_time:?}")
            } else {
                // Once at the first change of all.
                let changes = if kill == KILLS / 2 { 1 } else { 2 + draw % (CHANGES - 1) };
                wait_for_changes(&mut child, &folder.path("."), changes);
                format!("at change {changes} of its files")
            };
            child.kill().unwrap();
            let status = child.wait().unwrap();
            let place = format!("{line} {force}, killed {moment} ({status})");

            // While results change places the earlier ones stand beside it; the next command puts them back.
            let left = match content(&folder, results) {
                left if left.is_empty() => content(&folder, &beside(results)),
                left => left,
            };
            for (name, content) in &left {
                let whole = [&old, &new].map(|state| state.get(name) == Some(content));
                assert!(whole.contains(&true), "{place}: {name} is neither old nor new");
            }
            if results.len() == 1 {
                let states = [if earlier { &old } else { &BTreeMap::new() }, &new];
                assert!(states.contains(&&left), "{place}: {:?}", left.keys());
            }

            let interrupted = folder.path(&format!("{}.partial/manifest.json", results[0])).exists();
            let go_on = match (resumes, interrupted, left.is_empty()) {
                (true, true, _) => "--resume",
                (.., true) => "",
                (.., false) => "--force",
            };
            succeeds(&folder, &there(&format!("{line} {go_on}")));
            assert!(content(&folder, results) == new, "{place}: results differ");
        }
    }
}

const SWEEP: &str = "\
name: kills
scenario: room-run.yaml
seed: 5
trials: 8
axes:
  filter.particles: {from: 100, to: 600, step: 100}
";

/// Files of merged shards, or of an undisturbed command, by path in their folder.
fn merged(folder: &Folder, out: &str) -> BTreeMap<String, Vec<u8>> {
    let found = content(folder, &[out]);
    found.into_iter().map(|(name, content)| (name[out.len()..].to_owned(), content)).collect()
}

#[test]
fn a_killed_shard_is_run_again_and_merges_into_the_bytes_of_one_machine() {
    let lines =
        [("sweep s.yaml", ""), ("run room-run.yaml --seed 3 --trials 24 --models classic", "--record none")];
    for (number, (line, whole)) in lines.into_iter().enumerate() {
        let folder = Folder::new();
        folder.write(
            "room-run.yaml",
            edited(SCENARIO, "[classic, np_reg_registered]", "[classic, likelihood_field]"),
        );
        folder.write("s.yaml", SWEEP);
        succeeds(&folder, &format!("{line} {whole} --out one --quiet"));
        let one = merged(&folder, "one");
        succeeds(&folder, &format!("{line} --out o --quiet --shard 1/3"));
        succeeds(&folder, &format!("{line} --out o --quiet --shard 3/3"));
        let start = now();
        succeeds(&folder, &format!("{line} --out timed --quiet --shard 2/3"));
        let whole_time = now() - start;
        for kill in 0..KILLS {
            let chance = Draw::new(23, Stage::Trial, number as u32).seed(kill) as f64 / u64::MAX as f64;
            let moment = whole_time.mul_f64((f64::from(kill) + chance) / f64::from(KILLS));
            let shard = format!("{line} --out o --quiet --shard 2/3");
            let mut child = command(&folder, &shard).spawn().unwrap();
            sleep(moment);
            child.kill().unwrap();
            child.wait().unwrap();
            let place = format!("{shard}, killed after {moment:?} of {whole_time:?}");
            if !folder.path("o/shard-00002-of-00003").exists() {
                let refused = command(&folder, "merge o").output().unwrap();
                let error = String::from_utf8(refused.stderr).unwrap();
                assert_eq!(refused.status.code(), Some(2), "{place}: {error}");
                assert!(error.contains("1 of 3 shards are missing: 2"), "{place}: {error}");
                assert!(error.contains(&format!("locsim {line} --out o --shard 2/3")), "{place}: {error}");
                succeeds(&folder, &shard);
            }
            succeeds(&folder, &format!("merge o --out merged {whole} --quiet"));
            assert!(merged(&folder, "merged") == one, "{place}: results differ");
            fs::remove_dir_all(folder.path("merged")).unwrap();
            fs::remove_dir_all(folder.path("o/shard-00002-of-00003")).unwrap();
        }
    }
}
