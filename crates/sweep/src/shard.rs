//! A shard: a share of the cells, run on its own into a folder of its own.

use std::io::Read;
use std::path::{Path, PathBuf};

use indexmap::IndexMap;
use locsim_core::Shard;
use locsim_core::output::in_shell;
use locsim_report::store::{Folder, Request, Store};
use locsim_report::trial_set::{CellRows, TrialFile};
use serde::{Deserialize, Serialize};

use crate::plan::Plan;
use crate::run::{Inputs, SweepOptions, check, finished_cell, hash, open, run_cells};
use crate::{Sweep, SweepError};

/// The trials of a shard, in its folder.
pub const TRIALS: &str = "trials.parquet";
/// A summary has fewer bytes than this: some 40 for each cell and model.
const MOST_SUMMARY_BYTES: u64 = 256 << 20;
/// Its summary.
pub const SUMMARY: &str = "shard.json";

/// The content of `shard.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ShardSummary {
    /// Version of locsim.
    pub version: String,
    /// Hash of version, scenario and plan.
    pub digest: String,
    /// Which shard.
    pub shard: Shard,
    /// Number of the first cell.
    pub first_cell: u32,
    /// Number of cells.
    pub cells: u32,
    /// Number of pairs of a trial and a model.
    pub rows: u64,
    /// BLAKE3 of `trials.parquet`, or of a run's `trials.cbor`.
    pub blake3: String,
    /// Files that the cells read.
    pub inputs: Inputs,
    /// The sweep; of a run, a sweep without axes whose cells are trials.
    pub sweep: SweepSummary,
    /// The run, where the shard holds trials of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<RunSummary>,
    /// Mean wall time of a filter step \[ms\] of each cell, by model. A repeated run doesn't reproduce it.
    pub step_ms: Vec<IndexMap<String, f64>>,
}

/// The run that a shard is of.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunSummary {
    /// The models that the scenario was restricted to, if it was.
    pub models: Option<Vec<String>>,
}

impl RunSummary {
    /// The trials of a shard, in its folder.
    pub const TRIALS: &str = "trials.cbor";
}

impl ShardSummary {
    /// The command that runs a shard, without its place and number.
    pub fn command(&self) -> String {
        let SweepSummary { file, plan, .. } = &self.sweep;
        let Some(run) = &self.run else { return format!("locsim sweep {}", in_shell(file)) };
        let mut command = format!("locsim run {} --seed {}", in_shell(file), plan.seed);
        if let Some(trials) = plan.trials {
            command += " --trials ";
            command += &trials.to_string();
        }
        if let Some(models) = &run.models {
            command += " --models ";
            command += &models.iter().map(in_shell).collect::<Vec<_>>().join(",");
        }
        command
    }
}

/// The sweep that a shard is of.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SweepSummary {
    /// Its name.
    pub name: String,
    /// One line for people.
    pub description: String,
    /// Its file, as it was named.
    pub file: PathBuf,
    /// Its axes and how they are combined.
    pub plan: Plan,
}

impl SweepSummary {
    /// Of a sweep.
    pub fn of(sweep: &Sweep) -> Self {
        Self {
            name: sweep.name.clone(),
            description: sweep.description.clone(),
            file: sweep.file.clone(),
            plan: sweep.cells().plan().clone(),
        }
    }
}

/// The outcome of [`run_shard`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShardOutcome {
    /// It was run.
    Done,
    /// It was there already.
    AlreadyDone,
}

/// Runs a shard of a sweep into its folder in `options.out`, which is renamed into place when it is complete.
///
/// # Errors
/// [`SweepError`]; finished cells are kept, and the same call goes on with them.
pub fn run_shard(
    sweep: &Sweep,
    shard: Shard,
    options: &SweepOptions<'_>,
) -> Result<ShardOutcome, SweepError> {
    let count = sweep.cells().count();
    if shard.of > count {
        return Err(SweepError::TooManyShards { shards: shard.of, parts: count, part: "cell" });
    }
    let cells = shard.range(count);
    let inputs = check(sweep, cells.clone(), options.control)?;
    let digest = sweep.digest();
    let out = options.out.join(shard.folder());
    if complete(&out, &digest, shard, &inputs, options.force)? {
        return Ok(ShardOutcome::AlreadyDone);
    }
    let settings = serde_json::json!([digest, shard, inputs]);
    let fingerprint = blake3::hash(settings.to_string().as_bytes()).to_hex();
    let request = Request {
        out: &out,
        kind: "shard",
        fingerprint: &fingerprint,
        resume: !options.force,
        force: options.force,
    };
    request.fill(|store| {
        run_cells(sweep, cells.clone(), store, options, "the same command goes on")?;
        write(sweep, shard, &digest, &inputs, store, options)
    })?;
    options.control.progress.finish();
    Ok(ShardOutcome::Done)
}

