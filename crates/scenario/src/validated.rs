use std::path::PathBuf;
use std::str::FromStr;

use locsim_core::Pose2;
use locsim_dataset::BagTopics;
use locsim_mcl::{
    AnnealingOptions, InjectionOptions, ParticleCount, ResampleTrigger, Spread, UpdateThreshold,
};
use locsim_sensor::{AmclKind, ModelKind};
use locsim_world::effect::{Effect, EffectError, Effects, Residual};
use locsim_world::simulation::{BlockOptions, LaserOptions, OdometryNoise, Robot};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// A scenario that passed every check: what an experiment needs to know, in SI units and radians, files
/// resolved against the scenario's folder.
///
/// The serialized form leaves out what can't change a trial's result (names, paths, the number of trials, the
/// recording, the bounds); [`Scenario::content_hash`] is built on that.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scenario {
    /// The file it was read from.
    #[serde(skip)]
    pub file: PathBuf,
    /// The text of the file.
    #[serde(skip)]
    pub text: String,
    /// Letters, digits, `-` and `_`.
    #[serde(skip)]
    pub name: String,
    /// One line for people; may be empty.
    #[serde(skip)]
    pub description: String,
    /// Everything random derives from it.
    pub seed: u64,
    /// Number of trials, at least 1.
    #[serde(skip)]
    pub trials: u32,
    /// How the filter casts rays into the map.
    pub ray_cast: RayCast,
    /// Where scans and odometry come from.
    pub source: Source,
    /// How much training data the sensor models get.
    pub training: Training,
    /// Sensor models under comparison, at least one, labels unique.
    pub models: Vec<Model>,
    /// The particle filter.
    pub filter: Filter,
    /// How errors are measured.
    pub errors: Errors,
    /// Content of the recording.
    #[serde(skip)]
    pub record: Record,
    /// Bounds that the results have to keep.
    #[serde(skip)]
    pub expect: Vec<Expectation>,
}

/// How nominal ranges and log densities are computed inside the filter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum RayCast {
    /// From precomputed tables of the map and of the sensor models.
    Table {
        /// Side of a cell of the map's table (m), larger where it would not fit.
        cell_m: f64,
        /// Greatest size of the map's table (MB).
        memory_mb: u32,
    },
    /// By an exact cast and the model itself each time.
    Exact,
}

/// Where scans and odometry come from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Source {
    /// A simulated drive per trial.
    Simulation(Simulation),
    /// A measured log.
    Log(Log),
}

/// A simulated world, robot and laser.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Simulation {
    /// Map file: vector map, or ROS `map_server` YAML.
    #[serde(skip)]
    pub map: PathBuf,
    /// Unmapped blocks; `None` for a world that is as mapped.
    pub blocks: Option<BlockOptions>,
    /// How the robot moves.
    pub robot: Robot,
    /// Its laser.
    pub laser: LaserOptions,
    /// Ways in which the world differs from all this.
    pub effects: Vec<Effect>,
    /// Curves by which readings differ from all this without a known cause.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub residuals: Vec<Residual>,
}

/// A measured log, cut into parts by share of its scans. Each part is a list of half-open intervals
/// `[from, to)` with 0 <= from < to <= 1, in order, without overlap.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Log {
    /// The log, in the format that its name tells.
    #[serde(skip)]
    pub file: PathBuf,
    /// Where the map comes from.
    pub map: LogMap,
    /// Scans that the sensor models are trained on; none where they are trained on simulated scans.
    pub train_scans: Vec<[f64; 2]>,
    /// Scans that the filter localizes on: one interval.
    pub localize_scans: Vec<[f64; 2]>,
    /// Readings at or above this count as no return (m); `None` takes the log's own maximum.
    pub max_range_m: Option<f64>,
    /// Names of the topics, where the log is a bag.
    pub topics: BagTopics,
    /// The simulator of the same robot, if the scenario has one.
    pub simulator: Option<SimulatorOptions>,
}

/// The simulator's settings in a map, whatever path the robot takes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SimulatorOptions {
    /// Unmapped blocks; `None` for a world that is as mapped.
    pub blocks: Option<BlockOptions>,
    /// The laser.
    pub laser: LaserOptions,
    /// Noise of the odometry.
    pub odometry_noise: OdometryNoise,
    /// Ways in which the world differs from all this.
    pub effects: Vec<Effect>,
    /// Curves by which readings differ from all this without a known cause.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub residuals: Vec<Residual>,
}

impl SimulatorOptions {
    /// Effects and residuals, as a simulator takes them.
    ///
    /// # Errors
    /// [`EffectError`] for effects that exclude each other.
    pub fn effects(&self) -> Result<Effects, EffectError> {
        Effects::new(self.effects.clone())?.with_residuals(self.residuals.clone())
    }
}

