//! Walls that hardly any reading is left of, over a long stretch.
//!
//! Clutter that stays hides as much of a wall as it is wide, and may hide it all the time. A wall that has moved is gone over its whole length,
//! which is mostly longer. So it is the length that is looked at, and the replicates say what lengths clutter makes.

use glam::DVec2;
use locsim_comparison::kinds_shown_by;
use locsim_core::{Line, distance_to, median};
use locsim_world::effect::{self, EffectKind};

use super::displaced_walls::{FARTHEST_M, displacement, turned};
use super::readings::Reading;
use super::survey::Survey;
use super::walls::{ON_LINE_M, of_one_and_both_faces};
use super::{Family, Form, Found, Group, Halves, Readings, Start, Statistic};

/// Shorter walls are hidden by single things \[m\].
const LEAST_WALL_M: f64 = 1.5;
/// A map with more walls than this isn't one of walls, but of cells.
const MOST_WALLS: usize = 2000;
/// Pieces of a wall join within this \[m\], and are on one line where the cosine of the angle between them is 1, to this.
const JOINED_M: f64 = 1e-6;
const STRAIGHT: f64 = 1e-6;
/// Length of the bins into which a wall is cut \[m\].
const BIN_M: f64 = 0.25;
/// Fewer readings of a bin say nothing of it.
const LEAST_READINGS: f64 = 3.0;
/// The share of a bin's readings that are elsewhere where the wall has gone.
const GONE_SHARE: f64 = 0.8;
/// What a single thing hides more or less \[m\].
const BY_ONE_THING_M: f64 = 0.5;
/// The walls that fits start from.
const MOST_STARTS: usize = 2;

/// The lengths over which walls have gone.
pub(super) struct VacatedWalls {
    kind: EffectKind,
    walls: Vec<[DVec2; 2]>,
    /// Wall and bin of each beam; `None` of one that ends on no long wall.
    of_beams: Vec<Option<[u32; 2]>>,
}

/// Readings of a bin: those of the wall, and those beside it.
type Bin = [f64; 2];

impl VacatedWalls {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        let (walls, of_beams) = beams_of_walls(survey);
        kinds_shown_by(|statistic| matches!(statistic, effect::Statistic::WallShift))
            .map(|kind| Self { kind, walls: walls.clone(), of_beams: of_beams.clone() })
            .collect()
    }

    /// The bins of each wall, in each half of the log.
    fn bins(&self, log: &Readings<'_>) -> Vec<[Vec<Bin>; 2]> {
        let empty = |[a, b]: &[DVec2; 2]| {
            let bins = vec![[0.0; 2]; (a.distance(*b) / BIN_M) as usize + 1];
            [bins.clone(), bins]
        };
        let mut bins: Vec<[Vec<Bin>; 2]> = self.walls.iter().map(empty).collect();
        for reading in &log.all {
            if let (Some([wall, bin]), Some(side)) = (self.of_beams[reading.index], side_of(reading)) {
                bins[wall as usize][reading.half][bin as usize][side] += 1.0;
            }
        }
        bins
    }

    /// Where a fit of a wall starts, over the longest stretch of it that has gone.
    fn start(&self, log: &Readings<'_>, wall: usize) -> Option<Start> {
        let [first, second] = &self.bins(log)[wall];
        let both: Vec<Bin> = first.iter().zip(second).map(|(a, b)| [a[0] + b[0], a[1] + b[1]]).collect();
        let [from, to] = longest(&both)?;
        let [a, b] = self.walls[wall];
        let along = (b - a).normalize();
        let is_in = |reading: &&Reading<'_>| {
            let of = self.of_beams[reading.index];
            of.is_some_and(|[of, bin]| of as usize == wall && (from..to).contains(&(bin as usize)))
        };
        let views = log.all.iter().filter(is_in).map(|reading| reading.beam.view.direction);
        let line = Line { point: a, along }.seen_from_its_right(views);
        let by = log.all.iter().filter(is_in).filter_map(|reading| {
            let by = displacement(reading).filter(|by| by.abs() <= FARTHEST_M)?;
            Some(line.away(reading.beam.view.direction) * by)
        });
        let by = median(&mut by.collect::<Vec<_>>());
        let at = |bin: usize| a + (bin as f64 * BIN_M).min(a.distance(b)) * along;
        let ends = if line.along.dot(along) > 0.0 { [at(from), at(to)] } else { [at(to), at(from)] };
        let turned = turned(log, line).map(|(_, start)| start);
        Some(turned.unwrap_or(Start { values: vec![by, 0.0], place: vec![ends] }))
    }
}

/// 0 for a reading of its wall, 1 for one beside it; `None` of what says nothing of the wall.
fn side_of(reading: &Reading<'_>) -> Option<usize> {
    match displacement(reading) {
        Some(by) => (by.abs() <= FARTHEST_M).then_some(1),
        None => reading.is_return.then_some(0),
    }
}

/// From which bin to which a wall has gone, the longest such stretch. Bins that few beams come to don't end it.
fn longest(bins: &[Bin]) -> Option<[usize; 2]> {
    let (mut best, mut run): (Option<[usize; 2]>, Option<[usize; 2]>) = (None, None);
    for (i, [on_wall, beside]) in bins.iter().enumerate() {
        let all = on_wall + beside;
        if all < LEAST_READINGS {
            continue;
        }
        run = (*beside >= GONE_SHARE * all).then(|| [run.map_or(i, |[from, _]| from), i + 1]);
        let length = |run: Option<[usize; 2]>| run.map_or(0, |[from, to]| to - from);
        if length(run) > length(best) {
            best = run;
        }
    }
    best
}

