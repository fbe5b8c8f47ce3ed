use std::sync::Arc;

use glam::DVec2;
use locsim_core::survival_of;

use super::BlockIntegral;

/// How far a beam gets among unmapped clutter: the probability that none stands within a range.
///
/// Between its entries the probability is linear, so that the density of the nearest clutter is constant there.
#[derive(Clone, Debug)]
pub struct ClutterSurvival {
    /// Entry `i` of the probabilities is that no clutter stands within `start_m + i * bin_m`; it is 1 before the first, and the
    /// last holds beyond.
    start_m: f64,
    bin_m: f64,
    probability: Arc<[f32]>,
}

impl ClutterSurvival {
    /// That of a ray from `origin` along the unit vector `direction` up to `limit` \[m\], for a robot at `robot`, in bins of
    /// `bin_m`. `counts` is scratch memory.
    pub fn new(
        clutter: &BlockIntegral,
        [origin, direction]: [DVec2; 2],
        robot: DVec2,
        limit: f64,
        bin_m: f64,
        counts: &mut Vec<f64>,
    ) -> Self {
        counts.clear();
        counts.resize((limit / bin_m) as usize + 2, 0.0);
        clutter.count_by_range(origin, direction, robot, limit, bin_m, counts);
        let (first, probability) = survival_of(counts);
        Self { start_m: first as f64 * bin_m, bin_m, probability: probability.collect() }
    }

    /// That of a beam without clutter.
    pub fn clear() -> Self {
        Self { start_m: 0.0, bin_m: 1.0, probability: Arc::new([]) }
    }

    /// Whether no clutter is in the way.
    pub fn is_clear(&self) -> bool {
        self.probability.is_empty()
    }

    /// That of a beam which ends nearby, at `to` metres instead of `from`, among clutter that is `deeper` times as deep: clutter
    /// stands by walls. It shares this one's memory.
    #[must_use]
    pub fn moved(&self, from: f64, to: f64, deeper: f64) -> Self {
        let start_m = to - deeper * (from - self.start_m);
        Self { start_m, bin_m: deeper * self.bin_m, probability: Arc::clone(&self.probability) }
    }

    /// Whether two share their memory, as [`ClutterSurvival::moved`] has it.
    pub fn is_shared_with(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.probability, &other.probability)
    }

    /// The middle of where clutter may stand within `range` metres \[m\].
    pub fn middle(&self, range: f64) -> f64 {
        let end = self.start_m + self.bin_m * self.probability.len().saturating_sub(1) as f64;
        0.5 * (self.start_m.min(range) + end.min(range)).max(0.0)
    }

    /// Probability that no clutter stands within `range` metres, and the density \[1/m\] of the nearest one there.
    #[inline]
    pub fn at(&self, range: f64) -> (f64, f64) {
        let Self { start_m, bin_m, probability } = self;
        let at = (range - start_m) / bin_m;
        if at < 0.0 {
            return (1.0, 0.0);
        }
        let i = at as usize;
        match probability.get(i..) {
            Some(&[a, b, ..]) => {
                let (a, b) = (f64::from(a), f64::from(b));
                (a + (at - i as f64) * (b - a), (a - b) / bin_m)
            }
            _ => (probability.last().map_or(1.0, |&last| f64::from(last)), 0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::{block_options, room};
    use super::super::{BlockModel, BlockOptions};
    use super::*;

    const BIN_M: f64 = 0.05;

    /// A beam gets past blocks of two kinds where it gets past each. What either kind may reach is in reach.
    #[test]
    fn two_kinds_of_blocks_are_in_the_way_of_a_beam_independently() {
        let at_walls = BlockModel::new(block_options(), &room()).unwrap();
        let far = BlockOptions { wall_distance_m: [0.5, 1.5], per_metre_of_wall: 0.1, ..block_options() };
        let in_the_open = BlockModel::new(far, &room()).unwrap();
        let [one, other] = [&at_walls, &in_the_open].map(BlockIntegral::new);
        let both = one.clone().and(Some(Arc::new(other.clone())));
        let (origin, direction) = (DVec2::new(2.0, 1.7), DVec2::from_angle(0.4));
        let survival = |blocks: &BlockIntegral, range: f64| {
            ClutterSurvival::new(blocks, [origin, direction], origin, 3.0, BIN_M, &mut Vec::new()).at(range).0
        };
        for range in [0.5, 1.0, 1.5, 2.0, 2.5].map(|range| range + 1e-9) {
            let apart = survival(&one, range) * survival(&other, range);
            assert!((survival(&both, range) - apart).abs() < 1e-3, "{range}");
        }
        assert!(survival(&other, 3.0) < 0.99);
        let points = both.lattice_in_reach(0.25, 0.1);
        assert!(points.is_superset(&at_walls.lattice_in_reach(0.25, 0.1)));
        assert!(points.is_superset(&in_the_open.lattice_in_reach(0.25, 0.1)));
    }

    /// Entries are the exponential of minus the clutter expected up to their ranges, by an integral summed otherwise.
    #[test]
    fn survival_is_that_of_the_expected_clutter() {
        let model = BlockModel::new(BlockOptions { clearance_m: 0.3, ..block_options() }, &room()).unwrap();
        let clutter = BlockIntegral::new(&model);
        let mut scratch = Vec::new();
        for i in 0..40 {
            let direction = DVec2::from_angle(0.3 * f64::from(i));
            let origin = DVec2::new(1.0 + 0.1 * f64::from(i), 1.7);
            let limit = 2.5 + 0.013 * f64::from(i);
            let survival =
                ClutterSurvival::new(&clutter, [origin, direction], origin, limit, BIN_M, &mut scratch);
            for (entry, &probability) in survival.probability.iter().enumerate() {
                let range = survival.start_m + entry as f64 * BIN_M;
                let mut expected = 0.0;
                clutter.stretches(origin, direction, origin, limit, |near, far, count| {
                    let share = if far > near {
                        (range - near) / (far - near)
                    } else {
                        f64::from(u8::from(range > near))
                    };
                    expected += count * share.clamp(0.0, 1.0);
                });
                let probability = f64::from(probability);
                assert!(
                    (probability - (-expected).exp()).abs() < 1e-6,
                    "{i} {entry} {probability} {expected}"
                );
            }
        }
    }

    /// Half a metre before a wall at 3 m is a metre before one at 4 m, among clutter twice as deep.
    #[test]
    fn a_moved_survival_is_aligned_at_the_wall_and_stretched_away_from_it() {
        let near = ClutterSurvival { start_m: 2.5, bin_m: 0.25, probability: [1.0, 0.75, 0.5].into() };
        let far = near.moved(3.0, 4.0, 2.0);
        assert_eq!((far.start_m, far.bin_m), (3.0, 0.5));
        assert!(far.is_shared_with(&near));
        assert_eq!(far.at(3.25), (0.875, 0.5));
        assert_eq!((far.at(2.9), far.at(9.0)), ((1.0, 0.0), (0.5, 0.0)));
        assert_eq!(ClutterSurvival::clear().at(2.0), (1.0, 0.0));
        assert_eq!((far.middle(9.0), far.middle(3.5), far.middle(2.0)), (3.5, 3.25, 2.0));
    }
}
