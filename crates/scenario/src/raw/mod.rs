//! A scenario as it stands in the file: types, keys and defaults. Their doc comments are the descriptions in
//! the JSON Schema. Ranges are checked later, in `validate`.

mod effect;
mod filter;
mod residual;
mod source;

use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::form::{Form, Short};
use super::{ErrorFrame, ModelName};

pub use effect::*;
pub use filter::*;
pub use residual::*;
pub use source::*;

/// An experiment of locsim: a world or a measured log, sensor models learnt from data, and a particle filter
/// that localizes under each of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "locsim scenario")]
pub struct RawScenario {
    /// Name of the results: up to 100 letters, digits, `-` and `_`. Default: the file's name without `.yaml`, with `-` for other signs.
    pub name: Option<String>,
    /// One line for people.
    #[serde(default)]
    pub description: String,
    /// Everything random derives from it: the same seed gives the same results, bit for bit.
    pub seed: u64,
    /// Number of trials, 1 to 1000000. Every model runs on the same trials.
    #[serde(default = "default::trials")]
    pub trials: u64,
    /// The map: its file, or a map of keys. Needed with `robot`; with `log`, a map is built from the log where this is absent.
    pub map: Option<Form<MapFile, RawMap>>,
    /// How the filter casts rays into the map.
    #[serde(default)]
    pub ray_cast: RawRayCast,
    /// Blocks that the map doesn't know; absent for none. Only with `laser`.
    pub blocks: Option<RawBlocks>,
    /// A simulated robot. Needed without `log`.
    pub robot: Option<RawRobot>,
    /// The simulated laser. Needed with `robot`. Beside `log`, it is the laser of the simulator that `locsim gap` holds the
    /// log against.
    pub laser: Option<RawLaser>,
    /// Ways in which the simulated world differs from what `map`, `blocks`, `robot` and `laser` say, all at once; the
    /// same may come twice, 1000 at the most. `locsim effects` lists them. Only with `laser`.
    #[serde(default)]
    pub effects: Vec<RawEffect>,
    /// Curves by which readings differ from the simulator's without a known cause, 100 at the most; they add up. Only with
    /// `laser`.
    #[serde(default)]
    pub residuals: Vec<RawResidual>,
    /// A measured log. Without it, the robot's drive is simulated.
    pub log: Option<RawLog>,
    /// How much training data the sensor models get.
    #[serde(default)]
    pub training: RawTraining,
    /// The sensor models under comparison, 1 to 100: each a name, or a map with `name` and options.
    pub models: Vec<Form<ModelName, RawModel>>,
    /// The particle filter.
    pub filter: RawFilter,
    /// How errors are measured.
    #[serde(default)]
    pub errors: RawErrors,
    /// Content of the recording.
    #[serde(default)]
    pub record: RawRecord,
    /// Bounds on figures of `summary.json`, by label of the model: `{classic: {lost_share: {max: 0.05}}}`. Nested
    /// figures are written nested or with dots (`train.log_loss_nats`). A run that misses one exits with 1.
    #[serde(default)]
    pub expect: BTreeMap<String, RawBounds>,
}

/// The file of a map: short for a map with the key `file`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[schemars(inline)]
pub struct MapFile(String);

impl Short for MapFile {
    const FORMS: &'static [&'static str] = &["FILE", "{file: FILE}"];

    fn from_word(word: &str) -> Option<Self> {
        Some(Self(word.to_owned()))
    }
}

impl Form<MapFile, RawMap> {
    /// The key path under which the map's file stands, and the file.
    pub fn file(&self) -> (&'static str, &str) {
        match self {
            Self::Short(MapFile(file)) => ("map", file),
            Self::Full(RawMap { file }) => ("map.file", file),
        }
    }
}

/// A map file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawMap {
    /// A vector map, or a ROS `map_server` YAML (the one with the key `image`). Relative to the scenario file;
    /// `${VARIABLE}` is replaced from the environment.
    pub file: String,
}

/// How much training data the sensor models get.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RawTraining {
    /// Scan poses drawn in free space, 2 to 1000000; for a log, at most this many of its training scans.
    pub poses: u64,
    /// Observations of each state, 1 to 100000. Default: 100; 1 for a log, which has no other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub observations: Option<u64>,
    /// Beams per pose that become states, spread evenly. Default: all of the laser's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beams: Option<u64>,
    /// Share of the poses held out for choosing bandwidths, floors and exponents, above 0 and below 1.
    pub held_out_share: f64,
}

impl Default for RawTraining {
    fn default() -> Self {
        Self { poses: 100, observations: None, beams: None, held_out_share: 0.25 }
    }
}

