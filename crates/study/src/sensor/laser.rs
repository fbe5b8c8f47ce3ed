use std::f64::consts::TAU;

use glam::DVec2;
use locsim_core::{Draw, Stage};
use locsim_world::raycast::ExactRangeMap;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::{Sensor, Values};

/// Beams nearer to a wall's direction than this add no more noise: a tangent has no end.
const STEEPEST_TANGENT: f64 = 10.0;

/// Beams that tell whether a path has walls in reach.
const PROBES: u32 = 2000;

/// A planar laser that is driven around a mapped room. Its state is (nominal range r \[m\], incidence alpha \[rad\]) by
/// a ray cast into the map; the beams of all bearings are pooled.
///
/// The noise is Gaussian with variance `sigma`^2 + (`sigma_per_m2` r^2)^2 + (`sigma_per_tan` tan alpha)^2. The second
/// term is that of a triangulating laser, whose range is inverse to the place of the spot on the imager (Konolige et al.
/// 2008): a baseline of 50 mm, a lens of 16 mm and a tenth of a pixel of 6 um give 0.75e-3 per metre. The third is the
/// spot's length on a slanted wall.
pub(crate) struct PlanarLaser {
    /// The room.
    pub map: ExactRangeMap,
    /// Closed path that the robot drives \[m\].
    pub path: Vec<DVec2>,
    /// Beams of a scan.
    pub beams: u32,
    /// Its possible values.
    pub values: Values,
    /// Constant part of the deviation \[m\].
    pub sigma: f64,
    /// Growth with the square of the range \[1/m\].
    pub sigma_per_m2: f64,
    /// Growth with the tangent of the incidence angle \[m\].
    pub sigma_per_tan: f64,
}

impl PlanarLaser {
    /// A place on the path and the heading there, every metre equally likely.
    fn pose(&self, random: &mut dyn Rng) -> (DVec2, f64) {
        let next = |i: usize| self.path[(i + 1) % self.path.len()];
        let lengths: Vec<f64> = (0..self.path.len()).map(|i| self.path[i].distance(next(i))).collect();
        let mut along = random.random::<f64>() * lengths.iter().sum::<f64>();
        let last = lengths.len() - 1;
        for (i, length) in lengths.iter().enumerate() {
            if along <= *length || i == last {
                let step = next(i) - self.path[i];
                return (self.path[i] + step * (along / length).min(1.0), step.to_angle());
            }
            along -= length;
        }
        (self.path[0], 0.0)
    }

    /// A beam at random: what it meets within the maximum range.
    fn beam(&self, random: &mut dyn Rng) -> Option<Vec<f64>> {
        let (place, heading) = self.pose(random);
        let beam = random.random_range(0..self.beams);
        let direction = DVec2::from_angle(heading + TAU * f64::from(beam) / f64::from(self.beams));
        let hit = self.map.cast_ray(place, direction, self.values.last)?;
        Some(vec![hit.range, hit.incidence])
    }

    /// The share of beams that meet a wall, of some that are the same each time.
    pub fn hit_share(&self) -> f64 {
        let draw = Draw::new(0, Stage::Laser, 0);
        let hits = (0..PROBES).filter(|i| self.beam(&mut draw.item(*i)).is_some()).count();
        hits as f64 / f64::from(PROBES)
    }

    fn deviation(&self, range: f64, incidence: f64) -> f64 {
        let slant = self.sigma_per_tan * incidence.tan().min(STEEPEST_TANGENT);
        (self.sigma.powi(2) + (self.sigma_per_m2 * range * range).powi(2) + slant.powi(2)).sqrt()
    }
}

impl Sensor for PlanarLaser {
    fn state(&self, random: &mut dyn Rng) -> Vec<f64> {
        // A wall beyond the maximum range is no state of a range sensor; in a room most beams have one nearer.
        loop {
            if let Some(state) = self.beam(random) {
                return state;
            }
        }
    }

    fn observe(&self, state: &[f64], random: &mut dyn Rng) -> f64 {
        let normal: f64 = StandardNormal.sample(random);
        self.values.nearest(state[0] + self.deviation(state[0], state[1]) * normal)
    }
}
