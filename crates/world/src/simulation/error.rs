use locsim_core::LaserError;
use locsim_core::limits::Limits;
use thiserror::Error;

use crate::effect::EffectError;

/// Why a simulation is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SimulationError {
    /// A parameter is out of range or not finite.
    #[error("{name} must be {allowed}; got {value}")]
    Parameter {
        /// The parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The allowed values.
        allowed: &'static str,
    },
    /// The interval of a uniform distribution is out of range, out of order or not finite.
    #[error("{name} must be an interval [lo, hi] with {allowed}; got [{}, {}]", .value[0], .value[1])]
    Interval {
        /// The parameter.
        name: &'static str,
        /// The interval.
        value: [f64; 2],
        /// The allowed values.
        allowed: &'static str,
    },
    /// Something would not fit into memory.
    #[error("{count:.0} {what} are more than the {max:.0} that are allowed")]
    TooMany {
        /// The unit that is counted.
        what: &'static str,
        /// How much.
        count: f64,
        /// The most that is allowed.
        max: f64,
    },
    /// There is more of something than a limit allows.
    #[error("{0}")]
    Limit(String),
    /// Blocks that are drawn anew for each observation cannot move.
    #[error("blocks that are resampled at each observation cannot have a speed")]
    SpeedWithoutPersistence,
    /// A path needs two waypoints.
    #[error("a path needs at least 2 waypoints; got {points}")]
    TooFewWaypoints {
        /// How many there are.
        points: usize,
    },
    /// A waypoint or the start of a velocity profile is NaN or infinite.
    #[error("point {index} of the path is not finite")]
    NotFinite {
        /// Index of the point; 0 for the start.
        index: usize,
    },
    /// A waypoint coincides with the one before it, which leaves its leg without a direction.
    #[error("waypoint {index} coincides with the one before it")]
    RepeatedWaypoint {
        /// Index of the second of them.
        index: usize,
    },
    /// A velocity profile needs a segment.
    #[error("a velocity profile needs at least one segment")]
    NoSegments,
    /// A segment of a velocity profile is not finite, or does not last.
    #[error("segment {index} of the velocity profile needs finite velocities and a duration above 0 s")]
    Segment {
        /// Index of the segment.
        index: usize,
    },
    /// The path leaves the map's free space.
    #[error("at {secs:.2} s the path is at ({x:.3}, {y:.3}) m, outside the map's free space")]
    OutsideFreeSpace {
        /// Time since the start \[s\].
        secs: f64,
        /// x there \[m\].
        x: f64,
        /// y there \[m\].
        y: f64,
    },
    /// An effect is refused.
    #[error(transparent)]
    Effect(#[from] EffectError),
    /// The laser's description is refused.
    #[error(transparent)]
    Laser(#[from] LaserError),
}

/// Bound on lengths \[m\], speeds \[m/s\] and other magnitudes; no robot exceeds it.
pub(super) const MOST: f64 = 1e4;

/// Whether a value is from 0 to [`MOST`], in words and as a test.
pub(super) const FROM_0: (&str, fn(f64) -> bool) =
    ("at least 0, at most 10000", |value| (0.0..=MOST).contains(&value));

/// `value` if it is finite and satisfies `allowed`.
pub(super) fn check(
    name: &'static str,
    value: f64,
    allowed: &'static str,
    satisfied: impl Fn(f64) -> bool,
) -> Result<f64, SimulationError> {
    if value.is_finite() && satisfied(value) {
        Ok(value)
    } else {
        Err(SimulationError::Parameter { name, value, allowed })
    }
}

/// Refuses more than a limit of this name.
pub(super) fn check_limit(name: &str, limit: u64, count: f64) -> Result<(), SimulationError> {
    if count <= limit as f64 {
        return Ok(());
    }
    Err(SimulationError::Limit(Limits::current().refusal(name, count.ceil() as u64)))
}

/// Refuses more than `max` of `what`.
pub(super) fn check_count(what: &'static str, count: f64, max: f64) -> Result<(), SimulationError> {
    if count <= max { Ok(()) } else { Err(SimulationError::TooMany { what, count, max }) }
}
