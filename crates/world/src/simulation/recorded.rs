use glam::DVec2;
use locsim_core::{Pose2, wrap_angle};

/// The motion through recorded poses: straight and even between two of them, and beyond the ends as next to them.
pub(super) struct RecordedPath<'a> {
    /// Times of the poses, in order \[s\].
    secs: &'a [f64],
    /// `map_from_base`.
    poses: &'a [Pose2],
}

impl<'a> RecordedPath<'a> {
    /// # Panics
    /// If there are not as many times as poses.
    pub fn new(secs: &'a [f64], poses: &'a [Pose2]) -> Self {
        assert_eq!(secs.len(), poses.len(), "times do not match poses");
        Self { secs, poses }
    }

    /// The pose so many seconds after the first; there must be one.
    pub fn pose_at(&self, secs: f64) -> Pose2 {
        let since = |i: usize| self.secs[i] - self.secs[0];
        let i = self.secs.partition_point(|time| time - self.secs[0] <= secs).saturating_sub(1);
        let pose = self.poses[i];
        // The interval after the pose; after the last one, that before it.
        let end = (i + 1).min(self.poses.len() - 1);
        let begin = end.saturating_sub(1);
        let lasting = since(end) - since(begin);
        let share = if lasting > 0.0 { (secs - since(i)) / lasting } else { 0.0 };
        let moved: DVec2 = self.poses[end].position() - self.poses[begin].position();
        let turned = wrap_angle(self.poses[end].theta - self.poses[begin].theta);
        Pose2::new(pose.x + share * moved.x, pose.y + share * moved.y, pose.theta + share * turned)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_path_goes_straight_through_the_poses_and_on_beyond_them() {
        let poses = [Pose2::new(0.0, 0.0, 3.0), Pose2::new(1.0, 0.0, -3.0), Pose2::new(1.0, 1.0, -3.0)];
        let secs = [10.0, 12.0, 13.0];
        let path = RecordedPath::new(&secs, &poses);
        let turned = wrap_angle(-6.0);
        for (secs, pose) in [
            (0.0, poses[0]),
            (1.0, Pose2::new(0.5, 0.0, 3.0 + 0.5 * turned)),
            (2.0, poses[1]),
            (2.5, Pose2::new(1.0, 0.5, -3.0)),
            (3.0, poses[2]),
            (4.0, Pose2::new(1.0, 2.0, -3.0)),
            (-1.0, Pose2::new(-0.5, 0.0, 3.0 - 0.5 * turned)),
        ] {
            let error = path.pose_at(secs).relative_to(&pose);
            assert!(error.position().length() < 1e-12 && error.theta.abs() < 1e-12, "{secs}: {error:?}");
        }
    }

    #[test]
    fn a_single_pose_and_equal_times_stand_still() {
        let pose = Pose2::new(1.0, 2.0, 0.5);
        assert_eq!(RecordedPath::new(&[3.0], &[pose]).pose_at(7.0), pose);
        let other = Pose2::new(2.0, 2.0, 0.5);
        let (secs, poses) = ([3.0, 3.0], [pose, other]);
        assert_eq!(RecordedPath::new(&secs, &poses).pose_at(7.0), other);
    }
}
