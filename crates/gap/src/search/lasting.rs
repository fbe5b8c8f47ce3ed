//! Errors of the odometry that last for a while, and those that are there all along.

use distreg::lasting::{QUANTILE_99, QUANTILE_975};
use locsim_core::normal::QUANTILE_975 as QUANTILE;

use super::Round;
use crate::GapError;
use crate::fit::Candidate;
use crate::statistics::odometry_errors;

/// Drops effects of the odometry that may have acted for a part of the drive, by wheels that err alike for many seconds. The others are no
/// surer than that.
pub fn drop_passing(round: &Round<'_>, mut candidates: Vec<Candidate>) -> Result<Vec<Candidate>, GapError> {
    let effects = round.comparison.effects(&round.effects)?;
    candidates.retain_mut(|candidate| {
        let errors = odometry_errors(candidate.kind(), &round.comparison, &effects, &round.fitted);
        candidate.score = errors.map(|errors| errors * QUANTILE / QUANTILE_975).or(candidate.score);
        errors.is_none_or(|errors| errors >= QUANTILE_99)
    });
    Ok(candidates)
}

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances};
    use locsim_core::{Draw, Pose2, Stage};
    use locsim_world::effect::{Effect, EffectKind};
    use rand::RngExt;

    use super::*;
    use crate::Recorded;

    /// Standard errors of unlike wheels, in a log with this effect, and with headings that err by up to `most` radians per metre for ten seconds
    /// on end.
    fn errors(effects: &[Effect], most: f64, seed: u64) -> f64 {
        let drive = record_library(&NOMINAL, &TRUTH, effects, Regime::default(), seed).unwrap();
        let mut recorded = Recorded::new(&drive, 400, 36, |_| true).unwrap();
        let draw = Draw::new(seed, Stage::Odometry, 0);
        let odometry = recorded.odometry.clone();
        for (i, pair) in odometry.windows(2).enumerate() {
            let step = pair[1].relative_to(&pair[0]);
            let drawn: f64 = draw.item((recorded.track.secs()[i] / 10.0) as u32).random();
            let turn = (2.0 * drawn - 1.0) * most * step.x.hypot(step.y);
            recorded.odometry[i + 1] =
                recorded.odometry[i].compose(&Pose2::new(step.x, step.y, step.theta + turn));
        }
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        odometry_errors(EffectKind::OdomImbalance, &comparison, &NOMINAL.effects, &fitted).unwrap()
    }

    #[test]
    fn wheels_that_err_for_a_while_are_told_from_unlike_ones() {
        let unlike = Effect::new(EffectKind::OdomImbalance, vec![0.1], Vec::new()).unwrap();
        assert!(errors(&[unlike], 0.0, 1) > QUANTILE_99);
        let passing = (1..=10).filter(|&seed| errors(&[], 0.3, seed) >= QUANTILE_99).count();
        // Of drives of four such stretches one in six has a mean that looks lasting; none of ten has a chance of .16, more than five one of .001.
        assert!(passing <= 5, "{passing}");
        let slip = EffectKind::WheelSlip;
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 1).unwrap();
        let recorded = Recorded::new(&drive, 100, 36, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.start(&Nuisances::default());
        assert_eq!(odometry_errors(slip, &comparison, &NOMINAL.effects, &fitted), None);
    }
}
