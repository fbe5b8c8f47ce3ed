use std::io::Write;
use std::path::Path;

use locsim_core::limits::Limits;
use locsim_core::{Drive, Pose2};

use crate::DatasetError;
use crate::lines::Lines;
use crate::output::{encoded, write_whole};
use crate::quaternion::heading;
use crate::source::open_text;

/// A pose with its time: one line of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Time (s).
    pub stamp_secs: f64,
    /// The pose at that time.
    pub pose: Pose2,
}

/// The reference poses of a drive, with the times of their scans; scans without one are left out.
pub fn reference_trajectory(drive: &Drive) -> Vec<StampedPose> {
    let steps = drive.steps.iter();
    steps
        .filter_map(|step| Some(StampedPose { stamp_secs: step.stamp_secs, pose: step.reference? }))
        .collect()
}

/// The odometry of a drive, with the times of its scans.
pub fn odometry_trajectory(drive: &Drive) -> Vec<StampedPose> {
    let steps = drive.steps.iter();
    steps.map(|step| StampedPose { stamp_secs: step.stamp_secs, pose: step.odometry }).collect()
}

/// Reads a trajectory in the format of the TUM RGB-D benchmark (Sturm et al., IROS 2012):
/// `timestamp tx ty tz qx qy qz qw` in seconds, metres and a unit quaternion; `#` starts a comment line.
///
/// The pose is projected to the plane: tz, roll and pitch are dropped. A last line without its newline is left out, because
/// its last number may be cut.
///
/// # Errors
/// The file can't be read, has no whole pose or costs more than the [`Limits`] allow; a line doesn't have
/// eight finite numbers, or its quaternion doesn't have unit length (to 1 %).
pub fn read_tum(path: &Path) -> Result<Vec<StampedPose>, DatasetError> {
    let limits = Limits::current();
    let mut lines = Lines::new(path, open_text(path, limits)?, limits);
    let mut trajectory = Vec::new();
    while let Some(line) = lines.next()? {
        let mut fields = line.fields_of("pose");
        if line.fields().keyword.starts_with('#') {
            continue;
        }
        fields.expect_remaining(8, 0, "(timestamp tx ty tz qx qy qz qw)")?;
        let stamp_secs = fields.stamp("timestamp")?;
        let mut v = [0.0; 7];
        for (v, name) in v.iter_mut().zip(["tx", "ty", "tz", "qx", "qy", "qz", "qw"]) {
            *v = fields.number(name)?;
        }
        let [x, y, _, qx, qy, qz, qw] = v;
        let theta = heading([qx, qy, qz, qw]).map_err(|length| {
            fields.refuse("length of the quaternion", &length.to_string(), "0.99 to 1.01")
        })?;
        trajectory.push(StampedPose { stamp_secs, pose: Pose2::new(x, y, theta) });
    }
    if trajectory.is_empty() {
        if let Some(error) = lines.cut_off() {
            return Err(error);
        }
        return Err(DatasetError::Empty { path: path.to_owned() });
    }
    Ok(trajectory)
}

/// Writes a trajectory in the TUM format (see [`read_tum`]), every number with all its digits, through a
/// temporary file; compressed when the name ends in `.gz`.
///
/// # Errors
/// The trajectory is empty or holds a number that isn't finite; the file can't be written.
pub fn write_tum(path: &Path, trajectory: &[StampedPose]) -> Result<(), DatasetError> {
    write_whole(path, |out| encode_tum(path, trajectory, out))
}

