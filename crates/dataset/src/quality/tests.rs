use std::f64::consts::{FRAC_PI_2, TAU};

use locsim_core::{Drive, DriveStep, Laser, Pose2, Scan};

use super::*;
use crate::{LogKind, MountSource};

/// The room that the robot drives in: walls at |x| = 4 m and |y| = 3 m.
const WALLS: [f64; 2] = [4.0, 3.0];
/// Seconds between scans.
const INTERVAL: f64 = 0.1;

/// Uniform numbers in [0, 1) of a linear congruential generator (Numerical Recipes).
struct Uniform(u32);

impl Uniform {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0) / 4_294_967_296.0
    }

    /// Nearly normal, of deviation 1.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}

fn range(laser: &Pose2, bearing: f64) -> f64 {
    let (sin, cos) = (laser.theta + bearing).sin_cos();
    let to = |at: f64, along: f64, wall: f64| {
        if along == 0.0 { f64::INFINITY } else { (wall * along.signum() - at) / along }
    };
    to(laser.x, cos, WALLS[0]).min(to(laser.y, sin, WALLS[1]))
}

/// How a drive is recorded.
#[derive(Clone, Copy)]
struct Recording {
    sigma_m: f64,
    sigma_per_m: f64,
    step_m: f64,
    /// The odometry reads distances times this.
    scale: f64,
    /// Odometry is this late (s).
    lag_secs: f64,
}

/// Three seconds of standing still, then a minute around the room: straight on and turning, swinging a little.
fn drive(recording: Recording) -> Drive {
    let Recording { sigma_m, sigma_per_m, step_m, scale, lag_secs } = recording;
    let bearings: Vec<f32> = (0..180).map(|beam| (f64::from(beam) - 90.0).to_radians() as f32).collect();
    let mount = Pose2::new(0.1, 0.0, 0.0);
    let laser = Laser::new(bearings.clone(), vec![0.0; 180], 0.1, 20.0, mount).unwrap();
    // Driven with turn rates that swing, so that turns tell the time.
    let pose_at = |secs: f64| {
        let t = (secs - 3.0).clamp(0.0, 60.0);
        let angle = 0.25 * t;
        let swing = if t > 0.0 { 0.3 * (1.3 * t).sin() } else { 0.0 };
        Pose2::new(1.5 * angle.cos(), 1.2 * angle.sin(), angle + FRAC_PI_2 + swing)
    };
    let odometry_at = |secs: f64| {
        let pose = pose_at(secs - lag_secs);
        Pose2::new(scale * pose.x, scale * pose.y, pose.theta)
    };
    let mut uniform = Uniform(7);
    let steps = (0..600).map(|i| {
        let secs = f64::from(i) * INTERVAL;
        let pose = pose_at(secs);
        let at = pose.compose(&mount);
        let reading = |&bearing: &f32| {
            let range = range(&at, f64::from(bearing));
            let noisy = range + (sigma_m + sigma_per_m * range) * uniform.normal();
            let read = if step_m > 0.0 { (noisy / step_m).round() * step_m } else { noisy };
            read as f32
        };
        let ranges = bearings.iter().map(reading).collect();
        DriveStep {
            stamp_secs: 1.7e9 + secs,
            odometry: odometry_at(secs),
            reference: Some(pose),
            scan: Scan { ranges },
        }
    });
    Drive { steps: steps.collect(), laser }
}

const PLAIN: Recording =
    Recording { sigma_m: 0.02, sigma_per_m: 0.0, step_m: 0.0, scale: 1.0, lag_secs: 0.0 };

fn summary() -> LogSummary {
    LogSummary {
        between: Vec::new(),
        remarks: Vec::new(),
        kind: LogKind::Referenced,
        odometry: OdometrySource::Topic,
        evidence: String::new(),
        scan_source: "/scan".to_owned(),
        odometry_messages: 600,
        odometry_interval_secs: None,
        reference_messages: 600,
        reference_deviation: None,
        reference_interval_secs: None,
        references_interpolated: 0,
        mount: MountSource::Given,
        topics: Vec::new(),
        transforms: Vec::new(),
        skipped: std::collections::BTreeMap::new(),
        stamps_repaired: 0,
        stamps_repeated: 0,
        scans_dropped: 0,
        intervals_without_odometry: 0,
        no_return_share: 0.0,
        unusable_share: 0.0,
        longest_return_m: None,
    }
}

