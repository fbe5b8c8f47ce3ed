//! Numbers of a recording that are likely in other units: millimetres, centimetres, degrees, milliseconds.

use glam::DVec2;
use locsim_core::{Drive, DriveStep, Pose2, median, wrap_angle};

/// Half of the readings of a lidar on a robot end nearer \[m\].
const USUAL_RANGE_M: f64 = 100.0;
/// A laser is mounted nearer to the robot's origin \[m\].
const USUAL_MOUNT_M: f64 = 5.0;
/// A robot that moves is slower, and faster \[m/s\].
const USUAL_SPEED_M_S: [f64; 2] = [2e-3, 60.0];
/// A robot that comes no farther than this \[m\] stands, and moves by the noise of its poses.
const LEAST_DRIVE_M: f64 = 1.0;
/// Steps below are rounding \[m\].
const LEAST_STEP_M: f64 = 1e-3;
/// Headings that turn by more between two scans \[rad\] ..
const LARGE_TURN_RAD: f64 = 1.0;
/// .. and faster \[rad/s\], a full turn, ..
const LARGE_RATE_RAD_S: f64 = 6.3;
/// .. in more than this share of the steps aren't a robot's.
const LARGE_TURNS: f64 = 0.02;
/// Scans whose readings are looked at, at the most.
const SCANS: usize = 200;
/// Fewer steps tell nothing.
const LEAST_STEPS: usize = 20;

/// Sentences on what a robot hardly does, and on the unit that would explain it.
pub fn unlikely_units(drive: &Drive) -> Vec<String> {
    let mut told = Vec::new();
    let max_range = drive.laser.max_range();
    let some = drive.steps.iter().step_by(drive.steps.len().div_ceil(SCANS).max(1));
    let readings = some.flat_map(|step| &step.scan.ranges);
    let mut returns: Vec<f64> = readings.filter(|z| **z < max_range).map(|z| f64::from(*z)).collect();
    let usual = if returns.is_empty() { 0.0 } else { median(&mut returns) };
    if usual > USUAL_RANGE_M {
        told.push(format!(
            "Half of the returns are beyond {usual:.0} m: the ranges may be in centimetres or millimetres; metres are needed."
        ));
    }
    let mount = drive.laser.base_from_laser().position().length();
    if mount > USUAL_MOUNT_M {
        told.push(format!(
            "The laser is mounted {mount:.1} m from the robot's origin: the mount may be in centimetres; metres are needed."
        ));
    }
    let odometry = poses(drive, |step| Some(step.odometry));
    let reference = poses(drive, |step| step.reference);
    for (what, poses) in [("odometry", odometry), ("reference", reference)] {
        told.extend(of_poses(what, &poses));
    }
    told
}

/// Stamps \[s\] and poses of the scans that have one.
fn poses(drive: &Drive, pose: impl Fn(&DriveStep) -> Option<Pose2>) -> Vec<(f64, Pose2)> {
    drive.steps.iter().filter_map(|step| Some((step.stamp_secs, pose(step)?))).collect()
}

fn of_poses(what: &str, poses: &[(f64, Pose2)]) -> Vec<String> {
    let steps: Vec<[f64; 3]> = poses
        .windows(2)
        .map(|pair| {
            let [(from_secs, from), (to_secs, to)] = [pair[0], pair[1]];
            let turn = wrap_angle(to.theta - from.theta).abs();
            [to_secs - from_secs, (to.position() - from.position()).length(), turn]
        })
        .filter(|[secs, ..]| *secs > 0.0)
        .collect();
    let mut told = Vec::new();
    let mut speeds: Vec<f64> = steps
        .iter()
        .filter(|[_, metres, _]| *metres > LEAST_STEP_M)
        .map(|[secs, metres, _]| metres / secs)
        .collect();
    let begin = poses.first().map_or(DVec2::ZERO, |(_, pose)| pose.position());
    let reach = poses.iter().map(|(_, pose)| pose.position().distance(begin)).fold(0.0, f64::max);
    if speeds.len() >= LEAST_STEPS && reach > LEAST_DRIVE_M {
        let speed = median(&mut speeds);
        let [slow, fast] = USUAL_SPEED_M_S;
        let unit = match speed {
            _ if speed > fast => "its positions may be in centimetres or millimetres",
            _ if speed < slow => "the stamps may be in milliseconds or finer",
            _ => "",
        };
        if !unit.is_empty() {
            told.push(format!(
                "By the {what} the robot drives at {speed:.4} m/s in the median: {unit}; metres and seconds are needed."
            ));
        }
    }
    let large = steps
        .iter()
        .filter(|[secs, metres, turn]| {
            *metres > LEAST_STEP_M && *turn > LARGE_TURN_RAD && *turn > LARGE_RATE_RAD_S * secs
        })
        .count();
    let share = large as f64 / steps.len().max(1) as f64;
    if steps.len() >= LEAST_STEPS && share > LARGE_TURNS {
        told.push(format!(
            "By the {what} the robot turns faster than a full turn per second in {:.0} % of the steps: its headings may be in \
             degrees; radians are needed.",
            100.0 * share
        ));
    }
    told
}

#[cfg(test)]
mod tests {
    use super::*;
    use locsim_core::{Laser, Scan};

    /// A robot that drives and turns, with units of its own for ranges, positions, headings, stamps and the mount.
    fn drive([range, position, heading, stamp, mount]: [f64; 5]) -> Drive {
        let mount = Pose2::new(0.1 * mount, 0.0, 0.0);
        let laser = Laser::new(vec![0.0; 3], vec![0.0; 3], 0.0, 8e4, mount).unwrap();
        let steps = (0..100).map(|i| {
            let t = f64::from(i);
            let pose = Pose2::new(0.05 * t * position, 0.0, (0.02 * t).sin() * 2.0 * heading);
            DriveStep {
                stamp_secs: 0.1 * t * stamp,
                odometry: Pose2::new(0.05 * t, 0.0, 0.0),
                reference: Some(pose),
                scan: Scan { ranges: vec![(3.0 * range) as f32, 8e4, f32::NAN] },
            }
        });
        Drive { laser, steps: steps.collect() }
    }

    #[test]
    fn each_wrong_unit_is_told_once_and_right_ones_never() {
        assert_eq!(unlikely_units(&drive([1.0; 5])), [""; 0]);
        for (units, said) in [
            ([100.0, 1.0, 1.0, 1.0, 1.0], &["Half of the returns are beyond 300 m"][..]),
            ([1.0, 1000.0, 1.0, 1.0, 1.0], &["By the reference the robot drives at 500.0000 m/s"]),
            ([1.0, 1.0, 57.3, 1.0, 1.0], &["By the reference the robot turns faster"]),
            (
                [1.0, 1.0, 1.0, 1000.0, 1.0],
                &["By the odometry the robot drives at 0.0005 m/s", "By the reference"],
            ),
            ([1.0, 1.0, 1.0, 1.0, 100.0], &["The laser is mounted 10.0 m"]),
        ] {
            let told = unlikely_units(&drive(units));
            assert_eq!(told.len(), said.len(), "{told:?}");
            for (told, said) in told.iter().zip(said) {
                assert!(told.starts_with(said), "{told}");
            }
        }
    }
}
