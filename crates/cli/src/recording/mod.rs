//! Turns one trial in full, or a search for what a simulation lacks, into a rerun recording with a prepared layout. The
//! only module that names rerun.
//!
//! Rerun's 2D view has y down. The entities `world`, `close_up/MODEL` and `beam_density` carry a transform that flips it, so that
//! every logged coordinate stays in the map frame (x forward, y left) and y points up on the screen. A view applies the
//! transforms below its origin alone: its origin is the parent of the entity that flips.

mod gap;

use std::path::Path;

use locsim_core::{DriveStep, Laser, Pose2};
use locsim_report::palette;
use locsim_report::results::{BeamProbe, DetailedModel, DetailedStep, DetailedTrial};
use rerun::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Grid, Horizontal, SelectionPanel, Spatial2DView, Tabs,
    TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
    components::{PanelState, PlayState},
};
use rerun::{RecordingStream, RecordingStreamBuilder, RecordingStreamResult};

pub use gap::record as record_gap;

/// Where a recording goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sink<'a> {
    /// A `.rrd` file.
    File(&'a Path),
    /// A viewer that already listens on this machine (rerun's default port).
    Connect,
    /// A viewer started for it (needs `rerun` on the path).
    Spawn,
}

// Seen on the dark sheet beneath.
const TRUTH: [u8; 3] = [0xff, 0xff, 0xff];
const WALL: [u8; 3] = [0xc8, 0xc8, 0xc8];
const BLOCK: [u8; 3] = [0x80, 0x80, 0x80];
const READING: [u8; 3] = [0x8f, 0xc7, 0xe8];
const NO_RETURN: [u8; 3] = [0x50, 0x50, 0x50];

/// The sheet beneath maps and plots: the viewer's own background may be light.
const SHEET: [u8; 3] = [0x11, 0x13, 0x17];
/// Room around what lies on a sheet, as a share of its longer side.
const MARGIN: f64 = 0.05;

/// Order of drawing, the greatest on top: estimates lie over the truth, which would hide them.
mod order {
    pub const SHEET: f32 = -1000.0;
    pub const MAP: f32 = 1.0;
    pub const SCAN: f32 = 2.0;
    pub const ODOMETRY: f32 = 3.0;
    pub const TRUTH: f32 = 4.0;
    pub const PARTICLES: f32 = 5.0;
    pub const ESTIMATE: f32 = 6.0;
}

/// Bounds of half of the side of a close-up \[m\].
const CLOSE_M: std::ops::RangeInclusive<f64> = 0.2..=5.0;
/// On the whole floor every fourth particle is drawn. A close-up has them all.
const FLOOR_STRIDE: usize = 4;

/// Length at which a beam without a return is drawn \[m\].
const STUB_M: f64 = 0.3;

/// Writes one trial, all models side by side on one timeline.
///
/// # Errors
/// rerun's error when the file can't be written or the viewer can't be reached.
pub fn record(trial: &DetailedTrial, scenario: &str, sink: Sink<'_>) -> anyhow::Result<()> {
    let builder =
        RecordingStreamBuilder::new("locsim").recording_name(scenario).with_blueprint(layout(trial));
    let stream = match sink {
        Sink::File(path) => builder.save(path)?,
        Sink::Connect => builder.connect_grpc()?,
        Sink::Spawn => builder.spawn()?,
    };
    // Wall-clock timelines mean nothing for a replay.
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    log_static(&stream, trial)?;
    let reach = reach(trial);
    for (i, step) in trial.drive.steps.iter().enumerate() {
        stream.set_time_sequence("step", i as i64);
        stream.set_duration_secs("time", step.stamp_secs - trial.drive.steps[0].stamp_secs);
        log_world(&stream, trial, i, step)?;
        for model in &trial.models {
            log_model(&stream, trial, model, i, step)?;
            log_close_up(&stream, trial, model, i, reach)?;
        }
    }
    Ok(stream.flush_blocking()?)
}

/// The 95 % quantile of chi-square with two degrees of freedom.
const CHI_SQUARE_95: f64 = 5.991;

