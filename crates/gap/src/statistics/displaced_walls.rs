//! Walls that stand elsewhere: most of a wall's readings at one distance before or behind it.
//!
//! The score of a wall's displacement sees a wall that has moved by less than a few standard deviations. Readings of one that has
//! moved farther look like clutter, reading by reading, and the likelihood takes any number of them for it. But clutter that stays
//! hides a few readings of many, and a wall that has moved lacks nearly all. So it is the share that is looked at, and the
//! replicates say what shares clutter makes.

use std::ops::RangeInclusive;

use glam::DVec2;
use locsim_comparison::kinds_shown_by;
use locsim_core::{Line, SlantedStretch, sorted};
use locsim_world::effect::{self, EffectKind};

use super::readings::Reading;
use super::survey::Survey;
use super::wall_cells::WallCells;
use super::walls::{
    MOST_STRETCHES, NEAR_LINE_M, ON_LINE_M, STRETCH_GAP_M, STRETCH_LEAST_M, STRETCH_REACH_M, lines_off,
    of_one_and_both_faces, wall_guesses,
};
use super::{Family, Form, Found, Group, Halves, Readings, Start, Statistic};

/// Width of the windows of displacement, and the largest one \[m\]: farther before a wall stand things of their own.
const WINDOW_M: f64 = 0.04;
pub(super) const FARTHEST_M: f64 = 0.5;
/// Windows overlap by half, so that readings at the border of one are in the middle of another.
const WINDOWS: usize = (4.0 * FARTHEST_M / WINDOW_M) as usize - 1;
/// The share of a displaced wall's readings that may be of anything else.
const OTHERS: f64 = 0.1;

/// Slopes at which a wall is turned: less is a parallel wall as well as can be told from here, more is another wall.
const TURNS: RangeInclusive<f64> = 0.003..=0.36;

/// A share of readings that says nothing: one of a hundred.
const FEW: f64 = 0.01;

/// The displacement in the middle of a window \[m\].
fn middle(window: usize) -> f64 {
    0.5 * WINDOW_M * (window as f64 + 1.0) - FARTHEST_M
}

/// The windows that a displacement is in.
fn windows_of(displacement: f64) -> impl Iterator<Item = usize> {
    let half = ((displacement + FARTHEST_M) / (0.5 * WINDOW_M)).floor();
    [half - 1.0, half].into_iter().filter(|at| (0.0..WINDOWS as f64).contains(at)).map(|at| at as usize)
}

/// Where a reading is from its wall, along the wall's normal \[m\]; `None` of a reading of the wall where it is mapped, and of none.
pub(super) fn displacement(reading: &Reading<'_>) -> Option<f64> {
    (reading.is_in_front || reading.is_behind)
        .then(|| (reading.z - reading.beam.range() - reading.shift) * reading.beam.view.incidence.cos())
}

/// The shares of the readings of walls that lie together elsewhere.
pub(super) struct DisplacedWalls {
    kind: EffectKind,
    walls: WallCells,
    /// Whether readings behind the wall count alone: clutter that stays is never there.
    is_of_behind: bool,
}

impl DisplacedWalls {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        let of = |kind| {
            [false, true].map(|is_of_behind| Self { kind, walls: survey.walls().clone(), is_of_behind })
        };
        kinds_shown_by(|statistic| matches!(statistic, effect::Statistic::WallShift)).flat_map(of).collect()
    }
}

/// Readings of a cell in each window, and all, in both halves of a log.
#[derive(Clone)]
struct Counts {
    windows: [[f64; 2]; WINDOWS],
    all: [f64; 2],
}

impl Counts {
    const NONE: Self = Self { windows: [[0.0; 2]; WINDOWS], all: [0.0; 2] };

