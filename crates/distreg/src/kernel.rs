use serde::{Deserialize, Serialize};

/// A kernel K(u) over a distance u in bandwidths, for smoothing over states (eq. 7) and over observations
/// (eq. 5). Several state coordinates are smoothed by K of the bandwidth-scaled Euclidean distance; for the
/// Gaussian this is the product kernel with a diagonal bandwidth matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kernel {
    /// exp(-u^2 / 2).
    Gaussian,
    /// 1 for |u| <= 1, else 0.
    Boxcar,
    /// 1 - u^2 for |u| < 1, else 0.
    Epanechnikov,
}

impl Kernel {
    /// K at the squared distance `u2` (in squared bandwidths), up to a constant factor.
    #[inline]
    pub fn at_squared(self, u2: f64) -> f64 {
        match self {
            Self::Gaussian => (-0.5 * u2).exp(),
            Self::Boxcar => f64::from(u8::from(u2 <= 1.0)),
            Self::Epanechnikov => (1.0 - u2).max(0.0),
        }
    }

    /// Distance in bandwidths beyond which K counts as zero. For the Gaussian it's where the plain value comes
    /// near the smallest f64 (exp(-37^2 / 2) = 5e-298), so eq. 7 holds wherever it can be evaluated at all.
    pub(crate) fn support(self) -> f64 {
        match self {
            Self::Gaussian => 37.0,
            Self::Boxcar | Self::Epanechnikov => 1.0,
        }
    }
}
