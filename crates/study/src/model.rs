//! The models that a study compares, and how each gets its bandwidths.

use distreg::{
    Alignment, ConditionalDistribution, Dataset, Degree, DensityEstimate, Distribution, Error, Family,
    FrechetOptions, Kernel, NpRegOptions, PRegOptions, Regressor, Weighting, crps, grid_search, histogram,
    histogram_match,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::sensor::Setup;
use locsim_report::text::code;

/// States on which cross-validation scores a candidate, over all folds. More take longer and choose hardly better.
const SCORED_STATES: usize = 100;
/// Observations that P-REG estimates the parameters of a state from, at least; it borrows from neighbours.
const LEAST_OBSERVATIONS: usize = 20;
/// Quantiles that stand for a distribution in Frechet regression, at most; fewer where a state has fewer observations.
const MOST_QUANTILES: usize = 100;

/// A model under comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, strum::IntoStaticStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Model {
    /// Procedure 1 with a Gaussian, as published.
    PReg,
    /// Procedure 1 with two Gaussians.
    PRegTwoGaussians,
    /// Procedure 2, as published.
    NpReg,
    /// Procedure 2 on observations relative to a state coordinate.
    NpRegRegistered,
    /// Local linear Frechet regression of quantile functions.
    Frechet,
}

/// Loss that cross-validation minimizes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Criterion {
    /// The paper's loss against the histogram of a held-out state's observations. It wants repeated observations.
    #[default]
    HistogramMatch,
    /// The continuous ranked probability score of the observations; single ones will do.
    Crps,
}

impl Model {
    /// Its name in files.
    pub fn as_str(self) -> &'static str {
        self.into()
    }

    /// Its definition, for reports.
    pub(super) fn describe(self, setup: &Setup) -> String {
        let text = match self {
            Self::PReg => {
                "a Gaussian whose mean and deviation are regressed on the state (the paper's procedure 1)"
            }
            Self::PRegTwoGaussians => "the same with two Gaussians",
            Self::NpReg => "histograms smoothed over states (the paper's procedure 2, as published)",
            Self::NpRegRegistered => {
                let name = |d: usize| &setup.coordinates[d].0;
                let aligned = match setup.alignment.unwrap_or_default() {
                    Alignment::Identity => "z".to_owned(),
                    Alignment::Shift { state_dim } => format!("z - {}", code(name(state_dim))),
                    Alignment::Scale { state_dim } => format!("z / {}", code(name(state_dim))),
                };
                return format!("the same with histograms of {aligned}, at every state and N of this study");
            }
            Self::Frechet => {
                "quantile functions regressed on the state by local planes (Petersen and Müller 2019)"
            }
        };
        text.to_owned()
    }

    /// Whether it needs a state coordinate that the observation follows.
    pub(super) fn needs_alignment(self) -> bool {
        matches!(self, Self::NpRegRegistered)
    }

    /// Learns from `data` and predicts at `queries` (row by row).
    pub(super) fn predict(
        self,
        setup: &Setup,
        data: &Dataset,
        bandwidths: &[f64],
        queries: &[f64],
    ) -> Result<Vec<Distribution>, Error> {
        let outcomes = setup.outcomes;
        let weighting = Weighting::kernel(Kernel::Gaussian, bandwidths);
        let parametric = |family| PRegOptions {
            outcomes,
            alignment: Alignment::Identity,
            family,
            weighting: weighting.clone(),
            degree: Degree::Linear,
            // A reading in steps has at least the deviation of the step.
            smallest_sigma: outcomes.grid.width / 12f64.sqrt(),
            least_observations: LEAST_OBSERVATIONS,
        };
        let smoothed = |alignment| NpRegOptions {
            outcomes,
            alignment,
            density: DensityEstimate::Histogram,
            weighting: weighting.clone(),
            degree: Degree::Constant,
        };
        match self {
            Self::PReg => predict(&parametric(Family::Gaussian), data, queries),
            Self::PRegTwoGaussians => predict(&parametric(Family::TwoGaussians), data, queries),
            Self::NpReg => predict(&smoothed(Alignment::Identity), data, queries),
            Self::NpRegRegistered => predict(&smoothed(setup.alignment.unwrap_or_default()), data, queries),
            Self::Frechet => {
                let observations = (0..data.len()).map(|i| data.observations(i).len()).min().unwrap_or(1);
                let quantiles = observations.clamp(1, MOST_QUANTILES);
                let alignment = Alignment::Identity;
                let options =
                    FrechetOptions { outcomes, alignment, quantiles, weighting, degree: Degree::Linear };
                predict(&options, data, queries)
            }
        }
    }

    /// The candidate with the smallest risk in cross-validation over states; the same folds for every model.
    pub(super) fn choose(
        self,
        setup: &Setup,
        candidates: &[Vec<f64>],
        folds: &[Fold],
        criterion: Criterion,
    ) -> Result<Vec<f64>, Error> {
        let score = |bandwidths: &Vec<f64>| -> Result<f64, Error> {
            let mut sum = 0.0;
            for fold in folds {
                let predicted = self.predict(setup, &fold.train, bandwidths, fold.held_out.states())?;
                for (i, predicted) in predicted.iter().enumerate() {
                    sum += match criterion {
                        Criterion::HistogramMatch => histogram_match(predicted, &fold.observed[i])?,
                        Criterion::Crps => crps(predicted, fold.held_out.observations(i)),
                    };
                }
            }
            Ok(sum)
        };
        Ok(grid_search(candidates, score)?.candidate)
    }
}

fn predict<R: Regressor>(method: &R, data: &Dataset, queries: &[f64]) -> Result<Vec<Distribution>, Error> {
    let predictions = method.fit(data)?.predict_batch(queries)?;
    Ok((0..predictions.len()).map(|i| predictions.distribution(i)).collect())
}

/// One fold of a cross-validation.
pub(super) struct Fold {
    train: Dataset,
    held_out: Dataset,
    observed: Vec<Distribution>,
}

/// Splits `data` into folds over states.
pub(super) fn folds(setup: &Setup, data: &Dataset, count: usize, seed: u64) -> Result<Vec<Fold>, Error> {
    let count = count.min(data.len());
    let most = SCORED_STATES.div_ceil(count);
    data.folds(count, seed)?
        .into_iter()
        .map(|(train, held_out)| {
            let every = held_out.len().div_ceil(most);
            let scored: Vec<usize> = (0..held_out.len()).step_by(every).collect();
            let held_out = held_out.subset(&scored);
            let observed = (0..held_out.len())
                .map(|i| histogram(held_out.observations(i), &setup.outcomes))
                .collect::<Result<_, _>>()?;
            Ok(Fold { train, held_out, observed })
        })
        .collect()
}
