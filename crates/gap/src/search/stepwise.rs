//! Stepwise selection: effects are named one at a time, then redundant ones are deleted.

use locsim_core::{Estimate, are_alike};
use locsim_world::effect::{Effect, EffectKind, Moves, Statistic};

use super::lasting::drop_passing;
use super::left_over::{FAINT_SHARE, Gain, is_left, is_left_by};
use super::predicted::drop_unfounded;
use super::selection::{
    adds_up, choose, choose_apart, compare_rivals, dies_away, is_of_few, is_of_odometry, is_one_cause,
    is_sure, may_be_of_robot, name, numbers, sum_of, surely_loses_returns,
};
use super::surroundings::{drop_of_one_place, drop_surroundings};
use super::{FAR_OFF, Round, SOMEWHAT_OFF, State};
use crate::GapError;
use crate::fit::{Candidate, Search};
use crate::outcome::{Named, Rival};
use crate::statistics::Start;

/// The most effects of the first round that are tried alone where several were named: all that a round fits, less the one
/// that was chosen.
const TRIED_ALONE: usize = 9;
/// Replicates that decide whether an effect alone is worth a full round: 19 are the fewest that reject at 5 %.
pub const SCREENING_REPLICATES: u32 = 19;
/// An effect alone explains the log if the p-value with it is above this. At the false-alarm rate of 1 % an effect would do
/// that leaves the log beyond 98 of 100 replicates.
const EXPLAINED: f64 = 0.05;
/// Effects that are fitted where nothing is off any more, to know how much of the gap may be left.
const FITTED_AT_END: usize = 3;
/// Numbers that make the log likelier by this are others (nats).
const LIKELIER_NATS: f64 = 2.0;
/// So many walls don't move alike by chance.
const MANY_WALLS: usize = 3;

fn most_gaining(candidates: &[Candidate]) -> Option<Candidate> {
    candidates.iter().max_by(|a, b| a.gain().total_cmp(&b.gain())).cloned()
}

/// The effect that would gain most on top, if any would.
struct Remaining(Option<Candidate>);

/// The steps from the nominal world to the named effects.
pub struct Path<'a> {
    /// The nominal world first, the one with all effects last.
    pub rounds: Vec<Round<'a>>,
    pub named: Vec<Named>,
    /// The fits of the first round, and the index of the chosen one.
    first_fits: Vec<Candidate>,
    first_choice: usize,
    pub rivals: Vec<Rival>,
    /// The effect that would gain most on top of the last round, once that is known; see [`State::remaining`].
    remaining: Option<Remaining>,
    /// A remark on the choice, for the report.
    pub note: Option<String>,
}

impl<'a> Path<'a> {
    pub fn first(&self) -> &Round<'a> {
        &self.rounds[0]
    }

    pub fn last(&self) -> &Round<'a> {
        &self.rounds[self.rounds.len() - 1]
    }

    /// The round with all names but one, if there was one.
    fn without(&self, index: usize) -> Option<&Round<'a>> {
        let others = self.named.iter().enumerate().filter(|(i, _)| *i != index);
        let kinds: Vec<EffectKind> = others.map(|(_, named)| named.name).collect();
        let mut rounds = self.rounds[1..].iter().rev();
        rounds.find(|round| round.effects.iter().map(|effect| effect.kind).eq(kinds.iter().copied()))
    }

    fn effects(&self) -> Vec<Effect> {
        self.named.iter().map(|named| named.effect.clone()).collect()
    }
}

