use std::collections::HashSet;

use glam::DVec2;
use locsim_core::{Draw, Stage};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, Poisson};

use super::SimulationError;
use super::error::{FROM_0, MOST, check, check_count};
use super::faces::{Face, faces_of};
use super::rectangle::Rectangle;
use crate::map::{FINEST_M, Geometry};
use crate::options::{BlockOptions, BlockResampling};

/// The most blocks of a world, on average.
const MAX_BLOCKS: f64 = 1e5;

/// A rectangular object that the map doesn't know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Corners in the map frame, counter-clockwise \[m\].
    pub corners: [DVec2; 4],
    /// Velocity in the map frame \[m/s\].
    pub velocity: DVec2,
}

/// The distribution of unmapped blocks in one map.
#[derive(Clone, Debug)]
pub struct BlockModel {
    options: BlockOptions,
    faces: Vec<Face>,
    /// Length of the faces up to the end of each \[m\].
    ends: Vec<f64>,
    /// The distribution of their number; `None` for a mean of 0.
    count: Option<Poisson<f64>>,
}

/// One block with its track along the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placement {
    face: Face,
    /// Place of the centre along the face at time 0 \[m\].
    position: f64,
    /// Distance of the centre from the wall \[m\].
    offset: f64,
    axis: DVec2,
    half: DVec2,
    /// Signed speed along the face at time 0 \[m/s\].
    speed: f64,
}

impl Placement {
    /// Where the block stands at `secs`.
    pub fn at(&self, secs: f64) -> Rectangle {
        let (position, _) = self.position_and_speed(secs);
        let center = self.face.start + position * self.face.along + self.offset * self.face.inward;
        Rectangle::new(center, self.axis, self.half)
    }

    /// As [`Placement::at`], with the velocity.
    pub fn block(&self, secs: f64) -> Block {
        let (_, speed) = self.position_and_speed(secs);
        Block { corners: self.at(secs).corners(), velocity: speed * self.face.along }
    }

    /// How fast it moves along the face \[m/s\].
    pub fn speed_m_s(&self) -> f64 {
        self.speed.abs()
    }

    /// The centre moves to and fro over the face.
    fn position_and_speed(&self, secs: f64) -> (f64, f64) {
        if self.speed == 0.0 {
            return (self.position, 0.0);
        }
        let length = self.face.length;
        let travelled = (self.position + self.speed * secs).rem_euclid(2.0 * length);
        if travelled <= length { (travelled, self.speed) } else { (2.0 * length - travelled, -self.speed) }
    }
}

impl BlockModel {
    /// The blocks of a map.
    ///
    /// # Errors
    /// [`SimulationError`] for an option out of its range, more than 100,000 blocks on average, or walls too long to look for
    /// free space along them.
    pub fn new(options: BlockOptions, geometry: &Geometry) -> Result<Self, SimulationError> {
        check("blocks per metre of wall", options.per_metre_of_wall, "at least 0", |value| value >= 0.0)?;
        check("clearance around the robot [m]", options.clearance_m, FROM_0.0, FROM_0.1)?;
        let side = ("0.0001 <= lo <= hi <= 10000", [FINEST_M, MOST]);
        let from_0 = ("0 <= lo <= hi <= 10000", [0.0, MOST]);
        let angle = ("-100 <= lo <= hi <= 100", [-100.0, 100.0]);
        check_interval("length of a block [m]", options.length_m, side)?;
        check_interval("width of a block [m]", options.width_m, side)?;
        check_interval("yaw of a block [rad]", options.yaw_rad, angle)?;
        check_interval("gap to the wall [m]", options.wall_distance_m, from_0)?;
        check_interval("speed of a block [m/s]", options.speed_m_s, from_0)?;
        match options.resample {
            BlockResampling::EachObservation if options.speed_m_s[1] > 0.0 => {
                return Err(SimulationError::SpeedWithoutPersistence);
            }
            BlockResampling::EachScanN(scans) => {
                check("scans between resampling blocks", f64::from(scans), "at least 1", |n| n >= 1.0)?;
            }
            BlockResampling::EachObservation | BlockResampling::Never => {}
        }
        let faces = faces_of(geometry)?;
        let mut total = 0.0;
        let ends = faces
            .iter()
            .map(|face| {
                total += face.length;
                total
            })
            .collect();
        let mut model = Self { options, faces, ends, count: None };
        check_count("blocks", model.expected_count(), MAX_BLOCKS)?;
        model.count = Poisson::new(model.expected_count()).ok();
        Ok(model)
    }

