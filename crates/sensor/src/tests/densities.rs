use std::sync::Arc;

use locsim_core::{Beams, Draw, Hits, Particles, Pose2, SensorModel, Stage};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::simulated::{MAX_RANGE, Objects, REACH, model, normalized_models};
use crate::{ModelKind, Oracle, Tempered};

/// Nominal range and incidence of the beams that are looked at: near, far, at the very end, just out of sight, nothing there.
const BEAMS: [(f32, f32); 9] = [
    (0.0, 0.0),
    (0.25, 0.3),
    (1.0, 1.2),
    (2.003, 0.6),
    (4.3, 0.1),
    (4.495, 0.5),
    (MAX_RANGE, 0.0),
    (5.2, 0.4),
    (REACH, 0.0),
];

/// Readings of one beam, all asked about at once.
struct OneBeam {
    laser: Particles,
    bearings: Vec<f32>,
    hits: Hits,
}

impl OneBeam {
    fn new((range, incidence): (f32, f32), readings: usize) -> Self {
        let mut hits = Hits::default();
        hits.resize(readings);
        hits.range.fill(range);
        hits.incidence.fill(incidence);
        Self { laser: [Pose2::IDENTITY].into_iter().collect(), bearings: vec![0.0; readings], hits }
    }

    fn beams(&self) -> Beams<'_> {
        self.hits.beams(self.laser.as_poses(), &self.bearings, MAX_RANGE)
    }
}

fn densities(model: &dyn SensorModel, beam: (f32, f32), z: &[f32]) -> Vec<f64> {
    let mut out = vec![0.0; z.len()];
    model.log_density(z, &OneBeam::new(beam, z.len()).beams(), &mut out);
    out.iter().map(|&l| f64::from(l).exp()).collect()
}

fn cdfs(model: &dyn SensorModel, beam: (f32, f32), z: &[f32]) -> Vec<f64> {
    let mut out = vec![0.0; z.len()];
    model.cdf(z, &OneBeam::new(beam, z.len()).beams(), &mut out);
    out.iter().map(|&p| f64::from(p)).collect()
}

/// Middles of 0.25 mm steps from 0 to the maximum range, and the step.
fn steps() -> (Vec<f32>, f64) {
    let step = 0.000_25;
    ((0..18_000).map(|i| (i as f32 + 0.5) * step).collect(), f64::from(step))
}

/// The density integrates to 1 with the point mass, and its running integral is the distribution function.
/// The midpoint rule errs by at most half a step times the jump at each edge of a histogram, well below 2e-3.
#[test]
fn every_density_integrates_to_one_and_to_its_distribution_function() {
    let (z, step) = steps();
    let mut models = normalized_models();
    models.push(Arc::new(Tempered::new(model(ModelKind::Classic), 0.05, 1.0).unwrap()));
    for model in models {
        for beam in BEAMS {
            let density = densities(&*model, beam, &z);
            let cdf = cdfs(&*model, beam, &z);
            let mut sum = 0.0;
            let mut last = 0.0;
            for ((p, &c), z) in density.iter().zip(&cdf).zip(&z) {
                assert!(*p >= 0.0 && c >= last - 1e-6, "{} {beam:?} at {z}: cdf falls", model.name());
                last = c;
                let middle = sum + 0.5 * p * step;
                assert!((middle - c).abs() < 2e-3, "{} {beam:?} at {z}: {middle} but cdf {c}", model.name());
                sum += p * step;
            }
            let at_max = densities(&*model, beam, &[MAX_RANGE])[0];
            assert!((sum + at_max - 1.0).abs() < 2e-3, "{} {beam:?}: total {}", model.name(), sum + at_max);
            let ends = cdfs(&*model, beam, &[MAX_RANGE.next_down(), MAX_RANGE, -0.1, MAX_RANGE + 1.0]);
            assert!((ends[0] + at_max - 1.0).abs() < 2e-4, "{} {beam:?}: jump at the maximum", model.name());
            assert_eq!(ends[1..], [1.0, 0.0, 1.0], "{}", model.name());
        }
    }
}

