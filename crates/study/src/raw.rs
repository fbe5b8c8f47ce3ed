//! A study as it stands in the file. Ranges are checked in `validate`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Criterion, Model};

/// An experiment of distribution regression: a sensor, training data of growing size, models tuned alike.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "locsim study")]
pub struct RawStudy {
    /// Name of the results: up to 100 letters, digits, `-` and `_`. Default: the file's name without `.yaml`, with `-` for other signs.
    pub name: Option<String>,
    /// One line for people.
    #[serde(default)]
    pub description: String,
    /// Everything random derives from it.
    pub seed: u64,
    /// Where observations come from.
    pub sensor: RawSensor,
    /// Models under comparison.
    pub models: Vec<Model>,
    /// Candidate bandwidths of each state coordinate, in its unit.
    pub bandwidths: BTreeMap<String, Vec<f64>>,
    /// Folds of the cross-validation over states that chooses among them.
    #[serde(default = "default::folds")]
    pub folds: u64,
    /// Loss that cross-validation minimizes.
    #[serde(default)]
    pub criterion: Criterion,
    /// Sizes N of the training set, ascending.
    pub states: Vec<u64>,
    /// Observations M of each training state; for recorded data at most this many, absent for all.
    pub observations: Option<u64>,
    /// Whether to show risk against a budget of chosen training states. Only with more than one size.
    #[serde(default)]
    pub thinning: bool,
    /// Numbers M of the figure of loss against M, ascending; absent for none.
    #[serde(default)]
    pub counts: Vec<u64>,
    /// Repeats with new training and test states.
    #[serde(default = "default::repeats")]
    pub repeats: u64,
    /// Test states of each repeat.
    #[serde(default = "default::test_states")]
    pub test_states: u64,
    /// Observations that make the true distribution of a test state. Only for simulated sensors.
    pub truth_observations: Option<u64>,
}

/// Where observations come from.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RawSensor {
    /// A planar laser in a mapped room.
    Laser(RawLaser),
    /// A magnetic field sensor near metal.
    FieldSensor(RawFieldSensor),
    /// A laser on a rail that looks into grass.
    Grass(RawGrass),
    /// A measured lidar that stood still.
    StaticLidar(RawStaticLidar),
    /// A table of states and observations.
    Table(RawTable),
}

/// A planar laser in a mapped room.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawLaser {
    /// The map's file.
    pub map: String,
    /// Closed path that the robot drives, `[x, y]` (m).
    pub path_m: Vec<[f64; 2]>,
    /// Beams of a scan, spread evenly over the circle.
    pub beams: u64,
    /// Maximum range (m).
    pub max_range_m: f64,
    /// Step of a reading (m).
    pub resolution_m: f64,
    /// Standard deviation that doesn't depend on the range (m).
    pub sigma_m: f64,
    /// Its growth with the square of the range (1/m), as triangulation gives.
    pub sigma_per_m2: f64,
    /// Its growth with the tangent of the incidence angle (m).
    pub sigma_per_tan_m: f64,
}

/// A magnetic field sensor near metal.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawFieldSensor {
    /// The probe's places on the transmitter's axis, `[lo, hi]` (m).
    pub positions_m: [f64; 2],
    /// Largest reading (m).
    pub max_m: f64,
    /// Step of a reading (m).
    pub resolution_m: f64,
    /// Standard deviation of a reading next to the transmitter (m).
    pub sigma_m: f64,
    /// Standard deviation that the noise of the field adds at the largest reading (m).
    pub field_sigma_m: f64,
    /// The metal object.
    pub forceps: RawForceps,
}

/// A metal object that is waved near the probe.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawForceps {
    /// Radius of the sphere that has the same induced dipole (m).
    pub radius_m: f64,
    /// Middle of the sweep, along and beside the axis (m).
    pub centre_m: [f64; 2],
    /// Half the length of the sweep along the axis (m).
    pub sweep_m: f64,
    /// Standard deviation of the hand about its sweep, in each direction (m).
    pub wobble_m: f64,
    /// Share of the time in which the object is out of reach.
    pub withdrawn_share: f64,
}

/// A laser on a rail that looks into grass.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawGrass {
    /// Length of the rail (m).
    pub rail_m: f64,
    /// Where the grass begins and ends before the rail, `[from, to]` (m); a wall stands at its end.
    pub depth_m: [f64; 2],
    /// Blades per square metre (1/m^2).
    pub blades_per_m2: f64,
    /// Half the width of a blade, `[lo, hi]` (m).
    pub blade_m: [f64; 2],
    /// Standard deviation of the wind's push, along the rail (m).
    pub wind_m: f64,
    /// Half the width of the beam (m).
    pub beam_m: f64,
    /// Standard deviation of a reading (m).
    pub sigma_m: f64,
    /// Maximum range (m).
    pub max_range_m: f64,
    /// Step of a reading (m).
    pub resolution_m: f64,
}

/// A measured lidar that stood still.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawStaticLidar {
    /// One scan per line, one range (m) per ray, `inf` without a return.
    pub file: String,
    /// Maximum range (m).
    pub max_range_m: f64,
    /// Step of a reading (m).
    pub resolution_m: f64,
    /// The first scans, whose medians make the states; the others are the observations.
    pub map_scans: u64,
    /// Rays that return less often than this are left out.
    pub least_return_share: f64,
}

/// A table of states and observations.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawTable {
    /// CSV with a line of names; the last column is the observation, those before it are the state.
    pub file: String,
    /// Smallest and largest value that the sensor reports, in the unit of z.
    pub values: [f64; 2],
    /// Step between values.
    pub resolution: f64,
    /// A value that is observed with positive probability, such as a maximum.
    pub point_mass_at: Option<f64>,
    /// Quantity that the observation follows, for registered models.
    pub align: Option<RawAlignment>,
}

/// Quantity that the observation follows.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RawAlignment {
    /// z minus this state column varies little.
    Shift(String),
    /// z divided by this state column varies little.
    Scale(String),
}

mod default {
    pub fn folds() -> u64 {
        5
    }

    pub fn repeats() -> u64 {
        20
    }

    pub fn test_states() -> u64 {
        100
    }
}
