//! The figures of a search's report.

use std::collections::BTreeMap;

use locsim_core::Interval;
use locsim_gap::{BeamPit, Outcome, PitHistogram, Profile, Unnamed};
use plotters::prelude::{Circle, Color, PathElement, RGBColor, Rectangle, Text};

use super::{GapStudy, covariate, curve, map_error, profile, unnamed};
use locsim_report::ReportError;
use locsim_report::figures::Figure;
use locsim_report::figures::canvas::{
    Area, Axis, DrawError, Drawn, HEADING, INK, LABEL, Mark, chart, figure, line, px, text, text_width,
};
use locsim_report::figures::geometry::{Point, Window, join};
use locsim_report::figures::map::{self as floor, LEFT, MapPanel};
use locsim_report::palette;

/// Side of a cell of wall \[m\].
const CELL_M: f64 = 0.25;
/// Fewer readings in a cell say nothing: the mean PIT of this many has a standard deviation of 0.065, half of [`FULL`].
const LEAST_READINGS: u32 = 20;
/// A mean PIT this far from the middle has the full colour.
const FULL: f64 = 0.12;
/// Readings that are shorter than expected, as expected, and longer: legible for the colour-blind.
const SHORT: RGBColor = RGBColor(0xc2, 0x3b, 0x22);
const EXPECTED: RGBColor = RGBColor(0xe6, 0xe6, 0xe6);
const LONG: RGBColor = RGBColor(0x1f, 0x5f, 0xb4);

/// Colour of the nominal simulator, and of the one with the effects.
fn sides() -> [RGBColor; 2] {
    [0, 1].map(|side| {
        let [red, green, blue] = palette::rgb(side);
        RGBColor(red, green, blue)
    })
}

/// Every figure that the outcome has something for.
pub(super) fn all(study: &GapStudy, outcome: &Outcome) -> Result<Vec<Figure>, ReportError> {
    let figure = |name, caption: &str, svg: Result<String, DrawError>| -> Result<Figure, ReportError> {
        let svg = svg.map_err(|error| ReportError::Figure { name, reason: error.to_string() })?;
        Ok(Figure { name, caption: caption.to_owned(), svg })
    };
    let mut figures = vec![
        figure(
            "map",
            "Where readings are off. Each mark is a piece of wall, coloured by the mean PIT of the readings of beams that \
             should end there: red where they are shorter than the simulation expects, blue where they are longer or \
             missing, grey where they are as expected. Line: the reference path.",
            map(study, outcome),
        )?,
        figure(
            "pit",
            "PIT histograms over fifths of each covariate: the share of readings in each tenth of what the simulation \
             expects. A simulation that is right has a tenth in each (grey line); a slope tells of readings that are too \
             long or too short, a bowl of readings that spread too much, a tower at the right of missing returns.",
            histograms(outcome),
        )?,
    ];
    if let Some(map) = &outcome.map {
        figures.push(figure(
            "map-errors",
            "The measured map against the readings: walls that stand elsewhere, walls that beams pass, objects that the map \
             lacks, and where readings end that are more than half a metre off.",
            map_error::draw(study, map),
        )?);
    }
    for named in &outcome.effects {
        let kind = named.name;
        if figures.iter().any(|figure| figure.name == kind.name()) {
            continue;
        }
        let of_kind: Vec<&Profile> = outcome
            .profiles
            .iter()
            .filter(|profile| profile.name == kind && !profile.bins.is_empty())
            .collect();
        if !of_kind.is_empty() {
            figures.push(figure(
                kind.name(),
                "What the effect does. Dots: the measured log. Lines and bands: median and 95 % of 40 simulated logs, without \
                 and with the named effects. Dots within the band agree with the simulation.",
                profile::draw(&of_kind, sides()),
            )?);
        }
    }
    let curves = curve::drawn(&outcome.unnamed);
    if !curves.is_empty() {
        figures.push(figure(
            "unnamed",
            "Dependences that have no name, as a free model of the readings learns them from the log, with 95 % bands. At 0 \
             (grey line) the log is as the simulation.",
            curve::draw(&curves, sides()[1]),
        )?);
    }
    let places = outcome.unnamed.iter().find(|found| found.curve.iter().any(|point| point.place.is_some()));
    if let Some(found) = places {
        figures.push(figure(
            "unnamed-places",
            "Where the readings differ from the simulation: each mark is a cell of the map that beams end in, its colour the \
             difference there, full at the largest. Line: the reference path.",
            map_of_cells(study, found),
        )?);
    }
    if !outcome.rivals.is_empty() {
        figures.push(figure(
            "rivals",
            "Log score that each effect gains on scans that its numbers were not fitted to, with 95 % intervals over \
             blocks of scans. The first of each round is the best. A gain counts as far as the effect's own score among \
             simulated logs allows, which may be little of a strong effect's.",
            rivals(outcome),
        )?);
    }
    Ok(figures)
}

