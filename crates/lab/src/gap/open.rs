//! What stands where no block of the scenario can: people in the open, furniture amid a room. A search whose simulated logs
//! have nothing there takes it for errors of the readings. So they get as much of it as the log has, and a scenario without any blocks gets some.

use std::collections::BTreeSet;

use glam::DVec2;
use locsim_core::{
    DistanceMap, DriveStep, Hits, Laser, NO_SURFACE, Particles, Pose2, RangeMap, Scan, Track, cell_at,
    median, quantile,
};
use locsim_world::raycast::{DistanceGrid, ExactRangeMap};
use locsim_world::simulation::{BlockModel, BlockOptions, BlockResampling, SimulationError, Simulator};

/// Scans that are looked at, at the most.
const SCANS: usize = 300;
/// The greatest distance to the nearest wall that is told \[m\], and the cells that tell it: of this side \[m\], or of a larger one where there
/// would be more of them than this.
const FARTHEST_M: f64 = 6.0;
const CELL_M: f64 = 0.1;
const MOST_CELLS: f64 = 4e6;
/// A reading is of something in front of the wall if it is shorter by this \[m\]: more than noise and errors of a reference make of it.
const MARGIN_M: f64 = 0.3;
/// It is in the open if no block comes nearer than this and half a cell \[m\], of cells so much smaller than those that tell distances: people stand a
/// few centimetres beyond what a scenario says of its blocks.
const BEYOND_M: f64 = 0.02;
const REACH_CELLS: f64 = 0.4;
/// Things in the open that stand beside a wall's end reach so much farther along the wall \[m\].
const PAST_END_M: f64 = 0.2;
/// Places that are looked at to find how far from walls things have to stand, at the most.
const PLACES: usize = 500;
/// Neighbouring beams that see one thing end within this \[m\]. Random readings have no such neighbours.
const ONE_THING_M: f64 = 0.2;
/// Fewer readings, and a lesser share of all returns, aren't told.
const LEAST_READINGS: usize = 50;
const LEAST_SHARE: f64 = 3e-3;
/// The same for simulated logs that get such things: a few dozen readings where nothing can stand are beyond all that have none.
const FEW_READINGS: usize = 20;
const FEW_SHARE: f64 = 2e-4;
/// Blocks per metre of wall with which it is found how many there are \[1/m\].
const TRIED_PER_METRE: f64 = 0.05;
/// How far from walls blocks stand at the most where a scenario has none \[m\].
const AT_WALLS_M: f64 = 1.0;
/// A beam that sees so much more than the median beam sees the robot itself, where most of these readings are alike to this \[m\].
const OF_ROBOT_SHARE: f64 = 0.1;
const OF_ROBOT_M: f64 = 0.1;
/// How often the sizes of simulated things are made those of the log's, the factors that they may have, and the share of things that the width
/// holds by which they are compared.
const SIZINGS: u32 = 2;
const SIZES: [f64; 2] = [0.2, 4.0];
const MOST_WIDTHS: f64 = 0.9;
/// Side of the cells, of which two by two are a place \[m\].
const PLACE_M: f64 = 0.5;
/// What has moved by this in such a place walks: a thing that stays is seen from elsewhere, by its own size at the most \[m\].
const WALKED_M: f64 = 0.4;
/// Share of these readings that the distance in the warning holds.
const MOST: f64 = 0.95;

/// A reading in the open.
#[derive(Clone, Copy)]
struct Open {
    /// Index of its scan.
    scan: usize,
    /// Where it lies \[m\].
    end: DVec2,
    /// Distance to the nearest wall \[m\].
    distance: f64,
    /// \[m\].
    range: f64,
}

/// Readings in the open.
struct InOpen {
    /// Their share of all returns.
    share: f64,
    /// The share of returns that end in front of walls where blocks can be.
    share_in_reach: f64,
    /// Distance to the nearest wall that most of them have at the most \[m\].
    most_m: f64,
    /// How far from walls blocks have to stand to be at all of these places \[m\].
    across_m: f64,
    /// The width that most things show at the most, from the first to the last beam that sees them \[m\]; 0 where two beams never see one.
    width_m: f64,
    /// How far from walls the scenario's blocks reach \[m\]; `None` where it has none.
    reach_m: Option<f64>,
    /// Whether there are enough to be told.
    is_told: bool,
    /// Whether most of them are of one thing. It is no clutter then: the search tells what it is, and where.
    is_one_thing: bool,
}

impl InOpen {
    /// What is told of them, if anything.
    pub fn warning(&self) -> Option<String> {
        let (percent, most_m) = (100.0 * self.share, self.most_m);
        let is_told = self.is_told && !(self.is_one_thing && self.reach_m.is_none());
        let text = self.reach_m.map_or_else(
            || {
                let at_walls_m = self.at_walls_m();
                let beyond = if most_m > AT_WALLS_M {
                    format!(" `scenario.yaml` has those up to {at_walls_m:.1} m from a wall.")
                } else {
                    String::new()
                };
                format!(
                    "{percent:.1} % of the readings end in front of the walls, and the scenario has no `blocks`: people or things in the \
                     open, most of them within {most_m:.1} m of a wall. Simulated logs get blocks up to there, as many as the log has.{beyond}"
                )
            },
            |reach_m| {
                let simulated = if self.is_one_thing {
                    "Most of them are at one place: it is for the search to say what stands there."
                } else {
                    "Simulated logs get as many, beside the scenario's blocks; `scenario.yaml` doesn't have them."
                };
                format!(
                    "{percent:.1} % of the readings end where no block of the scenario reaches ({reach_m:.1} m from a wall): people or things \
                     in the open, most of them within {most_m:.1} m of a wall. {simulated}"
                )
            },
        );
        is_told.then_some(text)
    }

