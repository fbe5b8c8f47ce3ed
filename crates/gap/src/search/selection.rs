//! Which effect is named, and which effects can't be told from it.

use std::collections::BTreeMap;

use locsim_core::{Estimate, differences, is_along_wall, quantile, sector_holds_middle, sum_error};
use locsim_world::effect::{self, Effect, EffectKind, Experiment, Moves};

use crate::GapError;
use crate::fit::Candidate;
use crate::outcome::{Evidence, Named, Number, Rival};
use crate::statistics::ROBOT_REACH_M;

/// Whether two effects are one that was fitted in two steps. The first fit of a strong effect may come out too weak.
pub fn adds_up(known: &Effect, more: &Effect) -> bool {
    known.kind == more.kind && known.place == more.place && known.kind.adds_up()
}

/// How far from the line of a stretch of wall another one is of the same wall \[m\].
const SAME_WALL_M: f64 = 0.3;

/// Whether two effects of one kind are of the same wall or the same sector. A wall that moved otherwise than the library says would
/// be moved again and again, and a thing of several ranges would be put before the laser piece by piece. The other wall of a corner ends on
/// this one, and is another.
pub fn is_one_cause(known: &Effect, more: &Effect) -> bool {
    let is_along = |stretch| more.place.iter().any(|other| is_along_wall(stretch, other, SAME_WALL_M));
    let is_of_same_wall = known.place.iter().any(is_along);
    let is_of_same_sector = known
        .sector()
        .zip(more.sector())
        .is_some_and(|(known, more)| sector_holds_middle(known, more) || sector_holds_middle(more, known));
    known.kind == more.kind && (is_of_same_wall || is_of_same_sector)
}

/// Standard errors by which a part of the robot gains, as it is there on all of the drive: one who passes by is so in a fold or two.
const ROBOT_ERRORS: f64 = 2.0;
/// Where a part of the robot gains so much on average over folds (nats), it gains this share of it on three of four of them: one who stands near
/// for half of the drive doesn't.
const CLEAR_NATS: f64 = 10.0;
const LEAST_QUARTILE: f64 = 0.25;

/// Whether readings of a sector may come from the robot itself: the floor ahead is farther.
pub fn may_be_of_robot(candidate: &Candidate) -> bool {
    let range_m = candidate.effect.sector().and_then(|_| candidate.effect.value("range_m"));
    let mean = candidate.gain() / candidate.gains.len() as f64;
    let is_often = mean < CLEAR_NATS || quantile(&mut candidate.gains.clone(), 0.25) > LEAST_QUARTILE * mean;
    let is_lasting = is_often && candidate.gain() > ROBOT_ERRORS * candidate.gain_error();
    range_m.is_none_or(|range_m| range_m <= ROBOT_REACH_M && is_lasting)
}

/// A drift that takes more drives than this to die away is none: over a drive it is a bias, or grows.
const MOST_DRIVES: f64 = 2.0;

/// Whether a drift dies away within a drive that took so long \[s\], or about.
pub fn dies_away(candidate: &Candidate, secs: f64) -> bool {
    candidate.effect.value("tau_secs").is_none_or(|tau| tau <= MOST_DRIVES * secs)
}

/// A tail is of no more than this share of the readings. What most of them have is their noise.
const MOST_IN_TAIL: f64 = 0.5;

/// Whether an effect gives some of the readings a tail.
pub fn is_tail(candidate: &Candidate) -> bool {
    candidate.kind().scores().any(|score| matches!(score, effect::Score::Tail))
}

/// Whether a candidate is no tail, or one of a minority of the readings.
pub fn is_of_few(candidate: &Candidate) -> bool {
    !is_tail(candidate) || candidate.effect.values[0] <= MOST_IN_TAIL
}

/// Two effects as one: strengths add up, and other parameters are those of the effect that is known.
pub fn sum_of(known: &Effect, more: &Effect) -> Result<Effect, GapError> {
    let parameters = known.kind.parameters();
    let mut values = known.values.clone();
    for i in known.kind.strengths() {
        let parameter = &parameters[i];
        values[i] = (known.values[i] + more.values[i] - parameter.neutral).clamp(parameter.lo, parameter.hi);
    }
    Ok(Effect::new(known.kind, values, known.place.clone())?)
}

