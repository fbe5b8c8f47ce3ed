//! An odometry that lags behind the stamps.

use locsim_comparison::{Comparison, Fitted};
use locsim_core::{Recorded, normal};
use locsim_world::effect::Effects;
use locsim_world::simulation::{Increment, OdometrySpread, lagging, standardized};

use super::Misalignment;
use crate::statistics::{Covariate, Deviation, lag_products};

/// Lags that are tried: to both sides up to half a second, in steps of this \[s\]: 1 cm at 1 m/s, the noise of a laser.
const STEPS: i32 = 50;
const STEP_SECS: f64 = 0.01;
/// Odometries are interpolated at the scans' stamps: a lag of so few steps is none.
const NO_LAG: usize = 1;
const MOST_SECS: f64 = STEPS as f64 * STEP_SECS;

/// The odometry's lag behind the stamps \[s\], with its standard error by the curvature of the log likelihood, and the gain on each fold by the
/// lag of the others: over none, or over as much to the other side where that is likelier, because a reference errs less between two of its
/// poses.
pub(crate) fn lag(comparison: &Comparison<'_>, effects: &Effects, fitted: &Fitted) -> Misalignment {
    let recorded = &*comparison.recorded;
    let corrected = comparison.corrected(&fitted.corrections);
    let increments = Increment::all(effects, &corrected, &recorded.odometry);
    let track = recorded.track.with_poses(corrected);
    let folds = recorded.folds;
    // Log likelihood of each fold at each lag, up to a constant.
    let at = |step: i32| -> Vec<f64> {
        let mut sums = vec![0.0; folds.count()];
        for (i, increment) in lagging(&track, f64::from(step) * STEP_SECS, MOST_SECS, &increments) {
            let errors = standardized(&increment, &fitted.nuisances.odometry_error);
            sums[folds.of_scan(i + 1)] -= 0.5 * errors.iter().map(|e| e * e).sum::<f64>();
        }
        sums
    };
    let mut all: Vec<Vec<f64>> = (-STEPS..=STEPS).map(at).collect();
    let errors = 2.0 * lagging(&track, 0.0, MOST_SECS, &increments).count().max(1) as f64;
    // Errors that are larger than those of the fitted noise at every lag have noise of their own.
    let least = all.iter().map(|folds| -folds.iter().sum::<f64>()).fold(f64::INFINITY, f64::min);
    let excess = (2.0 * least / errors).max(1.0);
    all.iter_mut().flatten().for_each(|log| *log /= excess);
    let total: Vec<f64> = all.iter().map(|folds| folds.iter().sum()).collect();
    let none = STEPS as usize;
    let best =
        |of: &dyn Fn(usize) -> f64| (0..all.len()).max_by(|&a, &b| of(a).total_cmp(&of(b))).unwrap_or(none);
    let gain = |fold: usize| {
        let of_others = |i: usize| total[i] - all[i][fold];
        let lag = best(&of_others);
        let opposite = 2 * none - lag;
        let rival = if of_others(opposite) > of_others(none) { opposite } else { none };
        all[lag][fold] - all[rival][fold]
    };
    let lag = best(&|i| total[i]).clamp(1, all.len() - 2);
    let late = (lag as f64 - none as f64) * STEP_SECS;
    // In reference poses that err each on its own, a lag of none or of a step looks like a longer one: between two poses they err less.
    let by_odometry = lag_by_odometry(recorded, &fitted.nuisances.odometry_error, &increments);
    let is_lag =
        lag.abs_diff(none) > NO_LAG && by_odometry.is_beyond(late.signum(), NO_LAG as f64 * STEP_SECS);
    let curvature = (2.0 * total[lag] - total[lag - 1] - total[lag + 1]).max(1e-6);
    Misalignment {
        deviation: Deviation::Lag,
        covariate: Covariate::Odometry,
        estimates: vec![[late, STEP_SECS / curvature.sqrt()]],
        gains: (0..folds.count()).map(|fold| if is_lag { gain(fold) } else { 0.0 }).collect(),
    }
}

/// A lag \[s\] with its standard error.
struct LagEstimate {
    secs: f64,
    error: f64,
}

impl LagEstimate {
    /// Whether it is surely longer than `least` \[s\], to one side.
    fn is_beyond(&self, sign: f64, least: f64) -> bool {
        sign * self.secs - normal::QUANTILE_975 * self.error > least
    }
}

/// The lag by how the odometry's errors go with its changes of speed; see [`lag_products`]. A lag that is longer than a step of the log comes
/// out shorter or longer, but not as none.
fn lag_by_odometry(recorded: &Recorded, spread: &OdometrySpread, increments: &[Increment]) -> LagEstimate {
    let mut sums = vec![[0.0; 2]; recorded.folds.count()];
    for (i, products) in lag_products(recorded.track.secs(), increments, spread).into_iter().enumerate() {
        let sum = &mut sums[recorded.folds.of_scan(i + 1)];
        sum.iter_mut().zip(products).for_each(|(sum, more)| *sum += more);
    }
    let [product, changes] = [0, 1].map(|which| sums.iter().map(|sum| sum[which]).sum::<f64>());
    if changes <= 0.0 {
        // No speed has changed.
        return LagEstimate { secs: 0.0, error: f64::INFINITY };
    }
    let secs = product / changes;
    let rests = sums.iter().map(|[product, changes]| (product - secs * changes).powi(2));
    LagEstimate { secs, error: rests.sum::<f64>().sqrt() / changes }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::Nuisances;
    use locsim_comparison::fixtures::{DRIVE, NOMINAL};
    use locsim_core::{Draw, Pose2, Stage, gains_surely};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::Recorded;

    /// Odometry of the scan before: it lags by a tenth of a second.
    #[test]
    fn a_lag_is_found() {
        for late in [0_u32, 1] {
            let mut drive = DRIVE.clone();
            for i in late as usize..drive.steps.len() {
                drive.steps[i].odometry = DRIVE.steps[i - late as usize].odometry;
            }
            let recorded = Recorded::new(&drive, 400, 24, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            let lag = lag(&comparison, &NOMINAL.effects, &fitted);
            assert!((lag.estimates[0][0] - 0.1 * f64::from(late)).abs() < 0.03, "{lag:?}");
            assert_eq!(lag.gain() > 5.0, late > 0, "{lag:?}");
        }
    }
    /// Headings of the reference err by 20 mrad, each on its own, and by less where they are interpolated. That is a lag in no more than 1 of 20
    /// logs: 1.96 standard errors are exceeded to one side by chance in 1 of 40.
    #[test]
    fn a_reference_that_errs_less_between_its_poses_is_no_lag() {
        let sure = |seed: u64| {
            let mut drive = DRIVE.clone();
            let mut rng = Draw::new(seed, Stage::Path, 0).item(0);
            for step in &mut drive.steps {
                let error: f64 = StandardNormal.sample(&mut rng);
                let Pose2 { x, y, theta } = step.reference.unwrap();
                step.reference = Some(Pose2::new(x, y, theta + 2e-2 * error));
            }
            let recorded = Recorded::new(&drive, 400, 24, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let mut fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            fitted.corrections.fill(glam::DVec3::ZERO);
            gains_surely(&lag(&comparison, &NOMINAL.effects, &fitted).gains)
        };
        let count = (0..20).filter(|&seed| sure(seed)).count();
        assert!(count <= 1, "{count}");
    }
}
