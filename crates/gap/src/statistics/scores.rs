//! Scores of effects that act on all beams, each beam with a weight of its own.

use locsim_comparison::{Comparison, normal_density, shown_by, surface_ranges, values_along};
use locsim_core::median;
use locsim_world::effect::{self, Direction, Effect, EffectKind, Moves, Score, TAIL_FACTOR};

use super::readings::Reading;
use super::survey::Survey;
use super::{Family, Form, Group, Halves, Readings, Start, Statistic};
use distreg::contamination::detectable_share;

/// The scores of one effect: sums over all beams of a weight times the derivative of the reading's log density.
pub(super) struct Scores {
    kind: EffectKind,
    score: Score,
    directions: Vec<Weights>,
    /// Whether errors of the reference take the effect in. It is then looked for in those errors.
    is_pose_pattern: bool,
    /// Whether it turns the laser.
    is_turn: bool,
}

/// A direction of an effect's values.
struct Weights {
    direction: Direction,
    /// Weight of each beam of the log.
    of_beams: Vec<f32>,
    /// Of a contamination the share at which the score is taken; else 0.
    share: f32,
}

impl Scores {
    /// Those of all effects that show in one of the scores.
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        let scores = [Score::Location, Score::Scale, Score::Tail, Score::NoReturn, Score::Uniform];
        scores.into_iter().flat_map(|score| Self::of(score, survey)).collect()
    }

    fn of(wanted: Score, survey: &Survey<'_>) -> impl Iterator<Item = Self> {
        let shown = shown_by(move |statistic| match statistic {
            effect::Statistic::Score { score, weight, directions } if *score == wanted => {
                Some((*weight, *directions))
            }
            _ => None,
        });
        shown.map(move |(kind, (weight, directions))| {
            let weights = |direction: &Direction| {
                let values = values_along(kind, direction);
                let of_beams: Vec<f32> =
                    (0..survey.beams()).map(|i| weight(&survey.beam_state(i), &values) as f32).collect();
                let beams = of_beams.iter().copied().map(f64::from).sum();
                let share = if is_contamination(wanted) { detectable_share(beams) as f32 } else { 0.0 };
                Weights { direction, of_beams, share }
            };
            let shows_in =
                |shown: fn(&effect::Statistic) -> bool| kind.description().statistics.iter().any(shown);
            Self {
                kind,
                score: wanted,
                directions: directions.iter().map(weights).collect(),
                is_pose_pattern: shows_in(|statistic| matches!(statistic, effect::Statistic::Pose { .. })),
                is_turn: shows_in(|statistic| matches!(statistic, effect::Statistic::Turn)),
            }
        })
    }

    /// The values of the effect by which most of a log's readings are moved, if it is one that moves readings.
    fn values_of_most(&self, log: &Readings<'_>) -> Option<Vec<f64>> {
        if self.score != Score::Location {
            return None;
        }
        let strengths: Vec<usize> = self.kind.strengths().collect();
        let &[strength] = &strengths[..] else { return self.strengths_of_most(log) };
        let moved = self.directions.iter().flat_map(|weights| {
            let turned = if self.is_turn { turned(log) } else { None };
            let cast = if self.kind.moves() == Moves::Scans { cast(log, self.kind, strength) } else { None };
            let all = [moved(log, &weights.of_beams), turned, cast].into_iter().flatten();
            all.map(|moved| (weights.direction, moved))
        });
        let (direction, [value, left]) = moved.min_by(|a, b| a.1[1].total_cmp(&b.1[1]))?;
        let mut values = values_along(self.kind, direction);
        values[strength] = self.kind.parameters()[strength].neutral + value;
        (left < LEFT).then_some(values)
    }

    /// The same of an effect of several strengths, each with a direction of its own: one after the other, each beside the others (coordinate
    /// descent of least absolute deviations).
    fn strengths_of_most(&self, log: &Readings<'_>) -> Option<Vec<f64>> {
        let returns =
            || log.all.iter().filter(|reading| reading.is_return && reading.terms.sigma.is_finite());
        let mut errors: Vec<f64> =
            returns().map(|reading| reading.terms.error / reading.terms.sigma).collect();
        let without = Errors::of(errors.iter().copied());
        let mut values = Effect::neutral(self.kind, Vec::new()).values;
        for _ in 0..DESCENTS {
            for Weights { direction, of_beams, .. } in &self.directions {
                let (parameter, unit) = direction.iter().copied().find(|(_, value)| *value != 0.0)?;
                let weights: Vec<f64> = returns()
                    .map(|reading| f64::from(of_beams[reading.index]) / reading.terms.sigma)
                    .collect();
                let by = least_absolute(&errors, &weights)?;
                errors.iter_mut().zip(&weights).for_each(|(error, weight)| *error -= by * weight);
                values[parameter] += by * unit.signum();
            }
        }
        (Errors::of(errors.into_iter()).left_of(&without) < LEFT).then_some(values)
    }

    /// Derivative of a reading's log density, of a contamination at a share of 0.
    fn derivative(&self, reading: &Reading<'_>, max: f64) -> f64 {
        let terms = &reading.terms;
        let t = terms.error / terms.sigma;
        let meets_surface = reading.beam.range() < max;
        match self.score {
            Score::Location if reading.is_return => terms.hit * terms.error / terms.sigma.powi(2),
            Score::Scale if reading.is_return => terms.hit * ((t * t).min(MOST_SQUARE) - 1.0),
            Score::NoReturn if meets_surface => {
                reading.contamination(f64::from(u8::from(!reading.is_return)))
            }
            Score::Tail if meets_surface && reading.is_return => {
                let is_near_surface = terms.sigma.is_finite();
                reading.contamination(if is_near_surface {
                    normal_density(t / TAIL_FACTOR) / (TAIL_FACTOR * terms.sigma)
                } else {
                    0.0
                })
            }
            Score::Uniform => {
                let uniform = if reading.is_return { 1.0 / max } else { 0.0 };
                terms.measure * uniform / terms.density - 1.0
            }
            Score::Location | Score::Scale | Score::NoReturn | Score::Tail => 0.0,
        }
    }
}

