//! How strong an effect is, as information: lambda = (E1\[S\] - E0\[S\])^2 / Var\[S\], where S is the log likelihood ratio
//! of the effect at its true strength against the best nominal world, nuisances fitted in both, and E1, E0 are over logs with
//! and without it.
//!
//! For independent readings and a regular effect of strength theta that is theta^2 times its Fisher information. Readings of
//! a log share blocks and errors of the reference, though: the variance is taken over whole simulated logs, not summed over
//! readings (Godambe's information instead of Fisher's), and a rare event counts by how often it happens, not by how
//! impossible it is without the effect. The best possible test, which knows the effect, finds it with probability
//! Phi(sqrt(lambda) - 2.33) at a false-alarm rate of 1 %.

use std::borrow::Cow;
use std::sync::Arc;

use distreg::moments::{Moments, mean_of_likelihood};
use locsim_core::{Draw, Drive, Track};
use locsim_world::effect::{Effect, Effects, Moves};
use locsim_world::simulation::OdometrySpread;
use rayon::prelude::*;

use crate::{GapError, Nominal, PoseError, Purpose, Recorded};
use locsim_comparison::hidden::Regime;
use locsim_comparison::{BlockTruth, CORRECTIONS, Comparison, Nuisances, Replay, Views};

/// An effect in another form than the library's: a drive along true poses with an effect of these values, under these conditions,
/// by a seed.
pub type OtherForm<'a> = dyn Fn(&Track, &Effect, Regime, u64) -> Result<Drive, GapError> + Sync + 'a;

/// Simulated logs with the effect behind an expectation, and as many without.
const LOGS: u32 = 16;
/// Simulated logs behind a least error: its own error is a seventh.
const LOGS_OF_BOUND: u32 = 24;
/// A likelihood is known at values this far from each other, and this many on either side of the true one (strength over
/// sqrt(lambda)). Rare events need the most: their number errs by up to sqrt(2) of that, and values that end too soon would make
/// the estimate surer than it can be.
const GRID: f64 = 0.75;
const GRID_STEPS: i32 = 6;
/// Steps of the search for a strength, with a few logs until it is near, and with all.
const STEPS: u32 = 4;
const FEW_LOGS: u32 = 6;
/// So near as a factor are few logs as good as all.
const NEAR: f64 = 1.6;
/// Whoever knows where to look sees a thread by a single reading; an object is no thinner than this.
const LEAST_RADIUS_M: f64 = 0.02;
/// The search ends at an information this close to what is asked for, as a factor. So many logs know it to a third.
const CLOSE: f64 = 1.2;

/// Simulated logs along recorded poses, to tell how strong effects are there.
pub struct Strength<'a> {
    nominal: &'a Nominal,
    recorded: &'a Recorded,
    regime: Regime,
    draw: Draw,
    views: Arc<Views>,
    /// Logs without an effect and their log likelihoods.
    nothing: Vec<(Recorded, f64)>,
}

impl<'a> Strength<'a> {
    /// Simulates logs without an effect.
    ///
    /// # Errors
    /// As the simulator's.
    pub fn new(
        nominal: &'a Nominal,
        recorded: &'a Recorded,
        regime: Regime,
        seed: u64,
    ) -> Result<Self, GapError> {
        let draw = Purpose::Strength.draw(seed);
        let views = Arc::new(Views::new(nominal, recorded, &nominal.effects)?);
        let mut strength = Self { nominal, recorded, regime, draw, views, nothing: Vec::new() };
        strength.nothing = (0..LOGS)
            .into_par_iter()
            .map(|i| {
                let log = strength.simulate(&[], LOGS + i)?;
                let total = strength.log_likelihood(&log, &nominal.effects, &strength.views);
                Ok((log, total))
            })
            .collect::<Result<_, GapError>>()?;
        Ok(strength)
    }

    fn nuisances(&self) -> Nuisances {
        Nuisances {
            pose_error: self.regime.pose_error.unwrap_or(PoseError::NONE),
            odometry_error: OdometrySpread { noise: self.nominal.odometry, ..OdometrySpread::default() },
            ..Nuisances::default()
        }
    }

    fn replay<'r>(&'r self, effects: &'r [Effect]) -> Replay<'r> {
        Replay {
            nominal: self.nominal,
            recorded: self.recorded,
            effects,
            nuisances: self.nuisances(),
            information: &[],
            known_offsets: Vec::new(),
            blocks: BlockTruth::of(self.regime.blocks(self.nominal)),
        }
    }

    fn simulate(&self, effects: &[Effect], number: u32) -> Result<Recorded, GapError> {
        Ok(self.replay(effects).simulate(self.draw.seed(number))?)
    }

