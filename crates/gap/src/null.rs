//! What the statistics of a log are where the simulator is right: whole simulated drives along the recorded poses.
//!
//! Beams of a scan share its pose's error and its blocks, and scans share both, so that no statistic over beams has a
//! distribution one could look up. Here each replicate simulates the whole log, with blocks that stay as long as the
//! log's and references that err as the log's, fits the same nuisances to it, and gives all statistics. One false-alarm
//! rate holds for all of them together: the largest standardized statistic of the log is ranked among those of the
//! replicates (max-T; Westfall and Young 1993).

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use locsim_core::{Draw, Pose2, Stage};
use locsim_world::effect::Effect;
use locsim_world::simulation::BlockResampling;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use crate::hypothesis::{Comparison, Fitted, Nuisances};
use crate::nominal::BlockPolicy;
use crate::statistics::{Dictionary, Halves, OBJECT_CELL_M, cell_at, pit_draw};
use crate::views::Views;
use crate::{GapError, Nominal, Recorded};

/// Expectation maximization steps of a replicate, which starts at the fitted process.
const REFIT: usize = 4;

/// A fitted simulator: it can replay the log.
pub(crate) struct Replay<'a> {
    pub nominal: &'a Nominal,
    pub recorded: &'a Recorded,
    /// Effects beyond the nominal ones.
    pub effects: &'a [Effect],
    pub nuisances: Nuisances,
    pub blocks: BlockTruth,
}

/// What is true of unmapped blocks where the fit to a log says what it says.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockTruth {
    pub resample: BlockResampling,
    /// True density over fitted density: readings of blocks right in front of walls are taken for the walls.
    pub density_over_fit: f64,
}

impl Replay<'_> {
    /// One simulated log.
    pub fn simulate(&self, seed: u64) -> Result<Recorded, GapError> {
        let effects = self.nominal.effects_with(self.effects)?;
        let density = self.nuisances.block_density * self.blocks.density_over_fit;
        let blocks = BlockPolicy { density, resample: self.blocks.resample };
        let simulator = self.nominal.simulator(&effects, blocks)?;
        let truth = self.true_poses(seed);
        let readings = simulator.scan_along(&self.recorded.secs, &truth, seed);
        let all = self.recorded.all_bearings.len();
        let readings = if all == self.recorded.beams() {
            readings
        } else {
            let scans = readings.chunks(all);
            scans.flat_map(|scan| self.recorded.kept.iter().map(|&beam| scan[beam])).collect()
        };
        let noise = &self.nominal.odometry;
        let odometry = locsim_world::simulation::odometry_along(&truth, noise, &effects, seed);
        Ok(self.recorded.with(readings, self.with_odometry_error(&odometry, seed)))
    }

    /// True poses of a log whose reference is the recorded one.
    fn true_poses(&self, seed: u64) -> Vec<Pose2> {
        let process = self.nuisances.pose_error;
        let poses = &self.recorded.poses;
        if process.is_none() {
            return poses.clone();
        }
        let mut error = [0.0; 3];
        let sigma = [process.sigma_m, process.sigma_m, process.sigma_rad];
        (0..poses.len())
            .map(|i| {
                let mut rng = Draw::new(seed, Stage::Path, i as u32).item(1);
                let phi = if i == 0 {
                    0.0
                } else {
                    process.correlation(self.recorded.secs[i] - self.recorded.secs[i - 1])
                };
                for (error, sigma) in error.iter_mut().zip(sigma) {
                    let normal: f64 = StandardNormal.sample(&mut rng);
                    *error = phi * *error + (1.0 - phi * phi).sqrt() * sigma * normal;
                }
                Pose2::new(poses[i].x + error[0], poses[i].y + error[1], poses[i].theta + error[2])
            })
            .collect()
    }

    /// Increments with the error that the scenario's noise doesn't explain.
    fn with_odometry_error(&self, odometry: &[Pose2], seed: u64) -> Vec<Pose2> {
        let error = self.nuisances.odometry_error;
        let mut pose = Pose2::IDENTITY;
        let mut track = vec![pose];
        for (i, pair) in odometry.windows(2).enumerate() {
            let mut rng = Draw::new(seed, Stage::Odometry, i as u32).item(2);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let step = pair[1].relative_to(&pair[0]);
            let stretch = error.sigma_m * normal();
            let along = step.position().normalize_or_zero();
            let turn = error.sigma_rad * normal();
            let step = Pose2::new(
                step.x + stretch * if along.x == 0.0 && along.y == 0.0 { 1.0 } else { along.x },
                step.y + stretch * along.y,
                step.theta + turn,
            );
            pose = pose.compose(&step);
            track.push(pose);
        }
        track
    }
}

