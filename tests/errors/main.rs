//! Every kind of bad input as a user meets it: exit code 2 and a message that names the file, the line where there
//! is one, the key, the value and what is allowed. What is no error but a recovery says what happened.

#[path = "../common/mod.rs"]
mod common;
mod maps;

use common::{Folder, SCENARIO, edited, output};
use predicates::str::{contains, is_empty, starts_with};

/// Runs a command line that has to be refused with exactly this message.
fn refused(folder: &Folder, line: &str, message: &str) {
    let call = folder.locsim(line).code(2).stdout(is_empty());
    let error = String::from_utf8(call.get_output().stderr.clone()).unwrap();
    assert_eq!(error.trim_end(), format!("error: {message}"), "{line}");
    assert!(!folder.path("results").join("room").exists(), "{line} left results");
}

/// Runs the scenario with one part replaced.
fn refused_scenario(from: &str, to: &str, message: &str) {
    let folder = Folder::new();
    folder.write("s.yaml", edited(SCENARIO, from, to));
    refused(&folder, "run s.yaml", message);
}

/// A scenario that localizes on `drive.log`.
const ON_A_LOG: &str = "\
seed: 1
log: {file: drive.log, train_scans: [[0.0, 0.5]], localize_scans: [[0.5, 1.0]]}
map: {file: room.yaml}
training: {poses: 400}
models: [classic]
filter:
  particles: 100
  motion: {model: odometry, alpha: [0.1, 0.05, 0.1, 0.05]}
  start: {tracking: {sigma_m: 0.1, sigma_deg: 3}}
";

#[test]
fn keys_types_and_values_of_a_scenario() {
    for (from, to, message) in [
        (
            "  particles: 100",
            "  partcles: 100",
            "s.yaml:15: filter.partcles: `partcles` is not a key; did you mean `particles`? allowed: particles, motion, \
             resampler, resample, injection, start, beams, update, estimate, regularization, least_effective_share, annealing",
        ),
        ("seed: 3", "seed: three", "s.yaml:3: seed: \"three\" is not allowed; a whole number"),
        (
            "particles: 100",
            "particles: 0",
            "s.yaml:15: filter.particles: 0 is not allowed; a whole number from 1 to 10000000",
        ),
        (
            "beams: 12",
            "beams: 0",
            "s.yaml:11: laser.beams: 0 is not allowed; a whole number from 1 to 100000",
        ),
        ("trials: 3", "trials: 0", "s.yaml:4: trials: 0 is not allowed; a whole number from 1 to 1000000"),
        (
            "max_range_m: 3",
            "max_range_m: .nan",
            "s.yaml:11: laser.max_range_m: NaN is not allowed; a number from 0.001 to 10000",
        ),
        (
            "sigma_m: 0.02",
            "sigma_m: -0.02",
            "s.yaml:11: laser.noise.sigma_m: -0.02 is not allowed; 0, or a number from 0.000001 to 1",
        ),
        ("seed: 3\n", "", "s.yaml:1: seed: the key is missing"),
        (
            "seed: 3",
            "seed: 3: 4",
            "s.yaml:3: not readable as YAML: mapping values are not allowed in this context",
        ),
    ] {
        refused_scenario(from, to, message);
    }
}

/// Error for a scenario, which is refused.
fn told(content: impl AsRef<[u8]>) -> String {
    let folder = Folder::new();
    folder.write("s.yaml", content);
    let call = folder.locsim("validate s.yaml").code(2).stdout(is_empty());
    String::from_utf8(call.get_output().stderr.clone()).unwrap()
}

