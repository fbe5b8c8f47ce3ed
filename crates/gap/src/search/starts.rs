//! Where fits start: kinds of effect, strengths, places, by the statistics that are farthest off.

use glam::DVec2;
use locsim_world::effect::EffectKind;

use super::{Round, State};
use crate::fit::Start;
use crate::statistics::{Aim, Hint, OBJECT_CELL_M, WALL_CELL_M, cell_at};

/// Directions of a kind of effect: how far the log is off, and the index of the statistic.
type Directions = Vec<(f64, usize)>;

impl<'a> State<'a> {
    /// Kinds with where their fits start, the most promising first.
    pub fn starts(&self, round: &Round<'a>, count: usize) -> Vec<(EffectKind, Vec<Start>)> {
        let mut best: Vec<(EffectKind, f64, Directions)> = Vec::new();
        for (i, aim) in round.dictionary.aims.iter().enumerate() {
            let Aim::Effect(kind, _) = aim else { continue };
            // The density of blocks is fitted along with everything else; see `block_density`.
            if self.options.without.contains(kind) || *kind == EffectKind::BlockDensity {
                continue;
            }
            let z = round.null.z[i];
            match best.iter_mut().find(|(known, ..)| known == kind) {
                Some((_, largest, all)) => {
                    *largest = largest.max(z.abs());
                    all.push((z, i));
                }
                None => best.push((*kind, z.abs(), vec![(z, i)])),
            }
        }
        best.sort_by(|a, b| b.1.total_cmp(&a.1));
        best.truncate(count);
        // An effect whose own direction is hardly off can't be what moves others this far.
        let least = best.first().map_or(0.0, |(_, z, _)| (0.25 * z).clamp(2.0, 4.0));
        best.retain(|(_, z, _)| *z >= least);
        best.into_iter()
            .map(|(kind, _, mut all)| {
                all.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
                let starts = self.starts_of(kind, &all, round);
                (kind, starts)
            })
            .filter(|(_, starts)| !starts.is_empty())
            .collect()
    }

    fn starts_of(&self, kind: EffectKind, all: &[(f64, usize)], round: &Round<'a>) -> Vec<Start> {
        let typical: Vec<f64> = kind.parameters().iter().map(|parameter| parameter.start).collect();
        let hint = |i: usize| match &round.dictionary.aims[i] {
            Aim::Effect(_, hint) => hint.clone(),
            Aim::Cell(_) => Hint::None,
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
                    if let Hint::Values(hints) = hint(i) {
                        for (axis, value) in hints {
                            if value != 0.0 {
                                values[axis] = value * z.signum();
                            }
                        }
                    }
                }
                vec![Start { values, place: Vec::new() }]
            }
            EffectKind::Glass | EffectKind::MovedWall => walls(round, all, 2)
                .into_iter()
                .map(|(z, stretch)| Start { values: signed(typical.clone(), z), place: vec![stretch] })
                .collect(),
            EffectKind::MissingObject => all
                .iter()
                .filter(|(z, _)| *z > 0.0)
                .take(3)
                .filter_map(|&(_, i)| match hint(i) {
                    Hint::Object([x, y]) => Some(Start {
                        values: vec![
                            (f64::from(x) + 0.5) * OBJECT_CELL_M,
                            (f64::from(y) + 0.5) * OBJECT_CELL_M,
                            0.15,
                        ],
                        place: Vec::new(),
                    }),
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
                        if let Hint::Values(hints) = hint(i) {
                            for (number, value) in hints {
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
        let values = |i: usize| match &round.dictionary.aims[i] {
            Aim::Effect(EffectKind::SectorOcclusion, Hint::Values(hints)) => {
                Some([hints[0].1, hints[1].1, hints[2].1])
            }
            _ => None,
        };
        let Some([mut from, mut to, range]) = values(index) else { return typical.to_vec() };
        for (i, &z) in round.null.z.iter().enumerate().take(round.dictionary.first_cell()) {
            if let Some([a, b, r]) = values(i) {
                let joins = (r - range).abs() < 1e-9 && z > 4.0;
                if joins && (a - to).abs() < 1e-6 {
                    to = b;
                } else if joins && (b - from).abs() < 1e-6 {
                    from = a;
                }
            }
        }
        // Where exactly readings of it lie.
        let readings = &self.recorded.readings;
        let k = self.recorded.beams();
        let bearings = self.recorded.laser.bearings();
        let mut near: Vec<f64> = readings
            .iter()
            .enumerate()
            .filter(|(i, _)| (from..=to).contains(&f64::from(bearings[i % k])))
            .map(|(_, &z)| f64::from(z))
            .filter(|z| (z - range).abs() <= 0.2)
            .collect();
        near.sort_by(f64::total_cmp);
        let at = near.get(near.len() / 2).copied().unwrap_or(range);
        let mut start = vec![from, to, at, 0.3];
        start.truncate(typical.len());
        start
    }
}

/// Stretches of wall whose statistics are farthest off, neighbours joined.
fn walls(round: &Round<'_>, all: &[(f64, usize)], most: usize) -> Vec<(f64, [DVec2; 2])> {
    let cell = |i: usize| match round.dictionary.aims[i] {
        Aim::Effect(_, Hint::Wall(cell)) => Some(cell),
        _ => None,
    };
    let mut used: Vec<[i32; 2]> = Vec::new();
    let mut out = Vec::new();
    for &(z, i) in all {
        let Some(seed) = cell(i).filter(|seed| !used.contains(seed)) else { continue };
        if out.len() == most {
            break;
        }
        // Neighbouring cells that are off the same way.
        let strong = 0.35 * z.abs();
        let mut cells = vec![seed];
        let mut next = 0;
        while next < cells.len() {
            let [x, y] = cells[next];
            for &(other, j) in all {
                let Some(neighbour) = cell(j) else { continue };
                let touches = (neighbour[0] - x).abs() <= 1 && (neighbour[1] - y).abs() <= 1;
                if touches
                    && other.signum() == z.signum()
                    && other.abs() > strong.max(3.0)
                    && !cells.contains(&neighbour)
                {
                    cells.push(neighbour);
                }
            }
            next += 1;
        }
        used.extend(&cells);
        let points: Vec<DVec2> = round
            .comparison
            .views
            .beams
            .iter()
            .map(|beam| beam.view.endpoint)
            .filter(|p| cells.contains(&cell_at(p.x, p.y, WALL_CELL_M)))
            .collect();
        if let Some(stretch) = line_through(&points) {
            out.push((z, stretch));
        }
    }
    out
}

/// The stretch along the direction in which points spread most.
fn line_through(points: &[DVec2]) -> Option<[DVec2; 2]> {
    let n = points.len() as f64;
    if points.len() < 3 {
        return None;
    }
    // Medians, as a recess or a corner may lie in the same cells.
    let mean = points.iter().sum::<DVec2>() / n;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let d = *p - mean;
        (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
    }
    let direction = DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy));
    let mut across: Vec<f64> = points.iter().map(|p| direction.perp_dot(*p - mean)).collect();
    across.sort_by(f64::total_cmp);
    let offset = across[across.len() / 2];
    let along: Vec<f64> = points
        .iter()
        .filter(|p| (direction.perp_dot(**p - mean) - offset).abs() < 0.1)
        .map(|p| direction.dot(*p - mean))
        .collect();
    let lo = along.iter().copied().fold(f64::INFINITY, f64::min);
    let hi = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let at = |along: f64| mean + along * direction + offset * direction.perp();
    (hi - lo > 0.05).then(|| [at(lo), at(hi)])
}
