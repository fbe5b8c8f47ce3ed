use glam::DVec3;
use thiserror::Error;

use crate::{Drive, Folds, Laser, Pose2, Track, TrackError, median, wrap_angle};

/// A fold lasts about so long \[s\], and has so many scans. Readings so far apart share little clutter and little error of the
/// reference; what comes and goes in ten seconds can still be learnt from the folds about one that is held out.
const FOLD_SECS: f64 = 2.0;
const FOLD_SCANS: std::ops::RangeInclusive<usize> = 5..=20;

/// Two of the largest folds, the least that an effect can be fitted to and scored on apart.
pub const LEAST_SCANS: usize = 40;

/// Why no part of a log can be held against a simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum RecordedError {
    /// Too few scans have a reference pose.
    #[error("only {scans} scans with a reference pose in the map's free space; at least {least} are needed")]
    TooFewScans {
        /// How many there are.
        scans: usize,
        /// How many it takes.
        least: usize,
    },
    /// The reference poses and their stamps make no track.
    #[error(transparent)]
    Track(#[from] TrackError),
}

/// The part of a measured log that is held against a simulation: scans with reference poses, in order.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The log's laser with the beams that are looked at.
    pub laser: Laser,
    /// Index of each of them among the log's beams.
    pub kept: Vec<usize>,
    /// The log's laser with all its beams.
    pub log_laser: Laser,
    /// Pose of each scan that beams are cast from, `map_from_base`: its reference pose with the errors taken off that are known.
    pub track: Track,
    /// What was added to each reference pose, x, y \[m\] and heading \[rad\].
    pub corrections: Vec<DVec3>,
    /// Stamp of the first scan \[s\].
    pub begin_secs: f64,
    /// Reference poses between the scans as well, where they are known or scans were left out; see [`Recorded::along`].
    pub along: Option<Track>,
    /// What these err by from one to the next.
    pub jitter: PoseJitter,
    /// `odom_from_base` at each scan.
    pub odometry: Vec<Pose2>,
    /// Readings \[m\], \[scan\]\[beam\].
    pub readings: Vec<f32>,
    /// The beams that aren't looked at, as the map doesn't say where they end; empty where all are.
    pub ignored: Vec<bool>,
    /// Stretches of the log for cross-validation.
    pub folds: Folds,
}

impl Recorded {
    /// Takes at most `scans` scans and `beams` beams of a log: beams evenly spread, scans one stretch from its first
    /// with a reference pose for which `usable` holds, so that motion between neighbours is kept.
    ///
    /// # Errors
    /// [`RecordedError::TooFewScans`] below 40 scans; [`RecordedError::Track`] for stamps that decrease.
    pub fn new(
        drive: &Drive,
        scans: usize,
        beams: usize,
        usable: impl Fn(&Pose2) -> bool,
    ) -> Result<Self, RecordedError> {
        let (laser, kept) = drive.laser.thinned(beams);
        let steps: Vec<_> = drive
            .steps
            .iter()
            .filter_map(|step| Some((step, step.reference?)))
            .filter(|(_, pose)| usable(pose))
            .take(scans)
            .collect();
        if steps.len() < LEAST_SCANS {
            return Err(RecordedError::TooFewScans { scans: steps.len(), least: LEAST_SCANS });
        }
        let track = Track::new(steps.iter().map(|&(step, pose)| (step.stamp_secs, pose)))?;
        Ok(Self {
            laser,
            log_laser: drive.laser.clone(),
            begin_secs: steps[0].0.stamp_secs,
            along: None,
            jitter: PoseJitter::default(),
            folds: Folds::new(&track, FOLD_SECS, FOLD_SCANS),
            corrections: vec![DVec3::ZERO; track.len()],
            track,
            odometry: steps.iter().map(|(step, _)| step.odometry).collect(),
            readings: steps
                .iter()
                .flat_map(|(step, _)| kept.iter().map(|&beam| step.scan.ranges[beam]))
                .collect(),
            kept,
            ignored: Vec::new(),
        })
    }

    /// The same with reference poses, by their stamps \[s\], between the scans as well: scans that are left out tell where the robot
    /// was when beams are taken late. Stamps that decrease tell nothing.
    #[must_use]
    pub fn along(self, stamped: impl IntoIterator<Item = (f64, Pose2)>) -> Self {
        let first = (self.begin_secs, self.track.poses()[0]);
        let since = stamped.into_iter().filter(|(secs, _)| *secs > self.begin_secs);
        let along = Track::new(std::iter::once(first).chain(since)).ok();
        let jitter = along.as_ref().map(PoseJitter::of).unwrap_or_default();
        Self { along, jitter, ..self }
    }

