use thiserror::Error;

use super::EffectKind;

/// Why an effect is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum EffectError {
    /// There is no effect of this name.
    #[error("{name:?} is not an effect; one of {}", EffectKind::ALL.map(EffectKind::name).join(", "))]
    Unknown {
        /// The name that was asked for.
        name: String,
    },
    /// An effect has as many values as parameters.
    #[error("{kind} needs {} values; got {got}", .kind.parameters().len())]
    Values {
        /// The effect.
        kind: EffectKind,
        /// How many there are.
        got: usize,
    },
    /// A value is out of range or not finite.
    #[error("{parameter} of {kind} must be from {lo} to {hi}; got {value}")]
    Value {
        /// The effect.
        kind: EffectKind,
        /// The parameter.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// The least that is allowed.
        lo: f64,
        /// The most that is allowed.
        hi: f64,
    },
    /// Effects on a stretch of wall need one; the others have none.
    #[error("{kind} {}", if .kind.has_place() { "needs a place: at least one stretch of wall" } else { "has no place" })]
    Place {
        /// The effect.
        kind: EffectKind,
    },
    /// A stretch of wall has no length, or an end that isn't finite.
    #[error("stretch {index} of the place of {kind} needs two finite ends that differ")]
    Stretch {
        /// The effect.
        kind: EffectKind,
        /// Which stretch.
        index: usize,
    },
    /// More than one of a kind that can be there once.
    #[error("{kind} can be there once only")]
    Twice {
        /// The effect.
        kind: EffectKind,
    },
    /// More ways for a reading to go astray than a distribution holds.
    #[error("{count} replacements of readings by effects are more than the {max} that are allowed")]
    TooMany {
        /// How many there are.
        count: usize,
        /// The most that is allowed.
        max: usize,
    },
}
