use std::sync::Arc;

use locsim_world::effect::{Effect, Effects, Residual};
use locsim_world::raycast::ExactRangeMap;
use locsim_world::simulation::{
    BlockIntegral, BlockModel, BlockOptions, BlockResampling, LaserOptions, OdometryNoise, Simulator,
    WallPieces,
};

use serde::Serialize;

use crate::ComparisonError;
use locsim_core::Recorded;

/// The simulator that a log is held against.
#[derive(Clone)]
pub struct Nominal {
    /// Its map.
    pub map: Arc<ExactRangeMap>,
    /// Its laser.
    pub laser: LaserOptions,
    /// Unmapped blocks, if there are any.
    pub blocks: Option<BlockOptions>,
    /// People and things in the open, farther from walls than these reach.
    open: Option<BlockOptions>,
    /// How odometry errs.
    pub odometry: OdometryNoise,
    /// Effects that it has already.
    pub effects: Effects,
    /// Prior of its clutter.
    integral: Option<Arc<BlockIntegral>>,
    /// The pieces of its walls, which may stand a little off; `None` of a map that is taken for exact.
    pub pieces: Option<Arc<WallPieces>>,
}

/// Shapes of things in the open that an integral over them is summed over, a quarter of those of blocks: they are few, their places spread over
/// metres, and beams meet those of each face around.
const OPEN_SHAPES: u32 = 32;

impl Nominal {
    /// Prepares a simulator.
    ///
    /// # Errors
    /// [`ComparisonError::NoNoise`] for a laser without noise, [`ComparisonError::Simulation`] for options out of range.
    pub fn new(
        map: Arc<ExactRangeMap>,
        laser: LaserOptions,
        blocks: Option<BlockOptions>,
        odometry: OdometryNoise,
        effects: Effects,
    ) -> Result<Self, ComparisonError> {
        if laser.sigma_m <= 0.0 {
            return Err(ComparisonError::NoNoise);
        }
        // As the laser has them: the f32 of 5.6 is below 5.6, and a reading of it is at the maximum range.
        let laser = LaserOptions {
            min_range_m: f64::from(laser.min_range_m as f32),
            max_range_m: f64::from(laser.max_range_m as f32),
            ..laser
        };
        let blocks = blocks.filter(|blocks| blocks.per_metre_of_wall > 0.0);
        let simulator = Simulator::new(Arc::clone(&map), blocks, laser, effects.clone())?;
        let integral = simulator.blocks().map(|model| Arc::new(BlockIntegral::new(model)));
        let pieces = WallPieces::new(map.geometry())?.map(Arc::new);
        Ok(Self { map, laser, blocks, open: None, odometry, effects, integral, pieces })
    }

    /// The same simulator with people and things in the open, if it has blocks at all.
    ///
    /// # Errors
    /// [`ComparisonError::Simulation`] for options out of range.
    pub fn with_things_in_the_open(mut self, open: BlockOptions) -> Result<Self, ComparisonError> {
        self.open = self.blocks.map(|_| open);
        self.integral = self.blocks.map(|blocks| self.integral_of(&blocks)).transpose()?;
        Ok(self)
    }

    /// Whether there are people and things in the open.
    pub fn has_things_in_the_open(&self) -> bool {
        self.open.is_some()
    }

    /// Prior of these blocks beside what is in the open.
    fn integral_of(&self, blocks: &BlockOptions) -> Result<Arc<BlockIntegral>, ComparisonError> {
        let model = |options: &BlockOptions| BlockModel::new(*options, self.map.geometry());
        let open = self.open.as_ref().map(model).transpose()?;
        let open = open.map(|model| Arc::new(BlockIntegral::with_shapes(&model, OPEN_SHAPES)));
        Ok(Arc::new(BlockIntegral::new(&model(blocks)?).and(open)))
    }

    /// The same simulator without clutter.
    ///
    /// # Errors
    /// As [`Nominal::new`].
    pub fn without_blocks(&self) -> Result<Self, ComparisonError> {
        Self::new(Arc::clone(&self.map), self.laser, None, self.odometry, self.effects.clone())
    }

    /// The blocks of its world with these effects.
    pub fn blocks_with(&self, effects: &Effects) -> Option<BlockOptions> {
        self.blocks.map(|blocks| effects.blocks(blocks))
    }

    /// Prior of this clutter.
    ///
    /// # Errors
    /// [`ComparisonError::Simulation`] for options out of range.
    pub fn integral_over(
        &self,
        blocks: Option<&BlockOptions>,
    ) -> Result<Option<Arc<BlockIntegral>>, ComparisonError> {
        if blocks == self.integral.as_ref().map(|integral| integral.model().options()) {
            return Ok(self.integral.clone());
        }
        blocks.map(|blocks| self.integral_of(blocks)).transpose()
    }

