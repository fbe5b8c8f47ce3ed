use std::fmt::Debug;
use std::sync::Arc;

use locsim_core::{BATCH, Draw, Particles, Pose2, Stage, sin_cos, wrap_angle};
use rayon::prelude::*;

use crate::error::{check_alpha, check_sigma};
use crate::{FilterError, Spread};

/// How a robot moves, given an odometry increment: samples from `p(x_t | u_t, x_t-1)`.
pub trait MotionModel: Debug + Send + Sync {
    /// Moves each particle by a draw from the motion distribution.
    ///
    /// `increment` is the motion since the last step by odometry, `base_prev_from_base_now`. Particle `i` draws
    /// from item `i` of `draw`.
    fn propagate(&self, increment: &Pose2, draw: &Draw, particles: &mut Particles);
}

/// Below this translation (m) its direction is mostly noise of the encoders (the bound AMCL uses).
const MIN_TRANSLATION_M: f64 = 0.01;

/// The odometry motion model (Probabilistic Robotics, table 5.6): a rotation, a translation and a second
/// rotation, each with Gaussian noise.
///
/// Two usual refinements. A backward motion is a negative translation with small rotations, not two rotations
/// by half a turn, so that it is as noisy as the same motion forward. Below 1 cm of translation the direction is mostly
/// encoder noise, and the whole rotation counts as the second one in the noise. The mean is always the increment:
/// without noise each pose is composed with it exactly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryMotion {
    alpha: [f64; 4],
}

impl OdometryMotion {
    /// Variances of the two rotations (rad^2) and of the translation (m^2) are
    ///
    /// - `alpha_1 rot^2 + alpha_2 trans^2` for each rotation `rot`,
    /// - `alpha_3 trans^2 + alpha_4 (rot1^2 + rot2^2)` for the translation `trans`.
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
            let (sin, cos) = sin_cos(direction);
            *x += trans * cos;
            *y += trans * sin;
            *theta = wrap_angle(direction + rot2 + rot2_sigma * n3);
        });
    }
}

/// A motion model and a random walk of the position, the same in all directions. A map and reference poses that were made of a log are
/// off by some centimetres, by others a few metres farther on: from scan to scan the robot seems to move sideways by the difference,
/// which no wheel does and no noise of a wheeled robot's model has.
#[derive(Debug)]
pub struct RandomWalk {
    motion: Arc<dyn MotionModel>,
    sigma_m: f64,
}

impl RandomWalk {
    /// A walk with a standard deviation of `sigma_m` along x and along y after a metre of way or a radian of turning; it grows with the
    /// root of either (m).
    ///
    /// # Errors
    /// [`FilterError::Option`] where the deviation is negative or not finite.
    pub fn new(motion: Arc<dyn MotionModel>, sigma_m: f64) -> Result<Self, FilterError> {
        check_sigma("random walk", sigma_m)?;
        Ok(Self { motion, sigma_m })
    }
}

impl MotionModel for RandomWalk {
    fn propagate(&self, increment: &Pose2, draw: &Draw, particles: &mut Particles) {
        self.motion.propagate(increment, draw, particles);
        if self.sigma_m == 0.0 {
            return;
        }
        let way = increment.x.hypot(increment.y) + increment.theta.abs();
        let walk = Spread { sigma_m: self.sigma_m * way.sqrt(), sigma_rad: 0.0 };
        walk.add_to(particles, &Draw::new(draw.seed(u32::MAX), Stage::Motion, 0));
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
    /// - `alpha_1 v^2 + alpha_2 omega^2` for v,
    /// - `alpha_3 v^2 + alpha_4 omega^2` for omega,
    /// - `alpha_5 v^2 + alpha_6 omega^2` for gamma.
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
            let (sin, cos) = sin_cos(*theta + angle / 2.0);
            *x += chord * cos;
            *y += chord * sin;
            *theta = wrap_angle(*theta + angle + final_sigma * n3);
        });
    }
}

/// sin(a) / a, 1 at 0.
fn sinc(a: f64) -> f64 {
    // Below this the series' next term, a^2 / 6, is under half a unit in the last place of 1.
    let ratio = sin_cos(a).0 / a;
    if a.abs() < 2e-8 { 1.0 } else { ratio }
}

/// Particles per parallel batch.
const CHUNK: usize = 16 * BATCH;

