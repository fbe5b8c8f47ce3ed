//! The search: detect, locate, name, add, and stop when nothing is off any more.

mod naming;
mod precision;
mod starts;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use locsim_core::{Draw, Stage};
use locsim_world::effect::{Effect, EffectKind};
use locsim_world::simulation::BlockResampling;
use rand::RngExt;
use rayon::prelude::*;

use naming::{adds_up, choose, compare_rivals, gain, is_sure, name, numbers, sum_of};

use crate::fit::{Candidate, Search, Start, blocks};
use crate::hypothesis::{Comparison, Fitted, Nuisances};
use crate::null::{Null, compare};
use crate::outcome::{
    Detectable, Detection, Direction, Estimate, Evidence, Gap, Named, Number, Outcome, Rival, Verdict,
};
use crate::replay::{BlockTruth, Replay, fit_persistence};
use crate::show::{Side, distance, histograms, locate, pits};
use crate::statistics::{Aim, Dictionary, Hint};
use crate::views::Views;
use crate::{GapError, Nominal, Recorded};

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

/// An effect can be named if its own direction is off as only in this share of logs without anything some direction is.
const FAR_OFF: f64 = 0.1;
/// The same for what may be left when nothing is off any more.
const SOMEWHAT_OFF: f64 = 0.5;

/// So many of the first round's effects are tried alone where several were named, after a glance at so many simulated logs.
const TRIED_ALONE: usize = 9;
const GLANCE: u32 = 19;

/// A score so many standard deviations off is of something strong.
const BEYOND_DOUBT: f64 = 10.0;

/// Is told how far a search is.
pub trait Progress: Sync {
    /// A new stage of so many ticks begins.
    fn stage(&self, name: &str, ticks: u64);
    /// So many of them are done.
    fn advance(&self, ticks: u64);
}

impl Progress for () {
    fn stage(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
}

/// A hypothesis with what simulations of it look like.
struct Round<'a> {
    effects: Vec<Effect>,
    comparison: Comparison<'a>,
    fitted: Fitted,
    blocks: BlockTruth,
    dictionary: Dictionary,
    null: Null,
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
    let comparison = Comparison::new(nominal, recorded);
    let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
    let blocks = fit_persistence(nominal, recorded, &fitted, options.seed)?;
    progress.advance(1);
    let state = State { nominal, recorded, options, progress, stop, blocks };
    let mut path = state.name_effects(state.round(Vec::new(), fitted.nuisances, options.replicates)?)?;
    state.delete(&mut path)?;
    state.simplify(&mut path)?;
    if !path.named.is_empty() {
        state.make_precise(&mut path.named, &path.rounds[path.rounds.len() - 1])?;
    }
    // Deeper blocks also stand in the way of more beams.
    let deeper = path.named.iter().any(|named| named.name == EffectKind::BlockDepth);
    if !deeper && !options.without.contains(&EffectKind::BlockDensity) {
        let more = state.block_density(path.first(), path.last())?;
        path.named.extend(more);
    }
    state.outcome(path)
}

/// The way from the nominal world to the named effects.
struct Path<'a> {
    /// The nominal world first, the one with all effects last.
    rounds: Vec<Round<'a>>,
    named: Vec<Named>,
    /// What the first round's fits were.
    first_fits: Vec<Candidate>,
    rivals: Vec<Rival>,
    /// What each round's choice gained, block by block.
    gains: Vec<Vec<f64>>,
    /// What would gain most on top.
    remaining: Option<Candidate>,
}

impl<'a> Path<'a> {
    fn first(&self) -> &Round<'a> {
        &self.rounds[0]
    }

    fn last(&self) -> &Round<'a> {
        &self.rounds[self.rounds.len() - 1]
    }

    fn effects(&self) -> Vec<Effect> {
        self.named.iter().map(|named| named.effect.clone()).collect()
    }
}

struct State<'a> {
    nominal: &'a Nominal,
    recorded: &'a Recorded,
    options: &'a GapOptions,
    progress: &'a dyn Progress,
    stop: &'a AtomicBool,
    blocks: BlockTruth,
}

