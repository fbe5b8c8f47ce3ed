use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::positive;

/// The quantity that is smoothed over states: the observation itself, or the observation relative to a state
/// coordinate. Where the observation follows that coordinate, aligned observations of neighbouring states agree, and
/// smoothing over states doesn't blur them ("registered" regression).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// z, as published.
    #[default]
    Identity,
    /// z minus the coordinate; a prediction is shifted back by the query's coordinate.
    Shift {
        /// Index of the state coordinate.
        state_dim: usize,
    },
    /// z divided by the coordinate, which must be positive; a prediction is scaled back.
    Scale {
        /// Index of the state coordinate.
        state_dim: usize,
    },
}

impl Alignment {
    /// The affine map from aligned observations to z at `state`: z = offset + scale * aligned.
    ///
    /// # Errors
    /// If the coordinate doesn't exist, or is to divide and isn't positive.
    pub(crate) fn at(self, state: &[f64]) -> Result<Affine, Error> {
        let coordinate = |state_dim: usize| {
            state.get(state_dim).copied().ok_or(Error::AlignmentDimension { state_dim, dim: state.len() })
        };
        match self {
            Self::Identity => Ok(Affine { offset: 0.0, scale: 1.0 }),
            Self::Shift { state_dim } => Ok(Affine { offset: coordinate(state_dim)?, scale: 1.0 }),
            Self::Scale { state_dim } => {
                let scale = positive("the state coordinate of a scale alignment", coordinate(state_dim)?)?;
                Ok(Affine { offset: 0.0, scale })
            }
        }
    }
}

/// z = offset + scale * aligned, with a positive scale.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Affine {
    pub offset: f64,
    pub scale: f64,
}

impl Affine {
    pub fn align(self, z: f64) -> f64 {
        (z - self.offset) / self.scale
    }

    pub fn restore(self, aligned: f64) -> f64 {
        self.offset + self.scale * aligned
    }
}
