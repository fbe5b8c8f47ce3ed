//! Tries mutated inputs on every reader of locsim, with a stable compiler.
//!
//! `locsim-fuzz try` makes inputs from the corpus and runs them in a process of their own, so that an abort ends that
//! process alone; the input under way is on disk. An input that panics, aborts, takes more memory or more time than is
//! allowed is kept in `failures/` and printed with the command that repeats it.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use clap::{Args, Parser, Subcommand};
use locsim_fuzz::{TARGETS, Target, mutate, target};
use peak_alloc::PeakAlloc;
use sysinfo::{Pid, Process, ProcessRefreshKind, ProcessesToUpdate, System};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// The system gives a worker this much address space \[KiB\], so that an input that wants everything ends the worker
/// and not the machine.
const ADDRESS_SPACE_KIB: u32 = 6 << 20;

/// An input may take this many times its processor time by the clock.
const PATIENCE: u32 = 10;

/// How many inputs are kept that fail in the same way.
const KEPT_ALIKE: usize = 3;

/// So many failures of a target are enough to look at.
const MOST_FAILURES: usize = 2000;

/// Damaged and hostile inputs for every reader of locsim.
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    command: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Try mutated inputs and keep those that fail
    Try(Try),
    /// Run files again and say what becomes of each
    Repeat(Repeat),
    /// Write one input of a series to a file
    Make {
        /// The kind of input
        #[arg(value_parser = known)]
        target: Target,
        /// Which input
        number: u64,
        /// Everything random derives from it
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// The file
        #[arg(long)]
        out: PathBuf,
    },
    /// Make the seeds anew whose formats are the program's own
    Seeds,
    #[command(hide = true)]
    Work(Work),
}

#[derive(Args)]
struct Try {
    /// Kinds of inputs [default: all]
    #[arg(value_parser = known)]
    targets: Vec<Target>,
    /// Everything random derives from it
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// So many inputs of each kind at least
    #[arg(long, default_value_t = 200)]
    inputs: u64,
    /// Go on for about so many seconds in all
    #[arg(long, default_value_t = 0)]
    seconds: u64,
    /// Processes at a time [default: all cores]
    #[arg(long)]
    jobs: Option<usize>,
    #[command(flatten)]
    most: Most,
}

#[derive(Args)]
struct Repeat {
    /// The kind of input
    #[arg(value_parser = known)]
    target: Target,
    /// The inputs
    files: Vec<PathBuf>,
    #[command(flatten)]
    most: Most,
}

#[derive(Args)]
struct Work {
    #[arg(value_parser = known)]
    target: Target,
    #[arg(long)]
    seed: u64,
    #[arg(long)]
    from: u64,
    #[arg(long)]
    inputs: u64,
    #[arg(long)]
    seconds: u64,
    /// Gets the number of an input and the input, before it is run
    #[arg(long)]
    under_way: PathBuf,
    #[command(flatten)]
    most: Most,
}

/// What an input may cost.
#[derive(Clone, Copy, Args)]
struct Most {
    /// Memory that an input may take [bytes]
    #[arg(long, default_value_t = 1_000_000_000)]
    most_bytes: usize,
    /// Processor time that an input may take [s]; by the clock it may take ten times as long
    #[arg(long, default_value_t = 10.0)]
    most_seconds: f64,
}

fn known(name: &str) -> Result<Target, String> {
    let names = || TARGETS.map(|target| target.name).join(", ");
    target(name).ok_or_else(|| format!("allowed: {}", names()))
}

/// Bytes of a seed that is kept in the corpus.
const LARGEST_SEED: usize = 100_000;

fn main() -> ExitCode {
    match Arguments::parse().command {
        Task::Try(arguments) => try_all(&arguments),
        Task::Repeat(arguments) => repeat(&arguments),
        Task::Make { target, number, seed, out } => {
            fs::write(out, mutate::input(&target, &corpus(&target), seed, number)).expect("a file");
            ExitCode::SUCCESS
        }
        Task::Seeds => {
            for (target, name, content) in locsim_fuzz::seeds() {
                // The tests make larger ones for themselves.
                if content.len() > LARGEST_SEED {
                    continue;
                }
                fs::write(folder("corpus").join(target).join(name), content).expect("a file in the corpus");
            }
            ExitCode::SUCCESS
        }
        Task::Work(arguments) => work(&arguments),
    }
}

