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

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Stage};
    use rand::RngExt;

    use super::*;
    use crate::map::{MeasuredMap, MeasuredWall};

    /// A room with an open door, a thin post and a slanted wall, of which the border of what was seen is farther out.
    fn map() -> ExactRangeMap {
        let wall = |from_m, to_m| MeasuredWall { from_m, to_m, sigma_m: 0.005, hits: 100, hit_share: 1.0 };
        let walls = vec![
            wall([0.0, 0.0], [6.0, 0.0]),
            wall([6.0, 0.0], [6.0, 1.5]),
            wall([6.0, 2.5], [6.0, 4.0]),
            wall([6.0, 4.0], [3.0, 4.6]),
            wall([3.0, 4.6], [0.0, 4.0]),
            wall([0.0, 4.0], [0.0, 0.0]),
            wall([3.0, 2.0], [3.05, 2.0]),
        ];
        let seen = vec![vec![[-0.5, -0.5], [9.0, -0.5], [9.0, 5.0], [-0.5, 5.0]]];
        ExactRangeMap::new(MeasuredMap { seen, walls }.to_geometry().unwrap())
    }

    /// The definition: whole beams to both sides end on the line of the wall that the beam meets.
    fn by_definition(map: &ExactRangeMap, origin: DVec2, heading: f64, max: f64) -> Option<Unsure> {
        let geometry = map.geometry();
        let cast = |heading| {
            let hit = map.cast_segment(origin, DVec2::from_angle(heading), max)?;
            (!geometry.is_unknown(geometry.surfaces()[hit.0])).then_some(hit)
        };
        let Some((segment, range)) = cast(heading) else { return Some(Unsure::Unknown) };
        let [a, b] = geometry.segments()[segment];
        let turn = (END_M / range).max(END_RAD);
        let is_on_line = |heading| {
            cast(heading).is_some_and(|(_, range)| {
                let end = origin + range * DVec2::from_angle(heading);
                (b - a).normalize().perp_dot(end - a).abs() < SAME_WALL_M
            })
        };
        if is_on_line(heading - turn) && is_on_line(heading + turn) { None } else { Some(Unsure::AtEnd) }
    }

    #[test]
    fn a_beam_is_unsure_as_the_definition_says() {
        let map = map();
        let mut rng = Draw::new(4, Stage::Path, 0).item(0);
        let mut counts = [0; 3];
        for _ in 0..20_000 {
            let origin = DVec2::new(0.2 + 5.6 * rng.random::<f64>(), 0.2 + 3.6 * rng.random::<f64>());
            let (heading, max) = (6.3 * rng.random::<f64>(), 1.0 + 9.0 * rng.random::<f64>());
            let hit = map.cast_segment(origin, DVec2::from_angle(heading), max);
            let found = unsure(&map, origin, heading, hit, max);
            assert_eq!(found, by_definition(&map, origin, heading, max), "{origin} {heading} {max}");
            counts[found.map_or(0, |unsure| 1 + usize::from(unsure == Unsure::AtEnd))] += 1;
        }
        assert!(counts.iter().all(|count| *count > 500), "{counts:?}");
    }
}