    /// How far from walls blocks stand of a scenario that has none \[m\]. What is farther off is in the open.
    fn at_walls_m(&self) -> f64 {
        (10.0 * self.most_m.min(AT_WALLS_M)).round() / 10.0
    }

    /// Blocks for a scenario that has none. How many there are is fitted to the log, as is how long they stay.
    fn blocks(&self) -> Option<BlockOptions> {
        let blocks = BlockOptions {
            per_metre_of_wall: 0.1,
            length_m: [0.1, 0.6],
            width_m: [0.1, 0.4],
            yaw_rad: [-std::f64::consts::FRAC_PI_4, std::f64::consts::FRAC_PI_4],
            // To the digit that is told.
            wall_distance_m: [0.0, self.at_walls_m()],
            resample: BlockResampling::EachObservation,
            speed_m_s: [0.0, 0.0],
            clearance_m: 0.35,
        };
        (self.reach_m.is_none() && self.is_told && !self.is_one_thing).then_some(blocks)
    }

    /// Blocks that show as wide as what the log has does, wherever they stand.
    ///
    /// # Errors
    /// As the simulator's.
    fn as_wide(
        &self,
        blocks: BlockOptions,
        along: &Along<'_>,
        known: Option<&BlockOptions>,
    ) -> Result<BlockOptions, SimulationError> {
        let anywhere = BlockOptions { wall_distance_m: [0.0, self.across_m], ..blocks };
        let mut times = 1.0_f64;
        // To the centimetre.
        let sized = |of: BlockOptions, times: f64| {
            let sizes = |sizes: [f64; 2]| sizes.map(|size| (100.0 * times * size).round().max(1.0) / 100.0);
            BlockOptions { length_m: sizes(of.length_m), width_m: sizes(of.width_m), ..of }
        };
        for _ in 0..SIZINGS {
            let Some(shown) = along.seen(sized(anywhere, times), known)? else { break };
            if shown.width_m == 0.0 || self.width_m == 0.0 {
                break;
            }
            times = (times * self.width_m / shown.width_m).clamp(SIZES[0], SIZES[1]);
        }
        Ok(sized(blocks, times))
    }

    /// People and things in the open beside a scenario's blocks, as many as the log has: the share of such readings in scans of a simulator without
    /// blocks along the same poses says how many these are. They are at walls as well, or keep so far from them that they alone don't make more readings
    /// there than the log has; where they do all the same, they are fewer.
    ///
    /// # Errors
    /// As the simulator's.
    fn things(
        &self,
        along: &Along<'_>,
        blocks: Option<&BlockOptions>,
    ) -> Result<Option<BlockOptions>, SimulationError> {
        let Some(blocks) = blocks.filter(|_| !self.is_one_thing) else {
            return Ok(None);
        };
        let anywhere = BlockOptions {
            per_metre_of_wall: TRIED_PER_METRE,
            length_m: [0.1, 0.5],
            width_m: [0.1, 0.5],
            yaw_rad: [-std::f64::consts::FRAC_PI_4, std::f64::consts::FRAC_PI_4],
            // A reading where nothing can stand would count as much as many others.
            wall_distance_m: [0.0, self.across_m],
            resample: BlockResampling::EachObservation,
            speed_m_s: [0.0, 0.0],
            clearance_m: blocks.clearance_m,
        };
        let anywhere = self.as_wide(anywhere, along, Some(blocks))?;
        let mut things = None;
        for share in FROM_WALLS {
            let from_m = share * blocks.reach_m().min(self.across_m);
            let tried = BlockOptions { wall_distance_m: [from_m, self.across_m], ..anywhere };
            let Some(found) = along.seen(tried, Some(blocks))? else { break };
            let in_reach = self.share_in_reach / found.share_in_reach.max(f64::MIN_POSITIVE);
            let times = (self.share / found.share).min(in_reach);
            things = Some(BlockOptions {
                resample: BlockResampling::EachScanN(BlockOptions::PASSING_SCANS),
                // Some stand, some walk.
                speed_m_s: [0.0, WALKING_M_S],
                ..tried.times(times)
            });
            if times < in_reach {
                break;
            }
        }
        Ok(things)
    }
}

/// A log's poses, along which scans are simulated.
struct Along<'a> {
    /// A simulator without blocks.
    empty: &'a Simulator,
    /// Seconds from the first scan on.
    secs: Vec<f64>,
    poses: Vec<Pose2>,
    seed: u64,
}

