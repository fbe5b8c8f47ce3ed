//! The `locsim` command: runs scenarios, checks them, lists effects, simulates and inspects logs, builds maps. It is a library
//! so that the Python package runs the same command.

mod arguments;
mod export;
mod recording;
mod sweep;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail, ensure};
use clap::{CommandFactory, Parser};
use locsim_core::limits::quoted;
use locsim_core::output::{Output, in_shell};
use locsim_dataset::{BagTopics, LogOptions};
use locsim_lab::apply::apply as apply_effects;
use locsim_lab::convert::{convert_log, convert_map};
use locsim_lab::gap::{self, GapSettings, GapStudy, GapStudyOptions};
use locsim_lab::inspect::{self, Inspection, NewScenario};
use locsim_lab::run::{self, LogMaps, Recorder, RunOptions, RunSummary};
use locsim_lab::{EffectKind, LabError};
use locsim_report::figures::Rasterizer;
use locsim_report::terminal_table;
use locsim_scenario::{self as scenario, LogMap, Overrides, Scenario, Source, catalogue};
use locsim_study::{self as study, StudyOptions, StudyOverrides};
use locsim_terminal::{BAD_INPUT, DONE, Failure, OutputOptions, Session, columns, complain, exit_code, say};

use arguments::{
    Apply, Arguments, Command, Convert, Gap, Init, Inspect, Map, Record, Run, Simulate, Validate,
};

/// A bound that the scenario declares was missed.
const MISSED: u8 = 1;

/// Runs a command line and returns the exit code. The first of `arguments` is the program's path, by which batch engines call it
/// again. Ctrl-C and limits are those of the process, which can run one command of long work.
pub fn run(arguments: &[OsString]) -> u8 {
    let program = arguments.first().map_or(Path::new("locsim"), Path::new);
    let arguments = match Arguments::try_parse_from(arguments) {
        Ok(arguments) => arguments,
        Err(error) => {
            // The help is such an error, with the exit code 0. A closed stream is no failure.
            let _ = error.print();
            return u8::try_from(error.exit_code()).unwrap_or(BAD_INPUT);
        }
    };
    let done = arguments.limits.set().map_err(Failure::from).and_then(|()| obey(&arguments.command, program));
    exit_code(done)
}

fn obey(command: &Command, program: &Path) -> Result<u8, Failure> {
    Ok(match command {
        Command::Run(arguments) => run_scenario(arguments)?,
        Command::Study(arguments) => run_studies(arguments)?,
        Command::Sweep(arguments) => sweep::run(arguments, program)?,
        Command::Merge(arguments) => sweep::merge(arguments)?,
        Command::Validate(arguments) => validate(arguments)?,
        Command::Schema { study, sweep } => print_schema(*study, *sweep)?,
        Command::Effects { name } => effects(name.as_deref())?,
        Command::Simulate(arguments) => simulate(arguments)?,
        Command::Gap(arguments) => gap(arguments)?,
        Command::Apply(arguments) => apply(arguments)?,
        Command::Export(arguments) => export::export(arguments)?,
        Command::Map(arguments) => map(arguments)?,
        Command::Convert(arguments) => convert(arguments)?,
        Command::Inspect(arguments) => inspect_log(arguments)?,
        Command::Init(arguments) => init(arguments)?,
        Command::Manual { command } => manual(command.as_deref())?,
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Arguments::command(), "locsim", &mut script);
            say(&String::from_utf8(script)?)?;
            DONE
        }
    })
}

/// Prints the manual page of the program, or of one of its commands.
fn manual(name: Option<&str>) -> anyhow::Result<u8> {
    let mut program = Arguments::command();
    // Names the commands' pages, and gives them the options that every command takes.
    program.build();
    let command = match name {
        None => program,
        Some(name) => program
            .find_subcommand(name)
            .with_context(|| {
                let commands: Vec<&str> = program.get_subcommands().map(clap::Command::get_name).collect();
                format!("`{}` is not a command of locsim; allowed: {}", quoted(name), commands.join(", "))
            })?
            .clone(),
    };
    let mut page = Vec::new();
    clap_mangen::Man::new(command).render(&mut page)?;
    say(&String::from_utf8(page)?)?;
    Ok(DONE)
}

