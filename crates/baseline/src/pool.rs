//! The readings of both logs at the places that both have seen, and what a reading is expected to be.

use locsim_core::cell_at;
use std::collections::HashMap;
use std::sync::Arc;

use glam::DVec2;
use locsim_gap::{GapError, Nominal, Recorded, Views};
use locsim_world::effect::{Alternative, Effect, EffectKind, Effects, HitKind, Statistic, burst_window};
use locsim_world::simulation::ClutteredBeam as Beam;

/// Side of the cells of the map in which beams end \[m\]. Walls of a measured map are off by nearly the same within one.
const PLACE_M: f64 = 1.0;
/// Walls at round numbers aren't at the borders of cells \[m\].
const BORDER_M: f64 = 0.17;
/// Borders of the classes of incidence \[rad\]: 45 and 65 degrees. Slanted walls lose returns, and errors of the map grow by
/// 1 / cos there.
const SLANTED_RAD: [f64; 2] = [0.785, 1.134];
/// The classes of a place: three of incidence, and beams that end nowhere.
pub(super) const CLASSES: usize = SLANTED_RAD.len() + 2;
/// Errors up to this are of the surface that a beam meets \[m\]; other readings are in front of it or behind.
pub(super) const REACH_M: f64 = 1.0;
/// A place is compared that each log has seen so often.
const LEAST_READINGS: usize = 4;
/// Stretches into which a log is cut, and those of it that the other log has seen, about.
const STRETCHES: usize = 16;
/// The fewest scans of a stretch, and of one that the other log has seen: scans nearer to each other err alike.
const LEAST_SCANS: usize = 10;
const LEAST_SEEN_SCANS: usize = 5;

/// The expected reading of a beam, relative to the baseline's distribution at its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Expected {
    /// Where the beam ends.
    pub place: u32,
    /// Mean of the return \[m\], infinite where nothing is met.
    pub mean: f32,
    /// Standard deviation beyond that of the baseline's readings \[m\].
    pub widened: f32,
    /// Probability of a tail beyond the baseline's, and its standard deviation \[m\].
    pub tail: [f32; 2],
    /// Probability that nothing else is read instead.
    pub kept: f32,
    /// Density of what is read instead, at the reading \[1/m\], a probability at the maximum range.
    pub added: f32,
    /// Probabilities of what is read instead: in front of the return, and about as far; the rest is behind or lost.
    pub added_before: [f32; 2],
    /// Step of the readings beyond the laser's own \[m\], or 0.
    pub step: f32,
}

/// A usable reading of one of the logs.
pub(super) struct Reading {
    /// 0 for the baseline, 1 for today's log.
    pub log: usize,
    /// Its beam in that log.
    pub index: usize,
    /// Index of its stretch, among those of both logs.
    pub stretch: u32,
    /// Index of its window of bursts.
    pub window: u32,
    /// The reading, at most the maximum range \[m\].
    pub z: f32,
    /// The expected reading by the scenario.
    pub expected: Expected,
}

/// A world that both logs are seen in.
#[derive(Clone)]
pub(super) struct World {
    effects: Effects,
    views: [Arc<Views>; 2],
}

/// A log with its beams, cast into the map.
pub(super) struct CastLog<'a> {
    pub recorded: &'a Recorded,
    pub views: Arc<Views>,
}

impl<'a> CastLog<'a> {
    fn new(nominal: &Nominal, recorded: &'a Recorded) -> Result<Self, GapError> {
        Ok(Self { recorded, views: Arc::new(Views::new(nominal, recorded, &nominal.effects)?) })
    }

    fn views_with(&self, nominal: &Nominal, effects: &Effects) -> Result<Arc<Views>, GapError> {
        if self.views.are_of(effects) {
            Ok(Arc::clone(&self.views))
        } else {
            Ok(Arc::new(self.views.with(nominal, self.recorded, effects)?))
        }
    }
}

/// Both logs.
pub(super) struct Pool<'a> {
    pub nominal: &'a Nominal,
    pub logs: [CastLog<'a>; 2],
    pub plain: World,
    /// Beams with what is behind the first surface.
    behind: [Arc<Views>; 2],
    /// The readings at places that both logs have seen, and then all others, which tell of objects and lost returns alone.
    pub readings: Vec<Reading>,
    /// Number of readings at places that both have seen.
    shared_readings: usize,
    /// Number of places, the classes first: those stand for places that the baseline didn't see.
    pub places: usize,
    pub class_of: Vec<u8>,
    index: HashMap<([i32; 2], u8), u32>,
    /// The stretch of each scan in each log.
    stretch_of: [Vec<u32>; 2],
    /// Stretches of the baseline, and of both.
    pub stretches: [usize; 2],
    /// Share of today's readings at places that the baseline has seen.
    pub shared: f64,
}

