//! Effects that are known already, and the places of those that have one.

use std::sync::Arc;

use glam::DVec2;
use locsim_world::effect::{Effect, EffectKind, Moves};

use super::pool::{Expected, Pool, Reading};

/// What is named at a place reaches so far \[m\].
const NEAR_M: f64 = 1.0;

/// Whether a kind acts at one place.
pub(super) fn is_of_place(kind: EffectKind) -> bool {
    kind.has_place() || kind.moves() == Moves::Objects
}

/// Effects of today's log that are known already.
pub(super) struct Given {
    pub effects: Vec<Effect>,
    /// Whether each reading is at the place of one of them; empty without any. What an effect of all beams gains there is what is left of the
    /// place's form: a box isn't a disc, and a cupboard has more sides than the wall that has moved with it.
    is_at_place: Arc<[bool]>,
}

impl Given {
    pub fn none() -> Self {
        Self { effects: Vec::new(), is_at_place: Arc::new([]) }
    }

    pub fn of(pool: &Pool<'_>, effects: Vec<Effect>) -> Self {
        if !effects.iter().any(|effect| is_of_place(effect.kind)) {
            return Self { effects, ..Self::none() };
        }
        let is_at_place = |reading: &Reading| {
            let (point, _) = pool.point(reading);
            let end = pool.beam(reading).view.endpoint;
            effects.iter().any(|effect| is_near(effect, point) || is_near(effect, end))
        };
        Self { is_at_place: pool.readings.iter().map(is_at_place).collect(), effects }
    }

    /// Those of the effects that `is_kept` holds for, with the places of all.
    pub fn of_these(&self, is_kept: impl Fn(&Effect) -> bool) -> Self {
        let effects = self.effects.iter().filter(|effect| is_kept(effect)).cloned().collect();
        Self { effects, is_at_place: self.is_at_place.clone() }
    }

    /// Leaves out the readings at the places, of those that an effect of all beams changes.
    pub fn keep_away(&self, kind: EffectKind, changed: &mut Vec<(u32, Expected)>) {
        if !self.is_at_place.is_empty() && !is_of_place(kind) {
            changed.retain(|(index, _)| !self.is_at_place[*index as usize]);
        }
    }
}

/// Whether a point \[m\] is at the place of an effect.
pub(super) fn is_near(effect: &Effect, point: DVec2) -> bool {
    let is_near_wall = |[a, b]: &[DVec2; 2]| {
        let along = (*b - *a).normalize_or_zero();
        let at = (point - *a).dot(along).clamp(0.0, a.distance(*b));
        point.distance(*a + at * along) < NEAR_M
    };
    if effect.kind.moves() == Moves::Objects {
        let [x, y, radius_m] = [0, 1, 2].map(|i| effect.values[i]);
        return point.distance(DVec2::new(x, y)) < radius_m + NEAR_M;
    }
    effect.place.iter().any(is_near_wall)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_reaches_a_metre_beyond_what_is_named_there() {
        let wall = vec![[DVec2::new(3.0, 4.0), DVec2::new(5.0, 4.0)]];
        let wall = Effect::new(EffectKind::MovedWall, vec![0.3, 0.0], wall).unwrap();
        let disc = Effect::new(EffectKind::MissingObject, vec![4.0, 4.0, 0.4], Vec::new()).unwrap();
        let are_near = |x: f64, y: f64| [&wall, &disc].map(|effect| is_near(effect, DVec2::new(x, y)));
        assert_eq!(are_near(4.5, 4.9), [true, true]);
        assert_eq!(are_near(5.9, 4.0), [true, false]);
        assert_eq!(are_near(4.0, 5.3), [false, true]);
        assert_eq!(are_near(6.1, 4.0), [false, false]);
        assert!(!is_near(&Effect::typical(EffectKind::RangeBias, Vec::new()), DVec2::ZERO));
    }
}
