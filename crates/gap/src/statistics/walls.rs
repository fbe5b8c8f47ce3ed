//! Effects of a stretch of wall, over cells of the map that walls run through.

use distreg::contamination::{detectable_share, score};
use glam::DVec2;
use locsim_comparison::{kinds_shown_by, near_density};
use locsim_core::{Line, Stretch, Stretches, lines_through, median};
use locsim_world::effect::{self, EffectKind, PLACE_REACH_M};

use super::readings::{Reading, side_of};
use super::survey::Survey;
use super::wall_cells::{WallCells, wall_cell};
use super::{Family, Found, Halves, Readings, Start, Statistic, typical_values};

/// The scores of a wall that is displaced along its normal.
pub(super) struct WallShift {
    kind: EffectKind,
    walls: WallCells,
}

impl WallShift {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        kinds_shown_by(|statistic| matches!(statistic, effect::Statistic::WallShift))
            .map(|kind| Self { kind, walls: survey.walls().clone() })
            .collect()
    }
}

impl Family for WallShift {
    fn statistics(&self) -> Vec<Statistic> {
        self.walls.statistics(self.kind)
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        // One that has moved is farther for beams from one side and nearer for those from the other.
        self.walls.sums(log, |reading, _| reading.side() * reading.wall_shift_score())
    }

    fn first_guesses(&self, log: &Readings<'_>, found: &[Found<'_>]) -> Vec<Start> {
        let evidence = |reading: &Reading<'_>, away: f64| {
            let score = away * reading.wall_shift_score();
            [score, score * score]
        };
        wall_guesses(self.kind, &self.walls, log, found, evidence, |[score, information], z| {
            // The score's own estimate, where it is to the statistic's side.
            let is_right = score * z > 0.0;
            if is_right { (0.5 * score * score / information, score / information) } else { (0.0, 0.0) }
        })
    }
}

/// The scores of a wall that some beams go through.
pub(super) struct WallLoss {
    kind: EffectKind,
    walls: WallCells,
    /// The share of each cell's beams at which the score is taken.
    shares: Vec<f64>,
}

/// Shares of beams that a stretch may let through, from one that is just seen to nearly all.
const LOSS_SHARES: [f64; 5] = [0.01, 0.03, 0.1, 0.3, 0.8];

impl WallLoss {
    pub fn all(survey: &Survey<'_>) -> Vec<Self> {
        let shares: Vec<f64> = survey.walls().counts().into_iter().map(detectable_share).collect();
        kinds_shown_by(|statistic| matches!(statistic, effect::Statistic::WallLoss))
            .map(|kind| Self { kind, walls: survey.walls().clone(), shares: shares.clone() })
            .collect()
    }
}

/// Density of a reading of a beam that its wall lets through, over the hypothesis's, less 1. Such a beam has no return, or
/// one of what is behind.
fn loss_ratio(reading: &Reading<'_>, max: f64) -> f64 {
    let through = if reading.is_return {
        let sigma = reading.terms.sigma.min(0.1);
        let behind = reading.beam.view.behind;
        let mapped = behind.map_or(0.0, |behind| near_density(reading.z, behind + reading.shift, sigma, max));
        // The map often lacks the surface behind.
        0.5 * mapped + if reading.is_behind { 0.5 / max } else { 0.0 }
    } else {
        0.5
    };
    reading.contamination(through)
}

impl Family for WallLoss {
    fn statistics(&self) -> Vec<Statistic> {
        let pairs = self.walls.pairs().iter().map(|&[a, b]| self.shares[a].min(self.shares[b]));
        let shares = self.shares.iter().copied().chain(pairs);
        self.walls
            .statistics(self.kind)
            .into_iter()
            .zip(shares)
            .map(|(statistic, share)| statistic.with_one_reading(share.recip()))
            .collect()
    }

    fn measure(&self, log: &Readings<'_>) -> Vec<Halves> {
        let max = log.max_range();
        self.walls.sums(log, |reading, cell| score(loss_ratio(reading, max), self.shares[cell]))
    }

    fn first_guesses(&self, log: &Readings<'_>, found: &[Found<'_>]) -> Vec<Start> {
        let max = log.max_range();
        let evidence = |reading: &Reading<'_>, _: f64| {
            let ratio = loss_ratio(reading, max);
            // The gain itself: sums of few events aren't normal.
            LOSS_SHARES.map(|share| (share * ratio).ln_1p())
        };
        wall_guesses(self.kind, &self.walls, log, found, evidence, |gains, _| {
            let gains = gains.into_iter().zip(LOSS_SHARES);
            gains.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0.0))
        })
    }
}

