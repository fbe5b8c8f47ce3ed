use std::io::{self, BufWriter, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use locsim_core::Drive;
use locsim_core::output::write_file;

use crate::DatasetError;
use crate::beams::Beams;

/// Writes a whole file through `body`; an existing file is replaced.
pub fn write_whole(
    path: &Path,
    body: impl FnOnce(&mut dyn Write) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    write_file(path, |file| body(file).map_err(io::Error::other)).map_err(|error| {
        error
            .downcast::<DatasetError>()
            .unwrap_or_else(|source| DatasetError::Write { path: path.to_owned(), source })
    })
}

/// Writes the output of `body`, compressed when the name of the file ends in `.gz`.
pub fn encoded(
    path: &Path,
    out: &mut dyn Write,
    body: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), DatasetError> {
    let written = if path.extension().is_some_and(|extension| extension == "gz") {
        // Buffered on the outside: the encoder works on blocks, the body writes words.
        let mut encoder = BufWriter::new(GzEncoder::new(out, Compression::default()));
        body(&mut encoder)
            .and_then(|()| encoder.into_inner().map_err(io::IntoInnerError::into_error)?.finish().map(|_| ()))
    } else {
        body(out)
    };
    written.map_err(|source| DatasetError::Write { path: path.to_owned(), source })
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
