//! Whether both drives go the same way. What map and reference err by keeps its direction in the room, and turns around in the frame of a robot that
//! does: it no longer cancels between the logs.

use locsim_core::Pose2;

/// A scan is at another's place within this \[m\].
const SAME_PLACE_M: f64 = 1.0;
/// Scans of a log that are looked at, evenly spread.
const MOST_SCANS: usize = 1000;

/// Share of today's scans within a metre of the baseline's that look the other way than the nearest of these; 0 where there are none.
pub(crate) fn share_reversed(baseline: &[Pose2], today: &[Pose2]) -> f64 {
    let evenly = |poses: &[Pose2]| -> Vec<Pose2> {
        poses.iter().copied().step_by(poses.len().div_ceil(MOST_SCANS).max(1)).collect()
    };
    let [baseline, today] = [baseline, today].map(evenly);
    let apart = |a: &Pose2, b: &Pose2| a.position().distance(b.position());
    let nearest = |pose: &Pose2| {
        let nearest = baseline.iter().min_by(|a, b| apart(a, pose).total_cmp(&apart(b, pose)));
        nearest.filter(|other| apart(other, pose) <= SAME_PLACE_M)
    };
    let met = today.iter().filter_map(|pose| Some((pose.theta - nearest(pose)?.theta).cos()));
    let met: Vec<f64> = met.collect();
    met.iter().filter(|cosine| **cosine < 0.0).count() as f64 / met.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    #[test]
    fn a_drive_the_other_way_is_seen() {
        let drive =
            |theta: f64, y: f64| (0..20).map(|i| Pose2::new(f64::from(i), y, theta)).collect::<Vec<_>>();
        let share = |theta: f64, y: f64| share_reversed(&drive(0.1, 0.0), &drive(theta, y));
        assert_eq!([share(PI, 0.5), share(-0.3, 0.5), share(PI, 3.0)], [1.0, 0.0, 0.0]);
    }
}
