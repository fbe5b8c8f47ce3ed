//! Readings in front of walls and behind them, and lost ones, that an effect predicts.

use glam::DVec2;
use locsim_comparison::{Beam, BlockPolicy, Comparison, Fitted};

use super::Round;
use super::selection::is_of_odometry;
use crate::GapError;
use crate::fit::Candidate;
use crate::null::REFIT;
use locsim_world::effect::{Bursts, Effect, Effects, Fit, Moves};

/// A reading is behind a wall, or in front of it, where it differs by so much from the range in the map \[m\].
const OFF_M: f64 = 0.2;
/// A reading is random rather than of clutter or noise where the one is so much likelier, and on a surface within this and its noise \[m\].
const UNLIKELY: f64 = 50.0;
const ON_SURFACE_M: f64 = 0.01;
/// The log has at least this share of what an effect predicts,
const LEAST_SHARE: f64 = 0.5;
/// where it predicts so many standard deviations more than there would be without it.
const CLEAR: f64 = 3.0;
/// An effect of the readings that gains less than this share of what such a one gains, and less than so much (nats), is no explanation
/// instead of it.
const LEAST_GAIN_SHARE: f64 = 0.05;
const SMALL_GAIN_NATS: f64 = 25.0;
/// Clutter is of the same readings, and has to gain this share.
const LEAST_CLUTTER_SHARE: f64 = 0.5;
/// Random readings, clutter and losses are all around: beams are cut into so many parts by a covariate.
const PARTS: usize = 8;

/// Drops effects that predict readings which the log doesn't have. Random readings are behind walls as well, and all around: those in front
/// alone are of things that stand or walk there, those at some walls of a pane or a mirror, those on other surfaces of beams that met these, and so is
/// what else gains next to nothing beside them. Clutter is in front of walls all around. Returns that any beam loses are lost at all places, and by each beam of the laser.
pub fn drop_unfounded(round: &Round<'_>, mut candidates: Vec<Candidate>) -> Result<Vec<Candidate>, GapError> {
    let stands = round.blocks.policy.stands();
    let is_there =
        |e: &Effect| has_what_it_predicts(&round.comparison, &round.fitted, &round.effects, e, stands);
    let are_on_surfaces = || end_on_surfaces(&round.comparison, &round.fitted, &round.effects);
    // What a measured map has for walls may send nothing back at all.
    let is_exact = round.comparison.nominal.pieces.is_none();
    let mut most = 0.0_f64;
    for i in (0..candidates.len()).rev() {
        let kind = candidates[i].kind();
        if kind.is_of_random_readings() && (!is_there(&candidates[i].effect)? || are_on_surfaces()?) {
            most = most.max(total(&candidates.remove(i)));
        } else if is_exact && kind.loses_returns() && !is_there(&candidates[i].effect)? {
            candidates.remove(i);
        }
    }
    let least = (LEAST_GAIN_SHARE * most).min(SMALL_GAIN_NATS);
    candidates.retain(|candidate| {
        is_of_odometry(candidate) || candidate.kind().loses_returns() || total(candidate) >= least
    });
    // Clutter that stands, as the scenario has it, is no deeper for what comes and goes.
    let of_scenario = round.comparison.nominal.blocks.map(|blocks| BlockPolicy::of_scenario(&blocks));
    let are_others = of_scenario.is_some_and(|blocks| blocks.stands()) && !stands;
    for i in (0..candidates.len()).rev() {
        let is_enough = total(&candidates[i]) >= LEAST_CLUTTER_SHARE * most;
        let effect = &candidates[i].effect;
        let is_of_others = are_others && effect.kind.description().fit != Fit::Nuisance;
        if effect.kind.moves() == Moves::Clutter && (is_of_others || !is_enough || !is_there(effect)?) {
            candidates.remove(i);
        }
    }
    Ok(candidates)
}

