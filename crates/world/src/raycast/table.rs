use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec2;
use locsim_core::{Hits, Poses, RangeMap};

use super::batch::cast_batch;
use super::build::{Lists, build};
use super::segment::range_to;
use super::{ExactRangeMap, RayHit};
use crate::map::{CellFrame, MapError};

/// Fast ray casts: a table tells, for each cell of the plane and bin of headings, which few segments a ray can meet,
/// and the ray is intersected with those alone.
///
/// The lists hold every segment that exact casts meet from the corners and the centre of the cell, in the
/// directions of the edges and the centre of the bin. So a range is exact, unless the nearest segment shows only in
/// a sliver between these casts and a listed segment stands behind it. A ray that meets no listed segment, or
/// starts outside the map's free space, is cast exactly.
pub struct SurfaceTable {
    map: ExactRangeMap,
    walls: Vec<Wall>,
    frame: CellFrame,
    /// A power of two.
    headings: usize,
    /// Per row, column and heading bin: the number of its list.
    entries: Vec<u32>,
    lists: Lists,
}

/// A segment with what a query needs of it, side by side in memory.
struct Wall {
    ends: [DVec2; 2],
    /// Direction of the segment [rad], in \[0, pi).
    direction: f64,
    surface: u32,
}

impl SurfaceTable {
    /// Builds the table in parallel: cells of `cell_m` metres, and `headings` bins of heading (rounded up to a power
    /// of two). 0.05 m and 128 suit corridors and offices.
    ///
    /// # Errors
    /// [`MapError`] when the cell size is not positive or the table would be too large.
    pub fn new(map: &ExactRangeMap, cell_m: f64, headings: usize) -> Result<Self, MapError> {
        Self::with_progress(map, cell_m, headings, &|_| ())
    }

    /// As [`SurfaceTable::new`]; `progress` hears from several threads which share of the table is done, 0 to 1.
    ///
    /// # Errors
    /// As [`SurfaceTable::new`].
    pub fn with_progress(
        map: &ExactRangeMap,
        cell_m: f64,
        headings: usize,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<Self, MapError> {
        let headings = headings.max(4).next_power_of_two();
        let frame = CellFrame::covering(map.bounds(), cell_m, headings)?;
        let (entries, lists) = build(map, &frame, headings, progress);
        let geometry = map.geometry();
        let walls = geometry
            .segments()
            .iter()
            .zip(geometry.surfaces())
            .map(|(&ends, &surface)| Wall {
                ends,
                direction: (ends[1] - ends[0]).to_angle().rem_euclid(PI),
                surface,
            })
            .collect();
        Ok(Self { map: map.clone(), walls, frame, headings, entries, lists })
    }

    /// The map that the table was built from.
    pub fn exact(&self) -> &ExactRangeMap {
        &self.map
    }

    /// Size of the table in memory [bytes].
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.entries) + self.lists.bytes() + size_of_val(&*self.walls)
    }

    /// The list numbers of a cell, one per heading bin; `None` outside the map.
    fn cell(&self, origin: DVec2) -> Option<&[u32]> {
        let p = (origin - DVec2::new(self.frame.x0, self.frame.y0)) / self.frame.cell_m;
        // False for NaN too.
        let inside =
            p.x >= 0.0 && p.y >= 0.0 && p.x < self.frame.columns as f64 && p.y < self.frame.rows as f64;
        inside.then(|| {
            let start = (p.y as usize * self.frame.columns + p.x as usize) * self.headings;
            &self.entries[start..start + self.headings]
        })
    }

    /// The nearest of the listed segments. `heading` is above -2 pi.
    #[inline]
    fn nearest_listed(&self, cell: &[u32], origin: DVec2, direction: DVec2, heading: f64) -> Option<RayHit> {
        let heading = heading + TAU;
        let bin = (heading * (self.headings as f64 / TAU)) as usize & (self.headings - 1);
        let mut nearest = None;
        let mut range = f64::INFINITY;
        for &candidate in self.lists.get(cell[bin]) {
            let wall = &self.walls[candidate as usize];
            if let Some(r) = range_to(&wall.ends, origin, direction)
                && r < range
            {
                (range, nearest) = (r, Some(wall));
            }
        }
        nearest.map(|wall| {
            let turned = heading + PI - wall.direction;
            let from_wall = turned - PI * f64::from((turned / PI) as u32);
            RayHit { range, incidence: (FRAC_PI_2 - from_wall).abs(), surface: wall.surface }
        })
    }
}

impl RangeMap for SurfaceTable {
    fn cast(&self, laser: Poses<'_>, bearings: &[f32], max_range: f32, out: &mut Hits) {
        cast_batch(laser, bearings, max_range, out, |origin| {
            let cell = self.cell(origin);
            move |direction, heading| {
                cell.and_then(|cell| self.nearest_listed(cell, origin, direction, heading))
                    .or_else(|| self.map.cast_ray(origin, direction, f64::from(max_range)))
            }
        });
    }

    fn is_free(&self, x: f64, y: f64) -> bool {
        self.map.is_free(x, y)
    }

    fn bounds(&self) -> [f64; 4] {
        self.map.bounds()
    }
}
