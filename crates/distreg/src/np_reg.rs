use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::density::Taps;
use crate::distribution::MAX_BINS;
use crate::error::{finite, positive};
use crate::{Dataset, Distribution, Error, Grid, Kernel, PointMass, Smoother, Support};

/// What is smoothed over states: the observation itself, or the observation relative to a state coordinate.
/// Where the observation follows that coordinate, aligned histograms of neighbouring states agree, and smoothing
/// them doesn't blur.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// Histograms of z, as published.
    Identity,
    /// Histograms of z minus the coordinate; a prediction is shifted back by the query's coordinate.
    Shift {
        /// Index of the state coordinate.
        state_dim: usize,
    },
    /// Histograms of z divided by the coordinate; a prediction is scaled back. The coordinate must be positive.
    Scale {
        /// Index of the state coordinate.
        state_dim: usize,
    },
}

/// How to fit [`NpReg`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NpRegOptions {
    /// Bins of every predicted distribution.
    pub grid: Grid,
    /// Observations equal to this value are a point mass, smoothed over states as one number and never aligned.
    pub point_mass_at: Option<f64>,
    /// What is smoothed over states.
    pub alignment: Alignment,
    /// Bandwidth of kernel smoothing over z (eq. 5), in units of z; 0 for plain histograms (eq. 6).
    pub observation_bandwidth: f64,
    /// Kernel over states and, where `observation_bandwidth` is positive, over z.
    pub kernel: Kernel,
    /// One bandwidth per state coordinate, in its units.
    pub bandwidths: Vec<f64>,
}

/// Nonparametric distribution regression (procedure 2, NP-REG): a histogram at each training state, and
/// predictions as their kernel-weighted mean (eq. 7).
///
/// Histograms are sparse, so that a prediction costs the neighbours' occupied bins, at most M each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct NpReg {
    options: NpRegOptions,
    smoother: Smoother,
    histograms: Histograms,
    /// Width of an aligned bin: in units of z, or of z / x for [`Alignment::Scale`].
    aligned_width: f64,
    taps: Option<Taps>,
}

/// The states' histograms, compressed by row. Masses of a state and its point share sum to 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Histograms {
    /// End of state i's entries.
    ends: Vec<usize>,
    /// Aligned bin of each entry: the grid's bin for [`Alignment::Identity`], else floor(aligned z / width).
    bins: Vec<i32>,
    masses: Vec<f64>,
    /// Share of the point mass at each state.
    points: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    options: NpRegOptions,
    smoother: Smoother,
    histograms: Histograms,
}

impl From<NpReg> for Parts {
    fn from(model: NpReg) -> Self {
        Self { options: model.options, smoother: model.smoother, histograms: model.histograms }
    }
}

impl TryFrom<Parts> for NpReg {
    type Error = Error;
    fn try_from(parts: Parts) -> Result<Self, Error> {
        parts.histograms.validate(&parts.options, parts.smoother.len())?;
        Self::assemble(parts.options, parts.smoother, parts.histograms)
    }
}

/// Predictions at many queries, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Predictions {
    grid: Grid,
    point_mass_at: Option<f64>,
    /// Queries x bins.
    mass: Vec<f64>,
    points: Vec<f64>,
    support: Vec<Support>,
}

impl Predictions {
    /// Number of queries.
    pub fn len(&self) -> usize {
        self.support.len()
    }

    /// Whether there were no queries.
    pub fn is_empty(&self) -> bool {
        self.support.is_empty()
    }

    /// Probability of each bin at query `i`, without the point mass.
    ///
    /// # Panics
    /// If `i` is not below `len`.
    pub fn mass(&self, i: usize) -> &[f64] {
        &self.mass[i * self.grid.bins..(i + 1) * self.grid.bins]
    }

    /// Probability of the point mass at each query; 0 where the model has none.
    pub fn points(&self) -> &[f64] {
        &self.points
    }

