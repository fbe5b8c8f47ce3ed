//! Mapping with known poses: an occupancy grid ([`occupancy_from_drive`]), or walls where the readings end
//! ([`walls_from_drive`]).
//!
//! # Walls
//! 1. Each reading becomes a point with a normal, which neighbouring readings of the scan give (`hits`).
//! 2. Points of one line are gathered by region growing over small cells, fitted by robust total least squares, split where
//!    they bend, and given to the nearest line anew (`surfaces`). The two faces of a thin wall have opposite normals, so they
//!    are two lines.
//! 3. Scans are moved by some centimetres to where they agree with the lines (`poses`), and the lines fitted again.
//! 4. Each part of a line is held against the beams that reached it: those that ended there and those that passed. What
//!    most beams passed is no wall (`walls`).
//! 5. The area between the laser and the readings was seen; beyond its border nothing is known (`border`).

mod beams;
mod border;
mod check;
mod hits;
mod occupancy;
mod poses;
mod surface;
mod surfaces;
mod walls;

use glam::DVec2;
use locsim_core::{Drive, Pose2};

use self::beams::{Scan, scan_of};
use self::border::border_of;
pub use self::check::{Agreement, HeldOutReading, MapCheck, check_maps};
use self::hits::{Hit, hits_of};
pub use self::occupancy::{MappingOptions, occupancy_from_drive};
use self::surface::Surface;
use self::surfaces::surfaces_of;
use self::walls::{Piece, walls_of};
use locsim_world::map::{FARTHEST_M, MapError, MeasuredMap};

/// Makes a map of walls from the scans of some steps of a drive, each taken from its reference pose, which may be
/// corrected by some centimetres so that the scans agree. Steps without a reference pose are left out, and so are readings
/// that are NaN or negative. Of the options, only the usable range counts.
///
/// # Errors
/// [`MapError`] when no step has a reference pose and a reading, or the map would be too large.
///
/// # Panics
/// If an index is not one of a step.
pub fn walls_from_drive(
    drive: &Drive,
    steps: &[usize],
    options: &MappingOptions,
) -> Result<MeasuredMap, MapError> {
    let built = Built::new(drive, steps, options)?.ok_or(MapError::NoReference { steps: steps.len() })?;
    Ok(built.map())
}

/// A map of walls with what it was made from, relative to a point of the map.
struct Built {
    /// That point \[m\]: near the scans, so that squares of coordinates keep their digits.
    centre: DVec2,
    hits: Vec<Hit>,
    surfaces: Vec<Surface>,
    walls: Vec<Piece>,
    border: Vec<Vec<DVec2>>,
}

impl Built {
    /// `None` when no step has a reference pose and a reading.
    fn new(drive: &Drive, steps: &[usize], options: &MappingOptions) -> Result<Option<Self>, MapError> {
        let poses: Vec<Pose2> =
            steps.iter().filter_map(|&step| drive.steps[step].reference.filter(Pose2::is_finite)).collect();
        if let Some(far) = poses.iter().find(|pose| pose.position().abs().max_element() > FARTHEST_M) {
            return Err(MapError::Origin([far.x, far.y, 0.0]));
        }
        let Some(centre) = poses.first().map(|pose| pose.position().round()) else { return Ok(None) };
        let scan = |&step: &usize| scan_of(drive, step, centre, options.usable_range_m);
        let mut scans: Vec<Scan> = steps.iter().filter_map(scan).collect();
        let mut hits: Vec<Hit> = scans.iter().zip(0..).flat_map(|(scan, i)| hits_of(i, scan)).collect();
        if hits.is_empty() {
            return Ok(None);
        }
        let surfaces = surfaces_of(&mut scans, &mut hits);
        let walls = walls_of(&scans, &hits, &surfaces);
        let border = border_of(&scans)?;
        Ok(Some(Self { centre, hits, surfaces, walls, border }))
    }

    fn map(&self) -> MeasuredMap {
        let on_map = |point: &DVec2| (*point + self.centre).to_array();
        MeasuredMap {
            seen: self.border.iter().map(|ring| ring.iter().map(on_map).collect()).collect(),
            walls: self.walls.iter().map(|wall| wall.on_map(self.centre)).collect(),
        }
    }
}