fn quality(recording: Recording) -> DriveQuality {
    DriveQuality::of(&drive(recording), &summary())
}

fn near(found: Option<f64>, wanted: f64, tolerance: f64) {
    assert!(found.is_some_and(|found| (found - wanted).abs() <= tolerance), "{found:?}, not {wanted}");
}

#[test]
fn noise_and_resolution_come_from_the_readings() {
    for (sigma_m, step_m) in [(0.02, 0.0), (0.02, 0.01), (0.005, 0.001)] {
        let readings = quality(Recording { sigma_m, step_m, ..PLAIN }).readings;
        match readings.resolution_m {
            None => assert_eq!(step_m, 0.0),
            found => near(found, step_m, 1e-3 * step_m.max(1e-9)),
        }
        assert!(readings.still_scans >= 30, "{}", readings.still_scans);
        near(readings.still_noise_m, sigma_m, 0.05 * sigma_m);
        near(readings.flat_noise_m, sigma_m.hypot(step_m / 12.0_f64.sqrt()), 0.15 * sigma_m);
        assert_eq!(readings.noise_m(), readings.still_noise_m);
    }
}

/// Noise that grows with range is told with its growth, standing still or by flat walls; noise that doesn't without.
#[test]
fn growth_of_the_noise_comes_from_the_readings() {
    let mut moving = drive(Recording { sigma_m: 0.005, sigma_per_m: 0.003, ..PLAIN });
    let still = DriveQuality::of(&moving, &summary()).readings;
    moving.steps.drain(..31);
    let flat = DriveQuality::of(&moving, &summary()).readings;
    for readings in [&still, &flat] {
        let [constant, growth] = readings.noise_by_range.unwrap();
        near(Some(constant), 0.005, 0.0025);
        near(Some(growth), 0.003, 0.001);
    }
    assert_eq!(quality(PLAIN).readings.noise_by_range, None);
    // The same beams of a laser that turns clockwise.
    let reversed = |values: &[f32]| values.iter().rev().copied().collect::<Vec<f32>>();
    let laser = &moving.laser;
    let laser = Laser::new(
        reversed(laser.bearings()),
        reversed(laser.beam_times_secs()),
        laser.min_range(),
        laser.max_range(),
        laser.base_from_laser(),
    );
    moving.laser = laser.unwrap();
    moving.steps.iter_mut().for_each(|step| step.scan.ranges.reverse());
    assert_eq!(DriveQuality::of(&moving, &summary()).readings.noise_by_range, flat.noise_by_range);
}

/// One reading in ten is of something that stands there for one scan, up to 15 % of the way in front of the wall: the laser errs by no more, nor
/// by more with range, whether the robot stands or not.
#[test]
fn what_comes_and_goes_is_no_noise() {
    let mut passing = drive(Recording { sigma_m: 0.012, ..PLAIN });
    let mut uniform = Uniform(7);
    for range in passing.steps.iter_mut().flat_map(|step| &mut step.scan.ranges) {
        if uniform.next() < 0.1 {
            *range *= 1.0 - 0.15 * uniform.next() as f32;
        }
    }
    let readings = DriveQuality::of(&passing, &summary()).readings;
    near(readings.still_noise_m, 0.012, 0.001);
    assert_eq!(readings.noise_by_range, None);
    passing.steps.drain(..31);
    let readings = DriveQuality::of(&passing, &summary()).readings;
    assert_eq!((readings.still_noise_m, readings.noise_by_range), (None, None));
}

