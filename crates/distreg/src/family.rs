//! The parametric families of P-REG: maximum likelihood at one state, and the scale on which each parameter is
//! regressed.

use std::f64::consts::{PI, SQRT_2};

use serde::{Deserialize, Serialize};
use statrs::function::erf::erfc;
use statrs::function::gamma::digamma;

use crate::alignment::Affine;

/// Rounds of expectation maximization, and the gain of mean log likelihood below which it ends: far less than the 1 / M
/// that M observations leave uncertain.
const MOST_ROUNDS: usize = 50;
const LEAST_GAIN: f64 = 1e-5;

/// A parametric family of p(z | x).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// One Gaussian, as published (eq. 4).
    #[default]
    Gaussian,
    /// Two Gaussians, ordered by their means: the first has the smaller.
    TwoGaussians,
    /// A Gaussian and an exponential that falls from the low end of the grid: the classic model of a range sensor
    /// with unmodelled objects.
    GaussianExponential,
}

/// The second part of a mixture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Second {
    /// A Gaussian.
    Gaussian {
        /// Mean, in units of z.
        mean: f64,
        /// Standard deviation, in units of z.
        sigma: f64,
    },
    /// An exponential from the low end of the grid.
    Exponential {
        /// Mean distance from the low end, in units of z.
        scale: f64,
    },
}

/// Parameters of a family at one state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Mean of the Gaussian, in units of z.
    pub mean: f64,
    /// Standard deviation of the Gaussian, in units of z.
    pub sigma: f64,
    /// The second part and its share, for mixtures.
    pub second: Option<(f64, Second)>,
}

impl Parameters {
    /// P(Z <= z), for an exponential that starts at `lo`.
    pub(crate) fn cdf(&self, lo: f64, z: f64) -> f64 {
        let first = normal_cdf((z - self.mean) / self.sigma);
        match self.second {
            None => first,
            Some((share, second)) => (1.0 - share) * first + share * second.cdf(lo, z),
        }
    }
}

impl Second {
    fn cdf(self, lo: f64, z: f64) -> f64 {
        match self {
            Self::Gaussian { mean, sigma } => normal_cdf((z - mean) / sigma),
            Self::Exponential { scale } => -(-(z - lo).max(0.0) / scale).exp_m1(),
        }
    }

    fn density(self, lo: f64, z: f64) -> f64 {
        match self {
            Self::Gaussian { mean, sigma } => normal_density(z, mean, sigma),
            Self::Exponential { scale } => (-(z - lo).max(0.0) / scale).exp() / scale,
        }
    }
}

fn normal_cdf(u: f64) -> f64 {
    0.5 * erfc(-u / SQRT_2)
}

fn normal_density(z: f64, mean: f64, sigma: f64) -> f64 {
    (-0.5 * ((z - mean) / sigma).powi(2)).exp() / (sigma * (2.0 * PI).sqrt())
}

/// Mean and standard deviation (with n - 1) of the observations at one state, eq. 4 with the square root that
/// the paper omits. The deviation is `None` for a single observation, the mean NaN for none.
pub fn gaussian_parameters(observations: &[f64]) -> (f64, Option<f64>) {
    let n = observations.len() as f64;
    let mean = observations.iter().sum::<f64>() / n;
    let squares: f64 = observations.iter().map(|z| (z - mean).powi(2)).sum();
    let sigma = (observations.len() > 1).then(|| (squares / (n - 1.0)).sqrt());
    (mean, sigma)
}

impl Family {
    /// Number of values that are regressed.
    pub(crate) fn values(self) -> usize {
        match self {
            Self::Gaussian => 2,
            Self::GaussianExponential => 4,
            Self::TwoGaussians => 5,
        }
    }

