//! The hidden-effect suite: logs in which an effect is hidden, the search that doesn't know, and a score.
//!
//! The search reads a log and the nominal scenario; the score reads truths and findings afterwards, from folders of their
//! own. Whatever is done is kept with its hash, and a run that was interrupted goes on where it stopped.

mod plan;
mod score;
mod setup;
mod text;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use locsim_core::{Control, Draw, Drive, Estimate, Progress, RecordedError, Shard, Stage};
use locsim_dataset::{LogOptions, read_log, write_log};
use locsim_gap::hidden::record_library;
use locsim_gap::{GapError, GapOptions, Nominal, Outcome, Recorded, Strength, Unnamed, Verdict, find};
use locsim_world::effect::{Effect, EffectKind, Effects};
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::{Simulator, simulate_drive};
use rayon::ThreadPoolBuilder;
use serde::{Deserialize, Serialize};
use tempfile::TempDir;

pub use plan::{Group, Size};
pub use score::{Score, SetupScore, Share};
pub use setup::Setup;
pub use text::table;

use crate::BenchError;
use crate::hidden::{OtherForm, record_other, record_outside};
use locsim_lab::gap::{FilterOnLog, GapSettings, GapStudy};
use locsim_report::store::{Folder, Lock};
use locsim_scenario::{Overrides, Scenario, Simulation, Source, load_map};
use plan::{Case, Hidden, REGIMES, plan};

/// How the suite is run.
pub struct SuiteOptions<'a> {
    /// The nominal scenario.
    pub scenario: PathBuf,
    /// Where truths and findings go.
    pub out: PathBuf,
    /// The share of the logs that is run; `None` for all.
    pub shard: Option<Shard>,
    /// A folder of shards whose truths and findings are taken over; nothing is run then.
    pub shards: Option<PathBuf>,
    /// How much.
    pub size: Size,
    /// The groups that are run; none for all.
    pub groups: Vec<Group>,
    /// The setups that are run; none for all.
    pub setups: Vec<Setup>,
    /// Everything random derives from it.
    pub seed: u64,
    /// Simulated logs behind each p-value.
    pub replicates: u32,
    /// The most scans of a log.
    pub scans: usize,
    /// The caller's clock and progress; an interruption stops the searches at hand.
    pub control: Control<'a>,
    /// No log is begun later than this; what is done is scored, and the next run goes on.
    pub no_later: Option<Duration>,
}

/// The truth about a log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthFile {
    /// The log's purpose in the suite.
    pub group: Group,
    /// Its laser, and what its scenario says.
    pub setup: Setup,
    /// Information of each effect.
    pub lambda: f64,
    /// Name of the regime.
    pub regime: String,
    /// Names of the effects.
    pub effects: Vec<String>,
    /// Their numbers.
    pub values: Vec<BTreeMap<String, f64>>,
    /// Of each, the number that is its strength.
    pub strength: Vec<String>,
    /// The least error of an estimate of the strength of one effect in the library's form, see [`Strength::least_error`].
    pub least_error: Option<f64>,
    /// Stages taken out of the library.
    pub without: Vec<String>,
    /// The covariates of an effect from outside the library: any of these is right.
    pub covariates: Vec<String>,
}

/// The findings of the search in a log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundFile {
    /// The verdict.
    pub verdict: Verdict,
    /// Names, in order.
    pub effects: Vec<String>,
    /// Of each, the set that can't be told apart.
    pub candidates: Vec<Vec<String>>,
    /// Of each, value and interval of its numbers.
    pub numbers: Vec<BTreeMap<String, [f64; 3]>>,
    /// Global p-value.
    pub p: f64,
    /// The same with the named effects.
    pub p_after: f64,
    /// Share of the log score gained, with its interval.
    pub gained: [f64; 3],
    /// Share of the gap closed, with its interval; `None` where ranges can't say.
    pub closed: Option<[f64; 3]>,
    /// Wasserstein-1 distance of range errors before and after, and its floor \[mm\].
    pub w1_mm: [f64; 3],
    /// Dependences without a name: what depends on what, and the effect whose form it corrects.
    pub unnamed: Vec<UnnamedFile>,
    /// How far the log is off in every effect's direction, in standard deviations.
    pub directions: BTreeMap<String, f64>,
    /// Threshold of that statistic for effects that shift or spread readings or act on the odometry.
    pub threshold: f64,
    /// Time \[s\].
    pub seconds: f64,
    /// Its influence on a filter, where it was measured.
    #[serde(default)]
    pub filter: Option<FilterFile>,
    /// The effects themselves.
    #[serde(skip)]
    named: Vec<Effect>,
}

