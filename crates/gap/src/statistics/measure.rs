//! The statistics of a log.

use std::collections::HashSet;
use std::f64::consts::TAU;

use locsim_core::Draw;
use rand::RngExt;

use super::dictionary::{Dense, Dictionary};
use super::{
    BLOCK, Halves, OBJECT_CELL_M, RATIO_BIN, RATIO_BINS, SECTOR_RANGE_M, SECTORS, SLIP_SHARES, STEPS_M,
    cell_at, contaminated, just_seen,
};
use crate::hypothesis::{Comparison, Fitted, Nuisances};
use crate::likelihood::{Density, Terms, near_density, normal_density};
use crate::odometry::{deviation, increments, slip_ratios, standardized};
use crate::views::Beam;

impl Dictionary {
    /// Whether a reading is of something in front of what the map has there.
    pub fn is_in_front(&self, beam: &Beam, shift: f64, z: f64, terms: &Terms) -> bool {
        z < self.max && z < beam.range() + shift - 4.0 * terms.sigma.min(0.1)
    }

    /// Whether a reading is of something behind what the map has there.
    fn is_behind(&self, beam: &Beam, shift: f64, z: f64, terms: &Terms) -> bool {
        z < self.max && z > beam.range() + shift + 5.0 * terms.sigma.min(0.1)
    }

    /// Density of a reading of a beam that its wall lets through, relative to what it is, less 1.
    pub fn glass_ratio(&self, beam: &Beam, shift: f64, z: f64, terms: &Terms) -> f64 {
        let through = if z < self.max {
            let sigma = terms.sigma.min(0.1);
            let far = beam.view.behind.map_or(0.0, |behind| near_density(z, behind + shift, sigma, self.max));
            // What stands behind is often not on the map.
            0.5 * far + if self.is_behind(beam, shift, z, terms) { 0.5 / self.max } else { 0.0 }
        } else {
            0.5
        };
        Density::contamination(terms, through)
    }

