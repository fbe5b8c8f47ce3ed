//! The figures of a study.

use distreg::Distribution;
use plotters::prelude::{Circle, Color, PathElement, Polygon, RGBColor};

use super::experiment::Extra;
use super::results::{Curve, Results};
use super::results::{Sample, Samples};
use super::sensor::Unit;
use super::{Criterion, Kind, Model, Study, families};
use locsim_report::ReportError;
use locsim_report::figures::Figure;
use locsim_report::figures::canvas::{
    Area, Axis, Chart, DrawError, Drawn, INK, Mark, UNKNOWN, chart, figure, heading, line, px,
};
use locsim_report::palette;

/// Steps of a drawn distribution.
const STEPS: usize = 110;
/// Room for the labels of a y axis (px).
const LEFT: f64 = 74.0;
/// Reference lines.
const REFERENCE: RGBColor = RGBColor(0x77, 0x77, 0x77);
/// Colour of observations.
const OBSERVED: RGBColor = UNKNOWN;

impl Model {
    /// Its colour, the same in every study.
    fn color(self) -> RGBColor {
        let place = match self {
            Self::NpReg => 0,
            Self::PReg => 1,
            Self::NpRegRegistered => 2,
            Self::Frechet => 3,
            Self::PRegTwoGaussians => 4,
        };
        color(place)
    }
}

fn color(place: usize) -> RGBColor {
    let [red, green, blue] = palette::rgb(place);
    RGBColor(red, green, blue)
}

/// Every figure of a study, in the order of the paper's.
pub(super) fn all(study: &Study, results: &Results, extra: &Extra) -> Result<Vec<Figure>, ReportError> {
    let figure = |name, caption: String, svg: Result<String, DrawError>| -> Result<Figure, ReportError> {
        let svg = svg.map_err(|error| ReportError::Figure { name, reason: error.to_string() })?;
        Ok(Figure { name, caption, svg })
    };
    let mut figures = Vec::new();
    if !extra.neighbours.is_empty() {
        let caption =
            "What the sensor reads at three places a centimetre apart, as in the paper's Fig. 3.".to_owned();
        figures.push(figure("neighbours", caption, neighbours(study, extra))?);
    }
    if study.kind == Kind::Grass {
        let caption = "Loss between the true distributions of two states against their distance (mean over pairs). Where it \
                       rises to that of unrelated states within the distance of training states, there is nothing to smooth.";
        figures.push(figure("roughness", caption.to_owned(), roughness(results))?);
    }
    if study.kind == Kind::Laser {
        let caption = "Two predictions and what they are compared with, as in the paper's Fig. 5: the histogram match knows \
                       which one is nearer, the Euclidean distance doesn't.";
        figures.push(figure("losses", caption.to_owned(), losses(study, results, extra))?);
    }
    if !extra.rays.states.is_empty() {
        let caption = "Readings of some rays, and the families of distributions fitted to them. Each panel has axes of its own.";
        figures.push(figure("rays", caption.to_owned(), rays(study, &extra.rays))?);
    }
    let caption = format!(
        "Distribution of the observations at {}, as in the paper's Fig. 6. Each panel has axes of its own.",
        if results.conditions.len() > 1 {
            "the same states under each condition"
        } else {
            "three test states"
        }
    );
    figures.push(figure("observations", caption, observations(study, extra))?);
    if results.conditions.iter().any(|c| c.loss_against_observations.is_some()) {
        let caption = "Loss of a histogram of M observations against the true one, mean over test states, with the middle 80 % of \
                       repeats, as in the paper's Fig. 7. Thin: the law c sqrt(1/M + 1/M0), M0 the observations behind the truth. \
                       Horizontal: the threshold.";
        figures.push(figure(
            "loss_against_observations",
            caption.to_owned(),
            loss_against_observations(results),
        )?);
    }
    let caption = "Risk against the number N of training states: mean over repeats and the middle 80 % of them, as in the paper's \
                   Fig. 8. Grey: the histogram of all training observations whatever their state (upper), and a histogram of M \
                   observations at the test state itself (lower).";
    figures.push(figure("risk", caption.to_owned(), risk(study, results))?);
    if results.conditions.iter().any(|c| c.thinning.is_some()) {
        let caption = "Risk when the training states are chosen from the largest set within a budget; mean over repeats and the \
                       middle 80 % of them. Condensed: the states chosen farthest first, each with the observations of all \
                       states that are nearest to it.";
        figures.push(figure("budget", caption.to_owned(), budget(results))?);
    }
    let caption = format!(
        "Predictions at test states (colours) and what is observed there (grey), as in the paper's Fig. 9; the largest training \
         set, {} states. Each panel has axes of its own.",
        extra.conditions.first().map_or(0, |c| c.training_states)
    );
    figures.push(figure("predictions", caption, predictions(study, extra))?);
    Ok(figures)
}

