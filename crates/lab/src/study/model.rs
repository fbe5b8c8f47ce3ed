//! The models that a study compares, and how each gets its bandwidths.

use distreg::{Alignment, Dataset, Distribution, Error, Kernel, NpReg, NpRegOptions, PReg, histogram, histogram_match};
use serde::{Deserialize, Serialize};

use super::sensor::Setup;

/// States on which cross-validation scores a candidate, over all folds. More take longer and choose hardly better.
const SCORED_STATES: usize = 100;

/// A model under comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// Procedure 1 with a Gaussian.
    PReg,
    /// Procedure 2 as published.
    NpReg,
    /// Procedure 2 on observations relative to a state coordinate.
    NpRegRegistered,
}

impl Model {
    /// Its name in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::PReg => "p_reg",
            Self::NpReg => "np_reg",
            Self::NpRegRegistered => "np_reg_registered",
        }
    }

    /// What it is, for reports.
    pub(super) fn describe(self) -> &'static str {
        match self {
            Self::PReg => "a Gaussian whose mean and deviation are regressed on the state (the paper's procedure 1)",
            Self::NpReg => "histograms smoothed over states (the paper's procedure 2, as published)",
            Self::NpRegRegistered => "the same on observations relative to the state coordinate that they follow",
        }
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
        let kernel = Kernel::Gaussian;
        if self == Self::PReg {
            // A reading in steps has at least the deviation of the step.
            let model = PReg::fit(data, kernel, bandwidths, setup.grid.width / 12f64.sqrt())?;
            return queries.chunks(data.dim()).map(|query| Ok(model.predict(query, setup.grid)?.0)).collect();
        }
        let alignment = match self {
            Self::NpRegRegistered => setup.alignment.unwrap_or(Alignment::Identity),
            _ => Alignment::Identity,
        };
        let options = NpRegOptions {
            grid: setup.grid,
            point_mass_at: setup.point_mass_at,
            alignment,
            observation_bandwidth: 0.0,
            kernel,
            bandwidths: bandwidths.to_vec(),
        };
        let predictions = NpReg::fit(data, options)?.predict_batch(queries)?;
        Ok((0..predictions.len()).map(|i| predictions.distribution(i)).collect())
    }

    /// The candidate with the smallest risk (histogram match to the histogram of a held-out state's observations) in
    /// cross-validation over states; the same folds for every model.
    pub(super) fn choose(
        self,
        setup: &Setup,
        data: &Dataset,
        candidates: &[Vec<f64>],
        folds: &[Fold],
    ) -> Result<Vec<f64>, Error> {
        let score = |bandwidths: &Vec<f64>| -> Result<f64, Error> {
            let mut sum = 0.0;
            for fold in folds {
                let predicted = self.predict(setup, &fold.train, bandwidths, fold.held_out.states())?;
                for (predicted, observed) in predicted.iter().zip(&fold.observed) {
                    sum += histogram_match(predicted, observed)?;
                }
            }
            Ok(sum)
        };
        debug_assert!(data.dim() == candidates[0].len());
        Ok(distreg::grid_search(candidates, score)?.candidate)
    }
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
                .map(|i| histogram(held_out.observations(i), setup.grid, setup.point_mass_at))
                .collect::<Result<_, _>>()?;
            Ok(Fold { train, held_out, observed })
        })
        .collect()
}
