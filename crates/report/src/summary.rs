//! `summary.json`: what an experiment found, for scripts. The schema is stable: fields are added, never
//! renamed or removed.

use indexmap::IndexMap;
use locsim_core::Interval;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::drive;
use crate::localized::Localized;
use crate::nees::NeesIntervals;
use crate::results::{ModelTrial, RunResults, TrainingRow};
use crate::statistics::{Bootstrap, Moments, PooledValues, share_interval};

/// Name of the model that ratios `*_vs_classic` refer to.
pub const CLASSIC: &str = "classic";
/// Name of the model that ratios `*_vs_oracle` refer to.
pub const ORACLE: &str = "oracle";

/// Why results can't be summarized.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SummaryError {
    /// Nothing was run.
    #[error("the results hold no {0}")]
    Empty(&'static str),
    /// A trial doesn't have the run's models in the run's order, so trials aren't paired.
    #[error("trial {trial} has the models {found:?}; the run has {expected:?}")]
    Models {
        /// Number of the trial.
        trial: u32,
        /// The models it has.
        found: Vec<String>,
        /// The run's models.
        expected: Vec<String>,
    },
    /// There isn't one training row per model.
    #[error("{rows} training rows for {models} models")]
    Training {
        /// Number of training rows.
        rows: usize,
        /// Number of models.
        models: usize,
    },
    /// A model has no steps in a trial.
    #[error("model {model} has no steps in trial {trial}")]
    NoSteps {
        /// Number of the trial.
        trial: u32,
        /// Name of the model.
        model: String,
    },
    /// An error or an effective sample size is NaN or infinite.
    #[error("model {model} has a value that is not finite at step {step} of trial {trial}")]
    NotFinite {
        /// Number of the trial.
        trial: u32,
        /// Name of the model.
        model: String,
        /// Index of the scan.
        step: u32,
    },
}

/// Mean and standard deviation of a signed error (m).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearError<T = f64> {
    /// Mean (m).
    pub mean_m: T,
    /// Standard deviation about the mean (m).
    pub std_m: T,
}

/// Mean and standard deviation of a signed error (rad).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AngularError<T = f64> {
    /// Mean (rad).
    pub mean_rad: T,
    /// Standard deviation about the mean (rad).
    pub std_rad: T,
}

/// Errors of one model's estimate, pooled over all steps of the trials they are taken over. With
/// `T = Interval` the 95 % interval of each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors<T = f64> {
    /// Root of the mean squared distance between estimate and truth (m) (absolute trajectory error).
    pub position_rmse_m: T,
    /// Median of that distance (m).
    pub position_median_m: T,
    /// Its 95th percentile (m).
    pub position_p95_m: T,
    /// Root of the sum of the variances of the signed errors along and across (m).
    pub position_std_m: T,
    /// Signed error along the scenario's error axis.
    pub along: LinearError<T>,
    /// Signed error across it, left positive.
    pub across: LinearError<T>,
    /// Signed heading error, each wrapped to (-pi, pi].
    pub heading: AngularError<T>,
}

impl<T> Errors<T> {
    fn from_array(values: [T; 10]) -> Self {
        let [rmse, median, p95, std, along, along_std, across, across_std, heading, heading_std] = values;
        Self {
            position_rmse_m: rmse,
            position_median_m: median,
            position_p95_m: p95,
            position_std_m: std,
            along: LinearError { mean_m: along, std_m: along_std },
            across: LinearError { mean_m: across, std_m: across_std },
            heading: AngularError { mean_rad: heading, std_rad: heading_std },
        }
    }
}

/// 95 % intervals of a model's figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelIntervals {
    /// Of the share of lost trials: Clopper and Pearson's exact interval.
    pub lost_share: Interval,
    /// Of the errors: percentile bootstrap over trials.
    #[serde(flatten)]
    pub errors: Errors<Interval>,
}

