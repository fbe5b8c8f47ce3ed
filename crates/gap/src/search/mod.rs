//! The search: detect, locate, name, add, and stop when nothing is off any more.

mod calibration;
mod initial_guess;
mod judge;
mod judgement;
mod lasting;
mod left_over;
mod outcome;
mod pair;
mod precision;
mod predicted;
mod residual;
mod selection;
mod stepwise;
mod surroundings;
mod unnamed;

use std::borrow::Cow;
use std::cmp::Ordering;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

use locsim_comparison::{
    BlockPolicy, BlockTruth, Comparison, Fitted, Nuisances, Replay, Views, fit_persistence, surface_ranges,
};
use locsim_core::Progress;
use locsim_world::effect::{Effect, EffectKind, Moves};
use locsim_world::raycast::Unsure;
use rayon::prelude::*;

use crate::fit::{Candidate, Search};
use crate::map_error::{self, LeftOut, MeasuredMapFindings};
use crate::null::compare;
use crate::outcome::Outcome;
use crate::rank::Null;
use crate::statistics::{Dictionary, Form};
use crate::{GapError, Nominal, Purpose, Recorded};
use initial_guess::Guesses;
use judgement::Judgement;

/// How a search is run.
#[derive(Clone, Debug, PartialEq)]
pub struct GapOptions {
    /// Simulated logs behind a p-value.
    pub replicates: u32,
    /// Chance of finding something in a log in which there is nothing.
    pub false_alarm: f64,
    /// The most effects that are named.
    pub most_effects: usize,
    /// Kinds of effect that are fitted in a round, those whose statistics are farthest off.
    pub fitted_kinds: usize,
    /// Effects that are left out of the library.
    pub without: Vec<EffectKind>,
    /// Everything random derives from it.
    pub seed: u64,
}

impl Default for GapOptions {
    fn default() -> Self {
        Self {
            replicates: 999,
            false_alarm: 0.01,
            most_effects: 3,
            fitted_kinds: 10,
            without: Vec::new(),
            seed: 0,
        }
    }
}

/// An effect is fitted where something is off if one of its statistics is as far off as any statistic is in only this share of
/// logs without a fault: above the false-alarm rate, as another effect may be the one that is significant.
const FAR_OFF: f64 = 0.1;
/// The same where nothing is off any more, and the question is only how much may be left.
const SOMEWHAT_OFF: f64 = 0.5;

/// A score beyond this many standard deviations is of a strong effect, whose gain isn't limited by the score: the score is a
/// linear approximation about the neutral value.
const BEYOND_DOUBT: f64 = 10.0;

/// A fit is believed without its score where it gains more than this (nats), if most readings are moved by the effect, or the score is bounded.
const BEYOND_SCORE_NATS: f64 = 200.0;

/// A hypothesis with what simulations of it look like.
struct Round<'a> {
    effects: Vec<Effect>,
    comparison: Comparison<'a>,
    fitted: Fitted,
    blocks: BlockTruth,
    dictionary: Dictionary,
    null: Null,
    /// The free model on top of it, where that was asked for.
    judgement: OnceLock<Judgement>,
    /// Simulated logs that ranges are held against, where that was asked for.
    logs: OnceLock<Vec<Recorded>>,
}

impl Round<'_> {
    /// The simulator that was fitted in this round.
    fn replay(&self) -> Replay<'_> {
        Replay::new(&self.comparison, &self.effects, &self.fitted, self.blocks)
    }

    /// The statistics of an effect, by index.
    fn own(&self, kind: EffectKind) -> impl Iterator<Item = usize> {
        let statistics = self.dictionary.statistics.iter().enumerate();
        statistics.filter(move |(_, statistic)| statistic.effect() == Some(kind)).map(|(i, _)| i)
    }

    /// Which of two statistics says more: the one of larger weight, and at the same weight the one that is farther off.
    fn says(&self, a: usize, b: usize) -> Ordering {
        let off = |i: usize| self.dictionary.statistics[i].off(self.null.z[i]);
        self.null.weight[a].total_cmp(&self.null.weight[b]).then(off(a).total_cmp(&off(b)))
    }

    /// The statistic of an effect that says most. It needn't be the one that is farthest off: where clutter stays, many standard
    /// deviations say little.
    fn most_telling(&self, kind: EffectKind) -> Option<usize> {
        self.own(kind).max_by(|&a, &b| self.says(a, b))
    }
}

