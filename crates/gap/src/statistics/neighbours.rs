//! Neighbouring beams that err alike.

use super::{Cell, Covariate, Deviation, Family, Form, Halves, Readings, Statistic};

/// The sum of products of the PITs of neighbouring beams' readings of the surface. Clutter and errors of the reference make
/// neighbours alike, too; the replicates say by how much.
pub(super) struct Neighbours;

impl Family for Neighbours {
    fn statistics(&self) -> Vec<Statistic> {
        let (covariate, deviation) = (Covariate::Neighbour, Deviation::Mean);
        vec![Statistic::of_cell(Cell { covariate, lo: 0.0, hi: 0.0, place: None, deviation }, Form::Other)]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let mut sum = [0.0; 2];
        for pair in log.all.windows(2) {
            let are_neighbours = pair[0].scan == pair[1].scan && pair[0].index + 1 == pair[1].index;
            let of_surface = pair.iter().all(|r| r.is_return && !r.is_in_front && !r.is_behind);
            if are_neighbours && of_surface {
                sum[pair[0].half] += (pair[0].pit - 0.5) * (pair[1].pit - 0.5);
            }
        }
        vec![sum]
    }
}
