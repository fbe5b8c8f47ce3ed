//! Models as tables against the models themselves.

use std::sync::Arc;

use locsim_core::{
    EndpointGrid, EndpointScan, Hits, Laser, LikelihoodGrid, ModelTable, Particles, Pose2, SensorModel,
};

use super::simulated::{MAX_RANGE, Objects, model, training_set};
use crate::{ModelKind, Oracle, Prepared, SensorError, Tempered};

const ENDPOINTS: EndpointGrid = EndpointGrid { x0: -3.0, y0: -3.0, cell_m: 0.01, columns: 800, rows: 600 };

fn states() -> LikelihoodGrid {
    LikelihoodGrid::for_laser(&Laser::new(vec![0.0], vec![0.0], 0.0, MAX_RANGE, Pose2::IDENTITY).unwrap())
}

fn tempered(kind: ModelKind) -> Arc<dyn SensorModel> {
    Arc::new(Tempered::new(model(kind), 0.01, 0.7).unwrap())
}

/// Log densities (nats) of readings of given states, by the model and by its table.
fn both(kind: ModelKind, states_and_readings: &[(f32, f32, f32)]) -> Vec<(f64, f64)> {
    let model = tempered(kind);
    let prepared = Prepared::new(Arc::clone(&model), states(), &ENDPOINTS).unwrap();
    let Some(ModelTable::State(table)) = prepared.table() else { panic!("{kind} knows states") };
    let laser: Particles = [Pose2::IDENTITY].into_iter().collect();
    let n = states_and_readings.len();
    let mut hits = Hits::default();
    hits.resize(n);
    let mut z = Vec::new();
    for (i, &(range, incidence, reading)) in states_and_readings.iter().enumerate() {
        (hits.range[i], hits.incidence[i]) = (range, incidence);
        z.push(reading);
    }
    let mut exact = vec![0.0; n];
    model.log_density(&z, &hits.beams(laser.as_poses(), &vec![0.0; n], MAX_RANGE), &mut exact);
    let tabled = states_and_readings.iter().map(|&(r, a, z)| table.log_density(z, r, a.cos()));
    exact.into_iter().map(f64::from).zip(tabled.map(f64::from)).collect()
}

const KINDS: [ModelKind; 5] = [
    ModelKind::Classic,
    ModelKind::BeamMixture,
    ModelKind::PReg,
    ModelKind::NpReg,
    ModelKind::NpRegRegistered,
];

#[test]
fn a_table_is_its_model_at_the_knots() {
    let (ranges, incidences) = states().states();
    let knots: Vec<(f32, f32, f32)> = (0..ranges.len())
        .step_by(997)
        .flat_map(|i| [0, 3, 400, 899, 900].map(|row| (ranges[i], incidences[i], states().reading(row))))
        .collect();
    for kind in KINDS {
        for (exact, tabled) in both(kind, &knots) {
            assert!((exact - tabled).abs() < 2e-3, "{kind}: {exact} and {tabled}");
        }
    }
}

/// Between knots 5 mm apart, with a sensor whose noise is 1 cm, a table loses 0.008 to 0.012 nats of log loss on held-out
/// readings (measured).
#[test]
fn a_table_costs_little_between_the_knots() {
    let held_out = training_set(2000, 1, 77);
    let readings: Vec<_> = held_out.readings().map(|(z, beam)| (beam.nominal, beam.incidence, z)).collect();
    for kind in KINDS {
        let both = both(kind, &readings);
        let n = both.len() as f64;
        let loss = both.iter().map(|(exact, tabled)| exact - tabled).sum::<f64>() / n;
        let off = both.iter().map(|(exact, tabled)| (exact - tabled).abs()).sum::<f64>() / n;
        assert!(loss.abs() < 0.02, "{kind}: log loss grows by {loss}");
        assert!(off < 0.25, "{kind}: {off} nats on average");
    }
}

