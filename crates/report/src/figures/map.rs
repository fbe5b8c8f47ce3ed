//! Figures on the map: trajectories, and the paper's Fig. 10.

use locsim_core::{Drive, Pose2};
use plotters::prelude::{Circle, Color, PathElement, Polygon, RGBColor, ShapeStyle, Text};

use super::canvas::{
    Area, Axis, Chart, DrawError, Drawn, HEADING, INK, Mark, READING, UNKNOWN, WIDTH, chart, figure, line,
    model_color, px, text,
};
use super::geometry::{Point, Window, join};
use crate::palette;
use crate::results::{DetailedModel, DetailedStep, DetailedTrial};
use crate::statistics::quantile;

/// Room for the labels of the y axis (px).
pub const LEFT: f64 = 74.0;
/// Margins of [`chart`] at the right, at the top and below a labelled x axis (px).
pub const MARGINS: (f64, f64, f64) = (18.0, 8.0, 46.0);
/// Colour of dead reckoning.
const DEAD_RECKONING: RGBColor = {
    let [red, green, blue] = palette::DEAD_RECKONING;
    RGBColor(red, green, blue)
};
/// Colour of the true path: drawn broad, under the others.
const TRUTH: RGBColor = RGBColor(0xf2, 0xd6, 0x30);
/// Most particles drawn of one filter.
const PARTICLES: usize = 500;

/// A map in a panel, everything clipped to its window.
pub struct MapPanel<'a, 'b> {
    chart: Chart<'a, 'b>,
    window: Window,
}

impl<'a, 'b> MapPanel<'a, 'b> {
    /// The window, with about this many ticks on x and y.
    ///
    /// # Errors
    /// [`DrawError`], as every shape here.
    pub fn new(area: &'a Area<'b>, window: Window, ticks: [f64; 2]) -> Result<Self, DrawError> {
        let x = Axis::linear("x [m]", window.lo[0], window.hi[0], ticks[0]);
        let y = Axis::linear("y [m]", window.lo[1], window.hi[1], ticks[1]);
        Ok(Self { chart: chart(area, &x, &y, LEFT)?, window })
    }

    /// The part of a polyline that shows.
    ///
    /// # Errors
    /// [`DrawError`].
    pub fn line(&mut self, points: &[Point], style: ShapeStyle) -> Drawn {
        for part in self.window.clip_line(points) {
            let points = part.into_iter().map(|[x, y]| (x, y)).collect::<Vec<_>>();
            self.chart.draw_series([PathElement::new(points, style)])?;
        }
        Ok(())
    }

    fn area(&mut self, corners: &[Point], color: RGBColor) -> Drawn {
        let corners = self.window.clip_polygon(corners);
        if corners.len() > 2 {
            let points = corners.into_iter().map(|[x, y]| (x, y)).collect::<Vec<_>>();
            self.chart.draw_series([Polygon::new(points, color.filled())])?;
        }
        Ok(())
    }

    /// A circle, if its middle shows.
    ///
    /// # Errors
    /// [`DrawError`].
    pub fn dot(&mut self, point: Point, radius_px: f64, style: ShapeStyle) -> Drawn {
        if self.window.contains(point) {
            self.chart.draw_series([Circle::new((point[0], point[1]), px(radius_px), style)])?;
        }
        Ok(())
    }

    /// Walls, and blocks under them.
    ///
    /// # Errors
    /// [`DrawError`].
    pub fn map(&mut self, walls: &[Vec<Point>], blocks: &[[Point; 4]]) -> Drawn {
        for block in blocks {
            self.area(block, UNKNOWN)?;
        }
        for wall in walls {
            self.line(wall, line(INK, 1.5))?;
        }
        Ok(())
    }

    /// A pose as a ring with a line along its heading, `size` metres long.
    fn pose(&mut self, pose: Pose2, size: f64, color: RGBColor) -> Drawn {
        let tip = [pose.x + size * pose.theta.cos(), pose.y + size * pose.theta.sin()];
        self.line(&[[pose.x, pose.y], tip], line(color, 2.0))?;
        self.dot([pose.x, pose.y], 5.0, line(color, 2.0))
    }
}

fn points(poses: impl IntoIterator<Item = Pose2>) -> Vec<Point> {
    poses.into_iter().map(|p| [p.x, p.y]).collect()
}

/// Width over height of the plot in an area of this size (px).
pub fn aspect(width: f64, height: f64) -> f64 {
    let (right, top, below) = MARGINS;
    (width - LEFT - right) / (height - top - below)
}

