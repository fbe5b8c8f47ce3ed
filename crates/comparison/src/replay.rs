//! Simulated logs along the recorded poses, with blocks that stay as long as the log's and a reference that errs as its.

use std::collections::HashSet;

use glam::DVec3;
use locsim_core::{Draw, Pose2, PoseInformation, Purpose, Recorded, Stage, Track, cell_at, share_again};
use locsim_world::effect::{Effect, Effects};
use locsim_world::simulation::{BlockResampling, MovedWalls};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::hypothesis::{Comparison, Fitted, Nuisances};
use crate::jitter::Jitter;
use crate::nominal::BlockPolicy;
use crate::pose_pattern::{errors_beyond_patterns, errors_in_patterns};
use crate::{ComparisonError, Nominal};

/// Items of a scan's draws beside those of the simulator.
const REFERENCE_ERROR: u32 = 1;
/// Noise of what a scan says of that.
const TOLD_ERROR: u32 = 2;
/// Item of a piece of wall.
const WALL_ERROR: u32 = 3;
/// Item of what all walls stand off by.
const MAP_BIAS: u32 = 4;
/// Item of errors of the reference that outlast the log.
const PATTERN_ERROR: u32 = 5;
/// Standard deviation of what all walls of a measured map stand off by \[m\]: held-out readings of measured logs have medians of
/// 0.4 to 1.3 cm from such maps.
const MAP_BIAS_M: f64 = 0.01;

/// Side of a cell of the map in which readings in front of walls are counted \[m\]: about a small object's size.
pub const OBJECT_CELL_M: f64 = 0.25;

/// A fitted simulator: it can replay the log.
pub struct Replay<'a> {
    /// The simulator.
    pub nominal: &'a Nominal,
    /// The log, whose poses the replicates have.
    pub recorded: &'a Recorded,
    /// Effects beyond the nominal ones.
    pub effects: &'a [Effect],
    /// What was fitted to the log.
    pub nuisances: Nuisances,
    /// What the log's scans say of errors of its poses.
    pub information: &'a [PoseInformation],
    /// Offset and standard deviation of pieces of a measured map's walls \[m\].
    pub known_offsets: Vec<[f64; 2]>,
    /// How blocks stay, and how many there are.
    pub blocks: BlockTruth,
}

/// True density of clutter as a function of the fitted one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockTruth {
    /// How long blocks stay.
    pub policy: BlockPolicy,
    /// True density over fitted density: readings of blocks right in front of walls are taken for the walls.
    pub density_over_fit: f64,
}

impl<'a> Replay<'a> {
    /// The simulator with the effects and the nuisance parameters that were fitted to a log.
    pub fn new(
        comparison: &'a Comparison<'_>,
        effects: &'a [Effect],
        fitted: &'a Fitted,
        blocks: BlockTruth,
    ) -> Self {
        Self {
            nominal: comparison.nominal,
            recorded: &comparison.recorded,
            effects,
            nuisances: fitted.nuisances,
            information: &fitted.information,
            known_offsets: fitted.known_offsets.clone(),
            blocks,
        }
    }

    /// One simulated log.
    ///
    /// # Errors
    /// As [`Nominal::simulator`].
    pub fn simulate(&self, seed: u64) -> Result<Recorded, ComparisonError> {
        let effects = self.nominal.effects_with(self.effects)?;
        let density = self.nuisances.block_density * self.blocks.density_over_fit;
        let simulator = self.nominal.simulator(&effects, density, self.blocks.policy)?;
        // As the log's laser sweeps.
        let mut simulator = simulator.with_beam_times(self.recorded.log_laser.beam_times_secs())?;
        if let Some(moved) = self.moved_walls(seed) {
            simulator = simulator.with_moved_walls(moved);
        }
        let (erring, corrections) = self.errors(seed);
        let track = &self.recorded.track;
        let base_at = |scan: usize, secs| {
            let error = erring.pose_during(scan, secs).error_from(&track.pose_during(scan, secs));
            self.recorded.pose_at(scan, secs).moved(error - corrections[scan])
        };
        let truth: Vec<Pose2> = track.secs().iter().enumerate().map(|(i, &secs)| base_at(i, secs)).collect();
        let jitter = Jitter::new(self.recorded, seed);
        let seen_from = |scan: usize, secs| {
            let pose = base_at(scan, secs);
            jitter.as_ref().map_or(pose, |jitter| pose.moved(jitter.at(scan, secs)))
        };
        let readings = simulator.beams_along(&self.recorded.kept, track.secs(), seen_from, seed);
        let odometry = self.nuisances.odometry_error.along(&truth, &effects, seed);
        Ok(Recorded { corrections, ..self.recorded.with(readings, odometry) })
    }

