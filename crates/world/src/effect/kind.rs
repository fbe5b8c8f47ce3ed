use std::fmt;
use std::str::FromStr;

use serde::{Serialize, Serializer};

use super::effect_type::EffectType;
use super::statistic::{Score, Statistic};
use super::{
    Description, EffectError, Moves, Needs, Parameter, Role, Site, clock, clutter, false_returns,
    lost_returns, mount, noise, objects, odometry, ranges, walls,
};

/// Makes [`EffectKind`] of the types that define the effects.
macro_rules! catalogue {
    ($($family:ident::$kind:ident,)*) => {
        /// The name of an effect: one way in which a real world may differ from the nominal simulator.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[expect(missing_docs, reason = "each is described by its type")]
        pub enum EffectKind {
            $($kind,)*
        }

        impl EffectKind {
            /// Every kind, in the order of the documentation.
            pub const ALL: [Self; [$(stringify!($kind)),*].len()] = [$(Self::$kind),*];

            /// The type that defines it.
            pub(super) fn effect_type(self) -> &'static dyn EffectType {
                match self {
                    $(Self::$kind => &$family::$kind,)*
                }
            }
        }
    };
}

catalogue! {
    ranges::RangeBias,
    ranges::RangeScale,
    ranges::IncidenceBias,
    noise::RangeNoise,
    noise::IncidenceNoise,
    noise::HeavyTail,
    lost_returns::IncidenceDropout,
    lost_returns::RangeDropout,
    false_returns::MixedPixels,
    walls::Glass,
    walls::MovedWall,
    objects::MissingObject,
    mount::MountYaw,
    mount::MountOffset,
    clock::TimeOffset,
    clock::MotionSkew,
    ranges::WarmupDrift,
    objects::SectorOcclusion,
    false_returns::Crosstalk,
    ranges::Quantization,
    clutter::BlockDensity,
    clutter::BlockDepth,
    odometry::OdomDistanceScale,
    odometry::OdomTurnScale,
    odometry::OdomImbalance,
    odometry::WheelSlip,
}

impl EffectKind {
    /// Its description.
    pub fn description(self) -> &'static Description {
        self.effect_type().description()
    }

    /// The name used in files.
    pub fn name(self) -> &'static str {
        self.description().name
    }

    /// The part of the simulation that it changes.
    pub fn site(self) -> Site {
        self.description().site
    }

    /// Its numbers, in the order of [`Effect::values`](super::Effect::values).
    pub fn parameters(self) -> &'static [Parameter] {
        self.description().parameters
    }

    /// Indices of the parameters that say how strong it is.
    pub fn strengths(self) -> impl Iterator<Item = usize> {
        (0..self.parameters().len()).filter(move |&i| self.parameters()[i].is_strength())
    }

    /// Whether it can act in one direction only, as a probability does.
    pub fn is_one_sided(self) -> bool {
        self.strengths().all(|i| self.parameters()[i].lo >= self.parameters()[i].neutral)
    }

    /// Whether two of it at one place are one of the sum of their strengths. Two that have positions of their own
    /// aren't.
    pub fn adds_up(self) -> bool {
        !self.parameters().iter().any(|parameter| matches!(parameter.role, Role::Position { .. }))
    }

    /// The scores that it is looked for by.
    pub fn scores(self) -> impl Iterator<Item = Score> {
        self.description().statistics.iter().filter_map(|statistic| match statistic {
            Statistic::Score { score, .. } => Some(*score),
            _ => None,
        })
    }

    /// Whether it is the same for every return.
    pub fn is_constant(self) -> bool {
        self == Self::RangeBias
    }

    /// Whether its strength is a step, which is right or wrong.
    pub fn is_stepped(self) -> bool {
        self.parameters().iter().any(|parameter| parameter.role == Role::Step)
    }

    /// Whether it acts on a stretch of wall.
    pub fn has_place(self) -> bool {
        self.description().has_place
    }

    /// The part of a log that it moves.
    pub fn moves(self) -> Moves {
        self.description().moves
    }

    /// Whether it does nothing but lose returns, of all beams alike.
    pub fn loses_returns(self) -> bool {
        let is_loss = |s: &Statistic| matches!(s, Statistic::Score { score: Score::NoReturn, .. });
        let statistics = self.description().statistics;
        !statistics.is_empty() && statistics.iter().all(is_loss)
    }

    /// Whether it is where the laser sits on the robot.
    pub fn displaces_laser(self) -> bool {
        self == Self::MountOffset
    }

    /// Whether it does nothing but spread readings, each beam's by itself.
    pub fn is_noise(self) -> bool {
        let is_spread =
            |s: &Statistic| matches!(s, Statistic::Score { score: Score::Scale | Score::Tail, .. });
        let statistics = self.description().statistics;
        !statistics.is_empty() && statistics.iter().all(is_spread)
    }

    /// Whether some beams go on behind the walls that it acts on.
    pub fn lets_beams_through(self) -> bool {
        self.description().statistics.iter().any(|statistic| matches!(statistic, Statistic::WallLoss))
    }

    /// Whether it does nothing but shift readings.
    pub fn is_bias(self) -> bool {
        let is_shift = |s: &Statistic| matches!(s, Statistic::Score { score: Score::Location, .. });
        let statistics = self.description().statistics;
        !statistics.is_empty() && statistics.iter().all(is_shift)
    }

    /// Whether readings are random under it, whatever a beam meets.
    pub fn is_of_random_readings(self) -> bool {
        let is_random = |s: &Statistic| matches!(s, Statistic::Score { score: Score::Uniform, .. });
        self.description().statistics.iter().any(is_random)
    }

    /// Whether beams start elsewhere, or meet other things, so that a log's beams have to be cast anew.
    pub fn changes_views(self) -> bool {
        matches!(self.moves(), Moves::Scans | Moves::Objects | Moves::Clutter)
            || self.description().needs != Needs::default()
    }

    /// Its definition: r is the range of what a beam meets, alpha the incidence there.
    pub fn formula(self) -> &'static str {
        self.description().formula
    }

    /// Definition in plain language.
    pub fn sentence(self) -> &'static str {
        self.description().sentence
    }

    /// Its signature in data.
    pub fn signature(self) -> &'static str {
        self.description().signature
    }

    /// Other kinds that look much like it.
    pub fn confused_with(self) -> &'static [Self] {
        self.description().confused_with
    }
}

impl fmt::Display for EffectKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl Serialize for EffectKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
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
