//! The fixed work, read from its folder.

use std::fs;
use std::path::{Path, PathBuf};

use locsim_core::{Drive, DriveStep, Laser, Particles, Pose2, Scan};
use locsim_world::map::{Geometry, OccupancyGrid, OccupancyMapFile};
use serde::Deserialize;

use super::BenchError;
use crate::scenario::{self, Problem, ScenarioError};
use crate::yaml;

/// Everything that the folder of a benchmark holds.
#[derive(Clone)]
pub struct Workload {
    /// The map's walls.
    pub geometry: Geometry,
    /// The same map as cells, for the plain loop.
    pub grid: OccupancyGrid,
    /// The sensor: bearings of `scan.csv`, maximum range and mount of `workload.json`.
    pub laser: Laser,
    /// The scan of the timed update.
    pub scan: Scan,
    /// The particles of the timed update, `map_from_base`.
    pub particles: Particles,
    /// True pose of that scan.
    pub truth: Pose2,
    /// Standard deviations of the particles \[m\] and \[rad\].
    pub spread: (f64, f64),
    /// Odometry increment of the timed full step.
    pub increment: Pose2,
    /// Noise of the odometry motion model (Probabilistic Robotics, table 5.6).
    pub alpha: [f64; 4],
    /// The beam model's parameters that other programs ran with, for the plain loop.
    pub beam: BeamParameters,
    /// Recorded drives in the world as mapped.
    pub static_world: Drive,
    /// The same among moving objects that the map doesn't know.
    pub dynamic_world: Drive,
}

/// The textbook's beam model (Probabilistic Robotics, table 6.1).
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct BeamParameters {
    /// Weight of the Gaussian at the nominal range.
    pub z_hit: f64,
    /// Weight of the exponential before it.
    pub z_short: f64,
    /// Weight of the maximum range.
    pub z_max: f64,
    /// Weight of the uniform.
    pub z_rand: f64,
    /// Deviation of the Gaussian \[m\].
    pub sigma_hit: f64,
    /// Rate of the exponential \[1/m\].
    pub lambda_short: f64,
}

/// `workload.json`; keys that only other programs need are passed over.
#[derive(Deserialize)]
struct Settings {
    true_pose: [f64; 3],
    max_range_m: f32,
    n_beams: usize,
    n_particles: usize,
    sigma_xy: f64,
    sigma_theta: f64,
    sensor_pose: [f64; 3],
    odom_delta_fullstep: [f64; 3],
    alphas: [f64; 4],
    beam: BeamParameters,
}

impl Workload {
    /// Reads `map.yaml` with its image, `workload.json`, `scan.csv`, `particles_f64le.bin`, `traj_static.csv` and
    /// `traj_dynamic.csv`.
    ///
    /// # Errors
    /// [`BenchError`] that names the file and, where there is one, line, key or column, value, and what is allowed.
    pub fn read(folder: &Path) -> Result<Self, BenchError> {
        let map = folder.join("map.yaml");
        let geometry = scenario::load_map(&map)?.geometry;
        let (map_file, _) = yaml::parse::<OccupancyMapFile>(&map, &yaml::read(&map)?)?;
        let grid = map_file.load(folder)?;
        let settings = read_settings(&folder.join("workload.json"))?;
        let pose = |[x, y, theta]: [f64; 3]| Pose2::new(x, y, theta);
        let (bearings, scan) = read_scan(&folder.join("scan.csv"), &settings)?;
        let times = vec![0.0; bearings.len()];
        let laser = Laser::new(bearings, times, 0.0, settings.max_range_m, pose(settings.sensor_pose))
            .map_err(|error| {
                refused(&folder.join("workload.json"), None, "max_range_m", &error.to_string())
            })?;
        let drive = |name| read_drive(&folder.join(name), &laser);
        Ok(Self {
            geometry,
            grid,
            scan,
            particles: read_particles(&folder.join("particles_f64le.bin"), settings.n_particles)?,
            truth: pose(settings.true_pose),
            spread: (settings.sigma_xy, settings.sigma_theta),
            increment: pose(settings.odom_delta_fullstep),
            alpha: settings.alphas,
            beam: settings.beam,
            static_world: drive("traj_static.csv")?,
            dynamic_world: drive("traj_dynamic.csv")?,
            laser,
        })
    }
}