impl<'a> Along<'a> {
    fn new(steps: &[&DriveStep], empty: &'a Simulator, seed: u64) -> Self {
        let known: Vec<(f64, Pose2)> =
            steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?))).collect();
        let start = known.first().map_or(0.0, |(secs, _)| *secs);
        let (secs, poses) = known.into_iter().map(|(secs, pose)| (secs - start, pose)).unzip();
        Self { empty, secs, poses, seed }
    }

    /// What is in front of walls of `tried` alone, where none of the blocks `known` can be.
    fn seen(
        &self,
        tried: BlockOptions,
        known: Option<&BlockOptions>,
    ) -> Result<Option<InOpen>, SimulationError> {
        let Self { empty, secs, poses, seed } = self;
        let laser = empty.laser().laser();
        let simulator = Simulator::clone(empty).with_more_blocks(tried)?;
        let readings = simulator.scan_along(secs, |i, _| poses[i], *seed);
        let scans = secs.iter().zip(poses).zip(readings.chunks(laser.beam_count()));
        let steps = scans.map(|((secs, pose), ranges)| {
            let scan = Scan { ranges: ranges.to_vec() };
            DriveStep { stamp_secs: *secs, odometry: *pose, reference: Some(*pose), scan }
        });
        let steps: Vec<DriveStep> = steps.collect();
        Ok(in_open(&steps.iter().collect::<Vec<_>>(), laser, empty.map(), known, None))
    }
}

/// How far from walls things in the open keep at the least, as shares of the blocks' reach: the first with which they explain no more than the log has.
const FROM_WALLS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// The greatest speed of people \[m/s\].
const WALKING_M_S: f64 = 1.4;

/// The scans that are looked at.
pub(super) fn looked_at<'a>(steps: impl Iterator<Item = &'a DriveStep>) -> Vec<&'a DriveStep> {
    let steps: Vec<&DriveStep> = steps.collect();
    let every = steps.len().div_ceil(SCANS).max(1);
    steps.into_iter().step_by(every).collect()
}

/// What simulated logs get beside what the scenario has, so that they have as much in front of walls as the log.
pub(super) struct Clutter {
    /// What is told of it, if anything.
    pub warning: Option<String>,
    /// Blocks for a scenario that has none.
    pub blocks: Option<BlockOptions>,
    /// People and things where none of the blocks can be, neither the scenario's nor the added ones.
    pub things: Option<BlockOptions>,
}

impl Clutter {
    /// By scans whose reference poses are known, of a robot on its way, and a simulator without blocks.
    ///
    /// # Errors
    /// As the simulator's.
    pub fn of(
        steps: &[&DriveStep],
        way: Option<&Way<'_>>,
        laser: &Laser,
        empty: &Simulator,
        of_scenario: Option<&BlockOptions>,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        let found_with = |blocks: Option<&BlockOptions>| in_open(steps, laser, empty.map(), blocks, way);
        let along = Along::new(steps, empty, seed);
        let found = found_with(of_scenario);
        let warning = found.as_ref().and_then(InOpen::warning);
        let added = found.as_ref().and_then(|found| Some((found, found.blocks()?)));
        let blocks = added.map(|(found, blocks)| found.as_wide(blocks, &along, None)).transpose()?;
        let found = if blocks.is_some() { found_with(blocks.as_ref()) } else { found };
        let known = of_scenario.or(blocks.as_ref());
        let things = found.map(|found| found.things(&along, known)).transpose()?.flatten();
        Ok(Self { warning, blocks, things })
    }
}

/// The poses of a drive, at stamps from the first one on.
pub(super) struct Way<'a> {
    pub first_secs: f64,
    pub track: &'a Track,
}

impl Way<'_> {
    fn pose_at(&self, stamp_secs: f64) -> Pose2 {
        self.track.pose_at(stamp_secs - self.first_secs)
    }
}

/// Casts each beam of a scan from its own pose.
fn cast(map: &ExactRangeMap, laser: &Laser, poses: &[Pose2], hits: &mut Hits) {
    let (bearings, reach) = (laser.bearings(), laser.cast_range());
    let is_at_rest = poses.windows(2).all(|pair| pair[0] == pair[1]);
    if is_at_rest {
        let pose: Particles = poses.iter().take(1).copied().collect();
        map.cast(pose.as_poses(), bearings, reach, hits);
        return;
    }
    let mut one = Hits::default();
    hits.resize(poses.len());
    for (i, pose) in poses.iter().enumerate() {
        let pose: Particles = std::iter::once(*pose).collect();
        map.cast(pose.as_poses(), &bearings[i..=i], reach, &mut one);
        (hits.range[i], hits.surface[i]) = (one.range[0], one.surface[0]);
    }
}

/// Where the robot is at each beam of a scan: on its way, or at rest where that isn't given.
fn beam_poses(step: &DriveStep, reference: Pose2, laser: &Laser, way: Option<&Way<'_>>) -> Vec<Pose2> {
    let at = |secs: &f32| match way {
        Some(way) if *secs != 0.0 => way.pose_at(step.stamp_secs + f64::from(*secs)),
        _ => reference,
    };
    laser.beam_times_secs().iter().map(at).map(|pose| pose.compose(&laser.base_from_laser())).collect()
}

