//! The likelihood field: a reading is likely where it ends near a mapped surface.

use std::collections::BTreeMap;
use std::sync::Arc;

use locsim_core::{Beams, DependsOn, DistanceMap, Draw, Pose2, SensorModel};
use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::beam::{cdfs, log_densities, samples};
use crate::mixture::{check_sigma, check_weights};
use crate::normal;
use crate::{ModelKind, SensorError, TrainingSet};

/// Steps of the quadrature along a beam: of 1.5 cm at a maximum range of 30 m, a third of a cell of the distances.
const STEPS: usize = 2048;

/// Most rounds of expectation maximization.
const ROUNDS: usize = 300;

/// No deviation below this \[m\] is believed.
const LEAST_SIGMA: f64 = 1e-3;

/// Neither part is ever quite certain.
const LEAST_WEIGHT: f64 = 1e-6;

/// Parameters of the likelihood field (Probabilistic Robotics, table 6.3), as a file stores them.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FieldParameters {
    /// Weights of the Gaussian and of the uniform part; they sum to 1.
    z_hit: f32,
    z_rand: f32,
    /// Share of readings at the maximum range.
    z_max: f32,
    /// Standard deviation of the distance from a reading's end to the nearest surface \[m\].
    sigma_m: f32,
}

impl FieldParameters {
    /// Maximum likelihood by expectation maximization over the distances at which the training readings end.
    pub fn fit(train: &TrainingSet, map: &dyn DistanceMap) -> Result<Self, SensorError> {
        let mut distances = Vec::new();
        let mut at_max = 0usize;
        for i in 0..train.len() {
            let direction = train.heading(i).sin_cos();
            for &z in train.observations(i) {
                if z >= train.max_range() {
                    at_max += 1;
                } else {
                    let [x, y] = end_of(train.pose(i), direction, z);
                    distances.push(f64::from(map.distance(x, y)));
                }
            }
        }
        if distances.is_empty() {
            return Err(SensorError::TooFewData {
                model: ModelKind::LikelihoodField,
                what: "no reading below the maximum range",
            });
        }
        let n = distances.len() as f64;
        let uniform = 1.0 / f64::from(train.max_range());
        let (mut z_hit, mut sigma) = (0.8, 0.1);
        for _ in 0..ROUNDS {
            let (mut hits, mut squares) = (0.0, 0.0);
            for d in &distances {
                let hit = z_hit * normal::pdf(d / sigma) / sigma;
                let share = hit / (hit + (1.0 - z_hit) * uniform);
                hits += share;
                squares += share * d * d;
            }
            // so that no share above is 0 / 0
            z_hit = (hits / n).clamp(LEAST_WEIGHT, 1.0 - LEAST_WEIGHT);
            let before = std::mem::replace(&mut sigma, (squares / hits.max(1e-9)).sqrt().max(LEAST_SIGMA));
            if (sigma - before).abs() < 1e-9 {
                break;
            }
        }
        // the constant of the maximum range is never 0: one more such reading than was seen
        let z_max = (at_max as f64 + 1.0) / (at_max as f64 + n + 2.0);
        Ok(Self {
            z_hit: z_hit as f32,
            z_rand: (1.0 - z_hit) as f32,
            z_max: z_max as f32,
            sigma_m: sigma as f32,
        })
    }

    /// Whether a fit could have given them.
    pub fn check(&self) -> Result<(), String> {
        check_weights(&[("z_hit", self.z_hit), ("z_rand", self.z_rand)])?;
        // The score divides by the weight of the uniform part and by the share of readings below the maximum range.
        if f64::from(self.z_rand) < 0.5 * LEAST_WEIGHT || !(0.0..1.0).contains(&self.z_max) {
            return Err(format!(
                "z_rand {} and z_max {} are not allowed; above 0, and from 0 to below 1",
                self.z_rand, self.z_max
            ));
        }
        check_sigma(self.sigma_m, LEAST_SIGMA)
    }

    pub fn chosen(&self) -> BTreeMap<String, f64> {
        [("z_hit", self.z_hit), ("z_rand", self.z_rand), ("z_max", self.z_max), ("sigma_m", self.sigma_m)]
            .map(|(name, value)| (name.to_owned(), f64::from(value)))
            .into()
    }
}

/// The likelihood field over a map.
///
/// `log_density` is the table's own score: (1 - `z_max`) (`z_hit` N(d; 0, sigma) + `z_rand` / max) at a
/// reading's end with distance d to the nearest surface, and the constant `z_max` for any reading at the
/// maximum range. It is **not** a normalized density of z: along a wall it is high for every z, so its log
/// loss isn't comparable with that of the other models. `cdf` and `sample` use the same score normalized
/// along the beam by quadrature.
pub(crate) struct LikelihoodField {
    pub parameters: FieldParameters,
    pub map: Arc<dyn DistanceMap>,
}

