//! The distribution of readings at each place, learnt from the baseline.
//!
//! A place has a histogram of the error against the scenario's range, and shares of readings in front, behind and without a
//! return. It is drawn to that of all places of its class, which stands for as many readings as [`PRIOR_READINGS`].

use super::pool::{CLASSES, Expected, Pool, REACH_M};

/// Width of its bins \[m\]: the noise of a laser, and twice the step of many.
const BIN_M: f64 = 0.01;
const BINS: usize = (2.0 * REACH_M / BIN_M) as usize;
/// Readings that the class of a place counts as.
const PRIOR_READINGS: f32 = 8.0;
/// Standard deviations by which histograms are widened \[m\]; between them is interpolated.
const WIDENED_M: [f64; 7] = [0.0, 0.015, 0.03, 0.06, 0.12, 0.24, 0.48];
/// Share of a uniform density under everything, so that no single reading decides.
const FLOOR: f64 = 1e-3;
/// The least length over which readings in front or behind are spread \[m\].
const LEAST_M: f64 = 0.5;

/// Shares of a place's readings that are of no surface.
const FRONT: usize = 0;
const BEHIND: usize = 1;
const LOST: usize = 2;

/// The readings' distributions by the baseline. Readings of the baseline itself are held against what is learnt from its other half,
/// every other stretch: a place that the histograms don't fit then looks the same on both logs.
pub(super) struct Learnt {
    whole: Distribution,
    halves: [Distribution; 2],
    /// The half that a stretch of the baseline is held against.
    half_of: Vec<Option<usize>>,
}

impl Learnt {
    /// Learns from the stretches that `is_baseline` holds for.
    pub fn new(pool: &Pool<'_>, is_baseline: &[bool]) -> Self {
        let mut half_of = vec![None; is_baseline.len()];
        let own = half_of.iter_mut().zip(is_baseline).filter(|(_, is)| **is);
        own.enumerate().for_each(|(i, (half, _))| *half = Some(i % 2));
        let half = |which: usize| {
            let is_other: Vec<bool> = half_of.iter().map(|half| *half == Some(1 - which)).collect();
            Distribution::new(pool, &is_other)
        };
        Self { whole: Distribution::new(pool, is_baseline), halves: [half(0), half(1)], half_of }
    }

    /// Density of a reading of a stretch \[1/m\], a probability at the maximum range.
    #[inline]
    pub fn density(&self, stretch: u32, expected: &Expected, z: f32) -> f64 {
        let half = self.half_of[stretch as usize];
        half.map_or(&self.whole, |half| &self.halves[half]).density(expected, z)
    }

    /// Adds the expected distribution of errors to a histogram, with those in front, behind and without a return at its ends.
    pub fn add_errors(&self, expected: &Expected, base: f32, histogram: &mut [f64]) {
        self.whole.add_errors(expected, base, histogram);
    }
}

/// The readings' distribution at each place.
struct Distribution {
    /// Density of the error at each place \[1/m\], \[width\]\[place\]\[bin\].
    errors: Vec<Vec<[f32; BINS]>>,
    shares: Vec<[f32; 3]>,
    max: f64,
    grid: f64,
}

/// Counts of a place.
#[derive(Clone)]
struct Counts {
    errors: [f32; BINS],
    shares: [f32; 3],
    all: f32,
}

impl Counts {
    const NONE: Self = Self { errors: [0.0; BINS], shares: [0.0; 3], all: 0.0 };

    /// Drawn to a distribution that counts as `readings` readings.
    fn drawn_to(&self, other: &Self, readings: f32) -> Self {
        let factor = 1.0 / (self.all + readings);
        let mix = |own: f32, other: f32| factor * (own + readings * other);
        Self {
            errors: std::array::from_fn(|i| mix(self.errors[i], other.errors[i])),
            shares: std::array::from_fn(|i| mix(self.shares[i], other.shares[i])),
            all: 1.0,
        }
    }
}

