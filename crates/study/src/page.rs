//! The results folder of a study: `results.json`, figures, report.

use minijinja::syntax::SyntaxConfig;
use minijinja::value::Serde;
use minijinja::{Environment, context};
use serde::Serialize;

use super::Study;
use super::experiment::Extra;
use super::figures;
use super::results::{Claim, ConditionResults, Results};
use locsim_report::figures::Figure;
use locsim_report::store::Folder;
use locsim_report::text::{self, TextTable, significant};
use locsim_report::{ReportError, page, write_figures};

const MARKDOWN: &str = include_str!("templates/study.md.j2");

/// A figure with the statements that it speaks to.
#[derive(Serialize)]
struct FigureWithClaims<'a> {
    name: &'a str,
    caption: &'a str,
    path: String,
    claims: Vec<ClaimText<'a>>,
}

#[derive(Serialize)]
struct ClaimText<'a> {
    figure: &'a str,
    paper: &'a str,
    finding: &'a str,
    verdict: &'a str,
    reason: &'a str,
}

impl<'a> From<&'a Claim> for ClaimText<'a> {
    fn from(claim: &'a Claim) -> Self {
        Self {
            figure: claim.figure,
            paper: claim.paper,
            finding: &claim.finding,
            verdict: claim.verdict.as_str(),
            reason: &claim.reason,
        }
    }
}

/// Writes everything into a folder.
pub(super) fn write(
    folder: &Folder,
    study: &Study,
    results: &Results,
    extra: &Extra,
) -> Result<(), ReportError> {
    let mut json = serde_json::to_string_pretty(results)?;
    json.push('\n');
    folder.write("results.json", json.as_bytes())?;
    let figures = figures::all(study, results, extra)?;
    write_figures(folder, &figures)?;
    let markdown = markdown(study, results, &figures, &study.command())?;
    folder.write("report.md", markdown.as_bytes())?;
    Ok(folder.write("report.html", page::html(&results.study, &markdown, &figures)?.as_bytes())?)
}

fn markdown(
    study: &Study,
    results: &Results,
    figures: &[Figure],
    command: &str,
) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
    environment.add_template("study.md", MARKDOWN)?;
    let figures: Vec<FigureWithClaims<'_>> = figures
        .iter()
        .map(|figure| FigureWithClaims {
            name: figure.name,
            caption: &figure.caption,
            path: figure.path(),
            claims: results.claims.iter().filter(|c| c.ours == figure.name).map(ClaimText::from).collect(),
        })
        .collect();
    let tables: Vec<(String, String)> = results
        .conditions
        .iter()
        .map(|c| (c.condition.clone(), risk_table(study, c).to_markdown()))
        .collect();
    let models: Vec<(&str, String)> =
        study.models.iter().map(|m| (m.as_str(), m.describe(&study.setup))).collect();
    let page = context! {
        title => text::escape(&results.study),
        description => text::escape(&study.description),
        quick => results.quick,
        seed => results.seed,
        repeats => results.repeats,
        bins => results.bins,
        bin_width => significant(results.bin_width * study.setup.unit.per_z),
        unit => study.setup.unit.name,
        test_states => study.test_states,
        observations => study.observations,
        folds => study.folds,
        note => study.setup.note.as_deref().map(text::escape),
        claims_table => (!results.claims.is_empty()).then(|| claims_table(results).to_markdown()),
        figures => Serde(figures),
        tables => Serde(tables),
        families_table => families_table(results).map(|t| t.to_markdown()),
        models => Serde(models),
        notes => notes(results),
        command => command.trim(),
        study_yaml => study.text.trim_end(),
        fence => page::fence(&[&study.text, command]),
    };
    Ok(environment.get_template("study.md")?.render(page)?)
}

fn claims_table(results: &Results) -> TextTable {
    TextTable::new(
        ["paper", "statement", "here"],
        results.claims.iter().map(|claim| {
            [claim.figure.to_owned(), claim.paper.to_owned(), claim.verdict.as_str().to_owned()]
        }),
    )
}

/// Risk of each model at each N.
fn risk_table(study: &Study, condition: &ConditionResults) -> TextTable {
    let names: Vec<&str> = study.setup.coordinates.iter().map(|(name, _)| name.as_str()).collect();
    let bandwidths = format!("bandwidths ({})", names.join(", "));
    let crps = format!("CRPS [{}]", study.setup.unit.name);
    let rows = condition.risks.iter().flat_map(|r| {
        (0..r.risk.at.len()).map(|k| {
            [
                r.model.to_owned(),
                format!("{}", r.risk.at[k]),
                significant(r.risk.mean[k]),
                format!("{} to {}", significant(r.risk.lo[k]), significant(r.risk.hi[k])),
                text::with_interval(r.ratio[k], r.ratio_intervals[k], 2),
                significant(r.crps.mean[k] * study.setup.unit.per_z),
                r.bandwidths[k].iter().map(|h| significant(*h)).collect::<Vec<_>>().join(", "),
            ]
        })
    });
    let first = condition.risks.first().map_or("", |r| r.model);
    TextTable::new(
        ["model", "N", "risk [bins]", "middle 80 %", &format!("risk / {first}"), &crps, &bandwidths],
        rows,
    )
}

fn families_table(results: &Results) -> Option<TextTable> {
    let families = results.families.as_ref()?;
    Some(TextTable::new(
        ["family", "log loss [nats]", "best of all", "best of the parametric"],
        families.families.iter().map(|f| {
            [
                f.family.to_owned(),
                text::fixed(f.log_loss, 3),
                f.best.to_string(),
                f.best_parametric.map_or_else(|| text::NONE.to_owned(), |n| n.to_string()),
            ]
        }),
    ))
}

/// Limits of the search, for readers.
fn notes(results: &Results) -> Vec<String> {
    let often = 0.5;
    let mut notes = Vec::new();
    for condition in &results.conditions {
        for model in &condition.risks {
            let places: Vec<String> = model
                .risk
                .at
                .iter()
                .zip(&model.at_end_share)
                .filter(|(_, share)| **share > often)
                .map(|(n, _)| n.to_string())
                .collect();
            if !places.is_empty() {
                notes.push(format!(
                    "{}: `{}` chose a bandwidth at an end of its list in more than half of the repeats at N = {}.",
                    condition.condition,
                    model.model,
                    places.join(", ")
                ));
            }
        }
    }
    notes
}

/// The verdicts on the paper's statements, for a terminal.
pub fn terminal_summary(results: &Results, width: Option<usize>) -> String {
    let head = format!("{}: {} repeats, seed {}", results.study, results.repeats, results.seed);
    if results.claims.is_empty() {
        head
    } else {
        format!("{head}\n{}", claims_table(results).to_terminal(width))
    }
}
