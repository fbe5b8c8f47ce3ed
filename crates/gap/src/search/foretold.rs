//! Readings behind walls that random readings foretell.

use locsim_world::effect::{Effect, Effects};

use super::Round;
use super::selection::is_of_odometry;
use crate::GapError;
use crate::fit::Candidate;
use crate::hypothesis::{Comparison, Fitted};

/// A reading is behind a wall where it is this much longer than the range in the map \[m\].
const BEHIND_M: f64 = 0.2;
/// The log has at least this share of what an effect foretells,
const LEAST_SHARE: f64 = 0.5;
/// where it foretells so many standard deviations more than there would be without it.
const CLEAR: f64 = 3.0;
/// An effect of the readings that gains less than this share of what such a one gains, and less than so much (nats), is no explanation
/// instead of it.
const LEAST_GAIN_SHARE: f64 = 0.05;
const SMALL_GAIN_NATS: f64 = 25.0;

/// Drops effects that foretell random readings of which the log has those in front of walls alone: these are of things that stand or
/// walk there, and so is what else gains next to nothing beside them.
pub fn drop_unfounded(round: &Round<'_>, mut candidates: Vec<Candidate>) -> Result<Vec<Candidate>, GapError> {
    let is_there = |e: &Effect| has_what_it_foretells(&round.comparison, &round.fitted, &round.effects, e);
    let mut most = 0.0_f64;
    for i in (0..candidates.len()).rev() {
        if candidates[i].kind().is_of_random_readings() && !is_there(&candidates[i].effect)? {
            most = most.max(total(&candidates.remove(i)));
        }
    }
    let least = (LEAST_GAIN_SHARE * most).min(SMALL_GAIN_NATS);
    candidates.retain(|candidate| {
        is_of_odometry(candidate) || candidate.kind().loses_returns() || total(candidate) >= least
    });
    Ok(candidates)
}

fn total(candidate: &Candidate) -> f64 {
    candidate.fitted_gains.iter().sum()
}

/// Whether a log, fitted under the given effects, has the readings behind walls that another one foretells.
fn has_what_it_foretells(
    comparison: &Comparison<'_>,
    fitted: &Fitted,
    given: &[Effect],
    effect: &Effect,
) -> Result<bool, GapError> {
    let spread = effect.bursts().map_or_else(|| effect.clone(), |bursts| bursts.spread);
    let behind =
        |effects: &[Effect]| Ok::<_, GapError>(behind(comparison, fitted, &comparison.effects(effects)?));
    let [_, without] = behind(given)?;
    let [counted, with] = behind(&[given, &[spread]].concat())?;
    let foretold = with - without;
    Ok(foretold < CLEAR * with.sqrt() || counted - without >= LEAST_SHARE * foretold)
}

/// How many readings are behind walls: in the log, and to be expected.
fn behind(comparison: &Comparison<'_>, fitted: &Fitted, effects: &Effects) -> [f64; 2] {
    let max = comparison.nominal.laser.max_range_m;
    let last = max.next_down();
    let mut sums = [0.0; 2];
    comparison.for_each_reading(&comparison.views, effects, fitted, |_, i, density, shift, z, _| {
        let beam = &comparison.views.beams[i];
        let from = beam.range() + shift + BEHIND_M;
        if from < last {
            sums[0] += f64::from(u8::from(z > from && z < max));
            sums[1] += density.cdf(beam, shift, last) - density.cdf(beam, shift, from);
        }
    });
    sums
}

#[cfg(test)]
mod tests {
    use locsim_world::effect::EffectKind;

    use super::*;
    use crate::Recorded;
    use crate::fixtures::{NOMINAL, TRUTH};
    use crate::hidden::{Regime, record_library};
    use crate::hypothesis::Nuisances;

    /// Random readings of one beam in ten are there where they are hidden. Things that the map lacks, in front of walls, are no random readings,
    /// nor is nothing; of one beam in ten thousand nobody can tell.
    #[test]
    fn random_readings_are_behind_walls_as_well() {
        let effect = |kind, values: &[f64]| Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
        let random = |p: f64| effect(EffectKind::Crosstalk, &[p, 1.0]);
        let things = [[1.2, 3.2], [3.0, 2.2], [4.6, 3.4]]
            .map(|[x, y]| effect(EffectKind::MissingObject, &[x, y, 0.2]));
        for (hidden, p, is_there) in [
            (vec![random(0.1)], 0.1, true),
            (vec![random(0.1)], 0.3, false),
            (things.to_vec(), 0.05, false),
            (Vec::new(), 0.1, false),
            (Vec::new(), 1e-4, true),
        ] {
            let drive = record_library(&NOMINAL, &TRUTH, &hidden, Regime::default(), 3).unwrap();
            let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            let found = has_what_it_foretells(&comparison, &fitted, &[], &random(p)).unwrap();
            assert_eq!(found, is_there, "{p} of {hidden:?}");
        }
    }
}