    /// The options that it was made from.
    pub fn options(&self) -> &BlockOptions {
        &self.options
    }

    /// Length of the wall faces that blocks stand at \[m\].
    pub fn wall_length_m(&self) -> f64 {
        self.ends.last().copied().unwrap_or(0.0)
    }

    /// Mean number of blocks, before those near the robot are left out.
    pub fn expected_count(&self) -> f64 {
        self.options.per_metre_of_wall * self.wall_length_m()
    }

    /// The blocks of scan `step` at `secs` after the start of the drive, without those near the robot at
    /// `robot` \[m\].
    pub fn blocks_at(&self, seed: u64, step: u32, secs: f64, robot: DVec2) -> Vec<Block> {
        let mut placements = Vec::new();
        self.place_blocks(&self.draw(seed, step), secs, robot, &mut placements);
        placements.iter().map(|placement| placement.block(secs)).collect()
    }

    /// The draws that place the blocks of scan `step`: the same for all scans between two resamplings.
    pub(super) fn draw(&self, seed: u64, step: u32) -> Draw {
        let epoch = match self.options.resample {
            BlockResampling::EachObservation => step,
            BlockResampling::EachScanN(scans) => step / scans,
            BlockResampling::Never => 0,
        };
        Draw::new(seed, Stage::Blocks, epoch)
    }

    /// Draws blocks and leaves out those near the robot at `secs`. Item 0 draws their number, item `i` + 1
    /// block `i`.
    pub(super) fn place_blocks(&self, draw: &Draw, secs: f64, robot: DVec2, out: &mut Vec<Placement>) {
        out.clear();
        let count = self.count.map_or(0, |poisson| poisson.sample(&mut draw.item(0)) as u32);
        out.extend((1..=count).map(|item| {
            let mut rng = draw.item(item);
            let position = self.wall_length_m() * rng.random::<f64>();
            self.place(position, &mut rng)
        }));
        out.retain(|placement| self.is_clear(&placement.at(secs), robot));
    }

    /// A block of random shape at `position` \[m\] along the wall faces.
    pub(super) fn place(&self, position: f64, rng: &mut impl Rng) -> Placement {
        let shape = [(); 4].map(|()| rng.random::<f64>());
        // The last draws; those of a block that stands are never asked for.
        let [slowest, fastest] = self.options.speed_m_s;
        let speed = if fastest > 0.0 {
            let speed = slowest + (fastest - slowest) * rng.random::<f64>();
            if rng.random::<bool>() { speed } else { -speed }
        } else {
            0.0
        };
        let i = self.ends.partition_point(|&end| end <= position).min(self.faces.len() - 1);
        let face = self.faces[i];
        let position = (position - (self.ends[i] - face.length)).clamp(0.0, face.length);
        Placement { speed, ..self.place_at(face, position, shape) }
    }

    /// A block at `position` \[m\] along a face, which stands; its shape is that of four numbers from 0 to 1.
    pub(super) fn place_at(&self, face: Face, position: f64, shape: [f64; 4]) -> Placement {
        let between = |[lo, hi]: [f64; 2], share: f64| lo + (hi - lo) * share;
        let [length, width, yaw, gap] = shape;
        let options = &self.options;
        let half = 0.5 * DVec2::new(between(options.length_m, length), between(options.width_m, width));
        let yaw = DVec2::from_angle(between(options.yaw_rad, yaw));
        Placement {
            face,
            position,
            offset: between(options.wall_distance_m, gap) + half.x * yaw.y.abs() + half.y * yaw.x.abs(),
            axis: yaw.rotate(face.along),
            half,
            speed: 0.0,
        }
    }

    /// How many wall faces there are that blocks stand at.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// The wall faces that blocks stand at.
    pub(super) fn faces(&self) -> &[Face] {
        &self.faces
    }

