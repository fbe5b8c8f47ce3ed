//! What is looked at in a log: a statistic for each direction in which the library's effects would move it, and the PIT
//! (probability integral transform) of its readings over bins of what a beam is.
//!
//! All of them are plain numbers without a distribution of their own; they get one from simulated logs, see
//! [`crate::null`].

use std::collections::{HashMap, HashSet};
use std::f64::consts::{PI, TAU};

use glam::DVec2;
use locsim_core::{Draw, Stage};
use locsim_world::effect::EffectKind;
use locsim_world::effect::EffectKind as E;
use rand::RngExt;

use crate::hypothesis::{Comparison, Fitted};
use crate::likelihood::{Density, Terms, near_density, normal_density};
use crate::odometry::{deviation, increments, slip_ratio, standardized};
use crate::views::{Beam, jumps};

/// Side of a cell of the map in which endpoints are counted \[m\]: walls, and unmapped objects.
pub(crate) const WALL_CELL_M: f64 = 1.0;
pub(crate) const OBJECT_CELL_M: f64 = 0.25;
/// Bins of a sector: over bearing, and of its range \[m\].
const SECTORS: usize = 24;
pub(crate) const SECTOR_RANGE_M: f64 = 0.25;
/// Steps of a quantization that are looked for \[m\].
const STEPS_M: [f64; 7] = [0.002, 0.003, 0.005, 0.01, 0.02, 0.025, 0.05];
/// Angles from which, and ranges over whose power, returns may be lost.
const DROPOUT_ANGLES_DEG: [f64; 5] = [30.0, 45.0, 60.0, 70.0, 80.0];
const DROPOUT_EXPONENTS: [f64; 5] = [0.0, 1.0, 2.0, 4.0, 8.0];
/// Blocks can stand where their density along a beam is more than this \[1/m\].
const LEAST_HAZARD: f64 = 1e-4;
const WARM_UP_SECS: [f64; 4] = [5.0, 20.0, 60.0, 150.0];
/// Consecutive scans that are held out, located and drawn together \[scans\].
pub(crate) const BLOCK: usize = 20;

/// A covariate of the omnibus search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariate {
    /// Nominal range \[m\].
    Range,
    /// Incidence \[rad\].
    Incidence,
    /// Bearing in the laser's frame \[rad\].
    Bearing,
    /// A square of the map in which the beam ends; see [`Cell::place`].
    Place,
    /// Time since the first scan \[s\].
    Time,
    /// The robot's speed \[m/s\].
    Speed,
    /// The robot's turn rate \[rad/s\].
    TurnRate,
    /// Range jump to a neighbour beam \[m\].
    Jump,
    /// Bearing, by turn rate.
    BearingByTurnRate,
    /// Each scan as a whole: how much scans differ, by what their beams share.
    Scan,
    /// Every beam: the PIT's tenths, from `lo` to `hi`.
    Pit,
}

/// What is off in a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Deviation {
    /// Readings are too long or too short on average (mean of the PIT).
    Mean,
    /// Readings spread too much or too little (variance of the PIT).
    Spread,
    /// Share of readings of something unmapped in front.
    Short,
    /// Share of missing returns.
    NoReturn,
    /// Share of readings whose PIT lies in this tenth.
    Share,
}

/// A cell of the omnibus search.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Cell {
    /// Over what.
    pub covariate: Covariate,
    /// From, in the covariate's unit.
    pub lo: f64,
    /// To.
    pub hi: f64,
    /// Lower corner of the square, for [`Covariate::Place`] \[m\].
    pub place: Option<[f64; 2]>,
    /// What is off.
    pub deviation: Deviation,
}

/// What a statistic looks for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Aim {
    /// An effect; the numbers start its fit: values, or a cell of the map.
    Effect(EffectKind, Hint),
    Cell(Cell),
}

/// Where a fit of an effect can start.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Hint {
    None,
    /// Value of a parameter other than the strength, by index.
    Values(Vec<(usize, f64)>),
    /// A cell of walls, or two neighbours; twice the same for one.
    Wall([[i32; 2]; 2]),
    /// Four cells of free space; the one with the least numbers.
    Object([i32; 2]),
}

/// One number of a log, in two halves: alternating blocks of scans.
pub(crate) type Halves = [f64; 2];

