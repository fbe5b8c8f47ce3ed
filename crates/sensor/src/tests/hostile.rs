//! Model files with a right hash and wrong content.

use std::path::Path;
use std::sync::Arc;

use ciborium::{Value, cbor};
use locsim_core::{Draw, Stage};
use rand::{Rng, RngExt};

use super::simulated::{MAX_RANGE, REACH, Wall, fitted};
use crate::total::OneBeam;
use crate::{FittedModel, ModelKind, SensorError};

/// Bytes before the content: magic, version, hash.
const HEADER: usize = 44;

/// A file with this content and a right hash.
fn file_of(body: &[u8]) -> Vec<u8> {
    let start = fitted(ModelKind::Classic).to_bytes();
    [&start[..12], blake3::hash(body).as_bytes(), body].concat()
}

fn encoded(value: &Value) -> Vec<u8> {
    let mut body = Vec::new();
    ciborium::into_writer(value, &mut body).unwrap();
    body
}

fn loaded(value: &Value) -> Result<FittedModel, String> {
    FittedModel::from_bytes(&file_of(&encoded(value)), Path::new("model")).map_err(|error| {
        let SensorError::Damaged { what, .. } = error else { panic!("{error}") };
        what
    })
}

fn decoded(bytes: &[u8]) -> Value {
    ciborium::from_reader(&bytes[HEADER..]).unwrap()
}

/// A sound model of each kind; the tables of the regressed ones have only a few cells.
fn sound(kind: ModelKind) -> Value {
    let grid = |reach: f32| cbor!({"reach" => reach, "ranges" => 3, "incidences" => 2}).unwrap();
    let table = |reach: f32, axis: Value, masses: &[f32]| {
        let mass: Vec<f32> = (0..7).flat_map(|_| masses.to_vec()).collect();
        let grid = grid(reach);
        cbor!({"Histogram" => {
            "kind" => kind, "max_range" => MAX_RANGE, "grid" => grid, "axis" => axis, "mass" => mass,
        }})
    };
    let form = match kind {
        ModelKind::PReg => {
            let cell = cbor!({"offset_m" => -0.01f32, "sigma_m" => 0.02f32, "no_return" => 0.1f32}).unwrap();
            let (grid, cells) = (grid(MAX_RANGE), vec![cell; 7]);
            cbor!({"Normal" => {"grid" => grid, "cells" => cells}})
        }
        ModelKind::NpReg => {
            let axis = cbor!({"origin" => 0.0f32, "quantum" => 0.5f32, "ends" => [1, 3, 9]}).unwrap();
            table(MAX_RANGE, axis, &[0.2, 0.3, 0.4])
        }
        ModelKind::NpRegRegistered => {
            let axis = cbor!({"origin" => -REACH, "quantum" => 0.75f32, "ends" => [8, 9, 10, 18]}).unwrap();
            table(REACH, axis, &[0.2, 0.3, 0.4, 0.05])
        }
        _ => return decoded(&fitted(kind).to_bytes()),
    };
    let form = form.unwrap();
    cbor!({
        "kind" => kind, "max_range" => MAX_RANGE, "chosen" => {"held_out_log_loss_nats" => f64::INFINITY}, "form" => form,
    })
    .unwrap()
}

/// The value at a path of keys.
fn at<'a>(value: &'a mut Value, path: &[&str]) -> &'a mut Value {
    path.iter().fold(value, |value, key| match value {
        Value::Array(items) => &mut items[key.parse::<usize>().unwrap()],
        Value::Map(entries) => {
            let entry = entries.iter_mut().find(|(name, _)| name.as_text() == Some(key));
            &mut entry.unwrap_or_else(|| panic!("no {key}")).1
        }
        _ => panic!("no {key}"),
    })
}

/// The error for a file in which the value at `path` is replaced by `new`.
fn refusal(kind: ModelKind, path: &[&str], new: impl Into<Value>) -> String {
    let mut value = sound(kind);
    *at(&mut value, path) = new.into();
    match loaded(&value) {
        Ok(_) => panic!("{kind} {path:?}: accepted"),
        Err(what) => what,
    }
}

