use locsim_core::Pose2;

use super::reading::{Hit, Return};
use super::{
    Alternatives, BeamView, Disc, Effect, EffectError, HitKind, Needs, OdometryDistribution, OdometryErrors,
    ReadingDistribution, Replacement, Residual, residual,
};
use crate::options::{BlockOptions, LaserOptions};

/// All effects of a world; the default is the nominal world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Effects {
    list: Vec<Effect>,
    /// Indices into the list, in the order in which they act on a reading.
    order: Vec<usize>,
    objects: Vec<Disc>,
    needs: Needs,
    residuals: Vec<Residual>,
}

impl Effects {
    /// The nominal world.
    pub fn none() -> Self {
        Self::default()
    }

    /// A world with these effects, all at once.
    ///
    /// # Errors
    /// [`EffectError`] for an effect that [`Effect::new`] refuses, two of a kind of which a world has one
    /// (`wheel_slip`), and effects by which a beam may read more than 12 other things.
    pub fn new(list: Vec<Effect>) -> Result<Self, EffectError> {
        let list = list
            .into_iter()
            .map(|Effect { kind, values, place }| Effect::new(kind, values, place))
            .collect::<Result<Vec<_>, _>>()?;
        let replaces = |i: usize| list[i].kind.description().replaces;
        // Effects that shape the return come before those that replace it.
        let mut order: Vec<usize> = (0..list.len()).collect();
        order.sort_by_key(|&i| replaces(i));
        Alternatives::check(list.iter().map(alternatives).sum(), 0)?;
        let count = |kind| list.iter().filter(|effect| effect.kind == kind).count();
        let mut singles = list.iter().map(|effect| effect.kind).filter(|kind| kind.description().is_single);
        if let Some(kind) = singles.find(|&kind| count(kind) > 1) {
            return Err(EffectError::Twice { kind });
        }
        let needs = || list.iter().map(|effect| effect.kind.description().needs);
        let needs = Needs {
            map: needs().any(|needs| needs.map),
            jump: needs().any(|needs| needs.jump),
            behind: needs().any(|needs| needs.behind),
        };
        let objects = list.iter().filter_map(|effect| effect.kind.effect_type().object(effect)).collect();
        Ok(Self { list, order, objects, needs, residuals: Vec::new() })
    }

    /// The same world with residuals, which act on a reading after all effects that shape it.
    ///
    /// # Errors
    /// [`EffectError::TooMany`] where effects leave no room for what residuals read instead of a return.
    pub fn with_residuals(mut self, residuals: Vec<Residual>) -> Result<Self, EffectError> {
        if !residuals.is_empty() {
            let count = self.list.iter().map(alternatives).sum();
            Alternatives::check(count, residual::MOST_ALTERNATIVES)?;
        }
        self.needs.map |= residuals.iter().any(|residual| residual.needs().map);
        self.residuals = residuals;
        Ok(self)
    }

    /// The same world with these effects instead of its own; residuals stay.
    ///
    /// # Errors
    /// As [`Effects::new`] and [`Effects::with_residuals`].
    pub fn replaced(&self, list: Vec<Effect>) -> Result<Self, EffectError> {
        Self::new(list)?.with_residuals(self.residuals.clone())
    }

    /// Curves without a cause that it has beside the effects.
    pub fn residuals(&self) -> &[Residual] {
        &self.residuals
    }

    /// The effects as they were given.
    pub fn list(&self) -> &[Effect] {
        &self.list
    }

