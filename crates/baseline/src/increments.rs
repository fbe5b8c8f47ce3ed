//! The odometry of both logs: errors of its increments, beyond those that the baseline has.

use locsim_core::{Pose2, median};
use locsim_world::effect::{Axis, Effect, EffectKind, Moves, Statistic};
use locsim_world::simulation::{Increment, OdometryModel};

use super::assignment::{Assignment, variance_inflation};
use super::pool::Pool;
use super::trials::strengths;

/// Increments of both logs, with their stretches.
pub(super) struct Increments {
    all: Vec<(u32, Increment)>,
    /// Stretches of the baseline, and of both logs.
    stretches: [usize; 2],
}

/// How surely the odometry of one log errs in another way than that of the other.
pub(super) struct Contrast {
    /// In standard errors, signed.
    pub errors: f64,
    /// Its variance inflation by stretches that don't err independently.
    pub inflation: f64,
}

impl Increments {
    pub fn new(pool: &Pool<'_>) -> Self {
        let mut all = Vec::new();
        let every = strides([0, 1].map(|log| median_step(pool.logs[log].recorded.track.secs())));
        for (log, (cast, every)) in pool.logs.iter().zip(every).enumerate() {
            let recorded = cast.recorded;
            let thinned = |poses: &[Pose2]| poses.iter().copied().step_by(every).collect::<Vec<_>>();
            let (poses, odometry) = (thinned(recorded.track.poses()), thinned(&recorded.odometry));
            let own = Increment::all(&pool.nominal.effects, &poses, &odometry).into_iter().enumerate();
            all.extend(own.map(|(i, increment)| (pool.stretch(log, (i + 1) * every), increment)));
        }
        Self { all, stretches: pool.stretches }
    }

    /// The effects that are tried.
    pub fn trials() -> Vec<Effect> {
        let kinds = EffectKind::ALL.into_iter().filter(|kind| is_of_odometry(*kind));
        kinds
            .flat_map(|kind| {
                let shares = kind.description().statistics.iter().find_map(|statistic| match statistic {
                    Statistic::Slip { shares } => Some(*shares),
                    _ => None,
                });
                match shares {
                    Some(shares) => {
                        let values = shares.iter().flat_map(|&share| [0.05, 0.3].map(|p| vec![p, share]));
                        values.filter_map(|values| Effect::new(kind, values, Vec::new()).ok()).collect()
                    }
                    None => strengths(kind),
                }
            })
            .collect()
    }

    /// Learns from the stretches that `is_baseline` holds for.
    pub fn learn(&self, is_baseline: &[bool]) -> OdometryModel {
        let own = self.all.iter().filter(|(stretch, _)| is_baseline[*stretch as usize]);
        OdometryModel::learn(&own.map(|(_, increment)| *increment).collect::<Vec<_>>())
    }

    /// Gain of an effect beside the given ones on each stretch (nats).
    pub fn gains(
        &self,
        usual: &OdometryModel,
        given: &[Effect],
        effect: &Effect,
        is_used: &[bool],
    ) -> Vec<f64> {
        let mut gains = vec![0.0; self.stretches[1]];
        let without = Changed::of(given);
        let with = Changed::of(&[given, std::slice::from_ref(effect)].concat());
        for (stretch, increment) in &self.all {
            if is_used[*stretch as usize] {
                let rest = usual.without(increment);
                gains[*stretch as usize] +=
                    with.log_density(&rest, usual) - without.log_density(&rest, usual);
            }
        }
        gains
    }
}

/// Steps of two logs last equally long if their durations differ by no more than this share.
const AS_LONG: f64 = 0.1;
/// The most steps that are put together.
const MOST_STEPS: usize = 8;

/// How many steps of each of two logs to put together, by how long they last \[s\], so that they last equally long: the noise of an increment
/// doesn't grow with its distance as an effect does, and steps of another length seem to have another odometry.
fn strides(secs: [f64; 2]) -> [usize; 2] {
    let pairs = (2..=2 * MOST_STEPS).flat_map(|sum| (1..sum).map(move |first| [first, sum - first]));
    let unlike = |pair: &[usize; 2]| (pair[0] as f64 * secs[0] / (pair[1] as f64 * secs[1])).ln().abs();
    let mut known = pairs.filter(|pair| pair.iter().all(|&steps| steps <= MOST_STEPS));
    let alike = known.clone().find(|pair| unlike(pair) <= AS_LONG);
    let nearest = || known.by_ref().min_by(|a, b| unlike(a).total_cmp(&unlike(b)));
    alike.or_else(nearest).unwrap_or([1, 1])
}

/// The median time between scans \[s\].
fn median_step(secs: &[f64]) -> f64 {
    let mut steps: Vec<f64> = secs.windows(2).map(|pair| pair[1] - pair[0]).collect();
    median(&mut steps)
}

/// Errors beyond these standard deviations count as these: a reference that jumps tells nothing of the odometry.
const MOST_DEVIATIONS: f64 = 3.0;
/// The slip whose likelihood tells of slips: share of the increments, and standard deviation as a share of the distance.
const SLIP: [f64; 2] = [0.1, 0.3];

