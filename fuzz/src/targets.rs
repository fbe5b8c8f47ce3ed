//! The readers, each behind a function of bytes.

#![allow(
    clippy::missing_panics_doc,
    reason = "only a temporary folder that can't be written makes a target panic"
)]

use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use locsim_bench::speed::Workload;
use locsim_core::{Control, Draw, Hits, Particles, Pose2, Progress, RangeMap, SensorModel, Stage};
use locsim_dataset::{LogOptions, read_log, read_tum};
use locsim_lab::convert::convert_map;
use locsim_lab::run::{self, LogMaps, RunOptions};
use locsim_scenario::{Overrides, Scenario, load_map};
use locsim_sensor::{FittedModel, ModelKind};
use locsim_study::{self as study, Study, StudyOverrides};
use locsim_world::raycast::{DistanceGrid, ExactRangeMap, RangeTable, RangeTableOptions};
use tempfile::TempDir;

use crate::Outcome;

/// Files that inputs name, as they are beside them.
const FILES: [(&str, &[u8]); 13] = [
    ("room.yaml", ROOM),
    ("grid.yaml", GRID),
    ("corridor.yaml", include_bytes!("../../maps/corridor.yaml")),
    ("l_corridor.yaml", include_bytes!("../../maps/l_corridor.yaml")),
    ("office.yaml", include_bytes!("../../maps/office.yaml")),
    ("wooden_room.yaml", include_bytes!("../../maps/wooden_room.yaml")),
    ("grid.pgm", include_bytes!("../files/grid.pgm")),
    ("drive.log", include_bytes!("../files/drive.log")),
    ("drive.mcap", include_bytes!("../files/drive.mcap")),
    ("fitted.model", include_bytes!("../files/fitted.model")),
    ("readings.csv", include_bytes!("../files/readings.csv")),
    ("ultrasonic.csv", include_bytes!("../../scenarios/paper/ultrasonic.csv")),
    ("scans.csv", include_bytes!("../files/scans.csv")),
];

const ROOM: &[u8] = include_bytes!("../files/room.yaml");
const RESUMED: &[u8] = include_bytes!("../files/resumed.yaml");
const GRID: &[u8] = include_bytes!("../files/grid.yaml");

/// A folder of this process that holds [`FILES`].
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::Builder::new().prefix("locsim-fuzz-").tempdir().expect("a temporary folder");
    for (name, content) in FILES {
        fs::write(folder.path().join(name), content).expect("a file in it");
    }
    folder
});

/// Writes an input under a name into the folder.
fn written(name: &str, data: &[u8]) -> PathBuf {
    let path = FOLDER.path().join(name);
    fs::write(&path, data).expect("a file in the temporary folder");
    path
}

fn refused(error: impl Display) -> String {
    error.to_string()
}

/// A scenario.
///
/// # Errors
/// Why it is refused.
pub fn yaml(data: &[u8]) -> Outcome {
    let path = written("input.yaml", data);
    // As `validate` does, which tells the two kinds of files apart.
    study::is_study(&path).map_err(refused)?;
    let scenario = Scenario::load(&path, &Overrides::default()).map_err(refused)?;
    scenario.content_hash().map(drop).map_err(refused)
}

/// A study.
///
/// # Errors
/// Why it is refused.
pub fn study(data: &[u8]) -> Outcome {
    let path = written("input.yaml", data);
    Study::load(&path, StudyOverrides::default()).map(drop).map_err(refused)
}

/// A vector map.
///
/// # Errors
/// Why it is refused.
pub fn vector_map(data: &[u8]) -> Outcome {
    use_map(&written("input.yaml", data))
}

/// The image of an occupancy grid map.
///
/// # Errors
/// Why it is refused.
pub fn map_image(data: &[u8]) -> Outcome {
    let mut data = data.to_vec();
    make_png_sums_right(&mut data);
    // The format is told by the content, not by the name.
    written("image.pgm", &data);
    use_map(&written("image.yaml", &edited(GRID, "grid.pgm", "image.pgm")))
}

