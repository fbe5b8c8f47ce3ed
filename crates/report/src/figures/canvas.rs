//! Common parts of all figures: size, type, colours, axes and legends.

use std::io;
use std::ops::Range;

use plotters::chart::{ChartBuilder, ChartContext};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::{
    Cartesian2d, Circle, Color, DrawingArea, DrawingAreaErrorKind, IntoDrawingArea, IntoFont, PathElement,
    RGBColor, Rectangle, SVGBackend, ShapeStyle, Text, TextStyle,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::palette;

/// Drawing units per pixel: the SVG backend rounds coordinates to integers, and a quarter of a pixel is fine.
const UNITS: u32 = 4;
/// Width of every figure (px).
pub const WIDTH: u32 = 960;
/// The typeface; the first is what the PNGs are set in, the others stand in where it isn't installed.
const TYPEFACE: &str = "Ubuntu, Segoe UI, Helvetica, Arial, sans-serif";
/// Size of labels (px).
pub const LABEL: f64 = 13.0;
/// Size of a panel's title (px).
pub const HEADING: f64 = 14.0;
/// Size of a figure's title (px).
const TITLE: f64 = 18.0;
/// Room left of a y axis' title (px).
const EDGE: f64 = 12.0;

/// Text and axes.
pub const INK: RGBColor = RGBColor(0x26, 0x26, 0x26);
/// Background elements: grids, reference lines.
pub const GRID: RGBColor = RGBColor(0xe4, 0xe4, 0xe4);
/// Things unknown to the filter: blocks.
pub const UNKNOWN: RGBColor = RGBColor(0xb4, 0xb4, 0xb4);
/// Readings of the laser.
pub const READING: RGBColor = RGBColor(0x7b, 0x3f, 0xb5);

/// The colour of a model: fixed by its place among the models of the run, in every figure.
pub fn model_color(models: &[String], name: &str) -> RGBColor {
    let [red, green, blue] = palette::of_model(models, name);
    RGBColor(red, green, blue)
}

/// Drawing into a string can't fail, but plotters' signatures allow for it.
pub type DrawError = DrawingAreaErrorKind<io::Error>;
/// Result of drawing.
pub type Drawn = Result<(), DrawError>;
/// A part of a figure.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// A panel.
pub type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Axis, Axis>>;

/// Pixels in drawing units.
pub fn px(pixels: f64) -> i32 {
    (pixels * f64::from(UNITS)).round() as i32
}

/// A line of this colour and width (px).
pub fn line(color: impl Color, width_px: f64) -> ShapeStyle {
    color.stroke_width(px(width_px) as u32)
}

/// Text of this size (px) and colour.
pub fn text(size: f64, color: RGBColor) -> TextStyle<'static> {
    // The SVG backend divides font sizes by 1.24.
    (TYPEFACE, size * f64::from(UNITS) * 1.24).into_font().color(&color)
}

/// Estimated width of a text (px): plotters has no metrics of the typeface.
pub fn text_width(content: &str, size: f64) -> f64 {
    let advance = |c| match c {
        'i' | 'l' | 'j' | 'I' | '.' | ',' | ':' | ' ' | '/' | '\'' | '|' => 0.27,
        'f' | 'r' | 't' | '-' | '(' | ')' | '[' | ']' => 0.36,
        'm' | 'w' | 'M' | 'W' | '%' => 0.85,
        _ => 0.56,
    };
    content.chars().map(advance).sum::<f64>() * size
}

/// How an entry of a legend looks in the figure.
#[derive(Clone, Copy, Debug)]
pub enum Mark {
    /// A line.
    Line(RGBColor),
    /// A dot.
    Dot(RGBColor),
    /// A ring.
    Ring(RGBColor),
    /// A filled area.
    Area(RGBColor),
}

/// Least room between two labels of an axis (px).
const LABEL_GAP: f64 = 4.0;
const LINE_HEIGHT: f64 = 22.0;
const SWATCH: f64 = 22.0;

