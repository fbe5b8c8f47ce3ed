use locsim_core::{Drive, Pose2};
use locsim_report::figures::Figure;
use locsim_report::figures::canvas::{
    Area, DrawError, Drawn, INK, Mark, READING, UNKNOWN, WIDTH, figure, line,
};
use locsim_report::figures::geometry::{Point, Window};
use locsim_report::figures::map::{LEFT, MARGINS, MapPanel};
use locsim_report::{ReportError, palette};
use plotters::prelude::{Color, RGBColor};

use super::{Role, Split};

/// The figure shows at most this many readings: more hide each other.
const SHOWN_READINGS: usize = 20_000;

const NAME: &str = "drive";

/// The drive seen from above: reference, odometry and the ends of the readings. Parts of the reference have the colours of
/// what the proposed split takes them for.
///
/// # Errors
/// [`ReportError::Figure`].
pub fn picture(drive: &Drive, split: Option<&Split>) -> Result<Figure, ReportError> {
    let svg = draw(drive, split)
        .map_err(|error: DrawError| ReportError::Figure { name: NAME, reason: error.to_string() })?;
    let caption = "Reference, odometry and the ends of the readings.".to_owned();
    Ok(Figure { name: NAME, caption, svg })
}

/// A piece of the path with its colour.
struct Piece {
    path: Vec<Point>,
    color: RGBColor,
}

fn draw(drive: &Drive, split: Option<&Split>) -> Result<String, DrawError> {
    let color = |index: usize| {
        let [red, green, blue] = palette::rgb(index);
        RGBColor(red, green, blue)
    };
    let has_reference = drive.steps.iter().any(|step| step.reference.is_some());
    let odometry = odometry(drive);
    let ends = ends(drive, &odometry, has_reference);
    let roles = [
        (Role::Map, "map", color(2)),
        (Role::Train, "training", color(1)),
        (Role::MapAndTrain, "map and training", color(2)),
        (Role::Localize, "localization", color(0)),
    ];
    let mut pieces = Vec::new();
    let mut legend = vec![("ends of readings".to_owned(), Mark::Dot(READING))];
    if let Some(split) = split {
        for (role, name, color) in roles {
            let parts = split.parts.iter().filter(|part| part.role == role);
            let before = pieces.len();
            pieces.extend(parts.map(|part| Piece { path: reference(drive, part.scans), color }));
            if pieces.len() > before {
                legend.push((format!("reference: {name}"), Mark::Line(color)));
            }
        }
    } else if has_reference {
        pieces.push(Piece { path: reference(drive, [0.0, 1.0]), color: INK });
        legend.push(("reference".to_owned(), Mark::Line(INK)));
    }
    let points = |poses: &[Pose2]| -> Vec<Point> { poses.iter().map(|pose| [pose.x, pose.y]).collect() };
    let odometry = points(&odometry);
    if !drive.steps.iter().all(|step| step.odometry == Pose2::IDENTITY) {
        legend.push(("odometry".to_owned(), Mark::Line(UNKNOWN)));
    }
    let path = pieces.iter().flat_map(|piece| &piece.path);
    let around = Window::around(usual(&ends).iter().chain(&odometry).chain(path));
    let (right, top, below) = MARGINS;
    let width = f64::from(WIDTH) - LEFT - right;
    let [x, y] = around.size();
    let height = (width * y / x.max(1e-3)).clamp(0.3 * width, 1.2 * width);
    let window = around.with_aspect(width / height);
    figure("The drive", &legend, height + top + below, |area: &Area<'_>| -> Drawn {
        let mut panel = MapPanel::new(area, window, [10.0, height / 80.0])?;
        for end in &ends {
            panel.dot(*end, 0.8, READING.mix(0.5).filled())?;
        }
        panel.line(&odometry, line(UNKNOWN, 1.5))?;
        for Piece { path, color } in &pieces {
            panel.line(path, line(*color, 2.5))?;
        }
        Ok(())
    })
}

/// The corners of the window that holds all points but the outermost of each side: single readings end far away.
fn usual(points: &[Point]) -> Vec<Point> {
    const OUTERMOST: f64 = 0.01;
    let [xs, ys] = [0, 1].map(|axis| {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        values.sort_by(f64::total_cmp);
        values
    });
    let cut = (OUTERMOST * points.len() as f64) as usize;
    let at = |i: usize| Some([*xs.get(i)?, *ys.get(i)?]);
    at(cut).into_iter().chain(at(points.len().wrapping_sub(1 + cut))).collect()
}

/// The odometry, laid over the first reference pose.
fn odometry(drive: &Drive) -> Vec<Pose2> {
    let anchor = drive.steps.iter().find_map(|step| Some((step.reference?, step.odometry)));
    let (reference, origin) = anchor.unwrap_or_default();
    let start = reference.compose(&origin.inverse());
    drive.steps.iter().map(|step| start.compose(&step.odometry)).collect()
}

/// The reference poses of a share of the scans.
fn reference(drive: &Drive, [from, to]: [f64; 2]) -> Vec<Point> {
    let n = drive.steps.len() as f64;
    let steps = drive.steps.iter().enumerate();
    // With the first scan of the next part, so that the line goes on.
    let inside = steps.filter(|(i, _)| (from * n..to * n + 1.0).contains(&(*i as f64)));
    inside.filter_map(|(_, step)| step.reference).map(|pose| [pose.x, pose.y]).collect()
}

/// Where readings end, from the reference or else from the odometry.
fn ends(drive: &Drive, odometry: &[Pose2], has_reference: bool) -> Vec<Point> {
    let laser = &drive.laser;
    let stride = (drive.steps.len() * laser.beam_count()).div_ceil(SHOWN_READINGS).max(1);
    let mut ends = Vec::new();
    for (i, (step, odometry)) in drive.steps.iter().zip(odometry).enumerate() {
        let Some(pose) = step.reference.or((!has_reference).then_some(*odometry)) else { continue };
        let pose = pose.compose(&laser.base_from_laser());
        // Other beams of each scan.
        for beam in (i % stride..laser.beam_count()).step_by(stride) {
            let range = step.scan.ranges[beam];
            if range < laser.max_range() {
                let direction = pose.theta + f64::from(laser.bearings()[beam]);
                let range = f64::from(range);
                ends.push([pose.x + range * direction.cos(), pose.y + range * direction.sin()]);
            }
        }
    }
    ends
}
