//! Measured logs with known edits, held against the unedited other half of the same log: how often `locsim gap --baseline` names
//! what was edited, and how often it names something where nothing was.
//!
//! Findings are kept with their hash, and a run that was interrupted goes on where it stopped.

mod edits;
mod score;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use locsim_baseline::{BaselineOptions, ChangeVerdict, Changes, find_changes};
use locsim_core::{Control, Draw, Drive, Pose2, Stage};
use locsim_dataset::{LogOptions, read_log};
use locsim_gap::{GapError, Nominal, Recorded, Views};
use locsim_mapping::{MappingOptions, walls_from_drive};
use locsim_report::store::{Folder, Lock};
use locsim_world::effect::Effects;
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::{LaserOptions, OdometryNoise};
use serde::{Deserialize, Serialize};

pub use edits::{EDITS, Edit, Truth};
use edits::{RobotPath, THINNED};
pub use score::{RealScore, table};

use crate::BenchError;

/// How measured logs are edited and searched.
pub struct RealOptions<'a> {
    /// Folder of corrected CARMEN logs.
    pub logs: PathBuf,
    /// Where findings go.
    pub out: PathBuf,
    /// Everything random derives from it.
    pub seed: u64,
    /// Permutations behind a p-value.
    pub permutations: u32,
    /// The most scans of a half, spread evenly over it.
    pub scans: usize,
    /// Range from which a reading is no return \[m\].
    pub max_range_m: f64,
    /// The caller's clock and progress; an interruption stops the search at hand.
    pub control: Control<'a>,
    /// No search is begun later than this; what is done is scored, and the next run goes on.
    pub no_later: Option<Duration>,
}

/// How a log is cut in two.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cut {
    /// The first half is the baseline.
    Halves,
    /// The second half is the baseline.
    HalvesSwapped,
    /// Stretches of 40 scans in turns, as two passes at one time.
    Turns,
    /// The same, the other way around.
    TurnsSwapped,
}

/// All cuts. Edits are made with the first; the others tell false alarms as well.
const CUTS: [Cut; 4] = [Cut::Halves, Cut::HalvesSwapped, Cut::Turns, Cut::TurnsSwapped];
/// Scans of a turn.
const TURN_SCANS: usize = 40;
/// Beams of a scan that are looked at, as `locsim gap` does.
const BEAMS: usize = 72;
/// A plain laser's noise \[m\], its readings' step \[m\], and the noise of a plain odometry: what is learnt from the baseline
/// corrects them.
const SIGMA_M: f64 = 0.02;
const STEP_M: f64 = 0.01;
/// Scans per second where a log's clock stands still.
const RATE_HZ: f64 = 1.0;
const ODOMETRY: [f64; 4] = [0.02, 0.01, 0.02, 0.01];

/// A search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// The log's name.
    pub log: String,
    /// How it is cut.
    pub cut: Cut,
    /// The edit of the half that isn't the baseline.
    pub edit: Edit,
}

/// The findings of a search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// The edit; `None` where the log had no room for the edit.
    pub truth: Option<Truth>,
    /// The verdict.
    pub verdict: String,
    /// Names, in order; `losses_by_bearing` where returns are lost at some bearings.
    pub effects: Vec<String>,
    /// Value and 95 % interval of the number that was edited, where the edit is named first.
    pub strength: Option<[f64; 3]>,
    /// p-value.
    pub p: f64,
    /// Share of readings at places of the baseline.
    pub shared: f64,
    /// Wasserstein-1 distance before, after, and of permutations \[mm\].
    pub w1_mm: [f64; 3],
    /// Time \[s\].
    pub seconds: f64,
}

impl Found {
    fn of(truth: Truth, changes: &Changes, seconds: f64) -> Self {
        let first = changes.effects.first();
        let names = changes.effects.iter().map(|named| named.name.name().to_owned());
        let window = changes.losses_by_bearing.is_some().then(|| "losses_by_bearing".to_owned());
        let noise = changes.noise_of_every_beam_m.is_some().then(|| "noise_of_every_beam".to_owned());
        let strength = truth.strength.as_ref().and_then(|(parameter, _)| {
            let named = first.filter(|named| Some(named.name.name()) == truth.effect.as_deref())?;
            let estimate = named.params.get(parameter.as_str())?.estimate;
            Some([estimate.value, estimate.interval.lo, estimate.interval.hi])
        });
        Self {
            strength,
            truth: Some(truth),
            verdict: verdict(changes.verdict).to_owned(),
            effects: names.chain(window).chain(noise).collect(),
            p: changes.p,
            shared: changes.shared,
            w1_mm: changes.w1_mm,
            seconds,
        }
    }

