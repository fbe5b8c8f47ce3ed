//! A split of a log into scans for the map, for training and for the filter, such that the map knows where the others drive.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;

use locsim_core::{Drive, Pose2};
use serde::Serialize;

/// Parts that a drive is cut into.
const PARTS: usize = 20;
/// Parts that a filter localizes on, and that models are trained on: a fifth of the drive each. The map gets the rest.
const LOCALIZED_PARTS: usize = 4;
const TRAINING_PARTS: usize = 4;
/// A drive of fewer scans with references isn't cut.
const LEAST_SCANS: usize = 100;
/// Scans of a part and beams of a scan that are looked at, at the most.
const SCANS: usize = 100;
const BEAMS: usize = 90;
/// Readings beyond this range \[m\] make no map (as in mapping).
const USABLE_RANGE_M: f64 = 30.0;
/// A reading is known to a map that has a reading in its cell of this side \[m\] or in a cell beside it: the distance up to
/// which a filter finds the wall.
const CELL_M: f64 = 0.2;
/// Where less than this share of the readings is known to the map, filters get lost.
pub const COVERED: f64 = 0.5;
/// The localized part covers at least this share of the distance that parts of its length cover on average, or as much as any does: a
/// robot that stands still shows nothing.
const LEAST_MOTION: f64 = 0.8;

/// The use of a part's scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The map is built from them.
    Map,
    /// Sensor models are trained on them.
    Train,
    /// The filter localizes on them.
    Localize,
    /// Some serve for the map, some for training.
    MapAndTrain,
}

/// A part of a drive.
#[derive(Clone, Debug, Serialize)]
pub struct Part {
    /// Its scans, as a share of the log's.
    pub scans: [f64; 2],
    /// Share of its readings that end where other parts have readings, too.
    pub covered_by_others: f64,
    /// Share of its readings that end where the parts of the map have readings; of a part of the map itself, where its
    /// others have.
    pub covered_by_map: f64,
    /// The use of its scans.
    pub role: Role,
}

/// A proposed split of a log.
#[derive(Clone, Debug, Serialize)]
pub struct Split {
    /// Scans that the map is built from, as shares of the log's.
    pub map_scans: Vec<[f64; 2]>,
    /// Scans that models are trained on.
    pub train_scans: Vec<[f64; 2]>,
    /// Scans that the filter localizes on.
    pub localize_scans: [f64; 2],
    /// The least coverage of a localized part by the map.
    pub least_localized: f64,
    /// The least coverage of a training part by the map; `None` where scans for both alternate.
    pub least_trained: Option<f64>,
    /// The parts of the drive.
    pub parts: Vec<Part>,
}

/// A set of parts, a bit each.
type Parts = u32;

impl Split {
    /// Number of scans of the localized part, of a log with this many.
    pub fn localized(&self, scans: usize) -> usize {
        let [from, to] = self.localize_scans;
        ((to - from) * scans as f64).round() as usize
    }

