use serde::{Deserialize, Serialize};

use crate::density::Taps;
use crate::distribution::MAX_BINS;
use crate::error::positive;
use crate::{
    Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, Error, Outcomes, Regressor,
    Scratch, Smoother, Support, Weighting,
};

/// Nonparametric distribution regression (procedure 2, NP-REG) with its settings. As published, the alignment is
/// [`Alignment::Identity`], the density estimate a histogram and the degree [`Degree::Constant`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NpRegOptions {
    /// The possible outcomes.
    pub outcomes: Outcomes,
    /// The quantity that is smoothed over states.
    pub alignment: Alignment,
    /// ESTIMATEDENSITY of the paper.
    pub density: DensityEstimate,
    /// How much each state counts at a query.
    pub weighting: Weighting,
    /// Mean of the densities around a query, or the mean balanced as a plane would be
    /// ([`Smoother::positive_weights`]).
    pub degree: Degree,
}

/// The model fitted by [`NpRegOptions`]: a histogram at each training state; predictions are their weighted mean (eq. 7).
///
/// An aligned histogram that is moved beyond the low end of the grid counts in the first bin; beyond the high end,
/// as the point mass where that lies at the high end (a range beyond the maximum reads as maximum), else in the
/// last bin.
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

impl Regressor for NpRegOptions {
    type Model = NpReg;

    fn fit(&self, data: &Dataset) -> Result<NpReg, Error> {
        let smoother = Smoother::new(data, &self.weighting)?;
        self.outcomes.validate()?;
        let width = aligned_width(self, &smoother)?;
        let mut histograms = Histograms {
            ends: Vec::with_capacity(data.len()),
            bins: Vec::new(),
            masses: Vec::new(),
            points: Vec::with_capacity(data.len()),
        };
        let mut bins: Vec<i32> = Vec::new();
        for i in 0..data.len() {
            let observations = data.observations(i);
            let affine = self.alignment.at(data.state(i))?;
            bins.clear();
            bins.extend(observations.iter().filter(|&&z| !self.outcomes.is_point(z)).map(|&z| {
                match self.alignment {
                    Alignment::Identity => self.outcomes.grid.bin(z) as i32,
                    Alignment::Shift { .. } | Alignment::Scale { .. } => {
                        (affine.align(z) / width).floor() as i32
                    }
                }
            }));
            let count = observations.len() as f64;
            histograms.points.push((observations.len() - bins.len()) as f64 / count);
            bins.sort_unstable();
            for same in bins.chunk_by(|a, b| a == b) {
                histograms.bins.push(same[0]);
                histograms.masses.push(same.len() as f64 / count);
            }
            histograms.ends.push(histograms.bins.len());
        }
        NpReg::assemble(self.clone(), smoother, histograms)
    }

    fn outcomes(&self) -> Outcomes {
        self.outcomes
    }
}

impl NpReg {
    fn assemble(options: NpRegOptions, smoother: Smoother, histograms: Histograms) -> Result<Self, Error> {
        options.outcomes.validate()?;
        let taps = match options.density {
            DensityEstimate::Histogram => None,
            DensityEstimate::Kernel { kernel, bandwidth } => {
                positive("the observation bandwidth", bandwidth)?;
                Some(Taps::new(&options.outcomes.grid, kernel, bandwidth))
            }
        };
        Ok(Self { aligned_width: aligned_width(&options, &smoother)?, options, smoother, histograms, taps })
    }

    /// The options of the fit.
    pub fn options(&self) -> &NpRegOptions {
        &self.options
    }

