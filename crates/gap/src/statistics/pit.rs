//! The histogram of the PIT over all readings.

use super::{Cell, Covariate, Deviation, Family, Form, Halves, Readings, Statistic};

/// Its number of bins.
const BINS: u32 = 10;

pub(super) struct PitHistogram;

impl Family for PitHistogram {
    fn statistics(&self) -> Vec<Statistic> {
        let edge = |i: u32| 0.1 * f64::from(i);
        let cell = |i: u32| Cell {
            covariate: Covariate::Pit,
            lo: edge(i),
            hi: edge(i + 1),
            place: None,
            deviation: Deviation::Share,
        };
        (0..BINS).map(|i| Statistic::of_cell(cell(i), Form::Other)).collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let mut counts = vec![[0.0; 2]; BINS as usize];
        for reading in &log.all {
            let bin = (f64::from(BINS) * reading.pit) as usize;
            counts[bin.min(BINS as usize - 1)][reading.half] += 1.0;
        }
        counts
    }
}