impl LikelihoodField {
    fn score(&self, x: f64, y: f64, max_range: f32) -> f32 {
        let p = &self.parameters;
        let t = self.map.distance(x, y) / p.sigma_m;
        (1.0 - p.z_max) * (p.z_hit * 0.398_942_3 * (-0.5 * t * t).exp() / p.sigma_m + p.z_rand / max_range)
    }

    /// The score along beam `i`, normalized to 1 - `z_max`.
    fn profile(&self, beams: &Beams<'_>, i: usize) -> Profile {
        Profile::along(beams, i, 1.0 - self.parameters.z_max, |_, x, y| self.score(x, y, beams.max_range))
    }
}

/// The running integral of a score along a beam, normalized, at STEPS + 1 ranges.
pub(crate) struct Profile(Vec<f32>);

impl Profile {
    /// Integrates `score(z, x, y)` along beam `i`, where (x, y) \[m\] is where the reading z \[m\] ends; from 0 to
    /// `returns`, the share of returns.
    pub fn along(
        beams: &Beams<'_>,
        i: usize,
        returns: f32,
        mut score: impl FnMut(f32, f64, f64) -> f32,
    ) -> Self {
        let pose = beams.laser.get(i / beams.per_pose());
        let (sin, cos) = beams.heading(i).sin_cos();
        let step = f64::from(beams.max_range) / STEPS as f64;
        let mut values = Vec::with_capacity(STEPS + 1);
        values.push(0.0);
        let mut sum = 0.0;
        for s in 0..STEPS {
            let z = (s as f64 + 0.5) * step;
            sum += score(z as f32, pose.x + z * cos, pose.y + z * sin);
            values.push(sum);
        }
        for value in &mut values {
            *value *= returns / sum;
        }
        Self(values)
    }

    /// P(Z <= z) for z as a share of the maximum range, by linear interpolation.
    pub fn below(&self, share: f32) -> f32 {
        let at = share * STEPS as f32;
        let i = (at as usize).min(STEPS - 1);
        self.0[i] + (at - i as f32) * (self.0[i + 1] - self.0[i])
    }

    /// The reading below which `u` of the distribution lies, as a share of the maximum range; `None` is no return.
    pub fn quantile(&self, u: f32) -> Option<f32> {
        let above = self.0.partition_point(|&p| p <= u);
        if above > STEPS {
            return None;
        }
        let (lo, hi) = (self.0[above - 1], self.0[above]);
        Some((above as f32 - 1.0 + (u - lo) / (hi - lo)) / STEPS as f32)
    }
}

/// Where a reading z \[m\] from a laser pose ends \[m\]; `direction` is the sine and cosine of the beam's heading.
#[inline]
pub(crate) fn end_of(laser: Pose2, (sin, cos): (f64, f64), z: f32) -> [f64; 2] {
    [laser.x + f64::from(z) * cos, laser.y + f64::from(z) * sin]
}

impl SensorModel for LikelihoodField {
    fn name(&self) -> &str {
        ModelKind::LikelihoodField.as_str()
    }

    fn depends_on(&self) -> DependsOn {
        DependsOn::Endpoint
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        let directions: Vec<(f64, f64)> = beams.bearings.iter().map(|b| f64::from(*b).sin_cos()).collect();
        let mut last = usize::MAX;
        let (mut sin, mut cos) = (0.0, 1.0);
        log_densities(z, beams, out, |z, beam| {
            if z >= beam.max_range {
                return self.parameters.z_max.ln();
            }
            if beam.pose != last {
                (sin, cos) = beams.laser.theta[beam.pose].sin_cos();
                last = beam.pose;
            }
            let (s, c) = directions[beam.bearing];
            let x = beams.laser.x[beam.pose] + f64::from(z) * (cos * c - sin * s);
            let y = beams.laser.y[beam.pose] + f64::from(z) * (sin * c + cos * s);
            self.score(x, y, beam.max_range).ln()
        });
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        // many readings of one beam, as an evaluation asks for, share its profile
        let mut profiled: Option<((usize, f32), Profile)> = None;
        cdfs(z, beams, out, |z, beam| {
            let key = (beam.pose, beams.bearings[beam.bearing]);
            if profiled.as_ref().is_none_or(|(profiled, _)| *profiled != key) {
                let i = beam.pose * beams.per_pose() + beam.bearing;
                profiled = Some((key, self.profile(beams, i)));
            }
            profiled.as_ref().map_or(0.0, |(_, profile)| profile.below(z / beam.max_range))
        });
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        samples(beams, draw, out, |beam, rng| {
            let profile = self.profile(beams, beam.pose * beams.per_pose() + beam.bearing);
            profile.quantile(rng.random::<f32>()).map_or(beam.max_range, |share| share * beam.max_range)
        });
    }
}
