//! Objects that the map lacks: readings in front of the walls, counted where they lie in the map.

use locsim_core::{cell_at, densest};
use std::collections::HashMap;

use glam::DVec2;
use locsim_comparison::kinds_shown_by;
use locsim_world::effect::{self, Disc, EffectKind};

use super::readings::Reading;
use super::survey::Survey;
use super::{Family, Form, Found, Group, Halves, OBJECT_CELL_M, Readings, Start, Statistic};

/// The error of where a reading lies that noise and errors of the reference make \[m\], or five standard deviations of a laser
/// with more noise.
const READING_ERROR_M: f64 = 0.1;
/// Readings of one object are within this of each other \[m\].
const TOGETHER_M: f64 = 0.1;
/// Radii from which the fit of an object may start \[m\]: a leg of a chair, a column.
const FIRST_RADII_M: [f64; 4] = [0.02, 0.05, 0.1, 0.2];
/// The most windows that fits start from.
const MOST_STARTS: usize = 3;

/// The counts of readings in windows of free space. Windows of four cells overlap, so that an object on the border of a cell
/// isn't shared out.
pub(super) struct Objects {
    kind: EffectKind,
    /// Index of each cell of free space.
    cells: HashMap<[i32; 2], u32>,
    windows: Vec<Window>,
}

#[derive(Clone)]
struct Window {
    /// Its cell of the least coordinates.
    corner: [i32; 2],
    /// Indices of its cells in free space.
    cells: Vec<u32>,
    /// Whether clutter can stand there.
    is_among_clutter: bool,
}

impl Objects {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        let (cells, windows) = free_space(survey);
        kinds_shown_by(|statistic| matches!(statistic, effect::Statistic::Object))
            .map(|kind| Self { kind, cells: cells.clone(), windows: windows.clone() })
            .collect()
    }

    /// The disc at the readings in a window that lie together, of the radius by which it stops most beams, less those that pass.
    fn disc(log: &Readings<'_>, [x, y]: [i32; 2]) -> Disc {
        let is_inside = |reading: &&Reading<'_>| {
            let [i, j] = cell_at(reading.point(), OBJECT_CELL_M);
            (x..=x + 1).contains(&i) && (y..=y + 1).contains(&j)
        };
        let inside: Vec<&Reading<'_>> = log.in_front().filter(is_inside).collect();
        let points: Vec<DVec2> = inside.iter().map(|reading| reading.point()).collect();
        let middle = DVec2::new(f64::from(x + 1), f64::from(y + 1)) * OBJECT_CELL_M;
        let face = densest(&points, TOGETHER_M).unwrap_or(middle);
        // Readings lie on the side that faces the laser.
        let together = inside.iter().filter(|reading| reading.point().distance(face) <= TOGETHER_M);
        let inwards = together.map(|reading| reading.beam.view.direction).sum::<DVec2>().normalize_or_zero();
        let discs = FIRST_RADII_M.map(|radius_m| Disc { center: face + radius_m * inwards, radius_m });
        let stopped = |disc: &Disc| log.all.iter().map(|reading| stops(disc, reading)).sum::<i32>();
        discs.into_iter().rev().max_by_key(stopped).unwrap_or(discs[0])
    }
}

/// 1 for a disc that stops a beam where its reading is, -1 for one that would and doesn't, 0 for one that is hidden or beside it.
fn stops(disc: &Disc, reading: &Reading<'_>) -> i32 {
    let (direction, to_center) = (reading.beam.view.direction, disc.center - reading.point());
    let (along, across) = (direction.dot(to_center), direction.perp_dot(to_center));
    let reach = disc.radius_m + READING_ERROR_M;
    // Ends before it, or comes from a laser beyond it.
    if across.abs() >= disc.radius_m || along > reach || reading.z + along < 0.0 {
        return 0;
    }
    if along >= -reach { 1 } else { -1 }
}

/// The cells along the beams up to their ends, where objects can be seen, and the windows of four of them.
fn free_space(survey: &Survey<'_>) -> (HashMap<[i32; 2], u32>, Vec<Window>) {
    let (comparison, max) = (survey.comparison, survey.max_range);
    let mut cells = HashMap::new();
    for beam in &comparison.views.beams {
        let range = beam.view.range.min(max);
        let mut along = 0.5 * OBJECT_CELL_M;
        while along < range {
            cells.insert(cell_at(beam.view.point_at(range - along), OBJECT_CELL_M), 0);
            along += OBJECT_CELL_M;
        }
    }
    let mut corners: Vec<[i32; 2]> = cells.keys().copied().collect();
    corners.sort_unstable();
    for (i, corner) in corners.iter().enumerate() {
        cells.insert(*corner, i as u32);
    }
    let error = READING_ERROR_M.max(5.0 * comparison.nominal.laser.sigma_m);
    // The points of this lattice are the middles of windows.
    let reach = comparison.views.blocks_in_reach(OBJECT_CELL_M, OBJECT_CELL_M + error);
    let window = |[x, y]: [i32; 2]| Window {
        corner: [x, y],
        cells: [[x, y], [x + 1, y], [x, y + 1], [x + 1, y + 1]]
            .iter()
            .filter_map(|cell| cells.get(cell).copied())
            .collect(),
        is_among_clutter: reach.contains(&[x + 1, y + 1]),
    };
    let windows = corners.into_iter().map(window).collect();
    (cells, windows)
}

