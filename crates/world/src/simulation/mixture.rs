use super::{ClutterSurvival, LaserOptions};
use crate::effect::{BeamView, Effects, HitKind, Met, Parts, ReadingDistribution, least_value};

/// The steps in which readings of a laser without a resolution are compared with quantized ones \[m\]: finer than any laser's.
const FINEST_STEP_M: f64 = 1e-4;

/// The least probability that a survival counts as: the logarithm of none would be infinite.
const LEAST_SURVIVAL: f64 = 1e-12;

/// A beam with everything that its reading depends on.
#[derive(Clone, Debug)]
pub struct ClutteredBeam {
    /// Covariates of effects.
    pub view: BeamView,
    /// Range of a missing object in front of the wall \[m\].
    pub object: Option<f64>,
    /// Change of the range with the robot's pose in the map frame \[m/m, m/m, m/rad\].
    pub jacobian: [f64; 3],
    /// How far the beam gets among clutter.
    pub survival: ClutterSurvival,
    /// Log probability that no clutter stands before the nominal surface; see [`ClutteredBeam::range`].
    pub log_clear: f64,
}

impl ClutteredBeam {
    /// A beam that meets these, of a laser of this maximum range.
    pub fn new(
        view: BeamView,
        object: Option<f64>,
        jacobian: [f64; 3],
        survival: ClutterSurvival,
        max_range_m: f64,
    ) -> Self {
        let mut beam = Self { view, object, jacobian, survival, log_clear: 0.0 };
        beam.log_clear = beam.log_clear_to(beam.range().min(max_range_m));
        beam
    }

    /// Nominal range of the surface \[m\]: of the missing object in front of it, or of the map's wall where that isn't moved.
    #[inline]
    pub fn range(&self) -> f64 {
        self.object.unwrap_or(self.view.range)
    }

    /// Probability that no clutter stands within `range` metres, and the density \[1/m\] of the nearest one there.
    #[inline]
    pub fn survival_at(&self, range: f64) -> (f64, f64) {
        self.survival.at(range)
    }

    fn log_clear_to(&self, range: f64) -> f64 {
        self.survival_at(range).0.max(LEAST_SURVIVAL).ln()
    }
}

/// The distribution of a beam's reading among unmapped clutter.
///
/// With the probability that no clutter stands in front, the reading is one of the surface; otherwise it is one of the nearest
/// clutter, whose range has the density -S'(r), where S(r) is the beam's [`ClutterSurvival`]. Both are read by the
/// [`ReadingDistribution`] of what was met, which the simulator draws from. Density and distribution function are those of a
/// usable reading.
///
/// Two approximations make it fast: clutter is read without noise, and the probability of what may be read instead of it is
/// that of clutter at the reading's own range, or of clutter in the middle of where it may stand if nothing is returned.
#[derive(Clone, Copy, Debug)]
pub struct ReadingMixture<'a> {
    laser: &'a LaserOptions,
    effects: &'a Effects,
    clutter_density: f64,
    /// [`ReadingDistribution::limits`] of readings with the laser's own step.
    limits: [f64; 2],
}

/// The density of a reading by what it is of: per metre, a probability at the maximum range.
#[derive(Clone, Copy, Debug)]
pub struct MixtureDensity {
    /// Of whatever was read.
    pub total: f64,
    /// Of the surface itself.
    pub surface: f64,
    /// Of clutter.
    pub clutter: f64,
    /// Of a beam that no clutter is in front of, without the probability of that.
    pub unobstructed: f64,
    /// Probability that no clutter is in front.
    pub clear: f64,
    /// Probability that the reading is of the surface itself, in units of the measure: `surface` over the density of its noise.
    pub returned: f64,
    /// [`ReadingDistribution::tail`] of a reading of the surface.
    pub tail: [f64; 2],
    /// Factor from the density per metre to that of usable multiples of the laser's step.
    pub measure: f64,
    /// Mean of a reading of the surface \[m\]; infinite where nothing is met.
    pub mean: f64,
    /// Its standard deviation \[m\].
    pub sigma: f64,
}

