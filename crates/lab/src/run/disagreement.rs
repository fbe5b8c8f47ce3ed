//! Where the reference poses of a log and its map disagree.

use std::ops::Range;

use locsim_core::{DistanceMap, Drive, DriveStep, Laser, Pose2};
use locsim_report::results::Disagreement;
use rayon::prelude::*;

/// A robot that has moved by less than this \[m\], a radian counting as a metre, sees the same again.
const MOVES_M: f64 = 0.2;
/// Scans of a window, half of which search for a common pose beside the references; the other half says whether it is better.
const WINDOW: usize = 10;
/// At most this many scans of a drive are looked at, and so many beams of each, evenly chosen.
const MOST_SCANS: usize = 1000;
const MOST_BEAMS: usize = 72;

/// Poses beside the reference: to so many steps of this length \[m\] either way in x and y ..
const SHIFTS: i32 = 10;
const SHIFT_M: f64 = 0.05;
/// .. and turned by so many steps of this angle \[rad\].
const TURNS: i32 = 2;
const TURN_RAD: f64 = 0.01;

/// Readings within about this of a surface are of it \[m\]; this share of them may end anywhere.
const NEAR_M: f64 = 0.05;
const ANYWHERE: f32 = 0.05;

/// A disagreement is told from here on \[m\]: it is then larger than what a good filter errs by.
const LEAST_M: f64 = 0.1;
/// Both halves of a window have to find the same shift, to this \[m\] ..
const SAME_M: f64 = 0.08;
/// .. and to gain so much by that of the other \[nats\] in a scan, on average, and at all in this share of the scans.
const LEAST_NATS: f32 = 2.0;
const LEAST_SHARE: f64 = 0.7;

/// A pose beside the reference: metres along the map's axes, and an angle.
#[derive(Clone, Copy)]
struct Shift {
    x: f64,
    y: f64,
    turn: f64,
}

impl Shift {
    const NONE: Self = Self { x: 0.0, y: 0.0, turn: 0.0 };

    /// All that are tried, none first: it wins where others are as good.
    fn all() -> Vec<Self> {
        let mut all = vec![Self::NONE];
        for turn in -TURNS..=TURNS {
            for x in -SHIFTS..=SHIFTS {
                for y in -SHIFTS..=SHIFTS {
                    if [x, y, turn] != [0; 3] {
                        let turn = f64::from(turn) * TURN_RAD;
                        all.push(Self { x: f64::from(x) * SHIFT_M, y: f64::from(y) * SHIFT_M, turn });
                    }
                }
            }
        }
        all
    }

    fn length(self) -> f64 {
        self.x.hypot(self.y)
    }

    fn of(self, reference: &Pose2) -> Pose2 {
        Pose2::new(reference.x + self.x, reference.y + self.y, reference.theta + self.turn)
    }
}

/// How well a scan fits the map.
#[derive(Clone, Copy, Default)]
struct Fit {
    /// Log likelihood by where its readings end \[nats\].
    nats: f32,
    /// Readings that end near a surface, of all that ended.
    near: u32,
    returns: u32,
}

/// How well a scan fits the map from this pose of the robot.
fn fit(map: &dyn DistanceMap, laser: &Laser, step: &DriveStep, robot: Pose2) -> Fit {
    let pose = robot.compose(&laser.base_from_laser());
    let mut fit = Fit::default();
    let stride = laser.beam_count().div_ceil(MOST_BEAMS).max(1);
    for (&z, &bearing) in step.scan.ranges.iter().zip(laser.bearings()).step_by(stride) {
        if z < laser.max_range() {
            let (sin, cos) = locsim_core::sin_cos(pose.theta + f64::from(bearing));
            let distance = map.distance(pose.x + f64::from(z) * cos, pose.y + f64::from(z) * sin);
            let deviations = distance / NEAR_M as f32;
            fit.nats += (ANYWHERE + (1.0 - ANYWHERE) * (-0.5 * deviations * deviations).exp()).ln();
            fit.near += u32::from(f64::from(distance) <= NEAR_M);
            fit.returns += 1;
        }
    }
    fit
}

