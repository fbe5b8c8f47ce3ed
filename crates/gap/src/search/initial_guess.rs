//! Where fits start: kinds of effect, strengths, places, by the statistics that are farthest off.

use glam::DVec2;
use locsim_world::effect::EffectKind;

use super::{Round, State};
use crate::fit::Start;
use crate::likelihood::Terms;
use crate::statistics::{OBJECT_CELL_M, SECTOR_RANGE_M, Seed, Target, cell_at, moved_wall_score, wall_cell};
use crate::views::Beam;

/// Directions of a kind of effect: how far the log is off, and the index of the statistic.
type Directions = Vec<(f64, usize)>;

impl<'a> State<'a> {
    /// Kinds with where their fits start, the most promising first: those whose own direction is as far off as `chance`
    /// of all logs without anything are in some direction. Unmapped blocks that stay look like missing objects, in every
    /// such log.
    pub fn starts(&self, round: &Round<'a>, count: usize, chance: f64) -> Vec<(EffectKind, Vec<Start>)> {
        let least = round.null.weight_at(chance);
        let is_there = |kind: EffectKind| {
            let mut all = self.nominal.effects.list().iter().chain(&round.effects);
            all.any(|effect| effect.kind == kind)
        };
        let mut best: Vec<(EffectKind, f64, Directions)> = Vec::new();
        for (i, target) in round.dictionary.targets.iter().enumerate() {
            let Target::Effect(kind, _) = target else { continue };
            // The density of blocks is fitted along with everything else; see `block_density`.
            if self.options.without.contains(kind) || *kind == EffectKind::BlockDensity {
                continue;
            }
            // A world has one way of slipping.
            if *kind == EffectKind::WheelSlip && is_there(*kind) {
                continue;
            }
            let z = round.null.z[i];
            match best.iter_mut().find(|(known, ..)| known == kind) {
                Some((_, largest, all)) => {
                    *largest = largest.max(round.null.weight[i]);
                    all.push((z, i));
                }
                None => best.push((*kind, round.null.weight[i], vec![(z, i)])),
            }
        }
        best.sort_by(|a, b| b.1.total_cmp(&a.1));
        best.truncate(count);
        best.retain(|(_, weight, _)| *weight >= least);
        best.into_iter()
            .map(|(kind, _, mut all)| {
                all.sort_by(|a, b| round.says(b.1, a.1));
                // Places among blocks are no starts where others say more.
                let group = round.dictionary.group(all[0].1);
                all.retain(|(_, i)| round.dictionary.group(*i) == group);
                let starts = self.starts_of(kind, &all, round);
                (kind, starts)
            })
            .filter(|(_, starts)| !starts.is_empty())
            .collect()
    }

    fn starts_of(&self, kind: EffectKind, all: &[(f64, usize)], round: &Round<'a>) -> Vec<Start> {
        let typical: Vec<f64> = kind.parameters().iter().map(|parameter| parameter.start).collect();
        let initial = |i: usize| match &round.dictionary.targets[i] {
            Target::Effect(_, initial) => initial.clone(),
            Target::Cell(_) => Seed::None,
        };
        let two_sided = kind.parameters()[0].lo < kind.parameters()[0].neutral;
        let signed = |mut values: Vec<f64>, z: f64| {
            if two_sided && z < 0.0 {
                values[0] = kind.parameters()[0].neutral - (values[0] - kind.parameters()[0].neutral);
            }
            values
        };
        match kind {
            EffectKind::MountOffset => {
                // Both axes at once: the two statistics come in the dictionary's order.
                let mut values = vec![0.0; 2];
                for &(z, i) in all {
                    if let Seed::Values(seed_values) = initial(i) {
                        for (axis, value) in seed_values {
                            if value != 0.0 {
                                values[axis] = value * z.signum();
                            }
                        }
                    }
                }
                vec![Start { values, place: Vec::new() }]
            }
            EffectKind::Glass | EffectKind::MovedWall => walls(round, kind, all, 2)
                .into_iter()
                .flat_map(|(value, stretch)| {
                    // A wall that is moved far has no score: a typical strength is tried as well.
                    [vec![value], signed(typical.clone(), value)]
                        .map(|values| Start { values, place: vec![stretch] })
                })
                .collect(),
            EffectKind::MissingObject => all
                .iter()
                .filter(|(z, _)| *z > 0.0)
                .take(3)
                .filter_map(|&(_, i)| match initial(i) {
                    Seed::Object(cell) => {
                        let at = object_at(round, cell);
                        Some(Start { values: vec![at.x, at.y, 0.05], place: Vec::new() })
                    }
                    _ => None,
                })
                .collect(),
            EffectKind::SectorOcclusion => all
                .iter()
                .filter(|(z, _)| *z > 0.0)
                .take(2)
                .map(|&(_, i)| Start { values: self.sector(round, i, &typical), place: Vec::new() })
                .collect(),
            _ => {
                let most = if kind.parameters().len() > 1 { 2 } else { 1 };
                all.iter()
                    .take(most)
                    .map(|&(z, i)| {
                        let mut values = signed(typical.clone(), z);
                        if let Seed::Values(seed_values) = initial(i) {
                            for (number, value) in seed_values {
                                values[number] = value;
                            }
                        }
                        Start { values, place: Vec::new() }
                    })
                    .collect()
            }
        }
    }

