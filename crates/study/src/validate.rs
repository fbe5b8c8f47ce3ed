//! From the raw study to the validated one: ranges, what keys have to do with each other, maps and data.

use std::collections::BTreeMap;
use std::path::Path;

use distreg::{Alignment, Dataset, Outcomes};
use glam::DVec2;
use locsim_core::limits::MOST_REPEATS;
use locsim_core::{Draw, Stage};
use locsim_world::raycast::ExactRangeMap;

use super::raw::{
    RawAlignment, RawFieldSensor, RawGrass, RawLaser, RawSensor, RawStaticLidar, RawStudy, RawTable,
};
use super::sensor::{
    Condition, FieldSensor, Forceps, Grass, GrassNoise, PlanarLaser, Setup, Source, Unit, Values,
    read_static_lidar, read_table,
};
use super::{Kind, Study, StudyError, StudyOverrides};
use locsim_scenario::check::Allowed::{self, FromBelow, Within};
use locsim_scenario::check::{COORDINATE, Checker, LENGTH, NOISE, POSITIVE_LENGTH, number};
use locsim_scenario::error::unknown_word;
use locsim_scenario::{load_map, name};

const METRES: &str = "m";
/// The most bins, training states or observations.
const MOST: u32 = 10_000_000;
/// Share of a laser's beams that have to meet a wall.
const LEAST_HITS: f64 = 0.01;
/// The most observations of all states together, and the most of a test state's truth.
const MOST_TOGETHER: u64 = 100_000_000;
/// The most points of a path, numbers in a list or bandwidths to try.
const MOST_LISTED: usize = 1000;
/// Bandwidths, steps and values in the unit of a table.
const ANY_UNIT: Allowed = Within(1e-12, 1e12);
/// Share of recorded states that a repeat tests on, at most.
const TEST_SHARE: f64 = 0.3;

/// Sizes with `--quick`.
const QUICK_REPEATS: u32 = 2;
const QUICK_STATES: usize = 60;
const QUICK_TESTS: usize = 20;
const QUICK_TRUTH: usize = 2000;
/// Families are fitted to one ray in this many.
const QUICK_RAYS: usize = 10;

