use std::collections::HashSet;
use std::sync::Arc;

use glam::DVec2;
use locsim_core::low_discrepancy;

use super::BlockModel;
use super::faces::Face;
use crate::raycast::Boxes;

/// Shapes of blocks that an integral is summed over, where not said otherwise.
const SHAPES: u32 = 128;
/// Shorter faces than this take turns with the shapes \[m\]: walls of a grid map are faces of a cell each.
const FACE_M: f64 = 1.0;
/// So many shapes stand at each face at least.
const LEAST_SHAPES: usize = 8;

/// The expected number of unmapped blocks on a ray, for any ray that begins outside of blocks.
///
/// As blocks are a Poisson process, the probability that none stands on a ray within s is exp(-Lambda(s)), where Lambda(s) is
/// the expected number of blocks that the ray meets within s: an integral over the shapes of blocks and their places along
/// the walls. Shapes are summed over a low-discrepancy sequence; over places the integral is exact: a block that is moved
/// along its wall is met by a ray at one of its sides, farther along the ray by as much as it was moved. Faces below a metre
/// take turns with the shapes. Rays along a wall are some percent off, those among the short faces of a grid's map up to ten.
#[derive(Clone, Debug)]
pub struct BlockIntegral {
    model: BlockModel,
    /// Shapes at faces with free space on their left, seen along them, and on their right.
    shapes: [Vec<Shape>; 2],
    /// How far a block reaches out from its wall at most \[m\].
    depth_m: f64,
    /// The largest diameter of a block \[m\].
    diameter_m: f64,
    /// Blocks of one shape per metre of wall \[1/m\].
    density: f64,
    /// Boxes around what the blocks of each face reach: a grid's map has many thousand faces.
    reach: Boxes,
    /// Blocks of another kind.
    more: Option<Arc<BlockIntegral>>,
}

/// A block at the beginning of a face, in coordinates along the face and away from it.
#[derive(Clone, Copy, Debug)]
struct Shape {
    /// Distance of the centre from the wall \[m\].
    offset: f64,
    /// Radius of the circle through the corners \[m\].
    radius: f64,
    /// Corners, counter-clockwise.
    x: [f64; 4],
    y: [f64; 4],
}

/// A ray in coordinates along a face and away from it.
struct LocalRay {
    origin: DVec2,
    direction: DVec2,
    /// Its length for a metre farther from the wall.
    per_climb: f64,
    limit: f64,
}

impl BlockIntegral {
    /// Prepares the integral over these blocks.
    pub fn new(model: &BlockModel) -> Self {
        Self::with_shapes(model, SHAPES)
    }

    /// As [`BlockIntegral::new`], summed over this number of shapes of a face (at least one): more are exacter, and take as much longer.
    pub fn with_shapes(model: &BlockModel, shapes_per_face: u32) -> Self {
        let mut shapes = [Vec::new(), Vec::new()];
        let (mut depth_m, mut diameter_m) = (0.0_f64, 0.0_f64);
        let count = if model.expected_count() > 0.0 { shapes_per_face.max(1) } else { 0 };
        for placement in (0..count).map(|i| model.place_at(Face::UNIT, 0.0, low_discrepancy(i))) {
            let block = placement.at(0.0);
            let (center, radius) = block.circle();
            let corners = block.corners();
            depth_m = corners.iter().map(|corner| corner.y).fold(depth_m, f64::max);
            diameter_m = diameter_m.max(2.0 * radius);
            let (x, y) = (corners.map(|corner| corner.x), corners.map(|corner| corner.y));
            shapes[0].push(Shape { offset: center.y, radius, x, y });
            // Turned the other way, seen from the face; still counter-clockwise.
            let (mut x, mut y) = (x.map(|x| -x), y);
            x.reverse();
            y.reverse();
            shapes[1].push(Shape { offset: center.y, radius, x, y });
        }
        let density = model.options().per_metre_of_wall / f64::from(count.max(1));
        let reach = Boxes::new(model.faces().iter().map(|face| box_around(face, diameter_m, depth_m)));
        Self { model: model.clone(), shapes, depth_m, diameter_m, density, reach, more: None }
    }

    /// The same with blocks of another kind beside them.
    #[must_use]
    pub fn and(self, more: Option<Arc<Self>>) -> Self {
        Self { more, ..self }
    }

