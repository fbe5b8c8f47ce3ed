//! The particle filter that a scenario describes.

use std::sync::Arc;

use locsim_core::{Drive, Pose2};
use locsim_dataset::OdometryError;
use locsim_mcl::{
    FilterOptions, KldOptions, MotionModel, Multinomial, OdometryMotion, ParticleCount, PoseBins, Resampler,
    Residual, Spread, Start, Stratified, Systematic, VelocityMotion,
};
use locsim_scenario::{self as scenario, Estimate, Motion};

use crate::LabError;

/// Side of a bin of the densest cluster when the scenario doesn't set one: AMCL's 0.5 m and 10 degrees.
const CLUSTER_BINS: (f64, f64) = (0.5, 10.0 * std::f64::consts::PI / 180.0);

/// Fitted motion noise is this many times the odometry's, and each alpha at least this. The errors of nominal ranges are alike
/// from scan to scan; with less motion noise than that the filter loses its particles.
const FITTED_ALPHA: (f64, f64) = (2.0, 0.002);

/// Motion noise fitted to the odometry's error against the reference, on the scans of a log without those that trials localize
/// on; `None` with too few of them.
pub(crate) fn fitted_alpha(drive: &Drive, localized: &[usize]) -> Option<[f64; 4]> {
    let mut others = drive.clone();
    for &i in localized {
        others.steps[i].reference = None;
    }
    let error = OdometryError::of(&others)?;
    Some(error.alpha.map(|alpha| (FITTED_ALPHA.0 * alpha).max(FITTED_ALPHA.1)))
}

/// Where the filter starts; `None` where it starts at the true first pose and that isn't known.
pub(super) fn start(settings: &scenario::Filter, truth: Option<Pose2>) -> Option<Start> {
    Some(match settings.start {
        scenario::Start::Global => Start::Global,
        scenario::Start::Around(pose, spread) => Start::Tracking { pose, spread },
        scenario::Start::Tracking(spread) => Start::Tracking { pose: truth?, spread },
    })
}

/// The filter that a scenario describes; motion noise that isn't known is the usual.
pub(crate) fn options(settings: &scenario::Filter, ancestry: bool) -> Result<FilterOptions, LabError> {
    let motion: Arc<dyn MotionModel> = match settings.motion {
        Motion::Odometry(alpha) => {
            Arc::new(OdometryMotion::new(alpha.unwrap_or(OdometryError::USUAL_ALPHA))?)
        }
        Motion::Velocity(alpha) => Arc::new(VelocityMotion::new(alpha)?),
    };
    let resampler: Arc<dyn Resampler> = match settings.resampler {
        scenario::Resampler::Multinomial => Arc::new(Multinomial),
        scenario::Resampler::Systematic => Arc::new(Systematic),
        scenario::Resampler::Stratified => Arc::new(Stratified),
        scenario::Resampler::Residual => Arc::new(Residual),
    };
    let (bin_m, bin_rad) = match settings.particles {
        ParticleCount::Fixed(_) => CLUSTER_BINS,
        ParticleCount::Kld(KldOptions { bin_m, bin_rad, .. }) => (bin_m, bin_rad),
    };
    let jitter = settings.regularization;
    Ok(FilterOptions {
        particles: settings.particles,
        motion,
        resampler,
        trigger: settings.resample,
        injection: settings.injection,
        regularization: (jitter != Spread::default()).then_some(jitter),
        clusters: (settings.estimate == Estimate::DensestCluster)
            .then(|| PoseBins::new(bin_m, bin_rad))
            .transpose()?,
        annealing: settings.annealing,
        ancestry,
    })
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, DriveStep, Laser, Particles, Scan, Stage};

    use super::*;

    const ALPHA: [f64; 4] = [0.03, 0.02, 0.02, 0.01];

    /// A drive of steps of half a metre in wide curves, with odometry that is as noisy as the motion model has it.
    fn drive(alpha: [f64; 4], steps: u32) -> Drive {
        let motion = OdometryMotion::new(alpha).unwrap();
        let draw = Draw::new(3, Stage::Motion, 1);
        let (mut truth, mut odometry) = (Pose2::IDENTITY, Particles::from_iter([Pose2::IDENTITY]));
        let steps = (0..steps).map(|i| {
            let increment = Pose2::new(0.5, 0.0, if i / 8 % 3 == 0 { 0.0 } else { 0.6 });
            truth = truth.compose(&increment);
            motion.propagate(&increment, &draw.at(i), &mut odometry);
            DriveStep {
                stamp_secs: f64::from(i),
                odometry: odometry.get(0),
                reference: Some(truth),
                scan: Scan { ranges: vec![1.0] },
            }
        });
        let laser = Laser::new(vec![0.0], vec![0.0], 0.0, 10.0, Pose2::IDENTITY).unwrap();
        Drive { steps: steps.collect(), laser }
    }

    /// A variance of 1,000 windows is known to 4.5 % (one standard deviation); each alpha is one of two regressors that share
    /// it, so that it is known to about 20 %.
    #[test]
    fn motion_noise_is_fitted_on_scans_that_are_not_localized_on() {
        let measured = drive(ALPHA, 4000);
        let fitted = fitted_alpha(&measured, &[]).unwrap();
        for (fitted, alpha) in fitted.iter().zip(ALPHA) {
            let ratio = fitted / (2.0 * alpha);
            assert!((0.5..2.0).contains(&ratio), "{fitted} for {alpha}");
        }

        let localized: Vec<usize> = (1000..2000).collect();
        let without = fitted_alpha(&measured, &localized).unwrap();
        assert_ne!(without, fitted);
        let mut garbage = measured;
        for &i in &localized {
            garbage.steps[i].odometry = Pose2::new(i as f64, -7.0, 1.0);
        }
        assert_eq!(fitted_alpha(&garbage, &localized), Some(without));
    }

    #[test]
    fn perfect_odometry_keeps_the_least_noise_and_a_short_drive_says_nothing() {
        assert_eq!(fitted_alpha(&drive([0.0; 4], 400), &[]), Some([FITTED_ALPHA.1; 4]));
        assert_eq!(fitted_alpha(&drive(ALPHA, 4), &[]), None);
    }
}
