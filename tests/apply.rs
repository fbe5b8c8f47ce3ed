//! `locsim apply` as a user types it: a scenario's effects on a recording, and `locsim gap`, which finds them again.

mod common;

use common::{Folder, edited, output};
use predicates::str::contains;
use serde_json::Value;

/// A robot in a corridor as its developers think it is.
const NOMINAL: &str = include_str!("../scenarios/gap/nominal.yaml");

/// What its laser does anyway, and a perfect simulation doesn't.
const USUAL: &str = "  - {name: range_dropout, p: 0.005, exponent: 0}
  - {name: crosstalk, p: 0.003, share: 1}
";

/// An effect with numbers that are plain on the drive of the corridor, and those of them that the search has to find.
struct Case {
    effect: &'static str,
    /// Parameter, value, and how far the answer may be off.
    numbers: &'static [(&'static str, f64, f64)],
}

impl Case {
    fn name(&self) -> &'static str {
        self.effect.trim_start_matches("{name: ").split(',').next().unwrap()
    }
}

const CASES: [Case; 26] = [
    Case { effect: "{name: range_bias, bias_m: 0.03}", numbers: &[("bias_m", 0.03, 0.004)] },
    Case { effect: "{name: range_scale, k: 0.02}", numbers: &[("k", 0.02, 0.004)] },
    Case { effect: "{name: incidence_bias, bias_m: 0.02}", numbers: &[("bias_m", 0.02, 0.003)] },
    Case { effect: "{name: range_noise, growth: 0.003}", numbers: &[("growth", 0.003, 0.001)] },
    Case { effect: "{name: incidence_noise, growth: 2}", numbers: &[("growth", 2.0, 0.4)] },
    Case { effect: "{name: heavy_tail, p: 0.2}", numbers: &[("p", 0.2, 0.03)] },
    Case {
        effect: "{name: incidence_dropout, p: 0.4, angle_deg: 60}",
        numbers: &[("p", 0.4, 0.06), ("angle_rad", 1.047, 0.06)],
    },
    Case {
        effect: "{name: range_dropout, p: 0.5, exponent: 3}",
        numbers: &[("p", 0.5, 0.15), ("exponent", 3.0, 1.0)],
    },
    Case { effect: "{name: mixed_pixels, p: 0.6}", numbers: &[("p", 0.6, 0.15)] },
    Case { effect: "{name: glass, p: 0.6, wall: south-2}", numbers: &[("p", 0.6, 0.1)] },
    Case {
        effect: "{name: moved_wall, distance_m: 0.05, wall: south-2}",
        numbers: &[("distance_m", 0.05, 0.015)],
    },
    Case {
        effect: "{name: missing_object, x_m: 10, y_m: 1.2, radius_m: 0.15}",
        numbers: &[("x_m", 10.0, 0.1), ("y_m", 1.2, 0.1), ("radius_m", 0.15, 0.05)],
    },
    Case { effect: "{name: mount_yaw, yaw_deg: 3}", numbers: &[("yaw_rad", 0.05236, 0.006)] },
    Case { effect: "{name: mount_offset, x_m: 0.06}", numbers: &[("x_m", 0.06, 0.01)] },
    Case { effect: "{name: time_offset, delay_secs: 0.1}", numbers: &[("delay_secs", 0.1, 0.02)] },
    Case { effect: "{name: motion_skew, sweep_secs: -0.1}", numbers: &[("sweep_secs", -0.1, 0.02)] },
    Case {
        effect: "{name: warmup_drift, bias_m: 0.06, tau_secs: 8}",
        numbers: &[("bias_m", 0.06, 0.012), ("tau_secs", 8.0, 3.0)],
    },
    Case {
        effect: "{name: sector_occlusion, from_deg: 50, to_deg: 80, range_m: 0.4, p: 0.6}",
        numbers: &[("p", 0.6, 0.1), ("range_m", 0.4, 0.02)],
    },
    Case { effect: "{name: crosstalk, p: 0.3, share: 0.3}", numbers: &[("p", 0.3, 0.1)] },
    Case { effect: "{name: quantization, step_m: 0.05}", numbers: &[("step_m", 0.05, 0.001)] },
    Case { effect: "{name: block_density, factor: 3}", numbers: &[("factor", 3.0, 0.7)] },
    Case { effect: "{name: block_depth, factor: 2}", numbers: &[("factor", 2.0, 0.3)] },
    Case { effect: "{name: odom_distance_scale, k: 0.1}", numbers: &[("k", 0.1, 0.03)] },
    Case { effect: "{name: odom_turn_scale, k: 0.2}", numbers: &[("k", 0.2, 0.06)] },
    Case { effect: "{name: odom_imbalance, turn_deg_per_m: 6}", numbers: &[("turn_per_m", 0.1047, 0.03)] },
    Case { effect: "{name: wheel_slip, p: 0.2, share: 0.6}", numbers: &[("p", 0.2, 0.1)] },
];