    fn log_likelihood(&self, log: &Recorded, effects: &Effects, views: &Views) -> f64 {
        let comparison = Comparison {
            nominal: self.nominal,
            recorded: Cow::Borrowed(log),
            views: Arc::clone(&self.views),
        };
        let start = comparison.start(&self.nuisances());
        let iterations = if start.nuisances.pose_error.is_none() { 2 } else { CORRECTIONS };
        comparison.evaluate_views(views, effects, &start, iterations).total()
    }

    /// A simulated log with an effect in another form than the library's.
    fn simulate_other(
        &self,
        form: &OtherForm<'_>,
        effect: &Effect,
        number: u32,
    ) -> Result<Recorded, GapError> {
        let seed = self.draw.seed(number);
        let truth = self.replay(&[]).errors(seed).0;
        // The error of the reference is in the true poses already.
        let regime = Regime { pose_error: None, ..self.regime };
        let drive = form(&truth, effect, regime, seed)?;
        let readings = drive
            .steps
            .iter()
            .flat_map(|step| self.recorded.kept.iter().map(|&beam| step.scan.ranges[beam]))
            .collect();
        let odometry = drive.steps.iter().map(|step| step.odometry).collect();
        Ok(self.recorded.with(readings, odometry))
    }

    /// lambda of an effect; in another form than the library's, lambda in the direction of the library's, which is the
    /// information that a test has that takes the effect to be as the library says.
    ///
    /// # Errors
    /// As the simulator's.
    pub fn information(&self, effect: &Effect, form: Option<&OtherForm<'_>>) -> Result<f64, GapError> {
        self.information_by(effect, form, LOGS)
    }

    /// The same by `logs` logs with the effect and as many without.
    fn information_by(
        &self,
        effect: &Effect,
        form: Option<&OtherForm<'_>>,
        logs: u32,
    ) -> Result<f64, GapError> {
        let effects = &[evenly_spread(effect)];
        let all = self.nominal.effects_with(effects)?;
        let views = self.views.with(self.nominal, self.recorded, &all)?;
        let ratio = |log: &Recorded, without: f64| self.log_likelihood(log, &all, &views) - without;
        let with = (0..logs)
            .into_par_iter()
            .map(|i| {
                let log = match form {
                    Some(form) => self.simulate_other(form, &effects[0], i)?,
                    None => self.simulate(effects, i)?,
                };
                Ok(ratio(&log, self.log_likelihood(&log, &self.nominal.effects, &self.views)))
            })
            .collect::<Result<Vec<f64>, GapError>>()?;
        let nothing = self.nothing[..logs as usize].par_iter().map(|(log, without)| ratio(log, *without));
        let [with, without] = [with, nothing.collect()].map(|ratios| Moments::of(ratios.into_iter()));
        // Of an effect that is lost in rounding neither mean nor variance says anything.
        Ok((with.mean() - without.mean()).powi(2) / (0.5 * (with.variance() + without.variance())).max(1e-6))
    }

    /// The strength of an effect whose information is `lambda`: number `index` of `effect` is scaled about its neutral
    /// value. An object has at least a radius of 2 cm, and then more information.
    ///
    /// # Errors
    /// As the simulator's.
    pub fn with_information(
        &self,
        effect: &Effect,
        index: usize,
        form: Option<&OtherForm<'_>>,
        lambda: f64,
    ) -> Result<Effect, GapError> {
        let parameter = &effect.kind.parameters()[index];
        let scaled = |factor: f64| -> Effect {
            let mut scaled = effect.clone();
            let away = factor * (effect.values[index] - parameter.neutral);
            let least = if is_object(effect) { LEAST_RADIUS_M } else { parameter.lo };
            scaled.values[index] = (parameter.neutral + away).clamp(least, parameter.hi);
            scaled
        };
        // Secants in logarithms: information grows with a power of the strength, 1 for rare events, 2 for a shift.
        let (mut factor, mut power) = (1.0_f64, 1.6);
        let mut tried: Vec<(f64, f64)> = Vec::new();
        for (logs, close) in [(FEW_LOGS, NEAR), (LOGS, CLOSE)] {
            tried.clear();
            for _ in 0..STEPS {
                let stronger = scaled(factor);
                // At the edge of what is allowed nothing changes any more.
                if tried.last().is_some_and(|(before, _)| scaled(before.exp()) == stronger) {
                    break;
                }
                let now = self.information_by(&stronger, form, logs)?.max(1e-3 * lambda);
                let off = (lambda / now).ln();
                tried.push((factor.ln(), off));
                if let [.., (a, before), (b, now)] = tried[..]
                    && (a - b).abs() > 1e-9
                {
                    power = ((before - now) / (b - a)).clamp(0.7, 2.5);
                }
                let is_close = off.abs() < close.ln();
                if !is_close || logs < LOGS {
                    factor *= (off / power).exp().clamp(0.05, 8.0);
                }
                if is_close {
                    break;
                }
            }
        }
        let nearest = tried.iter().min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        Ok(scaled(nearest.map_or(1.0, |(factor, _)| factor.exp())))
    }

