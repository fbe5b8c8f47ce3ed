//! The outcome of a search: verdict, regions, size of the gap.

use std::borrow::Cow;
use std::ops::Range;

use distreg::Floor;
use locsim_comparison::{BlockPolicy, Views};
use locsim_core::{Draw, Estimate, Interval, Stage, differences, sorted};
use locsim_world::effect::{Effect, EffectKind, Moves, Score};
use rand::RngExt;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::calibration::HARDLY_ANY;
use super::judgement::Judgement;
use super::residual::{LOGS, Nameless};
use super::stepwise::Path;
use super::{Round, State};
use crate::fit::Candidate;
use crate::outcome::{Detectable, Detection, Direction, Evidence, Gap, Named, Number, Outcome, Verdict};
use crate::profile::profiles;
use crate::rank::Null;
use crate::regions::{Side, distance, histograms, locate, pits};
use crate::statistics::{Form, Group, Statistic, Target};
use crate::{GapError, Nominal, Purpose, Recorded};

/// Simulated logs behind the 95 % bands of profiles: one of them lies beyond each end.
const PROFILE_LOGS: usize = 40;
/// Step of the bootstrap of the closed share.
const CLOSED_SHARE: u32 = 3;

impl<'a> State<'a> {
    /// The outcome of the steps of a search.
    pub fn outcome(
        &self,
        path: Path<'a>,
        remaining: Option<&Candidate>,
        nameless: Nameless,
    ) -> Result<Outcome, GapError> {
        let State { nominal, recorded, options, .. } = *self;
        let Path { rounds, mut named, rivals, note, .. } = path;
        // Of several, each has the evidence of its gain beside the others, and the one that gains most comes first.
        if let [only] = &mut named[..] {
            only.count_all_gains(recorded.scans());
        }
        most_gaining_first(&mut named);
        let (before, after) = (&rounds[0], &rounds[rounds.len() - 1]);
        let still_off = after.null.p <= options.false_alarm;
        let detectable = detectable(before);
        let blind = detectable.iter().filter(|d| d.value > d.typical).count();
        self.progress.stage("measuring the gap", 1);
        let logs = if named.is_empty() { LOGS } else { PROFILE_LOGS };
        let of_profiles = [self.replay(before, logs)?, self.replay(after, logs)?];
        let profiles = profiles(
            &named,
            &before.comparison,
            &after.comparison,
            of_profiles.each_ref().map(|logs| &**logs),
        );
        let [old, new] = of_profiles.each_ref().map(|logs| &logs[..LOGS]);
        let judged = [self.judge(before)?, self.judge(after)?];
        let gap = self.gap(&rounds, &named, remaining, judged, [old, new]);
        let Nameless { unnamed, curves } = nameless;
        let residual = self.residual_stage(after, &unnamed, curves, new)?;
        let is_ambiguous = named.iter().any(|named| named.candidates.len() > 1);
        // The rest may be due to the form of an effect alone.
        let only_forms = !unnamed.is_empty() && unnamed.iter().all(|found| found.form_of.is_some());
        let is_explained = !still_off || only_forms;
        let verdict = match (named.is_empty(), is_explained) {
            (true, true) if 2 * blind > detectable.len() => Verdict::Underpowered,
            (true, true) => Verdict::None,
            (true, false) if unnamed.is_empty() => Verdict::Unexplained,
            (true, false) => Verdict::Unnamed,
            // No statistic may be off any more, and the simulated ranges still be far from the measured ones.
            (false, explained) if !explained || gap.is_open_in_ranges() => Verdict::PartlyExplained,
            (false, _) if is_ambiguous => Verdict::Ambiguous,
            (false, _) => Verdict::Named,
        };
        let side = [before, after].map(|round| Side { dictionary: &round.dictionary, null: &round.null });
        let regions = locate(&side[0], &side[1], &before.comparison.views, recorded, old);
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
            map: None,
            effects: named,
            unnamed,
            residual,
            detection: detection(&before.null),
            detection_after: detection(&after.null),
            regions,
            gap,
            filter: None,
            rivals,
            detectable,
            directions: directions(before),
            threshold: before.null.thresholds[Group::Wide as usize],
            nuisances: before.fitted.nuisances,
            nuisances_after: after.fitted.nuisances,
            pit,
            profiles,
            notes: notes(nominal, self.blocks).into_iter().chain(note).collect(),
            scans: recorded.scans(),
            beams: recorded.beams(),
            seed: options.seed,
            seconds: 0.0,
            beam_pits,
        })
    }

    /// Names the density of clutter where it surely isn't the scenario's. It is a nuisance parameter of every hypothesis; the
    /// replicates say how far its fit is off by chance.
    pub fn block_density(&self, first: &Round<'a>, last: &Round<'a>) -> Result<Option<Named>, GapError> {
        let found = last.fitted.nuisances.block_density.ln();
        // What a scenario guesses, where a log on a measured map has next to none, is no effect.
        if self.nominal.blocks.is_none() || (self.nominal.pieces.is_some() && found < HARDLY_ANY.ln()) {
            return Ok(None);
        }
        // Who counts what is there counts what stands in the open, too, and how much of what is before walls is of that can't be told.
        if self.nominal.has_things_in_the_open() {
            return Ok(None);
        }
        let logs: Vec<f64> = last.null.nuisances.iter().map(|found| found.block_density.ln()).collect();
        let (comparison, fitted) = (&first.comparison, &first.fitted);
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let error = (logs.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / (logs.len() as f64 - 1.0)).sqrt();
        // The fit's bias by simulated logs of the last round: the first one's are of a world without the effects.
        let simulated = found + last.blocks.density_over_fit.ln();
        let truth = found + simulated - mean;
        // Student's distribution, as mean and spread come from few replicates.
        let n = logs.len() as f64;
        let t = truth / (error * (1.0 + 1.0 / n).sqrt());
        if !t.is_finite() {
            return Ok(None);
        }
        let p = StudentsT::new(0.0, 1.0, n - 1.0).map_or(1.0, |student| 2.0 * student.sf(t.abs()));
        if p > 0.1 * self.options.false_alarm {
            return Ok(None);
        }
        let kind = EffectKind::BlockDensity;
        let parameter = &kind.parameters()[0];
        let effect = Effect::new(kind, vec![truth.exp().clamp(parameter.lo, parameter.hi)], Vec::new())?;
        let mut nominal = fitted.clone();
        nominal.nuisances.block_density = 1.0;
        let without = comparison.evaluate(&[], &nominal, 0)?;
        let folds = self.recorded.folds;
        let gains = differences(&folds.sums(&fitted.scans), &folds.sums(&without.scans));
        let gain_nats = Estimate::of_sum(&gains);
        if gain_nats.interval.lo <= 0.0 {
            return Ok(None);
        }
        let number = Number { estimate: Estimate::normal(truth, error).map(f64::exp), unit: parameter.unit };
        Ok(Some(Named {
            name: kind,
            candidates: vec![kind],
            params: [(parameter.name, number)].into(),
            place: Vec::new(),
            evidence: Evidence {
                gain_nats,
                gain_nats_per_scan: gain_nats.value / self.recorded.scans() as f64,
                score: None,
                p,
            },
            split_by: None,
            effect,
            gains,
        }))
    }

    /// Some simulated logs of a round, [`LOGS`] at least; the first of more are the same.
    fn replay<'r>(&self, round: &'r Round<'a>, logs: usize) -> Result<Cow<'r, [Recorded]>, GapError> {
        let replay = round.replay();
        let draw = Purpose::Distance.draw(self.options.seed);
        let simulated = |range: Range<usize>| -> Result<Vec<Recorded>, GapError> {
            range.into_par_iter().map(|i| Ok(replay.simulate(draw.seed(i as u32))?)).collect()
        };
        let known = if let Some(known) = round.logs.get() {
            known
        } else {
            let first = simulated(0..LOGS)?;
            round.logs.get_or_init(|| first)
        };
        if logs <= LOGS {
            return Ok(Cow::Borrowed(known));
        }
        Ok(Cow::Owned([known.clone(), simulated(LOGS..logs)?].concat()))
    }

    /// Whether simulated ranges are no nearer to the log's in the later round, whose last effect this is, than in the first.
    pub fn moves_away(
        &self,
        first: &Round<'a>,
        last: &Round<'a>,
        kind: EffectKind,
    ) -> Result<bool, GapError> {
        let (old_mm, new_mm, floor) = self.distances(first, last)?;
        // Steps move ranges by half a step at most, to both sides alike.
        if kind.is_stepped() {
            return Ok(floor.is_farther(old_mm, new_mm));
        }
        let is_of_surface = kind.moves() == Moves::Scans
            || kind.scores().any(|score| matches!(score, Score::Location | Score::Scale | Score::Tail));
        Ok(moves_away(&floor, [old_mm, new_mm], self.nominal.pieces.is_some(), is_of_surface))
    }

    /// Whether simulated ranges are farther from the log's in the later round by more than two simulations differ.
    pub fn is_farther(&self, first: &Round<'a>, last: &Round<'a>) -> Result<bool, GapError> {
        let (old_mm, new_mm, floor) = self.distances(first, last)?;
        Ok(floor.is_farther(old_mm, new_mm))
    }

    /// Whether simulated ranges are more than twice as far from the log's in the later round.
    pub fn doubles(&self, first: &Round<'a>, last: &Round<'a>) -> Result<bool, GapError> {
        let (old_mm, new_mm, floor) = self.distances(first, last)?;
        Ok(floor.doubles(old_mm, new_mm))
    }

    /// Distances of simulated ranges from the log's in two rounds \[mm\], and what simulations of the later one differ by.
    fn distances(&self, first: &Round<'a>, last: &Round<'a>) -> Result<(f64, f64, Floor), GapError> {
        let (old, new) = (self.replay(first, LOGS)?, self.replay(last, LOGS)?);
        let views = &first.comparison.views;
        let [old_mm, new_mm] = [&old, &new].map(|logs| distance(views, self.recorded, logs));
        Ok((old_mm, new_mm, floor_of(views, &new)))
    }

    fn gap(
        &self,
        rounds: &[Round<'a>],
        named: &[Named],
        remaining: Option<&Candidate>,
        judged: [&Judgement; 2],
        [old, new]: [&[Recorded]; 2],
    ) -> Gap {
        let (before, after) = (&rounds[0], &rounds[rounds.len() - 1]);
        let total = |values: &[f64]| values.iter().sum::<f64>();
        let scans = self.recorded.scans() as f64;
        let folds = self.recorded.folds.count();
        let gained: Vec<f64> = (0..folds).map(|b| named.iter().map(|named| named.gains[b]).sum()).collect();
        // The free model doesn't know the odometry, of which an effect of the library may say more.
        let [possible, free] = judged.map(Judgement::gains);
        let rest = match remaining {
            Some(candidate) if candidate.gain() > total(&free) => candidate.gains.clone(),
            _ => free,
        };
        let share = |gained: f64, rest: f64| {
            if gained <= 0.0 { 0.0 } else { gained / (gained + rest.max(0.0)) }
        };
        let gained_share = if named.is_empty() {
            Estimate::around(0.0, 0.0)
        } else {
            let draw = Draw::new(self.options.seed, Stage::Bootstrap, CLOSED_SHARE);
            let shares = sorted((0..1000).map(|i| {
                let mut rng = draw.item(i);
                let (mut a, mut b) = (0.0, 0.0);
                for _ in 0..folds {
                    let fold = rng.random_range(0..folds);
                    a += gained[fold];
                    b += rest[fold];
                }
                share(a, b)
            }));
            Estimate {
                value: share(total(&gained), total(&rest)),
                interval: Interval { lo: shares[25], hi: shares[974] },
            }
        };
        let view = &before.comparison.views;
        let typical = &after.null.log_likelihoods;
        let floor = typical.iter().sum::<f64>() / typical.len().max(1) as f64;
        let score = |total: f64, w1_mm: f64| crate::outcome::Distance {
            log_score_nats_per_scan: total / scans,
            w1_mm,
        };
        let range_floor = floor_of(view, new);
        let [old_mm, new_mm] = [old, new].map(|logs| distance(view, self.recorded, logs));
        let is_of_odometry = |effect: &Effect| effect.kind.moves() == Moves::Odometry;
        let in_odometry = !after.effects.is_empty() && after.effects.iter().all(is_of_odometry);
        // What is in the odometry moves no ranges.
        let closed_in_ranges = if in_odometry { None } else { range_floor.closed(old_mm, new_mm) };
        Gap {
            before: score(before.fitted.total(), old_mm),
            after: score(after.fitted.total(), new_mm),
            floor: score(floor, range_floor.mean),
            gained_nats_per_scan: total(&gained) / scans,
            remaining_nats_per_scan: total(&rest).max(0.0) / scans,
            possible_nats_per_scan: total(&possible).max(0.0) / scans,
            gained_share,
            closed: closed(gained_share, closed_in_ranges),
            closed_in_ranges,
            w1_visible_mm: range_floor.visible(),
        }
    }
}

