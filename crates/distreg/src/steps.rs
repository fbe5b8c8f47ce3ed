//! A maximum between steps at which a log likelihood is known.

use std::sync::LazyLock;

/// Biases that are tried, in standard deviations, to both sides. Between them a parabola is.
const BIASES: [f64; 13] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.5, 7.5, 10.0, 14.0, 20.0, 28.0, 40.0];
/// Logarithms of factors on the spread that are tried, below 1 and above.
const NARROWER: [f64; 7] = [1.2, 0.9, 0.65, 0.45, 0.3, 0.18, 0.08];
const WIDER: [f64; 19] =
    [0.08, 0.18, 0.3, 0.42, 0.55, 0.7, 0.85, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.3, 2.6, 2.9, 3.2, 3.6, 4.0];
/// The number of biases, and of spreads, no change among them.
pub const COUNT: usize = 27;

/// Biases that may be many standard deviations large (standard deviations).
#[must_use]
pub fn biases() -> &'static Steps<COUNT> {
    static OF_BIASES: LazyLock<Steps<COUNT>> = LazyLock::new(|| {
        let below: Vec<f64> = BIASES.into_iter().rev().collect();
        Steps::new(&below, &BIASES)
    });
    &OF_BIASES
}

/// Changes of a spread (logarithms of factors).
#[must_use]
pub fn spreads() -> &'static Steps<COUNT> {
    static OF_SPREADS: LazyLock<Steps<COUNT>> = LazyLock::new(|| Steps::new(&NARROWER, &WIDER));
    &OF_SPREADS
}

/// Changes that are tried, in increasing order, no change among them.
pub struct Steps<const COUNT: usize> {
    /// The changes.
    pub at: [f64; COUNT],
    /// Index of no change.
    pub none: usize,
}

impl<const COUNT: usize> Steps<COUNT> {
    /// Steps below 0, given by their sizes from the largest on, 0, and steps above.
    #[must_use]
    pub fn new(below: &[f64], above: &[f64]) -> Self {
        let all = below.iter().map(|step| -step).chain([0.0]).chain(above.iter().copied());
        let mut at = [0.0; COUNT];
        at.iter_mut().zip(all).for_each(|(at, step)| *at = step);
        Self { at, none: below.len() }
    }
}

/// The vertex of the parabola through the log likelihood at the best step and at its neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    step: usize,
    /// The change.
    pub at: f64,
    /// Its standard error, by the curvature; 0 where the best step is the first or the last one.
    pub error: f64,
}

impl Vertex {
    /// The best change, where `log` is the log likelihood at each step.
    #[must_use]
    pub fn of<const COUNT: usize>(steps: &Steps<COUNT>, log: impl Fn(usize) -> f64) -> Self {
        // None, of steps that are all as good.
        let step = (0..COUNT).fold(steps.none, |best, step| if log(step) > log(best) { step } else { best });
        if step == 0 || step == COUNT - 1 {
            return Self { step, at: steps.at[step], error: 0.0 };
        }
        let [a, b, c] = [step - 1, step, step + 1].map(|step| steps.at[step]);
        let [below, here, above] = [step - 1, step, step + 1].map(log);
        let (left, right) = ((here - below) / (b - a), (above - here) / (c - b));
        // The second derivative is twice this, and not above 0, as the middle is the highest.
        let bend = (right - left) / (c - a);
        let slope = left + bend * (b - a);
        if bend >= -1e-12 {
            return Self { step, at: b, error: 0.0 };
        }
        Self { step, at: (b - 0.5 * slope / bend).clamp(a, c), error: (-0.5 / bend).sqrt() }
    }

    /// Puts those that know less than a quarter of what the whole of their level's readings knows between the nearest that know more: a stretch of
    /// time that is held out is between those before and after it.
    pub fn interpolate<const COUNT: usize>(steps: &Steps<COUNT>, levels: &mut [Self], whole: &[Self]) {
        let is_known = |(own, all): (&Self, &Self)| {
            let is_last = own.step == all.step && (own.step == 0 || own.step == COUNT - 1);
            is_last || (own.error > 0.0 && (all.error == 0.0 || own.error <= 2.0 * all.error))
        };
        let known: Vec<(usize, f64)> = (0..)
            .zip(levels.iter().zip(whole))
            .filter(|(_, pair)| is_known(*pair))
            .map(|(i, (own, _))| (i, own.at))
            .collect();
        for (i, level) in levels.iter_mut().enumerate() {
            let next = known.partition_point(|(known, _)| *known < i);
            level.at = match (next.checked_sub(1).map(|before| known[before]), known.get(next)) {
                (_, Some(&(here, _))) if here == i => continue,
                (Some((a, before)), Some(&(b, after))) => {
                    before + (after - before) * (i - a) as f64 / (b - a) as f64
                }
                (Some((_, at)), None) | (None, Some(&(_, at))) => at,
                (None, None) => continue,
            };
            let above = steps.at.partition_point(|step| *step < level.at).clamp(1, COUNT - 1);
            let is_nearer = level.at - steps.at[above - 1] < steps.at[above] - level.at;
            level.step = if is_nearer { above - 1 } else { above };
        }
    }

