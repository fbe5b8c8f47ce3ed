//! Results of a whole sweep, from its cells or from its shards. Both ways write the same bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};

use indexmap::IndexMap;
use locsim_core::output::in_shell;
use locsim_core::{Control, Shard};
use locsim_report::ReportError;
use locsim_report::store::{Folder, Request, Store};
use locsim_report::trial_set::{CellRows, Table, TrialSet, for_each, plain, read};
use rayon::prelude::*;

use crate::cells::{Figures, Place};
use crate::page;
use crate::plan::Cells;
use crate::results::{Merged, ModelFigures};
use crate::run::{Inputs, SweepOptions, check, finished_cell, run_cells};
use crate::shard::{ShardSummary, SweepSummary, TRIALS, check_trials, mean_step_ms, read_summary};
use crate::{Sweep, SweepError};

/// Name of the data set of trials.
const DATA_SET: &str = "trials";
/// An error lists this many shards of a kind at the most.
const LISTED: usize = 20;

/// How to merge.
pub struct MergeOptions<'a> {
    /// The folder with the shards.
    pub shards: PathBuf,
    /// The results folder.
    pub out: PathBuf,
    /// Whether earlier results may be replaced.
    pub force: bool,
    /// The caller's progress.
    pub control: Control<'a>,
}

/// Runs all cells of a sweep on this machine and writes the results folder, which is written beside its place and renamed when
/// complete.
///
/// # Errors
/// [`SweepError`]; earlier results at `options.out` are then untouched, and finished cells are kept.
pub fn run_sweep(sweep: &Sweep, options: &SweepOptions<'_>) -> Result<Merged, SweepError> {
    let all = 0..sweep.cells().count();
    let inputs = check(sweep, all.clone(), options.control)?;
    let whole = Whole { summary: SweepSummary::of(sweep), digest: sweep.digest(), inputs };
    let merged = whole.fill(&options.out, options.resume, options.force, |store| {
        run_cells(sweep, all.clone(), store, options, "add --resume to go on")?;
        options.control.progress.stage("writing results", u64::from(all.end));
        let columns = sweep.cells().plan().columns();
        let mut times = Vec::new();
        let tables = all.clone().map(|cell| {
            let finished = finished_cell(sweep, cell, store, options)?;
            times.push(mean_step_ms(&finished.rows));
            let values = sweep.cells().values(cell);
            let rows = CellRows { cell, values: &values, beams: finished.beams, rows: &finished.rows };
            options.control.progress.advance(1);
            Ok(rows.table(&columns)?)
        });
        let (merged, figures) = whole.write_trials(store.folder(), sweep.cells(), tables)?;
        write_times(store.folder(), &times)?;
        page::write(store.folder(), sweep.cells(), &merged, &figures)?;
        Ok(merged)
    })?;
    options.control.progress.finish();
    Ok(merged)
}

/// Merges the shards in a folder into the results that one machine would have written.
///
/// # Errors
/// [`SweepError::Unmergeable`] with every shard that is missing, damaged, doubled, or of another sweep, and the commands that
/// mend it. Nothing is written then.
pub fn merge(options: &MergeOptions<'_>) -> Result<Merged, SweepError> {
    let shards = Shards::find(&options.shards)?;
    let first = &shards.whole[0].1;
    let mut inputs = Inputs::new();
    shards.whole.iter().for_each(|(_, summary)| inputs.extend(summary.inputs.clone()));
    let whole = Whole { summary: first.sweep.clone(), digest: first.digest.clone(), inputs };
    let cells = Cells::of(whole.summary.plan.clone()).ok_or_else(|| SweepError::DamagedShard {
        path: shards.whole[0].0.clone(),
        what: "has more cells than are allowed".to_owned(),
    })?;
    for (folder, summary) in &shards.whole {
        let found = summary.first_cell..summary.first_cell.saturating_add(summary.cells);
        if found != summary.shard.range(cells.count()) {
            let what = format!("has the cells {found:?}, which aren't those of {}", summary.shard);
            return Err(SweepError::DamagedShard { path: folder.clone(), what });
        }
    }
    let merged = whole.fill(&options.out, false, options.force, |store| {
        options.control.progress.stage("merging shards", shards.whole.len() as u64);
        let tables = shards.whole.iter().flat_map(|(folder, _)| {
            options.control.progress.advance(1);
            match read(&folder.join(TRIALS)) {
                Ok(tables) => Box::new(tables.map(|table| Ok(table?))) as Box<dyn Iterator<Item = _>>,
                Err(error) => Box::new(std::iter::once(Err(SweepError::from(error)))),
            }
        });
        let (merged, figures) = whole.write_trials(store.folder(), &cells, tables)?;
        let times: Vec<_> = shards.whole.iter().flat_map(|(_, summary)| summary.step_ms.clone()).collect();
        write_times(store.folder(), &times)?;
        page::write(store.folder(), &cells, &merged, &figures)?;
        Ok(merged)
    })?;
    options.control.progress.finish();
    Ok(merged)
}

