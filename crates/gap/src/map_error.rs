//! Where a measured map can't be right, and where it can't say.
//!
//! A map that was measured has errors that no laser has. They are found by place, told by name, and the beams that they concern
//! are left out of the search: of the log and of all simulated ones alike.

use std::collections::{BTreeMap, HashSet};

use glam::DVec2;
use locsim_comparison::{Comparison, Fitted, PieceView, beam_headings};
use locsim_core::{cell_at, cells_between, circular_mean, median, wrap_angle};
use locsim_world::simulation::WallPieces;
use serde::Serialize;

use crate::Guess;
use crate::statistics::OBJECT_CELL_M;

/// A reading is far from where the map has it when it is off by more than this \[m\], and more than a turn of the robot by this
/// makes \[rad\].
const FAR_M: f64 = 0.5;
const FAR_RAD: f64 = 0.05;
/// A wall that is farther off than this \[m\] has moved, or was never there.
const MOVED_M: f64 = 0.15;
/// The fewest readings, and scans, that make an error of the map.
const FEWEST_READINGS: usize = 5;
const FEWEST_SCANS: usize = 3;
/// The least share of the beams which come to a place that go through it, or are stopped by it.
const LEAST_SHARE: f64 = 0.15;
/// This many times the share of the whole log: readings that are random are so everywhere.
const TIMES_USUAL: f64 = 4.0;
/// Beams of these widths of incidence lose returns alike \[rad\].
const CLASS_RAD: f64 = 0.2;
/// Panes and gratings are seldom wider than this \[m\]: pieces farther off tell what a wall of another kind would return.
const NEARBY_M: f64 = 2.0;
/// A piece that few beams come to is as those within this \[m\].
const BESIDE_M: f64 = 0.5;
/// The least angle between the bearings of beams that end on an object in the room: one on the robot is always at the same
/// \[rad\].
const LEAST_TURN_RAD: f64 = 0.2;

/// What is wrong about a place of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MapErrorKind {
    /// A wall stands elsewhere.
    MovedWall,
    /// Something stands where the map has free space.
    MissingObject,
    /// Beams go through a wall.
    Hole,
}

/// A place where the map is wrong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapError {
    /// What is wrong.
    pub kind: MapErrorKind,
    /// The ends of a stretch of wall, or opposite corners of the cells of an object \[m\].
    pub place: [[f64; 2]; 2],
    /// How much farther from the laser the wall stands, across \[m\]; of a wall that has moved.
    pub offset_m: Option<f64>,
    /// Readings that show it.
    pub readings: usize,
    /// Share of these among the beams that come there.
    pub share: f64,
}

/// The beams that a search leaves out, as shares of all, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LeftOut {
    /// They leave what the map has seen: they have no nominal range.
    pub unknown: f64,
    /// They pass an end of a wall so near that it isn't known where they end.
    pub at_ends: f64,
    /// They come to a place where the map is wrong.
    pub map_errors: f64,
}

/// What a measured map doesn't say, and where it is wrong.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MeasuredMapFindings {
    /// What the search has otherwise than the scenario.
    pub guesses: Vec<Guess>,
    /// Beams that are left out.
    pub left_out: LeftOut,
    /// The places, those with most readings first.
    pub errors: Vec<MapError>,
}

/// A reading against the map, once pose and wall are where they fit best.
struct Place {
    beam: usize,
    scan: usize,
    bearing: f64,
    piece: usize,
    /// The reading less the range \[m\].
    error: f64,
    /// The offset of the wall that it speaks for, across \[m\].
    offset: f64,
    is_far: bool,
    is_return: bool,
    /// Whether it is far behind the wall, or there is no return.
    is_beyond: bool,
    /// The beams that lose returns alike: by incidence and range.
    class: [i32; 2],
    origin: DVec2,
    end: DVec2,
}

/// The places where the map is wrong, and the beams that come there, \[scan\]\[beam\].
pub(crate) fn find(comparison: &Comparison<'_>, fitted: &Fitted) -> (Vec<MapError>, Vec<bool>) {
    let views = &comparison.views;
    let mut ignored = vec![false; views.beams.len()];
    let Some(pieces) = comparison.nominal.pieces.as_ref().filter(|_| !views.pieces.is_empty()) else {
        return (Vec::new(), ignored);
    };
    let mut places = places(comparison, fitted);
    let mut errors = walls(pieces, &places, &mut ignored);
    places.retain(|place| place.is_return);
    errors.extend(objects(comparison, &places, &mut ignored));
    errors.sort_by(|a, b| b.readings.cmp(&a.readings).then(a.kind.cmp(&b.kind)));
    (errors, ignored)
}

