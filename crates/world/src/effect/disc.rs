use glam::DVec2;

/// An opaque disc in the map frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Its centre \[m\].
    pub center: DVec2,
    /// Its radius \[m\]; a disc of radius 0 is met by no ray.
    pub radius_m: f64,
}

impl Disc {
    /// Where the ray from `origin` along the unit vector `direction` first meets the disc \[m\]: 0 if it starts inside,
    /// `None` if it misses it or meets it at `limit` or beyond.
    pub fn first_hit(&self, origin: DVec2, direction: DVec2, limit: f64) -> Option<f64> {
        let to_center = self.center - origin;
        let along = to_center.dot(direction);
        let across = to_center.perp_dot(direction);
        let half_chord_squared = self.radius_m * self.radius_m - across * across;
        if half_chord_squared <= 0.0 {
            return None;
        }
        let half_chord = half_chord_squared.sqrt();
        let enter = (along - half_chord).max(0.0);
        (along + half_chord >= 0.0 && enter < limit).then_some(enter)
    }

    /// Angle between the ray and the normal of the disc's edge where it enters \[rad\], 0 to pi/2.
    pub fn incidence(&self, origin: DVec2, direction: DVec2) -> f64 {
        let across = (self.center - origin).perp_dot(direction).abs();
        (across / self.radius_m).min(1.0).asin()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_hit_lies_on_the_edge_and_its_incidence_is_that_to_the_radius(
            x in -3.0..3.0f64, y in -3.0..3.0f64, radius_m in 0.01..1.0f64, heading in -4.0..4.0f64,
        ) {
            let disc = Disc { center: DVec2::new(x, y), radius_m };
            let direction = DVec2::from_angle(heading);
            let inside = disc.center.length() < radius_m;
            match disc.first_hit(DVec2::ZERO, direction, f64::INFINITY) {
                Some(range) if inside => prop_assert_eq!(range, 0.0),
                Some(range) => {
                    let normal = range * direction - disc.center;
                    prop_assert!((normal.length() - radius_m).abs() < 1e-9);
                    let angle = (-direction).angle_to(normal).abs();
                    prop_assert!((disc.incidence(DVec2::ZERO, direction) - angle).abs() < 1e-6);
                    prop_assert_eq!(disc.first_hit(DVec2::ZERO, direction, range), None);
                }
                None => {
                    let nearest = disc.center.dot(direction).max(0.0) * direction;
                    prop_assert!(nearest.distance(disc.center) >= radius_m - 1e-12);
                }
            }
        }
    }

    #[test]
    fn a_disc_without_extent_is_met_by_no_ray() {
        let disc = Disc { center: DVec2::X, radius_m: 0.0 };
        assert_eq!(disc.first_hit(DVec2::ZERO, DVec2::X, 9.0), None);
        assert_eq!(disc.first_hit(DVec2::X, DVec2::X, 9.0), None);
    }
}
