use locsim_core::{Drive, DriveStep, FASTEST, Pose2, median, wrap_angle};
use serde::Serialize;

use super::body::base_from_body;
use super::calibration::OdometryCalibration;
use super::windows::{Window, windows};

/// Fewer windows say nothing.
const LEAST_WINDOWS: usize = 5;
/// A window that turns by less is straight, by more a turn \[rad\].
const STRAIGHT: f64 = 0.2;
const TURN: f64 = 0.5;
/// An error beyond this many times the median one counts as this: the reference has jumped.
const CUT: f64 = 6.0;

/// A shorter step than this is no jump \[m\] and \[rad\].
const JUMP: (f64, f64) = (0.5, 0.5);
/// A reference jumps where, within a step, it moves otherwise than the odometry by more than this \[m\] and \[rad\], and by more than
/// this many times what most steps differ by.
const REFERENCE_JUMP: (f64, f64) = (0.05, 0.035);
const USUAL: f64 = 10.0;
/// The odometry of a step may be off by this share of it, a robot moves that comes farther than this between scans \[m, rad\], and an interval
/// between scans is a gap that is this many times the usual one.
const OF_WAY: f64 = 0.1;
const MOVES: f64 = 1e-3;
const GAP: f64 = 3.0;

/// How the robot moved by its odometry, and how far off that is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OdometryQuality {
    /// Distance driven \[m\].
    pub driven_m: f64,
    /// Sum of all turns \[rad\].
    pub turned_rad: f64,
    /// Number of steps between scans that no robot can make; `None` where the stamps stand still.
    pub jumps: Option<usize>,
    /// How long it stood still while the reference moved \[s\].
    pub frozen_secs: f64,
    /// How far the reference moved meanwhile \[m\].
    pub frozen_m: f64,
    /// How much later than the reference it shows the same motion \[s\]; 0 where a lag doesn't explain most of what they differ by.
    pub lag_secs: f64,
    /// Its error, beside the lag; `None` without a reference to compare it with.
    pub error: Option<OdometryError>,
    /// The part of it that is systematic; `None` where none shows.
    pub calibration: Option<OdometryCalibration>,
}

/// The error of odometry against a reference, over windows of about a metre.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OdometryError {
    /// Number of windows.
    pub windows: usize,
    /// Distance by odometry over distance by reference.
    pub distance_ratio: f64,
    /// Position error per metre driven \[m/m\].
    pub position_per_m: f64,
    /// Heading error per metre on straight windows \[rad/m\].
    pub heading_per_m: Option<f64>,
    /// Heading error per radian turned \[rad/rad\].
    pub heading_per_rad: Option<f64>,
    /// Noise of the odometry motion model, alpha 1 to 4 (Probabilistic Robotics, table 5.6), that explains these errors; the
    /// reference's own errors are taken for the odometry's.
    pub alpha: [f64; 4],
}

/// The reference poses of a drive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReferenceQuality {
    /// Number of scans that have one.
    pub scans: usize,
    /// Longest stretch of scans without one \[s\].
    pub longest_gap_secs: f64,
    /// Number of steps between scans at which it moves otherwise than the odometry by 5 cm or 2 degrees, and by ten times what most
    /// steps differ by.
    pub jumps: usize,
    /// The median of these jumps \[m\] and \[rad\]; 0 without any.
    pub jump_m: f64,
    /// See `jump_m`.
    pub jump_rad: f64,
    /// Pose on the robot's base of the body that the reference is of, `base_from_body`, where one explains most of what odometry and reference
    /// differ by.
    pub body: Option<Pose2>,
}