/// Checks everything; the error holds every problem of the first step that finds one.
pub(super) fn validate<'a>(
    raw: RawStudy,
    path: &Path,
    text: String,
    overrides: StudyOverrides,
    checker: &dyn Fn() -> Checker<'a>,
) -> Result<Study, StudyError> {
    let mut check = checker();
    let name = name(&mut check, raw.name.as_deref(), path);
    let repeats = match overrides.repeats {
        Some(repeats) => check.count("--repeats", repeats.into(), 1, MOST_REPEATS),
        None => check.count("repeats", raw.repeats, 1, MOST_REPEATS),
    };
    let folds = check.count("folds", raw.folds, 2, 100) as usize;
    let states = counts(&mut check, "states", &raw.states, folds as u32);
    let counts_of_figure = counts(&mut check, "counts", &raw.counts, 1);
    check.refuse(states.is_empty(), "states", || {
        "an empty list is not allowed; at least one number".to_owned()
    });
    check.refuse(raw.models.is_empty(), "models", || {
        "an empty list is not allowed; at least one model".to_owned()
    });
    check.length("models", &raw.models, MOST_LISTED);
    for (i, model) in raw.models.iter().take(MOST_LISTED).enumerate() {
        check.refuse(raw.models[..i].contains(model), &format!("models[{i}]"), || {
            format!("`{}` is not allowed; it is in the list already", model.as_str())
        });
    }
    let test_states = check.count("test_states", raw.test_states, 2, MOST) as usize;
    let observations = raw.observations.map(|n| check.count("observations", n, 1, MOST) as usize);
    check_bandwidths(&mut check, &raw.bandwidths);
    let simulated = !matches!(raw.sensor, RawSensor::StaticLidar(_) | RawSensor::Table(_));
    if simulated {
        check.refuse(observations.is_none(), "observations", || "the key is missing".to_owned());
    } else {
        let why = "recorded data have the observations that they have";
        check.absent("", "truth_observations", raw.truth_observations.as_ref(), why);
    }
    check.refuse(raw.thinning && states.len() < 2, "thinning", || {
        "true is not allowed with one number of states; the largest is thinned to the others".to_owned()
    });
    let truth_observations =
        raw.truth_observations.map_or(5000, |n| check.count("truth_observations", n, 2, MOST) as usize);
    let most = |list: &[usize]| list.iter().copied().max().unwrap_or(0) as u64;
    for (key, states, each) in [
        ("observations", most(&states), observations.unwrap_or(0) as u64),
        ("counts", most(&states), most(&counts_of_figure)),
        ("truth_observations", if simulated { test_states as u64 } else { 0 }, truth_observations as u64),
    ] {
        let together = states.saturating_mul(each);
        check.refuse(together > MOST_TOGETHER, key, || {
            format!("{each} of each of {states} states are not allowed; at most {MOST_TOGETHER} together")
        });
    }
    let seed = overrides.seed.unwrap_or(raw.seed);
    let (kind, prepare) = sensor(&mut check, raw.sensor, seed);
    if !check.is_clean() {
        return Err(check.into_error().into());
    }
    let setup = prepare()?;

    let mut check = checker();
    let coordinates: Vec<&str> = setup.coordinates.iter().map(|(name, _)| name.as_str()).collect();
    for key in raw.bandwidths.keys().filter(|key| !coordinates.contains(&key.as_str())) {
        check.problem(&format!("bandwidths.{key}"), unknown_word(key, "a state coordinate", &coordinates));
    }
    for coordinate in &coordinates {
        check.refuse(!raw.bandwidths.contains_key(*coordinate), &format!("bandwidths.{coordinate}"), || {
            "the key is missing; candidate bandwidths of the state coordinate, in its unit".to_owned()
        });
    }
    for (i, model) in raw.models.iter().enumerate().filter(|(_, model)| model.needs_alignment()) {
        check.refuse(setup.alignment.is_none(), &format!("models[{i}]"), || {
            format!("`{}` is not allowed; the observation follows no state coordinate here", model.as_str())
        });
    }
    let test_states = test_states_of(&mut check, &setup, &states, test_states);
    if !check.is_clean() {
        return Err(check.into_error().into());
    }
    let bandwidths = coordinates.iter().map(|name| raw.bandwidths[*name].clone()).collect();
    let mut study = Study {
        file: path.to_owned(),
        text,
        name,
        description: raw.description,
        seed,
        kind,
        setup,
        models: raw.models,
        bandwidths,
        folds,
        criterion: raw.criterion,
        states,
        observations,
        thinning: raw.thinning,
        counts: counts_of_figure,
        repeats,
        test_states,
        truth_observations,
        quick: overrides.quick,
    };
    if overrides.quick {
        make_quick(&mut study, overrides.repeats);
    }
    Ok(study)
}

/// Checks the candidate bandwidths of each state coordinate.
fn check_bandwidths(check: &mut Checker<'_>, bandwidths: &BTreeMap<String, Vec<f64>>) {
    let names = bandwidths.len();
    check.refuse(names > MOST_LISTED, "bandwidths", || {
        format!("{names} coordinates are not allowed; at most {MOST_LISTED}")
    });
    for (coordinate, candidates) in bandwidths {
        let key = format!("bandwidths.{coordinate}");
        check.refuse(candidates.is_empty(), &key, || {
            "an empty list is not allowed; at least one number".to_owned()
        });
        check.length(&key, candidates, MOST_LISTED);
        check.numbers(&key, candidates, ANY_UNIT);
    }
}

/// The number of test states, of which recorded data leave no more than [`TEST_SHARE`]; the states of each size of training set
/// have to be among the others.
fn test_states_of(check: &mut Checker<'_>, setup: &Setup, states: &[usize], mut test_states: usize) -> usize {
    for condition in &setup.conditions {
        if let Source::Recorded(data) = &condition.source {
            test_states = test_states.min((TEST_SHARE * data.len() as f64) as usize);
            let most = data.len() - test_states;
            for (i, n) in states.iter().enumerate().filter(|(_, n)| **n > most) {
                check.problem(
                    &format!("states[{i}]"),
                    format!(
                        "{n} is not allowed; at most {most}: of {} states {test_states} are for tests",
                        data.len()
                    ),
                );
            }
        }
    }
    test_states
}

/// Cuts a study down to what `--quick` leaves. `repeats` are those that the command line gives.
fn make_quick(study: &mut Study, repeats: Option<u32>) {
    study.repeats = repeats.unwrap_or(study.repeats.min(QUICK_REPEATS));
    let most = QUICK_STATES.max(study.folds);
    study.states.retain(|n| *n <= most);
    if study.states.is_empty() {
        study.states.push(most);
    }
    study.test_states = study.test_states.min(QUICK_TESTS);
    study.setup.rays = std::mem::take(&mut study.setup.rays).into_iter().step_by(QUICK_RAYS).collect();
    study.truth_observations = study.truth_observations.min(QUICK_TRUTH);
}

