//! One curve over the levels of a covariate: a histogram with a penalty on the steps between neighbours.

/// The sums of what readings say of a moment at a level.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    /// Slope of the log score by the moment's tilt.
    pub slope: f64,
    /// Its variance.
    pub variance: f64,
}

impl Sums {
    /// Adds a reading's slope and variance.
    pub fn add(&mut self, [slope, variance]: [f64; 2]) {
        self.slope += slope;
        self.variance += variance;
    }

    /// Whether no reading was added.
    fn is_none(self) -> bool {
        self.slope == 0.0 && self.variance == 0.0
    }

    fn plus(self, other: Self) -> Self {
        Self { slope: self.slope + other.slope, variance: self.variance + other.variance }
    }

    fn minus(self, other: Self) -> Self {
        Self { slope: self.slope - other.slope, variance: (self.variance - other.variance).max(0.0) }
    }

    /// Gain of a tilt (nats). A share's readings are few: their number is Poisson, and so is its log score.
    fn gain(self, tilt: f64, is_share: bool) -> f64 {
        if is_share {
            self.slope * tilt - self.variance * (tilt.exp_m1() - tilt)
        } else {
            self.slope * tilt - 0.5 * self.variance * tilt * tilt
        }
    }
}

/// How a curve is fitted.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Information of a step between neighbouring levels.
    pub stiffness: f64,
    /// Whether neighbouring levels are alike. Levels without an order are drawn to 0.
    pub is_ordered: bool,
    /// Whether the moment is the share of a class.
    pub is_share: bool,
}

/// Information of each level about 0, which keeps curves finite: a hundredth of a reading.
const RIDGE: f64 = 0.01;
/// Newton steps of a share's fit, each no longer than the largest step.
const NEWTON_STEPS: usize = 8;
const LARGEST_STEP: f64 = 2.0;
/// The most that a curve of a moment of the surface moves at once: its log score is a parabola only near by.
pub const LARGEST_TILT: f64 = 1.0;

/// What a fit works on, one entry for each level: it is used again for each fold.
#[derive(Default)]
struct Solver {
    curve: Vec<f64>,
    /// Slope and curvature of each level where the last step began.
    at: Vec<[f64; 2]>,
    pivots: Vec<f64>,
    change: Vec<f64>,
}

impl Solver {
    /// The curve of some sums, from where the last fit ended if it is a share's, whose fit takes several steps.
    fn solve(&mut self, sums: &(impl Iterator<Item = Sums> + Clone), shape: Shape) {
        if !shape.is_share {
            self.curve.fill(0.0);
        }
        for _ in 0..if shape.is_share { NEWTON_STEPS } else { 1 } {
            self.at.clear();
            self.at.extend(sums.clone().zip(&self.curve).map(|(sums, tilt)| {
                if shape.is_share {
                    let more = tilt.exp_m1();
                    [sums.slope - sums.variance * more, sums.variance * (more + 1.0)]
                } else {
                    [sums.slope, sums.variance]
                }
            }));
            self.newton(shape);
            let most = if shape.is_share { LARGEST_STEP } else { LARGEST_TILT };
            let mut moved = 0.0_f64;
            for (tilt, change) in self.curve.iter_mut().zip(&self.change) {
                let change = change.clamp(-most, most);
                *tilt += change;
                moved = moved.max(change.abs());
            }
            if moved < 1e-3 {
                break;
            }
        }
    }

    /// A Newton step of the penalized log score: a tridiagonal system.
    fn newton(&mut self, shape: Shape) {
        let Self { curve, at, pivots, change } = self;
        let n = at.len();
        let [step, ridge] = penalties(n, shape);
        pivots.clear();
        pivots.extend(diagonal(at, shape));
        change.clear();
        change.extend((0..n).map(|i| {
            let before = if i > 0 { step * (curve[i] - curve[i - 1]) } else { 0.0 };
            let after = if i + 1 < n { step * (curve[i] - curve[i + 1]) } else { 0.0 };
            at[i][0] - ridge * curve[i] - before - after
        }));
        for i in 1..n {
            let factor = -step / pivots[i - 1];
            pivots[i] += factor * step;
            change[i] -= factor * change[i - 1];
        }
        for i in (0..n).rev() {
            let next = if i + 1 < n { step * change[i + 1] } else { 0.0 };
            change[i] = (change[i] + next) / pivots[i];
        }
    }
}

/// Information of a step between neighbouring levels, and of each level about 0.
fn penalties(levels: usize, shape: Shape) -> [f64; 2] {
    let step = if shape.is_ordered && levels > 1 { shape.stiffness } else { 0.0 };
    let ridge = if shape.is_ordered { RIDGE } else { RIDGE * shape.stiffness.max(1.0) };
    [step, ridge]
}

