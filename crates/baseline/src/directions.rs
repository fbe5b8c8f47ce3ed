//! Whether both drives go the same way.

use locsim_core::Pose2;

/// A scan is at another's place within this \[m\].
const SAME_PLACE_M: f64 = 1.0;
/// So many of today's scans have to look the other way for a remark.
const MANY: f64 = 0.5;

/// A remark, where most of today's scans look the other way than the baseline's nearest within a metre: what map and reference err by keeps
/// its direction in the room and turns around in the robot's frame.
pub(crate) fn note(baseline: &[Pose2], today: &[Pose2]) -> Option<String> {
    let apart = |a: &Pose2, b: &Pose2| a.position().distance(b.position());
    let nearest = |pose: &Pose2| {
        let nearest = baseline.iter().min_by(|a, b| apart(a, pose).total_cmp(&apart(b, pose)));
        nearest.filter(|other| apart(other, pose) <= SAME_PLACE_M)
    };
    let met: Vec<f64> =
        today.iter().filter_map(|pose| Some((pose.theta - nearest(pose)?.theta).cos())).collect();
    let reversed = met.iter().filter(|cosine| **cosine < 0.0).count() as f64 / met.len().max(1) as f64;
    (reversed > MANY).then(|| {
        format!(
            "At {:.0} % of the common places the robot drives the other way today. Errors of the map and of the reference, which cancel \
             where both logs go one way, then look like a laser that is displaced by twice as much (`mount_offset`): compare drives in one \
             direction.",
            100.0 * reversed
        )
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    #[test]
    fn a_drive_the_other_way_is_told() {
        let drive =
            |theta: f64, y: f64| (0..20).map(|i| Pose2::new(f64::from(i), y, theta)).collect::<Vec<_>>();
        let told = |theta: f64, y: f64| note(&drive(0.1, 0.0), &drive(theta, y));
        assert!(told(PI, 0.5).unwrap().contains("100 %"));
        assert_eq!((told(-0.3, 0.5), told(PI, 3.0)), (None, None));
    }
}
