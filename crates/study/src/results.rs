//! Results of a study: the content of `results.json`.

use distreg::Distribution;
use locsim_core::Interval;
use serde::{Deserialize, Serialize};

/// Everything a study finds.
#[derive(Clone, Debug, Serialize)]
pub struct Results {
    /// The study's name.
    pub study: String,
    /// The sensor, as in the study's file.
    pub sensor: &'static str,
    /// The seed.
    pub seed: u64,
    /// Number of repeats, each with its own training and test states.
    pub repeats: u32,
    /// Whether `--quick` cut the study down.
    pub quick: bool,
    /// Values B that the sensor can report.
    pub bins: usize,
    /// Distance of two values, in the sensor's unit.
    pub bin_width: f64,
    /// Per condition, such as still surroundings.
    pub conditions: Vec<ConditionResults>,
    /// The two losses on the paper's example of Fig. 5.
    pub losses: LossExample,
    /// Families of distributions on the rays of a static lidar.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub families: Option<Families>,
    /// The paper's statements beside the findings.
    pub claims: Vec<Claim>,
}

/// A quantity over another: mean over repeats, and the range of the middle 80 % of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Curve {
    /// Numbers of states or observations.
    pub at: Vec<f64>,
    /// Mean over repeats.
    pub mean: Vec<f64>,
    /// 10 % quantile over repeats.
    pub lo: Vec<f64>,
    /// 90 % quantile over repeats.
    pub hi: Vec<f64>,
}

impl Curve {
    /// The same in another unit.
    #[must_use]
    pub fn times(&self, factor: f64) -> Self {
        let scaled = |values: &[f64]| values.iter().map(|v| v * factor).collect();
        Self { at: self.at.clone(), mean: scaled(&self.mean), lo: scaled(&self.lo), hi: scaled(&self.hi) }
    }
}

/// Results under one condition.
#[derive(Clone, Debug, Serialize)]
pub struct ConditionResults {
    /// The condition.
    pub condition: String,
    /// Share of the test states whose observations a test of level 1 % tells from a Gaussian.
    pub not_gaussian_share: f64,
    /// Observations behind each of these tests, on average.
    pub not_gaussian_observations: f64,
    /// Smallest and largest first coordinate of the test states, of all repeats, that the test doesn't tell from a Gaussian;
    /// absent where it tells all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gaussian_between: Option<[f64; 2]>,
    /// Span of each state coordinate over the largest training set, mean over repeats.
    pub spans: Vec<f64>,
    /// Loss of a histogram of M observations against M (Fig. 7).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub loss_against_observations: Option<LossAgainstObservations>,
    /// Risk of each model against N, in bins (Fig. 8).
    pub risks: Vec<ModelRisk>,
    /// Risk of the histogram of all training observations, whatever their state: what a model that learns nothing of
    /// the state has.
    pub pooled_risk: Curve,
    /// Risk of a histogram of M observations at the test state itself; simulated sensors only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_histogram_risk: Option<f64>,
    /// Risk of a model whose training states were chosen from the largest set within a budget, against the budget.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thinning: Option<Thinning>,
    /// How the distribution changes with the state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness: Option<Roughness>,
}

/// Loss of a histogram of M observations, in bins.
#[derive(Clone, Debug, Serialize)]
pub struct LossAgainstObservations {
    /// Against M, over all test states.
    pub loss: Curve,
    /// The threshold of the paper, in bins.
    pub threshold: f64,
    /// M at which the mean loss falls to the threshold, interpolated; absent where no M of the study reaches it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub needed: Option<f64>,
    /// c of the law c sqrt(1/M + 1/M0) that the losses follow, M0 the observations behind the truth, in bins.
    pub coefficient: f64,
    /// M0: observations behind the truth, on average.
    pub truth_observations: f64,
    /// M at which that law falls to the threshold, with a truth that is known exactly.
    pub needed_by_law: f64,
    /// c as it follows from the true distributions: sqrt(2 / pi) times the sum of sqrt(F (1 - F)) over bins.
    pub coefficient_of_truth: f64,
    /// Standard deviation of a Gaussian with the same c, in bins.
    pub equivalent_sigma: f64,
}

impl LossAgainstObservations {
    /// The law's value for M observations.
    pub fn reading(&self, observations: f64) -> f64 {
        self.coefficient * (1.0 / observations + 1.0 / self.truth_observations).sqrt()
    }
}