    /// The walls of a measured map as far off as such walls are.
    fn moved_walls(&self, seed: u64) -> Option<MovedWalls> {
        let pieces = self.nominal.pieces.clone()?;
        let draw = Draw::new(seed, Stage::Path, 0);
        let all: f64 = StandardNormal.sample(&mut draw.item(MAP_BIAS));
        let offset = |piece: usize| {
            let mut rng = draw.at(piece as u32).item(WALL_ERROR);
            let normal: f64 = StandardNormal.sample(&mut rng);
            let count = self.known_offsets.len();
            let own = if count == 0 {
                pieces.sigmas()[piece] * normal
            } else {
                let [offset, sigma] = self.known_offsets[rng.random_range(0..count)];
                offset + sigma * normal
            };
            MAP_BIAS_M * all + own
        };
        let offsets = (0..pieces.sigmas().len()).map(offset).collect();
        Some(MovedWalls { pieces, offsets })
    }

    /// The recorded poses with errors as the log's reference poses have them, those that outlast it included, and what is known of these, which
    /// is taken off: nothing where nothing is known of the log's, and otherwise what scans like its own tell.
    pub fn errors(&self, seed: u64) -> (Track, Vec<DVec3>) {
        let (track, process) = (&self.recorded.track, &self.nuisances.pose_error);
        let draw = |item| move |scan| Draw::new(seed, Stage::Path, scan).item(item);
        let mut errors = process.simulate(track.secs(), draw(REFERENCE_ERROR));
        let in_patterns = errors_in_patterns(process, self.recorded, &mut draw(PATTERN_ERROR)(0));
        errors.iter_mut().zip(in_patterns).for_each(|(error, more)| *error += more);
        let known = if self.recorded.is_corrected() {
            let scans = self.information.iter().zip(&errors).enumerate();
            let told = scans.map(|(i, (scan, e))| scan.simulate(*e, &mut draw(TOLD_ERROR)(i as u32)));
            errors_beyond_patterns(process, self.recorded, &told.collect::<Vec<_>>())
        } else {
            vec![DVec3::ZERO; errors.len()]
        };
        let erring = track.poses().iter().zip(errors).map(|(pose, error)| pose.moved(error));
        (track.with_poses(erring.collect()), known)
    }
}

/// How long blocks stay in a log: the policy under which neighbouring scans share as many short readings. The bias of their
/// density is left out; see [`BlockTruth::in_world`].
///
/// # Errors
/// As [`Replay::simulate`].
pub fn fit_persistence(
    comparison: &Comparison<'_>,
    effects: &[Effect],
    fitted: &Fitted,
    seed: u64,
) -> Result<BlockPolicy, ComparisonError> {
    let Some(blocks) = comparison.nominal.blocks else {
        return Ok(BlockPolicy::of(BlockResampling::EachObservation));
    };
    let all = comparison.effects(effects)?;
    let shared = |recorded: &Recorded| shared_shorts(&comparison.of(recorded), &all, fitted);
    let own = shared(&comparison.recorded);
    let own_policy = BlockPolicy::of_scenario(&blocks);
    let resamples = [BlockResampling::EachObservation, BlockResampling::Never].into_iter();
    let resamples = resamples.chain([3, 10, 40].map(BlockResampling::EachScanN));
    let mut policies: Vec<BlockPolicy> = resamples.map(BlockPolicy::of).collect();
    policies.extend(SHARES.map(|share| BlockPolicy::passing(share, true)));
    policies.extend(SHARES[..4].iter().map(|share| BlockPolicy::passing(*share, false)));
    if !policies.contains(&own_policy) {
        policies.push(own_policy);
    }
    let draw = Purpose::Persistence.draw(seed);
    let distances = policies
        .iter()
        .map(|&policy| {
            let replay = Replay::new(comparison, effects, fitted, BlockTruth::of(policy));
            let logs = (0..6)
                .into_par_iter()
                .map(|i| Ok(shared(&replay.simulate(draw.seed(i))?)))
                .collect::<Result<Vec<_>, ComparisonError>>()?;
            let distance = (0..LAGS.len()).map(|lag| {
                let mean = logs.iter().map(|log| log[lag]).sum::<f64>() / logs.len() as f64;
                (mean - own[lag]).abs()
            });
            // The nominal policy is kept where it is as good.
            let handicap = if policy == own_policy { 0.0 } else { 0.02 };
            Ok(distance.sum::<f64>() + handicap)
        })
        .collect::<Result<Vec<f64>, ComparisonError>>()?;
    let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
    // Of those that are about as good the one under which blocks are seen longest: it takes least for a discovery.
    let best = policies
        .iter()
        .zip(&distances)
        .filter(|(_, distance)| **distance <= 1.3 * least + 0.02)
        .map(|(policy, _)| *policy)
        .max_by(|a, b| a.stay_scans().total_cmp(&b.stay_scans()));
    Ok(best.unwrap_or(own_policy))
}

