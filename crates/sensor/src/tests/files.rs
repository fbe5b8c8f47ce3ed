use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use locsim_core::limits::Limits;
use tempfile::TempDir;

use super::simulated::{Wall, fitted, training_set};
use crate::{FittedModel, ModelKind, SensorError, evaluate};

fn saved(kind: ModelKind) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    fitted(kind).save(&path).unwrap();
    (folder, path)
}

/// Scores are sums over thousands of densities, so that equal bits mean equal densities.
#[test]
fn a_loaded_model_is_the_saved_one_bit_for_bit() {
    let data = training_set(100, 5, 8);
    for &kind in ModelKind::ALL {
        let (_folder, path) = saved(kind);
        let before = fitted(kind);
        let after = FittedModel::load(&path).unwrap();
        assert_eq!((after.kind(), after.max_range()), (before.kind(), before.max_range()));
        assert_eq!(after.chosen(), before.chosen());
        let map = || Some(Arc::new(Wall) as _);
        let scores = [before, after].map(|m| evaluate(&*m.into_model(map()).unwrap(), &data));
        assert_eq!(scores[0].log_loss_nats.to_bits(), scores[1].log_loss_nats.to_bits(), "{kind}");
        assert_eq!(scores[0].histogram_match_m.to_bits(), scores[1].histogram_match_m.to_bits(), "{kind}");
    }
}

#[test]
fn a_file_cut_short_anywhere_is_refused() {
    let (_folder, path) = saved(ModelKind::Classic);
    let whole = fs::read(&path).unwrap();
    for length in 0..whole.len() {
        fs::write(&path, &whole[..length]).unwrap();
        let error = FittedModel::load(&path).unwrap_err();
        match error {
            SensorError::Foreign(_) => assert!(length < 8),
            SensorError::Damaged { .. } => assert!(length >= 8),
            other => panic!("{other}"),
        }
    }
}

#[test]
fn an_altered_byte_is_found() {
    let (_folder, path) = saved(ModelKind::Classic);
    let whole = fs::read(&path).unwrap();
    for i in 0..whole.len() {
        let mut altered = whole.clone();
        altered[i] ^= 0x10;
        fs::write(&path, altered).unwrap();
        assert!(FittedModel::load(&path).is_err(), "byte {i}");
    }
}

#[test]
fn a_newer_format_and_a_foreign_file_are_named_as_such() {
    let (folder, path) = saved(ModelKind::BeamMixture);
    let mut bytes = fs::read(&path).unwrap();
    bytes[8] = 9;
    fs::write(&path, bytes).unwrap();
    let error = FittedModel::load(&path).unwrap_err();
    assert!(matches!(error, SensorError::Version { found: 9, known: 2, .. }));
    assert!(
        error.to_string().ends_with("has format version 9; this locsim reads version 2: fit the model again"),
        "{error}"
    );

    fs::write(&path, "name: a scenario\n").unwrap();
    assert!(matches!(FittedModel::load(&path), Err(SensorError::Foreign(_))));

    let absent = folder.path().join("absent");
    assert!(FittedModel::load(&absent).unwrap_err().to_string().contains("absent"));
    assert!(fitted(ModelKind::Classic).save(&path.join("below a file")).is_err());
}

#[test]
fn a_likelihood_field_needs_its_map() {
    let (_folder, path) = saved(ModelKind::LikelihoodField);
    let field = FittedModel::load(&path).unwrap();
    assert!(matches!(field.into_model(None), Err(SensorError::NoDistanceMap)));
}

#[test]
fn a_model_is_read_back_from_its_bytes() {
    let (_folder, path) = saved(ModelKind::Classic);
    let bytes = fitted(ModelKind::Classic).to_bytes();
    assert_eq!(fs::read(&path).unwrap(), bytes);
    let model = FittedModel::from_bytes(&bytes, &path).unwrap();
    assert_eq!(model.to_bytes(), bytes);
}

/// The neighbour that a file is first written to is nobody's.
#[test]
fn saving_leaves_the_files_beside_alone() {
    let folder = tempfile::tempdir().unwrap();
    let neighbour = folder.path().join("model.part");
    fs::write(&neighbour, "precious").unwrap();
    fitted(ModelKind::Classic).save(&folder.path().join("model")).unwrap();
    assert_eq!(fs::read(&neighbour).unwrap(), b"precious");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn a_file_larger_than_models_are_is_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model");
    let most = Limits::current().model_bytes;
    fs::File::create(&path).unwrap().set_len(most + 1).unwrap();
    let error = FittedModel::load(&path).unwrap_err();
    assert!(matches!(error, SensorError::TooLarge { .. }));
    assert!(error.to_string().contains(&format!("--limit model_bytes={}", most + 1)), "{error}");
}
