//! Stretches of a line on which something adds up.

use std::ops::Range;

/// Numbers that add up, in bins along a line.
#[derive(Clone, Debug)]
pub struct Stretches<const N: usize> {
    counts: Vec<usize>,
    sums: Vec<[f64; N]>,
}

impl<const N: usize> Stretches<N> {
    /// So many empty bins.
    pub fn new(bins: usize) -> Self {
        Self { counts: vec![0; bins], sums: vec![[0.0; N]; bins] }
    }

    /// Adds to a bin; nothing beyond the last one.
    pub fn add(&mut self, bin: usize, more: [f64; N]) {
        if let (Some(count), Some(sum)) = (self.counts.get_mut(bin), self.sums.get_mut(bin)) {
            *count += 1;
            sum.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
    }

    /// The bins from one that isn't empty to another which gain most, at least `least` of them and nowhere more than `most_empty` empty ones on
    /// end, with their gain and strength. `judge` gives both by the bins' sum. `None` where nothing gains.
    pub fn best(
        &self,
        least: usize,
        most_empty: usize,
        judge: impl Fn([f64; N]) -> (f64, f64),
    ) -> Option<(f64, f64, Range<usize>)> {
        let mut best: Option<(f64, f64, Range<usize>)> = None;
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
                if gain > best.as_ref().map_or(0.0, |(most, ..)| *most) {
                    best = Some((gain, strength, from..to + 1));
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
        let mut stretches = Stretches::<1>::new(20);
        for (bin, gain) in [(1, 1.0), (2, 2.0), (3, -0.5), (5, 3.0), (6, -9.0), (12, 4.0), (40, 99.0)] {
            stretches.add(bin, [gain]);
        }
        let best = |least, most_empty| stretches.best(least, most_empty, |[gain]| (gain, 2.0 * gain));
        assert_eq!(best(1, 3), Some((5.5, 11.0, 1..6)));
        assert_eq!(best(1, 0), Some((4.0, 8.0, 12..13)));
        assert_eq!(best(6, 0), None);
    }
}
