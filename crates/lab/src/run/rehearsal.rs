//! Short localizations on the training scans of a log, which tell how sure a sensor model may make the filter.
//!
//! Held-out scans one by one show how the beams of a scan depend on each other. They don't show how scans do: what the map
//! lacks, scan after scan sees the same way. A filter that takes them as independent is too sure of its pose, and few of its
//! particles are effective. The normalized estimation error squared (NEES; Bar-Shalom, Li and Kirubarajan, "Estimation
//! with Applications to Tracking and Navigation", 2001, section 5.4) of a drive shows both.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use locsim_core::{
    DependsOn, Draw, Drive, DriveStep, EndpointGrid, LikelihoodGrid, Pose2, RangeMap, SensorModel, Stage,
    wrap_angle,
};
use locsim_mcl::{Estimate, Filter, Spread, Start, StepInput};
use locsim_scenario as scenario;
use locsim_sensor::{Prepared, Tempered};
use rayon::prelude::*;

use super::filter::options;
use crate::LabError;

/// A consistent filter has a NEES of the number of its dimensions on average.
const DIMENSIONS: f64 = 3.0;

/// Exponents that are tried, upwards.
const EXPONENTS: [f64; 12] = [0.02, 0.03, 0.04, 0.055, 0.075, 0.1, 0.14, 0.2, 0.28, 0.4, 0.57, 0.8];

/// Stretches are repeated with other draws until there are this many steps: their errors come in runs, and a few tens of
/// steps would leave the mean to chance.
const STEPS: usize = 200;

/// Spread of the start where the scenario's filter starts anywhere: an exponent is that of a filter that has gathered.
pub(crate) const START: Spread = Spread { sigma_m: 0.1, sigma_rad: 0.05 };

/// Stretches with fewer steps than this in all tell nothing.
const FEWEST_STEPS: usize = 10;

/// Least deviations of an estimate: 1 mm and 0.05 degrees, far below what any reference pose is good for. Particles that
/// are all copies of one have none of their own.
const LEAST_SIGMA: [f64; 3] = [1e-3, 1e-3, 1e-3];

/// The normalized estimation error squared of a pose: e^T C^-1 e over (x, y, heading).
pub(super) fn nees(estimate: &Estimate, truth: Pose2) -> f64 {
    let difference = estimate.pose.position() - truth.position();
    let error = DVec3::new(difference.x, difference.y, wrap_angle(estimate.pose.theta - truth.theta));
    let floor = DMat3::from_diagonal(DVec3::from_array(LEAST_SIGMA.map(|sigma| sigma * sigma)));
    // Symmetric, so that rows are columns.
    let covariance = DMat3::from_cols_array_2d(&estimate.covariance) + floor;
    error.dot(covariance.inverse() * error)
}

/// Stretches of a drive that no trial localizes on, and the filter of the trials.
pub struct Rehearsal<'a> {
    filter: &'a scenario::Filter,
    map: Arc<dyn RangeMap>,
    stretches: Vec<Drive>,
    seed: u64,
}

/// Keeps the steps of a stretch from the first with a reference pose to the last before one without.
pub(super) fn keep_referenced(stretch: &mut Drive) {
    let known = |step: &DriveStep| step.reference.is_some();
    let first = stretch.steps.iter().position(known).unwrap_or(stretch.steps.len());
    stretch.steps.drain(..first);
    let end = stretch.steps.iter().position(|step| !known(step)).unwrap_or(stretch.steps.len());
    stretch.steps.truncate(end);
}

/// The exponent that a rehearsal chose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rehearsed {
    pub exponent: f64,
    /// Mean NEES with it.
    pub nees: f64,
}

