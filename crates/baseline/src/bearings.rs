//! Returns that are lost at some bearings: a dirty, scratched or covered window.

use std::f64::consts::TAU;

use locsim_core::gains_surely;
use locsim_core::{Estimate, sum_error};
use serde::Serialize;

use super::fitting::Known;
use super::pool::{Expected, Pool};

/// Parts into which all bearings are cut.
const PARTS: usize = 36;
/// A share isn't told of fewer readings.
const FEWEST: f64 = 40.0;
/// The least probability of a loss: the baseline may have none at a place by chance.
const LEAST: f64 = 1e-3;
/// A share that is surely larger is shown.
const SHOWN: f64 = 0.05;
/// A share of lost returns is at most this.
const MOST: f64 = 0.99;

/// Returns that today's log loses, beyond the baseline, by the bearing of the beam.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LossesByBearing {
    /// First and last bearing of each part that has been seen often enough \[rad\].
    pub bearings: Vec<[f64; 2]>,
    /// Share of the returns that are lost there, which the baseline has.
    pub shares: Vec<Estimate>,
    /// Log score that they gain on stretches that they weren't learnt from (nats).
    pub gain_nats: f64,
}

impl LossesByBearing {
    /// The stretches of bearings at which returns are surely lost \[rad\].
    pub fn stretches(&self) -> Vec<[f64; 2]> {
        let mut stretches: Vec<[f64; 2]> = Vec::new();
        let mut parts: Vec<([f64; 2], f64)> =
            self.bearings.iter().copied().zip(self.shares.iter().map(|share| share.interval.lo)).collect();
        parts.sort_by(|([a, _], _), ([b, _], _)| a.total_cmp(b));
        // Parts between which no other has been seen are of one stretch.
        let mut goes_on = false;
        for ([from, to], least) in parts {
            let is_lossy = least >= SHOWN;
            match stretches.last_mut().filter(|_| goes_on) {
                _ if !is_lossy => {}
                Some(last) => last[1] = to,
                None => stretches.push([from, to]),
            }
            goes_on = is_lossy;
        }
        stretches
    }

    /// The bearings at which most returns are lost \[rad\], with their share.
    pub fn most(&self) -> Option<([f64; 2], Estimate)> {
        let all = self.bearings.iter().copied().zip(self.shares.iter().copied());
        all.max_by(|(_, a), (_, b)| a.value.total_cmp(&b.value))
    }
}

/// Returns that were expected, and those that were lost beyond the baseline's.
#[derive(Clone, Copy, Default)]
struct Count {
    expected: f64,
    lost: f64,
}

impl Count {
    fn share(self) -> f64 {
        (self.lost / self.expected.max(1.0)).clamp(0.0, MOST)
    }
}

/// Losses by bearing, where they surely gain more on held-out stretches of today's log than `rival`, the gain of an effect on each
/// stretch (nats). `expected` is what is expected of each reading without that effect.
pub(super) fn find(
    pool: &Pool<'_>,
    known: &Known,
    expected: &[Expected],
    rival: &[f64],
) -> Option<LossesByBearing> {
    let max = pool.nominal.laser.max_range_m as f32;
    let stretches = rival.len();
    let mut counts = vec![[Count::default(); PARTS]; stretches];
    let mut readings = Vec::new();
    for (reading, expected) in pool.at_shared_places().iter().zip(expected) {
        if reading.log != 1 || !expected.mean.is_finite() {
            continue;
        }
        let usual = known.learnt.density(reading.stretch, expected, max).clamp(LEAST, 1.0 - LEAST);
        let turn = pool.beam(reading).view.bearing.rem_euclid(TAU) / TAU;
        let part = ((turn * PARTS as f64) as usize).min(PARTS - 1);
        let is_lost = reading.z >= max;
        let count = &mut counts[reading.stretch as usize][part];
        count.expected += 1.0 - usual;
        count.lost += f64::from(u8::from(is_lost)) - usual;
        readings.push((reading.stretch as usize, part, usual, is_lost));
    }
    let mut all = [Count::default(); PARTS];
    for of_stretch in &counts {
        for (sum, count) in all.iter_mut().zip(of_stretch) {
            sum.expected += count.expected;
            sum.lost += count.lost;
        }
    }
    let mut gains = vec![0.0; stretches];
    for (stretch, part, usual, is_lost) in readings {
        // As learnt from all other stretches.
        let (whole, own) = (all[part], counts[stretch][part]);
        let share = Count { expected: whole.expected - own.expected, lost: whole.lost - own.lost }.share();
        gains[stretch] += if is_lost { (share * (1.0 - usual) / usual).ln_1p() } else { (-share).ln_1p() };
    }
    let ahead: Vec<f64> = gains.iter().zip(rival).map(|(own, other)| own - other).collect();
    let of_today: Vec<f64> = ahead[pool.stretches[0]..].to_vec();
    if !gains_surely(&of_today) {
        return None;
    }
    let mut found =
        LossesByBearing { bearings: Vec::new(), shares: Vec::new(), gain_nats: gains.iter().sum() };
    for (part, whole) in all.iter().enumerate().filter(|(_, whole)| whole.expected >= FEWEST) {
        let side = TAU / PARTS as f64;
        let from = part as f64 * side;
        let from = if from >= 0.5 * TAU { from - TAU } else { from };
        // Stretches are independent, readings of one aren't.
        let rests: Vec<f64> =
            counts.iter().map(|of| of[part].lost - whole.share() * of[part].expected).collect();
        found.bearings.push([from, from + side]);
        found.shares.push(Estimate::normal(whole.share(), sum_error(&rests) / whole.expected));
    }
    Some(found)
}