/// Makes the check sums of a PNG's chunks right, so that what is in them is looked at.
fn make_png_sums_right(data: &mut [u8]) {
    let signature = b"\x89PNG\r\n\x1a\n";
    if !data.starts_with(signature) {
        return;
    }
    let mut rest = &mut data[signature.len()..];
    while let Some((length, after)) = rest.split_first_chunk_mut::<4>() {
        // Its kind and its content.
        let length = 4 + u32::from_be_bytes(*length) as usize;
        let Some((chunk, after)) = after.split_at_mut_checked(length) else { return };
        let Some((sum, after)) = after.split_first_chunk_mut() else { return };
        *sum = crc32fast::hash(chunk).to_be_bytes();
        rest = after;
    }
}

fn edited(text: &[u8], from: &str, to: &str) -> Vec<u8> {
    String::from_utf8_lossy(text).replace(from, to).into_bytes()
}

/// Loads a map, casts rays into it and measures distances in it.
fn use_map(path: &Path) -> Outcome {
    let map = ExactRangeMap::new(load_map(path).map_err(refused)?.geometry);
    let [x0, y0, x1, y1] = map.bounds();
    let poses: Particles = [[0.5, 0.5], [0.3, 0.6], [0.0, 0.0], [2.0, -1.0]]
        .into_iter()
        .enumerate()
        .map(|(i, [x, y])| Pose2::new(x0 + x * (x1 - x0), y0 + y * (y1 - y0), i as f64))
        .collect();
    cast(&map, &poses);
    DistanceGrid::new(map.geometry(), 0.05, 2.0).map(drop).map_err(refused)
}

fn cast(map: &dyn RangeMap, poses: &Particles) {
    const MAX_RANGE_M: f32 = 8.0;
    let mut hits = Hits::default();
    map.cast(poses.as_poses(), &[-3.0, -1.5, 0.0, 0.7, 1.5], MAX_RANGE_M, &mut hits);
    assert!(hits.range.iter().all(|range| (0.0..=MAX_RANGE_M).contains(range)), "{:?}", hits.range);
}

/// A CARMEN log, plain or compressed.
///
/// # Errors
/// Why it is refused.
pub fn carmen(data: &[u8]) -> Outcome {
    use_log(&written("input.log", data))
}

/// A map of BeeSoft, plain or compressed.
///
/// # Errors
/// Why it is refused.
pub fn beesoft_map(data: &[u8]) -> Outcome {
    convert_map(&written("input.dat", data)).map(drop).map_err(refused)
}

/// A ROS 2 bag in an MCAP file.
///
/// # Errors
/// Why it is refused.
pub fn mcap(data: &[u8]) -> Outcome {
    let mut data = data.to_vec();
    take_out_bag_sums(&mut data);
    use_log(&written("input.mcap", &data))
}

/// Sets the check sums of a bag's chunks and of its data to 0, which is none, so that what is in them is looked at.
fn take_out_bag_sums(data: &mut [u8]) {
    const MAGIC: usize = 8;
    let Some((_, mut rest)) = data.split_at_mut_checked(MAGIC) else { return };
    while let Some(([kind, length @ ..], after)) = rest.split_first_chunk_mut::<9>() {
        let length = u64::from_le_bytes(*length) as usize;
        let Some((record, after)) = after.split_at_mut_checked(length) else { return };
        let sum = match kind {
            // A chunk: two times and a size stand before it.
            6 => record.get_mut(24..28),
            // The end of the data.
            15 => record.get_mut(..4),
            _ => None,
        };
        if let Some(sum) = sum {
            sum.fill(0);
        }
        rest = after;
    }
}

/// A ROS 2 bag in a file of `SQLite`.
///
/// # Errors
/// Why it is refused.
pub fn db3(data: &[u8]) -> Outcome {
    use_log(&written("input.db3", data))
}

/// Reads a log and, as `map` does, makes maps of it.
fn use_log(path: &Path) -> Outcome {
    let (_, summary) = read_log(path, &LogOptions::default()).map_err(refused)?;
    drop(summary.to_string());
    // A log without reference poses is a log, if no map.
    drop(LogMaps::from_log(path, &[[0.0, 1.0]], 0.05, &LogOptions::default()));
    Ok(())
}

/// A trajectory.
///
/// # Errors
/// Why it is refused.
pub fn tum(data: &[u8]) -> Outcome {
    read_tum(&written("input.tum", data)).map(drop).map_err(refused)
}