impl<'a> State<'a> {
    /// Names the effect that gains most, adds it, and tests again, until nothing is off or no effect surely gains.
    pub fn name_effects(&self, first: Round<'a>) -> Result<Path<'a>, GapError> {
        let options = self.options;
        let mut path = Path {
            rounds: vec![first],
            named: Vec::new(),
            first_fits: Vec::new(),
            first_choice: 0,
            rivals: Vec::new(),
            remaining: None,
            note: None,
        };
        loop {
            let round = path.last();
            let off = round.null.p <= options.false_alarm;
            if !off && path.named.is_empty() {
                break;
            }
            let candidates = self.admissible(round, &path.named)?;
            let mut is_by_form = false;
            let accepted = if off && path.named.len() < options.most_effects {
                let likeliest = choose(&candidates);
                let mut accepted = self.weigh(round, &candidates, likeliest)?;
                // Two errors at once are no curve over one covariate, and spread the readings.
                let is_cause = |best: usize| !candidates[best].kind().is_noise();
                if path.named.len() + 1 < options.most_effects && !accepted.is_some_and(is_cause) {
                    accepted = self.first_of_two(round, &candidates)?.or(accepted);
                }
                is_by_form = accepted.is_some() && accepted != likeliest;
                // What the odometry does has its name, whether or not the readings have one, and so have lost returns beside the others.
                let apart = [is_of_odometry, surely_loses_returns];
                for best in apart.into_iter().filter_map(|is_apart| choose_apart(&candidates, is_apart)) {
                    if accepted.is_none() {
                        accepted = self.weigh(round, &candidates, Some(best))?;
                    }
                }
                accepted
            } else {
                None
            };
            let Some(best) = accepted else {
                let rest = most_gaining(&candidates);
                if let Some(most) = rest.as_ref().filter(|_| off) {
                    path.rivals.extend(compare_rivals(&candidates, most, path.rounds.len()));
                }
                path.remaining = Some(Remaining(rest));
                break;
            };
            let chosen = &candidates[best].effect;
            let adds_to = path.named.iter().position(|known| adds_up(&known.effect, chosen));
            if adds_to.is_some() && path.rounds.len() > 2 * options.most_effects {
                // The sum of an effect's fits doesn't settle.
                path.remaining = Some(Remaining(Some(candidates[best].clone())));
                break;
            }
            let (p, nuisances) = (round.null.p, round.fitted.nuisances);
            path.rivals.extend(compare_rivals(&candidates, &candidates[best], path.rounds.len()));
            let mut more = name(&candidates, best, p, self.recorded.scans());
            if is_by_form {
                // What gains as much as its formula was refused: its curve gains more.
                more.leave_alone();
            }
            if path.rounds.len() == 1 {
                (path.first_fits, path.first_choice) = (candidates, best);
            }
            match adds_to {
                Some(known) => {
                    path.named[known].effect = sum_of(&path.named[known].effect, &more.effect)?;
                    path.named[known].add_gains(&more.gains);
                    self.refit(&mut path.named, known, &path.rounds[path.rounds.len() - 1])?;
                }
                None => path.named.push(more),
            }
            let next = self.round(path.effects(), nuisances, options.replicates)?;
            path.rounds.push(next);
        }
        Ok(path)
    }

    /// Fits of a round that may be named beside those that are.
    fn admissible(&self, round: &Round<'a>, named: &[Named]) -> Result<Vec<Candidate>, GapError> {
        let is_off = round.null.p <= self.options.false_alarm;
        let secs = self.recorded.track.secs().last().copied().unwrap_or_default();
        let mut candidates = self.candidates_of(round)?;
        let of_another_form = if is_off { self.of_another_form(round)? } else { Vec::new() };
        candidates.retain(|candidate| {
            may_be_of_robot(candidate)
                && is_of_few(candidate)
                && dies_away(candidate, secs)
                && !named.iter().any(|named| {
                    !adds_up(&named.effect, &candidate.effect)
                        && (is_one_cause(&named.effect, &candidate.effect)
                            || is_left_by(named, &Gain::of(candidate), of_another_form.contains(&named.name)))
                })
        });
        let candidates = drop_of_one_place(round, drop_surroundings(round, candidates)?)?;
        drop_passing(round, drop_unfounded(round, candidates)?)
    }

    /// The effect that would gain most on top of all that is named.
    pub fn remaining(&self, path: &mut Path<'a>) -> Result<Option<Candidate>, GapError> {
        if let Some(Remaining(known)) = path.remaining.take() {
            return Ok(known);
        }
        if path.named.is_empty() {
            return Ok(most_gaining(&path.first_fits));
        }
        Ok(most_gaining(&self.admissible(path.last(), &path.named)?))
    }

    /// Deletes effects that don't surely gain beside the others, or no more than one of these leaves. A later effect may explain what an earlier
    /// one was named for: a strong yaw looks like noise at first, and a wall that has moved like deep clutter.
    pub fn delete(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        // Of poses that were corrected once more an effect is seen as it is.
        let is_corrected = path.last().comparison.recorded.is_corrected();
        let count = path.named.len();
        if count == 0 || count == 1 && !is_corrected {
            return Ok(());
        }
        let before = path.effects();
        let mut i = 0;
        while i < path.named.len() {
            let gains = self.refit(&mut path.named, i, &path.rounds[path.rounds.len() - 1])?;
            if gains && !is_left(&path.named, i) || path.named.len() == 1 {
                i += 1;
            } else {
                // What it gained the others do.
                let explained = path.named.remove(i);
                path.named[0].add_gains(&explained.gains);
            }
        }
        let is_likelier = || -> Result<bool, GapError> {
            let Round { comparison, fitted, .. } = path.last();
            let [old, new] =
                [&before, &path.effects()].map(|effects| comparison.evaluate(effects, fitted, 1));
            Ok(is_corrected && new?.total() > old?.total() + LIKELIER_NATS)
        };
        if path.named.len() < count || is_likelier()? {
            self.compare_again(path)?;
        }
        Ok(())
    }

    /// Makes the numbers of the named effects precise, and drops those whose strength has an interval that holds its neutral value: what
    /// may not be there has no name.
    pub fn make_sure(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        if path.named.is_empty() {
            return Ok(());
        }
        self.make_precise(&mut path.named, &path.rounds[path.rounds.len() - 1])?;
        let count = path.named.len();
        path.named.retain(is_there);
        if path.named.len() < count {
            self.compare_again(path)?;
        }
        if (1..count).contains(&path.named.len()) {
            self.make_precise(&mut path.named, &path.rounds[path.rounds.len() - 1])?;
        }
        Ok(())
    }

    /// A bias of every return and an effect on the mean whose form isn't its formula are one cause, a bias of another course: drops the one that
    /// gains less.
    pub fn join_biases(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        let Some(constant) = path.named.iter().position(|named| named.name.is_constant()) else {
            return Ok(());
        };
        let of_another_form = self.of_another_form(path.last())?;
        let curved = path.named.iter().position(|named| {
            !named.name.is_constant() && named.name.is_bias() && of_another_form.contains(&named.name)
        });
        let Some(curved) = curved else { return Ok(()) };
        let gain = |index: usize| path.named[index].evidence.gain_nats.value;
        path.named.remove(if gain(constant) < gain(curved) { constant } else { curved });
        self.compare_again(path)
    }

    /// Drops moved walls that are many and have all moved alike, to the robot or away from it: readings of a kind of surface are off.
    pub fn join_surfaces(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        let distances: Vec<Estimate> =
            path.named.iter().filter(|named| is_moved_wall(named)).map(distance_of).collect();
        if distances.len() < MANY_WALLS || !are_alike(&distances) {
            return Ok(());
        }
        path.named.retain(|named| !is_moved_wall(named));
        self.compare_again(path)?;
        path.note = Some(format!(
            "{} walls read {:.0} mm too {}, all alike: a kind of surface, rather than walls that have moved.",
            distances.len(),
            1e3 * distances[0].value.abs(),
            if distances[0].value > 0.0 { "long" } else { "short" },
        ));
        Ok(())
    }

    /// Drops noises with which neighbouring beams still err alike: each beam has its noise for itself. Names that gained little beside them go,
    /// too. Walls of a measured map are off for neighbours alike, whatever the noise is.
    pub fn drop_shared(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        let has_noise = self.nominal.pieces.is_none() && path.named.iter().any(|named| named.name.is_noise());
        let is_off = path.last().null.p <= self.options.false_alarm;
        if has_noise && is_off && self.judge(path.last())?.neighbours_err_alike() {
            let gain = |named: &Named| named.evidence.gain_nats.value;
            let noises = path.named.iter().filter(|named| named.name.is_noise());
            // What gained hardly anything beside it stands or falls with it.
            let least = FAINT_SHARE * noises.map(gain).fold(0.0, f64::max);
            path.named.retain(|named| !named.name.is_noise() && gain(named) >= least);
            self.compare_again(path)?;
        }
        Ok(())
    }

    /// Drops names with which simulated ranges move away from the log, or are farther from it than without the last one, which goes first.
    /// Anything that makes readings off the walls likelier raises the log score where something has no name.
    pub fn come_nearer(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        // On an exact map, a formula that gains more than curves of any shape is right, whatever clutter does to the ranges beside it: they
        // are somewhat farther off then, not twice as far.
        let is_surely_right = |path: &Path<'a>| -> Result<bool, GapError> {
            let of_curves: f64 = self.judge(path.first())?.gains().iter().sum();
            let gains_more =
                self.nominal.pieces.is_none() && path.named[0].evidence.gain_nats.value > of_curves;
            Ok(gains_more && !self.doubles(path.first(), path.last())?)
        };
        // Where beams end that a wall lets through to what the map doesn't have, no simulation knows.
        if path.named.iter().any(|named| leads_off_map(path.last(), &named.effect)) {
            return Ok(());
        }
        while let Some(last) = last_of_ranges(&path.named) {
            if last == 0 && is_surely_right(path)? {
                break;
            }
            let without = path.without(last);
            let is_farther = without.map(|without| self.is_farther(without, path.last())).transpose()?;
            if is_farther != Some(true)
                && !self.moves_away(path.first(), path.last(), path.named[last].name)?
            {
                break;
            }
            path.named.remove(last);
            self.compare_again(path)?;
        }
        Ok(())
    }

