use rand_philox::Philox;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{ConditionalDistribution, Dataset, Distribution, Error, Outcomes, histogram};

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

/// Wasserstein-1 distance between two samples, in their unit: the area between their quantile functions. 0 where one has no value.
pub fn empirical_wasserstein_1(mut a: Vec<f64>, mut b: Vec<f64>) -> f64 {
    if a.is_empty() || b.is_empty() {
        return 0.0;
    }
    a.sort_by(f64::total_cmp);
    b.sort_by(f64::total_cmp);
    let (n, m) = (a.len(), b.len());
    let (mut i, mut j, mut at, mut sum) = (0, 0, 0.0, 0.0);
    while i < n && j < m {
        let (end_a, end_b) = ((i + 1) as f64 / n as f64, (j + 1) as f64 / m as f64);
        let end = end_a.min(end_b);
        sum += (end - at) * (a[i] - b[j]).abs();
        at = end;
        if end_a <= end {
            i += 1;
        }
        if end_b <= end {
            j += 1;
        }
    }
    sum
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

/// Mean over `observations` of the continuous ranked probability score, the integral of (cdf(t) - \[t >= z\])^2 over
/// t, in units of z (Gneiting and Raftery 2007). NaN without observations.
pub fn crps(distribution: &Distribution, observations: &[f64]) -> f64 {
    let grid = distribution.grid();
    let point = distribution.point();
    let mut breaks: Vec<f64> = (0..=grid.bins).map(|b| grid.lo + b as f64 * grid.width).collect();
    let place = point.map_or(f64::NAN, |p| p.at);
    if point.is_some() {
        breaks.insert(breaks.partition_point(|&t| t < place), place);
    }
    let jump = |t: f64| point.map_or(0.0, |p| if t >= p.at { p.mass } else { 0.0 });
    // Between neighbouring breaks the cdf is linear, from `a` to `b`; its square integrates to
    // length (a^2 + a b + b^2) / 3.
    let square = |from: f64, to: f64, a: f64, b: f64| (to - from) * (a * a + a * b + b * b) / 3.0;
    let ends = |from: f64, to: f64| {
        let jump = jump(from);
        (distribution.continuous_cdf(from) + jump, distribution.continuous_cdf(to) + jump)
    };
    // Integrals of cdf^2 from the lowest break, and of (1 - cdf)^2 from there, up to each break.
    let (mut below, mut above) = (vec![0.0], vec![0.0]);
    for pair in breaks.windows(2) {
        let (a, b) = ends(pair[0], pair[1]);
        below.push(below[below.len() - 1] + square(pair[0], pair[1], a, b));
        above.push(above[above.len() - 1] + square(pair[0], pair[1], 1.0 - a, 1.0 - b));
    }
    let (last, total_above) = (breaks.len() - 1, above[above.len() - 1]);
    let score = |&z: &f64| {
        if z <= breaks[0] {
            return breaks[0] - z + total_above;
        }
        if z >= breaks[last] {
            return below[last] + z - breaks[last];
        }
        let k = breaks.partition_point(|&t| t <= z) - 1;
        let (a, b) = ends(breaks[k], z);
        below[k] + square(breaks[k], z, a, b) + total_above
            - above[k]
            - square(breaks[k], z, 1.0 - a, 1.0 - b)
    };
    observations.iter().map(score).sum::<f64>() / observations.len() as f64
}

/// How far a prediction is from what was observed at a state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Loss {
    /// [`histogram_match`] with the observations' histogram: the paper's. Like the other distances between
    /// distributions it needs repeated observations; with a single one it is smallest for a point at the median.
    #[default]
    HistogramMatch,
    /// [`wasserstein_1`] with the observations' histogram.
    Wasserstein1,
    /// [`euclidean`] distance to the observations' histogram.
    Euclidean,
    /// [`log_loss`] of the observations.
    LogLoss {
        /// Share of [`Distribution::with_floor`], which keeps the loss finite on the grid.
        floor: f64,
    },
    /// [`crps`] of the observations.
    Crps,
}

impl Loss {
    /// The loss of `predicted` against the observations at its state.
    ///
    /// # Errors
    /// If there are no observations, one isn't finite, or the floor isn't within 0..=1.
    pub fn of(self, predicted: &Distribution, observations: &[f64]) -> Result<f64, Error> {
        let outcomes =
            Outcomes { grid: *predicted.grid(), point_mass_at: predicted.point().map(|point| point.at) };
        let observed = histogram(observations, &outcomes)?;
        match self {
            Self::HistogramMatch => histogram_match(predicted, &observed),
            Self::Wasserstein1 => wasserstein_1(predicted, &observed),
            Self::Euclidean => euclidean(predicted, &observed),
            Self::LogLoss { floor } => Ok(log_loss(&predicted.with_floor(floor)?, observations)),
            Self::Crps => Ok(crps(predicted, observations)),
        }
    }
}

/// The loss at each state of `held_out`, in parallel. [`risk`] makes their mean with its interval.
///
/// # Errors
/// If a prediction or a loss isn't possible.
pub fn losses<M>(model: &M, held_out: &Dataset, loss: Loss) -> Result<Vec<f64>, Error>
where
    M: ConditionalDistribution + ?Sized,
{
    (0..held_out.len())
        .into_par_iter()
        .map(|i| loss.of(&model.predict(held_out.state(i))?.0, held_out.observations(i)))
        .collect()
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
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
