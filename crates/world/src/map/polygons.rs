//! Free space between polygons.

use glam::DVec2;

/// The space inside an outline and outside every obstacle. All are closed polygons.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Polygons {
    /// Edges of all polygons.
    corners: usize,
    /// Lower end of the first band \[m\], and bands per metre.
    lowest: f64,
    bands_per_m: f64,
    /// Edges that come into each horizontal band, those of a polygon together: a point is compared with those of its band alone.
    bands: Vec<Vec<Edge>>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Edge {
    /// 0 for the outline, then the obstacles.
    polygon: u32,
    a: DVec2,
    b: DVec2,
}

impl Polygons {
    pub fn new(outline: &[DVec2], obstacles: &[Vec<DVec2>]) -> Self {
        let polygons = std::iter::once(outline).chain(obstacles.iter().map(Vec::as_slice));
        let edges: Vec<Edge> = (0..)
            .zip(polygons)
            .flat_map(|(polygon, ring)| {
                let before = ring.iter().cycle().skip(ring.len().max(1) - 1);
                before.zip(ring).map(move |(&a, &b)| Edge { polygon, a, b })
            })
            .collect();
        let heights = edges.iter().map(|edge| edge.b.y);
        let (lowest, highest) =
            heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), y| (lo.min(y), hi.max(y)));
        let height = (highest - lowest).max(f64::MIN_POSITIVE);
        // A horizontal line crosses so many edges. As many bands as edges by this number hold each edge twice on average.
        let crossed = edges.iter().map(|edge| (edge.a.y - edge.b.y).abs() / height).sum::<f64>().max(1.0);
        let count = (edges.len() as f64 / crossed).ceil().max(1.0);
        let mut polygons = Self {
            corners: edges.len(),
            lowest,
            bands_per_m: count / height,
            bands: vec![Vec::new(); count as usize],
        };
        for edge in edges {
            let (lower, upper) =
                (polygons.band(edge.a.y.min(edge.b.y)), polygons.band(edge.a.y.max(edge.b.y)));
            for band in &mut polygons.bands[lower..=upper] {
                band.push(edge);
            }
        }
        polygons
    }

    /// Number of corners of all polygons.
    pub fn corners(&self) -> usize {
        self.corners
    }

    /// The band of a height; the nearest one for heights beyond all.
    fn band(&self, y: f64) -> usize {
        (((y - self.lowest) * self.bands_per_m) as usize).min(self.bands.len() - 1)
    }

    /// Whether a point is inside the outline and outside every obstacle, by the even-odd rule of each polygon.
    pub fn has_free(&self, point: DVec2) -> bool {
        let of_polygons = self.bands[self.band(point.y)].chunk_by(|a, b| a.polygon == b.polygon);
        let mut is_inside = false;
        for edges in of_polygons {
            let contains = edges.iter().fold(false, |inside, edge| inside ^ edge.is_right_of(point));
            match (edges[0].polygon, contains) {
                (0, contains) => is_inside = contains,
                (_, true) => return false,
                (_, false) => {}
            }
        }
        is_inside
    }
}

impl Edge {
    /// Whether a ray from the point along x crosses it.
    fn is_right_of(&self, point: DVec2) -> bool {
        let Self { a, b, .. } = self;
        (a.y > point.y) != (b.y > point.y) && point.x < a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// By all edges of all polygons.
    fn is_free(polygons: &[Vec<DVec2>], point: DVec2) -> bool {
        let contains = |ring: &Vec<DVec2>| {
            let edges = (0..ring.len()).map(|i| (ring[(i + ring.len() - 1) % ring.len()], ring[i]));
            let crosses = |&(a, b): &(DVec2, DVec2)| {
                (a.y > point.y) != (b.y > point.y)
                    && point.x < a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x)
            };
            edges.filter(crosses).count() % 2 == 1
        };
        contains(&polygons[0]) && !polygons[1..].iter().any(contains)
    }

    /// A room with ragged walls and two hundred pillars, some of which overlap; points everywhere, at corners, on edges and outside.
    #[test]
    fn points_are_free_by_the_edges_of_their_band_as_by_all() {
        let star = |middle: DVec2, corners: u32, size: f64| -> Vec<DVec2> {
            let corner = |i: u32| {
                let radius = size * (1.0 + 0.3 * (2.4 * f64::from(i)).sin());
                middle + radius * DVec2::from_angle(TAU * f64::from(i) / f64::from(corners))
            };
            (0..corners).map(corner).collect()
        };
        let mut polygons = vec![star(DVec2::ZERO, 400, 10.0)];
        polygons.extend((0..200).map(|i| {
            let at = 9.0 * DVec2::new((0.7 * f64::from(i)).sin(), (1.3 * f64::from(i)).cos());
            star(at, 3 + i % 7, 0.3)
        }));
        let free = Polygons::new(&polygons[0], &polygons[1..]);
        assert!(free.bands.len() > 20);
        let grid = (0..90_000).map(|i| {
            DVec2::new(f64::from(i % 300) - 150.0, f64::from(i / 300) - 150.0) * 0.1 + DVec2::new(0.013, 0.0)
        });
        let corners = polygons.iter().flatten().copied();
        let mut counts = [0; 2];
        for point in grid.chain(corners.clone()).chain(corners.map(|corner| corner - DVec2::X)) {
            let expected = is_free(&polygons, point);
            assert_eq!(free.has_free(point), expected, "{point}");
            counts[usize::from(expected)] += 1;
        }
        assert!(counts.iter().all(|&count| count > 10_000), "{counts:?}");
        for point in [DVec2::new(0.0, f64::NAN), DVec2::NAN, DVec2::new(0.0, f64::INFINITY), DVec2::INFINITY]
        {
            assert!(!free.has_free(point), "{point}");
        }
    }
}
