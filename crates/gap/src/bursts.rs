//! Effects that come in bursts, of which a log doesn't say when they came.

use locsim_world::effect::{self, Effect, Effects, burst_window};

/// Bursts of an effect, which fall on all readings of a window of time or on none: together those say far more surely than one by
/// one when there was one. A scan is of the window of its stamp, also where its beams take time.
pub(crate) struct Bursts {
    /// The effects in a burst.
    pub on: Effects,
    /// The effects without one.
    pub off: Effects,
    /// Share of the windows that one falls on.
    share: f64,
}

/// What is known of a scan when bursts may come.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InBurst {
    /// Its log likelihood, given the scans before it of its window (nats).
    pub log_likelihood: f64,
    /// Probability that a burst falls on it, given all scans of its window.
    pub probability: f64,
}

impl Bursts {
    /// Those of these effects; `None` of none. Of several, the readings of all but the first are taken one by one.
    pub fn of(effects: &Effects) -> Option<Self> {
        let (at, bursts) = effects.list().iter().enumerate().find_map(|(i, effect)| {
            let comes_and_goes =
                |bursts: &effect::Bursts| bursts.share > 0.0 && bursts.share < 1.0 && bursts.on != bursts.off;
            Some((i, effect.bursts().filter(comes_and_goes)?))
        })?;
        let with = |state: Effect| {
            let mut list = effects.list().to_vec();
            list[at] = state;
            effects.replaced(list).ok()
        };
        Some(Self { on: with(bursts.on)?, off: with(bursts.off)?, share: bursts.share })
    }

    /// Of each scan at `secs` \[s\], by its log likelihoods with a burst and without (nats).
    pub fn scans(&self, secs: &[f64], with: &[f64], without: &[f64]) -> Vec<InBurst> {
        let prior = [self.share.ln(), (-self.share).ln_1p()];
        let add = |[a, b]: [f64; 2]| a.max(b) + (-(a - b).abs()).exp().ln_1p();
        let mut scans: Vec<InBurst> = Vec::with_capacity(secs.len());
        for window in secs.chunk_by(|a, b| burst_window(*a) == burst_window(*b)) {
            let first = scans.len();
            let mut log_weights = prior;
            for scan in first..first + window.len() {
                let before = add(log_weights);
                log_weights = [log_weights[0] + with[scan], log_weights[1] + without[scan]];
                scans.push(InBurst { log_likelihood: add(log_weights) - before, probability: 0.0 });
            }
            let probability = (log_weights[0] - add(log_weights)).exp();
            scans[first..].iter_mut().for_each(|scan| scan.probability = probability);
        }
        scans
    }
}

#[cfg(test)]
mod tests {
    use locsim_world::effect::EffectKind;

    use super::*;

    fn crosstalk(p: f64, share: f64) -> Effect {
        Effect::new(EffectKind::Crosstalk, vec![p, share], Vec::new()).unwrap()
    }

    /// Two windows of two scans and one: each is with a burst or without, as a whole.
    #[test]
    fn a_burst_falls_on_all_scans_of_a_window_or_on_none() {
        let bursts = Bursts::of(&Effects::new(vec![crosstalk(0.1, 0.2)]).unwrap()).unwrap();
        let (with, without): ([f64; 3], [f64; 3]) = ([-3.0, -2.0, -40.0], [-8.0, -1.0, -30.0]);
        let scans = bursts.scans(&[0.3, 0.9, 1.1], &with, &without);
        let likelihoods = [0, 1, 2].map(|scan: usize| scans[scan].log_likelihood);
        let first = 0.2 * (-5.0_f64).exp() + 0.8 * (-9.0_f64).exp();
        let second = 0.2 * (-40.0_f64).exp() + 0.8 * (-30.0_f64).exp();
        assert!(
            (likelihoods[0] + likelihoods[1] - first.ln()).abs() < 1e-12
                && (likelihoods[2] - second.ln()).abs() < 1e-12,
            "{scans:?}"
        );
        assert!((likelihoods[0] - (0.2 * (-3.0_f64).exp() + 0.8 * (-8.0_f64).exp()).ln()).abs() < 1e-12);
        let of_first = 0.2 * (-5.0_f64).exp() / first;
        let of_second = 0.2 * (-40.0_f64).exp() / second;
        for (scan, right) in scans.iter().zip([of_first, of_first, of_second]) {
            assert!((scan.probability - right).abs() < 1e-12, "{scans:?}");
        }
    }

    /// Crosstalk that never ends has no bursts, beside which those of another one are known.
    #[test]
    fn what_never_ends_has_no_bursts() {
        let of = |list: Vec<Effect>| Bursts::of(&Effects::new(list).unwrap());
        assert!(of(vec![crosstalk(0.1, 1.0)]).is_none());
        let both = of(vec![crosstalk(0.003, 1.0), crosstalk(0.1, 0.2)]).unwrap();
        assert_eq!(both.on.list(), [crosstalk(0.003, 1.0), crosstalk(0.1, 1.0)]);
        assert_eq!(both.off.list(), [crosstalk(0.003, 1.0), crosstalk(0.0, 1.0)]);
        let two = of(vec![crosstalk(0.1, 0.5), crosstalk(0.1, 0.2)]).unwrap();
        assert_eq!(two.on.list(), [crosstalk(0.1, 1.0), crosstalk(0.1, 0.2)]);
    }
}
