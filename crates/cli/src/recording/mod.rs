//! Turns one trial in full, or a search for what a simulation lacks, into a rerun recording with a prepared layout. The
//! only module that names rerun.
//!
//! Rerun's 2D view has y down; the entity `world` carries a transform that flips it, so every logged
//! coordinate stays in the map frame (x forward, y left) and y points up on the screen.

mod gap;

use std::path::Path;

use locsim_core::{DriveStep, Laser, Pose2};
use locsim_report::palette;
use locsim_report::results::{BeamProbe, DetailedModel, DetailedStep, DetailedTrial};
use rerun::blueprint::{
    BarChartView, Blueprint, BlueprintPanel, ContainerLike, Grid, Horizontal, SelectionPanel, Spatial2DView,
    Tabs, TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical,
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

// Seen on the viewer's dark background.
const TRUTH: [u8; 3] = [0xff, 0xff, 0xff];
const ODOMETRY: [u8; 3] = [0x70, 0x70, 0x70];
const WALL: [u8; 3] = [0xc8, 0xc8, 0xc8];
const BLOCK: [u8; 3] = [0x80, 0x80, 0x80];
const NO_RETURN: [u8; 3] = [0x50, 0x50, 0x50];

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
    for (i, step) in trial.drive.steps.iter().enumerate() {
        stream.set_time_sequence("step", i as i64);
        stream.set_duration_secs("time", step.stamp_secs - trial.drive.steps[0].stamp_secs);
        log_world(&stream, trial, i, step)?;
        for (m, model) in trial.models.iter().enumerate() {
            log_model(&stream, trial, m, model, i, step)?;
        }
    }
    Ok(stream.flush_blocking()?)
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

/// Maps to the left, one per model; time series and the beam's density to the right.
fn layout(trial: &DetailedTrial) -> Blueprint {
    let wide = is_wide(&trial.walls);
    let maps = trial.models.iter().map(|model| {
        let shared = ["map", "blocks", "truth", "odometry"].map(|part| format!("/world/{part}/**"));
        Spatial2DView::new(&model.name)
            .with_origin("/world")
            .with_contents(shared.into_iter().chain([format!("/world/models/{}/**", model.name)]))
            .into()
    });
    let maps = Grid::new(maps.collect::<Vec<ContainerLike>>()).with_grid_columns(if wide { 1 } else { 3 });
    let series = |title: &str, origin: &str| -> ContainerLike {
        TimeSeriesView::new(title).with_origin(origin.to_owned()).into()
    };
    let side = Vertical::new([
        series("Position error of the weighted mean [m]", "/error/position"),
        series("Heading error of the weighted mean [deg]", "/error/heading"),
        series("Effective sample size", "/effective_sample_size"),
        BarChartView::new("One beam: predicted density [1/m] over range, and its reading")
            .with_origin("/beam_density")
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
            .with_radii([rerun::Radius::new_ui_points(1.2)]),
    )?;
    stream.log_static(
        "legend",
        &rerun::TextDocument::from_markdown(
            "Each map shows one sensor model's filter on the same drive.\n\n\
             - white: true (or reference) path and pose; grey line: odometry alone\n\
             - grey rectangles: blocks that stood there, **not known to the filter**\n\
             - points: particles, dim to strong by weight\n\
             - thin line in the model's colour: most likely trajectory (found at the end of the drive)\n\
             - ellipse: 95 % of the particles' position covariance\n\
             - beams: log likelihood of the reading at the true pose, red (unexpected) to blue (expected); \
             grey stubs: beams without a return\n",
        ),
    )?;
    for (m, model) in trial.models.iter().enumerate() {
        let line = rerun::SeriesLines::new()
            .with_colors([color(palette::rgb(m))])
            .with_names([model.name.as_str()])
            .with_widths([1.5]);
        for plot in ["error/position", "error/heading", "effective_sample_size", "log_evidence"] {
            stream.log_static(format!("{plot}/{}", model.name), &line)?;
        }
        let path = model.most_likely_trajectory.iter().map(pose_point);
        stream.log_static(
            format!("world/models/{}/most_likely_trajectory", model.name),
            &rerun::LineStrips2D::new([path.collect::<Vec<_>>()])
                .with_colors([color(palette::rgb(m))])
                .with_radii([rerun::Radius::new_ui_points(1.0)]),
        )?;
    }
    Ok(())
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
                .with_radii([rerun::Radius::new_ui_points(1.5)]),
        )?;
    }
    let truth: Vec<_> =
        trial.drive.steps[..=i].iter().filter_map(|s| s.reference.as_ref().map(pose_point)).collect();
    stream.log("world/truth/path", &path(truth, TRUTH))?;
    stream.log(
        "world/odometry/path",
        &path(trial.dead_reckoning[..=i].iter().map(pose_point).collect(), ODOMETRY),
    )?;
    if let Some(pose) = &step.reference {
        stream.log("world/truth/pose", &arrow(pose, 0.5, TRUTH))?;
    }
    Ok(())
}