/// Readings in the open, from scans whose reference poses are known, by a robot on its way; `None` where there are few.
fn in_open(
    steps: &[&DriveStep],
    laser: &Laser,
    map: &ExactRangeMap,
    blocks: Option<&BlockOptions>,
    way: Option<&Way<'_>>,
) -> Option<InOpen> {
    let [x0, y0, x1, y1] = map.geometry().bounds();
    let area = (x1 - x0 + 2.0 * FARTHEST_M) * (y1 - y0 + 2.0 * FARTHEST_M);
    let cell_m = (area / MOST_CELLS).sqrt().max(CELL_M);
    let distances = DistanceGrid::new(map.geometry(), cell_m, FARTHEST_M).ok()?;
    let reach_cell_m = REACH_CELLS * cell_m;
    let near_m = 0.5 * reach_cell_m + BEYOND_M;
    let at_walls = |blocks: &BlockOptions| {
        Some(BlockModel::new(*blocks, map.geometry()).ok()?.lattice_in_reach(reach_cell_m, near_m))
    };
    let in_reach = blocks.and_then(at_walls);
    let is_measured = !map.geometry().wall_sigmas().is_empty();
    let beams = laser.beam_count();
    let (mut returns, mut open) = (vec![0_usize; beams], vec![Vec::new(); beams]);
    let mut hits = Hits::default();
    let mut at_walls = 0_usize;
    let mut widths = Vec::new();
    for (scan, step) in steps.iter().enumerate() {
        let Some(reference) = step.reference else { continue };
        let poses = beam_poses(step, reference, laser, way);
        cast(map, laser, &poses, &mut hits);
        let ranges = &step.scan.ranges;
        let in_front = |beam: usize| -> Option<(Open, bool)> {
            if ranges[beam] >= laser.max_range() {
                return None;
            }
            let range = f64::from(ranges[beam]);
            // What stands before the border of what is known may be a wall, as may what stands where a measured map has none.
            let is_in_front = range < f64::from(hits.range[beam]) - MARGIN_M;
            let is_known = match hits.surface[beam] {
                NO_SURFACE => !is_measured,
                surface => !distances.is_unknown(surface),
            };
            if !is_in_front || !is_known {
                return None;
            }
            let pose = poses[beam];
            let (sin, cos) = (pose.theta + f64::from(laser.bearings()[beam])).sin_cos();
            let end = pose.position() + range * DVec2::new(cos, sin);
            let distance = f64::from(distances.distance(end.x, end.y));
            let is_in_open = in_reach.as_ref().map_or(distance > cell_m + BEYOND_M, |in_reach| {
                let at = (end / reach_cell_m).round();
                !in_reach.contains(&[at.x as i32, at.y as i32])
            });
            Some((Open { scan, end, distance, range }, is_in_open))
        };
        let in_front: Vec<_> = (0..beams).map(in_front).collect();
        at_walls += in_front.iter().flatten().filter(|(_, is_in_open)| !is_in_open).count();
        let found: Vec<Option<Open>> = in_front
            .into_iter()
            .map(|of| of.and_then(|(reading, is_in_open)| is_in_open.then_some(reading)))
            .collect();
        widths.extend(widths_of(&found));
        for beam in 0..beams {
            returns[beam] += usize::from(ranges[beam] < laser.max_range());
            let sees_it_too = |other: Option<usize>| {
                let other = other.filter(|other| found.get(*other).is_some_and(Option::is_some));
                other.is_some_and(|other| f64::from((ranges[other] - ranges[beam]).abs()) < ONE_THING_M)
            };
            let neighbours = [beam.checked_sub(1), Some(beam + 1)];
            open[beam].extend(found[beam].filter(|_| neighbours.into_iter().any(sees_it_too)));
        }
    }
    // Of all scans: a beam that ends nowhere has no returns but of what is in the open.
    let share = |beam: usize| open[beam].len() as f64 / steps.len().max(1) as f64;
    let most = OF_ROBOT_SHARE + 2.0 * median(&mut (0..beams).map(share).collect::<Vec<_>>());
    let is_alike = |beam: usize| {
        let [low, high] = [0.1, 0.9].map(|share| {
            quantile(&mut open[beam].iter().map(|reading| reading.range).collect::<Vec<_>>(), share)
        });
        high - low < OF_ROBOT_M
    };
    let told = (0..beams).filter(|&beam| share(beam) <= most || !is_alike(beam)).flat_map(|beam| &open[beam]);
    let told: Vec<Open> = told.copied().collect();
    let mut farthest: Vec<f64> = told.iter().map(|reading| reading.distance).collect();
    let all = returns.iter().sum::<usize>().max(1) as f64;
    let (share, share_in_reach) = (farthest.len() as f64 / all, at_walls as f64 / all);
    let is_told = farthest.len() >= LEAST_READINGS && share >= LEAST_SHARE;
    let are_few = farthest.len() < FEW_READINGS || share < FEW_SHARE;
    let is_one_thing = is_one_thing(&told);
    let across = |reading: &Open| across_from(reading.end, map.geometry().segments());
    let every = told.len().div_ceil(PLACES).max(1);
    // Off a corner the wall across may be that of the hall's other end, and strips as deep take long.
    let across_m = told.iter().step_by(every).filter_map(across).fold(0.0, f64::max).min(FARTHEST_M);
    (!are_few).then(|| InOpen {
        share,
        share_in_reach,
        most_m: quantile(&mut farthest, MOST),
        across_m,
        width_m: if widths.is_empty() { 0.0 } else { quantile(&mut widths, MOST_WIDTHS) },
        reach_m: blocks.map(BlockOptions::reach_m),
        is_told,
        is_one_thing,
    })
}