/// Walls as rough as neighbours are apart: it isn't the laser that errs by nothing near them, and by more and more farther off.
#[test]
fn rough_walls_are_no_growing_noise() {
    let mut drive = drive(Recording { sigma_m: 0.002, ..PLAIN });
    drive.steps.drain(..31);
    let mut uniform = Uniform(5);
    for range in drive.steps.iter_mut().flat_map(|step| &mut step.scan.ranges) {
        *range *= 1.0 + 0.04 * (uniform.next() - 0.5) as f32;
    }
    let readings = DriveQuality::of(&drive, &summary()).readings;
    assert_eq!(readings.noise_by_range, None);
    let nearest = drive.steps.iter().flat_map(|step| &step.scan.ranges).copied().fold(f32::MAX, f32::min);
    let all = readings.flat_noise_m.unwrap();
    assert!(all < 0.04 * f64::from(nearest), "{all} of ranges from {nearest} m");
}

/// No returns that the log doesn't call so are one number, below the longest return. Returns in steps of a centimetre are many numbers.
#[test]
fn a_number_that_is_read_again_and_again_is_told() {
    let mut recording = drive(Recording { step_m: 0.01, ..PLAIN });
    assert_eq!(DriveQuality::of(&recording, &summary()).readings.repeated, None);
    let mut of_four_beams = recording.clone();
    for step in &mut of_four_beams.steps {
        step.scan.ranges[20..24].fill(8.19);
    }
    assert_eq!(DriveQuality::of(&of_four_beams, &summary()).readings.repeated, None);
    for (scan, step) in recording.steps.iter_mut().enumerate() {
        step.scan.ranges[scan % 180] = 8.19;
        step.scan.ranges[(scan + 90) % 180] = 8.19;
    }
    recording.steps[3].scan.ranges[4] = 8.2;
    let [at, share] = DriveQuality::of(&recording, &summary()).readings.repeated.unwrap();
    near(Some(at), 8.19, 1e-6);
    near(Some(share), 2.0 / 180.0, 1e-4);
}

/// Shares of lost and of random readings are seen between neighbours on one wall.
#[test]
fn lost_and_random_readings_come_from_their_neighbours() {
    let readings = quality(PLAIN).readings;
    assert_eq!((readings.lost_share, readings.random_share), (Some(0.0), Some(0.0)));
    let mut straying = drive(PLAIN);
    let max = straying.laser.max_range();
    let mut uniform = Uniform(11);
    for range in straying.steps.iter_mut().flat_map(|step| &mut step.scan.ranges) {
        let drawn = uniform.next();
        if drawn < 0.01 {
            *range = max;
        } else if drawn < 0.03 {
            *range = max * uniform.next() as f32;
        }
    }
    let readings = DriveQuality::of(&straying, &summary()).readings;
    near(readings.lost_share, 0.01, 0.003);
    near(readings.random_share, 0.02, 0.006);
    // A tenth of the readings is of what stands 1 m behind a gap in the wall.
    for (i, range) in straying.steps.iter_mut().flat_map(|step| &mut step.scan.ranges).enumerate() {
        if i % 10 == 5 && *range < 0.5 * max {
            *range += 1.0;
        }
    }
    let readings = DriveQuality::of(&straying, &summary()).readings;
    near(readings.random_share, 0.02, 0.006);
}

#[test]
fn a_robot_that_never_stands_still_tells_its_noise_by_flat_walls_alone() {
    let mut moving = drive(PLAIN);
    moving.steps.drain(..31);
    let readings = DriveQuality::of(&moving, &summary()).readings;
    assert_eq!((readings.still_scans, readings.still_noise_m), (0, None));
    near(readings.noise_m(), PLAIN.sigma_m, 0.15 * PLAIN.sigma_m);
}

#[test]
fn odometry_is_held_against_the_reference() {
    let right = quality(PLAIN).odometry.unwrap().error.unwrap();
    assert!(right.position_per_m < 1e-9 && right.alpha.iter().all(|alpha| *alpha < 1e-12), "{right:?}");
    let long = quality(Recording { scale: 1.05, ..PLAIN }).odometry.unwrap().error.unwrap();
    near(Some(long.distance_ratio), 1.05, 1e-3);
    near(Some(long.position_per_m), 0.05, 0.01);
    assert!(long.alpha[2] > 1e-3, "{long:?}");
}

