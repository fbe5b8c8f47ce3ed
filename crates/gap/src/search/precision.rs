//! How sure the numbers of named effects are, by simulated logs in which those effects are.

use std::sync::Arc;

use distreg::moments::Moments;
use distreg::newton::newton_steps;
use locsim_comparison::{Comparison, ComparisonError, Fitted, Replay, Views};
use locsim_core::{Estimate, normal};
use locsim_world::effect::{Effect, EffectKind, Fit, Parameter, Role};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use super::{Round, State};
use crate::fit::{PRIORS, log_prior_by_chance};
use crate::null::REFIT;
use crate::outcome::{Evidence, Named, Number};
use crate::{GapError, Purpose, Recorded};

/// Simulated logs. The standard deviation over 24 has an error of 15 %, and makes an interval 5 % wider than a known one would.
const LOGS: u32 = 24;
/// An interval that is wider than the fit's own by more than this factor isn't used: the information is nearly singular.
const MOST_WIDENED: f64 = 5.0;

/// Larger steps are taken where the variance by them is less than this share of that by smaller ones: the likelihood is rough then. Where it is
/// no parabola they differ by less.
const ROUGH_SHARE: f64 = 0.5;

impl<'a> State<'a> {
    /// Takes its bias off each number, and gives it the interval of its spread, by what the fit makes of logs that are
    /// simulated with the effects (parametric bootstrap; a Newton step stands for a fit).
    ///
    /// The density of a reading is composite: beams share blocks, of which it knows nothing. What that does to a number, it does
    /// in simulated logs, too.
    pub fn make_precise(&self, named: &mut [Named], round: &Round<'a>) -> Result<(), GapError> {
        let effects: Vec<Effect> = named.iter().map(|named| named.effect.clone()).collect();
        let replay = Replay { effects: &effects, ..round.replay() };
        let draw = Purpose::Intervals.draw(self.options.seed);
        let logs = (0..LOGS)
            .into_par_iter()
            .map(|i| replay.simulate(draw.seed(i)))
            .collect::<Result<Vec<_>, ComparisonError>>()?;
        let all = self.nominal.effects_with(&effects)?;
        let views = round.comparison.views_with(&all)?;
        // Nuisances beside the effects as they are.
        let starts: Vec<Fitted> = logs
            .par_iter()
            .map(|log| {
                let comparison = Comparison { views: Arc::clone(&views), ..round.comparison.of(log) };
                comparison.find_nuisances(&all, &round.fitted.nuisances, REFIT)
            })
            .collect();
        let simulated: Vec<(&Recorded, &Fitted)> = logs.iter().zip(&starts).collect();
        self.progress.stage("making numbers precise", named.len() as u64);
        for (index, named) in named.iter_mut().enumerate() {
            let kind = effects[index].kind;
            let least = bound(&effects[index], &named.evidence);
            let numbers: Vec<(usize, f64)> = smooth_numbers(kind)
                .filter_map(|i| {
                    let parameter = &kind.parameters()[i];
                    let number = named.params.get(parameter.name)?;
                    let room = room(&effects[index], i);
                    let least = if parameter.is_strength() { least } else { 0.0 };
                    let error = number.estimate.interval.half() / normal::QUANTILE_975;
                    let step = error.max(least).min(room);
                    (step > 0.0).then_some((i, step))
                })
                .collect();
            // Where steps are too small for a likelihood that is rough, larger ones tell more, or tell anything at all.
            let mut shifts = None;
            for factor in [1.0, 3.0, 9.0] {
                if factor == 9.0 && shifts.is_some() {
                    break;
                }
                let larger: Vec<(usize, f64)> = numbers
                    .iter()
                    .map(|&(i, step)| (i, (factor * step).min(room(&effects[index], i))))
                    .collect();
                let totals = self.totals(&effects, index, &larger, &simulated, &views, round)?;
                let steps: Vec<f64> = larger.iter().map(|(_, step)| *step).collect();
                shifts = surer(newton_steps(&totals, &steps), shifts, &numbers);
            }
            if let Some(shifts) = shifts {
                for ((i, _), shifts) in numbers.iter().zip(shifts) {
                    let parameter = &kind.parameters()[*i];
                    let fit = named.params[parameter.name];
                    let least = if parameter.is_strength() { normal::QUANTILE_975 * least } else { 0.0 };
                    let mut estimate =
                        Estimate::less_bias(named.effect.values[*i], parameter.neutral, &shifts);
                    if estimate.interval.half() > MOST_WIDENED * fit.estimate.interval.half().max(least) {
                        // The information is nearly singular, and steps lead anywhere.
                        estimate = fit.estimate;
                    }
                    // No number is surer than by its bound, however steep a rough likelihood is here or there.
                    let half = estimate.interval.half().max(least);
                    let estimate = Estimate::around(estimate.value, half)
                        .map(|value| value.clamp(parameter.lo, parameter.hi));
                    named.effect.values[*i] = estimate.value;
                    named.params.insert(parameter.name, Number { estimate, unit: parameter.unit });
                }
            }
            self.progress.advance(1);
        }
        Ok(())
    }

