//! The search: detect, locate, name, add, and stop when nothing is off any more.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::DVec2;
use locsim_core::{Draw, Stage};
use locsim_world::effect::{Effect, EffectKind};
use locsim_world::simulation::BlockResampling;
use rand::RngExt;
use rayon::prelude::*;

use crate::fit::{Candidate, Search, Start, blocks, sum_error};
use crate::hypothesis::{Comparison, Fitted, Nuisances};
use crate::null::{BlockTruth, Null, Replay, compare, fit_persistence};
use crate::outcome::{
    Detectable, Detection, Estimate, Evidence, Gap, Named, Number, Outcome, Rival, Verdict,
};
use crate::show::{Side, distance, histograms, locate, pits};
use crate::statistics::{Aim, Dictionary, Hint, OBJECT_CELL_M, WALL_CELL_M};
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
    let first = state.round(Vec::new(), fitted.nuisances)?;
    let mut rounds = vec![first];
    let mut named: Vec<Named> = Vec::new();
    let mut rivals = Vec::new();
    let mut gains: Vec<Vec<f64>> = Vec::new();
    let mut remaining: Option<Candidate> = None;
    loop {
        let round = &rounds[rounds.len() - 1];
        let off = round.null.p <= options.false_alarm;
        if !off && named.is_empty() {
            break;
        }
        let count = if off { options.fitted_kinds } else { 3 };
        let candidates = state.candidates(round, count)?;
        let accepted = if off && named.len() < options.most_effects { choose(&candidates) } else { None };
        let Some(best) = accepted else {
            remaining = candidates.into_iter().max_by(|a, b| a.gain().total_cmp(&b.gain()));
            break;
        };
        rivals.extend(compare_rivals(&candidates, &candidates[best], rounds.len()));
        gains.push(candidates[best].gains.clone());
        let more = name(&candidates, best, round.null.p, recorded.scans());
        match named.iter().position(|known| adds_up(&known.effect, &more.effect)) {
            Some(known) if rounds.len() > 2 * options.most_effects => {
                // It doesn't settle.
                named[known].effect = sum_of(&named[known].effect, &more.effect)?;
                break;
            }
            Some(known) => {
                named[known].effect = sum_of(&named[known].effect, &more.effect)?;
                state.refit(&mut named, known, &round.fitted)?;
            }
            None => named.push(more),
        }
        let effects: Vec<Effect> = named.iter().map(|named| named.effect.clone()).collect();
        let next = state.round(effects, round.fitted.nuisances)?;
        rounds.push(next);
    }
    if named.len() > 1 {
        for i in 0..named.len() {
            state.refit(&mut named, i, &rounds[rounds.len() - 1].fitted)?;
        }
    }
    // Deeper blocks also stand in the way of more beams.
    let deeper = named.iter().any(|named| named.name == EffectKind::BlockDepth);
    if !deeper && !options.without.contains(&EffectKind::BlockDensity) {
        named.extend(state.block_density(&rounds[0], &rounds[rounds.len() - 1])?);
    }
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
    progress.stage("measuring the gap", 1);
    let (old, new) = (state.replay(before)?, state.replay(after)?);
    let side = [before, after].map(|round| Side { dictionary: &round.dictionary, null: &round.null });
    let regions = locate(&side[0], &side[1], &before.comparison.views, recorded, &old);
    let gap = state.gap(before, after, &gains, remaining.as_ref(), &old, &new);
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
    progress.advance(1);
    Ok(Outcome {
        verdict,
        effects: named,
        detection: state.detection(&before.null),
        detection_after: state.detection(&after.null),
        regions,
        gap,
        filter: None,
        rivals,
        detectable,
        nuisances: before.fitted.nuisances,
        pit,
        notes: notes(nominal, blocks.resample),
        scans: recorded.scans(),
        beams: recorded.beams(),
        seed: options.seed,
        seconds: 0.0,
        beam_pits,
    })
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
    /// Fits the nuisances under these effects and simulates logs with them.
    fn round(&self, effects: Vec<Effect>, nuisances: Nuisances) -> Result<Round<'a>, GapError> {
        let all = self.nominal.effects_with(&effects)?;
        let views = Arc::new(Views::new(self.nominal, self.recorded, &all));
        let comparison = Comparison { nominal: self.nominal, recorded: self.recorded, views };
        let fitted = comparison.fit_nuisances_with(&all, &nuisances, 20);
        let dictionary = Dictionary::new(&comparison);
        let replicates = self.options.replicates;
        self.progress.stage(
            if effects.is_empty() { "simulating the nominal world" } else { "simulating with the effects" },
            u64::from(replicates),
        );
        let replay = Replay {
            nominal: self.nominal,
            recorded: self.recorded,
            effects: &effects,
            nuisances: fitted.nuisances,
            blocks: self.blocks,
        };
        let seed = Draw::new(self.options.seed, Stage::Trial, 9).seed(effects.len() as u32);
        let tick = || self.progress.advance(1);
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
        Ok(Round { effects, comparison, fitted, dictionary, null })
    }

    fn detection(&self, null: &Null) -> Detection {
        Detection {
            p_library: null.p_library,
            p_omnibus: null.p_omnibus,
            p: null.p,
            replicates: self.options.replicates,
        }
    }

    /// Fits the kinds of effect whose statistics are farthest off.
    fn candidates(&self, round: &Round<'a>, count: usize) -> Result<Vec<Candidate>, GapError> {
        let starts = self.starts(round, count);
        self.progress.stage("fitting effects", starts.len() as u64);
        // The comparison of the nominal world: effects given so far are part of each hypothesis.
        let comparison = Comparison::new(self.nominal, self.recorded);
        let search = Search {
            comparison: &comparison,
            given: &round.effects,
            without: &round.fitted,
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
        Ok(fits.into_iter().flatten().collect())
    }

    /// Kinds with where their fits start, the most promising first.
    fn starts(&self, round: &Round<'a>, count: usize) -> Vec<(EffectKind, Vec<Start>)> {
        let mut best: Vec<(EffectKind, f64, Directions)> = Vec::new();
        for (i, aim) in round.dictionary.aims.iter().enumerate() {
            let Aim::Effect(kind, _) = aim else { continue };
            // The density of blocks is fitted along with everything else; see `block_density`.
            if self.options.without.contains(kind) || *kind == EffectKind::BlockDensity {
                continue;
            }
            let z = round.null.z[i];
            match best.iter_mut().find(|(known, ..)| known == kind) {
                Some((_, largest, all)) => {
                    *largest = largest.max(z.abs());
                    all.push((z, i));
                }
                None => best.push((*kind, z.abs(), vec![(z, i)])),
            }
        }
        best.sort_by(|a, b| b.1.total_cmp(&a.1));
        best.truncate(count);
        // An effect whose own direction is hardly off can't be what moves others this far.
        let least = best.first().map_or(0.0, |(_, z, _)| (0.25 * z).clamp(2.0, 4.0));
        best.retain(|(_, z, _)| *z >= least);
        best.into_iter()
            .map(|(kind, _, mut all)| {
                all.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
                let starts = self.starts_of(kind, &all, round);
                (kind, starts)
            })
            .filter(|(_, starts)| !starts.is_empty())
            .collect()
    }

    fn starts_of(&self, kind: EffectKind, all: &[(f64, usize)], round: &Round<'a>) -> Vec<Start> {
        let typical: Vec<f64> = kind.parameters().iter().map(|parameter| parameter.start).collect();
        let hint = |i: usize| match &round.dictionary.aims[i] {
            Aim::Effect(_, hint) => hint.clone(),
            Aim::Cell(_) => Hint::None,
        };
        let two_sided = kind.parameters()[0].lo < kind.parameters()[0].neutral;
        let signed = |mut values: Vec<f64>, z: f64| {
            if two_sided && z < 0.0 {
                values[0] = kind.parameters()[0].neutral - (values[0] - kind.parameters()[0].neutral);
            }
            values
        };
        match kind {
            EffectKind::MountOffset => {
                // Both axes at once: the two statistics come in the dictionary's order.
                let mut values = vec![0.0; 2];
                for &(z, i) in all {
                    if let Hint::Values(hints) = hint(i) {
                        for (axis, value) in hints {
                            if value != 0.0 {
                                values[axis] = value * z.signum();
                            }
                        }
                    }
                }
                vec![Start { values, place: Vec::new() }]
            }
            EffectKind::Glass | EffectKind::MovedWall => walls(round, all, 2)
                .into_iter()
                .map(|(z, stretch)| Start { values: signed(typical.clone(), z), place: vec![stretch] })
                .collect(),
            EffectKind::MissingObject => all
                .iter()
                .filter(|(z, _)| *z > 0.0)
                .take(3)
                .filter_map(|&(_, i)| match hint(i) {
                    Hint::Object([x, y]) => Some(Start {
                        values: vec![
                            (f64::from(x) + 0.5) * OBJECT_CELL_M,
                            (f64::from(y) + 0.5) * OBJECT_CELL_M,
                            0.15,
                        ],
                        place: Vec::new(),
                    }),
                    _ => None,
                })
                .collect(),
            EffectKind::SectorOcclusion => all
                .iter()
                .filter(|(z, _)| *z > 0.0)
                .take(2)
                .map(|&(_, i)| Start { values: self.sector(round, i, &typical), place: Vec::new() })
                .collect(),
            _ => {
                let most = if kind.parameters().len() > 1 { 2 } else { 1 };
                all.iter()
                    .take(most)
                    .map(|&(z, i)| {
                        let mut values = signed(typical.clone(), z);
                        if let Hint::Values(hints) = hint(i) {
                            for (number, value) in hints {
                                values[number] = value;
                            }
                        }
                        Start { values, place: Vec::new() }
                    })
                    .collect()
            }
        }
    }

    /// A sector's ends, by the neighbouring bearings at which something stands at the same range.
    fn sector(&self, round: &Round<'a>, index: usize, typical: &[f64]) -> Vec<f64> {
        let values = |i: usize| match &round.dictionary.aims[i] {
            Aim::Effect(EffectKind::SectorOcclusion, Hint::Values(hints)) => {
                Some([hints[0].1, hints[1].1, hints[2].1])
            }
            _ => None,
        };
        let Some([mut from, mut to, range]) = values(index) else { return typical.to_vec() };
        for (i, &z) in round.null.z.iter().enumerate().take(round.dictionary.first_cell()) {
            if let Some([a, b, r]) = values(i) {
                let joins = (r - range).abs() < 1e-9 && z > 4.0;
                if joins && (a - to).abs() < 1e-6 {
                    to = b;
                } else if joins && (b - from).abs() < 1e-6 {
                    from = a;
                }
            }
        }
        // Where exactly readings of it lie.
        let readings = &self.recorded.readings;
        let k = self.recorded.beams();
        let bearings = self.recorded.laser.bearings();
        let mut near: Vec<f64> = readings
            .iter()
            .enumerate()
            .filter(|(i, _)| (from..=to).contains(&f64::from(bearings[i % k])))
            .map(|(_, &z)| f64::from(z))
            .filter(|z| (z - range).abs() <= 0.2)
            .collect();
        near.sort_by(f64::total_cmp);
        let at = near.get(near.len() / 2).copied().unwrap_or(range);
        let mut start = vec![from, to, at, 0.3];
        start.truncate(typical.len());
        start
    }

    /// A density of unmapped blocks that isn't the scenario's: fitted to the log in every hypothesis, it is told as an effect
    /// where simulated logs say that it can't be chance.
    fn block_density(&self, first: &Round<'a>, last: &Round<'a>) -> Result<Option<Named>, GapError> {
        let logs: Vec<f64> = last.null.fits.iter().map(|fit| fit.nuisances.block_density.ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let error = (logs.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / (logs.len() as f64 - 1.0)).sqrt();
        let truth = (last.fitted.nuisances.block_density * self.blocks.density_over_fit).ln();
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

    /// Fits the numbers of one effect anew, the others as they are.
    fn refit(&self, named: &mut [Named], index: usize, start: &Fitted) -> Result<(), GapError> {
        let comparison = Comparison::new(self.nominal, self.recorded);
        let others = named.iter().enumerate().filter(|(i, _)| *i != index);
        let given: Vec<Effect> = others.map(|(_, named)| named.effect.clone()).collect();
        let without = comparison.evaluate(&given, start, 1)?;
        let search = Search { comparison: &comparison, given: &given, without: &without, start: &without };
        let effect = &named[index].effect;
        let from = Start { values: effect.values.clone(), place: effect.place.clone() };
        if let Some(candidate) = search.fit(effect.kind, &[from])? {
            let named = &mut named[index];
            named.params = numbers(&candidate);
            named.evidence.gain_nats = gain(&candidate.gains);
            named.evidence.gain_nats_per_scan = named.evidence.gain_nats.value / self.recorded.scans() as f64;
            named.effect = candidate.effect;
        }
        Ok(())
    }

    /// Some simulated logs of a round.
    fn replay(&self, round: &Round<'a>) -> Result<Vec<Recorded>, GapError> {
        let replay = Replay {
            nominal: self.nominal,
            recorded: self.recorded,
            effects: &round.effects,
            nuisances: round.fitted.nuisances,
            blocks: self.blocks,
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

/// Directions of a kind of effect: how far the log is off, and the index of the statistic.
type Directions = Vec<(f64, usize)>;

/// Whether two effects are one that was fitted in two steps: a strong one first comes out too weak.
fn adds_up(known: &Effect, more: &Effect) -> bool {
    let somewhere = matches!(known.kind, EffectKind::MissingObject | EffectKind::SectorOcclusion);
    known.kind == more.kind && known.place == more.place && !somewhere
}

/// Both as one: strengths add up, other numbers are the stronger one's.
fn sum_of(known: &Effect, more: &Effect) -> Result<Effect, GapError> {
    let parameters = known.kind.parameters();
    let count = if known.kind == EffectKind::MountOffset { 2 } else { 1 };
    let mut values = known.values.clone();
    for i in 0..count {
        let parameter = &parameters[i];
        values[i] = (known.values[i] + more.values[i] - parameter.neutral).clamp(parameter.lo, parameter.hi);
    }
    Ok(Effect::new(known.kind, values, known.place.clone())?)
}

/// Stretches of wall whose statistics are farthest off, neighbours joined.
fn walls(round: &Round<'_>, all: &[(f64, usize)], most: usize) -> Vec<(f64, [DVec2; 2])> {
    let cell = |i: usize| match round.dictionary.aims[i] {
        Aim::Effect(_, Hint::Wall(cell)) => Some(cell),
        _ => None,
    };
    let mut used: Vec<[i32; 2]> = Vec::new();
    let mut out = Vec::new();
    for &(z, i) in all {
        let Some(seed) = cell(i).filter(|seed| !used.contains(seed)) else { continue };
        if out.len() == most {
            break;
        }
        // Neighbouring cells that are off the same way.
        let strong = 0.35 * z.abs();
        let mut cells = vec![seed];
        let mut next = 0;
        while next < cells.len() {
            let [x, y] = cells[next];
            for &(other, j) in all {
                let Some(neighbour) = cell(j) else { continue };
                let touches = (neighbour[0] - x).abs() <= 1 && (neighbour[1] - y).abs() <= 1;
                if touches
                    && other.signum() == z.signum()
                    && other.abs() > strong.max(3.0)
                    && !cells.contains(&neighbour)
                {
                    cells.push(neighbour);
                }
            }
            next += 1;
        }
        used.extend(&cells);
        let points: Vec<DVec2> = round
            .comparison
            .views
            .beams
            .iter()
            .map(|beam| beam.view.endpoint)
            .filter(|p| cells.contains(&crate::statistics::cell_at(p.x, p.y, WALL_CELL_M)))
            .collect();
        if let Some(stretch) = line_through(&points) {
            out.push((z, stretch));
        }
    }
    out
}

/// The stretch along the direction in which points spread most.
fn line_through(points: &[DVec2]) -> Option<[DVec2; 2]> {
    let n = points.len() as f64;
    if points.len() < 3 {
        return None;
    }
    // Medians, as a recess or a corner may lie in the same cells.
    let mean = points.iter().sum::<DVec2>() / n;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let d = *p - mean;
        (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
    }
    let direction = DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy));
    let mut across: Vec<f64> = points.iter().map(|p| direction.perp_dot(*p - mean)).collect();
    across.sort_by(f64::total_cmp);
    let offset = across[across.len() / 2];
    let along: Vec<f64> = points
        .iter()
        .filter(|p| (direction.perp_dot(**p - mean) - offset).abs() < 0.1)
        .map(|p| direction.dot(*p - mean))
        .collect();
    let lo = along.iter().copied().fold(f64::INFINITY, f64::min);
    let hi = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let at = |along: f64| mean + along * direction + offset * direction.perp();
    (hi - lo > 0.05).then(|| [at(lo), at(hi)])
}

/// The candidate that is named: it gains surely, most of all, or within one standard error of that with fewer numbers.
fn choose(candidates: &[Candidate]) -> Option<usize> {
    let sure = |c: &Candidate| c.gain() > 2.0 && c.gain() - 1.645 * c.gain_error() > 0.0;
    let most = (0..candidates.len())
        .filter(|&i| sure(&candidates[i]))
        .max_by(|&a, &b| candidates[a].gain().total_cmp(&candidates[b].gain()))?;
    let simpler = (0..candidates.len()).filter(|&i| i != most && sure(&candidates[i])).filter(|&i| {
        let (behind, error) = behind(&candidates[most], &candidates[i]);
        let fewer = candidates[i].effect.values.len() < candidates[most].effect.values.len();
        fewer && behind < error
    });
    simpler.min_by_key(|&i| candidates[i].effect.values.len()).or(Some(most))
}

/// By how much a candidate is behind another, with the standard error over blocks (nats).
fn behind(best: &Candidate, other: &Candidate) -> (f64, f64) {
    let difference: Vec<f64> = best.gains.iter().zip(&other.gains).map(|(a, b)| a - b).collect();
    (difference.iter().sum(), sum_error(&difference))
}

fn gain(blocks: &[f64]) -> Estimate {
    let (value, error) = (blocks.iter().sum::<f64>(), sum_error(blocks));
    Estimate { value, lo: value - 1.96 * error, hi: value + 1.96 * error }
}

fn numbers(candidate: &Candidate) -> std::collections::BTreeMap<&'static str, Number> {
    let effect = &candidate.effect;
    let parameters = effect.kind.parameters().iter().zip(&effect.values).zip(&candidate.intervals);
    parameters
        .map(|((parameter, &value), &[lo, hi])| {
            (parameter.name, Number { value, lo, hi, unit: parameter.unit })
        })
        .collect()
}

/// Candidates that can't be told from the best: what they are behind isn't sure.
fn equivalent(candidates: &[Candidate], best: usize) -> Vec<EffectKind> {
    let mut set = vec![candidates[best].kind()];
    for (i, other) in candidates.iter().enumerate() {
        let (behind, error) = behind(&candidates[best], other);
        let sure = other.gain() - 1.645 * other.gain_error() > 0.0;
        if i != best && sure && behind < 1.3 * error && !is_same(&candidates[best], other) {
            set.push(other.kind());
        }
    }
    set
}

/// Whether an effect with more numbers has become the best one: a drift that doesn't end is a bias, a loss from any angle on
/// one at any range.
fn is_same(best: &Candidate, other: &Candidate) -> bool {
    let (behind, error) = behind(best, other);
    let more = other.effect.values.len() > best.effect.values.len();
    more && behind > -2.0 && error < 0.25 * best.gain_error()
}

fn name(candidates: &[Candidate], best: usize, p: f64, scans: usize) -> Named {
    let candidate = &candidates[best];
    let set = equivalent(candidates, best);
    let gain_nats = gain(&candidate.gains);
    Named {
        name: candidate.kind(),
        split_by: split_by(&set),
        candidates: set,
        params: numbers(candidate),
        place: candidate.effect.place.iter().map(|stretch| stretch.map(|end| end.to_array())).collect(),
        evidence: Evidence { gain_nats, gain_nats_per_scan: gain_nats.value / scans as f64, p },
        effect: candidate.effect.clone(),
    }
}

/// What would tell effects apart that look alike on this log.
fn split_by(set: &[EffectKind]) -> Option<&'static str> {
    use EffectKind as E;
    let has = |kinds: &[EffectKind]| set.iter().filter(|kind| kinds.contains(kind)).count() >= 2;
    if set.len() < 2 {
        None
    } else if has(&[E::TimeOffset, E::MountOffset, E::MotionSkew]) {
        Some(
            "drive the same stretch forward and in reverse: an error of time changes its sign, a displaced laser doesn't",
        )
    } else if has(&[E::OdomImbalance, E::MountYaw, E::OdomTurnScale]) {
        Some("turn in place both ways, and drive straight: only one of them shows in each")
    } else if has(&[E::RangeBias, E::RangeScale]) {
        Some("take scans over a wider span of ranges: a bias stays, a scale grows")
    } else if has(&[E::RangeBias, E::WarmupDrift]) {
        Some("go on after the sensor has warmed up: a drift dies away, a bias stays")
    } else if has(&[E::IncidenceDropout, E::RangeDropout]) {
        Some("see walls at right angles from far away, and slanted ones from near")
    } else if has(&[E::MissingObject, E::SectorOcclusion]) {
        Some("turn the robot on the spot: what is on the robot turns along")
    } else {
        Some("see the same places again from other sides and distances")
    }
}

fn compare_rivals(candidates: &[Candidate], best: &Candidate, round: usize) -> Vec<Rival> {
    let mut rivals: Vec<Rival> = candidates
        .iter()
        .map(|candidate| {
            let (value, error) = behind(best, candidate);
            Rival {
                round,
                name: candidate.kind(),
                params: numbers(candidate),
                gain_nats: gain(&candidate.gains),
                behind_nats: Estimate { value, lo: value - 1.96 * error, hi: value + 1.96 * error },
            }
        })
        .collect();
    rivals.sort_by(|a, b| b.gain_nats.value.total_cmp(&a.gain_nats.value));
    rivals
}

/// Strengths that reach the threshold with 90 % probability: a score's spread is the square root of its information.
fn detectable(round: &Round<'_>) -> Vec<Detectable> {
    let threshold = round.null.threshold + 1.2816;
    let mut out: Vec<Detectable> = Vec::new();
    for (i, aim) in round.dictionary.aims.iter().enumerate() {
        let Aim::Effect(kind, hint) = aim else { continue };
        if !round.dictionary.is_score(i) || *hint != Hint::None {
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