/// A dependence that no effect explains.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnnamedFile {
    /// The quantity of a reading, or of the odometry, that depends on it.
    pub deviation: String,
    /// On what.
    pub covariate: String,
    /// The named effect whose form it corrects.
    pub form_of: Option<String>,
    /// Log score gained (nats).
    pub gain_nats: f64,
}

impl UnnamedFile {
    fn of(found: &Unnamed) -> Self {
        Self {
            deviation: key(&found.deviation),
            covariate: key(&found.covariate),
            form_of: found.form_of.map(|kind| kind.name().to_owned()),
            gain_nats: found.evidence.gain_nats.value,
        }
    }
}

/// The name of a value in files.
fn key(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// Position error of a filter on a log \[m\], over its seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilterFile {
    /// With the nominal simulator.
    pub before_m: f64,
    /// With the named effects.
    pub after_m: f64,
    /// With the hidden effect itself.
    pub with_truth_m: f64,
}

impl FoundFile {
    fn of(outcome: &Outcome, seconds: f64) -> Self {
        let triple = |&Estimate { value, interval }: &Estimate| [value, interval.lo, interval.hi];
        Self {
            verdict: outcome.verdict,
            effects: outcome.effects.iter().map(|e| e.name.name().to_owned()).collect(),
            candidates: outcome
                .effects
                .iter()
                .map(|e| e.candidates.iter().map(|kind| kind.name().to_owned()).collect())
                .collect(),
            numbers: outcome
                .effects
                .iter()
                .map(|e| e.params.iter().map(|(name, n)| ((*name).to_owned(), triple(&n.estimate))).collect())
                .collect(),
            p: outcome.detection.p,
            p_after: outcome.detection_after.p,
            gained: triple(&outcome.gap.gained_share),
            closed: outcome.gap.closed.as_ref().map(triple),
            w1_mm: [outcome.gap.before, outcome.gap.after, outcome.gap.floor].map(|side| side.w1_mm),
            unnamed: outcome.unnamed.iter().map(UnnamedFile::of).collect(),
            directions: outcome.directions.iter().map(|d| (d.name.name().to_owned(), d.z)).collect(),
            threshold: outcome.threshold,
            seconds,
            filter: None,
            named: outcome.effects.iter().map(|named| named.effect.clone()).collect(),
        }
    }
}

/// The world that hidden data come from, and that the search takes as nominal.
struct World {
    nominal: Nominal,
    drive: Drive,
    /// The readings that a log has.
    template: Recorded,
}

impl World {
    fn new(
        simulation: &Simulation,
        map: &Arc<ExactRangeMap>,
        options: &SuiteOptions<'_>,
    ) -> Result<Self, GapError> {
        let Simulation { blocks, laser, robot, .. } = simulation;
        let effects = Effects::new(simulation.effects.clone())?;
        let simulator = Simulator::new(Arc::clone(map), *blocks, *laser, effects.clone())?;
        let mut drive = simulate_drive(&simulator, robot, options.seed)?.drive;
        drive.steps.truncate(options.scans);
        let nominal = Nominal::new(Arc::clone(map), *laser, *blocks, robot.odometry_noise, effects)?;
        let template = Recorded::new(&drive, usize::MAX, usize::MAX, |_| true)?;
        Ok(Self { nominal, drive, template })
    }
}

