//! YAML files into typed values, with errors that name file, line, key path, value and what is allowed.
//!
//! The one module that names `serde_yaml`. That crate reads the text; the typed value is then made from its
//! tree by [`Node`], whose errors keep what serde knows (the unknown key, the allowed ones) instead of a
//! finished sentence.

use std::fmt;
use std::path::Path;

use serde::de::value::{MapDeserializer, SeqDeserializer};
use serde::de::{self, DeserializeOwned, DeserializeSeed, Deserializer, Expected, Unexpected, Visitor};
use serde::de::{IntoDeserializer, value::StrDeserializer};
use serde_yaml::Value;

use crate::scenario::error::unknown_word;
use crate::scenario::locate::{Locations, join};
use crate::scenario::{Problem, ScenarioError};

/// The text of a file.
pub(crate) fn read(path: &Path) -> Result<String, ScenarioError> {
    std::fs::read_to_string(path).map_err(|source| ScenarioError::Read { path: path.to_owned(), source })
}

/// Makes a value from a text that was read from `path`, and tells where its keys stand. An enum is written as its
/// variant's name, or as a map with that one key.
///
/// # Errors
/// [`ScenarioError`] when the text isn't YAML, holds a key twice, or doesn't fit `T`.
pub(crate) fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<(T, Locations), ScenarioError> {
    let invalid = |problems| ScenarioError::Invalid { file: path.to_owned(), problems };
    let locations = Locations::of(text);
    if !locations.duplicates().is_empty() {
        return Err(invalid(locations.duplicates().to_vec()));
    }
    let tree: Value = serde_yaml::from_str(text).map_err(|error| {
        let message = error.to_string();
        // The line is already told.
        let what = message.split(" at line ").next().unwrap_or_default();
        let line = error.location().map(|at| at.line());
        invalid(vec![Problem { line, key: String::new(), message: format!("not readable as YAML: {what}") }])
    })?;
    if tree.is_null() {
        let message = "the file is empty; a map of keys is needed".to_owned();
        return Err(invalid(vec![Problem { line: None, key: String::new(), message }]));
    }
    let value = serde_path_to_error::deserialize(Node(&tree)).map_err(|error| {
        let mut key =
            if error.path().iter().next().is_none() { String::new() } else { error.path().to_string() };
        if let Mismatch::MissingKey { key: missing } = error.inner() {
            key = join(&key, missing);
        }
        invalid(vec![Problem { line: locations.line(&key), message: error.inner().to_string(), key }])
    })?;
    Ok((value, locations))
}

/// Why a tree doesn't fit a type.
#[derive(Debug)]
enum Mismatch {
    UnknownKey { key: String, known: &'static [&'static str] },
    MissingKey { key: String },
    UnknownWord { word: String, known: &'static [&'static str] },
    Value { found: String, allowed: String },
    Other(String),
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownKey { key, known } => f.write_str(&unknown_word(key, "a key", known)),
            Self::MissingKey { .. } => f.write_str("the key is missing"),
            Self::UnknownWord { word, known } => f.write_str(&unknown_word(word, "allowed", known)),
            Self::Value { found, allowed } => write!(f, "{found} is not allowed; {allowed}"),
            Self::Other(message) => f.write_str(message),
        }
    }
}

impl std::error::Error for Mismatch {}

impl Mismatch {
    fn value(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        let found = match found {
            Unexpected::Bool(value) => value.to_string(),
            Unexpected::Unsigned(value) => value.to_string(),
            Unexpected::Signed(value) => value.to_string(),
            Unexpected::Float(value) => format!("{value:?}"),
            Unexpected::Str(value) => format!("{value:?}"),
            Unexpected::Unit | Unexpected::Option => "no value".to_owned(),
            Unexpected::Seq => "a list".to_owned(),
            Unexpected::Map => "a map".to_owned(),
            other => other.to_string(),
        };
        Self::Value { found, allowed: plain_words(&expected.to_string()) }
    }
}

/// Serde's names of Rust types in words of the file.
fn plain_words(expected: &str) -> String {
    match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, not negative".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".to_owned(),
        "f32" | "f64" => "a number".to_owned(),
        "a string" => "text (in quotes where it looks like a number)".to_owned(),
        "a sequence" => "a list".to_owned(),
        other if other.starts_with("struct ") => "a map of keys".to_owned(),
        other => other.replace("an array of length", "a list of length"),
    }
}

impl de::Error for Mismatch {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::Other(message.to_string())
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::value(found, expected)
    }

    fn invalid_value(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::value(found, expected)
    }

    fn invalid_length(length: usize, expected: &dyn Expected) -> Self {
        Self::Value {
            found: format!("a list of length {length}"),
            allowed: plain_words(&expected.to_string()),
        }
    }

    fn unknown_variant(word: &str, known: &'static [&'static str]) -> Self {
        Self::UnknownWord { word: word.to_owned(), known }
    }

    fn unknown_field(key: &str, known: &'static [&'static str]) -> Self {
        Self::UnknownKey { key: key.to_owned(), known }
    }

    fn missing_field(key: &'static str) -> Self {
        Self::MissingKey { key: key.to_owned() }
    }
}

