//! The parametric beam models: the classic Gaussian + exponential, and the four-component beam mixture.

use std::collections::BTreeMap;

use locsim_core::{Beams, Draw, SensorModel};
use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::beam::{Beam, cdfs, log_densities, samples};
use crate::error::NO_SURFACE;
use crate::normal::RangeNormal;
use crate::{ModelKind, SensorError, TrainingSet};

/// Index of each component in [`BeamMixture`]'s weights.
const HIT: usize = 0;
const SHORT: usize = 1;
const MAX: usize = 2;
const RANDOM: usize = 3;

/// Lowest nominal range \[m\] for the exponential, so that it has somewhere to be on a ray that starts in a
/// wall.
const SHORTEST: f32 = 1e-3;

/// No deviation below this \[m\] is believed.
const LEAST_SIGMA: f64 = 1e-4;

/// A rate above this \[1/m\] is not believed.
const MOST_LAMBDA: f64 = 1e3;

/// Weights are sums of shares in f32, each off by 1e-7 at most; so far their sum may be from 1.
const WEIGHT_TOLERANCE: f64 = 1e-5;

/// Expectation maximization stops when the mean log likelihood gains less than this \[nats\], or after so
/// many rounds.
const TOLERANCE: f64 = 1e-7;
const ROUNDS: usize = 500;

/// A mixture of up to four ways in which a reading comes about (Probabilistic Robotics, eqs. 6.4 to 6.12).
///
/// - *hit*: Gaussian around the nominal range r, cut at 0; its mass beyond the maximum range is reported as the
///   maximum range. Where the map has nothing within reach (r = maximum), the point mass at the maximum
///   range.
/// - *short*: an exponential of rate lambda (at least 0.001 per metre, which is nearly uniform) cut to \[0,
///   r), from unmapped objects.
/// - *max*: the point mass at the maximum range.
/// - *random*: uniform over \[0, maximum).
///
/// `classic` has only *hit* and *short*, as the paper's baseline: a reading at the maximum range where the
/// map has a surface is then (nearly) impossible, and such training readings take no part in the fit. Only a
/// floor on the density ([`crate::Tempered`]) makes that model usable with a sensor that fails to see
/// surfaces.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct BeamMixture {
    kind: ModelKind,
    /// Weights of hit, short, max and random; they sum to 1.
    weights: [f32; 4],
    /// Standard deviation of *hit* \[m\].
    sigma_m: f32,
    /// Rate lambda of *short* \[1/m\].
    lambda_per_m: f32,
}

impl BeamMixture {
    /// Fits the components of `kind` (`classic` or `beam_mixture`) by expectation maximization (Probabilistic
    /// Robotics, table 6.2), but with the maximum-likelihood rate of the *cut* exponential, found by one
    /// Newton step per round, where the table has the rate of an uncut one.
    pub fn fit(kind: ModelKind, train: &TrainingSet) -> Result<Self, SensorError> {
        let readings: Vec<(f32, Beam)> = train
            .readings()
            .filter(|(z, beam)| kind == ModelKind::BeamMixture || *z < beam.max_range || beam.is_open())
            .collect();
        if !readings.iter().any(|(z, beam)| *z < beam.max_range && !beam.is_open()) {
            return Err(SensorError::TooFewData { model: kind, what: NO_SURFACE });
        }
        let weights = if kind == ModelKind::Classic { [0.5, 0.5, 0.0, 0.0] } else { [0.7, 0.1, 0.1, 0.1] };
        let (sigma_m, lambda_per_m) = first_guess(&readings);
        let mut model = Self { kind, weights, sigma_m, lambda_per_m };
        let mut last = f64::NEG_INFINITY;
        for _ in 0..ROUNDS {
            let log_likelihood = model.improve(&readings);
            if log_likelihood - last < TOLERANCE {
                break;
            }
            last = log_likelihood;
        }
        Ok(model)
    }

