//! Measured logs that aren't part of the project, in the folder `LOCSIM_DATA`.

use std::path::PathBuf;

use locsim_core::{Drive, Pose2};
use locsim_dataset::{CarmenOptions, LogKind, OdometrySource, read_carmen};

fn data(file: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("LOCSIM_DATA") else {
        println!("skipped: LOCSIM_DATA is not set");
        return None;
    };
    Some(PathBuf::from(folder).join(file))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Medians over the steps of a drive of |translation| (m) and |rotation| (rad).
fn medians(drive: &Drive, of: impl Fn(Pose2, Pose2) -> Pose2) -> (f64, f64) {
    let reference = |i: usize| drive.steps[i].reference.unwrap();
    let steps: Vec<_> = (1..drive.steps.len())
        .map(|i| of(reference(i).relative_to(&reference(i - 1)), drive.odometry_increment(i)))
        .collect();
    (
        median(steps.iter().map(|p| p.position().length()).collect()),
        median(steps.iter().map(|p| p.theta.abs()).collect()),
    )
}

/// Recovered odometry agrees with the reference: the median disagreement over an interval stays below 35 % of
/// the median motion (Freiburg's short steps of 0.1 m: 27 %, the others 8 % and 3 %), which neither odometry
/// that stands still (100 %) nor one with the jumps of the corrections in it could do. It isn't the reference
/// itself either: there is some disagreement.
#[test]
fn corrected_logs_are_recognised_and_their_odometry_is_recovered() {
    for (file, scans, beams, last_bearing) in [
        ("intel-corrected.log.gz", 910, 180, 89.0_f32),
        ("freiburg-079-corrected.log.gz", 4791, 360, 89.5),
        ("infinite-corridor-corrected.log.gz", 1941, 180, 89.0),
    ] {
        let Some(path) = data(file) else { return };
        let (drive, summary) = read_carmen(&path, &CarmenOptions::default()).unwrap();
        println!("{file}\n{summary}");
        assert_eq!(summary.kind, LogKind::Corrected);
        assert_eq!(summary.odometry, OdometrySource::RestartedOdomLines);
        assert_eq!((drive.steps.len(), drive.laser.beam_count()), (scans, beams));
        assert_eq!(summary.intervals_without_odometry, 0);
        let bearings = drive.laser.bearings();
        assert!((bearings[0].to_degrees() + 90.0).abs() < 1e-4);
        assert!((bearings[beams - 1].to_degrees() - last_bearing).abs() < 1e-4);
        assert!(drive.steps.windows(2).all(|w| w[0].stamp_secs <= w[1].stamp_secs));

        let motion = medians(&drive, |reference, _| reference);
        let error = medians(&drive, |reference, odometry| odometry.relative_to(&reference));
        println!(
            "median motion {:.3} m {:.4} rad, disagreement {:.4} m {:.4} rad",
            motion.0, motion.1, error.0, error.1
        );
        assert!(error.0 > 1e-3 && error.0 < 0.35 * motion.0);
        assert!(error.1 > 1e-4 && error.1 < 0.35 * motion.1);
    }
}

/// The laser of the infinite corridor's robot counted only to 51 m; the summary shows it and the option mends it.
#[test]
fn another_maximum_range_shows_in_the_summary() {
    let Some(path) = data("infinite-corridor-corrected.log.gz") else { return };
    let (_, summary) = read_carmen(&path, &CarmenOptions::default()).unwrap();
    assert_eq!((summary.no_return_share, summary.longest_return_m), (0.0, Some(51.16)));
    let options = CarmenOptions { max_range_m: Some(50.0), ..Default::default() };
    let (drive, summary) = read_carmen(&path, &options).unwrap();
    assert!(summary.no_return_share > 0.01);
    assert_eq!(drive.laser.max_range(), 50.0);
}

/// Logs in another format say what they have instead.
#[test]
fn a_wean_hall_log_is_refused_by_name() {
    let Some(path) = data("wean-hall/robotdata1.log.gz") else { return };
    let message = read_carmen(&path, &CarmenOptions::default()).unwrap_err().to_string();
    assert!(message.contains("no scan") && message.contains("L ") && message.contains("O "), "{message}");
}
