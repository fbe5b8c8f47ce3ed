//! The omnibus search: the PIT of readings over bins of covariates of their beams.

use locsim_core::{even_edges, quantile_edges};
use std::f64::consts::FRAC_PI_2;

use super::readings::Reading;
use super::survey::Survey;
use super::{Cell, Covariate, Deviation, Family, Form, Halves, Readings, Statistic};

/// The deviations that every bin has a cell for, in the order of their statistics.
const DEVIATIONS: [Deviation; 5] =
    [Deviation::Mean, Deviation::Spread, Deviation::Short, Deviation::NoReturn, Deviation::Long];

/// The cells of all covariates.
pub(super) struct Bins {
    axes: Vec<Axis>,
}

/// The bins of a covariate.
struct Axis {
    covariate: Covariate,
    bins: Vec<Bin>,
    /// Index of each beam's bin; `None` of a beam that is in none.
    of_beams: Vec<Option<u32>>,
}

struct Bin {
    lo: f64,
    hi: f64,
    /// Lower corner of a bin that is a square of the map \[m\].
    place: Option<[f64; 2]>,
}

impl Bins {
    pub fn new(survey: &Survey<'_>) -> Self {
        let (views, secs) = (&survey.comparison.views, survey.comparison.recorded.track.secs());
        let bearings = survey.bearings();
        let (first, last) = (bearings[0], bearings[bearings.len() - 1] + MARGIN);
        let speeds: Vec<f64> = survey.velocities.iter().map(|v| v[0].hypot(v[1])).collect();
        let turn_rates: Vec<f64> = survey.velocities.iter().map(|v| v[2]).collect();
        let view = |i: usize| &views.beams[i].view;
        let axis = |covariate, edges: &[f64], value: &dyn Fn(usize) -> f64| {
            Axis::new(covariate, edges, (0..survey.beams()).map(value))
        };
        let turn_rate = |i: usize| turn_rates[survey.scan(i)];
        Self {
            axes: vec![
                axis(Covariate::Range, &even_edges(0.0, survey.max_range, 12), &|i| view(i).range),
                axis(Covariate::Incidence, &even_edges(0.0, FRAC_PI_2, 9), &|i| view(i).incidence),
                axis(Covariate::Bearing, &even_edges(first, last, 24), &|i| view(i).bearing),
                Axis::of_places(survey),
                axis(Covariate::Time, &even_edges(0.0, secs[secs.len() - 1] + MARGIN, 20), &|i| {
                    secs[survey.scan(i)]
                }),
                axis(Covariate::Speed, &quantile_edges(&speeds, 5), &|i| speeds[survey.scan(i)]),
                axis(Covariate::TurnRate, &quantile_edges(&turn_rates, 7), &turn_rate),
                // No jump, jumps as of clutter, of doors, of rooms.
                axis(Covariate::Jump, &[0.0, 0.3, 0.6, 1.5, survey.max_range], &|i| {
                    survey.jumps()[i].map_or(0.0, |[near, far]| far - near)
                }),
                axis(Covariate::BearingByTurnRate, &even_edges(first, last, 8), &|i| view(i).bearing)
                    .crossed_with(&axis(Covariate::TurnRate, &quantile_edges(&turn_rates, 4), &turn_rate)),
            ],
        }
    }

    /// The axes, each with the index of its first statistic.
    fn axes(&self) -> impl Iterator<Item = (usize, &Axis)> {
        self.axes.iter().scan(0, |next, axis| {
            let first = *next;
            *next += axis.bins.len() * DEVIATIONS.len();
            Some((first, axis))
        })
    }
}

/// Added to the last edge, so that the largest value lies below it.
const MARGIN: f64 = 1e-6;

impl Axis {
    /// Bins between edges. Values beyond the edges are in the first or the last bin.
    fn new(covariate: Covariate, edges: &[f64], values: impl Iterator<Item = f64>) -> Self {
        let bin = |value: f64| edges.partition_point(|&edge| edge <= value).clamp(1, edges.len() - 1) - 1;
        Self {
            covariate,
            bins: edges.windows(2).map(|pair| Bin { lo: pair[0], hi: pair[1], place: None }).collect(),
            of_beams: values.map(|value| Some(bin(value) as u32)).collect(),
        }
    }

