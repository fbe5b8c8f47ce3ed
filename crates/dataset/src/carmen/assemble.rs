use std::f64::consts::PI;
use std::path::Path;

use locsim_core::{Drive, DriveStep, Laser, Pose2, Scan, circular_mean, wrap_angle};

use super::parse::{Log, ScanLine};
use super::{CarmenLaser, CarmenOptions};
use crate::beams::Beams;
use crate::laser::checked;
use crate::{DatasetError, LogKind, LogSummary, MountSource, OdometrySource};

/// Where the SICK LMS in centimetre mode begins to count error codes instead of distances (m).
/// Range from which a reading of a SICK LMS is no return \[m\]: that of lines which don't say theirs.
pub const SICK_MAX_RANGE: f32 = 81.83;

/// Poses nearer than this (m, rad) are the same pose, printed twice.
const SAME: f64 = 1e-6;

/// The laser's pose on the robot varies by more than this (m, rad) only if one of the two was corrected.
const RIGID: f64 = 0.02;

/// A robot moves no farther than this from an ODOM line to the scan after it (m).
const MOST_MOVED: f64 = 0.5;

/// An ODOM line may be logged so much later than it was taken (m).
const MOST_LATE: f64 = 0.1;

/// Times may go backwards this far (s) because messages were logged out of order; further back, the clock was
/// set or wrapped.
const BACKWARDS: f64 = 60.0;

/// Stamps that go backwards by more than this (s) weren't just logged out of order.
const MOST_HELD_SECS: f64 = 1.0;

/// No two scans of a log are further apart in time (s).
const LEAP: f64 = 1e6;

/// Between two ODOM lines that are no further apart in time (s) the robot is taken to move evenly.
const EVEN_SECS: f64 = 0.5;

/// Turns the lines of a log into a drive.
pub fn assemble(log: Log, options: &CarmenOptions, path: &Path) -> Result<(Drive, LogSummary), DatasetError> {
    let recognised = Recognised::from(&log);
    let (mount, mount_source) = mount(&log, recognised.kind, options.laser);
    let (poses, intervals_without_odometry) = poses(&log, &recognised, &mount);
    let laser = laser(&log, options, mount, path)?;

    let (max, min) = (laser.max_range(), laser.min_range());
    let mut clock = Clock::default();
    let mut steps = Vec::with_capacity(log.scans.len());
    let (mut no_return, mut unusable, mut longest) = (0_usize, 0_usize, None);
    for (mut scan, (odometry, reference)) in log.scans.into_iter().zip(poses) {
        for range in &mut scan.ranges {
            if *range >= max {
                *range = max;
                no_return += 1;
            } else if *range < min || *range == 0.0 {
                *range = f32::NAN;
                unusable += 1;
            } else {
                longest = Some(range.max(longest.unwrap_or(0.0)));
            }
        }
        let stamp_secs = clock.stamp(scan.stamp_secs);
        steps.push(DriveStep { stamp_secs, odometry, reference, scan: Scan { ranges: scan.ranges } });
    }
    let readings = (steps.len() * laser.beam_count()) as f64;
    let summary = LogSummary {
        between: Vec::new(),
        remarks: clock.remarks(),
        kind: recognised.kind,
        odometry: recognised.odometry,
        evidence: recognised.evidence,
        scan_source: log.keyword.to_owned(),
        odometry_messages: log.odometry_lines,
        odometry_interval_secs: None,
        reference_messages: log.true_pose_lines,
        reference_deviation: None,
        reference_interval_secs: None,
        references_interpolated: 0,
        mount: mount_source,
        topics: Vec::new(),
        transforms: Vec::new(),
        skipped: log.skipped,
        stamps_repaired: clock.repaired,
        stamps_repeated: clock.repeated,
        scans_dropped: 0,
        intervals_without_odometry,
        no_return_share: no_return as f64 / readings,
        unusable_share: unusable as f64 / readings,
        longest_return_m: longest,
    };
    Ok((Drive { laser, steps }, summary))
}

/// The kind of a log's poses, with the evidence for it.
struct Recognised {
    kind: LogKind,
    odometry: OdometrySource,
    evidence: String,
}