/// The statistics of a log beside those of replicates.
pub(crate) struct Null {
    /// The log's statistics in standard deviations of the replicates, over both halves.
    pub z: Vec<f64>,
    /// The same of each half of the log's blocks.
    pub halves: Vec<Halves>,
    /// The log's rank among replicates: p-values of the largest of the library, of the cells, of all.
    pub p_library: f64,
    pub p_omnibus: f64,
    pub p: f64,
    /// What a score of an effect has to exceed to be found at 1 % (standard deviations).
    pub threshold: f64,
    /// Standard deviation of each statistic among the replicates.
    pub spread: Vec<f64>,
    /// Nuisances of the replicates and what else the caller asked for.
    pub fits: Vec<Fitted>,
}

/// Runs the replicates and ranks the log among them.
#[expect(clippy::too_many_arguments, reason = "one call, and each is a thing of its own")]
pub(crate) fn compare(
    replay: &Replay<'_>,
    comparison: &Comparison<'_>,
    views: &Arc<Views<'_>>,
    dictionary: &Dictionary,
    fitted: &Fitted,
    replicates: u32,
    seed: u64,
    stop: &AtomicBool,
    tick: &(dyn Fn() + Sync),
) -> Result<Null, GapError> {
    let effects = replay.nominal.effects_with(replay.effects)?;
    let pit = pit_draw(seed);
    let own = dictionary.of(comparison, &effects, views, fitted, &pit);
    let draw = Draw::new(seed, Stage::Trial, 7);
    let simulated: Vec<(Vec<Halves>, Fitted)> = (0..replicates)
        .into_par_iter()
        .map(|i| {
            if stop.load(Ordering::Relaxed) {
                return Err(GapError::Interrupted);
            }
            let recorded = replay.simulate(draw.seed(i))?;
            let other =
                Comparison { nominal: comparison.nominal, recorded: &recorded, views: Arc::clone(views) };
            let fitted = other.fit_nuisances_with(&effects, &replay.nuisances, REFIT);
            let statistics = dictionary.of(&other, &effects, views, &fitted, &pit_draw(draw.seed(i)));
            tick();
            Ok((statistics, fitted))
        })
        .collect::<Result<_, _>>()?;
    let (statistics, fits): (Vec<_>, Vec<_>) = simulated.into_iter().unzip();
    Ok(rank(dictionary, &own, &statistics, fits))
}

/// By how many standard deviations of its largest statistic a group of statistics has to stand out more than the effects
/// that act on many beams: places and cells are many, and there is one false-alarm rate for all.
const HANDICAP: [f64; GROUPS] = [0.0, 0.8, 0.8];
const GROUPS: usize = 3;

fn rank(dictionary: &Dictionary, own: &[Halves], others: &[Vec<Halves>], fits: Vec<Fitted>) -> Null {
    let count = others.len() + 1;
    let (mut z, mut halves) = (vec![0.0; own.len()], vec![[0.0; 2]; own.len()]);
    let mut spreads = vec![0.0; own.len()];
    // The largest of each group, of each replicate, the log last.
    let mut largest = vec![[0.0_f64; GROUPS]; count];
    for i in 0..own.len() {
        let group = dictionary.group(i);
        // Counts by their roots, whose variance doesn't depend on the mean (Anscombe 1948) and is at most about 1 by
        // chance; of a count that hardly ever happens it is less, and would make a single event stand out.
        let is_count = dictionary.is_count(i);
        let least = if is_count { 1.0 } else { 1e-9 };
        let number = |value: f64| if is_count { 2.0 * (value.max(0.0) + 0.375).sqrt() } else { value };
        let both = |v: &Halves| number(v[0] + v[1]);
        // For the ranks the log counts as one of them, so that all are alike where the simulator is right.
        let values = || others.iter().map(|other| both(&other[i])).chain([both(&own[i])]);
        let (mean, spread) = moments(values(), least);
        for (value, largest) in values().zip(&mut largest) {
            largest[group] = largest[group].max(((value - mean) / spread).abs());
        }
        let (mean, spread) = moments(others.iter().map(|other| both(&other[i])), least);
        z[i] = (both(&own[i]) - mean) / spread;
        spreads[i] = spread;
        for half in 0..2 {
            let (mean, spread) = moments(others.iter().map(|other| number(other[i][half])), least);
            halves[i][half] = (number(own[i][half]) - mean) / spread;
        }
    }
    // Each group in units of its own largest statistic's spread, less its handicap.
    let scales: Vec<(f64, f64)> = (0..GROUPS).map(|g| moments(largest.iter().map(|t| t[g]), 1e-9)).collect();
    for t in &mut largest {
        for g in 0..GROUPS {
            t[g] = (t[g] - scales[g].0) / scales[g].1 - HANDICAP[g];
        }
    }
    let p_of = |of: &dyn Fn(&[f64; GROUPS]) -> f64| {
        let mine = of(&largest[count - 1]);
        largest.iter().filter(|other| of(other) >= mine).count() as f64 / count as f64
    };
    let p_library = p_of(&|t| t[0].max(t[1]));
    let p_omnibus = p_of(&|t| t[2]);
    let all = |t: &[f64; GROUPS]| t.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let p = p_of(&all);
    let mut sorted: Vec<f64> = largest[..count - 1].iter().map(all).collect();
    sorted.sort_by(f64::total_cmp);
    let above = ((0.01 * sorted.len() as f64).ceil() as usize).max(1);
    let threshold = scales[0].0 + scales[0].1 * (sorted[sorted.len() - above] + HANDICAP[0]);
    Null { z, halves, p_library, p_omnibus, p, threshold, spread: spreads, fits }
}

