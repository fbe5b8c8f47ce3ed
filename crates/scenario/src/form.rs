use std::fmt;
use std::marker::PhantomData;

use schemars::JsonSchema;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error, MapAccess, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

// A value with a short form (a word or a number) and a full form (a map or a list). Doc comments here would become
// descriptions in the JSON Schema.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
#[schemars(inline)]
pub(super) enum Form<S, F> {
    Short(S),
    Full(F),
}

/// A value that can be written as a word or a number.
pub(super) trait Short: Sized {
    /// Every form that is allowed, the full one included, as an error message shows them.
    const FORMS: &'static [&'static str];

    /// Whether the full form is a list; otherwise it is a map, which no list stands for.
    const FULL_IS_A_LIST: bool = false;

    /// From a word of the file.
    fn from_word(_: &str) -> Option<Self> {
        None
    }

    /// From a whole number.
    fn from_count(_: u64) -> Option<Self> {
        None
    }
}

impl<'de, S: Short, F: Deserialize<'de>> Deserialize<'de> for Form<S, F> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(FormVisitor(PhantomData))
    }
}

struct FormVisitor<S, F>(PhantomData<(S, F)>);

impl<'de, S: Short, F: Deserialize<'de>> Visitor<'de> for FormVisitor<S, F> {
    type Value = Form<S, F>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "allowed: {}", S::FORMS.join(", "))
    }

    fn visit_str<E: Error>(self, word: &str) -> Result<Self::Value, E> {
        S::from_word(word).map(Form::Short).ok_or_else(|| E::unknown_variant(word, S::FORMS))
    }

    fn visit_u64<E: Error>(self, count: u64) -> Result<Self::Value, E> {
        S::from_count(count)
            .map(Form::Short)
            .ok_or_else(|| E::invalid_type(Unexpected::Unsigned(count), &self))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        F::deserialize(MapAccessDeserializer::new(map)).map(Form::Full)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Self::Value, A::Error> {
        if !S::FULL_IS_A_LIST {
            return Err(A::Error::invalid_type(Unexpected::Seq, &self));
        }
        F::deserialize(SeqAccessDeserializer::new(list)).map(Form::Full)
    }
}
