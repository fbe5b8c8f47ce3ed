use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::{finite, positive};

/// Largest number of bins; bin numbers then fit an `i32` even after an alignment.
pub(crate) const MAX_BINS: usize = 1 << 30;

/// Equal bins over the observation: bin b covers [`lo` + b `width`, `lo` + (b + 1) `width`). Observations beyond
/// either end count as the end bin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Lower edge of the first bin, in units of z.
    pub lo: f64,
    /// Width of a bin, positive, in units of z.
    pub width: f64,
    /// Number of bins B.
    pub bins: usize,
}

impl Grid {
    /// Bins centred on the values `first`, `first + resolution`, ... up to `last` that a sensor can report; a
    /// laser with 0 to 4.5 m in steps of 1 mm has 4501.
    ///
    /// # Errors
    /// If a number isn't finite, `resolution` isn't positive or `last` is below `first`.
    pub fn of_values(first: f64, last: f64, resolution: f64) -> Result<Self, Error> {
        finite("the first value of a grid", first)?;
        positive("the resolution of a grid", resolution)?;
        let values = ((last - first) / resolution).round() + 1.0;
        let bins = positive("the number of values of a grid", values)? as usize;
        let grid = Self { lo: first - 0.5 * resolution, width: resolution, bins };
        grid.validate()?;
        Ok(grid)
    }

    /// Upper edge of the last bin.
    pub fn hi(&self) -> f64 {
        self.lo + self.bins as f64 * self.width
    }

    /// Centre of bin `b`.
    pub fn centre(&self, b: usize) -> f64 {
        self.lo + (b as f64 + 0.5) * self.width
    }

    /// The bin that `z` counts in; beyond the ends, the end bin.
    pub fn bin(&self, z: f64) -> usize {
        // The cast takes negative numbers and NaN to zero.
        (((z - self.lo) / self.width) as usize).min(self.bins.saturating_sub(1))
    }

    pub(crate) fn validate(&self) -> Result<(), Error> {
        finite("the lower end of a grid", self.lo)?;
        positive("the bin width of a grid", self.width)?;
        finite("the upper end of a grid", self.hi())?;
        if self.bins == 0 || self.bins > MAX_BINS {
            return Err(Error::Bins { found: self.bins, most: MAX_BINS });
        }
        Ok(())
    }
}

/// The possible outcomes of an observation: the bins of a grid, and a value that has a probability of its own, such as
/// a laser's maximum range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outcomes {
    /// Bins of every distribution.
    pub grid: Grid,
    /// Observations equal to this value are a point mass. It is smoothed over states as one number and never
    /// aligned.
    #[serde(default)]
    pub point_mass_at: Option<f64>,
}

impl Outcomes {
    /// The values `first`, `first + resolution`, ... up to `last` that a sensor can report, a bin each (see
    /// [`Grid::of_values`]), and no point mass.
    ///
    /// # Errors
    /// If a number isn't finite, `resolution` isn't positive or `last` is below `first`.
    pub fn of_values(first: f64, last: f64, resolution: f64) -> Result<Self, Error> {
        Ok(Self { grid: Grid::of_values(first, last, resolution)?, point_mass_at: None })
    }

    /// The same outcomes with a point mass at `z`.
    #[must_use]
    pub fn with_point_mass(self, z: f64) -> Self {
        Self { point_mass_at: Some(z), ..self }
    }

    /// Whether `z` is the point mass.
    pub fn is_point(&self, z: f64) -> bool {
        self.point_mass_at == Some(z)
    }

    pub(crate) fn validate(&self) -> Result<(), Error> {
        self.grid.validate()?;
        self.point_mass_at.map_or(Ok(()), |at| finite("the place of a point mass", at).map(|_| ()))
    }

    /// Accounts for mass above the grid: it is the point mass where that lies at the high end (a range beyond the
    /// maximum reads as maximum), else it counts in the last bin. Gives what is added to the point mass.
    pub(crate) fn absorb_above(&self, above: f64, mass: &mut [f64]) -> f64 {
        let last = self.grid.bins - 1;
        match self.point_mass_at {
            Some(at) if at >= self.grid.centre(last) => above,
            _ => {
                mass[last] += above;
                0.0
            }
        }
    }
}

/// A value that is observed with positive probability, such as a laser's maximum range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointMass {
    /// The value, in units of z.
    pub at: f64,
    /// Its probability.
    pub mass: f64,
}

/// A distribution of z: constant density within each bin of a grid, and possibly a point mass. The bins and the
/// point mass sum to 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct Distribution {
    grid: Grid,
    mass: Vec<f64>,
    point: Option<PointMass>,
    /// Sum of `mass` up to and including each bin.
    cumulative: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    grid: Grid,
    mass: Vec<f64>,
    point: Option<PointMass>,
}

impl From<Distribution> for Parts {
    fn from(distribution: Distribution) -> Self {
        Self { grid: distribution.grid, mass: distribution.mass, point: distribution.point }
    }
}

impl TryFrom<Parts> for Distribution {
    type Error = Error;
    fn try_from(parts: Parts) -> Result<Self, Error> {
        Self::new(parts.grid, parts.mass, parts.point)
    }
}

