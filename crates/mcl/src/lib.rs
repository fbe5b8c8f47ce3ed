//! Monte Carlo localization (Probabilistic Robotics, chapter 8): motion models, resamplers, the particle
//! filter and the estimates that are read off it.
//!
//! A [`Filter`] owns a weighted particle set. Each [`Filter::step`] moves it by the odometry ([`MotionModel`]),
//! casts the scan's beams into a map ([`locsim_core::RangeMap`]), weights it by a sensor model
//! ([`locsim_core::SensorModel`]), reads off the estimates and, where the options say so, resamples it
//! ([`Resampler`]). Every random number is keyed by the filter's seed and the step, and work is split into runs
//! of fixed length, so a filter's results do not depend on the number of threads.

mod adaptive;
mod ancestry;
mod annealing;
mod augmented;
mod bins;
mod error;
mod estimate;
mod filter;
mod motion;
mod resampling;
mod spread;
mod start;
mod update_threshold;
mod weigh;

pub use adaptive::{KldOptions, KldSampler};
pub use ancestry::{Ancestry, NO_PARENT, PRUNED_AFTER, Trajectory};
pub use annealing::AnnealingOptions;
pub use augmented::{Augmented, InjectionOptions};
pub use bins::PoseBins;
pub use error::FilterError;
pub use estimate::{Cluster, Clusters, Estimate, max_weight, weighted_mean};
pub use filter::{
    Estimates, Filter, FilterOptions, ParticleCount, Recovery, ResampleTrigger, StepInput, StepOutcome,
    Update,
};
pub use motion::{MotionModel, OdometryMotion, RandomWalk, VelocityMotion};
pub use resampling::{Multinomial, Resampler, Residual, Stratified, Systematic};
pub use spread::Spread;
pub use start::Start;
pub use update_threshold::UpdateThreshold;
