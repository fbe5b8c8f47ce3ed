//! The time by which odometry lags behind the scans, from the turns that both show, and behind the reference.

use glam::DVec2;
use locsim_core::{Drive, DriveStep, Laser, Track, wrap_angle};

/// Scans that come more seldom \[s\] tell no lag: between them the odometry is interpolated.
const LONGEST_INTERVAL_SECS: f64 = 0.5;
/// Greatest lag that is looked for \[s\], and the step of the search.
const LAGS_SECS: (f64, f64) = (0.5, 0.01);
/// Pairs of scans that are compared, at the most: those that turn most.
const PAIRS: usize = 600;
/// Parts of the drive that are left out in turn.
const PARTS: usize = 8;
/// Clutter, noise of the wheels and readings between scans move the lag of a drive without any by this (standard deviation \[s\]): seventeen
/// simulated drives had 0 to 63 ms.
const SYSTEMATIC_SECS: f64 = 0.03;
/// Fewer turning pairs tell nothing.
const LEAST_PAIRS: usize = 30;
/// A pair turns when it turns by this much \[rad\], and by less than this: scans that turn more have too little in common.
const TURNING: (f64, f64) = (0.01, 0.35);
/// A difference of readings beyond this is of another surface \[m\].
const OTHER_SURFACE_M: f32 = 0.3;
/// The correlation of turns by scans and by odometry at the best lag: below, they don't agree at all.
const AGREEMENT: f64 = 0.8;

/// Steps between scans that are held against the reference, at the most.
const STEPS: usize = 2000;
/// A lag behind the reference is told that makes the differences of both, of distances and of turns, so many times smaller together.
const LEAST_GAIN: f64 = 3.0;
/// A lag below is within the interpolation \[s\].
const LEAST_SECS: f64 = 0.04;
/// Differences below are digits of the file \[m, rad\].
const DIGITS: f64 = 1e-4;

/// How much later than the reference the odometry shows the same motion \[s\]; 0 where a lag doesn't explain most of what they differ by.
pub(super) fn lag_to_reference(drive: &Drive) -> f64 {
    let Ok(track) = Track::new(drive.steps.iter().map(|step| (step.stamp_secs, step.odometry))) else {
        return 0.0;
    };
    let (most, step) = LAGS_SECS;
    let count = (most / step).round() as i32;
    let (secs, end) = (track.secs(), track.secs()[track.len() - 1]);
    let steps: Vec<_> = (1..drive.steps.len())
        .filter(|&i| secs[i - 1] >= most && secs[i] <= end - most)
        .filter(|&i| (1e-6..LONGEST_INTERVAL_SECS).contains(&(secs[i] - secs[i - 1])))
        .filter_map(|i| Some((i, drive.steps[i].reference?.relative_to(&drive.steps[i - 1].reference?))))
        .collect();
    let steps: Vec<_> = steps.iter().step_by(steps.len().div_ceil(STEPS).max(1)).collect();
    if steps.len() < LEAST_PAIRS {
        return 0.0;
    }
    // Mean differences along the way and of the turn, as the logarithm of their product.
    let difference = |lag: f64| {
        let mut sums = [DIGITS * steps.len() as f64; 2];
        for &&(i, reference) in &steps {
            let [from, to] = [i - 1, i].map(|i| track.pose_at(secs[i] + lag));
            let apart = reference.relative_to(&to.relative_to(&from));
            sums[0] += apart.position().length();
            sums[1] += wrap_angle(apart.theta).abs();
        }
        sums[0].ln() + sums[1].ln()
    };
    let differences: Vec<f64> = (-count..=count).map(|i| difference(f64::from(i) * step)).collect();
    let best = (0..differences.len()).min_by(|&a, &b| differences[a].total_cmp(&differences[b]));
    let best = best.unwrap_or(count as usize);
    let lag = f64::from(best as i32 - count) * step;
    // Between two poses the odometry jitters less: to either side that is the same.
    let rival = differences[count as usize].min(differences[differences.len() - 1 - best]);
    let is_inside = (1..differences.len() - 1).contains(&best);
    let is_sure = (rival - differences[best]).exp() >= LEAST_GAIN && lag.abs() >= LEAST_SECS;
    if is_inside && is_sure { lag } else { 0.0 }
}

