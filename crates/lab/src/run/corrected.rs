//! What is corrected in the scans of a log before a map is built of them, models are trained on them and filters see them.

use locsim_core::Drive;

/// Scans of a log whose clock stands still are taken to be this far apart \[s\], as those of logs that keep a scan each half metre.
const SCAN_SECS: f64 = 1.0;

/// The drive with a time for each scan, without the robot's motion within a sweep, and without readings of scans that were sent again; with
/// sentences on what there was of these.
pub(crate) fn corrected(mut drive: Drive) -> (Drive, Vec<String>) {
    // A sweep is corrected by the motion between stamps.
    let mut notes: Vec<String> = spread_stamps(&mut drive, SCAN_SECS).into_iter().collect();
    let stale = drive.stale_scans();
    let times = drive.laser.beam_times_secs();
    let sweep_ms = 1e3 * (times[times.len() - 1] - times[0]).abs();
    let mut drive = drive.deskewed().map_or(drive, |deskewed| {
        notes.push(format!(
            "A scan takes {sweep_ms:.0} ms, by the log's own times of the beams. The robot's motion meanwhile, by its odometry, was taken out \
             of the readings."
        ));
        deskewed
    });
    for &scan in &stale {
        drive.steps[scan].scan.ranges.fill(f32::NAN);
    }
    if !stale.is_empty() {
        notes.push(format!(
            "{} scans have all readings of the scan before, though the robot has moved: the driver has sent them again. Their readings \
             aren't used.",
            stale.len()
        ));
    }
    (drive, notes)
}

/// Gives scans of one stamp times of their own, at most `interval_secs` \[s\] apart; a note on them.
pub(crate) fn spread_stamps(drive: &mut Drive, interval_secs: f64) -> Option<String> {
    let spread = drive.spread_stamps(interval_secs);
    (spread > 0).then(|| {
        format!(
            "{spread} scans have the stamp of the scan before. They are taken to come evenly, at most {interval_secs} s apart: times and \
             speeds are no better than that."
        )
    })
}

#[cfg(test)]
mod tests {
    use locsim_core::{DriveStep, Laser, Pose2, Scan};

    use super::*;

    /// A robot that passes a wall of posts; every other scan is sent again.
    #[test]
    fn scans_that_were_sent_again_have_no_readings() {
        let bearings: Vec<f32> = (0..40_u8).map(|i| 0.05 * f32::from(i)).collect();
        let laser = Laser::new(bearings, vec![0.0; 40], 0.1, 20.0, Pose2::IDENTITY).unwrap();
        let step = |i: u32| {
            let x = 0.05 * f64::from(i);
            let ranges = (0..40_u32).map(|beam| (2.0 + 0.01 * f64::from(i * (beam + 1) % 97)) as f32);
            DriveStep {
                stamp_secs: 0.1 * f64::from(i),
                odometry: Pose2::new(x, 0.0, 0.0),
                reference: None,
                scan: Scan { ranges: ranges.collect() },
            }
        };
        let mut drive = Drive { laser, steps: (0..80).map(step).collect() };
        let clean = drive.clone();
        for scan in [20, 50, 51] {
            drive.steps[scan].scan = drive.steps[scan - 1].scan.clone();
        }
        let (found, notes) = corrected(drive);
        let blank = |step: &DriveStep| step.scan.ranges.iter().all(|range| range.is_nan());
        let blanks: Vec<usize> = (0..80).filter(|&i| blank(&found.steps[i])).collect();
        assert_eq!(blanks, [20, 50, 51]);
        assert!(notes.len() == 1 && notes[0].starts_with("3 scans have all readings"), "{notes:?}");
        assert_eq!(corrected(clean.clone()), (clean, Vec::new()));
    }
}
