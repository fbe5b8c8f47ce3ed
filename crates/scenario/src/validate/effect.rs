//! Effects: numbers first, places once the map is known.

use glam::DVec2;
use locsim_world::effect::{Effect, Effects, Moves, Residual};

use crate::LoadedMap;
use crate::check::Allowed::Within;
use crate::check::{COORDINATE, Checker, number};
use crate::effect::{in_file, is_angle};
use crate::error::unknown_word;
use crate::key_path::join;
use crate::raw::{PLACE, RawEffect, RawScenario};

/// Effects of a scenario.
const MOST_EFFECTS: usize = 1000;

/// The effects of a simulated world; places that are given by name are still empty.
pub(super) fn effects(check: &mut Checker<'_>, raw: &RawScenario) -> Vec<Effect> {
    check.length("effects", &raw.effects, MOST_EFFECTS);
    for (i, effect) in raw.effects.iter().enumerate() {
        check.refuse(
            effect.kind.moves() == Moves::Clutter && raw.blocks.is_none(),
            &format!("effects[{i}].name"),
            || format!("`{}` is not allowed; there are no `blocks`", effect.kind),
        );
    }
    raw.effects.iter().enumerate().map(|(i, raw)| effect(check, &format!("effects[{i}]"), raw)).collect()
}

fn effect(check: &mut Checker<'_>, at: &str, raw: &RawEffect) -> Effect {
    let kind = raw.kind;
    let place = if kind.has_place() { &PLACE[..] } else { &[] };
    let known: Vec<&str> = ["name"]
        .into_iter()
        .chain(place.iter().copied())
        .chain(kind.parameters().iter().map(|parameter| parameter.key))
        .collect();
    let given_place = [raw.wall.is_some(), raw.from_m.is_some(), raw.to_m.is_some()];
    let given_place = PLACE.into_iter().zip(given_place).filter(|(_, given)| *given).map(|(word, _)| word);
    let given = raw.unknown.iter().chain(raw.numbers.keys()).map(String::as_str).chain(given_place);
    for word in given.filter(|word| !known.contains(word)) {
        check.problem(&join(at, word), unknown_word(word, &format!("a key of `{kind}`"), &known));
    }
    let mut values = Vec::with_capacity(kind.parameters().len());
    for parameter in kind.parameters() {
        let key = join(at, parameter.key);
        let value = raw.numbers.get(parameter.key).copied().or(parameter.default);
        check.refuse(value.is_none(), &key, || "the key is missing".to_owned());
        let [lo, hi] = [parameter.lo, parameter.hi].map(|limit| in_file(parameter, limit));
        // A missing value has been reported before.
        let value = value.map_or(lo, |value| check.number(&key, value, Within(lo, hi)));
        let value = if is_angle(parameter) { value.to_radians() } else { value };
        values.push(value.clamp(parameter.lo, parameter.hi));
    }
    Effect { kind, values, place: if kind.has_place() { stretch(check, at, raw) } else { Vec::new() } }
}

/// The stretch of wall that is given by its ends.
fn stretch(check: &mut Checker<'_>, at: &str, raw: &RawEffect) -> Vec<[DVec2; 2]> {
    let kind = raw.kind;
    if raw.wall.is_some() {
        let why = "there is a `wall`";
        check.absent(at, "from_m", raw.from_m.as_ref(), why);
        check.absent(at, "to_m", raw.to_m.as_ref(), why);
        return Vec::new();
    }
    let (Some(from), Some(to)) = (raw.from_m, raw.to_m) else {
        let missing = match (raw.from_m, raw.to_m) {
            (Some(_), None) => "to_m",
            (None, Some(_)) => "from_m",
            _ => "wall",
        };
        check.problem(&join(at, missing), format!(
            "the key is missing; `{kind}` acts on a stretch of wall: `wall` (its name), or `from_m` and `to_m`"
        ));
        return Vec::new();
    };
    check.numbers(&join(at, "from_m"), &from, COORDINATE);
    check.numbers(&join(at, "to_m"), &to, COORDINATE);
    let [from, to] = [from, to].map(DVec2::from_array);
    check.refuse(from.distance(to) < 1e-6, &join(at, "to_m"), || {
        format!("[{}, {}] is not allowed; it is where the stretch begins", number(to[0]), number(to[1]))
    });
    vec![[from, to]]
}

/// Finds walls by their names (`walls[i]` of effect `i`), and checks the effects together.
pub(super) fn places(
    check: &mut Checker<'_>,
    effects: &mut [Effect],
    residuals: &[Residual],
    walls: &[Option<String>],
    map: &LoadedMap,
) {
    let geometry = &map.geometry;
    for (i, (effect, wall)) in effects.iter_mut().zip(walls).enumerate() {
        let Some(wall) = wall else { continue };
        let key = format!("effects[{i}].wall");
        if map.image.is_some() {
            check.problem(
                &key,
                "the key is not allowed here; an image of a map has no named walls, give `from_m` and `to_m`",
            );
            continue;
        }
        let names: Vec<&str> = geometry.surface_names().iter().map(String::as_str).collect();
        let surface = names.iter().position(|name| name == wall);
        check.refuse(surface.is_none(), &key, || unknown_word(wall, "a wall of the map", &names));
        let on_it = geometry.segments().iter().zip(geometry.surfaces());
        effect.place =
            on_it.filter(|(_, of)| Some(**of as usize) == surface).map(|(ends, _)| *ends).collect();
    }
    if check.is_clean()
        && let Err(error) =
            Effects::new(effects.to_vec()).and_then(|effects| effects.with_residuals(residuals.to_vec()))
    {
        check.problem("effects", error.to_string());
    }
}
