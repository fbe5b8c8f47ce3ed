use std::f64::consts::TAU;

use glam::DVec2;
use locsim_core::{Draw, Obstructions, Stage};
use rand::RngExt;
use rayon::prelude::*;

use super::error::{check, check_count};
use super::rectangle::Rectangle;
use super::{BlockModel, SimulationError};
use crate::map::Geometry;

/// The most numbers in a table (1 GB).
const MAX_ENTRIES: f64 = 2.5e8;
/// The most sampled blocks; counts of them are exact in f32.
const MAX_SAMPLES: f64 = 1e7;
/// A cell whose centre is not free is looked at from the free one of this many times as many points nearest to it.
const SUBDIVISION: u32 = 4;
/// No table for this cell.
const NO_TABLE: u32 = u32::MAX;

/// How finely an [`ObstructionTable`] is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObstructionOptions {
    /// Side of a cell [m], for example 0.2.
    pub cell_m: f64,
    /// Number of headings over the full circle, for example 72.
    pub headings: u32,
    /// Distance between two entries along a ray [m], for example 0.05.
    pub bin_m: f64,
    /// Length of a ray [m].
    pub max_range_m: f64,
    /// Number K of blocks that the integral is sampled with, for example 1000 per metre of wall.
    pub samples: u32,
}

/// The probability that no block stands on a ray, for rays from the free cells of a map: what the oracle knows.
///
/// As blocks are a Poisson process, S(s) = exp(-Lambda(s)), where Lambda(s) is the expected number of blocks that the
/// ray meets within s. It is summed over K sampled blocks, their places stratified along the walls; a block counts
/// n/K, n the mean number of blocks. Blocks too near a robot at the ray's origin are left out, as the simulator
/// does; that a laser's mount puts the robot elsewhere is neglected. Each cell is looked at from its centre, each
/// heading along its direction, and a query is answered by the nearest cell and heading.
#[derive(Clone, Debug)]
pub struct ObstructionTable {
    origin: DVec2,
    cell_m: f64,
    columns: usize,
    rows: usize,
    /// Number of each cell's table, row by row, or [`NO_TABLE`].
    tables: Vec<u32>,
    headings: usize,
    bin_m: f32,
    /// Entries per ray.
    entries: usize,
    /// \[table\]\[heading\]\[entry\]
    survival: Vec<f32>,
}

impl ObstructionTable {
    /// Makes the table for the blocks of a map.
    ///
    /// # Errors
    /// [`SimulationError`] for an option that is not positive and finite, or a table that would not fit into memory.
    pub fn new(
        model: &BlockModel,
        geometry: &Geometry,
        options: &ObstructionOptions,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        for (name, value) in [
            ("cell of the obstruction table [m]", options.cell_m),
            ("headings of the obstruction table", f64::from(options.headings)),
            ("bin of the obstruction table [m]", options.bin_m),
            ("range of the obstruction table [m]", options.max_range_m),
            ("samples of the obstruction table", f64::from(options.samples)),
        ] {
            check(name, value, "above 0", |value| value > 0.0)?;
        }
        check_count("sampled blocks", f64::from(options.samples), MAX_SAMPLES)?;

        let [x0, y0, x1, y1] = geometry.bounds();
        let origin = DVec2::new(x0, y0);
        let size = ((DVec2::new(x1, y1) - origin) / options.cell_m).ceil().max(DVec2::ONE);
        let headings = options.headings as usize;
        let entries = (options.max_range_m / options.bin_m).ceil() + 1.0;
        check_count("cells", size.x * size.y, MAX_ENTRIES)?;
        let (columns, rows) = (size.x as usize, size.y as usize);

        let mut viewpoints = Vec::new();
        let mut tables = vec![NO_TABLE; columns * rows];
        for (i, table) in tables.iter_mut().enumerate() {
            let corner = origin + options.cell_m * DVec2::new((i % columns) as f64, (i / columns) as f64);
            if let Some(viewpoint) = viewpoint(geometry, corner, options.cell_m) {
                *table = viewpoints.len() as u32;
                viewpoints.push(viewpoint);
            }
        }
        check_count(
            "entries of the obstruction table",
            viewpoints.len() as f64 * headings as f64 * entries,
            MAX_ENTRIES,
        )?;
        let entries = entries as usize;

        let rays = Rays {
            model,
            blocks: sample_blocks(model, options.samples, seed),
            directions: (0..headings).map(|i| DVec2::from_angle(i as f64 * TAU / headings as f64)).collect(),
            bin_m: options.bin_m,
            max_range_m: options.max_range_m,
            entries,
        };
        let mut survival = vec![0.0; viewpoints.len() * headings * entries];
        survival
            .par_chunks_mut(headings * entries)
            .zip(&viewpoints)
            .for_each(|(survival, &viewpoint)| rays.fill(viewpoint, survival));
        Ok(Self {
            origin,
            cell_m: options.cell_m,
            columns,
            rows,
            tables,
            headings,
            bin_m: options.bin_m as f32,
            entries,
            survival,
        })
    }
}