    /// A sector's ends, by the neighbouring bearings at which something stands at the same range.
    fn sector(&self, round: &Round<'a>, index: usize, typical: &[f64]) -> Vec<f64> {
        let values = |i: usize| match &round.dictionary.targets[i] {
            Target::Effect(EffectKind::SectorOcclusion, Seed::Values(seed_values)) => {
                Some([seed_values[0].1, seed_values[1].1, seed_values[2].1])
            }
            _ => None,
        };
        let Some([from, to, range]) = values(index) else { return typical.to_vec() };
        // Where exactly readings of it lie: the tenth of a metre that holds most of them.
        let readings = &self.recorded.readings;
        let k = self.recorded.beams();
        let bearings: Vec<f64> = self.recorded.laser.bearings().iter().map(|&b| f64::from(b)).collect();
        let mut near: Vec<f64> = readings
            .iter()
            .enumerate()
            .filter(|(i, _)| (from..=to).contains(&bearings[i % k]))
            .map(|(_, &z)| f64::from(z))
            .filter(|z| (z - range).abs() <= SECTOR_RANGE_M)
            .collect();
        near.sort_by(f64::total_cmp);
        let held =
            |&from: &f64| near.partition_point(|z| *z < from + 0.1) - near.partition_point(|z| *z < from);
        let densest = near.iter().copied().max_by_key(held).map_or(range, |z| z + 0.05);
        // The bearings at which there are more such readings than elsewhere (Kulldorff's scan statistic, 1997).
        let mut counts = vec![0.0; k];
        for (i, &z) in readings.iter().enumerate() {
            if (f64::from(z) - densest).abs() < 0.1 {
                counts[i % k] += 1.0;
            }
        }
        let inside = |b: usize| (from - 0.3..=to + 0.3).contains(&bearings[b]);
        let outside: Vec<f64> = (0..k).filter(|&b| !inside(b)).map(|b| counts[b]).collect();
        let usual = (outside.iter().sum::<f64>() / outside.len().max(1) as f64).max(0.2);
        let mut best = (0.0, from, to);
        for a in (0..k).filter(|&b| inside(b)) {
            let mut sum = 0.0;
            for b in (a..k).take_while(|&b| inside(b)) {
                sum += counts[b];
                let expected = usual * (b - a + 1) as f64;
                if sum > expected {
                    let gain = sum * (sum / expected).ln() - (sum - expected);
                    if gain > best.0 {
                        let half = 0.5 * (bearings[(a + 1).min(k - 1)] - bearings[a]).abs();
                        best = (gain, bearings[a] - half, bearings[b] + half);
                    }
                }
            }
        }
        let (_, from, to) = best;
        let at = densest;
        let mut start = vec![from, to, at, 0.05];
        start.truncate(typical.len());
        start
    }
}

/// Where readings in front lie in a window of free space.
fn object_at(round: &Round<'_>, [x, y]: [i32; 2]) -> DVec2 {
    let mut points = Vec::new();
    each_reading(round, |beam, heading, shift, z, terms| {
        if round.dictionary.is_in_front(beam, shift, z, terms) {
            let point = beam.view.endpoint - (beam.view.range - z) * DVec2::from_angle(heading);
            let [i, j] = cell_at(point.x, point.y, OBJECT_CELL_M);
            if (x..=x + 1).contains(&i) && (y..=y + 1).contains(&j) {
                points.push(point);
            }
        }
    });
    // Of those the middle of the ones that lie together.
    let near = |p: &DVec2| points.iter().filter(|q| p.distance(**q) < 0.1).count();
    let Some(centre) = points.iter().copied().max_by_key(near) else {
        return DVec2::new(f64::from(x + 1), f64::from(y + 1)) * OBJECT_CELL_M;
    };
    let close: Vec<DVec2> = points.iter().copied().filter(|p| p.distance(centre) < 0.1).collect();
    close.iter().sum::<DVec2>() / close.len() as f64
}

