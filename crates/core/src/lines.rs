//! Lines that most of some points lie on.

use std::ops::RangeInclusive;

use glam::DVec2;

use crate::sorted;

/// Of more points a sample is looked at: pairs of 60 are 1770 lines.
const SAMPLE: usize = 60;
/// The noise of two nearer points \[m\] turns a line by more than 0.1 rad.
const APART_M: f64 = 0.2;

/// A line of the plane.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// A point on it \[m\].
    pub point: DVec2,
    /// Its direction, of length 1.
    pub along: DVec2,
}

impl Line {
    /// Distance of a point from it \[m\].
    pub fn distance(&self, point: DVec2) -> f64 {
        self.along.perp_dot(point - self.point).abs()
    }

    /// The same line, along which most of these directions cross it from its right.
    #[must_use]
    pub fn seen_from_its_right(self, directions: impl Iterator<Item = DVec2>) -> Self {
        let from_right: f64 = directions.map(|direction| self.away(direction)).sum();
        Self { along: if from_right < 0.0 { -self.along } else { self.along }, ..self }
    }

    /// 1 for a direction that crosses it from its right to its left, -1 for one from its left.
    pub fn away(&self, direction: DVec2) -> f64 {
        self.along.perp_dot(direction).signum()
    }
}

/// Whether a point is of the same wall as a stretch: within a distance \[m\] of its line, and no farther from its ends than it is long.
pub fn is_of_wall(stretch: &[DVec2; 2], point: DVec2, reach_m: f64) -> bool {
    let [a, b] = *stretch;
    let (length, at) = (a.distance(b), (b - a).normalize_or_zero().dot(point - a));
    off_wall(stretch, point) <= reach_m && (-length..=2.0 * length).contains(&at)
}

/// Whether another stretch is of the same wall: both of its ends are on its line, and one is no farther from its ends than it is long. The other wall
/// of a corner ends on it, and isn't along it.
pub fn is_along_wall(stretch: &[DVec2; 2], [a, b]: &[DVec2; 2], reach_m: f64) -> bool {
    let is_near = |end: &DVec2| off_wall(stretch, *end) <= reach_m;
    let is_at = |end: &DVec2| is_of_wall(stretch, *end, reach_m);
    is_near(a) && is_near(b) && (is_at(a) || is_at(b))
}

/// Distance of a point from the line of a stretch \[m\].
fn off_wall([a, b]: &[DVec2; 2], point: DVec2) -> f64 {
    (*b - *a).normalize_or_zero().perp_dot(point - *a).abs()
}

/// Up to `most` lines, the one with most points first. A point that is nearer than `near_m` \[m\] to a line is on it, and counts for one line only.
pub fn lines_through(mut points: Vec<DVec2>, most: usize, near_m: f64) -> Vec<Line> {
    let mut lines = Vec::new();
    while lines.len() < most
        && let Some(line) = line_through(&points, near_m)
    {
        lines.push(line);
        points.retain(|point| line.distance(*point) >= near_m);
    }
    lines
}

/// A stretch of an axis along which most of some points lie on a slanted line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlantedStretch {
    /// How many of the points do.
    pub count: usize,
    /// From and to where along the axis \[m\].
    pub ends: [f64; 2],
    /// The line's height in the middle of the stretch \[m\].
    pub middle: f64,
    /// Its slope.
    pub slope: f64,
}

impl SlantedStretch {
    /// The line that most of the points (along the axis, and off it) are within `near_m` \[m\] of. The stretch goes as far as its points have no gap
    /// of more than `gap_m`, and on to where the line meets the axis, as far as there are `others` on the axis, in ascending order, without
    /// such a gap. `None` of a line whose slope, without its sign, isn't among `slopes`.
    pub fn through(
        points: Vec<DVec2>,
        others: &[f64],
        near_m: f64,
        gap_m: f64,
        slopes: RangeInclusive<f64>,
    ) -> Option<Self> {
        let line = line_through(&points, near_m)?;
        let slope = line.along.y / line.along.x;
        if !slopes.contains(&slope.abs()) {
            return None;
        }
        let on_it = points.into_iter().filter(|point| line.distance(*point) < near_m);
        let on_it = sorted(on_it.map(|point| point.x));
        let pieces = on_it.chunk_by(|a, b| b - a <= gap_m);
        let piece = pieces.max_by_key(|piece| piece.len())?;
        let [from, to] = [piece[0], piece[piece.len() - 1]];
        let meets = line.point.x - line.point.y / slope;
        let go_on = |last: &mut f64, s: &f64| {
            let has_gap = (s - *last).abs() > gap_m;
            *last = *s;
            (!has_gap).then_some(*s)
        };
        let after = others.iter().filter(|s| (to..=meets).contains(s)).scan(to, go_on).last();
        let before = others.iter().rev().filter(|s| (meets..=from).contains(s)).scan(from, go_on).last();
        let ends = [before.unwrap_or(from), after.unwrap_or(to)];
        let middle = line.point.y + slope * (0.5 * (ends[0] + ends[1]) - line.point.x);
        Some(Self { count: piece.len(), ends, middle, slope })
    }
}

