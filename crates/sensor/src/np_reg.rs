//! The paper's nonparametric regression of histograms, as published and registered to the nominal range.

use std::collections::BTreeMap;

use locsim_core::CAST_REACH;
use rayon::prelude::*;

use crate::axis::Axis;
use crate::binned::{Counts, published, registered};
use crate::error::NO_SURFACE;
use crate::evaluate::{histogram_match, log_loss};
use crate::histogram::{HistogramTable, Parts};
use crate::state_grid::StateGrid;
use crate::{ModelKind, SensorError, TrainingSet};

/// Candidates for the bandwidth of `np_reg` over nominal range, as shares of the maximum range: 1 cm to 45 cm
/// of 4.5 m.
const RANGE_SHARES: [f32; 6] = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1];
/// The same of `np_reg_registered`: 4.5 cm to 3.6 m.
const REGISTERED_RANGE_SHARES: [f32; 7] = [0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8];
/// Candidates for the bandwidth over incidence \[rad\].
const INCIDENCES: [f32; 5] = [0.03, 0.06, 0.12, 0.25, 0.5];
/// Candidates for the bandwidth over the observation in bins, and for the weight of the pooled histogram in
/// readings; the first of each is used while the bandwidths over the state are chosen.
const OBSERVATIONS: [f32; 4] = [1.0, 0.5, 2.0, 3.0];
const PSEUDO_COUNTS: [f32; 4] = [3.0, 1.0, 10.0, 30.0];

/// Weight of the pooled histogram for `np_reg`. The paper's method has none; without it there is no density where no
/// training state is near.
const FALLBACK: f32 = 1e-3;

/// Share of the wide distribution (half uniform, half at the maximum range) in the pooled histogram: no
/// reading is impossible.
const WIDE: f32 = 1e-3;

/// Candidates whose risk is within this share of the least count as equally good by risk.
const EQUAL_RISK: f64 = 0.01;

/// The parameters of the smoothing.
#[derive(Clone, Copy, Debug)]
struct Smoothing {
    range_m: f32,
    incidence_rad: f32,
    observation_bins: f32,
    pseudo_count: f32,
}

/// Fits `np_reg` or `np_reg_registered`.
///
/// `np_reg` is the paper's procedure 2 with histograms (eqs. 6 and 7): histograms of z in bins of 1 cm
/// (1/1000 of the maximum range where that is more), smoothed over (r, alpha) by a product of Gaussian
/// kernels. Each reading has the same weight; with M readings at every state that is eq. (7). Bandwidths:
/// least risk (mean histogram match, the paper's criterion) on the held-out states; of those within 1 % of
/// the least, the one with the least log loss.
///
/// `np_reg_registered` smooths histograms of z - r. The sensor's own noise then stays at 0 whatever the
/// bandwidth over r, so that it isn't blurred. Its bins are fine around 0 and coarse far away, smoothed by a
/// Gaussian that is constant in bins, hence wide where bins are; a cell with few readings around it leans on
/// the histogram of all. All constants minimize the held-out log loss: it is a strictly proper score, and the sum that a
/// filter uses. The risk isn't used, because it forgives a blurred peak. First the bandwidths over the state,
/// then over the observation, then the weight of the pooled histogram.
pub(crate) fn fit(
    kind: ModelKind,
    train: &TrainingSet,
    held_out: &TrainingSet,
) -> Result<(HistogramTable, BTreeMap<String, f64>), SensorError> {
    if !train.readings().any(|(z, beam)| z < beam.max_range && !beam.is_open()) {
        return Err(SensorError::TooFewData { model: kind, what: NO_SURFACE });
    }
    let search = Search::new(kind, train, held_out);
    let registered = kind == ModelKind::NpRegRegistered;
    let mut tried = search.states();
    if !registered {
        let least = tried.iter().map(|t| t.risk_m).fold(f64::INFINITY, f64::min);
        tried.retain(|t| t.risk_m <= least * (1.0 + EQUAL_RISK));
    }
    let mut best = least_log_loss(tried);
    if registered {
        let start = best.smoothing;
        let tried = OBSERVATIONS.map(|bins| search.score(Smoothing { observation_bins: bins, ..start }));
        best = least_log_loss(tried);
        let start = best.smoothing;
        let tried = PSEUDO_COUNTS.map(|readings| search.score(Smoothing { pseudo_count: readings, ..start }));
        best = least_log_loss(tried);
    }
    let Smoothing { range_m, incidence_rad, observation_bins, pseudo_count } = best.smoothing;
    let table = search.table(&search.smoothed(best.smoothing), pseudo_count);
    let mut chosen: BTreeMap<String, f64> = [
        ("bandwidth_range_m", range_m.into()),
        ("bandwidth_incidence_rad", incidence_rad.into()),
        ("held_out_log_loss_nats", best.log_loss_nats),
        ("held_out_histogram_match_m", histogram_match(&table, held_out)),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into();
    if registered {
        chosen.insert("bandwidth_observation_bins".to_owned(), observation_bins.into());
        chosen.insert("pseudo_count".to_owned(), pseudo_count.into());
    }
    Ok((table, chosen))
}

/// A candidate and its held-out scores.
struct Tried {
    smoothing: Smoothing,
    log_loss_nats: f64,
    /// Mean histogram match \[m\]; only `np_reg` asks for it, 0 otherwise.
    risk_m: f64,
}

/// The candidate with the least log loss, the first of equals. There is at least one.
fn least_log_loss(tried: impl IntoIterator<Item = Tried>) -> Tried {
    tried
        .into_iter()
        .reduce(|best, other| if other.log_loss_nats < best.log_loss_nats { other } else { best })
        .expect("there are candidates")
}

/// The readings as counts, and the data that score candidates.
struct Search<'a> {
    kind: ModelKind,
    axis: Axis,
    counts: Counts,
    held_out: &'a TrainingSet,
}

