use std::f64::consts::{PI, TAU};

use glam::DVec2;
use locsim_core::Laser;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::error::{FROM_0, MOST, check, check_count};
use super::{BeamCaster, SimulationError};
use crate::effect::as_read;
use crate::options::{LaserOptions, is_full_circle};

/// The most beams of a scan.
const MAX_BEAMS: f64 = 1e6;

/// The longest maximum range \[m\].
const MOST_RANGE_M: f64 = 1e6;

/// A laser that turns true distances into readings.
#[derive(Clone, Debug, PartialEq)]
pub struct LaserSimulator {
    options: LaserOptions,
    laser: Laser,
    /// Unit direction of each beam in the robot's frame.
    directions: Vec<DVec2>,
    /// Bearing of beam 0 \[rad\].
    first_bearing: f64,
    beams_per_rad: f64,
}

impl LaserSimulator {
    /// Checks the options and lays out the beams.
    ///
    /// # Errors
    /// [`SimulationError`] for an option out of its range.
    pub fn new(options: LaserOptions) -> Result<Self, SimulationError> {
        let (from_0, is_from_0) = FROM_0;
        check("laser rate [Hz]", options.rate_hz, "above 0", |rate| rate > 0.0)?;
        check("field of view [rad]", options.field_of_view_rad, "above 0, at most 2 pi", |fov| {
            fov > 0.0 && fov <= TAU + 1e-9
        })?;
        if let Some(first) = options.first_bearing_rad {
            check("bearing of the first beam [rad]", first, "-pi to pi", |first| first.abs() <= PI + 1e-9)?;
        }
        check("laser resolution [m]", options.resolution_m, from_0, is_from_0)?;
        check("laser noise sigma [m]", options.sigma_m, from_0, is_from_0)?;
        check("laser noise sigma per metre", options.sigma_per_m, from_0, is_from_0)?;
        check(
            "scan time [s]",
            options.scan_secs,
            "at least 0, at most the time between two scans",
            |secs| secs >= 0.0 && secs * options.rate_hz <= 1.0 + 1e-9,
        )?;
        for value in [options.mount.x, options.mount.y].into_iter().filter(|value| value.is_finite()) {
            check("laser mount [m]", value, "at most 10000 either way", |value| value.abs() <= MOST)?;
        }
        if !options.mount.is_finite() {
            let value = options.mount.x + options.mount.y + options.mount.theta;
            return Err(SimulationError::Parameter { name: "laser mount", value, allowed: "finite" });
        }
        check_count("beams", f64::from(options.beams), MAX_BEAMS)?;

        let beams = options.beams as usize;
        let (min, max) = (options.min_range_m as f32, options.max_range_m as f32);
        let gaps = gaps(beams, options.field_of_view_rad);
        let shares = || (0..beams).map(|beam| beam as f64 / gaps as f64);
        let first_bearing =
            options.first_bearing_rad.unwrap_or_else(|| first_bearing(beams, options.field_of_view_rad));
        let bearings: Vec<f32> =
            shares().map(|share| (first_bearing + share * options.field_of_view_rad) as f32).collect();
        let times = shares().map(|share| (share * options.scan_secs) as f32).collect();
        let laser = Laser::new(bearings, times, min, max, options.mount)?;
        let directions = BeamCaster::directions(&laser, &options.mount);
        check("laser maximum range [m]", options.max_range_m, "at most 1000000", |range| {
            range <= MOST_RANGE_M
        })?;
        let beams_per_rad = gaps as f64 / options.field_of_view_rad;
        Ok(Self { options, laser, directions, first_bearing, beams_per_rad })
    }

    /// The same with beams that are taken at these times \[s, from the scan's stamp\]: some lasers turn clockwise, and some begin a sweep
    /// elsewhere than at their first bearing.
    ///
    /// # Errors
    /// [`SimulationError`] for another number of times than of beams.
    pub fn with_beam_times(self, secs: &[f32]) -> Result<Self, SimulationError> {
        Ok(Self { laser: self.laser.with_beam_times(secs)?, ..self })
    }

    /// The laser as a filter knows it.
    pub fn laser(&self) -> &Laser {
        &self.laser
    }

    /// The options that it was made from.
    pub fn options(&self) -> &LaserOptions {
        &self.options
    }

    /// Unit direction of each beam in the robot's frame.
    pub(super) fn directions(&self) -> &[DVec2] {
        &self.directions
    }

    /// The beams at most `half_width` \[rad\] away from `bearing` in (-pi, pi]. Beyond a half-width of pi some come
    /// twice.
    pub(super) fn beams_within(&self, bearing: f64, half_width: f64) -> impl Iterator<Item = usize> {
        /// More than bearings are off by, as f32 \[rad\].
        const MARGIN: f64 = 1e-6;
        let beams = self.directions.len();
        let middle = (bearing - self.first_bearing) * self.beams_per_rad;
        let half = (half_width + MARGIN) * self.beams_per_rad;
        let turn = TAU * self.beams_per_rad;
        // Conversion rounds down, and takes what is below 0 to 0.
        [middle - turn, middle, middle + turn].into_iter().flat_map(move |middle| {
            let first = (middle - half + 1.0) as usize;
            let end = ((middle + half + 1.0) as usize).min(beams);
            first..end
        })
    }

