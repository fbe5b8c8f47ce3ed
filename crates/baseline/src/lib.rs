//! Today's log against yesterday's: what has changed since a baseline.
//!
//! The nominal simulator is learnt from the baseline: at each place of the map the distribution of the readings' errors, of
//! lost returns and of readings in front and behind, and the odometry's errors in proportion to the motion. Errors of the map
//! and of the simulator are in both logs, and cancel. An effect of the library then changes today's readings from what they are
//! expected to be; its strength is the change since the baseline.
//!
//! The null distribution is of permutations; that of effects at one place is of the other places. Both logs are cut into stretches, and the stretches are assigned anew to two
//! logs; each time the baseline is learnt and all effects are tried again. So a p-value knows how well the baseline is known,
//! how stretches differ from one another, and how many effects were tried. It supposes that stretches of one log are
//! exchangeable with those of the other where nothing changed.
//!
//! | step | code |
//! | --- | --- |
//! | readings of both logs at the places that both have seen | `pool` |
//! | the distribution of readings at each place | `learnt` |
//! | the odometry | `increments` |
//! | effects that are known already, and their places | `given` |
//! | effects with the readings that they change | `trials` |
//! | fits of an effect | `fitting` |
//! | effects at one place | `places` |
//! | permutations, and whether anything changed | `search` |
//! | names | `naming` |
//! | whether what an effect of all beams gains is of all places | `everywhere` |
//! | whether noise is that of beams, and not of whole scans | `neighbours` |
//! | returns that are lost at some bearings | `bearings` |
//! | numbers with their intervals | `precision` |
//! | how rare a gain is | `null` |

mod assignment;
mod bearings;
mod directions;
mod everywhere;
mod fitting;
mod given;
mod increments;
mod learnt;
mod naming;
mod neighbours;
mod null;
mod places;
mod pool;
mod precision;
mod random_readings;
mod search;
#[cfg(test)]
mod tests;
mod trials;

use locsim_gap::Named;
use locsim_world::effect::EffectKind;
use serde::Serialize;

pub use bearings::{LossAtBearings, LossesByBearing};
pub use search::find_changes;

/// How changes since a baseline are searched.
#[derive(Clone, Debug, PartialEq)]
pub struct BaselineOptions {
    /// Permutations behind a p-value.
    pub permutations: u32,
    /// Chance of finding a change where there is none; effects at one place have half of it on top.
    pub false_alarm: f64,
    /// The most effects that are named.
    pub most_effects: usize,
    /// Effects that are left out of the library.
    pub without: Vec<EffectKind>,
    /// Everything random derives from it.
    pub seed: u64,
}

impl Default for BaselineOptions {
    fn default() -> Self {
        Self { permutations: 399, false_alarm: 0.01, most_effects: 3, without: Vec::new(), seed: 0 }
    }
}

/// The result of a comparison with a baseline in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeVerdict {
    /// The log is as the baseline.
    None,
    /// Something changed, and effects of the library say what.
    Changed,
    /// Something changed, and no effect of the library surely explains it.
    Unexplained,
    /// The logs have too few places in common.
    Underpowered,
}

/// An effect that was tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Tried {
    /// Its kind.
    pub name: EffectKind,
    /// Log score that its best strength gains on today's log (nats).
    pub gain_nats: f64,
    /// How far that is above permutations', in their standard deviations.
    pub z: f64,
}

/// The changes since the baseline.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Changes {
    /// The verdict.
    pub verdict: ChangeVerdict,
    /// Effects that today's log has beyond the baseline, in the order in which they were named. Numbers are changes.
    pub effects: Vec<Named>,
    /// Returns that are lost at some bearings, where that explains more than any effect does.
    pub losses_by_bearing: Option<LossesByBearing>,
    /// The noise of every beam in the baseline and today \[m\], where it has grown, and more than in the form of an effect.
    pub noise_of_every_beam_m: Option<[f64; 2]>,
    /// By how much the odometry lags behind the reference in the baseline and today \[s\], where that has changed.
    pub odometry_lag_secs: Option<[f64; 2]>,
    /// Lower and upper corner \[m\] of the place where readings have changed most, where an effect of all beams would explain them there and is
    /// surely none elsewhere.
    pub place: Option<[f64; 4]>,
    /// Chance that two logs without a change look as different.
    pub p: f64,
    /// Permutations behind it.
    pub permutations: u32,
    /// All kinds of effects, the one that gains most first.
    pub tried: Vec<Tried>,
    /// Share of today's readings at places that the baseline has seen.
    pub shared: f64,
    /// Share of today's scans at places of the baseline that look the other way.
    pub reversed: f64,
    /// Wasserstein-1 distance of range errors between the baseline and today's log at the places that both have seen \[mm\]: as
    /// it is, with the named effects, and between permutations (median). Errors count as at most 1 m, and so do lost returns.
    pub w1_mm: [f64; 3],
    /// Scans of the baseline and of today's log.
    pub scans: [usize; 2],
    /// Beams per scan.
    pub beams: usize,
    /// Remarks for people.
    pub notes: Vec<String>,
    /// Everything random derives from it.
    pub seed: u64,
    /// Time it took \[s\]; the caller's clock.
    pub seconds: f64,
}