impl BlockTruth {
    /// As dense as fits say.
    pub const fn of(policy: BlockPolicy) -> Self {
        Self { policy, density_over_fit: 1.0 }
    }

    /// The same blocks with the bias that the fit of their density has in a world with these effects, by simulated logs.
    ///
    /// # Errors
    /// As [`Replay::simulate`].
    pub fn in_world(
        self,
        comparison: &Comparison<'_>,
        effects: &[Effect],
        fitted: &Fitted,
        seed: u64,
    ) -> Result<Self, ComparisonError> {
        if comparison.nominal.blocks.is_none() {
            return Ok(self);
        }
        let all = comparison.effects(effects)?;
        let draw = Purpose::BlockDensity.draw(seed);
        let seeming = |truth: Self| -> Result<f64, ComparisonError> {
            let replay = Replay::new(comparison, effects, fitted, truth);
            let densities = (0..12)
                .into_par_iter()
                .map(|i| {
                    let simulated = replay.simulate(draw.seed(i))?;
                    let refitted = comparison.of(&simulated).find_nuisances(&all, &fitted.nuisances, 4);
                    Ok(refitted.nuisances.block_density)
                })
                .collect::<Result<Vec<f64>, ComparisonError>>()?;
            Ok(densities.iter().sum::<f64>() / densities.len() as f64)
        };
        let own = fitted.nuisances.block_density;
        // Things in the open are in the reach of blocks as well.
        let hardly_any = Self { density_over_fit: HARDLY_ANY, ..self };
        let of_things = if comparison.nominal.has_things_in_the_open() { seeming(hardly_any)? } else { 0.0 };
        let of_blocks = seeming(self)? - of_things;
        let over = self.density_over_fit * (own - of_things) / of_blocks.max(f64::MIN_POSITIVE);
        let limits = if of_things > 0.0 { HARDLY_ANY..=2.0 } else { 0.5..=2.0 };
        Ok(Self { density_over_fit: over.clamp(*limits.start(), *limits.end()), ..self })
    }
}

/// Density of blocks over the fitted one where all that the log has in front of walls may be things in the open.
const HARDLY_ANY: f64 = 0.02;

/// Shares of clutter that doesn't stay which are tried.
const SHARES: [f64; 5] = [0.25, 0.5, 0.75, 0.9, 1.0];

/// Numbers of scans after which blocks are looked for where they were.
const LAGS: [usize; 4] = [1, 4, 16, 64];

/// Share of cells of the map with a short reading in a scan that have one again a given number of scans later.
fn shared_shorts(comparison: &Comparison<'_>, effects: &Effects, fitted: &Fitted) -> [f64; LAGS.len()] {
    let mut cells = vec![HashSet::new(); comparison.views.scans()];
    comparison.for_each_reading(&comparison.views, effects, fitted, |scan, i, _, _, z, terms| {
        if terms.short > 0.5 {
            let point = comparison.views.beams[i].view.point_at(z);
            cells[scan].insert(cell_at(point, OBJECT_CELL_M));
        }
    });
    LAGS.map(|lag| share_again(&cells, lag))
}

#[cfg(test)]
mod tests {
    use locsim_world::simulation::{BlockOptions, LaserOptions};

    use super::*;
    use crate::fixtures::{NOMINAL, TRUTH};
    use crate::hidden::{Regime, record_library};

    /// The scenario's laser turns counter-clockwise, the log's clockwise: its walls are where its beams are taken.
    #[test]
    fn a_simulated_log_sweeps_as_the_log() {
        let laser = LaserOptions { scan_secs: 0.1, ..NOMINAL.laser };
        let nominal =
            Nominal::new(NOMINAL.map.clone(), laser, None, NOMINAL.odometry, NOMINAL.effects.clone())
                .unwrap();
        let mut drive = record_library(&nominal, &TRUTH, &[], Regime::default(), 5).unwrap();
        let mut secs = drive.laser.beam_times_secs().to_vec();
        secs.reverse();
        drive.laser = drive.laser.with_beam_times(&secs).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let comparison = Comparison::new(&nominal, &recorded).unwrap();
        let fitted = comparison.start(&Nuisances::default());
        let truth = BlockTruth::of(BlockPolicy::of(BlockResampling::EachObservation));
        let log = Replay::new(&comparison, &[], &fitted, truth).simulate(8).unwrap();
        let beams = comparison.views.beams.iter().zip(&log.readings);
        let far = beams.filter(|(beam, z)| (beam.range() - f64::from(**z)).abs() > 0.05);
        // Returns that get lost, and beams at edges.
        assert!((far.count() as f64) < 0.05 * log.readings.len() as f64);
    }

