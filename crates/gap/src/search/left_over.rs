//! What a named effect leaves of its gain to others: they gain little beside it, and aren't there.

use locsim_core::Estimate;
use locsim_world::effect::{EffectKind, Moves};

use super::judgement::share_a_moment;
use super::selection::SURE_ERRORS;
use crate::fit::Candidate;
use crate::outcome::Named;

/// What a named effect may leave of its gain to others that change the same moment: losses at slanted walls left 1.4 %, where clutter lost
/// returns as well. Where its form is visibly off, that is far more.
const LEFT_SHARE: f64 = 0.03;
const LEFT_BY_FORM_SHARE: f64 = 0.25;
/// What it may leave to any other, as its likelihood is an approximation: integrals over ranges in steps, a scan at one pose. Beside 5,000 and
/// 7,000 nats of late or lost readings, clutter and tails that weren't there gained 5 and 6.
const LEFT_TO_ANY_SHARE: f64 = 2e-3;
/// What gains less than this share may be by chance, unless its interval doesn't hold 0.
pub const FAINT_SHARE: f64 = 0.05;

/// What an effect gains beside others (nats), and the standard error of that.
pub struct Gain {
    kind: EffectKind,
    nats: f64,
    error: f64,
}

impl Gain {
    pub fn of(candidate: &Candidate) -> Self {
        Self { kind: candidate.kind(), nats: candidate.gain(), error: candidate.gain_error() }
    }
}

/// Whether a named effect is what another one leaves.
pub fn is_left(named: &[Named], index: usize) -> bool {
    let Named { name, evidence, .. } = &named[index];
    let Estimate { value, interval } = evidence.gain_nats;
    let gain = Gain { kind: *name, nats: value, error: interval.half() / SURE_ERRORS };
    named.iter().enumerate().any(|(i, other)| i != index && is_left_by(other, &gain, false))
}

/// Whether an effect is what a named one leaves: it gains little beside it, for one that changes the same moment.
pub fn is_left_by(named: &Named, other: &Gain, is_of_another_form: bool) -> bool {
    let [a, b] = [named.name, other.kind].map(|kind| kind.moves() == Moves::Odometry);
    if a != b {
        return false;
    }
    // A formula that isn't quite right is off by a constant, too, and a mean that isn't spreads readings.
    let is_spread = is_of_another_form && named.name.is_bias() && other.kind.is_noise();
    let is_akin = other.kind.is_constant() || share_a_moment(named.name, other.kind);
    let share = match is_akin || is_spread {
        true if is_of_another_form => LEFT_BY_FORM_SHARE,
        true => LEFT_SHARE,
        false => LEFT_TO_ANY_SHARE,
    };
    let before = named.evidence.gain_nats.value;
    let is_faint = other.nats < (FAINT_SHARE * before).min(SURE_ERRORS * other.error);
    is_faint || other.nats < share * before
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use locsim_world::effect::Effect;

    use super::*;
    use crate::search::selection::name;

    /// Losses were named with 1,000 nats. Other losses have to gain 30, noise doesn't.
    #[test]
    fn what_gains_little_of_the_same_moment_is_left_by_its_form() {
        let candidate =
            |kind: EffectKind, gain: f64| Candidate::of_gain(Effect::typical(kind, Vec::new()), gain);
        let losses = name(&[candidate(EffectKind::IncidenceDropout, 1000.0)], 0, 0.01, 100);
        let is_left = |kind, gain, is_of_another_form| {
            is_left_by(&losses, &Gain::of(&candidate(kind, gain)), is_of_another_form)
        };
        assert!(is_left(EffectKind::RangeDropout, 29.0, false));
        assert!(!is_left(EffectKind::RangeDropout, 31.0, false));
        assert!(is_left(EffectKind::RangeDropout, 249.0, true));
        assert!(!is_left(EffectKind::RangeDropout, 251.0, true));
        assert!(!is_left(EffectKind::HeavyTail, 29.0, true));
        assert!(is_left(EffectKind::RangeBias, 249.0, true) && !is_left(EffectKind::RangeBias, 31.0, false));
        // A bias whose form is off spreads readings; noise beside one whose form is right is another cause.
        let bias = name(&[candidate(EffectKind::RangeScale, 1000.0)], 0, 0.01, 100);
        let is_spread = |gain, is_of_another_form| {
            is_left_by(&bias, &Gain::of(&candidate(EffectKind::RangeNoise, gain)), is_of_another_form)
        };
        assert!(is_spread(249.0, true) && !is_spread(251.0, true) && !is_spread(31.0, false));
        // Two thousandths may be the likelihood's own, but not of other data.
        assert!(is_left(EffectKind::HeavyTail, 1.9, false) && !is_left(EffectKind::HeavyTail, 2.1, false));
        assert!(!is_left(EffectKind::OdomTurnScale, 0.2, false));
        // A few bursts gain by less than two standard errors: 48 nats may be by chance beside 1,000, 60 are another matter.
        let bursts = |gain: f64| {
            let mut candidate = candidate(EffectKind::HeavyTail, gain);
            candidate.gains = vec![0.0; 10];
            candidate.gains[..2].fill(0.5 * gain);
            is_left_by(&losses, &Gain::of(&candidate), false)
        };
        assert!(bursts(48.0) && !bursts(60.0) && !is_left(EffectKind::HeavyTail, 48.0, false));
    }

    /// Deep clutter was named first, and then a wall that has moved, which gains a thousand times as much: what clutter gains beside it the wall
    /// leaves, whichever came first. Of two that gain much both stay.
    #[test]
    fn a_name_that_gains_next_to_nothing_beside_another_is_left_by_it() {
        let named = |kind: EffectKind, gain: f64| {
            let place = Vec::from_iter(kind.has_place().then_some([DVec2::ZERO, DVec2::X]));
            let candidate = Candidate::of_gain(Effect::typical(kind, place), gain);
            name(&[candidate], 0, 0.01, 100)
        };
        let of = |gain: f64| [named(EffectKind::BlockDepth, gain), named(EffectKind::MovedWall, 10_000.0)];
        let left = |named: &[Named]| [0, 1].map(|index| is_left(named, index));
        assert_eq!([left(&of(15.0)), left(&of(25.0))], [[true, false], [false, false]]);
        assert!(!is_left(&of(15.0)[..1], 0));
    }
}
