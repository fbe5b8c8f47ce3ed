//! A reading as the outcome of a few classes: of the surface that the beam meets, in bins of its PIT there, of something in front of it or
//! behind it, or of nothing; and what tilts of its moments make of that.

use super::{MOMENTS, MOST, bins, share_within, tilted};

/// Classes beside the surface's, each with the share of readings that are of it as its moment.
pub const SHARES: usize = 4;
/// Moments of a reading: those of the surface's readings, and the shares of the other classes.
pub const MOMENTS_OF_READING: usize = MOMENTS + SHARES;
/// The least variance that a class with a small probability counts as having.
const LEAST_VARIANCE: f64 = 1e-9;

/// The logarithm of what the probabilities of a reading are multiplied by, for each moment (1).
#[derive(Clone, Copy, Debug, Default)]
pub struct Tilt(pub [f64; MOMENTS_OF_READING]);

/// What a reading says of moments that don't depend on others': those of the surface's readings, or the shares of the other classes.
#[derive(Clone, Copy, Debug)]
pub struct Look<const N: usize> {
    /// Log score gained by their tilts (nats).
    pub gain: f64,
    /// The slope of the log score by each moment's tilt, and its variance.
    pub pulls: [[f64; 2]; N],
}

impl<const N: usize> Default for Look<N> {
    fn default() -> Self {
        Self { gain: 0.0, pulls: [[0.0; 2]; N] }
    }
}

/// The class of a reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Of the surface, in a bin.
    Surface(u8),
    /// In front of the surface, where other things can stand.
    Short,
    /// Behind the surface.
    Long,
    /// No return.
    NoReturn,
    /// In front of the surface, where hardly anything can stand.
    Open,
}

/// A reading with the probabilities of its classes under a model.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// Index of its scan in the log.
    pub scan: u32,
    /// Index of its beam in the log.
    pub beam: u32,
    /// Its class.
    pub class: Class,
    /// Probabilities of the classes, in the order of [`Class`].
    pub probabilities: [f64; 1 + SHARES],
    /// Standard deviation of a reading of the surface \[m\]; 0 of a beam that meets none.
    pub sigma: f64,
}

impl Class {
    /// Its index among [`Outcome::probabilities`].
    #[must_use]
    pub fn index(self) -> usize {
        match self {
            Self::Surface(_) => 0,
            Self::Short => 1,
            Self::Long => 2,
            Self::NoReturn => 3,
            Self::Open => 4,
        }
    }
}

impl Outcome {
    /// Probabilities of the classes under a tilt.
    fn classes(&self, tilt: &Tilt) -> [f64; 1 + SHARES] {
        let mut shares = self.probabilities;
        for (share, tilt) in shares[1..].iter_mut().zip(&tilt.0[MOMENTS..]) {
            if *tilt != 0.0 {
                *share *= tilt.clamp(-MOST, MOST).exp();
            }
        }
        let total: f64 = shares.iter().sum();
        shares.map(|share| share / total)
    }

    /// What a tilt of the surface's moments makes of the reading; nothing of one that isn't of the surface.
    #[must_use]
    pub fn surface(&self, tilt: &Tilt) -> Look<MOMENTS> {
        let mut look = Look::default();
        if let Class::Surface(bin) = self.class {
            let (bin, shares) = (usize::from(bin), tilted(&tilt.0));
            look.gain = (shares[bin] / bins().weight[bin] * share_within()).ln();
            let mut means = [0.0; 2 * MOMENTS];
            for (share, basis) in shares.iter().zip(&bins().squares) {
                means.iter_mut().zip(basis).for_each(|(mean, b)| *mean += share * b);
            }
            for (moment, pull) in look.pulls.iter_mut().enumerate() {
                let [mean, square] = [means[moment], means[MOMENTS + moment]];
                *pull = [bins().basis[bin][moment] - mean, square - mean * mean];
            }
        }
        look
    }

    /// What a tilt of the other classes' shares makes of the reading.
    #[must_use]
    pub fn shares(&self, tilt: &Tilt) -> Look<SHARES> {
        let (shares, own) = (self.classes(tilt), self.class.index());
        let pull = |class: usize| {
            let hit = f64::from(u8::from(class == own));
            [hit - shares[class], (shares[class] * (1.0 - shares[class])).max(LEAST_VARIANCE)]
        };
        let gain = (shares[own] / self.probabilities[own]).ln();
        Look { gain, pulls: std::array::from_fn(|share| pull(1 + share)) }
    }

