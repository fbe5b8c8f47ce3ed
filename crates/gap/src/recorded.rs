use locsim_core::{Drive, Folds, Laser, Pose2, Track, wrap_angle};

use crate::GapError;

/// A fold lasts about so long \[s\], and has so many scans. Readings so far apart share little clutter and little error of the
/// reference; what comes and goes in ten seconds can still be learnt from the folds about one that is held out.
const FOLD_SECS: f64 = 2.0;
const FOLD_SCANS: std::ops::RangeInclusive<usize> = 5..=20;

/// Two of the largest folds, the least that an effect can be fitted to and scored on apart.
pub const LEAST_SCANS: usize = 40;

/// The part of a measured log that is held against the simulation: scans with reference poses, in order.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The log's laser with the beams that are looked at.
    pub laser: Laser,
    /// Index of each of them among the log's beams.
    pub kept: Vec<usize>,
    /// The log's laser with all its beams.
    pub log_laser: Laser,
    /// Reference pose of each scan, `map_from_base`.
    pub track: Track,
    /// Stamp of the first scan \[s\].
    pub(crate) begin_secs: f64,
    /// Reference poses between the scans as well, where scans were left out.
    pub(crate) along: Option<Track>,
    /// `odom_from_base` at each scan.
    pub odometry: Vec<Pose2>,
    /// Readings \[m\], \[scan\]\[beam\].
    pub readings: Vec<f32>,
    /// The beams that aren't looked at, as the map doesn't say where they end; empty where all are.
    pub(crate) ignored: Vec<bool>,
    pub(crate) folds: Folds,
}

impl Recorded {
    /// Takes at most `scans` scans and `beams` beams of a log: beams evenly spread, scans one stretch from its first
    /// with a reference pose for which `usable` holds, so that motion between neighbours is kept.
    ///
    /// # Errors
    /// [`GapError::TooFewScans`] below 40 scans; [`GapError::Track`] for stamps that decrease.
    pub fn new(
        drive: &Drive,
        scans: usize,
        beams: usize,
        usable: impl Fn(&Pose2) -> bool,
    ) -> Result<Self, GapError> {
        let (laser, kept) = drive.laser.thinned(beams);
        let steps: Vec<_> = drive
            .steps
            .iter()
            .filter_map(|step| Some((step, step.reference?)))
            .filter(|(_, pose)| usable(pose))
            .take(scans)
            .collect();
        if steps.len() < LEAST_SCANS {
            return Err(GapError::TooFewScans { scans: steps.len(), least: LEAST_SCANS });
        }
        let track = Track::new(steps.iter().map(|&(step, pose)| (step.stamp_secs, pose)))?;
        Ok(Self {
            laser,
            log_laser: drive.laser.clone(),
            begin_secs: steps[0].0.stamp_secs,
            along: None,
            folds: Folds::new(&track, FOLD_SECS, FOLD_SCANS),
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
        Self { along: Track::new(std::iter::once(first).chain(since)).ok(), ..self }
    }

    /// The reference pose some time after the first scan.
    pub(crate) fn pose_at(&self, secs: f64) -> Pose2 {
        self.along.as_ref().unwrap_or(&self.track).pose_at(secs)
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

    /// The same with other reference poses.
    pub(crate) fn with_reference(&self, other: impl Fn(&Pose2) -> Pose2) -> Self {
        let of = |track: &Track| track.with_poses(track.poses().iter().map(&other).collect());
        Self { track: of(&self.track), along: self.along.as_ref().map(of), ..self.clone() }
    }

    /// The same without the readings of more beams.
    pub(crate) fn without(&self, ignored: &[bool]) -> Self {
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