    /// The blocks it is of, without those of another kind.
    pub fn model(&self) -> &BlockModel {
        &self.model
    }

    /// The points of a lattice near which blocks of either kind may stand; see [`BlockModel::lattice_in_reach`].
    pub fn lattice_in_reach(&self, side: f64, half: f64) -> HashSet<[i32; 2]> {
        let mut points = self.model.lattice_in_reach(side, half);
        points.extend(self.more.iter().flat_map(|more| more.lattice_in_reach(side, half)));
        points
    }

    /// Calls `met` with (near, far, count) of every stretch of a ray from `origin` along the unit vector `direction`, up to
    /// `limit`, in which it is expected to meet `count` blocks, evenly between two ranges \[m\]; blocks too near a robot at
    /// `robot` are left out. Stretches come in no order, and many of them overlap.
    pub fn stretches(
        &self,
        origin: DVec2,
        direction: DVec2,
        robot: DVec2,
        limit: f64,
        mut met: impl FnMut(f64, f64, f64),
    ) {
        for kind in std::iter::once(self).chain(self.more.as_deref()) {
            kind.own_stretches(origin, direction, robot, limit, &mut met);
        }
    }

    fn own_stretches(
        &self,
        origin: DVec2,
        direction: DVec2,
        robot: DVec2,
        limit: f64,
        met: &mut impl FnMut(f64, f64, f64),
    ) {
        if self.shapes[0].is_empty() {
            return;
        }
        let clearance = self.model.options().clearance_m;
        // In their own order, whatever the tree's, so that sums are the same.
        for number in self.reach.met_by(origin, direction, limit) {
            let face = &self.model.faces()[number];
            let local = |v: DVec2| DVec2::new(v.dot(face.along), v.dot(face.inward));
            let (start, step) = (local(origin - face.start), local(direction));
            // A ray along the wall is turned a little, so that it meets each block somewhere.
            let climb = if step.y.abs() < 1e-9 { 1e-9 } else { step.y };
            let ray = LocalRay { origin: start, direction: step, per_climb: climb.recip(), limit };
            if !self.may_meet(&ray, face.length) {
                continue;
            }
            let robot = local(robot - face.start);
            let is_left = face.along.perp_dot(face.inward) > 0.0;
            let shapes = &self.shapes[usize::from(!is_left)];
            // A run of the sequence is as even as the whole.
            let run =
                ((face.length / FACE_M * shapes.len() as f64) as usize).clamp(LEAST_SHAPES, shapes.len());
            let first = number % (shapes.len() / run) * run;
            let density = self.density * shapes.len() as f64 / run as f64;
            for shape in &shapes[first..first + run] {
                let too_near = shape.too_near(robot, clearance);
                shape.stretches(&ray, face.length, |[begin, end], [from, to]| {
                    let at = |place: f64| begin + (place - from) / (to - from) * (end - begin);
                    let mut add = |from: f64, to: f64, a: f64, b: f64| {
                        if to > from {
                            met(a.min(b).max(0.0), a.max(b).min(limit), density * (to - from));
                        }
                    };
                    match too_near {
                        Some([lo, hi]) if lo < to && hi > from => {
                            add(from, lo, begin, at(lo));
                            add(hi, to, at(hi), end);
                        }
                        _ => add(from, to, begin, end),
                    }
                });
            }
        }
    }

    /// Adds to `counts[i]` the expected number of blocks that a ray from `origin` along the unit vector `direction` meets
    /// between `i * bin_m` and `(i + 1) * bin_m`, up to `limit` \[m\]; blocks too near a robot at `robot` are left out.
    ///
    /// The last bin has what lies beyond it, too.
    ///
    /// # Panics
    /// If there is no bin.
    pub fn count_by_range(
        &self,
        origin: DVec2,
        direction: DVec2,
        robot: DVec2,
        limit: f64,
        bin_m: f64,
        counts: &mut [f64],
    ) {
        let (bins_per_m, end) = (bin_m.recip(), counts.len() - 1);
        self.stretches(origin, direction, robot, limit, |near, far, count| {
            // Rounding may take the end of the last bin to the next.
            let [first, last] = [near, far].map(|range| ((range * bins_per_m) as usize).min(end));
            if first == last {
                counts[first] += count;
                return;
            }
            let per_metre = count / (far - near);
            let [after_first, before_last] = [(first + 1) as f64 * bin_m, last as f64 * bin_m];
            counts[first] += per_metre * (after_first - near);
            counts[last] += per_metre * (far.min(before_last + bin_m) - before_last);
            for whole in &mut counts[first + 1..last] {
                *whole += per_metre * bin_m;
            }
        });
    }

