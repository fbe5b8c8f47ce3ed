use std::io::Write;
use std::path::{Path, PathBuf};

use locsim_core::Drive;
use locsim_core::limits::{Limits, quoted};
use serde::Serialize;

use crate::carmen::{self, encode_carmen};
use crate::output::write_whole;
use crate::quality::unlikely_units;
use crate::ros::{self, encode_mcap};
use crate::source::{self, BEESOFT_MAP, Content, LOGS, Source, not_a_log};
use crate::{BagOptions, BagTopics, CarmenOptions, DatasetError, LogContents, LogSummary};

/// The formats of measured logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LogFormat {
    /// A ROS 2 bag: a folder, or one file of MCAP or `SQLite`.
    Bag,
    /// A CARMEN log.
    Carmen,
}

impl LogFormat {
    /// The format in which a file of this name is written: MCAP where it ends in `.mcap`, otherwise CARMEN.
    pub fn of_name(path: &Path) -> Self {
        let mcap = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"));
        if mcap { Self::Bag } else { Self::Carmen }
    }

    /// As [`Self::of_name`], for a log that is to be written, while another one may be read.
    ///
    /// # Errors
    /// The name ends as logs of neither format do; the folder is a bag.
    pub fn to_write(path: &Path, read: Option<&Path>) -> Result<Self, DatasetError> {
        let ending = |name: &Path| name.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        let of_packed = |name: &Path| name.file_stem().and_then(|stem| ending(Path::new(stem)));
        let is_known = match ending(path).as_deref() {
            None | Some("mcap" | "log" | "clf") => true,
            Some("gz") => matches!(of_packed(path).as_deref(), None | Some("log" | "clf")),
            Some(_) => false,
        };
        if !is_known {
            let reason = format!(
                "a log isn't written as `.{}`; allowed: .mcap for a ROS 2 bag; .log, .log.gz or a name without an ending for a CARMEN log",
                quoted(&path.extension().unwrap_or_default().to_string_lossy())
            );
            return Err(DatasetError::Refused { path: path.to_owned(), line: None, reason });
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let is_read = read.is_some_and(|read| {
            matches!((read.canonicalize(), folder.canonicalize()), (Ok(read), Ok(folder)) if read == folder)
        });
        if Self::of_name(path) == Self::Bag && (is_read || ros::is_recording(folder)) {
            let reason =
                "this folder is a bag, and the file would be taken for a part of it; allowed: another folder"
                    .to_owned();
            return Err(DatasetError::Refused { path: path.to_owned(), line: None, reason });
        }
        Ok(Self::of_name(path))
    }

    /// The format of a file that is there, by its first bytes; a folder is a bag.
    ///
    /// # Errors
    /// The file can't be read, or is no log by its first bytes.
    pub fn of_content(path: &Path) -> Result<Self, DatasetError> {
        if path.is_dir() {
            return Ok(Self::Bag);
        }
        Ok(match Source::open(path, Limits::current())?.content {
            Content::Mcap | Content::Sqlite => Self::Bag,
            Content::Text => Self::Carmen,
            Content::BeesoftMap => return Err(not_a_log(path, BEESOFT_MAP, LOGS)),
        })
    }
}

/// How to read a log of either format.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LogOptions {
    /// Readings of this range (m) or more mean "no return". `None`: the log's own maximum.
    pub max_range_m: Option<f32>,
    /// Names of a bag's topics; a CARMEN log has no topics.
    pub topics: BagTopics,
    /// Reads the scans of a bag alone; their odometry is then the origin.
    pub without_odometry: bool,
}

impl LogOptions {
    /// The same, and what isn't given as in `others`.
    #[must_use]
    pub fn or(self, others: &Self) -> Self {
        let or = |own: Option<String>, other: &Option<String>| own.or_else(|| other.clone());
        let topics = BagTopics {
            scan: or(self.topics.scan, &others.topics.scan),
            odometry: or(self.topics.odometry, &others.topics.odometry),
            reference: or(self.topics.reference, &others.topics.reference),
        };
        Self { max_range_m: self.max_range_m.or(others.max_range_m), topics, ..self }
    }
}

