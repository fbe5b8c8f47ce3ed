//! Increments of the odometry against those of the reference.

use locsim_core::{Draw, Pose2, Stage, Track, increments, median, normal, wrap_angle};
use rand_distr::{Distribution, StandardNormal};

use super::{OdometryNoise, odometry_along};
use crate::effect::Effects;

/// Least standard deviation of an increment's distance \[m\] and turn \[rad\]: the encoders' resolution, also where a simulator wrote
/// an exact log.
const LEAST: [f64; 2] = [1e-4, 1e-4];
/// An error beyond this many standard deviations counts as this many: a reference that jumps tells nothing of the odometry.
const CUT: f64 = 4.0;
/// Under the increments' normal density lies another one, this much wider, of this share.
const WIDE: (f64, f64) = (0.01, 6.0);

/// Item of an increment's draws beside those of the noise that grows with the motion.
const OWN_ERROR: u32 = 2;

/// How far the increments of a log's odometry scatter about those of the reference. The scenario's noise is mostly a guess, and the
/// reference errs, too: both are fitted to the log.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct OdometrySpread {
    /// Noise that grows with the motion.
    #[serde(flatten)]
    pub noise: OdometryNoise,
    /// Standard deviation of a distance beyond that \[m\].
    pub sigma_m: f64,
    /// Standard deviation of a turn beyond that \[rad\].
    pub sigma_rad: f64,
}

impl Default for OdometrySpread {
    fn default() -> Self {
        Self { noise: OdometryNoise::default(), sigma_m: LEAST[0], sigma_rad: LEAST[1] }
    }
}

impl OdometrySpread {
    /// `odom_from_base` at each of the true poses, as [`odometry_along`] has it, with the errors that don't grow with the motion. These of
    /// increment `i` draw from step `i`.
    pub fn along(&self, truth: &[Pose2], effects: &Effects, seed: u64) -> Vec<Pose2> {
        let odometry = odometry_along(truth, &self.noise, effects, seed);
        let mut pose = Pose2::IDENTITY;
        let mut track = vec![pose];
        for (i, pair) in odometry.windows(2).enumerate() {
            let mut rng = Draw::new(seed, Stage::Odometry, i as u32).item(OWN_ERROR);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let step = pair[1].relative_to(&pair[0]);
            let stretch = self.sigma_m * normal();
            let along = step.position().normalize_or_zero();
            let turn = self.sigma_rad * normal();
            let step = Pose2::new(
                step.x + stretch * if along.x == 0.0 && along.y == 0.0 { 1.0 } else { along.x },
                step.y + stretch * along.y,
                step.theta + turn,
            );
            pose = pose.compose(&step);
            track.push(pose);
        }
        track
    }
}

/// Errors of an increment in distance \[m\] and turn \[rad\].
#[derive(Clone, Copy, Debug)]
pub struct Increment {
    /// True distance \[m\] and turn \[rad\], by the reference.
    pub truth: [f64; 2],
    /// Error of the odometry.
    pub error: [f64; 2],
    /// Squares of the motion that alpha 3 and 4 multiply in the variance of the distance, alpha 1 and 2 in that of the turn.
    pub squares: [[f64; 2]; 2],
}

impl Increment {
    /// The increments of a log, from its second scan on.
    pub fn all(effects: &Effects, track: &[Pose2], odometry: &[Pose2]) -> Vec<Self> {
        let truth = increments(track);
        let read = increments(odometry);
        let steps = track.windows(2).zip(truth).zip(read);
        steps
            .map(|((pair, truth), read)| {
                let distribution = effects.odometry(&pair[1].relative_to(&pair[0]));
                let [mean] = [increments(&[Pose2::IDENTITY, distribution.mean])[0]];
                let [distance, turn] = mean.map(|value| value * value);
                // Two rotations are half of a smooth turn each; a turn in place is one.
                let share = if distance > 1e-4 { 0.5 } else { 1.0 };
                let squares = [[distance, share * turn], [share * turn, 2.0 * distance]];
                let error = [read[0] - mean[0], locsim_core::wrap_angle(read[1] - mean[1])];
                Self { truth, error, squares }
            })
            .collect()
    }