/// Calls `f(normals, x, y, theta)` for each particle, in parallel, with three standard normal numbers of the
/// particle's own. Where `f` has no branches and calls nothing but such functions, the loop over particles becomes
/// vector instructions.
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
            let batches = x.chunks_mut(BATCH).zip(y.chunks_mut(BATCH)).zip(theta.chunks_mut(BATCH));
            for (batch, ((x, y), theta)) in batches.enumerate() {
                let [n1, n2, n3] = draw.normals((chunk * CHUNK + batch * BATCH) as u32);
                let normals = n1.iter().zip(&n2).zip(&n3);
                for (((x, y), theta), ((n1, n2), n3)) in x.iter_mut().zip(y).zip(theta).zip(normals) {
                    f([*n1, *n2, *n3].map(f64::from), x, y, theta);
                }
            }
        });
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use locsim_core::Stage;
    use proptest::prelude::*;

    use super::*;

    const N: usize = 200_000;

    fn draw() -> Draw {
        Draw::new(5, Stage::Motion, 3)
    }

    /// N particles at the origin after one motion.
    fn moved(model: &dyn MotionModel, increment: Pose2) -> Particles {
        let mut particles = Particles::zeros(N);
        model.propagate(&increment, &draw(), &mut particles);
        particles
    }

    /// The sample variance of N normal numbers has a relative standard deviation of sqrt(2 / N); 4.9 of these
    /// have a false-alarm probability of 1e-6. The mean's bound is 4.9 / sqrt(N) standard deviations.
    fn assert_normal(what: &str, values: impl Iterator<Item = f64>, mean: f64, variance: f64) {
        let n = N as f64;
        let values: Vec<f64> = values.collect();
        let sample_mean = values.iter().sum::<f64>() / n;
        let sample_variance = values.iter().map(|v| (v - sample_mean).powi(2)).sum::<f64>() / n;
        let bound = 4.9 * (variance / n).sqrt() + 1e-12;
        assert!((sample_mean - mean).abs() <= bound, "{what}: mean {sample_mean}, expected {mean}");
        let bound = 4.9 * variance * (2.0 / n).sqrt() + 1e-20;
        assert!(
            (sample_variance - variance).abs() <= bound,
            "{what}: variance {sample_variance}, expected {variance}"
        );
    }

    fn increment() -> impl Strategy<Value = Pose2> {
        (-0.5..0.5, -0.5..0.5, -3.0..3.0).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
    }

    /// After two metres and a radian, in steps or at once, the walk has the variance of three; it goes on where a plain motion has none.
    #[test]
    fn a_random_walk_goes_with_the_way() {
        let walk = RandomWalk::new(Arc::new(OdometryMotion::new([0.0; 4]).unwrap()), 0.05).unwrap();
        for steps in [1_u32, 8] {
            let mut particles: Particles = std::iter::repeat_n(Pose2::IDENTITY, 20_000).collect();
            let part = 1.0 / f64::from(steps);
            for step in 0..steps {
                let increment = Pose2::new(2.0 * part, 0.0, part);
                walk.propagate(&increment, &Draw::new(3, Stage::Motion, step), &mut particles);
            }
            let expected =
                (0..steps).fold(Pose2::IDENTITY, |pose, _| pose.compose(&Pose2::new(2.0 * part, 0.0, part)));
            for (values, mean) in [(&particles.x, expected.x), (&particles.y, expected.y)] {
                let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 20_000.0;
                // Five standard errors of a variance.
                assert!((variance / (3.0 * 0.05 * 0.05) - 1.0).abs() < 0.05, "{steps} steps: {variance}");
            }
        }
        assert!(RandomWalk::new(Arc::new(OdometryMotion::new([0.0; 4]).unwrap()), -0.1).is_err());
    }

    proptest! {
    #[test]
        fn odometry_without_noise_composes_the_increment(
            increment in increment(), scale in prop::sample::select(vec![0.0, 1e-9, 1e-3, 1.0]),
            x in -9.0..9.0, y in -9.0..9.0, theta in -3.1..3.1,
        ) {
            let start = Pose2::new(x, y, theta);
            let increment = Pose2 { x: scale * increment.x, y: scale * increment.y, ..increment };
            let mut particles: Particles = [start].into_iter().collect();
            OdometryMotion::new([0.0; 4]).unwrap().propagate(&increment, &draw(), &mut particles);
            let (got, expected) = (particles.get(0), start.compose(&increment));
            prop_assert!((got.x - expected.x).abs() < 1e-12 && (got.y - expected.y).abs() < 1e-12);
            prop_assert!(wrap_angle(got.theta - expected.theta).abs() < 1e-12);
        }

        #[test]
        fn velocity_without_noise_drives_the_arc(
            arc in -1.0..1.0f64, angle in -3.1..3.1f64, theta in -3.1..3.1,
        ) {
            // The arc's end from its centre, as table 5.3 has it.
            let radius = arc / angle;
            let increment = Pose2::new(radius * angle.sin(), radius * (1.0 - angle.cos()), angle);
            let start = Pose2::new(2.0, 3.0, theta);
            let mut particles: Particles = [start].into_iter().collect();
            VelocityMotion::new([0.0; 6]).unwrap().propagate(&increment, &draw(), &mut particles);
            let (got, expected) = (particles.get(0), start.compose(&increment));
            prop_assert!((got.x - expected.x).abs() < 1e-9 && (got.y - expected.y).abs() < 1e-9);
            prop_assert!(wrap_angle(got.theta - expected.theta).abs() < 1e-9);
        }
    }

    #[test]
    fn odometry_noise_has_the_variances_of_table_5_6() {
        let model = OdometryMotion::new([0.02, 0.01, 0.03, 0.01]).unwrap();
        // rot1 = 0.1, trans = 0.5, rot2 = 0.2: small noise, so that neither angle wraps.
        let increment = Pose2::new(0.5 * 0.1_f64.cos(), 0.5 * 0.1_f64.sin(), 0.3);
        let particles = moved(&model, increment);
        let rot1 = || particles.iter().map(|p| p.y.atan2(p.x));
        assert_normal("rot1", rot1(), 0.1, 0.02 * 0.01 + 0.01 * 0.25);
        let rot2 = particles.iter().zip(rot1()).map(|(p, rot1)| p.theta - rot1);
        assert_normal("rot2", rot2, 0.2, 0.02 * 0.04 + 0.01 * 0.25);
        let trans = particles.iter().map(|p| p.x.hypot(p.y));
        assert_normal("trans", trans, 0.5, 0.03 * 0.25 + 0.01 * (0.01 + 0.04));
    }

    #[test]
    fn backward_is_as_noisy_as_forward() {
        let model = OdometryMotion::new([0.1, 0.0, 0.001, 0.0]).unwrap();
        let particles = moved(&model, Pose2::new(-0.5, 0.0, 0.0));
        assert_normal("x", particles.x.iter().copied(), -0.5, 0.001 * 0.25);
        assert!(particles.theta.iter().all(|theta| *theta == 0.0), "no rotation, no rotation noise");
    }

    #[test]
    fn turning_in_place_is_noisy_in_heading_whatever_the_encoders_say_of_the_direction() {
        let model = OdometryMotion::new([0.01, 0.0, 0.0, 0.0]).unwrap();
        for (x, y) in [(0.0, 0.0), (1e-4, 0.0), (-1e-4, 1e-4), (0.0, -1e-4)] {
            let particles = moved(&model, Pose2::new(x, y, 1.0));
            assert_normal("heading", particles.theta.iter().copied(), 1.0, 0.01);
        }
        // Half a turn is a turn, not a reversal.
        let particles = moved(&model, Pose2::new(0.0, 0.0, PI));
        let turned = particles.theta.iter().map(|theta| wrap_angle(theta - PI));
        assert_normal("half a turn", turned, 0.0, 0.01 * PI * PI);
    }

    #[test]
    fn velocity_noise_has_the_variances_of_table_5_3() {
        let straight = Pose2::new(0.4, 0.0, 0.0);
        let along = moved(&VelocityMotion::new([0.02, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap(), straight);
        assert_normal("v", along.x.iter().copied(), 0.4, 0.02 * 0.16);
        assert!(along.y.iter().chain(&along.theta).all(|v| *v == 0.0));
        let turn = moved(&VelocityMotion::new([0.0, 0.0, 0.03, 0.05, 0.07, 0.11]).unwrap(), straight);
        assert_normal("heading", turn.theta.iter().copied(), 0.0, (0.03 + 0.07) * 0.16);
        let spin = Pose2::new(0.0, 0.0, 0.5);
        let spun = moved(&VelocityMotion::new([0.0, 0.02, 0.03, 0.05, 0.07, 0.11]).unwrap(), spin);
        assert_normal("heading", spun.theta.iter().copied(), 0.5, (0.05 + 0.11) * 0.25);
        // v noise by omega: the chord is normal along half the turned angle, so its signed length is v dt.
        let slid = moved(&VelocityMotion::new([0.0, 0.02, 0.0, 0.0, 0.0, 0.0]).unwrap(), spin);
        let length = slid.iter().map(|p| (p.x * 0.25_f64.cos() + p.y * 0.25_f64.sin()) / sinc(0.25));
        assert_normal("v", length, 0.0, 0.02 * 0.25);
    }

    #[test]
    fn particles_draw_their_own_noise_whatever_their_number() {
        let model = OdometryMotion::new([0.1; 4]).unwrap();
        let increment = Pose2::new(0.3, 0.1, 0.2);
        let all = moved(&model, increment);
        let mut few = Particles::zeros(3000);
        model.propagate(&increment, &draw(), &mut few);
        assert!(few.iter().zip(all.iter()).all(|(a, b)| a == b));
        assert_ne!(few.get(0), few.get(CHUNK), "chunks do not share their draws");
    }

    #[test]
    fn noise_parameters_are_checked() {
        assert!(OdometryMotion::new([0.0, -0.1, 0.0, 0.0]).is_err());
        let error = VelocityMotion::new([0.0, 0.0, 0.0, 0.0, 0.0, f64::NAN]).unwrap_err();
        assert_eq!(error.to_string(), "motion alpha must be finite and at least 0, got NaN");
    }
}
