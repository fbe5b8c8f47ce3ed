//! Whether today's readings are noisier than the baseline's, by the differences of neighbouring beams.
//!
//! A reference that errs by more looks like noise at each place. But its errors are those of whole scans: neighbouring beams on one wall err
//! alike, and what each is off the mean of its neighbours is noise of the laser.

use std::collections::HashMap;
use std::f64::consts::PI;

use locsim_world::effect::{EffectKind, Score, Statistic};

use super::assignment::Assignment;
use super::pool::{Pool, Reading};

/// Neighbours on one wall: the incidence changes as evenly as the bearing, to this share of the step between beams.
const EVENLY: f64 = 0.2;
/// Errors of the surface that a beam meets \[m\]: others are of something else.
const SURFACE_M: f64 = 0.3;
/// Differences beyond this many times the median one count as this.
const CUT: f64 = 6.0;
/// Fewer differences of one log at a place say nothing of the place.
const LEAST: f64 = 3.0;
/// Fewer places say nothing.
const LEAST_PLACES: usize = 8;
/// Standard errors between places by which today's differences have to be larger: the one-sided 2.5 % quantile.
pub(super) const SURELY: f64 = 1.96;

/// A smaller difference is a digit of the file \[m\].
const LEAST_SIZE_M: f64 = 1e-3;
/// The bulk's noise has grown by this share of that of all readings where all have: heavier tails leave the bulk as it is.
const OF_BULK: f64 = 0.75;
/// The variance has grown by this share where a kind says that it has hardly grown.
const OF_PART: f64 = 0.5;
/// Walls are slanted from here on \[rad\].
const SLANTED_RAD: f64 = 0.785;

/// A reading's difference from the mean of its neighbours.
struct Difference {
    stretch: u32,
    place: u32,
    /// Its size \[m\], cut.
    size: f64,
    /// Range \[m\] and incidence \[rad\] of the beam.
    range: f64,
    incidence: f64,
}

/// The differences of readings at places that both logs have seen, by place.
pub(super) struct Neighbours {
    all: Vec<Difference>,
}

/// Whether a kind widens the distribution of all readings, as errors of the reference do.
pub(super) fn is_noise(kind: EffectKind) -> bool {
    let is_spread = |statistic: &Statistic| {
        matches!(statistic, Statistic::Score { score: Score::Scale | Score::Tail, .. })
    };
    let description = kind.description();
    description.is_as_map_errors && description.statistics.iter().any(is_spread)
}

impl Neighbours {
    pub fn new(pool: &Pool<'_>) -> Self {
        let mut all = differences(pool);
        let mut sizes: Vec<f64> = all.iter().map(|of| of.size).collect();
        if !sizes.is_empty() {
            let most = CUT * locsim_core::median(&mut sizes);
            for of in &mut all {
                of.size = of.size.min(most);
            }
        }
        all.sort_by_key(|of| of.place);
        Self { all }
    }

    /// How surely neighbouring beams differ by more on today's stretches than on the baseline's, in standard errors between places; `None` where
    /// too few places tell, as on a map of cells, whose walls have no incidence.
    pub fn contrast(&self, assignment: &Assignment) -> Option<f64> {
        let more = self.means(assignment, |_| true, |size| size).into_iter();
        errors_above(&more.map(|[weight, baseline, today]| [weight, today - baseline]).collect::<Vec<_>>())
    }

    /// The weight of each place that both have seen, and the means of a function of the differences on the baseline's stretches and on today's.
    fn means(
        &self,
        assignment: &Assignment,
        is_used: impl Fn(&Difference) -> bool,
        function: impl Fn(f64) -> f64,
    ) -> Vec<[f64; 3]> {
        let of_place = |of_place: &[Difference]| {
            let mean_of = |is_own: &[bool]| {
                let own = of_place.iter().filter(|of| is_own[of.stretch as usize] && is_used(of));
                let add = |(count, sum), of: &Difference| (count + 1.0, sum + function(of.size));
                let (count, sum) = own.fold((0.0, 0.0), add);
                (count >= LEAST).then(|| [count, sum / count])
            };
            let ([n, baseline], [m, today]) =
                (mean_of(&assignment.is_baseline)?, mean_of(&assignment.is_today)?);
            Some([n * m / (n + m), baseline, today])
        };
        self.all.chunk_by(|a, b| a.place == b.place).filter_map(of_place).collect()
    }

