use std::path::Path;

use glam::DVec2;
use locsim_core::{
    BEAMS_PER_RUN, BeamRun, Hits, LikelihoodTable, NO_SURFACE, Pose2, Poses, PreparedScan, RangeMap, sin_cos,
    turn,
};
use wide::bytemuck::cast;
use wide::{f32x4, u32x4};

use super::ExactRangeMap;
use super::batch::for_each_chunk;
use super::build::{BinContents, Built, build, cells_in_sight};
use super::cache::Cached;
use super::sight::{RunHits, Sight};
use crate::map::{CellFrame, MapError};

/// Resolution of a [`RangeTable`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeTableOptions {
    /// Side of a cell \[m\]; doubled until the table fits into `most_bytes`, or given up for exact casts.
    pub cell_m: f64,
    /// The table may be this large \[bytes\].
    pub most_bytes: usize,
    /// Where three or more walls show in one bin of headings, the two that explain it best may be off by this much on
    /// average \[m\]; where they are worse, the table lists all the walls, which are slower to intersect.
    pub tolerance_m: f64,
}

impl Default for RangeTableOptions {
    /// Cells of 10 cm, 512 MiB, a tolerance of 5 cm.
    fn default() -> Self {
        Self { cell_m: 0.1, most_bytes: 512 << 20, tolerance_m: 0.05 }
    }
}

/// The part of the plane that is no farther than `distance_m` from any of the `points` \[m\], to a cell.
#[derive(Clone, Copy, Debug)]
pub struct Vicinity<'a> {
    /// Such as the poses of a drive.
    pub points: &'a [[f64; 2]],
    /// \[m\].
    pub distance_m: f64,
}

impl Vicinity<'_> {
    /// Whether each cell lies in it.
    fn cells(&self, frame: &CellFrame) -> Vec<bool> {
        let mut inside = vec![false; frame.rows * frame.columns];
        let radius = self.distance_m / frame.cell_m;
        let span = |centre: f64, count: usize| {
            // Saturates, so that points far off the map have no cells.
            let bound = |at: f64| (at.max(0.0) as usize).min(count);
            bound((centre - radius).floor())..bound((centre + radius).ceil() + 1.0)
        };
        for [x, y] in self.points {
            let at = [(x - frame.x0) / frame.cell_m, (y - frame.y0) / frame.cell_m];
            for row in span(at[1], frame.rows) {
                for column in span(at[0], frame.columns) {
                    let [dx, dy] = [column as f64 + 0.5 - at[0], row as f64 + 0.5 - at[1]];
                    inside[row * frame.columns + column] |= dx * dx + dy * dy <= radius * radius;
                }
            }
        }
        inside
    }
}

/// Fast ray casts: a table holds, for each cell of the plane and bin of headings, the wall that a ray meets, or the two
/// walls and the corner that divides the rays between them; the ray is then intersected with that wall's line.
///
/// So a range is exact to rounding (f32), wherever in its cell and bin the ray is. Where exact casts from the cell's
/// corners and centre along the bin's edges and centre meet more than two walls, the table lists the walls that these
/// casts meet, and the ray is intersected with all of them. Walls that none of these casts meets are missed. A ray that
/// starts in a cell without free space is cast exactly. One that starts inside a wall, but in a cell with free space, is
/// cast as from that cell.
pub struct RangeTable {
    map: ExactRangeMap,
    frame: CellFrame,
    /// \[1/m\].
    cells_per_m: f64,
    /// Row of each cell.
    rows: Vec<u32>,
    /// The content of each row's heading bins: an index into `sights`, or behind these into `lists`.
    entries: Vec<u32>,
    /// In coordinates relative to the frame's lower left corner.
    sights: Vec<Sight>,
    /// The surface ids of each sight's walls.
    surfaces: Vec<[u32; 2]>,
    /// Where each list's walls start among `walls`, and where the last one's end.
    lists: Vec<u32>,
    walls: Vec<ListedWall>,
}

/// A wall of a list, relative to the frame's lower left corner.
#[derive(Clone, Copy, Debug)]
struct ListedWall {
    /// One end \[m\].
    start: [f32; 2],
    /// Unit vector from there to the other end.
    along: [f32; 2],
    /// \[m\].
    length: f32,
    segment: u32,
}

/// Walls of a list are this much longer at both ends \[m\], so that no ray passes between two that share an end.
const OVERLAP_M: f32 = 1e-5;