/// Ascending whole numbers from `lo`.
fn counts(check: &mut Checker<'_>, key: &str, values: &[u64], lo: u32) -> Vec<usize> {
    check.length(key, values, MOST_LISTED);
    let mut last = 0;
    let mut counts = Vec::new();
    for (i, value) in values.iter().enumerate() {
        let key = format!("{key}[{i}]");
        let count = check.count(&key, *value, lo, MOST) as usize;
        check.refuse(i > 0 && count <= last, &key, || format!("{count} is not allowed; numbers ascend"));
        last = count;
        counts.push(count);
    }
    counts
}

/// Reads and builds what the checks of a sensor's keys let pass.
type Prepare = Box<dyn FnOnce() -> Result<Setup, StudyError>>;

fn sensor(check: &mut Checker<'_>, raw: RawSensor, seed: u64) -> (Kind, Prepare) {
    match raw {
        RawSensor::Laser(raw) => (Kind::Laser, laser(check, raw)),
        RawSensor::FieldSensor(raw) => (Kind::FieldSensor, field_sensor(check, &raw)),
        RawSensor::Grass(raw) => (Kind::Grass, grass(check, &raw, seed)),
        RawSensor::StaticLidar(raw) => (Kind::StaticLidar, static_lidar(check, &raw)),
        RawSensor::Table(raw) => (Kind::Table, table(check, raw)),
    }
}

/// The values of a sensor from 0 on.
fn values(check: &mut Checker<'_>, key: &str, last: f64, last_key: &str, resolution: f64) -> Values {
    check.number(&format!("{key}.{last_key}"), last, POSITIVE_LENGTH);
    let resolution_key = format!("{key}.resolution_m");
    check.number(&resolution_key, resolution, Within(1e-9, 1e6));
    check.refuse(resolution >= last, &resolution_key, || {
        format!("{} is not allowed; below {last_key}, which is {}", number(resolution), number(last))
    });
    too_many(check, &resolution_key, last / resolution);
    Values { resolution, last }
}

fn too_many(check: &mut Checker<'_>, key: &str, values: f64) {
    let most = 1e6;
    check.refuse(values > most, key, || {
        format!("{} values are not allowed; at most {most}", number(values.round()))
    });
}

