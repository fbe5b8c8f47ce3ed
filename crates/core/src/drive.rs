use std::sync::Arc;

use thiserror::Error;

use crate::{CAST_REACH, Pose2, Track, TrackError, median, wrap_angle};

/// Reasons for which a laser's description is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LaserError {
    /// There is no beam.
    #[error("a laser needs at least one beam")]
    NoBeams,
    /// Minimum and maximum range are not 0 <= min < max, finite.
    #[error("laser ranges must satisfy 0 <= min < max, finite; got min {min} m, max {max} m")]
    Ranges {
        /// Minimum range \[m\].
        min: f32,
        /// Maximum range \[m\].
        max: f32,
    },
    /// A bearing is not finite.
    #[error("bearing {index} of the laser is not finite")]
    Bearing {
        /// Its index.
        index: usize,
    },
    /// The number of beam times is not the number of bearings.
    #[error("{times} beam times for {bearings} bearings")]
    BeamTimes {
        /// Number of beam times.
        times: usize,
        /// Number of bearings.
        bearings: usize,
    },
}

/// The fixed description of a planar range sensor, as in ROS `sensor_msgs/LaserScan`.
#[derive(Clone, Debug, PartialEq)]
pub struct Laser {
    bearings: Arc<[f32]>,
    beam_times_secs: Arc<[f32]>,
    min_range: f32,
    max_range: f32,
    base_from_laser: Pose2,
}

impl Laser {
    /// A laser with one bearing [rad, laser frame] and one time offset [s, from the scan's stamp] per beam,
    /// its range limits \[m\] and where it is mounted on the robot.
    ///
    /// # Errors
    /// [`LaserError`] for no beams, ranges out of order, bearings that are not finite, lengths that differ.
    pub fn new(
        bearings: Vec<f32>,
        beam_times_secs: Vec<f32>,
        min_range: f32,
        max_range: f32,
        base_from_laser: Pose2,
    ) -> Result<Self, LaserError> {
        if bearings.is_empty() {
            return Err(LaserError::NoBeams);
        }
        if !(min_range >= 0.0 && max_range > min_range && max_range.is_finite()) {
            return Err(LaserError::Ranges { min: min_range, max: max_range });
        }
        if let Some(index) = bearings.iter().position(|b| !b.is_finite()) {
            return Err(LaserError::Bearing { index });
        }
        if beam_times_secs.len() != bearings.len() {
            return Err(LaserError::BeamTimes { times: beam_times_secs.len(), bearings: bearings.len() });
        }
        Ok(Self {
            bearings: bearings.into(),
            beam_times_secs: beam_times_secs.into(),
            min_range,
            max_range,
            base_from_laser,
        })
    }

    /// Bearing of each beam in the laser frame \[rad\].
    pub fn bearings(&self) -> &[f32] {
        &self.bearings
    }

    /// When each beam was taken, seconds after the scan's stamp.
    pub fn beam_times_secs(&self) -> &[f32] {
        &self.beam_times_secs
    }

    /// Number of beams.
    pub fn beam_count(&self) -> usize {
        self.bearings.len()
    }

    /// Minimum range \[m\].
    pub fn min_range(&self) -> f32 {
        self.min_range
    }

    /// Maximum range \[m\]; a reading equal to it means "no return".
    pub fn max_range(&self) -> f32 {
        self.max_range
    }

    /// How far nominal ranges are cast for this laser \[m\]: [`CAST_REACH`] times its maximum range.
    pub fn cast_range(&self) -> f32 {
        CAST_REACH * self.max_range
    }

    /// Where the laser is mounted.
    pub fn base_from_laser(&self) -> Pose2 {
        self.base_from_laser
    }

    /// This laser whose beams are taken at these times \[s, from the scan's stamp\].
    ///
    /// # Errors
    /// [`LaserError::BeamTimes`] for another number of times than of beams.
    pub fn with_beam_times(self, secs: &[f32]) -> Result<Self, LaserError> {
        if secs.len() != self.beam_count() {
            return Err(LaserError::BeamTimes { times: secs.len(), bearings: self.beam_count() });
        }
        Ok(Self { beam_times_secs: secs.into(), ..self })
    }

    /// This laser with at most `count` of its beams, evenly spread, and the index of each kept beam.
    pub fn thinned(&self, count: usize) -> (Self, Vec<usize>) {
        let n = self.beam_count();
        let count = count.clamp(1, n);
        let kept: Vec<usize> = (0..count).map(|i| (2 * i + 1) * n / (2 * count)).collect();
        (self.with_beams(&kept), kept)
    }

