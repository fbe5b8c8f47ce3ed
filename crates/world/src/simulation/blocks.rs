use glam::DVec2;
use locsim_core::{Draw, Stage};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, Poisson};

use super::SimulationError;
use super::error::{check, check_count};
use super::faces::{Face, faces_of};
use super::rectangle::Rectangle;
use crate::map::Geometry;

/// The most blocks of a world, on average.
const MAX_BLOCKS: f64 = 1e5;

/// A rectangular object that the map doesn't know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Corners in the map frame, counter-clockwise [m].
    pub corners: [DVec2; 4],
    /// Velocity in the map frame [m/s].
    pub velocity: DVec2,
}

/// Unmapped rectangular blocks along the walls. Each `[lo, hi]` is the interval of a uniform distribution.
///
/// Blocks are a Poisson process over the wall faces, the sides of walls that border free space: their number is
/// Poisson with mean `per_metre_of_wall` times the faces' length, each stands at a uniform place, independent of the
/// others. A block is put on the free side of its wall; where it reaches into another wall, the wall hides it.
///
/// Where a block comes closer than `clearance_m` to the robot's centre, it is left out of that scan. A thinned
/// Poisson process is Poisson, so the probability that nothing stands on a ray is exactly exp(-expected number of
/// blocks on it).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockOptions {
    /// Blocks per metre of wall face [1/m], at least 0.
    pub per_metre_of_wall: f64,
    /// Length of a block, along the wall before it is turned [m], above 0.
    pub length_m: [f64; 2],
    /// Width of a block [m], above 0.
    pub width_m: [f64; 2],
    /// Yaw relative to the wall [rad].
    pub yaw_rad: [f64; 2],
    /// Gap between the wall and the block's nearest corner [m], at least 0.
    pub wall_distance_m: [f64; 2],
    /// When blocks take new places.
    pub resample: BlockResampling,
    /// Speed along the wall [m/s], at least 0, either way; blocks turn back where their centre reaches the end of
    /// the wall face. 0 for blocks that are resampled at each observation.
    pub speed_m_s: [f64; 2],
    /// No block comes closer than this to the robot's centre [m], at least 0.
    pub clearance_m: f64,
}

/// When blocks take new places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockResampling {
    /// At every scan.
    EachObservation,
    /// Every so many scans, at least 1.
    EachScanN(u32),
    /// Never: the blocks of a drive stay, or move at their speed.
    Never,
}

/// The distribution of unmapped blocks in one map.
#[derive(Clone, Debug)]
pub struct BlockModel {
    options: BlockOptions,
    faces: Vec<Face>,
    /// Length of the faces up to the end of each [m].
    ends: Vec<f64>,
}

/// One block with its track along the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placement {
    face: Face,
    /// Place of the centre along the face at time 0 [m].
    position: f64,
    /// Distance of the centre from the wall [m].
    offset: f64,
    axis: DVec2,
    half: DVec2,
    /// Signed speed along the face at time 0 [m/s].
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
    /// [`SimulationError`] for an option out of its range, or more than 100,000 blocks on average.
    pub fn new(options: BlockOptions, geometry: &Geometry) -> Result<Self, SimulationError> {
        let at_least_0 = |value: f64| value >= 0.0;
        check("blocks per metre of wall", options.per_metre_of_wall, "at least 0", at_least_0)?;
        check("clearance around the robot [m]", options.clearance_m, "at least 0", at_least_0)?;
        check_interval("length of a block [m]", options.length_m, "0 < lo <= hi", |lo| lo > 0.0)?;
        check_interval("width of a block [m]", options.width_m, "0 < lo <= hi", |lo| lo > 0.0)?;
        check_interval("yaw of a block [rad]", options.yaw_rad, "lo <= hi", |_| true)?;
        check_interval("gap to the wall [m]", options.wall_distance_m, "0 <= lo <= hi", at_least_0)?;
        check_interval("speed of a block [m/s]", options.speed_m_s, "0 <= lo <= hi", at_least_0)?;
        match options.resample {
            BlockResampling::EachObservation if options.speed_m_s[1] > 0.0 => {
                return Err(SimulationError::SpeedWithoutPersistence);
            }
            BlockResampling::EachScanN(scans) => {
                check("scans between resampling blocks", f64::from(scans), "at least 1", |n| n >= 1.0)?;
            }
            BlockResampling::EachObservation | BlockResampling::Never => {}
        }
        let faces = faces_of(geometry);
        let mut total = 0.0;
        let ends = faces
            .iter()
            .map(|face| {
                total += face.length;
                total
            })
            .collect();
        let model = Self { options, faces, ends };
        check_count("blocks", model.expected_count(), MAX_BLOCKS)?;
        Ok(model)
    }

    /// What it was made from.
    pub fn options(&self) -> &BlockOptions {
        &self.options
    }

    /// Length of the wall faces that blocks stand at [m].
    pub fn wall_length_m(&self) -> f64 {
        self.ends.last().copied().unwrap_or(0.0)
    }

    /// Mean number of blocks, before those near the robot are left out.
    pub fn expected_count(&self) -> f64 {
        self.options.per_metre_of_wall * self.wall_length_m()
    }

    /// The blocks of scan `step` at `secs` after the start of the drive, without those near the robot at `robot` [m].
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

    /// Draws blocks and leaves out those near the robot at `secs`. Item 0 draws their number, item `i` + 1 block `i`.
    pub(super) fn place_blocks(&self, draw: &Draw, secs: f64, robot: DVec2, out: &mut Vec<Placement>) {
        out.clear();
        let count = match Poisson::new(self.expected_count()) {
            Ok(poisson) => poisson.sample(&mut draw.item(0)) as u32,
            Err(_) => 0, // the mean is 0
        };
        out.extend((1..=count).map(|item| {
            let mut rng = draw.item(item);
            let position = self.wall_length_m() * rng.random::<f64>();
            self.place(position, &mut rng)
        }));
        out.retain(|placement| self.is_clear(&placement.at(secs), robot));
    }

    /// A block of random shape at `position` [m] along the wall faces.
    pub(super) fn place(&self, position: f64, rng: &mut impl Rng) -> Placement {
        let mut uniform = |[lo, hi]: [f64; 2]| lo + (hi - lo) * rng.random::<f64>();
        let half = 0.5 * DVec2::new(uniform(self.options.length_m), uniform(self.options.width_m));
        let yaw = DVec2::from_angle(uniform(self.options.yaw_rad));
        let gap = uniform(self.options.wall_distance_m);
        let speed = uniform(self.options.speed_m_s);
        let i = self.ends.partition_point(|&end| end <= position).min(self.faces.len() - 1);
        let face = self.faces[i];
        Placement {
            face,
            position: (position - (self.ends[i] - face.length)).clamp(0.0, face.length),
            offset: gap + half.x * yaw.y.abs() + half.y * yaw.x.abs(),
            axis: yaw.rotate(face.along),
            half,
            speed: if rng.random::<bool>() { speed } else { -speed },
        }
    }

    /// Whether a block leaves the robot at `robot` [m] its clearance.
    pub(super) fn is_clear(&self, block: &Rectangle, robot: DVec2) -> bool {
        block.distance_to(robot) > self.options.clearance_m
    }
}

fn check_interval(
    name: &'static str,
    value: [f64; 2],
    allowed: &'static str,
    lo_is_allowed: impl Fn(f64) -> bool,
) -> Result<(), SimulationError> {
    let [lo, hi] = value;
    if lo.is_finite() && hi.is_finite() && lo <= hi && lo_is_allowed(lo) {
        Ok(())
    } else {
        Err(SimulationError::Interval { name, value, allowed })
    }
}
