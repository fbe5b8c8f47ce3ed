//! The `locsim` command: runs scenarios, checks them, lists effects, simulates logs, builds maps, measures speed.

mod arguments;
mod interrupt;
mod progress;
mod recording;
mod terminal;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::{CommandFactory, Parser};
use locsim_bench::speed;
use locsim_bench::suite::{self, GapBenchError, GapBenchOptions};
use locsim_core::limits::{Limits, THREADS_PER_CORE};
use locsim_core::output::Output;
use locsim_dataset::{BagTopics, LogOptions};
use locsim_lab::gap::{self, GapSettings, GapStudy, GapStudyError, GapStudyOptions};
use locsim_lab::run::{self, Recorder, RunError, RunOptions};
use locsim_report::terminal_table;
use locsim_scenario::catalogue;
use locsim_scenario::{self as scenario, Overrides, Scenario};

use arguments::{Arguments, Bench, Command, Gap, Map, Record, Run, Simulate};
use interrupt::Interrupt;
use locsim_report::store::{Request, Store};
use locsim_study::{self as study, StudyError, StudyOptions, StudyOverrides};
use progress::Bars;
use terminal::{complain, say};

/// A bound that the scenario declares was missed.
const MISSED: u8 = 1;
/// Bad input.
const BAD_INPUT: u8 = 2;
/// Fewer simulated logs than this can't tell a chance of 5 %.
const LEAST_REPLICATES: u32 = 19;
/// Stopped by the user, as shells report it.
const INTERRUPTED: u8 = 130;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let limits = Limits::DEFAULT.with(arguments.limit.iter().map(String::as_str));
    let done = limits.map_err(anyhow::Error::from).and_then(|limits| {
        limits.set();
        obey(&arguments.command)
    });
    done.unwrap_or_else(|error| {
        complain(&format!("error: {}", explain(&error)));
        let interrupted = matches!(error.downcast_ref(), Some(RunError::Interrupted { .. }))
            || matches!(error.downcast_ref(), Some(StudyError::Interrupted))
            || error.downcast_ref::<GapBenchError>().is_some_and(GapBenchError::is_interruption)
            || error.downcast_ref().is_some_and(GapStudyError::is_interruption);
        ExitCode::from(if interrupted { INTERRUPTED } else { BAD_INPUT })
    })
}

fn obey(command: &Command) -> Result<ExitCode> {
    match command {
        Command::Run(arguments) => run(arguments),
        Command::Study(arguments) => run_studies(arguments),
        Command::BenchRegression(arguments) => bench_regression(arguments),
        Command::Validate { scenarios } => validate(scenarios),
        Command::Schema { study } => print_schema(*study),
        Command::Effects { name } => effects(name.as_deref()),
        Command::Simulate(arguments) => simulate(arguments),
        Command::Gap(arguments) => gap(arguments),
        Command::Map(arguments) => map(arguments),
        Command::Bench(arguments) => bench(arguments),
        Command::GapBench(arguments) => run_gap_bench(arguments),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Arguments::command(), "locsim", &mut script);
            say(&String::from_utf8(script)?)?;
            Ok(ExitCode::SUCCESS)
        }
    }
}