impl Distribution {
    /// Learns from the stretches that `is_used` holds for.
    fn new(pool: &Pool<'_>, is_used: &[bool]) -> Self {
        let max = pool.nominal.laser.max_range_m;
        let mut counts = vec![Counts::NONE; pool.places];
        for reading in pool.at_shared_places() {
            if !is_used[reading.stretch as usize] {
                continue;
            }
            let place = &mut counts[reading.expected.place as usize];
            place.all += 1.0;
            match outcome(f64::from(reading.z), f64::from(reading.expected.mean), max) {
                Outcome::Error(error) => {
                    let at = (error + REACH_M) / BIN_M;
                    let bin = (at as usize).min(BINS - 1);
                    for (bin, share) in [(bin.saturating_sub(1), 0.25), (bin, 0.5), (bin + 1, 0.25)] {
                        place.errors[bin.min(BINS - 1)] += share;
                    }
                }
                Outcome::Not(share) => place.shares[share] += 1.0,
            }
        }
        let mut classes = vec![Counts::NONE; CLASSES];
        for (place, &class) in counts.iter().zip(&pool.class_of) {
            let class = &mut classes[class as usize];
            class.all += place.all;
            class.errors.iter_mut().zip(place.errors).for_each(|(sum, more)| *sum += more);
            class.shares.iter_mut().zip(place.shares).for_each(|(sum, more)| *sum += more);
        }
        let even = Counts { errors: [0.8 / BINS as f32; BINS], shares: [0.2 / 3.0; 3], all: 1.0 };
        let classes: Vec<Counts> =
            classes.iter().map(|class| class.drawn_to(&even, PRIOR_READINGS)).collect();
        let drawn = |place: &Counts, class: u8| place.drawn_to(&classes[class as usize], PRIOR_READINGS);
        let places = || counts.iter().zip(&pool.class_of);
        let shares = places().map(|(place, &class)| drawn(place, class).shares).collect();
        let widened = |sigma: f64| -> Vec<[f32; BINS]> {
            let kernel = kernel(sigma);
            // Places have few readings, and classes many: apart that is less work.
            let of_classes: Vec<[f32; BINS]> =
                classes.iter().map(|class| widen(&class.errors, &kernel)).collect();
            let density = |(place, &class): (&Counts, &u8)| {
                let factor = 1.0 / (BIN_M as f32 * (place.all + PRIOR_READINGS));
                let own = widen(&place.errors, &kernel);
                let class = &of_classes[class as usize];
                std::array::from_fn(|bin| factor * (own[bin] + PRIOR_READINGS * class[bin]))
            };
            places().map(density).collect()
        };
        let errors = WIDENED_M.iter().map(|&sigma| widened(sigma)).collect();
        Self { errors, shares, max, grid: pool.nominal.laser.resolution_m.max(1e-3) }
    }

    #[inline]
    fn density(&self, expected: &Expected, z: f32) -> f64 {
        let z = f64::from(z);
        let place = expected.place as usize;
        let learnt = match outcome(z, f64::from(expected.mean), self.max) {
            Outcome::Error(error) => {
                let [p, sigma] = expected.tail.map(f64::from);
                let widened = f64::from(expected.widened);
                let plain = self.of_error(place, widened_for(expected, widened), error);
                if p > 0.0 {
                    (1.0 - p) * plain + p * self.of_error(place, sigma.hypot(widened), error)
                } else {
                    plain
                }
            }
            Outcome::Not(LOST) => f64::from(self.shares[place][LOST]),
            Outcome::Not(share) => {
                let mean = f64::from(expected.mean);
                let length = match share {
                    FRONT if mean.is_infinite() => self.max,
                    FRONT => mean - REACH_M,
                    _ => self.max - mean - REACH_M,
                };
                f64::from(self.shares[place][share]) / length.max(LEAST_M)
            }
        };
        let learnt = learnt * self.on_step(expected, z);
        let density = f64::from(expected.kept) * learnt + f64::from(expected.added);
        (1.0 - FLOOR) * density + FLOOR / self.max
    }

    /// The factor on a density that a coarser step makes: readings that are no multiples are impossible.
    fn on_step(&self, expected: &Expected, z: f64) -> f64 {
        let step = f64::from(expected.step);
        if step <= 0.0 || z >= self.max {
            return 1.0;
        }
        let steps = z / step;
        let is_multiple = (steps - steps.round()).abs() * step < 0.5 * self.grid;
        if is_multiple { step / self.grid } else { 0.0 }
    }

