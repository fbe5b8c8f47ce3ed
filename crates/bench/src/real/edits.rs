//! Known edits of measured logs, written on poses and readings as plainly as can be. None of them knows a map or shares code with
//! the simulator's effects.

use locsim_core::{Draw, Drive, Pose2, Stage, Track, wrap_angle};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// An edit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Edit {
    /// Nothing.
    None,
    /// Readings are longer by a length.
    Biased,
    /// Readings are longer by a share.
    Scaled,
    /// Readings of surfaces beyond 60 degrees of incidence get lost.
    Thinned,
    /// Readings of some bearings come from a part of the robot.
    Sector,
    /// Readings are multiples of a step.
    Quantized,
    /// The laser is turned by whole beams.
    Turned,
    /// Stamps are late: poses and odometry are those of a later time.
    Late,
    /// In some seconds many readings are random.
    Bursts,
    /// A disc stands in the room.
    Disc,
    /// A stretch of one wall returns nothing.
    WallLost,
    /// Distances of the odometry are too long by a share.
    OdometryScaled,
    /// The odometry turns while it drives straight.
    OdometryUnbalanced,
    /// Some distances of the odometry are far too long.
    OdometrySlipping,
}

/// All that change something.
pub const EDITS: [Edit; 13] = [
    Edit::Biased,
    Edit::Scaled,
    Edit::Thinned,
    Edit::Sector,
    Edit::Quantized,
    Edit::Turned,
    Edit::Late,
    Edit::Bursts,
    Edit::Disc,
    Edit::WallLost,
    Edit::OdometryScaled,
    Edit::OdometryUnbalanced,
    Edit::OdometrySlipping,
];

/// The truth of an edited log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// The effect that it is; `None` of no edit.
    pub effect: Option<String>,
    /// The effect's number that says how strong it is, and its true value in SI units.
    pub strength: Option<(String, f64)>,
}

impl Truth {
    fn of(effect: &str, parameter: &str, value: f64) -> Self {
        Self { effect: Some(effect.to_owned()), strength: Some((parameter.to_owned(), value)) }
    }
}

/// Poses of a log at its full rate, with their stamps \[s\]: a half has some of its scans.
#[derive(Clone)]
pub struct RobotPath {
    /// Reference poses.
    pub reference: Vec<(f64, Pose2)>,
    /// The odometry's.
    pub odometry: Vec<(f64, Pose2)>,
}

impl RobotPath {
    /// The path of a drive.
    pub fn new(drive: &Drive) -> Self {
        let reference = drive.steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?)));
        let odometry = drive.steps.iter().map(|step| (step.stamp_secs, step.odometry));
        Self { reference: reference.collect(), odometry: odometry.collect() }
    }

    /// Reference and odometry some time after a stamp; `None` where stamps decrease.
    fn late(&self) -> Option<[impl Fn(f64) -> Pose2 + use<>; 2]> {
        let late = |stamped: &[(f64, Pose2)]| {
            let track = Track::new(stamped.iter().copied()).ok()?;
            // A track's time begins with its first pose.
            let begin = stamped.first()?.0;
            Some(move |stamp: f64| track.pose_at(stamp - begin + LATE_SECS))
        };
        Some([late(&self.reference)?, late(&self.odometry)?])
    }
}

