//! The models that are fitted to data: their names, their forms, their fits.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;
use std::sync::Arc;

use locsim_core::limits::quoted;
use locsim_core::{CAST_REACH, DistanceMap, SensorModel};
use serde::{Deserialize, Serialize};
use strum::{VariantArray, VariantNames};

use crate::field::{FieldParameters, LikelihoodField};
use crate::histogram::HistogramTable;
use crate::mixture::BeamMixture;
use crate::np_reg;
use crate::np_reg_field::{self, Intensity, NpRegField as NpRegFieldModel};
use crate::p_reg::{self, NormalTable};
use crate::{SensorError, TrainingSet, total};

/// The models that are fitted to data, by the names that scenarios and tables use.
#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    VariantArray,
    VariantNames,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum ModelKind {
    /// Gaussian at the nominal range and exponential, the paper's baseline: Probabilistic Robotics, eqs. 6.4
    /// to 6.9.
    Classic,
    /// Hit, short, max and random: Probabilistic Robotics, tables 6.1 and 6.2.
    BeamMixture,
    /// Distance of the reading's end to the map: Probabilistic Robotics, table 6.3.
    LikelihoodField,
    /// Gaussian whose parameters are regressed on the state: the paper's procedure 1.
    PReg,
    /// Histograms of z smoothed over the state: the paper's procedure 2, as published.
    NpReg,
    /// Histograms of z - r smoothed over the state.
    NpRegRegistered,
    /// Histograms of z - r and of the distance of the reading's end to the map, per metre of beam.
    NpRegField,
}

impl ModelKind {
    /// Every kind, in the order of tables.
    pub const ALL: &[Self] = <Self as VariantArray>::VARIANTS;

    /// Their names.
    pub const NAMES: &[&str] = <Self as VariantNames>::VARIANTS;

    /// The name, for example `np_reg_registered`.
    pub const fn as_str(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// Whether its density of each beam integrates to 1. Models that score where readings end don't: along a wall their
    /// density is high everywhere.
    pub const fn is_normalized(self) -> bool {
        !matches!(self, Self::LikelihoodField | Self::NpRegField)
    }

    /// Description for reports and the schema of scenarios.
    pub const fn sentence(self) -> &'static str {
        match self {
            Self::Classic => {
                "Gaussian about the nominal range plus an exponential for unmapped objects (the paper's competitor), by EM"
            }
            Self::BeamMixture => {
                "hit, short, maximum and random components (Probabilistic Robotics, table 6.1), by EM"
            }
            Self::LikelihoodField => {
                "distance of a reading's end to the nearest mapped surface (table 6.3 there)"
            }
            Self::PReg => {
                "Gaussian whose parameters are regressed on the beam's state (the paper's procedure 1)"
            }
            Self::NpReg => {
                "histograms smoothed over the beam's state (the paper's procedure 2, as published)"
            }
            Self::NpRegRegistered => {
                "the same on readings minus nominal ranges, with a point mass at the maximum range"
            }
            Self::NpRegField => {
                "readings by offset from the nominal range and by distance of their end to the nearest mapped surface"
            }
        }
    }
}

impl fmt::Display for ModelKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for ModelKind {
    type Err = SensorError;

    fn from_str(name: &str) -> Result<Self, SensorError> {
        Self::ALL
            .iter()
            .copied()
            .find(|kind| kind.as_str() == name)
            .ok_or_else(|| SensorError::UnknownModel(name.to_owned()))
    }
}

/// Inputs of a fit beside the data.
#[derive(Clone, Default)]
pub struct FitOptions {
    /// Distances to the mapped surfaces, for `likelihood_field` and `np_reg_field`; the other models don't look at it.
    pub distance_map: Option<Arc<dyn DistanceMap>>,
}

/// Maximum ranges \[m\] that a model file may name.
const MAX_RANGES_M: RangeInclusive<f32> = 1e-3..=1e6;

/// Greatest number of chosen values in a model file, and of letters in a value's name.
const MOST_CHOSEN: usize = 32;
const MOST_LETTERS: usize = 64;