/// Whether a score is of readings that another density takes the place of.
fn is_contamination(score: Score) -> bool {
    match score {
        Score::Location | Score::Scale => false,
        Score::NoReturn | Score::Uniform | Score::Tail => true,
    }
}

/// A noise is in all readings: the square of an error counts up to this (variances). A few readings of five standard deviations, of clutter at
/// a wall or a pose that errs, are no noise, and in sums of squares they would be as much as thousands of others.
const MOST_SQUARE: f64 = 9.0;
/// Beams of less weight than this say nothing of a strength.
const LEAST_WEIGHT: f64 = 1e-6;
/// An effect moves readings by many standard deviations if with it their errors are this share of what they were.
const LEFT: f64 = 0.5;
/// The mean and the median of normal noise's absolute value (standard deviations).
const MEAN_NOISE: f64 = 0.80;
const MEDIAN_NOISE: f64 = 0.67;
/// A laser's noise is taken to be at least this \[m\].
const LEAST_SIGMA_M: f64 = 1e-3;
/// Errors count up to this many standard deviations.
const CUT: f64 = 100.0;
/// Most readings are far off if this many standard deviations are their median.
const FAR: f64 = 3.0;
/// Times that several strengths are fitted one after the other.
const DESCENTS: usize = 3;
/// Steps between the least and the largest strength.
const CASTS: u32 = 20;

/// The strength by which most returns are moved (least absolute deviations), and the share of their errors that it leaves. A score doesn't see
/// readings that are moved by many standard deviations.
fn moved(log: &Readings<'_>, of_beams: &[f32]) -> Option<[f64; 2]> {
    let returns =
        log.scans().flatten().filter(|reading| reading.is_return && reading.terms.sigma.is_finite());
    let (errors, weights): (Vec<f64>, Vec<f64>) = returns
        .map(|reading| {
            let sigma = reading.terms.sigma;
            (reading.terms.error / sigma, f64::from(of_beams[reading.index]) / sigma)
        })
        .unzip();
    let strength = least_absolute(&errors, &weights)?;
    let left = Errors::of(errors.iter().zip(&weights).map(|(error, weight)| error - strength * weight));
    Some([strength, left.left_of(&Errors::of(errors.iter().copied()))])
}

/// The strength with which errors are least in absolute value, each less its weight times the strength: a weighted median.
fn least_absolute(errors: &[f64], weights: &[f64]) -> Option<f64> {
    let weighted = errors.iter().zip(weights).filter(|(_, weight)| weight.abs() > LEAST_WEIGHT);
    let mut ratios: Vec<[f64; 2]> = weighted.map(|(error, weight)| [error / weight, weight.abs()]).collect();
    ratios.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let half = 0.5 * ratios.iter().map(|[_, weight]| weight).sum::<f64>();
    let mut sum = 0.0;
    let [strength, _] = ratios.into_iter().find(|[_, weight]| {
        sum += weight;
        sum >= half
    })?;
    Some(strength)
}

/// Errors of readings, in standard deviations of their noise.
struct Errors {
    count: usize,
    /// The sum of their absolute values, each up to [`CUT`].
    sum: f64,
    median: f64,
}