    /// Time from the first beam of a scan to the last \[s\].
    pub fn sweep_secs(&self) -> f64 {
        self.log_laser.beam_times_secs().iter().copied().fold(0.0, f32::max).into()
    }

    /// The pose that beams of a scan are cast from which are taken some time after the first scan.
    pub fn pose_at(&self, scan: usize, secs: f64) -> Pose2 {
        if secs == self.track.secs()[scan] {
            return self.track.poses()[scan];
        }
        self.along.as_ref().unwrap_or(&self.track).pose_at(secs).moved(self.corrections[scan])
    }

    /// Number of scans.
    pub fn scans(&self) -> usize {
        self.track.len()
    }

    /// Beams per scan.
    pub fn beams(&self) -> usize {
        self.laser.beam_count()
    }

    /// The same drive with other readings and odometry: what a simulation of it gives.
    #[must_use]
    pub fn with(&self, readings: Vec<f32>, odometry: Vec<Pose2>) -> Self {
        Self { odometry, readings, ..self.clone() }.masked()
    }

    /// The same with beams cast from the reference poses plus a correction of each scan's, x, y \[m\] and heading \[rad\].
    #[must_use]
    pub fn corrected(&self, corrections: Vec<DVec3>) -> Self {
        let changes = corrections.iter().zip(&self.corrections).map(|(new, old)| *new - *old);
        let poses = self.track.poses().iter().zip(changes).map(|(pose, change)| pose.moved(change));
        let track = self.track.with_poses(poses.collect());
        // Between the scans the reference stays: the errors of a scan are those of its whole sweep.
        let along = self.along.clone().or_else(|| Some(self.track.clone()));
        Self { track, corrections, along, ..self.clone() }
    }

    /// Whether beams are cast from other poses than the reference's.
    pub fn is_corrected(&self) -> bool {
        self.corrections.iter().any(|c| *c != DVec3::ZERO)
    }

    /// The same with other reference poses. Beams are cast from where they were.
    #[must_use]
    pub fn with_reference(&self, other: impl Fn(&Pose2) -> Pose2) -> Self {
        let poses = self.track.poses().iter().zip(&self.corrections);
        let corrections = poses.map(|(pose, &c)| pose.error_from(&other(&pose.moved(-c)))).collect();
        let along = self.along.as_ref().unwrap_or(&self.track);
        let along = Some(along.with_poses(along.poses().iter().map(other).collect()));
        Self { corrections, along, ..self.clone() }
    }

    /// The same without the readings of more beams.
    #[must_use]
    pub fn without(&self, ignored: &[bool]) -> Self {
        let mut log = self.clone();
        log.ignored.resize(ignored.len(), false);
        for (known, more) in log.ignored.iter_mut().zip(ignored) {
            *known |= more;
        }
        log.masked()
    }

    fn masked(mut self) -> Self {
        for (reading, _) in self.readings.iter_mut().zip(&self.ignored).filter(|(_, ignored)| **ignored) {
            *reading = f32::NAN;
        }
        self
    }

    /// Velocity of the robot at each scan in the map frame \[m/s, m/s, rad/s\]: from the neighbours' poses.
    pub fn velocities(&self) -> Vec<[f64; 3]> {
        let (n, secs, poses) = (self.scans(), self.track.secs(), self.track.poses());
        (0..n)
            .map(|i| {
                let (a, b) = (i.saturating_sub(1), (i + 1).min(n - 1));
                let secs = (secs[b] - secs[a]).max(1e-6);
                let (from, to) = (&poses[a], &poses[b]);
                let moved = (to.position() - from.position()) / secs;
                [moved.x, moved.y, wrap_angle(to.theta - from.theta) / secs]
            })
            .collect()
    }
}

/// What poses between scans err by from one to the next, of x and of y \[m\] and of the heading \[rad\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseJitter {
    /// Standard deviation of the noise of each pose, as of motion capture.
    pub white: [f64; 2],
    /// Standard deviation of a random walk after a second, as of wheels; it grows with the root of the time.
    pub walk: [f64; 2],
}