    /// This laser with these of its beams.
    fn with_beams(&self, kept: &[usize]) -> Self {
        Self {
            bearings: kept.iter().map(|&i| self.bearings[i]).collect(),
            beam_times_secs: kept.iter().map(|&i| self.beam_times_secs[i]).collect(),
            ..self.clone()
        }
    }
}

/// One sweep of a laser: a range \[m\] per beam.
///
/// A value equal to the laser's maximum range means "no return within range"; NaN means "no usable reading"
/// (for example below the minimum range) and has no influence on a filter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scan {
    /// Range of each beam \[m\].
    pub ranges: Vec<f32>,
}

impl Scan {
    /// Number of usable readings.
    pub fn usable(&self) -> usize {
        self.ranges.iter().filter(|range| !range.is_nan()).count()
    }
}

/// One scan of a drive with the poses recorded at its stamp.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveStep {
    /// Time of the scan \[s\]; never decreasing along a drive.
    pub stamp_secs: f64,
    /// `odom_from_base`: the robot's pose by its odometry alone.
    pub odometry: Pose2,
    /// `map_from_base`: the true pose (simulation) or the reference pose (measured log), where known.
    pub reference: Option<Pose2>,
    /// The sweep.
    pub scan: Scan,
}

/// No indoor robot is faster \[m/s\] or turns faster \[rad/s\].
pub const FASTEST: (f64, f64) = (5.0, 7.0);
/// A robot that has moved by less than this \[m\], a radian counting as a metre, or than a step of its laser's readings may read the
/// same.
const MOVED_M: f64 = 0.005;
/// Fewer returns may all be the same by chance, and so may those of a laser of which half don't change from scan to scan.
const FEWEST_RETURNS: usize = 20;
const MOST_UNCHANGED: f64 = 0.5;
/// Readings that differ by less than this are the same but for rounding \[m\], and so many scans tell the steps of a laser.
const ROUNDING_M: f32 = 1e-5;
const SCANS_FOR_STEP: usize = 100;

/// Odometry that has one pose for so long \[s\] while the robot moves so far \[m\] isn't recorded: readings of it may come more seldom than
/// scans, and references err.
const FROZEN_SECS: f64 = 1.0;
const FROZEN_M: f64 = 0.1;
/// A reference that has one pose for so long while the odometry comes so far away \[m\] isn't recorded: an odometry at rest jitters.
const AWAY_M: f64 = 0.3;
/// No robot moves as evenly as this \[m, rad\], but what is drawn between two poses.
const EVENLY: f64 = 1e-6;

/// A recorded drive, simulated or measured: one laser, many steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// The sensor that took every scan.
    pub laser: Laser,
    /// The scans with odometry and reference, in order of time.
    pub steps: Vec<DriveStep>,
}

impl Drive {
    /// Motion from step `i - 1` to step `i` by odometry, in the frame of the base at `i - 1`; the identity at 0.
    pub fn odometry_increment(&self, i: usize) -> Pose2 {
        if i == 0 {
            return Pose2::IDENTITY;
        }
        self.steps[i].odometry.relative_to(&self.steps[i - 1].odometry)
    }

    /// Gives scans with the stamp of the scan before a time of their own: evenly until the next stamp, and at most `interval_secs` \[s\]
    /// apart. Clocks that stand still, or tick once in several scans, tell no more. Returns how many scans had no time of their own.
    pub fn spread_stamps(&mut self, interval_secs: f64) -> usize {
        let mut spread = 0;
        let mut begin = 0;
        while let Some(stamp) = self.steps.get(begin).map(|step| step.stamp_secs) {
            let others = &self.steps[begin + 1..];
            let same = 1 + others.iter().take_while(|step| step.stamp_secs == stamp).count();
            let until = self.steps.get(begin + same).map(|next| (next.stamp_secs - stamp) / same as f64);
            let each = until.unwrap_or(interval_secs).min(interval_secs);
            for (i, step) in self.steps[begin..begin + same].iter_mut().enumerate() {
                step.stamp_secs = stamp + i as f64 * each;
            }
            spread += same - 1;
            begin += same;
        }
        spread
    }

