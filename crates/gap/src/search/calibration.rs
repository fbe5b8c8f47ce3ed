//! The shares of random and of missing readings that a scenario guesses, by the log.

use locsim_world::effect::{Effect, EffectKind};

use crate::hypothesis::Comparison;
use crate::{GapError, Nominal};

/// A return this far behind a wall is of no wall \[m\].
const BEHIND_M: f64 = 1.0;
/// Beams in each of the groups of which the one with the smallest share counts, at the least.
const FEWEST: f64 = 200.0;
/// Standard deviations of a count by which it may be too small by chance.
const ERRORS: f64 = 2.0;
/// Incidences that groups are of, in equal parts of a right angle, and ranges, in equal parts of the beams.
const INCIDENCES: usize = 3;
const RANGES: usize = 3;

/// The simulator with no larger a share of missing returns (`range_dropout` that doesn't depend on range) and of random readings
/// (`crosstalk` without bursts) than the log has where it has least. Every scenario has such shares, mostly as a guess, and no
/// effect makes them smaller.
pub fn with_shares_of_log(comparison: &Comparison<'_>) -> Result<Nominal, GapError> {
    let nominal = comparison.nominal;
    let max = nominal.laser.max_range_m;
    let mut ranges: Vec<f64> = Vec::new();
    let mut beams: Vec<[f64; 3]> = Vec::new();
    for (beam, &reading) in comparison.views.beams.iter().zip(&comparison.recorded.readings) {
        if !reading.is_nan() && beam.range() < max {
            ranges.push(beam.range());
            beams.push([beam.range(), beam.view.incidence, f64::from(reading)]);
        }
    }
    ranges.sort_by(f64::total_cmp);
    // Beams, missing returns, returns from far behind, and how many of these there were if all readings were random.
    let mut groups = [[0.0; 4]; INCIDENCES * RANGES];
    for [range, incidence, reading] in beams {
        let below = ranges.partition_point(|other| *other < range);
        let slant = (incidence / std::f64::consts::FRAC_PI_2 * INCIDENCES as f64) as usize;
        let group = &mut groups[slant.min(INCIDENCES - 1) * RANGES + below * RANGES / ranges.len()];
        let from = range + BEHIND_M;
        let more = [
            1.0,
            f64::from(u8::from(reading >= max)),
            f64::from(u8::from(reading > from && reading < max)),
            (1.0 - from / max).max(0.0),
        ];
        for (sum, more) in group.iter_mut().zip(more) {
            *sum += more;
        }
    }
    // The most that may be expected of where there are so many: of the smallest of several groups, and of none, too.
    let most = |count: f64| count + 1.0 + ERRORS * (count + 1.0).sqrt();
    let least = |count: usize, of: usize| {
        let large = groups.iter().filter(|group| group[of] >= FEWEST);
        large.map(|group| most(group[count]) / group[of]).fold(1.0, f64::min)
    };
    let (missing, random) = (least(1, 0), least(2, 3));
    let fitted = nominal.effects.list().iter().map(|effect| {
        let most = match (effect.kind, &effect.values[..]) {
            (EffectKind::RangeDropout, &[_, 0.0]) => missing,
            (EffectKind::Crosstalk, &[_, 1.0]) => random,
            _ => return Ok(effect.clone()),
        };
        let mut values = effect.values.clone();
        values[0] = values[0].min(most);
        Effect::new(effect.kind, values, effect.place.clone())
    });
    let list = fitted.collect::<Result<Vec<Effect>, _>>()?;
    Ok(nominal.with_effects(nominal.effects.replaced(list)?))
}
