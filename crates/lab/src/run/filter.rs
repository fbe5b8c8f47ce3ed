//! The particle filter that a scenario describes.

use std::sync::Arc;

use locsim_core::{Drive, Pose2};
use locsim_dataset::{OdometryCalibration, OdometryError};
use locsim_mcl::{
    FilterOptions, KldOptions, MotionModel, Multinomial, OdometryMotion, ParticleCount, PoseBins, RandomWalk,
    Resampler, Residual, Spread, Start, Stratified, Systematic, VelocityMotion,
};
use locsim_scenario::{self as scenario, Estimate, Motion};

use crate::LabError;

/// Side of a bin of the densest cluster when the scenario doesn't set one: AMCL's 0.5 m and 10 degrees.
const CLUSTER_BINS: (f64, f64) = (0.5, 10.0 * std::f64::consts::PI / 180.0);

/// Fitted motion noise is this many times the odometry's (variances).
const FITTED_TIMES: f64 = 2.0;
/// Least variance of fitted motion noise, in m^2 and rad^2 per metre driven and per radian turned. The errors of nominal ranges are
/// alike from scan to scan; with less motion noise than that the filter loses its particles. It is of the way, not of a step: a
/// log with ten times the scans isn't ten times as sure.
const LEAST_VARIANCE: f64 = 0.001;

/// Of steps of a few millimetres, most of the way is jitter of the encoders.
const MOST_LEAST_ALPHA: f64 = 0.1;

/// Takes the systematic part of the odometry's error out of a log, as the scans without those that trials localize on show it; `None`
/// where they show none.
pub(crate) fn calibrated(drive: &mut Drive, localized: &[usize]) -> Option<OdometryCalibration> {
    let found = OdometryCalibration::of(&without_references(drive, localized))?;
    found.apply(drive);
    Some(found)
}

fn without_references(drive: &Drive, localized: &[usize]) -> Drive {
    let mut others = drive.clone();
    for &i in localized {
        others.steps[i].reference = None;
    }
    others
}

/// Motion noise fitted to the odometry's error against the reference, on the scans of a log without those that trials localize
/// on; `None` with too few of them.
pub(crate) fn fitted_alpha(drive: &Drive, localized: &[usize]) -> Option<[f64; 4]> {
    let error = OdometryError::of(&without_references(drive, localized))?;
    let least = least_alpha(drive);
    Some(std::array::from_fn(|i| (FITTED_TIMES * error.alpha[i]).max(least[i])))
}

/// The alphas that add [`LEAST_VARIANCE`]: a step's variance goes with its square, and the way is the sum of the steps.
fn least_alpha(drive: &Drive) -> [f64; 4] {
    let [mut way, mut squares] = [[0.0; 2]; 2];
    for i in 1..drive.steps.len() {
        let step = drive.odometry_increment(i);
        for (axis, length) in [step.theta.abs(), step.position().length()].into_iter().enumerate() {
            way[axis] += length;
            squares[axis] += length * length;
        }
    }
    let of = |axis: usize| if squares[axis] > 0.0 { LEAST_VARIANCE * way[axis] / squares[axis] } else { 0.0 };
    let [turn, distance] = [of(0), of(1)];
    [turn, distance, distance, turn].map(|alpha| alpha.clamp(LEAST_VARIANCE, MOST_LEAST_ALPHA))
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
    let motion = Arc::new(RandomWalk::new(motion, settings.random_walk_m)?);
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
        update: settings.update,
        least_effective_share: settings.least_effective_share,
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

    /// Odometry that is 10 % long is shortened by what the scans show that aren't localized on, and all of the drive with it.
    #[test]
    fn odometry_is_calibrated_on_scans_that_are_not_localized_on() {
        let mut long = drive([1e-4; 4], 1000);
        for step in &mut long.steps {
            let Pose2 { x, y, theta } = step.odometry;
            step.odometry = Pose2::new(1.1 * x, 1.1 * y, theta);
        }
        let localized: Vec<usize> = (600..800).collect();
        for &i in &localized {
            // Says nothing of the odometry: it isn't to be looked at.
            long.steps[i].reference = Some(Pose2::IDENTITY);
        }
        let length = |drive: &Drive| -> f64 {
            (601..800).map(|i| drive.odometry_increment(i).position().length()).sum()
        };
        let before = length(&long);
        let found = calibrated(&mut long, &localized).unwrap();
        assert!((found.matrix[0][0] - 1.0 / 1.1).abs() < 0.005, "{found}");
        assert!((length(&long) / before - 1.0 / 1.1).abs() < 0.005);
        assert_eq!(calibrated(&mut long, &localized), None, "nothing is left of it");
    }

    /// The random walk of a scenario is that of its filter.
    #[test]
    fn particles_walk_as_the_scenario_says() {
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios/ci-smoke.yaml");
        let mut settings = scenario::Scenario::load(&file, &scenario::Overrides::default()).unwrap().filter;
        settings.motion = Motion::Odometry(Some([0.0; 4]));
        let mut across = |walk: f64| {
            settings.random_walk_m = walk;
            let mut particles: Particles = std::iter::repeat_n(Pose2::IDENTITY, 2000).collect();
            let draw = Draw::new(1, Stage::Motion, 0);
            let motion = options(&settings, false).unwrap().motion;
            motion.propagate(&Pose2::new(1.0, 0.0, 0.0), &draw, &mut particles);
            (particles.y.iter().map(|y| y * y).sum::<f64>() / 2000.0).sqrt()
        };
        assert_eq!(across(0.0), 0.0);
        assert!((across(0.05) / 0.05 - 1.0).abs() < 0.1);
    }

    /// Ten times the scans, each with a tenth of the way, have as much noise over the same way.
    #[test]
    fn the_least_noise_is_of_the_way_and_not_of_the_scans() {
        let over_a_metre = |steps_per_m: u32| {
            let mut plain = drive([0.0; 4], 1);
            let step = Pose2::new(1.0 / f64::from(steps_per_m), 0.0, 0.0);
            for i in 0..20 * steps_per_m {
                let last = plain.steps.last().unwrap().clone();
                let pose = last.odometry.compose(&step);
                plain.steps.push(DriveStep {
                    stamp_secs: f64::from(i),
                    odometry: pose,
                    reference: Some(pose),
                    ..last
                });
            }
            let [_, _, alpha, _] = fitted_alpha(&plain, &[]).unwrap();
            f64::from(steps_per_m) * alpha * step.x * step.x
        };
        let [sparse, dense] = [2, 20].map(over_a_metre);
        assert!(
            (sparse - LEAST_VARIANCE).abs() < 1e-6 && (dense / sparse - 1.0).abs() < 0.1,
            "{sparse} {dense}"
        );
    }

    #[test]
    fn perfect_odometry_keeps_the_least_noise_and_a_short_drive_says_nothing() {
        // Steps of half a metre, and turns of 0.6 rad where there are any.
        let [turn, distance] = [LEAST_VARIANCE / 0.6, LEAST_VARIANCE / 0.5];
        let fitted = fitted_alpha(&drive([0.0; 4], 400), &[]).unwrap();
        for (fitted, least) in fitted.iter().zip([turn, distance, distance, turn]) {
            assert!((fitted / least - 1.0).abs() < 1e-9, "{fitted} for {least}");
        }
        assert_eq!(fitted_alpha(&drive(ALPHA, 4), &[]), None);
    }
}
