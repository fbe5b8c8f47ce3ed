//! `locsim export nav2`: parameters for AMCL and Beluga, searched on a robot's own drives.

mod amcl;
mod comparison;
mod files;
mod page;
mod search;

use std::path::Path;

use locsim_core::{Control, Drive};
use locsim_dataset::LogOptions;
use locsim_report::TextTable;
use locsim_scenario::yaml;
use locsim_scenario::{Overrides, Scenario, Source, Start};
use serde_json::{Map, Value};

use self::amcl::{Localizer, odometry_noise, updates};
use self::comparison::Comparison;
use self::files::Origin;
use self::search::Search;
use locsim_lab::LabError;
use locsim_lab::inspect::{Inspection, NewScenario, rounded};
use locsim_lab::run::{Grounds, START};

/// Fewer updates in all training drives tell nothing.
const LEAST_UPDATES: usize = 10;

/// How parameters are searched.
#[derive(Clone, Copy)]
pub struct Nav2Options<'a> {
    /// Sets of parameters that are tried; at least 16.
    pub evaluations: u32,
    /// Trials of the comparison; at least 2.
    pub trials: u32,
    /// The command that repeats it.
    pub command: &'a str,
    /// Clock, progress and interruption.
    pub control: Control<'a>,
    /// Where range tables are kept between runs, if anywhere.
    pub cache: Option<&'a Path>,
}

/// Parameter files and the page on them.
#[derive(Clone, Debug, PartialEq)]
pub struct Nav2Export {
    /// Parameters of nav2's AMCL.
    pub amcl: String,
    /// Parameters of Beluga.
    pub beluga: String,
    /// The page as Markdown.
    pub markdown: String,
    /// The page as HTML.
    pub html: String,
    /// The errors before and after.
    pub table: TextTable,
    /// The result in a sentence.
    pub sentence: String,
}

/// The scenario of a log, as `locsim init` writes it.
///
/// # Errors
/// [`LabError`] for a log that can't be read, or lacks what a scenario needs.
pub fn nav2_scenario(log: &Path, options: &LogOptions, overrides: &Overrides) -> Result<Scenario, LabError> {
    let inspection = Inspection::of(log, options)?;
    let name = log.file_name().unwrap_or_default().to_string_lossy();
    // As the name of a scenario: without endings and without signs.
    let stem = name.split('.').next().unwrap_or_default();
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    let plain: String = stem.chars().map(|c| if is_plain(c) { c } else { '_' }).take(100).collect();
    let out = log.with_file_name(if plain.is_empty() { "log" } else { &plain }).with_extension("yaml");
    let new = NewScenario { log, map: None, cell_m: None, out: &out, options: options.clone() };
    let (tree, _) = yaml::parse::<Map<String, Value>>(&out, &new.text(&inspection)?)?;
    Ok(Scenario::of_tree(&out, &Value::Object(tree), overrides)?)
}

/// Searches AMCL's parameters on the training drives of a scenario, and compares nav2's defaults with what it found on its trials.
///
/// # Errors
/// [`LabError`]: what is wrong with map, log or world; too few updates with reference poses; an interruption.
pub fn nav2(scenario: &Scenario, options: &Nav2Options<'_>) -> Result<Nav2Export, LabError> {
    let control = options.control;
    let grounds = Grounds::prepare(scenario, options.trials, options.cache, control.progress)?;
    let refuse = |what: String| {
        let path = match &scenario.source {
            Source::Log(log) => log.file.clone(),
            Source::Simulation(_) => scenario.file.clone(),
        };
        LabError::Log { path, what }
    };
    let cut = |drives: &[Drive]| -> Vec<Drive> { drives.iter().map(updates).collect() };
    let (training, trials) = (cut(&grounds.training), cut(&grounds.trials));
    let steps: usize = training.iter().map(|drive| drive.steps.len()).sum();
    if steps < LEAST_UPDATES {
        return Err(refuse(format!(
            "{steps} updates in the training drives, {} m or {} rad apart; at least {LEAST_UPDATES}",
            amcl::UPDATE_MIN_D,
            amcl::UPDATE_MIN_A
        )));
    }
    let (alpha, windows) = odometry_noise(&cut(&grounds.odometry)).ok_or_else(|| {
        refuse("alpha1: too few metres of odometry with reference poses to estimate its noise".to_owned())
    })?;
    let spread = match scenario.filter.start {
        Start::Tracking(spread) | Start::Around(_, spread) => spread,
        Start::Global => START,
    };
    let localizer = Localizer { maps: grounds.maps, start: spread, lost_m: scenario.errors.lost_m };
    let search = Search {
        localizer: &localizer,
        drives: &training,
        alpha,
        seed: scenario.seed,
        evaluations: options.evaluations,
        control,
    };
    let [found, field] = search.run()?;
    let comparison = Comparison::run(&localizer, &trials, &found, &search, options.trials)?;
    control.progress.finish();
    let origin = Origin {
        source: &scenario.name,
        command: options.command,
        windows,
        alpha,
        evaluations: options.evaluations,
        drives: training.len(),
        max_range_m: rounded(training[0].laser.max_range().into(), 6),
    };
    let parameters = files::amcl(&found, &origin);
    let markdown = page::markdown(scenario, &comparison, &parameters, &found, &origin, &trials)?;
    Ok(Nav2Export {
        amcl: files::yaml(&parameters, "nav2's AMCL", &origin),
        beluga: files::yaml(&files::beluga(&field, &origin), "beluga_amcl", &origin),
        html: page::html(scenario, &markdown)?,
        table: comparison.table(),
        sentence: comparison.sentence(),
        markdown,
    })
}