/// Part of the values that a panel shows, as bins.
struct Window {
    from: usize,
    to: usize,
    /// Bins that make one step.
    per_step: usize,
}

impl Window {
    /// The range between extreme quantiles of a distribution, with a margin.
    fn around(truth: &Distribution) -> Self {
        let grid = truth.grid();
        let [lo, hi] = [0.002, 0.998].map(|u| grid.bin(truth.quantile(u)));
        let room = ((hi - lo) * 2 / 5).max(8);
        let (from, to) = (lo.saturating_sub(room), (hi + room + 1).min(grid.bins));
        Self { from, to, per_step: (to - from).div_ceil(STEPS) }
    }

    fn whole(truth: &Distribution) -> Self {
        Self { from: 0, to: truth.grid().bins, per_step: truth.grid().bins.div_ceil(STEPS) }
    }

    /// Corners of the density's steps, in the unit.
    fn steps(&self, distribution: &Distribution, unit: Unit) -> Vec<(f64, f64)> {
        let grid = distribution.grid();
        let edge = |b: usize| (grid.lo + b as f64 * grid.width) * unit.per_z;
        let mut corners = vec![(edge(self.from), 0.0)];
        let mut from = self.from;
        while from < self.to {
            let to = (from + self.per_step).min(self.to);
            let density = distribution.mass()[from..to].iter().sum::<f64>() / (edge(to) - edge(from));
            corners.push((edge(from), density));
            corners.push((edge(to), density));
            from = to;
        }
        corners.push((edge(self.to), 0.0));
        corners
    }
}

fn highest(curves: &[Vec<(f64, f64)>]) -> f64 {
    curves.iter().flatten().map(|p| p.1).fold(1e-12, f64::max)
}

/// A panel of distributions: the first filled, the others as lines.
fn panel(
    area: &Area<'_>,
    title: &str,
    study: &Study,
    window: &Window,
    filled: &Distribution,
    lines: &[(&Distribution, RGBColor)],
) -> Drawn {
    let unit = study.setup.unit;
    let shape = window.steps(filled, unit);
    let curves: Vec<Vec<(f64, f64)>> = lines.iter().map(|(d, _)| window.steps(d, unit)).collect();
    // A line that towers over what it predicts may leave the panel.
    let top = 1.08 * highest(std::slice::from_ref(&shape)).max(0.6 * highest(&curves));
    let (left, right) = (shape[0].0, shape[shape.len() - 1].0);
    let below = heading(area, title, LEFT)?;
    let x = Axis::linear(&format!("z [{}]", unit.name), left, right, 4.0);
    let y = Axis::linear(&format!("density [1/{}]", unit.name), 0.0, top, 4.0);
    let mut chart = chart(&below, &x, &y, LEFT)?;
    chart.draw_series([Polygon::new(shape, OBSERVED.mix(0.7).filled())])?;
    for (curve, (_, color)) in curves.into_iter().zip(lines) {
        chart.draw_series([PathElement::new(curve, line(*color, 1.75))])?;
    }
    Ok(())
}

/// The title of a panel: its condition, where there are several, and its state.
fn title(study: &Study, condition: usize, state: &[f64]) -> String {
    let state = state_name(study, state);
    match study.setup.conditions.as_slice() {
        [_] => state,
        conditions => format!("{}: {state}", conditions[condition].label),
    }
}

/// The name of a state: its coordinates.
fn state_name(study: &Study, state: &[f64]) -> String {
    // More names than two don't fit above a panel.
    if state.len() > 2 {
        let values: Vec<String> = state.iter().map(|x| format!("{x:.3}")).collect();
        return format!("state ({})", values.join(", "));
    }
    let coordinates = study.setup.coordinates.iter().zip(state).map(|((name, unit), x)| {
        let plain = name.strip_suffix(&format!("_{unit}")).unwrap_or(name);
        if unit.is_empty() { format!("{plain} {x:.4}") } else { format!("{plain} {x:.3} {unit}") }
    });
    coordinates.collect::<Vec<_>>().join(", ")
}