/// The least gain of an effect that is named (nats): a likelihood ratio of 7.
pub const LEAST_GAIN_NATS: f64 = 2.0;

/// Whether a candidate surely gains: by more than a standard error, or by half of one where its own statistics are
/// significant. One standard error is little, because the replicates have already said that something is off; the gain of a
/// few rare events never exceeds its standard error by much. A noise is no rare event: what one stretch of the drive has, and no other, is something else.
pub fn is_sure(candidate: &Candidate) -> bool {
    let (gain, errors) = (candidate.gain(), if candidate.is_beyond_chance { 0.5 } else { 1.0 });
    let most = candidate.gains.iter().copied().fold(0.0, f64::max);
    let is_passing = candidate.kind().is_noise() && most > 0.5 * gain;
    gain > LEAST_GAIN_NATS && gain - errors * candidate.gain_error() > 0.0 && !is_passing
}

/// The candidate that is named, by index: of those that surely gain the one that gains most. One with fewer parameters is
/// preferred where it can't be told from that one, or is behind by what more parameters gain by chance.
///
/// Where most readings are off by the same cause, what replaces or spreads readings explains a part of each: it comes after the cause.
pub fn choose(candidates: &[Candidate]) -> Option<usize> {
    let has_cause = candidates.iter().any(|candidate| candidate.moves_most && is_sure(candidate));
    let comes_after = |candidate: &Candidate| has_cause && candidate.kind().moves() == Moves::Distribution;
    choose_among(candidates, |candidate| is_sure(candidate) && !comes_after(candidate))
}

/// The same of the candidates of other data than most readings: those in the odometry, or in lost returns. They need statistics of their own
/// that are significant: that something is off may be due to the readings.
pub fn choose_apart(candidates: &[Candidate], is_apart: fn(&Candidate) -> bool) -> Option<usize> {
    choose_among(candidates, |candidate| {
        is_apart(candidate) && candidate.is_beyond_chance && is_sure(candidate)
    })
}

/// Whether an effect loses returns, and gains by two standard errors: lost returns that have a name beside errors that have none aren't chance.
pub fn surely_loses_returns(candidate: &Candidate) -> bool {
    candidate.kind().loses_returns() && candidate.gain() > SURE_ERRORS * candidate.gain_error()
}

/// Standard errors of a gain whose interval doesn't hold 0: the two-sided 95 % quantile.
pub const SURE_ERRORS: f64 = 1.96;

fn choose_among(candidates: &[Candidate], may: impl Fn(&Candidate) -> bool) -> Option<usize> {
    let most = (0..candidates.len())
        .filter(|&i| may(&candidates[i]))
        .max_by(|&a, &b| candidates[a].gain().total_cmp(&candidates[b].gain()))?;
    let numbers = |i: usize| candidates[i].effect.values.len();
    let simpler = (0..candidates.len()).filter(|&i| i != most && may(&candidates[i])).filter(|&i| {
        let (behind, error) = behind(&candidates[most], &candidates[i]);
        let more = numbers(most).saturating_sub(numbers(i));
        more > 0 && behind < (BEHIND_ERRORS * error).max(BY_CHANCE * more as f64)
    });
    let gain = |i: usize| candidates[i].gain();
    simpler.min_by(|&a, &b| numbers(a).cmp(&numbers(b)).then(gain(b).total_cmp(&gain(a)))).or(Some(most))
}

/// The gain that each further parameter has to have (nats): half the 95 % quantile of chi squared with one degree of freedom,
/// which a parameter that isn't needed exceeds in 1 of 20 fits. The standard error says nothing where one effect becomes the
/// other, as wheels that always slip are a scale: their folds gain alike.
const BY_CHANCE: f64 = 1.92;

/// How much less a candidate gains than another, with the standard error over folds (nats).
fn behind(best: &Candidate, other: &Candidate) -> (f64, f64) {
    let difference = differences(&best.gains, &other.gains);
    (difference.iter().sum(), sum_error(&difference))
}

