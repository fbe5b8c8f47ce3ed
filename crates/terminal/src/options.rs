use std::fmt::Write;

use anyhow::Result;
use clap::Args;
use locsim_core::Shard;
use locsim_core::limits::{Limit, Limits, THREADS_PER_CORE};

/// `--limit`, which every command takes.
#[derive(Debug, Args)]
pub struct LimitOptions {
    /// Change a limit on what may be read, such as `map_pixels=400000000`; may be given more than once
    // Its list is long, and few need it: it stands last.
    #[arg(long, global = true, value_name = "NAME=VALUE", long_help = limit_help(), help_heading = "Limits")]
    limit: Vec<String>,
}

impl LimitOptions {
    /// Sets the limits of the process.
    ///
    /// # Errors
    /// A limit that doesn't exist, or a value that is no number.
    pub fn set(&self) -> Result<()> {
        Limits::DEFAULT.with(self.limit.iter().map(String::as_str))?.set();
        Ok(())
    }
}

/// The limits with their defaults.
fn limit_help() -> String {
    let mut help =
        "Change a limit on what may be read; may be given more than once. The limits:\n".to_owned();
    for Limit { name, default, what } in Limits::TABLE {
        let _ = write!(help, "\n  {name}={default}\n      {what}");
    }
    help
}

/// `--threads` of commands that compute in parallel.
#[derive(Debug, Args)]
pub struct Threads {
    /// Worker threads, at most 4 for each core; results don't depend on it [default: all cores]
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<usize>([1, most_threads()]))]
    threads: Option<usize>,
}

impl Threads {
    /// The number asked for, if any.
    pub fn asked(&self) -> Option<usize> {
        self.threads
    }

    /// Limits the worker threads of the process.
    ///
    /// # Errors
    /// Threads that the system refuses.
    pub fn set(&self) -> Result<()> {
        if let Some(threads) = self.threads {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
        }
        Ok(())
    }
}

/// The most worker threads on this machine.
fn most_threads() -> u64 {
    (THREADS_PER_CORE * std::thread::available_parallelism().map_or(1, usize::from)) as u64
}

/// One of several shares of the work.
#[derive(Debug, Args)]
pub struct Share {
    /// Run one of N equal shares, of the cells of a sweep, the trials of a run or the logs of a suite, from 1/N to N/N; a merge puts them together
    /// [default: a Slurm array's task]
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    pub shard: Option<Shard>,
    /// Number of shards; which one is this is the engine's task number (`SLURM_ARRAY_TASK_ID`, `HQ_TASK_ID`, `PARALLEL_SEQ`)
    #[arg(long, value_name = "N", conflicts_with = "shard", allow_negative_numbers = true, value_parser = whole::<u32>([1, u32::MAX.into()]))]
    pub shards: Option<u32>,
}

impl Share {
    /// The shard that the command line or a batch engine asks for, if any.
    ///
    /// # Errors
    /// Variables of an engine that don't name a shard.
    pub fn asked(&self) -> Result<Option<Shard>> {
        let environment = |name: &str| std::env::var(name).ok();
        match self.shard {
            Some(shard) => Ok(Some(shard)),
            None => {
                Shard::from_environment(&environment, self.shards).map_err(|error| anyhow::anyhow!(error))
            }
        }
    }
}

/// Output of a command.
#[derive(Debug, Args)]
pub struct OutputOptions {
    /// Print nothing but errors and, with --json, the results
    #[arg(long)]
    pub quiet: bool,
    /// Print the results as JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// A parser of whole numbers from `least` to `most`; clap's own message of a number beyond its type doesn't say what is allowed.
pub fn whole<T: TryFrom<u64> + Clone + Send + Sync + 'static>(
    [least, most]: [u64; 2],
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let value = text.parse().ok().filter(|value| (least..=most).contains(value));
        value
            .and_then(|value| T::try_from(value).ok())
            .ok_or_else(|| format!("a whole number from {least} to {most} is allowed"))
    }
}

/// A parser of finite numbers from `least` to `most`.
pub fn number(
    [least, most]: [f64; 2],
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| {
        let value = text.parse().ok().filter(|value| (least..=most).contains(value));
        value.ok_or_else(|| format!("a number from {least} to {most} is allowed"))
    }
}