/// A model's errors without the trials it lost: precision apart from divergence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// Number of trials not lost.
    pub trials: u32,
    /// The errors over these trials.
    #[serde(flatten)]
    pub errors: Errors,
    /// Their 95 % intervals; `None` with a single trial, or so few kept ones that most resamples hold none.
    pub intervals: Option<Errors<Interval>>,
}

/// Results of an experiment for one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelSummary {
    /// Share of the trials that ended farther from the truth than the scenario's `lost_m`, or were that far off in more than
    /// half of their steps.
    pub lost_share: f64,
    /// Errors over all trials, lost ones included.
    #[serde(flatten)]
    pub errors: Errors,
    /// Mean effective sample size before resampling, over all steps of all trials.
    pub ess_mean: f64,
    /// Mean over trials of their mean normalized estimation error squared over (x, y, heading): 3 for a filter whose
    /// covariance is right.
    pub nees_mean: f64,
    /// The same with the covariance of the errors that scans of a log share added to the filter's.
    pub nees_with_shared_errors_mean: f64,
    /// 95 % intervals of these two; `None` of a drive of fewer than 20 steps.
    pub nees_intervals: Option<NeesIntervals>,
    /// Mean wall time of a filter step (ms); with `seconds` the only figure that a repeated run doesn't reproduce.
    pub step_ms: f64,
    /// How the model did on held-out training data, and what was chosen on it.
    pub train: TrainingRow,
    /// 95 % intervals; `None` with a single trial.
    pub intervals: Option<ModelIntervals>,
    /// The errors without lost trials; `None` when all were lost.
    pub kept: Option<Kept>,
    /// How soon the filter found the robot; only from an unknown start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub localized: Option<Localized>,
}

/// A ratio of two models' figures on the same trials.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ratio {
    /// The ratio.
    pub value: f64,
    /// Lower end of its 95 % interval: by the paired bootstrap over trials. Where all are of one drive, it is at least as wide as how its
    /// steps vary, whose errors last (Kiefer and Vogelsang 2005). `None` of one drive of fewer than 20 steps.
    pub lo: Option<f64>,
    /// Upper end, likewise.
    pub hi: Option<f64>,
}

impl Ratio {
    /// Its interval, where there is one.
    pub fn interval(&self) -> Option<Interval> {
        Some(Interval { lo: self.lo?, hi: self.hi? })
    }
}

/// One model against the models it is judged by: `classic` and `oracle`, and the first of several models where `classic`
/// isn't in the run. `None` where that model isn't in the run, where its figure is zero, or where no trial is left to compare on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ratios {
    /// `position_std_m` over that of `classic`.
    pub position_std_vs_classic: Option<Ratio>,
    /// `position_rmse_m` over that of `classic`.
    pub rmse_vs_classic: Option<Ratio>,
    /// `position_rmse_m` over that of `oracle`.
    pub rmse_vs_oracle: Option<Ratio>,
    /// `position_rmse_m` over the lowest of all models.
    pub rmse_vs_lowest: Option<Ratio>,
    /// `position_std_m` over that of the first model; only in a run without `classic`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_std_vs_first: Option<Ratio>,
    /// `position_rmse_m` over that of the first model; only in a run without `classic`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rmse_vs_first: Option<Ratio>,
}

impl Ratios {
    /// `position_std_m` over that of the [baseline](Summary::baseline).
    pub fn position_std(&self) -> Option<Ratio> {
        self.position_std_vs_classic.or(self.position_std_vs_first)
    }

    /// `position_rmse_m` over that of the [baseline](Summary::baseline).
    pub fn rmse(&self) -> Option<Ratio> {
        self.rmse_vs_classic.or(self.rmse_vs_first)
    }
}

/// `summary.json`: everything an experiment found. All errors are pooled over all steps of all trials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The scenario's name.
    pub scenario: String,
    /// Its seed.
    pub seed: u64,
    /// Number of trials.
    pub trials: u32,
    /// Wall time of the run (s).
    pub seconds: f64,
    /// Whether all trials are of one drive, as those of a log: they differ in the filter's draws alone.
    #[serde(default)]
    pub one_drive: bool,
    /// The models in the scenario's order.
    pub models: IndexMap<String, ModelSummary>,
    /// Ratios over all trials, in the same order.
    pub ratios: IndexMap<String, Ratios>,
    /// The same ratios over the trials that neither of the two models lost.
    pub ratios_kept: IndexMap<String, Ratios>,
}

