use super::{ClutterSurvival, LaserOptions};
use crate::effect::{BeamView, Effects, HitKind, Parts, ReadingDistribution};

/// The steps in which readings of a laser without a resolution are compared with quantized ones \[m\]: finer than any laser's.
const FINEST_STEP_M: f64 = 1e-4;

/// The least probability that a survival counts as: the logarithm of none would be infinite.
const LEAST_SURVIVAL: f64 = 1e-12;

/// A beam with everything that its reading depends on.
#[derive(Clone, Debug)]
pub struct ClutteredBeam {
    /// What effects may depend on.
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
/// that at the reading's own range.
#[derive(Clone, Copy, Debug)]
pub struct ReadingMixture<'a> {
    /// The laser.
    pub laser: &'a LaserOptions,
    /// The effects of the world.
    pub effects: &'a Effects,
    /// Factor on the density of clutter.
    pub clutter_density: f64,
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
    /// What a density per metre was multiplied by to be one of usable multiples of the laser's step, as these are.
    pub measure: f64,
    /// Mean of a reading of the surface \[m\]; infinite where nothing is met.
    pub mean: f64,
    /// Its standard deviation \[m\].
    pub sigma: f64,
}

/// A beam without clutter in front of it.
struct Unobstructed {
    reading: ReadingDistribution,
    /// Range of the surface \[m\].
    range: f64,
    /// Probability that no clutter is in front.
    clear: f64,
}

/// A reading of the nearest clutter.
struct OfClutter {
    /// `None` for one that is the clutter's range.
    reading: Option<ReadingDistribution>,
    /// Range of the clutter \[m\].
    range: f64,
}

impl OfClutter {
    /// Parts of the alternatives, and the probability of none of them.
    fn alternatives(&self, of: impl Fn(&ReadingDistribution) -> Parts) -> [f64; 2] {
        self.reading.as_ref().map(of).map_or([0.0, 1.0], |parts| [parts.alternatives, parts.rest])
    }
}

impl ReadingMixture<'_> {
    /// The density of a reading `z` \[m\] from the minimum range on; `shift` is added to the range of surface and clutter \[m\].
    ///
    /// Densities are those of multiples of the laser's own step, so that worlds of coarser steps can be compared. A fine step
    /// has the density at its middle instead of its probability over the step: a relative error of (t^2 - 1) / 24 times the
    /// square of the step in standard deviations, at t standard deviations from the mean.
    pub fn density(&self, beam: &ClutteredBeam, shift: f64, z: f64) -> MixtureDensity {
        let Unobstructed { reading, range, clear } = self.unobstructed(beam, shift);
        let of_surface = reading.density_parts(z);
        let mut total = clear * of_surface.total();
        let mut usable = clear * reading.usable();
        let mut clutter = 0.0;
        if clear < 1.0 {
            let is_return = z < reading.max_m;
            let nearest =
                self.clutter_read_at(beam, if is_return { z } else { 0.5 * range.min(reading.max_m) });
            let [instead, rest] = nearest.alternatives(|reading| reading.density_parts(z));
            if is_return && nearest.range < range {
                clutter = rest * self.nearest_density(beam, nearest.range - shift);
            }
            total += (1.0 - clear) * instead + clutter;
            usable += self.usable_clutter(beam, shift, clear, &nearest, reading.min_m);
        }
        let measure = reading.on_grid(z, self.laser.resolution_m.max(FINEST_STEP_M)) / usable;
        MixtureDensity {
            total: measure * total,
            surface: measure * clear * of_surface.returned,
            clutter: measure * clutter,
            unobstructed: measure * of_surface.total(),
            clear,
            measure,
            mean: reading.mean,
            sigma: reading.sigma,
        }
    }

    /// P(value before rounding < `x`) of a usable reading, for `x` from the minimum to the maximum range \[m\]: at a fine step
    /// that is the distribution function less half of the step's own probability. `shift` as in [`ReadingMixture::density`].
    pub fn cdf(&self, beam: &ClutteredBeam, shift: f64, x: f64) -> f64 {
        let Unobstructed { reading, range, clear } = self.unobstructed(beam, shift);
        let mut below = clear * reading.below(x).total();
        let mut usable = clear * reading.usable();
        if clear < 1.0 {
            let nearest = self.clutter_read_at(beam, x.min(range));
            let [instead, rest] = nearest.alternatives(|reading| reading.below(x));
            let survival = self.survival(beam, nearest.range.min(range) - shift).max(clear);
            below += (1.0 - clear) * instead + rest * (1.0 - survival);
            usable += self.usable_clutter(beam, shift, clear, &nearest, reading.min_m);
        }
        ((below - (1.0 - usable)) / usable).clamp(0.0, 1.0)
    }

    fn unobstructed(&self, beam: &ClutteredBeam, shift: f64) -> Unobstructed {
        let view = BeamView { range: beam.view.range + shift, ..beam.view };
        let range = beam.object.map_or_else(|| self.effects.wall_range(&view), |object| object + shift);
        let reading = self.effects.reading_of(
            self.laser,
            &view,
            HitKind::Wall,
            range,
            beam.object.is_none(),
            |_, share| share,
        );
        let log_clear = if beam.object.is_some() || range == view.range {
            beam.log_clear
        } else {
            beam.log_clear_to((range - shift).min(reading.max_m))
        };
        Unobstructed { reading, range, clear: (self.clutter_density * log_clear).exp() }
    }

    /// The clutter whose reading is expected at `z` \[m\].
    fn clutter_read_at(&self, beam: &ClutteredBeam, z: f64) -> OfClutter {
        if self.effects.is_empty() {
            return OfClutter { reading: None, range: z };
        }
        let reading =
            self.effects.reading_of(self.laser, &beam.view, HitKind::Object, z, false, |_, share| share);
        // A reading errs by about as much a little nearer or farther.
        let error = if reading.mean.is_finite() { reading.mean - z } else { 0.0 };
        OfClutter { reading: Some(reading), range: z - error }
    }

    /// Probability that no clutter stands within `range` metres.
    fn survival(&self, beam: &ClutteredBeam, range: f64) -> f64 {
        let (survival, _) = beam.survival_at(range);
        if survival < 1.0 { survival.max(LEAST_SURVIVAL).powf(self.clutter_density) } else { 1.0 }
    }

    /// Density of the nearest clutter at `range` \[1/m\].
    fn nearest_density(&self, beam: &ClutteredBeam, range: f64) -> f64 {
        let (survival, density) = beam.survival_at(range);
        if density > 0.0 {
            let factor = self.clutter_density;
            factor * survival.max(LEAST_SURVIVAL).powf(factor - 1.0) * density
        } else {
            0.0
        }
    }

    /// Probability that clutter stands in front and the reading is usable.
    fn usable_clutter(
        &self,
        beam: &ClutteredBeam,
        shift: f64,
        clear: f64,
        nearest: &OfClutter,
        min_m: f64,
    ) -> f64 {
        let [instead, rest] = nearest.alternatives(ReadingDistribution::unusable);
        let within_reach = self.survival(beam, min_m - shift).max(clear);
        (1.0 - clear) * (1.0 - rest - instead) + rest * (within_reach - clear)
    }
}
