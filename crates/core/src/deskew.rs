//! Scans of a laser that sweeps while the robot moves, as they were from one place.

use glam::DVec2;

use crate::{Drive, FASTEST, Laser, Scan, Track, resampled};

impl Drive {
    /// The drive with each scan as if all of its beams had been read at its stamp: the robot's motion until a beam's own time, by the odometry
    /// between the scans, is taken out of its reading, and readings are interpolated at the laser's bearings where neighbours are of one
    /// surface. `None` where all beams of a scan have one time, or stamps go backwards.
    pub fn deskewed(&self) -> Option<Self> {
        let times = self.laser.beam_times_secs();
        if times.iter().all(|secs| *secs == times[0]) {
            return None;
        }
        let odometry = Track::new(self.steps.iter().map(|step| (step.stamp_secs, step.odometry))).ok()?;
        let laser = Laser::new(
            self.laser.bearings().to_vec(),
            vec![0.0; times.len()],
            self.laser.min_range(),
            self.laser.max_range(),
            self.laser.base_from_laser(),
        )
        .ok()?;
        // A track counts from its first pose on.
        let begin = self.steps[0].stamp_secs;
        let steps = self.steps.iter().map(|step| {
            let mut step = step.clone();
            step.scan = Scan { ranges: self.at_stamp(&step.scan.ranges, step.stamp_secs - begin, &odometry) };
            step
        });
        Some(Self { laser, steps: steps.collect() })
    }

