//! Cost of a ray: 10,000 poses x 60 beams in a corridor, exact and from the table, with the poses clustered as in
//! tracking and spread as in global localization. Read the item rate: one item is one ray.

use divan::Bencher;
use divan::counter::ItemsCount;
use locsim_core::{Draw, Hits, Particles, Pose2, RangeMap, Stage};
use locsim_world::raycast::{ExactRangeMap, RangeTable, RangeTableOptions};
use rand::RngExt;

#[path = "../tests/maps_and_rays/common.rs"]
mod common;

const POSES: u32 = 10_000;
const BEAMS: u16 = 60;
const MAX_RANGE_M: f32 = 4.5;

fn main() {
    divan::main();
}

/// Poses within `half_width` (x [m], y [m], heading [rad]) of a pose in the corridor.
fn poses_around(pose: [f64; 3], half_width: [f64; 3]) -> Particles {
    let draw = Draw::new(1, Stage::Initial, 0);
    (0..POSES)
        .map(|i| {
            let mut rng = draw.item(i);
            let [x, y, theta] =
                std::array::from_fn(|axis| pose[axis] + half_width[axis] * rng.random_range(-1.0..1.0));
            Pose2::new(x, y, theta)
        })
        .collect()
}

fn clustered() -> Particles {
    poses_around([7.3, 1.6, 0.35], [0.5, 0.5, 0.25])
}

fn spread() -> Particles {
    poses_around([10.0, 2.0, 0.0], [10.0, 2.0, std::f64::consts::PI])
}

fn cast(bencher: Bencher<'_, '_>, map: &dyn RangeMap, poses: &Particles) {
    let bearings: Vec<f32> =
        (0..BEAMS).map(|i| f32::from(i) * std::f32::consts::TAU / f32::from(BEAMS)).collect();
    let mut hits = Hits::default();
    bencher
        .counter(ItemsCount::new(poses.len() * bearings.len()))
        .bench_local(|| map.cast(poses.as_poses(), &bearings, MAX_RANGE_M, &mut hits));
}

fn exact() -> ExactRangeMap {
    ExactRangeMap::new(common::corridor())
}

fn table() -> RangeTable {
    RangeTable::new(&exact(), &RangeTableOptions::default(), &|_| ()).unwrap()
}

#[divan::bench]
fn exact_clustered(bencher: Bencher<'_, '_>) {
    cast(bencher, &exact(), &clustered());
}

#[divan::bench]
fn exact_spread(bencher: Bencher<'_, '_>) {
    cast(bencher, &exact(), &spread());
}

#[divan::bench]
fn table_clustered(bencher: Bencher<'_, '_>) {
    cast(bencher, &table(), &clustered());
}

#[divan::bench]
fn table_spread(bencher: Bencher<'_, '_>) {
    cast(bencher, &table(), &spread());
}

#[divan::bench(sample_count = 3)]
fn build_table() -> RangeTable {
    table()
}