/// Indices of the scans that are looked at: those with a reference pose from which the robot has moved since the one before.
fn looked_at(localized: &Drive) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    for (i, step) in localized.steps.iter().enumerate() {
        let Some(reference) = step.reference else { continue };
        let last = chosen.last().and_then(|&last| localized.steps[last].reference);
        let moved = last.is_none_or(|last| {
            let way = reference.relative_to(&last);
            way.position().length() + way.theta.abs() >= MOVES_M
        });
        if moved {
            chosen.push(i);
        }
    }
    let stride = chosen.len().div_ceil(MOST_SCANS).max(1);
    chosen.into_iter().step_by(stride).collect()
}

/// The shift that all scans of a window fit better from, if there is one: `nats` has the log likelihood of each scan under each shift.
fn common_shift(nats: &[Vec<f32>], shifts: &[Shift]) -> Option<Shift> {
    let half = |parity: usize| nats.iter().skip(parity).step_by(2);
    let best = |parity: usize| {
        let mut best = (f32::NEG_INFINITY, 0);
        for i in 0..shifts.len() {
            let sum = half(parity).map(|scan| scan[i]).sum();
            if sum > best.0 {
                best = (sum, i);
            }
        }
        best.1
    };
    let found = [best(0), best(1)];
    let [even, odd] = found.map(|i| shifts[i]);
    let gains: Vec<f32> = half(1)
        .map(|scan| scan[found[0]] - scan[0])
        .chain(half(0).map(|scan| scan[found[1]] - scan[0]))
        .collect();
    let mean = gains.iter().sum::<f32>() / gains.len() as f32;
    let better = gains.iter().filter(|gain| **gain > 0.0).count() as f64;
    let is_same = (even.x - odd.x).hypot(even.y - odd.y) <= SAME_M;
    let is_large = even.length().min(odd.length()) >= LEAST_M;
    (is_same && is_large && mean >= LEAST_NATS && better >= LEAST_SHARE * gains.len() as f64).then_some(
        Shift { x: 0.5 * (even.x + odd.x), y: 0.5 * (even.y + odd.y), turn: 0.5 * (even.turn + odd.turn) },
    )
}

