//! What stands where no block of the scenario can: people in the open, furniture amid a room. A search whose simulated logs
//! have nothing there takes it for errors of the readings. So they get as much of it as the log has, and a scenario without any blocks gets some.

mod readings;
#[cfg(test)]
mod tests;

use locsim_core::{DriveStep, Laser, Pose2, Scan};
use locsim_world::simulation::{BlockOptions, BlockResampling, SimulationError, Simulator};

pub(super) use readings::Way;
use readings::{InOpen, in_open};

/// Scans that are looked at, at the most.
const SCANS: usize = 300;
/// Blocks per metre of wall with which it is found how many there are \[1/m\].
const TRIED_PER_METRE: f64 = 0.05;
/// How far from walls blocks stand at the most where a scenario has none \[m\].
const AT_WALLS_M: f64 = 1.0;
/// How often the sizes of simulated things are made those of the log's, and the factors that they may have.
const SIZINGS: u32 = 2;
const SIZES: [f64; 2] = [0.2, 4.0];

/// How far from walls things in the open keep at the least, as shares of the blocks' reach: the first with which they explain no more than the log has.
const FROM_WALLS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// The greatest speed of people \[m/s\].
const WALKING_M_S: f64 = 1.4;

/// The scans that are looked at.
pub(super) fn looked_at<'a>(steps: impl Iterator<Item = &'a DriveStep>) -> Vec<&'a DriveStep> {
    let steps: Vec<&DriveStep> = steps.collect();
    let every = steps.len().div_ceil(SCANS).max(1);
    steps.into_iter().step_by(every).collect()
}

/// What simulated logs get beside what the scenario has, so that they have as much in front of walls as the log.
pub(super) struct Clutter {
    /// What is told of it, if anything.
    pub warning: Option<String>,
    /// Blocks for a scenario that has none.
    pub blocks: Option<BlockOptions>,
    /// People and things where none of the blocks can be, neither the scenario's nor the added ones.
    pub things: Option<BlockOptions>,
}

impl Clutter {
    /// By scans whose reference poses are known, of a robot on its way, and a simulator without blocks.
    ///
    /// # Errors
    /// As the simulator's.
    pub fn of(
        steps: &[&DriveStep],
        way: Option<&Way<'_>>,
        laser: &Laser,
        empty: &Simulator,
        of_scenario: Option<&BlockOptions>,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        let found_with = |blocks: Option<&BlockOptions>| in_open(steps, laser, empty.map(), blocks, way);
        let along = Along::new(steps, empty, seed);
        let found = found_with(of_scenario);
        let warning = found.as_ref().and_then(InOpen::warning);
        let added = found.as_ref().and_then(|found| Some((found, found.blocks()?)));
        let blocks = added.map(|(found, blocks)| found.as_wide(blocks, &along, None)).transpose()?;
        let found = if blocks.is_some() { found_with(blocks.as_ref()) } else { found };
        let known = of_scenario.or(blocks.as_ref());
        let things = found.map(|found| found.things(&along, known)).transpose()?.flatten();
        Ok(Self { warning, blocks, things })
    }
}

impl InOpen {
    /// What is told of them, if anything.
    pub fn warning(&self) -> Option<String> {
        let (percent, most_m) = (100.0 * self.share, self.most_m);
        let is_told = self.is_told && !(self.is_one_thing && self.reach_m.is_none());
        let text = self.reach_m.map_or_else(
            || {
                let simulated = if most_m > AT_WALLS_M {
                    format!(
                        "Simulated logs get as many: blocks up to {:.1} m from a wall, which `scenario.yaml` has as well, and things in the \
                         open beyond.",
                        self.at_walls_m()
                    )
                } else {
                    "Simulated logs get blocks up to there, as many as the log has.".to_owned()
                };
                format!(
                    "{percent:.1} % of the readings end in front of the walls, and the scenario has no `blocks`: people or things in the \
                     open, most of them within {most_m:.1} m of a wall. {simulated}"
                )
            },
            |reach_m| {
                let simulated = if self.is_one_thing {
                    "Most of them are at one place: it is for the search to say what stands there."
                } else {
                    "Simulated logs get as many, beside the scenario's blocks; `scenario.yaml` doesn't have them."
                };
                format!(
                    "{percent:.1} % of the readings end where no block of the scenario reaches ({reach_m:.1} m from a wall): people or things \
                     in the open, most of them within {most_m:.1} m of a wall. {simulated}"
                )
            },
        );
        is_told.then_some(text)
    }

    /// How far from walls blocks stand of a scenario that has none \[m\]. What is farther off is in the open.
    fn at_walls_m(&self) -> f64 {
        (10.0 * self.most_m.min(AT_WALLS_M)).round() / 10.0
    }

    /// Blocks for a scenario that has none. How many there are is fitted to the log, as is how long they stay.
    fn blocks(&self) -> Option<BlockOptions> {
        let blocks = BlockOptions {
            per_metre_of_wall: 0.1,
            length_m: [0.1, 0.6],
            width_m: [0.1, 0.4],
            yaw_rad: [-std::f64::consts::FRAC_PI_4, std::f64::consts::FRAC_PI_4],
            // To the digit that is told.
            wall_distance_m: [0.0, self.at_walls_m()],
            resample: BlockResampling::EachObservation,
            speed_m_s: [0.0, 0.0],
            clearance_m: 0.35,
        };
        (self.reach_m.is_none() && self.is_told && !self.is_one_thing).then_some(blocks)
    }

