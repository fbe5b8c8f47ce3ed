//! The cost of a run, estimated from its scenario alone. A run that the machine can't hold is refused before it starts.

use std::f64::consts::TAU;

use locsim_core::LikelihoodGrid;
use locsim_core::limits::Limits;
use locsim_world::map::Geometry;
use locsim_world::simulation::Trajectory;
use sysinfo::{MemoryRefreshKind, RefreshKind, System};

use crate::LabError;
use locsim_mcl::{KldOptions, PRUNED_AFTER, ParticleCount};
use locsim_scenario::{Estimate as PoseEstimate, ModelName, RayCast, Scenario, Simulation, Source, load_map};

/// Bytes of a training reading in all the forms that it has at once: as scanned, in the training set, as the list of
/// readings and beams that a mixture is fitted to (40 bytes).
const BYTES_OF_TRAINING_READING: f64 = 56.0;
/// Bytes of a scan's own bookkeeping.
const BYTES_OF_SCAN: f64 = 48.0;
/// Bytes of a training state: a beam at a pose, in the whole set and in its two parts.
const BYTES_OF_STATE: f64 = 128.0;
/// Bytes of a particle in a filter; docs/ARCHITECTURE.md counts them.
const BYTES_OF_PARTICLE: f64 = 88.0;
/// Bytes of a particle's pose and parent, kept for the last steps where trajectories are wanted.
const BYTES_OF_ANCESTOR: f64 = 36.0;
/// Bytes of a row of results while trials run, and in all the forms that a report makes of it, when map and models are gone.
const BYTES_OF_ROW: [f64; 2] = [300.0, 1500.0];
/// Bytes of a model's table, in the square of its readings: half as many nominal ranges again, by 16 incidences, of two bytes.
const BYTES_OF_TABLE: f64 = 48.0;
/// Bytes of a simulated scan and of its messages in a log, and of each of its readings in both.
const BYTES_OF_WRITTEN_SCAN: f64 = 2000.0;
const BYTES_OF_WRITTEN_READING: f64 = 16.0;
/// Bytes of the program itself, its tables and figures.
const BYTES_OF_PROGRAM: f64 = 150e6;

/// Seconds for a particle and a beam: from the table, by exact casts, and for the oracle, which integrates.
const SECONDS_PER_BEAM: [f64; 3] = [7e-9, 120e-9, 120e-9];
/// Seconds for a simulated training reading, and to train one model on it.
const SECONDS_PER_READING: [f64; 2] = [0.5e-6, 2e-6];
/// Seconds to train a model and to draw its figures, whatever the data.
const SECONDS_PER_MODEL: f64 = 1.5;

/// Seconds for a bin of headings of a cell of the range table in which one wall shows, and for each wall more; at most so many
/// walls are told apart.
const SECONDS_PER_BIN: [f64; 2] = [0.6e-6, 1e-6];
const MOST_WALLS: f64 = 24.0;
/// Bins of headings, and the angle of one \[rad\].
const BINS: f64 = 256.0;
const BIN_RAD: f64 = TAU / BINS;

/// The approximate cost of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Memory \[bytes\], at most.
    pub memory_bytes: f64,
    /// Processor time \[s\]; `None` on a measured log, whose length isn't known before it is read.
    pub cpu_secs: Option<f64>,
    /// The keys that most of the memory is due to, and how much.
    largest: (&'static str, f64),
}

