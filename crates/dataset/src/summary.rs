use std::collections::BTreeMap;
use std::fmt;

use locsim_core::Pose2;
use serde::Serialize;

/// The kind of poses in a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LogKind {
    /// As the robot recorded it: odometry, and no reference poses.
    Raw,
    /// The scans' laser poses were corrected afterwards, for example by a mapping program: they are the
    /// reference, good to some centimetres.
    Corrected,
    /// TRUEPOS lines give the true poses.
    Simulated,
    /// A topic of reference poses of any source.
    Referenced,
    /// Poses that a localizer on the robot found from the same scans.
    Localized,
}

/// Where the odometry of a log was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum OdometrySource {
    /// The robot pose in each scan's own line.
    ScanLines,
    /// ODOM lines: between those before and after a scan, where their times say so and are at most half a second apart; otherwise the last one before it.
    OdomLines,
    /// ODOM lines that start again from the corrected pose after each scan, as gmapping writes them: the last
    /// one before a scan, seen from the scan before, is the odometry of the interval.
    RestartedOdomLines,
    /// A topic of odometry messages, interpolated at the times of the scans.
    Topic,
    /// Transforms of `/tf`, interpolated at the times of the scans.
    Transforms,
    /// Nowhere: the log was read without.
    Missing,
}

/// Where the laser's mount on the robot was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MountSource {
    /// The caller gave it.
    Given,
    /// Transforms of `/tf_static`.
    StaticTransforms,
    /// Transforms of `/tf` that never change.
    ConstantTransforms,
    /// PARAM lines.
    Parameters,
    /// The laser's pose on the robot in the lines of the scans.
    ScanLines,
    /// Nowhere: the laser is taken to be at the robot's origin.
    Unknown,
}

impl fmt::Display for MountSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Given => "as given",
            Self::StaticTransforms => "from /tf_static",
            Self::ConstantTransforms => "from transforms of /tf that never change",
            Self::Parameters => "from PARAM lines",
            Self::ScanLines => "from the lines of the scans",
            Self::Unknown => "unknown, taken to be the robot's origin",
        })
    }
}

/// Content of a log, and how it was interpreted.
#[derive(Clone, Debug, PartialEq)]
pub struct LogSummary {
    /// Reference poses between the scans, interpolated every 20 ms, with their times \[s\]; empty without a reference, and of a CARMEN log.
    pub between: Vec<(f64, Pose2)>,
    /// The kind of the poses.
    pub kind: LogKind,
    /// Where the odometry comes from.
    pub odometry: OdometrySource,
    /// How kind and odometry were recognised, in words and counts.
    pub evidence: String,
    /// Where the scans come from: the keyword of their lines, or their topic.
    pub scan_source: String,
    /// Number of odometry messages: ODOM lines, or messages of the odometry's topic.
    pub odometry_messages: usize,
    /// Median time between odometry messages (s), where they come apart from the scans.
    pub odometry_interval_secs: Option<f64>,
    /// Number of reference poses: TRUEPOS lines, or messages of the reference's topic.
    pub reference_messages: usize,
    /// Median standard deviations of the reference poses (m, m, rad), where they come with covariances.
    pub reference_deviation: Option<[f64; 3]>,
    /// Median time between reference poses (s), where they come apart from the scans.
    pub reference_interval_secs: Option<f64>,
    /// Number of scans whose reference pose is interpolated between two others.
    pub references_interpolated: usize,
    /// Where the laser's mount comes from.
    pub mount: MountSource,
    /// The topics of a bag, with types and numbers of messages.
    pub topics: Vec<String>,
    /// The pairs of frames among the transforms that were read, as `parent:child`.
    pub transforms: Vec<String>,
    /// What is odd about the recording and how it was taken, in sentences.
    pub remarks: Vec<String>,
    /// Number of lines or messages skipped, by keyword or topic; comments count as `#`.
    pub skipped: BTreeMap<String, usize>,
    /// Number of scans whose time went backwards or leapt and was repaired.
    pub stamps_repaired: usize,
    /// Number of scans with the same time as the scan before, after repair.
    pub stamps_repeated: usize,
    /// Number of scans left out because they are before or after the odometry or in a hole of it, or have no readings.
    pub scans_dropped: usize,
    /// Number of intervals between scans for which [`OdometrySource::RestartedOdomLines`] has no odometry. The
    /// motion of the reference stands in for it, so these steps test nothing.
    pub intervals_without_odometry: usize,
    /// Share of readings at the maximum range.
    pub no_return_share: f64,
    /// Share of readings that are unusable (NaN).
    pub unusable_share: f64,
    /// The longest reading below the maximum range (m); `None` when no reading is.
    pub longest_return_m: Option<f32>,
}

impl LogKind {
    /// What a reference that a localizer found is worth, in a sentence.
    pub const LOCALIZED: &str = "The reference is a localizer's estimate from the same scans: errors against it are differences \
                                 between two localizers.";
}

impl fmt::Display for LogSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.kind {
            LogKind::Raw => "raw log without reference poses",
            LogKind::Corrected => "corrected log",
            LogKind::Simulated => "log with true poses",
            LogKind::Referenced => "log with reference poses",
            LogKind::Localized => "log with the poses of a localizer, which are no independent reference",
        };
        writeln!(f, "{kind}: {}", self.evidence)?;
        if let Some([x, y, theta]) = self.reference_deviation {
            let theta = theta.to_degrees();
            writeln!(
                f,
                "reference: standard deviations of {x:.3} m, {y:.3} m, {theta:.2} deg by its own covariance"
            )?;
        }
        write!(f, "readings: {:.1} % without return", 100.0 * self.no_return_share)?;
        write!(f, ", {:.1} % unusable", 100.0 * self.unusable_share)?;
        if let Some(longest) = self.longest_return_m {
            write!(f, ", longest return {longest} m")?;
        }
        writeln!(f)?;
        if self.stamps_repaired + self.stamps_repeated > 0 {
            writeln!(
                f,
                "times: {} repaired because they went backwards or leapt, {} stand still",
                self.stamps_repaired, self.stamps_repeated
            )?;
        }
        if self.scans_dropped > 0 {
            writeln!(
                f,
                "scans: {} left out, without readings or without odometry at their time",
                self.scans_dropped
            )?;
        }
        if self.intervals_without_odometry > 0 {
            writeln!(
                f,
                "odometry: missing in {} intervals, the reference's motion stands in",
                self.intervals_without_odometry
            )?;
        }
        let skipped: Vec<_> = self.skipped.iter().map(|(word, n)| format!("{word} {n}")).collect();
        write!(f, "skipped: {}", if skipped.is_empty() { "none".into() } else { skipped.join(", ") })
    }
}
