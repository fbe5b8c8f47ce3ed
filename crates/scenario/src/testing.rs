//! Tests of files and their schemas that several crates share.

#![allow(clippy::missing_panics_doc, reason = "a test fails by a panic")]

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::Value;

use crate::ScenarioError;

/// A YAML text as JSON.
pub fn json_of(yaml: &str) -> Value {
    crate::yaml::parse(Path::new("x.yaml"), yaml).unwrap().0
}

/// Follows a reference.
pub(crate) fn resolved<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    match schema["$ref"].as_str() {
        Some(reference) => root.pointer(reference.trim_start_matches('#')).unwrap(),
        None => schema,
    }
}

/// Whether a value fits a schema, by the keywords that ours uses; `seen` collects the property schemas that were
/// matched, by address.
pub fn fits(root: &Value, schema: &Value, value: &Value, seen: &mut BTreeSet<usize>) -> bool {
    let schema = resolved(root, schema);
    if let Some(choices) = schema["oneOf"].as_array().or(schema["anyOf"].as_array()) {
        return choices.iter().any(|choice| fits(root, choice, value, seen));
    }
    if schema["const"] != Value::Null && schema["const"] != *value {
        return false;
    }
    let kinds: Vec<&str> = match &schema["type"] {
        Value::String(kind) => vec![kind],
        Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).collect(),
        _ => panic!("no type: {schema}"),
    };
    kinds.into_iter().any(|kind| match (kind, value) {
        ("null", Value::Null)
        | ("boolean", Value::Bool(_))
        | ("string", Value::String(_))
        | ("number", Value::Number(_)) => true,
        ("integer", Value::Number(number)) => number.is_u64(),
        ("array", Value::Array(items)) => {
            let length = items.len() as u64;
            schema["minItems"].as_u64().is_none_or(|n| n <= length)
                && schema["maxItems"].as_u64().is_none_or(|n| length <= n)
                && items.iter().all(|item| fits(root, &schema["items"], item, seen))
        }
        ("object", Value::Object(map)) => {
            let required = schema["required"].as_array().into_iter().flatten();
            let known = |key: &str| &schema["properties"][key];
            required.filter_map(Value::as_str).all(|key| map.contains_key(key))
                && map.iter().all(|(key, value)| match (known(key), &schema["additionalProperties"]) {
                    (Value::Null, Value::Null | Value::Bool(false)) => false,
                    (Value::Null, rest) => fits(root, rest, value, seen),
                    (property, _) => {
                        let fits = fits(root, property, value, seen);
                        if fits {
                            seen.insert(std::ptr::from_ref(property) as usize);
                        }
                        fits
                    }
                })
        }
        _ => false,
    })
}

/// Every property of every object of the schema, with its name.
pub(crate) fn properties<'a>(schema: &'a Value, out: &mut Vec<(&'a str, &'a Value)>) {
    match schema {
        Value::Object(map) => {
            if let Some(Value::Object(properties)) = map.get("properties") {
                out.extend(properties.iter().map(|(name, schema)| (name.as_str(), schema)));
            }
            map.values().for_each(|inner| properties(inner, out));
        }
        Value::Array(items) => items.iter().for_each(|inner| properties(inner, out)),
        _ => {}
    }
}

/// Every key, more than `least` of them, is among those seen, and is described.
pub fn assert_every_key_seen(schema: &Value, seen: &BTreeSet<usize>, least: usize) {
    let mut all = Vec::new();
    properties(schema, &mut all);
    assert!(all.len() > least, "{}", all.len());
    for (name, property) in all {
        assert!(
            seen.contains(&(std::ptr::from_ref(property) as usize)),
            "no fixture has `{name}`: {property}"
        );
        let described =
            property["description"].as_str().or(resolved(schema, property)["description"].as_str());
        let variant = property["type"] != Value::Null || property["$ref"] != Value::Null;
        assert!(described.is_some() || variant, "`{name}` has no description");
    }
}

/// Replacements of each number of a file.
const HOSTILE: [&str; 16] = [
    "0",
    "-1",
    "1e-300",
    "1e300",
    "1e18",
    "-0.0",
    ".nan",
    ".inf",
    "18446744073709551616",
    "-1e9",
    "0.5",
    "word",
    "[]",
    "{}",
    "~",
    "1e999",
];

/// A text with each of its numbers replaced by each hostile value, and with each of its keys left out or twice. As JSON, a
/// key on each line.
pub fn hostile_texts(text: &str) -> Vec<String> {
    let tree = json_of(text);
    let lines: Vec<String> =
        serde_json::to_string_pretty(&tree).unwrap().lines().map(str::to_owned).collect();
    let mut texts = Vec::new();
    let mut with = |i: usize, new: Vec<String>| {
        let mut changed = lines.clone();
        changed.splice(i..=i, new);
        texts.push(changed.join("\n"));
    };
    for (i, line) in lines.iter().enumerate() {
        let (before, value) = line.rsplit_once(' ').unwrap_or(("", line));
        let (number, comma) = value.strip_suffix(',').map_or((value, ""), |number| (number, ","));
        if number.parse::<f64>().is_ok() {
            for hostile in HOSTILE {
                with(i, vec![format!("{before} {hostile}{comma}")]);
            }
            with(i, vec![]);
        }
        if let Some((key, _)) = line.split_once(": ") {
            with(i, vec![format!("{key}: 0,"), line.clone()]);
            with(i, vec![line.replacen('"', "\"x", 1)]);
        }
    }
    texts
}

/// Every problem is told in a line or two, and those with a key by line.
pub fn assert_told(error: &ScenarioError) {
    let ScenarioError::Invalid { problems, .. } = error else { return };
    assert!(!problems.is_empty());
    for problem in problems {
        assert!(problem.line.is_some() || problem.key.is_empty(), "{problem:?}");
        assert!(problem.to_string().len() < 2000, "{problem}");
    }
}