/// Whether a shard's folder holds it already, whole.
///
/// # Errors
/// [`SweepError::OtherShard`] for a folder of something else, unless `force`, and [`SweepError::DamagedShard`].
pub fn complete(
    folder: &Path,
    digest: &str,
    shard: Shard,
    inputs: &Inputs,
    force: bool,
) -> Result<bool, SweepError> {
    let Some(found) = read_summary(folder)? else { return Ok(false) };
    let is_same = found.digest == digest && found.shard == shard && found.inputs == *inputs;
    if is_same {
        check_trials(folder, &found)?;
    } else if !force {
        return Err(SweepError::OtherShard { folder: folder.to_owned() });
    }
    Ok(is_same)
}

/// Writes `trials.parquet` and `shard.json`.
fn write(
    sweep: &Sweep,
    shard: Shard,
    digest: &str,
    inputs: &Inputs,
    store: &Store,
    options: &SweepOptions<'_>,
) -> Result<(), SweepError> {
    let cells = shard.range(sweep.cells().count());
    let path = store.folder().claim(TRIALS)?;
    let columns = sweep.cells().plan().columns();
    let mut file = TrialFile::create(&path, &columns)?;
    let mut step_ms = Vec::new();
    for cell in cells.clone() {
        let finished = finished_cell(sweep, cell, store, options)?;
        let values = sweep.cells().values(cell);
        let rows = CellRows { cell, values: &values, beams: finished.beams, rows: &finished.rows };
        file.push(rows.table(&columns)?)?;
        step_ms.push(mean_step_ms(&finished.rows));
    }
    let rows = file.finish()?;
    let summary = ShardSummary {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        digest: digest.to_owned(),
        shard,
        first_cell: cells.start,
        cells: cells.end - cells.start,
        rows,
        blake3: hash(&path)?,
        inputs: inputs.clone(),
        sweep: SweepSummary::of(sweep),
        run: None,
        step_ms,
    };
    write_summary(store.folder(), &summary)
}

/// Writes `shard.json`.
///
/// # Errors
/// [`SweepError`] for a file that cannot be written.
pub fn write_summary(folder: &Folder, summary: &ShardSummary) -> Result<(), SweepError> {
    let text = serde_json::to_string_pretty(summary).map_err(locsim_report::ReportError::from)?;
    Ok(folder.write(SUMMARY, text.as_bytes())?)
}

/// Mean over trials of the wall time of a filter step \[ms\], by model.
pub fn mean_step_ms(rows: &[locsim_report::TrialRow]) -> IndexMap<String, f64> {
    let mut sums = IndexMap::<String, (f64, f64)>::new();
    for row in rows {
        let (sum, count) = sums.entry(row.model.clone()).or_default();
        *sum += row.step_ms;
        *count += 1.0;
    }
    sums.into_iter().map(|(model, (sum, count))| (model, sum / count)).collect()
}

/// The summary of the shard in a folder, if there is one.
///
/// # Errors
/// [`SweepError::DamagedShard`] for a folder without a summary that can be read.
pub fn read_summary(folder: &Path) -> Result<Option<ShardSummary>, SweepError> {
    if !folder.exists() {
        return Ok(None);
    }
    let damaged = |what: String| SweepError::DamagedShard { path: folder.join(SUMMARY), what };
    let unreadable = |error: std::io::Error| damaged(format!("can't be read: {error}"));
    let mut text = Vec::new();
    let file = open(&folder.join(SUMMARY)).map_err(unreadable)?;
    file.take(MOST_SUMMARY_BYTES + 1).read_to_end(&mut text).map_err(unreadable)?;
    if text.len() as u64 > MOST_SUMMARY_BYTES {
        return Err(damaged(format!("has more than {MOST_SUMMARY_BYTES} bytes")));
    }
    let summary: ShardSummary = serde_json::from_slice(&text)
        .map_err(|error| damaged(format!("is not a shard's summary: {error}")))?;
    let Shard { of, number } = summary.shard;
    Shard::new(number, of).map_err(|error| damaged(format!("says that {error}")))?;
    if !summary.sweep.plan.is_sound() {
        return Err(damaged("has axes that don't belong together".to_owned()));
    }
    Ok(Some(summary))
}

/// Fails for a shard whose trials aren't as they were written.
///
/// # Errors
/// [`SweepError::DamagedShard`].
pub fn check_trials(folder: &Path, summary: &ShardSummary) -> Result<(), SweepError> {
    let path = folder.join(if summary.run.is_some() { RunSummary::TRIALS } else { TRIALS });
    match hash(&path) {
        Ok(found) if found == summary.blake3 => Ok(()),
        Ok(_) => {
            Err(SweepError::DamagedShard { path, what: "was cut or changed since it was written".to_owned() })
        }
        Err(SweepError::File { source, .. }) => {
            Err(SweepError::DamagedShard { path, what: format!("can't be read: {source}") })
        }
        Err(error) => Err(error),
    }
}
