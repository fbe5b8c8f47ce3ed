use locsim_core::limits::Limits;

use super::{Cell, MapError};

/// Ends of a boundary, in cells.
type Ends = [[f64; 2]; 2];

/// Boundaries between occupied and other cells, in units of cells from the grid's lower left corner.
/// Runs along one grid line whose occupied cells are on the same side are merged.
///
/// # Errors
/// [`MapError::TooMany`] for more of them than a map may have.
pub(super) fn cell_boundaries(cells: &[Cell], width: usize, height: usize) -> Result<Vec<Ends>, MapError> {
    let occupied = |column: usize, row: usize| cells[row * width + column] == Cell::Occupied;
    let mut boundaries = Vec::new();
    let most = Limits::current().map_segments;
    let mut count = 0;
    let mut push = |ends: Ends| {
        count += 1;
        if count <= most {
            boundaries.push(ends);
        }
    };
    for row in 0..=height {
        let side = |column| {
            let below = row > 0 && occupied(column, row - 1);
            let above = row < height && occupied(column, row);
            (below != above).then_some(below)
        };
        let y = row as f64;
        merge_runs(width, side, |from, to| push([[from, y], [to, y]]));
    }
    for column in 0..=width {
        let side = |row| {
            let left = column > 0 && occupied(column - 1, row);
            let right = column < width && occupied(column, row);
            (left != right).then_some(left)
        };
        let x = column as f64;
        merge_runs(height, side, |from, to| push([[x, from], [x, to]]));
    }
    if count > most {
        return Err(MapError::TooMany(Limits::current().refusal("map_segments", count)));
    }
    Ok(boundaries)
}

/// Reports each maximal run `from..to` of one and the same side along a grid line.
fn merge_runs(n: usize, side: impl Fn(usize) -> Option<bool>, mut run: impl FnMut(f64, f64)) {
    let mut start = 0;
    let mut current = None;
    for i in 0..=n {
        let here = if i < n { side(i) } else { None };
        if here != current {
            if current.is_some() {
                run(start as f64, i as f64);
            }
            (start, current) = (i, here);
        }
    }
}
