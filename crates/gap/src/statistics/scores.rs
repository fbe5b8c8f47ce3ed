//! Scores of effects that act on all beams, each beam with a weight of its own.

use locsim_world::effect::{self, Direction, EffectKind, Score, TAIL_FACTOR};

use super::contamination::detectable_share;
use super::readings::Reading;
use super::survey::Survey;
use super::{Family, Form, Group, Halves, Readings, Statistic};
use crate::catalogue::{shown_by, values_along};
use crate::likelihood::normal_density;

/// The scores of one effect: sums over all beams of a weight times the derivative of the reading's log density.
pub(super) struct Scores {
    kind: EffectKind,
    score: Score,
    directions: Vec<Weights>,
    /// Whether errors of the reference take the effect in. It is then looked for in those errors.
    is_pose_pattern: bool,
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
            let statistics = kind.description().statistics.iter();
            Self {
                kind,
                score: wanted,
                directions: directions.iter().map(weights).collect(),
                is_pose_pattern: statistics
                    .into_iter()
                    .any(|statistic| matches!(statistic, effect::Statistic::Pose { .. })),
            }
        })
    }

    /// Derivative of a reading's log density, of a contamination at a share of 0.
    fn derivative(&self, reading: &Reading<'_>, max: f64) -> f64 {
        let terms = &reading.terms;
        let t = terms.error / terms.sigma;
        let meets_surface = reading.beam.range() < max;
        match self.score {
            Score::Location if reading.is_return => terms.hit * terms.error / terms.sigma.powi(2),
            Score::Scale if reading.is_return => terms.hit * (t * t - 1.0),
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