    /// The mean of a function of the differences, on the baseline's stretches and on today's, at the same places.
    fn mean(
        &self,
        assignment: &Assignment,
        is_used: impl Fn(&Difference) -> bool,
        function: impl Fn(f64) -> f64,
    ) -> [f64; 2] {
        let means = self.means(assignment, is_used, function);
        let whole = means.iter().map(|[weight, ..]| weight).sum::<f64>().max(1e-12);
        [1, 2].map(|log| means.iter().map(|of| of[0] * of[log]).sum::<f64>() / whole)
    }

    /// The noise of the baseline and of today \[m\].
    pub fn noise(&self, assignment: &Assignment) -> [f64; 2] {
        // The mean of a normal number's size, and half of the variance of each neighbour's.
        self.mean(assignment, |_| true, |size| size).map(|size| size / (2.0 / PI).sqrt() / 1.5_f64.sqrt())
    }

    /// Whether the noise has grown where a kind of noise says little of it, by nearly as much: of near returns, of walls that face the laser, of the
    /// bulk of the readings.
    pub fn are_all_noisier(&self, kind: EffectKind, assignment: &Assignment) -> bool {
        let grown = |is_used: &dyn Fn(&Difference) -> bool| {
            let [baseline, today] = self.mean(assignment, is_used, |size| size * size);
            today - baseline
        };
        let of_tail =
            |statistic: &Statistic| matches!(statistic, Statistic::Score { score: Score::Tail, .. });
        if kind.description().statistics.iter().any(of_tail) {
            let [baseline, today] = self.mean(assignment, |_| true, |size| size.max(LEAST_SIZE_M).ln());
            let squares = self.mean(assignment, |_| true, |size| size * size);
            let [less, more] = squares.map(|square| 0.5 * square.ln());
            return today - baseline >= OF_BULK * (more - less);
        }
        let mut ranges: Vec<f64> = self.all.iter().map(|of| of.range).collect();
        let range = locsim_core::median(&mut ranges);
        let parts: [&dyn Fn(&Difference) -> bool; 2] = if kind.description().needs.map {
            [&|of| of.incidence < SLANTED_RAD, &|of| of.incidence >= SLANTED_RAD]
        } else {
            [&|of| of.range < range, &|of| of.range >= range]
        };
        let [little, much] = parts.map(grown);
        little >= OF_PART * much
    }
}

/// The weighted mean of places in standard errors between them; `None` of few.
fn errors_above(more: &[[f64; 2]]) -> Option<f64> {
    if more.len() < LEAST_PLACES {
        return None;
    }
    let whole: f64 = more.iter().map(|[weight, _]| weight).sum();
    let mean = more.iter().map(|[weight, more]| weight * more).sum::<f64>() / whole;
    let variance: f64 = more.iter().map(|[weight, more]| (weight * (more - mean) / whole).powi(2)).sum();
    Some(mean / variance.sqrt().max(1e-12))
}

