//! Commands and options of the program.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, StringValueParser, TypedValueParser};
use clap::{Args, Parser, Subcommand, ValueEnum};
use locsim_core::limits::{MOST_REPEATS, MOST_TRIALS, RANGE_M};
use locsim_core::output::in_shell;
use locsim_lab::gap::GapSettings;
use locsim_scenario::catalogue;
use locsim_terminal::{LimitOptions, OutputOptions, Share, Threads, number, whole};

/// A laboratory for particle-filter localization with range sensors.
///
/// Exit codes: 0 done, 1 a bound declared under `expect` was missed, 2 bad input, 130 interrupted.
#[derive(Debug, Parser)]
#[command(name = "locsim", version, max_term_width = 110)]
pub struct Arguments {
    #[command(flatten)]
    pub limits: LimitOptions,
    /// The command.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a scenario: train the sensor models, localize under each, write tables, figures, report, recording
    Run(Run),
    /// Run studies of distribution regression (the paper's sensor experiments): figures, report, results.json
    Study(Study),
    /// Run a scenario with every combination of other values at some of its keys, here or in shards on a cluster
    Sweep(Sweep),
    /// Merge the shards of a sweep or a run into the results that one machine would have written
    Merge(Merge),
    /// Check scenarios, studies and sweeps without running them
    Validate(Validate),
    /// Print the JSON Schema of scenario files, for editors
    Schema {
        /// Print that of study files instead
        #[arg(long)]
        study: bool,
        /// Print that of sweep files instead
        #[arg(long, conflicts_with = "study")]
        sweep: bool,
    },
    /// List the effects: named ways in which a simulated world can differ from the nominal one; or tell all about one
    Effects {
        /// The effect to tell all about [default: list all effects]
        #[arg(value_parser = EffectName, hide_possible_values = true)]
        name: Option<String>,
    },
    /// Write one simulated drive of a scenario as a measured log (ROS 2 bag or CARMEN log)
    Simulate(Simulate),
    /// Find where a measured log and a simulated scenario disagree, name the effect that the scenario lacks, and add it
    Gap(Gap),
    /// Apply a scenario's effects to a recording: its scans, stamps and odometry become those of a worse robot
    Apply(Apply),
    /// Write a scenario's laser, with as many effects as the format can have, for a simulator; or parameters for AMCL and Beluga
    #[command(subcommand)]
    Export(Export),
    /// Build maps from a log with reference poses: an occupancy grid (ROS `map_server` format) and a map of walls
    Map(Map),
    /// Read what older programs wrote: any log into a ROS 2 bag or a CARMEN log, a map of CMU's `BeeSoft` into a map of ROS
    Convert(Convert),
    /// Say what a log holds: topics, laser, odometry, reference, clocks, what it is good for, and how to cut it
    Inspect(Inspect),
    /// Write a scenario for a log, which `run`, `map` and `gap` take as it is
    Init(Init),
    /// Print the manual page of locsim or of a command (`locsim manual run | man -l -`)
    Manual {
        /// The command [default: locsim as a whole]
        command: Option<String>,
    },
    /// Print a shell's completion script
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// The name of an effect. Completions know all of them. The catalogue refuses others, and says what is meant.
#[derive(Clone)]
struct EffectName;

impl TypedValueParser for EffectName {
    type Value = String;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        StringValueParser::new().parse_ref(command, argument, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(catalogue::names().map(PossibleValue::new)))
    }
}

/// `locsim run`.
#[derive(Debug, Args)]
pub struct Run {
    /// The scenario file
    pub scenario: PathBuf,
    /// Results folder [default: results/ and the name of the scenario]
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Number of trials, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u32>([1, MOST_TRIALS.into()]))]
    pub trials: Option<u32>,
    /// Seed, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub share: Share,
    #[command(flatten)]
    pub threads: Threads,
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
    /// Where range tables are kept between runs [default: `LOCSIM_CACHE`, or `locsim` in the user's cache folder]
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputOptions,
}

/// Destinations of the recording.
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
pub struct Study {
    /// The studies' files
    #[arg(required = true)]
    pub studies: Vec<PathBuf>,
    /// Folder that gets a results folder for each study
    #[arg(long, default_value = "results")]
    pub out: PathBuf,
    /// Number of repeats, instead of the study's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u32>([1, MOST_REPEATS.into()]))]
    pub repeats: Option<u32>,
    /// Seed, instead of the study's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub threads: Threads,
    /// Two repeats on little data, to see whether everything works
    #[arg(long)]
    pub quick: bool,
    /// Go on with an interrupted study
    #[arg(long)]
    pub resume: bool,
    /// Replace earlier results of locsim, and what an interrupted study has kept; nothing else is ever touched
    #[arg(long, conflicts_with = "resume")]
    pub force: bool,
    #[command(flatten)]
    pub output: OutputOptions,
}

