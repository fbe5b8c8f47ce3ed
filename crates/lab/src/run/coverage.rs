//! The parts of the localized drive that the training scans and the map of a log don't cover.

use std::collections::{BTreeMap, BTreeSet};

use locsim_core::{DistanceMap, Drive, Hits, Laser, Particles, Pose2, RangeMap};

/// Bins of incidence, of 15 degrees.
const INCIDENCES: u8 = 6;

/// A warning is due when more than this share of the beams lies outside.
const SHARE: f64 = 0.01;

/// A return that ends farther than this from any surface ends where the map has nothing \[m\]: far more than a reference
/// pose is off.
const NEAR_M: f32 = 0.5;

/// People, glass and what was moved make up to a fifth of the readings far from the map's walls.
const MOST_FAR: f64 = 0.3;

/// Shorter steps have no direction \[m\]: the reference is off by centimetres.
const MOVES_M: f64 = 0.03;

/// A bin of a beam's state: nominal range by octaves of the maximum range, from 0 beyond it to 7 below a 64th, and
/// incidence.
type State = (u8, u8);

fn state(range: f32, incidence: f32, max_range: f32) -> State {
    let octave = (0..7).take_while(|&i| range < max_range / (1_u32 << i) as f32).count();
    let incidence = (incidence / std::f32::consts::FRAC_PI_2 * f32::from(INCIDENCES)) as u8;
    (octave as u8, incidence.min(INCIDENCES - 1))
}

/// What every beam meets from every pose, poses outermost.
fn met(map: &dyn RangeMap, laser: &Laser, poses: impl Iterator<Item = Pose2>) -> Hits {
    let poses: Particles = poses.map(|pose| pose.compose(&laser.base_from_laser())).collect();
    let mut hits = Hits::default();
    map.cast(poses.as_poses(), laser.bearings(), laser.cast_range(), &mut hits);
    hits
}

/// Nominal ranges and incidences of every beam from every pose, poses outermost.
fn states(map: &dyn RangeMap, laser: &Laser, poses: impl Iterator<Item = Pose2>) -> Vec<State> {
    let hits = met(map, laser, poses);
    let hits = hits.range.iter().zip(&hits.incidence);
    hits.map(|(&range, &incidence)| state(range, incidence, laser.max_range())).collect()
}

/// A sentence on the beams of `localized` whose state no beam of the training scans has.
pub(super) fn untrained_states(
    map: &dyn RangeMap,
    training: (&Laser, &[Pose2]),
    localized: &Drive,
) -> Option<String> {
    let (laser, poses) = training;
    let known: BTreeSet<State> = states(map, laser, poses.iter().copied()).into_iter().collect();
    let reference = |step: &locsim_core::DriveStep| step.reference;
    let beams = localized.laser.beam_count();
    let found = states(map, &localized.laser, localized.steps.iter().filter_map(reference));
    let mut outside: BTreeMap<State, u32> = BTreeMap::new();
    let mut first = None;
    for (i, state) in found.iter().enumerate().filter(|(_, state)| !known.contains(state)) {
        *outside.entry(*state).or_default() += 1;
        first.get_or_insert(i / beams);
    }
    let count: u32 = outside.values().sum();
    let (&(octave, incidence), _) = outside.iter().max_by_key(|(_, count)| **count)?;
    if f64::from(count) <= SHARE * found.len() as f64 {
        return None;
    }
    let max_range = laser.max_range();
    let at = |octave: u8| max_range / (1_u32 << octave) as f32;
    let range = match octave {
        0 => format!("no surface within {max_range} m"),
        7 => format!("a range below {:.1} m", at(6)),
        _ => format!("a range of {:.1} to {:.1} m", at(octave), at(octave - 1)),
    };
    let degrees = 90 / u32::from(INCIDENCES) * u32::from(incidence);
    let slant = if octave == 0 {
        String::new()
    } else {
        format!(" at {degrees} to {} degrees", degrees + 90 / u32::from(INCIDENCES))
    };
    Some(format!(
        "{count} of {} beams ({:.0} %) of the localized part have a nominal range and incidence that no training beam has, \
         the first in scan {}, most of them {range}{slant}: there the models extrapolate.",
        found.len(),
        100.0 * f64::from(count) / found.len() as f64,
        first.unwrap_or_default(),
    ))
}