/// A sweep whose cells are all there.
struct Whole {
    summary: SweepSummary,
    digest: String,
    inputs: Inputs,
}

impl Whole {
    /// Fills a results folder, which is then renamed into place.
    fn fill(
        &self,
        out: &Path,
        resume: bool,
        force: bool,
        write: impl FnOnce(&Store) -> Result<Merged, SweepError>,
    ) -> Result<Merged, SweepError> {
        let settings = serde_json::json!([self.digest, self.inputs]);
        let fingerprint = blake3::hash(settings.to_string().as_bytes()).to_hex();
        Request { out, kind: "sweep", fingerprint: &fingerprint, resume, force }.fill(write)
    }

    /// Writes the data set, `cells.csv` and `sweep.json`.
    fn write_trials(
        &self,
        folder: &Folder,
        cells: &Cells,
        tables: impl Iterator<Item = Result<Table, SweepError>>,
    ) -> Result<(Merged, Figures), SweepError> {
        let mut set = TrialSet::new(folder, DATA_SET);
        let mut figures = Figures::default();
        for table in tables {
            let table = table?;
            for_each(&table, |row| figures.add(&row))?;
            set.push(&table)?;
        }
        let rows = set.finish()?.values().sum();
        let places = figures.places();
        write_cells(folder, cells, &figures, &places)?;
        let placed = |model: usize, place: Place| {
            let found =
                figures.cells.iter().zip(&places).flat_map(|(cell, places)| cell.models.iter().zip(places));
            found.filter(|((other, _), found)| *other == model && **found == place).count()
        };
        let models = figures.models.iter().enumerate().map(|(i, label)| {
            let total = figures.total(i);
            let model = ModelFigures {
                trials: total.trials(),
                lost_share: total.lost_share(),
                lost_share_interval: total.lost_interval(),
                position_rmse_m: total.rmse_m(),
                position_rmse_interval: total.rmse_interval(),
                cells_best: placed(i, Place::Best),
                cells_tied: placed(i, Place::Tied),
            };
            (label.clone(), model)
        });
        let merged = Merged {
            name: self.summary.name.clone(),
            description: self.summary.description.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            digest: self.digest.clone(),
            inputs: self.inputs.clone(),
            plan: self.summary.plan.clone(),
            cells: cells.count(),
            rows,
            models: models.collect(),
        };
        let text = serde_json::to_string_pretty(&merged).map_err(ReportError::from)?;
        folder.write("sweep.json", format!("{text}\n").as_bytes())?;
        Ok((merged, figures))
    }
}

