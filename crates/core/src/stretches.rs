//! Stretches of a line on which something adds up.

use glam::DVec2;

use crate::Line;

/// Numbers that add up, in bins along a line, to both sides of its point.
#[derive(Clone, Debug)]
pub struct Stretches<const N: usize> {
    line: Line,
    bin_m: f64,
    reach_m: f64,
    counts: Vec<usize>,
    sums: Vec<[f64; N]>,
}

/// A stretch of a line that gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// The gain \[nats\].
    pub gain: f64,
    /// The strength that goes with it.
    pub strength: f64,
    /// Both ends, along the line \[m\].
    pub ends: [DVec2; 2],
}

impl<const N: usize> Stretches<N> {
    /// Empty bins of this length on a line, as far as this from its point \[m\].
    pub fn new(line: Line, bin_m: f64, reach_m: f64) -> Self {
        let bins = (2.0 * reach_m / bin_m) as usize;
        Self { line, bin_m, reach_m, counts: vec![0; bins], sums: vec![[0.0; N]; bins] }
    }

    /// Adds to the bin that a point is beside; nothing beyond the line's reach.
    pub fn add(&mut self, point: DVec2, more: [f64; N]) {
        let bin = (self.line.along.dot(point - self.line.point) + self.reach_m) / self.bin_m;
        if bin < 0.0 {
            return;
        }
        let bin = bin as usize;
        if let (Some(count), Some(sum)) = (self.counts.get_mut(bin), self.sums.get_mut(bin)) {
            *count += 1;
            sum.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
    }

    /// The stretch that gains most, from a bin that isn't empty to another, at least `least_m` long and nowhere empty for more than `gap_m` on
    /// end \[m\]. `judge` gives gain and strength by the sum of its bins. `None` where nothing gains.
    pub fn best(&self, least_m: f64, gap_m: f64, judge: impl Fn([f64; N]) -> (f64, f64)) -> Option<Stretch> {
        let [least, most_empty] = [least_m, gap_m].map(|length| (length / self.bin_m).round() as usize);
        let at = |bin: usize| self.line.point + (bin as f64 * self.bin_m - self.reach_m) * self.line.along;
        let mut best: Option<Stretch> = None;
        for from in (0..self.counts.len()).filter(|&bin| self.counts[bin] > 0) {
            let (mut total, mut last) = ([0.0; N], from);
            for to in from..self.counts.len() {
                total.iter_mut().zip(self.sums[to]).for_each(|(sum, more)| *sum += more);
                if self.counts[to] > 0 {
                    last = to;
                } else if to - last > most_empty {
                    break;
                }
                if self.counts[to] == 0 || to - from + 1 < least {
                    continue;
                }
                let (gain, strength) = judge(total);
                if gain > best.map_or(0.0, |best| best.gain) {
                    best = Some(Stretch { gain, strength, ends: [from, to + 1].map(at) });
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stretch_that_gains_most_has_no_long_gap() {
        let line = Line { point: DVec2::new(10.0, 3.0), along: DVec2::X };
        let mut stretches = Stretches::<1>::new(line, 1.0, 10.0);
        for (x, gain) in [
            (1.5, 1.0),
            (2.5, 2.0),
            (3.5, -0.5),
            (5.5, 3.0),
            (6.5, -9.0),
            (12.5, 4.0),
            (40.5, 99.0),
            (-0.5, 99.0),
        ] {
            stretches.add(DVec2::new(x, 3.02), [gain]);
        }
        let best = |least, most_empty| {
            let best = stretches.best(least, most_empty, |[gain]| (gain, 2.0 * gain))?;
            Some((best.gain, best.strength, best.ends.map(|end| end.x)))
        };
        assert_eq!(best(1.0, 3.0), Some((5.5, 11.0, [1.0, 6.0])));
        assert_eq!(best(1.0, 0.0), Some((4.0, 8.0, [12.0, 13.0])));
        assert_eq!(best(6.0, 0.0), None);
    }
}