/// Runs what of the suite hasn't been run, and scores all of it.
///
/// # Errors
/// [`BenchError`]; what was done is kept.
pub fn run(options: &SuiteOptions<'_>) -> Result<Score, BenchError> {
    let scenario = Scenario::load(&options.scenario, &Overrides::default())?;
    let Source::Simulation(simulation) = &scenario.source else {
        return Err(BenchError::NotSimulated(options.scenario.clone()));
    };
    let map = Arc::new(ExactRangeMap::new(load_map(&simulation.map)?.geometry));
    options.control.progress.stage("integrating over blocks", 1);
    let world = World::new(simulation, &map, options)?;
    options.control.progress.advance(1);
    let poses: Vec<_> = world.drive.steps.iter().filter_map(|step| step.reference).collect();
    let mut cases = plan(options.size, options.seed, &map, &poses);
    cases.retain(|case| options.groups.is_empty() || options.groups.contains(&case.group));
    cases.retain(|case| options.setups.is_empty() || options.setups.contains(&case.setup));
    if cases.is_empty() {
        return Err(BenchError::NoLogs);
    }
    let suite = Suite::open(options, &world)?;
    if let Some(shards) = &options.shards {
        suite.merge(&cases, shards, options.control.progress)?;
        return suite.score(&cases, options);
    }
    if let Some(shard) = options.shard {
        let count = cases.len() as u32;
        if shard.of > count {
            return Err(BenchError::TooManyShards { shards: shard.of, logs: count });
        }
        let range = shard.range(count);
        cases = cases.drain(range.start as usize..range.end as usize).collect();
    }
    let mut worlds = BTreeMap::from([(Setup::Scenario, world)]);
    for &setup in Setup::OTHERS.iter().filter(|setup| cases.iter().any(|case| case.setup == **setup)) {
        worlds.insert(setup, World::new(&setup.of(simulation)?, &map, options)?);
    }
    let mut strengths = BTreeMap::new();
    for case in &cases {
        if let Entry::Vacant(entry) = strengths.entry((case.setup, case.regime)) {
            let World { nominal, template, .. } = &worlds[&case.setup];
            entry.insert(Strength::new(nominal, template, REGIMES[case.regime].1, options.seed)?);
        }
    }
    options.control.progress.stage("hidden effects", cases.len() as u64);
    // Logs side by side, each on one thread: nothing waits for anything.
    let next = AtomicUsize::new(0);
    let work = || -> Result<(), BenchError> {
        let pool = ThreadPoolBuilder::new().num_threads(1).build()?;
        while let Some(case) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
            if options.control.is_interrupted() {
                return Err(GapError::Interrupted.into());
            }
            if suite.done(case, options.control.progress)?.is_none() {
                if options.no_later.is_some_and(|end| (options.control.clock)() > end) {
                    break;
                }
                let log = suite.logs.path().join(format!("{}.mcap", case.id));
                let world = &worlds[&case.setup];
                let strength = &strengths[&(case.setup, case.regime)];
                let truth = pool.install(|| hide(world, strength, case, &log))?;
                let mut finding = pool.install(|| search(&world.nominal, &log, case, options))?;
                if let Hidden::Given(effect) = &case.hidden {
                    finding.filter = Some(pool.install(|| localize(&log, effect, &finding, options))?);
                }
                // The finding last: with it, the case is done.
                suite.save(&truth_file(case), &truth)?;
                suite.save(&found_file(case), &finding)?;
                // It can be made again from its seed.
                let _ = std::fs::remove_file(&log);
            }
            options.control.progress.advance(1);
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..rayon::current_num_threads()).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|worker| match worker.join() {
            Ok(done) => done,
            Err(panic) => std::panic::resume_unwind(panic),
        })
    })?;
    options.control.progress.finish();
    suite.score(&cases, options)
}

/// Of the suite's files; those of another one are of no use.
const FORMAT: u32 = 9;

/// What the suite's folders are of, in their manifests.
const KIND: &str = "gap-bench";

/// Name of the report in the suite's folder.
pub const REPORT: &str = "report.md";

/// Name of the figures there.
const SCORE: &str = "score.json";

/// The suite's folder. Truths and findings in it count only if they are as they were written.
struct Suite {
    folder: Folder,
    /// Hash of all that its files depend on.
    fingerprint: String,
    /// Logs, as long as they are searched.
    logs: TempDir,
    /// Held, so that no other process works in the folder.
    _lock: Lock,
}

impl Suite {
    fn open(options: &SuiteOptions<'_>, world: &World) -> Result<Self, BenchError> {
        let scenario = Scenario::load(&options.scenario, &Overrides::default())?.content_hash()?;
        let settings = serde_json::json!({
            "format": FORMAT, "scenario": scenario, "size": options.size, "seed": options.seed,
            "replicates": options.replicates, "groups": options.groups, "setups": options.setups,
            "scans": world.drive.steps.len(), "beams": world.drive.laser.beam_count(),
        });
        let fingerprint = blake3::hash(settings.to_string().as_bytes()).to_hex().to_string();
        // Looked at before it is locked: a lock is a file, and a stranger's folder gets none.
        let open = || Folder::go_on(&options.out, KIND, &fingerprint);
        open()?;
        let lock = Lock::take(&options.out.join("lock"), &options.out)?;
        let folder = open()?;
        for name in [REPORT, SCORE] {
            folder.check(name)?;
        }
        let logs = tempfile::tempdir().map_err(BenchError::Temporary)?;
        Ok(Self { folder, fingerprint, logs, _lock: lock })
    }