fn total(candidate: &Candidate) -> f64 {
    candidate.fitted_gains.iter().sum()
}

/// Whether most readings that clutter and noise hardly explain end on surfaces of the map, or near their own. Random ones end there by chance alone. A beam that passes a
/// pillar by less than the map is wrong by meets the pillar.
fn end_on_surfaces(comparison: &Comparison<'_>, fitted: &Fitted, given: &[Effect]) -> Result<bool, GapError> {
    let effects = comparison.effects(given)?;
    let (views, laser) = (&comparison.views, &comparison.nominal.laser);
    let walls = comparison.nominal.map.geometry().segments();
    let mut on_surfaces = [0_usize; 2];
    comparison.for_each_reading(views, &effects, fitted, |_, i, _, shift, z, terms| {
        let beam = &views.beams[i];
        let is_random = terms.measure / laser.max_range_m > UNLIKELY * terms.density;
        if z >= laser.max_range_m || !is_random {
            return;
        }
        let (end, near) = (beam.view.point_at(z), ON_SURFACE_M + laser.sigma_m + laser.sigma_per_m * z);
        let is_of_own = (z - beam.range() - shift).abs() < OFF_M;
        let is_on_surface = is_of_own || walls.iter().any(|wall| distance_to(end, wall) < near);
        on_surfaces[usize::from(is_on_surface)] += 1;
    });
    Ok(on_surfaces[1] > on_surfaces[0])
}

