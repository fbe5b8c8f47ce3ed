//! Beams that a named effect of one place has to do with, and what a further name is worth without them.
//!
//! A thing in one place, a moved wall or a bumper in a sector, seldom has quite the form that the library gives it. What is left at its
//! ends looks like noise, lost returns or readings in between, and an effect of all beams would be named for it.

use std::f64::consts::TAU;

use glam::DVec2;
use locsim_comparison::Beam;
use locsim_core::{cell_at, differences, distance_to, most_of_four, sum_error};
use locsim_world::effect::{Disc, Effect, Effects, Moves};

use super::Round;
use super::selection::{LEAST_GAIN_NATS, adds_up};
use crate::GapError;
use crate::fit::Candidate;

/// Beams that end this near to an effect have to do with it \[m\], and those that pass its ends this near.
const NEAR_M: f64 = 0.5;
const PASSING_M: f64 = 0.25;
/// Beams this far beside a sector have to do with it \[rad\].
const BESIDE_RAD: f64 = 0.1;
/// A further name gains, without these beams, at least this share of what it gains with them, by the share of beams that are left.
const LEAST_SHARE: f64 = 0.5;

/// Whether a beam from `origin` to `end`, at a bearing, has to do with an effect of one place.
fn concerns(effect: &Effect, [origin, end]: [DVec2; 2], bearing: f64) -> bool {
    let at_wall = effect.place.iter().any(|stretch| {
        distance_to(stretch, end) <= NEAR_M
            || stretch.iter().any(|corner| distance_to(&[origin, end], *corner) <= PASSING_M)
    });
    let in_sector = effect.sector().is_some_and(|[from, to]| {
        let width = (to - from).rem_euclid(TAU) + 2.0 * BESIDE_RAD;
        (bearing - from + BESIDE_RAD).rem_euclid(TAU) <= width
    });
    at_wall || in_sector
}

/// Whether a beam has to do with a disc.
fn meets(disc: &Disc, ray: [DVec2; 2]) -> bool {
    distance_to(&ray, disc.center) <= disc.radius_m + PASSING_M
}

/// Drops candidates that don't surely gain without the beams that the named effects of one place have to do with. What adds up
/// with one of these stays, and what is in the odometry.
pub fn drop_surroundings(round: &Round<'_>, candidates: Vec<Candidate>) -> Result<Vec<Candidate>, GapError> {
    let own = Effects::new(round.effects.clone())?;
    let (views, recorded) = (&round.comparison.views, &*round.comparison.recorded);
    let mount = recorded.laser.base_from_laser();
    let lasers: Vec<DVec2> =
        recorded.track.poses().iter().map(|pose| pose.compose(&mount).position()).collect();
    let concerned = |(i, beam): (usize, &Beam)| {
        let ray = [lasers[i / views.per_scan], beam.view.endpoint];
        round.effects.iter().any(|effect| concerns(effect, ray, beam.view.bearing))
            || own.objects().iter().any(|disc| meets(disc, ray))
    };
    let ignored: Vec<bool> = views.beams.iter().enumerate().map(concerned).collect();
    if !ignored.contains(&true) {
        return Ok(candidates);
    }
    let left = ignored.iter().filter(|ignored| !**ignored).count() as f64 / ignored.len() as f64;
    let elsewhere = recorded.without(&ignored);
    let comparison = round.comparison.of(&elsewhere);
    let folds = recorded.folds;
    let without = folds.sums(&comparison.evaluate(&round.effects, &round.fitted, 1)?.scans);
    let gains_elsewhere = |candidate: &Candidate| -> Result<bool, GapError> {
        let is_part = round.effects.iter().any(|known| adds_up(known, &candidate.effect));
        if is_part || candidate.kind().moves() == Moves::Odometry {
            return Ok(true);
        }
        let mut effects = round.effects.clone();
        effects.push(candidate.effect.clone());
        let with = folds.sums(&comparison.evaluate(&effects, &round.fitted, 1)?.scans);
        let gains = differences(&with, &without);
        let (gain, all) = (gains.iter().sum::<f64>(), candidate.fitted_gains.iter().sum::<f64>());
        Ok(gain > LEAST_GAIN_NATS.max(sum_error(&gains)) && gain >= LEAST_SHARE * left * all)
    };
    kept(candidates, gains_elsewhere)
}

