//! The oracle: the density by which a simulated world makes its readings.

use std::sync::Arc;

use locsim_core::{Beams, DependsOn, Draw, Obstructions, SensorModel, Survival};
use rand::{Rng, RngExt};

use crate::SensorError;
use crate::beam::{Beam, cdfs, log_densities, samples};
use crate::normal::{self, RangeNormal};

/// Noise beyond this many standard deviations (mass 6e-7) is taken as none.
const REACH: f32 = 5.0;

/// The best that any model of independent beams can be in a simulated world: it knows the true noise and,
/// from [`Obstructions`], how far a ray gets before an unmapped object stops it.
///
/// With S the survival function of a ray and r its nominal range, the object in front stands at r with
/// probability S(r), otherwise at x < r with density -S'(x), constant within a bin; the reading is that
/// distance plus Gaussian noise of deviation `sigma_m + sigma_per_m * x`, conditioned on being at least 0,
/// and the maximum range if it isn't below it. The noise's deviation is taken as constant within a bin. A ray
/// that meets neither map nor object reads the maximum range.
pub struct Oracle {
    obstructions: Arc<dyn Obstructions>,
    sigma_m: f32,
    sigma_per_m: f32,
}

/// Where an unmapped object may stand on a ray: evenly within `[near, far]` \[m\].
struct Stretch {
    near: f32,
    far: f32,
    /// Probability that the nearest object stands here.
    mass: f32,
}

impl Oracle {
    /// The name of this model in scenarios and tables. It is no [`crate::ModelKind`]: there is nothing to fit
    /// or save.
    pub const NAME: &'static str = "oracle";

    /// `sigma_m` \[m\] and `sigma_per_m` \[m per m of range\] describe the true noise.
    ///
    /// # Errors
    /// [`SensorError::Parameter`] unless `sigma_m` is positive and `sigma_per_m` at least 0, both finite.
    pub fn new(
        obstructions: Arc<dyn Obstructions>,
        sigma_m: f32,
        sigma_per_m: f32,
    ) -> Result<Self, SensorError> {
        if !(sigma_m > 0.0 && sigma_m.is_finite()) {
            let (what, allowed) = ("the noise's sigma_m", "positive and finite");
            return Err(SensorError::Parameter { what, allowed, value: sigma_m.into() });
        }
        if !(sigma_per_m >= 0.0 && sigma_per_m.is_finite()) {
            let (what, allowed) = ("the noise's sigma_per_m", "at least 0 and finite");
            return Err(SensorError::Parameter { what, allowed, value: sigma_per_m.into() });
        }
        Ok(Self { obstructions, sigma_m, sigma_per_m })
    }

    fn noise(&self, mean: f32) -> RangeNormal {
        RangeNormal { mean, sigma: self.sigma_m + self.sigma_per_m * mean }
    }

