//! Figures of profiles: what a named effect does, measured and simulated, without it and with it.

use locsim_core::Estimate;
use locsim_gap::{Over, Profile, ProfileBin, Quantity};
use locsim_report::figures::canvas::{
    Area, Axis, DrawError, Drawn, INK, Mark, chart, figure, heading, line, px,
};
use plotters::prelude::{Circle, Color, PathElement, Polygon, RGBColor};

/// Height of a panel (px).
const PANEL: f64 = 300.0;
/// Room for the labels of the y axis (px).
const LEFT: f64 = 74.0;

/// Words and scale of a quantity or a covariate in figures.
struct Shown {
    label: &'static str,
    scale: f64,
}

fn quantity(quantity: Quantity) -> Shown {
    let (label, scale) = match quantity {
        Quantity::Error => ("median error of the readings [mm]", 1e3),
        Quantity::Spread => ("spread of the errors [mm]", 1e3),
        Quantity::NoReturn => ("readings without a return [%]", 1e2),
        Quantity::InFront => ("readings in front of the map [%]", 1e2),
        Quantity::Share => ("share of the readings [%]", 1e2),
        Quantity::OdometryDistance => ("mean error of a distance [mm]", 1e3),
        Quantity::OdometryTurn => ("mean error of a turn [deg]", 1f64.to_degrees()),
    };
    Shown { label, scale }
}

fn over(over: Over) -> Shown {
    let (label, scale) = match over {
        Over::Range => ("nominal range [m]", 1.0),
        Over::Incidence => ("incidence [deg]", 1f64.to_degrees()),
        Over::Bearing => ("bearing [deg]", 1f64.to_degrees()),
        Over::Time => ("time [s]", 1.0),
        Over::Error => ("reading less nominal range [m]", 1.0),
        Over::Distance => ("distance between two scans [m]", 1.0),
        Over::Turn => ("turn between two scans [deg]", 1f64.to_degrees()),
    };
    Shown { label, scale }
}

/// The profiles of one kind of effect, two panels each.
pub(super) fn draw(profiles: &[&Profile], sides: [RGBColor; 2]) -> Result<String, DrawError> {
    let title = profiles.first().map_or_else(String::new, |profile| {
        let words = |label: &'static str| label.split(" [").next().unwrap_or_default();
        format!(
            "{}: {} over {}",
            profile.name,
            words(quantity(profile.quantity).label),
            words(over(profile.over).label)
        )
    });
    let [before, after] = sides;
    let legend = [
        ("measured".to_owned(), Mark::Dot(INK)),
        ("simulated, scenario as it is".to_owned(), Mark::Line(before)),
        ("simulated, with the named effects".to_owned(), Mark::Line(after)),
    ];
    figure(&title, &legend, PANEL * profiles.len() as f64, |area| {
        for (profile, row) in profiles.iter().zip(area.split_evenly((profiles.len(), 1))) {
            let panels = row.split_evenly((1, 2));
            panel(&panels[0], "Scenario as it is", profile, |bin| bin.before, before)?;
            panel(&panels[1], "With the named effects", profile, |bin| bin.after, after)?;
        }
        Ok(())
    })
}

fn panel(
    area: &Area<'_>,
    title: &str,
    profile: &Profile,
    side: fn(&ProfileBin) -> Estimate,
    color: RGBColor,
) -> Drawn {
    let (x, y) = (over(profile.over), quantity(profile.quantity));
    let bins = &profile.bins;
    let values = bins.iter().flat_map(|bin| {
        [
            bin.measured,
            bin.before.interval.lo,
            bin.before.interval.hi,
            bin.after.interval.lo,
            bin.after.interval.hi,
        ]
        .map(|value| value * y.scale)
    });
    let (lo, hi) = values.fold((0.0_f64, 0.0_f64), |(lo, hi), value| (lo.min(value), hi.max(value)));
    let room = 0.06 * (hi - lo).max(1e-9);
    let places = || bins.iter().map(|bin| bin.at * x.scale);
    let (left, right) = places().fold((f64::MAX, f64::MIN), |(lo, hi), at| (lo.min(at), hi.max(at)));
    let x_axis = Axis::linear(x.label, left, right, 6.0);
    let y_axis = Axis::linear(y.label, if lo < 0.0 { lo - room } else { 0.0 }, hi + room, 5.0);
    let below = heading(area, title, LEFT)?;
    let mut chart = chart(&below, &x_axis, &y_axis, LEFT)?;
    let ends = |pick: fn(Estimate) -> f64| {
        let value = move |bin: &ProfileBin| (bin.at * x.scale, pick(side(bin)) * y.scale);
        bins.iter().map(value).collect::<Vec<_>>()
    };
    let outline: Vec<(f64, f64)> = ends(|band| band.interval.hi)
        .into_iter()
        .chain(ends(|band| band.interval.lo).into_iter().rev())
        .collect();
    chart.draw_series([Polygon::new(outline, color.mix(0.25).filled())])?;
    chart.draw_series([PathElement::new(ends(|band| band.value), line(color, 2.0))])?;
    let dots =
        bins.iter().map(|bin| Circle::new((bin.at * x.scale, bin.measured * y.scale), px(4.0), INK.filled()));
    chart.draw_series(dots)?;
    Ok(())
}