/// Reads a log in the format of its content: [`read_bag`](crate::read_bag) or
/// [`read_carmen`](crate::read_carmen).
///
/// # Errors
/// Those of the format's reader; topics are named for a CARMEN log.
pub fn read_log(path: &Path, options: &LogOptions) -> Result<(Drive, LogSummary), DatasetError> {
    read(path, options, Limits::current())
}

pub fn read(path: &Path, options: &LogOptions, limits: &Limits) -> Result<(Drive, LogSummary), DatasetError> {
    let LogOptions { max_range_m, topics, without_odometry } = options.clone();
    let (mut drive, mut summary) = match LogFormat::of_content(path)? {
        LogFormat::Carmen if topics != BagTopics::default() => Err(DatasetError::Topic {
            path: path.to_owned(),
            reason: "topics are named, by options or in `log.topics`; allowed: for a ROS 2 bag".to_owned(),
            found: "a CARMEN log".to_owned(),
        }),
        LogFormat::Bag => {
            let options = BagOptions { topics, without_odometry, max_range_m, ..BagOptions::default() };
            ros::read(path, &options, limits)
        }
        LogFormat::Carmen => {
            carmen::read(path, &CarmenOptions { max_range_m, ..CarmenOptions::default() }, limits)
        }
    }?;
    let [secs, metres] = drive.drop_frozen_reference();
    if secs > 0.0 {
        summary.remarks.push(format!(
            "The reference stands still or creeps evenly for {secs:.1} s, in which the odometry comes {metres:.2} m away: its scans count as \
             without a reference."
        ));
    }
    summary.remarks.extend(unlikely_units(&drive));
    Ok((drive, summary))
}

/// Lists the contents of a log of any format.
///
/// # Errors
/// The file can't be read, is no log, is damaged or costs more than the limits allow.
pub fn read_contents(path: &Path) -> Result<LogContents, DatasetError> {
    let limits = Limits::current();
    match LogFormat::of_content(path)? {
        LogFormat::Bag => ros::contents(path, limits),
        LogFormat::Carmen => carmen::contents(path, limits),
    }
}

/// What a path leads to that isn't a text, in words: a folder, or a file by its first bytes; `None` for a text, and where it can't be
/// told.
pub fn not_a_text(path: &Path) -> Option<&'static str> {
    if path.is_dir() {
        let is_bag = ros::folder_files(path).is_ok();
        return Some(if is_bag { "the folder of a ROS 2 bag" } else { "a folder" });
    }
    source::not_a_text(path)
}

/// The files that a log is read from: itself, or those of a bag's folder in the order of recording.
///
/// # Errors
/// The folder doesn't hold one bag.
pub fn log_files(path: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    if path.is_dir() { ros::folder_files(path) } else { Ok(vec![path.to_owned()]) }
}

/// Writes a drive in the format of the file's name: [`write_mcap`](crate::write_mcap) or
/// [`write_carmen`](crate::write_carmen).
///
/// # Errors
/// Those of the format's writer.
pub fn write_log(path: &Path, drive: &Drive) -> Result<(), DatasetError> {
    write_whole(path, |out| encode_log(path, drive, out))
}

/// Writes a simulated drive, whose stamps begin at 0. In a bag they count from a fixed date, 2024-01-01 00:00 UTC: programs of
/// ROS take a time near 0 for none.
///
/// # Errors
/// Those of the format's writer.
pub fn write_simulated_log(path: &Path, drive: &Drive) -> Result<(), DatasetError> {
    let format = LogFormat::to_write(path, None)?;
    write_whole(path, |out| match format {
        LogFormat::Bag => encode_mcap(path, drive, SIMULATED_EPOCH_SECS, out),
        LogFormat::Carmen => encode_carmen(path, drive, out),
    })
}

/// 2024-01-01 00:00:00 UTC in Unix time (s).
const SIMULATED_EPOCH_SECS: i32 = 1_704_067_200;

/// Writes the bytes of the file that [`write_log`] writes to `out`. `path` decides the format and the compression, and
/// is named in errors.
///
/// # Errors
/// Those of the format's writer.
pub fn encode_log(path: &Path, drive: &Drive, out: &mut dyn Write) -> Result<(), DatasetError> {
    match LogFormat::to_write(path, None)? {
        LogFormat::Bag => encode_mcap(path, drive, 0, out),
        LogFormat::Carmen => encode_carmen(path, drive, out),
    }
}