/// Bytes of a model file before its hash, and of the hash.
const MODEL_HEADER: usize = 12;
const HASH: usize = blake3::OUT_LEN;

/// A fitted sensor model. Its hash is made right, so that what is behind it is looked at.
///
/// # Errors
/// Why it is refused.
///
/// # Panics
/// A model that was accepted gives what is no density.
pub fn model(data: &[u8]) -> Outcome {
    let mut data = data.to_vec();
    if let Some((_, rest)) = data.split_at_mut_checked(MODEL_HEADER)
        && let Some((hash, body)) = rest.split_at_mut_checked(HASH)
    {
        hash.copy_from_slice(blake3::hash(body).as_bytes());
    }
    let fitted = FittedModel::load(&written("input.model", &data)).map_err(refused)?;
    let max_range = fitted.max_range();
    let map = ExactRangeMap::new(load_map(&written("room.yaml", ROOM)).map_err(refused)?.geometry);
    let distances = DistanceGrid::new(map.geometry(), 0.05, 2.0).map_err(refused)?;
    let model = fitted.into_model(Some(Arc::new(distances))).map_err(refused)?;
    use_model(&*model, max_range);
    Ok(())
}

/// Asks a model for densities, cumulative probabilities and draws.
fn use_model(model: &dyn SensorModel, max_range: f32) {
    let share = |share: f32| share * max_range;
    let bearings = [-1.0, 0.0, 1.0, 2.0, 3.0];
    let poses: Particles = [Pose2::new(1.0, 1.0, 0.0), Pose2::new(1e3, -1e3, 2.0)].into_iter().collect();
    let hits = Hits {
        range: [0.0, 0.2, 0.5, 0.9, 1.0, 0.01, 0.3, 0.7, 0.999, 1.0].map(share).to_vec(),
        incidence: vec![0.0, 0.1, 0.5, 1.0, 0.0, 1.57, 0.8, 0.3, 1.2, 0.0],
        surface: vec![0; 10],
    };
    let beams = hits.beams(poses.as_poses(), &bearings, max_range);
    let mut out = vec![0.0; beams.len()];
    let mut below = vec![0.0; beams.len()];
    for z in [0.0, 1e-6, 0.1, 0.3, 0.5, 0.9, 0.999_999, 1.0].map(share) {
        let scan = [z; 5];
        model.log_density(&scan, &beams, &mut out);
        assert!(out.iter().all(|l| !l.is_nan() && *l != f32::INFINITY), "log density at {z} m: {out:?}");
        model.cdf(&scan, &beams, &mut out);
        let in_order = out.iter().zip(&below).all(|(p, below)| (below - 1e-5..=1.0 + 1e-5).contains(p));
        assert!(in_order, "P(Z <= {z} m): {out:?} after {below:?}");
        below.copy_from_slice(&out);
    }
    model.log_density(&[f32::NAN; 5], &beams, &mut out);
    assert!(out.iter().all(|l| *l == 0.0), "log density of no reading: {out:?}");
    model.sample(&beams, &Draw::new(1, Stage::Sensor, 0), &mut out);
    assert!(out.iter().all(|z| (0.0..=max_range).contains(z)), "draws: {out:?}");
}

/// Stops a run after its first trial: before the report, which costs most and reads nothing.
#[derive(Default)]
struct FirstTrial {
    begun: AtomicBool,
    done: AtomicBool,
}

impl Progress for FirstTrial {
    fn stage(&self, name: &str, _total: u64) {
        self.begun.store(name == "trials", Ordering::Relaxed);
    }

    fn advance(&self, _n: u64) {
        self.done.fetch_or(self.begun.load(Ordering::Relaxed), Ordering::Relaxed);
    }
}

/// Runs a scenario until its first trial is kept.
fn run_first_trial(scenario: &Scenario, out: PathBuf, resume: bool) -> Outcome {
    let first = FirstTrial::default();
    let options = RunOptions { resume, force: !resume, ..options(out, &first) };
    run::run(scenario, &options).map(drop).map_err(refused)
}

