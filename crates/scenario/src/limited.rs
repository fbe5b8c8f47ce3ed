//! Files that are read whole, but never more of them than a limit allows.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use locsim_core::limits::Limits;

use crate::{Problem, ScenarioError};

/// The bytes of a file, at most `most`, which is the limit called `name`. Pipes and devices may have no end.
///
/// # Errors
/// [`ScenarioError`] for a file that cannot be read or is larger.
pub fn read(path: &Path, name: &str, most: u64) -> Result<Vec<u8>, ScenarioError> {
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(most.saturating_add(1)).read_to_end(&mut bytes))
        .map_err(|source| ScenarioError::Read { path: path.to_owned(), source })?;
    let read = bytes.len() as u64;
    if read <= most {
        return Ok(bytes);
    }
    // Only regular files know their size.
    let size = fs::metadata(path).map_or(0, |found| found.len()).max(read);
    let problem = Problem::of_file(Limits::current().refusal(name, size));
    Err(ScenarioError::Invalid { file: path.to_owned(), problems: vec![problem] })
}
