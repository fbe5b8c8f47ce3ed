use thiserror::Error;

use crate::Pose2;

/// Why poses and times make no [`Track`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum TrackError {
    /// There is no pose.
    #[error("a track needs at least one pose")]
    NoPoses,
    /// A time is not finite, or earlier than the one before it.
    #[error("time {index} of a track is not finite, or earlier than the time before it")]
    Time {
        /// Its index.
        index: usize,
    },
}

/// Poses of a robot with their times, in order; between them the robot moves evenly.
///
/// Times count from the first pose, so that stamps since 1970 lose no precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    secs: Vec<f64>,
    poses: Vec<Pose2>,
}

impl Track {
    /// A track of (time \[s\], pose) pairs. Times may start anywhere and may repeat.
    ///
    /// # Errors
    /// [`TrackError`] for no poses, and for times that are not finite or decrease.
    pub fn new(stamped: impl IntoIterator<Item = (f64, Pose2)>) -> Result<Self, TrackError> {
        let (mut secs, poses): (Vec<f64>, Vec<Pose2>) = stamped.into_iter().unzip();
        let first = *secs.first().ok_or(TrackError::NoPoses)?;
        let mut last = first;
        for (index, secs) in secs.iter_mut().enumerate() {
            if !(secs.is_finite() && *secs >= last) {
                return Err(TrackError::Time { index });
            }
            last = *secs;
            *secs -= first;
        }
        Ok(Self { secs, poses })
    }

    /// The same times with other poses.
    ///
    /// # Panics
    /// If there is not one pose for each time.
    #[must_use]
    pub fn with_poses(&self, poses: Vec<Pose2>) -> Self {
        assert_eq!(self.secs.len(), poses.len(), "one pose for each time");
        Self { secs: self.secs.clone(), poses }
    }

    /// Time of each pose since the first \[s\].
    pub fn secs(&self) -> &[f64] {
        &self.secs
    }

    /// The poses.
    pub fn poses(&self) -> &[Pose2] {
        &self.poses
    }

    /// Number of poses, at least 1.
    #[expect(clippy::len_without_is_empty, reason = "a track is never empty")]
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// The pose `secs` after the first one.
    ///
    /// The position moves along a straight line and the heading along its shortest turn, both at constant rates. Before
    /// the first pose and after the last one, the motion of the nearest interval goes on. A single pose, and an interval
    /// without duration, stand still. At the time of a pose the result is that pose bit for bit; of several at one
    /// time it is the last.
    pub fn pose_at(&self, secs: f64) -> Pose2 {
        let i = self.secs.partition_point(|&time| time <= secs).saturating_sub(1);
        // After the last pose, the interval before it, followed backwards by a negative share.
        let other = if i + 1 < self.len() { i + 1 } else { i.saturating_sub(1) };
        let duration = self.secs[other] - self.secs[i];
        let share = if duration == 0.0 { 0.0 } else { (secs - self.secs[i]) / duration };
        self.poses[i].interpolate(&self.poses[other], share)
    }

