//! Accepted scenarios, and every kind of refusal.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt::Write;
use std::path::{Path, PathBuf};

use glam::DVec2;
use locsim_core::Pose2;
use locsim_dataset::BagTopics;
use locsim_mcl::{
    AnnealingOptions, InjectionOptions, KldOptions, ParticleCount, ResampleTrigger, Spread, UpdateThreshold,
};
use locsim_sensor::ModelKind;
use locsim_world::effect::EffectKind;
use locsim_world::simulation::{
    BlockOptions, BlockResampling, LaserOptions, OdometryNoise, Robot, RobotPath,
};
use proptest::prelude::*;
use serde_json::json;

use super::*;
use crate::testing::{assert_told, hostile_texts};

/// Tests run in the crate's folder, so that messages hold relative paths.
mod refused;

use refused::REFUSED;

const FIXTURES: &str = "src/fixtures";

fn environment(name: &str) -> Option<String> {
    (name == "LOGS").then(|| format!("{FIXTURES}/."))
}

pub(super) fn text(fixture: &str) -> String {
    std::fs::read_to_string(Path::new(FIXTURES).join(fixture)).unwrap()
}

fn parse_with(text: &str, overrides: &Overrides) -> Result<Scenario, ScenarioError> {
    Scenario::parse(&Path::new(FIXTURES).join("x.yaml"), text, overrides, &environment)
}

pub(super) fn parse(text: &str) -> Result<Scenario, ScenarioError> {
    parse_with(text, &Overrides::default())
}

/// The text with one part replaced, which must be there.
pub(super) fn edited(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from:?} is not in the fixture");
    text.replacen(from, to, 1)
}

/// Seven sweeps a second last 0.1429 s each, which a data sheet may round up; none lasts longer than its period.
#[test]
fn a_sweep_may_be_rounded_up() {
    let of = |secs: &str| {
        parse(&edited(&text("simulation.yaml"), "scan_secs: 0.1", &format!("scan_secs: {secs}")))
    };
    let Source::Simulation(simulation) = of("0.2015").unwrap().source else { panic!("no simulation") };
    let laser = simulation.laser;
    assert_eq!(laser.scan_secs, 1.0 / laser.rate_hz);
    assert!(of("0.203").unwrap_err().to_string().contains("laser.scan_secs: 0.203"));
}

