//! A floor on the density and a tempering exponent, and how both are chosen.

use std::sync::Arc;

use locsim_core::{Beams, DependsOn, Draw, Hits, Particles, SensorModel};
use rand::RngExt;
use rayon::prelude::*;

use crate::SensorError;

/// Any model made fit for a filter: `exponent * ln((1 - floor) p + floor q)`.
///
/// q is the same wide distribution for every model: half its mass uniform on \[0, maximum), half at the
/// maximum range. The floor bounds the influence of one reading that the model holds impossible. The exponent makes
/// up for beams that are not independent (Probabilistic Robotics, section 6.3.4).
///
/// `cdf` and `sample` are those of the mixture (1 - floor) p + floor q: with an exponent other than 1 the log
/// density is a score, not the log of a normalized density.
#[derive(Clone)]
pub struct Tempered {
    inner: Arc<dyn SensorModel>,
    floor: f32,
    exponent: f32,
}

/// Density of q: per metre below the maximum range, a probability at it.
fn wide_density(z: f32, max_range: f32) -> f32 {
    if z >= max_range { 0.5 } else { 0.5 / max_range }
}

impl Tempered {
    /// Wraps `inner`.
    ///
    /// # Errors
    /// [`SensorError::Parameter`] unless 0 <= `floor` <= 1 and `exponent` is positive and finite.
    pub fn new(inner: Arc<dyn SensorModel>, floor: f64, exponent: f64) -> Result<Self, SensorError> {
        check(floor, exponent)?;
        Ok(Self { inner, floor: floor as f32, exponent: exponent as f32 })
    }
}

fn check(floor: f64, exponent: f64) -> Result<(), SensorError> {
    if !(0.0..=1.0).contains(&floor) {
        return Err(SensorError::Parameter { what: "the floor", allowed: "from 0 to 1", value: floor });
    }
    if !(exponent > 0.0 && exponent.is_finite()) {
        let (what, allowed) = ("the exponent", "positive and finite");
        return Err(SensorError::Parameter { what, allowed, value: exponent });
    }
    Ok(())
}

impl SensorModel for Tempered {
    /// The inner model's name.
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn depends_on(&self) -> DependsOn {
        self.inner.depends_on()
    }

    fn log_density(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        self.inner.log_density(z, beams, out);
        for out in out.chunks_mut(beams.per_pose()) {
            for (l, &z) in out.iter_mut().zip(z) {
                if !z.is_nan() {
                    let p = (1.0 - self.floor) * l.exp() + self.floor * wide_density(z, beams.max_range);
                    *l = self.exponent * p.ln();
                }
            }
        }
    }

    fn cdf(&self, z: &[f32], beams: &Beams<'_>, out: &mut [f32]) {
        self.inner.cdf(z, beams, out);
        for out in out.chunks_mut(beams.per_pose()) {
            for (p, &z) in out.iter_mut().zip(z) {
                let wide = if z >= beams.max_range { 1.0 } else { 0.5 * z.max(0.0) / beams.max_range };
                *p = (1.0 - self.floor) * *p + self.floor * wide;
            }
        }
    }

    fn sample(&self, beams: &Beams<'_>, draw: &Draw, out: &mut [f32]) {
        self.inner.sample(beams, draw, out);
        for (i, z) in out.iter_mut().enumerate() {
            let mut rng = draw.item(i as u32 | WIDE_ITEMS);
            if rng.random::<f32>() < self.floor {
                let u = rng.random::<f32>();
                *z = if u < 0.5 { 2.0 * u * beams.max_range } else { beams.max_range };
            }
        }
    }
}

/// Set in the item number of the draws that decide between the inner model and q: the inner model has the
/// others.
const WIDE_ITEMS: u32 = 1 << 31;

/// A held-out scan with candidates for the pose it was taken from.
#[derive(Clone, Debug)]
pub struct CalibrationScan {
    /// Readings \[k\] \[m\], not used in the model's fit.
    pub z: Vec<f32>,
    /// Laser poses \[K + 1\]: the true one first, then K perturbed ones.
    pub laser: Particles,
    /// Bearings \[k\] \[rad\].
    pub bearings: Vec<f32>,
    /// Ray casts from each laser pose at each bearing \[(K + 1) * k\].
    pub hits: Hits,
    /// Maximum range \[m\].
    pub max_range: f32,
}

/// Values that [`choose_tempering`] tries, each floor with each exponent.
#[derive(Clone, Debug, PartialEq)]
pub struct TemperingGrid {
    /// Floors, from 0 to 1.
    pub floors: Vec<f64>,
    /// Exponents, above 0.
    pub exponents: Vec<f64>,
}

