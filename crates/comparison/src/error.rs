use locsim_core::RecordedError;
use locsim_world::effect::EffectError;
use locsim_world::simulation::SimulationError;
use thiserror::Error;

/// Why a log can't be compared with a simulator.
#[derive(Debug, Error)]
pub enum ComparisonError {
    /// No part of the log can be compared.
    #[error(transparent)]
    Recorded(#[from] RecordedError),
    /// The log's laser is not the scenario's.
    #[error("the log's laser {what} is {log}, the scenario's {scenario}")]
    Laser {
        /// The difference.
        what: &'static str,
        /// As the log says.
        log: f64,
        /// As the scenario says.
        scenario: f64,
    },
    /// The simulated laser has no noise.
    #[error(
        "the nominal laser has no noise: no reading of a real one has a density under it; set laser.noise.sigma_m"
    )]
    NoNoise,
    /// A hidden drive needs a speed between any two of its poses.
    #[error("a drive needs at least two poses, each later than the one before")]
    Truth,
    /// The simulator refused.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// An effect out of its bounds.
    #[error(transparent)]
    Effect(#[from] EffectError),
}