impl Simulation {
    /// Effects and residuals, as a simulator takes them.
    ///
    /// # Errors
    /// [`EffectError`] for effects that exclude each other.
    pub fn effects(&self) -> Result<Effects, EffectError> {
        Effects::new(self.effects.clone())?.with_residuals(self.residuals.clone())
    }
}

impl Scenario {
    /// The simulator: that of a simulated robot, or the one beside a log.
    pub fn simulator(&self) -> Option<SimulatorOptions> {
        match &self.source {
            Source::Simulation(Simulation { blocks, robot, laser, effects, residuals, .. }) => {
                Some(SimulatorOptions {
                    blocks: *blocks,
                    laser: *laser,
                    odometry_noise: robot.odometry_noise,
                    effects: effects.clone(),
                    residuals: residuals.clone(),
                })
            }
            Source::Log(log) => log.simulator.clone(),
        }
    }
}

/// The map of a measured log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum LogMap {
    /// A map file.
    File(#[serde(skip)] PathBuf),
    /// An occupancy grid built from scans of the same log.
    FromScans {
        /// Scans the map is built from.
        scans: Vec<[f64; 2]>,
        /// Side of a cell (m).
        resolution_m: f64,
    },
    /// Walls built from scans of the same log.
    Walls {
        /// Scans the map is built from.
        scans: Vec<[f64; 2]>,
    },
}

/// How much training data the sensor models get.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Training {
    /// Scan poses drawn in free space; for a log, at most this many of its training scans.
    pub poses: u32,
    /// Observations M of each state; a log always has 1.
    pub observations: u32,
    /// Beams per pose that become states; `None` for all of the laser's.
    pub beams: Option<u32>,
    /// Share of the poses held out for choosing bandwidths, floors and exponents, in (0, 1).
    pub held_out_share: f64,
}

/// One sensor model under comparison.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Model {
    /// Which model.
    pub name: ModelName,
    /// Its name in results; unique.
    pub label: String,
    /// Weight of the uniform floor, in [0, 1); `None`: chosen on held-out data.
    pub floor: Option<f64>,
    /// Tempering exponent, in (0, 1]; `None`: chosen on held-out data.
    pub exponent: Option<f64>,
    /// A fitted model, or AMCL's parameters, to load; `None`: fit it, or take nav2's defaults.
    #[serde(skip)]
    pub file: Option<PathBuf>,
}

/// A sensor model that a scenario can name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ModelName {
    /// A model that is fitted to readings.
    Fitted(ModelKind),
    /// A laser model of AMCL, with the parameters of a file, or nav2's defaults.
    Amcl(AmclKind),
    /// The true density, from the simulated blocks on a lattice of cells and headings; simulation only.
    Oracle,
}

impl ModelName {
    /// Every model, in the order of the documentation.
    pub const ALL: [Self; ModelKind::ALL.len() + AmclKind::ALL.len() + 1] = {
        let mut all = [Self::Oracle; ModelKind::ALL.len() + AmclKind::ALL.len() + 1];
        let mut i = 0;
        while i < ModelKind::ALL.len() {
            all[i] = Self::Fitted(ModelKind::ALL[i]);
            i += 1;
        }
        let mut j = 0;
        while j < AmclKind::ALL.len() {
            all[i + j] = Self::Amcl(AmclKind::ALL[j]);
            j += 1;
        }
        all
    };

    /// Their names.
    pub const NAMES: [&'static str; Self::ALL.len()] = {
        let mut names = [""; Self::ALL.len()];
        let mut i = 0;
        while i < names.len() {
            names[i] = Self::ALL[i].as_str();
            i += 1;
        }
        names
    };

    /// The name used in files.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Fitted(kind) => kind.as_str(),
            Self::Amcl(kind) => kind.as_str(),
            Self::Oracle => "oracle",
        }
    }

    fn sentence(self) -> &'static str {
        match self {
            Self::Fitted(kind) => kind.sentence(),
            Self::Amcl(kind) => kind.sentence(),
            Self::Oracle => {
                "the true density, from the simulated blocks on a lattice of cells and headings; simulation only"
            }
        }
    }
}

impl Serialize for ModelName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl<'de> Deserialize<'de> for ModelName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let word = String::deserialize(deserializer)?;
        word.parse().map_err(|_| de::Error::unknown_variant(&word, &Self::NAMES))
    }
}

impl JsonSchema for ModelName {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "ModelName".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let models = Self::ALL.map(|model| {
            serde_json::json!({ "type": "string", "const": model.as_str(), "description": model.sentence() })
        });
        json_schema!({ "description": "A sensor model that a scenario can name.", "oneOf": models })
    }
}

impl std::fmt::Display for ModelName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// There is no sensor model of this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{name:?} is not a sensor model; one of {}", ModelName::NAMES.join(", "))]
pub struct UnknownModel {
    /// The name that was asked for.
    pub name: String,
}

