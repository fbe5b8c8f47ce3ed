//! Figures of errors and effective sample sizes over all trials.

use locsim_core::Interval;
use plotters::prelude::{Circle, Color, PathElement, Polygon, RGBColor, Rectangle, Text};

use super::canvas::{
    Area, Axis, DrawError, Drawn, HEADING, INK, LABEL, Mark, WIDTH, chart, figure, line, model_color, px,
    text,
};
use crate::results::{RunResults, StepRow};
use crate::statistics::quantile;
use crate::summary::{Ratio, Ratios, Summary};

/// The finest error worth an axis (m).
const FINEST_M: f64 = 1e-4;
/// Points of a drawn distribution.
const POINTS: u32 = 240;
/// Most points of a drawn time series.
const MOMENTS: usize = 500;
/// Where reference and map disagree.
const DISAGREEMENT: RGBColor = RGBColor(0xf4, 0xe3, 0xb5);

fn legend(models: &[String]) -> Vec<(String, Mark)> {
    models.iter().map(|m| (m.clone(), Mark::Line(model_color(models, m)))).collect()
}

/// Share of steps whose position error is below a value, per model.
pub fn distribution(results: &RunResults) -> Result<String, DrawError> {
    let curves: Vec<Vec<(f64, f64)>> = (0..results.models.len())
        .map(|model| {
            let steps = results.trials.iter().flat_map(|t| &t.models[model].steps);
            let mut errors: Vec<f64> = steps.map(StepRow::position_error_m).collect();
            errors.sort_by(f64::total_cmp);
            let share = |i: u32| f64::from(i) / f64::from(POINTS);
            (0..=POINTS).map(|i| (quantile(&errors, share(i)), share(i))).collect()
        })
        .collect();
    // The lowest percent would stretch the axis by decades.
    let lowest = curves.iter().map(|c| c[POINTS as usize / 100].0).fold(f64::INFINITY, f64::min);
    let highest = curves.iter().map(|c| c[POINTS as usize].0).fold(FINEST_M, f64::max);
    let x = Axis::logarithmic("position error [m]", lowest.max(FINEST_M), 1.05 * highest);
    let y = Axis::linear("share of steps with a smaller error", 0.0, 1.0, 5.0);
    figure("Position error of each model", &legend(&results.models), 420.0, |area| {
        let mut chart = chart(area, &x, &y, 74.0)?;
        for (model, curve) in results.models.iter().zip(&curves) {
            let style = line(model_color(&results.models, model), 2.0);
            chart.draw_series([PathElement::new(curve.clone(), style)])?;
        }
        Ok(())
    })
}

/// Quantiles over trials at each step.
struct Series {
    /// Seconds since the start of the drive.
    time: Vec<f64>,
    lower: Vec<f64>,
    median: Vec<f64>,
    upper: Vec<f64>,
}

impl Series {
    /// Of `value`, over the trials that reach a step; steps are thinned evenly to what a figure can show.
    fn new(results: &RunResults, model: usize, value: fn(&StepRow) -> f64) -> Self {
        let trials: Vec<&[StepRow]> =
            results.trials.iter().map(|t| t.models[model].steps.as_slice()).collect();
        let steps = trials.iter().map(|t| t.len()).max().unwrap_or(0);
        let mut series = Self { time: vec![], lower: vec![], median: vec![], upper: vec![] };
        for step in (0..steps).step_by(steps.div_ceil(MOMENTS).max(1)) {
            let mut values: Vec<f64> = trials.iter().filter_map(|t| t.get(step)).map(value).collect();
            values.sort_by(f64::total_cmp);
            let time = trials.iter().find_map(|t| Some(t.get(step)?.stamp_secs - t[0].stamp_secs));
            series.time.push(time.unwrap_or(0.0));
            series.lower.push(quantile(&values, 0.1));
            series.median.push(quantile(&values, 0.5));
            series.upper.push(quantile(&values, 0.9));
        }
        series
    }

    fn points(&self, values: &[f64]) -> Vec<(f64, f64)> {
        self.time.iter().copied().zip(values.iter().copied()).collect()
    }
}

/// The times at which reference and map disagree, from and to (s since the start of the drive).
fn disagreements(results: &RunResults) -> Vec<[f64; 2]> {
    let Some(steps) = results.trials.first().and_then(|trial| Some(&trial.models.first()?.steps)) else {
        return Vec::new();
    };
    let secs =
        |step: u32| steps.iter().find(|row| row.step >= step).map(|row| row.stamp_secs - steps[0].stamp_secs);
    let found = results.disagreements.iter();
    found.filter_map(|found| Some([secs(found.first_scan)?, secs(found.last_scan)?])).collect()
}

fn extremes<'a>(values: impl Iterator<Item = &'a f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), &v| (lo.min(v), hi.max(v)))
}

