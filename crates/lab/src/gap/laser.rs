//! A log's laser as the scenario's: where it is mounted, and which beam is which.

use locsim_core::{Drive, DriveStep, Laser, Pose2, Scan, wrap_angle};

/// Bearings of log and scenario that differ by more than this are of other beams \[rad\].
const SAME_BEARING_RAD: f64 = 2e-3;

/// Mounts that differ by less than this are the same \[m\] and \[rad\]: logs round.
const SAME_MOUNT: f64 = 2e-3;

/// The drive with the laser where the scenario has it: a log may not know, and the scenario is what is in question.
///
/// A laser of bearings from -90 to 89 degrees is also one from -89.5 to 89.5 degrees that is turned by half a degree: where log
/// and scenario agree on where beams point on the robot, the log's bearings become the scenario's.
pub(super) fn with_mount(drive: Drive, scenario: &Laser, warnings: &mut Vec<String>) -> Drive {
    let mount = scenario.base_from_laser();
    let bearings: Vec<f32> = match turn_of_bearings(&drive.laser, scenario) {
        Some(turn) => {
            drive.laser.bearings().iter().map(|&bearing| (f64::from(bearing) + turn) as f32).collect()
        }
        None => drive.laser.bearings().to_vec(),
    };
    let logged = logged_mount(&drive.laser, scenario);
    if are_apart(&logged, &mount) {
        warnings.push(format!(
            "The log has the laser at {} on the robot; the scenario's {} is used.",
            mount_in_words(logged),
            mount_in_words(mount)
        ));
    }
    let laser = Laser::new(
        bearings,
        drive.laser.beam_times_secs().to_vec(),
        drive.laser.min_range(),
        drive.laser.max_range(),
        mount,
    );
    match laser {
        Ok(laser) => Drive { laser, ..drive },
        Err(_) => drive,
    }
}

/// The angle between two ways to say where beams point \[rad\]: the log's bearings and mount, and the scenario's. `None` where they don't point alike, or
/// are said alike.
fn turn_of_bearings(log: &Laser, scenario: &Laser) -> Option<f64> {
    let turn = wrap_angle(log.base_from_laser().theta - scenario.base_from_laser().theta);
    let first = |laser: &Laser| laser.bearings().first().map_or(f64::NAN, |&bearing| f64::from(bearing));
    let apart = wrap_angle(first(log) + turn - first(scenario));
    (turn.abs() > SAME_MOUNT && apart.abs() < SAME_MOUNT).then_some(turn)
}

/// The log's mount, for the scenario's bearings where beams point alike: turned bearings are the same directions, and the place of the laser is another
/// matter.
pub(super) fn logged_mount(log: &Laser, scenario: &Laser) -> Pose2 {
    let mount = log.base_from_laser();
    match turn_of_bearings(log, scenario) {
        Some(_) => Pose2 { theta: scenario.base_from_laser().theta, ..mount },
        None => mount,
    }
}

/// Whether two mounts are others.
pub(super) fn are_apart(a: &Pose2, b: &Pose2) -> bool {
    let apart = a.relative_to(b);
    apart.position().length() > SAME_MOUNT || apart.theta.abs() > SAME_MOUNT
}

/// The laser's place on the robot.
pub(super) fn mount_in_words(pose: Pose2) -> String {
    format!("({:.3} m, {:.3} m, {:.1} deg)", pose.x, pose.y, pose.theta.to_degrees())
}

/// The drive with its beams in the order of the scenario's, matched by where they point.
///
/// Lidars begin behind, ahead or at a side, some turn clockwise, and some have a beam at both ends of a full circle. Beams are taken when
/// the log says; one that doesn't say so has the scenario's sweep. What has no return in the log has none in the scenario, whose maximum
/// range may be rounded.
pub(super) fn with_beams(drive: Drive, scenario: &Laser) -> Result<Drive, String> {
    let (range, max) = (drive.laser.max_range(), scenario.max_range());
    if (range - max).abs() > 1e-3 * max {
        return Err(format!(
            "a maximum range of {range} m doesn't fit the scenario's laser; its laser.max_range_m is {max}"
        ));
    }
    let drive = if range == max { drive } else { with_max_range(drive, max)? };
    let log = &drive.laser;
    let order = matching_beams(log.bearings(), scenario.bearings())?;
    let sweeps = log.beam_times_secs().iter().any(|&secs| secs != 0.0);
    let secs = if sweeps {
        order.iter().map(|&beam| log.beam_times_secs()[beam]).collect()
    } else {
        scenario.beam_times_secs().to_vec()
    };
    if order.iter().copied().eq(0..log.beam_count()) {
        let laser = drive.laser.with_beam_times(&secs).map_err(|error| error.to_string())?;
        return Ok(Drive { laser, ..drive });
    }
    let bearing = |(&theirs, &beam): (&f32, &usize)| {
        let apart = wrap_angle(f64::from(log.bearings()[beam]) - f64::from(theirs));
        (f64::from(theirs) + apart) as f32
    };
    let laser = Laser::new(
        scenario.bearings().iter().zip(&order).map(bearing).collect(),
        secs,
        log.min_range(),
        max,
        log.base_from_laser(),
    )
    .map_err(|error| error.to_string())?;
    let steps = drive.steps.into_iter().map(|step| {
        let ranges = order.iter().map(|&beam| step.scan.ranges[beam]).collect();
        DriveStep { scan: Scan { ranges }, ..step }
    });
    Ok(Drive { laser, steps: steps.collect() })
}