impl<'a> State<'a> {
    /// Names the effect that gains most, adds it, and looks again, until nothing is off or nothing surely gains.
    fn name_effects(&self, first: Round<'a>) -> Result<Path<'a>, GapError> {
        let options = self.options;
        let mut path = Path {
            rounds: vec![first],
            named: Vec::new(),
            first_fits: Vec::new(),
            rivals: Vec::new(),
            gains: Vec::new(),
            remaining: None,
        };
        loop {
            let round = path.last();
            let off = round.null.p <= options.false_alarm;
            if !off && path.named.is_empty() {
                break;
            }
            let (count, chance) = if off { (options.fitted_kinds, FAR_OFF) } else { (3, SOMEWHAT_OFF) };
            let candidates = self.candidates(round, count, chance)?;
            let accepted =
                if off && path.named.len() < options.most_effects { choose(&candidates) } else { None };
            let most = |a: &&Candidate, b: &&Candidate| a.gain().total_cmp(&b.gain());
            let Some(best) = accepted else {
                if let Some(best) = candidates.iter().max_by(most).filter(|_| off) {
                    path.rivals.extend(compare_rivals(&candidates, best, path.rounds.len()));
                }
                path.remaining = candidates.into_iter().max_by(|a, b| a.gain().total_cmp(&b.gain()));
                break;
            };
            let (p, fitted) = (round.null.p, round.fitted.clone());
            path.rivals.extend(compare_rivals(&candidates, &candidates[best], path.rounds.len()));
            path.gains.push(candidates[best].gains.clone());
            let more = name(&candidates, best, p, self.recorded.scans());
            if path.rounds.len() == 1 {
                path.first_fits = candidates;
            }
            match path.named.iter().position(|known| adds_up(&known.effect, &more.effect)) {
                Some(known) => {
                    path.named[known].effect = sum_of(&path.named[known].effect, &more.effect)?;
                    if path.rounds.len() > 2 * options.most_effects {
                        // It doesn't settle.
                        break;
                    }
                    self.refit(&mut path.named, known, &fitted)?;
                }
                None => path.named.push(more),
            }
            let next = self.round(path.effects(), fitted.nuisances, options.replicates)?;
            path.rounds.push(next);
        }
        Ok(path)
    }

    /// What an effect was named for, a later one may explain: a strong yaw looks like noise at first.
    fn delete(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        if path.named.len() < 2 {
            return Ok(());
        }
        let count = path.named.len();
        let mut i = 0;
        while i < path.named.len() {
            let fitted = &path.rounds[path.rounds.len() - 1].fitted;
            if self.refit(&mut path.named, i, fitted)? || path.named.len() == 1 {
                i += 1;
            } else {
                path.named.remove(i);
            }
        }
        if path.named.len() < count {
            let next = self.round(path.effects(), path.last().fitted.nuisances, self.options.replicates)?;
            path.rounds.push(next);
        }
        Ok(())
    }

    /// One effect that explains everything alone is better than several, even if others gain more one by one: unmapped blocks
    /// that are deeper than expected and stay look like a missing object each.
    fn simplify(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        if path.named.len() < 2 {
            return Ok(());
        }
        let mut alone: Vec<usize> =
            (0..path.first_fits.len()).filter(|&i| is_sure(&path.first_fits[i])).collect();
        alone.sort_by(|&a, &b| path.first_fits[b].gain().total_cmp(&path.first_fits[a].gain()));
        for &i in alone.iter().take(TRIED_ALONE) {
            let (effects, nuisances) =
                (vec![path.first_fits[i].effect.clone()], path.first().fitted.nuisances);
            // Most are far from it, which few simulated logs can say.
            if self.round(effects.clone(), nuisances, GLANCE)?.null.is_clearly_off() {
                continue;
            }
            let round = self.round(effects, nuisances, self.options.replicates)?;
            if round.null.p <= self.options.false_alarm {
                continue;
            }
            let mut named = name(&path.first_fits, i, path.first().null.p, self.recorded.scans());
            // Those that gain as much don't explain everything, or weren't tried.
            (named.candidates, named.split_by) = (vec![named.name], None);
            path.gains = vec![path.first_fits[i].gains.clone()];
            path.named = vec![named];
            path.rounds.truncate(1);
            path.remaining = self
                .candidates(&round, 3, SOMEWHAT_OFF)?
                .into_iter()
                .max_by(|a, b| a.gain().total_cmp(&b.gain()));
            path.rounds.push(round);
            break;
        }
        Ok(())
    }

    /// What is told of it all.
    fn outcome(&self, path: Path<'a>) -> Result<Outcome, GapError> {
        let State { nominal, recorded, options, .. } = *self;
        let Path { rounds, named, rivals, gains, remaining, .. } = path;
        let (before, after) = (&rounds[0], &rounds[rounds.len() - 1]);
        let still_off = after.null.p <= options.false_alarm;
        let verdict = match (named.is_empty(), still_off) {
            (true, true) => Verdict::Unexplained,
            (true, false) => Verdict::None,
            (false, true) => Verdict::PartlyExplained,
            (false, false) if named.iter().any(|named| named.candidates.len() > 1) => Verdict::Ambiguous,
            (false, false) => Verdict::Named,
        };
        let detectable = detectable(before);
        let blind = detectable.iter().filter(|d| d.value > d.typical).count();
        let verdict = if verdict == Verdict::None && 2 * blind > detectable.len() {
            Verdict::Underpowered
        } else {
            verdict
        };
        self.progress.stage("measuring the gap", 1);
        let (old, new) = (self.replay(before)?, self.replay(after)?);
        let side = [before, after].map(|round| Side { dictionary: &round.dictionary, null: &round.null });
        let regions = locate(&side[0], &side[1], &before.comparison.views, recorded, &old);
        let gap = self.gap(before, after, &gains, remaining.as_ref(), &old, &new);
        let beam_pits = pits(
            &before.comparison,
            &before.fitted,
            &after.comparison,
            &after.fitted,
            nominal,
            &after.effects,
            options.seed,
        )?;
        let pit = histograms(&before.comparison, &beam_pits);
        self.progress.advance(1);
        Ok(Outcome {
            verdict,
            effects: named,
            detection: detection(&before.null),
            detection_after: detection(&after.null),
            regions,
            gap,
            filter: None,
            rivals,
            detectable,
            directions: directions(before),
            threshold: before.null.threshold,
            nuisances: before.fitted.nuisances,
            pit,
            notes: notes(nominal, self.blocks.resample),
            scans: recorded.scans(),
            beams: recorded.beams(),
            seed: options.seed,
            seconds: 0.0,
            beam_pits,
        })
    }

    /// Fits the nuisances under these effects and simulates logs with them.
    fn round(
        &self,
        effects: Vec<Effect>,
        nuisances: Nuisances,
        replicates: u32,
    ) -> Result<Round<'a>, GapError> {
        let all = self.nominal.effects_with(&effects)?;
        let views = Arc::new(Views::new(self.nominal, self.recorded, &all));
        let comparison = Comparison { nominal: self.nominal, recorded: self.recorded, views };
        let fitted = comparison.fit_nuisances_with(&all, &nuisances, 20);
        let seed = Draw::new(self.options.seed, Stage::Trial, 9).seed(effects.len() as u32);
        let blocks =
            self.blocks.in_world(self.nominal, self.recorded, &comparison.views, &effects, &fitted, seed)?;
        let dictionary = Dictionary::new(&comparison);
        self.progress.stage(
            if effects.is_empty() { "simulating the nominal world" } else { "simulating with the effects" },
            u64::from(replicates),
        );
        let replay = Replay {
            nominal: self.nominal,
            recorded: self.recorded,
            effects: &effects,
            nuisances: fitted.nuisances,
            blocks,
        };
        let tick = |ticks| self.progress.advance(ticks);
        let null = compare(
            &replay,
            &comparison,
            &comparison.views,
            &dictionary,
            &fitted,
            replicates,
            seed,
            self.stop,
            &tick,
        )?;
        Ok(Round { effects, comparison, fitted, blocks, dictionary, null })
    }

