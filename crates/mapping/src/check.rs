//! Maps held against scans that they weren't made from.

use glam::DVec2;
use locsim_core::{Drive, median};

use crate::beams::{Scan, scan_of};
use crate::hits::{Hit, hits_of};
use crate::poses::correct_poses;
use crate::surfaces::Nearest;
use crate::{Built, MappingOptions, occupancy_from_drive};
use locsim_world::map::{Geometry, MapError};
use locsim_world::raycast::ExactRangeMap;

/// Scans in a row that are held out together: neighbouring scans have the error of their poses in common. Some metres of
/// driving.
const STRETCH: usize = 10;

/// One stretch of this many is held out.
const STRETCHES: usize = 5;

/// A reading is far from its nominal range when it is off by more than this \[m\].
const FAR_M: f64 = 0.5;

/// How often a held-out scan is brought nearer to the walls.
const ALIGNMENTS: usize = 10;

/// How well nominal ranges in a map agree with readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Share of the readings that have a nominal range.
    pub nominal_share: f64,
    /// Median of |reading - nominal range| \[m\].
    pub median_abs_m: f64,
    /// Median of reading - nominal range \[m\].
    pub median_m: f64,
    /// Share of the readings with a nominal range that are more than half a metre off.
    pub far_share: f64,
}

/// A held-out reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutReading {
    /// Where it ends \[m\].
    pub end_m: [f64; 2],
    /// Reading - nominal range in the map of walls \[m\]; `None` where that has none.
    pub error_m: Option<f64>,
}

/// Maps made from four fifths of the scans, held against the readings of the others.
#[derive(Clone, Debug)]
pub struct MapCheck {
    /// How many scans were held out.
    pub scans: usize,
    /// The occupancy grid. A beam that meets no cell within the laser's maximum range has that as its nominal range.
    pub cells: Agreement,
    /// The occupancy grid, for the readings that have a nominal range in the map of walls.
    pub cells_where_walls: Agreement,
    /// The map of walls.
    pub walls: Agreement,
    /// The map of walls, with each held-out scan moved by up to some centimetres to where it agrees best: without the
    /// errors of the reference poses.
    pub walls_aligned: Agreement,
    /// The readings, from their reference poses.
    pub readings: Vec<HeldOutReading>,
    /// The map of walls that they were held against.
    pub map: Geometry,
}

/// Holds out one stretch of ten scans in five, makes both maps from the others, and compares. `None` where too little
/// is left for either.
///
/// # Errors
/// As [`occupancy_from_drive`].
pub fn check_maps(
    drive: &Drive,
    steps: &[usize],
    options: &MappingOptions,
) -> Result<Option<MapCheck>, MapError> {
    let is_held = |i: usize| i / STRETCH % STRETCHES == STRETCHES / 2;
    let part = |held: bool| -> Vec<usize> {
        let mine = steps.iter().enumerate().filter(|(i, _)| is_held(*i) == held);
        mine.map(|(_, &step)| step).collect()
    };
    let (held, others) = (part(true), part(false));
    let Some(built) = Built::new(drive, &others, options)? else { return Ok(None) };
    let cells = ExactRangeMap::new(occupancy_from_drive(drive, &others, options)?.to_geometry()?);
    let walls = ExactRangeMap::new(built.map().to_geometry()?);
    let mut scans: Vec<Scan> = held
        .iter()
        .filter_map(|&step| scan_of(drive, step, built.centre, options.usable_range_m))
        .filter(|scan| scan.beams.iter().any(|beam| beam.hit))
        .collect();
    if scans.is_empty() {
        return Ok(None);
    }
    let max_range = f64::from(drive.laser.max_range());
    let in_cells = |from: DVec2, direction: DVec2| {
        Some(cells.cast_ray(from, direction, max_range).map_or(max_range, |hit| hit.range))
    };
    let in_walls = |from: DVec2, direction: DVec2| {
        let hit = walls.cast_ray(from, direction, max_range)?;
        (!walls.geometry().is_unknown(hit.surface)).then_some(hit.range)
    };
    let by_cells = errors(&scans, built.centre, in_cells);
    let by_walls = errors(&scans, built.centre, in_walls);
    let cells_where_walls =
        by_cells.iter().zip(&by_walls).map(|(cells, walls)| walls.error_m.and(cells.error_m));
    let mut hits: Vec<Hit> = scans.iter().zip(0..).flat_map(|(scan, i)| hits_of(i, scan)).collect();
    let nearest = Nearest::new(&built.surfaces, &built.hits);
    for _ in 0..ALIGNMENTS {
        let groups = nearest.groups(&hits);
        let pairs = built.surfaces.iter().zip(groups.iter().map(Vec::as_slice));
        correct_poses(&mut scans, &mut hits, pairs);
    }
    let aligned = errors(&scans, built.centre, in_walls);
    let of = |readings: &[HeldOutReading]| agreement(readings.iter().map(|reading| reading.error_m));
    Ok(Some(MapCheck {
        scans: scans.len(),
        cells: of(&by_cells),
        cells_where_walls: agreement(cells_where_walls),
        walls: of(&by_walls),
        walls_aligned: of(&aligned),
        readings: by_walls,
        map: walls.geometry().clone(),
    }))
}

/// Readings against the nominal ranges of their beams.
fn errors(
    scans: &[Scan],
    centre: DVec2,
    nominal: impl Fn(DVec2, DVec2) -> Option<f64>,
) -> Vec<HeldOutReading> {
    let beams = scans.iter().flat_map(|scan| scan.beams.iter().map(move |beam| (scan.origin, beam)));
    beams
        .filter(|(origin, beam)| beam.hit && beam.end != *origin)
        .map(|(origin, beam)| {
            let reading = origin.distance(beam.end);
            let range = nominal(origin + centre, (beam.end - origin) / reading);
            let end_m = (beam.end + centre).to_array();
            HeldOutReading { end_m, error_m: range.map(|range| reading - range) }
        })
        .collect()
}

fn agreement(errors: impl Iterator<Item = Option<f64>>) -> Agreement {
    let all: Vec<Option<f64>> = errors.collect();
    let mut errors: Vec<f64> = all.iter().copied().flatten().collect();
    let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
    Agreement {
        nominal_share: share(errors.len(), all.len()),
        median_abs_m: median(&mut errors.iter().map(|error| error.abs()).collect::<Vec<_>>()),
        median_m: median(&mut errors),
        far_share: share(errors.iter().filter(|error| error.abs() > FAR_M).count(), errors.len()),
    }
}