/// The line that most of some points lie on, of those through two of them.
fn line_through(points: &[DVec2], near_m: f64) -> Option<Line> {
    let few: Vec<DVec2> = points.iter().copied().step_by(points.len().div_ceil(SAMPLE).max(1)).collect();
    let mut best: Option<(usize, Line)> = None;
    for (i, &a) in few.iter().enumerate() {
        for &b in few[i + 1..].iter().filter(|b| a.distance(**b) > APART_M) {
            let through = Line { point: a, along: (b - a).normalize() };
            let on_it = few.iter().filter(|point| through.distance(**point) < near_m).count();
            if best.as_ref().is_none_or(|(most, _)| on_it > *most) {
                best = Some((on_it, Line { point: 0.5 * (a + b), ..through }));
            }
        }
    }
    best.map(|(_, line)| line)
}

/// Distance from a point to a segment \[m\].
pub fn distance_to(&[a, b]: &[DVec2; 2], point: DVec2) -> f64 {
    let edge = b - a;
    let share = ((point - a).dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
    point.distance(a + share * edge)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points rise by a tenth from 3 to 6.9 m, on a line that meets the axis at 1 m; two others lie elsewhere.
    #[test]
    fn a_slanted_stretch_goes_on_to_where_it_meets_the_axis() {
        let rises = (0..40).map(|i| 3.0 + 0.1 * f64::from(i)).map(|x| DVec2::new(x, 0.1 * (x - 1.0)));
        let points = || rises.clone().chain([DVec2::new(4.0, -0.4), DVec2::new(8.5, 0.1)]).collect();
        let of = |others: &[f64]| SlantedStretch::through(points(), others, 0.02, 1.5, 0.01..=0.3).unwrap();
        let seen: Vec<f64> = (0..20).map(|i| 0.5 * f64::from(i)).collect();
        let found = of(&seen);
        assert!(found.count == 40 && (found.slope - 0.1).abs() < 1e-9, "{found:?}");
        assert!((found.ends[0] - 1.0).abs() < 1e-9 && (found.ends[1] - 6.9).abs() < 1e-9, "{found:?}");
        assert!((found.middle - 0.295).abs() < 1e-9, "{found:?}");
        let far: Vec<f64> = seen.into_iter().filter(|s| !(1.2..2.8).contains(s)).collect();
        assert_eq!(of(&far).ends[0], 3.0, "a gap");
        assert_eq!(SlantedStretch::through(points(), &[], 0.02, 1.5, 0.2..=0.3), None, "too flat");
    }

    /// A recess, its side, and the wall beside it.
    #[test]
    fn points_of_several_walls_are_on_several_lines() {
        let on = |from: [f64; 2], to: [f64; 2], count: usize| {
            let at = move |i: usize| DVec2::from(from).lerp(DVec2::from(to), i as f64 / count as f64);
            (0..count).map(at)
        };
        let side = on([1.0, 0.04], [1.0, 0.4], 20);
        let points = on([0.0, 0.0], [1.0, 0.0], 60).chain(side).chain(on([1.04, 0.4], [2.0, 0.4], 40));
        let lines = lines_through(points.collect(), 3, 0.03);
        let expected = [(DVec2::ZERO, DVec2::X), (DVec2::new(1.5, 0.4), DVec2::X), (DVec2::X, DVec2::Y)];
        assert_eq!(lines.len(), expected.len(), "{lines:?}");
        for (Line { point, along }, (on_it, direction)) in lines.into_iter().zip(expected) {
            assert!(along.perp_dot(direction).abs() < 0.05, "{along} for {direction}");
            assert!(direction.perp_dot(point - on_it).abs() < 0.03, "{point} for {on_it}");
        }
    }
}
