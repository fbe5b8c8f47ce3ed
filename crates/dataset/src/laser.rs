use std::path::Path;

use locsim_core::limits::{COORDINATE, RANGE_M};
use locsim_core::{Laser, LaserError};

use crate::DatasetError;

/// The laser that a log describes, if its numbers are within the bounds for safe arithmetic.
pub fn checked(path: &Path, laser: Result<Laser, LaserError>) -> Result<Laser, DatasetError> {
    let laser = laser.map_err(|source| DatasetError::Laser { path: path.to_owned(), source })?;
    let mount = laser.base_from_laser();
    let values = [
        ("maximum range", &[laser.max_range()][..], RANGE_M),
        ("bearing of a beam", laser.bearings(), COORDINATE),
        ("time of a beam", laser.beam_times_secs(), COORDINATE),
        ("mount", &[mount.x as f32, mount.y as f32, mount.theta as f32], COORDINATE),
    ];
    for (name, values, most) in values {
        let sound = |value: &&f32| (0.0..=most).contains(&f64::from(value.abs()));
        if let Some(value) = values.iter().find(|value| !sound(value)) {
            let reason = format!("{name} is {value}; allowed: a finite number up to {most:e}");
            return Err(DatasetError::Refused { path: path.to_owned(), line: None, reason });
        }
    }
    Ok(laser)
}
