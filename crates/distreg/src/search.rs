use std::cell::RefCell;

use argmin::core::{CostFunction, Executor};
use argmin::solver::neldermead::NelderMead;
use rayon::prelude::*;

use crate::error::positive;
use crate::{Dataset, Error, Loss, Regressor, losses};

/// The simplex search ends where the scores of its corners agree to this share of the start's score.
const TOLERANCE: f64 = 1e-3;

/// The best candidate of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct Found<C> {
    /// The candidate with the smallest score; among equals the first.
    pub candidate: C,
    /// Its score.
    pub score: f64,
    /// The scores of all candidates, in their order; infinite where the criterion gave no finite number.
    pub scores: Vec<f64>,
}

/// Tries every candidate, in parallel, and gives the one with the smallest criterion. A candidate whose
/// criterion isn't finite is never chosen. [`cross_validate`] makes a criterion from a loss.
///
/// # Errors
/// The criterion's first error, or [`Error::NoFiniteScore`].
pub fn grid_search<C, E, F>(candidates: &[C], criterion: F) -> Result<Found<C>, E>
where
    C: Clone + Sync,
    E: From<Error> + Send,
    F: Fn(&C) -> Result<f64, E> + Send + Sync,
{
    let results: Vec<Result<f64, E>> = candidates.par_iter().map(criterion).collect();
    let scores = results
        .into_iter()
        .map(|score| score.map(|s| if s.is_finite() { s } else { f64::INFINITY }))
        .collect::<Result<Vec<f64>, E>>()?;
    let best = scores.iter().enumerate().filter(|(_, s)| s.is_finite()).min_by(|a, b| a.1.total_cmp(b.1));
    match best {
        Some((i, &score)) => Ok(Found { candidate: candidates[i].clone(), score, scores }),
        None => Err(Error::NoFiniteScore { candidates: candidates.len() }.into()),
    }
}

/// The cross-validated risk of a method: mean loss at states that the fit hasn't seen, each held out once (see
/// [`Dataset::folds`]), so that it is the criterion of a search over the method's settings.
///
/// # Errors
/// If the folds, a fit or a loss isn't possible.
pub fn cross_validate<R: Regressor>(
    method: &R,
    data: &Dataset,
    folds: usize,
    seed: u64,
    loss: Loss,
) -> Result<f64, Error> {
    let mut sum = 0.0;
    for (train, held_out) in data.folds(folds, seed)? {
        sum += losses(&method.fit(&train)?, &held_out, loss)?.iter().sum::<f64>();
    }
    Ok(sum / data.len() as f64)
}

/// Minimizes the criterion over positive numbers, such as bandwidths, from `start`: the simplex method of Nelder
/// and Mead 1965 on their logarithms, from a simplex whose edges change one number by the factor `spread`. It ends after `steps`,
/// each of which asks for the criterion once or twice, or when the scores of the simplex agree to a thousandth of the
/// start's. The criterion may jump; where it isn't finite it counts as worst.
///
/// A search finds the minimum around its start, so start from the best of a coarse [`grid_search`].
///
/// # Errors
/// If a start value or the spread isn't positive, the criterion's first error, or [`Error::NoFiniteScore`].
pub fn optimize<F>(start: &[f64], spread: f64, steps: usize, criterion: F) -> Result<Found<Vec<f64>>, Error>
where
    F: Fn(&[f64]) -> Result<f64, Error>,
{
    if start.is_empty() {
        return Err(Error::Empty { what: "the start of a search" });
    }
    for &value in start {
        positive("the start of a search", value)?;
    }
    let step = positive("the spread of a search", spread)?.ln();
    let origin: Vec<f64> = start.iter().map(|value| value.ln()).collect();
    let mut simplex = vec![origin.clone()];
    for axis in 0..start.len() {
        let mut corner = origin.clone();
        corner[axis] += step;
        simplex.push(corner);
    }
    let (trace, failure) = (RefCell::default(), RefCell::default());
    let problem = Problem { criterion, trace: &trace, failure: &failure };
    let start_score = problem.score(&origin)?;
    let tolerance = if start_score.is_finite() { TOLERANCE * start_score.abs() } else { 0.0 };
    let solver = NelderMead::new(simplex).with_sd_tolerance(tolerance);
    // The solver's own errors are of settings, which are valid; the criterion's are kept aside.
    let _ = solver.and_then(|solver| {
        let executor = Executor::new(problem, solver).timer(false);
        executor.configure(|state| state.max_iters(steps as u64)).run()
    });
    if let Some(error) = failure.into_inner() {
        return Err(error);
    }
    let trace = trace.into_inner();
    let scores: Vec<f64> = trace.iter().map(|(_, score)| *score).collect();
    match trace.into_iter().filter(|(_, score)| score.is_finite()).min_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((candidate, score)) => Ok(Found { candidate, score, scores }),
        None => Err(Error::NoFiniteScore { candidates: scores.len() }),
    }
}

/// A criterion over positive numbers as a function of their logarithms, which remembers what it was asked.
struct Problem<'a, F> {
    criterion: F,
    /// Candidates and scores.
    trace: &'a RefCell<Vec<(Vec<f64>, f64)>>,
    /// The first error; the solver would panic over it.
    failure: &'a RefCell<Option<Error>>,
}

impl<F: Fn(&[f64]) -> Result<f64, Error>> Problem<'_, F> {
    fn score(&self, logarithms: &[f64]) -> Result<f64, Error> {
        let candidate: Vec<f64> = logarithms.iter().map(|value| value.exp()).collect();
        if let Some((_, score)) = self.trace.borrow().iter().find(|(known, _)| *known == candidate) {
            return Ok(*score);
        }
        let score = (self.criterion)(&candidate)?;
        let score = if score.is_finite() { score } else { f64::INFINITY };
        self.trace.borrow_mut().push((candidate, score));
        Ok(score)
    }
}

impl<F: Fn(&[f64]) -> Result<f64, Error>> CostFunction for Problem<'_, F> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, logarithms: &Vec<f64>) -> Result<f64, argmin::core::Error> {
        if self.failure.borrow().is_some() {
            return Ok(f64::INFINITY);
        }
        Ok(self.score(logarithms).unwrap_or_else(|error| {
            *self.failure.borrow_mut() = Some(error);
            f64::INFINITY
        }))
    }
}

/// Every combination of one value per axis, the last axis fastest: the candidates of a grid search over
/// bandwidths.
pub fn product(axes: &[&[f64]]) -> Vec<Vec<f64>> {
    axes.iter().fold(vec![Vec::new()], |rows, axis| {
        rows.iter()
            .flat_map(|row| {
                axis.iter().map(move |&value| {
                    let mut longer = row.clone();
                    longer.push(value);
                    longer
                })
            })
            .collect()
    })
}
