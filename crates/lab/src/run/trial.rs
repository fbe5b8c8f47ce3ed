//! One trial: every model localizes on the same drive.

use std::time::Duration;

use locsim_core::{Clock, Drive, Pose2, wrap_angle};
use locsim_mcl::{Filter, Spread, Start, StepInput, StepOutcome};

use super::detail::Detail;
use super::filter::{self, options};
use super::laboratory::Laboratory;
use super::misfit::Misfit;
use super::rehearsal::{PoseError, scan_log_density};
use super::training::TrainedModel;
use crate::LabError;
use locsim_report::results::{ModelTrial, StepRow};
use locsim_scenario::{ErrorFrame, Errors, Estimate};

/// Runs one model's filter over a drive. With `detail`, every step is kept in full.
///
/// # Errors
/// [`LabError::Log`] for a drive without reference poses, [`LabError::Filter`] for a filter that gives up.
pub(super) fn localize(
    laboratory: &Laboratory<'_>,
    model: &TrainedModel,
    drive: &Drive,
    seed: u64,
    clock: Clock<'_>,
    mut detail: Option<&mut Detail<'_>>,
) -> Result<ModelTrial, LabError> {
    let settings = &laboratory.filter;
    let truth = truth_of(laboratory, drive)?;
    let dead_reckoning = dead_reckoning(drive, truth[0]);
    let map = &*laboratory.maps.ranges;
    // It keeps every generation of particles, so only where its trajectory is asked for.
    let ancestry = detail.is_some() || settings.estimate == Estimate::MostLikelyTrajectory;
    let start = filter::start(settings, Some(truth[0])).unwrap_or(Start::Global);
    let mut filter = Filter::new(options(settings, ancestry)?, &start, map, seed)?;
    let mut steps = Vec::with_capacity(drive.steps.len());
    let mut events = Vec::new();
    let mut spent = Duration::ZERO;
    let mut misfit = Misfit::new(settings, model);
    for (i, step) in drive.steps.iter().enumerate() {
        let input =
            StepInput { odometry: drive.odometry_increment(i), laser: &drive.laser, scan: &step.scan };
        let before = clock();
        let outcome = filter.step(&input, map, &*model.tempered)?;
        spent += clock().saturating_sub(before);
        let first_event = events.len();
        let estimate = online_estimate(settings.estimate, &outcome);
        let scan_density = |pose| scan_log_density(&*model.floored, map, &drive.laser, &step.scan, pose);
        if let Some(recovery) = outcome.recovered {
            events.push((i as u32, recovery.to_string()));
        }
        if outcome.injected > 0 {
            events.push((i as u32, format!("{} random particles injected", outcome.injected)));
        }
        let is_lost = misfit.is_lost(&outcome, scan_density);
        if is_lost {
            events.push((i as u32, Misfit::event()));
        }
        if let Some(detail) = detail.as_deref_mut() {
            let events = events[first_event..].iter().map(|(_, event): &(u32, String)| event.clone());
            detail.push(&filter, &outcome, model, truth[i], &step.scan, events.collect());
        }
        let error = PoseError::of(&outcome.estimates.weighted_mean, truth[i]);
        steps.push(StepRow {
            step: i as u32,
            stamp_secs: step.stamp_secs,
            truth: truth[i],
            dead_reckoning: dead_reckoning[i],
            estimate,
            error_along_m: 0.0,
            error_across_m: 0.0,
            error_heading_rad: 0.0,
            effective_sample_size: outcome.effective_sample_size,
            likelihood_power: outcome.likelihood_power,
            particles: outcome.particle_count as u32,
            log_evidence_nats: outcome.log_evidence,
            scan_log_density_nats: scan_density(estimate),
            nees: error.nees(Spread::default()),
            nees_with_shared_errors: error.nees(model.shared),
            resampled: outcome.resampled,
        });
        if is_lost {
            let before = clock();
            filter.restart(map)?;
            spent += clock().saturating_sub(before);
        }
    }
    if let Some(trajectory) = filter.ancestry().and_then(locsim_mcl::Ancestry::most_likely_trajectory) {
        if settings.estimate == Estimate::MostLikelyTrajectory {
            // Steps before an injected particle came in keep the weighted mean.
            for (row, pose) in steps.iter_mut().skip(trajectory.first_step).zip(&trajectory.poses) {
                row.estimate = *pose;
            }
        }
        if let Some(detail) = detail {
            detail.finish(&trajectory);
        }
    }
    for row in &mut steps {
        measure(row, laboratory.scenario.errors);
    }
    let lost_m = laboratory.scenario.errors.lost_m;
    Ok(ModelTrial {
        model: model.label.clone(),
        lost: is_lost(&steps, lost_m),
        step_ms: spent.as_secs_f64() * 1e3 / steps.len() as f64,
        steps,
        events,
    })
}

