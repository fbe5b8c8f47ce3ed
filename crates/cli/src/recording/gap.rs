//! A search for what a simulation lacks, as a recording: the drive twice, beams coloured by how the nominal simulator
//! expected them, and by how the one with the named effects did.

use std::path::Path;

use locsim_core::Pose2;
use locsim_lab::gap::{BeamPit, GapStudy, Outcome, answer};
use rerun::blueprint::{
    Blueprint, BlueprintPanel, Grid, Horizontal, SelectionPanel, Spatial2DView, TextDocumentView, TimePanel,
    TimeSeriesView, Vertical,
    components::{PanelState, PlayState},
};
use rerun::{RecordingStream, RecordingStreamBuilder, RecordingStreamResult};

use super::{NO_RETURN, STUB_M, TRUTH, WALL, arrow, blend, color, path, point, pose_point, upright};

/// Readings that are shorter than expected, as expected, and longer.
const SHORT: [u8; 3] = [0xff, 0x4d, 0x4d];
const EXPECTED: [u8; 3] = [0x6a, 0x6a, 0x6a];
const LONG: [u8; 3] = [0x4d, 0xa6, 0xff];

/// The nominal scenario and the one with the named effects, apart from the colours of readings.
const SERIES: [[u8; 3]; 2] = [[0xc8, 0xc8, 0xc8], [0xff, 0xc4, 0x3d]];

/// A PIT outside of this is improbable: two readings in a hundred lie there if the simulation is right.
const CENTRAL: std::ops::Range<f32> = 0.01..0.99;

/// The two sides: entity and title.
const SIDES: [(&str, &str); 2] = [("before", "Nominal scenario"), ("after", "With the named effects")];

/// Writes the drive of a search to a file.
///
/// # Errors
/// rerun's error when the file can't be written.
pub fn record(study: &GapStudy, outcome: &Outcome, file: &Path) -> anyhow::Result<()> {
    let walls = study.walls();
    let stream = RecordingStreamBuilder::new("locsim")
        .recording_name(study.name())
        .with_blueprint(layout(&walls))
        .save(file)?;
    // Wall-clock timelines mean nothing for a replay.
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    let scans = Scans { study, outcome, expected: study.expected_ends() };
    log_static(&stream, &walls, &scans)?;
    let recorded = study.recorded();
    let driven: Vec<[f32; 2]> = recorded.track.poses().iter().map(pose_point).collect();
    for (i, (pose, secs)) in recorded.track.poses().iter().zip(recorded.track.secs()).enumerate() {
        stream.set_time_sequence("step", i as i64);
        stream.set_duration_secs("time", *secs);
        stream.log("world/robot/path", &path(super::driven(i).map(|i| driven[i]).collect(), TRUTH))?;
        stream.log("world/robot/pose", &arrow(pose, 0.5, TRUTH))?;
        for (side, (name, _)) in SIDES.iter().enumerate() {
            stream.log(format!("world/{name}/scan"), &scans.rays(i, side))?;
            stream.log(format!("improbable/{name}"), &rerun::Scalars::new([scans.improbable(i, side)]))?;
        }
    }
    Ok(stream.flush_blocking()?)
}

/// The two maps above each other or side by side, as their shape asks for; the share of improbable readings and the
/// legend beneath.
fn layout(walls: &[[[f64; 2]; 2]]) -> Blueprint {
    let wide = super::is_wide(walls);
    let maps = SIDES.map(|(name, title)| {
        Spatial2DView::new(title)
            .with_origin("/")
            .with_contents(
                ["/world/map/**", "/world/robot/**", &format!("/world/{name}/**")].map(str::to_owned),
            )
            .into()
    });
    let maps = Grid::new(maps).with_grid_columns(if wide { 1 } else { 2 });
    let beneath = Horizontal::new([
        TimeSeriesView::new("Share of improbable readings (0.02 expected)").with_origin("/improbable").into(),
        TextDocumentView::new("Colours, and what was found").with_origin("/legend").into(),
    ]);
    Blueprint::new(Vertical::new([maps.into(), beneath.into()]).with_row_shares([2.2, 1.0]))
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(
            TimePanel::new()
                .with_state(PanelState::Collapsed)
                .with_timeline("step")
                .with_play_state(PlayState::Following),
        )
}

