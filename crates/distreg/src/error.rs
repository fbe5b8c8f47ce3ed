/// Errors in the input of distribution regression.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A state or query has another number of coordinates than the data.
    #[error("a state has {found} coordinates, expected {expected}")]
    Dimension {
        /// Coordinates of the data's states.
        expected: usize,
        /// Coordinates that were given.
        found: usize,
    },
    /// A number that must be finite is NaN or infinite.
    #[error("{what} must be finite, found {value}")]
    NotFinite {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A number that must be positive and finite is not.
    #[error("{what} must be positive and finite, found {value}")]
    NotPositive {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A share is not within 0 and 1.
    #[error("{what} must be within 0 and 1, found {value}")]
    NotAShare {
        /// Which share.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// Something that must have at least one element has none.
    #[error("{what} must not be empty")]
    Empty {
        /// The empty input.
        what: &'static str,
    },
    /// Two lengths that belong together differ.
    #[error("{what}: found {found}, expected {expected}")]
    Length {
        /// Which length.
        what: &'static str,
        /// The length that was needed.
        expected: usize,
        /// The length that was given.
        found: usize,
    },
    /// A grid has no bins or too many.
    #[error("a grid must have 1 to {most} bins, found {found}")]
    Bins {
        /// Bins of the grid.
        found: usize,
        /// Most bins that a grid may have.
        most: usize,
    },
    /// An alignment names a state coordinate that does not exist.
    #[error("alignment by state coordinate {state_dim}, but a state has {dim} coordinates")]
    AlignmentDimension {
        /// The coordinate that was named.
        state_dim: usize,
        /// Coordinates of a state.
        dim: usize,
    },
    /// Two distributions on different grids can't be compared bin by bin.
    #[error("the distributions are on different grids")]
    GridMismatch,
    /// Of an observation and its residual, one has a point mass and the other has not.
    #[error("either both or neither of an observation and its residual have a point mass")]
    PointMassMismatch,
    /// Bin masses that are negative, not finite or sum to zero are no distribution.
    #[error("bin masses must be finite, at least zero, and sum to more than zero")]
    NoDistribution,
    /// Cross-validation needs at least two folds and no more folds than states.
    #[error("{folds} folds cannot be made of {states} states; 2 to {states} are possible")]
    Folds {
        /// Folds asked for.
        folds: usize,
        /// States of the data.
        states: usize,
    },
    /// A search found no candidate with a finite score.
    #[error("none of the {candidates} candidates has a finite score")]
    NoFiniteScore {
        /// Candidates tried.
        candidates: usize,
    },
}

/// Accepts finite numbers.
pub(crate) fn finite(what: &'static str, value: f64) -> Result<f64, Error> {
    if value.is_finite() { Ok(value) } else { Err(Error::NotFinite { what, value }) }
}

/// Accepts positive finite numbers.
pub(crate) fn positive(what: &'static str, value: f64) -> Result<f64, Error> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(Error::NotPositive { what, value }) }
}

/// Accepts queries of `dim` finite coordinates.
pub(crate) fn query(dim: usize, query: &[f64]) -> Result<(), Error> {
    if query.len() != dim {
        return Err(Error::Dimension { expected: dim, found: query.len() });
    }
    for &x in query {
        finite("a state coordinate", x)?;
    }
    Ok(())
}