    /// The maximum-likelihood parameters of observations at one state. No deviation is below `least`.
    pub(crate) fn estimate(self, observations: &[f64], lo: f64, least: f64) -> Parameters {
        let (mean, sigma) = gaussian_parameters(observations);
        let sigma = sigma.unwrap_or(0.0).max(least);
        let mut sorted = observations.to_vec();
        sorted.sort_by(f64::total_cmp);
        let gaussian = |part: &[f64]| {
            let (mean, sigma) = gaussian_parameters(part);
            (mean, sigma.unwrap_or(0.0).max(least))
        };
        let starts: Vec<Parameters> = match self {
            Self::Gaussian => return Parameters { mean, sigma, second: None },
            // Splits of the sorted observations.
            Self::TwoGaussians => [0.15, 0.5, 0.85]
                .into_iter()
                .map(|share| {
                    let cut = ((share * sorted.len() as f64) as usize).clamp(1, sorted.len().max(2) - 1);
                    let (low, high) = sorted.split_at(cut.min(sorted.len()));
                    let (first, second) = (gaussian(low), gaussian(if high.is_empty() { low } else { high }));
                    let part = Second::Gaussian { mean: second.0, sigma: second.1 };
                    Parameters { mean: first.0, sigma: first.1, second: Some((1.0 - share, part)) }
                })
                .collect(),
            // A Gaussian around the middle of the upper or of all observations; an exponential of the whole.
            Self::GaussianExponential => [0.5, 0.75]
                .into_iter()
                .map(|level| {
                    let n = sorted.len() as f64;
                    let at = |share: f64| sorted[((share * n) as usize).min(sorted.len() - 1)];
                    let sigma = ((at(level + 0.125) - at(level - 0.125)) / 0.64).max(least);
                    let scale = (mean - lo).max(least);
                    Parameters { mean: at(level), sigma, second: Some((0.25, Second::Exponential { scale })) }
                })
                .collect(),
        };
        // A sensor's readings repeat; each value counts once, with its number.
        let values: Vec<(f64, f64)> =
            sorted.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as f64)).collect();
        let fits = starts.into_iter().map(|start| maximize(start, &values, lo, least));
        let best = fits.reduce(|a, b| if b.1 > a.1 { b } else { a });
        let mut best = best.map_or(Parameters { mean, sigma, second: None }, |fit| fit.0);
        if let Some((share, Second::Gaussian { mean, sigma })) = best.second
            && mean < best.mean
        {
            best = Parameters {
                mean,
                sigma,
                second: Some((1.0 - share, Second::Gaussian { mean: best.mean, sigma: best.sigma })),
            };
        }
        best
    }

    /// Appends the regressed values of the parameters of `n` observations: places aligned, deviations and scales
    /// as logarithms (a positive number whose error is relative), shares as they are.
    pub(crate) fn encode(self, parameters: &Parameters, n: usize, affine: Affine, out: &mut Vec<f64>) {
        // The logarithm of a sample deviation with nu = n - 1 degrees of freedom lies below that of sigma by
        // (ln(nu / 2) - digamma(nu / 2)) / 2 in the mean, for a Gaussian.
        let bias = match self {
            Self::Gaussian if n > 1 => {
                let half = 0.5 * (n - 1) as f64;
                0.5 * (half.ln() - digamma(half))
            }
            _ => 0.0,
        };
        out.extend([affine.align(parameters.mean), (parameters.sigma / affine.scale).ln() + bias]);
        match parameters.second {
            None => (),
            Some((share, Second::Gaussian { mean, sigma })) => {
                out.extend([share, affine.align(mean), (sigma / affine.scale).ln()]);
            }
            Some((share, Second::Exponential { scale })) => out.extend([share, scale.ln()]),
        }
    }

    /// The parameters of regressed values. No deviation is below `least`.
    pub(crate) fn decode(self, values: &[f64], affine: Affine, least: f64) -> Parameters {
        let sigma = |ln: f64| (affine.scale * ln.exp()).clamp(least, f64::MAX);
        let second = match self {
            Self::Gaussian => None,
            Self::TwoGaussians => {
                let part = Second::Gaussian { mean: affine.restore(values[3]), sigma: sigma(values[4]) };
                Some((values[2].clamp(0.0, 1.0), part))
            }
            Self::GaussianExponential => {
                let part = Second::Exponential { scale: values[3].exp().clamp(least, f64::MAX) };
                Some((values[2].clamp(0.0, 1.0), part))
            }
        };
        Parameters { mean: affine.restore(values[0]), sigma: sigma(values[1]), second }
    }
}

/// Expectation maximization (Dempster, Laird and Rubin 1977) over (value, count) from a start; gives the parameters and
/// their mean log likelihood.
fn maximize(start: Parameters, values: &[(f64, f64)], lo: f64, least: f64) -> (Parameters, f64) {
    let n: f64 = values.iter().map(|value| value.1).sum();
    let mut at = start;
    let mut likelihood = f64::NEG_INFINITY;
    // How much of each value's count is the second part's.
    let mut second_counts = vec![0.0; values.len()];
    for _ in 0..MOST_ROUNDS {
        let Some((share, second)) = at.second else { break };
        let mut sum = 0.0;
        for (part, &(z, count)) in second_counts.iter_mut().zip(values) {
            let first = (1.0 - share) * normal_density(z, at.mean, at.sigma);
            let other = share * second.density(lo, z);
            let total = (first + other).max(f64::MIN_POSITIVE);
            *part = count * other / total;
            sum += count * total.ln();
        }
        let gain = sum / n - likelihood;
        likelihood = sum / n;
        if gain < LEAST_GAIN {
            break;
        }
        let weight: f64 = second_counts.iter().sum();
        let moments = |weight: f64, part: &dyn Fn(f64, f64) -> f64| {
            let pairs = || values.iter().zip(&second_counts).map(|(v, &second)| (v.0, part(v.1, second)));
            let mean = pairs().map(|(z, w)| w * z).sum::<f64>() / weight;
            let square = pairs().map(|(z, w)| w * (z - mean).powi(2)).sum::<f64>() / weight;
            (mean, square.sqrt().max(least))
        };
        // A part that explains less than a tenth of an observation keeps its place.
        if n - weight > 0.1 {
            (at.mean, at.sigma) = moments(n - weight, &|count, second| count - second);
        }
        let second = match second {
            second if weight <= 0.1 => second,
            Second::Gaussian { .. } => {
                let (mean, sigma) = moments(weight, &|_, second| second);
                Second::Gaussian { mean, sigma }
            }
            Second::Exponential { .. } => {
                let distances = values.iter().zip(&second_counts).map(|(v, w)| w * (v.0 - lo).max(0.0));
                Second::Exponential { scale: (distances.sum::<f64>() / weight).max(least) }
            }
        };
        at.second = Some((weight / n, second));
    }
    (at, likelihood)
}