/// An error with its causes; a cause that the message quotes already isn't said again.
fn explain(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

fn run(arguments: &Run) -> Result<ExitCode> {
    let overrides =
        Overrides { trials: arguments.trials, seed: arguments.seed, models: arguments.models.clone() };
    let scenario = Scenario::load(&arguments.scenario, &overrides)?;
    use_threads(arguments.threads)?;
    let interrupt = Interrupt::listen()?;
    #[expect(clippy::disallowed_methods, reason = "the binary is where time is taken")]
    let start = Instant::now();
    let clock = || start.elapsed();
    let bars = Bars::new(arguments.quiet || !std::io::stderr().is_terminal());
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("results").join(&scenario.name));
    let recorder = recorder(arguments.record, &scenario.name);
    let cache = arguments.cache.clone().or_else(users_cache);
    let options = RunOptions {
        out: out.clone(),
        resume: arguments.resume,
        force: arguments.force,
        command: command_line(arguments, &scenario),
        clock: &clock,
        progress: &bars,
        interrupted: interrupt.flag(),
        cache: cache.as_deref(),
        recorder: recorder.as_deref(),
    };
    interrupt.work_on(&out, "trials");
    let outcome = run::run(&scenario, &options)?;
    if arguments.json {
        say(&serde_json::to_string_pretty(&outcome.summary)?)?;
    } else if !arguments.quiet {
        say(&terminal_table(&outcome.summary))?;
        let replay = if arguments.record == Record::File {
            format!("; `rerun {}` replays", out.join(run::RECORDING).display())
        } else {
            String::new()
        };
        say(&format!("Results in {} (open report.html{replay})", out.display()))?;
    }
    for missed in &outcome.missed {
        complain(&format!("missed: {missed}"));
    }
    Ok(if outcome.missed.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(MISSED) })
}

