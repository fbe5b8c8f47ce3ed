use serde::{Deserialize, Serialize};

use crate::error::finite;
use crate::{Error, Kernel, Smoother, Support};

/// Ridge on the slopes, in squared bandwidths: the local design of few or collinear states then has a solution
/// that tends to the weighted mean, while a design that spans a bandwidth keeps its slope to one in a million.
const RIDGE: f64 = 1e-6;

/// Locally weighted linear regression of q target values on the state: at each query a weighted least-squares
/// plane through the states around it, evaluated at the query. The regressor of P-REG (procedure 1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct LocallyWeightedLinear {
    smoother: Smoother,
    /// n x q.
    targets: Vec<f64>,
    target_dim: usize,
}

#[derive(Serialize, Deserialize)]
struct Parts {
    smoother: Smoother,
    targets: Vec<f64>,
}

impl From<LocallyWeightedLinear> for Parts {
    fn from(regression: LocallyWeightedLinear) -> Self {
        Self { smoother: regression.smoother, targets: regression.targets }
    }
}

impl TryFrom<Parts> for LocallyWeightedLinear {
    type Error = Error;
    fn try_from(parts: Parts) -> Result<Self, Error> {
        Self::over(parts.smoother, parts.targets)
    }
}

impl LocallyWeightedLinear {
    /// Regression on `states` (n x `dim`, row by row) of `targets` (n x q, row by row), with one bandwidth per
    /// state coordinate.
    ///
    /// # Errors
    /// If there are no states or targets, the rows don't match, a number isn't finite, or the bandwidths aren't
    /// `dim` positive numbers.
    pub fn fit(
        dim: usize,
        states: &[f64],
        targets: &[f64],
        kernel: Kernel,
        bandwidths: &[f64],
    ) -> Result<Self, Error> {
        if bandwidths.len() != dim {
            return Err(Error::Length {
                what: "number of state bandwidths",
                expected: dim,
                found: bandwidths.len(),
            });
        }
        let smoother = Smoother::of_states(states.to_vec(), kernel, bandwidths)?;
        Self::over(smoother, targets.to_vec())
    }

    fn over(smoother: Smoother, targets: Vec<f64>) -> Result<Self, Error> {
        let n = smoother.len();
        if targets.is_empty() {
            return Err(Error::Empty { what: "the regression targets" });
        }
        if !targets.len().is_multiple_of(n) {
            return Err(Error::Length {
                what: "number of target values (a multiple of the number of states)",
                expected: n * targets.len().div_ceil(n),
                found: targets.len(),
            });
        }
        for &target in &targets {
            finite("a regression target", target)?;
        }
        Ok(Self { target_dim: targets.len() / n, smoother, targets })
    }

    /// Number q of values that a prediction has.
    pub fn target_dim(&self) -> usize {
        self.target_dim
    }

    /// Writes the q predicted values at `query` into `out`. Outside the data ([`Support::Nearest`]) it's the
    /// mean of the nearest states; a plane is never extrapolated from there.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers or `out` hasn't q elements.
    pub fn predict(&self, query: &[f64], out: &mut [f64]) -> Result<Support, Error> {
        let q = self.target_dim;
        if out.len() != q {
            return Err(Error::Length { what: "length of the output", expected: q, found: out.len() });
        }
        let mut weights = Vec::new();
        let support = self.smoother.weights(query, &mut weights)?;

        out.fill(0.0);
        for &(i, w) in &weights {
            for (o, t) in out.iter_mut().zip(self.target(i)) {
                *o += w * t;
            }
        }
        if support == Support::Nearest {
            return Ok(support);
        }

        // Centred on the weighted means, the normal equations are C slope = c with C = sum w u u^T and
        // c = sum w u (t - mean t), where u = (x - mean x) / h; the plane passes through the means.
        let p = query.len();
        let h = self.smoother.bandwidths();
        let mut centre = vec![0.0; p];
        for &(i, w) in &weights {
            for ((c, x), h) in centre.iter_mut().zip(self.smoother.state(i)).zip(h) {
                *c += w * x / h;
            }
        }
        let mut matrix = vec![0.0; p * p];
        let mut cross = vec![0.0; p * q];
        let mut u = vec![0.0; p];
        for &(i, w) in &weights {
            for (d, u) in u.iter_mut().enumerate() {
                *u = self.smoother.state(i)[d] / h[d] - centre[d];
            }
            for a in 0..p {
                for b in 0..p {
                    matrix[a * p + b] += w * u[a] * u[b];
                }
                for (k, t) in self.target(i).iter().enumerate() {
                    cross[a * q + k] += w * u[a] * (t - out[k]);
                }
            }
        }
        for a in 0..p {
            matrix[a * p + a] += RIDGE;
        }
        solve_positive_definite(p, &mut matrix, q, &mut cross);
        for a in 0..p {
            let offset = query[a] / h[a] - centre[a];
            for (k, o) in out.iter_mut().enumerate() {
                *o += cross[a * q + k] * offset;
            }
        }
        Ok(support)
    }

    fn target(&self, i: usize) -> &[f64] {
        &self.targets[i * self.target_dim..(i + 1) * self.target_dim]
    }
}

/// Solves A X = B in place by Cholesky's factorization; A is p x p, symmetric positive definite, and B p x q.
fn solve_positive_definite(p: usize, a: &mut [f64], q: usize, b: &mut [f64]) {
    for j in 0..p {
        for i in j..p {
            let dot: f64 = (0..j).map(|k| a[i * p + k] * a[j * p + k]).sum();
            let value = a[i * p + j] - dot;
            // No pivot of a matrix above RIDGE times the identity is smaller, but for rounding.
            a[i * p + j] = if i == j { value.max(RIDGE).sqrt() } else { value / a[j * p + j] };
        }
    }
    for c in 0..q {
        for i in 0..p {
            let dot: f64 = (0..i).map(|k| a[i * p + k] * b[k * q + c]).sum();
            b[i * q + c] = (b[i * q + c] - dot) / a[i * p + i];
        }
        for i in (0..p).rev() {
            let dot: f64 = (i + 1..p).map(|k| a[k * p + i] * b[k * q + c]).sum();
            b[i * q + c] = (b[i * q + c] - dot) / a[i * p + i];
        }
    }
}
