//! The layers of the workspace: which crate may use which, and where a large dependency may be named.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// Each crate of the workspace and the crates of the workspace that it uses.
const LAYERS: [(&str, &[&str]); 14] = [
    ("distreg", &[]),
    ("locsim-core", &[]),
    ("locsim-world", &["locsim-core"]),
    ("locsim-sensor", &["distreg", "locsim-core"]),
    ("locsim-mcl", &["locsim-core"]),
    ("locsim-dataset", &["locsim-core"]),
    ("locsim-gap", &["locsim-core", "locsim-world"]),
    ("locsim-report", &["locsim-core", "locsim-sensor"]),
    ("locsim-scenario", &["locsim-core", "locsim-dataset", "locsim-sensor", "locsim-world"]),
    ("locsim-study", &["distreg", "locsim-core", "locsim-report", "locsim-scenario", "locsim-world"]),
    (
        "locsim-lab",
        &[
            "locsim-core",
            "locsim-dataset",
            "locsim-gap",
            "locsim-mcl",
            "locsim-report",
            "locsim-scenario",
            "locsim-sensor",
            "locsim-world",
        ],
    ),
    (
        "locsim-bench",
        &[
            "distreg",
            "locsim-core",
            "locsim-dataset",
            "locsim-gap",
            "locsim-lab",
            "locsim-mcl",
            "locsim-report",
            "locsim-scenario",
            "locsim-sensor",
            "locsim-world",
        ],
    ),
    (
        "locsim-fuzz",
        &[
            "locsim-bench",
            "locsim-core",
            "locsim-dataset",
            "locsim-lab",
            "locsim-scenario",
            "locsim-sensor",
            "locsim-study",
            "locsim-world",
        ],
    ),
    (
        "locsim",
        &[
            "distreg",
            "locsim-bench",
            "locsim-core",
            "locsim-dataset",
            "locsim-lab",
            "locsim-report",
            "locsim-scenario",
            "locsim-study",
        ],
    ),
];

/// Dependencies that one crate keeps to itself, and the place in its sources (a file or a folder) that names them.
const KEPT: [(&str, &str, &str); 4] = [
    ("rerun", "locsim", "crates/cli/src/recording"),
    ("parry2d-f64", "locsim-world", "crates/world/src/raycast"),
    ("serde_yaml", "locsim-scenario", "crates/scenario/src/yaml.rs"),
    ("saphyr-parser", "locsim-scenario", "crates/scenario/src"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// Names of all dependencies (of tests and builds too) of each crate of the workspace.
fn dependencies() -> BTreeMap<String, Vec<String>> {
    let arguments = ["metadata", "--no-deps", "--format-version", "1", "--offline"];
    let call = Command::new(env!("CARGO")).args(arguments).current_dir(root()).output().unwrap();
    assert!(call.status.success(), "{}", String::from_utf8_lossy(&call.stderr));
    let metadata: Value = serde_json::from_slice(&call.stdout).unwrap();
    let name = |value: &Value| value["name"].as_str().unwrap().to_owned();
    let packages = metadata["packages"].as_array().unwrap().iter();
    packages.map(|p| (name(p), p["dependencies"].as_array().unwrap().iter().map(name).collect())).collect()
}

/// Rust sources under a folder.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths
        .flat_map(|path| {
            if path.is_dir() {
                sources(&path)
            } else {
                Vec::from_iter(path.extension().is_some_and(|extension| extension == "rs").then_some(path))
            }
        })
        .collect()
}

#[test]
fn crates_use_the_layers_that_are_named() {
    let found = dependencies();
    let layers = BTreeMap::from(LAYERS);
    assert!(found.keys().map(String::as_str).eq(layers.keys().copied()), "{:?}", found.keys());
    for (name, used) in &found {
        let used: BTreeSet<&str> =
            used.iter().map(String::as_str).filter(|name| layers.contains_key(name)).collect();
        let allowed: BTreeSet<&str> = layers[name.as_str()].iter().copied().collect();
        assert_eq!(used, allowed, "{name}");
    }
}

#[test]
fn one_crate_each_knows_rerun_and_parry() {
    let found = dependencies();
    for (kept, owner, _) in KEPT {
        let users: Vec<_> = found.iter().filter(|(_, used)| used.iter().any(|name| name == kept)).collect();
        assert!(
            users.iter().map(|(name, _)| name.as_str()).eq([owner]),
            "{kept} belongs to {owner}: {users:?}"
        );
    }
    assert!(
        !found.values().flatten().any(|name| name == "parry2d"),
        "in f32 it loses hits at grazing angles"
    );
}

/// Lines of the program that may name an effect. Any other code asks an effect for its properties, so that a new effect
/// is one type in one file and one line in a list.
const MOST_EFFECT_NAMES: usize = 30;

/// Files that name effects by their nature: their definitions, the logs with hidden effects, tests.
fn may_name_effects(file: &Path) -> bool {
    let of_tests = ["tests", "tests.rs", "fixtures.rs", "hidden", "plan.rs"];
    file.starts_with("crates/world") || of_tests.iter().any(|name| file.iter().any(|part| part == *name))
}

#[test]
fn effects_are_seldom_named() {
    let root = root();
    let mut count = 0;
    for path in sources(&root.join("crates")) {
        let file = path.strip_prefix(&root).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let program = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
        if !may_name_effects(file) {
            count += program.lines().filter(|line| line.contains("EffectKind::")).count();
        }
    }
    assert!((1..=MOST_EFFECT_NAMES).contains(&count), "{count}");
}

#[test]
fn large_dependencies_are_named_in_one_place() {
    let root = root();
    let files: Vec<(PathBuf, String)> = sources(&root.join("crates"))
        .into_iter()
        .map(|path| (path.strip_prefix(&root).unwrap().to_owned(), fs::read_to_string(&path).unwrap()))
        .collect();
    assert!(files.len() > 100, "{}", files.len());
    for (kept, _, place) in KEPT {
        let path = format!("{}::", kept.replace('-', "_"));
        let naming: Vec<&Path> =
            files.iter().filter(|(_, text)| text.contains(&path)).map(|(file, _)| file.as_path()).collect();
        assert!(!naming.is_empty(), "nothing names {kept}");
        assert!(naming.iter().all(|file| file.starts_with(place)), "{kept} is named in {naming:?}");
    }
}
