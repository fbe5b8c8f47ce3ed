//! Parts of the robot in front of the laser: readings in front of the walls, counted by bearing and range.

use locsim_core::{Pose2, cell_at};
use std::collections::HashSet;

use locsim_comparison::kinds_shown_by;
use locsim_world::effect::{self, EffectKind};

use super::survey::Survey;
use super::{Family, Form, Found, Group, Halves, OBJECT_CELL_M, Readings, Start, Statistic};

/// Bins of bearing over the field of view: of 15 degrees for a full turn.
const BEARINGS: usize = 24;
/// How far from its laser a robot may have a part of its own \[m\].
pub(crate) const ROBOT_REACH_M: f64 = 2.0;
/// Length of a bin of range \[m\].
const RANGE_BIN_M: f64 = 0.25;
/// The length of a piece of the way \[m\], to which a turn adds this much \[m/rad\]. What stands in the room is in one window for a few pieces, and
/// what is on the robot for all of them.
const PIECE_M: f64 = 0.5;
const TURN_M: f64 = 0.5;
const PIECES_OF_ONE_THING: f64 = 3.0;
/// The most windows that fits start from, and the probability that they start at.
const MOST_STARTS: usize = 2;
const FIRST_PROBABILITY: f64 = 0.05;

/// The counts of readings in windows of two bins of bearing and two of range, and the shares of the way on which a window has any.
pub(super) struct Sectors {
    kind: EffectKind,
    /// Bearing of each beam of a scan, and the width of a bin \[rad\].
    bearings: Vec<f64>,
    width_rad: f64,
    /// Number of bins of range.
    ranges: usize,
    /// The bin of each beam of a scan.
    of_beams: Vec<usize>,
    /// The piece of the way of each scan.
    of_scans: Vec<usize>,
}

/// The window of a statistic: bearings and middle range.
struct Window {
    from_rad: f64,
    to_rad: f64,
    range_m: f64,
}

impl Sectors {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        let bearings = survey.bearings();
        let (first, last) = (bearings[0], bearings[bearings.len() - 1]);
        let width_rad = (last - first) / BEARINGS as f64;
        let bin = |bearing: &f64| ((bearing - first) / width_rad.max(1e-9)) as usize;
        let of_beams: Vec<usize> = bearings.iter().map(|bearing| bin(bearing).min(BEARINGS - 1)).collect();
        let ranges = (survey.max_range.min(ROBOT_REACH_M) / RANGE_BIN_M).ceil() as usize;
        let of_scans = pieces_of_way(survey.comparison.recorded.track.poses());
        kinds_shown_by(|statistic| matches!(statistic, effect::Statistic::Sector))
            .map(|kind| Self {
                kind,
                bearings: bearings.clone(),
                width_rad,
                ranges,
                of_beams: of_beams.clone(),
                of_scans: of_scans.clone(),
            })
            .collect()
    }

    /// The bins of bearing and range at which each window begins.
    fn corners(&self) -> impl Iterator<Item = [usize; 2]> {
        (0..BEARINGS - 1).flat_map(|bearing| (0..self.ranges - 1).map(move |range| [bearing, range]))
    }

    /// The window of a statistic.
    fn window(&self, statistic: usize) -> Window {
        let index = statistic % self.corners().count();
        let [bearing, range] = [index / (self.ranges - 1), index % (self.ranges - 1)];
        let from_rad = self.bearings[0] + bearing as f64 * self.width_rad;
        let to_rad = from_rad + 2.0 * self.width_rad;
        Window { from_rad, to_rad, range_m: (range as f64 + 1.0) * RANGE_BIN_M }
    }
}

/// The piece of the way that each scan is on.
fn pieces_of_way(poses: &[Pose2]) -> Vec<usize> {
    let mut way_m = 0.0;
    let mut of_scans = vec![0];
    for pair in poses.windows(2) {
        let step = pair[1].relative_to(&pair[0]);
        way_m += step.position().length() + TURN_M * step.theta.abs();
        of_scans.push((way_m / PIECE_M) as usize);
    }
    of_scans
}

/// The range about which most readings of a window lie \[m\]: the middle of the densest tenth of a metre.
fn densest_range(log: &Readings<'_>, bearings: &[f64], window: &Window) -> f64 {
    const WIDTH_M: f64 = 0.1;
    let recorded = &*log.comparison.recorded;
    let mut near: Vec<f64> = recorded
        .readings
        .iter()
        .enumerate()
        .filter(|(i, _)| (window.from_rad..=window.to_rad).contains(&bearings[i % bearings.len()]))
        .map(|(_, &z)| f64::from(z))
        .filter(|z| (z - window.range_m).abs() <= RANGE_BIN_M)
        .collect();
    near.sort_by(f64::total_cmp);
    let below = |limit: f64| near.partition_point(|z| *z < limit);
    let count = |&from: &f64| below(from + WIDTH_M) - below(from);
    near.iter().copied().max_by_key(count).map_or(window.range_m, |z| z + 0.5 * WIDTH_M)
}

