//! The JSON Schema of studies says what the program does.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use locsim_scenario::testing::{assert_every_key_seen, assert_told, fits, hostile_texts, json_of};

use super::*;

/// The shipped studies.
fn shipped() -> Vec<(PathBuf, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios/paper");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    files
        .filter(|path| path.extension().is_some_and(|extension| extension == "yaml"))
        .map(|path| (path.clone(), std::fs::read_to_string(&path).unwrap()))
        .collect()
}

fn table() -> String {
    shipped().into_iter().find(|(path, _)| path.ends_with("table.yaml")).unwrap().1
}

#[test]
fn the_schema_accepts_the_shipped_studies_and_knows_every_key() {
    let schema = schema();
    assert_eq!(schema["title"], "locsim study");
    let mut texts: Vec<String> = shipped().into_iter().map(|(_, text)| text).collect();
    assert!(texts.len() >= 5, "{}", texts.len());
    // Keys that no shipped study has.
    texts.push(table().replace("shift:", "scale:") + "\nname: other\nfolds: 4\ntest_states: 10\n");
    let mut seen = BTreeSet::new();
    for text in texts {
        assert!(fits(&schema, &schema, &json_of(&text), &mut seen), "{text}");
    }
    assert_every_key_seen(&schema, &seen, 50);
}

/// The negative control.
#[test]
fn the_schema_refuses_what_the_program_refuses() {
    let schema = schema();
    for (from, to) in [
        ("seed: 2016", "sed: 2016"),
        ("repeats: 20", "repeats: 2.5"),
        ("  table:", "  tabel:"),
        ("values: [0, 3]", "values: [0]"),
        ("np_reg_registered", "np_reg_registred"),
        ("criterion: crps", "criterion: crbs"),
        ("shift: distance_m", "shift: 3"),
    ] {
        let text = table();
        assert!(text.contains(from), "{from}");
        let text = text.replace(from, to);
        assert!(!fits(&schema, &schema, &json_of(&text), &mut BTreeSet::new()), "{from} -> {to}");
    }
}

#[test]
fn documented_defaults_are_the_defaults() {
    let schema = schema();
    let path = Path::new("x.yaml");
    let (raw, _) = yaml::parse::<raw::RawStudy>(path, &table().replace("repeats: 20", "")).unwrap();
    let read = serde_json::to_value(raw).unwrap();
    for key in ["description", "folds", "thinning", "counts", "repeats", "test_states"] {
        assert_eq!(
            schema["properties"][key]["default"],
            if key == "description" { "".into() } else { read[key].clone() },
            "{key}"
        );
    }
    assert_eq!(schema["properties"]["criterion"]["default"], "histogram_match");
}

#[test]
fn studies_are_told_from_scenarios() {
    for (path, _) in shipped() {
        assert!(is_study(&path).unwrap(), "{}", path.display());
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios");
    assert!(!is_study(&folder.join("global.yaml")).unwrap());
    assert!(is_study(&folder.join("absent.yaml")).is_err());
}

#[test]
fn no_number_and_no_key_of_a_shipped_study_can_do_harm() {
    let (mut refused, mut valid) = (0, 0);
    for (path, text) in shipped() {
        for text in hostile_texts(&text) {
            let checked = yaml::parse::<raw::RawStudy>(&path, &text).map_err(StudyError::from).and_then(
                |(raw, locations)| {
                    let environment = |_: &str| None;
                    let check = || Checker::new(&path, &locations, &environment);
                    validate::validate(raw, &path, text.clone(), StudyOverrides::default(), &check)
                },
            );
            match checked {
                Ok(_) => valid += 1,
                Err(error) => {
                    if let StudyError::Scenario(error) = &error {
                        assert_told(error);
                    }
                    assert!(error.to_string().len() < 40_000);
                    refused += 1;
                }
            }
        }
    }
    assert!(refused > 1000 && valid > 100, "{refused} {valid}");
}