    /// All statistics of a log, `fitted` to it. Which ones are looked at is the `hypothesis`'s to say, for the log and its
    /// replicates alike: where a replicate's errors of the reference happen to be found to be none, or to be some, a
    /// statistic that only it has would be an outlier among them.
    pub fn of(
        &self,
        comparison: &Comparison<'_>,
        effects: &locsim_world::effect::Effects,
        fitted: &Fitted,
        hypothesis: &Nuisances,
        pit: &Draw,
    ) -> Vec<Halves> {
        let mut out = vec![[0.0; 2]; self.len()];
        let views = &*comparison.views;
        let n = views.beams.len();
        let k = views.per_scan;
        let max = comparison.nominal.laser.max_range_m;
        let mut scores: [Vec<f32>; 5] = std::array::from_fn(|_| vec![0.0; n]);
        let mut depth = [[0.0; 2]; 2];
        let mut in_cells = vec![[0.0; 2]; self.objects.len()];
        let mut places_of_sectors = HashSet::new();
        let mut in_sectors = vec![[0.0; 2]; SECTORS * self.sector_ranges];
        let mut whole = vec![[0.0_f64; 3]; views.scans()];
        comparison.for_each_reading(views, effects, fitted, |scan, i, density, shift, z, terms| {
            let half = (scan / BLOCK) % 2;
            let beam = &views.beams[i];
            let is_return = z < max;
            let t = terms.error / terms.sigma;
            let g = |other| Density::contamination(&terms, other);
            if is_return {
                scores[0][i] = (terms.hit * terms.error / terms.sigma.powi(2)) as f32;
                scores[1][i] = (terms.hit * (t * t - 1.0)) as f32;
            }
            if beam.range() < max {
                scores[2][i] = g(f64::from(u8::from(!is_return))) as f32;
                let tail = if is_return && terms.hit > 0.0 || terms.sigma.is_finite() {
                    normal_density(t / 5.0) / (5.0 * terms.sigma)
                } else {
                    0.0
                };
                if is_return {
                    scores[4][i] = g(tail) as f32;
                }
            }
            let uniform = if is_return { 1.0 / max } else { 0.0 };
            scores[3][i] = ((uniform / terms.density) - 1.0) as f32;
            if let Some([near, far]) = self.jumps[i] {
                let inside = is_return && (near..far).contains(&z);
                let ratio = g(if inside { 1.0 / (far - near) } else { 0.0 });
                out[self.mixed][half] += contaminated(ratio, self.mixed_share);
            }
            let wall = self.wall[i];
            if wall != u32::MAX {
                let wall = wall as usize;
                if is_return {
                    out[self.moved_wall + wall][half] += moved_wall_score(beam, &terms);
                }
                out[self.glass + wall][half] +=
                    contaminated(self.glass_ratio(beam, shift, z, &terms), self.wall_share[wall]);
            }
            // Things in front may stand where no block does.
            let in_front = self.is_in_front(beam, shift, z, &terms);
            if in_front {
                let heading = comparison.recorded.track.poses()[scan].theta + beam.view.bearing;
                let back = beam.view.range - z;
                let end = beam.view.endpoint;
                let cell = cell_at(end.x - back * heading.cos(), end.y - back * heading.sin(), OBJECT_CELL_M);
                if let Some(&index) = self.objects.get(&cell) {
                    in_cells[index as usize][half] += 1.0;
                }
                // What is seen at one place of the map again and again isn't on the robot.
                let range = (z / SECTOR_RANGE_M) as usize;
                if range < self.sector_ranges {
                    let bin = usize::from(self.sector_of[i % k]) * self.sector_ranges + range;
                    if places_of_sectors.insert((bin, half, cell)) {
                        in_sectors[bin][half] += 1.0;
                    }
                }
                // Whether blocks can stand there as the hypothesis has them is just what is asked.
                depth[0][half] += (beam.range() - z).min(DEEPEST_M);
                depth[1][half] += 1.0;
            }
            if is_return {
                for (s, [cos, sin]) in phases(z).into_iter().enumerate() {
                    out[self.steps + 2 * s][half] += cos;
                    out[self.steps + 2 * s + 1][half] += sin;
                }
            }
            let u = if is_return {
                density.cdf(beam, shift, z)
            } else {
                1.0 - terms.density.min(1.0) * pit.at(scan as u32).item(i as u32).random::<f64>()
            };
            let missing = f64::from(u8::from(!is_return && beam.range() < max));
            let beyond = is_return && self.is_behind(beam, shift, z, &terms);
            let long = f64::from(u8::from(beyond));
            let values = [u - 0.5, (u - 0.5).powi(2) - 1.0 / 12.0, terms.short, missing, long];
            if is_return && (in_front || beyond) {
                let bin = (z / ((beam.range() + shift) * RATIO_BIN)) as usize;
                out[self.ratios + bin.min(RATIO_BINS - 1)][half] += 1.0;
            }
            for (sum, value) in whole[scan].iter_mut().zip([values[0], values[2], values[3]]) {
                *sum += value;
            }
            out[self.whole + 3 + ((10.0 * u) as usize).min(9)][half] += 1.0;
            for &cell in &self.cell_of[i] {
                if cell != u32::MAX {
                    for (v, value) in values.iter().enumerate() {
                        out[cell as usize + v][half] += value;
                    }
                }
            }
        });
        for (i, of_scan) in whole.windows(2).enumerate() {
            for kind in 0..3 {
                // What changes from scan to scan; what stays is for other cells.
                out[self.whole + kind][(i / BLOCK) % 2] += (of_scan[1][kind] - of_scan[0][kind]).powi(2);
            }
        }
        for Dense { score, index, weights, share } in &self.dense {
            // Fitted errors of the reference take in what moves whole scans; the patterns look for it in the errors.
            if self.moves_scans(*index) && !hypothesis.pose_error.is_none() {
                continue;
            }
            let scores = &scores[*score as usize];
            for scan in 0..views.scans() {
                let beams = scan * k..(scan + 1) * k;
                let pairs = scores[beams.clone()].iter().zip(&weights[beams]).map(|(s, w)| s * w);
                let sum: f32 = if *share > 0.0 {
                    pairs.map(|ratio| ratio / (1.0 + share * ratio)).sum()
                } else {
                    pairs.sum()
                };
                out[*index][(scan / BLOCK) % 2] += f64::from(sum);
            }
        }
        let walls = self.wall_share.len();
        for first in [self.moved_wall, self.glass] {
            for (p, pair) in self.wall_pairs.iter().enumerate() {
                out[first + walls + p] =
                    std::array::from_fn(|half| pair.iter().map(|&i| out[first + i as usize][half]).sum());
            }
        }
        for (window, cells) in self.object_windows.iter().enumerate() {
            for &cell in cells.iter().filter(|&&cell| cell != u32::MAX) {
                for half in 0..2 {
                    out[self.first_object + window][half] += in_cells[cell as usize][half];
                }
            }
        }
        let ranges = self.sector_ranges;
        for s in 0..SECTORS - 1 {
            for r in 0..ranges - 1 {
                let corner = s * ranges + r;
                let window = [corner, corner + 1, corner + ranges, corner + ranges + 1];
                out[self.sector + s * (ranges - 1) + r] =
                    std::array::from_fn(|half| window.iter().map(|&i| in_sectors[i][half]).sum());
            }
        }
        for half in 0..2 {
            out[self.depth][half] = depth[0][half] / (depth[1][half] + 1.0);
            out[self.density][half] = 0.5 * fitted.nuisances.block_density.ln();
        }
        for (p, score) in
            fitted.pattern_scores.iter().enumerate().filter(|_| !hypothesis.pose_error.is_none())
        {
            // Of the log as a whole.
            out[self.patterns + p] = [0.5 * score; 2];
        }
        let track = comparison.corrected(&fitted.corrections);
        let all = increments(comparison.nominal, effects, &track, &comparison.recorded.odometry);
        // Correlations, so that they don't depend on how large the reference's errors are taken to be.
        let seen = just_seen(all.len() as f64);
        let mut sums = [[Correlation::default(); 3]; 2];
        for (scan, increment) in all.iter().enumerate() {
            let [distance, turn] = standardized(increment, &fitted.nuisances.odometry_error);
            let [ds, dtheta] = increment.truth;
            let error = &fitted.nuisances.odometry_error;
            let [of_distance, of_turn] = [0, 1].map(|axis| deviation(increment, error, axis));
            let half = (scan / BLOCK) % 2;
            let [scale, turn_scale, imbalance] = &mut sums[half];
            scale.add(distance, ds / of_distance);
            turn_scale.add(turn, dtheta / of_turn);
            imbalance.add(turn, ds / of_turn);
            for (i, share) in SLIP_SHARES.into_iter().enumerate() {
                let [longer, shorter] = slip_ratios(increment, error, share).map(|r| contaminated(r, seen));
                out[self.odometry + sums[half].len() + i][half] += longer - shorter;
            }
        }
        for (half, sums) in sums.iter().enumerate() {
            for (i, correlation) in sums.iter().enumerate() {
                out[self.odometry + i][half] = correlation.value();
            }
        }
        out
    }
}