/// The bearings between which more readings lie at a range than elsewhere (Kulldorff's scan statistic, 1997) \[rad\].
fn bearings_at(log: &Readings<'_>, bearings: &[f64], window: &Window, range_m: f64) -> [f64; 2] {
    /// Readings within this of the range count \[m\].
    const NEAR_M: f64 = 0.1;
    /// How far a sector may reach beyond the window \[rad\].
    const BEYOND_RAD: f64 = 0.3;
    /// The least number of such readings that is expected of a beam: none at all would make any single one infinitely rare.
    const LEAST_EXPECTED: f64 = 0.2;
    let beams = bearings.len();
    let mut counts = vec![0.0; beams];
    for (i, &z) in log.comparison.recorded.readings.iter().enumerate() {
        if (f64::from(z) - range_m).abs() < NEAR_M {
            counts[i % beams] += 1.0;
        }
    }
    let reach = window.from_rad - BEYOND_RAD..=window.to_rad + BEYOND_RAD;
    let is_inside = |beam: usize| reach.contains(&bearings[beam]);
    let outside: Vec<f64> = (0..beams).filter(|&beam| !is_inside(beam)).map(|beam| counts[beam]).collect();
    let usual = (outside.iter().sum::<f64>() / outside.len().max(1) as f64).max(LEAST_EXPECTED);
    let (mut most, mut best) = (0.0, [window.from_rad, window.to_rad]);
    for first in (0..beams).filter(|&beam| is_inside(beam)) {
        let mut sum = 0.0;
        for last in (first..beams).take_while(|&beam| is_inside(beam)) {
            sum += counts[last];
            let expected = usual * (last - first + 1) as f64;
            let gain = if sum > expected { sum * (sum / expected).ln() - (sum - expected) } else { 0.0 };
            if gain > most {
                let half = 0.5 * (bearings[(first + 1).min(beams - 1)] - bearings[first]).abs();
                (most, best) = (gain, [bearings[first] - half, bearings[last] + half]);
            }
        }
    }
    best
}

impl Family for Sectors {
    fn statistics(&self) -> Vec<Statistic> {
        let pieces = self.of_scans.last().map_or(1, |last| last + 1);
        let count = Statistic::of_effect(self.kind, Group::Places, Form::Count);
        let share = Statistic::of_effect(self.kind, Group::OnRobot, Form::Share);
        let share = share.with_one_reading(PIECES_OF_ONE_THING / (pieces as f64).max(PIECES_OF_ONE_THING));
        let windows = self.corners().count();
        [vec![count; windows], vec![share; windows]].concat()
    }

    /// Several readings of one place in the map count once: a thing that stands in the room isn't on the robot.
    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let (mut seen, mut met) = (HashSet::new(), HashSet::new());
        let mut counts = vec![[0.0; 2]; BEARINGS * self.ranges];
        for reading in log.in_front() {
            let range = (reading.z / RANGE_BIN_M) as usize;
            if range < self.ranges {
                let bin = self.of_beams[reading.index % self.of_beams.len()] * self.ranges + range;
                let place = cell_at(reading.point(), OBJECT_CELL_M);
                if seen.insert((bin, reading.half, place)) {
                    counts[bin][reading.half] += 1.0;
                }
                met.insert((bin, reading.half, self.of_scans[reading.scan]));
            }
        }
        let bins_of = |[bearing, range]: [usize; 2]| {
            let corner = bearing * self.ranges + range;
            [corner, corner + 1, corner + self.ranges, corner + self.ranges + 1]
        };
        let count = |window: [usize; 2]| {
            let bins = bins_of(window);
            std::array::from_fn(|half| bins.iter().map(|&bin| counts[bin][half]).sum())
        };
        let mut pieces = [Vec::new(), Vec::new()];
        for readings in log.scans() {
            pieces[readings[0].half].push(self.of_scans[readings[0].scan]);
        }
        pieces.iter_mut().for_each(Vec::dedup);
        let share = |window: [usize; 2]| {
            let bins = bins_of(window);
            std::array::from_fn(|half| {
                let is_met = |piece: &&usize| bins.iter().any(|&bin| met.contains(&(bin, half, **piece)));
                let own = pieces[half].iter().filter(is_met).count() as f64;
                // As minus the logarithm of the rest; a piece more keeps it finite.
                -0.5 * (-own / (pieces[half].len() as f64 + 1.0)).ln_1p()
            })
        };
        self.corners().map(count).chain(self.corners().map(share)).collect()
    }

    fn first_guesses(&self, log: &Readings<'_>, found: &[Found<'_>]) -> Vec<Start> {
        let more = found.iter().filter(|found| found.z > 0.0).take(MOST_STARTS);
        more.map(|found| {
            let window = self.window(found.index);
            let range_m = densest_range(log, &self.bearings, &window);
            let [from_rad, to_rad] = bearings_at(log, &self.bearings, &window, range_m);
            Start { values: vec![from_rad, to_rad, range_m, FIRST_PROBABILITY], place: Vec::new() }
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances};
    use locsim_world::effect::Effect;

    use super::*;
    use crate::Recorded;
    use crate::statistics::pit_draw;

    /// A cable that hides a beam in two of three scans is met on nearly all of the way; clutter in a small room on about half of it.
    #[test]
    fn what_is_on_the_robot_is_met_on_all_of_the_way() {
        let most = |effects: &[Effect]| {
            let regime = Regime { persistent_blocks: true, pose_error: None };
            let drive = record_library(&NOMINAL, &TRUTH, effects, regime, 3).unwrap();
            let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let family = Sectors::all(&Survey::new(&comparison)).remove(0);
            let fitted = comparison.start(&Nuisances::default());
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
            let windows = family.corners().count();
            let shares = family.measure(&log).split_off(windows);
            // From minus the logarithm of the rest.
            shares.iter().map(|halves| 1.0 - (-halves.iter().sum::<f64>()).exp()).fold(0.0, f64::max)
        };
        let cable = Effect::new(EffectKind::SectorOcclusion, vec![0.4, 0.5, 0.2, 0.67], Vec::new()).unwrap();
        let (with, without) = (most(&[cable]), most(&[]));
        assert!(with > 0.8 && without < 0.6, "{with} {without}");
    }
}
