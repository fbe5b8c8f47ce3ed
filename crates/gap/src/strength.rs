//! How strong an effect is, as information: lambda = 2 E\[log likelihood ratio\] of the truth against the best nominal
//! world, nuisances fitted in both. For a regular effect of strength theta that is theta^2 times its Fisher information.
//! The best possible test, which knows the effect, finds it with probability Phi(sqrt(lambda) - 2.33) at a false-alarm
//! rate of 1 %.

use locsim_core::{Draw, Stage};
use locsim_world::effect::Effect;
use locsim_world::simulation::BlockResampling;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, Normal};

use crate::hidden::Regime;
use crate::hypothesis::{Comparison, Nuisances};
use crate::null::{BlockTruth, Replay};
use crate::{GapError, Nominal, PoseError, Recorded};

/// Simulated logs behind an expectation.
const LOGS: u32 = 6;
/// Steps of the search for a strength.
const STEPS: u32 = 5;

fn nuisances(regime: &Regime) -> Nuisances {
    Nuisances { pose_error: regime.pose_error.unwrap_or(PoseError::NONE), ..Nuisances::default() }
}

/// lambda of an effect in logs along the recorded poses.
///
/// # Errors
/// As the simulator's.
pub fn information(
    nominal: &Nominal,
    recorded: &Recorded,
    effect: &Effect,
    regime: &Regime,
    seed: u64,
) -> Result<f64, GapError> {
    let resample =
        if regime.persistent_blocks { BlockResampling::Never } else { BlockResampling::EachObservation };
    let effects = std::slice::from_ref(effect);
    let replay = Replay {
        nominal,
        recorded,
        effects,
        nuisances: nuisances(regime),
        blocks: BlockTruth { resample, density_over_fit: 1.0 },
    };
    let draw = Draw::new(seed, Stage::Trial, 11);
    let ratios = (0..LOGS)
        .into_par_iter()
        .map(|i| {
            let simulated = replay.simulate(draw.seed(i))?;
            let comparison = Comparison::new(nominal, &simulated);
            let start = comparison.start(&nuisances(regime));
            let without = comparison.evaluate(&[], &start, 2)?.total();
            let with = comparison.evaluate(effects, &start, 2)?.total();
            Ok(2.0 * (with - without))
        })
        .collect::<Result<Vec<f64>, GapError>>()?;
    Ok(ratios.iter().sum::<f64>() / f64::from(LOGS))
}

/// The strength of an effect whose information is `lambda`: number `index` of `effect` is scaled about its neutral value.
///
/// # Errors
/// As the simulator's.
pub fn with_information(
    nominal: &Nominal,
    recorded: &Recorded,
    effect: &Effect,
    index: usize,
    lambda: f64,
    regime: &Regime,
    seed: u64,
) -> Result<Effect, GapError> {
    let parameter = &effect.kind.parameters()[index];
    let scaled = |factor: f64| -> Effect {
        let mut scaled = effect.clone();
        let away = factor * (effect.values[index] - parameter.neutral);
        scaled.values[index] = (parameter.neutral + away).clamp(parameter.lo, parameter.hi);
        scaled
    };
    let mut factor: f64 = 1.0;
    for _ in 0..STEPS {
        let now = information(nominal, recorded, &scaled(factor), regime, seed)?;
        // Somewhere between a shift, whose information is quadratic, and a rare event, whose is linear.
        let step = (lambda / now.max(0.02 * lambda)).powf(0.6).clamp(0.05, 8.0);
        factor *= step;
        if (step - 1.0).abs() < 0.05 {
            break;
        }
    }
    Ok(scaled(factor))
}

/// Power of the best test at a false-alarm rate.
pub fn oracle_power(lambda: f64, false_alarm: f64) -> f64 {
    let Ok(normal) = Normal::new(0.0, 1.0) else { return 0.0 };
    normal.cdf(lambda.max(0.0).sqrt() - normal.inverse_cdf(1.0 - false_alarm))
}