fn refused(file: &Path, line: Option<usize>, key: &str, message: &str) -> BenchError {
    let problem = Problem { line, key: key.to_owned(), message: message.to_owned() };
    ScenarioError::Invalid { file: file.to_owned(), problems: vec![problem] }.into()
}

/// A key, its values, what is allowed, and whether a value is.
type Check<'a> = (&'a str, &'a [f64], &'a str, &'a dyn Fn(f64) -> bool);

/// JSON is YAML, and the reader of scenarios knows lines and keys.
fn read_settings(path: &Path) -> Result<Settings, BenchError> {
    let (settings, locations) = yaml::parse::<Settings>(path, &yaml::read(path)?)?;
    let finite = |v: f64| v.is_finite();
    let at_least_0 = |v: f64| v.is_finite() && v >= 0.0;
    let beam = &settings.beam;
    let numbers: [Check<'_>; 13] = [
        ("true_pose", &settings.true_pose, "finite", &finite),
        ("sensor_pose", &settings.sensor_pose, "finite", &finite),
        ("odom_delta_fullstep", &settings.odom_delta_fullstep, "finite", &finite),
        ("sigma_xy", &[settings.sigma_xy], "at least 0", &at_least_0),
        ("sigma_theta", &[settings.sigma_theta], "at least 0", &at_least_0),
        ("alphas", &settings.alphas, "at least 0", &at_least_0),
        ("beam.z_hit", &[beam.z_hit], "at least 0", &at_least_0),
        ("beam.z_short", &[beam.z_short], "at least 0", &at_least_0),
        ("beam.z_max", &[beam.z_max], "at least 0", &at_least_0),
        ("beam.z_rand", &[beam.z_rand], "at least 0", &at_least_0),
        ("beam.sigma_hit", &[beam.sigma_hit], "above 0", &|v| v.is_finite() && v > 0.0),
        ("beam.lambda_short", &[beam.lambda_short], "above 0", &|v| v.is_finite() && v > 0.0),
        ("n_beams", &[settings.n_beams as f64], "from 1 to 100000", &|v| (1.0..=1e5).contains(&v)),
    ];
    for (key, values, allowed, ok) in numbers {
        if let Some(value) = values.iter().find(|&&value| !ok(value)) {
            let message = format!("{value} is not allowed; {allowed}");
            return Err(refused(path, locations.line(key), key, &message));
        }
    }
    Ok(settings)
}

/// A table of comma-separated numbers with a header.
struct Table {
    path: PathBuf,
    header: csv::StringRecord,
    rows: Vec<csv::StringRecord>,
}

impl Table {
    fn read(path: PathBuf) -> Result<Self, BenchError> {
        let text = fs::read(&path).map_err(BenchError::system(&path))?;
        let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(text.as_slice());
        let refuse = |error: &csv::Error| BenchError::Csv {
            path: path.clone(),
            line: error.position().map_or(1, csv::Position::line),
            column: "row".to_owned(),
            what: format!("{error}; text of numbers, separated by commas, is needed"),
        };
        let header = reader.headers().map_err(|error| refuse(&error))?.clone();
        let rows: Vec<_> = reader.records().collect::<Result<_, _>>().map_err(|error| refuse(&error))?;
        let table = Self { path, header, rows };
        if table.rows.is_empty() {
            return Err(table.refuse(1, "row", "there is none; a header and at least one row are needed"));
        }
        Ok(table)
    }

    fn refuse(&self, line: u64, column: &str, what: &str) -> BenchError {
        BenchError::Csv { path: self.path.clone(), line, column: column.to_owned(), what: what.to_owned() }
    }

    fn column(&self, name: &str) -> Result<usize, BenchError> {
        self.header.iter().position(|column| column == name).ok_or_else(|| {
            let found: Vec<&str> = self.header.iter().take(10).collect();
            self.refuse(1, name, &format!("the column is missing; the header has {} ..", found.join(", ")))
        })
    }

