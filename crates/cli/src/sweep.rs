//! `locsim sweep`, `locsim merge` and the shards of `locsim run`.

use std::path::Path;

use anyhow::{Context, anyhow, ensure};
use locsim_core::Shard;
use locsim_core::output::in_shell;
use locsim_lab::run::RunOptions;
use locsim_scenario::Scenario;
use locsim_sweep::{
    Engine, Job, MergeOptions, Merged, RunShards, ShardOutcome, ShardedRun, Sweep, SweepError, SweepOptions,
    SweepOverrides,
};
use locsim_terminal::{DONE, Failure, OutputOptions, Session, columns, say};

use crate::arguments::{self, EngineName};
use crate::{command_line, recorder, report_run, users_cache};

/// A sweep of more cells has to be confirmed: at a second for each this takes hours, and a slip in a range is the usual reason.
const UNCONFIRMED_CELLS: u32 = 10_000;

fn of_sweep(error: SweepError) -> Failure {
    let is_interruption = error.is_interruption();
    Failure::of_work(error, is_interruption)
}

/// Runs a sweep or a shard of it, or writes the scripts that call `program` to do it.
pub fn run(arguments: &arguments::Sweep, program: &Path) -> Result<u8, Failure> {
    let overrides = SweepOverrides { trials: arguments.trials, seed: arguments.seed };
    arguments.threads.set()?;
    let sweep = Sweep::load(&arguments.sweep, overrides)?;
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
    let shard = arguments.share.asked()?;
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
        say(&told(outcome, shard, shard.range(count).len(), "cells", &folder))?;
    }
    Ok(DONE)
}

/// What became of a shard.
fn told(outcome: ShardOutcome, shard: Shard, count: usize, parts: &str, folder: &Path) -> String {
    match outcome {
        ShardOutcome::Done => format!("{shard}: {count} {parts} in {}", folder.display()),
        ShardOutcome::AlreadyDone => format!("{shard}: nothing to do; {} is complete", folder.display()),
    }
}

/// Runs a shard of the trials of a run.
pub fn run_trials(arguments: &arguments::Run, scenario: Scenario, shard: Shard) -> Result<u8, Failure> {
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("results").join(&scenario.name));
    let session = Session::begin(arguments.output.quiet)?;
    let cache = arguments.cache.clone().or_else(users_cache);
    let folder = out.join(shard.folder());
    let options = SweepOptions {
        out,
        resume: arguments.resume,
        force: arguments.force,
        control: session.control(),
        cache: cache.as_deref(),
    };
    session.work_on(&folder, "trials");
    let trials = shard.range(scenario.trials).len();
    let run = ShardedRun { scenario, models: arguments.models.clone() };
    let outcome = run.run_shard(shard, &options).map_err(of_sweep)?;
    if !arguments.output.quiet {
        say(&told(outcome, shard, trials, "trials", &folder))?;
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
    let shards = arguments.share.shards.unwrap_or(1);
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
    let then = format!("then `locsim merge {}`", in_shell(&out));
    if arguments.batch.submit {
        Job::submit(&script)?;
        say(&format!("Submitted {shards} shards; {then}"))?;
    } else {
        say(&format!("`sh {}` runs {shards} shards; {then}", in_shell(&script)))?;
    }
    Ok(DONE)
}

/// Merges shards.
pub fn merge(arguments: &arguments::Merge) -> Result<u8, Failure> {
    arguments.threads.set()?;
    let session = Session::begin(arguments.output.quiet)?;
    let out = arguments.out.clone().unwrap_or_else(|| arguments.shards.join("merged"));
    if let Some(shards) = RunShards::find(&arguments.shards).map_err(of_sweep)? {
        let ShardedRun { scenario, models } = &shards.run;
        let recorder = recorder(arguments.record, &scenario.name);
        let cache = arguments.cache.clone().or_else(users_cache);
        let options = RunOptions {
            out: out.clone(),
            resume: false,
            force: arguments.force,
            command: command_line(scenario, models.as_deref()),
            control: session.control(),
            cache: cache.as_deref(),
            recorder: recorder.as_deref(),
        };
        let outcome = shards.merge(&options).map_err(of_sweep)?;
        return Ok(report_run(&outcome, &out, &arguments.output, arguments.record)?);
    }
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