    /// The simulator with more effects, `density` times as many blocks, and clutter that stays as long as `policy` says.
    ///
    /// # Errors
    /// [`ComparisonError::Simulation`] for options out of range.
    pub fn simulator(
        &self,
        effects: &Effects,
        density: f64,
        policy: BlockPolicy,
    ) -> Result<Simulator, ComparisonError> {
        let BlockPolicy { resample, moves, passing, walks } = policy;
        let standing = self.blocks.map(|blocks| BlockOptions {
            speed_m_s: if moves { blocks.speed_m_s } else { [0.0; 2] },
            ..blocks.times(density * (1.0 - passing)).resampled(resample)
        });
        let mut simulator = Simulator::new(Arc::clone(&self.map), standing, self.laser, effects.clone())?;
        if let Some(open) = self.open {
            // As many as the log has, however many there are of the others.
            simulator = simulator.with_more_blocks(open)?;
        }
        let Some(blocks) = self.blocks.filter(|_| passing > 0.0) else { return Ok(simulator) };
        let passing = blocks.times(density * passing);
        let passing = match (walks, passing.speed_m_s[1] > 0.0) {
            (false, _) => passing.resampled(BlockResampling::EachObservation),
            (true, false) => passing.walking(),
            // As fast as the scenario says.
            (true, true) => passing,
        };
        Ok(simulator.with_more_blocks(passing)?)
    }

    /// The same simulator with more residuals.
    ///
    /// # Errors
    /// [`ComparisonError::Effect`] for residuals that can't be.
    pub fn with_residuals(&self, more: &[Residual]) -> Result<Self, ComparisonError> {
        let residuals = [self.effects.residuals(), more].concat();
        Ok(Self { effects: self.effects.clone().with_residuals(residuals)?, ..self.clone() })
    }

    /// The same simulator with this standard deviation of the readings' noise \[m\].
    #[must_use]
    pub fn with_noise(self, sigma_m: f64) -> Self {
        Self { laser: LaserOptions { sigma_m, ..self.laser }, ..self }
    }

    /// The same simulator with other effects that act on readings alone.
    #[must_use]
    pub fn with_effects(&self, effects: Effects) -> Self {
        Self { effects, ..self.clone() }
    }

    /// Its own effects and more.
    ///
    /// # Errors
    /// [`ComparisonError::Effect`] for effects that exclude each other.
    pub fn effects_with(&self, more: &[Effect]) -> Result<Effects, ComparisonError> {
        Ok(self.effects.replaced([self.effects.list(), more].concat())?)
    }

    /// Whether the log's laser can be the scenario's: number of beams and maximum range.
    ///
    /// # Errors
    /// [`ComparisonError::Laser`] where it can't.
    pub fn check(&self, recorded: &Recorded) -> Result<(), ComparisonError> {
        let differs = |log: f64, scenario: f64| (log - scenario).abs() > 1e-3 * scenario.abs().max(1.0);
        let all = f64::from(self.laser.beams);
        if differs(recorded.log_laser.beam_count() as f64, all) {
            let log = recorded.log_laser.beam_count() as f64;
            return Err(ComparisonError::Laser { what: "beams per scan", log, scenario: all });
        }
        let log = f64::from(recorded.laser.max_range());
        if differs(log, self.laser.max_range_m) {
            return Err(ComparisonError::Laser {
                what: "maximum range [m]",
                log,
                scenario: self.laser.max_range_m,
            });
        }
        Ok(())
    }
}

/// A number of the scenario's laser that is larger than the log's, where the log's is least.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Guess {
    /// Its key in the scenario, or the effect whose `p` it is.
    pub what: &'static str,
    /// What the scenario has, SI unit.
    pub scenario: f64,
    /// What the log has at the most where it has least: the search has it so.
    pub log: f64,
}

/// How long clutter stays, fitted to the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockPolicy {
    /// When blocks take new places, those that stay.
    pub resample: BlockResampling,
    /// Whether those that stay for more than a scan move meanwhile, as fast as the nominal simulator's.
    pub moves: bool,
    /// The share of them that doesn't stay, whatever the nominal simulator has.
    pub passing: f64,
    /// Whether these walk past, as people do; otherwise they are elsewhere at each observation.
    pub walks: bool,
}

impl BlockPolicy {
    /// Blocks that stand until they take new places.
    pub const fn of(resample: BlockResampling) -> Self {
        Self { resample, moves: false, passing: 0.0, walks: false }
    }

    /// Blocks as a scenario has them.
    pub fn of_scenario(blocks: &BlockOptions) -> Self {
        Self { moves: blocks.speed_m_s[1] > 0.0, ..Self::of(blocks.resample) }
    }

    /// Blocks of which this share doesn't stay, and the rest never moves.
    pub const fn passing(share: f64, walks: bool) -> Self {
        Self { passing: share, walks, ..Self::of(BlockResampling::Never) }
    }

    /// Whether all of it stays where it is.
    pub fn stands(&self) -> bool {
        *self == Self::of(BlockResampling::Never)
    }

    /// In how many scans a block is seen at one place, about.
    pub fn stay_scans(&self) -> f64 {
        let stays = match self.resample {
            BlockResampling::EachObservation => 1,
            BlockResampling::EachScanN(scans) => scans,
            BlockResampling::Never => u32::MAX,
        };
        let stays = if self.moves { stays.min(BlockOptions::PASSING_SCANS) } else { stays };
        // One that walks by half of the time until it is elsewhere.
        let passes = if self.walks { 0.5 * f64::from(BlockOptions::PASSING_SCANS) } else { 1.0 };
        self.passing * passes + (1.0 - self.passing) * f64::from(stays)
    }
}