    /// The number in a row and column, if `ok` allows it.
    fn number(
        &self,
        row: &csv::StringRecord,
        column: usize,
        allowed: &str,
        ok: impl Fn(f64) -> bool,
    ) -> Result<f64, BenchError> {
        let word = row.get(column).unwrap_or("").trim();
        word.parse().ok().filter(|&value| ok(value)).ok_or_else(|| {
            let line = row.position().map_or(0, csv::Position::line);
            let name = self.header.get(column).unwrap_or_default();
            let found = if word.is_empty() { "nothing" } else { word };
            self.refuse(line, name, &format!("{found} is not allowed; {allowed}"))
        })
    }
}

/// Bearings \[rad\] and readings of the scan.
fn read_scan(path: &Path, settings: &Settings) -> Result<(Vec<f32>, Scan), BenchError> {
    let table = Table::read(path.to_owned())?;
    if table.rows.len() != settings.n_beams {
        let what = format!("{} beams; workload.json says {}", table.rows.len(), settings.n_beams);
        return Err(table.refuse(table.rows.len() as u64 + 1, "beam", &what));
    }
    let (angle, range) = (table.column("angle_rad")?, table.column("range_m")?);
    let (mut bearings, mut scan) = (Vec::new(), Scan::default());
    for row in &table.rows {
        bearings.push(table.number(row, angle, "a finite angle in radians", f64::is_finite)? as f32);
        scan.ranges.push(reading(&table, row, range, settings.max_range_m)?);
    }
    Ok((bearings, scan))
}

/// A range, from 0 to the maximum \[m\].
fn reading(table: &Table, row: &csv::StringRecord, column: usize, max: f32) -> Result<f32, BenchError> {
    let allowed = format!("a range from 0 to the maximum, {max} m");
    let value = table.number(row, column, &allowed, |z| (0.0..=f64::from(max)).contains(&z))?;
    Ok(value as f32)
}

/// Steps with true pose, odometry pose and the readings `r0`, `r1`, ..
fn read_drive(path: &Path, laser: &Laser) -> Result<Drive, BenchError> {
    let table = Table::read(path.to_owned())?;
    let columns = |names: [&str; 3]| -> Result<[usize; 3], BenchError> {
        Ok([table.column(names[0])?, table.column(names[1])?, table.column(names[2])?])
    };
    let step = table.column("step")?;
    let truth = columns(["gt_x", "gt_y", "gt_theta"])?;
    let odometry = columns(["odom_x", "odom_y", "odom_theta"])?;
    let readings: Vec<usize> =
        (0..laser.beam_count()).map(|beam| table.column(&format!("r{beam}"))).collect::<Result<_, _>>()?;
    let pose = |row: &csv::StringRecord, [x, y, theta]: [usize; 3]| -> Result<Pose2, BenchError> {
        let number = |column| table.number(row, column, "a finite number", f64::is_finite);
        Ok(Pose2::new(number(x)?, number(y)?, number(theta)?))
    };
    let steps = table.rows.iter().map(|row| {
        let ranges = readings.iter().map(|&column| reading(&table, row, column, laser.max_range()));
        Ok(DriveStep {
            stamp_secs: table.number(row, step, "a finite number", f64::is_finite)?,
            odometry: pose(row, odometry)?,
            reference: Some(pose(row, truth)?),
            scan: Scan { ranges: ranges.collect::<Result<_, BenchError>>()? },
        })
    });
    Ok(Drive { laser: laser.clone(), steps: steps.collect::<Result<_, BenchError>>()? })
}

/// `count` times x, y, theta as little-endian 64-bit floating-point numbers.
fn read_particles(path: &Path, count: usize) -> Result<Particles, BenchError> {
    let bytes = fs::read(path).map_err(BenchError::system(path))?;
    let refuse = |what| BenchError::Particles { path: path.to_owned(), what };
    if count == 0 || bytes.len() != 24 * count {
        let needed = format!("n_particles in workload.json is {count}, 24 bytes each");
        return Err(refuse(format!("{} bytes are not allowed; {needed}, at least one", bytes.len())));
    }
    let (numbers, _) = bytes.as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|number| f64::from_le_bytes(*number)).collect();
    if let Some(i) = numbers.iter().position(|number| !number.is_finite()) {
        return Err(refuse(format!("number {i} is {}; a finite number is needed", numbers[i])));
    }
    let (poses, _) = numbers.as_chunks::<3>();
    Ok(poses.iter().map(|&[x, y, theta]| Pose2::new(x, y, theta)).collect())
}
