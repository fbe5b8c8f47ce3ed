//! What a scenario guesses of laser and clutter, by the log: noise, the shares of random and of missing readings, the density of clutter.

use locsim_comparison::{BlockPolicy, BlockTruth, Comparison, Fitted, Nuisances, Replay};
use locsim_core::normal::SIGMA_OVER_MAD;
use locsim_core::{median, sorted};
use locsim_world::effect::{Effect, EffectKind};
use locsim_world::simulation::BlockResampling;
use rayon::prelude::*;

use crate::{GapError, Guess, Nominal, Purpose};

/// A return this far behind a wall is of no wall \[m\].
const BEHIND_M: f64 = 1.0;
/// Beams in each of the groups of which the one with the smallest share counts, at the least.
const FEWEST: f64 = 200.0;
/// For noise they are at least this part of the readings: what few beams of a wall or two say of it is the fit of these walls.
const LEAST_PART: f64 = 0.05;
/// Standard deviations of a count by which it may be too small by chance.
const ERRORS: f64 = 2.0;
/// Incidences that groups are of, in equal parts of a right angle, and ranges, in equal parts of the beams.
const INCIDENCES: usize = 3;
const RANGES: usize = 3;
/// A return this near to a wall is of it \[m\].
const NEAR_M: f64 = 0.15;
/// A log whose fitted density of clutter is less than this share of the scenario's has none.
pub const HARDLY_ANY: f64 = 0.05;
/// Walls of a measured map are known no better than this \[m\].
const LEAST_M: f64 = 1e-3;
/// Simulated logs that say what noise fits leave.
const LOGS: u32 = 4;
/// Standard error of a standard deviation by the median, over it and times the root of the number of values.
const MEDIAN_ERROR: f64 = 1.17;

/// The simulator with no more noise, and no larger shares of missing and of random readings, than the log has where it has least, and
/// without clutter where the log has none. Every scenario has a guess of them, and no effect makes the laser's smaller.
pub fn as_in_log(
    comparison: &Comparison<'_>,
    fitted: &Fitted,
    seed: u64,
) -> Result<(Nominal, Vec<Guess>), GapError> {
    let scenario = comparison.nominal;
    let nominal = with_shares_of_log(comparison)?;
    let sigma_m = match noise_of_log(comparison, fitted).map(|noise_m| noise_m.max(LEAST_M)) {
        Some(least_m) => {
            let seeming_m =
                noise_of_simulated(comparison, &nominal.clone().with_noise(least_m), fitted, seed)?;
            (least_m * least_m / seeming_m).min(scenario.laser.sigma_m)
        }
        None => scenario.laser.sigma_m,
    };
    let blocks = scenario.blocks.map_or(0.0, |blocks| blocks.per_metre_of_wall);
    let is_bare = blocks > 0.0 && fitted.nuisances.block_density < HARDLY_ANY;
    let nominal = if is_bare { nominal.without_blocks()? } else { nominal }.with_noise(sigma_m);
    let shares = scenario.effects.list().iter().filter_map(|effect| {
        let own = nominal.effects.list().iter().find(|own| own.kind == effect.kind)?;
        Some(Guess { what: effect.kind.name(), scenario: effect.values[0], log: own.values[0] })
    });
    let noise = Guess { what: "laser.noise.sigma_m", scenario: scenario.laser.sigma_m, log: sigma_m };
    let clutter = Guess {
        what: "blocks.per_metre_of_wall",
        scenario: blocks,
        log: if is_bare { fitted.nuisances.block_density * blocks } else { blocks },
    };
    let guesses =
        [noise, clutter].into_iter().chain(shares).filter(|guess| guess.log < guess.scenario).collect();
    Ok((nominal, guesses))
}

/// The least noise of beams of one incidence and range, about where poses and walls fit best \[m\]; `None` of too few readings.
fn noise_of_log(comparison: &Comparison<'_>, fitted: &Fitted) -> Option<f64> {
    let (views, max) = (&comparison.views, comparison.nominal.laser.max_range_m);
    let mut errors: Vec<[f64; 3]> = Vec::new();
    comparison.for_each_reading(views, &comparison.nominal.effects, fitted, |_, i, _, shift, z, _| {
        let beam = &views.beams[i];
        let error = (z - beam.range() - shift).abs();
        if z < max && error < NEAR_M {
            errors.push([beam.range(), beam.view.incidence, error]);
        }
    });
    let fewest = FEWEST.max(LEAST_PART * errors.len() as f64);
    let ranges = sorted(errors.iter().map(|[range, ..]| *range));
    let mut groups: [Vec<f64>; INCIDENCES * RANGES] = std::array::from_fn(|_| Vec::new());
    for [range, incidence, error] in errors {
        groups[group_of(&ranges, range, incidence)].push(error);
    }
    let of_group = |errors: &mut Vec<f64>| {
        // By how much it may be too small by chance, the smallest of several.
        let chance = 1.0 + ERRORS * MEDIAN_ERROR / (errors.len() as f64).sqrt();
        SIGMA_OVER_MAD * median(errors) * chance
    };
    let large = groups.iter_mut().filter(|errors| errors.len() as f64 >= fewest);
    large.map(of_group).reduce(f64::min)
}

