//! Where a study's observations come from.

mod field;
mod grass;
mod laser;
mod recorded;

use std::path::PathBuf;

use distreg::{Alignment, Dataset, Outcomes};
use rand::Rng;

pub(super) use field::{FieldSensor, Forceps};
pub(super) use grass::{Grass, Noise as GrassNoise};
pub(super) use laser::PlanarLaser;
pub(super) use recorded::{RaySummary, read_static_lidar, read_table};

/// A sensor that is simulated: states to draw, and observations at a state.
pub(super) trait Sensor: Send + Sync {
    /// A state at random, as many coordinates as the study names.
    fn state(&self, random: &mut dyn Rng) -> Vec<f64>;

    /// An observation at `state`, one of the sensor's values.
    fn observe(&self, state: &[f64], random: &mut dyn Rng) -> f64;
}

/// The values that a sensor reports: multiples of a step from 0 to a largest one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Values {
    /// Step (m).
    pub resolution: f64,
    /// Largest value (m).
    pub last: f64,
}

impl Values {
    /// The value nearest to `z`.
    fn nearest(self, z: f64) -> f64 {
        (z.clamp(0.0, self.last) / self.resolution).round() * self.resolution
    }
}

/// Where the observations of one condition come from.
pub(super) enum Source {
    /// As many states and observations as anyone asks for.
    Simulated(Box<dyn Sensor>),
    /// A fixed set of states with their observations.
    Recorded(Dataset),
}

/// A condition under which the sensor is studied, such as still surroundings.
pub(super) struct Condition {
    /// Its name in figures.
    pub label: String,
    /// Its observations.
    pub source: Source,
}

/// A sensor with everything that the experiments ask of it.
pub(super) struct Setup {
    /// Name and unit of each state coordinate.
    pub coordinates: Vec<(String, &'static str)>,
    /// The sensor's values, and one that is observed with positive probability.
    pub outcomes: Outcomes,
    /// Unit of z, and how many of the units that figures show it has.
    pub unit: Unit,
    /// The coordinate that the observation follows; `None` where it follows none.
    pub alignment: Option<Alignment>,
    /// At least one.
    pub conditions: Vec<Condition>,
    /// The rays of a static lidar.
    pub rays: Vec<RaySummary>,
    /// The files that were read for it.
    pub files: Vec<PathBuf>,
    /// A remark on recorded data for readers.
    pub note: Option<String>,
}

/// The unit that figures show z in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unit {
    /// Its name.
    pub name: &'static str,
    /// How many of it make one unit of z.
    pub per_z: f64,
}

impl Unit {
    /// Millimetres, for z in metres.
    pub const MILLIMETRE: Self = Self { name: "mm", per_z: 1000.0 };
    /// The unit of z itself.
    pub const OF_Z: Self = Self { name: "units of z", per_z: 1.0 };
}