impl<'a> Pool<'a> {
    pub fn new(nominal: &'a Nominal, baseline: &'a Recorded, today: &'a Recorded) -> Result<Self, GapError> {
        let logs = [CastLog::new(nominal, baseline)?, CastLog::new(nominal, today)?];
        let far = vec![[DVec2::splat(1e5), DVec2::splat(1e5 + 1.0)]];
        let pane = nominal.effects_with(&[Effect::typical(EffectKind::Glass, far)])?;
        let mut pool = Self {
            nominal,
            behind: [logs[0].views_with(nominal, &pane)?, logs[1].views_with(nominal, &pane)?],
            plain: World {
                effects: nominal.effects.clone(),
                views: logs.each_ref().map(|log| Arc::clone(&log.views)),
            },
            logs,
            readings: Vec::new(),
            shared_readings: 0,
            places: CLASSES,
            class_of: (0..CLASSES as u8).collect(),
            index: HashMap::new(),
            stretch_of: [Vec::new(), Vec::new()],
            stretches: [0; 2],
            shared: 0.0,
        };
        pool.find_places();
        pool.cut();
        pool.read();
        Ok(pool)
    }

    fn cut(&mut self) {
        let mut count = 0;
        for log in 0..2 {
            let first = count;
            let seen = self.shared_by_scan(log);
            self.stretch_of[log] = cut(&seen).into_iter().map(|stretch| first + stretch).collect();
            count = self.stretch_of[log].last().map_or(first, |last| last + 1);
            self.stretches[log] = count as usize;
        }
    }

    /// How many readings each scan has at places that both logs have seen.
    fn shared_by_scan(&self, log: usize) -> Vec<usize> {
        let views = &self.logs[log].views;
        let is_shared = |(i, beam): (usize, &Beam)| {
            self.reading(log, i).is_some() && self.index.contains_key(&self.key(beam))
        };
        let scans = views.beams.chunks(views.per_scan).enumerate();
        scans
            .map(|(scan, beams)| {
                let first = scan * views.per_scan;
                beams.iter().enumerate().filter(|&(i, beam)| is_shared((first + i, beam))).count()
            })
            .collect()
    }

    /// The stretch of a scan.
    pub fn stretch(&self, log: usize, scan: usize) -> u32 {
        self.stretch_of[log][scan]
    }

    /// The places that both logs have seen often enough.
    fn find_places(&mut self) {
        let mut seen: HashMap<([i32; 2], u8), [usize; 2]> = HashMap::new();
        for (log, cast) in self.logs.iter().enumerate() {
            for (i, beam) in cast.views.beams.iter().enumerate() {
                if self.reading(log, i).is_some() {
                    seen.entry(self.key(beam)).or_default()[log] += 1;
                }
            }
        }
        let mut keys: Vec<_> =
            seen.into_iter().filter(|(_, counts)| counts.iter().all(|&n| n >= LEAST_READINGS)).collect();
        keys.sort_unstable();
        for (key, _) in keys {
            self.index.insert(key, self.places as u32);
            self.class_of.push(key.1);
            self.places += 1;
        }
    }

    fn read(&mut self) {
        let mut readings = [Vec::new(), Vec::new()];
        let mut windows = 0_u32;
        let mut window = None;
        for log in 0..2 {
            let Recorded { track, .. } = self.logs[log].recorded;
            let per_scan = self.logs[log].views.per_scan;
            for (i, beam) in self.logs[log].views.beams.iter().enumerate() {
                let Some(z) = self.reading(log, i) else { continue };
                let here = Some((log, burst_window(track.secs()[i / per_scan])));
                if window != here {
                    (window, windows) = (here, windows + 1);
                }
                let is_shared = self.index.contains_key(&self.key(beam));
                readings[usize::from(!is_shared)].push(Reading {
                    log,
                    index: i,
                    stretch: self.stretch(log, i / per_scan),
                    window: windows,
                    z: z as f32,
                    expected: self.expect(&self.plain, beam, z),
                });
            }
        }
        let of_today = |readings: &[Reading]| readings.iter().filter(|reading| reading.log == 1).count();
        let [shared, others] = readings.each_ref().map(|readings| of_today(readings));
        self.shared = shared as f64 / f64::from((shared + others).max(1) as u32);
        let [mut shared, others] = readings;
        self.shared_readings = shared.len();
        shared.extend(others);
        self.readings = shared;
    }