/// Position error over time: one panel per model with its median and the band of the middle 80 % of trials; the
/// other models' medians stand behind in grey, and stretches on which reference and map disagree are coloured.
pub fn over_time(results: &RunResults) -> Result<String, DrawError> {
    let series: Vec<Series> =
        (0..results.models.len()).map(|m| Series::new(results, m, StepRow::position_error_m)).collect();
    let end = series.iter().filter_map(|s| s.time.last()).fold(0.0, |a: f64, &b| a.max(b));
    let (_, highest) = extremes(series.iter().flat_map(|s| &s.upper));
    let (lowest, _) = extremes(series.iter().flat_map(|s| s.lower.iter().skip(1).chain(&s.median)));
    let y = Axis::logarithmic("position error [m]", lowest.max(1e-3), 1.1 * highest.max(2e-3));
    let x = Axis::linear("time [s]", 0.0, end, 5.0);
    let columns = if series.len() == 1 { 1 } else { 2 };
    let rows = series.len().div_ceil(columns);
    let mut legend = vec![
        ("median over trials".to_owned(), Mark::Line(INK)),
        ("10 % to 90 % of trials".to_owned(), Mark::Area(RGBColor(0xcc, 0xcc, 0xcc))),
        ("medians of the other models".to_owned(), Mark::Line(RGBColor(0xcc, 0xcc, 0xcc))),
    ];
    let disagreements = disagreements(results);
    if !disagreements.is_empty() {
        legend.push(("reference and map disagree".to_owned(), Mark::Area(DISAGREEMENT)));
    }
    let (floor, ceiling) = y.ends();
    figure("Position error over time", &legend, 252.0 * rows as f64, |area| {
        for (index, panel) in area.split_evenly((rows, columns)).iter().enumerate().take(series.len()) {
            let (model, own) = (&results.models[index], &series[index]);
            let color = model_color(&results.models, model);
            panel.draw(&Text::new(model.clone(), (px(74.0), px(12.0)), text(HEADING, color)))?;
            let (_, below) = panel.split_vertically(px(28.0));
            let mut chart = chart(&below, &x, &y, 74.0)?;
            let shaded = disagreements.iter().map(|&[from, to]| {
                Rectangle::new([(from, floor), (to, ceiling)], DISAGREEMENT.mix(0.7).filled())
            });
            chart.draw_series(shaded)?;
            for other in series.iter().enumerate().filter(|(i, _)| *i != index).map(|(_, s)| s) {
                let points = other.points(&other.median);
                chart.draw_series([PathElement::new(points, line(RGBColor(0xcc, 0xcc, 0xcc), 1.0))])?;
            }
            let mut band = own.points(&own.upper);
            band.extend(own.points(&own.lower).into_iter().rev());
            chart.draw_series([Polygon::new(band, color.mix(0.22).filled())])?;
            chart.draw_series([PathElement::new(own.points(&own.median), line(color, 2.0))])?;
        }
        Ok(())
    })
}

/// Median effective sample size over time, per model.
pub fn effective_sample_size(results: &RunResults) -> Result<String, DrawError> {
    let series: Vec<Series> =
        (0..results.models.len()).map(|m| Series::new(results, m, |s| s.effective_sample_size)).collect();
    let end = series.iter().filter_map(|s| s.time.last()).fold(0.0, |a: f64, &b| a.max(b));
    let (lowest, highest) = extremes(series.iter().flat_map(|s| &s.median));
    let x = Axis::linear("time [s]", 0.0, end, 8.0);
    let y = Axis::logarithmic("effective sample size", lowest.max(1.0) / 1.2, 1.2 * highest.max(2.0));
    figure(
        "Effective sample size before resampling, median over trials",
        &legend(&results.models),
        320.0,
        |area| {
            let mut chart = chart(area, &x, &y, 74.0)?;
            for (model, own) in results.models.iter().zip(&series) {
                let style = line(model_color(&results.models, model), 1.75);
                chart.draw_series([PathElement::new(own.points(&own.median), style)])?;
            }
            Ok(())
        },
    )
}

/// One estimate of a forest plot: a place, its interval, and whether lost trials are in it.
struct Estimate {
    value: f64,
    interval: Option<Interval>,
    all: bool,
}

/// A forest plot's panel: estimates by row, with a reference line.
struct Forest {
    title: String,
    rows: Vec<Vec<Estimate>>,
    reference: Option<f64>,
    unit: &'static str,
}