/// Finds where a log and a simulator disagree, and why.
///
/// # Errors
/// [`GapError`] for a log that isn't of the simulator's laser or too short, and when `stop` is set.
pub fn find(
    nominal: &Nominal,
    recorded: &Recorded,
    options: &GapOptions,
    progress: &dyn Progress,
    stop: &AtomicBool,
) -> Result<Outcome, GapError> {
    nominal.check(recorded)?;
    progress.stage("fitting blocks and reference", 1);
    let within = within_limit(nominal, recorded);
    let recorded = &within;
    let known = known_part(nominal, recorded, options.seed)?;
    let nominal = known.as_ref().map_or(nominal, |known| &known.nominal);
    let mut options = options.clone();
    if known.is_some() {
        options
            .without
            .extend(EffectKind::ALL.into_iter().filter(|kind| kind.description().is_as_map_errors));
    }
    let recorded = known.as_ref().map_or(recorded, |known| &known.recorded);
    let comparison = match &known {
        Some(known) => {
            Comparison { nominal, recorded: Cow::Borrowed(recorded), views: Arc::clone(&known.views) }
        }
        None => Comparison::new(nominal, recorded)?,
    };
    let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
    let (corrected, fitted) = comparison.clone().recast(&nominal.effects, fitted)?;
    let blocks = fit_persistence(&corrected, &[], &fitted, options.seed)?;
    progress.advance(1);
    let state = State { nominal, recorded, comparison, options: &options, progress, stop, blocks };
    let mut path = state.name_effects(state.round(Vec::new(), fitted.nuisances, options.replicates)?)?;
    state.delete(&mut path)?;
    state.simplify(&mut path)?;
    state.make_sure(&mut path)?;
    state.join_biases(&mut path)?;
    state.join_surfaces(&mut path)?;
    state.drop_shared(&mut path)?;
    state.come_nearer(&mut path)?;
    // Deeper blocks also stand in the way of more beams.
    let deeper = path.named.iter().any(|named| named.name.moves() == Moves::Clutter);
    let nameless = state.nameless(path.last())?;
    // What has no name may look like clutter.
    let is_told = nameless.unnamed.is_empty() && !options.without.contains(&EffectKind::BlockDensity);
    if !deeper && is_told {
        let more = state.block_density(path.first(), path.last())?;
        path.named.extend(more);
    }
    let remaining = state.remaining(&mut path)?;
    let outcome = state.outcome(path, remaining.as_ref(), nameless)?;
    Ok(Outcome { map: known.map(|known| known.findings), ..outcome })
}

/// A beam is at the laser's limit where noise of so many standard deviations takes its range to the other side of it.
const AT_LIMIT_SIGMAS: f64 = 4.0;

/// The log without beams that nominally end at the laser's maximum range. Whether noise makes a return of a wall that is a little farther away is
/// each driver's own way, and readings that no simulated log can have say much.
fn within_limit(nominal: &Nominal, recorded: &Recorded) -> Recorded {
    let laser = &nominal.laser;
    let max = laser.max_range_m;
    let at_limit = AT_LIMIT_SIGMAS * (laser.sigma_m + laser.sigma_per_m * max);
    let ranges = surface_ranges(nominal, recorded, &nominal.effects);
    let ignored: Vec<bool> = ranges.into_iter().map(|range| (range - max).abs() < at_limit).collect();
    recorded.without(&ignored)
}

/// The part of a log that a measured map says something of.
struct KnownPart {
    /// The simulator, with no more noise and random readings than the log has.
    nominal: Nominal,
    recorded: Recorded,
    views: Arc<Views>,
    findings: MeasuredMapFindings,
}

/// Fewer readings with a nominal range can't be compared.
const LEAST_READINGS: usize = 200;

