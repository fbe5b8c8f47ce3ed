//! CARMEN logs: one message per line, `KEYWORD fields.. ipc_timestamp hostname logger_timestamp`.
//!
//! Formats: `readlog.c` and `writelog.c` of CARMEN (Montemerlo, Roy and Thrun, IROS 2003), and the variants in the logs
//! of the Radish repository. The lines `L` and `O` are those of Carnegie Mellon University before CARMEN (Wean Hall).

mod assemble;
mod parse;
mod write;

use std::io::BufRead;
use std::path::Path;

use locsim_core::Drive;
use locsim_core::limits::Limits;

use crate::lines::Lines;
use crate::source::open_text;
use crate::{DatasetError, LogContents, LogFormat, LogSummary, Scanner, Topic};

pub use assemble::SICK_MAX_RANGE;
pub use write::{encode_carmen, write_carmen};

/// Which of a robot's lasers to read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CarmenLaser {
    /// The forward one: FLASER, ROBOTLASER1 or L.
    #[default]
    Front,
    /// The backward one: RLASER or ROBOTLASER2.
    Rear,
}

impl CarmenLaser {
    /// The keywords of its lines.
    fn keywords(self) -> &'static [&'static str] {
        match self {
            Self::Front => &["FLASER", "ROBOTLASER1", "L"],
            Self::Rear => &["RLASER", "ROBOTLASER2"],
        }
    }
}

/// How to read a CARMEN log.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CarmenOptions {
    /// Which laser's scans.
    pub laser: CarmenLaser,
    /// Readings of this range (m) or more mean "no return". `None`: the maximum range in the ROBOTLASER line;
    /// for FLASER and L lines, which have none, `PARAM robot_front_laser_max` (`robot_rear_laser_max`), and no more than 81.83 m, where the
    /// SICK LMS begins to count its error codes. Some logs need another value; [`LogSummary::longest_return_m`] shows it.
    pub max_range_m: Option<f32>,
    /// Readings below this range (m) are unusable. `None`: the minimum range that [`write_carmen`] noted in the log,
    /// otherwise 0. A reading of exactly 0 is always unusable.
    pub min_range_m: Option<f32>,
}

/// Reads the scans of one laser with odometry and, where the log has them, reference poses.
///
/// It reads PARAM, ODOM, TRUEPOS, FLASER and ROBOTLASER1 (front), RLASER and ROBOTLASER2 (rear), and the older O
/// (odometry) and L (front), whose lengths are centimetres; other lines are skipped and counted. Of the forms of a laser's
/// lines the first one in the log is read. A last line without its
/// newline is skipped and counted as `(cut off)`, because its last number may be cut.
///
/// - **Beams** of ROBOTLASER lines have the bearings that the line gives. FLASER and L lines give none: their beams run from
///   right to left in steps of 1, 0.5 or 0.25 degrees, the first at -90 degrees (180 and 360 beams are 181 and 361
///   without the last one), unless `PARAM laser_front_laser_resolution` and `laser_front_laser_fov` (degrees) give other
///   values. Other numbers of beams are spread evenly over 180 degrees with both ends.
/// - **Mount** of the laser: `PARAM robot_frontlaser_offset` (`robot_rearlaser_offset`), `.._side_offset` and
///   `.._angular_offset`; without them, in raw and simulated logs, the mean pose of the laser relative to the
///   robot in the scans' lines.
/// - **Reference**: TRUEPOS where present (the last one since the scan before, carried on by odometry to the
///   scan); otherwise the laser pose of each scan in a corrected log.
/// - **Odometry**: see [`OdometrySource`](crate::OdometrySource). In a log of restarted ODOM lines the odometry starts
///   at the first reference pose. A corrected log's ODOM lines give the same point of the robot as its scan lines: the
///   laser.
/// - **Times** are the scans' `ipc_timestamp`. A time that goes backwards by up to a minute is held. After a larger
///   jump (a clock that was set or wrapped) time continues from the scan before.
///
/// # Errors
/// The file can't be read, is empty or no text, or costs more than the [`Limits`] allow; it ends inside a line; a line
/// of a known keyword has the wrong number of fields or a field that isn't allowed; scans differ in their beams; the
/// log has no scan of the laser.
pub fn read_carmen(path: &Path, options: &CarmenOptions) -> Result<(Drive, LogSummary), DatasetError> {
    read(path, options, Limits::current())
}

pub fn read(
    path: &Path,
    options: &CarmenOptions,
    limits: &Limits,
) -> Result<(Drive, LogSummary), DatasetError> {
    read_from(path, open_text(path, limits)?, options, limits)
}

/// The keywords of a log with the number of their lines.
pub fn contents(path: &Path, limits: &Limits) -> Result<LogContents, DatasetError> {
    let keywords = parse::keywords(Lines::new(path, open_text(path, limits)?, limits))?;
    let lasers = [CarmenLaser::Front, CarmenLaser::Rear].map(CarmenLaser::keywords);
    let scanners = lasers.iter().copied().flatten().filter_map(|keyword| {
        let scans = *keywords.get(*keyword)?;
        Some(Scanner { source: (*keyword).to_owned(), scans, beams: None })
    });
    let topic = |(name, messages): (&String, &usize)| Topic {
        name: name.clone(),
        kind: "line".to_owned(),
        messages: *messages,
        rate_hz: None,
        longest_gap_secs: None,
    };
    Ok(LogContents {
        format: LogFormat::Carmen,
        topics: keywords.iter().map(topic).collect(),
        scanners: scanners.collect(),
        transforms: Vec::new(),
    })
}

/// [`read`] from any source; `path` is for messages.
fn read_from(
    path: &Path,
    reader: impl BufRead,
    options: &CarmenOptions,
    limits: &Limits,
) -> Result<(Drive, LogSummary), DatasetError> {
    let log = parse::parse(Lines::new(path, reader, limits), options.laser, limits, path)?;
    assemble::assemble(log, options, path)
}

#[cfg(test)]
mod tests;
