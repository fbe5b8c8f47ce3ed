//! Finished parts of long work, each in a file with a hash.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use locsim_core::output::write_file;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::StoreError;
use super::error::at;
use super::manifest::{is_temporary, remove_file};

const ENDING: &str = ".part";

/// A kept part.
#[derive(Debug, PartialEq)]
pub enum Part<T> {
    /// There is none.
    Missing,
    /// As it was kept.
    Whole(T),
    /// Its file was cut, altered, or is another part's.
    Damaged,
}

/// The folder of parts.
#[derive(Debug)]
pub struct Parts {
    folder: PathBuf,
    fingerprint: String,
}

impl Parts {
    pub(super) fn open(folder: PathBuf, fingerprint: &str) -> Result<Self, StoreError> {
        fs::create_dir_all(&folder).map_err(at(&folder))?;
        Ok(Self { folder, fingerprint: fingerprint.to_owned() })
    }

    fn file(&self, number: u32) -> PathBuf {
        self.folder.join(format!("{number:06}{ENDING}"))
    }

    /// The hash of a part: of its content, its number and the work that it belongs to.
    fn hash(&self, number: u32, content: &[u8]) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&(self.fingerprint.len() as u64).to_le_bytes()).update(self.fingerprint.as_bytes());
        hasher.update(&number.to_le_bytes()).update(content);
        hasher.finalize()
    }

    /// The part of this number.
    pub fn load<T: DeserializeOwned>(&self, number: u32) -> Part<T> {
        let bytes = match fs::read(self.file(number)) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == ErrorKind::NotFound => return Part::Missing,
            Err(_) => return Part::Damaged,
        };
        let Some((hash, content)) = bytes.split_first_chunk::<{ blake3::OUT_LEN }>() else {
            return Part::Damaged;
        };
        if self.hash(number, content) != blake3::Hash::from_bytes(*hash) {
            return Part::Damaged;
        }
        ciborium::from_reader(content).map_or(Part::Damaged, Part::Whole)
    }

    /// Keeps a part.
    ///
    /// # Errors
    /// [`StoreError::File`].
    pub fn save(&self, number: u32, part: &impl Serialize) -> Result<(), StoreError> {
        let path = self.file(number);
        let mut content = Vec::new();
        ciborium::into_writer(part, &mut content).map_err(std::io::Error::other).map_err(at(&path))?;
        let hash = self.hash(number, &content);
        write_file(&path, |file| {
            file.write_all(hash.as_bytes())?;
            file.write_all(&content)
        })
        .map_err(at(&path))
    }

    /// The number of parts.
    ///
    /// # Errors
    /// [`StoreError::File`] where the folder can't be read any more.
    pub fn kept(&self) -> Result<usize, StoreError> {
        Self::count(&self.folder).map(|count| count.unwrap_or(0))
    }

    /// The number of parts in a folder; the inner error is something that isn't a part.
    pub(super) fn count(folder: &Path) -> Result<Result<usize, PathBuf>, StoreError> {
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Ok(0)),
            Err(error) => return Err(at(folder)(error)),
        };
        let mut count = 0;
        for entry in entries {
            let entry = entry.map_err(at(folder))?;
            let is_file = entry.file_type().map_err(at(folder))?.is_file();
            if is_file && is_temporary(&entry.file_name()) {
                continue;
            }
            if !(is_file && is_part(&entry.path())) {
                return Ok(Err(entry.path()));
            }
            count += 1;
        }
        Ok(Ok(count))
    }

    /// Removes the parts in a folder, and the folder.
    pub(super) fn remove(folder: &Path) -> Result<(), StoreError> {
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
            Err(error) => return Err(at(folder)(error)),
        };
        for entry in entries {
            let path = entry.map_err(at(folder))?.path();
            if is_part(&path) || path.file_name().is_some_and(is_temporary) {
                remove_file(&path)?;
            }
        }
        fs::remove_dir(folder).map_err(at(folder))
    }
}

/// Whether a file has the name of a part: its number.
fn is_part(path: &Path) -> bool {
    let number = path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_suffix(ENDING));
    number.is_some_and(|number| number.len() >= 6 && number.bytes().all(|digit| digit.is_ascii_digit()))
}
