//! Simulated logs of known truth, to try a search on: how else would one know that it finds an effect?
//!
//! [`HiddenDrive`] is the nominal drive, whose readings, odometry and poses may be changed before it becomes a log. Whoever looks for
//! the effect is given the [`Drive`] alone.

use locsim_core::{Draw, Drive, DriveStep, Pose2, PoseError, Scan, Stage, Track};
use locsim_world::effect::{Effect, Effects};
use locsim_world::simulation::{BlockResampling, Simulator, odometry_along};

use crate::nominal::BlockPolicy;
use crate::{ComparisonError, Nominal};

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
    pub const POSE_ERROR: PoseError =
        PoseError { sigma_m: 0.01, sigma_rad: 0.003, correlation_secs: 2.0, ..PoseError::NONE };

    /// The world of a drive with these effects.
    ///
    /// # Errors
    /// As the simulator's.
    pub fn simulator(self, nominal: &Nominal, effects: &Effects) -> Result<Simulator, ComparisonError> {
        nominal.simulator(effects, 1.0, self.blocks(nominal))
    }

    /// How long blocks stay.
    pub fn blocks(self, nominal: &Nominal) -> BlockPolicy {
        let of_scenario = nominal.blocks.filter(|_| !self.persistent_blocks);
        of_scenario
            .map_or(BlockPolicy::of(BlockResampling::Never), |blocks| BlockPolicy::of_scenario(&blocks))
    }
}

/// A drive with effects in the library's own form, all at once; without any, the nominal drive.
///
/// # Errors
/// [`ComparisonError::Effect`] for effects that can't be together.
pub fn record_library(
    nominal: &Nominal,
    truth: &Track,
    effects: &[Effect],
    regime: Regime,
    seed: u64,
) -> Result<Drive, ComparisonError> {
    let effects = nominal.effects_with(effects)?;
    let hidden = HiddenDrive::new(nominal, truth, &effects, regime, seed)?;
    Ok(hidden.drive(&hidden.readings_along(truth), hidden.odometry()))
}

/// A simulated drive along the true poses, before anything is hidden in its readings or its odometry.
pub struct HiddenDrive<'a> {
    /// The simulator that a search is given.
    pub nominal: &'a Nominal,
    /// Where the robot really was at each scan, `map_from_base`.
    pub truth: &'a Track,
    /// Everything random derives from it.
    pub seed: u64,
    /// The world of the drive.
    pub simulator: Simulator,
    regime: Regime,
}

impl<'a> HiddenDrive<'a> {
    /// A drive along `truth` in a world with these effects.
    ///
    /// # Errors
    /// [`ComparisonError::Truth`] for a track of fewer than two poses or with equal times, and as the simulator's.
    pub fn new(
        nominal: &'a Nominal,
        truth: &'a Track,
        effects: &Effects,
        regime: Regime,
        seed: u64,
    ) -> Result<Self, ComparisonError> {
        if truth.len() < 2 || truth.secs().windows(2).any(|pair| pair[0] == pair[1]) {
            return Err(ComparisonError::Truth);
        }
        let simulator = regime.simulator(nominal, effects)?;
        Ok(Self { nominal, truth, seed, simulator, regime })
    }

    /// Readings \[scan\]\[beam\] of a robot that followed `track`.
    pub fn readings_along(&self, track: &Track) -> Vec<f32> {
        self.simulator.scan_along(track.secs(), |scan, secs| track.pose_during(scan, secs), self.seed)
    }

    /// `odom_from_base` at each scan.
    pub fn odometry(&self) -> Vec<Pose2> {
        odometry_along(self.truth.poses(), &self.nominal.odometry, self.simulator.effects(), self.seed)
    }

    /// The log: readings, odometry and, as reference, the true poses with the regime's error.
    pub fn drive(&self, readings: &[f32], odometry: Vec<Pose2>) -> Drive {
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
