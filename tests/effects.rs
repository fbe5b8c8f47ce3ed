//! Effects as a user meets them: the list, the page of one, scenarios that have some.

mod common;

use common::{Folder, SCENARIO, edited, output};
use predicates::str::{contains, is_empty};
use serde_json::Value;

/// The scenario with effects.
fn with_effects(effects: &str) -> String {
    edited(SCENARIO, "training:", &format!("effects: [{effects}]\ntraining:"))
}

#[test]
fn the_list_names_every_effect_with_its_parameters() {
    let folder = Folder::new();
    let list = output(&folder.locsim("effects").success());
    for words in
        ["range_bias", "bias_m [m]", "angle_deg [deg]", "turn_deg_per_m [deg/m]", "wheel_slip", "wall, p"]
    {
        assert!(list.contains(words), "{words} is not in\n{list}");
    }
    assert!(list.lines().all(|line| line.chars().count() <= 110), "{list}");
}

#[test]
fn the_page_of_an_effect_says_what_it_is_and_what_looks_like_it() {
    let folder = Folder::new();
    let page = output(&folder.locsim("effects incidence_dropout").success());
    assert_eq!(
        page,
        "incidence_dropout (beam)\n\n\
         Slanted walls often send nothing back.\n\n\
         definition      P(no return) = p / (1 + exp(-(alpha - angle_deg) / width_deg)), on walls\n\
         gives it away   missing returns that set in at an incidence\n\
         looks like      range_dropout, glass\n\n\
         p               0 to 1, such as 0.5\n\
         angle_deg       0 to 90 deg, such as 68.755\n\
         width_deg       0.057 to 57.296 deg, such as 2.865; default 3\n"
    );
    folder.locsim("effects glass").success().stdout(contains("name of a wall of a vector map"));
    folder.locsim("effects glas").code(2).stdout(is_empty()).stderr(contains(
        "error: `glas` is not an effect; did you mean `glass`? allowed: range_bias, range_scale,",
    ));
}

#[test]
fn a_simulated_log_has_the_effects_of_its_scenario() {
    let folder = Folder::new();
    let log = |name: &str, effects: &str| {
        folder.write(&format!("{name}.yaml"), with_effects(effects));
        folder.locsim(&format!("simulate {name}.yaml --out {name}.log")).success();
        folder.read(&format!("{name}.log"))
    };
    folder.locsim("simulate room-run.yaml --out nominal.log").success();
    let nominal = folder.read("nominal.log");
    assert_eq!(log("none", ""), nominal);
    assert_eq!(log("neutral", "{name: range_bias, bias_m: 0}, {name: glass, wall: room/0, p: 0}"), nominal);
    assert_ne!(log("biased", "{name: range_bias, bias_m: 0.05}"), nominal);
    assert_ne!(log("glass", "{name: glass, wall: room/0, p: 0.8}"), nominal);
    assert_ne!(log("odometry", "{name: odom_distance_scale, k: 0.1}"), nominal);
}

#[test]
fn a_run_localizes_in_the_world_with_effects() {
    let folder = Folder::new();
    let rmse = |text: &str| {
        folder.write("s.yaml", text);
        let call =
            folder.locsim("run s.yaml --trials 1 --models classic --record none --json --force").success();
        let summary: Value = serde_json::from_str(&output(&call)).unwrap();
        summary["models"]["classic"]["position_rmse_m"].as_f64().unwrap()
    };
    let nominal = rmse(SCENARIO);
    assert_eq!(rmse(&with_effects("{name: mount_yaw, yaw_deg: 0}")), nominal);
    // Models learn ranges, not where the laser points.
    let turned = rmse(&with_effects("{name: mount_yaw, yaw_deg: 25}"));
    assert!(turned > 1.5 * nominal, "{turned} {nominal}");
}

#[test]
fn effects_that_make_no_sense_are_refused() {
    let folder = Folder::new();
    for (effects, message) in [
        (
            "{name: glas, p: 0.5}",
            "s.yaml:12: effects[0].name: `glas` is not allowed; did you mean `glass`? allowed: range_bias,",
        ),
        ("{name: heavy_tail, p: 2}", "s.yaml:12: effects[0].p: 2 is not allowed; a number from 0 to 1"),
        (
            "{name: heavy_tail, share: 1}",
            "s.yaml:12: effects[0].share: `share` is not a key of `heavy_tail`; allowed: name, p",
        ),
        (
            "{name: glass, p: 1, wall: room/9}",
            "s.yaml:12: effects[0].wall: `room/9` is not a wall of the map; did you mean `room/0`?",
        ),
    ] {
        folder.write("s.yaml", with_effects(effects));
        folder.locsim("run s.yaml").code(2).stdout(is_empty()).stderr(contains(message));
    }
}