/// A folder with the nominal scenario, the same without effects, and a recording of that perfect simulation.
fn folder(perfect: &str) -> Folder {
    let folder = Folder::new();
    let maps = concat!(env!("CARGO_MANIFEST_DIR"), "/../../maps/corridor.yaml");
    let nominal = edited(NOMINAL, "../../maps/corridor.yaml", maps);
    folder.write("nominal.yaml", &nominal);
    let usual = format!("effects: # every real laser does both\n{USUAL}");
    folder.write("perfect.yaml", edited(&nominal, &usual, ""));
    folder.locsim(&format!("simulate perfect.yaml --seed 11 --out {perfect}")).success();
    folder
}

/// Applies a case to the perfect recording, and searches for it with these options. The answer, and what is wrong with it.
fn search(folder: &Folder, case: &Case, perfect: &str, worse: &str, options: &str) -> (Value, Vec<String>) {
    let nominal = String::from_utf8(folder.read("nominal.yaml")).unwrap();
    let hidden = format!("{USUAL}  - {}\n", case.effect);
    folder.write("hidden.yaml", edited(&nominal, USUAL, &hidden));
    folder.locsim(&format!("apply hidden.yaml --in {perfect} --out {worse} --force")).success();
    // The recording says that the laser sits elsewhere or that a sweep takes its time, and so does the scenario of whoever believes it.
    let believed = match case.name() {
        "mount_yaw" => edited(&nominal, "mount: {x_m: 0.1}", "mount: {x_m: 0.1, yaw_deg: -3}"),
        "mount_offset" => edited(&nominal, "mount: {x_m: 0.1}", "mount: {x_m: 0.04}"),
        "motion_skew" => edited(&nominal, "  rate_hz: 10\n", "  rate_hz: 10\n  scan_secs: 0.1\n"),
        _ => nominal,
    };
    folder.write("believed.yaml", believed);
    let line =
        format!("gap believed.yaml --log {worse} --out found --force --no-filter --json --quiet {options}");
    let outcome: Value = serde_json::from_str(&output(&folder.locsim(&line).success())).unwrap();
    let mut wrong = Vec::new();
    let found = &outcome["effects"][0];
    if found["name"] != case.name() || outcome["effects"].as_array().is_none_or(|effects| effects.len() != 1)
    {
        wrong.push(format!(
            "named {:?}",
            outcome["effects"].as_array().map(|effects| {
                effects.iter().map(|effect| effect["name"].to_string()).collect::<Vec<_>>()
            })
        ));
    }
    for (parameter, value, off) in case.numbers {
        let number = found["params"][parameter]["value"].as_f64().unwrap_or(f64::NAN);
        if number.is_nan() || (number - value).abs() > *off {
            wrong.push(format!("{parameter} = {number}"));
        }
    }
    (outcome, wrong)
}

/// Stamps in a bag, and lost returns by the map in a CARMEN log; the others are searched for by hand, below.
#[test]
fn effects_applied_to_a_perfect_recording_are_found_again() {
    for (perfect, worse, name) in
        [("perfect.mcap", "worse.mcap", "time_offset"), ("perfect.log", "worse.log.gz", "incidence_dropout")]
    {
        let folder = folder(perfect);
        for case in CASES.iter().filter(|case| case.name() == name) {
            let (outcome, wrong) =
                search(&folder, case, perfect, worse, "--replicates 19 --scans 300 --beams 36");
            assert!(wrong.is_empty(), "{}: {wrong:?} {:#}", case.effect, outcome["effects"]);
        }
    }
}

