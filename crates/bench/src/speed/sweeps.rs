//! Cost against the number of particles, of beams, of threads, and the size of the map.

use std::f64::consts::TAU;

use locsim_core::{Draw, Hits, Laser, Particles, Pose2, RangeMap, Scan, Stage};
use locsim_world::map::{Cell, OccupancyGrid};
use locsim_world::raycast::ExactRangeMap;
use plotters::prelude::PathElement;
use rand_distr::{Distribution, StandardNormal};
use rayon::ThreadPoolBuilder;
use serde::Serialize;

use super::{Workbench, Workload, measure, table};
use crate::BenchError;
use locsim_core::Clock;
use locsim_core::Progress;
use locsim_report::ReportError;
use locsim_report::figures::canvas::{Axis, DrawError, Mark, chart, figure, line, model_color};
use locsim_report::figures::{Figure, Rasterizer};
use locsim_report::store::{Folder, Store};

/// Particles of the first sweep.
const PARTICLES: [usize; 5] = [1_000, 10_000, 100_000, 1_000_000, 10_000_000];

/// Beams of the second, over the full circle.
const BEAMS: [usize; 6] = [15, 30, 60, 120, 360, 1080];

/// Sides of the maps of the third \[m\].
const MAPS_M: [[f64; 2]; 5] = [[20.0, 4.0], [50.0, 20.0], [50.0, 50.0], [100.0, 100.0], [200.0, 200.0]];

/// Cells of these maps \[m\].
const MAP_CELL_M: f64 = 0.05;

/// Cost at one point of a sweep; every timing is with the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Particles.
    pub particles: usize,
    /// Beams.
    pub beams: usize,
    /// Area of the map's bounds \[m^2\].
    pub map_m2: f64,
    /// Threads.
    pub threads: usize,
    /// A sensor update \[ns per particle and beam\].
    pub update_ns_per_particle_beam: f64,
    /// A whole step \[ms\].
    pub step_ms: f64,
    /// Building the table \[s\], where the sweep is over maps.
    pub table_build_s: Option<f64>,
    /// The table's size \[bytes\], where the sweep is over maps.
    pub table_bytes: Option<usize>,
    /// Side of its cells \[m\], larger than asked for where the table would not have fitted.
    pub table_cell_m: Option<f64>,
}

/// All sweeps.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SweepReport {
    /// Over the number of particles, on one and on two threads, in the workload's map.
    pub particles: Vec<Cost>,
    /// Over the number of beams.
    pub beams: Vec<Cost>,
    /// Over maps: rooms along corridors, drawn by rule.
    pub maps: Vec<Cost>,
}

/// Runs every sweep and leaves `sweeps.json` and the figures (`.svg`, `.png`) in the results folder of `store`.
///
/// # Errors
/// [`BenchError`] when a filter gives up or a file can't be written.
pub fn sweep(
    bench: &Workbench,
    store: Store,
    clock: Clock<'_>,
    progress: &dyn Progress,
) -> Result<SweepReport, BenchError> {
    let mut report = SweepReport::default();
    let workload = &bench.workload;
    let beams = workload.laser.beam_count();
    progress.stage("sweep over particles", 2 * PARTICLES.len() as u64);
    for threads in [1, 2] {
        for particles in PARTICLES {
            let seen = seen_from(workload, &bench.maps.exact, workload.truth, beams, particles)?;
            report.particles.push(cost(bench, &seen, &*bench.table.map, threads, clock)?);
            progress.advance(1);
        }
    }
    progress.stage("sweep over beams", BEAMS.len() as u64);
    for beams in BEAMS {
        let seen = seen_from(workload, &bench.maps.exact, workload.truth, beams, 10_000)?;
        report.beams.push(cost(bench, &seen, &*bench.table.map, 1, clock)?);
        progress.advance(1);
    }
    progress.stage("sweep over maps", MAPS_M.len() as u64);
    for sides in MAPS_M {
        let exact = ExactRangeMap::new(office(sides)?.to_geometry()?);
        let table = table::build(&exact, clock, &())?;
        let truth = Pose2::new(0.5 * sides[0], 0.5 * CORRIDOR_M, 0.35);
        let seen = seen_from(workload, &exact, truth, beams, 10_000)?;
        let cost = cost(bench, &seen, &*table.map, 1, clock)?;
        report.maps.push(Cost {
            table_build_s: Some(table.seconds),
            table_bytes: Some(table.map.bytes()),
            table_cell_m: Some(table.map.cell_m()),
            ..cost
        });
        progress.advance(1);
    }
    progress.finish();
    write(&report, store.folder())?;
    store.finish()?;
    Ok(report)
}

