//! `locsim sweep` and `locsim merge`.

use std::path::Path;

use anyhow::{Context, anyhow, ensure};
use locsim_sweep::{
    Engine, Job, MergeOptions, Merged, Shard, ShardOutcome, Sweep, SweepError, SweepOptions, SweepOverrides,
};
use locsim_terminal::{DONE, Failure, OutputOptions, Session, columns, say};

use crate::arguments::{self, EngineName};
use crate::users_cache;

/// A sweep of more cells has to be confirmed: at a second for each this takes hours, and a slip in a range is the usual reason.
const UNCONFIRMED_CELLS: u32 = 10_000;

fn of_sweep(error: SweepError) -> Failure {
    let is_interruption = error.is_interruption();
    Failure::of_work(error, is_interruption)
}

/// Runs a sweep or a shard of it, or writes the scripts that call `program` to do it.
pub fn run(arguments: &arguments::Sweep, program: &Path) -> Result<u8, Failure> {
    let overrides = SweepOverrides { trials: arguments.trials, seed: arguments.seed };
    let sweep = Sweep::load(&arguments.sweep, overrides)?;
    arguments.threads.set()?;
    if arguments.dry_run {
        say(&format!("{}: {}", sweep.name, sweep.estimate(rayon::current_num_threads())?))?;
        return Ok(DONE);
    }
    let count = sweep.cells().count();
    if count > UNCONFIRMED_CELLS && !arguments.yes {
        let sizes = sweep.cells().plan().sizes();
        return Err(anyhow!(
            "{}: {count} cells ({sizes}) are not allowed; at most {UNCONFIRMED_CELLS}, or more with --yes (--dry-run tells time and \
             memory)",
            arguments.sweep.display()
        )
        .into());
    }
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("results").join(&sweep.name));
    if let Some(engine) = arguments.batch.engine {
        return Ok(submit(arguments, program, &sweep, engine, &out)?);
    }
    let environment = |name: &str| std::env::var(name).ok();
    let shard = match arguments.shard {
        Some(shard) => Some(shard),
        None => Shard::from_environment(&environment, arguments.shards).map_err(|error| anyhow!(error))?,
    };
    let session = Session::begin(arguments.output.quiet)?;
    let cache = arguments.cache.clone().or_else(users_cache);
    let options = SweepOptions {
        out: out.clone(),
        resume: arguments.earlier.resume,
        force: arguments.earlier.force,
        control: session.control(),
        cache: cache.as_deref(),
    };
    let Some(shard) = shard else {
        session.work_on(&out, "cells");
        let merged = locsim_sweep::run_sweep(&sweep, &options).map_err(of_sweep)?;
        report(&merged, &out, &arguments.output)?;
        return Ok(DONE);
    };
    let folder = out.join(shard.folder());
    session.work_on(&folder, "cells");
    let outcome = locsim_sweep::run_shard(&sweep, shard, &options).map_err(of_sweep)?;
    if !arguments.output.quiet {
        let cells = shard.cells(count).len();
        say(&match outcome {
            ShardOutcome::Done => format!("{shard}: {cells} cells in {}", folder.display()),
            ShardOutcome::AlreadyDone => format!("{shard}: nothing to do; {} is complete", folder.display()),
        })?;
    }
    Ok(DONE)
}

/// Writes the scripts of an engine, and submits them if asked for.
fn submit(
    arguments: &arguments::Sweep,
    program: &Path,
    sweep: &Sweep,
    engine: EngineName,
    out: &Path,
) -> anyhow::Result<u8> {
    let shards = arguments.shards.unwrap_or(1);
    let cells = sweep.cells().count();
    ensure!(
        (1..=cells).contains(&shards),
        "--shards: {shards} is not allowed; a whole number from 1 to {cells}, the cells"
    );
    let absolute = |path: &Path| std::path::absolute(path).with_context(|| path.display().to_string());
    let out = absolute(out)?;
    let mut words = vec!["sweep".to_owned(), absolute(&arguments.sweep)?.display().to_string()];
    words.extend(["--out".to_owned(), out.display().to_string()]);
    let numbers = [("--trials", arguments.trials.map(u64::from)), ("--seed", arguments.seed)];
    for (option, number) in numbers {
        words.extend(number.map(|number| [option.to_owned(), number.to_string()]).into_iter().flatten());
    }
    if let Some(cache) = &arguments.cache {
        words.extend(["--cache".to_owned(), absolute(cache)?.display().to_string()]);
    }
    let flags = [(arguments.yes, "--yes"), (arguments.earlier.force, "--force")];
    words.extend(flags.into_iter().filter(|(given, _)| *given).map(|(_, flag)| flag.to_owned()));
    let job = Job {
        engine: match engine {
            EngineName::Slurm => Engine::Slurm,
            EngineName::Hyperqueue => Engine::HyperQueue,
            EngineName::Parallel => Engine::Parallel,
        },
        name: sweep.name.clone(),
        shards,
        // One thread for each shard wastes no core.
        threads: arguments.threads.asked().unwrap_or(1),
        program: program.to_owned(),
        arguments: words,
        out: out.clone(),
        template: sweep.template.clone(),
    };
    let script = job.write()?;
    let then = format!("then `locsim merge {}`", out.display());
    if arguments.batch.submit {
        Job::submit(&script)?;
        say(&format!("Submitted {shards} shards; {then}"))?;
    } else {
        say(&format!("`sh {}` runs {shards} shards; {then}", script.display()))?;
    }
    Ok(DONE)
}

/// Merges shards.
pub fn merge(arguments: &arguments::Merge) -> Result<u8, Failure> {
    let session = Session::begin(arguments.output.quiet)?;
    let out = arguments.out.clone().unwrap_or_else(|| arguments.shards.join("merged"));
    let options = MergeOptions {
        shards: arguments.shards.clone(),
        out: out.clone(),
        force: arguments.force,
        control: session.control(),
    };
    let merged = locsim_sweep::merge(&options).map_err(of_sweep)?;
    report(&merged, &out, &arguments.output)?;
    Ok(DONE)
}

/// Prints the results.
fn report(merged: &Merged, out: &Path, output: &OutputOptions) -> anyhow::Result<()> {
    if output.json {
        return say(&serde_json::to_string_pretty(merged)?);
    }
    if output.quiet {
        return Ok(());
    }
    say(&format!("{}: {} cells, seed {}", merged.name, merged.cells, merged.plan.seed))?;
    say(&merged.table().to_terminal(columns()))?;
    say(&format!("Results in {} (open report.html)", out.display()))
}