#[test]
fn the_likelihood_field_is_a_table_over_the_plane() {
    let model = tempered(ModelKind::LikelihoodField);
    let prepared = Prepared::new(Arc::clone(&model), states(), &ENDPOINTS).unwrap();
    let Some(ModelTable::Endpoint(table)) = prepared.table() else { panic!("it knows where a reading ends") };
    let poses: Particles =
        (0..40).map(|i| Pose2::new(0.02 * f64::from(i), 0.3, 0.1 * f64::from(i))).collect();
    // A beam count that fills no run, a NaN reading, and one of no return.
    let bearings: Vec<f32> = (0..11).map(|i| 0.2 * i as f32).collect();
    let mut z: Vec<f32> = (0..11).map(|i| 0.5 + 0.15 * i as f32).collect();
    (z[3], z[8]) = (f32::NAN, MAX_RANGE);
    let mut scan = EndpointScan::default();
    scan.prepare(&bearings, &z, table);
    let mut tabled = vec![0.0; poses.len()];
    table.log_likelihood(poses.as_poses(), &scan, &mut tabled);
    let (mut hits, mut exact) = (Hits::default(), vec![0.0; poses.len()]);
    hits.resize(poses.len() * bearings.len());
    let beams = hits.beams(poses.as_poses(), &bearings, MAX_RANGE);
    model.log_likelihood(&z, &beams, &mut Vec::new(), &mut exact);
    for (exact, tabled) in exact.iter().zip(&tabled) {
        // The score's slope is below 60 nats per metre, and a cell's corner 7 mm from its centre.
        assert!((exact - tabled).abs() < 9.0 * 0.4, "{exact} and {tabled}");
    }
    let mean = exact.iter().zip(&tabled).map(|(a, b)| (a - b).abs()).sum::<f64>() / 40.0;
    assert!(mean < 0.3, "{mean} nats on average");
}

#[test]
fn a_scaled_table_is_that_of_another_exponent() {
    for kind in [ModelKind::BeamMixture, ModelKind::NpRegRegistered, ModelKind::LikelihoodField] {
        let made = |exponent: f64| Arc::new(Tempered::new(model(kind), 0.01, exponent).unwrap());
        let prepared = |exponent: f64| Prepared::new(made(exponent), states(), &ENDPOINTS).unwrap();
        let scaled = prepared(0.2).scaled(made(0.6), 3.0);
        match (scaled.table().unwrap(), prepared(0.6).table().unwrap()) {
            (ModelTable::State(a), ModelTable::State(b)) => {
                for (range, z) in [(1.0, 1.0), (1.0, 0.4), (2.0, 2.01), (2.0, MAX_RANGE)] {
                    let [a, b] = [a, b].map(|table| table.log_density(z, range, 0.7));
                    assert!((a - b).abs() < 3e-3, "{kind}: {a} and {b} at {z} of {range} m");
                }
            }
            (ModelTable::Endpoint(a), ModelTable::Endpoint(b)) => {
                let poses: Particles = [Pose2::new(0.3, 0.3, 0.1)].into_iter().collect();
                let [a, b] = [a, b].map(|table| {
                    let (mut scan, mut sum) = (EndpointScan::default(), [0.0]);
                    scan.prepare(&[0.0, 1.0], &[0.5, 1.0], table);
                    table.log_likelihood(poses.as_poses(), &scan, &mut sum);
                    sum[0]
                });
                assert!((a - b).abs() < 6e-3, "{a} and {b}");
            }
            _ => panic!("{kind}: tables of two kinds"),
        }
    }
}

#[test]
fn the_oracle_has_no_table() {
    let oracle = Arc::new(Oracle::new(Arc::new(Objects::default()), 0.01, 0.002).unwrap());
    let refused = Prepared::new(oracle, states(), &ENDPOINTS).err();
    assert!(matches!(refused, Some(SensorError::NoTable { .. })));
}
