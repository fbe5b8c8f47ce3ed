use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use glam::DVec2;
use locsim_core::limits::{Limits, RANGE_M};
use serde::{Deserialize, Serialize};

use super::geometry::{FreeSpace, bounds_of};
use super::polygons::Polygons;
use super::{COINCIDENT_M, FARTHEST_M, Geometry, MapError};

/// A map of polylines, as written in a vector map file (see the [module](super) for the format). Coordinates are
/// metres in the map frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VectorMap {
    /// The boundary of the floor.
    pub outline: Polyline,
    /// Obstacles on the floor.
    #[serde(default)]
    pub obstacles: Vec<Polyline>,
    /// Walls without thickness.
    #[serde(default)]
    pub walls: Vec<Wall>,
}

/// A closed polyline.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Polyline {
    /// Its name; `outline` or `obstacle-<index>` by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its corners \[m\]; the last is joined to the first.
    pub points_m: Vec<[f64; 2]>,
    /// Names for some of its edges.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub surfaces: Vec<NamedEdges>,
}

/// A named surface: one or more edges of a polyline. Edge `i` runs from point `i` to point `i + 1`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedEdges {
    /// Name of the surface.
    pub name: String,
    /// Indices of its edges.
    pub edges: Vec<usize>,
}

/// A thin wall that can be seen from both sides. It doesn't bound free space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wall {
    /// Name of the surface.
    pub name: String,
    /// One end \[m\].
    pub from_m: [f64; 2],
    /// The other end \[m\].
    pub to_m: [f64; 2],
}

impl VectorMap {
    /// Checks the map and turns it into segments: the outline's edges, each obstacle's edges, the walls, in that
    /// order. Surface ids count up in the order in which surfaces first occur.
    ///
    /// # Errors
    /// [`MapError`] naming the polyline and the point, edge or name that is wrong.
    pub fn to_geometry(&self) -> Result<Geometry, MapError> {
        let limits = Limits::current();
        let polylines = || std::iter::once(&self.outline).chain(&self.obstacles);
        let corners = polylines().map(|polyline| polyline.points_m.len() as u64).sum();
        if corners > limits.map_corners {
            return Err(MapError::TooMany(limits.refusal("map_corners", corners)));
        }
        let segments = corners + self.walls.len() as u64;
        if segments > limits.map_segments {
            return Err(MapError::TooMany(limits.refusal("map_segments", segments)));
        }
        let mut builder = Builder::default();
        let outline = builder.add_polyline(&self.outline, "outline")?;
        check_outline(self.outline.name.as_deref().unwrap_or("outline"), &outline)?;
        let mut obstacles = Vec::with_capacity(self.obstacles.len());
        for (i, obstacle) in self.obstacles.iter().enumerate() {
            obstacles.push(builder.add_polyline(obstacle, &format!("obstacle-{i}"))?);
        }
        let [x0, y0, x1, y1] = bounds_of(outline.iter().copied());
        let is_in_reach = |p: DVec2| {
            let beyond = DVec2::new(x0, y0) - p;
            beyond.max(p - DVec2::new(x1, y1)).max_element() <= RANGE_M
        };
        for wall in &self.walls {
            builder.claim_name(&wall.name, &wall.name)?;
            let ends = finite_points(&wall.name, &[wall.from_m, wall.to_m])?;
            if let Some(point) = ends.iter().position(|end| !is_in_reach(*end)) {
                let value = ends[point].to_array();
                return Err(MapError::OutOfReach { wall: wall.name.clone(), point, value });
            }
            let surface = builder.new_surface(wall.name.clone());
            builder.add(&wall.name, &ends, 0, surface)?;
        }
        let bounds = bounds_of(builder.segments.iter().flatten().copied());
        let free = FreeSpace::Polygons(Polygons::new(&outline, &obstacles));
        Ok(Geometry::new(builder.segments, builder.surfaces, builder.surface_names, bounds, free))
    }
}

/// A geometry under construction.
#[derive(Default)]
struct Builder {
    segments: Vec<[DVec2; 2]>,
    surfaces: Vec<u32>,
    surface_names: Vec<String>,
    /// Names of polylines and of surfaces share one name space, since an unnamed edge is called after its
    /// polyline.
    names: BTreeSet<String>,
}

