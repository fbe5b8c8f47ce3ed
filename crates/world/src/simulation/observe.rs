use std::sync::Arc;

use glam::DVec2;
use locsim_core::{Draw, Pose2, Poses, Scan, Stage};
use rayon::prelude::*;

use super::blocks::Placement;
use super::rectangle::{Rectangle, nearest_hit};
use super::{BlockModel, BlockOptions, LaserOptions, LaserSimulator, SimulationError};
use crate::raycast::ExactRangeMap;

/// A world that is not quite as its map, and a laser in it.
#[derive(Clone)]
pub struct Simulator {
    map: Arc<ExactRangeMap>,
    blocks: Option<BlockModel>,
    laser: LaserSimulator,
}

/// Where blocks are kept between scans, to allocate once.
#[derive(Default)]
struct Scratch {
    placements: Vec<Placement>,
    rectangles: Vec<Rectangle>,
}

impl Simulator {
    /// A mapped world with unmapped blocks in it (`None`: as mapped) and a laser.
    ///
    /// # Errors
    /// As [`BlockModel::new`] and [`LaserSimulator::new`].
    pub fn new(
        map: Arc<ExactRangeMap>,
        blocks: Option<BlockOptions>,
        laser: LaserOptions,
    ) -> Result<Self, SimulationError> {
        let blocks = blocks.map(|options| BlockModel::new(options, map.geometry())).transpose()?;
        Ok(Self { map, blocks, laser: LaserSimulator::new(laser)? })
    }

    /// The map.
    pub fn map(&self) -> &ExactRangeMap {
        &self.map
    }

    /// The distribution of blocks, where there are any.
    pub fn blocks(&self) -> Option<&BlockModel> {
        self.blocks.as_ref()
    }

    /// The laser.
    pub fn laser(&self) -> &LaserSimulator {
        &self.laser
    }

    /// The readings \[m\] of one scan by a robot that stands at `pose` (`map_from_base`), one per beam, with
    /// blocks of its own: whatever the [resampling](super::BlockResampling) of a drive, observations of one
    /// seed are independent.
    pub fn observe(&self, pose: &Pose2, seed: u64, observation: u32) -> Vec<f32> {
        let mut out = vec![0.0; self.laser.laser().beam_count()];
        self.observe_into(&Standing::new(self, pose), seed, observation, &mut Scratch::default(), &mut out);
        out
    }

    /// `per_pose` independent scans at each pose (`map_from_base`): readings \[m\] in
    /// \[pose\]\[observation\]\[beam\] order.
    ///
    /// Pose `i` observes with seed `Draw::new(seed, Stage::Training, 3).seed(i)`, so that more poses or more
    /// observations leave those there are as they were. Steps 0 to 2 are drawn from where these scans are learnt
    /// from.
    pub fn observe_many(&self, poses: Poses<'_>, per_pose: u32, seed: u64) -> Vec<f32> {
        let beams = self.laser.laser().beam_count();
        let mut out = vec![0.0; poses.len() * per_pose as usize * beams];
        if out.is_empty() {
            return out;
        }
        let draw = Draw::new(seed, Stage::Training, 3);
        out.par_chunks_mut(per_pose as usize * beams).enumerate().for_each_init(
            Scratch::default,
            |scratch, (i, out)| {
                let standing = Standing::new(self, &poses.get(i));
                let seed = draw.seed(i as u32);
                for (observation, out) in out.chunks_mut(beams).enumerate() {
                    self.observe_into(&standing, seed, observation as u32, scratch, out);
                }
            },
        );
        out
    }

