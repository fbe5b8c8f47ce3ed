use serde::{Deserialize, Serialize};

use crate::error::finite;
use crate::{Degree, Error, Smoother, Support, Weighting};

/// Regression of q target values on the state: at each query the weighted mean of the states around it, or a
/// weighted least-squares plane through them, evaluated at the query. The REGRESS of the paper's procedures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct LocalRegression {
    smoother: Smoother,
    degree: Degree,
    /// n x q.
    targets: Vec<f64>,
    target_dim: usize,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    smoother: Smoother,
    degree: Degree,
    targets: Vec<f64>,
}

impl From<LocalRegression> for Parts {
    fn from(regression: LocalRegression) -> Self {
        Self { smoother: regression.smoother, degree: regression.degree, targets: regression.targets }
    }
}

impl TryFrom<Parts> for LocalRegression {
    type Error = Error;
    fn try_from(parts: Parts) -> Result<Self, Error> {
        Self::over(parts.smoother, parts.degree, parts.targets)
    }
}

impl LocalRegression {
    /// Regression on `states` (n x the weighting's number of bandwidths, row by row) of `targets` (n x q, row by
    /// row).
    ///
    /// # Errors
    /// If there are no states or targets, the rows don't match, or a number isn't finite.
    pub fn fit(
        states: &[f64],
        targets: &[f64],
        weighting: &Weighting,
        degree: Degree,
    ) -> Result<Self, Error> {
        Self::over(Smoother::of_states(states.to_vec(), weighting)?, degree, targets.to_vec())
    }

    fn over(smoother: Smoother, degree: Degree, targets: Vec<f64>) -> Result<Self, Error> {
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
        Ok(Self { target_dim: targets.len() / n, smoother, degree, targets })
    }

    /// Number q of values that a prediction has.
    pub fn target_dim(&self) -> usize {
        self.target_dim
    }

    /// Coordinates of a state.
    pub fn dim(&self) -> usize {
        self.smoother.dim()
    }

    /// Checks the number of target values of a regression from a file.
    pub(crate) fn expect(&self, target_dim: usize) -> Result<(), Error> {
        if self.target_dim == target_dim {
            return Ok(());
        }
        Err(Error::Length { what: "number of target values", expected: target_dim, found: self.target_dim })
    }

    /// Writes the q predicted values at `query` into `out`. Outside the data ([`Support::Nearest`]) it's the
    /// mean of the nearest states; a plane is never extrapolated from there.
    ///
    /// # Errors
    /// If the query isn't `dim` finite numbers or `out` hasn't q elements.
    pub fn predict(&self, query: &[f64], out: &mut [f64]) -> Result<Support, Error> {
        self.predict_with(query, &mut Vec::new(), out)
    }

    /// As [`LocalRegression::predict`], with a buffer for the weights.
    pub(crate) fn predict_with(
        &self,
        query: &[f64],
        weights: &mut Vec<(usize, f64)>,
        out: &mut [f64],
    ) -> Result<Support, Error> {
        let q = self.target_dim;
        if out.len() != q {
            return Err(Error::Length { what: "length of the output", expected: q, found: out.len() });
        }
        let support = self.smoother.regression_weights(query, self.degree, weights)?;
        out.fill(0.0);
        for &(i, w) in weights.iter() {
            for (o, t) in out.iter_mut().zip(&self.targets[i * q..(i + 1) * q]) {
                *o += w * t;
            }
        }
        Ok(support)
    }
}