    /// Density of the error of a distance (`axis` 0) or a turn (1) where nothing slips.
    pub fn density(&self, error: &OdometrySpread, axis: usize) -> f64 {
        let (sigma, (share, factor)) = (self.deviation(error, axis), WIDE);
        let t = self.error[axis] / sigma;
        ((1.0 - share) * normal::density(t) + share * normal::density(t / factor) / factor) / sigma
    }

    /// Standard deviation of the error of a distance \[m\] or a turn \[rad\].
    pub fn deviation(&self, error: &OdometrySpread, axis: usize) -> f64 {
        let [a1, a2, a3, a4] = error.noise.alpha();
        let [p, q] = [[a3, a4], [a1, a2]][axis];
        let [u, v] = self.squares[axis];
        let extra = [error.sigma_m, error.sigma_rad][axis];
        (p * u + q * v + extra * extra).sqrt()
    }

    /// How much more likely a distance is of a slip than without one, less 1; and the same if it erred by as much the other way.
    /// Slips only lengthen: the two differ, however large the errors are that make no difference between them.
    pub fn slip_ratios(&self, error: &OdometrySpread, share: f64) -> [f64; 2] {
        let mirrored = Self { error: self.error.map(|e| -e), ..*self };
        [self, &mirrored]
            .map(|increment| slipped(increment, error, share) / increment.density(error, 0).max(1e-300) - 1.0)
    }
}

impl OdometrySpread {
    /// Steps of the fit. Each brings the likelihood nearer to its maximum.
    const STEPS: usize = 200;
    /// Shares of the variance at first. At a steady speed a constant can't be told from what grows with the motion, and stays small.
    const FIRST_SHARES: [f64; 3] = [0.495, 0.495, 0.01];
    /// An error beyond this many standard deviations counts as this many in the fit, as in Huber's proposal 2: some increments slip.
    const MOST_DEVIATIONS: f64 = 1.5;

    /// The variances of increments by maximum likelihood, in multiplicative steps that keep them positive (Févotte, Bertin and Durrieu
    /// 2009). A robot that stands still tells nothing of its odometry.
    pub fn of(increments: &[Increment]) -> Self {
        let moves = |increment: &&Increment| {
            // By the odometry alone: a reference jitters.
            let read = increment.truth.iter().zip(&increment.error).map(|(truth, error)| truth + error);
            read.zip(LEAST).any(|(read, least)| read.abs() > least)
        };
        let increments: Vec<&Increment> = increments.iter().filter(moves).collect();
        let of_axis = |axis: usize| {
            let parts = |increment: &Increment| {
                let [u, v] = increment.squares[axis];
                [u, v, 1.0]
            };
            let count = increments.len().max(1) as f64;
            let mut deviations: Vec<f64> = increments.iter().map(|i| i.error[axis].abs()).collect();
            let whole = if deviations.is_empty() { 0.0 } else { median(&mut deviations) };
            let whole = (normal::SIGMA_OVER_MAD * whole).powi(2);
            let mut factors: [f64; 3] = std::array::from_fn(|part| {
                let mean = increments.iter().map(|increment| parts(increment)[part]).sum::<f64>() / count;
                if mean > 0.0 { Self::FIRST_SHARES[part] * whole / mean } else { 0.0 }
            });
            // What doesn't change from step to step: the parts, what they expect, and the squared error.
            let expected_square = Self::expected_square();
            let of_increment = |increment: &Increment| {
                let parts = parts(increment);
                (parts, parts.map(|part| part * expected_square), increment.error[axis].powi(2))
            };
            let rows: Vec<([f64; 3], [f64; 3], f64)> =
                increments.iter().map(|increment| of_increment(increment)).collect();
            for _ in 0..Self::STEPS {
                let (mut found, mut expected) = ([0.0; 3], [0.0; 3]);
                for (parts, expecting, squared) in &rows {
                    let variance = parts.iter().zip(factors).map(|(part, factor)| part * factor).sum::<f64>()
                        + LEAST[axis].powi(2);
                    let square = (squared / variance).min(Self::MOST_DEVIATIONS.powi(2));
                    for i in 0..3 {
                        found[i] += parts[i] * square / variance;
                        expected[i] += expecting[i] / variance;
                    }
                }
                for (factor, (found, expected)) in factors.iter_mut().zip(found.into_iter().zip(expected)) {
                    if expected > 0.0 {
                        *factor *= found / expected;
                    }
                }
            }
            factors
        };
        let [[a3, a4, distance], [a1, a2, turn]] = [of_axis(0), of_axis(1)];
        // Factors of a log that doesn't move are anything.
        let noise = OdometryNoise::new([a1, a2, a3, a4].map(|alpha| alpha.min(1.0))).unwrap_or_default();
        Self { noise, sigma_m: distance.sqrt().hypot(LEAST[0]), sigma_rad: turn.sqrt().hypot(LEAST[1]) }
    }