    /// One round of expectation maximization; returns the mean log likelihood before it.
    fn improve(&mut self, readings: &[(f32, Beam)]) -> f64 {
        let mut log_likelihood = 0.0;
        let mut counts = [0.0f64; 4];
        let (mut residual, mut hits) = (0.0, 0.0);
        let (mut slope, mut curvature) = (0.0, 0.0);
        let lambda = f64::from(self.lambda_per_m);
        for &(z, beam) in readings {
            let parts = self.weighted(z, beam);
            let total: f32 = parts.iter().sum();
            log_likelihood += f64::from(self.log(z, beam));
            // so far from the nominal range that only the Gaussian's tail is left of it, too small for f32
            let shares = if total > 0.0 { parts.map(|p| f64::from(p / total)) } else { [1.0, 0.0, 0.0, 0.0] };
            for (count, share) in counts.iter_mut().zip(shares) {
                *count += share;
            }
            if z < beam.max_range && !beam.is_open() {
                hits += shares[HIT];
                residual += shares[HIT] * f64::from(z - beam.range).powi(2);
            }
            if shares[SHORT] > 0.0 {
                let (d1, d2) =
                    cut_exponential_slopes(lambda, f64::from(z), f64::from(beam.range.max(SHORTEST)));
                slope += shares[SHORT] * d1;
                curvature += shares[SHORT] * d2;
            }
        }
        let n = readings.len() as f64;
        self.weights = counts.map(|count| (count / n) as f32);
        if hits > 0.0 {
            self.sigma_m = ((residual / hits).sqrt() as f32).max(LEAST_SIGMA as f32);
        }
        if curvature < 0.0 {
            self.lambda_per_m = (lambda - slope / curvature)
                .clamp(lambda / 4.0, lambda * 4.0)
                .clamp(1e-3, MOST_LAMBDA) as f32;
        }
        log_likelihood / n
    }

    fn hit(&self, beam: Beam) -> RangeNormal {
        RangeNormal { mean: beam.range, sigma: self.sigma_m }
    }

    /// Density of each component times its weight.
    fn weighted(&self, z: f32, beam: Beam) -> [f32; 4] {
        let w = &self.weights;
        if z >= beam.max_range {
            let hit = if beam.is_open() { 1.0 } else { self.hit(beam).at(beam.max_range) };
            return [w[HIT] * hit, 0.0, w[MAX], 0.0];
        }
        let hit = if beam.is_open() { 0.0 } else { w[HIT] * self.hit(beam).density(z) };
        let reach = beam.range.max(SHORTEST);
        let lambda = self.lambda_per_m;
        let short = if z < reach {
            w[SHORT] * lambda * (-lambda * z).exp() / -(-lambda * reach).exp_m1()
        } else {
            0.0
        };
        [hit, short, 0.0, w[RANDOM] / beam.max_range]
    }

    fn log(&self, z: f32, beam: Beam) -> f32 {
        let total: f32 = self.weighted(z, beam).iter().sum();
        if total > 0.0 || z >= beam.max_range || beam.is_open() {
            total.ln()
        } else {
            self.hit(beam).log_density(self.weights[HIT], z)
        }
    }

    /// Whether a fit could have given it.
    pub fn check(&self) -> Result<(), String> {
        let [hit, short, max, random] = self.weights;
        check_weights(&[("hit", hit), ("short", short), ("max", max), ("random", random)])?;
        if self.kind == ModelKind::Classic && (max, random) != (0.0, 0.0) {
            return Err(format!(
                "weights {max} of max and {random} of random are not allowed in {}",
                self.kind
            ));
        }
        check_sigma(self.sigma_m, LEAST_SIGMA)?;
        if self.lambda_per_m > 0.0 && f64::from(self.lambda_per_m) <= MOST_LAMBDA {
            return Ok(());
        }
        Err(format!("lambda {} per m is not allowed; above 0, at most {MOST_LAMBDA}", self.lambda_per_m))
    }

    /// Which model this is.
    pub fn kind(&self) -> ModelKind {
        self.kind
    }

    pub fn chosen(&self) -> BTreeMap<String, f64> {
        let names = ["weight_hit", "weight_short", "weight_max", "weight_random"];
        let used = if self.kind == ModelKind::Classic { 2 } else { 4 };
        let mut chosen: BTreeMap<_, _> = names[..used]
            .iter()
            .zip(self.weights)
            .map(|(name, w)| ((*name).to_owned(), f64::from(w)))
            .collect();
        chosen.insert("sigma_m".to_owned(), f64::from(self.sigma_m));
        chosen.insert("lambda_per_m".to_owned(), f64::from(self.lambda_per_m));
        chosen
    }
}

