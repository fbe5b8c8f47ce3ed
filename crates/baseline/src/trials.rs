//! The effects that are tried: of each kind some strengths, and for places and sectors those where readings point to one.

use std::collections::{BTreeMap, HashMap, HashSet};

use glam::DVec2;
use locsim_core::{Line, cell_at, median};
use locsim_gap::{GapError, OBJECT_CELL_M, WALL_CELL_M, values_along};
use locsim_world::effect::{
    Direction, Disc, Effect, EffectKind, JUMP_M, Moves, PLACE_REACH_M, Parameter, Statistic,
};
use rayon::prelude::*;

use super::given::Given;
use super::learnt::Learnt;
use super::pool::{Expected, Pool, REACH_M, Reading, World};

/// Strengths that are tried, in typical ones, to both sides where there are two: gains vary slowly with the strength, and the best
/// is fitted.
const FACTORS: [f64; 4] = [0.3, 1.0, 3.0, 9.0];
/// Probabilities that are tried.
const PROBABILITIES: [f64; 2] = [0.05, 0.4];
/// Steps of readings that are tried \[m\]: those of lasers, and coarser ones of drivers and of messages.
const STEPS_M: [f64; 9] = [0.005, 0.01, 0.02, 0.025, 0.05, 0.1, 0.2, 0.25, 0.5];
/// Bearings of which a sector is made, and the numbers of them that are tried.
const BEARINGS: usize = 24;
const SECTORS: [usize; 3] = [2, 4, 8];
/// A part of the robot is within this \[m\].
const ROBOT_M: f64 = 6.0;
/// An object is tried where at least this many readings, of at least this many scans, lie in front of the walls; and its radii \[m\].
const LEAST_OF_OBJECT: usize = 6;
const LEAST_SCANS_OF_OBJECT: usize = 3;
const RADII_M: [f64; 2] = [0.15, 0.3];
/// The most objects: those that most readings point to.
const MOST_OBJECTS: usize = 150;
/// A stretch of wall is tried where at least this many beams end.
const LEAST_OF_WALL: usize = 20;
/// The most panes and displaced walls: those where most beams end.
const MOST_WALLS: usize = 300;
/// Displacements of a wall \[m\], and shares that a pane lets through.
const DISPLACED_M: [f64; 4] = [-0.3, -0.1, 0.1, 0.3];
const LET_THROUGH: f64 = 0.5;

/// An effect with the readings that it changes.
pub(super) struct Trial {
    pub effect: Effect,
    /// Share of the windows of time that the effect falls on, if it comes in bursts.
    pub share: Option<f64>,
    /// Reading, by index, and what it is then.
    pub changed: Vec<(u32, Expected)>,
}

impl Trial {
    /// The readings that an effect changes beside the given ones; `among` limits them to those by index.
    pub fn new(
        pool: &Pool<'_>,
        given: &Given,
        effect: Effect,
        known: &[Expected],
        among: Option<&[u32]>,
    ) -> Result<Self, GapError> {
        let share = effect.bursts().map(|bursts| bursts.share).filter(|&share| share > 0.0 && share < 1.0);
        let acting = effect.bursts().filter(|_| share.is_some()).map_or_else(|| effect.clone(), |b| b.on);
        let effects = [&given.effects[..], std::slice::from_ref(&acting)].concat();
        let is_of_walls = given.effects.is_empty() && effect.kind.has_place();
        let is_object = given.effects.is_empty() && effect.kind.moves() == Moves::Objects;
        let mut changed = if is_object {
            of_object(pool, &effect, known)
        } else {
            let world = if is_of_walls { pool.world_of_walls(&effects)? } else { pool.world(&effects)? };
            let all = 0..pool.compared_for(effect.kind) as u32;
            match among {
                Some(among) => {
                    changed(pool, &world, known, among.iter().copied().filter(|i| all.contains(i)))
                }
                None => changed(pool, &world, known, all),
            }
        };
        given.keep_away(effect.kind, &mut changed);
        Ok(Self { effect, share, changed })
    }

    /// Gain of the effect on each stretch (nats), over what is expected without it: `log` is the log density of each reading then.
    /// Stretches that `is_used` doesn't hold for gain nothing.
    pub fn gains(&self, pool: &Pool<'_>, learnt: &Learnt, log: &[f64], is_used: &[bool]) -> Vec<f64> {
        let mut gains = vec![0.0; pool.stretches[1]];
        let mut window = (u32::MAX, 0_u32, 0.0);
        let add_burst = |gains: &mut Vec<f64>, (at, stretch, sum): (u32, u32, f64)| {
            if let Some(share) = self.share
                && at != u32::MAX
            {
                gains[stretch as usize] += (share * (sum.min(500.0).exp() - 1.0)).ln_1p();
            }
        };
        for (index, gain) in self.reading_gains(pool, learnt, log, is_used) {
            let reading = &pool.readings[index as usize];
            if self.share.is_none() {
                gains[reading.stretch as usize] += gain;
            } else if window.0 == reading.window {
                window.2 += gain;
            } else {
                add_burst(&mut gains, window);
                window = (reading.window, reading.stretch, gain);
            }
        }
        add_burst(&mut gains, window);
        gains
    }

