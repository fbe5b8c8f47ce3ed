//! YAML files into typed values, with errors that name file, line, key path, value and what is allowed.
//!
//! `tree` reads the text within limits; the typed value is then made from it by `Node`, whose errors keep what serde
//! knows (the unknown key, the allowed ones) instead of a finished sentence.

mod locate;
pub(crate) mod tree;

use std::fmt;
use std::path::Path;

use locsim_core::limits::{Limits, quoted};
use locsim_dataset::not_a_text;
use serde::Serialize;
use serde::de::value::{MapDeserializer, SeqDeserializer};
use serde::de::{self, DeserializeOwned, DeserializeSeed, Deserializer, Expected, Unexpected, Visitor};
use serde::de::{IntoDeserializer, value::StrDeserializer};

use crate::error::unknown_word;
use crate::key_path::join;
use crate::limited;
use crate::{Problem, ScenarioError};
pub use locate::Locations;
use tree::{Entry, Value};

/// How texts begin that aren't in UTF-8; the longer marks first, as one begins like a shorter one.
const OTHER_ENCODINGS: [(&[u8], &str); 4] = [
    (&[0xff, 0xfe, 0, 0], "UTF-32"),
    (&[0, 0, 0xfe, 0xff], "UTF-32"),
    (&[0xff, 0xfe], "UTF-16"),
    (&[0xfe, 0xff], "UTF-16"),
];

/// How a text in UTF-8 may begin.
const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();

/// The text of a file, without a byte-order mark.
///
/// # Errors
/// [`ScenarioError`] for a file that cannot be read, is above the limit or is not UTF-8.
pub fn read(path: &Path) -> Result<String, ScenarioError> {
    let invalid = |line, message| ScenarioError::Invalid {
        file: path.to_owned(),
        problems: vec![Problem { line, key: String::new(), message }],
    };
    if let Some(found) = not_a_text(path) {
        let message =
            format!("this is {found}; a YAML file is needed (`locsim init` makes a scenario of a log)");
        return Err(invalid(None, message));
    }
    let mut bytes = limited::read(path, "yaml_bytes", Limits::current().yaml_bytes)?;
    if let Some((_, encoding)) = OTHER_ENCODINGS.iter().find(|(mark, _)| bytes.starts_with(mark)) {
        return Err(invalid(None, format!("a text in {encoding} is not allowed; save it as UTF-8")));
    }
    if bytes.starts_with(BYTE_ORDER_MARK) {
        bytes.drain(..BYTE_ORDER_MARK.len());
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let bytes = error.as_bytes();
        let message = format!("the byte 0x{:02x} is not allowed; text in UTF-8", bytes[at]);
        invalid(Some(tree::line_at(bytes, at)), message)
    })
}

/// Makes a value from a text that was read from `path`, and tells where its keys stand. An enum is written as its
/// variant's name, or as a map with that one key.
///
/// # Errors
/// [`ScenarioError`] when the text isn't YAML, holds a key twice, is above a limit, or doesn't fit `T`.
pub fn parse<T: DeserializeOwned>(path: &Path, text: &str) -> Result<(T, Locations), ScenarioError> {
    let invalid = |problems| ScenarioError::Invalid { file: path.to_owned(), problems };
    let empty = || invalid(vec![Problem::of_file("the file is empty; a map of keys is needed")]);
    let root = tree::read(text, Limits::current()).map_err(invalid)?.ok_or_else(empty)?;
    if *root.value() == Value::Null {
        return Err(empty());
    }
    let locations = Locations::new(root);
    let value = serde_path_to_error::deserialize(Node(locations.root().value())).map_err(|error| {
        let mut key =
            if error.path().iter().next().is_none() { String::new() } else { error.path().to_string() };
        if let Mismatch::MissingKey { key: missing } = error.inner() {
            key = join(&key, missing);
        }
        invalid(vec![Problem { line: locations.line(&key), message: error.inner().to_string(), key }])
    })?;
    Ok((value, locations))
}