    /// Compares the log with the world of the effects that are named now.
    fn compare_again(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        path.remaining = None;
        if path.named.is_empty() {
            path.rounds.truncate(1);
            return Ok(());
        }
        let next = self.round(path.effects(), path.last().fitted.nuisances, self.options.replicates)?;
        path.rounds.push(next);
        Ok(())
    }

    /// Fits the effects that a round's statistics point to: where nothing is off any more, the few that may still gain.
    fn candidates_of(&self, round: &Round<'a>) -> Result<Vec<Candidate>, GapError> {
        if round.null.p <= self.options.false_alarm {
            self.candidates(round, self.options.fitted_kinds, FAR_OFF, &self.acting_on_leading(round)?)
        } else {
            self.candidates(round, FITTED_AT_END, SOMEWHAT_OFF, &[])
        }
    }

    /// Prefers one effect that explains the log alone to several, even if those gain more one by one. Deep clutter that stays in
    /// its place looks like many missing objects.
    pub fn simplify(&self, path: &mut Path<'a>) -> Result<(), GapError> {
        if path.named.len() < 2 {
            return Ok(());
        }
        // The first choice alone didn't explain the log.
        let mut alone: Vec<usize> = (0..path.first_fits.len())
            .filter(|&i| i != path.first_choice && is_sure(&path.first_fits[i]))
            .collect();
        alone.sort_by(|&a, &b| path.first_fits[b].gain().total_cmp(&path.first_fits[a].gain()));
        for &i in alone.iter().take(TRIED_ALONE) {
            let (effects, nuisances) =
                (vec![path.first_fits[i].effect.clone()], path.first().fitted.nuisances);
            // Most effects leave the log far off, and few replicates are enough to see that.
            if self.round(effects.clone(), nuisances, SCREENING_REPLICATES)?.null.is_clearly_off() {
                continue;
            }
            let round = self.round(effects, nuisances, self.options.replicates)?;
            if round.null.p <= EXPLAINED {
                continue;
            }
            let mut named = name(&path.first_fits, i, path.first().null.p, self.recorded.scans());
            // Rivals that gain as much don't explain the log alone, or weren't tried.
            (named.candidates, named.split_by) = (vec![named.name], None);
            path.note = Some(format!(
                "{} was named first, but leaves something off; {} alone explains the log.",
                path.first_fits[path.first_choice].kind(),
                named.name,
            ));
            path.rivals = compare_rivals(&path.first_fits, &path.first_fits[i], 1);
            path.named = vec![named];
            path.rounds.truncate(1);
            path.remaining = None;
            path.rounds.push(round);
            break;
        }
        Ok(())
    }

