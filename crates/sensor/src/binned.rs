//! Nadaraya-Watson smoothing of histograms over the state, on a grid.
//!
//! The paper's eq. (7) takes a weighted sum over all N training states at each query. Here the states are
//! first counted into the cells of a grid over (r, alpha); a product of Gaussian kernels then is a
//! convolution along one axis after the other (binned kernel estimators: Fan and Marron, Fast implementations
//! of nonparametric curve estimators, J. Comp. Graph. Stat. 1994). The cost doesn't depend on N, and the
//! result is the table that answers at run time. Against the sum over states each state moves by at most half
//! a cell.

use locsim_core::CAST_REACH;
use rayon::prelude::*;

use crate::TrainingSet;
use crate::axis::Axis;
use crate::beam::Beam;
use crate::state_grid::StateGrid;

/// Kernels are cut at this many bandwidths, where 3e-4 of their height and 1e-4 of their mass are left.
const CUT: f32 = 4.0;

/// Readings counted by cell and bin, smoothed or not.
#[derive(Clone)]
pub(crate) struct Counts {
    pub grid: StateGrid,
    /// Number of bins plus one: the last entry of each row counts readings at the maximum range.
    stride: usize,
    /// \[cell\]\[stride\].
    rows: Vec<f32>,
}

/// The observation of `np_reg`: the reading itself.
pub(crate) fn published(z: f32, beam: &Beam) -> Option<f32> {
    (z < beam.max_range).then_some(z)
}

/// The observation of `np_reg_registered`: the reading less the nominal range. No return from a beam whose wall stands
/// beyond the maximum range is what that wall would give, observed at the wall; which beam a block stopped
/// between the maximum range and the wall can't be told.
pub(crate) fn registered(z: f32, beam: &Beam) -> Option<f32> {
    let unseen_wall = beam.is_open() && beam.nominal < CAST_REACH * beam.max_range;
    if z < beam.max_range { Some(z - beam.nominal) } else { unseen_wall.then_some(0.0) }
}

impl Counts {
    /// Counts the observation `observe(z, beam)` of every reading; `None` is no return.
    pub fn of(
        data: &TrainingSet,
        grid: StateGrid,
        axis: &Axis,
        observe: impl Fn(f32, &Beam) -> Option<f32>,
    ) -> Self {
        let stride = axis.bins() + 1;
        let mut rows = vec![0.0; grid.cells() * stride];
        for (z, beam) in data.readings() {
            let bin = observe(z, &beam).map_or(axis.bins(), |observation| axis.bin(observation));
            rows[grid.cell(&beam) * stride + bin] += 1.0;
        }
        Self { grid, stride, rows }
    }

    pub fn row(&self, cell: usize) -> &[f32] {
        &self.rows[cell * self.stride..][..self.stride]
    }

    /// The readings of all cells with a mapped surface together.
    pub fn pooled(&self) -> Vec<f32> {
        let mut sum = vec![0.0f64; self.stride];
        for cell in 0..self.grid.mapped() {
            sum.iter_mut().zip(self.row(cell)).for_each(|(sum, count)| *sum += f64::from(*count));
        }
        sum.into_iter().map(|count| count as f32).collect()
    }

    /// Smooths every row along the observation by a Gaussian of `bandwidth` bins, which keeps its counts.
    #[must_use]
    pub fn smoothed_over_observation(&self, bandwidth: f32) -> Self {
        let kernel = kernel(bandwidth);
        let bins = self.stride - 1;
        let mut out = self.clone();
        out.rows.par_chunks_mut(self.stride).zip(self.rows.par_chunks(self.stride)).for_each(|(to, from)| {
            to[..bins].fill(0.0);
            for (bin, &count) in from[..bins].iter().enumerate().filter(|(_, count)| **count > 0.0) {
                let near = bin.saturating_sub(kernel.len() - 1)..(bin + kernel.len()).min(bins);
                let total: f32 = near.clone().map(|b| kernel[b.abs_diff(bin)]).sum();
                for b in near {
                    to[b] += count * kernel[b.abs_diff(bin)] / total;
                }
            }
        });
        out
    }

    /// Smooths over nominal range by a Gaussian kernel of `bandwidth` \[m\] with peak 1, so that counts add
    /// up to the effective number of readings behind a cell. The cell of open beams is left alone, here and
    /// below.
    #[must_use]
    pub fn smoothed_over_range(&self, bandwidth: f32) -> Self {
        let kernel = kernel(bandwidth / self.grid.range_width());
        let slab = self.grid.incidences * self.stride;
        let mut out = self.clone();
        let mapped = self.grid.mapped() * self.stride;
        out.rows[..mapped].par_chunks_mut(slab).enumerate().for_each(|(i, to)| {
            convolve(to, &self.rows[..mapped], i, self.grid.ranges, &kernel);
        });
        out
    }

