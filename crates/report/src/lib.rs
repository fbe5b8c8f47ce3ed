//! The files of a results folder for readers: `summary.json`, tables, figures and the report. `docs/RESULTS.md` lists
//! every file and column.

mod drive;
pub mod figures;
mod findings;
mod localized;
mod nees;
pub mod page;
pub mod palette;
pub mod results;
pub mod statistics;
pub mod store;
pub mod summary;
pub mod tables;
pub mod text;
mod trial_row;
pub mod trial_set;

use thiserror::Error;

use crate::results::{DetailedTrial, RunResults};
use crate::store::{Folder, StoreError};
use crate::summary::{Summary, SummaryError};

use figures::{Figure, Rasterizer};
pub use findings::warnings;
pub use localized::Localized;
pub use nees::NeesIntervals;
pub use text::TextTable;
pub use text::terminal_table;
pub use trial_row::TrialRow;

/// Content of a report beside the results.
#[derive(Clone, Debug, Default)]
pub struct ReportContext {
    /// The scenario's text; the report's appendix.
    pub scenario_yaml: String,
    /// The command that reproduces the run, seed included.
    pub command: String,
    /// Whether the drives were simulated; only then does the paper's experiment stand beside them.
    pub simulated: bool,
    /// Remarks to read before the figures, one or two sentences each.
    pub warnings: Vec<String>,
    /// Limits of the run, one or two sentences each.
    pub notes: Vec<String>,
}

/// Why a report wasn't written.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The results can't be summarized.
    #[error(transparent)]
    Summary(#[from] SummaryError),
    /// A file can't be written.
    #[error("cannot write the report: {0}")]
    Store(#[from] StoreError),
    /// A table can't be put together.
    #[error("cannot build a table: {0}")]
    Table(#[from] arrow::error::ArrowError),
    /// A table can't be written as Parquet.
    #[error("cannot write a Parquet table: {0}")]
    Parquet(#[from] parquet::errors::ParquetError),
    /// A table can't be written as CSV.
    #[error("cannot write a CSV table: {0}")]
    Csv(#[from] csv::Error),
    /// A figure can't be drawn.
    #[error("cannot draw figure {name}: {reason}")]
    Figure {
        /// Its name.
        name: &'static str,
        /// Why.
        reason: String,
    },
    /// The report's text can't be put together.
    #[error("cannot write the report: {0}")]
    Template(#[from] minijinja::Error),
    /// The summary can't be written as JSON.
    #[error("cannot write the summary: {0}")]
    Json(#[from] serde_json::Error),
}

/// Writes `summary.json`, `steps` and `trials` (`.csv`, `.parquet`), `figures/*.svg` and `.png`, `report.md` and
/// `report.html` into a folder. Returns the summary.
///
/// The bytes are a function of the arguments alone; the tables leave out timings, so that a repeated run
/// writes the same ones.
///
/// # Errors
/// [`ReportError`] for results that can't be summarized and files that can't be written.
pub fn write(
    folder: &Folder,
    results: &RunResults,
    detail: Option<&DetailedTrial>,
    context: &ReportContext,
) -> Result<Summary, ReportError> {
    let summary = Summary::new(results)?;
    let mut json = serde_json::to_string_pretty(&summary)?;
    json.push('\n');
    folder.write("summary.json", json.as_bytes())?;

    for (name, table) in [("steps", tables::steps(results)?), ("trials", tables::trials(results)?)] {
        folder.write(&format!("{name}.csv"), &tables::csv(&table)?)?;
        folder.write(&format!("{name}.parquet"), &tables::parquet(&table)?)?;
    }

    let figures = figures::all(results, &summary, detail, context.simulated)?;
    write_figures(folder, &figures)?;
    let markdown = page::markdown(results, &summary, &figures, context)?;
    folder.write("report.md", markdown.as_bytes())?;
    folder.write("report.html", page::html(&results.scenario, &markdown, &figures)?.as_bytes())?;
    Ok(summary)
}

/// Each figure as `figures/NAME.svg` and `.png`.
///
/// # Errors
/// [`ReportError`] for a figure that cannot be rasterized and files that cannot be written.
pub fn write_figures(folder: &Folder, figures: &[Figure]) -> Result<(), ReportError> {
    let rasterizer = Rasterizer::new();
    for figure in figures {
        folder.write(&figure.path(), figure.svg.as_bytes())?;
        folder.write(&format!("figures/{}.png", figure.name), &rasterizer.png(figure)?)?;
    }
    Ok(())
}
