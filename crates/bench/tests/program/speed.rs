//! `locsim-bench speed` on a small folder of work, made here: all figures are there, and bad files are named.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::TempDir;

use crate::{bench, output};

const WORKLOAD: &str = r#"{
 "true_pose": [1.0, 1.0, 0.2],
 "max_range_m": 4.5,
 "n_beams": 8,
 "n_particles": 50,
 "sigma_xy": 0.1,
 "sigma_theta": 0.05,
 "sensor_pose": [0, 0, 0],
 "odom_delta_fullstep": [0.05, 0.0, 0.0],
 "alphas": [0.05, 0.02, 0.05, 0.01],
 "beam": {"z_hit": 0.7, "z_short": 0.15, "z_max": 0.1, "z_rand": 0.05, "sigma_hit": 0.1, "lambda_short": 0.5}
}"#;

/// Inner sides of the room's walls \[m\].
const ROOM: [f64; 2] = [3.0, 2.0];

/// A room of 3 m x 2 m, 8 beams, 50 particles, two drives of 6 steps along its middle.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, content: &[u8]| fs::write(folder.path().join(name), content).unwrap();
    let yaml = "image: map.pgm\nresolution: 0.1\norigin: [-0.2, -0.2, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\nnegate: 0\n";
    write("map.yaml", yaml.as_bytes());
    let (columns, rows) = (34, 24);
    let mut image = format!("P5\n{columns} {rows}\n255\n").into_bytes();
    for row in 0..rows {
        let wall = |i: i32, n: i32| i < 2 || i >= n - 2;
        image.extend(
            (0..columns).map(|column| if wall(column, columns) || wall(row, rows) { 0 } else { 254 }),
        );
    }
    write("map.pgm", &image);
    write("workload.json", WORKLOAD.as_bytes());
    let mut scan = "beam,angle_rad,range_exact_m,range_m\n".to_owned();
    for (beam, range) in ranges(1.0, 1.0, 0.2).into_iter().enumerate() {
        writeln!(scan, "{beam},{},{range},{range}", bearing(beam)).unwrap();
    }
    write("scan.csv", scan.as_bytes());
    let numbers = (0..50).flat_map(|i| [1.0 + 0.002 * f64::from(i), 1.0, 0.2]);
    write("particles_f64le.bin", &numbers.flat_map(f64::to_le_bytes).collect::<Vec<u8>>());
    let joined = |words: Vec<String>| words.join(",");
    let header = joined((0..8).map(|beam| format!("r{beam}")).collect());
    let mut drive = format!("step,gt_x,gt_y,gt_theta,odom_x,odom_y,odom_theta,{header}\n");
    for step in 0..6 {
        let x = 0.1 * f64::from(step);
        let readings = joined(ranges(1.0 + x, 1.0, 0.0).iter().map(f64::to_string).collect());
        writeln!(drive, "{step},{},1,0,{x},0,0,{readings}", 1.0 + x).unwrap();
    }
    write("traj_static.csv", drive.as_bytes());
    write("traj_dynamic.csv", drive.as_bytes());
    folder
}

fn bearing(beam: usize) -> f64 {
    beam as f64 * std::f64::consts::TAU / 8.0
}

/// Distances to the walls of the room.
fn ranges(x: f64, y: f64, theta: f64) -> Vec<f64> {
    (0..8)
        .map(|beam| {
            let (sin, cos) = (theta + bearing(beam)).sin_cos();
            let to = |at: f64, along: f64, end: f64| {
                if along.abs() < 1e-9 {
                    f64::INFINITY
                } else {
                    ((if along > 0.0 { end } else { 0.0 }) - at) / along
                }
            };
            to(x, cos, ROOM[0]).min(to(y, sin, ROOM[1])).min(4.5)
        })
        .collect()
}

#[test]
fn every_figure_is_measured_and_small_errors_are_found() {
    let folder = folder();
    let json = output(&bench(folder.path(), "speed . --json").success());
    let report: Value = serde_json::from_str(&json).unwrap();
    let models = ["classic", "beam_mixture", "p_reg", "np_reg", "np_reg_registered", "likelihood_field"];
    for model in models {
        for path in ["exact", "table", "table_2_threads"] {
            let time = &report["update_ns_per_particle_beam"][model][path];
            assert!(time.as_f64().unwrap() > 0.0, "{model} {path}: {time}");
        }
        for drive in ["static", "dynamic"] {
            let errors = &report["replay_ate_m"][drive][model];
            let [median, max] = ["median", "max"].map(|key| errors[key].as_f64().unwrap());
            // Six noiseless scans in a room of bare walls, from a known start.
            assert!(median <= max && max < 0.1, "{model} {drive}: {errors}");
            assert_eq!(errors["localized"], 10, "{model} {drive}: {errors}");
        }
    }
    for key in ["predict_ns", "resample_ns_10k", "resample_ns_1m", "estimate_ns", "step_ms", "table_build_s"]
    {
        assert!(report[key].as_f64().unwrap() > 0.0, "{key}: {}", report[key]);
    }
    for path in ["exact", "table"] {
        assert!(report["raycast_ns"][path].as_f64().unwrap() > 0.0);
    }
    for drive in ["static", "dynamic"] {
        assert!(report["global_localized"][drive].as_u64().unwrap() <= 10);
    }
    assert!(report["accuracy"]["range_m"]["mean"].as_f64().unwrap() < 0.05);
}

