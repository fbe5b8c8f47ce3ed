//! Maximum likelihood fits of an effect's parameters, and their gain on held-out scans.

use argmin::core::{CostFunction, Executor};
use argmin::solver::neldermead::NelderMead;
use distreg::matrix::{invert, quadratic};
use distreg::sandwich::half_widths;
use locsim_comparison::{Comparison, Fitted};
use locsim_core::{Interval, differences, sum_error};
use locsim_world::effect::{Effect, EffectKind, Fit, Moves, Parameter, Prior};

use crate::GapError;
use crate::statistics::Start;

/// The most iterations of the simplex search for each parameter. They bound the time of a fit that doesn't settle.
const ITERATIONS: u64 = 22;
/// The simplex search ends where the simplex agrees to this (nats): a hundredth of what a parameter that isn't needed may gain
/// by chance.
const TOLERANCE_NATS: f64 = 0.02;
/// First corners of the simplex from its start, in first steps: of the strength towards neutral, of other parameters away
/// from it. For a logarithm they are factors of 0.5 and 1.5.
const FIRST_CORNERS: [f64; 2] = [-0.7, 0.4];
/// A fit that gains less on the scans that it was fitted to isn't assessed: an effect that is named gains ten times as much on
/// held-out ones (nats).
const LEAST_GAIN_NATS: f64 = 0.2;
/// A search that has gained this much is repeated from where it ended (nats), so often at the most.
const STRONG_NATS: f64 = 20.0;
const MOST_RESTARTS: usize = 4;
/// Expectation-maximization steps of the nuisance parameters with an effect: they start near their maximum.
const REFIT_STEPS: usize = 12;

/// An effect fitted to a log.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub effect: Effect,
    /// Gain over the hypothesis without it on each fold, with parameters fitted to the other folds (nats).
    pub gains: Vec<f64>,
    /// The same, however much of it counts; see [`Candidate::limit`].
    pub fitted_gains: Vec<f64>,
    /// 95 % interval of each parameter.
    pub intervals: Vec<Interval>,
    /// Whether the effect's own statistics are significant at the search's false-alarm rate.
    pub is_beyond_chance: bool,
    /// Whether most readings are off, and by half as much at the most with the effect.
    pub moves_most: bool,
    /// See [`crate::outcome::Evidence::score`].
    pub score: Option<f64>,
}

impl Candidate {
    /// A fit that gains so much (nats), as much on each of ten folds.
    #[cfg(test)]
    pub fn of_gain(effect: Effect, gain: f64) -> Self {
        let gains = vec![0.1 * gain; 10];
        Self {
            effect,
            fitted_gains: gains.clone(),
            gains,
            intervals: Vec::new(),
            is_beyond_chance: true,
            moves_most: false,
            score: None,
        }
    }

    pub fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }

    /// Counts no more than `most` nats of the gain. A score of z standard deviations is worth about z^2 / 2 nats. A gain far
    /// beyond that is had in replicates without the effect, too: by beams at edges that an error of the reference moves across.
    pub fn limit(&mut self, most: f64) {
        let gain = self.gain();
        if gain > most {
            for fold in &mut self.gains {
                *fold *= most / gain;
            }
        }
    }

    /// Standard error of the gain, over folds.
    pub fn gain_error(&self) -> f64 {
        sum_error(&self.gains)
    }

    pub fn kind(&self) -> EffectKind {
        self.effect.kind
    }
}

/// Fits an effect to a log, on top of others.
pub(crate) struct Search<'c, 'a> {
    pub comparison: &'c Comparison<'a>,
    /// The other effects, which are kept as they are.
    pub given: &'c [Effect],
    /// The log under the other effects.
    pub without: &'c Fitted,
    /// Nuisance parameters and errors of the reference that evaluations with the effect start from.
    pub start: &'c Fitted,
}