fn places(comparison: &Comparison<'_>, fitted: &Fitted) -> Vec<Place> {
    let views = &comparison.views;
    let rays = beam_headings(comparison.nominal, &comparison.recorded);
    let max = comparison.nominal.laser.max_range_m;
    let mut places = Vec::new();
    let effects = &comparison.nominal.effects;
    comparison.for_each_reading(views, effects, fitted, |scan, i, _, shift, z, _| {
        let beam = &views.beams[i];
        let Some(PieceView { piece, lean }) = views.pieces[i].filter(|_| beam.range() < max) else { return };
        let error = z - beam.range() - shift;
        let is_far = error.abs() > FAR_M + FAR_RAD * beam.jacobian[2].abs();
        let (origin, heading) = rays[i];
        let direction = DVec2::from_angle(heading);
        places.push(Place {
            beam: i,
            scan,
            bearing: beam.view.bearing,
            piece: piece as usize,
            error,
            offset: error / lean + fitted.offsets[piece as usize],
            is_far,
            is_return: z < max,
            is_beyond: is_far && error > 0.0 || z >= max,
            class: [beam.view.incidence / CLASS_RAD, beam.range().max(1.0).log2()].map(|x| x as i32),
            origin,
            end: origin + z * direction,
        });
    });
    places
}

/// By how much the middle of the bearings of readings, which lie in the order of scans, turns from scan to scan \[rad\].
fn turn_between_scans(ends: &[&Place]) -> f64 {
    let middle = |of_scan: &[&Place]| circular_mean(of_scan.iter().map(|place| (place.bearing, 1.0)));
    let mut middles = ends.chunk_by(|a, b| a.scan == b.scan).filter_map(middle);
    let Some(first) = middles.next() else { return 0.0 };
    let (lo, hi) = middles
        .map(|bearing| wrap_angle(bearing - first))
        .fold((0.0_f64, 0.0_f64), |(lo, hi), turned| (lo.min(turned), hi.max(turned)));
    hi - lo
}

/// How many readings of each class end at a wall, and how many pass it or have no return.
type Passes = BTreeMap<[i32; 2], [f64; 2]>;

fn count<'p>(places: impl Iterator<Item = &'p &'p Place>) -> Passes {
    let mut passes = Passes::new();
    for place in places {
        passes.entry(place.class).or_default()[usize::from(place.is_beyond)] += 1.0;
    }
    passes
}

/// The share of readings that are to pass a piece of wall: of those of the same classes at pieces that aren't nearby. What a laser loses
/// of slanted or far walls it loses of all alike.
fn expected_share(own: &Passes, nearby: &Passes, all: &Passes, usual: f64) -> f64 {
    let expected = own.iter().map(|(class, readings)| {
        let [end, pass] = [0, 1].map(|i| all[class][i] - nearby[class][i]);
        readings.iter().sum::<f64>() * (pass + usual) / (end + pass + 1.0)
    });
    expected.sum::<f64>() / own.values().flatten().sum::<f64>()
}

/// Pieces of walls that beams go through, or that stand elsewhere.
fn walls(pieces: &WallPieces, places: &[Place], ignored: &mut [bool]) -> Vec<MapError> {
    // What is in front of a wall says nothing about it.
    let arrived: Vec<&Place> = places.iter().filter(|place| !place.is_far || place.is_beyond).collect();
    let mut of_pieces: BTreeMap<usize, Vec<&Place>> = BTreeMap::new();
    for place in &arrived {
        of_pieces.entry(place.piece).or_default().push(place);
    }
    let middle_of = |piece: usize| pieces.ends(piece).iter().sum::<DVec2>() / 2.0;
    let all = count(arrived.iter());
    let usual = arrived.iter().filter(|place| place.is_beyond).count() as f64 / arrived.len().max(1) as f64;
    let offset_of = |near: &mut dyn Iterator<Item = &&Place>| {
        median(&mut near.filter(|place| !place.is_beyond).map(|place| place.offset).collect::<Vec<_>>())
    };
    let usual_offset = offset_of(&mut arrived.iter());
    let mut errors = Vec::new();
    let mut wrong = HashSet::new();
    for (&piece, own) in &of_pieces {
        let within = |reach: f64| -> Vec<&Place> {
            let near = |other: usize| middle_of(other).distance(middle_of(piece)) < reach;
            of_pieces
                .iter()
                .filter(|(other, _)| near(**other))
                .flat_map(|(_, places)| places)
                .copied()
                .collect()
        };
        // Whether beams go through is told by the pieces beside it, where few come to this one.
        let arrived = if own.len() < FEWEST_READINGS { within(BESIDE_M) } else { own.clone() };
        let nearby = count(within(NEARBY_M).iter());
        let expected = expected_share(&count(arrived.iter()), &nearby, &all, usual);
        let through: Vec<&Place> = arrived.iter().copied().filter(|place| place.is_beyond).collect();
        let beyond = own.iter().filter(|place| place.is_beyond).count();
        let near = own.len() - beyond;
        let share = through.len() as f64 / arrived.len() as f64;
        let offset = offset_of(&mut own.iter()) - usual_offset;
        let (kind, readings, share, offset_m) = if beyond > 0
            && is_enough(&through)
            && share >= LEAST_SHARE.max((TIMES_USUAL * expected).min(0.5 + 0.5 * expected))
        {
            (MapErrorKind::Hole, beyond, share, None)
        } else if near >= FEWEST_READINGS && offset.abs() > MOVED_M {
            (MapErrorKind::MovedWall, near, 1.0 - share, Some(offset))
        } else {
            continue;
        };
        let place = pieces.ends(piece).map(|end| end.to_array());
        errors.push(MapError { kind, place, offset_m, readings, share });
        wrong.insert(piece);
    }
    for place in places.iter().filter(|place| wrong.contains(&place.piece)) {
        ignored[place.beam] = true;
    }
    errors
}

