use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use locsim_world::effect::EffectKind;
use locsim_world::effect::EffectKind as E;

use super::{
    Cell, Covariate, DROPOUT_ANGLES_DEG, DROPOUT_EXPONENTS, Deviation, OBJECT_CELL_M, RATIO_BIN, RATIO_BINS,
    READINGS_ERR_M, SECTOR_RANGE_M, SECTORS, SLIP_SHARES, STEPS_M, Seed, Target, WARM_UP_SECS, cell_at,
    just_seen, tangent_squared, wall_cell, wall_corner,
};
use crate::hypothesis::Comparison;
use crate::views::jumps;

/// Statistic of what, in which log.
#[derive(Clone)]
pub(crate) struct Dictionary {
    pub targets: Vec<Target>,
    /// A count of rare events rather than a sum of scores.
    pub(super) counts: Vec<bool>,
    pub(super) dense: Vec<Dense>,
    /// Maximum range \[m\].
    pub(super) max: f64,
    pub(super) wall: Vec<u32>,
    /// Neighbouring cells of walls.
    pub(super) wall_pairs: Vec<[u32; 2]>,
    /// Share of a contamination of each cell.
    pub(super) wall_share: Vec<f64>,
    pub(super) moved_wall: usize,
    pub(super) glass: usize,
    /// Index of each cell of free space, and the cells of each statistic.
    pub(super) objects: HashMap<[i32; 2], u32>,
    pub(super) object_windows: Vec<[u32; 4]>,
    /// Whether unmapped blocks can stand there.
    pub(super) among_blocks: Vec<bool>,
    pub(super) first_object: usize,
    pub(super) sector: usize,
    pub(super) sector_ranges: usize,
    pub(super) sector_of: Vec<u16>,
    pub(super) mixed_share: f64,
    pub(super) steps: usize,
    pub(super) mixed: usize,
    pub(super) depth: usize,
    pub(super) density: usize,
    pub(super) odometry: usize,
    pub(super) patterns: usize,
    pub(super) cells: usize,
    pub(super) whole: usize,
    pub(super) ratios: usize,
    pub(super) cell_of: Vec<[u32; COVARIATES]>,
    pub(super) jumps: Vec<Option<[f64; 2]>>,
}

/// Statistics that are ranked among themselves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    /// Scores of effects that shift or spread many readings, or are in the odometry.
    Wide,
    /// Effects in one of many places or sectors.
    Places,
    /// The omnibus cells.
    Cells,
    /// Objects where unmapped blocks can stand: where those stay, each looks like an object.
    AmongBlocks,
    /// Shares of readings that are lost or not of the wall, and how deep blocks are: where blocks stay, such readings come in
    /// crowds, and the largest of these statistics is now and then far beyond what is usual.
    Shares,
}

impl Group {
    pub const COUNT: usize = 5;
}

pub(super) const COVARIATES: usize = 9;
/// Where the last bin of ratios ends.
const MOST_RATIO: f64 = 1000.0;