/// `locsim sweep`.
#[derive(Debug, Args)]
pub struct Sweep {
    /// The sweep's file
    pub sweep: PathBuf,
    /// Results folder; shards get folders in it [default: results/ and the name of the sweep]
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Print the number of cells, time and memory, and run nothing
    #[arg(long, conflicts_with_all = ["shard", "shards", "engine", "json"])]
    pub dry_run: bool,
    /// Run more than 10000 cells
    #[arg(long)]
    pub yes: bool,
    /// Trials of each cell, instead of the sweep's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u32>([1, MOST_TRIALS.into()]))]
    pub trials: Option<u32>,
    /// Seed, instead of the sweep's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub share: Share,
    #[command(flatten)]
    pub batch: Batch,
    #[command(flatten)]
    pub threads: Threads,
    #[command(flatten)]
    pub earlier: Earlier,
    /// Where range tables are kept between cells [default: `LOCSIM_CACHE`, or `locsim` in the user's cache folder]
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputOptions,
}

/// Scripts of a batch engine.
#[derive(Debug, Args)]
pub struct Batch {
    /// Write the scripts that run --shards shards on a batch engine
    #[arg(long, value_enum, requires = "shards")]
    pub engine: Option<EngineName>,
    /// Submit them as well
    #[arg(long, requires = "engine")]
    pub submit: bool,
}

/// The treatment of earlier results.
#[derive(Debug, Args)]
pub struct Earlier {
    /// Go on with an interrupted sweep; a shard always does
    #[arg(long)]
    pub resume: bool,
    /// Replace earlier results of locsim, and what an interrupted sweep has kept; nothing else is ever touched
    #[arg(long, conflicts_with = "resume")]
    pub force: bool,
}

/// Batch engines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum EngineName {
    /// Slurm: an array job
    Slurm,
    /// `HyperQueue`: a task array
    Hyperqueue,
    /// GNU parallel, on this machine
    Parallel,
}

/// `locsim merge`.
#[derive(Debug, Args)]
pub struct Merge {
    /// The folder with the shards
    pub shards: PathBuf,
    /// Results folder [default: `merged` in the folder with the shards]
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Replace earlier results of locsim; nothing else is ever touched
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub threads: Threads,
    /// Where the recording of one trial of a run goes: a file in the results folder, a running viewer, a new viewer
    #[arg(long, value_enum, default_value_t = Record::File)]
    pub record: Record,
    /// Where range tables of a run are kept [default: `LOCSIM_CACHE`, or `locsim` in the user's cache folder]
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputOptions,
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
    /// Which trial of the scenario to write; those beyond its `trials` are further drives of the same kind
    #[arg(long, default_value_t = 0, allow_negative_numbers = true, value_parser = whole::<u32>([0, u32::MAX.into()]))]
    pub trial: u32,
    /// Seed, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
    pub seed: Option<u64>,
}

/// `locsim apply`.
#[derive(Debug, Args)]
pub struct Apply {
    /// The scenario with the effects, such as `found/scenario.yaml` of a search
    pub scenario: PathBuf,
    /// The recording: a ROS 2 bag (a folder, `.mcap`, `.db3`) or a CARMEN log (`.log`, `.log.gz`)
    #[arg(long = "in", value_name = "LOG")]
    pub log: PathBuf,
    /// The recording to write: a ROS 2 bag (`.mcap`), with all other messages of a bag, or a CARMEN log (`.log`, `.log.gz`)
    #[arg(long)]
    pub out: PathBuf,
    /// Replace the recording if it is there
    #[arg(long)]
    pub force: bool,
    /// Effects that are left out, separated by commas: those that the recording has already
    #[arg(long, value_name = "EFFECT", value_delimiter = ',', value_parser = EffectName, hide_possible_values = true)]
    pub without: Vec<String>,
    /// Seed of the effects' draws, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub log_options: LogOptions,
}

/// `locsim export`: the formats of other programs.
#[derive(Debug, Subcommand)]
pub enum Export {
    /// Gazebo: a model with a `gpu_lidar`, in `SDFormat` 1.9
    Sdf(ExportSensor),
    /// Stage: a `ranger`
    Stage(ExportSensor),
    /// Webots: a `Lidar` node
    Webots(ExportSensor),
    /// nav2's AMCL and Beluga: parameters that are searched on the robot's own drives
    Nav2(ExportNav2),
}