/// Half of the side of a close-up \[m\], in which particles can be told apart: twice the usual distance from the robot to the
/// far side of its ellipse.
fn reach(trial: &DetailedTrial) -> f64 {
    let steps = trial.models.iter().flat_map(|model| trial.drive.steps.iter().zip(&model.steps));
    let mut far: Vec<f64> = steps
        .map(|(drive_step, step)| {
            let [[xx, _], [_, yy]] = step.position_covariance;
            let error =
                drive_step.reference.map_or(0.0, |pose| step.estimate.position().distance(pose.position()));
            error + (CHI_SQUARE_95 * (xx + yy)).sqrt()
        })
        .collect();
    far.sort_by(f64::total_cmp);
    let usual = far.get(far.len() / 2).copied().unwrap_or(1.0);
    (2.0 * usual).clamp(*CLOSE_M.start(), *CLOSE_M.end())
}

/// Whether a map is so much wider than high that maps belong above each other.
fn is_wide(walls: &[[[f64; 2]; 2]]) -> bool {
    let spread = |axis: usize| {
        let values = walls.iter().flatten().map(|p| p[axis]);
        values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
    };
    spread(0) > 2.5 * spread(1)
}

/// Turns y up on the screen.
fn upright() -> rerun::Transform3D {
    rerun::Transform3D::from_scale([1.0, -1.0, 1.0])
}

/// To the left a close-up for each model that follows the robot, and the whole floor; time series and the beam's density to the
/// right.
fn layout(trial: &DetailedTrial) -> Blueprint {
    let side = 2.0 * reach(trial);
    let close_up = |model: &DetailedModel| -> ContainerLike {
        let title = format!("{} ({side:.1} m)", model.name);
        let content = format!("/close_up/{}/**", model.name);
        Spatial2DView::new(title).with_origin("/close_up").with_contents([content]).into()
    };
    let columns = if trial.models.len() > 4 { 3 } else { 2 };
    let close_ups = Grid::new(trial.models.iter().map(close_up).collect::<Vec<ContainerLike>>())
        .with_grid_columns(columns);
    let floor = Spatial2DView::new("The whole floor").with_origin("/").with_contents(["/world/**"]).into();
    let maps = Vertical::new([close_ups.into(), floor]).with_row_shares([2.0, 1.0]);
    let series = |title: &str, origin: &str| -> ContainerLike {
        TimeSeriesView::new(title).with_origin(origin.to_owned()).into()
    };
    let side = Vertical::new([
        series("Position error of the weighted mean [m]", "/error/position"),
        series("Heading error of the weighted mean [deg]", "/error/heading"),
        series("Effective sample size", "/effective_sample_size"),
        Spatial2DView::new("One beam: predicted density over range, and its reading")
            .with_origin("/")
            .with_contents(["/beam_density/**"])
            .into(),
        Tabs::new([
            TextDocumentView::new("Legend").with_origin("/legend").into(),
            TextLogView::new("Events").with_origin("/events").into(),
            series("Log evidence [nats]", "/log_evidence"),
        ])
        .into(),
    ])
    .with_row_shares([1.0, 0.8, 0.8, 1.2, 1.2]);
    Blueprint::new(Horizontal::new([maps.into(), side.into()]).with_column_shares([1.5, 1.0]))
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(
            TimePanel::new()
                .with_state(PanelState::Collapsed)
                .with_timeline("step")
                .with_play_state(PlayState::Following),
        )
}