pub fn numbers(candidate: &Candidate) -> BTreeMap<&'static str, Number> {
    let effect = &candidate.effect;
    let parameters = effect.kind.parameters().iter().zip(&effect.values).zip(&candidate.intervals);
    parameters
        .map(|((parameter, &value), &interval)| {
            (parameter.name, Number { estimate: Estimate { value, interval }, unit: parameter.unit })
        })
        .collect()
}

/// One-sided 95 % quantile of the normal distribution: a rival has to gain as surely as that.
const RIVAL_ERRORS: f64 = 1.645;
/// A rival that is behind by fewer standard errors can't be told from the best: the one-sided 90 % quantile.
const BEHIND_ERRORS: f64 = 1.3;

/// The best candidate and the rivals that can't be told from it.
fn equivalent(candidates: &[Candidate], best: usize) -> Vec<EffectKind> {
    let mut set = vec![candidates[best].kind()];
    for (i, other) in candidates.iter().enumerate() {
        let (behind, error) = behind(&candidates[best], other);
        let sure = other.gain() - RIVAL_ERRORS * other.gain_error() > 0.0;
        let of_same_data = is_of_odometry(&candidates[best]) == is_of_odometry(other);
        let is_near = behind < BEHIND_ERRORS * error;
        // Beside lost returns, what surely gains more was refused for the errors of the others.
        let loses = |candidate: &Candidate| candidate.kind().loses_returns();
        let refused = behind < -BEHIND_ERRORS * error && loses(&candidates[best]) && !loses(other);
        if i != best && of_same_data && sure && is_near && !refused && !is_same(&candidates[best], other) {
            set.push(other.kind());
        }
    }
    set
}

/// Whether an effect is in the odometry: other data than the readings, so that the one can't stand for the other.
pub fn is_of_odometry(candidate: &Candidate) -> bool {
    candidate.kind().moves() == Moves::Odometry
}

/// Whether an effect with more parameters has become the best one: a drift that doesn't end is a bias, and a loss of returns
/// from any angle on is one at any range. Then both gain nearly the same on each fold.
fn is_same(best: &Candidate, other: &Candidate) -> bool {
    /// The largest standard error of the difference, as a share of that of the gain.
    const ALIKE: f64 = 0.25;
    let (behind, error) = behind(best, other);
    let more = other.effect.values.len() > best.effect.values.len();
    more && behind > -LEAST_GAIN_NATS && error < ALIKE * best.gain_error()
}

pub fn name(candidates: &[Candidate], best: usize, p: f64, scans: usize) -> Named {
    let candidate = &candidates[best];
    let set = equivalent(candidates, best);
    let gain_nats = Estimate::of_sum(&candidate.gains);
    Named {
        name: candidate.kind(),
        split_by: Experiment::telling_apart(&set),
        candidates: set,
        params: numbers(candidate),
        place: candidate.effect.place.iter().map(|stretch| stretch.map(|end| end.to_array())).collect(),
        evidence: Evidence {
            gain_nats,
            gain_nats_per_scan: gain_nats.value / scans as f64,
            score: candidate.score,
            p,
        },
        effect: candidate.effect.clone(),
        gains: candidate.fitted_gains.clone(),
    }
}