/// Length of the bins into which a wall is cut \[m\], and the least length of a stretch: about three readings at 3 m.
const STRETCH_BIN_M: f64 = 0.1;
pub(super) const STRETCH_LEAST_M: f64 = 0.3;
/// How far a stretch is looked for on both sides of a cell's wall \[m\]: one wall has one name, however long it is.
pub(super) const STRETCH_REACH_M: f64 = 25.0;
/// A wall on which no beam ends for so long \[m\] is another one: a door is narrower, and a line goes on through all that lies on it.
pub(super) const STRETCH_GAP_M: f64 = 2.0;
/// Ends of beams within this of a line are on it \[m\].
pub(super) const ON_LINE_M: f64 = 0.03;
/// The same for the readings of a stretch: the line through the ends is known to a few centimetres.
pub(super) const NEAR_LINE_M: f64 = 0.05;
/// A wall is thin up to this \[m\], and so many beams see its other face.
const THIN_M: f64 = 0.3;
const FEWEST_OF_FACE: usize = 10;
/// The most stretches that fits start from.
pub(super) const MOST_STRETCHES: usize = 2;
/// The most walls that are looked at in a statistic's cells: the two of a corner, and a third of a recess.
const MOST_WALLS: usize = 3;

/// Starts at the stretches of wall that say most, on the walls through the cells that are farthest off.
///
/// `evidence` is what a reading says, in numbers that add up over readings, and 1 for a beam from the wall's right, to whose left it is farther, or -1.
/// By their sum over a stretch and the statistic's z, `judge` gives the gain in nats and the strength.
pub(super) fn wall_guesses<const N: usize>(
    kind: EffectKind,
    walls: &WallCells,
    log: &Readings<'_>,
    found: &[Found<'_>],
    evidence: impl Fn(&Reading<'_>, f64) -> [f64; N],
    judge: impl Fn([f64; N], f64) -> (f64, f64),
) -> Vec<Start> {
    let stretches = lines_off(walls, log, found).filter_map(|(z, lines)| {
        lines
            .into_iter()
            .filter_map(|line| {
                best_stretch(log, line, &evidence, |sum| judge(sum, z * side_of(line.along.perp())))
            })
            .max_by(|a, b| a.gain.total_cmp(&b.gain))
    });
    let starts = stretches.take(MOST_STRETCHES).flat_map(|Stretch { strength, ends, .. }| {
        // A wall that is displaced far has no score: a typical strength is tried as well.
        let typical = typical_values(kind, strength);
        let own = std::iter::once(strength).chain(typical[1..].iter().copied()).collect();
        let [own, typical] = [own, typical].map(|values| Start { values, place: vec![ends] });
        of_one_and_both_faces(log, own).chain([typical])
    });
    starts.collect()
}

/// A start at a stretch that is seen from its right, and the same with the other face of its wall, where that is thin and seen, too: a partition
/// moves with both of its faces.
pub(super) fn of_one_and_both_faces(log: &Readings<'_>, start: Start) -> impl Iterator<Item = Start> + use<> {
    let place = with_other_face(log, start.place[0]);
    let of_both = place.map(|place| Start { values: start.values.clone(), place });
    std::iter::once(start).chain(of_both)
}

/// A stretch with the other face of its wall. Both go the same way along, so that both move to the same side.
fn with_other_face(log: &Readings<'_>, [a, b]: [DVec2; 2]) -> Option<Vec<[DVec2; 2]>> {
    let along = (b - a).normalize();
    let max = log.max_range();
    let views = log.all.iter().map(|reading| &reading.beam.view).filter(|view| view.range < max);
    let from_left = views.filter(|view| along.perp_dot(view.direction) < 0.0).map(|view| view.endpoint - a);
    let beside = from_left.filter(|end| (0.0..=a.distance(b)).contains(&along.dot(*end)));
    let behind = beside.map(|end| along.perp_dot(end)).filter(|by| (PLACE_REACH_M..=THIN_M).contains(by));
    let mut behind: Vec<f64> = behind.collect();
    if behind.len() < FEWEST_OF_FACE {
        return None;
    }
    let other = median(&mut behind) * along.perp();
    Some(vec![[a, b], [a + other, b + other]])
}

/// The walls through the cells that are farthest off, with the statistic's z; each cell once, and each wall with most of its beams from its right.
pub(super) fn lines_off<'s>(
    walls: &'s WallCells,
    log: &'s Readings<'_>,
    found: &'s [Found<'_>],
) -> impl Iterator<Item = (f64, Vec<Line>)> + 's {
    let max = log.max_range();
    let mut used: Vec<[i32; 2]> = Vec::new();
    found.iter().filter_map(move |&Found { z, index, .. }| {
        let cells = walls.of_statistic(index);
        if cells.iter().any(|cell| used.contains(cell)) {
            return None;
        }
        let beams = log.comparison.views.beams.iter().filter(|beam| beam.view.range < max);
        let ends = beams.map(|beam| beam.view.endpoint).filter(|end| cells.contains(&wall_cell(*end)));
        let lines = lines_through(ends.collect(), MOST_WALLS, ON_LINE_M).into_iter().map(|line| {
            let views = log.all.iter().map(|reading| &reading.beam.view);
            let of_wall = views.filter(|view| line.distance(view.endpoint) <= NEAR_LINE_M);
            line.seen_from_its_right(of_wall.map(|view| view.direction))
        });
        used.extend(cells);
        Some((z, lines.collect()))
    })
}