    /// Where an edit has no room.
    fn nothing() -> Self {
        Self {
            truth: None,
            verdict: String::new(),
            effects: Vec::new(),
            strength: None,
            p: 1.0,
            shared: 0.0,
            w1_mm: [0.0; 3],
            seconds: 0.0,
        }
    }
}

fn verdict(verdict: ChangeVerdict) -> &'static str {
    match verdict {
        ChangeVerdict::None => "none",
        ChangeVerdict::Changed => "changed",
        ChangeVerdict::Unexplained => "unexplained",
        ChangeVerdict::Underpowered => "underpowered",
    }
}

/// Of the findings' files; those of another one are of no use.
const FORMAT: u32 = 1;
/// Name of the report in the folder, and of the figures.
pub const REPORT: &str = "report.md";
const SCORE: &str = "score.json";

/// Searches what hasn't been searched, and scores all of it.
///
/// # Errors
/// [`BenchError`]; what was done is kept.
pub fn run(options: &RealOptions<'_>) -> Result<RealScore, BenchError> {
    let logs = logs_in(&options.logs)?;
    let settings = serde_json::json!({
        "format": FORMAT, "seed": options.seed, "permutations": options.permutations, "scans": options.scans,
        "max_range_m": options.max_range_m,
    });
    let fingerprint = blake3::hash(settings.to_string().as_bytes()).to_hex();
    // Looked at before it is locked: a lock is a file, and a stranger's folder gets none.
    let open = || Folder::go_on(&options.out, "gap-bench", &fingerprint);
    open()?;
    let _lock = Lock::take(&options.out.join("lock"), &options.out)?;
    let folder = open()?;
    for name in [REPORT, SCORE] {
        folder.check(name)?;
    }
    let mut done = Vec::new();
    let mut planned = 0;
    'logs: for path in &logs {
        let name = log_name(path);
        let mut cases: Vec<Case> =
            CUTS.into_iter().map(|cut| Case { log: name.clone(), cut, edit: Edit::None }).collect();
        cases.extend(EDITS.into_iter().map(|edit| Case { log: name.clone(), cut: CUTS[0], edit }));
        planned += cases.len();
        options.control.progress.stage(&name, cases.len() as u64);
        let mut log = None;
        for case in cases {
            let found = if let Some(found) = read(&folder, &case)? {
                found
            } else {
                if options.no_later.is_some_and(|end| (options.control.clock)() > end) {
                    continue 'logs;
                }
                if log.is_none() {
                    log = Some(Log::load(path, options)?);
                }
                let Some(log) = &log else { continue };
                let found = search(log, &case, options)?;
                folder.write(&file(&case), serde_json::to_string_pretty(&found)?.as_bytes())?;
                found
            };
            options.control.progress.advance(1);
            done.push((case, found));
        }
    }
    options.control.progress.finish();
    let score = RealScore::new(done, planned, options.seed, options.permutations);
    folder.write(REPORT, score::report(&score).as_bytes())?;
    folder.write(SCORE, serde_json::to_string_pretty(&score)?.as_bytes())?;
    Ok(score)
}

fn file(case: &Case) -> String {
    let word = |value: serde_json::Value| value.as_str().unwrap_or_default().to_owned();
    let [cut, edit] = [serde_json::json!(case.cut), serde_json::json!(case.edit)].map(word);
    format!("found/{}-{cut}-{edit}.json", case.log)
}

fn read(folder: &Folder, case: &Case) -> Result<Option<Found>, BenchError> {
    Ok(folder.read(&file(case))?.and_then(|bytes| serde_json::from_slice(&bytes).ok()))
}

/// The CARMEN logs of a folder, in order.
fn logs_in(folder: &Path) -> Result<Vec<PathBuf>, BenchError> {
    let refuse = |source| BenchError::System { path: folder.to_owned(), source };
    let entries = std::fs::read_dir(folder).map_err(refuse)?;
    let paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>, _>>().map_err(refuse)?;
    let is_log = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.ends_with(".log") || name.ends_with(".log.gz")
    };
    let mut logs: Vec<PathBuf> = paths.into_iter().filter(is_log).collect();
    logs.sort();
    if logs.is_empty() {
        let what = "the folder has no CARMEN log (.log, .log.gz)";
        return Err(refuse(std::io::Error::new(std::io::ErrorKind::NotFound, what)));
    }
    Ok(logs)
}

fn log_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let stem = name.trim_end_matches(".gz").trim_end_matches(".log");
    stem.trim_end_matches("-corrected").to_owned()
}

/// A log with the simulator that it is held against: a plain laser on the map of walls of the whole log.
struct Log {
    drive: Drive,
    path: RobotPath,
    nominal: Nominal,
}