impl Errors {
    fn of(errors: impl Iterator<Item = f64>) -> Self {
        let mut errors: Vec<f64> = errors.map(|error| error.abs().min(CUT)).collect();
        Self { count: errors.len(), sum: errors.iter().sum(), median: median(&mut errors) }
    }

    /// What share of others they are: by the median or, where there is little clutter, by the mean. Below the noise nothing is told.
    fn left_of(&self, others: &Self) -> f64 {
        let ratio = |with: f64, without: f64, noise: f64| with.max(noise) / without.max(noise);
        let of_sums = ratio(self.sum, others.sum, MEAN_NOISE * self.count as f64);
        of_sums.min(ratio(self.median, others.median, MEDIAN_NOISE))
    }
}

/// The strength, of some over all that it may have, at which returns are nearest to where beams end that are cast anew, and the share of their
/// errors that it leaves. Scans that are moved far move their readings in no proportion.
fn cast(log: &Readings<'_>, kind: EffectKind, strength: usize) -> Option<[f64; 2]> {
    let returns = || log.scans().flatten().filter(|r| r.is_return && r.terms.sigma.is_finite());
    let without = Errors::of(returns().map(|reading| reading.terms.error / reading.terms.sigma));
    if without.median < FAR {
        return None;
    }
    let parameter = &kind.parameters()[strength];
    let Comparison { nominal, recorded, .. } = log.comparison;
    let left = |value: f64| {
        let mut effect = Effect::neutral(kind, Vec::new());
        effect.values[strength] = value;
        let effects = log.effects.replaced([log.effects.list(), &[effect]].concat()).ok()?;
        let ranges = surface_ranges(nominal, recorded, &effects);
        let moved = |reading: &Reading<'_>| {
            let max = log.max_range();
            ranges[reading.index].min(max) - reading.beam.range().min(max)
        };
        let errors = returns().map(|reading| (reading.terms.error - moved(reading)) / reading.terms.sigma);
        Some([value, Errors::of(errors).left_of(&without)])
    };
    let step = (parameter.hi - parameter.lo) / f64::from(CASTS);
    let values = (0..=CASTS).map(|i| parameter.lo + f64::from(i) * step);
    values.filter_map(left).min_by(|a, b| a[1].total_cmp(&b[1]))
}