    fn survival(&self, beams: &Beams<'_>, beam: Beam) -> Survival<'_> {
        let heading = beams.laser.theta[beam.pose] + f64::from(beams.bearings[beam.bearing]);
        let (x, y) = (beams.laser.x[beam.pose], beams.laser.y[beam.pose]);
        self.obstructions.survival(x, y, heading, beam.nominal)
    }

    /// The bins of a survival function between two ranges in which an object may stand, cut at `to`.
    fn stretches(&self, survival: Survival<'_>, from: f32, to: f32) -> impl Iterator<Item = Stretch> {
        let width = self.obstructions.bin_m();
        let Survival { probability, start_m } = survival;
        let first = ((from.max(0.0) - start_m) / width).max(0.0) as usize;
        let last = ((to - start_m) / width).ceil().max(0.0) as usize;
        (first..last.min(probability.len().saturating_sub(1))).filter_map(move |i| {
            let drop = probability[i] - probability[i + 1];
            let begin = start_m + i as f32 * width;
            let (near, far) = (begin.max(0.0), (begin + width).min(to));
            // where the nominal range ends inside a bin, the surface hides objects behind it
            (drop > 0.0 && far > near).then(|| Stretch { near, far, mass: drop * (far - near) / width })
        })
    }

    /// Probability that nothing unmapped stands before the nominal range.
    fn clear(&self, survival: Survival<'_>, range: f32) -> f32 {
        let at = ((range - survival.start_m) / self.obstructions.bin_m()).max(0.0);
        let i = at as usize;
        match (survival.probability.get(i), survival.probability.get(i + 1)) {
            (Some(a), Some(b)) => a + (at - i as f32) * (b - a),
            (a, _) => a.or(survival.probability.last()).copied().unwrap_or(1.0),
        }
    }

    /// P(reading <= `z`) of an object that stands evenly within a stretch, for `z` from 0 to the maximum.
    fn stretch_cdf(&self, stretch: &Stretch, z: f32) -> f32 {
        let below = self.below_zero(stretch);
        (self.uncut_cdf(stretch, z) - below) / (1.0 - below)
    }

    /// Density \[1/m\] of a reading of an object that stands evenly within a stretch.
    fn stretch_density(&self, stretch: &Stretch, z: f32) -> f32 {
        let &Stretch { near, far, .. } = stretch;
        let sigma = self.noise(0.5 * (near + far)).sigma;
        let mass = normal::quick_cdf((z - near) / sigma) - normal::quick_cdf((z - far) / sigma);
        mass / ((far - near) * (1.0 - self.below_zero(stretch)))
    }

    /// P(reading < 0), which is conditioned away.
    fn below_zero(&self, stretch: &Stretch) -> f32 {
        let away = stretch.near > REACH * self.noise(stretch.far).sigma;
        if away { 0.0 } else { self.uncut_cdf(stretch, 0.0) }
    }

    /// P(reading <= `z`) before readings below 0 are conditioned away.
    fn uncut_cdf(&self, stretch: &Stretch, z: f32) -> f32 {
        let &Stretch { near, far, .. } = stretch;
        let sigma = self.noise(0.5 * (near + far)).sigma;
        let (first, last) = ((z - near) / sigma, (z - far) / sigma);
        if first < -REACH || last > REACH {
            return if last > REACH { 1.0 } else { 0.0 };
        }
        // the integral of the normal distribution function is t cdf(t) + pdf(t)
        let primitive = |t: f32| t * normal::quick_cdf(t) + normal::pdf(f64::from(t)) as f32;
        ((primitive(first) - primitive(last)) * sigma / (far - near)).clamp(0.0, 1.0)
    }

    fn density(&self, survival: Survival<'_>, z: f32, beam: Beam) -> f32 {
        let range = beam.range.min(beam.max_range);
        let clear = self.clear(survival, range);
        // noise where the reading is; at the far end of its own reach it is a little wider
        let reach = REACH * self.noise(z * (1.0 + REACH * self.sigma_per_m) + REACH * self.sigma_m).sigma;
        if z >= beam.max_range {
            let nominal = if beam.is_open() { 1.0 } else { self.noise(range).at(beam.max_range) };
            let objects: f32 = self
                .stretches(survival, z - reach, range)
                .map(|s| s.mass * (1.0 - self.stretch_cdf(&s, z)))
                .sum();
            return clear * nominal + objects;
        }
        let nominal =
            if beam.is_open() || (z - range).abs() > reach { 0.0 } else { self.noise(range).density(z) };
        let objects: f32 = self
            .stretches(survival, z - reach, range)
            .take_while(|s| s.near <= z + reach)
            .map(|s| s.mass * self.stretch_density(&s, z))
            .sum();
        clear * nominal + objects
    }

    fn draw(&self, survival: Survival<'_>, beam: Beam, rng: &mut dyn Rng) -> f32 {
        let range = beam.range.min(beam.max_range);
        let mut u = rng.random::<f32>();
        for stretch in self.stretches(survival, 0.0, range) {
            if u < stretch.mass {
                let at = stretch.near + (stretch.far - stretch.near) * u / stretch.mass;
                return self.noise(at).sample(beam.max_range, rng);
            }
            u -= stretch.mass;
        }
        if beam.is_open() { beam.max_range } else { self.noise(range).sample(beam.max_range, rng) }
    }
}

impl SensorModel for Oracle {
    fn name(&self) -> &str {
        Self::NAME
    }

    fn depends_on(&self) -> DependsOn {
        DependsOn::Everything
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        log_densities(z, beams, out, |z, beam| self.density(self.survival(beams, beam), z, beam).ln());
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        cdfs(z, beams, out, |z, beam| {
            let survival = self.survival(beams, beam);
            let range = beam.range.min(beam.max_range);
            let nominal = if beam.is_open() { 0.0 } else { self.noise(range).cdf(z) };
            let objects: f32 =
                self.stretches(survival, 0.0, range).map(|s| s.mass * self.stretch_cdf(&s, z)).sum();
            self.clear(survival, range) * nominal + objects
        });
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        samples(beams, draw, out, |beam, rng| self.draw(self.survival(beams, beam), beam, rng));
    }
}