    /// Log likelihood of each log, from its nuisances on, as \[log\]\[variant\]: of the effects themselves, of each number of one of them a step
    /// up and down, and of each two up.
    fn totals(
        &self,
        effects: &[Effect],
        index: usize,
        numbers: &[(usize, f64)],
        logs: &[(&Recorded, &Fitted)],
        views: &Arc<Views>,
        round: &Round<'a>,
    ) -> Result<Vec<Vec<f64>>, GapError> {
        let mut changes: Vec<Vec<(usize, f64)>> = vec![Vec::new()];
        for &(i, step) in numbers {
            changes.extend([vec![(i, step)], vec![(i, -step)]]);
        }
        for (n, &a) in numbers.iter().enumerate() {
            changes.extend(numbers[..n].iter().map(|&b| vec![a, b]));
        }
        let variants = changes
            .iter()
            .map(|changes| {
                let mut effects = effects.to_vec();
                let Effect { kind, values, .. } = &mut effects[index];
                for &(i, change) in changes {
                    // A step to the edge may be rounded beyond it.
                    let parameter = &kind.parameters()[i];
                    values[i] = (values[i] + change).clamp(parameter.lo, parameter.hi);
                }
                let all = self.nominal.effects_with(&effects)?;
                let views = if views.are_of(&all) {
                    Arc::clone(views)
                } else {
                    Arc::new(views.with(self.nominal, &round.comparison.recorded, &all)?)
                };
                Ok((all, views, effects.swap_remove(index)))
            })
            .collect::<Result<Vec<_>, ComparisonError>>()?;
        let chance = Purpose::Prior.draw(self.options.seed);
        let of_log = |(number, &(log, start)): (usize, &(&Recorded, &Fitted))| {
            let comparison = Comparison { views: Arc::clone(views), ..round.comparison.of(log) };
            let mut chance = chance.item(number as u32);
            let typical: [f64; PRIORS] = std::array::from_fn(|_| StandardNormal.sample(&mut chance));
            let total = |(all, views, effect): &(_, Arc<Views>, Effect)| {
                let likelihood = comparison.evaluate_views(views, all, start, 1).total();
                likelihood + log_prior_by_chance(effect, &effects[index], typical)
            };
            variants.iter().map(total).collect()
        };
        Ok(logs.par_iter().enumerate().map(of_log).collect())
    }
}

/// The shifts of numbers by larger steps than before, if they are that much surer, and otherwise those before.
fn surer(
    larger: Option<Vec<Vec<f64>>>,
    before: Option<Vec<Vec<f64>>>,
    numbers: &[(usize, f64)],
) -> Option<Vec<Vec<f64>>> {
    let variance = |shifts: &Vec<Vec<f64>>| spread(shifts, numbers);
    let known = before.as_ref().map(variance);
    larger.filter(|larger| known.is_none_or(|known| variance(larger) < ROUGH_SHARE * known)).or(before)
}