#[test]
#[expect(clippy::too_many_lines, reason = "one expected value for each section of the file, written out")]
fn every_key_arrives_in_si_units_and_radians() {
    let scenario = parse(&text("simulation.yaml")).unwrap();
    assert_eq!(scenario.name, "everything");
    assert_eq!((scenario.seed, scenario.trials), (7, 20));
    assert_eq!(scenario.ray_cast, RayCast::Table { cell_m: 0.05, memory_mb: 300 });
    let Source::Simulation(simulation) = &scenario.source else { panic!("{:?}", scenario.source) };
    assert_eq!(simulation.map, Path::new(FIXTURES).join("map.yaml"));
    let degrees = f64::to_radians;
    assert_eq!(
        simulation.blocks,
        Some(BlockOptions {
            per_metre_of_wall: 0.5,
            length_m: [0.2, 0.6],
            width_m: [0.2, 0.5],
            yaw_rad: [degrees(-30.0), degrees(30.0)],
            wall_distance_m: [0.0, 0.5],
            resample: BlockResampling::EachScanN(5),
            speed_m_s: [0.0, 0.1],
            clearance_m: 0.4,
        })
    );
    assert_eq!(
        simulation.robot,
        Robot {
            path: RobotPath::Waypoints {
                points_m: vec![[1.0, 2.0], [19.0, 2.0], [19.0, 3.0]],
                speed_m_s: 0.5,
                turn_rate_rad_s: degrees(45.0),
            },
            start_jitter_m: 0.1,
            odometry_noise: OdometryNoise::new([0.05, 0.02, 0.05, 0.01]).unwrap(),
        }
    );
    assert_eq!(
        simulation.laser,
        LaserOptions {
            rate_hz: 5.0,
            beams: 36,
            field_of_view_rad: 1.5 * PI,
            first_bearing_rad: None,
            min_range_m: 0.05,
            max_range_m: 4.5,
            resolution_m: 0.001,
            sigma_m: 0.01,
            sigma_per_m: 0.002,
            mount: Pose2 { x: 0.1, y: -0.05, theta: FRAC_PI_2 },
            scan_secs: 0.1,
        }
    );
    assert_eq!(
        scenario.training,
        Training { poses: 50, observations: 70, beams: Some(18), held_out_share: 0.2 }
    );
    let plain =
        |name: ModelName| Model { name, label: name.to_string(), floor: None, exponent: None, file: None };
    assert_eq!(
        scenario.models,
        [
            plain(ModelName::Fitted(ModelKind::Classic)),
            Model {
                name: ModelName::Fitted(ModelKind::NpRegRegistered),
                label: "loaded".to_owned(),
                floor: Some(0.01),
                exponent: Some(0.5),
                file: Some(Path::new(FIXTURES).join("fitted.model")),
            },
            plain(ModelName::Fitted(ModelKind::NpRegRegistered)),
            plain(ModelName::Oracle),
        ]
    );
    assert_eq!(
        scenario.filter,
        Filter {
            particles: ParticleCount::Kld(KldOptions {
                min: 500,
                max: 5000,
                error: 0.02,
                quantile: 0.95,
                bin_m: 0.25,
                bin_rad: degrees(5.0),
            }),
            motion: Motion::Odometry(Some([0.1, 0.05, 0.1, 0.05])),
            calibrate: false,
            random_walk_m: 0.02,
            resampler: Resampler::Residual,
            resample: ResampleTrigger::EffectiveShareBelow(0.5),
            injection: Some(InjectionOptions { alpha_slow: 0.001, alpha_fast: 0.1 }),
            start: Start::Tracking(Spread { sigma_m: 0.1, sigma_rad: degrees(3.0) }),
            beams: Some(12),
            update: Some(UpdateThreshold { distance_m: 0.25, angle_rad: degrees(10.0) }),
            estimate: Estimate::MostLikelyTrajectory,
            regularization: Spread { sigma_m: 0.01, sigma_rad: degrees(0.5) },
            least_effective_share: None,
            annealing: Some(AnnealingOptions {
                candidates: 4000,
                effective_share: 0.8,
                moves: 6,
                step: Spread { sigma_m: 0.02, sigma_rad: degrees(1.0) },
                gathered_m: 0.3,
            }),
        }
    );
    assert_eq!(scenario.errors, Errors { frame: ErrorFrame::Robot, lost_m: 1.5 });
    // In the order of the models, not of the list.
    assert_eq!(scenario.record, Record { trial: 3, models: vec!["classic".to_owned(), "loaded".to_owned()] });
    let expectation =
        |model: &str, metric, min, max| Expectation { model: model.to_owned(), metric, min, max };
    assert_eq!(
        scenario.expect,
        [
            expectation("loaded", "along.std_m", None, Some(0.02)),
            expectation("loaded", "position_rmse_m", Some(0.001), Some(0.05)),
            expectation("loaded", "train.log_loss_nats", None, Some(3.0)),
            expectation("oracle", "lost_share", None, Some(0.0)),
        ]
    );
}

#[test]
fn the_first_beam_may_be_given() {
    let first = "  field_of_view_deg: 270\n  first_beam_deg: -180\n";
    let text = edited(&text("simulation.yaml"), "  field_of_view_deg: 270\n", first);
    let Source::Simulation(simulation) = parse(&text).unwrap().source else { panic!() };
    assert_eq!(simulation.laser.first_bearing_rad, Some(-PI));
}

/// The scenario of a log, with a bag instead.
pub(super) fn bag() -> String {
    let topics = "drive.mcap\n  topics: {scan: /lidar, odometry: /wheels, reference: /fused}";
    edited(&text("log.yaml"), "drive.log", topics)
}