/// What a reading may be of, by the [`ReadingMixture`] that it is asked of: all of its density that doesn't depend on how much
/// clutter there is.
#[derive(Clone, Copy, Debug)]
pub struct ReadingSources {
    /// Log probability that no clutter of the nominal density is in front of the surface.
    log_clear: f64,
    of_surface: Parts,
    /// Probability that something usable is read where no clutter is.
    usable: f64,
    clutter: Option<ClutterSource>,
    /// [`ReadingDistribution::on_grid`].
    on_grid: f64,
    tail: [f64; 2],
    mean: f64,
    sigma: f64,
}

/// Clutter in front of a surface, which may have been read.
#[derive(Clone, Copy, Debug)]
struct ClutterSource {
    nearest: OfClutter,
    /// [`ClutteredBeam::survival_at`] where it stands, if it stands in front of the surface.
    at: Option<(f64, f64)>,
    /// Probability that no clutter of the nominal density stands within the minimum range.
    within_reach: f64,
}

/// A reading of the nearest clutter.
#[derive(Clone, Copy, Debug)]
struct OfClutter {
    /// Range of the clutter \[m\].
    range: f64,
    /// Probability, or its density, of what is read instead of it.
    instead: f64,
    /// Probability that something usable is read instead of it.
    usable_instead: f64,
    /// Probability that nothing is read instead of it.
    rest: f64,
}

impl<'a> ReadingMixture<'a> {
    /// Readings of this laser in a world with these effects; `clutter_density` is a factor on the density of clutter.
    pub fn new(laser: &'a LaserOptions, effects: &'a Effects, clutter_density: f64) -> Self {
        let limits = [laser.min_range_m, laser.max_range_m]
            .map(|m| least_value(f64::from(m as f32), laser.resolution_m));
        Self { laser, effects, clutter_density, limits }
    }

    fn limits(&self, reading: &ReadingDistribution) -> [f64; 2] {
        if reading.step_m == self.laser.resolution_m { self.limits } else { reading.limits() }
    }

    /// The density of a reading `z` \[m\] from the minimum range on; `shift` is added to the range of surface and clutter \[m\].
    ///
    /// Densities are those of multiples of the laser's own step, so that worlds of coarser steps can be compared. A fine step
    /// has the density at its middle instead of its probability over the step: a relative error of (t^2 - 1) / 24 times the
    /// square of the step in standard deviations, at t standard deviations from the mean.
    #[inline]
    pub fn density(&self, beam: &ClutteredBeam, shift: f64, z: f64) -> MixtureDensity {
        self.density_of(&self.sources(beam, shift, z))
    }

    /// What a reading may be of, whatever the density of clutter is: the first part of [`ReadingMixture::density`], and the longer.
    #[inline]
    pub fn sources(&self, beam: &ClutteredBeam, shift: f64, z: f64) -> ReadingSources {
        let view = BeamView { range: beam.view.range + shift, ..beam.view };
        let range = self.surface_range(beam, &view, shift);
        let mut reading = ReadingDistribution::nothing(self.laser);
        self.effects.fill(&mut reading, self.laser, &view, surface(beam, range), |_, share| share);
        let log_clear = self.log_clear(beam, &view, range, shift);
        let [of_surface, usable] = reading.density_parts(self.limits(&reading), z);
        let clutter = (log_clear < 0.0).then(|| {
            let is_return = z < reading.max_m;
            let expected = if is_return { z } else { beam.survival.middle(range - shift) + shift };
            let nearest = self
                .clutter_read_at(beam, expected, |reading| reading.density_parts(self.limits(reading), z));
            let is_in_front = is_return && nearest.range < range;
            let at = is_in_front.then(|| beam.survival_at(nearest.range - shift));
            ClutterSource { nearest, at, within_reach: beam.survival_at(reading.min_m - shift).0 }
        });
        ReadingSources {
            log_clear,
            of_surface,
            usable: usable.total(),
            clutter,
            on_grid: reading.on_grid(z, self.laser.resolution_m.max(FINEST_STEP_M)),
            tail: reading.tail,
            mean: reading.mean,
            sigma: reading.sigma,
        }
    }