/// The drive with the odometry so much earlier \[s\].
pub(super) fn with_earlier_odometry(drive: &Drive, lag_secs: f64) -> Drive {
    let Ok(track) = Track::new(drive.steps.iter().map(|step| (step.stamp_secs, step.odometry))) else {
        return drive.clone();
    };
    let end = track.secs()[track.len() - 1];
    // Beyond the ends nothing is known of the motion.
    let is_known = |secs: f64| (0.0..=end).contains(&(secs + lag_secs));
    let step = |(step, &secs): (&DriveStep, &f64)| DriveStep {
        odometry: track.pose_at(secs + lag_secs),
        reference: step.reference.filter(|_| is_known(secs)),
        ..step.clone()
    };
    Drive { laser: drive.laser.clone(), steps: drive.steps.iter().zip(track.secs()).map(step).collect() }
}

/// How much later than the scans the odometry shows the same turns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OdometryLag {
    /// The lag \[s\].
    pub secs: f64,
    /// Its standard error, by leaving out parts of the drive in turn (jackknife), and by what drives without a lag have \[s\].
    pub error_secs: f64,
}

/// The odometry's lag behind the scans; `None` where the robot turned too little, or scans are too rare.
pub(super) fn odometry_lag(drive: &Drive, interval_secs: f64) -> Option<OdometryLag> {
    if !(interval_secs > 0.0 && interval_secs < LONGEST_INTERVAL_SECS) {
        return None;
    }
    let track = Track::new(drive.steps.iter().map(|step| (step.stamp_secs, step.odometry))).ok()?;
    let turns = turns(drive, &track, interval_secs)?;
    if turns.len() < LEAST_PAIRS {
        return None;
    }
    let (most, step) = LAGS_SECS;
    let count = (most / step).round() as i32;
    // Of a laser that sweeps, a scan is taken about half a sweep after its stamp.
    let times = drive.laser.beam_times_secs();
    let middle = times.iter().map(|secs| f64::from(*secs)).sum::<f64>() / times.len().max(1) as f64;
    let sums = |lag: i32| {
        let mut parts = [PairSums::default(); PARTS];
        for (i, &(from, to, turn)) in turns.iter().enumerate() {
            let [a, b] = [from, to].map(|secs| track.pose_at(secs + middle + f64::from(lag) * step).theta);
            parts[i * PARTS / turns.len()].add(wrap_angle(b - a), turn);
        }
        parts
    };
    let lags: Vec<[PairSums; PARTS]> = (-count..=count).map(sums).collect();
    // The lag and the correlation at it, without one of the parts.
    let best = |left_out: Option<usize>| {
        let of_lag = |parts: &[PairSums; PARTS]| {
            let kept = parts.iter().enumerate().filter(|(i, _)| Some(*i) != left_out);
            kept.fold(PairSums::default(), |sum, (_, part)| sum.plus(part)).correlation()
        };
        let all: Vec<f64> = lags.iter().map(of_lag).collect();
        let (best, most) = all.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        let bend = if (1..all.len() - 1).contains(&best) {
            2.0 * all[best] - all[best - 1] - all[best + 1]
        } else {
            return None;
        };
        let fraction = if bend > 0.0 { 0.5 * (all[best + 1] - all[best - 1]) / bend } else { 0.0 };
        Some(((f64::from(best as i32 - count) + fraction) * step, *most))
    };
    let (secs, agreement) = best(None)?;
    let without: Vec<f64> = (0..PARTS).filter_map(|part| Some(best(Some(part))?.0)).collect();
    let mean = without.iter().sum::<f64>() / without.len() as f64;
    let squares = without.iter().map(|lag| (lag - mean).powi(2)).sum::<f64>();
    let error_secs =
        (squares * (without.len() as f64 - 1.0) / without.len() as f64).sqrt().hypot(SYSTEMATIC_SECS);
    (agreement > AGREEMENT && without.len() == PARTS).then_some(OdometryLag { secs, error_secs })
}

/// Pairs of scans between which the robot turns: their times \[s\], and the turn that the scans show \[rad\].
fn turns(drive: &Drive, track: &Track, interval_secs: f64) -> Option<Vec<(f64, f64, f64)>> {
    let beam_rad = even_spacing(drive.laser.bearings())?;
    let mut turning: Vec<usize> = (1..drive.steps.len())
        .filter(|&i| {
            let secs = track.secs()[i] - track.secs()[i - 1];
            let turn = wrap_angle(drive.odometry_increment(i).theta).abs();
            secs > 0.0 && secs < 2.0 * interval_secs && (TURNING.0..TURNING.1).contains(&turn)
        })
        .collect();
    let stride = turning.len().div_ceil(PAIRS).max(1);
    turning = turning.into_iter().step_by(stride).collect();
    let laser_at = |i: usize| drive.steps[i].odometry.compose(&drive.laser.base_from_laser());
    let turn = |i: usize| {
        let [before, after] = [i - 1, i].map(|i| drive.steps[i].scan.ranges.as_slice());
        // Driving past walls turns a scan as well.
        let moved = laser_at(i).relative_to(&laser_at(i - 1)).position();
        let before = seen_from(moved, before, &drive.laser, beam_rad);
        let turn = turn_between(&before, after, beam_rad, drive.laser.max_range())?;
        Some((track.secs()[i - 1], track.secs()[i], turn))
    };
    Some(turning.into_iter().filter_map(turn).collect())
}