/// The widths that a scan's things show \[m\]: neighbouring beams that end at about the same range see one thing.
fn widths_of(scan: &[Option<Open>]) -> Vec<f64> {
    let of_one = |a: &Option<Open>, b: &Option<Open>| {
        a.zip(*b).is_some_and(|(a, b)| (a.range - b.range).abs() < ONE_THING_M)
    };
    let things = scan.chunk_by(of_one).filter(|thing| thing.len() > 1);
    let ends = things.filter_map(|thing| Some((thing.first()?.as_ref()?, thing.last()?.as_ref()?)));
    ends.map(|(first, last)| first.end.distance(last.end)).collect()
}

/// Whether most readings are of one thing that stays where it is. Somebody who walks by is in one place, too.
fn is_one_thing(readings: &[Open]) -> bool {
    let places: Vec<[i32; 2]> = readings.iter().map(|reading| cell_at(reading.end, PLACE_M)).collect();
    let is_in = |[x, y]: [i32; 2], [i, j]: [i32; 2]| (x..=x + 1).contains(&i) && (y..=y + 1).contains(&j);
    let count = |place: &[i32; 2]| places.iter().filter(|own| is_in(*place, **own)).count();
    let cells: BTreeSet<[i32; 2]> = places.iter().copied().collect();
    let Some(most) = cells.into_iter().max_by_key(count) else { return false };
    let own = readings.iter().zip(&places).filter(|(_, own)| is_in(most, **own));
    let own: Vec<Open> = own.map(|(reading, _)| *reading).collect();
    2 * own.len() > readings.len() && moved_m(own) < WALKED_M
}

/// By how much the middle of readings moves from the first third of them to the last \[m\].
fn moved_m(mut readings: Vec<Open>) -> f64 {
    readings.sort_by_key(|reading| reading.scan);
    let third = readings.len().div_ceil(3);
    let middle = |part: &[Open]| part.iter().map(|reading| reading.end).sum::<DVec2>() / part.len() as f64;
    middle(&readings[..third]).distance(middle(&readings[readings.len() - third..]))
}

