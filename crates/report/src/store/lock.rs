use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};

use same_file::Handle;

use super::StoreError;
use super::error::at;
use super::manifest::remove_file;

/// The right to write a folder. It ends with the process that holds it, however that ends.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    /// Locked as long as it is open.
    file: File,
}

impl Lock {
    /// Fails where another process has the lock at `path`, for results at `out`. Nothing is made or kept.
    ///
    /// # Errors
    /// [`StoreError::Held`], and [`StoreError::Foreign`] for something that is no file.
    pub fn check(path: &Path, out: &Path) -> Result<(), StoreError> {
        check_kind(path, out)?;
        // The caller that needs the file reports that it can't be opened.
        let Ok(file) = File::open(path) else { return Ok(()) };
        match file.try_lock_shared() {
            Err(TryLockError::WouldBlock) => Err(held(&file, out)),
            _ => Ok(()),
        }
    }

    /// Takes the lock at `path` for results at `out`.
    ///
    /// # Errors
    /// [`StoreError::Held`] where another process has it; [`StoreError::Foreign`], [`StoreError::File`].
    pub fn take(path: &Path, out: &Path) -> Result<Self, StoreError> {
        loop {
            check_kind(path, out)?;
            let mut open = OpenOptions::new();
            open.read(true).write(true).create(true).truncate(false);
            let mut file = match open.open(path) {
                // The folder of work that was just finished.
                Err(error) if error.kind() == ErrorKind::NotFound => {
                    let folder = path.parent().unwrap_or(Path::new("."));
                    fs::create_dir_all(folder).map_err(at(folder))?;
                    continue;
                }
                other => other.map_err(at(path))?,
            };
            match file.try_lock() {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Err(held(&file, out)),
                Err(TryLockError::Error(error)) => return Err(at(path)(error)),
            }
            // Whoever had it before may have removed the file meanwhile; a lock on that keeps nobody out.
            let mine = file.try_clone().and_then(Handle::from_file).map_err(at(path))?;
            if Handle::from_path(path).is_ok_and(|there| there == mine) {
                file.set_len(0).and_then(|()| file.rewind()).map_err(at(path))?;
                writeln!(file, "process {}{}", std::process::id(), on_host()).map_err(at(path))?;
                return Ok(Self { path: path.to_owned(), file });
            }
        }
    }

    /// Removes the lock's file while it is locked.
    ///
    /// # Errors
    /// [`StoreError`] for a file that cannot be removed.
    pub fn remove(self) -> Result<(), StoreError> {
        remove_file(&self.path)?;
        drop(self.file);
        Ok(())
    }
}

/// Refuses what is no file: a pipe would be waited for, and what a link leads to isn't ours.
fn check_kind(path: &Path, out: &Path) -> Result<(), StoreError> {
    match fs::symlink_metadata(path) {
        Ok(found) if !found.is_file() => {
            Err(StoreError::Foreign { out: out.to_owned(), found: path.to_owned() })
        }
        _ => Ok(()),
    }
}

/// The error of a lock that another process has.
fn held(file: &File, out: &Path) -> StoreError {
    let mut holder = String::new();
    // Who it is, if it has been written already.
    let _ = file.take(200).read_to_string(&mut holder);
    let holder = holder.trim();
    let holder = if holder.is_empty() { "another process" } else { holder }.to_owned();
    StoreError::Held { out: out.to_owned(), holder }
}

/// ` on NAME`: folders may be shared by machines.
fn on_host() -> String {
    sysinfo::System::host_name().map_or_else(String::new, |name| format!(" on {name}"))
}
