//! The kind of a results folder, and the files in it that belong to locsim.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use locsim_core::output::{TEMPORARY, write_file};
use serde::{Deserialize, Serialize};

use super::StoreError;
use super::error::at;

/// The manifest's name in its folder.
pub(super) const MANIFEST: &str = "manifest.json";

/// Named in a manifest, so that no other program's is taken for ours.
const PROGRAM: &str = "locsim";

/// Version of the format of manifests and parts.
const FORMAT: u32 = 1;

/// A manifest is longer than this only if it isn't ours.
const LONGEST: u64 = 64 << 20;

/// Folders in a results folder are nested no deeper.
const DEEPEST: usize = 4;

/// Kind and files of a results folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Manifest {
    program: String,
    format: u32,
    /// The command that wrote the results: `run`, `study`, `gap`, `gap-bench` (of `locsim-bench gap`), `sweeps`.
    pub kind: String,
    /// Version of the program.
    version: String,
    /// Hash of all that the results depend on.
    pub fingerprint: String,
    /// Files by their path in the folder, parts joined by `/`, with the BLAKE3 hash of their content; empty while one is
    /// being written.
    pub files: BTreeMap<String, String>,
}

/// The state of a results folder's path.
#[derive(Debug)]
pub(super) enum State {
    /// Nothing.
    Absent,
    /// An empty folder.
    Empty,
    /// Files of a manifest, each as it was written, and nothing else.
    Results(Manifest),
    /// Something else: this.
    Foreign(PathBuf),
}

impl Manifest {
    pub fn new(kind: &str, fingerprint: &str) -> Self {
        Self {
            program: PROGRAM.to_owned(),
            format: FORMAT,
            kind: kind.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            fingerprint: fingerprint.to_owned(),
            files: BTreeMap::new(),
        }
    }

    /// The manifest in a file; `None` where there is none of ours.
    pub fn read(path: &Path) -> Result<Option<Self>, StoreError> {
        let length = match fs::symlink_metadata(path) {
            Ok(found) if found.is_file() => found.len(),
            Ok(_) => return Ok(None),
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(at(path)(error)),
        };
        if length > LONGEST {
            return Ok(None);
        }
        let bytes = fs::read(path).map_err(at(path))?;
        let manifest: Option<Self> = serde_json::from_slice(&bytes).ok();
        Ok(manifest.filter(|found| found.program == PROGRAM && found.format == FORMAT))
    }

    pub fn write(&self, path: &Path) -> Result<(), StoreError> {
        let write = |file: &mut dyn Write| {
            serde_json::to_writer_pretty(&mut *file, self)?;
            file.write_all(b"\n")
        };
        write_file(path, write).map_err(at(path))
    }

    /// The state of a results folder's path. Links aren't followed: their targets don't belong to locsim.
    pub(super) fn state(folder: &Path) -> Result<State, StoreError> {
        let entries = match fs::symlink_metadata(folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(State::Absent),
            Err(error) => return Err(at(folder)(error)),
            Ok(found) if !found.is_dir() => return Ok(State::Foreign(folder.to_owned())),
            Ok(_) => fs::read_dir(folder).map_err(at(folder))?,
        };
        let Some(manifest) = Self::read(&folder.join(MANIFEST))? else {
            // The first in the order of names, so that the message is the same each time. The manifest is written before all
            // else, so that a kill may leave its temporary file alone.
            let names = entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<Vec<_>, _>>();
            return Ok(match names {
                Ok(names) => names
                    .into_iter()
                    .filter(|path| !path.is_file() || !is_temporary(path.file_name().unwrap_or_default()))
                    .min()
                    .map_or(State::Empty, State::Foreign),
                Err(_) => State::Foreign(folder.to_owned()),
            });
        };
        let foreign = files(folder, &mut |path, name| Ok(!manifest.is_ours(path, name)?))?;
        Ok(foreign.map_or(State::Results(manifest), State::Foreign))
    }

