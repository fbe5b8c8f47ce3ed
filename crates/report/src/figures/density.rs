//! The paper's Fig. 11: what every model predicts for one beam.

use plotters::prelude::{PathElement, RGBColor, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{Axis, DrawError, INK, LABEL, Mark, READING, chart, figure, line, model_color, px, text};
use crate::results::{BeamProbe, DetailedTrial};

/// Decades shown below the highest density.
const DECADES: f64 = 4.5;

/// The nominal range stands at most this far along the axis, so that its label has room.
const ROOM_FOR_LABEL: f64 = 0.86;

/// Share of the maximum range beyond which a wall is too near the axis's end to show what stands at it.
const IN_SIGHT: f32 = 0.85;

/// A reading this much shorter than its nominal range has met something that isn't in the map (m).
const SHORTENED_M: f32 = 0.1;

/// Predictions of the models for one shortened beam: of the steps at which all of them probed the same beam of the
/// same particle and its reading was short, the one with the median shortfall. Empty without such a step.
pub fn shortened_beam(detail: &DetailedTrial) -> Vec<(&str, &BeamProbe)> {
    let Some(first) = detail.models.first() else { return Vec::new() };
    let same = |a: &BeamProbe, b: &BeamProbe| a.beam == b.beam && a.pose == b.pose && !b.z_m.is_empty();
    let mut short: Vec<(f32, usize)> = first
        .steps
        .iter()
        .enumerate()
        .map(|(step, s)| (s.probe.nominal_m - s.probe.reading_m, step))
        .filter(|&(shortfall, step)| {
            let probe = &first.steps[step].probe;
            let furthest = probe.z_m.last().copied().unwrap_or(0.0);
            shortfall > SHORTENED_M && probe.nominal_m < IN_SIGHT * furthest
        })
        .filter(|&(_, step)| {
            let shared = &first.steps[step].probe;
            detail.models.iter().all(|m| m.steps.get(step).is_some_and(|s| same(shared, &s.probe)))
        })
        .collect();
    short.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    short.get(short.len() / 2).map_or_else(Vec::new, |&(_, step)| {
        detail.models.iter().map(|m| (m.name.as_str(), &m.steps[step].probe)).collect()
    })
}

/// Predicted densities of the models for the same beam of the same particle, with the nominal range and the
/// reading. The legend gives each model's density at the reading and its probability of no return.
///
/// `models` fixes the colours; the first probe's nominal range and reading are drawn.
pub fn predicted(models: &[String], probes: &[(&str, &BeamProbe)]) -> Result<String, DrawError> {
    let (nominal, reading) =
        probes.first().map_or((0.0, 0.0), |(_, p)| (f64::from(p.nominal_m), f64::from(p.reading_m)));
    let curves: Vec<Vec<(f64, f64)>> = probes.iter().map(|(_, probe)| curve(probe)).collect();
    let highest = curves.iter().flatten().map(|p| p.1).filter(|d| d.is_finite()).fold(1e-6, f64::max);
    let y = Axis::logarithmic("predicted density [1/m]", highest / 10f64.powf(DECADES), 3.0 * highest);
    let furthest =
        curves.iter().flatten().map(|p| p.0).fold((nominal / ROOM_FOR_LABEL).max(reading), f64::max);
    let x = Axis::linear("range [m]", 0.0, furthest, 10.0);
    let legend: Vec<(String, Mark)> = probes
        .iter()
        .zip(&curves)
        .map(|((model, probe), curve)| {
            let label = format!(
                "{model}: {} /m at the reading, no return {:.1} %",
                short(density_at(curve, reading)),
                100.0 * probe.max_range_probability
            );
            (label, Mark::Line(model_color(models, model)))
        })
        .collect();
    figure("What each model predicts for one beam", &legend, 420.0, |area| {
        let mut chart = chart(area, &x, &y, 74.0)?;
        let (bottom, top) = y.ends();
        let nearer = if reading < nominal { HPos::Right } else { HPos::Left };
        let farther = if reading < nominal { HPos::Left } else { HPos::Right };
        for (range, label, color, side) in [
            (nominal, format!("nominal {nominal:.2} m"), RGBColor(0x77, 0x77, 0x77), farther),
            (reading, format!("reading {reading:.2} m"), READING, nearer),
        ] {
            let at = range;
            chart.draw_series([PathElement::new(vec![(at, bottom), (at, top)], line(color, 1.5))])?;
            let (place_x, place_y) = chart.backend_coord(&(at, top));
            let (origin_x, origin_y) = area.get_base_pixel();
            let gap = if matches!(side, HPos::Right) { -px(6.0) } else { px(6.0) };
            let style = text(LABEL, INK).pos(Pos::new(side, VPos::Top));
            area.draw(&Text::new(label, (place_x - origin_x + gap, place_y - origin_y + px(4.0)), style))?;
        }
        for ((model, _), curve) in probes.iter().zip(&curves) {
            let style = line(model_color(models, model), 1.75);
            for run in runs_above(curve, bottom) {
                chart.draw_series([PathElement::new(run.to_vec(), style)])?;
            }
        }
        Ok(())
    })
}

fn curve(probe: &BeamProbe) -> Vec<(f64, f64)> {
    probe.z_m.iter().zip(&probe.density_per_m).map(|(&z, &d)| (f64::from(z), f64::from(d))).collect()
}

/// The parts of a curve above `bottom`, each with the point before and after: what lies below isn't drawn along
/// the axis.
fn runs_above(curve: &[(f64, f64)], bottom: f64) -> Vec<&[(f64, f64)]> {
    let visible: Vec<bool> = curve
        .iter()
        .enumerate()
        .map(|(i, _)| curve[i.saturating_sub(1)..(i + 2).min(curve.len())].iter().any(|p| p.1 > bottom))
        .collect();
    let mut start = 0;
    visible
        .chunk_by(|a, b| a == b)
        .filter_map(|run| {
            let from = start;
            start += run.len();
            run[0].then(|| &curve[from..start])
        })
        .collect()
}

/// Density at `z`, by linear interpolation; 0 outside the curve.
fn density_at(curve: &[(f64, f64)], z: f64) -> f64 {
    let after = curve.partition_point(|p| p.0 < z);
    match (after.checked_sub(1).map(|i| curve[i]), curve.get(after)) {
        (Some((z0, d0)), Some(&(z1, d1))) => d0 + (d1 - d0) * (z - z0) / (z1 - z0),
        (None, Some(&(z1, d1))) if z1 == z => d1,
        _ => 0.0,
    }
}

fn short(density: f64) -> String {
    match density {
        d if d >= 10.0 => format!("{d:.0}"),
        d if d >= 0.1 => format!("{d:.2}"),
        d => format!("{d:.4}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_drawn_only_where_it_is_above_the_axis() {
        let curve = [0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 7.0].map(|d| (0.0, d));
        let lengths: Vec<usize> = runs_above(&curve, 1.0).iter().map(|run| run.len()).collect();
        assert_eq!(lengths, [3, 2]);
    }

    #[test]
    fn density_is_interpolated_inside_and_zero_outside() {
        let curve = [(1.0, 2.0), (2.0, 4.0)];
        assert_eq!(density_at(&curve, 1.5), 3.0);
        assert_eq!(density_at(&curve, 1.0), 2.0);
        assert_eq!(density_at(&curve, 2.0), 4.0);
        assert_eq!(density_at(&curve, 0.9), 0.0);
        assert_eq!(density_at(&curve, 2.1), 0.0);
    }
}