/// Statistic of what, in which log.
#[derive(Clone)]
pub(crate) struct Dictionary {
    pub aims: Vec<Aim>,
    /// A count of rare events rather than a sum of scores.
    counts: Vec<bool>,
    dense: Vec<Dense>,
    /// Maximum range \[m\].
    max: f64,
    wall: Vec<u32>,
    wall_cells: HashMap<[i32; 2], u32>,
    /// Neighbouring cells of walls.
    wall_pairs: Vec<[u32; 2]>,
    /// Share of a contamination of each cell.
    wall_share: Vec<f64>,
    moved_wall: usize,
    glass: usize,
    /// Index of each cell of free space, and the cells of each statistic.
    objects: HashMap<[i32; 2], u32>,
    object_windows: Vec<[u32; 4]>,
    /// Whether unmapped blocks can stand there.
    among_blocks: Vec<bool>,
    first_object: usize,
    sector: usize,
    sector_ranges: usize,
    sector_of: Vec<u16>,
    mixed_share: f64,
    steps: usize,
    mixed: usize,
    depth: usize,
    density: usize,
    odometry: usize,
    patterns: usize,
    cells: usize,
    whole: usize,
    cell_of: Vec<[u32; COVARIATES]>,
    jumps: Vec<Option<[f64; 2]>>,
}

const COVARIATES: usize = 9;

/// A direction in which every beam has a weight.
#[derive(Clone)]
struct Dense {
    score: Score,
    index: usize,
    weights: Vec<f32>,
    /// For contaminations: their share.
    share: f32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Score {
    Location,
    Scale,
    NoReturn,
    Uniform,
    Tail,
}

pub(crate) fn cell_at(x: f64, y: f64, side: f64) -> [i32; 2] {
    [(x / side).floor() as i32, (y / side).floor() as i32]
}

/// Maps have walls at round numbers; cells of walls have their borders elsewhere, or rounding would share a wall out.
const WALL_BORDER_M: f64 = 0.37;

/// The cell of a point of a wall.
pub(crate) fn wall_cell(point: DVec2) -> [i32; 2] {
    cell_at(point.x + WALL_BORDER_M, point.y + WALL_BORDER_M, WALL_CELL_M)
}

/// Lower corner of a cell of walls \[m\].
fn wall_corner(cell: [i32; 2]) -> [f64; 2] {
    cell.map(|c| f64::from(c) * WALL_CELL_M - WALL_BORDER_M)
}

/// About as many events of a kind can just be told from chance: scores of contaminations are best for so many.
const EVENTS: f64 = 15.0;

/// The share at which a contamination of so many beams can just be told from chance.
fn just_seen(beams: f64) -> f64 {
    (EVENTS / beams.max(1.0)).min(0.3)
}

/// Derivative of a log density by the share of a contamination, at `share`; `ratio` is the contamination's density over
/// the hypothesis's, less 1. At a share of 0 it would be the ratio itself, which a single reading can make huge.
#[inline]
fn contaminated(ratio: f64, share: f64) -> f64 {
    ratio / (1.0 + share * ratio)
}

pub(crate) fn tangent_squared(incidence: f64) -> f64 {
    incidence.min(80.0_f64.to_radians()).tan().powi(2)
}

/// The bin of a value between edges; values beyond go to the ends.
fn bin(edges: &[f64], value: f64) -> usize {
    edges.partition_point(|&edge| edge <= value).clamp(1, edges.len() - 1) - 1
}

fn even(lo: f64, hi: f64, bins: usize) -> Vec<f64> {
    (0..=bins).map(|i| lo + (hi - lo) * i as f64 / bins as f64).collect()
}

/// Edges between which equally many of the values lie.
fn quantile_edges(values: &[f64], bins: usize) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let mut edges: Vec<f64> = (0..=bins).map(|i| sorted[(i * (sorted.len() - 1)) / bins]).collect();
    edges.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    if edges.len() < 2 {
        edges = vec![edges[0] - 0.5, edges[0] + 0.5];
    }
    edges
}

