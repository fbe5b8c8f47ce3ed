use std::f64::consts::TAU;

use glam::DVec2;
use locsim_core::{CAST_REACH, Draw, Obstructions, Stage, Survival};
use rand::RngExt;
use rayon::prelude::*;

use super::error::{check, check_count};
use super::rectangle::Rectangle;
use super::{BlockModel, SimulationError};
use crate::map::Geometry;
use crate::raycast::ExactRangeMap;

/// The most numbers in a table (1 GB).
const MAX_ENTRIES: f64 = 2.5e8;
/// The most sampled blocks; counts of them are exact in f32.
const MAX_SAMPLES: f64 = 1e7;
/// A cell is looked at from its centre or, where that is not free, from the nearest free point of a grid with
/// this many points per side.
const SUBDIVISION: u32 = 4;
/// No table for this cell.
const NO_TABLE: u32 = u32::MAX;

/// How finely an [`ObstructionTable`] is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObstructionOptions {
    /// Side of a cell \[m\], for example 0.2.
    pub cell_m: f64,
    /// Number of headings over the full circle, for example 72.
    pub headings: u32,
    /// Distance between two entries along a ray \[m\], for example 0.05.
    pub bin_m: f64,
    /// Length of a ray \[m\].
    pub max_range_m: f64,
    /// Number K of blocks that the integral is sampled with, for example 1000 per metre of wall.
    pub samples: u32,
}

/// The probability that no block stands on a ray, for rays from the free cells of a map: what the oracle
/// knows.
///
/// As blocks are a Poisson process, S(s) = exp(-Lambda(s)), where Lambda(s) is the expected number of blocks
/// that the ray meets within s. It is summed over K sampled blocks, their places stratified along the walls;
/// a block counts n/K, n the mean number of blocks. Blocks too near a robot at the ray's origin are left out,
/// as the simulator does; that a laser's mount puts the robot elsewhere is neglected. Each cell is looked at
/// from its centre, each heading along its direction, and a query is answered by the nearest cell and
/// heading, moved along the ray so that both rays' walls coincide: blocks stand by walls.
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
    /// A nominal range of this or more is that of a ray without a wall \[m\].
    reach: f32,
    /// Nominal range of each ray \[table\]\[heading\] \[m\].
    ranges: Vec<f32>,
    /// Entries per ray.
    entries: usize,
    /// \[table\]\[heading\]\[entry\]
    survival: Vec<f32>,
}

