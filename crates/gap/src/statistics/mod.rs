//! What is looked at in a log: a statistic for each direction in which the library's effects would move it, and the PIT
//! (probability integral transform) of its readings over bins of what a beam is.
//!
//! All of them are plain numbers without a distribution of their own; they get one from simulated logs, see
//! [`crate::null`].

mod dictionary;
mod measure;

use glam::DVec2;
use locsim_core::{Draw, Stage};
use locsim_world::effect::EffectKind;

pub(crate) use dictionary::{Dictionary, Group};
pub(crate) use measure::moved_wall_score;

/// Side of a cell of the map in which endpoints are counted \[m\]: walls, and unmapped objects.
pub(crate) const WALL_CELL_M: f64 = 1.0;
pub(crate) const OBJECT_CELL_M: f64 = 0.25;
/// Bins of a sector: over bearing, and of its range \[m\].
const SECTORS: usize = 24;
pub(crate) const SECTOR_RANGE_M: f64 = 0.25;
/// Steps of a quantization that are looked for \[m\].
const STEPS_M: [f64; 7] = [0.002, 0.003, 0.005, 0.01, 0.02, 0.025, 0.05];
/// Angles from which, and ranges over whose power, returns may be lost.
const DROPOUT_ANGLES_DEG: [f64; 5] = [30.0, 45.0, 60.0, 70.0, 80.0];
const DROPOUT_EXPONENTS: [f64; 5] = [0.0, 1.0, 2.0, 4.0, 8.0];
/// Readings of blocks lie outside of them by this as noise and errors of the reference have it, or by five standard deviations of a
/// laser that has more noise \[m\].
const READINGS_ERR_M: f64 = 0.1;
/// Shares by which slipping wheels may turn farther than the robot gets.
const SLIP_SHARES: [f64; 2] = [0.2, 0.5];
const WARM_UP_SECS: [f64; 4] = [5.0, 20.0, 60.0, 150.0];
/// Bins of the ratio of a reading to the nominal range: of this width, up to this number of them.
const RATIO_BIN: f64 = 0.1;
const RATIO_BINS: usize = 31;
/// Consecutive scans that are held out, located and drawn together \[scans\].
pub(crate) const BLOCK: usize = 20;

/// A covariate of the omnibus search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariate {
    /// Nominal range \[m\].
    Range,
    /// Incidence \[rad\].
    Incidence,
    /// Bearing in the laser's frame \[rad\].
    Bearing,
    /// A square of the map in which the beam ends; see [`Cell::place`].
    Place,
    /// Time since the first scan \[s\].
    Time,
    /// The robot's speed \[m/s\].
    Speed,
    /// The robot's turn rate \[rad/s\].
    TurnRate,
    /// Range jump to a neighbour beam \[m\].
    Jump,
    /// Bearing, by turn rate.
    BearingByTurnRate,
    /// Each scan as a whole: how much scans differ, by what their beams share.
    Scan,
    /// Every beam: the PIT's tenths, from `lo` to `hi`.
    Pit,
    /// Reading over nominal range, of readings that are not of the surface \[1\].
    Ratio,
}

/// What is off in a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Deviation {
    /// Readings are too long or too short on average (mean of the PIT).
    Mean,
    /// Readings spread too much or too little (variance of the PIT).
    Spread,
    /// Share of readings of something unmapped in front.
    Short,
    /// Share of missing returns.
    NoReturn,
    /// Share of readings of something behind what the map has there.
    Long,
    /// Share of readings that lie in this bin.
    Share,
}

impl Deviation {
    /// Those that every bin of a covariate has a cell for, in the order of their statistics.
    pub(crate) const OF_BINS: [Self; 5] = [Self::Mean, Self::Spread, Self::Short, Self::NoReturn, Self::Long];
}

/// A cell of the omnibus search.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Cell {
    /// Over what.
    pub covariate: Covariate,
    /// From, in the covariate's unit.
    pub lo: f64,
    /// To.
    pub hi: f64,
    /// Lower corner of the square, for [`Covariate::Place`] \[m\].
    pub place: Option<[f64; 2]>,
    /// What is off.
    pub deviation: Deviation,
}

/// What a statistic looks for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Target {
    /// An effect; the numbers start its fit: values, or a cell of the map.
    Effect(EffectKind, Seed),
    Cell(Cell),
}

/// Where a fit of an effect can start.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Seed {
    None,
    /// Value of a parameter other than the strength, by index.
    Values(Vec<(usize, f64)>),
    /// A cell of walls, or two neighbours; twice the same for one.
    Wall([[i32; 2]; 2]),
    /// Four cells of free space; the one with the least numbers.
    Object([i32; 2]),
}

/// One number of a log, in two halves: alternating blocks of scans.
pub(crate) type Halves = [f64; 2];

pub(crate) fn cell_at(x: f64, y: f64, side: f64) -> [i32; 2] {
    [(x / side).floor() as i32, (y / side).floor() as i32]
}

/// Maps have walls at round numbers; cells of walls have their borders elsewhere, or rounding would share a wall out.
const WALL_BORDER_M: f64 = 0.37;

/// The cell of a point of a wall.
pub(crate) fn wall_cell(point: DVec2) -> [i32; 2] {
    cell_at(point.x + WALL_BORDER_M, point.y + WALL_BORDER_M, WALL_CELL_M)
}

/// Lower corner of a cell of walls \[m\].
fn wall_corner(cell: [i32; 2]) -> [f64; 2] {
    cell.map(|c| f64::from(c) * WALL_CELL_M - WALL_BORDER_M)
}

/// About as many events of a kind can just be told from chance: scores of contaminations are best for so many.
const EVENTS: f64 = 15.0;

/// The share at which a contamination of so many beams can just be told from chance.
fn just_seen(beams: f64) -> f64 {
    (EVENTS / beams.max(1.0)).min(0.3)
}

/// Derivative of a log density by the share of a contamination, at `share`; `ratio` is the contamination's density over
/// the hypothesis's, less 1. At a share of 0 it would be the ratio itself, which a single reading can make huge.
#[inline]
fn contaminated(ratio: f64, share: f64) -> f64 {
    ratio / (1.0 + share * ratio)
}

pub(crate) fn tangent_squared(incidence: f64) -> f64 {
    incidence.min(80.0_f64.to_radians()).tan().powi(2)
}

/// The draws that randomize the PIT of missing returns.
pub(crate) fn pit_draw(seed: u64) -> Draw {
    Draw::new(seed, Stage::Bootstrap, 0)
}