fn model_legend(study: &Study) -> Vec<(String, Mark)> {
    let models = study.models.iter().map(|m| (m.as_str().to_owned(), Mark::Line(m.color())));
    std::iter::once(("observed".to_owned(), Mark::Area(OBSERVED))).chain(models).collect()
}

/// Panels in rows.
fn grid_of<'a, T>(
    title: &str,
    legend: &[(String, Mark)],
    rows: &'a [Vec<T>],
    draw: impl Fn(&Area<'_>, &'a T) -> Drawn,
) -> Result<String, DrawError> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(1);
    figure(title, legend, 240.0 * rows.len() as f64, |area| {
        for (row, line) in area.split_evenly((rows.len(), 1)).iter().zip(rows) {
            for (cell, content) in row.split_evenly((1, columns)).iter().zip(line) {
                draw(cell, content)?;
            }
        }
        Ok(())
    })
}

fn observations(study: &Study, extra: &Extra) -> Result<String, DrawError> {
    let rows: Vec<Vec<(usize, &Sample)>> = extra
        .conditions
        .iter()
        .enumerate()
        .map(|(c, samples)| samples.states.iter().map(|s| (c, s)).collect())
        .collect();
    grid_of("Observations at a state", &[], &rows, |area, (condition, sample)| {
        let title = title(study, *condition, &sample.state);
        panel(area, &title, study, &Window::around(&sample.truth), &sample.truth, &[])
    })
}

fn predictions(study: &Study, extra: &Extra) -> Result<String, DrawError> {
    let rows: Vec<Vec<(usize, &Sample)>> = extra
        .conditions
        .iter()
        .enumerate()
        .map(|(c, samples)| samples.states.iter().map(|s| (c, s)).collect())
        .collect();
    grid_of("Predictions at test states", &model_legend(study), &rows, |area, (condition, sample)| {
        let title = title(study, *condition, &sample.state);
        let lines: Vec<_> = sample.predicted.iter().zip(&study.models).map(|(d, m)| (d, m.color())).collect();
        panel(area, &title, study, &Window::around(&sample.truth), &sample.truth, &lines)
    })
}

fn rays(study: &Study, samples: &Samples) -> Result<String, DrawError> {
    let names = families::names();
    let families = names.iter().enumerate().map(|(i, name)| (name.clone(), Mark::Line(color(i))));
    let legend: Vec<_> =
        std::iter::once(("readings".to_owned(), Mark::Area(OBSERVED))).chain(families).collect();
    let rows: Vec<Vec<&Sample>> = samples.states.chunks(3).map(|row| row.iter().collect()).collect();
    grid_of("Readings of some rays", &legend, &rows, |area, sample| {
        // The first on top: others can be the same curve.
        let lines: Vec<_> = sample.predicted.iter().enumerate().rev().map(|(i, d)| (d, color(i))).collect();
        let title = format!("ray {:.0}", sample.state[0]);
        panel(area, &title, study, &Window::around(&sample.truth), &sample.truth, &lines)
    })
}

fn neighbours(study: &Study, extra: &Extra) -> Result<String, DrawError> {
    let rows: Vec<Vec<&(f64, Distribution)>> = vec![extra.neighbours.iter().collect()];
    let all: Vec<Window> = extra.neighbours.iter().map(|(_, d)| Window::around(d)).collect();
    let from = all.iter().map(|w| w.from).min().unwrap_or(0);
    let to = all.iter().map(|w| w.to).max().unwrap_or(1);
    let shared = Window { from, to, per_step: (to - from).div_ceil(STEPS) };
    grid_of("Observations at neighbouring places", &[], &rows, |area, (distance, truth)| {
        let title = format!("{:.0} mm along the rail", 1000.0 * distance);
        panel(area, &title, study, &shared, truth, &[])
    })
}

