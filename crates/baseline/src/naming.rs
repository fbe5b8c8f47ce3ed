//! The names of what changed: the effect that gains most, and what gains beside it.

use std::collections::BTreeMap;

use glam::DVec2;
use locsim_core::{Estimate, sum_error};
use locsim_gap::{Evidence, GapError, Named};
use locsim_world::effect::{Bursts, Effect, EffectKind, Experiment, Moves};
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::Changes;
use super::assignment::Assignment;
use super::everywhere::{CELL_M, ReadingGain, only_place};
use super::fitting::{Fit, Known, Search};
use super::given::{Given, is_near, is_of_place};
use super::increments::{Contrast, is_of_odometry};
use super::neighbours::is_noise;
use super::null::{Best, Null, Score, add};
use super::places;
use super::pool::Expected;
use super::precision::Precise;
use super::random_readings::are_behind_as_well;
use super::trials::{Trial, trials, usual};

/// Kinds of effect that are fitted in a round: those whose best trial gains most.
const FITTED_KINDS: usize = 5;
/// False alarms that effects at one place may make, as a share of those of all others: they come on top.
pub(super) const SHARE_OF_PLACES: f64 = 0.2;

/// What is tried beside nothing, and how it scores.
pub(super) struct Round {
    pub tried: Vec<Trial>,
    pub own: Best,
    pub places: BTreeMap<EffectKind, places::Best>,
    /// Distance of the range errors of stretches of both logs, the median \[mm\].
    pub floor: f64,
    /// Whether neighbouring beams surely differ by more today; `None` where they can't tell.
    pub is_noisier: Option<bool>,
}

/// What comes next: the name of a fit, or noise of every beam, by the effect that is nearest to it.
enum Next {
    Name(usize, Box<Precise>),
    Noise(Effect),
}

/// What is named already, and what a further effect is held against.
struct Beside<'a> {
    named: &'a [Named],
    given: &'a Given,
    expected: &'a [Expected],
    /// Log densities of the readings without and with the given effects.
    logs: &'a [Vec<f64>; 2],
}