/// `cells.csv`: one row for each cell and model.
fn write_cells(
    folder: &Folder,
    cells: &Cells,
    figures: &Figures,
    places: &[Vec<Place>],
) -> Result<(), SweepError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let axes = cells.plan().axes.iter().map(crate::plan::Axis::column);
    let fixed = [
        "model",
        "trials",
        "lost_share",
        "lost_share_lo",
        "lost_share_hi",
        "position_rmse_m",
        "position_rmse_lo_m",
        "position_rmse_hi_m",
        "particles_mean",
        "beams",
        "place",
    ];
    let header = std::iter::once("cell".to_owned()).chain(axes).chain(["cell_seed".to_owned()]);
    writer.write_record(header.chain(fixed.map(str::to_owned))).map_err(ReportError::from)?;
    let number = |value: f64| if value.is_finite() { value.to_string() } else { String::new() };
    let seeded = cells.plan().axis("seed");
    let lines: Vec<Vec<Vec<String>>> = figures
        .cells
        .par_iter()
        .zip(places)
        .map(|(cell, places)| {
            let values = cells.values(cell.cell);
            let seed = seeded.map_or_else(|| cells.seed(cell.cell).to_string(), |axis| plain(&values[axis]));
            let line = |((model, tally), place): (&(usize, crate::cells::Tally), &Place)| {
                let lost = tally.lost_interval();
                let rmse = tally.rmse_interval();
                let mut line = vec![cell.cell.to_string()];
                line.extend(values.iter().map(plain));
                line.extend([seed.clone(), figures.models[*model].clone(), tally.trials().to_string()]);
                line.extend([tally.lost_share(), lost.lo, lost.hi, tally.rmse_m()].map(number));
                line.extend(
                    [rmse.map(|rmse| rmse.lo), rmse.map(|rmse| rmse.hi)]
                        .map(|v| v.map_or_else(String::new, number)),
                );
                line.extend([number(tally.particles()), cell.beams.to_string(), place.word().to_owned()]);
                line
            };
            cell.models.iter().zip(places).map(line).collect()
        })
        .collect();
    for line in lines.iter().flatten() {
        writer.write_record(line).map_err(ReportError::from)?;
    }
    let bytes = writer.into_inner().map_err(|error| ReportError::Csv(error.into_error().into()))?;
    Ok(folder.write("cells.csv", &bytes)?)
}

/// `times.csv`: wall times, the one file that a repeated sweep doesn't reproduce.
fn write_times(folder: &Folder, times: &[IndexMap<String, f64>]) -> Result<(), SweepError> {
    let mut text = "cell,model,step_ms\n".to_owned();
    for (cell, models) in times.iter().enumerate() {
        for (model, ms) in models {
            // Writing to a string can't fail.
            let _ = writeln!(text, "{cell},{model},{ms:.6}");
        }
    }
    Ok(folder.write("times.csv", text.as_bytes())?)
}

/// The shards of a sweep or a run, each of them once, in their order.
pub struct Shards {
    /// Folders and summaries.
    pub whole: Vec<(PathBuf, ShardSummary)>,
}

impl Shards {
    /// The folders of shards in a folder, whole or not.
    ///
    /// # Errors
    /// [`SweepError::NoFolder`] and [`SweepError::File`].
    pub fn folders(folder: &Path) -> Result<Vec<PathBuf>, SweepError> {
        if !folder.is_dir() {
            let what = if folder.exists() { "it is a file" } else { "nothing is there" };
            return Err(SweepError::NoFolder { path: folder.to_owned(), what });
        }
        let unreadable = |source| SweepError::File { path: folder.to_owned(), source };
        let mut folders = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(unreadable)? {
            let entry = entry.map_err(unreadable)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let is_work = [".partial", ".old"].iter().any(|ending| name.ends_with(ending));
            if name.starts_with("shard-") && !is_work && entry.path().is_dir() {
                folders.push(entry.path());
            }
        }
        folders.sort_unstable();
        Ok(folders)
    }

    /// The shards in a folder.
    ///
    /// # Errors
    /// [`SweepError::Unmergeable`] unless each is there once, whole, and of the same work.
    pub fn find(folder: &Path) -> Result<Self, SweepError> {
        let folders = Self::folders(folder)?;
        let read = folders.into_par_iter().map(|folder| {
            let found = read_summary(&folder).and_then(|summary| {
                summary.iter().try_for_each(|summary| check_trials(&folder, summary))?;
                Ok(summary)
            });
            (folder, found)
        });
        let mut problems = Vec::new();
        let mut damaged = BTreeSet::new();
        let mut whole = Vec::new();
        for (folder, found) in read.collect::<Vec<_>>() {
            match found {
                Ok(Some(summary)) => whole.push((folder, summary)),
                Ok(None) => {}
                Err(error) => {
                    problems.push(error.to_string());
                    damaged.insert(folder);
                }
            }
        }
        let Some(first) = usual(&whole) else {
            problems.push(format!("{}: there is no whole shard", folder.display()));
            return Err(SweepError::Unmergeable { problems });
        };
        let of = first.shard.of;
        problems.extend(listed(whole.iter().filter_map(|(folder, summary)| other(folder, summary, &first))));
        let mut places: BTreeMap<u32, &Path> = BTreeMap::new();
        for (folder, summary) in
            whole.iter().filter(|(folder, summary)| other(folder, summary, &first).is_none())
        {
            if let Some(before) = places.insert(summary.shard.number, folder) {
                problems.push(format!(
                    "{} is there twice: {} and {}; remove one of them",
                    summary.shard,
                    before.display(),
                    folder.display()
                ));
            }
        }
        let missing: Vec<u32> = (1..=of).filter(|number| !places.contains_key(number)).collect();
        if !missing.is_empty() {
            problems.push(absent(folder, &missing, &damaged, &first));
        }
        if !problems.is_empty() {
            return Err(SweepError::Unmergeable { problems });
        }
        whole.sort_by_key(|(_, summary)| summary.shard);
        Ok(Self { whole })
    }
}