/// A trial is lost when it ends farther than `lost_m` \[m\] from the truth, or is that far off in more than half of its
/// steps: a filter that comes back for the last scan has not localized the robot.
fn is_lost(steps: &[StepRow], lost_m: f64) -> bool {
    let is_off = |row: &StepRow| row.position_error_m() > lost_m;
    steps.last().is_some_and(is_off) || 2 * steps.iter().filter(|row| is_off(row)).count() > steps.len()
}

/// The reference pose of each step.
fn truth_of(laboratory: &Laboratory<'_>, drive: &Drive) -> Result<Vec<Pose2>, LabError> {
    drive
        .steps
        .iter()
        .map(|step| step.reference)
        .collect::<Option<Vec<Pose2>>>()
        .filter(|truth| !truth.is_empty())
        .ok_or_else(|| LabError::Log {
            path: laboratory.scenario.file.clone(),
            what: "errors need a reference pose at every scan that is localized on".to_owned(),
        })
}

/// `map_from_base` by odometry alone, from the true first pose.
pub(super) fn dead_reckoning(drive: &Drive, start: Pose2) -> Vec<Pose2> {
    let origin = drive.steps[0].odometry;
    drive.steps.iter().map(|step| start.compose(&step.odometry.relative_to(&origin))).collect()
}

/// Signed errors of a row in the scenario's frame.
fn measure(row: &mut StepRow, errors: Errors) {
    let difference = row.estimate.position() - row.truth.position();
    let error = match errors.frame {
        ErrorFrame::Map => difference,
        ErrorFrame::Robot => glam::DVec2::from_angle(-row.truth.theta).rotate(difference),
    };
    row.error_along_m = error.x;
    row.error_across_m = error.y;
    row.error_heading_rad = wrap_angle(row.estimate.theta - row.truth.theta);
}

/// The step's estimate; for the most likely trajectory a stand-in that is replaced at the end of the drive.
pub(super) fn online_estimate(estimate: Estimate, outcome: &StepOutcome) -> Pose2 {
    let estimates = &outcome.estimates;
    let mean = estimates.weighted_mean.pose;
    match estimate {
        Estimate::WeightedMean | Estimate::MostLikelyTrajectory => mean,
        Estimate::MaxWeight => estimates.max_weight,
        Estimate::DensestCluster => estimates.densest_cluster.map_or(mean, |cluster| cluster.estimate.pose),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(error_along_m: f64) -> StepRow {
        StepRow { error_along_m, ..StepRow::default() }
    }

    #[test]
    fn a_trial_is_lost_at_its_end_or_for_more_than_half_of_it() {
        for (errors, lost) in [
            (vec![0.1, 0.1, 0.1, 2.0], true),
            (vec![2.0, 2.0, 2.0, 0.1], true),
            (vec![2.0, 2.0, 0.1, 0.1], false),
            (vec![0.1; 4], false),
        ] {
            let steps: Vec<StepRow> = errors.iter().copied().map(row).collect();
            assert_eq!(is_lost(&steps, 1.0), lost, "{errors:?}");
        }
    }
}