fn options(out: PathBuf, progress: &FirstTrial) -> RunOptions<'_> {
    RunOptions {
        out,
        resume: false,
        force: true,
        command: String::new(),
        control: Control { clock: &|| Duration::ZERO, progress, interrupted: &progress.done },
        cache: None,
        recorder: None,
    }
}

/// What an interrupted run kept. The first byte of an input says which file the rest is: `0` a finished trial, whose hash
/// is made right, `1` the same as it is, `2` the manifest of the work, `3` that of earlier results.
///
/// # Errors
/// Why the run can't go on; stopped again after one trial, it is accepted.
pub fn resume(data: &[u8]) -> Outcome {
    static KEPT: LazyLock<(Scenario, Vec<u8>, Vec<u8>)> = LazyLock::new(|| {
        let scenario = written("resumed.yaml", RESUMED);
        let scenario = Scenario::load(&scenario, &Overrides::default()).expect("a scenario");
        let out = FOLDER.path().join("resumed");
        run_first_trial(&scenario, out.clone(), false).expect_err("an interruption");
        let read = |name: &str| fs::read(out.with_extension("partial").join(name)).expect("what is kept");
        (scenario, read("manifest.json"), read("parts/000000.part"))
    });
    let (scenario, manifest, part) = &*KEPT;
    let out = FOLDER.path().join("resumed");
    let partial = out.with_extension("partial");
    drop(fs::remove_dir_all(&out));
    drop(fs::remove_dir_all(&partial));
    fs::create_dir_all(partial.join("parts")).expect("a folder in the temporary folder");
    let write =
        |path: PathBuf, content: &[u8]| fs::write(path, content).expect("a file in the temporary folder");
    write(partial.join("manifest.json"), manifest);
    let (&which, data) = data.split_first().unwrap_or((&b'0', &[]));
    let mut part = part.clone();
    match which {
        b'0' => {
            let fingerprint = scenario.content_hash().map_err(refused)?;
            let content = data.get(HASH..).unwrap_or_default();
            let mut hasher = blake3::Hasher::new();
            hasher.update(&(fingerprint.len() as u64).to_le_bytes()).update(fingerprint.as_bytes());
            hasher.update(&0_u32.to_le_bytes()).update(content);
            part = [hasher.finalize().as_bytes().as_slice(), content].concat();
        }
        b'2' => write(partial.join("manifest.json"), data),
        b'3' => {
            fs::create_dir_all(&out).expect("a folder in the temporary folder");
            write(out.join("manifest.json"), data);
        }
        _ => part = data.to_vec(),
    }
    write(partial.join("parts/000000.part"), &part);
    match run_first_trial(scenario, out, true) {
        Err(message) if message.starts_with("interrupted after ") => Ok(()),
        other => other,
    }
}

/// Files of a benchmark's folder; the first byte of an input says which file the rest is.
const WORK: [(&str, &[u8]); 7] = [
    ("workload.json", include_bytes!("../files/work/workload.json")),
    ("scan.csv", include_bytes!("../files/work/scan.csv")),
    ("particles_f64le.bin", include_bytes!("../files/work/particles_f64le.bin")),
    ("traj_static.csv", include_bytes!("../files/work/traj_static.csv")),
    ("traj_dynamic.csv", include_bytes!("../files/work/traj_dynamic.csv")),
    ("map.yaml", include_bytes!("../files/work/map.yaml")),
    ("map.pgm", include_bytes!("../files/work/map.pgm")),
];

/// The folder of a benchmark's fixed work.
///
/// # Errors
/// Why it is refused.
pub fn workload(data: &[u8]) -> Outcome {
    let folder = FOLDER.path().join("work");
    fs::create_dir_all(&folder).expect("a folder in the temporary folder");
    let (&which, data) = data.split_first().unwrap_or((&b'0', &[]));
    for (i, (name, content)) in WORK.into_iter().enumerate() {
        let chosen = usize::from(which.wrapping_sub(b'0')) % WORK.len() == i;
        fs::write(folder.join(name), if chosen { data } else { content })
            .expect("a file in the temporary folder");
    }
    Workload::read(&folder).map(drop).map_err(refused)
}

