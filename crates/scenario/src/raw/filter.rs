use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::default;
use crate::form::{Form, Short};
use crate::{Estimate, Resampler};

/// The particle filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawFilter {
    /// Number of particles, 1 to 10000000, or `{kld: ...}`.
    pub particles: Form<Count, RawAdaptive>,
    /// How particles move.
    pub motion: RawMotion,
    /// How ancestors are drawn.
    #[serde(default)]
    pub resampler: Resampler,
    /// When the filter resamples.
    #[serde(default)]
    pub resample: RawResample,
    /// `none`, or random particles injected when the likelihood drops (augmented MCL; Probabilistic Robotics,
    /// table 8.3).
    #[serde(default = "default::injection")]
    pub injection: Form<No, RawInjection>,
    /// Where particles start.
    pub start: RawStart,
    /// Beams of a scan that the filter uses, spread evenly. Default: all.
    pub beams: Option<u64>,
    /// Which scans are taken in: `each_scan`, or those after the robot has moved by a distance or turned by an angle, as AMCL does
    /// (`update_min_d`, `update_min_a`). Default: `{distance_m: 0.02, angle_deg: 1}` on a log, where scans of a robot that stands err
    /// alike; `each_scan` in simulation.
    pub update: Option<Form<EachScan, RawUpdate>>,
    /// Which pose estimate errors are measured of.
    #[serde(default)]
    pub estimate: Estimate,
    /// Gaussian jitter added after resampling (regularized particle filter).
    #[serde(default)]
    pub regularization: RawSpread,
    /// A scan that would leave fewer effective particles than this share is taken in by the largest power of its likelihood
    /// that leaves as many; 0 to below 1, 0 takes all in whole that aren't annealed. Default: 0.02 on a log, 0 in simulation.
    pub least_effective_share: Option<f64>,
    /// `none`, or scans taken in by small powers of their likelihood while the particles are spread (Del Moral, Doucet and
    /// Jasra 2006), for a global start; costs some ten weighings of the particles for each such scan. On a log with
    /// training scans, a filter of which 30 scans in a row don't fit starts anywhere again. Until they have gathered there are as many as KLD sampling asks for, by `particles.kld` or with bins of 0.5 m and 10 degrees up to 20000.
    #[serde(default = "default::annealing")]
    pub annealing: Form<NotAnnealed, RawAnnealing>,
}

/// A whole number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(transparent)]
pub struct Count(pub u64);

impl Short for Count {
    const FORMS: &'static [&'static str] =
        &["a whole number from 1 to 10000000", "{kld: {min: ..., max: ...}}"];

    fn from_count(count: u64) -> Option<Self> {
        Some(Self(count))
    }
}

/// A number of particles that adapts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawAdaptive {
    /// KLD sampling (Fox 2003).
    pub kld: RawKld,
}

/// KLD sampling (Fox 2003): enough particles that the Kullback-Leibler distance stays below a bound.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawKld {
    /// At least this many particles, 1 to 10000000.
    pub min: u64,
    /// At most this many, `min` to 10000000.
    pub max: u64,
    /// The bound epsilon, 0.000001 to 1000.
    #[serde(default = "default::kld_error")]
    pub error: f64,
    /// Probability with which the bound holds, 0.5 to below 1.
    #[serde(default = "default::kld_quantile")]
    pub quantile: f64,
    /// Side of a histogram bin (m), 0.001 to 10000.
    #[serde(default = "default::kld_bin_m")]
    pub bin_m: f64,
    /// Heading width of a histogram bin (deg), 0.001 to 360.
    #[serde(default = "default::kld_bin_deg")]
    pub bin_deg: f64,
}

/// Motion model with its noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawMotion {
    /// Which model.
    pub model: MotionModelName,
    /// Noise parameters, each 0 to 1000: alpha 1 to 4 (`odometry`) or 1 to 6 (`velocity`). On a log, those of `odometry` may be
    /// left out: they are then fitted to the log's odometry, on scans with a reference pose that no trial localizes on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alpha: Option<Vec<f64>>,
    /// Whether the systematic part of the odometry's error (wheels of another size or track) is taken out, as it shows against reference
    /// poses of scans that no trial localizes on. Only for a log. Default: `true` where `alpha` is left out, else `false`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibrate: Option<bool>,
    /// Standard deviation of a random walk of the position, in all directions alike, after a metre of way or a radian of turning (m), 0 to
    /// 1000; it grows with the root of either. Maps and reference poses that were made of a log are off by some centimetres, by
    /// others a few metres farther on. Default: 0.04 where `alpha` is left out, else 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub random_walk_m: Option<f64>,
}

