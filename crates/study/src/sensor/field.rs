use std::f64::consts::TAU;

use glam::DVec2;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::{Sensor, Values};

/// A probe on the axis of a magnetic transmitter; its state is its place on that axis \[m\].
///
/// Fields are those of dipoles, in units of (transmitter's moment) mu0 / 4 pi: 2 / d^3 on the axis. The device knows
/// that law alone and turns the strength of the field that it measures into a place by inverting it. What metal adds to
/// the field it takes for another place.
pub(crate) struct FieldSensor {
    /// Where the probe can be \[m\], lowest and highest.
    pub positions: [f64; 2],
    /// Its possible values.
    pub values: Values,
    /// Standard deviation next to the transmitter \[m\].
    pub sigma: f64,
    /// Noise of the position at the largest value, from the noise of the field \[m\]. Where the field falls with d^3, noise
    /// of the field becomes noise of the position that grows with d^4.
    pub field_sigma: f64,
    /// The metal; `None` for still surroundings.
    pub forceps: Option<Forceps>,
}

/// A metal object that a hand sweeps to and fro beside the axis, and withdraws from time to time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Forceps {
    /// Radius of the sphere of high permeability that has the same induced dipole \[m\].
    pub radius: f64,
    /// Middle of the sweep, along and beside the axis \[m\].
    pub centre: DVec2,
    /// Half its length \[m\].
    pub sweep: f64,
    /// Standard deviation of the hand about it \[m\].
    pub wobble: f64,
    /// Share of the time in which it is out of reach.
    pub withdrawn_share: f64,
}

/// Field of the dipole `moment` at `offset` from it.
fn dipole_field(moment: DVec2, offset: DVec2) -> DVec2 {
    let distance = offset.length();
    let direction = offset / distance;
    (3.0 * moment.dot(direction) * direction - moment) / distance.powi(3)
}

impl Forceps {
    /// Where it is at a moment of the sweep; `None` while it is withdrawn.
    fn place(&self, random: &mut dyn Rng) -> Option<DVec2> {
        let withdrawn = random.random::<f64>() < self.withdrawn_share;
        let phase = TAU * random.random::<f64>();
        let mut wobble = || -> f64 { StandardNormal.sample(random) };
        let offset = DVec2::new(wobble(), wobble()) * self.wobble;
        (!withdrawn).then(|| self.centre + DVec2::new(self.sweep * phase.sin(), 0.0) + offset)
    }

    /// Its contribution to the field at `probe`: a sphere of radius a and high permeability in the field B has the dipole
    /// a^3 B (Jackson, Classical Electrodynamics, section 5.11). It doesn't come nearer to the probe or the transmitter than
    /// its own surface.
    fn field(&self, place: DVec2, probe: DVec2) -> DVec2 {
        let apart = |from: DVec2| {
            let offset = place - from;
            from + offset * (1.5 * self.radius / offset.length().max(1e-9)).max(1.0)
        };
        let place = apart(probe);
        let moment = dipole_field(DVec2::X, place) * self.radius.powi(3);
        dipole_field(moment, probe - place)
    }
}

impl Sensor for FieldSensor {
    fn state(&self, random: &mut dyn Rng) -> Vec<f64> {
        let [lo, hi] = self.positions;
        vec![lo + (hi - lo) * random.random::<f64>()]
    }

    fn observe(&self, state: &[f64], random: &mut dyn Rng) -> f64 {
        let probe = DVec2::new(state[0], 0.0);
        let mut field = dipole_field(DVec2::X, probe);
        if let Some(forceps) = &self.forceps
            && let Some(place) = forceps.place(random)
        {
            field += forceps.field(place, probe);
        }
        let mut normal = || -> f64 { StandardNormal.sample(random) };
        // d = (2 / B)^(1/3), so that an error dB moves the place by d^4 dB / 6.
        let field_sigma = 6.0 * self.field_sigma / self.values.last.powi(4);
        let measured = (field.length() + field_sigma * normal()).max(f64::MIN_POSITIVE);
        self.values.nearest((2.0 / measured).cbrt() + self.sigma * normal())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use locsim_core::{Draw, Stage};

    /// On its axis a dipole's field is 2 m / d^3 along it, beside it -m / d^3.
    #[test]
    fn the_field_of_a_dipole_is_the_textbooks() {
        let on_axis = dipole_field(DVec2::X, DVec2::new(0.2, 0.0));
        let beside = dipole_field(DVec2::X, DVec2::new(0.0, 0.2));
        assert!((on_axis - DVec2::new(250.0, 0.0)).length() < 1e-9);
        assert!((beside - DVec2::new(-125.0, 0.0)).length() < 1e-9);
    }

    fn readings(forceps: Option<Forceps>, sigma: f64) -> Vec<f64> {
        let sensor = FieldSensor {
            positions: [0.02, 0.18],
            values: Values { resolution: 1e-4, last: 0.2 },
            sigma,
            field_sigma: 0.0,
            forceps,
        };
        let draw = Draw::new(1, Stage::Laser, 0);
        (0..500).map(|i| sensor.observe(&[0.1], &mut draw.item(i))).collect()
    }

    #[test]
    fn without_noise_and_metal_the_inversion_is_exact_and_metal_disturbs_it() {
        assert!(readings(None, 0.0).iter().all(|z| (z - 0.1).abs() < 1e-12));
        let forceps = Forceps {
            radius: 0.012,
            centre: DVec2::new(0.1, 0.04),
            sweep: 0.05,
            wobble: 0.003,
            withdrawn_share: 0.3,
        };
        let disturbed = readings(Some(forceps), 0.0);
        let untouched = disturbed.iter().filter(|z| (*z - 0.1).abs() < 1e-12).count();
        let moved = disturbed.iter().filter(|z| (*z - 0.1).abs() > 5e-4).count();
        // 150 of 500 are expected where the object is withdrawn; 5 standard deviations of the binomial are 51.
        assert!(untouched > 99, "{untouched}");
        assert!(moved > 100, "{moved}");
    }
}