impl ListedWall {
    fn new([a, b]: &[DVec2; 2], segment: u32, origin: DVec2) -> Self {
        let (start, along) = (*a - origin, (*b - *a).normalize());
        Self {
            start: [start.x as f32, start.y as f32],
            along: [along.x as f32, along.y as f32],
            length: a.distance(*b) as f32,
            segment,
        }
    }

    /// Distance along a ray \[m\]; infinite if it misses.
    #[inline]
    fn range_to(&self, origin: [f32; 2], direction: [f32; 2]) -> f32 {
        let start = [self.start[0] - origin[0], self.start[1] - origin[1]];
        let range = perp_dot(self.along, start) / perp_dot(self.along, direction);
        let position = range * dot(self.along, direction) - dot(self.along, start);
        let hit = range >= 0.0 && position >= -OVERLAP_M && position <= self.length + OVERLAP_M;
        if hit { range } else { f32::INFINITY }
    }
}

#[inline]
fn dot(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[0] + a[1] * b[1]
}

#[inline]
fn perp_dot(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[1] - a[1] * b[0]
}

/// Bins of heading over the full circle: the upper byte of a heading in turns of 2^-32.
const HEADINGS: usize = 256;
/// Beam directions are kept for this many beams at a time, on the stack.
const BEAMS_PER_BLOCK: usize = 64;

impl RangeTable {
    /// Builds the table in parallel; `progress` hears from several threads which share of it is done, 0 to 1.
    ///
    /// # Errors
    /// [`MapError`] when the cell size is not positive, or the map so large that no cell size fits.
    pub fn new(
        map: &ExactRangeMap,
        options: &RangeTableOptions,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<Self, MapError> {
        Self::cached(map, options, None, progress)
    }

    /// As [`RangeTable::new`], kept in a folder: read from there if the very same table was built before, and written
    /// there otherwise. A file that is damaged is built anew, a folder that can't be written to is done without.
    ///
    /// # Errors
    /// As [`RangeTable::new`].
    pub fn cached(
        map: &ExactRangeMap,
        options: &RangeTableOptions,
        folder: Option<&Path>,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<Self, MapError> {
        Self::near(map, options, None, folder, progress)
    }

    /// As [`RangeTable::cached`], but only for cells that a filter can be expected in. Rays from elsewhere are cast exactly.
    ///
    /// # Errors
    /// As [`RangeTable::new`].
    pub fn near(
        map: &ExactRangeMap,
        options: &RangeTableOptions,
        vicinity: Option<Vicinity<'_>>,
        folder: Option<&Path>,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<Self, MapError> {
        let (frame, in_sight) = fitting_frame(map, options, vicinity)?;
        let cached = folder.map(|folder| Cached::new(folder, map, options, &frame, &in_sight, HEADINGS));
        if let Some(built) = cached.as_ref().and_then(Cached::read) {
            progress(1.0);
            return Ok(Self::assemble(map, frame, built));
        }
        let built = build(map, &frame, HEADINGS, &in_sight, options.tolerance_m, progress);
        if let Some(cached) = cached {
            cached.write(&built);
        }
        Ok(Self::assemble(map, frame, built))
    }

    fn assemble(map: &ExactRangeMap, frame: CellFrame, built: Built) -> Self {
        let Built { rows, entries, contents: BinContents { sights: keys, lists } } = built;
        let (segments, surfaces) = (map.geometry().segments(), map.geometry().surfaces());
        let origin = DVec2::new(frame.x0, frame.y0);
        let mut walls = Vec::new();
        let mut starts = vec![0];
        for list in lists {
            walls.extend(list.iter().map(|&wall| ListedWall::new(&segments[wall as usize], wall, origin)));
            starts.push(walls.len() as u32);
        }
        let surface = |wall: u32| surfaces.get(wall as usize).copied().unwrap_or(NO_SURFACE);
        Self {
            map: map.clone(),
            frame,
            cells_per_m: 1.0 / frame.cell_m,
            rows,
            entries,
            sights: keys.iter().map(|key| key.sight(segments, origin)).collect(),
            surfaces: keys.iter().map(|key| key.walls.map(surface)).collect(),
            lists: starts,
            walls,
        }
    }

    /// The map that the table was built from.
    pub fn exact(&self) -> &ExactRangeMap {
        &self.map
    }

    /// Side of a cell \[m\]: that of the options, or larger where the table would not have fitted.
    pub fn cell_m(&self) -> f64 {
        self.frame.cell_m
    }

    /// Size of the table in memory \[bytes\].
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.rows)
            + size_of_val(&*self.entries)
            + size_of_val(&*self.sights)
            + size_of_val(&*self.surfaces)
            + size_of_val(&*self.lists)
            + size_of_val(&*self.walls)
    }

    /// The heading bins of the cell that holds a point relative to the frame's corner \[m\]; `None` outside free space.
    #[inline]
    fn bins(&self, x: f64, y: f64) -> Bins<'_> {
        let (column, row) = (x * self.cells_per_m, y * self.cells_per_m);
        // False for NaN too.
        let inside =
            column >= 0.0 && row >= 0.0 && column < self.frame.columns as f64 && row < self.frame.rows as f64;
        if !inside {
            return None;
        }
        // Signed conversions are cheaper.
        let cell = row as i64 as usize * self.frame.columns + column as i64 as usize;
        let row = self.rows[cell];
        // No table has as many rows as the mark for "none".
        self.entries.as_chunks().0.get(row as usize)
    }
}

