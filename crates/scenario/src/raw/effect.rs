use std::collections::BTreeMap;
use std::fmt;
use std::sync::LazyLock;

use locsim_world::effect::EffectKind;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, IgnoredAny, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use crate::effect::{in_file, unit};

/// An effect with its numbers in the units of the file, by key; which belong to it is checked later, as the name may
/// stand after them.
#[derive(Clone, Debug, PartialEq)]
pub struct RawEffect {
    /// Which.
    pub kind: EffectKind,
    /// A named wall of the map.
    pub wall: Option<String>,
    /// One end of a stretch of wall (m).
    pub from_m: Option<[f64; 2]>,
    /// The other end (m).
    pub to_m: Option<[f64; 2]>,
    /// Numbers of any effect.
    pub numbers: BTreeMap<String, f64>,
    /// Keys of no effect at all.
    pub unknown: Vec<String>,
}

/// Keys of places.
pub const PLACE: [&str; 3] = ["wall", "from_m", "to_m"];

/// The name of an effect.
struct Name(EffectKind);

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        static NAMES: LazyLock<Vec<&str>> =
            LazyLock::new(|| EffectKind::ALL.into_iter().map(EffectKind::name).collect());
        let word = String::deserialize(deserializer)?;
        word.parse().map(Self).map_err(|_| D::Error::unknown_variant(&word, &NAMES))
    }
}

impl<'de> Deserialize<'de> for RawEffect {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct EffectVisitor;

        impl<'de> Visitor<'de> for EffectVisitor {
            type Value = RawEffect;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a map such as {name: range_bias, bias_m: 0.02}")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<RawEffect, A::Error> {
                let mut kind = None;
                let (mut wall, mut from_m, mut to_m) = (None, None, None);
                let (mut numbers, mut unknown) = (BTreeMap::new(), Vec::new());
                while let Some(key) = map.next_key::<String>()? {
                    match key.as_str() {
                        "name" => kind = Some(map.next_value::<Name>()?.0),
                        "wall" => wall = Some(map.next_value()?),
                        "from_m" => from_m = Some(map.next_value()?),
                        "to_m" => to_m = Some(map.next_value()?),
                        number if is_key(number) => {
                            numbers.insert(key, map.next_value()?);
                        }
                        _ => {
                            map.next_value::<IgnoredAny>()?;
                            unknown.push(key);
                        }
                    }
                }
                let kind = kind.ok_or_else(|| A::Error::missing_field("name"))?;
                Ok(RawEffect { kind, wall, from_m, to_m, numbers, unknown })
            }
        }

        deserializer.deserialize_map(EffectVisitor)
    }
}

/// Whether a parameter of any effect has this key.
fn is_key(key: &str) -> bool {
    let mut parameters = EffectKind::ALL.into_iter().flat_map(EffectKind::parameters);
    parameters.any(|parameter| parameter.key == key)
}

impl Serialize for RawEffect {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("name", &self.kind)?;
        if let Some(wall) = &self.wall {
            map.serialize_entry("wall", wall)?;
        }
        for (key, end) in [("from_m", &self.from_m), ("to_m", &self.to_m)] {
            if let Some(end) = end {
                map.serialize_entry(key, end)?;
            }
        }
        for (key, number) in &self.numbers {
            map.serialize_entry(key, number)?;
        }
        map.end()
    }
}

impl JsonSchema for RawEffect {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "RawEffect".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let kinds: Vec<Value> = EffectKind::ALL.into_iter().map(schema_of).collect();
        json_schema!({ "description": "An effect: its name and its numbers.", "oneOf": kinds })
    }
}

/// One kind of effect.
fn schema_of(kind: EffectKind) -> Value {
    let mut properties = Map::new();
    let mut required = vec!["name"];
    let name = serde_json::json!({
        "type": "string",
        "const": kind.name(),
        "description": format!("{} Definition: {}.", kind.sentence(), kind.formula()),
    });
    properties.insert("name".to_owned(), name);
    if kind.has_place() {
        let wall = "Name of a wall of a vector map. Either this or `from_m` and `to_m`.";
        properties.insert("wall".to_owned(), serde_json::json!({ "type": "string", "description": wall }));
        for (key, which) in [("from_m", "One end"), ("to_m", "The other end")] {
            let end = serde_json::json!({
                "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2,
                "description": format!("{which} of the stretch of wall [x, y] in the map frame (m)."),
            });
            properties.insert(key.to_owned(), end);
        }
    }
    for parameter in kind.parameters() {
        let [lo, hi] = [parameter.lo, parameter.hi].map(|limit| in_file(parameter, limit));
        let unit = unit(parameter).map(|unit| format!(" ({unit})")).unwrap_or_default();
        let mut number = serde_json::json!({
            "type": "number", "minimum": lo, "maximum": hi,
            "description": format!("Parameter of `{kind}`{unit}, {lo} to {hi}."),
        });
        match parameter.default {
            Some(default) => number["default"] = default.into(),
            None => required.push(parameter.key),
        }
        properties.insert(parameter.key.to_owned(), number);
    }
    serde_json::json!({
        "type": "object", "properties": properties, "required": required, "additionalProperties": false,
    })
}
