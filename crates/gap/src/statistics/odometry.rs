//! Errors of the odometry's increments against those of the reference.

use distreg::contamination::{detectable_share, score};
use distreg::{Correlation, lasting};
use locsim_comparison::{Comparison, Fitted, shown_by};
use locsim_core::Folds;
use locsim_world::effect::{self, Axis, EffectKind, Effects};
use locsim_world::simulation::{Increment, OdometrySpread, standardized};

use super::{Covariate, Deviation, Family, Form, Group, Halves, Readings, Statistic};

/// The increments of a log's odometry, with the reference's errors taken off.
fn increments_of(comparison: &Comparison<'_>, effects: &Effects, fitted: &Fitted) -> Vec<Increment> {
    Increment::all(effects, &comparison.corrected(&fitted.corrections), &comparison.recorded.odometry)
}

/// The correlation of an error of the odometry with a motion.
pub(super) struct OdometryCorrelation {
    kind: EffectKind,
    error: Axis,
    motion: Axis,
}

impl OdometryCorrelation {
    pub fn all() -> Vec<Self> {
        let shown = shown_by(|statistic| match statistic {
            effect::Statistic::Odometry { error, motion } => Some((*error, *motion)),
            _ => None,
        });
        shown.map(|(kind, (error, motion))| Self { kind, error, motion }).collect()
    }

    /// An increment's error with the motion that it may depend on, in standard deviations; `errs` where the reference has errors.
    fn pair(&self, increments: &[Increment], scan: usize, spread: &OdometrySpread, errs: bool) -> [f64; 2] {
        let (error, motion) = (self.error as usize, self.motion as usize);
        let increment = &increments[scan];
        let driven = if errs { motion_about(increments, scan) } else { increment.truth };
        [standardized(increment, spread)[error], driven[motion] / increment.deviation(spread, error)]
    }

    /// Each half's correlation; `errs` where the reference has errors.
    fn of_increments(
        &self,
        increments: &[Increment],
        folds: Folds,
        spread: &OdometrySpread,
        errs: bool,
    ) -> Halves {
        let mut correlations = [Correlation::default(); 2];
        for scan in 0..increments.len() {
            let [error, motion] = self.pair(increments, scan, spread, errs);
            correlations[folds.half_of(scan)].add(error, motion);
        }
        correlations.map(|correlation| correlation.value())
    }
}

impl Family for OdometryCorrelation {
    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic::of_effect(self.kind, Group::Wide, Form::Other)]
    }

    /// A correlation doesn't depend on how large the reference's errors are taken to be, only on whether it has any.
    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let spread = &log.fitted.nuisances.odometry_error;
        let folds = log.comparison.recorded.folds;
        vec![self.of_increments(
            &increments_of(log.comparison, log.effects, log.fitted),
            folds,
            spread,
            log.has_pose_errors,
        )]
    }
}

/// How surely an effect of the odometry has acted all along, in standard errors that know that wheels may err alike for many seconds;
/// `None` of an effect that comes and goes.
pub fn odometry_errors(
    kind: EffectKind,
    comparison: &Comparison<'_>,
    effects: &Effects,
    fitted: &Fitted,
) -> Option<f64> {
    let increments = increments_of(comparison, effects, fitted);
    let (spread, errs) = (&fitted.nuisances.odometry_error, !fitted.nuisances.pose_error.is_none());
    let errors = |correlation: OdometryCorrelation| {
        let pair = |scan| correlation.pair(&increments, scan, spread, errs);
        lasting::slope(&(0..increments.len()).map(pair).collect::<Vec<_>>()).abs()
    };
    let own = OdometryCorrelation::all().into_iter().filter(|correlation| correlation.kind == kind);
    own.map(errors).max_by(f64::total_cmp)
}

/// The motion of an increment by those two before and two after it. What its own poses err by is in its motion and in its error
/// alike: an odometry better than the reference would err against the motion.
fn motion_about(increments: &[Increment], at: usize) -> [f64; 2] {
    let before = at.checked_sub(2).and_then(|i| increments.get(i));
    let about: Vec<[f64; 2]> = before.into_iter().chain(increments.get(at + 2)).map(|i| i.truth).collect();
    std::array::from_fn(|axis| {
        about.iter().map(|motion| motion[axis]).sum::<f64>() / about.len().max(1) as f64
    })
}

/// Likelihood ratios of wheels that slip, for a few shares by which they then turn too far.
pub(super) struct Slips {
    kind: EffectKind,
    shares: &'static [f64],
}

impl Slips {
    pub fn all() -> Vec<Self> {
        let shown = shown_by(|statistic| match statistic {
            effect::Statistic::Slip { shares } => Some(*shares),
            _ => None,
        });
        shown.map(|(kind, shares)| Self { kind, shares }).collect()
    }
}