/// Every reading with its beam and the beam's heading.
fn each_reading(round: &Round<'_>, mut visit: impl FnMut(&Beam, f64, f64, f64, &Terms)) {
    let comparison = &round.comparison;
    let Ok(effects) = comparison.effects(&round.effects) else { return };
    comparison.for_each_reading(&comparison.views, &effects, &round.fitted, |scan, i, _, shift, z, terms| {
        let beam = &comparison.views.beams[i];
        visit(beam, comparison.recorded.track.poses()[scan].theta + beam.view.bearing, shift, z, &terms);
    });
}

/// Length of the bins into which a wall is cut \[m\], how far a stretch is looked for on both sides, and its least length.
const STRETCH_BIN_M: f64 = 0.1;
const STRETCH_REACH_M: f64 = 4.0;
const STRETCH_LEAST_M: f64 = 0.3;

/// Stretches of wall whose statistics are farthest off, on the walls through the cells that are, with the strength that an
/// effect seems to have there.
fn walls(round: &Round<'_>, kind: EffectKind, all: &[(f64, usize)], most: usize) -> Vec<(f64, [DVec2; 2])> {
    let cells = |i: usize| match round.dictionary.targets[i] {
        Target::Effect(_, Seed::Wall(cells)) => Some(cells),
        _ => None,
    };
    let max = round.comparison.nominal.laser.max_range_m;
    let mut used: Vec<[i32; 2]> = Vec::new();
    let mut out = Vec::new();
    for &(z, i) in all {
        if out.len() == most {
            break;
        }
        let Some(seeds) = cells(i).filter(|seeds| !seeds.iter().any(|seed| used.contains(seed))) else {
            continue;
        };
        let points: Vec<DVec2> = round
            .comparison
            .views
            .beams
            .iter()
            .filter(|beam| beam.view.range < max)
            .map(|beam| beam.view.endpoint)
            .filter(|p| seeds.contains(&wall_cell(*p)))
            .collect();
        used.extend(&seeds);
        let stretches = lines_through(points).into_iter().filter_map(|line| stretch(round, kind, line, z));
        if let Some((_, value, ends)) = stretches.max_by(|a, b| a.0.total_cmp(&b.0)) {
            out.push((value, ends));
        }
    }
    out
}

/// Shares of beams that a stretch may let through.
const GLASS_SHARES: [f64; 5] = [0.01, 0.03, 0.1, 0.3, 0.8];

/// The stretch of a wall through a point that says most for the effect, in the direction of `z`: by how many nats, its
/// strength, its ends.
fn stretch(
    round: &Round<'_>,
    kind: EffectKind,
    (middle, along): (DVec2, DVec2),
    z: f64,
) -> Option<(f64, f64, [DVec2; 2])> {
    let bins = (2.0 * STRETCH_REACH_M / STRETCH_BIN_M) as usize;
    let mut readings = vec![0_usize; bins];
    // Of a moved wall the score and its information, of glass the gain of each share: few events are no normal numbers.
    let mut sums = vec![[0.0; GLASS_SHARES.len()]; bins];
    each_reading(round, |beam, _, shift, reading, terms| {
        let from_middle = beam.view.endpoint - middle;
        if along.perp_dot(from_middle).abs() > 0.05 {
            return;
        }
        let bin = (along.dot(from_middle) + STRETCH_REACH_M) / STRETCH_BIN_M;
        if bin < 0.0 || bin as usize >= bins {
            return;
        }
        readings[bin as usize] += 1;
        let sums = &mut sums[bin as usize];
        if kind == EffectKind::Glass {
            let ratio = round.dictionary.glass_ratio(beam, shift, reading, terms);
            for (sum, share) in sums.iter_mut().zip(GLASS_SHARES) {
                *sum += (share * ratio).ln_1p();
            }
        } else {
            let score = moved_wall_score(beam, terms);
            sums[0] += score;
            sums[1] += score * score;
        }
    });
    let mut best: Option<(f64, f64, [usize; 2])> = None;
    for from in (0..bins).filter(|&bin| readings[bin] > 0) {
        let mut total = [0.0; GLASS_SHARES.len()];
        for to in from..bins {
            for (total, sum) in total.iter_mut().zip(sums[to]) {
                *total += sum;
            }
            if readings[to] == 0 || (to - from + 1) as f64 * STRETCH_BIN_M < STRETCH_LEAST_M {
                continue;
            }
            let (gain, strength) = if kind == EffectKind::Glass {
                let gains = total.into_iter().zip(GLASS_SHARES);
                gains.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0.0))
            } else {
                // The score's own estimate.
                let [score, information, ..] = total;
                let is_right = score * z > 0.0;
                if is_right { (0.5 * score * score / information, score / information) } else { (0.0, 0.0) }
            };
            if gain > best.map_or(0.0, |(most, ..)| most) {
                best = Some((gain, strength, [from, to + 1]));
            }
        }
    }
    let at = |bin: usize| middle + (bin as f64 * STRETCH_BIN_M - STRETCH_REACH_M) * along;
    best.map(|(gain, strength, ends)| (gain, strength, ends.map(at)))
}