    /// Smooths over incidence by a Gaussian kernel of `bandwidth` \[rad\] with peak 1.
    #[must_use]
    pub fn smoothed_over_incidence(&self, bandwidth: f32) -> Self {
        let kernel = kernel(bandwidth / self.grid.incidence_width());
        let slab = self.grid.incidences * self.stride;
        let mut out = self.clone();
        let mapped = self.grid.mapped() * self.stride;
        out.rows[..mapped].par_chunks_mut(slab).zip(self.rows.par_chunks(slab)).for_each(|(to, from)| {
            for (j, to) in to.chunks_mut(self.stride).enumerate() {
                convolve(to, from, j, self.grid.incidences, &kernel);
            }
        });
        out
    }
}

/// `to` becomes the kernel-weighted sum of the `n` equal parts of `from` around part `at`.
fn convolve(to: &mut [f32], from: &[f32], at: usize, n: usize, kernel: &[f32]) {
    to.fill(0.0);
    for i in at.saturating_sub(kernel.len() - 1)..(at + kernel.len()).min(n) {
        let weight = kernel[i.abs_diff(at)];
        let part = &from[i * to.len()..];
        for (to, from) in to.iter_mut().zip(part) {
            *to += weight * from;
        }
    }
}

/// A Gaussian kernel of `bandwidth` cells at distances of 0, 1, 2.. cells.
pub(crate) fn kernel(bandwidth: f32) -> Vec<f32> {
    let reach = (CUT * bandwidth) as usize;
    (0..=reach).map(|k| if k == 0 { 1.0 } else { (-0.5 * (k as f32 / bandwidth).powi(2)).exp() }).collect()
}

#[cfg(test)]
mod tests {
    use distreg::{Dataset, Kernel, Smoother, Weighting};
    use locsim_core::{Draw, Stage};
    use rand::RngExt;

    use super::*;
    use crate::tests::simulated::{MAX_RANGE, state};

    /// With every state in the middle of a cell, smoothing on the grid is the sum over states of eq. (7), but
    /// for what lies beyond four bandwidths: 3e-4 of a kernel's height, and a mass of 1e-4.
    #[test]
    fn smoothing_on_the_grid_is_the_sum_over_states() {
        let grid = StateGrid { reach: MAX_RANGE, ranges: 30, incidences: 10 };
        let axis = Axis::uniform(MAX_RANGE, 20);
        let mut data = TrainingSet::new(MAX_RANGE).unwrap();
        let mut states = Dataset::new(2);
        for i in 0..120 {
            let mut rng = Draw::new(2, Stage::Training, 0).item(i);
            let (r, alpha) = grid.centre(rng.random_range(0..grid.mapped()));
            let z: Vec<f32> =
                (0..5).map(|_| rng.random::<f32>() * 1.1 * MAX_RANGE).map(|z| z.min(MAX_RANGE)).collect();
            data.push(state(r, alpha, i), &z).unwrap();
            states.push(&[r.into(), alpha.into()], &z.iter().map(|&z| z.into()).collect::<Vec<_>>()).unwrap();
        }
        let bandwidths = [0.4f32, 0.3];
        let counts = Counts::of(&data, grid, &axis, published);
        let smoothed = counts.smoothed_over_range(bandwidths[0]).smoothed_over_incidence(bandwidths[1]);
        let smoother =
            Smoother::new(&states, &Weighting::kernel(Kernel::Gaussian, &bandwidths.map(f64::from))).unwrap();
        let mut weights = Vec::new();
        for cell in 0..grid.mapped() {
            let (r, alpha) = grid.centre(cell);
            smoother.weights(&[r.into(), alpha.into()], &mut weights).unwrap();
            let mut expected = vec![0.0; axis.bins() + 1];
            for &(i, weight) in &weights {
                for &z in data.observations(i) {
                    let bin = if z >= MAX_RANGE { axis.bins() } else { axis.bin(z) };
                    expected[bin] += weight / 5.0;
                }
            }
            let row = smoothed.row(cell);
            let total: f32 = row.iter().sum();
            for (found, expected) in row.iter().zip(expected) {
                assert!((f64::from(found / total) - expected).abs() < 2e-3, "cell {cell}");
            }
        }
    }

    #[test]
    fn smoothing_over_the_observation_keeps_every_count() {
        let grid = StateGrid { reach: MAX_RANGE, ranges: 1, incidences: 1 };
        let axis = Axis::around_zero(MAX_RANGE, 0.002, 0.03);
        let mut data = TrainingSet::new(MAX_RANGE).unwrap();
        data.push(state(2.0, 0.1, 0), &[0.0, 1.9, 2.0, 2.01, 4.4, MAX_RANGE]).unwrap();
        for bandwidth in [0.0, 0.5, 3.0, 50.0] {
            let counts = Counts::of(&data, grid, &axis, registered).smoothed_over_observation(bandwidth);
            let (below, at_max) = counts.row(0).split_at(axis.bins());
            assert!((below.iter().sum::<f32>() - 5.0).abs() < 1e-4);
            assert_eq!(at_max, [1.0]);
        }
    }
}