fn most_gaining_first(named: &mut [Named]) {
    named.sort_by(|a, b| b.evidence.gain_nats.value.total_cmp(&a.evidence.gain_nats.value));
}

/// The share of a gap that counts as closed: as much as both the log score and the ranges say. `None` where something is gained that
/// ranges don't show: then they can't say whether the gap has closed.
fn closed(gained: Estimate, in_ranges: Option<f64>) -> Option<Estimate> {
    match in_ranges {
        Some(most) => Some(gained.map(|share| share.min(most.max(0.0)))),
        None => (gained.value <= 0.0).then_some(gained),
    }
}

/// Distances of range errors of simulated logs \[mm\], each from the others.
fn floor_of(views: &Views, logs: &[Recorded]) -> Floor {
    let distances: Vec<f64> = (0..logs.len())
        .into_par_iter()
        .map(|i| {
            let others: Vec<Recorded> = [&logs[..i], &logs[i + 1..]].concat();
            distance(views, &logs[i], &others)
        })
        .collect();
    Floor::of(&distances)
}

/// Whether a name has to go for its distances \[mm\]. On a measured map ranges have to come nearer. An exact map is to be believed for as long
/// as ranges weren't off before, and are hardly more so. A bias, a noise or a tail of a surface's readings changes them by
/// millimetres, and so may a laser that is elsewhere or late, which other errors may hide; readings that are replaced show.
fn moves_away(floor: &Floor, [before, after]: [f64; 2], is_measured: bool, is_of_surface: bool) -> bool {
    let is_strict = is_measured || floor.is_farther(before, after);
    let least_mm = if is_of_surface { floor.error(LOGS) } else { 0.0 };
    let is_off = |closed| if is_strict { closed <= 0.0 } else { closed < 0.0 && after - before > least_mm };
    floor.doubles(before, after) || floor.closed(before, after).is_some_and(is_off)
}

