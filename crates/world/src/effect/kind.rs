use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use super::EffectError;

/// One named way in which a real world may differ from the nominal simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EffectKind {
    /// Every return is off by the same length.
    RangeBias,
    /// Every return is off by the same share of its range.
    RangeScale,
    /// Returns of slanted walls are off.
    IncidenceBias,
    /// Noise that grows faster with range.
    RangeNoise,
    /// Noise that grows with the slant of a wall.
    IncidenceNoise,
    /// A share of the returns with five times the noise.
    HeavyTail,
    /// No return from slanted walls.
    IncidenceDropout,
    /// No return from far away.
    RangeDropout,
    /// Returns between the two surfaces of an edge.
    MixedPixels,
    /// A wall that lets beams through.
    Glass,
    /// A wall that isn't where the map has it.
    MovedWall,
    /// A round object that the map lacks.
    MissingObject,
    /// The laser is turned.
    MountYaw,
    /// The laser is displaced.
    MountOffset,
    /// Stamps that are early or late.
    TimeOffset,
    /// A sweep that takes another time than its beams' stamps say.
    MotionSkew,
    /// A bias that dies away after the start.
    WarmupDrift,
    /// A part of the robot in front of some beams.
    SectorOcclusion,
    /// Bursts of random readings.
    Crosstalk,
    /// Readings in steps.
    Quantization,
    /// More or fewer unmapped blocks.
    BlockDensity,
    /// Deeper or flatter unmapped blocks.
    BlockDepth,
    /// Odometry that reads distances too long or too short.
    OdomDistanceScale,
    /// Odometry that reads turns too wide or too narrow.
    OdomTurnScale,
    /// Odometry that reads a turn where there is none: wheels that differ.
    OdomImbalance,
    /// Wheels that now and then turn without getting on.
    WheelSlip,
}

/// What of the simulation an effect changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Site {
    /// What stands around the robot.
    World,
    /// The laser and its readings.
    Beam,
    /// What the odometry reads.
    Odometry,
    /// When beams are taken.
    Clock,
}

impl Site {
    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::World => "world",
            Self::Beam => "beam",
            Self::Odometry => "odometry",
            Self::Clock => "clock",
        }
    }
}

/// One number of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Its name, with the unit where it has one.
    pub name: &'static str,
    /// Its SI unit; `1` for a pure number.
    pub unit: &'static str,
    /// The value at which the effect is the identity. Where another parameter of the effect decides that alone (a
    /// probability of 0), a typical value.
    pub neutral: f64,
    /// The least value that is allowed.
    pub lo: f64,
    /// The greatest value that is allowed.
    pub hi: f64,
    /// A typical strength, for a fit to start from.
    pub start: f64,
}

/// What there is to say of a kind.
struct Entry {
    kind: EffectKind,
    name: &'static str,
    site: Site,
    parameters: &'static [Parameter],
    formula: &'static str,
    sentence: &'static str,
    signature: &'static str,
    confused_with: &'static [EffectKind],
}

const fn parameter(
    name: &'static str,
    unit: &'static str,
    neutral: f64,
    [lo, hi]: [f64; 2],
    start: f64,
) -> Parameter {
    Parameter { name, unit, neutral, lo, hi, start }
}

/// A probability: neutral at 0.
const fn probability(start: f64) -> Parameter {
    parameter("p", "1", 0.0, [0.0, 1.0], start)
}

use EffectKind as E;