impl Forest {
    fn draw(&self, area: &Area<'_>, models: &[String], left: Option<f64>) -> Drawn {
        let ends = |e: &Estimate| {
            let interval = e.interval.unwrap_or(Interval { lo: e.value, hi: e.value });
            [e.value, interval.lo, interval.hi]
        };
        let values: Vec<f64> =
            self.rows.iter().flatten().flat_map(ends).chain(self.reference).filter(|v| *v > 0.0).collect();
        let (lowest, highest) = extremes(values.iter());
        let x = Axis::logarithmic(self.unit, lowest / 1.25, 1.25 * highest);
        let y = Axis::rows(models);
        let y = if left.is_some() { y } else { y.unlabelled() };
        let left = left.unwrap_or(18.0);
        area.draw(&Text::new(self.title.clone(), (px(left), px(6.0)), text(HEADING, INK)))?;
        let (_, below) = area.split_vertically(px(24.0));
        let mut chart = chart(&below, &x, &y, left)?;
        if let Some(reference) = self.reference {
            let (bottom, top) = y.ends();
            let style = line(RGBColor(0x77, 0x77, 0x77), 1.5);
            chart.draw_series([PathElement::new(vec![(reference, bottom), (reference, top)], style)])?;
        }
        for (row, (model, estimates)) in models.iter().zip(&self.rows).enumerate() {
            let color = model_color(models, model);
            for estimate in estimates {
                let place = -(row as f64) + if estimate.all { 0.14 } else { -0.18 };
                if let Some(Interval { lo, hi }) = estimate.interval {
                    let width = if estimate.all { 2.5 } else { 1.25 };
                    let points = vec![(lo, place), (hi, place)];
                    chart.draw_series([PathElement::new(points, line(color, width))])?;
                }
                let center = (estimate.value, place);
                if estimate.all {
                    chart.draw_series([Circle::new(center, px(4.5), color.filled())])?;
                } else {
                    chart.draw_series([Circle::new(center, px(4.0), plotters::style::WHITE.filled())])?;
                    chart.draw_series([Circle::new(center, px(4.0), line(color, 1.5))])?;
                }
            }
        }
        Ok(())
    }
}

/// RMSE of each model with its interval, over all trials and without lost ones, and its ratios to `classic` and
/// `oracle` where these are in the run.
pub fn forest(summary: &Summary) -> Result<String, DrawError> {
    let models: Vec<String> = summary.models.keys().cloned().collect();
    let rmse = summary.models.values().map(|m| {
        let all = Estimate {
            value: m.errors.position_rmse_m,
            interval: m.intervals.map(|i| i.errors.position_rmse_m),
            all: true,
        };
        let kept = m.kept.filter(|_| m.lost_share > 0.0).map(|kept| Estimate {
            value: kept.errors.position_rmse_m,
            interval: kept.intervals.map(|i| i.position_rmse_m),
            all: false,
        });
        [all].into_iter().chain(kept).collect()
    });
    let mut panels = vec![Forest {
        title: "position RMSE".to_owned(),
        rows: rmse.collect(),
        reference: None,
        unit: "RMSE [m]",
    }];
    let ratio_panel = |title: String, pick: fn(&Ratios) -> Option<Ratio>| {
        let rows: Vec<Vec<Estimate>> = summary
            .ratios
            .values()
            .zip(summary.ratios_kept.values())
            .map(|(all, kept)| {
                let estimate =
                    |ratio: Ratio, all| Estimate { value: ratio.value, interval: ratio.interval(), all };
                let all = pick(all).map(|r| estimate(r, true));
                // Only worth a mark where leaving lost trials out changes the ratio.
                let kept = pick(kept).filter(|k| all.as_ref().is_none_or(|a| a.value != k.value));
                all.into_iter().chain(kept.map(|r| estimate(r, false))).collect()
            })
            .collect();
        rows.iter().any(|row| !row.is_empty()).then_some(Forest {
            title,
            rows,
            reference: Some(1.0),
            unit: "ratio",
        })
    };
    panels.extend(ratio_panel(format!("RMSE / {}", summary.baseline()), Ratios::rmse));
    panels.extend(ratio_panel("RMSE / oracle".to_owned(), |r| r.rmse_vs_oracle));
    let legend = [
        ("all trials, 95 % interval".to_owned(), Mark::Dot(INK)),
        ("without lost trials".to_owned(), Mark::Ring(INK)),
    ];
    let longest = models.iter().map(|m| super::canvas::text_width(m, LABEL)).fold(0.0, f64::max);
    let left = longest + 24.0;
    let height = 90.0 + 44.0 * models.len() as f64;
    figure("Position RMSE of each model, and against its competitors", &legend, height, |area| {
        let width = (f64::from(WIDTH) - left) / panels.len() as f64;
        let (first, rest) = area.split_horizontally(px(left + width));
        panels[0].draw(&first, &models, Some(left))?;
        if panels.len() > 1 {
            for (panel, area) in panels[1..].iter().zip(rest.split_evenly((1, panels.len() - 1))) {
                panel.draw(&area, &models, None)?;
            }
        }
        Ok(())
    })
}
