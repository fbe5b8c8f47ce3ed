//! A maximum between steps at which a log likelihood is known.

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

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!((flat.at, flat.error), (0.0, 0.0));
    }
}