impl Estimate {
    /// The estimate for a scenario whose trials run on `threads` threads.
    pub fn of(scenario: &Scenario, threads: usize) -> Self {
        let threads = threads as f64;
        let trials = f64::from(scenario.trials);
        let models = scenario.models.len() as f64;
        let training = &scenario.training;
        let (poses, observations) = (f64::from(training.poses), f64::from(training.observations));
        let simulated = match &scenario.source {
            Source::Simulation(simulation) => Some(simulation),
            Source::Log(_) => None,
        };
        // A log says how many beams it has only when it is read; most have fewer.
        let beams = simulated.map_or(360.0, |simulation| f64::from(simulation.laser.beams));
        let training_beams = training.beams.map_or(beams, f64::from).min(beams);
        let filter_beams = scenario.filter.beams.map_or(beams, f64::from).min(beams);
        let steps = simulated.and_then(steps_of);
        let particles = match scenario.filter.particles {
            ParticleCount::Fixed(count) => count as f64,
            ParticleCount::Kld(KldOptions { max, .. }) => max as f64,
        };
        let candidates = scenario.filter.annealing.map_or(0.0, |annealing| annealing.candidates as f64);

        let most = f64::from(LikelihoodGrid::MOST_READINGS);
        let knots = simulated.map_or(most, |simulation| simulation.laser.max_range_m / 0.005);
        // The fields look at where a reading ends, the oracle casts, and AMCL's weight of a scan is no product over beams.
        let has_table = |name| matches!(name, ModelName::Fitted(kind) if kind.is_normalized());
        let tables = scenario.models.iter().filter(|model| has_table(model.name)).count() as f64;
        let bytes_of_tables = tables * BYTES_OF_TABLE * knots.min(most).powi(2);

        let readings = poses * observations * training_beams;
        let trajectories = match scenario.filter.estimate {
            PoseEstimate::MostLikelyTrajectory => threads,
            // The recorded trial alone.
            _ => 1.0,
        };
        let [row, row_in_report] = BYTES_OF_ROW;
        let rows = trials * models * steps.unwrap_or(0.0);
        let of_report = ("trials", rows * row_in_report);
        let of_trials = [
            (
                "training.poses x training.observations",
                poses * observations * (4.0 * beams + BYTES_OF_SCAN)
                    + readings * BYTES_OF_TRAINING_READING
                    + poses * training_beams * BYTES_OF_STATE,
            ),
            ("filter.particles", particles.max(candidates) * BYTES_OF_PARTICLE * threads),
            (
                "filter.particles x filter.estimate",
                trajectories * particles * steps.unwrap_or(0.0).min(PRUNED_AFTER as f64) * BYTES_OF_ANCESTOR,
            ),
            ("trials", rows * row),
            (
                "models",
                match scenario.ray_cast {
                    RayCast::Table { .. } => bytes_of_tables,
                    RayCast::Exact => 0.0,
                },
            ),
            ("laser.rate_hz x laser.beams", (threads + 1.0) * steps.unwrap_or(0.0) * 4.0 * beams),
            (
                "ray_cast.memory_mb",
                match scenario.ray_cast {
                    RayCast::Table { memory_mb, .. } => f64::from(memory_mb) * f64::from(1 << 20),
                    RayCast::Exact => 0.0,
                },
            ),
        ];
        let cpu_secs = steps.map(|steps| {
            let [table, exact, oracle] = SECONDS_PER_BEAM;
            let cast = if scenario.ray_cast == RayCast::Exact { exact } else { table };
            let of_beam = |name| if name == ModelName::Oracle { cast + oracle } else { cast };
            let beam: f64 = scenario.models.iter().map(|model| of_beam(model.name)).sum();
            let [observe, train] = SECONDS_PER_READING;
            trials * steps * particles * filter_beams * beam
                + poses * observations * beams * observe
                + models * (readings * train + SECONDS_PER_MODEL)
        });
        let most = of_trials.iter().map(|(_, bytes)| bytes).sum::<f64>().max(of_report.1);
        let largest = of_trials.into_iter().chain([of_report]).max_by(|a, b| a.1.total_cmp(&b.1));
        let memory_bytes = BYTES_OF_PROGRAM + most;
        Self { memory_bytes, cpu_secs, largest: largest.unwrap_or(of_report) }
    }

    /// The estimate with the time for the map's range table. The map is read, so that this isn't for each cell of a sweep, which keeps its
    /// tables anyway.
    #[must_use]
    pub fn with_table(mut self, scenario: &Scenario) -> Self {
        if let (Source::Simulation(simulation), RayCast::Table { cell_m, memory_mb }) =
            (&scenario.source, scenario.ray_cast)
            && let Ok(map) = load_map(&simulation.map)
            && let Some(secs) = &mut self.cpu_secs
        {
            *secs += secs_of_table(&map.geometry, cell_m, f64::from(memory_mb) * f64::from(1 << 20));
        }
        self
    }