    /// The least error, root of the mean square, that an estimate of number `index` of an effect in the library's form can have,
    /// about what it is, of information `lambda`: that of the mean of the likelihood, which is the best estimate where nothing
    /// is known before (Pitman 1939), in simulated logs; other numbers known. Of a regular number it is the bound of Cramer and Rao. The
    /// likelihood is that of the search, in which beams that share a block count as if they didn't: where blocks stay, the
    /// error of the best likelihood may be less.
    ///
    /// Strength over sqrt(lambda) is that of a shift. Of rare events lambda says how surely they are told from nothing, and
    /// their number, which is chance, bounds how well their probability can be known: up to sqrt(2) of that. Beams that come
    /// over edges make a likelihood steep at places, and a bound by its curvature there far too small.
    /// `None` of an object, whose information is that of its least radius, and of what has no strength.
    ///
    /// # Errors
    /// As the simulator's.
    pub fn least_error(&self, effect: &Effect, index: usize, lambda: f64) -> Result<Option<f64>, GapError> {
        let parameter = &effect.kind.parameters()[index];
        let value = effect.values[index];
        let deviation = (value - parameter.neutral).abs() / lambda.sqrt();
        if is_object(effect) || deviation <= 0.0 {
            return Ok(None);
        }
        let variants = (-GRID_STEPS..=GRID_STEPS)
            .map(|step| GRID * f64::from(step) * deviation)
            .filter(|up| (parameter.lo..=parameter.hi).contains(&(value + up)))
            .map(|up| {
                let all = self.nominal.effects_with(&[stronger(effect, index, up)])?;
                let views = self.views.with(self.nominal, self.recorded, &all)?;
                Ok((up, all, views))
            })
            .collect::<Result<Vec<_>, GapError>>()?;
        let errors = (0..LOGS_OF_BOUND)
            .into_par_iter()
            .map(|i| {
                let log = self.simulate(&[stronger(effect, index, 0.0)], 2 * LOGS + i)?;
                let likelihoods: Vec<f64> =
                    variants.iter().map(|(_, all, views)| self.log_likelihood(&log, all, views)).collect();
                Ok(mean_of_likelihood(variants.iter().map(|(up, ..)| *up), &likelihoods))
            })
            .collect::<Result<Vec<f64>, GapError>>()?;
        let square = errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64;
        Ok(Some(square.sqrt()))
    }
}

/// Whether an effect is an object, whose strength is its radius.
fn is_object(effect: &Effect) -> bool {
    effect.kind.moves() == Moves::Objects
}

/// An effect with its strength `up` higher.
fn stronger(effect: &Effect, index: usize, up: f64) -> Effect {
    let mut other = effect.clone();
    other.values[index] += up;
    evenly_spread(&other)
}

/// An effect that comes in bursts as one that doesn't: how many bursts a log has is chance, and would count as noise.
fn evenly_spread(effect: &Effect) -> Effect {
    effect.bursts().map_or_else(|| effect.clone(), |bursts| bursts.spread)
}

#[cfg(test)]
mod tests {
    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::record_library;
    use locsim_world::effect::EffectKind;

    use super::*;

    /// A sweep and a late stamp move beams over edges, where the likelihood is steep: by its curvature there, the least errors would be
    /// 0.05 to 0.13 of a shift's. Fits of 24 logs with such effects err by 0.4 and 1.3 of it.
    #[test]
    fn edges_make_no_number_surer_than_it_is() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let strength = Strength::new(&NOMINAL, &recorded, Regime::default(), 9).unwrap();
        for (kind, value, expected) in
            [(EffectKind::MotionSkew, 1.37e-3, 0.62), (EffectKind::TimeOffset, 6.4e-4, 1.17)]
        {
            let effect = Effect::new(kind, vec![value], Vec::new()).unwrap();
            let lambda = strength.information(&effect, None).unwrap();
            let found = strength.least_error(&effect, 0, lambda).unwrap().unwrap();
            let of_a_shift = value / lambda.sqrt();
            let ratio = found / of_a_shift;
            let off = (ratio / expected - 1.0).abs();
            assert!(off < 0.1, "{kind}: {ratio} of a shift's at {lambda}, not {expected}");
        }
    }
}
