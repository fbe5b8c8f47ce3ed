use serde::{Deserialize, Serialize};

use crate::np_reg::deposit;
use crate::point_share::{PointShare, regress_apart, without_points};
use crate::{
    Alignment, ConditionalDistribution, Dataset, Degree, Error, LocalRegression, Outcomes, Regressor,
    Scratch, Support, Weighting,
};

/// Local Frechet regression of distributions in the Wasserstein space (Petersen and Mueller 2019), with its
/// settings: the quantile functions of the states are regressed level by level, and the result is projected onto
/// monotone functions. Degree [`Degree::Linear`] is the paper's local linear estimator, [`Degree::Constant`] the
/// kernel-weighted Wasserstein barycentre.
///
/// The point mass is regressed apart from the quantiles of the other observations. The spread at a state is learned
/// from repeated observations there; with a single one at each state a prediction collapses to a point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrechetOptions {
    /// The possible outcomes.
    pub outcomes: Outcomes,
    /// The quantity that is smoothed over states.
    pub alignment: Alignment,
    /// Number m of quantiles that stand for a distribution, at the levels (k + 1/2) / m; no more than observations
    /// at a state carry information.
    pub quantiles: usize,
    /// How much each state counts at a query.
    pub weighting: Weighting,
    /// The local fit to the quantiles around a query.
    pub degree: Degree,
}

/// The model fitted by [`FrechetOptions`]: the quantiles of aligned observations at each state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub struct Frechet {
    options: FrechetOptions,
    quantiles: LocalRegression,
    points: PointShare,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    options: FrechetOptions,
    quantiles: LocalRegression,
    points: PointShare,
}

impl From<Frechet> for Parts {
    fn from(model: Frechet) -> Self {
        Self { options: model.options, quantiles: model.quantiles, points: model.points }
    }
}

impl TryFrom<Parts> for Frechet {
    type Error = Error;
    fn try_from(parts: Parts) -> Result<Self, Error> {
        let Parts { options, quantiles, points } = parts;
        options.outcomes.validate()?;
        quantiles.expect(options.quantiles)?;
        points.expect(&options.outcomes, quantiles.dim())?;
        Ok(Self { options, quantiles, points })
    }
}

impl Regressor for FrechetOptions {
    type Model = Frechet;

    fn fit(&self, data: &Dataset) -> Result<Frechet, Error> {
        if self.quantiles == 0 {
            return Err(Error::Empty { what: "the quantiles" });
        }
        let Self { outcomes, weighting, degree, .. } = self;
        let rest = without_points(data, outcomes, weighting)?;
        let (quantiles, points) = regress_apart(data, &rest, outcomes, weighting, *degree, |i| {
            let affine = self.alignment.at(rest.state(i))?;
            let mut aligned: Vec<f64> = rest.observations(i).iter().map(|&z| affine.align(z)).collect();
            aligned.sort_by(f64::total_cmp);
            let levels = (0..self.quantiles).map(|k| (k as f64 + 0.5) / self.quantiles as f64);
            Ok(levels.map(|level| sample_quantile(&aligned, level)).collect())
        })?;
        Ok(Frechet { options: self.clone(), quantiles, points })
    }

    fn outcomes(&self) -> Outcomes {
        self.outcomes
    }
}

/// Quantile of sorted numbers, linear between the levels (k + 1/2) / n (Hyndman and Fan 1996, type 5).
fn sample_quantile(sorted: &[f64], level: f64) -> f64 {
    let last = sorted.len() - 1;
    let position = (level * sorted.len() as f64 - 0.5).clamp(0.0, last as f64);
    let k = (position as usize).min(last);
    let next = sorted[(k + 1).min(last)];
    sorted[k] + (position - k as f64) * (next - sorted[k])
}

impl Frechet {
    /// The options of the fit.
    pub fn options(&self) -> &FrechetOptions {
        &self.options
    }