impl Dictionary {
    /// What to look at in a log, from the log's poses and the nominal world alone, never from its readings.
    pub fn new(comparison: &Comparison<'_>) -> Self {
        let (views, recorded) = (&comparison.views, comparison.recorded);
        let max = comparison.nominal.laser.max_range_m;
        let (n, k) = (views.beams.len(), views.per_scan);
        let velocities = recorded.velocities();
        let mut aims = Vec::new();
        let mut counts = Vec::new();
        let mut dense: Vec<Dense> = Vec::new();
        let mut add = |aims: &mut Vec<Aim>,
                       counts: &mut Vec<bool>,
                       kind,
                       hint,
                       score,
                       weight: &dyn Fn(usize) -> f64| {
            let weights: Vec<f32> = (0..n).map(|i| weight(i) as f32).collect();
            let share = match score {
                Score::Location | Score::Scale => 0.0,
                Score::NoReturn | Score::Uniform | Score::Tail => {
                    just_seen(weights.iter().copied().map(f64::from).sum())
                }
            };
            dense.push(Dense { score, index: aims.len(), weights, share: share as f32 });
            aims.push(Aim::Effect(kind, hint));
            counts.push(false);
        };
        let beam = |i: usize| &views.beams[i];
        let scan = |i: usize| i / k;
        let secs = |i: usize| recorded.secs[scan(i)];
        let drift = |i: usize| {
            let (j, v) = (beam(i).jacobian, velocities[scan(i)]);
            j[0] * v[0] + j[1] * v[1] + j[2] * v[2]
        };
        let bearings = recorded.laser.bearings();
        let sweep = |i: usize| locsim_core::wrap_angle(f64::from(bearings[i % k])) / TAU;
        let along = |i: usize, axis: f64| {
            let (j, heading) = (beam(i).jacobian, recorded.poses[scan(i)].theta + axis);
            j[0] * heading.cos() + j[1] * heading.sin()
        };
        let (a, c) = (&mut aims, &mut counts);
        add(a, c, E::RangeBias, Hint::None, Score::Location, &|_| 1.0);
        add(a, c, E::RangeScale, Hint::None, Score::Location, &|i| beam(i).range());
        add(a, c, E::IncidenceBias, Hint::None, Score::Location, &|i| {
            tangent_squared(beam(i).view.incidence)
        });
        add(a, c, E::MountYaw, Hint::None, Score::Location, &|i| beam(i).jacobian[2]);
        add(a, c, E::MountOffset, Hint::Values(vec![(0, 0.02), (1, 0.0)]), Score::Location, &|i| {
            along(i, 0.0)
        });
        add(a, c, E::MountOffset, Hint::Values(vec![(0, 0.0), (1, 0.02)]), Score::Location, &|i| {
            along(i, 0.5 * PI)
        });
        add(a, c, E::TimeOffset, Hint::None, Score::Location, &drift);
        add(a, c, E::MotionSkew, Hint::None, Score::Location, &|i| drift(i) * sweep(i));
        for tau in WARM_UP_SECS {
            let hint = Hint::Values(vec![(1, tau)]);
            add(a, c, E::WarmupDrift, hint, Score::Location, &|i| (-secs(i) / tau).exp());
        }
        add(a, c, E::RangeNoise, Hint::None, Score::Scale, &|i| {
            let (r, laser) = (beam(i).range(), &comparison.nominal.laser);
            r * r / (laser.sigma_m + laser.sigma_per_m * r)
        });
        add(a, c, E::IncidenceNoise, Hint::None, Score::Scale, &|i| tangent_squared(beam(i).view.incidence));
        add(a, c, E::HeavyTail, Hint::None, Score::Tail, &|_| 1.0);
        for angle in DROPOUT_ANGLES_DEG.map(f64::to_radians) {
            let hint = Hint::Values(vec![(1, angle)]);
            add(a, c, E::IncidenceDropout, hint, Score::NoReturn, &|i| {
                1.0 / (1.0 + (-(beam(i).view.incidence - angle) / 0.07).exp())
            });
        }
        for exponent in DROPOUT_EXPONENTS {
            let hint = Hint::Values(vec![(1, exponent)]);
            add(a, c, E::RangeDropout, hint, Score::NoReturn, &|i| {
                (beam(i).range() / max).min(1.0).powf(exponent)
            });
        }
        add(a, c, E::Crosstalk, Hint::None, Score::Uniform, &|_| 1.0);

        // sparse ones
        let push = |aims: &mut Vec<Aim>, counts: &mut Vec<bool>, aim, count| {
            aims.push(aim);
            counts.push(count);
            aims.len() - 1
        };
        let mut wall_cells: HashMap<[i32; 2], u32> = HashMap::new();
        let mut wall_order = Vec::new();
        let wall: Vec<u32> = views
            .beams
            .iter()
            .map(|beam| {
                if beam.view.range >= max {
                    return u32::MAX;
                }
                let cell = wall_cell(beam.view.endpoint);
                *wall_cells.entry(cell).or_insert_with(|| {
                    wall_order.push(cell);
                    wall_order.len() as u32 - 1
                })
            })
            .collect();
        let walls = wall_order.len();
        let mut wall_pairs = Vec::new();
        for (i, &[x, y]) in wall_order.iter().enumerate() {
            for neighbour in [[x + 1, y], [x, y + 1]] {
                wall_pairs.extend(wall_cells.get(&neighbour).map(|&j| [i as u32, j]));
            }
        }
        let mut wall_share = vec![0.0; walls];
        for &cell in wall.iter().filter(|&&cell| cell != u32::MAX) {
            wall_share[cell as usize] += 1.0;
        }
        for share in &mut wall_share {
            *share = just_seen(*share);
        }
        let [moved_wall, glass] = [E::MovedWall, E::Glass].map(|kind| {
            let first = aims.len();
            let pairs = wall_pairs.iter().map(|pair| pair.map(|i| wall_order[i as usize]));
            for cells in wall_order.iter().map(|&cell| [cell; 2]).chain(pairs) {
                push(&mut aims, &mut counts, Aim::Effect(kind, Hint::Wall(cells)), false);
            }
            first
        });
        let mixed = push(&mut aims, &mut counts, Aim::Effect(E::MixedPixels, Hint::None), false);
        let steps = aims.len();
        for step in STEPS_M {
            for _ in 0..2 {
                push(
                    &mut aims,
                    &mut counts,
                    Aim::Effect(E::Quantization, Hint::Values(vec![(0, step)])),
                    false,
                );
            }
        }
        let depth = push(&mut aims, &mut counts, Aim::Effect(E::BlockDepth, Hint::None), false);
        let density = push(&mut aims, &mut counts, Aim::Effect(E::BlockDensity, Hint::None), false);
        let odometry = aims.len();
        for kind in [E::OdomDistanceScale, E::OdomTurnScale, E::OdomImbalance, E::WheelSlip] {
            push(&mut aims, &mut counts, Aim::Effect(kind, Hint::None), false);
        }
        let patterns = aims.len();
        for (kind, hint) in [
            (E::MountYaw, Hint::None),
            (E::MountOffset, Hint::Values(vec![(0, 0.02), (1, 0.0)])),
            (E::MountOffset, Hint::Values(vec![(0, 0.0), (1, 0.02)])),
            (E::TimeOffset, Hint::None),
        ] {
            push(&mut aims, &mut counts, Aim::Effect(kind, hint), false);
        }
        // Where unmapped objects can be seen: along the beams, up to their ends.
        let mut objects = HashMap::new();
        let mut block_cells = HashSet::new();
        for (i, beam) in views.beams.iter().enumerate() {
            let heading = recorded.poses[scan(i)].theta + beam.view.bearing;
            let range = beam.view.range.min(max);
            let end = beam.view.endpoint;
            let mut back = 0.5 * OBJECT_CELL_M;
            while back < range {
                let from_end = beam.view.range - (range - back);
                let (x, y) = (end.x - from_end * heading.cos(), end.y - from_end * heading.sin());
                let cell = cell_at(x, y, OBJECT_CELL_M);
                objects.entry(cell).or_insert(0);
                if beam.survival_at(back).1 > LEAST_HAZARD {
                    block_cells.insert(cell);
                }
                back += OBJECT_CELL_M;
            }
        }
        let mut order: Vec<[i32; 2]> = objects.keys().copied().collect();
        order.sort_unstable();
        for (i, cell) in order.iter().enumerate() {
            objects.insert(*cell, i as u32);
        }
        // Overlapping windows of four cells: what stands on a border isn't shared out.
        let first_object = aims.len();
        let (mut object_windows, mut among_blocks) = (Vec::new(), Vec::new());
        for &[x, y] in &order {
            let window = [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]];
            among_blocks.push(window.iter().any(|cell| block_cells.contains(cell)));
            object_windows.push(window.map(|cell| objects.get(&cell).copied().unwrap_or(u32::MAX)));
            push(&mut aims, &mut counts, Aim::Effect(E::MissingObject, Hint::Object([x, y])), true);
        }
        let sector_ranges = (max / SECTOR_RANGE_M).ceil().min(24.0) as usize;
        let sector = aims.len();
        let (first, last) = (f64::from(bearings[0]), f64::from(bearings[k - 1]));
        let width = (last - first) / SECTORS as f64;
        for s in 0..SECTORS - 1 {
            for r in 0..sector_ranges - 1 {
                let from = first + s as f64 * width;
                let range = (r as f64 + 1.0) * SECTOR_RANGE_M;
                let hint = Hint::Values(vec![(0, from), (1, from + 2.0 * width), (2, range)]);
                push(&mut aims, &mut counts, Aim::Effect(E::SectorOcclusion, hint), true);
            }
        }
        let sector_of = bearings
            .iter()
            .map(|&b| (((f64::from(b) - first) / width.max(1e-9)) as usize).min(SECTORS - 1) as u16)
            .collect();