#[test]
fn effects_arrive_in_si_units_and_on_their_walls() {
    let scenario = parse(&text("simulation.yaml")).unwrap();
    let Source::Simulation(Simulation { effects, .. }) = &scenario.source else { panic!() };
    let find = |kind| effects.iter().filter(|effect| effect.kind == kind).collect::<Vec<_>>();
    let point = DVec2::new;
    let degrees = f64::to_radians;
    assert_eq!(find(EffectKind::IncidenceDropout)[0].values, [0.5, degrees(60.0), degrees(5.0)]);
    assert_eq!(find(EffectKind::SectorOcclusion)[0].values, [degrees(170.0), degrees(-170.0), 0.3, 0.5]);
    assert_eq!(find(EffectKind::OdomImbalance)[0].values, [degrees(1.0)]);
    assert_eq!(find(EffectKind::MissingObject)[0].values, [15.0, 3.5, 0.2]);
    let glass = find(EffectKind::Glass);
    assert_eq!(glass[0].place, [[point(20.0, 4.0), point(0.0, 4.0)]], "the wall outline/2");
    assert_eq!(glass[1].place, [[point(4.0, 0.0), point(6.5, 0.0)]]);
    assert_eq!([&glass[0].values[..], &glass[1].values[..]], [[0.3, 0.0], [0.6, 0.2]]);
    let left_out = "effects: [{name: mount_offset, y_m: 0.1}, {name: warmup_drift, bias_m: 0.1}]";
    let scenario = parse(&format!("{}{left_out}", text("minimal.yaml"))).unwrap();
    let Source::Simulation(Simulation { effects, .. }) = &scenario.source else { panic!() };
    assert_eq!(
        (effects[0].values.as_slice(), effects[1].values.as_slice()),
        (&[0.0, 0.1][..], &[0.1, 60.0][..])
    );
}

/// A file may be called as its user likes.
#[test]
fn a_name_comes_from_the_file() {
    let text = text("minimal.yaml");
    for (file, name) in
        [("my.robot.yaml", "my-robot"), ("lab 2, left.yaml", "lab-2--left"), ("l\u{fc}bke.yaml", "l-bke")]
    {
        let path = Path::new(FIXTURES).join(file);
        let scenario = Scenario::parse(&path, &text, &Overrides::default(), &environment).unwrap();
        assert_eq!(scenario.name, name);
    }
}

#[test]
fn a_log_is_read_with_its_parts() {
    let scenario = parse(&text("log.yaml")).unwrap();
    assert_eq!(scenario.name, "x", "the file's name");
    assert_eq!(
        scenario.source,
        Source::Log(Log {
            file: Path::new(FIXTURES).join("./drive.log"),
            map: LogMap::FromScans { scans: vec![[0.0, 0.5]], resolution_m: 0.1 },
            train_scans: vec![[0.5, 0.6], [0.6, 0.75]],
            localize_scans: vec![[0.75, 1.0]],
            max_range_m: Some(40.0),
            topics: BagTopics::default(),
            simulator: None,
        })
    );
    let Source::Log(bag) = parse(&bag()).unwrap().source else { panic!() };
    let topic = |name: &str| Some(name.to_owned());
    assert_eq!(
        bag.topics,
        BagTopics { scan: topic("/lidar"), odometry: topic("/wheels"), reference: topic("/fused") }
    );
    assert_eq!(scenario.map_file(), None);
    assert_eq!(scenario.training.observations, 1);
    assert_eq!(scenario.filter.start, Start::Global);
    assert_eq!(scenario.filter.least_effective_share, Some(0.1));
    for (motion, walk, calibrate) in [
        ("{model: odometry}", 0.04, true),
        ("{model: odometry, calibrate: false, random_walk_m: 0}", 0.0, false),
        ("{model: odometry, alpha: [0.1, 0.05, 0.1, 0.05], random_walk_m: 0.01}", 0.01, false),
        ("{model: odometry, alpha: [0.1, 0.05, 0.1, 0.05], calibrate: true}", 0.0, true),
    ] {
        let other = edited(&text("log.yaml"), "{model: odometry, alpha: [0.1, 0.05, 0.1, 0.05]}", motion);
        let filter = parse(&other).unwrap().filter;
        assert_eq!((filter.random_walk_m, filter.calibrate), (walk, calibrate));
    }
    for (line, share) in [("", Some(0.02)), ("  least_effective_share: 0\n", None)] {
        let other = edited(&text("log.yaml"), "  least_effective_share: 0.1\n", line);
        assert_eq!(parse(&other).unwrap().filter.least_effective_share, share);
    }

    let standing = Some(UpdateThreshold { distance_m: 0.02, angle_rad: 1_f64.to_radians() });
    assert_eq!(scenario.filter.update, standing);
    let all = edited(&text("log.yaml"), "  least_eff", "  update: each_scan\n  least_eff");
    assert_eq!(parse(&all).unwrap().filter.update, None);

    let with_map = edited(&text("log.yaml"), "  map_scans: [[0.0, 0.5]]\n", "");
    let with_map = edited(&with_map, "  map_resolution_m: 0.1\n", "");
    let scenario = parse(&format!("map: {{file: map.yaml}}\n{with_map}")).unwrap();
    assert_eq!(scenario.map_file(), Some(Path::new(FIXTURES).join("map.yaml").as_path()));
}