    fn observe_into(
        &self,
        standing: &Standing,
        seed: u64,
        observation: u32,
        scratch: &mut Scratch,
        out: &mut [f32],
    ) {
        scratch.rectangles.clear();
        if let Some(blocks) = &self.blocks {
            let draw = Draw::new(seed, Stage::Blocks, observation);
            blocks.place_blocks(&draw, 0.0, standing.robot, &mut scratch.placements);
            scratch.rectangles.extend(scratch.placements.iter().map(|placement| placement.at(0.0)));
        }
        let noise = Draw::new(seed, Stage::Laser, observation);
        let beams = standing.directions.iter().zip(&standing.nominal).zip(out);
        for (beam, ((&direction, &nominal), reading)) in beams.enumerate() {
            let range = nearest_hit(&scratch.rectangles, standing.origin, direction, nominal);
            *reading = self.read(range, &noise, beam);
        }
    }

    /// The scan that a robot takes from `stamp_secs` on: each beam from where robot and blocks are at its own
    /// time.
    pub(super) fn sweep(
        &self,
        placements: &[Placement],
        stamp_secs: f64,
        map_from_base_at: impl Fn(f64) -> Pose2,
        noise: &Draw,
    ) -> Scan {
        let laser = self.laser.laser();
        let max = f64::from(laser.max_range());
        let mut rectangles = Vec::with_capacity(placements.len());
        let mut now = f64::NAN;
        let mut map_from_laser = Pose2::IDENTITY;
        let beams = laser.bearings().iter().zip(laser.beam_times_secs());
        let ranges = beams.enumerate().map(|(beam, (&bearing, &offset_secs))| {
            let secs = stamp_secs + f64::from(offset_secs);
            if secs != now {
                now = secs;
                map_from_laser = map_from_base_at(secs).compose(&laser.base_from_laser());
                rectangles.clear();
                rectangles.extend(placements.iter().map(|placement| placement.at(secs)));
            }
            let origin = map_from_laser.position();
            let direction = DVec2::from_angle(map_from_laser.theta + f64::from(bearing));
            let block = nearest_hit(&rectangles, origin, direction, max);
            let range = self.map.cast_ray(origin, direction, block).map_or(block, |hit| hit.range);
            self.read(range, noise, beam)
        });
        Scan { ranges: ranges.collect() }
    }

    /// The reading of a beam that is free for `range` metres, the maximum range where nothing is met before
    /// it.
    fn read(&self, range: f64, noise: &Draw, beam: usize) -> f32 {
        let max = f64::from(self.laser.laser().max_range());
        self.laser.reading((range < max).then_some(range), &mut noise.item(beam as u32))
    }
}

/// A robot that stands still, with the beams of its laser cast into the map once.
struct Standing {
    robot: DVec2,
    origin: DVec2,
    directions: Vec<DVec2>,
    /// Range of each beam in the map \[m\], at most the maximum range.
    nominal: Vec<f64>,
}

