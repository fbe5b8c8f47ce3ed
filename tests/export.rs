//! `locsim export` as a user types it.

mod common;

use common::{Folder, edited, output};
use predicates::str::contains;

/// A laser with effects that formats have, and effects that they haven't.
const EFFECTS: &str = "effects:
  - {name: range_bias, bias_m: 0.03}
  - {name: mount_yaw, yaw_deg: 3}
  - {name: quantization, step_m: 0.01}
  - {name: incidence_dropout, p: 0.4, angle_deg: 60}
training:";

fn folder() -> Folder {
    let folder = Folder::new();
    let laser = "{rate_hz: 5, beams: 12, max_range_m: 3, noise: {sigma_m: 0.02}";
    let scenario = edited(common::SCENARIO, laser, &laser.replace("0.02", "0.02, sigma_per_m: 0.001"));
    let scenario = edited(&scenario, "0.001}}", "0.001}, mount: {x_m: 0.1}}");
    std::fs::create_dir(folder.path("found")).unwrap();
    folder.write(
        "found/scenario.yaml",
        edited(&scenario, "map: {file: room", "map: {file: ../room").replace("training:", EFFECTS),
    );
    folder
}

#[test]
fn a_simulators_sensor_has_the_effects_that_its_format_can_have() {
    let folder = folder();
    for (format, said, left, golden) in [
        (
            "sdf",
            "range_bias: <noise><mean>\n  mount_yaw: <pose>",
            "quantization, incidence_dropout",
            include_str!("data/lidar.sdf"),
        ),
        (
            "stage",
            "mount_yaw: pose",
            "range_bias, quantization, incidence_dropout",
            include_str!("data/lidar.inc"),
        ),
        (
            "webots",
            "mount_yaw: translation, rotation\n  quantization: resolution",
            "range_bias, incidence_dropout",
            include_str!("data/lidar.wbt"),
        ),
    ] {
        let call = folder.locsim(&format!("export {format} found -o lidar")).success();
        let printed = output(&call);
        assert!(printed.contains(said), "{printed}");
        for kind in left.split(", ") {
            assert!(printed.contains(&format!("  {kind}: left to `locsim apply`")), "{printed}");
        }
        let written = String::from_utf8(folder.read("lidar")).unwrap();
        if std::env::var_os("LOCSIM_GOLDEN").is_some() {
            let name = match format {
                "sdf" => "lidar.sdf",
                "stage" => "lidar.inc",
                _ => "lidar.wbt",
            };
            std::fs::write(format!("{}/../../tests/data/{name}", env!("CARGO_MANIFEST_DIR")), &written)
                .unwrap();
        }
        assert_eq!(written, golden, "{format}");
        std::fs::remove_file(folder.path("lidar")).unwrap();
    }
}

/// What is left is applied by the command that is printed: the file's effects and those of `apply` are all there are, none twice.
#[test]
fn what_is_left_is_applied_by_the_command_that_is_printed() {
    let folder = folder();
    let printed = output(&folder.locsim("export sdf found/scenario.yaml -o lidar.sdf").success());
    let command = printed.split('`').find(|part| part.starts_with("locsim apply found")).unwrap();
    assert_eq!(
        command,
        "locsim apply found/scenario.yaml --without range_bias,mount_yaw --in RECORDING --out worse.mcap"
    );
    folder.locsim("simulate room-run.yaml --out perfect.mcap").success();
    let command = command.trim_start_matches("locsim ").replace("RECORDING", "perfect.mcap");
    assert_eq!(
        output(&folder.locsim(&command).success()),
        "worse.mcap: 21 scans\n  quantization: readings\n  incidence_dropout: readings, by the map\n"
    );
    folder
        .locsim("export sdf found -o lidar.sdf")
        .code(2)
        .stderr(contains("it exists (--force replaces it)"));
    folder
        .locsim("export sdf found -o found/scenario.yaml --force")
        .code(2)
        .stderr(contains("this command reads it"));
}

/// The room with a drive to and fro: 8 m, which tell the noise of its odometry.
fn to_and_fro() -> Folder {
    let folder = Folder::new();
    let path = "[[0.6, 0.9], [2.6, 0.9]]";
    let longer = "[[0.6, 0.9], [2.6, 0.9], [0.6, 0.9], [2.6, 0.9], [0.6, 0.9]]";
    folder.write("room-run.yaml", edited(common::SCENARIO, path, longer));
    folder
}