/// The setup of a simulated sensor.
fn simulated(
    coordinates: &[(&str, &'static str)],
    values: Values,
    alignment: Option<Alignment>,
    conditions: Vec<Condition>,
) -> Result<Setup, StudyError> {
    Ok(Setup {
        coordinates: coordinates.iter().map(|(name, unit)| ((*name).to_owned(), *unit)).collect(),
        outcomes: Outcomes::of_values(0.0, values.last, values.resolution)?,
        unit: Unit::MILLIMETRE,
        alignment,
        conditions,
        rays: Vec::new(),
        files: Vec::new(),
        note: None,
    })
}

fn laser(check: &mut Checker<'_>, raw: RawLaser) -> Prepare {
    let key = |name: &str| format!("sensor.laser.{name}");
    let map = check.file(&key("map"), &raw.map);
    check.refuse(raw.path_m.len() < 2, &key("path_m"), || {
        format!("{} points are not allowed; at least 2", raw.path_m.len())
    });
    check.length(&key("path_m"), &raw.path_m, MOST_LISTED);
    let all_the_same = raw.path_m.windows(2).all(|ends| {
        let [[x0, y0], [x1, y1]] = [ends[0], ends[1]];
        (x1 - x0).hypot(y1 - y0) < 1e-6
    });
    check.refuse(raw.path_m.len() > 1 && all_the_same, &key("path_m"), || {
        "points that are all the same are not allowed; a path".to_owned()
    });
    for (i, point) in raw.path_m.iter().enumerate() {
        check.numbers(&format!("{}[{i}]", key("path_m")), point, COORDINATE);
    }
    let beams = check.count(&key("beams"), raw.beams, 1, 100_000);
    let values = values(check, "sensor.laser", raw.max_range_m, "max_range_m", raw.resolution_m);
    let sigma = check.number(&key("sigma_m"), raw.sigma_m, NOISE);
    let sigma_per_m2 = check.number(&key("sigma_per_m2"), raw.sigma_per_m2, NOISE);
    let sigma_per_tan = check.number(&key("sigma_per_tan_m"), raw.sigma_per_tan_m, NOISE);
    Box::new(move || {
        let loaded = load_map(&map)?;
        let files = [map.clone()].into_iter().chain(loaded.image).collect();
        let geometry = loaded.geometry;
        let path: Vec<DVec2> = raw.path_m.iter().copied().map(DVec2::from_array).collect();
        let refuse = |what| Err(StudyError::Data { path: map.clone(), line: None, what });
        if let Some(outside) = path.iter().find(|p| !geometry.is_free(p.x, p.y)) {
            let [x, y] = [outside.x, outside.y].map(number);
            return refuse(format!("the study's path_m leads through [{x}, {y}], which isn't free"));
        }
        let ranges = ExactRangeMap::new(geometry);
        let sensor = PlanarLaser { map: ranges, path, beams, values, sigma, sigma_per_m2, sigma_per_tan };
        if sensor.hit_share() < LEAST_HITS {
            return refuse(format!(
                "hardly a beam from the study's path_m meets a wall within max_range_m, {} m",
                number(values.last)
            ));
        }
        let setup = simulated(
            &[("range_m", METRES), ("incidence_rad", "rad")],
            values,
            Some(Alignment::Shift { state_dim: 0 }),
            vec![Condition { label: "laser".to_owned(), source: Source::Simulated(Box::new(sensor)) }],
        )?;
        Ok(Setup { files, ..setup })
    })
}

fn field_sensor(check: &mut Checker<'_>, raw: &RawFieldSensor) -> Prepare {
    let key = |name: &str| format!("sensor.field_sensor.{name}");
    let values = values(check, "sensor.field_sensor", raw.max_m, "max_m", raw.resolution_m);
    let positions = check.interval(&key("positions_m"), raw.positions_m, POSITIVE_LENGTH);
    check.refuse(positions[1] > values.last, &key("positions_m"), || {
        format!("{} is not allowed; at most max_m, {}", number(positions[1]), number(values.last))
    });
    let sigma = check.number(&key("sigma_m"), raw.sigma_m, NOISE);
    let field_sigma = check.number(&key("field_sigma_m"), raw.field_sigma_m, NOISE);
    let metal = &raw.forceps;
    let centre = metal.centre_m;
    check.numbers(&key("forceps.centre_m"), &centre, Within(-10.0, 10.0));
    let forceps = Forceps {
        radius: check.number(&key("forceps.radius_m"), metal.radius_m, POSITIVE_LENGTH),
        centre: DVec2::from_array(centre),
        sweep: check.number(&key("forceps.sweep_m"), metal.sweep_m, LENGTH),
        wobble: check.number(&key("forceps.wobble_m"), metal.wobble_m, NOISE),
        withdrawn_share: check.number(
            &key("forceps.withdrawn_share"),
            metal.withdrawn_share,
            Within(0.0, 1.0),
        ),
    };
    Box::new(move || {
        let condition = |label: &str, forceps| {
            let sensor = FieldSensor { positions, values, sigma, field_sigma, forceps };
            Condition { label: label.to_owned(), source: Source::Simulated(Box::new(sensor)) }
        };
        simulated(
            &[("position_m", METRES)],
            values,
            Some(Alignment::Shift { state_dim: 0 }),
            vec![condition("still", None), condition("disturbed", Some(forceps))],
        )
    })
}

fn grass(check: &mut Checker<'_>, raw: &RawGrass, seed: u64) -> Prepare {
    let key = |name: &str| format!("sensor.grass.{name}");
    let values = values(check, "sensor.grass", raw.max_range_m, "max_range_m", raw.resolution_m);
    let rail = check.number(&key("rail_m"), raw.rail_m, POSITIVE_LENGTH);
    let depth = check.interval(&key("depth_m"), raw.depth_m, POSITIVE_LENGTH);
    check.refuse(depth[1] > values.last, &key("depth_m"), || {
        format!("{} is not allowed; at most max_range_m, {}", number(depth[1]), number(values.last))
    });
    let per_square_metre = check.number(&key("blades_per_m2"), raw.blades_per_m2, FromBelow(0.0, 1e6));
    let blade = check.interval(&key("blade_m"), raw.blade_m, Within(1e-6, 1e3));
    let noise = GrassNoise {
        wind: check.number(&key("wind_m"), raw.wind_m, NOISE),
        beam: check.number(&key("beam_m"), raw.beam_m, NOISE),
        sigma: check.number(&key("sigma_m"), raw.sigma_m, NOISE),
    };
    let blades = Grass::blades(rail, depth, per_square_metre, blade, noise);
    check.refuse(blades > MOST.into(), &key("blades_per_m2"), || {
        format!("{} blades are not allowed; at most {MOST}", number(blades))
    });
    let seed = Draw::new(seed, Stage::Trial, 0).seed(u32::MAX);
    Box::new(move || {
        let sensor = Grass::new(seed, rail, depth, per_square_metre, blade, noise, values);
        simulated(
            &[("position_m", METRES)],
            values,
            None,
            vec![Condition { label: "grass".to_owned(), source: Source::Simulated(Box::new(sensor)) }],
        )
    })
}

fn static_lidar(check: &mut Checker<'_>, raw: &RawStaticLidar) -> Prepare {
    let key = |name: &str| format!("sensor.static_lidar.{name}");
    let file = check.file(&key("file"), &raw.file);
    let values = values(check, "sensor.static_lidar", raw.max_range_m, "max_range_m", raw.resolution_m);
    let map_scans = check.count(&key("map_scans"), raw.map_scans, 2, MOST) as usize;
    let least = check.number(&key("least_return_share"), raw.least_return_share, Within(0.0, 1.0));
    Box::new(move || {
        let lidar = read_static_lidar(&file, map_scans, least)?;
        let mut setup = simulated(
            &[("range_m", METRES), ("slope_m", METRES), ("edge_m", METRES)],
            values,
            Some(Alignment::Shift { state_dim: 0 }),
            vec![Condition { label: "lidar".to_owned(), source: Source::Recorded(lidar.data) }],
        )?;
        setup.note = Some(format!(
            "{} scans of {} rays; the first {map_scans} scans stand in for the map. {} rays return in at least {} % of \
             the scans and are used. Readings without a return, {:.2} % of theirs, are left out: distributions are those of \
             a reading given that there is one.",
            lidar.scans,
            lidar.all_rays,
            lidar.rays.len(),
            100.0 * least,
            100.0 * lidar.no_return_share
        ));
        setup.rays = lidar.rays;
        setup.files = vec![file];
        Ok(setup)
    })
}

fn table(check: &mut Checker<'_>, raw: RawTable) -> Prepare {
    let key = |name: &str| format!("sensor.table.{name}");
    let file = check.file(&key("file"), &raw.file);
    let [first, last] = check.interval(&key("values"), raw.values, Within(-1e12, 1e12));
    check.number(&key("resolution"), raw.resolution, ANY_UNIT);
    too_many(check, &key("resolution"), (last - first) / raw.resolution);
    if let Some(mass) = raw.point_mass_at {
        check.number(&key("point_mass_at"), mass, Within(first, last));
    }
    Box::new(move || {
        let (names, data) = read_table(&file)?;
        let refuse = |what: String| StudyError::Data { path: file.clone(), line: Some(1), what };
        let known: Vec<&str> = names.iter().map(String::as_str).collect();
        let index = |column: &str| {
            known.iter().position(|name| *name == column).ok_or_else(|| {
                refuse(format!("sensor.table.align: {}", unknown_word(column, "a state column", &known)))
            })
        };
        let alignment = match &raw.align {
            None => None,
            Some(RawAlignment::Shift(column)) => Some(Alignment::Shift { state_dim: index(column)? }),
            Some(RawAlignment::Scale(column)) => Some(Alignment::Scale { state_dim: index(column)? }),
        };
        let needed = 8;
        if data.len() < needed {
            return Err(refuse(format!("{} states are not enough; at least {needed}", data.len())));
        }
        Ok(Setup {
            coordinates: names.iter().map(|name| (name.clone(), "")).collect(),
            outcomes: Outcomes {
                point_mass_at: raw.point_mass_at,
                ..Outcomes::of_values(first, last, raw.resolution)?
            },
            unit: Unit::OF_Z,
            alignment,
            note: Some(describe(&data)),
            conditions: vec![Condition { label: "table".to_owned(), source: Source::Recorded(data) }],
            rays: Vec::new(),
            files: vec![file.clone()],
        })
    })
}

fn describe(data: &Dataset) -> String {
    let counts = (0..data.len()).map(|i| data.observations(i).len());
    let (least, most) = counts.fold((usize::MAX, 0), |(lo, hi), n| (lo.min(n), hi.max(n)));
    format!("{} states with {least} to {most} observations each.", data.len())
}
