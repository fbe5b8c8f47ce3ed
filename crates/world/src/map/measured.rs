use glam::DVec2;
use locsim_core::limits::Limits;
use serde::Deserialize;

use super::geometry::{FreeSpace, bounds_of};
use super::polygons::Polygons;
use super::{COINCIDENT_M, FARTHEST_M, Geometry, MapError};

/// A wall has a nominal range when at least this share of the beams that reach it end there: then their median ends there.
const NOMINAL_SHARE: f64 = 0.5;

/// The lengths that are allowed: 0 to [`FARTHEST_M`].
const LENGTH: &str = "a length of 0 to 10000000 (m)";

/// The name of the surface around what was seen.
const UNKNOWN: &str = "unknown";

/// A map made from measured scans: walls as thin as they were seen, and the area that was seen at all (see the
/// [module](super) for the format). Coordinates are metres in the map frame.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredMap {
    /// Closed polylines \[m\]: around what was seen, then around each part within that was not.
    pub seen: Vec<Vec<[f64; 2]>>,
    /// The walls.
    pub walls: Vec<MeasuredWall>,
}

/// One face of a wall.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeasuredWall {
    /// One end \[m\]; the laser stood left of the line from here to the other.
    pub from_m: [f64; 2],
    /// The other end \[m\].
    pub to_m: [f64; 2],
    /// Standard deviation of the wall's offset across \[m\].
    pub sigma_m: f64,
    /// How many readings end on it.
    pub hits: u32,
    /// Share of these among the beams that reached the wall: little for glass, or what stood there for a while.
    pub hit_share: f64,
}

impl MeasuredMap {
    /// The wall segments, then the border of what was seen as one surface called `unknown`. A wall that most beams pass
    /// is left out: it has no nominal range.
    ///
    /// # Errors
    /// [`MapError`] naming the polyline or wall and the point that is wrong.
    pub fn to_geometry(&self) -> Result<Geometry, MapError> {
        let limits = Limits::current();
        let corners = self.seen.iter().map(|ring| ring.len() as u64).sum::<u64>();
        if corners > limits.map_corners {
            return Err(MapError::TooMany(limits.refusal("map_corners", corners)));
        }
        let count = corners + self.walls.len() as u64;
        if count > limits.map_segments {
            return Err(MapError::TooMany(limits.refusal("map_segments", count)));
        }
        let mut segments = Vec::new();
        let mut names = Vec::new();
        let (mut sigmas, mut hit_shares) = (Vec::new(), Vec::new());
        for (i, wall) in self.walls.iter().enumerate() {
            let name = format!("wall-{i}");
            let ends = super::finite_points(&name, &[wall.from_m, wall.to_m])?;
            if ends[0].distance(ends[1]) < COINCIDENT_M {
                return Err(MapError::ZeroLengthEdge { polyline: name, point: 0, next: 1 });
            }
            let is_length = |value: f64| (0.0..=FARTHEST_M).contains(&value);
            for (key, value, is_allowed, allowed) in [
                ("sigma_m", wall.sigma_m, is_length(wall.sigma_m), LENGTH),
                ("hit_share", wall.hit_share, (0.0..=1.0).contains(&wall.hit_share), "a share, 0 to 1"),
            ] {
                if !is_allowed {
                    return Err(MapError::Wall { wall: name, key, value, allowed });
                }
            }
            if wall.hit_share >= NOMINAL_SHARE {
                segments.push([ends[0], ends[1]]);
                names.push(name);
                sigmas.push(wall.sigma_m);
                hit_shares.push(wall.hit_share);
            }
        }
        let mut surfaces: Vec<u32> = (0..segments.len() as u32).collect();
        let mut rings = Vec::new();
        for (i, ring) in self.seen.iter().enumerate() {
            let name = format!("seen-{i}");
            let points = super::finite_points(&name, ring)?;
            if points.len() < 3 {
                return Err(MapError::TooFewPoints { polyline: name, points: points.len() });
            }
            for (point, ends) in edges(&points).enumerate() {
                if ends[0].distance(ends[1]) < COINCIDENT_M {
                    let next = (point + 1) % points.len();
                    return Err(MapError::ZeroLengthEdge { polyline: name, point, next });
                }
                segments.push(ends);
                surfaces.push(names.len() as u32);
            }
            rings.push(points);
        }
        if rings.is_empty() {
            return Err(MapError::TooFewPoints { polyline: "seen-0".to_owned(), points: 0 });
        }
        let walls = names.len();
        names.push(UNKNOWN.to_owned());
        let bounds = bounds_of(segments.iter().flatten().copied());
        let free = FreeSpace::Polygons(Polygons::new(&rings[0], &rings[1..]));
        let geometry = Geometry::new(segments, surfaces, names, bounds, free);
        Ok(geometry.with_walls(walls).with_measured(sigmas, hit_shares))
    }

    /// The map as a file: one line for each polyline, in millimetres, and each wall, in tenths of them.
    pub fn to_yaml(&self) -> String {
        let ring = |ring: &Vec<[f64; 2]>| {
            let points: Vec<String> = ring.iter().map(|[x, y]| format!("[{x:.3}, {y:.3}]")).collect();
            format!("  - [{}]", points.join(", "))
        };
        let wall = |wall: &MeasuredWall| {
            let MeasuredWall { from_m: [x0, y0], to_m: [x1, y1], sigma_m, hits, hit_share } = wall;
            format!(
                "  - {{from_m: [{x0:.4}, {y0:.4}], to_m: [{x1:.4}, {y1:.4}], sigma_m: {sigma_m:.4}, hits: {hits}, \
                 hit_share: {hit_share:.3}}}"
            )
        };
        let mut lines =
            vec!["# Walls from measured scans, and the border of the area that was seen.".to_owned()];
        lines.push("seen:".to_owned());
        lines.extend(self.seen.iter().map(ring));
        lines.push(if self.walls.is_empty() { "walls: []" } else { "walls:" }.to_owned());
        lines.extend(self.walls.iter().map(wall));
        lines.push(String::new());
        lines.join("\n")
    }
}

/// The edges of a closed polyline.
fn edges(points: &[DVec2]) -> impl Iterator<Item = [DVec2; 2]> {
    points.iter().zip(points.iter().cycle().skip(1)).map(|(a, b)| [*a, *b])
}
