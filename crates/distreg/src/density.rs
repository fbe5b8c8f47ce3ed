//! ESTIMATEDENSITY of the paper: a distribution from the observations at one state.

use serde::{Deserialize, Serialize};

use crate::error::{finite, positive};
use crate::{Distribution, Error, Grid, Kernel, Outcomes, PointMass};

/// Gaussian taps end here, in bandwidths: exp(-8^2 / 2) = 1e-14.
const GAUSSIAN_REACH: f64 = 8.0;

/// How a density is estimated from the observations at a state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityEstimate {
    /// Histogram over the bins (eq. 6).
    #[default]
    Histogram,
    /// Kernel density (eq. 5).
    Kernel {
        /// Kernel over z.
        kernel: Kernel,
        /// Its bandwidth, in units of z.
        bandwidth: f64,
    },
}

/// Histogram of `observations` (eq. 6). Observations at the point mass count as that, the others in their bin.
///
/// # Errors
/// If there are no observations, a number isn't finite or the grid is invalid.
pub fn histogram(observations: &[f64], outcomes: &Outcomes) -> Result<Distribution, Error> {
    outcomes.validate()?;
    let grid = outcomes.grid;
    if observations.is_empty() {
        return Err(Error::Empty { what: "the observations of a histogram" });
    }
    let mut mass = vec![0.0; grid.bins];
    let mut point = outcomes.point_mass_at.map(|at| PointMass { at, mass: 0.0 });
    for &z in observations {
        finite("an observation", z)?;
        match &mut point {
            Some(point) if z == point.at => point.mass += 1.0,
            _ => mass[grid.bin(z)] += 1.0,
        }
    }
    Distribution::new(grid, mass, point)
}

/// Kernel density of `observations` (eq. 5) on the bins of `grid`: each observation's bin is spread over the
/// bins around it by the kernel at bin distances, reflected at the ends of the grid. The point mass stays sharp.
/// `bandwidth` is in units of z.
///
/// # Errors
/// As [`histogram`], and if the bandwidth isn't positive.
pub fn kernel_density(
    observations: &[f64],
    outcomes: &Outcomes,
    kernel: Kernel,
    bandwidth: f64,
) -> Result<Distribution, Error> {
    positive("the observation bandwidth", bandwidth)?;
    let histogram = histogram(observations, outcomes)?;
    let grid = outcomes.grid;
    let mut mass = vec![0.0; grid.bins];
    Taps::new(&grid, kernel, bandwidth).spread(histogram.mass(), &mut mass);
    Ok(Distribution::normalized(grid, mass, histogram.point()))
}

/// A kernel over bins: weights at bin distances 0, 1, 2, ...; both sides together sum to 1.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Taps(Vec<f64>);

impl Taps {
    /// `bandwidth` is positive, in units of z.
    pub(crate) fn new(grid: &Grid, kernel: Kernel, bandwidth: f64) -> Self {
        let reach = match kernel {
            Kernel::Gaussian => GAUSSIAN_REACH,
            Kernel::Boxcar | Kernel::Epanechnikov => kernel.support(),
        };
        let count = ((reach * bandwidth / grid.width) as usize).min(grid.bins);
        let mut taps: Vec<f64> =
            (0..=count).map(|k| kernel.at_squared((k as f64 * grid.width / bandwidth).powi(2))).collect();
        let total = taps[0] + 2.0 * taps[1..].iter().sum::<f64>();
        for tap in &mut taps {
            *tap /= total;
        }
        Self(taps)
    }

    /// Adds the bins of `from`, spread, to `to`; reflection at the ends keeps the sum.
    pub(crate) fn spread(&self, from: &[f64], to: &mut [f64]) {
        let bins = from.len();
        let reflect = |b: isize| {
            let b = b.rem_euclid(2 * bins as isize) as usize;
            if b < bins { b } else { 2 * bins - 1 - b }
        };
        for (b, &mass) in from.iter().enumerate() {
            if mass == 0.0 {
                continue;
            }
            to[b] += mass * self.0[0];
            for (k, tap) in self.0.iter().enumerate().skip(1) {
                to[reflect(b as isize - k as isize)] += mass * tap;
                to[reflect((b + k) as isize)] += mass * tap;
            }
        }
    }
}