fn log_model(
    stream: &RecordingStream,
    trial: &DetailedTrial,
    m: usize,
    model: &DetailedModel,
    i: usize,
    drive_step: &DriveStep,
) -> RecordingStreamResult<()> {
    let step = &model.steps[i];
    let at = |part: &str| format!("world/models/{}/{part}", model.name);
    let rgb = palette::rgb(m);

    stream.log(at("particles"), &particles(step, rgb))?;
    stream.log(at("estimate"), &arrow(&step.estimate, 0.5, rgb))?;
    stream.log(at("covariance"), &ellipse(step, rgb))?;
    if let Some(pose) = &drive_step.reference {
        stream.log(at("scan"), &scan(&trial.drive.laser, drive_step, pose, step))?;
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
    log_probe(stream, &model.name, &step.probe, rgb)?;
    for event in &step.events {
        stream
            .log("events", &rerun::TextLog::new(format!("{}: {event}", model.name)).with_color(color(rgb)))?;
    }
    Ok(())
}

/// The density of one beam as bars, and its reading as a bar of its own.
fn log_probe(
    stream: &RecordingStream,
    model: &str,
    probe: &BeamProbe,
    rgb: [u8; 3],
) -> RecordingStreamResult<()> {
    if probe.z_m.len() < 2 {
        return Ok(());
    }
    let bars = |values: &[f32], abscissa: &[f32], width: f32, rgb| {
        rerun::BarChart::new(values.to_vec())
            .with_abscissa(abscissa.to_vec())
            .with_widths(vec![width; values.len()])
            .with_color(color(rgb))
    };
    let width = probe.z_m[1] - probe.z_m[0];
    stream.log(format!("beam_density/{model}"), &bars(&probe.density_per_m, &probe.z_m, width, rgb))?;
    let height = probe.density_per_m.iter().copied().fold(0.0, f32::max);
    stream.log("beam_density/reading", &bars(&[height], &[probe.reading_m], width, TRUTH))
}

fn particles(step: &DetailedStep, rgb: [u8; 3]) -> rerun::Points2D {
    let heaviest = step.weights.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    // The square root keeps light particles visible beside a few heavy ones.
    let colors = step.weights.iter().map(|w| blend([0x40; 3], rgb, (w / heaviest).sqrt()));
    rerun::Points2D::new(step.particles.iter().map(|p| pose_point(&p)))
        .with_colors(colors)
        .with_radii([rerun::Radius::new_ui_points(1.5)])
}

/// Readings as rays from the true pose, coloured by their log density under the model; beams without a return as
/// stubs, as their probability is that of a point and no density.
fn scan(laser: &Laser, drive_step: &DriveStep, pose: &Pose2, step: &DetailedStep) -> rerun::LineStrips2D {
    let map_from_laser = pose.compose(&laser.base_from_laser());
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
        let end = [map_from_laser.x + length * direction.cos(), map_from_laser.y + length * direction.sin()];
        rays.push([pose_point(&map_from_laser), point(end)]);
        // -4 nats (improbable) to 3 nats (a peak some centimetres wide).
        let share = f64::from((log_density + 4.0) / 7.0);
        let by_density = blend([0xd5, 0x3e, 0x4f], [0x32, 0x88, 0xbd], share);
        colors.push(if returned { by_density } else { color(NO_RETURN) });
    }
    rerun::LineStrips2D::new(rays).with_colors(colors).with_radii([rerun::Radius::new_ui_points(0.5)])
}

/// The ellipse that holds 95 % of a Gaussian with the particles' covariance.
fn ellipse(step: &DetailedStep, rgb: [u8; 3]) -> rerun::LineStrips2D {
    let [[xx, xy], [_, yy]] = step.position_covariance;
    let mean = 0.5 * (xx + yy);
    let spread = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    // 5.991: the 95 % quantile of chi-square with two degrees of freedom.
    let [a, b] = [mean + spread, mean - spread].map(|variance| (5.991 * variance.max(0.0)).sqrt());
    let outline = (0..=48).map(|i| {
        let t = f64::from(i) * std::f64::consts::TAU / 48.0;
        let (u, v) = (a * t.cos(), b * t.sin());
        point([
            step.estimate.x + u * angle.cos() - v * angle.sin(),
            step.estimate.y + u * angle.sin() + v * angle.cos(),
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
