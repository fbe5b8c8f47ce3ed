//! Data in which an effect is hidden, to try [`find`](crate::find) on: how else would one know that it finds one?
//!
//! A nominal drive is simulated, and then changed: its readings, when they were taken, its odometry, its reference
//! poses. Nothing here uses what [`locsim_world::effect`] makes of an effect, except [`record_library`], which asks for
//! just that:
//! - [`record_other`]: an effect of the library, in another form than the library's ([`OtherForm`]);
//! - [`record_outside`]: an effect that isn't in the library ([`Outside`]);
//! - [`record_library`]: effects of the library, in its own form.
//!
//! At strength 0 each is the nominal drive, bit for bit. Whoever looks for the effect is given the [`Drive`] alone.

mod beam;
mod odometry;
mod other;
mod outside;
#[cfg(test)]
mod tests;

use glam::DVec2;
use locsim_core::{Draw, Drive, DriveStep, Pose2, Scan, Stage, Track};
use locsim_world::effect::{Effect, Effects};
use locsim_world::simulation::{BlockResampling, Simulator, odometry_along};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

pub use other::OtherForm;
pub use outside::Outside;

use crate::nominal::BlockPolicy;
use crate::{GapError, Nominal, PoseError};
use beam::{Beam, Change, Sweep};

/// Item of a scan's draws that no beam uses: what all beams of the scan share.
const WHOLE_SCAN: u32 = u32::MAX;

/// Item of a scan's draws of the path for the error of its reference pose; the simulator's own items are below it.
const REFERENCE_ERROR: u32 = 2;

/// Conditions that make a log hard, whatever is hidden in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Regime {
    /// Whether unmapped blocks stay for the whole drive; otherwise as the nominal simulator has it.
    pub persistent_blocks: bool,
    /// Error of the reference poses that the log reports; `None` for exact ones.
    pub pose_error: Option<PoseError>,
}

impl Regime {
    /// An error that is common, of 1 cm and 0.003 rad, kept up for 2 s.
    pub const POSE_ERROR: PoseError = PoseError { sigma_m: 0.01, sigma_rad: 0.003, correlation_secs: 2.0 };

    pub(crate) fn simulator(self, nominal: &Nominal, effects: &Effects) -> Result<Simulator, GapError> {
        let resample = match nominal.blocks {
            Some(blocks) if !self.persistent_blocks => blocks.resample,
            _ => BlockResampling::Never,
        };
        nominal.simulator(effects, BlockPolicy { density: 1.0, resample })
    }
}

/// A drive with `form` in it, whose strength is on the scale of the library's: `values` are those of the effect
/// [`OtherForm::kind`], SI units, `place` its stretches of wall, if it has a place.
///
/// # Errors
/// [`GapError::Effect`] for values or a place that the library's effect doesn't take.
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
    let hidden = HiddenDrive::new(nominal, truth, &nominal.effects, regime, seed)?;
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
    let hidden = HiddenDrive::new(nominal, truth, &nominal.effects, regime, seed)?;
    Ok(outside::record(&hidden, kind, strength))
}

/// A drive with effects in the library's own form, all at once; without any, the nominal drive.
///
/// # Errors
/// [`GapError::Effect`] for effects that can't be together.
pub fn record_library(
    nominal: &Nominal,
    truth: &Track,
    effects: &[Effect],
    regime: Regime,
    seed: u64,
) -> Result<Drive, GapError> {
    let effects = nominal.effects_with(effects)?;
    let hidden = HiddenDrive::new(nominal, truth, &effects, regime, seed)?;
    Ok(hidden.drive(&hidden.readings_along(truth), hidden.odometry()))
}

/// A simulated drive along the true poses, before anything is hidden in its readings or its odometry.
struct HiddenDrive<'a> {
    nominal: &'a Nominal,
    /// Where the robot really was at each scan, `map_from_base`.
    truth: &'a Track,
    regime: Regime,
    seed: u64,
    simulator: Simulator,
}

impl<'a> HiddenDrive<'a> {
    fn new(
        nominal: &'a Nominal,
        truth: &'a Track,
        effects: &Effects,
        regime: Regime,
        seed: u64,
    ) -> Result<Self, GapError> {
        if truth.len() < 2 || truth.secs().windows(2).any(|pair| pair[0] == pair[1]) {
            return Err(GapError::Truth);
        }
        let simulator = regime.simulator(nominal, effects)?;
        Ok(Self { nominal, truth, regime, seed, simulator })
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

    /// Readings \[scan\]\[beam\] of a robot that followed `track`.
    fn readings_along(&self, track: &Track) -> Vec<f32> {
        self.simulator.scan_along(track, self.seed)
    }

    fn odometry(&self) -> Vec<Pose2> {
        odometry_along(self.truth.poses(), &self.nominal.odometry, self.simulator.effects(), self.seed)
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

    /// The log: readings, odometry and, as reference, the true poses with the regime's error.
    fn drive(&self, readings: &[f32], odometry: Vec<Pose2>) -> Drive {
        let laser = self.simulator.laser().laser().clone();
        let scans = readings.chunks(laser.beam_count());
        let steps = self.truth.secs().iter().zip(self.references()).zip(odometry).zip(scans);
        let steps = steps
            .map(|(((&stamp_secs, reference), odometry), ranges)| DriveStep {
                stamp_secs,
                odometry,
                reference: Some(reference),
                scan: Scan { ranges: ranges.to_vec() },
            })
            .collect();
        Drive { laser, steps }
    }

    /// The reference poses of the log: the true ones with the regime's error.
    fn references(&self) -> Vec<Pose2> {
        let process = self.regime.pose_error.unwrap_or(PoseError::NONE);
        process.perturb(self.truth, |scan| Draw::new(self.seed, Stage::Path, scan).item(REFERENCE_ERROR))
    }
}
