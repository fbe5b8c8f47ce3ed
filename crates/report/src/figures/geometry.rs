//! Windows onto a map: equal scales on both axes, clipping, and walls joined to polylines.

use std::collections::HashMap;

/// A point of the map (m).
pub type Point = [f64; 2];

/// An axis-aligned window onto the map (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Lower left corner.
    pub lo: Point,
    /// Upper right corner.
    pub hi: Point,
}

impl Window {
    /// The smallest window around points; a metre around the origin without any.
    pub fn around<'a>(points: impl IntoIterator<Item = &'a Point>) -> Self {
        let empty = Self { lo: [f64::INFINITY; 2], hi: [f64::NEG_INFINITY; 2] };
        let window = points.into_iter().fold(empty, |w, p| Self {
            lo: [w.lo[0].min(p[0]), w.lo[1].min(p[1])],
            hi: [w.hi[0].max(p[0]), w.hi[1].max(p[1])],
        });
        if window.lo[0] <= window.hi[0] { window } else { Self { lo: [-0.5; 2], hi: [0.5; 2] } }
    }

    /// The window of this size and middle.
    pub fn centered([x, y]: Point, [width, height]: [f64; 2]) -> Self {
        Self { lo: [x - width / 2.0, y - height / 2.0], hi: [x + width / 2.0, y + height / 2.0] }
    }

    /// Width and height (m).
    pub fn size(&self) -> [f64; 2] {
        [self.hi[0] - self.lo[0], self.hi[1] - self.lo[1]]
    }

    /// Its middle.
    pub fn middle(&self) -> Point {
        [f64::midpoint(self.lo[0], self.hi[0]), f64::midpoint(self.lo[1], self.hi[1])]
    }

    /// The smallest window about the same middle that has this aspect (width over height) and holds this one with
    /// a margin of 3 %.
    #[must_use]
    pub fn with_aspect(&self, aspect: f64) -> Self {
        let [width, height] = self.size();
        let height = 1.06 * height.max(width / aspect).max(1e-3);
        Self::centered(self.middle(), [aspect * height, height])
    }

    /// A window of this size around `point`, moved so that it shows as little as possible of what is outside
    /// `self`.
    #[must_use]
    pub fn part_around(&self, point: Point, size: [f64; 2]) -> Self {
        let own = self.size();
        let middle = self.middle();
        let center = [0, 1].map(|axis| {
            if size[axis] >= own[axis] {
                middle[axis]
            } else {
                let half = size[axis] / 2.0;
                point[axis].clamp(self.lo[axis] + half, self.hi[axis] - half)
            }
        });
        Self::centered(center, size)
    }

    /// Whether a point lies in it, edges included.
    pub fn contains(&self, p: Point) -> bool {
        (0..2).all(|axis| self.lo[axis] <= p[axis] && p[axis] <= self.hi[axis])
    }

    /// The parts of a polyline that lie in the window (Liang and Barsky 1984, segment by segment).
    pub fn clip_line(&self, points: &[Point]) -> Vec<Vec<Point>> {
        let mut parts: Vec<Vec<Point>> = Vec::new();
        let mut open = false;
        for pair in points.windows(2) {
            let [a, b] = [pair[0], pair[1]];
            let Some((start, end)) = self.clip_segment(a, b) else {
                open = false;
                continue;
            };
            let at = |t: f64| [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
            match parts.last_mut() {
                Some(part) if open && start == 0.0 => part.push(at(end)),
                _ => parts.push(vec![at(start), at(end)]),
            }
            open = end == 1.0;
        }
        parts
    }

    /// The share of a segment, from and to, that lies in the window.
    fn clip_segment(&self, a: Point, b: Point) -> Option<(f64, f64)> {
        let (mut start, mut end) = (0.0f64, 1.0f64);
        for axis in 0..2 {
            let step = b[axis] - a[axis];
            let (to_lo, to_hi) = (self.lo[axis] - a[axis], self.hi[axis] - a[axis]);
            if step == 0.0 {
                if to_lo > 0.0 || to_hi < 0.0 {
                    return None;
                }
                continue;
            }
            let (enter, leave) = if step > 0.0 { (to_lo, to_hi) } else { (to_hi, to_lo) };
            start = start.max(enter / step);
            end = end.min(leave / step);
        }
        (start <= end).then_some((start, end))
    }

    /// The part of a convex polygon that lies in the window (Sutherland and Hodgman 1974).
    pub fn clip_polygon(&self, corners: &[Point]) -> Vec<Point> {
        let mut polygon = corners.to_vec();
        for (axis, bound, sign) in
            [(0, self.lo[0], 1.0), (0, self.hi[0], -1.0), (1, self.lo[1], 1.0), (1, self.hi[1], -1.0)]
        {
            let depth = |p: &Point| sign * (p[axis] - bound);
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (i, p) in polygon.iter().enumerate() {
                let previous = &polygon[(i + polygon.len() - 1) % polygon.len()];
                let (d0, d1) = (depth(previous), depth(p));
                if (d0 < 0.0) != (d1 < 0.0) {
                    let t = d0 / (d0 - d1);
                    kept.push([0, 1].map(|k| previous[k] + t * (p[k] - previous[k])));
                }
                if d1 >= 0.0 {
                    kept.push(*p);
                }
            }
            polygon = kept;
        }
        polygon
    }
}