/// The workload as seen from `truth` in some map, with other numbers of beams and particles, without noise.
fn seen_from(
    workload: &Workload,
    exact: &ExactRangeMap,
    truth: Pose2,
    beams: usize,
    particles: usize,
) -> Result<Workload, BenchError> {
    let bearings: Vec<f32> = (0..beams).map(|i| (i as f64 * TAU / beams as f64) as f32).collect();
    let old = &workload.laser;
    let laser =
        Laser::new(bearings, vec![0.0; beams], old.min_range(), old.max_range(), old.base_from_laser())
            .map_err(|error| BenchError::Laser(error.to_string()))?;
    let pose: Particles = [truth.compose(&laser.base_from_laser())].into_iter().collect();
    let mut hits = Hits::default();
    exact.cast(pose.as_poses(), laser.bearings(), laser.max_range(), &mut hits);
    let draw = Draw::new(1, Stage::Initial, 0);
    let (sigma_m, sigma_rad) = workload.spread;
    let around = |i: usize| {
        let mut rng = draw.item(i as u32);
        let [x, y, theta]: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
        Pose2::new(truth.x + sigma_m * x, truth.y + sigma_m * y, truth.theta + sigma_rad * theta)
    };
    Ok(Workload {
        geometry: exact.geometry().clone(),
        scan: Scan { ranges: hits.range },
        particles: (0..particles).map(around).collect(),
        laser,
        truth,
        ..workload.clone()
    })
}

fn cost(
    bench: &Workbench,
    seen: &Workload,
    map: &dyn RangeMap,
    threads: usize,
    clock: Clock<'_>,
) -> Result<Cost, BenchError> {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build()?;
    let model = &*bench.main_model().prepared;
    let update = pool.install(|| measure::update(clock, seen, map, model))?;
    let step = pool.install(|| measure::whole_step(clock, seen, map, model))?;
    let [x0, y0, x1, y1] = map.bounds();
    Ok(Cost {
        particles: seen.particles.len(),
        beams: seen.laser.beam_count(),
        map_m2: (x1 - x0) * (y1 - y0),
        threads,
        update_ns_per_particle_beam: update.median_ns,
        step_ms: step.median_ns * 1e-6,
        ..Cost::default()
    })
}

/// Width of a corridor \[m\].
const CORRIDOR_M: f64 = 2.0;

/// Rooms of 5 m x 6 m in rows along corridors of 2 m, doors of 1 m in the wall to the corridor, a pillar in each room;
/// walls of 0.1 m.
fn office([width_m, height_m]: [f64; 2]) -> Result<OccupancyGrid, BenchError> {
    /// Depth and width of a room \[m\].
    const ROOM_M: [f64; 2] = [6.0, 5.0];
    const WALL_M: f64 = 0.1;
    let (columns, rows) = ((width_m / MAP_CELL_M).round() as usize, (height_m / MAP_CELL_M).round() as usize);
    let occupied = |column: usize, row: usize| {
        let (x, y) = ((column as f64 + 0.5) * MAP_CELL_M, (row as f64 + 0.5) * MAP_CELL_M);
        let edge = x < WALL_M || y < WALL_M || x > width_m - WALL_M || y > height_m - WALL_M;
        let along = x.rem_euclid(ROOM_M[1]);
        let across = y.rem_euclid(CORRIDOR_M + ROOM_M[0]);
        let front = (CORRIDOR_M..CORRIDOR_M + WALL_M).contains(&across) && !(2.0..3.0).contains(&along);
        let back = across > CORRIDOR_M + ROOM_M[0] - WALL_M;
        let side = across > CORRIDOR_M && along < WALL_M;
        let pillar = (along - 3.5).abs() < 0.2 && (across - CORRIDOR_M - 4.0).abs() < 0.2;
        edge || front || back || side || pillar
    };
    let cells: Vec<Cell> = (0..columns * rows)
        .map(|i| if occupied(i % columns, i / columns) { Cell::Occupied } else { Cell::Free })
        .collect();
    let occupancy = cells.iter().map(|cell| f32::from(u8::from(*cell == Cell::Occupied))).collect();
    Ok(OccupancyGrid::new(columns, rows, MAP_CELL_M, Pose2::IDENTITY, cells, occupancy)?)
}