/// Mean PIT of readings by the piece of wall that their beams should end on: place, nominal, with the effects.
fn by_wall(study: &GapStudy, outcome: &Outcome) -> Vec<(Point, [f64; 2])> {
    let mut cells: BTreeMap<[i64; 2], (u32, [f64; 4])> = BTreeMap::new();
    for (pit, end) in outcome.beam_pits.iter().zip(study.expected_ends()) {
        let BeamPit { before, after, .. } = *pit;
        let Some([x, y]) = end.filter(|_| before.is_finite() && after.is_finite()) else { continue };
        let cell = cells.entry([x, y].map(|v| (v / CELL_M).floor() as i64)).or_default();
        cell.0 += 1;
        for (sum, value) in cell.1.iter_mut().zip([x, y, f64::from(before), f64::from(after)]) {
            *sum += value;
        }
    }
    let kept = cells.into_values().filter(|(count, _)| *count >= LEAST_READINGS);
    kept.map(|(count, sums)| {
        let [x, y, before, after] = sums.map(|sum| sum / f64::from(count));
        ([x, y], [before, after])
    })
    .collect()
}

/// Height of the title of a map's panel (px).
const TITLE: f64 = 22.0;

/// Marks on one panel of the map, above the walls and the reference path.
fn marks(
    study: &GapStudy,
    area: &Area<'_>,
    (title, panel, window): (&str, f64, Window),
    marks: impl Iterator<Item = (Point, RGBColor)>,
) -> Drawn {
    area.draw(&Text::new(title.to_owned(), (px(LEFT), px(4.0)), text(HEADING, INK)))?;
    let (_, below) = area.split_vertically(px(TITLE));
    let mut panel = MapPanel::new(&below, window, [10.0, panel / 60.0])?;
    panel.map(&join(&study.walls()), &[])?;
    let path: Vec<Point> = study.recorded.track.poses().iter().map(|pose| [pose.x, pose.y]).collect();
    panel.line(&path, line(RGBColor(0xaa, 0xaa, 0xaa), 1.0))?;
    for (place, color) in marks {
        panel.dot(place, 4.5, color.filled())?;
    }
    Ok(())
}

/// The cells of a dependence on places, by how much readings differ there.
fn map_of_cells(study: &GapStudy, found: &Unnamed) -> Result<String, DrawError> {
    let (panel, window) = floor::panel(&study.walls());
    let most = found.curve.iter().fold(1e-12_f64, |most, point| most.max(point.estimate.value.abs()));
    let cells = found.curve.iter().filter_map(|point| {
        let [x0, y0, x1, y1] = point.place?;
        Some(([0.5 * (x0 + x1), 0.5 * (y0 + y1)], shade(point.estimate.value / most)))
    });
    let legend = [
        ("less".to_owned(), Mark::Dot(SHORT)),
        ("as simulated".to_owned(), Mark::Dot(EXPECTED)),
        ("more".to_owned(), Mark::Dot(LONG)),
    ];
    figure("What has no name, by place", &legend, panel + TITLE, |area| {
        marks(study, area, (&unnamed::sentence(found), panel, window), cells)
    })
}

fn map(study: &GapStudy, outcome: &Outcome) -> Result<String, DrawError> {
    let (panel, window) = floor::panel(&study.walls());
    let cells = by_wall(study, outcome);
    let legend = [
        ("shorter than expected".to_owned(), Mark::Dot(SHORT)),
        ("as expected".to_owned(), Mark::Dot(EXPECTED)),
        ("longer, or missing".to_owned(), Mark::Dot(LONG)),
    ];
    let panels: &[&str] = if outcome.effects.is_empty() {
        &["Scenario as it is"]
    } else {
        &["Scenario as it is", "With the named effects"]
    };
    figure("What is off, and where", &legend, panels.len() as f64 * (panel + TITLE), |area| {
        for (side, (name, area)) in panels.iter().zip(area.split_evenly((panels.len(), 1))).enumerate() {
            let shaded = cells.iter().map(|(place, pits)| (*place, shade((pits[side] - 0.5) / FULL)));
            marks(study, &area, (name, panel, window), shaded)?;
        }
        Ok(())
    })
}