impl Builder {
    /// Adds a polyline's edges; returns its corners.
    fn add_polyline(&mut self, polyline: &Polyline, default_name: &str) -> Result<Vec<DVec2>, MapError> {
        let name = polyline.name.as_deref().unwrap_or(default_name);
        self.claim_name(name, name)?;
        let points = finite_points(name, &polyline.points_m)?;
        if points.len() < 3 {
            return Err(MapError::TooFewPoints { polyline: name.to_owned(), points: points.len() });
        }
        let mut surface_of_edge = BTreeMap::new();
        for surface in &polyline.surfaces {
            self.claim_name(&surface.name, name)?;
            for &edge in &surface.edges {
                if edge >= points.len() {
                    return Err(MapError::NoSuchEdge {
                        polyline: name.to_owned(),
                        name: surface.name.clone(),
                        edge,
                        last: points.len() - 1,
                    });
                }
                match surface_of_edge.entry(edge) {
                    Entry::Vacant(slot) => slot.insert(surface.name.as_str()),
                    Entry::Occupied(slot) => {
                        return Err(MapError::EdgeNamedTwice {
                            polyline: name.to_owned(),
                            edge,
                            first: (*slot.get()).to_owned(),
                            second: surface.name.clone(),
                        });
                    }
                };
            }
        }
        let mut ids = BTreeMap::new();
        for edge in 0..points.len() {
            let surface = match surface_of_edge.get(&edge) {
                Some(&surface) => *ids.entry(surface).or_insert_with(|| self.new_surface(surface.to_owned())),
                None => self.new_surface(format!("{name}/{edge}")),
            };
            self.add(name, &points, edge, surface)?;
        }
        Ok(points)
    }

    /// Adds the edge from point `i` to the next, cyclically.
    fn add(&mut self, polyline: &str, points: &[DVec2], i: usize, surface: u32) -> Result<(), MapError> {
        let next = (i + 1) % points.len();
        if points[i].distance(points[next]) < COINCIDENT_M {
            return Err(MapError::ZeroLengthEdge { polyline: polyline.to_owned(), point: i, next });
        }
        self.segments.push([points[i], points[next]]);
        self.surfaces.push(surface);
        Ok(())
    }

    fn new_surface(&mut self, name: String) -> u32 {
        self.surface_names.push(name);
        self.surface_names.len() as u32 - 1
    }

    fn claim_name(&mut self, name: &str, polyline: &str) -> Result<(), MapError> {
        if self.names.insert(name.to_owned()) {
            return Ok(());
        }
        Err(MapError::DuplicateName { name: name.to_owned(), polyline: polyline.to_owned() })
    }
}

/// Checks that an outline has an area and doesn't cross itself. Edges may touch.
fn check_outline(name: &str, points: &[DVec2]) -> Result<(), MapError> {
    let polyline = || name.to_owned();
    let edge = |i: usize| [points[i], points[(i + 1) % points.len()]];
    let around: f64 = (0..points.len()).map(|i| edge(i)[0].distance(edge(i)[1])).sum();
    // From the first point, as coordinates may be far from 0.
    let area: f64 =
        (0..points.len()).map(|i| (edge(i)[0] - points[0]).perp_dot(edge(i)[1] - points[0])).sum();
    let order = edges_from_left(points);
    for (k, &i) in order.iter().enumerate() {
        let right = edge(i)[0].x.max(edge(i)[1].x);
        // Edges that begin farther right don't reach this one.
        let near = order[k + 1..].iter().take_while(|&&j| edge(j)[0].x.min(edge(j)[1].x) <= right);
        if let Some(&j) = near.into_iter().find(|&&j| do_cross(edge(i), edge(j))) {
            return Err(MapError::Crosses { polyline: polyline(), edges: [i.min(j), i.max(j)] });
        }
    }
    if area.abs() <= COINCIDENT_M * around { Err(MapError::NoArea { polyline: polyline() }) } else { Ok(()) }
}

/// The edges of a closed polyline, ordered by their left ends.
fn edges_from_left(points: &[DVec2]) -> Vec<usize> {
    let left = |i: usize| points[i].x.min(points[(i + 1) % points.len()].x);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&i, &j| left(i).total_cmp(&left(j)));
    order
}

/// Whether two lines cross each other, each with both ends clearly off the other.
fn do_cross(one: [DVec2; 2], other: [DVec2; 2]) -> bool {
    let are_apart = |[a, b]: [DVec2; 2], ends: [DVec2; 2]| {
        let along = (b - a).normalize();
        let [first, second] = ends.map(|end| along.perp_dot(end - a));
        first.abs() > COINCIDENT_M && second.abs() > COINCIDENT_M && (first > 0.0) != (second > 0.0)
    };
    are_apart(one, other) && are_apart(other, one)
}

pub(super) fn finite_points(polyline: &str, points: &[[f64; 2]]) -> Result<Vec<DVec2>, MapError> {
    points
        .iter()
        .enumerate()
        .map(|(point, &value)| {
            let p = DVec2::from_array(value);
            if !p.is_finite() {
                return Err(MapError::NotFinite { polyline: polyline.to_owned(), point, value });
            }
            if p.abs().max_element() > FARTHEST_M {
                return Err(MapError::TooFar { polyline: polyline.to_owned(), point, value });
            }
            Ok(p)
        })
        .collect()
}