impl Search<'_, '_> {
    /// The best fit over several starts; `None` where nothing is gained. With `is_far`, the last start is far from the neutral value.
    pub fn fit(
        &self,
        kind: EffectKind,
        starts: &[Start],
        is_far: bool,
    ) -> Result<Option<Candidate>, GapError> {
        let exact = self.comparison.start_exact(&self.start.nuisances);
        let mut fits =
            starts.iter().map(|start| self.maximize(kind, start)).collect::<Result<Vec<_>, _>>()?;
        if let (Some(exact), true, Some(far)) =
            (&exact, is_far && kind.moves() == Moves::Scans, starts.last())
        {
            // Errors of the reference that were fitted to a laser that is turned far make the right turn look wrong.
            fits.push(Search { start: exact, ..*self }.maximize(kind, far)?);
        }
        // Of fits that are as good the first.
        let best = fits.into_iter().reduce(|best, other| if other.0 > best.0 { other } else { best });
        let Some(best) = best else { return Ok(None) };
        let (value, effect) = self.polish(kind, best)?;
        let gain = value - self.without.total();
        let is_absorbed = match kind.moves() {
            Moves::Scans => true,
            Moves::Readings => exact.is_some(),
            Moves::Walls => exact.is_some() && gain > STRONG_NATS,
            _ => false,
        };
        if !is_absorbed {
            return if gain > LEAST_GAIN_NATS { self.assess(effect).map(Some) } else { Ok(None) };
        }
        // Errors of the reference that were fitted without the effect have absorbed some of it, of a strong one nearly all.
        let refitted = self.refitted(&effect)?;
        let mut settled = Search { start: &refitted, ..*self }.settle(kind, &effect)?;
        if let Some(exact) = exact.filter(|_| gain > STRONG_NATS) {
            let other = Search { start: &exact, ..*self }.settle(kind, &effect)?;
            if other.0 > settled.0 {
                settled = other;
            }
        }
        // Walls of a measured map follow poses, and poses walls: with those that were fitted to it each value is the best one.
        let has_walls = self.comparison.nominal.pieces.is_some();
        if has_walls && kind.moves() == Moves::Scans && settled.0 - self.without.total() > STRONG_NATS {
            let start = Start { values: settled.1.values.clone(), place: settled.1.place.clone() };
            let by_refit =
                |search: &Self, effect: &Effect| Ok(search.with_refit(effect.clone())?.0 + log_prior(effect));
            let (_, effect) = self.maximize_over(kind, &start, kind.parameters().len(), by_refit)?;
            let other = self.with_refit(effect)?;
            if other.1.is_beyond(&settled.1, &other.2.nuisances.pose_error) {
                settled = other;
            }
        }
        let (value, effect, refitted) = settled;
        if value <= self.without.total() + LEAST_GAIN_NATS {
            return Ok(None);
        }
        Search { start: &refitted, ..*self }.assess(effect).map(Some)
    }

    /// The maximum near an effect, with the nuisance parameters fitted to it then and its log likelihood under these.
    fn settle(&self, kind: EffectKind, effect: &Effect) -> Result<(f64, Effect, Fitted), GapError> {
        let start = Start { values: effect.values.clone(), place: effect.place.clone() };
        let (_, effect) = self.maximize(kind, &start)?;
        self.with_refit(effect)
    }

    /// An effect with the nuisance parameters fitted to it, and its log likelihood under these.
    fn with_refit(&self, effect: Effect) -> Result<(f64, Effect, Fitted), GapError> {
        let refitted = self.refitted(&effect)?;
        let value = Search { start: &refitted, ..*self }.evaluate(&effect)?.total();
        Ok((value, effect, refitted))
    }

    /// Searches again from the end of a search, until that gains nothing more: of several parameters a simplex may shrink before it is at
    /// the maximum, and of a strong effect it is far from it then.
    fn polish(
        &self,
        kind: EffectKind,
        (mut value, mut effect): (f64, Effect),
    ) -> Result<(f64, Effect), GapError> {
        if effect.values.len() < 2 || value < self.without.total() + STRONG_NATS {
            return Ok((value, effect));
        }
        for _ in 0..MOST_RESTARTS {
            let start = Start { values: effect.values.clone(), place: effect.place.clone() };
            let (again, better) =
                self.maximize_over(kind, &start, kind.parameters().len(), Self::evaluate_roughly)?;
            let gained = again - value;
            if gained > 0.0 {
                (value, effect) = (again, better);
            }
            if gained < LEAST_GAIN_NATS {
                break;
            }
        }
        Ok((value, effect))
    }