impl Distribution {
    /// A distribution with `mass` in the bins of `grid`, and a point mass; all are scaled to sum to 1.
    ///
    /// # Errors
    /// If the grid is invalid, `mass` hasn't one element per bin, or the masses are no distribution.
    pub fn new(grid: Grid, mut mass: Vec<f64>, mut point: Option<PointMass>) -> Result<Self, Error> {
        grid.validate()?;
        if mass.len() != grid.bins {
            return Err(Error::Length {
                what: "number of bin masses",
                expected: grid.bins,
                found: mass.len(),
            });
        }
        if let Some(point) = point {
            finite("the place of a point mass", point.at)?;
        }
        let point_mass = point.map_or(0.0, |p| p.mass);
        let total = mass.iter().sum::<f64>() + point_mass;
        let valid = |m: f64| m >= 0.0 && m.is_finite();
        if !(mass.iter().copied().all(valid) && valid(point_mass) && valid(total) && total > 0.0) {
            return Err(Error::NoDistribution);
        }
        for m in &mut mass {
            *m /= total;
        }
        if let Some(point) = &mut point {
            point.mass /= total;
        }
        Ok(Self::normalized(grid, mass, point))
    }

    /// As [`Distribution::new`], for masses known to be a distribution.
    pub(crate) fn normalized(grid: Grid, mass: Vec<f64>, point: Option<PointMass>) -> Self {
        let mut sum = 0.0;
        let cumulative = mass
            .iter()
            .map(|m| {
                sum += m;
                sum
            })
            .collect();
        Self { grid, mass, point, cumulative }
    }

    /// The bins.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Probability of each bin, without the point mass.
    pub fn mass(&self) -> &[f64] {
        &self.mass
    }

    /// The point mass, if the distribution has one.
    pub fn point(&self) -> Option<PointMass> {
        self.point
    }

    /// p(z): the probability itself where `z` equals the place of the point mass exactly, else the density per
    /// unit of z, 0 outside the grid. NaN has density 0.
    pub fn density(&self, z: f64) -> f64 {
        match self.point {
            Some(point) if z == point.at => point.mass,
            _ if z >= self.grid.lo && z < self.grid.hi() => self.mass[self.grid.bin(z)] / self.grid.width,
            _ => 0.0,
        }
    }

    /// P(Z <= z).
    pub fn cdf(&self, z: f64) -> f64 {
        let point = self.point.map_or(0.0, |p| if z >= p.at { p.mass } else { 0.0 });
        self.continuous_cdf(z) + point
    }

    /// The share of P(Z <= z) that lies in the bins.
    pub(crate) fn continuous_cdf(&self, z: f64) -> f64 {
        let position = (z - self.grid.lo) / self.grid.width;
        if position <= 0.0 {
            return 0.0;
        }
        if position >= self.grid.bins as f64 {
            return self.cumulative[self.grid.bins - 1];
        }
        let b = position as usize;
        let within = (position - b as f64) * self.mass[b];
        if b == 0 { within } else { self.cumulative[b - 1] + within }
    }

    /// The smallest z with cdf(z) >= u; `u` is limited to 0..=1, and u = 0 gives the lower end of the support.
    pub fn quantile(&self, u: f64) -> f64 {
        let u = u.clamp(0.0, 1.0);
        let Some(point) = self.point else {
            return self.continuous_quantile(u);
        };
        let before = self.continuous_cdf(point.at);
        let reached = if u > 0.0 { u > before } else { before <= 0.0 };
        if !reached || point.mass == 0.0 {
            self.continuous_quantile(u)
        } else if u <= before + point.mass || before >= self.cumulative[self.grid.bins - 1] {
            point.at
        } else {
            self.continuous_quantile(u - point.mass)
        }
    }

    /// The smallest z at which the bins' share of the cdf reaches `v`.
    fn continuous_quantile(&self, v: f64) -> f64 {
        let v = v.min(self.cumulative[self.grid.bins - 1]);
        let b = if v > 0.0 {
            self.cumulative.partition_point(|&c| c < v)
        } else {
            self.cumulative.partition_point(|&c| c <= 0.0)
        };
        let b = b.min(self.grid.bins - 1);
        let before = if b == 0 { 0.0 } else { self.cumulative[b - 1] };
        let within = if self.mass[b] > 0.0 { ((v - before) / self.mass[b]).clamp(0.0, 1.0) } else { 0.0 };
        self.grid.lo + (b as f64 + within) * self.grid.width
    }

    /// A draw from the distribution by inversion of a uniform number `u` in (0, 1).
    pub fn sample(&self, u: f64) -> f64 {
        self.quantile(u)
    }

    /// Mean of z.
    pub fn mean(&self) -> f64 {
        let bins: f64 = self.mass.iter().enumerate().map(|(b, m)| m * self.grid.centre(b)).sum();
        bins + self.point.map_or(0.0, |p| p.at * p.mass)
    }

    /// The mixture of this distribution and, with weight `share`, an equal probability for every bin and the
    /// point mass if there is one. Keeps the log loss finite on the grid.
    ///
    /// # Errors
    /// If `share` isn't within 0..=1.
    pub fn with_floor(&self, share: f64) -> Result<Self, Error> {
        if !(0.0..=1.0).contains(&share) {
            return Err(Error::NotAShare { what: "the share of a floor", value: share });
        }
        let outcomes = self.grid.bins + usize::from(self.point.is_some());
        let mix = |m: f64| (1.0 - share) * m + share / outcomes as f64;
        Ok(Self::normalized(
            self.grid,
            self.mass.iter().copied().map(mix).collect(),
            self.point.map(|p| PointMass { at: p.at, mass: mix(p.mass) }),
        ))
    }
}