    /// Truth and finding of a case, if both are there.
    fn done(
        &self,
        case: &Case,
        progress: &dyn Progress,
    ) -> Result<Option<(TruthFile, FoundFile)>, BenchError> {
        let read = |name: &str| self.folder.read(name);
        let (truth, found) = (read(&truth_file(case))?, read(&found_file(case))?);
        let both = truth.zip(found).and_then(|(truth, found)| {
            Some((serde_json::from_slice(&truth).ok()?, serde_json::from_slice(&found).ok()?))
        });
        if both.is_none() && self.folder.path().join(found_file(case)).exists() {
            progress.warn(&format!("{} was done, but its files are damaged; it is done again", case.id));
        }
        Ok(both)
    }

    /// Scores what is done, and writes the report.
    fn score(&self, cases: &[Case], options: &SuiteOptions<'_>) -> Result<Score, BenchError> {
        let scored = cases.iter().filter_map(|case| self.done(case, options.control.progress).transpose());
        let score =
            Score::new(scored.collect::<Result<_, _>>()?, cases.len(), options.replicates, options.seed);
        self.folder.write(REPORT, text::report(&score).as_bytes())?;
        self.folder.write(SCORE, serde_json::to_string_pretty(&score)?.as_bytes())?;
        Ok(score)
    }

    /// Takes over what the shards in a folder hold.
    fn merge(&self, cases: &[Case], folder: &Path, progress: &dyn Progress) -> Result<(), BenchError> {
        let at = |source| BenchError::System { path: folder.to_owned(), source };
        let mut shards = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(at)? {
            let path = entry.map_err(at)?.path();
            if let Some(shard) = path.file_name().and_then(|name| Shard::of_folder(name.to_str()?)) {
                shards.push((shard, Folder::go_on(&path, KIND, &self.fingerprint)?));
            }
        }
        shards.sort_by_key(|(shard, _)| *shard);
        let mut missing = Vec::new();
        for (number, case) in (0..).zip(cases) {
            if self.done(case, progress)?.is_some() {
                continue;
            }
            let names = [truth_file(case), found_file(case)];
            let read = |(_, folder): &(Shard, Folder)| {
                names.iter().map(|name| folder.read(name)).collect::<Result<Option<Vec<_>>, _>>().transpose()
            };
            match shards.iter().find_map(read).transpose()? {
                Some(files) => {
                    for (name, file) in names.iter().zip(files) {
                        self.folder.write(name, &file)?;
                    }
                }
                None => missing.push(number),
            }
        }
        if missing.is_empty() {
            return Ok(());
        }
        let count = cases.len() as u32;
        let of = shards.first().map_or(1, |(shard, _)| shard.of);
        let is_asked = |shard: &Shard| missing.iter().any(|log| shard.range(count).contains(log));
        let asked = (1..=of).map(|number| Shard { of, number }).filter(is_asked);
        let again = asked.map(|shard| format!("{}/{of}", shard.number)).collect::<Vec<_>>().join(", ");
        Err(BenchError::MissingLogs {
            folder: folder.to_owned(),
            missing: missing.len(),
            of: cases.len(),
            again,
        })
    }

    fn save(&self, name: &str, value: &impl Serialize) -> Result<(), BenchError> {
        Ok(self.folder.write(name, serde_json::to_string_pretty(value)?.as_bytes())?)
    }
}

fn truth_file(case: &Case) -> String {
    format!("truth/{}.json", case.id)
}

fn found_file(case: &Case) -> String {
    format!("found/{}.json", case.id)
}