/// Whether readings are enough, and of enough scans.
fn is_enough(places: &[&Place]) -> bool {
    let scans: HashSet<usize> = places.iter().map(|place| place.scan).collect();
    places.len() >= FEWEST_READINGS && scans.len() >= FEWEST_SCANS
}

/// Cells of free space in which beams end.
fn objects(comparison: &Comparison<'_>, places: &[Place], ignored: &mut [bool]) -> Vec<MapError> {
    #[derive(Default)]
    struct Cell<'p> {
        crossed: usize,
        ends: Vec<&'p Place>,
    }
    let mut cells: BTreeMap<[i32; 2], Cell<'_>> = BTreeMap::new();
    for place in places {
        let is_short = place.is_far && place.error < 0.0;
        for cell in cells_between(place.origin, place.end, OBJECT_CELL_M) {
            cells.entry(cell).or_default().crossed += 1;
        }
        if is_short {
            cells.entry(cell_at(place.end, OBJECT_CELL_M)).or_default().ends.push(place);
        }
    }
    let shorts: usize = cells.values().map(|cell| cell.ends.len()).sum();
    let came: usize = cells.values().map(|cell| cell.crossed).sum();
    let usual = shorts as f64 / came.max(1) as f64;
    let stands = |cell: &Cell<'_>| {
        let ends = &cell.ends;
        let turn = turn_between_scans(ends);
        let share = ends.len() as f64 / cell.crossed.max(ends.len()) as f64;
        is_enough(ends) && turn >= LEAST_TURN_RAD && share >= LEAST_SHARE.max((TIMES_USUAL * usual).min(0.5))
    };
    let found: BTreeMap<[i32; 2], &Cell<'_>> =
        cells.iter().filter(|(_, cell)| stands(cell)).map(|(at, cell)| (*at, cell)).collect();
    // Beams that would come there, whether they were stopped or not.
    let views = &comparison.views;
    let rays = beam_headings(comparison.nominal, &comparison.recorded);
    if !found.is_empty() {
        for (i, (origin, heading)) in rays.into_iter().enumerate() {
            let end = origin + views.beams[i].range() * DVec2::from_angle(heading);
            ignored[i] |= cells_between(origin, end, OBJECT_CELL_M).any(|cell| found.contains_key(&cell));
        }
    }
    // Neighbouring cells are of one object.
    let mut left: BTreeMap<[i32; 2], &Cell<'_>> = found;
    let mut errors = Vec::new();
    while let Some((first, cell)) = left.pop_first() {
        let (mut lo, mut hi, mut ends, mut came) = (first, first, cell.ends.len(), cell.crossed);
        let mut border = vec![first];
        while let Some([x, y]) = border.pop() {
            for next in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x + dx, y + dy])) {
                if let Some(cell) = left.remove(&next) {
                    (lo, hi) =
                        ([lo[0].min(next[0]), lo[1].min(next[1])], [hi[0].max(next[0]), hi[1].max(next[1])]);
                    ends += cell.ends.len();
                    came += cell.crossed;
                    border.push(next);
                }
            }
        }
        let place = [lo.map(|c| f64::from(c) * OBJECT_CELL_M), hi.map(|c| f64::from(c + 1) * OBJECT_CELL_M)];
        let share = ends as f64 / came.max(ends) as f64;
        errors.push(MapError {
            kind: MapErrorKind::MissingObject,
            place,
            offset_m: None,
            readings: ends,
            share,
        });
    }
    errors
}