    /// Whether a ray comes where blocks of a face of some length stand.
    fn may_meet(&self, ray: &LocalRay, length: f64) -> bool {
        let (mut enter, mut exit) = (0.0_f64, ray.limit);
        let reach = [[-self.diameter_m, length + self.diameter_m], [0.0, self.depth_m]];
        for ([lo, hi], (at, step)) in
            reach.into_iter().zip([(ray.origin.x, ray.direction.x), (ray.origin.y, ray.direction.y)])
        {
            if step == 0.0 {
                if !(lo..=hi).contains(&at) {
                    return false;
                }
            } else {
                let (a, b) = ((lo - at) / step, (hi - at) / step);
                enter = enter.max(a.min(b));
                exit = exit.min(a.max(b));
            }
        }
        enter <= exit
    }
}

/// Lower and upper corner of a box around a face's blocks, whose diameter and reach are at most these.
fn box_around(face: &Face, diameter_m: f64, depth_m: f64) -> [DVec2; 2] {
    let at = |along: f64, inward: f64| face.start + along * face.along + inward * face.inward;
    let (from, to) = (-diameter_m, face.length + diameter_m);
    let corners = [at(from, 0.0), at(to, 0.0), at(from, depth_m), at(to, depth_m)];
    [
        corners.into_iter().fold(DVec2::INFINITY, DVec2::min),
        corners.into_iter().fold(DVec2::NEG_INFINITY, DVec2::max),
    ]
}

impl Shape {
    /// Calls `met` with ranges and places, each from and to, for each side at which the ray can meet the block, along a face of
    /// some length.
    #[inline]
    fn stretches(&self, ray: &LocalRay, length: f64, mut met: impl FnMut([f64; 2], [f64; 2])) {
        let [ranges, places] = self.met_at(ray);
        let is_beside = |values: [f64; 4], end: f64| {
            values.iter().all(|&value| value <= 0.0) || values.iter().all(|&value| value >= end)
        };
        if is_beside(places, length) || is_beside(ranges, ray.limit) {
            return;
        }
        for i in 0..4 {
            let j = (i + 1) % 4;
            // Corners go counter-clockwise: along a side at which the ray comes in, places decrease where it climbs.
            if (places[j] - places[i]) * ray.per_climb >= 0.0 {
                continue;
            }
            let (i, j) = if ray.per_climb > 0.0 { (j, i) } else { (i, j) };
            let ([near, far], [mut from, mut to]) = ([ranges[i], ranges[j]], [places[i], places[j]]);
            let is_whole = from >= 0.0 && to <= length && near.min(far) >= 0.0 && near.max(far) <= ray.limit;
            if is_whole {
                met([near, far], [from, to]);
                continue;
            }
            // Clip to the face and to the ray.
            let slope = (far - near) / (to - from);
            let at = |place: f64| near + (place - places[i]) * slope;
            if slope != 0.0 {
                let (a, b) = (from - near / slope, from + (ray.limit - near) / slope);
                (from, to) = (from.max(a.min(b)), to.min(a.max(b)));
            } else if !(0.0..ray.limit).contains(&near) {
                continue;
            }
            (from, to) = (from.max(0.0), to.min(length));
            if to > from {
                met([at(from), at(to)].map(|range| range.clamp(0.0, ray.limit)), [from, to]);
            }
        }
    }

