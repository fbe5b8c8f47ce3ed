use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A curve by which readings differ from the simulator's, as a table of two columns: one covariate (none for every beam
/// alike) and one quantity. `locsim gap` writes them where it knows that something depends on something, and not why.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawResidual {
    /// Nominal ranges (m), ascending; between them the curve is linear, beyond them constant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range_m: Option<Vec<f64>>,
    /// Incidences (deg), ascending.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub incidence_deg: Option<Vec<f64>>,
    /// Bearings in the laser frame (deg), ascending.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bearing_deg: Option<Vec<f64>>,
    /// Times since the drive's first scan (s), ascending.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_secs: Option<Vec<f64>>,
    /// Cells of the map in which nominal rays end, `[x_min, y_min, x_max, y_max]` (m); nothing differs outside.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cells_m: Option<Vec<[f64; 4]>>,
    /// Bias of a return (m), -10 to 10.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias_m: Option<Vec<f64>>,
    /// Relative change of the standard deviation of a return, -0.99 to 100: 0.5 for one and a half times the noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spread: Option<Vec<f64>>,
    /// Probability of no return, 0 to 1, beside the other effects.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_return: Option<Vec<f64>>,
    /// Probability of a reading somewhere in front of the wall, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub short: Option<Vec<f64>>,
    /// Probability of a reading somewhere behind the wall, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub long: Option<Vec<f64>>,
}