/// In the order of [`EffectKind`].
const CATALOGUE: [Entry; 26] = [
    Entry {
        kind: E::RangeBias,
        name: "range_bias",
        site: Site::Beam,
        parameters: &[parameter("bias_m", "m", 0.0, [-1.0, 1.0], 0.02)],
        formula: "mean = r + bias_m",
        sentence: "Every return is too long or too short by the same length.",
        signature: "a flat shift of the residuals over range, incidence, bearing and time",
        confused_with: &[E::RangeScale, E::WarmupDrift],
    },
    Entry {
        kind: E::RangeScale,
        name: "range_scale",
        site: Site::Beam,
        parameters: &[parameter("k", "1", 0.0, [-0.2, 0.2], 0.01)],
        formula: "mean = r (1 + k)",
        sentence: "Every return is too long or too short by the same share of its range.",
        signature: "a shift of the residuals that is linear in range",
        confused_with: &[E::RangeBias, E::WarmupDrift],
    },
    Entry {
        kind: E::IncidenceBias,
        name: "incidence_bias",
        site: Site::Beam,
        parameters: &[parameter("bias_m", "m", 0.0, [-0.5, 0.5], 0.01)],
        formula: "mean = r + bias_m tan^2(alpha), alpha at most 80 deg, on walls",
        sentence: "Returns of slanted walls are too long or too short: the spot that a beam lights up is stretched.",
        signature: "a shift of the residuals that depends on incidence alone",
        confused_with: &[E::MovedWall, E::RangeScale],
    },
    Entry {
        kind: E::RangeNoise,
        name: "range_noise",
        site: Site::Beam,
        parameters: &[parameter("growth", "1/m", 0.0, [0.0, 0.1], 0.001)],
        formula: "sigma = sigma(r) + growth r^2",
        sentence: "Far returns are noisier than the nominal sensor's.",
        signature: "residuals that spread with range",
        confused_with: &[E::IncidenceNoise, E::HeavyTail],
    },
    Entry {
        kind: E::IncidenceNoise,
        name: "incidence_noise",
        site: Site::Beam,
        parameters: &[parameter("growth", "1", 0.0, [0.0, 50.0], 1.0)],
        formula: "sigma = sigma(r) (1 + growth tan^2(alpha)), alpha at most 80 deg, on walls",
        sentence: "Returns of slanted walls are noisier than the nominal sensor's.",
        signature: "residuals that spread with incidence",
        confused_with: &[E::RangeNoise, E::HeavyTail],
    },
    Entry {
        kind: E::HeavyTail,
        name: "heavy_tail",
        site: Site::Beam,
        parameters: &[probability(0.05)],
        formula: "(1 - p) N(mean, sigma) + p N(mean, 5 sigma)",
        sentence: "Some returns, anywhere, have five times the usual noise.",
        signature: "both ends of the residuals, everywhere alike",
        confused_with: &[E::RangeNoise, E::IncidenceNoise],
    },
    Entry {
        kind: E::IncidenceDropout,
        name: "incidence_dropout",
        site: Site::Beam,
        parameters: &[
            probability(0.5),
            parameter("angle_rad", "rad", 1.2, [0.0, FRAC_PI_2], 1.2),
            parameter("width_rad", "rad", 0.05, [0.001, 1.0], 0.05),
        ],
        formula: "P(no return) = p / (1 + exp(-(alpha - angle_rad) / width_rad)), on walls",
        sentence: "Slanted walls often send nothing back.",
        signature: "missing returns that set in at an incidence",
        confused_with: &[E::RangeDropout, E::Glass],
    },
    Entry {
        kind: E::RangeDropout,
        name: "range_dropout",
        site: Site::Beam,
        parameters: &[probability(0.2), parameter("exponent", "1", 4.0, [0.0, 20.0], 4.0)],
        formula: "P(no return) = p (r / R)^exponent, R the maximum range",
        sentence: "Far surfaces often send nothing back.",
        signature: "missing returns that grow with range",
        confused_with: &[E::IncidenceDropout],
    },
    Entry {
        kind: E::MixedPixels,
        name: "mixed_pixels",
        site: Site::Beam,
        parameters: &[probability(0.3)],
        formula: "with p: U(near, far) where the nominal range jumps by more than 0.3 m to a neighbouring beam",
        sentence: "At an edge a beam lights up two surfaces and reads something in between.",
        signature: "readings between near and far at jumps of the range",
        confused_with: &[E::Crosstalk],
    },
    Entry {
        kind: E::Glass,
        name: "glass",
        site: Site::World,
        parameters: &[probability(0.5)],
        formula: "with p, at the place: the reading of the surface behind, no return where there is none",
        sentence: "A stretch of wall lets beams through: glass, or a grating.",
        signature: "one stretch of wall that reads too long or not at all",
        confused_with: &[E::MovedWall, E::IncidenceDropout],
    },
    Entry {
        kind: E::MovedWall,
        name: "moved_wall",
        site: Site::World,
        parameters: &[parameter("distance_m", "m", 0.0, [-5.0, 5.0], 0.1)],
        formula: "r + distance_m / cos(alpha), alpha at most 80 deg, at the place; positive: farther",
        sentence: "A stretch of wall stands elsewhere than in the map.",
        signature: "one stretch of wall that is shifted, whichever way the robot looks at it",
        confused_with: &[E::Glass, E::MissingObject],
    },
    Entry {
        kind: E::MissingObject,
        name: "missing_object",
        site: Site::World,
        parameters: &[
            parameter("x_m", "m", 0.0, [-1e5, 1e5], 0.0),
            parameter("y_m", "m", 0.0, [-1e5, 1e5], 0.0),
            parameter("radius_m", "m", 0.0, [0.0, 10.0], 0.2),
        ],
        formula: "an opaque disc at (x_m, y_m) of radius radius_m in the map frame",
        sentence: "Something round stands in the world, always at the same place, and the map lacks it.",
        signature: "short readings of all beams through one place",
        confused_with: &[E::BlockDensity, E::MovedWall],
    },
    Entry {
        kind: E::MountYaw,
        name: "mount_yaw",
        site: Site::Beam,
        parameters: &[parameter("yaw_rad", "rad", 0.0, [-PI, PI], 0.02)],
        formula: "the laser's heading on the robot + yaw_rad",
        sentence: "The laser sits on the robot at another angle than the description says.",
        signature: "residuals signed by the slant of the wall, the same wherever the robot is",
        confused_with: &[E::OdomImbalance, E::MotionSkew, E::TimeOffset],
    },
    Entry {
        kind: E::MountOffset,
        name: "mount_offset",
        site: Site::Beam,
        parameters: &[
            parameter("x_m", "m", 0.0, [-2.0, 2.0], 0.03),
            parameter("y_m", "m", 0.0, [-2.0, 2.0], 0.03),
        ],
        formula: "the laser's position on the robot + (x_m, y_m), x forward, y left",
        sentence: "The laser sits elsewhere on the robot than the description says.",
        signature: "residuals signed by bearing, turning with the robot",
        confused_with: &[E::TimeOffset],
    },
    Entry {
        kind: E::TimeOffset,
        name: "time_offset",
        site: Site::Clock,
        parameters: &[parameter("delay_secs", "s", 0.0, [-1.0, 1.0], 0.05)],
        formula: "beams are taken delay_secs after their stamps",
        sentence: "The stamps of the scans are early or late: the robot has moved on when the beams are taken.",
        signature: "residuals in proportion to speed and turn rate, reversed with the motion",
        confused_with: &[E::MountOffset, E::MountYaw],
    },
    Entry {
        kind: E::MotionSkew,
        name: "motion_skew",
        site: Site::Clock,
        parameters: &[parameter("sweep_secs", "s", 0.0, [-1.0, 1.0], 0.05)],
        formula: "beams are taken sweep_secs (bearing / 2 pi) after their stamps, bearing in (-pi, pi]",
        sentence: "A sweep takes longer or shorter than the beams' stamps say.",
        signature: "residuals in proportion to bearing times turn rate or speed",
        confused_with: &[E::TimeOffset, E::MountYaw],
    },
    Entry {
        kind: E::WarmupDrift,
        name: "warmup_drift",
        site: Site::Beam,
        parameters: &[
            parameter("bias_m", "m", 0.0, [-1.0, 1.0], 0.03),
            parameter("tau_secs", "s", 60.0, [0.1, 1e5], 60.0),
        ],
        formula: "mean = r + bias_m exp(-t / tau_secs), t since the first scan",
        sentence: "Just after the start returns are off; the shift dies away as the sensor warms up.",
        signature: "a shift that fades with time",
        confused_with: &[E::RangeBias, E::RangeScale],
    },
    Entry {
        kind: E::SectorOcclusion,
        name: "sector_occlusion",
        site: Site::Beam,
        parameters: &[
            parameter("from_rad", "rad", -0.2, [-PI, PI], -0.2),
            parameter("to_rad", "rad", 0.2, [-PI, PI], 0.2),
            parameter("range_m", "m", 0.3, [0.0, 100.0], 0.3),
            probability(0.5),
        ],
        formula: "with p: N(range_m, sigma(range_m)) for bearings from from_rad counter-clockwise to to_rad, \
                  where what is met is farther",
        sentence: "Part of the robot (a cable, a post) is in front of some beams.",
        signature: "short readings of a fixed range at fixed bearings",
        confused_with: &[E::BlockDensity],
    },
    Entry {
        kind: E::Crosstalk,
        name: "crosstalk",
        site: Site::Beam,
        parameters: &[probability(0.3), parameter("share", "1", 0.2, [0.0, 1.0], 0.2)],
        formula: "with p: U(0, R), in those windows of 1 s that a burst falls on, each with probability share",
        sentence: "Another sensor's light disturbs the laser for seconds at a time: some readings are random.",
        signature: "random readings at all bearings, in clusters of time",
        confused_with: &[E::MixedPixels, E::HeavyTail],
    },
    Entry {
        kind: E::Quantization,
        name: "quantization",
        site: Site::Beam,
        parameters: &[parameter("step_m", "m", 0.0, [0.0, 1.0], 0.05)],
        formula: "round(z / step_m) step_m",
        sentence: "Readings come in coarse steps.",
        signature: "what is left of readings modulo the step",
        confused_with: &[E::RangeNoise],
    },
    Entry {
        kind: E::BlockDensity,
        name: "block_density",
        site: Site::World,
        parameters: &[parameter("factor", "1", 1.0, [0.0, 100.0], 2.0)],
        formula: "blocks per metre of wall times factor",
        sentence: "There are more, or fewer, unmapped objects along the walls than assumed.",
        signature: "how often readings are short near walls",
        confused_with: &[E::BlockDepth, E::MissingObject],
    },
    Entry {
        kind: E::BlockDepth,
        name: "block_depth",
        site: Site::World,
        parameters: &[parameter("factor", "1", 1.0, [0.01, 100.0], 1.5)],
        formula: "width of blocks and their gap to the wall times factor",
        sentence: "Unmapped objects reach farther, or less far, into the room than assumed.",
        signature: "how short readings are near walls",
        confused_with: &[E::BlockDensity],
    },
    Entry {
        kind: E::OdomDistanceScale,
        name: "odom_distance_scale",
        site: Site::Odometry,
        parameters: &[parameter("k", "1", 0.0, [-0.5, 0.5], 0.02)],
        formula: "ds (1 + k)",
        sentence: "The odometry reads every distance too long or too short by the same share: a wheel's diameter is off.",
        signature: "increments of distance in proportion to the true ones",
        confused_with: &[E::WheelSlip],
    },
    Entry {
        kind: E::OdomTurnScale,
        name: "odom_turn_scale",
        site: Site::Odometry,
        parameters: &[parameter("k", "1", 0.0, [-0.5, 0.5], 0.02)],
        formula: "dtheta (1 + k)",
        sentence: "The odometry reads every turn too wide or too narrow by the same share: the wheel base is off.",
        signature: "increments of heading in proportion to the true ones",
        confused_with: &[E::OdomImbalance],
    },
    Entry {
        kind: E::OdomImbalance,
        name: "odom_imbalance",
        site: Site::Odometry,
        parameters: &[parameter("turn_per_m", "rad/m", 0.0, [-1.0, 1.0], 0.02)],
        formula: "dtheta + turn_per_m ds",
        sentence: "The odometry reads a turn while the robot drives straight: one wheel is larger than the other.",
        signature: "increments of heading in proportion to distance",
        confused_with: &[E::OdomTurnScale, E::MountYaw],
    },
    Entry {
        kind: E::WheelSlip,
        name: "wheel_slip",
        site: Site::Odometry,
        parameters: &[probability(0.1), parameter("share", "1", 0.2, [0.0, 5.0], 0.2)],
        formula: "with p: ds (1 + |N(0, share^2)|)",
        sentence: "Now and then the wheels turn without getting on, and the odometry reads too long a distance.",
        signature: "a long upper tail of the increments of distance",
        confused_with: &[E::OdomDistanceScale],
    },
];

