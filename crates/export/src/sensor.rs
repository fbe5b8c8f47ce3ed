//! The laser of a scenario, with as many of its effects as the sensor of a simulator can have.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use locsim_core::{Pose2, wrap_angle};
use locsim_scenario::{Problem, Scenario, ScenarioError, SimulatorOptions};
use locsim_world::effect::{Effect, EffectKind, Effects, Moves, Site};
use locsim_world::simulation::{LaserOptions, LaserSimulator};

use locsim_lab::LabError;
use locsim_lab::run::refused;

/// Cameras that render ranges see nothing nearer than this \[m\], and can't have 0.
const NEAR_M: f64 = 0.01;

/// Simulators whose description of a sensor is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimulatorFormat {
    /// Gazebo: a model with a `gpu_lidar`, in `SDFormat` 1.9.
    Sdf,
    /// Stage: a model of type `ranger`.
    Stage,
    /// Webots: a `Lidar` node.
    Webots,
}

/// The description of a sensor for a simulator.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    /// Content of the file.
    pub text: String,
    /// Each effect, and the part of the file that has it.
    pub said: Vec<(EffectKind, &'static str)>,
    /// Effects that the format can't have.
    pub left: Vec<EffectKind>,
    /// What else the format can't have.
    pub notes: Vec<&'static str>,
}

/// A sensor as simulators have it.
struct Sensor<'a> {
    laser: &'a LaserOptions,
    /// Where it really sits.
    mount: Pose2,
    /// Bearing of the first beam and the angle between two beams \[rad\].
    first_rad: f64,
    step_rad: f64,
    /// Shift of all readings \[m\].
    bias_m: f64,
    /// Readings are multiples of this \[m\]; 0 for readings that aren't quantized.
    step_m: f64,
}

impl Sensor<'_> {
    /// The angle from the first beam to the last \[rad\].
    fn field_of_view_rad(&self) -> f64 {
        self.step_rad * f64::from(self.laser.beams.saturating_sub(1))
    }

    /// Its pose on the robot with the middle of its field of view ahead.
    fn centred(&self) -> Pose2 {
        let middle = self.first_rad + 0.5 * self.field_of_view_rad();
        Pose2 { theta: wrap_angle(self.mount.theta + middle), ..self.mount }
    }
}

/// Writes the laser of a scenario for a simulator.
///
/// # Errors
/// [`LabError`]: the scenario has no `laser`.
pub fn sensor(scenario: &Scenario, format: SimulatorFormat) -> Result<Exported, LabError> {
    let Some(SimulatorOptions { laser, effects, residuals, .. }) = scenario.simulator() else {
        let message = "the key is missing; it describes the sensor that is written".to_owned();
        let problem = Problem { line: None, key: "laser".to_owned(), message };
        return Err(ScenarioError::Invalid { file: scenario.file.clone(), problems: vec![problem] }.into());
    };
    let part = |effect: &Effect| part(effect, format);
    let said: Vec<Effect> = effects.iter().filter(|effect| part(effect).is_some()).cloned().collect();
    let simulated = LaserSimulator::new(laser).map_err(refused(scenario))?;
    let bearings = simulated.laser().bearings();
    let numbers = |kind: EffectKind| {
        let of_kind = effects.iter().filter(move |effect| effect.kind == kind);
        of_kind.map(|effect| effect.values[0])
    };
    let sensor = Sensor {
        mount: Effects::new(said.clone())
            .map_err(|error| refused(scenario)(error.into()))?
            .laser_mount(laser.mount),
        first_rad: bearings[0].into(),
        step_rad: match bearings {
            [first, .., last] => {
                (f64::from(*last) - f64::from(*first)) / f64::from(laser.beams.saturating_sub(1))
            }
            _ => 0.0,
        },
        bias_m: if format == SimulatorFormat::Sdf { numbers(EffectKind::RangeBias).sum() } else { 0.0 },
        step_m: numbers(EffectKind::Quantization).fold(laser.resolution_m, f64::max),
        laser: &laser,
    };
    let mut exported = Exported {
        text: String::new(),
        said: effects.iter().filter_map(|effect| Some((effect.kind, part(effect)?))).collect(),
        left: effects.iter().filter(|effect| part(effect).is_none()).map(|effect| effect.kind).collect(),
        notes: notes(&laser, !residuals.is_empty(), format),
    };
    let comment = comment(scenario, &exported);
    exported.text = match format {
        SimulatorFormat::Sdf => sdf(scenario, &sensor, &comment),
        SimulatorFormat::Stage => stage(&sensor, &comment),
        SimulatorFormat::Webots => webots(&sensor, &comment),
    };
    Ok(exported)
}