/// The distance from a point to a segment \[m\].
fn distance_to(point: DVec2, [a, b]: &[DVec2; 2]) -> f64 {
    let along = *b - *a;
    let share = ((point - *a).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    point.distance(*a + share * along)
}

/// Whether a log, fitted under the given effects, has the readings that another one predicts: random ones behind walls, clutter in front of
/// them, and lost ones. What stands all the time makes many readings of few things, and is where these are.
fn has_what_it_predicts(
    comparison: &Comparison<'_>,
    fitted: &Fitted,
    given: &[Effect],
    effect: &Effect,
    stands: bool,
) -> Result<bool, GapError> {
    let bursts = effect.bursts();
    let are_seldom = bursts.as_ref().is_some_and(Bursts::are_seldom);
    let spread = bursts.map_or_else(|| effect.clone(), |bursts| bursts.spread);
    let side = match effect.kind {
        kind if kind.moves() == Moves::Clutter => Side::InFront,
        kind if kind.loses_returns() => Side::Lost,
        _ => Side::Behind,
    };
    let count = |effects: &[Effect]| {
        let effects = comparison.effects(effects)?;
        if side != Side::InFront {
            return Ok::<_, GapError>(Counts::new(comparison, fitted, &effects, side));
        }
        let comparison = comparison.in_world(&effects)?;
        let fitted = comparison.find_nuisances(&effects, &fitted.nuisances, REFIT);
        Ok(Counts::new(&comparison, &fitted, &effects, side))
    };
    let (without, with) = (count(given)?, count(&[given, &[spread]].concat())?);
    let has = |share: f64, [_, without]: [f64; 2], [counted, with]: [f64; 2]| {
        counted - without >= share * (with - without)
    };
    let is_clear = |[_, without]: [f64; 2], [_, with]: [f64; 2]| with - without > CLEAR * with.sqrt();
    let total =
        |counts: &Counts| counts.parts[RANGE].iter().fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    let [all_without, all_with] = [&without, &with].map(total);
    if is_clear(all_without, all_with) && !has(LEAST_SHARE, all_without, all_with) {
        return Ok(false);
    }
    // The least share of what is predicted that a part has, and the most of it that may be in parts which have less. Surfaces differ in what they
    // send back: one that sends back all is no exception.
    let [least, most_lacking] = if side == Side::Lost { [0.2, 0.5] } else { [LEAST_SHARE, 0.3] };
    let lacks = |by: usize| {
        let parts = without.parts[by].iter().zip(&with.parts[by]);
        if side == Side::Lost && by == RANGE {
            // How losses grow with range is a matter of form.
            return false;
        }
        let mut predicted = [0.0; 2];
        for (&without, &with) in parts.filter(|(without, with)| is_clear(**without, **with)) {
            predicted[usize::from(has(least, without, with))] += with[1] - without[1];
        }
        predicted[0] > most_lacking * (predicted[0] + predicted[1])
    };
    let is_of_few_things = side == Side::InFront && stands;
    Ok(are_seldom || is_of_few_things || !(0..COVARIATES).any(lacks))
}

#[derive(Clone, Copy, PartialEq)]
enum Side {
    InFront,
    Behind,
    Lost,
}

/// Range, the two coordinates of where a beam ends, the beam of the laser, and how far along a beam a reading in front is.
const COVARIATES: usize = 5;
const RANGE: usize = 0;
const BEAM: usize = 3;
const ALONG: usize = 4;

/// How many readings are on one side of walls, in the log and to be expected, in parts by each covariate. Lost ones are in a part for each beam
/// of the laser.
struct Counts {
    parts: [Vec<[f64; 2]>; COVARIATES],
}

impl Counts {
    fn new(comparison: &Comparison<'_>, fitted: &Fitted, effects: &Effects, side: Side) -> Self {
        let (views, max) = (&comparison.views, comparison.nominal.laser.max_range_m);
        let last = max.next_down();
        let of_beam = |i: usize, beam: &Beam| {
            let [x, y] = beam.view.endpoint.to_array();
            [beam.range(), x, y, (i % views.per_scan) as f64, 0.0]
        };
        let beams = views.beams.iter().enumerate();
        let edges: [Vec<f64>; COVARIATES] = std::array::from_fn(|by| {
            let mut values: Vec<f64> = beams.clone().map(|(i, beam)| of_beam(i, beam)[by]).collect();
            values.sort_by(f64::total_cmp);
            let parts = if side == Side::Lost && by == BEAM { views.per_scan } else { PARTS };
            (1..parts).map(|part| values[part * values.len() / parts]).collect()
        });
        let mut parts = edges.each_ref().map(|edges| vec![[0.0; 2]; edges.len() + 1]);
        comparison.for_each_reading(views, effects, fitted, |_, i, density, shift, z, _| {
            let beam = &views.beams[i];
            let [is_there, chance] = match side {
                Side::InFront => {
                    let to = ((beam.range() + shift).min(max) - OFF_M).max(0.0);
                    let below = |part: usize| density.cdf(beam, shift, to * part as f64 / PARTS as f64);
                    for (part, [is_there, chance]) in parts[ALONG].iter_mut().enumerate() {
                        *is_there += f64::from(u8::from(z < to && part == (PARTS as f64 * z / to) as usize));
                        *chance += below(part + 1) - below(part);
                    }
                    [f64::from(u8::from(z < to)), below(PARTS)]
                }
                Side::Lost => [f64::from(u8::from(z >= max)), 1.0 - density.cdf(beam, shift, last)],
                Side::Behind => {
                    let from = beam.range() + shift + OFF_M;
                    if from >= last {
                        return;
                    }
                    let chance = density.cdf(beam, shift, last) - density.cdf(beam, shift, from);
                    [f64::from(u8::from(z > from && z < max)), chance]
                }
            };
            for ((parts, edges), value) in parts[..ALONG].iter_mut().zip(&edges).zip(of_beam(i, beam)) {
                let part = &mut parts[edges.partition_point(|edge| *edge <= value)];
                part[0] += is_there;
                part[1] += chance;
            }
        });
        Self { parts }
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::Nuisances;
    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_world::effect::EffectKind;

    use super::*;
    use crate::Recorded;

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
            let found = has_what_it_predicts(&comparison, &fitted, &[], &random(p), false).unwrap();
            assert_eq!(found, is_there, "{p} of {hidden:?}");
        }
    }

    /// Clutter three times as deep is in front of walls all around. Readings 2 m ahead at a few bearings, as of a floor that is hit, aren't, nor are
    /// random ones behind one wall.
    #[test]
    fn clutter_and_random_readings_are_all_around() {
        let effect = |kind, values: &[f64]| Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
        let deep = effect(EffectKind::BlockDepth, &[3.0]);
        let floor = effect(EffectKind::SectorOcclusion, &[-0.3, 0.3, 2.0, 0.6]);
        let pane = Effect::new(
            EffectKind::Glass,
            vec![0.5, 0.0],
            vec![[DVec2::new(5.5, 4.0), DVec2::new(0.5, 4.0)]],
        )
        .unwrap();
        let random = effect(EffectKind::Crosstalk, &[0.1, 1.0]);
        for (hidden, predicted, is_there) in [
            (&deep, &deep, true),
            (&floor, &effect(EffectKind::BlockDepth, &[5.0]), false),
            (&random, &random, true),
            (&pane, &random, false),
        ] {
            let drive =
                record_library(&NOMINAL, &TRUTH, std::slice::from_ref(hidden), Regime::default(), 3).unwrap();
            let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            let found = has_what_it_predicts(&comparison, &fitted, &[], predicted, false).unwrap();
            assert_eq!(found, is_there, "{} of {}", predicted.kind, hidden.kind);
        }
    }

    /// Deeper clutter that stands is in front of some walls and not of others: it is a matter of where few things are. What comes and goes has to be
    /// all around.
    #[test]
    fn clutter_that_stands_is_where_it_is() {
        let deep = Effect::new(EffectKind::BlockDepth, vec![3.0], Vec::new()).unwrap();
        let regime = Regime { persistent_blocks: true, pose_error: None };
        let drive = record_library(&NOMINAL, &TRUTH, std::slice::from_ref(&deep), regime, 3).unwrap();
        let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let is_there = |stands: bool| has_what_it_predicts(&comparison, &fitted, &[], &deep, stands).unwrap();
        assert!(is_there(true) && !is_there(false));
    }

    /// Beams that pass a wall's end by a centimetre meet it. Random readings of one beam in fifty end there by chance alone.
    #[test]
    fn random_readings_end_on_no_surface() {
        let random = Effect::new(EffectKind::Crosstalk, vec![0.02, 1.0], Vec::new()).unwrap();
        let ends_on_surfaces = |hidden: &[Effect], at_ends: bool| {
            let drive = record_library(&NOMINAL, &TRUTH, hidden, Regime::default(), 3).unwrap();
            let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let walls = NOMINAL.map.geometry().segments();
            let at_end = |i: usize| {
                let view = &comparison.views.beams[i].view;
                walls.iter().flatten().find_map(|end| {
                    let along = view.range
                        - (view.endpoint - *end).dot(view.endpoint - view.point_at(0.0)) / view.range;
                    let is_met = along < view.range - 0.5 && view.point_at(along).distance(*end) < 0.01;
                    is_met.then_some(along as f32)
                })
            };
            let read = |(i, z): (usize, &f32)| at_end(i).filter(|_| at_ends).unwrap_or(*z);
            let readings: Vec<f32> = recorded.readings.iter().enumerate().map(read).collect();
            let ends = (0..readings.len()).filter(|&i| at_ends && at_end(i).is_some()).count();
            assert_eq!(ends > 10, at_ends, "{ends}");
            let recorded = recorded.with(readings, recorded.odometry.clone());
            let comparison = comparison.of(&recorded);
            let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
            end_on_surfaces(&comparison, &fitted, &[]).unwrap()
        };
        assert!(ends_on_surfaces(&[], true));
        assert!(!ends_on_surfaces(&[random], false));
        assert!(!ends_on_surfaces(&[], false));
    }
}