/// Largest cell \[m\]: a larger one would not distinguish the two sides of a wall.
const COARSEST_M: f64 = 1.0;

/// The most cells times corners of the map's polygons, each of which is compared with each cell: seconds.
const MOST_COMPARED: usize = 20_000_000_000;

/// The map's bounds with the lower corner moved by a part of a cell: walls tend to lie on whole multiples of a cell,
/// and casts from a point on a wall say nothing about its neighbours.
fn shifted([x0, y0, x1, y1]: [f64; 4], cell_m: f64) -> [f64; 4] {
    [x0 - 0.382 * cell_m, y0 - 0.382 * cell_m, x1, y1]
}

/// The cells of the table and which of them have a row: as fine as the options say, or as fine as fits; without any row
/// where even cells of a metre don't fit, so that every ray is cast exactly.
fn fitting_frame(
    map: &ExactRangeMap,
    options: &RangeTableOptions,
    vicinity: Option<Vicinity<'_>>,
) -> Result<(CellFrame, Vec<bool>), MapError> {
    let mut cell_m = options.cell_m;
    let corners = map.geometry().corners_of_free_space().max(1);
    loop {
        let frame = CellFrame::covering(shifted(map.bounds(), cell_m), cell_m);
        let coarsest = cell_m >= COARSEST_M;
        match frame {
            Ok(frame)
                if frame.rows * frame.columns <= options.most_bytes / size_of::<u32>()
                    && frame.rows * frame.columns <= MOST_COMPARED / corners =>
            {
                let mut in_sight = cells_in_sight(map, &frame);
                if let Some(vicinity) = vicinity {
                    in_sight.iter_mut().zip(vicinity.cells(&frame)).for_each(|(cell, near)| *cell &= near);
                }
                let rows = in_sight.iter().filter(|inside| **inside).count();
                if (rows * HEADINGS + in_sight.len()) * size_of::<u32>() <= options.most_bytes {
                    return Ok((frame, in_sight));
                }
                if coarsest {
                    return Ok((frame, vec![false; in_sight.len()]));
                }
            }
            Ok(_) | Err(MapError::Extent { .. }) if !coarsest => {}
            Ok(frame) => {
                return Err(MapError::Extent { width: frame.columns as f64, height: frame.rows as f64 });
            }
            Err(error) => return Err(error),
        }
        cell_m *= 2.0;
    }
}

/// A pose in the table's frame and units.
struct Origin {
    /// Relative to the frame's corner \[m\].
    at: [f32; 2],
    /// Unit vector of the heading.
    ahead: [f32; 2],
    /// In turns of 2^-32.
    heading: u32,
}

/// The heading bins of a pose's cell, `None` outside free space.
type Bins<'a> = Option<&'a [u32; HEADINGS]>;

/// The bin of a heading in turns of 2^-32.
#[inline]
const fn bin(heading: u32) -> usize {
    (heading >> 24) as usize
}

impl RangeTable {
    #[inline]
    fn origin(&self, pose: Pose2) -> (Origin, Bins<'_>) {
        let (x, y) = (pose.x - self.frame.x0, pose.y - self.frame.y0);
        let (sin, cos) = sin_cos(pose.theta);
        let origin =
            Origin { at: [x as f32, y as f32], ahead: [cos as f32, sin as f32], heading: turn(pose.theta) };
        (origin, self.bins(x, y))
    }

    /// The entries of a run of beams, and its directions.
    #[inline]
    fn entries(
        origin: &Origin,
        bins: &[u32; HEADINGS],
        beams: &BeamRun,
    ) -> ([u32; BEAMS_PER_RUN], [f32x4; 2]) {
        let [c, s] = origin.ahead;
        let direction = [beams.cos * c - beams.sin * s, beams.cos * s + beams.sin * c];
        let heading = beams.turn + u32x4::splat(origin.heading);
        (heading.to_array().map(|heading| bins[bin(heading)]), direction)
    }