/// The turn of the laser, by whole beams \[rad\], with which returns are nearest to the nominal ranges of the scan's other beams, and what it
/// leaves of their median distance.
fn turned(log: &Readings<'_>) -> Option<[f64; 2]> {
    let views = &log.comparison.views;
    let (count, bearings) = (views.per_scan, log.comparison.recorded.laser.bearings());
    if count < 3 || bearings.len() != count {
        return None;
    }
    let all = f64::from(bearings[count - 1] - bearings[0]);
    let step = all / (count as f64 - 1.0);
    let is_full = all.abs() + 1.5 * step.abs() > std::f64::consts::TAU;
    let least = log.comparison.nominal.laser.sigma_m.max(LEAST_SIGMA_M);
    // The median distance from the nominal ranges of the beams so many farther, over that from their own.
    let left = |by: isize| {
        let returns = log.scans().flatten().filter(|reading| reading.is_return);
        let distances = returns.filter_map(|reading| {
            let beam = (reading.index % count) as isize + by;
            let beam = if is_full { beam.rem_euclid(count as isize) } else { beam };
            let other = views.scan(reading.scan).get(usize::try_from(beam).ok()?)?;
            let [other, own] = [other, reading.beam].map(|beam| beam.range().min(log.max_range()));
            Some(((reading.z - other).abs(), (reading.z - own).abs()))
        });
        let (mut with, mut without): (Vec<f64>, Vec<f64>) = distances.unzip();
        median(&mut with).max(least) / median(&mut without).max(least)
    };
    let most = count as isize / 2;
    let (by, left) = (-most..=most).map(|by| (by, left(by))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    Some([by as f64 * step, left])
}

impl Family for Scores {
    fn statistics(&self) -> Vec<Statistic> {
        let group = if is_contamination(self.score) { Group::Shares } else { Group::Wide };
        let statistic = |weights: &Weights| {
            let statistic = Statistic::along(self.kind, weights.direction, group, Form::Score);
            if weights.share > 0.0 {
                statistic.with_one_reading(f64::from(weights.share).recip())
            } else {
                statistic
            }
        };
        self.directions.iter().map(statistic).collect()
    }

    fn moves_most(&self, log: &Readings<'_>) -> Option<(EffectKind, Start)> {
        let mut values = self.values_of_most(log)?;
        for (value, parameter) in values.iter_mut().zip(self.kind.parameters()) {
            *value = value.clamp(parameter.lo, parameter.hi);
        }
        Some((self.kind, Start { values, place: Vec::new() }))
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let mut sums = vec![[0.0; 2]; self.directions.len()];
        if self.is_pose_pattern && log.has_pose_errors {
            return sums;
        }
        let max = log.max_range();
        for readings in log.scans() {
            let half = readings[0].half;
            let derivatives: Vec<f32> =
                readings.iter().map(|reading| self.derivative(reading, max) as f32).collect();
            for (sum, Weights { of_beams, share, .. }) in sums.iter_mut().zip(&self.directions) {
                let weighted = readings.iter().zip(&derivatives).map(|(reading, derivative)| {
                    let ratio = derivative * of_beams[reading.index];
                    ratio / (1.0 + share * ratio)
                });
                sum[half] += f64::from(weighted.sum::<f32>());
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use locsim_comparison::Nuisances;
    use locsim_comparison::fixtures::{NOMINAL, SIGMA_M, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};

    use super::*;
    use crate::Recorded;
    use crate::statistics::pit_draw;

    /// Thirty readings that are four and a half deviations off are less of a noise than all readings that are 1.5 % noisier. By their squares they
    /// would be more.
    #[test]
    fn a_few_readings_are_no_noise() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.start(&Nuisances::default());
        let views = &comparison.views.beams;
        let score = |error: &dyn Fn(usize, f64) -> f64| {
            let moved = |(i, z): (usize, &f32)| {
                let (range, z) = (views[i].range(), f64::from(*z));
                let is_of_wall = range < 4.5 && (z - range).abs() < 3.0 * SIGMA_M;
                if is_of_wall { (range + error(i, z - range)) as f32 } else { z as f32 }
            };
            let readings = recorded.readings.iter().enumerate().map(moved).collect();
            let recorded = recorded.with(readings, recorded.odometry.clone());
            let comparison = comparison.of(&recorded);
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
            let scores = Scores::all(&Survey::new(&comparison));
            let noise = scores.iter().find(|scores| scores.kind == EffectKind::RangeNoise).unwrap();
            noise.measure(&log)[0].iter().sum::<f64>()
        };
        let as_it_is = score(&|_, error| error);
        let few = score(&|i, error| if i % 480 == 7 { 4.5 * SIGMA_M } else { error });
        let noisier = score(&|_, error| 1.015 * error);
        assert!(few > as_it_is && noisier > few, "{as_it_is} {few} {noisier}");
    }

    /// A laser that sits 30 cm ahead and 20 cm to the right of where it is said to be moves most readings, in two directions at once.
    #[test]
    fn a_laser_that_is_displaced_by_far_is_found() {
        let most = |values: [f64; 2]| {
            let displaced = Effect::new(EffectKind::MountOffset, values.to_vec(), Vec::new()).unwrap();
            let drive = record_library(&NOMINAL, &TRUTH, &[displaced], Regime::default(), 3).unwrap();
            let recorded = Recorded::new(&drive, 150, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let fitted = comparison.start(&Nuisances::default());
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
            let scores = Scores::all(&Survey::new(&comparison));
            let own = scores.iter().find(|scores| scores.kind == EffectKind::MountOffset).unwrap();
            own.moves_most(&log).map(|(_, start)| start.values)
        };
        let found = most([0.3, -0.2]).unwrap();
        assert!((found[0] - 0.3).abs() < 0.02 && (found[1] + 0.2).abs() < 0.02, "{found:?}");
        assert_eq!(most([0.0; 2]), None);
    }

    /// Stamps that are late by more than a third of a second are far from moving readings in proportion: beams are cast anew. Where nothing is off
    /// no effect moves most readings.
    #[test]
    fn stamps_that_are_late_by_far_are_found() {
        let most = |delay_secs: f64| {
            let late = Effect::new(EffectKind::TimeOffset, vec![delay_secs], Vec::new()).unwrap();
            let drive = record_library(&NOMINAL, &TRUTH, &[late], Regime::default(), 3).unwrap();
            let recorded = Recorded::new(&drive, 150, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let fitted = comparison.start(&Nuisances::default());
            let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
            let scores = Scores::all(&Survey::new(&comparison));
            let own = scores.iter().find(|scores| scores.kind == EffectKind::TimeOffset).unwrap();
            own.moves_most(&log).map(|(_, start)| start.values[0])
        };
        for delay_secs in [-0.4, 0.8] {
            let found = most(delay_secs).unwrap();
            assert!((found - delay_secs).abs() < 0.06, "{found} of {delay_secs}");
        }
        assert_eq!(most(0.0), None);
    }
}
