//! Result of a search, as it is written to `gap.json`.

use std::collections::BTreeMap;

use locsim_core::Estimate;
use locsim_world::effect::{Effect, EffectKind, Residual};
use serde::{Deserialize, Serialize, Serializer};

use crate::map_error::MeasuredMapFindings;
use crate::statistics::{Covariate, Deviation};
use locsim_comparison::Nuisances;

/// The result of a search in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Nothing: the log is as the simulator says.
    None,
    /// Effects of the library explain what is off.
    Named,
    /// So do several effects, each as well as another.
    Ambiguous,
    /// An effect is named, and something else is still off.
    PartlyExplained,
    /// Something is off that no effect of the library explains, and a free model of the readings says what depends on what.
    Unnamed,
    /// Something is off that neither an effect of the library nor the free model explains.
    Unexplained,
    /// Nothing was found, and a typical effect would not have been.
    Underpowered,
}

/// A number of an effect.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Number {
    /// Its value, in SI units.
    #[serde(flatten)]
    pub estimate: Estimate,
    /// Its unit.
    pub unit: &'static str,
}

/// Why an effect is named.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// Log score gained on scans that its numbers weren't fitted to (nats, over the log).
    pub gain_nats: Estimate,
    /// The same per scan.
    pub gain_nats_per_scan: f64,
    /// Score of its strength, or how deep blocks seem to be, in the world in which it was named (standard deviations of
    /// simulated logs); none where what gives an effect away is at one place of many.
    pub score: Option<f64>,
    /// Chance that a log without any effect looks as much off as this one did before this effect was added.
    pub p: f64,
}

/// An effect that explains something.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Named {
    /// Its name.
    #[serde(serialize_with = "name")]
    pub name: EffectKind,
    /// Effects that explain it as well, itself among them.
    #[serde(serialize_with = "names")]
    pub candidates: Vec<EffectKind>,
    /// Its numbers.
    pub params: BTreeMap<&'static str, Number>,
    /// Where it acts, for effects of walls \[m\].
    pub place: Vec<[[f64; 2]; 2]>,
    /// Its evidence.
    pub evidence: Evidence,
    /// The motion that would tell the candidates apart, if there are several.
    pub split_by: Option<&'static str>,
    /// The effect itself.
    #[serde(skip)]
    pub effect: Effect,
    /// What the log gained on each fold when it was named, whatever of it counted, and by others that it explains \[nats\].
    #[serde(skip)]
    pub gains: Vec<f64>,
}

impl Named {
    /// Leaves out the effects that may be the cause instead.
    pub(crate) fn leave_alone(&mut self) {
        self.candidates.truncate(1);
        self.split_by = None;
    }

    /// Makes the evidence that of all gains: those that counted for the choice may have been limited by the score.
    pub(crate) fn count_all_gains(&mut self, scans: usize) {
        let gain_nats = Estimate::of_sum(&self.gains);
        self.evidence =
            Evidence { gain_nats, gain_nats_per_scan: gain_nats.value / scans as f64, ..self.evidence };
    }

    /// Adds what another name gained on each fold \[nats\].
    pub(crate) fn add_gains(&mut self, other: &[f64]) {
        self.gains.iter_mut().zip(other).for_each(|(gain, other)| *gain += other);
    }
}

/// A dependence that no effect of the library explains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unnamed {
    /// The quantity that depends on the covariate: a reading's mean, its spread, a share; the odometry's lag; the turn or the
    /// shift of the reference's frame.
    pub deviation: Deviation,
    /// On what.
    pub covariate: Covariate,
    /// The named effect that acts on this as well, but in another form than the library's.
    #[serde(serialize_with = "optional_name")]
    pub form_of: Option<EffectKind>,
    /// The evidence for it.
    pub evidence: Evidence,
    /// Unit of size and curve: metres of the mean and of a shift, seconds of a lag, radians of a turn; 1 of a share, of the spread's relative change, of the
    /// correlation of neighbouring beams.
    pub unit: &'static str,
    /// Amplitude of the wave, where the curve is one, and otherwise the largest value of the curve; the correlation of
    /// neighbouring beams; the odometry's lag; the turn of the reference's frame, or the length of its shift.
    pub size: f64,
    /// The wave that the curve is.
    pub wave: Option<distreg::wave::Wave>,
    /// The curve with its 95 % band; of a lag or a turn, the number itself; of a shift, those along x and y.
    pub curve: Vec<CurvePoint>,
}

/// The curves without a name as a part of the simulator, learnt and without a cause.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ResidualStage {
    /// The curves that a simulator can carry.
    pub curves: Vec<Residual>,
    /// Wasserstein-1 distance of range errors between log and simulation with the named effects alone \[mm\].
    pub w1_without_mm: f64,
    /// The same with the curves: each half of the log, every other fold of it, against simulations with curves that were learnt
    /// from the other half \[mm\].
    pub w1_mm: f64,
}

impl ResidualStage {
    /// Whether simulated ranges come nearer to the measured ones.
    pub fn is_nearer(&self) -> bool {
        self.w1_mm < self.w1_without_mm
    }
}