impl EffectKind {
    /// Every kind, in the order of the documentation.
    pub const ALL: [Self; 26] = {
        let mut all = [Self::RangeBias; 26];
        let mut i = 0;
        while i < all.len() {
            all[i] = CATALOGUE[i].kind;
            i += 1;
        }
        all
    };

    fn entry(self) -> &'static Entry {
        &CATALOGUE[self as usize]
    }

    /// The name used in files.
    pub fn name(self) -> &'static str {
        self.entry().name
    }

    /// What of the simulation it changes.
    pub fn site(self) -> Site {
        self.entry().site
    }

    /// Its numbers, in the order of [`Effect::values`](super::Effect::values).
    pub fn parameters(self) -> &'static [Parameter] {
        self.entry().parameters
    }

    /// Whether it acts on a stretch of wall.
    pub fn has_place(self) -> bool {
        matches!(self, Self::Glass | Self::MovedWall)
    }

    /// Its definition: r is the range of what a beam meets, alpha the incidence there.
    pub fn formula(self) -> &'static str {
        self.entry().formula
    }

    /// What it is, in plain language.
    pub fn sentence(self) -> &'static str {
        self.entry().sentence
    }

    /// What gives it away in data.
    pub fn signature(self) -> &'static str {
        self.entry().signature
    }

    /// What else looks much like it.
    pub fn confused_with(self) -> &'static [Self] {
        self.entry().confused_with
    }
}

impl fmt::Display for EffectKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for EffectKind {
    type Err = EffectError;

    fn from_str(name: &str) -> Result<Self, EffectError> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.name() == name)
            .ok_or_else(|| EffectError::Unknown { name: name.to_owned() })
    }
}