impl SensorModel for BeamMixture {
    fn name(&self) -> &str {
        self.kind.as_str()
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        log_densities(z, beams, out, |z, beam| self.log(z, beam));
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        cdfs(z, beams, out, |z, beam| {
            let w = &self.weights;
            let hit = if beam.is_open() { 0.0 } else { w[HIT] * self.hit(beam).cdf(z) };
            let reach = beam.range.max(SHORTEST);
            let lambda = self.lambda_per_m;
            let short = w[SHORT] * (-lambda * z.min(reach)).exp_m1() / (-lambda * reach).exp_m1();
            hit + short + w[RANDOM] * z / beam.max_range
        });
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        samples(beams, draw, out, |beam, rng| {
            let w = &self.weights;
            let u = rng.random::<f32>() * w.iter().sum::<f32>();
            if u < w[HIT] {
                if beam.is_open() { beam.max_range } else { self.hit(beam).sample(beam.max_range, rng) }
            } else if u < w[HIT] + w[SHORT] {
                let reach = beam.range.max(SHORTEST);
                let u = rng.random::<f32>();
                -(u * (-self.lambda_per_m * reach).exp_m1()).ln_1p() / self.lambda_per_m
            } else if u < w[HIT] + w[SHORT] + w[MAX] {
                beam.max_range
            } else {
                rng.random::<f32>() * beam.max_range
            }
        });
    }
}

/// Whether weights are shares of 1.
pub(crate) fn check_weights(weights: &[(&str, f32)]) -> Result<(), String> {
    if let Some((name, weight)) = weights.iter().find(|(_, weight)| !(0.0..=1.0).contains(weight)) {
        return Err(format!("weight {weight} of {name} is not allowed; from 0 to 1"));
    }
    let sum: f64 = weights.iter().map(|(_, weight)| f64::from(*weight)).sum();
    if (sum - 1.0).abs() <= WEIGHT_TOLERANCE {
        Ok(())
    } else {
        Err(format!("the weights sum to {sum}, not to 1"))
    }
}

/// Whether a standard deviation \[m\] is finite and at least `least`.
pub(crate) fn check_sigma(sigma_m: f32, least: f64) -> Result<(), String> {
    if sigma_m >= least as f32 && sigma_m.is_finite() {
        return Ok(());
    }
    Err(format!("sigma {sigma_m} m is not allowed; at least {least}"))
}

/// Where expectation maximization starts: sigma from the median distance to the nominal range, which blocked
/// readings hardly move, lambda from the mean range.
fn first_guess(readings: &[(f32, Beam)]) -> (f32, f32) {
    let mut off: Vec<f32> = readings
        .iter()
        .filter(|(z, beam)| *z < beam.max_range && !beam.is_open())
        .map(|(z, beam)| (z - beam.range).abs())
        .collect();
    let middle = off.len() / 2;
    let (_, median, _) = off.select_nth_unstable_by(middle, f32::total_cmp);
    let mean = readings.iter().map(|(z, _)| f64::from(*z)).sum::<f64>() / readings.len() as f64;
    ((1.48 * *median).clamp(1e-3, 1.0), (1.0 / mean.max(1e-2)) as f32)
}

/// First and second derivative by lambda of the log density of an exponential cut to \[0, r), ln(lambda) -
/// lambda z - ln(1 - exp(-lambda r)); it is concave in lambda.
fn cut_exponential_slopes(lambda: f64, z: f64, r: f64) -> (f64, f64) {
    let x = lambda * r;
    if x < 1e-2 {
        // 1/x - 1/(e^x - 1) = 1/2 - x/12 + O(x^3)
        return (r * (0.5 - x / 12.0) - z, -r * r / 12.0);
    }
    let e = x.exp_m1();
    (1.0 / lambda - r / e - z, -1.0 / (lambda * lambda) + r * r * (1.0 + 1.0 / e) / e)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Central differences of the log density itself.
    #[test]
    fn the_slopes_of_the_cut_exponential_are_its_derivatives() {
        for (lambda, z, r) in [(1e-3f64, 0.4, 2.0f64), (4.9e-3, 0.1, 2.0), (0.5, 0.3, 3.0), (4.0, 0.1, 1.0)] {
            let log = |l: f64| l.ln() - l * z - (-(-l * r).exp_m1()).ln();
            let h = 1e-4 * lambda;
            let (d1, d2) = cut_exponential_slopes(lambda, z, r);
            assert!((d1 - (log(lambda + h) - log(lambda - h)) / (2.0 * h)).abs() < 1e-4);
            let slope = |l: f64| cut_exponential_slopes(l, z, r).0;
            assert!((d2 - (slope(lambda + h) - slope(lambda - h)) / (2.0 * h)).abs() < 1e-3);
        }
    }
}