impl OdometryQuality {
    /// `on_time` is the drive without the lag.
    pub(super) fn of(drive: &Drive, on_time: &Drive, lag_secs: f64) -> Self {
        let increments: Vec<Pose2> = (1..drive.steps.len()).map(|i| drive.odometry_increment(i)).collect();
        let secs = || drive.steps.windows(2).map(|pair| pair[1].stamp_secs - pair[0].stamp_secs);
        let usual = median(&mut secs().collect::<Vec<_>>());
        let jump = |(step, secs): &(&Pose2, f64)| {
            let (distance, turn) = (step.position().length(), wrap_angle(step.theta).abs());
            (distance > JUMP.0 && distance > FASTEST.0 * secs) || (turn > JUMP.1 && turn > FASTEST.1 * secs)
        };
        let [frozen_secs, frozen_m] = drive.frozen_odometry();
        Self {
            driven_m: increments
                .iter()
                .map(|step| step.position().length())
                .fold(0.0, |sum, length| sum + length),
            turned_rad: increments
                .iter()
                .map(|step| wrap_angle(step.theta).abs())
                .fold(0.0, |sum, turn| sum + turn),
            jumps: (usual > 0.0)
                .then(|| increments.iter().zip(secs().map(|secs| secs.max(usual))).filter(jump).count()),
            frozen_secs,
            frozen_m,
            lag_secs,
            error: OdometryError::of(on_time),
            calibration: OdometryCalibration::of(on_time),
        }
    }
}

impl ReferenceQuality {
    /// `is_comparable` where the odometry can be held against it.
    pub(super) fn of(drive: &Drive, is_comparable: bool) -> Option<Self> {
        let known: Vec<(f64, Pose2)> =
            drive.steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?))).collect();
        let (first, last) = (drive.steps.first()?, drive.steps.last()?);
        let (begin, end) = (known.first()?, known.last()?);
        let inside = known.windows(2).map(|pair| pair[1].0 - pair[0].0);
        let gaps = if known.len() < drive.steps.len() { inside.fold(0.0, f64::max) } else { 0.0 };
        let jumps = if is_comparable { reference_jumps(drive) } else { Vec::new() };
        let median_of = |which: usize| {
            if jumps.is_empty() {
                0.0
            } else {
                median(&mut jumps.iter().map(|jump| jump[which]).collect::<Vec<_>>())
            }
        };
        Some(Self {
            scans: known.len(),
            longest_gap_secs: gaps.max(begin.0 - first.stamp_secs).max(last.stamp_secs - end.0),
            jumps: jumps.len(),
            jump_m: median_of(0),
            jump_rad: median_of(1),
            body: if is_comparable { base_from_body(&windows(drive)) } else { None },
        })
    }
}

/// How far the reference jumps against the odometry \[m, rad\], in the steps between scans where it does. Where the odometry itself makes a
/// step that no robot can make, the reference doesn't jump, and across a gap between scans it may go its own way.
fn reference_jumps(drive: &Drive) -> Vec<[f64; 2]> {
    let secs = |pair: &[DriveStep]| pair[1].stamp_secs - pair[0].stamp_secs;
    let usual_secs = median(&mut drive.steps.windows(2).map(secs).collect::<Vec<_>>());
    // What they differ by, and how far the robot went.
    let apart: Vec<[[f64; 2]; 2]> = drive
        .steps
        .windows(2)
        .filter(|pair| secs(pair) <= GAP * usual_secs)
        .filter_map(|pair| {
            let (a, b) = pair[0].reference.zip(pair[1].reference)?;
            let odometry = pair[1].odometry.relative_to(&pair[0].odometry);
            let apart = b.relative_to(&a).relative_to(&odometry);
            let sizes =
                [apart, odometry].map(|pose| [pose.position().length(), wrap_angle(pose.theta).abs()]);
            (sizes[1][0] <= JUMP.0 + FASTEST.0 * secs(pair)).then_some(sizes)
        })
        .collect();
    let usual = |which: usize| {
        let moving = apart.iter().filter(|[_, way]| way[0] > MOVES || way[1] > MOVES);
        let mut all: Vec<f64> = moving.map(|[apart, _]| apart[which]).collect();
        if all.is_empty() { 0.0 } else { median(&mut all) }
    };
    let least = [REFERENCE_JUMP.0.max(USUAL * usual(0)), REFERENCE_JUMP.1.max(USUAL * usual(1))];
    let is_jump = |[apart, way]: &[[f64; 2]; 2]| (0..2).any(|i| apart[i] > least[i] + OF_WAY * way[i]);
    apart.into_iter().filter(is_jump).map(|[apart, _]| apart).collect()
}

