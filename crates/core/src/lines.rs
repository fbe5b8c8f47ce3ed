//! Lines that most of some points lie on.

use glam::DVec2;

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

#[cfg(test)]
mod tests {
    use super::*;

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