/// Curvature of the penalized log score by each level, for that of the log score. Neighbours have minus the information of a step.
fn diagonal(at: &[[f64; 2]], shape: Shape) -> impl Iterator<Item = f64> {
    let n = at.len();
    let [step, ridge] = penalties(n, shape);
    let neighbours = move |i: usize| f64::from(u8::from(i > 0)) + f64::from(u8::from(i + 1 < n));
    (0..n).map(move |i| at[i][1] + ridge + step * neighbours(i))
}

/// Standard errors of the levels. Forward and backward pivots together give the diagonal of the inverse.
fn errors(at: &[[f64; 2]], shape: Shape) -> Vec<f64> {
    let n = at.len();
    let [step, _] = penalties(n, shape);
    let diagonal: Vec<f64> = diagonal(at, shape).collect();
    let (mut forward, mut backward) = (diagonal.clone(), diagonal.clone());
    for i in 1..n {
        let factor = -step / forward[i - 1];
        forward[i] += factor * step;
    }
    for i in (0..n.saturating_sub(1)).rev() {
        backward[i] -= step * step / backward[i + 1];
    }
    (0..n).map(|i| (1.0 / (forward[i] + backward[i] - diagonal[i])).sqrt()).collect()
}

/// The curve of some sums, and slope and curvature of each level where the last step began.
fn solve(sums: &[Sums], shape: Shape) -> Solver {
    let mut solver = Solver { curve: vec![0.0; sums.len()], ..Solver::default() };
    solver.solve(&sums.iter().copied(), shape);
    solver
}

/// The curve of all folds, with its standard errors: one number for each level. A fold has the sums of each level.
pub fn fit(folds: &[Vec<Sums>], shape: Shape) -> (Vec<f64>, Vec<f64>) {
    let Solver { curve, at, .. } = solve(&total(folds), shape);
    let errors = errors(&at, shape);
    (curve, errors)
}

/// Held-out gain of the curves on each fold (nats).
pub fn crossfit(folds: &[Vec<Sums>], shape: Shape) -> Vec<f64> {
    let mut gains = Vec::with_capacity(folds.len());
    for_each_fold(folds, shape, |fold, curve| {
        let gain = |(own, tilt): (&Sums, &f64)| own.gain(*tilt, shape.is_share);
        gains.push(fold.iter().zip(curve).filter(|(own, _)| !own.is_none()).map(gain).sum());
    });
    gains
}

/// The curves that are fitted without each fold.
pub fn curves_without(folds: &[Vec<Sums>], shape: Shape) -> Vec<Vec<f64>> {
    let mut curves = Vec::with_capacity(folds.len());
    for_each_fold(folds, shape, |_, curve| curves.push(curve.to_vec()));
    curves
}

/// Calls `each` with every fold and the curve that is fitted without it.
fn for_each_fold(folds: &[Vec<Sums>], shape: Shape, mut each: impl FnMut(&[Sums], &[f64])) {
    let total = total(folds);
    let all = solve(&total, shape);
    let mut solver = Solver::default();
    for fold in folds {
        solver.curve.clear();
        solver.curve.extend(&all.curve);
        if shape.is_ordered {
            solver.solve(&total.iter().zip(fold).map(|(all, own)| all.minus(*own)), shape);
        } else {
            // Levels that aren't drawn to each other are each for itself: those that the fold has no readings of stay.
            let levels = (0..total.len()).filter(|&i| !fold[i].is_none());
            let mut one = Solver::default();
            for i in levels {
                one.curve.clear();
                one.curve.push(all.curve[i]);
                one.solve(&std::iter::once(total[i].minus(fold[i])), shape);
                solver.curve[i] = one.curve[0];
            }
        }
        each(fold, &solver.curve);
    }
}