impl Search<'_> {
    /// Names the effect that gains most, adds it, and looks again.
    pub fn name(
        &self,
        first: &Round,
        odometry: &[Effect],
        null: &Null,
        assignment: &Assignment,
        known: &Known,
        changes: &mut Changes,
    ) -> Result<Vec<Named>, GapError> {
        let Round { tried, own, places, .. } = first;
        let mut named: Vec<Named> = Vec::new();
        let mut given = Given::none();
        let mut expected = usual(self.pool);
        let effect_of = |tried: &[Trial], index: usize| {
            tried
                .get(index)
                .map_or_else(|| odometry[index - tried.len()].clone(), |trial| trial.effect.clone())
        };
        let starts =
            |tried: &[Trial], best: &Best, is_rare: &dyn Fn(EffectKind, &Score) -> bool| -> Vec<Effect> {
                let mut kinds: Vec<(f64, usize)> = best
                    .iter()
                    .filter(|(kind, score)| is_rare(**kind, score))
                    .map(|(_, score)| (score.gain, score.index))
                    .collect();
                kinds.sort_by(|a, b| b.0.total_cmp(&a.0));
                kinds.into_iter().take(FITTED_KINDS).map(|(_, index)| effect_of(tried, index)).collect()
            };
        // That something of these data changed is known in the first round; later on, each kind might be there by chance.
        let chance = self.options.false_alarm;
        let stand_out = || places.values().filter(|best| best.p <= SHARE_OF_PLACES * chance);
        let at_place = || stand_out().map(|best| best.place.effect.clone());
        let mut next = starts(tried, own, &|kind, score| {
            null.p_beside(kind, own) <= chance && null.weight(kind, score) > -chance.ln()
        });
        next.extend(at_place());
        let mut scores = own.clone();
        while !next.is_empty() && named.len() < self.options.most_effects {
            self.progress.stage("fitting effects", next.len() as u64);
            let logs = self.log_densities(known, &expected);
            let mut fits = next
                .into_par_iter()
                .map(|effect| {
                    let fit = self.fit(effect, &given, &expected, &logs, assignment, known);
                    self.progress.advance(1);
                    fit
                })
                .collect::<Result<Vec<Fit>, _>>()?;
            let beside = Beside { named: &named, given: &given, expected: &expected, logs: &logs };
            let sure = self.surest(&mut fits, &beside, first, assignment, known, changes)?;
            let effect = match sure {
                None => break,
                Some(Next::Noise(effect)) => effect,
                Some(Next::Name(best, precise)) => {
                    let effect = precise.effect.clone();
                    let z = scores.get(&effect.kind).map(|score| null.z(effect.kind, score));
                    let z_of_place = || places.get(&effect.kind).map_or(0.0, |best| best.z);
                    let evidence = [z.unwrap_or_else(z_of_place), changes.p];
                    let scans = self.pool.logs[1].recorded.scans();
                    named.push(name(&fits, best, *precise, assignment, evidence, scans));
                    effect
                }
            };
            given = Given::of(self.pool, given.effects.into_iter().chain([effect]).collect());
            if named.len() == self.options.most_effects {
                break;
            }
            expected = self.expected_with(&given.effects)?;
            // Beside effects of readings each place would be cast anew: those that stood out in the first round are fitted again.
            let without: Vec<EffectKind> = EffectKind::ALL
                .into_iter()
                .filter(|kind| is_of_place(*kind) || self.options.without.contains(kind))
                .collect();
            let on_laser = given.of_these(|effect| !is_of_odometry(effect.kind));
            let more = trials(self.pool, &on_laser, &expected, &without);
            // The rest of a named effect is its form.
            let is_new =
                |kind: EffectKind| given.effects.iter().all(|known| known.kind != kind || !kind.adds_up());
            let mut best =
                self.best_beside(&given, &expected, [&more, tried], odometry, assignment, known)?;
            best.retain(|kind, _| is_new(*kind));
            next = starts(&more, &best, &|kind, score| {
                null.weight(kind, score) > null.least_weight(kind, chance).max(-chance.ln())
            });
            next.extend(at_place().filter(|effect| is_new(effect.kind)));
            scores = best;
        }
        self.drop_farther(&mut named, assignment, known, first.floor)?;
        // Gains of readings and of the odometry don't compare. What stands out more among permutations is told first.
        let of_places = stand_out().map(|best| -(best.p / SHARE_OF_PLACES).ln()).fold(0.0, f64::max);
        let rarity = |named: &Named| {
            let most = null.most_beside(named.name, own);
            if is_of_odometry(named.name) { most } else { most.max(of_places) }
        };
        named.sort_by(|a, b| rarity(b).total_cmp(&rarity(a)));
        Ok(named)
    }

    /// Drops names without which ranges are nearer, beside all others; the one that puts them farthest off goes first. An effect that was named
    /// before what has really changed took some of that for its own.
    fn drop_farther(
        &self,
        named: &mut Vec<Named>,
        assignment: &Assignment,
        known: &Known,
        floor: f64,
    ) -> Result<(), GapError> {
        let distance = |named: &[&Named]| -> Result<f64, GapError> {
            let effects: Vec<Effect> = named.iter().map(|named| named.effect.clone()).collect();
            Ok(self.distance(&known.learnt, &self.expected_with(&effects)?, assignment))
        };
        loop {
            let all = distance(&named.iter().collect::<Vec<_>>())?;
            let mut without = vec![None; named.len()];
            for index in (0..named.len()).filter(|&i| !is_of_odometry(named[i].name)) {
                let others = named.iter().enumerate().filter(|(i, _)| *i != index);
                without[index] = Some(distance(&others.map(|(_, named)| named).collect::<Vec<_>>())?);
            }
            let Some(index) = farthest(all, &without, floor) else { return Ok(()) };
            named.remove(index);
        }
    }

    /// The fit that is named next, with its numbers; fits that aren't to be named are left out on the way.
    fn surest(
        &self,
        fits: &mut Vec<Fit>,
        beside: &Beside<'_>,
        first: &Round,
        assignment: &Assignment,
        known: &Known,
        changes: &mut Changes,
    ) -> Result<Option<Next>, GapError> {
        let Beside { named, given, expected, logs } = *beside;
        let errors = errors_by_chance(assignment, self.options.false_alarm);
        // That something changed is known for the first name. A further one has to say so itself.
        let is_known = named.is_empty() && changes.noise_of_every_beam_m.is_none();
        let is_noise_known = given.effects.iter().any(|given| is_noise(given.kind));
        // Errors of the references move scans as a displaced laser does, by less than stretches of the logs differ. What puts such ranges farther off is
        // no bias either.
        let differs_less = |floor: f64| self.distance(&known.learnt, expected, assignment) <= floor;
        while let Some(best) = choose(fits, assignment, errors, is_known) {
            let effect = &fits[best].effect;
            if is_noise(effect.kind)
                && !is_noise_known
                && first.is_noisier == Some(true)
                && self.neighbours.are_all_noisier(effect.kind, assignment)
            {
                changes.noise_of_every_beam_m = Some(self.neighbours.noise(assignment));
                return Ok(Some(Next::Noise(effect.clone())));
            }
            if let Some(at) = self.only_place(effect, given, expected, &logs[1], assignment, known)? {
                fits.remove(best);
                let [lower, upper] = [-0.5, 0.5].map(|side| at + side * CELL_M);
                changes.place.get_or_insert([lower.x, lower.y, upper.x, upper.y]);
                for place in first.places.values().map(|best| &best.place).filter(|place| place.is_at(at)) {
                    if fits.iter().all(|fit| fit.effect.kind != place.effect.kind) {
                        let effect = place.effect.clone();
                        fits.push(self.fit(effect, given, expected, logs, assignment, known)?);
                    }
                }
                continue;
            }
            let is_further = !is_known && !is_of_odometry(effect.kind);
            let is_no_name = is_left_over(&fits[best], named)
                || is_noise(effect.kind)
                    && (first.is_noisier == Some(false) || changes.noise_of_every_beam_m.is_some())
                || is_of_named_wall(effect, given)
                || effect.kind.displaces_laser() && differs_less(first.floor)
                || effect.kind.is_of_random_readings() && {
                    let lasting = self.lasting(effect, given, expected, logs, assignment, known)?;
                    !are_behind_as_well(self.pool, effect, lasting.as_ref())
                }
                || is_bias(effect.kind)
                    && differs_less(first.floor)
                    && self.is_farther_off(effect, beside, assignment, known, 0.0)?
                || is_further
                    && self.is_farther_off(effect, beside, assignment, known, FARTHER * first.floor)?;
            if !is_no_name {
                let precise = self.precise(effect, given, expected, assignment, known)?;
                if precise.is_known {
                    return Ok(Some(Next::Name(best, Box::new(precise))));
                }
            }
            fits.remove(best);
        }
        Ok(None)
    }

    /// Whether an effect puts ranges farther off by more than a distance \[mm\], beside what is named.
    fn is_farther_off(
        &self,
        effect: &Effect,
        Beside { given, expected, .. }: &Beside<'_>,
        assignment: &Assignment,
        known: &Known,
        by_mm: f64,
    ) -> Result<bool, GapError> {
        let all: Vec<Effect> = given.effects.iter().cloned().chain([effect.clone()]).collect();
        let with = self.distance(&known.learnt, &self.expected_with(&all)?, assignment);
        Ok(with > self.distance(&known.learnt, expected, assignment) + by_mm)
    }

    /// The place where an effect of all beams gains, if it loses elsewhere.
    fn only_place(
        &self,
        effect: &Effect,
        given: &Given,
        expected: &[Expected],
        log: &[f64],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<Option<DVec2>, GapError> {
        let bursts = effect.bursts();
        let are_seldom = bursts.as_ref().is_some_and(Bursts::are_seldom);
        if is_of_place(effect.kind) || is_of_odometry(effect.kind) || are_seldom {
            return Ok(None);
        }
        let effect = bursts.map_or_else(|| effect.clone(), |bursts| bursts.spread);
        let on_laser = given.of_these(|effect| !is_of_odometry(effect.kind));
        let trial = Trial::new(self.pool, &on_laser, effect, expected, None)?;
        let gains = trial.reading_gains(self.pool, &known.learnt, log, &assignment.is_today);
        let of_reading = |(index, gain): (u32, f64)| {
            let reading = &self.pool.readings[index as usize];
            let beam = &self.pool.logs[reading.log].views.beams[reading.index];
            ReadingGain { stretch: reading.stretch as usize, end: beam.view.endpoint, gain }
        };
        Ok(only_place(&gains.map(of_reading).collect::<Vec<_>>()))
    }

    /// The best trial of each kind beside the given effects; `plain` are the trials beside nothing.
    fn best_beside(
        &self,
        given: &Given,
        expected: &[Expected],
        [tried, plain]: [&[Trial]; 2],
        odometry: &[Effect],
        assignment: &Assignment,
        known: &Known,
    ) -> Result<Best, GapError> {
        let logs = self.log_densities(known, expected);
        let mut best = Best::new();
        let is_known = given.effects.iter().any(|given| is_noise(given.kind));
        let noise = if is_known { None } else { self.neighbours.contrast(assignment) };
        for (index, trial) in tried.iter().enumerate() {
            let Some(plain) = plain.iter().find(|plain| plain.effect == trial.effect) else { continue };
            let usual = plain.gains(self.pool, &known.learnt, &logs[0], &assignment.is_baseline);
            let gains = trial.gains(self.pool, &known.learnt, &logs[1], &assignment.is_today);
            let gain = assignment.net(&gains, &usual).iter().sum();
            let both: Vec<f64> = gains.iter().zip(usual).map(|(today, baseline)| today + baseline).collect();
            let noise = noise.filter(|_| is_noise(trial.effect.kind));
            let contrast = noise.unwrap_or_else(|| assignment.contrast(&both));
            add(&mut best, trial.effect.kind, Score { gain, contrast, index });
        }
        for (index, effect) in odometry.iter().enumerate() {
            let change = self.change(effect.clone(), given, expected)?;
            let gain: f64 = self.net(&change, &logs, assignment, known).iter().sum();
            let contrast = self.increments.contrast(&known.usual, &given.effects, effect.kind, assignment);
            add(&mut best, effect.kind, score_of_odometry(&contrast, gain, tried.len() + index));
        }
        Ok(best)
    }
}

