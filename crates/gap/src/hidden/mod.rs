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
use locsim_core::{Draw, Drive, DriveStep, Pose2, Scan, Stage, wrap_angle};
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

/// Where a robot really was, scan by scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    secs: Vec<f64>,
    poses: Vec<Pose2>,
}

impl Truth {
    /// The robot was at `poses[i]` (`map_from_base`) at `secs[i]`, when its scan `i` began.
    ///
    /// # Errors
    /// [`GapError::Truth`] for not as many times as poses, fewer than two, or times that don't increase.
    pub fn new(secs: Vec<f64>, poses: Vec<Pose2>) -> Result<Self, GapError> {
        let increasing = secs.windows(2).all(|pair| pair[0] < pair[1]);
        if secs.len() < 2 || secs.len() != poses.len() || !increasing {
            return Err(GapError::Truth { secs: secs.len(), poses: poses.len() });
        }
        Ok(Self { secs, poses })
    }

    /// Stamps and reference poses of a drive, as of one that [`simulate_drive`] gives.
    ///
    /// [`simulate_drive`]: locsim_world::simulation::simulate_drive
    ///
    /// # Errors
    /// As [`Truth::new`]; a scan without a reference pose is left out.
    pub fn of(drive: &Drive) -> Result<Self, GapError> {
        let known = drive.steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?)));
        let (secs, poses) = known.unzip();
        Self::new(secs, poses)
    }

    /// Time of each scan \[s\].
    pub fn secs(&self) -> &[f64] {
        &self.secs
    }

    /// `map_from_base` at each scan.
    pub fn poses(&self) -> &[Pose2] {
        &self.poses
    }

    /// The pose so many seconds after the first scan: straight and even between two scans, beyond the ends as next to
    /// them. At a scan it is that scan's pose, bit for bit.
    fn pose_at(&self, secs: f64) -> Pose2 {
        let since = |i: usize| self.secs[i] - self.secs[0];
        let last = self.secs.len() - 1;
        let i = self.secs.partition_point(|time| time - self.secs[0] <= secs).saturating_sub(1);
        let begin = i.min(last - 1);
        let share = (secs - since(i)) / (since(begin + 1) - since(begin));
        let (from, to, pose) = (&self.poses[begin], &self.poses[begin + 1], &self.poses[i]);
        let moved = share * (to.position() - from.position());
        Pose2::new(pose.x + moved.x, pose.y + moved.y, pose.theta + share * wrap_angle(to.theta - from.theta))
    }

    /// Speed forward \[m/s\] from each scan to the next.
    fn speeds(&self) -> Vec<f64> {
        let steps = self.poses.windows(2).zip(self.secs.windows(2));
        steps
            .map(|(poses, secs)| {
                let step = poses[1].relative_to(&poses[0]).position();
                step.length().copysign(step.x) / (secs[1] - secs[0])
            })
            .collect()
    }
}

/// What makes a log hard whatever is hidden in it.
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
    truth: &Truth,
    form: OtherForm,
    values: &[f64],
    place: &[[DVec2; 2]],
    regime: Regime,
    seed: u64,
) -> Result<Drive, GapError> {
    Effect::new(form.kind(), values.to_vec(), place.to_vec())?;
    let hidden = HiddenDrive::new(nominal, truth, regime, seed)?;
    Ok(other::record(&hidden, form, values, place))
}

/// A drive with `kind` in it; what `strength` is, [`Outside`] says.
///
/// # Errors
/// [`GapError::Option`] for a strength that is negative or not finite.
pub fn record_outside(
    nominal: &Nominal,
    truth: &Truth,
    kind: Outside,
    strength: f64,
    regime: Regime,
    seed: u64,
) -> Result<Drive, GapError> {
    if !(strength.is_finite() && strength >= 0.0) {
        return Err(GapError::Option { option: "strength", allowed: "finite, at least 0", value: strength });
    }
    let hidden = HiddenDrive::new(nominal, truth, regime, seed)?;
    Ok(outside::record(&hidden, kind, strength))
}

