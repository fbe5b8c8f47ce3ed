use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::positive;
use crate::family::{Family, Parameters};
use crate::point_share::{PointShare, regress_apart, without_points};
use crate::{
    Alignment, ConditionalDistribution, Dataset, Degree, Error, LocalRegression, Outcomes, Regressor,
    Scratch, Smoother, Support, Weighting,
};

/// Parametric distribution regression (procedure 1, P-REG) with its settings: a family's parameters are estimated
/// at each state by maximum likelihood and regressed on the state. As published, the family is a Gaussian and the
/// degree [`Degree::Linear`].
///
/// A state with fewer than `least_observations` borrows those of the states nearest to it, each moved by the
/// difference of the regressed means, so single observations at each state are enough. The point mass is regressed
/// apart from the rest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PRegOptions {
    /// The possible outcomes.
    pub outcomes: Outcomes,
    /// The quantity that is smoothed over states.
    pub alignment: Alignment,
    /// The parametric family.
    pub family: Family,
    /// How much each state counts at a query.
    pub weighting: Weighting,
    /// The local fit to the parameters around a query.
    pub degree: Degree,
    /// No deviation is below this, in units of z; the sensor's resolution / sqrt(12) is a good one.
    pub smallest_sigma: f64,
    /// Least number of observations that parameters are estimated from.
    pub least_observations: usize,
}

/// The model fitted by [`PRegOptions`]: parameters at each state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct PReg {
    options: PRegOptions,
    parameters: LocalRegression,
    points: PointShare,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    options: PRegOptions,
    parameters: LocalRegression,
    points: PointShare,
}

impl From<PReg> for Parts {
    fn from(model: PReg) -> Self {
        Self { options: model.options, parameters: model.parameters, points: model.points }
    }
}

impl TryFrom<Parts> for PReg {
    type Error = Error;
    fn try_from(parts: Parts) -> Result<Self, Error> {
        let Parts { options, parameters, points } = parts;
        options.outcomes.validate()?;
        positive("the smallest sigma", options.smallest_sigma)?;
        parameters.expect(options.family.values())?;
        points.expect(&options.outcomes, parameters.dim())?;
        Ok(Self { options, parameters, points })
    }
}

impl Regressor for PRegOptions {
    type Model = PReg;

    fn fit(&self, data: &Dataset) -> Result<PReg, Error> {
        positive("the smallest sigma", self.smallest_sigma)?;
        let Self { outcomes, weighting, degree, .. } = self;
        let rest = without_points(data, outcomes, weighting)?;
        let enough = (0..rest.len()).all(|i| rest.observations(i).len() >= self.least_observations);
        let pooled = if enough { None } else { Some(self.pooled(&rest)?) };
        let observations = pooled.as_ref().unwrap_or(&rest);
        let (parameters, points) = regress_apart(data, &rest, outcomes, weighting, *degree, |i| {
            let z = observations.observations(i);
            let parameters = self.family.estimate(z, outcomes.grid.lo, self.smallest_sigma);
            let mut values = Vec::with_capacity(self.family.values());
            self.family.encode(&parameters, z.len(), self.alignment.at(rest.state(i))?, &mut values);
            Ok(values)
        })?;
        Ok(PReg { options: self.clone(), parameters, points })
    }

    fn outcomes(&self) -> Outcomes {
        self.outcomes
    }
}

