//! One repeat: every model at every size, on states of its own.

use distreg::{Distribution, histogram_match, product};
use serde::{Deserialize, Serialize};

use super::Purpose;
use super::budget::thinned;
use super::data::{Test, data, score};
use super::loss_against_observations::losses;
use crate::model::folds;
use crate::results::{Sample, Samples};
use crate::sensor::{Sensor, Source};
use crate::{Study, StudyError, StudyOptions, families};

/// Predictions that are drawn.
const SAMPLES: usize = 3;

/// Results of one repeat; risks by model and size.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Repeat {
    pub risks: Vec<Vec<f64>>,
    pub crps: Vec<Vec<f64>>,
    pub bandwidths: Vec<Vec<Vec<f64>>>,
    /// Of each state coordinate, over the largest training set.
    pub spans: Vec<f64>,
    pub pooled: Vec<f64>,
    /// By way of choosing and budget.
    pub thinned: [Vec<f64>; 3],
    pub own: Option<f64>,
    pub losses: Vec<f64>,
    pub coefficient_of_truth: f64,
    pub truth_observations: f64,
    pub not_gaussian: f64,
    /// First coordinates of the other test states.
    pub gaussian_at: Vec<f64>,
    pub samples: Option<Samples>,
}

pub(super) fn run_repeat(
    study: &Study,
    number: usize,
    repeat: u32,
    options: &StudyOptions<'_>,
) -> Result<Repeat, StudyError> {
    let (data, tests) = data(study, number, repeat)?;
    let queries: Vec<f64> = tests.iter().flat_map(|test| test.state.iter().copied()).collect();
    let axes: Vec<&[f64]> = study.bandwidths.iter().map(Vec::as_slice).collect();
    let candidates = product(&axes);
    let models = study.models.len();
    let mut risks = vec![Vec::new(); models];
    let mut scores = vec![Vec::new(); models];
    let mut bandwidths = vec![Vec::new(); models];
    let mut pooled = Vec::new();
    let mut samples = Vec::new();
    for (place, &n) in study.states.iter().enumerate() {
        if options.control.is_interrupted() {
            return Err(StudyError::Interrupted);
        }
        let train = data.subset(&(0..n).collect::<Vec<_>>());
        let seed = study.draw(Purpose::Folds, repeat).seed(place as u32);
        let folds = folds(&study.setup, &train, study.folds, seed)?;
        for (m, model) in study.models.iter().enumerate() {
            let chosen = model.choose(&study.setup, &candidates, &folds, study.criterion)?;
            let predicted = model.predict(&study.setup, &train, &chosen, &queries)?;
            let (risk, score) = score(&predicted, &tests)?;
            risks[m].push(risk);
            scores[m].push(score);
            bandwidths[m].push(chosen);
            if repeat == 0 && place + 1 == study.states.len() {
                samples.push(predicted);
            }
        }
        let all: Vec<f64> = (0..n).flat_map(|i| train.observations(i).iter().copied()).collect();
        let all = study.histogram(&all)?;
        let loss = tests.iter().map(|test| histogram_match(&all, &test.truth)).sum::<Result<f64, _>>()?;
        pooled.push(loss / tests.len() as f64);
        options.control.progress.advance(1);
    }
    let thinned = thinned(study, repeat, &data, &tests, &queries, &candidates, &bandwidths)?;
    let (losses, coefficient_of_truth, truth_observations) = losses(study, number, repeat, &tests)?;
    let own = match &study.setup.conditions[number].source {
        Source::Simulated(sensor) => Some(own_risk(study, repeat, sensor.as_ref(), &tests)?),
        Source::Recorded(_) => None,
    };
    let gaussian_at: Vec<f64> = tests
        .iter()
        .filter(|test| !families::is_not_gaussian(&test.observed, &study.setup.outcomes.grid))
        .map(|test| test.state[0])
        .collect();
    let span = |d: usize| {
        let ends = ends((0..data.len()).map(|i| data.state(i)[d]));
        ends.map_or(0.0, |[lo, hi]| hi - lo)
    };
    Ok(Repeat {
        risks,
        crps: scores,
        bandwidths,
        spans: (0..data.dim()).map(span).collect(),
        pooled,
        thinned,
        own,
        losses,
        coefficient_of_truth,
        truth_observations,
        not_gaussian: 1.0 - gaussian_at.len() as f64 / tests.len() as f64,
        gaussian_at,
        samples: (repeat == 0)
            .then(|| pick_samples(&tests, &samples, study.states.last().copied().unwrap_or(0))),
    })
}

/// Mean loss of a histogram of M observations at the test states themselves.
fn own_risk(study: &Study, repeat: u32, sensor: &dyn Sensor, tests: &[Test]) -> Result<f64, StudyError> {
    let draw = study.draw(Purpose::Own, repeat);
    let count = study.observations.unwrap_or(1);
    let mut sum = 0.0;
    for (i, test) in tests.iter().enumerate() {
        let mut random = draw.item(i as u32);
        let own: Vec<f64> = (0..count).map(|_| sensor.observe(&test.state, &mut random)).collect();
        sum += histogram_match(&study.histogram(&own)?, &test.truth)?;
    }
    Ok(sum / tests.len() as f64)
}

/// The smallest and the largest of some values.
pub(super) fn ends(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values.map(|x| [x, x]).reduce(|[lo, hi], [x, _]| [lo.min(x), hi.max(x)])
}

/// Test states spread over the first coordinate.
fn pick_samples(tests: &[Test], predicted: &[Vec<Distribution>], training_states: usize) -> Samples {
    let mut order: Vec<usize> = (0..tests.len()).collect();
    order.sort_by(|&a, &b| tests[a].state[0].total_cmp(&tests[b].state[0]));
    let states = (0..SAMPLES.min(tests.len()))
        .map(|k| {
            let i = order[(2 * k + 1) * tests.len() / (2 * SAMPLES)];
            let test = &tests[i];
            let predicted = predicted.iter().map(|of_model| of_model[i].clone()).collect();
            Sample { state: test.state.clone(), truth: test.truth.clone(), predicted }
        })
        .collect();
    Samples { states, training_states }
}
