//! Parameter files of ROS 2, for AMCL and for Beluga.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use locsim_sensor::{AmclKind, AmclParameters};

use super::amcl::{PARTICLES, PF_ERR, PF_Z, UPDATE_MIN_A, UPDATE_MIN_D, USUAL_ALPHA};
use super::search::{Found, LEAST_ALPHA};
use crate::inspect::rounded;

/// What the comments tell of a search.
pub(super) struct Origin<'a> {
    /// The scenario or the log, and the command.
    pub source: &'a str,
    pub command: &'a str,
    /// Windows of the odometry's noise, and the noise between updates.
    pub windows: usize,
    pub alpha: [f64; 4],
    /// Sets of parameters that were tried, on so many training drives.
    pub evaluations: u32,
    pub drives: usize,
    /// Maximum range of the laser \[m\].
    pub max_range_m: f64,
}

/// A value as YAML has it: a float always with a point, as ROS 2 wants it.
pub(super) enum Value {
    Float(f64),
    Whole(usize),
    Flag(bool),
    Word(&'static str),
}

impl Value {
    pub fn text(&self) -> String {
        match self {
            // Without an exponent: YAML 1.1 takes `5e-6` for text.
            Self::Float(value) if value.fract() == 0.0 => format!("{value:.1}"),
            Self::Float(value) => value.to_string(),
            Self::Whole(value) => value.to_string(),
            Self::Flag(value) => value.to_string(),
            Self::Word(word) => format!("\"{word}\""),
        }
    }
}

/// A parameter with its origin.
pub(super) struct Parameter {
    pub name: &'static str,
    pub value: Value,
    pub origin: String,
}

/// AMCL's parameters of nav2.
pub(super) fn amcl(found: &Found, origin: &Origin<'_>) -> Vec<Parameter> {
    let mut parameters = laser(&found.settings.laser, origin, "");
    parameters.extend(motion(found, origin));
    let laser = &found.settings.laser;
    let beam_skip = [
        ("do_beamskip", Value::Flag(laser.do_beamskip)),
        ("beam_skip_distance", Value::Float(laser.beam_skip_distance)),
        ("beam_skip_threshold", Value::Float(laser.beam_skip_threshold)),
        ("beam_skip_error_threshold", Value::Float(laser.beam_skip_error_threshold)),
    ];
    parameters.extend(beam_skip.map(|(name, value)| usual(name, value)));
    parameters.extend(filter());
    parameters
}

/// Beluga's parameters, which has other weights: its Gaussian is normalized. `found` is of a likelihood field.
pub(super) fn beluga(found: &Found, origin: &Origin<'_>) -> Vec<Parameter> {
    let laser_of_nav2 = &found.settings.laser;
    let factor = laser_of_nav2.sigma_hit * TAU.sqrt();
    let converted = AmclParameters { z_hit: rounded(laser_of_nav2.z_hit * factor, 4), ..*laser_of_nav2 };
    let note = format!(
        "AMCL's z_hit {} x sigma_hit x sqrt(2 pi): Beluga divides by the latter",
        Value::Float(laser_of_nav2.z_hit).text()
    );
    let mut parameters = laser(&converted, origin, &note);
    parameters.extend(motion(found, origin));
    parameters.extend(filter());
    parameters
}

fn usual(name: &'static str, value: Value) -> Parameter {
    Parameter { name, value, origin: "nav2's default".to_owned() }
}

/// Parameters of the laser model; `hit` is the origin of `z_hit` where it isn't the search's.
fn laser(laser: &AmclParameters, origin: &Origin<'_>, hit: &str) -> Vec<Parameter> {
    let is_beam = laser.kind == AmclKind::AmclBeam;
    let searched =
        format!("search: best of {} sets on {} training drives", origin.evaluations, origin.drives);
    let unused = format!("nav2's default; {} doesn't use it", laser.kind.laser_model_type());
    let of = |is_used: bool| if is_used { searched.clone() } else { unused.clone() };
    let float = |name, value, origin| Parameter { name, value: Value::Float(value), origin };
    let hit = if hit.is_empty() { searched.clone() } else { hit.to_owned() };
    vec![
        Parameter {
            name: "laser_model_type",
            value: Value::Word(laser.kind.laser_model_type()),
            origin: searched.clone(),
        },
        Parameter { name: "max_beams", value: Value::Whole(laser.max_beams), origin: searched.clone() },
        float("z_hit", laser.z_hit, hit),
        float("z_rand", laser.z_rand, searched.clone()),
        float("sigma_hit", laser.sigma_hit, searched.clone()),
        float("laser_likelihood_max_dist", laser.laser_likelihood_max_dist, of(!is_beam)),
        float("z_short", laser.z_short, of(is_beam)),
        float("z_max", laser.z_max, of(is_beam)),
        float("lambda_short", laser.lambda_short, of(is_beam)),
        float("laser_max_range", origin.max_range_m, "the laser's; z_rand is divided by it".to_owned()),
    ]
}

fn motion(found: &Found, origin: &Origin<'_>) -> Vec<Parameter> {
    let names = ["alpha1", "alpha2", "alpha3", "alpha4"];
    let alphas = names.into_iter().zip(found.settings.alpha).zip(origin.alpha);
    let mut parameters: Vec<Parameter> = alphas
        .map(|((name, value), noise)| {
            let origin = match found.noise_factor {
                Some(factor) => {
                    let noise = if noise < LEAST_ALPHA {
                        format!("{LEAST_ALPHA}, the least")
                    } else {
                        rounded(noise, 3).to_string()
                    };
                    let windows = origin.windows;
                    format!("odometry against reference, {windows} windows: {noise}, times {factor} (search)")
                }
                None => "nav2's default: the search found nothing better".to_owned(),
            };
            Parameter { name, value: Value::Float(value), origin }
        })
        .collect();
    parameters.push(Parameter {
        name: "alpha5",
        value: Value::Float(USUAL_ALPHA),
        origin: "nav2's default; only omnidirectional robots use it".to_owned(),
    });
    parameters.push(usual("robot_model_type", Value::Word("nav2_amcl::DifferentialMotionModel")));
    parameters.push(usual("update_min_d", Value::Float(UPDATE_MIN_D)));
    parameters.push(usual("update_min_a", Value::Float(UPDATE_MIN_A)));
    parameters
}

fn filter() -> [Parameter; 5] {
    let [min, max] = PARTICLES;
    [
        usual("min_particles", Value::Whole(min)),
        usual("max_particles", Value::Whole(max)),
        usual("pf_err", Value::Float(PF_ERR)),
        usual("pf_z", Value::Float(PF_Z)),
        usual("resample_interval", Value::Whole(1)),
    ]
}

/// The file.
pub(super) fn yaml(parameters: &[Parameter], program: &str, origin: &Origin<'_>) -> String {
    let mut text = format!(
        "# Parameters of {program}, found by locsim on {}:\n# {}\namcl:\n  ros__parameters:\n",
        origin.source, origin.command
    );
    let lines: Vec<(String, &str)> = parameters
        .iter()
        .map(|parameter| {
            (format!("{}: {}", parameter.name, parameter.value.text()), parameter.origin.as_str())
        })
        .collect();
    let width = lines.iter().map(|(line, _)| line.len()).max().unwrap_or(0);
    for (line, origin) in lines {
        _ = writeln!(text, "    {line:width$} # {origin}");
    }
    text
}

#[cfg(test)]
mod tests {
    use locsim_scenario::{load_amcl, yaml};
    use serde_json::{Map, Value as Json};

