use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::elementary::ROUND;

/// Brings an angle \[rad\] into (-pi, pi] (REP-103); one that is there keeps its bits.
///
/// Has no branches, for loops over many angles. An angle of more than 2^51 turns, whose neighbouring doubles are
/// turns apart, becomes some angle of the interval.
#[inline]
pub fn wrap_angle(angle: f64) -> f64 {
    let turns = (angle / TAU + ROUND) - ROUND;
    let wrapped = angle - turns * TAU;
    // Outside by rounding only, or -pi itself.
    if wrapped > PI || wrapped <= -PI { PI } else { wrapped }
}

/// Whether a sector of bearings holds the middle of another one. Sectors go counter-clockwise from the first bearing \[rad\].
#[must_use]
pub fn sector_holds_middle([from, to]: [f64; 2], [a, b]: [f64; 2]) -> bool {
    let turn = |from: f64, to: f64| (to - from).rem_euclid(TAU);
    turn(from, a + 0.5 * turn(a, b)) <= turn(from, to)
}

/// Weighted circular mean of angles \[rad\]: the direction of the weighted sum of unit vectors.
///
/// `None` when that sum vanishes, that is, when no direction is preferred.
pub fn circular_mean(angles: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    let sum =
        angles.into_iter().fold(DVec2::ZERO, |sum, (angle, weight)| sum + weight * DVec2::from_angle(angle));
    (sum.length_squared() > 1e-24).then(|| sum.y.atan2(sum.x))
}

/// A pose in the plane, or the rigid transform that takes coordinates of the posed frame to its parent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose2 {
    /// Forward axis of the parent frame \[m\].
    pub x: f64,
    /// Left axis of the parent frame \[m\].
    pub y: f64,
    /// Heading \[rad\], counter-clockwise, in (-pi, pi].
    pub theta: f64,
}

impl Pose2 {
    /// The identity transform.
    pub const IDENTITY: Self = Self { x: 0.0, y: 0.0, theta: 0.0 };

    /// A pose from metres and radians; the heading is wrapped.
    pub fn new(x: f64, y: f64, theta: f64) -> Self {
        Self { x, y, theta: wrap_angle(theta) }
    }

    /// Position \[m\].
    pub fn position(&self) -> DVec2 {
        DVec2::new(self.x, self.y)
    }

    /// Takes a point of the posed frame to the parent frame \[m\].
    pub fn transform_point(&self, point: DVec2) -> DVec2 {
        self.position() + DVec2::from_angle(self.theta).rotate(point)
    }

    /// `a_from_b.compose(&b_from_c)` is `a_from_c`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        let position = self.transform_point(other.position());
        Self::new(position.x, position.y, self.theta + other.theta)
    }

    /// `a_from_b.inverse()` is `b_from_a`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let position = DVec2::from_angle(-self.theta).rotate(-self.position());
        Self::new(position.x, position.y, -self.theta)
    }

    /// `self` seen from `origin`: `parent_from_origin^-1 * parent_from_self`.
    #[must_use]
    pub fn relative_to(&self, origin: &Self) -> Self {
        origin.inverse().compose(self)
    }

    /// The pose at a share of the motion from `self` (0) to `other` (1): along the straight line between the positions
    /// and the shortest turn between the headings. Other shares extrapolate.
    #[must_use]
    pub fn interpolate(&self, other: &Self, share: f64) -> Self {
        let moved = share * (other.position() - self.position());
        let turned = share * wrap_angle(other.theta - self.theta);
        Self::new(self.x + moved.x, self.y + moved.y, self.theta + turned)
    }

    /// The pose with an error added: x, y \[m\] and heading \[rad\].
    #[must_use]
    pub fn moved(&self, error: DVec3) -> Self {
        Self::new(self.x + error.x, self.y + error.y, self.theta + error.z)
    }

    /// What [`Pose2::moved`] adds to `other` to make it this pose.
    #[must_use]
    pub fn error_from(&self, other: &Self) -> DVec3 {
        DVec3::new(self.x - other.x, self.y - other.y, wrap_angle(self.theta - other.theta))
    }

    /// All three components are finite.
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.theta.is_finite()
    }
}

/// Distance driven (signed along the heading) \[m\] and turn \[rad\] from each pose of a track to the next.
pub fn increments(track: &[Pose2]) -> Vec<[f64; 2]> {
    track
        .windows(2)
        .map(|pair| {
            let step = pair[1].relative_to(&pair[0]);
            let forward = DVec2::from_angle(0.5 * step.theta).dot(step.position());
            [forward.signum() * step.position().length(), step.theta]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-1e3..1e3, -1e3..1e3, -10.0..10.0).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
    }

    fn near(a: &Pose2, b: &Pose2) -> bool {
        (a.x - b.x).abs() < 1e-9 && (a.y - b.y).abs() < 1e-9 && wrap_angle(a.theta - b.theta).abs() < 1e-9
    }

    proptest! {
        #[test]
        fn wrapped_angles_lie_in_the_half_open_interval(angle in -1e4..1e4f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!(wrapped > -PI && wrapped <= PI);
            prop_assert!(((angle - wrapped) / TAU - ((angle - wrapped) / TAU).round()).abs() < 1e-9);
        }

        #[test]
        fn a_pose_and_its_inverse_cancel(a in pose()) {
            prop_assert!(near(&a.compose(&a.inverse()), &Pose2::IDENTITY));
        }

        #[test]
        fn composition_is_associative(a in pose(), b in pose(), c in pose()) {
            prop_assert!(near(&a.compose(&b).compose(&c), &a.compose(&b.compose(&c))));
        }

        #[test]
        fn relative_to_undoes_compose(a in pose(), b in pose()) {
            prop_assert!(near(&a.compose(&b).relative_to(&a), &b));
        }
    }

    #[test]
    fn the_wrap_keeps_plus_pi_and_maps_minus_pi_to_it() {
        assert_eq!(wrap_angle(PI), PI);
        assert_eq!(wrap_angle(-PI), PI);
    }

    #[test]
    fn angles_of_the_interval_keep_their_bits_and_all_finite_ones_reach_it() {
        let ulp = f64::EPSILON * 2.0;
        for angle in [0.0, -0.0, 1e-300, 3.0, -3.1, PI - ulp, -PI + ulp, PI] {
            assert_eq!(wrap_angle(angle).to_bits(), angle.to_bits(), "{angle}");
        }
        for angle in [PI + ulp, -PI - ulp, 3.0 * PI, -3.0 * PI, 1e15, -1e16, 1e17, -1e300, f64::MAX] {
            let wrapped = wrap_angle(angle);
            assert!(wrapped > -PI && wrapped <= PI, "{angle}: {wrapped}");
        }
        assert!(wrap_angle(f64::NAN).is_nan() && wrap_angle(f64::INFINITY).is_nan());
    }

    #[test]
    fn headings_either_side_of_the_cut_average_on_the_cut() {
        let mean = circular_mean([(PI - 0.1, 1.0), (-PI + 0.1, 1.0)]).unwrap();
        assert!((mean.abs() - PI).abs() < 1e-12);
        assert_eq!(circular_mean([(0.0, 1.0), (PI, 1.0)]), None);
    }
}
