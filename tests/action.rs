//! The step that a workflow runs (`action.yml`), as a runner runs it.

#[allow(dead_code, reason = "the calls of the other tests aren't needed here")]
mod common;

use std::collections::BTreeSet;
use std::process::Output;

use common::{Folder, SCENARIO};

const RUN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tools/action/run.sh");
const ACTION: &str = include_str!("../action.yml");

/// The script with the page of a job.
fn run(folder: &Folder, scenarios: &[&str]) -> Output {
    std::process::Command::new(RUN)
        .arg("results")
        .args(scenarios)
        .current_dir(folder.path(""))
        .env("LOCSIM", env!("CARGO_BIN_EXE_locsim"))
        .env("LOCSIM_CACHE", folder.path(".cache"))
        .env("LOCSIM_OPTIONS", "--record none --trials 1")
        .env("GITHUB_STEP_SUMMARY", folder.path("page.md"))
        .output()
        .unwrap()
}

#[test]
fn reports_are_on_the_page_of_the_job_and_bounds_decide() {
    let folder = Folder::new();
    let kept = format!("{SCENARIO}expect: {{classic: {{position_rmse_m: {{max: 100}}}}}}\n");
    let missed = kept.replace("max: 100", "max: 0.000001").replace("name: room", "name: narrow");
    folder.write("kept.yaml", &kept);
    folder.write("missed.yaml", &missed);

    let done = run(&folder, &["kept.yaml"]);
    assert_eq!(done.status.code(), Some(0), "{done:?}");
    let page = String::from_utf8(folder.read("page.md")).unwrap();
    assert!(page.starts_with("# room") && page.contains("| np_reg_registered |"), "{page}");
    assert!(!page.contains("![") && !page.contains("missed:"), "{page}");
    assert!(folder.path("results/kept/report.html").exists());

    // One after the other: the page has both, and the worst decides.
    std::fs::remove_dir_all(folder.path("results")).unwrap();
    let done = run(&folder, &["missed.yaml", "kept.yaml"]);
    assert_eq!(done.status.code(), Some(1), "{done:?}");
    let page = String::from_utf8(folder.read("page.md")).unwrap();
    assert!(page.contains("# narrow") && page.contains("missed: classic.position_rmse_m"), "{page}");
    assert!(folder.path("results/kept/report.html").exists());

    // A folder with results isn't overwritten, and the page says why nothing ran.
    let done = run(&folder, &["kept.yaml", "none.yaml"]);
    assert_eq!(done.status.code(), Some(2), "{done:?}");
    let page = String::from_utf8(folder.read("page.md")).unwrap();
    assert!(page.contains("`locsim run` ended with exit code 2") && page.contains("none.yaml"), "{page}");
    assert_eq!(std::process::Command::new(RUN).output().unwrap().status.code(), Some(2));
}

/// Every input that the steps use is declared, and every declared one is used; the script is where the step looks for it.
#[test]
fn the_action_uses_the_inputs_that_it_declares() {
    let (declared, steps) = ACTION.split_once("\nruns:").unwrap();
    let declared: BTreeSet<&str> = declared
        .split_once("\ninputs:")
        .and_then(|(_, rest)| rest.split_once("\noutputs:"))
        .map(|(inputs, _)| inputs)
        .unwrap()
        .lines()
        .filter_map(|line| line.strip_prefix("  ").filter(|key| !key.starts_with(' ')))
        .filter_map(|key| key.strip_suffix(':'))
        .collect();
    let used: BTreeSet<&str> = steps
        .split("inputs.")
        .skip(1)
        .map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap())
        .collect();
    assert_eq!(used, declared);
    assert!(steps.contains("$GITHUB_ACTION_PATH/tools/action/run.sh"));
}

/// What `cargo binstall` asks for is what a release holds, and everything is built with the oldest Rust that the crates are for.
#[test]
fn the_release_is_where_binstall_looks_for_it() {
    const MANIFEST: &str = include_str!("../crates/cli/Cargo.toml");
    const RELEASE: &str = include_str!("../.github/workflows/release.yml");
    const DOCKERFILE: &str = include_str!("../Dockerfile");
    const EXAMPLE: &str = include_str!("../docs/example-ci.yml");
    let asset = "locsim-{ target }.tar.gz";
    assert!(
        MANIFEST.contains(&format!("pkg-url = \"{{ repo }}/releases/download/v{{ version }}/{asset}\"\n"))
    );
    assert!(MANIFEST.contains("bin-dir = \"locsim-{ target }/{ bin }{ binary-ext }\"\n"));
    assert!(MANIFEST.contains("pkg-fmt = \"tgz\"\n") && MANIFEST.contains("\nname = \"locsim\"\n"));
    let packed = asset.replace("{ target }", "$TARGET");
    assert!(RELEASE.contains(&format!("tar -C release -czf \"{packed}\" \"locsim-$TARGET\"\n")));
    assert!(
        RELEASE.contains("tags: [\"v*\"]")
            && RELEASE.contains("cargo build --release --locked --package locsim ")
    );

    let rust = env!("CARGO_PKG_RUST_VERSION");
    assert!(
        ACTION.contains(&format!("rustup toolchain install {rust} "))
            && ACTION.contains(&format!("cargo +{rust} install"))
    );
    assert!(RELEASE.contains(&format!("rustup default {rust}\n")));
    assert!(DOCKERFILE.contains(&format!("FROM rust:{rust}-")));
    for root in ["/opt/locsim", "$HOME/locsim"] {
        let built = if root.starts_with('/') { DOCKERFILE } else { ACTION };
        assert!(built.contains("--path crates/cli") || built.contains("/crates/cli\""));
        assert!(built.contains(&format!("{root}/bin/locsim")), "{root}");
    }
    assert!(EXAMPLE.contains(concat!("OWNER/locsim@v", env!("CARGO_PKG_VERSION"), "\n")));
}
