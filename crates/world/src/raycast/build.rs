//! Filling a range table.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec2;
use rayon::prelude::*;

use super::ExactRangeMap;
use super::segment::range_to;
use super::sight::{NOTHING, SightKey, is_beyond};
use crate::map::CellFrame;

/// Cell rows per unit of parallel work; neighbouring bands both cast from the row of corners between them.
const BAND_ROWS: usize = 4;

/// A list has fewer walls than this: at most eight casts along a bin's edges and three between them from five points.
pub(super) const MOST_LISTED: usize = 32;

/// A range that is wrong by more than this is as wrong as can be \[m\].
const MOST_ERROR_M: f64 = 1.0;

/// A table's content: rows of cells, and sights by key.
pub(super) struct Built {
    /// Row of each cell of the frame, [`NO_ROW`] outside free space.
    pub rows: Vec<u32>,
    /// The content of each row's heading bins: an index into `contents.sights`, or behind these into `contents.lists`.
    pub entries: Vec<u32>,
    pub contents: BinContents,
}

/// The distinct contents of heading bins.
#[derive(Default)]
pub(super) struct BinContents {
    pub sights: Vec<SightKey>,
    /// Wall segments, ascending, of bins that no sight describes well enough.
    pub lists: Vec<Box<[u32]>>,
}

/// The walls that rays from a cell may meet in a bin of headings.
enum BinContent<'a> {
    Sight(SightKey),
    List(&'a [u32]),
}

/// Marks an index into the lists until it is known how many sights there are.
const LIST: u32 = 1 << 31;

/// The row of a cell from which no ray starts.
const NO_ROW: u32 = u32::MAX;

/// Marks the cells of which a corner or the centre is in free space.
pub(super) fn cells_in_sight(map: &ExactRangeMap, frame: &CellFrame) -> Vec<bool> {
    let free = |column2: usize, row2: usize| {
        let [x, y] = frame.half_cell(column2, row2);
        map.geometry().is_free(x, y)
    };
    let corners: Vec<bool> = (0..=frame.rows)
        .into_par_iter()
        .flat_map_iter(|row| (0..=frame.columns).map(move |column| free(2 * column, 2 * row)))
        .collect();
    let corner = |column: usize, row: usize| corners[row * (frame.columns + 1) + column];
    (0..frame.rows)
        .into_par_iter()
        .flat_map_iter(|row| {
            (0..frame.columns).map(move |column| {
                corner(column, row)
                    || corner(column + 1, row)
                    || corner(column, row + 1)
                    || corner(column + 1, row + 1)
                    || free(2 * column + 1, 2 * row + 1)
            })
        })
        .collect()
}