/// `locsim export sdf`, `stage`, `webots`.
#[derive(Debug, Args)]
pub struct ExportSensor {
    /// The scenario, or the results folder of a search or a run
    pub found: PathBuf,
    /// The file to write
    #[arg(short, long)]
    pub out: PathBuf,
    /// Replace the file if it is there
    #[arg(long)]
    pub force: bool,
}

/// `locsim export nav2`.
#[derive(Debug, Args)]
pub struct ExportNav2 {
    /// A scenario, the results folder of a search or a run, or a log with reference poses: a ROS 2 bag (a folder, `.mcap`, `.db3`) or a
    /// CARMEN log (`.log`, `.log.gz`)
    pub source: PathBuf,
    /// AMCL's parameter file; beside NAME.yaml come NAME.beluga.yaml, NAME.report.md and NAME.report.html
    #[arg(short, long)]
    pub out: PathBuf,
    /// Replace these files if they are there
    #[arg(long)]
    pub force: bool,
    /// Sets of parameters that are tried, 16 to 100000
    #[arg(long, default_value_t = 400, allow_negative_numbers = true, value_parser = whole::<u32>([16, 100_000]))]
    pub evaluations: u32,
    /// Trials of the comparison with nav2's defaults, 2 to 100000
    #[arg(long, default_value_t = 20, allow_negative_numbers = true, value_parser = whole::<u32>([2, 100_000]))]
    pub trials: u32,
    /// Seed, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub threads: Threads,
    #[command(flatten)]
    pub log_options: LogOptions,
    /// Where range tables are kept between runs [default: `LOCSIM_CACHE`, or `locsim` in the user's cache folder]
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    /// No progress and no table
    #[arg(long)]
    pub quiet: bool,
}

/// `locsim map`.
#[derive(Debug, Args)]
pub struct Map {
    /// A log with reference poses: a ROS 2 bag (a folder, `.mcap`, `.db3`) or a CARMEN log (`.log`, `.log.gz`); or a scenario
    /// of one (`.yaml`), whose map scans are then taken
    pub log: PathBuf,
    /// The maps to write: OUT.yaml and OUT.pgm (cells), OUT.walls.yaml (walls), OUT.check.svg (held-out readings on it)
    #[arg(long)]
    pub out: PathBuf,
    /// Replace the map if it is there
    #[arg(long)]
    pub force: bool,
    // Not a doc comment: rustdoc takes brackets for a link.
    #[arg(long, allow_negative_numbers = true, value_parser = number([1e-3, 10.0]), help = "Cell size [m], 0.001 to 10 [default: the scenario's, or 0.05]")]
    pub resolution: Option<f64>,
    /// Use only this share of the log, for example 0.0,0.5
    #[arg(long, value_delimiter = ',', num_args = 1, allow_negative_numbers = true, value_parser = number([0.0, 1.0]))]
    pub share: Vec<f64>,
    #[command(flatten)]
    pub log_options: LogOptions,
}

/// `locsim convert`.
#[derive(Debug, Args)]
pub struct Convert {
    /// A log that locsim reads, or a map of `BeeSoft` (`wean.dat`)
    pub file: PathBuf,
    /// Of a log: the ROS 2 bag (`.mcap`) or the CARMEN log (`.log`, `.log.gz`) to write. Of a map: OUT.yaml and OUT.pgm
    #[arg(long)]
    pub out: PathBuf,
    /// Replace what is there
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub log_options: LogOptions,
}

/// `locsim inspect`.
#[derive(Debug, Args)]
pub struct Inspect {
    /// The log: a ROS 2 bag (a folder, `.mcap`, `.db3`) or a CARMEN log (`.log`, `.log.gz`)
    pub log: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// Draw the drive into this file: `.svg` or `.png`
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// Replace the picture if it is there
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub log_options: LogOptions,
}

/// `locsim init`.
#[derive(Debug, Args)]
pub struct Init {
    /// The log: a ROS 2 bag (a folder, `.mcap`, `.db3`) or a CARMEN log (`.log`, `.log.gz`)
    pub log: PathBuf,
    /// The scenario to write
    #[arg(short, long)]
    pub out: PathBuf,
    /// The map: a ROS `map_server` YAML, a vector map, or a map of walls [default: one that is built from the log]
    #[arg(long)]
    pub map: Option<PathBuf>,
    /// Replace the scenario if it is there
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub log_options: LogOptions,
}