/// The motion models there are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MotionModelName {
    /// Odometry model (Probabilistic Robotics, table 5.6).
    Odometry,
    /// Velocity model (Probabilistic Robotics, table 5.3).
    Velocity,
}

/// When the filter resamples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RawResample {
    /// After every scan.
    #[default]
    EachStep,
    /// When the effective sample size falls below this share of the particles, above 0 to 1.
    EffectiveShareBelow(f64),
}

/// The word `each_scan`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EachScan {
    /// Every scan.
    EachScan,
}

impl Short for EachScan {
    const FORMS: &'static [&'static str] = &["each_scan", "{distance_m: ..., angle_deg: ...}"];

    fn from_word(word: &str) -> Option<Self> {
        (word == "each_scan").then_some(Self::EachScan)
    }
}

/// How far the robot moves before another scan is taken in, whichever of the two it reaches first. Both keys are needed; 0 takes every scan in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawUpdate {
    /// Distance (m), 0 to 10000.
    pub distance_m: f64,
    /// Turn (deg), 0 to 180.
    pub angle_deg: f64,
}

/// The word `none`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum No {
    /// None.
    None,
}

impl Short for No {
    const FORMS: &'static [&'static str] = &["none", "{alpha_slow: ..., alpha_fast: ...}"];

    fn from_word(word: &str) -> Option<Self> {
        (word == "none").then_some(Self::None)
    }
}

/// Random particles after a drop of the likelihood: 0 < `alpha_slow` < `alpha_fast` <= 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawInjection {
    /// Decay rate of the long-term average likelihood.
    pub alpha_slow: f64,
    /// Decay rate of the short-term average likelihood.
    pub alpha_fast: f64,
}

/// The word `none`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NotAnnealed {
    /// None.
    None,
}

impl Short for NotAnnealed {
    const FORMS: &'static [&'static str] =
        &["none", "{candidates: ..., effective_share: ..., moves: ..., sigma_m: ..., ...}"];

    fn from_word(word: &str) -> Option<Self> {
        (word == "none").then_some(Self::None)
    }
}

/// Annealed scans; `{}` for all defaults, which suit a laser of some tens of beams with noise of one to some centimetres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawAnnealing {
    /// Particles of a global start, 1 to 10000000; fewer from the first scan on.
    #[serde(default = "default::annealing_candidates")]
    pub candidates: u64,
    /// Each power is the largest that leaves this share of the particles effective, above 0 and below 1.
    #[serde(default = "default::annealing_effective_share")]
    pub effective_share: f64,
    /// Metropolis moves of each particle after each power, 1 to 1000.
    #[serde(default = "default::annealing_moves")]
    pub moves: u64,
    /// Standard deviation of the smallest moves along x and along y (m), 0 to 1000; others are 3, 10 and 30 times as large, up to 0.3 m.
    #[serde(default = "default::annealing_sigma_m")]
    pub sigma_m: f64,
    /// The same of the heading (deg), 0 to 1000; up to 0.3 rad.
    #[serde(default = "default::annealing_sigma_deg")]
    pub sigma_deg: f64,
    /// Scans are annealed until positions have this standard deviation (m), and again from five times it; 0 to 1000000.
    #[serde(default = "default::annealing_gathered_m")]
    pub gathered_m: f64,
}

/// Where particles start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RawStart {
    /// Uniform over the map's free space: global localization.
    Global,
    /// Gaussian around the first true (or reference) pose: pose tracking.
    Tracking(RawSpread),
    /// Gaussian around a given pose in the map frame.
    Around(RawAround),
}

/// A pose with its spread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawAround {
    /// x (m), -1000000 to 1000000, within the map's extent.
    pub x_m: f64,
    /// y (m), -1000000 to 1000000, within the map's extent.
    pub y_m: f64,
    /// Heading (deg), 0 along x, counter-clockwise, -1000000 to 1000000.
    pub heading_deg: f64,
    /// Standard deviation of x and of y (m), 0 to 1000.
    #[serde(default)]
    pub sigma_m: f64,
    /// Standard deviation of the heading (deg), 0 to 1000.
    #[serde(default)]
    pub sigma_deg: f64,
}

/// Independent Gaussian spread of a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RawSpread {
    /// Standard deviation of x and of y (m), 0 to 1000.
    #[serde(default)]
    pub sigma_m: f64,
    /// Standard deviation of the heading (deg), 0 to 1000.
    #[serde(default)]
    pub sigma_deg: f64,
}