/// A point of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CurvePoint {
    /// The covariate, SI unit; of places the number of the cell.
    pub at: f64,
    /// The cell of a place: lower and upper corner \[m\].
    pub place: Option<[f64; 4]>,
    /// The curve's value there.
    #[serde(flatten)]
    pub estimate: Estimate,
}

/// An effect that was tried.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rival {
    /// In which round, from 1.
    pub round: usize,
    /// Its name.
    #[serde(serialize_with = "name")]
    pub name: EffectKind,
    /// Its numbers.
    pub params: BTreeMap<&'static str, Number>,
    /// Log score gained on scans that its numbers weren't fitted to, as far as its own score among simulated logs allows (nats).
    pub gain_nats: Estimate,
    /// By how much it is behind the best of its round, paired over folds (nats).
    pub behind_nats: Estimate,
}

/// Chances that a log without any effect looks as much off as this one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Detection {
    /// By the library's directions.
    pub p_library: f64,
    /// By the PIT over all cells, and by a lag and a turned or shifted frame.
    pub p_omnibus: f64,
    /// By both together: this decides.
    pub p: f64,
    /// Simulated logs behind them.
    pub replicates: u32,
}

/// Where the log is off.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Region {
    /// Over what.
    pub covariate: Covariate,
    /// From, SI units.
    pub lo: f64,
    /// To.
    pub hi: f64,
    /// The square of the map, for places: lower and upper corner \[m\].
    pub place: Option<[f64; 4]>,
    /// The quantity that is off.
    pub deviation: Deviation,
    /// In standard deviations of simulated logs.
    pub z: f64,
    /// Wasserstein-1 distance of the readings there between log and simulation \[mm\].
    pub w1_mm: f64,
    /// Log score lost there against a simulation of its own (nats over the log), about half the square of `z`.
    pub nats: f64,
    /// False discovery rate at which it is a region (Benjamini and Hochberg 1995), on one half of the log's folds.
    pub q: f64,
    /// One-sided p-value on the other half.
    pub p_other_half: f64,
    /// Whether it is still off with the named effects.
    pub remains: bool,
}

/// How far apart simulation and log are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distance {
    /// Log density of the log's readings, per scan (nats); of simulated logs for the floor.
    pub log_score_nats_per_scan: f64,
    /// Wasserstein-1 distance of range errors between log and simulation \[mm\]; between two simulations for the floor.
    pub w1_mm: f64,
}

/// The gap before and after.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// With the nominal simulator.
    pub before: Distance,
    /// With the named effects.
    pub after: Distance,
    /// Simulation against simulation.
    pub floor: Distance,
    /// Log score that the named effects gain on held-out folds (nats per scan).
    pub gained_nats_per_scan: f64,
    /// The held-out gain of a free model of the readings on top of the named effects (nats per scan), beyond the most that it
    /// gains on a simulated log; or the gain of the best further effect, where that is more. At least 0.
    pub remaining_nats_per_scan: f64,
    /// The gain of the free model on top of the nominal simulator (nats per scan).
    pub possible_nats_per_scan: f64,
    /// Share of the log score that is gained on held-out folds: gained / (gained + remaining).
    pub gained_share: Estimate,
    /// Share of the gap that is closed: [`gained_share`](Self::gained_share), and no more than
    /// [`closed_in_ranges`](Self::closed_in_ranges). `None` where something is gained and ranges can't say whether the gap has closed.
    pub closed: Option<Estimate>,
    /// Share by which the distance of range errors came down to its floor: 1 where it did, below 0 where it grew. `None`
    /// where it was below [`w1_visible_mm`](Self::w1_visible_mm) before and after, so that it says nothing.
    pub closed_in_ranges: Option<f64>,
    /// Two simulations seldom differ by more than this distance of range errors \[mm\].
    pub w1_visible_mm: f64,
}

/// A gap is open where ranges came less than this share of the way.
pub(crate) const HALF: f64 = 0.5;

impl Gap {
    /// Whether simulated ranges came less than half of the way to the measured ones.
    pub fn is_open_in_ranges(&self) -> bool {
        self.closed_in_ranges.is_some_and(|share| share < HALF)
    }
}

/// Effect of the gap on a filter on the measured log.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FilterError {
    /// Root mean square of the position error \[m\], with its interval over the filter's seeds.
    pub position_rmse_m: Estimate,
}

/// The same filter with models of the nominal simulator, and of the one with the effects.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FilterGap {
    /// Before.
    pub before: FilterError,
    /// After.
    pub after: FilterError,
    /// After less before, paired over seeds \[m\].
    pub change_m: Estimate,
}

/// A strength that would have been found with 90 % probability.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Detectable {
    /// Effect.
    #[serde(serialize_with = "name")]
    pub name: EffectKind,
    /// Its first number.
    pub parameter: &'static str,
    /// How much of it.
    pub value: f64,
    /// Unit.
    pub unit: &'static str,
    /// A typical strength.
    pub typical: f64,
}

/// How far a log is off in the directions of an effect.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Direction {
    /// Effect.
    #[serde(serialize_with = "name")]
    pub name: EffectKind,
    /// The farthest of its statistics, in standard deviations of simulated logs.
    pub z: f64,
}

