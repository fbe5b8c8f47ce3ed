//! The statistics of a log: for each effect of the library a sum over the log that reacts to it, and for bins of all
//! beams the probability integral transform (PIT) of their readings.
//!
//! A [`Family`] holds the statistics of one kind. A statistic is a plain number without a known distribution; simulated
//! logs give it one, see [`crate::null`].

mod bins;
mod clutter;
mod dictionary;
mod displaced_walls;
mod edges;
mod frame;
mod neighbours;
mod objects;
mod odometry;
mod pit;
mod poses;
mod ratios;
mod readings;
mod scans;
mod scores;
mod sectors;
mod steps;
mod survey;
mod vacated_walls;
mod wall_cells;
mod walls;

use glam::DVec2;
use locsim_world::effect::EffectKind;

pub(crate) use dictionary::Dictionary;
pub(crate) use locsim_comparison::OBJECT_CELL_M;
pub(crate) use odometry::{lag_products, odometry_errors};
pub(crate) use readings::{Readings, pit_draw};
pub(crate) use sectors::ROBOT_REACH_M;
pub(crate) use survey::Survey;

/// Side of a cell of the map in which walls are counted \[m\].
pub const WALL_CELL_M: f64 = 1.0;

/// Statistics of one kind, with all that depends on the kind. A new kind is a type that implements this, and a line in
/// [`Dictionary::new`].
pub(crate) trait Family: Send + Sync {
    /// The statistics.
    fn statistics(&self) -> Vec<Statistic>;

    /// Their values for a log, in the same order.
    fn measure(&self, log: &Readings<'_>) -> Vec<Halves>;

    /// Where fits of the family's effect start, by its statistics that are farthest off, the most telling one first.
    fn first_guesses(&self, _: &Readings<'_>, found: &[Found<'_>]) -> Vec<Start> {
        typical_guesses(found)
    }

    /// The family's effect, if it moves readings, and most of the log's are moved as it does, with where a fit of it starts then: it is worth
    /// a try whatever the statistics say.
    fn moves_most(&self, _: &Readings<'_>) -> Option<(EffectKind, Start)> {
        None
    }

    /// Whether a statistic of the family counts the readings of a beam, both by index.
    fn includes(&self, _statistic: usize, _beam: usize) -> bool {
        true
    }
}

/// One number that is looked at in a log.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Statistic {
    pub target: Target,
    pub group: Group,
    pub form: Form,
    /// The most by which one reading changes it, where that may be more than its standard deviation: 0 of other statistics. Where
    /// nothing but the walls is ever seen, a single stray reading would stand out among all replicates.
    pub by_one_reading: f64,
}

/// The effect or the cell that a statistic is for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Target {
    Effect {
        kind: EffectKind,
        /// Values of parameters, by index, that aren't the typical ones in the direction that is looked in.
        values: Vec<(usize, f64)>,
    },
    Cell(Cell),
}

/// The statistics that are ranked among themselves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    /// Effects that shift or spread many readings, or are in the odometry.
    Wide,
    /// Effects in one of many places or sectors.
    Places,
    /// The omnibus cells.
    Cells,
    /// Objects where clutter can stand: clutter that stays looks like an object.
    AmongClutter,
    /// Shares of readings that are lost or not of the wall, and the depth of clutter. Where clutter stays, such readings
    /// come in crowds, and the largest of these statistics is now and then an outlier.
    Shares,
    /// An odometry that lags, a reference in a turned or shifted frame.
    Misalignments,
    /// Walls that are displaced far: clutter that stays in front of a wall looks like another wall.
    DisplacedWalls,
    /// Walls that hardly a reading is left of: clutter that stays hides no more of them than it is long.
    VacatedWalls,
    /// What is before the laser on all of the way: clutter is on a piece of it.
    OnRobot,
}

impl Group {
    pub const COUNT: usize = 9;
    /// Those whose statistics aren't of an effect of the library.
    pub const OMNIBUS: [Self; 2] = [Self::Cells, Self::Misalignments];
}

/// The form of a statistic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// A score: the derivative of the log likelihood by an effect's strength. Its standard deviation is the root of its
    /// information.
    Score,
    /// A count of rare events.
    Count,
    /// A share of readings, as minus the logarithm of the rest. Its standard deviations say nothing of what a fit gains.
    Share,
    /// Any other sum or ratio.
    Other,
}

impl Statistic {
    /// A statistic that looks for an effect of typical values.
    fn of_effect(kind: EffectKind, group: Group, form: Form) -> Self {
        Self::along(kind, &[], group, form)
    }

    /// A statistic that looks for an effect in a direction of its values.
    fn along(kind: EffectKind, direction: &[(usize, f64)], group: Group, form: Form) -> Self {
        let target = Target::Effect { kind, values: direction.to_vec() };
        Self { target, group, form, by_one_reading: 0.0 }
    }

    fn of_cell(cell: Cell, form: Form) -> Self {
        Self { target: Target::Cell(cell), group: Group::Cells, form, by_one_reading: 0.0 }
    }

    fn of_misalignment(covariate: Covariate, deviation: Deviation) -> Self {
        let cell = Cell { covariate, lo: 0.0, hi: 0.0, place: None, deviation };
        Self { group: Group::Misalignments, ..Self::of_cell(cell, Form::Other) }
    }

