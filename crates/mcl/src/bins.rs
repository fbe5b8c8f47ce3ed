use std::f64::consts::{PI, TAU};

use locsim_core::Pose2;

use crate::FilterError;
use crate::error::check_positive;

/// A regular partition of the poses into bins, for counting (KLD sampling) and for finding clusters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseBins {
    size_m: f64,
    headings: i32,
}

/// The bin of a pose: indices along x, y and heading.
pub(crate) type BinKey = [i32; 3];

impl PoseBins {
    /// Square bins of side `size_m` (m), and the least number of equal heading bins no wider than `size_rad`
    /// (rad). AMCL's are 0.5 m and 10 degrees.
    ///
    /// # Errors
    /// [`FilterError::Option`] where a size is not finite or not above 0.
    pub fn new(size_m: f64, size_rad: f64) -> Result<Self, FilterError> {
        check_positive("bin size", size_m)?;
        check_positive("heading bin size", size_rad)?;
        // The small allowance keeps 10 degrees, rounded to radians, at 36 bins.
        Ok(Self { size_m, headings: (TAU / size_rad - 1e-9).ceil().clamp(1.0, 1e6) as i32 })
    }

    pub(crate) fn key(&self, pose: &Pose2) -> BinKey {
        let heading = ((pose.theta + PI) / TAU * f64::from(self.headings)).floor() as i32;
        [
            (pose.x / self.size_m).floor() as i32,
            (pose.y / self.size_m).floor() as i32,
            heading.rem_euclid(self.headings),
        ]
    }

    /// The bin and those that touch it, 27 at most; headings wrap around.
    pub(crate) fn neighbours(&self, key: BinKey) -> impl Iterator<Item = BinKey> + use<> {
        let headings = self.headings;
        (-1..=1).flat_map(move |dx| {
            (-1..=1).flat_map(move |dy| {
                (-1..=1).map(move |dt| {
                    [key[0].saturating_add(dx), key[1].saturating_add(dy), (key[2] + dt).rem_euclid(headings)]
                })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_degrees_make_36_headings_and_the_cut_is_no_border() {
        let bins = PoseBins::new(0.5, 10_f64.to_radians()).unwrap();
        let keys: std::collections::HashSet<_> = (0..720)
            .map(|i| bins.key(&Pose2::new(0.1, 0.1, (f64::from(i) / 2.0 + 0.1).to_radians())))
            .collect();
        assert_eq!(keys.len(), 36);
        let [below, above] = [PI - 0.01, -PI + 0.01].map(|theta| bins.key(&Pose2::new(0.1, -0.1, theta)));
        assert_ne!(below, above);
        assert!(bins.neighbours(below).any(|key| key == above));
        assert_eq!(bins.key(&Pose2::new(0.0, 0.0, PI)), bins.key(&Pose2::new(0.0, 0.0, -PI + 1e-12)));
    }

    #[test]
    fn sizes_must_be_positive() {
        assert!(PoseBins::new(0.0, 0.1).is_err());
        assert!(PoseBins::new(0.5, f64::NAN).is_err());
    }
}
