//! Effects as files write them: angles in degrees, a place by the name of a wall or by its ends.

use std::fmt::Write;

use locsim_core::limits::is_hidden;
use locsim_world::effect::{BeamCovariate, Effect, Levels, Moment, Parameter, Residual};

/// Whether a parameter is an angle, or an angle per metre.
pub fn is_angle(parameter: &Parameter) -> bool {
    parameter.unit.starts_with("rad")
}

/// The unit of a value as it stands in files; `None` for a pure number.
pub fn unit(parameter: &Parameter) -> Option<&'static str> {
    match parameter.unit {
        "1" => None,
        "rad" => Some("deg"),
        "rad/m" => Some("deg/m"),
        unit => Some(unit),
    }
}

/// A value as it stands in files.
pub fn in_file(parameter: &Parameter, value: f64) -> f64 {
    if is_angle(parameter) { value.to_degrees() } else { value }
}

/// An effect as an entry of a scenario's list `effects`: `- {name: glass, wall: north, p: 0.3}`.
///
/// The place is that of the wall called `surface_name`, if there is one; otherwise each of its stretches gets an entry,
/// on a line of its own, with its ends.
pub fn effect_yaml(effect: &Effect, surface_name: Option<&str>) -> String {
    effect_yaml_with(effect, surface_name, &|_, value| value)
}