/// Runs what of the suite hasn't been run, and prints its table.
fn run_gap_bench(arguments: &arguments::GapBench) -> Result<ExitCode> {
    use_threads(arguments.threads)?;
    let interrupt = Interrupt::listen()?;
    #[expect(clippy::disallowed_methods, reason = "the binary is where time is taken")]
    let start = Instant::now();
    let clock = || start.elapsed();
    let bars = Bars::new(arguments.quiet || !std::io::stderr().is_terminal());
    let options = GapBenchOptions {
        scenario: arguments.scenario.clone(),
        out: arguments.out.clone(),
        size: match arguments.size {
            arguments::Size::Small => suite::Size::Small,
            arguments::Size::Medium => suite::Size::Medium,
            arguments::Size::Full => suite::Size::Full,
        },
        seed: arguments.seed,
        replicates: arguments.replicates,
        scans: arguments.scans as usize,
        clock: &clock,
        progress: &bars,
        interrupted: interrupt.flag(),
        no_later: arguments.minutes.map(|minutes| Duration::from_secs(60 * minutes)),
    };
    let score = suite::run(&options)?;
    if arguments.json {
        say(&serde_json::to_string_pretty(&score)?)?;
    } else if !arguments.quiet {
        say(&suite::table(&score))?;
        say(&format!(
            "{} of {} logs; report in {}",
            score.runs,
            score.planned,
            arguments.out.join(suite::REPORT).display()
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Limits the worker threads.
fn use_threads(threads: Option<usize>) -> Result<()> {
    if let Some(threads) = threads {
        let most = THREADS_PER_CORE * std::thread::available_parallelism().map_or(1, usize::from);
        anyhow::ensure!(
            (1..=most).contains(&threads),
            "--threads: {threads} is not allowed; a whole number from 1 to {most}, {THREADS_PER_CORE} for each core"
        );
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    Ok(())
}

/// Runs every study that can be read; one that can't doesn't keep the others from running.
fn run_studies(arguments: &arguments::Study) -> Result<ExitCode> {
    let overrides =
        StudyOverrides { repeats: arguments.repeats, seed: arguments.seed, quick: arguments.quick };
    use_threads(arguments.threads)?;
    let interrupt = Interrupt::listen()?;
    let bars = Bars::new(arguments.quiet || !std::io::stderr().is_terminal());
    let mut refused = false;
    for path in &arguments.studies {
        let study = match study::Study::load(path, overrides) {
            Ok(study) => study,
            Err(error) => {
                refused = true;
                complain(&format!("error: {error}"));
                continue;
            }
        };
        let out = arguments.out.join(&study.name);
        let options = StudyOptions {
            out: out.clone(),
            resume: arguments.resume,
            force: arguments.force,
            progress: &bars,
            interrupted: interrupt.flag(),
        };
        interrupt.work_on(&out, "repeats");
        let results = study::run(&study, &options)?;
        if arguments.json {
            say(&serde_json::to_string(&results)?)?;
        } else if !arguments.quiet {
            say(&study::terminal_summary(&results))?;
            say(&format!("Results in {} (open report.html)", out.display()))?;
        }
    }
    Ok(if refused { ExitCode::from(BAD_INPUT) } else { ExitCode::SUCCESS })
}

/// Runs the regression's fixed task.
fn bench_regression(arguments: &arguments::BenchRegression) -> Result<ExitCode> {
    if let Some(folder) = &arguments.folder {
        let script = folder.join("task.py");
        anyhow::ensure!(
            script.is_file(),
            "{} is not allowed; the folder that holds task.py",
            folder.display()
        );
    }
    #[expect(clippy::disallowed_methods, reason = "the binary is where time is taken")]
    let start = Instant::now();
    let report = distreg::benchmark::run(&|| start.elapsed())?;
    if arguments.json {
        say(&serde_json::to_string_pretty(&report)?)?;
    } else {
        let (ms, gauss, mixed) = (report.predict_ms, report.risk_mm.gauss, report.risk_mm.mixed);
        say(&format!(
            "200 queries [ms]: faithful {:.3}, on two threads {:.3}, registered {:.3}\n\
             one density from a table [ns]: {:.2}\n\
             risk, gauss [mm]: faithful {:.3}, registered {:.3} (by {}), p_reg {:.3}\n\
             risk, mixed [mm]: faithful {:.3}, registered {:.3} (by {}), p_reg {:.3}\n\
             largest difference from the dense product: {:.1e}",
            ms.faithful,
            ms.faithful_2_threads,
            ms.registered,
            report.density_ns,
            gauss.faithful,
            gauss.registered,
            report.registered_by.gauss,
            gauss.p_reg,
            mixed.faithful,
            mixed.registered,
            report.registered_by.mixed,
            mixed.p_reg,
            report.max_abs_diff_from_dense
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Where programs keep what they can do without, for this user.
fn users_cache() -> Option<PathBuf> {
    directories::BaseDirs::new().map(|user| user.cache_dir().join("locsim"))
}

/// The command that repeats a run.
fn command_line(arguments: &Run, scenario: &Scenario) -> String {
    let mut command = format!(
        "locsim run {} --seed {} --trials {}",
        arguments.scenario.display(),
        scenario.seed,
        scenario.trials
    );
    if let Some(models) = &arguments.models {
        command += " --models ";
        command += &models.join(",");
    }
    command
}

fn recorder(record: Record, scenario: &str) -> Option<Box<Recorder<'static>>> {
    let scenario = scenario.to_owned();
    match record {
        Record::None => None,
        Record::File => Some(Box::new(move |trial, path| {
            Ok(recording::record(trial, &scenario, recording::Sink::File(path))?)
        })),
        Record::Connect => {
            Some(Box::new(move |trial, _| Ok(recording::record(trial, &scenario, recording::Sink::Connect)?)))
        }
        Record::Spawn => {
            Some(Box::new(move |trial, _| Ok(recording::record(trial, &scenario, recording::Sink::Spawn)?)))
        }
    }
}

fn validate(files: &[PathBuf]) -> Result<ExitCode> {
    let mut refused = false;
    for path in files {
        match validate_one(path) {
            Ok(content) => say(&format!("{}: valid ({content})", path.display()))?,
            Err(error) => {
                refused = true;
                complain(&format!("error: {error}"));
            }
        }
    }
    Ok(if refused { ExitCode::from(BAD_INPUT) } else { ExitCode::SUCCESS })
}

/// Checks a scenario or a study, and describes its content.
fn validate_one(path: &Path) -> Result<String, StudyError> {
    Ok(if study::is_study(path)? {
        let study = study::Study::load(path, StudyOverrides::default())?;
        format!("study, {} models, {} repeats", study.models().len(), study.repeats())
    } else {
        let scenario = Scenario::load(path, &Overrides::default())?;
        let threads = rayon::current_num_threads();
        let cost = run::CostEstimate::of(&scenario, threads).in_words(threads);
        format!("{} models, {} trials; {cost}", scenario.models.len(), scenario.trials)
    })
}

fn print_schema(study: bool) -> Result<ExitCode> {
    let schema = if study { study::schema() } else { scenario::schema() };
    say(&serde_json::to_string_pretty(&schema)?)?;
    Ok(ExitCode::SUCCESS)
}

fn effects(name: Option<&str>) -> Result<ExitCode> {
    match name {
        None => say(&format!("{}\n`locsim effects NAME` tells more.", catalogue::table()))?,
        Some(name) => say(&catalogue::page(name)?)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn simulate(arguments: &Simulate) -> Result<ExitCode> {
    let overrides = Overrides { seed: arguments.seed, ..Overrides::default() };
    let scenario = Scenario::load(&arguments.scenario, &overrides)?;
    Output { path: &arguments.out, force: arguments.force, inputs: &scenario.inputs()? }.check()?;
    let drive = run::simulate_trial(&scenario, arguments.trial)?;
    locsim_dataset::write_log(&arguments.out, &drive)?;
    say(&format!(
        "{}: {} scans of {} beams",
        arguments.out.display(),
        drive.steps.len(),
        drive.laser.beam_count()
    ))?;
    Ok(ExitCode::SUCCESS)
}

fn log_options(arguments: &arguments::LogOptions) -> LogOptions {
    LogOptions {
        max_range_m: arguments.max_range.map(|max| max as f32),
        topics: BagTopics {
            scan: arguments.scan_topic.clone(),
            odometry: arguments.odometry_topic.clone(),
            reference: arguments.reference_topic.clone(),
        },
    }
}

fn gap(arguments: &Gap) -> Result<ExitCode> {
    if let Some(name) = &arguments.explain {
        say(&catalogue::page(name)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    let (Some(scenario), Some(log), Some(out)) = (&arguments.scenario, &arguments.log, &arguments.out) else {
        anyhow::bail!("a scenario, --log and --out are needed");
    };
    anyhow::ensure!(
        arguments.replicates >= LEAST_REPLICATES,
        "--replicates: {} is not allowed; a whole number from {LEAST_REPLICATES}",
        arguments.replicates
    );
    for (option, value) in [("--scans", arguments.scans), ("--beams", arguments.beams)] {
        anyhow::ensure!(value > 0, "{option}: 0 is not allowed; a whole number from 1");
    }
    let kinds = arguments.without.iter().map(|name| name.parse());
    let settings = GapSettings {
        replicates: arguments.replicates,
        seed: arguments.seed,
        scans: arguments.scans,
        beams: arguments.beams,
        without: kinds.collect::<Result<_, _>>().context("--without")?,
        log: log_options(&arguments.log_options),
    };
    let study = GapStudy::load(scenario, log, settings)?;
    use_threads(arguments.threads)?;
    let interrupt = Interrupt::listen()?;
    #[expect(clippy::disallowed_methods, reason = "the binary is where time is taken")]
    let start = Instant::now();
    let clock = || start.elapsed();
    let bars = Bars::new(arguments.quiet || !std::io::stderr().is_terminal());
    let cache = arguments.cache.clone().or_else(users_cache);
    let options = GapStudyOptions {
        out: out.clone(),
        force: arguments.force,
        command: gap_command_line(arguments, &study),
        filter: !arguments.no_filter,
        clock: &clock,
        progress: &bars,
        interrupted: interrupt.flag(),
        cache: cache.as_deref(),
        recorder: Some(&|study, outcome, path| Ok(recording::record_gap(study, outcome, path)?)),
    };
    let outcome = gap::run(&study, &options)?;
    if arguments.json {
        say(&serde_json::to_string_pretty(&outcome)?)?;
    } else if !arguments.quiet {
        say(&gap::answer(&outcome))?;
        say(&format!("Results in {} (open report.html; scenario.yaml runs as it is)", out.display()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The command that repeats a search.
fn gap_command_line(arguments: &Gap, study: &GapStudy) -> String {
    let path = |path: &Option<PathBuf>| path.as_deref().unwrap_or(Path::new("")).display().to_string();
    let mut command = format!(
        "locsim gap {} --log {} --out {} --replicates {} --seed {} --scans {} --beams {}",
        path(&arguments.scenario),
        path(&arguments.log),
        path(&arguments.out),
        arguments.replicates,
        study.seed(),
        arguments.scans,
        arguments.beams
    );
    if !arguments.without.is_empty() {
        command += " --without ";
        command += &arguments.without.join(",");
    }
    if arguments.no_filter {
        command += " --no-filter";
    }
    let arguments::LogOptions { max_range, scan_topic, odometry_topic, reference_topic } =
        &arguments.log_options;
    if let Some(max) = max_range {
        command += " --max-range ";
        command += &max.to_string();
    }
    for (option, topic) in [
        (" --scan-topic ", scan_topic),
        (" --odometry-topic ", odometry_topic),
        (" --reference-topic ", reference_topic),
    ] {
        if let Some(topic) = topic {
            command += option;
            command += topic;
        }
    }
    command
}

fn map(arguments: &Map) -> Result<ExitCode> {
    let &[from, to] = arguments.share.as_slice() else {
        anyhow::bail!("--share: two numbers are needed, for example 0.0,0.5");
    };
    anyhow::ensure!(
        0.0 <= from && from < to && to <= 1.0,
        "--share: {from},{to} is not allowed; 0 <= from < to <= 1"
    );
    let named_yaml = arguments.out.extension().is_some_and(|extension| extension == "yaml");
    let stem = if named_yaml { arguments.out.with_extension("") } else { arguments.out.clone() };
    // Appended: what follows a dot in a name such as `floor-0.05` is no extension.
    let [image, yaml] = [".pgm", ".yaml"].map(|extension| {
        let mut name = stem.clone().into_os_string();
        name.push(extension);
        PathBuf::from(name)
    });
    let name = image.file_name().context("--out needs a file name")?;
    let name = name.to_str().context("--out: a map names its image in UTF-8; this name is not")?;
    let inputs = [arguments.log.clone()];
    let [image_file, yaml_file] =
        [&image, &yaml].map(|path| Output { path, force: arguments.force, inputs: &inputs });
    image_file.check()?;
    yaml_file.check()?;
    let options = log_options(&arguments.log_options);
    let (grid, summary) = run::map_from_log(&arguments.log, &[[from, to]], arguments.resolution, &options)?;
    let [pgm, description] = run::map_files(&grid, name);
    Output::write_all(&[(image_file, &pgm), (yaml_file, &description)])?;
    say(&summary.to_string())?;
    say(&format!(
        "{}: {} x {} cells of {} m",
        yaml.display(),
        grid.width(),
        grid.height(),
        grid.resolution_m()
    ))?;
    Ok(ExitCode::SUCCESS)
}

fn bench(arguments: &Bench) -> Result<ExitCode> {
    #[expect(clippy::disallowed_methods, reason = "the binary is where time is taken")]
    let start = Instant::now();
    let clock = || start.elapsed();
    let bars = Bars::new(arguments.quiet || !std::io::stderr().is_terminal());
    let force = arguments.force;
    let sweeps = arguments
        .sweeps
        .as_deref()
        .map(|out| Store::open(&Request { out, kind: "sweeps", fingerprint: "", resume: false, force }));
    let sweeps = sweeps.transpose()?;
    let bench = speed::Bench::prepare(&arguments.folder, &clock, &bars)?;
    let report = bench.run(&clock, &bars)?;
    if let Some(store) = sweeps {
        speed::sweep(&bench, store, &clock, &bars)?;
    }
    say(&if arguments.json {
        serde_json::to_string_pretty(&report)?
    } else {
        speed::terminal_text(&report)
    })?;
    Ok(ExitCode::SUCCESS)
}
