//! Covariates of a beam: the levels that curves are over.

use std::collections::HashMap;
use std::f64::consts::FRAC_PI_2;

use distreg::explained::{are_all_alike, explained_share};
use locsim_comparison::jumps;
use locsim_core::{cell_at, even_edges, inner_quantile_edges};

use crate::statistics::Covariate;
use locsim_comparison::Comparison;

/// The covariates of a log's beams. They depend on poses and map, and never on readings.
pub(crate) struct Covariates {
    pub axes: Vec<Axis>,
}

/// One covariate in levels.
pub(crate) struct Axis {
    pub covariate: Covariate,
    /// Middle of each level, SI units; for places the index of the cell.
    pub levels: Vec<f64>,
    /// Whether neighbouring levels are alike.
    pub is_ordered: bool,
    /// Level of each beam; empty where it depends on the readings.
    pub of_beams: Vec<u16>,
    /// Lower corner and side of each cell of places \[m\].
    pub cells: Vec<[f64; 3]>,
    edges: Vec<f64>,
}

/// Numbers of levels: incidence in steps of 5 degrees, bearing in steps of 5 degrees of a full circle.
const INCIDENCES: usize = 18;
const BEARINGS: usize = 72;
const RANGES: usize = 24;
/// Shares of the beams in finer levels at both ends of the ranges: what happens to the nearest or farthest readings alone would
/// be thinned out in a level of even width.
const ENDS: [f64; 4] = [0.0025, 0.005, 0.01, 0.02];
const SPEEDS: usize = 8;
/// A robot that is slower doesn't reverse \[m/s\].
const STANDS_M_S: f64 = 1e-3;
const TURN_RATES: usize = 12;
/// A level of time is of no fewer scans than half a fold, so that a fold that is held out isn't a level's only one; and there are
/// no more levels than this.
const TIMES: usize = 120;
const SCANS_PER_TIME: usize = 5;
/// Edges of the levels of a jump \[m\]: none, as of clutter, of doors, of rooms.
const JUMPS: [f64; 4] = [0.15, 0.4, 0.8, 1.6];
/// Edges of the levels of a neighbour's error (standard deviations).
const NEIGHBOURS: [f64; 8] = [-2.0, -1.2, -0.7, -0.25, 0.25, 0.7, 1.2, 2.0];
/// Edges of the levels of the variance of a scan's other errors (1).
const SCANS: [f64; 10] = [0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.2, 3.0, 4.5, 7.0];
/// Edges of the levels of the share of a scan's other beams without return, beyond the simulated share (1).
const LOSSES: [f64; 9] = [-0.03, 0.02, 0.05, 0.08, 0.12, 0.16, 0.22, 0.3, 0.5];
/// Side of the cells of places \[m\], doubled until there are no more than these.
const PLACE_M: f64 = 0.5;
const MOST_PLACES: usize = 200;
/// Walls at round numbers aren't at the borders of cells \[m\].
const BORDER_M: f64 = 0.17;

/// Noise comes and goes with scans where that gains so many times what anything else does, and losses do: a scan's other beams tell those
/// of any cause, a little less well than the cause. Losses are seen for sure, noise isn't.
pub(super) const NOISE_OF_SCANS: f64 = 1.25;
pub(super) const LOSSES_OF_SCANS: f64 = 1.1;
impl Covariates {
    pub fn new(comparison: &Comparison<'_>) -> Self {
        let (nominal, recorded, views) = (comparison.nominal, &*comparison.recorded, &comparison.views);
        let (scans, per_scan, max) = (views.scans(), views.per_scan, nominal.laser.max_range_m);
        let secs = recorded.track.secs();
        let even = |lo: f64, hi: f64, levels: usize| even_edges(lo, hi, levels)[1..levels.max(1)].to_vec();
        let velocities = recorded.velocities();
        let speed = |v: &[f64; 3]| if v[0] < -STANDS_M_S { -v[0].hypot(v[1]) } else { v[0].hypot(v[1]) };
        let speeds: Vec<f64> = velocities.iter().map(speed).collect();
        let turn_rates: Vec<f64> = velocities.iter().map(|v| v[2]).collect();
        let bearings: Vec<f64> = recorded.laser.bearings().iter().map(|&b| f64::from(b)).collect();
        let jumps: Vec<f64> = (0..scans)
            .flat_map(|scan| jumps(nominal, recorded, scan))
            .map(|jump| jump.map_or(0.0, |[near, far]| far - near))
            .collect();
        let view = |i: usize| &views.beams[i].view;
        let of = |covariate, edges: Vec<f64>, value: &dyn Fn(usize) -> f64| {
            Axis::new(covariate, edges, (0..views.beams.len()).map(value))
        };
        let (first, last) = (bearings[0], bearings[bearings.len() - 1]);
        let times = (scans / SCANS_PER_TIME).clamp(1, TIMES);
        let ranges: Vec<f64> = (0..views.beams.len()).map(|i| view(i).range.min(max)).collect();
        Self {
            axes: vec![
                of(Covariate::Everywhere, Vec::new(), &|_| 0.0),
                of(Covariate::Range, inner_quantile_edges(&ranges, RANGES, &ENDS), &|i| ranges[i]),
                of(Covariate::Incidence, even(0.0, FRAC_PI_2, INCIDENCES), &|i| view(i).incidence),
                of(Covariate::Bearing, even(first, last, BEARINGS.min(bearings.len())), &|i| view(i).bearing),
                Axis::of_places(comparison, max),
                of(Covariate::Time, even(secs[0], secs[secs.len() - 1], times), &|i| secs[i / per_scan]),
                of(Covariate::Speed, inner_quantile_edges(&speeds, SPEEDS, &[]), &|i| speeds[i / per_scan]),
                of(Covariate::TurnRate, inner_quantile_edges(&turn_rates, TURN_RATES, &[]), &|i| {
                    turn_rates[i / per_scan]
                }),
                of(Covariate::Jump, JUMPS.to_vec(), &|i| jumps[i]),
                Axis::of_readings(Covariate::Neighbour, &NEIGHBOURS),
                Axis::of_readings(Covariate::Scan, &SCANS),
                Axis::of_readings(Covariate::Losses, &LOSSES),
            ],
        }
    }
}

