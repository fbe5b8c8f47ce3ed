//! What a user can type.

use std::fmt::Write;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use locsim_core::limits::{Limit, Limits};

/// A laboratory for particle-filter localization with range sensors.
///
/// Exit codes: 0 done, 1 a bound declared under `expect` was missed, 2 bad input, 130 interrupted.
#[derive(Debug, Parser)]
#[command(name = "locsim", version, max_term_width = 110)]
pub struct Arguments {
    /// Changes a limit on what may be read, such as `map_pixels=400000000`; may be given more than once
    #[arg(long, global = true, value_name = "NAME=VALUE", long_help = limit_help())]
    pub limit: Vec<String>,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The limits with their defaults.
fn limit_help() -> String {
    let mut help =
        "Changes a limit on what may be read; may be given more than once. The limits:\n".to_owned();
    for Limit { name, default, what } in Limits::TABLE {
        let _ = write!(help, "\n  {name}={default}\n      {what}");
    }
    help
}

/// A whole number from 0 on; clap's own message of a number that is too large or negative doesn't say what is allowed.
fn whole<T: TryFrom<u64> + Copy>(text: &str) -> Result<T, String> {
    let most = if size_of::<T>() == 4 { u64::from(u32::MAX) } else { u64::MAX };
    let refused = || format!("a whole number from 0 to {most} is allowed");
    text.parse::<u64>().ok().and_then(|value| T::try_from(value).ok()).ok_or_else(refused)
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a scenario: train the sensor models, localize under each, write tables, figures, report, recording
    Run(Run),
    /// Run studies of distribution regression (the paper's sensor experiments): figures, report, results.json
    Study(Study),
    /// Measure distribution regression on its fixed task: times, risks, agreement with the dense product
    BenchRegression(BenchRegression),
    /// Check scenarios and studies without running them
    Validate {
        /// Scenario and study files
        #[arg(required = true)]
        scenarios: Vec<PathBuf>,
    },
    /// Print the JSON Schema of scenario files, for editors
    Schema {
        /// Of study files instead
        #[arg(long)]
        study: bool,
    },
    /// List the effects: named ways in which a simulated world can differ from the nominal one; or tell all about one
    Effects {
        /// Which one
        name: Option<String>,
    },
    /// Write one simulated drive of a scenario as a measured log (ROS 2 bag or CARMEN log)
    Simulate(Simulate),
    /// Find where a measured log and a simulated scenario disagree, name the effect that the scenario lacks, and add it
    Gap(Gap),
    /// Build an occupancy grid map (ROS `map_server` format) from a log with reference poses
    Map(Map),
    /// Measure speed and accuracy on a folder of fixed work, beside targets and other programs
    Bench(Bench),
    /// Run the hidden-effect suite: how often and how well `gap` finds what is hidden in simulated logs
    GapBench(GapBench),
    /// Print a shell's completion script
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// `locsim run`.
#[derive(Debug, Args)]
#[expect(clippy::struct_excessive_bools, reason = "each is an option of the command line")]
pub struct Run {
    /// The scenario file
    pub scenario: PathBuf,
    /// Results folder [default: results/ and the name of the scenario]
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Number of trials, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u32>)]
    pub trials: Option<u32>,
    /// Seed, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>)]
    pub seed: Option<u64>,
    /// Worker threads, at most 4 for each core; results don't depend on it [default: all cores]
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub threads: Option<usize>,
    /// Only these models of the scenario, separated by commas
    #[arg(long, value_delimiter = ',')]
    pub models: Option<Vec<String>>,
    /// Where the recording of one trial goes: a file in the results folder, a running viewer, a new viewer
    #[arg(long, value_enum, default_value_t = Record::File)]
    pub record: Record,
    /// Go on with an interrupted run of the same scenario
    #[arg(long)]
    pub resume: bool,
    /// Replace earlier results of locsim, and what an interrupted run has kept; nothing else is ever touched
    #[arg(long, conflicts_with = "resume")]
    pub force: bool,
    /// Where range tables are kept between runs [default: `locsim` in the user's cache folder]
    #[arg(long, env = "LOCSIM_CACHE", value_name = "FOLDER", hide_env_values = true)]
    pub cache: Option<PathBuf>,
    /// Print nothing but errors (and, with --json, the summary)
    #[arg(long)]
    pub quiet: bool,
    /// Print summary.json instead of the table
    #[arg(long)]
    pub json: bool,
}