impl ObstructionTable {
    /// Makes the table for the blocks of a map.
    ///
    /// # Errors
    /// [`SimulationError`] for an option that is not positive and finite, or a table that would not fit
    /// into memory.
    pub fn new(
        model: &BlockModel,
        map: &ExactRangeMap,
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

        let geometry = map.geometry();
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
        let reach = f64::from(CAST_REACH) * options.max_range_m;
        let ranges = viewpoints
            .iter()
            .flat_map(|&viewpoint| rays.directions.iter().map(move |&direction| (viewpoint, direction)))
            .map(|(viewpoint, direction)| {
                let hit = map.cast_ray(viewpoint, direction, reach);
                hit.map_or(reach, |hit| hit.range) as f32
            })
            .collect();
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
            reach: reach as f32,
            ranges,
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
    fn survival(&self, x: f64, y: f64, heading: f64, range: f32) -> Survival<'_> {
        let unknown = Survival { probability: &[1.0], start_m: 0.0 };
        let cell = ((DVec2::new(x, y) - self.origin) / self.cell_m).floor();
        let inside = cell.cmpge(DVec2::ZERO).all()
            && cell.x < self.columns as f64
            && cell.y < self.rows as f64
            && heading.is_finite();
        if !inside {
            return unknown;
        }
        match self.tables[cell.y as usize * self.columns + cell.x as usize] {
            NO_TABLE => unknown,
            table => {
                let turns = (heading / TAU * self.headings as f64).round();
                let heading = turns.rem_euclid(self.headings as f64) as usize;
                let ray = table as usize * self.headings + heading;
                // Without a wall within reach on either ray there is nothing to align.
                let aligned = range < self.reach && self.ranges[ray] < self.reach;
                Survival {
                    probability: &self.survival[ray * self.entries..(ray + 1) * self.entries],
                    start_m: if aligned { range - self.ranges[ray] } else { 0.0 },
                }
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
            for heading in first..first + count {
                let heading = if heading < headings { heading } else { heading - headings };
                if let Some(range) = block.first_hit(origin, self.directions[heading], self.max_range_m) {
                    // The first entry beyond the hit; never entry 0, the origin itself.
                    let entry = ((range / self.bin_m) as usize + 1).min(self.entries - 1);
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

#[cfg(test)]
mod tests {
    use locsim_core::Pose2;

    use super::super::fixtures::{block_options, laser_options, on_threads, room, room_map};
    use super::super::{BlockOptions, LaserOptions, Simulator};
    use super::*;
    use crate::effect::Effects;

    /// Two by three cells around (1, 1), (3, 1), .. (5, 3).
    fn options() -> ObstructionOptions {
        ObstructionOptions { cell_m: 2.0, headings: 8, bin_m: 0.1, max_range_m: 8.0, samples: 200_000 }
    }

    fn table(blocks: BlockOptions, options: &ObstructionOptions) -> ObstructionTable {
        let model = BlockModel::new(blocks, &room()).unwrap();
        ObstructionTable::new(&model, &room_map(), options, 1).unwrap()
    }

    /// Survival along a table's own rays, which start where the query does.
    fn survival(table: &ObstructionTable, x: f64, y: f64, heading: f64) -> &[f32] {
        let wall = room_map().cast_ray(DVec2::new(x, y), DVec2::from_angle(heading), 8.0);
        let survival = table.survival(x, y, heading, wall.map_or(8.0, |hit| hit.range) as f32);
        assert!(survival.start_m.abs() < 1e-5);
        survival.probability
    }

    fn viewpoints() -> impl Iterator<Item = DVec2> {
        [1.0, 3.0, 5.0].into_iter().flat_map(|x| [1.0, 3.0].map(|y| DVec2::new(x, y)))
    }

    /// Greatest deviation between the table and the share of simulated readings beyond each entry, in
    /// standard errors: binomial for the readings; for the table, Lambda is n/K times a count, with a
    /// variance of at most n Lambda / K.
    fn worst_deviation(table: &ObstructionTable, readings: &[Vec<f32>], blocks: f64) -> f64 {
        let mut worst = 0.0_f64;
        for (point, readings) in viewpoints().zip(readings) {
            let n = readings.len() / 8;
            for beam in 0..8 {
                let angle = (beam + 1) as f64 / 8.0 * TAU - 0.5 * TAU;
                let wall = room_map().cast_ray(point, DVec2::from_angle(angle), 8.0).unwrap().range;
                let survival = survival(table, point.x, point.y, angle);
                for (i, &survival) in survival.iter().enumerate() {
                    let (s, survival) = (0.1 * i as f64, f64::from(survival));
                    let expected_hits = (1.0 - survival) * n as f64;
                    // Up to the wall, and where the normal approximation holds.
                    if s < wall && expected_hits > 50.0 {
                        let beyond = |scan: &&[f32]| f64::from(scan[beam]) > s;
                        let share = readings.chunks(8).filter(beyond).count() as f64 / n as f64;
                        let variance = survival * (1.0 - survival) / n as f64
                            + survival.powi(2) * -survival.ln() * blocks / 200_000.0;
                        worst = worst.max((share - survival).abs() / variance.sqrt());
                    }
                }
            }
        }
        worst
    }

    /// 6 points x 8 rays x about 25 entries: each of 1200 comparisons at 1e-6 / 1200, that is 6.15 standard
    /// errors.
    #[test]
    fn survival_is_the_share_of_simulated_readings_that_no_block_shortened() {
        let laser = LaserOptions { beams: 8, ..laser_options() };
        let simulator = Simulator::new(room_map(), Some(block_options()), laser, Effects::none()).unwrap();
        let poses =
            viewpoints().map(|point| Pose2::new(point.x, point.y, 0.0)).collect::<locsim_core::Particles>();
        let per_pose = 20_000;
        let all = simulator.observe_many(poses.view(), per_pose, 3);
        let readings: Vec<Vec<f32>> = all.chunks(per_pose as usize * 8).map(<[f32]>::to_vec).collect();
        let worst = |blocks| worst_deviation(&table(blocks, &options()), &readings, 20.0);

        let good = block_options();
        assert!(worst(good) < 6.15, "{}", worst(good));
        // Controls: 15 % more blocks, no clearance, a gap 2 cm too wide.
        assert!(worst(BlockOptions { per_metre_of_wall: 1.15, ..good }) > 6.15);
        assert!(worst(BlockOptions { clearance_m: 0.0, ..good }) > 6.15);
        assert!(worst(BlockOptions { wall_distance_m: [0.07, 0.52], ..good }) > 6.15);
    }

    /// Blocks all alike, square to the wall: those on a ray straight at the wall have their centre within
    /// half a length of it, so Lambda jumps from 0 to density x length where the blocks' fronts are.
    #[test]
    fn a_ray_straight_at_a_wall_has_the_survival_of_a_one_dimensional_poisson_process() {
        let blocks = BlockOptions {
            per_metre_of_wall: 1.5,
            length_m: [0.4, 0.4],
            width_m: [0.2, 0.2],
            yaw_rad: [0.0, 0.0],
            wall_distance_m: [0.1, 0.1],
            ..block_options()
        };
        let table = table(blocks, &ObstructionOptions { bin_m: 0.04, ..options() });
        let survival = survival(&table, 3.0, 1.0, -0.25 * TAU);
        // From 1 m the fronts are at 0.7 m. Stratified places: the count is off by at most 2 in 4000.
        for (i, &s) in survival.iter().enumerate().take(25) {
            let expected: f64 = if (i as f64) * 0.04 < 0.7 { 1.0 } else { (-1.5_f64 * 0.4).exp() };
            assert!((f64::from(s) - expected).abs() < 1e-3, "{i}: {s}");
        }
    }

    #[test]
    fn survival_starts_at_one_and_never_increases() {
        let table = table(block_options(), &ObstructionOptions { samples: 1000, ..options() });
        for point in viewpoints() {
            for heading in 0..8 {
                let survival = survival(&table, point.x, point.y, f64::from(heading) * TAU / 8.0);
                assert_eq!(survival.len(), 81);
                assert_eq!(survival[0], 1.0);
                assert!(survival.windows(2).all(|pair| pair[1] <= pair[0] && pair[1] > 0.0));
            }
        }
    }

    #[test]
    fn queries_are_answered_by_the_nearest_cell_and_heading() {
        let table = table(block_options(), &ObstructionOptions { samples: 1000, ..options() });
        let step = TAU / 8.0;
        let ray = |x, y, heading| table.survival(x, y, heading, 1.0).probability;
        for turns in -2..=2 {
            let heading = f64::from(turns) * TAU + 3.0 * step;
            assert_eq!(ray(3.0, 1.0, 3.0 * step), ray(2.1, 1.9, heading + 0.4 * step));
            assert_eq!(ray(3.0, 1.0, 4.0 * step), ray(3.9, 0.1, heading + 0.6 * step));
        }
        assert_ne!(ray(3.0, 1.0, step), ray(3.0, 1.0, 2.0 * step));
        for (x, y, heading) in [(-0.1, 1.0, 0.0), (1.0, 4.1, 0.0), (f64::NAN, 1.0, 0.0), (1.0, 1.0, f64::NAN)]
        {
            assert_eq!(ray(x, y, heading), [1.0]);
        }
    }

    /// From (3, 1) the wall below is 1 m away; a query 0.2 m nearer to it has its blocks 0.2 m nearer.
    #[test]
    fn neighbouring_rays_are_aligned_at_their_walls() {
        let table = table(block_options(), &ObstructionOptions { samples: 1000, ..options() });
        let down = -0.25 * TAU;
        assert!((table.survival(3.0, 0.8, down, 0.8).start_m + 0.2).abs() < 1e-6);
        assert_eq!(table.survival(3.0, 0.8, down, 12.0).start_m, 0.0, "an open ray has no wall to align");
    }

    #[test]
    fn no_blocks_are_never_in_the_way() {
        let table = table(BlockOptions { per_metre_of_wall: 0.0, ..block_options() }, &options());
        assert!(survival(&table, 3.0, 1.0, 0.0).iter().all(|&s| s == 1.0));
    }

    #[test]
    fn the_table_is_the_same_on_any_number_of_threads() {
        let options = ObstructionOptions { cell_m: 0.5, samples: 500, ..options() };
        let run = |threads| on_threads(threads, || table(block_options(), &options).survival);
        let one = run(1);
        assert_eq!(one, run(2));
        assert_eq!(one, run(8));
    }

    #[test]
    fn options_out_of_range_are_refused() {
        let good = options();
        let model = BlockModel::new(block_options(), &room()).unwrap();
        for (options, message) in [
            (
                ObstructionOptions { cell_m: 0.0, ..good },
                "cell of the obstruction table [m] must be above 0; got 0",
            ),
            (ObstructionOptions { cell_m: 1e-6, ..good }, "cells are more than"),
            (ObstructionOptions { headings: 0, ..good }, "headings of the obstruction table"),
            (ObstructionOptions { bin_m: f64::NAN, ..good }, "bin of the obstruction table [m]"),
            (ObstructionOptions { bin_m: 1e-9, ..good }, "entries of the obstruction table are more than"),
            (ObstructionOptions { max_range_m: -1.0, ..good }, "range of the obstruction table [m]"),
            (ObstructionOptions { samples: 0, ..good }, "samples of the obstruction table"),
            (ObstructionOptions { samples: 20_000_000, ..good }, "20000000 sampled blocks are more than"),
        ] {
            let error = ObstructionTable::new(&model, &room_map(), &options, 1).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