/// The colour of a difference: -1 for as much too short, or too few, as is shown, 1 for as much too long.
fn shade(off: f64) -> RGBColor {
    let off = off.clamp(-1.0, 1.0);
    let to = if off < 0.0 { SHORT } else { LONG };
    let mix =
        |from: u8, to: u8| (f64::from(from) + off.abs() * (f64::from(to) - f64::from(from))).round() as u8;
    RGBColor(mix(EXPECTED.0, to.0), mix(EXPECTED.1, to.1), mix(EXPECTED.2, to.2))
}

fn histograms(outcome: &Outcome) -> Result<String, DrawError> {
    // One row for each covariate.
    let mut rows: Vec<Vec<&PitHistogram>> = Vec::new();
    for histogram in &outcome.pit {
        match rows.last_mut() {
            Some(row) if row[0].covariate == histogram.covariate => row.push(histogram),
            _ => rows.push(vec![histogram]),
        }
    }
    let [before, after] = sides();
    let named = !outcome.effects.is_empty();
    let mut legend = vec![("scenario as it is".to_owned(), Mark::Area(before))];
    if named {
        legend.push(("with the named effects".to_owned(), Mark::Line(after)));
    }
    let row_height = 112.0;
    figure("PIT histograms", &legend, rows.len() as f64 * row_height, |area| {
        for (row, area) in rows.iter().zip(area.split_evenly((rows.len(), 1))) {
            let most = row.iter().flat_map(|h| h.before.iter().chain(&h.after)).copied().fold(0.2, f64::max);
            let y = Axis::linear("", 0.0, 1.05 * most, 3.0);
            for (i, (histogram, area)) in row.iter().zip(area.split_evenly((1, row.len()))).enumerate() {
                let name = covariate::span(histogram.covariate, histogram.lo, histogram.hi);
                area.draw(&Text::new(name, (px(44.0), px(2.0)), text(LABEL - 1.0, INK)))?;
                let (_, below) = area.split_vertically(px(14.0));
                let x = Axis::linear("", 0.0, 1.0, 2.0).unlabelled();
                let y = if i == 0 { y.clone() } else { y.clone().unlabelled() };
                let mut chart = chart(&below, &x, &y, 44.0)?;
                let tenth = |i: usize| i as f64 / 10.0;
                let bars = histogram.before.iter().enumerate().map(|(i, &share)| {
                    Rectangle::new([(tenth(i), 0.0), (tenth(i + 1), share)], before.mix(0.45).filled())
                });
                chart.draw_series(bars)?;
                chart.draw_series([PathElement::new(
                    vec![(0.0, 0.1), (1.0, 0.1)],
                    line(RGBColor(0x77, 0x77, 0x77), 1.0),
                )])?;
                if named {
                    let steps = histogram.after.iter().enumerate();
                    let outline: Vec<(f64, f64)> =
                        steps.flat_map(|(i, &share)| [(tenth(i), share), (tenth(i + 1), share)]).collect();
                    chart.draw_series([PathElement::new(outline, line(after, 2.0))])?;
                }
            }
        }
        Ok(())
    })
}

fn rivals(outcome: &Outcome) -> Result<String, DrawError> {
    let labels: Vec<String> =
        outcome.rivals.iter().map(|rival| format!("{}. {}", rival.round, rival.name)).collect();
    let gains = outcome.rivals.iter().map(|rival| rival.gain_nats);
    let lo = gains.clone().map(|gain| gain.interval.lo).fold(0.0, f64::min);
    let hi = gains.clone().map(|gain| gain.interval.hi).fold(1.0, f64::max);
    let left = labels.iter().map(|label| text_width(label, LABEL)).fold(0.0, f64::max) + 28.0;
    let named: Vec<bool> = outcome
        .rivals
        .iter()
        .map(|rival| outcome.effects.get(rival.round - 1).is_some_and(|named| named.name == rival.name))
        .collect();
    let [_, color] = sides();
    let plain = RGBColor(0x77, 0x77, 0x77);
    let legend = [("named".to_owned(), Mark::Dot(color)), ("tried".to_owned(), Mark::Dot(plain))];
    let height = 64.0 + 24.0 * labels.len() as f64;
    figure("What each effect explains", &legend, height, |area| {
        let room = 0.03 * (hi - lo);
        let x = Axis::linear("log score gained on held-out scans [nats]", lo.max(-hi) - room, hi + room, 8.0);
        let mut chart = chart(area, &x, &Axis::rows(&labels), left)?;
        for (i, (gain, named)) in gains.zip(named).enumerate() {
            let (y, color) = (-(i as f64), if named { color } else { plain });
            let Interval { lo, hi } = gain.interval;
            chart.draw_series([PathElement::new(vec![(lo, y), (hi, y)], line(color, 2.0))])?;
            chart.draw_series([Circle::new((gain.value, y), px(4.5), color.filled())])?;
        }
        Ok(())
    })
}
