use std::collections::BTreeMap;
use std::io::BufRead;
use std::path::Path;

use locsim_core::Pose2;
use locsim_core::limits::{Limits, READINGS_PER_SCAN};

use super::CarmenLaser;
use crate::DatasetError;
use crate::beams::Beams;
use crate::lines::{Fields, Lines};

/// Greatest number of unknown keywords that are counted by name; logs have few.
const MOST_KEYWORDS: usize = 100;

/// Every message of CARMEN ends with `ipc_timestamp hostname logger_timestamp`.
const TRAILER: usize = 3;

/// A log's lines as read, before anything is concluded from them.
pub struct Log {
    /// Keyword of the scans' lines.
    pub keyword: &'static str,
    pub scans: Vec<ScanLine>,
    /// Layout and maximum range (m) of the first ROBOTLASER line; the others have the same.
    pub layout: Option<Layout>,
    pub params: Params,
    pub odometry_lines: usize,
    pub true_pose_lines: usize,
    pub skipped: BTreeMap<String, usize>,
    /// The first ODOM line's pose.
    pub first_odometry: Option<Pose2>,
}

impl Log {
    /// Takes in a line of odometry.
    fn count_odometry(&mut self, between: &mut Between, stamp_secs: f64, pose: Pose2) {
        self.odometry_lines += 1;
        self.first_odometry.get_or_insert(pose);
        between.odometry_lines += 1;
        between.first_odometry.get_or_insert((stamp_secs, pose));
        between.last_odometry = Some((stamp_secs, pose));
    }
}

/// One scan with the lines between it and the scan before.
pub struct ScanLine {
    pub stamp_secs: f64,
    pub ranges: Vec<f32>,
    pub laser_pose: Pose2,
    pub robot_pose: Pose2,
    pub before: Between,
}

/// The lines between two scans.
#[derive(Clone, Copy, Default)]
pub struct Between {
    /// Number of ODOM or O lines.
    pub odometry_lines: usize,
    /// Time and pose of the first ODOM line.
    pub first_odometry: Option<(f64, Pose2)>,
    /// Time and pose of the last ODOM line.
    pub last_odometry: Option<(f64, Pose2)>,
    /// True pose and odometry of the last TRUEPOS line.
    pub truth: Option<(Pose2, Pose2)>,
}

/// The description of the laser in a ROBOTLASER line.
#[derive(Clone, Copy, PartialEq)]
pub struct Layout {
    pub beams: Beams,
    pub max_range: f32,
}

/// The parameters of the wanted laser, where the log has them.
#[derive(Default)]
pub struct Params {
    /// Mount of the wanted laser: x (m), y (m), heading (rad).
    pub offset: Option<f64>,
    pub side_offset: Option<f64>,
    pub angular_offset: Option<f64>,
    /// Degrees.
    pub resolution: Option<f64>,
    /// Degrees.
    pub field_of_view: Option<f64>,
    /// Range from which a reading is no return \[m\].
    pub max_range: Option<f64>,
    /// Noted by `write_carmen`.
    pub min_range: Option<f64>,
    pub beam_interval: Option<f64>,
}

/// Names of the parameters that only `write_carmen` notes; CARMEN has no place for these values.
pub const MIN_RANGE: &str = "locsim_laser_min_range_m";
pub const BEAM_INTERVAL: &str = "locsim_laser_beam_interval_secs";

impl Params {
    fn slot(&mut self, name: &str, laser: CarmenLaser) -> Option<&mut Option<f64>> {
        let (robot, device, max_range) = match laser {
            CarmenLaser::Front => ("robot_frontlaser_", "laser_front_laser_", "robot_front_laser_max"),
            CarmenLaser::Rear => ("robot_rearlaser_", "laser_rear_laser_", "robot_rear_laser_max"),
        };
        if name == max_range {
            return Some(&mut self.max_range);
        }
        match (name, name.strip_prefix(robot), name.strip_prefix(device)) {
            (_, Some("offset"), _) => Some(&mut self.offset),
            (_, Some("side_offset"), _) => Some(&mut self.side_offset),
            (_, Some("angular_offset"), _) => Some(&mut self.angular_offset),
            (_, _, Some("resolution")) => Some(&mut self.resolution),
            (_, _, Some("fov")) => Some(&mut self.field_of_view),
            (MIN_RANGE, _, _) => Some(&mut self.min_range),
            (BEAM_INTERVAL, _, _) => Some(&mut self.beam_interval),
            _ => None,
        }
    }

