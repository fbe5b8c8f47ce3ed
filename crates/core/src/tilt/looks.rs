use std::sync::Arc;

use rayon::prelude::*;

use super::{Class, Look, MOMENTS, Outcome, SHARES, Tilt};

/// What the readings of a log say of each moment under their tilts. The surface's moments and the shares don't depend on each other: where tilts of
/// the ones change, the others stay.
#[derive(Clone, Debug)]
pub struct Looks {
    surface: Arc<Vec<Look<MOMENTS>>>,
    shares: Arc<Vec<Look<SHARES>>>,
}

impl Looks {
    /// One tilt for each reading.
    #[must_use]
    pub fn new(readings: &[Outcome], tilts: &[Tilt]) -> Self {
        Self {
            surface: of_each(readings, tilts, Outcome::surface),
            shares: of_each(readings, tilts, Outcome::shares),
        }
    }

    /// The same under tilts of which only this moment's differ.
    #[must_use]
    pub fn with(&self, moment: usize, readings: &[Outcome], tilts: &[Tilt]) -> Self {
        let Self { surface, shares } = self.clone();
        if moment < MOMENTS {
            Self { surface: of_each(readings, tilts, Outcome::surface), shares }
        } else {
            Self { surface, shares: of_each(readings, tilts, Outcome::shares) }
        }
    }

    /// Log score gained by the tilts in each of `folds` folds (nats), where `fold_of` has the fold of each reading.
    #[must_use]
    pub fn score(&self, fold_of: &[usize], folds: usize) -> Vec<f64> {
        let mut score = vec![0.0; folds];
        for ((shares, surface), &fold) in self.shares.iter().zip(self.surface.iter()).zip(fold_of) {
            score[fold] += shares.gain + surface.gain;
        }
        score
    }

    /// The slope of each reading's log score by a moment's tilt, and its variance.
    pub fn pulls(&self, moment: usize) -> impl Iterator<Item = [f64; 2]> {
        self.surface.iter().zip(self.shares.iter()).map(move |(surface, shares)| {
            match moment.checked_sub(MOMENTS) {
                None => surface.pulls[moment],
                Some(share) => shares.pulls[share],
            }
        })
    }

    /// Errors of the readings beyond the model (standard deviations); `None` of one that isn't of the surface.
    #[must_use]
    pub fn errors(&self, readings: &[Outcome]) -> Vec<Option<f64>> {
        // The slope by a tilt of the mean is the error.
        let of = |([error, _], reading): ([f64; 2], &Outcome)| {
            matches!(reading.class, Class::Surface(_)).then_some(error)
        };
        self.pulls(0).zip(readings).map(of).collect()
    }

    /// The same of the beam before each reading's, in its scan.
    #[must_use]
    pub fn errors_before(&self, readings: &[Outcome]) -> Vec<Option<f64>> {
        let errors = self.errors(readings);
        let before = |i: usize| {
            let (before, here) = (readings.get(i.checked_sub(1)?)?, &readings[i]);
            if before.scan == here.scan && before.beam + 1 == here.beam { errors[i - 1] } else { None }
        };
        (0..readings.len()).map(before).collect()
    }

    /// Correlation of neighbouring beams' errors beyond the model.
    #[must_use]
    pub fn neighbour_correlation(&self, readings: &[Outcome]) -> f64 {
        let [mut xy, mut xx, mut yy] = [0.0; 3];
        for pair in self.errors_before(readings).into_iter().zip(self.errors(readings)) {
            if let (Some(x), Some(y)) = pair {
                xy += x * y;
                xx += x * x;
                yy += y * y;
            }
        }
        xy / (xx * yy).sqrt().max(1e-300)
    }
}

fn of_each<T: Send>(
    readings: &[Outcome],
    tilts: &[Tilt],
    look: impl Fn(&Outcome, &Tilt) -> T + Sync,
) -> Arc<Vec<T>> {
    Arc::new(readings.par_iter().zip(tilts).map(|(reading, tilt)| look(reading, tilt)).collect())
}
