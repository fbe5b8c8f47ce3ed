//! Maximum likelihood of an effect's numbers, and what it gains on scans that the fit hasn't seen.

use argmin::core::{CostFunction, Executor};
use argmin::solver::neldermead::NelderMead;
use glam::DVec2;
use locsim_world::effect::{Effect, EffectKind, Fit, Moves, Parameter, Prior, Role};
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::GapError;
use crate::hypothesis::{Comparison, Fitted};
use crate::statistics::BLOCK;

/// Steps of the simplex search for each number.
const STEPS_PER_NUMBER: u64 = 22;
/// The search ends where the simplex agrees to so many nats.
const TOLERANCE_NATS: f64 = 0.02;

/// An effect fitted to a log.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub effect: Effect,
    /// Gain over the hypothesis without it, block by block, of numbers fitted to the other blocks (nats).
    pub gains: Vec<f64>,
    /// 95 % interval of each number.
    pub intervals: Vec<[f64; 2]>,
    /// Whether simulated logs say that the log is off in the effect's own direction, whatever else is looked at.
    pub is_beyond_chance: bool,
    /// See [`crate::outcome::Evidence::score`].
    pub score: Option<f64>,
}

impl Candidate {
    pub fn gain(&self) -> f64 {
        self.gains.iter().sum()
    }

    /// Counts no more than `most` nats of the gain. A score of z standard deviations of simulated logs is worth about z^2 / 2
    /// nats; what is gained far beyond that, simulated logs without the effect gain too, as beams at edges do that an
    /// error of the reference moves across.
    pub fn limit(&mut self, most: f64) {
        let gain = self.gain();
        if gain > most {
            for block in &mut self.gains {
                *block *= most / gain;
            }
        }
    }

    /// Standard error of the gain, over blocks.
    pub fn gain_error(&self) -> f64 {
        sum_error(&self.gains)
    }

    pub fn kind(&self) -> EffectKind {
        self.effect.kind
    }
}

/// Standard error of a sum over blocks.
pub(crate) fn sum_error(blocks: &[f64]) -> f64 {
    let n = blocks.len() as f64;
    let mean = blocks.iter().sum::<f64>() / n;
    (n / (n - 1.0) * blocks.iter().map(|b| (b - mean).powi(2)).sum::<f64>()).sqrt()
}

/// Sums over blocks of consecutive scans.
pub(crate) fn blocks(scans: &[f64]) -> Vec<f64> {
    let mut blocks: Vec<f64> = scans.chunks(BLOCK).map(|block| block.iter().sum()).collect();
    // A last block of few scans goes with the one before.
    if !scans.len().is_multiple_of(BLOCK) && blocks.len() > 1 {
        let last = blocks.pop().unwrap_or(0.0);
        if let Some(previous) = blocks.last_mut() {
            *previous += last;
        }
    }
    blocks
}

/// Where a search starts.
#[derive(Clone, Debug)]
pub(crate) struct Start {
    pub values: Vec<f64>,
    pub place: Vec<[DVec2; 2]>,
}

/// An effect on top of others, for a log.
pub(crate) struct Search<'c, 'a> {
    pub comparison: &'c Comparison<'a>,
    /// Effects that stay as they are.
    pub given: &'c [Effect],
    /// The log under those.
    pub without: &'c Fitted,
    /// Where evaluations with the effect begin: nuisances and errors of the reference.
    pub start: &'c Fitted,
}

impl Search<'_, '_> {
    /// The best fit over several starts; `None` where nothing is gained.
    pub fn fit(&self, kind: EffectKind, starts: &[Start]) -> Result<Option<Candidate>, GapError> {
        let errs = !self.start.nuisances.pose_error.is_none();
        let mut best: Option<(f64, Effect)> = None;
        for start in starts {
            let (value, effect) = self.maximize(kind, start)?;
            if best.as_ref().is_none_or(|(known, _)| value > *known) {
                best = Some((value, effect));
            }
        }
        match best {
            Some((_, effect)) if kind.moves() == Moves::Scans || kind.moves() == Moves::Readings && errs => {
                // Errors of the reference that were fitted without the effect have taken some of it in.
                let refitted = self.refitted(&effect)?;
                let anew = Search { start: &refitted, ..*self };
                let start = Start { values: effect.values.clone(), place: effect.place.clone() };
                let (_, effect) = anew.maximize(kind, &start)?;
                let refitted = anew.refitted(&effect)?;
                let anew = Search { start: &refitted, ..*self };
                let gains = anew.evaluate(&effect)?.total() > self.without.total() + 0.2;
                Ok(if gains { Some(anew.assess(effect)?) } else { None })
            }
            Some((value, effect)) if value > self.without.total() + 0.2 => Ok(Some(self.assess(effect)?)),
            _ => Ok(None),
        }
    }

