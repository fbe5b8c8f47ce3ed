//! Figures of a benchmark, each beside its target and the figures of other programs.

use std::collections::BTreeMap;

use serde::Serialize;

use super::accuracy::Accuracy;
use super::replay::ReplayErrors;
use super::world::TrainingWorld;
use locsim_report::TextTable;

/// Sensor updates of one model \[ns per particle and beam\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UpdateTimes {
    /// Exact casts and the model itself, one thread.
    pub exact: f64,
    /// The table and the model prepared for it, one thread.
    pub table: f64,
    /// The same on two threads.
    pub table_2_threads: f64,
}

/// Ray casts alone \[ns\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CastTimes {
    /// Exact.
    pub exact: f64,
    /// From the table.
    pub table: f64,
}

/// Every timed figure, once as median and once as fastest of its repeats.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Timings {
    /// By name of the model.
    pub update_ns_per_particle_beam: BTreeMap<String, UpdateTimes>,
    /// Ray casts alone \[ns\].
    pub raycast_ns: Option<CastTimes>,
    /// Odometry motion model \[ns per particle\].
    pub predict_ns: f64,
    /// Systematic resampling of 10,000 particles, poses gathered \[ns per particle\].
    pub resample_ns_10k: f64,
    /// The same of 1,000,000.
    pub resample_ns_1m: f64,
    /// Weighted mean and covariance \[ns per particle\].
    pub estimate_ns: f64,
    /// A whole step with the table, on one thread \[ms\]: the slowest of the models.
    pub step_ms: f64,
    /// By name of the model.
    pub step_ms_by_model: BTreeMap<String, f64>,
    /// The plain loop: textbook beam model over Bresenham's walk, one thread.
    pub plain_loop: PlainLoop,
}

/// The plain loop's times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PlainLoop {
    /// Of an update \[ns per particle and beam\].
    pub update_ns_per_particle_beam: f64,
    /// Of a ray cast \[ns\].
    pub raycast_ns: f64,
}

/// The same in the world as mapped and among unmapped objects.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Both<T> {
    /// `traj_static.csv`.
    #[serde(rename = "static")]
    pub in_static: T,
    /// `traj_dynamic.csv`.
    #[serde(rename = "dynamic")]
    pub in_dynamic: T,
}

/// How the figures came about.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Conditions {
    /// Version of the program.
    pub version: &'static str,
    /// The definition of a timing.
    pub timing: &'static str,
    /// Particles and beams of the timed update.
    pub update: [usize; 2],
    /// Particles of a replay with a known start.
    pub replay_particles: usize,
    /// Particles of a replay with an unknown start.
    pub global_particles: usize,
    /// Filter seeds of each replay.
    pub seeds: u64,
    /// When a replay counts as localized.
    pub localized: &'static str,
    /// The model of the unknown start, and of the comparison of table and exact casts.
    pub model: &'static str,
    /// The world that the models were trained in.
    pub training: TrainingWorld,
}

/// The content of `locsim-bench speed --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchReport {
    /// How the figures came about.
    pub conditions: Conditions,
    /// Medians.
    #[serde(flatten)]
    pub median: Timings,
    /// The fastest of each timing's repeats, which other work on the machine disturbs least.
    pub fastest: Timings,
    /// Time to build the table on all threads \[s\].
    pub table_build_s: f64,
    /// Its size \[bytes\].
    pub table_bytes: usize,
    /// Errors of the replays with a known start.
    pub replay_ate_m: Both<BTreeMap<String, ReplayErrors>>,
    /// How many of the seeds localized from an unknown start.
    pub global_localized: Both<usize>,
    /// Differences between the table and exact casts.
    pub accuracy: Accuracy,
    /// Memory that a filter of a million particles adds \[bytes\], where the system tells.
    pub bytes_per_million_particles: Option<f64>,
    /// The figures that have a target.
    pub rows: Vec<Row>,
}

/// One figure beside its target.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Its name.
    pub figure: String,
    /// Its unit.
    pub unit: &'static str,
    /// Measured; `None` where it couldn't be.
    pub value: Option<f64>,
    /// The bound.
    pub target: f64,
    /// Whether the bound is an upper one.
    pub at_most: bool,
    /// Whether it is kept; `None` without a value.
    pub met: Option<bool>,
    /// The figures of other programs.
    pub others: &'static str,
}

impl Row {
    fn at_most(
        figure: impl Into<String>,
        unit: &'static str,
        value: Option<f64>,
        target: f64,
        others: &'static str,
    ) -> Self {
        let met = value.map(|value| value <= target);
        Self { figure: figure.into(), unit, value, target, at_most: true, met, others }
    }

    fn at_least(
        figure: impl Into<String>,
        unit: &'static str,
        value: f64,
        target: f64,
        others: &'static str,
    ) -> Self {
        let met = Some(value >= target);
        Self { figure: figure.into(), unit, value: Some(value), target, at_most: false, met, others }
    }
}

/// The source of other programs' figures, which [`rows`] quotes.
pub const OTHERS: &str = "Others: measured elsewhere on the same files, one thread, portable build / build for the \
                          host's processor, each at its best setting.";

