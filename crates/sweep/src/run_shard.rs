//! Shards of one run: shares of its trials. Their merge writes the results folder that the run would have written.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use indexmap::IndexMap;
use locsim_core::Shard;
use locsim_core::output::write_file;
use locsim_lab::run::{Outcome, RunOptions, run_share, run_with};
use locsim_report::results::Trial;
use locsim_report::store::{Request, Store};
use locsim_scenario::{Overrides, Scenario};

use crate::merge::Shards;
use crate::plan::Plan;
use crate::run::{Inputs, hash};
use crate::shard::{
    RunSummary, ShardOutcome, ShardSummary, SweepSummary, complete, read_summary, write_summary,
};
use crate::{SweepError, SweepOptions};

/// A scenario whose trials are run in shards.
#[derive(Clone, Debug)]
pub struct ShardedRun {
    /// The scenario.
    pub scenario: Scenario,
    /// The models that it was restricted to, if it was.
    pub models: Option<Vec<String>>,
}

impl ShardedRun {
    /// A hash (BLAKE3, hexadecimal) of everything that the results depend on, the number of trials included.
    fn digest(&self) -> Result<String, SweepError> {
        let settings = serde_json::json!([self.scenario.content_hash()?, self.scenario.trials]);
        Ok(blake3::hash(settings.to_string().as_bytes()).to_hex().to_string())
    }

    /// Runs the trials of a shard into its folder in `options.out`, which is renamed into place when it is complete.
    ///
    /// # Errors
    /// [`SweepError`]; finished trials are kept, and the same call goes on with them.
    pub fn run_shard(&self, shard: Shard, options: &SweepOptions<'_>) -> Result<ShardOutcome, SweepError> {
        let trials = self.scenario.trials;
        if shard.of > trials {
            return Err(SweepError::TooManyShards { shards: shard.of, parts: trials, part: "trial" });
        }
        let digest = self.digest()?;
        let out = options.out.join(shard.folder());
        if complete(&out, &digest, shard, &Inputs::new(), options.force)? {
            return Ok(ShardOutcome::AlreadyDone);
        }
        let settings = serde_json::json!([digest, shard]);
        let fingerprint = blake3::hash(settings.to_string().as_bytes()).to_hex();
        let request = Request {
            out: &out,
            kind: "shard",
            fingerprint: &fingerprint,
            resume: !options.force,
            force: options.force,
        };
        request.fill(|store| {
            let numbers = shard.range(trials);
            let done = run_share(&self.scenario, numbers.clone(), store, options.cache, options.control);
            let done = done.map_err(|error| match error {
                error if error.is_interruption() => match store.parts().kept() {
                    Ok(finished) => SweepError::Interrupted {
                        finished,
                        of: numbers.end - numbers.start,
                        parts: "trials",
                        again: "the same command goes on",
                    },
                    Err(error) => error.into(),
                },
                error => error.into(),
            })?;
            self.write(shard, &digest, &done, store)
        })?;
        options.control.progress.finish();
        Ok(ShardOutcome::Done)
    }

    /// Writes `trials.cbor` and `shard.json`.
    fn write(&self, shard: Shard, digest: &str, trials: &[Trial], store: &Store) -> Result<(), SweepError> {
        let Scenario { file, name, description, seed, trials: count, .. } = &self.scenario;
        let run = RunSummary { models: self.models.clone() };
        let path = store.folder().claim(RunSummary::TRIALS)?;
        write_file(&path, |out| ciborium::into_writer(trials, out).map_err(std::io::Error::other))
            .map_err(|source| SweepError::File { path: path.clone(), source })?;
        let numbers = shard.range(*count);
        let plan = Plan {
            seed: *seed,
            trials: Some(*count),
            axes: Vec::new(),
            groups: Vec::new(),
            conditions: Vec::new(),
        };
        let summary = ShardSummary {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            digest: digest.to_owned(),
            shard,
            first_cell: numbers.start,
            cells: numbers.end - numbers.start,
            rows: trials.iter().map(|trial| trial.models.len() as u64).sum(),
            blake3: hash(&path)?,
            inputs: Inputs::new(),
            sweep: SweepSummary {
                name: name.clone(),
                description: description.clone(),
                file: file.clone(),
                plan,
            },
            run: Some(run),
            step_ms: Vec::<IndexMap<_, _>>::new(),
        };
        write_summary(store.folder(), &summary)
    }
}

/// The shards of a run, all of them.
pub struct RunShards {
    /// The run.
    pub run: ShardedRun,
    /// Their folders.
    folders: Vec<PathBuf>,
}

impl RunShards {
    /// The shards in a folder; `None` where the first of them is of a sweep, or there is none.
    ///
    /// # Errors
    /// [`SweepError::Unmergeable`] as [`merge`](crate::merge()), and a scenario that has changed since.
    pub fn find(folder: &Path) -> Result<Option<Self>, SweepError> {
        let first = Shards::folders(folder)?.iter().find_map(|found| read_summary(found).ok().flatten());
        let Some(RunSummary { models }) = first.and_then(|summary| summary.run) else { return Ok(None) };
        let shards = Shards::find(folder)?;
        let summary = &shards.whole[0].1;
        let Plan { seed, trials, .. } = summary.sweep.plan;
        let overrides = Overrides { trials, seed: Some(seed), models: models.clone() };
        let run = ShardedRun { scenario: Scenario::load(&summary.sweep.file, &overrides)?, models };
        if run.digest()? != summary.digest {
            return Err(SweepError::ChangedScenario { file: summary.sweep.file.clone() });
        }
        Ok(Some(Self { run, folders: shards.whole.into_iter().map(|(folder, _)| folder).collect() }))
    }

    /// Writes the results folder of the whole run.
    ///
    /// # Errors
    /// [`SweepError`]; earlier results at `options.out` are then untouched.
    pub fn merge(&self, options: &RunOptions<'_>) -> Result<Outcome, SweepError> {
        run_with(&self.run.scenario, options, |store| {
            for folder in &self.folders {
                let path = folder.join(RunSummary::TRIALS);
                let file =
                    File::open(&path).map_err(|source| SweepError::File { path: path.clone(), source })?;
                let trials: Vec<Trial> = ciborium::from_reader(BufReader::new(file)).map_err(|error| {
                    SweepError::DamagedShard { path: path.clone(), what: format!("can't be read: {error}") }
                })?;
                for trial in &trials {
                    store.parts().save(trial.trial, trial)?;
                }
            }
            Ok(())
        })
    }
}