    /// Hits of a run of beams.
    #[inline]
    fn meet(&self, origin: &Origin, bins: &[u32; HEADINGS], beams: &BeamRun) -> RunHits {
        let (entries, direction) = Self::entries(origin, bins, beams);
        match entries.map(|entry| self.sights.get(entry as usize)) {
            [Some(a), Some(b), Some(c), Some(d)] => Sight::meet([a, b, c, d], origin.at, direction),
            _ => self.meet_lists(entries, origin, direction),
        }
    }

    /// Sum of the entries of a run of beams in a likelihood table.
    #[inline]
    fn sum(
        &self,
        origin: &Origin,
        bins: &[u32; HEADINGS],
        (beams, row_start): (&BeamRun, u32x4),
        table: &LikelihoodTable,
    ) -> i32 {
        let (entries, direction) = Self::entries(origin, bins, beams);
        // As in `meet`, but arranged so that the values of most beams stay in registers.
        match entries.map(|entry| self.sights.get(entry as usize)) {
            [Some(a), Some(b), Some(c), Some(d)] => {
                let met = Sight::meet([a, b, c, d], origin.at, direction);
                table.sum(row_start + table.scale().entry(met.range, met.cosine))
            }
            _ => self.sum_with_lists(entries, origin, direction, row_start, table),
        }
    }

    #[cold]
    #[inline(never)]
    fn sum_with_lists(
        &self,
        entries: [u32; BEAMS_PER_RUN],
        origin: &Origin,
        direction: [f32x4; 2],
        row_start: u32x4,
        table: &LikelihoodTable,
    ) -> i32 {
        let met = self.meet_lists(entries, origin, direction);
        table.sum(row_start + table.scale().entry(met.range, met.cosine))
    }

    /// Hits of a run in which some beams have a list of walls instead of a sight.
    #[cold]
    #[inline(never)]
    fn meet_lists(&self, entries: [u32; BEAMS_PER_RUN], origin: &Origin, direction: [f32x4; 2]) -> RunHits {
        let sights = entries.map(|entry| self.sights.get(entry as usize).unwrap_or(&Sight::NOTHING));
        let mut met = Sight::meet(sights, origin.at, direction);
        let frame = DVec2::new(self.frame.x0, self.frame.y0);
        let position = frame + DVec2::new(f64::from(origin.at[0]), f64::from(origin.at[1]));
        let [x, y] = direction.map(f32x4::to_array);
        for (i, entry) in entries.into_iter().enumerate() {
            let Some(list) = (entry as usize).checked_sub(self.sights.len()) else { continue };
            let direction = [x[i], y[i]];
            let walls = &self.walls[self.lists[list] as usize..self.lists[list + 1] as usize];
            let mut nearest: Option<(&ListedWall, f32)> = None;
            for wall in walls {
                let range = wall.range_to(origin.at, direction);
                if nearest.map_or(range < f32::INFINITY, |(_, least)| range < least) {
                    nearest = Some((wall, range));
                }
            }
            let (wall, range) = if let Some((wall, range)) = nearest {
                (*wall, range)
            } else {
                let [x, y] = direction.map(f64::from);
                let hit = self.map.cast_segment(position, DVec2::new(x, y), f64::INFINITY);
                let Some((segment, range)) = hit else { continue };
                let ends = &self.map.geometry().segments()[segment];
                (ListedWall::new(ends, segment as u32, frame), range as f32)
            };
            met.range.as_mut_array()[i] = range;
            met.cosine.as_mut_array()[i] = perp_dot(wall.along, direction).abs();
            met.sine.as_mut_array()[i] = dot(wall.along, direction).abs();
            met.listed[i] = wall.segment;
        }
        met
    }

    /// Range \[m\], incidence angle \[rad\] and surface id (as bits) of a run of beams.
    #[inline]
    fn hits(
        &self,
        pose: Pose2,
        origin: &Origin,
        bins: Bins<'_>,
        beams: &BeamRun,
        max_range: f32,
    ) -> [f32x4; 3] {
        let Some(bins) = bins else { return self.exact_hits(pose, beams, max_range) };
        let met = self.meet(origin, bins, beams);
        let heading = (beams.turn + u32x4::splat(origin.heading)).to_array();
        let first = met.first.to_array();
        let surface: [u32; BEAMS_PER_RUN] = std::array::from_fn(|i| {
            let sight = self.surfaces.get(bins[bin(heading[i])] as usize);
            sight.map_or_else(
                || self.map.geometry().surfaces().get(met.listed[i] as usize).copied().unwrap_or(NO_SURFACE),
                |walls| walls[usize::from(first[i].to_bits() == 0)],
            )
        });
        let is_hit = met.range.simd_ge(f32x4::ZERO) & met.range.simd_lt(f32x4::splat(max_range));
        [
            is_hit.bitselect(met.range, f32x4::splat(max_range)),
            is_hit & met.sine.atan2(met.cosine),
            is_hit.bitselect(cast(surface), cast([NO_SURFACE; BEAMS_PER_RUN])),
        ]
    }

