//! The Python package: pytest on the extension module of this build, without an installation. It is skipped where Python, numpy
//! or pytest aren't there, and the test says so; `LOCSIM_PYTHON` names an interpreter (or `python3`).

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Python's modules without which no test can run.
const NEEDED: &str = "import sys, numpy, pytest; sys.exit(sys.version_info < (3, 11))";

fn python() -> Command {
    Command::new(std::env::var_os("LOCSIM_PYTHON").unwrap_or_else(|| "python3".into()))
}

/// Cargo leaves the extension module beside the test, and the program beside that folder.
fn deps() -> PathBuf {
    std::env::current_exe().unwrap().parent().unwrap().to_owned()
}

/// The package with its sources and the extension module, as a wheel would install it.
fn install(folder: &Path) {
    let package = folder.join("locsim");
    fs::create_dir(&package).unwrap();
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/locsim");
    for entry in fs::read_dir(sources).unwrap().map(Result::unwrap) {
        if entry.file_type().unwrap().is_file() {
            fs::copy(entry.path(), package.join(entry.file_name())).unwrap();
        }
    }
    let module = format!("{}_locsim{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    fs::copy(deps().join(module), package.join("_locsim.abi3.so")).unwrap();
}

#[test]
fn pytest() {
    if cfg!(windows) || !python().args(["-c", NEEDED]).status().is_ok_and(|status| status.success()) {
        eprintln!("skipped: a Python from 3.11 on with numpy and pytest isn't there");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    install(folder.path());
    let mut tests = python();
    tests
        .args(["-m", "pytest", "-q", "-p", "no:cacheprovider", "-rs", "."])
        .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests"))
        .env("PYTHONPATH", folder.path())
        .env("PYTHONDONTWRITEBYTECODE", "1");
    let program = deps().join("../locsim");
    if program.is_file() {
        tests.env("LOCSIM_PROGRAM", program);
    }
    assert!(tests.status().unwrap().success());
}