/// Writes the bytes of the file that [`write_tum`] writes to `out`, compressed if `path` ends in `.gz`; `path` is named
/// in errors.
///
/// # Errors
/// Those of [`write_tum`].
pub fn encode_tum(path: &Path, trajectory: &[StampedPose], out: &mut dyn Write) -> Result<(), DatasetError> {
    let unwritable =
        |reason: &str| DatasetError::Unwritable { path: path.to_owned(), reason: reason.to_owned() };
    if trajectory.is_empty() {
        return Err(unwritable("the trajectory has no pose; allowed: at least one"));
    }
    if !trajectory.iter().all(|p| p.stamp_secs.is_finite() && p.pose.is_finite()) {
        return Err(unwritable("a pose or its time is not finite; allowed: finite numbers"));
    }
    encoded(path, out, |out| {
        writeln!(out, "# timestamp tx ty tz qx qy qz qw")?;
        for StampedPose { stamp_secs, pose } in trajectory {
            let (qz, qw) = (0.5 * pose.theta).sin_cos();
            writeln!(out, "{stamp_secs} {} {} 0 0 0 {qz} {qw}", pose.x, pose.y)?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    use locsim_core::wrap_angle;
    use proptest::prelude::*;

    fn read(text: &str) -> Result<Vec<StampedPose>, DatasetError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.tum");
        fs::write(&path, text).unwrap();
        read_tum(&path)
    }

    proptest! {
        #[test]
        fn a_written_trajectory_reads_back(
            rows in prop::collection::vec((-1e10..1e10f64, -1e3..1e3f64, -1e3..1e3f64, -3.2..3.2f64), 1..20),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("t.tum.gz");
            let written: Vec<_> = rows
                .iter()
                .map(|&(t, x, y, theta)| StampedPose { stamp_secs: t, pose: Pose2::new(x, y, theta) })
                .collect();
            write_tum(&path, &written).unwrap();
            let back = read_tum(&path).unwrap();
            prop_assert_eq!(back.len(), written.len());
            for (a, b) in back.iter().zip(&written) {
                prop_assert_eq!((a.stamp_secs, a.pose.x, a.pose.y), (b.stamp_secs, b.pose.x, b.pose.y));
                prop_assert!(wrap_angle(a.pose.theta - b.pose.theta).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_tilted_pose_is_projected_to_its_yaw() {
        // Yaw 90 degrees, then pitch 30 degrees about the new y axis: q = q_yaw * q_pitch.
        let (s, c) = (std::f64::consts::FRAC_PI_4.sin(), std::f64::consts::FRAC_PI_4.cos());
        let (sp, cp) = 15.0_f64.to_radians().sin_cos();
        let (qx, qy, qz, qw) = (-s * sp, c * sp, s * cp, c * cp);
        let text = format!("# a comment\n\n1.5 2 3 9 {qx} {qy} {qz} {qw}\r\n");
        let pose = read(&text).unwrap()[0];
        assert_eq!((pose.stamp_secs, pose.pose.x, pose.pose.y), (1.5, 2.0, 3.0));
        assert!((pose.pose.theta - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn a_cut_last_line_is_left_out() {
        let whole = "0 0 0 0 0 0 0 1\n1 2 0 0 0 0 0 1\n";
        let cut = read(&format!("{whole}2 3 0 0 0 0 0 0.9")).unwrap();
        assert_eq!(cut, read(whole).unwrap());
    }

    #[test]
    fn errors_name_the_line_the_value_and_what_is_allowed() {
        for (text, parts) in [
            ("", &["empty"][..]),
            ("# only a comment\n", &["empty"]),
            ("0 0 0 0 0 0 0 1\n1 2 3\n", &[":2:", "3 fields", "8 (timestamp"]),
            ("0 0 x 0 0 0 0 1\n", &[":1:", "ty is `x`", "a finite number"]),
            ("0 0 nan 0 0 0 0 1\n", &[":1:", "`nan`"]),
            ("0 0 0 0 0 0 0 0\n", &[":1:", "quaternion is `0`", "0.99 to 1.01"]),
            ("0 0 0 0 0 0 0 1", &[":1:", "cut off"]),
        ] {
            let message = read(text).unwrap_err().to_string();
            for part in parts {
                assert!(message.contains(part), "{text:?}: {message}");
            }
        }
    }

    #[test]
    fn what_cannot_be_written_leaves_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.tum");
        fs::write(&path, "old").unwrap();
        let bad = StampedPose { stamp_secs: f64::NAN, pose: Pose2::IDENTITY };
        assert!(matches!(write_tum(&path, &[bad]), Err(DatasetError::Unwritable { .. })));
        assert!(matches!(write_tum(&path, &[]), Err(DatasetError::Unwritable { .. })));
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        let below_a_file = path.join("t.tum");
        let good = StampedPose { stamp_secs: 0.0, pose: Pose2::IDENTITY };
        assert!(matches!(write_tum(&below_a_file, &[good]), Err(DatasetError::Write { .. })));
        let made = folder.path().join("no/such/folder.tum");
        write_tum(&made, &[good]).unwrap();
        assert_eq!(read_tum(&made).unwrap(), [good]);
    }
}
