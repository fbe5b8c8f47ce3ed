//! The readings of a log in front of walls where no block can be.

use std::collections::BTreeSet;

use glam::DVec2;
use locsim_core::{
    DistanceMap, DriveStep, Hits, Laser, NO_SURFACE, Particles, Pose2, RangeMap, Track, cell_at, median,
    quantile,
};
use locsim_world::raycast::{DistanceGrid, ExactRangeMap};
use locsim_world::simulation::{BlockModel, BlockOptions};

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
/// A beam that sees so much more than the median beam sees the robot itself, where most of these readings are alike to this \[m\].
const OF_ROBOT_SHARE: f64 = 0.1;
const OF_ROBOT_M: f64 = 0.1;
/// Side of the cells, of which two by two are a place \[m\].
const PLACE_M: f64 = 0.5;
/// What has moved by this in such a place walks: a thing that stays is seen from elsewhere, by its own size at the most \[m\].
const WALKED_M: f64 = 0.4;
/// Share of these readings that the distance in the warning holds.
const MOST: f64 = 0.95;
/// Share of the things that the width by which they are compared holds.
const MOST_WIDTHS: f64 = 0.9;

/// A reading in the open.
#[derive(Clone, Copy)]
pub struct Open {
    /// Index of its scan.
    pub scan: usize,
    /// Where it lies \[m\].
    pub end: DVec2,
    /// Distance to the nearest wall \[m\].
    pub distance: f64,
    /// \[m\].
    pub range: f64,
}

/// Readings in the open.
pub struct InOpen {
    /// Their share of all returns.
    pub share: f64,
    /// The share of returns that end in front of walls where blocks can be.
    pub share_in_reach: f64,
    /// Distance to the nearest wall that most of them have at the most \[m\].
    pub most_m: f64,
    /// How far from walls blocks have to stand to be at all of these places \[m\].
    pub across_m: f64,
    /// The width that most things show at the most, from the first to the last beam that sees them \[m\]; 0 where two beams never see one.
    pub width_m: f64,
    /// How far from walls the scenario's blocks reach \[m\]; `None` where it has none.
    pub reach_m: Option<f64>,
    /// Whether there are enough to be told.
    pub is_told: bool,
    /// Whether most of them are of one thing. It is no clutter then: the search tells what it is, and where.
    pub is_one_thing: bool,
}

/// The poses of a drive, at stamps from the first one on.
pub struct Way<'a> {
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
pub fn in_open(
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
    let is_of_robot: Vec<bool> = (0..beams).map(|beam| share(beam) > most && is_alike(beam)).collect();
    let told: Vec<Open> =
        (0..beams).filter(|&beam| !is_of_robot[beam]).flat_map(|beam| &open[beam]).copied().collect();
    let widths = widths.into_iter().filter(|(beam, _): &(usize, f64)| !is_of_robot[*beam]);
    let mut widths: Vec<f64> = widths.map(|(_, width_m)| width_m).collect();
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

/// The widths that a scan's things show \[m\], each with the first beam that sees the thing: neighbouring beams that end at about the same range see
/// one.
fn widths_of(scan: &[Option<Open>]) -> Vec<(usize, f64)> {
    let of_one = |a: &Option<Open>, b: &Option<Open>| {
        a.zip(*b).is_some_and(|(a, b)| (a.range - b.range).abs() < ONE_THING_M)
    };
    let mut next = 0;
    let things = scan.chunk_by(of_one).filter_map(|thing| {
        let first = next;
        next += thing.len();
        let [Some(from), .., Some(to)] = thing else { return None };
        Some((first, from.end.distance(to.end)))
    });
    things.collect()
}

/// Whether most readings are of one thing that stays where it is. Somebody who walks by is in one place, too.
pub fn is_one_thing(readings: &[Open]) -> bool {
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
pub fn across_from(point: DVec2, walls: &[[DVec2; 2]]) -> Option<f64> {
    let distances = walls.iter().filter_map(|[a, b]| {
        let (along, from) = ((*b - *a).normalize_or_zero(), point - *a);
        let at = along.dot(from);
        (-PAST_END_M..=a.distance(*b) + PAST_END_M).contains(&at).then(|| along.perp_dot(from).abs())
    });
    distances.min_by(f64::total_cmp)
}