impl FromStr for ModelName {
    type Err = UnknownModel;

    fn from_str(name: &str) -> Result<Self, UnknownModel> {
        Self::ALL
            .into_iter()
            .find(|model| model.as_str() == name)
            .ok_or_else(|| UnknownModel { name: name.to_owned() })
    }
}

/// The particle filter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Filter {
    /// How many particles.
    pub particles: ParticleCount,
    /// How particles move.
    pub motion: Motion,
    /// Whether the systematic error of a log's odometry is taken out.
    pub calibrate: bool,
    /// Standard deviation of a random walk of the position after a metre of way or a radian of turning (m).
    pub random_walk_m: f64,
    /// How ancestors are drawn.
    pub resampler: Resampler,
    /// When they are drawn.
    pub resample: ResampleTrigger,
    /// Random particles injected when the likelihood drops; `None` for none.
    pub injection: Option<InjectionOptions>,
    /// Where particles start.
    pub start: Start,
    /// Beams of a scan that the filter uses, spread evenly; `None` for all.
    pub beams: Option<u32>,
    /// How far the robot moves before another scan is taken in; `None` takes every scan in.
    pub update: Option<UpdateThreshold>,
    /// Which estimate errors are measured of.
    pub estimate: Estimate,
    /// Jitter added after resampling (regularized particle filter); zero for none.
    pub regularization: Spread,
    /// The least share of particles that a scan leaves effective; `None` takes every scan in whole.
    pub least_effective_share: Option<f64>,
    /// How scans are taken in while the particles are spread; `None` for all at once as always.
    pub annealing: Option<AnnealingOptions>,
}

/// Motion model with its noise parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Motion {
    /// Odometry model, alpha 1 to 4 (Probabilistic Robotics, table 5.6); `None` to fit them to the log.
    Odometry(Option<[f64; 4]>),
    /// Velocity model, alpha 1 to 6 (Probabilistic Robotics, table 5.3).
    Velocity([f64; 6]),
}

/// How ancestors are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Resampler {
    /// Independent draws.
    Multinomial,
    /// One draw, evenly spaced (the low variance sampler).
    #[default]
    Systematic,
    /// One draw in each of n strata.
    Stratified,
    /// Whole copies first, the rest multinomial.
    Residual,
}

/// Where particles start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Start {
    /// Gaussian around the true (or reference) first pose: pose tracking.
    Tracking(Spread),
    /// Gaussian around this pose.
    Around(Pose2, Spread),
    /// Uniform over the map's free space: global localization.
    Global,
}

/// Which pose estimate of the filter errors are measured of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Estimate {
    /// Weighted mean of the particles, circular for the heading.
    #[default]
    WeightedMean,
    /// The particle of greatest weight.
    MaxWeight,
    /// Mean of the densest cluster of particles.
    DensestCluster,
    /// The most likely trajectory by particle ancestry, known at the end of the drive.
    MostLikelyTrajectory,
}

/// How errors are measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Errors {
    /// Along which axes.
    pub frame: ErrorFrame,
    /// A trial is lost when its last position error exceeds this (m), or more than half of its position errors do.
    pub lost_m: f64,
}

/// The axes of position errors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ErrorFrame {
    /// Along is the map's x, across its y.
    #[default]
    Map,
    /// Along is the true robot's forward axis, across its left.
    Robot,
}

/// Content of the recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// Number of the trial, below the number of trials.
    pub trial: u32,
    /// Labels of the models recorded, in the scenario's order.
    pub models: Vec<String>,
}

/// A bound on one figure of one model in `summary.json`.
#[derive(Clone, Debug, PartialEq)]
pub struct Expectation {
    /// Label of the model.
    pub model: String,
    /// One of [`METRICS`].
    pub metric: &'static str,
    /// The figure must not be below it.
    pub min: Option<f64>,
    /// The figure must not be above it.
    pub max: Option<f64>,
}

/// Figures of a model in `summary.json` that `expect` can bound, with dots between nested keys; `kept` leaves out
/// the lost trials.
pub const METRICS: [&str; 28] = [
    "lost_share",
    "position_rmse_m",
    "position_median_m",
    "position_p95_m",
    "position_std_m",
    "along.mean_m",
    "along.std_m",
    "across.mean_m",
    "across.std_m",
    "heading.mean_rad",
    "heading.std_rad",
    "ess_mean",
    "nees_mean",
    "nees_with_shared_errors_mean",
    "step_ms",
    "train.log_loss_nats",
    "train.histogram_match_m",
    "kept.trials",
    "kept.position_rmse_m",
    "kept.position_median_m",
    "kept.position_p95_m",
    "kept.position_std_m",
    "kept.along.mean_m",
    "kept.along.std_m",
    "kept.across.mean_m",
    "kept.across.std_m",
    "kept.heading.mean_rad",
    "kept.heading.std_rad",
];