/// A direction in which every beam has a weight.
#[derive(Clone)]
pub(super) struct Dense {
    pub(super) score: Score,
    pub(super) index: usize,
    pub(super) weights: Vec<f32>,
    /// For contaminations: their share.
    pub(super) share: f32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Score {
    Location,
    Scale,
    NoReturn,
    Uniform,
    Tail,
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
        let mut targets = Vec::new();
        let mut counts = Vec::new();
        let mut dense: Vec<Dense> = Vec::new();
        let mut add = |targets: &mut Vec<Target>,
                       counts: &mut Vec<bool>,
                       kind,
                       initial,
                       score,
                       weight: &dyn Fn(usize) -> f64| {
            let weights: Vec<f32> = (0..n).map(|i| weight(i) as f32).collect();
            let share = match score {
                Score::Location | Score::Scale => 0.0,
                Score::NoReturn | Score::Uniform | Score::Tail => {
                    just_seen(weights.iter().copied().map(f64::from).sum())
                }
            };
            dense.push(Dense { score, index: targets.len(), weights, share: share as f32 });
            targets.push(Target::Effect(kind, initial));
            counts.push(false);
        };
        let beam = |i: usize| &views.beams[i];
        let scan = |i: usize| i / k;
        let secs = |i: usize| recorded.track.secs()[scan(i)];
        let drift = |i: usize| {
            let (j, v) = (beam(i).jacobian, velocities[scan(i)]);
            j[0] * v[0] + j[1] * v[1] + j[2] * v[2]
        };
        let bearings = recorded.laser.bearings();
        let sweep = |i: usize| locsim_core::wrap_angle(f64::from(bearings[i % k])) / TAU;
        let along = |i: usize, axis: f64| {
            let (j, heading) = (beam(i).jacobian, recorded.track.poses()[scan(i)].theta + axis);
            j[0] * heading.cos() + j[1] * heading.sin()
        };
        let (a, c) = (&mut targets, &mut counts);
        add(a, c, E::RangeBias, Seed::None, Score::Location, &|_| 1.0);
        add(a, c, E::RangeScale, Seed::None, Score::Location, &|i| beam(i).range());
        add(a, c, E::IncidenceBias, Seed::None, Score::Location, &|i| {
            tangent_squared(beam(i).view.incidence)
        });
        add(a, c, E::MountYaw, Seed::None, Score::Location, &|i| beam(i).jacobian[2]);
        add(a, c, E::MountOffset, Seed::Values(vec![(0, 0.02), (1, 0.0)]), Score::Location, &|i| {
            along(i, 0.0)
        });
        add(a, c, E::MountOffset, Seed::Values(vec![(0, 0.0), (1, 0.02)]), Score::Location, &|i| {
            along(i, 0.5 * PI)
        });
        add(a, c, E::TimeOffset, Seed::None, Score::Location, &drift);
        add(a, c, E::MotionSkew, Seed::None, Score::Location, &|i| drift(i) * sweep(i));
        for tau in WARM_UP_SECS {
            let initial = Seed::Values(vec![(1, tau)]);
            add(a, c, E::WarmupDrift, initial, Score::Location, &|i| (-secs(i) / tau).exp());
        }
        add(a, c, E::RangeNoise, Seed::None, Score::Scale, &|i| {
            let (r, laser) = (beam(i).range(), &comparison.nominal.laser);
            r * r / (laser.sigma_m + laser.sigma_per_m * r)
        });
        add(a, c, E::IncidenceNoise, Seed::None, Score::Scale, &|i| tangent_squared(beam(i).view.incidence));
        add(a, c, E::HeavyTail, Seed::None, Score::Tail, &|_| 1.0);
        for angle in DROPOUT_ANGLES_DEG.map(f64::to_radians) {
            let initial = Seed::Values(vec![(1, angle)]);
            add(a, c, E::IncidenceDropout, initial, Score::NoReturn, &|i| {
                1.0 / (1.0 + (-(beam(i).view.incidence - angle) / 0.07).exp())
            });
        }
        for exponent in DROPOUT_EXPONENTS {
            let initial = Seed::Values(vec![(1, exponent)]);
            add(a, c, E::RangeDropout, initial, Score::NoReturn, &|i| {
                (beam(i).range() / max).min(1.0).powf(exponent)
            });
        }
        add(a, c, E::Crosstalk, Seed::None, Score::Uniform, &|_| 1.0);

        // sparse ones
        let push = |targets: &mut Vec<Target>, counts: &mut Vec<bool>, target, count| {
            targets.push(target);
            counts.push(count);
            targets.len() - 1
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
            let first = targets.len();
            let pairs = wall_pairs.iter().map(|pair| pair.map(|i| wall_order[i as usize]));
            for cells in wall_order.iter().map(|&cell| [cell; 2]).chain(pairs) {
                push(&mut targets, &mut counts, Target::Effect(kind, Seed::Wall(cells)), false);
            }
            first
        });
        let mixed = push(&mut targets, &mut counts, Target::Effect(E::MixedPixels, Seed::None), false);
        let steps = targets.len();
        for step in STEPS_M {
            for _ in 0..2 {
                push(
                    &mut targets,
                    &mut counts,
                    Target::Effect(E::Quantization, Seed::Values(vec![(0, step)])),
                    false,
                );
            }
        }
        let depth = push(&mut targets, &mut counts, Target::Effect(E::BlockDepth, Seed::None), false);
        let density = push(&mut targets, &mut counts, Target::Effect(E::BlockDensity, Seed::None), false);
        let odometry = targets.len();
        for kind in [E::OdomDistanceScale, E::OdomTurnScale, E::OdomImbalance] {
            push(&mut targets, &mut counts, Target::Effect(kind, Seed::None), false);
        }
        for share in SLIP_SHARES {
            let initial = Seed::Values(vec![(1, share)]);
            push(&mut targets, &mut counts, Target::Effect(E::WheelSlip, initial), false);
        }
        let patterns = targets.len();
        for (kind, initial) in [
            (E::MountYaw, Seed::None),
            (E::MountOffset, Seed::Values(vec![(0, 0.02), (1, 0.0)])),
            (E::MountOffset, Seed::Values(vec![(0, 0.0), (1, 0.02)])),
            (E::TimeOffset, Seed::None),
        ] {
            push(&mut targets, &mut counts, Target::Effect(kind, initial), false);
        }
        // Where unmapped objects can be seen: along the beams, up to their ends.
        let mut objects = HashMap::new();
        for (i, beam) in views.beams.iter().enumerate() {
            let heading = recorded.track.poses()[scan(i)].theta + beam.view.bearing;
            let range = beam.view.range.min(max);
            let end = beam.view.endpoint;
            let mut back = 0.5 * OBJECT_CELL_M;
            while back < range {
                let from_end = beam.view.range - (range - back);
                let (x, y) = (end.x - from_end * heading.cos(), end.y - from_end * heading.sin());
                objects.entry(cell_at(x, y, OBJECT_CELL_M)).or_insert(0);
                back += OBJECT_CELL_M;
            }
        }
        let mut order: Vec<[i32; 2]> = objects.keys().copied().collect();
        order.sort_unstable();
        for (i, cell) in order.iter().enumerate() {
            objects.insert(*cell, i as u32);
        }
        // Overlapping windows of four cells: what stands on a border isn't shared out.
        let first_object = targets.len();
        let readings_err = READINGS_ERR_M.max(5.0 * comparison.nominal.laser.sigma_m);
        // Of windows around points of a lattice.
        let reach = views.blocks_in_reach(OBJECT_CELL_M, OBJECT_CELL_M + readings_err);
        let (mut object_windows, mut among_blocks) = (Vec::new(), Vec::new());
        for &[x, y] in &order {
            let window = [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]];
            among_blocks.push(reach.contains(&[x + 1, y + 1]));
            object_windows.push(window.map(|cell| objects.get(&cell).copied().unwrap_or(u32::MAX)));
            push(&mut targets, &mut counts, Target::Effect(E::MissingObject, Seed::Object([x, y])), true);
        }
        let sector_ranges = (max / SECTOR_RANGE_M).ceil().min(24.0) as usize;
        let sector = targets.len();
        let (first, last) = (f64::from(bearings[0]), f64::from(bearings[k - 1]));
        let width = (last - first) / SECTORS as f64;
        for s in 0..SECTORS - 1 {
            for r in 0..sector_ranges - 1 {
                let from = first + s as f64 * width;
                let range = (r as f64 + 1.0) * SECTOR_RANGE_M;
                let initial = Seed::Values(vec![(0, from), (1, from + 2.0 * width), (2, range)]);
                push(&mut targets, &mut counts, Target::Effect(E::SectorOcclusion, initial), true);
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
        let time_edges = even(0.0, recorded.track.secs()[recorded.scans() - 1] + 1e-6, 20);
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
        let cells = targets.len();
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
                    Covariate::Scan | Covariate::Pit | Covariate::Ratio => (0.0, 0.0),
                    Covariate::BearingByTurnRate => {
                        let i = i / (coarse_turn.len() - 1);
                        (coarse_bearing[i], coarse_bearing[i + 1])
                    }
                };
                let place = (covariate == Covariate::Place).then(|| wall_corner(wall_order[i]));
                for deviation in Deviation::OF_BINS {
                    let count = matches!(deviation, Deviation::Short | Deviation::NoReturn | Deviation::Long);
                    push(
                        &mut targets,
                        &mut counts,
                        Target::Cell(Cell { covariate, lo, hi, place, deviation }),
                        count,
                    );
                }
            }
        }
        let whole = targets.len();
        for deviation in [Deviation::Mean, Deviation::Short, Deviation::NoReturn] {
            let cell = Cell { covariate: Covariate::Scan, lo: 0.0, hi: 0.0, place: None, deviation };
            push(&mut targets, &mut counts, Target::Cell(cell), false);
        }
        for tenth in 0..10 {
            let (lo, hi) = (0.1 * f64::from(tenth), 0.1 * f64::from(tenth + 1));
            let cell = Cell { covariate: Covariate::Pit, lo, hi, place: None, deviation: Deviation::Share };
            push(&mut targets, &mut counts, Target::Cell(cell), false);
        }
        let ratios = targets.len();
        for i in 0..RATIO_BINS {
            let lo = i as f64 * RATIO_BIN;
            let hi = if i + 1 == RATIO_BINS { MOST_RATIO } else { lo + RATIO_BIN };
            let cell = Cell { covariate: Covariate::Ratio, lo, hi, place: None, deviation: Deviation::Share };
            push(&mut targets, &mut counts, Target::Cell(cell), true);
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
                    if bins[c] == usize::MAX {
                        u32::MAX
                    } else {
                        (cells + Deviation::OF_BINS.len() * (starts[c] + bins[c])) as u32
                    }
                })
            })
            .collect();
        Self {
            targets,
            counts,
            dense,
            max,
            wall,
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
            ratios,
            cell_of,
            jumps,
        }
    }

    pub fn len(&self) -> usize {
        self.targets.len()
    }

    /// Index of the first omnibus cell; the library's directions come before.
    pub fn first_cell(&self) -> usize {
        self.cells
    }

    /// What a statistic is ranked among.
    pub fn group(&self, index: usize) -> Group {
        let is_share = |dense: &Dense| {
            dense.index == index && matches!(dense.score, Score::NoReturn | Score::Uniform | Score::Tail)
        };
        if index == self.mixed || index == self.depth || self.dense.iter().any(is_share) {
            return Group::Shares;
        }
        let is_wide = self.is_score(index) || (self.odometry..self.patterns + 4).contains(&index);
        let windows = self.first_object..self.first_object + self.object_windows.len();
        if index >= self.cells {
            Group::Cells
        } else if is_wide {
            Group::Wide
        } else if windows.contains(&index) && self.among_blocks[index - self.first_object] {
            Group::AmongBlocks
        } else {
            Group::Places
        }
    }

    /// How far a statistic at `z` standard deviations speaks for what it looks for: a share can't be negative.
    pub fn off(&self, index: usize, z: f64) -> f64 {
        match self.targets[index] {
            Target::Effect(kind, _) if is_one_sided(kind) => z,
            _ => z.abs(),
        }
    }

    pub(super) fn moves_scans(&self, index: usize) -> bool {
        matches!(self.targets[index], Target::Effect(E::MountYaw | E::MountOffset | E::TimeOffset, _))
    }

    /// Whether a statistic counts rare events.
    pub fn is_count(&self, index: usize) -> bool {
        self.counts[index]
    }

    /// Whether a statistic is the score of an effect's first number: its spread is the root of its information.
    pub fn is_score(&self, index: usize) -> bool {
        self.dense.iter().any(|dense| dense.index == index)
    }

    /// The omnibus cells of each beam: the index of the first of its statistics.
    pub fn cells_of_beams(&self) -> &[[u32; COVARIATES]] {
        &self.cell_of
    }
}

/// Whether an effect can act in one direction only.
fn is_one_sided(kind: EffectKind) -> bool {
    let strength = &kind.parameters()[0];
    strength.lo >= strength.neutral || matches!(kind, E::MissingObject | E::SectorOcclusion)
}