#[test]
fn exported_parameters_of_amcl_are_those_of_a_run() {
    let folder = to_and_fro();
    let command = "export nav2 room-run.yaml -o amcl.yaml --evaluations 16 --trials 3";
    let printed = output(&folder.locsim(&format!("{command} --threads 1")).success());
    assert!(printed.contains("nav2's defaults") && printed.contains("exported"), "{printed}");
    let files = ["amcl.yaml", "amcl.beluga.yaml", "amcl.report.md", "amcl.report.html"];
    let first = files.map(|file| folder.read(file));
    folder.locsim(command).code(2).stderr(contains("it exists (--force replaces it)"));
    folder.locsim(&format!("{command} --threads 2 --force --quiet")).success();
    assert_eq!(first, files.map(|file| folder.read(file)), "the same bytes on any number of threads");
    let text = String::from_utf8(folder.read("amcl.yaml")).unwrap();
    assert!(text.contains("\namcl:\n  ros__parameters:\n"), "{text}");
    let value = |name: &str| {
        let line = text.lines().find(|line| line.trim_start().starts_with(&format!("{name}: ")));
        let line = line.unwrap_or_else(|| panic!("{name} is not in {text}"));
        let (value, origin) = line.split_once(": ").unwrap().1.split_once(" # ").unwrap();
        assert!(!origin.is_empty(), "{line}");
        value.trim().to_owned()
    };
    // Of ROS 2, a float has a point, and a whole number none.
    for name in ["z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short", "alpha1", "alpha5"] {
        assert!(value(name).contains('.') && value(name).parse::<f64>().is_ok(), "{name}: {}", value(name));
    }
    assert!(value("max_beams").parse::<u32>().unwrap() >= 2);
    assert_eq!(value("laser_max_range"), "3.0");
    // The file is a model of a scenario.
    let kind = value("laser_model_type").replace('"', "");
    let models =
        format!("models: [{{name: amcl_{kind}, file: amcl.yaml}}, amcl_likelihood_field_prob, amcl_beam]");
    let models = models
        .replace("name: amcl_likelihood_field_prob", "label: exported, name: amcl_likelihood_field_prob");
    let models = models.replace("name: amcl_beam", "label: exported, name: amcl_beam");
    folder.write("run.yaml", edited(common::SCENARIO, "models: [classic, np_reg_registered]", &models));
    folder.locsim("run run.yaml --record none --out results").success();
    let other = if kind == "beam" { "likelihood_field" } else { "beam" };
    let wrong = format!("models: [{{name: amcl_{other}, file: amcl.yaml}}]");
    folder.write("run.yaml", edited(common::SCENARIO, "models: [classic, np_reg_registered]", &wrong));
    for command in ["validate run.yaml", "run run.yaml --out wrong"] {
        let refused = format!("has laser_model_type `{kind}`, the scenario asks for amcl_{other}");
        folder.locsim(command).code(2).stderr(contains(refused));
    }
}

/// A log is cut as `locsim inspect` proposes; its name has endings and a sign.
#[test]
fn parameters_are_searched_on_a_log_without_a_scenario() {
    let folder = to_and_fro();
    let long = String::from_utf8(folder.read("room-run.yaml")).unwrap();
    folder.write("long.yaml", edited(&long, "speed_m_s: 0.5", "speed_m_s: 0.15"));
    folder.locsim("simulate long.yaml --out my~drive.log.gz").success();
    folder.locsim("export nav2 my~drive.log.gz -o amcl.yaml --evaluations 16 --trials 2 --quiet").success();
    let text = String::from_utf8(folder.read("amcl.yaml")).unwrap();
    assert!(text.starts_with("# Parameters of nav2's AMCL, found by locsim on my_drive:"), "{text}");
}

/// The folder of a run has its scenario: 2 m of drive, six of which tell the odometry's noise together.
#[test]
fn the_results_of_a_run_are_a_source() {
    let folder = Folder::new();
    folder.write("room-run.yaml", common::SCENARIO);
    folder.locsim("run room-run.yaml --quiet --record none --trials 1 --out results/room").success();
    let options = "--evaluations 16 --trials 2 --quiet";
    folder.locsim(&format!("export nav2 results/room -o of-results.yaml {options}")).success();
    folder.locsim(&format!("export nav2 room-run.yaml -o of-scenario.yaml {options}")).success();
    let parameters = |name: &str| {
        let text = String::from_utf8(folder.read(name)).unwrap();
        text.split_once("\namcl:\n").unwrap().1.to_owned()
    };
    assert_eq!(parameters("of-results.yaml"), parameters("of-scenario.yaml"));
    folder.locsim("export sdf results/room -o lidar.sdf").success();
    // As it is, from its place.
    folder.locsim("run results/room/scenario.yaml --quiet --record none --trials 1 --out again").success();
    assert_eq!(folder.read("again/steps.csv"), folder.read("results/room/steps.csv"));
}

#[test]
fn what_nav2_parameters_cannot_be_searched_on_is_refused() {
    let folder = to_and_fro();
    folder.write("other.txt", "no log");
    folder.write(
        "floor.yaml",
        edited(
            common::SCENARIO,
            "models: [classic, np_reg_registered]",
            "models: [{name: amcl_beam, exponent: 0.5}]",
        ),
    );
    for (line, message) in [
        ("room-run.yaml --evaluations 3", "'--evaluations <EVALUATIONS>': a whole number from 16 to 100000"),
        ("room-run.yaml --trials 1", "'--trials <TRIALS>': a whole number from 2 to 100000"),
        ("nothing.yaml", "nothing.yaml: cannot be read"),
        ("nothing.mcap", "nothing.mcap: cannot be read"),
        ("other.txt", "other.txt"),
        ("floor.yaml", "models[0].exponent: the key is not allowed here; AMCL has none"),
    ] {
        folder.locsim(&format!("export nav2 {line} -o amcl.yaml")).code(2).stderr(contains(message));
        assert!(!folder.path("amcl.yaml").exists());
    }
    // Six drives of 0.4 m are too short.
    folder.write("short.yaml", edited(common::SCENARIO, "[2.6, 0.9]", "[1.0, 0.9]"));
    folder
        .locsim("export nav2 short.yaml -o amcl.yaml --evaluations 16")
        .code(2)
        .stderr(contains("too few metres of odometry with reference poses"));
    folder
        .locsim("export nav2 room-run.yaml -o room-run.yaml --force")
        .code(2)
        .stderr(contains("this command reads it"));
}
