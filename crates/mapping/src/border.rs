//! The border of the area that was seen.

use std::collections::VecDeque;

use glam::DVec2;

use crate::beams::Scan;
use locsim_world::map::{CellFrame, MapError};

/// The border follows cells of this size \[m\].
const CELL_M: f64 = 0.1;

/// The border runs this many cells outside what was seen, so that walls, which are in what was seen, are in front of it.
const MARGIN_CELLS: usize = 1;

/// Beams farther apart than this \[rad\] leave what is between them unseen: 2.1 degrees, so that neighbours at 2 degrees do
/// not.
const GAP_RAD: f64 = 0.0367;

/// Holes smaller than this \[m^2\] are filled: gaps between beams.
const HOLE_M2: f64 = 0.25;

/// The border is this near to that of the cells \[m\].
const SIMPLIFIED_M: f64 = 0.08;

/// Closed polylines \[m\]: around what was seen, then around each hole in it.
///
/// # Errors
/// [`MapError::Extent`] for an area that is too large.
pub(crate) fn border_of(scans: &[Scan]) -> Result<Vec<Vec<DVec2>>, MapError> {
    let ends = scans.iter().flat_map(|scan| scan.beams.iter().map(|beam| beam.end).chain([scan.origin]));
    let (lower, upper) = ends.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(a, b), p| (a.min(p), b.max(p)));
    let margin = DVec2::splat(CELL_M * (MARGIN_CELLS + 2) as f64);
    let (lower, upper) = (lower - margin, upper + margin);
    let frame = CellFrame::covering([lower.x, lower.y, upper.x, upper.y], CELL_M)?;
    let mut seen = vec![false; frame.columns * frame.rows];
    let mut mark = |from: DVec2, to: DVec2| {
        for [column, row] in frame.cells_between(from, to).chain([frame.cell_of(to)]) {
            seen[row * frame.columns + column] = true;
        }
    };
    for scan in scans {
        for pair in scan.beams.windows(2) {
            let [u, v] = [&pair[0], &pair[1]].map(|beam| beam.end - scan.origin);
            mark(scan.origin, pair[0].end);
            let (p, q) = (u.length(), v.length());
            if !(pair[0].hit && pair[1].hit) || u.angle_to(v).abs() > GAP_RAD {
                continue;
            }
            let reach = p.min(q);
            let rays = (u.distance(v) / CELL_M).min(reach * GAP_RAD / CELL_M).ceil() as usize;
            for k in 1..rays {
                let direction = u.lerp(v, k as f64 / rays as f64).normalize_or_zero();
                mark(scan.origin, scan.origin + reach * direction);
            }
        }
        if let Some(last) = scan.beams.last() {
            mark(scan.origin, last.end);
        }
    }
    for _ in 0..MARGIN_CELLS {
        seen = grown(&seen, &frame);
    }
    let seen = without_islands(&seen, &frame);
    let mut rings: Vec<Vec<DVec2>> = rings(&seen, &frame).iter().map(|ring| simplified(ring)).collect();
    rings.retain(|ring| ring.len() >= 3);
    rings.sort_by(|a, b| area(b).abs().total_cmp(&area(a).abs()));
    Ok(rings)
}

fn grown(seen: &[bool], frame: &CellFrame) -> Vec<bool> {
    let mut grown = seen.to_vec();
    for row in 1..frame.rows - 1 {
        for column in 1..frame.columns - 1 {
            if seen[row * frame.columns + column] {
                for near in row - 1..=row + 1 {
                    grown[near * frame.columns + column - 1..=near * frame.columns + column + 1].fill(true);
                }
            }
        }
    }
    grown
}