    /// Mean of a standard normal number's square that is cut as in the fit.
    fn expected_square() -> f64 {
        let cut = Self::MOST_DEVIATIONS;
        1.0 - 2.0 * (normal::tail(cut) + cut * normal::density(cut)) + 2.0 * cut * cut * normal::tail(cut)
    }

    /// The spread of a log's odometry, whatever errors in proportion to the motion it has.
    pub fn fit(effects: &Effects, track: &[Pose2], odometry: &[Pose2]) -> Self {
        OdometryModel::learn(&Increment::all(effects, track, odometry)).spread
    }
}

/// An odometry that errs in proportion to distance and turn, and the spread of the rest.
#[derive(Clone, Copy, Debug, Default)]
pub struct OdometryModel {
    /// Error of the distance per metre.
    distance: f64,
    /// Error of the turn per radian and per metre.
    turn: [f64; 2],
    /// The rest.
    pub spread: OdometrySpread,
}

impl OdometryModel {
    /// Least squares are repeated without errors of more than these standard deviations.
    const CUT: f64 = 3.0;
    const ROUNDS: usize = 4;

    /// Learns from increments, of which those that aren't finite don't count.
    pub fn learn(increments: &[Increment]) -> Self {
        let increments: Vec<&Increment> =
            increments.iter().filter(|increment| increment.error.iter().all(|e| e.is_finite())).collect();
        let mut model = Self::default();
        for _ in 0..Self::ROUNDS {
            let rest: Vec<Increment> = increments.iter().map(|increment| model.without(increment)).collect();
            model.spread = OdometrySpread::of(&rest);
            let [mut dd, mut de, mut tt, mut td, mut te, mut ds, mut se] = [0.0; 7];
            for (increment, rest) in increments.iter().zip(&rest) {
                let [d, t] = increment.truth;
                let within: [f64; 2] = std::array::from_fn(|axis| {
                    let sigma = rest.deviation(&model.spread, axis);
                    if rest.error[axis].abs() < Self::CUT * sigma { sigma.powi(-2) } else { 0.0 }
                });
                dd += within[0] * d * d;
                de += within[0] * d * increment.error[0];
                tt += within[1] * t * t;
                td += within[1] * t * d;
                ds += within[1] * d * d;
                te += within[1] * t * increment.error[1];
                se += within[1] * d * increment.error[1];
            }
            if dd > 0.0 {
                model.distance = de / dd;
            }
            let determinant = tt * ds - td * td;
            if determinant > 1e-12 * (tt * ds) {
                model.turn = [(te * ds - se * td) / determinant, (se * tt - te * td) / determinant];
            }
        }
        model
    }

    /// An increment without the errors in proportion to its motion.
    pub fn without(&self, increment: &Increment) -> Increment {
        let [d, t] = increment.truth;
        let [distance, turn] = increment.error;
        let error = [distance - self.distance * d, turn - self.turn[0] * t - self.turn[1] * d];
        Increment { error, ..*increment }
    }
}