    fn evaluate(&self, effect: &Effect) -> Result<Fitted, GapError> {
        Ok(self.comparison.evaluate(&self.with(effect), self.start, 1)?)
    }

    /// The log likelihood with the prior, as the search uses it: nuisance parameters that the effect doesn't touch aren't refitted.
    fn evaluate_roughly(&self, effect: &Effect) -> Result<f64, GapError> {
        let with_clutter = effect.kind.description().fit == Fit::WithClutter;
        let stay = self.start.nuisances.pose_error.is_none() && !with_clutter;
        let fitted = self.comparison.evaluate(&self.with(effect), self.start, u32::from(!stay) as usize)?;
        Ok(fitted.total() + log_prior(effect))
    }

    fn with(&self, effect: &Effect) -> Vec<Effect> {
        let mut effects = self.given.to_vec();
        effects.push(effect.clone());
        effects
    }

    /// The nuisance parameters fitted with an effect.
    fn refitted(&self, effect: &Effect) -> Result<Fitted, GapError> {
        Ok(self.comparison.refit(&self.with(effect), self.start, REFIT_STEPS)?)
    }

    /// The maximum near a start. Where a shape has a prior, the strength is fitted first: a strength that is far off would
    /// drive the shape to where it makes up for it.
    fn maximize(&self, kind: EffectKind, start: &Start) -> Result<(f64, Effect), GapError> {
        if priors(kind).next().is_none() {
            return self.maximize_over(kind, start, kind.parameters().len(), Self::evaluate_roughly);
        }
        let (_, effect) = self.maximize_over(kind, start, 1, Self::evaluate_roughly)?;
        let start = Start { values: effect.values, place: effect.place };
        self.maximize_over(kind, &start, kind.parameters().len(), Self::evaluate_roughly)
    }

    /// The maximum over the first `count` parameters, the others as they are.
    fn maximize_over(
        &self,
        kind: EffectKind,
        start: &Start,
        count: usize,
        evaluate: fn(&Self, &Effect) -> Result<f64, GapError>,
    ) -> Result<(f64, Effect), GapError> {
        let parameters = kind.parameters();
        let scales: Vec<f64> = parameters
            .iter()
            .take(count)
            .zip(&start.values)
            .map(|(parameter, &value)| parameter.first_step(value))
            .collect();
        let problem = Problem { evaluate: &|effect| evaluate(self, effect), kind, start, scales: &scales };
        let origin = vec![0.0; scales.len()];
        // Effects that exclude each other are refused here: in the solver the error would be lost.
        self.comparison.effects(&self.with(&problem.effect(&origin)?))?;
        if kind.is_stepped() {
            return self.likeliest_multiple(kind, start, evaluate);
        }
        let mut simplex = vec![origin.clone()];
        for axis in 0..origin.len() {
            let mut corner = origin.clone();
            corner[axis] = FIRST_CORNERS[axis.min(1)];
            simplex.push(corner);
        }
        let iterations = ITERATIONS * scales.len() as u64;
        let solver = NelderMead::new(simplex).with_sd_tolerance(TOLERANCE_NATS).map_err(|_| {
            GapError::Option { option: "tolerance", value: TOLERANCE_NATS, allowed: "positive" }
        })?;
        let result =
            Executor::new(&problem, solver).timer(false).configure(|state| state.max_iters(iterations)).run();
        match result {
            Ok(result) => {
                let best = result.state.best_param.unwrap_or(origin);
                Ok((-result.state.best_cost, problem.effect(&best)?))
            }
            // The problem clamps values to their limits, so that it makes no error of its own.
            Err(_) => Ok((f64::NEG_INFINITY, problem.effect(&origin)?)),
        }
    }