impl PoseJitter {
    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// That of a track, from its second differences over equal steps and over longer ones: noise is as large in both, and a random walk grows
    /// with the steps (variances). Their median has none of a few accelerations. Poses that are interpolated show in the longer steps alone.
    fn of(track: &Track) -> Self {
        let evenly = |stride: usize| evenly_timed(track.secs(), 2 * stride);
        let (stride, even) = LONGER_STEPS
            .map(|stride| (stride, evenly(stride)))
            .into_iter()
            .find(|(_, even)| even.len() >= LEAST_DIFFERENCES)
            .unwrap_or_default();
        if even.is_empty() {
            return Self::default();
        }
        let [once, longer] = [1, stride].map(|stride| second_differences(track.poses(), stride, &even));
        let more = 2.0 * (stride as f64 - 1.0);
        let walk = [0, 1].map(|i| ((longer[i] - once[i]) / more).max(0.0));
        let white = [0, 1].map(|i| ((once[i] - 2.0 * walk[i]).max(0.0) / 6.0).sqrt());
        let secs = track.secs();
        let step_secs = median(&mut even.iter().map(|i| secs[i + 1] - secs[*i]).collect::<Vec<_>>());
        Self { white, walk: walk.map(|variance| (variance / step_secs).sqrt()) }
    }
}

/// Steps that second differences are over beside single ones, the longest of which there are enough.
const LONGER_STEPS: [usize; 2] = [4, 2];
/// Fewer differences tell nothing.
const LEAST_DIFFERENCES: usize = 100;

/// Numbers of the times after which so many steps are as long as each other.
fn evenly_timed(secs: &[f64], steps: usize) -> Vec<usize> {
    let is_even = |i: &usize| {
        let steps = secs[*i..=i + steps].array_windows().map(|[a, b]| b - a);
        let (least, most) =
            steps.fold((f64::INFINITY, 0.0_f64), |(least, most), step| (least.min(step), most.max(step)));
        least > 1e-6 && most < 1.1 * least
    };
    (0..secs.len().saturating_sub(steps)).filter(is_even).collect()
}

/// Variances of second differences of poses over `stride` steps that begin at these, by their median: of x and of y \[m^2\], and of the heading
/// \[rad^2\].
fn second_differences(poses: &[Pose2], stride: usize, begins: &[usize]) -> [f64; 2] {
    /// Standard deviation of a normal variable over the median of its size.
    const OF_MEDIAN: f64 = 1.482_602_2;
    let [mut of_position, mut of_heading] = [Vec::new(), Vec::new()];
    for begin in begins {
        let [a, b, c] = [0, stride, 2 * stride].map(|k| &poses[begin + k]);
        let second = c.error_from(b) - b.error_from(a);
        of_position.extend([second.x.abs(), second.y.abs()]);
        of_heading.push(second.z.abs());
    }
    [of_position, of_heading].map(|mut sizes| (OF_MEDIAN * median(&mut sizes)).powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DriveStep, Scan};

    fn recorded() -> Recorded {
        let laser = Laser::new(vec![0.0, 0.1, 0.2], vec![0.0; 3], 0.1, 10.0, Pose2::IDENTITY).unwrap();
        let step = |i: u32| DriveStep {
            stamp_secs: 5.0 + f64::from(i),
            odometry: Pose2::IDENTITY,
            reference: Some(Pose2::new(f64::from(i), 0.0, 0.0)),
            scan: Scan { ranges: vec![1.0; 3] },
        };
        let drive = Drive { laser, steps: (0..50).map(step).collect() };
        Recorded::new(&drive, 50, 3, |_| true).unwrap()
    }

    /// The beams of a sweep share the correction of its scan, along the path that the reference has between scans. Another reference moves no
    /// beam.
    #[test]
    fn a_sweep_has_the_correction_of_its_scan() {
        let log = recorded().along([(6.5, Pose2::new(1.5, 0.25, 0.0)), (7.0, Pose2::new(2.0, 0.0, 0.0))]);
        let mut corrections = vec![DVec3::ZERO; 50];
        corrections[1] = DVec3::new(0.0, 0.125, 0.0);
        let corrected = log.corrected(corrections.clone());
        assert!(!log.is_corrected() && corrected.is_corrected());
        assert_eq!(log.pose_at(1, 1.5), Pose2::new(1.5, 0.25, 0.0));
        assert_eq!(corrected.pose_at(1, 1.5), Pose2::new(1.5, 0.375, 0.0));
        assert_eq!(corrected.pose_at(1, 1.0), Pose2::new(1.0, 0.125, 0.0));
        assert_eq!(corrected.pose_at(2, 2.0), Pose2::new(2.0, 0.0, 0.0));
        let shifted = corrected.with_reference(|pose| Pose2::new(pose.x + 0.5, pose.y, pose.theta));
        assert_eq!(shifted.track, corrected.track);
        assert!(shifted.corrections.iter().zip(&corrections).all(|(a, b)| (*a - *b).x == -0.5));
        assert_eq!(corrected.corrected(vec![DVec3::ZERO; 50]).track, log.track);
    }
}