    fn plus(&self, other: &Self) -> Self {
        let mut sum = self.clone();
        let all = other.windows.iter().chain([&other.all]);
        for (sum, more) in sum.windows.iter_mut().chain([&mut sum.all]).zip(all) {
            sum.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
        sum
    }

    /// Minus the logarithm of the share of readings that aren't in the fullest window: a share near 1 stands out from any
    /// below a half. A reading more, of the wall where it is, keeps it finite.
    fn value(&self) -> Halves {
        std::array::from_fn(|half| {
            let most = self.windows.iter().map(|window| window[half]).fold(0.0, f64::max);
            -(-most / (self.all[half] + 1.0)).ln_1p()
        })
    }
}

impl Family for DisplacedWalls {
    fn statistics(&self) -> Vec<Statistic> {
        let counts = self.walls.counts();
        let of_pairs = self.walls.pairs().iter().map(|&[a, b]| counts[a] + counts[b]);
        // A half of the log has half of them.
        let by_one = |count: f64| -(-1.0 / (0.5 * count + 1.0)).ln_1p();
        let of = |count: f64| {
            let group = if self.is_of_behind { Group::Places } else { Group::DisplacedWalls };
            Statistic::of_effect(self.kind, group, Form::Share).with_one_reading(by_one(count).max(FEW))
        };
        counts.iter().copied().chain(of_pairs).map(of).collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let mut cells = vec![Counts::NONE; self.walls.len()];
        for reading in &log.all {
            let Some(cell) = self.walls.of_beam(reading.index) else { continue };
            cells[cell].all[reading.half] += 1.0;
            let counted = displacement(reading).filter(|_| reading.is_behind || !self.is_of_behind);
            for window in counted.map(|by| reading.side() * by).into_iter().flat_map(windows_of) {
                cells[cell].windows[window][reading.half] += 1.0;
            }
        }
        let pairs = self.walls.pairs().iter().map(|&[a, b]| cells[a].plus(&cells[b]).value());
        cells.iter().map(Counts::value).chain(pairs).collect()
    }

    fn first_guesses(&self, log: &Readings<'_>, found: &[Found<'_>]) -> Vec<Start> {
        let evidence = |reading: &Reading<'_>, away: f64| {
            // Without a return, or with one of what hides wall and displaced wall alike, a reading says nothing.
            if !reading.is_return {
                return [0.0; WINDOWS];
            }
            let mut gains = [OTHERS.ln(); WINDOWS];
            for window in displacement(reading).map(|by| away * by).into_iter().flat_map(windows_of) {
                let density = reading.beam.view.incidence.cos() / WINDOW_M;
                gains[window] = (OTHERS + (1.0 - OTHERS) * density / reading.terms.density).ln();
            }
            gains
        };
        let mut starts = wall_guesses(self.kind, &self.walls, log, found, evidence, |gains, _| {
            let gains = gains.into_iter().enumerate().map(|(window, gain)| (gain, middle(window)));
            gains.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0.0))
        });
        let turned = lines_off(&self.walls, log, found).take(MOST_STRETCHES).filter_map(|(_, lines)| {
            lines.into_iter().filter_map(|line| turned(log, line)).max_by_key(|(count, _)| *count)
        });
        starts.extend(turned.flat_map(|(_, start)| of_one_and_both_faces(log, start)));
        starts
    }
}

