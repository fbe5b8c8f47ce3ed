//! Readings behind walls that random readings foretell.

use locsim_world::effect::{Effect, Effects, Score, Statistic};

use super::Round;
use super::selection::is_of_odometry;
use crate::GapError;
use crate::fit::Candidate;

/// A reading is behind a wall where it is this much longer than the range in the map \[m\].
const BEHIND_M: f64 = 0.2;
/// The log has at least this share of what an effect foretells,
const LEAST_SHARE: f64 = 0.5;
/// where it foretells so many standard deviations more than there would be without it.
const CLEAR: f64 = 3.0;

/// An effect that gains less than this share of what such a one gains is no explanation instead of it.
const LEAST_GAIN_SHARE: f64 = 0.05;

/// Drops effects that foretell random readings of which the log has those in front of walls alone: these are of things that stand or
/// walk there, and so is what else gains next to nothing beside them.
pub fn drop_unfounded(round: &Round<'_>, mut candidates: Vec<Candidate>) -> Result<Vec<Candidate>, GapError> {
    let mut most = 0.0_f64;
    for i in (0..candidates.len()).rev() {
        if is_random(&candidates[i].effect) && !has_what_it_foretells(round, &candidates[i].effect)? {
            most = most.max(total(&candidates.remove(i)));
        }
    }
    candidates.retain(|candidate| is_of_odometry(candidate) || total(candidate) >= LEAST_GAIN_SHARE * most);
    Ok(candidates)
}

fn total(candidate: &Candidate) -> f64 {
    candidate.fitted_gains.iter().sum()
}

fn is_random(effect: &Effect) -> bool {
    let statistics = effect.kind.description().statistics;
    statistics.iter().any(|statistic| matches!(statistic, Statistic::Score { score: Score::Uniform, .. }))
}

fn has_what_it_foretells(round: &Round<'_>, effect: &Effect) -> Result<bool, GapError> {
    let spread = effect.bursts().map_or_else(|| effect.clone(), |bursts| bursts.spread);
    let behind = |effects: &[Effect]| Ok::<_, GapError>(behind(round, &round.comparison.effects(effects)?));
    let [_, without] = behind(&round.effects)?;
    let [counted, with] = behind(&[&round.effects[..], &[spread]].concat())?;
    let foretold = with - without;
    Ok(foretold < CLEAR * with.sqrt() || counted - without >= LEAST_SHARE * foretold)
}

/// How many readings are behind walls: in the log, and to be expected.
fn behind(round: &Round<'_>, effects: &Effects) -> [f64; 2] {
    let comparison = &round.comparison;
    let max = comparison.nominal.laser.max_range_m;
    let last = max.next_down();
    let mut sums = [0.0; 2];
    comparison.for_each_reading(&comparison.views, effects, &round.fitted, |_, i, density, shift, z, _| {
        let beam = &comparison.views.beams[i];
        let from = beam.range() + shift + BEHIND_M;
        if from < last {
            sums[0] += f64::from(u8::from(z > from && z < max));
            sums[1] += density.cdf(beam, shift, last) - density.cdf(beam, shift, from);
        }
    });
    sums
}