impl<'a> Rehearsal<'a> {
    /// Localizes on each of the `stretches`, as far as its scans have reference poses, from the first of these on. `None` where
    /// there are too few steps.
    pub(super) fn new(
        filter: &'a scenario::Filter,
        mut stretches: Vec<Drive>,
        map: Arc<dyn RangeMap>,
        seed: u64,
    ) -> Option<Self> {
        stretches.iter_mut().for_each(keep_referenced);
        let steps: usize = stretches.iter().map(|stretch| stretch.steps.len()).sum();
        (steps >= FEWEST_STEPS).then_some(Self { filter, map, stretches, seed })
    }

    /// The greatest exponent with which the filter's own covariance accounts for its errors: up to it, the mean NEES of the
    /// stretches is no more than a consistent filter's. The least that is tried, if there is none.
    ///
    /// # Errors
    /// [`LabError`] for a filter that gives up.
    pub(super) fn choose(
        &self,
        model: &Arc<dyn SensorModel>,
        floor: f64,
        tables: Option<(LikelihoodGrid, &EndpointGrid)>,
    ) -> Result<Rehearsed, LabError> {
        let failed = |source| LabError::TrainingData { source };
        let tempered = |exponent: f64| -> Result<Arc<dyn SensorModel>, LabError> {
            Ok(Arc::new(Tempered::new(Arc::clone(model), floor, exponent).map_err(failed)?))
        };
        let mut last = EXPONENTS[0];
        let mut prepared = match tables {
            Some((states, endpoints)) if model.depends_on() != DependsOn::Everything => {
                Some(Prepared::new(tempered(last)?, states, endpoints).map_err(failed)?)
            }
            _ => None,
        };
        let mut chosen: Option<Rehearsed> = None;
        for exponent in EXPONENTS {
            let tempered = tempered(exponent)?;
            prepared = prepared.map(|table| table.scaled(Arc::clone(&tempered), exponent / last));
            last = exponent;
            let nees = match &prepared {
                Some(prepared) => self.mean_nees(prepared)?,
                None => self.mean_nees(&*tempered)?,
            };
            if nees > DIMENSIONS && chosen.is_some() {
                break;
            }
            chosen = Some(Rehearsed { exponent, nees });
            if nees > DIMENSIONS {
                break;
            }
        }
        Ok(chosen.expect("one exponent has been tried"))
    }

    fn mean_nees(&self, model: &dyn SensorModel) -> Result<f64, LabError> {
        let steps: usize = self.stretches.iter().map(|stretch| stretch.steps.len()).sum();
        let repeats = STEPS.div_ceil(steps) as u32;
        let sums: Vec<f64> = (0..repeats)
            .into_par_iter()
            .map(|repeat| {
                self.stretches
                    .iter()
                    .zip(0..)
                    .map(|(stretch, i)| {
                        let seed = Draw::new(self.seed, Stage::Training, 2 + i).seed(repeat);
                        self.sum_of_nees(stretch, model, seed)
                    })
                    .sum::<Result<f64, _>>()
            })
            .collect::<Result<_, _>>()?;
        Ok(sums.iter().sum::<f64>() / (steps * repeats as usize) as f64)
    }

    fn sum_of_nees(&self, drive: &Drive, model: &dyn SensorModel, seed: u64) -> Result<f64, LabError> {
        let Some(pose) = drive.steps.first().and_then(|step| step.reference) else { return Ok(0.0) };
        let spread = match self.filter.start {
            scenario::Start::Tracking(spread) | scenario::Start::Around(_, spread) => spread,
            scenario::Start::Global => START,
        };
        let start = Start::Tracking { pose, spread };
        let mut filter = Filter::new(options(self.filter, false)?, &start, &*self.map, seed)?;
        let mut sum = 0.0;
        for (i, step) in drive.steps.iter().enumerate() {
            let input =
                StepInput { odometry: drive.odometry_increment(i), laser: &drive.laser, scan: &step.scan };
            let outcome = filter.step(&input, &*self.map, model)?;
            if let Some(truth) = step.reference {
                sum += nees(&outcome.estimates.weighted_mean, truth);
            }
        }
        Ok(sum)
    }
}