    /// Probability that bursts last in each window of time by its readings, if the effect comes in bursts.
    pub fn burst_probabilities(
        &self,
        pool: &Pool<'_>,
        learnt: &Learnt,
        log: &[f64],
        is_used: &[bool],
    ) -> Option<HashMap<u32, f64>> {
        let share = self.share?;
        let mut sums: HashMap<u32, f64> = HashMap::new();
        for (index, gain) in self.reading_gains(pool, learnt, log, is_used) {
            *sums.entry(pool.readings[index as usize].window).or_default() += gain;
        }
        let logit = (share / (1.0 - share)).ln();
        Some(sums.into_iter().map(|(window, sum)| (window, 1.0 / (1.0 + (-logit - sum).exp()))).collect())
    }

    /// The readings that are changed, by index, with the gain of each (nats); of bursts, while they last.
    pub fn reading_gains<'t>(
        &'t self,
        pool: &'t Pool<'_>,
        learnt: &'t Learnt,
        log: &'t [f64],
        is_used: &'t [bool],
    ) -> impl Iterator<Item = (u32, f64)> + 't {
        let used =
            self.changed.iter().filter(|(index, _)| is_used[pool.readings[*index as usize].stretch as usize]);
        used.map(|(index, expected)| {
            let reading = &pool.readings[*index as usize];
            let gain = learnt.density(reading.stretch, expected, reading.z).ln() - log[*index as usize];
            (*index, gain)
        })
    }
}

/// The readings that a world changes, of some by index.
fn changed(
    pool: &Pool<'_>,
    world: &World,
    known: &[Expected],
    among: impl Iterator<Item = u32>,
) -> Vec<(u32, Expected)> {
    let one = |index: u32| {
        let expected = pool.expected(world, &pool.readings[index as usize]);
        (expected != known[index as usize]).then_some((index, expected))
    };
    among.filter_map(one).collect()
}

/// The readings of beams that meet an object.
pub(super) fn of_object(pool: &Pool<'_>, effect: &Effect, known: &[Expected]) -> Vec<(u32, Expected)> {
    let [x, y, radius_m] = [0, 1, 2].map(|i| effect.values[i]);
    let disc = Disc { center: DVec2::new(x, y), radius_m };
    let met = pool.readings.iter().enumerate().filter_map(|(index, reading)| {
        let (point, heading) = pool.point(reading);
        let laser = point - f64::from(reading.z) * heading;
        let before = f64::from(known[index].mean).min(pool.nominal.laser.max_range_m);
        let range = disc.first_hit(laser, heading, before)?;
        Some((index as u32, Expected { place: 0, mean: range as f32, ..known[index] }))
    });
    met.collect()
}

/// All effects that are tried beside the given ones. They depend on what was read, and not on which log read it.
pub(super) fn trials(
    pool: &Pool<'_>,
    given: &Given,
    known: &[Expected],
    without: &[EffectKind],
) -> Vec<Trial> {
    let mut list: Vec<(Effect, Option<Vec<u32>>)> = Vec::new();
    let of_readings = |kind: &EffectKind| {
        !kind.has_place() && !matches!(kind.moves(), Moves::Odometry | Moves::Clutter | Moves::Objects)
    };
    for kind in EffectKind::ALL.into_iter().filter(of_readings) {
        if kind == EffectKind::SectorOcclusion {
            list.extend(sectors(pool).into_iter().map(|effect| (effect, None)));
        } else {
            list.extend(strengths(kind).into_iter().map(|effect| (effect, None)));
        }
    }
    list.extend(objects(pool).into_iter().map(|effect| (effect, None)));
    for (place, among) in walls(pool) {
        let of_logs = [0, 1].map(|log| displacement(pool, &place, &among, log));
        let far = of_logs.into_iter().flatten().filter(|distance| distance.abs() > DISPLACED_M[2]);
        let displaced = DISPLACED_M.into_iter().chain(far).map(|distance| (EffectKind::MovedWall, distance));
        for (kind, value) in displaced.chain([(EffectKind::Glass, LET_THROUGH)]) {
            let mut effect = Effect::typical(kind, vec![place]);
            effect.values[0] = value;
            list.push((effect, Some(among.clone())));
        }
    }
    list.retain(|(effect, _)| !without.contains(&effect.kind));
    list.into_par_iter()
        // Effects that exclude each other can't be tried together.
        .filter_map(|(effect, among)| Trial::new(pool, given, effect, known, among.as_deref()).ok())
        .filter(|trial| !trial.changed.is_empty())
        .collect()
}

