//! Effects as files write them: angles in degrees, a place by the name of a wall or by its ends.

use std::fmt::Write;

use locsim_world::effect::{Effect, EffectKind, Parameter};

/// The key of a parameter in files: its name, where angles are in degrees.
pub(crate) fn key(parameter: &Parameter) -> &'static str {
    match parameter.name {
        "angle_rad" => "angle_deg",
        "width_rad" => "width_deg",
        "yaw_rad" => "yaw_deg",
        "from_rad" => "from_deg",
        "to_rad" => "to_deg",
        "turn_per_m" => "turn_deg_per_m",
        name => name,
    }
}

/// Whether a parameter is an angle, or an angle per metre.
pub(crate) fn is_angle(parameter: &Parameter) -> bool {
    parameter.unit.starts_with("rad")
}

/// A value as it stands in files.
pub(crate) fn in_file(parameter: &Parameter, value: f64) -> f64 {
    if is_angle(parameter) { value.to_degrees() } else { value }
}

/// The value of a parameter that may be left out, as it would stand in the file; `None` where it may not.
pub(crate) fn default(kind: EffectKind, parameter: &Parameter) -> Option<f64> {
    match (kind, parameter.name) {
        (EffectKind::IncidenceDropout, "width_rad") => Some(3.0),
        (EffectKind::RangeDropout, "exponent") => Some(4.0),
        (EffectKind::WarmupDrift, "tau_secs") => Some(60.0),
        (EffectKind::MountOffset, _) => Some(0.0),
        _ => None,
    }
}

/// The keys of an effect in files, its name and those of a place aside.
pub(crate) fn keys(kind: EffectKind) -> impl Iterator<Item = &'static str> {
    kind.parameters().iter().map(key)
}

/// An effect as an entry of a scenario's list `effects`: `- {name: glass, wall: north, p: 0.3}`.
///
/// The place is that of the wall called `surface_name`, if there is one; otherwise each of its stretches gets an entry,
/// on a line of its own, with its ends.
pub fn effect_yaml(effect: &Effect, surface_name: Option<&str>) -> String {
    let mut values = String::new();
    for (parameter, &value) in effect.kind.parameters().iter().zip(&effect.values) {
        // 0 without a sign, as people write it.
        let value = in_file(parameter, value) + 0.0;
        let _ = write!(values, ", {}: {value}", key(parameter));
    }
    let entry = |place: &str| format!("- {{name: {}{place}{values}}}", effect.kind);
    match surface_name {
        _ if effect.place.is_empty() => entry(""),
        Some(name) => entry(&format!(", wall: {}", word(name))),
        None => {
            let lines: Vec<String> = effect
                .place
                .iter()
                .map(|[a, b]| {
                    entry(&format!(
                        ", from_m: [{}, {}], to_m: [{}, {}]",
                        a.x + 0.0,
                        a.y + 0.0,
                        b.x + 0.0,
                        b.y + 0.0
                    ))
                })
                .collect();
            lines.join("\n")
        }
    }
}

/// A text in YAML: as it is where it can't be taken for something else, in quotes otherwise.
fn word(text: &str) -> String {
    let reserved = ["true", "false", "null", "yes", "no", "on", "off", "y", "n"];
    let plain = text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || "-_/".contains(c))
        && !reserved.contains(&text.to_ascii_lowercase().as_str());
    // A JSON string is a YAML string in quotes.
    if plain { text.to_owned() } else { serde_json::Value::from(text).to_string() }
}