#[test]
fn files_that_would_cost_the_machine() {
    let nested = |depth| format!("{}{}", "[".repeat(depth), "]".repeat(depth));
    let aliases = format!("a: &a {}\nb: [{}]\n", "x".repeat(100_000), vec!["*a"; 100_000].join(","));
    let laughs: Vec<String> = (1..30).map(|i| format!("a{i}: &a{i} [*a{0}, *a{0}]\n", i - 1)).collect();
    for (text, said) in [
        (format!("seed: {}", nested(100)), "collections within each other are not allowed; at most 64"),
        (format!("seed: {}", nested(40_000)), "s.yaml:1: more collections within each other are not allowed"),
        ("- ".repeat(40_000), "collections within each other are not allowed; at most 64"),
        ("{a: ".repeat(20_000), "s.yaml:1: "),
        (aliases, "s.yaml:2: b["),
        (format!("a0: &a0 [1]\n{}", laughs.concat()), "keys and values of a YAML file"),
        ("#".repeat(3_000_000), "3000000 bytes of a YAML file"),
        (format!("seed: 1\n{}: 2", "k".repeat(1_000_000)), "s.yaml:2: "),
        (format!("seed: {}", "9".repeat(1_000_000)), "s.yaml:1: seed: "),
    ] {
        let error = told(text);
        assert!(error.contains(said) && error.len() < 1000, "{said}: {error}");
    }
}

#[test]
fn encodings_and_whole_numbers() {
    let folder = Folder::new();
    folder.write("s.yaml", format!("\u{feff}{SCENARIO}"));
    folder.locsim("validate s.yaml").success();
    let utf_16: Vec<u8> = SCENARIO.encode_utf16().flat_map(u16::to_be_bytes).collect();
    assert_eq!(
        told([b"\xfe\xff".as_slice(), &utf_16].concat()).trim_end(),
        "error: s.yaml: a text in UTF-16 is not allowed; save it as UTF-8"
    );
    let latin_1 = edited(SCENARIO, "A short drive", "Eine kurze R\u{1}cke").replace('\u{1}', "?");
    let latin_1: Vec<u8> = latin_1.bytes().map(|byte| if byte == b'?' { 0xfc } else { byte }).collect();
    assert_eq!(told(latin_1).trim_end(), "error: s.yaml:2: the byte 0xfc is not allowed; text in UTF-8");
    let to = format!("a whole number from 0 to {}", u64::MAX);
    let least = "a whole number, at least 0".to_owned();
    for (seed, allowed) in [("18446744073709551616", &to), ("-1", &least), ("1.5", &least)] {
        let message = format!("error: s.yaml:3: seed: {seed} is not allowed; {allowed}");
        assert_eq!(told(edited(SCENARIO, "seed: 3", &format!("seed: {seed}"))).trim_end(), message);
    }
}

#[test]
fn numbers_that_would_overflow_or_are_missing() {
    for (from, to, message) in [
        (
            "alpha: [0.1, 0.05, 0.1, 0.05]",
            "alpha: [1e300, 0.05, 0.1, 0.05]",
            "s.yaml:16: filter.motion.alpha[0]: 1e300 is not allowed; a number from 0 to 1000",
        ),
        (
            ", alpha: [0.1, 0.05, 0.1, 0.05]",
            "",
            "s.yaml:16: filter.motion.alpha: the key is missing; only the noise of `odometry` may be left out, on a `log`, to \
             which it is then fitted",
        ),
        (
            "speed_m_s: 0.5",
            "speed_m_s: 1e-300",
            "s.yaml:9: robot.path.waypoints.speed_m_s: 1e-300 is not allowed; a number from 0.001 to 1000",
        ),
        (
            "[2.6, 0.9]",
            "[1e300, 0.9]",
            "s.yaml:9: robot.path.waypoints.points_m[1][0]: 1e300 is not allowed; a number from -1000000 to 1000000",
        ),
    ] {
        refused_scenario(from, to, message);
    }
}

#[test]
fn every_problem_of_a_file_is_told_at_once_in_the_order_of_the_file() {
    let folder = Folder::new();
    let text = edited(SCENARIO, "particles: 100", "particles: 0");
    folder.write("s.yaml", edited(&text, "trials: 3", "trials: 0"));
    refused(
        &folder,
        "validate s.yaml",
        "s.yaml:4: trials: 0 is not allowed; a whole number from 1 to 1000000\n\
         s.yaml:15: filter.particles: 0 is not allowed; a whole number from 1 to 10000000",
    );
}