/// The score of a trial of the odometry whose net gain is that of stretches taken for independent (nats).
pub(super) fn score_of_odometry(contrast: &Contrast, gain: f64, index: usize) -> Score {
    Score { gain: gain / contrast.inflation, contrast: contrast.errors, index }
}

/// A further name may put ranges farther off by this share of what stretches differ by.
const FARTHER: f64 = 0.25;

/// Or by this share of what they are off without it.
const FARTHER_SHARE: f64 = 0.1;

/// Of several names the one without which ranges are nearest, by index, where they are nearer by more than a part of the floor or of what they
/// are off. Distances are those with all names, and without each of them; `None` of one that moves no ranges. A single name stays: a disc
/// puts ranges farther off than the box that it stands for, and so do bursts that come at other times.
fn farthest(all: f64, without: &[Option<f64>], floor: f64) -> Option<usize> {
    let known = without.iter().enumerate().filter_map(|(index, without)| Some((index, (*without)?)));
    let nearest = known.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let least = (FARTHER * floor).min(FARTHER_SHARE * nearest.1);
    (without.len() > 1 && all - nearest.1 > least).then_some(nearest.0)
}

/// What is left of an effect in a form that isn't quite its own gains up to this share of it: the square of an error of a seventh.
const LEFT_OVER: f64 = 0.02;