impl Summary {
    /// Whether scans share errors under some model, as those of a log do.
    pub fn shares_errors(&self) -> bool {
        self.models.values().any(|model| model.nees_with_shared_errors_mean != model.nees_mean)
    }

    /// The model that the others are compared with: `classic`, or the first where that isn't in the run.
    pub fn baseline(&self) -> &str {
        let first = self.models.keys().next().map(String::as_str);
        self.models.get(CLASSIC).map(|_| CLASSIC).or(first).unwrap_or(CLASSIC)
    }

    /// Summarizes a run. A pure function of its results: the bootstrap is keyed by the run's seed.
    ///
    /// # Errors
    /// [`SummaryError`] for results without models, trials or steps, trials with other models than the run,
    /// and values that are not finite.
    pub fn new(results: &RunResults) -> Result<Self, SummaryError> {
        check(results)?;
        let bootstrap = Bootstrap::new(results.seed, results.trials.len());
        let samples: Vec<Sample<'_>> =
            (0..results.models.len()).map(|model| Sample::new(results, model, bootstrap.as_ref())).collect();
        let by_model = |name: &str| results.models.iter().position(|m| m == name).map(|i| &samples[i]);
        let (classic, oracle) = (by_model(CLASSIC), by_model(ORACLE));
        let first = samples.first().filter(|_| classic.is_none() && samples.len() > 1);
        let all = vec![1; results.trials.len()];
        let lowest = samples.iter().min_by(|a, b| a.position_rmse(&all).total_cmp(&b.position_rmse(&all)));
        let ratios = |kept: bool| {
            let of = |sample: &Sample<'_>| {
                let std = |base| ratio(sample, base, kept, bootstrap.as_ref(), Spread::AboutMean);
                let rmse = |base| ratio(sample, base, kept, bootstrap.as_ref(), Spread::AboutTruth);
                Ratios {
                    position_std_vs_classic: std(classic),
                    rmse_vs_classic: rmse(classic),
                    rmse_vs_oracle: rmse(oracle),
                    rmse_vs_lowest: rmse(lowest),
                    position_std_vs_first: std(first),
                    rmse_vs_first: rmse(first),
                }
            };
            results.models.iter().cloned().zip(samples.iter().map(of)).collect()
        };
        let models = samples.iter().zip(&results.training).enumerate().map(|(i, (sample, train))| {
            sample.summary(train.clone(), Localized::of(results, i), bootstrap.as_ref())
        });
        Ok(Self {
            scenario: results.scenario.clone(),
            seed: results.seed,
            trials: results.trials.len() as u32,
            seconds: results.seconds,
            one_drive: drive::is_shared(&samples[0].trials),
            models: results.models.iter().cloned().zip(models).collect(),
            ratios: ratios(false),
            ratios_kept: ratios(true),
        })
    }
}

fn check(results: &RunResults) -> Result<(), SummaryError> {
    if results.models.is_empty() {
        return Err(SummaryError::Empty("models"));
    }
    if results.trials.is_empty() {
        return Err(SummaryError::Empty("trials"));
    }
    let models = results.models.len();
    if results.training.len() != models {
        return Err(SummaryError::Training { rows: results.training.len(), models });
    }
    for trial in &results.trials {
        if !trial.models.iter().map(|m| &m.model).eq(&results.models) {
            return Err(SummaryError::Models {
                trial: trial.trial,
                found: trial.models.iter().map(|m| m.model.clone()).collect(),
                expected: results.models.clone(),
            });
        }
        for ModelTrial { model, steps, .. } in &trial.models {
            if steps.is_empty() {
                return Err(SummaryError::NoSteps { trial: trial.trial, model: model.clone() });
            }
            let finite = |values: [f64; 4]| values.iter().all(|v| v.is_finite());
            if let Some(row) = steps.iter().find(|s| {
                !finite([s.error_along_m, s.error_across_m, s.error_heading_rad, s.effective_sample_size])
            }) {
                return Err(SummaryError::NotFinite {
                    trial: trial.trial,
                    model: model.clone(),
                    step: row.step,
                });
            }
        }
    }
    Ok(())
}