/// Effects of all beams: some strengths in each of the directions in which the search looks for the kind.
pub(super) fn strengths(kind: EffectKind) -> Vec<Effect> {
    let parameters = kind.parameters();
    if kind.is_stepped() {
        return STEPS_M.iter().filter_map(|&step| Effect::new(kind, vec![step], Vec::new()).ok()).collect();
    }
    let directions: Vec<Direction> = kind
        .description()
        .statistics
        .iter()
        .find_map(|statistic| match statistic {
            Statistic::Score { directions, .. } => Some(directions.to_vec()),
            _ => None,
        })
        .unwrap_or_else(|| vec![&[]]);
    let is_probability =
        |parameter: &Parameter| parameter.neutral == 0.0 && parameter.hi == 1.0 && parameter.unit == "1";
    let mut effects = Vec::new();
    for direction in directions {
        let typical = values_along(kind, direction);
        let mut add = |scale: &dyn Fn(usize, f64) -> f64| {
            let mut values = typical.clone();
            for i in kind.strengths() {
                let parameter = &parameters[i];
                values[i] = scale(i, values[i]).clamp(parameter.lo, parameter.hi);
            }
            effects.extend(Effect::new(kind, values, Vec::new()).ok());
        };
        if kind.strengths().all(|i| is_probability(&parameters[i])) {
            for p in PROBABILITIES {
                add(&|_, _| p);
            }
            continue;
        }
        for factor in FACTORS {
            for sign in if kind.is_one_sided() { &[1.0][..] } else { &[1.0, -1.0][..] } {
                add(&|i, value| {
                    let neutral = parameters[i].neutral;
                    neutral + sign * factor * (value - neutral)
                });
            }
        }
    }
    effects
}

/// Sectors in which readings of both logs come from about one range in front of the walls.
fn sectors(pool: &Pool<'_>) -> Vec<Effect> {
    const WIDTH_M: f64 = 0.1;
    let bearings = pool.logs[1].recorded.laser.bearings();
    let (first, last) = (f64::from(bearings[0]), f64::from(bearings[bearings.len() - 1]));
    let width = (last - first) / BEARINGS as f64;
    let bins = (ROBOT_M / WIDTH_M) as usize;
    let mut counts = vec![vec![0_u32; bins]; BEARINGS];
    for reading in pool.at_shared_places() {
        let z = f64::from(reading.z);
        if z < ROBOT_M && f64::from(reading.expected.mean) - z > JUMP_M {
            let at = (pool.beam(reading).view.bearing - first) / width;
            let bin = ((z / WIDTH_M) as usize).min(bins - 1);
            counts[(at as usize).min(BEARINGS - 1)][bin] += 1;
        }
    }
    let mut effects = Vec::new();
    for size in SECTORS {
        for from in (0..=BEARINGS - size).step_by(size / 2) {
            let sum =
                |bin: usize| counts[from..from + size].iter().map(|of_bearing| of_bearing[bin]).sum::<u32>();
            let Some(bin) = (0..bins).max_by_key(|&bin| sum(bin)) else { continue };
            let from_rad = first + from as f64 * width;
            let range_m = (bin as f64 + 0.5) * WIDTH_M;
            for p in PROBABILITIES {
                let values = vec![from_rad, from_rad + size as f64 * width, range_m, p];
                effects.extend(Effect::new(EffectKind::SectorOcclusion, values, Vec::new()).ok());
            }
        }
    }
    effects
}

/// A reading in front of the wall: the middle of an object there \[m\], log and scan.
struct InFront {
    middle: DVec2,
    scan: [usize; 2],
}

/// Discs where readings of several scans lie in front of the walls.
fn objects(pool: &Pool<'_>) -> Vec<Effect> {
    let mut cells: BTreeMap<[i32; 2], Vec<InFront>> = BTreeMap::new();
    for reading in &pool.readings {
        if f64::from(reading.expected.mean) - f64::from(reading.z) > JUMP_M {
            let (point, heading) = pool.point(reading);
            let per_scan = pool.logs[reading.log].views.per_scan;
            // The middle of an object is behind its face.
            let middle = point + RADII_M[0] * heading;
            let scan = [reading.log, reading.index / per_scan];
            cells.entry(cell_at(middle, OBJECT_CELL_M)).or_default().push(InFront { middle, scan });
        }
    }
    let mut found: Vec<(usize, DVec2)> = cells
        .into_values()
        .filter(|points| {
            let scans: HashSet<_> = points.iter().map(|point| point.scan).collect();
            points.len() >= LEAST_OF_OBJECT && scans.len() >= LEAST_SCANS_OF_OBJECT
        })
        .map(|points| {
            (points.len(), points.iter().map(|point| point.middle).sum::<DVec2>() / points.len() as f64)
        })
        .collect();
    found.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    found.truncate(MOST_OBJECTS);
    let discs =
        found.into_iter().flat_map(|(_, middle)| RADII_M.map(|radius| vec![middle.x, middle.y, radius]));
    discs.filter_map(|values| Effect::new(EffectKind::MissingObject, values, Vec::new()).ok()).collect()
}

