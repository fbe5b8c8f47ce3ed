//! The fixed work, read from its folder.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use locsim_core::limits::{Limits, quoted};
use locsim_core::{Drive, DriveStep, Laser, Particles, Pose2, Scan};
use locsim_world::map::{Geometry, OccupancyGrid, OccupancyMapFile};
use serde::Deserialize;

use crate::BenchError;
use locsim_scenario::check::{self, ANGLE, Allowed, COORDINATE, Checker, MAX_RANGE, NOISE};
use locsim_scenario::limited;
use locsim_scenario::yaml;
use locsim_scenario::yaml::Locations;
use locsim_scenario::{self as scenario, Problem, ScenarioError};

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
        let settings_file = folder.join("workload.json");
        let (settings, locations) = read_settings(&settings_file)?;
        let line = locations.line("true_pose");
        let [x, y, _] = settings.true_pose;
        if !geometry.is_free(x, y) {
            let [x, y] = [x, y].map(check::number);
            let message = format!("[{x}, {y}] is not allowed; a point in the free space of map.yaml");
            return Err(refused(&settings_file, line, "true_pose", &message));
        }
        let pose = |[x, y, theta]: [f64; 3]| Pose2::new(x, y, theta);
        let (bearings, scan) = read_scan(&folder.join("scan.csv"), &settings)?;
        let times = vec![0.0; bearings.len()];
        let laser = Laser::new(bearings, times, 0.0, settings.max_range_m, pose(settings.sensor_pose))
            .map_err(|error| refused(&settings_file, None, "max_range_m", &error.to_string()))?;
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

/// JSON is YAML, and the reader of scenarios knows lines and keys.
fn read_settings(path: &Path) -> Result<(Settings, Locations), BenchError> {
    let (settings, locations) = yaml::parse::<Settings>(path, &yaml::read(path)?)?;
    let mut check = Checker::new(path, &locations, &|_| None);
    for (key, [x, y, theta]) in [
        ("true_pose", settings.true_pose),
        ("sensor_pose", settings.sensor_pose),
        ("odom_delta_fullstep", settings.odom_delta_fullstep),
    ] {
        check.numbers(key, &[x, y], COORDINATE);
        check.number(&format!("{key}[2]"), theta, ANGLE);
    }
    let beam = &settings.beam;
    for (key, value, allowed) in [
        ("max_range_m", settings.max_range_m.into(), MAX_RANGE),
        ("sigma_xy", settings.sigma_xy, NOISE),
        ("sigma_theta", settings.sigma_theta, NOISE),
        ("beam.z_hit", beam.z_hit, NOISE),
        ("beam.z_short", beam.z_short, NOISE),
        ("beam.z_max", beam.z_max, NOISE),
        ("beam.z_rand", beam.z_rand, NOISE),
        ("beam.sigma_hit", beam.sigma_hit, Allowed::Within(1e-6, 1e3)),
        ("beam.lambda_short", beam.lambda_short, Allowed::Within(1e-6, 1e6)),
    ] {
        check.number(key, value, allowed);
    }
    check.numbers("alphas", &settings.alphas, NOISE);
    check.count("n_beams", settings.n_beams as u64, 1, 100_000);
    check.count("n_particles", settings.n_particles as u64, 1, 10_000_000);
    if check.is_clean() { Ok((settings, locations)) } else { Err(check.into_error().into()) }
}

/// Rows of a table, at the most.
const MOST_ROWS: usize = 100_000;

/// Coordinates \[m\], angles \[rad\] and steps, either way.
const SANE: &str = "a number from -1000000 to 1000000";

fn is_sane(value: f64) -> bool {
    value.abs() <= 1e6
}

/// A table of comma-separated numbers with a header.
struct Table {
    path: PathBuf,
    header: csv::StringRecord,
    rows: Vec<csv::StringRecord>,
}

impl Table {
    fn read(path: PathBuf) -> Result<Self, BenchError> {
        let text = limited::read(&path, "table_bytes", Limits::current().table_bytes)?;
        let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(text.as_slice());
        let refuse = |error: &csv::Error| BenchError::Csv {
            path: path.clone(),
            line: error.position().map_or(1, csv::Position::line),
            column: "row".to_owned(),
            what: format!("{error}; text of numbers, separated by commas, is needed"),
        };
        let header = reader.headers().map_err(|error| refuse(&error))?.clone();
        let rows: Vec<_> =
            reader.records().take(MOST_ROWS + 1).collect::<Result<_, _>>().map_err(|error| refuse(&error))?;
        let table = Self { path, header, rows };
        if table.rows.len() > MOST_ROWS {
            let line = MOST_ROWS as u64 + 2;
            return Err(table.refuse(line, "row", &format!("more than {MOST_ROWS} rows are not allowed")));
        }
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
            let found: Vec<String> = self.header.iter().take(10).map(quoted).collect();
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
            let found = if word.is_empty() { "nothing".to_owned() } else { quoted(word) };
            self.refuse(line, &quoted(name), &format!("{found} is not allowed; {allowed}"))
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
        bearings.push(table.number(row, angle, "an angle in radians, up to 1000000", is_sane)? as f32);
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
        let number = |column| table.number(row, column, SANE, is_sane);
        Ok(Pose2::new(number(x)?, number(y)?, number(theta)?))
    };
    let steps = table.rows.iter().map(|row| {
        let ranges = readings.iter().map(|&column| reading(&table, row, column, laser.max_range()));
        Ok(DriveStep {
            stamp_secs: table.number(row, step, SANE, is_sane)?,
            odometry: pose(row, odometry)?,
            reference: Some(pose(row, truth)?),
            scan: Scan { ranges: ranges.collect::<Result<_, BenchError>>()? },
        })
    });
    Ok(Drive { laser: laser.clone(), steps: steps.collect::<Result<_, BenchError>>()? })
}

/// `count` times x, y, theta as little-endian 64-bit floating-point numbers.
fn read_particles(path: &Path, count: usize) -> Result<Particles, BenchError> {
    let refuse = |what| BenchError::Particles { path: path.to_owned(), what };
    let needed = 24 * count as u64;
    // One more tells that there are more, whatever the file is.
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|file| file.take(needed + 1).read_to_end(&mut bytes))
        .map_err(BenchError::system(path))?;
    let read = bytes.len() as u64;
    if read != needed {
        let found = std::fs::metadata(path).map_or(0, |found| found.len()).max(read);
        let allowed = format!("{needed}, as n_particles in workload.json is {count}, 24 bytes each");
        return Err(refuse(format!("{found} bytes are not allowed; {allowed}")));
    }
    let (numbers, _) = bytes.as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|number| f64::from_le_bytes(*number)).collect();
    if let Some(i) = numbers.iter().position(|number| !is_sane(*number)) {
        return Err(refuse(format!("number {i} is {}; {SANE} is needed", check::number(numbers[i]))));
    }
    let (poses, _) = numbers.as_chunks::<3>();
    Ok(poses.iter().map(|&[x, y, theta]| Pose2::new(x, y, theta)).collect())
}