#[test]
fn each_field_is_checked() {
    use ModelKind::{BeamMixture, Classic, LikelihoodField, NpReg, NpRegRegistered, PReg};
    for &kind in ModelKind::ALL {
        loaded(&sound(kind)).unwrap();
    }
    let weights = |weights: [f32; 4]| Value::Array(weights.map(|w| Value::Float(w.into())).into());
    let ends = |ends: &[u64]| Value::Array(ends.iter().map(|&end| end.into()).collect());
    let whole = |n: u64| Value::Integer(n.into());
    let real = Value::Float;
    let text = |text: &str| Value::Text(text.to_owned());
    let mixture = |key| ["form", "Mixture", key];
    let field = |key| ["form", "Field", key];
    let cell = |key| ["form", "Normal", "cells", "3", key];
    let histogram = |key| ["form", "Histogram", key];
    let axis = |key| ["form", "Histogram", "axis", key];
    let cases: &[(ModelKind, &[&str], Value, &str)] = &[
        (Classic, &["max_range"], real(0.0), "maximum range 0 m is not allowed"),
        (Classic, &["max_range"], real(f64::NAN), "maximum range NaN m"),
        (Classic, &["max_range"], real(1e30), "from 0.001 m to 1000000 m"),
        (Classic, &["kind"], text("np_reg"), "it says it is np_reg, and holds the form of classic"),
        (Classic, &["kind"], text("beam_mixture"), "it says it is beam_mixture"),
        (Classic, &["chosen", "sigma_m"], real(f64::NAN), "NaN is not allowed as the chosen value `sigma_m`"),
        (
            BeamMixture,
            &mixture("weights"),
            weights([100.0; 4]),
            "weight 100 of hit is not allowed; from 0 to 1",
        ),
        (BeamMixture, &mixture("weights"), weights([0.3; 4]), "the weights sum to 1.2"),
        (BeamMixture, &mixture("weights"), weights([0.0; 4]), "the weights sum to 0"),
        (BeamMixture, &mixture("weights"), weights([f32::NAN; 4]), "weight NaN of hit"),
        (Classic, &mixture("weights"), weights([0.5, 0.2, 0.2, 0.1]), "weights 0.2 of max and 0.1 of random"),
        (Classic, &mixture("sigma_m"), real(0.0), "sigma 0 m is not allowed; at least 0.0001"),
        (Classic, &mixture("sigma_m"), real(f64::INFINITY), "sigma inf m"),
        (BeamMixture, &mixture("lambda_per_m"), real(0.0), "lambda 0 per m is not allowed"),
        (BeamMixture, &mixture("lambda_per_m"), real(1e4), "lambda 10000 per m is not allowed"),
        (LikelihoodField, &field("z_hit"), real(100.0), "weight 100 of z_hit"),
        (LikelihoodField, &field("z_rand"), real(0.9), "the weights sum to"),
        (LikelihoodField, &field("z_max"), real(1.0), "z_max 1 are not allowed"),
        (LikelihoodField, &field("sigma_m"), real(-1.0), "sigma -1 m"),
        (
            PReg,
            &["form", "Normal", "grid", "ranges"],
            whole(u64::MAX),
            "doesn't match the grid of 18446744073709551615 ranges",
        ),
        (PReg, &["form", "Normal", "grid", "incidences"], whole(1 << 63), "doesn't match the grid"),
        (PReg, &["form", "Normal", "grid", "ranges"], whole(0), "doesn't match the grid"),
        (PReg, &["form", "Normal", "grid", "reach"], real(1e-30), "its table reaches to"),
        (PReg, &["form", "Normal", "grid", "reach"], real(f64::NAN), "reaches to NaN m"),
        (PReg, &cell("sigma_m"), real(0.0), "cell 3 are no distribution"),
        (PReg, &cell("offset_m"), real(f64::NAN), "cell 3 are no distribution"),
        (PReg, &cell("no_return"), real(1.1), "cell 3 are no distribution"),
        (NpReg, &histogram("kind"), text("np_reg_registered"), "it says it is np_reg"),
        (NpReg, &histogram("max_range"), real(9.0), "its table reaches to 9 m, not to 4.5 m"),
        (
            NpRegRegistered,
            &["form", "Histogram", "grid", "reach"],
            real(4.5),
            "reaches to 4.5 m, not to 6.75 m",
        ),
        (NpReg, &["form", "Histogram", "grid", "ranges"], whole(1 << 62), "doesn't match the grid"),
        (NpReg, &axis("ends"), ends(&[1, 3, (1 << 32) - 1]), "bins up to quantum 4294967295 are not allowed"),
        (NpReg, &axis("ends"), ends(&[1, 1, 9]), "bins are out of order"),
        (NpReg, &axis("ends"), ends(&[0, 1, 9]), "bins are out of order"),
        (NpReg, &axis("ends"), ends(&[]), "bins are out of order"),
        (NpReg, &axis("quantum"), real(-0.5), "quanta of -0.5 m are not allowed"),
        (NpReg, &axis("quantum"), real(1e-45), "integrates to"),
        (NpReg, &axis("quantum"), real(1e38), "bin 2 is inf m wide"),
        (NpReg, &axis("origin"), real(1e30), "bin 0 is 0 m wide"),
        (NpReg, &axis("origin"), real(1.0), "the density integrates to"),
        (NpReg, &[histogram("mass").as_slice(), &["4"]].concat(), real(1.5), "mass 1.5 of bin 1 of cell 1"),
        (
            NpReg,
            &[histogram("mass").as_slice(), &["4"]].concat(),
            real(0.5),
            "the masses of cell 1 sum to 1.1",
        ),
    ];
    for (kind, path, new, expected) in cases {
        let what = refusal(*kind, path, new.clone());
        assert!(what.contains(expected), "{kind} {path:?}: {what}");
    }
}