/// Strengths: plain ones, each to be seen by eye in a plot of the readings.
const BIAS_M: f64 = 0.1;
const SCALE: f64 = 0.03;
/// Chance of a return of a slanted surface to get lost, and from which slant on \[degrees\].
pub(super) const THINNED: (f64, f64) = (0.7, 60.0);
const SECTOR: (f64, f64) = (20.0, 0.6);
const STEP_M: f64 = 0.25;
const TURN_DEG: f64 = 3.0;
const LATE_SECS: f64 = 0.5;
const BURSTS: (f64, f64) = (0.2, 0.3);
const DISC_M: f64 = 0.25;
const WALL_M: (f64, f64) = (2.0, 0.15);
const ODOMETRY_SCALE: f64 = 0.05;
const ODOMETRY_TURN_PER_M: f64 = 0.05;
const SLIP: (f64, f64) = (0.2, 0.3);
/// Readings that a disc has to hide, a wall has to lose: one in this many of all.
const LEAST_SHARE: usize = 400;
/// The baseline has looked at what changes, with so many readings for each one that changes: what it hasn't seen is no change since.
const LOOKED: f64 = 0.25;
/// Readings this far from each other \[m\], and no farther off their line than this, tell the slant of a surface.
const LINE_M: f64 = 0.3;
const STRAIGHT_M: f64 = 0.05;
/// A disc keeps this far from the robot \[m\].
const CLEAR_M: f64 = 0.7;

impl Edit {
    /// Applies the edit to a log, with the path that its scans are on, that is held against a baseline; `None` where the log has no
    /// room for it.
    pub fn apply(
        self,
        drive: &mut Drive,
        path: &mut RobotPath,
        baseline: &Drive,
        seed: u64,
    ) -> Option<Truth> {
        let draw = Draw::new(seed, Stage::Trial, 40 + self as u32);
        match self {
            Self::None => Some(Truth { effect: None, strength: None }),
            Self::Biased => {
                each_return(drive, |z, _, _| z + BIAS_M as f32);
                Some(Truth::of("range_bias", "bias_m", BIAS_M))
            }
            Self::Scaled => {
                each_return(drive, |z, _, _| z * (1.0 + SCALE as f32));
                Some(Truth::of("range_scale", "k", SCALE))
            }
            Self::Thinned => Some(thin(drive, &draw)),
            Self::Sector => Some(hide_sector(drive, &draw)),
            Self::Quantized => {
                each_return(drive, |z, _, _| ((f64::from(z) / STEP_M).round() * STEP_M) as f32);
                Some(Truth::of("quantization", "step_m", STEP_M))
            }
            Self::Turned => Some(turn(drive)),
            // Without stamps nothing is late, and no second comes.
            Self::Late | Self::Bursts if !has_stamps(drive) => None,
            Self::Late => {
                let late = path.late()?;
                for step in &mut drive.steps {
                    step.reference = step.reference.map(|_| late[0](step.stamp_secs));
                    step.odometry = late[1](step.stamp_secs);
                }
                path.reference.iter_mut().for_each(|(stamp, _)| *stamp -= LATE_SECS);
                Some(Truth::of("time_offset", "delay_secs", -LATE_SECS))
            }
            Self::Bursts => disturb(drive, &draw),
            Self::Disc => draw_disc(drive, &ends(baseline), &draw),
            Self::WallLost => lose_wall(drive, &ends(baseline), &draw),
            Self::OdometryScaled => {
                each_increment(drive, |_, step| {
                    Pose2::new(step.x * (1.0 + ODOMETRY_SCALE), step.y * (1.0 + ODOMETRY_SCALE), step.theta)
                });
                Some(Truth::of("odom_distance_scale", "k", ODOMETRY_SCALE))
            }
            Self::OdometryUnbalanced => {
                let poses: Vec<Option<Pose2>> = drive.steps.iter().map(|step| step.reference).collect();
                each_increment(drive, |i, step| {
                    // Per metre that the robot drives, whatever its odometry reads.
                    let driven = poses[i].zip(poses[i - 1]).map(|(here, before)| here.relative_to(&before));
                    let distance = driven.unwrap_or(step).position().length() * step.x.signum();
                    Pose2::new(step.x, step.y, step.theta + ODOMETRY_TURN_PER_M * distance)
                });
                Some(Truth::of("odom_imbalance", "turn_per_m", ODOMETRY_TURN_PER_M))
            }
            Self::OdometrySlipping => {
                each_increment(drive, |i, step| {
                    let mut rng = draw.item(i as u32);
                    let slips = rng.random::<f64>() < SLIP.0;
                    let noise: f64 = StandardNormal.sample(&mut rng);
                    let factor = if slips { 1.0 + SLIP.1 * noise.abs() } else { 1.0 };
                    Pose2::new(step.x * factor, step.y * factor, step.theta)
                });
                Some(Truth::of("wheel_slip", "p", SLIP.0))
            }
        }
    }
}