/// Sums over pairs of numbers that their correlation takes.
#[derive(Clone, Copy, Default)]
struct PairSums([f64; 6]);

impl PairSums {
    fn add(&mut self, x: f64, y: f64) {
        *self = self.plus(&Self([1.0, x, y, x * x, x * y, y * y]));
    }

    fn plus(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }

    /// Pearson's correlation: blind to the scale and to a constant bias.
    fn correlation(&self) -> f64 {
        let [n, x, y, xx, xy, yy] = self.0;
        let [xx, xy, yy] = [xx - x * x / n, xy - x * y / n, yy - y * y / n];
        if xx * yy > 0.0 { xy / (xx * yy).sqrt() } else { 0.0 }
    }
}

/// The spacing of evenly spaced beams \[rad\].
fn even_spacing(bearings: &[f32]) -> Option<f64> {
    let spacing = f64::from(bearings.get(1)? - bearings[0]);
    let even = bearings.windows(2).all(|pair| (f64::from(pair[1] - pair[0]) - spacing).abs() < 1e-4);
    (even && spacing.abs() > 1e-4).then_some(spacing)
}

/// A scan as it is seen from elsewhere, by a laser that hasn't turned. Beams that what it saw says nothing of have no return.
pub(super) fn seen_from(place: DVec2, ranges: &[f32], laser: &Laser, beam_rad: f64) -> Vec<f32> {
    let (first, max) = (f64::from(laser.bearings()[0]), laser.max_range());
    let mut seen = vec![max; ranges.len()];
    // The beam, to a fraction, and the range of each point.
    let points = ranges.iter().zip(laser.bearings()).map(|(&range, &bearing)| {
        (range < max).then(|| {
            let point = f64::from(range) * DVec2::from_angle(f64::from(bearing)) - place;
            let beam = f64::from(bearing) + wrap_angle(point.to_angle() - f64::from(bearing)) - first;
            (beam / beam_rad, point.length())
        })
    });
    let points: Vec<_> = points.collect();
    for pair in points.windows(2) {
        let [Some((from, near)), Some((to, far))] = *pair else { continue };
        if to <= from || to < 0.0 || (far - near).abs() > f64::from(OTHER_SURFACE_M) {
            continue;
        }
        for beam in from.ceil().max(0.0) as usize..=to.floor() as usize {
            let range = near + (far - near) * (beam as f64 - from) / (to - from);
            if let Some(seen) = seen.get_mut(beam) {
                *seen = seen.min(range as f32);
            }
        }
    }
    seen
}

/// The turn between two scans \[rad\] by the shift of their beams at which they agree best, to a fraction of a beam.
fn turn_between(before: &[f32], after: &[f32], beam_rad: f64, max_range: f32) -> Option<f64> {
    let most = ((1.5 * TURNING.1 / beam_rad.abs()).ceil() as usize).min(before.len() / 3);
    let apart = |shift: isize| {
        let (mut sum, mut count) = (0.0, 0_u32);
        for (beam, &range) in after.iter().enumerate() {
            let Some(&other) = beam.checked_add_signed(shift).and_then(|beam| before.get(beam)) else {
                continue;
            };
            if range < max_range && other < max_range {
                sum += (range - other).abs().min(OTHER_SURFACE_M);
                count += 1;
            }
        }
        (count > 0).then(|| f64::from(sum) / f64::from(count))
    };
    let shifts = -(most as isize)..=most as isize;
    let (best, least) =
        shifts.filter_map(|shift| Some((shift, apart(shift)?))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    let [below, above] = [apart(best - 1)?, apart(best + 1)?];
    let bend = below + above - 2.0 * least;
    let fraction = if bend > 0.0 { 0.5 * (below - above) / bend } else { 0.0 };
    Some((best as f64 + fraction) * beam_rad)
}
