//! The paper's parametric regression: a Gaussian whose parameters are regressed on the state.

use std::collections::BTreeMap;

use distreg::{Degree, Kernel, LocalRegression, Weighting};
use locsim_core::{Beams, Draw, SensorModel};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::beam::{Beam, cdfs, log_densities, samples};
use crate::evaluate::{histogram_match, log_loss};
use crate::normal::RangeNormal;
use crate::state_grid::StateGrid;
use crate::{ModelKind, SensorError, TrainingSet};

/// Least readings in a group of states, so that their standard deviation can be estimated; and the greatest number of
/// groups, so that a regression over them stays fast.
const GROUP: usize = 20;
const MOST_GROUPS: usize = 2000;

/// Candidates for the bandwidths: over nominal range as shares of the maximum range, over incidence \[rad\].
const RANGE_SHARES: [f64; 5] = [0.02, 0.05, 0.1, 0.2, 0.4];
const INCIDENCES: [f64; 4] = [0.05, 0.1, 0.25, 0.6];

/// No deviation below this \[m\] is believed.
const LEAST_SIGMA: f64 = 1e-3;

/// A Gaussian's mean is at most this many deviations below 0. Further away so little of it is left above 0 (less than
/// 3e-5) that neither f32 can tell it nor a draw finds it.
const MOST_CUT: f32 = 4.0;