    fn read(&mut self, mut fields: Fields<'_>, laser: CarmenLaser) -> Result<(), DatasetError> {
        let name = fields.word();
        if let Some(slot) = self.slot(name, laser) {
            *slot = Some(fields.number(name)?);
        }
        Ok(())
    }
}

/// Reads every line.
pub fn parse<R: BufRead>(
    mut lines: Lines<'_, R>,
    laser: CarmenLaser,
    limits: &Limits,
    path: &Path,
) -> Result<Log, DatasetError> {
    let forms = laser.keywords();
    let mut log = Log {
        keyword: forms[0],
        scans: Vec::new(),
        layout: None,
        params: Params::default(),
        odometry_lines: 0,
        true_pose_lines: 0,
        skipped: BTreeMap::new(),
        first_odometry: None,
    };
    let (mut params, mut readings) = (0, 0);
    let mut between = Between::default();
    while let Some(line) = lines.next()? {
        let mut fields = line.fields();
        let keyword = fields.keyword;
        // The first scan decides which of the forms is read.
        let form = forms.iter().find(|form| keyword == **form);
        let form = form.filter(|form| log.scans.is_empty() || log.keyword == **form);
        if keyword == "PARAM" {
            log.params.read(fields, laser)?;
            params += 1;
        } else if keyword == "ODOM" {
            fields.expect_remaining(6 + TRAILER, 1, "(ODOM x y theta tv rv accel, times and host)")?;
            let pose = fields.pose("robot")?;
            for speed in ["translational velocity", "rotational velocity", "acceleration"] {
                fields.number(speed)?;
            }
            log.count_odometry(&mut between, trailer(&mut fields)?, pose);
        } else if keyword == "O" {
            fields.expect_remaining(4, 1, "(O x y theta, time)")?;
            let pose = in_metres(fields.pose("robot")?);
            log.count_odometry(&mut between, fields.stamp("time")?, pose);
        } else if keyword == "TRUEPOS" {
            fields.expect_remaining(6 + TRAILER, 1, "(TRUEPOS true pose, odometry pose, times and host)")?;
            between.truth = Some((fields.pose("true")?, fields.pose("odometry")?));
            trailer(&mut fields)?;
            log.true_pose_lines += 1;
        } else if let Some(form) = form {
            log.keyword = form;
            let first_count = log.scans.first().map(|scan| scan.ranges.len());
            let (layout, scan) = match *form {
                "L" => (None, centimetre_scan(fields, first_count, &between)?),
                "ROBOTLASER1" | "ROBOTLASER2" => {
                    let (layout, scan) = new_scan(fields, first_count, log.layout, &between)?;
                    (Some(layout), scan)
                }
                _ => (None, old_scan(fields, first_count, &between)?),
            };
            readings += READINGS_PER_SCAN + scan.ranges.len() as u64;
            if readings > limits.log_readings {
                return Err(line.refuse(Limits::refusal_above("log_readings", limits.log_readings)));
            }
            log.layout = log.layout.or(layout);
            log.scans.push(scan);
            between = Between::default();
        } else {
            count(&mut log.skipped, keyword);
        }
    }
    let cut_off = lines.cut_off();
    if !log.scans.is_empty() {
        if cut_off.is_some() {
            log.skipped.insert(CUT_OFF.into(), 1);
        }
        return Ok(log);
    }
    if let Some(error) = cut_off {
        return Err(error);
    }
    let known = [("PARAM", params), ("ODOM", log.odometry_lines), ("TRUEPOS", log.true_pose_lines)];
    let found: Vec<_> = known
        .into_iter()
        .chain(log.skipped.iter().map(|(word, n)| (word.as_str(), *n)))
        .filter(|(word, n)| *n > 0 && *word != "#")
        .map(|(word, n)| format!("{word} {n}"))
        .take(10)
        .collect();
    if found.is_empty() {
        return Err(DatasetError::Empty { path: path.to_owned() });
    }
    Err(DatasetError::NoScans { path: path.to_owned(), wanted: forms.join(" or "), found: found.join(", ") })
}