/// Makes a log with something hidden in it.
fn hide(world: &World, strength_of: &Strength<'_>, case: &Case, log: &Path) -> Result<TruthFile, BenchError> {
    let World { nominal, drive, .. } = world;
    let regime = REGIMES[case.regime].1;
    let path = drive.reference().map_err(RecordedError::from)?;
    let strong = |effect: &Effect, index: usize, form: Option<OtherForm>| {
        // A course goes about the library's formula, whose strength it has: a formula that fits it badly gains little at any strength.
        let form = form.filter(|form| !matches!(form, OtherForm::Course(..)));
        let other = form.map(|form| form.of_logs(nominal));
        let other = other.as_ref().map(|other| other as &locsim_gap::OtherForm<'_>);
        strength_of.with_information(effect, index, other, case.lambda)
    };
    let mut strength = Vec::new();
    let (effects, recorded) = match &case.hidden {
        Hidden::Library(list) => {
            let mut effects = Vec::new();
            for (effect, index) in list {
                effects.push(strong(effect, *index, None)?);
                strength.push(effect.kind.parameters()[*index].name.to_owned());
            }
            let recorded = record_library(nominal, &path, &effects, regime, case.seed)?;
            (effects, recorded)
        }
        Hidden::Given(effect) => {
            let recorded = record_library(nominal, &path, std::slice::from_ref(effect), regime, case.seed)?;
            (vec![effect.clone()], recorded)
        }
        Hidden::Other(form, effect, index) => {
            let effect = strong(effect, *index, Some(*form))?;
            strength.push(effect.kind.parameters()[*index].name.to_owned());
            let recorded =
                record_other(nominal, &path, *form, &effect.values, &effect.place, regime, case.seed)?;
            (vec![effect], recorded)
        }
        Hidden::Outside(kind, amount) => {
            let recorded = record_outside(nominal, &path, *kind, *amount, regime, case.seed)?;
            (Vec::new(), recorded)
        }
    };
    let mut names: Vec<String> = effects.iter().map(|effect| effect.kind.name().to_owned()).collect();
    if let Hidden::Outside(kind, _) = &case.hidden {
        names.push(kind.name().to_owned());
    }
    let numbers = |effect: &Effect| {
        let parameters = effect.kind.parameters().iter().zip(&effect.values);
        parameters.map(|(parameter, value)| (parameter.name.to_owned(), *value)).collect()
    };
    let least_error = match &case.hidden {
        Hidden::Library(list) if case.group == Group::Same => {
            strength_of.least_error(&effects[0], list[0].1, case.lambda)?
        }
        _ => None,
    };
    let file = TruthFile {
        group: case.group,
        setup: case.setup,
        lambda: case.lambda,
        regime: REGIMES[case.regime].0.to_owned(),
        effects: names,
        values: effects.iter().map(numbers).collect(),
        strength,
        least_error,
        without: case.without.iter().map(|kind| kind.name().to_owned()).collect(),
        covariates: match &case.hidden {
            Hidden::Outside(kind, _) => kind.covariates().iter().map(key).collect(),
            _ => Vec::new(),
        },
    };
    write_log(log, &recorded)?;
    Ok(file)
}

/// Reads a log and searches it; of the case it is told which stages the library lacks, and nothing else.
fn search(
    nominal: &Nominal,
    log: &Path,
    case: &Case,
    options: &SuiteOptions<'_>,
) -> Result<FoundFile, BenchError> {
    let (drive, _) = read_log(log, &LogOptions::default())?;
    let recorded = Recorded::new(&drive, usize::MAX, usize::MAX, |_| true)?;
    let settings = GapOptions {
        replicates: options.replicates,
        without: case.without.clone(),
        seed: Draw::new(case.seed, Stage::Trial, plan::SEARCH).seed(0),
        ..GapOptions::default()
    };
    let began = (options.control.clock)();
    let outcome = find(nominal, &recorded, &settings, &(), options.control.interrupted)?;
    Ok(FoundFile::of(&outcome, options.control.seconds_since(began)))
}

/// The influence of the effect on a filter, and the part of it that the named effects remove.
fn localize(
    log: &Path,
    truth: &Effect,
    finding: &FoundFile,
    options: &SuiteOptions<'_>,
) -> Result<FilterFile, BenchError> {
    let settings = GapSettings {
        replicates: options.replicates,
        seed: None,
        scans: options.scans,
        beams: usize::MAX,
        without: Vec::new(),
        log: LogOptions::default(),
        baseline: None,
    };
    let study = GapStudy::load(&options.scenario, Some(log), settings)?;
    let filter = FilterOnLog::new(&study, None, Control { progress: &(), ..options.control })?;
    let mean = |effects: Vec<Effect>| -> Result<f64, BenchError> {
        let errors = filter.errors(effects)?;
        Ok(errors.iter().sum::<f64>() / errors.len() as f64)
    };
    Ok(FilterFile {
        before_m: mean(Vec::new())?,
        after_m: mean(finding.named.clone())?,
        with_truth_m: mean(vec![truth.clone()])?,
    })
}

/// Names of the whole library, for the confusion matrix.
fn library() -> Vec<&'static str> {
    EffectKind::ALL.iter().map(|kind| kind.name()).collect()
}
