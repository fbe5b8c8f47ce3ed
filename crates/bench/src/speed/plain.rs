//! The update as one would write it first: a loop over particles and beams, Bresenham's walk through the grid, and the
//! textbook's beam model with an exponential and a logarithm for each beam. What everything else is measured beside.

use std::f64::consts::PI;

use locsim_core::Pose2;
use locsim_world::map::{Cell, OccupancyGrid};

use super::{BeamParameters, Workload};

/// Log likelihood of a scan for each particle (nats).
pub fn log_likelihoods(workload: &Workload, out: &mut Vec<f64>) {
    let Workload { grid, laser, scan, particles, beam, .. } = workload;
    let max_range = f64::from(laser.max_range());
    let grid_from_map = grid.origin().inverse();
    out.clear();
    for particle in particles.iter() {
        let pose = grid_from_map.compose(&particle.compose(&laser.base_from_laser()));
        let mut sum = 0.0;
        for (&bearing, &z) in laser.bearings().iter().zip(&scan.ranges) {
            let nominal = cast(grid, &pose, f64::from(bearing), max_range);
            sum += density(beam, f64::from(z), nominal, max_range).ln();
        }
        out.push(sum);
    }
}

/// Range \[m\] to the first occupied cell on the line of cells from a pose's own (Bresenham 1965), the pose being in the
/// grid's frame; the maximum range where there is none.
pub fn cast(grid: &OccupancyGrid, pose: &Pose2, bearing: f64, max_range: f64) -> f64 {
    let (sin, cos) = (pose.theta + bearing).sin_cos();
    let cell =
        |x: f64, y: f64| ((x / grid.resolution_m()).floor() as i64, (y / grid.resolution_m()).floor() as i64);
    let start = cell(pose.x, pose.y);
    let end = cell(pose.x + max_range * cos, pose.y + max_range * sin);
    let (dx, dy) = ((end.0 - start.0).abs(), (end.1 - start.1).abs());
    let step = ((end.0 - start.0).signum(), (end.1 - start.1).signum());
    let (mut column, mut row) = start;
    let mut error = dx - dy;
    loop {
        let inside = (0..grid.width() as i64).contains(&column) && (0..grid.height() as i64).contains(&row);
        if inside && grid.cells()[row as usize * grid.width() + column as usize] == Cell::Occupied {
            let (dx, dy) = ((column - start.0) as f64, (row - start.1) as f64);
            return (grid.resolution_m() * dx.hypot(dy)).min(max_range);
        }
        if (column, row) == end {
            return max_range;
        }
        let twice = 2 * error;
        if twice > -dy {
            error -= dy;
            column += step.0;
        }
        if twice < dx {
            error += dx;
            row += step.1;
        }
    }
}

/// p(z | nominal range) of the textbook's beam model (Probabilistic Robotics, table 6.1), with its normalizers.
fn density(beam: &BeamParameters, z: f64, nominal: f64, max_range: f64) -> f64 {
    let off = (z - nominal) / beam.sigma_hit;
    let hit = (-0.5 * off * off).exp() / (beam.sigma_hit * (2.0 * PI).sqrt());
    let short = if z <= nominal && nominal > 0.0 {
        let normalizer = 1.0 - (-beam.lambda_short * nominal).exp();
        beam.lambda_short * (-beam.lambda_short * z).exp() / normalizer
    } else {
        0.0
    };
    let (max, rand) = if z >= max_range { (1.0, 0.0) } else { (0.0, 1.0 / max_range) };
    beam.z_hit * hit + beam.z_short * short + beam.z_max * max + beam.z_rand * rand
}

/// Casts every beam of every particle and returns the mean range \[m\], so that the work can't be left out.
pub fn mean_range(workload: &Workload) -> f64 {
    let Workload { grid, laser, particles, .. } = workload;
    let max_range = f64::from(laser.max_range());
    let grid_from_map = grid.origin().inverse();
    let mut sum = 0.0;
    for particle in particles.iter() {
        let pose = grid_from_map.compose(&particle.compose(&laser.base_from_laser()));
        for &bearing in laser.bearings() {
            sum += cast(grid, &pose, f64::from(bearing), max_range);
        }
    }
    sum / (particles.len() * laser.beam_count()) as f64
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use locsim_world::raycast::ExactRangeMap;

    use super::*;

    /// A room of 40 x 20 cells of 0.1 m within walls one cell thick, its grid turned and moved.
    fn room() -> OccupancyGrid {
        let (columns, rows) = (42, 22);
        let wall = |i: usize| {
            let (column, row) = (i % columns, i / columns);
            column == 0 || row == 0 || column == columns - 1 || row == rows - 1
        };
        let cells = (0..columns * rows).map(|i| if wall(i) { Cell::Occupied } else { Cell::Free }).collect();
        let occupancy = vec![0.5; columns * rows];
        OccupancyGrid::new(columns, rows, 0.1, Pose2::new(1.0, -2.0, 0.3), cells, occupancy).unwrap()
    }

    /// Bresenham's line leaves the ray by at most a cell, and so does its end; a ray that grazes a wall may end earlier
    /// or later by more, so headings keep off the walls' directions.
    #[test]
    fn the_walk_ends_within_two_cells_of_the_exact_cast() {
        let grid = room();
        let exact = ExactRangeMap::new(grid.to_geometry().unwrap());
        for i in 0..200 {
            let t = f64::from(i);
            let inside = Pose2::new(0.6 + 3.0 * (0.37 * t).fract(), 0.5 + 1.2 * (0.61 * t).fract(), t);
            let heading = DVec2::from_angle(inside.theta);
            if heading.x.abs().min(heading.y.abs()) < 0.2 {
                continue;
            }
            let pose = grid.origin().compose(&inside);
            let direction = DVec2::from_angle(pose.theta);
            let range = exact.cast_ray(pose.position(), direction, 10.0).unwrap().range;
            let walked = cast(&grid, &inside, 0.0, 10.0);
            assert!((walked - range).abs() < 0.3, "{walked} for {range} from {pose:?}");
            assert_eq!(cast(&grid, &inside, 0.0, 0.2), 0.2, "no wall so near");
        }
    }

    #[test]
    fn the_density_of_readings_integrates_to_the_weights() {
        let beam = BeamParameters {
            z_hit: 0.7,
            z_short: 0.15,
            z_max: 0.1,
            z_rand: 0.05,
            sigma_hit: 0.05,
            lambda_short: 0.5,
        };
        let step = 1e-4;
        let below: f64 =
            (0..45_000).map(|i| step * density(&beam, (f64::from(i) + 0.5) * step, 3.0, 4.5)).sum();
        assert!((below - 0.9).abs() < 1e-3, "{below}");
        assert!((density(&beam, 4.5, 3.0, 4.5) - 0.1).abs() < 1e-9);
    }
}