    fn at_stamp(&self, ranges: &[f32], stamp: f64, odometry: &Track) -> Vec<f32> {
        let (laser, max) = (&self.laser, self.laser.max_range());
        let (bearings, mount) = (laser.bearings(), laser.base_from_laser());
        let from_stamp = odometry.pose_at(stamp).compose(&mount);
        let sweep = laser
            .beam_times_secs()
            .iter()
            .fold(0.0_f32, |sweep, secs| if secs.abs() > sweep.abs() { *secs } else { sweep });
        let over_sweep = odometry.pose_at(stamp + f64::from(sweep)).relative_to(&odometry.pose_at(stamp));
        let secs = f64::from(sweep.abs());
        // The odometry was set anew, and says nothing of the sweep.
        if over_sweep.position().length() > FASTEST.0 * secs || over_sweep.theta.abs() > FASTEST.1 * secs {
            return ranges.to_vec();
        }
        let beams = ranges.iter().zip(bearings).zip(laser.beam_times_secs());
        let seen = beams.map(|((&range, &bearing), &secs)| {
            let taken_from = odometry.pose_at(stamp + f64::from(secs)).compose(&mount);
            let moved = taken_from.relative_to(&from_stamp);
            let bearing = f64::from(bearing);
            if range.is_nan() || range >= max {
                return (bearing + moved.theta, range);
            }
            let point = moved.transform_point(f64::from(range) * DVec2::from_angle(bearing));
            // A return stays one.
            (point.to_angle(), (point.length() as f32).min(max.next_down()))
        });
        resampled(seen, |range| range < max, bearings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DriveStep, Pose2};

    const BEAMS: u32 = 360;
    const HALF_SIDE_M: f64 = 3.0;

    /// Range to the walls of a square room around the origin.
    fn range(from: Pose2, bearing: f64) -> f64 {
        let (sin, cos) = (from.theta + bearing).sin_cos();
        let to_wall = |at: f64, along: f64| {
            if along.abs() < 1e-12 { f64::INFINITY } else { (HALF_SIDE_M * along.signum() - at) / along }
        };
        to_wall(from.x, cos).min(to_wall(from.y, sin))
    }

    /// A robot that turns with 1 rad/s and drives with 0.5 m/s, with a laser that takes a fifth of a second for a turn: five scans.
    fn drive(sweep_secs: f64, direction: f64) -> Drive {
        let bearings: Vec<f32> = (0..BEAMS).map(|i| (direction * f64::from(i)).to_radians() as f32).collect();
        let times: Vec<f32> =
            (0..BEAMS).map(|i| (sweep_secs * f64::from(i) / f64::from(BEAMS)) as f32).collect();
        let laser = Laser::new(bearings, times, 0.1, 3.6, Pose2::new(0.1, 0.05, 2.0)).unwrap();
        let robot = |secs: f64| Pose2::new(0.5 * secs.sin() - 0.2, 0.5 - 0.5 * secs.cos(), secs);
        let steps = (0..6_u32).map(|i| {
            let stamp_secs = 0.2 * f64::from(i);
            let beams = laser.bearings().iter().zip(laser.beam_times_secs());
            let ranges = beams.map(|(bearing, secs)| {
                let from = robot(stamp_secs + f64::from(*secs)).compose(&laser.base_from_laser());
                range(from, f64::from(*bearing)).min(3.6) as f32
            });
            let odometry = robot(stamp_secs);
            let stamp_secs = 1.7e9 + stamp_secs;
            DriveStep { stamp_secs, odometry, reference: None, scan: Scan { ranges: ranges.collect() } }
        });
        let steps = steps.collect();
        Drive { laser, steps }
    }

    /// Readings that are off by up to half a metre come to within millimetres of those from one place, but for some at the corners of the
    /// room and at the border of the maximum range.
    #[test]
    fn a_sweep_becomes_what_was_seen_at_its_stamp() {
        for direction in [1.0, -1.0] {
            let (swept, still) = (drive(0.2, direction), drive(0.0, direction));
            let corrected = swept.deskewed().unwrap();
            let far = |drive: &Drive, step: usize| {
                let pairs = drive.steps[step].scan.ranges.iter().zip(&still.steps[step].scan.ranges);
                pairs.filter(|(a, b)| (**a - **b).abs() > 0.01 || a.is_nan()).count()
            };
            for step in 0..5 {
                assert!(
                    far(&swept, step) > 200 && far(&corrected, step) < 24,
                    "{step}: {}",
                    far(&corrected, step)
                );
            }
            assert!(corrected.laser.beam_times_secs().iter().all(|secs| *secs == 0.0));
        }
        assert!(drive(0.0, 1.0).deskewed().is_none());
    }

    /// Half a circle against the robot's turn ends before its last beams. They have no reading, whatever there is at other bearings.
    #[test]
    fn an_unusable_reading_is_no_return() {
        let mut swept = drive(0.2, -1.0);
        let [bearings, times] =
            [swept.laser.bearings(), swept.laser.beam_times_secs()].map(|all| all[..180].to_vec());
        swept.laser = Laser::new(bearings, times, 0.1, 3.6, swept.laser.base_from_laser()).unwrap();
        swept.steps.iter_mut().for_each(|step| step.scan.ranges.truncate(180));
        let last = |drive: &Drive| drive.deskewed().unwrap().steps[1].scan.ranges[175..].to_vec();
        assert!(last(&swept).iter().all(|range| range.is_nan()), "{:?}", last(&swept));
        swept.steps[1].scan.ranges[20] = f32::NAN;
        assert!(last(&swept).iter().all(|range| range.is_nan()), "{:?}", last(&swept));
    }

    /// An odometry that starts again at the origin moves no reading, and unusable readings stay so.
    #[test]
    fn a_reset_of_the_odometry_is_no_motion() {
        let mut reset = drive(0.2, 1.0);
        for step in &mut reset.steps[3..] {
            step.odometry = Pose2::new(step.odometry.x + 50.0, step.odometry.y, step.odometry.theta);
        }
        reset.steps[1].scan.ranges[100..140].fill(f32::NAN);
        let corrected = reset.deskewed().unwrap();
        assert_eq!(corrected.steps[2].scan, reset.steps[2].scan);
        assert_ne!(corrected.steps[1].scan, reset.steps[1].scan);
        let ranges = &corrected.steps[1].scan.ranges;
        assert!(ranges[115..120].iter().all(|range| range.is_nan()), "{ranges:?}");
        assert!(ranges.iter().filter(|range| range.is_nan()).count() < 45, "{ranges:?}");
    }
}