        // omnibus cells
        let jumps: Vec<Option<[f64; 2]>> =
            (0..views.scans()).flat_map(|s| jumps(comparison.nominal, recorded, s)).collect();
        let mixed_share = just_seen(jumps.iter().flatten().count() as f64);
        let jump_size = |i: usize| jumps[i].map_or(0.0, |[near, far]| far - near);
        let speed = |i: usize| velocities[scan(i)][0].hypot(velocities[scan(i)][1]);
        let turn = |i: usize| velocities[scan(i)][2];
        let per_scan =
            |of: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..views.scans()).map(|s| of(s * k)).collect() };
        let range_edges = even(0.0, max, 12);
        let incidence_edges = even(0.0, 0.5 * PI, 9);
        let bearing_edges = even(first, last + 1e-6, 24);
        let time_edges = even(0.0, recorded.secs[recorded.scans() - 1] + 1e-6, 20);
        let speed_edges = quantile_edges(&per_scan(&speed), 5);
        let turn_edges = quantile_edges(&per_scan(&turn), 7);
        let coarse_turn = quantile_edges(&per_scan(&turn), 4);
        let jump_edges = vec![0.0, 0.3, 0.6, 1.5, max];
        let coarse_bearing = even(first, last + 1e-6, 8);
        let sizes = [
            range_edges.len() - 1,
            incidence_edges.len() - 1,
            bearing_edges.len() - 1,
            walls,
            time_edges.len() - 1,
            speed_edges.len() - 1,
            turn_edges.len() - 1,
            jump_edges.len() - 1,
            (coarse_bearing.len() - 1) * (coarse_turn.len() - 1),
        ];
        let cells = aims.len();
        let mut starts = [0; COVARIATES];
        let mut next = 0;
        for (start, size) in starts.iter_mut().zip(sizes) {
            *start = next;
            next += size;
        }
        let covariates = [
            Covariate::Range,
            Covariate::Incidence,
            Covariate::Bearing,
            Covariate::Place,
            Covariate::Time,
            Covariate::Speed,
            Covariate::TurnRate,
            Covariate::Jump,
            Covariate::BearingByTurnRate,
        ];
        for (covariate, size) in covariates.into_iter().zip(sizes) {
            for i in 0..size {
                let interval = |edges: &[f64]| (edges[i], edges[i + 1]);
                let (lo, hi) = match covariate {
                    Covariate::Range => interval(&range_edges),
                    Covariate::Incidence => interval(&incidence_edges),
                    Covariate::Bearing => interval(&bearing_edges),
                    Covariate::Place => (i as f64, i as f64 + 1.0),
                    Covariate::Time => interval(&time_edges),
                    Covariate::Speed => interval(&speed_edges),
                    Covariate::TurnRate => interval(&turn_edges),
                    Covariate::Jump => interval(&jump_edges),
                    // These have cells of their own.
                    Covariate::Scan | Covariate::Pit => (0.0, 0.0),
                    Covariate::BearingByTurnRate => {
                        let i = i / (coarse_turn.len() - 1);
                        (coarse_bearing[i], coarse_bearing[i + 1])
                    }
                };
                let place = (covariate == Covariate::Place).then(|| wall_corner(wall_order[i]));
                for deviation in [Deviation::Mean, Deviation::Spread, Deviation::Short, Deviation::NoReturn] {
                    let count = matches!(deviation, Deviation::Short | Deviation::NoReturn);
                    push(
                        &mut aims,
                        &mut counts,
                        Aim::Cell(Cell { covariate, lo, hi, place, deviation }),
                        count,
                    );
                }
            }
        }
        let whole = aims.len();
        for deviation in [Deviation::Mean, Deviation::Short, Deviation::NoReturn] {
            let cell = Cell { covariate: Covariate::Scan, lo: 0.0, hi: 0.0, place: None, deviation };
            push(&mut aims, &mut counts, Aim::Cell(cell), false);
        }
        for tenth in 0..10 {
            let (lo, hi) = (0.1 * f64::from(tenth), 0.1 * f64::from(tenth + 1));
            let cell = Cell { covariate: Covariate::Pit, lo, hi, place: None, deviation: Deviation::Share };
            push(&mut aims, &mut counts, Aim::Cell(cell), false);
        }
        let cell_of = (0..n)
            .map(|i| {
                let turns = coarse_turn.len() - 1;
                let bins = [
                    bin(&range_edges, beam(i).view.range),
                    bin(&incidence_edges, beam(i).view.incidence),
                    bin(&bearing_edges, beam(i).view.bearing),
                    if wall[i] == u32::MAX { usize::MAX } else { wall[i] as usize },
                    bin(&time_edges, secs(i)),
                    bin(&speed_edges, speed(i)),
                    bin(&turn_edges, turn(i)),
                    bin(&jump_edges, jump_size(i)),
                    bin(&coarse_bearing, beam(i).view.bearing) * turns + bin(&coarse_turn, turn(i)),
                ];
                std::array::from_fn(|c| {
                    if bins[c] == usize::MAX { u32::MAX } else { (cells + 4 * (starts[c] + bins[c])) as u32 }
                })
            })
            .collect();
        Self {
            aims,
            counts,
            dense,
            max,
            wall,
            wall_cells,
            wall_pairs,
            wall_share,
            moved_wall,
            glass,
            objects,
            object_windows,
            among_blocks,
            first_object,
            sector,
            sector_ranges,
            sector_of,
            mixed_share,
            steps,
            mixed,
            depth,
            density,
            odometry,
            patterns,
            cells,
            whole,
            cell_of,
            jumps,
        }
    }

    pub fn len(&self) -> usize {
        self.aims.len()
    }

    /// Index of the first omnibus cell; the library's directions come before.
    pub fn first_cell(&self) -> usize {
        self.cells
    }

    /// Statistics that are ranked among themselves: 0 for the scores of effects that act on many beams, 1 for those that
    /// act in one of many places, 2 for the cells, 3 for objects where unmapped blocks can stand: where those stay, each
    /// looks like an object.
    pub fn group(&self, index: usize) -> usize {
        let is_wide = self.is_score(index)
            || (self.odometry..self.patterns + 4).contains(&index)
            || index == self.mixed
            || index == self.depth;
        let windows = self.first_object..self.first_object + self.object_windows.len();
        if index >= self.cells {
            2
        } else if is_wide {
            0
        } else if windows.contains(&index) && self.among_blocks[index - self.first_object] {
            3
        } else {
            1
        }
    }

    /// How far a statistic at `z` standard deviations speaks for what it looks for: a share can't be negative.
    pub fn off(&self, index: usize, z: f64) -> f64 {
        match self.aims[index] {
            Aim::Effect(kind, _) if is_one_sided(kind) => z,
            _ => z.abs(),
        }
    }

    fn moves_scans(&self, index: usize) -> bool {
        matches!(self.aims[index], Aim::Effect(E::MountYaw | E::MountOffset | E::TimeOffset, _))
    }

    /// Whether a statistic counts rare events.
    pub fn is_count(&self, index: usize) -> bool {
        self.counts[index]
    }

    /// Whether a statistic is the score of an effect's first number: its spread is the root of its information.
    pub fn is_score(&self, index: usize) -> bool {
        self.dense.iter().any(|dense| dense.index == index)
    }

    /// The omnibus cells of each beam: the index of the first of four statistics.
    pub fn cells_of_beams(&self) -> &[[u32; COVARIATES]] {
        &self.cell_of
    }

    /// Whether a reading is of something in front of what the map has there.
    pub fn is_in_front(&self, beam: &Beam<'_>, shift: f64, z: f64, terms: &Terms) -> bool {
        z < self.max && z < beam.range() + shift - 4.0 * terms.sigma.min(0.1)
    }

    /// What a reading says of the share of beams that a wall lets through.
    pub fn glass_score(&self, beam: &Beam<'_>, shift: f64, z: f64, terms: &Terms) -> f64 {
        let wall = self.wall_cells.get(&wall_cell(beam.view.endpoint));
        wall.map_or(0.0, |&wall| self.glass_score_of(wall as usize, beam, shift, z, terms))
    }

    fn glass_score_of(&self, wall: usize, beam: &Beam<'_>, shift: f64, z: f64, terms: &Terms) -> f64 {
        let through = if z < self.max {
            let sigma = terms.sigma.min(0.1);
            let far = beam.view.behind.map_or(0.0, |behind| near_density(z, behind + shift, sigma, self.max));
            // What stands behind is often not on the map.
            0.5 * far + if z > beam.range() + shift + 5.0 * sigma { 0.5 / self.max } else { 0.0 }
        } else {
            0.5
        };
        contaminated(Density::contamination(terms, through), self.wall_share[wall])
    }

    /// All statistics of a log.
    pub fn of(
        &self,
        comparison: &Comparison<'_>,
        effects: &locsim_world::effect::Effects,
        views: &crate::views::Views<'_>,
        fitted: &Fitted,
        pit: &Draw,
    ) -> Vec<Halves> {
        let mut out = vec![[0.0; 2]; self.len()];
        let n = views.beams.len();
        let k = views.per_scan;
        let max = comparison.nominal.laser.max_range_m;
        let mut scores: [Vec<f32>; 5] = std::array::from_fn(|_| vec![0.0; n]);
        let mut depth = [[0.0; 2]; 2];
        let mut in_cells = vec![[0.0; 2]; self.objects.len()];
        let mut in_sectors = vec![[0.0; 2]; SECTORS * self.sector_ranges];
        let mut whole = vec![[0.0_f64; 3]; views.scans()];
        comparison.for_each_reading(views, effects, fitted, |scan, i, density, shift, z, terms| {
            let half = (scan / BLOCK) % 2;
            let beam = &views.beams[i];
            let is_return = z < max;
            let t = terms.error / terms.sigma;
            let g = |other| Density::contamination(&terms, other);
            if is_return {
                scores[0][i] = (terms.hit * terms.error / terms.sigma.powi(2)) as f32;
                scores[1][i] = (terms.hit * (t * t - 1.0)) as f32;
            }
            if beam.range() < max {
                scores[2][i] = g(f64::from(u8::from(!is_return))) as f32;
                let tail = if is_return && terms.hit > 0.0 || terms.sigma.is_finite() {
                    normal_density(t / 5.0) / (5.0 * terms.sigma)
                } else {
                    0.0
                };
                if is_return {
                    scores[4][i] = g(tail) as f32;
                }
            }
            let uniform = if is_return { 1.0 / max } else { 0.0 };
            scores[3][i] = ((uniform / terms.density) - 1.0) as f32;
            if let Some([near, far]) = self.jumps[i] {
                let inside = is_return && (near..far).contains(&z);
                let ratio = g(if inside { 1.0 / (far - near) } else { 0.0 });
                out[self.mixed][half] += contaminated(ratio, self.mixed_share);
            }
            let wall = self.wall[i];
            if wall != u32::MAX {
                let wall = wall as usize;
                if is_return {
                    out[self.moved_wall + wall][half] += moved_wall_score(beam, &terms);
                }
                out[self.glass + wall][half] += self.glass_score_of(wall, beam, shift, z, &terms);
            }
            // Things in front may stand where no block does.
            let in_front = self.is_in_front(beam, shift, z, &terms);
            if in_front {
                let heading = comparison.recorded.poses[scan].theta + beam.view.bearing;
                let back = beam.view.range - z;
                let end = beam.view.endpoint;
                let cell = cell_at(end.x - back * heading.cos(), end.y - back * heading.sin(), OBJECT_CELL_M);
                if let Some(&index) = self.objects.get(&cell) {
                    in_cells[index as usize][half] += 1.0;
                }
                depth[0][half] += terms.short * (beam.range() - z);
                depth[1][half] += terms.short;
            }
            if in_front {
                let range = (z / SECTOR_RANGE_M) as usize;
                if range < self.sector_ranges {
                    in_sectors[usize::from(self.sector_of[i % k]) * self.sector_ranges + range][half] += 1.0;
                }
            }
            if is_return {
                for (s, [cos, sin]) in phases(z).into_iter().enumerate() {
                    out[self.steps + 2 * s][half] += cos;
                    out[self.steps + 2 * s + 1][half] += sin;
                }
            }
            let u = if is_return {
                density.cdf(beam, shift, z)
            } else {
                1.0 - terms.density.min(1.0) * pit.at(scan as u32).item(i as u32).random::<f64>()
            };
            let missing = f64::from(u8::from(!is_return && beam.range() < max));
            let values = [u - 0.5, (u - 0.5).powi(2) - 1.0 / 12.0, terms.short, missing];
            for (sum, value) in whole[scan].iter_mut().zip([values[0], values[2], values[3]]) {
                *sum += value;
            }
            out[self.whole + 3 + ((10.0 * u) as usize).min(9)][half] += 1.0;
            for &cell in &self.cell_of[i] {
                if cell != u32::MAX {
                    for (v, value) in values.iter().enumerate() {
                        out[cell as usize + v][half] += value;
                    }
                }
            }
        });
        for (i, of_scan) in whole.windows(2).enumerate() {
            for kind in 0..3 {
                // What changes from scan to scan; what stays is for other cells.
                out[self.whole + kind][(i / BLOCK) % 2] += (of_scan[1][kind] - of_scan[0][kind]).powi(2);
            }
        }
        for Dense { score, index, weights, share } in &self.dense {
            // Fitted errors of the reference take in what moves whole scans; the patterns look for it in the errors.
            if self.moves_scans(*index) && !fitted.nuisances.pose_error.is_none() {
                continue;
            }
            let scores = &scores[*score as usize];
            for scan in 0..views.scans() {
                let beams = scan * k..(scan + 1) * k;
                let pairs = scores[beams.clone()].iter().zip(&weights[beams]).map(|(s, w)| s * w);
                let sum: f32 = if *share > 0.0 {
                    pairs.map(|ratio| ratio / (1.0 + share * ratio)).sum()
                } else {
                    pairs.sum()
                };
                out[*index][(scan / BLOCK) % 2] += f64::from(sum);
            }
        }
        let walls = self.wall_share.len();
        for first in [self.moved_wall, self.glass] {
            for (p, pair) in self.wall_pairs.iter().enumerate() {
                out[first + walls + p] =
                    std::array::from_fn(|half| pair.iter().map(|&i| out[first + i as usize][half]).sum());
            }
        }
        for (window, cells) in self.object_windows.iter().enumerate() {
            for &cell in cells.iter().filter(|&&cell| cell != u32::MAX) {
                for half in 0..2 {
                    out[self.first_object + window][half] += in_cells[cell as usize][half];
                }
            }
        }
        let ranges = self.sector_ranges;
        for s in 0..SECTORS - 1 {
            for r in 0..ranges - 1 {
                let corner = s * ranges + r;
                let window = [corner, corner + 1, corner + ranges, corner + ranges + 1];
                out[self.sector + s * (ranges - 1) + r] =
                    std::array::from_fn(|half| window.iter().map(|&i| in_sectors[i][half]).sum());
            }
        }
        for half in 0..2 {
            out[self.depth][half] = depth[0][half] / (depth[1][half] + 1.0);
            out[self.density][half] = 0.5 * fitted.nuisances.block_density.ln();
        }
        for (p, score) in fitted.pattern_scores.iter().enumerate() {
            // Of the log as a whole.
            out[self.patterns + p] = [0.5 * score; 2];
        }
        let track = comparison.corrected(&fitted.corrections);
        let all = increments(comparison.nominal, effects, &track, &comparison.recorded.odometry);
        // Correlations, so that they don't depend on how large the reference's errors are taken to be.
        let slip_share = E::WheelSlip.parameters()[1].start;
        let mut sums = [[Correlation::default(); 4]; 2];
        for (scan, increment) in all.iter().enumerate() {
            let [distance, turn] = standardized(increment, &fitted.nuisances.odometry_error);
            let [ds, dtheta] = increment.truth;
            let error = &fitted.nuisances.odometry_error;
            let [of_distance, of_turn] = [0, 1].map(|axis| deviation(increment, error, axis));
            let [scale, turn_scale, imbalance, slip] = &mut sums[(scan / BLOCK) % 2];
            scale.add(distance, ds / of_distance);
            turn_scale.add(turn, dtheta / of_turn);
            imbalance.add(turn, ds / of_turn);
            slip.add(
                contaminated(slip_ratio(increment, error, slip_share), just_seen(all.len() as f64)),
                1.0,
            );
        }
        for (half, sums) in sums.iter().enumerate() {
            for (i, correlation) in sums.iter().enumerate() {
                out[self.odometry + i][half] = correlation.value();
            }
        }
        out
    }
}

