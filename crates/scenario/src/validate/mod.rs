//! From the raw scenario to the validated one: ranges, and what keys have to do with each other.

mod effect;
mod filter;
mod residual;
mod source;

use std::collections::BTreeMap;
use std::path::Path;

use locsim_core::Pose2;
use locsim_core::limits::{MOST_TRIALS, quoted};
use locsim_world::map::Geometry;
use locsim_world::simulation::{RobotPath, Trajectory};

use super::check::Allowed::Within;
use super::check::Allowed::{AboveUpTo, Any, Between, FromBelow};
use super::check::{Checker, number};
use super::error::{shown, unknown_word};
use super::form::Form;
use super::key_path::join;
use super::raw::{All, RawBounds, RawModel, RawRecord, RawScenario, RawTraining, default};
use super::{
    Errors, Expectation, LoadedMap, METRICS, Model, ModelName, Overrides, Record, Scenario, ScenarioError,
    Simulation, Source, Start, Training, check_reading,
};

/// Models of a scenario.
const MOST_MODELS: usize = 100;
/// Letters of a name: names become names of files.
const MOST_LETTERS: usize = 100;
const MAX_BEAMS: u32 = 100_000;

/// Checks everything; the error holds every problem.
pub(crate) fn validate(
    raw: RawScenario,
    path: &Path,
    overrides: &Overrides,
    mut check: Checker<'_>,
) -> Result<Scenario, ScenarioError> {
    let name = name(&mut check, raw.name.as_deref(), path);
    let trials_of_file = check.count("trials", raw.trials, 1, MOST_TRIALS);
    let trials = match overrides.trials {
        Some(trials) => check.count("--trials", trials.into(), 1, MOST_TRIALS),
        None => trials_of_file,
    };
    let ray_cast = source::ray_cast(&mut check, &raw.ray_cast);
    let source = source::source(&mut check, &raw);
    let training = training(&mut check, &raw.training, source.as_ref());
    let all_models = models(&mut check, &raw.models, raw.log.is_some());
    let has_oracle = all_models.iter().any(|model| model.name == ModelName::Oracle);
    let noiseless = raw.laser.as_ref().is_some_and(|laser| laser.noise.sigma_m == 0.0);
    check.refuse(has_oracle && noiseless, "laser.noise.sigma_m", || {
        "0 is not allowed with the model `oracle`, which is a density; a finite number above 0".to_owned()
    });
    let models = select(&mut check, &all_models, overrides.models.as_deref());
    let filter = filter::filter(&mut check, &raw.filter, raw.laser.as_ref(), raw.log.is_some());
    let errors = Errors {
        frame: raw.errors.frame,
        lost_m: check.number("errors.lost_m", raw.errors.lost_m, Within(1e-3, 1e6)),
    };
    let mut record = record(&mut check, &raw.record, trials_of_file, &all_models, &models);
    record.trial = record.trial.min(trials.saturating_sub(1));
    let expect = expectations(&mut check, &raw.expect, &all_models, &models);
    match source {
        Some(source) if check.is_clean() => Ok(Scenario {
            file: path.to_owned(),
            text: String::new(),
            name,
            description: raw.description,
            seed: overrides.seed.unwrap_or(raw.seed),
            trials,
            ray_cast,
            source,
            training,
            models,
            filter,
            errors,
            record,
            expect,
        }),
        _ => Err(check.into_error()),
    }
}

/// Checks that need the map: finds the walls that effects name (`walls[i]` for effect `i`), and checks that a simulated
/// robot's way points, or its start, lie in the map's free space.
pub(crate) fn in_map(
    scenario: &mut Scenario,
    walls: &[Option<String>],
    map: &LoadedMap,
    mut check: Checker<'_>,
) -> Result<(), ScenarioError> {
    if let Start::Around(pose, _) = scenario.filter.start {
        around(&mut check, pose, &map.geometry);
    }
    let simulation = match &mut scenario.source {
        Source::Simulation(simulation) => simulation,
        Source::Log(log) => {
            if let Some(simulator) = &mut log.simulator {
                effect::places(&mut check, &mut simulator.effects, &simulator.residuals, walls, map);
            }
            return if check.is_clean() { Ok(()) } else { Err(check.into_error()) };
        }
    };
    effect::places(&mut check, &mut simulation.effects, &simulation.residuals, walls, map);
    let positions = match &simulation.robot.path {
        RobotPath::Waypoints { points_m, .. } => points_m.clone(),
        RobotPath::VelocityProfile { start, .. } => vec![[start.x, start.y]],
    };
    check_reading(&simulation.map, &map.geometry, &positions)?;
    let mut visit = |key: &str, x: f64, y: f64| {
        check.refuse(!map.geometry.is_free(x, y), key, || {
            let [x, y] = [x, y].map(number);
            format!("[{x}, {y}] is not allowed; a point in the free space of {}", shown(&simulation.map))
        });
    };
    match &simulation.robot.path {
        RobotPath::Waypoints { points_m, .. } => {
            for (i, [x, y]) in points_m.iter().enumerate() {
                visit(&format!("robot.path.waypoints.points_m[{i}]"), *x, *y);
            }
        }
        RobotPath::VelocityProfile { start, .. } => {
            visit("robot.path.velocity_profile.start", start.x, start.y);
        }
    }
    if check.is_clean() {
        between_points(&mut check, simulation, map);
    }
    if check.is_clean() { Ok(()) } else { Err(check.into_error()) }
}

