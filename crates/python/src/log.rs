use std::path::PathBuf;

use locsim_core::{Drive, Pose2};
use locsim_dataset::{self as dataset, BagTopics, LogOptions};
use locsim_lab::run::simulate_trial;
use locsim_scenario::Overrides;
use pyo3::prelude::*;

use crate::array::{numpy, pose_array};
use crate::error::{Error, refused};
use crate::scenario;
use crate::work::Work;

/// A pose that isn't known.
const UNKNOWN: Pose2 = Pose2 { x: f64::NAN, y: f64::NAN, theta: f64::NAN };

/// A recorded drive, simulated or measured: n scans of k beams, with the robot's pose at each by odometry and, where it is known,
/// in the map.
#[pyclass(frozen, module = "locsim")]
pub struct Log {
    drive: Drive,
    /// What was found in the log, in words.
    #[pyo3(get)]
    summary: String,
    /// Its stamps begin at 0.
    simulated: bool,
}

/// Reads a CARMEN log or a ROS 2 bag (a folder, MCAP or SQLite), packed or not.
///
/// Args:
///     path: The log.
///     max_range_m: Readings of this range or more mean "no return"; the log's own maximum by default.
///     scan_topic, odometry_topic, reference_topic: Topics of a bag, where it has several. A reference may also be a transform,
///         such as `map:base_link`.
///     without_odometry: Reads the scans of a bag alone.
///
/// Raises:
///     LogError: The log can't be read; with the file and, of a text, the line.
#[pyfunction]
#[pyo3(signature = (
    path, *, max_range_m = None, scan_topic = None, odometry_topic = None, reference_topic = None,
    without_odometry = false,
))]
pub fn read_log(
    py: Python<'_>,
    path: PathBuf,
    max_range_m: Option<f32>,
    scan_topic: Option<String>,
    odometry_topic: Option<String>,
    reference_topic: Option<String>,
    without_odometry: bool,
) -> Result<Log, Error> {
    let topics = BagTopics { scan: scan_topic, odometry: odometry_topic, reference: reference_topic };
    let options = LogOptions { max_range_m, topics, without_odometry };
    let (drive, summary) =
        Work::new(py, Some(false), None)?.run(py, |_| dataset::read_log(&path, &options))?;
    Ok(Log { drive, summary: summary.to_string(), simulated: false })
}

/// Simulates the drive of one trial of a scenario, with all beams of its laser.
///
/// Raises:
///     ScenarioError: The scenario is refused.
///     LogError: It is of a measured log.
#[pyfunction]
#[pyo3(signature = (source, *, trial = 0, seed = None))]
pub fn simulate(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    trial: u32,
    seed: Option<u64>,
) -> Result<Log, Error> {
    let scenario = scenario::of(source, Overrides { seed, ..Overrides::default() })?;
    let drive = Work::new(py, Some(false), None)?.run(py, |_| simulate_trial(&scenario, trial))?;
    Ok(Log { drive, summary: format!("trial {trial} of {}, simulated", scenario.name), simulated: true })
}

#[pymethods]
impl Log {
    /// Time of each scan [s], float64 [scans].
    #[getter]
    fn stamps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let stamps: Vec<f64> = self.drive.steps.iter().map(|step| step.stamp_secs).collect();
        numpy(py, &stamps, &[stamps.len()])
    }

    /// True or reference pose of the robot at each scan (x, y, theta), float64 [scans, 3]; NaN where it isn't known.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        pose_array(py, self.drive.steps.iter().map(|step| step.reference.unwrap_or(UNKNOWN)))
    }

    /// Pose of the robot by odometry alone (x, y, theta), float64 [scans, 3].
    #[getter]
    fn odometry<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        pose_array(py, self.drive.steps.iter().map(|step| step.odometry))
    }

    /// Motion since the scan before by odometry, in the frame of the robot there, float64 [scans, 3]; zeros for the first.
    #[getter]
    fn increments<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        pose_array(py, (0..self.drive.steps.len()).map(|i| self.drive.odometry_increment(i)))
    }

    /// Readings [m], float32 [scans, beams]; the maximum range means "no return", NaN no usable reading.
    #[getter]
    fn ranges<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let ranges: Vec<f32> = self.drive.steps.iter().flat_map(|step| &step.scan.ranges).copied().collect();
        numpy(py, &ranges, &[self.drive.steps.len(), self.drive.laser.beam_count()])
    }

    /// Bearing of each beam in the frame of the laser [rad], float32 [beams].
    #[getter]
    fn bearings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        numpy(py, self.drive.laser.bearings(), &[self.drive.laser.beam_count()])
    }

    /// When each beam was taken [s], after the scan's stamp, float32 [beams].
    #[getter]
    fn beam_times<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        numpy(py, self.drive.laser.beam_times_secs(), &[self.drive.laser.beam_count()])
    }

    /// The sensor's minimum range [m].
    #[getter]
    fn min_range(&self) -> f32 {
        self.drive.laser.min_range()
    }

    /// The sensor's maximum range [m].
    #[getter]
    fn max_range(&self) -> f32 {
        self.drive.laser.max_range()
    }

    /// Where the laser is on the robot (x, y, theta).
    #[getter]
    fn mount(&self) -> (f64, f64, f64) {
        let Pose2 { x, y, theta } = self.drive.laser.base_from_laser();
        (x, y, theta)
    }

    /// The same of the laser, float64 [scans, 3].
    #[getter]
    fn laser_poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let mount = self.drive.laser.base_from_laser();
        let pose = |base: Option<Pose2>| base.map_or(UNKNOWN, |base| base.compose(&mount));
        pose_array(py, self.drive.steps.iter().map(|step| pose(step.reference)))
    }

    /// The same drive with at most `count` beams in a scan, evenly spread.
    fn with_beams(&self, count: usize) -> Result<Self, Error> {
        if count == 0 {
            return Err(refused("count: 0 is not allowed; a whole number from 1"));
        }
        let summary = self.summary.clone();
        Ok(Self { drive: self.drive.with_beams(count), summary, simulated: self.simulated })
    }

    /// Writes the drive as a ROS 2 bag where the name ends in `.mcap`, and otherwise as a CARMEN log, packed where it ends in `.gz`.
    ///
    /// Raises:
    ///     LogError: It can't be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> Result<(), Error> {
        let write = if self.simulated { dataset::write_simulated_log } else { dataset::write_log };
        Ok(py.detach(|| write(&path, &self.drive))?)
    }

    fn __len__(&self) -> usize {
        self.drive.steps.len()
    }

    fn __repr__(&self) -> String {
        format!("Log({} scans of {} beams)", self.drive.steps.len(), self.drive.laser.beam_count())
    }
}
