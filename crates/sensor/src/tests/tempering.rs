use std::sync::Arc;

use locsim_core::{Draw, Hits, Particles, SensorModel, Stage};
use rand::RngExt;
use rand_distr::{Distribution, Normal};

use super::simulated::{MAX_RANGE, Objects, model, training_set};
use crate::{
    CalibrationScan, ModelKind, Oracle, SensorError, Tempered, TemperingGrid, choose_tempering, evaluate,
};

const SIGMA_M: f64 = 0.01;

/// 400 scans of 6 beams with noise of 1 cm; the candidates' ranges are off by U(-3, 3) cm, the same for every
/// beam, as a wrong pose's are. Each reading is repeated `copies` times. A share of the readings is wrong.
fn scans(copies: usize, wrong: f64) -> Vec<CalibrationScan> {
    (0..400)
        .map(|s| {
            let mut rng = Draw::new(6, Stage::Training, 2).item(s);
            let ranges: Vec<f64> = (0..6).map(|_| 1.0 + 2.5 * rng.random::<f64>()).collect();
            let readings: Vec<f32> = ranges
                .iter()
                .map(|&r| {
                    if rng.random::<f64>() < wrong {
                        return MAX_RANGE * rng.random::<f32>();
                    }
                    Normal::new(r, SIGMA_M).unwrap().sample(&mut rng) as f32
                })
                .collect();
            let mut hits = Hits::default();
            for candidate in 0..20 {
                let off = if candidate == 0 { 0.0 } else { 0.06 * rng.random::<f64>() - 0.03 };
                for _ in 0..copies {
                    hits.range.extend(ranges.iter().map(|r| (r + off) as f32));
                }
            }
            hits.resize(hits.range.len());
            CalibrationScan {
                z: readings.repeat(copies),
                laser: Particles::zeros(20),
                bearings: vec![0.0; 6 * copies],
                hits,
                max_range: MAX_RANGE,
            }
        })
        .collect()
}

/// The true density of a reading that isn't wrong.
fn exact() -> Oracle {
    struct Nothing;
    impl locsim_core::Obstructions for Nothing {
        fn bin_m(&self) -> f32 {
            1.0
        }
        fn survival(&self, _x: f64, _y: f64, _heading: f64, _range: f32) -> locsim_core::Survival<'_> {
            locsim_core::Survival { probability: &[1.0], start_m: 0.0 }
        }
    }
    Oracle::new(Arc::new(Nothing), SIGMA_M as f32, 0.0).unwrap()
}

fn grid() -> TemperingGrid {
    TemperingGrid { floors: vec![1e-6, 1e-3, 0.03, 0.3], exponents: vec![0.0625, 0.125, 0.25, 0.5, 1.0, 2.0] }
}

/// A correct model needs no tempering; readings that are repeated four times count a quarter each.
#[test]
fn the_exponent_makes_up_for_beams_that_say_the_same() {
    assert_eq!(choose_tempering(&exact(), &scans(1, 0.0), &grid()).unwrap().exponent, 1.0);
    assert_eq!(choose_tempering(&exact(), &scans(4, 0.0), &grid()).unwrap().exponent, 0.25);
}

#[test]
fn the_floor_follows_the_share_of_wrong_readings() {
    let clean = choose_tempering(&exact(), &scans(1, 0.0), &grid()).unwrap();
    let dirty = choose_tempering(&exact(), &scans(1, 0.3), &grid()).unwrap();
    assert!(clean.floor <= 1e-3, "{clean:?}");
    assert_eq!(dirty.floor, 0.3, "{dirty:?}");
    // better than not knowing which of 20, worse with wrong readings
    assert!(clean.score > dirty.score && dirty.score > -(20.0f64.ln()) && clean.score < 0.0);
}

#[test]
fn tempering_is_its_formula() {
    let (floor, exponent) = (0.05, 0.3);
    let tempered = Tempered::new(model(ModelKind::NpRegRegistered), floor, exponent).unwrap();
    assert_eq!(tempered.name(), "np_reg_registered");
    let scan = &scans(1, 0.3)[0];
    let beams = scan.hits.beams(scan.laser.as_poses(), &scan.bearings, MAX_RANGE);
    let mut z = scan.z.clone();
    (z[0], z[1]) = (MAX_RANGE, f32::NAN);
    let (mut plain, mut out) = (vec![0.0f32; beams.len()], vec![0.0f32; beams.len()]);
    model(ModelKind::NpRegRegistered).log_density(&z, &beams, &mut plain);
    tempered.log_density(&z, &beams, &mut out);
    for (i, (plain, out)) in plain.iter().zip(&out).enumerate() {
        let z = z[i % z.len()];
        let q = if z >= MAX_RANGE { 0.5 } else { 0.5 / f64::from(MAX_RANGE) };
        let expected = exponent * ((1.0 - floor) * f64::from(*plain).exp() + floor * q).ln();
        let expected = if z.is_nan() { 0.0 } else { expected };
        assert!((expected - f64::from(*out)).abs() < 1e-5);
    }
}

#[test]
fn bad_constants_and_calibrations_are_refused() {
    let inner = model(ModelKind::Classic);
    for (floor, exponent) in [(-0.1, 1.0), (1.1, 1.0), (f64::NAN, 1.0), (0.1, 0.0), (0.1, f64::NAN)] {
        let refused = Tempered::new(inner.clone(), floor, exponent);
        assert!(matches!(refused, Err(SensorError::Parameter { .. })));
    }
    let refuse =
        |scans: &[CalibrationScan], grid: &TemperingGrid| choose_tempering(&*inner, scans, grid).unwrap_err();
    assert!(matches!(refuse(&[], &grid()), SensorError::Calibration(_)));
    let scans = scans(1, 0.0);
    assert!(matches!(
        refuse(&scans, &TemperingGrid { floors: vec![], ..grid() }),
        SensorError::Calibration(_)
    ));
    let bad = TemperingGrid { exponents: vec![-1.0], ..grid() };
    assert!(matches!(refuse(&scans, &bad), SensorError::Parameter { .. }));
    let mut short = scans;
    short[3].z.pop();
    assert!(matches!(refuse(&short, &grid()), SensorError::Calibration(_)));
}

/// Every learnt model survives readings that it holds impossible: none costs more than -ln(floor q) =
/// ln(100) + ln(9) nats.
#[test]
fn a_floor_bounds_every_score_from_below() {
    let data = training_set(50, 3, 12);
    for &kind in ModelKind::ALL {
        let tempered = Tempered::new(model(kind), 0.01, 1.0).unwrap();
        let loss = evaluate(&tempered, &data).log_loss_nats;
        assert!(loss <= 900.0f64.ln(), "{kind}: {loss}");
    }
}

#[test]
fn an_oracle_needs_noise() {
    for (sigma, per_m) in [(0.0, 0.0), (-1.0, 0.0), (0.01, -0.1), (f32::NAN, 0.0)] {
        let refused = Oracle::new(Arc::new(Objects::default()), sigma, per_m);
        assert!(matches!(refused, Err(SensorError::Parameter { .. })));
    }
}
