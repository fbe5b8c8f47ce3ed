//! The one way in which files are written: a temporary neighbour, synchronized, then renamed.
//!
//! A reader never sees half a file, and a failure leaves the old file. [`Output::check`] keeps a command from
//! overwriting its own inputs, and files that exist unless `--force` is given.

use std::borrow::Cow;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use same_file::Handle;
use tempfile::NamedTempFile;
use thiserror::Error;

/// Prefix and suffix of temporary files' names. A killed program leaves at most one behind.
pub const TEMPORARY: [&str; 2] = [".locsim-", ".tmp"];

/// Reasons for which a file isn't written.
#[derive(Debug, Error)]
pub enum OutputError {
    /// The command reads it.
    #[error("{} is not allowed; this command reads it", path.display())]
    Input {
        /// The file.
        path: PathBuf,
    },
    /// It is there already.
    #[error("{} is not allowed; it exists (--force replaces it)", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// It is not a regular file, but for example a folder or a device.
    #[error("{} is not allowed; it is no file", path.display())]
    NoFile {
        /// Its path.
        path: PathBuf,
    },
    /// The system can't.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

/// A path or a word as shells read it: in quotes where it has blanks and the like.
pub fn in_shell(word: impl AsRef<OsStr>) -> String {
    let text = word.as_ref().to_string_lossy();
    shlex::try_quote(&text).map_or_else(|_| text.to_string(), Cow::into_owned)
}

/// A file that a command is asked to write.
#[derive(Clone, Copy, Debug)]
pub struct Output<'a> {
    /// Its path.
    pub path: &'a Path,
    /// Whether an existing file may be replaced.
    pub force: bool,
    /// Files that the command reads.
    pub inputs: &'a [PathBuf],
}

impl Output<'_> {
    /// Whether the file may be written. Nothing is touched.
    ///
    /// # Errors
    /// [`OutputError`] for one of the inputs (under whatever name), for something that is no file, and for a file that is
    /// there, unless it is to be replaced.
    pub fn check(&self) -> Result<(), OutputError> {
        let path = || self.path.to_owned();
        let Ok(found) = fs::metadata(self.path) else { return Ok(()) };
        if !found.is_file() {
            return Err(OutputError::NoFile { path: path() });
        }
        if let Ok(handle) = Handle::from_path(self.path)
            && self.inputs.iter().any(|input| Handle::from_path(input).is_ok_and(|input| input == handle))
        {
            return Err(OutputError::Input { path: path() });
        }
        if self.force { Ok(()) } else { Err(OutputError::Exists { path: path() }) }
    }

    /// Writes files that belong together: [`Output::check`] of each, then all are staged, then each is put in its place.
    ///
    /// # Errors
    /// [`OutputError`]; before the first file is in its place, all are as they were.
    pub fn write_all(files: &[(Self, &[u8])]) -> Result<(), OutputError> {
        let failed = |output: &Self| {
            let path = output.path.to_owned();
            move |source| OutputError::Write { path, source }
        };
        for (output, _) in files {
            output.check()?;
        }
        let stage = |(output, bytes): &(Self, &[u8])| {
            Staged::new(output.path, |file| file.write_all(bytes)).map_err(failed(output))
        };
        let staged = files.iter().map(stage).collect::<Result<Vec<_>, _>>()?;
        staged
            .into_iter()
            .zip(files)
            .try_for_each(|(staged, (output, _))| staged.persist().map_err(failed(output)))
    }
}

/// Writes a whole file through `body`, in the place of one that is there.
///
/// # Errors
/// Errors of the system and of `body`; the file is then unchanged.
pub fn write_file(path: &Path, body: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    Staged::new(path, body)?.persist()
}

/// A file that is written and synchronized under a temporary name. Files that belong together are all staged before the
/// first takes its place, so that a full disk leaves the old ones.
#[derive(Debug)]
pub struct Staged {
    file: NamedTempFile,
    path: PathBuf,
}