/// Whether a fit gains no more than what the named effects leave over. Readings and odometry are different data.
fn is_left_over(fit: &Fit, named: &[Named]) -> bool {
    let alike = named.iter().filter(|named| is_of_odometry(named.name) == is_of_odometry(fit.effect.kind));
    let most = alike.map(|named| named.evidence.gain_nats.value).fold(0.0, f64::max);
    fit.gain() < LEFT_OVER * most
}

/// Whether an effect is about a stretch of wall that is named for something else.
fn is_of_named_wall(effect: &Effect, given: &Given) -> bool {
    let middles = || effect.place.iter().map(|[a, b]| 0.5 * (*a + *b));
    let walls = given.effects.iter().filter(|given| given.kind.has_place());
    walls.into_iter().any(|wall| middles().any(|middle| is_near(wall, middle)))
}

/// The standard errors that a gain on today's stretches exceeds with this chance where there is none.
fn errors_by_chance(assignment: &Assignment, chance: f64) -> f64 {
    let stretches = assignment.is_today.iter().filter(|is| **is).count() as f64;
    StudentsT::new(0.0, 1.0, (stretches - 1.0).max(1.0)).map_or(1.0, |t| t.inverse_cdf(1.0 - chance))
}

/// The fit that is named: the one that is worth most, and gains by so many standard errors; one with fewer parameters within a standard
/// error. What acts at one place, in bursts or on the odometry gains on few stretches, and needs one standard error, as does what may explain
/// a change that is known. Noise doesn't: a reference that errs by more looks like it.
fn choose(fits: &[Fit], assignment: &Assignment, errors: f64, is_known: bool) -> Option<usize> {
    let of_today = |fit: &Fit| assignment.of_today(&fit.gains);
    let comes_and_goes = |effect: &Effect| {
        is_of_place(effect.kind) || is_of_odometry(effect.kind) || effect.bursts().is_some()
    };
    let is_as_map_errors = |kind: EffectKind| kind.description().is_as_map_errors;
    let errors = |fit: &Fit| match fit.effect.kind {
        _ if comes_and_goes(&fit.effect) => 1.0,
        kind if is_known && !is_as_map_errors(kind) => 1.0,
        _ => errors,
    };
    let is_sure = |fit: &Fit| fit.worth() > 0.0 && fit.gain() - errors(fit) * sum_error(&of_today(fit)) > 0.0;
    let most = (0..fits.len())
        .filter(|&i| is_sure(&fits[i]))
        .max_by(|&a, &b| fits[a].worth().total_cmp(&fits[b].worth()))?;
    let count = |i: usize| fits[i].effect.values.len();
    let simpler =
        (0..fits.len()).filter(|&i| i != most && is_sure(&fits[i]) && count(i) < count(most)).filter(|&i| {
            let behind: Vec<f64> =
                of_today(&fits[most]).iter().zip(of_today(&fits[i])).map(|(a, b)| a - b).collect();
            behind.iter().sum::<f64>() < sum_error(&behind)
        });
    let gain = |i: usize| fits[i].gain();
    simpler.max_by(|&a, &b| gain(a).total_cmp(&gain(b))).or(Some(most))
}