/// One model's errors by trial, in the form that resampling wants.
struct Sample<'a> {
    trials: Vec<&'a ModelTrial>,
    along: Vec<Moments>,
    across: Vec<Moments>,
    heading: Vec<Moments>,
    position: PooledValues,
    lost: Vec<bool>,
    ess_mean: f64,
    nees_mean: f64,
    nees_with_shared_errors_mean: f64,
    nees_intervals: Option<NeesIntervals>,
    step_ms: f64,
}

impl<'a> Sample<'a> {
    fn new(results: &'a RunResults, model: usize, bootstrap: Option<&Bootstrap>) -> Self {
        let trials: Vec<&ModelTrial> = results.trials.iter().map(|t| &t.models[model]).collect();
        let per_trial = |value: fn(&crate::results::StepRow) -> f64| {
            trials.iter().map(|t| t.steps.iter().map(value).collect::<Moments>()).collect::<Vec<_>>()
        };
        let ess = per_trial(|s| s.effective_sample_size);
        let mean_of_trials =
            |value| per_trial(value).iter().map(Moments::mean).sum::<f64>() / trials.len() as f64;
        let positions = trials
            .iter()
            .zip(0..)
            .flat_map(|(t, trial)| t.steps.iter().map(move |s| (s.position_error_m(), trial)));
        Self {
            along: per_trial(|s| s.error_along_m),
            across: per_trial(|s| s.error_across_m),
            heading: per_trial(|s| s.error_heading_rad),
            position: PooledValues::new(trials.len(), positions),
            lost: trials.iter().map(|t| t.lost).collect(),
            ess_mean: Moments::pooled(ess.iter().map(|m| (m, 1))).mean(),
            nees_mean: mean_of_trials(|s| s.nees),
            nees_with_shared_errors_mean: mean_of_trials(|s| s.nees_with_shared_errors),
            nees_intervals: NeesIntervals::of(&trials, bootstrap),
            step_ms: trials.iter().map(|t| t.step_ms).sum::<f64>() / trials.len() as f64,
            trials,
        }
    }

    fn pooled(parts: &[Moments], copies: &[u32]) -> Moments {
        Moments::pooled(parts.iter().zip(copies.iter().copied()))
    }

    fn position_rmse(&self, copies: &[u32]) -> f64 {
        let squares = Self::pooled(&self.along, copies).mean_square()
            + Self::pooled(&self.across, copies).mean_square();
        squares.sqrt()
    }

    fn position_std(&self, copies: &[u32]) -> f64 {
        let variances =
            Self::pooled(&self.along, copies).variance() + Self::pooled(&self.across, copies).variance();
        variances.sqrt()
    }

    fn errors(&self, copies: &[u32]) -> [f64; 10] {
        let [along, across, heading] =
            [&self.along, &self.across, &self.heading].map(|parts| Self::pooled(parts, copies));
        let [median, p95] = self.position.quantiles(copies, [0.5, 0.95]);
        [
            self.position_rmse(copies),
            median,
            p95,
            self.position_std(copies),
            along.mean(),
            along.variance().sqrt(),
            across.mean(),
            across.variance().sqrt(),
            heading.mean(),
            heading.variance().sqrt(),
        ]
    }

    /// `copies` with none of the lost trials.
    fn without_lost(&self, copies: &[u32]) -> Vec<u32> {
        copies.iter().zip(&self.lost).map(|(&n, &lost)| if lost { 0 } else { n }).collect()
    }