impl Staged {
    /// Writes the file through `body`, beside `path`, in folders that are made where they aren't there.
    ///
    /// # Errors
    /// Errors of the system and of `body`; no file is left then.
    pub fn new(path: &Path, body: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<Self> {
        let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let [prefix, suffix] = TEMPORARY;
        let mut builder = tempfile::Builder::new();
        builder.prefix(prefix).suffix(suffix);
        // As other programs create files: for all whom the user's mask allows.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        fs::create_dir_all(folder)?;
        let file = builder.tempfile_in(folder).map_err(|error| without_name(&error))?;
        // Not through `NamedTempFile`, whose errors tell the temporary name.
        let mut writer = BufWriter::new(file.as_file());
        body(&mut writer)?;
        writer.into_inner()?.sync_all()?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// Puts the file in its place.
    ///
    /// # Errors
    /// Errors of the system; the old file then stays.
    pub fn persist(self) -> io::Result<()> {
        self.file.persist(&self.path).map(|_: File| ()).map_err(|error| error.error)
    }
}

/// The system's error without the temporary file's name, which means nothing to a user.
fn without_name(error: &io::Error) -> io::Error {
    let text = error.to_string();
    let (of_system, _) = text.split_once(" at path ").unwrap_or((&text, ""));
    io::Error::new(error.kind(), of_system)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_quoted_where_a_shell_needs_it() {
        for (path, is_plain) in [
            ("scenarios/my-robot_2.yaml", true),
            ("my drive.yaml", false),
            ("it's $HOME (2).yaml", false),
            ("", false),
        ] {
            let written = in_shell(Path::new(path));
            assert_eq!(written == path, is_plain, "{written}");
            assert_eq!(shlex::split(&written).unwrap(), [path]);
        }
    }

    #[test]
    fn a_failure_leaves_what_was_there_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        write_file(&path, |file| file.write_all(b"old")).unwrap();
        let failed = write_file(&path, |file| {
            file.write_all(b"new")?;
            Err(io::Error::other("full"))
        });
        assert_eq!(failed.unwrap_err().to_string(), "full");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn folders_are_made_and_one_that_cannot_be_is_told_as_the_system_tells_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none/a");
        write_file(&path, |file| file.write_all(b"1")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"1");
        let error = write_file(&path.join("b"), |_| Ok(())).unwrap_err();
        assert_eq!(error.to_string(), fs::create_dir_all(&path).unwrap_err().to_string());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn errors_are_the_systems_without_the_temporary_name() {
        let error = write_file(Path::new("/proc/a"), |_| Ok(())).unwrap_err();
        assert_eq!(error.to_string(), "No such file or directory (os error 2)");
    }

    #[cfg(unix)]
    #[test]
    fn an_input_is_known_under_every_name_and_never_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("input"), "precious").unwrap();
        fs::hard_link(at("input"), at("hard")).unwrap();
        std::os::unix::fs::symlink(at("input"), at("soft")).unwrap();
        for name in ["input", "hard", "soft", "./input"] {
            let path = at(name);
            let output = Output { path: &path, force: true, inputs: &[at("missing"), at("input")] };
            assert!(matches!(Output::write_all(&[(output, b"x")]), Err(OutputError::Input { .. })), "{name}");
        }
        assert_eq!(fs::read(at("input")).unwrap(), b"precious");
    }

    #[test]
    fn what_is_there_is_replaced_only_when_asked_for_and_only_if_it_is_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let write =
            |force, bytes: &[u8]| Output::write_all(&[(Output { path: &path, force, inputs: &[] }, bytes)]);
        write(false, b"1").unwrap();
        assert!(matches!(write(false, b"2"), Err(OutputError::Exists { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"1");
        write(true, b"3").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"3");
        let folder = Output { path: folder.path(), force: true, inputs: &[] };
        assert!(matches!(Output::write_all(&[(folder, b"4")]), Err(OutputError::NoFile { .. })));
    }

    #[test]
    fn of_files_that_belong_together_all_are_written_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let [image, text] = ["a.pgm", "a.pgm/a.yaml"].map(|name| folder.path().join(name));
        fs::write(&image, "old").unwrap();
        let output = |path| Output { path, force: true, inputs: &[] };
        let failed = Output::write_all(&[(output(&image), b"new"), (output(&text), b"new")]);
        assert!(matches!(failed, Err(OutputError::Write { path, .. }) if path == text));
        assert_eq!(fs::read(&image).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