/// PIT histograms over the bins of a covariate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PitHistogram {
    /// Over what.
    pub covariate: Covariate,
    /// From, SI units.
    pub lo: f64,
    /// To.
    pub hi: f64,
    /// Share of readings in each tenth of the PIT.
    pub before: [f64; 10],
    /// With the named effects.
    pub after: [f64; 10],
    /// Readings in it.
    pub readings: usize,
}

/// A quantity of the readings or of the odometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Median of the reading less the nominal range \[m\], over returns.
    Error,
    /// Spread of it \[m\]: half of the distance between its 16 % and 84 % quantiles.
    Spread,
    /// Share of readings without a return.
    NoReturn,
    /// Share of readings of something in front of the surface.
    InFront,
    /// Share of readings with such an error.
    Share,
    /// Mean error of the distance between two scans \[m\].
    OdometryDistance,
    /// Mean error of the turn between two scans \[rad\].
    OdometryTurn,
}

/// The covariate of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Over {
    /// Nominal range \[m\].
    Range,
    /// Incidence \[rad\].
    Incidence,
    /// Bearing \[rad\].
    Bearing,
    /// Time \[s\].
    Time,
    /// Reading less the nominal range \[m\].
    Error,
    /// Distance between two scans \[m\], negative backward.
    Distance,
    /// Turn between two scans \[rad\].
    Turn,
}

/// A profile of a named effect.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Profile {
    /// The effect.
    #[serde(serialize_with = "name")]
    pub name: EffectKind,
    /// The quantity.
    pub quantity: Quantity,
    /// Its covariate.
    pub over: Over,
    /// The bins, in order.
    pub bins: Vec<ProfileBin>,
}

/// A bin of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ProfileBin {
    /// Mean of the covariate.
    pub at: f64,
    /// Readings or increments in it.
    pub count: usize,
    /// The log's value.
    pub measured: f64,
    /// Median of the simulated logs' values under the nominal simulator, and the interval that holds 95 % of them.
    pub before: Estimate,
    /// The same with the named effects.
    pub after: Estimate,
}

/// A beam of the log, for figures and recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BeamPit {
    /// Where the reading ends \[m\].
    pub endpoint: [f32; 2],
    /// PIT under the nominal simulator, NaN for an unusable reading.
    pub before: f32,
    /// With the named effects.
    pub after: f32,
    /// Reading less the expected range under the nominal simulator \[m\], cut at +-1 m.
    pub residual: f32,
}

/// All that a search found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// The verdict.
    pub verdict: Verdict,
    /// In the order in which they were named.
    pub effects: Vec<Named>,
    /// Dependences that no effect of the library explains, which a free model of the readings finds,
    /// the one that gains most first. Empty where nothing is off with the effects.
    pub unnamed: Vec<Unnamed>,
    /// Their curves as a part of the simulator; `None` where it can carry none of them.
    pub residual: Option<ResidualStage>,
    /// What a measured map doesn't say, and where it is wrong; `None` of a map that is taken for exact.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<MeasuredMapFindings>,
    /// Chances.
    pub detection: Detection,
    /// Chances with the named effects added; the same where none is.
    pub detection_after: Detection,
    /// Where the log is off.
    #[serde(rename = "where")]
    pub regions: Vec<Region>,
    /// The gap.
    pub gap: Gap,
    /// Its effect on a filter, if that was asked for.
    pub filter: Option<FilterGap>,
    /// Effects that were tried.
    pub rivals: Vec<Rival>,
    /// Effects that would have been found.
    pub detectable: Vec<Detectable>,
    /// How far the log is off in every effect's direction, before any is added.
    pub directions: Vec<Direction>,
    /// The bound for an effect that shifts or spreads readings, or is in the odometry.
    pub threshold: f64,
    /// Nuisance parameters that were fitted before any effect was named: clutter, errors of the reference, which may have taken up a part of one.
    pub nuisances: Nuisances,
    /// The same beside the effects that are named.
    pub nuisances_after: Nuisances,
    /// PIT histograms.
    pub pit: Vec<PitHistogram>,
    /// The profile of each named effect: readings or odometry, measured and simulated.
    pub profiles: Vec<Profile>,
    /// Remarks for people.
    pub notes: Vec<String>,
    /// Number of scans and of beams per scan.
    pub scans: usize,
    /// Beams per scan.
    pub beams: usize,
    /// Everything random derives from it.
    pub seed: u64,
    /// Time it took \[s\]; the caller's clock.
    pub seconds: f64,
    /// Every beam, \[scan\]\[beam\].
    #[serde(skip)]
    pub beam_pits: Vec<BeamPit>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn name<S: Serializer>(kind: &EffectKind, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(kind.name())
}

fn names<S: Serializer>(kinds: &[EffectKind], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(kinds.iter().map(|kind| kind.name()))
}

#[expect(clippy::ref_option, clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn optional_name<S: Serializer>(kind: &Option<EffectKind>, serializer: S) -> Result<S::Ok, S::Error> {
    match kind {
        Some(kind) => serializer.serialize_some(kind.name()),
        None => serializer.serialize_none(),
    }
}
