//! A small world of blocked beams whose true density is known, and the models learnt from it.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::{Arc, LazyLock};

use locsim_core::{
    CAST_REACH, DistanceMap, Draw, NO_SURFACE, Obstructions, Pose2, SensorModel, Stage, Survival,
};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use crate::{BeamState, FitOptions, FittedModel, ModelKind, Oracle, TrainingSet, fit, normal};

pub const MAX_RANGE: f32 = 4.5;
/// How far nominal ranges are cast.
pub const REACH: f32 = CAST_REACH * MAX_RANGE;
const SIGMA_M: f64 = 0.01;
const BLOCKED: f64 = 0.2;
const UNSEEN: f64 = 0.02;
/// A block stands this far before the wall [m], at right angles to it.
const DEPTH: [f64; 2] = [0.1, 0.6];
/// Of the beams that meet nothing in the map, this share meets a block anywhere.
const OPEN_BLOCKED: f64 = 0.2;

/// A reading of a wall at range `r` under incidence `alpha`: unseen with probability 0.02, blocked with
/// probability 0.2 at r - U(0.1, 0.6) / cos(alpha) if that lies before the sensor, with noise of 1 cm.
fn reading(r: f64, alpha: f64, rng: &mut impl Rng) -> f32 {
    let max = f64::from(MAX_RANGE);
    if r >= max {
        return if rng.random::<f64>() < OPEN_BLOCKED {
            (rng.random::<f64>() * max) as f32
        } else {
            MAX_RANGE
        };
    }
    if rng.random::<f64>() < UNSEEN {
        return MAX_RANGE;
    }
    let short = (DEPTH[0] + (DEPTH[1] - DEPTH[0]) * rng.random::<f64>()) / alpha.cos();
    let at = if rng.random::<f64>() < BLOCKED && short < r { r - short } else { r };
    let noise: f64 = StandardNormal.sample(rng);
    (at + SIGMA_M * noise).clamp(0.0, max) as f32
}

/// ln of the density that [`reading`] draws from, exact except within 5 cm of either end.
fn true_log_density(z: f64, r: f64, alpha: f64) -> f64 {
    let max = f64::from(MAX_RANGE);
    if r >= max {
        return if z >= max { (1.0 - OPEN_BLOCKED).ln() } else { (OPEN_BLOCKED / max).ln() };
    }
    if z >= max {
        return UNSEEN.ln();
    }
    let nominal = (-0.5 * ((z - r) / SIGMA_M).powi(2)).exp() / (SIGMA_M * (2.0 * PI).sqrt());
    let (near, far) = (r - DEPTH[1] / alpha.cos(), r - DEPTH[0] / alpha.cos());
    if far <= 0.0 {
        return ((1.0 - UNSEEN) * nominal).ln();
    }
    let first = near.max(0.0);
    let blocked = BLOCKED * (far - first) / (far - near);
    let short = (normal::cdf((z - first) / SIGMA_M) - normal::cdf((z - far) / SIGMA_M)) / (far - first);
    ((1.0 - UNSEEN) * ((1.0 - blocked) * nominal + blocked * short)).ln()
}

/// The log loss of the true density [nats].
pub fn true_log_loss(data: &TrainingSet) -> f64 {
    let sum: f64 = data
        .readings()
        .map(|(z, beam)| true_log_density(z.into(), beam.range.into(), beam.incidence.into()))
        .sum();
    -sum / data.reading_count() as f64
}

/// A state at the origin.
pub fn state(range: f32, incidence: f32, scan: u32) -> BeamState {
    let surface = if range < MAX_RANGE { 0 } else { NO_SURFACE };
    BeamState { laser: Pose2::IDENTITY, bearing: 0.0, range, incidence, surface, scan }
}

/// `n` states with `m` readings each, ten states to a scan; one state in ten meets nothing in the map.
pub fn training_set(n: u32, m: usize, seed: u64) -> TrainingSet {
    let draw = Draw::new(seed, Stage::Training, 1);
    let mut set = TrainingSet::new(MAX_RANGE).unwrap();
    for i in 0..n {
        let mut rng = draw.item(i);
        let open = i % 10 == 9;
        let r = if open { f64::from(REACH) } else { 0.3 + 4.1 * rng.random::<f64>() };
        let alpha = if open { 0.0 } else { 1.3 * rng.random::<f64>() };
        let z: Vec<f32> = (0..m).map(|_| reading(r, alpha, &mut rng)).collect();
        assert!(set.push(state(r as f32, alpha as f32, i / 10), &z).unwrap());
    }
    set
}

/// A wall along x = 2 m and nothing else.
pub struct Wall;

impl DistanceMap for Wall {
    fn distance(&self, x: f64, _y: f64) -> f32 {
        (x - 2.0).abs().min(1.0) as f32
    }
}

/// Objects that stand on any ray with even density between 0.5 m and 2.5 m.
pub struct Objects(Vec<f32>);

impl Default for Objects {
    fn default() -> Self {
        Self((0..=90).map(|i| 1.0 - 0.3 * ((i as f32 * 0.05 - 0.5) / 2.0).clamp(0.0, 1.0)).collect())
    }
}

impl Obstructions for Objects {
    fn bin_m(&self) -> f32 {
        0.05
    }

    fn survival(&self, _x: f64, _y: f64, _heading: f64, _range: f32) -> Survival<'_> {
        Survival { probability: &self.0, start_m: 0.0 }
    }
}

/// Each kind of model fitted to 700 states of 70 readings, once for all tests.
pub fn fitted(kind: ModelKind) -> FittedModel {
    static FITTED: LazyLock<BTreeMap<ModelKind, FittedModel>> = LazyLock::new(|| {
        let (train, held_out) = training_set(1000, 70, 1).split(0.3, 1).unwrap();
        let options = FitOptions { distance_map: Some(Arc::new(Wall)) };
        ModelKind::ALL.iter().map(|&kind| (kind, fit(kind, &train, &held_out, &options).unwrap())).collect()
    });
    FITTED[&kind].clone()
}

/// [`fitted`], ready to use.
pub fn model(kind: ModelKind) -> Arc<dyn SensorModel> {
    fitted(kind).into_model(Some(Arc::new(Wall))).unwrap()
}

/// Every model whose density is normalized, the oracle included.
pub fn normalized_models() -> Vec<Arc<dyn SensorModel>> {
    let kinds = ModelKind::ALL.iter().copied().filter(|kind| kind.is_normalized());
    let mut models: Vec<_> = kinds.map(model).collect();
    models.push(Arc::new(Oracle::new(Arc::new(Objects::default()), 0.01, 0.002).unwrap()));
    models
}
