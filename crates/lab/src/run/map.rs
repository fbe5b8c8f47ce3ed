//! `locsim map`: both maps of a log, and how they agree with scans that they weren't made from.

use std::path::Path;

use locsim_core::Drive;
use locsim_core::limits::number;
use locsim_dataset::{DriveQuality, LogOptions, LogSummary, read_log};
use locsim_mapping::{
    Agreement, HeldOutReading, MapCheck, MappingOptions, check_maps, occupancy_from_drive, walls_from_drive,
};
use locsim_report::figures::Figure;
use locsim_report::figures::canvas::{DrawError, INK, Mark, WIDTH, figure, line};
use locsim_report::figures::geometry::{Point, Window};
use locsim_report::figures::map::{LEFT, MARGINS, MapPanel};
use locsim_report::{ReportError, TextTable, palette};
use locsim_scenario::yaml;
use locsim_world::map::{FARTHEST_M, ImageFormat, MeasuredMap, OccupancyGrid};
use plotters::prelude::{Color, RGBColor};

use super::corrected::corrected;
use super::measured_log::{no_reference, selected, unusable};
use crate::LabError;
use crate::inspect::doubts;

/// The figure shows at most this many readings: more hide each other.
const SHOWN_READINGS: usize = 20_000;

/// Readings nearer to their nominal range than this are drawn as near \[m\]: a few standard deviations of a laser and a
/// reference pose.
const NEAR_M: f64 = 0.1;

/// Readings farther from their nominal range than this are drawn as far \[m\], as [`Agreement::far_share`] counts them.
const FAR_M: f64 = 0.5;

/// Both maps of a log.
pub struct LogMaps {
    /// Cells.
    pub grid: OccupancyGrid,
    /// Walls.
    pub walls: MeasuredMap,
    /// How both agree with held-out scans; `None` for a log too short to hold out any.
    pub check: Option<MapCheck>,
    /// Counts of the messages that were read.
    pub summary: LogSummary,
    /// What makes the maps wrong, in words.
    pub doubts: Vec<String>,
}

impl LogMaps {
    /// Builds both maps from the given shares of a log.
    ///
    /// # Errors
    /// [`LabError::Dataset`] for a log that can't be read, [`LabError::Log`] for shares of no scan and for reference poses beyond any
    /// map, [`LabError::Map`] when no map can be made of it.
    pub fn from_log(
        log: &Path,
        shares: &[[f64; 2]],
        resolution_m: f64,
        options: &LogOptions,
    ) -> Result<Self, LabError> {
        let (drive, summary) = read_log(log, options)?;
        if drive.steps.iter().all(|step| step.reference.is_none()) {
            let what = no_reference(&summary.topics, &summary.transforms);
            return Err(LabError::Log { path: log.to_owned(), what });
        }
        check_steps(&drive, shares).map_err(|what| LabError::Log { path: log.to_owned(), what })?;
        let mut doubts = doubts(&DriveQuality::of(&drive, &summary));
        let (drive, _) = corrected(drive);
        let options = MappingOptions { resolution_m, ..MappingOptions::default() };
        let steps = selected(&drive, shares);
        let grid = occupancy_from_drive(&drive, &steps, &options).map_err(unusable(log))?;
        let walls = walls_from_drive(&drive, &steps, &options).map_err(unusable(log))?;
        let check = check_maps(&drive, &steps, &options).map_err(unusable(log))?;
        if walls.walls.is_empty() {
            doubts.push(format!(
                "The map of walls has no wall, as the readings of its scans ({}) lie on no line. More scans, or a laser with more beams, are needed.",
                steps.len()
            ));
        }
        Ok(Self { grid, walls, check, summary, doubts })
    }
}

/// Checks that the shares of a drive hold a scan, and that a map can hold its reference poses.
fn check_steps(drive: &Drive, shares: &[[f64; 2]]) -> Result<(), String> {
    let count = drive.steps.len();
    if shares.iter().map(|[from, to]| to - from).sum::<f64>() * (count as f64) < 1.0 {
        let shares: Vec<String> = shares.iter().map(|share| share.map(number).join(",")).collect();
        return Err(format!(
            "the share {} holds none of its {count} scans; allowed: one or more",
            shares.join(" and ")
        ));
    }
    let poses = drive.steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?)));
    match poses.into_iter().find(|(_, pose)| pose.x.abs().max(pose.y.abs()) > FARTHEST_M) {
        None => Ok(()),
        Some((secs, pose)) => Err(format!(
            "the reference pose at {secs:.3} s is at [{}, {}]; allowed: metres, at most {FARTHEST_M} either way",
            number(pose.x),
            number(pose.y)
        )),
    }
}

/// A grid as ROS `map_server` reads it: the image, to be written as `image`, and its description.
pub fn grid_files(grid: &OccupancyGrid, image: &str) -> [Vec<u8>; 2] {
    let description = yaml::text(&grid.map_file(Path::new(image)));
    [grid.image_bytes(ImageFormat::Pgm), description.into_bytes()]
}

