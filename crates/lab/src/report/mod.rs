//! What a run leaves in its results folder for readers: `summary.json`, tables, figures and the report.
//! `docs/RESULTS.md` lists every file and column.

pub(crate) mod figures;
mod findings;
pub(crate) mod page;
mod tables;
pub(crate) mod text;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::results::{DetailedTrial, RunResults};
use crate::summary::{Summary, SummaryError};

pub(crate) use text::TextTable;
pub use text::terminal_table;

/// What a report says beside the results.
#[derive(Clone, Debug, Default)]
pub struct ReportContext {
    /// The scenario's text; the report's appendix.
    pub scenario_yaml: String,
    /// The command that reproduces the run, seed included.
    pub command: String,
    /// Whether the drives were simulated; only then does the paper's experiment stand beside them.
    pub simulated: bool,
    /// What a reader should know of the run's limits, one sentence or two each.
    pub notes: Vec<String>,
}

/// Why a report wasn't written.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The results can't be summarized.
    #[error(transparent)]
    Summary(#[from] SummaryError),
    /// A file or folder can't be written.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
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
/// `report.html` into `dir`, which is made if it's missing. Returns the summary.
///
/// The bytes are a function of the arguments alone; the tables leave out timings, so that a repeated run
/// writes the same ones.
///
/// # Errors
/// [`ReportError`] for results that can't be summarized and files that can't be written.
pub fn write(
    dir: &Path,
    results: &RunResults,
    detail: Option<&DetailedTrial>,
    context: &ReportContext,
) -> Result<Summary, ReportError> {
    let summary = Summary::new(results)?;
    let folder = dir.join("figures");
    fs::create_dir_all(&folder).map_err(|source| ReportError::Io { path: folder.clone(), source })?;

    let mut json = serde_json::to_string_pretty(&summary)?;
    json.push('\n');
    save(&dir.join("summary.json"), json.as_bytes())?;

    for (name, table) in [("steps", tables::steps(results)?), ("trials", tables::trials(results)?)] {
        save(&dir.join(format!("{name}.csv")), &tables::csv(&table)?)?;
        save(&dir.join(format!("{name}.parquet")), &tables::parquet(&table)?)?;
    }

    let figures = figures::all(results, &summary, detail)?;
    let rasterizer = figures::Rasterizer::new();
    for figure in &figures {
        save(&folder.join(format!("{}.svg", figure.name)), figure.svg.as_bytes())?;
        save(&folder.join(format!("{}.png", figure.name)), &rasterizer.png(figure)?)?;
    }

    let markdown = page::markdown(results, &summary, &figures, context)?;
    save(&dir.join("report.md"), markdown.as_bytes())?;
    save(&dir.join("report.html"), page::html(&results.scenario, &markdown, &figures)?.as_bytes())?;
    Ok(summary)
}

pub(crate) fn save(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    fs::write(path, bytes).map_err(|source| ReportError::Io { path: path.to_owned(), source })
}
