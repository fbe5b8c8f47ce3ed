//! Beams of which a measured map doesn't say where they end.

use glam::DVec2;

use super::{ExactRangeMap, RayHit};

/// The ends of a measured wall are known to this \[m\], at long ranges to an angle \[rad\]: about the distance of two readings.
const END_M: f64 = 0.1;
const END_RAD: f64 = 0.01;
/// A beam beside the end of a wall meets the same wall if it ends this near to its line \[m\].
const SAME_WALL_M: f64 = 0.1;

/// Why a beam has no nominal range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsure {
    /// It leaves what was seen.
    Unknown,
    /// It passes the end of a wall.
    AtEnd,
}

/// Why the beam from `origin` \[m\] at `heading` \[rad\] has no nominal range in a measured map up to `max` \[m\]; `None` where it has one.
pub fn unsure(map: &ExactRangeMap, origin: DVec2, heading: f64, max: f64) -> Option<Unsure> {
    let geometry = map.geometry();
    let cast = |heading| map.cast_ray(origin, DVec2::from_angle(heading), max);
    let known = |hit: &RayHit| !geometry.is_unknown(hit.surface);
    let Some(hit) = cast(heading).filter(known) else { return Some(Unsure::Unknown) };
    let [a, b] = geometry.walls()[hit.surface as usize];
    let along = (b - a).normalize();
    let turn = (END_M / hit.range).max(END_RAD);
    let goes_on = [-turn, turn].into_iter().all(|turn| {
        let heading = heading + turn;
        cast(heading).filter(known).is_some_and(|beside| {
            let end = origin + beside.range * DVec2::from_angle(heading);
            along.perp_dot(end - a).abs() < SAME_WALL_M
        })
    });
    if goes_on { None } else { Some(Unsure::AtEnd) }
}
