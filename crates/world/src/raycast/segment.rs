use std::f64::consts::{FRAC_1_PI, FRAC_PI_2, PI};

use glam::DVec2;
use parry2d_f64::bounding_volume::Aabb;
use parry2d_f64::partitioning::{Bvh, BvhBuildStrategy};

/// Segments are this much wider than drawn \[m\], so that no ray slips between two that share an end.
pub(super) const OVERLAP_M: f64 = 1e-9;

/// Distance \[m\] along a ray (unit `direction`) to a segment, `None` if it misses.
///
/// Both ends belong to the segment. The ends' signed distances from the ray decide, and two segments that share
/// an end compute the same number for it: no ray passes between them. A ray along the segment meets its nearest
/// point.
#[inline]
pub(super) fn range_to(&[a, b]: &[DVec2; 2], origin: DVec2, direction: DVec2) -> Option<f64> {
    let (a, b) = (a - origin, b - origin);
    let (side_a, side_b) = (direction.perp_dot(a), direction.perp_dot(b));
    if side_a > OVERLAP_M && side_b > OVERLAP_M || side_a < -OVERLAP_M && side_b < -OVERLAP_M {
        return None;
    }
    let (along_a, along_b) = (direction.dot(a), direction.dot(b));
    let along = if (side_a - side_b).abs() <= OVERLAP_M {
        // Along the segment. The nearest point ahead is the origin itself when the ends lie either side of it.
        let (near, far) = (along_a.min(along_b), along_a.max(along_b));
        if far < 0.0 { far } else { near.max(0.0) }
    } else {
        let share = (side_a / (side_a - side_b)).clamp(0.0, 1.0);
        along_a + share * (along_b - along_a)
    };
    (along >= -OVERLAP_M).then_some(along.max(0.0))
}

/// Direction of a segment \[rad\], from its first end to the other.
pub(super) fn angle(&[a, b]: &[DVec2; 2]) -> f64 {
    (b - a).to_angle()
}

/// Angle between a ray of a heading and the normal of a segment of an angle \[rad\], 0 to pi/2.
#[inline]
pub(super) fn incidence(angle: f64, heading: f64) -> f64 {
    let turn = (heading - angle).abs();
    let from_segment = turn - PI * f64::from((turn * FRAC_1_PI) as u32);
    (FRAC_PI_2 - from_segment).abs()
}

/// A tree over the segments; leaf `i` is segment `i`. Boxes are wider than the segments' overlap, so that rounding
/// at the edge of a box never decides whether a ray meets the segment.
pub(super) fn tree_over(segments: &[[DVec2; 2]]) -> Bvh {
    let margin = DVec2::splat(2.0 * OVERLAP_M);
    let boxes: Vec<Aabb> =
        segments.iter().map(|[a, b]| Aabb::new(a.min(*b) - margin, a.max(*b) + margin)).collect();
    Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes)
}