/// Log likelihood of each increment (nats).
pub fn log_likelihoods(
    effects: &Effects,
    error: &OdometrySpread,
    track: &[Pose2],
    odometry: &[Pose2],
) -> Vec<f64> {
    let slip = effects.odometry(&Pose2::new(1.0, 0.0, 0.0)).slip;
    Increment::all(effects, track, odometry)
        .iter()
        .map(|increment| {
            let plain = increment.density(error, 0);
            let distance = if slip.p > 0.0 && slip.share > 0.0 {
                (1.0 - slip.p) * plain + slip.p * slipped(increment, error, slip.share)
            } else {
                plain
            };
            distance.max(1e-300).ln() + increment.density(error, 1).max(1e-300).ln()
        })
        .collect()
}

/// The same of a distance with a half-normal slip: the sum of a normal and a half-normal number is skew normal (Azzalini 1985).
fn slipped(increment: &Increment, error: &OdometrySpread, share: f64) -> f64 {
    let (sigma, (wide, factor)) = (increment.deviation(error, 0), WIDE);
    let slip = share * increment.truth[0].abs();
    let longer = increment.error[0] * increment.truth[0].signum();
    let skew_normal = |sigma: f64| {
        let scale = sigma.hypot(slip);
        2.0 * normal::density(longer / scale) * normal::cdf(slip / sigma * longer / scale) / scale
    };
    (1.0 - wide) * skew_normal(sigma) + wide * skew_normal(factor * sigma)
}

/// Errors in standard deviations, cut where they say nothing more.
pub fn standardized(increment: &Increment, error: &OdometrySpread) -> [f64; 2] {
    std::array::from_fn(|axis| (increment.error[axis] / increment.deviation(error, axis)).clamp(-CUT, CUT))
}