/// Loses readings of slanted surfaces.
fn thin(drive: &mut Drive, draw: &Draw) -> Truth {
    let max = drive.laser.max_range();
    let bearings = bearings(drive);
    for (scan, step) in drive.steps.iter_mut().enumerate() {
        let before = step.scan.ranges.clone();
        for (beam, z) in step.scan.ranges.iter_mut().enumerate() {
            let slant = incidence(&before, &bearings, beam, max);
            let chance: f64 = draw.at(scan as u32).item(beam as u32).random();
            if slant.is_some_and(|slant| slant > THINNED.1.to_radians()) && chance < THINNED.0 {
                *z = max;
            }
        }
    }
    Truth::of("incidence_dropout", "p", THINNED.0)
}

/// Reads a part of the robot in a sector.
fn hide_sector(drive: &mut Drive, draw: &Draw) -> Truth {
    let bearings = bearings(drive);
    let width = SECTOR.0.to_radians();
    let (first, last) = (bearings[0], bearings[bearings.len() - 1]);
    let from = first + draw.item(0).random::<f64>() * (last - first - width);
    for (scan, step) in drive.steps.iter_mut().enumerate() {
        for (beam, z) in step.scan.ranges.iter_mut().enumerate() {
            if (from..from + width).contains(&bearings[beam]) {
                let noise: f64 = StandardNormal.sample(&mut draw.at(scan as u32).item(1 + beam as u32));
                *z = (SECTOR.1 + 0.01 * noise) as f32;
            }
        }
    }
    Truth::of("sector_occlusion", "range_m", SECTOR.1)
}

/// Makes readings of some seconds random.
fn disturb(drive: &mut Drive, draw: &Draw) -> Option<Truth> {
    let max = drive.laser.max_range();
    let first = drive.steps.first()?.stamp_secs;
    for (scan, step) in drive.steps.iter_mut().enumerate() {
        let second = (step.stamp_secs - first) as u32;
        if draw.at(u32::MAX - second).item(0).random::<f64>() >= BURSTS.0 {
            continue;
        }
        for (beam, z) in step.scan.ranges.iter_mut().enumerate() {
            let mut rng = draw.at(scan as u32).item(1 + beam as u32);
            if rng.random::<f64>() < BURSTS.1 {
                *z = rng.random::<f32>() * max;
            }
        }
    }
    Some(Truth::of("crosstalk", "p", BURSTS.1))
}

/// Turns the laser by whole beams.
fn turn(drive: &mut Drive) -> Truth {
    let bearings = bearings(drive);
    let spacing = (bearings[1] - bearings[0]).abs();
    let beams = (TURN_DEG.to_radians() / spacing).round().max(1.0);
    for step in &mut drive.steps {
        // Each beam reads what its neighbour `beams` to the left read.
        let before = step.scan.ranges.clone();
        for (beam, z) in step.scan.ranges.iter_mut().enumerate() {
            *z = before.get(beam + beams as usize).copied().unwrap_or(f32::NAN);
        }
    }
    Truth::of("mount_yaw", "yaw_rad", beams * spacing)
}

/// Whether stamps tell the time: they increase, and no robot drives faster than 3 m/s from scan to scan.
fn has_stamps(drive: &Drive) -> bool {
    drive.steps.windows(2).all(|pair| {
        let secs = pair[1].stamp_secs - pair[0].stamp_secs;
        let metres = pair[1].odometry.relative_to(&pair[0].odometry).position().length();
        secs > 0.0 && metres < 3.0 * secs
    })
}

fn bearings(drive: &Drive) -> Vec<f64> {
    drive.laser.bearings().iter().map(|&bearing| f64::from(bearing)).collect()
}