    fn summary(
        &self,
        train: TrainingRow,
        localized: Option<Localized>,
        bootstrap: Option<&Bootstrap>,
    ) -> ModelSummary {
        let trials = self.lost.len() as u32;
        let lost = self.lost.iter().filter(|&&lost| lost).count() as u32;
        let all = vec![1; self.lost.len()];
        let errors = Errors::from_array(self.errors(&all));
        let intervals =
            bootstrap.and_then(|b| b.intervals(|copies| self.errors(copies))).map(Errors::from_array);
        let kept = match lost {
            0 => Some(Kept { trials, errors, intervals }),
            _ if lost == trials => None,
            _ => Some(Kept {
                trials: trials - lost,
                errors: Errors::from_array(self.errors(&self.without_lost(&all))),
                intervals: bootstrap
                    .and_then(|b| b.intervals(|copies| self.errors(&self.without_lost(copies))))
                    .map(Errors::from_array),
            }),
        };
        ModelSummary {
            lost_share: f64::from(lost) / f64::from(trials),
            errors,
            ess_mean: self.ess_mean,
            nees_mean: self.nees_mean,
            nees_with_shared_errors_mean: self.nees_with_shared_errors_mean,
            nees_intervals: self.nees_intervals,
            step_ms: self.step_ms,
            train,
            intervals: intervals
                .map(|errors| ModelIntervals { lost_share: share_interval(lost, trials), errors }),
            kept,
            localized,
        }
    }
}

/// The two figures of how large position errors are.
#[derive(Clone, Copy)]
enum Spread {
    /// RMSE.
    AboutTruth,
    /// Standard deviation.
    AboutMean,
}

impl Spread {
    fn of(self, sample: &Sample<'_>, copies: &[u32]) -> f64 {
        match self {
            Self::AboutTruth => sample.position_rmse(copies),
            Self::AboutMean => sample.position_std(copies),
        }
    }

    /// Its square at each step of the drive that all trials share, over those with copies.
    fn by_step(self, sample: &Sample<'_>, copies: &[u32]) -> Option<Vec<f64>> {
        let centre = match self {
            Self::AboutTruth => [0.0; 2],
            Self::AboutMean => [&sample.along, &sample.across].map(|of| Sample::pooled(of, copies).mean()),
        };
        let trials = sample.trials.iter().zip(copies).filter(|(_, copies)| **copies > 0);
        let trials: Vec<&ModelTrial> = trials.map(|(trial, _)| *trial).collect();
        drive::by_step(&trials, |row| {
            (row.error_along_m - centre[0]).powi(2) + (row.error_across_m - centre[1]).powi(2)
        })
    }
}

/// `spread` of `sample` over that of `base`, on the same trials; with `kept` on those that neither lost.
fn ratio(
    sample: &Sample<'_>,
    base: Option<&Sample<'_>>,
    kept: bool,
    bootstrap: Option<&Bootstrap>,
    spread: Spread,
) -> Option<Ratio> {
    let base = base?;
    let chosen = |copies: &[u32]| {
        if kept { base.without_lost(&sample.without_lost(copies)) } else { copies.to_vec() }
    };
    let of = |copies: &[u32]| {
        let copies = chosen(copies);
        [spread.of(sample, &copies) / spread.of(base, &copies)]
    };
    let all = vec![1; sample.lost.len()];
    let [value] = of(&all);
    if !value.is_finite() {
        return None;
    }
    let over_trials = bootstrap.and_then(|b| b.intervals(of)).map(|[interval]| interval);
    let interval = if drive::is_shared(&sample.trials) {
        let by_step = |of: &Sample<'_>| spread.by_step(of, &chosen(&all));
        by_step(sample).zip(by_step(base)).map(|(own, other)| {
            let factor = drive::factor_of_root_ratio(&own, &other);
            // A trial that is lost makes the filter's draws matter more than the drive.
            let Interval { lo, hi } = over_trials.unwrap_or(Interval { lo: value, hi: value });
            Interval { lo: lo.min(value / factor), hi: hi.max(value * factor) }
        })
    } else {
        over_trials
    };
    Some(Ratio { value, lo: interval.map(|i| i.lo), hi: interval.map(|i| i.hi) })
}