    /// Blocks that show as wide as what the log has does, wherever they stand.
    ///
    /// # Errors
    /// As the simulator's.
    fn as_wide(
        &self,
        blocks: BlockOptions,
        along: &Along<'_>,
        known: Option<&BlockOptions>,
    ) -> Result<BlockOptions, SimulationError> {
        let anywhere = BlockOptions { wall_distance_m: [0.0, self.across_m], ..blocks };
        let mut times = 1.0_f64;
        // To the centimetre.
        let sized = |of: BlockOptions, times: f64| {
            let sizes = |sizes: [f64; 2]| sizes.map(|size| (100.0 * times * size).round().max(1.0) / 100.0);
            BlockOptions { length_m: sizes(of.length_m), width_m: sizes(of.width_m), ..of }
        };
        for _ in 0..SIZINGS {
            let Some(shown) = along.seen(sized(anywhere, times), known)? else { break };
            if shown.width_m == 0.0 || self.width_m == 0.0 {
                break;
            }
            times = (times * self.width_m / shown.width_m).clamp(SIZES[0], SIZES[1]);
        }
        Ok(sized(blocks, times))
    }

    /// People and things in the open beside a scenario's blocks, as many as the log has: the share of such readings in scans of a simulator without
    /// blocks along the same poses says how many these are. They are at walls as well, or keep so far from them that they alone don't make more readings
    /// there than the log has; where they do all the same, they are fewer.
    ///
    /// # Errors
    /// As the simulator's.
    fn things(
        &self,
        along: &Along<'_>,
        blocks: Option<&BlockOptions>,
    ) -> Result<Option<BlockOptions>, SimulationError> {
        let Some(blocks) = blocks.filter(|_| !self.is_one_thing) else {
            return Ok(None);
        };
        let anywhere = BlockOptions {
            per_metre_of_wall: TRIED_PER_METRE,
            length_m: [0.1, 0.5],
            width_m: [0.1, 0.5],
            yaw_rad: [-std::f64::consts::FRAC_PI_4, std::f64::consts::FRAC_PI_4],
            // A reading where nothing can stand would count as much as many others.
            wall_distance_m: [0.0, self.across_m],
            resample: BlockResampling::EachObservation,
            speed_m_s: [0.0, 0.0],
            clearance_m: blocks.clearance_m,
        };
        let anywhere = self.as_wide(anywhere, along, Some(blocks))?;
        let mut things = None;
        for share in FROM_WALLS {
            let from_m = share * blocks.reach_m().min(self.across_m);
            let tried = BlockOptions { wall_distance_m: [from_m, self.across_m], ..anywhere };
            let Some(found) = along.seen(tried, Some(blocks))? else { break };
            let in_reach = self.share_in_reach / found.share_in_reach.max(f64::MIN_POSITIVE);
            let times = (self.share / found.share).min(in_reach);
            things = Some(BlockOptions {
                resample: BlockResampling::EachScanN(BlockOptions::PASSING_SCANS),
                // Some stand, some walk.
                speed_m_s: [0.0, WALKING_M_S],
                ..tried.times(times)
            });
            if times < in_reach {
                break;
            }
        }
        Ok(things)
    }
}

/// A log's poses, along which scans are simulated.
struct Along<'a> {
    /// A simulator without blocks.
    empty: &'a Simulator,
    /// Seconds from the first scan on.
    secs: Vec<f64>,
    poses: Vec<Pose2>,
    seed: u64,
}

impl<'a> Along<'a> {
    fn new(steps: &[&DriveStep], empty: &'a Simulator, seed: u64) -> Self {
        let known: Vec<(f64, Pose2)> =
            steps.iter().filter_map(|step| Some((step.stamp_secs, step.reference?))).collect();
        let start = known.first().map_or(0.0, |(secs, _)| *secs);
        let (secs, poses) = known.into_iter().map(|(secs, pose)| (secs - start, pose)).unzip();
        Self { empty, secs, poses, seed }
    }

    /// What is in front of walls of `tried` alone, where none of the blocks `known` can be.
    fn seen(
        &self,
        tried: BlockOptions,
        known: Option<&BlockOptions>,
    ) -> Result<Option<InOpen>, SimulationError> {
        let Self { empty, secs, poses, seed } = self;
        let laser = empty.laser().laser();
        let simulator = Simulator::clone(empty).with_more_blocks(tried)?;
        let readings = simulator.scan_along(secs, |i, _| poses[i], *seed);
        let scans = secs.iter().zip(poses).zip(readings.chunks(laser.beam_count()));
        let steps = scans.map(|((secs, pose), ranges)| {
            let scan = Scan { ranges: ranges.to_vec() };
            DriveStep { stamp_secs: *secs, odometry: *pose, reference: Some(*pose), scan }
        });
        let steps: Vec<DriveStep> = steps.collect();
        Ok(in_open(&steps.iter().collect::<Vec<_>>(), laser, empty.map(), known, None))
    }
}