    /// Adds the weighted histograms of z - x to `row`, shifted up by `shift`. Gives the mass above the grid.
    fn shifted(&self, shift: f64, weights: &[(usize, f64)], raw: &mut Vec<f64>, row: &mut [f64]) -> f64 {
        // An aligned bin moves by whole bins and a fraction. `raw` takes what the whole bins leave in the grid,
        // with one more bin at either end for the rest; then the fraction is split between neighbours.
        let grid = &self.options.outcomes.grid;
        // Beyond these limits nothing stays within the grid, and whole bins would not fit an i32.
        let limit = MAX_BINS as f64 - 1.0;
        let offset = ((shift - grid.lo) / grid.width).clamp(-limit, limit);
        let fraction = offset - offset.floor();
        let whole = offset.floor() as i32;
        let (below, above) = (-1 - whole, row.len() as i32 - whole);
        let end = row.len() + 1;
        raw.clear();
        raw.resize(row.len() + 2, 0.0);
        for &(i, w) in weights {
            // Bins rise, so those beyond either end are a beginning and an end; mostly there are none.
            let (bins, masses) = self.histograms.of(i);
            let (Some(&lowest), Some(&highest)) = (bins.first(), bins.last()) else { continue };
            let first = if lowest > below { 0 } else { bins.partition_point(|&b| b <= below) };
            let last = if highest < above { bins.len() } else { bins.partition_point(|&b| b < above) };
            raw[0] += w * masses[..first].iter().sum::<f64>();
            for (&b, m) in bins[first..last].iter().zip(&masses[first..last]) {
                raw[(b - below) as usize] += w * m;
            }
            raw[end] += w * masses[last..].iter().sum::<f64>();
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
        let grid = &self.options.outcomes.grid;
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

impl ConditionalDistribution for NpReg {
    fn dim(&self) -> usize {
        self.smoother.dim()
    }

    fn outcomes(&self) -> Outcomes {
        self.options.outcomes
    }

    fn predict_into(
        &self,
        query: &[f64],
        scratch: &mut Scratch,
        mass: &mut [f64],
    ) -> Result<(f64, Support), Error> {
        let Scratch { weights, bins: raw, .. } = scratch;
        let support = self.smoother.positive_weights(query, self.options.degree, weights)?;
        let mut point: f64 = weights.iter().map(|&(i, w)| w * self.histograms.points[i]).sum();
        let affine = self.options.alignment.at(query)?;
        let above = match self.options.alignment {
            Alignment::Identity => {
                for &(i, w) in weights.iter() {
                    let (bins, masses) = self.histograms.of(i);
                    for (&b, m) in bins.iter().zip(masses) {
                        mass[b as usize] += w * m;
                    }
                }
                0.0
            }
            Alignment::Shift { .. } => self.shifted(affine.offset, weights, raw, mass),
            Alignment::Scale { .. } => self.scaled(affine.scale, weights, mass),
        };
        if above > 0.0 {
            point += self.options.outcomes.absorb_above(above, mass);
        }
        if let Some(taps) = &self.taps {
            raw.clear();
            raw.extend_from_slice(mass);
            mass.fill(0.0);
            taps.spread(raw, mass);
        }
        Ok((point, support))
    }
}

/// Spreads `mass` evenly over [`from`, `to`) in units of bins; mass below bin 0 counts in it. Returns the mass above the
/// last bin.
pub(crate) fn deposit(from: f64, to: f64, mass: f64, row: &mut [f64]) -> f64 {
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
    let mut largest = 0.0;
    for i in 0..smoother.len() {
        largest = options.alignment.at(smoother.state(i))?.scale.max(largest);
    }
    Ok(options.outcomes.grid.width / largest)
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
        let in_grid = |b: i32| b >= 0 && (b as usize) < options.outcomes.grid.bins;
        let is_share = |m: f64| (0.0..=1.0).contains(&m);
        let valid = self.ends.is_sorted()
            && (options.alignment != Alignment::Identity || self.bins.iter().all(|&b| in_grid(b)))
            && self.masses.iter().chain(&self.points).all(|&m| is_share(m))
            && (0..states).all(|i| {
                let (bins, masses) = self.of(i);
                let total = masses.iter().sum::<f64>() + self.points[i];
                bins.is_sorted() && (total - 1.0).abs() < 1e-9
            });
        if valid { Ok(()) } else { Err(Error::NoDistribution) }
    }
}
