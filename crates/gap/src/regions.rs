//! Where a log is off, and by how much.

use distreg::{empirical_wasserstein_1, false_discovery_rates};
use locsim_comparison::Views;
use locsim_core::{equal_bins, normal};
use locsim_world::effect::Effect;
use rand::RngExt;
use rayon::prelude::*;

use crate::outcome::{BeamPit, PitHistogram, Region};
use crate::rank::Null;
use crate::statistics::{Cell, Covariate, Dictionary, WALL_CELL_M, pit_draw};
use crate::{GapError, Nominal, Recorded};
use locsim_comparison::{Comparison, Fitted};

/// False discovery rate of regions: on average, at most one of ten regions is there by chance.
const DISCOVERY_RATE: f64 = 0.1;
/// A region has to be off on the other half of the log too, with this p-value.
const OTHER_HALF: f64 = 0.05;
/// The most regions that are reported.
const MOST_REGIONS: usize = 40;
/// A cell is still off beyond this (standard deviations), which a normal number exceeds once in 2000.
const STILL_OFF: f64 = 3.5;

/// A hypothesis as far as regions need it.
pub(crate) struct Side<'r> {
    pub dictionary: &'r Dictionary,
    pub null: &'r Null,
}

/// Regions found on one half of the log's folds and certified on the other, the farthest off first.
pub(crate) fn locate(
    before: &Side<'_>,
    after: &Side<'_>,
    views: &Views,
    recorded: &Recorded,
    simulated: &[Recorded],
) -> Vec<Region> {
    let null = before.null;
    // Over all cells, on the first half.
    let mut order: Vec<(usize, &Cell)> = before.dictionary.cells().collect();
    // A frame is of the log as a whole: there is no other half to certify it on.
    order.retain(|(_, cell)| !cell.deviation.is_of_frame());
    order.sort_by(|(a, _), (b, _)| null.halves[*b][0].abs().total_cmp(&null.halves[*a][0].abs()));
    let p_values: Vec<f64> =
        order.iter().map(|(i, _)| 2.0 * normal::tail(null.halves[*i][0].abs())).collect();
    let q = false_discovery_rates(&p_values);
    let mut regions: Vec<Region> = order
        .iter()
        .zip(q)
        .filter(|(_, q)| *q <= DISCOVERY_RATE)
        .filter_map(|(&(i, cell), q)| {
            let [here, there] = null.halves[i];
            let p_other_half = normal::tail(there * here.signum());
            if p_other_half > OTHER_HALF {
                return None;
            }
            let z = null.z[i];
            let all = 0..views.beams.len();
            let beams: Vec<u32> =
                all.filter(|&beam| before.dictionary.includes(i, beam)).map(|beam| beam as u32).collect();
            let same = after.dictionary.cells().find(|(_, other)| *other == cell);
            let still = same.map_or(0.0, |(j, _)| after.null.z[j]);
            let place = cell.place.map(|[x, y]| [x, y, x + WALL_CELL_M, y + WALL_CELL_M]);
            Some(Region {
                covariate: cell.covariate,
                lo: cell.lo,
                hi: cell.hi,
                place,
                deviation: cell.deviation,
                z,
                w1_mm: distance_of(&beams, views, recorded, simulated),
                nats: 0.5 * z * z,
                q,
                p_other_half,
                remains: still.abs() > STILL_OFF,
            })
        })
        .collect();
    regions.sort_by(|a, b| b.z.abs().total_cmp(&a.z.abs()));
    regions.truncate(MOST_REGIONS);
    regions
}

/// Wasserstein-1 distance of range errors between a log and simulated ones \[mm\].
pub(crate) fn distance(views: &Views, recorded: &Recorded, simulated: &[Recorded]) -> f64 {
    let all: Vec<u32> = (0..views.beams.len() as u32).collect();
    distance_of(&all, views, recorded, simulated)
}

/// The same where each half of the log is held against simulations of its own.
pub(crate) fn distance_in_halves(views: &Views, recorded: &Recorded, simulated: [&[Recorded]; 2]) -> f64 {
    let all = 0..views.beams.len() as u32;
    let half_of = |beam: u32| recorded.folds.half_of(beam as usize / views.per_scan);
    let own = range_errors(&all.clone().collect::<Vec<_>>(), views, recorded);
    let others = simulated.into_iter().enumerate().flat_map(|(half, logs)| {
        let beams: Vec<u32> = all.clone().filter(|&beam| half_of(beam) == half).collect();
        logs.iter().flat_map(|log| range_errors(&beams, views, log)).collect::<Vec<f64>>()
    });
    1e3 * empirical_wasserstein_1(own, others.collect())
}

