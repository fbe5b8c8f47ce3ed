use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use locsim_core::output::write_file;

use super::error::at;
use super::manifest::{MANIFEST, hash};
use super::{Manifest, StoreError};

/// A folder that results are written to. Each file is in its manifest before it is there.
#[derive(Debug)]
pub struct Folder {
    root: PathBuf,
    manifest: Mutex<Manifest>,
}

impl Folder {
    /// A new folder for results that don't belong to a run, at a place where nothing is.
    ///
    /// # Errors
    /// [`StoreError::NotEmpty`] for a folder with something in it, and [`StoreError::File`].
    pub fn new(root: &Path) -> Result<Self, StoreError> {
        if !is_empty(root) {
            return Err(StoreError::NotEmpty { out: root.to_owned() });
        }
        Self::create(root, Manifest::new("report", ""))
    }

    /// A folder with this manifest, whose files are there already.
    pub(crate) fn create(root: &Path, manifest: Manifest) -> Result<Self, StoreError> {
        fs::create_dir_all(root).map_err(at(root))?;
        manifest.write(&root.join(MANIFEST))?;
        Ok(Self { root: root.to_owned(), manifest: Mutex::new(manifest) })
    }

    /// A folder that work goes on in: with the same `kind` and `fingerprint`, or new where nothing is. What else is in it
    /// stays.
    ///
    /// # Errors
    /// [`StoreError::OtherWork`] for a folder of something else, and [`StoreError::File`].
    pub fn go_on(root: &Path, kind: &str, fingerprint: &str) -> Result<Self, StoreError> {
        match Manifest::read(&root.join(MANIFEST))? {
            Some(found) if found.kind == kind && found.fingerprint == fingerprint => {
                Ok(Self { root: root.to_owned(), manifest: Mutex::new(found) })
            }
            None if is_empty(root) => Self::create(root, Manifest::new(kind, fingerprint)),
            _ => Err(StoreError::OtherWork { out: root.to_owned() }),
        }
    }

    /// Fails for a file that somebody else has put there or changed.
    ///
    /// # Errors
    /// [`StoreError::Foreign`], and [`StoreError::File`].
    pub fn check(&self, name: &str) -> Result<(), StoreError> {
        let path = self.root.join(name);
        if path.symlink_metadata().is_ok() && self.read(name)?.is_none() {
            return Err(StoreError::Foreign { out: self.root.clone(), found: path });
        }
        Ok(())
    }

    /// The folder's path.
    pub fn path(&self) -> &Path {
        &self.root
    }

    fn manifest(&self) -> MutexGuard<'_, Manifest> {
        // A list of names is whole after every insertion.
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn list(&self, name: &str, hash: String) -> Result<(), StoreError> {
        let mut manifest = self.manifest();
        manifest.files.insert(name.to_owned(), hash);
        manifest.write(&self.root.join(MANIFEST))
    }

    /// Writes a file; `name` is its path in the folder, parts joined by `/`.
    ///
    /// # Errors
    /// [`StoreError::File`].
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), StoreError> {
        self.list(name, blake3::hash(bytes).to_hex().to_string())?;
        let path = self.place(name)?;
        write_file(&path, |file| file.write_all(bytes)).map_err(at(&path))
    }

    /// The path of a file that something else will write.
    ///
    /// # Errors
    /// [`StoreError::File`].
    pub fn claim(&self, name: &str) -> Result<PathBuf, StoreError> {
        self.list(name, String::new())?;
        self.place(name)
    }

    /// The path of a file; the folder that it is in is made.
    fn place(&self, name: &str) -> Result<PathBuf, StoreError> {
        let path = self.root.join(name);
        let folder = path.parent().unwrap_or(&self.root);
        fs::create_dir_all(folder).map_err(at(folder))?;
        Ok(path)
    }

    /// The content of a file, if it is as it was written.
    ///
    /// # Errors
    /// [`StoreError::File`] for a file that is there and can't be read.
    pub fn read(&self, name: &str) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(listed) = self.manifest().files.get(name).cloned() else { return Ok(None) };
        let path = self.root.join(name);
        if !path.is_file() {
            return Ok(None);
        }
        let bytes = fs::read(&path).map_err(at(&path))?;
        Ok((blake3::hash(&bytes).to_hex().as_str() == listed).then_some(bytes))
    }

    /// Notes the hashes of files that something else has written.
    pub(super) fn complete(&self) -> Result<(), StoreError> {
        let mut manifest = self.manifest();
        // Files that were claimed and never written don't exist.
        manifest.files.retain(|name, hash| !hash.is_empty() || self.root.join(name).is_file());
        for (name, listed) in &mut manifest.files {
            if listed.is_empty() {
                *listed = hash(&self.root.join(name))?;
            }
        }
        manifest.write(&self.root.join(MANIFEST))
    }
}

/// Whether nothing is in a folder but perhaps the lock of whoever asks.
fn is_empty(root: &Path) -> bool {
    fs::read_dir(root).map_or(true, |entries| entries.flatten().all(|entry| entry.file_name() == super::LOCK))
}
