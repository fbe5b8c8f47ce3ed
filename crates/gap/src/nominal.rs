use std::sync::Arc;

use locsim_core::{Obstructions, Survival};
use locsim_world::effect::{Effect, Effects};
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::{
    BlockOptions, BlockResampling, LaserOptions, ObstructionOptions, ObstructionTable, OdometryNoise,
    Simulator,
};

use crate::{GapError, Recorded};

/// Entries that an obstruction table may have (400 MB).
const MOST_ENTRIES: f64 = 1e8;
/// Sampled blocks of an obstruction table.
const SAMPLED_BLOCKS: u32 = 20_000;

/// The simulator that a log is held against.
#[derive(Clone)]
pub struct Nominal {
    /// Its map.
    pub map: Arc<ExactRangeMap>,
    /// Its laser.
    pub laser: LaserOptions,
    /// Unmapped blocks, if there are any.
    pub blocks: Option<BlockOptions>,
    /// How odometry errs.
    pub odometry: OdometryNoise,
    /// Effects that it has already.
    pub effects: Effects,
    /// How likely blocks stand in a beam's way.
    obstructions: Arc<dyn Obstructions>,
}

impl Nominal {
    /// Prepares a simulator; integrating over its blocks takes some seconds.
    ///
    /// # Errors
    /// [`GapError::NoNoise`] for a laser without noise, [`GapError::Simulation`] for options out of range.
    pub fn new(
        map: Arc<ExactRangeMap>,
        laser: LaserOptions,
        blocks: Option<BlockOptions>,
        odometry: OdometryNoise,
        effects: Effects,
        seed: u64,
    ) -> Result<Self, GapError> {
        if laser.sigma_m <= 0.0 {
            return Err(GapError::NoNoise);
        }
        let blocks = blocks.filter(|blocks| blocks.per_metre_of_wall > 0.0);
        let simulator = Simulator::new(Arc::clone(&map), blocks, laser, effects.clone())?;
        let obstructions: Arc<dyn Obstructions> = match simulator.blocks() {
            None => Arc::new(NothingInTheWay),
            Some(model) => {
                let [x0, y0, x1, y1] = map.geometry().bounds();
                let range = laser.max_range_m;
                let mut options = ObstructionOptions {
                    cell_m: 0.15,
                    headings: 120,
                    bin_m: 0.05,
                    max_range_m: range,
                    samples: SAMPLED_BLOCKS,
                };
                let entries = |o: &ObstructionOptions| {
                    (x1 - x0) * (y1 - y0) / o.cell_m.powi(2) * f64::from(o.headings) * range / o.bin_m
                };
                while entries(&options) > MOST_ENTRIES {
                    options.cell_m *= 1.25;
                    options.bin_m = (options.bin_m * 1.1).min(0.1);
                }
                Arc::new(ObstructionTable::new(model, &map, &options, seed)?)
            }
        };
        Ok(Self { map, laser, blocks, odometry, effects, obstructions })
    }

    /// How likely blocks stand in a beam's way.
    pub(crate) fn obstructions(&self) -> &dyn Obstructions {
        &*self.obstructions
    }

    /// The simulator with more effects, as many blocks as `blocks` says and blocks that stay for so many scans.
    pub(crate) fn simulator(&self, effects: &Effects, blocks: BlockPolicy) -> Result<Simulator, GapError> {
        let options = self.blocks.map(|nominal| BlockOptions {
            per_metre_of_wall: nominal.per_metre_of_wall * blocks.density,
            resample: blocks.resample,
            speed_m_s: if blocks.resample == BlockResampling::EachObservation {
                [0.0; 2]
            } else {
                nominal.speed_m_s
            },
            ..nominal
        });
        Ok(Simulator::new(Arc::clone(&self.map), options, self.laser, effects.clone())?)
    }

    /// Its own effects and more.
    pub(crate) fn effects_with(&self, more: &[Effect]) -> Result<Effects, GapError> {
        Ok(Effects::new([self.effects.list(), more].concat())?)
    }

    /// Whether the log's laser can be the scenario's: number of beams and maximum range.
    pub(crate) fn check(&self, recorded: &Recorded) -> Result<(), GapError> {
        let differs = |log: f64, scenario: f64| (log - scenario).abs() > 1e-3 * scenario.abs().max(1.0);
        let all = f64::from(self.laser.beams);
        if differs(recorded.all_bearings.len() as f64, all) {
            let log = recorded.all_bearings.len() as f64;
            return Err(GapError::Laser { what: "beams per scan", log, scenario: all });
        }
        let log = f64::from(recorded.laser.max_range());
        if differs(log, self.laser.max_range_m) {
            return Err(GapError::Laser { what: "maximum range [m]", log, scenario: self.laser.max_range_m });
        }
        Ok(())
    }
}

/// What a simulation of the log needs to know of unmapped blocks besides the nominal options, fitted to the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockPolicy {
    /// Factor on their density.
    pub density: f64,
    /// When they take new places.
    pub resample: BlockResampling,
}

/// A world that is as mapped.
struct NothingInTheWay;

impl Obstructions for NothingInTheWay {
    fn bin_m(&self) -> f32 {
        1.0
    }

    fn survival(&self, _x: f64, _y: f64, _heading: f64, _range: f32) -> Survival<'_> {
        Survival { probability: &[1.0], start_m: 0.0 }
    }
}