impl Recognised {
    fn from(log: &Log) -> Self {
        let scans = &log.scans;
        let n = scans.len();
        let count = |what: &dyn Fn(&ScanLine) -> bool| scans.iter().filter(|s| what(s)).count();
        let most = |part: usize, of: usize| of > 0 && part * 20 >= of * 19;

        // Without odometry of their own the scans' robot poses stand still while the ODOM lines move.
        let moves =
            |pose: Option<Pose2>| pose.zip(log.first_odometry).is_some_and(|(a, b)| !near(&a, &b, SAME));
        let frozen = n > 1
            && scans.iter().all(|s| s.robot_pose == scans[0].robot_pose)
            && scans.iter().any(|s| moves(s.before.last_odometry.map(|(_, pose)| pose)));
        let own = if frozen { OdometrySource::OdomLines } else { OdometrySource::ScanLines };

        let with_truth = count(&|s| s.before.truth.is_some());
        if with_truth > 0 {
            let evidence = format!("{with_truth} of {n} scans have a TRUEPOS line before them");
            return Self { kind: LogKind::Simulated, odometry: own, evidence };
        }

        // A mapping program that restarts the odometry at each corrected pose leaves three traces.
        let one_pose = count(&|s| near(&s.laser_pose, &s.robot_pose, SAME));
        let follows: Vec<bool> = scans
            .windows(2)
            .filter_map(|w| Some(near(&w[1].before.first_odometry?.1, &w[0].laser_pose, SAME)))
            .collect();
        let restarted = follows.iter().filter(|same| **same).count();
        let at_scan_time = |s: &ScanLine| s.before.last_odometry.filter(|(time, _)| *time == s.stamp_secs);
        let same_time = count(&|s| at_scan_time(s).is_some());
        let contradicted = count(&|s| at_scan_time(s).is_some_and(|(_, p)| !near(&p, &s.robot_pose, SAME)));
        if most(one_pose, n) && most(restarted, follows.len()) && contradicted * 2 > same_time {
            let evidence = format!(
                "laser pose and robot pose are one in {one_pose} of {n} scans, the ODOM line after a scan \
                 repeats its pose in {restarted} of {} intervals, and the ODOM line of the same time before a \
                 scan differs from it in {contradicted} of {same_time} scans",
                follows.len()
            );
            let odometry = OdometrySource::RestartedOdomLines;
            return Self { kind: LogKind::Corrected, odometry, evidence };
        }

        if !frozen {
            let mount = scans[0].laser_pose.relative_to(&scans[0].robot_pose);
            let bent = count(&|s| !near(&s.laser_pose.relative_to(&s.robot_pose), &mount, RIGID));
            if bent * 20 > n {
                let evidence = format!(
                    "the laser's pose on the robot isn't rigid: it differs from the first in {bent} of {n} scans"
                );
                return Self { kind: LogKind::Corrected, odometry: own, evidence };
            }
            let apart = apart_from_lines(scans);
            if apart * 2 > n {
                let evidence = format!(
                    "the scans' robot poses are corrected: farther from the ODOM lines than the robot moves between these \
                     in {apart} of {n} scans"
                );
                let odometry = OdometrySource::OdomLines;
                return Self { kind: LogKind::Corrected, odometry, evidence };
            }
        }
        let evidence = format!(
            "no TRUEPOS line, and nothing shows that the poses of {n} scans were corrected; odometry from {}",
            if frozen { "ODOM lines, because the scans' own doesn't change" } else { "the scans' lines" }
        );
        Self { kind: LogKind::Raw, odometry: own, evidence }
    }
}

/// How many scans have a robot pose that is farther from the ODOM line before them than the robot moves until the one after.
fn apart_from_lines(scans: &[ScanLine]) -> usize {
    let pairs = scans.iter().enumerate().filter_map(|(i, scan)| {
        let (_, before) = scan.before.last_odometry?;
        let after = scans[i + 1..].iter().find_map(|scan| scan.before.first_odometry);
        let moved = after.map_or(MOST_MOVED, |(_, after)| before.position().distance(after.position()));
        let off = before.position().distance(scan.robot_pose.position());
        Some(off > (moved + MOST_LATE).min(MOST_MOVED))
    });
    pairs.filter(|is_apart| *is_apart).count()
}

/// Poses that differ by at most `tolerance` (m, rad) in each component.
fn near(a: &Pose2, b: &Pose2, tolerance: f64) -> bool {
    (a.x - b.x).abs() <= tolerance
        && (a.y - b.y).abs() <= tolerance
        && wrap_angle(a.theta - b.theta).abs() <= tolerance
}