/// A sentence on steps in which the odometry goes the other way than the reference. Some mapping programs write its length without its
/// sign, and a filter follows it.
pub(super) fn against_odometry(localized: &Drive) -> Option<String> {
    let way = |i: usize| localized.odometry_increment(i).position().length();
    let against: Vec<usize> = (1..localized.steps.len())
        .filter(|&i| {
            let [from, to] = [i - 1, i].map(|i| localized.steps[i].reference);
            let (Some(from), Some(to)) = (from, to) else { return false };
            let reference = to.relative_to(&from).position();
            let odometry = localized.odometry_increment(i).position();
            let moves = reference.length() > MOVES_M && odometry.length() > MOVES_M;
            moves && reference.dot(odometry) < 0.0
        })
        .collect();
    let driven: f64 = (1..localized.steps.len()).map(way).sum();
    let wrong: f64 = against.iter().map(|&i| way(i)).sum();
    let first = against.first()?;
    (wrong > SHARE * driven).then(|| {
        format!(
            "On {wrong:.1} of {driven:.1} m of the localized part the odometry goes forward where the reference goes back, or the other way \
             round, the first time in scan {first}: filters follow the odometry, and get lost there."
        )
    })
}

/// A sentence on reference poses that lie where the map has no free space, if many do.
pub(super) fn outside_of_map(map: &dyn RangeMap, localized: &Drive) -> Option<String> {
    let known = localized.steps.iter().filter_map(|step| step.reference);
    let (outside, all) = known
        .fold((0, 0), |(outside, all), pose| (outside + usize::from(!map.is_free(pose.x, pose.y)), all + 1));
    (10 * outside > all).then(|| {
        format!(
            "{outside} of {all} localized scans have a reference pose outside of the map's free space. Is the reference in the map's frame?"
        )
    })
}

/// A sentence on readings that are far from what the map has, seen from the reference poses, if many are.
pub(super) fn unlike_map(map: &dyn RangeMap, localized: &Drive) -> Option<String> {
    let laser = &localized.laser;
    let known = || localized.steps.iter().filter_map(|step| Some((step.reference?, &step.scan.ranges)));
    let hits = met(map, laser, known().map(|(pose, _)| pose));
    let readings = known().flat_map(|(_, ranges)| ranges).zip(&hits.range);
    let returns = readings.filter(|&(&z, &range)| z < laser.max_range() && range < laser.cast_range());
    let (far, all) = returns.fold((0_usize, 0_usize), |(far, all), (z, range)| {
        (far + usize::from((z - range).abs() > NEAR_M), all + 1)
    });
    (far as f64 > MOST_FAR * all as f64).then(|| {
        format!(
            "{:.0} % of the readings of the localized part are more than {NEAR_M} m from what the map has there, seen from the reference \
             poses: the map is of another place or another time, or the laser's mount, or the order of its beams, isn't as given.",
            100.0 * far as f64 / all as f64
        )
    })
}