/// Cosine and sine of 2 pi z over each of [`STEPS_M`]: all but one are powers of one complex number.
fn phases(z: f64) -> [[f64; 2]; STEPS_M.len()] {
    let phase = |step: f64| {
        let (sin, cos) = (TAU * z / step).sin_cos();
        [cos, sin]
    };
    let times = |[a, b]: [f64; 2], [c, d]: [f64; 2]| [a * c - b * d, a * d + b * c];
    let square = |a| times(a, a);
    let tenth = phase(0.1);
    let of_50 = square(tenth);
    let of_25 = square(of_50);
    let of_20 = times(of_25, tenth);
    let of_10 = square(of_20);
    let of_5 = square(of_10);
    let of_2 = times(square(of_5), of_10);
    [of_2, phase(0.003), of_5, of_10, of_20, of_25, of_50]
}

/// Whether an effect can act in one direction only.
fn is_one_sided(kind: EffectKind) -> bool {
    let strength = &kind.parameters()[0];
    strength.lo >= strength.neutral || matches!(kind, E::MissingObject | E::SectorOcclusion)
}

/// What a reading says of how far a wall is moved.
pub(crate) fn moved_wall_score(beam: &Beam<'_>, terms: &Terms) -> f64 {
    if terms.sigma.is_infinite() {
        return 0.0;
    }
    terms.hit * terms.error / terms.sigma.powi(2) / beam.view.incidence.cos().max(0.17)
}