/// A rival that is behind by fewer standard errors can't be told from the best: the one-sided 90 % quantile.
const BEHIND_ERRORS: f64 = 1.3;

fn name(
    fits: &[Fit],
    best: usize,
    Precise { effect, numbers, .. }: Precise,
    assignment: &Assignment,
    [z, p]: [f64; 2],
    scans: usize,
) -> Named {
    let fit = &fits[best];
    let of_today = |fit: &Fit| assignment.of_today(&fit.gains);
    let own = of_today(fit);
    let is_rival = |other: &&Fit| {
        let behind: Vec<f64> = own.iter().zip(of_today(other)).map(|(a, b)| a - b).collect();
        // Readings and odometry are different data: what explains one is no rival of what explains the other.
        other.effect.kind != fit.effect.kind
            && is_of_odometry(other.effect.kind) == is_of_odometry(fit.effect.kind)
            && other.gain() - 1.645 * sum_error(&of_today(other)) > 0.0
            && behind.iter().sum::<f64>() < BEHIND_ERRORS * sum_error(&behind)
    };
    let mut candidates = vec![fit.effect.kind];
    candidates.extend(fits.iter().filter(is_rival).map(|other| other.effect.kind));
    let gain_nats = Estimate::normal(fit.gain(), sum_error(&own));
    Named {
        name: fit.effect.kind,
        split_by: Experiment::telling_apart(&candidates),
        candidates,
        params: numbers,
        place: effect.place.iter().map(|stretch| stretch.map(|end| end.to_array())).collect(),
        evidence: Evidence {
            gain_nats,
            gain_nats_per_scan: gain_nats.value / scans as f64,
            score: Some(z),
            p,
        },
        effect,
        gains: own,
    }
}