/// The figures that have a target, medians of `timings`.
pub fn rows(report: &BenchReport) -> Vec<Row> {
    let timings = &report.median;
    let mut rows = Vec::new();
    for (model, update) in &timings.update_ns_per_particle_beam {
        let field = model == "likelihood_field";
        let (table, two, exact) = if field {
            ("Beluga 6.6 / 3.9, MRPT 25, nav2 37 / 33", "Beluga 4.3 / 2.0", "")
        } else {
            ("range_libc's table 16 / 11", "", "beam models: MRPT 179, nav2 191 / 172, Beluga 296 / 314")
        };
        let unit = "ns per particle and beam";
        rows.push(Row::at_most(format!("update, {model}, table"), unit, Some(update.table), 4.0, table));
        let figure = format!("update, {model}, table, 2 threads");
        rows.push(Row::at_most(figure, unit, Some(update.table_2_threads), 2.2, two));
        rows.push(Row::at_most(format!("update, {model}, exact"), unit, Some(update.exact), 180.0, exact));
    }
    let particle = "ns per particle";
    let step = "Beluga field 7.7, range_libc's table 9.3, MRPT 23, nav2 49";
    let scale = |value: Option<f64>, by: f64| value.map(|value| value / by);
    rows.push(Row::at_most("predict", particle, Some(timings.predict_ns), 25.0, "Beluga 209, nav2 237"));
    rows.push(Row::at_most(
        "resample 10k",
        particle,
        Some(timings.resample_ns_10k),
        10.0,
        "MRPT 42, Beluga 64, nav2 3578",
    ));
    rows.push(Row::at_most(
        "resample 1M",
        particle,
        Some(timings.resample_ns_1m),
        10.0,
        "MRPT 51, Beluga 233",
    ));
    rows.push(Row::at_most("estimate", particle, Some(timings.estimate_ns), 3.0, ""));
    rows.push(Row::at_most("whole step, slowest model", "ms", Some(timings.step_ms), 3.0, step));
    let build = "range_libc's table 0.9 s, 38 MB";
    rows.push(Row::at_most("table build, all threads", "s", Some(report.table_build_s), 1.0, build));
    let memory = scale(report.bytes_per_million_particles, 1e6);
    rows.push(Row::at_most("memory per million particles", "MB", memory, 100.0, ""));
    let best = |errors: &BTreeMap<String, ReplayErrors>| {
        errors.values().map(|errors| errors.median).min_by(f64::total_cmp)
    };
    let errors = &report.replay_ate_m;
    let others_static = "range_libc's table and MRPT 0.024, Beluga 0.035, nav2 0.052";
    let others_dynamic = "range_libc's table and MRPT 0.029, Beluga 0.050, nav2 0.059";
    for (figure, value, target, others) in [
        ("replay error, static, best model (aim)", best(&errors.in_static), 0.010, others_static),
        ("replay error, static, best model (bound)", best(&errors.in_static), 0.020, others_static),
        ("replay error, dynamic, best model (aim)", best(&errors.in_dynamic), 0.014, others_dynamic),
        ("replay error, dynamic, best model (bound)", best(&errors.in_dynamic), 0.025, others_dynamic),
    ] {
        rows.push(Row::at_most(figure, "m", value, target, others));
    }
    let global = &report.global_localized;
    rows.push(Row::at_least("unknown start, static", "of 10", global.in_static as f64, 10.0, "best 8 of 10"));
    rows.push(Row::at_least(
        "unknown start, dynamic",
        "of 10",
        global.in_dynamic as f64,
        9.0,
        "best 6 of 10",
    ));
    rows
}

/// For a terminal.
pub fn terminal_text(report: &BenchReport) -> String {
    let header = ["figure", "unit", "here", "target", "met", "others"];
    let digits = |value: f64| if value < 0.1 { format!("{value:.4}") } else { format!("{value:.2}") };
    let table = TextTable::new(
        header,
        report.rows.iter().map(|row| {
            [
                row.figure.clone(),
                row.unit.to_owned(),
                row.value.map_or("-".to_owned(), digits),
                format!("{} {}", if row.at_most { "<=" } else { ">=" }, row.target),
                row.met.map_or("-", |met| if met { "yes" } else { "no" }).to_owned(),
                row.others.to_owned(),
            ]
        }),
    );
    let plain = &report.median.plain_loop;
    let replays = TextTable::new(
        ["replay error, 500 particles [m]", "static", "static max", "dynamic", "dynamic max"],
        report.replay_ate_m.in_static.iter().map(|(model, errors)| {
            let dynamic = report.replay_ate_m.in_dynamic.get(model).unwrap_or(errors);
            let [a, b, c, d] = [errors.median, errors.max, dynamic.median, dynamic.max].map(digits);
            [model.clone(), a, b, c, d]
        }),
    );
    let accuracy = &report.accuracy;
    format!(
        "{}\n{OTHERS}\n\n{}\nTable against exact casts: range {:.4} m on average, {:.4} m at most in 99 %, log \
         likelihood {:.3} nats at most in 99 %, replay error {:.4} m on average.\nThe plain loop needs {:.0} ns per \
         particle and beam, {:.0} ns of them for the cast.\nTimings: {}.\n",
        table.to_terminal(None),
        replays.to_terminal(None),
        accuracy.range_m.mean,
        accuracy.range_m.p99,
        accuracy.log_likelihood.p99,
        accuracy.ate_m.mean,
        plain.update_ns_per_particle_beam,
        plain.raycast_ns,
        report.conditions.timing,
    )
}
