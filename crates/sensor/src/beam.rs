//! One beam at a time: the common part of the models' batch methods.

use locsim_core::{Beams, Draw};
use rand::Rng;

/// One beam of a batch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Beam {
    /// Index of its pose.
    pub pose: usize,
    /// Index of its bearing.
    pub bearing: usize,
    /// Nominal range r \[m\], cut at the maximum range.
    pub range: f32,
    /// Nominal range as cast \[m\], which may lie beyond the maximum range.
    pub nominal: f32,
    /// Incidence angle alpha \[rad\].
    pub incidence: f32,
    /// Maximum range \[m\].
    pub max_range: f32,
}

impl Beam {
    /// The map has nothing along this beam that the sensor could see.
    pub fn is_open(&self) -> bool {
        self.range >= self.max_range
    }
}

/// The beam of a batch with this pose and bearing.
#[inline]
pub(crate) fn beam_at(beams: &Beams<'_>, pose: usize, bearing: usize) -> Beam {
    let i = pose * beams.per_pose() + bearing;
    let (nominal, incidence) = (beams.range[i], beams.incidence[i]);
    let max_range = beams.max_range;
    Beam { pose, bearing, range: nominal.min(max_range), nominal, incidence, max_range }
}

/// Calls `f(index of beam, beam)` for every beam, pose-major.
fn each_beam(beams: &Beams<'_>, mut f: impl FnMut(usize, Beam)) {
    let k = beams.per_pose();
    for pose in 0..beams.poses() {
        for bearing in 0..k {
            f(pose * k + bearing, beam_at(beams, pose, bearing));
        }
    }
}

/// The log density of one beam. NaN gives 0, a negative reading minus infinity and a reading beyond the maximum range
/// counts as the maximum range, so `f` sees only readings from 0 to the maximum.
#[inline]
pub(crate) fn log_density(z: f32, beam: &Beam, f: impl FnOnce(f32, &Beam) -> f32) -> f32 {
    if z.is_nan() {
        0.0
    } else if z < 0.0 {
        f32::NEG_INFINITY
    } else {
        f(z.min(beam.max_range), beam)
    }
}

/// `log_density` of a batch from that of one beam, as [`log_density`].
#[inline]
pub(crate) fn log_densities(
    z: &[f32],
    beams: &Beams<'_>,
    out: &mut [f32],
    mut f: impl FnMut(f32, Beam) -> f32,
) {
    each_beam(beams, |i, beam| out[i] = log_density(z[beam.bearing], &beam, |z, beam| f(z, *beam)));
}

/// `cdf` of a batch from that of one beam: 0 below 0, 1 from the maximum range on, NaN for NaN; `f` sees only
/// readings from 0 to below the maximum.
pub(crate) fn cdfs(z: &[f32], beams: &Beams<'_>, out: &mut [f32], mut f: impl FnMut(f32, Beam) -> f32) {
    each_beam(beams, |i, beam| {
        let z = z[beam.bearing];
        out[i] = if z.is_nan() {
            f32::NAN
        } else if z < 0.0 {
            0.0
        } else if z >= beam.max_range {
            1.0
        } else {
            f(z, beam).clamp(0.0, 1.0)
        };
    });
}

/// `sample` of a batch from that of one beam, each with the generator of its index.
pub(crate) fn samples(
    beams: &Beams<'_>,
    draw: &Draw,
    out: &mut [f32],
    mut f: impl FnMut(Beam, &mut dyn Rng) -> f32,
) {
    each_beam(beams, |i, beam| out[i] = f(beam, &mut draw.item(i as u32)).clamp(0.0, beam.max_range));
}
