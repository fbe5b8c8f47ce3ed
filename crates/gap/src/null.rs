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
pub(crate) const REFIT: usize = 4;

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
    /// How much each statistic says: minus the logarithm of the chance that one of its group says as much, over the
    /// group's share of the false-alarm rate.
    pub weight: Vec<f64>,
    /// The largest weight of each replicate, in order.
    pub largest: Vec<f64>,
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
    tick: &(dyn Fn(u64) + Sync),
) -> Result<Null, GapError> {
    let effects = replay.nominal.effects_with(replay.effects)?;
    let pit = pit_draw(seed);
    let own = dictionary.of(comparison, &effects, views, fitted, &pit);
    let draw = Draw::new(seed, Stage::Trial, 7);
    let one = |i: u32| {
        if stop.load(Ordering::Relaxed) {
            return Err(GapError::Interrupted);
        }
        let recorded = replay.simulate(draw.seed(i))?;
        let other = Comparison { nominal: comparison.nominal, recorded: &recorded, views: Arc::clone(views) };
        let fitted = other.fit_nuisances_with(&effects, &replay.nuisances, REFIT);
        let statistics = dictionary.of(&other, &effects, views, &fitted, &pit_draw(draw.seed(i)));
        tick(1);
        Ok((statistics, fitted))
    };
    let (mut statistics, mut fits) = (Vec::new(), Vec::new());
    let mut begun = 0;
    loop {
        let end = if begun == 0 { replicates.min(FIRST_LOOK) } else { replicates };
        let more = (begun..end).into_par_iter().map(one).collect::<Result<Vec<_>, GapError>>()?;
        for (of_log, fitted) in more {
            statistics.push(of_log);
            fits.push(fitted);
        }
        begun = end;
        let null = rank(dictionary, &own, &statistics);
        if begun == replicates || null.p > CLEARLY_NOTHING {
            tick(u64::from(replicates - begun));
            return Ok(Null { fits, ..null });
        }
    }
}

/// After so many replicates a log that is off no more than this share of them is left alone: that more of them would make
/// it a discovery is as good as impossible, and only what all of them say is one (Besag and Clifford 1991).
const FIRST_LOOK: u32 = 199;
const CLEARLY_NOTHING: f64 = 0.1;

/// How the false-alarm rate is shared out among groups of statistics: effects that act on many beams, effects at one of
/// many places, cells, objects among blocks. Each gets its share however many statistics it has.
const SHARES: [f64; GROUPS] = [0.6, 0.2, 0.15, 0.05];
const GROUPS: usize = 4;

