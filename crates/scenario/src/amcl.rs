//! Parameters of AMCL in a parameter file of ROS 2.

use std::path::Path;

use locsim_core::limits::number;
use locsim_sensor::{AmclKind, AmclParameters, SensorError};
use serde::Deserialize;

use super::error::unknown_word;
use super::key_path::join;
use super::{Problem, ScenarioError};
use crate::yaml;

/// Where AMCL's parameters stand in such a file.
const SECTION: &str = "amcl.ros__parameters";

/// A parameter file, of which other nodes are of no interest.
#[derive(Deserialize)]
struct File {
    amcl: Node,
}

#[derive(Deserialize)]
struct Node {
    #[serde(rename = "ros__parameters")]
    parameters: Parameters,
}

/// The parameters that the laser models use. A key that is absent has nav2's default.
#[derive(Deserialize)]
struct Parameters {
    laser_model_type: Option<String>,
    z_hit: Option<f64>,
    z_short: Option<f64>,
    z_max: Option<f64>,
    z_rand: Option<f64>,
    sigma_hit: Option<f64>,
    lambda_short: Option<f64>,
    max_beams: Option<u64>,
    laser_likelihood_max_dist: Option<f64>,
    do_beamskip: Option<bool>,
    beam_skip_distance: Option<f64>,
    beam_skip_threshold: Option<f64>,
    beam_skip_error_threshold: Option<f64>,
}

/// Reads the parameters of AMCL's laser model from a parameter file of ROS 2 (`amcl: ros__parameters:`), which may have other
/// nodes and keys. Where a key is absent, AMCL has nav2's default.
///
/// # Errors
/// [`ScenarioError`] with the line and the key of what isn't a parameter file of AMCL, or what AMCL wouldn't take.
pub fn load_amcl(path: &Path) -> Result<AmclParameters, ScenarioError> {
    let text = yaml::read(path)?;
    let (file, locations) = yaml::parse::<File>(path, &text)?;
    let refuse = |name: &str, message: String| {
        let key = join(SECTION, name);
        let problem = Problem { line: locations.line(&key), key, message };
        ScenarioError::Invalid { file: path.to_owned(), problems: vec![problem] }
    };
    let said = file.amcl.parameters;
    let types: Vec<&str> = AmclKind::ALL.iter().map(|kind| kind.laser_model_type()).collect();
    let kind = match &said.laser_model_type {
        None => AmclKind::AmclLikelihoodField,
        Some(word) => {
            let found = types.iter().position(|name| name == word);
            let index = found.ok_or_else(|| {
                refuse("laser_model_type", unknown_word(word, "a laser model of AMCL", &types))
            })?;
            AmclKind::ALL[index]
        }
    };
    let usual = AmclParameters::defaults(kind);
    let parameters = AmclParameters {
        kind,
        z_hit: said.z_hit.unwrap_or(usual.z_hit),
        z_short: said.z_short.unwrap_or(usual.z_short),
        z_max: said.z_max.unwrap_or(usual.z_max),
        z_rand: said.z_rand.unwrap_or(usual.z_rand),
        sigma_hit: said.sigma_hit.unwrap_or(usual.sigma_hit),
        lambda_short: said.lambda_short.unwrap_or(usual.lambda_short),
        max_beams: said.max_beams.map_or(usual.max_beams, |beams| beams as usize),
        laser_likelihood_max_dist: said.laser_likelihood_max_dist.unwrap_or(usual.laser_likelihood_max_dist),
        do_beamskip: said.do_beamskip.unwrap_or(usual.do_beamskip),
        beam_skip_distance: said.beam_skip_distance.unwrap_or(usual.beam_skip_distance),
        beam_skip_threshold: said.beam_skip_threshold.unwrap_or(usual.beam_skip_threshold),
        beam_skip_error_threshold: said.beam_skip_error_threshold.unwrap_or(usual.beam_skip_error_threshold),
    };
    parameters.check().map_err(|error| match error {
        SensorError::Parameter { what, allowed, value } => {
            refuse(what, format!("{} is not allowed; {allowed}", number(value)))
        }
        other => refuse("", other.to_string()),
    })?;
    Ok(parameters)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<AmclParameters, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("amcl.yaml");
        std::fs::write(&path, text).unwrap();
        let shown = format!("{}", folder.path().display());
        load_amcl(&path).map_err(|error| error.to_string().replace(&shown, ""))
    }

    #[test]
    fn absent_keys_are_nav2s_defaults_and_others_are_left_alone() {
        let text = "other: {ros__parameters: {a: 1}}\namcl:\n  ros__parameters:\n    max_particles: 2000\n    z_hit: 0.9\n    max_beams: 30\n";
        let usual = AmclParameters::defaults(AmclKind::AmclLikelihoodField);
        assert_eq!(load(text).unwrap(), AmclParameters { z_hit: 0.9, max_beams: 30, ..usual });
        let beam = "amcl: {ros__parameters: {laser_model_type: beam}}";
        assert_eq!(load(beam).unwrap(), AmclParameters::defaults(AmclKind::AmclBeam));
    }

    #[test]
    fn what_amcl_would_not_take_is_refused_with_line_and_key() {
        for (line, expected) in [
            ("z_hit: 2.0", ":3: amcl.ros__parameters.z_hit: 2 is not allowed; from 0 to 1"),
            ("sigma_hit: 0.0", ":3: amcl.ros__parameters.sigma_hit: 0 is not allowed; positive and finite"),
            ("max_beams: 1", ":3: amcl.ros__parameters.max_beams: 1 is not allowed; at least 2"),
            ("laser_model_type: laser", "amcl.ros__parameters.laser_model_type: `laser` is not"),
            ("z_hit: many", "amcl.ros__parameters.z_hit:"),
        ] {
            let error = load(&format!("amcl:\n  ros__parameters:\n    {line}\n")).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        assert!(load("slam: {}").unwrap_err().contains("amcl"));
    }
}
