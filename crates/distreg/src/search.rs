use rayon::prelude::*;

use crate::{Dataset, Error};

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

/// Mean over the folds of `score(train, held out)`; each state is held out once (see [`Dataset::folds`]).
///
/// # Errors
/// If the folds are impossible, or the score's first error.
pub fn cross_validate<E, F>(data: &Dataset, folds: usize, seed: u64, score: F) -> Result<f64, E>
where
    E: From<Error>,
    F: Fn(&Dataset, &Dataset) -> Result<f64, E>,
{
    let mut sum = 0.0;
    for (train, held_out) in data.folds(folds, seed)? {
        sum += score(&train, &held_out)?;
    }
    Ok(sum / folds as f64)
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