/// The readings that a measured map says something of, with where it is wrong; `None` of a map that is taken for exact.
fn known_part(nominal: &Nominal, recorded: &Recorded, seed: u64) -> Result<Option<KnownPart>, GapError> {
    if nominal.pieces.is_none() {
        return Ok(None);
    }
    let all = Comparison::new(nominal, recorded)?;
    let unsure = &all.views.unsure;
    let ignored: Vec<bool> = unsure.iter().map(Option::is_some).collect();
    let readings = ignored.iter().filter(|ignored| !**ignored).count();
    if readings < LEAST_READINGS {
        return Err(GapError::TooFewReadings { readings, all: ignored.len(), least: LEAST_READINGS });
    }
    let sure = recorded.without(&ignored);
    let comparison = all.of(&sure);
    let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
    let (errors, wrong) = map_error::find(&comparison, &fitted);
    let (nominal, guesses) = calibration::as_in_log(&comparison.of(&sure.without(&wrong)), &fitted, seed)?;
    let share = |count: usize| count as f64 / unsure.len().max(1) as f64;
    let of = |reason| share(unsure.iter().filter(|unsure| **unsure == Some(reason)).count());
    let left_out = LeftOut {
        unknown: of(Unsure::Unknown),
        at_ends: of(Unsure::AtEnd),
        map_errors: share(
            wrong.iter().zip(unsure).filter(|(wrong, unsure)| **wrong && unsure.is_none()).count(),
        ),
    };
    let views = Arc::clone(&comparison.views);
    Ok(Some(KnownPart {
        nominal,
        recorded: sure.without(&wrong),
        views,
        findings: MeasuredMapFindings { guesses, left_out, errors },
    }))
}

struct State<'a> {
    nominal: &'a Nominal,
    recorded: &'a Recorded,
    /// The log against the nominal world.
    comparison: Comparison<'a>,
    options: &'a GapOptions,
    progress: &'a dyn Progress,
    stop: &'a AtomicBool,
    blocks: BlockPolicy,
}