/// Walls that are drawn in pieces, one after the other on one line, as one.
fn joined(segments: &[[DVec2; 2]]) -> Vec<[DVec2; 2]> {
    let mut walls: Vec<[DVec2; 2]> = Vec::new();
    for &[a, b] in segments {
        let goes_on = |[from, to]: &[DVec2; 2]| {
            to.distance(a) < JOINED_M && (*to - *from).normalize().dot((b - a).normalize()) > 1.0 - STRAIGHT
        };
        match walls.last_mut().filter(|last| goes_on(last)) {
            Some(last) => last[1] = b,
            None => walls.push([a, b]),
        }
    }
    walls
}

/// The long walls of the map, and which of them and which bin of it each beam ends on.
fn beams_of_walls(survey: &Survey<'_>) -> (Vec<[DVec2; 2]>, Vec<Option<[u32; 2]>>) {
    let (nominal, views) = (survey.comparison.nominal, &survey.comparison.views);
    let mut walls = joined(nominal.map.geometry().segments());
    walls.retain(|[a, b]| a.distance(*b) >= LEAST_WALL_M);
    // Errors of a measured map are found by place, before the search.
    if nominal.pieces.is_some() || walls.len() > MOST_WALLS {
        walls.clear();
    }
    let of_beam = |end: DVec2| {
        let (wall, off) = walls
            .iter()
            .enumerate()
            .map(|(i, wall)| (i, distance_to(wall, end)))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        let [a, b] = walls[wall];
        let bin = (b - a).normalize().dot(end - a).max(0.0) / BIN_M;
        (off <= ON_LINE_M).then_some([wall as u32, bin as u32])
    };
    let met = views.beams.iter().map(|beam| {
        let is_met = beam.view.range < survey.max_range;
        is_met.then(|| of_beam(beam.view.endpoint)).flatten()
    });
    let of_beams = met.collect();
    (walls, of_beams)
}

impl Family for VacatedWalls {
    fn statistics(&self) -> Vec<Statistic> {
        let of = Statistic::of_effect(self.kind, Group::VacatedWalls, Form::Share)
            .with_one_reading(BY_ONE_THING_M);
        vec![of; self.walls.len()]
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let length =
            |bins: &Vec<Bin>| longest(bins).map_or(0.0, |[from, to]| 0.5 * BIN_M * (to - from) as f64);
        self.bins(log).iter().map(|halves| halves.each_ref().map(length)).collect()
    }

    fn first_guesses(&self, log: &Readings<'_>, found: &[Found<'_>]) -> Vec<Start> {
        let walls = found.iter().filter(|found| found.z > 0.0).take(MOST_STARTS);
        let starts = walls.filter_map(|found| self.start(log, found.index));
        starts.flat_map(|start| of_one_and_both_faces(log, start)).collect()
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

    /// A wall of 6 m has moved by 17 cm over 5 m of it, and is turned by a degree, where clutter stays in front of walls: it has gone over its
    /// length, and fits start there. Clutter alone hides less than a metre of any wall.
    #[test]
    fn a_wall_that_moved_is_gone_over_its_length() {
        let stretch = [DVec2::new(0.5, 4.0), DVec2::new(5.5, 4.0)];
        let turn = 1f64.to_radians();
        let moved = Effect::new(EffectKind::MovedWall, vec![-0.17, turn], vec![stretch]).unwrap();
        let longest_in = |effects: &[Effect]| {
            let regime = Regime { persistent_blocks: true, pose_error: None };
            let drive = record_library(&NOMINAL, &TRUTH, effects, regime, 3).unwrap();
            let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let family = VacatedWalls::all(&Survey::new(&comparison)).remove(0);
            let fitted = comparison.start(&Nuisances::default());
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
            let lengths: Vec<f64> = family.measure(&log).iter().map(|halves| halves.iter().sum()).collect();
            let (wall, length) = lengths
                .into_iter()
                .enumerate()
                .max_by(|a, b| a.1.total_cmp(&b.1))
                .expect("the room has walls");
            (length, family.start(&log, wall))
        };
        let (length, start) = longest_in(&[moved]);
        let start = start.unwrap();
        let [a, b] = start.place[0];
        assert!((4.0..=5.5).contains(&length) && a.distance(b) > 4.0, "{length} {start:?}");
        assert!(
            (start.values[0] + 0.17).abs() < 0.02 && (start.values[1].abs() - turn).abs() < 0.005,
            "{start:?}"
        );
        assert!(longest_in(&[]).0 <= 0.75);
    }

    /// A wall of 3 m in pieces, and the wall beyond its corner.
    #[test]
    fn a_wall_that_is_drawn_in_pieces_is_one() {
        let at = |points: [[f64; 2]; 5]| points.map(DVec2::from);
        let points = at([[0.0, 0.0], [1.0, 0.0], [2.2, 0.0], [3.0, 0.0], [3.0, 2.0]]);
        let pieces: Vec<[DVec2; 2]> = points.windows(2).map(|ends| [ends[0], ends[1]]).collect();
        assert_eq!(joined(&pieces), [[points[0], points[3]], [points[3], points[4]]]);
        assert_eq!(joined(&[pieces[0], pieces[2]]), [pieces[0], pieces[2]], "a gap between them");
    }

    #[test]
    fn the_longest_stretch_has_no_readings_of_the_wall() {
        let (gone, there, unseen) = ([1.0, 9.0], [9.0, 1.0], [0.0, 1.0]);
        assert_eq!(longest(&[gone, there, gone, unseen, gone, gone, there]), Some([2, 6]));
        assert_eq!(longest(&[there, unseen, there]), None);
        assert_eq!(longest(&[[3.0, 7.0]; 9]), None);
    }
}