    /// Whether a file is listed, and as it was written. One that was being written has no hash yet. A folder, whose name ends in `/`, is
    /// ours where a listed file belongs in it.
    fn is_ours(&self, path: &Path, name: &str) -> Result<bool, StoreError> {
        if name.ends_with('/') {
            return Ok(self.files.keys().any(|file| file.starts_with(name)));
        }
        if name == MANIFEST || is_temporary(path.file_name().unwrap_or_default()) {
            return Ok(true);
        }
        match self.files.get(name).map(String::as_str) {
            None => Ok(false),
            Some("") => Ok(true),
            Some(listed) => Ok(hash(path)? == listed),
        }
    }
}

/// BLAKE3 hash of a file.
pub(super) fn hash(path: &Path) -> Result<String, StoreError> {
    let mut hasher = blake3::Hasher::new();
    let file = File::open(path).map_err(at(path))?;
    hasher.update_reader(file).map_err(at(path))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Whether a name is that of a file that was being written.
pub(super) fn is_temporary(name: &OsStr) -> bool {
    let [begin, end] = TEMPORARY;
    name.to_str().is_some_and(|name| name.starts_with(begin) && name.ends_with(end))
}

/// The first file or folder under a folder, in the order of names and what is in a folder before it, that `is_wanted` by its path and its
/// name in the folder; names of folders end in `/`. What is neither file nor folder, lies too deep, or has a name that isn't text is wanted always.
fn files(
    folder: &Path,
    is_wanted: &mut dyn FnMut(&Path, &str) -> Result<bool, StoreError>,
) -> Result<Option<PathBuf>, StoreError> {
    fn visit(
        folder: &Path,
        prefix: &str,
        depth: usize,
        is_wanted: &mut dyn FnMut(&Path, &str) -> Result<bool, StoreError>,
    ) -> Result<Option<PathBuf>, StoreError> {
        let mut entries =
            fs::read_dir(folder).and_then(Iterator::collect::<Result<Vec<_>, _>>).map_err(at(folder))?;
        entries.sort_by_key(fs::DirEntry::file_name);
        for entry in entries {
            let path = entry.path();
            let kind = entry.file_type().map_err(at(&path))?;
            let name = entry.file_name().to_str().map(|name| format!("{prefix}{name}"));
            let found = match name {
                Some(name) if kind.is_file() => is_wanted(&path, &name)?.then(|| path.clone()),
                Some(name) if kind.is_dir() && depth < DEEPEST => {
                    let name = format!("{name}/");
                    match visit(&path, &name, depth + 1, is_wanted)? {
                        None => is_wanted(&path, &name)?.then(|| path.clone()),
                        found => found,
                    }
                }
                _ => Some(path.clone()),
            };
            if found.is_some() {
                return Ok(found);
            }
        }
        Ok(None)
    }
    visit(folder, "", 0, is_wanted)
}

/// Removes a results folder: the files of its manifest, then the folders that are empty, the manifest last.
pub(super) fn remove(folder: &Path) -> Result<(), StoreError> {
    match Manifest::state(folder)? {
        State::Absent => return Ok(()),
        State::Foreign(found) => return Err(StoreError::Foreign { out: folder.to_owned(), found }),
        State::Empty | State::Results(_) => {}
    }
    files(folder, &mut |path, name| {
        if name.ends_with('/') {
            fs::remove_dir(path).map_err(at(path))?;
        } else if name != MANIFEST {
            remove_file(path)?;
        }
        Ok(false)
    })?;
    remove_file(&folder.join(MANIFEST))?;
    fs::remove_dir(folder).map_err(at(folder))
}

/// Removes what a kill left of files that were being written.
pub(super) fn remove_temporary(folder: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(folder).map_err(at(folder))? {
        let entry = entry.map_err(at(folder))?;
        if is_temporary(&entry.file_name()) {
            remove_file(&entry.path())?;
        }
    }
    Ok(())
}

/// Removes a file that may be gone already.
pub(super) fn remove_file(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(at(path)(error)),
        _ => Ok(()),
    }
}