    /// Refits the parameters of one effect, with the others as they are. Returns whether it still surely gains.
    fn refit(&self, named: &mut [Named], index: usize, round: &Round<'a>) -> Result<bool, GapError> {
        let others = named.iter().enumerate().filter(|(i, _)| *i != index);
        let given: Vec<Effect> = others.map(|(_, named)| named.effect.clone()).collect();
        let comparison = round.comparison.in_world(&self.nominal.effects_with(&given)?)?;
        let without = comparison.evaluate(&given, &round.fitted, 1)?;
        let search = Search { comparison: &comparison, given: &given, without: &without, start: &without };
        let effect = &named[index].effect;
        let from = Start { values: effect.values.clone(), place: effect.place.clone() };
        let fit = search.fit(effect.kind, &[from], false)?;
        let gains = fit.as_ref().is_some_and(is_sure);
        if let Some(candidate) = fit {
            let named = &mut named[index];
            named.params = numbers(&candidate);
            // Beside others it gains less.
            if !given.is_empty() {
                named.evidence.gain_nats = Estimate::of_sum(&candidate.gains);
                named.evidence.gain_nats_per_scan =
                    named.evidence.gain_nats.value / self.recorded.scans() as f64;
            }
            named.effect = candidate.effect;
        }
        Ok(gains)
    }
}