/// Strengths that reach the threshold with 90 % probability: a score's spread is the square root of its information.
fn detectable(round: &Round<'_>) -> Vec<Detectable> {
    let mut out: Vec<Detectable> = Vec::new();
    for (i, statistic) in round.dictionary.statistics.iter().enumerate() {
        let Target::Effect { kind, values } = &statistic.target else { continue };
        if statistic.form != Form::Score || !values.is_empty() || round.null.spread[i] < 1e-3 {
            continue;
        }
        let parameter = &kind.parameters()[0];
        let threshold = round.null.thresholds[statistic.group as usize] + 1.2816;
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
        replicates: null.nuisances.len() as u32,
    }
}

/// The statistic of each effect that says most, with its sign.
fn directions(round: &Round<'_>) -> Vec<Direction> {
    let mut out: Vec<Direction> = Vec::new();
    for kind in round.dictionary.statistics.iter().filter_map(Statistic::effect) {
        if out.iter().all(|known| known.name != kind) {
            out.extend(round.most_telling(kind).map(|i| Direction { name: kind, z: round.null.z[i] }));
        }
    }
    out
}

fn notes(nominal: &Nominal, BlockPolicy { resample, moves, passing, walks }: BlockPolicy) -> Vec<String> {
    let mut notes = vec![
        "A constant yaw of the laser's mount and a constant error of the reference's heading can't be told apart from \
         scans alone."
            .to_owned(),
    ];
    if passing > 0.0 {
        let does = if walks { "walks" } else { "is elsewhere in every scan" };
        let what = if passing < 1.0 {
            format!("About {:.0} % of what the map doesn't know {does}, the rest stands", 100.0 * passing)
        } else {
            format!("What the map doesn't know {does}")
        };
        notes.push(format!("{what}: the simulations that the log is held against have it so."));
    } else if nominal
        .blocks
        .is_some_and(|blocks| resample == blocks.resample && blocks.speed_m_s[1] > 0.0 && !moves)
    {
        notes.push("Unmapped blocks stand, though the scenario has them move.".to_owned());
    } else if let Some(blocks) = nominal.blocks.filter(|blocks| blocks.resample != resample) {
        notes.push(format!(
            "Unmapped blocks take new places otherwise than the scenario says: {resample} instead of {}.",
            blocks.resample
        ));
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::super::selection::name;
    use super::*;

    /// Clutter was named before the wall that gains more.
    #[test]
    fn the_name_that_gains_most_comes_first() {
        let of_gain = |kind, gain| Candidate::of_gain(Effect::typical(kind, Vec::new()), gain);
        let named = |kind, gain| name(&[of_gain(kind, gain)], 0, 0.01, 100);
        let [clutter, tail, scale] =
            [(EffectKind::BlockDepth, 79.0), (EffectKind::HeavyTail, 900.0), (EffectKind::RangeScale, 80.0)]
                .map(|(kind, gain)| named(kind, gain));
        let mut all = [clutter, tail, scale];
        most_gaining_first(&mut all);
        let names = all.map(|named| named.name);
        assert_eq!(names, [EffectKind::HeavyTail, EffectKind::RangeScale, EffectKind::BlockDepth]);
    }

    /// Nine tenths are closed only where ranges came half of the way or more, wherever distances and floor are.
    #[test]
    fn no_gap_counts_as_closed_against_the_ranges() {
        let gained = Estimate { value: 0.98, interval: Interval { lo: 0.95, hi: 1.0 } };
        let mut counted = [0; 3];
        for deviation in [0.1, 4.0, 19.0] {
            let floor = Floor { mean: 45.0, deviation };
            for (before, after) in (0..150).flat_map(|a| (0..150).map(move |b| (f64::from(a), f64::from(b))))
            {
                let is_open = before - after < 0.5 * (before - floor.mean);
                let share = closed(gained, floor.closed(before, after)).map(|closed| closed.value);
                counted[usize::from(share.is_some()) + usize::from(share >= Some(0.9))] += 1;
                assert!(!is_open || share < Some(0.5), "{before} -> {after}, {floor:?}: {share:?}");
            }
        }
        assert!(counted.iter().all(|&count| count > 0), "{counted:?}");
        // 53 -> 71 mm, where simulations differ by 45 and up to 75 mm: ranges can't say.
        let floor = Floor { mean: 45.0, deviation: 10.0 };
        assert_eq!(closed(gained, floor.closed(53.0, 71.0)), None);
        assert_eq!(closed(Estimate::around(0.0, 0.0), None), Some(Estimate::around(0.0, 0.0)));
    }

    /// Simulations that differ by 181 mm give or take 128 aren't as near to a log at 661 mm as others were at 35.
    #[test]
    fn ranges_are_farther_by_more_than_simulations_differ() {
        let bursts = Floor { mean: 181.0, deviation: 128.0 };
        assert!(bursts.is_farther(35.0, 661.0) && !bursts.is_farther(35.0, 400.0));
        assert!(!bursts.is_farther(661.0, 35.0));
    }

    /// Ranges are 12 cm off by people, whatever a noise does.
    #[test]
    fn a_noise_may_be_hidden_in_ranges_and_random_readings_may_not() {
        let floor = Floor { mean: 7.0, deviation: 2.5 };
        let [measured, exact] = [true, false];
        let [of_surface, replaced] = [true, false];
        assert!(!moves_away(&floor, [123.2, 123.4], exact, of_surface));
        assert!(moves_away(&floor, [123.2, 123.4], exact, replaced));
        assert!(moves_away(&floor, [123.2, 123.4], measured, of_surface));
        // By more than the standard error of the two, 1.25 mm.
        assert!(moves_away(&floor, [123.2, 124.6], exact, of_surface));
        for kind in [of_surface, replaced] {
            assert!(
                !moves_away(&floor, [123.2, 60.0], exact, kind)
                    && !moves_away(&floor, [123.2, 60.0], measured, kind)
            );
            assert!(moves_away(&floor, [123.2, 300.0], exact, kind));
            // Bursts of simulations differ by more than any distance is large.
            let bursts = Floor { mean: 286.0, deviation: 240.0 };
            assert!(moves_away(&bursts, [243.0, 735.0], exact, kind));
            assert!(!moves_away(&bursts, [243.0, 480.0], exact, kind));
        }
    }

    #[test]
    fn ranges_count_as_closed_as_far_as_they_came_down_to_their_floor() {
        let floor = Floor { mean: 10.0, deviation: 1.0 };
        assert_eq!(floor.closed(30.0, 15.0), Some(0.75));
        assert_eq!(floor.closed(30.0, 11.0), Some(1.0), "at its floor");
        assert!(floor.closed(13.5, 12.5).is_some_and(|share| share < 0.5), "hardly nearer");
        assert_eq!(floor.closed(30.0, 50.0), Some(-1.0));
        assert_eq!(floor.closed(11.9, 11.0), None, "too little to be seen in ranges");
        assert_eq!(floor.closed(11.9, 30.0), Some(0.0), "away from where it was");
    }
}