#[test]
fn jumps_are_counted() {
    let mut jumping = drive(PLAIN);
    for step in &mut jumping.steps[300..] {
        step.odometry.x += 2.0;
    }
    let found = DriveQuality::of(&jumping, &summary());
    assert_eq!(found.odometry.unwrap().jumps, Some(1));
    // It is the odometry that jumps, and not the reference.
    assert_eq!(found.reference.unwrap().jumps, 0);
    let mut corrected = drive(PLAIN);
    for step in &mut corrected.steps[300..] {
        step.reference = step.reference.map(|pose| Pose2::new(pose.x + 0.08, pose.y, pose.theta));
    }
    let found = DriveQuality::of(&corrected, &summary());
    let reference = found.reference.unwrap();
    assert_eq!((found.odometry.unwrap().jumps, reference.jumps), (Some(0), 1));
    near(Some(reference.jump_m), 0.08, 1e-6);
    assert_eq!(quality(PLAIN).odometry.unwrap().jumps, Some(0));
    for step in &mut jumping.steps {
        step.stamp_secs = 0.0;
    }
    assert_eq!(DriveQuality::of(&jumping, &summary()).odometry.unwrap().jumps, None);
}

/// A scan seen from 12 cm ahead and 5 cm to the left is the scan that is taken there, as far as the first one saw it.
#[test]
fn a_scan_is_seen_from_elsewhere() {
    let bearings: Vec<f32> = (0..180).map(|beam| (f64::from(beam) - 90.0).to_radians() as f32).collect();
    let laser = Laser::new(bearings.clone(), vec![0.0; 180], 0.1, 20.0, Pose2::IDENTITY).unwrap();
    let place = glam::DVec2::new(0.12, 0.05);
    let scan_at = |place: glam::DVec2| -> Vec<f32> {
        let pose = Pose2::new(0.3 + place.x, -0.4 + place.y, 0.0);
        bearings.iter().map(|&bearing| range(&pose, f64::from(bearing)) as f32).collect()
    };
    let [first, there] = [glam::DVec2::ZERO, place].map(scan_at);
    let seen = super::lag::seen_from(place, &first, &laser, 1_f64.to_radians());
    let known: Vec<f32> =
        (0..180).filter(|&i| seen[i] < laser.max_range()).map(|i| (seen[i] - there[i]).abs()).collect();
    let unmoved = first.iter().zip(&there).map(|(a, b)| (a - b).abs()).sum::<f32>() / 180.0;
    assert!(known.len() > 150 && known.iter().sum::<f32>() / (known.len() as f32) < 0.1 * unmoved);
}

#[test]
fn a_lag_is_found_on_either_side() {
    for lag_secs in [-0.15, 0.0, 0.2] {
        let clock = quality(Recording { lag_secs, ..PLAIN }).clock;
        near(clock.odometry_lag_secs, lag_secs, 0.02);
        assert!(
            (0.03..0.032).contains(&clock.odometry_lag_error_secs.unwrap()),
            "{:?}",
            clock.odometry_lag_error_secs
        );
    }
}

/// What a lag makes of a motion is neither the odometry's noise nor a jump of the reference; an odometry that is off, or a reference that
/// jumps, is no lag.
#[test]
fn a_lag_behind_the_reference_is_no_error_of_the_odometry() {
    let plain = quality(PLAIN).odometry.unwrap();
    assert_eq!(plain.lag_secs, 0.0);
    for lag_secs in [-0.15, 0.2] {
        let found = quality(Recording { lag_secs, ..PLAIN });
        let odometry = found.odometry.unwrap();
        near(Some(odometry.lag_secs), lag_secs, 0.02);
        let [with, without] = [odometry, plain.clone()].map(|odometry| odometry.error.unwrap());
        assert!(with.position_per_m < without.position_per_m + 0.01, "{with:?}");
        assert_eq!(found.reference.unwrap().jumps, 0);
    }
    assert_eq!(quality(Recording { scale: 1.1, ..PLAIN }).odometry.unwrap().lag_secs, 0.0);
    let mut jumping = drive(PLAIN);
    for (i, step) in jumping.steps.iter_mut().enumerate() {
        step.reference =
            step.reference.map(|pose| Pose2::new(pose.x + 0.08 * (i / 20 % 2) as f64, pose.y, pose.theta));
    }
    assert_eq!(DriveQuality::of(&jumping, &summary()).odometry.unwrap().lag_secs, 0.0);
}