impl Default for TemperingGrid {
    /// Floors from 0.0001 to 0.95 and exponents from 0.05 to 1, about evenly in their logarithms.
    fn default() -> Self {
        Self {
            floors: vec![1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 0.95],
            exponents: vec![0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4, 0.57, 0.8, 1.0],
        }
    }
}

/// The result of [`choose_tempering`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tempering {
    /// For [`Tempered::new`].
    pub floor: f64,
    /// For [`Tempered::new`].
    pub exponent: f64,
    /// Mean log posterior probability of the true pose among its candidates \[nats\]; at most 0.
    pub score: f64,
}

/// Chooses floor and exponent by the mean log posterior of the true pose among its candidates on held-out
/// scans, all candidates being equally likely beforehand: the mean of `l_0 - ln sum_k exp(l_k)`, `l_k` the
/// tempered log likelihood of candidate k.
///
/// This is a conditional likelihood, the logarithmic score of the posterior; that score is proper (Gneiting
/// and Raftery, JASA 2007), so it rewards posteriors that are as sharp as they are right and no sharper. One
/// rule for every model. Among equal scores the earlier in the grid wins.
///
/// # Errors
/// [`SensorError::Calibration`] for no scans, an empty grid, lengths that don't match or when no candidate
/// has a finite score (with a floor above 0 there always is one); [`SensorError::Parameter`] for a grid value
/// out of bounds.
pub fn choose_tempering(
    model: &dyn SensorModel,
    calibration: &[CalibrationScan],
    grid: &TemperingGrid,
) -> Result<Tempering, SensorError> {
    if calibration.is_empty() {
        return Err(SensorError::Calibration("there are no held-out scans"));
    }
    if grid.floors.is_empty() || grid.exponents.is_empty() {
        return Err(SensorError::Calibration("there is nothing to try"));
    }
    for (&floor, &exponent) in grid.floors.iter().flat_map(|f| grid.exponents.iter().map(move |e| (f, e))) {
        check(floor, exponent)?;
    }
    for scan in calibration {
        let k = scan.bearings.len();
        if scan.z.len() != k || k == 0 || scan.laser.is_empty() || scan.hits.len() != scan.laser.len() * k {
            return Err(SensorError::Calibration("readings, bearings, poses and ray casts don't match"));
        }
    }
    // one row of scores per scan, floor-major; collected in order, so that the sums don't depend on threads
    let scores: Vec<Vec<f64>> =
        calibration.par_iter().map(|scan| log_posteriors(model, scan, grid)).collect();
    let mut best: Option<Tempering> = None;
    for (i, &floor) in grid.floors.iter().enumerate() {
        for (j, &exponent) in grid.exponents.iter().enumerate() {
            let at = i * grid.exponents.len() + j;
            let score = scores.iter().map(|row| row[at]).sum::<f64>() / scores.len() as f64;
            if score.is_finite() && best.is_none_or(|best| score > best.score) {
                best = Some(Tempering { floor, exponent, score });
            }
        }
    }
    best.ok_or(SensorError::Calibration(
        "with each that is tried some training scan has a likelihood of 0; a `floor` above 0 prevents that",
    ))
}

/// Log posterior of the true pose of one scan for every floor and exponent.
fn log_posteriors(model: &dyn SensorModel, scan: &CalibrationScan, grid: &TemperingGrid) -> Vec<f64> {
    let k = scan.bearings.len();
    let mut density = vec![0.0f32; scan.hits.len()];
    model.log_density(
        &scan.z,
        &scan.hits.beams(scan.laser.as_poses(), &scan.bearings, scan.max_range),
        &mut density,
    );
    for l in &mut density {
        *l = l.exp();
    }
    let mut row = Vec::with_capacity(grid.floors.len() * grid.exponents.len());
    for &floor in &grid.floors {
        let sums: Vec<f64> = density
            .chunks(k)
            .map(|density| {
                let usable = density.iter().zip(&scan.z).filter(|(_, z)| !z.is_nan());
                usable
                    .map(|(&p, &z)| {
                        ((1.0 - floor) * f64::from(p) + floor * f64::from(wide_density(z, scan.max_range)))
                            .ln()
                    })
                    .sum()
            })
            .collect();
        let highest = sums.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        row.extend(grid.exponents.iter().map(|exponent| {
            let total: f64 = sums.iter().map(|l| (exponent * (l - highest)).exp()).sum();
            exponent * (sums[0] - highest) - total.ln()
        }));
    }
    row
}