fn is_moved_wall(named: &Named) -> bool {
    named.name.description().statistics.iter().any(|statistic| matches!(statistic, Statistic::WallShift))
}

/// Whether an effect lets beams through a wall behind which the map has nothing for most of them.
fn leads_off_map(round: &Round<'_>, effect: &Effect) -> bool {
    let at_wall =
        round.comparison.views.beams.iter().filter(|beam| effect.stretch_at(beam.view.endpoint).is_some());
    let behind = at_wall.map(|beam| if beam.view.behind.is_some() { -1 } else { 1 });
    effect.kind.lets_beams_through() && behind.sum::<i32>() > 0
}

/// How far a wall has moved \[m\].
fn distance_of(wall: &Named) -> Estimate {
    wall.params["distance_m"].estimate
}

/// The last effect that moves ranges. What is in the odometry doesn't.
fn last_of_ranges(named: &[Named]) -> Option<usize> {
    named.iter().rposition(|named| named.name.moves() != Moves::Odometry)
}

/// Whether a strength of an effect surely isn't its neutral value; an effect without numbers or strengths is there, and so is one whose
/// likelihood ends at a limit and says nothing of how sure it is.
fn is_there(named: &Named) -> bool {
    let strengths = named.name.parameters().iter().filter(|parameter| parameter.is_strength());
    let mut intervals = strengths
        .filter_map(|parameter| Some((parameter, named.params.get(parameter.name)?.estimate.interval)))
        .peekable();
    intervals.peek().is_none()
        || intervals.any(|(parameter, interval)| {
            let is_unknown = interval.contains(parameter.lo) && interval.contains(parameter.hi);
            is_unknown || !interval.contains(parameter.neutral)
        })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use glam::DVec2;
    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{HiddenDrive, Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances, fit_persistence};
    use locsim_world::effect::EffectKind;

    use super::*;
    use crate::Recorded;
    use crate::find;
    use crate::outcome::Number;
    use crate::search::GapOptions;

    /// What is in the odometry stays when a name goes with which ranges move away.
    #[test]
    fn the_last_name_that_moves_ranges_is_found_before_those_of_the_odometry() {
        let named = |kind: EffectKind| {
            let candidate = Candidate::of_gain(Effect::typical(kind, Vec::new()), 9.0);
            name(&[candidate], 0, 0.01, 100)
        };
        let [tail, scale] = [EffectKind::HeavyTail, EffectKind::OdomDistanceScale];
        let last =
            |kinds: &[EffectKind]| last_of_ranges(&kinds.iter().map(|&kind| named(kind)).collect::<Vec<_>>());
        assert_eq!((last(&[tail, scale]), last(&[scale, tail])), (Some(0), Some(1)));
        assert_eq!((last(&[scale]), last(&[])), (None, None));
    }

    /// A laser whose bearings are off by up to a degree, as a sine around, errs as far as walls are slanted. Neighbouring beams err alike:
    /// it is no noise.
    #[test]
    fn errors_that_neighbours_share_are_no_noise() {
        let hidden = HiddenDrive::new(&NOMINAL, &TRUTH, &NOMINAL.effects, Regime::default(), 3).unwrap();
        let mut readings = hidden.readings_along(&TRUTH);
        let bearings = hidden.simulator.laser().laser().bearings().to_vec();
        for (pose, readings) in TRUTH.poses().iter().zip(readings.chunks_mut(bearings.len())) {
            let at = pose.compose(&NOMINAL.laser.mount);
            let cast = |bearing: f64| {
                let direction = DVec2::from_angle(at.theta + bearing);
                NOMINAL.map.cast_ray(at.position(), direction, 20.0).map_or(20.0, |hit| hit.range)
            };
            for (reading, bearing) in readings.iter_mut().zip(&bearings) {
                let bearing = f64::from(*bearing);
                let error = cast(bearing + 0.02 * bearing.sin()) - cast(bearing);
                if error.abs() < 0.3 && *reading < NOMINAL.laser.max_range_m as f32 {
                    *reading += error as f32;
                }
            }
        }
        let drive = hidden.drive(&readings, hidden.odometry());
        let recorded = Recorded::new(&drive, 150, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 99, seed: 5, ..GapOptions::default() };
        let outcome = find(&NOMINAL, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
        assert!(
            outcome.effects.iter().all(|named| !named.name.is_noise()) && !outcome.unnamed.is_empty(),
            "{:?} {:?}",
            outcome.effects,
            outcome.unnamed
        );
    }

    /// Noise and a tail were named for a turned laser. The turned laser alone takes their place; where it wasn't among the
    /// first fits, nothing takes it.
    #[test]
    fn one_effect_that_explains_all_takes_the_place_of_several() {
        let yaw = Effect::new(EffectKind::MountYaw, vec![0.02], Vec::new()).unwrap();
        let drive = record_library(&NOMINAL, &TRUTH, &[yaw], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 100, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 39, seed: 5, ..GapOptions::default() };
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let blocks = fit_persistence(&comparison, &[], &fitted, options.seed).unwrap();
        let stop = AtomicBool::new(false);
        let state = State {
            nominal: &NOMINAL,
            recorded: &recorded,
            comparison,
            options: &options,
            progress: &(),
            stop: &stop,
            blocks,
        };
        let first = || state.round(Vec::new(), fitted.nuisances, options.replicates).unwrap();
        let wrong = [EffectKind::IncidenceNoise, EffectKind::HeavyTail];
        let fits = state.candidates(&first(), options.fitted_kinds, FAR_OFF, &wrong).unwrap();
        let at = |kind| fits.iter().position(|fit| fit.kind() == kind).unwrap();
        assert!(
            is_sure(&fits[at(EffectKind::MountYaw)]) && wrong.iter().all(|&kind| is_sure(&fits[at(kind)]))
        );
        let path = |fits: Vec<Candidate>| {
            let at = |kind| fits.iter().position(|fit| fit.kind() == kind).unwrap();
            Path {
                rounds: vec![first()],
                named: wrong.iter().map(|&kind| name(&fits, at(kind), 0.01, recorded.scans())).collect(),
                first_choice: at(wrong[0]),
                first_fits: fits,
                rivals: Vec::new(),
                remaining: None,
                note: None,
            }
        };
        let names = |path: &Path<'_>| path.named.iter().map(|named| named.name).collect::<Vec<_>>();

        // What a deleted name gained is the others': they explain it.
        let mut both = path(fits.clone());
        both.named.push(name(&fits, at(EffectKind::MountYaw), 0.01, recorded.scans()));
        let gained = |path: &Path<'_>| path.named.iter().flat_map(|named| &named.gains).sum::<f64>();
        let before = gained(&both);
        both.rounds.push(state.round(both.effects(), fitted.nuisances, options.replicates).unwrap());
        state.delete(&mut both).unwrap();
        assert!(names(&both).contains(&EffectKind::MountYaw) && both.named.len() < 3, "{:?}", names(&both));
        assert!((gained(&both) - before).abs() < 1e-6 * before.abs());

        let mut with = path(fits.clone());
        state.simplify(&mut with).unwrap();
        assert_eq!(names(&with), [EffectKind::MountYaw]);
        assert!(with.note.is_some() && with.rounds.len() == 2);

        let mut without = path(fits.into_iter().filter(|fit| fit.kind() != EffectKind::MountYaw).collect());
        state.simplify(&mut without).unwrap();
        assert_eq!(names(&without), wrong);
        assert!(without.note.is_none());
    }

    /// A yaw is hidden. A tail of nothing beside it is dropped, whichever comes first.
    #[test]
    fn what_is_named_has_to_be_surely_there() {
        let yaw = Effect::new(EffectKind::MountYaw, vec![0.02], Vec::new()).unwrap();
        let drive = record_library(&NOMINAL, &TRUTH, &[yaw], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 100, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 39, seed: 5, ..GapOptions::default() };
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let blocks = fit_persistence(&comparison, &[], &fitted, options.seed).unwrap();
        let stop = AtomicBool::new(false);
        let (nominal, recorded) = (&NOMINAL, &recorded);
        let state =
            State { nominal, recorded, comparison, options: &options, progress: &(), stop: &stop, blocks };
        let first = state.round(Vec::new(), fitted.nuisances, options.replicates).unwrap();
        let fits = state.candidates(&first, options.fitted_kinds, FAR_OFF, &[]).unwrap();
        let at = fits.iter().position(|fit| fit.kind() == EffectKind::MountYaw).unwrap();
        let yaw = name(&fits, at, 0.01, recorded.scans());
        let mut weak = yaw.clone();
        weak.name = EffectKind::HeavyTail;
        weak.effect = Effect::new(EffectKind::HeavyTail, vec![1e-5], Vec::new()).unwrap();
        let estimate = Estimate::around(1e-5, 1e-3).map(|p| p.max(0.0));
        weak.params = [("p", Number { estimate, unit: "1" })].into();
        assert!(is_there(&yaw) && !is_there(&weak));
        for (named, kept) in [
            (vec![yaw.clone(), weak.clone()], vec![EffectKind::MountYaw]),
            (vec![weak.clone(), yaw], vec![EffectKind::MountYaw]),
            (vec![weak], Vec::new()),
        ] {
            let effects = named.iter().map(|named| named.effect.clone()).collect();
            let round = || state.round(Vec::new(), fitted.nuisances, options.replicates).unwrap();
            let last = state.round(effects, fitted.nuisances, options.replicates).unwrap();
            let mut path = Path {
                rounds: vec![round(), last],
                named,
                first_fits: fits.clone(),
                first_choice: at,
                rivals: Vec::new(),
                remaining: None,
                note: None,
            };
            state.make_sure(&mut path).unwrap();
            assert_eq!(path.named.iter().map(|named| named.name).collect::<Vec<_>>(), kept);
            assert_eq!(path.last().effects.len(), kept.len());
        }
    }
}