    /// Whether each query lies within the data.
    pub fn support(&self) -> &[Support] {
        &self.support
    }

    /// The distribution predicted at query `i`.
    ///
    /// # Panics
    /// If `i` is not below `len`.
    pub fn distribution(&self, i: usize) -> Distribution {
        let point = self.point_mass_at.map(|at| PointMass { at, mass: self.points[i] });
        Distribution::normalized(self.grid, self.mass(i).to_vec(), point)
    }
}

/// Buffers of one worker.
#[derive(Default)]
struct Scratch {
    weights: Vec<(usize, f64)>,
    row: Vec<f64>,
}

impl NpReg {
    /// Learns from `data`.
    ///
    /// # Errors
    /// If there is no data, an option is invalid, the alignment names a coordinate that doesn't exist, or it
    /// scales by one that isn't positive at every state.
    pub fn fit(data: &Dataset, options: NpRegOptions) -> Result<Self, Error> {
        let smoother = Smoother::new(data, options.kernel, &options.bandwidths)?;
        options.grid.validate()?;
        let width = aligned_width(&options, &smoother)?;
        let mut histograms = Histograms {
            ends: Vec::with_capacity(data.len()),
            bins: Vec::new(),
            masses: Vec::new(),
            points: Vec::with_capacity(data.len()),
        };
        let mut bins: Vec<i32> = Vec::new();
        for i in 0..data.len() {
            let observations = data.observations(i);
            bins.clear();
            for &z in observations {
                if options.point_mass_at == Some(z) {
                    continue;
                }
                bins.push(match options.alignment {
                    Alignment::Identity => options.grid.bin(z) as i32,
                    Alignment::Shift { state_dim } => ((z - data.state(i)[state_dim]) / width).floor() as i32,
                    Alignment::Scale { state_dim } => (z / data.state(i)[state_dim] / width).floor() as i32,
                });
            }
            let count = observations.len() as f64;
            histograms.points.push((observations.len() - bins.len()) as f64 / count);
            bins.sort_unstable();
            for same in bins.chunk_by(|a, b| a == b) {
                histograms.bins.push(same[0]);
                histograms.masses.push(same.len() as f64 / count);
            }
            histograms.ends.push(histograms.bins.len());
        }
        Self::assemble(options, smoother, histograms)
    }

    fn assemble(options: NpRegOptions, smoother: Smoother, histograms: Histograms) -> Result<Self, Error> {
        options.grid.validate()?;
        if let Some(at) = options.point_mass_at {
            finite("the place of the point mass", at)?;
        }
        let bandwidth = options.observation_bandwidth;
        let taps = if bandwidth == 0.0 {
            None
        } else {
            positive("the observation bandwidth (or 0)", bandwidth)?;
            Some(Taps::new(&options.grid, options.kernel, bandwidth))
        };
        Ok(Self { aligned_width: aligned_width(&options, &smoother)?, options, smoother, histograms, taps })
    }

    /// The options of the fit.
    pub fn options(&self) -> &NpRegOptions {
        &self.options
    }

    /// Coordinates of a state.
    pub fn dim(&self) -> usize {
        self.smoother.dim()
    }

    /// The distribution at `query`. An aligned histogram that is moved beyond the low end of the grid counts in
    /// the first bin; beyond the high end, as the point mass where that lies at the high end (a range beyond the
    /// maximum reads as maximum), else in the last bin.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers, or the coordinate of a scale alignment isn't positive.
    pub fn predict(&self, query: &[f64]) -> Result<(Distribution, Support), Error> {
        crate::error::query(self.dim(), query)?;
        let predictions = self.predict_batch(query)?;
        Ok((predictions.distribution(0), predictions.support[0]))
    }

