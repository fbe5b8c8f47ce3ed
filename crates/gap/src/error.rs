use locsim_comparison::ComparisonError;
use locsim_core::RecordedError;
use locsim_world::effect::EffectError;
use locsim_world::simulation::SimulationError;
use thiserror::Error;

/// Why a log can't be held against a simulation.
#[derive(Debug, Error)]
pub enum GapError {
    /// The log can't be compared with the simulator.
    #[error(transparent)]
    Comparison(#[from] ComparisonError),
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

impl From<RecordedError> for GapError {
    fn from(error: RecordedError) -> Self {
        ComparisonError::from(error).into()
    }
}

impl From<SimulationError> for GapError {
    fn from(error: SimulationError) -> Self {
        ComparisonError::from(error).into()
    }
}

impl From<EffectError> for GapError {
    fn from(error: EffectError) -> Self {
        ComparisonError::from(error).into()
    }
}