/// Places of legend entries (px), wrapped at the figure's width, and the height they take.
fn legend_layout(entries: &[(String, Mark)]) -> (Vec<(f64, f64)>, f64) {
    let (mut x, mut y) = (16.0, 0.0);
    let mut places = Vec::new();
    for (label, _) in entries {
        let width = SWATCH + 8.0 + text_width(label, LABEL) + 24.0;
        if x + width > f64::from(WIDTH) && x > 16.0 {
            (x, y) = (16.0, y + LINE_HEIGHT);
        }
        places.push((x, y));
        x += width;
    }
    (places, if entries.is_empty() { 0.0 } else { y + LINE_HEIGHT })
}

fn draw_legend_entry(area: &Area<'_>, (x, y): (f64, f64), label: &str, mark: Mark) -> Drawn {
    let middle = px(y + LINE_HEIGHT / 2.0);
    let (left, right) = (px(x), px(x + SWATCH));
    let center = (px(x + SWATCH / 2.0), middle);
    match mark {
        Mark::Line(color) => {
            area.draw(&PathElement::new([(left, middle), (right, middle)], line(color, 2.5)))?;
        }
        Mark::Dot(color) => area.draw(&Circle::new(center, px(4.0), color.filled()))?,
        Mark::Ring(color) => area.draw(&Circle::new(center, px(4.0), line(color, 1.5)))?,
        Mark::Area(color) => {
            area.draw(&Rectangle::new(
                [(left, middle - px(6.0)), (right, middle + px(6.0))],
                color.filled(),
            ))?;
        }
    }
    let style = text(LABEL, INK).pos(Pos::new(HPos::Left, VPos::Center));
    area.draw(&Text::new(label.to_owned(), (px(x + SWATCH + 8.0), middle), style))
}

/// A figure: title and legend, then what `body` draws into an area of `body_height` pixels beneath them.
///
/// # Errors
/// [`DrawError`] when the backend refuses a shape.
pub fn figure(
    title: &str,
    legend: &[(String, Mark)],
    body_height: f64,
    body: impl FnOnce(&Area<'_>) -> Drawn,
) -> Result<String, DrawError> {
    let (places, legend_height) = legend_layout(legend);
    let top = 42.0;
    let head = top + legend_height + 6.0;
    let height = (head + body_height).ceil() as u32;
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (WIDTH * UNITS, height * UNITS)).into_drawing_area();
        root.fill(&plotters::style::WHITE)?;
        root.draw(&Text::new(title.to_owned(), (px(16.0), px(14.0)), text(TITLE, INK)))?;
        for ((label, mark), (x, y)) in legend.iter().zip(places) {
            draw_legend_entry(&root, (x, top + y), label, *mark)?;
        }
        let (_, below) = root.split_vertically(px(head));
        body(&below)?;
        root.present()?;
    }
    // Shown at one pixel per `UNITS`; the view box keeps the units.
    let in_units = format!("width=\"{}\" height=\"{}\"", WIDTH * UNITS, height * UNITS);
    Ok(svg.replacen(&in_units, &format!("width=\"{WIDTH}\" height=\"{height}\""), 1))
}

/// One axis of a panel. Values beyond an end are drawn on it.
#[derive(Clone, Debug)]
pub struct Axis {
    label: String,
    lo: f64,
    hi: f64,
    /// Values with a grid line, and what is written at them.
    ticks: Vec<(f64, String)>,
    logarithmic: bool,
    /// Of rows with a name each.
    is_list: bool,
}