    /// The likeliest step among whole multiples of the one to start from: readings in steps lie on the steps' parts as well. There is nothing
    /// between to search.
    fn likeliest_multiple(
        &self,
        kind: EffectKind,
        start: &Start,
        evaluate: fn(&Self, &Effect) -> Result<f64, GapError>,
    ) -> Result<(f64, Effect), GapError> {
        let most = kind.parameters()[0].hi;
        let of_start = start.values[0];
        let multiples = (1..=MOST_MULTIPLE).map(|times| f64::from(times) * of_start);
        let tried = multiples.filter(|&step| step <= most || step == of_start).map(|step| {
            let mut effect = Effect::new(kind, start.values.clone(), start.place.clone())?;
            effect.values[0] = step;
            Ok((evaluate(self, &effect)?, effect))
        });
        let tried = tried.collect::<Result<Vec<_>, GapError>>()?;
        let best = tried.into_iter().max_by(|(a, _), (b, _)| a.total_cmp(b));
        best.ok_or(GapError::Option { option: "step", value: of_start, allowed: "a number" })
    }

    /// The gain of a fit on folds that it wasn't fitted to, and the intervals of its parameters.
    ///
    /// The fit without a fold is approximated by one Newton step from the fit with it. Intervals come from the sandwich of
    /// Godambe (1960) over folds, with Student's distribution, and are no narrower than the curvature alone makes them.
    pub fn assess(&self, effect: Effect) -> Result<Candidate, GapError> {
        let fitted = self.evaluate(&effect)?;
        let folds = self.comparison.recorded.folds;
        let without = folds.sums(&self.without.scans);
        let gains = differences(&folds.sums(&fitted.scans), &without);
        let (gains, intervals) = if effect.kind.is_stepped() {
            (gains, vec![Interval::around(effect.values[0], 0.0)])
        } else {
            let slopes = Slopes::new(self, &effect, fitted.total())?;
            let gradient = slopes.gradient();
            let inverse = invert(&slopes.information()?);
            let held_out = gains.iter().enumerate().map(|(fold, gain)| {
                let of_fold: Vec<f64> = gradient.iter().map(|of_folds| of_folds[fold]).collect();
                gain - quadratic(&inverse, &of_fold).min(gain + MOST_LOST_NATS).max(0.0)
            });
            (held_out.collect(), intervals(&effect, &inverse, &gradient))
        };
        let fitted_gains = gains.clone();
        Ok(Candidate {
            effect,
            gains,
            fitted_gains,
            intervals,
            is_beyond_chance: false,
            moves_most: false,
            score: None,
        })
    }
}

/// Steps up to so many times those that are looked for are tried: 3 and 4 cm by 1 and 2 cm.
const MOST_MULTIPLE: u32 = 5;

/// The most that a fold loses where the fit hasn't seen it, beyond its gain (nats). A Newton step overshoots where a few
/// readings of one fold decide a parameter.
const MOST_LOST_NATS: f64 = 5.0;

/// 95 % intervals of an effect's parameters, by the inverse of their information and the gradient \[parameter\]\[fold\].
fn intervals(effect: &Effect, inverse: &[Vec<f64>], gradient: &[Vec<f64>]) -> Vec<Interval> {
    let parameters = effect.kind.parameters().iter().zip(&effect.values);
    let halves = half_widths(inverse, gradient).into_iter();
    let interval = |((parameter, value), half): ((&Parameter, &f64), f64)| Interval {
        lo: (value - half).max(parameter.lo),
        hi: (value + half).min(parameter.hi),
    };
    parameters.zip(halves).map(interval).collect()
}

/// The log likelihood about a fit, a step up and down in each parameter.
struct Slopes<'s, 'c, 'a> {
    search: &'s Search<'c, 'a>,
    effect: &'s Effect,
    /// Log likelihood of the fit itself (nats).
    total: f64,
    steps: Vec<f64>,
    /// Log likelihood of each fold with a parameter moved, as \[parameter\]\[fold\] (nats).
    up: Vec<Vec<f64>>,
    down: Vec<Vec<f64>>,
}

impl<'s, 'c, 'a> Slopes<'s, 'c, 'a> {
    fn new(search: &'s Search<'c, 'a>, effect: &'s Effect, total: f64) -> Result<Self, GapError> {
        let mut slopes = Self { search, effect, total, steps: Vec::new(), up: Vec::new(), down: Vec::new() };
        for parameter in 0..effect.values.len() {
            let (step, up, down) = slopes.differences(parameter)?;
            slopes.steps.push(step);
            slopes.up.push(up);
            slopes.down.push(down);
        }
        Ok(slopes)
    }

