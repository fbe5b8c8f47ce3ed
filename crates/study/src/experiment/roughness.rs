//! How the distribution changes from a state to its neighbours (Fig. 3).

use distreg::{Distribution, histogram_match};
use rayon::prelude::*;

use super::Purpose;
use crate::results::Roughness;
use crate::sensor::{Condition, Source};
use crate::{Kind, Study, StudyError};

/// Pairs of states behind each distance of a roughness.
const PAIRS: u32 = 60;
/// Distances of neighbouring states, as shares of the span of a state coordinate.
const STEPS: [f64; 12] = [1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.4];

/// How the distribution changes along a state of one coordinate; `None` for other studies.
pub(super) fn roughness(study: &Study, condition: &Condition) -> Result<Option<Roughness>, StudyError> {
    let (Source::Simulated(sensor), 1) = (&condition.source, study.setup.coordinates.len()) else {
        return Ok(None);
    };
    let draw = study.draw(Purpose::Roughness, 0);
    let starts: Vec<f64> = (0..PAIRS).map(|i| sensor.state(&mut draw.item(i))[0]).collect();
    let (lo, hi) =
        starts.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), &x| (lo.min(x), hi.max(x)));
    let middle = 0.5 * (lo + hi);
    let truth = |x: f64, step: u32, i: u32| -> Result<Distribution, StudyError> {
        let mut random = draw.at(step).item(i);
        let observed: Vec<f64> =
            (0..study.truth_observations).map(|_| sensor.observe(&[x], &mut random)).collect();
        study.histogram(&observed)
    };
    let truths: Vec<Distribution> = starts
        .par_iter()
        .enumerate()
        .map(|(i, &x)| truth(x, 1, i as u32))
        .collect::<Result<_, StudyError>>()?;
    let mut roughness =
        Roughness { distance: Vec::new(), loss: Vec::new(), unrelated: 0.0, half_distance: f64::NAN };
    for (k, share) in STEPS.into_iter().enumerate() {
        let distance = share * (hi - lo);
        let losses = starts
            .par_iter()
            .enumerate()
            .map(|(i, &x)| {
                // Towards the middle, or the state would leave its span.
                let other = if x < middle { x + distance } else { x - distance };
                Ok(histogram_match(&truths[i], &truth(other, k as u32 + 2, i as u32)?)?)
            })
            .collect::<Result<Vec<f64>, StudyError>>()?;
        roughness.distance.push(distance);
        roughness.loss.push(losses.iter().sum::<f64>() / losses.len() as f64);
    }
    let pairs = truths.len() / 2;
    for i in 0..pairs {
        roughness.unrelated += histogram_match(&truths[i], &truths[i + pairs])? / pairs as f64;
    }
    let half = 0.5 * roughness.unrelated;
    if let Some(k) = roughness.loss.iter().position(|loss| *loss >= half) {
        roughness.half_distance = match k.checked_sub(1) {
            None => roughness.distance[0],
            Some(before) => {
                let share = (half - roughness.loss[before]) / (roughness.loss[k] - roughness.loss[before]);
                roughness.distance[before] + share * (roughness.distance[k] - roughness.distance[before])
            }
        };
    }
    Ok(Some(roughness))
}

/// True distributions at neighbouring places of the grass.
pub(super) fn neighbours(study: &Study) -> Result<Vec<(f64, Distribution)>, StudyError> {
    let (Kind::Grass, Source::Simulated(sensor)) = (study.kind, &study.setup.conditions[0].source) else {
        return Ok(Vec::new());
    };
    let draw = study.draw(Purpose::Roughness, 1);
    let start = sensor.state(&mut draw.item(0))[0];
    [0.0, 0.01, 0.02]
        .into_iter()
        .enumerate()
        .map(|(i, distance)| {
            let mut random = draw.item(i as u32 + 1);
            let observed: Vec<f64> = (0..study.truth_observations)
                .map(|_| sensor.observe(&[start + distance], &mut random))
                .collect();
            Ok((distance, study.histogram(&observed)?))
        })
        .collect()
}
