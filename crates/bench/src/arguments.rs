//! Commands and options of the program.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use locsim_bench::suite::{Group, Setup, Size};
use locsim_core::limits::RANGE_M;
use locsim_terminal::{LimitOptions, OutputOptions, Share, Threads, number, whole};

/// Benchmarks of locsim.
///
/// Exit codes: 0 done, 2 bad input, 130 interrupted.
#[derive(Debug, Parser)]
#[command(name = "locsim-bench", version, max_term_width = 110)]
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
    /// Measure speed and accuracy on a folder of fixed work, beside targets and other programs
    Speed(Speed),
    /// Run the hidden-effect suite: how often and how well `locsim gap` finds what is hidden in simulated logs
    Gap(Gap),
    /// Measure distribution regression on its fixed task: times, risks, agreement with the dense product
    Regression(Regression),
}

/// `locsim-bench speed`.
#[derive(Debug, Args)]
pub struct Speed {
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

/// `locsim-bench gap`.
#[derive(Debug, Args)]
pub struct Gap {
    /// The nominal scenario
    #[arg(default_value = "scenarios/gap/nominal.yaml")]
    pub scenario: PathBuf,
    /// Instead of simulated logs, edit the corrected CARMEN logs of this folder (`.log`, `.log.gz`), and hold each against its own
    /// other half: the test of `locsim gap --baseline`
    #[arg(long, value_name = "DIR")]
    pub real: Option<PathBuf>,
    /// Range from which a reading of these logs is no return [m]
    #[arg(long, default_value_t = 40.0, allow_negative_numbers = true, value_parser = number([1e-3, RANGE_M]), requires = "real")]
    pub max_range: f64,
    /// How much: small (minutes), medium (two hours on two cores), full (a day)
    #[arg(long, value_enum, default_value_t)]
    pub size: Size,
    /// Only logs of these groups, with commas between
    #[arg(long, value_enum, value_delimiter = ',', conflicts_with = "real")]
    pub groups: Vec<Group>,
    /// Only logs of these lasers and scenarios, with commas between; the small suite has the nominal one alone
    #[arg(long, value_enum, value_delimiter = ',', conflicts_with = "real")]
    pub setups: Vec<Setup>,
    /// Everything random derives from it: tune on one seed, score on another
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
    pub seed: u64,
    /// Begin no log after this many minutes, and score what is done; the same command goes on
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<u64>([0, u64::MAX]))]
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
    #[command(flatten)]
    pub share: Share,
    /// Put the shards in the folder together in its folder `merged`, and score all logs
    #[arg(long, conflicts_with_all = ["shard", "shards", "real"])]
    pub merge: bool,
    #[command(flatten)]
    pub threads: Threads,
    #[command(flatten)]
    pub output: OutputOptions,
}

/// `locsim-bench regression`.
#[derive(Debug, Args)]
pub struct Regression {
    /// Folder of the task's script, task.py. Its data are part of the program, number by number, so that the
    /// folder is only asked whether it is the right one
    pub folder: Option<PathBuf>,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}