impl Covariates {
    /// Share of the variance of some numbers of all beams that a covariate's levels explain. Numbers that are all alike are
    /// those of every beam, and of no other covariate.
    pub fn explained(&self, covariate: Covariate, values: impl Iterator<Item = f64>) -> f64 {
        let Some(axis) = self.axes.iter().find(|axis| axis.covariate == covariate) else { return 0.0 };
        let values: Vec<f64> = values.collect();
        let is_constant = are_all_alike(&values);
        if covariate == Covariate::Everywhere || is_constant {
            return f64::from(u8::from(is_constant && covariate == Covariate::Everywhere));
        }
        if axis.is_of_readings() { 0.0 } else { explained_share(&values, &axis.of_beams) }
    }
}

impl Axis {
    /// Levels of what other readings of the scan say, between inner edges; the last is of those that say nothing.
    fn of_readings(covariate: Covariate, edges: &[f64]) -> Self {
        let ends = [edges[0], edges[edges.len() - 1]];
        let middles = edges.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        let levels = std::iter::once(ends[0]).chain(middles).chain([ends[1], f64::NAN]);
        Self { levels: levels.collect(), ..Self::of_edges(covariate, edges.to_vec()) }
    }

    /// Whether its levels are of what other readings say.
    pub fn is_of_readings(&self) -> bool {
        self.of_beams.is_empty()
    }

    /// An axis with these inner edges, as yet without levels and beams.
    fn of_edges(covariate: Covariate, edges: Vec<f64>) -> Self {
        let (levels, of_beams, cells) = (Vec::new(), Vec::new(), Vec::new());
        Self { covariate, levels, is_ordered: true, of_beams, cells, edges }
    }

    /// Levels between inner edges.
    fn new(covariate: Covariate, edges: Vec<f64>, values: impl Iterator<Item = f64>) -> Self {
        let values: Vec<f64> = values.collect();
        let mut axis = Self::of_edges(covariate, edges);
        axis.of_beams = values.iter().map(|&value| axis.level_of(value)).collect();
        let count = axis.edges.len() + 1;
        let (mut sums, mut counts) = (vec![0.0; count], vec![0.0; count]);
        for (value, &level) in values.iter().zip(&axis.of_beams) {
            sums[level as usize] += value;
            counts[level as usize] += 1.0;
        }
        axis.levels = sums.iter().zip(&counts).map(|(sum, count)| sum / f64::max(*count, 1.0)).collect();
        axis
    }

    /// An axis of these levels, without beams.
    #[cfg(test)]
    pub fn of_levels(covariate: Covariate, levels: Vec<f64>) -> Self {
        Self { levels, ..Self::new(covariate, Vec::new(), std::iter::empty()) }
    }

    /// The level of a value; a value that isn't a number has the last one.
    pub fn level_of(&self, value: f64) -> u16 {
        if value.is_nan() {
            return self.edges.len() as u16 + 1;
        }
        self.edges.partition_point(|&edge| edge <= value) as u16
    }

    /// Cells of the map in which beams end; those that end nowhere are together.
    fn of_places(comparison: &Comparison<'_>, max: f64) -> Self {
        let beams = &comparison.views.beams;
        let mut side = PLACE_M;
        loop {
            let mut indices: HashMap<[i32; 2], u16> = HashMap::new();
            let mut cells = vec![[0.0; 3]];
            let of_beams: Vec<u16> = beams
                .iter()
                .map(|beam| {
                    if beam.view.range >= max {
                        return 0;
                    }
                    let cell = cell_at(beam.view.endpoint + BORDER_M, side);
                    *indices.entry(cell).or_insert_with(|| {
                        let [x, y] = cell.map(|c| f64::from(c) * side - BORDER_M);
                        cells.push([x, y, side]);
                        cells.len() as u16 - 1
                    })
                })
                .collect();
            if cells.len() <= MOST_PLACES {
                return Self {
                    covariate: Covariate::Place,
                    levels: (0..cells.len()).map(|i| i as f64).collect(),
                    is_ordered: false,
                    of_beams,
                    cells,
                    edges: Vec::new(),
                };
            }
            side *= 2.0;
        }
    }
}
