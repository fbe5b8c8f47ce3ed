use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::SensorError;

/// The models that are fitted to data, by the names that scenarios and tables use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModelKind {
    /// Gaussian at the nominal range and exponential, the paper's baseline: Probabilistic Robotics, eqs. 6.4
    /// to 6.9.
    Classic,
    /// Hit, short, max and random: Probabilistic Robotics, tables 6.1 and 6.2.
    BeamMixture,
    /// Distance of the reading's end to the map: Probabilistic Robotics, table 6.3.
    LikelihoodField,
    /// Gaussian whose parameters are regressed on the state: the paper's procedure 1.
    PReg,
    /// Histograms of z smoothed over the state: the paper's procedure 2, as published.
    NpReg,
    /// Histograms of z - r smoothed over the state.
    NpRegRegistered,
}

impl ModelKind {
    /// Every kind, in the order of tables.
    pub const ALL: [Self; 6] = [
        Self::Classic,
        Self::BeamMixture,
        Self::LikelihoodField,
        Self::PReg,
        Self::NpReg,
        Self::NpRegRegistered,
    ];

    /// The name, for example `np_reg_registered`.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Classic => "classic",
            Self::BeamMixture => "beam_mixture",
            Self::LikelihoodField => "likelihood_field",
            Self::PReg => "p_reg",
            Self::NpReg => "np_reg",
            Self::NpRegRegistered => "np_reg_registered",
        }
    }
}

impl fmt::Display for ModelKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for ModelKind {
    type Err = SensorError;

    fn from_str(name: &str) -> Result<Self, SensorError> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.as_str() == name)
            .ok_or_else(|| SensorError::UnknownModel(name.to_owned()))
    }
}