fn write(report: &SweepReport, folder: &Folder) -> Result<(), BenchError> {
    let json = serde_json::to_string_pretty(report).map_err(ReportError::from)?;
    folder.write(
        "sweeps.json",
        (json
            + "
")
        .as_bytes(),
    )?;
    let figures =
        figures(report).map_err(|error| ReportError::Figure { name: "sweeps", reason: error.to_string() })?;
    let rasterizer = Rasterizer::new();
    for figure in &figures {
        folder.write(&format!("{}.svg", figure.name), figure.svg.as_bytes())?;
        folder.write(&format!("{}.png", figure.name), &rasterizer.png(figure)?)?;
    }
    Ok(())
}

type Curve = (String, Vec<(f64, f64)>);

fn figures(report: &SweepReport) -> Result<Vec<Figure>, DrawError> {
    let on_threads = |threads: usize, value: fn(&Cost) -> f64| -> Curve {
        let costs = report.particles.iter().filter(|cost| cost.threads == threads);
        let label = if threads == 1 { "one thread" } else { "two threads" };
        (label.to_owned(), costs.map(|cost| (cost.particles as f64, value(cost))).collect())
    };
    let update: fn(&Cost) -> f64 = |cost| cost.update_ns_per_particle_beam;
    let step: fn(&Cost) -> f64 = |cost| cost.step_ms;
    let over = |costs: &[Cost], x: fn(&Cost) -> f64, label: &str| -> Curve {
        (label.to_owned(), costs.iter().map(|cost| (x(cost), update(cost))).collect())
    };
    let beams = over(&report.beams, |cost| cost.beams as f64, "10,000 particles");
    let maps = over(&report.maps, |cost| cost.map_m2, "10,000 particles x 60 beams");
    let built: Curve = (
        "time to build the table on all threads".to_owned(),
        report.maps.iter().filter_map(|cost| Some((cost.map_m2, cost.table_build_s?))).collect(),
    );
    let cost = "ns per particle and beam";
    Ok(vec![
        plot(
            "update_particles",
            "Sensor update against particles",
            "particles",
            cost,
            &[on_threads(1, update), on_threads(2, update)],
        )?,
        plot(
            "step_particles",
            "Whole step against particles",
            "particles",
            "ms",
            &[on_threads(1, step), on_threads(2, step)],
        )?,
        plot("update_beams", "Sensor update against beams", "beams", cost, &[beams])?,
        plot("update_maps", "Sensor update against the size of the map", "area [m^2]", cost, &[maps])?,
        plot("table_maps", "The table against the size of the map", "area [m^2]", "s", &[built])?,
    ])
}

/// Curves on logarithmic axes.
fn plot(name: &'static str, title: &str, x: &str, y: &str, curves: &[Curve]) -> Result<Figure, DrawError> {
    let names: Vec<String> = curves.iter().map(|(label, _)| label.clone()).collect();
    let points = || curves.iter().flat_map(|(_, points)| points.iter().copied());
    let ends = |of: fn((f64, f64)) -> f64| {
        let (lo, hi) =
            points().map(of).fold((f64::INFINITY, 0.0_f64), |(lo, hi), value| (lo.min(value), hi.max(value)));
        (lo, hi)
    };
    let (x_ends, y_ends) = (ends(|point| point.0), ends(|point| point.1));
    let x = Axis::logarithmic(x, x_ends.0, x_ends.1);
    let y = Axis::logarithmic(y, 0.7 * y_ends.0, 1.4 * y_ends.1);
    let legend: Vec<(String, Mark)> =
        names.iter().map(|name| (name.clone(), Mark::Line(model_color(&names, name)))).collect();
    let svg = figure(title, &legend, 360.0, |area| {
        let mut chart = chart(area, &x, &y, 74.0)?;
        for (label, points) in curves {
            let style = line(model_color(&names, label), 2.0);
            chart.draw_series([PathElement::new(points.clone(), style)])?;
        }
        Ok(())
    })?;
    Ok(Figure { name, caption: title.to_owned(), svg })
}