    fn evaluate(&self, effect: &Effect) -> Result<Fitted, GapError> {
        self.comparison.evaluate(&self.with(effect), self.start, 1)
    }

    /// The likelihood while searching: nuisance parameters that an effect has nothing to do with stay where they are.
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

    /// The nuisances fitted with this effect.
    fn refitted(&self, effect: &Effect) -> Result<Fitted, GapError> {
        self.comparison.refit(&self.with(effect), self.start, 12)
    }

    /// The most likely numbers near a start: of a shape that isn't known well the strength first, or a strength that is far
    /// off drives the shape to where it makes up for it.
    fn maximize(&self, kind: EffectKind, start: &Start) -> Result<(f64, Effect), GapError> {
        if priors(kind).next().is_none() {
            return self.maximize_over(kind, start, kind.parameters().len());
        }
        let (_, effect) = self.maximize_over(kind, start, 1)?;
        let start = Start { values: effect.values, place: effect.place };
        self.maximize_over(kind, &start, kind.parameters().len())
    }

    /// The same over the first so many numbers.
    fn maximize_over(
        &self,
        kind: EffectKind,
        start: &Start,
        numbers: usize,
    ) -> Result<(f64, Effect), GapError> {
        let parameters = kind.parameters();
        let scales: Vec<f64> = parameters
            .iter()
            .take(numbers)
            .zip(&start.values)
            .map(|(parameter, &value)| first_step(parameter, value))
            .collect();
        let problem = Problem { search: self, kind, start, scales: &scales };
        let origin = vec![0.0; scales.len()];
        // What can't be together is refused here; within the solver it would be a panic.
        self.comparison.effects(&self.with(&problem.effect(&origin)?))?;
        if kind.is_stepped() {
            // A step is right or it isn't.
            let effect = problem.effect(&origin)?;
            return Ok((self.evaluate_roughly(&effect)?, effect));
        }
        let mut simplex = vec![origin.clone()];
        for axis in 0..origin.len() {
            let mut corner = origin.clone();
            corner[axis] = if axis == 0 { -0.7 } else { 0.4 };
            simplex.push(corner);
        }
        let steps = STEPS_PER_NUMBER * scales.len() as u64;
        let solver = NelderMead::new(simplex).with_sd_tolerance(TOLERANCE_NATS).map_err(|_| {
            GapError::Option { option: "tolerance", value: TOLERANCE_NATS, allowed: "positive" }
        })?;
        let result =
            Executor::new(&problem, solver).timer(false).configure(|state| state.max_iters(steps)).run();
        match result {
            Ok(result) => {
                let best = result.state.best_param.unwrap_or(origin);
                Ok((-result.state.best_cost, problem.effect(&best)?))
            }
            // The problem's own errors are of effects out of bounds, which it doesn't make.
            Err(_) => Ok((f64::NEG_INFINITY, problem.effect(&origin)?)),
        }
    }

