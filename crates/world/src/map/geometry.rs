use glam::DVec2;

use super::polygons::Polygons;
use super::{Cell, OccupancyGrid};

/// The wall segments of a map with the surfaces they belong to, and the map's free space.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    segments: Vec<[DVec2; 2]>,
    surfaces: Vec<u32>,
    surface_names: Vec<String>,
    bounds: [f64; 4],
    free: FreeSpace,
    /// The segments from here on are the border of what is known.
    walls: usize,
    /// Standard deviation of each wall's offset across \[m\]; empty where walls are taken for exact.
    sigmas: Vec<f64>,
    /// Share of the beams reaching each wall that ended on it; empty of a map that wasn't measured.
    hit_shares: Vec<f64>,
}

/// Where a robot can stand.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum FreeSpace {
    /// Inside the outline and outside every obstacle.
    Polygons(Polygons),
    /// In a free cell.
    Grid(OccupancyGrid),
}

impl Geometry {
    /// `surfaces[i]` is the surface of segment `i`, an index into `surface_names`.
    pub(super) fn new(
        segments: Vec<[DVec2; 2]>,
        surfaces: Vec<u32>,
        surface_names: Vec<String>,
        bounds: [f64; 4],
        free: FreeSpace,
    ) -> Self {
        debug_assert_eq!(segments.len(), surfaces.len());
        let walls = segments.len();
        Self {
            segments,
            surfaces,
            surface_names,
            bounds,
            free,
            walls,
            sigmas: Vec::new(),
            hit_shares: Vec::new(),
        }
    }

    /// The same with walls that were measured: of each the standard deviation of the offset across \[m\], and the share of the
    /// beams reaching it that ended on it.
    pub(super) fn with_measured(self, sigmas: Vec<f64>, hit_shares: Vec<f64>) -> Self {
        debug_assert_eq!([sigmas.len(), hit_shares.len()], [self.walls; 2]);
        Self { sigmas, hit_shares, ..self }
    }

    /// The same with only the first `walls` segments being walls, and the others the border of what is known. No surface
    /// has segments of both kinds.
    pub(super) fn with_walls(self, walls: usize) -> Self {
        debug_assert!(walls <= self.segments.len());
        Self { walls, ..self }
    }

    /// Everything that ends a ray: the wall segments, then the border of what is known. End points are in the map
    /// frame \[m\]; no segment has length zero.
    pub fn segments(&self) -> &[[DVec2; 2]] {
        &self.segments
    }

    /// The wall segments without the border of what is known \[m\].
    pub fn walls(&self) -> &[[DVec2; 2]] {
        &self.segments[..self.walls]
    }

    /// Whether the straight way between two points crosses a wall, ends on it or leads along it.
    pub fn is_crossed(&self, from: DVec2, to: DVec2) -> bool {
        let way = to - from;
        self.walls().iter().any(|[a, b]| {
            let along = *b - *a;
            let sides = [
                way.perp_dot(*a - from) * way.perp_dot(*b - from),
                along.perp_dot(from - *a) * along.perp_dot(to - *a),
            ];
            let is_along = way.perp_dot(*a - from) == 0.0 && way.perp_dot(*b - from) == 0.0;
            let ends = [*a, *b].map(|end| way.dot(end - from));
            let overlaps = ends[0].max(ends[1]) > 0.0 && ends[0].min(ends[1]) < way.length_squared();
            (sides[0] < 0.0 && sides[1] <= 0.0) || (is_along && overlaps)
        })
    }

    /// Standard deviation of the offset across of each of [`Geometry::walls`] \[m\]; empty of a map whose walls are taken for
    /// exact.
    pub fn wall_sigmas(&self) -> &[f64] {
        &self.sigmas
    }

    /// Share of the beams reaching each of [`Geometry::walls`] that ended on it; empty of a map that wasn't measured.
    pub fn hit_shares(&self) -> &[f64] {
        &self.hit_shares
    }

    /// Whether a surface is the border of what is known: a ray that meets it has no nominal range, and a reading of its
    /// beam says nothing about the map.
    pub fn is_unknown(&self, surface: u32) -> bool {
        self.unknown() == Some(surface)
    }

    /// The surface that is the border of what is known, if the map has one.
    pub(crate) fn unknown(&self) -> Option<u32> {
        self.surfaces.get(self.walls).copied()
    }

    /// Surface id of each segment: an index into [`Geometry::surface_names`].
    pub fn surfaces(&self) -> &[u32] {
        &self.surfaces
    }

    /// The name of each surface.
    pub fn surface_names(&self) -> &[String] {
        &self.surface_names
    }

    /// Lower and upper corner of the map \[x0, y0, x1, y1\] \[m\].
    pub fn bounds(&self) -> [f64; 4] {
        self.bounds
    }

    /// How many corners of polygons [`Geometry::is_free`] compares a point with at the most; none in an occupancy grid.
    pub(crate) fn corners_of_free_space(&self) -> usize {
        match &self.free {
            FreeSpace::Polygons(polygons) => polygons.corners(),
            FreeSpace::Grid(_) => 0,
        }
    }

    /// Total length of the wall segments \[m\].
    pub fn wall_length_m(&self) -> f64 {
        self.walls().iter().map(|[a, b]| a.distance(*b)).sum()
    }

    /// Whether a point \[m\] is in free space: inside the outline and outside the obstacles of a vector map, in a
    /// free cell of an occupancy grid (an unknown cell is not free). Points on a wall may count either way.
    pub fn is_free(&self, x: f64, y: f64) -> bool {
        match &self.free {
            FreeSpace::Polygons(polygons) => polygons.has_free(DVec2::new(x, y)),
            FreeSpace::Grid(grid) => grid.cell_at(x, y) == Some(Cell::Free),
        }
    }
}

/// The smallest box around the points \[x0, y0, x1, y1\] \[m\].
pub(super) fn bounds_of(points: impl IntoIterator<Item = DVec2>) -> [f64; 4] {
    let (lower, upper) = points
        .into_iter()
        .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lower, upper), p| (lower.min(p), upper.max(p)));
    [lower.x, lower.y, upper.x, upper.y]
}