/// A tree as a serde deserializer.
#[derive(Clone, Copy)]
struct Node<'de>(&'de Value);

impl<'de> IntoDeserializer<'de, Mismatch> for Node<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

/// The text of a scalar that stands where a name is wanted; `None` for what isn't a scalar.
fn scalar_text(value: &Value) -> Option<String> {
    match value {
        Value::Bool(value) => Some(value.to_string()),
        Value::Number(value) => Some(value.to_string()),
        Value::String(value) => Some(value.clone()),
        Value::Null => Some("null".to_owned()),
        Value::Sequence(_) | Value::Mapping(_) | Value::Tagged(_) => None,
    }
}

impl<'de> Deserializer<'de> for Node<'de> {
    type Error = Mismatch;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Mismatch> {
        match self.0 {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::Number(number) => {
                if let Some(value) = number.as_u64() {
                    visitor.visit_u64(value)
                } else if let Some(value) = number.as_i64() {
                    visitor.visit_i64(value)
                } else {
                    visitor.visit_f64(number.as_f64().unwrap_or(f64::NAN))
                }
            }
            Value::String(value) => visitor.visit_borrowed_str(value),
            Value::Sequence(list) => {
                let mut items = SeqDeserializer::new(list.iter().map(Node));
                let value = visitor.visit_seq(&mut items)?;
                match items.end() {
                    Ok(()) => Ok(value),
                    Err(Mismatch::Value { allowed, .. }) => Err(Mismatch::Value {
                        found: format!("a list of length {}", list.len()),
                        allowed: allowed.split_once(' ').map_or_else(
                            || allowed.clone(),
                            |(count, _)| format!("a list of length {count}"),
                        ),
                    }),
                    Err(other) => Err(other),
                }
            }
            Value::Mapping(map) => {
                let entries = map.iter().map(|(key, value)| (Key(key), Node(value)));
                visitor.visit_map(MapDeserializer::new(entries))
            }
            Value::Tagged(tagged) => Err(Mismatch::Value {
                found: format!("the YAML tag {}", tagged.tag),
                allowed: "a value without a tag".to_owned(),
            }),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Mismatch> {
        if self.0.is_null() { visitor.visit_none() } else { visitor.visit_some(self) }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Mismatch> {
        visitor.visit_newtype_struct(self)
    }

    /// Derived visitors would take a list as the fields in their order.
    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Mismatch> {
        match self.0 {
            Value::Sequence(_) => Err(Mismatch::value(Unexpected::Seq, &visitor)),
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Mismatch> {
        let (word, content) = match self.0 {
            Value::Mapping(map) if map.len() == 1 => {
                let entry = map.iter().next();
                (entry.and_then(|(key, _)| scalar_text(key)), entry.map(|(_, value)| value))
            }
            Value::Null => (None, None),
            other => (scalar_text(other), None),
        };
        let Some(word) = word else {
            let found = match self.0 {
                Value::Null => "no value".to_owned(),
                Value::Mapping(map) => format!("a map with {} keys", map.len()),
                _ => "a list".to_owned(),
            };
            return Err(Mismatch::Value { found, allowed: format!("one of {}", variants.join(", ")) });
        };
        visitor.visit_enum(Choice { word, content })
    }

    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Mismatch> {
        visitor.visit_unit()
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit unit_struct
        seq tuple tuple_struct map identifier
    }
}

/// A map key: always taken as text, or a number would count as the index of a field.
#[derive(Clone, Copy)]
struct Key<'de>(&'de Value);

impl<'de> IntoDeserializer<'de, Mismatch> for Key<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Deserializer<'de> for Key<'de> {
    type Error = Mismatch;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Mismatch> {
        let text = scalar_text(self.0).ok_or_else(|| Mismatch::Value {
            found: "a map or list as a key".to_owned(),
            allowed: "a word".to_owned(),
        })?;
        visitor.visit_string(text)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit
        unit_struct newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}

/// One variant of an enum: a word, with content where it was written as a map.
struct Choice<'de> {
    word: String,
    content: Option<&'de Value>,
}

impl<'de> Choice<'de> {
    fn content(&self) -> Result<Node<'de>, Mismatch> {
        self.content.map(Node).ok_or_else(|| Mismatch::Value {
            found: format!("`{}` without a value", self.word),
            allowed: format!("write {{{}: ...}}", self.word),
        })
    }
}

impl<'de> de::EnumAccess<'de> for Choice<'de> {
    type Error = Mismatch;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), Mismatch> {
        let word: StrDeserializer<'_, Mismatch> = self.word.as_str().into_deserializer();
        Ok((seed.deserialize(word)?, self))
    }
}

impl<'de> de::VariantAccess<'de> for Choice<'de> {
    type Error = Mismatch;

    fn unit_variant(self) -> Result<(), Mismatch> {
        match self.content {
            None => Ok(()),
            Some(_) => Err(Mismatch::Value {
                found: format!("a value for `{}`", self.word),
                allowed: "it stands alone".to_owned(),
            }),
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, Mismatch> {
        seed.deserialize(self.content()?)
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Mismatch> {
        self.content()?.deserialize_any(visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Mismatch> {
        self.content()?.deserialize_struct("", fields, visitor)
    }
}