    /// At which places, from and to, the block comes closer to a robot than `clearance`: where the robot is within the block
    /// with a margin of so much, which has rounded corners.
    #[inline]
    fn too_near(&self, robot: DVec2, clearance: f64) -> Option<[f64; 2]> {
        if (robot.y - self.offset).abs() > clearance + self.radius {
            return None;
        }
        let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut reaches = |x: f64| (lo, hi) = (lo.min(x), hi.max(x));
        for i in 0..4 {
            let j = (i + 1) % 4;
            let [a, b] = [i, j].map(|k| DVec2::new(self.x[k], self.y[k]));
            let squared = clearance.powi(2) - (robot.y - a.y).powi(2);
            if squared >= 0.0 {
                reaches(a.x - squared.sqrt());
                reaches(a.x + squared.sqrt());
            }
            let margin = -clearance * (b - a).perp() / a.distance(b);
            let share = (robot.y - a.y - margin.y) / (b.y - a.y);
            if (0.0..=1.0).contains(&share) {
                reaches(a.x + margin.x + share * (b.x - a.x));
            }
        }
        (lo <= hi).then_some([robot.x - hi, robot.x - lo])
    }

    /// How far along a ray each corner is met, and where the block stands then.
    #[inline]
    fn met_at(&self, ray: &LocalRay) -> [[f64; 4]; 2] {
        let ranges = self.y.map(|y| (y - ray.origin.y) * ray.per_climb);
        let x = ranges.map(|range| ray.origin.x + range * ray.direction.x);
        [ranges, std::array::from_fn(|corner| x[corner] - self.x[corner])]
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Stage};
    use rand::RngExt;

    use super::super::BlockOptions;
    use super::super::fixtures::{block_options, room};
    use super::*;
    use crate::map::{Polyline, VectorMap, Wall};

    /// Expected numbers of blocks within each of some ranges, and how many of `count` sampled ones are met there.
    fn expected_and_sampled(
        model: &BlockModel,
        origin: DVec2,
        direction: DVec2,
        ranges: &[f64],
        count: u32,
    ) -> Vec<(f64, f64)> {
        let limit = ranges[ranges.len() - 1];
        let robot = origin + DVec2::new(0.1, 0.0);
        let mut stretches = Vec::new();
        BlockIntegral::new(model).stretches(origin, direction, robot, limit, |near, far, count| {
            assert!(0.0 <= near && near <= far && far <= limit && count > 0.0);
            stretches.push((near, far, count));
        });
        let draw = Draw::new(1, Stage::Blocks, 0);
        let hits: Vec<f64> = (0..count)
            .filter_map(|i| {
                let mut rng = draw.item(i);
                let position =
                    model.wall_length_m() * (f64::from(i) + rng.random::<f64>()) / f64::from(count);
                let block = model.place(position, &mut rng).at(0.0);
                block.first_hit(origin, direction, limit).filter(|_| model.is_clear(&block, robot))
            })
            .collect();
        let within = |(near, far, count): &(f64, f64, f64), range: f64| {
            let share =
                if far > near { (range - near) / (far - near) } else { f64::from(u8::from(range > *near)) };
            count * share.clamp(0.0, 1.0)
        };
        let sampled = |range: f64| hits.iter().filter(|&&hit| hit < range).count() as f64;
        let expected = |range: f64| stretches.iter().map(|stretch| within(stretch, range)).sum();
        ranges.iter().map(|&range| (expected(range), sampled(range))).collect()
    }