/// The drive with another maximum range \[m\], which readings without a return have.
fn with_max_range(mut drive: Drive, max: f32) -> Result<Drive, String> {
    let laser = &drive.laser;
    let range = laser.max_range();
    drive.laser = Laser::new(
        laser.bearings().to_vec(),
        laser.beam_times_secs().to_vec(),
        laser.min_range(),
        max,
        laser.base_from_laser(),
    )
    .map_err(|error| error.to_string())?;
    for reading in drive.steps.iter_mut().flat_map(|step| &mut step.scan.ranges) {
        // What isn't a number stays so.
        if *reading >= range.min(max) {
            *reading = max;
        }
    }
    Ok(drive)
}

/// For each beam of the scenario, the log's beam that points there; an error where one of either has no counterpart.
fn matching_beams(log: &[f32], scenario: &[f32]) -> Result<Vec<usize>, String> {
    let wrapped = |bearing: f32| wrap_angle(f64::from(bearing));
    let mut sorted: Vec<(f64, usize)> =
        scenario.iter().enumerate().map(|(beam, &bearing)| (wrapped(bearing), beam)).collect();
    sorted.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let refuse = |what: &str, bearing: f32, other: &str| {
        format!(
            "{what} points to {:.2} deg, where {other} has no beam ({} beams in the log, {} in the scenario); its \
             laser.beams, laser.field_of_view_deg, laser.first_beam_deg and laser.mount must be those of the log",
            f64::from(bearing).to_degrees(),
            log.len(),
            scenario.len()
        )
    };
    let mut matched = vec![None; scenario.len()];
    for (beam, &bearing) in log.iter().enumerate() {
        let at = sorted.partition_point(|(sorted, _)| *sorted < wrapped(bearing));
        // Neighbours on either side, around the circle.
        let neighbours = [at + sorted.len() - 1, at].map(|at| sorted[at % sorted.len()]);
        let apart = neighbours.map(|(other, _)| wrap_angle(wrapped(bearing) - other).abs());
        let nearest = usize::from(apart[1] < apart[0]);
        if apart[nearest] > SAME_BEARING_RAD {
            return Err(refuse(&format!("beam {beam}"), bearing, "the scenario's laser"));
        }
        matched[neighbours[nearest].1].get_or_insert(beam);
    }
    let matches = matched.into_iter().zip(scenario).enumerate();
    matches
        .map(|(beam, (found, &bearing))| {
            found.ok_or_else(|| refuse(&format!("beam {beam} of the scenario"), bearing, "the log"))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use super::*;

    fn drive(bearings: Vec<f32>) -> Drive {
        let ranges: Vec<f32> =
            bearings.iter().map(|bearing| 1.0 + wrap_angle(f64::from(*bearing)).abs() as f32).collect();
        let times = (0..bearings.len()).map(|beam| beam as f32).collect();
        let laser = Laser::new(bearings, times, 0.0, 8.0, Pose2::IDENTITY).unwrap();
        let step =
            DriveStep { stamp_secs: 0.0, odometry: Pose2::IDENTITY, reference: None, scan: Scan { ranges } };
        Drive { laser, steps: vec![step] }
    }

    /// `count` beams from `first` on, a step apart (rad).
    fn beams(first: f32, step: f32, count: usize) -> Vec<f32> {
        (0..count).map(|beam| first + beam as f32 * step).collect()
    }

    /// A data sheet's 8 m are 7.994 m in the log, or the other way around; a reading without a return is at either's maximum range.
    #[test]
    fn what_has_no_return_has_none_in_a_laser_of_about_the_same_range() {
        let mut log = drive(beams(0.0, 1.0, 4));
        log.steps[0].scan.ranges = vec![7.994, f32::NAN, 7.9, 8.0];
        let with_range = |drive: &Drive, max: f32| with_max_range(drive.clone(), max).unwrap();
        let rounded = with_range(&log, 7.994);
        for (own, max) in [(&rounded, 8.0), (&log, 7.994)] {
            let scenario = with_range(&drive(beams(0.0, 1.0, 4)), max).laser;
            let found = with_beams(own.clone(), &scenario).unwrap();
            let ranges = &found.steps[0].scan.ranges;
            assert_eq!(found.laser.max_range(), max);
            assert!(
                ranges[0] == max && ranges[1].is_nan() && ranges[2] == 7.9 && ranges[3] == max,
                "{ranges:?}"
            );
        }
    }

    #[test]
    fn beams_are_matched_by_where_they_point() {
        let step = PI / 4.0;
        let scenario = drive(beams(step - PI, step, 8));
        for (log, first) in [
            (beams(step - PI, step, 8), 0),
            // From behind on, from ahead on, clockwise, and with a beam at both ends.
            (beams(-PI, step, 8), 1),
            (beams(0.0, step, 8), 5),
            (beams(PI, -step, 8), 7),
            (beams(-PI, step, 9), 1),
        ] {
            let found = with_beams(drive(log), &scenario.laser).unwrap();
            for (found, expected) in found.laser.bearings().iter().zip(scenario.laser.bearings()) {
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
            for (found, expected) in found.steps[0].scan.ranges.iter().zip(&scenario.steps[0].scan.ranges) {
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
            assert_eq!(found.laser.beam_times_secs()[0], first as f32);
        }
    }

    /// A log that doesn't say when its beams are taken has the scenario's sweep.
    #[test]
    fn beams_are_taken_when_the_log_says() {
        let step = PI / 4.0;
        let scenario = drive(beams(step - PI, step, 8)).laser;
        let clockwise = drive(beams(PI, -step, 8));
        let times = |drive| with_beams(drive, &scenario).unwrap().laser.beam_times_secs().to_vec();
        assert_eq!(times(clockwise.clone()), [7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.0]);
        let still = |laser: Laser| laser.with_beam_times(&[0.0; 8]).unwrap();
        let unsaid = Drive { laser: still(clockwise.laser.clone()), ..clockwise };
        assert_eq!(times(unsaid), scenario.beam_times_secs());
        let same = Drive { laser: still(scenario.clone()), ..drive(beams(step - PI, step, 8)) };
        assert_eq!(times(same), scenario.beam_times_secs());
    }

    /// Half a degree of bearings is half a degree of the mount, and says nothing of where the laser is.
    #[test]
    fn a_laser_that_the_log_has_elsewhere_is_told() {
        let half = 0.5_f64.to_radians();
        let laser = |first: f64, mount: Pose2| {
            let bearings = beams(first as f32, 0.1, 8);
            Laser::new(bearings, vec![0.0; 8], 0.0, 8.0, mount).unwrap()
        };
        let scenario = laser(-0.4 + half, Pose2::new(0.0, 0.0, -half));
        for (x_m, turn, told) in [
            (0.0, 0.0, None),
            (-0.04, 0.0, Some("(-0.040 m, 0.000 m, -0.5 deg)")),
            (0.0, 0.1, Some("5.7 deg)")),
        ] {
            let log = Drive { laser: laser(-0.4, Pose2::new(x_m, 0.0, turn)), steps: Vec::new() };
            let mut notes = Vec::new();
            let found = with_mount(log, &scenario, &mut notes);
            assert_eq!(found.laser.base_from_laser(), scenario.base_from_laser());
            assert_eq!(notes.len(), usize::from(told.is_some()), "{notes:?}");
            assert!(told.is_none_or(|told| notes[0].contains(told)), "{notes:?}");
        }
        // For the scenario's bearings, where those point alike.
        for (turn, expected) in [(0.0, -half), (0.1, 0.1)] {
            let log = laser(-0.4, Pose2::new(-0.04, 0.0, turn));
            assert_eq!(logged_mount(&log, &scenario), Pose2::new(-0.04, 0.0, expected));
        }
    }

    #[test]
    fn other_beams_are_refused() {
        let step = PI / 4.0;
        let scenario = drive(beams(step - PI, step, 8));
        for (log, part) in [
            (
                beams(0.1, step, 8),
                "beam 0 points to 5.73 deg, where the scenario's laser has no beam (8 beams in the log",
            ),
            (beams(-PI, step / 2.0, 16), "beam 1 points to -157.50 deg"),
            (beams(-PI, step, 7), "beam 6 of the scenario points to 135.00 deg, where the log has no beam"),
        ] {
            let error = with_beams(drive(log), &scenario.laser).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