/// Fills the rows of the cells `in_sight`.
pub(super) fn build(
    map: &ExactRangeMap,
    frame: &CellFrame,
    headings: usize,
    in_sight: &[bool],
    tolerance_m: f64,
    progress: &(dyn Fn(f64) + Sync),
) -> Built {
    let mut entries = vec![0; in_sight.iter().filter(|inside| **inside).count() * headings];
    let direction = |bins: f64| DVec2::from_angle(TAU * bins / headings as f64);
    let edges: Vec<DVec2> = (0..headings).map(|i| direction(i as f64)).collect();
    let between = (0..headings).map(|i| [0.25, 0.5, 0.75].map(|part| direction(i as f64 + part))).collect();
    let caster = Caster { map, frame, edges, between, tolerance_m };

    // Each band of cell rows has a share of the entries and a pool of keys of its own.
    let mut bands = Vec::new();
    let mut rest = entries.as_mut_slice();
    for (band, inside) in in_sight.chunks(BAND_ROWS * frame.columns).enumerate() {
        let cells = inside.iter().filter(|inside| **inside).count();
        let (here, after) = rest.split_at_mut(cells * headings);
        rest = after;
        bands.push((band * BAND_ROWS, inside, here));
    }
    let done = AtomicUsize::new(0);
    let total = bands.len();
    let pools: Vec<BinContents> = bands
        .into_par_iter()
        .map(|(first_row, inside, entries)| {
            let contents = caster.fill_band(first_row, inside, entries);
            progress((done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / total as f64);
            contents
        })
        .collect();

    // Make the pools one, in order.
    let mut pool = Pool::default();
    let mut rest = entries.as_mut_slice();
    for (inside, contents) in in_sight.chunks(BAND_ROWS * frame.columns).zip(pools) {
        let sights: Vec<u32> =
            contents.sights.into_iter().map(|key| pool.index(&BinContent::Sight(key))).collect();
        let lists: Vec<u32> = contents.lists.iter().map(|list| pool.index(&BinContent::List(list))).collect();
        let cells = inside.iter().filter(|inside| **inside).count();
        let (here, after) = rest.split_at_mut(cells * headings);
        rest = after;
        for entry in here {
            *entry = if *entry < LIST { sights[*entry as usize] } else { lists[(*entry - LIST) as usize] };
        }
    }
    let sights = pool.contents.sights.len() as u32;
    for entry in entries.iter_mut().filter(|entry| **entry >= LIST) {
        *entry = *entry - LIST + sights;
    }
    Built { rows: rows_of(in_sight), entries, contents: pool.contents }
}

/// Numbers the cells `in_sight`.
pub(super) fn rows_of(in_sight: &[bool]) -> Vec<u32> {
    let mut count = 0;
    let row = |&inside: &bool| {
        count += u32::from(inside);
        if inside { count - 1 } else { NO_ROW }
    };
    in_sight.iter().map(row).collect()
}

/// Collects distinct contents.
#[derive(Default)]
struct Pool {
    contents: BinContents,
    sights: HashMap<SightKey, u32>,
    lists: HashMap<Box<[u32]>, u32>,
}

impl Pool {
    fn index(&mut self, content: &BinContent<'_>) -> u32 {
        let BinContents { sights, lists } = &mut self.contents;
        match *content {
            BinContent::Sight(key) => *self.sights.entry(key).or_insert_with(|| {
                sights.push(key);
                sights.len() as u32 - 1
            }),
            BinContent::List(list) => {
                if let Some(&index) = self.lists.get(list) {
                    return index;
                }
                let index = LIST + lists.len() as u32;
                lists.push(list.into());
                self.lists.insert(list.into(), index);
                index
            }
        }
    }
}

/// An exact cast that a sight has to explain.
struct Sample {
    origin: DVec2,
    direction: DVec2,
    wall: u32,
}

/// A corner of a cell.
struct Spot {
    at: DVec2,
    /// The wall that it sees along the lower edge of each heading bin; empty outside free space, from where nobody
    /// looks.
    walls: Vec<u32>,
}

struct Caster<'a> {
    map: &'a ExactRangeMap,
    frame: &'a CellFrame,
    /// Direction of the lower edge of each heading bin.
    edges: Vec<DVec2>,
    /// Directions within each bin, where two walls may hide a third between the edges.
    between: Vec<[DVec2; 3]>,
    tolerance_m: f64,
}