/// Keeps the largest part of what was seen and fills small holes.
fn without_islands(seen: &[bool], frame: &CellFrame) -> Vec<bool> {
    let mut label = vec![u32::MAX; seen.len()];
    let mut parts: Vec<(bool, usize)> = Vec::new();
    for start in 0..seen.len() {
        if label[start] != u32::MAX {
            continue;
        }
        let (part, is_seen) = (parts.len() as u32, seen[start]);
        label[start] = part;
        let mut queue = VecDeque::from([start]);
        let mut size = 0;
        while let Some(cell) = queue.pop_front() {
            size += 1;
            let (column, row) = (cell % frame.columns, cell / frame.columns);
            let near = [
                (column > 0).then(|| cell - 1),
                (column + 1 < frame.columns).then(|| cell + 1),
                (row > 0).then(|| cell - frame.columns),
                (row + 1 < frame.rows).then(|| cell + frame.columns),
            ];
            for next in near.into_iter().flatten() {
                if label[next] == u32::MAX && seen[next] == is_seen {
                    label[next] = part;
                    queue.push_back(next);
                }
            }
        }
        parts.push((is_seen, size));
    }
    let largest = parts.iter().filter(|part| part.0).map(|part| part.1).max().unwrap_or(0);
    let hole = (HOLE_M2 / (CELL_M * CELL_M)) as usize;
    label
        .iter()
        .map(|&label| match parts[label as usize] {
            (true, size) => size == largest,
            (false, size) => size < hole,
        })
        .collect()
}

/// Right, up, left, down.
const STEPS: [(i64, i64); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

/// The borders of the cells, counter-clockwise around what was seen, corner by corner.
fn rings(seen: &[bool], frame: &CellFrame) -> Vec<Vec<DVec2>> {
    let is_seen = |column: i64, row: i64| {
        column >= 0
            && row >= 0
            && (column as usize) < frame.columns
            && (row as usize) < frame.rows
            && seen[row as usize * frame.columns + column as usize]
    };
    let width = frame.columns + 1;
    // An edge starts at a lattice point and has what was seen on its left.
    let has_edge = |x: i64, y: i64, direction: usize| {
        let (left, right) = match direction {
            0 => ((x, y), (x, y - 1)),
            1 => ((x - 1, y), (x, y)),
            2 => ((x - 1, y - 1), (x - 1, y)),
            _ => ((x, y - 1), (x - 1, y - 1)),
        };
        is_seen(left.0, left.1) && !is_seen(right.0, right.1)
    };
    let mut done = vec![false; width * (frame.rows + 1) * 4];
    let mut rings = Vec::new();
    for y in 0..=frame.rows as i64 {
        for x in 0..frame.columns as i64 {
            if !has_edge(x, y, 0) || done[(y as usize * width + x as usize) * 4] {
                continue;
            }
            let (mut px, mut py, mut direction) = (x, y, 0);
            let mut ring = Vec::new();
            loop {
                let edge = (py as usize * width + px as usize) * 4 + direction;
                if done[edge] {
                    break;
                }
                done[edge] = true;
                ring.push(DVec2::from_array(frame.half_cell(2 * px as usize, 2 * py as usize)));
                px += STEPS[direction].0;
                py += STEPS[direction].1;
                // Left first: parts that touch at a corner are one.
                direction = [1, 0, 3]
                    .into_iter()
                    .map(|turn| (direction + turn) % 4)
                    .find(|&direction| has_edge(px, py, direction))
                    .unwrap_or(direction);
            }
            rings.push(ring);
        }
    }
    rings
}

/// Fewer points, none of the others farther from the new edges than [`SIMPLIFIED_M`] (Douglas and Peucker, 1973).
fn simplified(ring: &[DVec2]) -> Vec<DVec2> {
    let far = (0..ring.len())
        .max_by(|&a, &b| ring[a].distance(ring[0]).total_cmp(&ring[b].distance(ring[0])))
        .unwrap_or(0);
    let mut kept = vec![false; ring.len() + 1];
    kept[0] = true;
    kept[far] = true;
    let mut stack = vec![(0, far), (far, ring.len())];
    while let Some((a, b)) = stack.pop() {
        let (p, q) = (ring[a], ring[b % ring.len()]);
        let worst = (a + 1..b)
            .map(|i| (i, locsim_core::distance_to(&[p, q], ring[i])))
            .max_by(|x, y| x.1.total_cmp(&y.1));
        if let Some((i, distance)) = worst
            && distance > SIMPLIFIED_M
        {
            kept[i] = true;
            stack.extend([(a, i), (i, b)]);
        }
    }
    ring.iter().zip(kept).filter(|(_, kept)| *kept).map(|(p, _)| *p).collect()
}

fn area(ring: &[DVec2]) -> f64 {
    let next = ring.iter().cycle().skip(1);
    0.5 * ring.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>()
}
