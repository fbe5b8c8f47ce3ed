//! The walls that a ray from a cell of the plane can meet in a bin of headings: one wall, or two and the corner between
//! them.

use glam::DVec2;
use wide::f32x4;

/// Two walls and the corner that divides the rays between them, shared by all cells and bins that see the same.
///
/// A ray that passes clockwise of the corner meets the first wall, any other the second. That is exact for the corner
/// between two walls as for a wall's end in front of another wall, wherever the ray comes from. Where one wall is
/// all that is seen, both are that wall.
///
/// A wall is its line, the points q with normal . q = offset; no wall at all is a line without normal, which makes
/// every range infinite.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Sight {
    /// The corner's x and y, the first wall's offset, the second's \[m\].
    corner_and_offsets: f32x4,
    /// x and y of the first wall's unit normal, of the second's.
    normals: f32x4,
}

/// Stands for "no wall" among the indices of wall segments.
pub(super) const NOTHING: u32 = u32::MAX;

/// A sight by the segments it is made of: clockwise wall, other wall, and which end of which of the two is the corner
/// (bit 0: the end, bit 1: the wall).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct SightKey {
    pub walls: [u32; 2],
    pub corner: u32,
}

/// Whether a ray meets the second wall of a sight: it passes counter-clockwise of the corner, or through it.
pub(super) fn is_beyond(corner: DVec2, origin: DVec2, direction: DVec2) -> bool {
    direction.perp_dot(corner - origin) <= 0.0
}

impl SightKey {
    /// One wall, or nothing, is all that is seen.
    pub const fn single(wall: u32) -> Self {
        Self { walls: [wall, wall], corner: 0 }
    }

    /// The corner \[m\]; any point where one wall is all that is seen.
    pub fn corner(&self, segments: &[[DVec2; 2]]) -> DVec2 {
        let wall = self.walls[(self.corner >> 1) as usize];
        segments.get(wall as usize).map_or(DVec2::ZERO, |ends| ends[(self.corner & 1) as usize])
    }

    /// The sight for queries, in coordinates relative to `origin` \[m\].
    pub fn sight(&self, segments: &[[DVec2; 2]], origin: DVec2) -> Sight {
        let corner = self.corner(segments) - origin;
        let [first, second] = self.walls.map(|wall| {
            segments.get(wall as usize).map_or((DVec2::ZERO, 1.0), |[a, b]| {
                let normal = (*b - *a).normalize().perp();
                (normal, normal.dot(*a - origin))
            })
        });
        let lanes = |values: [f64; 4]| f32x4::new(values.map(|value| value as f32));
        Sight {
            corner_and_offsets: lanes([corner.x, corner.y, first.1, second.1]),
            normals: lanes([first.0.x, first.0.y, second.0.x, second.0.y]),
        }
    }
}

/// Hits of four rays from one point.
pub(super) struct RunHits {
    /// Distance along the ray \[m\]; negative, infinite or NaN where the wall's line isn't ahead.
    pub range: f32x4,
    /// Cosine of the incidence angle.
    pub cosine: f32x4,
    /// Sine of the incidence angle.
    pub sine: f32x4,
    /// Whether it is the first wall: all bits or none.
    pub first: f32x4,
    /// The segment, where it was found in a list of walls; [`NOTHING`] otherwise.
    pub listed: [u32; 4],
}

impl Sight {
    /// Nothing to meet.
    pub const NOTHING: Self = Self { corner_and_offsets: f32x4::ONE, normals: f32x4::ZERO };

    /// Four rays, each with its own sight, from `[x, y]` \[m\] along unit vectors.
    #[inline]
    pub fn meet(sights: [&Self; 4], [x, y]: [f32; 2], direction: [f32x4; 2]) -> RunHits {
        let [corner_x, corner_y, first, second] =
            f32x4::transpose(sights.map(|sight| sight.corner_and_offsets));
        let [first_x, first_y, second_x, second_y] = f32x4::transpose(sights.map(|sight| sight.normals));
        let [ahead, left] = direction;
        let side = ahead * (corner_y - y) - left * (corner_x - x);
        let is_first = side.simd_gt(f32x4::ZERO);
        let offset = is_first.bitselect(first, second);
        let normal_x = is_first.bitselect(first_x, second_x);
        let normal_y = is_first.bitselect(first_y, second_y);
        let cosine = normal_x * ahead + normal_y * left;
        RunHits {
            range: (offset - normal_x * x - normal_y * y) / cosine,
            cosine: cosine.abs(),
            sine: (normal_x * left - normal_y * ahead).abs(),
            first: is_first,
            listed: [NOTHING; 4],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_divides_the_rays() {
        // A near wall from (1, 0) to (1, 2), whose end at (1, 2) hides part of a far wall at x = 3.
        let segments =
            [[DVec2::new(1.0, 0.0), DVec2::new(1.0, 2.0)], [DVec2::new(3.0, -9.0), DVec2::new(3.0, 9.0)]];
        let key = SightKey { walls: [0, 1], corner: 0b01 };
        assert_eq!(key.corner(&segments), DVec2::new(1.0, 2.0));
        let origin = DVec2::new(0.5, 0.5);
        let sight = key.sight(&segments, DVec2::new(-2.0, -2.0));
        let meet = |sight: &Sight, direction: DVec2| {
            let lanes = [direction.x, direction.y].map(|v| f32x4::splat(v as f32));
            let met = Sight::meet([sight; 4], [2.5, 2.5], lanes);
            [met.range, met.cosine].map(|v| v.to_array()[0])
        };
        for (direction, wall, range) in [((0.5, 1.49), 0, 0.5), ((0.5, 1.51), 1, 2.5)] {
            let direction = DVec2::new(direction.0, direction.1);
            let second = is_beyond(key.corner(&segments), origin, direction);
            assert_eq!(key.walls[usize::from(second)], wall);
            let [met, cosine] = meet(&sight, direction.normalize());
            assert!((f64::from(met) - range / 0.5 * direction.length()).abs() < 1e-5);
            assert!((f64::from(cosine) - 0.5 / direction.length()).abs() < 1e-6);
        }
        let nothing = SightKey::single(NOTHING).sight(&segments, origin);
        assert_eq!(meet(&nothing, DVec2::X)[0], f32::INFINITY);
    }
}
