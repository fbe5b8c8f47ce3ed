use glam::DVec2;
use locsim_core::{Pose2, wrap_angle};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use super::SimulationError;
use super::error::{FROM_0, check};

/// Below this translation \[m\] its direction is mostly noise of the encoders (the bound that AMCL uses).
const MIN_TRANSLATION_M: f64 = 0.01;

/// Noise of a differential drive's odometry: the odometry motion model (Probabilistic Robotics, table 5.6).
///
/// An increment of the true motion is a rotation, a translation and a second rotation; each is read with
/// Gaussian noise whose variance is
///
/// - `alpha_1 rot^2 + alpha_2 trans^2` for each rotation `rot` \[rad^2\],
/// - `alpha_3 trans^2 + alpha_4 (rot1^2 + rot2^2)` for the translation `trans` \[m^2\].
///
/// As the noise of an increment grows with its square, the noise over a stretch of road depends on how many
/// increments it is cut into: here, one per scan.
///
/// Two usual refinements: a backward motion is a negative translation with small rotations rather than two
/// half turns, and below 1 cm of translation, whose direction says little, the whole rotation counts as the
/// second one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct OdometryNoise {
    alpha: [f64; 4],
}

impl OdometryNoise {
    /// Noise with parameters alpha 1 to 4; all zero for perfect odometry.
    ///
    /// # Errors
    /// [`SimulationError::Parameter`] for an alpha that is negative, above 10,000 or not finite.
    pub fn new(alpha: [f64; 4]) -> Result<Self, SimulationError> {
        for value in alpha {
            check("odometry noise alpha", value, FROM_0.0, FROM_0.1)?;
        }
        Ok(Self { alpha })
    }

    /// alpha 1 to 4.
    pub fn alpha(&self) -> [f64; 4] {
        self.alpha
    }

    /// Draws an odometry increment for a true motion `base_prev_from_base_now`.
    pub fn sample(&self, increment: &Pose2, rng: &mut impl Rng) -> Pose2 {
        let distance = increment.x.hypot(increment.y);
        let trans = if increment.x >= 0.0 { distance } else { -distance };
        let rot1 =
            if distance < MIN_TRANSLATION_M { 0.0 } else { (trans * increment.y).atan2(trans * increment.x) };
        let rot2 = wrap_angle(increment.theta - rot1);

        let [a1, a2, a3, a4] = self.alpha;
        let (rot1_sq, rot2_sq, trans_sq) = (rot1 * rot1, rot2 * rot2, trans * trans);
        let mut noise = |variance: f64| {
            let normal: f64 = StandardNormal.sample(rng);
            variance.sqrt() * normal
        };
        let rot1_noise = noise(a1 * rot1_sq + a2 * trans_sq);
        let trans_noise = noise(a3 * trans_sq + a4 * (rot1_sq + rot2_sq));
        let rot2_noise = noise(a1 * rot2_sq + a2 * trans_sq);

        // The noisy motion, put around the true one so that zero noise gives it back exactly: turn by the
        // first noise, drive the extra way in the direction of travel, turn by the second noise.
        let direction = DVec2::from_angle(rot1);
        let position = DVec2::from_angle(rot1_noise).rotate(increment.position() + trans_noise * direction);
        Pose2::new(position.x, position.y, increment.theta + rot1_noise + rot2_noise)
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Stage};
    use proptest::prelude::*;

    use super::super::fixtures::is_normal_sample;
    use super::*;

    /// Small enough that no sample turns the sign of the translation (8 standard deviations).
    const ALPHA: [f64; 4] = [0.02, 0.008, 0.012, 0.004];

    fn samples(alpha: [f64; 4], increment: &Pose2) -> Vec<Pose2> {
        let noise = OdometryNoise::new(alpha).unwrap();
        let draw = Draw::new(1, Stage::Odometry, 0);
        (0..100_000).map(|i| noise.sample(increment, &mut draw.item(i))).collect()
    }

    /// The increment that turns by `rot1`, drives `trans` (backward if negative), and turns by `rot2`.
    fn increment(rot1: f64, trans: f64, rot2: f64) -> Pose2 {
        Pose2::new(0.0, 0.0, rot1).compose(&Pose2::new(trans, 0.0, 0.0)).compose(&Pose2::new(0.0, 0.0, rot2))
    }

    /// Whether rotations and translations read off the samples have the moments of table 5.6 with `alpha`.
    fn agrees(samples: &[Pose2], [rot1, trans, rot2]: [f64; 3], alpha: [f64; 4]) -> bool {
        let sign = trans.signum();
        let direction = |p: &Pose2| (sign * p.y).atan2(sign * p.x);
        let rot1s: Vec<f64> = samples.iter().map(direction).collect();
        let transs: Vec<f64> = samples.iter().map(|p| sign * p.x.hypot(p.y)).collect();
        let rot2s: Vec<f64> = samples.iter().map(|p| wrap_angle(p.theta - direction(p))).collect();
        let [a1, a2, a3, a4] = alpha;
        is_normal_sample(&rot1s, rot1, a1 * rot1.powi(2) + a2 * trans.powi(2))
            && is_normal_sample(&transs, trans, a3 * trans.powi(2) + a4 * (rot1.powi(2) + rot2.powi(2)))
            && is_normal_sample(&rot2s, rot2, a1 * rot2.powi(2) + a2 * trans.powi(2))
    }

    /// Six moments for each of two motions; an alpha 25 % off changes some variance by at
    /// least 3 %, 7 of its standard errors, and must show.
    #[test]
    fn the_moments_are_those_of_table_5_6_forward_and_backward() {
        for motion in [[0.3, 0.5, -0.2], [-0.2, -0.5, 0.4]] {
            let [rot1, trans, rot2] = motion;
            let samples = samples(ALPHA, &increment(rot1, trans, rot2));
            assert!(agrees(&samples, motion, ALPHA));
            for i in 0..4 {
                let mut wrong = ALPHA;
                wrong[i] *= 1.25;
                assert!(!agrees(&samples, motion, wrong), "alpha {} makes no difference", i + 1);
            }
        }
    }

    #[test]
    fn a_turn_in_place_is_one_rotation_whatever_the_tiny_translation_says() {
        for shift in [0.0, 1e-9, -1e-9] {
            let samples = samples(ALPHA, &Pose2::new(0.0, shift, 0.4));
            let headings: Vec<f64> = samples.iter().map(|p| p.theta).collect();
            assert!(is_normal_sample(&headings, 0.4, ALPHA[0] * 0.16));
            let x: Vec<f64> = samples.iter().map(|p| p.x).collect();
            assert!(is_normal_sample(&x, 0.0, ALPHA[3] * 0.16));
        }
    }

    proptest! {
        #[test]
        fn zero_noise_gives_the_increment_back(x in -1.0..1.0f64, y in -1.0..1.0f64, theta in -3.0..3.0f64) {
            let increment = Pose2::new(x, y, theta);
            let mut rng = Draw::new(1, Stage::Odometry, 0).item(0);
            prop_assert_eq!(OdometryNoise::default().sample(&increment, &mut rng), increment);
        }
    }

    #[test]
    fn standing_still_is_read_without_noise() {
        assert!(samples(ALPHA, &Pose2::IDENTITY).iter().all(|p| *p == Pose2::IDENTITY));
    }

    #[test]
    fn alphas_must_be_finite_and_not_negative() {
        for wrong in [-0.1, f64::NAN, f64::INFINITY, 1e300] {
            let error = OdometryNoise::new([0.1, 0.1, wrong, 0.1]).unwrap_err();
            assert!(error.to_string().contains("alpha must be at least 0"), "{error}");
        }
    }
}