/// Changes each return, by scan and beam; one that becomes too long is lost.
fn each_return(drive: &mut Drive, change: impl Fn(f32, usize, usize) -> f32) {
    let max = drive.laser.max_range();
    for (scan, step) in drive.steps.iter_mut().enumerate() {
        for (beam, z) in step.scan.ranges.iter_mut().enumerate() {
            if *z < max {
                *z = change(*z, scan, beam).min(max);
            }
        }
    }
}

/// Changes each increment of the odometry.
fn each_increment(drive: &mut Drive, change: impl Fn(usize, Pose2) -> Pose2) {
    let increments: Vec<Pose2> = (0..drive.steps.len()).map(|i| drive.odometry_increment(i)).collect();
    let Some(first) = drive.steps.first() else { return };
    let mut pose = first.odometry;
    for (i, (step, increment)) in drive.steps.iter_mut().zip(increments).enumerate().skip(1) {
        pose = pose.compose(&change(i, increment));
        step.odometry = pose;
    }
}

/// Angle between a beam and the normal of the surface that it ends on, by the readings of its neighbours \[rad\]: all to the same
/// number on both sides, the first that are far enough from each other, have to lie on a line. An edge has no slant.
fn incidence(ranges: &[f32], bearings: &[f64], beam: usize, max: f32) -> Option<f64> {
    let end = |i: usize| {
        let z = *ranges.get(i)?;
        (z < max).then(|| [f64::from(z) * bearings[i].cos(), f64::from(z) * bearings[i].sin()])
    };
    for neighbours in 1..=beam {
        let (first, last) = (beam - neighbours, beam + neighbours);
        let (a, b) = (end(first)?, end(last)?);
        let apart = (b[0] - a[0]).hypot(b[1] - a[1]);
        if apart < LINE_M {
            continue;
        }
        let off = |p: [f64; 2]| ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])).abs() / apart;
        for i in first..=last {
            if off(end(i)?) > STRAIGHT_M {
                return None;
            }
        }
        let angle = wrap_angle((b[1] - a[1]).atan2(b[0] - a[0]) - bearings[beam]).abs();
        return Some(std::f64::consts::FRAC_PI_2 - angle.min(std::f64::consts::PI - angle));
    }
    None
}

/// A scan, a beam of it, where the laser was, and where the reading ends in the map \[m\].
type End = (usize, usize, [f64; 2], [f64; 2]);

/// The readings below the maximum range.
fn ends(drive: &Drive) -> Vec<End> {
    let (max, bearings) = (drive.laser.max_range(), bearings(drive));
    let mut ends = Vec::new();
    for (scan, step) in drive.steps.iter().enumerate() {
        let Some(reference) = step.reference else { continue };
        let laser = reference.compose(&drive.laser.base_from_laser());
        for (beam, &z) in step.scan.ranges.iter().enumerate() {
            if z < max {
                let heading = laser.theta + bearings[beam];
                let end = [laser.x + f64::from(z) * heading.cos(), laser.y + f64::from(z) * heading.sin()];
                ends.push((scan, beam, [laser.x, laser.y], end));
            }
        }
    }
    ends
}

/// Draws a disc into the room where many beams pass, of the baseline as well, clear of the robot's way.
fn draw_disc(drive: &mut Drive, baseline: &[End], draw: &Draw) -> Option<Truth> {
    let ends = ends(drive);
    let least = ends.len() / LEAST_SHARE;
    let poses: Vec<[f64; 2]> =
        drive.steps.iter().filter_map(|step| step.reference.map(|pose| [pose.x, pose.y])).collect();
    for trial in 0..400 {
        let mut rng = draw.item(trial);
        let (_, _, from, to) = ends[rng.random_range(0..ends.len())];
        let share: f64 = rng.random_range(0.4..0.8);
        let center = [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])];
        if poses.iter().any(|pose| (pose[0] - center[0]).hypot(pose[1] - center[1]) < CLEAR_M + DISC_M) {
            continue;
        }
        let hidden: Vec<_> =
            ends.iter().filter_map(|end| disc_at(center, end).map(|range| (end.0, end.1, range))).collect();
        let passed = baseline.iter().filter(|end| disc_at(center, end).is_some()).count();
        if hidden.len() < least || (passed as f64) < LOOKED * hidden.len() as f64 {
            continue;
        }
        for (scan, beam, range) in hidden {
            let noise: f64 = StandardNormal.sample(&mut draw.at(1000 + scan as u32).item(beam as u32));
            drive.steps[scan].scan.ranges[beam] = (range + 0.01 * noise) as f32;
        }
        return Some(Truth::of("missing_object", "radius_m", DISC_M));
    }
    None
}