#[test]
fn gaps_of_scans_and_reference_are_found() {
    let mut holed = drive(PLAIN);
    holed.steps.drain(200..220);
    for step in &mut holed.steps[400..450] {
        step.reference = None;
    }
    let found = DriveQuality::of(&holed, &summary());
    assert_eq!(found.clock.gaps, 1);
    near(Some(found.clock.longest_gap_secs), 2.1, 1e-3);
    let reference = found.reference.unwrap();
    assert_eq!(reference.scans, 530);
    near(Some(reference.longest_gap_secs), 5.1, 1e-3);
}

/// Drives of nothing, of one scan, of scans without returns: estimates are missing, and nothing fails.
#[test]
fn poor_drives_have_no_estimates() {
    let whole = drive(PLAIN);
    let one = Drive { steps: whole.steps[..1].to_vec(), laser: whole.laser.clone() };
    let mut empty = whole.clone();
    for (i, step) in empty.steps.iter_mut().enumerate() {
        step.scan.ranges.fill(if i % 2 == 0 { 20.0 } else { f32::NAN });
        step.reference = None;
        step.odometry = Pose2::new(0.0, 0.0, TAU);
    }
    let beam = Laser::new(vec![0.0], vec![0.0], 0.0, 20.0, Pose2::IDENTITY).unwrap();
    let mut single = Drive { laser: beam, ..whole.clone() };
    for step in &mut single.steps {
        step.scan.ranges.truncate(1);
    }
    for poor in [one, empty, single] {
        let found = DriveQuality::of(&poor, &summary());
        assert_eq!(found.clock.odometry_lag_secs, None);
        let missing = LogSummary { odometry: OdometrySource::Missing, ..summary() };
        assert_eq!(DriveQuality::of(&poor, &missing).odometry, None);
    }
}

/// A reference of a body that is turned, or lies ahead, and one of the base.
#[test]
fn a_reference_of_another_body_is_told() {
    let plain = drive(Recording { scale: 1.02, ..PLAIN });
    let told = |recording: &Drive| DriveQuality::of(recording, &summary()).reference.unwrap().body;
    assert_eq!(told(&plain), None);
    for body in [Pose2::new(0.2, -0.05, 0.0), Pose2::new(0.0, 0.0, 0.05), Pose2::new(-0.3, 0.1, -1.6)] {
        let mut other = plain.clone();
        for step in &mut other.steps {
            step.reference = step.reference.map(|pose| pose.compose(&body));
        }
        let found = told(&other).unwrap();
        let apart = found.relative_to(&body);
        assert!(apart.position().length() < 0.02 && apart.theta.abs() < 0.01, "{found:?} for {body:?}");
    }
    // Wheels of different size turn the heading, and no body does.
    let mut imbalanced = plain.clone();
    let steps = plain.steps.windows(2).map(|pair| pair[1].odometry.relative_to(&pair[0].odometry));
    for (i, step) in steps.enumerate() {
        let turned = Pose2 { theta: step.theta + 0.05 * step.position().length(), ..step };
        imbalanced.steps[i + 1].odometry = imbalanced.steps[i].odometry.compose(&turned);
    }
    assert_eq!(told(&imbalanced), None);
}

/// Odometry that comes once a second is interpolated, which is no lag and no jump.
#[test]
fn rare_odometry_tells_no_lag() {
    let late = drive(Recording { lag_secs: 0.2, ..PLAIN });
    let rare = LogSummary { odometry_interval_secs: Some(1.0), ..summary() };
    let [often, rarely] = [summary(), rare].map(|summary| DriveQuality::of(&late, &summary));
    assert!(often.odometry.unwrap().lag_secs > 0.15 && often.clock.odometry_lag_secs.is_some());
    assert_eq!((rarely.odometry.unwrap().lag_secs, rarely.clock.odometry_lag_secs), (0.0, None));
}