/// A model fitted to data: parameters or tables that can be saved, loaded and turned into a [`SensorModel`].
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "Unchecked")]
pub struct FittedModel {
    kind: ModelKind,
    max_range: f32,
    chosen: BTreeMap<String, f64>,
    form: Form,
}

/// A model as stored in a file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Unchecked {
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
    Intensity(Intensity),
}

impl TryFrom<Unchecked> for FittedModel {
    type Error = String;

    fn try_from(Unchecked { kind, max_range, chosen, form }: Unchecked) -> Result<Self, String> {
        if !MAX_RANGES_M.contains(&max_range) {
            let (least, most) = MAX_RANGES_M.into_inner();
            return Err(format!("maximum range {max_range} m is not allowed; from {least} m to {most} m"));
        }
        check_chosen(&chosen)?;
        form.check(kind, max_range)?;
        Ok(Self { kind, max_range, chosen, form })
    }
}

/// Chosen values stand in tables and reports.
fn check_chosen(chosen: &BTreeMap<String, f64>) -> Result<(), String> {
    if chosen.len() > MOST_CHOSEN {
        return Err(format!("{} chosen values are not allowed; at most {MOST_CHOSEN}", chosen.len()));
    }
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    for (name, value) in chosen {
        if name.is_empty() || name.len() > MOST_LETTERS || !name.chars().all(plain) {
            return Err(format!(
                "`{}` is not allowed as the name of a chosen value; a-z, 0-9 and _, at most {MOST_LETTERS}",
                quoted(name)
            ));
        }
        // A score of a model that holds a held-out reading impossible is plus infinity.
        if value.is_nan() || *value == f64::NEG_INFINITY {
            return Err(format!("{value} is not allowed as the chosen value `{name}`"));
        }
    }
    Ok(())
}

impl Form {
    /// Whether it is a model of this kind for this sensor, and its density integrates to 1 if it should.
    fn check(&self, kind: ModelKind, max_range: f32) -> Result<(), String> {
        use ModelKind::{BeamMixture, Classic, LikelihoodField, NpReg, NpRegField, NpRegRegistered, PReg};
        let (kinds, kind_within): (&[_], _) = match self {
            Self::Mixture(mixture) => (&[Classic, BeamMixture], mixture.kind()),
            Self::Field(_) => (&[LikelihoodField], LikelihoodField),
            Self::Normal(_) => (&[PReg], PReg),
            Self::Histogram(table) => (&[NpReg, NpRegRegistered], table.kind()),
            Self::Intensity(_) => (&[NpRegField], NpRegField),
        };
        if kind != kind_within || !kinds.contains(&kind) {
            return Err(format!("it says it is {kind}, and holds the form of {}", kinds[0]));
        }
        let cast_range = if kind == NpRegRegistered { CAST_REACH * max_range } else { max_range };
        let same = |found: f32, expected: f32| {
            if found == expected {
                Ok(())
            } else {
                Err(format!("its table reaches to {found} m, not to {expected} m"))
            }
        };
        match self {
            Self::Mixture(mixture) => {
                mixture.check()?;
                total::check(mixture, max_range)
            }
            Self::Field(parameters) => parameters.check(),
            Self::Normal(table) => {
                same(table.reach(), cast_range)?;
                total::check(table, max_range)
            }
            Self::Histogram(table) => {
                same(table.max_range(), max_range)?;
                same(table.reach(), cast_range)?;
                total::check(table, max_range)
            }
            Self::Intensity(intensity) => same(intensity.max_range(), max_range),
        }
    }
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
    let chooses = [ModelKind::PReg, ModelKind::NpReg, ModelKind::NpRegRegistered, ModelKind::NpRegField];
    let needs_held_out = chooses.contains(&kind);
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
        ModelKind::NpRegField => {
            let map = options.distance_map.as_deref().ok_or(SensorError::NoDistanceMap)?;
            let (intensity, chosen) = np_reg_field::fit(train, held_out, map)?;
            (Form::Intensity(intensity), chosen)
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

    /// The values that fitting chose, by name: weights, deviations and rates of a mixture, bandwidths of a regression
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
            Form::Intensity(intensity) => {
                let map = distance_map.ok_or(SensorError::NoDistanceMap)?;
                Arc::new(NpRegFieldModel { intensity, map })
            }
        })
    }
}