fn rank(dictionary: &Dictionary, own: &[Halves], others: &[Vec<Halves>]) -> Null {
    let count = others.len() + 1;
    let (mut z, mut halves) = (vec![0.0; own.len()], vec![[0.0; 2]; own.len()]);
    let mut spreads = vec![0.0; own.len()];
    // The largest of each group, of each replicate, the log last.
    let mut largest = vec![[0.0_f64; GROUPS]; count];
    let mut values = vec![0.0; count];
    for i in 0..own.len() {
        let group = dictionary.group(i);
        // Counts by their roots, whose variance doesn't depend on the mean (Anscombe 1948) and is at most about 1 by
        // chance; of a count that hardly ever happens it is less, and would make a single event stand out.
        let is_count = dictionary.is_count(i);
        let number = |value: f64| if is_count { 2.0 * (value.max(0.0) + 0.375).sqrt() } else { value };
        for half in 0..2 {
            let replicates = others.iter().map(|other| number(other[i][half]));
            halves[i][half] = Moments::of(replicates).normal(number(own[i][half]), is_count);
        }
        for (value, log) in values.iter_mut().zip(others.iter().map(|other| &other[i]).chain([&own[i]])) {
            *value = number(log[0] + log[1]);
        }
        // Each by what all others say, so that log and replicates are alike where the simulator is right.
        let all = Moments::of(values.iter().copied());
        for (value, largest) in values.iter().zip(&mut largest) {
            let normal = all.without(*value).normal(*value, is_count);
            largest[group] = largest[group].max(dictionary.off(i, normal));
        }
        let rest = all.without(values[count - 1]);
        z[i] = rest.normal(values[count - 1], is_count);
        spreads[i] = rest.variance().sqrt();
    }
    // Each group's largest as a p-value over the group's share, as a logarithm.
    let tails: Vec<Tail> = (0..GROUPS).map(|g| Tail::of(largest.iter().map(|t| t[g]))).collect();
    let weighed: Vec<[f64; GROUPS]> = largest
        .iter()
        .map(|t| std::array::from_fn(|g| tails[g].minus_log_p(t[g]) + SHARES[g].ln()))
        .collect();
    let p_of = |of: &dyn Fn(&[f64; GROUPS]) -> f64| {
        let mine = of(&weighed[count - 1]);
        weighed.iter().filter(|other| of(other) >= mine).count() as f64 / count as f64
    };
    let p_library = p_of(&|t| t[0].max(t[1]).max(t[3]));
    let p_omnibus = p_of(&|t| t[2]);
    let all = |t: &[f64; GROUPS]| t.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let p = p_of(&all);
    let mut sorted: Vec<f64> = weighed[..count - 1].iter().map(all).collect();
    sorted.sort_by(f64::total_cmp);
    let above = ((0.01 * sorted.len() as f64).ceil() as usize).max(1);
    let weight = (0..own.len())
        .map(|i| {
            let group = dictionary.group(i);
            tails[group].minus_log_p(dictionary.off(i, z[i])) + SHARES[group].ln()
        })
        .collect();
    let threshold = tails[0].at(sorted[sorted.len() - above] - SHARES[0].ln());
    Null {
        z,
        halves,
        p_library,
        p_omnibus,
        p,
        weight,
        largest: sorted,
        threshold,
        spread: spreads,
        fits: Vec::new(),
    }
}

impl Null {
    /// The weight that the largest of a log without anything exceeds with this chance.
    pub fn weight_at(&self, chance: f64) -> f64 {
        let rank = ((1.0 - chance) * self.largest.len() as f64) as usize;
        self.largest[rank.min(self.largest.len() - 1)]
    }
}

/// The upper tail of a sample: exponential beyond its ninth decile.
struct Tail {
    decile: f64,
    scale: f64,
    sorted: Vec<f64>,
}

impl Tail {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[((share * sorted.len() as f64) as usize).min(sorted.len() - 1)];
        let (decile, high) = (at(0.9), at(0.98));
        Self { decile, scale: ((high - decile) / 5.0_f64.ln()).max(1e-3), sorted }
    }

    /// Minus the logarithm of the chance of a value as large.
    fn minus_log_p(&self, value: f64) -> f64 {
        if value > self.decile {
            return 10.0_f64.ln() + (value - self.decile) / self.scale;
        }
        let above = self.sorted.len() - self.sorted.partition_point(|v| *v < value);
        -(above as f64 / self.sorted.len() as f64).ln()
    }

    /// The value of a chance below a tenth.
    fn at(&self, minus_log_p: f64) -> f64 {
        self.decile + (minus_log_p - 10.0_f64.ln()).max(0.0) * self.scale
    }
}

/// The first three moments of a sample, as sums about its first value.
#[derive(Clone, Copy, Default)]
struct Moments {
    about: f64,
    count: f64,
    sums: [f64; 3],
}

impl Moments {
    fn of(mut values: impl Iterator<Item = f64>) -> Self {
        let about = values.next().unwrap_or(0.0);
        let mut all = Self { about, count: 1.0, sums: [0.0; 3] };
        for value in values {
            all.add(value, 1.0);
        }
        all
    }

    fn add(&mut self, value: f64, times: f64) {
        let x = value - self.about;
        for (sum, power) in self.sums.iter_mut().zip([x, x * x, x * x * x]) {
            *sum += times * power;
        }
        self.count += times;
    }

    /// The sample less one of its values.
    fn without(mut self, value: f64) -> Self {
        self.add(value, -1.0);
        self
    }

    fn mean(&self) -> f64 {
        self.about + self.sums[0] / self.count
    }