    /// The density of a reading by what it may be of: the second part of [`ReadingMixture::density`].
    #[inline]
    pub fn density_of(&self, sources: &ReadingSources) -> MixtureDensity {
        let of_surface = sources.of_surface;
        let clear = (self.clutter_density * sources.log_clear).exp();
        let mut total = clear * of_surface.total();
        let mut usable = clear * sources.usable;
        let mut clutter = 0.0;
        if clear < 1.0
            && let Some(ClutterSource { nearest, at, within_reach }) = &sources.clutter
        {
            if let Some(at) = *at {
                clutter = nearest.rest * self.nearest_density(at);
            }
            total += (1.0 - clear) * nearest.instead + clutter;
            usable += self.usable_clutter(clear, nearest, *within_reach);
        }
        let measure = sources.on_grid / usable;
        MixtureDensity {
            total: measure * total,
            surface: measure * clear * of_surface.returned,
            clutter: measure * clutter,
            unobstructed: measure * of_surface.total(),
            clear,
            returned: measure * clear * of_surface.rest,
            tail: sources.tail,
            measure,
            mean: sources.mean,
            sigma: sources.sigma,
        }
    }

    /// P(value before rounding < `x`) of a usable reading, for `x` from the minimum to the maximum range \[m\]: at a fine step
    /// that is the distribution function less half of the step's own probability. `shift` as in [`ReadingMixture::density`].
    pub fn cdf(&self, beam: &ClutteredBeam, shift: f64, x: f64) -> f64 {
        let view = BeamView { range: beam.view.range + shift, ..beam.view };
        let range = self.surface_range(beam, &view, shift);
        let mut reading = ReadingDistribution::nothing(self.laser);
        self.effects.fill(&mut reading, self.laser, &view, surface(beam, range), |_, share| share);
        let clear = (self.clutter_density * self.log_clear(beam, &view, range, shift)).exp();
        let [of_surface, usable] = reading.below(self.limits(&reading), x);
        let mut below = clear * of_surface.total();
        let mut usable = clear * usable.total();
        if clear < 1.0 {
            let nearest =
                self.clutter_read_at(beam, x.min(range), |reading| reading.below(self.limits(reading), x));
            let survival = self.survival(beam.survival_at(nearest.range.min(range) - shift).0).max(clear);
            below += (1.0 - clear) * nearest.instead + nearest.rest * (1.0 - survival);
            usable += self.usable_clutter(clear, &nearest, beam.survival_at(reading.min_m - shift).0);
        }
        ((below - (1.0 - usable)) / usable).clamp(0.0, 1.0)
    }

    /// Range of the surface, where it really is \[m\].
    fn surface_range(&self, beam: &ClutteredBeam, view: &BeamView, shift: f64) -> f64 {
        beam.object.map_or_else(|| self.effects.wall_range(view), |object| object + shift)
    }

    /// Log probability that no clutter of the nominal density is in front of the surface.
    fn log_clear(&self, beam: &ClutteredBeam, view: &BeamView, range: f64, shift: f64) -> f64 {
        if beam.object.is_some() || range == view.range {
            beam.log_clear
        } else {
            beam.log_clear_to((range - shift).min(f64::from(self.laser.max_range_m as f32)))
        }
    }

    /// The clutter whose reading is expected at `z` \[m\], with the parts that `of` gives of what is read instead of it.
    fn clutter_read_at(
        &self,
        beam: &ClutteredBeam,
        z: f64,
        of: impl Fn(&ReadingDistribution) -> [Parts; 2],
    ) -> OfClutter {
        if self.effects.is_empty() {
            return OfClutter { range: z, instead: 0.0, usable_instead: 0.0, rest: 1.0 };
        }
        let mut reading = ReadingDistribution::nothing(self.laser);
        let met = Met { kind: HitKind::Object, range: z, is_mapped: false };
        self.effects.fill(&mut reading, self.laser, &beam.view, met, |_, share| share);
        // A reading errs by about as much a little nearer or farther.
        let error = if reading.mean.is_finite() { reading.mean - z } else { 0.0 };
        let [at_reading, usable] = of(&reading);
        OfClutter {
            range: z - error,
            instead: at_reading.alternatives,
            usable_instead: usable.alternatives,
            rest: usable.rest,
        }
    }