    /// The readings at places that both logs have seen.
    pub fn at_shared_places(&self) -> &[Reading] {
        &self.readings[..self.shared_readings]
    }

    /// How many readings an effect is held against: whether a beam meets an object or comes back at all doesn't ask how far off the
    /// map is where it ends.
    pub fn compared_for(&self, kind: EffectKind) -> usize {
        if is_of_outcomes(kind) { self.readings.len() } else { self.shared_readings }
    }

    /// A usable reading \[m\].
    fn reading(&self, log: usize, index: usize) -> Option<f64> {
        let z = f64::from(self.logs[log].recorded.readings[index]);
        let max = self.nominal.laser.max_range_m;
        (z >= self.nominal.laser.min_range_m).then_some(z.min(max))
    }

    /// The cell and the class of where a beam ends.
    fn key(&self, beam: &Beam) -> ([i32; 2], u8) {
        if beam.range() >= self.nominal.laser.max_range_m {
            return ([0, 0], CLASSES as u8 - 1);
        }
        let class = SLANTED_RAD.iter().filter(|&&border| beam.view.incidence > border).count() as u8;
        (cell_at(beam.view.endpoint + BORDER_M, PLACE_M), class)
    }

    /// A world with these effects beside the scenario's.
    pub fn world(&self, effects: &[Effect]) -> Result<World, GapError> {
        let effects = self.nominal.effects_with(effects)?;
        let [first, second] = self.logs.each_ref().map(|log| log.views_with(self.nominal, &effects));
        let views = [first?, second?];
        Ok(World { effects, views })
    }

    /// The same where beams end as by the scenario, with what is behind.
    pub fn world_of_walls(&self, effects: &[Effect]) -> Result<World, GapError> {
        Ok(World { effects: self.nominal.effects_with(effects)?, views: self.behind.clone() })
    }

    /// The expected reading in a world.
    pub fn expected(&self, world: &World, reading: &Reading) -> Expected {
        let beam = &world.views[reading.log].beams[reading.index];
        self.expect(world, beam, f64::from(reading.z))
    }

    fn expect(&self, world: &World, beam: &Beam, z: f64) -> Expected {
        let (laser, view) = (&self.nominal.laser, &beam.view);
        let plain = self.nominal.effects.reading(laser, view, HitKind::Wall, beam.range());
        let key = self.key(beam);
        let mut expected = Expected {
            place: self.index.get(&key).copied().unwrap_or(u32::from(key.1)),
            mean: plain.mean as f32,
            widened: 0.0,
            tail: [0.0; 2],
            kept: 1.0,
            added: 0.0,
            added_before: [0.0; 2],
            step: 0.0,
        };
        if world.effects.list().len() == self.nominal.effects.list().len() {
            return expected;
        }
        let with = world.effects.reading(laser, view, HitKind::Wall, beam.range());
        expected.mean = with.mean as f32;
        expected.widened = (with.sigma.powi(2) - plain.sigma.powi(2)).max(0.0).sqrt() as f32;
        if with.tail[0] != plain.tail[0] {
            expected.tail = [with.tail[0], with.tail[1] * with.sigma].map(|number| number as f32);
        }
        if with.step_m > plain.step_m {
            expected.step = with.step_m as f32;
        }
        let mut known = plain.alternatives.as_slice().iter().peekable();
        for alternative in with.alternatives.as_slice() {
            if known.next_if(|known| *known == alternative).is_some() {
                continue;
            }
            let (p, alternative) = *alternative;
            let density = alternative.density(z, laser.max_range_m);
            let pane = if is_pane(world, alternative) { 0.5 } else { 1.0 };
            for (sum, share) in expected.added_before.iter_mut().zip(before(alternative, with.mean)) {
                *sum += expected.kept * (p * pane * share) as f32;
            }
            expected.added += expected.kept * (p * self.or_lost(world, alternative, density, z)) as f32;
            expected.kept *= 1.0 - p as f32;
        }
        expected
    }