/// How to read a log.
#[derive(Debug, Args)]
pub struct LogOptions {
    /// Readings at or above this count as no return [m; default: the log's own]
    #[arg(long, allow_negative_numbers = true, value_parser = number([1e-3, RANGE_M]))]
    pub max_range: Option<f64>,
    /// The bag's topic of laser scans [default: `/scan`, or the only one]
    #[arg(long, value_name = "TOPIC")]
    pub scan_topic: Option<String>,
    /// The bag's topic of odometry [default: `/odom`, the only one, or the transform `odom:base_link`]
    #[arg(long, value_name = "TOPIC")]
    pub odometry_topic: Option<String>,
    /// The bag's topic of reference poses or a transform such as `map:base_link` [default: `/reference`, `/ground_truth`,
    /// `/base_pose_ground_truth`, `/ground_truth/state`, or what a localizer found]
    #[arg(long, value_name = "TOPIC")]
    pub reference_topic: Option<String>,
}

impl LogOptions {
    /// Each option that is given, and its value.
    fn given(&self) -> impl Iterator<Item = (&'static str, String)> {
        let options = [
            ("--max-range", self.max_range.map(|max| max.to_string())),
            ("--scan-topic", self.scan_topic.clone()),
            ("--odometry-topic", self.odometry_topic.clone()),
            ("--reference-topic", self.reference_topic.clone()),
        ];
        options.into_iter().filter_map(|(option, value)| Some((option, value?)))
    }

    /// The first option that is given.
    pub fn first_given(&self) -> Option<&'static str> {
        self.given().next().map(|(option, _)| option)
    }

    /// The options as a shell takes them, each behind a blank.
    pub fn command_line(&self) -> String {
        self.given().fold(String::new(), |line, (option, value)| {
            line + " " + option + " " + &in_shell(Path::new(&value))
        })
    }
}

/// `locsim validate`.
#[derive(Debug, Args)]
pub struct Validate {
    /// Scenario, study and sweep files
    #[arg(required = true)]
    pub scenarios: Vec<PathBuf>,
    /// Hold a scenario against this log as well, as `locsim gap` does before it searches: laser, mount, reference poses, map
    #[arg(long)]
    pub log: Option<PathBuf>,
    #[command(flatten)]
    pub log_options: LogOptions,
}

/// `locsim gap`.
#[derive(Debug, Args)]
pub struct Gap {
    /// The scenario: a simulation of the robot as it is thought to be
    #[arg(required = true)]
    pub scenario: Option<PathBuf>,
    /// The measured log, with reference poses: a ROS 2 bag (a folder, `.mcap`, `.db3`) or a CARMEN log (`.log`, `.log.gz`)
    /// [default: the scenario's]
    #[arg(long)]
    pub log: Option<PathBuf>,
    /// An earlier log of the same robot: name what has changed since, instead of what the simulation lacks
    #[arg(long, value_name = "LOG")]
    pub baseline: Option<PathBuf>,
    /// Results folder
    #[arg(long, required = true)]
    pub out: Option<PathBuf>,
    /// Replace earlier results of locsim; nothing else is ever touched
    #[arg(long)]
    pub force: bool,
    /// Simulated logs (beside a baseline: permutations) behind a p-value, at least 19; its least value is 1 / (replicates + 1). Where 99 to
    /// 398 leave a log in doubt, 399 are simulated. Beside a baseline, changes that all stretches show have smaller values, by Student's
    /// distribution
    /// [default: 999; beside a baseline 399]
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u32>(GapSettings::ALLOWED_REPLICATES))]
    pub replicates: Option<u32>,
    /// Seed, instead of the scenario's
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub threads: Threads,
    /// The most scans of the log that are looked at: the first ones, or with --baseline every second, third and so on
    #[arg(long, default_value_t = GapSettings::SCANS, allow_negative_numbers = true, value_parser = whole::<usize>(GapSettings::ALLOWED_SCANS))]
    pub scans: usize,
    /// The most beams of a scan that are looked at, evenly spread
    #[arg(long, default_value_t = GapSettings::BEAMS, allow_negative_numbers = true, value_parser = whole::<usize>(GapSettings::ALLOWED_BEAMS))]
    pub beams: usize,
    /// Effects that are left out of the library, separated by commas
    #[arg(long, value_name = "EFFECT", value_delimiter = ',', value_parser = EffectName, hide_possible_values = true)]
    pub without: Vec<String>,
    /// Don't run the particle filter with the old and the new simulator
    #[arg(long)]
    pub no_filter: bool,
    #[command(flatten)]
    pub log_options: LogOptions,
    /// Where range tables are kept between runs [default: `LOCSIM_CACHE`, or `locsim` in the user's cache folder]
    #[arg(long, value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    #[command(flatten)]
    pub output: OutputOptions,
    /// Only say what an effect is, what gives it away and what it is confused with
    #[arg(long, value_name = "EFFECT", exclusive = true, value_parser = EffectName, hide_possible_values = true)]
    pub explain: Option<String>,
}