/// The same over some beams.
fn distance_of(beams: &[u32], views: &Views, recorded: &Recorded, simulated: &[Recorded]) -> f64 {
    let own = range_errors(beams, views, recorded);
    let others: Vec<f64> = simulated.iter().flat_map(|log| range_errors(beams, views, log)).collect();
    1e3 * empirical_wasserstein_1(own, others)
}

/// Readings of some beams less the map's ranges \[m\], both no more than the maximum range.
fn range_errors(beams: &[u32], views: &Views, log: &Recorded) -> Vec<f64> {
    let max = log.laser.max_range();
    let usable = beams.iter().map(|&i| i as usize).filter(|&i| !log.readings[i].is_nan());
    usable.map(|i| f64::from(log.readings[i].min(max)) - views.beams[i].range().min(f64::from(max))).collect()
}

/// The PIT of every beam before and after.
pub(crate) fn pits(
    before: &Comparison<'_>,
    fitted_before: &Fitted,
    after: &Comparison<'_>,
    fitted_after: &Fitted,
    nominal: &Nominal,
    effects: &[Effect],
    seed: u64,
) -> Result<Vec<BeamPit>, GapError> {
    let mut out = vec![
        BeamPit { before: f32::NAN, after: f32::NAN, residual: f32::NAN, ..BeamPit::default() };
        before.views.beams.len()
    ];
    let draw = pit_draw(seed);
    let all = nominal.effects_with(effects)?;
    for (comparison, fitted, effects, is_before) in
        [(before, fitted_before, &nominal.effects, true), (after, fitted_after, &all, false)]
    {
        let max = nominal.laser.max_range_m;
        comparison.for_each_reading(
            &comparison.views,
            effects,
            fitted,
            |scan, i, density, shift, z, terms| {
                let beam = &comparison.views.beams[i];
                let u = if z < max {
                    density.cdf(beam, shift, z)
                } else {
                    1.0 - terms.density.min(1.0) * draw.at(scan as u32).item(i as u32).random::<f64>()
                };
                if is_before {
                    out[i].before = u as f32;
                    out[i].residual = (z - (beam.range() + shift).min(max)).clamp(-1.0, 1.0) as f32;
                    let end = beam.view.point_at(z);
                    out[i].endpoint = [end.x as f32, end.y as f32];
                } else {
                    out[i].after = u as f32;
                }
            },
        );
    }
    Ok(out)
}

/// Bins of a covariate in which the PIT is counted.
const PIT_BINS: usize = 5;

/// PIT histograms over a few bins of each covariate that has an order.
pub(crate) fn histograms(comparison: &Comparison<'_>, pits: &[BeamPit]) -> Vec<PitHistogram> {
    use Covariate as C;
    let (views, recorded) = (&comparison.views, &*comparison.recorded);
    let velocities = recorded.velocities();
    let k = views.per_scan;
    let value = |covariate: Covariate, i: usize| match covariate {
        C::Range => views.beams[i].view.range.min(comparison.nominal.laser.max_range_m),
        C::Incidence => views.beams[i].view.incidence,
        C::Bearing => views.beams[i].view.bearing,
        C::Time => recorded.track.secs()[i / k],
        C::Speed => velocities[i / k][0].hypot(velocities[i / k][1]),
        _ => velocities[i / k][2],
    };
    let covariates = [C::Range, C::Incidence, C::Bearing, C::Time, C::Speed, C::TurnRate].into_par_iter();
    let of_covariate = |covariate| {
        let known = (0..pits.len()).filter(|&i| pits[i].before.is_finite() && pits[i].after.is_finite());
        equal_bins(known.map(|i| (value(covariate, i), i)).collect(), PIT_BINS, 1).into_iter().map(
            move |(_, part)| {
                let histogram = |of: &dyn Fn(&BeamPit) -> f32| {
                    let mut shares = [0.0; 10];
                    for &i in &part {
                        shares[((10.0 * of(&pits[i])) as usize).min(9)] += 1.0 / part.len() as f64;
                    }
                    shares
                };
                PitHistogram {
                    covariate,
                    lo: part.first().map_or(0.0, |&i| value(covariate, i)),
                    hi: part.last().map_or(0.0, |&i| value(covariate, i)),
                    before: histogram(&|pit| pit.before),
                    after: histogram(&|pit| pit.after),
                    readings: part.len(),
                }
            },
        )
    };
    covariates.flat_map_iter(of_covariate).collect()
}