/// The increments against those of the track so much earlier \[s\], which is what an odometry that lags by that errs by; each with its
/// index. Those of the first and the last `reach_secs` of the track are left out: nothing is known of the motion before and after.
pub fn lagging(
    track: &Track,
    late_secs: f64,
    reach_secs: f64,
    increments: &[Increment],
) -> impl Iterator<Item = (usize, Increment)> {
    let secs = track.secs();
    let poses: Vec<Pose2> = secs.iter().map(|&secs| track.pose_at(secs - late_secs)).collect();
    let is_known =
        move |i: &usize| secs[*i] >= reach_secs && secs[i + 1] <= secs[secs.len() - 1] - reach_secs;
    let truths = self::increments(&poses);
    let all = increments.iter().zip(truths).enumerate().filter(move |(i, _)| is_known(i));
    all.map(|(i, (increment, truth))| {
        let change = [increment.truth[0] - truth[0], wrap_angle(increment.truth[1] - truth[1])];
        (
            i,
            Increment {
                error: std::array::from_fn(|axis| increment.error[axis] + change[axis]),
                ..*increment
            },
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Increments with these errors, on straight lines and in turns by turns.
    fn drawn(mut error: impl FnMut(usize, [f64; 2]) -> [f64; 2]) -> Vec<Increment> {
        let motions = [[0.1, 0.0], [0.1, 0.02], [0.0, 0.2], [0.05, 0.1]];
        (0..4000)
            .map(|i| {
                let [d, t] = motions[i % motions.len()];
                let squares = [[d * d, t * t], [t * t, 2.0 * d * d]];
                Increment { truth: [d, t], error: error(i, [d, t]), squares }
            })
            .collect()
    }

    /// Noise with four known alphas and a constant is found again, whatever scale and imbalance the odometry has, also where one in
    /// twenty increments slips.
    #[test]
    fn noise_and_proportional_errors_are_found_together() {
        let mut rng = locsim_core::Draw::new(1, locsim_core::Stage::Odometry, 0).item(0);
        let mut normal =
            || -> f64 { rand_distr::Distribution::sample(&rand_distr::StandardNormal, &mut rng) };
        let noisy = drawn(|i, [d, t]| {
            let sigma_d = (0.0004 * d * d + 0.001 * t * t + 0.001_f64.powi(2)).sqrt();
            let sigma_t = (0.0009 * t * t + 2.0 * 0.002 * d * d + 0.001_f64.powi(2)).sqrt();
            let slip = if i % 20 == 7 { 0.5 * d } else { 0.0 };
            [0.03 * d + sigma_d * normal() + slip, -0.02 * t + 0.1 * d + sigma_t * normal()]
        });
        let model = OdometryModel::learn(&noisy);
        // A robot that stands still for most of the time has the same spread, whatever its reference does.
        let still =
            Increment { truth: [5e-4, 1e-3], error: [-5e-4, -1e-3], squares: [[2.5e-7, 1e-6], [1e-6, 5e-7]] };
        let with_stops: Vec<Increment> = noisy.iter().copied().chain(vec![still; 3 * noisy.len()]).collect();
        assert_eq!(OdometrySpread::of(&with_stops), OdometrySpread::of(&noisy));
        let near =
            |value: f64, truth: f64, error: f64| assert!((value - truth).abs() < error, "{value} {truth}");
        near(model.distance, 0.03, 0.001);
        near(model.turn[0], -0.02, 0.002);
        near(model.turn[1], 0.1, 0.004);
        // A twentieth that counts as 1.5 standard deviations widens the distances by a tenth.
        for (motion, sigma) in [([0.1, 0.0], [0.00224, 0.00640]), ([0.0, 0.2], [0.00640, 0.00608])] {
            let at = noisy.iter().find(|increment| increment.truth == motion).unwrap();
            for (axis, sigma) in sigma.into_iter().enumerate() {
                near(at.deviation(&model.spread, axis) / sigma, 1.05, 0.12);
            }
        }
    }

    /// An odometry that is exact, and one that never moves.
    #[test]
    fn a_spread_of_nothing_is_none() {
        let exact = OdometryModel::learn(&drawn(|_, _| [0.0; 2]));
        assert!(exact.spread.noise.alpha().iter().all(|alpha| *alpha < 1e-9), "{exact:?}");
        assert!(
            (exact.spread.sigma_m - LEAST[0]).abs() < 1e-9
                && (exact.spread.sigma_rad - LEAST[1]).abs() < 1e-9
        );
        assert_eq!(OdometrySpread::of(&[]), OdometrySpread::default());
        let still = Increment { truth: [0.0; 2], error: [1e-3, 0.0], squares: [[0.0; 2]; 2] };
        let spread = OdometryModel::learn(&[still; 9]).spread;
        assert!(spread.noise.alpha() == [0.0; 4] && spread.sigma_m > 1e-3, "{spread:?}");
    }

    /// The density of a slipped distance has a whole of 1, and a mean that is longer by that of the slip, forward and in reverse.
    #[test]
    fn a_slip_lengthens_as_the_simulator_s_does() {
        let noise = OdometryNoise::new([0.0, 0.0, 0.003 * 0.003, 0.0]).unwrap();
        let error = OdometrySpread { noise, sigma_m: 0.004, sigma_rad: 0.0 };
        for truth in [0.07, -0.07] {
            let step = 1e-4;
            let (mut whole, mut mean) = (0.0, 0.0);
            for i in -4000..4000 {
                let off = step * (f64::from(i) + 0.5);
                let increment =
                    Increment { truth: [truth, 0.0], error: [off, 0.0], squares: [[1.0, 0.0]; 2] };
                let share = step * slipped(&increment, &error, 0.5);
                whole += share;
                mean += share * off;
            }
            let expected = 0.5 * truth * (2.0 / std::f64::consts::PI).sqrt();
            assert!(
                (whole - 1.0).abs() < 1e-6 && (mean - expected).abs() < 1e-6,
                "{whole} {mean} {expected}"
            );
        }
    }
}