/// The candidates that are to be kept.
fn kept(
    candidates: Vec<Candidate>,
    keeps: impl Fn(&Candidate) -> Result<bool, GapError>,
) -> Result<Vec<Candidate>, GapError> {
    let checked = candidates.into_iter().map(|candidate| Ok(keeps(&candidate)?.then_some(candidate)));
    checked.filter_map(Result::transpose).collect()
}

/// Side of the squares of which two by two are a place \[m\].
const SQUARE_M: f64 = 0.5;
/// An effect that has more than this share of its gain at one place is of that place.
const OF_PLACE_SHARE: f64 = 0.5;

/// Drops effects of all beams that gain mostly by readings that end at one place: a door that was closed, or a thing that stands there.
pub fn drop_of_one_place(round: &Round<'_>, candidates: Vec<Candidate>) -> Result<Vec<Candidate>, GapError> {
    let (comparison, known) = (&round.comparison, &round.effects);
    // What each reading gains, and the square that it ends in.
    let logarithms = |more: &[Effect]| -> Result<Vec<(f64, [i32; 2])>, GapError> {
        let effects = comparison.effects(&[known.as_slice(), more].concat())?;
        let mut found = vec![(0.0, [0; 2]); comparison.views.beams.len()];
        let views = comparison.views_with(&effects)?;
        comparison.for_each_reading(&views, &effects, &round.fitted, |_, i, _, _, z, terms| {
            let view = &views.beams[i].view;
            let short = if z < comparison.nominal.laser.max_range_m { view.range - z } else { 0.0 };
            found[i] = (terms.density.ln(), cell_at(view.endpoint - short * view.direction, SQUARE_M));
        });
        Ok(found)
    };
    let without = logarithms(&[])?;
    let is_all_around = |candidate: &Candidate| -> Result<bool, GapError> {
        let effect = &candidate.effect;
        let is_of_beams = effect.kind.moves() == Moves::Distribution && effect.bursts().is_none();
        // Losses have a rule of their own: surfaces differ in what they send back.
        if !is_of_beams || effect.kind.has_place() || effect.sector().is_some() || effect.kind.loses_returns()
        {
            return Ok(true);
        }
        let with = logarithms(std::slice::from_ref(effect))?;
        let gains = with.iter().zip(&without).map(|((with, square), (without, _))| (*square, with - without));
        let [most, all] = most_of_four(gains);
        Ok(most <= OF_PLACE_SHARE * all)
    };
    kept(candidates, is_all_around)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances, fit_persistence};
    use locsim_world::effect::EffectKind;

    use super::*;
    use crate::Recorded;
    use crate::search::{GapOptions, State};

    /// A wall has moved, and is named without its last 40 cm. A tail that is worth something there alone is no name; a bias of all
    /// beams, which is hidden as well, is one.
    #[test]
    fn what_a_wall_leaves_at_its_end_is_no_name() {
        let wall = |to: f64| {
            let stretch = vec![[DVec2::new(to, 4.0), DVec2::new(5.5, 4.0)]];
            Effect::new(EffectKind::MovedWall, vec![-0.1, 0.0], stretch).unwrap()
        };
        let bias = Effect::new(EffectKind::RangeBias, vec![0.01], Vec::new()).unwrap();
        let tail = Effect::new(EffectKind::HeavyTail, vec![0.005], Vec::new()).unwrap();
        let hidden = [wall(0.5), bias.clone()];
        let drive = record_library(&NOMINAL, &TRUTH, &hidden, Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 19, seed: 5, ..GapOptions::default() };
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let blocks = fit_persistence(&comparison, &[], &fitted, options.seed).unwrap();
        let stop = AtomicBool::new(false);
        let (nominal, recorded) = (&NOMINAL, &recorded);
        let state =
            State { nominal, recorded, comparison, options: &options, progress: &(), stop: &stop, blocks };
        // Without and with the bias: a tail widens what a bias has shifted, too.
        for (given, candidate, is_kept) in
            [(vec![wall(0.9)], bias.clone(), true), (vec![wall(0.9), bias], tail, false)]
        {
            let round = state.round(given, fitted.nuisances, options.replicates).unwrap();
            let total = |more: &[Effect]| {
                let effects = [&round.effects[..], more].concat();
                round.comparison.evaluate(&effects, &round.fitted, 1).unwrap().total()
            };
            let gain = total(std::slice::from_ref(&candidate)) - total(&[]);
            assert!(gain > 5.0, "{}: {gain}", candidate.kind);
            let candidate = Candidate::of_gain(candidate, gain);
            assert_eq!(drop_surroundings(&round, vec![candidate]).unwrap().len(), usize::from(is_kept));
        }
    }

    /// 100 readings end 4.5 cm behind where they should, at one place or anywhere. A tail is a name in the latter case alone.
    #[test]
    fn what_is_off_at_one_place_is_no_name_of_all_beams() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 19, seed: 5, ..GapOptions::default() };
        let is_kept = |is_at: fn(usize, DVec2) -> bool| {
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let mut readings = recorded.readings.clone();
            let beams = comparison.views.beams.iter().enumerate();
            let off =
                beams.filter(|(i, beam)| beam.view.range > 1.0 && is_at(*i, beam.view.endpoint)).take(100);
            off.for_each(|(i, beam)| readings[i] = (beam.view.range + 0.045) as f32);
            let recorded = recorded.with(readings, recorded.odometry.clone());
            let comparison = comparison.of(&recorded);
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            let (nominal, recorded, stop) = (&NOMINAL, &recorded, AtomicBool::new(false));
            let blocks = fit_persistence(&comparison, &[], &fitted, options.seed).unwrap();
            let comparison = Comparison::new(nominal, recorded).unwrap();
            let state = State {
                nominal,
                recorded,
                comparison,
                options: &options,
                progress: &(),
                stop: &stop,
                blocks,
            };
            let round = state.round(Vec::new(), fitted.nuisances, options.replicates).unwrap();
            let tail = Effect::new(EffectKind::HeavyTail, vec![0.01], Vec::new()).unwrap();
            let candidate = Candidate::of_gain(tail, 10.0);
            !drop_of_one_place(&round, vec![candidate]).unwrap().is_empty()
        };
        assert!(!is_kept(|_, end| end.distance(DVec2::new(6.0, 3.0)) < 0.4));
        assert!(is_kept(|i, _| i % 200 == 7));
    }

    #[test]
    fn beams_at_a_wall_and_past_its_ends_have_to_do_with_it() {
        let stretch = [DVec2::new(0.0, 2.0), DVec2::new(4.0, 2.0)];
        let moved = Effect::new(EffectKind::MovedWall, vec![0.1, 0.0], vec![stretch]).unwrap();
        let from_origin = |x, y| concerns(&moved, [DVec2::ZERO, DVec2::new(x, y)], 0.0);
        assert!(from_origin(2.0, 2.0) && from_origin(2.0, 1.6) && from_origin(-0.3, 8.0));
        assert!(!from_origin(2.0, 1.4) && !from_origin(-3.0, 8.0) && !from_origin(-0.1, 1.0));
    }

    #[test]
    fn beams_beside_a_sector_have_to_do_with_it() {
        let sector = Effect::new(EffectKind::SectorOcclusion, vec![3.0, -3.0, 0.3, 0.5], Vec::new()).unwrap();
        let at = |bearing| concerns(&sector, [DVec2::ZERO, DVec2::X], bearing);
        assert!(at(3.1) && at(-3.1) && at(2.95) && at(-2.95));
        assert!(!at(2.8) && !at(0.0) && !at(-2.8));
    }

    #[test]
    fn a_disc_hides_what_is_behind_it() {
        let disc = Disc { center: DVec2::new(2.0, 0.0), radius_m: 0.3 };
        let meets = |x, y| meets(&disc, [DVec2::ZERO, DVec2::new(x, y)]);
        assert!(meets(5.0, 0.0) && meets(5.0, 1.0) && !meets(5.0, 2.0) && !meets(1.0, 0.0));
    }
}