/// Counts a last line without its newline in [`LogSummary::skipped`](crate::LogSummary::skipped).
const CUT_OFF: &str = "(cut off)";

/// Counts the lines of each keyword.
pub fn keywords<R: BufRead>(mut lines: Lines<'_, R>) -> Result<BTreeMap<String, usize>, DatasetError> {
    let mut counts = BTreeMap::new();
    while let Some(line) = lines.next()? {
        count(&mut counts, line.fields().keyword);
    }
    Ok(counts)
}

/// Counts an unknown line. Lines without a keyword share one name, as do keywords above [`MOST_KEYWORDS`].
fn count(skipped: &mut BTreeMap<String, usize>, keyword: &str) {
    let name = if keyword.starts_with('#') {
        "#"
    } else if keyword.len() <= 32 && keyword.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_') {
        keyword
    } else {
        "(no keyword)"
    };
    let name = if skipped.len() < MOST_KEYWORDS || skipped.contains_key(name) { name } else { "(others)" };
    match skipped.get_mut(name) {
        Some(count) => *count += 1,
        None => {
            skipped.insert(name.to_owned(), 1);
        }
    }
}

/// The time of a message (s), from the fields that end it.
fn trailer(fields: &mut Fields<'_>) -> Result<f64, DatasetError> {
    let stamp_secs = fields.stamp("ipc_timestamp")?;
    fields.word();
    fields.stamp("logger_timestamp")?;
    Ok(stamp_secs)
}

/// `FLASER n r1..rn laser_pose robot_pose`
fn old_scan(
    mut fields: Fields<'_>,
    first_count: Option<usize>,
    before: &Between,
) -> Result<ScanLine, DatasetError> {
    let n = beam_count(&mut fields, first_count)?;
    let tail = 6 + TRAILER;
    fields.expect_remaining(n.saturating_add(tail), 2, &format!("for {n} beams"))?;
    let ranges = ranges(&mut fields, n)?;
    let (laser_pose, robot_pose) = (fields.pose("laser")?, fields.pose("robot")?);
    let stamp_secs = trailer(&mut fields)?;
    Ok(ScanLine { stamp_secs, ranges, laser_pose, robot_pose, before: *before })
}

/// `L robot_pose laser_pose r1..rn time`, lengths in centimetres. The number of beams follows from that of the fields.
fn centimetre_scan(
    mut fields: Fields<'_>,
    first_count: Option<usize>,
    before: &Between,
) -> Result<ScanLine, DatasetError> {
    const BESIDE: usize = 6 + 1;
    let n = first_count.unwrap_or_else(|| fields.remaining().saturating_sub(BESIDE)).max(1);
    let why = match first_count {
        Some(n) => format!("for {n} beams, as in the first scan"),
        None => "or more (L robot pose, laser pose, ranges, time)".to_owned(),
    };
    fields.expect_remaining(n.saturating_add(BESIDE), 1, &why)?;
    let (robot_pose, laser_pose) = (in_metres(fields.pose("robot")?), in_metres(fields.pose("laser")?));
    let ranges = ranges(&mut fields, n)?.into_iter().map(|centimetres| centimetres / 100.0).collect();
    let stamp_secs = fields.stamp("time")?;
    Ok(ScanLine { stamp_secs, ranges, laser_pose, robot_pose, before: *before })
}

/// A pose whose position is in centimetres.
fn in_metres(pose: Pose2) -> Pose2 {
    Pose2::new(pose.x / 100.0, pose.y / 100.0, pose.theta)
}

