use std::io;
use std::path::PathBuf;

use locsim_core::LaserError;
use thiserror::Error;

/// Why a log or a trajectory could not be read or written. Line numbers count from 1.
#[derive(Debug, Error)]
pub enum DatasetError {
    /// The file can't be opened.
    #[error("{}: cannot be opened: {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The file can't be read on, for example because its compressed data are damaged or cut.
    #[error("{}:{line}: cannot be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The line that was to be read.
        line: usize,
        /// The error of the system or the decompressor.
        source: io::Error,
    },
    /// The file's first bytes are not those of a log.
    #[error("{}: this is {found}; allowed: {allowed}", path.display())]
    NotALog {
        /// The file.
        path: PathBuf,
        /// The apparent type of the file.
        found: &'static str,
        /// The allowed content.
        allowed: &'static str,
    },
    /// The log costs more than the limits allow, or has content that a log must not have.
    #[error("{}{}: {reason}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
    Refused {
        /// The file.
        path: PathBuf,
        /// The line, where the file is a text.
        line: Option<usize>,
        /// The defect, and the allowed content.
        reason: String,
    },
    /// The file holds nothing, or nothing but blank lines and comments.
    #[error("{}: the file is empty", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The last line has no line end.
    #[error(
        "{}:{line}: {keyword}: the file ends inside this line, so it was cut off; \
         allowed: every line ends with a newline",
        path.display()
    )]
    CutOff {
        /// The file.
        path: PathBuf,
        /// The last line.
        line: usize,
        /// Its first word.
        keyword: Box<str>,
    },
    /// A line is longer than any line of a log.
    #[error("{}:{line}: the line is too long for a text log; allowed: at most {limit} bytes", path.display())]
    LongLine {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The greatest allowed length in bytes.
        limit: usize,
    },
    /// A line has too few or too many fields, counting its keyword.
    #[error("{}:{line}: {keyword}: the line has {found} fields; allowed: {allowed}", path.display())]
    FieldCount {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The line's keyword.
        keyword: Box<str>,
        /// Number of fields found.
        found: usize,
        /// Number of fields the format asks for, and why.
        allowed: Box<str>,
    },
    /// A field has a value that isn't allowed.
    #[error("{}:{line}: {keyword}: {field} is `{value}`; allowed: {allowed}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The line's keyword.
        keyword: Box<str>,
        /// The meaning of the field.
        field: Box<str>,
        /// The offending value.
        value: Box<str>,
        /// The allowed values.
        allowed: Box<str>,
    },
    /// The log has no scan of the wanted laser.
    #[error("{}: no scan in this log; allowed: at least one {wanted} line; found: {found}", path.display())]
    NoScans {
        /// The file.
        path: PathBuf,
        /// Keywords of the wanted laser.
        wanted: String,
        /// The keywords of the log.
        found: String,
    },
    /// The file isn't a complete MCAP file, or its content is damaged.
    #[error(
        "{}: not a complete MCAP file: {reason}; allowed: a file that was closed \
         (`mcap recover` mends one that was cut off)",
        path.display()
    )]
    Mcap {
        /// The file.
        path: PathBuf,
        /// The defect.
        reason: String,
    },
    /// The file isn't a bag that `rosbag2` wrote to `SQLite`, or its content is damaged.
    #[error("{}: not a sound bag in SQLite: {reason}; allowed: a file that `ros2 bag record` closed", path.display())]
    Sqlite {
        /// The file.
        path: PathBuf,
        /// The defect.
        reason: String,
    },
    /// The folder isn't one bag.
    #[error("{}: {reason}; allowed: the folder of one bag, as `ros2 bag record` writes it", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The defect.
        reason: String,
    },
    /// The bag has no topic, or several, of a needed type.
    #[error("{}: {reason}; found: {found}", path.display())]
    Topic {
        /// The file.
        path: PathBuf,
        /// The needed type, and the ways to name a topic.
        reason: String,
        /// The topics of the file, with types and numbers of messages.
        found: String,
    },
    /// A message of a bag has content that isn't allowed.
    #[error("{}: {topic}: message {number}: {reason}", path.display())]
    Message {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Which of the topic's messages, counted from 1 in the order of the file.
        number: usize,
        /// The defect, and the allowed content.
        reason: String,
    },
    /// No scan was taken while there was odometry.
    #[error(
        "{}: none of the {scans} scans, from {:.3} s to {:.3} s, lies within the time of the odometry{}; allowed: stamps of \
         one clock",
        path.display(), scan_secs[0], scan_secs[1],
        odometry_secs.map_or_else(String::new, |[from, to]| format!(", from {from:.3} s to {to:.3} s"))
    )]
    NoOdometry {
        /// The file.
        path: PathBuf,
        /// Number of scans.
        scans: usize,
        /// Stamps of the first and the last of them (s).
        scan_secs: [f64; 2],
        /// Times of the odometry (s), where it has any.
        odometry_secs: Option<[f64; 2]>,
    },
    /// The log or the options describe an impossible laser.
    #[error("{}: {source}", path.display())]
    Laser {
        /// The file.
        path: PathBuf,
        /// The defect.
        source: LaserError,
    },
    /// The drive or trajectory doesn't fit into the format.
    #[error("{}: not written: {reason}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// The part that doesn't fit, and the allowed values.
        reason: String,
    },
    /// The file can't be written; an old file is unchanged.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}