/// Checks that the filter starts within the map.
fn around(check: &mut Checker<'_>, start: Pose2, map: &Geometry) {
    let [x0, y0, x1, y1] = map.bounds();
    for (key, value, [lo, hi]) in [("x_m", start.x, [x0, x1]), ("y_m", start.y, [y0, y1])] {
        check.refuse(!(lo..=hi).contains(&value), &join("filter.start.around", key), || {
            let [value, lo, hi] = [value, lo, hi].map(number);
            format!("{value} is not allowed; {lo} to {hi}, the map's extent")
        });
    }
}

/// The most pairs of a step and a wall that are looked at.
const MOST_CROSSINGS: u64 = 100_000_000;
/// Time between the points of a path that are looked at for walls \[s\].
const STEP_SECS: f64 = 0.05;

/// Checks that the path of a simulated robot lies in the map's free space wherever it takes a scan.
fn between_points(check: &mut Checker<'_>, simulation: &Simulation, map: &LoadedMap) {
    let rate_hz = simulation.laser.rate_hz;
    // Other defects of a path are refused when it is simulated.
    let Ok(path) = Trajectory::new(&simulation.robot.path) else { return };
    let Ok(count) = path.scan_count(rate_hz) else { return };
    let mut poses = (0..count).map(|i| (i as f64 / rate_hz, path.pose_at(i as f64 / rate_hz)));
    let key = match simulation.robot.path {
        RobotPath::Waypoints { .. } => "robot.path.waypoints.points_m",
        RobotPath::VelocityProfile { .. } => "robot.path.velocity_profile.segments",
    };
    if let Some((secs, pose)) = poses.find(|(_, pose)| !map.geometry.is_free(pose.x, pose.y)) {
        check.problem(
            key,
            format!(
                "after {secs:.2} s the path is at ({:.3}, {:.3}) m, which is not in the free space of {}",
                pose.x,
                pose.y,
                shown(&simulation.map)
            ),
        );
        return;
    }
    // A wall without thickness has no inside. A scan may be far from the next, around a corner.
    let step_secs = STEP_SECS.min(1.0 / rate_hz);
    let points = (count as f64 / rate_hz / step_secs) as u64;
    if points * map.geometry.walls().len() as u64 > MOST_CROSSINGS {
        return;
    }
    let mut before = None;
    let mut poses = (0..points).map(|i| (i as f64 * step_secs, path.pose_at(i as f64 * step_secs)));
    let crossing = poses.find(|(_, pose)| {
        let here = pose.position();
        before.replace(here).is_some_and(|before| map.geometry.is_crossed(before, here))
    });
    if let Some((secs, pose)) = crossing {
        let map = shown(&simulation.map);
        let what = format!(
            "after {secs:.2} s the path crosses a wall of {map}, near ({:.3}, {:.3}) m",
            pose.x, pose.y
        );
        check.problem(key, what);
    }
}

/// Checks what can't be said of a map that is yet to be built from a log: it has no named walls.
pub(crate) fn without_map(walls: &[Option<String>], mut check: Checker<'_>) -> Result<(), ScenarioError> {
    for (i, _) in walls.iter().enumerate().filter(|(_, wall)| wall.is_some()) {
        check.problem(
            &format!("effects[{i}].wall"),
            "the key is not allowed here; a map that is built from a log has no named walls, give `from_m` and `to_m`",
        );
    }
    if check.is_clean() { Ok(()) } else { Err(check.into_error()) }
}

/// Whether files and columns can be called so.
fn is_plain_name(name: &str) -> bool {
    (1..=MOST_LETTERS).contains(&name.len()) && name.chars().all(is_plain)
}