    /// The distributions at many queries (row by row, Q x `dim`), in parallel. Each row depends on its query
    /// alone, so the number of threads changes no bit.
    ///
    /// # Errors
    /// As [`NpReg::predict`], at any query.
    pub fn predict_batch(&self, queries: &[f64]) -> Result<Predictions, Error> {
        let dim = self.dim();
        if !queries.len().is_multiple_of(dim) {
            return Err(Error::Dimension { expected: dim, found: queries.len() % dim });
        }
        let bins = self.options.grid.bins;
        let mut mass = vec![0.0; queries.len() / dim * bins];
        let rows: Result<Vec<(f64, Support)>, Error> = mass
            .par_chunks_mut(bins)
            .zip(queries.par_chunks(dim))
            .map_init(Scratch::default, |scratch, (row, query)| self.predict_into(query, scratch, row))
            .collect();
        let (points, support) = rows?.into_iter().unzip();
        Ok(Predictions {
            grid: self.options.grid,
            point_mass_at: self.options.point_mass_at,
            mass,
            points,
            support,
        })
    }

    /// Fills `row`, all zeros, with the bin masses at `query`; gives the probability of the point mass.
    fn predict_into(
        &self,
        query: &[f64],
        scratch: &mut Scratch,
        row: &mut [f64],
    ) -> Result<(f64, Support), Error> {
        let Scratch { weights, row: raw } = scratch;
        let support = self.smoother.weights(query, weights)?;
        let mut point: f64 = weights.iter().map(|&(i, w)| w * self.histograms.points[i]).sum();
        let above = match self.options.alignment {
            Alignment::Identity => {
                for &(i, w) in weights.iter() {
                    let (bins, masses) = self.histograms.of(i);
                    for (&b, m) in bins.iter().zip(masses) {
                        row[b as usize] += w * m;
                    }
                }
                0.0
            }
            Alignment::Shift { state_dim } => self.shifted(query[state_dim], weights, raw, row),
            Alignment::Scale { state_dim } => {
                let scale = positive("the state coordinate of a scale alignment", query[state_dim])?;
                self.scaled(scale, weights, row)
            }
        };
        if above > 0.0 {
            let last = row.len() - 1;
            match self.options.point_mass_at {
                Some(at) if at >= self.options.grid.centre(last) => point += above,
                _ => row[last] += above,
            }
        }
        if let Some(taps) = &self.taps {
            raw.clear();
            raw.extend_from_slice(row);
            row.fill(0.0);
            taps.spread(raw, row);
        }
        Ok((point, support))
    }

    /// Adds the weighted histograms of z - x to `row`, shifted up by `shift`. Gives the mass above the grid.
    fn shifted(&self, shift: f64, weights: &[(usize, f64)], raw: &mut Vec<f64>, row: &mut [f64]) -> f64 {
        // An aligned bin moves by whole bins and a fraction. `raw` takes what the whole bins leave in the grid,
        // with one more bin at either end for the rest; then the fraction is split between neighbours.
        let grid = &self.options.grid;
        // Beyond these limits nothing stays within the grid, and whole bins would not fit an i32.
        let limit = MAX_BINS as f64 - 1.0;
        let offset = ((shift - grid.lo) / grid.width).clamp(-limit, limit);
        let fraction = offset - offset.floor();
        let whole = offset.floor() as i32;
        let (below, above) = (-1 - whole, row.len() as i32 - whole);
        raw.clear();
        raw.resize(row.len() + 2, 0.0);
        for &(i, w) in weights {
            let (bins, masses) = self.histograms.of(i);
            for (&b, m) in bins.iter().zip(masses) {
                raw[(b.clamp(below, above) - below) as usize] += w * m;
            }
        }
        row[0] += raw[0];
        for (b, mass) in row.iter_mut().enumerate() {
            let below = if b == 0 { 0.0 } else { raw[b] };
            *mass += (1.0 - fraction) * raw[b + 1] + fraction * below;
        }
        fraction * raw[row.len()] + raw[row.len() + 1]
    }

