use std::f64::consts::{PI, SQRT_2};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use statrs::function::erf::erfc;

use crate::error::positive;
use crate::{Dataset, Distribution, Error, Grid, Kernel, LocallyWeightedLinear, Support};

/// Mean and standard deviation (with n - 1) of the observations at one state, eq. 4 with the square root that
/// the paper omits. The deviation is `None` for a single observation, the mean NaN for none.
pub fn gaussian_parameters(observations: &[f64]) -> (f64, Option<f64>) {
    let n = observations.len() as f64;
    let mean = observations.iter().sum::<f64>() / n;
    let squares: f64 = observations.iter().map(|z| (z - mean).powi(2)).sum();
    let sigma = (observations.len() > 1).then(|| (squares / (n - 1.0)).sqrt());
    (mean, sigma)
}

/// Parametric distribution regression (procedure 1, P-REG) with a Gaussian: its mean and standard deviation are
/// estimated at each state and regressed on the state by locally weighted linear regression.
///
/// A state with a single observation has no deviation of its own; |z - m(x)| sqrt(pi / 2) takes its place, with
/// m the regressed mean: for a Gaussian its expectation is sigma.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PReg {
    parameters: LocallyWeightedLinear,
    smallest_sigma: f64,
}

impl PReg {
    /// Learns from `data`. `smallest_sigma` is a lower limit of the predicted deviation, in units of z; the
    /// sensor's resolution / sqrt(12) is a good one.
    ///
    /// # Errors
    /// If there is no data, the bandwidths aren't `dim` positive numbers, or `smallest_sigma` isn't positive.
    pub fn fit(
        data: &Dataset,
        kernel: Kernel,
        bandwidths: &[f64],
        smallest_sigma: f64,
    ) -> Result<Self, Error> {
        positive("the smallest sigma", smallest_sigma)?;
        let regress = |targets: &[f64]| {
            LocallyWeightedLinear::fit(data.dim(), data.states(), targets, kernel, bandwidths)
        };
        let estimates: Vec<(f64, Option<f64>)> =
            (0..data.len()).map(|i| gaussian_parameters(data.observations(i))).collect();
        let sigmas = if estimates.iter().all(|(_, sigma)| sigma.is_some()) {
            estimates.iter().filter_map(|&(_, sigma)| sigma).collect()
        } else {
            let means: Vec<f64> = estimates.iter().map(|&(mean, _)| mean).collect();
            let means = regress(&means)?;
            estimates
                .par_iter()
                .enumerate()
                .map(|(i, &(mean, sigma))| {
                    if let Some(sigma) = sigma {
                        return Ok(sigma);
                    }
                    let mut smooth = [0.0];
                    means.predict(data.state(i), &mut smooth)?;
                    Ok((mean - smooth[0]).abs() * (PI / 2.0).sqrt())
                })
                .collect::<Result<Vec<f64>, Error>>()?
        };
        let targets: Vec<f64> =
            estimates.iter().zip(sigmas).flat_map(|(&(mean, _), sigma)| [mean, sigma]).collect();
        Ok(Self { parameters: regress(&targets)?, smallest_sigma })
    }

    /// Mean and standard deviation at `query`, in units of z.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers.
    pub fn parameters(&self, query: &[f64]) -> Result<(f64, f64, Support), Error> {
        let mut out = [0.0; 2];
        let support = self.parameters.predict(query, &mut out)?;
        Ok((out[0], out[1].max(self.smallest_sigma), support))
    }

    /// The Gaussian at `query` on the bins of `grid`; what lies beyond the ends counts in the end bins.
    ///
    /// # Errors
    /// As [`PReg::parameters`], and if the grid is invalid.
    pub fn predict(&self, query: &[f64], grid: Grid) -> Result<(Distribution, Support), Error> {
        grid.validate()?;
        let (mean, sigma, support) = self.parameters(query)?;
        let cdf = |edge: f64| 0.5 * erfc((mean - edge) / (sigma * SQRT_2));
        let mut before = 0.0;
        let mass = (0..grid.bins)
            .map(|b| {
                let after = if b + 1 == grid.bins { 1.0 } else { cdf(grid.lo + (b + 1) as f64 * grid.width) };
                let mass = (after - before).max(0.0);
                before = after;
                mass
            })
            .collect();
        Ok((Distribution::new(grid, mass, None)?, support))
    }
}
