//! Beams of which a measured map doesn't say where they end.

use glam::DVec2;

use super::ExactRangeMap;

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

/// Why the beam from `origin` \[m\] at `heading` \[rad\] has no nominal range in a measured map, up to `max` \[m\], which meets
/// its segment `hit` at that range \[m\] first; `None` where it has one.
pub fn unsure(
    map: &ExactRangeMap,
    origin: DVec2,
    heading: f64,
    hit: Option<(usize, f64)>,
    max: f64,
) -> Option<Unsure> {
    let geometry = map.geometry();
    let known = |segment: usize| !geometry.is_unknown(geometry.surfaces()[segment]);
    let Some((segment, range)) = hit.filter(|(segment, _)| known(*segment)) else {
        return Some(Unsure::Unknown);
    };
    let [a, b] = geometry.segments()[segment];
    let across = (b - a).normalize().perp();
    let distance = across.dot(a - origin);
    let turn = (END_M / range).max(END_RAD);
    let goes_on = [-turn, turn].into_iter().all(|turn| {
        let direction = DVec2::from_angle(heading + turn);
        // The wall's line, a little farther out: what is met beyond that is another wall.
        let towards = across.dot(direction);
        let farthest = [-SAME_WALL_M, SAME_WALL_M].map(|beside| (distance + beside) / towards);
        let farthest = farthest[0].max(farthest[1]).min(max);
        farthest > 0.0
            && map.cast_segment(origin, direction, farthest).is_some_and(|(segment, range)| {
                known(segment) && (towards * range - distance).abs() < SAME_WALL_M
            })
    });
    if goes_on { None } else { Some(Unsure::AtEnd) }
}