pub fn compare_rivals(candidates: &[Candidate], best: &Candidate, round: usize) -> Vec<Rival> {
    let mut rivals: Vec<Rival> = candidates
        .iter()
        .map(|candidate| {
            let (value, error) = behind(best, candidate);
            Rival {
                round,
                name: candidate.kind(),
                params: numbers(candidate),
                gain_nats: Estimate::of_sum(&candidate.gains),
                behind_nats: Estimate::normal(value, error),
            }
        })
        .collect();
    rivals.sort_by(|a, b| b.gain_nats.value.total_cmp(&a.gain_nats.value));
    rivals
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 60 nats on ten stretches, of which one has 9 or 40.
    #[test]
    fn a_noise_of_one_stretch_is_none() {
        let is_sure_of = |kind: EffectKind, best: f64| {
            let rest = (60.0 - best) / 9.0;
            let gains: Vec<f64> = std::iter::once(best).chain([rest; 9]).collect();
            is_sure(&Candidate {
                effect: Effect::typical(kind, Vec::new()),
                fitted_gains: gains.clone(),
                gains,
                intervals: Vec::new(),
                is_beyond_chance: true,
                moves_most: false,
                score: None,
            })
        };
        for noise in [EffectKind::RangeNoise, EffectKind::IncidenceNoise, EffectKind::HeavyTail] {
            assert!(is_sure_of(noise, 9.0) && !is_sure_of(noise, 40.0));
        }
        assert!(is_sure_of(EffectKind::WarmupDrift, 40.0));
    }

    /// A drift that dies away in 2000 s gains 8 nats more than a bias, with a standard error of 7: the bias has its name. Where it surely gains
    /// more, the drift has.
    #[test]
    fn of_two_that_can_t_be_told_apart_the_simpler_one_is_named() {
        let candidate = |kind, values: &[f64], gains: Vec<f64>| Candidate {
            effect: Effect::new(kind, values.to_vec(), Vec::new()).unwrap(),
            fitted_gains: gains.clone(),
            gains,
            intervals: Vec::new(),
            is_beyond_chance: true,
            moves_most: false,
            score: None,
        };
        let bias = candidate(EffectKind::RangeBias, &[0.02], vec![100.0; 4]);
        let drift = |more: [f64; 4]| {
            let gains = more.iter().map(|more| 100.0 + more).collect();
            candidate(EffectKind::WarmupDrift, &[0.02, 2000.0], gains)
        };
        let named = |more| {
            let candidates = [bias.clone(), drift(more)];
            candidates[choose(&candidates).unwrap()].kind()
        };
        assert_eq!(named([8.0, 0.0, 0.0, 0.0]), EffectKind::RangeBias);
        assert_eq!(named([8.0, 7.0, 9.0, 8.0]), EffectKind::WarmupDrift);
    }

    /// Random readings explain a part of anything. Where most readings are off by one cause, it comes first, if it surely gains.
    #[test]
    fn what_moves_most_readings_comes_before_what_replaces_them() {
        let candidate = |kind, gain: f64, moves_most| Candidate {
            effect: Effect::typical(kind, Vec::new()),
            fitted_gains: vec![gain; 4],
            gains: vec![gain; 4],
            intervals: Vec::new(),
            is_beyond_chance: true,
            moves_most,
            score: None,
        };
        let named = |late: f64, moves_most| {
            let candidates = [
                candidate(EffectKind::Crosstalk, 9000.0, false),
                candidate(EffectKind::TimeOffset, late, moves_most),
            ];
            candidates[choose(&candidates).unwrap()].kind()
        };
        assert_eq!(named(4000.0, true), EffectKind::TimeOffset);
        assert_eq!(named(4000.0, false), EffectKind::Crosstalk);
        assert_eq!(named(-1.0, true), EffectKind::Crosstalk);
    }

    /// A loss of returns is named beside a bias that was refused. The bias is no rival of it; a loss that gains nearly as much is.
    #[test]
    fn what_was_refused_is_no_rival_of_lost_returns() {
        let candidate = |kind, gains: [f64; 4]| Candidate {
            effect: Effect::typical(kind, Vec::new()),
            fitted_gains: gains.to_vec(),
            gains: gains.to_vec(),
            intervals: vec![locsim_core::Interval { lo: 0.0, hi: 1.0 }; 3],
            is_beyond_chance: true,
            moves_most: false,
            score: None,
        };
        let candidates = [
            candidate(EffectKind::IncidenceBias, [74.0, 75.0, 73.0, 75.0]),
            candidate(EffectKind::RangeDropout, [52.0, 53.0, 54.0, 53.0]),
            candidate(EffectKind::IncidenceDropout, [53.0, 51.0, 55.0, 52.0]),
        ];
        assert_eq!(
            (choose(&candidates), choose_apart(&candidates, surely_loses_returns)),
            (Some(0), Some(1))
        );
        // All of it on one fold of four: 79 nats, with a standard error of 80.
        let by_chance = [candidate(EffectKind::RangeDropout, [79.0, 5.0, -10.0, 5.0])];
        assert!(is_sure(&by_chance[0]) && choose_apart(&by_chance, surely_loses_returns).is_none());
        let losses = [EffectKind::RangeDropout, EffectKind::IncidenceDropout];
        assert_eq!(name(&candidates, 1, 0.01, 100).candidates, losses);
        assert_eq!(name(&candidates, 0, 0.01, 100).candidates, [EffectKind::IncidenceBias]);
    }

    /// A score is a linear approximation, and limits what counts for a choice. The log gains what it gains.
    #[test]
    fn a_name_has_the_gain_of_the_log_however_much_of_it_counted() {
        let mut candidate = Candidate {
            effect: Effect::typical(EffectKind::IncidenceBias, Vec::new()),
            gains: vec![30.0, 50.0],
            fitted_gains: vec![30.0, 50.0],
            intervals: vec![locsim_core::Interval { lo: 0.0, hi: 1.0 }; 3],
            is_beyond_chance: true,
            moves_most: false,
            score: Some(4.0),
        };
        candidate.limit(16.0);
        let mut named = name(&[candidate], 0, 0.01, 100);
        assert!((named.evidence.gain_nats.value - 16.0).abs() < 1e-9);
        named.count_all_gains(100);
        let Evidence { gain_nats, gain_nats_per_scan, .. } = named.evidence;
        assert!((gain_nats.value - 80.0).abs() < 1e-9 && (gain_nats_per_scan - 0.8).abs() < 1e-9);
    }

    /// Four folds of 3, 0, 0 and 3 nats: 6 with an error of sqrt(12).
    #[test]
    fn a_gain_is_surer_where_the_effect_s_own_statistic_is_significant() {
        let bias = Effect::new(EffectKind::RangeBias, vec![0.01], Vec::new()).unwrap();
        let candidate = |gains: Vec<f64>, is_beyond_chance| Candidate {
            effect: bias.clone(),
            fitted_gains: gains.clone(),
            gains,
            intervals: Vec::new(),
            is_beyond_chance,
            moves_most: false,
            score: None,
        };
        assert!((Estimate::of_sum(&[3.0, 0.0, 0.0, 3.0]).value - 6.0).abs() < 1e-12);
        assert!((sum_error(&[3.0, 0.0, 0.0, 3.0]) - 12.0_f64.sqrt()).abs() < 1e-12);
        assert!(is_sure(&candidate(vec![3.0, 0.0, 0.0, 3.0], false)));
        // 3 with an error of 3: only where the effect's own direction is off.
        assert!(!is_sure(&candidate(vec![3.0, 0.0, 0.0, 0.0], false)));
        assert!(is_sure(&candidate(vec![3.0, 0.0, 0.0, 0.0], true)));
        assert!(!is_sure(&candidate(vec![0.5; 4], true)));
    }

    /// Wheels that always slip are a scale, and gain a little more in each fold alike. A second parameter has to gain more than
    /// it does by chance.
    #[test]
    fn a_parameter_that_gains_as_by_chance_is_spared() {
        let candidate = |kind, values, gain: f64| Candidate {
            effect: Effect::new(kind, values, Vec::new()).unwrap(),
            gains: vec![gain / 10.0; 10],
            fitted_gains: vec![gain / 10.0; 10],
            intervals: Vec::new(),
            is_beyond_chance: true,
            moves_most: false,
            score: None,
        };
        let scale = candidate(EffectKind::OdomDistanceScale, vec![0.04], 20.0);
        let slip = |gain| candidate(EffectKind::WheelSlip, vec![0.9, 0.05], gain);
        assert_eq!(choose(&[slip(21.8), scale.clone()]), Some(1));
        assert_eq!(choose(&[slip(22.2), scale.clone()]), Some(0));
        // An effect with as many parameters is no simpler.
        let other = candidate(EffectKind::OdomTurnScale, vec![0.04], 21.0);
        assert_eq!(choose(&[scale, other]), Some(1));
    }

    /// A bias and a scale of the odometry gain alike, each by its own data; two biases gain alike by the same.
    #[test]
    fn readings_and_odometry_do_not_stand_for_each_other() {
        let candidate = |kind| Candidate {
            effect: Effect::typical(kind, Vec::new()),
            gains: vec![9.0, 10.0, 11.0],
            fitted_gains: vec![9.0, 10.0, 11.0],
            intervals: Vec::new(),
            is_beyond_chance: true,
            moves_most: false,
            score: None,
        };
        let [bias, scale, odometry] =
            [EffectKind::RangeBias, EffectKind::RangeScale, EffectKind::OdomDistanceScale].map(candidate);
        let mut shifted = scale;
        shifted.gains = vec![11.0, 10.0, 8.9];
        let set = equivalent(&[bias, shifted, odometry], 0);
        assert_eq!(set, [EffectKind::RangeBias, EffectKind::RangeScale]);
    }

    /// A drift of 90 s is one in a drive of a minute, and none in one of half a minute; a bias has no such time.
    #[test]
    fn a_drift_dies_away_within_two_drives() {
        let of = |kind, values| Candidate {
            effect: Effect::new(kind, values, Vec::new()).unwrap(),
            gains: Vec::new(),
            fitted_gains: Vec::new(),
            intervals: Vec::new(),
            is_beyond_chance: true,
            moves_most: false,
            score: None,
        };
        let drift = of(EffectKind::WarmupDrift, vec![0.03, 90.0]);
        assert!(dies_away(&drift, 60.0) && !dies_away(&drift, 30.0));
        assert!(dies_away(&of(EffectKind::RangeBias, vec![0.03]), 1.0));
    }

    /// A wall of 7 m, a piece of it, its continuation, and the wall that ends at its corner.
    #[test]
    fn the_other_wall_of_a_corner_is_another_cause() {
        let glass = |from: [f64; 2], to: [f64; 2]| {
            Effect::new(EffectKind::Glass, vec![0.4, 0.0], vec![[from.into(), to.into()]]).unwrap()
        };
        let known = glass([23.0, 18.0], [23.0, 11.0]);
        assert!(is_one_cause(&known, &glass([23.1, 14.0], [23.1, 15.0])));
        assert!(is_one_cause(&known, &glass([23.0, 11.5], [23.0, 3.0])));
        assert!(!is_one_cause(&known, &glass([23.0, 11.0], [30.0, 11.0])));
        assert!(!is_one_cause(&known, &glass([24.0, 18.0], [24.0, 11.0])));
        assert!(!is_one_cause(&known, &glass([23.0, 90.0], [23.0, 95.0])));
    }

    /// A piece of a sector is of the sector, across the back of the robot, too; the sector beside it isn't.
    #[test]
    fn sectors_of_one_thing_are_one_cause() {
        let sector = |from, to| {
            Effect::new(EffectKind::SectorOcclusion, vec![from, to, 0.3, 0.5], Vec::new()).unwrap()
        };
        let known = sector(2.8, -2.8);
        assert!(is_one_cause(&known, &sector(3.0, 3.1)) && is_one_cause(&sector(3.0, 3.1), &known));
        assert!(is_one_cause(&known, &sector(-3.1, -2.9)));
        assert!(!is_one_cause(&known, &sector(-2.8, -2.4)) && !is_one_cause(&known, &sector(0.0, 0.5)));
        let bias = Effect::new(EffectKind::RangeBias, vec![0.01], Vec::new()).unwrap();
        assert!(!is_one_cause(&bias, &bias));
        let at = |range_m| {
            let values = vec![-0.2, 0.4, range_m, 0.05];
            Effect::new(EffectKind::SectorOcclusion, values, Vec::new()).unwrap()
        };
        let of = |effect: &Effect, gains: &[f64]| {
            may_be_of_robot(&Candidate {
                effect: effect.clone(),
                gains: gains.to_vec(),
                fitted_gains: gains.to_vec(),
                intervals: Vec::new(),
                is_beyond_chance: true,
                moves_most: false,
                score: None,
            })
        };
        let (always, once) = ([9.0, 11.0, 10.0, 10.0], [40.0, 0.0, 0.0, 0.0]);
        assert!(of(&at(0.4), &always) && !of(&at(4.8), &always) && of(&bias, &always));
        assert!(!of(&at(0.4), &once) && of(&bias, &once));
        // Two fifths of a drive, and seven tenths, surely.
        for tenths in [4, 7] {
            let for_a_while: Vec<f64> =
                (0..20).map(|fold| if fold % 10 < tenths { 60.0 } else { 1.0 }).collect();
            assert!(!of(&at(0.4), &for_a_while), "{tenths}");
        }
        assert!(of(&at(0.4), &[24.0; 20]));
    }
}