/// The differences of readings at shared places from the mean of both neighbours, where all three are of one wall.
fn differences(pool: &Pool<'_>) -> Vec<Difference> {
    let error = |reading: &Reading| {
        let error = f64::from(reading.z) - f64::from(reading.expected.mean);
        (error.abs() < SURFACE_M).then_some(error)
    };
    let errors: HashMap<(usize, usize), f64> = pool
        .readings
        .iter()
        .filter_map(|reading| Some(((reading.log, reading.index), error(reading)?)))
        .collect();
    let difference = |reading: &Reading| {
        let log = &pool.logs[reading.log];
        let beam = reading.index % log.views.per_scan;
        if beam == 0 || beam + 1 == log.views.per_scan {
            return None;
        }
        let [before, here, after] = [reading.index - 1, reading.index, reading.index + 1];
        let [a, b, c] = [before, here, after].map(|index| &log.views.beams[index].view);
        let bend = a.incidence + c.incidence - 2.0 * b.incidence;
        if bend.abs() > EVENLY * (c.bearing - b.bearing).abs() {
            return None;
        }
        let of = |index: usize| errors.get(&(reading.log, index)).copied();
        let size = (of(here)? - 0.5 * (of(before)? + of(after)?)).abs();
        let (stretch, place) = (reading.stretch, reading.expected.place);
        Some(Difference { stretch, place, size, range: b.range, incidence: b.incidence })
    };
    pool.at_shared_places().iter().filter_map(difference).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve places, seen on four stretches of each log. Today's differences are larger by a tenth at each, or at one alone by as much in all.
    #[test]
    fn noise_is_more_at_all_places() {
        let contrast = |more: &dyn Fn(u32) -> f64| {
            let of = |(place, stretch): (u32, u32)| {
                let jitter = 0.02 * f64::from((7 * place + 3 * stretch) % 5);
                let size = 1.0 + jitter + if stretch >= 4 { more(place) } else { 0.0 };
                Difference { stretch, place, size, range: 3.0, incidence: 0.1 }
            };
            let pairs = (0..12).flat_map(|place| (0..8).map(move |stretch| (place, stretch)));
            let assignment = Assignment {
                is_baseline: (0..8).map(|stretch| stretch < 4).collect(),
                is_today: (0..8).map(|stretch| stretch >= 4).collect(),
            };
            Neighbours { all: pairs.map(of).collect() }.contrast(&assignment).unwrap()
        };
        assert!(contrast(&|_| 0.1) > 5.0, "{}", contrast(&|_| 0.1));
        assert!(contrast(&|_| 0.0).abs() < SURELY);
        assert!(contrast(&|place| if place == 5 { 1.2 } else { 0.0 }) < SURELY);
        let nowhere = Assignment { is_baseline: vec![true, false], is_today: vec![false, true] };
        assert_eq!(Neighbours { all: Vec::new() }.contrast(&nowhere), None);
    }

    /// Noise that has doubled everywhere, beyond 3 m, on slanted walls, and of a tenth of the readings by far.
    #[test]
    fn noise_of_every_beam_is_that_of_near_and_far_and_of_the_bulk() {
        let normal = |i: u32| [0.2, 1.1, 0.6, 1.7, 0.4, 0.9, 0.1, 1.3, 0.7, 2.2][i as usize % 10];
        let grown = |factor: &dyn Fn(u32, f64, f64) -> f64| {
            let of = |i: u32| {
                let (place, stretch) = (i / 80, i % 8);
                let (range, incidence) = (1.0 + f64::from(i % 5), 0.3 * f64::from(i % 4));
                let factor = if stretch >= 4 { factor(i, range, incidence) } else { 1.0 };
                Difference { stretch, place, size: 0.01 * normal(i / 8) * factor, range, incidence }
            };
            let assignment = Assignment {
                is_baseline: (0..8).map(|stretch| stretch < 4).collect(),
                is_today: (0..8).map(|stretch| stretch >= 4).collect(),
            };
            let neighbours = Neighbours { all: (0..960).map(of).collect() };
            [EffectKind::RangeNoise, EffectKind::IncidenceNoise, EffectKind::HeavyTail]
                .map(|kind| neighbours.are_all_noisier(kind, &assignment))
        };
        assert_eq!(grown(&|_, _, _| 2.0), [true; 3]);
        assert!(!grown(&|_, range, _| if range > 3.0 { 2.0 } else { 1.0 })[0]);
        assert!(!grown(&|_, _, incidence| if incidence > 0.785 { 2.0 } else { 1.0 })[1]);
        assert!(!grown(&|i, _, _| if i % 10 == 3 { 6.0 } else { 1.0 })[2]);
    }

    #[test]
    fn kinds_of_noise_are_those_that_spread_readings() {
        let kinds: Vec<EffectKind> = EffectKind::ALL.into_iter().filter(|kind| is_noise(*kind)).collect();
        assert_eq!(kinds, [EffectKind::RangeNoise, EffectKind::IncidenceNoise, EffectKind::HeavyTail]);
    }
}