/// The simulator of a log's robot, on which `gap` and training without `train_scans` rest.
#[test]
fn a_log_may_have_a_simulator() {
    let simulator = "robot: {odometry_noise: {alpha: [0.1, 0.2, 0.3, 0.4]}}\nlaser: {rate_hz: 5, beams: 36, max_range_m: 4.5}\n\
                     effects: [{name: range_bias, bias_m: 0.02}]\n";
    let log = edited(&text("log.yaml"), "  train_scans: [[0.5, 0.6], [0.6, 0.75]]\n", "");
    let scenario = parse(&format!("{simulator}{log}")).unwrap();
    let found = scenario.simulator().unwrap();
    assert_eq!(found.odometry_noise.alpha(), [0.1, 0.2, 0.3, 0.4]);
    assert_eq!((found.laser.beams, found.effects.len(), found.blocks), (36, 1, None));
    assert_eq!(scenario.training.observations, 100, "simulated scans");
    assert_eq!(parse(&text("log.yaml")).unwrap().simulator(), None);
    assert!(parse(&text("minimal.yaml")).unwrap().simulator().is_some());
}

#[test]
fn numbers_and_anchors_are_read_as_yaml_means_them() {
    let text = edited(&text("minimal.yaml"), "max_range_m: 4.5", "max_range_m: +4.5e0, resolution_m: 1e-3");
    let text = edited(
        &text,
        "length_m: [0.2, 0.6], width_m: [0.2, 0.6]",
        "length_m: &side [0.2, .6], width_m: *side",
    );
    let scenario = parse(&text).unwrap();
    let Source::Simulation(simulation) = &scenario.source else { panic!() };
    assert_eq!((simulation.laser.max_range_m, simulation.laser.resolution_m), (4.5, 0.001));
    assert_eq!(simulation.blocks.as_ref().unwrap().width_m, [0.2, 0.6]);
}

#[test]
fn the_command_line_overrides_before_anything_is_checked() {
    let some = |labels: &[&str]| Some(labels.iter().map(|label| (*label).to_owned()).collect());
    let overrides = Overrides { trials: Some(4), seed: Some(9), models: some(&["oracle", "loaded"]) };
    let scenario = parse_with(&text("simulation.yaml"), &overrides).unwrap();
    assert_eq!((scenario.trials, scenario.seed), (4, 9));
    let labels: Vec<&str> = scenario.models.iter().map(|model| model.label.as_str()).collect();
    assert_eq!(labels, ["loaded", "oracle"]);
    assert_eq!(scenario.record.models, ["loaded"]);

    let overrides = Overrides { trials: Some(2), models: some(&["classic"]), ..Overrides::default() };
    let scenario = parse_with(&text("simulation.yaml"), &overrides).unwrap();
    assert_eq!(scenario.expect, []);
    assert_eq!(scenario.record, Record { trial: 1, models: vec!["classic".to_owned()] });
}