    /// Log likelihood of each fold with some parameters moved, by index.
    fn moved(&self, changes: &[(usize, f64)]) -> Result<Vec<f64>, GapError> {
        let mut other = self.effect.clone();
        for &(i, change) in changes {
            let parameter = &other.kind.parameters()[i];
            other.values[i] = (other.values[i] + change).clamp(parameter.lo, parameter.hi);
        }
        let mut moved = self.search.comparison.recorded.folds.sums(&self.search.evaluate(&other)?.scans);
        // The prior holds for the log as a whole: each fold has its share of it.
        let prior = (log_prior(&other) - log_prior(self.effect)) / moved.len() as f64;
        for fold in &mut moved {
            *fold += prior;
        }
        Ok(moved)
    }

    /// A step of a parameter that changes the log likelihood by about half a nat, with the folds a step up and down. A much
    /// smaller step drowns in rounding, and over a much larger one the likelihood is no parabola.
    fn differences(&self, i: usize) -> Result<(f64, Vec<f64>, Vec<f64>), GapError> {
        /// The change that is aimed at, and the changes that will do (nats): half a nat is a step of one standard error, and
        /// steps of 0.45 to 2.4 standard errors will do.
        const AIM_NATS: f64 = 0.5;
        const GOOD_NATS: std::ops::Range<f64> = 0.1..3.0;
        const TRIALS: usize = 3;
        let (parameter, value) = (&self.effect.kind.parameters()[i], self.effect.values[i]);
        let room = (parameter.hi - value).min(value - parameter.lo);
        let mut step = 0.1 * (value - parameter.neutral).abs().max(0.2 * parameter.start.abs());
        step = step.max(1e-6 * (parameter.hi - parameter.lo));
        let mut bounded = step;
        for _ in 0..TRIALS {
            bounded = if room > 0.0 { step.min(room) } else { step };
            let (up, down) = (self.moved(&[(i, bounded)])?, self.moved(&[(i, -bounded)])?);
            let drop = self.total - 0.5 * (up.iter().sum::<f64>() + down.iter().sum::<f64>());
            if GOOD_NATS.contains(&drop) || drop <= 0.0 {
                return Ok((bounded, up, down));
            }
            step = bounded * (AIM_NATS / drop).sqrt().clamp(0.05, 8.0);
            let is_at_limit = room > 0.0 && bounded >= room && step > room;
            if is_at_limit {
                return Ok((bounded, up, down));
            }
        }
        Ok((bounded, self.moved(&[(i, bounded)])?, self.moved(&[(i, -bounded)])?))
    }

    /// Derivative of each fold's log likelihood by each parameter, as \[parameter\]\[fold\].
    fn gradient(&self) -> Vec<Vec<f64>> {
        let pairs = self.up.iter().zip(&self.down).zip(&self.steps);
        pairs
            .map(|((up, down), step)| up.iter().zip(down).map(|(a, b)| (a - b) / (2.0 * step)).collect())
            .collect()
    }

    /// Minus the second derivatives of the log likelihood by the parameters.
    fn information(&self) -> Result<Vec<Vec<f64>>, GapError> {
        /// The least drop over a step (nats). At a limit or on a plateau the likelihood says nothing of the curvature.
        const LEAST_DROP_NATS: f64 = 0.05;
        /// The largest correlation of two parameters: differences are too rough for a higher one.
        const MOST_CORRELATED: f64 = 0.98;
        let Self { total, steps, .. } = self;
        let sum = |folds: &[f64]| folds.iter().sum::<f64>();
        let numbers = steps.len();
        let mut information = vec![vec![0.0; numbers]; numbers];
        for i in 0..numbers {
            let (up, down) = (sum(&self.up[i]), sum(&self.down[i]));
            let curvature = (2.0 * total - up - down) / steps[i].powi(2);
            information[i][i] = curvature.max(LEAST_DROP_NATS / steps[i].powi(2));
            for j in 0..i {
                let both = sum(&self.moved(&[(i, steps[i]), (j, steps[j])])?);
                let mixed = (both - up - sum(&self.up[j]) + total) / (steps[i] * steps[j]);
                let most = MOST_CORRELATED * (information[i][i] * information[j][j]).sqrt();
                information[i][j] = (-mixed).clamp(-most, most);
                information[j][i] = information[i][j];
            }
        }
        Ok(information)
    }
}

