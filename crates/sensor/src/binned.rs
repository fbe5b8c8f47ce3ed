//! Nadaraya-Watson smoothing of histograms over the state, on a grid.
//!
//! The paper's eq. (7) takes a weighted sum over all N training states at each query. Here the states are first counted into the
//! cells of a grid over (r, alpha); a product of Gaussian kernels then is a convolution along one axis after
//! the other (binned kernel estimators: Fan and Marron, Fast implementations of nonparametric curve estimators,
//! J. Comp. Graph. Stat. 1994). The cost doesn't depend on N, and the result is the table that answers at run time. Against
//! the sum over states each state moves by at most half a cell.

use rayon::prelude::*;

use crate::TrainingSet;
use crate::axis::Axis;
use crate::state_grid::StateGrid;

/// Kernels are cut at this many bandwidths.
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

impl Counts {
    /// Counts the observation `observe(z, r)` of every reading.
    pub fn of(data: &TrainingSet, grid: StateGrid, axis: &Axis, observe: impl Fn(f32, f32) -> f32) -> Self {
        let stride = axis.bins() + 1;
        let mut rows = vec![0.0; grid.cells() * stride];
        for (z, beam) in data.readings() {
            let bin = if z >= beam.max_range { axis.bins() } else { axis.bin(observe(z, beam.range)) };
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
        out.rows.par_chunks_mut(self.stride).zip(self.rows.par_chunks(self.stride)).for_each(
            |(to, from)| {
                to[..bins].fill(0.0);
                for (bin, &count) in from[..bins].iter().enumerate().filter(|(_, count)| **count > 0.0) {
                    let near = bin.saturating_sub(kernel.len() - 1)..(bin + kernel.len()).min(bins);
                    let total: f32 = near.clone().map(|b| kernel[b.abs_diff(bin)]).sum();
                    for b in near {
                        to[b] += count * kernel[b.abs_diff(bin)] / total;
                    }
                }
            },
        );
        out
    }

    /// Smooths over nominal range by a Gaussian kernel of `bandwidth` [m] with peak 1, so that counts add up to the
    /// effective number of readings behind a cell. The cell of open beams is left alone, here and below.
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

    /// Smooths over incidence by a Gaussian kernel of `bandwidth` [rad] with peak 1.
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
fn kernel(bandwidth: f32) -> Vec<f32> {
    let reach = (CUT * bandwidth) as usize;
    (0..=reach).map(|k| if k == 0 { 1.0 } else { (-0.5 * (k as f32 / bandwidth).powi(2)).exp() }).collect()
}
