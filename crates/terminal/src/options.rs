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
    #[arg(long, allow_negative_numbers = true, value_parser = whole::<usize>)]
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
    /// A number that is not allowed; threads that the system refuses.
    pub fn set(&self) -> Result<()> {
        if let Some(threads) = self.threads {
            let most = THREADS_PER_CORE * std::thread::available_parallelism().map_or(1, usize::from);
            anyhow::ensure!(
                (1..=most).contains(&threads),
                "--threads: {threads} is not allowed; a whole number from 1 to {most}, {THREADS_PER_CORE} for each core"
            );
            rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
        }
        Ok(())
    }
}

/// One of several shares of the work.
#[derive(Debug, Args)]
pub struct Share {
    /// Run one of N equal shares, of the cells of a sweep, the trials of a run or the logs of a suite, from 1/N to N/N; a merge puts them together
    /// [default: a Slurm array's task]
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    pub shard: Option<Shard>,
    /// Number of shards; which one is this is the engine's task number (`SLURM_ARRAY_TASK_ID`, `HQ_TASK_ID`, `PARALLEL_SEQ`)
    #[arg(long, value_name = "N", conflicts_with = "shard", allow_negative_numbers = true, value_parser = whole::<u32>)]
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

/// A whole number from 0 on; clap's own message of a number that is too large or negative doesn't say what is allowed.
///
/// # Errors
/// The numbers that are allowed.
pub fn whole<T: TryFrom<u64> + Copy>(text: &str) -> Result<T, String> {
    let most = if size_of::<T>() == 4 { u64::from(u32::MAX) } else { u64::MAX };
    let refused = || format!("a whole number from 0 to {most} is allowed");
    text.parse::<u64>().ok().and_then(|value| T::try_from(value).ok()).ok_or_else(refused)
}