    /// The points of a lattice of `side` \[m\], as multiples of it, with part of a block perhaps in the upright square around them
    /// whose sides are twice `half` \[m\]. Around all others no block ever stands.
    pub fn lattice_in_reach(&self, side: f64, half: f64) -> HashSet<[i32; 2]> {
        let (diameter, reach) = (self.options.diameter_m(), self.options.reach_m());
        let mut points = HashSet::new();
        for face in &self.faces {
            // The square's own extent along the face, and as much away from it.
            let extent = half * (face.along.x.abs() + face.along.y.abs());
            let (before, out) = (0.5 * diameter + extent, reach + extent);
            let [a, b] = [-before, face.length + before].map(|at| face.start + at * face.along);
            let corners = [-extent, out].map(|out| [a, b].map(|at| at + out * face.inward));
            let all = corners.as_flattened();
            let lower = all.iter().copied().reduce(DVec2::min).unwrap_or(a) / side;
            let upper = all.iter().copied().reduce(DVec2::max).unwrap_or(a) / side;
            for x in lower.x.ceil() as i32..=upper.x.floor() as i32 {
                for y in lower.y.ceil() as i32..=upper.y.floor() as i32 {
                    let from_start = side * DVec2::new(f64::from(x), f64::from(y)) - face.start;
                    let (at, away) = (from_start.dot(face.along), from_start.dot(face.inward));
                    if (-extent..=out).contains(&away) && (-before..=face.length + before).contains(&at) {
                        points.insert([x, y]);
                    }
                }
            }
        }
        points
    }

    /// Whether a block leaves the robot at `robot` \[m\] its clearance.
    pub(super) fn is_clear(&self, block: &Rectangle, robot: DVec2) -> bool {
        block.distance_to(robot) > self.options.clearance_m
    }
}