/// Standard error for the folder, which is refused with exit code 2.
fn refusal(folder: &Path) -> String {
    let call = bench(folder, "speed .").code(2);
    String::from_utf8(call.get_output().stderr.clone()).unwrap()
}

#[test]
fn bad_files_are_named_with_line_key_value_and_what_is_allowed() {
    let cases: [(&str, &str, &str, &str); 14] = [
        (
            "workload.json",
            "\"max_range_m\": 4.5",
            "\"max_range_m\": \"far\"",
            "workload.json:3: max_range_m: ",
        ),
        (
            "workload.json",
            "\"sigma_xy\": 0.1",
            "\"sigma_xy\": -0.1",
            "workload.json:6: sigma_xy: -0.1 is not allowed; a number from 0 to 1000",
        ),
        (
            "workload.json",
            "\"n_particles\": 50",
            "\"n_particles\": 49",
            "particles_f64le.bin: 1200 bytes are not allowed; 1176, as n_particles in workload.json is 49",
        ),
        (
            "scan.csv",
            "angle_rad",
            "angle_deg",
            "scan.csv:1: angle_rad: the column is missing; the header has beam",
        ),
        (
            "traj_dynamic.csv",
            "\n2,",
            "\n2,east",
            "traj_dynamic.csv:4: gt_x: east1.2 is not allowed; a number from -1000000 to 1000000",
        ),
        ("map.yaml", "resolution: 0.1", "resolution: 0", "map.yaml:2: resolution: "),
        (
            "workload.json",
            "[1.0, 1.0, 0.2]",
            "[1e300, 1.0, 0.2]",
            "workload.json:2: true_pose[0]: 1e300 is not allowed; a number from -1000000 to 1000000",
        ),
        (
            "workload.json",
            "[1.0, 1.0, 0.2]",
            "[1e5, 1.0, 0.2]",
            "workload.json:2: true_pose: [100000, 1] is not allowed; a point in the free space of map.yaml",
        ),
        (
            "workload.json",
            "[0.05, 0.02,",
            "[1e300, 0.02,",
            "workload.json:10: alphas[0]: 1e300 is not allowed; a number from 0 to 1000",
        ),
        (
            "workload.json",
            "\"n_particles\": 50",
            "\"n_particles\": 18446744073709551615",
            "workload.json:5: n_particles: 18446744073709551615 is not allowed; a whole number from 1 to 10000000",
        ),
        (
            "workload.json",
            "\"max_range_m\": 4.5",
            "\"max_range_m\": 1e300",
            "workload.json:3: max_range_m: inf is not allowed; a number from 0.001 to 10000",
        ),
        ("traj_static.csv", "\n2,1.2,", "\n2,1e300,", "traj_static.csv:4: gt_x: 1e300 is not allowed"),
        ("scan.csv", "\n0,0,", "\n0,1e300,", "scan.csv:2: angle_rad: 1e300 is not allowed"),
        ("scan.csv", "\n0,0,", "\n0,\u{1b}[2J,", "scan.csv:2: angle_rad: \\u{1b}[2J is not allowed"),
    ];
    for (name, from, to, expected) in cases {
        let folder = folder();
        let path = folder.path().join(name);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{name}: {from:?}");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let said = refusal(folder.path());
        assert!(said.contains(expected), "{name}: {said}");
    }
    // Numbers of particles that would leave the map's neighbourhood, and more of them than asked for.
    for (number, said) in [(1e300, "number 0 is 1e300"), (f64::NAN, "number 0 is NaN")] {
        let folder = folder();
        let mut bytes = fs::read(folder.path().join("particles_f64le.bin")).unwrap();
        bytes[..8].copy_from_slice(&number.to_le_bytes());
        fs::write(folder.path().join("particles_f64le.bin"), bytes).unwrap();
        assert!(refusal(folder.path()).contains(said), "{}", refusal(folder.path()));
    }
    let large = folder();
    fs::File::create(large.path().join("particles_f64le.bin")).unwrap().set_len(1 << 40).unwrap();
    assert!(refusal(large.path()).contains("1099511627776 bytes are not allowed; 1200, as n_particles"));
    let folder = folder();
    fs::remove_file(folder.path().join("traj_static.csv")).unwrap();
    assert!(refusal(folder.path()).contains("traj_static.csv: "));
}
