//! The point mass of methods that treat it apart from the rest: its share is regressed as one number, and the rest
//! is learned from the other observations.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{Dataset, Degree, Error, LocalRegression, Outcomes, Smoother, Weighting};

/// Regression of the point mass's share on the state.
///
/// Shares are averaged as they are: unlike that of their logits, the mean of shares of counts has no bias, and 0
/// and 1 need no correction. Predictions of a plane are limited to 0..=1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PointShare(Option<LocalRegression>);

impl PointShare {
    pub fn fit(
        data: &Dataset,
        outcomes: &Outcomes,
        weighting: &Weighting,
        degree: Degree,
    ) -> Result<Self, Error> {
        if outcomes.point_mass_at.is_none() {
            return Ok(Self(None));
        }
        let shares: Vec<f64> = (0..data.len())
            .map(|i| {
                let z = data.observations(i);
                z.iter().filter(|&&z| outcomes.is_point(z)).count() as f64 / z.len() as f64
            })
            .collect();
        Ok(Self(Some(LocalRegression::fit(data.states(), &shares, weighting, degree)?)))
    }

    /// Checks a share from a file against the model it belongs to.
    pub fn expect(&self, outcomes: &Outcomes, dim: usize) -> Result<(), Error> {
        match (&self.0, outcomes.point_mass_at) {
            (None, None) => Ok(()),
            (Some(share), Some(_)) if share.dim() == dim => share.expect(1),
            (share, at) => Err(Error::Length {
                what: "number of point shares",
                expected: usize::from(at.is_some()),
                found: usize::from(share.is_some()),
            }),
        }
    }

    pub fn predict(&self, query: &[f64], weights: &mut Vec<(usize, f64)>) -> Result<f64, Error> {
        let Some(regression) = &self.0 else {
            return Ok(0.0);
        };
        let mut share = [0.0];
        regression.predict_with(query, weights, &mut share)?;
        Ok(share[0].clamp(0.0, 1.0))
    }
}

/// Regresses `values` of each state of `rest` ([`without_points`] of `data`), and the point mass's share apart from them.
///
/// # Errors
/// Those of `values` and of [`LocalRegression::fit`].
pub(crate) fn regress_apart(
    data: &Dataset,
    rest: &Dataset,
    outcomes: &Outcomes,
    weighting: &Weighting,
    degree: Degree,
    values: impl Fn(usize) -> Result<Vec<f64>, Error> + Send + Sync,
) -> Result<(LocalRegression, PointShare), Error> {
    let values: Vec<Vec<f64>> = (0..rest.len()).into_par_iter().map(values).collect::<Result<_, Error>>()?;
    Ok((
        LocalRegression::fit(rest.states(), &values.concat(), weighting, degree)?,
        PointShare::fit(data, outcomes, weighting, degree)?,
    ))
}

/// The states with an observation other than the point mass, and only those observations.
///
/// # Errors
/// If there are none, or if outcomes or weighting are invalid.
pub(crate) fn without_points(
    data: &Dataset,
    outcomes: &Outcomes,
    weighting: &Weighting,
) -> Result<Dataset, Error> {
    outcomes.validate()?;
    // Of all the data: what is wrong with them is said before what is wrong with a part.
    Smoother::new(data, weighting)?;
    let mut rest = Dataset::new(data.dim());
    for i in 0..data.len() {
        let z: Vec<f64> = data.observations(i).iter().copied().filter(|&z| !outcomes.is_point(z)).collect();
        if !z.is_empty() {
            rest.push(data.state(i), &z)?;
        }
    }
    if rest.is_empty() {
        return Err(Error::Empty { what: "the observations that aren't the point mass" });
    }
    Ok(rest)
}
