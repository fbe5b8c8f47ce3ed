use locsim_core::Pose2;
use serde::Serialize;

use crate::error::{FilterError, check};

/// How far a robot moves before another scan is taken in: AMCL's `update_min_d` and `update_min_a`. Scans of a robot that stands err
/// alike, by the same map and the same objects; taken for independent ones, they leave a few particles that happen to suit them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UpdateThreshold {
    /// Distance \[m\].
    pub distance_m: f64,
    /// Turn \[rad\].
    pub angle_rad: f64,
}

impl UpdateThreshold {
    pub(crate) fn check(&self) -> Result<(), FilterError> {
        for (name, value) in [("update distance_m", self.distance_m), ("update angle_rad", self.angle_rad)] {
            check(name, value, value.is_finite() && value >= 0.0, "finite and not below 0")?;
        }
        Ok(())
    }

    /// Whether a robot has moved far enough or turned enough.
    pub(crate) fn is_reached(&self, moved: &Pose2) -> bool {
        moved.position().length() >= self.distance_m || moved.theta.abs() >= self.angle_rad
    }
}