/// What to do with the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Record {
    /// No recording
    None,
    /// recording.rrd in the results folder
    File,
    /// Send to a rerun viewer that is already open on this machine
    Connect,
    /// Start a rerun viewer (`rerun` must be on the path)
    Spawn,
}

/// `locsim study`.
#[derive(Debug, Args)]
#[expect(clippy::struct_excessive_bools, reason = "each is an option of the command line")]
pub struct Study {
    /// The studies' files
    #[arg(required = true)]
    pub studies: Vec<PathBuf>,
    /// Folder that gets a results folder for each study
    #[arg(long, default_value = "results")]
    pub out: PathBuf,
    /// Number of repeats, instead of the study's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u32>)]
    pub repeats: Option<u32>,
    /// Seed, instead of the study's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>)]
    pub seed: Option<u64>,
    /// Worker threads, at most 4 for each core; results don't depend on it [default: all cores]
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub threads: Option<usize>,
    /// Two repeats on little data, to see whether everything works
    #[arg(long)]
    pub quick: bool,
    /// Go on with an interrupted study
    #[arg(long)]
    pub resume: bool,
    /// Replace earlier results of locsim, and what an interrupted study has kept; nothing else is ever touched
    #[arg(long, conflicts_with = "resume")]
    pub force: bool,
    /// Print nothing but errors (and, with --json, the results)
    #[arg(long)]
    pub quiet: bool,
    /// Print the results as JSON, one study per line, instead of what holds
    #[arg(long)]
    pub json: bool,
}