/// Variance of the shifts of numbers by logs, \[number\]\[log\], in squares of the numbers' steps.
fn spread(shifts: &[Vec<f64>], numbers: &[(usize, f64)]) -> f64 {
    let of_number = |(shifts, (_, step)): (&Vec<f64>, &(usize, f64))| {
        Moments::of(shifts.iter().copied()).variance() / step.powi(2)
    };
    shifts.iter().zip(numbers).map(of_number).sum()
}

/// How far a number of an effect can go either way.
fn room(effect: &Effect, number: usize) -> f64 {
    let (parameter, value) = (&effect.kind.parameters()[number], effect.values[number]);
    (parameter.hi - value).min(value - parameter.lo)
}

/// The parameters of an effect in which the likelihood is smooth, by index: none of a nuisance parameter, which is fitted
/// elsewhere.
fn smooth_numbers(kind: EffectKind) -> impl Iterator<Item = usize> {
    let is_smooth = |parameter: &Parameter| matches!(parameter.role, Role::Strength | Role::Shape(_));
    let is_effect = kind.description().fit != Fit::Nuisance;
    let parameters = kind.parameters().iter().enumerate();
    parameters.filter(move |(_, parameter)| is_effect && is_smooth(parameter)).map(|(i, _)| i)
}

/// About the bound of Cramer and Rao on the error of an effect's strength: by what it gains, half its information, or by its
/// score among simulated logs, the root of it, which beams that come over edges don't raise as they raise the gain. Over
/// less, those beams make the likelihood rough.
fn bound(effect: &Effect, evidence: &Evidence) -> f64 {
    let by_gain = 2.0 * evidence.gain_nats.value;
    let information = evidence.score.map_or(by_gain, |score| by_gain.min(score * score));
    let away = |i: usize| effect.values[i] - effect.kind.parameters()[i].neutral;
    let away = effect.kind.strengths().map(|i| away(i).powi(2)).sum::<f64>().sqrt();
    away / information.max(4.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parabolas with a maximum at 0, on which beams that come over edges put up to 0.3 nats here and there. By a step over which the parabola
    /// falls by as much the maximum is anywhere, by three times that step it is near 0.
    #[test]
    fn larger_steps_tell_more_where_a_likelihood_is_rough() {
        let numbers = [(0, 0.1)];
        let by = |step: f64, roughness: f64| {
            let rough =
                |log: i32, at: i32| roughness * f64::from((log * 37 + at * 61).rem_euclid(101)) / 101.0;
            let total =
                |log: i32, at: i32| -30.0 * (f64::from(at) * step - 0.002 * f64::from(log % 7)).powi(2);
            let totals: Vec<Vec<f64>> =
                (0..24).map(|log| [0, 1, -1].map(|at| total(log, at) + rough(log, at)).to_vec()).collect();
            newton_steps(&totals, &[step])
        };
        let of = |roughness: f64| [0.3, 0.1].map(|step| by(step, roughness));
        let [larger, smaller] = of(0.3);
        assert_eq!(surer(larger.clone(), smaller, &numbers), larger);
        let [larger, smaller] = of(0.001);
        assert_eq!(surer(larger.clone(), smaller.clone(), &numbers), smaller);
        assert_eq!(surer(larger.clone(), None, &numbers), larger);
        assert_eq!(surer(None, smaller.clone(), &numbers), smaller);
    }

    /// A bias of 2 cm that gains 50 nats, or has a score of 10 standard deviations, is known to 2 mm; a gain that is larger
    /// than the score allows counts for no more.
    #[test]
    fn the_bound_is_that_of_the_gain_or_of_the_score() {
        let bias = Effect::new(EffectKind::RangeBias, vec![0.02], Vec::new()).unwrap();
        let by = |gain: f64, score| {
            let gain_nats = Estimate::around(gain, 0.0);
            bound(&bias, &Evidence { gain_nats, gain_nats_per_scan: 0.0, score, p: 0.01 })
        };
        assert!((by(50.0, None) - 0.002).abs() < 1e-12);
        assert!((by(800.0, Some(10.0)) - 0.002).abs() < 1e-12);
        assert!((by(50.0, Some(40.0)) - 0.002).abs() < 1e-12);
        assert!((by(0.0, Some(0.0)) - 0.01).abs() < 1e-12);
    }
}