    /// What a fit gains on blocks that it hasn't seen, and how sure its numbers are.
    ///
    /// The fit without a block is one Newton step from the fit with it. Intervals are by the sandwich of Godambe (1960)
    /// over blocks, with Student's distribution, and no narrower than the curvature alone makes them.
    pub fn assess(&self, effect: Effect) -> Result<Candidate, GapError> {
        let fitted = self.evaluate(&effect)?;
        let with = blocks(&fitted.scans);
        let without = blocks(&self.without.scans);
        if effect.kind.is_stepped() {
            let gains = with.iter().zip(&without).map(|(a, b)| a - b).collect();
            let intervals = vec![[effect.values[0]; 2]];
            return Ok(Candidate { effect, gains, intervals, is_beyond_chance: false, score: None });
        }
        let parameters = effect.kind.parameters();
        let numbers = parameters.len();
        let total = fitted.total();
        let moved = |changes: &[(usize, f64)]| -> Result<Vec<f64>, GapError> {
            let mut other = effect.clone();
            for &(i, change) in changes {
                other.values[i] = (other.values[i] + change).clamp(parameters[i].lo, parameters[i].hi);
            }
            let mut moved = blocks(&self.evaluate(&other)?.scans);
            // What is typical holds for the log as a whole: each block has its share of it.
            let typical = (log_prior(&other) - log_prior(&effect)) / moved.len() as f64;
            for block in &mut moved {
                *block += typical;
            }
            Ok(moved)
        };
        // A step that changes the likelihood by about half a nat.
        let mut steps = vec![0.0; numbers];
        let mut up = Vec::with_capacity(numbers);
        let mut down = Vec::with_capacity(numbers);
        for i in 0..numbers {
            let (lo, hi) = (parameters[i].lo, parameters[i].hi);
            let room = (hi - effect.values[i]).min(effect.values[i] - lo);
            let mut step =
                0.1 * (effect.values[i] - parameters[i].neutral).abs().max(0.2 * parameters[i].start.abs());
            step = step.max(1e-6 * (hi - lo));
            for _ in 0..3 {
                let bounded = if room > 0.0 { step.min(room) } else { step };
                let (a, b) = (moved(&[(i, bounded)])?, moved(&[(i, -bounded)])?);
                let drop = total - 0.5 * (a.iter().sum::<f64>() + b.iter().sum::<f64>());
                (steps[i], step) = (bounded, bounded);
                let good = (0.1..3.0).contains(&drop);
                if good || drop <= 0.0 {
                    up.push(a);
                    down.push(b);
                    break;
                }
                step *= (0.5 / drop).sqrt().clamp(0.05, 8.0);
                if room > 0.0 && bounded >= room && step > room {
                    up.push(a);
                    down.push(b);
                    break;
                }
            }
            if up.len() == i {
                up.push(moved(&[(i, steps[i])])?);
                down.push(moved(&[(i, -steps[i])])?);
            }
        }
        let count = with.len();
        let gradient: Vec<Vec<f64>> = (0..numbers)
            .map(|i| (0..count).map(|b| (up[i][b] - down[i][b]) / (2.0 * steps[i])).collect())
            .collect();
        let sum = |blocks: &[f64]| blocks.iter().sum::<f64>();
        let mut information = vec![vec![0.0; numbers]; numbers];
        for i in 0..numbers {
            let curvature = (2.0 * total - sum(&up[i]) - sum(&down[i])) / steps[i].powi(2);
            // At the edge of what is allowed or on a plateau it tells nothing; a nat over the whole start does.
            information[i][i] = curvature.max(0.05 / steps[i].powi(2));
            for j in 0..i {
                let both = sum(&moved(&[(i, steps[i]), (j, steps[j])])?);
                let mixed = (both - sum(&up[i]) - sum(&up[j]) + total) / (steps[i] * steps[j]);
                let most = 0.98 * (information[i][i] * information[j][j]).sqrt();
                information[i][j] = (-mixed).clamp(-most, most);
                information[j][i] = information[i][j];
            }
        }
        let inverse = invert(&information);
        let gains = (0..count)
            .map(|b| {
                let g: Vec<f64> = gradient.iter().map(|g| g[b]).collect();
                let left_out = quadratic(&inverse, &g).min(with[b] - without[b] + 5.0).max(0.0);
                with[b] - without[b] - left_out
            })
            .collect();
        let degrees = (count as f64 - 1.0).max(2.0);
        let quantile = StudentsT::new(0.0, 1.0, degrees).map_or(1.96, |t| t.inverse_cdf(0.975));
        let intervals = (0..numbers)
            .map(|i| {
                let row = &inverse[i];
                let projected =
                    (0..count).map(|b| row.iter().zip(&gradient).map(|(r, g)| r * g[b]).sum::<f64>());
                let sandwich = projected.map(|p| p * p).sum::<f64>() * count as f64 / degrees;
                let error = sandwich.max(0.0).sqrt();
                let curvature = inverse[i][i].max(0.0).sqrt();
                let half = (quantile * (0.5 * (error * error + curvature * curvature)).sqrt())
                    .max(1.96 * 0.8 * curvature);
                [
                    (effect.values[i] - half).max(parameters[i].lo),
                    (effect.values[i] + half).min(parameters[i].hi),
                ]
            })
            .collect();
        Ok(Candidate { effect, gains, intervals, is_beyond_chance: false, score: None })
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
        .map(|(i, prior)| log_normal(prior.deviations(effect.values[i], parameters[i].start)))
        .sum()
}

/// The same about typical values that are drawn: each is as many standard deviations above the shape of `about` as given.
pub(crate) fn log_prior_by_chance(effect: &Effect, about: &Effect, deviations: [f64; PRIORS]) -> f64 {
    priors(effect.kind)
        .zip(deviations)
        .map(|((i, prior), deviations)| {
            log_normal(prior.deviations(effect.values[i], about.values[i]) - deviations)
        })
        .sum()
}

/// Log density of the standard normal distribution, up to a constant.
fn log_normal(deviations: f64) -> f64 {
    -0.5 * deviations.powi(2)
}

/// First step of a search in a parameter that starts at `value`.
fn first_step(parameter: &Parameter, value: f64) -> f64 {
    if let Role::Position { first_step } = parameter.role {
        return first_step;
    }
    if parameter.lo >= 0.0 {
        // The least value it starts from.
        return 1e-3 * (parameter.start - parameter.lo).abs().max(1e-3);
    }
    let away = (value - parameter.neutral).abs().max(0.3 * (parameter.start - parameter.neutral).abs());
    // Towards the neutral value first, on either side of it.
    let away = if value < parameter.neutral { -away } else { away };
    if away == 0.0 { 0.05 * (parameter.hi - parameter.lo) } else { away }
}

/// The search's objective: numbers in units of their start's distance from neutral, about the start.
struct Problem<'s, 'c, 'a> {
    search: &'s Search<'c, 'a>,
    kind: EffectKind,
    start: &'s Start,
    scales: &'s [f64],
}