    /// Clutter that is drawn anew, that stays, that walks and of which a half does each is told apart by where its readings are again.
    #[test]
    fn a_log_tells_how_its_clutter_stays() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 5).unwrap();
        let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let [redrawn, stays] =
            [BlockResampling::EachObservation, BlockResampling::Never].map(BlockPolicy::of);
        let passing = [(0.5, true), (1.0, true), (0.5, false)];
        let passing = passing.map(|(share, walks)| BlockPolicy::passing(share, walks));
        for truth in [redrawn, stays].into_iter().chain(passing) {
            let log = Replay::new(&comparison, &[], &fitted, BlockTruth::of(truth)).simulate(8).unwrap();
            let log = comparison.of(&log);
            let fitted = log.fit_nuisances(&Nuisances::default(), 20);
            let found = fit_persistence(&log, &[], &fitted, 3).unwrap();
            // Of shares about as good the one with more that stays.
            let is_right = if truth.passing == 0.5 {
                [0.25, 0.5].contains(&found.passing) && found.walks == truth.walks
            } else {
                found == truth
            };
            assert!(is_right, "{found:?} {truth:?}");
            assert_eq!(found.stands(), truth == stays);
        }
    }

    /// A log with blocks and things in the open. Simulated logs have as many of both together, as far as a fit of the blocks tells.
    #[test]
    fn things_in_the_open_are_no_blocks() {
        let blocks = NOMINAL.blocks.unwrap();
        let things = BlockOptions {
            per_metre_of_wall: 0.15,
            wall_distance_m: [0.0, blocks.wall_distance_m[1] + 0.6],
            ..blocks
        };
        let nominal = NOMINAL.clone().with_things_in_the_open(things).unwrap();
        let drive = record_library(&nominal, &TRUTH, &[], Regime::default(), 5).unwrap();
        let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
        let comparison = Comparison::new(&nominal, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        // Were there a third of the blocks, things would make most of what is fitted.
        let mut few = fitted.clone();
        few.nuisances.block_density *= 0.3;
        let anew = BlockTruth::of(BlockPolicy::of(BlockResampling::EachObservation));
        for (fitted, least) in [(&fitted, 0.8), (&few, 0.0)] {
            let truth = anew.in_world(&comparison, &[], fitted, 3).unwrap();
            let log = Replay::new(&comparison, &[], fitted, truth).simulate(8).unwrap();
            let refitted = comparison.of(&log).fit_nuisances(&Nuisances::default(), 20);
            let ratio = refitted.nuisances.block_density / fitted.nuisances.block_density;
            assert!(truth.density_over_fit > 0.0 && ratio > least && ratio < 1.3, "{ratio} {truth:?}");
        }
    }

    /// A scenario says that what stands there moves. What the log has may stand all the same.
    #[test]
    fn blocks_that_a_scenario_has_move_may_stand() {
        let moving = BlockOptions {
            resample: BlockResampling::Never,
            speed_m_s: [0.2, 0.6],
            ..NOMINAL.blocks.unwrap()
        };
        let nominal = Nominal::new(
            NOMINAL.map.clone(),
            NOMINAL.laser,
            Some(moving),
            NOMINAL.odometry,
            NOMINAL.effects.clone(),
        )
        .unwrap();
        let drive = record_library(&nominal, &TRUTH, &[], Regime::default(), 5).unwrap();
        let recorded = Recorded::new(&drive, 300, 72, |_| true).unwrap();
        let comparison = Comparison::new(&nominal, &recorded).unwrap();
        let fitted = comparison.fit_nuisances(&Nuisances::default(), 20);
        let stands = BlockPolicy::of(BlockResampling::Never);
        for truth in [stands, BlockPolicy::of_scenario(&moving)] {
            let log = Replay::new(&comparison, &[], &fitted, BlockTruth::of(truth)).simulate(8).unwrap();
            let log = comparison.of(&log);
            let fitted = log.fit_nuisances(&Nuisances::default(), 20);
            let found = fit_persistence(&log, &[], &fitted, 3).unwrap();
            assert_eq!(found.stands(), truth == stands, "{found:?}");
        }
    }
}
