//! A sweep as it stands in the file. Doc comments are the descriptions in the JSON Schema.

use std::collections::BTreeMap;
use std::fmt;

use indexmap::IndexMap;
use schemars::JsonSchema;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Number, Value};

/// A sweep: one scenario, run with every combination of other values at some of its keys.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "locsim sweep")]
pub struct RawSweep {
    /// Name of the results: up to 100 letters, digits, `-` and `_`. Default: the file's name without `.yaml`, with `-` for other signs.
    pub name: Option<String>,
    /// One line for people.
    #[serde(default)]
    pub description: String,
    /// The scenario. It must be valid as it is. Relative to this file; `${VARIABLE}` is replaced from the environment.
    pub scenario: String,
    /// The seed that the seed of each cell is derived from.
    pub seed: u64,
    /// Trials of each cell, 1 to 1000000. Default: the scenario's.
    pub trials: Option<u64>,
    /// Values of each axis, by key path of the scenario: `filter.particles`, `blocks.per_metre_of_wall`, `models[0].floor`. Axes are
    /// combined with each other; the last one varies fastest.
    #[schemars(with = "BTreeMap<String, RawAxis>")]
    pub axes: IndexMap<String, RawAxis>,
    /// Groups of axes that vary together, value by value, instead of in all combinations.
    #[serde(default)]
    pub zip: Vec<Vec<String>>,
    /// Comparisons that a cell must meet, each of an axis with an axis or a value: `filter.beams <= laser.beams`.
    #[serde(default, rename = "where")]
    pub conditions: Vec<String>,
    /// Shell lines around a shard's command on a cluster: module lines, a container. `{command}` stands for the command,
    /// `{arguments}` for its arguments alone.
    pub template: Option<String>,
}

/// The values of an axis.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum RawAxis {
    /// One after another: numbers, words, lists or maps.
    List(Vec<Value>),
    /// Evenly spaced numbers.
    Range(RawRange),
}

/// Evenly spaced numbers, both ends included. Whole numbers where `from`, `to` and `step` are written as such.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawRange {
    /// The first number.
    pub from: Number,
    /// The last number, or a bound that no number exceeds.
    pub to: Number,
    /// Distance between neighbours, above 0. Either this or `count`.
    pub step: Option<Number>,
    /// How many numbers, 2 to 100000.
    pub count: Option<u64>,
    /// Whether ratios of neighbours are equal instead of distances. Only with `count`.
    #[serde(default)]
    pub log: bool,
}

/// Serde's own `untagged` would lose the path of a key at fault.
impl<'de> Deserialize<'de> for RawAxis {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct AxisVisitor;

        impl<'de> Visitor<'de> for AxisVisitor {
            type Value = RawAxis;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of values, or a range such as {from: 100, to: 1000, step: 100}")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<RawAxis, A::Error> {
                Deserialize::deserialize(SeqAccessDeserializer::new(list)).map(RawAxis::List)
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<RawAxis, A::Error> {
                Deserialize::deserialize(MapAccessDeserializer::new(map)).map(RawAxis::Range)
            }
        }

        deserializer.deserialize_any(AxisVisitor)
    }
}