#[test]
fn files_that_are_not_there() {
    let folder = Folder::new();
    refused(&folder, "run nowhere.yaml", "nowhere.yaml: No such file or directory (os error 2)");
    refused_scenario(
        "map: {file: room.yaml}",
        "map: {file: hall.yaml}",
        "s.yaml:5: map.file: `hall.yaml` is not allowed; there is no file hall.yaml",
    );
    refused_scenario(
        "models: [classic,",
        "models: [{name: classic, file: old.model},",
        "s.yaml:13: models[0].file: `old.model` is not allowed; there is no file old.model",
    );
    folder.write("s.yaml", ON_A_LOG);
    refused(
        &folder,
        "run s.yaml",
        "s.yaml:2: log.file: `drive.log` is not allowed; there is no file drive.log",
    );
    folder.write("s.yaml", edited(ON_A_LOG, "drive.log", "'${LOCSIM_DATA}/drive.log'"));
    refused(
        &folder,
        "run s.yaml",
        "s.yaml:2: log.file: `${LOCSIM_DATA}/drive.log` is not allowed; the environment variable LOCSIM_DATA is not \
         set (export LOCSIM_DATA=...)",
    );
    refused(
        &folder,
        "map nowhere.log --out m",
        "nowhere.log: cannot be opened: No such file or directory (os error 2)",
    );
}

#[test]
fn options_of_the_command_line() {
    let folder = Folder::new();
    let run = "run room-run.yaml";
    refused(
        &folder,
        &format!("{run} --models classic,np_rge"),
        "room-run.yaml: --models: `np_rge` is not a model of this scenario; allowed: classic, np_reg_registered",
    );
    for threads in ["0", "100000"] {
        let message =
            format!("error: invalid value '{threads}' for '--threads <THREADS>': a whole number from 1 to ");
        folder.locsim(&format!("{run} --threads {threads}")).code(2).stderr(starts_with(message));
    }
    for (option, allowed) in [
        (
            "--trials 0",
            "invalid value '0' for '--trials <TRIALS>': a whole number from 1 to 1000000 is allowed",
        ),
        ("--trials -1", "a whole number from 1 to 1000000 is allowed"),
        ("--seed 18446744073709551616", "a whole number from 0 to 18446744073709551615 is allowed"),
        ("--limit map_pixels=many", "NAME=VALUE with a whole number"),
        ("--limit pixels=1", "`pixels` is not a limit; allowed: yaml_bytes, "),
    ] {
        folder.locsim(&format!("{run} {option}")).code(2).stdout(is_empty()).stderr(contains(allowed));
    }
    folder.locsim("simulate room-run.yaml --out drive.log").success();
    let map = "map drive.log --out m";
    refused(
        &folder,
        &format!("{map} --share 0.5"),
        "--share: 0.5 is not allowed; two numbers are needed, for example 0.0,0.5",
    );
    refused(
        &folder,
        &format!("{map} --share 0.5,0.2"),
        "--share: 0.5,0.2 is not allowed; 0 <= from < to <= 1",
    );
    // What a scenario says isn't said twice.
    let mapped = edited(ON_A_LOG, "drive.log, ", "drive.log, map_scans: [[0, 0.4]], map_resolution_m: 0.1, ");
    folder.write("of-log.yaml", edited(&mapped, "map: {file: room.yaml}\n", ""));
    let map = "map of-log.yaml --out m";
    for (option, what) in [
        ("--max-range 5", "--max-range: not allowed with a scenario, whose `log` section says it"),
        ("--scan-topic /scan", "--scan-topic: not allowed with a scenario, whose `log` section says it"),
        ("--share 0,0.5", "--share: not allowed with a scenario that has `log.map_scans`"),
    ] {
        refused(&folder, &format!("{map} {option}"), what);
    }
    folder.locsim(map).success();
    let description = String::from_utf8(folder.read("m.yaml")).unwrap();
    assert!(description.contains("resolution: 0.1\n"), "{description}");
    let map = "map drive.log --out m";
    for size in ["0", "1000", "nan"] {
        let call = folder.locsim(&format!("{map} --resolution {size}")).code(2).stdout(is_empty());
        call.stderr(contains("'--resolution <RESOLUTION>'")).stderr(contains("a number from 0.001 to 10"));
    }
    refused(
        &folder,
        "simulate room-run.yaml --out room.yaml/drive.log",
        "room.yaml/drive.log: cannot be written: File exists (os error 17)",
    );
}

