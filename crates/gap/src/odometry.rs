//! Increments of the odometry against those of the reference.

use locsim_core::{Pose2, median, normal};
use locsim_world::effect::Effects;

use crate::{Nominal, Recorded};

/// Least standard deviation of an increment's distance \[m\] and turn \[rad\].
const LEAST: [f64; 2] = [1e-4, 1e-4];
/// An error beyond this many standard deviations counts as this many: a reference that jumps tells nothing of the odometry.
const CUT: f64 = 4.0;
/// Under the increments' normal density lies another one, this much wider, of this share.
const WIDE: (f64, f64) = (0.01, 6.0);

/// Variance of an odometry increment against the reference's that no scenario knows: errors of the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct OdometryError {
    /// Standard deviation of a distance \[m\].
    pub sigma_m: f64,
    /// Standard deviation of a turn \[rad\].
    pub sigma_rad: f64,
}

/// Errors of an increment in distance \[m\] and turn \[rad\], and their variances by the scenario's noise.
pub struct Increment {
    /// True distance \[m\] and turn \[rad\], by the reference.
    pub truth: [f64; 2],
    /// Error of the odometry.
    pub error: [f64; 2],
    /// Variance of the error.
    pub variance: [f64; 2],
}

impl Increment {
    /// The increments of a log, from its second scan on.
    pub fn all(nominal: &Nominal, effects: &Effects, track: &[Pose2], odometry: &[Pose2]) -> Vec<Self> {
        let [a1, a2, a3, a4] = nominal.odometry.alpha();
        let truth = Recorded::increments(track);
        let read = Recorded::increments(odometry);
        let steps = track.windows(2).zip(truth).zip(read);
        steps
            .map(|((pair, truth), read)| {
                let distribution = effects.odometry(&pair[1].relative_to(&pair[0]));
                let [mean] = [Recorded::increments(&[Pose2::IDENTITY, distribution.mean])[0]];
                let [distance, turn] = mean.map(|value| value * value);
                // Two rotations are half of a smooth turn each; a turn in place is one.
                let share = if distance > 1e-4 { 0.5 } else { 1.0 };
                let variance = [a3 * distance + share * a4 * turn, share * a1 * turn + 2.0 * a2 * distance];
                let error = [read[0] - mean[0], locsim_core::wrap_angle(read[1] - mean[1])];
                Self { truth, error, variance }
            })
            .collect()
    }

    /// Density of the error of a distance (`axis` 0) or a turn (1) where nothing slips.
    pub fn density(&self, error: &OdometryError, axis: usize) -> f64 {
        let (sigma, (share, factor)) = (self.deviation(error, axis), WIDE);
        let t = self.error[axis] / sigma;
        ((1.0 - share) * normal::density(t) + share * normal::density(t / factor) / factor) / sigma
    }

    /// Standard deviation of the error of a distance \[m\] or a turn \[rad\].
    pub fn deviation(&self, error: &OdometryError, axis: usize) -> f64 {
        let extra = [error.sigma_m, error.sigma_rad][axis];
        (self.variance[axis] + extra * extra + LEAST[axis].powi(2)).sqrt()
    }

    /// How much more likely a distance is of a slip than without one, less 1; and the same if it erred by as much the other way.
    /// Slips only lengthen: the two differ, however large the errors are that make no difference between them.
    pub fn slip_ratios(&self, error: &OdometryError, share: f64) -> [f64; 2] {
        let mirrored = Self { error: self.error.map(|e| -e), ..*self };
        [self, &mirrored]
            .map(|increment| slipped(increment, error, share) / increment.density(error, 0).max(1e-300) - 1.0)
    }
}

impl OdometryError {
    /// By the median of squares over what the scenario's noise explains.
    pub(crate) fn fit(nominal: &Nominal, effects: &Effects, track: &[Pose2], odometry: &[Pose2]) -> Self {
        let increments = Increment::all(nominal, effects, track, odometry);
        let extra = |axis: usize| {
            if increments.is_empty() {
                return 0.0;
            }
            let mut errors: Vec<f64> = increments.iter().map(|i| i.error[axis]).collect();
            let middle = median(&mut errors);
            let mut deviations: Vec<f64> = errors.iter().map(|error| (error - middle).abs()).collect();
            let spread = normal::SIGMA_OVER_MAD * median(&mut deviations);
            let mut known: Vec<f64> = increments.iter().map(|i| i.variance[axis]).collect();
            (spread * spread - median(&mut known)).max(0.0).sqrt()
        };
        Self { sigma_m: extra(0), sigma_rad: extra(1) }
    }
}

/// Log likelihood of each increment (nats).
pub(crate) fn log_likelihoods(
    nominal: &Nominal,
    effects: &Effects,
    error: &OdometryError,
    track: &[Pose2],
    odometry: &[Pose2],
) -> Vec<f64> {
    let slip = effects.odometry(&Pose2::new(1.0, 0.0, 0.0)).slip;
    Increment::all(nominal, effects, track, odometry)
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
fn slipped(increment: &Increment, error: &OdometryError, share: f64) -> f64 {
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
pub(crate) fn standardized(increment: &Increment, error: &OdometryError) -> [f64; 2] {
    std::array::from_fn(|axis| (increment.error[axis] / increment.deviation(error, axis)).clamp(-CUT, CUT))
}

/// Evidence of each increment for an odometry that lags behind the stamps: by the lag's first order, an increment is that of the
/// truth less the lag times its rate of change. The product of error and slope, and the square of the slope, in standard
/// deviations \[1/s, 1/s^2\]; the first one is of the second increment.
pub(crate) fn lag_slopes(increments: &[Increment], error: &OdometryError, secs: &[f64]) -> Vec<[f64; 2]> {
    let triples = increments.windows(3).zip(secs.windows(4));
    triples
        .map(|(triple, secs)| {
            let [before, here, after] = triple else { return [0.0; 2] };
            let errors = standardized(here, error);
            let mut slopes = [0.0; 2];
            for (axis, value) in errors.into_iter().enumerate() {
                let change = 0.5 * (after.truth[axis] - before.truth[axis]) / (secs[2] - secs[1]).max(1e-6);
                let slope = -change / here.deviation(error, axis);
                slopes[0] += slope * value;
                slopes[1] += slope * slope;
            }
            slopes
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The density of a slipped distance has a whole of 1, and a mean that is longer by that of the slip, forward and in reverse.
    #[test]
    fn a_slip_lengthens_as_the_simulator_s_does() {
        let error = OdometryError { sigma_m: 0.004, sigma_rad: 0.0 };
        for truth in [0.07, -0.07] {
            let step = 1e-4;
            let (mut whole, mut mean) = (0.0, 0.0);
            for i in -4000..4000 {
                let off = step * (f64::from(i) + 0.5);
                let increment =
                    Increment { truth: [truth, 0.0], error: [off, 0.0], variance: [0.003 * 0.003, 0.0] };
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
