use locsim_core::RecordedError;
use locsim_world::simulation::SimulationError;
use thiserror::Error;

/// Why a log can't be held against a simulation.
#[derive(Debug, Error)]
pub enum GapError {
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
    /// An option is out of its range.
    #[error("{option} must be {allowed}; got {value}")]
    Option {
        /// Its name.
        option: &'static str,
        /// The refused value.
        value: f64,
        /// The allowed content.
        allowed: &'static str,
    },
    /// The simulator refused.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// An effect out of its bounds.
    #[error(transparent)]
    Effect(#[from] locsim_world::effect::EffectError),
    /// Too few readings have a nominal range in the measured map.
    #[error(
        "only {readings} of {all} readings have a nominal range in the map; at least {least} are needed: reference poses, the laser's mount \
         or its angles and the map don't go together"
    )]
    TooFewReadings {
        /// How many have one.
        readings: usize,
        /// How many there are.
        all: usize,
        /// How many it takes.
        least: usize,
    },
    /// The caller asked to stop.
    #[error("interrupted")]
    Interrupted,
}