/// Readings farther in front of a wall are hardly of blocks \[m\].
const DEEPEST_M: f64 = 1.5;

/// Cosine and sine of 2 pi z over each of [`STEPS_M`]: all but one are powers of one complex number.
fn phases(z: f64) -> [[f64; 2]; STEPS_M.len()] {
    let phase = |step: f64| {
        let (sin, cos) = (TAU * z / step).sin_cos();
        [cos, sin]
    };
    let times = |[a, b]: [f64; 2], [c, d]: [f64; 2]| [a * c - b * d, a * d + b * c];
    let square = |a| times(a, a);
    let tenth = phase(0.1);
    let of_50 = square(tenth);
    let of_25 = square(of_50);
    let of_20 = times(of_25, tenth);
    let of_10 = square(of_20);
    let of_5 = square(of_10);
    let of_2 = times(square(of_5), of_10);
    [of_2, phase(0.003), of_5, of_10, of_20, of_25, of_50]
}

/// What a reading says of how far a wall is moved.
pub(crate) fn moved_wall_score(beam: &Beam, terms: &Terms) -> f64 {
    if terms.sigma.is_infinite() {
        return 0.0;
    }
    terms.hit * terms.error / terms.sigma.powi(2) / beam.view.incidence.cos().max(0.17)
}

/// Correlation of two numbers about zero, times the root of how many there are.
#[derive(Clone, Copy, Default)]
struct Correlation {
    xy: f64,
    xx: f64,
    yy: f64,
    count: f64,
}

impl Correlation {
    fn add(&mut self, x: f64, y: f64) {
        self.xy += x * y;
        self.xx += x * x;
        self.yy += y * y;
        self.count += 1.0;
    }