impl Standing {
    fn new(simulator: &Simulator, map_from_base: &Pose2) -> Self {
        let laser = simulator.laser.laser();
        let max = f64::from(laser.max_range());
        let map_from_laser = map_from_base.compose(&laser.base_from_laser());
        let origin = map_from_laser.position();
        let directions: Vec<DVec2> = laser
            .bearings()
            .iter()
            .map(|&bearing| DVec2::from_angle(map_from_laser.theta + f64::from(bearing)))
            .collect();
        let nominal = directions
            .iter()
            .map(|&direction| simulator.map.cast_ray(origin, direction, max).map_or(max, |hit| hit.range))
            .collect();
        Self { robot: map_from_base.position(), origin, directions, nominal }
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::{Hits, Particles, RangeMap};
    use proptest::prelude::*;

    use super::super::fixtures::{block_options, laser_options, on_threads, room_map};
    use super::*;

    fn noisy_laser() -> LaserOptions {
        let mount = Pose2::new(0.1, 0.05, 0.3);
        LaserOptions { sigma_m: 0.01, resolution_m: 0.001, max_range_m: 3.0, mount, ..laser_options() }
    }

    fn simulator(laser: LaserOptions) -> Simulator {
        Simulator::new(room_map(), Some(block_options()), laser).unwrap()
    }

    fn some_poses() -> Particles {
        (0..7).map(|i| Pose2::new(1.0 + 0.5 * f64::from(i), 2.0, f64::from(i))).collect()
    }

    proptest! {
        /// Without noise a reading is what an exact cast against the walls and the edges of the same blocks
        /// gives.
        #[test]
        fn readings_are_casts_at_walls_and_blocks(
            x in 0.5..5.5f64, y in 0.5..3.5f64, theta in -3.0..3.0f64, observation: u32,
        ) {
            let simulator = simulator(laser_options());
            let pose = Pose2::new(x, y, theta);
            let blocks = simulator.blocks().unwrap().blocks_at(4, observation, 0.0, pose.position());
            let edges: Vec<[DVec2; 2]> = blocks
                .iter()
                .flat_map(|block| (0..4).map(|i| [block.corners[i], block.corners[(i + 1) % 4]]))
                .collect();
            let readings = simulator.observe(&pose, 4, observation);
            for (&reading, &bearing) in readings.iter().zip(simulator.laser().laser().bearings()) {
                let direction = DVec2::from_angle(theta + f64::from(bearing));
                let hit = simulator.map().cast_ray_with(&edges, pose.position(), direction, 8.0).unwrap();
                prop_assert!((f64::from(reading) - hit.range).abs() < 1e-5, "{} {}", reading, hit.range);
            }
        }
    }

    #[test]
    fn a_world_without_blocks_is_as_its_map() {
        let none = BlockOptions { per_metre_of_wall: 0.0, ..block_options() };
        let poses = some_poses();
        for blocks in [None, Some(none)] {
            let simulator = Simulator::new(room_map(), blocks, laser_options()).unwrap();
            let mut hits = Hits::default();
            let laser = simulator.laser().laser();
            simulator.map().cast(poses.view(), laser.bearings(), laser.max_range(), &mut hits);
            for (reading, range) in simulator.observe_many(poses.view(), 1, 1).iter().zip(&hits.range) {
                assert!((reading - range).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn many_observations_are_single_ones_in_order_and_new_ones_leave_the_old() {
        let (simulator, poses) = (simulator(noisy_laser()), some_poses());
        let many = simulator.observe_many(poses.view(), 5, 9);
        assert_eq!(many.len(), 7 * 5 * 36);
        let draw = Draw::new(9, Stage::Training, 3);
        for (i, scan) in many.chunks(36).enumerate() {
            let single = simulator.observe(&poses.get(i / 5), draw.seed((i / 5) as u32), (i % 5) as u32);
            assert_eq!(bits(scan), bits(&single));
        }
        let fewer = simulator.observe_many(poses.view().slice(0, 3), 2, 9);
        for (few, many) in fewer.chunks(2 * 36).zip(many.chunks(5 * 36)) {
            assert_eq!(bits(few), bits(&many[..2 * 36]));
        }
        assert!(simulator.observe_many(poses.view(), 0, 9).is_empty());
    }

    #[test]
    fn observations_are_the_same_on_any_number_of_threads() {
        let (simulator, poses) = (simulator(noisy_laser()), some_poses());
        let run = |threads| on_threads(threads, || bits(&simulator.observe_many(poses.view(), 20, 9)));
        let one = run(1);
        assert_eq!(one, run(2));
        assert_eq!(one, run(8));
    }

    #[test]
    fn a_beam_that_meets_nothing_reads_the_maximum_range() {
        let laser = LaserOptions { max_range_m: 1.0, sigma_m: 0.01, ..laser_options() };
        let simulator = Simulator::new(room_map(), None, laser).unwrap();
        assert_eq!(simulator.observe(&Pose2::new(3.0, 2.0, 0.0), 1, 0), [1.0; 36]);
    }

    fn bits(readings: &[f32]) -> Vec<u32> {
        readings.iter().map(|reading| reading.to_bits()).collect()
    }
}
