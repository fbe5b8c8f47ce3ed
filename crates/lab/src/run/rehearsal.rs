//! Short localizations on the training scans of a log, which tell how sure a sensor model may make the filter.
//!
//! Held-out scans one by one show how the beams of a scan depend on each other. They don't show how scans do: what the map
//! lacks, scan after scan sees the same way. A filter that takes them as independent is too sure of its pose, and few of its
//! particles are effective. The log density of the reference poses under the filter's own estimates shows both (Gneiting and Raftery,
//! "Strictly Proper Scoring Rules, Prediction, and Estimation", 2007). A normalized estimation error squared (NEES; Bar-Shalom, Li and
//! Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4) that is right alone may be had by a filter
//! that learns little from its scans: errors and covariance are both large then.

use std::sync::Arc;

use glam::{DMat3, DVec3};
use locsim_core::{
    DependsOn, Draw, Drive, DriveStep, EndpointGrid, Hits, Laser, LikelihoodGrid, Particles, Pose2, RangeMap,
    Scan, SensorModel, Stage, wrap_angle,
};
use locsim_mcl::{Estimate, Filter, Spread, Start, StepInput};
use locsim_report::statistics::quantile;
use locsim_scenario as scenario;
use locsim_sensor::{Prepared, Tempered};
use rayon::prelude::*;

use super::filter::options;
use crate::LabError;

/// Exponents that are tried: from [`FIRST`] upwards, and downwards where none above it is better.
const EXPONENTS: [f64; 12] = [0.02, 0.03, 0.04, 0.055, 0.075, 0.1, 0.14, 0.2, 0.28, 0.4, 0.57, 0.8];

/// The first of them that is tried: on measured logs, models have 0.04 to 0.8.
const FIRST: usize = 7;

/// Either way exponents are tried until so many in a row are worse than the best.
const MOST_WORSE: u32 = 2;

/// Stretches are repeated with other draws until there are this many steps: their errors come in runs, and a few tens of
/// steps would leave the mean to chance.
const STEPS: usize = 200;

/// Spread of the start where the scenario's filter starts anywhere: an exponent is that of a filter that has gathered.
pub const START: Spread = Spread { sigma_m: 0.1, sigma_rad: 0.05 };

/// Stretches with fewer steps than this in all tell nothing.
const FEWEST_STEPS: usize = 10;

/// Least deviations of an estimate: 1 mm and 0.05 degrees, far below what any reference pose is good for. Particles that
/// are all copies of one have none of their own.
const LEAST_SIGMA: [f64; 3] = [1e-3, 1e-3, 1e-3];

/// Deviations that are tried for the errors that scans share \[m\] and \[rad\].
const SHARED_M: [f64; 9] = [0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08];
const SHARED_RAD: [f64; 6] = [0.0, 0.002, 0.005, 0.01, 0.02, 0.04];

/// The error of an estimate and the filter's own covariance, over (x, y, heading).
#[derive(Clone, Copy, Debug)]
pub(super) struct PoseError {
    error: DVec3,
    covariance: DMat3,
}

impl PoseError {
    pub(super) fn of(estimate: &Estimate, truth: Pose2) -> Self {
        let difference = estimate.pose.position() - truth.position();
        let error = DVec3::new(difference.x, difference.y, wrap_angle(estimate.pose.theta - truth.theta));
        let floor = DMat3::from_diagonal(DVec3::from_array(LEAST_SIGMA.map(|sigma| sigma * sigma)));
        // Symmetric, so that rows are columns.
        Self { error, covariance: DMat3::from_cols_array_2d(&estimate.covariance) + floor }
    }

    /// The normalized estimation error squared e^T C^-1 e, and ln det C, with the covariance of shared errors in C.
    fn normalized(&self, shared: Spread) -> (f64, f64) {
        let Spread { sigma_m, sigma_rad } = shared;
        let [position, heading] = [sigma_m * sigma_m, sigma_rad * sigma_rad];
        let covariance = self.covariance + DMat3::from_diagonal(DVec3::new(position, position, heading));
        (self.error.dot(covariance.inverse() * self.error), covariance.determinant().ln())
    }

    /// The normalized estimation error squared.
    pub(super) fn nees(&self, shared: Spread) -> f64 {
        self.normalized(shared).0
    }

    /// -2 ln of the normal density of the error, without its constant.
    fn deviance(&self, shared: Spread) -> f64 {
        let (nees, log_determinant) = self.normalized(shared);
        nees + log_determinant
    }
}