/// A value as a YAML text, for files that locsim writes whole.
///
/// # Panics
/// Never for structs of numbers and text.
pub fn text(value: &impl Serialize) -> String {
    let text = serde_yaml::to_string(value).expect("a struct of numbers and text is written");
    if !text.contains(LINE_SEPARATORS) {
        return text;
    }
    // The writer indents what follows such a character, which adds spaces to the text. JSON is YAML, and has escapes for them.
    let text = serde_json::to_string_pretty(value).expect("a struct of numbers and text is written");
    LINE_SEPARATORS.iter().fold(text, |text, &c| text.replace(c, &format!("\\u{:04x}", u32::from(c))))
}

/// Characters that end a line in YAML 1.1, and that no keyboard has.
const LINE_SEPARATORS: [char; 3] = ['\u{85}', '\u{2028}', '\u{2029}'];

/// Whether a text is YAML and a map with this key.
pub fn has_key(text: &str, key: &str) -> bool {
    let root = tree::read(text, Limits::current()).ok().flatten();
    root.is_some_and(|root| match root.value() {
        Value::Map(entries) => entries.iter().any(|entry| *entry.key == *key),
        _ => false,
    })
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
        // The least and the greatest number of a type help whoever wrote a number.
        let is_number =
            matches!(found, Unexpected::Unsigned(_) | Unexpected::Signed(_) | Unexpected::Float(_));
        let is_below = match found {
            Unexpected::Signed(value) => value < 0,
            Unexpected::Float(value) => value < u64::MAX as f64,
            _ => false,
        };
        let found = match found {
            Unexpected::Bool(value) => value.to_string(),
            Unexpected::Unsigned(value) => value.to_string(),
            Unexpected::Signed(value) => value.to_string(),
            Unexpected::Float(value) => format!("{value:?}"),
            Unexpected::Str(value) => format!("\"{}\"", quoted(value)),
            Unexpected::Unit | Unexpected::Option => "no value".to_owned(),
            Unexpected::Seq => "a list".to_owned(),
            Unexpected::Map => "a map".to_owned(),
            other => other.to_string(),
        };
        let allowed = match expected.to_string().as_str() {
            "u64" | "usize" if is_below => "a whole number, at least 0".to_owned(),
            expected => plain_words(expected, is_number),
        };
        Self::Value { found, allowed }
    }
}

/// Serde's names of Rust types in words of the file.
fn plain_words(expected: &str, is_number: bool) -> String {
    match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" if !is_number => "a whole number".to_owned(),
        "u8" => whole_numbers_to(u8::MAX.into()),
        "u16" => whole_numbers_to(u16::MAX.into()),
        "u32" => whole_numbers_to(u32::MAX.into()),
        "u64" | "usize" => whole_numbers_to(u64::MAX),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".to_owned(),
        "f32" | "f64" => "a number".to_owned(),
        "a string" => "text (in quotes where it looks like a number)".to_owned(),
        "a sequence" => "a list".to_owned(),
        other if other.starts_with("struct ") => "a map of keys".to_owned(),
        other => other.replace("an array of length", "a list of length"),
    }
}

fn whole_numbers_to(most: u64) -> String {
    format!("a whole number from 0 to {most}")
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
            allowed: plain_words(&expected.to_string(), false),
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

/// A value of a tree as a serde deserializer.
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
        Value::Unsigned(value) => Some(value.to_string()),
        Value::Negative(value) => Some(value.to_string()),
        Value::Float(_, text) | Value::Text(text) => Some(text.to_string()),
        Value::Null => Some("null".to_owned()),
        Value::List(_) | Value::Map(_) => None,
        Value::Shared(node) => scalar_text(node.value()),
    }
}

