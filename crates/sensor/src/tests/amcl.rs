//! AMCL's laser models against numbers that were computed by hand from the formulas of nav2's sources.

use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use locsim_core::{DistanceMap, Draw, Hits, Particles, Pose2, SensorModel, Stage};

use crate::{Amcl, AmclKind, AmclParameters};

const MAX_RANGE: f32 = 10.0;

const FIELD: f64 = 0.112_145_443;
const PROB: f64 = -3.706_537_542;
const BEAM: f64 = 0.114_984_816;
/// The first beam alone.
const SKIPPED: [f64; 3] = [-0.710_805_268, -0.597_837_001, -0.710_805_268];

/// A wall at x = 2 m.
struct Wall;

impl DistanceMap for Wall {
    fn distance(&self, x: f64, _y: f64) -> f32 {
        (2.0 - x).abs().min(2.0) as f32
    }
}

fn model(parameters: AmclParameters) -> Amcl {
    Amcl::new(parameters, Arc::new(Wall)).unwrap()
}

/// Log likelihood of a scan for robots at these x, which look along x.
fn weigh(parameters: AmclParameters, x: &[f64], bearings: &[f32], ranges: &[f32], z: &[f32]) -> Vec<f64> {
    let poses: Particles = x.iter().map(|&x| Pose2::new(x, 0.0, 0.0)).collect();
    let mut hits = Hits::default();
    hits.resize(x.len() * bearings.len());
    for nominal in hits.range.chunks_mut(ranges.len()) {
        nominal.copy_from_slice(ranges);
    }
    let mut out = vec![0.0; x.len()];
    let beams = hits.beams(poses.as_poses(), bearings, MAX_RANGE);
    model(parameters).log_likelihood(z, &beams, &mut Vec::new(), &mut out);
    out
}

fn assert_near(found: f64, expected: f64) {
    // Bearings and ranges are f32.
    assert!((found - expected).abs() < 1e-6, "{found}, by hand {expected}");
}

const BEARINGS: [f32; 3] = [0.0, FRAC_PI_2, PI];
const NOMINAL: [f32; 3] = [2.0, 15.0, 3.0];
const READINGS: [f32; 3] = [1.9, 1.0, MAX_RANGE];

/// Terms 0.491248 (0.1 m from the wall) and 0.05 (2 m); the third reading is ignored.
#[test]
fn the_likelihood_field_adds_cubes_to_one() {
    let defaults = AmclParameters::defaults(AmclKind::AmclLikelihoodField);
    let found = weigh(defaults, &[0.0], &BEARINGS, &NOMINAL, &READINGS);
    assert_near(found[0], FIELD);
    let defaults = AmclParameters::defaults(AmclKind::AmclLikelihoodFieldProb);
    let found = weigh(defaults, &[0.0], &BEARINGS, &NOMINAL, &READINGS);
    assert_near(found[0], PROB);
}

/// Distances of more than 0.3 m count as 0.3 m: 0.5 exp(-1.125) + 0.05 for the second beam.
#[test]
fn distances_are_cut() {
    let defaults = AmclParameters::defaults(AmclKind::AmclLikelihoodFieldProb);
    let cut = AmclParameters { laser_likelihood_max_dist: 0.3, ..defaults };
    let found = weigh(cut, &[0.0], &BEARINGS, &NOMINAL, &READINGS);
    assert_near(found[0], 0.491_248_45_f64.ln() + 0.212_326_23_f64.ln());
}

/// A hit of a reading that is a little short; a short one where nothing is in reach, which AMCL takes for a wall at the maximum range;
/// one at the maximum range before a wall.
#[test]
fn the_beam_model_adds_cubes_to_one() {
    let defaults = AmclParameters::defaults(AmclKind::AmclBeam);
    assert_near(weigh(defaults, &[0.0], &BEARINGS, &NOMINAL, &READINGS)[0], BEAM);
    // Below the minimum range: AMCL makes it the maximum range.
    let unusable = [READINGS[0], READINGS[1], f32::NAN];
    assert_near(weigh(defaults, &[0.0], &BEARINGS, &NOMINAL, &unusable)[0], BEAM);
}