/// Whether a kind moves the mean of all readings.
fn is_bias(kind: EffectKind) -> bool {
    kind.moves() == Moves::Readings
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bias that gains on half of today's stretches, as where one drive passes what the other didn't, is a name if something has to
    /// explain the change, and none beside a name that does. Noise is none.
    #[test]
    fn a_further_name_has_to_gain_on_all_of_the_drive() {
        let assignment = Assignment {
            is_baseline: [[true; 16], [false; 16]].concat(),
            is_today: [[false; 16], [true; 16]].concat(),
        };
        let gains = |today: [f64; 16]| [[0.0; 16], today].concat();
        let here_and_there = [
            93.0, 170.0, 99.0, 24.0, 34.0, 97.0, 201.0, -9.0, -35.0, -39.0, -4.0, -31.0, 23.0, -11.0, -14.0,
            7.0,
        ];
        let fit = |kind, gains| Fit { effect: Effect::typical(kind, Vec::new()), gains };
        let noise = [fit(EffectKind::IncidenceNoise, gains(here_and_there))];
        let errors = errors_by_chance(&assignment, 0.01);
        assert!((errors - 2.602).abs() < 1e-3, "{errors}");
        let bias = [fit(EffectKind::RangeBias, gains(here_and_there))];
        assert_eq!(choose(&bias, &assignment, errors, true), Some(0));
        assert_eq!(choose(&bias, &assignment, errors, false), None);
        assert_eq!(choose(&noise, &assignment, errors, true), None);
        let lasting = [fit(EffectKind::IncidenceNoise, gains([10.0, 30.0].repeat(8).try_into().unwrap()))];
        assert_eq!(choose(&lasting, &assignment, errors, false), Some(0));
        // Wheels slip here and there.
        let slip = [fit(EffectKind::WheelSlip, gains(here_and_there))];
        assert_eq!(choose(&slip, &assignment, errors, false), Some(0));
    }

    /// After a name of 1000 nats: 15 nats of the same data are what its form leaves, 25 aren't, and the odometry is other data.
    #[test]
    fn a_fiftieth_of_a_name_is_left_over_by_its_form() {
        let fit = |kind, gain| Fit { effect: Effect::typical(kind, Vec::new()), gains: vec![0.0, gain] };
        let assignment = Assignment { is_baseline: vec![true, false], is_today: vec![false, true] };
        let bias = fit(EffectKind::RangeBias, 1000.0);
        let precise = Precise { effect: bias.effect.clone(), numbers: BTreeMap::new(), is_known: true };
        let named = [name(&[bias], 0, precise, &assignment, [5.0, 0.01], 100)];
        assert!(is_left_over(&fit(EffectKind::MixedPixels, 15.0), &named));
        assert!(!is_left_over(&fit(EffectKind::MixedPixels, 25.0), &named));
        assert!(!is_left_over(&fit(EffectKind::OdomImbalance, 15.0), &named));
        assert!(!is_left_over(&fit(EffectKind::MixedPixels, 15.0), &[]));
    }

    /// Random readings put ranges 7 mm farther off beside an object that takes 6 mm away.
    #[test]
    fn a_name_without_which_ranges_are_nearer_goes() {
        assert_eq!(farthest(17.0, &[Some(10.0), Some(23.0)], 5.1), Some(0));
        assert_eq!(
            farthest(17.0, &[None, Some(16.0)], 5.1),
            None,
            "by less than a quarter of the floor and a tenth"
        );
        assert_eq!(farthest(34.1, &[None, Some(29.3)], 26.6), Some(1));
        assert_eq!(farthest(34.1, &[Some(9.3)], 26.6), None, "alone");
        assert_eq!(farthest(17.0, &[None], 5.1), None);
    }

    #[test]
    fn a_wall_has_one_name() {
        let at = |kind, x: f64| {
            let wall = vec![[DVec2::new(x, 0.0), DVec2::new(x + 1.0, 0.0)]];
            Effect::typical(kind, wall)
        };
        let mut given = Given::none();
        given.effects.push(at(EffectKind::MovedWall, 2.0));
        assert!(is_of_named_wall(&at(EffectKind::Glass, 2.5), &given));
        assert!(!is_of_named_wall(&at(EffectKind::Glass, 5.0), &given));
        let object = Effect::new(EffectKind::MissingObject, vec![2.5, 0.0, 0.2], Vec::new()).unwrap();
        assert!(
            !is_of_named_wall(&object, &given)
                && !is_of_named_wall(&at(EffectKind::Glass, 2.5), &Given::none())
        );
    }
}
