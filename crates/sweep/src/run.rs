//! Runs cells and keeps each when it is done.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

use locsim_core::Control;
use locsim_lab::LabError;
use locsim_lab::run::{CostEstimate, measure};
use locsim_report::TrialRow;
use locsim_report::store::{Part, Store};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{Sweep, SweepError};

/// How to run a sweep or a shard of it.
pub struct SweepOptions<'a> {
    /// The results folder; shards get folders in it.
    pub out: PathBuf,
    /// Whether to go on with an interrupted sweep. Shards always do.
    pub resume: bool,
    /// Whether earlier results, and what an interrupted sweep has kept, may be replaced.
    pub force: bool,
    /// The caller's clock, progress and interruption; an interruption stops after the trials under way.
    pub control: Control<'a>,
    /// Where range tables are kept between cells, if anywhere.
    pub cache: Option<&'a Path>,
}

/// A cell that was run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FinishedCell {
    /// The cell's seed: a kept cell of another seed is another cell.
    pub seed: u64,
    /// Beams of a scan that the filter used.
    pub beams: u32,
    /// One row for each model and trial.
    pub rows: Vec<TrialRow>,
}

/// BLAKE3 (hexadecimal) of the maps, logs and models that cells read, by path from the scenario's folder.
pub type Inputs = BTreeMap<String, String>;

/// Checks the scenario of every cell before the first is run, and hashes the files that they read.
///
/// # Errors
/// [`SweepError::Scenario`] for a cell that is refused, and a machine without the memory for it; files that cannot be read.
pub fn check(sweep: &Sweep, cells: Range<u32>, control: Control<'_>) -> Result<Inputs, SweepError> {
    let workers = workers(&cells);
    control.progress.stage("checking cells", u64::from(cells.end - cells.start));
    let paths = cells
        .into_par_iter()
        .map(|cell| {
            let scenario = sweep.scenario(cell)?;
            let mut cost = CostEstimate::of(&scenario, 1);
            cost.memory_bytes *= workers as f64;
            cost.check(&scenario).map_err(of_cell(sweep, cell))?;
            let inputs = scenario.inputs()?;
            control.progress.advance(1);
            Ok(inputs.into_iter().skip(1).collect())
        })
        .try_reduce(BTreeSet::<PathBuf>::new, |mut all, more| {
            all.extend(more);
            Ok::<_, SweepError>(all)
        })?;
    let folder = sweep.scenario_file().parent().unwrap_or(Path::new(""));
    let hashed = paths.par_iter().map(|path| {
        let name = path.strip_prefix(folder).unwrap_or(path).display().to_string();
        Ok((name, hash(path)?))
    });
    hashed.collect()
}

/// The BLAKE3 hash of a file, hexadecimal.
///
/// # Errors
/// [`SweepError::File`].
pub fn hash(path: &Path) -> Result<String, SweepError> {
    let mut hasher = blake3::Hasher::new();
    open(path)
        .and_then(|file| hasher.update_reader(file).map(|hasher| hasher.finalize().to_hex().to_string()))
        .map_err(|source| SweepError::File { path: path.to_owned(), source })
}

/// Opens a file. What is none is refused: a pipe would be waited for.
///
/// # Errors
/// The system's errors.
pub fn open(path: &Path) -> io::Result<File> {
    if std::fs::metadata(path)?.is_file() { File::open(path) } else { Err(io::Error::other("it is no file")) }
}

/// Cells that are run side by side.
fn workers(cells: &Range<u32>) -> usize {
    rayon::current_num_threads().min(cells.len()).max(1)
}

/// Runs the cells that the store doesn't keep yet, side by side.
///
/// # Errors
/// [`SweepError`] of the first cell that fails; finished ones are kept.
pub fn run_cells(
    sweep: &Sweep,
    cells: Range<u32>,
    store: &Store,
    options: &SweepOptions<'_>,
    again: &'static str,
) -> Result<(), SweepError> {
    let control = options.control;
    control.progress.stage("cells", u64::from(cells.end - cells.start));
    // Each cell has a pool of its own: in a common one a thread that waits for a part of one cell would begin another, and
    // more cells than threads would be in memory.
    let workers = workers(&cells);
    let threads = rayon::current_num_threads() / workers;
    let next = AtomicU32::new(cells.start);
    let failure = Mutex::new(None);
    let work = || {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        loop {
            let cell = next.fetch_add(1, Ordering::Relaxed);
            if cell >= cells.end {
                return Ok(());
            }
            pool.install(|| finished_cell(sweep, cell, store, options))?;
            control.progress.advance(1);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                if let Err(error) = work() {
                    next.store(cells.end, Ordering::Relaxed);
                    // A poisoned lock holds an error or none, as any other.
                    let mut first = failure.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                    first.get_or_insert(error);
                }
            });
        }
    });
    match failure.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner) {
        Some(SweepError::Cell { source, .. }) if source.is_interruption() => Err(SweepError::Interrupted {
            finished: store.parts().kept()?,
            of: cells.end - cells.start,
            parts: "cells",
            again,
        }),
        Some(error) => Err(error),
        None => Ok(()),
    }
}

/// A cell from the store, or run and kept there.
///
/// # Errors
/// [`SweepError`] for a cell that can't be run or kept.
pub fn finished_cell(
    sweep: &Sweep,
    cell: u32,
    store: &Store,
    options: &SweepOptions<'_>,
) -> Result<FinishedCell, SweepError> {
    match store.parts().load::<FinishedCell>(cell) {
        Part::Whole(kept) if kept.seed == sweep.cells().seed(cell) => return Ok(kept),
        Part::Missing => {}
        Part::Whole(_) | Part::Damaged => {
            let note = format!("cell {cell} was kept, but its file is damaged; it is run again");
            options.control.progress.warn(&note);
        }
    }
    if options.control.is_interrupted() {
        return Err(of_cell(sweep, cell)(LabError::Interrupted { finished: 0, trials: 0 }));
    }
    let measured =
        measure(&sweep.scenario(cell)?, options.cache, options.control).map_err(of_cell(sweep, cell))?;
    let finished =
        FinishedCell { seed: sweep.cells().seed(cell), beams: measured.beams, rows: measured.rows };
    store.parts().save(cell, &finished)?;
    Ok(finished)
}

/// Attaches the cell to what went wrong in it.
fn of_cell(sweep: &Sweep, cell: u32) -> impl FnOnce(LabError) -> SweepError {
    move |source| SweepError::Cell { cell, name: sweep.cells().name(cell), source: Box::new(source) }
}