/// The most walls that are looked at in two cells.
const WALLS: usize = 3;

/// The walls that some points lie on, the one with most of them first: recesses and corners have several in the same cells.
fn lines_through(mut points: Vec<DVec2>) -> Vec<(DVec2, DVec2)> {
    let mut lines = Vec::new();
    while lines.len() < WALLS
        && let Some((middle, along)) = line_through(&points)
    {
        lines.push((middle, along));
        points.retain(|p| along.perp_dot(*p - middle).abs() >= 0.03);
    }
    lines
}

/// The wall that most of some points lie on: a point of it, and its direction.
fn line_through(points: &[DVec2]) -> Option<(DVec2, DVec2)> {
    const MOST: usize = 60;
    let few: Vec<DVec2> = points.iter().copied().step_by(points.len().div_ceil(MOST).max(1)).collect();
    let mut best: Option<(usize, DVec2, DVec2)> = None;
    for (i, &a) in few.iter().enumerate() {
        for &b in few[i + 1..].iter().filter(|b| a.distance(**b) > 0.2) {
            let along = (b - a).normalize();
            let on_it = few.iter().filter(|p| along.perp_dot(**p - a).abs() < 0.03).count();
            if best.is_none_or(|(most, ..)| on_it > most) {
                best = Some((on_it, 0.5 * (a + b), along));
            }
        }
    }
    best.map(|(_, middle, along)| (middle, along))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use locsim_world::effect::Effect;

    use super::*;
    use crate::fixtures::{NOMINAL, TRUTH};
    use crate::hidden::{Regime, record_library};
    use crate::search::GapOptions;
    use crate::{Recorded, find};

    /// A recess, its side, and the wall beside it share cells: each is a wall to look at, the one with most beams first.
    #[test]
    fn cells_have_several_walls() {
        let on = |from: [f64; 2], to: [f64; 2], count: usize| {
            let at = move |i: usize| DVec2::from(from).lerp(DVec2::from(to), i as f64 / count as f64);
            (0..count).map(at)
        };
        let side = on([1.0, 0.04], [1.0, 0.4], 20);
        let points = on([0.0, 0.0], [1.0, 0.0], 60).chain(side).chain(on([1.04, 0.4], [2.0, 0.4], 40));
        let lines = lines_through(points.collect());
        let expected = [(DVec2::ZERO, DVec2::X), (DVec2::new(1.5, 0.4), DVec2::X), (DVec2::X, DVec2::Y)];
        assert_eq!(lines.len(), expected.len(), "{lines:?}");
        for ((middle, along), (point, direction)) in lines.into_iter().zip(expected) {
            assert!(along.perp_dot(direction).abs() < 0.05, "{along} for {direction}");
            assert!(direction.perp_dot(middle - point).abs() < 0.03, "{middle} for {point}");
        }
    }

    /// Most beams of a door's cells end on its back and on the wall beside it; a pane in its jamb is found all the same.
    #[test]
    fn a_pane_in_a_jamb_is_named() {
        let pane = [DVec2::new(2.0, -0.4), DVec2::new(2.0, 0.0)];
        let glass = Effect::new(EffectKind::Glass, vec![0.5], vec![pane]).unwrap();
        let drive = record_library(&NOMINAL, &TRUTH, &[glass], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 99, seed: 5, ..GapOptions::default() };
        let outcome = find(&NOMINAL, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
        let first = outcome.effects.first().expect("something is named");
        assert_eq!(first.name, EffectKind::Glass, "{:?}", outcome.rivals);
        let ends = first.place[0];
        assert!(ends.iter().all(|end| (end[0] - 2.0).abs() < 0.06), "{ends:?}");
    }
}