/// A study's table of readings, or, behind the byte `1`, of a static lidar's scans.
///
/// # Errors
/// Why it is refused.
pub fn csv(data: &[u8]) -> Outcome {
    let (&which, data) = data.split_first().unwrap_or((&b'0', &[]));
    written("input.csv", data);
    let study: &[u8] = match which {
        b'1' => include_bytes!("../files/lidar.yaml"),
        _ => include_bytes!("../files/table.yaml"),
    };
    let path = written("input-study.yaml", study);
    Study::load(&path, StudyOverrides::default()).map(drop).map_err(refused)
}

/// The file of a range table. Its key and hash are made right, so that what is between them is looked at.
///
/// # Errors
/// The map of the table can't be used, which no input changes.
pub fn range_table(data: &[u8]) -> Outcome {
    const MAGIC_AND_KEY: usize = 24 + HASH;
    static KEPT: LazyLock<(ExactRangeMap, PathBuf, Vec<u8>)> = LazyLock::new(|| {
        let (map, file) = kept_table();
        let head = fs::read(&file).expect("a file")[..MAGIC_AND_KEY].to_vec();
        (map, file, head)
    });
    let (map, file, head) = &*KEPT;
    let body = data.get(head.len()..data.len().saturating_sub(HASH)).unwrap_or_default();
    let mut content = [head.as_slice(), body].concat();
    content.extend(blake3::hash(&content).as_bytes());
    fs::write(file, content).expect("a file in the temporary folder");
    let table = RangeTable::cached(map, &TABLE, file.parent(), &|_| ()).map_err(refused)?;
    let poses: Particles = (0..60)
        .map(|i| Pose2::new(0.06 * f64::from(i), 0.05 + 0.03 * f64::from(i), 0.3 * f64::from(i)))
        .collect();
    cast(&table, &poses);
    Ok(())
}

/// A table small enough for a seed.
const TABLE: RangeTableOptions = RangeTableOptions { cell_m: 0.8, most_bytes: 1 << 20, tolerance_m: 0.01 };

/// A map and the file that its range table is kept in.
fn kept_table() -> (ExactRangeMap, PathBuf) {
    let map = ExactRangeMap::new(load_map(&written("room.yaml", ROOM)).expect("a map").geometry);
    let folder = FOLDER.path().join("tables");
    RangeTable::cached(&map, &TABLE, Some(&folder), &|_| ()).expect("a table");
    let mut files = fs::read_dir(&folder).expect("a folder").map(|entry| entry.expect("a file").path());
    (map, files.next().expect("a file"))
}

/// Seeds in formats of the program's own, by target and name: to be made anew when a format changes.
///
/// # Panics
/// A run of the program fails.
pub fn seeds() -> Vec<(&'static str, String, Vec<u8>)> {
    let read = |path: &Path| fs::read(path).expect("a file");
    let scenario = |edit: &dyn Fn(String) -> String| {
        let text = edit(String::from_utf8_lossy(RESUMED).into_owned());
        Scenario::load(&written("resumed.yaml", text.as_bytes()), &Overrides::default()).expect("a scenario")
    };
    let mut seeds = vec![("range_table", "table.bin".to_owned(), read(&kept_table().1))];
    let out = FOLDER.path().join("models");
    let models = ModelKind::NAMES;
    let progress = FirstTrial::default();
    let all = scenario(&|text| text.replace("[classic]", &format!("{models:?}")));
    let control =
        Control { clock: &|| Duration::ZERO, progress: &progress, interrupted: &AtomicBool::new(false) };
    run::run(&all, &RunOptions { control, ..options(out.clone(), &progress) }).expect("a run");
    for name in models {
        let file = out.join("models").join(format!("{name}.model"));
        seeds.push(("model", format!("{name}.model"), read(&file)));
    }
    let out = FOLDER.path().join("resumed");
    run_first_trial(&scenario(&|text| text), out.clone(), false).expect_err("an interruption");
    let partial = out.with_extension("partial");
    let mut kept = |which: u8, name: &str, file: &Path| {
        seeds.push(("resume", name.to_owned(), [&[which], read(file).as_slice()].concat()));
    };
    kept(b'0', "trial.part", &partial.join("parts/000000.part"));
    kept(b'2', "work.json", &partial.join("manifest.json"));
    seeds
}