/// The parts of a mixture are densities whatever its parameters are; a table's bins may miss readings.
#[test]
fn a_density_that_does_not_integrate_to_one_is_refused() {
    // Bins to 3 m alone: readings beyond have the density of the last one.
    let short = Value::Array([1u64, 3, 6].map(Value::from).into());
    let what = refusal(ModelKind::NpReg, &["form", "Histogram", "axis", "ends"], short);
    assert!(what.starts_with("the density integrates to 1.3"), "{what}");
    let finer = Value::Float(0.1);
    let what = refusal(ModelKind::NpRegRegistered, &["form", "Histogram", "axis", "quantum"], finer);
    assert!(what.starts_with("the density integrates to"), "{what}");
}

#[test]
fn names_of_chosen_values_are_plain_and_few() {
    let with = |names: Vec<String>| {
        let mut value = sound(ModelKind::PReg);
        let entries = names.into_iter().map(|name| (Value::Text(name), Value::Float(0.0))).collect();
        *at(&mut value, &["chosen"]) = Value::Map(entries);
        loaded(&value).map(drop)
    };
    with(vec!["a".repeat(64)]).unwrap();
    for name in ["", "a b", "<script>", &"a".repeat(65)] {
        assert!(with(vec![name.to_owned()]).unwrap_err().contains("as the name of a chosen value"));
    }
    with((0..32).map(|i| format!("a{i}")).collect()).unwrap();
    let many = with((0..33).map(|i| format!("a{i}")).collect()).unwrap_err();
    assert_eq!(many, "33 chosen values are not allowed; at most 32");
}

#[test]
fn what_follows_the_model_unknown_keys_and_deep_nesting_are_refused() {
    let refused = |body: &[u8]| match FittedModel::from_bytes(&file_of(body), Path::new("m")).unwrap_err() {
        SensorError::Damaged { what, .. } => what,
        other => panic!("{other}"),
    };
    let mut body = encoded(&sound(ModelKind::PReg));
    body.push(0);
    assert_eq!(refused(&body), "1 bytes follow the model");
    let mut value = sound(ModelKind::PReg);
    value.as_map_mut().unwrap().push((Value::Text("extra".to_owned()), Value::Null));
    assert!(refused(&encoded(&value)).contains("unknown field `extra`"));
    for deep in [0x81, 0xa1, 0xc1, 0x9f, 0xbf] {
        refused(&vec![deep; 1 << 20]);
        refused(&[&[0xa1, 0x66, b'c', b'h', b'o', b's', b'e', b'n'][..], &vec![deep; 1 << 20]].concat());
    }
}