    fn of_error(&self, place: usize, widened: f64, error: f64) -> f64 {
        let above = WIDENED_M.iter().position(|&level| level > widened).unwrap_or(WIDENED_M.len());
        let below = above - 1;
        let here = at(&self.errors[below][place], error);
        if above == WIDENED_M.len() || widened == WIDENED_M[below] {
            return here;
        }
        let share = (widened - WIDENED_M[below]) / (WIDENED_M[above] - WIDENED_M[below]);
        (1.0 - share) * here + share * at(&self.errors[above][place], error)
    }

    fn add_errors(&self, expected: &Expected, base: f32, histogram: &mut [f64]) {
        let shift = f64::from(expected.mean - base);
        let [p, sigma] = expected.tail.map(f64::from);
        let widened = widened_for(expected, f64::from(expected.widened));
        let place = expected.place as usize;
        let shares = self.shares[place].map(f64::from);
        let kept = f64::from(expected.kept);
        let last = histogram.len() - 1;
        let [front, about] = expected.added_before.map(f64::from);
        histogram[0] += kept * shares[FRONT] + front;
        histogram[last] += kept * (shares[BEHIND] + shares[LOST]) + (1.0 - kept - front - about);
        for bin in &mut histogram[1..last] {
            *bin += about / BINS as f64;
        }
        for bin in 0..BINS {
            let error = (bin as f64 + 0.5) * BIN_M - REACH_M;
            let plain = self.of_error(place, widened, error);
            let density = if p > 0.0 {
                (1.0 - p) * plain + p * self.of_error(place, sigma.hypot(widened), error)
            } else {
                plain
            };
            let to = if shift.is_finite() { bin_of(error + shift, histogram.len()) } else { last };
            histogram[to] += kept * density * BIN_M;
        }
    }
}

/// Bins of [`Learnt::add_errors`].
pub(super) const ERROR_BINS: usize = BINS + 2;

/// Width of those bins \[m\].
pub(super) const ERROR_BIN_M: f64 = BIN_M;

/// The bin of an error there.
pub(super) fn bin_of(error: f64, bins: usize) -> usize {
    (((error + REACH_M) / BIN_M).floor() + 1.0).clamp(0.0, bins as f64 - 1.0) as usize
}

/// The outcome of a beam.
enum Outcome {
    /// A return of what the beam meets, with its error \[m\].
    Error(f64),
    /// In front, behind, lost.
    Not(usize),
}

fn outcome(z: f64, mean: f64, max: f64) -> Outcome {
    let error = z - mean;
    if z >= max {
        Outcome::Not(LOST)
    } else if error.abs() < REACH_M {
        Outcome::Error(error)
    } else {
        Outcome::Not(if error < 0.0 { FRONT } else { BEHIND })
    }
}

/// A step gathers the readings of all of it: its standard deviation is step / sqrt(12).
fn widened_for(expected: &Expected, widened: f64) -> f64 {
    if expected.step > 0.0 { widened.hypot(f64::from(expected.step) / 12.0_f64.sqrt()) } else { widened }
}

/// A density between the middles of its bins.
#[inline]
fn at(density: &[f32; BINS], error: f64) -> f64 {
    let at = ((error + REACH_M) / BIN_M - 0.5).clamp(0.0, BINS as f64 - 1.0);
    let bin = (at as usize).min(BINS - 2);
    let share = at - bin as f64;
    (1.0 - share) * f64::from(density[bin]) + share * f64::from(density[bin + 1])
}

/// Half of a normal kernel over bins, of sum 1 when mirrored.
fn kernel(sigma: f64) -> Vec<f32> {
    if sigma == 0.0 {
        return vec![1.0];
    }
    let reach = (3.0 * sigma / BIN_M).ceil() as usize;
    let weights: Vec<f64> = (0..=reach).map(|i| (-0.5 * (i as f64 * BIN_M / sigma).powi(2)).exp()).collect();
    let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    weights.into_iter().map(|weight| (weight / sum) as f32).collect()
}

fn widen(density: &[f32; BINS], kernel: &[f32]) -> [f32; BINS] {
    let mut wide = [0.0; BINS];
    for (i, &value) in density.iter().enumerate() {
        if value == 0.0 {
            continue;
        }
        for (distance, weight) in kernel.iter().enumerate() {
            for to in [i.checked_sub(distance), (distance > 0).then_some(i + distance)] {
                if let Some(bin) = to.and_then(|to| wide.get_mut(to)) {
                    *bin += weight * value;
                }
            }
        }
    }
    wide
}
