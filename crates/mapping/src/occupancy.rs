//! Occupancy grid mapping with known poses (Probabilistic Robotics, tables 9.1 and 9.2).

use glam::DVec2;
use locsim_core::limits::Limits;
use locsim_core::{Drive, Pose2};

use locsim_world::map::{Cell, CellFrame, FARTHEST_M, MapError, OccupancyGrid};

/// How scans become a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MappingOptions {
    /// Edge length of a cell \[m\].
    pub resolution_m: f64,
    /// Room around everything that was seen \[m\].
    pub margin_m: f64,
    /// A reading beyond this range \[m\] marks no cell; its beam clears up to here.
    pub usable_range_m: f64,
    /// A beam without return clears up to this range \[m\]; 0 clears nothing.
    pub no_return_clear_m: f64,
    /// Probability that a cell is occupied, given that a beam ends in it; between 0.5 and 1.
    pub occupied_if_hit: f64,
    /// Probability that a cell is occupied, given that a beam passes it; between 0 and 0.5.
    pub occupied_if_passed: f64,
}

impl Default for MappingOptions {
    /// 5 cm cells. A cell is occupied when more than about one in six of the beams that reach it end there: moving
    /// objects are cleared, and a wall seen at a grazing angle stays.
    fn default() -> Self {
        Self {
            resolution_m: 0.05,
            margin_m: 0.5,
            usable_range_m: 30.0,
            no_return_clear_m: 0.0,
            occupied_if_hit: 0.87,
            occupied_if_passed: 0.4,
        }
    }
}

/// A cell that is more probably occupied than this is [`Cell::Occupied`]: the default of ROS's `map_server`.
const OCCUPIED_ABOVE: f64 = 0.65;
/// A cell that is less probably occupied than this is [`Cell::Free`]: as far from 0.5 as [`OCCUPIED_ABOVE`].
const FREE_BELOW: f64 = 0.35;

/// Makes a map from the scans of some steps of a drive, each taken from its reference pose. Steps without a
/// reference pose are left out, and so are readings that are NaN or negative.
///
/// Within one scan each cell counts once, as hit if any beam ends in it (as in Cartographer; Hess et al., ICRA 2016,
/// section IV): neighbouring beams are no independent evidence, and beams that graze a wall don't clear it.
///
/// # Errors
/// [`MapError`] when no step has a reference pose and a reading, the resolution is not positive, or the map would be
/// too large.
///
/// # Panics
/// If an index is not one of a step.
pub fn occupancy_from_drive(
    drive: &Drive,
    steps: &[usize],
    options: &MappingOptions,
) -> Result<OccupancyGrid, MapError> {
    // Not kept: a long log has beams for gigabytes.
    let scans = || steps.iter().map(|&step| beams_of(drive, step, options));
    let frame = frame_around(scans(), options).ok_or(MapError::NoReference { steps: steps.len() })??;
    let limits = Limits::current();
    let cells = (frame.columns * frame.rows) as u64;
    if cells > limits.map_pixels {
        return Err(MapError::TooMany(limits.refusal("map_pixels", cells)));
    }
    let log_odds = |p: f64| (p / (1.0 - p)).ln();
    let hit = log_odds(options.occupied_if_hit);
    let passed = log_odds(options.occupied_if_passed);
    let mut evidence = vec![0.0_f64; frame.columns * frame.rows];
    // The last scan that counted in each cell; scans are numbered from 1.
    let mut counted = vec![0_u32; evidence.len()];
    for (scan, beams) in (1..).zip(scans()) {
        let mut count = |[column, row]: [usize; 2], weight: f64| {
            let cell = row * frame.columns + column;
            if counted[cell] != scan {
                counted[cell] = scan;
                evidence[cell] += weight;
            }
        };
        for beam in beams.iter().filter(|beam| beam.hit) {
            count(frame.cell_of(beam.end), hit);
        }
        for beam in &beams {
            for cell in frame.cells_between(beam.start, beam.end) {
                count(cell, passed);
            }
        }
    }
    drop(counted);
    let probability = |log_odds: &f64| 1.0 / (1.0 + (-log_odds).exp());
    let classify = |p: f64| {
        if p > OCCUPIED_ABOVE {
            Cell::Occupied
        } else if p < FREE_BELOW {
            Cell::Free
        } else {
            Cell::Unknown
        }
    };
    OccupancyGrid::new(
        frame.columns,
        frame.rows,
        options.resolution_m,
        Pose2::new(frame.x0, frame.y0, 0.0),
        evidence.iter().map(probability).map(classify).collect(),
        evidence.iter().map(probability).map(|p| p as f32).collect(),
    )
}

/// A beam as a line in the map frame \[m\].
struct Beam {
    start: DVec2,
    end: DVec2,
    /// Whether it ends at a surface.
    hit: bool,
}

/// The usable beams of a step's scan.
fn beams_of(drive: &Drive, step: usize, options: &MappingOptions) -> Vec<Beam> {
    let laser = &drive.laser;
    let step = &drive.steps[step];
    let Some(map_from_base) = step.reference.filter(Pose2::is_finite) else { return Vec::new() };
    let map_from_laser = map_from_base.compose(&laser.base_from_laser());
    let start = map_from_laser.position();
    step.scan
        .ranges
        .iter()
        .zip(laser.bearings())
        .filter(|(range, _)| range.is_finite() && **range >= 0.0)
        .map(|(&range, &bearing)| {
            let returned = range < laser.max_range();
            let hit = returned && f64::from(range) <= options.usable_range_m;
            let length = if returned {
                f64::from(range).min(options.usable_range_m)
            } else {
                options.no_return_clear_m.min(laser.max_range().into())
            };
            let direction = DVec2::from_angle(map_from_laser.theta + f64::from(bearing));
            Beam { start, end: start + length * direction, hit }
        })
        .collect()
}

/// Cells around every beam; `None` if there is none.
fn frame_around(
    scans: impl Iterator<Item = Vec<Beam>>,
    options: &MappingOptions,
) -> Option<Result<CellFrame, MapError>> {
    let (lower, upper) = scans
        .flatten()
        .map(|beam| (beam.start.min(beam.end), beam.start.max(beam.end)))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
    // A whole cell at least, so that no point is on the outermost edge.
    let margin = options.margin_m.max(options.resolution_m);
    if lower.abs().max(upper.abs()).max_element() > FARTHEST_M {
        return Some(Err(MapError::Origin([lower.x, lower.y, 0.0])));
    }
    let bounds = [lower.x - margin, lower.y - margin, upper.x + margin, upper.y + margin];
    Some(CellFrame::covering(bounds, options.resolution_m))
}
