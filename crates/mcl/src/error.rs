use thiserror::Error;

/// Why a filter could not be made or could not take a step.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FilterError {
    /// An option is out of its range.
    #[error("{option} must be {allowed}, got {value}")]
    Option {
        /// The option's name.
        option: &'static str,
        /// The refused value.
        value: f64,
        /// The allowed values.
        allowed: &'static str,
    },
    /// No free point of the map was found for a random particle.
    #[error("no free space found in the map in {attempts} random points of its bounds")]
    NoFreeSpace {
        /// Number of points tried.
        attempts: u32,
    },
    /// The scan does not belong to the laser.
    #[error("step {step}: a scan of {ranges} ranges from a laser of {beams} beams")]
    ScanLength {
        /// The filter's step, from 0.
        step: u32,
        /// Ranges in the scan.
        ranges: usize,
        /// Beams of the laser.
        beams: usize,
    },
    /// The odometry increment is not finite.
    #[error("step {step}: the odometry increment is not finite")]
    Odometry {
        /// The filter's step, from 0.
        step: u32,
    },
    /// A sensor model returned a log likelihood that is NaN or plus infinity: a defect of that model.
    #[error(
        "step {step}: sensor model `{model}` gives particle {particle} a log likelihood that is no number"
    )]
    SensorModel {
        /// The model's name.
        model: String,
        /// The filter's step, from 0.
        step: u32,
        /// The first such particle.
        particle: usize,
    },
}

/// `Ok` if `holds`, else the error that names the option, its value and the allowed values.
pub(crate) fn check(
    option: &'static str,
    value: f64,
    holds: bool,
    allowed: &'static str,
) -> Result<(), FilterError> {
    if holds { Ok(()) } else { Err(FilterError::Option { option, value, allowed }) }
}

/// Each of the motion model's noise parameters is finite and not negative.
pub(crate) fn check_alpha(alpha: &[f64]) -> Result<(), FilterError> {
    alpha
        .iter()
        .try_for_each(|&a| check("motion alpha", a, a.is_finite() && a >= 0.0, "finite and at least 0"))
}

/// A standard deviation is finite and not negative.
pub(crate) fn check_sigma(option: &'static str, sigma: f64) -> Result<(), FilterError> {
    check(option, sigma, sigma.is_finite() && sigma >= 0.0, "finite and at least 0")
}

/// A size is finite and positive.
pub(crate) fn check_positive(option: &'static str, size: f64) -> Result<(), FilterError> {
    check(option, size, size.is_finite() && size > 0.0, "finite and above 0")
}