    /// Indices of the scans that have all readings of the scan before although the robot has moved: a driver has sent a scan again.
    /// Where the laser's steps, its noise or the place let readings stay as they are, none is told.
    pub fn stale_scans(&self) -> Vec<usize> {
        let least = f64::from(self.range_step()).max(MOVED_M);
        let pairs = self.steps.array_windows().enumerate();
        let moved = pairs.filter(|(_, [before, here])| {
            let poses = match (before.reference, here.reference) {
                (Some(before), Some(here)) => [before, here],
                _ => [before.odometry, here.odometry],
            };
            let motion = poses[1].relative_to(&poses[0]);
            motion.position().length().max(motion.theta.abs()) >= least
        });
        let max = self.laser.max_range();
        let unchanged = moved.filter_map(|(i, [before, here])| {
            let readings = before.scan.ranges.iter().zip(&here.scan.ranges);
            let (mut same, mut returns) = (0, 0);
            for (a, b) in readings.filter(|(a, b)| **a < max || **b < max) {
                returns += 1;
                same += usize::from(a == b);
            }
            (returns >= FEWEST_RETURNS).then(|| (i + 1, same as f64 / returns as f64))
        });
        let unchanged: Vec<(usize, f64)> = unchanged.collect();
        let usual = median(&mut unchanged.iter().map(|(_, share)| *share).collect::<Vec<_>>());
        if usual >= MOST_UNCHANGED {
            return Vec::new();
        }
        unchanged.into_iter().filter(|(_, share)| *share == 1.0).map(|(scan, _)| scan).collect()
    }

    /// The least difference between two returns of the laser \[m\]: the step of its readings, if they have one.
    fn range_step(&self) -> f32 {
        let each = (self.steps.len() / SCANS_FOR_STEP).max(1);
        let scans = self.steps.iter().step_by(each);
        let mut returns: Vec<f32> = scans.flat_map(|step| &step.scan.ranges).copied().collect();
        returns.retain(|range| *range < self.laser.max_range());
        returns.sort_by(f32::total_cmp);
        let steps = returns.array_windows().map(|[a, b]| b - a).filter(|step| *step > ROUNDING_M);
        steps.reduce(f32::min).unwrap_or(0.0)
    }

    /// How long the odometry stood still while the reference moved \[s\], in stretches of a second or more, and how far the reference
    /// moved in them \[m\]; 0 where it never did.
    pub fn frozen_odometry(&self) -> [f64; 2] {
        let (mut all, mut here, mut from) = ([0.0; 2], [0.0; 2], None);
        let mut add = |stretch: [f64; 2]| {
            if stretch[0] >= FROZEN_SECS && stretch[1] >= FROZEN_M {
                all.iter_mut().zip(stretch).for_each(|(sum, more)| *sum += more);
            }
        };
        for [before, step] in self.steps.array_windows() {
            match before.reference.zip(step.reference) {
                Some((a, b)) if before.odometry == step.odometry => {
                    // A reference that jitters about one place goes nowhere.
                    let from = from.get_or_insert(a.position());
                    here[0] += step.stamp_secs - before.stamp_secs;
                    here[1] = f64::max(here[1], from.distance(b.position()));
                }
                _ => {
                    add(std::mem::take(&mut here));
                    from = None;
                }
            }
        }
        add(here);
        all
    }

    /// Takes the reference from scans at which it stood still, or crept at one speed, for a second or more while the odometry came 0.3 m farther
    /// away: the last pose was sent again, or what lies between two poses was drawn where the clock was set forward. The scan after them loses it,
    /// too, as its pose may lie between the last one and the next. Returns how long that was \[s\], and how far the odometry came \[m\].
    pub fn drop_frozen_reference(&mut self) -> [f64; 2] {
        let mut all = [0.0; 2];
        let mut first = 0;
        for i in 1..=self.steps.len() {
            if self.goes_on_evenly(first, i) {
                continue;
            }
            let from = &self.steps[first];
            let stretch = &self.steps[first..i];
            let away = stretch.iter().map(|step| step.odometry.position().distance(from.odometry.position()));
            let away = away.fold(0.0, f64::max);
            let stood = [stretch[stretch.len() - 1].stamp_secs - from.stamp_secs, away];
            let crept = from.reference.zip(stretch[stretch.len() - 1].reference);
            let crept = crept.map(|(from, to)| from.position().distance(to.position()));
            let is_frozen = crept.is_some_and(|crept| crept <= FROZEN_M && away >= crept + AWAY_M);
            if is_frozen && stood[0] >= FROZEN_SECS {
                let after = self.steps.len().min(i + 1);
                self.steps[first + 1..after].iter_mut().for_each(|step| step.reference = None);
                all.iter_mut().zip(stood).for_each(|(sum, more)| *sum += more);
            }
            // The last pose of a stretch may be the first of the next.
            first = (first + 1).max(i - 1);
        }
        all
    }