/// `locsim bench-regression`.
#[derive(Debug, Args)]
pub struct BenchRegression {
    /// Folder of the task's script, task.py. Its data are part of the program, number by number, so that the
    /// folder is only asked whether it is the right one
    pub folder: Option<PathBuf>,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// `locsim simulate`.
#[derive(Debug, Args)]
pub struct Simulate {
    /// The scenario file
    pub scenario: PathBuf,
    /// The log to write: a ROS 2 bag (`.mcap`) or a CARMEN log (`.log`, `.log.gz`)
    #[arg(long)]
    pub out: PathBuf,
    /// Replace the log if it is there
    #[arg(long)]
    pub force: bool,
    /// Which trial of the scenario to write
    #[arg(long, default_value_t = 0, allow_negative_numbers = true, value_parser = whole::<u32>)]
    pub trial: u32,
    /// Seed, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>)]
    pub seed: Option<u64>,
}

/// `locsim map`.
#[derive(Debug, Args)]
pub struct Map {
    /// A log with reference poses: a ROS 2 bag (a folder, `.mcap`, `.db3`) or a CARMEN log (`.log`, `.log.gz`)
    pub log: PathBuf,
    /// The map to write: OUT.yaml and OUT.pgm
    #[arg(long)]
    pub out: PathBuf,
    /// Replace the map if it is there
    #[arg(long)]
    pub force: bool,
    /// Cell size \[m\]
    #[arg(long, default_value_t = 0.05)]
    pub resolution: f64,
    /// Use only this share of the log, for example 0.0,0.5
    #[arg(long, value_delimiter = ',', num_args = 1, default_values_t = [0.0, 1.0])]
    pub share: Vec<f64>,
    #[command(flatten)]
    pub log_options: LogOptions,
}

/// How to read a log.
#[derive(Debug, Args)]
pub struct LogOptions {
    /// Readings at or above this count as no return [m; default: the log's own]
    #[arg(long)]
    pub max_range: Option<f64>,
    /// The bag's topic of laser scans [default: /scan, or the only one]
    #[arg(long, value_name = "TOPIC")]
    pub scan_topic: Option<String>,
    /// The bag's topic of odometry [default: /odom, the only one, or the transform `odom:base_link`]
    #[arg(long, value_name = "TOPIC")]
    pub odometry_topic: Option<String>,
    /// The bag's topic of reference poses or a transform such as `map:base_link` [default: /reference,
    /// `/ground_truth`, or what a localizer found]
    #[arg(long, value_name = "TOPIC")]
    pub reference_topic: Option<String>,
}

/// `locsim gap`.
#[derive(Debug, Args)]
#[expect(clippy::struct_excessive_bools, reason = "each is an option of the command line")]
pub struct Gap {
    /// The scenario: a simulation of the robot as it is thought to be
    #[arg(required_unless_present = "explain")]
    pub scenario: Option<PathBuf>,
    /// The measured log, with reference poses: a ROS 2 bag (a folder, `.mcap`, `.db3`) or a CARMEN log (`.log`, `.log.gz`)
    #[arg(long, required_unless_present = "explain")]
    pub log: Option<PathBuf>,
    /// Results folder
    #[arg(long, required_unless_present = "explain")]
    pub out: Option<PathBuf>,
    /// Replace earlier results of locsim; nothing else is ever touched
    #[arg(long)]
    pub force: bool,
    /// Simulated logs behind a p-value, at least 19; its least value is 1 / (replicates + 1)
    #[arg(long, default_value_t = 999, allow_negative_numbers = true, value_parser = whole::<u32>)]
    pub replicates: u32,
    /// Seed, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>)]
    pub seed: Option<u64>,
    /// Worker threads, at most 4 for each core; results don't depend on it [default: all cores]
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub threads: Option<usize>,
    /// The most scans of the log that are looked at
    #[arg(long, default_value_t = 600, allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub scans: usize,
    /// The most beams of a scan that are looked at, evenly spread
    #[arg(long, default_value_t = 72, allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub beams: usize,
    /// Effects that are left out of the library, separated by commas
    #[arg(long, value_name = "EFFECT", value_delimiter = ',')]
    pub without: Vec<String>,
    /// Don't run the particle filter with the old and the new simulator
    #[arg(long)]
    pub no_filter: bool,
    #[command(flatten)]
    pub log_options: LogOptions,
    /// Where range tables are kept between runs [default: `locsim` in the user's cache folder]
    #[arg(long, env = "LOCSIM_CACHE", value_name = "FOLDER", hide_env_values = true)]
    pub cache: Option<PathBuf>,
    /// Print nothing but errors (and, with --json, the outcome)
    #[arg(long)]
    pub quiet: bool,
    /// Print gap.json instead of the short answer
    #[arg(long)]
    pub json: bool,
    /// Only say what an effect is, what gives it away and what it is confused with
    #[arg(long, value_name = "EFFECT", conflicts_with_all = ["scenario", "log", "out"])]
    pub explain: Option<String>,
}

/// `locsim bench`.
#[derive(Debug, Args)]
pub struct Bench {
    /// Folder with map.yaml, workload.json, scan.csv, `particles_f64le.bin`, `traj_static.csv`, `traj_dynamic.csv`
    pub folder: PathBuf,
    /// Print all figures as JSON instead of a table
    #[arg(long)]
    pub json: bool,
    /// Also measure cost against particles, beams, map size and threads, and write sweeps.json and plots into this
    /// folder (some minutes)
    #[arg(long)]
    pub sweeps: Option<PathBuf>,
    /// Replace earlier sweeps of locsim there; nothing else is ever touched
    #[arg(long)]
    pub force: bool,
    /// No progress bars
    #[arg(long)]
    pub quiet: bool,
}

/// `locsim gap-bench`.
#[derive(Debug, Args)]
pub struct GapBench {
    /// The nominal scenario
    #[arg(default_value = "scenarios/gap/nominal.yaml")]
    pub scenario: PathBuf,
    /// How much: small (minutes), medium (an hour on two cores), full (a day)
    #[arg(long, value_enum, default_value_t = Size::Small)]
    pub size: Size,
    /// Everything random derives from it: tune on one seed, score on another
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = whole::<u64>)]
    pub seed: u64,
    /// Begin no log after so many minutes, and score what is done; the same command goes on
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>)]
    pub minutes: Option<u64>,
    /// Folder for logs, truths, findings and the report; what it holds already isn't run again
    #[arg(long, default_value = "results/gap-bench")]
    pub out: PathBuf,
    /// Simulated logs behind each p-value
    #[arg(long, default_value_t = 199, value_parser = clap::value_parser!(u32).range(99..))]
    pub replicates: u32,
    /// The most scans of a log
    #[arg(long, default_value_t = 600, value_parser = clap::value_parser!(u32).range(60..))]
    pub scans: u32,
    /// Worker threads, at most 4 for each core; results don't depend on it [default: all cores]
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<usize>)]
    pub threads: Option<usize>,
    /// Print nothing but errors (and, with --json, the figures)
    #[arg(long)]
    pub quiet: bool,
    /// Print the figures as JSON instead of the table
    #[arg(long)]
    pub json: bool,
}

/// How much of the suite is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Size {
    /// Minutes
    Small,
    /// An hour on two cores
    Medium,
    /// A day
    Full,
}