    /// The reading \[m\] of a beam whose way is free for `range` metres, or free beyond the maximum range
    /// (`None`).
    ///
    /// Gaussian noise of standard deviation sigma(range), then quantization. A reading at or beyond the
    /// maximum range, and no return, is exactly the maximum range; one below the minimum is NaN, not usable.
    pub fn reading(&self, range: Option<f64>, rng: &mut impl Rng) -> f32 {
        let Some(range) = range else { return self.laser.max_range() };
        let normal: f64 = StandardNormal.sample(rng);
        let noisy = range + (self.options.sigma_m + self.options.sigma_per_m * range) * normal;
        as_read(noisy, self.options.resolution_m, self.laser.min_range(), self.laser.max_range())
    }
}

/// How many times the angle between two beams goes into the field of view.
fn gaps(beams: usize, field_of_view: f64) -> usize {
    if is_full_circle(field_of_view) { beams } else { beams.saturating_sub(1).max(1) }
}

/// Bearing of the first beam \[rad\] where none is given.
fn first_bearing(beams: usize, field_of_view: f64) -> f64 {
    if beams <= 1 {
        0.0
    } else if is_full_circle(field_of_view) {
        TAU / beams as f64 - PI
    } else {
        -0.5 * field_of_view
    }
}

#[cfg(test)]
mod tests {
    use locsim_core::{Draw, Pose2, Stage, wrap_angle};
    use proptest::prelude::*;

    use super::super::fixtures::{is_normal_sample, laser_options};
    use super::*;

    fn readings(options: LaserOptions, range: Option<f64>, count: u32) -> Vec<f32> {
        let laser = LaserSimulator::new(options).unwrap();
        let draw = Draw::new(3, Stage::Laser, 0);
        (0..count).map(|i| laser.reading(range, &mut draw.item(i))).collect()
    }

    fn bearings(beams: u32, field_of_view_rad: f64) -> Vec<f32> {
        let options = LaserOptions { beams, field_of_view_rad, ..laser_options() };
        LaserSimulator::new(options).unwrap().laser().bearings().to_vec()
    }

    #[test]
    fn the_first_beam_may_be_given() {
        let options = LaserOptions {
            beams: 4,
            field_of_view_rad: TAU,
            first_bearing_rad: Some(-PI),
            ..laser_options()
        };
        let laser = LaserSimulator::new(options).unwrap();
        let expected = [-PI, -0.5 * PI, 0.0, 0.5 * PI].map(|bearing| bearing as f32);
        assert_eq!(laser.laser().bearings(), expected);
        // The beam behind is found from either side.
        for bearing in [PI, -PI + 1e-3] {
            assert!(laser.beams_within(bearing, 0.1).any(|beam| beam == 0));
        }
        let beyond = LaserOptions { first_bearing_rad: Some(3.2), ..options };
        assert!(LaserSimulator::new(beyond).is_err());
    }

    #[test]
    fn a_full_circle_has_no_double_end_and_a_narrower_field_of_view_has_both() {
        let pi = PI as f32;
        assert_eq!(bearings(4, TAU), [-0.5 * pi, 0.0, 0.5 * pi, pi]);
        assert_eq!(bearings(3, PI), [-0.5 * pi, 0.0, 0.5 * pi]);
        assert_eq!(bearings(1, PI), [0.0]);
        assert_eq!(bearings(1, TAU), [0.0]);
    }

    #[test]
    fn beams_are_stamped_along_the_sweep() {
        let times = |beams, field_of_view_rad| {
            let options = LaserOptions { beams, field_of_view_rad, scan_secs: 0.2, ..laser_options() };
            LaserSimulator::new(options).unwrap().laser().beam_times_secs().to_vec()
        };
        assert_eq!(times(4, TAU), [0.0, 0.05, 0.1, 0.15]);
        assert_eq!(times(3, PI), [0.0, 0.1, 0.2]);
        assert_eq!(times(1, PI), [0.0]);
    }

    proptest! {
        /// Of fields of view of all widths, and of intervals that reach over their ends.
        #[test]
        fn beams_within_an_interval_are_those_and_no_others(
            beams in 1..400u32, field_of_view_rad in 0.1..TAU + 0.1, bearing in -PI..PI, half_width in 0.0..PI,
        ) {
            let field_of_view_rad = field_of_view_rad.min(TAU);
            let options = LaserOptions { beams, field_of_view_rad, ..laser_options() };
            let laser = LaserSimulator::new(options).unwrap();
            let mut found: Vec<usize> = laser.beams_within(bearing, half_width).collect();
            found.sort_unstable();
            found.dedup();
            for (beam, &b) in laser.laser().bearings().iter().enumerate() {
                let away = wrap_angle(f64::from(b) - bearing).abs();
                if found.contains(&beam) {
                    prop_assert!(away < half_width + 2e-6, "beam {} is {} away", beam, away);
                } else {
                    prop_assert!(away > half_width, "beam {} is missing", beam);
                }
            }
        }
    }