    /// Probability that no clutter stands within a range, for that of the nominal density.
    fn survival(&self, nominal: f64) -> f64 {
        if nominal < 1.0 { nominal.max(LEAST_SURVIVAL).powf(self.clutter_density) } else { 1.0 }
    }

    /// Density of the nearest clutter at a range \[1/m\], for the survival there and the density at the nominal one.
    fn nearest_density(&self, (survival, density): (f64, f64)) -> f64 {
        if density > 0.0 {
            let factor = self.clutter_density;
            factor * survival.max(LEAST_SURVIVAL).powf(factor - 1.0) * density
        } else {
            0.0
        }
    }

    /// Probability that clutter stands in front and the reading is usable; `within_reach` as in [`ClutterSource`].
    fn usable_clutter(&self, clear: f64, nearest: &OfClutter, within_reach: f64) -> f64 {
        let within_reach = self.survival(within_reach).max(clear);
        (1.0 - clear) * nearest.usable_instead + nearest.rest * (within_reach - clear)
    }
}

fn surface(beam: &ClutteredBeam, range: f64) -> Met {
    Met { kind: HitKind::Wall, range, is_mapped: beam.object.is_none() }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::super::fixtures::{block_options, laser_options, room};
    use super::super::{BlockIntegral, BlockModel};
    use super::*;
    use crate::effect::{Effect, EffectKind};

    const LASER: LaserOptions = LaserOptions {
        sigma_m: 0.01,
        sigma_per_m: 0.002,
        min_range_m: 0.3,
        max_range_m: 4.0,
        ..laser_options()
    };

    /// A beam from (2.5, 2) straight at the east wall of the room, through the clutter in front of it.
    fn beam() -> ClutteredBeam {
        let (origin, range) = (DVec2::new(2.5, 2.0), 3.5);
        let clutter = BlockIntegral::new(&BlockModel::new(block_options(), &room()).unwrap());
        let survival =
            ClutterSurvival::new(&clutter, [origin, DVec2::X], origin, range, 0.05, &mut Vec::new());
        let endpoint = origin + range * DVec2::X;
        let view = BeamView {
            secs: 3.0,
            bearing: 0.0,
            range,
            incidence: 0.2,
            endpoint,
            direction: DVec2::X,
            normal: DVec2::ZERO,
            jump: None,
            behind: None,
        };
        ClutteredBeam::new(view, None, [0.0; 3], survival, 4.0)
    }

    fn worlds() -> Vec<Effects> {
        let one = |kind, values: &[f64]| Effect::new(kind, values.to_vec(), Vec::new()).unwrap();
        vec![
            Effects::none(),
            Effects::new(vec![one(EffectKind::Crosstalk, &[0.2, 1.0])]).unwrap(),
            Effects::new(vec![
                one(EffectKind::RangeDropout, &[0.5, 1.0]),
                one(EffectKind::RangeBias, &[0.07]),
            ])
            .unwrap(),
        ]
    }

    /// P(value before rounding < x), summed over millimetres of where the nearest clutter stands, each read with its noise.
    fn plain_below(mixture: &ReadingMixture<'_>, beam: &ClutteredBeam, x: f64) -> f64 {
        let below = |met, range| {
            let mut reading = ReadingDistribution::nothing(mixture.laser);
            let met = Met { kind: met, range, is_mapped: met == HitKind::Wall };
            mixture.effects.fill(&mut reading, mixture.laser, &beam.view, met, |_, share| share);
            reading.below(reading.limits(), x)[0].total()
        };
        let survival = |range: f64| beam.survival_at(range).0.powf(mixture.clutter_density);
        let millimetres = (beam.view.range / 0.001).round() as u32;
        let of_clutter = (0..millimetres).map(|i| {
            let [near, middle, far] = [0.0, 0.5, 1.0].map(|share| 0.001 * (f64::from(i) + share));
            let probability = survival(near) - survival(far);
            if probability > 0.0 { probability * below(HitKind::Object, middle) } else { 0.0 }
        });
        survival(beam.view.range) * below(HitKind::Wall, beam.view.range) + of_clutter.sum::<f64>()
    }

    /// Where the probability of a lost return changes along the clutter, the distribution function errs by up to this.
    const BOUNDS: [f64; 3] = [0.005, 0.005, 0.06];

    #[test]
    fn the_fast_distribution_is_near_the_plain_one() {
        let beam = beam();
        for (effects, bound) in worlds().iter().zip(BOUNDS) {
            let mut worst = 0.0_f64;
            for clutter_density in [0.5, 1.0, 3.0] {
                let mixture = ReadingMixture::new(&LASER, effects, clutter_density);
                let unusable = plain_below(&mixture, &beam, LASER.min_range_m);
                for i in 8..100 {
                    let x = 0.04 * f64::from(i);
                    let plain = (plain_below(&mixture, &beam, x) - unusable) / (1.0 - unusable);
                    worst = worst.max((mixture.cdf(&beam, 0.0, x) - plain).abs());
                }
            }
            assert!(worst < bound, "{effects:?}: {worst}");
        }
    }

    /// The density adds up to the distribution function, and to 1 with the mass at the maximum range.
    #[test]
    fn the_density_is_the_slope_of_the_distribution_function() {
        let beam = beam();
        for (effects, bound) in worlds().iter().zip(BOUNDS) {
            let mixture = ReadingMixture::new(&LASER, effects, 1.3);
            let step = 5e-4;
            let (mut sum, mut worst) = (0.0, 0.0_f64);
            for i in 600..8000 {
                let z = step * (f64::from(i) + 0.5);
                let density = mixture.density(&beam, 0.0, z);
                assert!(density.surface + density.clutter <= density.total * (1.0 + 1e-12), "{density:?}");
                sum += step * density.total;
                if i % 100 == 99 {
                    worst = worst.max((sum - mixture.cdf(&beam, 0.0, z + 0.5 * step)).abs());
                }
            }
            let total = sum + mixture.density(&beam, 0.0, 4.0).total;
            assert!(worst < bound && (total - 1.0).abs() < bound, "{effects:?}: {worst} {total}");
        }
    }

    /// What a reading may be of is the same however much clutter there is.
    #[test]
    fn sources_of_a_reading_do_not_depend_on_the_density_of_clutter() {
        let beam = beam();
        for effects in &worlds() {
            let [few, many] = [0.2, 5.0].map(|density| ReadingMixture::new(&LASER, effects, density));
            for z in [0.4, 2.9, 3.3, 3.49, 3.8, 4.0] {
                let of = |density: MixtureDensity| (density.total, density.clutter, density.clear);
                let [own, other] =
                    [&many, &few].map(|from| of(many.density_of(&from.sources(&beam, 0.01, z))));
                assert_eq!(own, other);
                assert_eq!(own, of(many.density(&beam, 0.01, z)));
                assert_ne!(own, of(few.density(&beam, 0.01, z)));
            }
        }
    }

    /// Clutter hides a wall that has moved farther more often.
    #[test]
    fn clutter_stands_in_front_of_where_the_wall_is() {
        let beam = beam();
        let place = vec![[DVec2::new(6.0, 4.0), DVec2::new(6.0, 0.0)]];
        let clear = |offset: f64| {
            let moved = Effect::new(EffectKind::MovedWall, vec![offset, 0.0], place.clone()).unwrap();
            let effects = Effects::new(vec![moved]).unwrap();
            let mixture = ReadingMixture::new(&LASER, &effects, 1.0);
            mixture.density(&beam, 0.0, 3.0).clear
        };
        assert!((clear(0.0) - beam.log_clear.exp()).abs() < 1e-12);
        assert!(clear(-0.5) > clear(0.0) + 0.05, "{} {}", clear(-0.5), clear(0.0));
    }
}