fn losses(study: &Study, results: &Results, extra: &Extra) -> Result<String, DrawError> {
    let [reference, near, far] = &extra.loss_example;
    let entry = |name: &str, k: usize, color| {
        let label = format!(
            "{name}: histogram match {:.1} bins, Euclidean distance {:.3}",
            results.losses.histogram_match[k], results.losses.euclidean[k]
        );
        (label, Mark::Line(color))
    };
    let legend = [
        ("compared with".to_owned(), Mark::Area(OBSERVED)),
        entry("near", 0, color(1)),
        entry("far", 1, color(0)),
    ];
    figure("Two losses", &legend, 240.0, |area| {
        let lines = [(near, color(1)), (far, color(0))];
        panel(area, "", study, &Window::whole(reference), reference, &lines)
    })
}

/// Curves with their bands, all lines above all bands.
fn draw_curves(chart: &mut Chart<'_, '_>, curves: &[(&Curve, RGBColor)]) -> Drawn {
    let points = |curve: &Curve, values: &[f64]| -> Vec<(f64, f64)> {
        curve.at.iter().copied().zip(values.iter().copied()).collect()
    };
    for (curve, color) in curves {
        let mut band = points(curve, &curve.hi);
        band.extend(points(curve, &curve.lo).into_iter().rev());
        chart.draw_series([Polygon::new(band, color.mix(0.18).filled())])?;
    }
    for (curve, color) in curves {
        let mean = points(curve, &curve.mean);
        chart.draw_series(mean.iter().map(|p| Circle::new(*p, px(3.0), color.filled())))?;
        chart.draw_series([PathElement::new(mean, line(*color, 2.0))])?;
    }
    Ok(())
}

fn extremes<'a>(values: impl Iterator<Item = &'a f64>) -> (f64, f64) {
    values.filter(|v| **v > 0.0).fold((f64::INFINITY, 0.0), |(lo, hi), &v| (lo.min(v), hi.max(v)))
}

fn loss_against_observations(results: &Results) -> Result<String, DrawError> {
    let found: Vec<_> = results
        .conditions
        .iter()
        .filter_map(|c| Some((c.condition.clone(), c.loss_against_observations.as_ref()?)))
        .collect();
    let legend: Vec<_> = found
        .iter()
        .enumerate()
        .map(|(i, (name, loss))| {
            let needed = loss.needed.unwrap_or(loss.needed_by_law);
            let about = if loss.needed.is_some() { "" } else { " by the law" };
            (format!("{name}: {:.1} at M = {needed:.0}{about}", loss.threshold), Mark::Line(color(i)))
        })
        .collect();
    let curves = || found.iter().map(|(_, l)| &l.loss);
    let (first, last) = extremes(curves().flat_map(|c| &c.at));
    let (lowest, highest) = extremes(curves().flat_map(|c| c.lo.iter().chain(&c.hi)));
    let x = Axis::logarithmic("observations M", first, last);
    let threshold = found.first().map_or(0.5, |(_, l)| l.threshold);
    let y = Axis::logarithmic("loss [bins]", lowest.min(0.8 * threshold) / 1.1, 1.1 * highest);
    figure("Loss against the number of observations", &legend, 380.0, |area| {
        let mut chart = chart(area, &x, &y, LEFT)?;
        chart.draw_series([PathElement::new(
            vec![(first, threshold), (last, threshold)],
            line(REFERENCE, 1.5),
        )])?;
        let colored: Vec<_> = found.iter().enumerate().map(|(i, (_, l))| (&l.loss, color(i))).collect();
        draw_curves(&mut chart, &colored)?;
        for (_, loss) in &found {
            let law = loss.loss.at.iter().map(|m| (*m, loss.reading(*m))).collect::<Vec<_>>();
            chart.draw_series([PathElement::new(law, line(INK, 0.75))])?;
        }
        Ok(())
    })
}