    /// Adds the weighted histograms of z / x to `row`, scaled up by `scale`. Gives the mass above the grid.
    fn scaled(&self, scale: f64, weights: &[(usize, f64)], row: &mut [f64]) -> f64 {
        let grid = &self.options.grid;
        // Finite, as bin 0 times infinity would be NaN.
        let step = (self.aligned_width * scale / grid.width).min(f64::MAX);
        let start = -grid.lo / grid.width;
        let mut above = 0.0;
        for &(i, w) in weights {
            let (bins, masses) = self.histograms.of(i);
            for (&b, m) in bins.iter().zip(masses) {
                let from = start + f64::from(b) * step;
                above += deposit(from, from + step, w * m, row);
            }
        }
        above
    }
}

/// Spreads `mass` evenly over [`from`, `to`) in units of bins, what lies below bin 0 into it. Gives what lies
/// above the last bin.
fn deposit(from: f64, to: f64, mass: f64, row: &mut [f64]) -> f64 {
    let bins = row.len() as f64;
    let length = to - from;
    if from >= bins {
        return mass;
    }
    // An interval too short to divide by counts where it starts.
    if to <= 0.0 || length < 1e-9 {
        row[from.max(0.0) as usize] += mass;
        return 0.0;
    }
    let density = mass / length;
    row[0] += density * (-from).max(0.0);
    let (inner_from, inner_to) = (from.max(0.0), to.min(bins));
    let first = inner_from as usize;
    for (k, cell) in row[first..inner_to.ceil() as usize].iter_mut().enumerate() {
        let edge = (first + k) as f64;
        let overlap = inner_to.min(edge + 1.0) - inner_from.max(edge);
        *cell += density * overlap.max(0.0);
    }
    density * (to - bins).max(0.0)
}

/// Width of an aligned bin. Ratios z / x have bins that are no wider than the grid's at the largest x.
fn aligned_width(options: &NpRegOptions, smoother: &Smoother) -> Result<f64, Error> {
    let dim = smoother.dim();
    match options.alignment {
        Alignment::Shift { state_dim } | Alignment::Scale { state_dim } if state_dim >= dim => {
            Err(Error::AlignmentDimension { state_dim, dim })
        }
        Alignment::Identity | Alignment::Shift { .. } => Ok(options.grid.width),
        Alignment::Scale { state_dim } => {
            let mut largest: f64 = 0.0;
            for i in 0..smoother.len() {
                let x = smoother.state(i)[state_dim];
                largest = largest.max(positive("the state coordinate of a scale alignment", x)?);
            }
            Ok(options.grid.width / largest)
        }
    }
}

impl Histograms {
    /// Occupied bins and their masses at state `i`.
    #[inline]
    fn of(&self, i: usize) -> (&[i32], &[f64]) {
        let start = if i == 0 { 0 } else { self.ends[i - 1] };
        let end = self.ends[i];
        (&self.bins[start..end], &self.masses[start..end])
    }

    /// Checks what a prediction relies on, for histograms that come from a file.
    fn validate(&self, options: &NpRegOptions, states: usize) -> Result<(), Error> {
        for (what, expected, found) in [
            ("number of histograms", states, self.ends.len()),
            ("number of point shares", states, self.points.len()),
            ("number of masses", self.bins.len(), self.masses.len()),
            ("end of the last histogram", self.bins.len(), self.ends.last().copied().unwrap_or(0)),
        ] {
            if expected != found {
                return Err(Error::Length { what, expected, found });
            }
        }
        let in_grid = |b: i32| b >= 0 && (b as usize) < options.grid.bins;
        let is_share = |m: f64| (0.0..=1.0).contains(&m);
        let valid = self.ends.is_sorted()
            && (options.alignment != Alignment::Identity || self.bins.iter().all(|&b| in_grid(b)))
            && self.masses.iter().chain(&self.points).all(|&m| is_share(m))
            && (0..states).all(|i| {
                let total = self.of(i).1.iter().sum::<f64>() + self.points[i];
                (total - 1.0).abs() < 1e-9
            });
        if valid { Ok(()) } else { Err(Error::NoDistribution) }
    }
}