impl OdometryError {
    /// Alpha 1 to 4 of an odometry that nothing is known of: half of AMCL's default.
    pub const USUAL_ALPHA: [f64; 4] = [0.1; 4];

    /// The errors on the steps whose scans have reference poses; `None` where there are too few of them.
    pub fn of(drive: &Drive) -> Option<Self> {
        let windows = windows(drive);
        (windows.len() >= LEAST_WINDOWS).then(|| error(&windows))
    }
}

fn error(windows: &[Window]) -> OdometryError {
    let heading = |w: &Window| wrap_angle(w.odometry.theta - w.reference.theta).abs();
    let per = |selected: &dyn Fn(&&Window) -> bool, along: fn(&Window) -> f64| {
        let chosen = || windows.iter().filter(selected);
        let whole: f64 = chosen().map(along).sum();
        (chosen().count() >= LEAST_WINDOWS && whole > 0.0).then(|| chosen().map(heading).sum::<f64>() / whole)
    };
    let total = |of: fn(&Window) -> f64| windows.iter().map(of).sum::<f64>();
    let length = |pose: Pose2| pose.position().length();
    let squares = |of: &dyn Fn(&Window) -> f64| -> Vec<f64> {
        let errors: Vec<f64> = windows.iter().map(of).collect();
        let cut = CUT * median(&mut errors.clone());
        errors.into_iter().map(|error| error.min(cut).powi(2)).collect()
    };
    let turns = squares(&heading);
    let distances = squares(&|w| (length(w.odometry) - length(w.reference)).abs());
    // Of a smooth turn, each of the model's two rotations is a half, so that its square counts by half; the distance acts on
    // both.
    let turn_squares = |w: &Window| 0.5 * w.turn_squares;
    let [a1, a2] = least_squares(windows.iter().map(|w| [turn_squares(w), 2.0 * w.distance_squares]), &turns);
    let [a3, a4] = least_squares(windows.iter().map(|w| [w.distance_squares, turn_squares(w)]), &distances);
    OdometryError {
        windows: windows.len(),
        distance_ratio: total(|w| w.odometry.position().length())
            / total(|w| w.reference.position().length()).max(1e-9),
        position_per_m: total(|w| w.odometry.position().distance(w.reference.position()))
            / total(|w| w.distance).max(1e-9),
        heading_per_m: per(&|w| w.turn < STRAIGHT, |w| w.distance),
        heading_per_rad: per(&|w| w.turn > TURN, |w| w.turn),
        alpha: [a1, a2, a3, a4],
    }
}

/// The coefficients, not negative, of the two regressors that explain the values best.
fn least_squares(regressors: impl Iterator<Item = [f64; 2]>, values: &[f64]) -> [f64; 2] {
    let (mut xx, mut xy, mut yy, mut xv, mut yv) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for ([x, y], value) in regressors.zip(values) {
        xx += x * x;
        xy += x * y;
        yy += y * y;
        xv += x * value;
        yv += y * value;
    }
    let alone = |square: f64, product: f64| if square > 0.0 { product / square } else { 0.0 };
    let determinant = xx * yy - xy * xy;
    if determinant > 1e-9 * xx * yy {
        let both = [(yy * xv - xy * yv) / determinant, (xx * yv - xy * xv) / determinant];
        if both.iter().all(|coefficient| *coefficient >= 0.0) {
            return both;
        }
    }
    // One of them explains more alone.
    if xv * xv * yy >= yv * yv * xx { [alone(xx, xv), 0.0] } else { [0.0, alone(yy, yv)] }
}