    /// The split whose localized and training parts the map knows best; `None` for a drive with too few reference poses.
    pub fn propose(drive: &Drive) -> Option<Self> {
        let referenced = drive.steps.iter().filter(|step| step.reference.is_some()).count();
        if referenced < LEAST_SCANS {
            return None;
        }
        let coverage = Coverage::of(drive);
        let all = run(0, PARTS);
        let motion: Vec<f64> = (0..PARTS).map(|part| distance(drive, part)).collect();
        let usual = motion.iter().sum::<f64>() * LOCALIZED_PARTS as f64 / PARTS as f64;
        // The whole of the localized part needs references, to be judged by.
        let judged =
            |part: usize| drive.steps[scans(drive, part)].iter().all(|step| step.reference.is_some());
        let judged_motion = |from: usize| {
            let mut parts = from..from + LOCALIZED_PARTS;
            parts.clone().all(judged).then(|| parts.by_ref().map(|part| motion[part]).sum::<f64>())
        };
        let most = (0..=PARTS - LOCALIZED_PARTS).filter_map(judged_motion).fold(0.0, f64::max);
        let least = most.min(LEAST_MOTION * usual);
        let localizable = |&from: &usize| judged_motion(from).is_some_and(|motion| motion >= least);
        let candidates = (0..=PARTS - LOCALIZED_PARTS).filter(localizable).flat_map(|from| {
            let localized = run(from, LOCALIZED_PARTS);
            (0..=PARTS - TRAINING_PARTS)
                .map(move |from| (localized, run(from, TRAINING_PARTS)))
                .filter(|(localized, trained)| localized & trained == 0)
        });
        let scored = candidates.map(|(localized, trained)| {
            let map = all & !localized & !trained;
            let [least_localized, least_trained] =
                [localized, trained].map(|parts| coverage.least(parts, map));
            // A lost filter costs more than a model trained on fewer of its readings.
            (least_localized + 0.5 * least_trained, localized, trained)
        });
        let (_, localized, trained) = scored.reduce(|a, b| if b.0 > a.0 { b } else { a })?;
        let map = all & !localized & !trained;
        let least_trained = coverage.least(trained, map);
        if least_trained < COVERED {
            return Some(Self::interleaved(&coverage, localized));
        }
        let shares = |parts: Parts| intervals((0..PARTS).filter(|part| has(parts, *part)).map(share));
        Some(Self {
            map_scans: shares(map),
            train_scans: shares(trained),
            localize_scans: shares(localized)[0],
            least_localized: coverage.least(localized, map),
            least_trained: Some(least_trained),
            parts: coverage.parts(localized, trained, map),
        })
    }

    /// A split for a drive that seldom comes back: between scans for the map, every second tenth of a part serves training.
    fn interleaved(coverage: &Coverage, localized: Parts) -> Self {
        const PIECES: usize = 10;
        let rest = run(0, PARTS) & !localized;
        let piece = |part: usize, i: usize| {
            let at = |i: usize| (part * PIECES + i) as f64 / (PARTS * PIECES) as f64;
            [at(i), at(i + 1)]
        };
        let pieces = |odd: usize| {
            let of_part =
                move |part| (0..PIECES).filter(move |i| i % 3 / 2 == odd).map(move |i| piece(part, i));
            intervals((0..PARTS).filter(|part| has(rest, *part)).flat_map(of_part))
        };
        let mut parts = coverage.parts(localized, 0, rest);
        for part in parts.iter_mut().filter(|part| part.role == Role::Map) {
            part.role = Role::MapAndTrain;
        }
        Self {
            map_scans: pieces(0),
            train_scans: pieces(1),
            localize_scans: intervals((0..PARTS).filter(|part| has(localized, *part)).map(share))[0],
            least_localized: coverage.least(localized, rest),
            least_trained: None,
            parts,
        }
    }
}

/// The least share of the readings of a stretch of the localized scans that end where scans of the map have readings, as
/// [`Part::covered_by_map`] of a split that the scenario chooses. `None` without reference poses.
pub fn least_covered(drive: &Drive, localized: &[[f64; 2]], map: &[[f64; 2]]) -> Option<f64> {
    let all = drive.steps.len();
    let steps = |[from, to]: [f64; 2]| {
        let [from, to] = [from, to].map(|share| ((share * all as f64).ceil() as usize).min(all));
        from..to.max(from)
    };
    let known: HashSet<[i32; 2]> = map.iter().flat_map(|&share| cells(drive, steps(share))).collect();
    let stretch = all.div_ceil(PARTS).max(1);
    let stretches = localized.iter().flat_map(|&share| {
        let steps = steps(share);
        let end = steps.end;
        steps.step_by(stretch).map(move |from| from..(from + stretch).min(end))
    });
    let shares = stretches.filter_map(|steps| {
        let cells = cells(drive, steps);
        let found = cells.iter().filter(|cell| around(**cell).any(|cell| known.contains(&cell))).count();
        (!cells.is_empty()).then(|| found as f64 / cells.len() as f64)
    });
    shares.reduce(f64::min)
}

/// A cell and those beside it.
fn around([x, y]: [i32; 2]) -> impl Iterator<Item = [i32; 2]> {
    (-1..=1).flat_map(move |i| (-1..=1).map(move |j| [x.saturating_add(i), y.saturating_add(j)]))
}

/// `count` parts from one on.
fn run(from: usize, count: usize) -> Parts {
    ((1 << count) - 1) << from
}