fn risk(study: &Study, results: &Results) -> Result<String, DrawError> {
    let legend: Vec<_> =
        study.models.iter().map(|m| (m.as_str().to_owned(), Mark::Line(m.color()))).collect();
    figure("Risk against the number of training states", &legend, 380.0, |area| {
        for (cell, condition) in
            area.split_evenly((1, results.conditions.len())).iter().zip(&results.conditions)
        {
            let by_crps = study.criterion == Criterion::Crps;
            let shown: Vec<Curve> = condition
                .risks
                .iter()
                .map(|r| if by_crps { r.crps.times(study.setup.unit.per_z) } else { r.risk.clone() })
                .collect();
            // The references are histogram matches.
            let references = if by_crps { Curve::default() } else { condition.pooled_risk.clone() };
            let own: Vec<f64> = condition.own_histogram_risk.filter(|_| !by_crps).into_iter().collect();
            let (lowest, highest) = extremes(
                shown.iter().flat_map(|c| c.lo.iter().chain(&c.hi)).chain(&references.mean).chain(&own),
            );
            let (first, last) = extremes(condition.pooled_risk.at.iter());
            let below = heading(cell, &condition.condition, LEFT)?;
            let x = Axis::logarithmic("training states N", first, last);
            let label =
                if by_crps { format!("CRPS [{}]", study.setup.unit.name) } else { "risk [bins]".to_owned() };
            let y = Axis::logarithmic(&label, lowest / 1.15, 1.15 * highest);
            let mut chart = chart(&below, &x, &y, LEFT)?;
            let points: Vec<_> = references.at.iter().copied().zip(references.mean.iter().copied()).collect();
            chart.draw_series([PathElement::new(points, line(REFERENCE, 1.5))])?;
            for own in own {
                let ends = vec![(first, own), (last, own)];
                chart.draw_series([PathElement::new(ends, line(REFERENCE, 1.5))])?;
            }
            let colored: Vec<_> = shown.iter().zip(&study.models).map(|(c, m)| (c, m.color())).collect();
            draw_curves(&mut chart, &colored)?;
        }
        Ok(())
    })
}

fn budget(results: &Results) -> Result<String, DrawError> {
    let found: Vec<_> = results
        .conditions
        .iter()
        .filter_map(|c| {
            let t = c.thinning.as_ref()?;
            let curves =
                [("random", &t.random), ("farthest first", &t.farthest_first), ("herding", &t.herding)];
            Some((
                format!("{}: {}", c.condition, t.model),
                [curves[0], curves[1], curves[2], ("condensed", &t.condensed)],
            ))
        })
        .collect();
    let legend: Vec<_> = found.first().map_or_else(Vec::new, |(_, curves)| {
        curves.iter().enumerate().map(|(i, (name, _))| ((*name).to_owned(), Mark::Line(color(i)))).collect()
    });
    figure("Risk against a budget of training states", &legend, 360.0, |area| {
        for (cell, (title, curves)) in area.split_evenly((1, found.len())).iter().zip(&found) {
            let below = heading(cell, title, LEFT)?;
            let (first, last) = extremes(curves[0].1.at.iter());
            let (lowest, highest) = extremes(curves.iter().flat_map(|(_, c)| c.lo.iter().chain(&c.hi)));
            let x = Axis::logarithmic("training states", first, last);
            let y = Axis::logarithmic("risk [bins]", lowest / 1.15, 1.15 * highest);
            let mut chart = chart(&below, &x, &y, LEFT)?;
            let colored: Vec<_> = curves.iter().enumerate().map(|(i, (_, c))| (*c, color(i))).collect();
            draw_curves(&mut chart, &colored)?;
        }
        Ok(())
    })
}

fn roughness(results: &Results) -> Result<String, DrawError> {
    let found = results.conditions.iter().find_map(|c| c.roughness.as_ref());
    let legend = [
        ("two places at that distance".to_owned(), Mark::Line(color(0))),
        ("two places at random".to_owned(), Mark::Line(REFERENCE)),
    ];
    figure("How fast the distribution changes", &legend, 320.0, |area| {
        let Some(found) = found else { return Ok(()) };
        let millimetres: Vec<f64> = found.distance.iter().map(|d| 1000.0 * d).collect();
        let (first, last) = extremes(millimetres.iter());
        let (_, highest) = extremes(found.loss.iter().chain([&found.unrelated]));
        let x = Axis::logarithmic("distance of two places [mm]", first, last);
        let y = Axis::linear("loss [bins]", 0.0, 1.1 * highest, 5.0);
        let mut chart = chart(area, &x, &y, LEFT)?;
        let unrelated = vec![(first, found.unrelated), (last, found.unrelated)];
        chart.draw_series([PathElement::new(unrelated, line(REFERENCE, 1.5))])?;
        let points: Vec<_> = millimetres.iter().copied().zip(found.loss.iter().copied()).collect();
        chart.draw_series(points.iter().map(|p| Circle::new(*p, px(3.0), color(0).filled())))?;
        chart.draw_series([PathElement::new(points, line(color(0), 2.0))])?;
        Ok(())
    })
}