/// (181 - 1) / (60 - 1) = 3 leaves 61 beams; 181 / 60, rounded up, is 4.
#[test]
fn beams_are_every_so_manieth_from_the_first_on() {
    let stride =
        |kind, max_beams, beams| AmclParameters { max_beams, ..AmclParameters::defaults(kind) }.stride(beams);
    assert_eq!(stride(AmclKind::AmclLikelihoodField, 60, 181), 3);
    assert_eq!(stride(AmclKind::AmclBeam, 60, 181), 3);
    assert_eq!(stride(AmclKind::AmclLikelihoodFieldProb, 60, 181), 4);
    // All of them, though 179 / 99 is nearly 2.
    assert_eq!(stride(AmclKind::AmclLikelihoodField, 100, 180), 1);
    for kind in AmclKind::ALL {
        assert_eq!(stride(*kind, 60, 1), 1);
    }
    // Readings in between don't count.
    for kind in AmclKind::ALL {
        let parameters = AmclParameters { max_beams: 2, ..AmclParameters::defaults(*kind) };
        let scan = |middle: f32| weigh(parameters, &[0.0], &[0.0; 4], &[2.0; 4], &[1.9, middle, 1.9, 1.9])[0];
        assert_eq!(scan(0.3).to_bits(), scan(1.7).to_bits(), "{kind}");
    }
}

/// Three particles 10 cm apart; a beam that ends at the wall for all of them, and one that a person stops a metre before it.
#[test]
fn a_beam_that_most_particles_disagree_with_is_skipped() {
    let (x, z) = ([0.0, 0.1, 0.2], [1.9, 1.0]);
    let prob = AmclParameters::defaults(AmclKind::AmclLikelihoodFieldProb);
    let skipping = AmclParameters { do_beamskip: true, max_beams: 2, ..prob };
    let weigh = |parameters, x: &[f64]| weigh(parameters, x, &[0.0; 2], &[2.0; 2], &z);
    for (found, expected) in weigh(skipping, &x).into_iter().zip(SKIPPED) {
        assert_near(found, expected);
    }
    // At half of the beams skipped, none is.
    let strict = AmclParameters { beam_skip_error_threshold: 0.5, ..skipping };
    assert_eq!(weigh(strict, &x), weigh(AmclParameters { max_beams: 2, ..prob }, &x));
    // Nor while the particles are apart.
    let apart = [0.0, 0.1, 1.5];
    assert_eq!(weigh(skipping, &apart), weigh(AmclParameters { max_beams: 2, ..prob }, &apart));
    assert!(model(skipping).needs_all_particles() && !model(prob).needs_all_particles());
}

#[test]
fn samples_follow_the_distribution_and_terms_are_finite() {
    let laser: Particles = [Pose2::IDENTITY].into_iter().collect();
    for kind in AmclKind::ALL {
        let amcl = model(AmclParameters::defaults(*kind));
        let mut hits = Hits::default();
        hits.resize(400);
        hits.range.fill(2.0);
        let bearings = vec![0.0; 400];
        let beams = hits.beams(laser.as_poses(), &bearings, MAX_RANGE);
        let mut z = vec![0.0; 400];
        amcl.sample(&beams, &Draw::new(4, Stage::Sensor, 0), &mut z);
        let mut below = vec![0.0; 400];
        amcl.cdf(&z, &beams, &mut below);
        let returns: Vec<f32> =
            below.iter().zip(&z).filter(|(_, z)| **z < MAX_RANGE).map(|(p, _)| *p).collect();
        // Uniform up to the share of returns; 0.289 / sqrt(400) is a standard error, 4.9 of them 7 %.
        let mean = returns.iter().sum::<f32>() / returns.len() as f32;
        assert!((mean - 0.5).abs() < 0.08, "{kind}: {mean}");
        let odd = [f32::NAN, 0.0, 2.0, MAX_RANGE, -1.0];
        let mut density = vec![0.0; 5];
        hits.resize(5);
        amcl.log_density(&odd, &hits.beams(laser.as_poses(), &bearings[..5], MAX_RANGE), &mut density);
        assert_eq!((density[0], density[4]), (0.0, f32::NEG_INFINITY));
        assert!(density[..4].iter().all(|l| l.is_finite()), "{kind}: {density:?}");
    }
}

#[test]
fn parameters_are_checked() {
    let usual = AmclParameters::defaults(AmclKind::AmclBeam);
    for (bad, what) in [
        (AmclParameters { z_hit: 1.5, ..usual }, "z_hit"),
        (AmclParameters { sigma_hit: 0.0, ..usual }, "sigma_hit"),
        (AmclParameters { lambda_short: f64::NAN, ..usual }, "lambda_short"),
        (AmclParameters { max_beams: 1, ..usual }, "max_beams"),
    ] {
        let error = Amcl::new(bad, Arc::new(Wall)).err().unwrap().to_string();
        assert!(error.contains(what), "{error}");
    }
}
