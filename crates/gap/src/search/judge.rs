//! The free model as the judge of a round.

use locsim_world::effect::{self, Effect, EffectKind, Moves};
use rayon::prelude::*;

use super::judgement::{Dependence, Judgement, acts_on};
use super::selection::{is_of_odometry, is_sure, is_tail};
use super::unnamed::fit_wave;
use super::{Round, State};
use crate::fit::Candidate;
use crate::free_model::{Axis, Covariates, FreeModel, Part, lag, misaligned_frame};
use crate::null::REFIT;
use crate::statistics::{Covariate, Deviation, Statistic, Survey, pit_draw};
use crate::{GapError, Purpose};

/// Simulated logs of the hypothesis that the free model is learnt from as well. What it gains there is the simulator's own: beams
/// share clutter and the error of the reference, which the hypothesis for single readings doesn't know.
const LOGS: u32 = 4;

/// An effect that gains this share of what the best curve gains is named, and the curve is of what it leaves: a strong bias that differs
/// from beam to beam is a bias first.
const NEARLY_ALL: f64 = 0.9;
/// An effect whose formula gains at least this share of what the free curve over its own covariate gains is the right name in
/// another form. An effect that gains less is another effect.
const RIGHT_NAME_SHARE: f64 = 0.5;
/// The same of an effect at a wall, where the curve is farthest off at this very wall: one that has turned about its end gains a quarter
/// or less where it is taken for one that has moved, the less the farther its other end is off.
const RIGHT_WALL_SHARE: f64 = 0.15;

/// Losses or noise that differ from scan to scan by so much, as a share of what the best curve gains, aren't those of a beam's range or
/// incidence, nor a tail.
const COMES_AND_GOES_SHARE: f64 = 0.1;
/// A curve of so many waves isn't an effect of the library in another form.
const COMES_AND_GOES: f64 = 3.0;

impl<'a> State<'a> {
    /// The free model on top of a round's hypothesis, which is learnt once.
    pub fn judge<'r>(&self, round: &'r Round<'a>) -> Result<&'r Judgement, GapError> {
        if let Some(judgement) = round.judgement.get() {
            return Ok(judgement);
        }
        let judgement = self.learn(round)?;
        Ok(round.judgement.get_or_init(|| judgement))
    }

    fn learn(&self, round: &Round<'a>) -> Result<Judgement, GapError> {
        let effects = round.comparison.effects(&round.effects)?;
        let covariates = Covariates::new(&round.comparison);
        let replay = round.replay();
        let draw = Purpose::FreeModel.draw(self.options.seed);
        let own = pit_draw(self.options.seed);
        let model =
            FreeModel::new(&round.comparison, &effects, &round.fitted, &covariates, &own, Part::Whole);
        let frame =
            misaligned_frame(&round.comparison, &effects, &round.fitted)?.filter(|frame| frame.gain() > 0.0);
        let least = round.null.weight_at(self.options.false_alarm);
        // A frame that replicates don't have is none of those that gain in simulated logs by chance.
        let may_be_chance = frame.as_ref().is_some_and(|frame| {
            let is_own = |of: &Statistic| of.cell().is_some_and(|cell| cell.deviation == frame.deviation);
            let own = round.dictionary.statistics.iter().position(is_own);
            own.is_none_or(|own| round.null.weight[own] <= least)
        });
        let misalignments =
            [lag(&round.comparison, &effects, &round.fitted)].into_iter().chain(frame).collect();
        let simulated = (0..LOGS)
            .into_par_iter()
            .map(|i| {
                let seed = draw.seed(i);
                let log = replay.simulate(seed)?;
                let comparison = round.comparison.of(&log);
                let fitted = comparison.find_nuisances(&effects, &round.fitted.nuisances, REFIT);
                let own = pit_draw(seed);
                let model = FreeModel::new(&comparison, &effects, &fitted, &covariates, &own, Part::Whole);
                let frame =
                    if may_be_chance { misaligned_frame(&comparison, &effects, &fitted)? } else { None };
                let misalignments = [lag(&comparison, &effects, &fitted)].into_iter().chain(frame).collect();
                Ok((model, misalignments))
            })
            .collect::<Result<_, GapError>>()?;
        Ok(Judgement { model, covariates, misalignments, simulated })
    }

