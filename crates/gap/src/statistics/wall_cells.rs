//! Cells of the map that walls run through.

use locsim_core::cell_at;
use std::collections::HashMap;

use glam::DVec2;
use locsim_comparison::Views;
use locsim_world::effect::EffectKind;

use super::readings::Reading;
use super::{Form, Group, Halves, Readings, Statistic, WALL_CELL_M};

/// Maps have walls at round numbers. Cells of walls have their borders elsewhere, or rounding would share a wall out
/// between two cells \[m\].
const WALL_BORDER_M: f64 = 0.37;

/// The cell of a point of a wall.
pub(super) fn wall_cell(point: DVec2) -> [i32; 2] {
    cell_at(point + WALL_BORDER_M, WALL_CELL_M)
}

/// The cells that the walls of a log run through.
#[derive(Clone)]
pub(super) struct WallCells {
    cells: Vec<[i32; 2]>,
    /// Index of each beam's cell; `None` of a beam that meets no wall.
    of_beams: Vec<Option<u32>>,
    /// Neighbouring cells, by index.
    pairs: Vec<[usize; 2]>,
}

impl WallCells {
    pub fn new(views: &Views, max_range: f64) -> Self {
        let mut indices: HashMap<[i32; 2], u32> = HashMap::new();
        let mut cells = Vec::new();
        let met = views.beams.iter().map(|beam| {
            (beam.view.range < max_range).then(|| {
                let cell = wall_cell(beam.view.endpoint);
                *indices.entry(cell).or_insert_with(|| {
                    cells.push(cell);
                    cells.len() as u32 - 1
                })
            })
        });
        let of_beams = met.collect();
        let mut pairs = Vec::new();
        for (i, &[x, y]) in cells.iter().enumerate() {
            for neighbour in [[x + 1, y], [x, y + 1]] {
                pairs.extend(indices.get(&neighbour).map(|&j| [i, j as usize]));
            }
        }
        Self { cells, of_beams, pairs }
    }

    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Lower corner of a cell \[m\].
    pub fn corner(&self, cell: usize) -> [f64; 2] {
        self.cells[cell].map(|c| f64::from(c) * WALL_CELL_M - WALL_BORDER_M)
    }

    /// Index of a beam's cell.
    pub fn of_beam(&self, beam: usize) -> Option<usize> {
        self.of_beams[beam].map(|cell| cell as usize)
    }

    /// The number of beams in each cell.
    pub fn counts(&self) -> Vec<f64> {
        let mut counts = vec![0.0; self.len()];
        for cell in self.of_beams.iter().flatten() {
            counts[*cell as usize] += 1.0;
        }
        counts
    }

    /// A statistic for each cell and for each two neighbours: a stretch of wall doesn't end where a cell does.
    pub fn statistics(&self, kind: EffectKind) -> Vec<Statistic> {
        vec![Statistic::of_effect(kind, Group::Places, Form::Other); self.len() + self.pairs.len()]
    }

    /// Neighbouring cells, by index.
    pub fn pairs(&self) -> &[[usize; 2]] {
        &self.pairs
    }

    /// The sums over cells, followed by those over neighbours.
    pub fn sums(
        &self,
        log: &Readings<'_>,
        mut summand: impl FnMut(&Reading<'_>, usize) -> f64,
    ) -> Vec<Halves> {
        let mut sums = vec![[0.0; 2]; self.len()];
        for reading in &log.all {
            if let Some(cell) = self.of_beam(reading.index) {
                sums[cell][reading.half] += summand(reading, cell);
            }
        }
        let both = |&[a, b]: &[usize; 2]| std::array::from_fn(|half| sums[a][half] + sums[b][half]);
        let of_pairs: Vec<Halves> = self.pairs.iter().map(both).collect();
        sums.extend(of_pairs);
        sums
    }

    /// The cells of a statistic.
    pub fn of_statistic(&self, index: usize) -> Vec<[i32; 2]> {
        match index.checked_sub(self.len()) {
            None => vec![self.cells[index]],
            Some(pair) => self.pairs[pair].map(|cell| self.cells[cell]).to_vec(),
        }
    }
}