impl Log {
    fn load(path: &Path, options: &RealOptions<'_>) -> Result<Self, BenchError> {
        let read = LogOptions { max_range_m: Some(options.max_range_m as f32), ..LogOptions::default() };
        let (mut drive, _) = read_log(path, &read)?;
        drive.spread_stamps(RATE_HZ.recip());
        let path = RobotPath::new(&drive);
        // Evenly spread: each half is thinned further, and the map takes no more scans than both have.
        let each = drive.steps.len().div_ceil(2 * options.scans).max(1);
        let steps = drive.steps.into_iter().step_by(each).collect();
        let drive = Drive { laser: drive.laser, steps };
        let all: Vec<usize> = (0..drive.steps.len()).collect();
        let geometry = walls_from_drive(&drive, &all, &MappingOptions::default())?.to_geometry()?;
        let bearings = drive.laser.bearings();
        let [first, last] = [bearings[0], bearings[bearings.len() - 1]].map(f64::from);
        let laser = LaserOptions {
            rate_hz: RATE_HZ,
            beams: bearings.len() as u32,
            field_of_view_rad: last - first,
            first_bearing_rad: None,
            min_range_m: 0.0,
            max_range_m: options.max_range_m,
            resolution_m: STEP_M,
            sigma_m: SIGMA_M,
            sigma_per_m: 0.0,
            mount: drive.laser.base_from_laser(),
            scan_secs: 0.0,
        };
        let odometry = OdometryNoise::new(ODOMETRY).map_err(GapError::from)?;
        let map = Arc::new(ExactRangeMap::new(geometry));
        Ok(Self { nominal: Nominal::new(map, laser, None, odometry, Effects::none())?, drive, path })
    }

    /// The baseline, and the part that is edited.
    fn cut(&self, cut: Cut) -> [Drive; 2] {
        let count = self.drive.steps.len();
        let is_second = |i: usize| match cut {
            Cut::Halves | Cut::HalvesSwapped => i >= count / 2,
            Cut::Turns | Cut::TurnsSwapped => (i / TURN_SCANS) % 2 == 1,
        };
        let part = |second: bool| {
            let steps = self.drive.steps.iter().enumerate().filter(|(i, _)| is_second(*i) == second);
            Drive { laser: self.drive.laser.clone(), steps: steps.map(|(_, step)| step.clone()).collect() }
        };
        match cut {
            Cut::Halves | Cut::Turns => [part(false), part(true)],
            Cut::HalvesSwapped | Cut::TurnsSwapped => [part(true), part(false)],
        }
    }
}

fn search(log: &Log, case: &Case, options: &RealOptions<'_>) -> Result<Found, BenchError> {
    let [baseline, mut today] = log.cut(case.cut);
    let unedited = today.clone();
    let mut path = log.path.clone();
    let Some(mut truth) = case.edit.apply(&mut today, &mut path, &baseline, options.seed) else {
        return Ok(Found::nothing());
    };
    let free = |pose: &Pose2| log.nominal.map.geometry().is_free(pose.x, pose.y);
    let [baseline, today, unedited] =
        [baseline, today, unedited].map(|drive| Recorded::new(&drive, options.scans, BEAMS, free));
    let baseline = baseline?.along(log.path.reference.iter().copied());
    let today = today?.along(path.reference);
    if case.edit == Edit::Thinned {
        let lost = lost_of_slanted(&log.nominal, &unedited?, &today)?;
        truth.strength = truth.strength.map(|(parameter, _)| (parameter, lost));
    }
    let search = BaselineOptions {
        permutations: options.permutations,
        seed: Draw::new(options.seed, Stage::Trial, SEARCH).seed(case.edit as u32),
        ..BaselineOptions::default()
    };
    let began = (options.control.clock)();
    let changes = find_changes(&log.nominal, &baseline, &today, &search, &(), options.control.interrupted)?;
    Ok(Found::of(truth, &changes, options.control.seconds_since(began)))
}

/// Share of the returns of slanted walls that an edit loses. The edit knows slants by the readings alone: what it takes for an edge
/// stays. The effect's slants are those of the map.
fn lost_of_slanted(nominal: &Nominal, unedited: &Recorded, edited: &Recorded) -> Result<f64, GapError> {
    let max = nominal.laser.max_range_m as f32;
    let views = Views::new(nominal, unedited, &nominal.effects)?;
    let readings = views.beams.iter().zip(unedited.readings.iter().zip(&edited.readings));
    let (mut slanted, mut lost) = (0.0, 0.0);
    for (beam, (before, after)) in readings {
        if beam.view.incidence > THINNED.1.to_radians() && *before < max {
            slanted += 1.0;
            lost += f64::from(u8::from(*after >= max));
        }
    }
    Ok(lost / f64::max(slanted, 1.0))
}

/// Step of the searches' seeds.
const SEARCH: u32 = 300;