    /// The slope of the log score by a moment's tilt, and its variance.
    #[must_use]
    pub fn pull(&self, tilt: &Tilt, moment: usize) -> [f64; 2] {
        match moment.checked_sub(MOMENTS) {
            None => self.surface(tilt).pulls[moment],
            Some(share) => self.shares(tilt).pulls[share],
        }
    }

    /// The change that a tilt of one moment makes: the mean of a reading of the surface \[m\], its spread (a factor, less 1), its skewness,
    /// or the share of a class. `None` of a beam that meets no surface, for the surface's moments.
    #[must_use]
    pub fn change(&self, moment: usize, by: f64) -> Option<f64> {
        let mut tilt = Tilt::default();
        tilt.0[moment] = by;
        if moment >= MOMENTS {
            let class = moment - MOMENTS + 1;
            return Some(self.classes(&tilt)[class] - self.probabilities[class]);
        }
        if self.sigma == 0.0 {
            return None;
        }
        let of = |tilt: &Tilt| {
            let mut means = [0.0; MOMENTS];
            for (share, basis) in tilted(&tilt.0).iter().zip(&bins().basis) {
                means.iter_mut().zip(basis).for_each(|(mean, basis)| *mean += share * basis);
            }
            means
        };
        let [mean, square, cube] = of(&tilt);
        Some(match moment {
            0 => self.sigma * mean,
            1 => {
                let [_, plain, _] = of(&Tilt::default());
                ((1.0 + square - mean * mean) / (1.0 + plain)).max(0.0).sqrt() - 1.0
            }
            _ => cube,
        })
    }

    /// What a reading counts for in the mean change of a moment: 1, or the probability that it isn't of the share's class.
    #[must_use]
    pub fn weight(&self, moment: usize) -> f64 {
        let class = (moment + 1).checked_sub(MOMENTS).filter(|class| *class > 0);
        class.map_or(1.0, |class| 1.0 - self.probabilities[class])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLASSES: [Class; 5] = [Class::Surface(7), Class::Short, Class::Long, Class::NoReturn, Class::Open];

    fn gain(outcome: &Outcome, tilt: &Tilt) -> f64 {
        outcome.surface(tilt).gain + outcome.shares(tilt).gain
    }

    fn outcome(class: Class) -> Outcome {
        Outcome { scan: 0, beam: 0, class, probabilities: [0.7, 0.1, 0.05, 0.1, 0.05], sigma: 0.01 }
    }

    /// A log score that is a density's: its exponential has the mean 1 under the model, for every tilt.
    #[test]
    fn a_tilted_outcome_is_a_distribution() {
        let tilt = Tilt([0.4, -0.2, 0.1, 0.8, -0.5, 0.3, 1.2]);
        let surface = bins().weight.iter().enumerate().map(|(bin, weight)| {
            0.7 * weight / share_within() * gain(&outcome(Class::Surface(bin as u8)), &tilt).exp()
        });
        let others = CLASSES[1..].iter().zip([0.1, 0.05, 0.1, 0.05]);
        let others = others.map(|(&class, share)| share * gain(&outcome(class), &tilt).exp());
        let total = surface.sum::<f64>() + others.sum::<f64>();
        assert!((total - 1.0).abs() < 1e-12, "{total}");
    }

    #[test]
    fn a_pull_is_the_slope_of_the_gain() {
        let tilt = Tilt([0.3, 0.1, -0.05, 0.4, -0.2, 0.1, 0.6]);
        for class in CLASSES {
            let (outcome, step) = (outcome(class), 1e-6);
            let (surface, shares) = (outcome.surface(&tilt).pulls, outcome.shares(&tilt).pulls);
            for (moment, [slope, _]) in surface.into_iter().chain(shares).enumerate() {
                let at = |by: f64| {
                    let mut tilt = tilt;
                    tilt.0[moment] += by;
                    gain(&outcome, &tilt)
                };
                let expected = (at(step) - at(-step)) / (2.0 * step);
                assert!((slope - expected).abs() < 1e-6, "{class:?} {moment}: {slope} {expected}");
            }
        }
    }
}