impl Increments {
    /// How surely the odometry errs in another way today, with its variance inflation: the mean by which
    /// an effect of the kind would err on each stretch, today's less the baseline's, in standard errors between stretches. A wheel that errs
    /// for many seconds on end errs alike on stretches that follow each other.
    pub fn contrast(
        &self,
        usual: &OdometryModel,
        given: &[Effect],
        kind: EffectKind,
        assignment: &Assignment,
    ) -> Contrast {
        // The given effects are today's.
        let [none, given] = [&[], given].map(Changed::of);
        let mut sums = vec![[0.0; 2]; self.stretches[1]];
        for (stretch, increment) in &self.all {
            let known = if assignment.is_today[*stretch as usize] { &given } else { &none };
            let [score, information] = known.score(&usual.without(increment), usual, kind);
            if score.is_finite() {
                let sum = &mut sums[*stretch as usize];
                sum[0] += score;
                sum[1] += information;
            }
        }
        // By how much each stretch moves the difference of the means, beyond its share of its log's.
        let mut moves = vec![0.0; sums.len()];
        let [today, baseline] =
            [(&assignment.is_today, 1.0), (&assignment.is_baseline, -1.0)].map(|(is_used, sign)| {
                let own = || (0..sums.len()).filter(|&stretch| is_used[stretch]);
                let n = f64::max(own().count() as f64, 2.0);
                let information: f64 = own().map(|stretch| sums[stretch][1]).sum::<f64>().max(1e-12);
                let mean = own().map(|stretch| sums[stretch][0]).sum::<f64>() / information;
                for stretch in own() {
                    let [score, part] = sums[stretch];
                    moves[stretch] = sign * (n / (n - 1.0)).sqrt() * (score - mean * part) / information;
                }
                mean
            });
        let variance: f64 = moves.iter().map(|by| by * by).sum();
        let (first, second) = moves.split_at(self.stretches[0]);
        let inflation = variance_inflation(&[first, second]);
        let deviation = (inflation * variance).sqrt().max(1e-12);
        Contrast { errors: (today - baseline) / deviation, inflation }
    }
}

/// Effects on increments.
struct Changed {
    distance: f64,
    turn: [f64; 2],
    slip: Option<[f64; 2]>,
}

impl Changed {
    fn of(effects: &[Effect]) -> Self {
        let mut changed = Self { distance: 0.0, turn: [0.0; 2], slip: None };
        for effect in effects {
            for statistic in effect.kind.description().statistics {
                match statistic {
                    Statistic::Odometry { error: Axis::Distance, .. } => changed.distance += effect.values[0],
                    Statistic::Odometry { error: Axis::Turn, motion: Axis::Turn } => {
                        changed.turn[0] += effect.values[0];
                    }
                    Statistic::Odometry { error: Axis::Turn, motion: Axis::Distance } => {
                        changed.turn[1] += effect.values[0];
                    }
                    Statistic::Slip { .. } => changed.slip = Some([effect.values[0], effect.values[1]]),
                    _ => {}
                }
            }
        }
        changed
    }

    /// Error of an increment along an effect of a kind, cut where it is an outlier, and how much the increment tells of it.
    fn score(&self, rest: &Increment, usual: &OdometryModel, kind: EffectKind) -> [f64; 2] {
        let rest = self.without(rest);
        let [d, t] = rest.truth;
        let mut sum = [0.0; 2];
        for statistic in kind.description().statistics {
            let (axis, slope) = match statistic {
                Statistic::Odometry { error: Axis::Distance, .. } => (0, d),
                Statistic::Odometry { error: Axis::Turn, motion: Axis::Turn } => (1, t),
                Statistic::Odometry { error: Axis::Turn, motion: Axis::Distance } => (1, d),
                Statistic::Slip { .. } => {
                    let [p, share] = SLIP;
                    let [ratio, mirrored] =
                        rest.slip_ratios(&usual.spread, share).map(|ratio| (p * ratio).max(-0.999).ln_1p());
                    sum[0] += ratio - mirrored;
                    sum[1] += 1.0;
                    continue;
                }
                _ => continue,
            };
            let sigma = rest.deviation(&usual.spread, axis);
            let error = (rest.error[axis] / sigma).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS);
            sum[0] += slope / sigma * error;
            sum[1] += (slope / sigma).powi(2);
        }
        sum
    }

    fn without(&self, rest: &Increment) -> Increment {
        let [d, t] = rest.truth;
        let error = [rest.error[0] - self.distance * d, rest.error[1] - self.turn[0] * t - self.turn[1] * d];
        Increment { error, ..*rest }
    }

    fn log_density(&self, rest: &Increment, usual: &OdometryModel) -> f64 {
        let increment = self.without(rest);
        let mut log: f64 = (0..2).map(|axis| increment.density(&usual.spread, axis).max(1e-300).ln()).sum();
        if let Some([p, share]) = self.slip {
            let [ratio, _] = increment.slip_ratios(&usual.spread, share);
            log += (p * ratio).max(-0.999).ln_1p();
        }
        log
    }
}

/// Whether a kind acts on the odometry alone.
pub(super) fn is_of_odometry(kind: EffectKind) -> bool {
    kind.moves() == Moves::Odometry
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_put_together_until_they_last_as_long() {
        for (secs, expected) in [
            ([0.1, 0.1], [1, 1]),
            ([0.1, 0.108], [1, 1]),
            ([0.3, 0.2], [2, 3]),
            ([0.1, 0.7], [7, 1]),
            ([2.3, 0.7], [1, 3]),
            // Out of reach: as near as can be.
            ([0.1, 5.0], [8, 1]),
        ] {
            assert_eq!(strides(secs), expected, "{secs:?}");
        }
    }
}