/// [`effect_yaml`] with values that `shown` rounds, as they stand in the file.
pub fn effect_yaml_with(
    effect: &Effect,
    surface_name: Option<&str>,
    shown: &dyn Fn(&Parameter, f64) -> f64,
) -> String {
    let mut values = String::new();
    for (parameter, &value) in effect.kind.parameters().iter().zip(&effect.values) {
        // 0 without a sign, as people write it.
        let value = shown(parameter, in_file(parameter, value)) + 0.0;
        let _ = write!(values, ", {}: {value}", parameter.key);
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

/// A residual as an entry of a scenario's list `residuals`: `- {bearing_deg: [-90, 0, 90], bias_m: [0, 0.01, 0]}`.
///
/// Numbers are rounded: levels to four digits after the point, values to six.
pub fn residual_yaml(residual: &Residual) -> String {
    let list = |values: &mut dyn Iterator<Item = f64>, decimals: i32| {
        let scale = 10_f64.powi(decimals);
        // 0 without a sign, as people write it.
        let words = values.map(|value| ((value * scale).round() / scale + 0.0).to_string());
        format!("[{}]", words.collect::<Vec<_>>().join(", "))
    };
    let levels = match residual.levels() {
        Levels::Everywhere => String::new(),
        Levels::Over(covariate, at) => {
            let (key, unit) = match covariate {
                BeamCovariate::Range => ("range_m", 1.0),
                BeamCovariate::Incidence => ("incidence_deg", 1_f64.to_radians()),
                BeamCovariate::Bearing => ("bearing_deg", 1_f64.to_radians()),
                BeamCovariate::Time => ("time_secs", 1.0),
            };
            format!("{key}: {}, ", list(&mut at.iter().map(|value| value / unit), 4))
        }
        Levels::Cells(cells) => {
            let cells: Vec<String> = cells.iter().map(|cell| list(&mut cell.iter().copied(), 4)).collect();
            format!("cells_m: [{}], ", cells.join(", "))
        }
    };
    let key = match residual.moment() {
        Moment::Bias => "bias_m",
        Moment::Spread => "spread",
        Moment::NoReturn => "no_return",
        Moment::Short => "short",
        Moment::Long => "long",
    };
    format!("- {{{levels}{key}: {}}}", list(&mut residual.values().iter().copied(), 6))
}

/// A text in YAML: as it is where it can't be taken for something else, in quotes otherwise.
fn word(text: &str) -> String {
    let reserved = ["true", "false", "null", "yes", "no", "on", "off", "y", "n"];
    let plain = text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || "-_/".contains(c))
        && !reserved.contains(&text.to_ascii_lowercase().as_str());
    if plain { text.to_owned() } else { quoted_text(text) }
}

/// A text in quotes in YAML, on one line whatever it holds.
pub fn quoted_text(text: &str) -> String {
    // A JSON string is a YAML string in quotes; JSON leaves some characters as they are that end lines in YAML 1.1.
    let mut quoted = String::new();
    for c in serde_json::Value::from(text).to_string().chars() {
        if is_hidden(c) {
            let _ = write!(quoted, "\\u{:04x}", u32::from(c));
        } else {
            quoted.push(c);
        }
    }
    quoted
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use locsim_world::effect::EffectKind;

    use super::*;
    use crate::tests::{parse, text};
    use crate::{Scenario, Source};

    fn effects(scenario: Scenario) -> Vec<Effect> {
        let Source::Simulation(simulation) = scenario.source else { panic!() };
        simulation.effects
    }

    /// A scenario that lists these entries.
    fn scenario(entries: &str) -> String {
        let indented = entries.replace("\n-", "\n  -");
        format!("{}effects:\n  {indented}\n", text("minimal.yaml"))
    }

    /// Every effect of the fixture, and each kind that it lacks at typical values. Angles are off by the rounding of degrees.
    #[test]
    fn an_effect_that_is_written_is_read_back() {
        let mut written = effects(parse(&text("simulation.yaml")).unwrap());
        let stretch = [DVec2::new(1.0, 0.0), DVec2::new(2.0, 0.0)];
        for kind in EffectKind::ALL {
            if !written.iter().any(|effect| effect.kind == kind) {
                written.push(Effect::typical(kind, Vec::from_iter(kind.has_place().then_some(stretch))));
            }
        }
        for effect in written {
            let named = (effect.kind == EffectKind::Glass).then_some("outline/0");
            for name in [None, named] {
                let read = effects(parse(&scenario(&effect_yaml(&effect, name))).unwrap());
                assert_eq!(read.len(), 1);
                assert_eq!(read[0].kind, effect.kind);
                for (a, b) in read[0].values.iter().zip(&effect.values) {
                    assert!((a - b).abs() <= 1e-15 * b.abs(), "{}: {a} {b}", effect.kind);
                }
                let south = vec![[DVec2::ZERO, DVec2::new(20.0, 0.0)]];
                assert_eq!(read[0].place, if name.is_some() { south } else { effect.place.clone() });
            }
        }
    }

    #[test]
    fn residuals_come_back_as_they_were_written() {
        let curve = |moment, levels, values: &[f64]| Residual::new(moment, levels, values.to_vec()).unwrap();
        let over = |covariate, at: &[f64]| Levels::Over(covariate, at.to_vec());
        let curves = [
            curve(Moment::Bias, Levels::Everywhere, &[-0.0125]),
            curve(Moment::Spread, over(BeamCovariate::Range, &[0.5, 2.25]), &[-0.5, 3.0]),
            curve(Moment::NoReturn, over(BeamCovariate::Time, &[0.0, 60.0]), &[0.0, 1.0]),
            curve(Moment::Short, Levels::Cells(vec![[-1.0, 0.0, 1.0, 0.5]]), &[0.25]),
            curve(Moment::Long, over(BeamCovariate::Incidence, &[0.0, 60_f64.to_radians()]), &[0.25, 0.5]),
            curve(Moment::Bias, over(BeamCovariate::Bearing, &[-1_f64.to_radians()]), &[0.5]),
        ];
        let entries: Vec<String> =
            curves.iter().map(|curve| format!("  {}\n", residual_yaml(curve))).collect();
        let scenario = parse(&format!("{}residuals:\n{}", text("minimal.yaml"), entries.concat())).unwrap();
        let crate::Source::Simulation(simulation) = scenario.source else { panic!() };
        assert_eq!(simulation.residuals.len(), curves.len());
        for (read, written) in simulation.residuals.iter().zip(&curves) {
            assert_eq!((read.moment(), read.values()), (written.moment(), written.values()));
            assert_eq!(residual_yaml(read), residual_yaml(written));
        }
        assert_eq!(entries[3], "  - {cells_m: [[-1, 0, 1, 0.5]], short: [0.25]}\n");
    }

    #[test]
    fn effects_are_written_as_people_write_them() {
        let stretch = |x: f64| [DVec2::new(x, -0.0), DVec2::new(x, 1.5)];
        let glass = Effect::new(EffectKind::Glass, vec![0.3, 0.0], vec![stretch(1.0), stretch(2.0)]).unwrap();
        assert_eq!(
            effect_yaml(&glass, Some("north-3")),
            "- {name: glass, wall: north-3, p: 0.3, clutter: 0}"
        );
        assert_eq!(effect_yaml(&glass, Some("3")), "- {name: glass, wall: \"3\", p: 0.3, clutter: 0}");
        assert_eq!(effect_yaml(&glass, Some("No")), "- {name: glass, wall: \"No\", p: 0.3, clutter: 0}");
        assert_eq!(
            effect_yaml(&glass, Some("a: \"b\"")),
            "- {name: glass, wall: \"a: \\\"b\\\"\", p: 0.3, clutter: 0}"
        );
        assert_eq!(
            effect_yaml(&glass, None),
            "- {name: glass, from_m: [1, 0], to_m: [1, 1.5], p: 0.3, clutter: 0}\n\
             - {name: glass, from_m: [2, 0], to_m: [2, 1.5], p: 0.3, clutter: 0}"
        );
        let yaw = Effect::new(EffectKind::MountYaw, vec![std::f64::consts::FRAC_PI_2], vec![]).unwrap();
        assert_eq!(effect_yaml(&yaw, None), "- {name: mount_yaw, yaw_deg: 90}");
        assert_eq!(
            effect_yaml(&Effect::neutral(EffectKind::MountOffset, vec![]), None),
            "- {name: mount_offset, x_m: 0, y_m: 0}"
        );
    }
}
