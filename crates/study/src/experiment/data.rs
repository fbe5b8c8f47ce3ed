//! Training and test states of a repeat.

use distreg::{Dataset, Distribution, histogram_match};
use locsim_core::Draw;

use super::Purpose;
use crate::sensor::{Sensor, Source};
use crate::{Study, StudyError};

/// A test state with its true distribution.
pub(super) struct Test {
    pub state: Vec<f64>,
    pub truth: Distribution,
    /// The observations that the truth was made of, or a share of them.
    pub observed: Vec<f64>,
}

/// Training states of a repeat, the largest set; smaller ones are its beginnings, so that a curve over N compares like
/// with like. And the test states, which aren't among them.
pub(super) fn data(study: &Study, number: usize, repeat: u32) -> Result<(Dataset, Vec<Test>), StudyError> {
    let most = study.states.last().copied().unwrap_or(0);
    let training = study.draw(Purpose::Training, repeat);
    match &study.setup.conditions[number].source {
        Source::Simulated(sensor) => {
            let count = study.observations.unwrap_or(1);
            let mut data = Dataset::new(study.setup.coordinates.len());
            for i in 0..most as u32 {
                let (state, observations) = observe(sensor.as_ref(), training, i, count);
                data.push(&state, &observations)?;
            }
            let test = study.draw(Purpose::Test, repeat);
            let tests = (0..study.test_states as u32)
                .map(|i| {
                    let (state, mut observed) = observe(sensor.as_ref(), test, i, study.truth_observations);
                    let truth = study.histogram(&observed)?;
                    observed.truncate(1000);
                    Ok(Test { state, truth, observed })
                })
                .collect::<Result<_, StudyError>>()?;
            Ok((data, tests))
        }
        Source::Recorded(recorded) => {
            let order = shuffled(recorded.len(), training, 0);
            let (tests, train) = order.split_at(study.test_states);
            let tests = tests
                .iter()
                .map(|&i| {
                    let observed = recorded.observations(i).to_vec();
                    Ok(Test {
                        state: recorded.state(i).to_vec(),
                        truth: study.histogram(&observed)?,
                        observed,
                    })
                })
                .collect::<Result<_, StudyError>>()?;
            let mut data = Dataset::new(recorded.dim());
            for &i in &train[..most] {
                let observations = recorded.observations(i);
                let count = study.observations.unwrap_or(usize::MAX).min(observations.len());
                let chosen = shuffled(observations.len(), training, i as u32 + 1);
                let observations: Vec<f64> = chosen[..count].iter().map(|&j| observations[j]).collect();
                data.push(recorded.state(i), &observations)?;
            }
            Ok((data, tests))
        }
    }
}

/// State number `i` of a draw, and `count` observations at it.
fn observe(sensor: &dyn Sensor, draw: Draw, i: u32, count: usize) -> (Vec<f64>, Vec<f64>) {
    let mut random = draw.item(i);
    let state = sensor.state(&mut random);
    let observations = (0..count).map(|_| sensor.observe(&state, &mut random)).collect();
    (state, observations)
}

/// 0..n in random order.
pub(super) fn shuffled(n: usize, draw: Draw, item: u32) -> Vec<usize> {
    use rand::seq::SliceRandom;
    let mut order: Vec<usize> = (0..n).collect();
    order.shuffle(&mut draw.item(item));
    order
}

/// Mean histogram match (bins) and mean CRPS (units of z) of predictions at the test states.
pub(super) fn score(predicted: &[Distribution], tests: &[Test]) -> Result<(f64, f64), StudyError> {
    let (mut risk, mut crps) = (0.0, 0.0);
    for (predicted, test) in predicted.iter().zip(tests) {
        risk += histogram_match(predicted, &test.truth)?;
        crps += distreg::crps(predicted, &test.observed);
    }
    let n = tests.len() as f64;
    Ok((risk / n, crps / n))
}