    /// Fits the kinds of effect whose statistics are farthest off.
    fn candidates(&self, round: &Round<'a>, count: usize, chance: f64) -> Result<Vec<Candidate>, GapError> {
        let starts = self.starts(round, count, chance);
        self.progress.stage("fitting effects", starts.len() as u64);
        // The comparison of the nominal world: effects given so far are part of each hypothesis.
        let comparison = Comparison::new(self.nominal, self.recorded);
        // As far along as with the effect.
        let without = comparison.evaluate(&round.effects, &round.fitted, 1)?;
        let search = Search {
            comparison: &comparison,
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
                let fit = search.fit(*kind, starts);
                self.progress.advance(1);
                fit
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut candidates: Vec<Candidate> = fits.into_iter().flatten().collect();
        let beyond_chance = round.null.weight_at(self.options.false_alarm);
        for candidate in &mut candidates {
            let is_own =
                |(_, aim): &(usize, &Aim)| matches!(aim, Aim::Effect(kind, _) if *kind == candidate.kind());
            let own = || round.dictionary.aims.iter().enumerate().filter(is_own).map(|(i, _)| i);
            let off = own().map(|i| round.dictionary.off(i, round.null.z[i])).fold(0.0, f64::max);
            let weight = own().map(|i| round.null.weight[i]).fold(f64::NEG_INFINITY, f64::max);
            candidate.is_beyond_chance = weight >= beyond_chance;
            // A fit can be far better than its score where the effect is strong.
            if off < BEYOND_DOUBT {
                candidate.limit(off * off);
            }
            // Many standard deviations are nothing where statistics are clumped, as objects among resting blocks.
            if !candidate.is_beyond_chance {
                candidate.limit(2.0 * weight.max(0.0));
            }
        }
        Ok(candidates)
    }

    /// A density of unmapped blocks that isn't the scenario's: fitted to the log in every hypothesis, it is told as an effect
    /// where simulated logs say that it can't be chance.
    fn block_density(&self, first: &Round<'a>, last: &Round<'a>) -> Result<Option<Named>, GapError> {
        let logs: Vec<f64> = last.null.fits.iter().map(|fit| fit.nuisances.block_density.ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let error = (logs.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / (logs.len() as f64 - 1.0)).sqrt();
        // The fit's bias by the last round's own simulated logs: the first one's is of a world without the effects.
        let fitted = last.fitted.nuisances.block_density.ln();
        let simulated = fitted + last.blocks.density_over_fit.ln();
        let truth = fitted + simulated - mean;
        let z = truth / error;
        // As rare as one false alarm among all effects.
        let p = statrs::function::erf::erfc(z.abs() / std::f64::consts::SQRT_2);
        if self.nominal.blocks.is_none() || !error.is_finite() || p > 0.1 * self.options.false_alarm {
            return Ok(None);
        }
        let kind = EffectKind::BlockDensity;
        let parameter = &kind.parameters()[0];
        let effect = Effect::new(kind, vec![truth.exp().clamp(parameter.lo, parameter.hi)], Vec::new())?;
        let mut nominal = first.fitted.clone();
        nominal.nuisances.block_density = 1.0 / self.blocks.density_over_fit;
        let without = first.comparison.evaluate(&[], &nominal, 0)?;
        let gains: Vec<f64> = blocks(&first.fitted.scans)
            .iter()
            .zip(blocks(&without.scans))
            .map(|(with, without)| with - without)
            .collect();
        let gain_nats = gain(&gains);
        let number = Number {
            value: truth.exp(),
            lo: (truth - 1.96 * error).exp(),
            hi: (truth + 1.96 * error).exp(),
            unit: parameter.unit,
        };
        Ok(Some(Named {
            name: kind,
            candidates: vec![kind],
            params: [(parameter.name, number)].into(),
            place: Vec::new(),
            evidence: Evidence {
                gain_nats,
                gain_nats_per_scan: gain_nats.value / self.recorded.scans() as f64,
                p,
            },
            split_by: None,
            effect,
        }))
    }

    /// Fits the numbers of one effect anew, the others as they are; whether it still surely gains.
    fn refit(&self, named: &mut [Named], index: usize, start: &Fitted) -> Result<bool, GapError> {
        let comparison = Comparison::new(self.nominal, self.recorded);
        let others = named.iter().enumerate().filter(|(i, _)| *i != index);
        let given: Vec<Effect> = others.map(|(_, named)| named.effect.clone()).collect();
        let without = comparison.evaluate(&given, start, 1)?;
        let search = Search { comparison: &comparison, given: &given, without: &without, start: &without };
        let effect = &named[index].effect;
        let from = Start { values: effect.values.clone(), place: effect.place.clone() };
        let fit = search.fit(effect.kind, &[from])?;
        let gains = fit.as_ref().is_some_and(is_sure);
        if let Some(candidate) = fit {
            let named = &mut named[index];
            named.params = numbers(&candidate);
            named.evidence.gain_nats = gain(&candidate.gains);
            named.evidence.gain_nats_per_scan = named.evidence.gain_nats.value / self.recorded.scans() as f64;
            named.effect = candidate.effect;
        }
        Ok(gains)
    }

    /// Some simulated logs of a round.
    fn replay(&self, round: &Round<'a>) -> Result<Vec<Recorded>, GapError> {
        let replay = Replay {
            nominal: self.nominal,
            recorded: self.recorded,
            effects: &round.effects,
            nuisances: round.fitted.nuisances,
            blocks: round.blocks,
        };
        let draw = Draw::new(self.options.seed, Stage::Trial, 10);
        (0..8).into_par_iter().map(|i| replay.simulate(draw.seed(i))).collect()
    }

    fn gap(
        &self,
        before: &Round<'a>,
        after: &Round<'a>,
        gains: &[Vec<f64>],
        remaining: Option<&Candidate>,
        old: &[Recorded],
        new: &[Recorded],
    ) -> Gap {
        let scans = self.recorded.scans() as f64;
        let blocks = gains.first().map_or(0, Vec::len);
        let gained: Vec<f64> = (0..blocks).map(|b| gains.iter().map(|g| g[b]).sum()).collect();
        let rest: Vec<f64> = match remaining {
            Some(candidate) if candidate.gain() > 0.0 => candidate.gains.clone(),
            _ => vec![0.0; blocks.max(1)],
        };
        let share = |gained: f64, rest: f64| {
            if gained <= 0.0 { 0.0 } else { gained / (gained + rest.max(0.0)) }
        };
        let total = |values: &[f64]| values.iter().sum::<f64>();
        let closed = if gained.is_empty() {
            Estimate { value: 0.0, lo: 0.0, hi: 0.0 }
        } else {
            let draw = Draw::new(self.options.seed, Stage::Bootstrap, 3);
            let mut shares: Vec<f64> = (0..1000)
                .map(|i| {
                    let mut rng = draw.item(i);
                    let (mut a, mut b) = (0.0, 0.0);
                    for _ in 0..blocks {
                        let block = rng.random_range(0..blocks);
                        a += gained[block];
                        b += rest[block.min(rest.len() - 1)];
                    }
                    share(a, b)
                })
                .collect();
            shares.sort_by(f64::total_cmp);
            Estimate { value: share(total(&gained), total(&rest)), lo: shares[25], hi: shares[974] }
        };
        let view = &before.comparison.views;
        let floor =
            after.null.fits.iter().map(Fitted::total).sum::<f64>() / after.null.fits.len().max(1) as f64;
        let score = |total: f64, w1_mm: f64| crate::outcome::Distance {
            log_score_nats_per_scan: total / scans,
            w1_mm,
        };
        Gap {
            before: score(before.fitted.total(), distance(view, self.recorded, old)),
            after: score(after.fitted.total(), distance(view, self.recorded, new)),
            floor: score(floor, distance(view, &new[0], &new[1..])),
            gained_nats_per_scan: total(&gained) / scans,
            remaining_nats_per_scan: total(&rest).max(0.0) / scans,
            closed,
        }
    }
}

/// Strengths that reach the threshold with 90 % probability: a score's spread is the square root of its information.
fn detectable(round: &Round<'_>) -> Vec<Detectable> {
    let threshold = round.null.threshold + 1.2816;
    let mut out: Vec<Detectable> = Vec::new();
    for (i, aim) in round.dictionary.aims.iter().enumerate() {
        let Aim::Effect(kind, hint) = aim else { continue };
        if !round.dictionary.is_score(i) || *hint != Hint::None || round.null.spread[i] < 1e-3 {
            continue;
        }
        let parameter = &kind.parameters()[0];
        let value = threshold / round.null.spread[i];
        if value.is_finite() && out.iter().all(|known| known.name != *kind) {
            let typical = (parameter.start - parameter.neutral).abs();
            out.push(Detectable {
                name: *kind,
                parameter: parameter.name,
                value,
                unit: parameter.unit,
                typical,
            });
        }
    }
    out
}

fn detection(null: &Null) -> Detection {
    Detection {
        p_library: null.p_library,
        p_omnibus: null.p_omnibus,
        p: null.p,
        replicates: null.fits.len() as u32,
    }
}

/// The farthest statistic of each effect, with its sign.
fn directions(round: &Round<'_>) -> Vec<Direction> {
    let mut out: Vec<Direction> = Vec::new();
    for (aim, &z) in round.dictionary.aims.iter().zip(&round.null.z) {
        let Aim::Effect(kind, _) = aim else { continue };
        match out.iter_mut().find(|direction| direction.name == *kind) {
            Some(known) if known.z.abs() < z.abs() => known.z = z,
            Some(_) => {}
            None => out.push(Direction { name: *kind, z }),
        }
    }
    out
}

fn notes(nominal: &Nominal, resample: BlockResampling) -> Vec<String> {
    let mut notes = vec![
        "A constant yaw of the laser's mount and a constant error of the reference's heading can't be told apart from \
         scans alone."
            .to_owned(),
    ];
    if let Some(blocks) = nominal.blocks.filter(|blocks| blocks.resample != resample) {
        notes.push(format!(
            "Unmapped blocks stay otherwise than the scenario says ({:?} instead of {:?}).",
            resample, blocks.resample
        ));
    }
    notes
}