#[expect(clippy::disallowed_methods, reason = "the driver bounds the time of an input")]
fn now() -> Instant {
    Instant::now()
}

/// Processor time of this process so far.
fn processor_time(system: &mut System) -> Duration {
    let own = Pid::from_u32(std::process::id());
    let what = ProcessRefreshKind::nothing().with_cpu();
    system.refresh_processes_specifics(ProcessesToUpdate::Some(&[own]), false, what);
    Duration::from_millis(system.process(own).map_or(0, Process::accumulated_cpu_time))
}

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// The seeds of a target, in the order of their names.
fn corpus(target: &Target) -> Vec<Vec<u8>> {
    let folder = folder("corpus").join(target.name);
    let entries = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("a file").path()).collect();
    paths.sort();
    paths.iter().map(|path| fs::read(path).expect("a file")).collect()
}

/// Ends the process when an input takes too long or too much while it runs. Never returns.
struct Watch {
    /// When the input under way began, in milliseconds since `start`, plus 1; 0 for none.
    began: AtomicU64,
    start: Instant,
    most: Most,
    /// Bytes in use before the input.
    before: AtomicUsize,
}

impl Watch {
    fn begin(most: Most) -> &'static Self {
        let (began, before) = (AtomicU64::new(0), AtomicUsize::new(0));
        let watch: &Self = Box::leak(Box::new(Self { began, start: now(), most, before }));
        thread::spawn(|| watch.look());
        watch
    }

    /// A machine with other work takes longer by the clock, so the bound is on processor time. An input that waits for
    /// something uses none.
    fn look(&self) {
        let mut system = System::new();
        let mut input = (0, Duration::ZERO);
        loop {
            thread::sleep(Duration::from_millis(20));
            let began = self.began.load(Ordering::Relaxed);
            let worked = processor_time(&mut system);
            if began != input.0 {
                input = (began, worked);
            }
            if began > 0 {
                let waited = (now() - self.start).saturating_sub(Duration::from_millis(began));
                let time = worked.saturating_sub(input.1).max(waited / PATIENCE);
                if time.as_secs_f64() > self.most.most_seconds {
                    Self::fail(&format!("more than {} s", self.most.most_seconds));
                }
            }
            self.check_memory();
        }
    }

    fn check_memory(&self) {
        let taken = self.taken();
        if taken > self.most.most_bytes {
            Self::fail(&format!("{} MB of memory", taken / 1_000_000));
        }
    }

    fn fail(what: &str) -> ! {
        eprintln!("too much: {what}");
        std::process::exit(1)
    }

    /// The most memory in use since the input began, without what was in use before.
    fn taken(&self) -> usize {
        MEMORY.peak_usage().saturating_sub(self.before.load(Ordering::Relaxed))
    }

    /// Runs an input; returns what became of it, the memory that it took, and the time.
    fn run(&self, target: &Target, data: &[u8]) -> (locsim_fuzz::Outcome, usize, Duration) {
        MEMORY.reset_peak_usage();
        self.before.store(MEMORY.current_usage(), Ordering::Relaxed);
        let began = now();
        self.began.store((began - self.start).as_millis() as u64 + 1, Ordering::Relaxed);
        let outcome = (target.run)(data);
        self.began.store(0, Ordering::Relaxed);
        let took = now() - began;
        self.check_memory();
        (outcome, self.taken(), took)
    }
}