    /// The estimate for `locsim simulate`, which holds the whole log of one trial.
    pub fn of_simulated_log(simulation: &Simulation) -> Self {
        let scans = steps_of(simulation).unwrap_or(0.0);
        let bytes =
            scans * (BYTES_OF_WRITTEN_SCAN + BYTES_OF_WRITTEN_READING * f64::from(simulation.laser.beams));
        let memory_bytes = BYTES_OF_PROGRAM + bytes;
        Self { memory_bytes, cpu_secs: None, largest: ("laser.rate_hz x laser.beams", bytes) }
    }

    /// Refuses a run that needs more memory than there is.
    ///
    /// # Errors
    /// [`LabError::Scenario`] with the keys to lower.
    pub fn check(&self, scenario: &Scenario) -> Result<(), LabError> {
        let limit = Limits::current().memory_bytes;
        let (available, of) =
            if limit > 0 { (limit as f64, "the limit is") } else { (free_memory(), "the process can get") };
        if self.memory_bytes <= available {
            return Ok(());
        }
        let (keys, bytes) = self.largest;
        let message = format!(
            "the run needs {} of memory, {} of it because of {keys}, which has to be lowered; {of} {} \
             (`--limit memory_bytes={:.0}` runs it all the same)",
            size(self.memory_bytes),
            size(bytes),
            size(available),
            self.memory_bytes.ceil()
        );
        let key = keys.split(' ').next().unwrap_or_default();
        Err(scenario.refusal(key, message).into())
    }

    /// The estimate in words, for a run on `threads` threads.
    pub fn in_words(&self, threads: usize) -> String {
        let memory = format!("at most {} of memory", size(self.memory_bytes));
        match self.cpu_secs {
            Some(secs) => format!("about {}, {memory}", duration(secs / threads as f64)),
            None => memory,
        }
    }
}

/// Processor time for a map's range table \[s\]. It grows with the number of walls in a bin of a cell, of which there are dozens
/// where walls are short.
fn secs_of_table(map: &Geometry, cell_m: f64, most_bytes: f64) -> f64 {
    const SIDE: u32 = 64;
    let [x0, y0, x1, y1] = map.bounds();
    let part = |i: u32| (f64::from(i) + 0.5) / f64::from(SIDE);
    let points = (0..SIDE).flat_map(|row| (0..SIDE).map(move |column| (part(column), part(row))));
    let free = points.filter(|(u, v)| map.is_free(x0 + u * (x1 - x0), y0 + v * (y1 - y0))).count() as f64;
    let area = (x1 - x0) * (y1 - y0) * free / f64::from(SIDE * SIDE);
    let cells = (area / cell_m.powi(2)).min(most_bytes / (4.0 * BINS));
    // The walls of the free space stand about half its side away.
    let shown_m = cell_m + 0.5 * area.sqrt() * BIN_RAD;
    let walls = shown_m * map.segments().len() as f64 / map.wall_length_m().max(f64::MIN_POSITIVE);
    let [one, more] = SECONDS_PER_BIN;
    cells * BINS * (one + more * walls.min(MOST_WALLS))
}

/// How many scans a simulated drive has; `None` for a path that is refused.
fn steps_of(simulation: &Simulation) -> Option<f64> {
    let path = Trajectory::new(&simulation.robot.path).ok()?;
    Some((path.duration_secs() * simulation.laser.rate_hz).floor() + 1.0)
}

/// Memory that a process can still get \[bytes\]: the machine's, its control group's, or what `ulimit -v` leaves it.
fn free_memory() -> f64 {
    let memory = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
    let system = System::new_with_specifics(memory);
    let machine = system.available_memory();
    let group = system.cgroup_limits().map_or(u64::MAX, |group| group.free_memory);
    machine.min(group).min(address_space()) as f64
}

