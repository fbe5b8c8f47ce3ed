//! The figures of a sweep's report: small multiples over two axes, the best model of each cell, error against cost.

use std::collections::BTreeMap;

use locsim_core::Interval;
use locsim_report::ReportError;
use locsim_report::figures::Figure;
use locsim_report::figures::canvas::{
    Area, Axis as Scale, DrawError, Drawn, HEADING, INK, LABEL, Mark, WIDTH, chart, figure, heading, line,
    model_color, px, text, text_width,
};
use locsim_report::text::significant;
use locsim_report::trial_set::plain;
use plotters::prelude::{Circle, Color, PathElement, RGBColor, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use serde_json::Value;

use crate::cells::{Figures, Place, Tally, places};
use crate::plan::{Axis, Cells};

/// Panels beside each other, and on top of each other: more are too small to read. Of more values, evenly spaced ones are shown.
const MOST_PANELS: usize = 5;
/// Room for the labels of a y axis (px).
const LEFT: f64 = 64.0;
/// Numbers that span more than this ratio are drawn on a logarithmic axis.
const LOGARITHMIC: f64 = 20.0;

/// Which axes a figure is drawn over; the trials of all others are pooled.
#[derive(Clone, Debug)]
pub struct Layout {
    /// The axis along x.
    pub x: usize,
    /// The axis whose values have a column of panels each.
    pub columns: Option<usize>,
    /// The axis whose values have a row of panels each.
    pub rows: Option<usize>,
    /// Axes that are pooled.
    pub pooled: Vec<usize>,
}

impl Layout {
    /// Along x the axis of numbers with the most values; panels over the next two. `None` where no axis has two values.
    pub fn of(cells: &Cells) -> Option<Self> {
        let plan = cells.plan();
        // Of axes that vary together one stands for all.
        let mut axes: Vec<usize> = plan.groups.iter().filter_map(|group| group.first().copied()).collect();
        axes.retain(|axis| plan.axes[*axis].values.len() > 1);
        axes.sort_by_key(|axis| {
            std::cmp::Reverse((plan.axes[*axis].is_numeric(), plan.axes[*axis].values.len()))
        });
        let mut axes = axes.into_iter();
        let x = axes.next()?;
        let mut others: Vec<usize> = axes.collect();
        others.sort_by_key(|axis| std::cmp::Reverse(plan.axes[*axis].values.len()));
        let mut others = others.into_iter();
        let (columns, rows) = (others.next(), others.next());
        Some(Self { x, columns, rows, pooled: others.collect() })
    }
}

/// The trials of each model at each place of a figure: column, row, x, model.
type Places = BTreeMap<(usize, usize, usize, usize), Tally>;

fn tallies(cells: &Cells, figures: &Figures, layout: &Layout) -> Places {
    let mut places = Places::new();
    for cell in &figures.cells {
        let indices = cells.indices(cell.cell);
        let at = |axis: Option<usize>| axis.map_or(0, |axis| indices[axis]);
        for (model, tally) in &cell.models {
            let key = (at(layout.columns), at(layout.rows), indices[layout.x], *model);
            places.entry(key).or_default().add(tally);
        }
    }
    places
}

/// Indices of the values that have panels.
fn shown(axis: Option<&Axis>) -> Vec<usize> {
    let count = axis.map_or(1, |axis| axis.values.len());
    let panels = count.min(MOST_PANELS);
    (0..panels).map(|i| if panels > 1 { i * (count - 1) / (panels - 1) } else { 0 }).collect()
}

/// The scale of an axis, and where its values stand.
fn scale(axis: &Axis) -> (Scale, Vec<f64>) {
    let numbers: Option<Vec<f64>> = axis.values.iter().map(Value::as_f64).collect();
    let Some(numbers) = numbers else {
        let words: Vec<String> = axis.values.iter().map(short).collect();
        let places = (0..words.len()).map(|i| i as f64).collect();
        return (Scale::words(&axis.key, &words), places);
    };
    let lo = numbers.iter().copied().fold(f64::INFINITY, f64::min);
    let hi = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let scale = if lo > 0.0 && hi / lo >= LOGARITHMIC {
        let room = (hi / lo).powf(0.05);
        Scale::logarithmic(&axis.key, lo / room, hi * room)
    } else {
        let room = 0.05 * (hi - lo);
        Scale::linear(&axis.key, lo - room, hi + room, 4.0)
    };
    (scale, numbers)
}

/// A value in a few characters.
fn short(value: &Value) -> String {
    const MOST: usize = 18;
    let text = plain(value);
    let text = text.rsplit('/').next().unwrap_or(&text);
    if text.chars().count() <= MOST {
        text.to_owned()
    } else {
        text.chars().take(MOST - 2).chain("..".chars()).collect()
    }
}

/// Every figure that the cells allow.
pub fn all(cells: &Cells, figures: &Figures) -> Result<Vec<Figure>, ReportError> {
    let Some(layout) = Layout::of(cells) else { return Ok(Vec::new()) };
    let drawn = |name, caption: String, svg: Result<String, DrawError>| -> Result<Figure, ReportError> {
        let svg = svg.map_err(|error| ReportError::Figure { name, reason: error.to_string() })?;
        Ok(Figure { name, caption, svg })
    };
    let places = tallies(cells, figures, &layout);
    let pooled = if layout.pooled.is_empty() {
        String::new()
    } else {
        let keys: Vec<&str> =
            layout.pooled.iter().map(|axis| cells.plan().axes[*axis].key.as_str()).collect();
        format!(" Trials of all values of {} are pooled.", keys.join(", "))
    };
    let mut all = vec![drawn(
        "error",
        format!(
            "Position RMSE of each model with its 95 % interval (Student's t over trials, of the squares).{pooled} Logarithmic \
             axis."
        ),
        multiples(cells, figures, &layout, &places, &RMSE),
    )?];
    if places.values().any(|tally| tally.lost > 0) {
        all.push(drawn(
            "lost",
            format!("Share of trials that each model lost, with its exact 95 % interval.{pooled}"),
            multiples(cells, figures, &layout, &places, &LOST),
        )?);
    }
    if figures.models.len() > 1 {
        all.push(drawn(
            "best",
            format!(
                "The model with the lowest position RMSE, and the RMSE in metres. Pale: the interval of another model meets that of \
                 the lowest.{pooled}"
            ),
            best(cells, figures, &layout, &places),
        )?);
    }
    if let Some(points) = costs(cells, figures) {
        all.push(drawn(
            "pareto",
            "Error against cost. A point is a model with its settings of the filter, over all trials of all other axes. Line: \
             the Pareto front; for each other point one on it is both cheaper and better. Logarithmic axes."
                .to_owned(),
            pareto(figures, &points),
        )?);
    }
    Ok(all)
}

/// A quantity of the small multiples.
struct Quantity {
    title: &'static str,
    label: &'static str,
    value: fn(&Tally) -> f64,
    interval: fn(&Tally) -> Option<Interval>,
    scale: fn(&str, f64, f64) -> Scale,
}

const RMSE: Quantity = Quantity {
    title: "Position error",
    label: "RMSE [m]",
    value: Tally::rmse_m,
    interval: Tally::rmse_interval,
    scale: |label, lo, hi| Scale::logarithmic(label, (lo / 1.15).max(1e-4), hi * 1.15),
};

const LOST: Quantity = Quantity {
    title: "Lost trials",
    label: "share",
    value: Tally::lost_share,
    interval: |tally| Some(tally.lost_interval()),
    scale: |label, _, _| Scale::linear(label, 0.0, 1.0, 4.0),
};

fn colors(figures: &Figures) -> Vec<RGBColor> {
    let labels: Vec<String> = figures.models.iter().cloned().collect();
    labels.iter().map(|label| model_color(&labels, label)).collect()
}

fn legend(figures: &Figures) -> Vec<(String, Mark)> {
    figures.models.iter().cloned().zip(colors(figures).into_iter().map(Mark::Line)).collect()
}

/// One panel for each pair of values of two axes, with the same scales.
fn multiples(
    cells: &Cells,
    figures: &Figures,
    layout: &Layout,
    places: &Places,
    quantity: &Quantity,
) -> Result<String, DrawError> {
    let axis = |axis: Option<usize>| axis.map(|axis| &cells.plan().axes[axis]);
    let (columns, rows) = (shown(axis(layout.columns)), shown(axis(layout.rows)));
    let (x, at) = scale(&cells.plan().axes[layout.x]);
    let ends = places.values().flat_map(|tally| {
        let value = (quantity.value)(tally);
        let interval = (quantity.interval)(tally).unwrap_or(Interval { lo: value, hi: value });
        // An interval that begins at 0 has no place on a logarithmic axis.
        [value, if interval.lo > 0.1 * value { interval.lo } else { value }, interval.hi]
    });
    let ends: Vec<f64> = ends.filter(|end| end.is_finite() && *end > 0.0).collect();
    let lo = ends.iter().copied().fold(f64::INFINITY, f64::min);
    let hi = ends.iter().copied().fold(0.0, f64::max);
    let y = (quantity.scale)(quantity.label, lo, hi);
    let colors = colors(figures);
    let height = if rows.len() > 1 { 210.0 } else { 300.0 };
    figure(quantity.title, &legend(figures), height * rows.len() as f64, |area| {
        let panels = area.split_evenly((rows.len(), columns.len()));
        for ((i, (row, column)), panel) in pairs(&rows, &columns).enumerate().zip(panels) {
            let title =
                [(layout.columns, column), (layout.rows, row)].into_iter().filter_map(|(along, index)| {
                    let along = axis(along)?;
                    Some(format!("{} {}", last_key(&along.key), short(&along.values[index])))
                });
            let title = title.collect::<Vec<_>>().join(", ");
            let is_left = i % columns.len() == 0;
            let (y, left) = if is_left || columns.len() == 1 {
                (y.clone(), LEFT)
            } else {
                (y.clone().unlabelled(), 24.0)
            };
            let is_last = i / columns.len() + 1 == rows.len();
            let x = if is_last { x.clone() } else { x.clone().unlabelled() };
            let body = heading(&panel, &title, left)?;
            let mut chart = chart(&body, &x, &y, left)?;
            for (model, color) in colors.iter().enumerate() {
                let mut points: Vec<(f64, &Tally)> = (0..at.len())
                    .filter_map(|index| Some((at[index], places.get(&(column, row, index, model))?)))
                    .filter(|(_, tally)| (quantity.value)(tally).is_finite())
                    .collect();
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
                let path = points.iter().map(|(x, tally)| (*x, (quantity.value)(tally)));
                chart.draw_series([PathElement::new(path.collect::<Vec<_>>(), line(*color, 2.0))])?;
                for (x, tally) in points {
                    if let Some(Interval { lo, hi }) = (quantity.interval)(tally) {
                        chart.draw_series([PathElement::new([(x, lo), (x, hi)], line(*color, 1.0))])?;
                    }
                    chart.draw_series([Circle::new(
                        (x, (quantity.value)(tally)),
                        px(2.5),
                        color.filled(),
                    )])?;
                }
            }
        }
        Ok(())
    })
}

/// The last part of a key's path.
fn last_key(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

/// Each of `rows` with each of `columns`.
fn pairs<'a>(rows: &'a [usize], columns: &'a [usize]) -> impl Iterator<Item = (usize, usize)> + 'a {
    rows.iter().flat_map(move |row| columns.iter().map(move |column| (*row, *column)))
}

/// Tiles over the axis along x and that of the columns, one field for each value of the axis of rows.
fn best(cells: &Cells, figures: &Figures, layout: &Layout, all: &Places) -> Result<String, DrawError> {
    const TILE: f64 = 34.0;
    const GAP: f64 = 1.0;
    let axes = &cells.plan().axes;
    let words = |axis: usize| axes[axis].values.iter().map(short).collect::<Vec<_>>();
    let (x_words, y_words) = (words(layout.x), layout.columns.map_or_else(|| vec![String::new()], words));
    let fields = shown(layout.rows.map(|axis| &axes[axis]));
    let left =
        y_words.iter().map(|word| text_width(word, LABEL)).fold(0.0, f64::max).clamp(20.0, 200.0) + 30.0;
    let width = (f64::from(WIDTH) - left - 20.0) / x_words.len() as f64;
    let colors = colors(figures);
    let head = 26.0;
    let field = head + TILE * y_words.len() as f64 + 26.0;
    let legend: Vec<(String, Mark)> =
        figures.models.iter().cloned().zip(colors.iter().copied().map(Mark::Area)).collect();
    let draw = |area: &Area<'_>| -> Drawn {
        let label = |content: &str, x: f64, y: f64, horizontal: HPos| {
            let style = text(LABEL, INK).pos(Pos::new(horizontal, VPos::Center));
            area.draw(&Text::new(content.to_owned(), (px(x), px(y)), style))
        };
        for (i, &row) in fields.iter().enumerate() {
            let top = i as f64 * field;
            let of_row =
                layout.rows.map(|axis| format!("{} {}: ", axes[axis].key, short(&axes[axis].values[row])));
            let y_key = layout.columns.map(|axis| format!("{} against ", axes[axis].key));
            let title =
                [of_row, y_key, Some(axes[layout.x].key.clone())].into_iter().flatten().collect::<String>();
            area.draw(&Text::new(title, (px(left), px(top + 6.0)), text(HEADING, INK)))?;
            for (column, word) in y_words.iter().enumerate() {
                let y = top + head + TILE * column as f64;
                label(word, left - 8.0, y + 0.5 * TILE, HPos::Right)?;
                for index in 0..x_words.len() {
                    let at =
                        |model: usize| all.get(&(column, row, index, model)).map(|tally| (model, *tally));
                    let (models, tallies): (Vec<usize>, Vec<Tally>) =
                        (0..colors.len()).filter_map(at).unzip();
                    let places = places(&tallies);
                    let Some(first) = places.iter().position(|place| *place == Place::Best) else { continue };
                    let strength = if places.contains(&Place::Tied) { 0.35 } else { 0.85 };
                    let x = left + width * index as f64;
                    let corners = [(px(x + GAP), px(y + GAP)), (px(x + width - GAP), px(y + TILE - GAP))];
                    area.draw(&Rectangle::new(corners, colors[models[first]].mix(strength).filled()))?;
                    let rmse = significant(tallies[first].rmse_m());
                    if text_width(&rmse, LABEL) < width - 4.0 {
                        label(&rmse, x + 0.5 * width, y + 0.5 * TILE, HPos::Center)?;
                    }
                }
            }
            let mut free_from = 0.0;
            for (index, word) in x_words.iter().enumerate() {
                let x = left + width * (index as f64 + 0.5);
                let half = 0.5 * text_width(word, LABEL);
                if x - half >= free_from {
                    label(word, x, top + head + TILE * y_words.len() as f64 + 11.0, HPos::Center)?;
                    free_from = x + half + 6.0;
                }
            }
        }
        Ok(())
    };
    figure("Best model", &legend, field * fields.len() as f64, draw)
}

/// A model with its settings of the filter.
pub struct Cost {
    /// Index of the model.
    pub model: usize,
    /// The settings: `particles 100, beams 12`.
    pub settings: String,
    /// Its trials.
    pub tally: Tally,
    /// Whether no other is both cheaper and better.
    pub on_front: bool,
}

/// Models with their settings of the filter, cheapest first; `None` where nothing that costs varies.
pub fn costs(cells: &Cells, figures: &Figures) -> Option<Vec<Cost>> {
    let axes = &cells.plan().axes;
    // What doesn't vary is no choice.
    let is_setting = |axis: &Axis| {
        axis.values.len() > 1 && (axis.key.starts_with("filter") || axis.key.starts_with("models"))
    };
    let chosen: Vec<usize> = (0..axes.len()).filter(|i| is_setting(&axes[*i])).collect();
    let mut tallies = BTreeMap::<(Vec<usize>, usize), Tally>::new();
    for cell in &figures.cells {
        let indices = cells.indices(cell.cell);
        let settings: Vec<usize> = chosen.iter().map(|axis| indices[*axis]).collect();
        for (model, tally) in &cell.models {
            tallies.entry((settings.clone(), *model)).or_default().add(tally);
        }
    }
    let mut points: Vec<Cost> = tallies
        .into_iter()
        .map(|((settings, model), tally)| {
            let setting = |(axis, index): (&usize, &usize)| {
                format!("{} {}", last_key(&axes[*axis].key), short(&axes[*axis].values[*index]))
            };
            let settings = chosen.iter().zip(&settings).map(setting).collect::<Vec<_>>().join(", ");
            Cost { model, settings, tally, on_front: false }
        })
        .collect();
    points.sort_by(|a, b| {
        a.tally.casts().total_cmp(&b.tally.casts()).then(a.tally.rmse_m().total_cmp(&b.tally.rmse_m()))
    });
    let mut lowest = f64::INFINITY;
    for point in &mut points {
        point.on_front = point.tally.rmse_m() < lowest;
        lowest = lowest.min(point.tally.rmse_m());
    }
    let (cheapest, dearest) = (points.first()?.tally.casts(), points.last()?.tally.casts());
    (cheapest > 0.0 && dearest > 1.05 * cheapest).then_some(points)
}

fn pareto(figures: &Figures, points: &[Cost]) -> Result<String, DrawError> {
    let ends = |value: fn(&Tally) -> f64| {
        let values =
            points.iter().map(|point| value(&point.tally)).filter(|value| value.is_finite() && *value > 0.0);
        values.fold((f64::INFINITY, 0.0_f64), |(lo, hi), value| (lo.min(value), hi.max(value)))
    };
    let ((x_lo, x_hi), (y_lo, y_hi)) = (ends(Tally::casts), ends(Tally::rmse_m));
    let x = Scale::logarithmic("particles x beams of a filter step", x_lo / 1.2, x_hi * 1.2);
    let y = Scale::logarithmic("RMSE [m]", y_lo / 1.15, y_hi * 1.15);
    let colors = colors(figures);
    let legend: Vec<(String, Mark)> =
        figures.models.iter().cloned().zip(colors.iter().copied().map(Mark::Dot)).collect();
    figure("Error against cost", &legend, 380.0, |area| {
        let mut chart = chart(area, &x, &y, LEFT)?;
        let place = |point: &Cost| (point.tally.casts(), point.tally.rmse_m());
        // Steps: between two settings the cheaper one is the best that can be had.
        let mut front: Vec<(f64, f64)> = Vec::new();
        for at in points.iter().filter(|point| point.on_front).map(place) {
            if let Some(&(_, before)) = front.last() {
                front.push((at.0, before));
            }
            front.push(at);
        }
        chart.draw_series([PathElement::new(front, line(INK.mix(0.5), 1.5))])?;
        for point in points {
            let color = colors[point.model];
            let style = if point.on_front { color.filled() } else { line(color, 1.5) };
            chart.draw_series([Circle::new(place(point), px(4.0), style)])?;
        }
        Ok(())
    })
}