    /// As [`RangeTable::hits`], by exact casts, for poses outside free space.
    #[cold]
    fn exact_hits(&self, pose: Pose2, beams: &BeamRun, max_range: f32) -> [f32x4; 3] {
        let rotation = DVec2::from_angle(pose.theta);
        let (cos, sin) = (beams.cos.to_array(), beams.sin.to_array());
        let hits: [(f32, f32, u32); BEAMS_PER_RUN] = std::array::from_fn(|i| {
            let direction = rotation.rotate(DVec2::new(f64::from(cos[i]), f64::from(sin[i])));
            self.map
                .cast_ray(pose.position(), direction, f64::from(max_range))
                // Rounding to f32 may reach the maximum, which means "no return".
                .filter(|hit| (hit.range as f32) < max_range)
                .map_or((max_range, 0.0, NO_SURFACE), |hit| {
                    (hit.range as f32, hit.incidence as f32, hit.surface)
                })
        });
        [f32x4::new(hits.map(|hit| hit.0)), f32x4::new(hits.map(|hit| hit.1)), cast(hits.map(|hit| hit.2))]
    }
}

impl RangeMap for RangeTable {
    fn cast(&self, laser: Poses<'_>, bearings: &[f32], max_range: f32, out: &mut Hits) {
        let k = bearings.len();
        out.resize(laser.len() * k);
        if out.is_empty() {
            return;
        }
        for_each_chunk(out, k, |first, range, incidence, surface| {
            let mut runs = [BeamRun::AHEAD; BEAMS_PER_BLOCK / BEAMS_PER_RUN];
            for (block, bearings) in bearings.chunks(BEAMS_PER_BLOCK).enumerate() {
                for (run, bearings) in runs.iter_mut().zip(bearings.chunks(BEAMS_PER_RUN)) {
                    *run = BeamRun::new(bearings);
                }
                for i in 0..range.len() / k {
                    let pose = laser.get(first + i);
                    let (origin, bins) = self.origin(pose);
                    let here =
                        i * k + block * BEAMS_PER_BLOCK..i * k + block * BEAMS_PER_BLOCK + bearings.len();
                    let hits = range[here.clone()].chunks_mut(BEAMS_PER_RUN);
                    let hits = hits.zip(incidence[here.clone()].chunks_mut(BEAMS_PER_RUN));
                    let hits = hits.zip(surface[here].chunks_mut(BEAMS_PER_RUN));
                    for (beams, ((range, incidence), surface)) in runs.iter().zip(hits) {
                        let [r, alpha, id] = self.hits(pose, &origin, bins, beams, max_range);
                        let n = range.len();
                        range.copy_from_slice(&r.to_array()[..n]);
                        incidence.copy_from_slice(&alpha.to_array()[..n]);
                        surface.copy_from_slice(&cast::<_, [u32; 4]>(id)[..n]);
                    }
                }
            }
        });
    }

    fn log_likelihood(
        &self,
        laser: Poses<'_>,
        scan: &PreparedScan,
        table: &LikelihoodTable,
        _hits: &mut Hits,
        out: &mut [f64],
    ) {
        for (i, out) in out.iter_mut().enumerate() {
            let (origin, bins) = self.origin(laser.get(i));
            let mut sum = 0;
            for &(ref beams, row_start) in &scan.runs {
                sum += if let Some(bins) = bins {
                    self.sum(&origin, bins, (beams, row_start), table)
                } else {
                    let [range, incidence, _] = self.exact_hits(laser.get(i), beams, table.grid().reach);
                    table.sum(row_start + table.scale().entry(range, incidence.cos()))
                };
            }
            *out = table.nats(scan.bearings.len(), sum);
        }
    }

    fn is_free(&self, x: f64, y: f64) -> bool {
        self.map.is_free(x, y)
    }

    fn bounds(&self) -> [f64; 4] {
        self.map.bounds()
    }
}