/// Addresses that `ulimit -v` leaves the process \[bytes\].
#[cfg(target_os = "linux")]
fn address_space() -> u64 {
    let Some(most) = rustix::process::getrlimit(rustix::process::Resource::As).current else {
        return u64::MAX;
    };
    let mut system = System::new();
    let own = sysinfo::Pid::from_u32(std::process::id());
    system.refresh_processes(sysinfo::ProcessesToUpdate::Some(&[own]), false);
    most.saturating_sub(system.process(own).map_or(0, sysinfo::Process::virtual_memory))
}

#[cfg(not(target_os = "linux"))]
fn address_space() -> u64 {
    u64::MAX
}

/// Bytes as people say them.
pub fn size(bytes: f64) -> String {
    let units = ["B", "kB", "MB", "GB", "TB", "PB", "EB"];
    let step = ((bytes.max(1.0).log10() / 3.0) as usize).min(units.len() - 1);
    let value = bytes / 1000_f64.powi(step as i32);
    if value < 10.0 { format!("{value:.1} {}", units[step]) } else { format!("{value:.0} {}", units[step]) }
}

/// A time as people say it.
pub fn duration(secs: f64) -> String {
    let (value, unit) = match secs {
        ..60.0 => (secs, "s"),
        ..3600.0 => (secs / 60.0, "min"),
        ..86400.0 => (secs / 3600.0, "h"),
        _ => (secs / 86400.0, "days"),
    };
    if value < 10.0 { format!("{value:.1} {unit}") } else { format!("{value:.0} {unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use locsim_scenario::Overrides;

    fn shipped(from: &str, to: &str) -> (tempfile::TempDir, Scenario) {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../");
        let text = std::fs::read_to_string(format!("{root}scenarios/table2.yaml")).unwrap();
        assert!(text.contains(from));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("s.yaml");
        let text = text.replace(from, to).replace("../maps/", &format!("{root}maps/"));
        std::fs::write(&file, text).unwrap();
        let scenario = Scenario::load(&file, &Overrides::default()).unwrap();
        (folder, scenario)
    }

    #[test]
    fn a_run_that_no_machine_can_hold_is_refused_with_the_key_to_lower() {
        let training = "training: {poses: 150, observations: 100";
        for (from, to, key) in [
            (training, "training: {poses: 1000000, observations: 100000", "training.poses"),
            ("particles: 1000", "particles: 10000000", "filter.particles"),
            ("trials: 200", "trials: 1000000", "trials"),
        ] {
            let (_folder, scenario) = shipped(from, to);
            let refused = Estimate::of(&scenario, 8).check(&scenario).unwrap_err().to_string();
            assert!(refused.contains(&format!(": {key}: the run needs ")), "{refused}");
            let line = std::fs::read_to_string(&scenario.file)
                .unwrap()
                .lines()
                .position(|line| line.contains(to))
                .unwrap();
            assert!(refused.contains(&format!("s.yaml:{}: ", line + 1)), "{refused}");
        }
    }

    #[test]
    fn the_shipped_experiment_costs_a_minute_and_less_than_a_gigabyte() {
        let (_folder, scenario) = shipped("trials: 200", "trials: 200");
        let cost = Estimate::of(&scenario, 2);
        // A minute on two cores, as the README says.
        assert!((60.0..240.0).contains(&cost.cpu_secs.unwrap()), "{cost:?}");
        assert!(cost.memory_bytes < 1e9 && cost.check(&scenario).is_ok(), "{cost:?}");
    }

    #[test]
    fn sizes_and_times_are_said_as_people_do() {
        assert_eq!([0.0, 999.0, 4.8e12, 150e6].map(size), ["0.0 B", "999 B", "4.8 TB", "150 MB"]);
        assert_eq!([2.0, 90.0, 7200.0, 1e7].map(duration), ["2.0 s", "1.5 min", "2.0 h", "116 days"]);
    }
}
