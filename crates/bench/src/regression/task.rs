use serde::{Deserialize, Serialize};
use statrs::function::erf::erfc;

use super::numpy::Generator;
use distreg::{Dataset, Error, Outcomes, Predictions};

/// States and observations at each, training.
const STATES: usize = 1000;
const OBSERVATIONS: usize = 100;
/// Queries.
const QUERIES: usize = 200;
/// The seed that the task's script gives to NumPy.
const SEED: u32 = 7;
/// Largest reading \[m\].
const MAX_RANGE: f64 = 4.5;
/// Bins are 1 mm wide.
const BINS_PER_METRE: f64 = 1000.0;

/// The synthetic range sensor. Its state is (nominal range \[m\], incidence \[rad\]), its observation a range in steps of
/// 1 mm up to 4.5 m.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Truth {
    /// A Gaussian whose deviation grows with range and incidence.
    Gauss,
    /// That Gaussian, objects in front of the wall, and lost returns that read as maximum.
    Mixed,
}

/// One synthetic task: training data and queries at which the truth is known.
pub struct Task {
    truth: Truth,
    /// 1000 states with 100 observations each.
    pub train: Dataset,
    /// 200 queries, row by row.
    pub queries: Vec<f64>,
}

fn bins() -> usize {
    (MAX_RANGE * BINS_PER_METRE) as usize + 1
}

fn normal_cdf(u: f64) -> f64 {
    0.5 * erfc(-u / std::f64::consts::SQRT_2)
}

fn steepest() -> f64 {
    75.0 * (std::f64::consts::PI / 180.0)
}

fn states(count: usize, random: &mut Generator) -> Vec<[f64; 2]> {
    let ranges: Vec<f64> = (0..count).map(|_| random.uniform(0.3, 4.2)).collect();
    ranges.into_iter().map(|r| [r, random.uniform(0.0, steepest())]).collect()
}

/// Mean and deviation \[m\] of the Gaussian.
fn gaussian([r, alpha]: [f64; 2]) -> (f64, f64) {
    let excess = 1.0 / alpha.cos() - 1.0;
    (r + 0.004 * excess, 0.002 + 0.0012 * (r * r) * (1.0 + 0.5 * excess))
}

/// Shares of objects in front of the wall and of lost returns.
fn shares([r, alpha]: [f64; 2]) -> (f64, f64) {
    let steepness = alpha / steepest();
    (0.10 + 0.25 * r / 4.2, 0.02 + 0.25 * steepness.powi(4))
}

/// Where most objects stand, in front of a wall at `r` \[m\].
fn near_wall(r: f64) -> (f64, f64) {
    ((r - 0.6).max(0.0), (r - 0.2).max(0.05))
}

/// P(Z <= z) of a reading from an object: near the wall, or by an exponential of 1 m cut at the wall.
fn object_cdf(z: f64, r: f64) -> f64 {
    let (lo, hi) = near_wall(r);
    let near = ((z - lo) / (hi - lo)).clamp(0.0, 1.0);
    let anywhere = ((1.0 - (-z.clamp(0.0, r)).exp()) / (1.0 - (-r).exp())).clamp(0.0, 1.0);
    0.7 * near + 0.3 * anywhere
}

fn observe(truth: Truth, states: &[[f64; 2]], random: &mut Generator) -> Vec<Vec<f64>> {
    let n = states.len() * OBSERVATIONS;
    let place = |k: usize| states[k / OBSERVATIONS];
    // In the order of the script's calls: whole arrays of each kind of number.
    let mut z: Vec<f64> = (0..n)
        .map(|k| {
            let (mean, sigma) = gaussian(place(k));
            mean + sigma * random.normal()
        })
        .collect();
    if truth == Truth::Mixed {
        let kind: Vec<f64> = (0..n).map(|_| random.uniform(0.0, 1.0)).collect();
        for (i, &state) in states.iter().enumerate() {
            let (r, (lo, hi)) = (state[0], near_wall(state[0]));
            let mut draws = || -> Vec<f64> { (0..OBSERVATIONS).map(|_| random.uniform(0.0, 1.0)).collect() };
            let (near, anywhere, which) = (draws(), draws(), draws());
            let (objects, lost) = shares(state);
            for k in 0..OBSERVATIONS {
                let at = i * OBSERVATIONS + k;
                if kind[at] < objects {
                    z[at] = if which[k] < 0.7 {
                        near[k] * (hi - lo) + lo
                    } else {
                        -(1.0 - anywhere[k] * (1.0 - (-r).exp())).ln()
                    };
                }
                if kind[at] > 1.0 - lost {
                    z[at] = MAX_RANGE;
                }
            }
        }
    }
    let last = (bins() - 1) as f64;
    let read = |z: &f64| (z * BINS_PER_METRE).round_ties_even().clamp(0.0, last) / BINS_PER_METRE;
    z.chunks(OBSERVATIONS).map(|z| z.iter().map(read).collect()).collect()
}

impl Task {
    /// The task's data.
    ///
    /// # Errors
    /// None, as the data is what it is.
    pub fn new(truth: Truth) -> Result<Self, Error> {
        let mut random = Generator::new(SEED);
        let places = states(STATES, &mut random);
        let observations = observe(truth, &places, &mut random);
        let mut train = Dataset::new(2);
        for (state, z) in places.iter().zip(&observations) {
            train.push(state, z)?;
        }
        Ok(Self { truth, train, queries: states(QUERIES, &mut random).concat() })
    }

    /// The sensor.
    pub fn truth(&self) -> Truth {
        self.truth
    }

    /// The bins 0, 1, ... 4500 mm, and the point mass of lost returns.
    ///
    /// # Errors
    /// None, as the grid is valid.
    pub fn outcomes() -> Result<Outcomes, Error> {
        Ok(Outcomes::of_values(0.0, MAX_RANGE, 1.0 / BINS_PER_METRE)?.with_point_mass(MAX_RANGE))
    }

    /// True P(Z <= upper edge) of every bin at a state; the last is 1.
    pub fn cdf(&self, state: [f64; 2]) -> Vec<f64> {
        let (mean, sigma) = gaussian(state);
        let (objects, lost) = shares(state);
        let mut cdf: Vec<f64> = (0..bins())
            .map(|b| {
                let edge = (b as f64 + 0.5) / BINS_PER_METRE;
                let hit = normal_cdf((edge - mean) / sigma);
                match self.truth {
                    Truth::Gauss => hit,
                    Truth::Mixed => (1.0 - objects - lost) * hit + objects * object_cdf(edge, state[0]),
                }
            })
            .collect();
        cdf[bins() - 1] = 1.0;
        cdf
    }

    /// Mean histogram match of predictions at the queries with the truth, in bins of 1 mm.
    pub fn risk(&self, predictions: &Predictions) -> f64 {
        let losses = self.queries.chunks(2).enumerate().map(|(q, state)| {
            let mut sum = 0.0;
            let last = bins() - 1;
            let masses = predictions.mass(q).iter().zip(self.cdf([state[0], state[1]])).enumerate();
            masses
                .map(|(b, (mass, truth))| {
                    sum += if b == last { mass + predictions.points()[q] } else { *mass };
                    (sum - truth).abs()
                })
                .sum::<f64>()
        });
        losses.sum::<f64>() / (self.queries.len() / 2) as f64
    }
}
