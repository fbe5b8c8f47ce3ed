//! The fixed benchmark work: how fast and how exact the filter is beside other programs on the same files.

mod accuracy;
mod figures;
mod measure;
mod plain;
mod replay;
mod sweeps;
mod table;
mod timing;
mod workload;
mod world;

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use locsim_core::{Clock, Drive, RangeMap};
use locsim_mcl::{AnnealingOptions, FilterOptions, Start};
use locsim_world::raycast::{DistanceGrid, ExactRangeMap, RangeTable};
use rayon::ThreadPoolBuilder;

pub use figures::{BenchReport, Both, Row, terminal_text};
pub use sweeps::{SweepReport, sweep};
pub use workload::{BeamParameters, Workload};

use crate::BenchError;
use figures::{CastTimes, Conditions, PlainLoop, Timings, UpdateTimes};
use locsim_core::Progress;
use locsim_lab::run::MapSet;
use locsim_scenario::ModelName;
use locsim_sensor::ModelKind;
use replay::{
    GLOBAL_PARTICLES, ReplayErrors, SEEDS, TRACKING_PARTICLES, filter_options, known_start, replays,
};
use table::BenchModel;
use timing::{Timing, time};
use world::{MODELS, TRAINING_WORLD, train_models};

/// The model of the unknown start, of the sweeps, and of the comparison of table and exact casts.
const MAIN_MODEL: ModelName = ModelName::Fitted(ModelKind::NpRegRegistered);

/// Cell \[m\] and saturation \[m\] of the distance grid behind the likelihood field.
const DISTANCE_GRID_M: (f64, f64) = (0.05, 2.0);

/// A workload with everything that is measured on it.
pub struct Workbench {
    workload: Workload,
    maps: MapSet,
    table: table::Table,
    models: Vec<BenchModel>,
}

impl Workbench {
    /// Reads the workload, builds the table, and trains the models in a simulation of the workload's world.
    ///
    /// # Errors
    /// [`BenchError`] for files that are refused.
    pub fn prepare(folder: &Path, clock: Clock<'_>, progress: &dyn Progress) -> Result<Self, BenchError> {
        let workload = Workload::read(folder)?;
        let distance = DistanceGrid::new(&workload.geometry, DISTANCE_GRID_M.0, DISTANCE_GRID_M.1)?;
        let exact = Arc::new(ExactRangeMap::new(workload.geometry.clone()));
        let table = table::build(&exact, clock, progress)?;
        let maps =
            MapSet { exact, ranges: Arc::<RangeTable>::clone(&table.map), distance: Arc::new(distance) };
        let models = train_models(&workload, &maps, &TRAINING_WORLD, progress)?
            .into_iter()
            .map(|model| BenchModel::new(model, &workload.laser, &maps.endpoints()))
            .collect::<Result<_, _>>()?;
        Ok(Self { workload, maps, table, models })
    }

    fn main_model(&self) -> &BenchModel {
        let main = self.models.iter().find(|model| model.label == MAIN_MODEL.as_str());
        main.expect("the main model is one of them")
    }

    /// Measures everything.
    ///
    /// # Errors
    /// [`BenchError`] when a filter gives up or threads can't be started.
    pub fn run(&self, clock: Clock<'_>, progress: &dyn Progress) -> Result<BenchReport, BenchError> {
        let (median, fastest) = self.timings(clock, progress)?;
        let replay_ate_m = Both {
            in_static: self.errors(&self.workload.static_world, progress)?,
            in_dynamic: self.errors(&self.workload.dynamic_world, progress)?,
        };
        let global_localized = Both {
            in_static: self.localized(&self.workload.static_world, progress)?,
            in_dynamic: self.localized(&self.workload.dynamic_world, progress)?,
        };
        progress.stage("table against exact casts", 1);
        let main = self.main_model();
        let (exact, table) = (&*self.maps.exact, &*self.table.map);
        let prepared = &*main.prepared;
        let accuracy = accuracy::compare(&self.workload, exact, &*main.exact, table, prepared)?;
        progress.advance(1);
        progress.stage("memory of ten million particles", 1);
        let bytes_per_million_particles =
            measure::bytes_per_million_particles(&self.workload, table, prepared)?;
        progress.advance(1);
        progress.finish();
        let mut report = BenchReport {
            conditions: Conditions {
                version: env!("CARGO_PKG_VERSION"),
                timing: "median of at least 7 repeats and 0.15 s after one to warm up; one thread unless it says two",
                update: [self.workload.particles.len(), self.workload.laser.beam_count()],
                replay_particles: TRACKING_PARTICLES,
                global_particles: GLOBAL_PARTICLES,
                seeds: SEEDS,
                localized: "last position within 0.5 m and last heading within 20 degrees of the truth",
                model: MAIN_MODEL.as_str(),
                training: TRAINING_WORLD,
            },
            median,
            fastest,
            table_build_s: self.table.seconds,
            table_bytes: self.table.map.bytes(),
            replay_ate_m,
            global_localized,
            accuracy,
            bytes_per_million_particles,
            rows: Vec::new(),
        };
        report.rows = figures::rows(&report);
        Ok(report)
    }