/// The prepared form of `p_reg`: for each cell of (r, alpha) a Gaussian around an offset from the beam's
/// exact nominal range (cut at 0, censored at the maximum range) and the probability of no return.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "Parts", into = "Parts")]
pub(crate) struct NormalTable(Parts);

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Parts {
    grid: StateGrid,
    cells: Vec<Cell>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Cell {
    /// Mean of z - r over readings below the maximum range \[m\].
    offset_m: f32,
    /// Their standard deviation \[m\].
    sigma_m: f32,
    /// Share of readings at the maximum range.
    no_return: f32,
}

impl From<NormalTable> for Parts {
    fn from(table: NormalTable) -> Self {
        table.0
    }
}

impl TryFrom<Parts> for NormalTable {
    type Error = String;

    fn try_from(parts: Parts) -> Result<Self, Self::Error> {
        parts.grid.holds(parts.cells.len(), 1)?;
        let sound = |c: &Cell| {
            c.offset_m.is_finite()
                && c.sigma_m >= LEAST_SIGMA as f32
                && c.sigma_m.is_finite()
                && (0.0..=1.0).contains(&c.no_return)
        };
        match parts.cells.iter().position(|cell| !sound(cell)) {
            Some(i) => Err(format!("the parameters of cell {i} are no distribution: {:?}", parts.cells[i])),
            None => Ok(Self(parts)),
        }
    }
}

impl NormalTable {
    /// Nominal range up to which there are cells \[m\].
    pub fn reach(&self) -> f32 {
        self.0.grid.reach
    }

    fn cell(&self, beam: &Beam) -> (RangeNormal, f32) {
        let cell = self.0.cells[self.0.grid.cell(beam)];
        let mean = (beam.range + cell.offset_m).max(-MOST_CUT * cell.sigma_m);
        (RangeNormal { mean, sigma: cell.sigma_m }, cell.no_return)
    }
}

impl SensorModel for NormalTable {
    fn name(&self) -> &str {
        ModelKind::PReg.as_str()
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        log_densities(z, beams, out, |z, beam| {
            let (normal, no_return) = self.cell(&beam);
            if z >= beam.max_range {
                return (no_return + (1.0 - no_return) * normal.at(beam.max_range)).ln();
            }
            normal.log_density(1.0 - no_return, z)
        });
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        cdfs(z, beams, out, |z, beam| {
            let (normal, no_return) = self.cell(&beam);
            (1.0 - no_return) * normal.cdf(z)
        });
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        samples(beams, draw, out, |beam, rng| {
            let (normal, no_return) = self.cell(&beam);
            if rng.random::<f32>() < no_return { beam.max_range } else { normal.sample(beam.max_range, rng) }
        });
    }
}

/// Fits `p_reg`: the paper's procedure 1 with a Gaussian (eq. 4, with the square root that its print lacks).
///
/// 1. Parameters at each state. A state needs readings enough for a deviation: while a set of states has two
///    groups' worth of readings (40, or a thousandth of all readings where that is more) it is halved at the
///    median of the coordinate in which it is wider, as in a k-d tree. With many readings at a state each
///    state is a group of its own; with one reading at a state about 20 to 40 neighbours are. In a group,
///    mean and deviation are those of z - r, so that its extent in r doesn't count as noise.
/// 2. Locally weighted linear regression of mean, deviation and share of no returns over (r, alpha), prepared
///    at the cells of a grid. Bandwidths: the least held-out risk (mean histogram match), the earlier of
///    equals.
///
/// Beams that meet nothing in the map have a Gaussian of their own.
pub(crate) fn fit(
    train: &TrainingSet,
    held_out: &TrainingSet,
) -> Result<(NormalTable, BTreeMap<String, f64>), SensorError> {
    let (open, mapped): (Vec<usize>, Vec<usize>) = (0..train.len()).partition(|&i| train.beam(i).is_open());
    let groups = Groups::of(train, mapped);
    if groups.normal_states.is_empty() {
        return Err(SensorError::TooFewData {
            model: ModelKind::PReg,
            what: "no two readings of a mapped surface",
        });
    }
    let open = open_cell(train, &open);
    let mut best: Option<(NormalTable, f64, f64, f64)> = None;
    for share in RANGE_SHARES {
        let range = share * f64::from(train.max_range());
        for incidence in INCIDENCES {
            let table = groups.regress(train.max_range(), [range, incidence], open)?;
            let risk = histogram_match(&table, held_out);
            if best.as_ref().is_none_or(|best| risk < best.3) {
                best = Some((table, range, incidence, risk));
            }
        }
    }
    let (table, range, incidence, risk) = best.expect("there are candidates");
    let chosen = [
        ("bandwidth_range_m", range),
        ("bandwidth_incidence_rad", incidence),
        ("held_out_histogram_match_m", risk),
        ("held_out_log_loss_nats", log_loss(&table, held_out)),
    ];
    Ok((table, chosen.map(|(name, value)| (name.to_owned(), value)).into()))
}

/// Parameters of groups of states, each at the group's mean state (r, alpha).
#[derive(Default)]
struct Groups {
    /// Groups with at least two readings below the maximum range: states, and (offset, deviation) of each.
    normal_states: Vec<f64>,
    normals: Vec<f64>,
    /// All groups: states, and share of no returns.
    states: Vec<f64>,
    no_returns: Vec<f64>,
    /// Least number of readings in a group.
    least_readings: usize,
    /// Half a reading of all those seen: no kind of reading is held rarer than that, least of all impossible.
    rarest: f64,
}

impl Groups {
    fn of(train: &TrainingSet, mut members: Vec<usize>) -> Self {
        let mut groups = Self {
            least_readings: GROUP.max(train.reading_count() / MOST_GROUPS),
            rarest: 0.5 / (train.reading_count() as f64 + 1.0),
            ..Self::default()
        };
        groups.split(train, &mut members);
        groups
    }

    fn split(&mut self, train: &TrainingSet, members: &mut [usize]) {
        let readings: usize = members.iter().map(|&i| train.observations(i).len()).sum();
        if members.len() < 2 || readings < 2 * self.least_readings {
            if !members.is_empty() {
                self.push(train, members);
            }
            return;
        }
        let scaled = |i: usize| {
            let state = train.state(i);
            [state.range / train.max_range(), state.incidence / std::f32::consts::FRAC_PI_2]
        };
        let extent = |axis: usize| {
            let values = || members.iter().map(|&i| scaled(i)[axis]);
            values().fold(0.0, f32::max) - values().fold(f32::INFINITY, f32::min)
        };
        let axis = usize::from(extent(1) > extent(0));
        let middle = members.len() / 2;
        members.select_nth_unstable_by(middle, |&a, &b| {
            scaled(a)[axis].total_cmp(&scaled(b)[axis]).then(a.cmp(&b))
        });
        let (low, high) = members.split_at_mut(middle);
        self.split(train, low);
        self.split(train, high);
    }

    fn push(&mut self, train: &TrainingSet, members: &[usize]) {
        let n = members.len() as f64;
        let mean = |f: &dyn Fn(usize) -> f32| members.iter().map(|&i| f64::from(f(i))).sum::<f64>() / n;
        let state = [mean(&|i| train.state(i).range), mean(&|i| train.state(i).incidence)];
        let (normal, no_return) = moments(train, members);
        self.states.extend(state);
        self.no_returns.push(no_return);
        if let Some((offset, sigma)) = normal {
            self.normal_states.extend(state);
            self.normals.extend([offset, sigma]);
        }
    }

    /// Regresses the parameters and prepares them on a grid.
    fn regress(&self, max_range: f32, bandwidths: [f64; 2], open: Cell) -> Result<NormalTable, SensorError> {
        let weighting = Weighting::kernel(Kernel::Gaussian, &bandwidths);
        let regression = |states: &[f64], targets: &[f64]| {
            LocalRegression::fit(states, targets, &weighting, Degree::Linear)
        };
        let normals = regression(&self.normal_states, &self.normals)?;
        let no_returns = regression(&self.states, &self.no_returns)?;
        let grid = StateGrid { reach: max_range, ranges: 60, incidences: 15 };
        // a plane may leave a parameter's domain; it is clamped to the values of the groups
        let seen = |parameter: usize| {
            let values = || self.normals.iter().skip(parameter).step_by(2).copied();
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
        };
        let (offsets, sigmas) = (seen(0), seen(1));
        let mut cells = (0..grid.mapped())
            .into_par_iter()
            .map(|cell| {
                let (r, alpha) = grid.centre(cell);
                let query = [f64::from(r), f64::from(alpha)];
                let (mut normal, mut no_return) = ([0.0; 2], [0.0]);
                normals.predict(&query, &mut normal)?;
                no_returns.predict(&query, &mut no_return)?;
                Ok(Cell {
                    offset_m: normal[0].clamp(offsets.0, offsets.1) as f32,
                    sigma_m: normal[1].clamp(sigmas.0, sigmas.1) as f32,
                    no_return: no_return[0].clamp(self.rarest, 1.0 - self.rarest) as f32,
                })
            })
            .collect::<Result<Vec<_>, SensorError>>()?;
        cells.push(open);
        Ok(NormalTable(Parts { grid, cells }))
    }
}

/// Mean and deviation of z - r over the readings below the maximum range (`None` if there are fewer than
/// two), and the share of the others.
fn moments(train: &TrainingSet, members: &[usize]) -> (Option<(f64, f64)>, f64) {
    let readings = || members.iter().flat_map(|&i| train.observations(i).iter().map(move |&z| (i, z)));
    let all = readings().count() as f64;
    let offsets = || {
        let below = readings().filter(|(_, z)| *z < train.max_range());
        below.map(|(i, z)| f64::from(z) - f64::from(train.state(i).range))
    };
    let n = offsets().count() as f64;
    let no_return = if all > 0.0 { 1.0 - n / all } else { 1.0 };
    if n < 2.0 {
        return (None, no_return);
    }
    let mean = offsets().sum::<f64>() / n;
    let variance = offsets().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (Some((mean, variance.sqrt().max(LEAST_SIGMA))), no_return)
}

/// The cell of open beams; without any reading below the maximum range, a Gaussian as wide as the range.
fn open_cell(train: &TrainingSet, open: &[usize]) -> Cell {
    let (normal, no_return) = moments(train, open);
    let max_range = f64::from(train.max_range());
    let (offset, sigma) = normal.unwrap_or((-0.5 * max_range, 0.5 * max_range));
    Cell { offset_m: offset as f32, sigma_m: sigma as f32, no_return: no_return as f32 }
}