/// The likelihood field is documented to be no density: this is the check above, and it must fail.
#[test]
fn the_likelihood_field_does_not_integrate_to_one() {
    let (z, step) = steps();
    let field = model(ModelKind::LikelihoodField);
    let beam = (2.0, 0.0);
    let sum = densities(&*field, beam, &z).iter().sum::<f64>() * step;
    let at_max = densities(&*field, beam, &[MAX_RANGE])[0];
    assert!((sum + at_max - 1.0).abs() > 2e-3);
    let ends = cdfs(&*field, beam, &[MAX_RANGE.next_down(), MAX_RANGE]);
    assert!((ends[0] + at_max - 1.0).abs() < 1e-4 && ends[1] == 1.0);
}

/// Kolmogorov-Smirnov distance of readings from a model's distribution, by the randomized probability
/// transform F(z-) + V (F(z) - F(z-)), which is uniform also where there is a point mass.
fn distance_from(model: &dyn SensorModel, beam: (f32, f32), z: &[f32]) -> f64 {
    let before: Vec<f32> =
        z.iter().map(|&z| if z >= MAX_RANGE { MAX_RANGE.next_down() } else { z }).collect();
    let upper = cdfs(model, beam, z);
    let lower = cdfs(model, beam, &before);
    let mut u: Vec<f64> = (0..z.len())
        .map(|i| {
            let v: f64 = Draw::new(5, Stage::Bootstrap, 0).item(i as u32).random();
            lower[i] + v * (upper[i] - lower[i])
        })
        .collect();
    u.sort_unstable_by(f64::total_cmp);
    let n = z.len() as f64;
    u.iter().enumerate().map(|(i, u)| (u - i as f64 / n).max((i as f64 + 1.0) / n - u)).fold(0.0, f64::max)
}

fn sampled(model: &dyn SensorModel, beam: (f32, f32), n: usize) -> Vec<f32> {
    let mut z = vec![0.0; n];
    model.sample(&OneBeam::new(beam, n).beams(), &Draw::new(5, Stage::Sensor, 3), &mut z);
    z
}

/// P(D > d) <= 2 exp(-2 n d^2) (Dvoretzky, Kiefer, Wolfowitz, Massart): 1e-6 at this d.
fn critical_distance(n: usize) -> f64 {
    ((2.0f64 / 1e-6).ln() / (2.0 * n as f64)).sqrt()
}

#[test]
fn samples_follow_the_distribution_function() {
    let n = 4000;
    let mut models = normalized_models();
    models.push(Arc::new(Tempered::new(model(ModelKind::Classic), 0.3, 1.0).unwrap()));
    models.extend([ModelKind::LikelihoodField, ModelKind::NpRegField].map(model));
    for model in models {
        for beam in BEAMS {
            let d = distance_from(&*model, beam, &sampled(&*model, beam, n));
            assert!(d < critical_distance(n), "{} {beam:?}: {d}", model.name());
        }
    }
}

/// The oracle's distribution function against a simulation of its assumptions by other code: an object with even
/// density between 0.5 m and 2.5 m in 30 % of the cases, hidden where it stands behind the surface, seen with
/// noise.
#[test]
fn the_oracle_is_what_a_simulation_does() {
    let n = 20_000;
    let oracle = Oracle::new(Arc::new(Objects::default()), 0.01, 0.002).unwrap();
    for range in [1.03f32, 2.003, 4.49, MAX_RANGE] {
        let z: Vec<f32> = (0..n as u32)
            .map(|i| {
                let mut rng = Draw::new(9, Stage::Laser, 0).item(i);
                let object: f32 =
                    if rng.random::<f32>() < 0.3 { 0.5 + 2.0 * rng.random::<f32>() } else { 9.0 };
                let at = object.min(range);
                if at >= MAX_RANGE {
                    return MAX_RANGE;
                }
                let noise: f32 = StandardNormal.sample(&mut rng);
                (at + (0.01 + 0.002 * at) * noise).min(MAX_RANGE)
            })
            .collect();
        let d = distance_from(&oracle, (range, 0.0), &z);
        assert!(d < critical_distance(n), "{range}: {d}");
        // negative control: 2 cm further away
        let d = distance_from(&oracle, (range - 0.02, 0.0), &z);
        assert!(d > critical_distance(n), "{range}: {d}");
    }
}

