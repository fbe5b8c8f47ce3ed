use std::collections::BTreeSet;

use super::simulated::{MAX_RANGE, model, state, training_set};
use crate::{FitOptions, ModelKind, SensorError, TrainingSet, evaluate, fit};

fn scans(set: &TrainingSet) -> BTreeSet<u32> {
    (0..set.len()).map(|i| set.state(i).scan).collect()
}

#[test]
fn a_split_parts_scans_and_keeps_every_reading() {
    let set = training_set(500, 3, 1);
    let (train, held_out) = set.split(0.3, 7).unwrap();
    assert!(scans(&train).is_disjoint(&scans(&held_out)));
    assert_eq!((scans(&train).len(), scans(&held_out).len()), (35, 15));
    assert_eq!(train.reading_count() + held_out.reading_count(), set.reading_count());
    let again = set.split(0.3, 7).unwrap().1;
    assert_eq!(scans(&again), scans(&held_out));
    assert_ne!(scans(&set.split(0.3, 8).unwrap().1), scans(&held_out));
    assert_eq!(train.observations(4), {
        let first = train.state(4);
        let i = (0..set.len()).find(|&i| set.state(i) == first).unwrap();
        set.observations(i)
    });
    for share in [0.0, 1.0, f64::NAN] {
        assert!(matches!(set.split(share, 1), Err(SensorError::Parameter { .. })));
    }
}

#[test]
fn runs_of_scans_stay_together() {
    let set = training_set(500, 1, 1);
    let (train, held_out) = set.split_runs(0.3, 7, 10).unwrap();
    let runs = |part: &TrainingSet| -> BTreeSet<u32> { scans(part).iter().map(|scan| scan / 10).collect() };
    assert!(runs(&train).is_disjoint(&runs(&held_out)));
    assert_eq!((scans(&train).len(), scans(&held_out).len()), (30, 20));
}

#[test]
fn both_parts_of_a_split_have_a_scan_where_there_are_two() {
    let two = training_set(20, 1, 1);
    for share in [0.01, 0.99] {
        let (train, held_out) = two.split(share, 1).unwrap();
        assert_eq!((scans(&train).len(), scans(&held_out).len()), (1, 1));
    }
}

#[test]
fn readings_of_nothing_are_left_out_and_impossible_ones_refused() {
    let mut set = TrainingSet::new(MAX_RANGE).unwrap();
    assert!(!set.push(state(1.0, 0.1, 0), &[f32::NAN]).unwrap());
    assert!(!set.push(state(1.0, 0.1, 0), &[]).unwrap());
    assert!(set.push(state(1.0, 0.1, 0), &[f32::NAN, 0.0, MAX_RANGE]).unwrap());
    assert_eq!((set.len(), set.observations(0)), (1, &[0.0, MAX_RANGE][..]));
    for z in [-0.1, MAX_RANGE + 0.1, f32::INFINITY] {
        assert!(matches!(set.push(state(1.0, 0.1, 0), &[1.0, z]), Err(SensorError::Reading { .. })));
    }
    for bad in [state(7.0, 0.1, 0), state(f32::NAN, 0.1, 0), state(1.0, 1.7, 0), state(1.0, -0.1, 0)] {
        assert!(matches!(set.push(bad, &[1.0]), Err(SensorError::State { index: 1, .. })));
    }
    assert_eq!((set.len(), set.reading_count()), (1, 2));
    for max_range in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(TrainingSet::new(max_range), Err(SensorError::MaxRange(_))));
    }
}

#[test]
fn fitting_says_what_is_missing() {
    let options = FitOptions::default();
    let set = training_set(40, 2, 1);
    let empty = TrainingSet::new(MAX_RANGE).unwrap();
    let open = set.filtered(|s| s.range >= MAX_RANGE);
    for kind in ModelKind::ALL.iter().copied().filter(|kind| kind.is_normalized()) {
        for train in [&empty, &open] {
            let refused = fit(kind, train, &set, &options);
            assert!(matches!(refused, Err(SensorError::TooFewData { .. })), "{kind}");
        }
    }
    for kind in [ModelKind::PReg, ModelKind::NpReg, ModelKind::NpRegRegistered] {
        assert!(matches!(fit(kind, &set, &empty, &options), Err(SensorError::TooFewData { .. })), "{kind}");
    }
    let other = TrainingSet::new(8.0).unwrap();
    let refused = fit(ModelKind::Classic, &set, &other, &options);
    assert!(matches!(refused, Err(SensorError::MaxRangesDiffer { .. })));
    for kind in [ModelKind::LikelihoodField, ModelKind::NpRegField] {
        let refused = fit(kind, &set, &set, &options);
        assert!(matches!(refused, Err(SensorError::NoDistanceMap)), "{kind}");
    }
}

#[test]
fn names_of_models_are_read_back() {
    for &kind in ModelKind::ALL {
        assert_eq!(kind.to_string().parse::<ModelKind>().unwrap(), kind);
        assert_eq!(model(kind).name(), kind.as_str());
    }
    let error = "np_regg".parse::<ModelKind>().unwrap_err().to_string();
    assert!(error.contains("np_regg") && error.contains("np_reg_registered"), "{error}");
}

/// One state, one reading: the match is the model's mean distance from the reading. For a uniform model over
/// \[0, max) and a reading in the middle that is max / 4.
#[test]
fn the_histogram_match_of_one_reading_is_the_mean_distance_from_it() {
    struct Uniform;
    impl locsim_core::SensorModel for Uniform {
        fn name(&self) -> &'static str {
            "uniform"
        }
        fn log_density(&self, z: &[f32], _: &locsim_core::Beams<'_>, out: &mut [f32]) {
            out[..z.len()].fill((1.0 / MAX_RANGE).ln());
        }
        fn cdf(&self, z: &[f32], _: &locsim_core::Beams<'_>, out: &mut [f32]) {
            out.iter_mut().zip(z).for_each(|(p, z)| *p = z / MAX_RANGE);
        }
        fn sample(&self, _: &locsim_core::Beams<'_>, _: &locsim_core::Draw, _: &mut [f32]) {}
    }
    let mut set = TrainingSet::new(MAX_RANGE).unwrap();
    set.push(state(1.0, 0.1, 0), &[0.5 * MAX_RANGE]).unwrap();
    let score = evaluate(&Uniform, &set);
    assert!((score.histogram_match_m - 0.25 * f64::from(MAX_RANGE)).abs() < 1e-4);
    assert!((score.log_loss_nats - f64::from(MAX_RANGE).ln()).abs() < 1e-6);
}