    /// Whether the reference is at scan `i` where it comes from scan `first` at the speed of that scan's interval.
    fn goes_on_evenly(&self, first: usize, i: usize) -> bool {
        let at = |i: usize| {
            let step = self.steps.get(i)?;
            Some((step.stamp_secs, step.reference?))
        };
        let Some(((t0, from), (t, pose))) = at(first).zip(at(i)) else { return false };
        if pose == from {
            return true;
        }
        let Some((t1, next)) = at(first + 1).filter(|(t1, _)| *t1 > t0) else { return false };
        let expected = from.interpolate(&next, (t - t0) / (t1 - t0));
        pose.position().distance(expected.position()) < EVENLY
            && wrap_angle(pose.theta - expected.theta).abs() < EVENLY
    }

    /// The reference poses of the scans that have one.
    ///
    /// # Errors
    /// [`TrackError`] if no scan has one, or if stamps decrease.
    pub fn reference(&self) -> Result<Track, TrackError> {
        Track::new(self.steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?))))
    }

    /// The same drive with at most `count` beams per scan, spread evenly.
    #[must_use]
    pub fn with_beams(&self, count: usize) -> Self {
        let (laser, kept) = self.laser.thinned(count);
        self.seen_by(laser, &kept)
    }

    /// The same drive with every so manieth beam (at least 1), from the first on.
    #[must_use]
    pub fn with_every_beam(&self, stride: usize) -> Self {
        let kept: Vec<usize> = (0..self.laser.beam_count()).step_by(stride.max(1)).collect();
        self.seen_by(self.laser.with_beams(&kept), &kept)
    }

    /// The same drive with these beams, those of `laser`.
    fn seen_by(&self, laser: Laser, kept: &[usize]) -> Self {
        let steps = self
            .steps
            .iter()
            .map(|step| DriveStep {
                scan: Scan { ranges: kept.iter().map(|&i| step.scan.ranges[i]).collect() },
                ..step.clone()
            })
            .collect();
        Self { laser, steps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive of 200 scans, 2 cm apart, of 30 beams that come nearer or stay away as they point, in steps.
    fn past_walls(step_m: f64, beams_that_change: usize) -> Drive {
        let bearings: Vec<f32> = (0..30).map(|beam| 0.1 * beam as f32).collect();
        let laser = Laser::new(bearings, vec![0.0; 30], 0.0, 20.0, Pose2::IDENTITY).unwrap();
        let step = |i: usize| {
            let x = 0.02 * i as f64;
            let range = |beam: usize| {
                let nearer = if beam < beams_that_change { x * (0.1 * beam as f64).cos() } else { 0.0 };
                (((9.0 + 0.37 * beam as f64 - nearer) / step_m).round() * step_m) as f32
            };
            let pose = Pose2::new(x, 0.0, 0.0);
            let ranges = (0..30).map(range).collect();
            DriveStep { stamp_secs: i as f64, odometry: pose, reference: None, scan: Scan { ranges } }
        };
        Drive { laser, steps: (0..200).map(step).collect() }
    }

    /// Scans that are sent again are told; scans of a coarse laser, or of one in a long corridor, are its own, and so are those of a robot
    /// that stands.
    #[test]
    fn a_scan_that_was_sent_again_is_stale() {
        let mut drive = past_walls(0.01, 30);
        assert_eq!(drive.stale_scans(), []);
        for scan in [40, 41, 120] {
            drive.steps[scan].scan = drive.steps[scan - 1].scan.clone();
        }
        assert_eq!(drive.stale_scans(), [40, 41, 120]);
        drive.steps[120].odometry = drive.steps[119].odometry;
        assert_eq!(drive.stale_scans(), [40, 41]);
        for (step_m, beams_that_change) in [(0.25, 30), (0.01, 0), (0.25, 3)] {
            let drive = past_walls(step_m, beams_that_change);
            let same = |pair: &[DriveStep; 2]| pair[0].scan == pair[1].scan;
            assert!(drive.steps.array_windows().any(same) && drive.stale_scans().is_empty(), "{step_m}");
        }
    }

    /// Ten scans a second at 1 m/s: odometry at 5 Hz isn't frozen, one that stops for 2 s is.
    #[test]
    fn odometry_that_stops_while_the_robot_drives_is_frozen() {
        let laser = Laser::new(vec![0.0], vec![0.0], 0.0, 5.0, Pose2::IDENTITY).unwrap();
        let drive = |odometry: &dyn Fn(u32) -> u32| {
            let step = |i: u32| DriveStep {
                stamp_secs: 0.1 * f64::from(i),
                odometry: Pose2::new(0.1 * f64::from(odometry(i)), 0.0, 0.0),
                reference: Some(Pose2::new(0.1 * f64::from(i), 0.0, 0.0)),
                scan: Scan::default(),
            };
            Drive { laser: laser.clone(), steps: (0..60).map(step).collect() }
        };
        assert_eq!(drive(&|i| i / 2 * 2).frozen_odometry(), [0.0; 2]);
        let mut moving = drive(&|i| i);
        assert_eq!(moving.drop_frozen_reference(), [0.0; 2]);
        let known = moving.steps[20].reference;
        moving.steps[21..40].iter_mut().for_each(|step| step.reference = known);
        let [secs, metres] = moving.drop_frozen_reference();
        assert!(secs > 1.0 && metres > 0.1, "{secs} {metres}");
        let without: Vec<usize> =
            (0..moving.steps.len()).filter(|&i| moving.steps[i].reference.is_none()).collect();
        assert_eq!(without, (21..=40).collect::<Vec<_>>());
        // The clock of the reference is set forward at scan 30: what is drawn from there to a pose 5 cm farther and 100 s later.
        let mut set_forward = drive(&|i| i);
        for (i, step) in set_forward.steps.iter_mut().enumerate().skip(30) {
            step.reference = Some(Pose2::new(3.0 + 0.05 * (i - 30) as f64 / 1000.0, 0.0, 0.0));
        }
        let [secs, metres] = set_forward.drop_frozen_reference();
        assert!(secs > 2.5 && metres > 2.5, "{secs} {metres}");
        let has_reference = |i: usize| set_forward.steps[i].reference.is_some();
        assert!((0..=30).all(has_reference) && !(32..60).any(has_reference));
        // Wheels that slip beside a reference that is measured.
        let mut slipping = drive(&|i| i);
        for (i, step) in slipping.steps.iter_mut().enumerate() {
            step.reference = Some(Pose2::new(0.001 * i as f64 + 1e-4 * (i * i % 7) as f64, 0.0, 0.0));
        }
        assert_eq!(slipping.drop_frozen_reference(), [0.0; 2]);
        // An odometry that jitters beside a reference at rest.
        let mut waiting = drive(&|i| 20 + i % 3);
        waiting.steps.iter_mut().for_each(|step| step.reference = known);
        assert_eq!(waiting.drop_frozen_reference(), [0.0; 2]);
        // A robot that stands, and a reference that jitters by a centimetre.
        let mut standing = drive(&|i| i.min(20));
        for (i, step) in standing.steps.iter_mut().enumerate().skip(20) {
            step.reference = Some(Pose2::new(2.0 + 0.01 * (i % 2) as f64, 0.0, 0.0));
        }
        assert_eq!(standing.frozen_odometry(), [0.0; 2]);
        let frozen = drive(&|i| if i > 20 { i.max(40) - 20 } else { i }).frozen_odometry();
        assert!(frozen.iter().all(|number| (number - 2.0).abs() < 1e-9), "{frozen:?}");
    }

    #[test]
    fn scans_of_one_stamp_come_evenly() {
        let laser = Laser::new(vec![0.0], vec![0.0], 0.0, 1.0, Pose2::IDENTITY).unwrap();
        let stamps = [5.0, 5.0, 5.0, 8.0, 8.0, 9.0, 30.0, 30.0, 90.0, 90.0, 90.0];
        let step = |stamp_secs| DriveStep {
            stamp_secs,
            odometry: Pose2::IDENTITY,
            reference: None,
            scan: Scan::default(),
        };
        let mut drive = Drive { laser, steps: stamps.map(step).to_vec() };
        assert_eq!(drive.spread_stamps(2.0), 6);
        let stamps: Vec<f64> = drive.steps.iter().map(|step| step.stamp_secs).collect();
        assert_eq!(stamps, [5.0, 6.0, 7.0, 8.0, 8.5, 9.0, 30.0, 32.0, 90.0, 92.0, 94.0]);
        // No reader gives such stamps, and a program may.
        drive.steps.iter_mut().for_each(|step| step.stamp_secs = f64::NAN);
        assert_eq!(drive.spread_stamps(2.0), 0);
    }
}
