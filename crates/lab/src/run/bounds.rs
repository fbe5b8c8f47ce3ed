use std::fmt;

use serde_json::Value;

use locsim_report::summary::Summary;
use locsim_scenario::Expectation;

/// A bound that a scenario declares and its results don't keep.
#[derive(Clone, Debug, PartialEq)]
pub struct MissedBound {
    /// Label of the model.
    pub model: String,
    /// The figure of `summary.json`, with dots between nested keys.
    pub metric: &'static str,
    /// The measured value; `None` where the model has no such figure.
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use locsim_report::results::TrainingRow;
    use locsim_report::summary::{AngularError, Errors as ErrorSummary, Kept, LinearError, ModelSummary};
    use locsim_scenario::METRICS;
    use locsim_scenario::key_path::join;

    use super::*;

    /// Collects the dotted paths of the numbers in a tree.
    fn figures(path: &str, value: &Value, out: &mut BTreeSet<String>) {
        match value {
            Value::Object(map) => {
                for (key, inner) in map {
                    figures(&join(path, key), inner, out);
                }
            }
            Value::Number(_) => _ = out.insert(path.to_owned()),
            _ => {}
        }
    }

    #[test]
    fn bounds_can_be_declared_on_every_figure_of_a_model() {
        let linear = LinearError { mean_m: 1.0, std_m: 1.0 };
        let errors = ErrorSummary {
            position_rmse_m: 1.0,
            position_median_m: 1.0,
            position_p95_m: 1.0,
            position_std_m: 1.0,
            along: linear,
            across: linear,
            heading: AngularError { mean_rad: 1.0, std_rad: 1.0 },
        };
        let train =
            TrainingRow { log_loss_nats: Some(1.0), histogram_match_m: Some(1.0), ..TrainingRow::default() };
        let summary = ModelSummary {
            lost_share: 0.0,
            errors,
            ess_mean: 1.0,
            nees_mean: 3.0,
            nees_with_shared_errors_mean: 3.0,
            nees_intervals: None,
            step_ms: 1.0,
            train,
            intervals: None,
            kept: Some(Kept { trials: 1, errors, intervals: None }),
            localized: None,
        };
        let mut found = BTreeSet::new();
        figures("", &serde_json::to_value(summary).unwrap(), &mut found);
        assert_eq!(found, METRICS.into_iter().map(str::to_owned).collect());
    }
}