/// The stretch of a line that gains most; `None` where none gains anything.
fn best_stretch<const N: usize>(
    log: &Readings<'_>,
    line: Line,
    evidence: impl Fn(&Reading<'_>, f64) -> [f64; N],
    judge: impl Fn([f64; N]) -> (f64, f64),
) -> Option<Stretch> {
    let mut stretches = Stretches::new(line, STRETCH_BIN_M, STRETCH_REACH_M);
    for reading in &log.all {
        let view = &reading.beam.view;
        if line.distance(view.endpoint) <= NEAR_LINE_M {
            stretches.add(view.endpoint, evidence(reading, line.away(view.direction)));
        }
    }
    stretches.best(STRETCH_LEAST_M, STRETCH_GAP_M, judge)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use locsim_comparison::fixtures::{NOMINAL, TRUTH};
    use locsim_comparison::hidden::{Regime, record_library};
    use locsim_comparison::{Comparison, Nuisances};
    use locsim_world::effect::Effect;

    use super::*;
    use crate::statistics::pit_draw;
    use crate::{GapOptions, Recorded, find};

    /// Most beams of a door's cells end on its back and on the wall beside it; a pane in its jamb is found all the same.
    #[test]
    fn a_pane_in_a_jamb_is_named() {
        let pane = [DVec2::new(2.0, -0.4), DVec2::new(2.0, 0.0)];
        let glass = Effect::new(EffectKind::Glass, vec![0.5, 0.0], vec![pane]).unwrap();
        let drive = record_library(&NOMINAL, &TRUTH, &[glass], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let options = GapOptions { replicates: 99, seed: 5, ..GapOptions::default() };
        let outcome = find(&NOMINAL, &recorded, &options, &(), &AtomicBool::new(false)).unwrap();
        let first = outcome.effects.first().expect("something is named");
        assert_eq!(first.name, EffectKind::Glass, "{:?}", outcome.rivals);
        let ends = first.place[0];
        assert!(ends.iter().all(|end| (end[0] - 2.0).abs() < 0.06), "{ends:?}");
    }

    /// Lines along walls, on each of which every reading says as much: what is found has no gap, though lines go on beyond theirs.
    #[test]
    fn a_stretch_ends_where_the_wall_does() {
        let drive = record_library(&NOMINAL, &TRUTH, &[], Regime::default(), 3).unwrap();
        let recorded = Recorded::new(&drive, 400, 72, |_| true).unwrap();
        let comparison = Comparison::new(&NOMINAL, &recorded).unwrap();
        let fitted = comparison.start(&Nuisances::default());
        let log = Readings::new(&comparison, &NOMINAL.effects, &fitted, false, &pit_draw(1));
        let met = comparison.views.beams.iter().filter(|beam| beam.view.range < log.max_range());
        let ends: Vec<DVec2> = met.map(|beam| beam.view.endpoint).collect();
        let mut with_gap = 0;
        for line in lines_through(ends.clone(), 20, ON_LINE_M) {
            let on_it = ends.iter().filter(|end| line.distance(**end) <= NEAR_LINE_M);
            let along = locsim_core::sorted(on_it.map(|end| line.along.dot(*end - line.point)));
            let gaps =
                || along.windows(2).filter(|pair| pair[1] - pair[0] > STRETCH_GAP_M + 2.0 * STRETCH_BIN_M);
            with_gap += usize::from(gaps().next().is_some());
            let Some(found) = best_stretch(&log, line, |_, _| [1.0], |[sum]| (sum, 1.0)) else { continue };
            let [from, to] = found.ends.map(|end| line.along.dot(end - line.point));
            assert!(!gaps().any(|pair| pair[0] >= from && pair[1] <= to), "{from} to {to}");
        }
        assert!(with_gap > 0);
    }
}
