use super::{EffectKind, Parameter, Statistic};

/// Description of a kind of effect.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_excessive_bools, reason = "properties that say nothing of each other")]
pub struct Description {
    /// The name used in files.
    pub name: &'static str,
    /// The part of the simulation that it changes, for people.
    pub site: Site,
    /// Its numbers, in the order of [`Effect::values`](super::Effect::values).
    pub parameters: &'static [Parameter],
    /// Whether it acts on a stretch of wall.
    pub has_place: bool,
    /// Its definition: r is the range of what a beam meets, alpha the incidence there.
    pub formula: &'static str,
    /// Definition in plain language.
    pub sentence: &'static str,
    /// The same of a strength below its neutral value and of one above, where that matters.
    pub sides: Option<[&'static str; 2]>,
    /// What it does in plain language with some values, where that is something else.
    pub sentence_of: fn(&[f64]) -> Option<&'static str>,
    /// Its signature in data.
    pub signature: &'static str,
    /// Other kinds that look much like it.
    pub confused_with: &'static [EffectKind],
    /// Motions or surroundings in which it looks unlike its rivals.
    pub experiments: &'static [Experiment],
    /// The statistics that look for it.
    pub statistics: &'static [Statistic],
    /// The part of a log that it moves, for fits.
    pub moves: Moves,
    /// How the search fits it.
    pub fit: Fit,
    /// Whether a world can have one of it only.
    pub is_single: bool,
    /// Whether a filter can take it out of mount, odometry, stamps or readings. Any other effect it has to learn, from
    /// scans that are simulated with it.
    pub is_correctable: bool,
    /// Whether errors of a measured map look the same: the roughness of its walls and their ends look like noise of the laser, and
    /// what stands otherwise than it has it is its own error.
    pub is_as_map_errors: bool,
    /// The value that is read instead of the return.
    pub replaces: Option<Replacement>,
    /// Parts of a beam that it needs.
    pub needs: Needs,
}

impl Description {
    /// Defaults of a definition.
    pub(super) const DEFAULT: Self = Self {
        name: "",
        site: Site::Beam,
        parameters: &[],
        has_place: false,
        formula: "",
        sentence: "",
        sides: None,
        sentence_of: |_| None,
        signature: "",
        confused_with: &[],
        experiments: &[],
        statistics: &[],
        moves: Moves::Distribution,
        fit: Fit::Alone,
        is_single: false,
        is_correctable: false,
        is_as_map_errors: false,
        replaces: None,
        needs: Needs { map: false, jump: false, behind: false },
    };
}

/// The part of the simulation that an effect changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Site {
    /// The surroundings of the robot.
    World,
    /// The laser and its readings.
    Beam,
    /// The readings of the odometry.
    Odometry,
    /// The time at which beams are taken.
    Clock,
}

impl Site {
    /// The word for it.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// The part of a log that an effect moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Moves {
    /// Whole scans, as errors of the reference poses do.
    Scans,
    /// The mean of all returns. Errors of the reference take some of it in.
    Readings,
    /// The spread of returns, or what is read instead of them.
    Distribution,
    /// A stretch of wall.
    Walls,
    /// Objects that the map lacks.
    Objects,
    /// The unmapped blocks.
    Clutter,
    /// The odometry, and nothing that the laser sees.
    Odometry,
}

/// How the search fits an effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fit {
    /// With the nuisance parameters as they are.
    Alone,
    /// Together with the density of clutter: its readings in front of walls look like clutter's.
    WithClutter,
    /// As a nuisance parameter, along with every effect.
    Nuisance,
}

/// Values that are read instead of a return, in the order in which alternatives are tried: nearest to the sensor first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Replacement {
    /// A part of the robot.
    Robot,
    /// Another sensor's light.
    Interference,
    /// Nothing: the way is too long.
    Distance,
    /// Nothing: the surface reflects to elsewhere.
    Surface,
    /// The surface behind this one.
    Behind,
    /// Something between the surface and its neighbour.
    Edge,
}

/// Parts of a beam that a list of effects needs beside its reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needs {
    /// Whatever only a cast into the map tells: the incidence, the place, objects, clutter.
    pub map: bool,
    /// [`BeamView::jump`](super::BeamView::jump).
    pub jump: bool,
    /// [`BeamView::behind`](super::BeamView::behind).
    pub behind: bool,
}

impl Needs {
    /// The map alone.
    pub(super) const MAP: Self = Self { map: true, jump: false, behind: false };
}

/// A drive in which effects that look alike on other logs don't, the most telling first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Experiment {
    /// Forward and in reverse.
    Reverse,
    /// Turns in place, and straight lines.
    TurnsAndLines,
    /// Near and far walls.
    Ranges,
    /// A sensor that has warmed up.
    WarmedUp,
    /// Walls at right angles far away, slanted walls near.
    RangeAndIncidence,
    /// A turn on the spot.
    Turn,
    /// The same places again.
    OtherViewpoints,
}

impl Experiment {
    /// All of them, in their order.
    pub const ALL: [Self; 7] = [
        Self::Reverse,
        Self::TurnsAndLines,
        Self::Ranges,
        Self::WarmedUp,
        Self::RangeAndIncidence,
        Self::Turn,
        Self::OtherViewpoints,
    ];

    /// A drive that tells effects apart which look alike on a log: the first one in which two of them differ, as a sentence; `None` of one effect.
    pub fn telling_apart(set: &[EffectKind]) -> Option<&'static str> {
        let differ =
            |of: &Self| set.iter().filter(|kind| kind.description().experiments.contains(of)).count() >= 2;
        (set.len() >= 2)
            .then(|| Self::ALL.into_iter().find(differ).unwrap_or(Self::OtherViewpoints).sentence())
    }

    /// An experiment, and the result that tells the effect from its rivals.
    pub fn sentence(self) -> &'static str {
        match self {
            Self::Reverse => {
                "drive the same stretch forward and in reverse: an error of time changes its sign, a displaced laser \
                 doesn't"
            }
            Self::TurnsAndLines => {
                "turn in place both ways, and drive straight: only one of them shows in each"
            }
            Self::Ranges => "take scans over a wider span of ranges: a bias stays, a scale grows",
            Self::WarmedUp => "go on after the sensor has warmed up: a drift dies away, a bias stays",
            Self::RangeAndIncidence => "see walls at right angles from far away, and slanted ones from near",
            Self::Turn => "turn the robot on the spot: what is on the robot turns along",
            Self::OtherViewpoints => "see the same places again from other sides and distances",
        }
    }
}
