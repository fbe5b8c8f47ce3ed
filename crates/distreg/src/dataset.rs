use rand_philox::Philox;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::{finite, query};

/// Training data D = {(`x_i`, `z_ij`)}: N states of `dim` coordinates, each with one or more observations. The
/// number M of observations may differ between states, and M = 1 is fine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dataset {
    dim: usize,
    states: Vec<f64>,
    observations: Vec<f64>,
    /// End of state i's observations.
    ends: Vec<usize>,
}

impl Dataset {
    /// No data yet; states will have `dim` coordinates.
    pub fn new(dim: usize) -> Self {
        Self { dim, states: Vec::new(), observations: Vec::new(), ends: Vec::new() }
    }

    /// Adds a state and everything observed at it.
    ///
    /// # Errors
    /// If the state has another dimension, there is no observation, or a number isn't finite. The data is then
    /// unchanged.
    pub fn push(&mut self, state: &[f64], observations: &[f64]) -> Result<(), Error> {
        query(self.dim, state)?;
        if observations.is_empty() {
            return Err(Error::Empty { what: "the observations of a state" });
        }
        for &z in observations {
            finite("an observation", z)?;
        }
        self.states.extend_from_slice(state);
        self.observations.extend_from_slice(observations);
        self.ends.push(self.observations.len());
        Ok(())
    }

    /// Number of states N.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there are no states.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Coordinates of a state, p.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// State `i`, `dim` coordinates.
    ///
    /// # Panics
    /// If `i` is not below `len`.
    pub fn state(&self, i: usize) -> &[f64] {
        &self.states[i * self.dim..(i + 1) * self.dim]
    }

    /// All states, row by row: N x `dim`.
    pub fn states(&self) -> &[f64] {
        &self.states
    }

    /// Everything observed at state `i`, at least one.
    ///
    /// # Panics
    /// If `i` is not below `len`.
    pub fn observations(&self, i: usize) -> &[f64] {
        let start = if i == 0 { 0 } else { self.ends[i - 1] };
        &self.observations[start..self.ends[i]]
    }

    /// The states of the given indices, in that order, with their observations.
    ///
    /// # Panics
    /// If an index is not below `len`.
    #[must_use]
    pub fn subset(&self, indices: &[usize]) -> Self {
        let mut subset = Self::new(self.dim);
        for &i in indices {
            subset.states.extend_from_slice(self.state(i));
            subset.observations.extend_from_slice(self.observations(i));
            subset.ends.push(subset.observations.len());
        }
        subset
    }

    /// Splits by state into (train, held out). The held-out part has the share `held_out_share` of the states
    /// (limited to 0..=1 and rounded to whole states), chosen at random by `seed`; both parts keep the order.
    pub fn split(&self, held_out_share: f64, seed: u64) -> (Self, Self) {
        let count = (held_out_share.clamp(0.0, 1.0) * self.len() as f64).round() as usize;
        let order = shuffled(self.len(), seed);
        let (held_out, train) = order.split_at(count.min(order.len()));
        (self.in_order(train), self.in_order(held_out))
    }

    /// The pairs (train, held out) of `folds`-fold cross-validation over states; each state is held out once.
    ///
    /// # Errors
    /// Unless there are at least 2 folds and at most as many as states.
    pub fn folds(&self, folds: usize, seed: u64) -> Result<Vec<(Self, Self)>, Error> {
        if folds < 2 || folds > self.len() {
            return Err(Error::Folds { folds, states: self.len() });
        }
        let order = shuffled(self.len(), seed);
        let part = |keep: &dyn Fn(usize) -> bool| {
            let chosen: Vec<usize> = (0..order.len()).filter(|&k| keep(k)).map(|k| order[k]).collect();
            self.in_order(&chosen)
        };
        Ok((0..folds).map(|fold| (part(&|k| k % folds != fold), part(&|k| k % folds == fold))).collect())
    }

    fn in_order(&self, indices: &[usize]) -> Self {
        let mut indices = indices.to_vec();
        indices.sort_unstable();
        self.subset(&indices)
    }
}

/// The indices 0..n in random order (Fisher and Yates).
pub(crate) fn shuffled(n: usize, seed: u64) -> Vec<usize> {
    let mut random = Philox::from_u64_seed(seed);
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, random.bounded(i as u32 + 1) as usize);
    }
    order
}