/// Where a folder is needed.
#[test]
fn files_in_the_place_of_folders() {
    let folder = Folder::new();
    for line in ["run room-run.yaml", "run room-run.yaml --shard 1/2", "run room-run.yaml --trials 1"] {
        for out in ["room.yaml", "room.yaml/a", "room.yaml/a/b"] {
            let message = "--out: room.yaml is not allowed; it is a file, and a folder is needed";
            refused(&folder, &format!("{line} --out {out}"), message);
        }
    }
    for (path, what) in [("room.yaml", "it is a file"), ("nowhere", "nothing is there")] {
        let message =
            format!("{path} is not allowed; {what}, and the folder that the shards are in is needed");
        refused(&folder, &format!("merge {path}"), &message);
    }
}

/// A pipe among the files of a shard is no file.
#[cfg(unix)]
#[test]
fn pipes_in_a_shard() {
    let folder = Folder::new();
    folder.locsim("run room-run.yaml --trials 1 --shard 1/1 --out o --quiet").success();
    for name in ["trials.cbor", "shard.json"] {
        let file = folder.path(&format!("o/shard-00001-of-00001/{name}"));
        std::fs::remove_file(&file).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&file).status().unwrap().success());
        let call = folder.locsim("merge o").code(2);
        call.stderr(starts_with(format!(
            "error: o/shard-00001-of-00001/{name} can't be read: it is no file; remove it and run the shard again\n"
        )));
    }
}

/// What stands in the place of the lock is no file of ours: a link's target isn't written to.
#[cfg(unix)]
#[test]
fn locks_that_are_no_files() {
    let folder = Folder::new();
    let room = folder.read("room.yaml");
    std::fs::create_dir_all(folder.path("r.partial")).unwrap();
    let lock = folder.path("r.partial/lock");
    let message = "--out: r is not allowed; r.partial/lock isn't as locsim wrote it, and stays. Move it away, or name another \
                   folder";
    for target in ["../room.yaml", "../nowhere"] {
        std::os::unix::fs::symlink(target, &lock).unwrap();
        refused(&folder, "run room-run.yaml --out r", message);
        std::fs::remove_file(&lock).unwrap();
    }
    assert!(std::process::Command::new("mkfifo").arg(&lock).status().unwrap().success());
    refused(&folder, "run room-run.yaml --out r --force", message);
    assert!(folder.read("room.yaml") == room, "the link's target was written to");
}

/// Opening a pipe is to wait for whoever writes into it.
#[cfg(unix)]
#[test]
fn pipes() {
    let folder = Folder::new();
    let made = std::process::Command::new("mkfifo").arg(folder.path("pipe")).status();
    assert!(made.unwrap().success());
    folder.write("s.yaml", edited(ON_A_LOG, "drive.log", "pipe"));
    for command in ["validate", "run"] {
        let message = "s.yaml:2: log.file: `pipe` is not allowed; pipe isn't a regular file";
        refused(&folder, &format!("{command} s.yaml"), message);
    }
    let effects = "effects: [{name: range_bias, bias_m: 0.02}]\n";
    folder.write("e.yaml", SCENARIO.to_owned() + effects);
    for line in [
        "inspect pipe",
        "map pipe --out m",
        "init pipe --out i.yaml",
        "convert pipe --out c.mcap",
        "gap room-run.yaml --log pipe --out g",
        "apply e.yaml --in pipe --out a.mcap",
        "export nav2 pipe --out n.yaml",
    ] {
        refused(&folder, line, "pipe: this is a pipe or a device; allowed: a file");
    }
    for line in [
        "validate pipe",
        "run pipe",
        "simulate pipe --out s.log",
        "study pipe",
        "sweep pipe",
        "gap pipe --out g",
        "export sdf pipe --out n.sdf",
    ] {
        let message = "pipe: a file is needed; this is a pipe or a device, and it is read more than once";
        refused(&folder, line, message);
    }
}