impl Problem<'_, '_, '_> {
    fn effect(&self, numbers: &[f64]) -> Result<Effect, GapError> {
        let values = self
            .kind
            .parameters()
            .iter()
            .zip(numbers.iter().chain(std::iter::repeat(&0.0)))
            .zip(self.scales.iter().chain(std::iter::repeat(&0.0)))
            .zip(&self.start.values)
            .map(|(((parameter, number), scale), start)| {
                // What can't be negative is searched by its logarithm: at 0 the likelihood has an edge.
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

impl CostFunction for &Problem<'_, '_, '_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, numbers: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        let total = self.search.evaluate_roughly(&self.effect(numbers)?)?;
        Ok(if total.is_finite() { -total } else { f64::MAX })
    }
}

fn quadratic(matrix: &[Vec<f64>], v: &[f64]) -> f64 {
    matrix.iter().zip(v).map(|(row, a)| a * row.iter().zip(v).map(|(m, b)| m * b).sum::<f64>()).sum()
}

/// Inverse of a small positive definite matrix (Gauss and Jordan); a ridge where it isn't.
pub(crate) fn invert(matrix: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let n = matrix.len();
    // Scaled to ones on the diagonal, so that units don't matter.
    let scale: Vec<f64> = (0..n).map(|i| matrix[i][i].max(1e-300).sqrt()).collect();
    let mut ridge = 0.0;
    loop {
        let mut left: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                (0..n)
                    .map(|j| matrix[i][j] / (scale[i] * scale[j]) + if i == j { ridge } else { 0.0 })
                    .collect()
            })
            .collect();
        let mut right: Vec<Vec<f64>> =
            (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
        let mut positive = true;
        for i in 0..n {
            let pivot = left[i][i];
            if pivot < 1e-6 {
                positive = false;
                break;
            }
            for j in 0..n {
                left[i][j] /= pivot;
                right[i][j] /= pivot;
            }
            for row in 0..n {
                if row != i {
                    let factor = left[row][i];
                    for j in 0..n {
                        left[row][j] -= factor * left[i][j];
                        right[row][j] -= factor * right[i][j];
                    }
                }
            }
        }
        if positive {
            for i in 0..n {
                for j in 0..n {
                    right[i][j] /= scale[i] * scale[j];
                }
            }
            return right;
        }
        ridge = if ridge == 0.0 { 0.01 } else { 2.0 * ridge };
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
