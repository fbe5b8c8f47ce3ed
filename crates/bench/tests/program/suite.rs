//! A small fixed part of the hidden-effect suite, as a user types it: two logs in which nothing is hidden, every effect of
//! the library once at an information of 100, two in another form, one from outside of the library.
//!
//! Everything derives from one seed, so that the figures are the same on every machine; what is asked of them leaves room
//! for a change that is none to the better or worse. A search that names at random would be right once in 24 logs.

use std::fs;

use predicates::str::contains;
use serde_json::Value;

use crate::{bench, output};

/// The nominal corridor with fewer beams: a log is a sixth of the suite's.
fn scenario() -> String {
    let own = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenarios/gap/nominal.yaml");
    let map = concat!(env!("CARGO_MANIFEST_DIR"), "/../../maps/corridor.yaml");
    let text = fs::read_to_string(own).unwrap();
    text.replace("../../maps/corridor.yaml", map).replace("  beams: 72", "  beams: 36")
}

#[test]
fn most_hidden_effects_are_named_and_nothing_else_is() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("small.yaml"), scenario()).unwrap();
    // In two shards, as two machines would.
    let line = |more: &str| {
        let line =
            format!("gap small.yaml --size small --seed 3 --replicates 99 --scans 200 --out suite {more}");
        bench(folder.path(), &line)
    };
    line("--shard 1/2 --quiet").success();
    line("--merge").code(2).stderr(contains("suite: 16 of 31 logs are missing; run with --shard 2/2"));
    line("--shard 2/2 --quiet").success();
    let score: Value = serde_json::from_str(&output(&line("--merge --json").success())).unwrap();
    assert_eq!(score["runs"], score["planned"]);
    for (regime, share) in score["false_alarm"].as_object().unwrap() {
        assert_eq!(share["count"], 0, "{regime}: {share}");
    }
    let same = &score["top1"]["100"]["same"];
    assert!(same["count"].as_u64().unwrap() >= 18 && same["of"] == 24, "{same}");
    let other = &score["top1"]["100"]["other"];
    assert!(other["count"].as_u64().unwrap() >= 1 && other["of"] == 2, "{other}");
    assert_eq!(score["outside"]["flagged"]["count"], 1, "{}", score["outside"]);
    // Done is done: the same commands run nothing again, and say the same.
    line("--shard 1/2 --quiet").success();
    let again: Value = serde_json::from_str(&output(&line("--merge --json").success())).unwrap();
    assert_eq!(again, score);
    let report = fs::read_to_string(folder.path().join("suite/merged/report.md")).unwrap();
    assert!(report.contains("| range_bias |") && report.contains("31 of 31 logs"), "{report}");
}

/// The small suite has no logs of other lasers: that is said, and no folder is made.
#[test]
fn a_part_of_the_suite_that_has_no_logs_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("small.yaml"), scenario()).unwrap();
    let line = "gap small.yaml --size small --setups fine --out suite";
    bench(folder.path(), line)
        .code(2)
        .stderr(contains("--groups, --setups: the suite has no such logs at this --size"));
    assert!(!folder.path().join("suite").exists());
}