impl PRegOptions {
    /// The same states, those with too few observations filled up from their neighbours.
    fn pooled(&self, data: &Dataset) -> Result<Dataset, Error> {
        let aligned: Vec<Vec<f64>> = (0..data.len())
            .map(|i| {
                let affine = self.alignment.at(data.state(i))?;
                Ok(data.observations(i).iter().map(|&z| affine.align(z)).collect())
            })
            .collect::<Result<_, Error>>()?;
        let means: Vec<f64> = aligned.iter().map(|z| z.iter().sum::<f64>() / z.len() as f64).collect();
        let means = LocalRegression::fit(data.states(), &means, &self.weighting, self.degree)?;
        let smooth: Vec<f64> = (0..data.len())
            .into_par_iter()
            .map(|i| {
                let mut mean = [0.0];
                means.predict(data.state(i), &mut mean)?;
                Ok(mean[0])
            })
            .collect::<Result<_, Error>>()?;
        let smoother = Smoother::new(data, &self.weighting)?;
        let pooled: Vec<Vec<f64>> = (0..data.len())
            .into_par_iter()
            .map(|i| {
                let own = data.observations(i);
                if own.len() >= self.least_observations {
                    return Ok(own.to_vec());
                }
                let affine = self.alignment.at(data.state(i))?;
                let mut neighbours = Vec::new();
                smoother.nearest_states(data.state(i), self.least_observations, &mut neighbours);
                let mut z = own.to_vec();
                for (k, _) in neighbours {
                    if z.len() >= self.least_observations {
                        break;
                    }
                    if k != i {
                        z.extend(aligned[k].iter().map(|e| affine.restore(e - smooth[k] + smooth[i])));
                    }
                }
                Ok(z)
            })
            .collect::<Result<_, Error>>()?;
        let mut filled = Dataset::new(data.dim());
        for (i, z) in pooled.iter().enumerate() {
            filled.push(data.state(i), z)?;
        }
        Ok(filled)
    }
}

impl PReg {
    /// The options of the fit.
    pub fn options(&self) -> &PRegOptions {
        &self.options
    }

    /// The family's parameters at `query`, without the point mass.
    ///
    /// # Errors
    /// As [`ConditionalDistribution::predict_into`].
    pub fn parameters(&self, query: &[f64]) -> Result<(Parameters, Support), Error> {
        self.parameters_with(query, &mut Scratch::default())
    }

    /// The data with (z - m(x)) / s(x) in place of each observation z, where m and s are the regressed mean and deviation; with
    /// `point` in place of the point mass.
    ///
    /// # Errors
    /// As [`PReg::parameters`].
    pub fn residuals(&self, data: &Dataset, point: Option<f64>) -> Result<Dataset, Error> {
        let whole = self.outcomes();
        let mut residuals = Dataset::new(data.dim());
        for i in 0..data.len() {
            let (at, _) = self.parameters(data.state(i))?;
            let e = |&z: &f64| match point {
                Some(point) if whole.is_point(z) => point,
                _ => (z - at.mean) / at.sigma,
            };
            residuals.push(data.state(i), &data.observations(i).iter().map(e).collect::<Vec<_>>())?;
        }
        Ok(residuals)
    }

    /// As [`PReg::parameters`], with buffers.
    pub(crate) fn parameters_with(
        &self,
        query: &[f64],
        scratch: &mut Scratch,
    ) -> Result<(Parameters, Support), Error> {
        let PRegOptions { family, alignment, smallest_sigma, .. } = self.options;
        let Scratch { weights, values, .. } = scratch;
        values.resize(family.values(), 0.0);
        let support = self.parameters.predict_with(query, weights, values)?;
        Ok((family.decode(values, alignment.at(query)?, smallest_sigma), support))
    }
}

impl ConditionalDistribution for PReg {
    fn dim(&self) -> usize {
        self.parameters.dim()
    }

    fn outcomes(&self) -> Outcomes {
        self.options.outcomes
    }

    /// Mass below the grid counts in the first bin. Mass above it counts as the point mass where that lies at the high
    /// end, else in the last bin.
    fn predict_into(
        &self,
        query: &[f64],
        scratch: &mut Scratch,
        mass: &mut [f64],
    ) -> Result<(f64, Support), Error> {
        let (parameters, support) = self.parameters_with(query, scratch)?;
        let mut point = self.points.predict(query, &mut scratch.weights)?;
        let rest = 1.0 - point;
        let grid = self.options.outcomes.grid;
        let mut before = 0.0;
        for (b, mass) in mass.iter_mut().enumerate() {
            let after = rest * parameters.cdf(grid.lo, grid.lo + (b + 1) as f64 * grid.width);
            *mass = (after - before).max(0.0);
            before = before.max(after);
        }
        point += self.options.outcomes.absorb_above((rest - before).max(0.0), mass);
        Ok((point, support))
    }
}