/// Mean and standard deviation; `least` is added to the variance.
fn moments(values: impl Iterator<Item = f64> + Clone, least: f64) -> (f64, f64) {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    (mean, variance.max(least).sqrt())
}

/// How long blocks stay in a log: the policy under which neighbouring scans share as many short readings.
pub(crate) fn fit_persistence(
    nominal: &Nominal,
    recorded: &Recorded,
    fitted: &Fitted,
    seed: u64,
) -> Result<BlockTruth, GapError> {
    let Some(blocks) = nominal.blocks else {
        return Ok(BlockTruth { resample: BlockResampling::EachObservation, density_over_fit: 1.0 });
    };
    let replay = |resample| Replay {
        nominal,
        recorded,
        effects: &[],
        nuisances: fitted.nuisances,
        blocks: BlockTruth { resample, density_over_fit: 1.0 },
    };
    let shared = |recorded: &Recorded| shared_shorts(&Comparison::new(nominal, recorded), fitted);
    let own = shared(recorded);
    let mut policies = vec![
        BlockResampling::EachObservation,
        BlockResampling::EachScanN(3),
        BlockResampling::EachScanN(10),
        BlockResampling::EachScanN(40),
        BlockResampling::Never,
    ];
    if !policies.contains(&blocks.resample) {
        policies.push(blocks.resample);
    }
    let draw = Draw::new(seed, Stage::Trial, 8);
    let distances = policies
        .iter()
        .map(|&resample| {
            let replay = replay(resample);
            let logs = (0..6)
                .into_par_iter()
                .map(|i| Ok(shared(&replay.simulate(draw.seed(i))?)))
                .collect::<Result<Vec<_>, GapError>>()?;
            let distance = (0..LAGS.len()).map(|lag| {
                let mean = logs.iter().map(|log| log[lag]).sum::<f64>() / logs.len() as f64;
                (mean - own[lag]).abs()
            });
            // The nominal policy is kept where it is as good.
            let handicap = if resample == blocks.resample { 0.0 } else { 0.02 };
            Ok(distance.sum::<f64>() + handicap)
        })
        .collect::<Result<Vec<f64>, GapError>>()?;
    let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
    // Of those that are about as good the one under which blocks stay longest: it takes least for a discovery.
    let resample = policies
        .iter()
        .zip(&distances)
        .filter(|(_, distance)| **distance <= 1.3 * least + 0.02)
        .map(|(policy, _)| *policy)
        .max_by_key(|policy| match policy {
            BlockResampling::EachObservation => 1,
            BlockResampling::EachScanN(scans) => *scans,
            BlockResampling::Never => u32::MAX,
        })
        .unwrap_or(blocks.resample);
    let replay = replay(resample);
    let ratios = (0..12)
        .into_par_iter()
        .map(|i| {
            let simulated = replay.simulate(draw.seed(100 + i))?;
            let refitted = Comparison::new(nominal, &simulated).fit_nuisances(&fitted.nuisances, 4);
            Ok(refitted.nuisances.block_density)
        })
        .collect::<Result<Vec<f64>, GapError>>()?;
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    Ok(BlockTruth { resample, density_over_fit: (fitted.nuisances.block_density / mean).clamp(0.5, 2.0) })
}

/// Numbers of scans after which blocks are looked for where they were.
const LAGS: [usize; 4] = [1, 4, 16, 64];

/// Share of cells of the map with a short reading in a scan that have one again so many scans later.
fn shared_shorts(comparison: &Comparison<'_>, fitted: &Fitted) -> [f64; LAGS.len()] {
    let mut cells = vec![HashSet::new(); comparison.views.scans()];
    let effects = &comparison.nominal.effects;
    comparison.for_each_reading(&comparison.views, effects, fitted, |scan, i, _, _, z, terms| {
        if terms.short > 0.5 {
            let beam = &comparison.views.beams[i];
            let heading = comparison.recorded.poses[scan].theta + beam.view.bearing;
            let back = beam.view.range - z;
            let end = beam.view.endpoint;
            let (x, y) = (end.x - back * heading.cos(), end.y - back * heading.sin());
            cells[scan].insert(cell_at(x, y, OBJECT_CELL_M));
        }
    });
    LAGS.map(|lag| {
        let pairs = cells.iter().zip(cells.iter().skip(lag));
        let (both, all) = pairs.fold((0, 1), |(both, all), (here, later)| {
            (both + here.intersection(later).count(), all + here.len())
        });
        both as f64 / f64::from(all as u32)
    })
}
