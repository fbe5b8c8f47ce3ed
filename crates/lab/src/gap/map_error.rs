//! Where a measured map is wrong, for people.

use locsim_core::{Particles, RangeMap};
use locsim_gap::{Guess, MapError, MapErrorKind, MeasuredMapFindings};
use plotters::prelude::{Color, RGBColor};

use super::GapStudy;
use locsim_report::figures::canvas::{DrawError, INK, Mark, figure, line};
use locsim_report::figures::geometry::Point;
use locsim_report::figures::map::MapPanel;
use locsim_report::palette;
use locsim_report::text::{TextTable, fixed};

/// Errors in the answer, and in the report's table; gap.json has all.
const SHOWN: usize = 3;
const TABLED: usize = 12;
/// A reading is far from its nominal range when it is off by more than this \[m\].
const FAR_M: f64 = 0.5;
/// Far readings in the figure, at the most.
const SHOWN_READINGS: usize = 20_000;

const KINDS: [MapErrorKind; 3] = [MapErrorKind::MovedWall, MapErrorKind::MissingObject, MapErrorKind::Hole];

/// The name of a kind, as in gap.json.
fn name(kind: MapErrorKind) -> &'static str {
    match kind {
        MapErrorKind::MovedWall => "moved_wall",
        MapErrorKind::MissingObject => "missing_object",
        MapErrorKind::Hole => "hole",
    }
}

fn place(error: &MapError) -> String {
    let [a, b] = error.place;
    format!("({:.2}, {:.2}) to ({:.2}, {:.2}) m", a[0], a[1], b[0], b[1])
}

fn finding(error: &MapError) -> String {
    let percent = fixed(100.0 * error.share, 0);
    match (error.kind, error.offset_m) {
        (MapErrorKind::MovedWall, Some(offset)) => {
            let side = if offset > 0.0 { "farther" } else { "nearer" };
            format!("the wall stands {:.2} m {side}", offset.abs())
        }
        (MapErrorKind::MovedWall, None) => "the wall stands elsewhere".to_owned(),
        (MapErrorKind::MissingObject, _) => format!("{percent} % of the beams end in free space"),
        (MapErrorKind::Hole, _) => format!("{percent} % of the beams pass the wall, or have no return"),
    }
}

/// What the map lacks, and what is left out for it.
pub(super) fn sentences(map: &MeasuredMapFindings) -> Vec<String> {
    let mut text = Vec::new();
    if !map.errors.is_empty() {
        let counts = KINDS.map(|kind| (name(kind), map.errors.iter().filter(|e| e.kind == kind).count()));
        let counts = counts.into_iter().filter(|(_, count)| *count > 0);
        let counts: Vec<String> = counts.map(|(name, count)| format!("{count} {name}")).collect();
        let first = map.errors.iter().take(SHOWN);
        let first: Vec<String> = first
            .map(|error| format!("{}, {}: {}", name(error.kind), place(error), finding(error)))
            .collect();
        text.push(format!("The map is wrong in places ({}): {}.", counts.join(", "), first.join("; ")));
    }
    if !map.guesses.is_empty() {
        let guess = |guess: &Guess| {
            format!("{} {:.4} (at most {:.4} in the log)", guess.what, guess.scenario, guess.log)
        };
        let guesses: Vec<String> = map.guesses.iter().map(guess).collect();
        text.push(format!(
            "The scenario states more than the log shows: {}. The search uses what the log shows. So does scenario.yaml, where \
             the scenario states the number.",
            guesses.join(", ")
        ));
    }
    let left_out = &map.left_out;
    let percent = |share: f64| fixed(100.0 * share, 0);
    text.push(format!(
        "The map was measured: {} % of the beams lead into space that it hasn't seen, {} % pass an end of a wall, {} % come \
         to places where it is wrong. They are left out, in the log and in its simulations.",
        percent(left_out.unknown),
        percent(left_out.at_ends),
        percent(left_out.map_errors)
    ));
    text
}

