//! The structure of the workspace: which crate may use which, where a large dependency may be named, the size of crates, circles of
//! modules, links of the documentation.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// Each crate of the workspace and the crates of the workspace that it uses, which stand above it.
const LAYERS: [(&str, &[&str]); 21] = [
    ("distreg", &[]),
    ("locsim-core", &[]),
    ("locsim-world", &["locsim-core"]),
    ("locsim-mapping", &["locsim-core", "locsim-world"]),
    ("locsim-sensor", &["distreg", "locsim-core"]),
    ("locsim-mcl", &["locsim-core"]),
    ("locsim-dataset", &["locsim-core"]),
    ("locsim-comparison", &["distreg", "locsim-core", "locsim-world"]),
    ("locsim-gap", &["distreg", "locsim-comparison", "locsim-core", "locsim-world"]),
    ("locsim-baseline", &["distreg", "locsim-comparison", "locsim-core", "locsim-gap", "locsim-world"]),
    ("locsim-report", &["distreg", "locsim-core", "locsim-sensor"]),
    ("locsim-scenario", &["locsim-core", "locsim-dataset", "locsim-mcl", "locsim-sensor", "locsim-world"]),
    ("locsim-study", &["distreg", "locsim-core", "locsim-report", "locsim-scenario", "locsim-world"]),
    (
        "locsim-lab",
        &[
            "locsim-baseline",
            "locsim-core",
            "locsim-dataset",
            "locsim-gap",
            "locsim-mapping",
            "locsim-mcl",
            "locsim-report",
            "locsim-scenario",
            "locsim-sensor",
            "locsim-world",
        ],
    ),
    (
        "locsim-export",
        &[
            "locsim-core",
            "locsim-dataset",
            "locsim-lab",
            "locsim-mcl",
            "locsim-report",
            "locsim-scenario",
            "locsim-sensor",
            "locsim-world",
        ],
    ),
    ("locsim-sweep", &["locsim-core", "locsim-lab", "locsim-report", "locsim-scenario"]),
    ("locsim-terminal", &["locsim-core", "locsim-report"]),
    (
        "locsim",
        &[
            "locsim-core",
            "locsim-dataset",
            "locsim-export",
            "locsim-lab",
            "locsim-report",
            "locsim-scenario",
            "locsim-study",
            "locsim-sweep",
            "locsim-terminal",
        ],
    ),
    (
        "locsim-python",
        &[
            "distreg",
            "locsim",
            "locsim-core",
            "locsim-dataset",
            "locsim-gap",
            "locsim-lab",
            "locsim-mcl",
            "locsim-report",
            "locsim-scenario",
            "locsim-sensor",
            "locsim-terminal",
            "locsim-world",
        ],
    ),
    (
        "locsim-bench",
        &[
            "distreg",
            "locsim-baseline",
            "locsim-comparison",
            "locsim-core",
            "locsim-dataset",
            "locsim-gap",
            "locsim-lab",
            "locsim-mapping",
            "locsim-mcl",
            "locsim-report",
            "locsim-scenario",
            "locsim-sensor",
            "locsim-terminal",
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
];

/// Most lines of code in a crate, tests left out: a larger one has more than one subject.
const MOST_LINES: usize = 9000;

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
    for (i, (name, used)) in LAYERS.iter().enumerate() {
        let above: Vec<&str> = LAYERS[..i].iter().map(|(name, _)| *name).collect();
        assert!(used.iter().all(|used| above.contains(used)), "{name} uses a crate that stands below it");
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

#[test]
fn no_crate_is_large() {
    let root = root();
    for folder in fs::read_dir(root.join("crates")).unwrap().map(|entry| entry.unwrap().path()) {
        let total: usize = modules(&folder.join("src")).values().map(|code| code.lines().count()).sum();
        assert!((100..=MOST_LINES).contains(&total), "{}: {total} lines", folder.display());
    }
}

/// The modules of a crate by path, with their code. Tests and lines of comments are left out.
fn modules(src: &Path) -> BTreeMap<Vec<String>, String> {
    let mut modules = BTreeMap::<Vec<String>, String>::new();
    for file in sources(src) {
        let path = file.strip_prefix(src).unwrap().with_extension("");
        let mut path: Vec<String> = path.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
        if path.iter().any(|part| part.ends_with("tests") || part == "fixtures") {
            continue;
        }
        path.pop_if(|last| ["mod", "lib", "main"].contains(&last.as_str()));
        let text = fs::read_to_string(&file).unwrap();
        let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
        let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
        modules.entry(path).or_default().extend(lines.map(|line| format!("{line}\n")));
    }
    modules
}

/// The paths that code of the module `own` names from `crate`, `super` or `self` on. A group in braces counts as many paths.
fn named_paths(own: &[String], code: &str) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    for (start, base) in
        [("crate::", &[][..]), ("super::", &own[..own.len().saturating_sub(1)]), ("self::", own)]
    {
        for (at, _) in code.match_indices(start) {
            let within = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
            if !code[..at].ends_with(within) {
                add_paths(base, &code[at + start.len()..], &mut paths);
            }
        }
    }
    paths
}

/// Adds the paths that begin with `base` and go on as `rest` does: `a::b`, or `a::{b, c::d}`.
fn add_paths(base: &[String], mut rest: &str, paths: &mut Vec<Vec<String>>) {
    let mut path = base.to_vec();
    loop {
        if let Some(group) = rest.strip_prefix('{') {
            let (mut depth, mut begin) = (0, 0);
            for (i, c) in group.char_indices() {
                match c {
                    '{' => depth += 1,
                    '}' if depth > 0 => depth -= 1,
                    '}' | ',' if depth == 0 => {
                        add_paths(&path, group[begin..i].trim(), paths);
                        begin = i + 1;
                    }
                    _ => {}
                }
                if c == '}' && begin == i + 1 {
                    return;
                }
            }
            return;
        }
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        match &rest[..end] {
            "super" => _ = path.pop(),
            "" | "self" => {}
            word => path.push(word.to_owned()),
        }
        match rest[end..].strip_prefix("::") {
            Some(after) => rest = after,
            None => break,
        }
    }
    paths.push(path);
}

/// Modules under one parent that use each other in a circle, as `parent: a, b`. What the crate's root re-exports counts as the
/// root's.
fn circles(src: &Path) -> Vec<String> {
    let modules = modules(src);
    // By parent: the siblings that each of its children uses.
    let mut uses = BTreeMap::<Vec<String>, BTreeMap<String, BTreeSet<String>>>::new();
    for (own, code) in &modules {
        for path in named_paths(own, code) {
            let known = (1..=path.len()).rev().map(|n| &path[..n]).find(|path| modules.contains_key(*path));
            let Some(used) = known else { continue };
            let shared = own.iter().zip(used).take_while(|(a, b)| a == b).count();
            if let (Some(from), Some(to)) = (own.get(shared), used.get(shared)) {
                let children = uses.entry(own[..shared].to_vec()).or_default();
                children.entry(from.clone()).or_default().insert(to.clone());
            }
        }
    }
    let mut circles = Vec::new();
    for (parent, children) in &uses {
        let uses_itself = |child: &String| {
            let (mut reached, mut open) = (BTreeSet::new(), vec![child]);
            while let Some(next) = open.pop() {
                open.extend(children.get(next).into_iter().flatten().filter(|to| reached.insert(*to)));
            }
            reached.contains(child)
        };
        let members: Vec<&str> =
            children.keys().filter(|child| uses_itself(child)).map(String::as_str).collect();
        if !members.is_empty() {
            circles.push(format!("{}: {}", parent.join("::"), members.join(", ")));
        }
    }
    circles
}

#[test]
fn no_modules_use_each_other_in_a_circle() {
    let root = root();
    for folder in fs::read_dir(root.join("crates")).unwrap().map(|entry| entry.unwrap().path()) {
        let name = folder.file_name().unwrap().to_str().unwrap();
        assert_eq!(circles(&folder.join("src")), Vec::<String>::new(), "{name}");
    }
}

/// The control: a circle is found, however its paths are written.
#[test]
fn a_circle_is_found() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("a")).unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("lib.rs", "mod a;\nmod b;\nmod c;\npub use b::B;\n");
    let tests = "#[cfg(test)]\nmod tests {\n    use crate::b::B;\n}\n";
    write("a/mod.rs", &format!("mod inner;\nuse crate::B;\n// use crate::b::B;\n{tests}"));
    write("a/inner.rs", "use super::super::c::C;\n");
    write("b.rs", "use crate::{c::C, a::{self, A}};\n");
    write("c.rs", "pub struct C;\n");
    assert_eq!(circles(folder.path()), Vec::<String>::new());
    write("c.rs", "fn f() -> super::b::B {}\n");
    assert_eq!(circles(folder.path()), [": a, b, c"]);
    write("c.rs", "pub struct C;\n");
    write("a/inner.rs", "use crate::{c::C, b};\n");
    assert_eq!(circles(folder.path()), [": a, b"]);
}

/// The files that a Markdown text links to, without anchors.
fn links(text: &str) -> impl Iterator<Item = &str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
    targets.filter(|target| {
        !target.is_empty() && !target.contains("://") && !target.contains(char::is_whitespace)
    })
}

#[test]
fn links_of_the_documentation_lead_to_files() {
    let root = root();
    let docs = fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = docs.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let mut count = 0;
    for page in pages.chain([root.join("README.md"), root.join("CHANGELOG.md")]) {
        for link in links(&fs::read_to_string(&page).unwrap()) {
            count += 1;
            assert!(page.parent().unwrap().join(link).exists(), "{}: {link}", page.display());
        }
    }
    assert!(count > 150, "{count} links");
}