#[test]
fn a_map_may_be_its_file_alone() {
    let full = text("minimal.yaml");
    let short = edited(&full, "map: {file: map.yaml}", "map: map.yaml");
    let [full, short] = [full, short].map(|text| parse(&text).unwrap());
    assert_eq!(short.content_hash().unwrap(), full.content_hash().unwrap());
    // Sweeps name it by its long path, searches move it with the scenario.
    let folder = tempfile::tempdir().unwrap();
    let moved = short.text_in(&folder.path().canonicalize().unwrap());
    std::fs::write(folder.path().join("s.yaml"), &moved).unwrap();
    let template = Template::load(&folder.path().join("s.yaml")).unwrap();
    let other = json!(Path::new(FIXTURES).join("grid.yaml").canonicalize().unwrap());
    let other = template.with([("map.file", &other)], &Overrides::default()).unwrap();
    assert_ne!(other.content_hash().unwrap(), full.content_hash().unwrap());
    let error = parse(&edited(&full.text, "map: {file: map.yaml}", "map: nowhere.yaml")).unwrap_err();
    assert!(error.to_string().contains("map: `nowhere.yaml` is not allowed; there is no file"), "{error}");
}

#[test]
fn the_hash_sees_what_changes_results_and_nothing_else() {
    let simulation = text("simulation.yaml");
    let hash = |from: &str, to: &str| parse(&edited(&simulation, from, to)).unwrap().content_hash().unwrap();
    let original = parse(&simulation).unwrap().content_hash().unwrap();
    for (from, to) in [
        ("name: everything", "name: other"),
        ("description: every key", ""),
        ("trials: 20", "trials: 40"),
        ("trial: 3", "trial: 2"),
        ("lost_share: {max: 0}", "lost_share: {max: 1}"),
        ("alpha: [0.1, 0.05, 0.1, 0.05]", "alpha: [.1, .05, .1, 5e-2]"),
    ] {
        assert_eq!(hash(from, to), original, "{from} -> {to}");
    }
    for (from, to) in [
        ("seed: 7", "seed: 8"),
        ("[0.2, 0.6]", "[0.2, 0.7]"),
        ("beams: 12", "beams: 13"),
        ("p: 0.6", "p: 0.7"),
        ("wall: outline/2", "wall: outline/0"),
        ("exponent: 0.5", "exponent: 0.6"),
        ("file: fitted.model", "file: map.yaml"),
    ] {
        assert_ne!(hash(from, to), original, "{from} -> {to}");
    }
    // Without walls that are named, which an image doesn't have.
    let nameless: Vec<&str> = simulation.lines().filter(|line| !line.contains("wall: outline")).collect();
    let nameless = nameless.join("\n");
    let hash = |text: &str| parse(text).unwrap().content_hash().unwrap();
    assert_ne!(hash(&edited(&nameless, "file: map.yaml", "file: grid.yaml")), hash(&nameless));
}

#[test]
fn the_hash_sees_the_content_of_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scenario.yaml");
    std::fs::write(&path, edited(&text("minimal.yaml"), "map.yaml", "grid.yaml")).unwrap();
    for file in ["grid.yaml", "grid.pgm"] {
        std::fs::copy(Path::new(FIXTURES).join(file), folder.path().join(file)).unwrap();
    }
    let hash = || Scenario::load(&path, &Overrides::default()).unwrap().content_hash().unwrap();
    let original = hash();
    assert_eq!(original, hash());
    let image = folder.path().join("grid.pgm");
    let mut pixels = std::fs::read(&image).unwrap();
    *pixels.last_mut().unwrap() = 0;
    std::fs::write(&image, pixels).unwrap();
    assert_ne!(original, hash());
}