impl Caster<'_> {
    fn wall(&self, origin: DVec2, direction: DVec2) -> u32 {
        self.map.cast_segment(origin, direction, f64::INFINITY).map_or(NOTHING, |(segment, _)| segment as u32)
    }

    /// Fills the entries of the cells `inside`, rows of cells from `first_row` on; returns the contents that the entries
    /// point to.
    fn fill_band(&self, first_row: usize, inside: &[bool], entries: &mut [u32]) -> BinContents {
        let columns = self.frame.columns;
        let mut pool = Pool::default();
        // Casts from each corner of the cell row along each edge; `None` where none was needed yet.
        let mut below: Vec<Option<Spot>> = (0..=columns).map(|_| None).collect();
        let mut above: Vec<Option<Spot>> = (0..=columns).map(|_| None).collect();
        let mut scratch = Scratch::default();
        let mut entries = entries.chunks_mut(self.edges.len());
        for (row, inside) in (first_row..).zip(inside.chunks(columns)) {
            for column in (0..columns).filter(|&column| inside[column]) {
                for column in [column, column + 1] {
                    below[column].get_or_insert_with(|| self.look(2 * column, 2 * row));
                    above[column].get_or_insert_with(|| self.look(2 * column, 2 * row + 2));
                }
                let corners = [&below[column], &below[column + 1], &above[column], &above[column + 1]];
                let corners =
                    corners.map(|corner| corner.as_ref().expect("each corner has been looked from"));
                let centre = self.spot(2 * column + 1, 2 * row + 1);
                let centre = Some(centre).filter(|&centre| self.is_free(centre));
                let entries = entries.next().expect("one row of entries per cell");
                for (bin, entry) in entries.iter_mut().enumerate() {
                    *entry = pool.index(&self.content_of_bin(corners, centre, bin, &mut scratch));
                }
            }
            std::mem::swap(&mut below, &mut above);
            above.fill_with(|| None);
        }
        pool.contents
    }

    fn spot(&self, column2: usize, row2: usize) -> DVec2 {
        DVec2::from_array(self.frame.half_cell(column2, row2))
    }

    fn is_free(&self, spot: DVec2) -> bool {
        self.map.geometry().is_free(spot.x, spot.y)
    }

    fn look(&self, column2: usize, row2: usize) -> Spot {
        let at = self.spot(column2, row2);
        let walls = if self.is_free(at) {
            self.edges.iter().map(|&direction| self.wall(at, direction)).collect()
        } else {
            Vec::new()
        };
        Spot { at, walls }
    }

    /// The content that explains the exact casts from the corners of a cell along the edges of a heading bin. If they meet
    /// one wall, it is that wall. If they meet several, casts in between are added, and the content is the sight with the
    /// least error or, if that error is too large, the list of all walls that the casts meet.
    fn content_of_bin<'a>(
        &self,
        corners: [&Spot; 4],
        centre: Option<DVec2>,
        bin: usize,
        Scratch { samples, walls, trials }: &'a mut Scratch,
    ) -> BinContent<'a> {
        let next = (bin + 1) % self.edges.len();
        samples.clear();
        for corner in corners.into_iter().filter(|corner| !corner.walls.is_empty()) {
            for edge in [bin, next] {
                let (origin, direction) = (corner.at, self.edges[edge]);
                samples.push(Sample { origin, direction, wall: corner.walls[edge] });
            }
        }
        if let Some((first, rest)) = samples.split_first()
            && rest.iter().all(|sample| sample.wall == first.wall)
        {
            return BinContent::Sight(SightKey::single(first.wall));
        }
        for i in 0..samples.len() / 2 {
            let origin = samples[2 * i].origin;
            self.look_between(origin, bin, samples);
        }
        if let Some(centre) = centre {
            self.look_between(centre, bin, samples);
        }
        walls.clear();
        walls.extend(samples.iter().map(|sample| sample.wall));
        walls.sort_unstable();
        walls.dedup();
        trials.compare(self.map.geometry().segments(), walls, samples);
        let count = walls.len();
        // Worse than this, and the walls are listed.
        let mut least_error = self.tolerance_m * samples.len() as f64;
        let mut best = None;
        let mut consider = |pair: [usize; 2], corner: usize, least_error: &mut f64| {
            if walls[pair[corner >> 1]] == NOTHING && pair[0] != pair[1] {
                return;
            }
            let error = trials.error(pair, corner, *least_error);
            if error < *least_error || (error <= *least_error && best.is_none()) {
                let key = SightKey { walls: pair.map(|wall| walls[wall]), corner: corner as u32 };
                (*least_error, best) = (error, Some(key));
            }
        };
        (0..count).for_each(|wall| consider([wall, wall], 0, &mut least_error));
        for first in 0..count {
            for second in (0..count).filter(|&second| second != first) {
                let pair = [first, second];
                if trials.bound(pair) <= least_error {
                    (0..4).for_each(|corner| consider(pair, corner, &mut least_error));
                }
            }
        }
        if let Some(key) = best {
            return BinContent::Sight(key);
        }
        walls.retain(|&wall| wall != NOTHING);
        BinContent::List(walls)
    }

    fn look_between(&self, origin: DVec2, bin: usize, samples: &mut Vec<Sample>) {
        for direction in self.between[bin] {
            samples.push(Sample { origin, direction, wall: self.wall(origin, direction) });
        }
    }
}

