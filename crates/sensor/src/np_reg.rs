//! The paper's nonparametric regression of histograms, as published and registered to the nominal range.

use std::collections::BTreeMap;

use crate::axis::Axis;
use crate::binned::Counts;
use crate::histogram::{HistogramTable, Parts};
use crate::state_grid::StateGrid;
use crate::{Evaluation, ModelKind, SensorError, TrainingSet, evaluate};

/// Candidates for the bandwidth over nominal range, as shares of the maximum range: 1 cm to 1.8 m of 4.5 m.
const RANGE_SHARES: [f32; 8] = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4];
/// Candidates for the bandwidth over incidence [rad].
const INCIDENCES: [f32; 5] = [0.03, 0.06, 0.12, 0.25, 0.5];
/// Candidates for the bandwidth over the observation in bins, and for the weight of the pooled histogram in
/// readings; the first of each is used while the bandwidths over the state are chosen.
const OBSERVATIONS: [f32; 4] = [1.0, 0.5, 2.0, 3.0];
const PSEUDO_COUNTS: [f32; 3] = [3.0, 1.0, 10.0];

/// Weight of the pooled histogram for `np_reg`, which knows of no such thing: enough to say something where no state
/// is near.
const FALLBACK: f32 = 1e-3;

/// Share of the wide distribution (half uniform, half at the maximum range) in the pooled histogram: no reading is
/// impossible.
const WIDE: f32 = 1e-3;

/// Candidates whose risk is within this share of the least count as equally good by risk.
const EQUAL_RISK: f64 = 0.01;

/// What decides the smoothing.
#[derive(Clone, Copy, Debug)]
struct Smoothing {
    range_m: f32,
    incidence_rad: f32,
    observation_bins: f32,
    pseudo_count: f32,
}

