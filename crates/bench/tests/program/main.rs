//! The program `locsim-bench` as a developer calls it.

mod regression;
mod speed;
mod suite;

use std::path::Path;

use assert_cmd::Command;
use assert_cmd::assert::Assert;

/// The program in a folder, with the arguments of a command line (no quotes: words are cut at blanks).
fn bench(folder: &Path, line: &str) -> Assert {
    let mut command = Command::new(env!("CARGO_BIN_EXE_locsim-bench"));
    command.current_dir(folder).args(line.split_whitespace()).assert()
}

/// Standard output of a call.
fn output(call: &Assert) -> String {
    String::from_utf8(call.get_output().stdout.clone()).unwrap()
}
