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

/// The least gain that is sure (nats), and its least number of standard errors over folds.
const LEAST_GAIN_NATS: f64 = 5.0;
const LEAST_ERRORS: f64 = 2.0;
/// A held-out gain beyond this isn't chance (nats), and the share of it that may be lost on other folds.
const BEYOND_DOUBT_NATS: f64 = 25.0;
const LOST_SHARE: f64 = 0.1;

/// What each fold gains more by the one than by the other.
pub fn differences(one: &[f64], other: &[f64]) -> Vec<f64> {
    one.iter().zip(other).map(|(one, other)| one - other).collect()
}

/// Whether the sum of held-out gains (nats) of folds is sure: by two standard errors over folds, or by far more than is lost on any of them. What shows in few folds has a large
/// standard error: a turn, a wall that is passed nearby.
pub fn gains_surely(gains: &[f64]) -> bool {
    let gain: f64 = gains.iter().sum();
    let lost: f64 = gains.iter().map(|gain| (-gain).max(0.0)).sum();
    gain > LEAST_GAIN_NATS
        && (gain > LEAST_ERRORS * sum_error(gains) || gain > BEYOND_DOUBT_NATS && lost <= LOST_SHARE * gain)
}

/// Gains of folds (nats) beyond a floor of their sum, shared out among folds as they are.
pub fn gains_beyond(gains: &[f64], floor: f64) -> Vec<f64> {
    let gain: f64 = gains.iter().sum();
    let share = if gain > 0.0 { (1.0 - floor / gain).max(0.0) } else { 0.0 };
    gains.iter().map(|gain| share * gain).collect()
}

/// Each number of a curve costs this (nats): what one that isn't needed gains on the readings that it was fitted to, and loses on
/// others.
const NATS_PER_NUMBER: f64 = 1.0;

/// A curve that gains a share less by so much is as good: what is left of a very strong dependence is the likelihood's approximation.
const TRIFLE: f64 = 1e-3;

/// Of curves with so many numbers and these held-out gains on each fold (nats), the index of the one with the fewest that isn't surely behind
/// the best: a dependence on something is told only where a constant doesn't do. The best one gains most after the cost of its numbers.
#[must_use]
pub fn simplest<'g>(curves: impl Iterator<Item = (usize, &'g [f64])>) -> Option<usize> {
    let curves: Vec<(usize, &[f64])> = curves.collect();
    let gain = |gains: &[f64]| gains.iter().sum::<f64>();
    let worth = |&(numbers, gains): &(usize, &[f64])| gain(gains) - NATS_PER_NUMBER * numbers as f64;
    let (_, most) = *curves.iter().max_by(|a, b| worth(a).total_cmp(&worth(b)))?;
    let is_as_good = |gains: &[f64]| {
        let behind: Vec<f64> = most.iter().zip(gains).map(|(most, own)| most - own).collect();
        gain(&behind) <= f64::max(LEAST_ERRORS * sum_error(&behind), TRIFLE * gain(most))
    };
    let as_good = (0..curves.len()).filter(|&i| is_as_good(curves[i].1));
    as_good.min_by(|&a, &b| {
        let [(few, own), (more, other)] = [curves[a], curves[b]];
        few.cmp(&more).then(gain(other).total_cmp(&gain(own)))
    })
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

    /// Two turns in ten folds show a late odometry; two folds that gain as much beside others that lose don't.
    #[test]
    fn a_gain_of_few_folds_is_sure_where_the_others_lose_nothing() {
        let few = |others: f64, gain: f64| {
            let mut gains = [others; 10];
            (gains[2], gains[7]) = (2.0 * gain, gain);
            gains_surely(&gains)
        };
        assert!(few(0.0, 40.0) && few(-0.5, 40.0));
        assert!(!few(-3.0, 40.0) && !few(0.0, 7.0));
        assert!(gains_surely(&[1.0; 10]) && !gains_surely(&[0.4; 10]));
    }

    #[test]
    fn a_floor_is_taken_off_in_proportion() {
        assert_eq!(gains_beyond(&[30.0, 10.0], 20.0), [15.0, 5.0]);
        assert_eq!(gains_beyond(&[30.0, 10.0], 50.0), [0.0, 0.0]);
        assert_eq!(gains_beyond(&[3.0, -10.0], 0.0), [0.0, 0.0]);
    }

    /// Of ten folds: one number that gains nearly as much as eight is simpler, unless it is surely behind.
    #[test]
    fn the_simplest_curve_that_gains_as_much_is_meant() {
        let even = [10.0; 10];
        let uneven: Vec<f64> = (0..10).map(|i| if i % 2 == 0 { 16.0 } else { 4.0 }).collect();
        let choose = |curves: &[(usize, &[f64])]| simplest(curves.iter().copied());
        assert_eq!(choose(&[(8, &even), (1, &uneven)]), Some(1));
        assert_eq!(choose(&[(8, &even), (1, &[9.0; 10])]), Some(0));
        // The numbers cost more than they gain.
        assert_eq!(choose(&[(8, &even), (1, &[9.5; 10])]), Some(1));
        assert_eq!(choose(&[]), None);
    }
}