    /// Effects that act on what the free model gains most by, and where that is noise those that move scans as a whole. They are fitted, however
    /// little their formulas say: a range scale that grows with the square looks like noise first, and so does a late stamp.
    pub fn acting_on_leading(&self, round: &Round<'a>) -> Result<Vec<EffectKind>, GapError> {
        let judgement = self.judge(round)?;
        let dependences = judgement.dependences();
        let Some(leading) = dependences.first() else { return Ok(Vec::new()) };
        let survey = Survey::new(&round.comparison);
        // Of few readings behind one wall no statistic is far off, however sure they are.
        let acts = |kind: &EffectKind| {
            let effect = Effect::typical(*kind, Vec::new());
            dependences.iter().any(|left| left.deviation == Deviation::Long) && kind.lets_beams_through()
                || !kind.has_place() && acts_on(&effect, leading, &judgement.covariates, &survey)
                || leading.deviation == Deviation::Spread && kind.moves() == Moves::Scans
        };
        Ok(EffectKind::ALL.into_iter().filter(acts).collect())
    }

    /// Effects of a round whose form is off: something still depends on what they act on.
    pub fn of_another_form(&self, round: &Round<'a>) -> Result<Vec<EffectKind>, GapError> {
        let judgement = self.judge(round)?;
        let dependences = judgement.dependences();
        let survey = Survey::new(&round.comparison);
        let is_off = |effect: &&Effect| {
            dependences.iter().any(|left| acts_on(effect, left, &judgement.covariates, &survey))
        };
        Ok(round.effects.iter().filter(is_off).map(|effect| effect.kind).collect())
    }

    /// The effect that is named, by index, where a free curve has its say: a formula that is surely behind the best curve is no
    /// explanation. Where the curve is over what an effect acts on, that effect is the right name in another form.
    pub fn weigh(
        &self,
        round: &Round<'a>,
        candidates: &[Candidate],
        accepted: Option<usize>,
    ) -> Result<Option<usize>, GapError> {
        let judgement = self.judge(round)?;
        let dependences = judgement.dependences();
        // Whether returns get lost says nothing of the errors of those that don't, nor do readings of the odometry: each is judged by its own.
        let mut rivals = dependences.iter().filter(|rival| match accepted.map(|best| &candidates[best]) {
            Some(best) if is_of_odometry(best) => rival.covariate == Covariate::Odometry,
            // In a frame that is off, beams end elsewhere.
            Some(best) if best.kind().loses_returns() => {
                rival.deviation == Deviation::NoReturn || rival.deviation.is_of_frame()
            }
            Some(_) => rival.covariate != Covariate::Odometry,
            None => true,
        });
        let Some(leading) = rivals.next() else { return Ok(accepted) };
        let survey = Survey::new(&round.comparison);
        let is_right = |effect: &Effect| acts_on(effect, leading, &judgement.covariates, &survey);
        // A tail is noise of every beam as well. One that gains less than a factor on the noise is no tail.
        let is_noise = (leading.deviation, leading.covariate) == (Deviation::Spread, Covariate::Everywhere);
        let is_no_tail = |of: &Candidate| is_noise && is_tail(of) && leading.beats(of);
        let is_enough = |best: usize| {
            let candidate = &candidates[best];
            let gain: f64 = candidate.fitted_gains.iter().sum();
            // A frame that is turned turns the headings as a turned laser does, and the positions with them.
            let mut statistics = candidate.kind().description().statistics.iter();
            let is_of_frame = statistics.any(|statistic| matches!(statistic, effect::Statistic::Turn))
                && dependences
                    .iter()
                    .any(|other| other.deviation == Deviation::FrameTurn && other.beats(candidate));
            // A mean that isn't quite right spreads readings.
            let is_left = candidate.kind().moves() == Moves::Distribution
                && leading.deviation == Deviation::Mean
                && round.effects.iter().any(is_right)
                && !leading.is_beaten_by(candidate);
            !is_of_frame
                && !is_left
                && !is_no_tail(candidate)
                && !comes_and_goes(candidate.kind(), &dependences, leading.gain())
                && (gain >= NEARLY_ALL * leading.gain() || !leading.beats(candidate))
        };
        if accepted.is_some_and(is_enough) {
            return Ok(accepted);
        }
        if round.effects.iter().any(is_right) {
            return Ok(None);
        }
        let is_any_form = may_have_any_form(leading, &judgement.covariates.axes);
        let right = (0..candidates.len()).filter(|&i| {
            let candidate = &candidates[i];
            let least = match candidate.kind().has_place() {
                true => RIGHT_WALL_SHARE,
                false if is_any_form => 0.0,
                false => RIGHT_NAME_SHARE,
            };
            is_sure(candidate)
                && !is_no_tail(candidate)
                && candidate.fitted_gains.iter().sum::<f64>() >= least * leading.gain()
                && is_right(&candidate.effect)
        });
        Ok(right.max_by(|&a, &b| candidates[a].gain().total_cmp(&candidates[b].gain())))
    }
}