fn is_plain(c: char) -> bool {
    c.is_ascii_alphanumeric() || "-_".contains(c)
}

/// The name that is given, or that of the file with `-` for what a name may not have.
pub fn name(check: &mut Checker<'_>, name: Option<&str>, path: &Path) -> String {
    let Some(name) = name else {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        return stem.chars().take(MOST_LETTERS).map(|c| if is_plain(c) { c } else { '-' }).collect();
    };
    check.refuse(!is_plain_name(name), "name", || {
        format!("`{}` is not allowed; up to {MOST_LETTERS} letters, digits, `-` and `_`", quoted(name))
    });
    name.to_owned()
}

fn training(check: &mut Checker<'_>, raw: &RawTraining, source: Option<&Source>) -> Training {
    let measured = matches!(source, Some(Source::Log(log)) if !log.train_scans.is_empty());
    let observations = match raw.observations {
        None if measured => 1,
        Some(n) if measured => {
            check.refuse(n != 1, "training.observations", || {
                format!("{n} is not allowed; a log has 1 observation of each state")
            });
            1
        }
        n => check.count("training.observations", n.unwrap_or(default::OBSERVATIONS), 1, 100_000),
    };
    Training {
        poses: check.count("training.poses", raw.poses, 2, 1_000_000),
        observations,
        beams: beams(
            check,
            "training.beams",
            raw.beams,
            match source {
                Some(Source::Simulation(simulation)) => Some(simulation.laser.beams),
                _ => None,
            },
        ),
        held_out_share: check.number("training.held_out_share", raw.held_out_share, Between(0.0, 1.0)),
    }
}

/// A number of beams, at most the laser's where that is known.
fn beams(check: &mut Checker<'_>, key: &str, beams: Option<u64>, of_laser: Option<u32>) -> Option<u32> {
    let beams = check.count(key, beams?, 1, MAX_BEAMS);
    // A laser without beams is a problem of its own.
    if let Some(limit @ 1..) = of_laser {
        check.refuse(beams > limit, key, || format!("{beams} is not allowed; at most laser.beams, {limit}"));
    }
    Some(beams)
}

fn models(check: &mut Checker<'_>, raw: &[Form<ModelName, RawModel>], measured: bool) -> Vec<Model> {
    check.refuse(raw.is_empty(), "models", || {
        format!("an empty list is not allowed; at least one of {}", ModelName::NAMES.join(", "))
    });
    check.length("models", raw, MOST_MODELS);
    let mut models: Vec<Model> = Vec::new();
    // Those beyond are refused already, and each is held against all before it.
    for (i, raw) in raw.iter().take(MOST_MODELS).enumerate() {
        let key = format!("models[{i}]");
        let model = match raw {
            Form::Short(name) => {
                Model { name: *name, label: name.to_string(), floor: None, exponent: None, file: None }
            }
            Form::Full(raw) => Model {
                name: raw.name,
                label: raw.label.clone().unwrap_or_else(|| raw.name.to_string()),
                floor: raw.floor.map(|floor| check.number(&join(&key, "floor"), floor, FromBelow(0.0, 1.0))),
                exponent: raw
                    .exponent
                    .map(|exponent| check.number(&join(&key, "exponent"), exponent, AboveUpTo(0.0, 1.0))),
                file: raw.file.as_ref().map(|file| check.file(&join(&key, "file"), file)),
            },
        };
        let label = &model.label;
        check.refuse(!is_plain_name(label), &join(&key, "label"), || {
            format!("`{}` is not allowed; up to {MOST_LETTERS} letters, digits, `-` and `_`", quoted(label))
        });
        // Of files in `trajectories/`.
        let is_taken = ["reference", "odometry"].contains(&label.as_str()) || label.ends_with("-estimate");
        check.refuse(is_taken, &join(&key, "label"), || {
            format!("`{}` is not allowed; a label other than `reference`, `odometry` and those that end in `-estimate`", quoted(label))
        });
        check.refuse(models.iter().any(|other| other.label == *label), &key, || {
            format!(
                "`{}` is not allowed; a model before it has this label, give one a `label` of its own",
                quoted(label)
            )
        });
        if model.name == ModelName::Oracle {
            check.refuse(measured, &key, || {
                "`oracle` is not allowed; it knows a simulated world, not a log".to_owned()
            });
            check.refuse(model.file.is_some(), &join(&key, "file"), || {
                "the key is not allowed here; `oracle` isn't fitted".to_owned()
            });
        }
        if matches!(model.name, ModelName::Amcl(_)) {
            for (key_of_value, is_there) in
                [("floor", model.floor.is_some()), ("exponent", model.exponent.is_some())]
            {
                check.refuse(is_there, &join(&key, key_of_value), || {
                    "the key is not allowed here; AMCL has none".to_owned()
                });
            }
        }
        models.push(model);
    }
    models
}