impl Axis {
    /// From `lo` to `hi` with about `count` round ticks.
    pub fn linear(label: &str, lo: f64, hi: f64, count: f64) -> Self {
        let (lo, hi) = usable(lo, hi);
        let rough = (hi - lo) / count;
        let decade = 10f64.powf(rough.log10().floor());
        let step =
            [1.0, 2.0, 5.0].map(|m| m * decade).into_iter().find(|s| *s >= rough).unwrap_or(10.0 * decade);
        let decimals = (-(step * 1.001).log10().floor()).max(0.0) as usize;
        let slack = 1e-9 * (hi - lo);
        let ticks = ((lo / step).floor() as i64..=(hi / step).ceil() as i64)
            .map(|i| i as f64 * step)
            .filter(|tick| *tick >= lo - slack && *tick <= hi + slack)
            .map(|tick| (tick, format!("{tick:.decimals$}")))
            .collect();
        Self { label: label.to_owned(), lo, hi, ticks, logarithmic: false, is_list: false }
    }

    /// From `lo` to `hi`, both positive, with ticks at powers of ten and the more multiples of them the shorter
    /// the axis.
    pub fn logarithmic(label: &str, lo: f64, hi: f64) -> Self {
        let (lo, hi) = usable(lo.max(1e-12), hi.max(1.5e-12));
        let hi = hi.max(1.5 * lo);
        let multiples: &[f64] = match hi / lo {
            ratio if ratio < 8.0 => &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0],
            ratio if ratio < 2000.0 => &[1.0, 2.0, 5.0],
            _ => &[1.0],
        };
        let ticks = (lo.log10().floor() as i32..=hi.log10().ceil() as i32)
            .flat_map(|decade| multiples.iter().map(move |m| (m * 10f64.powi(decade), decade)))
            .filter(|(tick, _)| (lo * (1.0 - 1e-9)..=hi * (1.0 + 1e-9)).contains(tick))
            .map(|(tick, decade)| {
                let decimals = (-decade).max(0) as usize;
                (tick, if decade < -4 { format!("{tick:e}") } else { format!("{tick:.decimals$}") })
            })
            .collect::<Vec<_>>();
        // Within less than an octave few of these lie; a step in metres then has more.
        let ticks = if ticks.len() < 3 { Self::linear(label, lo, hi, 4.0).ticks } else { ticks };
        Self { label: label.to_owned(), lo, hi, ticks, logarithmic: true, is_list: false }
    }

    /// Words at 0, 1, 2 and so on.
    pub fn words(label: &str, words: &[String]) -> Self {
        let ticks = words.iter().enumerate().map(|(i, word)| (i as f64, word.clone())).collect();
        let hi = words.len() as f64 - 0.5;
        Self { label: label.to_owned(), lo: -0.5, hi, ticks, logarithmic: false, is_list: false }
    }

    /// Rows of a list, the first on top, at 0, -1, -2 and so on.
    pub fn rows(labels: &[String]) -> Self {
        let ticks = labels.iter().enumerate().map(|(i, label)| (-(i as f64), label.clone())).collect();
        Self {
            label: String::new(),
            lo: 0.5 - labels.len() as f64,
            hi: 0.5,
            ticks,
            logarithmic: false,
            is_list: true,
        }
    }

    /// The same axis with its ticks but without their labels.
    #[must_use]
    pub fn unlabelled(mut self) -> Self {
        self.label.clear();
        self.ticks.iter_mut().for_each(|(_, label)| label.clear());
        self
    }

    /// The same axis without the labels that would touch the one before, where a label takes `extent` of `length` pixels.
    fn without_collisions(mut self, length: f64, extent: impl Fn(&str) -> f64) -> Self {
        let mut free_from = f64::NEG_INFINITY;
        for i in 0..self.ticks.len() {
            let (tick, label) = &mut self.ticks[i];
            let share = if self.logarithmic {
                (*tick / self.lo).ln() / (self.hi / self.lo).ln()
            } else {
                (*tick - self.lo) / (self.hi - self.lo)
            };
            let half = 0.5 * extent(label);
            if share * length - half < free_from {
                label.clear();
            } else {
                free_from = share * length + half + LABEL_GAP;
            }
        }
        self
    }

    /// Its ends.
    pub fn ends(&self) -> (f64, f64) {
        (self.lo, self.hi)
    }

    /// Room right of a panel for the half of the last tick's label that stands beyond it (px).
    fn overhang(&self) -> f64 {
        let widest = self.ticks.last().map_or(0.0, |(_, label)| text_width(label, LABEL));
        (0.5 * widest + 4.0).max(18.0)
    }

    /// Room that its tick labels and its title need below a panel (px).
    fn height(&self) -> f64 {
        let labelled = self.ticks.iter().any(|(_, label)| !label.is_empty());
        match (self.label.is_empty(), labelled) {
            (false, _) => 46.0,
            (true, true) => 26.0,
            (true, false) => 6.0,
        }
    }
}