/// A turn, and a beam more \[rad\]: degrees begin far above.
const MOST_ANGLE_RAD: f64 = 7.0;

/// `ROBOTLASER1 type start_angle field_of_view resolution max_range accuracy remission_mode n r1..rn m e1..em
/// laser_pose robot_pose tv rv forward_safety side_safety turn_axis`
fn new_scan(
    mut fields: Fields<'_>,
    first_count: Option<usize>,
    first_layout: Option<Layout>,
    before: &Between,
) -> Result<(Layout, ScanLine), DatasetError> {
    fields.number("laser_type")?;
    // Degrees would be read as many turns.
    let start = fields.value("start_angle", "radians, up to a turn", |v: f64| v.abs() <= MOST_ANGLE_RAD)?;
    let field_of_view = fields
        .value("field_of_view", "radians, up to a turn", |v: f64| (0.0..=MOST_ANGLE_RAD).contains(&v))?;
    let resolution = fields.number("angular_resolution")?;
    let max_range = fields.value("maximum_range", "more than 0 m", |v: f32| v > 0.0 && v.is_finite())?;
    fields.number("accuracy")?;
    fields.number("remission_mode")?;
    let n = beam_count(&mut fields, first_count)?;
    // Some writers leave the resolution 0: the beams then fill the field of view.
    let gaps = n.saturating_sub(1) as f64;
    let step = if resolution == 0.0 { field_of_view / gaps.max(1.0) } else { resolution };
    if (step.abs() * gaps - field_of_view).abs() > 1.5 * step.abs() {
        let allowed =
            format!("{n} beams over {field_of_view} rad (the line's own field of view), to one beam");
        return Err(fields.refuse("angular_resolution", &resolution.to_string(), &allowed));
    }
    let layout = Layout { beams: Beams { start, step }, max_range };
    if first_layout.is_some_and(|first| first != layout) {
        let value = format!("from {start} rad in steps of {step} rad up to {max_range} m");
        return Err(fields.refuse("laser", &value, "the same laser as in the first scan"));
    }
    let why = format!("or more for {n} beams");
    if fields.remaining() < n.saturating_add(1) {
        fields.expect_remaining(n.saturating_add(1 + 11 + TRAILER), 9, &why)?;
    }
    let ranges = ranges(&mut fields, n)?;
    let remissions = fields.value("number of remissions", "0 or more", |_: usize| true)?;
    let tail = 11 + TRAILER;
    fields.expect_remaining(
        remissions.saturating_add(tail),
        n.saturating_add(10),
        &format!("for {n} beams and {remissions} remissions"),
    )?;
    for _ in 0..remissions {
        fields.word();
    }
    let (laser_pose, robot_pose) = (fields.pose("laser")?, fields.pose("robot")?);
    for name in ["tv", "rv", "forward_safety_dist", "side_safety_dist", "turn_axis"] {
        fields.number(name)?;
    }
    let stamp_secs = trailer(&mut fields)?;
    Ok((layout, ScanLine { stamp_secs, ranges, laser_pose, robot_pose, before: *before }))
}

fn beam_count(fields: &mut Fields<'_>, first: Option<usize>) -> Result<usize, DatasetError> {
    match first {
        Some(first) => {
            fields.value("number of beams", &format!("{first}, as in the first scan"), |n| n == first)
        }
        None => fields.value("number of beams", "a whole number, 1 or more", |n: usize| n > 0),
    }
}

/// Readings as written. Infinity, which some writers use, is above every maximum range.
fn ranges(fields: &mut Fields<'_>, n: usize) -> Result<Vec<f32>, DatasetError> {
    let mut ranges = Vec::with_capacity(n);
    for i in 0..n {
        let word = fields.word();
        match word.parse::<f32>() {
            Ok(range) if range >= 0.0 => ranges.push(range),
            _ => return Err(fields.refuse(&format!("range {}", i + 1), word, "a range of 0 or more")),
        }
    }
    Ok(ranges)
}
