//! Parameter files of ROS 2, for AMCL and for Beluga.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use locsim_sensor::{AmclKind, AmclParameters};

use super::amcl::{PARTICLES, PF_ERR, PF_Z, UPDATE_MIN_A, UPDATE_MIN_D, USUAL_ALPHA};
use super::search::{Found, LEAST_ALPHA};
use locsim_lab::inspect::rounded;

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

/// A parameter with its origin in a few words, and what else there is to say of it.
pub(super) struct Parameter {
    pub name: &'static str,
    pub value: Value,
    pub origin: &'static str,
    pub details: String,
}

impl Parameter {
    /// The comment in the file.
    fn comment(&self) -> String {
        if self.details.is_empty() {
            self.origin.to_owned()
        } else {
            format!("{}: {}", self.origin, self.details)
        }
    }
}

/// Where values come from.
const SEARCH: &str = "search";
const ODOMETRY: &str = "odometry";
const USUAL: &str = "nav2's default";
const LASER: &str = "the laser";

/// AMCL's parameters of nav2.
pub(super) fn amcl(found: &Found, origin: &Origin<'_>) -> Vec<Parameter> {
    let mut parameters = laser(&found.settings.laser, origin);
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
///
/// Beluga refuses a weight above 1. Both are then divided by it, which changes no product of terms, and a sum of their cubes beside 1.
pub(super) fn beluga(found: &Found, origin: &Origin<'_>) -> Vec<Parameter> {
    let of_nav2 = &found.settings.laser;
    let weight = of_nav2.z_hit * of_nav2.sigma_hit * TAU.sqrt();
    let above = weight.max(1.0);
    let converted = AmclParameters {
        z_hit: rounded(weight / above, 4),
        z_rand: rounded(of_nav2.z_rand / above, 4),
        ..*of_nav2
    };
    let mut parameters = laser(&converted, origin);
    let divided = if above > 1.0 { format!(", over {}", rounded(above, 4)) } else { String::new() };
    for parameter in &mut parameters {
        let of_amcl = match parameter.name {
            "z_hit" => format!("{} x sigma_hit x sqrt(2 pi), by which Beluga divides", of_nav2.z_hit),
            "z_rand" if above > 1.0 => of_nav2.z_rand.to_string(),
            _ => continue,
        };
        parameter.details = format!("AMCL's {of_amcl}{divided}");
    }
    parameters.extend(motion(found, origin));
    parameters.extend(filter());
    parameters
}

fn usual(name: &'static str, value: Value) -> Parameter {
    Parameter { name, value, origin: USUAL, details: String::new() }
}

/// Parameters of the laser model.
fn laser(laser: &AmclParameters, origin: &Origin<'_>) -> Vec<Parameter> {
    let is_beam = laser.kind == AmclKind::AmclBeam;
    let drives = if origin.drives == 1 { "drive" } else { "drives" };
    let details = format!("best of {} sets on {} training {drives}", origin.evaluations, origin.drives);
    let searched = |name, value| Parameter { name, value, origin: SEARCH, details: details.clone() };
    let of = |is_used: bool, name, value| {
        let details = format!("{} doesn't use it", laser.kind.laser_model_type());
        if is_used { searched(name, value) } else { Parameter { name, value, origin: USUAL, details } }
    };
    vec![
        searched("laser_model_type", Value::Word(laser.kind.laser_model_type())),
        searched("max_beams", Value::Whole(laser.max_beams)),
        searched("z_hit", Value::Float(laser.z_hit)),
        searched("z_rand", Value::Float(laser.z_rand)),
        searched("sigma_hit", Value::Float(laser.sigma_hit)),
        of(!is_beam, "laser_likelihood_max_dist", Value::Float(laser.laser_likelihood_max_dist)),
        of(is_beam, "z_short", Value::Float(laser.z_short)),
        of(is_beam, "z_max", Value::Float(laser.z_max)),
        of(is_beam, "lambda_short", Value::Float(laser.lambda_short)),
        Parameter {
            name: "laser_max_range",
            value: Value::Float(origin.max_range_m),
            origin: LASER,
            details: "z_rand is divided by it".to_owned(),
        },
    ]
}

fn motion(found: &Found, origin: &Origin<'_>) -> Vec<Parameter> {
    let names = ["alpha1", "alpha2", "alpha3", "alpha4"];
    let alphas = names.into_iter().zip(found.settings.alpha).zip(origin.alpha);
    let mut parameters: Vec<Parameter> = alphas
        .map(|((name, value), noise)| {
            let (origin, details) = match found.noise_factor {
                Some(factor) => {
                    let noise = if noise < LEAST_ALPHA {
                        format!("{LEAST_ALPHA}, the least")
                    } else {
                        rounded(noise, 3).to_string()
                    };
                    let windows = origin.windows;
                    (
                        ODOMETRY,
                        format!("{noise} against reference, {windows} windows, times {factor} (search)"),
                    )
                }
                None => (USUAL, "the search found nothing better".to_owned()),
            };
            Parameter { name, value: Value::Float(value), origin, details }
        })
        .collect();
    parameters.push(Parameter {
        details: "only omnidirectional robots use it".to_owned(),
        ..usual("alpha5", Value::Float(USUAL_ALPHA))
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
    let lines: Vec<String> = parameters
        .iter()
        .map(|parameter| format!("{}: {}", parameter.name, parameter.value.text()))
        .collect();
    let width = lines.iter().map(String::len).max().unwrap_or(0);
    for (line, parameter) in lines.iter().zip(parameters) {
        _ = writeln!(text, "    {line:width$} # {}", parameter.comment());
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

    /// The type of a parameter in ROS 2. There, a double isn't set from an integer.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Type {
        Double,
        Integer,
        Text,
        Bool,
    }
    use Type::{Bool, Double, Integer, Text};

    /// What `nav2_amcl::AmclNode` declares of what the files have (navigation2, `nav2_amcl/src/amcl_node.cpp`, `add_parameter`).
    const OF_NAV2: [(&str, Type); 27] = [
        ("alpha1", Double),
        ("alpha2", Double),
        ("alpha3", Double),
        ("alpha4", Double),
        ("alpha5", Double),
        ("beam_skip_distance", Double),
        ("beam_skip_error_threshold", Double),
        ("beam_skip_threshold", Double),
        ("do_beamskip", Bool),
        ("lambda_short", Double),
        ("laser_likelihood_max_dist", Double),
        ("laser_max_range", Double),
        ("laser_model_type", Text),
        ("max_beams", Integer),
        ("max_particles", Integer),
        ("min_particles", Integer),
        ("pf_err", Double),
        ("pf_z", Double),
        ("resample_interval", Integer),
        ("robot_model_type", Text),
        ("sigma_hit", Double),
        ("update_min_a", Double),
        ("update_min_d", Double),
        ("z_hit", Double),
        ("z_max", Double),
        ("z_rand", Double),
        ("z_short", Double),
    ];

    /// Parameters of [`OF_NAV2`] that `beluga_amcl::AmclNode` doesn't declare, and those that it declares with a range from 0 to 1
    /// (beluga, `beluga_amcl/src/ros2_common.cpp` and `amcl_node.cpp`). All others of type double are at least 0 there.
    const NOT_OF_BELUGA: [&str; 4] =
        ["beam_skip_distance", "beam_skip_error_threshold", "beam_skip_threshold", "do_beamskip"];
    const UP_TO_ONE_IN_BELUGA: [&str; 5] = ["pf_err", "z_hit", "z_max", "z_rand", "z_short"];

    /// Parameters of a file, by name.
    fn read(text: &str) -> Map<String, Json> {
        let (tree, _) = yaml::parse::<Map<String, Json>>(std::path::Path::new("amcl.yaml"), text).unwrap();
        tree["amcl"]["ros__parameters"].as_object().unwrap().clone()
    }

    fn type_of(value: &Json) -> Option<Type> {
        match value {
            Json::Number(number) if number.is_f64() => Some(Double),
            Json::Number(_) => Some(Integer),
            Json::String(_) => Some(Text),
            Json::Bool(_) => Some(Bool),
            _ => None,
        }
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
            let parameters = read(&text);
            assert_eq!(parameters.len(), OF_NAV2.len(), "{text}");
            for (name, kind) in OF_NAV2 {
                assert_eq!(parameters.get(name).and_then(type_of), Some(kind), "{name} in {text}");
            }
            assert_eq!(parameters["alpha2"], 1e-7);
            assert!(
                text.contains("# odometry: 0.01 against reference, 9 windows, times 2 (search)"),
                "{text}"
            );
            assert!(text.contains("# search: best of 16 sets on 1 training drive\n"), "{text}");
            let quiet = Origin { alpha: [0.0; 4], ..ORIGIN };
            let text = yaml(&amcl(&found, &quiet), "nav2's AMCL", &quiet);
            assert!(text.contains("0.0005, the least against reference, 9 windows"), "{text}");
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

    /// 0.9 x 0.5 x sqrt(2 pi) = 1.128, which Beluga refuses: 1 and 0.4 / 1.128 keep their ratio.
    #[test]
    fn beluga_has_its_keys_types_and_ranges() {
        for (z_hit, sigma_hit) in [(1.0, 0.1), (0.9, 0.5)] {
            let mut found = found(AmclKind::AmclLikelihoodFieldProb);
            found.settings.laser = AmclParameters { z_hit, sigma_hit, z_rand: 0.4, ..found.settings.laser };
            let text = yaml(&beluga(&found, &ORIGIN), "beluga_amcl", &ORIGIN);
            let parameters = read(&text);
            assert_eq!(parameters.len(), OF_NAV2.len() - NOT_OF_BELUGA.len(), "{text}");
            for (name, kind) in OF_NAV2.into_iter().filter(|(name, _)| !NOT_OF_BELUGA.contains(name)) {
                assert_eq!(parameters.get(name).and_then(type_of), Some(kind), "{name} in {text}");
                let most = if UP_TO_ONE_IN_BELUGA.contains(&name) { 1.0 } else { f64::MAX };
                let value = parameters[name].as_f64();
                assert!(value.is_none_or(|value| (0.0..=most).contains(&value)), "{name}: {value:?}");
            }
            let ratio = parameters["z_hit"].as_f64().unwrap() / parameters["z_rand"].as_f64().unwrap();
            assert!((ratio / (z_hit * sigma_hit * TAU.sqrt() / 0.4) - 1.0).abs() < 1e-3, "{text}");
        }
    }
}
