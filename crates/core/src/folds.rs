//! Stretches of a log that are held out together.

use std::ops::RangeInclusive;

use crate::Track;

/// The most folds: of a log with more stretches a fold has several, evenly spread.
const MOST_FOLDS: usize = 44;

/// Folds of a log, of stretches of as many consecutive scans each; a last stretch that isn't full goes with the one before.
#[derive(Clone, Copy, Debug)]
pub struct Folds {
    scans_each: usize,
    stretches: usize,
    count: usize,
}

impl Folds {
    /// The folds of a track whose poses are those of the scans: a stretch lasts about `secs` \[s\], and has a number of scans that
    /// `allowed` has (from 1 on).
    pub fn new(track: &Track, secs: f64, allowed: RangeInclusive<usize>) -> Self {
        let (scans, stamps) = (track.len(), track.secs());
        let interval = stamps[scans - 1] / (scans - 1).max(1) as f64;
        // Without duration each stretch has as many as are allowed.
        let scans_each = ((secs / interval).round() as usize).clamp(*allowed.start(), *allowed.end());
        let stretches = (scans / scans_each).max(1);
        Self { scans_each, stretches, count: stretches / stretches.div_ceil(MOST_FOLDS) }
    }

    /// How many there are, at least 1.
    pub fn count(self) -> usize {
        self.count
    }

    /// The fold of a scan.
    pub fn of_scan(self, scan: usize) -> usize {
        (scan / self.scans_each).min(self.stretches - 1) % self.count
    }

    /// The half of the log that a scan is of, 0 or 1: folds alternate.
    pub fn half_of(self, scan: usize) -> usize {
        self.of_scan(scan) % 2
    }

    /// Sums over each fold of a value of each scan.
    pub fn sums(self, of_scans: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.count];
        for (scan, value) in of_scans.iter().enumerate() {
            sums[self.of_scan(scan)] += value;
        }
        sums
    }
}

/// Standard error of a sum over folds.
pub fn sum_error(folds: &[f64]) -> f64 {
    let n = folds.len() as f64;
    let mean = folds.iter().sum::<f64>() / n;
    (n / (n - 1.0) * folds.iter().map(|b| (b - mean).powi(2)).sum::<f64>()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose2;

    fn folds(scans: usize, rate_hz: f64) -> Folds {
        let stamped = (0..scans).map(|i| (i as f64 / rate_hz, Pose2::IDENTITY));
        Folds::new(&Track::new(stamped).unwrap(), 2.0, 5..=20)
    }

    #[test]
    fn folds_last_as_long_as_they_may() {
        let each = [100.0, 10.0, 4.0, 2.0, 0.1, f64::INFINITY].map(|rate_hz| folds(400, rate_hz).scans_each);
        assert_eq!(each, [20, 20, 8, 5, 5, 20]);
    }

    /// 88 stretches of five scans are 44 folds of two each, 45 are 22, and one of these has three.
    #[test]
    fn many_stretches_share_folds() {
        let sizes = |scans: usize| folds(scans, 2.5).sums(&vec![1.0; scans]);
        assert_eq!(sizes(440), [10.0; 44]);
        assert_eq!((folds(440, 2.5).of_scan(4), folds(440, 2.5).of_scan(220)), (0, 0));
        let of_45 = sizes(225);
        assert_eq!((of_45.len(), of_45[0], of_45[1]), (22, 15.0, 10.0));
    }

    #[test]
    fn scans_beyond_the_last_full_fold_go_with_it() {
        let folds = folds(59, 10.0);
        assert_eq!((folds.count(), folds.of_scan(39), folds.of_scan(58), folds.half_of(58)), (2, 1, 1, 1));
        assert_eq!(folds.sums(&[1.0; 59]), [20.0, 39.0]);
    }
}