/// A larger share of held-out readings that are far from their nominal ranges contradicts the map: people who walk make some per cent.
const MOST_FAR: f64 = 0.2;

/// Poses, mount and stamps that don't go together leave walls less true than this \[cm\].
const TRUE_CM: f64 = 3.0;

/// What is said of a map that the log it was made of contradicts.
pub fn contradiction(check: &MapCheck) -> Option<String> {
    // Beams that meet no cell count as far from cells: of the walls alone it is said.
    let far = check.walls.far_share;
    let median_cm = 100.0 * check.walls.median_abs_m;
    let reason = if median_cm <= TRUE_CM {
        format!(
            "The median is {median_cm:.1} cm, so poses, mount and stamps go together: look for glass, for what was moved between visits, \
             and for people."
        )
    } else {
        "Reference poses, the laser's mount, its angles or the stamps don't go together.".to_owned()
    };
    (far > MOST_FAR).then(|| {
        format!(
            "{:.0} % of the held-out readings are more than {FAR_M} m from the walls that the others make. {reason}",
            100.0 * far
        )
    })
}

/// How maps agree with held-out readings, as a table.
pub fn agreement_table(check: &MapCheck) -> TextTable {
    // Nothing is known where no reading has a nominal range.
    let known = |value: f64, text: String| if value.is_finite() { text } else { "-".to_owned() };
    let row = |name: &str, of: &Agreement| {
        [
            name.to_owned(),
            format!("{:.1}", 100.0 * of.nominal_share),
            known(of.median_abs_m, format!("{:.1}", 100.0 * of.median_abs_m)),
            known(of.median_m, format!("{:+.1}", 100.0 * of.median_m)),
            known(of.far_share, format!("{:.1}", 100.0 * of.far_share)),
        ]
    };
    TextTable::new(
        [
            "held-out readings against",
            "with nominal [%]",
            "median |error| [cm]",
            "median error [cm]",
            "> 0.5 m [%]",
        ],
        [
            row("cells", &check.cells),
            row("cells, where walls have a nominal range", &check.cells_where_walls),
            row("walls", &check.walls),
            row("walls, each scan aligned", &check.walls_aligned),
        ],
    )
}

/// The map of walls and the held-out readings, coloured by how far they are from their nominal ranges.
///
/// # Errors
/// [`ReportError::Figure`].
pub fn agreement_figure(check: &MapCheck) -> Result<Figure, ReportError> {
    let failed = |error: DrawError| ReportError::Figure { name: NAME, reason: error.to_string() };
    let svg = draw(check).map_err(failed)?;
    let caption =
        "Walls of the map, the border of what was seen, and readings of scans that the map wasn't made from.";
    Ok(Figure { name: NAME, caption: caption.to_owned(), svg })
}

const NAME: &str = "map_check";

fn draw(check: &MapCheck) -> Result<String, DrawError> {
    let color = |index: usize| {
        let [red, green, blue] = palette::rgb(index);
        RGBColor(red, green, blue)
    };
    let classes = [
        ("within 0.1 m", color(2)),
        ("within 0.5 m", color(5)),
        ("farther", color(0)),
        ("no nominal range", color(4)),
    ];
    let class = |reading: &HeldOutReading| match reading.error_m.map(f64::abs) {
        Some(error) if error <= NEAR_M => 0,
        Some(error) if error <= FAR_M => 1,
        Some(_) => 2,
        None => 3,
    };
    let border_color = RGBColor(0xaa, 0xaa, 0xaa);
    let mut legend = vec![
        ("wall".to_owned(), Mark::Line(INK)),
        ("border of what was seen".to_owned(), Mark::Line(border_color)),
    ];
    legend.extend(classes.map(|(name, color)| (name.to_owned(), Mark::Dot(color))));
    let segments: Vec<[Point; 2]> =
        check.map.segments().iter().map(|ends| ends.map(|end| end.to_array())).collect();
    let (walls, border) = segments.split_at(check.map.walls().len());
    let around = Window::around(segments.iter().flatten());
    let (right, top, below) = MARGINS;
    let width = f64::from(WIDTH) - LEFT - right;
    let [x, y] = around.size();
    let height = (width * y / x.max(1e-3)).clamp(0.3 * width, 1.5 * width);
    let window = around.with_aspect(width / height);
    figure("Held-out readings on the map of walls", &legend, height + top + below, |area| {
        let mut panel = MapPanel::new(area, window, [10.0, height / 80.0])?;
        for ends in border {
            panel.line(ends, line(border_color, 1.0))?;
        }
        for ends in walls {
            panel.line(ends, line(INK, 1.0))?;
        }
        let stride = check.readings.len().div_ceil(SHOWN_READINGS).max(1);
        for reading in check.readings.iter().step_by(stride) {
            panel.dot(reading.end_m, 1.0, classes[class(reading)].1.filled())?;
        }
        Ok(())
    })
}
