//! How sure the numbers of named effects are, by simulated logs in which those effects are.

use std::sync::Arc;

use distreg::matrix::invert;
use locsim_core::{Estimate, normal};
use locsim_world::effect::{Effect, EffectKind, Fit, Parameter, Role};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{Round, State};
use crate::fit::{PRIORS, log_prior_by_chance};
use crate::hypothesis::Comparison;
use crate::null::REFIT;
use crate::outcome::{Evidence, Named, Number};
use crate::replay::Replay;
use crate::views::Views;
use crate::{GapError, Purpose, Recorded};

/// Simulated logs. The standard deviation over 24 has an error of 15 %, and makes an interval 5 % wider than a known one would.
const LOGS: u32 = 24;
/// An interval that is wider than the fit's own by more than this factor isn't used: the information is nearly singular.
const MOST_WIDENED: f64 = 5.0;

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
            .collect::<Result<Vec<_>, GapError>>()?;
        let all = self.nominal.effects_with(&effects)?;
        let views = round.comparison.views_with(&all)?;
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
            // Where steps are too small for a likelihood that is rough, larger ones.
            let mut shifts = None;
            for factor in [1.0, 3.0, 9.0] {
                let numbers: Vec<(usize, f64)> = numbers
                    .iter()
                    .map(|&(i, step)| (i, (factor * step).min(room(&effects[index], i))))
                    .collect();
                let totals = self.totals(&effects, index, &numbers, &logs, &views, round)?;
                let steps: Vec<f64> = numbers.iter().map(|(_, step)| *step).collect();
                shifts = newton_steps(&totals, &steps);
                if shifts.is_some() {
                    break;
                }
            }
            if let Some(shifts) = shifts {
                for ((i, _), shifts) in numbers.iter().zip(shifts) {
                    let parameter = &kind.parameters()[*i];
                    let fit = named.params[parameter.name];
                    let least = if parameter.is_strength() { normal::QUANTILE_975 * least } else { 0.0 };
                    let mut estimate = corrected(named.effect.values[*i], parameter.neutral, &shifts);
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

    /// Log likelihood of each log, as \[log\]\[variant\]: of the effects themselves, of each number of one of them a step up
    /// and down, and of each two up.
    fn totals(
        &self,
        effects: &[Effect],
        index: usize,
        numbers: &[(usize, f64)],
        logs: &[Recorded],
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
                    Arc::new(views.with(self.nominal, self.recorded, &all)?)
                };
                Ok((all, views, effects.swap_remove(index)))
            })
            .collect::<Result<Vec<_>, GapError>>()?;
        let chance = Purpose::Prior.draw(self.options.seed);
        let of_log = |(number, log): (usize, &Recorded)| {
            let comparison = Comparison { nominal: self.nominal, recorded: log, views: Arc::clone(views) };
            let start = comparison.find_nuisances(&variants[0].0, &round.fitted.nuisances, REFIT);
            let mut chance = chance.item(number as u32);
            let typical: [f64; PRIORS] = std::array::from_fn(|_| StandardNormal.sample(&mut chance));
            let total = |(all, views, effect): &(_, Arc<Views>, Effect)| {
                let likelihood = comparison.evaluate_views(views, all, &start, 1).total();
                likelihood + log_prior_by_chance(effect, &effects[index], typical)
            };
            variants.iter().map(total).collect()
        };
        Ok(logs.par_iter().enumerate().map(of_log).collect())
    }
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