/// The ends of an axis, replaced where there is nothing to span.
fn usable(lo: f64, hi: f64) -> (f64, f64) {
    match (lo.is_finite(), hi.is_finite()) {
        (true, true) if hi > lo => (lo, hi),
        (true, _) => (lo, lo + 1.0),
        _ => (1.0, 2.0),
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        let value = value.clamp(self.lo, self.hi);
        let share = if self.logarithmic {
            (value / self.lo).ln() / (self.hi / self.lo).ln()
        } else {
            (value - self.lo) / (self.hi - self.lo)
        };
        from + (share * f64::from(to - from)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        // No light grid lines between the ticks.
        if hint.weight().allow_light_points() { vec![] } else { self.ticks.iter().map(|t| t.0).collect() }
    }

    fn range(&self) -> Range<f64> {
        self.lo..self.hi
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, value: &f64) -> String {
        self.ticks.iter().find(|(tick, _)| tick == value).map_or_else(String::new, |(_, label)| label.clone())
    }
}

/// The title of a panel from `left` (px) on, farther left where it would be cut off at the right. Gives the area beneath it.
///
/// # Errors
/// As [`figure`].
pub fn heading<'a>(area: &Area<'a>, title: &str, left: f64) -> Result<Area<'a>, DrawError> {
    let width = f64::from(area.dim_in_pixel().0) / f64::from(UNITS);
    let place = left.min(width - text_width(title, HEADING) - 4.0).max(0.0);
    area.draw(&Text::new(title.to_owned(), (px(place), px(8.0)), text(HEADING, INK)))?;
    Ok(area.split_vertically(px(24.0)).1)
}

