//! The page on exported parameters.

use locsim_core::Drive;
use locsim_report::text::{self, TextTable, metres};
use locsim_report::{ReportError, page};
use locsim_scenario::{Scenario, Source};
use minijinja::syntax::SyntaxConfig;
use minijinja::{Environment, context};

use super::amcl::Settings;
use super::comparison::Comparison;
use super::files::{self, Origin, Parameter};
use super::search::Found;
use locsim_lab::LabError;

const MARKDOWN: &str = include_str!("../templates/nav2.md.j2");

fn title(scenario: &Scenario) -> String {
    format!("AMCL on {}", scenario.name)
}

pub(super) fn markdown(
    scenario: &Scenario,
    comparison: &Comparison,
    parameters: &[Parameter],
    found: &Found,
    origin: &Origin<'_>,
    trials: &[Drive],
) -> Result<String, LabError> {
    let render = || -> Result<String, minijinja::Error> {
        let mut environment = Environment::new();
        environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
        environment.add_template("nav2.md", MARKDOWN)?;
        let updates: Vec<usize> = trials.iter().map(|drive| drive.steps.len()).collect();
        let page = context! {
            title => text::escape(&title(scenario)),
            description => text::escape(&scenario.description),
            sentence => comparison.sentence(),
            comparison => comparison.table().to_markdown(),
            is_log => matches!(scenario.source, Source::Log(_)),
            drives => trials.len(),
            updates => updates.iter().sum::<usize>() / updates.len().max(1),
            replicates => locsim_report::statistics::REPLICATES,
            lost_m => scenario.errors.lost_m.to_string(),
            parameters => table(parameters, found, origin).to_markdown(),
            evaluations => origin.evaluations,
            training_drives => origin.drives,
            windows => origin.windows,
            noise_factor => found.noise_factor.map(|factor| factor.to_string()),
            rehearsed => metres(found.error_m),
            rehearsed_defaults => metres(found.defaults_error_m),
            seed => scenario.seed,
            command => origin.command,
            fence => page::fence(&[origin.command]),
        };
        environment.get_template("nav2.md")?.render(page)
    };
    Ok(render().map_err(ReportError::from)?)
}

pub(super) fn html(scenario: &Scenario, markdown: &str) -> Result<String, LabError> {
    Ok(page::html(&title(scenario), markdown, &[])?)
}

/// Each parameter beside nav2's default.
fn table(parameters: &[Parameter], found: &Found, origin: &Origin<'_>) -> TextTable {
    let defaults = files::amcl(
        &Found { settings: Settings::DEFAULTS, noise_factor: None, ..*found },
        &Origin { max_range_m: 100.0, ..*origin },
    );
    let rows = parameters.iter().zip(defaults).map(|(parameter, usual)| {
        [
            parameter.name.to_owned(),
            parameter.value.text().replace('"', ""),
            usual.value.text().replace('"', ""),
            parameter.origin.to_owned(),
        ]
    });
    TextTable::new(["parameter", "exported", "nav2's default", "from"], rows)
}
