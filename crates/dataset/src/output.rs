use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use locsim_core::Drive;

use crate::DatasetError;
use crate::carmen::Beams;

/// Writes a whole file through `body`, compressed when the name ends in `.gz`.
///
/// The text goes to a neighbour named `<name>.partial`, which takes the file's place when it is complete: a
/// reader never sees half a file, and a failure leaves what was there before.
pub fn write_whole(
    path: &Path,
    body: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), DatasetError> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let partial = Path::new(&partial);
    write_to(partial, path.extension().is_some_and(|e| e == "gz"), body)
        .and_then(|()| fs::rename(partial, path))
        .map_err(|source| {
            // Nothing may be there to remove; the first failure is the one to report.
            let _ = fs::remove_file(partial);
            DatasetError::Write { path: path.to_owned(), source }
        })
}

fn write_to(
    path: &Path,
    compress: bool,
    body: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let file = BufWriter::new(File::create(path)?);
    let file = if compress {
        // Buffered on the outside too: the encoder works on blocks, the body writes words.
        let mut encoder = BufWriter::new(GzEncoder::new(file, Compression::default()));
        body(&mut encoder)?;
        encoder.into_inner()?.finish()?
    } else {
        let mut file = file;
        body(&mut file)?;
        file
    };
    file.into_inner()?.sync_all()
}

/// Bearings (rad) and times (s) of a drive's beams, where both are evenly spaced and the drive can be written.
pub fn evenly_spaced(path: &Path, drive: &Drive) -> Result<(Beams, Beams), DatasetError> {
    let unwritable = |reason: String| DatasetError::Unwritable { path: path.to_owned(), reason };
    let laser = &drive.laser;
    let beams = Beams::from_bearings(laser.bearings())
        .ok_or_else(|| unwritable("the bearings differ; allowed: evenly spaced bearings".into()))?;
    let times = Beams::from_bearings(laser.beam_times_secs())
        .filter(|times| times.start == 0.0)
        .ok_or_else(|| unwritable("the beam times differ; allowed: evenly spaced, from 0 s".into()))?;
    if drive.steps.is_empty() {
        return Err(unwritable("the drive has no scan; allowed: at least one".into()));
    }
    for (i, step) in drive.steps.iter().enumerate() {
        let ranges = &step.scan.ranges;
        let finite = step.stamp_secs.is_finite()
            && step.odometry.is_finite()
            && step.reference.is_none_or(|reference| reference.is_finite());
        if !finite {
            return Err(unwritable(format!(
                "scan {i}: a pose or the time isn't finite; allowed: finite numbers"
            )));
        }
        if ranges.len() != laser.beam_count() {
            let n = laser.beam_count();
            return Err(unwritable(format!(
                "scan {i} has {} ranges; allowed: {n}, one per beam",
                ranges.len()
            )));
        }
        if let Some(range) = ranges.iter().find(|r| !r.is_nan() && !(0.0..=laser.max_range()).contains(*r)) {
            let max = laser.max_range();
            return Err(unwritable(format!(
                "scan {i} has a range of {range} m; allowed: 0 to {max} m, or NaN"
            )));
        }
    }
    Ok((beams, times))
}