    /// The predicted quantiles of the observations other than the point mass at `query`, at the levels
    /// (k + 1/2) / m, in units of z and never falling.
    ///
    /// # Errors
    /// As [`ConditionalDistribution::predict_into`].
    pub fn quantiles(&self, query: &[f64]) -> Result<(Vec<f64>, Support), Error> {
        let mut scratch = Scratch::default();
        let support = self.quantiles_into(query, &mut scratch)?;
        Ok((scratch.values, support))
    }

    /// As [`Frechet::quantiles`], into the scratch's values.
    fn quantiles_into(&self, query: &[f64], scratch: &mut Scratch) -> Result<Support, Error> {
        let Scratch { weights, values, .. } = scratch;
        values.resize(self.options.quantiles, 0.0);
        let support = self.quantiles.predict_with(query, weights, values)?;
        project_monotone(values);
        let affine = self.options.alignment.at(query)?;
        for q in values {
            *q = affine.restore(*q);
        }
        Ok(support)
    }
}

impl ConditionalDistribution for Frechet {
    fn dim(&self) -> usize {
        self.quantiles.dim()
    }

    fn outcomes(&self) -> Outcomes {
        self.options.outcomes
    }

    fn predict_into(
        &self,
        query: &[f64],
        scratch: &mut Scratch,
        mass: &mut [f64],
    ) -> Result<(f64, Support), Error> {
        let support = self.quantiles_into(query, scratch)?;
        let mut point = self.points.predict(query, &mut scratch.weights)?;
        let rest = 1.0 - point;
        let quantiles = &scratch.values;
        let grid = self.options.outcomes.grid;
        let position = |z: f64| (z - grid.lo) / grid.width;
        // The mass between neighbouring levels is even between their quantiles; that beyond the outermost levels
        // is at their quantiles.
        let share = rest / quantiles.len() as f64;
        let mut above = 0.0;
        for pair in quantiles.windows(2) {
            above += deposit(position(pair[0]), position(pair[1]), share, mass);
        }
        for end in [quantiles[0], quantiles[quantiles.len() - 1]] {
            above += deposit(position(end), position(end), 0.5 * share, mass);
        }
        point += self.options.outcomes.absorb_above(above, mass);
        Ok((point, support))
    }
}

/// The nearest sequence in least squares that never falls, in place: pool adjacent violators (Ayer and others
/// 1955).
fn project_monotone(values: &mut [f64]) {
    // Pools of (sum, length) with rising means.
    let mut blocks: Vec<(f64, usize)> = Vec::new();
    if values.is_sorted() {
        return;
    }
    for &value in values.iter() {
        let mut block = (value, 1);
        while let Some(&(sum, length)) = blocks.last() {
            if sum / length as f64 <= block.0 / block.1 as f64 {
                break;
            }
            block = (block.0 + sum, block.1 + length);
            blocks.pop();
        }
        blocks.push(block);
    }
    let mut at = 0;
    for (sum, length) in blocks {
        values[at..at + length].fill(sum / length as f64);
        at += length;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// The projection by its min-max formula: max over a <= k of min over b >= k of the mean of a..=b.
        #[test]
        fn projection_is_the_min_max_formula(values in prop::collection::vec(-1.0..1.0f64, 1..12)) {
            let mut projected = values.clone();
            project_monotone(&mut projected);
            let mean = |a: usize, b: usize| values[a..=b].iter().sum::<f64>() / (b - a + 1) as f64;
            for (k, p) in projected.iter().enumerate() {
                let lower = |a| (k..values.len()).map(|b| mean(a, b)).fold(f64::INFINITY, f64::min);
                let expected = (0..=k).map(lower).fold(f64::NEG_INFINITY, f64::max);
                prop_assert!((p - expected).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn sample_quantiles_are_the_observations_at_their_own_levels() {
        let z = [1.0, 2.0, 4.0, 8.0];
        assert_eq!([0.125, 0.375, 0.625, 0.875].map(|u| sample_quantile(&z, u)), z);
        assert_eq!([0.0, 0.5, 1.0].map(|u| sample_quantile(&z, u)), [1.0, 3.0, 8.0]);
    }
}
