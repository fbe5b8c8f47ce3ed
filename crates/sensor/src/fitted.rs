//! Fitting, and what a fit gives.

use std::collections::BTreeMap;
use std::sync::Arc;

use locsim_core::{DistanceMap, SensorModel};
use serde::{Deserialize, Serialize};

use crate::field::{FieldParameters, LikelihoodField};
use crate::histogram::HistogramTable;
use crate::mixture::BeamMixture;
use crate::np_reg;
use crate::p_reg::{self, NormalTable};
use crate::{ModelKind, SensorError, TrainingSet};

/// What fitting may need beside the data.
#[derive(Clone, Default)]
pub struct FitOptions {
    /// Distances to the mapped surfaces, for `likelihood_field`; the other models don't look at it.
    pub distance_map: Option<Arc<dyn DistanceMap>>,
}

/// A model fitted to data: parameters or tables that can be saved, loaded and turned into a [`SensorModel`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FittedModel {
    kind: ModelKind,
    max_range: f32,
    chosen: BTreeMap<String, f64>,
    form: Form,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
enum Form {
    Mixture(BeamMixture),
    Field(FieldParameters),
    Normal(NormalTable),
    Histogram(HistogramTable),
}

/// Fits a model of `kind` to `train`; `held_out` decides between bandwidths, where the model has any.
///
/// Both sets should come from [`TrainingSet::split`]. The result is a function of the arguments alone,
/// whatever the number of threads.
///
/// # Errors
/// [`SensorError::TooFewData`] where there is nothing to fit or to choose by,
/// [`SensorError::MaxRangesDiffer`], and [`SensorError::NoDistanceMap`] for a likelihood field without its
/// map.
pub fn fit(
    kind: ModelKind,
    train: &TrainingSet,
    held_out: &TrainingSet,
    options: &FitOptions,
) -> Result<FittedModel, SensorError> {
    if train.max_range() != held_out.max_range() {
        return Err(SensorError::MaxRangesDiffer {
            train: train.max_range(),
            held_out: held_out.max_range(),
        });
    }
    if train.is_empty() {
        return Err(SensorError::TooFewData { model: kind, what: "no training states" });
    }
    let needs_held_out = matches!(kind, ModelKind::PReg | ModelKind::NpReg | ModelKind::NpRegRegistered);
    if needs_held_out && held_out.is_empty() {
        return Err(SensorError::TooFewData {
            model: kind,
            what: "no held-out states to choose bandwidths by",
        });
    }
    let (form, chosen) = match kind {
        ModelKind::Classic | ModelKind::BeamMixture => {
            let mixture = BeamMixture::fit(kind, train)?;
            let chosen = mixture.chosen();
            (Form::Mixture(mixture), chosen)
        }
        ModelKind::LikelihoodField => {
            let map = options.distance_map.as_deref().ok_or(SensorError::NoDistanceMap)?;
            let parameters = FieldParameters::fit(train, map)?;
            (Form::Field(parameters), parameters.chosen())
        }
        ModelKind::PReg => {
            let (table, chosen) = p_reg::fit(train, held_out)?;
            (Form::Normal(table), chosen)
        }
        ModelKind::NpReg | ModelKind::NpRegRegistered => {
            let (table, chosen) = np_reg::fit(kind, train, held_out)?;
            (Form::Histogram(table), chosen)
        }
    };
    Ok(FittedModel { kind, max_range: train.max_range(), chosen, form })
}

impl FittedModel {
    /// Which model this is.
    pub fn kind(&self) -> ModelKind {
        self.kind
    }

    /// Maximum range \[m\] of the sensor it was fitted to. It makes no sense for another.
    pub fn max_range(&self) -> f32 {
        self.max_range
    }

    /// What fitting chose, by name: weights, deviations and rates of a mixture, bandwidths of a regression
    /// and the held-out scores they were chosen by. Names end in their unit.
    pub fn chosen(&self) -> &BTreeMap<String, f64> {
        &self.chosen
    }

    /// The model itself. `distance_map` is needed by `likelihood_field` and ignored by the others.
    ///
    /// # Errors
    /// [`SensorError::NoDistanceMap`] for a likelihood field without its map.
    pub fn into_model(
        self,
        distance_map: Option<Arc<dyn DistanceMap>>,
    ) -> Result<Arc<dyn SensorModel>, SensorError> {
        Ok(match self.form {
            Form::Mixture(mixture) => Arc::new(mixture),
            Form::Field(parameters) => {
                let map = distance_map.ok_or(SensorError::NoDistanceMap)?;
                Arc::new(LikelihoodField { parameters, map })
            }
            Form::Normal(table) => Arc::new(table),
            Form::Histogram(table) => Arc::new(table),
        })
    }
}