/// Changes something somewhere.
fn mutate(value: &mut Value, others: &Value, rng: &mut impl Rng) {
    const REALS: [f64; 16] = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        100.0,
        1e-45,
        1e-38,
        1e-7,
        1e7,
        3.4e38,
        -3.4e38,
        1e300,
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
    ];
    const WHOLES: [i128; 12] =
        [0, 1, 2, -1, 255, 65_536, 1 << 26, 1 << 31, (1 << 32) - 1, 1 << 32, 1 << 63, (1 << 64) - 1];
    let inner = match value {
        Value::Array(items) => items.len(),
        Value::Map(entries) => entries.len(),
        _ => 0,
    };
    if inner > 0 && rng.random::<f32>() < 0.85 {
        let i = rng.random_range(0..inner);
        return match value {
            Value::Array(items) => mutate(&mut items[i], others, rng),
            Value::Map(entries) => mutate(&mut entries[i].1, others, rng),
            _ => unreachable!("it has something in it"),
        };
    }
    match value {
        Value::Array(items) if inner > 0 => {
            let i = rng.random_range(0..inner);
            match rng.random_range(0..4) {
                0 => items.truncate(i),
                1 => items.push(items[i].clone()),
                2 => items.swap(0, i),
                _ => drop(items.remove(i)),
            }
        }
        Value::Map(entries) if inner > 0 => {
            let (i, j) = (rng.random_range(0..inner), rng.random_range(0..inner));
            match rng.random_range(0..4) {
                0 => drop(entries.remove(i)),
                1 => entries.push(entries[i].clone()),
                2 => {
                    let key = entries[i].0.clone();
                    entries[i].0 = std::mem::replace(&mut entries[j].0, key);
                }
                _ => entries[i].0 = Value::Text("other".to_owned()),
            }
        }
        Value::Float(x) if rng.random::<bool>() => *x *= 4.0 * rng.random::<f64>(),
        Value::Float(x) => *x = REALS[rng.random_range(0..REALS.len())],
        Value::Integer(n) => *n = WHOLES[rng.random_range(0..WHOLES.len())].try_into().unwrap(),
        other => *other = others.clone(),
    }
}

/// Models as they may come, loaded or refused; a loaded one answers every question and is normalized. Returns how many
/// were loaded.
fn survive(cases: u32, seed: u64) -> usize {
    let draw = Draw::new(seed, Stage::Training, 9);
    let kinds = ModelKind::ALL;
    let sound: Vec<_> = kinds.iter().copied().map(sound).collect();
    let mut accepted = 0;
    for case in 0..cases {
        let rng = &mut draw.item(case);
        let mut value = sound[case as usize % kinds.len()].clone();
        let other = &sound[rng.random_range(0..kinds.len())];
        for _ in 0..rng.random_range(1..4) {
            mutate(&mut value, other, rng);
        }
        let mut body = encoded(&value);
        if rng.random::<f32>() < 0.3 {
            let i = rng.random_range(0..body.len());
            body[i] = rng.random();
        }
        let Ok(model) = FittedModel::from_bytes(&file_of(&body), Path::new("model")) else { continue };
        accepted += 1;
        let (kind, max_range) = (model.kind(), model.max_range());
        let model = model.into_model(Some(Arc::new(Wall))).unwrap();
        let nominal = max_range * rng.random_range(0.0..1.6f32);
        let beam = OneBeam { model: &*model, max_range, nominal, incidence: rng.random_range(0.0..1.6) };
        let z: Vec<f32> = (0..40)
            .map(|i| max_range * [0.0, 1.0, 2.0, rng.random(), rng.random()][i % 5])
            .chain([f32::NAN, -1.0, f32::INFINITY, nominal])
            .collect();
        let logs = beam.ask(&z, |model, beams, out| model.log_density(z.as_slice(), beams, out));
        assert!(logs.iter().all(|log| !log.is_nan() && *log < f32::INFINITY), "{kind} case {case}: {logs:?}");
        let shares = beam.ask(&z, |model, beams, out| model.cdf(z.as_slice(), beams, out));
        let is_share = |(z, share): (&f32, &f32)| z.is_nan() || (0.0..=1.0).contains(share);
        assert!(z.iter().zip(&shares).all(is_share), "{kind} case {case}: {shares:?}");
        let drawn = beam.ask(&z, |model, beams, out| model.sample(beams, &draw, out));
        assert!(drawn.iter().all(|z| (0.0..=max_range).contains(z)), "{kind} case {case}: {drawn:?}");
        if kind.is_normalized() {
            let totals = beam.totals();
            assert!(
                totals.iter().all(|t| (t - 1.0).abs() < 0.02),
                "{kind} case {case} at {nominal} m: {totals:?}"
            );
        }
    }
    accepted
}

#[test]
fn no_content_brings_a_reader_down() {
    let accepted = survive(3000, 1);
    assert!((100..2900).contains(&accepted), "{accepted} were loaded");
}
