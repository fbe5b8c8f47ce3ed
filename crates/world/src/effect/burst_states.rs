//! Effects that come in bursts, of which a log doesn't say when they came.

use super::false_returns::BURST_SECS;
use super::{Bursts, Effect, Effects};

/// Bursts of an effect, which fall on all readings of a scan or on none: together those say far more surely than one by one when
/// there was one. A window of time, which has a burst or not, may begin with any scan (a hidden Markov model of two states), as bursts
/// of another robot don't keep to this log's seconds. A scan is at its stamp, also where its beams take time.
#[derive(Clone, Debug)]
pub struct BurstStates {
    /// The effects in a burst.
    pub on: Effects,
    /// The effects without one.
    pub off: Effects,
    /// Share of the windows that one falls on.
    share: f64,
}

/// What is known of a scan when bursts may come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InBurst {
    /// Its log likelihood, given the scans before it (nats).
    pub log_likelihood: f64,
    /// Probability that a burst falls on it, given all scans.
    pub probability: f64,
}

impl BurstStates {
    /// Those of these effects; `None` of none. Of several, the readings of all but the first are taken one by one.
    pub fn of(effects: &Effects) -> Option<Self> {
        let (at, bursts) = effects.list().iter().enumerate().find_map(|(i, effect)| {
            let comes_and_goes =
                |bursts: &Bursts| bursts.share > 0.0 && bursts.share < 1.0 && bursts.on != bursts.off;
            Some((i, effect.bursts().filter(comes_and_goes)?))
        })?;
        let with = |state: Effect| {
            let mut list = effects.list().to_vec();
            list[at] = state;
            effects.replaced(list).ok()
        };
        Some(Self { on: with(bursts.on)?, off: with(bursts.off)?, share: bursts.share })
    }

    /// Of each scan at `secs` \[s\], by its log likelihoods with a burst and without (nats), one each. Forward and backward recursion
    /// (Rabiner 1989).
    pub fn scans(&self, secs: &[f64], with: &[f64], without: &[f64]) -> Vec<InBurst> {
        let prior = [self.share, 1.0 - self.share];
        // Probability that a window begins between a scan and the one before it.
        let begins = |scan: usize| match scan {
            0 => 1.0,
            // Never surely not: two scans may have one stamp.
            _ => ((secs[scan] - secs[scan - 1]) / BURST_SECS).clamp(1e-9, 1.0),
        };
        // Likelihoods over the greater of both, whose logarithm comes first.
        let scaled = |scan: usize| {
            let most = with[scan].max(without[scan]);
            (most, [(with[scan] - most).exp(), (without[scan] - most).exp()])
        };
        let mut state = prior;
        let mut scans = Vec::with_capacity(secs.len());
        for scan in 0..secs.len() {
            let begins = begins(scan);
            let (most, likelihoods) = scaled(scan);
            let joint = [0, 1].map(|i| (begins * prior[i] + (1.0 - begins) * state[i]) * likelihoods[i]);
            let total = joint[0] + joint[1];
            state = joint.map(|p| p / total);
            scans.push(InBurst { log_likelihood: most + total.ln(), probability: state[0] });
        }
        // What the scans after one say of its state.
        let mut after = [1.0; 2];
        for scan in (0..secs.len()).rev() {
            let here = scans[scan].probability;
            let joint = [here * after[0], (1.0 - here) * after[1]];
            scans[scan].probability = joint[0] / (joint[0] + joint[1]);
            let begins = begins(scan);
            let (_, likelihoods) = scaled(scan);
            let seen = [0, 1].map(|i| likelihoods[i] * after[i]);
            let anew = prior[0] * seen[0] + prior[1] * seen[1];
            let before = seen.map(|seen| begins * anew + (1.0 - begins) * seen);
            after = before.map(|p| p / (before[0] + before[1]));
        }
        scans
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::EffectKind;

    fn crosstalk(p: f64, share: f64) -> Effect {
        Effect::new(EffectKind::Crosstalk, vec![p, share], Vec::new()).unwrap()
    }

    /// Three scans, by all eight ways in which bursts may fall on them; the last is in a window of its own.
    #[test]
    fn bursts_fall_on_scans_as_a_sum_over_all_ways_says() {
        let bursts = BurstStates::of(&Effects::new(vec![crosstalk(0.1, 0.2)]).unwrap()).unwrap();
        let secs = [0.7, 1.1, 3.0];
        let (with, without): ([f64; 3], [f64; 3]) = ([-3.0, -2.0, -40.0], [-8.0, -1.0, -30.0]);
        let scans = bursts.scans(&secs, &with, &without);
        let share = |on: bool| if on { 0.2 } else { 0.8 };
        let (mut total, mut in_burst) = (0.0, [0.0; 3]);
        for ways in 0..8 {
            let on = [0, 1, 2].map(|scan| ways >> scan & 1 == 1);
            let stays = if on[0] == on[1] { 0.6 } else { 0.0 };
            let likelihood: f64 = (0..3).map(|scan| if on[scan] { with[scan] } else { without[scan] }).sum();
            let p = share(on[0]) * (0.4 * share(on[1]) + stays) * share(on[2]) * likelihood.exp();
            total += p;
            (0..3).filter(|&scan| on[scan]).for_each(|scan| in_burst[scan] += p);
        }
        let sum: f64 = scans.iter().map(|scan| scan.log_likelihood).sum();
        assert!((sum - total.ln()).abs() < 1e-12, "{scans:?}");
        for (scan, p) in scans.iter().zip(in_burst) {
            assert!((scan.probability - p / total).abs() < 1e-12, "{scans:?}");
        }
    }

    /// Likelihoods that no number can hold: each scan is surely with a burst or without.
    #[test]
    fn readings_that_say_it_surely_are_believed() {
        let bursts = BurstStates::of(&Effects::new(vec![crosstalk(1.0, 0.2)]).unwrap()).unwrap();
        let secs: Vec<f64> = (0..40).map(|scan| 0.1 * f64::from(scan)).collect();
        let is_on = |scan: usize| (7..22).contains(&scan);
        let (with, without): (Vec<f64>, Vec<f64>) =
            (0..40).map(|scan| if is_on(scan) { (-200.0, -9000.0) } else { (-9000.0, 100.0) }).unzip();
        for (i, scan) in bursts.scans(&secs, &with, &without).iter().enumerate() {
            assert!(scan.log_likelihood.is_finite(), "{i}: {scan:?}");
            assert!((scan.probability - f64::from(u8::from(is_on(i)))).abs() < 1e-9, "{i}: {scan:?}");
        }
    }

    /// Crosstalk that never ends has no bursts, beside which those of another one are known.
    #[test]
    fn what_never_ends_has_no_bursts() {
        let of = |list: Vec<Effect>| BurstStates::of(&Effects::new(list).unwrap());
        assert!(of(vec![crosstalk(0.1, 1.0)]).is_none());
        let both = of(vec![crosstalk(0.003, 1.0), crosstalk(0.1, 0.2)]).unwrap();
        assert_eq!(both.on.list(), [crosstalk(0.003, 1.0), crosstalk(0.1, 1.0)]);
        assert_eq!(both.off.list(), [crosstalk(0.003, 1.0), crosstalk(0.0, 1.0)]);
        let two = of(vec![crosstalk(0.1, 0.5), crosstalk(0.1, 0.2)]).unwrap();
        assert_eq!(two.on.list(), [crosstalk(0.1, 1.0), crosstalk(0.1, 0.2)]);
    }
}
