//! Choosing data: the states that stand for all within a budget.

use rand_philox::Philox;
use serde::{Deserialize, Serialize};

use crate::dataset::shuffled;
use crate::error::positive;
use crate::{Alignment, Dataset, Error, Smoother, Weighting};

/// How [`select`] chooses states.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Selection {
    /// At random: the measure of the others.
    Random,
    /// Each time the state farthest from those chosen (Gonzalez 1985): covers the states evenly, whatever their
    /// density. N x budget distances.
    FarthestFirst,
    /// Each time the state that most reduces the difference between the kernel means of all states and of those chosen
    /// (Chen, Welling and Smola 2010): follows the density of the states. N^2 kernels.
    Herding,
}

/// The indices of `budget` states (all, where there are fewer), in the order they were chosen: each beginning of the
/// list is the choice for a smaller budget. Distances are measured in `scales`, one per state coordinate; for herding
/// they are the bandwidths of a Gaussian kernel.
///
/// # Errors
/// If there is no data or the scales aren't `dim` positive numbers.
pub fn select(
    data: &Dataset,
    budget: usize,
    selection: Selection,
    scales: &[f64],
    seed: u64,
) -> Result<Vec<usize>, Error> {
    check(data, scales)?;
    let n = data.len();
    let budget = budget.min(n);
    let distance = |i: usize, j: usize| -> f64 {
        let pairs = data.state(i).iter().zip(data.state(j)).zip(scales);
        pairs.map(|((a, b), s)| ((a - b) / s).powi(2)).sum()
    };
    // The first of the states with the largest score that aren't chosen.
    let largest = |scores: &[f64], chosen: &[bool]| {
        let free = (0..n).filter(|&i| !chosen[i]);
        free.fold(None, |best: Option<usize>, i| match best {
            Some(b) if scores[b] >= scores[i] => Some(b),
            _ => Some(i),
        })
    };
    match selection {
        Selection::Random => Ok(shuffled(n, seed)[..budget].to_vec()),
        Selection::FarthestFirst | Selection::Herding => {
            let mut chosen = vec![false; n];
            let mut order = Vec::with_capacity(budget);
            let kernel = |i, j| (-0.5 * distance(i, j)).exp();
            // Farthest first: distance to the nearest chosen state. Herding: kernel mean over all states less that
            // over the chosen, up to the factor of their number.
            let mut scores = match selection {
                Selection::Herding => {
                    (0..n).map(|i| (0..n).map(|j| kernel(i, j)).sum::<f64>() / n as f64).collect()
                }
                _ => vec![f64::INFINITY; n],
            };
            let means = scores.clone();
            let mut next = match selection {
                Selection::Herding => largest(&scores, &chosen),
                _ => Some(Philox::from_u64_seed(seed).bounded(n as u32) as usize),
            };
            while let Some(i) = next {
                chosen[i] = true;
                order.push(i);
                if order.len() == budget {
                    break;
                }
                for (j, score) in scores.iter_mut().enumerate() {
                    match selection {
                        Selection::Herding => *score += means[j] - kernel(i, j),
                        _ => *score = score.min(distance(i, j)),
                    }
                }
                next = largest(&scores, &chosen);
            }
            order.truncate(budget);
            Ok(order)
        }
    }
}

/// Keeps the given states and gives each the observations of all states to which it is the nearest, aligned: nothing
/// that was observed is lost, only where exactly.
///
/// # Errors
/// If nothing is kept, the scales aren't `dim` positive numbers, or the alignment isn't possible.
///
/// # Panics
/// If an index is not below `len`.
pub fn condense(
    data: &Dataset,
    kept: &[usize],
    alignment: Alignment,
    point_mass_at: Option<f64>,
    scales: &[f64],
) -> Result<Dataset, Error> {
    check(data, scales)?;
    let subset = data.subset(kept);
    let smoother = Smoother::new(&subset, &Weighting::nearest_neighbours(1, scales))?;
    let mut observations = vec![Vec::new(); kept.len()];
    let mut nearest = Vec::new();
    for i in 0..data.len() {
        smoother.weights(data.state(i), &mut nearest)?;
        let k = nearest[0].0;
        let (from, to) = (alignment.at(data.state(i))?, alignment.at(subset.state(k))?);
        observations[k].extend(
            data.observations(i)
                .iter()
                .map(|&z| if point_mass_at == Some(z) { z } else { to.restore(from.align(z)) }),
        );
    }
    let mut condensed = Dataset::new(data.dim());
    for (k, z) in observations.iter().enumerate() {
        // A copy of another kept state may have no observations left.
        if !z.is_empty() {
            condensed.push(subset.state(k), z)?;
        }
    }
    Ok(condensed)
}

fn check(data: &Dataset, scales: &[f64]) -> Result<(), Error> {
    if data.is_empty() {
        return Err(Error::Empty { what: "the training states" });
    }
    if scales.len() != data.dim() {
        return Err(Error::Length { what: "number of scales", expected: data.dim(), found: scales.len() });
    }
    scales.iter().try_for_each(|&scale| positive("a scale", scale).map(|_| ()))
}