/// `--force` replaces what locsim has written, and an empty folder isn't of that.
#[test]
fn empty_folders_in_results() {
    let folder = Folder::new();
    let run = "run room-run.yaml --quiet --record none --trials 1 --models classic --out out";
    folder.locsim(run).success();
    for name in ["out/figures/mine", "out/notes"] {
        std::fs::create_dir(folder.path(name)).unwrap();
        let message = format!(
            "--out: out is not allowed; {name} isn't as locsim wrote it, and stays. Move it away, or name another folder"
        );
        refused(&folder, &format!("{run} --force"), &message);
        assert!(folder.path(name).is_dir());
        std::fs::remove_dir(folder.path(name)).unwrap();
    }
    folder.locsim(&format!("{run} --force")).success();
}

#[test]
fn names_of_what_is_written() {
    let folder = Folder::new();
    folder.locsim("simulate room-run.yaml --out drive.log").success();
    std::fs::create_dir(folder.path("floors")).unwrap();
    for out in ["/", ".", "..", "floor/", "floors/."] {
        let message = format!(
            "--out: `{out}` is not allowed; a name that the map's files are called by, such as floor"
        );
        refused(&folder, &format!("map drive.log --out {out}"), &message);
    }
    for (out, what) in
        [("floors", "it is no file"), ("/dev/null", "it is no file"), ("drive.log", "this command reads it")]
    {
        refused(&folder, &format!("map drive.log --out {out}"), &format!("{out} is not allowed; {what}"));
    }
    let logs = "allowed: .mcap for a ROS 2 bag; .log, .log.gz or a name without an ending for a CARMEN log";
    for line in ["simulate room-run.yaml --out", "convert drive.log --out"] {
        refused(&folder, &format!("{line} x.foo"), &format!("x.foo: a log isn't written as `.foo`; {logs}"));
        refused(
            &folder,
            &format!("{line} x.txt.gz"),
            &format!("x.txt.gz: a log isn't written as `.gz`; {logs}"),
        );
    }
    refused(
        &folder,
        "init drive.log --out i.mcap",
        "--out: i.mcap is not allowed; a file name that ends in .yaml or .yml",
    );
    for line in ["simulate room-run.yaml --out d", "convert drive.log --out e.clf.gz"] {
        folder.locsim(line).success();
    }
}

#[test]
fn what_a_log_or_a_scenario_has_not() {
    let folder = Folder::new();
    folder.locsim("simulate room-run.yaml --out drive.log --trial 2").success();
    let call = folder.locsim("simulate room-run.yaml --out t.log --limit memory_bytes=1000000").code(2);
    call.stderr(starts_with("error: room-run.yaml:11: laser.rate_hz: the run needs "))
        .stderr(contains("the limit is 1.0 MB (`--limit memory_bytes="));
    assert!(!folder.path("t.log").exists());
    refused(
        &folder,
        "map drive.log --share 0,1e-9 --out m",
        "drive.log: the share 0,1e-9 holds none of its 21 scans; allowed: one or more",
    );
    folder.write("one.yaml", edited(SCENARIO, "beams: 12", "beams: 1"));
    folder.locsim("simulate one.yaml --out one.log").success();
    let call = folder.locsim("map one.log --share 0,0.048 --out m").success();
    call.stderr(contains(
        "warning: The map of walls has no wall, as the readings of its scans (2) lie on no line.",
    ));
    folder
        .locsim("manual nope")
        .code(2)
        .stderr(contains("`nope` is not a command of locsim; allowed: run, "));
    let slow = edited(SCENARIO, "turn_rate_deg_s: 45", "turn_rate_deg_s: 0.001");
    let there_and_back = edited(&slow, "[2.6, 0.9]]", "[2.6, 0.9], [0.6, 0.9]]");
    folder.write("slow.yaml", edited(&there_and_back, "rate_hz: 5", "rate_hz: 20"));
    let call = folder.locsim("simulate slow.yaml --out t.log --limit memory_bytes=100000000000").code(2);
    call.stderr(contains(
        "slow.yaml:11: laser.rate_hz: 3600161 scans are more than the 1000000 that are allowed; a lower rate",
    ));
}