impl<'a> Search<'a> {
    fn new(kind: ModelKind, train: &TrainingSet, held_out: &'a TrainingSet) -> Self {
        let max_range = train.max_range();
        if kind == ModelKind::NpRegRegistered {
            let reach = CAST_REACH * max_range;
            let axis = Axis::around_zero(reach, noise_scale(train) / 5.0, max_range / 150.0);
            let grid = StateGrid { reach, ranges: 144, incidences: 30 };
            let counts = Counts::of(train, grid, &axis, registered);
            return Self { kind, axis, counts, held_out };
        }
        let bins = ((max_range / 0.01).ceil() as usize).clamp(100, 1000);
        let axis = Axis::uniform(max_range, bins);
        let grid = StateGrid { reach: max_range, ranges: bins.min(500), incidences: 15 };
        let counts = Counts::of(train, grid, &axis, published);
        Self { kind, axis, counts, held_out }
    }

    /// Scores every pair of bandwidths over the state.
    fn states(&self) -> Vec<Tried> {
        let (shares, observation_bins, pseudo_count) = match self.kind {
            ModelKind::NpRegRegistered => (&REGISTERED_RANGE_SHARES[..], OBSERVATIONS[0], PSEUDO_COUNTS[0]),
            _ => (&RANGE_SHARES[..], 0.0, FALLBACK),
        };
        let along_observation = self.counts.smoothed_over_observation(observation_bins);
        let mut tried = Vec::new();
        for share in shares {
            let range_m = share * self.held_out.max_range();
            let along_range = along_observation.smoothed_over_range(range_m);
            for incidence_rad in INCIDENCES {
                let smoothing = Smoothing { range_m, incidence_rad, observation_bins, pseudo_count };
                tried.push(self.scored(smoothing, &along_range.smoothed_over_incidence(incidence_rad)));
            }
        }
        tried
    }

    fn score(&self, smoothing: Smoothing) -> Tried {
        self.scored(smoothing, &self.smoothed(smoothing))
    }

    fn scored(&self, smoothing: Smoothing, smoothed: &Counts) -> Tried {
        let table = self.table(smoothed, smoothing.pseudo_count);
        let by_risk = self.kind == ModelKind::NpReg;
        Tried {
            smoothing,
            log_loss_nats: log_loss(&table, self.held_out),
            risk_m: if by_risk { histogram_match(&table, self.held_out) } else { 0.0 },
        }
    }

