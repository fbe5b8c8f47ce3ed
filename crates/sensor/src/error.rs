use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::ModelKind;

/// Why a sensor model can't be fitted, saved, loaded or used.
#[derive(Debug, Error)]
pub enum SensorError {
    /// The maximum range is not a positive finite number.
    #[error("the maximum range must be positive and finite, got {0} m")]
    MaxRange(f32),
    /// A training state has a pose, range or angle that is not finite or out of bounds.
    #[error("training state {index}: {what}")]
    State {
        /// Index the state would have had.
        index: usize,
        /// The defect.
        what: &'static str,
    },
    /// An observation lies outside of 0 to the maximum range.
    #[error("training state {index}: reading {value} m is outside of 0 to {max_range} m")]
    Reading {
        /// Index the state would have had.
        index: usize,
        /// The reading \[m\].
        value: f32,
        /// The maximum range \[m\].
        max_range: f32,
    },
    /// There are too few readings to fit anything.
    #[error("{model}: {what}")]
    TooFewData {
        /// The model that was to be fitted.
        model: ModelKind,
        /// The missing part.
        what: &'static str,
    },
    /// The training and held-out sets are of different sensors.
    #[error("training data reach to {train} m, held-out data to {held_out} m")]
    MaxRangesDiffer {
        /// Maximum range of the training set \[m\].
        train: f32,
        /// Maximum range of the held-out set \[m\].
        held_out: f32,
    },
    /// The likelihood field was to be fitted or used without a distance map.
    #[error("likelihood_field needs a distance map")]
    NoDistanceMap,
    /// A model of this name doesn't exist.
    #[error(
        "unknown sensor model {0:?}; known are {known}",
        known = ModelKind::NAMES.join(", ")
    )]
    UnknownModel(String),
    /// Parameters of a model are out of bounds.
    #[error("{what} must be {allowed}, got {value}")]
    Parameter {
        /// Which parameter.
        what: &'static str,
        /// The values it may have.
        allowed: &'static str,
        /// The value given.
        value: f64,
    },
    /// A model that looks at everything was to be prepared as a table.
    #[error("{model} depends on more of a beam than a table can hold")]
    NoTable {
        /// The model.
        model: String,
    },
    /// There is nothing to choose a floor and an exponent from.
    #[error("floor and exponent: {0}")]
    Calibration(&'static str),
    /// A regression failed.
    #[error("regression: {0}")]
    Regression(#[from] distreg::Error),
    /// A model file could not be read or written.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A model file is larger than the limit.
    #[error("{path}: {refusal}", path = path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The allowed values.
        refusal: String,
    },
    /// A file is not a sensor model of ours.
    #[error("{path} is not a locsim sensor model", path = .0.display())]
    Foreign(PathBuf),
    /// A file was written by another version of locsim.
    #[error("{path} has format version {found}; this locsim reads version {known}: fit the model again", path = path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Version in the file.
        found: u32,
        /// Version this program writes and reads.
        known: u32,
    },
    /// A file is cut short or altered, or holds no model.
    #[error("{path} is damaged: {what}", path = path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The part that doesn't fit.
        what: String,
    },
}

/// What training readings lack for a model of a wall's readings.
pub(crate) const NO_SURFACE: &str = "none of the training readings is of a wall of the map: are map and laser in metres, and does the \
                                     laser reach the walls?";