/// `base_from_laser`, and where it was found.
fn mount(log: &Log, kind: LogKind, laser: CarmenLaser) -> (Pose2, MountSource) {
    let params = &log.params;
    let facing = if laser == CarmenLaser::Front { 0.0 } else { PI };
    let noted = [params.offset, params.side_offset, params.angular_offset];
    let mounted = |s: &ScanLine| s.laser_pose.relative_to(&s.robot_pose);
    let one_pose = log.scans.iter().all(|s| near(&s.laser_pose, &s.robot_pose, SAME));
    if noted.iter().any(Option::is_some) || kind == LogKind::Corrected || one_pose {
        let [x, y, theta] = noted.map(Option::unwrap_or_default);
        let is_noted = noted.iter().any(Option::is_some);
        let source = if is_noted { MountSource::Parameters } else { MountSource::Unknown };
        return (Pose2::new(x, y, facing + theta), source);
    }
    let n = log.scans.len() as f64;
    let mean = |of: fn(Pose2) -> f64| log.scans.iter().map(|s| of(mounted(s))).sum::<f64>() / n;
    let heading = circular_mean(log.scans.iter().map(|s| (mounted(s).theta, 1.0)));
    (Pose2::new(mean(|p| p.x), mean(|p| p.y), heading.unwrap_or(facing)), MountSource::ScanLines)
}

/// Odometry and reference of the base at each scan; the number of intervals without odometry.
fn poses(log: &Log, recognised: &Recognised, mount: &Pose2) -> (Vec<(Pose2, Option<Pose2>)>, usize) {
    let laser_from_base = mount.inverse();
    let of_lines = poses_of_lines(&log.scans);
    let mut chained: Option<Pose2> = None;
    let mut previous: Option<Pose2> = None;
    let mut missing = 0;
    let poses = log.scans.iter().zip(of_lines).map(|(scan, of_lines)| {
        let last = scan.before.last_odometry.map(|(_, pose)| pose);
        let odometry = match recognised.odometry {
            // A CARMEN log has no topics and no transforms.
            OdometrySource::ScanLines
            | OdometrySource::Topic
            | OdometrySource::Transforms
            | OdometrySource::Missing => scan.robot_pose,
            OdometrySource::OdomLines => of_lines.or(log.first_odometry).unwrap_or(scan.robot_pose),
            OdometrySource::RestartedOdomLines => {
                let pose = match (chained, previous) {
                    (Some(chained), Some(previous)) => {
                        // A single ODOM line that repeats the scan before it holds no motion.
                        let told =
                            last.filter(|p| scan.before.odometry_lines > 1 || !near(p, &previous, SAME));
                        missing += usize::from(told.is_none());
                        chained.compose(&told.unwrap_or(scan.laser_pose).relative_to(&previous))
                    }
                    _ => scan.laser_pose,
                };
                chained = Some(pose);
                previous = Some(scan.laser_pose);
                pose.compose(&laser_from_base)
            }
        };
        let reference = match recognised.kind {
            LogKind::Raw | LogKind::Referenced | LogKind::Localized => None,
            // The corrected pose is the laser's, for any mount: the end points of Freiburg 079 (noted mount -0.04 m)
            // have an entropy of 9.75 nats with beams from that pose, 9.92 from 0.04 m behind it.
            LogKind::Corrected => Some(scan.laser_pose.compose(&laser_from_base)),
            LogKind::Simulated => scan.before.truth.map(|(truth, then)| {
                if then == odometry { truth } else { truth.compose(&odometry.relative_to(&then)) }
            }),
        };
        (odometry, reference)
    });
    (poses.collect(), missing)
}

/// The pose by ODOM lines at each scan's time: between the line before it and the one after it, where their times say so; otherwise that of the last
/// line before it. `None` before the first line.
fn poses_of_lines(scans: &[ScanLine]) -> Vec<Option<Pose2>> {
    let mut after: Vec<Option<(f64, Pose2)>> = Vec::with_capacity(scans.len());
    let mut next = None;
    for scan in scans.iter().rev() {
        after.push(next);
        next = scan.before.first_odometry.or(next);
    }
    let mut latest = None;
    let at_scan = |(scan, after): (&ScanLine, Option<(f64, Pose2)>)| {
        latest = scan.before.last_odometry.or(latest);
        let (secs, pose): (f64, Pose2) = latest?;
        let steps = [
            scan.before.first_odometry.map(|first| (first, (secs, pose))),
            after.map(|after| ((secs, pose), after)),
        ];
        let step = steps
            .into_iter()
            .flatten()
            .find(|((from, _), (to, _))| (*from..*to).contains(&scan.stamp_secs) && to - from <= EVEN_SECS);
        let between =
            step.map(|((from, a), (to, b))| a.interpolate(&b, (scan.stamp_secs - from) / (to - from)));
        Some(between.unwrap_or(pose))
    };
    scans.iter().zip(after.into_iter().rev()).map(at_scan).collect()
}

