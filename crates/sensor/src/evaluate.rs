//! How well a model predicts readings it hasn't seen.

use locsim_core::{Hits, Particles, SensorModel};
use rayon::prelude::*;

use crate::TrainingSet;

/// Points of the quadrature over z from 0 to the maximum range.
const POINTS: usize = 1000;

/// At most this many states enter the histogram match; of a larger set every so manieth.
const MATCHED_STATES: usize = 1000;

/// States per parallel task.
const CHUNK: usize = 16;

/// Scores of a model on a set of readings; less is better.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// Mean of -ln p(z) over all readings \[nats\]; plus infinity if the model holds one of them impossible.
    pub log_loss_nats: f64,
    /// Mean over states of the Wasserstein-1 distance \[m\] between predicted and observed distribution, the
    /// integral of the difference of their distribution functions: the paper's histogram match times the
    /// width of a bin. With one reading at a state it is the model's mean distance from that reading. Taken
    /// over at most 1000 states, evenly chosen.
    pub histogram_match_m: f64,
}

/// Scores `model` on every state of `data`. NaN for an empty set.
pub fn evaluate(model: &dyn SensorModel, data: &TrainingSet) -> Evaluation {
    Evaluation { log_loss_nats: log_loss(model, data), histogram_match_m: histogram_match(model, data) }
}

/// [`Evaluation::log_loss_nats`].
pub(crate) fn log_loss(model: &dyn SensorModel, data: &TrainingSet) -> f64 {
    let sum = sum_over_states(data.len(), |scorer, i| scorer.loss(model, data, i));
    sum / data.reading_count() as f64
}

/// [`Evaluation::histogram_match_m`].
pub(crate) fn histogram_match(model: &dyn SensorModel, data: &TrainingSet) -> f64 {
    let stride = data.len().div_ceil(MATCHED_STATES).max(1);
    let matched = data.len().div_ceil(stride);
    sum_over_states(matched, |scorer, i| scorer.distance(model, data, i * stride)) / matched as f64
}

/// Sums over states in parallel, but in an order that doesn't depend on threads.
fn sum_over_states(states: usize, score: impl Fn(&mut Scorer, usize) -> f64 + Sync) -> f64 {
    let parts: Vec<f64> = (0..states.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut scorer = Scorer::default();
            (chunk * CHUNK..((chunk + 1) * CHUNK).min(states)).map(|i| score(&mut scorer, i)).sum()
        })
        .collect();
    parts.iter().sum()
}

/// Buffers: one state as a batch of one pose whose beams all point the same way.
#[derive(Default)]
struct Scorer {
    bearings: Vec<f32>,
    hits: Hits,
    z: Vec<f32>,
    out: Vec<f32>,
}

impl Scorer {
    /// Asks the model about the readings in `self.z` at state `i`.
    fn ask(&mut self, data: &TrainingSet, i: usize, f: impl Fn(&[f32], &locsim_core::Beams<'_>, &mut [f32])) {
        let state = data.state(i);
        let k = self.z.len();
        let laser: Particles = std::iter::once(state.laser).collect();
        self.bearings.clear();
        self.bearings.resize(k, state.bearing);
        self.hits.resize(k);
        self.hits.range.fill(state.range);
        self.hits.incidence.fill(state.incidence);
        self.hits.surface.fill(state.surface);
        self.out.resize(k, 0.0);
        f(&self.z, &self.hits.beams(laser.as_poses(), &self.bearings, data.max_range()), &mut self.out);
    }

    /// Sum of -ln p over the readings of state `i`.
    fn loss(&mut self, model: &dyn SensorModel, data: &TrainingSet, i: usize) -> f64 {
        self.z.clear();
        self.z.extend_from_slice(data.observations(i));
        self.ask(data, i, |z, beams, out| model.log_density(z, beams, out));
        -self.out.iter().map(|&l| f64::from(l)).sum::<f64>()
    }

    /// Wasserstein-1 distance \[m\] at state `i`, by the midpoint rule.
    fn distance(&mut self, model: &dyn SensorModel, data: &TrainingSet, i: usize) -> f64 {
        let step = data.max_range() / POINTS as f32;
        self.z.clear();
        self.z.extend((0..POINTS).map(|p| (p as f32 + 0.5) * step));
        self.ask(data, i, |z, beams, out| model.cdf(z, beams, out));
        let mut observed = data.observations(i).to_vec();
        observed.sort_unstable_by(f32::total_cmp);
        let mut below = 0;
        let mut sum = 0.0;
        for (z, p) in self.z.iter().zip(&self.out) {
            while below < observed.len() && observed[below] <= *z {
                below += 1;
            }
            sum += (f64::from(*p) - below as f64 / observed.len() as f64).abs();
        }
        sum * f64::from(step)
    }
}
