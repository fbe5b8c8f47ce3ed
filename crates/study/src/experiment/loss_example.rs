//! Two losses of two predictions (Fig. 5).

use distreg::{Distribution, Grid, euclidean, histogram_match};

use crate::results::LossExample;
use crate::{Study, StudyError};

/// The paper's Fig. 5: predictions of the same shape as the reference, one moved a little, one moved far. Neither overlaps
/// with it, so that the Euclidean distance can't tell them apart.
pub(super) fn loss_example(study: &Study) -> Result<(LossExample, [Distribution; 3]), StudyError> {
    let grid = Grid { lo: 0.0, width: study.setup.outcomes.grid.width, bins: 60 };
    let bump = |from: usize| -> Result<Distribution, StudyError> {
        let mut mass = vec![0.0; grid.bins];
        for (b, share) in [1.0, 3.0, 5.0, 3.0, 1.0].into_iter().enumerate() {
            mass[from + b] = share;
        }
        Ok(Distribution::new(grid, mass, None)?)
    };
    // The far one is a little lower and wider, so that the Euclidean distance even prefers it.
    let mut far = vec![0.0; grid.bins];
    for (b, share) in [1.0, 2.0, 3.0, 3.0, 3.0, 2.0, 1.0].into_iter().enumerate() {
        far[45 + b] = share;
    }
    let three = [bump(10)?, bump(16)?, Distribution::new(grid, far, None)?];
    let [reference, near, far] = &three;
    let example = LossExample {
        histogram_match: [histogram_match(near, reference)?, histogram_match(far, reference)?],
        euclidean: [euclidean(near, reference)?, euclidean(far, reference)?],
    };
    Ok((example, three))
}