/// A panel with a light grid. `left` is the room for the labels of the y axis (px).
///
/// # Errors
/// As [`figure`].
pub fn chart<'a, 'b>(area: &'a Area<'b>, x: &Axis, y: &Axis, left: f64) -> Result<Chart<'a, 'b>, DrawError> {
    let (width, height) = area.dim_in_pixel();
    let [width, height] = [width, height].map(|pixels| f64::from(pixels) / f64::from(UNITS));
    let (right, bottom) = (x.overhang(), x.height());
    let x = x.clone().without_collisions(width - left - right, |label| text_width(label, LABEL));
    // A list names each of its rows.
    let y =
        if y.is_list { y.clone() } else { y.clone().without_collisions(height - 8.0 - bottom, |_| LABEL) };
    let mut chart = ChartBuilder::on(area)
        .margin_top(px(8.0))
        .margin_right(px(right))
        // The backend sets the axis title on the very edge of its area.
        .margin_left(px(EDGE))
        .x_label_area_size(px(bottom))
        .y_label_area_size(px(left - EDGE))
        .build_cartesian_2d(x.clone(), y.clone())?;
    chart
        .configure_mesh()
        .bold_line_style(line(GRID, 1.0))
        .axis_style(line(RGBColor(0x99, 0x99, 0x99), 1.0))
        .label_style(text(LABEL, INK))
        .axis_desc_style(text(LABEL, INK))
        .set_all_tick_mark_size(px(4.0))
        .x_desc(x.label.clone())
        .y_desc(y.label.clone())
        .draw()?;
    Ok(chart)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let labels = |axis: Axis| axis.ticks.into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(labels(Axis::linear("", 0.0, 10.0, 5.0)), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(Axis::linear("", -0.07, 0.12, 4.0)), ["-0.05", "0.00", "0.05", "0.10"]);
        assert_eq!(
            labels(Axis::logarithmic("", 0.004, 0.3)),
            ["0.005", "0.01", "0.02", "0.05", "0.1", "0.2"]
        );
        assert_eq!(labels(Axis::logarithmic("", 45.0, 220.0)), ["50", "60", "80", "100", "200"]);
        assert_eq!(labels(Axis::logarithmic("", 0.001, 100.0)), ["0.001", "0.01", "0.1", "1", "10", "100"]);
    }

    #[test]
    fn labels_do_not_touch() {
        let labels = |axis: Axis, length: f64| {
            let axis = axis.without_collisions(length, |label| text_width(label, LABEL));
            axis.ticks.into_iter().map(|tick| tick.1).filter(|label| !label.is_empty()).collect::<Vec<_>>()
        };
        let axis = || Axis::logarithmic("", 1.0, 7.0);
        assert_eq!(labels(axis(), 400.0), ["1", "2", "3", "4", "5", "6"]);
        assert_eq!(labels(axis(), 70.0), ["1", "2", "3", "5"]);
        // Less than an octave.
        assert_eq!(labels(Axis::logarithmic("", 0.0174, 0.0222), 400.0), ["0.020", "0.025"]);
    }

    /// A label of the last tick is centred on the panel's right end.
    #[test]
    fn the_last_label_has_room() {
        let beyond = |hi: f64| 0.5 * text_width(&format!("{hi}"), LABEL);
        for hi in [10.0, 1e4, 1e7, 1e11] {
            let room = Axis::logarithmic("", 1.0, hi).overhang();
            assert!(room > beyond(hi) && room < beyond(hi) + 20.0, "{room} at {hi}");
        }
    }

    #[test]
    fn a_title_stays_in_its_panel() {
        let places = |title: &str| {
            let svg = figure("", &[], 100.0, |area| {
                for cell in area.split_evenly((1, 3)) {
                    heading(&cell, title, 74.0)?;
                }
                Ok(())
            });
            // Left ends of the titles (px).
            let svg = svg.unwrap();
            let texts = svg.split("<text ").filter(|text| text.contains(title));
            texts
                .map(|text| text.split('"').nth(1).unwrap().parse::<f64>().unwrap() / 4.0)
                .collect::<Vec<_>>()
        };
        assert_eq!(places("short title"), [74.0, 394.0, 714.0]);
        let long = "laser: range 2.437 m, incidence 0.865 rad";
        let width = text_width(long, HEADING);
        for (place, left) in places(long).into_iter().zip([0.0, 320.0, 640.0]) {
            assert!(place >= left && place + width <= left + 320.0, "{place}");
        }
    }

    #[test]
    fn a_degenerate_range_still_makes_an_axis() {
        let axis = Axis::linear("", 3.0, 3.0, 5.0);
        assert!(axis.hi > axis.lo);
        assert_eq!(axis.map(&9.0, (0, 100)), 100);
        for axis in
            [Axis::linear("", f64::INFINITY, f64::NEG_INFINITY, 5.0), Axis::linear("", f64::NAN, 1.0, 5.0)]
        {
            assert!(axis.hi > axis.lo && axis.lo.is_finite());
        }
        let axis = Axis::logarithmic("", f64::INFINITY, 0.0);
        assert!(axis.hi > axis.lo && axis.lo > 0.0 && axis.lo.is_finite());
        let axis = Axis::logarithmic("", 0.0, 0.0);
        assert!(axis.hi > axis.lo && axis.map(&0.0, (0, 100)) == 0);
    }
}