    /// The density of a beam that a pane lets through. The map often lacks the surface behind, and then it is lost.
    fn or_lost(&self, world: &World, alternative: Alternative, density: f64, z: f64) -> f64 {
        if is_pane(world, alternative) {
            0.5 * density + if z >= self.nominal.laser.max_range_m { 0.5 } else { 0.0 }
        } else {
            density
        }
    }

    /// Where a reading lies in the map \[m\], and the direction of its beam.
    pub fn point(&self, reading: &Reading) -> (DVec2, DVec2) {
        let view = &self.beam(reading).view;
        (view.point_at(f64::from(reading.z)), view.direction)
    }

    /// The widest angle between neighbouring beams of today's log \[rad\].
    pub fn beam_spacing_rad(&self) -> f64 {
        let bearings = self.logs[1].recorded.laser.bearings();
        bearings.windows(2).map(|pair| f64::from(pair[1] - pair[0]).abs()).fold(0.0, f64::max)
    }

    /// The beam of a reading by the scenario.
    pub fn beam(&self, reading: &Reading) -> &Beam {
        &self.logs[reading.log].views.beams[reading.index]
    }
}

/// The stretch of each scan, by how many readings it has at places that the other log has seen, too. Where few scans have any, these are cut
/// finer: what decides are the stretches that can be compared. A last one that isn't full goes with the one before.
fn cut(seen: &[usize]) -> Vec<u32> {
    let scans = (seen.len() / STRETCHES).max(LEAST_SCANS);
    let readings = seen.iter().sum::<usize>().div_ceil((seen.len() / scans).max(1)).max(1);
    let mut stretches = Vec::with_capacity(seen.len());
    let (mut stretch, mut from, mut sum) = (0_u32, 0, 0);
    for (scan, &count) in seen.iter().enumerate() {
        stretches.push(stretch);
        sum += count;
        let length = scan + 1 - from;
        if length >= scans || length >= LEAST_SEEN_SCANS && sum >= readings {
            (stretch, from, sum) = (stretch + 1, scan + 1, 0);
        }
    }
    if from < seen.len() && stretch > 0 {
        stretches[from..].fill(stretch - 1);
    }
    stretches
}

/// Whether an effect changes what a beam meets at one place, and not how far that is.
pub(super) fn is_of_outcomes(kind: EffectKind) -> bool {
    let statistics = kind.description().statistics;
    statistics.iter().any(|statistic| matches!(statistic, Statistic::Object | Statistic::WallLoss))
}

/// Whether a reading is of what is behind a pane.
fn is_pane(world: &World, alternative: Alternative) -> bool {
    matches!(alternative, Alternative::Near { .. })
        && world.effects.list().last().is_some_and(|effect| effect.kind.lets_beams_through())
}

/// Shares of an alternative in front of a return, and within the reach of its errors.
fn before(alternative: Alternative, mean: f64) -> [f64; 2] {
    let below = |border: f64| match alternative {
        Alternative::NoReturn => 0.0,
        Alternative::Near { mean, .. } => f64::from(u8::from(mean < border)),
        Alternative::Between { lo, hi } => ((border - lo) / (hi - lo)).clamp(0.0, 1.0),
    };
    let front = below(mean - REACH_M);
    [front, below(mean + REACH_M) - front]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lengths(seen: &[usize]) -> Vec<usize> {
        cut(seen).chunk_by(|a, b| a == b).map(<[u32]>::len).collect()
    }

    /// Of 220 scans that see the same, stretches have 13 but for the rest, which goes with the last. Where 60 are seen, these make twelve instead
    /// of five; the others stay as they are.
    #[test]
    fn stretches_that_the_other_log_has_seen_are_finer() {
        assert_eq!(lengths(&[50; 220]), [vec![13; 15], vec![25]].concat());
        let few: Vec<usize> = (0..220).map(|scan| if scan < 60 { 70 } else { 0 }).collect();
        let all = lengths(&few);
        assert_eq!(all[..12], [5; 12]);
        assert!(all[12..all.len() - 1].iter().all(|&length| length == 13), "{all:?}");
        assert_eq!(all.iter().sum::<usize>(), 220);
        // A short log that the other has seen all of is in stretches of ten.
        assert_eq!(
            (lengths(&[0; 8]), lengths(&[3; 12]), lengths(&[3; 40])),
            (vec![8], vec![12], vec![10; 4])
        );
        assert!(cut(&[]).is_empty());
    }
}