/// The stretches of `localized` whose scans all fit the map better from poses beside their reference poses.
pub(super) fn disagreements(map: &dyn DistanceMap, localized: &Drive) -> Vec<Disagreement> {
    let scans = looked_at(localized);
    let laser = &localized.laser;
    if scans.len() < WINDOW {
        return Vec::new();
    }
    let shifts = Shift::all();
    let fit_from = |scan: usize, shift: Shift| {
        let step = &localized.steps[scan];
        step.reference.map_or(Fit::default(), |reference| fit(map, laser, step, shift.of(&reference)))
    };
    let nats: Vec<Vec<f32>> = scans
        .par_iter()
        .map(|&scan| shifts.iter().map(|&shift| fit_from(scan, shift).nats).collect())
        .collect();
    let starts = (0..=scans.len() - WINDOW).step_by(WINDOW / 2).chain([scans.len() - WINDOW]);
    let mut found: Vec<(Range<usize>, Vec<Shift>)> = Vec::new();
    for start in starts {
        let window = start..start + WINDOW;
        let Some(shift) = common_shift(&nats[window.clone()], &shifts) else { continue };
        match found.last_mut() {
            Some((before, shifts)) if before.end >= window.start => {
                before.end = window.end;
                shifts.push(shift);
            }
            _ => found.push((window, vec![shift])),
        }
    }
    found
        .into_iter()
        .map(|(stretch, shifts)| {
            let of_all = |from: &dyn Fn(usize) -> Fit| {
                let (near, returns) = stretch.clone().fold((0, 0), |(near, returns), i| {
                    let fit = from(i);
                    (near + fit.near, returns + fit.returns)
                });
                f64::from(near) / f64::from(returns.max(1))
            };
            let best = |i: usize| {
                let fits = shifts.iter().map(|shift| fit_from(scans[i], *shift));
                fits.max_by(|a, b| a.nats.total_cmp(&b.nats)).unwrap_or_default()
            };
            let lengths = || shifts.iter().map(|shift| shift.length());
            Disagreement {
                first_scan: scans[stretch.start] as u32,
                last_scan: scans[stretch.end - 1] as u32,
                least_m: lengths().fold(f64::INFINITY, f64::min),
                most_m: lengths().fold(0.0, f64::max),
                near_m: NEAR_M,
                near_share: of_all(&|i| fit_from(scans[i], Shift::NONE)),
                near_share_beside: of_all(&best),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Scan, Stage};
    use rand::RngExt;

    use super::*;

    /// A room of 6 x 4 m around the origin.
    struct Room;

    impl DistanceMap for Room {
        fn distance(&self, x: f64, y: f64) -> f32 {
            (x.abs() - 3.0).abs().min((y.abs() - 2.0).abs()) as f32
        }
    }

    /// A drive of `scans` along the room, with references that are off by `off` in x from scan 30 on, and with readings of
    /// the room, 1 cm of noise and 20 % of them at anything else.
    fn drive(scans: usize, off: f64, seed: u64) -> Drive {
        let bearings: Vec<f32> = (0..36).map(|i| i as f32 * 0.17).collect();
        let laser = Laser::new(bearings, vec![0.0; 36], 0.0, 10.0, Pose2::IDENTITY).unwrap();
        let steps = (0..scans).map(|i| {
            let mut rng = Draw::new(seed, Stage::Trial, 3).item(i as u32);
            let pose = Pose2::new(1.5 * (0.3 * i as f64).sin(), 0.8 * (0.2 * i as f64).cos(), 0.1 * i as f64);
            let ranges = laser.bearings().iter().map(|&bearing| {
                let (sin, cos) = (pose.theta + f64::from(bearing)).sin_cos();
                let wall = ((3.0 - pose.x * cos.signum()) / cos.abs())
                    .min((2.0 - pose.y * sin.signum()) / sin.abs());
                let share = if rng.random::<f64>() < 0.2 { rng.random::<f64>() } else { 1.0 };
                (share * wall + 0.02 * (rng.random::<f64>() - 0.5)) as f32
            });
            DriveStep {
                stamp_secs: i as f64,
                odometry: pose,
                scan: Scan { ranges: ranges.collect() },
                reference: Some(Pose2::new(pose.x + if i >= 30 { off } else { 0.0 }, pose.y, pose.theta)),
            }
        });
        let steps = steps.collect();
        Drive { laser, steps }
    }

    #[test]
    fn a_reference_beside_the_map_is_found_where_it_is() {
        let found = disagreements(&Room, &drive(60, 0.3, 1));
        let [found] = found.as_slice() else { panic!("{found:?}") };
        assert!((25..=33).contains(&found.first_scan) && found.last_scan == 59, "{found:?}");
        assert!((found.most_m - 0.3).abs() < 0.03, "{found:?}");
        assert!(found.near_share < 0.5 && found.near_share_beside > 0.7, "{found:?}");
    }

    /// Clutter has no shift in common. None of 396 windows: a rate below 1 in 130 at 95 %.
    #[test]
    fn clutter_is_no_disagreement() {
        for seed in 0..4 {
            let found = disagreements(&Room, &drive(500, 0.0, seed));
            assert!(found.is_empty(), "{seed}: {found:?}");
        }
    }

    /// Along a wall without an end, no place is better than another.
    #[test]
    fn what_the_map_cannot_tell_is_no_disagreement() {
        struct Walls;
        impl DistanceMap for Walls {
            fn distance(&self, _: f64, y: f64) -> f32 {
                (y.abs() - 2.0).abs() as f32
            }
        }
        let mut along = drive(60, 0.3, 1);
        for step in &mut along.steps {
            for (z, &bearing) in step.scan.ranges.iter_mut().zip(along.laser.bearings()) {
                let reference = step.reference.unwrap();
                let sin = (reference.theta + f64::from(bearing)).sin();
                *z = ((2.0 - reference.y * sin.signum()) / sin.abs()) as f32;
            }
        }
        assert!(disagreements(&Walls, &along).is_empty());
    }

    #[test]
    fn a_short_drive_says_nothing() {
        assert!(disagreements(&Room, &drive(WINDOW - 1, 0.3, 1)).is_empty());
        assert!(disagreements(&Room, &drive(0, 0.3, 1)).is_empty());
    }
}