/// A sentence on the first scan, if it was taken where there is no map.
pub(super) fn unmapped_start(
    map: &dyn RangeMap,
    distance: &dyn DistanceMap,
    localized: &Drive,
) -> Option<String> {
    let step = localized.steps.first()?;
    let pose = step.reference?;
    if !map.is_free(pose.x, pose.y) {
        return Some(
            "The first scan was taken in unmapped space: its reference pose isn't in the map's free space."
                .to_owned(),
        );
    }
    let laser = pose.compose(&localized.laser.base_from_laser());
    let returns = step.scan.ranges.iter().zip(localized.laser.bearings());
    let returns: Vec<bool> = returns
        .filter(|(z, _)| **z < localized.laser.max_range())
        .map(|(&z, &bearing)| {
            let (sin, cos) = (laser.theta + f64::from(bearing)).sin_cos();
            distance.distance(laser.x + f64::from(z) * cos, laser.y + f64::from(z) * sin) <= NEAR_M
        })
        .collect();
    let near = returns.iter().filter(|near| **near).count();
    (2 * near < returns.len()).then(|| {
        format!(
            "The first scan was taken in unmapped space: {near} of its {} returns end within {NEAR_M} m of a mapped \
             surface.",
            returns.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use locsim_core::{DriveStep, Scan};

    use super::*;

    /// A wall at `range` in every direction, and free space everywhere.
    struct Around {
        range: f32,
    }

    impl RangeMap for Around {
        fn cast(&self, laser: locsim_core::Poses<'_>, bearings: &[f32], _: f32, out: &mut Hits) {
            out.resize(laser.len() * bearings.len());
            // Farther by x.
            for (i, range) in out.range.iter_mut().enumerate() {
                *range = self.range + laser.x[i / bearings.len()] as f32;
            }
            out.incidence.fill(0.1);
        }

        fn is_free(&self, x: f64, _: f64) -> bool {
            x < 50.0
        }

        fn bounds(&self) -> [f64; 4] {
            [0.0, 0.0, 1.0, 1.0]
        }
    }

    impl DistanceMap for Around {
        fn distance(&self, x: f64, y: f64) -> f32 {
            (x.hypot(y) as f32 - self.range).abs()
        }
    }

    fn drive(x: &[f64], z: f32) -> Drive {
        let laser = Laser::new(vec![-0.5, 0.0, 0.5], vec![0.0; 3], 0.0, 8.0, Pose2::IDENTITY).unwrap();
        let step = |&x: &f64| DriveStep {
            stamp_secs: 0.0,
            odometry: Pose2::IDENTITY,
            reference: Some(Pose2::new(x, 0.0, 0.0)),
            scan: Scan { ranges: vec![z; 3] },
        };
        Drive { laser, steps: x.iter().map(step).collect() }
    }

    #[test]
    fn states_that_no_training_beam_has_are_counted() {
        let map = Around { range: 1.5 };
        let localized = drive(&[0.0, 0.2, 1.0], 1.5);
        let training = [Pose2::IDENTITY];
        let sentence = untrained_states(&map, (&localized.laser, &training), &localized).unwrap();
        let expected = "3 of 9 beams (33 %) of the localized part have a nominal range and incidence that no training beam \
                        has, the first in scan 2, most of them a range of 2.0 to 4.0 m at 0 to 15 degrees: there the models \
                        extrapolate.";
        assert_eq!(sentence, expected);
        let near = drive(&[0.0, 0.2], 1.5);
        assert_eq!(untrained_states(&map, (&near.laser, &training), &near), None);
    }

    #[test]
    fn a_reference_in_another_frame_is_told() {
        let map = Around { range: 1.5 };
        assert_eq!(outside_of_map(&map, &drive(&[0.0, 1.0, 2.0, 3.0], 1.5)), None);
        let sentence = outside_of_map(&map, &drive(&[0.0, 1.0, 70.0, 80.0], 1.5)).unwrap();
        assert!(sentence.starts_with("2 of 4 localized scans"), "{sentence}");
    }

    #[test]
    fn a_map_of_another_place_is_told() {
        let map = Around { range: 1.5 };
        assert_eq!(unlike_map(&map, &drive(&[0.0, 0.2], 1.6)), None);
        let sentence = unlike_map(&map, &drive(&[0.0, 0.2], 3.0)).unwrap();
        assert!(sentence.starts_with("100 % of the readings"), "{sentence}");
    }

    #[test]
    fn odometry_that_goes_the_other_way_is_said() {
        let mut localized = drive(&[0.0, 0.5, 1.0, 0.5], 1.5);
        for (step, x) in localized.steps.iter_mut().zip([0.0, 0.5, 1.0, 0.5]) {
            step.odometry = Pose2::new(x, 0.0, 0.0);
        }
        assert_eq!(against_odometry(&localized), None);
        localized.steps[3].odometry.x = 1.5;
        let sentence = against_odometry(&localized).unwrap();
        assert!(sentence.starts_with("On 0.5 of 1.5 m") && sentence.contains("in scan 3:"), "{sentence}");
    }

    #[test]
    fn a_start_without_a_map_is_said() {
        let map = Around { range: 1.5 };
        assert_eq!(unmapped_start(&map, &map, &drive(&[0.0], 1.6)), None);
        let beside = unmapped_start(&map, &map, &drive(&[0.0], 3.0)).unwrap();
        assert!(beside.contains("0 of its 3 returns"), "{beside}");
        let outside = unmapped_start(&map, &map, &drive(&[60.0], 1.6)).unwrap();
        assert!(outside.contains("isn't in the map's free space"), "{outside}");
    }
}
