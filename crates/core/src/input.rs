//! What files are read from.

use std::fs;
use std::path::Path;

/// Whether a path leads to a pipe, a socket or a device. To open a pipe is to wait for a writer, a device may have no end, and neither
/// can be read twice.
pub fn is_pipe_or_device(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}
