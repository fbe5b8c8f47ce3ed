use std::path::Path;

use locsim_core::Control;
use locsim_report::TrialRow;
use locsim_scenario::Scenario;
use rayon::prelude::*;

use super::laboratory::Laboratory;
use super::run_trial;
use crate::LabError;

/// The trials of a scenario without their steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Beams of a scan that the filter used.
    pub beams: u32,
    /// One row for each trial and model, trial by trial.
    pub rows: Vec<TrialRow>,
}

/// Runs every trial of a scenario under every model, as [`run`](super::run) does, and writes nothing. Of `control`, the progress
/// is not used.
///
/// # Errors
/// [`LabError`], as [`run`](super::run), and for a log without reference poses, which has no errors to measure.
pub fn measure(
    scenario: &Scenario,
    cache: Option<&Path>,
    control: Control<'_>,
) -> Result<Measurement, LabError> {
    let laboratory = Laboratory::prepare(scenario, cache, &())?;
    laboratory.with_reference()?;
    let rows: Vec<Vec<TrialRow>> = (0..scenario.trials)
        .into_par_iter()
        .map(|number| {
            if control.is_interrupted() {
                return Err(LabError::Interrupted { finished: 0, trials: scenario.trials as usize });
            }
            let trial = run_trial(&laboratory, number, control.clock)?;
            Ok(trial.models.iter().map(|model| TrialRow::new(&trial, model)).collect())
        })
        .collect::<Result<_, LabError>>()?;
    Ok(Measurement { beams: laboratory.beams() as u32, rows: rows.into_iter().flatten().collect() })
}
