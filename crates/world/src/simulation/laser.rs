use std::f64::consts::{PI, TAU};

use locsim_core::{Laser, Pose2};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::SimulationError;
use super::error::{check, check_count};

/// The most beams of a scan.
const MAX_BEAMS: f64 = 1e6;

/// A simulated planar laser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaserOptions {
    /// Scans per second [Hz], above 0.
    pub rate_hz: f64,
    /// Beams per scan, at least 1.
    pub beams: u32,
    /// Field of view [rad], above 0, at most 2 pi. At 2 pi beams are spread evenly, the last at bearing pi; below it
    /// both ends carry a beam. A single beam looks ahead.
    pub field_of_view_rad: f64,
    /// Minimum range [m], at least 0.
    pub min_range_m: f64,
    /// Maximum range [m], above the minimum.
    pub max_range_m: f64,
    /// Readings are multiples of this [m]; 0 for readings that aren't quantized.
    pub resolution_m: f64,
    /// Standard deviation of a reading at range 0 [m], at least 0.
    pub sigma_m: f64,
    /// Its growth per metre of range, at least 0: sigma(r) = `sigma_m` + `sigma_per_m` * r.
    pub sigma_per_m: f64,
    /// Where the laser sits, `base_from_laser`.
    pub mount: Pose2,
    /// Time that a sweep over the field of view takes [s]: at least 0, at most the time between two scans. A beam's
    /// time after the scan's stamp is its share of the field of view swept before it.
    pub scan_secs: f64,
}

/// A laser that turns true distances into readings.
#[derive(Clone, Debug, PartialEq)]
pub struct LaserSimulator {
    options: LaserOptions,
    laser: Laser,
}

impl LaserSimulator {
    /// Checks the options and lays out the beams.
    ///
    /// # Errors
    /// [`SimulationError`] for an option out of its range.
    pub fn new(options: LaserOptions) -> Result<Self, SimulationError> {
        let at_least_0 = |value: f64| value >= 0.0;
        check("laser rate [Hz]", options.rate_hz, "above 0", |rate| rate > 0.0)?;
        check("field of view [rad]", options.field_of_view_rad, "above 0, at most 2 pi", |fov| {
            fov > 0.0 && fov <= TAU + 1e-9
        })?;
        check("laser resolution [m]", options.resolution_m, "at least 0", at_least_0)?;
        check("laser noise sigma [m]", options.sigma_m, "at least 0", at_least_0)?;
        check("laser noise sigma per metre", options.sigma_per_m, "at least 0", at_least_0)?;
        check(
            "scan time [s]",
            options.scan_secs,
            "at least 0, at most the time between two scans",
            |secs| secs >= 0.0 && secs * options.rate_hz <= 1.0 + 1e-9,
        )?;
        if !options.mount.is_finite() {
            let value = options.mount.x + options.mount.y + options.mount.theta;
            return Err(SimulationError::Parameter { name: "laser mount", value, allowed: "finite" });
        }
        check_count("beams", f64::from(options.beams), MAX_BEAMS)?;

        let beams = options.beams as usize;
        let (min, max) = (options.min_range_m as f32, options.max_range_m as f32);
        let shares = || shares_swept(beams, options.field_of_view_rad);
        let first = first_bearing(beams, options.field_of_view_rad);
        let bearings = shares().map(|share| (first + share * options.field_of_view_rad) as f32).collect();
        let times = shares().map(|share| (share * options.scan_secs) as f32).collect();
        let laser = Laser::new(bearings, times, min, max, options.mount)?;
        Ok(Self { options, laser })
    }

    /// The laser as a filter knows it.
    pub fn laser(&self) -> &Laser {
        &self.laser
    }

    /// What it was made from.
    pub fn options(&self) -> &LaserOptions {
        &self.options
    }

    /// The reading [m] of a beam whose way is free for `range` metres, or free beyond the maximum range (`None`).
    ///
    /// Gaussian noise of standard deviation sigma(range), then quantization. A reading at or beyond the maximum
    /// range, and no return, is exactly the maximum range; one below the minimum is NaN, not usable.
    pub fn reading(&self, range: Option<f64>, rng: &mut impl Rng) -> f32 {
        let Some(range) = range else { return self.laser.max_range() };
        let normal: f64 = StandardNormal.sample(rng);
        let noisy = range + (self.options.sigma_m + self.options.sigma_per_m * range) * normal;
        let step = self.options.resolution_m;
        let reading = (if step > 0.0 { (noisy / step).round() * step } else { noisy }) as f32;
        if reading < self.laser.min_range() { f32::NAN } else { reading.min(self.laser.max_range()) }
    }
}

fn is_full_circle(field_of_view: f64) -> bool {
    field_of_view >= TAU - 1e-9
}

/// Share of the field of view between its first beam and each beam.
fn shares_swept(beams: usize, field_of_view: f64) -> impl Iterator<Item = f64> {
    let gaps = if is_full_circle(field_of_view) { beams } else { beams.saturating_sub(1).max(1) };
    (0..beams).map(move |beam| beam as f64 / gaps as f64)
}

/// Bearing of the first beam [rad].
fn first_bearing(beams: usize, field_of_view: f64) -> f64 {
    if beams <= 1 {
        0.0
    } else if is_full_circle(field_of_view) {
        TAU / beams as f64 - PI
    } else {
        -0.5 * field_of_view
    }
}