/// Height of a panel that shows these walls \[m\] (px), and the part of the plane that it shows.
pub fn panel(walls: &[[Point; 2]]) -> (f64, Window) {
    let bounds = Window::around(walls.iter().flatten());
    let (right, top, below) = MARGINS;
    let [width, height] = bounds.size();
    let plot_width = f64::from(WIDTH) - LEFT - right;
    let panel = (plot_width * 1.06 * height / width.max(1e-9)).clamp(130.0, 560.0) + top + below;
    (panel, bounds.with_aspect(aspect(f64::from(WIDTH), panel)))
}

/// Truth (or reference, as `truth` calls it), dead reckoning and each model's most likely trajectory on the map, and beneath
/// it how far each is from the truth over time.
pub(super) fn trajectories(
    models: &[String],
    detail: &DetailedTrial,
    truth: &str,
) -> Result<String, DrawError> {
    let true_poses: Vec<Option<Pose2>> = detail.drive.steps.iter().map(|s| s.reference).collect();
    let truth_line = points(true_poses.iter().flatten().copied());
    let bounds = Window::around(detail.walls.iter().flatten().chain(&truth_line));
    let (right, top, below) = MARGINS;
    let [width, height] = bounds.size();
    let plot_width = f64::from(WIDTH) - LEFT - right;
    let map_height = (plot_width * 1.06 * height / width.max(1e-9)).clamp(130.0, 620.0) + top + below;
    let window = bounds.with_aspect(aspect(f64::from(WIDTH), map_height));

    let start = detail.drive.steps.first().map_or(0.0, |s| s.stamp_secs);
    let distances = |poses: &[Pose2]| -> Vec<(f64, f64)> {
        let steps = detail.drive.steps.iter().zip(poses);
        steps
            .filter_map(|(step, pose)| {
                let distance = step.reference?.position().distance(pose.position());
                Some((step.stamp_secs - start, distance))
            })
            .collect()
    };
    let mut lines = vec![(DEAD_RECKONING, &detail.dead_reckoning)];
    lines.extend(detail.models.iter().map(|m| (model_color(models, &m.name), &m.most_likely_trajectory)));
    let errors: Vec<Vec<(f64, f64)>> = lines.iter().map(|(_, poses)| distances(poses)).collect();
    let values = errors.iter().flatten().map(|e| e.1);
    let y =
        Axis::logarithmic(&format!("distance to the {truth} [m]"), 1e-3, 1.2 * values.fold(1e-2, f64::max));
    let x = Axis::linear("time [s]", 0.0, errors.iter().flatten().map(|e| e.0).fold(0.0, f64::max), 8.0);

    let mut legend = vec![
        (truth.to_owned(), Mark::Area(TRUTH)),
        ("dead reckoning".to_owned(), Mark::Line(DEAD_RECKONING)),
    ];
    legend.extend(detail.models.iter().map(|m| (m.name.clone(), Mark::Line(model_color(models, &m.name)))));
    let first_blocks = detail.blocks.first().map_or(&[][..], Vec::as_slice);
    if !first_blocks.is_empty() {
        legend.push(("blocks at the first scan, not in the filter's map".to_owned(), Mark::Area(UNKNOWN)));
    }
    figure("Trajectories of the recorded trial", &legend, map_height + 260.0, |area| {
        let (map_area, time_area) = area.split_vertically(px(map_height));
        let mut panel = MapPanel::new(&map_area, window, [10.0, map_height / 60.0])?;
        panel.map(&join(&detail.walls), first_blocks)?;
        panel.line(&truth_line, line(TRUTH, 7.0))?;
        for (color, poses) in &lines {
            panel.line(&points(poses.iter().copied()), line(*color, 1.5))?;
        }
        let mut chart = chart(&time_area, &x, &y, LEFT)?;
        for ((color, _), errors) in lines.iter().zip(&errors) {
            chart.draw_series([PathElement::new(errors.clone(), line(*color, 1.5))])?;
        }
        Ok(())
    })
}