#[test]
fn every_error_names_file_line_key_value_and_what_is_allowed() {
    let mut messages = String::new();
    let mut tell = |name: &str, result: Result<Scenario, ScenarioError>| match result {
        Ok(_) => panic!("{name}: accepted"),
        Err(error) => writeln!(messages, "# {name}\n{error}\n").unwrap(),
    };
    for (name, fixture, from, to) in REFUSED {
        tell(name, parse(&edited(&text(fixture), from, to)));
    }
    tell("empty file", parse(""));
    tell("only a comment", parse("# nothing\n"));
    tell("a word", parse("scenario"));
    let overridden = |overrides| parse_with(&text("simulation.yaml"), &overrides);
    tell("--trials 0", overridden(Overrides { trials: Some(0), ..Overrides::default() }));
    let models = Some(vec!["p_reg".to_owned(), "lodaed".to_owned()]);
    tell("--models unknown", overridden(Overrides { models, ..Overrides::default() }));
    tell("--models of nothing", overridden(Overrides { models: Some(vec![]), ..Overrides::default() }));
    tell("no such file", Scenario::load(&Path::new(FIXTURES).join("nowhere.yaml"), &Overrides::default()));
    for map in
        ["map-nan.yaml", "map-open.yaml", "map-typo.yaml", "grid-no-image.yaml", "grid-resolution.yaml"]
    {
        tell(map, parse(&edited(&text("minimal.yaml"), "map.yaml", map)));
    }
    insta::assert_snapshot!("errors", messages);
}

#[test]
fn a_number_has_to_be_finite_wherever_it_stands() {
    let fixture = text("simulation.yaml");
    let mut tried = 0;
    for (start, _) in fixture.match_indices(|c: char| c.is_ascii_digit() || c == '-') {
        let end = start
            + fixture[start..].find(|c: char| !(c.is_ascii_digit() || "-.e".contains(c))).unwrap_or_default();
        let before = fixture[..start].chars().last().unwrap();
        if !" [".contains(before) || fixture[start..end].parse::<f64>().is_err() {
            continue;
        }
        for value in [".nan", ".inf", "-.inf"] {
            let text = format!("{}{value}{}", &fixture[..start], &fixture[end..]);
            assert!(
                parse(&text).is_err(),
                "accepted: {}",
                text[..start + value.len()].lines().last().unwrap()
            );
            tried += 1;
        }
    }
    assert!(tried > 150, "{tried}");
}

#[test]
fn values_that_would_overflow_later_are_refused() {
    for (fixture, from, to) in [
        ("simulation.yaml", "max_range_m: 4.5", "max_range_m: 1e300"),
        ("simulation.yaml", "max_range_m: 4.5", "max_range_m: 20000"),
        ("simulation.yaml", "alpha: [0.05, 0.02,", "alpha: [1e300, 0.02,"),
        ("simulation.yaml", "alpha: [0.1, 0.05,", "alpha: [1e300, 0.05,"),
        ("simulation.yaml", "speed_m_s: 0.5", "speed_m_s: 1e-300"),
        ("simulation.yaml", "turn_rate_deg_s: 45", "turn_rate_deg_s: 1e-300"),
        ("simulation.yaml", "rate_hz: 5", "rate_hz: 1e-300"),
        ("simulation.yaml", "rate_hz: 5", "rate_hz: 1e18"),
        ("simulation.yaml", "bin_m: 0.25", "bin_m: 1e-300"),
        ("simulation.yaml", "resolution_m: 1e-3", "resolution_m: 1e-310"),
        ("simulation.yaml", "sigma_m: 0.01, sigma_per_m", "sigma_m: 1e-300, sigma_per_m"),
        ("minimal.yaml", "secs: 4", "secs: 1e300"),
        ("minimal.yaml", "heading_deg: 180", "heading_deg: 1e300"),
    ] {
        let error = parse(&edited(&text(fixture), from, to)).unwrap_err();
        assert_told(&error);
        assert!(error.to_string().contains(" is not allowed; "), "{error}");
    }
}

#[test]
fn an_odometry_is_calibrated_on_a_log_alone() {
    let error = parse(&edited(&text("simulation.yaml"), "calibrate: false", "calibrate: true")).unwrap_err();
    assert_told(&error);
    assert!(error.to_string().contains("filter.motion.calibrate: true is not allowed"), "{error}");
}