/// The part of a description that has an effect.
fn part(effect: &Effect, format: SimulatorFormat) -> Option<&'static str> {
    use SimulatorFormat::{Sdf, Stage, Webots};
    let description = effect.kind.description();
    match (effect.kind, format) {
        _ if description.moves == Moves::Scans && description.site == Site::Beam => Some(match format {
            Sdf => "<pose>",
            Stage => "pose",
            Webots => "translation, rotation",
        }),
        (EffectKind::RangeBias, Sdf) => Some("<noise><mean>"),
        (EffectKind::Quantization, Webots) => Some("resolution"),
        _ => None,
    }
}

/// What a format can't say of a laser.
fn notes(laser: &LaserOptions, has_residuals: bool, format: SimulatorFormat) -> Vec<&'static str> {
    let mut notes = Vec::new();
    if laser.sigma_per_m > 0.0 && format != SimulatorFormat::Stage {
        notes.push("the noise's growth with range (laser.noise.sigma_per_m) is left out");
    }
    if laser.resolution_m > 0.0 && format != SimulatorFormat::Webots {
        notes.push("the simulator doesn't round readings to laser.resolution_m");
    }
    if laser.scan_secs > 0.0 {
        notes.push("all beams of a scan are taken at once (laser.scan_secs is left out)");
    }
    if has_residuals {
        notes.push("`residuals` are left out; `locsim apply` doesn't have them either");
    }
    notes
}

/// The lines that say what went where.
fn comment(scenario: &Scenario, exported: &Exported) -> Vec<String> {
    let file = scenario.file.file_name().unwrap_or_default().to_string_lossy();
    let mut lines = vec![format!("The laser of {}, written by locsim export.", quiet(&file))];
    lines.extend(exported.said.iter().map(|(kind, part)| format!("{kind}: {part}")));
    lines.extend(exported.left.iter().map(|kind| format!("{kind}: left to locsim apply")));
    lines.extend(exported.notes.iter().map(|note| (*note).to_owned()));
    lines
}

/// A name as a comment of XML may hold it.
fn quiet(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || "._".contains(c) { c } else { '_' }).collect()
}

