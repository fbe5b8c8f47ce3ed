use glam::DVec2;

/// A solid rectangle of any orientation, in the form that rays are cast at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rectangle {
    /// Centre \[m\].
    center: DVec2,
    /// Unit vector along the length.
    axis: DVec2,
    /// Half the length and half the width \[m\].
    half: DVec2,
    /// Radius of the circle through the corners \[m\].
    radius: f64,
}

impl Rectangle {
    /// `axis` is a unit vector along the length, `half` half the length and half the width \[m\].
    pub fn new(center: DVec2, axis: DVec2, half: DVec2) -> Self {
        Self { center, axis, half, radius: half.length() }
    }

    /// Its corners, counter-clockwise \[m\].
    pub fn corners(&self) -> [DVec2; 4] {
        let length = self.half.x * self.axis;
        let width = self.half.y * self.axis.perp();
        [-length - width, length - width, length + width, -length + width].map(|corner| self.center + corner)
    }

    /// Centre \[m\] and radius \[m\] of the circle through the corners.
    pub fn circle(&self) -> (DVec2, f64) {
        (self.center, self.radius)
    }

    /// Distance from a point to the rectangle \[m\], 0 inside it.
    pub fn distance_to(&self, point: DVec2) -> f64 {
        let offset = self.to_local(point - self.center);
        (offset.abs() - self.half).max(DVec2::ZERO).length()
    }

    /// Where the ray from `origin` along the unit vector `direction` first meets the rectangle \[m\]: 0 if it
    /// starts inside, `None` if it misses it or meets it at `limit` or beyond.
    #[inline]
    pub fn first_hit(&self, origin: DVec2, direction: DVec2, limit: f64) -> Option<f64> {
        let to_center = self.center - origin;
        let along = to_center.dot(direction);
        if to_center.perp_dot(direction).abs() > self.radius
            || along < -self.radius
            || along - self.radius >= limit
        {
            return None;
        }
        let start = -self.to_local(to_center);
        let step = self.to_local(direction);
        let (enter_x, exit_x) = slab(start.x, step.x, self.half.x);
        let (enter_y, exit_y) = slab(start.y, step.y, self.half.y);
        let enter = enter_x.max(enter_y).max(0.0);
        let exit = exit_x.min(exit_y);
        (enter <= exit && enter < limit).then_some(enter)
    }

    /// A vector of the map frame in the rectangle's own axes.
    fn to_local(self, vector: DVec2) -> DVec2 {
        DVec2::new(self.axis.dot(vector), self.axis.perp_dot(vector))
    }
}

/// Where a line `start + t step` enters and leaves the strip from `-half` to `half`.
///
/// A line along the strip gives infinities of the right signs. Exactly on the strip's edge one of them is a
/// NaN, which `min` and `max` ignore: the line counts as outside.
fn slab(start: f64, step: f64, half: f64) -> (f64, f64) {
    let inverse = step.recip();
    let (a, b) = ((-half - start) * inverse, (half - start) * inverse);
    (a.min(b), a.max(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rectangle() -> impl Strategy<Value = Rectangle> {
        (-2.0..2.0, -2.0..2.0, -4.0..4.0, 0.01..1.0, 0.01..1.0).prop_map(|(x, y, yaw, a, b)| {
            Rectangle::new(DVec2::new(x, y), DVec2::from_angle(yaw), DVec2::new(a, b))
        })
    }

    /// First intersection with the four edges as segments: another way to the same answer.
    fn by_edges(rectangle: &Rectangle, origin: DVec2, direction: DVec2) -> Option<f64> {
        let corners = rectangle.corners();
        (0..4)
            .filter_map(|i| {
                let (a, edge) = (corners[i], corners[(i + 1) % 4] - corners[i]);
                let t = (a - origin).perp_dot(edge) / direction.perp_dot(edge);
                let s = (a - origin).perp_dot(direction) / direction.perp_dot(edge);
                (t >= 0.0 && (0.0..=1.0).contains(&s)).then_some(t)
            })
            .min_by(f64::total_cmp)
    }

    proptest! {
        #[test]
        fn a_ray_meets_the_nearest_edge(
            r in rectangle(), x in -3.0..3.0f64, y in -3.0..3.0f64, angle in -4.0..4.0f64,
        ) {
            let (origin, direction) = (DVec2::new(x, y), DVec2::from_angle(angle));
            let hit = r.first_hit(origin, direction, f64::INFINITY);
            if r.distance_to(origin) == 0.0 {
                prop_assert_eq!(hit, Some(0.0));
            } else {
                match (hit, by_edges(&r, origin, direction)) {
                    (Some(hit), Some(edge)) => prop_assert!((hit - edge).abs() < 1e-9, "{} {}", hit, edge),
                    (hit, edge) => prop_assert_eq!(hit, edge),
                }
            }
        }

        #[test]
        fn a_hit_is_no_nearer_than_the_distance_and_lies_on_the_rectangle(
            r in rectangle(), x in -3.0..3.0f64, y in -3.0..3.0f64, angle in -4.0..4.0f64,
        ) {
            let (origin, direction) = (DVec2::new(x, y), DVec2::from_angle(angle));
            if let Some(hit) = r.first_hit(origin, direction, f64::INFINITY) {
                prop_assert!(hit >= r.distance_to(origin) - 1e-12);
                prop_assert!(r.distance_to(origin + hit * direction) < 1e-12);
                prop_assert_eq!(r.first_hit(origin, direction, hit), None);
            }
        }
    }

    #[test]
    fn rays_along_the_axes_meet_the_near_side() {
        let r = Rectangle::new(DVec2::new(2.0, 0.0), DVec2::X, DVec2::new(0.5, 0.25));
        for y in [-0.2499, 0.0, 0.2499] {
            assert_eq!(r.first_hit(DVec2::new(0.0, y), DVec2::X, 9.0), Some(1.5));
        }
        for y in [-0.26, -0.25, 0.25, 0.26] {
            assert_eq!(r.first_hit(DVec2::new(0.0, y), DVec2::X, 9.0), None, "along an edge or beside it");
        }
        assert_eq!(r.first_hit(DVec2::new(4.0, 0.0), DVec2::X, 9.0), None, "behind the ray");
        assert_eq!(r.first_hit(DVec2::ZERO, DVec2::X, 1.5), None, "at the limit");
    }
}
