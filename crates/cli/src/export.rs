//! `locsim export`: a simulator's sensor, parameters of AMCL and Beluga.

use std::path::{Path, PathBuf};

use anyhow::Context;
use locsim_core::output::{Output, in_shell};
use locsim_export::{self as export, Nav2Options, SimulatorFormat};
use locsim_scenario::{Overrides, Scenario};
use locsim_terminal::{DONE, Failure, Session, columns, say};

use crate::arguments::{Export, ExportNav2, ExportSensor};
use crate::{log_options, of_lab, users_cache};

/// Endings of the files beside AMCL's.
const BESIDE: [&str; 3] = ["beluga.yaml", "report.md", "report.html"];

pub fn export(arguments: &Export) -> Result<u8, Failure> {
    Ok(match arguments {
        Export::Sdf(arguments) => sensor(arguments, SimulatorFormat::Sdf)?,
        Export::Stage(arguments) => sensor(arguments, SimulatorFormat::Stage)?,
        Export::Webots(arguments) => sensor(arguments, SimulatorFormat::Webots)?,
        Export::Nav2(arguments) => nav2(arguments)?,
    })
}

/// The scenario of a results folder, or the file itself.
fn scenario_file(found: &Path) -> PathBuf {
    let within = found.join("scenario.yaml");
    if found.is_dir() { within } else { found.to_owned() }
}

fn sensor(arguments: &ExportSensor, format: SimulatorFormat) -> anyhow::Result<u8> {
    let ExportSensor { found, out, force } = arguments;
    let file = scenario_file(found);
    let scenario = Scenario::load(&file, &Overrides::default())?;
    let output = Output { path: out, force: *force, inputs: &scenario.inputs()? };
    output.check()?;
    let exported = export::sensor(&scenario, format)?;
    Output::write_all(&[(output, exported.text.as_bytes())])?;
    say(&format!("{}: written", out.display()))?;
    for (kind, part) in &exported.said {
        say(&format!("  {kind}: {part}"))?;
    }
    for kind in &exported.left {
        say(&format!("  {kind}: left to `locsim apply`"))?;
    }
    for note in &exported.notes {
        say(&format!("  {note}"))?;
    }
    if !exported.left.is_empty() {
        let said: Vec<&str> = exported.said.iter().map(|(kind, _)| kind.name()).collect();
        let without = if said.is_empty() { String::new() } else { format!(" --without {}", said.join(",")) };
        say(&format!(
            "A recording gets the others by `locsim apply {}{without} --in RECORDING --out worse.mcap`.",
            file.display()
        ))?;
    }
    Ok(DONE)
}

fn nav2(arguments: &ExportNav2) -> Result<u8, Failure> {
    let ExportNav2 { source, out, force, evaluations, trials, quiet, .. } = arguments;
    arguments.threads.set()?;
    let scenario = nav2_scenario(arguments)?;
    let inputs = scenario.inputs()?;
    let beside = BESIDE.map(|ending| out.with_extension(ending));
    let files = [out, &beside[0], &beside[1], &beside[2]];
    let output = |path| Output { path, force: *force, inputs: &inputs };
    for path in files {
        output(path).check().map_err(anyhow::Error::from)?;
    }
    let session = Session::begin(*quiet)?;
    let cache = arguments.cache.clone().or_else(users_cache);
    let command = format!(
        "locsim export nav2 {} --seed {} --evaluations {evaluations} --trials {trials} -o {}{}",
        in_shell(source),
        scenario.seed,
        in_shell(out),
        arguments.log_options.command_line()
    );
    let options = Nav2Options {
        evaluations: *evaluations,
        trials: *trials,
        command: &command,
        control: session.control(),
        cache: cache.as_deref(),
    };
    let exported = export::nav2(&scenario, &options).map_err(of_lab)?;
    let contents = [&exported.amcl, &exported.beluga, &exported.markdown, &exported.html];
    let written: Vec<_> =
        files.into_iter().zip(contents).map(|(path, text)| (output(path), text.as_bytes())).collect();
    Output::write_all(&written).map_err(anyhow::Error::from)?;
    if !quiet {
        say(&exported.table.to_terminal(columns()))?;
        say(&exported.sentence)?;
    }
    say(&format!(
        "{}: written, and {} for Beluga (open {})",
        out.display(),
        beside[0].display(),
        beside[2].display()
    ))?;
    Ok(DONE)
}

/// The scenario, or the one that `locsim init` would write for a log.
fn nav2_scenario(arguments: &ExportNav2) -> Result<Scenario, Failure> {
    let source = &arguments.source;
    let overrides = Overrides { seed: arguments.seed, ..Overrides::default() };
    let file = scenario_file(source);
    let is_yaml = file.extension().is_some_and(|ending| ending == "yaml" || ending == "yml");
    // A bag is a folder, too.
    if is_yaml && (source.is_file() || file.is_file()) {
        return Ok(Scenario::load(&file, &overrides)?);
    }
    std::fs::metadata(source).with_context(|| format!("{}: cannot be read", source.display()))?;
    let options = log_options(&arguments.log_options);
    export::nav2_scenario(source, &options, &overrides).map_err(of_lab)
}
