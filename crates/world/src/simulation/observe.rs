use std::sync::Arc;

use locsim_core::{Draw, Pose2, Poses, Scan, Stage};
use rayon::prelude::*;

use super::blocks::Placement;
use super::cast_scan::CastScan;
use super::{
    BeamCaster, BlockModel, BlockOptions, LaserOptions, LaserSimulator, MovedWalls, SimulationError,
};
use crate::effect::{Effects, HitKind, Met, ReadingDistribution, burst, burst_window};
use crate::raycast::ExactRangeMap;

/// A world that is not quite as its map, and a laser in it.
#[derive(Clone)]
pub struct Simulator {
    map: Arc<ExactRangeMap>,
    blocks: Option<BlockModel>,
    /// Those of other kinds beside them.
    more_blocks: Vec<BlockModel>,
    laser: LaserSimulator,
    /// The laser where it really sits.
    mounted: LaserSimulator,
    effects: Effects,
    /// Where the map's walls really stand, if elsewhere.
    moved: Option<MovedWalls>,
}

/// Buffers that are kept between scans.
#[derive(Default)]
pub(super) struct Scratch {
    cast: CastScan,
    /// The blocks of the last scan.
    pub blocks: Vec<Placement>,
    more_blocks: Vec<Placement>,
    ranges: Vec<f64>,
}

impl Simulator {
    /// A mapped world with unmapped blocks in it (`None`: as mapped), a laser, and the effects in which the world differs
    /// from this description. [`Simulator::laser`] stays the nominal laser: it is the one that a filter knows.
    ///
    /// # Errors
    /// As [`BlockModel::new`] and [`LaserSimulator::new`].
    pub fn new(
        map: Arc<ExactRangeMap>,
        blocks: Option<BlockOptions>,
        laser: LaserOptions,
        effects: Effects,
    ) -> Result<Self, SimulationError> {
        let blocks =
            blocks.map(|options| BlockModel::new(effects.blocks(options), map.geometry())).transpose()?;
        let mounted = LaserSimulator::new(LaserOptions { mount: effects.laser_mount(laser.mount), ..laser })?;
        let laser = LaserSimulator::new(laser)?;
        Ok(Self { map, blocks, more_blocks: Vec::new(), laser, mounted, effects, moved: None })
    }

    /// The same with blocks of another kind in its drives, drawn independently of the others, as people beside furniture.
    ///
    /// # Errors
    /// As [`BlockModel::new`].
    pub fn with_more_blocks(mut self, blocks: BlockOptions) -> Result<Self, SimulationError> {
        self.more_blocks.push(BlockModel::new(self.effects.blocks(blocks), self.map.geometry())?);
        Ok(self)
    }

    /// The same with walls that stand elsewhere than the map has them. Blocks stand by the walls of the map.
    #[must_use]
    pub fn with_moved_walls(self, moved: MovedWalls) -> Self {
        Self { moved: Some(moved), ..self }
    }

    /// The same with beams that are taken at these times \[s, from the scan's stamp\].
    ///
    /// # Errors
    /// As [`LaserSimulator::with_beam_times`].
    pub fn with_beam_times(self, secs: &[f32]) -> Result<Self, SimulationError> {
        let [laser, mounted] = [self.laser, self.mounted].map(|laser| laser.with_beam_times(secs));
        Ok(Self { laser: laser?, mounted: mounted?, ..self })
    }

    /// The map.
    pub fn map(&self) -> &Arc<ExactRangeMap> {
        &self.map
    }

    /// The effects in which this world differs from the nominal one.
    pub fn effects(&self) -> &Effects {
        &self.effects
    }

    /// The distribution of blocks as they really are, where there are any.
    pub fn blocks(&self) -> Option<&BlockModel> {
        self.blocks.as_ref()
    }

    /// The laser as it is said to be.
    pub fn laser(&self) -> &LaserSimulator {
        &self.laser
    }

