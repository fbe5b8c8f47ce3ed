//! How far readings that aren't of the surface are along their beams.

use super::{Cell, Covariate, Deviation, Family, Form, Halves, Readings, Statistic};

/// Width of a bin of the ratio of a reading to the nominal range, and the number of bins: up to 3 and beyond.
const WIDTH: f64 = 0.1;
const BINS: usize = 31;
/// Where the last bin is said to end.
const LARGEST: f64 = 1000.0;

/// The histogram of the ratio of a reading to the nominal range, of readings in front of the surface or behind it.
pub(super) struct Ratios;

impl Family for Ratios {
    fn statistics(&self) -> Vec<Statistic> {
        let cell = |i: usize| {
            let lo = i as f64 * WIDTH;
            let hi = if i + 1 == BINS { LARGEST } else { lo + WIDTH };
            Cell { covariate: Covariate::Ratio, lo, hi, place: None, deviation: Deviation::Share }
        };
        (0..BINS).map(|i| Statistic::of_cell(cell(i), Form::Count)).collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let mut counts = vec![[0.0; 2]; BINS];
        for reading in log.all.iter().filter(|reading| reading.is_in_front || reading.is_behind) {
            let bin = (reading.z / ((reading.beam.range() + reading.shift) * WIDTH)) as usize;
            counts[bin.min(BINS - 1)][reading.half] += 1.0;
        }
        counts
    }
}