    /// Mean and variance of 100,000 readings; a noise 3 % off must show.
    #[test]
    fn noise_grows_with_range() {
        let options = LaserOptions { sigma_m: 0.01, sigma_per_m: 0.004, ..laser_options() };
        for range in [0.5, 5.0] {
            let sample: Vec<f64> =
                readings(options, Some(range), 100_000).into_iter().map(f64::from).collect();
            let sigma = 0.01 + 0.004 * range;
            assert!(is_normal_sample(&sample, range, sigma * sigma));
            assert!(!is_normal_sample(&sample, range, (1.03 * sigma).powi(2)));
            assert!(!is_normal_sample(&sample, range + 0.03 * sigma, sigma * sigma));
        }
    }

    proptest! {
        #[test]
        fn readings_are_on_the_grid_or_a_value_of_their_own(range in 0.0..9.0f64, millimetres in 1..50u32) {
            let resolution_m = f64::from(millimetres) * 1e-3;
            let options = LaserOptions { resolution_m, sigma_m: 0.05, min_range_m: 0.2, ..laser_options() };
            for reading in readings(options, Some(range), 50) {
                let steps = f64::from(reading) / resolution_m;
                let on_grid = (steps - steps.round()).abs() < 1e-6 * steps && (0.2..8.0).contains(&reading);
                prop_assert!(on_grid || reading == 8.0 || reading.is_nan(), "{}", reading);
            }
        }
    }

    #[test]
    fn without_noise_a_reading_is_the_nearest_step() {
        let options = LaserOptions { resolution_m: 0.01, ..laser_options() };
        assert_eq!(readings(options, Some(1.2349), 1), [1.23]);
        assert_eq!(readings(options, Some(1.2351), 1), [1.24]);
        assert_eq!(readings(laser_options(), Some(1.2345), 1), [1.2345]);
    }

    #[test]
    fn no_return_and_readings_beyond_the_maximum_are_exactly_the_maximum() {
        let options = LaserOptions { sigma_m: 0.02, resolution_m: 0.003, ..laser_options() };
        assert!(readings(options, None, 1000).iter().all(|&reading| reading == 8.0));
        // Just below the maximum about half of the readings reach it; 1000 coins: 0.5 +- 4.9 * 0.0158.
        let beyond = readings(options, Some(7.9985), 1000).iter().filter(|&&reading| reading == 8.0).count();
        assert!((423..=577).contains(&beyond), "{beyond}");
    }

    #[test]
    fn readings_below_the_minimum_are_not_usable() {
        let options = LaserOptions { min_range_m: 0.25, ..laser_options() };
        assert!(readings(options, Some(0.2499), 1)[0].is_nan());
        assert_eq!(readings(options, Some(0.25), 1), [0.25]);
        let noisy = LaserOptions { sigma_m: 0.01, ..laser_options() };
        let unusable = readings(noisy, Some(0.0), 1000).iter().filter(|reading| reading.is_nan()).count();
        assert!((423..=577).contains(&unusable), "negative readings: {unusable}");
    }

    #[test]
    fn options_out_of_range_are_refused() {
        let good = laser_options();
        for (options, message) in [
            (LaserOptions { rate_hz: 0.0, ..good }, "laser rate [Hz] must be above 0; got 0"),
            (LaserOptions { beams: 0, ..good }, "at least one beam"),
            (LaserOptions { beams: 2_000_000, ..good }, "2000000 beams are more than the 1000000"),
            (
                LaserOptions { field_of_view_rad: 6.3, ..good },
                "field of view [rad] must be above 0, at most 2 pi",
            ),
            (LaserOptions { min_range_m: 8.0, ..good }, "0 <= min < max"),
            (LaserOptions { max_range_m: f64::NAN, ..good }, "0 <= min < max"),
            (LaserOptions { resolution_m: -0.1, ..good }, "laser resolution [m] must be at least 0"),
            (
                LaserOptions { sigma_m: f64::NAN, ..good },
                "laser noise sigma [m] must be at least 0, at most 10000; got NaN",
            ),
            (LaserOptions { sigma_per_m: -1.0, ..good }, "laser noise sigma per metre"),
            (LaserOptions { scan_secs: 0.21, ..good }, "at most the time between two scans; got 0.21"),
            (
                LaserOptions { mount: Pose2 { x: f64::NAN, ..Pose2::IDENTITY }, ..good },
                "laser mount must be finite",
            ),
            (
                LaserOptions { mount: Pose2::new(0.0, -1e300, 0.0), ..good },
                "laser mount [m] must be at most 10000 either way",
            ),
            (LaserOptions { max_range_m: 1e30, ..good }, "laser maximum range [m] must be at most 1000000"),
            (
                LaserOptions { sigma_m: 1e300, ..good },
                "laser noise sigma [m] must be at least 0, at most 10000",
            ),
            (
                LaserOptions { resolution_m: 1e300, ..good },
                "laser resolution [m] must be at least 0, at most 10000",
            ),
        ] {
            let error = LaserSimulator::new(options).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