fn log_static(stream: &RecordingStream, trial: &DetailedTrial) -> RecordingStreamResult<()> {
    stream.log_static("world", &upright())?;
    let walls = trial.walls.iter().map(|wall| wall.map(point));
    stream.log_static(
        "world/map",
        &rerun::LineStrips2D::new(walls)
            .with_colors([color(WALL)])
            .with_draw_order(order::MAP)
            .with_radii([rerun::Radius::new_ui_points(1.2)]),
    )?;
    let ends = || trial.walls.iter().flatten();
    let bound =
        |axis: usize, pick: fn(f64, f64) -> f64| ends().map(|end| end[axis]).reduce(pick).unwrap_or_default();
    let floor = [[bound(0, f64::min), bound(1, f64::min)], [bound(0, f64::max), bound(1, f64::max)]];
    log_sheet(stream, "world/sheet", floor)?;
    stream.log_static(
        "legend",
        &rerun::TextDocument::from_markdown(
            "Each close-up shows one sensor model's filter around the robot, on the same drive; its title says how wide it is.\n\n\
             - white: true (or reference) path and pose; grey line: odometry alone\n\
             - grey rectangles: clutter that stood there, **not known to the filter**\n\
             - points: particles, dim to strong by weight\n\
             - thin line in the model's colour: most likely trajectory (found at the end of the drive)\n\
             - light blue points: where the readings end, from the true pose\n\
             - ellipse: 95 % of the particles' position covariance\n\
             - beams: log likelihood of the reading at the true pose, red (unexpected) to blue (expected); \
             grey stubs: beams without a return\n",
        ),
    )?;
    let reach = reach(trial);
    for model in &trial.models {
        let rgb = palette::of_model(&trial.labels, &model.name);
        let line = rerun::SeriesLines::new()
            .with_colors([color(rgb)])
            .with_names([model.name.as_str()])
            .with_widths([1.5]);
        for plot in ["error/position", "error/heading", "effective_sample_size", "log_evidence"] {
            stream.log_static(format!("{plot}/{}", model.name), &line)?;
        }
        let path = model.most_likely_trajectory.iter().map(pose_point);
        stream.log_static(
            format!("world/models/{}/most_likely_trajectory", model.name),
            &rerun::LineStrips2D::new([path.collect::<Vec<_>>()])
                .with_colors([color(rgb)])
                .with_draw_order(order::ESTIMATE)
                .with_radii([rerun::Radius::new_ui_points(1.0)]),
        )?;
        let close_up = format!("close_up/{}", model.name);
        stream.log_static(close_up.as_str(), &upright())?;
        log_sheet(stream, &format!("{close_up}/sheet"), [[-reach; 2], [reach; 2]])?;
    }
    log_density_axes(stream, trial)
}

/// Most points of a path that is logged at each step, and its last one. With all of them a recording would grow with the square of its steps.
const PATH_POINTS: usize = 500;

/// The steps up to one, and evenly spaced ones where they are many, that its path is drawn through.
fn driven(step: usize) -> impl Iterator<Item = usize> {
    (0..step).step_by(step.div_ceil(PATH_POINTS).max(1)).chain([step])
}

fn log_world(
    stream: &RecordingStream,
    trial: &DetailedTrial,
    i: usize,
    step: &DriveStep,
) -> RecordingStreamResult<()> {
    if let Some(blocks) = trial.blocks.get(i) {
        let outlines = blocks.iter().map(|c| [0, 1, 2, 3, 0].map(|corner| point(c[corner])));
        stream.log(
            "world/blocks",
            &rerun::LineStrips2D::new(outlines)
                .with_colors([color(BLOCK)])
                .with_draw_order(order::MAP)
                .with_radii([rerun::Radius::new_ui_points(1.5)]),
        )?;
    }
    let truth = driven(i).filter_map(|i| trial.drive.steps[i].reference.as_ref().map(pose_point)).collect();
    stream.log("world/truth/path", &path(truth, TRUTH).with_draw_order(order::TRUTH))?;
    stream.log(
        "world/odometry/path",
        &path(driven(i).map(|i| pose_point(&trial.dead_reckoning[i])).collect(), palette::DEAD_RECKONING)
            .with_draw_order(order::ODOMETRY),
    )?;
    if let Some(pose) = &step.reference {
        stream.log("world/scan", &ends(&trial.drive.laser, step, pose))?;
        stream.log("world/truth/pose", &arrow(pose, 0.5, TRUTH).with_draw_order(order::TRUTH))?;
    }
    Ok(())
}

fn log_model(
    stream: &RecordingStream,
    trial: &DetailedTrial,
    model: &DetailedModel,
    i: usize,
    drive_step: &DriveStep,
) -> RecordingStreamResult<()> {
    let step = &model.steps[i];
    let at = |part: &str| format!("world/models/{}/{part}", model.name);
    let rgb = palette::of_model(&trial.labels, &model.name);

    stream.log(at("particles"), &particles(step, FLOOR_STRIDE, Pose2::IDENTITY, f64::INFINITY, rgb))?;
    stream.log(at("estimate"), &arrow(&step.estimate, 0.5, rgb).with_draw_order(order::ESTIMATE))?;
    if let Some(pose) = &drive_step.reference {
        let error = step.estimate.relative_to(pose);
        let scalar = |value: f64| rerun::Scalars::new([value]);
        stream.log(format!("error/position/{}", model.name), &scalar(error.position().length()))?;
        stream.log(format!("error/heading/{}", model.name), &scalar(error.theta.to_degrees()))?;
    }
    let series =
        [("effective_sample_size", step.effective_sample_size), ("log_evidence", step.log_evidence_nats)];
    for (plot, value) in series {
        stream.log(format!("{plot}/{}", model.name), &rerun::Scalars::new([value]))?;
    }
    log_probe(stream, trial, model, i, rgb)?;
    for event in &step.events {
        stream
            .log("events", &rerun::TextLog::new(format!("{}: {event}", model.name)).with_color(color(rgb)))?;
    }
    Ok(())
}