fn log_static(
    stream: &RecordingStream,
    walls: &[[[f64; 2]; 2]],
    scans: &Scans<'_>,
) -> RecordingStreamResult<()> {
    stream.log_static("world", &upright())?;
    stream.log_static(
        "world/map",
        &rerun::LineStrips2D::new(walls.iter().map(|wall| wall.map(point)))
            .with_colors([color(WALL)])
            .with_radii([rerun::Radius::new_ui_points(1.0)]),
    )?;
    for (side, ((name, _), rgb)) in SIDES.iter().zip(SERIES).enumerate() {
        stream.log_static(format!("world/{name}/all"), &scans.all(side))?;
        let line = rerun::SeriesLines::new().with_colors([color(rgb)]).with_names([*name]).with_widths([1.5]);
        stream.log_static(format!("improbable/{name}"), &line)?;
    }
    let found = answer(scans.outcome).replace('\n', "\n\n");
    stream.log_static(
        "legend",
        &rerun::TextDocument::from_markdown(format!(
            "- red: shorter than the simulation expected, grey: as expected, blue: longer, or lost (PIT from 0 to 1)\n\
             - points: where the readings of the whole drive end, or should have ended; rays: the scan of this moment\n\
             - white: reference path and pose\n\n\
             {found}\n"
        )),
    )
}

/// The scans that the search looked at.
struct Scans<'a> {
    study: &'a GapStudy,
    outcome: &'a Outcome,
    /// Where each beam would end in the world as it is mapped.
    expected: Vec<Option<[f64; 2]>>,
}

impl Scans<'_> {
    /// Beams of one scan with the PIT of one side; those without a usable reading left out.
    fn beams(&self, scan: usize, side: usize) -> impl Iterator<Item = (usize, &BeamPit, f32)> {
        let beams = self.outcome.beams;
        let pits = self.outcome.beam_pits.get(scan * beams..(scan + 1) * beams).unwrap_or_default();
        let pit = move |beam: &BeamPit| if side == 0 { beam.before } else { beam.after };
        pits.iter().enumerate().map(move |(i, beam)| (i, beam, pit(beam))).filter(|(.., pit)| pit.is_finite())
    }

    fn laser_pose(&self, scan: usize) -> Pose2 {
        let recorded = self.study.recorded();
        recorded.track.poses()[scan].compose(&recorded.laser.base_from_laser())
    }

    /// Whether a beam came back.
    fn returned(&self, scan: usize, beam: usize) -> bool {
        let recorded = self.study.recorded();
        recorded.readings[scan * self.outcome.beams + beam] < recorded.laser.max_range()
    }

    /// One scan as rays; those that didn't come back as stubs.
    fn rays(&self, scan: usize, side: usize) -> rerun::LineStrips2D {
        let laser = self.laser_pose(scan);
        let (mut rays, mut colors) = (Vec::new(), Vec::new());
        for (i, beam, pit) in self.beams(scan, side) {
            let returned = self.returned(scan, i);
            let end = if returned {
                beam.endpoint
            } else {
                let bearing = f64::from(self.study.recorded().laser.bearings()[i]) + laser.theta;
                point([laser.x + STUB_M * bearing.cos(), laser.y + STUB_M * bearing.sin()])
            };
            rays.push([pose_point(&laser), end]);
            colors.push(if returned || !CENTRAL.contains(&pit) { by_pit(pit) } else { color(NO_RETURN) });
        }
        rerun::LineStrips2D::new(rays).with_colors(colors).with_radii([rerun::Radius::new_ui_points(0.7)])
    }

    /// The ends of all readings of the drive; of lost ones, if that is improbable, where they should have ended.
    fn all(&self, side: usize) -> rerun::Points2D {
        let scans = self.study.recorded().scans();
        let ends = (0..scans).flat_map(|scan| {
            self.beams(scan, side).filter_map(move |(i, beam, pit)| {
                let expected = || self.expected[scan * self.outcome.beams + i].map(point);
                let lost = || expected().filter(|_| !CENTRAL.contains(&pit));
                let end = if self.returned(scan, i) { Some(beam.endpoint) } else { lost() };
                end.map(|end| (end, by_pit(pit)))
            })
        });
        let (ends, colors): (Vec<_>, Vec<_>) = ends.unzip();
        rerun::Points2D::new(ends).with_colors(colors).with_radii([rerun::Radius::new_ui_points(1.2)])
    }

    /// Share of improbable readings in a scan.
    fn improbable(&self, scan: usize, side: usize) -> f64 {
        let all = self.beams(scan, side).count();
        let out = self.beams(scan, side).filter(|(.., pit)| !CENTRAL.contains(pit)).count();
        out as f64 / all.max(1) as f64
    }
}

/// The colour of a PIT: strong at its ends alone, as most readings lie anywhere between.
fn by_pit(pit: f32) -> rerun::Color {
    let off = f64::from(2.0 * pit - 1.0);
    blend(EXPECTED, if off < 0.0 { SHORT } else { LONG }, off.abs().powi(8))
}
