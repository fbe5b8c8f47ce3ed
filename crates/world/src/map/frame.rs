use super::MapError;

/// More cells than this cannot be meant.
const MOST_CELLS: f64 = (1_u64 << 29) as f64;

/// Square cells over an axis-aligned box of the map frame, counted from its lower left corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CellFrame {
    /// Lower left corner [m].
    pub(crate) x0: f64,
    /// Lower left corner [m].
    pub(crate) y0: f64,
    /// Edge length of a cell [m].
    pub(crate) cell_m: f64,
    /// Cells along x.
    pub(crate) columns: usize,
    /// Cells along y.
    pub(crate) rows: usize,
}

impl CellFrame {
    /// The cells that cover the box \[x0, y0, x1, y1\] [m]. `layers` is how many values each cell will hold.
    ///
    /// # Errors
    /// [`MapError::Resolution`] for a cell size that is not positive, [`MapError::Extent`] for an empty box or too
    /// many values.
    pub(crate) fn covering([x0, y0, x1, y1]: [f64; 4], cell_m: f64, layers: usize) -> Result<Self, MapError> {
        if !(cell_m > 0.0 && cell_m.is_finite()) {
            return Err(MapError::Resolution(cell_m));
        }
        // A box of whole cells must not get one more by rounding.
        let cells = |length: f64| (length / cell_m - 1e-9).ceil().max(1.0);
        let (width, height) = (cells(x1 - x0), cells(y1 - y0));
        if !(x1 >= x0 && y1 >= y0 && width * height * layers as f64 <= MOST_CELLS) {
            return Err(MapError::Extent { width, height });
        }
        Ok(Self { x0, y0, cell_m, columns: width as usize, rows: height as usize })
    }

    /// A position of the lattice with half the cell size: even indices are cell borders, odd ones cell centres.
    pub(crate) fn half_cell(&self, column2: usize, row2: usize) -> [f64; 2] {
        let half = 0.5 * self.cell_m;
        [self.x0 + half * column2 as f64, self.y0 + half * row2 as f64]
    }
}