/// A number with at most six decimals: micrometres and microradians.
fn number(value: f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// An angle in degrees. Bearings are f32, good to 1e-5 degrees.
fn degrees(rad: f64) -> String {
    number((rad.to_degrees() * 1e4).round() / 1e4)
}

/// A model of one link, in `SDFormat`: <http://sdformat.org/spec?ver=1.9&elem=sensor>.
fn sdf(scenario: &Scenario, sensor: &Sensor<'_>, comment: &[String]) -> String {
    let Sensor { laser, mount, first_rad, bias_m, .. } = sensor;
    // No markup within a comment.
    let lines: Vec<String> =
        comment.iter().map(|line| line.replace("><", "/").replace(['<', '>'], "")).collect();
    let resolution = if sensor.step_m > 0.0 {
        format!("\n            <resolution>{}</resolution>", number(sensor.step_m))
    } else {
        String::new()
    };
    format!(
        "<?xml version=\"1.0\"?>
<!--
  {}
-->
<sdf version=\"1.9\">
  <model name=\"{}\">
    <link name=\"base_link\">
      <sensor name=\"lidar\" type=\"gpu_lidar\">
        <pose>{} {} 0 0 0 {}</pose>
        <always_on>true</always_on>
        <update_rate>{}</update_rate>
        <topic>scan</topic>
        <lidar>
          <scan>
            <horizontal>
              <samples>{}</samples>
              <resolution>1</resolution>
              <min_angle>{}</min_angle>
              <max_angle>{}</max_angle>
            </horizontal>
          </scan>
          <range>
            <min>{}</min>
            <max>{}</max>{resolution}
          </range>
          <noise>
            <type>gaussian</type>
            <mean>{}</mean>
            <stddev>{}</stddev>
          </noise>
        </lidar>
      </sensor>
    </link>
  </model>
</sdf>
",
        lines.join("\n  "),
        scenario.name,
        number(mount.x),
        number(mount.y),
        number(mount.theta),
        number(laser.rate_hz),
        laser.beams,
        number(*first_rad),
        number(first_rad + sensor.field_of_view_rad()),
        number(laser.min_range_m.max(NEAR_M)),
        number(laser.max_range_m),
        number(*bias_m),
        number(laser.sigma_m),
    )
}

/// A model of Stage. Its noise has the variance `noise[0]` \[m^2\], and is uniform within a share of the range of `noise[1]`.
fn stage(sensor: &Sensor<'_>, comment: &[String]) -> String {
    let laser = sensor.laser;
    let Pose2 { x, y, theta } = sensor.centred();
    // The variance of a uniform distribution is a third of its half-width squared.
    let proportional = 3.0_f64.sqrt() * laser.sigma_per_m;
    let mut text = String::new();
    for line in comment {
        _ = writeln!(text, "# {line}");
    }
    text + &format!(
        "define lidar ranger
(
  sensor
  (
    range [{} {}]
    fov {}
    samples {}
    noise [{:e} {} 0]
  )
  update_interval {}
  # on the robot:
  pose [{} {} 0 {}]
)
",
        number(laser.min_range_m),
        number(laser.max_range_m),
        degrees(sensor.field_of_view_rad()),
        laser.beams,
        laser.sigma_m * laser.sigma_m,
        number(proportional),
        number(1000.0 / laser.rate_hz),
        number(x),
        number(y),
        degrees(theta),
    )
}

/// A node of Webots (R2022a and later, where z points up). Its noise is a share of the maximum range.
fn webots(sensor: &Sensor<'_>, comment: &[String]) -> String {
    let laser = sensor.laser;
    let Pose2 { x, y, theta } = sensor.centred();
    // Pixels cover the field of view; beams look through their middles.
    let field_of_view = (sensor.step_rad.abs() * f64::from(laser.beams)).min(TAU);
    let resolution = if sensor.step_m > 0.0 { sensor.step_m } else { -1.0 };
    let mut text = "#VRML_SIM R2022a utf8\n".to_owned();
    for line in comment {
        _ = writeln!(text, "# {line}");
    }
    text + &format!(
        "# Enable it with a sampling period of {} ms. A range image runs from left to right.
Lidar {{
  translation {} {} 0
  rotation 0 0 1 {}
  name \"lidar\"
  horizontalResolution {}
  fieldOfView {}
  verticalFieldOfView {}
  numberOfLayers 1
  near {}
  minRange {}
  maxRange {}
  noise {}
  resolution {}
}}
",
        number(1000.0 / laser.rate_hz),
        number(x),
        number(y),
        number(theta),
        laser.beams,
        number(field_of_view),
        // One layer has to be narrower than the angle between beams: layers < vertical field of view x beams / field of view.
        number((1.1 * field_of_view / f64::from(laser.beams)).clamp(1e-3, PI)),
        number(NEAR_M),
        number(laser.min_range_m.max(NEAR_M)),
        number(laser.max_range_m),
        number(laser.sigma_m / laser.max_range_m),
        number(resolution),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_have_no_negative_zero() {
        for (value, text) in [(0.1, "0.1"), (-1e-9, "0"), (100.0, "100"), (2.000_000_6, "2.000001")] {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn a_name_ends_no_comment() {
        assert_eq!(quiet("a--b>.yaml"), "a__b_.yaml");
    }
}
