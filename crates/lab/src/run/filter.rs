//! The particle filter that a scenario describes.

use std::sync::Arc;

use locsim_core::Pose2;
use locsim_mcl::{
    AnnealingOptions, FilterOptions, KldOptions, MotionModel, Multinomial, OdometryMotion, PoseBins,
    Regularization, ResampleTrigger, Resampler, Residual, Start, Stratified, Systematic, VelocityMotion,
};
use locsim_scenario::{self as scenario, Estimate, Motion, ParticleCount, ResampleWhen};

use crate::LabError;

/// Side of a bin of the densest cluster when the scenario doesn't set one: AMCL's 0.5 m and 10 degrees.
const CLUSTER_BINS: (f64, f64) = (0.5, 10.0 * std::f64::consts::PI / 180.0);

/// Where the filter starts; `None` where it starts at the true first pose and that isn't known.
pub(super) fn start(settings: &scenario::Filter, truth: Option<Pose2>) -> Option<Start> {
    let around = |pose, spread: scenario::Spread| Start::Tracking {
        pose,
        sigma_m: spread.sigma_m,
        sigma_rad: spread.sigma_rad,
    };
    Some(match settings.start {
        scenario::Start::Global => Start::Global,
        scenario::Start::Around(pose, spread) => around(pose, spread),
        scenario::Start::Tracking(spread) => around(truth?, spread),
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
    let (particles, bins) = match settings.particles {
        ParticleCount::Fixed(n) => (locsim_mcl::ParticleCount::Fixed(n as usize), CLUSTER_BINS),
        ParticleCount::Kld { min, max, error, quantile, bin_m, bin_rad } => (
            locsim_mcl::ParticleCount::Kld(KldOptions {
                min: min as usize,
                max: max as usize,
                error,
                quantile,
                bins: PoseBins::new(bin_m, bin_rad)?,
            }),
            (bin_m, bin_rad),
        ),
    };
    let jitter = settings.regularization;
    Ok(FilterOptions {
        particles,
        motion,
        resampler,
        trigger: match settings.resample {
            ResampleWhen::EachStep => ResampleTrigger::EachStep,
            ResampleWhen::EffectiveShareBelow(share) => ResampleTrigger::EffectiveShareBelow(share),
        },
        injection: settings.injection.map(|injection| locsim_mcl::InjectionOptions {
            alpha_slow: injection.alpha_slow,
            alpha_fast: injection.alpha_fast,
        }),
        regularization: (jitter.sigma_m > 0.0 || jitter.sigma_rad > 0.0)
            .then_some(Regularization { sigma_m: jitter.sigma_m, sigma_rad: jitter.sigma_rad }),
        clusters: (settings.estimate == Estimate::DensestCluster)
            .then(|| PoseBins::new(bins.0, bins.1))
            .transpose()?,
        annealing: settings.annealing.map(|annealing| AnnealingOptions {
            candidates: annealing.candidates as usize,
            effective_share: annealing.effective_share,
            moves: annealing.moves as usize,
            sigma_m: annealing.step.sigma_m,
            sigma_rad: annealing.step.sigma_rad,
            gathered_m: annealing.gathered_m,
        }),
        ancestry,
    })
}
