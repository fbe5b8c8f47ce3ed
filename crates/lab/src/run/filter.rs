//! The particle filter that a scenario describes.

use std::sync::Arc;

use locsim_core::Pose2;
use locsim_mcl::{
    FilterOptions, KldOptions, MotionModel, Multinomial, OdometryMotion, ParticleCount, PoseBins, Resampler,
    Residual, Spread, Start, Stratified, Systematic, VelocityMotion,
};
use locsim_scenario::{self as scenario, Estimate, Motion};

use crate::LabError;

/// Side of a bin of the densest cluster when the scenario doesn't set one: AMCL's 0.5 m and 10 degrees.
const CLUSTER_BINS: (f64, f64) = (0.5, 10.0 * std::f64::consts::PI / 180.0);

/// Where the filter starts; `None` where it starts at the true first pose and that isn't known.
pub(super) fn start(settings: &scenario::Filter, truth: Option<Pose2>) -> Option<Start> {
    Some(match settings.start {
        scenario::Start::Global => Start::Global,
        scenario::Start::Around(pose, spread) => Start::Tracking { pose, spread },
        scenario::Start::Tracking(spread) => Start::Tracking { pose: truth?, spread },
    })
}

/// The filter that a scenario describes.
pub(crate) fn options(settings: &scenario::Filter, ancestry: bool) -> Result<FilterOptions, LabError> {
    let motion: Arc<dyn MotionModel> = match settings.motion {
        Motion::Odometry(alpha) => Arc::new(OdometryMotion::new(alpha)?),
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