/// The failure of a run or a search.
fn of_lab(error: LabError) -> Failure {
    let is_interruption = error.is_interruption();
    Failure::of_work(error, is_interruption)
}

fn run_scenario(arguments: &Run) -> Result<u8, Failure> {
    let overrides =
        Overrides { trials: arguments.trials, seed: arguments.seed, models: arguments.models.clone() };
    arguments.threads.set()?;
    let scenario = Scenario::load(&arguments.scenario, &overrides)?;
    if let Some(shard) = arguments.share.asked()? {
        return sweep::run_trials(arguments, scenario, shard);
    }
    let session = Session::begin(arguments.output.quiet)?;
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("results").join(&scenario.name));
    let recorder = recorder(arguments.record, &scenario.name);
    let cache = arguments.cache.clone().or_else(users_cache);
    let options = RunOptions {
        out: out.clone(),
        resume: arguments.resume,
        force: arguments.force,
        command: command_line(&scenario, arguments.models.as_deref()),
        control: session.control(),
        cache: cache.as_deref(),
        recorder: recorder.as_deref(),
    };
    session.work_on(&out, "trials");
    let outcome = run::run(&scenario, &options).map_err(of_lab)?;
    Ok(report_run(&outcome, &out, &arguments.output, arguments.record)?)
}

/// Prints the results of a run and the bounds that they miss, and returns the exit code.
fn report_run(
    outcome: &run::Outcome,
    out: &Path,
    output: &OutputOptions,
    record: Record,
) -> anyhow::Result<u8> {
    if output.json {
        say(&serde_json::to_string_pretty(&outcome.summary)?)?;
    } else if !output.quiet {
        match &outcome.summary {
            RunSummary::Referenced(summary) => say(&terminal_table(summary, columns()))?,
            RunSummary::Unreferenced(summary) => {
                say(&summary.table().to_terminal(columns()))?;
                summary.findings.iter().try_for_each(|finding| say(&format!("- {finding}")))?;
            }
        }
        let is_recorded = matches!(outcome.summary, RunSummary::Referenced(_));
        let replay = if record == Record::File && is_recorded {
            format!("; `rerun {}` replays", out.join(run::RECORDING).display())
        } else {
            String::new()
        };
        say(&format!("Results in {} (open report.html{replay})", out.display()))?;
    }
    for missed in &outcome.missed {
        complain(&format!("missed: {missed}"));
    }
    Ok(if outcome.missed.is_empty() { DONE } else { MISSED })
}

/// Runs every study that can be read; one that can't doesn't keep the others from running.
fn run_studies(arguments: &arguments::Study) -> Result<u8, Failure> {
    let overrides =
        StudyOverrides { repeats: arguments.repeats, seed: arguments.seed, quick: arguments.quick };
    arguments.threads.set()?;
    let session = Session::begin(arguments.output.quiet)?;
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
            control: session.control(),
        };
        session.work_on(&out, "repeats");
        let results = study::run(&study, &options).map_err(|error| {
            let is_interruption = error.is_interruption();
            Failure::of_work(error, is_interruption)
        })?;
        if arguments.output.json {
            say(&serde_json::to_string(&results)?)?;
        } else if !arguments.output.quiet {
            say(&study::terminal_summary(&results, columns()))?;
            say(&format!("Results in {} (open report.html)", out.display()))?;
        }
    }
    Ok(if refused { BAD_INPUT } else { DONE })
}