/// The errors with most readings.
pub(super) fn table(map: &MeasuredMapFindings) -> Option<TextTable> {
    let rows =
        map.errors.iter().take(TABLED).map(|error| {
            [name(error.kind).to_owned(), place(error), finding(error), error.readings.to_string()]
        });
    (!map.errors.is_empty()).then(|| TextTable::new(["what", "where", "how", "readings"], rows))
}

/// Errors beyond the table.
pub(super) fn more(map: &MeasuredMapFindings) -> usize {
    map.errors.len().saturating_sub(TABLED)
}

/// Where the readings end that are far from where the map has it \[m\].
fn far_readings(study: &GapStudy) -> Vec<Point> {
    let recorded = study.recorded();
    let (laser, geometry) = (&recorded.laser, study.map.geometry());
    let poses: Particles =
        recorded.track.poses().iter().map(|pose| pose.compose(&laser.base_from_laser())).collect();
    let mut hits = locsim_core::Hits::default();
    study.map.cast(poses.as_poses(), laser.bearings(), laser.max_range(), &mut hits);
    let beams = laser.beam_count();
    let end = |(i, &reading): (usize, &f32)| {
        let is_known = hits.range[i] < laser.max_range() && !geometry.is_unknown(hits.surface[i]);
        let is_far = f64::from((reading - hits.range[i]).abs()) > FAR_M;
        (is_known && is_far && reading < laser.max_range()).then(|| {
            let pose = poses.get(i / beams);
            let direction = pose.theta + f64::from(laser.bearings()[i % beams]);
            let range = f64::from(reading);
            [pose.x + range * direction.cos(), pose.y + range * direction.sin()]
        })
    };
    recorded.readings.iter().enumerate().filter_map(end).collect()
}

/// The floor: walls, those that are off or passed by beams in colour, objects that the map lacks, and readings that are far from
/// where the map has them.
pub(super) fn draw(study: &GapStudy, map: &MeasuredMapFindings) -> Result<String, DrawError> {
    let color = |index: usize| {
        let [red, green, blue] = palette::rgb(index);
        RGBColor(red, green, blue)
    };
    let (border_color, far_color) = (RGBColor(0xaa, 0xaa, 0xaa), RGBColor(0xe0, 0x8e, 0x79));
    let color_of = |kind| match kind {
        MapErrorKind::MovedWall => color(5),
        MapErrorKind::MissingObject => color(0),
        MapErrorKind::Hole => color(2),
    };
    let legend = [
        ("wall".to_owned(), Mark::Line(INK)),
        ("border of what was seen".to_owned(), Mark::Line(border_color)),
        ("moved wall".to_owned(), Mark::Line(color_of(MapErrorKind::MovedWall))),
        ("hole".to_owned(), Mark::Line(color_of(MapErrorKind::Hole))),
        ("missing object".to_owned(), Mark::Area(color_of(MapErrorKind::MissingObject))),
        ("reading more than 0.5 m off".to_owned(), Mark::Dot(far_color)),
    ];
    let segments = study.walls();
    let (walls, border) = segments.split_at(study.map.geometry().walls().len());
    let (panel, window) = locsim_report::figures::map::panel(&segments);
    figure("The map against the readings", &legend, panel, |area| {
        let mut floor = MapPanel::new(area, window, [10.0, panel / 60.0])?;
        for ends in border {
            floor.line(ends, line(border_color, 1.0))?;
        }
        let readings = far_readings(study);
        let stride = readings.len().div_ceil(SHOWN_READINGS).max(1);
        for end in readings.into_iter().step_by(stride) {
            floor.dot(end, 1.0, far_color.filled())?;
        }
        for ends in walls {
            floor.line(ends, line(INK, 1.0))?;
        }
        for MapError { kind, place, .. } in &map.errors {
            let style = line(color_of(*kind), 3.0);
            let [[x0, y0], [x1, y1]] = *place;
            if *kind == MapErrorKind::MissingObject {
                floor.line(&[[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], style)?;
            } else {
                floor.line(place, style)?;
            }
        }
        Ok(())
    })
}