impl Family for Slips {
    fn statistics(&self) -> Vec<Statistic> {
        let statistic = |&share: &f64| Statistic::along(self.kind, &[(1, share)], Group::Wide, Form::Other);
        self.shares.iter().map(statistic).collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let odometry_error = &log.fitted.nuisances.odometry_error;
        let increments = increments_of(log.comparison, log.effects, log.fitted);
        let detectable = detectable_share(increments.len() as f64);
        let folds = log.comparison.recorded.folds;
        let mut sums = vec![[0.0; 2]; self.shares.len()];
        for (scan, increment) in increments.iter().enumerate() {
            for (sum, &share) in sums.iter_mut().zip(self.shares) {
                let [longer, shorter] =
                    increment.slip_ratios(odometry_error, share).map(|ratio| score(ratio, detectable));
                sum[folds.half_of(scan)] += longer - shorter;
            }
        }
        sums
    }
}

/// By how much each increment speaks for an odometry that lags behind the stamps: the product of its errors with the changes of speed by
/// which a lag of a second would be off, e = -lag dv, and that of these with the same changes by the reference; nothing of the first and the
/// last one. All are in standard deviations. The speeds are the odometry's own, of the increments before and after: errors of the reference
/// aren't in them, and their own noise isn't in the reference's (instrumental variables).
pub(crate) fn lag_products(secs: &[f64], increments: &[Increment], spread: &OdometrySpread) -> Vec<[f64; 2]> {
    // By the odometry and by the reference.
    let speeds = |i: usize, axis: usize| {
        let Increment { truth, error, .. } = &increments[i];
        let lasting = (secs[i + 1] - secs[i]).max(LEAST_SECS);
        [truth[axis] + error[axis], truth[axis]].map(|motion| motion / lasting)
    };
    let products = |i: usize| {
        let mut sum = [0.0; 2];
        if i > 0 && i + 1 < increments.len() {
            for (axis, error) in standardized(&increments[i], spread).into_iter().enumerate() {
                let (before, after) = (speeds(i - 1, axis), speeds(i + 1, axis));
                let deviation = increments[i].deviation(spread, axis);
                let [own, reference] = [0, 1].map(|of| 0.5 * (after[of] - before[of]) / deviation);
                sum[0] -= error * own;
                sum[1] += own * reference;
            }
        }
        sum
    };
    (0..increments.len()).map(products).collect()
}

/// The least time between scans \[s\].
const LEAST_SECS: f64 = 1e-3;
/// One increment changes a standardized sum by one at the most.
const LEAST_ROOT: f64 = 1.0;

/// How surely the odometry lags behind the stamps: the sum of [`lag_products`] over its own root mean square, so that noise which was fitted
/// to a log with a lag says no less.
pub(super) struct OdometryLag;

impl Family for OdometryLag {
    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic::of_misalignment(Covariate::Odometry, Deviation::Lag).with_one_reading(LEAST_ROOT)]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let recorded = &*log.comparison.recorded;
        let increments = increments_of(log.comparison, log.effects, log.fitted);
        let products = lag_products(recorded.track.secs(), &increments, &log.fitted.nuisances.odometry_error);
        let mut sums = [[0.0; 2]; 2];
        for (scan, [product, _]) in products.into_iter().enumerate() {
            let [sum, squares] = &mut sums[recorded.folds.half_of(scan + 1)];
            *sum += product;
            *squares += product * product;
        }
        vec![sums.map(|[sum, squares]| sum / squares.sqrt().max(f64::MIN_POSITIVE))]
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Pose2, Stage, Track};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// A robot drives straight with an exact odometry, and each heading of its reference errs by 1 mrad: what an increment turns is what it
    /// errs by. Against the turns of others nothing is seen, and an odometry that turns a tenth too far in long turns still is.
    #[test]
    fn errors_of_the_reference_are_no_errors_of_the_odometry() {
        let turning =
            OdometryCorrelation { kind: EffectKind::OdomTurnScale, error: Axis::Turn, motion: Axis::Turn };
        let spread = OdometrySpread { sigma_rad: 1.4e-3, ..OdometrySpread::default() };
        let stamped = (0..401).map(|i| (0.1 * f64::from(i), Pose2::IDENTITY));
        let folds = Folds::new(&Track::new(stamped).unwrap(), 2.0, 20..=20);
        let correlated = |turn: fn(u32) -> f64, scale: f64, errs| {
            let mut rng = Draw::new(1, Stage::Path, 0).item(0);
            let headings: Vec<f64> =
                (0..401).map(|_| 1e-3 * Distribution::<f64>::sample(&StandardNormal, &mut rng)).collect();
            let increment = |(i, pair): (u32, &[f64])| {
                let read = turn(i) + pair[1] - pair[0];
                let odometry = (1.0 + scale) * turn(i);
                Increment { truth: [0.1, read], error: [0.0, odometry - read], squares: [[0.0; 2]; 2] }
            };
            let increments: Vec<Increment> = (0..).zip(headings.windows(2)).map(increment).collect();
            turning.of_increments(&increments, folds, &spread, errs).iter().sum::<f64>()
        };
        let straight: fn(u32) -> f64 = |_| 0.0;
        let turns: fn(u32) -> f64 = |i| if i % 40 < 15 { 0.05 } else { 0.0 };
        assert!(correlated(straight, 0.0, false) < -20.0 && correlated(straight, 0.0, true).abs() < 5.0);
        assert!(correlated(turns, 0.1, true) > 10.0, "{}", correlated(turns, 0.1, true));
    }
}
