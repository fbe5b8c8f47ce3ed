//! Figures of dependences without a name: each curve with its band.

use locsim_core::Estimate;
use locsim_gap::{Covariate, CurvePoint, Deviation, Unnamed};
use locsim_report::figures::canvas::{
    Area, Axis, DrawError, Drawn, INK, Mark, UNKNOWN, chart, figure, heading, line, px,
};
use plotters::prelude::{Circle, Color, PathElement, Polygon, RGBColor};

use super::{covariate, unnamed};

/// Height of a panel (px).
const PANEL: f64 = 260.0;
/// Room for the labels of the y axis (px).
const LEFT: f64 = 74.0;
/// The most curves that are drawn; gap.json has all.
const SHOWN: usize = 3;
/// Fewer points are no curve.
const FEWEST_POINTS: usize = 3;

/// The curves that are drawn: those over a number.
pub(super) fn drawn(found: &[Unnamed]) -> Vec<&Unnamed> {
    let is_curve = |found: &&Unnamed| {
        found.curve.len() >= FEWEST_POINTS && found.curve.iter().all(|point| point.place.is_none())
    };
    found.iter().filter(is_curve).take(SHOWN).collect()
}

/// Label of a quantity, and the factor from its SI unit.
fn quantity(found: &Unnamed) -> (String, f64) {
    let (unit, scale) = match found.deviation {
        Deviation::Mean if found.covariate != Covariate::Neighbour => ("mm", 1e3),
        Deviation::Mean | Deviation::Skew => ("1", 1.0),
        Deviation::Lag => ("s", 1.0),
        Deviation::FrameTurn => ("deg", 1_f64.to_degrees()),
        Deviation::FrameShift => ("mm", 1e3),
        _ => ("%", 1e2),
    };
    (format!("{} [{unit}]", unnamed::noun(found)), scale)
}

/// Label of a covariate, and the factor from its SI unit.
fn over(of: Covariate) -> (String, f64) {
    let (unit, scale) = match of {
        Covariate::Range | Covariate::Jump => (" [m]", 1.0),
        Covariate::Incidence | Covariate::Bearing => (" [deg]", 1_f64.to_degrees()),
        Covariate::TurnRate => (" [deg/s]", 1_f64.to_degrees()),
        Covariate::Time => (" [s]", 1.0),
        Covariate::Speed => (" [m/s]", 1.0),
        _ => ("", 1.0),
    };
    (format!("{}{unit}", covariate::noun(of)), scale)
}

/// One panel for each curve.
pub(super) fn draw(curves: &[&Unnamed], color: RGBColor) -> Result<String, DrawError> {
    let legend = [("learnt from the log, 95 %".to_owned(), Mark::Line(color))];
    figure("What has no name", &legend, PANEL * curves.len() as f64, |area| {
        for (curve, row) in curves.iter().zip(area.split_evenly((curves.len(), 1))) {
            panel(&row, curve, color)?;
        }
        Ok(())
    })
}

fn panel(area: &Area<'_>, found: &Unnamed, color: RGBColor) -> Drawn {
    let ((x_label, x_scale), (y_label, y_scale)) = (over(found.covariate), quantity(found));
    let points = |pick: fn(Estimate) -> f64| -> Vec<(f64, f64)> {
        let point = |point: &CurvePoint| (point.at * x_scale, pick(point.estimate) * y_scale);
        found.curve.iter().map(point).collect()
    };
    let [values, low, high] = [points(|e| e.value), points(|e| e.interval.lo), points(|e| e.interval.hi)];
    let (bottom, top) =
        low.iter().chain(&high).fold((0.0_f64, 0.0_f64), |(lo, hi), (_, y)| (lo.min(*y), hi.max(*y)));
    let room = 0.06 * (top - bottom).max(1e-9);
    let (left, right) = values.iter().fold((f64::MAX, f64::MIN), |(lo, hi), (x, _)| (lo.min(*x), hi.max(*x)));
    let title = unnamed::form_sentence(found).unwrap_or_else(|| unnamed::sentence(found));
    let below = heading(area, &title.replace('`', ""), LEFT)?;
    let (x_axis, y_axis) =
        (Axis::linear(&x_label, left, right, 8.0), Axis::linear(&y_label, bottom - room, top + room, 5.0));
    let mut chart = chart(&below, &x_axis, &y_axis, LEFT)?;
    chart.draw_series([PathElement::new([(left, 0.0), (right, 0.0)], line(UNKNOWN, 1.0))])?;
    let outline: Vec<(f64, f64)> = high.into_iter().chain(low.into_iter().rev()).collect();
    chart.draw_series([Polygon::new(outline, color.mix(0.25).filled())])?;
    chart.draw_series([PathElement::new(values.clone(), line(color, 2.0))])?;
    chart.draw_series(values.into_iter().map(|at| Circle::new(at, px(2.5), INK.filled())))?;
    Ok(())
}