/// The surroundings of the robot by one model's filter, in a frame that moves with it and keeps the map's directions.
fn log_close_up(
    stream: &RecordingStream,
    trial: &DetailedTrial,
    model: &DetailedModel,
    i: usize,
    reach: f64,
) -> RecordingStreamResult<()> {
    let (step, drive_step) = (&model.steps[i], &trial.drive.steps[i]);
    let at = |part: &str| format!("close_up/{}/{part}", model.name);
    let rgb = palette::of_model(&trial.labels, &model.name);
    let robot = drive_step.reference.unwrap_or(step.estimate);
    let center = Pose2::new(robot.x, robot.y, 0.0);
    let local = |pose: &Pose2| Pose2::new(pose.x - center.x, pose.y - center.y, pose.theta);
    let walls =
        trial.walls.iter().filter_map(|wall| clipped(wall.map(|[x, y]| [x - center.x, y - center.y]), reach));
    stream.log(
        at("map"),
        &rerun::LineStrips2D::new(walls.map(|wall| wall.map(point)))
            .with_colors([color(WALL)])
            .with_draw_order(order::MAP)
            .with_radii([rerun::Radius::new_ui_points(1.5)]),
    )?;
    stream.log(at("particles"), &particles(step, 1, center, reach, rgb))?;
    stream.log(at("covariance"), &ellipse(step, center, rgb).with_draw_order(order::ESTIMATE))?;
    stream.log(
        at("estimate"),
        &arrow(&local(&step.estimate), 0.3 * reach, rgb).with_draw_order(order::ESTIMATE),
    )?;
    if let Some(pose) = &drive_step.reference {
        stream.log(
            at("scan"),
            &scan(&trial.drive.laser, drive_step, pose, (center, reach), step).with_draw_order(order::SCAN),
        )?;
        stream.log(at("truth"), &arrow(&local(pose), 0.3 * reach, TRUTH).with_draw_order(order::TRUTH))?;
    }
    Ok(())
}

/// The part of a segment within the square of a close-up (Liang and Barsky).
fn clipped([a, b]: [[f64; 2]; 2], reach: f64) -> Option<[[f64; 2]; 2]> {
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    for axis in 0..2 {
        let step = b[axis] - a[axis];
        if step == 0.0 {
            if a[axis].abs() > reach {
                return None;
            }
            continue;
        }
        let [near, far] = [-reach * step.signum(), reach * step.signum()].map(|side| (side - a[axis]) / step);
        (from, to) = (from.max(near), to.min(far));
    }
    let at = |share: f64| [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    (from < to).then(|| [at(from), at(to)])
}

/// A dark sheet beneath a rectangle, given by its lower and its upper corner \[m\]: an image of one pixel.
fn log_sheet(stream: &RecordingStream, at: &str, [low, high]: [[f64; 2]; 2]) -> RecordingStreamResult<()> {
    let margin = MARGIN * (high[0] - low[0]).max(high[1] - low[1]);
    let corner = low.map(|value| (value - margin) as f32);
    let size = [0, 1].map(|axis| (high[axis] - low[axis] + 2.0 * margin) as f32);
    let place =
        rerun::Transform3D::from_translation_scale([corner[0], corner[1], 0.0], [size[0], size[1], 1.0]);
    stream.log_static(at, &place)?;
    let image = rerun::Image::from_rgb24(SHEET.to_vec(), [1, 1]).with_draw_order(order::SHEET);
    stream.log_static(at, &image)
}

/// Height of the densities' plot over its width.
const PLOT_ASPECT: f64 = 0.35;

/// The sheet and the axis of ranges beneath the curves, which have the models' colours.
fn log_density_axes(stream: &RecordingStream, trial: &DetailedTrial) -> RecordingStreamResult<()> {
    let most = f64::from(trial.drive.laser.max_range());
    let line = most / 12.0;
    let top = PLOT_ASPECT * most;
    stream.log_static("beam_density", &upright())?;
    log_sheet(stream, "beam_density/sheet", [[0.0, -line], [most, top]])?;
    stream.log_static("beam_density/axis/line", &path(vec![point([0.0, 0.0]), point([most, 0.0])], WALL))?;
    let ticks = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| share * most);
    stream.log_static(
        "beam_density/axis/ticks",
        &rerun::Points2D::new(ticks.map(|range| point([range, 0.0])))
            .with_labels(ticks.map(|range| format!("{range:.1} m")))
            .with_show_labels(true)
            .with_colors([color(WALL)])
            .with_radii([rerun::Radius::new_ui_points(2.0)]),
    )?;
    Ok(())
}