/// The deviations of shared errors under which `errors` are likeliest.
fn shared_errors(errors: &[PoseError]) -> Spread {
    let spreads =
        SHARED_M.iter().flat_map(|&sigma_m| SHARED_RAD.map(|sigma_rad| Spread { sigma_m, sigma_rad }));
    spreads
        .map(|shared| (mean(errors.iter().map(|error| error.deviance(shared))), shared))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(Spread::default, |(_, shared)| shared)
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// Tries exponents in order until [`MOST_WORSE`] in a row have a greater deviance than the best.
fn climb<T>(
    best: &mut (f64, f64, T),
    exponents: impl Iterator<Item = f64>,
    tried: &mut impl FnMut(f64) -> Result<(f64, f64, T), LabError>,
) -> Result<(), LabError> {
    let mut worse = 0;
    for exponent in exponents {
        let next = tried(exponent)?;
        if next.0 < best.0 {
            *best = next;
            worse = 0;
        } else {
            worse += 1;
            if worse == MOST_WORSE {
                break;
            }
        }
    }
    Ok(())
}

/// What `tried` makes of the exponent with the least deviance, and that exponent: (deviance, exponent, ..).
fn least<T>(
    mut tried: impl FnMut(f64) -> Result<(f64, f64, T), LabError>,
) -> Result<(f64, f64, T), LabError> {
    let mut best = tried(EXPONENTS[FIRST])?;
    climb(&mut best, EXPONENTS[FIRST + 1..].iter().copied(), &mut tried)?;
    if best.1 <= EXPONENTS[FIRST] {
        climb(&mut best, EXPONENTS[..FIRST].iter().rev().copied(), &mut tried)?;
    }
    Ok(best)
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
    /// Deviations of the errors that scans share: those of map and reference, which the filter's covariance doesn't have.
    pub shared: Spread,
    /// Mean NEES of the filter's own covariance, with the exponent.
    pub nees: f64,
    /// The log density that [`USUAL`] of the scans exceed \[nats per reading\].
    pub scan_log_density_nats: f64,
}

/// Share of the scans of a robot that isn't lost whose log density is usual.
const USUAL: f64 = 0.99;

/// The mean log density of a scan's readings from a pose, `map_from_base` \[nats per reading\]; NaN without usable readings.
pub(super) fn scan_log_density(
    model: &dyn SensorModel,
    map: &dyn RangeMap,
    laser: &Laser,
    scan: &Scan,
    pose: Pose2,
) -> f64 {
    let laser_pose: Particles = std::iter::once(pose.compose(&laser.base_from_laser())).collect();
    let mut hits = Hits::default();
    map.cast(laser_pose.as_poses(), laser.bearings(), laser.cast_range(), &mut hits);
    let mut log_density = vec![0.0; laser.beam_count()];
    let beams = hits.beams(laser_pose.as_poses(), laser.bearings(), laser.max_range());
    model.log_density(&scan.ranges, &beams, &mut log_density);
    log_density.into_iter().map(f64::from).sum::<f64>() / scan.usable() as f64
}

/// What a localization on the stretches shows, step by step.
#[derive(Default)]
struct Steps {
    errors: Vec<PoseError>,
    /// Nats per reading.
    scan_log_density: Vec<f64>,
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

    /// The exponent under which the reference poses are likeliest, each normal about the filter's estimate with the filter's own
    /// covariance. That score is proper: it counts how large the errors are as well as whether the covariance accounts for them. With it,
    /// the deviations of shared errors under which they are likeliest, and the model's table, where there are tables. `floored` is the model as scans
    /// are judged by it.
    ///
    /// # Errors
    /// [`LabError`] for a filter that gives up.
    pub(super) fn choose(
        &self,
        model: &Arc<dyn SensorModel>,
        floored: &dyn SensorModel,
        floor: f64,
        tables: Option<(LikelihoodGrid, &EndpointGrid)>,
    ) -> Result<(Rehearsed, Option<Prepared>), LabError> {
        let failed = |source| LabError::TrainingData { source };
        let tempered = |exponent: f64| -> Result<Arc<dyn SensorModel>, LabError> {
            Ok(Arc::new(Tempered::new(Arc::clone(model), floor, exponent).map_err(failed)?))
        };
        let mut last = EXPONENTS[FIRST];
        let mut prepared = match tables {
            Some((states, endpoints)) if model.depends_on() != DependsOn::Everything => {
                Some(Prepared::new(tempered(last)?, states, endpoints).map_err(failed)?)
            }
            _ => None,
        };
        let tried = |exponent: f64| -> Result<(f64, f64, Steps), LabError> {
            let tempered = tempered(exponent)?;
            let table = prepared.take().map(|table| table.scaled(Arc::clone(&tempered), exponent / last));
            last = exponent;
            let steps = match &table {
                Some(prepared) => self.steps(prepared, floored)?,
                None => self.steps(&*tempered, floored)?,
            };
            prepared = table;
            Ok((mean(steps.errors.iter().map(|error| error.deviance(Spread::default()))), exponent, steps))
        };
        let (_, exponent, Steps { errors, mut scan_log_density }) = least(tried)?;
        let shared = shared_errors(&errors);
        let nees = mean(errors.iter().map(|error| error.nees(Spread::default())));
        scan_log_density.sort_by(f64::total_cmp);
        let scan_log_density_nats = quantile(&scan_log_density, 1.0 - USUAL);
        let chosen = tempered(exponent)?;
        let prepared = prepared.map(|table| table.scaled(chosen, exponent / last));
        Ok((Rehearsed { exponent, shared, nees, scan_log_density_nats }, prepared))
    }

    /// All steps of all stretches and their repeats.
    fn steps(&self, model: &dyn SensorModel, floored: &dyn SensorModel) -> Result<Steps, LabError> {
        let steps: usize = self.stretches.iter().map(|stretch| stretch.steps.len()).sum();
        let repeats = STEPS.div_ceil(steps) as u32;
        let parts: Vec<Steps> = (0..repeats)
            .into_par_iter()
            .map(|repeat| {
                let mut steps = Steps::default();
                for (stretch, i) in self.stretches.iter().zip(0..) {
                    let seed = Draw::new(self.seed, Stage::Training, 2 + i).seed(repeat);
                    self.localize(stretch, model, floored, seed, &mut steps)?;
                }
                Ok(steps)
            })
            .collect::<Result<_, LabError>>()?;
        let mut all = Steps::default();
        for part in parts {
            all.errors.extend(part.errors);
            all.scan_log_density.extend(part.scan_log_density);
        }
        Ok(all)
    }

    /// Localizes on one stretch and adds its steps.
    fn localize(
        &self,
        drive: &Drive,
        model: &dyn SensorModel,
        floored: &dyn SensorModel,
        seed: u64,
        steps: &mut Steps,
    ) -> Result<(), LabError> {
        let Some(pose) = drive.steps.first().and_then(|step| step.reference) else { return Ok(()) };
        let spread = match self.filter.start {
            scenario::Start::Tracking(spread) | scenario::Start::Around(_, spread) => spread,
            scenario::Start::Global => START,
        };
        let start = Start::Tracking { pose, spread };
        let map = &*self.map;
        let mut filter = Filter::new(options(self.filter, false)?, &start, map, seed)?;
        for (i, step) in drive.steps.iter().enumerate() {
            let input =
                StepInput { odometry: drive.odometry_increment(i), laser: &drive.laser, scan: &step.scan };
            let outcome = filter.step(&input, map, model)?;
            let estimate = outcome.estimates.weighted_mean;
            // A robot that stands has one error, however often it is looked at.
            let Some(truth) = step.reference.filter(|_| outcome.likelihood_power > 0.0) else { continue };
            steps.errors.push(PoseError::of(&estimate, truth));
            steps.scan_log_density.push(scan_log_density(
                floored,
                map,
                &drive.laser,
                &step.scan,
                estimate.pose,
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// Wherever the least deviance is, it is found, and two exponents on either side are tried in vain at most.
    #[test]
    fn the_exponent_of_the_least_deviance_is_found() {
        for (at, &wanted) in EXPONENTS.iter().enumerate() {
            let mut asked = Vec::new();
            let (_, found, ()) = least(|exponent| {
                asked.push(exponent);
                Ok(((exponent / wanted).ln().abs(), exponent, ()))
            })
            .unwrap();
            assert_eq!(found, wanted);
            let way = FIRST.abs_diff(at);
            assert!(asked.len() <= way + 5, "{asked:?} for {wanted}");
            asked.sort_by(f64::total_cmp);
            assert!(asked.is_sorted_by(|a, b| a < b), "each once: {asked:?}");
        }
    }

    /// An error of 3 cm with a deviation of 1 cm: 9, and a mean of 9 / (1 + 8) with 8 cm^2 of shared errors.
    #[test]
    fn errors_that_scans_share_are_added_to_the_covariance() {
        let variance = 1e-4 - LEAST_SIGMA[0] * LEAST_SIGMA[0];
        let mut estimate = Estimate { pose: Pose2::new(0.03, 0.0, 0.0), covariance: [[0.0; 3]; 3] };
        for i in 0..3 {
            estimate.covariance[i][i] = variance;
        }
        let error = PoseError::of(&estimate, Pose2::IDENTITY);
        assert!((error.nees(Spread::default()) - 9.0).abs() < 1e-9);
        let shared = Spread { sigma_m: 8e-4_f64.sqrt(), sigma_rad: 0.0 };
        assert!((error.nees(shared) - 1.0).abs() < 1e-9);
        // More than the error asks for is unlikely, too.
        let deviance = |sigma_m: f64| error.deviance(Spread { sigma_m, sigma_rad: 0.0 });
        assert!(deviance(0.02) < deviance(0.0) && deviance(0.02) < deviance(0.5));
    }

    /// 400 errors of 1 cm by the filter and 2 cm that it doesn't know: the likelihood's deviation is known to 3 %, candidates are 25 %
    /// apart or more. No other error is found: headings err less than the filter says, by three standard errors of their variance.
    #[test]
    fn the_deviation_of_shared_errors_is_found() {
        let errors = |shared: f64| -> Vec<PoseError> {
            (0..400_u32)
                .map(|i| {
                    let mut rng = Draw::new(5, Stage::Training, 3).item(i);
                    let [a, b, c]: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
                    let position = 0.01_f64.hypot(shared);
                    let pose = Pose2::new(position * a, position * b, 0.009 * c);
                    let covariance = [[1e-4, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 1e-4]];
                    PoseError::of(&Estimate { pose, covariance }, Pose2::IDENTITY)
                })
                .collect()
        };
        assert_eq!(shared_errors(&errors(0.02)), Spread { sigma_m: 0.02, sigma_rad: 0.0 });
        assert_eq!(shared_errors(&errors(0.0)), Spread::default());
    }
}