    /// The cells of the map in which beams end.
    fn of_places(survey: &Survey<'_>) -> Self {
        let walls = survey.walls();
        let bin = |i: usize| Bin { lo: i as f64, hi: i as f64 + 1.0, place: Some(walls.corner(i)) };
        Self {
            covariate: Covariate::Place,
            bins: (0..walls.len()).map(bin).collect(),
            of_beams: (0..survey.beams()).map(|i| walls.of_beam(i).map(|cell| cell as u32)).collect(),
        }
    }

    /// Each bin cut by those of another axis. Bins keep their own limits.
    fn crossed_with(self, other: &Self) -> Self {
        let count = other.bins.len();
        let of_beams = self.of_beams.iter().zip(&other.of_beams);
        Self {
            covariate: self.covariate,
            of_beams: of_beams.map(|(a, b)| Some((*a)? * count as u32 + (*b)?)).collect(),
            bins: self
                .bins
                .iter()
                .flat_map(|bin| (0..count).map(|_| Bin { lo: bin.lo, hi: bin.hi, place: bin.place }))
                .collect(),
        }
    }
}

/// The summands of a reading in the cells of its bins, in the order of [`DEVIATIONS`].
fn summands(reading: &Reading<'_>, max: f64) -> [f64; DEVIATIONS.len()] {
    let of = |is: bool| f64::from(u8::from(is));
    let centered = reading.pit - 0.5;
    // A uniform number has the variance 1/12.
    let spread = centered.powi(2) - 1.0 / 12.0;
    let is_missing = !reading.is_return && reading.beam.range() < max;
    [centered, spread, reading.terms.short, of(is_missing), of(reading.is_behind)]
}

impl Family for Bins {
    fn statistics(&self) -> Vec<Statistic> {
        let statistic = |covariate, bin: &Bin, deviation| {
            let form = match deviation {
                Deviation::Short | Deviation::NoReturn | Deviation::Long => Form::Count,
                _ => Form::Other,
            };
            let Bin { lo, hi, place } = *bin;
            Statistic::of_cell(Cell { covariate, lo, hi, place, deviation }, form)
        };
        let of_axis = |axis: &'_ Axis| -> Vec<Statistic> {
            let of_bin = |bin| DEVIATIONS.map(|deviation| statistic(axis.covariate, bin, deviation));
            axis.bins.iter().flat_map(of_bin).collect()
        };
        self.axes.iter().flat_map(of_axis).collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let max = log.max_range();
        let mut sums = vec![[0.0; 2]; self.axes.iter().map(|axis| DEVIATIONS.len() * axis.bins.len()).sum()];
        for reading in &log.all {
            let summands = summands(reading, max);
            for (first, axis) in self.axes() {
                if let Some(bin) = axis.of_beams[reading.index] {
                    let of_bin = &mut sums[first + bin as usize * DEVIATIONS.len()..][..DEVIATIONS.len()];
                    for (sum, summand) in of_bin.iter_mut().zip(summands) {
                        sum[reading.half] += summand;
                    }
                }
            }
        }
        sums
    }

    fn includes(&self, statistic: usize, beam: usize) -> bool {
        self.axes().any(|(first, axis)| {
            let of_beam = axis.of_beams[beam].map(|bin| first + bin as usize * DEVIATIONS.len());
            of_beam.is_some_and(|first| (first..first + DEVIATIONS.len()).contains(&statistic))
        })
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{DRIVE, NOMINAL};
    use locsim_comparison::{Comparison, Nuisances};

    use super::*;
    use crate::Recorded;
    use crate::statistics::pit_draw;

    /// The beams that a cell is said to include are those whose readings are in its sum.
    #[test]
    fn a_cell_includes_the_beams_that_it_counts() {
        let recorded = Recorded::new(&DRIVE, 60, 24, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let bins = Bins::new(&Survey::new(&comparison));
        let fitted = comparison.start(&Nuisances::default());
        let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
        for (i, (statistic, halves)) in bins.statistics().iter().zip(bins.measure(&log)).enumerate() {
            let deviation = statistic.cell().map(|cell| cell.deviation);
            let position = DEVIATIONS.iter().position(|other| Some(*other) == deviation).unwrap();
            let included = log.all.iter().filter(|reading| bins.includes(i, reading.index));
            let sum: f64 = included.map(|reading| summands(reading, log.max_range())[position]).sum();
            assert!((sum - halves[0] - halves[1]).abs() < 1e-9, "{:?}: {sum} {halves:?}", statistic.cell());
        }
    }
}