    use super::super::amcl::Settings;
    use super::*;

    const ORIGIN: Origin<'_> = Origin {
        source: "a room",
        command: "locsim export nav2",
        windows: 9,
        alpha: [0.01; 4],
        evaluations: 16,
        drives: 1,
        max_range_m: 8.0,
    };

    fn found(kind: AmclKind) -> Found {
        let usual = AmclParameters::defaults(kind);
        // Whole numbers, which a float must not look like, and the least that a search can find.
        let laser = AmclParameters { z_hit: 1.0, z_rand: 5e-6, sigma_hit: 0.1, max_beams: 30, ..usual };
        let settings = Settings { laser, alpha: [2.0, 1e-7, 0.5, 0.25] };
        Found { settings, noise_factor: Some(2.0), error_m: 0.1, defaults_error_m: 0.2 }
    }

    #[test]
    fn a_file_has_nav2s_keys_and_types_and_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        for kind in AmclKind::ALL {
            let found = found(*kind);
            let text = yaml(&amcl(&found, &ORIGIN), "nav2's AMCL", &ORIGIN);
            let path = folder.path().join("amcl.yaml");
            std::fs::write(&path, &text).unwrap();
            assert_eq!(load_amcl(&path).unwrap(), found.settings.laser, "{text}");
            let (tree, _) = yaml::parse::<Map<String, Json>>(&path, &text).unwrap();
            let parameters = tree["amcl"]["ros__parameters"].as_object().unwrap();
            let whole = ["max_beams", "min_particles", "max_particles", "resample_interval"];
            let words = ["laser_model_type", "robot_model_type"];
            assert_eq!(parameters.len(), 27, "{text}");
            for (name, value) in parameters {
                let name = name.as_str();
                let is_right = match value {
                    Json::Number(number) if whole.contains(&name) => number.is_u64(),
                    Json::Number(number) => number.is_f64(),
                    Json::String(_) => words.contains(&name),
                    Json::Bool(_) => name == "do_beamskip",
                    _ => false,
                };
                assert!(is_right, "{name}: {value}");
            }
            assert_eq!(parameters["alpha2"], 1e-7);
            assert!(
                text.contains("# odometry against reference, 9 windows: 0.01, times 2 (search)"),
                "{text}"
            );
            let quiet = Origin { alpha: [0.0; 4], ..ORIGIN };
            let text = yaml(&amcl(&found, &quiet), "nav2's AMCL", &quiet);
            assert!(text.contains(" windows: 0.0005, the least, times 2 (search)"), "{text}");
        }
    }

    /// 1.0 x 0.1 x sqrt(2 pi) = 0.25066.
    #[test]
    fn beluga_has_the_weight_of_a_normalized_gaussian() {
        let parameters = beluga(&found(AmclKind::AmclLikelihoodField), &ORIGIN);
        let text = yaml(&parameters, "beluga_amcl", &ORIGIN);
        assert!(text.contains("    z_hit: 0.2507 "), "{text}");
        assert!(!text.contains("beam_skip") && text.contains("    z_rand: 0.000005 "), "{text}");
    }
}