/// A drive with effects in the library's own form, all at once; without any, the nominal drive.
///
/// # Errors
/// [`GapError::Effect`] for effects that can't be together.
pub fn record_library(
    nominal: &Nominal,
    truth: &Truth,
    effects: &[Effect],
    regime: Regime,
    seed: u64,
) -> Result<Drive, GapError> {
    let effects = nominal.effects_with(effects)?;
    let simulator = regime.simulator(nominal, &effects)?;
    let hidden = HiddenDrive { nominal, truth, regime, seed, simulator };
    let readings = hidden.simulator.scan_along(&truth.secs, &truth.poses, seed);
    let odometry = odometry_along(&truth.poses, &nominal.odometry, &effects, seed);
    Ok(hidden.drive(&readings, odometry))
}

/// A drive in the making, that starts as the nominal simulator's.
struct HiddenDrive<'a> {
    nominal: &'a Nominal,
    truth: &'a Truth,
    regime: Regime,
    seed: u64,
    simulator: Simulator,
}

impl<'a> HiddenDrive<'a> {
    fn new(nominal: &'a Nominal, truth: &'a Truth, regime: Regime, seed: u64) -> Result<Self, GapError> {
        let simulator = regime.simulator(nominal, &nominal.effects)?;
        Ok(Self { nominal, truth, regime, seed, simulator })
    }

    /// What is left to chance by what is hidden; item `beam` for a beam, [`WHOLE_SCAN`] for a scan. Under a seed of its
    /// own, so that it shares no draw with the simulator.
    fn chance(&self, scan: usize, item: u32) -> impl Rng + use<> {
        let own = Draw::new(self.seed, Stage::Effect, u32::MAX).seed(u32::MAX - 1);
        Draw::new(own, Stage::Effect, scan as u32).item(item)
    }

    fn normal(&self, scan: usize) -> f64 {
        StandardNormal.sample(&mut self.chance(scan, WHOLE_SCAN))
    }

    fn scans(&self) -> usize {
        self.truth.poses.len()
    }

    /// Readings \[scan\]\[beam\] of a robot that was at `poses` instead of the true ones.
    fn readings_at(&self, poses: &[Pose2]) -> Vec<f32> {
        self.simulator.scan_along(&self.truth.secs, poses, self.seed)
    }

    fn odometry(&self) -> Vec<Pose2> {
        odometry_along(&self.truth.poses, &self.nominal.odometry, &self.nominal.effects, self.seed)
    }

    /// The nominal drive with every reading changed as `change` says of its beam.
    fn with_readings(&self, change: impl Fn(&Beam<'_>, &mut dyn Rng) -> Change + Sync) -> Drive {
        let mut readings = self.readings_at(&self.truth.poses);
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
        let steps = self.truth.secs.iter().zip(self.references()).zip(odometry).zip(scans);
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

    /// The true poses, each with an error that follows a first-order autoregressive process.
    fn references(&self) -> Vec<Pose2> {
        let Truth { secs, poses } = self.truth;
        let Some(process) = self.regime.pose_error.filter(|process| !process.is_none()) else {
            return poses.clone();
        };
        let mut error = [0.0; 3];
        let sigma = [process.sigma_m, process.sigma_m, process.sigma_rad];
        let reference = |(i, pose): (usize, &Pose2)| {
            let kept = if i == 0 { 0.0 } else { process.correlation(secs[i] - secs[i - 1]) };
            let mut chance = Draw::new(self.seed, Stage::Path, i as u32).item(2);
            for (error, sigma) in error.iter_mut().zip(sigma) {
                let normal: f64 = StandardNormal.sample(&mut chance);
                *error = kept * *error + (1.0 - kept * kept).sqrt() * sigma * normal;
            }
            Pose2::new(pose.x + error[0], pose.y + error[1], pose.theta + error[2])
        };
        poses.iter().enumerate().map(reference).collect()
    }
}