fn laser(log: &Log, options: &CarmenOptions, mount: Pose2, path: &Path) -> Result<Laser, DatasetError> {
    let n = log.scans[0].ranges.len();
    let params = &log.params;
    let beams = log.layout.map_or_else(
        || Beams::of_old_line(n, params.resolution, params.field_of_view),
        |layout| layout.beams,
    );
    let of_lines = log.layout.map(|layout| layout.max_range);
    let of_params = params.max_range.filter(|max| *max > 0.0).map(|max| (max as f32).min(SICK_MAX_RANGE));
    let max_range = options.max_range_m.or(of_lines).or(of_params).unwrap_or(SICK_MAX_RANGE);
    let min_range = options.min_range_m.unwrap_or_else(|| params.min_range.unwrap_or(0.0) as f32);
    let interval = params.beam_interval.unwrap_or(0.0);
    let beam_times = (0..n).map(|i| (i as f64 * interval) as f32).collect();
    checked(path, Laser::new(beams.bearings(n), beam_times, min_range, max_range, mount))
}

/// Makes the scans' times never decrease.
#[derive(Default)]
struct Clock {
    last: Option<f64>,
    /// Time that the log's clock has lost since the start (s).
    offset: f64,
    /// The last stamp as it was logged (s).
    logged: f64,
    /// How often the clock was set, and the first time from when to when (s).
    set: (usize, Option<[f64; 2]>),
    /// How many stamps went backwards otherwise, and by how much at the most (s).
    held: (usize, f64),
    repaired: usize,
    repeated: usize,
}

impl Clock {
    fn stamp(&mut self, logged: f64) -> f64 {
        let mut stamp = logged + self.offset;
        if let Some(last) = self.last {
            if !(-BACKWARDS..=LEAP).contains(&(stamp - last)) {
                self.set.0 += 1;
                self.set.1.get_or_insert([self.logged, logged]);
                self.offset = last - logged;
                stamp = f64::NEG_INFINITY;
            }
            if stamp < last {
                if stamp.is_finite() {
                    self.held = (self.held.0 + 1, self.held.1.max(last - stamp));
                }
                self.repaired += 1;
                stamp = last;
            }
            self.repeated += usize::from(stamp == last);
        }
        (self.last, self.logged) = (Some(stamp), logged);
        stamp
    }

    /// Sentences on a clock that was set, and on stamps that are held for long.
    fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if let (count, Some([from, to])) = self.set {
            remarks.push(format!(
                "The log's clock was set, or leapt, {count} times, first from {from:.2} s to {to:.2} s: times go on from there."
            ));
        }
        let (count, most) = self.held;
        if most > MOST_HELD_SECS {
            remarks.push(format!(
                "{count} stamps go backwards, by up to {most:.2} s, as where the clock was set back: their scans have the latest time before them."
            ));
        }
        remarks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_that_go_backwards_are_held_and_leaps_continue() {
        let mut clock = Clock::default();
        let stamps = [10.0, 11.0, 10.9, 12.0, 4e9, 4e9 + 1.0, 5.0, 5.0, 7.0].map(|t| clock.stamp(t));
        assert_eq!(stamps, [10.0, 11.0, 11.0, 12.0, 12.0, 13.0, 13.0, 13.0, 15.0]);
        assert_eq!((clock.repaired, clock.repeated), (3, 4));
        let remarks = clock.remarks();
        assert!(remarks[0].contains("2 times, first from 12.00 s to 4000000000.00 s"), "{remarks:?}");
        assert_eq!((remarks.len(), Clock::default().remarks().len()), (1, 0));
        let mut held = Clock::default();
        assert_eq!([20.0, 17.0, 18.0].map(|t| held.stamp(t)), [20.0; 3]);
        assert!(held.remarks()[0].starts_with("2 stamps go backwards, by up to 3.00 s"));
    }
}