/// The least distance straight across from a wall to a point \[m\]; `None` where there is no wall across.
fn across_from(point: DVec2, walls: &[[DVec2; 2]]) -> Option<f64> {
    let distances = walls.iter().filter_map(|[a, b]| {
        let (along, from) = ((*b - *a).normalize_or_zero(), point - *a);
        let at = along.dot(from);
        (-PAST_END_M..=a.distance(*b) + PAST_END_M).contains(&at).then(|| along.perp_dot(from).abs())
    });
    distances.min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use locsim_world::effect::Effects;
    use locsim_world::map::{Polyline, VectorMap};
    use locsim_world::simulation::LaserOptions;

    use super::*;

    const BEAMS: usize = 72;

    const LASER: LaserOptions = LaserOptions {
        rate_hz: 10.0,
        beams: 360,
        field_of_view_rad: std::f64::consts::TAU,
        first_bearing_rad: None,
        min_range_m: 0.05,
        max_range_m: 20.0,
        resolution_m: 0.001,
        sigma_m: 0.01,
        sigma_per_m: 0.0,
        mount: Pose2::IDENTITY,
        scan_secs: 0.0,
    };

    fn blocks(gap_m: f64) -> BlockOptions {
        BlockOptions {
            per_metre_of_wall: 0.1,
            length_m: [0.3, 0.4],
            width_m: [0.2, 0.3],
            yaw_rad: [0.0, 0.0],
            wall_distance_m: [0.0, gap_m],
            resample: BlockResampling::EachObservation,
            speed_m_s: [0.0, 0.0],
            clearance_m: 0.0,
        }
    }

    /// 100 scans amid a hall of 12 m. `beam` of the `seen` beams of scan i sees something at a distance \[m\].
    fn told(
        seen: usize,
        beam: impl Fn(usize, usize) -> usize,
        at_m: f32,
        blocks: Option<&BlockOptions>,
    ) -> Option<String> {
        told_in(6.0, seen, beam, at_m, blocks).and_then(|found| found.warning())
    }

    /// The same amid a hall whose walls are `wall_m` away.
    fn told_in(
        wall_m: f64,
        seen: usize,
        beam: impl Fn(usize, usize) -> usize,
        at_m: f32,
        blocks: Option<&BlockOptions>,
    ) -> Option<InOpen> {
        let corners = [[-wall_m, -wall_m], [wall_m, -wall_m], [wall_m, wall_m], [-wall_m, wall_m]];
        let outline = Polyline { points_m: corners.to_vec(), ..Polyline::default() };
        let map = VectorMap { outline, obstacles: Vec::new(), walls: Vec::new() };
        let map = ExactRangeMap::new(map.to_geometry().unwrap());
        let bearings: Vec<f32> = (0..BEAMS).map(|i| (i as f32 * 5.0 - 177.5).to_radians()).collect();
        let laser = Laser::new(bearings, vec![0.0; BEAMS], 0.0, 20.0, Pose2::IDENTITY).unwrap();
        let poses: Particles = std::iter::once(Pose2::IDENTITY).collect();
        let mut hits = Hits::default();
        map.cast(poses.as_poses(), laser.bearings(), laser.cast_range(), &mut hits);
        let step = |i: usize| {
            let mut ranges: Vec<f32> = hits.range.iter().map(|range| range.min(laser.max_range())).collect();
            (0..seen).for_each(|j| ranges[beam(i, j)] = at_m);
            let pose = Pose2::IDENTITY;
            DriveStep { stamp_secs: i as f64, odometry: pose, reference: Some(pose), scan: Scan { ranges } }
        };
        let steps: Vec<DriveStep> = (0..100).map(step).collect();
        in_open(&looked_at(steps.iter()), &laser, &map, blocks, None)
    }

    /// A hall of 12 m, and 200 scans of a simulator amid it.
    struct Hall {
        map: Arc<ExactRangeMap>,
        walls: BlockOptions,
    }

    impl Hall {
        fn new(walls: BlockOptions) -> Self {
            let corners = [[-6.0, -6.0], [6.0, -6.0], [6.0, 6.0], [-6.0, 6.0]];
            let outline = Polyline { points_m: corners.to_vec(), ..Polyline::default() };
            let map = VectorMap { outline, obstacles: Vec::new(), walls: Vec::new() };
            Self { map: Arc::new(ExactRangeMap::new(map.to_geometry().unwrap())), walls }
        }

        fn simulator(&self, blocks: Option<BlockOptions>) -> Simulator {
            Simulator::new(Arc::clone(&self.map), blocks, LASER, Effects::none()).unwrap()
        }

        fn scans(simulator: &Simulator, seed: u64) -> Vec<DriveStep> {
            let secs: Vec<f64> = (0..200).map(|i| 0.1 * f64::from(i)).collect();
            let readings = simulator.scan_along(&secs, |_, _| Pose2::IDENTITY, seed);
            let step = |(secs, ranges): (&f64, &[f32])| DriveStep {
                stamp_secs: *secs,
                odometry: Pose2::IDENTITY,
                reference: Some(Pose2::IDENTITY),
                scan: Scan { ranges: ranges.to_vec() },
            };
            secs.iter().zip(readings.chunks(LASER.beams as usize)).map(step).collect()
        }

        fn in_open(&self, steps: &[DriveStep]) -> InOpen {
            let empty = self.simulator(None);
            in_open(
                &steps.iter().collect::<Vec<_>>(),
                empty.laser().laser(),
                &self.map,
                Some(&self.walls),
                None,
            )
            .unwrap()
        }

        fn things(&self, found: &InOpen, steps: &[DriveStep]) -> Option<BlockOptions> {
            let steps: Vec<&DriveStep> = steps.iter().collect();
            let empty = self.simulator(None);
            found.things(&Along::new(&steps, &empty, 7), Some(&self.walls)).unwrap()
        }
    }

    /// The same in other places in every scan, so that their share is that of the density.
    fn anew(things: BlockOptions) -> BlockOptions {
        BlockOptions { resample: BlockResampling::EachObservation, speed_m_s: [0.0; 2], ..things }
    }

    /// Scans of a simulator have things in the open at a known density, which is found from them. One thing alone is none of these.
    #[test]
    fn simulated_logs_get_as_many_things_in_the_open_as_a_log_has() {
        let hall = Hall::new(blocks(0.2));
        let simulator = hall.simulator(Some(hall.walls));
        let seen = |things: BlockOptions, seed: u64| {
            Hall::scans(&simulator.clone().with_more_blocks(things).unwrap(), seed)
        };
        let truth = BlockOptions { per_metre_of_wall: 0.03, wall_distance_m: [0.0, 4.0], ..hall.walls };
        let steps = seen(truth, 3);
        let found = hall.in_open(&steps);
        let things = hall.things(&found, &steps).unwrap();
        let refound = hall.in_open(&seen(anew(things), 5));
        let ratio = refound.share / found.share;
        assert!((0.7..1.4).contains(&ratio), "{} {}", found.share, refound.share);
        let one_thing = InOpen { is_one_thing: true, ..found };
        assert!(hall.things(&one_thing, &steps).is_none());
    }

    /// Legs of 12 cm, and trolleys of about a metre: simulated things show as wide, which nobody has told.
    #[test]
    fn simulated_things_are_as_wide_as_those_of_a_log() {
        let hall = Hall::new(blocks(0.2));
        let seen = |things: BlockOptions, seed: u64| {
            Hall::scans(&hall.simulator(None).with_more_blocks(things).unwrap(), seed)
        };
        for (sizes, most) in [([0.11, 0.13], [0.0, 0.25]), ([0.9, 1.1], [0.7, 2.0])] {
            let truth = BlockOptions {
                per_metre_of_wall: 0.04,
                length_m: sizes,
                width_m: sizes,
                wall_distance_m: [1.0, 3.5],
                ..hall.walls
            };
            let steps = seen(truth, 3);
            let found = hall.in_open(&steps);
            let things = hall.things(&found, &steps).unwrap();
            let again = hall.in_open(&seen(anew(things), 5));
            let ratio = again.width_m / found.width_m;
            assert!((0.75..1.35).contains(&ratio), "{sizes:?}: {} {}", found.width_m, again.width_m);
            let size = things.length_m[1];
            assert!(most[0] < size && size < most[1], "{sizes:?}: {size}");
        }
    }

    /// A robot that turns through 0.2 s of each sweep, amid a hall with pillars and nothing else: what its beams meet at their own times is the map.
    #[test]
    fn beams_of_a_sweep_start_where_the_robot_is_by_then() {
        let square = |x: f64, y: f64| Polyline {
            points_m: vec![[x, y], [x + 0.5, y], [x + 0.5, y + 0.5], [x, y + 0.5]],
            ..Polyline::default()
        };
        let corners = [[-6.0, -6.0], [6.0, -6.0], [6.0, 6.0], [-6.0, 6.0]];
        let outline = Polyline { points_m: corners.to_vec(), ..Polyline::default() };
        let obstacles = vec![square(2.0, 1.0), square(-3.0, 2.0), square(0.0, -3.0), square(-2.0, -2.0)];
        let map = VectorMap { outline, obstacles, walls: Vec::new() };
        let map = Arc::new(ExactRangeMap::new(map.to_geometry().unwrap()));
        let laser = LaserOptions { rate_hz: 5.0, scan_secs: 0.2, ..LASER };
        let simulator = Simulator::new(Arc::clone(&map), None, laser, Effects::none()).unwrap();
        let secs: Vec<f64> = (0..100).map(|i| 0.2 * f64::from(i)).collect();
        let pose_at = |secs: f64| Pose2::new(0.1 * secs, 0.0, 0.8 * secs);
        let readings = simulator.scan_along(&secs, |_, secs| pose_at(secs), 3);
        let step = |(secs, ranges): (&f64, &[f32])| DriveStep {
            // Since 1970.
            stamp_secs: 1.7e9 + *secs,
            odometry: pose_at(*secs),
            reference: Some(pose_at(*secs)),
            scan: Scan { ranges: ranges.to_vec() },
        };
        let steps: Vec<DriveStep> =
            secs.iter().zip(readings.chunks(LASER.beams as usize)).map(step).collect();
        let track = Track::new(steps.iter().map(|step| (step.stamp_secs, step.odometry))).unwrap();
        let way = Way { first_secs: 1.7e9, track: &track };
        let steps: Vec<&DriveStep> = steps.iter().collect();
        let found = |way: Option<&Way<'_>>| in_open(&steps, simulator.laser().laser(), &map, None, way);
        assert!(found(Some(&way)).is_none());
        assert!(found(None).is_some_and(|found| found.is_told));
    }

    /// Of a scenario without blocks, what stands at walls are blocks, and what stands three to four metres from them is in the open.
    #[test]
    fn a_scenario_without_blocks_gets_some_and_things_in_the_open() {
        let hall = Hall::new(blocks(0.2));
        let far = BlockOptions { per_metre_of_wall: 0.05, wall_distance_m: [3.0, 4.0], ..hall.walls };
        let at_walls = hall.simulator(Some(hall.walls));
        let everywhere = at_walls.clone().with_more_blocks(far).unwrap();
        let empty = hall.simulator(None);
        let of = |simulator: &Simulator, of_scenario: Option<&BlockOptions>| {
            let steps = Hall::scans(simulator, 3);
            let steps: Vec<&DriveStep> = steps.iter().collect();
            Clutter::of(&steps, None, empty.laser().laser(), &empty, of_scenario, 7).unwrap()
        };
        let without = of(&everywhere, None);
        assert_eq!(without.blocks.unwrap().wall_distance_m, [0.0, AT_WALLS_M]);
        assert!(without.warning.is_some());
        let with = of(&everywhere, Some(&hall.walls));
        assert!(with.blocks.is_none());
        // As many as beside the scenario's blocks.
        let [with, without] = [with, without].map(|found| found.things.unwrap());
        let ratio = without.per_metre_of_wall / with.per_metre_of_wall;
        assert!((0.6..1.6).contains(&ratio), "{without:?} {with:?}");
        let found = of(&at_walls, None);
        assert!(found.blocks.is_some() && found.things.is_none());
    }

    /// Things amid a hall, three to four metres from its walls, and none nearer. Those of simulated logs keep away from walls, too.
    #[test]
    fn things_make_no_more_readings_at_walls_than_the_log_has() {
        let hall = Hall::new(blocks(2.0));
        let seen = |things: BlockOptions, seed: u64| {
            Hall::scans(&hall.simulator(None).with_more_blocks(things).unwrap(), seed)
        };
        let truth = BlockOptions { per_metre_of_wall: 0.05, wall_distance_m: [3.0, 4.0], ..hall.walls };
        let steps = seen(truth, 3);
        let found = hall.in_open(&steps);
        let things = hall.things(&found, &steps).unwrap();
        assert!(things.wall_distance_m[0] > 0.0, "{things:?}");
        let [own, again] = [found.share_in_reach, hall.in_open(&seen(anew(things), 3)).share_in_reach];
        assert!(again < 1.3 * own + 0.002, "{again} {own}");
    }

    /// Off the corner of a rack nothing stands at the rack's own faces: things there are of the wall beyond.
    #[test]
    fn off_a_corner_things_are_of_the_wall_across() {
        let walls = [[[0.0, 0.0], [2.0, 0.0]], [[0.0, 0.0], [0.0, 2.0]], [[-3.0, -9.0], [-3.0, 9.0]]];
        let walls = walls.map(|wall| wall.map(DVec2::from_array));
        let across = |x: f64, y: f64| across_from(DVec2::new(x, y), &walls);
        assert_eq!(across(1.0, -0.5), Some(0.5));
        assert_eq!(across(-0.5, -0.5), Some(2.5));
        assert_eq!(across(5.0, 5.0), Some(8.0));
        assert_eq!(across(5.0, 12.0), None);
    }

    /// A post that is seen from both sides, one who walks by within a metre, and two posts.
    #[test]
    fn one_thing_stays_where_it_is() {
        let at = |scan: usize, x: f64| Open { scan, end: DVec2::new(x, 0.1), distance: 3.0, range: 2.0 };
        let post: Vec<Open> = (0..60).map(|scan| at(scan, if scan < 30 { 0.1 } else { 0.35 })).collect();
        assert!(is_one_thing(&post));
        let walks: Vec<Open> = (0..60).map(|scan| at(scan, 0.05 + 0.015 * scan as f64)).collect();
        assert!(!is_one_thing(&walks));
        let two: Vec<Open> = (0..60).map(|scan| at(scan, 5.0 * (scan % 2) as f64)).collect();
        assert!(!is_one_thing(&two) && !is_one_thing(&[]));
    }

    #[test]
    fn what_walks_in_the_open_is_told() {
        let walks = |i: usize, j: usize| i * 7 % (BEAMS - 2) + j;
        let told_with = |gap_m: f64| told(3, walks, 2.0, Some(&blocks(gap_m)));
        let text = told_with(0.5).unwrap();
        assert!(
            text.starts_with(
                "4.2 % of the readings end where no block of the scenario reaches (0.8 m from a wall)"
            ),
            "{text}"
        );
        // Two metres ahead are four metres to the walls; in the corners it is less.
        assert!(text.contains("most of them within 4.5 m of a wall"), "{text}");
        assert!(text.contains("Simulated logs get as many"), "{text}");
        let found = told_in(6.0, 3, walks, 2.0, Some(&blocks(0.5))).unwrap();
        let one_thing = InOpen { is_one_thing: true, ..found }.warning().unwrap();
        assert!(!one_thing.contains("Simulated logs get as many"), "{one_thing}");
        assert_eq!(told_with(5.0), None);
        assert!(told(3, walks, 2.0, None).unwrap().contains("the scenario has no `blocks`"));
        // Blocks are added where there are none, as far as these readings are or up to a metre. What is farther off is in the open.
        let added = |wall_m: f64, at_m: f32, blocks: Option<&BlockOptions>| {
            told_in(wall_m, 3, walks, at_m, blocks).unwrap().blocks()
        };
        let reach = |wall_m: f64, at_m: f32| added(wall_m, at_m, None).map(|blocks| blocks.wall_distance_m);
        assert_eq!([reach(6.0, 2.0), reach(2.0, 1.6)], [Some([0.0, 1.0]), Some([0.0, 0.8])]);
        assert_eq!(added(6.0, 2.0, Some(&blocks(0.5))), None);
        assert!(told(3, walks, 2.0, None).unwrap().ends_with("has those up to 1.0 m from a wall."));
        assert!(
            told(3, walks, 2.0, added(6.0, 2.0, None).as_ref())
                .unwrap()
                .contains("no block of the scenario reaches")
        );
        // Walls beyond the maximum range return nothing, and nothing stands where a reading without return seems to end.
        assert!(told_in(24.0, 0, walks, 2.0, Some(&blocks(0.5))).is_none());
        // What is read where no wall is in reach is something all the same.
        assert!(told_in(40.0, 3, walks, 2.0, Some(&blocks(0.5))).is_some());
        assert!(told_in(40.0, 0, walks, 2.0, Some(&blocks(0.5))).is_none());
        // One beam in a place is a random reading; the same beams at all times see the robot.
        assert_eq!(told(3, |i, j| (i * 7 + 20 * j) % BEAMS, 2.0, Some(&blocks(0.5))), None);
        assert_eq!(told(3, |_, j| j, 2.0, Some(&blocks(0.5))), None);
    }
}
