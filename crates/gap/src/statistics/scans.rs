//! Scans as wholes: how much they differ by what their beams share, such as a pose or a cloud of dust.

use super::{Cell, Covariate, Deviation, Family, Form, Halves, Readings, Statistic};

const DEVIATIONS: [Deviation; 3] = [Deviation::Mean, Deviation::Short, Deviation::NoReturn];

/// A reading that is lost in one scan changes its differences to both neighbours by 1. Replicates may have none.
const BY_ONE: f64 = 2.0;

/// The squared differences of consecutive scans in the sums of their PITs, of their readings in front and of missing returns.
/// Deviations that stay from scan to scan are for other cells.
pub(super) struct Scans;

impl Family for Scans {
    fn statistics(&self) -> Vec<Statistic> {
        let cell = |deviation| Cell { covariate: Covariate::Scan, lo: 0.0, hi: 0.0, place: None, deviation };
        DEVIATIONS
            .map(|deviation| Statistic::of_cell(cell(deviation), Form::Other).with_one_reading(BY_ONE))
            .to_vec()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let max = log.max_range();
        let mut of_scans = vec![[0.0; DEVIATIONS.len()]; log.comparison.views.scans()];
        for reading in &log.all {
            let is_missing = !reading.is_return && reading.beam.range() < max;
            let summands = [reading.pit - 0.5, reading.terms.short, f64::from(u8::from(is_missing))];
            for (sum, summand) in of_scans[reading.scan].iter_mut().zip(summands) {
                *sum += summand;
            }
        }
        let folds = log.comparison.recorded.folds;
        let mut sums = vec![[0.0; 2]; DEVIATIONS.len()];
        for (scan, pair) in of_scans.windows(2).enumerate() {
            for (sum, (before, after)) in sums.iter_mut().zip(pair[0].iter().zip(pair[1])) {
                sum[folds.half_of(scan)] += (after - before).powi(2);
            }
        }
        sums
    }
}