impl<'a> State<'a> {
    /// Fits the nuisances under these effects and simulates logs with them.
    fn round(
        &self,
        effects: Vec<Effect>,
        nuisances: Nuisances,
        replicates: u32,
    ) -> Result<Round<'a>, GapError> {
        let all = self.nominal.effects_with(&effects)?;
        let comparison = self.comparison.in_world(&all)?;
        let fitted = comparison.fit_nuisances_with(&all, &nuisances, 20);
        let (comparison, fitted) = comparison.recast(&all, fitted)?;
        let seed = Purpose::Round.draw(self.options.seed).seed(effects.len() as u32);
        let mut blocks = self.blocks;
        if !effects.is_empty() && !blocks.stands() {
            // Readings that are far off don't show what stands.
            let found = fit_persistence(&comparison, &effects, &fitted, seed)?;
            blocks = if found.stay_scans() > blocks.stay_scans() { found } else { blocks };
        }
        let blocks = BlockTruth::of(blocks).in_world(&comparison, &effects, &fitted, seed)?;
        let dictionary = Dictionary::new(&comparison);
        self.progress.stage(
            if effects.is_empty() { "simulating the nominal world" } else { "simulating with the effects" },
            u64::from(replicates),
        );
        let replay = Replay::new(&comparison, &effects, &fitted, blocks);
        let tick = |ticks| self.progress.advance(ticks);
        let null = compare(&replay, &comparison, &dictionary, &fitted, replicates, seed, self.stop, &tick)?;
        Ok(Round {
            effects,
            comparison,
            fitted,
            blocks,
            dictionary,
            null,
            judgement: OnceLock::new(),
            logs: OnceLock::new(),
        })
    }

    /// Fits the effects whose statistics are farthest off, and further ones.
    fn candidates(
        &self,
        round: &Round<'a>,
        count: usize,
        chance: f64,
        further: &[EffectKind],
    ) -> Result<Vec<Candidate>, GapError> {
        let Guesses { starts, moving } = self.first_guesses(round, count, chance, further)?;
        self.progress.stage("fitting effects", starts.len() as u64);
        // After as many updates of the nuisance parameters as evaluations with an effect.
        let without = round.comparison.evaluate(&round.effects, &round.fitted, 1)?;
        let search = Search {
            comparison: &round.comparison,
            given: &round.effects,
            without: &without,
            start: &round.fitted,
        };
        let fits = starts
            .par_iter()
            .map(|(kind, starts)| {
                if self.stop.load(std::sync::atomic::Ordering::Relaxed) {
                    return Err(GapError::Interrupted);
                }
                let fit = search.fit(*kind, starts, moving.contains(kind));
                self.progress.advance(1);
                fit
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut candidates: Vec<Candidate> = fits.into_iter().flatten().collect();
        let beyond_chance = round.null.weight_at(self.options.false_alarm);
        // A noise explains a little of anything. Scans that are moved explain more only where they are moved.
        let noises = candidates.iter().filter(|candidate| candidate.kind().is_noise());
        let of_noise = noises.map(Candidate::gain).max_by(f64::total_cmp).unwrap_or(f64::INFINITY);
        for candidate in &mut candidates {
            let (off, weight) = round.most_telling(candidate.kind()).map_or((0.0, f64::NEG_INFINITY), |i| {
                (round.dictionary.statistics[i].off(round.null.z[i]), round.null.weight[i])
            });
            let kind = candidate.kind();
            let form = |i: usize| round.dictionary.statistics[i].form;
            let has_score = round.own(kind).any(|i| form(i) == Form::Score) || kind.moves() == Moves::Clutter;
            // A score takes readings that are moved by many standard deviations for something other than the wall. Most beams of a wall go
            // through it for no other reason.
            // Nor does one that counts a reading as one event at the most say how much many of them gain.
            let is_bounded = |i: usize| round.dictionary.statistics[i].by_one_reading > 0.0;
            let is_beyond_score = candidate.gain() > BEYOND_SCORE_NATS
                && (moving.contains(&kind)
                    || kind.lets_beams_through() && candidate.effect.values[0] > 0.5
                    || weight >= beyond_chance && round.own(kind).all(is_bounded)
                    || kind.moves() == Moves::Scans && candidate.gain() > of_noise);
            candidate.is_beyond_chance = weight >= beyond_chance || is_beyond_score;
            candidate.moves_most = moving.contains(&kind);
            candidate.score = (has_score && !is_beyond_score).then_some(off);
            // Beyond its score a fit gains only where the effect is strong. The depth of clutter has no score, and readings
            // where nominal clutter can't stand say far more than the mean depth. A share of readings is no score either, nor a
            // correlation with the motion, which is 1 at the most; and the likelihood of an odometry simplifies nothing.
            let is_telling = |i: usize| form(i) == Form::Share && round.null.weight[i] >= beyond_chance;
            let is_free = is_beyond_score || round.own(kind).any(is_telling);
            if off < BEYOND_DOUBT && !matches!(kind.moves(), Moves::Clutter | Moves::Odometry) && !is_free {
                candidate.limit(off * off);
            }
            // Standard deviations say little where statistics have outliers, as counts of objects among clutter that stays.
            if !candidate.is_beyond_chance {
                candidate.limit(2.0 * weight.max(0.0));
            }
        }
        Ok(candidates)
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{DRIVE, MAX_M, NOMINAL, SIGMA_M};

    use super::*;

    /// Beams whose walls are at the maximum range, to four standard deviations, have no readings. All others keep theirs.
    #[test]
    fn beams_at_the_laser_s_limit_are_left_out() {
        let recorded = Recorded::new(&DRIVE, 100, 72, |_| true).unwrap();
        let within = within_limit(&NOMINAL, &recorded);
        let ranges = surface_ranges(&NOMINAL, &recorded, &NOMINAL.effects);
        let mut left_out = 0;
        for (i, range) in ranges.iter().enumerate() {
            let is_at_limit = (range - MAX_M).abs() < 4.0 * SIGMA_M;
            left_out += usize::from(is_at_limit);
            let is_kept = within.readings[i].to_bits() == recorded.readings[i].to_bits();
            assert!(is_kept || is_at_limit && within.readings[i].is_nan(), "{i} {range}");
            assert!(!is_at_limit || within.readings[i].is_nan(), "{i} {range}");
        }
        assert!((5..700).contains(&left_out), "{left_out}");
    }
}