fn repeat(arguments: &Repeat) -> ExitCode {
    let watch = Watch::begin(arguments.most);
    for file in &arguments.files {
        let data = fs::read(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        println!("{}", file.display());
        let (outcome, bytes, took) = watch.run(&arguments.target, &data);
        let outcome = outcome.map_or_else(|why| format!("refused: {why}"), |()| "accepted".to_owned());
        println!("{outcome}\n{bytes} bytes, {:.3} s", took.as_secs_f64());
    }
    ExitCode::SUCCESS
}

/// What a worker, or all workers of a target, found.
#[derive(Clone, Copy, Default)]
struct Tally {
    accepted: u64,
    /// The most memory that an input took \[bytes\], and which one.
    bytes: (u64, u64),
    /// The most time \[ms\], and which one.
    millis: (u64, u64),
}

impl Tally {
    fn add(&mut self, other: Self) {
        self.accepted += other.accepted;
        self.bytes = self.bytes.max(other.bytes);
        self.millis = self.millis.max(other.millis);
    }

    fn of(line: &str) -> Option<Self> {
        let numbers: Vec<u64> = line.split(' ').map(|word| word.parse().ok()).collect::<Option<_>>()?;
        let &[accepted, bytes, bytes_at, millis, millis_at] = numbers.as_slice() else { return None };
        Some(Self { accepted, bytes: (bytes, bytes_at), millis: (millis, millis_at) })
    }

    fn line(&self) -> String {
        let Self { accepted, bytes, millis } = self;
        format!("{accepted} {} {} {} {}", bytes.0, bytes.1, millis.0, millis.1)
    }
}

/// Runs inputs one by one and prints a tally now and then; ends with the first input that fails.
fn work(arguments: &Work) -> ExitCode {
    let start = now();
    let seeds = corpus(&arguments.target);
    let watch = Watch::begin(arguments.most);
    let mut tally = Tally::default();
    let mut printed = start;
    for number in arguments.from.. {
        if number >= arguments.inputs && (now() - start).as_secs() >= arguments.seconds {
            break;
        }
        let data = mutate::input(&arguments.target, &seeds, arguments.seed, number);
        // Before it is run: nothing can be written after an abort.
        let record = [&number.to_le_bytes()[..], &data].concat();
        fs::write(&arguments.under_way, record).expect("the file of the input under way");
        let (outcome, bytes, took) = watch.run(&arguments.target, &data);
        tally.add(Tally {
            accepted: u64::from(outcome.is_ok()),
            bytes: (bytes as u64, number),
            millis: (took.as_millis() as u64, number),
        });
        if now() - printed > Duration::from_secs(1) {
            printed = now();
            println!("{}", tally.line());
            tally = Tally { accepted: 0, ..tally };
        }
    }
    println!("{}", tally.line());
    ExitCode::SUCCESS
}

/// What was found in one target.
struct Found {
    inputs: u64,
    tally: Tally,
    failures: usize,
    /// Kept files and what became of each.
    kept: Vec<(PathBuf, String)>,
}

fn try_all(arguments: &Try) -> ExitCode {
    let targets = if arguments.targets.is_empty() { TARGETS.to_vec() } else { arguments.targets.clone() };
    let jobs = arguments.jobs.unwrap_or_else(|| thread::available_parallelism().map_or(1, usize::from));
    let seconds = arguments.seconds * jobs as u64 / targets.len() as u64;
    let scratch = tempfile::Builder::new().prefix("locsim-fuzz-").tempdir().expect("a temporary folder");
    println!(
        "{:<12} {:>9} {:>9} {:>9}  most memory       most time",
        "target", "inputs", "accepted", "failures"
    );
    let next = AtomicUsize::new(0);
    let all = Mutex::new((0, 0, Vec::new()));
    thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let Some(target) = targets.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let found = try_target(target, arguments, seconds, scratch.path());
                    let Tally { accepted, bytes, millis } = found.tally;
                    println!(
                        "{:<12} {:>9} {accepted:>9} {:>9}  {} MB (#{})  {:.3} s (#{})",
                        target.name,
                        found.inputs,
                        found.failures,
                        bytes.0 / 1_000_000,
                        bytes.1,
                        millis.0 as f64 / 1e3,
                        millis.1
                    );
                    let mut all = all.lock().expect("no panic");
                    all.0 += found.inputs;
                    all.1 += found.failures;
                    all.2.extend(found.kept);
                }
            });
        }
    });
    let (inputs, failures, kept) = all.into_inner().expect("no panic");
    println!("{inputs} inputs, {failures} failures");
    for (file, what) in &kept {
        let name = file.file_name().and_then(OsStr::to_str).unwrap_or_default();
        let target = name.split_once('-').map_or(name, |(target, _)| target);
        println!("\n{what}\n  cargo run -p locsim-fuzz -- repeat {target} {}", file.display());
    }
    if failures == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Runs workers over the inputs of a target until none of them dies.