    /// Whether the world is the nominal one: without effects and residuals.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty() && self.residuals.is_empty()
    }

    /// Parts of a beam that are needed.
    pub fn needs(&self) -> Needs {
        self.needs
    }

    /// Where the laser really sits, for where it is said to sit.
    pub fn laser_mount(&self, base_from_laser: Pose2) -> Pose2 {
        self.fold(base_from_laser, |mount, effect| effect.kind.effect_type().laser_mount(effect, mount))
    }

    /// When a beam is really taken \[s\], which by its stamp is taken at `secs`. Bearing \[rad\] in the laser frame.
    pub fn beam_secs(&self, bearing: f64, secs: f64) -> f64 {
        self.fold(secs, |secs, effect| effect.kind.effect_type().beam_secs(effect, bearing, secs))
    }

    /// Objects that stand in the world and aren't in the map.
    pub fn objects(&self) -> &[Disc] {
        &self.objects
    }

    /// The unmapped blocks as they really are.
    #[must_use]
    pub fn blocks(&self, nominal: BlockOptions) -> BlockOptions {
        self.fold(nominal, |blocks, effect| effect.kind.effect_type().blocks(effect, blocks))
    }

    /// The errors of the odometry.
    pub fn odometry_errors(&self) -> OdometryErrors {
        let mut errors = OdometryErrors::default();
        for effect in &self.list {
            effect.kind.effect_type().odometry(effect, &mut errors);
        }
        errors
    }

    /// Odometry of a true motion `base_prev_from_base_now`, before its noise.
    pub fn odometry(&self, increment: &Pose2) -> OdometryDistribution {
        self.odometry_errors().distribution(increment)
    }

    /// Shift of all returns at a time since the first scan \[s\] that a filter can take off \[m\].
    pub fn drift_m(&self, secs: f64) -> f64 {
        self.fold(0.0, |drift, effect| drift + effect.kind.effect_type().drift_m(effect, secs))
    }

    /// Range of the wall that a beam ends on \[m\], where it really stands.
    pub fn wall_range(&self, view: &BeamView) -> f64 {
        let range =
            self.fold(view.range, |range, effect| effect.kind.effect_type().wall_range(effect, view, range));
        range.max(0.0)
    }

    fn fold<T>(&self, nominal: T, change: impl Fn(T, &Effect) -> T) -> T {
        self.list.iter().fold(nominal, change)
    }

    /// The distribution of a reading of a beam that meets something at `range` \[m\].
    ///
    /// `met` at `view.range` is the wall of the map, which `moved_wall` may have moved, `glass` let through, and
    /// `mixed_pixels` mixed up with its neighbour. A `range` below it is of a missing object (a wall, whose incidence
    /// the view has to hold) or of a block. Where nothing is met within the maximum range, nothing is returned.
    ///
    /// Bursts of `crosstalk` come and go, and here it isn't known when: their probability is that of a reading at an
    /// unknown time, `p * share`.
    pub fn reading(
        &self,
        laser: &LaserOptions,
        view: &BeamView,
        met: HitKind,
        range: f64,
    ) -> ReadingDistribution {
        let is_mapped = met == HitKind::Wall && range >= view.range;
        let range = if is_mapped { self.wall_range(view) } else { range };
        let mut distribution = ReadingDistribution::nothing(laser);
        let met = Met { kind: met, range, is_mapped };
        self.fill(&mut distribution, laser, view, met, |_, share| share);
        distribution
    }

    /// As [`Effects::reading`], where it is known when bursts come: that of the crosstalk which is number `i` of the list and has
    /// this share falls on the beam with probability `burst(i, share)`.
    ///
    /// `distribution` is [`ReadingDistribution::nothing`] and filled in place: the room for alternatives makes it costly to move.
    pub(crate) fn fill(
        &self,
        distribution: &mut ReadingDistribution,
        laser: &LaserOptions,
        view: &BeamView,
        Met { kind: met, range, is_mapped: mapped }: Met,
        burst: impl Fn(usize, f64) -> f64,
    ) {
        let max = distribution.max_m;
        let mut reading = Return::new(laser, &mut distribution.alternatives);
        let mut hit = Hit { laser, view, met, range, mapped, max, burst: &burst, index: 0 };
        for &i in &self.order {
            let effect = &self.list[i];
            hit.index = i;
            effect.kind.effect_type().reading(effect, &hit, &mut reading);
        }
        if !self.residuals.is_empty() {
            residual::act(&self.residuals, &hit, &mut reading);
        }
        let Return { scale, bias, wall_bias, wall_sigma, growth, tail, step_m, .. } = reading;
        if hit.is_in_range() {
            distribution.mean = scale * range + (bias + wall_bias);
            distribution.sigma = (hit.sigma(range) + growth * range * range) * wall_sigma;
        }
        distribution.tail[0] = tail;
        distribution.step_m = step_m;
    }
}

/// The surface that a beam has met.
#[derive(Clone, Copy)]
pub(crate) struct Met {
    pub kind: HitKind,
    /// Where it is \[m\].
    pub range: f64,
    /// Whether it is the wall of the map, moved as it may be.
    pub is_mapped: bool,
}

/// The most that a beam may read instead of its return by an effect: beams behind a pane end on a surface or before it.
fn alternatives(effect: &Effect) -> usize {
    match effect.kind.description().replaces {
        None => 0,
        Some(Replacement::Behind) => {
            let [_, clutter] = effect.numbers();
            if clutter > 0.0 { 2 } else { 1 }
        }
        Some(_) => 1,
    }
}
