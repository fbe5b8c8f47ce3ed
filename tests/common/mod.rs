//! Shared parts of the tests of the program: a folder with a small world in it, and the program as a user calls it there.

use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::Command;
use assert_cmd::assert::Assert;
use tempfile::TempDir;

/// A room of 3.2 m x 2 m with a recess and a pillar.
const ROOM: &str = "
outline:
  name: room
  points_m: [[0, 0], [3.2, 0], [3.2, 0.8], [3.6, 0.8], [3.6, 1.4], [3.2, 1.4], [3.2, 2], [0, 2]]
obstacles:
  - {name: pillar, points_m: [[1.5, 1.5], [1.8, 1.5], [1.8, 1.8], [1.5, 1.8]]}
";

/// 21 scans along a straight path through the room, three trials. The blocks and the models stand on lines that
/// tests replace.
pub const SCENARIO: &str = "\
name: room
description: A short drive through a small room
seed: 3
trials: 3
map: {file: room.yaml}
ray_cast: {method: table, cell_m: 0.1}
blocks: {per_metre_of_wall: 0.3, length_m: [0.2, 0.4], width_m: [0.2, 0.4], wall_distance_m: [0.0, 0.3]}
robot:
  path: {waypoints: {points_m: [[0.6, 0.9], [2.6, 0.9]], speed_m_s: 0.5, turn_rate_deg_s: 45}}
  odometry_noise: {alpha: [0.05, 0.02, 0.05, 0.01]}
laser: {rate_hz: 5, beams: 12, max_range_m: 3, noise: {sigma_m: 0.02}}
training: {poses: 24, observations: 24}
models: [classic, np_reg_registered]
filter:
  particles: 100
  motion: {model: odometry, alpha: [0.1, 0.05, 0.1, 0.05]}
  start: {tracking: {sigma_m: 0.1, sigma_deg: 3}}
";

/// A folder that holds `room.yaml` and `room-run.yaml`.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        folder.write("room.yaml", ROOM);
        folder.write("room-run.yaml", SCENARIO);
        folder
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).unwrap();
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Calls the program in the folder, without the data that this machine may have.
    pub fn locsim(&self, line: &str) -> Assert {
        locsim(self.0.path(), line).env_remove("LOCSIM_DATA").assert()
    }
}

/// The program with the arguments of a command line (no quotes: words are cut at blanks).
pub fn locsim(folder: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_locsim"));
    // Not in the cache folder of whoever runs the tests.
    command.current_dir(folder).env("LOCSIM_CACHE", folder.join(".cache")).args(line.split_whitespace());
    command
}

/// The text with one part replaced, which must be there.
pub fn edited(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from:?} is not in the text");
    text.replacen(from, to, 1)
}

/// Standard output of a call.
pub fn output(call: &Assert) -> String {
    String::from_utf8(call.get_output().stdout.clone()).unwrap()
}
