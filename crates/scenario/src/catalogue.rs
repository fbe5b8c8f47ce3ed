//! The library of effects as text for people.

use std::fmt::Write;

use comfy_table::presets::UTF8_HORIZONTAL_ONLY;
use comfy_table::{ContentArrangement, Table};
use locsim_world::effect::EffectKind;

use crate::effect::{in_file, unit};
use crate::error::unknown_word;

/// Width of the table, in characters.
const WIDTH: u16 = 110;

/// The names of all effects.
pub fn names() -> impl Iterator<Item = &'static str> {
    EffectKind::ALL.into_iter().map(EffectKind::name)
}

/// All effects as a table: name, what it is, parameters as scenarios write them. At most `width` columns wide.
pub fn table(width: Option<usize>) -> String {
    let mut table = Table::new();
    table.load_style(UTF8_HORIZONTAL_ONLY);
    table
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_width(width.map_or(WIDTH, |width| WIDTH.min(width as u16)));
    // Rules between rows only cost lines.
    table.style_mut().row_separator = comfy_table::LineStyle::none();
    table.set_header(["effect", "what it is", "parameters"]);
    for kind in EffectKind::ALL {
        let place = kind.has_place().then(|| "wall".to_owned());
        let numbers = kind.parameters().iter().map(|parameter| match unit(parameter) {
            Some(unit) => format!("{} [{unit}]", parameter.key),
            None => parameter.key.to_owned(),
        });
        let parameters: Vec<String> = place.into_iter().chain(numbers).collect();
        table.add_row([kind.name().to_owned(), kind.sentence().to_owned(), parameters.join(", ")]);
    }
    table.trim_fmt()
}

/// All there is to say of one effect.
///
/// # Errors
/// A name that isn't one, with the one that may be meant and all that are.
pub fn page(name: &str) -> Result<String, String> {
    let names: Vec<&str> = names().collect();
    let kind: EffectKind = name.parse().map_err(|_| unknown_word(name, "an effect", &names))?;
    let mut text = format!("{kind} ({})\n\n{}\n\n", kind.site().name(), kind.sentence());
    // By the names that scenarios use.
    let formula = kind
        .parameters()
        .iter()
        .fold(kind.formula().to_owned(), |formula, parameter| formula.replace(parameter.name, parameter.key));
    let _ = writeln!(text, "definition      {formula}");
    let _ = writeln!(text, "gives it away   {}", kind.signature());
    let others: Vec<&str> = kind.confused_with().iter().map(|other| other.name()).collect();
    let _ = writeln!(text, "looks like      {}\n", others.join(", "));
    if kind.has_place() {
        text.push_str("wall            name of a wall of a vector map; or from_m and to_m, the ends [x, y] of a stretch\n");
    }
    for parameter in kind.parameters() {
        let [lo, hi, start] =
            [parameter.lo, parameter.hi, parameter.start].map(|value| rounded(in_file(parameter, value)));
        let unit = unit(parameter).map(|unit| format!(" {unit}")).unwrap_or_default();
        let left_out = parameter.default.map(|value| format!("; default {value}")).unwrap_or_default();
        let _ = writeln!(text, "{:<15} {lo} to {hi}{unit}, such as {start}{left_out}", parameter.key);
    }
    Ok(text)
}

/// With as many digits as a person wants to read.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
