use glam::DVec2;

use locsim_core::limits::Limits;

use super::{COARSEST_M, FINEST_M, MapError};

/// Square cells over an axis-aligned box of the map frame, counted from its lower left corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellFrame {
    /// Lower left corner \[m\].
    pub x0: f64,
    /// Lower left corner \[m\].
    pub y0: f64,
    /// Edge length of a cell \[m\].
    pub cell_m: f64,
    /// Cells along x.
    pub columns: usize,
    /// Cells along y.
    pub rows: usize,
}

impl CellFrame {
    /// The cells that cover the box \[x0, y0, x1, y1\] \[m\].
    ///
    /// # Errors
    /// [`MapError::Resolution`] for a cell size that is not from [`FINEST_M`] to [`COARSEST_M`], [`MapError::Extent`] for an empty box or too
    /// many cells.
    pub fn covering([x0, y0, x1, y1]: [f64; 4], cell_m: f64) -> Result<Self, MapError> {
        if !(FINEST_M..=COARSEST_M).contains(&cell_m) {
            return Err(MapError::Resolution(cell_m));
        }
        // A box of whole cells must not get one more by rounding.
        let cells = |length: f64| (length / cell_m - 1e-9).ceil().max(1.0);
        let (width, height) = (cells(x1 - x0), cells(y1 - y0));
        if !(x1 >= x0 && y1 >= y0 && width * height <= Limits::current().grid_cells as f64) {
            return Err(MapError::Extent { width, height });
        }
        Ok(Self { x0, y0, cell_m, columns: width as usize, rows: height as usize })
    }

    /// A position of the lattice with half the cell size: even indices are cell borders, odd ones cell centres.
    pub fn half_cell(&self, column2: usize, row2: usize) -> [f64; 2] {
        let half = 0.5 * self.cell_m;
        [self.x0 + half * column2 as f64, self.y0 + half * row2 as f64]
    }

    /// Column and row of the cell that holds a point of the box \[m\].
    pub fn cell_of(&self, point: DVec2) -> [usize; 2] {
        let cell = |value: f64, origin: f64| ((value - origin) / self.cell_m) as usize;
        [cell(point.x, self.x0), cell(point.y, self.y0)]
    }

    /// The cells that a line passes before the cell it ends in, in order (Amanatides and Woo, Eurographics 1987).
    /// Both points \[m\] are in the box.
    pub fn cells_between(&self, start: DVec2, end: DVec2) -> impl Iterator<Item = [usize; 2]> {
        let [mut column, mut row] = self.cell_of(start);
        let [last_column, last_row] = self.cell_of(end);
        let direction = end - start;
        // Share of the line up to the next border of a column or row, and from border to border.
        let next = |cell: usize, forward: bool, origin: f64, from: f64, step: f64| {
            (origin + self.cell_m * (cell + usize::from(forward)) as f64 - from) / step
        };
        let mut next_column = next(column, direction.x > 0.0, self.x0, start.x, direction.x);
        let mut next_row = next(row, direction.y > 0.0, self.y0, start.y, direction.y);
        let per_cell = self.cell_m / direction.abs();
        // Counting steps per axis ends in the last cell whatever the rounding.
        let mut columns_left = column.abs_diff(last_column);
        let mut rows_left = row.abs_diff(last_row);
        std::iter::from_fn(move || {
            if columns_left == 0 && rows_left == 0 {
                return None;
            }
            let cell = [column, row];
            if rows_left == 0 || (columns_left > 0 && next_column <= next_row) {
                columns_left -= 1;
                next_column += per_cell.x;
                column = if last_column > column { column + 1 } else { column - 1 };
            } else {
                rows_left -= 1;
                next_row += per_cell.y;
                row = if last_row > row { row + 1 } else { row - 1 };
            }
            Some(cell)
        })
    }
}
