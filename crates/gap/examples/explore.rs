//! Explore: one hidden effect, one search.
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use locsim_core::{Drive, DriveStep, Pose2, Scan};
use locsim_gap::{GapOptions, Nominal, Recorded, find};
use locsim_world::effect::{Effect, EffectKind, Effects};
use locsim_world::map::VectorMap;
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::*;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let seed: u64 = args[1].parse().unwrap();
    let replicates: u32 = args[2].parse().unwrap();
    let cases: Vec<Vec<Effect>> = args[3..].iter().map(|case| case.split('+').filter(|a| !a.is_empty())
        .map(|a| {
            let (name, values) = a.split_once('=').unwrap();
            let kind: EffectKind = name.parse().unwrap();
            let values: Vec<f64> = values.split(',').map(|v| v.parse().unwrap()).collect();
            let place = if kind.has_place() {
                vec![[glam::DVec2::new(9.9, 0.0), glam::DVec2::new(4.3 + 0.9, 0.0)]]
            } else {
                vec![]
            };
            Effect::new(kind, values, place).unwrap()
        })
        .collect()).collect();
    let text = std::fs::read_to_string("maps/corridor.yaml").unwrap();
    let map: VectorMap = serde_yaml::from_str(&text).unwrap();
    let map = Arc::new(ExactRangeMap::new(map.to_geometry().unwrap()));
    let laser = LaserOptions {
        rate_hz: 10.0, beams: 72, field_of_view_rad: std::f64::consts::TAU, min_range_m: 0.05, max_range_m: 8.0,
        resolution_m: 0.001, sigma_m: 0.01, sigma_per_m: 0.0, mount: Pose2::new(0.1, 0.0, 0.0), scan_secs: 0.0,
    };
    let blocks = BlockOptions {
        per_metre_of_wall: 0.5, length_m: [0.15, 0.35], width_m: [0.1, 0.25], yaw_rad: [-0.5, 0.5],
        wall_distance_m: [0.0, 0.2], resample: BlockResampling::EachObservation, speed_m_s: [0.0; 2], clearance_m: 0.35,
    };
    let base = Effects::new(vec![
        Effect::new(EffectKind::RangeDropout, vec![0.005, 0.0], vec![]).unwrap(),
        Effect::new(EffectKind::Crosstalk, vec![0.003, 1.0], vec![]).unwrap(),
    ]).unwrap();
    let odometry = OdometryNoise::new([0.02, 0.005, 0.01, 0.005]).unwrap();
    let start = Instant::now();
    let nominal = Nominal::new(Arc::clone(&map), laser, Some(blocks), odometry, base.clone(), 1).unwrap();
    println!("nominal {:?}", start.elapsed());
    let path = RobotPath::Waypoints {
        points_m: vec![[1.5, 1.5], [8.0, 2.5], [12.0, 1.4], [18.5, 2.2], [16.0, 2.9], [11.0, 2.0], [3.0, 2.4]],
        speed_m_s: 0.7, turn_rate_rad_s: 0.8,
    };
    let robot = Robot { path, start_jitter_m: 0.1, odometry_noise: odometry };
    for hidden in cases {
    println!("================ {:?}", hidden.iter().map(|e| (e.kind, &e.values)).collect::<Vec<_>>());
    let effects = Effects::new([base.list(), &hidden].concat()).unwrap();
    let simulator = Simulator::new(Arc::clone(&map), Some(blocks), laser, effects).unwrap();
    let drive = simulate_drive(&simulator, &robot, seed).unwrap().drive;
    let drive = Drive { laser: drive.laser, steps: drive.steps.into_iter().take(600).map(|s| DriveStep { scan: Scan { ranges: s.scan.ranges }, ..s }).collect() };
    println!("scans {}", drive.steps.len());
    let recorded = Recorded::new(&drive, 600, 72, |_| true).unwrap();
    let start = Instant::now();
    let options = GapOptions { replicates, seed: 7, ..GapOptions::default() };
    let outcome = find(&nominal, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
    println!("{:?} {:?}", start.elapsed(), outcome.verdict);
    println!("{:?}\nafter {:?}\n{:?}", outcome.detection, outcome.detection_after, outcome.nuisances);
    for named in &outcome.effects {
        println!("NAMED {} {:?}\n   {:?}\n   {:?} {:?}", named.name, named.params, named.candidates, named.evidence, named.place);
    }
    for r in &outcome.rivals {
        println!("  rival {} {} gain {:.1} behind {:.1} [{:.1}, {:.1}]", r.round, r.name, r.gain_nats.value, r.behind_nats.value, r.behind_nats.lo, r.behind_nats.hi);
    }
    println!("{:?}", outcome.gap);
    for r in outcome.regions.iter().take(6) {
        println!("  {:?} {:.2}..{:.2} {:?} z {:.1} w1 {:.1} mm q {:.3} remains {}", r.covariate, r.lo, r.hi, r.deviation, r.z, r.w1_mm, r.q, r.remains);
    }
    }
}