#[test]
fn a_path_through_a_wall() {
    refused_scenario(
        "[2.6, 0.9]",
        "[5.0, 0.9]",
        "s.yaml:9: robot.path.waypoints.points_m[1]: [5, 0.9] is not allowed; a point in the free space of room.yaml",
    );
    // Both ends are free here; the pillar stands between.
    refused_scenario(
        "[[0.6, 0.9], [2.6, 0.9]]",
        "[[0.6, 1.6], [2.6, 1.6]]",
        "s.yaml:9: robot.path.waypoints.points_m: after 1.80 s the path is at (1.500, 1.600) m, which is not in the free space of room.yaml",
    );
    // A wall without thickness, which has no inside.
    let folder = Folder::new();
    let room = String::from_utf8(folder.read("room.yaml")).unwrap();
    folder.write("room.yaml", room + "walls:\n  - {name: screen, from_m: [1.0, 0.5], to_m: [1.0, 1.5]}\n");
    folder.write("s.yaml", SCENARIO);
    for command in ["validate s.yaml", "run s.yaml"] {
        let call = folder.locsim(command).code(2);
        call.stderr(contains(
            "s.yaml:9: robot.path.waypoints.points_m: after 0.80 s the path crosses a wall of room.yaml",
        ));
    }
}

/// What is sound by itself, and isn't possible with the rest of the scenario.
#[test]
fn impossible_together() {
    for (from, to, message) in [
        (
            "max_range_m: 3,",
            "max_range_m: 3, resolution_m: 10000,",
            "s.yaml:11: laser.resolution_m: 10000 is not allowed; at most laser.max_range_m, which is 3",
        ),
        (
            "start: {tracking: {sigma_m: 0.1, sigma_deg: 3}}",
            "start: {around: {x_m: 1000000, y_m: 1, heading_deg: 0}}",
            "s.yaml:17: filter.start.around.x_m: 1000000 is not allowed; 0 to 3.6, the map's extent",
        ),
        (
            "training:",
            "expect: {classic: {lost_share: {max: -1}}}\ntraining:",
            "s.yaml:12: expect.classic.lost_share.max: -1 is not allowed; a share from 0 to 1",
        ),
        (
            "training:",
            "expect: {classic: {kept: {position_rmse_m: {max: -0.1}}}}\ntraining:",
            "s.yaml:12: expect.classic.kept.position_rmse_m.max: -0.1 is not allowed; 0 or more, as the figure is",
        ),
    ] {
        refused_scenario(from, to, message);
    }
    // Means of signed errors may be below 0.
    let folder = Folder::new();
    let signed =
        "expect: {classic: {along: {mean_m: {max: -0.1}}, train: {log_loss_nats: {max: -0.1}}}}\ntraining:";
    folder.write("s.yaml", edited(SCENARIO, "training:", signed));
    folder.locsim("validate s.yaml").success();
    // The path is free, and a start that is moved by 16 m isn't.
    let folder = Folder::new();
    folder.write("s.yaml", edited(SCENARIO, "robot:\n", "robot:\n  start_jitter_m: 16\n"));
    let call = folder.locsim("run s.yaml --trials 1").code(2);
    call.stderr(starts_with("error: s.yaml:9: robot.start_jitter_m: 16 is not allowed; with a start that is moved by up to so much, at "))
        .stderr(contains("outside the map's free space; 0, or what the path has room for"));
    folder.write("s.yaml", edited(SCENARIO, "max_range_m: 3,", "max_range_m: 3, mount: {x_m: 10000},"));
    refused(
        &folder,
        "run s.yaml",
        "s.yaml:13: models: `classic` can't be fitted: none of the training readings is of a wall of the map: are map and laser in metres, \
         and does the laser reach the walls?",
    );
    let room = String::from_utf8(folder.read("room.yaml")).unwrap();
    folder.write("room.yaml", room + "walls:\n  - {name: screen, from_m: [0.6, 0.9], to_m: [2.6, 0.9]}\n");
    folder
        .locsim("validate room-run.yaml")
        .code(2)
        .stderr(contains("room-run.yaml:9: robot.path.waypoints.points_m: after "))
        .stderr(contains("the path crosses a wall of room.yaml"));
}

