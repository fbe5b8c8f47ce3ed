//! The scenario with the effects that were found, and the difference to what it was.

use std::path::Path;

use locsim_baseline::Changes;
use locsim_core::Pose2;
use locsim_core::limits::quoted;
use locsim_gap::{Guess, Named, Outcome, ResidualStage};
use locsim_report::text::significant;
use locsim_scenario::edit::{Additions, Change, Entry};
use locsim_scenario::effect::{effect_yaml_with, in_file, residual_yaml};
use locsim_world::effect::Parameter;
use locsim_world::simulation::BlockOptions;
use similar::TextDiff;

use super::GapStudy;
use crate::LabError;
use crate::run::out_folder;

/// The scenario with what a search has found, to be read from the folder `out`: effects, curves, and what the log has where the
/// scenario guessed more.
///
/// # Errors
/// [`LabError::Store`] for a folder whose path can't be told.
pub fn scenario_after(study: &GapStudy, outcome: &Outcome, out: &Path) -> Result<String, LabError> {
    let guesses = outcome.map.as_ref().map_or(&[][..], |map| &map.guesses);
    let blocks = study.added_blocks.map(|blocks| blocks.times(outcome.nuisances.block_density));
    let blocks = blocks.as_ref().map(|blocks| block_entry(study, blocks));
    scenario_with(study, &outcome.effects, outcome.residual.as_ref(), guesses, blocks, out)
}

/// The scenario with what has changed since a baseline, to be read from the folder `out`.
///
/// # Errors
/// As [`scenario_after`].
pub fn scenario_since(study: &GapStudy, changes: &Changes, out: &Path) -> Result<String, LabError> {
    scenario_with(study, &changes.effects, None, &[], None, out)
}

fn scenario_with(
    study: &GapStudy,
    effects: &[Named],
    residual: Option<&ResidualStage>,
    guesses: &[Guess],
    blocks: Option<Entry>,
    out: &Path,
) -> Result<String, LabError> {
    let effects = effects.iter().map(|named| entry(study, named)).collect();
    // Curves that bring the ranges no nearer make no better simulator.
    let residuals = residual
        .filter(|stage| stage.is_nearer())
        .map_or_else(Vec::new, |stage| residual_entries(study, stage));
    let changes = guesses.iter().map(change).collect();
    let of_laser = study.logged_mount.map(|mount| format!("mount: {}", mount_yaml(mount)));
    let additions = Additions { changes, of_laser, blocks, effects, residuals };
    Ok(study.scenario.with(&additions, &out_folder(out)?, &proposed_name(&study.scenario.name)))
}

/// To a tenth of a millimetre and a thousandth of a degree.
fn mount_yaml(mount: Pose2) -> String {
    let rounded = |value: f64, digits: f64| (value * digits).round() / digits;
    let [x_m, y_m] = [mount.x, mount.y].map(|value| rounded(value, 1e4));
    format!("{{x_m: {x_m}, y_m: {y_m}, yaw_deg: {}}}", rounded(mount.theta.to_degrees(), 1e3))
}

/// Blocks that the log has and the scenario hasn't.
fn block_entry(study: &GapStudy, blocks: &BlockOptions) -> Entry {
    let log = quoted(&study.log.file_name().unwrap_or_default().to_string_lossy());
    let range = |key: &str, [from, to]: [f64; 2]| format!("{key}: [{from}, {to}]");
    Entry {
        comments: vec![format!(
            "As many as {log} has, found by `locsim gap`, and about as large as they look there."
        )],
        lines: vec![
            format!("per_metre_of_wall: {}", significant(blocks.per_metre_of_wall)),
            range("length_m", blocks.length_m),
            range("width_m", blocks.width_m),
            range("wall_distance_m", blocks.wall_distance_m),
            range("yaw_deg", blocks.yaw_rad.map(f64::to_degrees)),
        ],
    }
}

/// What the log has for what the scenario guessed, to three digits.
fn change(guess: &Guess) -> Change<'_> {
    let to = format!("{:.2e}", guess.log).parse().unwrap_or(guess.log);
    Change { what: guess.what, from: guess.scenario, to }
}

/// The curves, the first with what is known of all.
fn residual_entries(study: &GapStudy, stage: &ResidualStage) -> Vec<Entry> {
    let log = quoted(&study.log.file_name().unwrap_or_default().to_string_lossy());
    let mut comments = vec![
        format!(
            "Learnt from {log} by `locsim gap`; the cause is not known. Range errors on stretches that the curves"
        ),
        format!(
            "were not learnt from: {:.1} -> {:.1} mm from the simulation's.",
            stage.w1_without_mm, stage.w1_mm
        ),
    ];
    let entry = |curve| Entry { comments: std::mem::take(&mut comments), lines: vec![residual_yaml(curve)] };
    stage.curves.iter().map(entry).collect()
}

/// A name of its own: under that of the old scenario, its results would replace the old ones.
fn proposed_name(old: &str) -> String {
    const ENDING: &str = "-gap";
    /// Letters that a name may have.
    const MOST: usize = 100;
    let stem: String = old.chars().take(MOST - ENDING.len()).collect();
    stem + ENDING
}

/// The unified diff between two texts.
pub(super) fn diff(old: &str, new: &str, old_name: &str, new_name: &str) -> String {
    TextDiff::from_lines(old, new).unified_diff().context_radius(2).header(old_name, new_name).to_string()
}

/// One effect as an entry with what is known of it.
fn entry(study: &GapStudy, named: &Named) -> Entry {
    let evidence = &named.evidence;
    let log = quoted(&study.log.file_name().unwrap_or_default().to_string_lossy());
    let mut comments = vec![
        format!("Found in {log} by `locsim gap`: {}", named.effect.sentence()),
        format!("{}.", numbers(named)),
        format!(
            "It gains {} nats on held-out scans; chance of a false alarm {}.",
            super::answer::with_interval(&evidence.gain_nats),
            super::answer::p_value(evidence.p),
        ),
    ];
    let others: Vec<&str> = super::answer::others(named).collect();
    if !others.is_empty() {
        comments.push(format!("The log doesn't tell it from {}.", others.join(", ")));
    }
    let rounded = |parameter: &Parameter, value: f64| round_to_interval(named, parameter, value);
    let lines = effect_yaml_with(&named.effect, None, &rounded).lines().map(str::to_owned).collect();
    Entry { comments, lines }
}

/// `p 0.42 [0.38, 0.46], angle_deg 61 [59, 63]`: the numbers of an effect as files write them.
fn numbers(named: &Named) -> String {
    let number = |parameter: &Parameter| {
        let Some(number) = named.params.get(parameter.name) else { return String::new() };
        let estimate = number.estimate.map(|value| in_file(parameter, value));
        format!("{} {}", parameter.key, super::answer::with_interval(&estimate))
    };
    named.name.parameters().iter().map(number).collect::<Vec<_>>().join(", ")
}

/// A value as it stands in files, with as many digits as its interval is worth.
fn round_to_interval(named: &Named, parameter: &Parameter, value: f64) -> f64 {
    let [least, most] = [parameter.lo, parameter.hi].map(|limit| in_file(parameter, limit));
    let Some(number) = named.params.get(parameter.name) else { return value };
    // A hundredth of the interval.
    let interval = number.estimate.interval.map(|value| in_file(parameter, value));
    let decimals = super::answer::decimals(interval) + 1;
    let scale = 10_f64.powi(decimals as i32);
    ((value * scale).round() / scale).clamp(least, most)
}