/// Run by hand: `cargo test -p locsim --test apply -- --ignored --nocapture` prints the table of docs/simulators.md.
#[test]
#[ignore = "20 minutes or more: 26 searches"]
fn all_effects_applied_to_a_perfect_recording_are_found_again() {
    let folder = folder("perfect.mcap");
    let mut failed = Vec::new();
    println!("| effect | found | numbers |\n| --- | --- | --- |");
    for case in &CASES {
        let (outcome, wrong) = search(&folder, case, "perfect.mcap", "worse.mcap", "--replicates 99");
        let effects = outcome["effects"].as_array().cloned().unwrap_or_default();
        let names: Vec<&str> = effects.iter().filter_map(|effect| effect["name"].as_str()).collect();
        let numbers = case.numbers.iter().map(|(name, _, _)| {
            let number = &effects.first().map_or(Value::Null, |effect| effect["params"][name].clone());
            let part = |key: &str| number[key].as_f64().unwrap_or(f64::NAN);
            format!("{name} = {:.4} [{:.4}, {:.4}]", part("value"), part("lo"), part("hi"))
        });
        let numbers: Vec<String> = numbers.collect();
        println!("| `{}` | {} | {} |", case.effect, names.join(", "), numbers.join(", "));
        if !wrong.is_empty() {
            failed.push((case.effect, wrong));
        }
    }
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn the_same_input_gives_the_same_bytes_and_nothing_is_overwritten() {
    let folder = Folder::new();
    folder.locsim("simulate room-run.yaml --out in.mcap").success();
    let effects = "effects: [{name: range_bias, bias_m: 0.1}, {name: heavy_tail, p: 0.3}, {name: odom_turn_scale, k: 0.1}]";
    folder.write("worse.yaml", edited(common::SCENARIO, "training:", &format!("{effects}\ntraining:")));
    let said = output(&folder.locsim("apply worse.yaml --in in.mcap --out a.mcap").success());
    assert_eq!(
        said,
        "a.mcap: 21 scans\n  range_bias: readings\n  heavy_tail: readings\n  odom_turn_scale: odometry\n"
    );
    folder.locsim("apply worse.yaml --in in.mcap --out b.mcap").success();
    assert_eq!(folder.read("a.mcap"), folder.read("b.mcap"));
    folder.locsim("apply worse.yaml --in in.mcap --out c.mcap --seed 9").success();
    assert_ne!(folder.read("a.mcap"), folder.read("c.mcap"));
    let refused = |line: &str, words: &str| {
        folder.locsim(line).code(2).stderr(contains(words));
    };
    refused("apply worse.yaml --in in.mcap --out a.mcap", "it exists (--force replaces it)");
    refused("apply worse.yaml --in in.mcap --out in.mcap --force", "this command reads it");
    refused("apply room-run.yaml --in in.mcap --out d.mcap", "no effect is left to apply");
}

#[test]
fn effects_that_need_the_map_need_the_robots_pose() {
    let folder = Folder::new();
    folder.locsim("simulate room-run.yaml --out in.log").success();
    let text = String::from_utf8(folder.read("in.log")).unwrap();
    let blind: String = text.split_inclusive('\n').filter(|line| !line.starts_with("TRUEPOS")).collect();
    folder.write("blind.log", blind);
    let with = |effects: &str| {
        folder.write(
            "worse.yaml",
            edited(common::SCENARIO, "training:", &format!("effects: [{effects}]\ntraining:")),
        );
    };
    with("{name: glass, wall: room/0, p: 1}, {name: incidence_dropout, p: 0.5, angle_deg: 60}");
    folder.locsim("apply worse.yaml --in blind.log --out worse.log").code(2).stderr(contains(
        "glass, incidence_dropout act by the map and the robot's pose, and no scan has a reference pose",
    ));
    folder.locsim("apply worse.yaml --in in.log --out worse.log").success();
    // Others do without.
    with("{name: range_bias, bias_m: 0.25}");
    folder.locsim("apply worse.yaml --in blind.log --out biased.log").success();
    let ranges = |name: &str| -> Vec<f32> {
        let text = String::from_utf8(folder.read(name)).unwrap();
        let scans = text.lines().filter(|line| line.starts_with("ROBOTLASER1"));
        scans
            .flat_map(|line| {
                line.split(' ').skip(9).take(12).map(|z| z.parse().unwrap()).collect::<Vec<f32>>()
            })
            .collect()
    };
    let (before, after) = (ranges("blind.log"), ranges("biased.log"));
    assert_eq!(before.len(), 21 * 12);
    for (before, after) in before.iter().zip(after) {
        let expected = if *before >= 3.0 { 3.0 } else { (before + 0.25).min(3.0) };
        assert!((after - expected).abs() < 1e-5, "{before} {after}");
    }
}
