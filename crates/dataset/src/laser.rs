use std::path::Path;

use locsim_core::limits::{COORDINATE, LEAST_RANGE_M, RANGE_M, number};
use locsim_core::{Laser, LaserError};

use crate::DatasetError;

/// The laser that a log describes, if its numbers are within the bounds for safe arithmetic.
pub fn checked(path: &Path, laser: Result<Laser, LaserError>) -> Result<Laser, DatasetError> {
    let laser = laser.map_err(|source| DatasetError::Laser { path: path.to_owned(), source })?;
    let mount = laser.base_from_laser();
    let range = laser.max_range();
    if !(LEAST_RANGE_M..=RANGE_M).contains(&f64::from(range)) {
        let found = number(range);
        let reason = format!("maximum range is {found} m; allowed: {LEAST_RANGE_M} to {RANGE_M} m");
        return Err(DatasetError::Refused { path: path.to_owned(), line: None, reason });
    }
    let values = [
        ("bearing of a beam", laser.bearings()),
        ("time of a beam", laser.beam_times_secs()),
        ("mount", &[mount.x as f32, mount.y as f32, mount.theta as f32][..]),
    ];
    for (name, values) in values {
        let sound = |value: &&f32| (0.0..=COORDINATE).contains(&f64::from(value.abs()));
        if let Some(value) = values.iter().find(|value| !sound(value)) {
            let reason =
                format!("{name} is {}; allowed: a finite number up to {COORDINATE:e}", number(*value));
            return Err(DatasetError::Refused { path: path.to_owned(), line: None, reason });
        }
    }
    Ok(laser)
}