/// Allocations that are used again for each bin of a cell.
#[derive(Default)]
struct Scratch {
    samples: Vec<Sample>,
    walls: Vec<u32>,
    trials: Trials,
}

/// How each wall would explain each sample. Sights are made of two walls and a corner, so that all pairs need nothing else.
#[derive(Default)]
struct Trials {
    samples: usize,
    /// By how much the wall misses the exact cast \[wall\]\[sample\] \[m\], at most [`MOST_ERROR_M`].
    errors: Vec<f64>,
    /// Whether the ray passes counter-clockwise of the corner at an end of a wall \[wall\]\[end\]\[sample\].
    beyond: Vec<bool>,
}

impl Trials {
    fn compare(&mut self, segments: &[[DVec2; 2]], walls: &[u32], samples: &[Sample]) {
        self.samples = samples.len();
        self.errors.clear();
        self.beyond.clear();
        for &wall in walls {
            self.errors.extend(samples.iter().map(|sample| error_of(segments, wall, sample)));
            for end in 0..2 {
                let corner = SightKey { walls: [wall, wall], corner: end }.corner(segments);
                self.beyond
                    .extend(samples.iter().map(|sample| is_beyond(corner, sample.origin, sample.direction)));
            }
        }
    }

    /// A lower bound of the errors of two walls' sights, whatever the corner. Walls by the dozen show in a bin where they are
    /// short, and hardly any two of them come near to the best.
    fn bound(&self, pair: [usize; 2]) -> f64 {
        let errors = |wall: usize| self.errors[wall * self.samples..][..self.samples].as_chunks::<4>().0;
        let [first, second] = pair.map(errors);
        let mut sums = [0.0; 4];
        for (a, b) in first.iter().zip(second) {
            for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
                *sum += if a < b { a } else { b };
            }
        }
        // Less what rounding may add in another order.
        sums.iter().sum::<f64>() * (1.0 - 1e-12)
    }

    /// The sum of the errors of a sight, or anything above `most` if it is more: of a pair of the walls that were compared, and
    /// a corner as in [`SightKey`].
    fn error(&self, pair: [usize; 2], corner: usize, most: f64) -> f64 {
        let n = self.samples;
        let [first, second] = pair.map(|wall| &self.errors[wall * n..][..n]);
        let corner = 2 * pair[corner >> 1] + (corner & 1);
        let mut sum = 0.0;
        for ((a, b), beyond) in first.iter().zip(second).zip(&self.beyond[corner * n..][..n]) {
            sum += if *beyond { b } else { a };
            if sum > most {
                break;
            }
        }
        sum
    }
}

/// By how much a wall misses an exact cast \[m\], at most [`MOST_ERROR_M`].
fn error_of(segments: &[[DVec2; 2]], wall: u32, sample: &Sample) -> f64 {
    if wall == sample.wall {
        return 0.0;
    }
    // A wall that the ray passes by counts with its line, as in a query.
    let range = |wall: u32| {
        let [a, b] = *segments.get(wall as usize)?;
        let normal = (b - a).perp();
        let range = normal.dot(a - sample.origin) / normal.dot(sample.direction);
        range_to(&[a, b], sample.origin, sample.direction).or(Some(range).filter(|r| *r >= 0.0))
    };
    match (range(wall), range(sample.wall)) {
        (Some(a), Some(b)) => (a - b).abs().min(MOST_ERROR_M),
        _ => MOST_ERROR_M,
    }
}
