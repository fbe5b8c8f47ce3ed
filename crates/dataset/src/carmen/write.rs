use std::io::{self, Write};
use std::path::Path;

use locsim_core::{Drive, Pose2};

use super::parse::{BEAM_INTERVAL, MIN_RANGE};
use crate::DatasetError;
use crate::beams::Beams;
use crate::output::{encoded, evenly_spaced, write_whole};

/// Writes a drive as a CARMEN log that [`read_carmen`](super::read_carmen) turns into the same drive, and that
/// programs for CARMEN logs read: PARAM lines with the laser's mount, then for each scan ODOM, TRUEPOS where
/// the reference is known, and ROBOTLASER1 with the beams' bearings.
///
/// Every number has all its digits, so ranges, poses and times come back exactly, bearings to 1e-6 rad. An
/// unusable reading (NaN) is written as 0. CARMEN has no field for the minimum range and the time between beams: they
/// are PARAMs with names of locsim's own. The file is written under a temporary name, then renamed; it is compressed
/// when the name ends in `.gz`.
///
/// # Errors
/// The drive has no scan, bearings or beam times that aren't evenly spaced (the first beam at the stamp), or
/// values that a log must not hold; the file can't be written.
pub fn write_carmen(path: &Path, drive: &Drive) -> Result<(), DatasetError> {
    write_whole(path, |out| encode_carmen(path, drive, out))
}

/// Writes the bytes of the file to `out`, compressed if `path` ends in `.gz`.
pub fn encode_carmen(path: &Path, drive: &Drive, out: &mut dyn Write) -> Result<(), DatasetError> {
    let (beams, times) = evenly_spaced(path, drive)?;
    encoded(path, out, |out| body(out, drive, beams, times.step))
}

fn body(out: &mut dyn Write, drive: &Drive, beams: Beams, beam_interval: f64) -> io::Result<()> {
    let laser = &drive.laser;
    let mount = laser.base_from_laser();
    writeln!(out, "# CARMEN Logfile")?;
    writeln!(out, "# file format is one message per line")?;
    writeln!(out, "# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp")?;
    for (name, value) in [
        ("robot_frontlaser_offset", mount.x),
        ("robot_frontlaser_side_offset", mount.y),
        ("robot_frontlaser_angular_offset", mount.theta),
        (MIN_RANGE, f64::from(laser.min_range())),
        (BEAM_INTERVAL, beam_interval),
    ] {
        writeln!(out, "PARAM {name} {value} 0 locsim 0")?;
    }
    let n = laser.beam_count();
    let Beams { start, step: resolution } = beams;
    let field_of_view = resolution.abs() * (n - 1) as f64;
    for step in &drive.steps {
        let trailer = format!("{0} locsim {0}", step.stamp_secs);
        let robot = pose(&step.odometry);
        writeln!(out, "ODOM {robot} 0 0 0 {trailer}")?;
        if let Some(reference) = &step.reference {
            writeln!(out, "TRUEPOS {} {robot} {trailer}", pose(reference))?;
        }
        // Type 0 is a SICK LMS, the accuracy 1 cm; neither matters to a reader.
        write!(out, "ROBOTLASER1 0 {start} {field_of_view} {resolution} {} 0.01 0 {n}", laser.max_range())?;
        for range in &step.scan.ranges {
            write!(out, " {}", if range.is_nan() { 0.0 } else { *range })?;
        }
        let laser_pose = pose(&step.odometry.compose(&mount));
        writeln!(out, " 0 {laser_pose} {robot} 0 0 0 0 0 {trailer}")?;
    }
    Ok(())
}

fn pose(pose: &Pose2) -> String {
    format!("{} {} {}", pose.x, pose.y, pose.theta)
}
