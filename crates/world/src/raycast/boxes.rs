use glam::DVec2;
use parry2d_f64::bounding_volume::Aabb;
use parry2d_f64::partitioning::{Bvh, BvhBuildStrategy, BvhNode};

/// Boxes are wider by this, so that rounding doesn't decide whether a ray meets them \[m\].
const MARGIN_M: f64 = 1e-6;

/// Boxes along the axes, many of which rays meet.
#[derive(Clone, Debug)]
pub struct Boxes {
    tree: Bvh,
}

impl Boxes {
    /// Boxes of these lower and upper corners \[m\].
    pub fn new(corners: impl Iterator<Item = [DVec2; 2]>) -> Self {
        let margin = DVec2::splat(MARGIN_M);
        let boxes: Vec<Aabb> = corners.map(|[lo, hi]| Aabb::new(lo - margin, hi + margin)).collect();
        Self { tree: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes) }
    }

    /// Numbers of the boxes that a ray from `origin` along the unit vector `direction` meets within `limit` metres, in order.
    pub fn met_by(&self, origin: DVec2, direction: DVec2, limit: f64) -> Vec<usize> {
        let inverse = direction.recip();
        let is_met = |node: &BvhNode| entry(node, origin, inverse, limit).is_some();
        let mut met: Vec<usize> = self.tree.leaves(is_met).map(|leaf| leaf as usize).collect();
        met.sort_unstable();
        met
    }
}

/// Where a ray enters a box within `limit` metres (slab method; `BvhNode::cast_ray` does the same with divisions at every
/// box). `inverse` is of its direction, infinite for rays along an axis: zero times infinity then comes only of a ray on the very edge
/// of a box, and boxes are wider than their content.
#[inline]
pub(super) fn entry(node: &BvhNode, origin: DVec2, inverse: DVec2, limit: f64) -> Option<f64> {
    let (a, b) = ((node.mins() - origin) * inverse, (node.maxs() - origin) * inverse);
    let enter = a.min(b).max_element().max(0.0);
    let leave = a.max(b).min_element().min(limit);
    (enter <= leave).then_some(enter)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ray to the right, one up, one across, and one that ends before: the boxes that they come through, in order.
    #[test]
    fn a_ray_meets_the_boxes_that_it_comes_through() {
        let corner = |i: usize| DVec2::new((i % 10) as f64, (i / 10) as f64);
        let boxes = Boxes::new((0..100).map(|i| [corner(i), corner(i) + DVec2::splat(0.5)]));
        let from = DVec2::new(2.7, 3.25);
        assert_eq!(boxes.met_by(from, DVec2::X, 100.0), [33, 34, 35, 36, 37, 38, 39]);
        assert_eq!(boxes.met_by(from, DVec2::X, 2.0), [33, 34]);
        assert_eq!(boxes.met_by(DVec2::new(4.25, 7.75), DVec2::Y, 9.0), [84, 94]);
        let across = DVec2::new(1.0, 1.0).normalize();
        assert_eq!(boxes.met_by(DVec2::new(6.25, 6.25), across, 9.0), [66, 77, 88, 99]);
        assert!(boxes.met_by(DVec2::new(-1.0, 0.75), DVec2::X, 100.0).is_empty());
    }
}