/// The summary of the sweep that most shards are of, the first of them.
fn usual(whole: &[(PathBuf, ShardSummary)]) -> Option<ShardSummary> {
    let kind = |summary: &ShardSummary| (summary.digest.clone(), summary.shard.of);
    let mut counts = IndexMap::<_, usize>::new();
    for (_, summary) in whole {
        *counts.entry(kind(summary)).or_default() += 1;
    }
    // The first of several that are as frequent.
    let usual = counts.iter().rev().max_by_key(|(_, count)| **count)?.0;
    whole.iter().map(|(_, summary)| summary).find(|summary| kind(summary) == *usual).cloned()
}

/// How a shard is of another sweep than the others, if it is.
fn other(folder: &Path, summary: &ShardSummary, first: &ShardSummary) -> Option<String> {
    let reason = if summary.version != first.version {
        format!("it is of locsim {}, not {}", summary.version, first.version)
    } else if summary.digest != first.digest {
        let short = |digest: &str| digest.chars().take(12).collect::<String>();
        format!(
            "its digest {} is not {}: scenario, {}seed or trials differ",
            short(&summary.digest),
            short(&first.digest),
            if first.run.is_some() { "a file that it reads, " } else { "axes, " }
        )
    } else if summary.shard.of != first.shard.of {
        format!("it is one of {} shards, not of {}", summary.shard.of, first.shard.of)
    } else {
        let differs =
            |(path, hash): (&String, &String)| first.inputs.get(path).is_some_and(|other| other != hash);
        let path = summary.inputs.iter().find(|(path, hash)| differs((path, hash))).map(|(path, _)| path)?;
        format!("it read another content of {path}")
    };
    let work = if first.run.is_some() { "run" } else { "sweep" };
    Some(format!("{} is of another {work}: {reason}; remove it and run the shard again", folder.display()))
}

/// The first lines, and how many others there are.
fn listed(lines: impl Iterator<Item = String>) -> Vec<String> {
    let mut lines: Vec<String> = lines.collect();
    if lines.len() > LISTED {
        let more = lines.len() - LISTED;
        lines.truncate(LISTED);
        lines.push(format!("and {more} more"));
    }
    lines
}

/// Which shards are to be run again, and how.
fn absent(folder: &Path, missing: &[u32], damaged: &BTreeSet<PathBuf>, first: &ShardSummary) -> String {
    let of = first.shard.of;
    let kept = |number: &&u32| {
        let out = folder.join(Shard { number: **number, of }.folder());
        locsim_report::store::kept(&out).is_ok_and(|cells| cells > 0)
    };
    let begun = missing.iter().filter(kept).count();
    let mut text = format!("{} of {of} shards are missing: {}", missing.len(), ranges(missing));
    if begun > 0 {
        let parts = if first.run.is_some() { "trials" } else { "cells" };
        let _ = write!(text, " ({begun} of them keep finished {parts})");
    }
    text.push_str("; run them:\n");
    for folder in damaged {
        let _ = writeln!(text, "  rm -r {}", in_shell(folder));
    }
    let command =
        |shard: &str| format!("{} --out {} --shard {shard}/{of}", first.command(), in_shell(folder));
    let line = if let [one] = missing {
        command(&one.to_string())
    } else {
        let numbers = missing.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
        format!("for i in {numbers}; do {}; done", command("$i"))
    };
    text.push_str("  ");
    text.push_str(&line);
    text
}

