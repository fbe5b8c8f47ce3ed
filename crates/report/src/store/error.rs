use std::io;
use std::path::{Path, PathBuf};

use locsim_core::limits::quoted;
use thiserror::Error;

/// Why a results folder can't be used.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The path has no last part that a folder could be called by.
    #[error("--out: {} is not allowed; a folder with a name of its own", out.display())]
    NoName {
        /// The path.
        out: PathBuf,
    },
    /// The results folder has something in it.
    #[error(
        "--out: {} is not allowed; it isn't empty. Name another folder, or add --force to replace results of locsim",
        out.display()
    )]
    NotEmpty {
        /// The results folder.
        out: PathBuf,
    },
    /// The place of the results folder is taken by a file.
    #[error("--out: {} is not allowed; it is a file, and a folder is needed", quoted(&out.display().to_string()))]
    NoFolder {
        /// The path.
        out: PathBuf,
    },
    /// The name is longer than the file system takes, with the endings of the folders beside it.
    #[error("--out: {} is not allowed; the name is too long", quoted(&out.display().to_string()))]
    LongName {
        /// The path.
        out: PathBuf,
    },
    /// A link that leads nowhere.
    #[error("--out: {} is not allowed; it is a link to something that isn't there", quoted(&out.display().to_string()))]
    DanglingLink {
        /// The link.
        out: PathBuf,
    },
    /// The run that was to go on is complete.
    #[error("--resume: {} holds finished results, which are not extended; --force begins again", quoted(&out.display().to_string()))]
    Complete {
        /// The results folder.
        out: PathBuf,
    },
    /// Work can't go on there: it is of something else.
    #[error(
        "--out: {} is not allowed; it holds something other than this suite with its scenario, size, seed and options. \
         Name another folder",
        out.display()
    )]
    OtherWork {
        /// The folder.
        out: PathBuf,
    },
    /// Something that locsim didn't write, or that was changed since, would have to be removed.
    #[error(
        "--out: {} is not allowed; {} isn't as locsim wrote it, and stays. Move it away, or name another folder",
        out.display(),
        found.display()
    )]
    Foreign {
        /// The results folder.
        out: PathBuf,
        /// The path in the way.
        found: PathBuf,
    },
    /// Another process works on the same results.
    #[error("--out: {} is not allowed; {holder} is writing it", out.display())]
    Held {
        /// The results folder.
        out: PathBuf,
        /// Who, as far as it is known.
        holder: String,
    },
    /// Interrupted work would be lost.
    #[error(
        "{} keeps {parts} finished parts of an interrupted run; --resume goes on with them, --force begins again",
        partial.display()
    )]
    Kept {
        /// The folder of the work.
        partial: PathBuf,
        /// Number of finished parts.
        parts: usize,
    },
    /// The interrupted work is of something else.
    #[error(
        "--resume: {} keeps {parts} finished parts of another scenario, seed, option or version of locsim; \
         name another folder, or add --force to begin again",
        partial.display()
    )]
    Other {
        /// The folder of the work.
        partial: PathBuf,
        /// Number of finished parts.
        parts: usize,
    },
    /// The system can't read or write something.
    #[error("{}: {source}", path.display())]
    File {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

/// Attaches a path to a system error.
pub(super) fn at(path: &Path) -> impl FnOnce(io::Error) -> StoreError {
    let path = path.to_owned();
    move |source| StoreError::File { path, source }
}
