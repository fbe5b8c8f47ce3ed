//! Files that are read whole, but never more of them than a limit allows.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use locsim_core::input::is_pipe_or_device;
use locsim_core::limits::Limits;

use crate::{Problem, ScenarioError};

/// The bytes of a file, at most `most`, which is the limit called `name`.
///
/// # Errors
/// [`ScenarioError`] for a file that cannot be read or is larger, and for a pipe or a device.
pub fn read(path: &Path, name: &str, most: u64) -> Result<Vec<u8>, ScenarioError> {
    let refuse = |message: String| ScenarioError::Invalid {
        file: path.to_owned(),
        problems: vec![Problem::of_file(message)],
    };
    if is_pipe_or_device(path) {
        let what = "a file is needed; this is a pipe or a device, and it is read more than once";
        return Err(refuse(what.to_owned()));
    }
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(most.saturating_add(1)).read_to_end(&mut bytes))
        .map_err(|source| ScenarioError::Read { path: path.to_owned(), source })?;
    let read = bytes.len() as u64;
    if read <= most {
        return Ok(bytes);
    }
    // A file that grows may be longer by now.
    let size = fs::metadata(path).map_or(0, |found| found.len()).max(read);
    Err(refuse(Limits::current().refusal(name, size)))
}
