use glam::DVec2;
use locsim_core::{Pose2, wrap_angle};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::SimulationError;
use super::error::check;

/// Below this translation [m] its direction says nothing of the motion (the bound that AMCL uses).
const MIN_TRANSLATION_M: f64 = 0.01;

/// Noise of a differential drive's odometry: the odometry motion model (Probabilistic Robotics, table 5.6).
///
/// An increment of the true motion is a rotation, a translation and a second rotation; each is read with Gaussian
/// noise whose variance is
///
/// - `alpha_1 rot^2 + alpha_2 trans^2` for each rotation `rot` [rad^2],
/// - `alpha_3 trans^2 + alpha_4 (rot1^2 + rot2^2)` for the translation `trans` [m^2].
///
/// As the noise of an increment grows with its square, the noise over a stretch of road depends on how many
/// increments it is cut into: here, one per scan.
///
/// Two usual refinements: a backward motion is a negative translation with small rotations rather than two half
/// turns, and below 1 cm of translation, whose direction says little, the whole rotation counts as the second
/// one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OdometryNoise {
    alpha: [f64; 4],
}

impl OdometryNoise {
    /// Noise with parameters alpha 1 to 4; all zero for perfect odometry.
    ///
    /// # Errors
    /// [`SimulationError::Parameter`] for an alpha that is negative or not finite.
    pub fn new(alpha: [f64; 4]) -> Result<Self, SimulationError> {
        for value in alpha {
            check("odometry noise alpha", value, "at least 0", |value| value >= 0.0)?;
        }
        Ok(Self { alpha })
    }

    /// What the odometry reads for a true motion `base_prev_from_base_now`.
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

        // The noisy motion, put around the true one so that zero noise gives it back exactly: turn by the first
        // noise, drive the extra way in the direction of travel, turn by the second noise.
        let direction = DVec2::from_angle(rot1);
        let position = DVec2::from_angle(rot1_noise).rotate(increment.position() + trans_noise * direction);
        Pose2::new(position.x, position.y, increment.theta + rot1_noise + rot2_noise)
    }
}