/// The least noise that simulated logs of a simulator seem to have \[m\] (mean): fits of poses and walls take some of it.
fn noise_of_simulated(
    comparison: &Comparison<'_>,
    nominal: &Nominal,
    fitted: &Fitted,
    seed: u64,
) -> Result<f64, GapError> {
    let comparison = Comparison { nominal, ..comparison.of(&comparison.recorded) };
    let replay = Replay::new(
        &comparison,
        &[],
        fitted,
        BlockTruth::of(BlockPolicy::of(BlockResampling::EachObservation)),
    );
    let draw = Purpose::Calibration.draw(seed);
    let of_log = |i: u32| {
        let log = replay.simulate(draw.seed(i))?;
        let other = comparison.of(&log);
        let noise_m = noise_of_log(&other, &other.fit_nuisances(&Nuisances::default(), 20));
        Ok(noise_m.unwrap_or(nominal.laser.sigma_m))
    };
    let found = (0..LOGS).into_par_iter().map(of_log).collect::<Result<Vec<f64>, GapError>>()?;
    Ok(found.iter().sum::<f64>() / f64::from(LOGS))
}

/// The group of a beam, of a log with these ranges in order.
fn group_of(ranges: &[f64], range: f64, incidence: f64) -> usize {
    let below = ranges.partition_point(|other| *other < range);
    let slant = (incidence / std::f64::consts::FRAC_PI_2 * INCIDENCES as f64) as usize;
    slant.min(INCIDENCES - 1) * RANGES + below * RANGES / ranges.len()
}

/// The simulator with no larger a share of missing returns (`range_dropout` that doesn't depend on range) and of random readings
/// (`crosstalk` without bursts) than the log has where it has least. Every scenario has such shares, mostly as a guess, and no
/// effect makes them smaller.
fn with_shares_of_log(comparison: &Comparison<'_>) -> Result<Nominal, GapError> {
    let nominal = comparison.nominal;
    let max = nominal.laser.max_range_m;
    let mut beams: Vec<[f64; 3]> = Vec::new();
    for (beam, &reading) in comparison.views.beams.iter().zip(&comparison.recorded.readings) {
        if !reading.is_nan() && beam.range() < max {
            beams.push([beam.range(), beam.view.incidence, f64::from(reading)]);
        }
    }
    let ranges = sorted(beams.iter().map(|[range, ..]| *range));
    // Beams, missing returns, returns from far behind, and how many of these there were if all readings were random.
    let mut groups = [[0.0; 4]; INCIDENCES * RANGES + 1];
    for [range, incidence, reading] in beams {
        let from = range + BEHIND_M;
        let more = [
            1.0,
            f64::from(u8::from(reading >= max)),
            f64::from(u8::from(reading > from && reading < max)),
            (1.0 - from / max).max(0.0),
        ];
        // The last group is of all beams.
        for group in [group_of(&ranges, range, incidence), INCIDENCES * RANGES] {
            groups[group].iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
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

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{MEASURED, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};

    use super::*;
    use crate::Recorded;

    /// Readings with 10 mm of noise: a scenario of 20 mm has as little in the search, one of 5 mm keeps what it has.
    #[test]
    fn a_scenario_has_no_more_noise_than_its_log() {
        assert_eq!(MEASURED.laser.sigma_m, 0.01);
        let drive = record_library(&MEASURED, &TRUTH, &[], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        for (guess, expected) in [(0.02, 0.01), (0.005, 0.005)] {
            let scenario = MEASURED.clone().with_noise(guess);
            let comparison = Comparison::new(&scenario, &recorded).unwrap();
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            let (found, guesses) = as_in_log(&comparison, &fitted, 5).unwrap();
            let sigma_m = found.laser.sigma_m;
            assert!((sigma_m - expected).abs() < 0.15 * expected, "{sigma_m} of {guess}");
            let told = guesses.iter().find(|told| told.what == "laser.noise.sigma_m");
            assert_eq!(told.map(|told| told.log), (guess > expected).then_some(sigma_m));
        }
    }

    /// A log without any clutter: a scenario that guesses some has none in the search. Where the log has clutter it stays.
    #[test]
    fn a_scenario_has_no_clutter_where_its_log_has_none() {
        let bare = MEASURED.without_blocks().unwrap();
        for (truth, is_bare) in [(&bare, true), (&*MEASURED, false)] {
            let drive = record_library(truth, &TRUTH, &[], Regime::default(), 3).unwrap();
            let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
            let comparison = Comparison::new(&MEASURED, &recorded).unwrap();
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            let (found, guesses) = as_in_log(&comparison, &fitted, 5).unwrap();
            let is_told = guesses.iter().any(|told| told.what == "blocks.per_metre_of_wall");
            assert_eq!((found.blocks.is_none(), is_told), (is_bare, is_bare), "{guesses:?}");
        }
    }
}