impl Family for Objects {
    fn statistics(&self) -> Vec<Statistic> {
        let statistic = |window: &Window| {
            let group = if window.is_among_clutter { Group::AmongClutter } else { Group::Places };
            Statistic::of_effect(self.kind, group, Form::Count)
        };
        self.windows.iter().map(statistic).collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let mut counts = vec![[0.0; 2]; self.cells.len()];
        for reading in log.in_front() {
            if let Some(&cell) = self.cells.get(&cell_at(reading.point(), OBJECT_CELL_M)) {
                counts[cell as usize][reading.half] += 1.0;
            }
        }
        let count = |window: &Window| {
            std::array::from_fn(|half| window.cells.iter().map(|&cell| counts[cell as usize][half]).sum())
        };
        self.windows.iter().map(count).collect()
    }

    fn first_guesses(&self, log: &Readings<'_>, found: &[Found<'_>]) -> Vec<Start> {
        let more = found.iter().filter(|found| found.z > 0.0).take(MOST_STARTS);
        more.map(|found| {
            let Disc { center, radius_m } = Self::disc(log, self.windows[found.index].corner);
            Start { values: vec![center.x, center.y, radius_m], place: Vec::new() }
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

    use super::super::sectors::Sectors;
    use super::*;
    use crate::Recorded;
    use crate::statistics::pit_draw;

    /// An object in the room is seen many times at one place of the room and few times at one bearing and range from the
    /// robot; a part of the robot the other way round.
    #[test]
    fn an_object_in_the_room_is_not_on_the_robot() {
        /// The largest counts of the two families in a log with an effect.
        fn most(kind: EffectKind, values: &[f64]) -> [f64; 2] {
            let effect = Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
            let regime = Regime { persistent_blocks: true, pose_error: None };
            let drive = record_library(&NOMINAL, &TRUTH, &[effect], regime, 2).unwrap();
            let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let survey = Survey::new(&comparison);
            let fitted = comparison.start(&Nuisances::default());
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
            let counts = [Objects::all(&survey)[0].measure(&log), Sectors::all(&survey)[0].measure(&log)];
            counts.map(|all| all.iter().map(|halves| halves[0] + halves[1]).fold(0.0, f64::max))
        }
        let [in_room, as_sector] = most(EffectKind::MissingObject, &[2.6, 2.0, 0.05]);
        assert!(as_sector < 0.2 * in_room && in_room > 100.0, "{as_sector} {in_room}");
        let [_, on_robot] = most(EffectKind::SectorOcclusion, &[0.4, 0.8, 0.3, 0.2]);
        assert!(on_robot > 3.0 * as_sector, "{as_sector} {on_robot}");
    }

    /// A leg and a column in the room: fits start near their middles, from radii that are near theirs.
    #[test]
    fn fits_start_from_a_disc_like_the_object() {
        for radius_m in [0.02, 0.2] {
            let center = DVec2::new(2.6, 2.0);
            let object =
                Effect::new(EffectKind::MissingObject, vec![center.x, center.y, radius_m], Vec::new());
            let drive = record_library(&NOMINAL, &TRUTH, &[object.unwrap()], Regime::default(), 2).unwrap();
            let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let family = Objects::all(&Survey::new(&comparison)).remove(0);
            let fitted = comparison.start(&Nuisances::default());
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
            let counts = family.measure(&log);
            let most = |window: &usize| counts[*window].iter().sum::<f64>() as u32;
            // Clutter at walls has as many.
            let is_near = |window: &usize| {
                let [x, y] = family.windows[*window].corner.map(|cell| f64::from(cell + 1) * OBJECT_CELL_M);
                DVec2::new(x, y).distance(center) < 0.5
            };
            let window = (0..counts.len()).filter(is_near).max_by_key(most).unwrap();
            let disc = Objects::disc(&log, family.windows[window].corner);
            let ratio = disc.radius_m / radius_m;
            assert!(
                (0.4..2.6).contains(&ratio) && disc.center.distance(center) < 0.5 * radius_m + 0.05,
                "{disc:?}"
            );
        }
    }
}
