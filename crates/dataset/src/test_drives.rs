use locsim_core::{Drive, DriveStep, Laser, Pose2, Scan};
use proptest::prelude::*;

/// Any pose within a kilometre.
pub fn pose() -> impl Strategy<Value = Pose2> {
    (-1e3..1e3f64, -1e3..1e3f64, -3.2..3.2f64).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
}

/// Any drive that a log can hold.
pub fn drive() -> impl Strategy<Value = Drive> {
    let laser = (1..40_usize, -3.0..3.0f64, -0.1..0.1f64, 0.0..0.5f32, 1.0..90.0f32, 0.0..1e-3f32, pose());
    let laser = laser.prop_map(|(n, start, step, min, max, interval, mount)| {
        let bearings = (0..n).map(|i| (start + i as f64 * step) as f32).collect();
        Laser::new(bearings, (0..n).map(|i| i as f32 * interval).collect(), min, max, mount).unwrap()
    });
    (laser, 1..8_usize, 0.0..2e9f64).prop_flat_map(|(laser, count, start)| {
        let (min, max) = (laser.min_range(), laser.max_range());
        let range = prop_oneof![4 => min.max(1e-3)..max, 1 => Just(max), 1 => Just(f32::NAN)];
        let ranges = prop::collection::vec(range, laser.beam_count());
        let step = (0.0..10.0f64, pose(), prop::option::of(pose()), ranges);
        prop::collection::vec(step, count).prop_map(move |steps| {
            let mut stamp_secs = start;
            let steps = steps.into_iter().map(|(dt, odometry, reference, ranges)| {
                stamp_secs += dt;
                DriveStep { stamp_secs, odometry, reference, scan: Scan { ranges } }
            });
            Drive { laser: laser.clone(), steps: steps.collect() }
        })
    })
}

/// Bits of a scan's readings: unlike NaN values, those of NaN are equal.
pub fn bits(scan: &Scan) -> Vec<u32> {
    scan.ranges.iter().map(|r| r.to_bits()).collect()
}
