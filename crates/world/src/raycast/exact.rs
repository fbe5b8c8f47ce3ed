use glam::DVec2;
use locsim_core::{Hits, NO_SURFACE, Poses, RangeMap};
use parry2d_f64::partitioning::{Bvh, BvhNode};

use super::batch::cast_batch;
use super::boxes::entry;
use super::segment::{angle, incidence, range_to, tree_over};
use crate::map::Geometry;

/// Where a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// Distance from the ray's origin \[m\].
    pub range: f64,
    /// Angle between the ray and the surface's normal \[rad\], 0 to pi/2.
    pub incidence: f64,
    /// Id of the surface.
    pub surface: u32,
}

/// A surface nearer than this behind another one \[m\] is that surface itself.
pub const BEHIND_M: f64 = 1e-3;

/// Exact ray casts against the segments of a map, by a tree of bounding boxes (parry's `Bvh`).
///
/// - Walls are seen from both sides: a ray from inside a wall or outside the map hits whatever is in front of it.
/// - Ends belong to their segments, and segments that share an end let no ray pass between them (overlap of
///   1e-9 m).
/// - A ray that starts within 1e-9 m of a segment meets it at range 0.
/// - A ray along a segment meets its nearest point, at incidence pi/2.
/// - A surface at exactly the maximum range is not met.
#[derive(Clone)]
pub struct ExactRangeMap {
    geometry: Geometry,
    /// Direction of each segment \[rad\].
    angles: Vec<f64>,
    tree: Bvh,
}

impl ExactRangeMap {
    /// Builds the tree over the map's segments.
    pub fn new(geometry: Geometry) -> Self {
        let angles = geometry.segments().iter().map(angle).collect();
        let tree = tree_over(geometry.segments());
        Self { geometry, angles, tree }
    }

    /// The map.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Casts one ray from `origin` \[m\] along the unit vector `direction`; `None` if it meets nothing nearer than
    /// `max_range` \[m\], which may be infinite.
    pub fn cast_ray(&self, origin: DVec2, direction: DVec2, max_range: f64) -> Option<RayHit> {
        let hit = self.cast_segment(origin, direction, max_range)?;
        Some(self.hit(hit, direction.to_angle()))
    }

    /// Range \[m\] of the next surface behind the one that a ray meets at `range`: at least [`BEHIND_M`] behind it,
    /// `None` if there is none nearer than `max_range`, or if what was seen ends there.
    pub fn cast_behind(&self, origin: DVec2, direction: DVec2, range: f64, max_range: f64) -> Option<f64> {
        let start = range + BEHIND_M;
        let hit = self.cast_ray(origin + start * direction, direction, max_range - start);
        hit.filter(|hit| !self.geometry().is_unknown(hit.surface)).map(|hit| start + hit.range)
    }

    /// As [`ExactRangeMap::cast_ray`], with segments in the way that the map doesn't know. A hit on one of them
    /// has surface [`NO_SURFACE`].
    pub fn cast_ray_with(
        &self,
        extra: &[[DVec2; 2]],
        origin: DVec2,
        direction: DVec2,
        max_range: f64,
    ) -> Option<RayHit> {
        let heading = direction.to_angle();
        let mut best = self.cast_ray(origin, direction, max_range);
        for segment in extra {
            let nearest = best.map_or(max_range, |hit| hit.range);
            if let Some(range) = range_to(segment, origin, direction).filter(|&range| range < nearest) {
                let incidence = incidence(angle(segment), heading);
                best = Some(RayHit { range, incidence, surface: NO_SURFACE });
            }
        }
        best
    }

    /// A segment met by a ray of this heading \[rad\].
    pub(crate) fn hit(&self, (segment, range): (usize, f64), heading: f64) -> RayHit {
        let incidence = incidence(self.angles[segment], heading);
        RayHit { range, incidence, surface: self.geometry.surfaces()[segment] }
    }

    /// Unit normal of a segment, towards the side that a ray of this direction comes from.
    pub(crate) fn normal(&self, segment: usize, direction: DVec2) -> DVec2 {
        let [a, b] = self.geometry.segments()[segment];
        let normal = (b - a).perp().normalize();
        if normal.dot(direction) > 0.0 { -normal } else { normal }
    }

    /// Index of the segment that a ray meets first, and the range \[m\].
    pub(crate) fn cast_segment(
        &self,
        origin: DVec2,
        direction: DVec2,
        max_range: f64,
    ) -> Option<(usize, f64)> {
        let segments = self.geometry.segments();
        let inverse = direction.recip();
        let enter = |node: &BvhNode, nearest: f64| entry(node, origin, inverse, nearest).unwrap_or(f64::MAX);
        let (leaf, range) = self
            .tree
            .find_best(max_range, enter, |leaf, _| range_to(&segments[leaf as usize], origin, direction))?;
        Some((leaf as usize, range))
    }
}

impl RangeMap for ExactRangeMap {
    fn cast(&self, laser: Poses<'_>, bearings: &[f32], max_range: f32, out: &mut Hits) {
        let max = f64::from(max_range);
        cast_batch(laser, bearings, max_range, out, |origin| {
            move |direction, heading| {
                self.cast_segment(origin, direction, max).map(|hit| self.hit(hit, heading))
            }
        });
    }

    fn is_free(&self, x: f64, y: f64) -> bool {
        self.geometry.is_free(x, y)
    }

    fn bounds(&self) -> [f64; 4] {
        self.geometry.bounds()
    }
}
