use std::path::Path;

use locsim_core::limits::COORDINATE;
use locsim_core::{Laser, LaserError};

use crate::DatasetError;

/// The laser that a log describes, if its numbers are such that arithmetic with them is sound.
pub fn checked(path: &Path, laser: Result<Laser, LaserError>) -> Result<Laser, DatasetError> {
    let laser = laser.map_err(|source| DatasetError::Laser { path: path.to_owned(), source })?;
    let mount = laser.base_from_laser();
    let values = [
        ("maximum range", &[laser.max_range()][..]),
        ("bearing of a beam", laser.bearings()),
        ("time of a beam", laser.beam_times_secs()),
        ("mount", &[mount.x as f32, mount.y as f32, mount.theta as f32]),
    ];
    let sound = |value: &&f32| (0.0..=COORDINATE).contains(&f64::from(value.abs()));
    for (name, values) in values {
        if let Some(value) = values.iter().find(|value| !sound(value)) {
            let reason = format!("{name} is {value}; allowed: a finite number up to {COORDINATE:e}");
            return Err(DatasetError::Refused { path: path.to_owned(), line: None, reason });
        }
    }
    Ok(laser)
}