/// Fits `np_reg` or `np_reg_registered`.
///
/// `np_reg` is the paper's procedure 2 with histograms (eqs. 6 and 7): histograms of z in bins of 1 cm (1/1000 of the
/// maximum range where that is more), smoothed over (r, alpha) by a product of Gaussian kernels. Each reading has the same
/// weight; with M readings at every state that is eq. (7). Bandwidths: least risk (mean histogram match, the paper's
/// criterion) on the held-out states; of those within 1 % of the least, the one with the least log loss.
///
/// `np_reg_registered` smooths histograms of z - r. The sensor's own noise then stays at 0 whatever the bandwidth
/// over r, so that it isn't blurred. Its bins are fine around 0 and coarse far away, smoothed by a Gaussian
/// that is constant in bins, hence wide where bins are; a cell with few readings around it leans on the histogram of all.
/// All constants by the least held-out log loss, a strictly proper score and what a filter adds up; the risk, which
/// forgives a blurred peak, isn't asked. First the bandwidths over the state, then over the observation, then the weight of
/// the pooled histogram.
pub(crate) fn fit(
    kind: ModelKind,
    train: &TrainingSet,
    held_out: &TrainingSet,
) -> Result<(HistogramTable, BTreeMap<String, f64>), SensorError> {
    if !train.readings().any(|(z, beam)| z < beam.max_range && !beam.is_open()) {
        return Err(SensorError::TooFewData { model: kind, what: "no reading of a mapped surface" });
    }
    let search = Search::new(kind, train, held_out);
    let registered = kind == ModelKind::NpRegRegistered;
    let mut tried = search.states();
    let mut best = choose(kind, &tried);
    if registered {
        for observation_bins in OBSERVATIONS {
            tried.push(search.try_one(Smoothing { observation_bins, ..best.0 }));
        }
        best = choose(kind, &tried);
        for pseudo_count in PSEUDO_COUNTS {
            tried.push(search.try_one(Smoothing { pseudo_count, ..best.0 }));
        }
        best = choose(kind, &tried);
    }
    let (smoothing, score) = best;
    let mut chosen: BTreeMap<String, f64> = [
        ("bandwidth_range_m", smoothing.range_m.into()),
        ("bandwidth_incidence_rad", smoothing.incidence_rad.into()),
        ("held_out_log_loss_nats", score.log_loss_nats),
        ("held_out_histogram_match_m", score.histogram_match_m),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into();
    if registered {
        chosen.insert("bandwidth_observation_bins".to_owned(), smoothing.observation_bins.into());
        chosen.insert("pseudo_count".to_owned(), smoothing.pseudo_count.into());
    }
    Ok((search.table(&search.smoothed(smoothing), smoothing.pseudo_count), chosen))
}

/// The best of what was tried; the earlier of equals.
fn choose(kind: ModelKind, tried: &[(Smoothing, Evaluation)]) -> (Smoothing, Evaluation) {
    let least_risk = tried.iter().map(|t| t.1.histogram_match_m).fold(f64::INFINITY, f64::min);
    let allowed = |score: &Evaluation| {
        kind == ModelKind::NpRegRegistered || score.histogram_match_m <= least_risk * (1.0 + EQUAL_RISK)
    };
    let mut best: Option<&(Smoothing, Evaluation)> = None;
    for candidate in tried.iter().filter(|t| allowed(&t.1)) {
        if best.is_none_or(|best| candidate.1.log_loss_nats < best.1.log_loss_nats) {
            best = Some(candidate);
        }
    }
    *best.expect("the candidate of least risk is allowed")
}

/// The readings as counted, and what scores candidates.
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
            let axis = Axis::around_zero(max_range, noise_scale(train) / 5.0, max_range / 150.0);
            let grid = StateGrid { max_range, ranges: 96, incidences: 30 };
            let counts = Counts::of(train, grid, &axis, |z, r| z - r);
            return Self { kind, axis, counts, held_out };
        }
        let bins = ((max_range / 0.01).ceil() as usize).clamp(100, 1000);
        let axis = Axis::uniform(max_range, bins);
        let grid = StateGrid { max_range, ranges: bins.min(500), incidences: 15 };
        let counts = Counts::of(train, grid, &axis, |z, _| z);
        Self { kind, axis, counts, held_out }
    }

    /// Scores every pair of bandwidths over the state.
    fn states(&self) -> Vec<(Smoothing, Evaluation)> {
        let (observation_bins, pseudo_count) = match self.kind {
            ModelKind::NpRegRegistered => (OBSERVATIONS[0], PSEUDO_COUNTS[0]),
            _ => (0.0, FALLBACK),
        };
        let along_observation = self.counts.smoothed_over_observation(observation_bins);
        let mut tried = Vec::new();
        for share in RANGE_SHARES {
            let range_m = share * self.counts.grid.max_range;
            let along_range = along_observation.smoothed_over_range(range_m);
            for incidence_rad in INCIDENCES {
                let smoothing = Smoothing { range_m, incidence_rad, observation_bins, pseudo_count };
                let table = self.table(&along_range.smoothed_over_incidence(incidence_rad), pseudo_count);
                tried.push((smoothing, evaluate(&table, self.held_out)));
            }
        }
        tried
    }

    fn try_one(&self, smoothing: Smoothing) -> (Smoothing, Evaluation) {
        let table = self.table(&self.smoothed(smoothing), smoothing.pseudo_count);
        (smoothing, evaluate(&table, self.held_out))
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
        pooled.iter_mut().for_each(|mass| *mass *= (1.0 - WIDE) / total);
        let mut mass = Vec::with_capacity(grid.cells() * self.axis.bins());
        for cell in 0..grid.cells() {
            let open = cell == grid.mapped();
            let share = if open { 0.0 } else { pseudo_count };
            let wide = pseudo_count * if open { 1.0 } else { WIDE };
            self.push_row(smoothed.row(cell), &pooled, share, wide, grid.centre(cell).0, &mut mass);
        }
        let parts = Parts { kind: self.kind, grid, axis: self.axis.clone(), mass };
        HistogramTable::try_from(parts).expect("normalized counts are probabilities")
    }

    /// Appends the bin masses of one cell: its counts, `share` readings of the pooled histogram, and
    /// `wide` of the wide distribution, cut to readings that are possible at nominal range `r`, and normalized.
    fn push_row(&self, counts: &[f32], pooled: &[f32], share: f32, wide: f32, r: f32, mass: &mut Vec<f32>) {
        let bins = self.axis.bins();
        let max_range = self.counts.grid.max_range;
        let zero = if self.kind == ModelKind::NpRegRegistered { r } else { 0.0 };
        let start = mass.len();
        let mut at_max = f64::from(counts[bins] + share * pooled[bins] + 0.5 * wide);
        let mut total = 0.0;
        for bin in 0..bins {
            let (lower, upper) = (self.axis.lower(bin) + zero, self.axis.upper(bin) + zero);
            let possible = (upper.min(max_range) - lower.max(0.0)).max(0.0);
            let value = counts[bin] + share * pooled[bin] + 0.5 * wide * possible / max_range;
            // a reading beyond the maximum range is seen as the maximum range, one below 0 isn't seen
            let kept = if possible > 0.0 { value } else { 0.0 };
            if lower >= max_range {
                at_max += f64::from(value);
            }
            total += f64::from(kept);
            mass.push(kept);
        }
        let scale = 1.0 / (total + at_max);
        mass[start..].iter_mut().for_each(|m| *m = ((f64::from(*m) * scale) as f32).min(1.0));
    }
}

/// A scale of the sensor's own noise [m] from readings of mapped surfaces: the 40th percentile of their distance to the
/// nominal range, which is half a standard deviation of Gaussian noise, or more where objects block
/// some beams. Kept between 2.5 mm and 10 cm.
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