fn has(parts: Parts, part: usize) -> bool {
    parts >> part & 1 == 1
}

/// The scans of a part, as a share of the log's.
fn share(part: usize) -> [f64; 2] {
    [part as f64 / PARTS as f64, (part + 1) as f64 / PARTS as f64]
}

/// The steps of a part: those that [`share`] selects.
fn scans(drive: &Drive, part: usize) -> Range<usize> {
    let at = |share: f64| (share * drive.steps.len() as f64).ceil() as usize;
    let [from, to] = share(part).map(at);
    from..to.min(drive.steps.len())
}

fn distance(drive: &Drive, part: usize) -> f64 {
    let steps = scans(drive, part);
    steps.map(|i| drive.odometry_increment(i).position().length()).sum()
}

/// Intervals in order, neighbours joined.
fn intervals(all: impl Iterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
    let mut joined: Vec<[f64; 2]> = Vec::new();
    for [from, to] in all {
        match joined.last_mut() {
            Some(last) if last[1] == from => last[1] = to,
            _ => joined.push([from, to]),
        }
    }
    joined
}

/// For each part, how many of its readings end where which other parts have readings.
struct Coverage {
    counts: Vec<BTreeMap<Parts, usize>>,
}

impl Coverage {
    fn of(drive: &Drive) -> Self {
        let ends: Vec<Vec<[i32; 2]>> = (0..PARTS).map(|part| cells(drive, scans(drive, part))).collect();
        let mut known = HashMap::<[i32; 2], Parts>::new();
        for (part, cells) in ends.iter().enumerate() {
            for cell in cells {
                *known.entry(*cell).or_default() |= 1 << part;
            }
        }
        let parts_at =
            |cell| around(cell).filter_map(|cell| known.get(&cell)).fold(0, |all, parts| all | parts);
        let counts = ends.iter().enumerate().map(|(part, cells)| {
            let mut counts = BTreeMap::new();
            for cell in cells {
                *counts.entry(parts_at(*cell) & !(1 << part)).or_default() += 1;
            }
            counts
        });
        Self { counts: counts.collect() }
    }

    /// Share of a part's readings that end where `others` have readings; 0 of a part without readings.
    fn by(&self, part: usize, others: Parts) -> f64 {
        let counts = &self.counts[part];
        let all: usize = counts.values().sum();
        let known: usize =
            counts.iter().filter(|(parts, _)| **parts & others != 0).map(|(_, count)| count).sum();
        known as f64 / all.max(1) as f64
    }

    /// The least coverage of some parts by others.
    fn least(&self, parts: Parts, others: Parts) -> f64 {
        (0..PARTS).filter(|part| has(parts, *part)).map(|part| self.by(part, others)).fold(1.0, f64::min)
    }

    fn parts(&self, localized: Parts, trained: Parts, map: Parts) -> Vec<Part> {
        let part = |part: usize| Part {
            scans: share(part),
            covered_by_others: self.by(part, run(0, PARTS)),
            covered_by_map: self.by(part, map),
            role: if has(localized, part) {
                Role::Localize
            } else if has(trained, part) {
                Role::Train
            } else {
                Role::Map
            },
        };
        (0..PARTS).map(part).collect()
    }
}

/// The cells in which readings of some steps end.
fn cells(drive: &Drive, steps: Range<usize>) -> Vec<[i32; 2]> {
    let stride = steps.len().div_ceil(SCANS).max(1);
    let (laser, kept) = drive.laser.thinned(BEAMS);
    let mut cells = Vec::new();
    for step in drive.steps[steps].iter().step_by(stride) {
        let Some(pose) = step.reference.filter(Pose2::is_finite) else { continue };
        let pose = pose.compose(&laser.base_from_laser());
        for (&beam, &bearing) in kept.iter().zip(laser.bearings()) {
            let range = f64::from(step.scan.ranges[beam]);
            if range < f64::from(laser.max_range()).min(USABLE_RANGE_M) {
                let direction = pose.theta + f64::from(bearing);
                let end = [pose.x + range * direction.cos(), pose.y + range * direction.sin()];
                cells.push(end.map(|coordinate| (coordinate / CELL_M).floor() as i32));
            }
        }
    }
    cells
}
