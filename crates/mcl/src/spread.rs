use locsim_core::{Draw, Particles, wrap_angle};
use serde::Serialize;

use crate::FilterError;
use crate::error::check_sigma;
use crate::motion::for_each_with_normals;

/// Independent Gaussian spread of a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Standard deviation of x and of y (m).
    pub sigma_m: f64,
    /// Standard deviation of the heading (rad).
    pub sigma_rad: f64,
}

impl Spread {
    /// Both are finite and not negative; `names` are those of the options, for the error.
    pub(crate) fn check(self, names: [&'static str; 2]) -> Result<(), FilterError> {
        check_sigma(names[0], self.sigma_m)?;
        check_sigma(names[1], self.sigma_rad)
    }

    /// Adds noise to each pose; particle `i` draws from item `i`.
    pub(crate) fn add_to(self, particles: &mut Particles, draw: &Draw) {
        let Self { sigma_m, sigma_rad } = self;
        for_each_with_normals(particles, draw, |[n1, n2, n3], x, y, theta| {
            *x += sigma_m * n1;
            *y += sigma_m * n2;
            *theta = wrap_angle(*theta + sigma_rad * n3);
        });
    }
}
