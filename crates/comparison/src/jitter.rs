//! Noise of reference poses within sweeps: beams of a sweep are seen along poses that err from one to the next.

use glam::DVec3;
use locsim_core::{Draw, Recorded, Stage};
use rand_distr::{Distribution, StandardNormal};

/// Item of a pose's draws of the path, beside those of [`Replay`](crate::Replay).
const JITTER: u32 = 5;

/// Simulated noise of each reference pose, about the mean of its sweep: that mean is an error of the scan's pose.
pub struct Jitter<'a> {
    secs: &'a [f64],
    errors: Vec<DVec3>,
    means: Vec<DVec3>,
}

impl<'a> Jitter<'a> {
    /// Noise as large as a log's; `None` where it has none, or knows no poses between scans.
    pub fn new(recorded: &'a Recorded, seed: u64) -> Option<Self> {
        let along = recorded.along.as_ref().filter(|_| !recorded.jitter.is_none())?;
        let [white, walk] =
            [recorded.jitter.white, recorded.jitter.walk].map(|[m, rad]| DVec3::new(m, m, rad));
        let draw = Draw::new(seed, Stage::Path, 0);
        let mut walked = DVec3::ZERO;
        let mut before = 0.0;
        let error = |(pose, &secs): (usize, &f64)| {
            let mut rng = draw.at(pose as u32).item(JITTER);
            let mut normal = || DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(&mut rng)));
            walked += (secs - before).sqrt() * walk * normal();
            before = secs;
            walked + white * normal()
        };
        let errors: Vec<DVec3> = along.secs().iter().enumerate().map(error).collect();
        let mut jitter = Self { secs: along.secs(), errors, means: Vec::new() };
        let sweep_secs = recorded.sweep_secs();
        let mean = |&begin: &f64| {
            let [from, to] =
                [begin, begin + sweep_secs].map(|t| jitter.secs.partition_point(|secs| *secs < t));
            if from == to {
                // No pose is within the sweep: it is seen from between two.
                return jitter.error_at(begin + 0.5 * sweep_secs);
            }
            jitter.errors[from..to].iter().sum::<DVec3>() / (to - from) as f64
        };
        jitter.means = recorded.track.secs().iter().map(mean).collect();
        Some(jitter)
    }

    /// The noise of a pose at a time during a scan, x, y \[m\] and heading \[rad\].
    pub fn at(&self, scan: usize, secs: f64) -> DVec3 {
        self.error_at(secs) - self.means[scan]
    }

    /// The noise of a pose at a time, with what all poses of a sweep share.
    fn error_at(&self, secs: f64) -> DVec3 {
        let next = self.secs.partition_point(|time| *time <= secs);
        match (next.checked_sub(1), self.errors.get(next)) {
            (Some(before), Some(after)) => {
                let share = (secs - self.secs[before]) / (self.secs[next] - self.secs[before]);
                self.errors[before].lerp(*after, share)
            }
            (Some(last), None) => self.errors[last],
            (None, _) => self.errors[0],
        }
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::{Pose2, PoseJitter};

    use super::*;
    use crate::fixtures::{DRIVE, TRUTH};

    /// The noise has the size that it is given at each pose, and the mean of a sweep has none.
    #[test]
    fn noise_of_poses_is_about_the_mean_of_each_sweep() {
        let times: Vec<f32> = (0..72_u8).map(|beam| 0.1 * f32::from(beam) / 72.0).collect();
        let drive = locsim_core::Drive {
            laser: DRIVE.laser.clone().with_beam_times(&times).unwrap(),
            ..DRIVE.clone()
        };
        let recorded = Recorded::new(&drive, 170, 72, |_| true).unwrap();
        assert!(Jitter::new(&recorded, 1).is_none());
        let begin = recorded.begin_secs;
        let end = recorded.track.secs()[169];
        let between = (0..).map(|i| 0.02 * f64::from(i)).take_while(|secs| *secs < end);
        let between: Vec<(f64, Pose2)> = between.map(|secs| (begin + secs, TRUTH.pose_at(secs))).collect();
        let exact = recorded.clone().along(between.iter().copied());
        assert!(
            exact.jitter.white.iter().chain(&exact.jitter.walk).all(|error| *error < 1e-4),
            "{:?}",
            exact.jitter
        );
        let (white, walk) = ([0.003, 0.001], [0.02, 0.01]);
        // Sweeps that begin and end between two poses, and none at all: what poses walk by in all of the drive isn't in them.
        for sweep_secs in [0.0, 0.004] {
            let times: Vec<f32> = (0..72_u8).map(|beam| sweep_secs * f32::from(beam) / 72.0).collect();
            let laser = DRIVE.laser.clone().with_beam_times(&times).unwrap();
            let short = Recorded::new(&locsim_core::Drive { laser, ..DRIVE.clone() }, 170, 72, |_| true);
            let short = short.unwrap().along(between.iter().copied());
            let erring = Recorded { jitter: PoseJitter { white: [0.0; 2], walk }, ..short };
            let jitter = Jitter::new(&erring, 1).unwrap();
            let farthest = jitter.errors.iter().map(|e| e.truncate().length()).fold(0.0, f64::max);
            let within = recorded.track.secs().iter().enumerate().flat_map(|(scan, &begin)| {
                [0.0, 0.5, 1.0].map(|share| jitter.at(scan, begin + share * f64::from(sweep_secs)))
            });
            let most = within.map(|e| e.truncate().length()).fold(0.0, f64::max);
            // Between two poses 0.02 s apart it walks by 2.8 mm and 2.8 times as much in one of 10^7.
            assert!(farthest > 0.03 && most < 0.01, "{sweep_secs} s: {farthest} m, {most} m");
        }
        for truth in [PoseJitter { white, walk: [0.0; 2] }, PoseJitter { white: [0.0; 2], walk }] {
            let erring = Recorded { jitter: truth, ..exact.clone() };
            let jitter = Jitter::new(&erring, 1).unwrap();
            let (mut square, mut count) = (DVec3::ZERO, 0.0);
            for (scan, &begin) in recorded.track.secs().iter().enumerate().take(165) {
                let errors: Vec<DVec3> =
                    (0..5).map(|i| jitter.at(scan, begin + 0.02 * f64::from(i))).collect();
                assert!(errors.iter().sum::<DVec3>().length() < 1e-3);
                square += errors.iter().map(|e| *e * *e).sum::<DVec3>();
                count += 4.0;
            }
            // About their mean, five poses of a walk have the variance of one step.
            for axis in 0..2 {
                let variance = truth.white[axis].powi(2) + 0.02 * truth.walk[axis].powi(2);
                let found = [square.x, square.z][axis] / count;
                // Of 660 degrees of freedom, five standard errors are 28 %.
                assert!((found / variance - 1.0).abs() < 0.3, "{truth:?}: {found} of {variance}");
            }
            // What poses err by is found again.
            let noisy =
                between.iter().enumerate().map(|(i, (secs, pose))| (*secs, pose.moved(jitter.errors[i])));
            let found = recorded.clone().along(noisy).jitter;
            let near = |found: f64, truth: f64, of: f64| (found - truth).abs() < 0.5 * of;
            for axis in 0..2 {
                assert!(near(found.white[axis], truth.white[axis], white[axis]), "{found:?} {truth:?}");
                assert!(near(found.walk[axis], truth.walk[axis], walk[axis]), "{found:?} {truth:?}");
            }
        }
    }
}
