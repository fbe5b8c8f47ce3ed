use std::f64::consts::TAU;
use std::sync::{Arc, OnceLock};

use glam::DVec2;
use locsim_core::{CAST_REACH, Obstructions, Survival, survival_of};

use super::error::{check, check_count};
use super::{BlockIntegral, BlockModel, SimulationError};
use crate::map::Geometry;
use crate::raycast::ExactRangeMap;

/// Greatest number of a table's entries if every ray had blocks along its whole length (2 GB); real tables are a few times
/// smaller.
const MAX_ENTRIES: f64 = 5e8;
/// The most shapes of blocks (16 MB).
const MAX_SHAPES: f64 = 1e5;
/// A cell is looked at from its centre or, where that is not free, from the nearest free point of a grid with
/// this many points per side.
const SUBDIVISION: u32 = 4;
/// The number of a cell without free space.
const NOT_FREE: u32 = u32::MAX;
/// Cells of a table that doesn't fit grow by this factor.
const GROWTH: f64 = 1.1;

/// How finely an [`ObstructionTable`] is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObstructionOptions {
    /// Side of a cell \[m\], for example 0.1; it grows until the table fits into memory.
    pub cell_m: f64,
    /// Number of headings over the full circle, for example 240.
    pub headings: u32,
    /// Distance between two entries along a ray \[m\], for example 0.05.
    pub bin_m: f64,
    /// Length of a ray \[m\].
    pub max_range_m: f64,
    /// Shapes of blocks that are summed over, for example 256.
    pub shapes: u32,
}

/// The probability that no block stands on a ray, for rays from the free cells of a map. The oracle uses it.
///
/// As blocks are a Poisson process, S(s) = exp(-Lambda(s)), where Lambda(s) is the expected number of blocks
/// that the ray meets within s, by [`BlockIntegral`]. Blocks too near a robot at the ray's origin are left out,
/// as the simulator does; that a laser's mount puts the robot elsewhere is neglected. Each cell is looked at
/// from its centre, each heading along its direction, and a query is answered by the nearest cell and
/// heading, moved along the ray so that both rays' walls coincide: blocks stand by walls. A cell's rays are cast
/// when it is first asked for: a filter's particles see a small part of the map.
pub struct ObstructionTable {
    cells: Cells,
    /// Where each cell is looked at from.
    viewpoints: Vec<DVec2>,
    /// Of each cell.
    panoramas: Vec<OnceLock<Panorama>>,
    rays: Rays,
}

/// The rays from one point in all directions.
#[derive(Clone, Debug, PartialEq)]
struct Panorama {
    rays: Vec<Ray>,
    /// The entries of one ray after the other.
    survival: Vec<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Ray {
    /// Nominal range \[m\].
    range: f32,
    /// Distance of the first entry from the point \[m\]; nothing stands before it.
    start_m: f32,
    /// Where the ray's entries end in [`Panorama::survival`]. They begin where those of the ray before end.
    end: u32,
}

impl Panorama {
    fn ray(&self, heading: usize) -> (Ray, &[f32]) {
        let begin = heading.checked_sub(1).map_or(0, |before| self.rays[before].end);
        let ray = self.rays[heading];
        (ray, &self.survival[begin as usize..ray.end as usize])
    }
}

impl ObstructionTable {
    /// Makes the table for the blocks of a map.
    ///
    /// # Errors
    /// [`SimulationError`] for an option that is not positive and finite, or rays that would not fit into memory.
    pub fn new(
        model: &BlockModel,
        map: &Arc<ExactRangeMap>,
        options: &ObstructionOptions,
    ) -> Result<Self, SimulationError> {
        for (name, value) in [
            ("cell of the obstruction table [m]", options.cell_m),
            ("headings of the obstruction table", f64::from(options.headings)),
            ("bin of the obstruction table [m]", options.bin_m),
            ("range of the obstruction table [m]", options.max_range_m),
            ("shapes of the obstruction table", f64::from(options.shapes)),
        ] {
            check(name, value, "above 0", |value| value > 0.0)?;
        }
        check_count("shapes", f64::from(options.shapes), MAX_SHAPES)?;
        let headings = options.headings as usize;
        let entries = (options.max_range_m / options.bin_m).ceil() + 2.0;
        check_count("entries per cell of the obstruction table", entries * headings as f64, MAX_ENTRIES)?;

        let most_viewpoints = (MAX_ENTRIES / (entries * headings as f64)) as usize;
        let mut cell_m = options.cell_m;
        let (cells, viewpoints) = loop {
            let found = Cells::over(map.geometry(), cell_m)?;
            if found.1.len() <= most_viewpoints {
                break found;
            }
            cell_m *= GROWTH;
        };
        let rays = Rays {
            blocks: BlockIntegral::with_shapes(model, options.shapes),
            map: Arc::clone(map),
            directions: (0..headings).map(|i| DVec2::from_angle(i as f64 * TAU / headings as f64)).collect(),
            bin_m: options.bin_m,
            max_range_m: options.max_range_m,
            reach: f64::from(CAST_REACH) * options.max_range_m,
        };
        let panoramas = viewpoints.iter().map(|_| OnceLock::new()).collect();
        Ok(Self { cells, viewpoints, panoramas, rays })
    }
}

impl Obstructions for ObstructionTable {
    fn bin_m(&self) -> f32 {
        self.rays.bin_m as f32
    }

