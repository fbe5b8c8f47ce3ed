//! A rectangular room with analytic ray casts, and a Gaussian sensor model: the least that a filter needs.

use locsim_core::{Beams, Draw, Hits, Poses, RangeMap, SensorModel};
use rand_distr::{Distribution, StandardNormal};
use statrs::distribution::{ContinuousCDF, Normal};

/// The room [0, width] x [0, depth] [m]; walls 0 to 3 are west, east, south and north.
pub struct Room {
    pub width: f64,
    pub depth: f64,
}

impl RangeMap for Room {
    fn cast(&self, laser: Poses<'_>, bearings: &[f32], max_range: f32, out: &mut Hits) {
        out.resize(laser.len() * bearings.len());
        for i in 0..laser.len() {
            let pose = laser.get(i);
            for (j, bearing) in bearings.iter().enumerate() {
                let (sin, cos) = (pose.theta + f64::from(*bearing)).sin_cos();
                // Distance to the wall ahead along each axis; infinite along a wall.
                let along_x = (if cos < 0.0 { pose.x } else { self.width - pose.x }) / cos.abs();
                let along_y = (if sin < 0.0 { pose.y } else { self.depth - pose.y }) / sin.abs();
                let (range, across, surface) = if along_x < along_y {
                    (along_x, cos.abs(), u32::from(cos >= 0.0))
                } else {
                    (along_y, sin.abs(), 2 + u32::from(sin >= 0.0))
                };
                let entry = i * bearings.len() + j;
                out.range[entry] = (range as f32).clamp(0.0, max_range);
                out.incidence[entry] = across.acos() as f32;
                out.surface[entry] = surface;
            }
        }
    }

    fn is_free(&self, x: f64, y: f64) -> bool {
        (0.0..=self.width).contains(&x) && (0.0..=self.depth).contains(&y)
    }

    fn bounds(&self) -> [f64; 4] {
        [0.0, 0.0, self.width, self.depth]
    }
}

/// p(z | r) is normal around the nominal range; it does not treat the maximum range as special.
pub struct Gaussian {
    pub sigma_m: f32,
}

impl SensorModel for Gaussian {
    fn name(&self) -> &'static str {
        "gaussian"
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        let log_norm = -(self.sigma_m * std::f32::consts::TAU.sqrt()).ln();
        for (out, range) in out.chunks_mut(z.len()).zip(beams.range.chunks(z.len())) {
            for ((out, range), z) in out.iter_mut().zip(range).zip(z) {
                let u = (z - range) / self.sigma_m;
                *out = if z.is_nan() { 0.0 } else { log_norm - 0.5 * u * u };
            }
        }
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        for (i, out) in out.iter_mut().enumerate() {
            let u = (z[i % z.len()] - beams.range[i]) / self.sigma_m;
            *out = Normal::standard().cdf(f64::from(u)) as f32;
        }
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        for (i, out) in out.iter_mut().enumerate() {
            let normal: f32 = StandardNormal.sample(&mut draw.item(i as u32));
            *out = beams.range[i] + self.sigma_m * normal;
        }
    }
}