    /// The same with the most by which one reading changes it.
    fn with_one_reading(self, by: f64) -> Self {
        Self { by_one_reading: by, ..self }
    }

    /// The effect that it looks for.
    pub fn effect(&self) -> Option<EffectKind> {
        match self.target {
            Target::Effect { kind, .. } => Some(kind),
            Target::Cell(_) => None,
        }
    }

    pub fn cell(&self) -> Option<&Cell> {
        match &self.target {
            Target::Effect { .. } => None,
            Target::Cell(cell) => Some(cell),
        }
    }

    /// How far `z` standard deviations speak for what it looks for: an effect that acts in one direction only shows in
    /// positive numbers only.
    pub fn off(&self, z: f64) -> f64 {
        match self.effect() {
            Some(kind) if kind.is_one_sided() => z,
            _ => z.abs(),
        }
    }
}

/// The value of a statistic for a log, in two halves, of alternating [folds](locsim_core::Folds).
pub(crate) type Halves = [f64; 2];

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
    /// The robot's speed, below 0 in reverse \[m/s\].
    Speed,
    /// The robot's turn rate \[rad/s\].
    TurnRate,
    /// Range jump to a neighbour beam \[m\].
    Jump,
    /// Bearing, by turn rate.
    BearingByTurnRate,
    /// Every beam alike.
    Everywhere,
    /// The error of the beam before, in its standard deviations.
    Neighbour,
    /// The odometry.
    Odometry,
    /// Each scan as a whole: how much scans differ in what their beams share. Of a curve, the variance of the errors of the scan's
    /// other beams, in their standard deviations.
    Scan,
    /// The share of the scan's other beams without return, beyond that of the simulation \[1\].
    Losses,
    /// Every beam: the PIT's tenths, from `lo` to `hi`.
    Pit,
    /// Reading over nominal range, of readings that are not of the surface \[1\].
    Ratio,
}

/// The way in which a cell may be off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Deviation {
    /// Readings are too long or too short on average (mean of the PIT).
    Mean,
    /// Readings spread too much or too little (variance of the PIT).
    Spread,
    /// Errors have a longer tail on one side.
    Skew,
    /// Share of readings of something unmapped in front.
    Short,
    /// Share of missing returns.
    NoReturn,
    /// Share of readings of something behind the mapped surface.
    Long,
    /// Share of readings that lie in this bin.
    Share,
    /// How late something is.
    Lag,
    /// How far the reference's frame is turned.
    #[serde(rename = "frame")]
    FrameTurn,
    /// How far it is shifted.
    FrameShift,
}

impl Deviation {
    /// Whether it is of the reference's frame.
    pub fn is_of_frame(self) -> bool {
        matches!(self, Self::FrameTurn | Self::FrameShift)
    }
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
    /// The way in which it may be off.
    pub deviation: Deviation,
}

/// A statistic of a family that is off.
pub(crate) struct Found<'s> {
    /// Its value for the log in standard deviations of the replicates.
    pub z: f64,
    /// Its index in the family.
    pub index: usize,
    pub statistic: &'s Statistic,
}

/// Where a fit of an effect starts: its values, and the stretches of wall that it acts on.
#[derive(Clone, Debug)]
pub(crate) struct Start {
    pub values: Vec<f64>,
    pub place: Vec<[DVec2; 2]>,
}

/// Typical values of an effect, to the side of its neutral value that a statistic's sign says.
fn typical_values(kind: EffectKind, z: f64) -> Vec<f64> {
    let parameters = kind.parameters();
    let mut values: Vec<f64> = parameters.iter().map(|parameter| parameter.start).collect();
    if parameters[0].lo < parameters[0].neutral && z < 0.0 {
        values[0] = parameters[0].neutral - (values[0] - parameters[0].neutral);
    }
    values
}

/// Starts at typical values in the directions of the statistics that are farthest off.
fn typical_guesses(found: &[Found<'_>]) -> Vec<Start> {
    let Some(kind) = found.first().and_then(|first| first.statistic.effect()) else { return Vec::new() };
    let at = |values| Start { values, place: Vec::new() };
    let along = |found: &Found<'_>| match &found.statistic.target {
        Target::Effect { values, .. } => values.clone(),
        Target::Cell(_) => Vec::new(),
    };
    if kind.strengths().count() > 1 {
        // All strengths at once, such as both axes of an offset, each at the value of its own direction.
        let mut values = vec![0.0; kind.parameters().len()];
        for (parameter, value) in found.iter().flat_map(along).filter(|(_, value)| *value != 0.0) {
            values[parameter] = value;
        }
        return vec![at(values)];
    }
    let most = match kind.parameters().len() {
        // Readings in steps of 5 cm are in steps of 1 cm, too: the likelihood tells which.
        _ if kind.is_stepped() => found.len(),
        1 => 1,
        // A shape that isn't typical is worth a second start.
        _ => 2,
    };
    let starts = found.iter().take(most).map(|found| {
        let mut values = typical_values(kind, found.z);
        for (parameter, value) in along(found) {
            values[parameter] = value;
        }
        at(values)
    });
    starts.collect()
}
