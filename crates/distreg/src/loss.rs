use rand_philox::Philox;

use crate::{Distribution, Error};

/// Resamples of the bootstrap interval.
const RESAMPLES: u64 = 1000;

/// The paper's loss: the L1 norm of the difference of the cumulative sums, in bins. A point mass counts in the
/// bin it lies in.
///
/// # Errors
/// If the grids differ.
pub fn histogram_match(a: &Distribution, b: &Distribution) -> Result<f64, Error> {
    let mut sum: f64 = 0.0;
    let mut loss = 0.0;
    differences(a, b)?.for_each(|d| {
        sum += d;
        loss += sum.abs();
    });
    Ok(loss)
}

/// Wasserstein-1 distance of the binned distributions, in units of z: the histogram match times the bin width.
///
/// # Errors
/// If the grids differ.
pub fn wasserstein_1(a: &Distribution, b: &Distribution) -> Result<f64, Error> {
    Ok(histogram_match(a, b)? * a.grid().width)
}

/// Euclidean distance of the bin masses. Not a good loss: it doesn't know how far apart two bins are (Fig. 5).
///
/// # Errors
/// If the grids differ.
pub fn euclidean(a: &Distribution, b: &Distribution) -> Result<f64, Error> {
    Ok(differences(a, b)?.map(|d| d * d).sum::<f64>().sqrt())
}

/// Mean of -ln p(z) over `observations`, in nats; p is a density per unit of z, and a probability at the point
/// mass. Infinite where an observation has no density ([`Distribution::with_floor`] prevents that within the
/// grid), NaN without observations.
pub fn log_loss(distribution: &Distribution, observations: &[f64]) -> f64 {
    let sum: f64 = observations.iter().map(|&z| -distribution.density(z).ln()).sum();
    sum / observations.len() as f64
}

/// Continuous ranked probability score, the integral of (cdf(t) - [t >= z])^2 over t, in units of z (Gneiting
/// and Raftery 2007).
pub fn crps(distribution: &Distribution, z: f64) -> f64 {
    let grid = distribution.grid();
    let point = distribution.point();
    let mut breaks: Vec<f64> = (0..=grid.bins).map(|b| grid.lo + b as f64 * grid.width).collect();
    breaks.push(z);
    breaks.extend(point.map(|p| p.at));
    breaks.sort_by(f64::total_cmp);
    // Between neighbouring breaks the difference is linear from a to b, and its square integrates to
    // length (a^2 + a b + b^2) / 3.
    breaks
        .windows(2)
        .map(|ends| {
            let jumps = point.map_or(0.0, |p| if ends[0] >= p.at { p.mass } else { 0.0 })
                - if ends[0] >= z { 1.0 } else { 0.0 };
            let a = distribution.continuous_cdf(ends[0]) + jumps;
            let b = distribution.continuous_cdf(ends[1]) + jumps;
            (ends[1] - ends[0]) * (a * a + a * b + b * b) / 3.0
        })
        .sum()
}

/// Differences of bin masses, with point masses in their bins.
fn differences<'a>(
    a: &'a Distribution,
    b: &'a Distribution,
) -> Result<impl Iterator<Item = f64> + 'a, Error> {
    if a.grid() != b.grid() {
        return Err(Error::GridMismatch);
    }
    let point = |d: &Distribution| d.point().map(|p| (d.grid().bin(p.at), p.mass));
    let (point_a, point_b) = (point(a), point(b));
    let at = |point: Option<(usize, f64)>, bin| match point {
        Some((b, mass)) if b == bin => mass,
        _ => 0.0,
    };
    Ok(a.mass()
        .iter()
        .zip(b.mass())
        .enumerate()
        .map(move |(bin, (x, y))| x + at(point_a, bin) - y - at(point_b, bin)))
}

/// A mean loss over states with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Risk {
    /// Mean loss.
    pub mean: f64,
    /// Lower end of the bootstrap interval.
    pub lo: f64,
    /// Upper end of the bootstrap interval.
    pub hi: f64,
}

/// The empirical risk: mean of the losses at held-out states, with the 95 % percentile bootstrap interval over
/// states (1000 resamples, determined by `seed`).
///
/// # Errors
/// If there are no losses or one isn't finite.
pub fn risk(losses: &[f64], seed: u64) -> Result<Risk, Error> {
    if losses.is_empty() {
        return Err(Error::Empty { what: "the losses of a risk" });
    }
    for &loss in losses {
        crate::error::finite("a loss", loss)?;
    }
    let n = losses.len();
    let mut means: Vec<f64> = (0..RESAMPLES)
        .map(|resample| {
            let mut random = Philox::from_u64_seed_stream(seed, resample);
            let sum: f64 = (0..n).map(|_| losses[random.bounded(n as u32) as usize]).sum();
            sum / n as f64
        })
        .collect();
    means.sort_by(f64::total_cmp);
    let percentile = |share: f64| means[(share * (means.len() - 1) as f64).round() as usize];
    Ok(Risk { mean: losses.iter().sum::<f64>() / n as f64, lo: percentile(0.025), hi: percentile(0.975) })
}