fn total(folds: &[Vec<Sums>]) -> Vec<Sums> {
    let mut total = vec![Sums::default(); folds[0].len()];
    for fold in folds {
        for (sum, more) in total.iter_mut().zip(fold) {
            *sum = sum.plus(*more);
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The inverse of a well-conditioned matrix (Gauss and Jordan).
    fn invert(matrix: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let n = matrix.len();
        let unit = |i: usize| (0..n).map(move |j| f64::from(u8::from(i == j)));
        let mut rows: Vec<Vec<f64>> =
            matrix.iter().enumerate().map(|(i, row)| row.iter().copied().chain(unit(i)).collect()).collect();
        for i in 0..n {
            let pivot = rows[i][i];
            rows[i].iter_mut().for_each(|value| *value /= pivot);
            let row = rows[i].clone();
            for (_, other) in rows.iter_mut().enumerate().filter(|(k, _)| *k != i) {
                let factor = other[i];
                other.iter_mut().zip(&row).for_each(|(value, own)| *value -= factor * own);
            }
        }
        rows.into_iter().map(|row| row[n..].to_vec()).collect()
    }

    fn sums(pairs: &[[f64; 2]]) -> Vec<Sums> {
        pairs.iter().map(|&[slope, variance]| Sums { slope, variance }).collect()
    }

    /// The tridiagonal solution and the diagonal of the inverse, against those of the whole matrix.
    #[test]
    fn a_curve_is_the_maximum_of_its_penalized_log_score() {
        let sums = sums(&[[3.0, 20.0], [-1.0, 5.0], [0.5, 0.0], [2.0, 40.0]]);
        let shape = Shape { stiffness: 7.0, is_ordered: true, is_share: false };
        let (curve, errors) = fit(std::slice::from_ref(&sums), shape);
        let mut matrix = vec![vec![0.0; 4]; 4];
        for i in 0..4 {
            matrix[i][i] += sums[i].variance + RIDGE;
            if i > 0 {
                matrix[i][i] += 7.0;
                matrix[i - 1][i - 1] += 7.0;
                matrix[i][i - 1] -= 7.0;
                matrix[i - 1][i] -= 7.0;
            }
        }
        let inverse = invert(&matrix);
        for i in 0..4 {
            let expected: f64 = inverse[i].iter().zip(&sums).map(|(m, sum)| m * sum.slope).sum();
            assert!((curve[i] - expected).abs() < 1e-9, "{} {expected}", curve[i]);
            assert!((errors[i] - inverse[i][i].sqrt()).abs() < 1e-9, "{} {}", errors[i], inverse[i][i]);
        }
    }

    /// 30 readings where 10 are expected: their share is 3 times as large.
    #[test]
    fn a_share_s_tilt_is_the_logarithm_of_observed_over_expected() {
        let shape = Shape { stiffness: 1.0, is_ordered: true, is_share: true };
        let Solver { curve, .. } = solve(&sums(&[[20.0, 10.0]]), shape);
        assert!((curve[0] - 3.0_f64.ln()).abs() < 0.01, "{curve:?}");
    }

    /// A curve without a fold is that of the other folds alone, also of levels that the fold says nothing of.
    #[test]
    fn a_curve_without_a_fold_is_the_curve_of_the_others() {
        let fold = |k: usize| -> Vec<Sums> {
            let level = |i: usize| match (i + k) % 3 {
                0 => Sums::default(),
                j => Sums { slope: 4.0 * (i as f64 - 2.5 + 0.3 * k as f64).sin(), variance: 5.0 * j as f64 },
            };
            (0..6).map(level).collect()
        };
        let folds: Vec<Vec<Sums>> = (0..5).map(fold).collect();
        for (is_ordered, is_share) in [(true, true), (true, false), (false, true), (false, false)] {
            let shape = Shape { stiffness: 3.0, is_ordered, is_share };
            let gains = crossfit(&folds, shape);
            for (k, without) in curves_without(&folds, shape).iter().enumerate() {
                let mut others = folds.clone();
                let own = others.remove(k);
                let (curve, _) = fit(&others, shape);
                let apart = without.iter().zip(&curve).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(apart < 1e-3, "{shape:?}: {without:?} {curve:?}");
                let gain: f64 = own.iter().zip(&curve).map(|(own, tilt)| own.gain(*tilt, is_share)).sum();
                assert!((gains[k] - gain).abs() < 0.02, "{} {gain}", gains[k]);
            }
        }
    }

    /// Two levels that all folds agree on gain; levels on which folds contradict each other lose.
    #[test]
    fn a_curve_gains_where_it_was_not_fitted() {
        let shape = Shape { stiffness: 1.0, is_ordered: true, is_share: false };
        let alike = vec![sums(&[[10.0, 50.0], [-10.0, 50.0]]); 4];
        let (gains, without) = (crossfit(&alike, shape), curves_without(&alike, shape));
        // Each fold gains 2 (s t - v t^2 / 2) at t = s / v.
        let gain: f64 = gains.iter().sum();
        assert!((gain - 4.0 * 2.0).abs() < 0.1 && without.len() == 4, "{gain}");
        let unlike: Vec<Vec<Sums>> =
            (0..4).map(|i| sums(&[[if i % 2 == 0 { 10.0 } else { -10.0 }, 50.0]])).collect();
        assert!(crossfit(&unlike, shape).iter().sum::<f64>() < 0.0);
    }
}