    /// The integral is that over 200,000 sampled blocks: on a share of 1e-9 of all comparisons they differ by more than six
    /// standard errors, to which one shape and 2 % are added, 10 % where faces have a few shapes each. Rays from everywhere,
    /// also along walls, into corners, from near the walls, with faces of both hands.
    #[test]
    fn the_integral_is_that_over_sampled_blocks() {
        let screen = Wall { name: "screen".to_owned(), from_m: [3.0, 1.0], to_m: [3.6, 2.2] };
        let outline = Polyline {
            points_m: vec![[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]],
            ..Polyline::default()
        };
        let divided =
            VectorMap { outline, obstacles: Vec::new(), walls: vec![screen] }.to_geometry().unwrap();
        let uneven = BlockOptions {
            length_m: [0.8, 1.0],
            width_m: [0.05, 0.1],
            yaw_rad: [0.5, 0.9],
            wall_distance_m: [0.0, 0.3],
            ..block_options()
        };
        // Walls in pieces of 8 cm, as of a grid map.
        let corners = [[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]];
        let points_m = (0..4)
            .flat_map(|i| {
                let (a, b): ([f64; 2], [f64; 2]) = (corners[i], corners[(i + 1) % 4]);
                (0..50).map(move |k| [0, 1].map(|axis| a[axis] + f64::from(k) / 50.0 * (b[axis] - a[axis])))
            })
            .collect();
        let pieces = VectorMap {
            outline: Polyline { points_m, ..Polyline::default() },
            obstacles: Vec::new(),
            walls: Vec::new(),
        };
        let pieces = pieces.to_geometry().unwrap();
        for (geometry, options, inexact) in [
            (room(), block_options(), 0.02),
            (room(), uneven, 0.02),
            (divided, uneven, 0.02),
            (pieces, block_options(), 0.1),
        ] {
            let model = BlockModel::new(options, &geometry).unwrap();
            let count = 200_000;
            // A shape more or less within a range: blocks of it on a metre of wall.
            let of_shape = options.per_metre_of_wall / f64::from(SHAPES);
            let mut seen = 0.0;
            for i in 0..24 {
                let at = |share: f64, size: f64| 0.15 + (size - 0.3) * (f64::from(i) * share).fract();
                let origin = DVec2::new(at(0.618, 6.0), at(0.414, 4.0));
                let direction = if i % 8 == 0 { DVec2::X } else { DVec2::from_angle(f64::from(i) * 0.7) };
                let per_sample = model.expected_count() / f64::from(count);
                for (expected, sampled) in
                    expected_and_sampled(&model, origin, direction, &[0.7, 1.5, 2.5, 4.0], count)
                {
                    let sampled_count = sampled * per_sample;
                    let error = 6.0 * sampled.max(1.0).sqrt() * per_sample + inexact * expected + of_shape;
                    assert!(
                        (expected - sampled_count).abs() < error,
                        "{i} {expected} {sampled_count} {error}"
                    );
                    seen += sampled_count;
                }
            }
            assert!(seen > 5.0, "{seen}");
        }
    }

    /// In a mirror, where left faces are right ones, a mirrored ray meets as many blocks that are turned the other way.
    #[test]
    fn a_mirrored_world_has_the_same_integral() {
        let all = |hand: f64| {
            let corner = |[x, y]: [f64; 2]| [hand * x, y];
            let points_m = [[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]].map(corner).to_vec();
            let outline = Polyline { points_m, ..Polyline::default() };
            let map = VectorMap { outline, obstacles: Vec::new(), walls: Vec::new() }.to_geometry().unwrap();
            let options = BlockOptions { yaw_rad: [hand * 0.7; 2], ..block_options() };
            let integral = BlockIntegral::new(&BlockModel::new(options, &map).unwrap());
            let mirrored = |v: DVec2| DVec2::new(hand * v.x, v.y);
            let mut sums = Vec::new();
            for i in 0..30 {
                let origin = mirrored(DVec2::new(0.5 + 0.17 * f64::from(i), 0.6 + 0.08 * f64::from(i)));
                let direction = mirrored(DVec2::from_angle(0.9 * f64::from(i)));
                let mut sum = [0.0; 3];
                integral.stretches(origin, direction, origin, 3.0, |near, far, count| {
                    sum = [sum[0] + count, sum[1] + count * near, sum[2] + count * far];
                });
                sums.push(sum);
            }
            sums
        };
        let (left, right) = (all(1.0), all(-1.0));
        for (left, right) in left.iter().flatten().zip(right.iter().flatten()) {
            assert!((left - right).abs() < 1e-9, "{left} {right}");
        }
        assert!(left.iter().map(|sum| sum[0]).sum::<f64>() > 1.0);
    }

    #[test]
    fn no_blocks_are_on_no_ray() {
        let none = BlockOptions { per_metre_of_wall: 0.0, ..block_options() };
        let model = BlockModel::new(none, &room()).unwrap();
        BlockIntegral::new(&model).stretches(DVec2::ONE, DVec2::X, DVec2::ONE, 9.0, |_, _, _| panic!());
    }

    /// Any two of the four numbers come about equally often in each sixteenth of their square.
    #[test]
    fn the_sequence_fills_the_cube() {
        for (a, b) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            let mut cells = [0; 16];
            for i in 0..SHAPES {
                let point = low_discrepancy(i);
                cells[(4.0 * point[a]) as usize * 4 + (4.0 * point[b]) as usize] += 1;
            }
            assert!(cells.iter().all(|count| (5..=11).contains(count)), "{a} {b} {cells:?}");
        }
    }
}