/// Whether an effect loses returns or spreads readings, and losses or noise differ from scan to scan too much for it, where the best curve
/// gains `most` (nats).
fn comes_and_goes(kind: EffectKind, dependences: &[Dependence<'_>], most: f64) -> bool {
    let of_scans = |covariate| {
        let own = dependences.iter().filter(move |found| found.covariate == covariate);
        own.map(Dependence::gain).any(|gain| gain > COMES_AND_GOES_SHARE * most)
    };
    kind.loses_returns() && of_scans(Covariate::Losses) || kind.is_noise() && of_scans(Covariate::Scan)
}

/// Whether a curve is an effect of the library in any form. Errors and noise over range or incidence, and whatever happens at edges, have
/// one name each, whatever their course. What comes and goes over range is something else, as is a loss of the nearest returns. Over time
/// and bearing there are many causes.
fn may_have_any_form(dependence: &Dependence<'_>, axes: &[Axis]) -> bool {
    match dependence.covariate {
        Covariate::Jump => dependence.deviation != Deviation::NoReturn,
        Covariate::Range | Covariate::Incidence => {
            matches!(dependence.deviation, Deviation::Mean | Deviation::Spread)
                && dependence.component.is_some_and(|component| {
                    fit_wave(&axes[component.axis], &component.curve)
                        .is_none_or(|wave| wave.count < COMES_AND_GOES)
                })
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::free_model::Component;

    /// Losses over range gain 400 nats. Those over the scan's other beams gain 48 beside it, or 32.
    #[test]
    fn losses_and_noise_come_and_go_where_a_tenth_of_the_gain_is_by_scans() {
        let of = |covariate, gain: f64| Dependence {
            deviation: Deviation::NoReturn,
            covariate,
            gains: vec![gain; 4],
            component: None,
            misalignment: None,
        };
        let refused = |kind, covariate, gain| {
            comes_and_goes(kind, &[of(Covariate::Range, 100.0), of(covariate, gain)], 400.0)
        };
        let losses = EffectKind::IncidenceDropout;
        assert!(refused(losses, Covariate::Losses, 12.0) && !refused(losses, Covariate::Losses, 8.0));
        assert!(!refused(losses, Covariate::Place, 90.0));
        assert!(!refused(EffectKind::RangeBias, Covariate::Losses, 90.0));
        // So with noise: a tail is of every scan.
        let tail = EffectKind::HeavyTail;
        assert!(refused(tail, Covariate::Scan, 12.0) && !refused(tail, Covariate::Scan, 8.0));
        assert!(
            !refused(tail, Covariate::Losses, 90.0) && !refused(EffectKind::RangeBias, Covariate::Scan, 90.0)
        );
    }

    #[test]
    fn one_name_in_any_form_is_for_trends_over_range_and_incidence_and_for_edges() {
        let levels: Vec<f64> = (0..24).map(|i| 0.25 * f64::from(i)).collect();
        let may = |moment, covariate, course: fn(f64) -> f64| {
            let curve = levels.iter().map(|&x| Some([course(x), 0.001])).collect();
            let component = Component { moment, covariate, axis: 0, curve, gains: vec![10.0; 4] };
            let (deviation, gains) = (moment, component.gains.clone());
            let dependence =
                Dependence { deviation, covariate, gains, component: Some(&component), misalignment: None };
            may_have_any_form(&dependence, &[Axis::of_levels(covariate, levels.clone())])
        };
        let square: fn(f64) -> f64 = |x| 0.002 * x * x;
        let ripple: fn(f64) -> f64 = |x| 0.01 * (TAU * x / 1.5).sin();
        for covariate in [Covariate::Range, Covariate::Incidence] {
            assert!(may(Deviation::Mean, covariate, square) && may(Deviation::Spread, covariate, square));
            assert!(!may(Deviation::Mean, covariate, ripple) && !may(Deviation::NoReturn, covariate, square));
        }
        for covariate in [Covariate::Time, Covariate::Bearing, Covariate::Place] {
            assert!(!may(Deviation::Mean, covariate, square));
        }
        assert!(
            may(Deviation::Short, Covariate::Jump, square)
                && !may(Deviation::NoReturn, Covariate::Jump, square)
        );
    }
}