#[test]
fn logs() {
    let folder = Folder::new();
    folder.locsim("simulate room-run.yaml --out drive.log").success();
    folder.write("s.yaml", ON_A_LOG);
    folder.locsim("run s.yaml --quiet --record none --out whole").success();

    // Cut in the middle of the last line: read without it. A file that is nothing else is refused.
    let whole = folder.read("drive.log");
    folder.write("drive.log", &whole[..whole.len() - 150]);
    folder.locsim("run s.yaml --quiet --record none --out cut").success();
    let report = String::from_utf8(folder.read("cut/report.html")).unwrap();
    assert!(report.contains("(cut off) 1"), "{report}");
    folder.write("drive.log", "ODOM 0 0");
    let message = "drive.log:1: ODOM: the file ends inside this line, so it was cut off; allowed: every line ends with a newline";
    refused(&folder, "run s.yaml", message);

    folder.write("drive.log", "");
    refused(&folder, "run s.yaml", "drive.log: the file is empty");
    folder.write("drive.log", "# a comment\nODOM 0 0 0 0 0 0 0 nohost 0\n");
    let call = folder.locsim("run s.yaml").code(2);
    let error = String::from_utf8(call.get_output().stderr.clone()).unwrap();
    assert!(error.starts_with("error: drive.log: no scan in this log; allowed: at least one "), "{error}");
    refused(
        &folder,
        "simulate s.yaml --out other.log",
        "s.yaml: a scenario of a measured log has nothing to simulate",
    );
}

#[test]
fn saved_models() {
    let folder = Folder::new();
    folder.locsim("run room-run.yaml --out fitted --quiet --record none --trials 1").success();
    let models =
        |text: &str| edited(SCENARIO, "models: [classic, np_reg_registered]", &format!("models: [{text}]"));
    let refused = |folder: &Folder, message: &str| {
        refused(folder, "validate s.yaml", message);
        refused(folder, "run s.yaml", message);
    };

    let file = folder.read("fitted/models/np_reg_registered.model");
    folder.write("half.model", &file[..file.len() / 2]);
    folder.write("s.yaml", models("{name: np_reg_registered, file: half.model}"));
    let call = folder.locsim("run s.yaml").code(2).stderr(starts_with("error: model half.model: "));
    assert!(output(&call).is_empty());

    folder.write("empty.model", "");
    folder.write("s.yaml", models("{name: classic, file: empty.model}"));
    refused(&folder, "model empty.model: empty.model is not a locsim sensor model");

    folder.write("s.yaml", models("{name: classic, file: fitted/models/np_reg_registered.model}"));
    refused(
        &folder,
        "model fitted/models/np_reg_registered.model: holds a np_reg_registered model, the scenario asks for classic",
    );

    let other_laser = models("{name: classic, file: fitted/models/classic.model}");
    folder.write("s.yaml", edited(&other_laser, "max_range_m: 3", "max_range_m: 4"));
    refused(
        &folder,
        "model fitted/models/classic.model: was fitted to a sensor of 3 m maximum range, the scenario's reaches 4 m",
    );
}

#[test]
fn weights_that_are_all_zero_are_made_equal_and_the_trials_table_says_so() {
    // Three particles strewn over metres, under the exact density of a world as mapped, without a floor: none of
    // them can explain a scan.
    let folder = Folder::new();
    let text = edited(SCENARIO, "particles: 100", "particles: 3");
    let text = edited(&text, "sigma_m: 0.1, sigma_deg: 3", "sigma_m: 2, sigma_deg: 100");
    let text = edited(&text, "per_metre_of_wall: 0.3", "per_metre_of_wall: 0");
    let models =
        "models: [{name: oracle, floor: 0, exponent: 1}, {name: oracle, label: floored, floor: 0.01}]";
    folder.write("s.yaml", edited(&text, "models: [classic, np_reg_registered]", models));
    folder.locsim("run s.yaml --out o --quiet --record none").success();
    let table = String::from_utf8(folder.read("o/trials.csv")).unwrap();
    for row in table.lines().skip(1) {
        let recovered = row.contains("0: every particle had likelihood zero: weights made equal");
        assert_eq!(recovered, row.contains(",oracle,"), "{row}");
    }
}