    fn smoothed(&self, smoothing: Smoothing) -> Counts {
        self.counts
            .smoothed_over_observation(smoothing.observation_bins)
            .smoothed_over_range(smoothing.range_m)
            .smoothed_over_incidence(smoothing.incidence_rad)
    }

    /// Normalizes smoothed counts, mixed with `pseudo_count` readings of the pooled histogram.
    fn table(&self, smoothed: &Counts, pseudo_count: f32) -> HistogramTable {
        let grid = smoothed.grid;
        let mut pooled = smoothed.pooled();
        let total: f32 = pooled.iter().sum();
        for mass in &mut pooled {
            *mass *= (1.0 - WIDE) / total;
        }
        let mut mass = vec![0.0; grid.cells() * self.axis.bins()];
        mass.par_chunks_mut(self.axis.bins()).enumerate().for_each(|(cell, mass)| {
            // open beams aren't like the others: their cell leans on the wide distribution alone
            let (share, wide) =
                if cell == grid.mapped() { (0.0, 1.0) } else { (pseudo_count, pseudo_count * WIDE) };
            self.fill_cell(smoothed.row(cell), &pooled, share, wide, grid.longest(cell), mass);
        });
        let max_range = self.held_out.max_range();
        let parts = Parts { kind: self.kind, max_range, grid, axis: self.axis.clone(), mass };
        HistogramTable::try_from(parts).expect("normalized counts are probabilities")
    }

    /// The bin masses of one cell: its counts, `share` readings of the pooled histogram and `wide` of the
    /// wide distribution, without readings that would be below 0 at every nominal range up to `longest`, normalized.
    /// Readings beyond the maximum range stay: the table reports them as the maximum range.
    fn fill_cell(
        &self,
        counts: &[f32],
        pooled: &[f32],
        share: f32,
        wide: f32,
        longest: f32,
        mass: &mut [f32],
    ) {
        let bins = self.axis.bins();
        let zero = if self.kind == ModelKind::NpRegRegistered { -longest } else { 0.0 };
        for (bin, mass) in mass.iter_mut().enumerate() {
            if self.axis.upper(bin) > zero {
                let even = self.axis.width(bin) / self.held_out.max_range();
                *mass = counts[bin] + share * pooled[bin] + 0.5 * wide * even;
            }
        }
        let at_max = counts[bins] + share * pooled[bins] + 0.5 * wide;
        let total = f64::from(at_max) + mass.iter().map(|m| f64::from(*m)).sum::<f64>();
        for mass in mass {
            *mass = (f64::from(*mass) / total).min(1.0) as f32;
        }
    }
}

/// A scale of the sensor's own noise \[m\] from readings of mapped surfaces: the 40th percentile of their
/// distance to the nominal range, which is half a standard deviation of Gaussian noise, or more where objects
/// block some beams. Kept between 2.5 mm and 10 cm.
fn noise_scale(train: &TrainingSet) -> f32 {
    let mut off: Vec<f32> = train
        .readings()
        .filter(|(z, beam)| *z < beam.max_range && !beam.is_open())
        .map(|(z, beam)| (z - beam.range).abs())
        .collect();
    let at = off.len() * 2 / 5;
    let (_, scale, _) = off.select_nth_unstable_by(at, f32::total_cmp);
    scale.clamp(2.5e-3, 0.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::simulated::training_set;

    /// A beam is answered by the cell it falls into. Four times as many cells change the log loss by less
    /// than 0.003 nats, so interpolating between cells couldn't gain more.
    #[test]
    fn cells_are_small_enough() {
        let (train, held_out) = training_set(1000, 40, 3).split(0.3, 1).unwrap();
        let coarse = Search::new(ModelKind::NpRegRegistered, &train, &held_out);
        let grid = StateGrid { ranges: 288, incidences: 60, ..coarse.counts.grid };
        let counts = Counts::of(&train, grid, &coarse.axis, registered);
        let fine = Search { axis: coarse.axis.clone(), counts, ..coarse };
        let smoothing =
            Smoothing { range_m: 0.45, incidence_rad: 0.06, observation_bins: 1.0, pseudo_count: 3.0 };
        let losses = [&coarse, &fine].map(|search| search.score(smoothing).log_loss_nats);
        assert!((losses[0] - losses[1]).abs() < 0.003, "{losses:?}");
    }
}