/// The density of one beam as a line, as high as its peak, and its reading.
fn log_probe(
    stream: &RecordingStream,
    trial: &DetailedTrial,
    model: &DetailedModel,
    i: usize,
    rgb: [u8; 3],
) -> RecordingStreamResult<()> {
    let BeamProbe { z_m, density_per_m, reading_m, .. } = &model.steps[i].probe;
    let height = PLOT_ASPECT * f64::from(trial.drive.laser.max_range());
    // All models at one scale.
    let all = trial.models.iter().flat_map(|model| &model.steps[i].probe.density_per_m);
    let peak = all.copied().fold(f32::MIN_POSITIVE, f32::max);
    let scale = height / f64::from(peak);
    let curve = z_m.iter().zip(density_per_m);
    let curve = curve.map(|(&z, &density)| point([f64::from(z), scale * f64::from(density)]));
    stream.log(
        format!("beam_density/{}", model.name),
        &path(curve.collect(), rgb).with_draw_order(order::ESTIMATE),
    )?;
    let reading = f64::from(*reading_m);
    stream.log(
        "beam_density/reading",
        &path(vec![point([reading, 0.0]), point([reading, height])], TRUTH).with_draw_order(order::TRUTH),
    )
}

/// Particles within `reach` of a frame's origin, every `stride`th.
fn particles(step: &DetailedStep, stride: usize, frame: Pose2, reach: f64, rgb: [u8; 3]) -> rerun::Points2D {
    let heaviest = step.weights.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let place = |pose: Pose2| [pose.x - frame.x, pose.y - frame.y];
    let seen = step.particles.iter().zip(&step.weights).step_by(stride);
    let seen = seen.map(|(pose, weight)| (place(pose), weight));
    let near = seen.filter(|([x, y], _)| x.abs().max(y.abs()) <= reach);
    // The square root keeps light particles visible beside a few heavy ones.
    let drawn = near.map(|(place, weight)| (point(place), blend([0x40; 3], rgb, (weight / heaviest).sqrt())));
    let (points, colors): (Vec<_>, Vec<_>) = drawn.unzip();
    rerun::Points2D::new(points)
        .with_colors(colors)
        .with_draw_order(order::PARTICLES)
        .with_radii([rerun::Radius::new_ui_points(if reach.is_finite() { 2.5 } else { 1.5 })])
}

/// Where readings end, from the true pose.
fn ends(laser: &Laser, step: &DriveStep, pose: &Pose2) -> rerun::Points2D {
    let at = pose.compose(&laser.base_from_laser());
    let returned =
        step.scan.ranges.iter().zip(laser.bearings()).filter(|(range, _)| **range < laser.max_range());
    let end = |(&range, &bearing): (&f32, &f32)| {
        let (range, direction) = (f64::from(range), at.theta + f64::from(bearing));
        point([at.x + range * direction.cos(), at.y + range * direction.sin()])
    };
    rerun::Points2D::new(returned.map(end))
        .with_colors([color(READING)])
        .with_draw_order(order::SCAN)
        .with_radii([rerun::Radius::new_ui_points(2.0)])
}