/// The paper's Fig. 10: the filter under one model at four steps of the drive. At the left the robot's surroundings
/// with the scan; at the right the particles close up, darker with more weight.
pub(super) fn snapshots(
    models: &[String],
    detail: &DetailedTrial,
    model: &DetailedModel,
    truth: &str,
) -> Result<String, DrawError> {
    const ROW: f64 = 304.0;
    const CLOSE_UP: f64 = 330.0;
    const TITLE: f64 = 30.0;
    let last = model.steps.len().min(detail.drive.steps.len()).saturating_sub(1);
    let mut steps: Vec<usize> = (0..4).map(|i| i * last / 3).collect();
    steps.dedup();
    if model.steps.is_empty() || detail.drive.steps.is_empty() {
        steps.clear();
    }
    let walls = join(&detail.walls);
    let bounds = Window::around(detail.walls.iter().flatten());
    let bounds = Window::centered(bounds.middle(), bounds.size().map(|side| 1.06 * side));
    let color = model_color(models, &model.name);
    let legend = [
        (truth.to_owned(), Mark::Ring(INK)),
        ("particles".to_owned(), Mark::Dot(color)),
        (format!("readings, drawn from the {truth}"), Mark::Dot(READING)),
    ];
    let mut legend = legend.to_vec();
    if detail.blocks.iter().any(|blocks| !blocks.is_empty()) {
        legend.push(("blocks, not in the filter's map".to_owned(), Mark::Area(UNKNOWN)));
    }
    let title = format!("The filter with {} at {} steps of the recorded trial", model.name, steps.len());
    figure(&title, &legend, ROW * steps.len() as f64, |area| {
        for (row, &step) in area.split_evenly((steps.len().max(1), 1)).iter().zip(&steps) {
            let (at, seen) = (&model.steps[step], &detail.drive.steps[step]);
            let pose = seen.reference.unwrap_or(at.estimate);
            let blocks = detail.blocks.get(step).map_or(&[][..], Vec::as_slice);
            let label = format!(
                "step {step}, {:.1} s: effective sample size {:.0}",
                seen.stamp_secs - detail.drive.steps[0].stamp_secs,
                at.effective_sample_size
            );
            row.draw(&Text::new(label, (px(LEFT), px(12.0)), text(HEADING, INK)))?;
            let (_, row) = row.split_vertically(px(TITLE));
            let (wide, close) = row.split_horizontally(px(f64::from(WIDTH) - CLOSE_UP));

            let height = bounds.size()[1].clamp(3.0, 14.0);
            let size = [height * aspect(f64::from(WIDTH) - CLOSE_UP, ROW - TITLE), height];
            let mut panel = MapPanel::new(&wide, bounds.part_around([pose.x, pose.y], size), [8.0, 4.0])?;
            panel.map(&walls, blocks)?;
            draw_scan(&mut panel, &detail.drive, step, pose)?;
            draw_particles(&mut panel, at, 1.5, color)?;
            panel.pose(pose, 0.06 * height, INK)?;

            let size = close_up(at, pose);
            let square = [size * aspect(CLOSE_UP, ROW - TITLE), size];
            let mut panel = MapPanel::new(&close, Window::centered([pose.x, pose.y], square), [3.0, 4.0])?;
            panel.map(&walls, blocks)?;
            draw_particles(&mut panel, at, 2.5, color)?;
            panel.pose(pose, 0.12 * size, INK)?;
        }
        Ok(())
    })
}

/// Height of a window around the true pose that shows all but the furthest particles (m).
fn close_up(step: &DetailedStep, pose: Pose2) -> f64 {
    let mut distances: Vec<f64> =
        step.particles.iter().map(|p| p.position().distance(pose.position())).collect();
    distances.sort_by(f64::total_cmp);
    (2.3 * quantile(&distances, 0.98)).clamp(0.1, 10.0)
}

fn draw_scan(panel: &mut MapPanel<'_, '_>, drive: &Drive, step: usize, pose: Pose2) -> Drawn {
    let laser = pose.compose(&drive.laser.base_from_laser());
    let readings = drive.steps[step].scan.ranges.iter().zip(drive.laser.bearings());
    // A reading at the maximum range or without a value has no end to draw.
    let ends: Vec<Point> = readings
        .filter(|(range, _)| **range < drive.laser.max_range())
        .map(|(&range, &bearing)| {
            let heading = laser.theta + f64::from(bearing);
            [laser.x + f64::from(range) * heading.cos(), laser.y + f64::from(range) * heading.sin()]
        })
        .collect();
    for end in &ends {
        panel.line(&[[laser.x, laser.y], *end], line(READING.mix(0.25), 0.75))?;
    }
    for end in &ends {
        panel.dot(*end, 2.0, READING.filled())?;
    }
    Ok(())
}

fn draw_particles(
    panel: &mut MapPanel<'_, '_>,
    step: &DetailedStep,
    radius_px: f64,
    color: RGBColor,
) -> Drawn {
    let heaviest = step.weights.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let stride = step.particles.len().div_ceil(PARTICLES).max(1);
    let mut particles: Vec<(Pose2, f64)> =
        step.particles.iter().zip(step.weights.iter().map(|w| w / heaviest)).step_by(stride).collect();
    // The heaviest on top.
    particles.sort_by(|a, b| a.1.total_cmp(&b.1));
    for (pose, weight) in particles {
        // Two decimals of opacity are enough and keep the file small.
        let opacity = (100.0 * (0.2 + 0.8 * weight.sqrt())).round() / 100.0;
        panel.dot([pose.x, pose.y], radius_px, color.mix(opacity).filled())?;
    }
    Ok(())
}
