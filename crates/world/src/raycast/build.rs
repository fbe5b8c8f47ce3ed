//! Filling a surface table.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec2;
use rayon::prelude::*;

use super::ExactRangeMap;
use crate::map::CellFrame;

/// Cell rows per unit of parallel work; neighbouring bands both cast from the row of corners between them.
const BAND_ROWS: usize = 8;
/// Stands for "met nothing".
const NOTHING: u32 = u32::MAX;

/// Lists of segments, one after the other; list 0 is empty.
pub(super) struct Lists {
    starts: Vec<u32>,
    segments: Vec<u32>,
}

impl Lists {
    /// The segments of a list.
    #[inline]
    pub(super) fn get(&self, list: u32) -> &[u32] {
        let list = list as usize;
        &self.segments[self.starts[list] as usize..self.starts[list + 1] as usize]
    }

    /// Size in memory [bytes].
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&*self.starts) + size_of_val(&*self.segments)
    }
}

/// Gives equal lists one number.
struct Interner {
    lists: Lists,
    numbers: HashMap<Box<[u32]>, u32>,
}

impl Interner {
    fn new() -> Self {
        let empty = Lists { starts: vec![0, 0], segments: Vec::new() };
        Self { lists: empty, numbers: HashMap::from([(Box::default(), 0)]) }
    }

    fn number(&mut self, list: &[u32]) -> u32 {
        if let Some(&number) = self.numbers.get(list) {
            return number;
        }
        let number = self.numbers.len() as u32;
        self.numbers.insert(list.into(), number);
        self.lists.segments.extend_from_slice(list);
        self.lists.starts.push(self.lists.segments.len() as u32);
        number
    }
}

/// List numbers per row, column and heading bin, and the lists.
pub(super) fn build(
    map: &ExactRangeMap,
    frame: &CellFrame,
    headings: usize,
    progress: &(dyn Fn(f64) + Sync),
) -> (Vec<u32>, Lists) {
    // Edges (even) and centres (odd) of the heading bins.
    let directions: Vec<DVec2> =
        (0..2 * headings).map(|i| DVec2::from_angle(TAU * i as f64 / (2 * headings) as f64)).collect();
    let mut entries = vec![0; frame.rows * frame.columns * headings];
    let band_len = BAND_ROWS * frame.columns * headings;
    let rows_done = AtomicUsize::new(0);
    let bands: Vec<Lists> = entries
        .par_chunks_mut(band_len)
        .enumerate()
        .map(|(band, entries)| {
            let lists = fill_band(map, frame, band * BAND_ROWS, &directions, entries);
            let rows = entries.len() / (frame.columns * headings);
            let done = rows_done.fetch_add(rows, Ordering::Relaxed) + rows;
            progress(done as f64 / frame.rows as f64);
            lists
        })
        .collect();
    // Each band numbered its lists by itself; number them all together, in order.
    let mut interner = Interner::new();
    let renumber: Vec<Vec<u32>> = bands
        .iter()
        .map(|lists| (0..lists.starts.len() as u32 - 1).map(|i| interner.number(lists.get(i))).collect())
        .collect();
    entries.par_chunks_mut(band_len).zip(renumber).for_each(|(entries, number)| {
        for entry in entries {
            *entry = number[*entry as usize];
        }
    });
    (entries, interner.lists)
}

/// Fills the entries of the cell rows from `first_row` on; returns the lists that they number.
fn fill_band(
    map: &ExactRangeMap,
    frame: &CellFrame,
    first_row: usize,
    directions: &[DVec2],
    entries: &mut [u32],
) -> Lists {
    let headings = directions.len() / 2;
    let mut interner = Interner::new();
    // What each corner of the cell row sees in each direction; empty where nobody has asked yet.
    let mut below = vec![Vec::new(); frame.columns + 1];
    let mut above = below.clone();
    let mut centre = Vec::new();
    let look = |seen: &mut Vec<u32>, [x, y]: [f64; 2]| {
        if seen.is_empty() {
            seen.extend(directions.iter().map(|&direction| {
                map.cast_segment(DVec2::new(x, y), direction, f64::INFINITY)
                    .map_or(NOTHING, |(segment, _)| segment as u32)
            }));
        }
    };
    for (row, entries) in (first_row..).zip(entries.chunks_mut(frame.columns * headings)) {
        for (column, entries) in entries.chunks_mut(headings).enumerate() {
            let spot = |dx, dy| frame.half_cell(2 * column + dx, 2 * row + dy);
            let spots = [spot(0, 0), spot(2, 0), spot(0, 2), spot(2, 2), spot(1, 1)];
            if !spots.iter().any(|&[x, y]| map.geometry().is_free(x, y)) {
                continue;
            }
            centre.clear();
            look(&mut below[column], spots[0]);
            look(&mut below[column + 1], spots[1]);
            look(&mut above[column], spots[2]);
            look(&mut above[column + 1], spots[3]);
            look(&mut centre, spots[4]);
            let seen = [&below[column], &below[column + 1], &above[column], &above[column + 1], &centre];
            for (bin, entry) in entries.iter_mut().enumerate() {
                *entry = interner.number(&segments_of_bin(seen, bin));
            }
        }
        std::mem::swap(&mut below, &mut above);
        above.iter_mut().for_each(Vec::clear);
    }
    interner.lists
}

/// The segments seen in a heading bin, ascending.
fn segments_of_bin(seen: [&Vec<u32>; 5], bin: usize) -> Vec<u32> {
    let fine = seen[0].len();
    let mut list: Vec<u32> = seen
        .iter()
        .flat_map(|seen| [seen[2 * bin], seen[2 * bin + 1], seen[(2 * bin + 2) % fine]])
        .filter(|&segment| segment != NOTHING)
        .collect();
    list.sort_unstable();
    list.dedup();
    list
}
