//! Sweeps on batch engines, with a worker killed halfway. An engine that isn't installed is skipped, and the test says so: GNU
//! parallel is the package `parallel` of Debian, `HyperQueue` is the package `hyperqueue` of `PyPI` for the Python of `LOCSIM_PYTHON` (or `python3`).

#![cfg(target_os = "linux")]

#[allow(dead_code, reason = "the calls of the other tests aren't needed here")]
mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

use common::{Folder, SCENARIO, edited, locsim};

/// 8 cells of about half a second.
const SWEEP: &str = "\
name: engines
scenario: room-run.yaml
seed: 5
trials: 60
axes:
  filter.particles: {from: 1000, to: 2400, step: 200}
";
const SHARDS: u32 = 4;

fn prepared() -> (Folder, PathBuf) {
    let folder = Folder::new();
    // Models that are trained at once.
    folder.write(
        "room-run.yaml",
        edited(SCENARIO, "[classic, np_reg_registered]", "[classic, likelihood_field]"),
    );
    folder.write("s.yaml", SWEEP);
    folder.locsim("sweep s.yaml --out one --quiet").success();
    let out = folder.path("o");
    (folder, out)
}

fn is_there(program: &str, arguments: &[&str]) -> bool {
    let call = Command::new(program).args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    call.is_ok_and(|status| status.success())
}

/// Kills the process that works on a shard, once it has kept its first cell. Returns the number of the shard.
fn kill_a_worker(out: &Path, engine: &mut Child) -> u32 {
    loop {
        assert!(engine.try_wait().unwrap().is_none(), "the engine ended before a worker could be killed");
        for number in 1..=SHARDS {
            let partial = out.join(format!("shard-{number:05}-of-{SHARDS:05}.partial"));
            let is_part = |name: &Path| name.extension().is_some_and(|extension| extension == "part");
            let kept = fs::read_dir(partial.join("parts")).into_iter().flatten().flatten();
            let parts = kept.filter(|entry| is_part(&entry.path())).count();
            // `process 1234 on host`
            let lock = fs::read_to_string(partial.join("lock")).unwrap_or_default();
            let process = lock.split_whitespace().nth(1).and_then(|word| word.parse::<u32>().ok());
            if let (1.., Some(process)) = (parts, process)
                && is_there("kill", &["-9", &process.to_string()])
            {
                return number;
            }
        }
        sleep(Duration::from_millis(2));
    }
}

/// The merge says which shard is missing, and how to run it.
fn merge_refuses(folder: &Folder, killed: u32) -> String {
    let call = folder.locsim("merge o").code(2);
    let error = String::from_utf8(call.get_output().stderr.clone()).unwrap();
    assert!(error.contains(&format!("1 of {SHARDS} shards are missing: {killed}")), "{error}");
    assert!(error.contains("keep finished cells"), "{error}");
    let again = error.lines().map(str::trim).find_map(|line| line.strip_prefix("locsim "));
    again.unwrap_or_else(|| panic!("{error}")).to_owned()
}

fn assert_same(folder: &Folder) {
    folder.locsim("merge o --quiet").success();
    for name in [
        "trials/model=classic/part-0.parquet",
        "trials/model=likelihood_field/part-0.parquet",
        "cells.csv",
        "report.html",
    ] {
        assert!(folder.read(&format!("one/{name}")) == folder.read(&format!("o/merged/{name}")), "{name}");
    }
}

#[test]
fn gnu_parallel_goes_on_after_a_worker_was_killed() {
    if !is_there("parallel", &["--version"]) {
        eprintln!("skipped: GNU parallel is not installed");
        return;
    }
    let (folder, out) = prepared();
    folder.locsim(&format!("sweep s.yaml --out o --engine parallel --shards {SHARDS}")).success();
    let submit = || {
        let mut command = Command::new("sh");
        command.arg(out.join("engine/submit.sh")).env("LOCSIM_CACHE", folder.path(".cache"));
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    };
    let mut engine = submit().spawn().unwrap();
    let killed = kill_a_worker(&out, &mut engine);
    assert!(!engine.wait().unwrap().success());
    merge_refuses(&folder, killed);
    // The same script runs the failed shard alone.
    assert!(submit().status().unwrap().success());
    assert_same(&folder);
}

#[test]
fn hyperqueue_goes_on_after_a_worker_was_killed() {
    let python = std::env::var("LOCSIM_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    if !is_there(&python, &["-c", "import hyperqueue"]) {
        eprintln!("skipped: {python} has no package hyperqueue");
        return;
    }
    let (folder, out) = prepared();
    folder.locsim(&format!("sweep s.yaml --out o --engine hyperqueue --shards {SHARDS}")).success();
    let cluster = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/engines/hyperqueue_cluster.py");
    let mut engine = Command::new(&python)
        .arg(cluster)
        .arg(out.join("engine/shard.sh"))
        .arg(SHARDS.to_string())
        .env("LOCSIM_CACHE", folder.path(".cache"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let killed = kill_a_worker(&out, &mut engine);
    assert_eq!(engine.wait().unwrap().code(), Some(1));
    let again = merge_refuses(&folder, killed);
    locsim(&folder.path("."), &again).assert().success();
    assert_same(&folder);
}