/// Readings as rays from the true pose, coloured by their log density under the model; beams without a return as
/// stubs, as their probability is that of a point and no density.
fn scan(
    laser: &Laser,
    drive_step: &DriveStep,
    pose: &Pose2,
    (center, reach): (Pose2, f64),
    step: &DetailedStep,
) -> rerun::LineStrips2D {
    let map_from_laser = pose.compose(&laser.base_from_laser());
    let [x, y] = [map_from_laser.x - center.x, map_from_laser.y - center.y];
    let mut rays = Vec::new();
    let mut colors = Vec::new();
    for ((&range, &bearing), &log_density) in
        drive_step.scan.ranges.iter().zip(laser.bearings()).zip(&step.beam_log_density)
    {
        if range.is_nan() {
            continue;
        }
        let returned = range < laser.max_range();
        let length = if returned { f64::from(range) } else { STUB_M };
        let direction = map_from_laser.theta + f64::from(bearing);
        let ray = [[x, y], [x + length * direction.cos(), y + length * direction.sin()]];
        let Some(ray) = clipped(ray, reach) else { continue };
        rays.push(ray.map(point));
        // -4 nats (improbable) to 3 nats (a peak some centimetres wide).
        let share = f64::from((log_density + 4.0) / 7.0);
        let by_density = blend([0xd5, 0x3e, 0x4f], [0x32, 0x88, 0xbd], share);
        colors.push(if returned { by_density } else { color(NO_RETURN) });
    }
    rerun::LineStrips2D::new(rays).with_colors(colors).with_radii([rerun::Radius::new_ui_points(0.5)])
}

/// The ellipse that holds 95 % of a Gaussian with the particles' covariance.
fn ellipse(step: &DetailedStep, center: Pose2, rgb: [u8; 3]) -> rerun::LineStrips2D {
    let [[xx, xy], [_, yy]] = step.position_covariance;
    let mean = 0.5 * (xx + yy);
    let spread = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    let [a, b] = [mean + spread, mean - spread].map(|variance| (CHI_SQUARE_95 * variance.max(0.0)).sqrt());
    let outline = (0..=48).map(|i| {
        let t = f64::from(i) * std::f64::consts::TAU / 48.0;
        let (u, v) = (a * t.cos(), b * t.sin());
        point([
            step.estimate.x - center.x + u * angle.cos() - v * angle.sin(),
            step.estimate.y - center.y + u * angle.sin() + v * angle.cos(),
        ])
    });
    path(outline.collect(), rgb)
}

fn path(points: Vec<[f32; 2]>, rgb: [u8; 3]) -> rerun::LineStrips2D {
    rerun::LineStrips2D::new([points])
        .with_colors([color(rgb)])
        .with_radii([rerun::Radius::new_ui_points(1.0)])
}

fn arrow(pose: &Pose2, length_m: f64, rgb: [u8; 3]) -> rerun::Arrows2D {
    let vector = point([length_m * pose.theta.cos(), length_m * pose.theta.sin()]);
    rerun::Arrows2D::from_vectors([vector])
        .with_origins([pose_point(pose)])
        .with_colors([color(rgb)])
        .with_radii([rerun::Radius::new_ui_points(2.0)])
}

/// The border between the laboratory's f64 metres and the recording's f32.
fn point(p: [f64; 2]) -> [f32; 2] {
    [p[0] as f32, p[1] as f32]
}

fn pose_point(pose: &Pose2) -> [f32; 2] {
    point([pose.x, pose.y])
}

fn color([r, g, b]: [u8; 3]) -> rerun::Color {
    rerun::Color::from_rgb(r, g, b)
}

/// `from` at 0, `to` at 1.
fn blend(from: [u8; 3], to: [u8; 3], share: f64) -> rerun::Color {
    let share = share.clamp(0.0, 1.0);
    let channel = |i: usize| (f64::from(from[i]) * (1.0 - share) + f64::from(to[i]) * share).round() as u8;
    rerun::Color::from_rgb(channel(0), channel(1), channel(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All steps of a short drive, some of a long one, and always the last.
    #[test]
    fn a_path_has_its_last_point_and_not_too_many() {
        assert_eq!(driven(0).collect::<Vec<_>>(), [0]);
        assert_eq!(driven(3).collect::<Vec<_>>(), [0, 1, 2, 3]);
        for step in [500, 501, 999, 36_000] {
            let path: Vec<usize> = driven(step).collect();
            assert!((PATH_POINTS / 2..=PATH_POINTS + 1).contains(&path.len()), "{step}: {}", path.len());
            assert_eq!(path.last(), Some(&step));
        }
    }
}