/// The models that `--models` leaves.
fn select(check: &mut Checker<'_>, models: &[Model], labels: Option<&[String]>) -> Vec<Model> {
    let Some(labels) = labels else { return models.to_vec() };
    check.refuse(labels.is_empty(), "--models", || "no model is named".to_owned());
    for label in labels {
        known_label(check, "--models", label, models);
    }
    models.iter().filter(|model| labels.contains(&model.label)).cloned().collect()
}

fn known_label(check: &mut Checker<'_>, key: &str, label: &str, models: &[Model]) {
    let labels: Vec<&str> = models.iter().map(|model| model.label.as_str()).collect();
    check.refuse(!labels.contains(&label), key, || unknown_word(label, "a model of this scenario", &labels));
}

fn record(check: &mut Checker<'_>, raw: &RawRecord, trials: u32, all: &[Model], models: &[Model]) -> Record {
    let trial = match trials {
        // A problem of its own.
        0 => 0,
        1.. => check.count("record.trial", raw.trial, 0, trials - 1),
    };
    let wanted = |label: &String| match &raw.models {
        Form::Short(All::All) => true,
        Form::Full(labels) => labels.contains(label),
    };
    if let Form::Full(labels) = &raw.models {
        check.length("record.models", labels, MOST_MODELS);
        for (i, label) in labels.iter().take(MOST_MODELS).enumerate() {
            known_label(check, &format!("record.models[{i}]"), label, all);
        }
    }
    Record { trial, models: models.iter().map(|model| model.label.clone()).filter(wanted).collect() }
}

/// Bounds on the models that run; those on the others are checked and dropped.
fn expectations(
    check: &mut Checker<'_>,
    raw: &BTreeMap<String, RawBounds>,
    all: &[Model],
    models: &[Model],
) -> Vec<Expectation> {
    let mut expectations = Vec::new();
    for (label, bounds) in raw {
        let key = join("expect", label);
        known_label(check, &key, label, all);
        bound(check, &key, "", label, bounds, &mut expectations);
    }
    expectations.retain(|expectation| models.iter().any(|model| model.label == expectation.model));
    expectations
}

/// Collects the bounds on `metric` (empty for the model itself) and on the figures nested in it.
fn bound(
    check: &mut Checker<'_>,
    key: &str,
    metric: &str,
    label: &str,
    bounds: &RawBounds,
    out: &mut Vec<Expectation>,
) {
    for (inner, bounds) in &bounds.nested {
        bound(check, &join(key, inner), &join(metric, inner), label, bounds, out);
    }
    let [min, max] = [("min", bounds.min), ("max", bounds.max)]
        .map(|(word, value)| value.map(|value| check.number(&join(key, word), value, Any)));
    if min.is_none() && max.is_none() {
        check.refuse(bounds.nested.is_empty(), key, || {
            "an empty map is not allowed; a bound such as {max: 0.05}".to_owned()
        });
        return;
    }
    if let (Some(min), Some(max)) = (min, max) {
        check.refuse(min > max, &join(key, "min"), || {
            format!("{} is not allowed; not above max, {}", number(min), number(max))
        });
    }
    if metric.is_empty() {
        check.problem(key, "a bound belongs to a figure, such as {lost_share: {max: 0.05}}");
        return;
    }
    let (allowed, words) = match metric {
        "lost_share" => (0.0..=1.0, "a share from 0 to 1"),
        _ if is_signed(metric) => (f64::NEG_INFINITY..=f64::INFINITY, ""),
        _ => (0.0..=f64::INFINITY, "0 or more, as the figure is"),
    };
    for (word, bound) in [("min", min), ("max", max)] {
        let Some(bound) = bound.filter(|bound| !allowed.contains(bound)) else { continue };
        check.problem(&join(key, word), format!("{} is not allowed; {words}", number(bound)));
    }
    match METRICS.into_iter().find(|known| *known == metric) {
        Some(metric) => out.push(Expectation { model: label.to_owned(), metric, min, max }),
        None => check.problem(key, unknown_word(metric, "a figure of a model", &METRICS)),
    }
}

/// Whether a figure can be below 0: means of signed errors and logarithms of densities.
fn is_signed(metric: &str) -> bool {
    [".mean_m", ".mean_rad", ".log_loss_nats"].iter().any(|ending| metric.ends_with(ending))
}