/// `1-3,7`: as batch engines take the numbers of tasks.
pub fn ranges(numbers: &[u32]) -> String {
    let runs = numbers.chunk_by(|a, b| a + 1 == *b).map(|run| match run {
        [first, .., last] => format!("{first}-{last}"),
        _ => run.iter().map(u32::to_string).collect(),
    });
    runs.collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shards of made-up trials, to measure the merge of many: 1,000 of them with 10^7 rows, into the folder
    /// `LOCSIM_SYNTHETIC_SHARDS`.
    #[test]
    #[ignore = "writes a gigabyte; for measurements"]
    fn synthesize_shards() {
        use locsim_report::TrialRow;
        use locsim_report::trial_set::TrialFile;

        use crate::plan::{Axis, Plan};
        use crate::shard::write_summary;

        let out = PathBuf::from(std::env::var("LOCSIM_SYNTHETIC_SHARDS").unwrap());
        let (of, trials) = (1000, 143);
        let axis = |key: &str, count: i64| Axis {
            key: key.to_owned(),
            values: (0..count).map(Into::into).collect(),
        };
        let axes = vec![axis("filter.particles", 1000), axis("laser.beams", 10)];
        let plan = Plan {
            seed: 1,
            trials: Some(trials),
            axes,
            groups: vec![vec![0], vec![1]],
            conditions: Vec::new(),
        };
        let (columns, cells) = (plan.columns(), Cells::of(plan.clone()).unwrap());
        let row = |cell: u32, trial: u32, model: u32| {
            // Figures without a pattern, which don't shrink.
            let draw = locsim_core::Draw::new(u64::from(cell), locsim_core::Stage::Sweep, 7 * trial + model);
            let real = |item: u32| draw.seed(item) as f64 / u64::MAX as f64;
            TrialRow {
                trial,
                seed: draw.seed(0),
                model: format!("model_{model}"),
                steps: 100,
                lost: real(1) < 0.1,
                position_rmse_m: real(2),
                position_median_m: real(3),
                position_p95_m: real(4),
                position_max_m: real(5),
                position_final_m: real(6),
                along_mean_m: real(7),
                along_std_m: real(8),
                across_mean_m: real(9),
                across_std_m: real(10),
                heading_mean_rad: real(11),
                heading_std_rad: real(12),
                ess_mean: real(13),
                resamplings: 50,
                log_evidence_nats: real(14),
                particles_mean: f64::from(cell / 10 + 1),
                step_ms: real(15),
                events: Vec::new(),
            }
        };
        (1..=of).into_par_iter().for_each(|number| {
            let shard = Shard { of, number };
            let folder = Folder::new(&out.join(shard.folder())).unwrap();
            let path = folder.claim(TRIALS).unwrap();
            let mut file = TrialFile::create(&path, &columns).unwrap();
            let range = shard.range(cells.count());
            let mut step_ms = Vec::new();
            for cell in range.clone() {
                let rows: Vec<TrialRow> =
                    (0..trials).flat_map(|trial| (0..7).map(move |model| row(cell, trial, model))).collect();
                let values = cells.values(cell);
                file.push(
                    CellRows { cell, values: &values, beams: 36, rows: &rows }.table(&columns).unwrap(),
                )
                .unwrap();
                step_ms.push(mean_step_ms(&rows));
            }
            let summary = ShardSummary {
                version: env!("CARGO_PKG_VERSION").to_owned(),
                digest: "synthetic".to_owned(),
                shard,
                first_cell: range.start,
                cells: range.end - range.start,
                rows: file.finish().unwrap(),
                blake3: crate::run::hash(&path).unwrap(),
                inputs: Inputs::new(),
                sweep: SweepSummary {
                    name: "synthetic".to_owned(),
                    description: String::new(),
                    file: PathBuf::from("synthetic.yaml"),
                    plan: plan.clone(),
                },
                run: None,
                step_ms,
            };
            write_summary(&folder, &summary).unwrap();
        });
    }

    #[test]
    fn numbers_of_tasks_are_written_as_ranges() {
        assert_eq!(ranges(&[1, 2, 3, 7, 9, 10]), "1-3,7,9-10");
        assert_eq!(ranges(&[5]), "5");
        assert_eq!(ranges(&[]), "");
    }
}