/// Where range tables are kept between runs, for this user: `LOCSIM_CACHE`, or `locsim` in the user's folder of caches.
pub fn users_cache() -> Option<PathBuf> {
    let told = std::env::var_os("LOCSIM_CACHE").map(PathBuf::from);
    told.or_else(|| directories::BaseDirs::new().map(|user| user.cache_dir().join("locsim")))
}

/// The command that repeats a run.
fn command_line(scenario: &Scenario, models: Option<&[String]>) -> String {
    let mut command = format!(
        "locsim run {} --seed {} --trials {}",
        in_shell(&scenario.file),
        scenario.seed,
        scenario.trials
    );
    if let Some(models) = models {
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

fn validate(arguments: &Validate) -> anyhow::Result<u8> {
    if let Some(log) = &arguments.log {
        let [scenario] = &arguments.scenarios[..] else {
            anyhow::bail!(
                "--log: one scenario is held against a log, and {} are given",
                arguments.scenarios.len()
            );
        };
        return validate_against(scenario, log, &arguments.log_options);
    }
    if let Some(option) = arguments.log_options.first_given() {
        anyhow::bail!("{option} is about a log; it needs --log");
    }
    let mut refused = false;
    for path in &arguments.scenarios {
        match validate_one(path) {
            Ok(content) => say(&format!("{}: valid ({content})", path.display()))?,
            Err(error) => {
                refused = true;
                complain(&format!("error: {error}"));
            }
        }
    }
    Ok(if refused { BAD_INPUT } else { DONE })
}

/// Checks that a log can be held against a scenario, and says how it is read.
fn validate_against(scenario: &Path, log: &Path, options: &arguments::LogOptions) -> anyhow::Result<u8> {
    let study = GapStudy::load(scenario, Some(log), GapSettings::of_log(log_options(options)))?;
    study.remarks().for_each(|remark| complain(&format!("note: {remark}")));
    say(&format!("{}: valid, and of the same laser as {}", scenario.display(), log.display()))?;
    Ok(DONE)
}

/// Checks a scenario, a study or a sweep, and describes its content. A scenario's log and map are read.
fn validate_one(path: &Path) -> anyhow::Result<String> {
    Ok(if study::is_study(path)? {
        let study = study::Study::load(path, StudyOverrides::default())?;
        let [models, repeats] = [study.models().len(), study.repeats() as usize];
        format!("study, {}, {}", counted(models, "model"), counted(repeats, "repeat"))
    } else if locsim_sweep::is_sweep(path)? {
        let sweep = locsim_sweep::Sweep::load(path, locsim_sweep::SweepOverrides::default())?;
        format!("sweep, {}", sweep.estimate(rayon::current_num_threads())?)
    } else {
        let scenario = Scenario::load(path, &Overrides::default())?;
        for warning in run::check(&scenario)? {
            complain(&format!("warning: {}: {warning}", path.display()));
        }
        let threads = rayon::current_num_threads();
        let cost = run::CostEstimate::of(&scenario, threads).with_table(&scenario).in_words(threads);
        let (models, trials) = (scenario.models.len(), scenario.trials);
        format!("{}, {}; {cost}", counted(models, "model"), counted(trials as usize, "trial"))
    })
}

/// A number of things in words.
fn counted(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

fn print_schema(study: bool, sweep: bool) -> anyhow::Result<u8> {
    let schema = match (study, sweep) {
        (true, _) => study::schema(),
        (_, true) => locsim_sweep::schema(),
        _ => scenario::schema(),
    };
    say(&serde_json::to_string_pretty(&schema)?)?;
    Ok(DONE)
}

fn effects(name: Option<&str>) -> anyhow::Result<u8> {
    match name {
        None => say(&format!("{}\n`locsim effects NAME` tells more.", catalogue::table(columns())))?,
        Some(name) => say(&catalogue::page(name).map_err(anyhow::Error::msg)?)?,
    }
    Ok(DONE)
}

fn simulate(arguments: &Simulate) -> anyhow::Result<u8> {
    let overrides = Overrides { seed: arguments.seed, ..Overrides::default() };
    let scenario = Scenario::load(&arguments.scenario, &overrides)?;
    Output { path: &arguments.out, force: arguments.force, inputs: &scenario.inputs()? }.check()?;
    let drive = run::simulate_trial(&scenario, arguments.trial)?;
    locsim_dataset::write_simulated_log(&arguments.out, &drive)?;
    say(&format!(
        "{}: {} scans of {} beams",
        arguments.out.display(),
        drive.steps.len(),
        drive.laser.beam_count()
    ))?;
    Ok(DONE)
}

fn apply(arguments: &Apply) -> anyhow::Result<u8> {
    let Apply { scenario, log, out, force, seed, without, log_options: options } = arguments;
    let without = effect_kinds(without)?;
    let scenario = Scenario::load(scenario, &Overrides { seed: *seed, ..Overrides::default() })?;
    let inputs = [scenario.inputs()?, locsim_dataset::log_files(log)?].concat();
    Output { path: out, force: *force, inputs: &inputs }.check()?;
    let applied = apply_effects(&scenario, log, &without, &self::log_options(options), out)?;
    say(&format!("{}: {applied}", out.display()))?;
    Ok(DONE)
}

fn log_options(arguments: &arguments::LogOptions) -> LogOptions {
    LogOptions {
        max_range_m: arguments.max_range.map(|max| max as f32),
        topics: BagTopics {
            scan: arguments.scan_topic.clone(),
            odometry: arguments.odometry_topic.clone(),
            reference: arguments.reference_topic.clone(),
        },
        without_odometry: false,
    }
}

fn gap(arguments: &Gap) -> Result<u8, Failure> {
    if let Some(name) = &arguments.explain {
        say(&catalogue::page(name).map_err(anyhow::Error::msg)?)?;
        return Ok(DONE);
    }
    let (Some(scenario), Some(out)) = (&arguments.scenario, &arguments.out) else {
        return Err(anyhow!("a scenario and --out are needed").into());
    };
    // Before anything is computed on them.
    arguments.threads.set()?;
    let study = GapStudy::load(scenario, arguments.log.as_deref(), gap_settings(arguments)?)?;
    let session = Session::begin(arguments.output.quiet)?;
    let cache = arguments.cache.clone().or_else(users_cache);
    let options = GapStudyOptions {
        out: out.clone(),
        force: arguments.force,
        command: gap_command_line(arguments, &study),
        filter: !arguments.no_filter,
        control: session.control(),
        cache: cache.as_deref(),
        recorder: Some(&|study, outcome, path| Ok(recording::record_gap(study, outcome, path)?)),
    };
    let finished =
        || say(&format!("Results in {} (open report.html; scenario.yaml runs as it is)", out.display()));
    if arguments.baseline.is_some() {
        let changes = gap::run_since(&study, &options).map_err(of_lab)?;
        if arguments.output.json {
            say(&gap::json_since(&study, &changes).map_err(of_lab)?)?;
        } else if !arguments.output.quiet {
            say(&gap::answer_since(&changes))?;
            finished()?;
        }
        return Ok(DONE);
    }
    let outcome = gap::run(&study, &options).map_err(of_lab)?;
    if arguments.output.json {
        say(&serde_json::to_string_pretty(&outcome)?)?;
    } else if !arguments.output.quiet {
        say(&gap::answer(&outcome))?;
        finished()?;
    }
    Ok(DONE)
}

/// The effects that `--without` names.
fn effect_kinds(names: &[String]) -> anyhow::Result<Vec<EffectKind>> {
    names.iter().map(|name| name.parse()).collect::<Result<_, _>>().context("--without")
}

/// The settings of a search.
fn gap_settings(arguments: &Gap) -> anyhow::Result<GapSettings> {
    let settings = GapSettings {
        replicates: arguments.replicates.unwrap_or(match arguments.baseline {
            None => GapSettings::REPLICATES,
            Some(_) => GapSettings::PERMUTATIONS,
        }),
        seed: arguments.seed,
        scans: arguments.scans,
        beams: arguments.beams,
        without: effect_kinds(&arguments.without)?,
        log: log_options(&arguments.log_options),
        baseline: arguments.baseline.clone(),
    };
    settings.check().map_err(|refused| anyhow!("--{refused}"))?;
    Ok(settings)
}

/// The command that repeats a search.
fn gap_command_line(arguments: &Gap, study: &GapStudy) -> String {
    let path = |path: &Option<PathBuf>| in_shell(path.as_deref().unwrap_or(Path::new("")));
    let mut command = format!(
        "locsim gap {}{} --out {} --replicates {} --seed {} --scans {} --beams {}",
        path(&arguments.scenario),
        arguments.log.as_ref().map_or_else(String::new, |log| format!(" --log {}", in_shell(log))),
        path(&arguments.out),
        study.settings().replicates,
        study.seed(),
        arguments.scans,
        arguments.beams
    );
    if let Some(baseline) = &arguments.baseline {
        command += " --baseline ";
        command += &in_shell(baseline);
    }
    if !arguments.without.is_empty() {
        command += " --without ";
        command += &arguments.without.join(",");
    }
    if arguments.no_filter {
        command += " --no-filter";
    }
    command + &arguments.log_options.command_line()
}

fn map(arguments: &Map) -> anyhow::Result<u8> {
    let share = match arguments.share[..] {
        [] => None,
        [from, to] => {
            ensure!(from < to, "--share: {from},{to} is not allowed; 0 <= from < to <= 1");
            Some([from, to])
        }
        _ => {
            let given = arguments.share.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
            bail!("--share: {} is not allowed; two numbers are needed, for example 0.0,0.5", quoted(&given));
        }
    };
    let [image, yaml, walls, picture] =
        map_files(&arguments.out, [".pgm", ".yaml", ".walls.yaml", ".check.svg"]);
    let name = image_name(&image)?;
    let source = map_source(arguments, share)?;
    let inputs = [arguments.log.clone(), source.log.clone()];
    check_stem(&arguments.out, &inputs)?;
    let outputs = [&image, &yaml, &walls, &picture].map(|path| Output {
        path,
        force: arguments.force,
        inputs: &inputs,
    });
    for output in &outputs {
        output.check()?;
    }
    let maps = LogMaps::from_log(&source.log, &source.shares, source.resolution_m, &source.options)?;
    let [pgm, description] = run::grid_files(&maps.grid, name);
    let mut contents = vec![pgm, description, maps.walls.to_yaml().into_bytes()];
    if let Some(check) = &maps.check {
        contents.push(run::agreement_figure(check)?.svg.into_bytes());
    }
    let files: Vec<(Output, &[u8])> = outputs.into_iter().zip(contents.iter().map(Vec::as_slice)).collect();
    Output::write_all(&files)?;
    let contradiction = maps.check.as_ref().and_then(run::contradiction);
    let warnings = maps.summary.remarks.iter().chain(&maps.doubts).chain(&contradiction);
    warnings.for_each(|warning| complain(&format!("warning: {warning}")));
    say(&maps.summary.to_string())?;
    let grid = &maps.grid;
    let (width, height, cell) = (grid.width(), grid.height(), grid.resolution_m());
    say(&format!("{}: {width} x {height} cells of {cell} m", yaml.display()))?;
    say(&format!("{}: {} walls", walls.display(), maps.walls.walls.len()))?;
    if let Some(check) = &maps.check {
        say(&format!(
            "Maps from four fifths of the scans against the other {} ({}):\n{}",
            check.scans,
            picture.display(),
            run::agreement_table(check).to_terminal(columns())
        ))?;
    }
    Ok(DONE)
}

/// The files of a map, of which `--out` names one (`floor.yaml`) or all (`floor`).
fn map_files<const N: usize>(out: &Path, extensions: [&str; N]) -> [PathBuf; N] {
    let named_yaml = out.extension().is_some_and(|extension| extension == "yaml");
    let stem = if named_yaml { out.with_extension("") } else { out.to_owned() };
    // Appended: what follows a dot in a name such as `floor-0.05` is no extension.
    extensions.map(|extension| {
        let mut name = stem.clone().into_os_string();
        name.push(extension);
        PathBuf::from(name)
    })
}

/// Checks that files may be called by `--out` and endings: it has a name of its own, and isn't that of a folder, a device or an input.
fn check_stem(out: &Path, inputs: &[PathBuf]) -> anyhow::Result<()> {
    let text = out.to_string_lossy();
    let is_name = out.file_name().is_some() && !text.ends_with('/') && !text.ends_with("/.");
    ensure!(
        is_name,
        "--out: `{}` is not allowed; a name that the map's files are called by, such as floor",
        quoted(&text)
    );
    // A file of that name stays beside those that are written.
    Ok(Output { path: out, force: true, inputs }.check()?)
}

/// The name of a map's image, which its description holds.
fn image_name(image: &Path) -> anyhow::Result<&str> {
    let name = image.file_name().context("--out needs a file name")?;
    name.to_str().context("--out: a map names its image in UTF-8; this name is not")
}

fn convert(arguments: &Convert) -> anyhow::Result<u8> {
    let Convert { file, out, force, log_options: options } = arguments;
    let options = log_options(options);
    if !locsim_dataset::is_beesoft_map(file) {
        let inputs = locsim_dataset::log_files(file)?;
        Output { path: out, force: *force, inputs: &inputs }.check()?;
        let (scans, summary) = convert_log(file, &options, out)?;
        say(&format!("{summary}\n{}: {scans} scans", out.display()))?;
        return Ok(DONE);
    }
    ensure!(
        options == LogOptions::default(),
        "{}: options of a log are given, and this is a map",
        file.display()
    );
    let inputs = [file.clone()];
    check_stem(out, &inputs)?;
    let [image, yaml] = map_files(out, [".pgm", ".yaml"]);
    let outputs = [&image, &yaml].map(|path| Output { path, force: *force, inputs: &inputs });
    for output in &outputs {
        output.check()?;
    }
    let grid = convert_map(file)?;
    let [pgm, description] = run::grid_files(&grid, image_name(&image)?);
    let [of_image, of_yaml] = outputs;
    Output::write_all(&[(of_image, &pgm), (of_yaml, &description)])?;
    let (width, height, cell) = (grid.width(), grid.height(), grid.resolution_m());
    say(&format!("{}: {width} x {height} cells of {cell} m", yaml.display()))?;
    Ok(DONE)
}

fn inspect_log(arguments: &Inspect) -> anyhow::Result<u8> {
    let inputs = [arguments.log.clone()];
    let file = arguments.picture.as_deref();
    let picture = file.map(|path| Output { path, force: arguments.force, inputs: &inputs });
    if let Some(picture) = &picture {
        let extension = picture.path.extension().and_then(|extension| extension.to_str());
        ensure!(
            matches!(extension, Some("svg" | "png")),
            "--picture: {} is not allowed; a file name that ends in .svg or .png",
            picture.path.display()
        );
        picture.check()?;
    }
    let inspection = Inspection::of(&arguments.log, &log_options(&arguments.log_options))?;
    if arguments.json {
        say(&serde_json::to_string_pretty(&inspection)?)?;
    } else {
        say(inspection.to_terminal(columns()).trim_end())?;
    }
    if let (Some(problem), None) = (&inspection.problem, &inspection.drive) {
        complain(&format!("error: {}: {problem}", arguments.log.display()));
        return Ok(BAD_INPUT);
    }
    if let Some(picture) = picture {
        let drive = inspection.recording.as_ref().context("--picture: the log has no drive to draw")?;
        let figure = inspect::picture(drive, inspection.split.as_ref())?;
        let is_png = picture.path.extension().is_some_and(|extension| extension == "png");
        let content = if is_png { Rasterizer::new().png(&figure)? } else { figure.svg.into_bytes() };
        Output::write_all(&[(picture, &content)])?;
    }
    Ok(DONE)
}

/// Side of a cell \[m\], where neither `--resolution` nor a scenario says.
const CELL_M: f64 = 0.05;

/// The scans that maps are built from.
struct MapSource {
    log: PathBuf,
    shares: Vec<[f64; 2]>,
    resolution_m: f64,
    options: LogOptions,
}

/// A share of a log, or what a scenario's map is built from.
fn map_source(arguments: &Map, share: Option<[f64; 2]>) -> anyhow::Result<MapSource> {
    let Map { log: file, resolution, log_options: options, .. } = arguments;
    let is_scenario = file.extension().is_some_and(|extension| extension == "yaml" || extension == "yml");
    let all = || vec![share.unwrap_or([0.0, 1.0])];
    let resolution_m = resolution.unwrap_or(CELL_M);
    if !is_scenario {
        return Ok(MapSource {
            log: file.clone(),
            shares: all(),
            resolution_m,
            options: log_options(options),
        });
    }
    if let Some(option) = options.first_given() {
        bail!("{option}: not allowed with a scenario, whose `log` section says it");
    }
    let scenario = Scenario::load(file, &Overrides::default())?;
    let Source::Log(log) = &scenario.source else {
        bail!("{}: the scenario has no `log` to build a map from", file.display());
    };
    let (scans, cell_m) = match &log.map {
        LogMap::File(_) => (None, None),
        LogMap::FromScans { scans, resolution_m } => (Some(scans.clone()), Some(*resolution_m)),
        LogMap::Walls { scans } => (Some(scans.clone()), None),
    };
    ensure!(
        share.is_none() || scans.is_none(),
        "--share: not allowed with a scenario that has `log.map_scans`"
    );
    Ok(MapSource {
        log: log.file.clone(),
        shares: scans.unwrap_or_else(all),
        resolution_m: resolution.or(cell_m).unwrap_or(CELL_M),
        options: run::read_options(log),
    })
}

fn init(arguments: &Init) -> anyhow::Result<u8> {
    let Init { log, out, map, force, log_options: options } = arguments;
    let of_log = [locsim_dataset::log_files(log)?, vec![log.clone(), log.join("metadata.yaml")]].concat();
    let inputs: Vec<PathBuf> = map.iter().cloned().chain(of_log).collect();
    let output = Output { path: out, force: *force, inputs: &inputs };
    output.check()?;
    let ending = out.extension().map(|ending| ending.to_string_lossy());
    ensure!(
        matches!(ending.as_deref(), None | Some("yaml" | "yml")),
        "--out: {} is not allowed; a file name that ends in .yaml or .yml",
        out.display()
    );
    let cell_m = match map {
        Some(map) => scenario::load_map(map)?.cell_m,
        None => None,
    };
    let options = log_options(options);
    let inspection = Inspection::of(log, &options)?;
    let text = NewScenario { log, map: map.as_deref(), cell_m, out, options }.text(&inspection)?;
    Output::write_all(&[(output, text.as_bytes())])?;
    for warning in &inspection.warnings {
        complain(&format!("warning: {warning}"));
    }
    let (file, argument) = (out.display(), in_shell(out));
    let gap = if inspection.lacks.gap.is_empty() {
        format!(" `locsim gap {argument} --out found` searches for what its simulator lacks.")
    } else {
        String::new()
    };
    say(&format!("{file}: written. `locsim run {argument}` localizes on the log.{gap}"))?;
    Ok(DONE)
}