    /// Medians and fastest times.
    fn timings(&self, clock: Clock<'_>, progress: &dyn Progress) -> Result<(Timings, Timings), BenchError> {
        let one = ThreadPoolBuilder::new().num_threads(1).build()?;
        let two = ThreadPoolBuilder::new().num_threads(2).build()?;
        let workload = &self.workload;
        let (exact, table): (&dyn RangeMap, &dyn RangeMap) = (&*self.maps.exact, &*self.table.map);
        let (mut median, mut fastest) = (Timings::default(), Timings::default());
        progress.stage("timing updates", MODELS.len() as u64);
        for model in &self.models {
            let prepared = &*model.prepared;
            let exact = one.install(|| measure::update(clock, workload, exact, &*model.exact))?;
            let single = one.install(|| measure::update(clock, workload, table, prepared))?;
            let double = two.install(|| measure::update(clock, workload, table, prepared))?;
            let step = one.install(|| measure::whole_step(clock, workload, table, prepared))?;
            for (timings, of) in each(&mut median, &mut fastest) {
                let update =
                    UpdateTimes { exact: of(&exact), table: of(&single), table_2_threads: of(&double) };
                timings.update_ns_per_particle_beam.insert(model.label.clone(), update);
                timings.step_ms_by_model.insert(model.label.clone(), of(&step) * 1e-6);
                timings.step_ms = timings.step_ms.max(of(&step) * 1e-6);
            }
            progress.advance(1);
        }
        progress.stage("timing the rest", 1);
        let casts = one.install(|| [exact, table].map(|map| measure::raycast(clock, workload, map)));
        let predict = one.install(|| measure::predict(clock, workload))?;
        let resample_10k = one.install(|| measure::resample(clock, workload, 10_000));
        let resample_1m = one.install(|| measure::resample(clock, workload, 1_000_000));
        let estimate = one.install(|| measure::estimate(clock, workload));
        let beams = workload.particles.len() * workload.laser.beam_count();
        let mut log_likelihoods = Vec::new();
        let plain = time(clock, beams, || plain::log_likelihoods(workload, &mut log_likelihoods));
        let plain_cast = time(clock, beams, || {
            black_box(plain::mean_range(black_box(workload)));
        });
        progress.advance(1);
        for (timings, of) in each(&mut median, &mut fastest) {
            timings.raycast_ns = Some(CastTimes { exact: of(&casts[0]), table: of(&casts[1]) });
            timings.predict_ns = of(&predict);
            timings.resample_ns_10k = of(&resample_10k);
            timings.resample_ns_1m = of(&resample_1m);
            timings.estimate_ns = of(&estimate);
            timings.plain_loop =
                PlainLoop { update_ns_per_particle_beam: of(&plain), raycast_ns: of(&plain_cast) };
        }
        Ok((median, fastest))
    }

    /// Errors of every model on a drive with a known start.
    fn errors(
        &self,
        drive: &Drive,
        progress: &dyn Progress,
    ) -> Result<BTreeMap<String, ReplayErrors>, BenchError> {
        progress.stage("replays", self.models.len() as u64);
        let options = filter_options(self.workload.alpha, TRACKING_PARTICLES)?;
        let start = known_start(drive);
        self.models
            .iter()
            .map(|model| {
                let replays = replays(drive, &options, &start, &*self.table.map, &*model.prepared, SEEDS)?;
                progress.advance(1);
                Ok((model.label.clone(), ReplayErrors::of(&replays)))
            })
            .collect()
    }

    /// How many seeds localize from an unknown start.
    fn localized(&self, drive: &Drive, progress: &dyn Progress) -> Result<usize, BenchError> {
        progress.stage("unknown start", 1);
        let options = FilterOptions {
            annealing: Some(AnnealingOptions::default()),
            ..filter_options(self.workload.alpha, GLOBAL_PARTICLES)?
        };
        let model = &*self.main_model().prepared;
        let replays = replays(drive, &options, &Start::Global, &*self.table.map, model, SEEDS)?;
        progress.advance(1);
        Ok(ReplayErrors::of(&replays).localized)
    }
}

type Of = fn(&Timing) -> f64;

/// Both sets of figures, with what they take of a timing.
fn each<'a>(median: &'a mut Timings, fastest: &'a mut Timings) -> [(&'a mut Timings, Of); 2] {
    [(median, |timing| timing.median_ns), (fastest, |timing| timing.fastest_ns)]
}
