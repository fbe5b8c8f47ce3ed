//! Errors of the odometry's increments against those of the reference.

use distreg::contamination::{detectable_share, score};
use distreg::{Correlation, lasting};
use locsim_comparison::{Comparison, Fitted, shown_by};
use locsim_core::Folds;
use locsim_world::effect::{self, Axis, EffectKind, Effects};
use locsim_world::simulation::{Increment, OdometrySpread, lagging, standardized};

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

/// Lags that are tried, to either side up to half a second \[s\].
const LAGS: usize = 25;
const LAG_SECS: f64 = 0.02;
const LEAST_STEPS: usize = 2;
/// The least mean error of an increment \[m, rad\].
const LEAST_ERROR: f64 = 1e-3;
/// In most logs no lag is likelier than none, by not a nat; a root of this is of a few increments.
const LEAST_ROOT: f64 = 1.0;

/// The log likelihood ratio of an odometry that lags behind the stamps, by Laplace's distribution of any width: noise that was fitted to
/// a log has the lag in it. The rival is none or, if likelier, as much to the other side: the reference errs less between two poses.
pub(super) struct OdometryLag;

impl Family for OdometryLag {
    fn statistics(&self) -> Vec<Statistic> {
        vec![Statistic::of_misalignment(Covariate::Odometry, Deviation::Lag).with_one_reading(LEAST_ROOT)]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let increments = increments_of(log.comparison, log.effects, log.fitted);
        let track =
            log.comparison.recorded.track.with_poses(log.comparison.corrected(&log.fitted.corrections));
        // Sums over each half's increments: errors by axis, and how many.
        let errors = |step: usize| {
            let [late, reach] = [step as f64 - LAGS as f64, LAGS as f64].map(|steps| steps * LAG_SECS);
            let mut sums = [[LEAST_ERROR, LEAST_ERROR, 1.0]; 2];
            for (scan, increment) in lagging(&track, late, reach, &increments) {
                let [along, turn] = increment.error.map(|error| error.abs() + LEAST_ERROR);
                let sums = &mut sums[log.comparison.recorded.folds.half_of(scan + 1)];
                sums.iter_mut().zip([along, turn, 1.0]).for_each(|(sum, more)| *sum += more);
            }
            sums
        };
        let all: Vec<[[f64; 3]; 2]> = (0..=2 * LAGS).map(errors).collect();
        let ratios = |step: usize| -> Halves {
            std::array::from_fn(|half| {
                let [own, none, other] = [step, LAGS, 2 * LAGS - step].map(|step| all[step][half]);
                own[2] * (0..2).map(|axis| (none[axis].min(other[axis]) / own[axis]).ln()).sum::<f64>()
            })
        };
        // A lag below is within the interpolation.
        let steps = (0..all.len()).filter(|step| step.abs_diff(LAGS) >= LEAST_STEPS);
        let most = steps.map(ratios).max_by(|[a, b], [c, d]| (a + b).total_cmp(&(c + d)));
        // The root of a ratio has no long tail.
        vec![most.unwrap_or_default().map(|ratio| (2.0 * ratio.max(0.0)).sqrt())]
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
