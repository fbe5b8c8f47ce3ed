use std::fmt;

use serde_json::Value;

use crate::scenario::Expectation;
use crate::summary::Summary;

/// A bound that a scenario declares and its results don't keep.
#[derive(Clone, Debug, PartialEq)]
pub struct MissedBound {
    /// Label of the model.
    pub model: String,
    /// The figure of `summary.json`, with dots between nested keys.
    pub metric: &'static str,
    /// What was measured; `None` where the model has no such figure.
    pub value: Option<f64>,
    /// The bound, in words.
    pub bound: String,
}

impl fmt::Display for MissedBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{} ", self.model, self.metric)?;
        match self.value {
            Some(value) => write!(f, "is {value:.6}, expected {}", self.bound),
            None => write!(f, "was not measured, expected {}", self.bound),
        }
    }
}

/// The bounds that the summary misses. A figure that isn't a number keeps no bound.
pub(super) fn missed(expectations: &[Expectation], summary: &Summary) -> Vec<MissedBound> {
    let figures = serde_json::to_value(summary).unwrap_or_default();
    expectations
        .iter()
        .filter_map(|expected| {
            let mut keys = ["models", &expected.model].into_iter().chain(expected.metric.split('.'));
            let value = keys.try_fold(&figures, |value, key| value.get(key)).and_then(Value::as_f64);
            let low = expected.min.filter(|min| value.is_none_or(|value| value < *min));
            let high = expected.max.filter(|max| value.is_none_or(|value| value > *max));
            let bound = match (low, high) {
                (None, None) => return None,
                (Some(min), _) => format!("at least {min}"),
                (None, Some(max)) => format!("at most {max}"),
            };
            Some(MissedBound { model: expected.model.clone(), metric: expected.metric, value, bound })
        })
        .collect()
}