/// Stretches of wall, with the readings of beams that end there, most of which come from the right. Walls that meet in a cell are stretches of
/// their own.
pub(super) fn walls(pool: &Pool<'_>) -> Vec<([DVec2; 2], Vec<u32>)> {
    let mut cells: BTreeMap<[i32; 2], Vec<u32>> = BTreeMap::new();
    for (index, reading) in pool.readings.iter().enumerate() {
        let is_of_wall = !pool.logs[reading.log].views.is_unsure(reading.index);
        if reading.expected.mean.is_finite() && is_of_wall {
            let end = pool.beam(reading).view.endpoint;
            cells.entry(cell_at(end, WALL_CELL_M)).or_default().push(index as u32);
        }
    }
    let view = |index: u32| pool.beam(&pool.readings[index as usize]).view;
    let mut stretches = Vec::new();
    for mut left in cells.into_values() {
        while left.len() >= LEAST_OF_WALL {
            let Some([a, b]) = line_through(&left.iter().map(|&i| view(i).endpoint).collect::<Vec<_>>())
            else {
                break;
            };
            let line = line_of(&[a, b]);
            let is_on = |&i: &u32| line.distance(view(i).endpoint) < PLACE_REACH_M;
            let (on, others): (Vec<u32>, Vec<u32>) = left.into_iter().partition(is_on);
            if on.len() < LEAST_OF_WALL {
                break;
            }
            let from_right: f64 = on.iter().map(|&i| line.away(view(i).direction)).sum();
            stretches.push((if from_right < 0.0 { [b, a] } else { [a, b] }, on));
            left = others;
        }
    }
    // Those that both logs have seen come first.
    let shared = pool.at_shared_places().len() as u32;
    let seen = |among: &[u32]| (among.iter().filter(|&&index| index < shared).count(), among.len());
    stretches.sort_by_key(|(_, among)| std::cmp::Reverse(seen(among)));
    stretches.truncate(MOST_WALLS);
    stretches
}

fn line_of([a, b]: &[DVec2; 2]) -> Line {
    Line { point: *a, along: (b - a).normalize() }
}

/// By how much most readings of a log at a stretch are to the left of the wall \[m\]. Readings of a wall that is far from a trial are no likelier
/// by it.
fn displacement(pool: &Pool<'_>, place: &[DVec2; 2], among: &[u32], log: usize) -> Option<f64> {
    let max = pool.nominal.laser.max_range_m as f32;
    let readings = among.iter().map(|&index| &pool.readings[index as usize]);
    let own = readings.filter(|reading| reading.log == log && reading.z < max);
    let mut errors: Vec<f64> = own
        .map(|reading| {
            let view = pool.beam(reading).view;
            let behind = f64::from(reading.z - reading.expected.mean) * view.incidence.cos();
            line_of(place).away(view.direction) * behind
        })
        .filter(|error| error.abs() < REACH_M)
        .collect();
    (errors.len() >= LEAST_OF_WALL / 2).then(|| median(&mut errors))
}

/// The segment along most of some points: that of two of them with most others near it.
fn line_through(points: &[DVec2]) -> Option<[DVec2; 2]> {
    let step = (points.len() / 12).max(1);
    let some: Vec<DVec2> = points.iter().copied().step_by(step).collect();
    let near = |a: DVec2, along: DVec2, point: &DVec2| along.perp_dot(*point - a).abs() < PLACE_REACH_M;
    let mut best: Option<(usize, DVec2, DVec2)> = None;
    for (i, &a) in some.iter().enumerate() {
        for &b in &some[..i] {
            let along = (b - a).normalize_or_zero();
            if a.distance(b) < OBJECT_CELL_M || along == DVec2::ZERO {
                continue;
            }
            let count = points.iter().filter(|point| near(a, along, point)).count();
            if best.is_none_or(|(most, ..)| count > most) {
                best = Some((count, a, along));
            }
        }
    }
    let (_, a, along) = best?;
    let on = points.iter().filter(|point| near(a, along, point)).map(|point| along.dot(*point - a));
    let (lo, hi) = on.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), t| (lo.min(t), hi.max(t)));
    (hi - lo > OBJECT_CELL_M).then(|| [a + lo * along, a + hi * along])
}

/// The reading's usual world.
pub(super) fn usual(pool: &Pool<'_>) -> Vec<Expected> {
    pool.readings.iter().map(|reading: &Reading| reading.expected).collect()
}