/// Joins segments that share ends to polylines and drops points in the middle of straight runs: the walls of a
/// grid map have thousands of cell edges.
pub fn join(walls: &[[Point; 2]]) -> Vec<Vec<Point>> {
    // Ends within a hundredth of a millimetre are one.
    let key = |p: Point| p.map(|c| (c * 1e5).round() as i64);
    let mut at: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
    for (i, wall) in walls.iter().enumerate() {
        for end in wall {
            at.entry(key(*end)).or_default().push(i);
        }
    }
    let mut used = vec![false; walls.len()];
    let follow = |from: Point, line: &mut Vec<Point>, used: &mut Vec<bool>| {
        let mut end = from;
        while let Some(&i) = at[&key(end)].iter().find(|&&i| !used[i]) {
            used[i] = true;
            let [a, b] = walls[i];
            end = if key(a) == key(end) { b } else { a };
            line.push(end);
        }
    };
    let mut lines = Vec::new();
    for (i, &[a, b]) in walls.iter().enumerate() {
        if used[i] {
            continue;
        }
        used[i] = true;
        let mut line = vec![a, b];
        follow(b, &mut line, &mut used);
        line.reverse();
        follow(a, &mut line, &mut used);
        lines.push(straightened(line));
    }
    lines
}

/// Without points on the straight line between their neighbours.
fn straightened(line: Vec<Point>) -> Vec<Point> {
    let mut kept: Vec<Point> = Vec::with_capacity(line.len());
    for point in line {
        while let [.., a, b] = kept[..] {
            let [u, v] = [[b[0] - a[0], b[1] - a[1]], [point[0] - b[0], point[1] - b[1]]];
            let (cross, dot) = (u[0] * v[1] - u[1] * v[0], u[0] * v[0] + u[1] * v[1]);
            if cross.abs() > 1e-9 || dot < 0.0 {
                break;
            }
            kept.pop();
        }
        kept.push(point);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const UNIT: Window = Window { lo: [0.0, 0.0], hi: [1.0, 1.0] };

    fn area(polygon: &[Point]) -> f64 {
        let next = polygon.iter().cycle().skip(1);
        polygon.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>().abs() / 2.0
    }

    proptest! {
        #[test]
        fn what_is_clipped_lies_inside(points in proptest::collection::vec([-2.0..3.0f64, -2.0..3.0], 2..8)) {
            let grown = Window { lo: [-1e-9; 2], hi: [1.0 + 1e-9; 2] };
            for part in UNIT.clip_line(&points) {
                prop_assert!(part.len() >= 2 && part.iter().all(|p| grown.contains(*p)));
            }
        }

        #[test]
        fn a_window_around_a_point_has_its_size(point in [-9.0..9.0f64, -9.0..9.0], size in [0.1..5.0f64, 0.1..5.0]) {
            let part = UNIT.part_around(point, size);
            prop_assert!((part.size()[0] - size[0]).abs() < 1e-9 && (part.size()[1] - size[1]).abs() < 1e-9);
        }
    }

    #[test]
    fn a_line_that_leaves_and_comes_back_has_two_parts() {
        let parts = UNIT.clip_line(&[[0.5, 0.5], [2.0, 0.5], [2.0, 0.75], [0.5, 0.75], [0.25, 0.75]]);
        assert_eq!(parts, [vec![[0.5, 0.5], [1.0, 0.5]], vec![[1.0, 0.75], [0.5, 0.75], [0.25, 0.75]]]);
        assert_eq!(UNIT.clip_line(&[[2.0, -1.0], [2.0, 2.0]]), Vec::<Vec<Point>>::new());
    }

    #[test]
    fn a_polygon_keeps_the_area_it_has_inside() {
        let square = [[0.5, 0.5], [1.5, 0.5], [1.5, 1.5], [0.5, 1.5]];
        assert!((area(&UNIT.clip_polygon(&square)) - 0.25).abs() < 1e-12);
        assert!(UNIT.clip_polygon(&square.map(|[x, y]| [x + 5.0, y])).is_empty());
        let around = [[-1.0, -1.0], [2.0, -1.0], [2.0, 2.0], [-1.0, 2.0]];
        assert!((area(&UNIT.clip_polygon(&around)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_room_of_many_segments_becomes_one_line_of_its_corners() {
        let mut walls = Vec::new();
        for i in 0..10 {
            let (a, b) = (f64::from(i), f64::from(i + 1));
            walls.extend([
                [[a, 0.0], [b, 0.0]],
                [[b, 10.0], [a, 10.0]],
                [[0.0, b], [0.0, a]],
                [[10.0, a], [10.0, b]],
            ]);
        }
        let lines = join(&walls);
        assert_eq!(lines.len(), 1);
        assert!(lines[0].len() <= 6, "{lines:?}");
        let length: f64 = lines[0].windows(2).map(|w| (w[0][0] - w[1][0]).hypot(w[0][1] - w[1][1])).sum();
        assert!((length - 40.0).abs() < 1e-9);
    }
}
