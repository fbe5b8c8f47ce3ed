//! Residuals: tables of one covariate and one quantity.

use locsim_world::effect::{BeamCovariate, Levels, MOST_VALUES, Moment, Residual};

use crate::check::Allowed::Within;
use crate::check::{COORDINATE, Checker, number};
use crate::key_path::join;
use crate::raw::{RawResidual, RawScenario};

/// Residuals of a scenario.
const MOST_RESIDUALS: usize = 100;
/// The longest time of a table [s].
const LONGEST_SECS: f64 = 1e7;

/// The residuals of a simulated world; those that are refused are left out.
pub(super) fn residuals(check: &mut Checker<'_>, raw: &RawScenario) -> Vec<Residual> {
    check.length("residuals", &raw.residuals, MOST_RESIDUALS);
    let each = raw.residuals.iter().enumerate();
    each.filter_map(|(i, raw)| residual(check, &format!("residuals[{i}]"), raw)).collect()
}

fn residual(check: &mut Checker<'_>, at: &str, raw: &RawResidual) -> Option<Residual> {
    use BeamCovariate as C;
    let degrees = Within(-360.0, 360.0);
    let columns = [
        ("range_m", C::Range, &raw.range_m, COORDINATE, 1.0),
        ("incidence_deg", C::Incidence, &raw.incidence_deg, degrees, 1_f64.to_radians()),
        ("bearing_deg", C::Bearing, &raw.bearing_deg, degrees, 1_f64.to_radians()),
        ("time_secs", C::Time, &raw.time_secs, Within(0.0, LONGEST_SECS), 1.0),
    ];
    let mut levels = Vec::new();
    for (key, covariate, values, allowed, unit) in columns {
        let Some(values) = values else { continue };
        let key = join(at, key);
        length(check, &key, values.len());
        check.numbers(&key, values, allowed);
        for (i, pair) in values.windows(2).enumerate().filter(|(_, pair)| pair[0] >= pair[1]) {
            let here = number(pair[1]);
            check.problem(
                &format!("{key}[{}]", i + 1),
                format!("{here} is not allowed; more than the value before"),
            );
        }
        levels.push((key, Levels::Over(covariate, values.iter().map(|value| value * unit).collect())));
    }
    if let Some(cells) = &raw.cells_m {
        let key = join(at, "cells_m");
        length(check, &key, cells.len());
        for (i, cell) in cells.iter().enumerate() {
            let key = format!("{key}[{i}]");
            check.numbers(&key, cell, COORDINATE);
            check.refuse(!(cell[0] < cell[2] && cell[1] < cell[3]), &key, || {
                let cell = cell.map(number).join(", ");
                format!("[{cell}] is not allowed; [x_min, y_min, x_max, y_max], each max above its min")
            });
        }
        levels.push((key, Levels::Cells(cells.clone())));
    }
    let columns = [
        ("bias_m", Moment::Bias, &raw.bias_m),
        ("spread", Moment::Spread, &raw.spread),
        ("no_return", Moment::NoReturn, &raw.no_return),
        ("short", Moment::Short, &raw.short),
        ("long", Moment::Long, &raw.long),
    ];
    let names = columns.map(|(name, ..)| name).join(", ");
    let mut given =
        columns.into_iter().filter_map(|(key, moment, values)| Some((key, moment, values.as_ref()?)));
    let Some((key, moment, values)) = given.next() else {
        check.problem(at, format!("a curve needs values; one of {names}"));
        return None;
    };
    for (other, ..) in given {
        check.problem(&join(at, other), format!("the key is not allowed here; `{key}` has the values"));
    }
    for (other, _) in levels.iter().skip(1) {
        check.problem(other, format!("the key is not allowed here; the curve is over `{}`", levels[0].0));
    }
    let key = join(at, key);
    let [lo, hi] = moment.limits();
    length(check, &key, values.len());
    check.numbers(&key, values, Within(lo, hi));
    let (over, levels) = levels.into_iter().next().unzip();
    let levels = levels.unwrap_or(Levels::Everywhere);
    let count = levels.count();
    check.refuse(values.len() != count, &key, || {
        let as_many = over
            .map_or_else(|| "1 for all beams".to_owned(), |over| format!("{count}, as many as `{over}` has"));
        format!("a list of length {} is not allowed; {as_many}", values.len())
    });
    // What is refused here has been said above.
    Residual::new(moment, levels, values.clone()).ok()
}

fn length(check: &mut Checker<'_>, key: &str, length: usize) {
    check.refuse(!(1..=MOST_VALUES).contains(&length), key, || {
        format!("a list of length {length} is not allowed; 1 to {MOST_VALUES} values")
    });
}
