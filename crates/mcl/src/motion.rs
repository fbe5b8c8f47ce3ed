use std::fmt::Debug;

use locsim_core::{Draw, Particles, Pose2, wrap_angle};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::FilterError;
use crate::error::check_alpha;

/// How a robot moves, given what its odometry says of the motion: samples from p(x_t | u_t, x_t-1).
pub trait MotionModel: Debug + Send + Sync {
    /// Moves each particle by a draw from the motion distribution.
    ///
    /// `increment` is the motion since the last step by odometry, `base_prev_from_base_now`. Particle `i` draws
    /// from `draw.item(i)`. With all noise parameters at 0 each pose is composed with `increment`.
    fn propagate(&self, increment: &Pose2, draw: &Draw, particles: &mut Particles);
}

/// Below this translation [m] its direction is mostly noise of the encoders (the bound AMCL uses).
const MIN_TRANSLATION_M: f64 = 0.01;

/// The odometry motion model (Probabilistic Robotics, table 5.6): a rotation, a translation and a second
/// rotation, each with Gaussian noise.
///
/// Two usual refinements. A backward motion is a negative translation with small rotations, not two rotations
/// by half a turn, so that it is as noisy as the same motion forward. Below 1 cm of translation, whose direction
/// says little, the whole rotation counts as the second one in the noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryMotion {
    alpha: [f64; 4],
}

impl OdometryMotion {
    /// Variances of the two rotations [rad^2] and of the translation [m^2] are
    ///
    /// - alpha_1 rot^2 + alpha_2 trans^2 for each rotation `rot`,
    /// - alpha_3 trans^2 + alpha_4 (rot1^2 + rot2^2) for the translation `trans`.
    ///
    /// # Errors
    /// [`FilterError::Option`] where an alpha is negative or not finite.
    pub fn new(alpha: [f64; 4]) -> Result<Self, FilterError> {
        check_alpha(&alpha)?;
        Ok(Self { alpha })
    }
}

impl MotionModel for OdometryMotion {
    fn propagate(&self, increment: &Pose2, draw: &Draw, particles: &mut Particles) {
        let distance = increment.x.hypot(increment.y);
        let sign = if increment.x < 0.0 { -1.0 } else { 1.0 };
        let trans = sign * distance;
        let rot1 = (sign * increment.y).atan2(sign * increment.x);
        let rot2 = wrap_angle(increment.theta - rot1);

        let [a1, a2, a3, a4] = self.alpha;
        let (noise1, noise2) =
            if distance < MIN_TRANSLATION_M { (0.0, increment.theta) } else { (rot1, rot2) };
        let trans_sq = trans * trans;
        let rot1_sigma = (a1 * noise1 * noise1 + a2 * trans_sq).sqrt();
        let rot2_sigma = (a1 * noise2 * noise2 + a2 * trans_sq).sqrt();
        let trans_sigma = (a3 * trans_sq + a4 * (noise1 * noise1 + noise2 * noise2)).sqrt();

        for_each_with_normals(particles, draw, |[n1, n2, n3], x, y, theta| {
            let direction = *theta + rot1 + rot1_sigma * n1;
            let trans = trans + trans_sigma * n2;
            let (sin, cos) = direction.sin_cos();
            *x += trans * cos;
            *y += trans * sin;
            *theta = wrap_angle(direction + rot2 + rot2_sigma * n3);
        });
    }
}

/// The velocity motion model (Probabilistic Robotics, table 5.3): a circular arc and a final rotation, each with
/// Gaussian noise.
///
/// The commanded velocities v and omega are those of the arc that the odometry increment describes; the part of
/// an increment that no arc explains (a sideways slip) is dropped. All the model's standard deviations are
/// linear in v and omega, so multiplied by the interval's length dt they depend on the arc's length v dt and
/// angle omega dt alone: dt cancels, and none is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VelocityMotion {
    alpha: [f64; 6],
}

impl VelocityMotion {
    /// Variances per squared second of v, omega and the final rotation rate gamma are
    ///
    /// - alpha_1 v^2 + alpha_2 omega^2 for v,
    /// - alpha_3 v^2 + alpha_4 omega^2 for omega,
    /// - alpha_5 v^2 + alpha_6 omega^2 for gamma.
    ///
    /// # Errors
    /// [`FilterError::Option`] where an alpha is negative or not finite.
    pub fn new(alpha: [f64; 6]) -> Result<Self, FilterError> {
        check_alpha(&alpha)?;
        Ok(Self { alpha })
    }
}

impl MotionModel for VelocityMotion {
    fn propagate(&self, increment: &Pose2, draw: &Draw, particles: &mut Particles) {
        // An arc's chord points along half its angle and is shorter than the arc by sinc of that half.
        let angle = increment.theta;
        let (sin, cos) = (angle / 2.0).sin_cos();
        let arc = (increment.x * cos + increment.y * sin) / sinc(angle / 2.0);

        let [a1, a2, a3, a4, a5, a6] = self.alpha;
        let (arc_sq, angle_sq) = (arc * arc, angle * angle);
        let arc_sigma = (a1 * arc_sq + a2 * angle_sq).sqrt();
        let angle_sigma = (a3 * arc_sq + a4 * angle_sq).sqrt();
        let final_sigma = (a5 * arc_sq + a6 * angle_sq).sqrt();

        for_each_with_normals(particles, draw, |[n1, n2, n3], x, y, theta| {
            let angle = angle + angle_sigma * n2;
            let chord = (arc + arc_sigma * n1) * sinc(angle / 2.0);
            let (sin, cos) = (*theta + angle / 2.0).sin_cos();
            *x += chord * cos;
            *y += chord * sin;
            *theta = wrap_angle(*theta + angle + final_sigma * n3);
        });
    }
}

/// sin(a) / a, 1 at 0.
fn sinc(a: f64) -> f64 {
    // Below this the series' next term, a^2 / 6, is under half a unit in the last place of 1.
    if a.abs() < 2e-8 { 1.0 } else { a.sin() / a }
}

/// Particles are moved in parallel by runs of this many.
const CHUNK: usize = 1024;

/// Calls `f(normals, x, y, theta)` for each particle, in parallel, with three standard normal numbers of the
/// particle's own.
pub(crate) fn for_each_with_normals(
    particles: &mut Particles,
    draw: &Draw,
    f: impl Fn([f64; 3], &mut f64, &mut f64, &mut f64) + Sync,
) {
    let Particles { x, y, theta } = particles;
    x.par_chunks_mut(CHUNK)
        .zip(y.par_chunks_mut(CHUNK))
        .zip(theta.par_chunks_mut(CHUNK))
        .enumerate()
        .for_each(|(chunk, ((x, y), theta))| {
            for (i, ((x, y), theta)) in x.iter_mut().zip(y).zip(theta).enumerate() {
                let mut rng = draw.item((chunk * CHUNK + i) as u32);
                let normals = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
                f(normals, x, y, theta);
            }
        });
}
