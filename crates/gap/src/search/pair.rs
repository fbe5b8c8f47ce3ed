//! Two effects at once: neither alone explains what a curve over one covariate does, and both together explain more.

use locsim_core::{differences, gains_surely};

use super::selection::{choose, is_of_odometry, is_sure};
use super::stepwise::SCREENING_REPLICATES;
use super::{FAR_OFF, Round, State};
use crate::GapError;
use crate::fit::Candidate;
use crate::statistics::Covariate;

/// A curve that gains less (nats) may be of chance as well as of two effects.
const STRONG_NATS: f64 = 200.0;
/// The first of two effects gains at least this share of what the curve does.
const LEAST_SHARE: f64 = 0.3;

impl<'a> State<'a> {
    /// The effect, by index, that surely gains more than the best curve together with a second one. Neither is a noise, which explains a little of anything.
    pub fn first_of_two(
        &self,
        round: &Round<'a>,
        candidates: &[Candidate],
    ) -> Result<Option<usize>, GapError> {
        let judgement = self.judge(round)?;
        let dependences = judgement.dependences();
        let Some(leading) = dependences.iter().find(|found| found.covariate != Covariate::Odometry) else {
            return Ok(None);
        };
        let may = |candidate: &Candidate| {
            is_sure(candidate) && !candidate.kind().is_noise() && !is_of_odometry(candidate)
        };
        let least = STRONG_NATS.max(LEAST_SHARE * leading.gain());
        let mut firsts: Vec<usize> =
            (0..candidates.len()).filter(|&i| may(&candidates[i]) && candidates[i].gain() > least).collect();
        firsts.sort_by(|&a, &b| candidates[b].gain().total_cmp(&candidates[a].gain()));
        // The second best may be right where the best is of both.
        for &first in firsts.iter().take(2) {
            let one = &candidates[first];
            let effects = round.effects.iter().chain([&one.effect]).cloned().collect();
            let next = self.round(effects, round.fitted.nuisances, SCREENING_REPLICATES)?;
            let mut seconds = self.candidates(&next, self.options.fitted_kinds, FAR_OFF, &[])?;
            seconds.retain(|other| may(other) && other.kind() != one.kind());
            let Some(second) = choose(&seconds).map(|best| &seconds[best]) else { continue };
            // What the second adds to the first is what the curve is ahead of it, and more.
            let ahead = differences(&leading.gains, &one.fitted_gains);
            if gains_surely(&differences(&second.fitted_gains, &ahead)) {
                return Ok(Some(first));
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_world::effect::{Effect, EffectKind};

    use crate::{GapOptions, Recorded, find};

    /// A bias of every return and a part of the robot before some beams may be one curve over bearing. In this room each also gains enough by itself.
    #[test]
    fn a_bias_and_a_part_of_the_robot_are_two() {
        let bias = Effect::new(EffectKind::RangeBias, vec![0.025], Vec::new()).unwrap();
        let part = Effect::new(EffectKind::SectorOcclusion, vec![2.0, 2.4, 0.31, 0.85], Vec::new()).unwrap();
        let drive = record_library(&NOMINAL, &TRUTH, &[bias, part], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 99, seed: 5, ..GapOptions::default() };
        let outcome = find(&NOMINAL, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
        let mut names: Vec<EffectKind> = outcome.effects.iter().map(|named| named.name).collect();
        names.sort();
        assert_eq!(names, [EffectKind::RangeBias, EffectKind::SectorOcclusion], "{:?}", outcome.unnamed);
    }
}