    fn variance(&self) -> f64 {
        let mean = self.sums[0] / self.count;
        ((self.sums[1] - self.count * mean * mean) / (self.count - 1.0).max(1.0)).max(0.0)
    }

    fn skewness(&self) -> f64 {
        let [a, b, c] = self.sums.map(|sum| sum / self.count);
        let variance = b - a * a;
        if variance <= 1e-12 * b.abs() {
            0.0
        } else {
            (c - 3.0 * a * b + 2.0 * a.powi(3)) / variance.powf(1.5)
        }
    }

    /// A value as a standard normal number, if the sample is of a shifted gamma distribution (Pearson's type III; the
    /// cube root of Wilson and Hilferty 1931): sums of rare contributions are skewed, and would be taken for
    /// discoveries. Roots of counts are as good as normal, with a variance of 1 or more where they happen at all.
    fn normal(&self, value: f64, is_count: bool) -> f64 {
        if is_count {
            return (value - self.mean()) / self.variance().max(1.0).sqrt();
        }
        let t = (value - self.mean()) / self.variance().max(1e-9).sqrt();
        let skewness = self.skewness().clamp(-MOST_SKEWED, MOST_SKEWED);
        // Only the heavy side: how light the other one is, so few logs can't say.
        if skewness.abs() < LEAST_SKEWED || t * skewness < 0.0 {
            return t;
        }
        let shape = 4.0 / (skewness * skewness);
        let ratio = (1.0 + t * skewness.signum() / shape.sqrt()).max(0.0);
        skewness.signum() * 3.0 * shape.sqrt() * (ratio.cbrt() - 1.0 + 1.0 / (9.0 * shape))
    }
}

/// A sample's skewness counts as no more than this, and as none below that: of 200 numbers its error is 0.17.
const MOST_SKEWED: f64 = 2.0;
const LEAST_SKEWED: f64 = 0.25;

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

#[cfg(test)]
mod tests {
    use super::*;
    use statrs::distribution::{ContinuousCDF, Gamma, Normal};

    /// Quantiles of a gamma distribution of shape 4, skewness 1, become those of a normal one on its heavy side.
    #[test]
    fn skewed_sums_become_normal() {
        let gamma = Gamma::new(4.0, 0.5).unwrap();
        let normal = Normal::new(0.0, 1.0).unwrap();
        let sample = (0..20_000).map(|i| gamma.inverse_cdf((f64::from(i) + 0.5) / 20_000.0));
        let moments = Moments::of(sample);
        for p in [0.9, 0.99, 0.999, 0.9999] {
            let (z, plain) = (moments.normal(gamma.inverse_cdf(p), false), normal.inverse_cdf(p));
            assert!((z - plain).abs() < 0.05, "{p}: {z} for {plain}");
        }
        // Mirrored, the heavy side is the other one.
        let mirrored = (0..20_000).map(|i| -gamma.inverse_cdf((f64::from(i) + 0.5) / 20_000.0));
        let z = Moments::of(mirrored).normal(-gamma.inverse_cdf(0.999), false);
        assert!((z - normal.inverse_cdf(0.001)).abs() < 0.05, "{z}");
    }

    #[test]
    fn a_sample_without_a_value_is_the_rest() {
        let values = [3.0, 8.5, -1.0, 4.25, 0.5];
        let rest = Moments::of(values[1..].iter().copied());
        let without = Moments::of(values.iter().copied()).without(3.0);
        assert!((rest.mean() - without.mean()).abs() < 1e-12);
        assert!((rest.variance() - without.variance()).abs() < 1e-12);
        assert!((rest.skewness() - without.skewness()).abs() < 1e-12);
    }

    /// Of an exponential sample the tail goes on as it is.
    #[test]
    fn a_tail_is_continued() {
        let sample = (0..1000).map(|i| -((f64::from(i) + 0.5) / 1000.0).ln());
        let tail = Tail::of(sample);
        for minus_log_p in [0.5, 2.0, 4.0, 8.0] {
            assert!((tail.minus_log_p(minus_log_p) - minus_log_p).abs() < 0.03 * minus_log_p + 0.02);
        }
        assert!((tail.at(tail.minus_log_p(6.0)) - 6.0).abs() < 1e-9);
    }
}
