//! The `locsim-bench` command: speed, the hidden-effect suite, distribution regression.

mod arguments;

use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::ensure;
use clap::Parser;
use locsim_bench::real::{self, RealOptions};
use locsim_bench::speed::{self, Workbench};
use locsim_bench::suite::{self, SuiteOptions};
use locsim_bench::{BenchError, regression};
use locsim_report::store::{Request, Store};
use locsim_terminal::{DONE, Failure, Session, Share, exit_code, say};

use arguments::{Arguments, Command, Gap, Regression, Speed};

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let done = arguments.limits.set().map_err(Failure::from).and_then(|()| obey(&arguments.command));
    exit_code(done.map(|()| DONE)).into()
}

fn obey(command: &Command) -> Result<(), Failure> {
    match command {
        Command::Speed(arguments) => measure_speed(arguments),
        Command::Gap(arguments) => run_suite(arguments),
        Command::Regression(arguments) => measure_regression(arguments),
    }
}

fn failure(error: BenchError) -> Failure {
    let is_interruption = error.is_interruption();
    Failure::of_work(error, is_interruption)
}

fn measure_speed(arguments: &Speed) -> Result<(), Failure> {
    let session = Session::begin(arguments.quiet)?;
    let control = session.control();
    // Opened first, as a refusal after minutes of measuring would come late.
    let sweeps = arguments.sweeps.as_deref().map(|out| {
        Store::open(&Request { out, kind: "sweeps", fingerprint: "", resume: false, force: arguments.force })
    });
    let sweeps = sweeps.transpose()?;
    let bench = Workbench::prepare(&arguments.folder, control.clock, control.progress).map_err(failure)?;
    let report = bench.run(control.clock, control.progress).map_err(failure)?;
    if let Some(store) = sweeps {
        speed::sweep(&bench, store, control.clock, control.progress).map_err(failure)?;
    }
    say(&if arguments.json {
        serde_json::to_string_pretty(&report)?
    } else {
        speed::terminal_text(&report)
    })?;
    Ok(())
}

/// Runs the logs of the suite that haven't been run, and prints its table.
fn run_suite(arguments: &Gap) -> Result<(), Failure> {
    arguments.threads.set()?;
    let session = Session::begin(arguments.output.quiet)?;
    if let Some(logs) = &arguments.real {
        ensure_whole(arguments)?;
        return edit_logs(logs, arguments, &session);
    }
    let shard = if arguments.merge { None } else { arguments.share.asked()? };
    let out = match shard {
        Some(shard) => arguments.out.join(shard.folder()),
        None if arguments.merge => arguments.out.join("merged"),
        None => arguments.out.clone(),
    };
    let options = SuiteOptions {
        scenario: arguments.scenario.clone(),
        out: out.clone(),
        shard,
        shards: arguments.merge.then(|| arguments.out.clone()),
        size: arguments.size,
        groups: arguments.groups.clone(),
        setups: arguments.setups.clone(),
        seed: arguments.seed,
        replicates: arguments.replicates,
        scans: arguments.scans as usize,
        control: session.control(),
        no_later: arguments.minutes.map(|minutes| Duration::from_secs(60 * minutes)),
    };
    let score = suite::run(&options).map_err(failure)?;
    if arguments.output.json {
        say(&serde_json::to_string_pretty(&score)?)?;
    } else if !arguments.output.quiet {
        say(&suite::table(&score))?;
        let report = out.join(suite::REPORT);
        say(&format!("{} of {} logs; report in {}", score.runs, score.planned, report.display()))?;
    }
    Ok(())
}

/// Edited logs are not run in shards.
fn ensure_whole(arguments: &Gap) -> anyhow::Result<()> {
    let Share { shard, shards } = arguments.share;
    ensure!(shard.is_none() && shards.is_none(), "--shard and --shards are not allowed beside --real");
    Ok(())
}

/// Searches edited logs that haven't been searched, and prints the table.
fn edit_logs(logs: &Path, arguments: &Gap, session: &Session) -> Result<(), Failure> {
    let options = RealOptions {
        logs: logs.to_owned(),
        out: arguments.out.clone(),
        seed: arguments.seed,
        permutations: arguments.replicates,
        scans: arguments.scans as usize,
        max_range_m: arguments.max_range,
        control: session.control(),
        no_later: arguments.minutes.map(|minutes| Duration::from_secs(60 * minutes)),
    };
    let score = real::run(&options).map_err(failure)?;
    if arguments.output.json {
        say(&serde_json::to_string_pretty(&score)?)?;
    } else if !arguments.output.quiet {
        say(&real::table(&score))?;
        let report = arguments.out.join(real::REPORT);
        say(&format!("{} of {} searches; report in {}", score.runs, score.planned, report.display()))?;
    }
    Ok(())
}

fn measure_regression(arguments: &Regression) -> Result<(), Failure> {
    if let Some(folder) = &arguments.folder {
        check_task(folder)?;
    }
    let session = Session::begin(true)?;
    let report = regression::run(session.control().clock).map_err(failure)?;
    say(&if arguments.json {
        serde_json::to_string_pretty(&report)?
    } else {
        regression::terminal_text(&report)
    })?;
    Ok(())
}

fn check_task(folder: &Path) -> anyhow::Result<()> {
    ensure!(
        folder.join("task.py").is_file(),
        "{} is not allowed; the folder that holds task.py",
        folder.display()
    );
    Ok(())
}