/// How far each number's fit is from the truth in each log, as \[number\]\[log\], by log likelihoods \[log\]\[itself, each number
/// up, down, each two up\]; `None` where they have no maximum there.
fn newton_steps(totals: &[Vec<f64>], steps: &[f64]) -> Option<Vec<Vec<f64>>> {
    let n = steps.len();
    let mean = |of: &dyn Fn(&Vec<f64>) -> f64| totals.iter().map(of).sum::<f64>() / totals.len() as f64;
    let (up, down) = (|i: usize| 1 + 2 * i, |i: usize| 2 + 2 * i);
    let mut information = vec![vec![0.0; n]; n];
    let mut both = 1 + 2 * n;
    for i in 0..n {
        information[i][i] = mean(&|t| 2.0 * t[0] - t[up(i)] - t[down(i)]) / steps[i].powi(2);
        if !(information[i][i] > 0.0 && information[i][i].is_finite()) {
            return None;
        }
        for j in 0..i {
            let mixed = mean(&|t| t[both] - t[up(i)] - t[up(j)] + t[0]) / (steps[i] * steps[j]);
            let most = 0.98 * (information[i][i] * information[j][j]).sqrt();
            information[i][j] = (-mixed).clamp(-most, most);
            information[j][i] = information[i][j];
            both += 1;
        }
    }
    if information.iter().flatten().any(|value| !value.is_finite()) {
        return None;
    }
    let inverse = invert(&information);
    let gradient = |t: &Vec<f64>, i: usize| (t[up(i)] - t[down(i)]) / (2.0 * steps[i]);
    let step = |row: &Vec<f64>, t: &Vec<f64>| {
        row.iter().enumerate().map(|(i, inverse)| inverse * gradient(t, i)).sum::<f64>()
    };
    Some(inverse.iter().map(|row| totals.iter().map(|t| step(row, t)).collect()).collect())
}

/// A fitted value less its bias, with the 95 % interval of its spread. A bias that would take away most of it, or
/// add as much, is beyond what a Newton step can say: then the value stays, and the bias is part of its uncertainty.
fn corrected(value: f64, neutral: f64, shifts: &[f64]) -> Estimate {
    let n = shifts.len() as f64;
    let bias = shifts.iter().sum::<f64>() / n;
    let spread = shifts.iter().map(|shift| (shift - bias).powi(2)).sum::<f64>() / (n - 1.0);
    let quantile = StudentsT::new(0.0, 1.0, n - 1.0).map_or(normal::QUANTILE_975, |t| t.inverse_cdf(0.975));
    let mut variance = spread * (1.0 + 1.0 / n);
    let (away, left) = ((value - neutral).abs(), (value - bias - neutral) * (value - neutral).signum());
    let is_plausible = left > 0.3 * away && left < 1.7 * away;
    let value = if is_plausible {
        value - bias
    } else {
        variance += bias * bias;
        value
    };
    Estimate::around(value, quantile * variance.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a quadratic log likelihood the step leads to the maximum.
    #[test]
    fn a_newton_step_finds_the_maximum_of_a_parabola() {
        let likelihood = |x: f64, y: f64, at: [f64; 2]| {
            let (dx, dy) = (x - at[0], y - at[1]);
            -0.5 * (4.0 * dx * dx + 2.0 * 1.5 * dx * dy + 9.0 * dy * dy)
        };
        let (sx, sy) = (0.1, 0.2);
        let maxima = [[0.3, -0.2], [-0.1, 0.4], [0.05, 0.1]];
        let totals: Vec<Vec<f64>> = maxima
            .iter()
            .map(|&at| {
                [(0.0, 0.0), (sx, 0.0), (-sx, 0.0), (0.0, sy), (0.0, -sy), (sx, sy)]
                    .map(|(x, y)| likelihood(x, y, at))
                    .to_vec()
            })
            .collect();
        let shifts = newton_steps(&totals, &[sx, sy]).unwrap();
        for (log, at) in maxima.iter().enumerate() {
            for axis in 0..2 {
                assert!((shifts[axis][log] - at[axis]).abs() < 1e-9, "{axis} {log}");
            }
        }
        let upside_down: Vec<Vec<f64>> =
            totals.iter().map(|t| t.iter().map(|value| -value).collect()).collect();
        assert!(newton_steps(&upside_down, &[sx, sy]).is_none());
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

    /// Steps of 1, 2, 3 from the truth: a bias of 2 and a spread of 1.
    #[test]
    fn a_bias_is_taken_off() {
        let number = corrected(10.0, 0.0, &[1.0, 2.0, 3.0]);
        assert!((number.value - 8.0).abs() < 1e-12);
        let hi = number.interval.hi;
        assert!((hi - 8.0 - 4.302_653 * (4.0_f64 / 3.0).sqrt()).abs() < 1e-5, "{hi}");
        let doubtful = corrected(2.5, 0.0, &[1.0, 2.0, 3.0]);
        assert!((doubtful.value - 2.5).abs() < 1e-12);
        assert!(doubtful.interval.lo < 0.0 && doubtful.interval.hi > 5.0);
    }
}