fn try_target(target: &Target, arguments: &Try, seconds: u64, scratch: &Path) -> Found {
    let start = now();
    let scratch = scratch.join(target.name);
    fs::create_dir_all(&scratch).expect("a folder in the temporary folder");
    let under_way = scratch.join("under-way");
    let mut found = Found { inputs: 0, tally: Tally::default(), failures: 0, kept: Vec::new() };
    let mut alike = BTreeMap::<String, usize>::new();
    let mut from = 0;
    while found.failures < MOST_FAILURES {
        let left = seconds.saturating_sub((now() - start).as_secs());
        if from > 0 && from >= arguments.inputs && left == 0 {
            break;
        }
        let output = worker(target, arguments, from, left, &scratch).output().expect("a worker");
        for tally in String::from_utf8_lossy(&output.stdout).lines().filter_map(Tally::of) {
            found.tally.add(tally);
        }
        let record = fs::read(&under_way).expect("the input under way");
        let (number, data) = record.split_first_chunk().expect("a number before the input");
        from = u64::from_le_bytes(*number) + 1;
        found.inputs = from;
        if output.status.success() {
            break;
        }
        found.failures += 1;
        let text = String::from_utf8_lossy(&output.stderr);
        let what = what_happened(&text).unwrap_or_else(|| format!("{}: {text}", output.status));
        let times = alike.entry(what.lines().next().unwrap_or_default().to_owned()).or_default();
        *times += 1;
        if *times <= KEPT_ALIKE {
            let name = format!("{}-{}", target.name, &blake3::hash(data).to_hex()[..16]);
            let file = folder("failures").join(name);
            fs::create_dir_all(folder("failures")).expect("the folder of failures");
            fs::write(&file, data).expect("a file in the folder of failures");
            found.kept.push((file, what));
        }
    }
    found
}

/// The place and the words of a panic, or what else a worker said last.
fn what_happened(text: &str) -> Option<String> {
    let start = text
        .find("panicked at ")
        .or_else(|| text.find("too much: "))
        .or_else(|| text.find("memory allocation"))?;
    Some(text[start..].lines().take(3).collect::<Vec<_>>().join("\n  "))
}

fn worker(target: &Target, arguments: &Try, from: u64, seconds: u64, scratch: &Path) -> Command {
    let program = std::env::current_exe().expect("the path of this program");
    let mut command = if cfg!(unix) {
        let mut shell = Command::new("sh");
        shell.arg("-c").arg(format!("ulimit -v {ADDRESS_SPACE_KIB} && exec \"$0\" \"$@\"")).arg(program);
        shell
    } else {
        Command::new(program)
    };
    let Most { most_bytes, most_seconds } = arguments.most;
    command
        .args(["work", target.name])
        .args(["--seed", &arguments.seed.to_string(), "--from", &from.to_string()])
        .args(["--inputs", &arguments.inputs.to_string(), "--seconds", &seconds.to_string()])
        .args(["--most-bytes", &most_bytes.to_string(), "--most-seconds", &most_seconds.to_string()])
        .arg("--under-way")
        .arg(scratch.join("under-way"))
        // Its files go with the folder, also when it dies. Threads of its own would only be in each other's way.
        .env("TMPDIR", scratch)
        .env("RAYON_NUM_THREADS", "1")
        .env_remove("LOCSIM_DATA")
        .stdin(Stdio::null());
    command
}