/// The most parameters of an effect that have a prior.
pub(crate) const PRIORS: usize = 2;

/// The parameters of an effect that have a prior, by index.
fn priors(kind: EffectKind) -> impl Iterator<Item = (usize, Prior)> {
    let parameters = kind.parameters().iter().enumerate();
    parameters.filter_map(|(i, parameter)| Some((i, parameter.shape_prior()?)))
}

/// Log density of an effect's shapes about typical values, up to a constant.
fn log_prior(effect: &Effect) -> f64 {
    let parameters = effect.kind.parameters();
    priors(effect.kind)
        .map(|(i, prior)| -0.5 * prior.deviations(effect.values[i], parameters[i].start).powi(2))
        .sum()
}

/// The same about typical values that are drawn: each is as many standard deviations above the shape of `about` as given.
pub(crate) fn log_prior_by_chance(effect: &Effect, about: &Effect, deviations: [f64; PRIORS]) -> f64 {
    priors(effect.kind)
        .zip(deviations)
        .map(|((i, prior), deviations)| {
            -0.5 * (prior.deviations(effect.values[i], about.values[i]) - deviations).powi(2)
        })
        .sum()
}

/// The objective of the simplex search, over changes of the parameters from the start in their first steps.
struct Problem<'s> {
    evaluate: &'s dyn Fn(&Effect) -> Result<f64, GapError>,
    kind: EffectKind,
    start: &'s Start,
    scales: &'s [f64],
}

impl Problem<'_> {
    fn effect(&self, numbers: &[f64]) -> Result<Effect, GapError> {
        let values = self
            .kind
            .parameters()
            .iter()
            .zip(numbers.iter().chain(std::iter::repeat(&0.0)))
            .zip(self.scales.iter().chain(std::iter::repeat(&0.0)))
            .zip(&self.start.values)
            .map(|(((parameter, number), scale), start)| {
                // At 0 the likelihood of a parameter that can't be negative has an edge; its logarithm has none.
                let value = if parameter.lo >= 0.0 {
                    start.max(*scale) * number.exp()
                } else {
                    start + number * scale
                };
                value.clamp(parameter.lo, parameter.hi)
            })
            .collect();
        Ok(Effect::new(self.kind, values, self.start.place.clone())?)
    }
}

impl CostFunction for &Problem<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, numbers: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        let total = (self.evaluate)(&self.effect(numbers)?)?;
        Ok(if total.is_finite() { -total } else { f64::MAX })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dropout(width: f64) -> Effect {
        Effect::new(EffectKind::IncidenceDropout, vec![0.1, 1.2, width], Vec::new()).unwrap()
    }

    /// Half and twice a typical width are as likely. Effects without a shape have no prior.
    #[test]
    fn the_prior_of_a_shape_is_about_its_typical_value() {
        assert!(EffectKind::ALL.iter().all(|&kind| priors(kind).count() <= PRIORS));
        let typical = EffectKind::IncidenceDropout.parameters()[2].start;
        let [at, half, twice] = [1.0, 0.5, 2.0].map(|factor| log_prior(&dropout(factor * typical)));
        assert!(at.abs() < 1e-12 && (half - twice).abs() < 1e-12, "{at} {half} {twice}");
        assert!((half + 0.5 * (2.0_f64.ln() / 0.7).powi(2)).abs() < 1e-12, "{half}");
        let bias = Effect::new(EffectKind::RangeBias, vec![0.5], Vec::new()).unwrap();
        assert!(log_prior(&bias).abs() < 1e-12);
        // About a value that is drawn one standard deviation higher: a factor of e^0.7.
        let about = dropout(0.1);
        let moved = dropout(0.1 * 0.7_f64.exp());
        assert!(log_prior_by_chance(&moved, &about, [0.0, 1.0]).abs() < 1e-12);
        assert!((log_prior_by_chance(&about, &about, [0.0, 1.0]) + 0.5).abs() < 1e-12);
    }
}