    /// From a cell without free space nothing is known, and nothing is expected in the way.
    fn survival(&self, x: f64, y: f64, heading: f64, range: f32) -> Survival<'_> {
        let unknown = Survival { probability: &[1.0], start_m: 0.0 };
        let Some(cell) = self.cells.at(DVec2::new(x, y)).filter(|_| heading.is_finite()) else {
            return unknown;
        };
        let panorama = self.panoramas[cell].get_or_init(|| self.rays.panorama(self.viewpoints[cell]));
        let headings = panorama.rays.len() as f64;
        let turns = (heading / TAU * headings).round();
        let (ray, probability) = panorama.ray(turns.rem_euclid(headings) as usize);
        // Without a wall within reach on either ray there is nothing to align.
        let reach = self.rays.reach as f32;
        let aligned = range < reach && ray.range < reach;
        let moved = if aligned { range - ray.range } else { 0.0 };
        Survival { probability, start_m: ray.start_m + moved }
    }
}

/// The square cells of a map with free space in them, numbered row by row.
#[derive(Clone, Debug)]
struct Cells {
    origin: DVec2,
    side_m: f64,
    columns: usize,
    rows: usize,
    /// Number of each cell, or [`NOT_FREE`].
    numbers: Vec<u32>,
}

impl Cells {
    /// The cells of a map, and the point that each is looked at from.
    fn over(geometry: &Geometry, side_m: f64) -> Result<(Self, Vec<DVec2>), SimulationError> {
        let [x0, y0, x1, y1] = geometry.bounds();
        let origin = DVec2::new(x0, y0);
        let size = ((DVec2::new(x1, y1) - origin) / side_m).ceil().max(DVec2::ONE);
        check_count("cells", size.x * size.y, MAX_ENTRIES)?;
        let (columns, rows) = (size.x as usize, size.y as usize);
        let mut viewpoints = Vec::new();
        let mut numbers = vec![NOT_FREE; columns * rows];
        for (i, number) in numbers.iter_mut().enumerate() {
            let corner = origin + side_m * DVec2::new((i % columns) as f64, (i / columns) as f64);
            if let Some(viewpoint) = viewpoint(geometry, corner, side_m) {
                *number = viewpoints.len() as u32;
                viewpoints.push(viewpoint);
            }
        }
        Ok((Self { origin, side_m, columns, rows, numbers }, viewpoints))
    }