#[test]
fn an_error_is_short_whatever_a_file_holds() {
    let long = "x".repeat(1_000_000);
    let minimal = text("minimal.yaml");
    let simulation = text("simulation.yaml");
    let escaped = "\"a\\n\\e[2J\\u202E\"";
    for word in [long.as_str(), escaped] {
        for (text, from, to) in [
            (&minimal, "seed: 1", format!("seed: {word}")),
            (&minimal, "seed: 1", format!("seed: 1\n? {word}\n: 2")),
            (&minimal, "seed: 1", format!("seed: 1\nname: {word}")),
            (&minimal, "map.yaml", word.to_owned()),
            (&minimal, "[classic]", format!("[{word}]")),
            (&minimal, "[classic]", format!("[{{name: classic, label: {word}}}]")),
            (&simulation, "outline/2", word.to_owned()),
            (&simulation, "name: range_bias", format!("name: {word}")),
            (&simulation, "lost_share", format!("? {word}\n    ")),
            (&simulation, "resampler: residual", format!("resampler: {word}")),
            (&minimal, "[classic]", format!("!<{word}> [classic]")),
        ] {
            let error = parse(&edited(text, from, &to)).unwrap_err().to_string();
            assert!(!error.contains(&"x".repeat(81)), "{error}");
            assert!(error.len() < 3000 && !error.contains(|c: char| c.is_control() && c != '\n'), "{error}");
            assert!(!error.contains('\u{202e}') && error.lines().count() < 4, "{error}");
        }
    }
    let many = format!("[{}]", vec!["{name: classic, floor: 2}"; 5000].join(", "));
    let error = parse(&edited(&minimal, "[classic]", &many)).unwrap_err().to_string();
    assert_eq!(error.lines().count(), 21, "{error}");
    assert!(error.ends_with(" more"), "{error}");
}

proptest! {
    /// A damaged file is refused or read, never a panic; what is wrong with a key has a line.
    #[test]
    fn damage_is_survived(
        fixture in prop::sample::select(vec!["simulation.yaml", "minimal.yaml", "log.yaml"]),
        at in any::<prop::sample::Index>(),
        cut in 0..40_usize,
        put in "[-\\[\\]{}:,#&*!|>'\"%@` \n\t0-9a-z.~é]{0,4}",
    ) {
        let mut text: Vec<char> = text(fixture).chars().collect();
        let at = at.index(text.len());
        let end = (at + cut).min(text.len());
        text.splice(at..end, put.chars());
        if let Err(ScenarioError::Invalid { problems, .. }) = parse(&text.into_iter().collect::<String>()) {
            prop_assert!(!problems.is_empty());
            for problem in problems {
                prop_assert!(problem.line.is_some() || problem.key.is_empty(), "{problem:?}");
            }
        }
    }
}

#[test]
fn no_number_and_no_key_of_a_shipped_scenario_can_do_harm() {
    let (mut refused, mut valid) = (0, 0);
    for path in shipped() {
        let text = std::fs::read_to_string(&path).unwrap();
        for text in hostile_texts(&text) {
            match Scenario::of_text(&path, &text, &Overrides::default()) {
                Ok(_) => valid += 1,
                Err(error) => {
                    assert_told(&error);
                    refused += 1;
                }
            }
        }
    }
    assert!(refused > 3000 && valid > 200, "{refused} {valid}");
}

pub(super) fn shipped() -> Vec<PathBuf> {
    let root = Path::new("../../scenarios");
    let mut files: Vec<PathBuf> = [root.to_owned(), root.join("real")]
        .iter()
        .flat_map(|folder| std::fs::read_dir(folder).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "yaml"))
        .collect();
    files.sort();
    assert!(files.len() >= 6, "{files:?}");
    files
}

#[test]
fn every_shipped_scenario_is_valid() {
    for path in shipped() {
        // Those of measured logs are validated by tests/measured_logs.rs.
        if path.components().any(|part| part.as_os_str() == "real") {
            continue;
        }
        let scenario = Scenario::load(&path, &Overrides::default()).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(Some(scenario.name.as_str()), path.file_stem().and_then(|stem| stem.to_str()));
        assert!(!scenario.description.is_empty(), "{}", path.display());
    }
}
