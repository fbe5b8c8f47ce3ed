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