    /// The pose at a time during the sweep that begins at pose `i`: several sweeps may begin at one time.
    pub fn pose_during(&self, i: usize, secs: f64) -> Pose2 {
        if secs == self.secs[i] { self.poses[i] } else { self.pose_at(secs) }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::wrap_angle;

    fn near(a: &Pose2, b: &Pose2) -> bool {
        a.position().distance(b.position()) < 1e-9 && wrap_angle(a.theta - b.theta).abs() < 1e-9
    }

    /// Two to nine poses at stamps since 1970, at least 10 ms apart.
    fn stamped() -> impl Strategy<Value = Vec<(f64, Pose2)>> {
        let point = (0.01..3.0, -9.0..9.0, -9.0..9.0, -3.0..3.0);
        proptest::collection::vec(point, 2..10).prop_map(|points| {
            let mut stamp = 1.7e9;
            let stamped = points.into_iter().map(|(pause, x, y, theta)| {
                stamp += pause;
                (stamp, Pose2::new(x, y, theta))
            });
            stamped.collect()
        })
    }

    proptest! {
        #[test]
        fn a_track_goes_through_its_poses_bit_for_bit(stamped in stamped()) {
            let track = Track::new(stamped.clone()).unwrap();
            for ((stamp, pose), &secs) in stamped.iter().zip(track.secs()) {
                prop_assert_eq!(secs, stamp - stamped[0].0);
                prop_assert_eq!(track.pose_at(secs), *pose);
            }
        }

        /// Twice the pause from a pose is twice the motion, straight and by the shortest turn, within every interval
        /// and beyond the ends.
        #[test]
        fn motion_is_even_in_every_interval_and_beyond_the_ends(stamped in stamped(), share in 0.0..1.0f64) {
            let track = Track::new(stamped).unwrap();
            let (secs, poses, last) = (track.secs(), track.poses(), track.len() - 1);
            for i in 0..last {
                let (from, to) = (poses[i], poses[i + 1]);
                let turn = wrap_angle(to.theta - from.theta);
                let along = |share: f64| {
                    let moved = share * (to.position() - from.position());
                    Pose2::new(from.x + moved.x, from.y + moved.y, from.theta + share * turn)
                };
                let at = |share: f64| track.pose_at(secs[i] + share * (secs[i + 1] - secs[i]));
                prop_assert!(near(&at(share), &along(share)));
                if i == 0 {
                    prop_assert!(near(&at(-share), &along(-share)));
                }
                if i + 1 == last {
                    prop_assert!(near(&at(1.0 + share), &along(1.0 + share)));
                }
            }
        }

        /// A track seen from elsewhere is the same motion seen from elsewhere.
        #[test]
        fn motion_does_not_depend_on_the_frame(
            stamped in stamped(), x in -9.0..9.0, y in -9.0..9.0, theta in -3.0..3.0, secs in -1.0..30.0f64,
        ) {
            let frame = Pose2::new(x, y, theta);
            let track = Track::new(stamped).unwrap();
            let moved = track.with_poses(track.poses().iter().map(|pose| frame.compose(pose)).collect());
            let (a, b) = (moved.pose_at(secs), frame.compose(&track.pose_at(secs)));
            // Beyond the last pose, rounding grows with the time.
            prop_assert!(a.position().distance(b.position()) < 1e-6, "{a:?} {b:?}");
            prop_assert!(wrap_angle(a.theta - b.theta).abs() < 1e-6, "{a:?} {b:?}");
        }
    }

    #[test]
    fn headings_turn_the_short_way_across_the_cut() {
        let track =
            Track::new([(10.0, Pose2::new(0.0, 0.0, 3.0)), (12.0, Pose2::new(1.0, 0.0, -3.0))]).unwrap();
        let turn = wrap_angle(-6.0);
        for secs in [-1.0, 0.5, 1.0, 3.0] {
            let expected = Pose2::new(0.5 * secs, 0.0, 3.0 + 0.5 * secs * turn);
            assert!(near(&track.pose_at(secs), &expected), "{secs}: {:?}", track.pose_at(secs));
        }
    }

    #[test]
    fn a_single_pose_and_an_interval_without_duration_stand_still() {
        let [one, other] = [Pose2::new(1.0, 2.0, 0.5), Pose2::new(2.0, 2.0, 0.5)];
        assert_eq!(Track::new([(3.0, one)]).unwrap().pose_at(7.0), one);
        let track = Track::new([(3.0, one), (3.0, other)]).unwrap();
        assert_eq!(track.pose_at(7.0), other);
        assert_eq!(track.pose_at(-7.0), one);
    }

    #[test]
    fn times_that_do_not_make_a_track_are_refused() {
        let track = |secs: &[f64]| Track::new(secs.iter().map(|&secs| (secs, Pose2::IDENTITY)));
        assert_eq!(track(&[]), Err(TrackError::NoPoses));
        assert_eq!(track(&[1.0, 0.5]), Err(TrackError::Time { index: 1 }));
        for time in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(track(&[time]), Err(TrackError::Time { index: 0 }));
            assert_eq!(track(&[0.0, time]), Err(TrackError::Time { index: 1 }));
        }
        assert!(track(&[1.0, 1.0]).is_ok());
    }
}
