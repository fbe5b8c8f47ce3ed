//! Data in which an effect is hidden, for the suite.
//!
//! A nominal drive is simulated, and then changed: its readings, when they were taken, its odometry, its reference
//! poses. Nothing here uses what [`locsim_world::effect`] makes of an effect:
//! - [`record_other`]: an effect of the library, in another form than the library's ([`OtherForm`]);
//! - [`record_outside`]: an effect that isn't in the library ([`Outside`]).
//!
//! At strength 0 each is the nominal drive, bit for bit.

mod beam;
mod odometry;
mod other;
mod outside;
#[cfg(test)]
mod tests;

use std::ops::Deref;

use glam::DVec2;
use locsim_core::{Draw, Drive, Stage, Track};
use locsim_gap::hidden::{HiddenDrive, Regime};
use locsim_gap::{GapError, Nominal};
use locsim_world::effect::Effect;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

pub use other::OtherForm;
pub use outside::Outside;

use beam::{Beam, Change, Sweep};

/// Item of a scan's draws that no beam uses: what all beams of the scan share.
const WHOLE_SCAN: u32 = u32::MAX;

/// A drive with `form` in it, whose strength is on the scale of the library's: `values` are those of the effect
/// [`OtherForm::kind`], SI units, `place` its stretches of wall, if it has a place.
///
/// # Errors
/// [`GapError::Comparison`] for values or a place that the library's effect doesn't take.
pub fn record_other(
    nominal: &Nominal,
    truth: &Track,
    form: OtherForm,
    values: &[f64],
    place: &[[DVec2; 2]],
    regime: Regime,
    seed: u64,
) -> Result<Drive, GapError> {
    Effect::new(form.kind(), values.to_vec(), place.to_vec())?;
    let hidden = Altered::new(nominal, truth, regime, seed)?;
    Ok(other::record(&hidden, form, values, place))
}

/// A drive with `kind` in it; what `strength` is, [`Outside`] says.
///
/// # Errors
/// [`GapError::Option`] for a strength that is negative or not finite.
pub fn record_outside(
    nominal: &Nominal,
    truth: &Track,
    kind: Outside,
    strength: f64,
    regime: Regime,
    seed: u64,
) -> Result<Drive, GapError> {
    if !(strength.is_finite() && strength >= 0.0) {
        return Err(GapError::Option { option: "strength", allowed: "finite, at least 0", value: strength });
    }
    let hidden = Altered::new(nominal, truth, regime, seed)?;
    Ok(outside::record(&hidden, kind, strength))
}

impl OtherForm {
    /// Logs with this form, for [`locsim_gap::Strength`].
    pub fn of_logs(
        self,
        nominal: &Nominal,
    ) -> impl Fn(&Track, &Effect, Regime, u64) -> Result<Drive, GapError> + Sync {
        move |truth, effect, regime, seed| {
            record_other(nominal, truth, self, &effect.values, &effect.place, regime, seed)
        }
    }
}

/// A drive that is about to be changed.
struct Altered<'a>(HiddenDrive<'a>);

impl<'a> Deref for Altered<'a> {
    type Target = HiddenDrive<'a>;

    fn deref(&self) -> &HiddenDrive<'a> {
        &self.0
    }
}

impl<'a> Altered<'a> {
    fn new(nominal: &'a Nominal, truth: &'a Track, regime: Regime, seed: u64) -> Result<Self, GapError> {
        Ok(Self(HiddenDrive::new(nominal, truth, &nominal.effects, regime, seed)?))
    }

    /// Random numbers of the hidden effect; item `beam` for a beam, [`WHOLE_SCAN`] for a scan. Under a seed of its
    /// own, so that it shares no draw with the simulator.
    fn chance(&self, scan: usize, item: u32) -> impl Rng + use<> {
        let own = Draw::new(self.seed, Stage::Effect, u32::MAX).seed(u32::MAX - 1);
        Draw::new(own, Stage::Effect, scan as u32).item(item)
    }

    fn normal(&self, scan: usize) -> f64 {
        StandardNormal.sample(&mut self.chance(scan, WHOLE_SCAN))
    }

    fn scans(&self) -> usize {
        self.truth.len()
    }

    /// Speed forward \[m/s\] from each scan to the next.
    fn speeds(&self) -> Vec<f64> {
        let steps = self.truth.poses().windows(2).zip(self.truth.secs().windows(2));
        steps
            .map(|(poses, secs)| {
                let step = poses[1].relative_to(&poses[0]).position();
                step.length().copysign(step.x) / (secs[1] - secs[0])
            })
            .collect()
    }

    /// The nominal drive with every reading changed as `change` says of its beam.
    fn with_readings(&self, change: impl Fn(&Beam<'_>, &mut dyn Rng) -> Change + Sync) -> Drive {
        let mut readings = self.readings_along(self.truth);
        let beams = self.simulator.laser().laser().beam_count();
        readings.par_chunks_mut(beams).enumerate().for_each(|(scan, readings)| {
            let sweep = Sweep::new(self, scan);
            for (i, reading) in readings.iter_mut().enumerate() {
                let mut chance = self.chance(scan, i as u32);
                let beam = sweep.beam(i, *reading);
                *reading = match change(&beam, &mut chance) {
                    Change::None => *reading,
                    change => beam.read(change, &mut chance),
                };
            }
        });
        self.drive(&readings, self.odometry())
    }
}