/// Where a beam that passes through a disc meets it, from the laser \[m\].
fn disc_at(center: [f64; 2], &(_, _, laser, end): &End) -> Option<f64> {
    let [x, y] = [end[0] - laser[0], end[1] - laser[1]];
    let range = x.hypot(y);
    let to_center = [center[0] - laser[0], center[1] - laser[1]];
    let along = (to_center[0] * x + to_center[1] * y) / range;
    let across = (to_center[1] * x - to_center[0] * y) / range;
    let chord = DISC_M * DISC_M - across * across;
    let met = along - chord.max(0.0).sqrt();
    (chord > 0.0 && met > 0.0 && met < range).then_some(met)
}

/// Loses all returns of a stretch of wall on which many readings lie, of the baseline as well.
fn lose_wall(drive: &mut Drive, baseline: &[End], draw: &Draw) -> Option<Truth> {
    let ends = ends(drive);
    let least = ends.len() / LEAST_SHARE;
    let max = drive.laser.max_range();
    for trial in 0..400 {
        let at = draw.item(trial).random_range(0..ends.len() - 1);
        let ((scan, _, _, a), (other, _, _, b)) = (ends[at], ends[at + 1]);
        let apart = (b[0] - a[0]).hypot(b[1] - a[1]);
        if scan != other || !(0.02..0.3).contains(&apart) {
            continue;
        }
        let along = [(b[0] - a[0]) / apart, (b[1] - a[1]) / apart];
        let on_wall = |end: &[f64; 2]| {
            let [x, y] = [end[0] - a[0], end[1] - a[1]];
            let (t, off) = (x * along[0] + y * along[1], y * along[0] - x * along[1]);
            t.abs() < 0.5 * WALL_M.0 && off.abs() < WALL_M.1
        };
        let lost: Vec<_> = ends.iter().filter(|(.., end)| on_wall(end)).collect();
        let returned = baseline.iter().filter(|(.., end)| on_wall(end)).count();
        if lost.len() < least || (returned as f64) < LOOKED * lost.len() as f64 {
            continue;
        }
        for &&(scan, beam, ..) in &lost {
            drive.steps[scan].scan.ranges[beam] = max;
        }
        return Some(Truth { effect: Some("glass".to_owned()), strength: None });
    }
    None
}

#[cfg(test)]
mod tests {
    use locsim_core::{DriveStep, Laser, Scan};

    use super::*;

    /// A robot that drives along x at 1 m/s beside a wall at y = 2 m, with 5 beams of 10 degrees.
    fn drive() -> Drive {
        let bearings: Vec<f32> = (0..5).map(|beam| (70.0 + 10.0 * beam as f32).to_radians()).collect();
        let laser = Laser::new(bearings.clone(), vec![0.0; 5], 0.0, 10.0, Pose2::IDENTITY).unwrap();
        let steps = (0..100).map(|i| {
            let pose = Pose2::new(f64::from(i), 0.0, 0.0);
            let ranges = bearings.iter().map(|bearing| 2.0 / bearing.sin()).collect();
            DriveStep {
                stamp_secs: 1.7e9 + f64::from(i),
                odometry: pose,
                reference: Some(pose),
                scan: Scan { ranges },
            }
        });
        Drive { laser, steps: steps.collect() }
    }