/// Negative control: samples of a beam whose nominal range is 1 cm longer, one standard deviation of the
/// noise.
#[test]
fn samples_of_another_beam_are_told_apart() {
    let n = 4000;
    let registered = model(ModelKind::NpRegRegistered);
    let z = sampled(&*registered, (2.01, 0.3), n);
    assert!(distance_from(&*registered, (2.0, 0.3), &z) > critical_distance(n));
}

#[test]
fn readings_out_of_the_ordinary_have_a_defined_score() {
    let mut models = normalized_models();
    models.extend([ModelKind::LikelihoodField, ModelKind::NpRegField].map(model));
    models.push(Arc::new(Tempered::new(model(ModelKind::NpRegRegistered), 0.01, 0.5).unwrap()));
    let z = [f32::NAN, MAX_RANGE, MAX_RANGE + 3.0, f32::INFINITY, 0.0, 1.0];
    for model in models {
        for beam in BEAMS {
            let one = OneBeam::new(beam, z.len());
            let (mut out, mut total) = (Vec::new(), [0.0]);
            model.log_likelihood(&z, &one.beams(), &mut out, &mut total);
            assert_eq!(out[0], 0.0, "{}: NaN tells nothing", model.name());
            assert_eq!(out[1], out[2], "{}: beyond the maximum range is the maximum range", model.name());
            assert_eq!(out[1], out[3]);
            assert!(
                out.iter().all(|l| !l.is_nan() && *l < f32::INFINITY),
                "{} {beam:?} {out:?}",
                model.name()
            );
        }
        let mut below = [0.0];
        model.log_density(&[-0.1], &OneBeam::new(BEAMS[3], 1).beams(), &mut below);
        let floor = if model.name() == "np_reg_registered" { -0.1 } else { f32::NEG_INFINITY };
        assert!(below[0] == f32::NEG_INFINITY || below[0] < floor, "{}", model.name());
    }
}

/// A batch gives each beam the value that it gets alone, at any place in the batch.
#[test]
fn a_batch_equals_its_beams_one_by_one() {
    let laser: Particles = [Pose2::new(0.5, 0.1, 0.2), Pose2::new(-1.0, 0.3, -2.0)].into_iter().collect();
    let bearings = [0.0f32, 0.7, -0.4];
    let mut hits = Hits::default();
    hits.resize(6);
    for (i, (range, incidence)) in BEAMS[..6].iter().enumerate() {
        (hits.range[i], hits.incidence[i]) = (*range, *incidence);
    }
    let z = [0.9f32, 2.0, 4.3];
    let beams = hits.beams(laser.as_poses(), &bearings, MAX_RANGE);
    let mut models = normalized_models();
    models.extend([ModelKind::LikelihoodField, ModelKind::NpRegField].map(model));
    for model in models {
        let mut all = [0.0f32; 6];
        model.log_density(&z, &beams, &mut all);
        for (i, batched) in all.iter().enumerate() {
            let alone = Hits {
                range: vec![hits.range[i]],
                incidence: vec![hits.incidence[i]],
                surface: vec![hits.surface[i]],
            };
            let (pose, bearing) = (i / 3, i % 3);
            let one =
                alone.beams(laser.as_poses().slice(pose, pose + 1), &bearings[bearing..=bearing], MAX_RANGE);
            let mut out = [0.0];
            model.log_density(&z[bearing..=bearing], &one, &mut out);
            assert_eq!(out[0].to_bits(), batched.to_bits(), "{} beam {i}", model.name());
        }
    }
}