/// Risk of one model.
#[derive(Clone, Debug, Serialize)]
pub struct ModelRisk {
    /// The model.
    pub model: &'static str,
    /// Histogram match against N, in bins.
    pub risk: Curve,
    /// Continuous ranked probability score against N, in the unit of z.
    pub crps: Curve,
    /// Median over repeats of the bandwidth chosen for each state coordinate, at each N.
    pub bandwidths: Vec<Vec<f64>>,
    /// Share of repeats in which a chosen bandwidth was the first or the last of its list, at each N. A last one of ten spans
    /// of its coordinate and more is no end: the coordinate then doesn't count.
    pub at_end_share: Vec<f64>,
    /// Risk relative to the first model's, at each N, with 95 % bootstrap intervals over repeats (paired).
    pub ratio: Vec<f64>,
    /// Intervals of the ratios; absent for a single repeat.
    pub ratio_intervals: Vec<Option<Interval>>,
}

/// Risk against a budget of training states, in bins.
#[derive(Clone, Debug, Serialize)]
pub struct Thinning {
    /// The model.
    pub model: &'static str,
    /// States in the order of the draw: what the model's own curve over N shows.
    pub random: Curve,
    /// Each time the state farthest from those chosen.
    pub farthest_first: Curve,
    /// By kernel herding.
    pub herding: Curve,
    /// As `farthest_first`, each state with the observations of all states that are nearest to it, aligned.
    pub condensed: Curve,
}

/// Loss between the true distributions of two states, against their distance.
#[derive(Clone, Debug, Serialize)]
pub struct Roughness {
    /// Distances, in the unit of the first state coordinate.
    pub distance: Vec<f64>,
    /// Mean loss, in bins.
    pub loss: Vec<f64>,
    /// Mean loss of two states at random, in bins.
    pub unrelated: f64,
    /// Distance at which the loss has half of that.
    pub half_distance: f64,
}

/// The paper's Fig. 5: a reference histogram and two predictions, one near, one far.
#[derive(Clone, Debug, Serialize)]
pub struct LossExample {
    /// Histogram match of the near and the far prediction, in bins.
    pub histogram_match: [f64; 2],
    /// Euclidean distance of the same.
    pub euclidean: [f64; 2],
}

/// Families of distributions on rays.
#[derive(Clone, Debug, Serialize)]
pub struct Families {
    /// Rays.
    pub rays: usize,
    /// Rays that a test of level 1 % tells from a Gaussian.
    pub not_gaussian: usize,
    /// Each family.
    pub families: Vec<FamilyResults>,
    /// Mean over the rays that aren't Gaussian of the log loss of the Gaussian minus that of the kernel density, in
    /// nats per reading.
    pub kernel_density_gain: f64,
    /// Its 95 % bootstrap interval over rays.
    pub kernel_density_gain_interval: Option<Interval>,
}

/// One family.
#[derive(Clone, Debug, Serialize)]
pub struct FamilyResults {
    /// Its name.
    pub family: &'static str,
    /// Mean log loss over rays on held-out readings, in nats per reading (densities per unit of z).
    pub log_loss: f64,
    /// Rays on which it has the smallest log loss of all families.
    pub best: usize,
    /// Rays on which it has the smallest log loss of the parametric families; absent for the kernel density.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub best_parametric: Option<usize>,
}

/// A statement of the paper and what was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Claim {
    /// Figure of the paper.
    pub figure: &'static str,
    /// Name of our figure.
    pub ours: &'static str,
    /// The paper's statement.
    pub paper: &'static str,
    /// The finding from the numbers.
    pub finding: String,
    /// Whether it holds.
    pub verdict: Verdict,
    /// Why.
    pub reason: String,
}

/// Whether a statement holds here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It does.
    Reproduced,
    /// A part of it does.
    Partly,
    /// It doesn't.
    Not,
}

impl Verdict {
    /// In words.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Reproduced => "reproduced",
            Self::Partly => "partly",
            Self::Not => "not reproduced",
        }
    }

    /// Of a statement with two parts.
    pub fn of(first: bool, second: bool) -> Self {
        match (first, second) {
            (true, true) => Self::Reproduced,
            (false, false) => Self::Not,
            _ => Self::Partly,
        }
    }
}

/// Distributions at some test states.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Samples {
    /// States with the truth and each model's prediction from the largest training set.
    pub states: Vec<Sample>,
    /// Training states of that set.
    pub training_states: usize,
}

/// One test state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Sample {
    /// The state.
    pub state: Vec<f64>,
    /// The distribution of many observations there.
    pub truth: Distribution,
    /// The prediction of each model.
    pub predicted: Vec<Distribution>,
}