impl Obstructions for ObstructionTable {
    fn bin_m(&self) -> f32 {
        self.bin_m
    }

    /// From a cell without free space nothing is known, and nothing is expected in the way.
    fn survival(&self, x: f64, y: f64, heading: f64) -> &[f32] {
        let cell = ((DVec2::new(x, y) - self.origin) / self.cell_m).floor();
        let inside = cell.cmpge(DVec2::ZERO).all()
            && cell.x < self.columns as f64
            && cell.y < self.rows as f64
            && heading.is_finite();
        if !inside {
            return &[1.0];
        }
        match self.tables[cell.y as usize * self.columns + cell.x as usize] {
            NO_TABLE => &[1.0],
            table => {
                let turns = (heading / TAU * self.headings as f64).round();
                let heading = turns.rem_euclid(self.headings as f64) as usize;
                let ray = table as usize * self.headings + heading;
                &self.survival[ray * self.entries..(ray + 1) * self.entries]
            }
        }
    }
}

/// From where a cell is looked at: its centre, or the free point nearest to it. `None` without free space.
fn viewpoint(geometry: &Geometry, corner: DVec2, cell_m: f64) -> Option<DVec2> {
    let center = corner + DVec2::splat(0.5 * cell_m);
    let step = cell_m / f64::from(SUBDIVISION);
    let grid = (0..SUBDIVISION * SUBDIVISION).map(|i| {
        let place = DVec2::new(f64::from(i % SUBDIVISION), f64::from(i / SUBDIVISION)) + DVec2::splat(0.5);
        corner + step * place
    });
    std::iter::once(center)
        .chain(grid)
        .filter(|point| geometry.is_free(point.x, point.y))
        .min_by(|a, b| a.distance_squared(center).total_cmp(&b.distance_squared(center)))
}

/// K blocks, one from each of K equal stretches of wall.
fn sample_blocks(model: &BlockModel, samples: u32, seed: u64) -> Vec<Rectangle> {
    if model.expected_count() == 0.0 {
        return Vec::new();
    }
    let draw = Draw::new(seed, Stage::Oracle, 0);
    let stretch = model.wall_length_m() / f64::from(samples);
    (0..samples)
        .map(|i| {
            let mut rng = draw.item(i);
            let position = (f64::from(i) + rng.random::<f64>()) * stretch;
            model.place(position, &mut rng).at(0.0)
        })
        .collect()
}

/// The rays from one point in all directions of the table.
struct Rays<'a> {
    model: &'a BlockModel,
    blocks: Vec<Rectangle>,
    directions: Vec<DVec2>,
    bin_m: f64,
    max_range_m: f64,
    entries: usize,
}

impl Rays<'_> {
    /// Survival along each ray from `origin`; `out` is zero and has \[heading\]\[entry\] order.
    fn fill(&self, origin: DVec2, out: &mut [f32]) {
        let headings = self.directions.len();
        let per_radian = headings as f64 / TAU;
        for block in &self.blocks {
            let (center, radius) = block.circle();
            let to_center = center - origin;
            let distance = to_center.length();
            if distance - radius > self.max_range_m || !self.model.is_clear(block, origin) {
                continue;
            }
            // Only directions within the circle around the block can meet it.
            let (first, count) = if distance <= radius {
                (0, headings)
            } else {
                let middle = to_center.to_angle();
                let half_angle = (radius / distance).asin();
                let first = ((middle - half_angle) * per_radian).ceil();
                let last = ((middle + half_angle) * per_radian).floor();
                (first.rem_euclid(headings as f64) as usize, (last - first + 1.0).max(0.0) as usize)
            };
            for heading in (first..first + count).map(|heading| heading % headings) {
                if let Some(range) = block.first_hit(origin, self.directions[heading], self.max_range_m) {
                    // The first entry that the block is within; entry 0 is the origin itself.
                    let entry = ((range / self.bin_m).ceil() as usize).max(1);
                    out[heading * self.entries + entry] += 1.0;
                }
            }
        }
        let blocks_per_sample = self.model.expected_count() / self.blocks.len().max(1) as f64;
        for ray in out.chunks_mut(self.entries) {
            let mut met = 0.0;
            for entry in ray {
                met += f64::from(*entry);
                *entry = (-met * blocks_per_sample).exp() as f32;
            }
        }
    }
}