fn check_interval(
    name: &'static str,
    value: [f64; 2],
    (allowed, [least, most]): (&'static str, [f64; 2]),
) -> Result<(), SimulationError> {
    let [lo, hi] = value;
    if least <= lo && lo <= hi && hi <= most {
        Ok(())
    } else {
        Err(SimulationError::Interval { name, value, allowed })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::fixtures::{Z_1E6, block_options, moments, room};
    use super::*;
    use crate::map::{Polyline, VectorMap, Wall};

    const FAR: DVec2 = DVec2::splat(1e3);

    fn model(options: BlockOptions) -> BlockModel {
        BlockModel::new(options, &room()).unwrap()
    }

    fn center(block: &Block) -> DVec2 {
        block.corners.iter().sum::<DVec2>() / 4.0
    }

    /// Over 4000 worlds the count has the mean and the variance of a Poisson distribution of mean 20.
    /// Standard errors: sqrt(m/n) of the mean, sqrt((m + 2 m^2)/n) of the variance (fourth moment of a
    /// Poisson m + 3 m^2).
    #[test]
    fn the_number_of_blocks_is_poisson_with_the_density_times_the_wall_length() {
        let model = model(block_options());
        assert!((model.wall_length_m() - 20.0).abs() < 1e-9);
        let counts: Vec<f64> =
            (0..4000).map(|step| model.blocks_at(5, step, 0.0, FAR).len() as f64).collect();
        let (mean, variance) = moments(&counts);
        let (m, n): (f64, f64) = (20.0, 4000.0);
        let mean_error = Z_1E6 * (m / n).sqrt();
        assert!((mean - m).abs() < mean_error, "mean {mean}");
        assert!((mean - 1.05 * m).abs() > mean_error, "blind to 5 %");
        assert!((variance - m).abs() < Z_1E6 * ((m + 2.0 * m * m) / n).sqrt(), "variance {variance}");
    }

    /// Each wall gets its share of the length, uniform along it, standing blocks and moving ones at any time:
    /// the count on a stretch is Poisson.
    #[test]
    fn blocks_stand_at_walls_by_their_length() {
        let moving =
            BlockOptions { resample: BlockResampling::Never, speed_m_s: [0.0, 1.0], ..block_options() };
        let worlds = 4000_u32;
        for (options, secs) in [(block_options(), 0.0), (moving, 25.0)] {
            let model = model(options);
            let (mut south, mut west) = ([0_u32; 2], 0_u32);
            let mut placements = Vec::new();
            for seed in 0..worlds {
                model.place_blocks(&model.draw(u64::from(seed), 0), secs, FAR, &mut placements);
                for placement in &placements {
                    let (center, _) = placement.at(secs).circle();
                    let foot = center - placement.offset * placement.face.inward;
                    if foot.y.abs() < 1e-9 {
                        south[usize::from(foot.x > 2.0)] += 1;
                    }
                    west += u32::from(foot.x.abs() < 1e-9);
                }
            }
            for (count, length) in [(south[0], 2.0), (south[1], 4.0), (west, 4.0)] {
                let expected = f64::from(worlds) * length;
                assert!((f64::from(count) - expected).abs() < Z_1E6 * expected.sqrt(), "{count} {expected}");
            }
        }
    }

    /// Where a corner of a block ever is, blocks may stand; in the middle of the room and behind its walls, none may.
    #[test]
    fn blocks_stand_only_where_they_may() {
        let model = model(block_options());
        let (side, half) = (0.05, 0.03);
        let reach = model.lattice_in_reach(side, half);
        let corners =
            (0..500).flat_map(|step| model.blocks_at(3, step, 0.0, FAR)).flat_map(|block| block.corners);
        for corner in corners {
            assert!(reach.contains(&(corner / side).to_array().map(|at| at.round() as i32)), "{corner}");
        }
        // A gap of 0.5 m, a depth of 0.64 m at the greatest yaw and half of a square from the south wall at x = 3 m.
        for (y, may) in [(0.0, true), (1.15, true), (1.2, false), (2.0, false), (-0.05, false)] {
            assert_eq!(reach.contains(&[60, (y / side).round() as i32]), may, "{y}");
        }
    }

    proptest! {
        /// Sides, yaw relative to the wall, gap and side of the wall are as asked for.
        #[test]
        fn each_block_is_within_its_options(step: u32) {
            let options = block_options();
            let model = model(options);
            let mut placements = Vec::new();
            model.place_blocks(&model.draw(7, step), 0.0, FAR, &mut placements);
            for placement in placements {
                let Block { corners, .. } = placement.block(0.0);
                let within = |value: f64, [lo, hi]: [f64; 2]| (lo - 1e-9..hi + 1e-9).contains(&value);
                let side = corners[1] - corners[0];
                prop_assert!(within(side.length(), options.length_m));
                prop_assert!(within(corners[2].distance(corners[1]), options.width_m));
                prop_assert!(within(placement.face.along.angle_to(side), options.yaw_rad));
                let nearest = corners
                    .map(|corner| (corner - placement.face.start).dot(placement.face.inward))
                    .into_iter()
                    .fold(f64::INFINITY, f64::min);
                prop_assert!(within(nearest, options.wall_distance_m), "{}", nearest);
                prop_assert!(side.perp_dot(corners[2] - corners[1]) > 0.0, "not counter-clockwise");
            }
        }

        #[test]
        fn no_block_is_nearer_to_the_robot_than_the_clearance(step: u32, x in 0.0..6.0f64, y in 0.0..4.0f64) {
            let model = model(block_options());
            let robot = DVec2::new(x, y);
            let all = model.blocks_at(8, step, 0.0, FAR);
            let near = model.blocks_at(8, step, 0.0, robot);
            let distance = |block: &Block| {
                let (a, b, d) = (block.corners[0], block.corners[1], block.corners[3]);
                let rectangle = Rectangle::new(center(block), (b - a).normalize(),
                    0.5 * DVec2::new(a.distance(b), a.distance(d)));
                rectangle.distance_to(robot)
            };
            let kept: Vec<Block> = all.into_iter().filter(|block| distance(block) > 0.35).collect();
            prop_assert_eq!(kept, near);
        }
    }

    #[test]
    fn blocks_stay_for_as_many_scans_as_asked_for() {
        let blocks = |resample, step| {
            model(BlockOptions { resample, ..block_options() }).blocks_at(1, step, f64::from(step), FAR)
        };
        let each = BlockResampling::EachObservation;
        assert_ne!(blocks(each, 0), blocks(each, 1));
        let third = BlockResampling::EachScanN(3);
        assert_eq!(blocks(third, 0), blocks(third, 2));
        assert_eq!(blocks(third, 3), blocks(third, 5));
        assert_ne!(blocks(third, 2), blocks(third, 3));
        assert_eq!(blocks(BlockResampling::Never, 0), blocks(BlockResampling::Never, 1000));
        let other_seed = model(block_options()).blocks_at(2, 0, 0.0, FAR);
        assert_ne!(blocks(each, 0), other_seed);
    }

    #[test]
    fn moving_blocks_keep_their_speed_their_wall_and_their_shape() {
        let model = model(BlockOptions {
            resample: BlockResampling::Never,
            speed_m_s: [0.2, 0.4],
            ..block_options()
        });
        let (h, mut turned) = (0.05, 0);
        for tenth in 0..400 {
            let secs = 0.1 * f64::from(tenth);
            let before = model.blocks_at(1, 0, secs, FAR);
            let after = model.blocks_at(1, 0, secs + h, FAR);
            assert_eq!(before.len(), after.len());
            for (a, b) in before.iter().zip(&after) {
                assert!((0.2..=0.4).contains(&a.velocity.length()));
                assert!((a.corners[1] - a.corners[0]).distance(b.corners[1] - b.corners[0]) < 1e-12);
                let moved = center(b) - center(a);
                if a.velocity == b.velocity {
                    assert!(moved.distance(a.velocity * h) < 1e-12);
                } else {
                    assert!(moved.length() < 0.4 * h && a.velocity == -b.velocity);
                    turned += 1;
                }
                let c = center(b);
                assert!((-1e-9..6.0 + 1e-9).contains(&c.x) && (-1e-9..4.0 + 1e-9).contains(&c.y));
            }
        }
        // 20 blocks at 0.3 m/s reach an end of their wall about every 16 s each: some 25 times in 400 looks
        // of h.
        assert!(turned > 0, "no block turned back at the end of its wall");
    }

    #[test]
    fn a_screen_has_blocks_on_both_sides_and_no_wall_means_no_blocks() {
        let outline = Polyline {
            points_m: vec![[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]],
            ..Polyline::default()
        };
        let screen = Wall { name: "screen".into(), from_m: [2.0, 2.0], to_m: [4.0, 2.0] };
        let map = VectorMap { outline, obstacles: vec![], walls: vec![screen] }.to_geometry().unwrap();
        let model = BlockModel::new(block_options(), &map).unwrap();
        assert!((model.wall_length_m() - 24.0).abs() < 1e-9);
        let none = BlockOptions { per_metre_of_wall: 0.0, ..block_options() };
        let model = BlockModel::new(none, &map).unwrap();
        assert!((0..100).all(|step| model.blocks_at(1, step, 0.0, FAR).is_empty()));
    }

    #[test]
    fn options_out_of_range_are_refused() {
        let good = block_options();
        for (options, message) in [
            (
                BlockOptions { per_metre_of_wall: -1.0, ..good },
                "blocks per metre of wall must be at least 0; got -1",
            ),
            (BlockOptions { per_metre_of_wall: 1e9, ..good }, "20000000000 blocks are more than the 100000"),
            (
                BlockOptions { clearance_m: f64::NAN, ..good },
                "clearance around the robot [m] must be at least 0",
            ),
            (BlockOptions { length_m: [0.0, 1.0], ..good }, "length of a block [m] must be an interval"),
            (BlockOptions { width_m: [0.5, 0.4], ..good }, "0.0001 <= lo <= hi <= 10000; got [0.5, 0.4]"),
            (BlockOptions { yaw_rad: [1.0, -1.0], ..good }, "yaw of a block [rad]"),
            (BlockOptions { wall_distance_m: [-0.1, 1.0], ..good }, "gap to the wall [m]"),
            (
                BlockOptions { speed_m_s: [0.1, 0.2], ..good },
                "resampled at each observation cannot have a speed",
            ),
            (BlockOptions { resample: BlockResampling::EachScanN(0), ..good }, "at least 1; got 0"),
            (BlockOptions { length_m: [1e-300, 1.0], ..good }, "length of a block [m] must be an interval"),
            (BlockOptions { length_m: [1.0, 1e300], ..good }, "length of a block [m] must be an interval"),
            (BlockOptions { wall_distance_m: [0.0, 1e300], ..good }, "gap to the wall [m]"),
            (BlockOptions { yaw_rad: [0.0, 1e300], ..good }, "yaw of a block [rad]"),
            (BlockOptions { clearance_m: 1e300, ..good }, "clearance around the robot [m]"),
            (
                BlockOptions { speed_m_s: [1e300, 1e300], resample: BlockResampling::Never, ..good },
                "speed of a block [m/s]",
            ),
        ] {
            let error = BlockModel::new(options, &room()).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