    /// Another log likelihood at this change, by the parabola through the same steps.
    #[must_use]
    pub fn read<const COUNT: usize>(self, steps: &Steps<COUNT>, log: impl Fn(usize) -> f64) -> f64 {
        let Self { step, at, .. } = self;
        if step == 0 || step == COUNT - 1 || at == steps.at[step] {
            return log(step);
        }
        let around = [step - 1, step, step + 1];
        let [a, b, c] = around.map(|step| steps.at[step]);
        let [below, here, above] = around.map(log);
        let share = |p: f64, q: f64, r: f64| (at - q) * (at - r) / ((p - q) * (p - r));
        below * share(a, b, c) + here * share(b, a, c) + above * share(c, a, b)
    }
}

/// The best changes at the levels of a covariate, with and without each fold.
pub struct Crossfit {
    /// By all folds.
    pub levels: Vec<Vertex>,
    /// Without each fold.
    pub without: Vec<Vec<Vertex>>,
    /// Log likelihood that each fold gains by what is best without it.
    pub gains: Vec<f64>,
}

impl Crossfit {
    /// By the log likelihood of each fold's readings at each level and step; levels are in an order, or have nothing to do with each other.
    #[must_use]
    pub fn of<const COUNT: usize>(
        steps: &Steps<COUNT>,
        folds: &[Vec<[f64; COUNT]>],
        is_ordered: bool,
    ) -> Self {
        let mut total = vec![[0.0; COUNT]; folds.first().map_or(0, Vec::len)];
        for (level, more) in folds.iter().flat_map(|fold| fold.iter().enumerate()) {
            total[level].iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
        let levels: Vec<Vertex> = total.iter().map(|sums| Vertex::of(steps, |step| sums[step])).collect();
        let without = |fold: &Vec<[f64; COUNT]>| -> Vec<Vertex> {
            let of_level = |l: usize| Vertex::of(steps, |step| total[l][step] - fold[l][step]);
            let mut rest: Vec<Vertex> = (0..total.len()).map(of_level).collect();
            if is_ordered {
                Vertex::interpolate(steps, &mut rest, &levels);
            }
            rest
        };
        let without: Vec<Vec<Vertex>> = folds.iter().map(without).collect();
        let gain_of = |(sums, fit): (&[f64; COUNT], &Vertex)| fit.read(steps, |step| sums[step]);
        let gains = folds.iter().zip(&without).map(|(fold, fits)| fold.iter().zip(fits).map(gain_of).sum());
        Self { gains: gains.collect(), levels, without }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ladders_go_up_and_biases_are_even_on_both_sides() {
        for steps in [biases(), spreads()] {
            assert!(steps.at.windows(2).all(|pair| pair[1] > pair[0]));
            assert_eq!(steps.at[steps.none], 0.0);
        }
        let biases = super::biases();
        assert!((0..COUNT).all(|step| biases.at[step] == -biases.at[COUNT - 1 - step]));
    }

    /// The log likelihood of readings with unit noise is a parabola, and its vertex is their mean, known to 1 / sqrt(n).
    #[test]
    fn a_parabola_is_found_between_the_steps() {
        let steps = Steps::<7>::new(&[4.0, 1.5, 0.5], &[0.5, 1.5, 4.0]);
        assert!(steps.at.windows(2).all(|pair| pair[1] > pair[0]) && steps.at[steps.none] == 0.0);
        for (mean, n) in [(0.2, 5.0), (-1.7, 20.0), (2.4, 100.0)] {
            let log = |step: usize| -0.5 * n * (steps.at[step] - mean).powi(2) + 3.0;
            let vertex = Vertex::of(&steps, log);
            assert!((vertex.at - mean).abs() < 1e-9 && (vertex.error - f64::sqrt(1.0 / n)).abs() < 1e-9);
            assert!((vertex.read(&steps, log) - 3.0).abs() < 1e-9);
        }
        let flat = Vertex::of(&steps, |_| 0.0);
        // Between those at 0.2 and 1.4; beyond the last one as that.
        let of = |mean: f64, n: f64| Vertex::of(&steps, |step| -0.5 * n * (steps.at[step] - mean).powi(2));
        let mut levels = [of(0.2, 50.0), flat, of(-3.0, 1.0), of(1.4, 50.0), flat];
        Vertex::interpolate(&steps, &mut levels, &[of(0.0, 60.0); 5]);
        for (level, expected) in levels.iter().zip([0.2, 0.6, 1.0, 1.4, 1.4]) {
            assert!((level.at - expected).abs() < 1e-9, "{levels:?}");
            // A parabola is read there, too.
            let read = level.read(&steps, |step| -(steps.at[step] - 1.0).powi(2));
            assert!((read + (expected - 1.0).powi(2)).abs() < 1e-9, "{read}");
        }
        assert_eq!((flat.at, flat.error), (0.0, 0.0));
    }
}
