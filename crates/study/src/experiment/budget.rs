//! Training states chosen within a budget.

use distreg::{Alignment, Dataset, Selection, condense, select};

use super::Purpose;
use super::data::{Test, score};
use crate::model::folds;
use crate::{Model, Study, StudyError};

/// The model whose training set is thinned: the best of NP-REG's forms that the study has.
pub(super) fn thinned_model(study: &Study) -> Option<usize> {
    let place = |model| study.models.iter().position(|m| *m == model);
    place(Model::NpRegRegistered).or_else(|| place(Model::NpReg))
}

/// Risk with training states chosen from the largest set within each size, by farthest-first traversal, by herding, and by
/// the first with all observations kept. Distances are in the bandwidths that the model chose for the largest set.
pub(super) fn thinned(
    study: &Study,
    repeat: u32,
    data: &Dataset,
    tests: &[Test],
    queries: &[f64],
    candidates: &[Vec<f64>],
    bandwidths: &[Vec<Vec<f64>>],
) -> Result<[Vec<f64>; 3], StudyError> {
    let mut risks: [Vec<f64>; 3] = Default::default();
    let Some(place) = thinned_model(study).filter(|_| study.thinning) else { return Ok(risks) };
    let model = study.models[place];
    let Some(scales) = bandwidths[place].last() else { return Ok(risks) };
    let seed = study.draw(Purpose::Thinning, repeat).seed(0);
    let orders = [Selection::FarthestFirst, Selection::Herding]
        .map(|selection| select(data, data.len(), selection, scales, seed));
    let [farthest, herding] = orders;
    let (farthest, herding) = (farthest?, herding?);
    let alignment = match model {
        Model::NpRegRegistered => study.setup.alignment.unwrap_or_default(),
        _ => Alignment::Identity,
    };
    let point = study.setup.outcomes.point_mass_at;
    for &n in &study.states {
        let chosen = [
            data.subset(&farthest[..n]),
            data.subset(&herding[..n]),
            condense(data, &farthest[..n], alignment, point, scales)?,
        ];
        for (risks, train) in risks.iter_mut().zip(chosen) {
            let folds = folds(&study.setup, &train, study.folds, seed)?;
            let bandwidths = model.choose(&study.setup, candidates, &folds, study.criterion)?;
            let predicted = model.predict(&study.setup, &train, &bandwidths, queries)?;
            risks.push(score(&predicted, tests)?.0);
        }
    }
    Ok(risks)
}