impl<'de> Deserializer<'de> for Node<'de> {
    type Error = Mismatch;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Mismatch> {
        match self.0 {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::Unsigned(value) => visitor.visit_u64(*value),
            Value::Negative(value) => visitor.visit_i64(*value),
            Value::Float(value, written) => visitor.visit_f64(*value).map_err(|error| match error {
                // As it is written: a whole number may be too large to be one.
                Mismatch::Value { allowed, .. } => Mismatch::Value { found: quoted(written), allowed },
                other => other,
            }),
            Value::Text(value) => visitor.visit_borrowed_str(value),
            Value::List(list) => {
                let mut items = SeqDeserializer::new(list.iter().map(|item| Node(item.value())));
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
            Value::Map(entries) => {
                let entries = entries.iter().map(|Entry { key, value, .. }| (Key(key), Node(value.value())));
                visitor.visit_map(MapDeserializer::new(entries))
            }
            Value::Shared(node) => Node(node.value()).deserialize_any(visitor),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Mismatch> {
        if *self.0 == Value::Null { visitor.visit_none() } else { visitor.visit_some(self) }
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
            Value::List(_) => Err(Mismatch::value(Unexpected::Seq, &visitor)),
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
            Value::Map(entries) if let [Entry { key, value, .. }] = entries.as_slice() => {
                (Some(key.to_string()), Some(value.value()))
            }
            Value::Null => (None, None),
            other => (scalar_text(other), None),
        };
        let Some(word) = word else {
            let found = match self.0 {
                Value::Null => "no value".to_owned(),
                Value::Map(entries) => format!("a map with {} keys", entries.len()),
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
struct Key<'de>(&'de str);

impl<'de> IntoDeserializer<'de, Mismatch> for Key<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Deserializer<'de> for Key<'de> {
    type Error = Mismatch;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Mismatch> {
        visitor.visit_borrowed_str(self.0)
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
            found: format!("`{}` without a value", quoted(&self.word)),
            allowed: format!("write {{{}: ...}}", quoted(&self.word)),
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
                found: format!("a value for `{}`", quoted(&self.word)),
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

#[cfg(test)]
mod tests {
    use std::fs;

    use proptest::prelude::*;

    use super::*;

    fn read_bytes(bytes: &[u8]) -> Result<String, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.yaml");
        fs::write(&path, bytes).unwrap();
        let folder = format!("{}/", folder.path().display());
        read(&path).map_err(|error| error.to_string().replace(&folder, ""))
    }

    #[test]
    fn a_text_is_utf_8_with_or_without_a_byte_order_mark() {
        assert_eq!(read_bytes("\u{feff}seed: 1".as_bytes()).unwrap(), "seed: 1");
        let utf_16: Vec<u8> = "\u{feff}seed: 1".encode_utf16().flat_map(u16::to_le_bytes).collect();
        for (bytes, said) in [
            (utf_16.as_slice(), "s.yaml: a text in UTF-16 is not allowed; save it as UTF-8"),
            (b"\xfe\xff\0s", "s.yaml: a text in UTF-16 is not allowed; save it as UTF-8"),
            (b"\xff\xfe\0\0s\0\0\0", "s.yaml: a text in UTF-32 is not allowed; save it as UTF-8"),
            (b"\0\0\xfe\xff", "s.yaml: a text in UTF-32 is not allowed; save it as UTF-8"),
            (b"a: 1\nb: \xe4\n", "s.yaml:2: the byte 0xe4 is not allowed; text in UTF-8"),
        ] {
            assert_eq!(read_bytes(bytes).unwrap_err(), said);
        }
    }

    #[test]
    fn what_is_no_text_is_told_by_its_first_bytes() {
        for (bytes, found) in [
            (b"\x89MCAP0\r\n".as_slice(), "a ROS 2 bag (MCAP)"),
            (b"SQLite format 3\0\x10", "a SQLite file, perhaps a ROS 2 bag"),
            (b"\x1f\x8b\x08", "a file compressed with gzip, perhaps a log"),
            (b"P5\n4 4\n255\n", "a PGM image, perhaps a map"),
        ] {
            let said = read_bytes(bytes).unwrap_err();
            let init = "(`locsim init` makes a scenario of a log)";
            assert_eq!(said, format!("s.yaml: this is {found}; a YAML file is needed {init}"));
        }
        let folder = tempfile::tempdir().unwrap();
        assert!(read(folder.path()).unwrap_err().to_string().contains(": this is a folder; a YAML file"));
        fs::write(folder.path().join("drive_0.mcap"), b"\x89MCAP0\r\n").unwrap();
        assert!(read(folder.path()).unwrap_err().to_string().contains("this is the folder of a ROS 2 bag"));
    }

    #[test]
    fn no_more_is_read_than_the_limit_allows() {
        let most = Limits::DEFAULT.yaml_bytes;
        let error = read_bytes(&vec![b'#'; most as usize + 5]).unwrap_err();
        let found = most + 5;
        assert!(error.starts_with(&format!("s.yaml: {found} bytes of a YAML file")), "{error}");
        assert!(error.contains(&format!("--limit yaml_bytes={found}")), "{error}");
        assert!(read_bytes(&vec![b'#'; most as usize]).is_ok());
        #[cfg(unix)]
        {
            let error = read(Path::new("/dev/zero")).unwrap_err().to_string();
            assert!(error.ends_with("this is a pipe or a device, and it is read more than once"), "{error}");
        }
        assert!(read(Path::new(".")).unwrap_err().to_string().contains("this is a folder"));
    }

    fn tree(text: &str) -> serde_json::Value {
        parse(Path::new("s.yaml"), text).unwrap_or_else(|error| panic!("{error}\n{text}")).0
    }

    /// YAML files under a folder.
    fn yaml_files(folder: &Path) -> Vec<std::path::PathBuf> {
        let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let files = paths.flat_map(|path| {
            let yaml = path.extension().is_some_and(|extension| extension == "yaml");
            if path.is_dir() { yaml_files(&path) } else { Vec::from_iter(yaml.then_some(path)) }
        });
        files.collect()
    }

    #[test]
    fn our_files_are_read_as_serde_yaml_reads_them() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let files = [yaml_files(&root.join("scenarios")), yaml_files(&root.join("maps"))].concat();
        assert!(files.len() > 15, "{files:?}");
        for file in files {
            let text = fs::read_to_string(&file).unwrap();
            let expected: serde_json::Value = serde_yaml::from_str(&text).unwrap();
            assert_eq!(tree(&text), expected, "{}", file.display());
        }
    }

    fn any_value() -> impl Strategy<Value = serde_json::Value> {
        let scalar = prop_oneof![
            Just(serde_json::Value::Null),
            any::<bool>().prop_map(Into::into),
            any::<u64>().prop_map(Into::into),
            any::<i64>().prop_map(Into::into),
            any::<f64>().prop_filter("finite", |value| value.is_finite()).prop_map(Into::into),
            // Words that look like something else, and any other text.
            "[-+0-9.eE_~ :#'\"nulltrueyesnoinf{}\\[\\],&*!|>%@`-]{0,12}".prop_map(Into::into),
            "[^\\p{C}]{0,12}".prop_map(Into::into),
        ];
        let within = |inner: BoxedStrategy<serde_json::Value>| {
            prop_oneof![
                prop::collection::vec(inner.clone(), 0..4).prop_map(Into::into),
                prop::collection::btree_map("[a-z0-9 :.~-]{0,8}", inner, 0..4)
                    .prop_map(|map| serde_json::Value::Object(map.into_iter().collect())),
            ]
        };
        scalar.boxed().prop_recursive(4, 30, 4, move |inner| within(inner.boxed()))
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_as_it_was(value in any_value()) {
            // A file holds a map.
            let value = serde_json::json!({"value": value});
            prop_assert_eq!(tree(&text(&value)), value);
        }
    }

    #[test]
    fn line_separators_are_kept_as_they_are() {
        for text in ["\u{85}", "a\u{2028}", "\u{2028} b\n", "'\u{2029}\\u2029\""] {
            let value = serde_json::json!({"value": [[text]], "other": 0.5});
            assert_eq!(tree(&self::text(&value)), value);
        }
    }

    #[test]
    fn whole_numbers_out_of_range_are_told_with_the_range() {
        #[derive(Debug, serde::Deserialize)]
        struct One {
            #[expect(dead_code, reason = "only whether it can be read counts")]
            seed: u64,
        }
        let (to, least) = ("a whole number from 0 to 18446744073709551615", "a whole number, at least 0");
        for (word, allowed) in [
            ("18446744073709551616", to),
            (".inf", to),
            ("-1", least),
            ("1.5", least),
            ("1e3", least),
            ("-18446744073709551616", least),
        ] {
            let error = parse::<One>(Path::new("s.yaml"), &format!("seed: {word}\n")).unwrap_err();
            assert_eq!(error.to_string(), format!("s.yaml:1: seed: {word} is not allowed; {allowed}"));
        }
        parse::<One>(Path::new("s.yaml"), "seed: 18446744073709551615\n").unwrap();
    }
}