/// Correlation of two numbers about zero, times the root of how many there are.
#[derive(Clone, Copy, Default)]
struct Correlation {
    xy: f64,
    xx: f64,
    yy: f64,
    count: f64,
}

impl Correlation {
    fn add(&mut self, x: f64, y: f64) {
        self.xy += x * y;
        self.xx += x * x;
        self.yy += y * y;
        self.count += 1.0;
    }

    fn value(&self) -> f64 {
        self.xy / (self.xx * self.yy).sqrt().max(1e-300) * self.count.sqrt()
    }
}

/// The draws that randomize the PIT of missing returns.
pub(crate) fn pit_draw(seed: u64) -> Draw {
    Draw::new(seed, Stage::Bootstrap, 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_are_those_of_the_steps() {
        for z in [0.0, 0.4567, 3.21, 7.999] {
            for (step, [cos, sin]) in STEPS_M.into_iter().zip(phases(z)) {
                let angle = TAU * z / step;
                assert!((cos - angle.cos()).abs() < 1e-9 && (sin - angle.sin()).abs() < 1e-9, "{z} {step}");
            }
        }
    }

    /// At the share itself the score's mean is 0: sum of q ratio / (1 + share ratio) over two outcomes of probability
    /// q = p (1 + share ratio), p those of the hypothesis.
    #[test]
    fn the_score_of_a_contamination_has_no_mean_at_its_share() {
        let (p, share) = ([0.9, 0.1], 0.05);
        // Under the contamination alone: 0.2 and 0.8.
        let ratios = [0.2 / 0.9 - 1.0, 0.8 / 0.1 - 1.0];
        let mean: f64 =
            p.iter().zip(ratios).map(|(p, r)| p * (1.0 + share * r) * contaminated(r, share)).sum();
        assert!(mean.abs() < 1e-12, "{mean}");
    }
}
