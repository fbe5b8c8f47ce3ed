//! The report of a sweep, and what is printed at its end.

use locsim_report::figures::Figure;
use locsim_report::store::Folder;
use locsim_report::text::{self, TextTable, metres_with, percent, with_interval};
use locsim_report::trial_set::plain;
use locsim_report::{ReportError, page, write_figures};
use minijinja::syntax::SyntaxConfig;
use minijinja::value::Serde;
use minijinja::{Environment, context};
use serde::Serialize;

use crate::cells::Figures;
use crate::figures;
use crate::plan::{Cells, Operand, Plan};
use crate::results::Merged;

const MARKDOWN: &str = include_str!("templates/sweep.md.j2");
/// Values of an axis, and files, that a table lists.
const LISTED: usize = 12;

/// A figure as the template names it.
#[derive(Serialize)]
struct FigureLink<'a> {
    name: &'a str,
    caption: &'a str,
    path: String,
}

/// Writes `figures/`, `report.md` and `report.html`. The bytes are a function of the arguments alone.
pub fn write(folder: &Folder, cells: &Cells, merged: &Merged, figures: &Figures) -> Result<(), ReportError> {
    let pictures = figures::all(cells, figures)?;
    write_figures(folder, &pictures)?;
    let markdown = markdown(cells, merged, figures, &pictures)?;
    folder.write("report.md", markdown.as_bytes())?;
    Ok(folder.write("report.html", page::html(&merged.name, &markdown, &pictures)?.as_bytes())?)
}

fn markdown(
    cells: &Cells,
    merged: &Merged,
    figures: &Figures,
    pictures: &[Figure],
) -> Result<String, ReportError> {
    let mut environment = Environment::new();
    environment.set_syntax(SyntaxConfig::builder().trim_blocks(true).lstrip_blocks(true).build()?);
    environment.add_template("sweep.md", MARKDOWN)?;
    let links: Vec<FigureLink<'_>> = pictures
        .iter()
        .map(|figure| FigureLink { name: figure.name, caption: &figure.caption, path: figure.path() })
        .collect();
    let page = context! {
        title => text::escape(&merged.name),
        description => text::escape(&merged.description),
        cells => merged.cells,
        rows => merged.rows,
        seed => merged.plan.seed,
        models => merged.models.len(),
        axes_table => axes_table(&merged.plan).to_markdown(),
        conditions => conditions(&merged.plan),
        models_table => models_table(merged).to_markdown(),
        figures => Serde(links),
        front_table => front_table(cells, figures).map(|table| table.to_markdown()),
        version => merged.version.clone(),
        digest => merged.digest.clone(),
        inputs_table => inputs_table(merged).to_markdown(),
    };
    Ok(environment.get_template("sweep.md")?.render(page)?)
}

/// The first of many words, and how many others there are.
fn listed(words: impl ExactSizeIterator<Item = String>) -> String {
    let more = words.len().saturating_sub(LISTED);
    let text = words.take(LISTED).collect::<Vec<_>>().join(", ");
    if more > 0 { format!("{text} and {more} more") } else { text }
}

fn axes_table(plan: &Plan) -> TextTable {
    let with = |axis: usize| {
        let group = plan.groups.iter().find(|group| group.contains(&axis)).map_or(&[][..], Vec::as_slice);
        let others = group.iter().filter(|other| **other != axis);
        others.map(|other| plan.axes[*other].key.clone()).collect::<Vec<_>>().join(", ")
    };
    let rows = plan.axes.iter().enumerate().map(|(i, axis)| {
        let with = with(i);
        [
            axis.key.clone(),
            axis.values.len().to_string(),
            listed(axis.values.iter().map(plain)),
            if with.is_empty() { text::NONE.to_owned() } else { with },
        ]
    });
    TextTable::new(["key", "number", "values", "varies with"], rows)
}

fn conditions(plan: &Plan) -> Vec<String> {
    let text = plan.conditions.iter().map(|condition| {
        let sign = plain(&serde_json::to_value(condition.comparison).unwrap_or_default());
        let right = match &condition.right {
            Operand::Axis(axis) => plan.axes[*axis].key.clone(),
            Operand::Value(value) => plain(value),
        };
        format!("{} {sign} {right}", plan.axes[condition.left].key).replace('`', "'")
    });
    text.collect()
}

fn models_table(merged: &Merged) -> TextTable {
    let rows = merged.models.iter().map(|(label, model)| {
        let lost = model.lost_share_interval;
        [
            label.clone(),
            model.trials.to_string(),
            metres_with(model.position_rmse_m, model.position_rmse_interval),
            format!("{} [{}, {}]", percent(model.lost_share), percent(lost.lo), percent(lost.hi)),
            model.cells_best.to_string(),
            model.cells_tied.to_string(),
        ]
    });
    TextTable::new(["model", "trials", "RMSE [m]", "lost [%]", "best in cells", "tied in cells"], rows)
}

fn front_table(cells: &Cells, figures: &Figures) -> Option<TextTable> {
    let costs = figures::costs(cells, figures)?;
    let rows = costs.iter().filter(|cost| cost.on_front).map(|cost| {
        let settings = if cost.settings.is_empty() { text::NONE.to_owned() } else { cost.settings.clone() };
        [
            figures.models[cost.model].clone(),
            settings,
            format!("{:.0}", cost.tally.casts()),
            with_interval(cost.tally.rmse_m(), cost.tally.rmse_interval(), 4),
            percent(cost.tally.lost_share()),
        ]
    });
    Some(TextTable::new(["model", "settings", "particles x beams", "RMSE [m]", "lost [%]"], rows))
}

fn inputs_table(merged: &Merged) -> TextTable {
    let inputs = merged.inputs.iter().take(LISTED);
    TextTable::new(
        ["file", "BLAKE3"],
        inputs.map(|(path, hash)| [path.clone(), hash.chars().take(16).collect()]),
    )
}

impl Merged {
    /// The models over all cells, for a terminal.
    pub fn table(&self) -> TextTable {
        models_table(self)
    }
}