    /// Number of the cell with free space that a point is in.
    fn at(&self, point: DVec2) -> Option<usize> {
        let cell = ((point - self.origin) / self.side_m).floor();
        let is_inside =
            cell.cmpge(DVec2::ZERO).all() && cell.x < self.columns as f64 && cell.y < self.rows as f64;
        let number = is_inside.then(|| self.numbers[cell.y as usize * self.columns + cell.x as usize])?;
        (number != NOT_FREE).then_some(number as usize)
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

/// Casts the rays of a table.
struct Rays {
    blocks: BlockIntegral,
    map: Arc<ExactRangeMap>,
    directions: Vec<DVec2>,
    bin_m: f64,
    max_range_m: f64,
    /// A nominal range of this or more is that of a ray without a wall \[m\].
    reach: f64,
}

impl Rays {
    /// The rays from `origin`.
    fn panorama(&self, origin: DVec2) -> Panorama {
        let mut counts = Vec::new();
        let mut panorama = Panorama { rays: Vec::with_capacity(self.directions.len()), survival: Vec::new() };
        for &direction in &self.directions {
            let range = self.map.cast_ray(origin, direction, self.reach).map_or(self.reach, |hit| hit.range);
            // Only blocks in front of the wall and within the maximum range count.
            let limit = range.min(self.max_range_m);
            let bins = (limit / self.bin_m) as usize + 1;
            counts.clear();
            counts.resize(bins, 0.0);
            self.blocks.count_by_range(origin, direction, origin, limit, self.bin_m, &mut counts);
            let (first, survival) = survival_of(&counts);
            panorama.survival.extend(survival);
            panorama.rays.push(Ray {
                range: range as f32,
                start_m: (first as f64 * self.bin_m) as f32,
                end: panorama.survival.len() as u32,
            });
        }
        panorama.survival.shrink_to_fit();
        panorama
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::Pose2;

    use super::super::fixtures::{block_options, laser_options, room, room_map};
    use super::super::{BlockOptions, LaserOptions, Simulator};
    use super::*;
    use crate::effect::Effects;

    /// Two by three cells around (1, 1), (3, 1), .. (5, 3).
    fn options() -> ObstructionOptions {
        ObstructionOptions { cell_m: 2.0, headings: 8, bin_m: 0.1, max_range_m: 8.0, shapes: 8192 }
    }

    fn table(blocks: BlockOptions, options: &ObstructionOptions) -> ObstructionTable {
        let model = BlockModel::new(blocks, &room()).unwrap();
        ObstructionTable::new(&model, &room_map(), options).unwrap()
    }

    /// Survival along a table's own rays, which start where the query does.
    fn survival(table: &ObstructionTable, x: f64, y: f64, heading: f64) -> Survival<'_> {
        let wall = room_map().cast_ray(DVec2::new(x, y), DVec2::from_angle(heading), 8.0);
        table.survival(x, y, heading, wall.map_or(8.0, |hit| hit.range) as f32)
    }

    fn viewpoints() -> impl Iterator<Item = DVec2> {
        [1.0, 3.0, 5.0].into_iter().flat_map(|x| [1.0, 3.0].map(|y| DVec2::new(x, y)))
    }

    /// Greatest deviation between the table and the share of simulated readings beyond each entry, in binomial
    /// standard errors.
    fn worst_deviation(table: &ObstructionTable, readings: &[Vec<f32>]) -> f64 {
        let mut worst = 0.0_f64;
        for (point, readings) in viewpoints().zip(readings) {
            let n = readings.len() / 8;
            for beam in 0..8 {
                let angle = (beam + 1) as f64 / 8.0 * TAU - 0.5 * TAU;
                let wall = room_map().cast_ray(point, DVec2::from_angle(angle), 8.0).unwrap().range;
                let survival = survival(table, point.x, point.y, angle);
                for (i, &probability) in survival.probability.iter().enumerate() {
                    let s = f64::from(survival.start_m) + 0.1 * i as f64;
                    let survival = f64::from(probability);
                    let expected_hits = (1.0 - survival) * n as f64;
                    // Up to the wall, and where the normal approximation holds.
                    if s < wall && expected_hits > 50.0 {
                        let beyond = |scan: &&[f32]| f64::from(scan[beam]) > s;
                        let share = readings.chunks(8).filter(beyond).count() as f64 / n as f64;
                        let variance = survival * (1.0 - survival) / n as f64;
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
        let all = simulator.observe_many(poses.as_poses(), per_pose, 3);
        let readings: Vec<Vec<f32>> = all.chunks(per_pose as usize * 8).map(<[f32]>::to_vec).collect();
        let worst = |blocks| worst_deviation(&table(blocks, &options()), &readings);

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
        // From 1 m the fronts are at 0.7 m.
        // Between the last entry before and the first behind, a bin of 4 cm.
        let Survival { probability, start_m } = survival;
        assert!((start_m - 0.68).abs() < 1e-5, "{start_m}");
        assert_eq!(probability.len(), 2);
        assert!((f64::from(probability[1]) - (-1.5_f64 * 0.4).exp()).abs() < 1e-3, "{probability:?}");
    }

    #[test]
    fn survival_starts_at_one_and_never_increases() {
        let table = table(block_options(), &options());
        for point in viewpoints() {
            for heading in 0..8 {
                let survival = survival(&table, point.x, point.y, f64::from(heading) * TAU / 8.0);
                assert!(survival.start_m >= 0.0);
                let survival = survival.probability;
                assert_eq!(survival[0], 1.0);
                assert!((2..=81).contains(&survival.len()), "{}", survival.len());
                assert!(survival.windows(2).all(|pair| pair[1] <= pair[0] && pair[1] > 0.0));
            }
        }
    }

    #[test]
    fn queries_are_answered_by_the_nearest_cell_and_heading() {
        let table = table(block_options(), &options());
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
        let table = table(block_options(), &options());
        let down = -0.25 * TAU;
        let start = |y: f64, range: f32| table.survival(3.0, y, down, range).start_m;
        assert!((start(1.0, 1.0) - start(0.8, 0.8) - 0.2).abs() < 1e-6);
        assert_eq!(start(0.8, 12.0), start(1.0, 1.0), "an open ray has no wall to align");
    }

    #[test]
    fn no_blocks_are_never_in_the_way() {
        let table = table(BlockOptions { per_metre_of_wall: 0.0, ..block_options() }, &options());
        assert_eq!(survival(&table, 3.0, 1.0, 0.0).probability, [1.0]);
    }

    #[test]
    fn cells_grow_until_their_rays_fit() {
        let none = BlockOptions { per_metre_of_wall: 0.0, ..block_options() };
        let side = |bin_m| table(none, &ObstructionOptions { cell_m: 0.15, bin_m, ..options() }).cells.side_m;
        assert_eq!(side(0.1), 0.15);
        // 8 rays of 80,002 entries: 781 cells in 24 square metres.
        let side = side(1e-4);
        assert!((0.17..0.2).contains(&side), "{side}");
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
            (
                ObstructionOptions { bin_m: 1e-9, ..good },
                "entries per cell of the obstruction table are more",
            ),
            (ObstructionOptions { max_range_m: -1.0, ..good }, "range of the obstruction table [m]"),
            (ObstructionOptions { shapes: 0, ..good }, "shapes of the obstruction table"),
            (ObstructionOptions { shapes: 200_000, ..good }, "200000 shapes are more than"),
        ] {
            let error = ObstructionTable::new(&model, &room_map(), &options).err().unwrap().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