    fn edited(edit: Edit) -> Drive {
        let mut drive = drive();
        edit.apply(&mut drive, &mut RobotPath::new(&self::drive()), &self::drive(), 1).unwrap();
        drive
    }

    #[test]
    fn edits_are_what_they_say() {
        assert!((edited(Edit::Biased).steps[3].scan.ranges[2] - 2.1).abs() < 1e-6);
        assert!((edited(Edit::Scaled).steps[3].scan.ranges[2] - 2.06).abs() < 1e-6);
        assert!((edited(Edit::Late).steps[3].reference.unwrap().x - 3.5).abs() < 1e-9);
        assert!((edited(Edit::OdometryScaled).steps[10].odometry.x - 10.5).abs() < 1e-9);
        assert!((edited(Edit::OdometryUnbalanced).steps[10].odometry.theta - 0.5).abs() < 1e-9);
        assert!(edited(Edit::OdometrySlipping).steps[99].odometry.x > 101.0);
        let coarse = edited(Edit::Quantized);
        assert!(coarse.steps.iter().flat_map(|step| &step.scan.ranges).all(|z| (4.0 * z).fract() == 0.0));
        // The wall is met at 20 degrees at most.
        assert_eq!(edited(Edit::Thinned), drive());
    }

    #[test]
    fn the_slant_is_that_of_the_wall() {
        let bearings: Vec<f64> = (70..=90).map(|degrees| f64::from(degrees).to_radians()).collect();
        let mut ranges: Vec<f32> = bearings.iter().map(|bearing| (2.0 / bearing.sin()) as f32).collect();
        let slant = incidence(&ranges, &bearings, 10, 10.0).unwrap();
        assert!((slant - 10.0_f64.to_radians()).abs() < 1e-3, "{slant}");
        // The last beam has neighbours on one side alone, and what stands before the wall is of no line.
        assert_eq!(incidence(&ranges, &bearings, 20, 10.0), None);
        ranges[11] -= 0.1;
        assert_eq!(incidence(&ranges, &bearings, 10, 10.0), None);
    }

    /// Poses of the path keep, and their stamps are the earlier ones of when the robot was there.
    #[test]
    fn the_path_of_late_stamps_is_earlier() {
        let (mut late, mut path) = (drive(), RobotPath::new(&drive()));
        Edit::Late.apply(&mut late, &mut path, &drive(), 1).unwrap();
        let before = RobotPath::new(&drive());
        assert_eq!(path.reference[7].1, before.reference[7].1);
        assert!((before.reference[7].0 - path.reference[7].0 - LATE_SECS).abs() < 1e-6);
    }

    #[test]
    fn what_stands_where_the_baseline_has_not_been_is_no_edit() {
        // The wall is lost nearer, where beams end side by side.
        for (edit, nearer) in [(Edit::Disc, 1.0), (Edit::WallLost, 0.5)] {
            let mut log = drive();
            log.steps.iter_mut().flat_map(|step| &mut step.scan.ranges).for_each(|z| *z *= nearer);
            let mut elsewhere = log.clone();
            for step in &mut elsewhere.steps {
                step.reference = step.reference.map(|pose| Pose2::new(pose.x, 500.0, 0.0));
            }
            let mut today = log.clone();
            let mut path = RobotPath::new(&log);
            assert_eq!(edit.apply(&mut today, &mut path, &elsewhere, 1), None);
            assert_eq!(today, log);
            assert!(edit.apply(&mut today, &mut path, &log, 1).is_some(), "{edit:?}");
            assert_ne!(today, log);
        }
    }

    #[test]
    fn a_log_without_stamps_has_no_late_ones() {
        let mut drive = drive();
        drive.steps.iter_mut().for_each(|step| step.stamp_secs = 0.0);
        let baseline = drive.clone();
        assert_eq!(Edit::Late.apply(&mut drive, &mut RobotPath::new(&baseline), &baseline, 1), None);
    }
}