/// Where most displaced readings of a wall lie on a line of their own, with how many do. It goes on to where it meets the wall: near there,
/// readings aren't displaced.
pub(super) fn turned(log: &Readings<'_>, wall: Line) -> Option<(usize, Start)> {
    let along = |reading: &Reading<'_>| {
        let end = reading.beam.view.endpoint;
        let s = wall.along.dot(end - wall.point);
        (wall.distance(end) <= NEAR_LINE_M && s.abs() <= STRETCH_REACH_M).then_some(s)
    };
    let all = sorted(log.all.iter().filter_map(along));
    let displaced = log.all.iter().filter(|reading| reading.is_return).filter_map(|reading| {
        let by = displacement(reading).filter(|by| by.abs() <= 2.0 * FARTHEST_M)?;
        Some(DVec2::new(along(reading)?, wall.away(reading.beam.view.direction) * by))
    });
    let found = SlantedStretch::through(displaced.collect(), &all, ON_LINE_M, STRETCH_GAP_M, TURNS)?;
    let [from, to] = found.ends;
    let place = vec![[from, to].map(|s| wall.point + s * wall.along)];
    let start = Start { values: vec![found.middle, found.slope.atan()], place };
    (to - from >= STRETCH_LEAST_M).then_some((found.count, start))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;

    use locsim_comparison::fixtures::{NOMINAL, SEED, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nominal, Nuisances};
    use locsim_world::effect::Effect;
    use locsim_world::map::{Polyline, VectorMap};
    use locsim_world::raycast::ExactRangeMap;
    use locsim_world::simulation::{Robot, RobotPath, simulate_drive};

    use super::*;
    use crate::Recorded;
    use crate::search::{GapOptions, find};
    use crate::statistics::pit_draw;

    #[test]
    fn each_displacement_is_in_two_windows() {
        for displacement in [-0.47, -0.061, 0.0, 0.06, 0.333] {
            let windows: Vec<usize> = windows_of(displacement).collect();
            assert_eq!(windows.len(), 2);
            assert!(windows.into_iter().all(|at| (middle(at) - displacement).abs() <= 0.5 * WINDOW_M + 1e-9));
        }
        assert_eq!(windows_of(0.6).count() + windows_of(-0.6).count(), 0);
    }

    /// A wall of 5 m that is turned by 2 degrees about its end.
    fn with_a_turned_wall() -> (Recorded, f64) {
        let stretch = vec![[DVec2::new(0.5, 4.0), DVec2::new(5.5, 4.0)]];
        let turn = 2f64.to_radians();
        let turned = Effect::new(EffectKind::MovedWall, vec![-2.5 * turn.tan(), turn], stretch).unwrap();
        let drive = record_library(&NOMINAL, &TRUTH, &[turned], Regime::default(), 3).unwrap();
        (Recorded::new(&drive, 300, 72, |_| true).unwrap(), turn)
    }

    #[test]
    fn a_fit_starts_from_the_slanted_line_of_a_turned_wall() {
        let (recorded, turn) = with_a_turned_wall();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(5));
        let (_, start) = turned(&log, Line { point: DVec2::new(3.0, 4.0), along: DVec2::X }).unwrap();
        let [a, b] = start.place[0];
        assert!(a.distance(b) > 4.0 && (start.values[1] - turn).abs() < 0.1 * turn, "{start:?}");
    }

    #[test]
    fn a_turned_wall_is_named_over_its_length_with_its_turn() {
        let (recorded, turn) = with_a_turned_wall();
        let options = GapOptions { replicates: 99, seed: 5, ..GapOptions::default() };
        let outcome = find(&NOMINAL, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
        let [named] = &outcome.effects[..] else { panic!("{:?}", outcome.effects) };
        let [a, b] = named.place[0].map(DVec2::from);
        assert!(named.name == EffectKind::MovedWall && a.distance(b) > 4.0, "{named:?}");
        let found = named.params["turn_rad"].estimate;
        assert!((found.value.abs() - turn).abs() < 0.003 && found.interval.half() < 0.003, "{named:?}");
    }

    /// A wall that has moved by 15 cm, to where clutter can stand for all of a drive and does.
    #[test]
    fn a_wall_that_moved_is_named_among_clutter_that_stays() {
        let stretch = vec![[DVec2::new(0.5, 4.0), DVec2::new(5.5, 4.0)]];
        let moved = Effect::new(EffectKind::MovedWall, vec![-0.15, 0.0], stretch).unwrap();
        let regime = Regime { persistent_blocks: true, pose_error: None };
        let drive = record_library(&NOMINAL, &TRUTH, &[moved], regime, 3).unwrap();
        let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 99, seed: 5, ..GapOptions::default() };
        let outcome = find(&NOMINAL, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
        let first = outcome.effects.first().expect("something is named");
        assert_eq!(first.name, EffectKind::MovedWall, "{:?} {:?}", outcome.rivals, outcome.detection);
        let distance = first.params["distance_m"].estimate.value;
        assert!((distance + 0.15).abs() < 0.005, "{distance}");
    }

    /// A thin partition that has moved is nearer for a robot on one side and farther for one on the other. Clutter that stays could be before it, and
    /// never behind.
    #[test]
    fn a_partition_that_moved_is_named_from_both_sides() {
        let path = RobotPath::Waypoints {
            points_m: vec![[3.0, 1.6], [4.2, 1.5], [4.2, 2.8], [5.6, 2.8], [5.5, 0.6], [4.2, 0.5]],
            speed_m_s: 0.4,
            turn_rate_rad_s: 0.8,
        };
        let robot = Robot { path, start_jitter_m: 0.0, odometry_noise: NOMINAL.odometry };
        let simulator = Regime::default().simulator(&NOMINAL, &NOMINAL.effects).unwrap();
        let around = simulate_drive(&simulator, &robot, SEED).unwrap().drive.reference().unwrap();
        let screen = vec![[DVec2::new(5.0, 1.0), DVec2::new(5.0, 2.0)]];
        let moved = Effect::new(EffectKind::MovedWall, vec![0.15, 0.0], screen).unwrap();
        let regime = Regime { persistent_blocks: true, pose_error: None };
        let drive = record_library(&NOMINAL, &around, &[moved], regime, 3).unwrap();
        let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 99, seed: 5, ..GapOptions::default() };
        let outcome = find(&NOMINAL, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
        let [named] = &outcome.effects[..] else { panic!("{:?}", outcome.effects) };
        let [a, b] = named.place[0].map(DVec2::from);
        let west = named.params["distance_m"].estimate.value * (b - a).y.signum();
        assert!(named.name == EffectKind::MovedWall && (west - 0.15).abs() < 0.01, "{named:?}");
    }

    /// The fixtures' room with a partition of 12 cm and 1.2 m in its middle, which stands so far to the east of its place in the map \[m\].
    fn room_with_partition(east: f64) -> Nominal {
        let thick = [[3.3, 1.4], [3.42, 1.4], [3.42, 2.6], [3.3, 2.6]];
        let obstacle =
            Polyline { points_m: thick.map(|[x, y]| [x + east, y]).to_vec(), ..Polyline::default() };
        let room = [[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]];
        let outline = Polyline { points_m: room.to_vec(), ..Polyline::default() };
        let map = VectorMap { outline, obstacles: vec![obstacle], walls: Vec::new() };
        let map = Arc::new(ExactRangeMap::new(map.to_geometry().unwrap()));
        Nominal::new(map, NOMINAL.laser, NOMINAL.blocks, NOMINAL.odometry, NOMINAL.effects.clone()).unwrap()
    }

    /// A robot drives around a partition that stands 15 cm beside its place: both faces have moved, and one name says so.
    #[test]
    fn both_faces_of_a_partition_have_one_name() {
        let path = RobotPath::Waypoints {
            points_m: vec![[1.2, 1.0], [4.8, 0.8], [5.0, 3.2], [1.4, 3.2], [1.2, 1.4]],
            speed_m_s: 0.5,
            turn_rate_rad_s: 0.8,
        };
        let (nominal, real) = (room_with_partition(0.0), room_with_partition(0.15));
        let robot = Robot { path, start_jitter_m: 0.0, odometry_noise: nominal.odometry };
        let simulator = Regime::default().simulator(&real, &real.effects).unwrap();
        let around = simulate_drive(&simulator, &robot, SEED).unwrap().drive.reference().unwrap();
        let drive = record_library(&real, &around, &[], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 99, seed: 5, ..GapOptions::default() };
        let outcome = find(&nominal, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
        let [named] = &outcome.effects[..] else { panic!("{:?}", outcome.effects) };
        assert!(named.name == EffectKind::MovedWall && named.place.len() == 2, "{named:?}");
        let [a, b] = named.place[0].map(DVec2::from);
        let west = named.params["distance_m"].estimate.value * (b - a).y.signum();
        assert!((west + 0.15).abs() < 0.01, "{named:?}");
    }
}
