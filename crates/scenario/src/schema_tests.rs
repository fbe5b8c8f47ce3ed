//! The JSON Schema says what the program does: it accepts what is accepted, knows every key, and its defaults are
//! the defaults.

use std::collections::BTreeSet;

use serde_json::Value;

use super::tests::{bag, edited, parse, shipped, text};
use super::*;
use crate::testing::{assert_every_key_seen, fits, json_of, properties, resolved};

fn fixtures() -> [String; 5] {
    let simulation = text("simulation.yaml");
    let exact = edited(&simulation, "method: table\n  cell_m: 0.05\n  memory_mb: 300", "method: exact");
    let turning = edited(&text("minimal.yaml"), "speed_m_s: 0.5}", "speed_m_s: 0.5, turn_rate_deg_s: 10}");
    let turning = edited(&turning, "beams: 36", "beams: 36, first_beam_deg: -180");
    let log = edited(&text("log.yaml"), "map_resolution_m: 0.1", "map_resolution_m: 0.1\n  map: walls");
    let around = "start: {around: {x_m: 1, y_m: 2, heading_deg: 90, sigma_m: 0.1, sigma_deg: 3}}";
    let log = edited(&log, "start: global", around);
    [simulation, exact, turning, log, bag()]
}

#[test]
fn the_schema_accepts_what_is_accepted_and_knows_every_key() {
    let schema = schema();
    assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
    let mut seen = BTreeSet::new();
    let shipped = shipped().into_iter().map(|path| std::fs::read_to_string(path).unwrap());
    for text in fixtures().into_iter().chain(shipped) {
        assert!(fits(&schema, &schema, &json_of(&text), &mut seen), "{text}");
    }
    assert_every_key_seen(&schema, &seen, 80);
}

/// The negative control of the checker above: it refuses what the program refuses.
#[test]
fn the_schema_refuses_what_doesnt_fit() {
    let schema = schema();
    for (from, to) in [
        ("trials: 20", "trails: 20"),
        ("trials: 20", "trials: 20.5"),
        ("trials: 20", "trials: -20"),
        ("seed: 7\n", ""),
        ("cell_m: 0.05", "cell_m: small"),
        ("[0.2, 0.6]", "[0.2]"),
        ("[0.2, 0.6]", "[0.2, 0.4, 0.6]"),
        ("resampler: residual", "resampler: sytematic"),
        ("{each_scan_n: 5}", "each_scan_n"),
        ("  - classic", "  - clasic"),
        ("bin_deg: 5", "bin_degrees: 5"),
        ("{lost_share: {max: 0}}", "{lost_share: 0}"),
        ("name: range_bias", "name: range_bais"),
        ("p: 0.05", "k: 0.05"),
        ("radius_m: 0.2", "radius_m: wide"),
        (", radius_m: 0.2", ""),
    ] {
        let text = edited(&text("simulation.yaml"), from, to);
        assert!(!fits(&schema, &schema, &json_of(&text), &mut BTreeSet::new()), "{from} -> {to}");
        assert!(parse(&text).is_err(), "{from} -> {to}");
    }
}

/// Writes the documented default of every absent key into a scenario; collects the properties whose value is
/// their default.
fn fill(root: &Value, schema: &Value, value: &mut Value, seen: &mut BTreeSet<usize>) {
    let schema = resolved(root, schema);
    if let Some(choices) = schema["oneOf"].as_array().or(schema["anyOf"].as_array()) {
        let mut unused = BTreeSet::new();
        if let Some(choice) = choices.iter().find(|choice| fits(root, choice, value, &mut unused)) {
            fill(root, choice, value, seen);
        }
        return;
    }
    match value {
        Value::Object(map) => {
            for (name, property) in schema["properties"].as_object().into_iter().flatten() {
                if let Some(default) = property.get("default") {
                    if map.get(name).unwrap_or(default) == default {
                        seen.insert(std::ptr::from_ref(property) as usize);
                    }
                    map.entry(name.clone()).or_insert_with(|| default.clone());
                }
                if let Some(inner) = map.get_mut(name) {
                    fill(root, property, inner, seen);
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| fill(root, &schema["items"], item, seen)),
        _ => {}
    }
}

#[test]
fn every_documented_default_is_the_default() {
    let schema = schema();
    let minimal = text("minimal.yaml");
    let waypoints = edited(
        &minimal,
        "    velocity_profile:\n      start: {x_m: 3, y_m: 2, heading_deg: 180}\n      segments:\n        - {secs: 4, speed_m_s: 0.5}",
        "    waypoints: {points_m: [[1, 2], [2, 2]], speed_m_s: 1, turn_rate_deg_s: 45}",
    );
    let adaptive = edited(&minimal, "particles: 1000", "particles: {kld: {min: 10, max: 20}}");
    let annealed = edited(&minimal, "particles: 1000", "particles: 1000\n  annealing: {}");
    let placed = edited(&minimal, "{tracking: {}}", "{around: {x_m: 3, y_m: 2, heading_deg: 180}}");
    let log = edited(&text("log.yaml"), "  map_resolution_m: 0.1\n", "");
    let effects = "effects: [{name: mount_offset}, {name: incidence_dropout, p: 0.5, angle_deg: 60}, \
                   {name: range_dropout, p: 0.1}, {name: warmup_drift, bias_m: 0.1}, \
                   {name: moved_wall, from_m: [0, 0], to_m: [1, 0], distance_m: 0.1}, \
                   {name: glass, from_m: [0, 0], to_m: [1, 0], p: 0.1}]";
    let affected = format!("{minimal}{effects}");
    let mut seen = BTreeSet::new();
    for text in [minimal, waypoints, adaptive, annealed, placed, log, affected] {
        let mut explicit = json_of(&text);
        fill(&schema, &schema, &mut explicit, &mut seen);
        // JSON is YAML.
        let without_text = |text: &str| Scenario { text: String::new(), ..parse(text).unwrap() };
        assert_eq!(without_text(&text), without_text(&explicit.to_string()));
    }
    let mut all = Vec::new();
    properties(&schema, &mut all);
    let documented: Vec<_> = all
        .into_iter()
        // `null` only says that a key may be absent.
        .filter(|(_, property)| property.get("default").is_some_and(|default| !default.is_null()))
        .collect();
    assert!(documented.len() > 35, "{}", documented.len());
    for (name, property) in documented {
        assert!(seen.contains(&(std::ptr::from_ref(property) as usize)), "never tried: `{name}` {property}");
    }
}

#[test]
fn what_is_absent_takes_the_value_its_description_names() {
    let minimal = parse(&text("minimal.yaml")).unwrap();
    assert_eq!(minimal.name, "x");
    assert_eq!(
        minimal.training,
        Training { poses: 100, observations: 100, beams: None, held_out_share: 0.25 }
    );
    assert_eq!(minimal.filter.beams, None);
    assert_eq!(minimal.models[0].label, "classic");
    assert_eq!(minimal.record, Record { trial: 0, models: vec!["classic".to_owned()] });
    let log = edited(&text("log.yaml"), "  max_range_m: 40\n", "");
    let Source::Log(log) = parse(&log).unwrap().source else { panic!() };
    assert_eq!(log.max_range_m, None);
}