/// A sensor model with options.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawModel {
    /// Which model.
    pub name: ModelName,
    /// Label in results; unique among the models. Default: its name.
    pub label: Option<String>,
    /// Weight of a uniform floor under the density, 0 to below 1. Default: chosen on held-out data.
    pub floor: Option<f64>,
    /// Exponent of the likelihood, above 0 to 1. Default: chosen on held-out data; on a log, by localizing on its training scans.
    pub exponent: Option<f64>,
    /// A fitted model to load instead of fitting it; for a laser model of AMCL a parameter file of ROS 2. Relative to the scenario
    /// file; `${VARIABLE}` is replaced from the environment.
    pub file: Option<String>,
}

impl Short for ModelName {
    const FORMS: &'static [&'static str] = &{
        let mut forms =
            ["{name: ..., label: ..., floor: ..., exponent: ..., file: ...}"; ModelName::ALL.len() + 1];
        let mut i = 0;
        while i < ModelName::ALL.len() {
            forms[i] = ModelName::NAMES[i];
            i += 1;
        }
        forms
    };

    fn from_word(word: &str) -> Option<Self> {
        word.parse().ok()
    }
}

/// How errors are measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RawErrors {
    /// The axes of position errors.
    pub frame: ErrorFrame,
    /// A trial is lost when its last position error exceeds this (m), or more than half of its position errors do. 0.001 to
    /// 1000000.
    pub lost_m: f64,
}

impl Default for RawErrors {
    fn default() -> Self {
        Self { frame: ErrorFrame::Map, lost_m: 0.5 }
    }
}

/// Content of the recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RawRecord {
    /// Number of the trial, from 0, below `trials`.
    pub trial: u64,
    /// `all`, or a list of labels.
    pub models: Form<All, Vec<String>>,
}

impl Default for RawRecord {
    fn default() -> Self {
        Self { trial: 0, models: Form::Short(All::All) }
    }
}

/// The word `all`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum All {
    /// All.
    All,
}

impl Short for All {
    const FORMS: &'static [&'static str] = &["all", "[LABEL, ...]"];
    const FULL_IS_A_LIST: bool = true;

    fn from_word(word: &str) -> Option<Self> {
        (word == "all").then_some(Self::All)
    }
}

/// Bounds on a figure (`min`, `max`), or figures nested in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct RawBounds {
    /// The figure must not be below this.
    pub min: Option<f64>,
    /// The figure must not be above this.
    pub max: Option<f64>,
    /// Figures nested in this one.
    #[serde(flatten)]
    pub nested: BTreeMap<String, RawBounds>,
}

/// Serde's own `flatten` would read through a buffer and lose the path of a key at fault.
impl<'de> Deserialize<'de> for RawBounds {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct BoundsVisitor;

        impl<'de> Visitor<'de> for BoundsVisitor {
            type Value = RawBounds;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a map such as {max: 0.05}")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<RawBounds, A::Error> {
                let mut bounds = RawBounds::default();
                while let Some(key) = map.next_key::<String>()? {
                    match key.as_str() {
                        "min" => bounds.min = Some(map.next_value()?),
                        "max" => bounds.max = Some(map.next_value()?),
                        _ => _ = bounds.nested.insert(key, map.next_value()?),
                    }
                }
                Ok(bounds)
            }
        }

        deserializer.deserialize_map(BoundsVisitor)
    }
}

/// Values of keys that are absent, where they aren't zero or a type's own default.
pub mod default {
    use super::{Form, No, NotAnnealed, RawAnnealing, RawInjection};

    pub const CELL_M: f64 = 0.1;
    pub const MEMORY_MB: u64 = 512;
    pub const MAP_RESOLUTION_M: f64 = 0.05;
    pub const OBSERVATIONS: u64 = 100;

    pub fn trials() -> u64 {
        1
    }

    pub fn clearance_m() -> f64 {
        0.35
    }

    pub fn field_of_view_deg() -> f64 {
        360.0
    }

    pub fn injection() -> Form<No, RawInjection> {
        Form::Short(No::None)
    }

    pub fn annealing() -> Form<NotAnnealed, RawAnnealing> {
        Form::Short(NotAnnealed::None)
    }

    pub fn annealing_candidates() -> u64 {
        300_000
    }

    pub fn annealing_effective_share() -> f64 {
        0.5
    }

    pub fn annealing_moves() -> u64 {
        4
    }

    pub fn annealing_sigma_m() -> f64 {
        0.01
    }

    pub fn annealing_sigma_deg() -> f64 {
        0.3
    }

    pub fn annealing_gathered_m() -> f64 {
        0.2
    }

    pub fn kld_error() -> f64 {
        0.05
    }

    pub fn kld_quantile() -> f64 {
        0.99
    }

    pub fn kld_bin_m() -> f64 {
        0.5
    }

    pub fn kld_bin_deg() -> f64 {
        10.0
    }
}