    /// Casts the beams of its scans.
    pub(super) fn caster(&self) -> BeamCaster<'_> {
        let laser = self.mounted.laser();
        BeamCaster {
            map: &self.map,
            moved: self.moved.as_ref(),
            effects: &self.effects,
            laser,
            mount: laser.base_from_laser(),
            directions: self.mounted.directions(),
            is_closed: self.mounted.options().is_closed(),
        }
    }

    /// The readings \[m\] of one scan by a robot that stands at `pose` (`map_from_base`), one per beam, with
    /// blocks of its own: whatever the [resampling](super::BlockResampling) of a drive, observations of one
    /// seed are independent, in bursts of crosstalk too. An observation is one at the start of a drive, at 0 s.
    pub fn observe(&self, pose: &Pose2, seed: u64, observation: u32) -> Vec<f32> {
        let all = self.all_beams();
        let mut out = vec![0.0; all.len()];
        let mut scratch = Scratch::default();
        scratch.cast.update(&self.caster(), &all, 0.0, |_| *pose);
        self.observe_into(pose, seed, observation, &mut scratch, &mut out);
        out
    }

    /// `per_pose` independent scans at each pose (`map_from_base`): readings \[m\] in
    /// \[pose\]\[observation\]\[beam\] order.
    ///
    /// Pose `i` observes with seed `Draw::new(seed, Stage::Training, 3).seed(i)`, so that more poses or more
    /// observations leave those there are as they were. Steps 0 to 2 are drawn from where these scans are learnt
    /// from.
    pub fn observe_many(&self, poses: Poses<'_>, per_pose: u32, seed: u64) -> Vec<f32> {
        let all = self.all_beams();
        let beams = all.len();
        let mut out = vec![0.0; poses.len() * per_pose as usize * beams];
        if out.is_empty() {
            return out;
        }
        let draw = Draw::new(seed, Stage::Training, 3);
        out.par_chunks_mut(per_pose as usize * beams).enumerate().for_each_init(
            Scratch::default,
            |scratch, (i, out)| {
                let pose = poses.get(i);
                let seed = draw.seed(i as u32);
                scratch.cast.update(&self.caster(), &all, 0.0, |_| pose);
                for (observation, out) in out.chunks_mut(beams).enumerate() {
                    self.observe_into(&pose, seed, observation as u32, scratch, out);
                }
            },
        );
        out
    }

    /// The readings of a robot at `pose`, from where `scratch` has cast the beams.
    fn observe_into(
        &self,
        pose: &Pose2,
        seed: u64,
        observation: u32,
        scratch: &mut Scratch,
        out: &mut [f32],
    ) {
        let Scratch { cast, blocks, ranges, .. } = scratch;
        if let Some(model) = &self.blocks {
            model.place_blocks(&Draw::new(seed, Stage::Blocks, observation), 0.0, pose.position(), blocks);
        }
        cast.ranges_among(blocks, &self.mounted, ranges);
        self.read(cast, ranges, seed, observation, |_| observation, out);
    }

    /// The numbers of all beams of the laser.
    pub(super) fn all_beams(&self) -> Vec<usize> {
        (0..self.laser.laser().beam_count()).collect()
    }

    /// Some beams of the scan number `step` of a drive, which a robot takes from `stamp_secs` on: each beam from where robot and
    /// blocks are at its own time. The blocks are left in `scratch`.
    pub(super) fn sweep(
        &self,
        seed: u64,
        (step, stamp_secs): (u32, f64),
        beams: &[usize],
        map_from_base_at: impl Fn(f64) -> Pose2,
        scratch: &mut Scratch,
    ) -> Scan {
        let Scratch { cast, blocks, more_blocks, ranges } = scratch;
        let of_others = Draw::new(seed, Stage::Blocks, u32::MAX);
        let others = self.more_blocks.iter().zip(0..).map(|(model, kind)| (model, of_others.seed(kind)));
        blocks.clear();
        for (model, seed) in self.blocks.iter().map(|model| (model, seed)).chain(others) {
            let robot = map_from_base_at(stamp_secs).position();
            model.place_blocks(&model.draw(seed, step), stamp_secs, robot, more_blocks);
            blocks.append(more_blocks);
        }
        cast.update(&self.caster(), beams, stamp_secs, map_from_base_at);
        cast.ranges_among(blocks, &self.mounted, ranges);
        let mut scan = Scan { ranges: vec![0.0; ranges.len()] };
        self.read(cast, ranges, seed, step, burst_window, &mut scan.ranges);
        scan
    }

    /// The readings of beams that are free for `ranges` metres, the maximum range where nothing is met before it.
    /// `window` tells in which window of bursts a time \[s\] lies.
    fn read(
        &self,
        scan: &CastScan,
        ranges: &[f64],
        seed: u64,
        step: u32,
        window: impl Fn(f64) -> u32,
        out: &mut [f32],
    ) {
        let noise = Draw::new(seed, Stage::Laser, step);
        if scan.beams.is_empty() {
            let max = f64::from(self.laser.laser().max_range());
            for ((reading, &range), beam) in out.iter_mut().zip(ranges).zip(scan.numbers()) {
                *reading = self.laser.reading((range < max).then_some(range), &mut noise.item(beam));
            }
            return;
        }
        let chance = Draw::new(seed, Stage::Effect, step);
        let readings = out.iter_mut().zip(ranges);
        for ((reading, &range), (cast, beam)) in readings.zip(scan.beams.iter().zip(scan.numbers())) {
            let is_blocked = range < cast.range;
            let met = if is_blocked { HitKind::Object } else { HitKind::Wall };
            let is_mapped = cast.is_mapped() && !is_blocked;
            let burst = burst(seed, window(cast.view.secs));
            let options = self.laser.options();
            let mut distribution = ReadingDistribution::nothing(options);
            let met = Met { kind: met, range, is_mapped };
            self.effects.fill(&mut distribution, options, &cast.view, met, burst);
            *reading = distribution.sample(&mut noise.item(beam), &mut chance.item(beam));
        }
    }

    /// The scans of a robot that is at `at(i, secs)` (`map_from_base`) at a time of scan `i`, which is stamped `secs[i]`: readings
    /// \[m\] in \[scan\]\[beam\] order. Blocks take new places, and time counts from the first scan, as in
    /// [`simulate_drive`](super::simulate_drive).
    pub fn scan_along(&self, secs: &[f64], at: impl Fn(usize, f64) -> Pose2 + Sync, seed: u64) -> Vec<f32> {
        self.beams_along(&self.all_beams(), secs, at, seed)
    }

    /// The same readings of the beams `beams` alone, in increasing order and at least one.
    pub fn beams_along(
        &self,
        beams: &[usize],
        secs: &[f64],
        at: impl Fn(usize, f64) -> Pose2 + Sync,
        seed: u64,
    ) -> Vec<f32> {
        let mut out = vec![0.0; secs.len() * beams.len()];
        out.par_chunks_mut(beams.len()).enumerate().for_each_init(Scratch::default, |scratch, (i, out)| {
            let base_at = |secs| at(i, secs);
            out.copy_from_slice(&self.sweep(seed, (i as u32, secs[i]), beams, base_at, scratch).ranges);
        });
        out
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use locsim_core::{Hits, Particles, RangeMap, Track};
    use proptest::prelude::*;

    use super::super::fixtures::{block_options, laser_options, on_threads, room_map};
    use super::*;

    fn noisy_laser() -> LaserOptions {
        let mount = Pose2::new(0.1, 0.05, 0.3);
        LaserOptions { sigma_m: 0.01, resolution_m: 0.001, max_range_m: 3.0, mount, ..laser_options() }
    }

    fn simulator(laser: LaserOptions) -> Simulator {
        Simulator::new(room_map(), Some(block_options()), laser, Effects::none()).unwrap()
    }

    /// What a scan sees doesn't depend on whether the clock runs.
    #[test]
    fn scans_of_one_stamp_are_from_their_own_poses() {
        let along = |secs: f64| {
            let stamped =
                some_poses().iter().enumerate().map(|(i, pose)| (secs * i as f64, pose)).collect::<Vec<_>>();
            let track = Track::new(stamped).unwrap();
            simulator(noisy_laser()).scan_along(track.secs(), |i, secs| track.pose_during(i, secs), 5)
        };
        assert_eq!(along(0.0), along(1.0));
    }

    fn some_poses() -> Particles {
        (0..7).map(|i| Pose2::new(1.0 + 0.5 * f64::from(i), 2.0, f64::from(i))).collect()
    }

    proptest! {
        /// Without noise a reading is an exact cast against the walls and the edges of the same blocks.
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

    /// Without noise a reading among blocks of two kinds is the shorter of those among either.
    #[test]
    fn blocks_of_two_kinds_hide_what_either_hides() {
        let none = BlockOptions { per_metre_of_wall: 0.0, ..block_options() };
        let of = |blocks| Simulator::new(room_map(), Some(blocks), laser_options(), Effects::none()).unwrap();
        let track = Track::new(some_poses().iter().enumerate().map(|(i, pose)| (i as f64, pose))).unwrap();
        let first = of(block_options()).scan_along(track.secs(), |i, secs| track.pose_during(i, secs), 5);
        let more = of(none).with_more_blocks(block_options()).unwrap().scan_along(
            track.secs(),
            |i, secs| track.pose_during(i, secs),
            5,
        );
        let both = of(block_options()).with_more_blocks(block_options()).unwrap().scan_along(
            track.secs(),
            |i, secs| track.pose_during(i, secs),
            5,
        );
        let nearer: Vec<f32> = first.iter().zip(&more).map(|(a, b)| a.min(*b)).collect();
        assert_eq!(bits(&both), bits(&nearer));
        let hidden = |a: &[f32]| a.iter().zip(&both).filter(|(a, both)| a > both).count();
        assert!(hidden(&first) > 10 && hidden(&more) > 10, "{} {}", hidden(&first), hidden(&more));
    }

    #[test]
    fn a_world_without_blocks_is_as_its_map() {
        let none = BlockOptions { per_metre_of_wall: 0.0, ..block_options() };
        let poses = some_poses();
        for blocks in [None, Some(none)] {
            let simulator = Simulator::new(room_map(), blocks, laser_options(), Effects::none()).unwrap();
            let mut hits = Hits::default();
            let laser = simulator.laser().laser();
            simulator.map().cast(poses.as_poses(), laser.bearings(), laser.max_range(), &mut hits);
            for (reading, range) in simulator.observe_many(poses.as_poses(), 1, 1).iter().zip(&hits.range) {
                assert!((reading - range).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn many_observations_are_single_ones_in_order_and_new_ones_leave_the_old() {
        let (simulator, poses) = (simulator(noisy_laser()), some_poses());
        let many = simulator.observe_many(poses.as_poses(), 5, 9);
        assert_eq!(many.len(), 7 * 5 * 36);
        let draw = Draw::new(9, Stage::Training, 3);
        for (i, scan) in many.chunks(36).enumerate() {
            let single = simulator.observe(&poses.get(i / 5), draw.seed((i / 5) as u32), (i % 5) as u32);
            assert_eq!(bits(scan), bits(&single));
        }
        let fewer = simulator.observe_many(poses.as_poses().slice(0, 3), 2, 9);
        for (few, many) in fewer.chunks(2 * 36).zip(many.chunks(5 * 36)) {
            assert_eq!(bits(few), bits(&many[..2 * 36]));
        }
        assert!(simulator.observe_many(poses.as_poses(), 0, 9).is_empty());
    }

    #[test]
    fn observations_are_the_same_on_any_number_of_threads() {
        let (simulator, poses) = (simulator(noisy_laser()), some_poses());
        let run = |threads| on_threads(threads, || bits(&simulator.observe_many(poses.as_poses(), 20, 9)));
        let one = run(1);
        assert_eq!(one, run(2));
        assert_eq!(one, run(8));
    }

    #[test]
    fn a_beam_that_meets_nothing_reads_the_maximum_range() {
        let laser = LaserOptions { max_range_m: 1.0, sigma_m: 0.01, ..laser_options() };
        let simulator = Simulator::new(room_map(), None, laser, Effects::none()).unwrap();
        assert_eq!(simulator.observe(&Pose2::new(3.0, 2.0, 0.0), 1, 0), [1.0; 36]);
    }

    fn bits(readings: &[f32]) -> Vec<u32> {
        readings.iter().map(|reading| reading.to_bits()).collect()
    }
}