#[cfg(test)]
mod tests {
    use locsim_comparison::Nuisances;
    use locsim_comparison::fixtures::{MEASURED, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_core::Pose2;
    use locsim_world::effect::{Effect, EffectKind};

    use super::*;
    use crate::Recorded;

    fn found(effects: &[Effect]) -> (Vec<MapError>, f64) {
        let drive = record_library(&MEASURED, &TRUTH, effects, Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let comparison = Comparison::new(&MEASURED, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let (errors, wrong) = find(&comparison, &fitted);
        (errors, wrong.iter().filter(|wrong| **wrong).count() as f64 / wrong.len() as f64)
    }

    /// A pole and a wide part of the robot, and a thing in the room, which a robot that turns sees at other bearings.
    #[test]
    fn what_is_on_the_robot_is_at_one_bearing() {
        let at = |scan: usize, bearing: f64| Place {
            beam: 0,
            scan,
            bearing,
            piece: 0,
            error: -1.0,
            offset: 0.0,
            is_far: true,
            is_return: true,
            is_beyond: false,
            class: [0; 2],
            origin: DVec2::ZERO,
            end: DVec2::ZERO,
        };
        let turn = |bearings: &[&[f64]]| {
            let scans = bearings.iter().enumerate();
            let places: Vec<Place> = scans
                .flat_map(|(scan, of_scan)| of_scan.iter().map(move |&bearing| at(scan, bearing)))
                .collect();
            turn_between_scans(&places.iter().collect::<Vec<_>>())
        };
        assert!(turn(&[&[3.1, -3.1], &[-3.1], &[3.1]]) < LEAST_TURN_RAD);
        assert!(turn(&[&[0.2, 0.4, 0.6], &[0.2, 0.4, 0.6], &[0.4]]) < LEAST_TURN_RAD);
        assert!(turn(&[&[3.1], &[-3.1], &[-2.9]]) > LEAST_TURN_RAD);
        assert_eq!(turn(&[]), 0.0);
    }

    /// Each error of the map is found where it is and as what it is, and nothing else is. Effects of the laser are no errors of
    /// the map.
    #[test]
    fn errors_of_the_map_are_told_from_those_of_the_laser() {
        let wall = |kind, value: f64, from: [f64; 2], to: [f64; 2]| {
            let mut effect = Effect::typical(kind, vec![[from.into(), to.into()]]);
            effect.values[0] = value;
            effect
        };
        let plain = |kind, values: &[f64]| Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
        let north = ([2.0, 4.0], [4.0, 4.0]);
        for (effect, kind, middle) in [
            (wall(EffectKind::MovedWall, 0.3, north.0, north.1), MapErrorKind::MovedWall, [3.0, 4.0]),
            (wall(EffectKind::Glass, 0.6, [5.0, 1.0], [5.0, 2.0]), MapErrorKind::Hole, [5.0, 1.5]),
            // Nothing is behind the outer wall: beams that pass it have no return.
            (wall(EffectKind::Glass, 0.3, north.0, north.1), MapErrorKind::Hole, [3.0, 4.0]),
            (plain(EffectKind::MissingObject, &[2.6, 2.0, 0.12]), MapErrorKind::MissingObject, [2.6, 2.0]),
        ] {
            let (errors, left_out) = found(std::slice::from_ref(&effect));
            assert!(!errors.is_empty() && left_out < 0.5, "{kind:?} {left_out}");
            for error in &errors {
                let [a, b] = error.place;
                let at = [0, 1].map(|i| 0.5 * (a[i] + b[i]));
                let away = (at[0] - middle[0]).hypot(at[1] - middle[1]);
                assert!(error.kind == kind && away < 1.1, "{error:?} for {kind:?}");
            }
        }
        for (kind, values) in [
            (EffectKind::RangeBias, &[0.1][..]),
            (EffectKind::RangeScale, &[0.03]),
            (EffectKind::MountYaw, &[0.035]),
            (EffectKind::Crosstalk, &[0.1, 1.0]),
            (EffectKind::SectorOcclusion, &[0.4, 0.8, 0.3, 0.2]),
            (EffectKind::IncidenceDropout, &[0.8, 0.6, 0.2]),
        ] {
            let (errors, _) = found(&[plain(kind, values)]);
            assert!(errors.is_empty(), "{kind}: {errors:?}");
        }
    }

    /// A log of another place has nothing that could be compared.
    #[test]
    fn a_log_that_the_map_says_nothing_of_is_refused() {
        let drive = record_library(&MEASURED, &TRUTH, &[], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 60, 24, |_| true).unwrap();
        let poses = recorded.track.poses().iter().map(|pose| Pose2::new(pose.x + 500.0, pose.y, pose.theta));
        let elsewhere = Recorded { track: recorded.track.with_poses(poses.collect()), ..recorded };
        let options = crate::GapOptions { replicates: 19, ..crate::GapOptions::default() };
        let stop = std::sync::atomic::AtomicBool::new(false);
        let refused = crate::find(&MEASURED, &elsewhere, &options, &(), &stop);
        assert!(matches!(refused, Err(crate::GapError::TooFewReadings { readings: 0, .. })), "{refused:?}");
    }
}
