//! The wave that a curve is: least squares, weighted by how sure each level is.

use std::f64::consts::TAU;

use serde::Serialize;

/// A wave has to explain this share of a curve's variance, and to come and go more often than this over what was seen: a trend
/// is no wave.
const WAVE_SHARE: f64 = 0.7;
const FEWEST_WAVES: f64 = 1.5;
/// Levels in a wave, at the least.
const LEVELS_PER_WAVE: f64 = 3.0;

/// A wave over a covariate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Wave {
    /// Its period, in the covariate's unit.
    pub period: f64,
    /// How often it comes around in a full circle, or over what was seen.
    pub count: f64,
    /// Its amplitude, in the curve's unit.
    pub amplitude: f64,
}

/// Fits a wave to the points of a curve: covariate, value and weight (one over the variance), in the covariate's order. Over a circle
/// \[rad\] a wave comes around a whole number of times. `None` where a wave doesn't explain the curve.
pub fn fit(points: &[[f64; 3]], is_circle: bool) -> Option<Wave> {
    let span = points.last()?[0] - points.first()?[0];
    if span <= 0.0 {
        return None;
    }
    let most = points.len() as f64 / LEVELS_PER_WAVE;
    let counts: Vec<f64> = if is_circle {
        let circles = (span / TAU).max(1e-9);
        (1..=(most / circles) as u32).map(f64::from).collect()
    } else {
        (0..=(10.0 * (most - FEWEST_WAVES)) as u32).map(|i| FEWEST_WAVES + 0.1 * f64::from(i)).collect()
    };
    let weight: f64 = points.iter().map(|[_, _, w]| w).sum();
    let mean = points.iter().map(|[_, y, w]| y * w).sum::<f64>() / weight;
    let variation: f64 = points.iter().map(|[_, y, w]| w * (y - mean).powi(2)).sum();
    let fitted = counts.into_iter().map(|count| {
        let period = if is_circle { TAU / count } else { span / count };
        // Normal equations of mean, cosine and sine; the mean is nearly apart from the others.
        let [mut cc, mut cs, mut ss, mut cy, mut sy] = [0.0; 5];
        for [x, y, w] in points {
            let (sin, cos) = (TAU * x / period).sin_cos();
            cc += w * cos * cos;
            cs += w * cos * sin;
            ss += w * sin * sin;
            cy += w * cos * (y - mean);
            sy += w * sin * (y - mean);
        }
        let determinant = (cc * ss - cs * cs).max(1e-300);
        let (a, b) = ((cy * ss - sy * cs) / determinant, (sy * cc - cy * cs) / determinant);
        let share = (a * cy + b * sy) / variation.max(1e-300);
        (share, Wave { period, count, amplitude: a.hypot(b) })
    });
    let (share, wave) = fitted.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (share >= WAVE_SHARE).then_some(wave)
}