    fn value(&self) -> f64 {
        self.xy / (self.xx * self.yy).sqrt().max(1e-300) * self.count.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use locsim_world::effect::{Effect, EffectKind};

    use super::*;
    use crate::fixtures::{NOMINAL, TRUTH};
    use crate::hidden::{Regime, record_library};
    use crate::statistics::{Seed, Target, pit_draw};
    use crate::{PoseError, Recorded};

    /// Blocks three times as deep seem more than twice as deep, though nominal ones can't stand where most of them are seen.
    #[test]
    fn deep_blocks_are_seen_where_nominal_ones_cannot_stand() {
        let depth = |factor: f64| {
            let deeper = Effect::new(EffectKind::BlockDepth, vec![factor], Vec::new()).unwrap();
            let drive = record_library(&NOMINAL, &TRUTH, &[deeper], Regime::default(), 2).unwrap();
            let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let dictionary = Dictionary::new(&comparison);
            let (fitted, none) = (comparison.start(&Nuisances::default()), Nuisances::default());
            let all = dictionary.of(&comparison, &NOMINAL.effects, &fitted, &none, &pit_draw(1));
            all[dictionary.depth].iter().sum::<f64>()
        };
        let (nominal, deep) = (depth(1.0), depth(3.0));
        assert!(deep > 2.0 * nominal, "{nominal} {deep}");
    }

    /// What stands in the room is seen at one place of it many times, at one bearing and range from the robot few times; what stands
    /// on the robot the other way round.
    #[test]
    fn what_stands_in_the_room_is_not_on_the_robot() {
        let most = |kind, values: &[f64], looked_for: EffectKind| {
            let effect = Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
            let regime = Regime { persistent_blocks: true, pose_error: None };
            let drive = record_library(&NOMINAL, &TRUTH, &[effect], regime, 2).unwrap();
            let recorded = Recorded::new(&drive, 200, 72, |_| true).unwrap();
            let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
            let dictionary = Dictionary::new(&comparison);
            let (fitted, none) = (comparison.start(&Nuisances::default()), Nuisances::default());
            let all = dictionary.of(&comparison, &NOMINAL.effects, &fitted, &none, &pit_draw(1));
            let own = dictionary.targets.iter().zip(&all).filter(
                |(target, _)| matches!(target, Target::Effect(kind, Seed::Object(_) | Seed::Values(_)) if *kind == looked_for),
            );
            own.map(|(_, halves)| halves.iter().sum::<f64>()).fold(0.0, f64::max)
        };
        let post = [2.6, 2.0, 0.05];
        let [seen, as_sector] = [EffectKind::MissingObject, EffectKind::SectorOcclusion]
            .map(|looked_for| most(EffectKind::MissingObject, &post, looked_for));
        assert!(as_sector < 0.2 * seen && seen > 100.0, "{as_sector} {seen}");
        let cable = [0.4, 0.8, 0.3, 0.2];
        let seen = most(EffectKind::SectorOcclusion, &cable, EffectKind::SectorOcclusion);
        assert!(seen > 3.0 * as_sector, "{as_sector} {seen}");
    }

    /// Whether a displaced laser is looked for in the readings or in the errors of the reference is the same for a log and for
    /// all replicates, whatever errors are found in each.
    #[test]
    fn what_is_looked_at_is_the_hypothesis_s_to_say() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 2).unwrap();
        let recorded = Recorded::new(&drive, 60, 24, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let dictionary = Dictionary::new(&comparison);
        let errors = [PoseError::NONE, Regime::POSE_ERROR];
        let nuisances = errors.map(|pose_error| Nuisances { pose_error, ..Nuisances::default() });
        let offset = |target: &Target| matches!(target, Target::Effect(EffectKind::MountOffset, _));
        let looked_at = |found: &Nuisances, hypothesis: &Nuisances| {
            let mut fitted = comparison.start(found);
            fitted.pattern_scores = [3.0; 4];
            let all = dictionary.of(&comparison, &NOMINAL.effects, &fitted, hypothesis, &pit_draw(1));
            let of_offset = dictionary.targets.iter().zip(all).filter(|(target, _)| offset(target));
            of_offset.map(|(_, halves)| halves != [0.0; 2]).collect::<Vec<_>>()
        };
        for found in &nuisances {
            // Along x and along y: in the readings, then in the errors.
            assert_eq!(looked_at(found, &nuisances[0]), [true, true, false, false]);
            assert_eq!(looked_at(found, &nuisances[1]), [false, false, true, true]);
        }
    }

    #[test]
    fn phases_are_those_of_the_steps() {
        for z in [0.0, 0.4567, 3.21, 7.999] {
            for (step, [cos, sin]) in STEPS_M.into_iter().zip(phases(z)) {
                let angle = TAU * z / step;
                assert!((cos - angle.cos()).abs() < 1e-9 && (sin - angle.sin()).abs() < 1e-9, "{z} {step}");
            }
        }
    }

    /// At the share itself the score's mean is 0: sum of q ratio / (1 + share ratio) over two outcomes of probability
    /// q = p (1 + share ratio), p those of the hypothesis.
    #[test]
    fn the_score_of_a_contamination_has_no_mean_at_its_share() {
        let (p, share) = ([0.9, 0.1], 0.05);
        // Under the contamination alone: 0.2 and 0.8.
        let ratios = [0.2 / 0.9 - 1.0, 0.8 / 0.1 - 1.0];
        let mean: f64 =
            p.iter().zip(ratios).map(|(p, r)| p * (1.0 + share * r) * contaminated(r, share)).sum();
        assert!(mean.abs() < 1e-12, "{mean}");
    }
}
